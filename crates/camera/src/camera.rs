//! A camera: a lens model with its parameters and the size of its image.

use boresight_geometry::Vector3;

use crate::registry::{Model, ModelVisitor};
use crate::{CameraModel, LocalSupport, ParamGroup};

/// What can be wrong with a camera.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// No lens model has this name.
    #[error("there is no lens model `{name}`; known: {}", known.join(", "))]
    UnknownModel {
        /// The name asked for.
        name: String,
        /// The names that exist.
        known: Vec<&'static str>,
    },
    /// The text after a model's name is no configuration of it.
    #[error("`{found}` is no configuration of lens model {model}; it takes {need}")]
    BadConfiguration {
        /// The model's name.
        model: &'static str,
        /// What was given.
        found: String,
        /// What a configuration looks like, or that there is none.
        need: &'static str,
    },
    /// The model's configuration leaves open what it takes to project.
    #[error("the configuration of lens model {model} is not complete")]
    Incomplete {
        /// The model.
        model: Model,
    },
    /// The number of parameters is not the model's.
    #[error("lens model {model} takes {need} parameters, {found} are given")]
    ParamCount {
        /// The model's name.
        model: &'static str,
        /// How many were given.
        found: usize,
        /// How many it takes.
        need: usize,
    },
    /// A parameter has a value that no lens has.
    #[error("parameter {name} of lens model {model} is {value}: {need}")]
    BadParam {
        /// The model's name.
        model: &'static str,
        /// The parameter's name.
        name: &'static str,
        /// The value given.
        value: f64,
        /// What it must be.
        need: &'static str,
    },
}

/// A lens model, its parameters and its image size.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// The lens model.
    pub model: Model,
    /// The parameters, in the model's order: `fx, fy, cx, cy` first.
    pub params: Vec<f64>,
    /// Width and height of the image in pixels.
    pub image_size: [u32; 2],
}

/// A projected point and how its pixel moves.
#[derive(Clone, Debug, PartialEq)]
pub struct Linearized {
    /// The pixel.
    pub pixel: [f64; 2],
    /// The derivative of u and of v by the point in the camera frame.
    pub d_point: [[f64; 3]; 2],
    /// The derivative of u and of v by each parameter of the lens.
    pub d_params: [Vec<f64>; 2],
}

impl Camera {
    /// Returns the camera, after checking number and values of the parameters.
    pub fn new(model: Model, params: Vec<f64>, image_size: [u32; 2]) -> Result<Self, Error> {
        if !model.is_complete() {
            return Err(Error::Incomplete { model });
        }
        let names = model.param_names();
        if params.len() != names.len() {
            return Err(Error::ParamCount { model: model.name(), found: params.len(), need: names.len() });
        }
        for (i, (&name, &value)) in names.iter().zip(&params).enumerate() {
            let bad = |need| Error::BadParam { model: model.name(), name, value, need };
            if !value.is_finite() {
                return Err(bad("it must be finite"));
            }
            if i < 2 && value <= 0.0 {
                return Err(bad("a focal length must be positive"));
            }
        }
        Ok(Self { model, params, image_size })
    }

    /// Returns the pixel that sees `point_in_cam`, or `None` outside the model's domain.
    pub fn project(&self, point_in_cam: &Vector3<f64>) -> Option<[f64; 2]> {
        struct Project<'a>(&'a [f64], [f64; 3]);
        impl ModelVisitor for Project<'_> {
            type Output = Option<[f64; 2]>;
            fn visit<M: CameraModel>(self, model: M) -> Self::Output {
                model.project(self.0, self.1)
            }
        }
        self.model.visit(Project(&self.params, (*point_in_cam).into()))
    }

    /// Returns the pixel that sees `point_in_cam`, with its derivatives by the point and by all lens
    /// parameters; `None` outside the model's domain.
    pub fn linearize(&self, point_in_cam: &Vector3<f64>) -> Option<Linearized> {
        struct Linearize<'a>(&'a [f64], [f64; 3]);
        impl ModelVisitor for Linearize<'_> {
            type Output = Option<Linearized>;
            fn visit<M: CameraModel>(self, model: M) -> Self::Output {
                let Self(params, point) = self;
                let mut d_point = [[0.0; 3]; 2];
                let mut d_params = [vec![0.0; params.len()], vec![0.0; params.len()]];
                let [u_row, v_row] = &mut d_params;
                let pixel =
                    model.linearize(params, point, &mut d_point, [&mut u_row[4..], &mut v_row[4..]])?;
                // The pixel is (fx x + cx, fy y + cy).
                u_row[0] = (pixel[0] - params[2]) / params[0];
                v_row[1] = (pixel[1] - params[3]) / params[1];
                (u_row[2], v_row[3]) = (1.0, 1.0);
                Some(Linearized { pixel, d_point, d_params })
            }
        }
        self.model.visit(Linearize(&self.params, (*point_in_cam).into()))
    }

    /// Returns the unit direction in the camera frame that `pixel` sees, or `None` if there is none.
    pub fn unproject(&self, pixel: [f64; 2]) -> Option<Vector3<f64>> {
        struct Unproject<'a>(&'a [f64], [f64; 2]);
        impl ModelVisitor for Unproject<'_> {
            type Output = Option<[f64; 3]>;
            fn visit<M: CameraModel>(self, model: M) -> Self::Output {
                model.unproject(self.0, self.1)
            }
        }
        self.model.visit(Unproject(&self.params, pixel)).map(|ray| Vector3::from(ray).normalize())
    }

    /// Returns the largest angle off axis, in radians, up to which the lens is one-to-one.
    pub fn monotonic_limit(&self) -> Option<f64> {
        struct Limit<'a>(&'a [f64]);
        impl ModelVisitor for Limit<'_> {
            type Output = Option<f64>;
            fn visit<M: CameraModel>(self, model: M) -> Self::Output {
                model.monotonic_limit(self.0)
            }
        }
        self.model.visit(Limit(&self.params))
    }
}

