//! The pose of an object of known points in front of a calibrated camera, and how well it is known.
//!
//! The search is the solver's, over one reprojection term whose lens is held. The covariance is that
//! of this estimate: pixels of the stated sigma, and a lens that is off by what its calibration says.

use std::sync::Arc;

use boresight_camera::Camera;
use boresight_data::{Geometry, Observation, PointId, Shape, Target};
use boresight_geometry::nalgebra::{DMatrix, Matrix2x6, Matrix6xX, SMatrix};
use boresight_geometry::{Matrix6, Pose, Vector3, skew};
use boresight_solver::{Elimination, Parameters, Problem, SolveOptions, Term as _, solve};

use crate::chain::{Chain, Link};
use crate::options::Loss;
use crate::reprojection::{Layouts, Reprojection, TargetPoints};

/// A point of an object and where it is seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeenPoint {
    /// The point in the object's frame, in metres.
    pub point_m: [f64; 3],
    /// Where it is seen.
    pub pixel: [f64; 2],
    /// The standard deviation of either pixel coordinate.
    pub sigma_px: f64,
}

/// The pose of an object.
#[derive(Clone, Debug, PartialEq)]
pub struct ObjectPose {
    /// The pose.
    pub cam_from_object: Pose,
    /// Predicted minus seen pixel of each point.
    pub residuals_px: Vec<[f64; 2]>,
    /// The sum of squared residuals in units of their sigma.
    pub chi2: f64,
    /// Equations minus unknowns: two for each point, less six.
    pub degrees_of_freedom: usize,
    /// The covariance of the pose, a left perturbation `[rotation, translation]`, by the pixels' noise.
    pub covariance_by_pixels: Matrix6<f64>,
    /// The same by the errors of the lens, where its covariance is known.
    pub covariance_by_lens: Option<Matrix6<f64>>,
    /// The reciprocal condition of the normal matrix, its columns scaled to unit length.
    pub reciprocal_condition: f64,
}

/// What keeps an object from having a pose.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ObjectPoseError {
    /// There are fewer than three points.
    #[error("{found} points are given; {need} are needed for a pose")]
    TooFewPoints {
        /// How many are given.
        found: usize,
        /// How many are needed.
        need: usize,
    },
    /// A point is where the lens sees nothing.
    #[error("point {index} (counted from 0) is out of the lens's sight in the pose that was to be refined")]
    OutOfSight {
        /// The point, counted from 0.
        index: usize,
    },
    /// The points leave the pose open.
    #[error(
        "the points leave the pose open: the reciprocal condition of its equations is {reciprocal_condition:.1e}, at least {limit:.0e} is needed"
    )]
    Open {
        /// The reciprocal condition of the normal matrix.
        reciprocal_condition: f64,
        /// The least accepted.
        limit: f64,
    },
    /// The solver failed.
    #[error(transparent)]
    Solver(#[from] boresight_solver::Error),
    /// The search did not converge.
    #[error("the search did not converge: {stop}")]
    NotConverged {
        /// Why it stopped.
        stop: String,
    },
}

/// The least reciprocal condition of the scaled normal matrix.
const LEAST_RECIPROCAL_CONDITION: f64 = 1e-14;

/// Returns the pose with the least sum of squared residuals, from a start near it.
///
/// `lens_covariance` is that of all parameters of the camera, in their order.
pub fn object_pose(
    camera: &Camera,
    points: &[SeenPoint],
    start: &Pose,
    loss: Loss,
    lens_covariance: Option<&DMatrix<f64>>,
) -> Result<ObjectPose, ObjectPoseError> {
    if points.len() < 3 {
        return Err(ObjectPoseError::TooFewPoints { found: points.len(), need: 3 });
    }
    let target = Target {
        name: String::new(),
        geometry: Geometry::Points { points_m: points.iter().map(|point| point.point_m).collect() },
        shape: Shape::Rigid,
    };
    let observation = |(i, point): (usize, &SeenPoint)| Observation {
        point: PointId(i as u32),
        pixel: point.pixel,
        sigma_px: point.sigma_px,
    };
    let observations: Vec<Observation> = points.iter().enumerate().map(observation).collect();
    let mut parameters = Parameters::default();
    let lens = parameters.add_vector(&camera.params);
    parameters.hold_all(lens);
    let pose = parameters.add_pose(start, Elimination::Reduced);
    let drawn = Arc::new(TargetPoints::new(&target, &observations));
    let chain = Chain { links: vec![Link::Block(pose)] };
    let mut term =
        Reprojection::new(camera.model, lens, None, chain, drawn, &observations, &Layouts::default());
    term.set_loss(loss);
    if let Some(index) = term.predict(parameters.values()).iter().position(Option::is_none) {
        return Err(ObjectPoseError::OutOfSight { index });
    }
    debug_assert_eq!(term.row_count(), 2 * points.len());
    let problem = Problem::new(&parameters, vec![&term])?;
    let options = SolveOptions { decrease_below: 1e-12, threads: 1, ..SolveOptions::default() };
    let solution = solve(&problem, &options)?;
    if !solution.stop.is_converged() {
        return Err(ObjectPoseError::NotConverged { stop: solution.stop.to_string() });
    }
    assessed(camera, points, solution.values(&problem).pose(pose), lens_covariance)
}

