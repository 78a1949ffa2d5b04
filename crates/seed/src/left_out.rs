//! What a seed could not use, as facts with numbers.

use boresight_data::{CameraId, Dataset, FrameId, TargetId};

/// Something of the dataset that the seed leaves out, and why.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum LeftOut {
    /// A camera has too few usable views to be calibrated.
    TooFewViews {
        /// The camera.
        camera: CameraId,
        /// How many of its views are usable.
        found: usize,
        /// How many it takes.
        need: usize,
    },
    /// No lens explains a camera's views.
    NoLens {
        /// The camera.
        camera: CameraId,
        /// The number of usable views.
        views: usize,
    },
    /// A camera shares no frame with the largest group of connected cameras.
    Unconnected {
        /// The camera.
        camera: CameraId,
        /// The number of its usable views.
        views: usize,
        /// The number of cameras in the group that was kept.
        kept: usize,
    },
    /// A view has too few usable points.
    TooFewPoints {
        /// The view, as an index into the dataset's views.
        view_idx: usize,
        /// How many points it has.
        found: usize,
        /// How many it takes.
        need: usize,
    },
    /// The points of a view lie on a line, on the target or in the image.
    Collinear {
        /// The view, as an index into the dataset's views.
        view_idx: usize,
        /// The ratio of the points' standard deviations across and along the line.
        thinness: f64,
    },
    /// No pose brings the target in front of the camera with these pixels.
    NoPose {
        /// The view, as an index into the dataset's views.
        view_idx: usize,
    },
    /// The best pose found leaves most of the view's points far from their pixels.
    BadFit {
        /// The view, as an index into the dataset's views.
        view_idx: usize,
        /// The median length of its residuals in sigmas.
        median_sigmas: f64,
        /// The limit, which follows from the camera's other views.
        limit_sigmas: f64,
    },
    /// The seed has points of the view where the lens cannot see them.
    OutOfSight {
        /// The view, as an index into the dataset's views.
        view_idx: usize,
        /// How many points.
        points: usize,
    },
    /// A view's target was never seen in a frame together with the others.
    UnconnectedTarget {
        /// The view, as an index into the dataset's views.
        view_idx: usize,
        /// The target.
        target: TargetId,
    },
}

impl LeftOut {
    /// Returns the view that was left out, or `None` for a camera.
    pub fn view_idx(&self) -> Option<usize> {
        match *self {
            Self::TooFewViews { .. } | Self::NoLens { .. } | Self::Unconnected { .. } => None,
            Self::TooFewPoints { view_idx, .. }
            | Self::Collinear { view_idx, .. }
            | Self::NoPose { view_idx }
            | Self::BadFit { view_idx, .. }
            | Self::OutOfSight { view_idx, .. }
            | Self::UnconnectedTarget { view_idx, .. } => Some(view_idx),
        }
    }

    /// Returns a sentence that names camera, frame and numbers.
    pub fn describe(&self, dataset: &Dataset) -> String {
        let camera = |id: CameraId| dataset.cameras.get(id).map_or("?", |camera| camera.name.as_str());
        let frame = |id: FrameId| dataset.frames.get(id).map_or("?", |frame| frame.name.as_str());
        let place = |view_idx: usize| match dataset.views.get(view_idx) {
            Some(view) => format!("camera {}, frame {}", camera(view.camera), frame(view.frame)),
            None => format!("view {view_idx}"),
        };
        match *self {
            Self::TooFewViews { camera: id, found, need } => {
                format!("camera {} has {found} usable views; {need} are needed", camera(id))
            }
            Self::NoLens { camera: id, views } => {
                format!("no lens explains the {views} usable views of camera {}", camera(id))
            }
            Self::Unconnected { camera: id, views, kept } => format!(
                "camera {} shares no frame with the {kept} cameras that were kept; it has {views} usable views",
                camera(id)
            ),
            Self::TooFewPoints { view_idx, found, need } => {
                format!("{}: {found} usable points; {need} are needed", place(view_idx))
            }
            Self::Collinear { view_idx, thinness } => format!(
                "{}: the points lie on a line; their spread across it is {thinness:.1e} of that along it",
                place(view_idx)
            ),
            Self::NoPose { view_idx } => {
                format!(
                    "{}: no pose puts the target in front of the camera with these pixels",
                    place(view_idx)
                )
            }
            Self::BadFit { view_idx, median_sigmas, limit_sigmas } => format!(
                "{}: the best pose leaves a median residual of {median_sigmas:.1} sigmas; the limit is \
                 {limit_sigmas:.1}",
                place(view_idx)
            ),
            Self::OutOfSight { view_idx, points } => {
                format!("{}: the lens cannot see {points} of the points where they must be", place(view_idx))
            }
            Self::UnconnectedTarget { view_idx, target } => format!(
                "{}: target {} was never seen together with the others",
                place(view_idx),
                dataset.targets.get(target).map_or("?", |target| target.name.as_str())
            ),
        }
    }
}
