//! What can be wrong with a file, as facts: file, line, value, limit, and what to do about it.

use std::fmt;

/// Who has to act on an error; the command line maps it to its exit codes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// The command line or the job file asks for something that cannot be.
    Usage,
    /// An input file cannot be used.
    Input,
    /// A result cannot be written.
    CannotWrite,
}

/// A file and, where known, a line in it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Place {
    /// The file as the caller named it.
    pub file: String,
    /// The line, counted from 1.
    pub line: Option<usize>,
}

impl Place {
    /// Returns the place of a whole file.
    pub fn file(file: impl Into<String>) -> Self {
        Self { file: file.into(), line: None }
    }

    /// Returns the place of a line, counted from 1.
    pub fn line(file: impl Into<String>, line: usize) -> Self {
        Self { file: file.into(), line: Some(line) }
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.line {
            Some(line) => write!(f, "{}:{line}", self.file),
            None => f.write_str(&self.file),
        }
    }
}

/// What can be wrong with a file or with what it says.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file cannot be read.
    #[error("{file}: cannot be read: {source}")]
    Read {
        /// The file.
        file: String,
        /// What the system says.
        source: std::io::Error,
    },
    /// An image cannot be decoded.
    #[error("{file}: the image cannot be used: {why}")]
    Image {
        /// The file.
        file: String,
        /// What the decoder says.
        why: String,
    },
    /// The target was not detected in any image.
    #[error("the target ({target}) was detected in none of {images} images: {why}")]
    NothingDetected {
        /// The target in words.
        target: String,
        /// How many images were looked at.
        images: usize,
        /// What was said of most of them.
        why: String,
        /// How a target is declared that has the size which is seen in most of them.
        seen: Option<String>,
    },
    /// A recording holds no images.
    #[error("{file}: there are no images in it; {}", topics_in_words(topics))]
    NoImageTopic {
        /// The recordings.
        file: String,
        /// The topics there are, each with its schema and its encoding.
        topics: Vec<String>,
    },
    /// A file cannot be written.
    #[error("{file}: cannot be written: {source}")]
    Write {
        /// The file.
        file: String,
        /// What the system says.
        source: std::io::Error,
    },
    /// A number that is to be written is not finite.
    #[error("{at} is {value}: only finite numbers are written")]
    NotFinite {
        /// Which number.
        at: String,
        /// Its value.
        value: f64,
    },
    /// A calibration is not of one piece.
    #[error("a calibration with {found} {what} cannot be written; {need} are needed")]
    Inconsistent {
        /// Of what.
        what: &'static str,
        /// How many there are.
        found: usize,
        /// How many belong there.
        need: usize,
    },
    /// A format has no way to say what a calibration says.
    #[error("format {format} cannot carry {what} of camera {camera}")]
    CannotCarry {
        /// The format's name.
        format: &'static str,
        /// The camera's name.
        camera: String,
        /// What it cannot carry, such as "lens model kannala-brandt4".
        what: String,
        /// The formats that can.
        instead: Vec<&'static str>,
    },
    /// No format has this name, or none reads this file.
    #[error("there is no format `{name}`; known: {}", known.join(", "))]
    UnknownFormat {
        /// The name asked for.
        name: String,
        /// The names that exist.
        known: Vec<&'static str>,
    },
    /// A file is in no format that is known.
    #[error("{file}: this is no calibration in a known format ({})", known.join(", "))]
    Unrecognized {
        /// The file.
        file: String,
        /// The formats that are read.
        known: Vec<&'static str>,
    },
    /// A file is empty.
    #[error("{file}: the file is empty")]
    Empty {
        /// The file.
        file: String,
    },
    /// A file has a header and nothing else.
    #[error("{file}: no corner was found in the {lines} lines of the file")]
    NoCorners {
        /// The file.
        file: String,
        /// The number of lines it has.
        lines: usize,
    },
    /// A file is not written as its format demands.
    #[error("{place}: {found}; {need}")]
    Malformed {
        /// Where.
        place: Place,
        /// What is there.
        found: String,
        /// What the format needs there.
        need: &'static str,
    },
    /// A column is missing from a header, or there is no header.
    #[error("{place}: the header `{header}` has no column `{missing}`")]
    Header {
        /// Where.
        place: Place,
        /// The first line of the table.
        header: String,
        /// The column that is missing.
        missing: &'static str,
        /// What a header looks like.
        example: &'static str,
    },
    /// A column is missing from a robot's table.
    #[error("{file}: the header `{header}` has no column {}", missing.join(" or "))]
    TableColumn {
        /// The file.
        file: String,
        /// The first line of the table.
        header: String,
        /// The names that the column may have.
        missing: Vec<String>,
        /// What a header looks like.
        example: &'static str,
    },
    /// A line has too few or too many columns.
    #[error("{place}: the line has {found} columns, the header {need}")]
    ColumnCount {
        /// Where.
        place: Place,
        /// How many it has.
        found: usize,
        /// How many the header names.
        need: usize,
        /// Whether it is the last line and does not end in a newline.
        cut_off: bool,
    },
    /// A value is not what it has to be.
    #[error("{place}: {column} is `{value}`: {need}")]
    BadValue {
        /// Where.
        place: Place,
        /// The column, key or path of the value.
        column: String,
        /// The value.
        value: String,
        /// What it must be.
        need: String,
    },
    /// A camera is named that the job does not list.
    #[error("{place}: unknown camera `{name}`; the job lists {}", known.join(", "))]
    UnknownCamera {
        /// Where.
        place: Place,
        /// The name.
        name: String,
        /// The cameras that the job lists.
        known: Vec<String>,
    },
    /// The target has no such point.
    #[error("{place}: point {point} does not exist: the target ({target}) has points 0 to {}", points.saturating_sub(1))]
    PointOutOfRange {
        /// Where.
        place: Place,
        /// The point.
        point: u64,
        /// The number of points of the target.
        points: usize,
        /// The target in words, such as "9x6 inner corners".
        target: String,
    },
    /// A point is seen twice in one view.
    #[error("{place}: point {point} appears a second time in view {view} of camera {camera}")]
    DuplicatePoint {
        /// Where it appears again.
        place: Place,
        /// The point.
        point: u32,
        /// The camera.
        camera: String,
        /// The view.
        view: String,
    },
    /// Two images claim to be the same camera's view of the same frame.
    #[error("{place}: frame {frame} of camera {camera} is given twice: by `{first}` and by `{second}`")]
    DuplicateView {
        /// Where it appears again.
        place: Place,
        /// The frame.
        frame: String,
        /// The camera.
        camera: String,
        /// The image, or file, that gave it first.
        first: Box<str>,
        /// The image, or file, that gives it again.
        second: Box<str>,
    },
    /// Coordinates in the file are not those of the target's grid.
    #[error(
        "{place}: point {point} has {column} = {value}, but on a grid of {}x{} (columns x rows) it has {column} = {expected}",
        grid[0], grid[1]
    )]
    GridMismatch {
        /// Where.
        place: Place,
        /// The column, X, Y or Z.
        column: char,
        /// The point.
        point: u32,
        /// What the file says, in squares (or metres, for a target given as points).
        value: f64,
        /// What the target says.
        expected: f64,
        /// Columns and rows of the target.
        grid: [u32; 2],
        /// Columns and rows that the file was made with, where they can be told.
        file_grid: Option<[u32; 2]>,
    },
    /// An image has another number of corners than the target.
    #[error("{place}: image {image} has {found} corners, a grid of {}x{} has {}", grid[0], grid[1], grid[0] * grid[1])]
    CornerCount {
        /// The first line of the image.
        place: Place,
        /// The image.
        image: String,
        /// The number of corners it has.
        found: usize,
        /// Columns and rows of the target.
        grid: [u32; 2],
        /// Whether the images before it have the right number.
        others_fit: bool,
    },
    /// Pixels lie far outside the image.
    #[error(
        "camera {camera}: image_size is {}x{} but pixels reach ({:.0}, {:.0}): {outside} of {total} lie outside the image",
        image_size[0], image_size[1], reach[0], reach[1]
    )]
    ImageSize {
        /// The camera.
        camera: String,
        /// Width and height of its image in pixels.
        image_size: [u32; 2],
        /// The largest u and v in pixels.
        reach: [f64; 2],
        /// How many pixels lie outside by more than 10 %.
        outside: usize,
        /// How many there are.
        total: usize,
    },
    /// The size of a camera's image is not known.
    #[error("camera {camera}: the size of its image is not known")]
    NoImageSize {
        /// The camera.
        camera: String,
    },
    /// Image names do not tell which camera took them.
    #[error("{file}: the image names do not tell which camera took them: {why}")]
    AmbiguousNames {
        /// The file.
        file: String,
        /// Why, with an example.
        why: String,
    },
    /// A job file, or an option in its place, says something that cannot be.
    #[error("{place}: {message}")]
    Config {
        /// Where.
        place: Place,
        /// What is wrong.
        message: String,
        /// What to do.
        fix: Option<String>,
    },
    /// A target specification cannot be understood.
    #[error("target `{spec}`: {why}")]
    TargetSpec {
        /// The specification.
        spec: String,
        /// What is wrong with it.
        why: String,
    },
    /// A file has a schema of a later version.
    #[error("{file}: its schema is {found}; Boresight {version} reads {reads}", version = env!("CARGO_PKG_VERSION"))]
    Schema {
        /// The file.
        file: String,
        /// The schema it has.
        found: String,
        /// The schema that is read.
        reads: &'static str,
    },
    /// A file holds a camera that no lens has.
    #[error("{place}: camera {camera}: {source}")]
    Lens {
        /// Where.
        place: Place,
        /// The camera.
        camera: String,
        /// What is wrong with it.
        source: Box<boresight_camera::Error>,
    },
    /// A file claims more than is read.
    #[error("{file}: {found} {what}; at most {limit} are read")]
    TooMany {
        /// The file.
        file: String,
        /// Of what.
        what: &'static str,
        /// How many there are.
        found: usize,
        /// How many are read.
        limit: usize,
    },
}

