//! Sub-pixel corners: two blurred edges that cross, fitted to the grey values around a corner.
//!
//! With d₁ and d₂ the signed distances of a pixel from the edges and s₁ and s₂ the blur across them, h = d₁/s₁ and
//! k = d₂/s₂, the model is `b + bₓ x + b_y y + a g(h, k)`, where g is the mean of sgn(h + ξ) sgn(k + η) over normal ξ, η
//! whose correlation ρ is the cosine of the angle between the edges' normals: that is what Gaussian blur makes of four
//! sectors. It begins with E(h) E(k), E(x) = erf(x/√2), and goes on in powers of ρ with the tetrachoric series (Pearson
//! 1900). Each edge may be a parabola of known curvature. The fit is least squares by Gauss-Newton, of whose steps a share
//! is taken; its covariance, scaled by the residuals, tells how well the corner is known.

mod normal;

use boresight_data::{GrayImage, GrayPixels};
use boresight_geometry::nalgebra::SVector;

use self::normal::{Normal, Pixels};

/// The unknowns: corner (2), angles of the edges (2), logarithms of the blurs (2), offset, slopes (2), amplitude.
const N: usize = 10;
/// The narrowest blur in pixels: a little more than that of the area of a pixel, 1/√12. Narrower edges fall between pixels.
const LEAST_BLUR_PX: f64 = 0.30;
/// The widest window of a corner that is not blurred, in pixels; blur widens it.
const MOST_ACROSS: f64 = 29.0;
/// Pixels that are looked at lie on a lattice: one in so many, and from one row to the next by how many further. Each row and
/// each column has its share, so that sharp edges are met at all phases, and they are as far from each other as can be.
const LATTICES: [[usize; 2]; 8] = [[1, 0], [2, 1], [3, 1], [5, 2], [8, 3], [10, 3], [13, 5], [21, 8]];
/// The lattice of the widest windows: with it, all of a square of eight times [`MOST_ACROSS`] has room.
const WIDEST: [usize; 2] = [34, 13];
/// The least difference between the bright and the dark sectors of a window, as a share of the spread of its grey values. A
/// sharp corner in its middle has two, one that is off by a third of the window both ways a fifth of that.
const SECTOR_SHARE: f64 = 0.1;
/// What the model itself leaves, in pixels: on rendered boards almost free of noise the corners still scatter by this.
const MODEL_SIGMA_PX: f64 = 0.005;

/// How well a corner is fitted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Enough {
    /// A step that moves the corner by fewer pixels may be the last.
    step_px: f64,
    /// So may one that takes less than this share off the sum of squares.
    gain_share: f64,
    /// How many pixels of a window are looked at, at most.
    pixels: usize,
}

