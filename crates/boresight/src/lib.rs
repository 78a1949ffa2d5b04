//! The pipeline from a job to a judged calibration, and the names users import.
//!
//! [`load_job`] reads corners and job file, [`calibrate`] seeds, adjusts and judges, and
//! [`write_results`] writes what came of it:
//!
//! ```no_run
//! use boresight::{CalibrateOptions, JobOverrides, Watch};
//!
//! let job = boresight::load_job(&["datasets/opencv-stereo".into()], &JobOverrides::default())?;
//! let options = CalibrateOptions::of_job(&job)?;
//! let outcome = boresight::calibrate(&job, &options, &Watch::default())?;
//! boresight::write_results(&outcome, "out".as_ref())?;
//! # Ok::<(), boresight::Error>(())
//! ```
//!
//! Architecture invariant: nothing here prints, parses a command line or ends the process.

mod calibrate;
mod choices;
mod error;
mod explain;
mod images;
mod options;
mod results;
mod select;

pub use boresight_adjust::{Observer, Progress};
pub use boresight_camera::{Camera, Model};
pub use boresight_data::{
    Calibration, CameraFit, CameraInfo, Dataset, Finding, Frame, Geometry, Id, Observation, Provenance,
    Rejection, RejectionReason, Rig, RigCamera, Scene, Severity, Shape, Target, View,
};
pub use boresight_geometry::{Pose, Vector3};
pub use boresight_io::{
    Error as IoError, FORMATS, IMAGE_EXTENSIONS, ImageFile, ImageJob, Job, JobOverrides, Kind as IoKind,
    NamedCamera, OutputFile, SeenImage, calibration_to_json, corners_to_csv, export, is_pattern, load_images,
    load_job, matrices_to_json, matrices_to_npy, matrices_to_text, overlay_to_png, parse_target,
    read_calibration, read_cameras, read_image, write_files,
};
pub use boresight_validate::{CompareOptions, ComparedCamera, RigComparison, Verdict, compare_rigs, verdict};

pub use calibrate::{Outcome, Watch, calibrate};
pub use choices::{BadChoice, LossChoice, RegularizationChoice, RejectChoice, ShapeChoice};
pub use error::{Error, ErrorKind};
pub use explain::{codes, explain};
pub use images::{ImageProgress, detect_images, load};
pub use options::CalibrateOptions;
pub use results::{RESULT_FILES, result_files, sigma_of, write_results};

/// The version of Boresight, as provenance states it.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");