impl Error {
    /// Returns who has to act.
    pub fn kind(&self) -> Kind {
        match self {
            Error::Write { .. } | Error::NotFinite { .. } | Error::Inconsistent { .. } => Kind::CannotWrite,
            Error::CannotCarry { .. }
            | Error::UnknownFormat { .. }
            | Error::NoImageSize { .. }
            | Error::ImageSize { .. }
            | Error::GridMismatch { .. }
            | Error::CornerCount { others_fit: false, .. }
            | Error::AmbiguousNames { .. }
            | Error::Config { .. }
            | Error::TargetSpec { .. } => Kind::Usage,
            _ => Kind::Input,
        }
    }

    /// Returns what to do about it, where that is not obvious.
    pub fn hint(&self) -> Option<String> {
        let text = |text: &str| Some(text.to_owned());
        match self {
            Error::CannotCarry { instead, .. } if instead.is_empty() => None,
            Error::CannotCarry { format: "kalibr" | "ros", instead, .. } => Some(format!(
                "exchange the lens: boresight convert RESULT --model opencv4 -o DIR; or take another format: {}",
                instead.join(", ")
            )),
            Error::CannotCarry { instead, .. } => Some(format!("these formats can: {}", instead.join(", "))),
            Error::TableColumn { example, .. } => {
                Some(format!("names of columns have their units, such as `{example}`"))
            }
            Error::Header { example, .. } => {
                Some(format!("the first line must name the columns, such as `{example}`"))
            }
            Error::ColumnCount { cut_off: true, .. } => {
                text("it is the last line and does not end: the file was cut off; write or copy it again")
            }
            Error::UnknownCamera { name, known, .. } => {
                Some(match closest(name, known.iter().map(String::as_str)) {
                    Some(meant) => format!(
                        "did you mean `{meant}`? Otherwise add a [[camera]] with this name to the job"
                    ),
                    None => "add a [[camera]] with this name to the job, or rename it in the file".to_owned(),
                })
            }
            Error::PointOutOfRange { .. } => {
                text("points count from 0, row by row; do columns and rows of the target match the board?")
            }
            Error::GridMismatch { file_grid: Some([columns, rows]), .. } => {
                Some(format!("the file is {columns}x{rows}: write columns = {columns}, rows = {rows}"))
            }
            Error::GridMismatch { .. } => {
                text("X, Y, Z count squares: point row * columns + column is at (column, row, 0)")
            }
            Error::CornerCount { others_fit: true, .. } => text(
                "the images before it fit: was the file cut off? A missing corner is a line with `-` as its level",
            ),
            Error::CornerCount { found, grid, .. } => Some(likely_grids(*found, *grid)),
            Error::ImageSize { .. } => text("is image_size right?"),
            Error::NoImageSize { camera } => Some(format!(
                "add `[[camera]] name = \"{camera}\" image_size = [width, height]` to the job file (in pixels)"
            )),
            Error::AmbiguousNames { .. } => text(
                "add a pattern to each [[camera]] of the job, such as images = \"*-cam0.png\"; the part matched by * is the frame",
            ),
            Error::Config { fix, .. } => fix.clone(),
            Error::TargetSpec { .. } => text(
                "write chessboard:9x6:25mm (inner corners), charuco:14x9:40mm:30mm:5x5_1000 (squares, side of square and marker, dictionary), aprilgrid:6x6:88mm:0.3 (tags, side, gap as a share), circles:7x6:20mm or acircles:4x11:20mm",
            ),
            Error::Schema { .. } => text("a newer Boresight wrote it; read it with that, or update"),
            Error::NoImageTopic { .. } => text(
                "images are read as sensor_msgs Image and CompressedImage, and as foxglove RawImage and CompressedImage",
            ),
            Error::NothingDetected { seen: Some(spec), .. } => {
                let count =
                    if spec.starts_with("chessboard") { "; count inner corners, not squares" } else { "" };
                Some(format!("declare it as `--target {spec}` if that is the board{count}"))
            }
            Error::NothingDetected { .. } => text(
                "do columns and rows count inner corners, and does the whole board with its white rim show in the images?",
            ),
            Error::DuplicateView { .. } => text("a camera sees each frame once; are the frame names unique?"),
            _ => None,
        }
    }
}

