//! The transform between two cameras' frames that their lenses imply.

use boresight_camera::{Camera, CameraModel, ModelVisitor};
use boresight_geometry::{Dual, Matrix3, Matrix6, Pose, Vector3, Vector6, skew};

/// Up to this many pixels the loss is that of least squares; beyond, it grows linearly.
const LOSS_PX: f64 = 1.0;

/// Once a step moves the pixels by less than this, the fit ends as soon as steps get no shorter:
/// then they are rounding, at 1e-13 or so.
const STEP_BELOW_PX: f64 = 1e-9;

/// A step longer than this share of the one before means that convergence is slow.
const SLOW: f64 = 0.2;

/// Steps after which the fit gives up; about ten are common.
const MAX_STEPS: usize = 100;

/// Points needed to fit anything; three directions would do if they were exact.
pub(super) const MIN_POINTS: usize = 6;

/// What both cameras see at one pixel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sight {
    point_in_a: Vector3<f64>,
    point_in_b: Vector3<f64>,
    /// Where camera a sees its own point: the pixel but for rounding.
    pixel_in_a: [f64; 2],
    pixel_in_b: [f64; 2],
}

/// Two cameras, and how far each can be trusted to see.
#[derive(Clone, Copy, Debug)]
pub(super) struct Eyes<'a> {
    pub(super) a: &'a Camera,
    pub(super) b: &'a Camera,
    /// The angles off axis in radians beyond which the lenses fold back.
    limits_rad: [f64; 2],
    /// Where a camera sees a point further than this from the other's pixel, it does not see it.
    diagonal_px: f64,
}

impl<'a> Eyes<'a> {
    pub(super) fn new(a: &'a Camera, b: &'a Camera) -> Self {
        let [width, height] = a.image_size.map(f64::from);
        let limits_rad = [a, b].map(|camera| camera.monotonic_limit().unwrap_or(f64::INFINITY));
        Self { a, b, limits_rad, diagonal_px: width.hypot(height) }
    }

    /// Returns what is seen at `pixel` at `distance` from either camera, or `None` if either has no ray there.
    pub(super) fn sight(&self, pixel: [f64; 2], distance: f64) -> Option<Sight> {
        let (point_in_a, point_in_b) =
            (self.a.unproject(pixel)? * distance, self.b.unproject(pixel)? * distance);
        let (pixel_in_a, pixel_in_b) = (self.a.project(&point_in_a)?, self.b.project(&point_in_b)?);
        Some(Sight { point_in_a, point_in_b, pixel_in_a, pixel_in_b })
    }

    /// Returns the residuals a to b and b to a in pixels, or `None` outside either lens's domain.
    fn residuals(&self, sight: &Sight, b_from_a: &Pose) -> Option<[[f64; 2]; 2]> {
        let in_b = self.b.project(&(*b_from_a * sight.point_in_a))?;
        let in_a = self.a.project(&(b_from_a.inverse() * sight.point_in_b))?;
        Some([minus(in_b, sight.pixel_in_b), minus(in_a, sight.pixel_in_a)])
    }

    /// Returns the residuals, or `None` where a lens is beyond its fold or out of all proportion:
    /// polynomials and planes run to infinity there.
    pub(super) fn seen_residuals(&self, sight: &Sight, b_from_a: &Pose) -> Option<[[f64; 2]; 2]> {
        let points = [b_from_a.inverse() * sight.point_in_b, *b_from_a * sight.point_in_a];
        let is_within =
            |(point, limit_rad): (Vector3<f64>, f64)| point.xy().norm().atan2(point.z) <= limit_rad;
        let residuals = points
            .into_iter()
            .zip(self.limits_rad)
            .all(is_within)
            .then(|| self.residuals(sight, b_from_a))??;
        residuals.iter().all(|[u, v]| u.hypot(*v) <= self.diagonal_px).then_some(residuals)
    }
}

