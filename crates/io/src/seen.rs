//! What a corner file says, before cameras and frames have ids.

use boresight_data::{Geometry, Observation, Target};

/// The most images of one file, and the most points of a target, that are read.
pub(crate) const LIMIT: usize = 10_000_000;

/// A corner file's contents.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct SeenFile {
    /// The file as the caller named it.
    pub file: String,
    /// Which of the job's targets its points are of.
    pub target_idx: usize,
    /// What it says of each image.
    pub views: Vec<SeenView>,
    /// How many corners were given as (-1, -1), and the line of the first.
    pub minus_one: Option<(usize, usize)>,
    /// Whether the last line does not end.
    pub cut_off: bool,
}

/// The corners of one image.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct SeenView {
    /// The camera, where the file names it.
    pub camera: Option<String>,
    /// The frame, where the file names it.
    pub frame: Option<String>,
    /// The image, where the file names it.
    pub image: Option<String>,
    /// The line of its first corner, counted from 1.
    pub line: usize,
    /// The corners in increasing order of their points.
    pub observations: Vec<Observation>,
}

/// Describes a target for a message, such as "9x6 inner corners".
pub(crate) fn describe(target: &Target) -> String {
    match &target.geometry {
        Geometry::Chessboard { columns, rows, .. } => format!("{columns}x{rows} inner corners"),
        Geometry::Charuco { columns, rows, dictionary, .. } => {
            format!("{columns}x{rows} squares with markers of {}", dictionary.name())
        }
        Geometry::AprilGrid { columns, rows, dictionary, .. } => {
            format!("{columns}x{rows} tags of {}", dictionary.name())
        }
        Geometry::Circles { columns, rows, .. } => format!("{columns}x{rows} circles"),
        Geometry::Points { points_m } => format!("{} points", points_m.len()),
    }
}

/// Tells whether a pixel is OpenCV's mark of a missing corner.
pub(crate) fn is_missing(pixel: [f64; 2]) -> bool {
    pixel == [-1.0, -1.0]
}
