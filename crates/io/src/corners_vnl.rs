//! mrcal's and mrgingham's `corners.vnl`: `# filename x y level|weight`, one line per corner.
//!
//! The corners of an image follow each other, along the target's columns fastest. `- - -` alone is an
//! image without a board; `-` or a negative level is a missing corner. The header decides what the
//! last column means: a level `l` is a corner found at half the resolution `l` times, with a sigma
//! of `2^l` times the base; a weight `w` divides the base sigma.

use boresight_data::{Observation, PointId, Target};

use crate::cursor::{Cursor, shown};
use crate::seen::{LIMIT, SeenFile, SeenView, is_missing};
use crate::{Error, Place};

const EXAMPLE: &str = "# filename x y level";
const HIGHEST_LEVEL: f64 = 16.0;
const SMALLEST_WEIGHT: f64 = 1e-9;

#[derive(Clone, Copy, PartialEq)]
enum Column {
    File,
    X,
    Y,
    Level,
    Weight,
    Other,
}

/// Reads a vnl file whose images hold `target`; `sigma_px` is that of a corner of level 0 or weight 1.
pub(crate) fn read_vnl(file: &str, bytes: &[u8], target: &Target, sigma_px: f64) -> Result<SeenFile, Error> {
    let mut cursor = Cursor::new(bytes);
    if bytes.trim_ascii().is_empty() {
        return Err(Error::Empty { file: file.to_owned() });
    }
    let columns = read_header(file, &mut cursor)?;
    let mut images =
        Images { file, target, done: Vec::new(), name: &[], line: 0, n_lines: 0, observations: Vec::new() };
    let mut minus_one: Option<(usize, usize)> = None;
    let place = |line| Place::line(file, line);

    while !cursor.at_end() {
        cursor.skip_blanks();
        if cursor.at_line_end() {
            cursor.finish_line();
            continue;
        }
        if cursor.rest()[0] == b'#' {
            cursor.take_line();
            continue;
        }
        let line = cursor.line();
        let (mut x, mut y, mut sigma, mut missing) = (f64::NAN, f64::NAN, sigma_px, false);
        let mut n_columns = 0;
        for &column in &columns {
            cursor.skip_blanks();
            if cursor.at_line_end() {
                break;
            }
            n_columns += 1;
            match column {
                Column::File => images.take_name(&mut cursor)?,
                Column::Other => _ = cursor.take_token(),
                Column::X | Column::Y | Column::Level | Column::Weight => {
                    // Most levels and weights are a single digit.
                    let digit = cursor.take_single_digit().map(f64::from);
                    let value = match digit.map_or_else(|| cursor.take_number(), Ok) {
                        Ok(value) => value,
                        Err(b"-") => {
                            missing = true;
                            continue;
                        }
                        Err(token) => return Err(bad_value(place(line), column, token)),
                    };
                    match column {
                        Column::X => x = value,
                        Column::Y => y = value,
                        // The usual case needs no power.
                        Column::Level if value == 0.0 => {}
                        Column::Level if (..=HIGHEST_LEVEL).contains(&value) => {
                            missing |= value < 0.0;
                            sigma = sigma_px * value.exp2();
                        }
                        Column::Weight if value.is_finite() && (value <= 0.0 || value > SMALLEST_WEIGHT) => {
                            missing |= value <= 0.0;
                            sigma = sigma_px / value;
                        }
                        _ => return Err(bad_value(place(line), column, value.to_string().as_bytes())),
                    }
                }
            }
        }
        cursor.skip_blanks();
        if n_columns < columns.len() || !cursor.at_line_end() {
            let found = n_columns + shown(cursor.take_line()).split_whitespace().count();
            let cut_off = cursor.at_end() && cursor.ends_without_newline();
            return Err(Error::ColumnCount { place: place(line), found, need: columns.len(), cut_off });
        }
        cursor.finish_line();
        images.n_lines += 1;
        if missing {
            continue;
        }
        if is_missing([x, y]) {
            minus_one.get_or_insert((0, line)).0 += 1;
            continue;
        }
        if !(x.is_finite() && y.is_finite()) {
            let (column, value) = if x.is_finite() { (Column::Y, y) } else { (Column::X, x) };
            return Err(bad_value(place(line), column, value.to_string().as_bytes()));
        }
        let point = PointId((images.n_lines - 1) as u32);
        images.observations.push(Observation { point, pixel: [x, y], sigma_px: sigma });
    }
    images.finish()?;
    let views = images.done;
    if views.iter().all(|view| view.observations.is_empty()) {
        return Err(Error::NoCorners { file: file.to_owned(), lines: cursor.line() - 1 });
    }
    let cut_off = cursor.ends_without_newline();
    Ok(SeenFile { file: file.to_owned(), views, minus_one, cut_off, ..SeenFile::default() })
}

