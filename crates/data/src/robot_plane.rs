//! A robot's plane as a camera sees it: from a pixel to a position in the robot's base frame.

use serde::{Deserialize, Serialize};

/// How pixels lead to the robot's plane.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PlaneModel {
    /// Turn, scale and shift of pixels: the textbook's, for an image plane parallel to the robot's.
    Similarity,
    /// A linear map of pixels.
    Affine,
    /// A projective map of pixels.
    Homography,
    /// The textbook's, of directions freed of distortion.
    UndistortedSimilarity,
    /// A linear map of directions freed of distortion.
    UndistortedAffine,
    /// A projective map of directions freed of distortion.
    UndistortedHomography,
    /// The pose of a calibrated camera: where its rays meet the plane.
    Pose,
}

impl PlaneModel {
    /// All models, the simplest first.
    pub const ALL: [Self; 7] = [
        Self::Similarity,
        Self::Affine,
        Self::Homography,
        Self::UndistortedSimilarity,
        Self::UndistortedAffine,
        Self::UndistortedHomography,
        Self::Pose,
    ];

    /// Returns the name in files and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Similarity => "similarity",
            Self::Affine => "affine",
            Self::Homography => "homography",
            Self::UndistortedSimilarity => "undistorted-similarity",
            Self::UndistortedAffine => "undistorted-affine",
            Self::UndistortedHomography => "undistorted-homography",
            Self::Pose => "pose",
        }
    }

    /// Tells whether the model needs a calibrated lens.
    pub fn needs_lens(self) -> bool {
        self >= Self::UndistortedSimilarity
    }
}

/// A calibrated plane: all that it takes to go from a pixel to the robot, and how well that is known.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RobotPlane {
    /// How pixels lead to the plane.
    pub model: PlaneModel,
    /// The lens, where the model needs one.
    pub lens: Option<PlaneLens>,
    /// Image coordinates (pixels, or x / z and y / z of directions) enter the map less this,
    pub image_centre: [f64; 2],
    /// divided by this.
    pub image_scale: f64,
    /// What the map gives is multiplied by this, in metres,
    pub robot_scale_m: f64,
    /// and moved by this position in the base frame, in metres; heights refer to it too.
    pub robot_centre_m: [f64; 2],
    /// +1 if the image's z axis, into the scene, points along the robot's, -1 if against it.
    pub facing: f64,
    /// The map: 4, 6 or 8 numbers; of a pose `base_from_cam` as rotation x y z w and translation in metres.
    pub map: Vec<f64>,
    /// The plane in the base frame: height at the centre in metres, then its slopes along x and y.
    pub height_m: [f64; 3],
    /// Where the camera is in the base frame, in metres, where that can be told.
    pub camera_in_base_m: Option<[f64; 3]>,
    /// The touching tip on the flange, in metres, where touches are given as poses of the flange.
    pub tip_in_flange_m: Option<[f64; 3]>,
    /// The names of the columns of the covariance: those of the map, of the plane, of the lens.
    pub names: Vec<String>,
    /// The joint covariance, row by row.
    pub covariance: Vec<f64>,
}

/// A lens, as a plane keeps it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlaneLens {
    /// The camera's name.
    pub camera: String,
    /// The lens model.
    pub model: String,
    /// Its parameters, in its order.
    pub params: Vec<f64>,
    /// Width and height of the image in pixels.
    pub image_size: [u32; 2],
}
