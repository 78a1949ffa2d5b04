//! The robot-vision textbook's view of a camera: Eqs 8.1 to 8.30 of its chapter "Robot Vision".
//!
//! The textbook's letters are kept in this module alone. Its focal length `fc` and pixel size `Dx`,
//! `Dy` make a [`Sensor`]; its `u0, v0` are our `cx, cy`; its matrix `M` is the pose `cam_from_ref`;
//! its calibration matrix is `H = P M`. Its camera and image frames have our axes: x along the rows
//! of the sensor, y along its columns, z along the optical axis.
//!
//! Back from points to `H`, and from `H` to `P` and `M`, leads [`calibration_matrix`]. [`backward`] has the
//! equations of three points and their sides, [`stereo`] those of two cameras, [`robot_plane`] those of a
//! pattern that a robot touches.

pub mod backward;
pub mod calibration_matrix;
mod forward;
pub mod robot_plane;
mod sensor;
pub mod stereo;

pub use forward::{Projection, h_matrix, m_matrix, p_matrix, project_by_h, project_by_lens};
pub use sensor::{IndexFrame, IndexOrigin, Sensor};