/// Lists topics, or says that there are none.
fn topics_in_words(topics: &[String]) -> String {
    const SHOWN: usize = 8;
    let more = if topics.len() > SHOWN { ", ..." } else { "" };
    match topics {
        [] => "it has no topics".to_owned(),
        topics => format!("its topics are {}{more}", topics[..topics.len().min(SHOWN)].join(", ")),
    }
}

/// Says which grids have this many corners.
fn likely_grids(corners: usize, grid: [u32; 2]) -> String {
    let mut pairs: Vec<(usize, usize)> = (3..=corners.isqrt())
        .filter(|rows| corners.is_multiple_of(*rows))
        .map(|rows| (corners / rows, rows))
        .filter(|(columns, rows)| *columns <= 8 * rows)
        .collect();
    pairs.reverse();
    let swap = grid[1] > grid[0];
    let list: Vec<String> =
        pairs.iter().map(|&(a, b)| if swap { format!("{b}x{a}") } else { format!("{a}x{b}") }).collect();
    if list.is_empty() {
        format!("{corners} corners fill no grid: was the file cut off?")
    } else {
        format!("{corners} corners are {}: is that the board (columns x rows)?", list.join(" or "))
    }
}

/// Returns the candidate that a mistyped word most likely meant.
pub(crate) fn closest<'a>(word: &str, candidates: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    let limit = (word.chars().count() / 3).max(1);
    candidates
        .map(|candidate| (edits(word, candidate), candidate))
        .filter(|(n, _)| *n <= limit)
        .min()
        .map(|(_, c)| c)
}