/// The implied transform and how well it settled.
#[derive(Clone, Copy, Debug)]
pub(super) struct Implied {
    pub(super) b_from_a: Pose,
    pub(super) steps: usize,
    pub(super) last_step_px: f64,
}

/// There are too few points to fit a transform.
#[derive(Clone, Copy, Debug)]
pub(super) struct TooFew {
    pub(super) found: usize,
}

/// Returns the transform with the smallest robust sum of residuals both ways: a rotation at
/// infinity, a pose at a distance in metres.
pub(super) fn fit_implied(eyes: Eyes, sights: &[Sight], distance: Option<f64>) -> Result<Implied, TooFew> {
    let mut b_from_a = rotation_of_directions(sights);
    // The set of points stays: a step that takes one out of sight is cut short, so that the cost
    // never falls by losing points.
    let sights: Vec<Sight> =
        sights.iter().filter(|sight| eyes.seen_residuals(sight, &b_from_a).is_some()).copied().collect();
    if sights.len() < MIN_POINTS {
        return Err(TooFew { found: sights.len() });
    }
    let problem = Problem { eyes, sights: &sights, distance };
    let mut last_step_px = f64::INFINITY;
    let mut curvature = Curvature::OfSquares;
    for steps in 0..MAX_STEPS {
        let settled = Implied { b_from_a, steps, last_step_px };
        let Some((step, length_px, cost)) = problem.step(&b_from_a, curvature) else { return Ok(settled) };
        if length_px == 0.0 || (length_px < STEP_BELOW_PX && length_px >= last_step_px) {
            return Ok(Implied { last_step_px: length_px, ..settled });
        }
        // Lenses far apart leave large residuals, and the projections' own curvature counts.
        if length_px > SLOW * last_step_px {
            curvature = Curvature::Full;
        }
        last_step_px = length_px;
        match shorten(step, &b_from_a, |pose| {
            // Rounding may hide the last decreases.
            problem.cost(pose).is_some_and(|trial| trial <= cost * (1.0 + 1e-12))
        }) {
            Some(better) => b_from_a = better,
            None => return Ok(Implied { last_step_px, ..settled }),
        }
    }
    Ok(Implied { b_from_a, steps: MAX_STEPS, last_step_px })
}

/// Returns the rotation that best turns a's directions into b's: the start, defined however far apart they are.
///
/// From the identity, so that equal directions give exactly that.
fn rotation_of_directions(sights: &[Sight]) -> Pose {
    let mut b_from_a = Pose::identity();
    for _ in 0..50 {
        let (mut hessian, mut gradient) = (Matrix3::zeros(), Vector3::zeros());
        for sight in sights {
            let turned = b_from_a.rotation * sight.point_in_a.normalize();
            hessian += Matrix3::identity() - turned * turned.transpose();
            gradient += turned.cross(&sight.point_in_b.normalize());
        }
        let Some(turn) = hessian.cholesky().map(|factor| factor.solve(&gradient)) else { break };
        let mut step = Vector6::zeros();
        step.fixed_rows_mut::<3>(0).copy_from(&turn);
        if turn.norm() < 1e-12 {
            break;
        }
        b_from_a = b_from_a.perturbed(&step);
    }
    b_from_a
}

/// Returns the pose after the step, or after a part of it that is still acceptable.
fn shorten(step: Vector6<f64>, from: &Pose, is_acceptable: impl Fn(&Pose) -> bool) -> Option<Pose> {
    let fractions = (0..30).map(|halvings| 0.5f64.powi(halvings));
    fractions.map(|fraction| from.perturbed(&(step * fraction))).find(|pose| is_acceptable(pose))
}

/// Which Hessian a step takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Curvature {
    /// Without the projections' own curvature: Gauss and Newton's.
    OfSquares,
    /// With it: Newton's, by differences of gradients.
    Full,
}

/// What is minimised: half the robust sum of both residuals of all sights.
struct Problem<'a> {
    eyes: Eyes<'a>,
    sights: &'a [Sight],
    distance: Option<f64>,
}