/// All of a sharp corner is looked at, until nothing is left to be gained.
pub(crate) const FINE: Enough = Enough { step_px: 2e-3, gain_share: 1e-3, pixels: 1500 };
/// What is enough for a corner that will be fitted again.
pub(crate) const ROUGH: Enough = Enough { step_px: 0.1, gain_share: 1e-2, pixels: 1000 };

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
    /// How well it is to be fitted.
    pub enough: Enough,
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
    let mut pixels = Pixels::none();
    let mut window = Window::around(image, start, &mut pixels)?;
    let mut x = window.first_guess(start);
    let mut normal = window.normal_equations(&x);
    let mut step = full_step(&normal, &x)?;
    // What of a full step is taken: where the model leaves much, Gauss-Newton oversteps by the same share each time.
    let mut share = 1.0;
    for _ in 0..20 {
        let mut next = x - share * step;
        // Neither blur may vanish nor fill the window.
        for i in 4..6 {
            next[i] = next[i].clamp(LEAST_BLUR_PX.ln(), window.reach_px.max(0.5).ln());
        }
        let from_origin_px = next[0].hypot(next[1]);
        if from_origin_px.is_nan() || from_origin_px >= window.reach_px {
            return None;
        }
        let full_gain = normal.gradient.dot(&step);
        let gain = share * full_gain;
        let moved_px = (next - x).fixed_rows::<2>(0).norm();
        // What is left after such a step is far below any sigma, and what it gains is as foretold.
        if moved_px < start.enough.step_px && full_gain < start.enough.gain_share * normal.cost {
            x = next;
            normal.cost -= gain;
            break;
        }
        let tried = window.normal_equations(&next);
        // Single precision tells costs apart to a few millionths.
        let is_told = gain > 1e-4 * normal.cost;
        let is_better = tried.cost <= normal.cost * (1.0 + 1e-5);
        // Along a step the cost is nearly a parabola: its slope is known at one end, its height at both.
        if is_told {
            let bend = tried.cost - normal.cost + 2.0 * gain;
            share *= if bend > 0.0 { (gain / bend).clamp(0.1, 2.0) } else { 2.0 };
            share = share.min(1.0);
        }
        if is_better {
            (x, normal) = (next, tried);
            step = full_step(&normal, &x)?;
        } else if !is_told {
            break;
        }
    }
    let freedom = window.pixels.count.checked_sub(N).filter(|n| *n > 0)? as f64;
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
        contrast: 2.0 * x[9] * sense * window.spread,
        residual: (normal.cost / freedom).sqrt() * window.spread,
        shape: Some(window.shape(&x)),
    };
    let is_inside =
        (0..2).all(|axis| fit.pixel[axis] >= 1.0 && fit.pixel[axis] <= f64::from(image.size()[axis]) - 2.0);
    (fit.sigma_px.is_finite() && is_inside).then_some(fit)
}

/// Returns by what the unknowns at `x` are too large, were the model linear.
fn full_step(normal: &Normal, x: &SVector<f64, N>) -> Option<SVector<f64, N>> {
    let step = normal.matrix.cholesky()?.solve(&normal.gradient);
    // What a blur at its least would still lose is not the others' to make up for.
    let is_held = |i: &usize| x[*i] <= LEAST_BLUR_PX.ln() && step[*i] > 0.0;
    if ![4, 5].iter().any(is_held) {
        return Some(step);
    }
    let (mut matrix, mut gradient) = (normal.matrix, normal.gradient);
    for i in [4, 5].into_iter().filter(is_held) {
        matrix.row_mut(i).fill(0.0);
        matrix.column_mut(i).fill(0.0);
        (matrix[(i, i)], gradient[i]) = (1.0, 0.0);
    }
    Some(matrix.cholesky()?.solve(&gradient))
}

/// Returns by how much edges of this blur may seem moved because they fall between pixels.
///
/// The first harmonic of a Gaussian edge under sampling at unit pitch is exp(-2 π² s²) and moves it by up to a 2 π-th of
/// that. It is halved, as edges that are not along rows or columns cross pixels at all phases.
fn aliasing_px(blur_px: f64) -> f64 {
    use std::f64::consts::PI;
    (-2.0 * (PI * blur_px).powi(2)).exp() / (4.0 * PI)
}

/// The grey values around a corner, less their mean and in units of their spread.
struct Window<'a> {
    /// The pixel that the coordinates below are relative to.
    origin: [f64; 2],
    pixels: &'a mut Pixels,
    mean: f64,
    spread: f64,
    /// Half the width of the window in pixels.
    reach_px: f64,
    /// The curvatures of the two edges per pixel, along the normals of the first guess.
    curvatures: [f64; 2],
}

impl<'a> Window<'a> {
    fn around(image: &GrayImage, start: &Start, pixels: &'a mut Pixels) -> Option<Self> {
        match image.pixels() {
            GrayPixels::Eight(values) => Self::of(values, image.size(), start, pixels),
            GrayPixels::Sixteen(values) => Self::of(values, image.size(), start, pixels),
        }
    }

