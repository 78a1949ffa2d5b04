//! Corners as a table: `camera,image,view,point,X,Y,Z,u,v`, one line per corner, columns by name.
//!
//! `view` names the frame: equal views of several cameras were taken at once. `image` is optional, and
//! so are `X, Y, Z`, the point's place on the target in squares (in metres for a target given as
//! points); where they are given, they are held against the target. Other columns are left alone.

use std::collections::BTreeMap;

use boresight_data::{Dataset, Geometry, Id as _, Observation, PointId, Target};

use crate::cursor::{Cursor, shown};
use crate::number::parse_number;
use crate::seen::{LIMIT, SeenFile, SeenView, describe, is_missing};
use crate::{Error, Place};

const EXAMPLE: &str = "camera,image,view,point,X,Y,Z,u,v";
/// How far a coordinate may be from the grid's, in squares.
const TOLERANCE: f64 = 1e-4;

/// Returns the corners of a dataset as a table `camera,image,view,point,u,v,sigma_px`, as it is read.
///
/// Pixels and sigmas are rounded to 1e-6 pixels. A name with a comma, or with blanks around it, is quoted.
pub fn corners_to_csv(dataset: &Dataset) -> String {
    let mut text = String::from("camera,image,view,point,u,v,sigma_px\n");
    for view in &dataset.views {
        let quoted = |name: &str| match name.contains(',') || name.trim() != name {
            true => format!("\"{name}\""),
            false => name.to_owned(),
        };
        let camera = quoted(&dataset.cameras[view.camera].name);
        let frame = quoted(&dataset.frames[view.frame].name);
        let image = quoted(view.image.as_deref().unwrap_or_default());
        for Observation { point, pixel: [u, v], sigma_px } in &view.observations {
            text.push_str(&format!("{camera},{image},{frame},{point},{u:.6},{v:.6},{sigma_px:.6}\n"));
        }
    }
    text
}

#[derive(Clone, Copy, PartialEq)]
enum Column {
    Camera,
    Image,
    View,
    Point,
    Position(usize),
    Pixel(usize),
    Sigma,
    Other,
}

