//! Sub-pixel corners: two blurred edges that cross, fitted to the grey values around a corner.
//!
//! With d₁ and d₂ the signed distances of a pixel from the edges and s₁ and s₂ the blur across them, h = d₁/s₁ and
//! k = d₂/s₂, the model is `b + bₓ x + b_y y + a g(h, k)`, where g is the mean of sgn(h + ξ) sgn(k + η) over normal ξ, η
//! whose correlation ρ is the cosine of the angle between the edges' normals: that is what Gaussian blur makes of four
//! sectors. It begins with E(h) E(k), E(x) = erf(x/√2), and goes on in powers of ρ with the tetrachoric series (Pearson
//! 1900). Each edge may be a parabola of known curvature. The fit is least squares by Gauss-Newton with damping; its
//! covariance, scaled by the residuals, tells how well the corner is known.

use std::sync::LazyLock;

use boresight_data::{GrayImage, GrayPixels};
use boresight_geometry::nalgebra::{SMatrix, SVector};

/// The unknowns: corner (2), angles of the edges (2), logarithms of the blurs (2), offset, slopes (2), amplitude.
const N: usize = 10;
/// The narrowest blur in pixels: a little more than that of the area of a pixel, 1/√12. Narrower edges fall between pixels.
const LEAST_BLUR_PX: f64 = 0.30;
/// The most pixels of a window along either axis.
const MOST_ACROSS: f64 = 29.0;
/// What the model itself leaves, in pixels: on rendered boards almost free of noise the corners still scatter by this.
const MODEL_SIGMA_PX: f64 = 0.005;

/// What is known of a corner before it is fitted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Start {
    /// Where it is, to within a pixel or so.
    pub pixel: [f64; 2],
    /// The step to the next corner along either axis of the lattice, in pixels.
    pub steps_px: [[f64; 2]; 2],
    /// Half the second difference of the corners along either axis, in pixels: how the edges bend.
    pub bends_px: [[f64; 2]; 2],
    /// Whether the square between the two steps is bright.
    pub is_bright: bool,
    /// The standard deviation of the blur in pixels.
    pub blur_px: f64,
    /// The share of a step that the window reaches.
    pub reach: f64,
    /// What of the window is not looked at.
    pub hole: Option<Hole>,
    /// What an earlier fit of this corner found.
    pub before: Option<Shape>,
}

/// The inner parts of two opposite squares around a corner, where a marker may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Hole {
    /// Whether the squares are the bright ones.
    pub is_bright: bool,
    /// How far from the edges of a square it begins, in steps.
    pub from: f64,
}

/// The unknowns of a corner beside its place: angles of the edges, logarithms of the blurs, offset, slopes, amplitude.
type Shape = [f64; N - 2];

/// A fitted corner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Fit {
    /// Where it is.
    pub pixel: [f64; 2],
    /// The standard deviation of either coordinate, as the residuals of the fit have it.
    pub sigma_px: f64,
    /// The mean blur of its edges in pixels.
    pub blur_px: f64,
    /// The difference between bright and dark in grey values.
    pub contrast: f64,
    /// The root mean square of the residuals in grey values.
    pub residual: f64,
    /// What a fit of this corner from near here begins with.
    pub shape: Option<Shape>,
}

/// Fits a corner, or returns `None` where the grey values do not look like one.
pub(crate) fn fit(image: &GrayImage, start: &Start) -> Option<Fit> {
    let window = Window::around(image, start)?;
    let mut x = window.first_guess(start)?;
    let mut damping = 1e-3;
    let mut normal = window.normal_equations(&x);
    for _ in 0..20 {
        let mut damped = normal.matrix;
        for i in 0..N {
            damped[(i, i)] *= 1.0 + damping;
        }
        let step = damped.cholesky()?.solve(&normal.gradient);
        let mut next = x - step;
        // Neither blur may vanish nor fill the window.
        for i in 4..6 {
            next[i] = next[i].clamp(LEAST_BLUR_PX.ln(), window.reach_px.max(0.5).ln());
        }
        let moved = next[0].hypot(next[1]);
        if moved.is_nan() || moved >= window.reach_px {
            return None;
        }
        let tried = window.normal_equations(&next);
        if tried.cost <= normal.cost {
            // Convergence is quadratic: what is left after such a step is far below any sigma.
            let is_done = damping <= 1e-3
                && (next - x).fixed_rows::<2>(0).norm() < 2e-3
                && normal.cost - tried.cost < 1e-3 * normal.cost;
            (x, normal) = (next, tried);
            damping = (damping * 0.1).max(1e-9);
            if is_done {
                break;
            }
        } else {
            damping *= 8.0;
            if damping > 1e6 {
                break;
            }
        }
    }
    let freedom = window.pixels.len().checked_sub(N).filter(|n| *n > 0)? as f64;
    let covariance = normal.matrix.cholesky()?.inverse() * (normal.cost / freedom);
    let blur_px = (0.5 * (x[4] + x[5])).exp();
    let variance = 0.5 * (covariance[(0, 0)] + covariance[(1, 1)])
        + MODEL_SIGMA_PX.powi(2)
        + aliasing_px(blur_px).powi(2);
    let sense = if start.is_bright { 1.0 } else { -1.0 };
    let fit = Fit {
        pixel: [window.origin[0] + x[0], window.origin[1] + x[1]],
        sigma_px: variance.sqrt(),
        blur_px,
        contrast: 2.0 * x[9] * sense,
        residual: (normal.cost / freedom).sqrt(),
        shape: Some(std::array::from_fn(|i| x[i + 2])),
    };
    let is_inside =
        (0..2).all(|axis| fit.pixel[axis] >= 1.0 && fit.pixel[axis] <= f64::from(image.size()[axis]) - 2.0);
    (fit.sigma_px.is_finite() && is_inside).then_some(fit)
}

