//! Poses, their tangent space, and numbers that carry derivatives.
//!
//! A pose is named by both its ends: `b_from_a` maps a point given in frame `a` to the same point
//! given in frame `b`, so `point_in_b = b_from_a * point_in_a` and `c_from_a = c_from_b * b_from_a`.
//! Perturbations are on the left and ordered `[rotation, translation]`.
//!
//! Architecture invariant: nothing here knows a camera, a file or a solver.

mod dual;
mod pose;
mod pose_stream;
mod rodrigues;
mod scalar;
mod triangulation;

pub use dual::Dual;
pub use nalgebra;
pub use nalgebra::{Matrix2, Matrix3, Matrix6, Point3, Rotation3, UnitQuaternion, Vector2, Vector3, Vector6};
pub use pose::{Pose, left_jacobian_inverse, skew};
pub use pose_stream::PoseStream;
pub use rodrigues::rotation_by_rodrigues;
pub use scalar::{MAX_LANES, Scalar};
pub use triangulation::{RayPair, Triangulation, triangulate};