/// Reads a table of corners of `target`; `sigma_px` is that of a corner without a column `sigma_px`.
pub(crate) fn read_csv(file: &str, bytes: &[u8], target: &Target, sigma_px: f64) -> Result<SeenFile, Error> {
    let mut cursor = Cursor::new(bytes);
    if bytes.trim_ascii().is_empty() {
        return Err(Error::Empty { file: file.to_owned() });
    }
    let columns = read_header(file, &mut cursor)?;
    let mut views =
        Views { file, points: target.point_count(), views: Vec::new(), ids: BTreeMap::new(), current: None };
    let mut minus_one: Option<(usize, usize)> = None;

    // These three mostly repeat those of the line before.
    let (mut camera, mut image, mut view) = (&b""[..], &b""[..], &b""[..]);
    while !cursor.at_end() {
        cursor.skip_blanks();
        if cursor.at_line_end() {
            cursor.finish_line();
            continue;
        }
        let line = cursor.line();
        let bad = |column: &str, value: &[u8], need: &str| Error::BadValue {
            place: Place::line(file, line),
            column: column.to_owned(),
            value: shown(value),
            need: need.to_owned(),
        };
        let mut sigma = sigma_px;
        let (mut point, mut position, mut pixel) = (0_u64, [f64::NAN; 3], [f64::NAN; 2]);
        let mut n_columns = 0;
        for &column in &columns {
            // An empty last field is a field where empty ones are allowed.
            let optional = matches!(column, Column::Image | Column::Other);
            if cursor.at_line_end() && !(optional && bytes_before(bytes, &cursor) == Some(b',')) {
                break;
            }
            n_columns += 1;
            match column {
                Column::Camera => camera = cursor.take_field_like(camera),
                Column::Image => image = cursor.take_field_like(image),
                Column::View => view = cursor.take_field_like(view),
                Column::Other => _ = cursor.take_field(),
                Column::Point => {
                    let field = cursor.take_field();
                    point = whole_number(field)
                        .ok_or_else(|| bad("point", field, "a point is a whole number, counted from 0"))?;
                }
                Column::Position(axis) => {
                    position[axis] = number(&mut cursor)
                        .map_err(|field| bad(["X", "Y", "Z"][axis], field, "it must be a finite number"))?;
                }
                Column::Pixel(axis) => {
                    pixel[axis] = number(&mut cursor)
                        .map_err(|field| bad(["u", "v"][axis], field, "a pixel must be a finite number"))?;
                }
                Column::Sigma => {
                    sigma = number(&mut cursor)
                        .map_err(|field| bad("sigma_px", field, "it must be a finite number"))?;
                    if !(1e-9..=1e9).contains(&sigma) {
                        return Err(bad(
                            "sigma_px",
                            sigma.to_string().as_bytes(),
                            "a sigma in pixels must be positive",
                        ));
                    }
                }
            }
        }
        let may_end_in_comma = matches!(columns.last(), Some(Column::Image | Column::Other));
        let ends_in_comma = !may_end_in_comma && bytes_before(bytes, &cursor) == Some(b',');
        if n_columns < columns.len() || !cursor.at_line_end() || ends_in_comma {
            let rest = cursor.take_line();
            let more = rest.iter().filter(|&&byte| byte == b',').count() + 1;
            let found = if n_columns < columns.len() { n_columns } else { n_columns + more };
            let cut_off = cursor.at_end() && cursor.ends_without_newline() && n_columns < columns.len();
            return Err(Error::ColumnCount {
                place: Place::line(file, line),
                found,
                need: columns.len(),
                cut_off,
            });
        }
        cursor.finish_line();

        let point = views.check_point(point, line, target)?;
        if let Some((axis, expected)) = disagreement(target, point, position) {
            let geometry = &target.geometry;
            return Err(Error::GridMismatch {
                place: Place::line(file, line),
                column: ['X', 'Y', 'Z'][axis],
                point: point.0,
                value: position[axis],
                expected,
                grid: geometry.grid().unwrap_or([target.point_count() as u32, 1]),
                file_grid: matches!(geometry, Geometry::Chessboard { .. })
                    .then(|| extent(bytes, &columns))
                    .flatten(),
            });
        }
        for (name, value) in [("camera", camera), ("view", view)] {
            if value.is_empty() {
                return Err(bad(name, value, "it must not be empty"));
            }
        }
        if is_missing(pixel) {
            minus_one.get_or_insert((0, line)).0 += 1;
            continue;
        }
        views.add(camera, view, image, line, Observation { point, pixel, sigma_px: sigma })?;
    }
    let views = views.finish();
    if views.is_empty() {
        return Err(Error::NoCorners { file: file.to_owned(), lines: cursor.line() - 1 });
    }
    let cut_off = cursor.ends_without_newline();
    Ok(SeenFile { file: file.to_owned(), views, minus_one, cut_off, ..SeenFile::default() })
}

/// The views read so far; lines of one view usually follow each other, but need not.
struct Views<'a> {
    file: &'a str,
    points: usize,
    views: Vec<(SeenView, Vec<u64>)>,
    ids: BTreeMap<(&'a [u8], &'a [u8]), usize>,
    current: Option<(&'a [u8], &'a [u8], usize)>,
}

impl<'a> Views<'a> {
    fn check_point(&self, point: u64, line: usize, target: &Target) -> Result<PointId, Error> {
        if point < self.points as u64 {
            return Ok(PointId::from_index(point as usize));
        }
        let (place, target) = (Place::line(self.file, line), describe(target));
        Err(Error::PointOutOfRange { place, point, points: self.points, target })
    }