    /// Gathers the pixels whose coordinates in steps are within the reach.
    fn of<P: Copy + Into<f64>>(
        values: &[P],
        size: [u32; 2],
        start: &Start,
        pixels: &'a mut Pixels,
    ) -> Option<Self> {
        let [a, b] = start.steps_px;
        let determinant = a[0] * b[1] - a[1] * b[0];
        let lengths = start.steps_px.map(|step| step[0].hypot(step[1]));
        // Of a square seen nearly from the side, little is left between its edges.
        if determinant.is_nan() || determinant.abs() <= 0.1 * lengths[0] * lengths[1] {
            return None;
        }
        // The longer the edges that are seen, the better they average noise and, where they are sharp, how they fall between
        // pixels: the window is as wide as can be, and wider where edges are.
        let wider = (1.2 * start.blur_px).clamp(1.0, 8.0).floor();
        let enough_px = 0.5 * MOST_ACROSS * wider;
        let reach = lengths.map(|length| start.reach.min(enough_px / length).max(2.0 / length));
        let half = [0, 1].map(|axis| reach[0] * a[axis].abs() + reach[1] * b[axis].abs());
        let [width, height] = size.map(|side| side as usize);
        let low = [0, 1].map(|axis| (start.pixel[axis] - half[axis]).ceil().max(0.0) as usize);
        let high = [(0, width), (1, height)].map(|(axis, side)| {
            let last = (start.pixel[axis] + half[axis]).floor();
            if last < 0.0 { 0 } else { (last as usize + 1).min(side) }
        });
        let area = 4.0 * reach[0] * reach[1] * determinant.abs();
        let is_sparse = |[one_in, _]: &&[usize; 2]| area <= (one_in * start.enough.pixels) as f64;
        let [one_in, further] = *LATTICES.iter().find(is_sparse).unwrap_or(&WIDEST);
        // Blur brings what is in the hole nearer; a pixel beside the edge is always looked at.
        let hole_from = lengths.map(|length| match start.hole {
            Some(hole) => (hole.from - 2.5 * start.blur_px / length).max(1.0 / length),
            None => f64::INFINITY,
        });
        let is_hole_along = start.hole.is_some_and(|hole| hole.is_bright == start.is_bright);
        let origin = start.pixel.map(f64::round);
        // Sums and counts of the grey values in the sectors: both bright or both dark, before and after along each axis.
        let (mut sums, mut counts) = ([0.0f64; 4], [0.0f64; 4]);
        // Along a row, either coordinate in steps is linear in x.
        let slopes = [b[1] / determinant, -a[1] / determinant];
        for v in low[1]..high[1] {
            let y = v as f64 - start.pixel[1];
            let offsets = [-y * b[0] / determinant, a[0] * y / determinant];
            let (mut from, mut to) = (low[0] as f64, high[0] as f64 - 1.0);
            for axis in 0..2 {
                if let [Some(begin), Some(end)] = crossings(slopes[axis], offsets[axis], reach[axis]) {
                    from = from.max(begin + start.pixel[0]);
                    to = to.min(end + start.pixel[0]);
                } else if offsets[axis].abs() > reach[axis] {
                    to = f64::NEG_INFINITY;
                }
            }
            if to < from {
                continue;
            }
            // The lattice is the image's own: columns are counted from its left, rows from its top.
            let from = from.ceil() as usize;
            let skipped = (further * v + one_in - from % one_in) % one_in;
            for u in (from + skipped..=to.floor() as usize).step_by(one_in) {
                let x = u as f64 - start.pixel[0];
                let along = [slopes[0] * x + offsets[0], slopes[1] * x + offsets[1]];
                let is_in_hole = along[0].abs() > hole_from[0]
                    && along[1].abs() > hole_from[1]
                    && (along[0] * along[1] > 0.0) == is_hole_along;
                if !is_in_hole {
                    let value: f64 = values[v * width + u].into();
                    let sector = 2 * usize::from(along[0] > 0.0) + usize::from(along[1] > 0.0);
                    sums[sector] += value;
                    counts[sector] += 1.0;
                    pixels.push(u as f64 - origin[0], v as f64 - origin[1], value);
                }
            }
        }
        let curvatures = [0, 1].map(|i| {
            let (step, bend) = (start.steps_px[i], start.bends_px[i]);
            (step[0] * bend[1] - step[1] * bend[0]) / lengths[i].powi(3)
        });
        let reach_px = (reach[0] * lengths[0]).min(reach[1] * lengths[1]);
        let [mean, spread] = pixels.normalise();
        // The sectors 0 and 3 have one colour, 1 and 2 the other, or it is no corner and need not be fitted.
        let sense = if start.is_bright { 1.0 } else { -1.0 };
        let [a, b, c, d] = [0, 1, 2, 3].map(|i| sense * sums[i] / f64::max(counts[i], 1.0));
        let is_cut = counts.contains(&0.0);
        let is_corner = is_cut || a.min(d) - b.max(c) > SECTOR_SHARE * spread;
        (pixels.count > 2 * N && spread > 0.0 && is_corner).then_some(Self {
            origin,
            pixels,
            mean,
            spread,
            reach_px,
            curvatures,
        })
    }