/// Returns by how much edges of this blur may seem moved because they fall between pixels.
///
/// The first harmonic of a Gaussian edge under sampling at unit pitch is exp(-2 π² s²) and moves it by up to a 2 π-th of
/// that. It is halved, as edges that are not along rows or columns cross pixels at all phases.
fn aliasing_px(blur_px: f64) -> f64 {
    use std::f64::consts::PI;
    (-2.0 * (PI * blur_px).powi(2)).exp() / (4.0 * PI)
}

/// The grey values around a corner.
struct Window {
    /// The pixel that the coordinates below are relative to.
    origin: [f64; 2],
    /// Position and grey value.
    pixels: Vec<[f64; 3]>,
    /// Half the width of the window in pixels.
    reach_px: f64,
    /// The curvatures of the two edges per pixel, along the normals of the first guess.
    curvatures: [f64; 2],
}

struct Normal {
    matrix: SMatrix<f64, N, N>,
    gradient: SVector<f64, N>,
    cost: f64,
}

impl Window {
    fn around(image: &GrayImage, start: &Start) -> Option<Self> {
        match image.pixels() {
            GrayPixels::Eight(values) => Self::of(values, image.size(), start, f64::from),
            GrayPixels::Sixteen(values) => Self::of(values, image.size(), start, f64::from),
        }
    }

    /// Gathers the pixels whose coordinates in steps are within the reach.
    fn of<P: Copy>(values: &[P], size: [u32; 2], start: &Start, grey: impl Fn(P) -> f64) -> Option<Self> {
        let [a, b] = start.steps_px;
        let determinant = a[0] * b[1] - a[1] * b[0];
        let lengths = start.steps_px.map(|step| step[0].hypot(step[1]));
        // Of a square seen nearly from the side, little is left between its edges.
        if determinant.is_nan() || determinant.abs() <= 0.1 * lengths[0] * lengths[1] {
            return None;
        }
        // Wide edges need a wide window. They also need not be looked at in every row and column, sharp ones do.
        let gap = (1.2 * start.blur_px).clamp(1.0, 8.0).floor();
        let enough_px = (7.0 * start.blur_px + 6.0).min(0.5 * MOST_ACROSS * gap);
        let reach = lengths.map(|length| start.reach.min(enough_px / length).max(2.0 / length));
        let half = [0, 1].map(|axis| reach[0] * a[axis].abs() + reach[1] * b[axis].abs());
        let [width, height] = size.map(|side| side as usize);
        let low = [0, 1].map(|axis| (start.pixel[axis] - half[axis]).ceil().max(0.0) as usize);
        let high = [(0, width), (1, height)].map(|(axis, side)| {
            let last = (start.pixel[axis] + half[axis]).floor();
            if last < 0.0 { 0 } else { (last as usize + 1).min(side) }
        });
        let gap = gap as usize;
        // Blur brings what is in the hole nearer; a pixel beside the edge is always looked at.
        let hole_from = lengths.map(|length| match start.hole {
            Some(hole) => (hole.from - 2.5 * start.blur_px / length).max(1.0 / length),
            None => f64::INFINITY,
        });
        let is_hole_along = start.hole.is_some_and(|hole| hole.is_bright == start.is_bright);
        let origin = start.pixel.map(f64::round);
        let mut pixels = Vec::with_capacity(1024);
        for v in (low[1]..high[1]).step_by(gap) {
            for u in (low[0]..high[0]).step_by(gap) {
                let [x, y] = [u as f64 - start.pixel[0], v as f64 - start.pixel[1]];
                let along = [(x * b[1] - y * b[0]) / determinant, (a[0] * y - a[1] * x) / determinant];
                let is_in_hole = along[0].abs() > hole_from[0]
                    && along[1].abs() > hole_from[1]
                    && (along[0] * along[1] > 0.0) == is_hole_along;
                if along[0].abs() <= reach[0] && along[1].abs() <= reach[1] && !is_in_hole {
                    pixels.push([u as f64 - origin[0], v as f64 - origin[1], grey(values[v * width + u])]);
                }
            }
        }
        let curvatures = [0, 1].map(|i| {
            let (step, bend) = (start.steps_px[i], start.bends_px[i]);
            (step[0] * bend[1] - step[1] * bend[0]) / lengths[i].powi(3)
        });
        let reach_px = (reach[0] * lengths[0]).min(reach[1] * lengths[1]);
        (pixels.len() > 2 * N).then_some(Self { origin, pixels, reach_px, curvatures })
    }