    fn add(
        &mut self,
        camera: &'a [u8],
        view: &'a [u8],
        image: &[u8],
        line: usize,
        observation: Observation,
    ) -> Result<(), Error> {
        let idx = match self.current {
            Some((last_camera, last_view, idx)) if last_camera == camera && last_view == view => idx,
            _ => self.find(camera, view, image, line)?,
        };
        self.current = Some((camera, view, idx));
        let (seen, points) = &mut self.views[idx];
        let (word, bit) = (observation.point.index() / 64, 1_u64 << (observation.point.0 % 64));
        if points.len() <= word {
            points.resize(word + 1, 0);
        }
        if points[word] & bit != 0 {
            return Err(Error::DuplicatePoint {
                place: Place::line(self.file, line),
                point: observation.point.0,
                camera: shown(camera),
                view: shown(view),
            });
        }
        points[word] |= bit;
        seen.observations.push(observation);
        Ok(())
    }

    fn find(&mut self, camera: &'a [u8], view: &'a [u8], image: &[u8], line: usize) -> Result<usize, Error> {
        if let Some(&idx) = self.ids.get(&(camera, view)) {
            return Ok(idx);
        }
        let text = |column: &str, bytes: &[u8]| {
            std::str::from_utf8(bytes).map(str::to_owned).map_err(|_| Error::BadValue {
                place: Place::line(self.file, line),
                column: column.to_owned(),
                value: shown(bytes),
                need: "names must be UTF-8".to_owned(),
            })
        };
        let (idx, image) = (self.views.len(), text("image", image)?);
        if idx >= LIMIT {
            let (file, found) = (self.file.to_owned(), idx + 1);
            return Err(Error::TooMany { file, what: "views", found, limit: LIMIT });
        }
        let seen = SeenView {
            camera: Some(text("camera", camera)?),
            frame: Some(text("view", view)?),
            image: (!image.is_empty()).then_some(image),
            line,
            observations: Vec::new(),
        };
        self.views.push((seen, Vec::new()));
        self.ids.insert((camera, view), idx);
        Ok(idx)
    }

    fn finish(self) -> Vec<SeenView> {
        let sorted = |mut view: SeenView| {
            view.observations.sort_by_key(|observation| observation.point);
            view
        };
        self.views.into_iter().map(|(view, _)| sorted(view)).collect()
    }
}

fn read_header(file: &str, cursor: &mut Cursor<'_>) -> Result<Vec<Column>, Error> {
    let mut line = cursor.line();
    let mut text = cursor.take_line();
    while text.is_empty() && !cursor.at_end() {
        (line, text) = (cursor.line(), cursor.take_line());
    }
    let names: Vec<&[u8]> = text.split(|&byte| byte == b',').map(<[u8]>::trim_ascii).collect();
    let columns: Vec<Column> = names
        .iter()
        .map(|name| match *name {
            b"camera" => Column::Camera,
            b"image" => Column::Image,
            b"view" => Column::View,
            b"point" => Column::Point,
            b"X" => Column::Position(0),
            b"Y" => Column::Position(1),
            b"Z" => Column::Position(2),
            b"u" => Column::Pixel(0),
            b"v" => Column::Pixel(1),
            b"sigma_px" => Column::Sigma,
            _ => Column::Other,
        })
        .collect();
    let required = [
        (Column::Camera, "camera"),
        (Column::View, "view"),
        (Column::Point, "point"),
        (Column::Pixel(0), "u"),
        (Column::Pixel(1), "v"),
    ];
    for (column, missing) in required {
        if !columns.contains(&column) {
            let (place, header) = (Place::line(file, line), shown(text));
            return Err(Error::Header { place, header, missing, example: EXAMPLE });
        }
    }
    for (i, column) in columns.iter().enumerate() {
        if *column != Column::Other && columns[..i].contains(column) {
            return Err(Error::Malformed {
                place: Place::line(file, line),
                found: format!("the header names `{}` twice", shown(names[i])),
                need: "each column is named once",
            });
        }
    }
    Ok(columns)
}

/// Returns a finite number, or the field that is none.
#[inline(always)]
fn number<'a>(cursor: &mut Cursor<'a>) -> Result<f64, &'a [u8]> {
    cursor.skip_blanks();
    let field = cursor.rest();
    let value = cursor.take_number()?;
    cursor.finish_field();
    let length = || field.iter().position(|&byte| byte <= b' ' || byte == b',').unwrap_or(field.len());
    if value.is_finite() { Ok(value) } else { Err(&field[..length()]) }
}

