//! What can keep two cameras from being compared.

/// Why a comparison is impossible.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The two cameras have images of different size, so no pixel of one is a pixel of the other.
    #[error("the images differ in size: {}x{} and {}x{} pixels", a[0], a[1], b[0], b[1])]
    ImageSizes {
        /// Width and height of the first camera's image in pixels.
        a: [u32; 2],
        /// Width and height of the second camera's image in pixels.
        b: [u32; 2],
    },
    /// The grid is too coarse or too fine.
    #[error("option `columns` is {columns}; it must be {least} to {most}")]
    Columns {
        /// The value given.
        columns: usize,
        /// The smallest value allowed.
        least: usize,
        /// The largest value allowed.
        most: usize,
    },
    /// An option is not a positive number.
    #[error("option `{option}` is {value}; it must be positive and finite")]
    NotPositive {
        /// The option's name, unit included.
        option: &'static str,
        /// The value given.
        value: f64,
    },
    /// Too little of the focus region is seen by both cameras to tell the implied transform.
    #[error(
        "both cameras see {found} of the {tried} grid points within {focus_radius_px} px of the image's middle; \
         {need} are needed"
    )]
    TooFewPoints {
        /// Grid points that both cameras see.
        found: usize,
        /// Grid points in the focus region.
        tried: usize,
        /// Grid points needed.
        need: usize,
        /// The radius of the focus region in pixels.
        focus_radius_px: f64,
    },
    /// The lenses are so different that no transform could be fitted.
    #[error(
        "the lenses are too different to fit a transform between them: after {steps} steps, a step still moves \
         the pixels by {last_step_px:.1e} px"
    )]
    NoTransform {
        /// The steps taken.
        steps: usize,
        /// By how many pixels the last step would move the points (root mean square).
        last_step_px: f64,
    },
    /// The two calibrations have no camera of the same name.
    #[error("no camera is in both calibrations: one has {}; the other has {}", list(a), list(b))]
    NoCommonCamera {
        /// The names of the first calibration's cameras.
        a: Vec<String>,
        /// The names of the second calibration's cameras.
        b: Vec<String>,
    },
    /// The calibration tells no uncertainty.
    #[error("there is no uncertainty: {why}")]
    NoCovariance {
        /// Why.
        why: String,
    },
    /// The calibration does not tell how the poses of the frames vary with the lens.
    #[error(
        "the calibration does not tell how the views of camera {camera} move with its lens; calibrate anew"
    )]
    NoMotions {
        /// The camera's name.
        camera: String,
    },
    /// The camera is not in the calibration.
    #[error("camera {camera} is not calibrated")]
    NotCalibrated {
        /// The camera's name.
        camera: String,
    },
    /// Two cameras of the same name cannot be compared.
    #[error("camera {name} cannot be compared")]
    Camera {
        /// The camera's name.
        name: String,
        /// Why.
        source: Box<Error>,
    },
}

impl Error {
    /// Returns the error of the comparison the other way round.
    pub(crate) fn reversed(self) -> Self {
        match self {
            Error::ImageSizes { a, b } => Error::ImageSizes { a: b, b: a },
            error => error,
        }
    }
}

fn list(names: &[String]) -> String {
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}
