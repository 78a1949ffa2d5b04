//! The lens plug: what a lens model must say, and what it gets for that.

use boresight_geometry::{Dual, MAX_LANES, Scalar};

/// The largest number of parameters of a model whose points depend on all of them.
///
/// A model with [`LocalSupport`] has any number; a point depends on few of them.
pub const MAX_PARAMS: usize = 18;

/// The largest number of knots that a point depends on: four by four.
pub const MAX_LOCAL: usize = 16;

/// What a lens parameter is for; regularisation and reports go by it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ParamGroup {
    /// `fx` or `fy`, in pixels.
    Focal,
    /// `cx` or `cy`, in pixels.
    Centre,
    /// A radial coefficient.
    Radial,
    /// A coefficient in a radial polynomial's denominator, or one that trades against it.
    Rational,
    /// A tangential (decentring) coefficient.
    Tangential,
    /// A thin-prism coefficient.
    ThinPrism,
    /// A tilt of the sensor or of the optical axis, in radians.
    Tilt,
    /// What a sphere model mixes two projections by: `xi`, `alpha`, `beta`.
    Sphere,
    /// A coefficient of the entrance pupil's motion, in metres.
    Pupil,
    /// A coefficient of a spline, which moves a part of the image.
    Spline,
}

/// Which lens parameters a point depends on, for a lens whose parameters lie on a grid of knots.
///
/// A knot has two parameters: the first moves the image along x, the second along y, both in units of
/// the focal length. A point depends on the core and on a square of knots around it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LocalSupport {
    /// The number of knots in a row and in a column of the square.
    pub side: usize,
    /// The number of knots in a row of the grid; after the core, knots are stored row by row.
    pub columns: usize,
    /// The number of rows of the grid.
    pub rows: usize,
}

impl LocalSupport {
    /// Returns the parameter that moves the image along `axis` (0 or 1) at knot `k` of the square, row
    /// by row, whose first parameter is `first`.
    #[inline(always)]
    pub fn param(&self, first: usize, k: usize, axis: usize) -> usize {
        first + 2 * (k / self.side * self.columns + k % self.side) + axis
    }
}

/// A pixel with its derivatives, for a lens with [`LocalSupport`].
#[derive(Clone, Copy, Debug)]
pub struct LocalLinear<T> {
    /// The pixel.
    pub pixel: [T; 2],
    /// `d_point[row][axis]` is the derivative of pixel coordinate `row` by the point.
    pub d_point: [[T; 3]; 2],
    /// In each lane, the first parameter of the square of knots: that of its corner, along x.
    pub first: [usize; MAX_LANES],
    /// The weight of each knot of the square, row by row; those past the square are zero.
    ///
    /// The derivative of pixel coordinate `row` by [`LocalSupport::param`]`(first, k, row)` is
    /// `params[row] * weights[k]`; by the other parameter of the knot it is zero.
    pub weights: [T; MAX_LOCAL],
}

