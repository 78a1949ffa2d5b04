//! Recordings in, datasets and calibrations in and out: one file per format.
//!
//! [`load_job`] turns a job file, or corner files and a target, into a checked dataset.
//! [`calibration_to_json`] and [`observations_to_parquet`] write a result, [`export`] writes it in the
//! formats of others, and [`read_cameras`] reads cameras whatever file they are in. A format is a plug:
//! one file, and one line in [`FORMATS`]. Where formats disagree with `docs/conventions.md`, the
//! format's own file converts.
//!
//! Architecture invariant: nothing here calibrates or judges, and nothing prints. Files are written
//! whole or not at all, and the same calibration gives the same bytes.

mod assemble;
mod atomic;
mod calibration_document;
mod calibration_json;
mod cameramodel;
mod corners_csv;
mod corners_vnl;
mod cursor;
mod detection_cache;
mod error;
mod file_storage;
mod format;
mod foxglove_mcap;
#[cfg(any(test, feature = "fuzzing"))]
pub mod fuzzing;
mod geometry_document;
mod h_matrix;
mod image_files;
mod image_job;
mod image_names;
mod image_pixels;
mod job;
mod job_file;
mod json_text;
mod kalibr;
mod number;
mod observations_parquet;
mod opencv_yaml;
mod planar_motions;
mod pose_table;
mod python_literal;
mod recording;
mod robot_input;
mod robot_job;
mod robot_plane_json;
mod robot_table;
mod ros_camera_info;
#[cfg(test)]
mod samples;
mod seen;
mod sights_job;
mod size_seen;
#[cfg(test)]
mod speed_tests;
mod target_spec;

pub use atomic::write_atomically;
pub use calibration_json::{CALIBRATION_SCHEMA, calibration_from_json, calibration_to_json};
pub use corners_csv::corners_to_csv;
pub use detection_cache::DetectionCache;
pub use error::{Error, Kind, Place};
pub use format::{
    FORMATS, Format, NamedCamera, NamedCovariance, OutputFile, cameras_from_bytes, closest_format, export,
    lost_in, read_cameras, write_files,
};
pub use foxglove_mcap::calibration_to_mcap;
pub use h_matrix::{
    CameraMatrices, MATRIX_SCHEMA, matrices, matrices_to_json, matrices_to_npy, matrices_to_text,
};
pub use image_files::{IMAGE_EXTENSIONS, ImageFile, is_pattern};
pub use image_job::{ImageJob, SeenImage, load_images, read_image};
pub use image_pixels::{ReadImage, gray_to_png, image_from_bytes, overlay_to_png};
pub use job::{JOB_FILE, Job, JobOverrides, hash, load_job, read_calibration};
pub use observations_parquet::{
    OBSERVATIONS_SCHEMA, ObservationRow, attach_residuals, observations_to_parquet, read_observations,
};
pub use planar_motions::{PlanarMotionRow, read_planar_motions};
pub use pose_table::{PoseTable, RotationColumns, read_pose_table};
pub use recording::{
    CameraPair, Clock, Contents, ImageTopic, OpenedImage, Packing, RecordedImage, RecordedValue,
    RecordingJob, RecordingOptions, RecordingWriter, SeenRecorded, StatedCamera, Survey, Topic,
    load_recordings, survey_recordings,
};
pub use robot_input::{RobotAxes, RobotInput, RobotOverrides, TouchInput};
pub use robot_job::{RobotJob, read_robot_job};
pub use robot_plane_json::{
    PLANE_SCHEMA, PlaneDocument, TouchDocument, TriedDocument, plane_to_json, read_plane,
};
pub use robot_table::RobotTable;
pub use sights_job::{RobotRows, SightsJob, TimedPose, read_sights_job};
pub use size_seen::{SizeSeen, refuse_other_size};
pub use target_spec::{parse_target, target_spec};