impl Problem<'_> {
    /// Returns the cost, or `None` if a point is out of sight.
    fn cost(&self, b_from_a: &Pose) -> Option<f64> {
        let mut sum = 0.0;
        for sight in self.sights {
            let [ab, ba] = self.eyes.residuals(sight, b_from_a)?;
            sum += Loss::of(ab).value + Loss::of(ba).value;
        }
        Some(sum)
    }

    /// Returns a step in radians and metres, by how many pixels (root mean square) it moves the
    /// points, and the cost before it.
    fn step(&self, b_from_a: &Pose, curvature: Curvature) -> Option<(Vector6<f64>, f64, f64)> {
        let sums = self.sums(b_from_a)?;
        let full = match curvature {
            Curvature::OfSquares => None,
            Curvature::Full => {
                self.full_hessian(b_from_a).and_then(|hessian| solve_scaled(&hessian, &sums.gradient))
            }
        };
        // Far from the minimum the full Hessian may not be positive.
        let step = full.or_else(|| solve_scaled(&sums.hessian, &sums.gradient))?;
        let length_px = (-step.dot(&sums.gradient)).max(0.0) / (2 * self.sights.len()) as f64;
        Some((self.in_metres(&step), length_px.sqrt(), sums.cost))
    }

    /// Returns cost, gradient and Hessian of squares for a left perturbation with the translation in
    /// units of the distance, or `None` if a point is out of sight.
    fn sums(&self, b_from_a: &Pose) -> Option<Sums> {
        let mut sums = Sums { cost: 0.0, gradient: Vector6::zeros(), hessian: Matrix6::zeros() };
        let unit = self.distance.unwrap_or(0.0);
        let a_from_b = b_from_a.inverse();
        let rotation = a_from_b.rotation_matrix();
        let points_in_b: Vec<_> = self.sights.iter().map(|sight| *b_from_a * sight.point_in_a).collect();
        let points_in_a: Vec<_> = self.sights.iter().map(|sight| a_from_b * sight.point_in_b).collect();
        let seen_by_b = project_with_slopes(self.eyes.b, &points_in_b)?;
        let seen_by_a = project_with_slopes(self.eyes.a, &points_in_a)?;
        for (i, sight) in self.sights.iter().enumerate() {
            let (pixel, slope) = &seen_by_b[i];
            let (by_turn, by_shift) = (-skew(&points_in_b[i]), Matrix3::identity() * unit);
            sums.add(minus(*pixel, sight.pixel_in_b), slope, &by_turn, &by_shift);
            // With exp(d) on the left of b_from_a, exp(-d) is on the right of a_from_b.
            let (pixel, slope) = &seen_by_a[i];
            let (by_turn, by_shift) = (rotation * skew(&sight.point_in_b), rotation * -unit);
            sums.add(minus(*pixel, sight.pixel_in_a), slope, &by_turn, &by_shift);
        }
        Some(sums)
    }

    fn full_hessian(&self, b_from_a: &Pose) -> Option<Matrix6<f64>> {
        // Small enough for its square, large enough for the gradients' rounding.
        const DIFFERENCE: f64 = 1e-5;
        let n_unknowns = if self.distance.is_some() { 6 } else { 3 };
        let mut hessian = Matrix6::zeros();
        for i in 0..n_unknowns {
            let gradient = |length: f64| {
                let mut tangent = Vector6::zeros();
                tangent[i] = length;
                Some(self.sums(&b_from_a.perturbed(&self.in_metres(&tangent)))?.gradient)
            };
            let column = (gradient(DIFFERENCE)? - gradient(-DIFFERENCE)?) / (2.0 * DIFFERENCE);
            hessian.set_column(i, &column);
        }
        Some((hessian + hessian.transpose()) * 0.5)
    }

    fn in_metres(&self, step: &Vector6<f64>) -> Vector6<f64> {
        Vector6::from_fn(|i, _| if i < 3 { step[i] } else { step[i] * self.distance.unwrap_or(0.0) })
    }
}