impl Model {
    /// Returns the number of parameters, the core included.
    pub fn param_count(&self) -> usize {
        struct Count;
        impl ModelVisitor for Count {
            type Output = usize;
            fn visit<M: CameraModel>(self, model: M) -> usize {
                model.param_count()
            }
        }
        self.visit(Count)
    }

    /// Returns the name of each parameter.
    pub fn param_names(&self) -> Vec<&'static str> {
        struct Names;
        impl ModelVisitor for Names {
            type Output = Vec<&'static str>;
            fn visit<M: CameraModel>(self, model: M) -> Self::Output {
                model.param_names()
            }
        }
        self.visit(Names)
    }

    /// Returns what each parameter is for.
    pub fn param_groups(&self) -> Vec<ParamGroup> {
        struct Groups;
        impl ModelVisitor for Groups {
            type Output = Vec<ParamGroup>;
            fn visit<M: CameraModel>(self, model: M) -> Self::Output {
                model.param_groups()
            }
        }
        self.visit(Groups)
    }

    /// Tells whether the configuration says all that it takes to project.
    pub fn is_complete(&self) -> bool {
        struct Complete;
        impl ModelVisitor for Complete {
            type Output = bool;
            fn visit<M: CameraModel>(self, model: M) -> bool {
                model.is_complete()
            }
        }
        self.visit(Complete)
    }

    /// Returns which lens parameters a point depends on; `None` is all of them.
    pub fn local_support(&self) -> Option<LocalSupport> {
        struct Support;
        impl ModelVisitor for Support {
            type Output = Option<LocalSupport>;
            fn visit<M: CameraModel>(self, model: M) -> Self::Output {
                model.local_support()
            }
        }
        self.visit(Support)
    }

    /// Returns the parameters of a lens that sees beyond 90 degrees, if the model can, for the core
    /// `[fx, fy, cx, cy]`: a start from which any lens is within reach.
    pub fn wide(&self, core: [f64; 4]) -> Vec<f64> {
        struct Wide([f64; 4]);
        impl ModelVisitor for Wide {
            type Output = Vec<f64>;
            fn visit<M: CameraModel>(self, model: M) -> Self::Output {
                model.wide(self.0)
            }
        }
        self.visit(Wide(core))
    }

    /// Returns the parameters of the lens without distortion, for the core `[fx, fy, cx, cy]`.
    pub fn undistorted(&self, core: [f64; 4]) -> Vec<f64> {
        struct Undistorted([f64; 4]);
        impl ModelVisitor for Undistorted {
            type Output = Vec<f64>;
            fn visit<M: CameraModel>(self, model: M) -> Self::Output {
                model.undistorted(self.0)
            }
        }
        self.visit(Undistorted(core))
    }

    /// Returns the parameters with this core whose projection follows `pixel_of`, another lens's, or `None`
    /// for a model without [`local_support`](Self::local_support), or where `pixel_of` fails.
    pub fn following(
        &self,
        core: [f64; 4],
        pixel_of: &dyn Fn([f64; 3]) -> Option<[f64; 2]>,
    ) -> Option<Vec<f64>> {
        struct Following<'a>([f64; 4], &'a dyn Fn([f64; 3]) -> Option<[f64; 2]>);
        impl ModelVisitor for Following<'_> {
            type Output = Option<Vec<f64>>;
            fn visit<M: CameraModel>(self, model: M) -> Self::Output {
                model.following(self.0, self.1)
            }
        }
        self.visit(Following(core, pixel_of))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn linearized_pixels_match_differences() {
        let params = vec![1200.0, 1190.0, 800.5, 610.0, -0.2, 0.05, 1e-3, -5e-4, 0.02];
        let camera = Camera::new("opencv5".parse().unwrap(), params, [1600, 1200]).unwrap();
        let point = Vector3::new(0.4, -0.3, 1.5);
        let at = camera.linearize(&point).unwrap();
        assert_eq!(Some(at.pixel), camera.project(&point));
        let step = 1e-6;
        for i in 0..camera.params.len() {
            let mut moved = camera.clone();
            moved.params[i] += step;
            let pixel = moved.project(&point).unwrap();
            for (row, moved) in pixel.iter().enumerate() {
                // One-sided differences are good to the step times the second derivative.
                let difference = (moved - at.pixel[row]) / step;
                assert!((difference - at.d_params[row][i]).abs() < 1e-3, "{i} {row}");
            }
        }
        for axis in 0..3 {
            let mut moved = point;
            moved[axis] += step;
            let pixel = camera.project(&moved).unwrap();
            for (row, moved) in pixel.iter().enumerate() {
                let difference = (moved - at.pixel[row]) / step;
                assert!((difference - at.d_point[row][axis]).abs() < 1e-2, "{axis} {row}");
            }
        }
        assert_eq!(camera.linearize(&-point), None);
    }
}