    fn first_guess(&self, start: &Start) -> SVector<f64, N> {
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
            0.0,
            0.0,
            0.0,
            sense,
        ]);
        if let Some([angle1, angle2, blur1, blur2, offset, slope_u, slope_v, amplitude]) = start.before {
            let [offset, slope_u, slope_v, amplitude] =
                [offset - self.mean, slope_u, slope_v, amplitude].map(|grey| grey / self.spread);
            let before = [angle1, angle2, blur1, blur2, offset, slope_u, slope_v, amplitude];
            guess.fixed_rows_mut::<{ N - 2 }>(2).copy_from_slice(&before);
        }
        guess
    }

    /// Returns the unknowns beside the place, in grey values.
    fn shape(&self, x: &SVector<f64, N>) -> Shape {
        let mut shape = std::array::from_fn(|i| x[i + 2]);
        shape[4..].iter_mut().for_each(|grey| *grey *= self.spread);
        shape[4] += self.mean;
        shape
    }

    fn normal_equations(&mut self, x: &SVector<f64, N>) -> Normal {
        self.pixels.normal_equations(x, self.curvatures)
    }
}

/// Returns between which places a line stays within a limit on either side of zero; none if it is level.
fn crossings(slope: f64, offset: f64, limit: f64) -> [Option<f64>; 2] {
    let at = [(-limit - offset) / slope, (limit - offset) / slope];
    let is_level = slope.abs() < 1e-12;
    [at[0].min(at[1]), at[0].max(at[1])].map(|place| (!is_level).then_some(place))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edges_that_are_bent_as_told_leave_the_corner_in_place() {
        // A corner between edges that are parabolas, 0.6 pixels out at the end of a step of 20 pixels.
        let (at, blur, bend) = ([30.3, 29.6], 1.1, 0.6);
        let value = |i: usize| {
            let (x, y) = ((i % 60) as f64 - at[0], (i / 60) as f64 - at[1]);
            let curvature = bend / 400.0;
            // erf(x/√2) to 2e-4, odd: Bürmann's series in its first terms.
            let soft = |distance: f64| {
                let x = distance / blur / std::f64::consts::SQRT_2;
                let e = (-x * x).exp();
                let series = 0.5 * std::f64::consts::PI.sqrt() + 31.0 / 200.0 * e - 341.0 / 8000.0 * e * e;
                x.signum() * 2.0 / std::f64::consts::PI.sqrt() * (1.0 - e).sqrt() * series
            };
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
            enough: FINE,
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

    #[test]
    fn the_widest_window_is_looked_at_down_to_its_last_row() {
        let image = GrayImage::new([300, 300], GrayPixels::Eight(vec![9; 90_000])).unwrap();
        let start = Start {
            pixel: [150.0; 2],
            steps_px: [[250.0, 0.0], [0.0, 250.0]],
            bends_px: [[0.0; 2]; 2],
            is_bright: true,
            blur_px: 7.0,
            reach: 0.55,
            hole: None,
            before: None,
            enough: FINE,
        };
        let mut pixels = Pixels::none();
        assert!(Window::around(&image, &start, &mut pixels).is_none());
        // Half of 29 pixels, eight times over.
        let last = pixels.v[..pixels.count].iter().copied().fold(f32::MIN, f32::max);
        assert_eq!(last, 116.0);
    }
}