/// The images read so far, and the one being read.
struct Images<'a> {
    file: &'a str,
    target: &'a Target,
    done: Vec<SeenView>,
    name: &'a [u8],
    line: usize,
    n_lines: usize,
    observations: Vec<Observation>,
}

impl<'a> Images<'a> {
    /// Reads the name of an image and finishes the image before it, where it is another.
    #[inline(always)]
    fn take_name(&mut self, cursor: &mut Cursor<'a>) -> Result<(), Error> {
        if !self.name.is_empty() && cursor.take_word(self.name, |byte| byte <= b' ') {
            return Ok(());
        }
        self.start(cursor.take_token(), cursor.line())
    }

    fn start(&mut self, name: &'a [u8], line: usize) -> Result<(), Error> {
        self.finish()?;
        (self.name, self.line, self.n_lines) = (name, line, 0);
        Ok(())
    }

    fn finish(&mut self) -> Result<(), Error> {
        if self.name.is_empty() {
            return Ok(());
        }
        let place = || Place::line(self.file, self.line);
        let Ok(name) = std::str::from_utf8(self.name) else {
            let (value, need) = (shown(self.name), "file names must be UTF-8".to_owned());
            return Err(Error::BadValue { place: place(), column: "filename".to_owned(), value, need });
        };
        let points = self.target.point_count();
        let without_board = self.n_lines == 1 && self.observations.is_empty();
        if self.n_lines != points && !without_board {
            return Err(match self.target.geometry.grid() {
                Some(grid) => Error::CornerCount {
                    place: place(),
                    image: name.to_owned(),
                    found: self.n_lines,
                    grid,
                    others_fit: self.done.iter().any(|view| !view.observations.is_empty()),
                },
                None => Error::Malformed {
                    place: place(),
                    found: format!("image {name} has {} corners, the target {points} points", self.n_lines),
                    need: "a vnl file has a line for every point of the target, in their order",
                },
            });
        }
        if self.done.len() >= LIMIT {
            let (file, found) = (self.file.to_owned(), self.done.len() + 1);
            return Err(Error::TooMany { file, what: "images", found, limit: LIMIT });
        }
        // The next image most likely has as many corners.
        let next = Vec::with_capacity(self.observations.len());
        let observations = std::mem::replace(&mut self.observations, next);
        let image = Some(name.to_owned());
        self.done.push(SeenView { camera: None, frame: None, image, line: self.line, observations });
        Ok(())
    }
}

fn read_header(file: &str, cursor: &mut Cursor<'_>) -> Result<Vec<Column>, Error> {
    let header = |line: usize, text: &[u8], missing| Error::Header {
        place: Place::line(file, line),
        header: shown(text),
        missing,
        example: EXAMPLE,
    };
    while !cursor.at_end() {
        let line = cursor.line();
        let text = cursor.take_line().trim_ascii_start();
        let names = match text {
            [] | [b'#', b'#' | b'!', ..] => continue,
            [b'#', names @ ..] if names.trim_ascii().is_empty() => continue,
            [b'#', names @ ..] => names,
            _ => return Err(header(line, text, "filename")),
        };
        let columns: Vec<Column> = names
            .split(u8::is_ascii_whitespace)
            .filter(|name| !name.is_empty())
            .map(|name| match name {
                b"filename" => Column::File,
                b"x" => Column::X,
                b"y" => Column::Y,
                b"level" => Column::Level,
                b"weight" => Column::Weight,
                _ => Column::Other,
            })
            .collect();
        for (column, name) in [(Column::File, "filename"), (Column::X, "x"), (Column::Y, "y")] {
            match columns.iter().filter(|other| **other == column).count() {
                0 => return Err(header(line, text, name)),
                1 => {}
                _ => return Err(twice(file, line, text)),
            }
        }
        if columns.iter().filter(|column| matches!(column, Column::Level | Column::Weight)).count() > 1 {
            return Err(twice(file, line, text));
        }
        return Ok(columns);
    }
    Err(header(cursor.line(), b"", "filename"))
}

fn twice(file: &str, line: usize, text: &[u8]) -> Error {
    Error::Malformed {
        place: Place::line(file, line),
        found: format!("the header is `{}`", shown(text)),
        need: "each column is named once, and one of level and weight at most",
    }
}