/// Returns what is known of a pose that is at its optimum already, such as one of three points.
pub fn assessed(
    camera: &Camera,
    points: &[SeenPoint],
    cam_from_object: Pose,
    lens_covariance: Option<&DMatrix<f64>>,
) -> Result<ObjectPose, ObjectPoseError> {
    let mut normal = Matrix6::zeros();
    let mut by_lens = Matrix6xX::zeros(camera.params.len());
    let (mut residuals_px, mut chi2) = (Vec::with_capacity(points.len()), 0.0);
    for (index, point) in points.iter().enumerate() {
        let point_in_cam = cam_from_object * Vector3::from(point.point_m);
        let at = camera.linearize(&point_in_cam).ok_or(ObjectPoseError::OutOfSight { index })?;
        let weight = point.sigma_px.powi(-2);
        let residual = [0, 1].map(|row| at.pixel[row] - point.pixel[row]);
        chi2 += weight * (residual[0] * residual[0] + residual[1] * residual[1]);
        residuals_px.push(residual);
        let jacobian = pixel_by_pose(&at.d_point, &point_in_cam);
        normal += jacobian.transpose() * jacobian * weight;
        let lens = DMatrix::from_fn(2, camera.params.len(), |row, i| at.d_params[row][i]);
        by_lens += jacobian.transpose() * weight * lens;
    }
    let (inverse, reciprocal_condition) = scaled_inverse(&normal);
    let covariance_by_pixels =
        inverse.ok_or(ObjectPoseError::Open { reciprocal_condition, limit: LEAST_RECIPROCAL_CONDITION })?;
    let covariance_by_lens = lens_covariance.map(|lens| {
        let gain = covariance_by_pixels * &by_lens;
        let spread = &gain * lens * gain.transpose();
        Matrix6::from_iterator(spread.iter().copied())
    });
    Ok(ObjectPose {
        cam_from_object,
        residuals_px,
        chi2,
        degrees_of_freedom: (2 * points.len()).saturating_sub(6),
        covariance_by_pixels,
        covariance_by_lens,
        reciprocal_condition,
    })
}

impl ObjectPose {
    /// Returns the covariance of the pose as a left perturbation, lens and pixels together.
    pub fn covariance(&self) -> Matrix6<f64> {
        self.covariance_by_pixels + self.covariance_by_lens.unwrap_or_else(Matrix6::zeros)
    }

    /// Returns the covariance of the rotation about the camera's axes, in radians, and of the object's
    /// origin in the camera frame, in metres.
    pub fn origin_covariance(&self) -> Matrix6<f64> {
        self.point_covariance(&Vector3::zeros())
    }

    /// Returns the covariance of the rotation and of a point of the object, both in the camera frame.
    pub fn point_covariance(&self, point_in_object: &Vector3<f64>) -> Matrix6<f64> {
        let point_in_cam = self.cam_from_object * *point_in_object;
        let mut moves = Matrix6::identity();
        moves.fixed_view_mut::<3, 3>(3, 0).copy_from(&-skew(&point_in_cam));
        moves * self.covariance() * moves.transpose()
    }

    /// Returns the root of the mean squared length of the residuals, in pixels.
    pub fn rms_px(&self) -> f64 {
        let sum: f64 = self.residuals_px.iter().flatten().map(|residual| residual * residual).sum();
        (sum / self.residuals_px.len().max(1) as f64).sqrt()
    }
}

/// Returns the derivative of a pixel by a left perturbation of the pose that its point came by.
pub(crate) fn pixel_by_pose(d_point: &[[f64; 3]; 2], point_in_cam: &Vector3<f64>) -> Matrix2x6<f64> {
    let mut jacobian = Matrix2x6::zeros();
    for (row, slope) in d_point.iter().enumerate() {
        let slope = Vector3::from(*slope);
        // d(ω × p) along the slope is (p × slope) · ω.
        let turn = point_in_cam.cross(&slope);
        for axis in 0..3 {
            jacobian[(row, axis)] = turn[axis];
            jacobian[(row, 3 + axis)] = slope[axis];
        }
    }
    jacobian
}

/// Returns the inverse of a normal matrix, or `None` if it is singular, and its reciprocal condition
/// after its columns were scaled.
pub(crate) fn scaled_inverse<const N: usize>(
    normal: &SMatrix<f64, N, N>,
) -> (Option<SMatrix<f64, N, N>>, f64) {
    let dynamic = DMatrix::from_column_slice(N, N, normal.as_slice());
    let (inverse, reciprocal_condition) = scaled_inverse_dynamic(&dynamic);
    (inverse.map(|inverse| SMatrix::from_column_slice(inverse.as_slice())), reciprocal_condition)
}

/// Does what [`scaled_inverse`] does for a matrix of any size.
pub(crate) fn scaled_inverse_dynamic(normal: &DMatrix<f64>) -> (Option<DMatrix<f64>>, f64) {
    let n = normal.nrows();
    let scales: Vec<f64> = (0..n).map(|i| normal[(i, i)].sqrt().recip()).collect();
    if scales.iter().any(|scale| !scale.is_finite()) {
        return (None, 0.0);
    }
    let scaled = DMatrix::from_fn(n, n, |i, j| normal[(i, j)] * scales[i] * scales[j]);
    let eigen = scaled.symmetric_eigen();
    let reciprocal_condition = (eigen.eigenvalues.min() / eigen.eigenvalues.max()).max(0.0);
    if reciprocal_condition < LEAST_RECIPROCAL_CONDITION {
        return (None, reciprocal_condition);
    }
    let inverted = DMatrix::from_diagonal(&eigen.eigenvalues.map(|value| 1.0 / value));
    let inverse = &eigen.eigenvectors * inverted * eigen.eigenvectors.transpose();
    (Some(DMatrix::from_fn(n, n, |i, j| inverse[(i, j)] * scales[i] * scales[j])), reciprocal_condition)
}

#[cfg(test)]
#[path = "object_pose_tests.rs"]
mod tests;
