//! One view's residuals, summed up for a Gauss-Newton step: gradient and Hessian by the composite
//! pose `cam_from_target`, and by the lens where asked for.
//!
//! Residuals are predicted minus observed pixels over the observation's sigma. The Cauchy loss
//! weighs each point by its length. Points outside the lens's domain have no residual: they are
//! counted, and a step that loses points is refused by the callers.

use std::ops::AddAssign;

use boresight_camera::{Camera, CameraModel, MAX_PARAMS, Model, ModelVisitor};
use boresight_geometry::{Matrix6, Pose, Vector3, Vector6};

use crate::robust::LossSum;
use crate::sighting::Sighting;

/// A lens model with its parameters.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lens<'a> {
    pub model: Model,
    pub params: &'a [f64],
}

impl<'a> Lens<'a> {
    pub fn of(camera: &'a Camera) -> Self {
        Self { model: camera.model, params: &camera.params }
    }
}

/// The columns of a lens and a pose.
pub(crate) const MAX_COLUMNS: usize = MAX_PARAMS + 6;

/// The cost of a view, and how far it can be trusted.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Cost {
    /// The sum of the losses over the points that project.
    pub loss: f64,
    /// The number of points that project.
    pub inside: usize,
    /// The number of points that do not.
    pub outside: usize,
}

impl Cost {
    /// Tells whether this cost is to be preferred: fewer points lost, or as many and a lower loss.
    pub fn is_below(&self, other: &Cost) -> bool {
        self.outside < other.outside || (self.outside == other.outside && self.loss < other.loss)
    }
}

impl Cost {
    /// Returns the cost of residuals of these lengths.
    pub fn of(lengths: &[f64], outside: usize, width: f64) -> Self {
        let mut loss = LossSum::new(width);
        for length in lengths {
            loss.add(length * length);
        }
        Self { loss: loss.total(), inside: lengths.len(), outside }
    }
}

impl AddAssign for Cost {
    fn add_assign(&mut self, other: Self) {
        self.loss += other.loss;
        self.inside += other.inside;
        self.outside += other.outside;
    }
}

/// The normal equations of one view by the left perturbation of `cam_from_target`.
#[derive(Clone, Debug)]
pub(crate) struct PoseSum {
    pub hessian: Matrix6<f64>,
    pub gradient: Vector6<f64>,
    pub cost: Cost,
}

/// The normal equations of one view by the lens parameters, then the pose.
#[derive(Clone, Debug)]
pub(crate) struct LensSum {
    /// The upper triangle: lens parameters, pose, and the residual as the last column.
    pub gram: Box<[[f64; MAX_COLUMNS + 1]; MAX_COLUMNS + 1]>,
    /// The number of lens parameters, the core included.
    pub n_params: usize,
    pub cost: Cost,
}

/// Returns the normal equations by the pose, under a Cauchy loss of `width` sigmas, and appends the
/// lengths of the residuals, in sigmas, to `lengths`.
pub(crate) fn pose_sum(
    lens: Lens<'_>,
    cam_from_target: &Pose,
    sighting: &Sighting,
    width: f64,
    lengths: &mut Vec<f64>,
) -> PoseSum {
    lens.model.visit(PoseVisitor { params: lens.params, cam_from_target, sighting, width, lengths })
}

/// Returns the normal equations by lens and pose, under a Cauchy loss of `width` sigmas, and appends
/// the lengths of the residuals, in sigmas, to `lengths`.
pub(crate) fn lens_sum(
    lens: Lens<'_>,
    cam_from_target: &Pose,
    sighting: &Sighting,
    width: f64,
    lengths: &mut Vec<f64>,
) -> LensSum {
    lens.model.visit(LensVisitor { params: lens.params, cam_from_target, sighting, width, lengths })
}

/// Appends the lengths of the residuals in sigmas, points outside the domain left out; returns how
/// many those are.
pub(crate) fn residual_lengths(
    lens: Lens<'_>,
    cam_from_target: &Pose,
    sighting: &Sighting,
    lengths: &mut Vec<f64>,
) -> usize {
    lens.model.visit(LengthVisitor { params: lens.params, cam_from_target, sighting, lengths })
}

/// A pose as rotation matrix and translation, which is what a loop over points wants.
struct Rigid {
    rotation: [[f64; 3]; 3],
    translation: [f64; 3],
}

impl Rigid {
    fn of(pose: &Pose) -> Self {
        let r = pose.rotation_matrix();
        let rotation = [0, 1, 2].map(|row| [0, 1, 2].map(|column| r[(row, column)]));
        Self { rotation, translation: pose.translation.into() }
    }

    #[inline(always)]
    fn apply(&self, point: &Vector3<f64>) -> [f64; 3] {
        let ([a, b, c], t) = (&self.rotation, &self.translation);
        let (x, y, z) = (point.x, point.y, point.z);
        [
            a[0] * x + a[1] * y + a[2] * z + t[0],
            b[0] * x + b[1] * y + b[2] * z + t[1],
            c[0] * x + c[1] * y + c[2] * z + t[2],
        ]
    }
}

/// Returns the derivatives by the left perturbation of the pose, from those by the point:
/// `d p = omega x p + v`.
#[inline(always)]
fn by_pose(p: [f64; 3], g: [f64; 3]) -> [f64; 6] {
    [p[1] * g[2] - p[2] * g[1], p[2] * g[0] - p[0] * g[2], p[0] * g[1] - p[1] * g[0], g[0], g[1], g[2]]
}

struct PoseVisitor<'a> {
    params: &'a [f64],
    cam_from_target: &'a Pose,
    sighting: &'a Sighting,
    width: f64,
    lengths: &'a mut Vec<f64>,
}

