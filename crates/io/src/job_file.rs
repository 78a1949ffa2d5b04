//! `boresight.toml`: the layout of a job file, and errors that name its line.
//!
//! ```toml
//! [target]
//! kind = "chessboard"            # or "points" with file = "points.csv" (id,x_m,y_m,z_m)
//! columns = 9                    # inner corners
//! rows = 6
//! spacing_m = 0.025
//! [[board]]                      # optional: more targets, anywhere; each with its own corners
//! name = "wall"
//! kind = "chessboard:9x6:25mm"   # or as in [target]
//! corners = ["wall.csv"]
//! [[camera]]
//! name = "left"
//! image_size = [640, 480]
//! images = "left*.jpg"           # optional: the names of its images in a .vnl
//! model = "pinhole"              # optional: a lens that is known and shall not be estimated ...
//! params = [600.0, 600.0, 319.5, 239.5]   # ... and its parameters
//! [input]
//! corners = ["corners.csv"]      # relative to this file; .csv or .vnl
//! images = ["left", "right*.png"]   # or, instead: images, folders of them, patterns
//! recordings = ["drive.mcap"]    # or, instead: MCAP recordings
//! clock = "header"               # optional, of recordings: which times are believed, or "log"
//! sync_tolerance_ms = 5.0        # optional, of recordings: how far apart images of one frame may be
//! frame_times = "times.csv"      # optional, of corners and images: when each frame was taken (frame,time_s)
//! sigma_px = 1.0                 # optional
//! [robot]                        # see `robot_input.rs`
//! [options]                      # the command line's names; read by the pipeline
//! ```

use std::path::Path;

use boresight_camera::{Camera, Model};
use boresight_data::{Geometry, Shape, Target};
use serde::Deserialize;
use toml::Spanned;

use crate::assemble::CameraSpec;
use crate::error::closest;
use crate::image_names::Listed;
use crate::recording::Clock;
use crate::robot_input::RobotTable;
use crate::target_spec::{TARGET_NAME, chessboard};
use crate::{Error, Place};

/// What a job file says.
#[derive(Debug, Default)]
pub(crate) struct JobFile {
    pub target: Option<TargetDescription>,
    /// The targets beside it.
    pub boards: Vec<Board>,
    pub cameras: Vec<CameraSpec>,
    pub corners: Vec<String>,
    pub images: Vec<String>,
    pub recordings: Vec<String>,
    /// Which times of recordings are believed.
    pub clock: Option<Clock>,
    /// How far apart in time images of one frame may be, in nanoseconds.
    pub tolerance_ns: Option<i64>,
    /// The file that tells when frames were taken.
    pub frame_times: Option<String>,
    pub sigma_px: Option<f64>,
    pub options: toml::Table,
    /// The table `[robot]`, and where it stands.
    pub robot: Option<(RobotTable, Place)>,
    /// The lenses that are known, by camera.
    pub known_lenses: Vec<(String, Camera)>,
}

/// A target beside the first, and the files with its corners.
#[derive(Debug)]
pub(crate) struct Board {
    pub name: String,
    pub target: TargetDescription,
    pub corners: Vec<String>,
}