/// A central lens model: from a point in the camera frame to a pixel.
///
/// Every model begins with the core `fx, fy, cx, cy`, and its pixel is `(fx * x + cx, fy * y + cy)`
/// of some image-plane point `(x, y)` that depends on the other ("lens") parameters and the point.
/// The conformance suite holds every registered model to this.
pub trait CameraModel: Copy + Send + Sync + 'static {
    /// The name in files and on the command line.
    const NAME: &'static str;

    /// What the text after the name and a colon looks like, for a model that has a configuration.
    const CONFIGURATION: Option<&'static str> = None;

    /// Whether [`linearize`](Self::linearize) is short enough to become part of the loop over corners;
    /// otherwise that loop calls it.
    const IS_INLINED: bool = false;

    /// The side of a point's [`local_support`](Self::local_support), of a model that has one.
    const LOCAL_SIDE: Option<usize> = None;

    /// Returns the model that a configuration describes, or `None` if the text is none.
    ///
    /// What is configured is part of the model and never solved for.
    fn configured(text: &str) -> Option<Self> {
        let _ = text;
        None
    }

    /// Returns the configuration as [`configured`](Self::configured) reads it.
    fn configuration(&self) -> Option<String> {
        None
    }

    /// Tells whether the configuration says all that it takes to project.
    fn is_complete(&self) -> bool {
        true
    }

    /// Returns the model with what its configuration leaves open chosen so that the model covers
    /// `directions` in the camera frame. What is chosen stays.
    fn completed(&self, directions: &[[f64; 3]]) -> Self {
        let _ = directions;
        *self
    }

    /// Returns the number of parameters, the core included.
    fn param_count(&self) -> usize;

    /// Returns the name of each parameter, as its own community writes it.
    fn param_names(&self) -> Vec<&'static str>;

    /// Returns what each parameter is for.
    fn param_groups(&self) -> Vec<ParamGroup>;

    /// Returns the pixel that sees `point_in_cam`, or `None` outside the model's domain
    /// (for SIMD lanes: when any lane is outside).
    fn project<T: Scalar>(&self, params: &[T], point_in_cam: [T; 3]) -> Option<[T; 2]>;

    /// Returns the pixel as [`project`](Self::project) does, and its derivatives.
    ///
    /// `d_point[row][axis]` is the derivative of pixel coordinate `row` by the point;
    /// `d_lens[row][i]` that by the lens parameter `4 + i`. Derivatives by the core are the
    /// caller's: they follow from the pixel. Dual numbers provide this; a closed form is an override.
    #[inline(always)]
    fn linearize<T: Scalar>(
        &self,
        params: &[f64],
        point_in_cam: [T; 3],
        d_point: &mut [[T; 3]; 2],
        d_lens: [&mut [T]; 2],
    ) -> Option<[T; 2]> {
        linearize_with_duals(self, params, point_in_cam, d_point, d_lens)
    }

    /// Returns which lens parameters a point depends on; `None` is all of them.
    fn local_support(&self) -> Option<LocalSupport> {
        None
    }

    /// Returns the pixel as [`project`](Self::project) does, and its derivatives by the point and by
    /// those lens parameters that it depends on; `None` also for a lens without local support.
    #[inline(always)]
    fn linearize_locally<T: Scalar>(&self, params: &[f64], point_in_cam: [T; 3]) -> Option<LocalLinear<T>> {
        let _ = (params, point_in_cam);
        None
    }

    /// Returns the parameters with this core whose projection follows `pixel_of`, another lens's, or `None`
    /// for a model without [`local_support`](Self::local_support), or where `pixel_of` fails.
    ///
    /// It does so as well as the model's grid resolves it, and wherever the grid is.
    fn following(&self, core: [f64; 4], pixel_of: &dyn Fn([f64; 3]) -> Option<[f64; 2]>) -> Option<Vec<f64>> {
        let _ = (core, pixel_of);
        None
    }

    /// Returns a point in the camera frame on the ray that `pixel` sees, in no particular length,
    /// or `None` if no ray of the model's domain projects there.
    fn unproject(&self, params: &[f64], pixel: [f64; 2]) -> Option<[f64; 3]>;

    /// Returns the largest angle off the optical axis, in radians, up to which the radial part of
    /// the model is one-to-one: the image radius still grows with the angle. `None` is unlimited
    /// within the model's own domain.
    fn monotonic_limit(&self, params: &[f64]) -> Option<f64>;

    /// Returns the parameters with which the lens is free of distortion (or as near as it goes),
    /// for the core `[fx, fy, cx, cy]`.
    fn undistorted(&self, core: [f64; 4]) -> Vec<f64>;

    /// Returns the parameters of a lens that sees beyond 90 degrees, if the model can, and whose image
    /// near the axis is that of the core `[fx, fy, cx, cy]`: a start from which any lens is within reach.
    fn wide(&self, core: [f64; 4]) -> Vec<f64> {
        self.undistorted(core)
    }

    /// Returns instances with realistic parameters for a 1600x1200 image; the conformance suite runs on each.
    fn examples() -> Vec<(Self, Vec<f64>)>;
}