impl ModelVisitor for PoseVisitor<'_> {
    type Output = PoseSum;

    fn visit<M: CameraModel>(self, model: M) -> PoseSum {
        let cam_from_target = Rigid::of(self.cam_from_target);
        let n_lens = self.params.len() - 4;
        let mut gram = [[0.0; 7]; 6];
        let mut loss = LossSum::new(self.width);
        let mut cost = Cost::default();
        let (mut unused_u, mut unused_v) = ([0.0; MAX_PARAMS], [0.0; MAX_PARAMS]);
        let mut d_point = [[0.0; 3]; 2];
        let sighting = self.sighting;
        for ((point, pixel), weight) in sighting.points.iter().zip(&sighting.pixels).zip(&sighting.weights) {
            let p = cam_from_target.apply(point);
            let d_lens = [&mut unused_u[..n_lens], &mut unused_v[..n_lens]];
            let Some([u, v]) = model.linearize(self.params, p, &mut d_point, d_lens) else {
                cost.outside += 1;
                continue;
            };
            let residual = [(u - pixel[0]) * weight, (v - pixel[1]) * weight];
            let square = residual[0] * residual[0] + residual[1] * residual[1];
            self.lengths.push(square.sqrt());
            cost.inside += 1;
            let factor = loss.add(square);
            for (g, r) in d_point.iter().zip(residual) {
                let row = by_pose(p, *g).map(|value| value * weight);
                for i in 0..6 {
                    let scaled = factor * row[i];
                    for j in i..6 {
                        gram[i][j] += scaled * row[j];
                    }
                    gram[i][6] += scaled * r;
                }
            }
        }
        cost.loss = loss.total();
        let hessian = Matrix6::from_fn(|i, j| gram[i.min(j)][i.max(j)]);
        PoseSum { hessian, gradient: Vector6::from_fn(|i, _| gram[i][6]), cost }
    }
}

struct LensVisitor<'a> {
    params: &'a [f64],
    cam_from_target: &'a Pose,
    sighting: &'a Sighting,
    width: f64,
    lengths: &'a mut Vec<f64>,
}

impl ModelVisitor for LensVisitor<'_> {
    type Output = LensSum;

    fn visit<M: CameraModel>(self, model: M) -> LensSum {
        let cam_from_target = Rigid::of(self.cam_from_target);
        let n_params = self.params.len();
        let n = n_params + 7;
        let [fx, fy, cx, cy] = [self.params[0], self.params[1], self.params[2], self.params[3]];
        let mut loss = LossSum::new(self.width);
        let mut gram = Box::new([[0.0; MAX_COLUMNS + 1]; MAX_COLUMNS + 1]);
        let mut cost = Cost::default();
        let (mut row_u, mut row_v) = ([0.0; MAX_COLUMNS + 1], [0.0; MAX_COLUMNS + 1]);
        let mut d_point = [[0.0; 3]; 2];
        let sighting = self.sighting;
        for ((point, pixel), weight) in sighting.points.iter().zip(&sighting.pixels).zip(&sighting.weights) {
            let p = cam_from_target.apply(point);
            let d_lens = [&mut row_u[4..n_params], &mut row_v[4..n_params]];
            let Some([u, v]) = model.linearize(self.params, p, &mut d_point, d_lens) else {
                cost.outside += 1;
                continue;
            };
            (row_u[0], row_u[1], row_u[2], row_u[3]) = ((u - cx) / fx, 0.0, 1.0, 0.0);
            (row_v[0], row_v[1], row_v[2], row_v[3]) = (0.0, (v - cy) / fy, 0.0, 1.0);
            row_u[n_params..n_params + 6].copy_from_slice(&by_pose(p, d_point[0]));
            row_v[n_params..n_params + 6].copy_from_slice(&by_pose(p, d_point[1]));
            (row_u[n - 1], row_v[n - 1]) = (u - pixel[0], v - pixel[1]);

            let square = (row_u[n - 1] * row_u[n - 1] + row_v[n - 1] * row_v[n - 1]) * weight * weight;
            self.lengths.push(square.sqrt());
            cost.inside += 1;
            let factor = loss.add(square) * weight * weight;
            for i in 0..n {
                let (scaled_u, scaled_v) = (factor * row_u[i], factor * row_v[i]);
                let sums = &mut gram[i][i..n];
                for ((sum, u), v) in sums.iter_mut().zip(&row_u[i..n]).zip(&row_v[i..n]) {
                    *sum += scaled_u * u + scaled_v * v;
                }
            }
        }
        cost.loss = loss.total();
        LensSum { gram, n_params, cost }
    }
}

struct LengthVisitor<'a> {
    params: &'a [f64],
    cam_from_target: &'a Pose,
    sighting: &'a Sighting,
    lengths: &'a mut Vec<f64>,
}

impl ModelVisitor for LengthVisitor<'_> {
    type Output = usize;

    fn visit<M: CameraModel>(self, model: M) -> usize {
        let cam_from_target = Rigid::of(self.cam_from_target);
        let mut outside = 0;
        let sighting = self.sighting;
        for ((point, pixel), weight) in sighting.points.iter().zip(&sighting.pixels).zip(&sighting.weights) {
            match model.project(self.params, cam_from_target.apply(point)) {
                Some([u, v]) => {
                    let (du, dv) = (u - pixel[0], v - pixel[1]);
                    self.lengths.push((du * du + dv * dv).sqrt() * weight);
                }
                None => outside += 1,
            }
        }
        outside
    }
}