fn whole_number(field: &[u8]) -> Option<u64> {
    let digits = !field.is_empty() && field.len() <= 18 && field.iter().all(u8::is_ascii_digit);
    digits.then(|| field.iter().fold(0, |value, digit| 10 * value + u64::from(digit - b'0')))
}

fn bytes_before(bytes: &[u8], cursor: &Cursor<'_>) -> Option<u8> {
    let at = bytes.len() - cursor.rest().len();
    at.checked_sub(1).map(|before| bytes[before])
}

/// Returns the first axis on which a position, where given, is not the target's, and what it is there.
#[inline]
fn disagreement(target: &Target, point: PointId, position: [f64; 3]) -> Option<(usize, f64)> {
    let expected = match (&target.geometry, target.geometry.grid()) {
        (Geometry::Points { points_m }, _) => points_m[point.index()],
        // Corners of squares are counted, other points are in metres.
        (Geometry::Chessboard { .. } | Geometry::Charuco { .. }, Some([columns, _])) => {
            [f64::from(point.0 % columns), f64::from(point.0 / columns), 0.0]
        }
        _ => target.drawn_point(point).into(),
    };
    (0..3)
        .find(|&axis| (position[axis] - expected[axis]).abs() > TOLERANCE)
        .map(|axis| (axis, expected[axis]))
}

/// Returns the columns and rows of the grid that a table's X and Y span, if they span one of whole squares.
fn extent(bytes: &[u8], columns: &[Column]) -> Option<[u32; 2]> {
    let mut size = [0_u32; 2];
    let lines = bytes.split(|&byte| byte == b'\n').skip(1).filter(|line| !line.trim_ascii().is_empty());
    for line in lines {
        for (field, column) in line.split(|&byte| byte == b',').zip(columns) {
            let Column::Position(axis @ 0..=1) = *column else { continue };
            let value = parse_number(field.trim_ascii())?;
            if value.fract() != 0.0 || !(0.0..10_000.0).contains(&value) {
                return None;
            }
            size[axis] = size[axis].max(value as u32 + 1);
        }
    }
    (size[0] > 1 && size[1] > 1).then_some(size)
}

#[cfg(test)]
mod tests {
    use boresight_data::{CameraInfo, Frame, Shape, TargetId, View};

    use super::*;

    const HEADER: &str = "camera,image,view,point,X,Y,Z,u,v\n";

    fn read(text: &str) -> Result<SeenFile, Error> {
        let geometry = Geometry::Chessboard { columns: 3, rows: 2, spacing_m: 0.1 };
        let target = Target { name: "board".to_owned(), geometry, shape: Shape::Rigid };
        read_csv("c.csv", text.as_bytes(), &target, 1.0)
    }

    #[test]
    fn what_is_written_is_read_with_its_names() {
        let names = ["left, upper", " a.png", "12"];
        let seen = Observation { point: PointId(4), pixel: [10.25, 20.5], sigma_px: 0.125 };
        let mut dataset = Dataset::default();
        let camera = CameraInfo { name: names[0].to_owned(), image_size: [64, 48] };
        let camera = dataset.cameras.push(camera);
        let frame = dataset.frames.push(Frame { name: names[2].to_owned(), ..Frame::default() });
        let image = Some(names[1].to_owned());
        dataset.views.push(View { camera, frame, target: TargetId(0), image, observations: vec![seen] });
        let read = read(&corners_to_csv(&dataset)).unwrap();
        let view = &read.views[0];
        let found = [&view.camera, &view.image, &view.frame].map(|name| name.as_deref().unwrap());
        assert_eq!(found, names);
        assert_eq!(view.observations, [seen]);
    }