/// A target as a job file describes it.
#[derive(Debug)]
pub(crate) enum TargetDescription {
    /// In full.
    Here(Target),
    /// By the name of a file of points, relative to the job file.
    Points(String),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Tables {
    target: Option<Spanned<TargetTable>>,
    #[serde(default, rename = "board")]
    boards: Vec<Spanned<BoardTable>>,
    #[serde(default, rename = "camera")]
    cameras: Vec<Spanned<CameraTable>>,
    #[serde(default)]
    input: InputTable,
    #[serde(default)]
    options: toml::Table,
    robot: Option<Spanned<RobotTable>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TargetTable {
    kind: Spanned<String>,
    columns: Option<u32>,
    rows: Option<u32>,
    spacing_m: Option<Spanned<f64>>,
    file: Option<String>,
}

/// The keys of a target, a name and files; serde cannot flatten where unknown keys are refused.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct BoardTable {
    name: Spanned<String>,
    kind: Spanned<String>,
    columns: Option<u32>,
    rows: Option<u32>,
    spacing_m: Option<Spanned<f64>>,
    file: Option<String>,
    corners: Vec<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CameraTable {
    name: Spanned<String>,
    image_size: Spanned<[u32; 2]>,
    images: Option<String>,
    /// The lens, where it is known and shall not be estimated: its model and its parameters.
    model: Option<String>,
    params: Option<Spanned<Vec<f64>>>,
}

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct InputTable {
    #[serde(default)]
    corners: Vec<String>,
    #[serde(default)]
    images: Vec<String>,
    #[serde(default)]
    recordings: Vec<String>,
    clock: Option<Spanned<String>>,
    sync_tolerance_ms: Option<Spanned<f64>>,
    frame_times: Option<String>,
    sigma_px: Option<Spanned<f64>>,
}

/// Reads a job file.
pub(crate) fn read_job_file(file: &str, bytes: &[u8]) -> Result<JobFile, Error> {
    let text = std::str::from_utf8(bytes).map_err(|error| {
        let line = line_of(bytes, error.valid_up_to());
        wrong(Place::line(file, line), "the text is not UTF-8", None)
    })?;
    let tables: Tables = toml::from_str(text).map_err(|error| explain(file, bytes, &error))?;
    let at = |span: std::ops::Range<usize>| Place::line(file, line_of(bytes, span.start));

    let target = tables.target.map(|table| read_target(&table, &at)).transpose()?;
    let boards = read_boards(tables.boards, &at)?;
    let mut cameras: Vec<CameraSpec> = Vec::new();
    let mut known_lenses = Vec::new();
    for table in tables.cameras {
        let CameraTable { name, image_size, images, model, params } = table.into_inner();
        if name.as_ref().is_empty() || name.as_ref().chars().any(|c| c.is_control() || "/\\".contains(c)) {
            let message = format!("camera name `{}`: it must be a word without / and \\", name.as_ref());
            return Err(wrong(at(name.span()), &message, None));
        }
        if cameras.iter().any(|camera| camera.listed.name == *name.as_ref()) {
            let message = format!("there are two cameras with the name `{}`", name.as_ref());
            return Err(wrong(at(name.span()), &message, Some("names of cameras are unique")));
        }
        let [width, height] = *image_size.as_ref();
        if !(1..=1_000_000).contains(&width) || !(1..=1_000_000).contains(&height) {
            let message =
                format!("image_size is [{width}, {height}]: width and height in pixels must be positive");
            return Err(wrong(at(image_size.span()), &message, None));
        }
        if let Some(params) = params {
            let refused = |why: String| {
                let fix = "write model = \"pinhole\" and params = [fx, fy, cx, cy], or the parameters of another model";
                wrong(at(params.span()), &why, Some(fix))
            };
            let model = model.ok_or_else(|| refused("`params` without `model`".to_owned()))?;
            let model: Model = model.parse().map_err(|error| refused(format!("{error}")))?;
            let lens = Camera::new(model, params.as_ref().clone(), [width, height]);
            known_lenses.push((name.as_ref().clone(), lens.map_err(|error| refused(error.to_string()))?));
        } else if model.is_some() {
            let fix =
                "a lens that is known has `params` too; the model of lenses to be estimated is in [options]";
            return Err(wrong(at(name.span()), "`model` without `params`", Some(fix)));
        }
        let listed = Listed { name: name.into_inner(), images };
        cameras.push(CameraSpec { listed, image_size: [width, height] });
    }
    let kinds = [&tables.input.corners, &tables.input.images, &tables.input.recordings];
    if kinds.iter().filter(|named| !named.is_empty()).count() > 1 {
        let message = "[input] names more than one of corners, images and recordings";
        return Err(wrong(Place::file(file), message, Some("calibrate from one of them at a time")));
    }
    let are_detected = !tables.input.images.is_empty() || !tables.input.recordings.is_empty();
    if are_detected && !boards.is_empty() {
        let message = "[[board]] beside images or recordings: one target is detected at a time";
        let fix = "detect each with `boresight detect --target ... -o corners.csv`, and name the corners";
        return Err(wrong(Place::file(file), message, Some(fix)));
    }
    if tables.input.frame_times.is_some() && !tables.input.recordings.is_empty() {
        let message = "[input] has frame_times beside recordings, whose images have times of their own";
        return Err(wrong(Place::file(file), message, Some("leave frame_times out")));
    }
    let clock = match tables.input.clock {
        None => None,
        Some(said) => match said.as_ref().as_str() {
            "header" => Some(Clock::Header),
            "log" => Some(Clock::Log),
            other => {
                let message = format!("clock is `{other}`: it is \"header\" or \"log\"");
                return Err(wrong(at(said.span()), &message, None));
            }
        },
    };
    let tolerance_ns = match tables.input.sync_tolerance_ms {
        None => None,
        Some(said) if (0.0..=1e6).contains(said.as_ref()) => Some((said.as_ref() * 1e6).round() as i64),
        Some(said) => {
            let message = format!("sync_tolerance_ms is {}: it must be 0 to 1000000", said.as_ref());
            return Err(wrong(at(said.span()), &message, Some("leave it out for a quarter of the period")));
        }
    };
    let sigma_px = tables.input.sigma_px.map(|sigma| (sigma.span(), sigma.into_inner()));
    if let Some((span, sigma)) = sigma_px.clone().filter(|(_, sigma)| !(1e-6..=1e3).contains(sigma)) {
        let message =
            format!("sigma_px is {sigma}: the standard deviation of a corner in pixels must be positive");
        return Err(wrong(at(span), &message, Some("leave it out for 1 px")));
    }
    let sigma_px = sigma_px.map(|(_, sigma)| sigma);
    let robot = tables.robot.map(|table| (at(table.span()), table.into_inner()));
    let robot = robot.map(|(place, table)| (table, place));
    Ok(JobFile {
        target,
        boards,
        cameras,
        corners: tables.input.corners,
        images: tables.input.images,
        recordings: tables.input.recordings,
        clock,
        tolerance_ns,
        frame_times: tables.input.frame_times,
        sigma_px,
        options: tables.options,
        robot,
        known_lenses,
    })
}

/// Reads the points of a target: `id,x_m,y_m,z_m`, ids 0, 1, 2, ... in any order.
pub(crate) fn read_points(file: &str, bytes: &[u8]) -> Result<Target, Error> {
    const NAMES: [&str; 4] = ["id", "x_m", "y_m", "z_m"];
    const EXAMPLE: &str = "id,x_m,y_m,z_m";
    let text = String::from_utf8_lossy(bytes);
    let mut lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    let Some((first, header)) = lines.next() else { return Err(Error::Empty { file: file.to_owned() }) };
    let columns: Vec<&str> = header.split(',').map(str::trim).collect();
    let mut order = [0; 4];
    for (i, missing) in NAMES.into_iter().enumerate() {
        order[i] = columns.iter().position(|column| *column == missing).ok_or_else(|| Error::Header {
            place: Place::line(file, first + 1),
            header: crate::cursor::shown(header.as_bytes()),
            missing,
            example: EXAMPLE,
        })?;
    }
    let mut points: Vec<(usize, usize, [f64; 3])> = Vec::new();
    for (i, line) in lines {
        let place = || Place::line(file, i + 1);
        let fields: Vec<&str> = line.split(',').map(str::trim).collect();
        if fields.len() != columns.len() {
            let (found, need) = (fields.len(), columns.len());
            return Err(Error::ColumnCount { place: place(), found, need, cut_off: false });
        }
        let bad = |i: usize, need: &str| Error::BadValue {
            place: place(),
            column: NAMES[i].to_owned(),
            value: crate::cursor::shown(fields[order[i]].as_bytes()),
            need: need.to_owned(),
        };
        let id = fields[order[0]]
            .parse::<usize>()
            .map_err(|_| bad(0, "an id is a whole number, counted from 0"))?;
        let mut point = [0.0; 3];
        for axis in 0..3 {
            let value = fields[order[axis + 1]].parse::<f64>().ok().filter(|value| value.abs() < 1e6);
            point[axis] = value.ok_or_else(|| bad(axis + 1, "it must be a number of metres"))?;
        }
        points.push((id, i + 1, point));
    }
    points.sort_by_key(|(id, line, _)| (*id, *line));
    if let Some((i, (id, line, _))) = points.iter().enumerate().find(|(i, (id, ..))| i != id) {
        return Err(Error::Malformed {
            place: Place::line(file, *line),
            found: format!(
                "point {id} follows point {}",
                if i == 0 { "none".to_owned() } else { points[i - 1].0.to_string() }
            ),
            need: "ids are 0, 1, 2, ... each once",
        });
    }
    if points.len() < 3 {
        return Err(Error::Malformed {
            place: Place::file(file),
            found: format!("it has {} points", points.len()),
            need: "a target has at least 3 points",
        });
    }
    let points_m = points.into_iter().map(|(_, _, point)| point).collect();
    Ok(Target { name: TARGET_NAME.to_owned(), geometry: Geometry::Points { points_m }, shape: Shape::Rigid })
}

fn read_boards(
    tables: Vec<Spanned<BoardTable>>,
    at: &dyn Fn(std::ops::Range<usize>) -> Place,
) -> Result<Vec<Board>, Error> {
    let mut boards: Vec<Board> = Vec::new();
    for table in tables {
        let span = table.span();
        let BoardTable { name, kind, columns, rows, spacing_m, file, corners } = table.into_inner();
        let is_taken = |name: &str| name == TARGET_NAME || boards.iter().any(|board| board.name == name);
        if name.as_ref().is_empty() || is_taken(name.as_ref()) {
            let message = format!("there are two targets with the name `{}`", name.as_ref());
            let fix = format!("names of boards are unique, and `{TARGET_NAME}` is that of [target]");
            return Err(wrong(at(name.span()), &message, Some(&fix)));
        }
        if corners.is_empty() {
            let message = format!("board `{}` has no corners", name.as_ref());
            return Err(wrong(at(name.span()), &message, Some("write corners = [\"wall.csv\"]")));
        }
        let table = TargetTable { kind, columns, rows, spacing_m, file };
        let target = read_target(&Spanned::new(span, table), at)?;
        boards.push(Board { name: name.into_inner(), target, corners });
    }
    Ok(boards)
}

fn read_target(
    table: &Spanned<TargetTable>,
    at: &dyn Fn(std::ops::Range<usize>) -> Place,
) -> Result<TargetDescription, Error> {
    const EXAMPLE: &str = "write columns, rows (inner corners) and spacing_m (in metres)";
    let TargetTable { kind, columns, rows, spacing_m, file } = table.as_ref();
    let surplus = |name: &str| {
        let message = format!("`{name}` does not belong to a target of kind `{}`", kind.as_ref());
        Err(wrong(at(table.span()), &message, None))
    };
    match kind.as_ref().as_str() {
        "chessboard" => {
            if file.is_some() {
                return surplus("file");
            }
            let missing = |name: &str| {
                let message = format!("[target] of kind `chessboard` has no `{name}`");
                wrong(at(table.span()), &message, Some(EXAMPLE))
            };
            let columns = columns.ok_or_else(|| missing("columns"))?;
            let rows = rows.ok_or_else(|| missing("rows"))?;
            let spacing_m = spacing_m.as_ref().ok_or_else(|| missing("spacing_m"))?;
            let target = chessboard(columns, rows, *spacing_m.as_ref())
                .map_err(|why| wrong(at(spacing_m.span()), &why, Some(EXAMPLE)))?;
            Ok(TargetDescription::Here(target))
        }
        "points" => {
            for (name, given) in
                [("columns", columns.is_some()), ("rows", rows.is_some()), ("spacing_m", spacing_m.is_some())]
            {
                if given {
                    return surplus(name);
                }
            }
            let message = "[target] of kind `points` has no `file`";
            let fix = "write file = \"points.csv\", with the columns id,x_m,y_m,z_m";
            let file = file.clone().ok_or_else(|| wrong(at(table.span()), message, Some(fix)))?;
            Ok(TargetDescription::Points(file))
        }
        // Any target can be written as on the command line.
        spec if spec.contains(':') => {
            let given = [columns.is_some(), rows.is_some(), spacing_m.is_some(), file.is_some()];
            let names = ["columns", "rows", "spacing_m", "file"];
            if let Some((name, _)) = names.iter().zip(given).find(|(_, given)| *given) {
                return surplus(name);
            }
            let target = crate::parse_target(spec)
                .map_err(|error| wrong(at(kind.span()), &error.to_string(), error.hint().as_deref()))?;
            Ok(TargetDescription::Here(target))
        }
        other => {
            let known = ["chessboard", "points"];
            let message = format!(
                "there is no target kind `{other}`; known: {}, and targets as --target takes them",
                known.join(", ")
            );
            let fix = match closest(other, known.into_iter()) {
                Some(meant) => format!("did you mean `{meant}`?"),
                None => {
                    "write a target in a line, such as kind = \"charuco:14x9:40mm:30mm:5x5_1000\"".to_owned()
                }
            };
            Err(wrong(at(kind.span()), &message, Some(&fix)))
        }
    }
}

/// Turns an error of the TOML reader into one with a line and, for a mistyped key, a proposal.
pub(crate) fn explain(file: &str, bytes: &[u8], error: &toml::de::Error) -> Error {
    let place = match error.span() {
        Some(span) => Place::line(file, line_of(bytes, span.start)),
        None => Place::file(file),
    };
    let message = error.message().lines().next().unwrap_or_default().to_owned();
    let mut words = message.split('`').skip(1).step_by(2);
    let fix = if message.starts_with("unknown field") {
        let typed = words.next().unwrap_or_default();
        closest(typed, words).map(|meant| format!("did you mean `{meant}`?"))
    } else if message.contains("missing field `image_size`") {
        Some("write image_size = [width, height] in pixels".to_owned())
    } else {
        None
    };
    Error::Config { place, message, fix }
}

fn wrong(place: Place, message: &str, fix: Option<&str>) -> Error {
    Error::Config { place, message: message.to_owned(), fix: fix.map(str::to_owned) }
}

fn line_of(bytes: &[u8], at: usize) -> usize {
    1 + bytes[..at.min(bytes.len())].iter().filter(|&&byte| byte == b'\n').count()
}

/// Returns the name of a job file within its folder.
pub(crate) fn name_of(path: &Path) -> String {
    path.file_name().map_or_else(|| path.display().to_string(), |name| name.to_string_lossy().into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: &str = r#"
[target]
kind = "chessboard"
columns = 9
rows = 6
spacing_m = 0.025

[[camera]]
name = "left"
image_size = [640, 480]

[input]
corners = ["a.csv"]
sigma_px = 0.5

[options]
model = "opencv5"
"#;

    fn refuses(from: &str, to: &str, parts: &[&str]) {
        assert!(GOOD.contains(from));
        let error = read_job_file("job.toml", GOOD.replace(from, to).as_bytes()).unwrap_err();
        let message = format!("{error}; {}", error.hint().unwrap_or_default());
        for part in parts {
            assert!(message.contains(part), "`{part}` is not in: {message}");
        }
    }

    #[test]
    fn a_job_file_is_read() {
        let job = read_job_file("job.toml", GOOD.as_bytes()).unwrap();
        assert_eq!(job.cameras[0].image_size, [640, 480]);
        assert_eq!((job.corners, job.sigma_px), (vec!["a.csv".to_owned()], Some(0.5)));
        assert_eq!(job.options["model"].as_str(), Some("opencv5"));
        let Some(TargetDescription::Here(target)) = job.target else { panic!() };
        assert_eq!(target, crate::parse_target("chessboard:9x6:25mm").unwrap());
    }

    #[test]
    fn mistakes_are_named_with_their_line() {
        refuses("columns", "colums", &["job.toml:4", "unknown field `colums`", "did you mean `columns`?"]);
        refuses("[input]", "[inputs]", &["job.toml:12", "did you mean `input`?"]);
        refuses("columns = 9", "columns = \"9\"", &["job.toml:4", "invalid type"]);
        refuses("columns = 9", "columns = 1", &["columns = 1", "at least 2"]);
        refuses("columns = 9\n", "", &["job.toml:2", "no `columns`"]);
        refuses("columns = 9", "columns = ", &["job.toml:4"]);
        refuses("0.025", "25", &["job.toml:6", "25 m", "were millimetres meant? Then it is 0.025 m"]);
        refuses("0.025", "0.00001", &["job.toml:6", "which unit"]);
        refuses(
            "image_size = [640, 480]",
            "",
            &["job.toml:8", "missing field `image_size`", "[width, height]"],
        );
        refuses("[640, 480]", "[640, 0]", &["job.toml:10", "[640, 0]"]);
        refuses("[640, 480]", "[640]", &["job.toml:10"]);
        refuses(
            "\"chessboard\"",
            "\"chesboard\"",
            &["job.toml:3", "known: chessboard, points", "did you mean"],
        );
        refuses("\"left\"", "\"../left\"", &["job.toml:9", "without /"]);
        refuses(
            "[input]",
            "[[camera]]\nname = \"left\"\nimage_size = [1, 1]\n[input]",
            &["job.toml:13", "two cameras"],
        );
        refuses("sigma_px = 0.5", "images = [\"a\"]", &["job.toml", "more than one of corners, images"]);
        refuses("sigma_px = 0.5", "clock = \"sun\"", &["job.toml:14", "clock is `sun`"]);
        refuses("sigma_px = 0.5", "sync_tolerance_ms = -1.0", &["job.toml:14", "sync_tolerance_ms is -1"]);
        refuses("sigma_px = 0.5", "sigma_px = -1.0", &["job.toml:14", "sigma_px is -1"]);
        refuses(
            "corners = [\"a.csv\"]",
            "recordings = [\"a\"]\nframe_times = \"t\"",
            &["times of their own"],
        );
        let board = |keys: &str| format!("[[board]]\n{keys}\n[input]");
        let wall = "kind = \"chessboard:3x2:1cm\"\ncorners = [\"w.csv\"]";
        refuses("[input]", &board(&format!("name = \"target\"\n{wall}")), &["job.toml:13", "two targets"]);
        refuses("[input]", &board(&format!("nam = \"wall\"\n{wall}")), &["job.toml:13", "`name`?"]);
        let without = "name = \"wall\"\nkind = \"chessboard:3x2:1cm\"\ncorners = []";
        refuses("[input]", &board(without), &["job.toml:13", "board `wall` has no corners"]);
        refuses("rows = 6", "rows = 6\nfile = \"x\"", &["`file` does not belong"]);
    }

    #[test]
    fn points_are_read() {
        let text = "x_m,id,y_m,z_m\n1,1,2,3\n0,0,0,0\n\n4,2,5,6\n";
        let target = read_points("p.csv", text.as_bytes()).unwrap();
        let points_m = vec![[0.0; 3], [1.0, 2.0, 3.0], [4.0, 5.0, 6.0]];
        assert_eq!(target.geometry, Geometry::Points { points_m });
        for (text, part) in [
            ("", "p.csv: the file is empty"),
            ("id,x,y,z\n", "p.csv:1: the header `id,x,y,z` has no column `x_m`"),
            ("id,x_m,y_m,z_m\n0,0,0\n", "p.csv:2: the line has 3 columns"),
            ("id,x_m,y_m,z_m\n0,0,nan,0\n", "p.csv:2: y_m is `nan`"),
            ("id,x_m,y_m,z_m\n0,0,0,0\n0,1,1,1\n", "p.csv:3: point 0 follows point 0"),
            ("id,x_m,y_m,z_m\n0,0,0,0\n1,1,1,1\n", "at least 3 points"),
        ] {
            let error = read_points("p.csv", text.as_bytes()).unwrap_err().to_string();
            assert!(error.contains(part), "`{part}` is not in: {error}");
        }
    }
}
