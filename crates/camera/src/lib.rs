//! Lens models: project, unproject, differentiate, name.
//!
//! A lens model is a plug: one file that implements [`CameraModel`], and one line in [`registry`].
//! Camera axes are x right, y down, z forward; pixel (0, 0) is the centre of the top-left pixel.
//!
//! Architecture invariant: no lens knows a solver, a file or a dataset.

pub mod cahvor;
mod camera;
#[cfg(test)]
mod conformance;
pub mod division;
pub mod double_sphere;
pub mod eucm;
pub mod geographic;
pub mod kannala_brandt4;
pub mod mei;
mod model;
pub mod opencv;
pub mod pinhole;
pub mod registry;
mod roots;
mod sphere;
pub mod splined;
pub mod stereographic;
pub mod textbook;

pub use camera::{Camera, Error, Linearized};
pub use model::{CameraModel, LocalLinear, LocalSupport, MAX_LOCAL, MAX_PARAMS, ParamGroup};
pub use registry::{Model, ModelVisitor};