    fn first_guess(&self, start: &Start) -> Option<SVector<f64, N>> {
        let n = self.pixels.len() as f64;
        let mean = self.pixels.iter().map(|pixel| pixel[2]).sum::<f64>() / n;
        let square = self.pixels.iter().map(|pixel| (pixel[2] - mean).powi(2)).sum::<f64>() / n;
        let sense = if start.is_bright { 1.0 } else { -1.0 };
        let angle = |step: [f64; 2]| step[1].atan2(step[0]);
        let blur = start.blur_px.max(LEAST_BLUR_PX).ln();
        let mut guess = SVector::from([
            start.pixel[0] - self.origin[0],
            start.pixel[1] - self.origin[1],
            angle(start.steps_px[0]),
            angle(start.steps_px[1]),
            blur,
            blur,
            mean,
            0.0,
            0.0,
            sense * square.sqrt(),
        ]);
        if let Some(before) = start.before {
            guess.fixed_rows_mut::<{ N - 2 }>(2).copy_from_slice(&before);
        }
        (square > 0.0).then_some(guess)
    }

    /// Returns `JᵀJ`, `Jᵀr` and `rᵀr` for residuals `model - seen`.
    fn normal_equations(&self, x: &SVector<f64, N>) -> Normal {
        let [(sin1, cos1), (sin2, cos2)] = [x[2].sin_cos(), x[3].sin_cos()];
        let [inverse1, inverse2] = [(-x[4]).exp(), (-x[5]).exp()];
        // The square between the two steps is where d₁ and d₂ are positive; this is minus ρ.
        let correlation = sin1 * sin2 + cos1 * cos2;
        let (rho, rho2, rho3) = (correlation, 0.5 * correlation.powi(2), correlation.powi(3) / 6.0);
        let table = &*TABLE;
        // Rows are padded to whole registers, and single precision is enough: the steps shrink with the residuals.
        let mut products = [[0.0f32; N + 2]; N + 1];
        let mut cost = 0.0;
        for &[u, v, seen] in &self.pixels {
            let (dx, dy) = (u - x[0], v - x[1]);
            let (along1, along2) = (dx * cos1 + dy * sin1, dx * cos2 + dy * sin2);
            let d1 = dy * cos1 - dx * sin1 - self.curvatures[0] * along1 * along1;
            let d2 = dx * sin2 - dy * cos2 + self.curvatures[1] * along2 * along2;
            let (h, k) = (d1 * inverse1, d2 * inverse2);
            let ([e1, p1], [e2, p2]) = (table.at(h), table.at(k));
            // p is 2 φ, so the series' 4 φ φ is p p.
            let series = p1 * p2 * (rho2 * h * k - rho - rho3 * (h * h - 1.0) * (k * k - 1.0));
            let model = e1 * e2 + series;
            let (by_d1, by_d2) = (x[9] * p1 * e2 * inverse1, x[9] * p2 * e1 * inverse2);
            let residual = x[6] + x[7] * u + x[8] * v + x[9] * model - seen;
            let row: [f32; N + 2] = [
                (by_d1 * sin1 - by_d2 * sin2) as f32,
                (by_d2 * cos2 - by_d1 * cos1) as f32,
                (-by_d1 * along1) as f32,
                (by_d2 * along2) as f32,
                (-by_d1 * d1) as f32,
                (-by_d2 * d2) as f32,
                1.0,
                u as f32,
                v as f32,
                model as f32,
                residual as f32,
                0.0,
            ];
            cost += residual * residual;
            for (sums, &a) in products.iter_mut().zip(&row) {
                for (sum, &b) in sums.iter_mut().zip(&row) {
                    *sum += a * b;
                }
            }
        }
        let matrix = SMatrix::from_fn(|i, j| f64::from(products[i.min(j)][i.max(j)]));
        Normal { matrix, gradient: SVector::from_fn(|i, _| f64::from(products[i][N])), cost }
    }
}