/// Half the cost's sums over all residuals.
struct Sums {
    cost: f64,
    gradient: Vector6<f64>,
    hessian: Matrix6<f64>,
}

impl Sums {
    fn add(
        &mut self,
        residual: [f64; 2],
        slope: &[[f64; 3]; 2],
        by_turn: &Matrix3<f64>,
        by_shift: &Matrix3<f64>,
    ) {
        let rows = slope.map(|row| {
            let slope = Vector3::from(row).transpose();
            let (turn, shift) = (slope * by_turn, slope * by_shift);
            Vector6::new(turn[0], turn[1], turn[2], shift[0], shift[1], shift[2])
        });
        let loss = Loss::of(residual);
        let along = rows[0] * residual[0] + rows[1] * residual[1];
        self.cost += loss.value;
        self.gradient += along * loss.slope;
        self.hessian += (rows[0] * rows[0].transpose() + rows[1] * rows[1].transpose()) * loss.slope
            + along * along.transpose() * (2.0 * loss.curvature);
    }
}

/// Returns the step that leads to the minimum of the quadratic, or `None` if it has none.
fn solve_scaled(hessian: &Matrix6<f64>, gradient: &Vector6<f64>) -> Option<Vector6<f64>> {
    let scale = Vector6::from_fn(|i, _| match hessian[(i, i)] {
        diagonal if diagonal > 0.0 => 1.0 / diagonal.sqrt(),
        _ => 1.0,
    });
    let mut scaled = Matrix6::from_fn(|i, j| hessian[(i, j)] * scale[i] * scale[j]);
    for i in 0..6 {
        // Keeps directions that move no pixel from growing; the minimum stays where it is.
        // At infinity the translation has no derivative, and a one makes it stay at zero.
        scaled[(i, i)] = if scaled[(i, i)] == 0.0 { 1.0 } else { scaled[(i, i)] + 1e-12 };
    }
    let step = -scaled.cholesky()?.solve(&gradient.component_mul(&scale));
    Some(step.component_mul(&scale))
}

/// Half the pseudo-Huber loss of a residual: `c² (sqrt(1 + s/c²) - 1)` of its squared length s, and
/// twice its first two derivatives by s.
struct Loss {
    value: f64,
    slope: f64,
    curvature: f64,
}

impl Loss {
    fn of([u, v]: [f64; 2]) -> Self {
        let square = u * u + v * v;
        let root = (1.0 + square / (LOSS_PX * LOSS_PX)).sqrt();
        Self {
            // Written so that nothing cancels for small residuals.
            value: square / (root + 1.0),
            slope: 1.0 / root,
            curvature: -0.5 / (LOSS_PX * LOSS_PX * root * root * root),
        }
    }
}

/// A pixel, and its derivatives by the point that is seen there.
type Seen = ([f64; 2], [[f64; 3]; 2]);

/// Returns the pixels that see the points, with their derivatives by the points, or `None` if any is
/// outside the lens's domain.
fn project_with_slopes(camera: &Camera, points_in_cam: &[Vector3<f64>]) -> Option<Vec<Seen>> {
    struct Differentiate<'a>(&'a [f64], &'a [Vector3<f64>]);
    impl ModelVisitor for Differentiate<'_> {
        type Output = Option<Vec<Seen>>;
        fn visit<M: CameraModel>(self, model: M) -> Self::Output {
            let params: Vec<Dual<f64, 3>> = self.0.iter().map(|&param| Dual::fixed(param)).collect();
            let differentiate = |point: &Vector3<f64>| {
                let [u, v] =
                    model.project(&params, [0, 1, 2].map(|axis| Dual::variable(point[axis], axis)))?;
                Some(([u.value, v.value], [u.derivative, v.derivative]))
            };
            self.1.iter().map(differentiate).collect()
        }
    }
    camera.model.visit(Differentiate(&camera.params, points_in_cam))
}

fn minus(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0] - b[0], a[1] - b[1]]
}