    fn refuses(text: &str, parts: &[&str]) {
        let error = read(text).unwrap_err();
        let message = format!("{error} {}", error.hint().unwrap_or_default());
        for part in parts {
            assert!(message.contains(part), "`{part}` is not in: {message}");
        }
    }

    fn row(line: &str) -> String {
        format!("{HEADER}left,a.png,0,0,0,0,0,10,20\n{line}")
    }

    #[test]
    fn rows_are_gathered_into_views() {
        let seen = read(&row(
            "right,,0,1,1,0,0,5,6\r\nleft,a.png,0,4,1,1,0,1,2\n left , a.png,0 ,1,1,0,0,-3e1, 4 \n",
        ))
        .unwrap();
        let views: Vec<_> = seen
            .views
            .iter()
            .map(|view| {
                let points: Vec<_> = view.observations.iter().map(|o| (o.point.0, o.pixel)).collect();
                (view.camera.as_deref().unwrap(), view.image.as_deref(), view.line, points)
            })
            .collect();
        let left = vec![(0, [10.0, 20.0]), (1, [-30.0, 4.0]), (4, [1.0, 2.0])];
        assert_eq!(views, [("left", Some("a.png"), 2, left), ("right", None, 3, vec![(1, [5.0, 6.0])])]);
    }

    #[test]
    fn columns_go_by_name_and_some_are_optional() {
        let seen = read("v,u,extra,point,view,camera,sigma_px\n2,1,\"x, y\",5,7,c,0.25\n").unwrap();
        let observation = Observation { point: PointId(5), pixel: [1.0, 2.0], sigma_px: 0.25 };
        assert_eq!(seen.views[0].observations, [observation]);
        assert_eq!(read(&row("left,a.png,0,1,1,0,0,-1,-1\n")).unwrap().minus_one, Some((1, 3)));
    }

    #[test]
    fn what_is_wrong_is_said_with_line_value_and_fix() {
        refuses("", &["c.csv: the file is empty"]);
        refuses("\n \n", &["c.csv: the file is empty"]);
        refuses(HEADER, &["no corner", "1 lines"]);
        refuses("left,a.png,0,0,0,0,0,1,2\n", &["c.csv:1", "no column `camera`", "camera,image,view"]);
        refuses("camera,view,point,u,u,v\n", &["names `u` twice"]);
        refuses(&row("left,a.png,0,1,1,0,0,NaN,2\n"), &["c.csv:3", "u is `NaN`"]);
        refuses(&row("left,a.png,0,1,1,0,0,2,inf\n"), &["c.csv:3", "v is `inf`"]);
        refuses(&row("left,a.png,0,1,1,0,0,2,\n"), &["c.csv:3"]);
        refuses(&row("left,a.png,0,x,1,0,0,2,3\n"), &["c.csv:3", "point is `x`"]);
        refuses(&row("left,a.png,0,1,1,0,0,2\n"), &["c.csv:3", "8 columns, the header 9"]);
        refuses(&row("left,a.png,0,1,1,0,0,2,3,4,5\n"), &["c.csv:3", "11 columns, the header 9"]);
        refuses(&row("left,a.png,0,1,1,0,0,2"), &["c.csv:3", "8 columns", "cut off"]);
        refuses(&row("left,a.png,0,0,0,0,0,2,3\n"), &["c.csv:3", "point 0 appears a second time", "left"]);
        refuses(&row("left,a.png,0,6,0,2,0,2,3\n"), &["c.csv:3", "point 6", "3x2", "points 0 to 5"]);
        refuses(&row(",a.png,0,1,1,0,0,2,3\n"), &["c.csv:3", "camera is ``"]);
        refuses(&row("left,a.png,0,1,0.1,0,0,2,3\n"), &["c.csv:3", "X = 0.1", "X = 1", "count squares"]);
        refuses(
            &row("l,a,0,1,1,0,0,2,3\nl,a,0,2,0,1,0,4,4\nl,a,0,5,1,2,0,9,9\n"),
            &["c.csv:4", "point 2 has X = 0", "3x2", "the file is 2x3: write columns = 2, rows = 3"],
        );
    }
}