/// Returns the number of edits (insert, delete, replace, swap neighbours) between two words.
fn edits(a: &str, b: &str) -> usize {
    let (a, b): (Vec<char>, Vec<char>) = (a.chars().take(64).collect(), b.chars().take(64).collect());
    let mut rows = vec![vec![0; b.len() + 1]; a.len() + 1];
    for (i, row) in rows.iter_mut().enumerate() {
        row[0] = i;
    }
    rows[0] = (0..=b.len()).collect();
    for i in 1..=a.len() {
        for j in 1..=b.len() {
            let replace = rows[i - 1][j - 1] + usize::from(a[i - 1] != b[j - 1]);
            rows[i][j] = replace.min(rows[i - 1][j] + 1).min(rows[i][j - 1] + 1);
            if i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1] {
                rows[i][j] = rows[i][j].min(rows[i - 2][j - 2] + 1);
            }
        }
    }
    rows[a.len()][b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn typing_errors_are_recognised() {
        let known = ["columns", "rows", "spacing_m"];
        for (typed, meant) in [
            ("colums", Some("columns")),
            ("row", Some("rows")),
            ("spacing_mm", Some("spacing_m")),
            ("spaicng_m", Some("spacing_m")),
            ("kind", None),
        ] {
            assert_eq!(closest(typed, known.into_iter()), meant, "{typed}");
        }
    }

    #[test]
    fn grids_are_guessed_from_the_number_of_corners() {
        assert_eq!(
            likely_grids(48, [9, 6]),
            "48 corners are 8x6 or 12x4 or 16x3: is that the board (columns x rows)?"
        );
        assert_eq!(
            likely_grids(48, [6, 9]),
            "48 corners are 6x8 or 4x12 or 3x16: is that the board (columns x rows)?"
        );
        assert!(likely_grids(53, [9, 6]).contains("cut off"));
    }
}
