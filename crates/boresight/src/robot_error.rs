//! What can keep a robot command from its answer.

use boresight_adjust::{ObjectPoseError, SightedPointError, TouchError};
use boresight_seed::ThreePointError;
use boresight_seed::planar_robot::PlanarError;

use crate::error::ErrorKind;

/// Why a robot command has no answer.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum RobotError {
    /// A camera is asked for that the calibration does not have, or none is and there are several.
    #[error("the calibration has no camera `{name}`; it has {}", known.join(", "))]
    NoSuchCamera {
        /// The name; empty if none was given.
        name: String,
        /// The cameras there are.
        known: Vec<String>,
    },
    /// The calibration does not tell where a camera sits.
    #[error("the calibration does not tell where camera {name} sits")]
    NoPose {
        /// The camera.
        name: String,
    },
    /// Stereo of one camera, which was not moved.
    #[error("a point is found from the pixels of two cameras or more, and {name} is one")]
    OneCamera {
        /// The camera.
        name: String,
    },
    /// An option has a value that cannot be.
    #[error("{option} is {value}: {need}")]
    BadOption {
        /// The option.
        option: &'static str,
        /// Its value.
        value: f64,
        /// What it must be.
        need: &'static str,
    },
    /// There are too few points.
    #[error("{found} {what} are given; {need} are needed")]
    TooFew {
        /// Of what.
        what: &'static str,
        /// How many are given.
        found: usize,
        /// How many are needed.
        need: usize,
    },
    /// A pixel has no direction in the lens.
    #[error("point {name}: the pixel ({:.1}, {:.1}) has no direction in the lens", pixel[0], pixel[1])]
    NoDirection {
        /// The point.
        name: String,
        /// The pixel.
        pixel: [f64; 2],
    },
    /// No pose explains the points.
    #[error("no pose explains the points: of {tried} triangles none has one that sees all points")]
    NoSolution {
        /// The number of triangles that were tried.
        tried: usize,
    },
    /// A pixel does not lead to the plane.
    #[error("a pixel of the object does not lead to the robot's plane, or its surroundings do not")]
    NoPlace,
    /// An object is said to be as high above the plane as the camera.
    #[error(
        "the object's points are said to be {:.1} mm above the plane, and the camera is {:.1} mm above it", 1e3 * height_m, 1e3 * camera_m
    )]
    AboveCamera {
        /// Its stated height, in metres.
        height_m: f64,
        /// The camera's.
        camera_m: f64,
    },
    /// The three points have no pose.
    #[error(transparent)]
    ThreePoint(#[from] ThreePointError),
    /// The object's pose is open.
    #[error(transparent)]
    ObjectPose(#[from] ObjectPoseError),
    /// A point cannot be found.
    #[error(transparent)]
    SightedPoint(#[from] SightedPointError),
    /// The robot's plane cannot be found.
    #[error(transparent)]
    Touch(#[from] TouchError),
    /// The robot on wheels cannot be calibrated.
    #[error(transparent)]
    Planar(#[from] PlanarError),
}

impl RobotError {
    /// Returns who has to act.
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::NoSuchCamera { .. }
            | Self::NoPose { .. }
            | Self::OneCamera { .. }
            | Self::BadOption { .. }
            | Self::AboveCamera { .. } => ErrorKind::Usage,
            _ => ErrorKind::Solve,
        }
    }

    /// Returns what to do about it, where that is not obvious.
    pub fn hint(&self) -> Option<String> {
        let text = match self {
            Self::NoSuchCamera { name, .. } if name.is_empty() => "say which one with --camera NAME",
            Self::OneCamera { .. } => {
                "name another camera too, or tell with --moved where this one was moved to"
            }
            Self::AboveCamera { .. } => {
                "check the unit of height_mm, which counts from the plane of the touches"
            }
            Self::NoSolution { .. } => {
                "are the points paired with the right pixels, and is it the calibration of this camera?"
            }
            Self::ThreePoint(ThreePointError::NoTriangle { .. }) => {
                "are all sides in one unit, and in the order 12, 23, 31?"
            }
            Self::ThreePoint(ThreePointError::Collinear { .. }) => "choose points that span a triangle",
            Self::Touch(TouchError::Collinear { .. }) => {
                "touch points that span the area where parts will lie, not ones on a line"
            }
            Self::Touch(TouchError::TooFewTouches { .. }) => {
                "touch more points, at least nine for a good fit"
            }
            Self::Touch(TouchError::TipOpen { .. }) => {
                "turn the flange by 30 degrees or more between touches, about two axes"
            }
            _ => return None,
        };
        Some(text.to_owned())
    }
}