/// Differentiates a model's projection through dual numbers, four directions at a time.
#[inline(always)]
pub(crate) fn linearize_with_duals<M: CameraModel, T: Scalar>(
    model: &M,
    params: &[f64],
    point_in_cam: [T; 3],
    d_point: &mut [[T; 3]; 2],
    d_lens: [&mut [T]; 2],
) -> Option<[T; 2]> {
    const LANES: usize = 4;
    let [d_lens_u, d_lens_v] = d_lens;
    let n_directions = 3 + d_lens_u.len();
    let mut pixel = [point_in_cam[0]; 2];
    let mut dual_params = [Dual::<T, LANES>::fixed(point_in_cam[0].like(0.0)); MAX_PARAMS];
    let dual_params = &mut dual_params[..params.len()];
    for first in (0..n_directions).step_by(LANES) {
        for (i, (dual, &param)) in dual_params.iter_mut().zip(params).enumerate() {
            let param = point_in_cam[0].like(param);
            *dual = if i < 4 { Dual::fixed(param) } else { seeded(param, 3 + i - 4, first) };
        }
        let [x, y, z] = point_in_cam;
        let point = [seeded(x, 0, first), seeded(y, 1, first), seeded(z, 2, first)];
        let [u, v] = model.project(dual_params, point)?;
        pixel = [u.value, v.value];
        for lane in 0..LANES.min(n_directions - first) {
            let (du, dv) = (u.derivative[lane], v.derivative[lane]);
            let direction = first + lane;
            match direction.checked_sub(3) {
                None => (d_point[0][direction], d_point[1][direction]) = (du, dv),
                Some(i) => (d_lens_u[i], d_lens_v[i]) = (du, dv),
            }
        }
    }
    Some(pixel)
}

/// Differentiates a model's projection as [`linearize_with_duals`] does, one lane after the other: for
/// formulas whose functions have no SIMD instructions, and whose code is long.
#[inline(always)]
pub(crate) fn linearize_lane_by_lane<M: CameraModel, T: Scalar>(
    model: &M,
    params: &[f64],
    point_in_cam: [T; 3],
    d_point: &mut [[T; 3]; 2],
    d_lens: [&mut [T]; 2],
) -> Option<[T; 2]> {
    let [d_lens_u, d_lens_v] = d_lens;
    let n_lens = d_lens_u.len();
    let mut pixel = [point_in_cam[0]; 2];
    for lane in 0..T::LANES {
        let [x, y, z] = point_in_cam;
        let one = linearize_one(model, params, [x.lane(lane), y.lane(lane), z.lane(lane)])?;
        for row in 0..2 {
            pixel[row] = pixel[row].with_lane(lane, x.like(one.pixel[row]));
            for (axis, by_axis) in d_point[row].iter_mut().enumerate() {
                *by_axis = by_axis.with_lane(lane, x.like(one.d_point[row][axis]));
            }
        }
        for i in 0..n_lens {
            d_lens_u[i] = d_lens_u[i].with_lane(lane, x.like(one.d_lens[0][i]));
            d_lens_v[i] = d_lens_v[i].with_lane(lane, x.like(one.d_lens[1][i]));
        }
    }
    Some(pixel)
}

/// A pixel with its derivatives, for one point.
struct One {
    pixel: [f64; 2],
    d_point: [[f64; 3]; 2],
    d_lens: [[f64; MAX_PARAMS]; 2],
}

#[inline(never)]
fn linearize_one<M: CameraModel>(model: &M, params: &[f64], point_in_cam: [f64; 3]) -> Option<One> {
    let mut one = One { pixel: [0.0; 2], d_point: [[0.0; 3]; 2], d_lens: [[0.0; MAX_PARAMS]; 2] };
    let n_lens = params.len() - 4;
    let [u, v] = &mut one.d_lens;
    let d_lens = [&mut u[..n_lens], &mut v[..n_lens]];
    one.pixel = linearize_with_duals(model, params, point_in_cam, &mut one.d_point, d_lens)?;
    Some(one)
}

/// Returns a variable if `direction` is among the `N` from `first` on, else a constant.
#[inline(always)]
fn seeded<T: Scalar, const N: usize>(value: T, direction: usize, first: usize) -> Dual<T, N> {
    if direction >= first && direction < first + N {
        Dual::variable(value, direction - first)
    } else {
        Dual::fixed(value)
    }
}