/// erf(x/√2) and its derivative, tabulated.
struct Table {
    values: Vec<[f64; 2]>,
}

/// Beyond this the error function is one to nine digits.
const TABLE_END: f64 = 6.0;
const TABLE_STEPS_PER_UNIT: f64 = 128.0;

static TABLE: LazyLock<Table> = LazyLock::new(|| {
    let count = (TABLE_END * TABLE_STEPS_PER_UNIT) as usize + 2;
    let density = |x: f64| (2.0 / std::f64::consts::PI).sqrt() * (-0.5 * x * x).exp();
    let mut values = Vec::with_capacity(count);
    let mut sum = 0.0;
    for i in 0..count {
        let x = i as f64 / TABLE_STEPS_PER_UNIT;
        values.push([sum, density(x)]);
        // Simpson's rule over a step of 1/128 is good to 1e-12.
        let end = x + 1.0 / TABLE_STEPS_PER_UNIT;
        sum += (density(x) + 4.0 * density(0.5 * (x + end)) + density(end)) / (6.0 * TABLE_STEPS_PER_UNIT);
    }
    Table { values }
});

impl Table {
    /// Returns erf(x/√2) and its derivative.
    #[inline]
    fn at(&self, x: f64) -> [f64; 2] {
        let scaled = x.abs() * TABLE_STEPS_PER_UNIT;
        let i = scaled as usize;
        if i + 1 >= self.values.len() {
            return [1f64.copysign(x), 0.0];
        }
        let share = scaled - i as f64;
        let ([e0, p0], [e1, p1]) = (self.values[i], self.values[i + 1]);
        [(e0 + share * (e1 - e0)).copysign(x), p0 + share * (p1 - p0)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_is_the_error_function() {
        // erf(x/√2) to 16 digits, from Python's math.erf.
        for (x, expected) in
            [(0.0, 0.0), (0.3, 0.23582284437790524), (1.0, 0.6826894921370859), (4.1, 0.9999586849861749)]
        {
            for sign in [1.0, -1.0] {
                let [value, slope] = TABLE.at(sign * x);
                let density = (2.0 / std::f64::consts::PI).sqrt() * (-0.5 * x * x).exp();
                // Between entries 1/128 apart, chords are off by at most 4e-6.
                assert!(
                    (value - sign * expected).abs() < 5e-6 && (slope - density).abs() < 1e-5,
                    "{x}: {value} {slope}"
                );
            }
        }
        assert_eq!((TABLE.at(50.0), TABLE.at(-50.0)), ([1.0, 0.0], [-1.0, 0.0]));
    }

    #[test]
    fn edges_that_are_bent_as_told_leave_the_corner_in_place() {
        // A corner between edges that are parabolas, 0.6 pixels out at the end of a step of 20 pixels.
        let (at, blur, bend) = ([30.3, 29.6], 1.1, 0.6);
        let value = |i: usize| {
            let (x, y) = ((i % 60) as f64 - at[0], (i / 60) as f64 - at[1]);
            let curvature = bend / 400.0;
            let soft = |distance: f64| TABLE.at(distance / blur)[0];
            (120.0 + 80.0 * soft(y - curvature * x * x) * soft(x - curvature * y * y)).round() as u8
        };
        let image = GrayImage::new([60, 60], GrayPixels::Eight((0..3600).map(value).collect())).unwrap();
        let start = Start {
            pixel: [30.8, 29.2],
            steps_px: [[20.0, 0.0], [0.0, 20.0]],
            bends_px: [[0.0, bend], [bend, 0.0]],
            is_bright: true,
            blur_px: 1.0,
            reach: 0.55,
            hole: None,
            before: None,
        };
        let error = |start: &Start| {
            let fit = fit(&image, start).unwrap();
            (fit.pixel[0] - at[0]).hypot(fit.pixel[1] - at[1])
        };
        assert!(error(&start) < 0.01, "{}", error(&start));
        let straight = Start { bends_px: [[0.0; 2]; 2], ..start };
        assert!(error(&straight) > 0.03, "{}", error(&straight));
        assert!(fit(&image, &Start { is_bright: false, ..start }).is_none_or(|fit| fit.contrast < 0.0));
        assert_eq!(fit(&image, &Start { steps_px: [[20.0, 0.0], [20.0, 0.1]], ..start }), None);
    }
}
