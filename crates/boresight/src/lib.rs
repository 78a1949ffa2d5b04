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

mod beliefs;
mod calibrate;
mod choices;
mod convert;
mod cross_validation;
mod demo;
mod doctor;
mod error;
mod explain;
mod hand_eye;
mod held_out;
mod images;
mod known_rig;
mod lens_choice;
mod line_delay;
mod locate;
mod options;
mod planar;
mod plane_sanity;
mod recording_texts;
mod recordings;
mod results;
mod robot_error;
mod robot_plane;
mod robot_texts;
mod select;
mod shape_choice;
mod shared_lens;
mod stereo;
mod time_offset;
mod trial;
mod uncertainty;
mod verify;

pub use boresight_adjust::{
    AdjustOptions, Heights, ObjectPose, Observer, PoseNoise, Progress, RobotNoise, TipKnowledge, Touch,
    TouchLens, TouchOptions, TouchedPlane, TriedModel,
};
pub use boresight_camera::{Camera, Model};
pub use boresight_data::{
    Calibration, CameraFit, CameraId, CameraInfo, CircleLayout, Dataset, Dictionary, Finding, Frame,
    Geometry, HeldOut, Id, Mounting, Observation, PlaneModel, PoseConvention, PoseDirection, Provenance,
    Rejection, RejectionReason, Rig, RigCamera, RobotPlane, RotationKind, Scene, Severity, Shape, Target,
    View,
};
pub use boresight_geometry::{Pose, UnitQuaternion, Vector3};
pub use boresight_io::{
    CameraPair, Clock, Contents, DetectionCache, Error as IoError, FORMATS, IMAGE_EXTENSIONS, ImageFile,
    ImageJob, ImageTopic, Job, JobOverrides, Kind as IoKind, NamedCamera, OutputFile, PLANE_SCHEMA,
    PlanarMotionRow, PlaneDocument, RecordingJob, RecordingOptions, RobotAxes, RobotInput, RobotJob,
    RobotOverrides, RobotRows, RobotTable, RotationColumns, SeenImage, SeenRecorded, SightsJob, SizeSeen,
    StatedCamera, Survey, TimedPose, Topic, TouchDocument, TriedDocument, calibration_to_json,
    calibration_to_mcap, corners_to_csv, export, hash, is_pattern, load_images, load_job, load_recordings,
    lost_in, matrices_to_json, matrices_to_npy, matrices_to_text, overlay_to_png, parse_target,
    plane_to_json, read_calibration, read_cameras, read_image, read_observations, read_planar_motions,
    read_plane, read_robot_job, read_sights_job, refuse_other_size, survey_recordings, target_spec,
    write_atomically, write_files,
};
pub use boresight_seed::planar_robot::{PLANAR_NAMES, PlanarError, PlanarMotion, PlanarRobot};
pub use boresight_synthetic::{FirstSquare, NotDrawn, Paper, Print, Sheet, sheet};
pub use boresight_validate::{
    AtDistance, CompareOptions, ComparedCamera, Method, ProjectionUncertainty, Propagation, RigComparison,
    Spread, StereoUncertainty, UncertaintyMap, Verdict, compare_known_rigs, compare_rigs, stereo_uncertainty,
    verdict,
};

pub use beliefs::HoldChoice;
pub use boresight_seed::{Converted, ImpliedRotation, triangle_from_sides};
pub use boresight_validate::{CameraLook, Looks, WeakestLink};
pub use calibrate::{Outcome, Watch, calibrate, with_threads};
pub use choices::{
    BadChoice, BadList, ByCamera, HoldoutChoice, LensChoice, LensModel, LossChoice, RegularizationChoice,
    RejectChoice, ShapeChoice,
};
pub use convert::{ConvertedCamera, convert_lenses};
pub use cross_validation::{compared, cross_validate};
pub use demo::{Demo, Recovered, Recovery, demo, recovery};
pub use doctor::{Examination, examine};
pub use error::{Error, ErrorKind};
pub use explain::{codes, explain};
pub use hand_eye::{
    ClockPair, Figures, HAND_EYE_POSES_SCHEMA, HAND_EYE_SCHEMA, HandEyeDocument, HandEyeOptions,
    HandEyeOutcome, JOINTS_SCHEMA, Joint, JointChain, JointLink, MethodFigures, NoiseChoice, PlainAnswer,
    PoseFigures, PoseHandEye, PoseReadings, SigmaSource, TouchedPoints, WorkingPoint, check_motions,
    describe_reading, hand_eye, hand_eye_of_poses, joint_chain, joints_to_json, pose_hand_eye_to_json,
    read_poses,
};
pub use held_out::held_out;
pub use images::{DetectWatch, ImageProgress, Stages, detect_images, detection_cache, load};
pub use known_rig::KnownRig;
pub use lens_choice::{LensSelection, ModelTrial, NoLens};
pub use line_delay::{LineDelayChoice, LineDelayUse};
pub use locate::{Candidate, LocatePoint, Located, locate};
pub use options::CalibrateOptions;
pub use planar::{PLANAR_SCHEMA, PlanarOutcome, planar, planar_to_json};
pub use recordings::detect_recordings;
pub use results::{RESULT_FILES, result_files, write_results};
pub use shape_choice::ShapeSelection;
pub use time_offset::TimeOffsetChoice;
pub use uncertainty::{CameraUncertainty, UncertaintyOptions, UncertaintyReport, uncertainty};
pub use verify::{CameraVerification, Verification, verify};

pub use robot_error::RobotError;
pub use robot_plane::{
    Chapter, ObjectSeen, PatternOutcome, PatternTouch, PlacedObject, PlaneOutcome, lens_of,
    pattern_procedure, place_object, robot_plane,
};
pub use stereo::{Stereo, StereoFix};

/// The version of Boresight, as provenance states it.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");