fn bad_value(place: Place, column: Column, token: &[u8]) -> Error {
    let (column, need) = match column {
        Column::X => ("x", "a pixel coordinate must be a finite number, or `-` for a missing corner"),
        Column::Y => ("y", "a pixel coordinate must be a finite number, or `-` for a missing corner"),
        Column::Level => ("level", "a level counts halvings of the image, 0 to 16; `-` is a missing corner"),
        _ => ("weight", "a weight must be a finite number, or `-` for a missing corner"),
    };
    Error::BadValue { place, column: column.to_owned(), value: shown(token), need: need.to_owned() }
}

#[cfg(test)]
mod tests {
    use boresight_data::{Geometry, Shape};

    use super::*;

    fn read(text: &str) -> Result<SeenFile, Error> {
        let geometry = Geometry::Chessboard { columns: 2, rows: 2, spacing_m: 0.1 };
        let target = Target { name: "board".to_owned(), geometry, shape: Shape::Rigid };
        read_vnl("c.vnl", text.as_bytes(), &target, 0.5)
    }

    fn refuses(text: &str, parts: &[&str]) {
        let error = read(text).unwrap_err();
        let message = format!("{error} {}", error.hint().unwrap_or_default());
        for part in parts {
            assert!(message.contains(part), "`{part}` is not in: {message}");
        }
    }

    #[test]
    fn the_header_decides_between_level_and_weight() {
        let rows = "a.png 1 2 1\na.png 3 4 2\na.png 5 6 -\na.png 7.5 8 -1\n";
        let sigmas = |header: &str| -> Vec<(u32, f64)> {
            let seen = read(&format!("## made by hand\n{header}\n{rows}b.png - - -\n")).unwrap();
            assert_eq!(seen.views.len(), 2);
            assert_eq!(seen.views[1].line, 7);
            seen.views[0].observations.iter().map(|o| (o.point.0, o.sigma_px)).collect()
        };
        assert_eq!(sigmas("# filename x y level"), [(0, 1.0), (1, 2.0)]);
        assert_eq!(sigmas("# filename x y weight"), [(0, 0.5), (1, 0.25)]);
    }

    #[test]
    fn columns_may_be_in_any_order_and_lines_end_in_any_way() {
        let seen = read("# x y who filename\r\n1 2 me a\r\n3 4 me a\r\n\r\n5 6 me a\r\n7 8 me a").unwrap();
        let pixels: Vec<_> = seen.views[0].observations.iter().map(|o| o.pixel).collect();
        assert_eq!(pixels, [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0], [7.0, 8.0]]);
        assert!(seen.cut_off);
    }

    #[test]
    fn corners_at_minus_one_are_missing() {
        let seen = read("# filename x y level\na 1 1 0\na -1 -1 0\na -1. -1.0 0\na 2 2 0\n").unwrap();
        assert_eq!(seen.minus_one, Some((2, 3)));
        assert_eq!(seen.views[0].observations.len(), 2);
    }

    #[test]
    fn what_is_wrong_is_said_with_line_value_and_fix() {
        let ok = "# filename x y level\na 1 1 0\na 1 2 0\na 1 3 0\na 1 4 0\n";
        refuses("", &["c.vnl: the file is empty"]);
        refuses("a 1 2 0\n", &["c.vnl:1", "`a 1 2 0`", "# filename x y level"]);
        refuses("# filename x level\n", &["no column `y`"]);
        refuses("# filename x y level weight\n", &["c.vnl:1", "one of level and weight"]);
        refuses("# filename x y level\nb - - -\n", &["no corner"]);
        refuses(&format!("{ok}b 1 nan 0\n"), &["c.vnl:6", "y is `NaN`"]);
        refuses(&format!("{ok}b 1 2\n"), &["c.vnl:6", "3 columns, the header 4"]);
        refuses(&format!("{ok}b 1 2 0 9 9\n"), &["c.vnl:6", "6 columns, the header 4"]);
        refuses(&format!("{ok}b 1 2"), &["c.vnl:6", "cut off"]);
        refuses(&format!("{ok}b 1 2 0\nb 1 2 0\n"), &["c.vnl:6", "image b has 2 corners", "cut off"]);
        refuses("# filename x y level\na 1 1x 0\n", &["c.vnl:2", "y is `1x`"]);
        refuses("# filename x y level\na 1 1 40\n", &["c.vnl:2", "level is `40`"]);
        let long: String = (0..12).map(|i| format!("a {i} 1 0\n")).collect();
        refuses(
            &format!("# filename x y level\n{long}"),
            &["12 corners, a grid of 2x2 has 4", "12 corners are 4x3"],
        );
    }
}
