//! What can be told of a dataset before any solve, in numbers.

use boresight_data::{Calibration, CameraId, Dataset};

use crate::findings::{Case, coverage, largest_board, middle_sigma_px, tilt_spread_rad, weakest_link};

/// What cameras saw, before any solve.
#[derive(Clone, Debug, PartialEq)]
pub struct Looks {
    /// Of each camera of the dataset.
    pub cameras: Vec<CameraLook>,
    /// Where the rig hangs together by the fewest frames; `None` for a single camera.
    pub weakest_link: Option<WeakestLink>,
}

/// What a camera saw.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraLook {
    /// The camera.
    pub camera: CameraId,
    /// Its views that can be used.
    pub views: usize,
    /// The corners in these.
    pub corners: usize,
    /// The share of the image in which corners were seen: of 10 x 10 cells, those that the lens reaches.
    pub coverage: Option<f64>,
    /// The largest angle between the normals of any two boards, in radians.
    pub tilt_spread_rad: Option<f64>,
    /// The share of the image's diagonal that the board spans where it spans most.
    pub largest_board: Option<f64>,
    /// The sigma of a corner in the middle view, in pixels; `None` if images did not tell.
    pub sigma_px: Option<f64>,
}

/// The cameras that hang on the others by the fewest frames.
#[derive(Clone, Debug, PartialEq)]
pub struct WeakestLink {
    /// These cameras ...
    pub cameras: Vec<CameraId>,
    /// ... share so many frames with the others.
    pub frames: usize,
}

/// Returns what cameras saw; `start` says where targets were as far as a start can tell.
pub fn looks(dataset: &Dataset, start: &Calibration) -> Looks {
    let case = Case::new(dataset, start);
    let look = |camera: CameraId| CameraLook {
        camera,
        views: case.used_views_of(camera).count(),
        corners: case.used_views_of(camera).map(|used| used.view.observations.len()).sum(),
        coverage: coverage(&case, camera),
        tilt_spread_rad: tilt_spread_rad(&case, camera),
        largest_board: largest_board(&case, camera),
        sigma_px: middle_sigma_px(&case, camera),
    };
    let weakest_link = weakest_link(&case).map(|(cameras, frames)| WeakestLink { cameras, frames });
    Looks { cameras: dataset.cameras.ids().map(look).collect(), weakest_link }
}
