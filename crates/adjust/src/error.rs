//! What can keep a dataset from being adjusted.

use boresight_data::{CameraId, FrameId, PointId, TargetId};

/// Why a dataset was not adjusted.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The seed has no camera at all.
    #[error("no camera has a seed; {views} views are left out")]
    NoCamera {
        /// The number of views in the dataset.
        views: usize,
    },
    /// The seed is of another dataset.
    #[error("the seed has {found} {what}, the dataset has {need}")]
    SeedMismatch {
        /// What is counted.
        what: &'static str,
        /// How many the seed has.
        found: usize,
        /// How many the dataset has.
        need: usize,
    },
    /// A view names something that the dataset does not have.
    #[error(
        "view {view_idx} names camera {camera}, frame {frame}, target {target}; one of them does not exist"
    )]
    DanglingView {
        /// The view.
        view_idx: usize,
        /// Its camera.
        camera: CameraId,
        /// Its frame.
        frame: FrameId,
        /// Its target.
        target: TargetId,
    },
    /// An observation has a sigma that is not positive.
    #[error(
        "observation {observation_idx} of view {view_idx} has a sigma of {sigma_px} px; it must be positive"
    )]
    BadSigma {
        /// The view.
        view_idx: usize,
        /// The observation.
        observation_idx: usize,
        /// Its sigma.
        sigma_px: f64,
    },
    /// A touch is of a point that does not exist, or nobody knows how good it is.
    #[error(
        "touch {touch_idx} (counted from 0) is of point {point} of target {target}, which no camera sees or which does not exist, or its sigma of {sigma_m} m is not positive"
    )]
    BadTouch {
        /// The touch.
        touch_idx: usize,
        /// Its target.
        target: TargetId,
        /// Its point.
        point: PointId,
        /// Its sigma in metres, in units of the pixels'.
        sigma_m: f64,
    },
    /// There are fewer equations than unknowns.
    #[error(
        "{rows} equations for {unknowns} unknowns: more views are needed, or a lens model with fewer parameters"
    )]
    TooFewEquations {
        /// The number of equations.
        rows: usize,
        /// The number of unknowns.
        unknowns: usize,
    },
    /// A view of the seed lies outside its lens's domain.
    #[error("the seed puts points of view {view_idx} where the lens cannot see them")]
    SeedOutOfView {
        /// The view.
        view_idx: usize,
    },
    /// A lens of many parameters is seen through a robot's poses, where its sums have no place yet.
    #[error(
        "camera {camera} has a {model} lens, which cannot be adjusted with a robot's poses: take a lens of few \
         parameters"
    )]
    LocalLensOnRobot {
        /// The camera.
        camera: CameraId,
        /// Its lens model.
        model: &'static str,
    },
    /// A lens of many parameters sees a moving target row by row, where its sums have no place.
    #[error(
        "camera {camera} has a {model} lens, which cannot be adjusted with a line delay while the target moves: take a lens \
         of few parameters"
    )]
    LocalLensRolling {
        /// The camera.
        camera: CameraId,
        /// Its lens model.
        model: &'static str,
    },
    /// A prior cannot be used.
    #[error(
        "prior {prior_idx} is about something that the dataset does not have, ties the poses of two frames together, \
         or its covariance is not positive definite"
    )]
    BadPrior {
        /// The prior, by its place in the options.
        prior_idx: usize,
    },
    /// Cameras cannot share a lens.
    #[error("cameras {} and {} cannot share a lens: it is {} for one and {} for the other", cameras[0], cameras[1], models[0], models[1])]
    LensesDiffer {
        /// The cameras.
        cameras: [CameraId; 2],
        /// Their lens models.
        models: [&'static str; 2],
    },
    /// The solver failed.
    #[error(transparent)]
    Solver(#[from] boresight_solver::Error),
}
