//! Candidates for corners where four squares meet: saddles of the grey values with two edges through them.

use std::f64::consts::{PI, TAU};

use crate::plane::Plane;

/// The most candidates of an image that are looked at closely, those with the strongest response.
const MOST: usize = 4000;
/// The radii in pixels of the circles on which a candidate's edges are looked for, in this order.
const RADII_PX: [f64; 2] = [5.0, 3.0];
/// Samples on a circle.
const SAMPLES: usize = 32;
/// By how much the two halves of an edge may differ in direction, in radians.
const BEND_RAD: f64 = 0.45;

/// A place where four sectors meet, bright and dark in turn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Saddle {
    /// Where it is, to within a pixel: the fit begins here.
    pub pixel: [f64; 2],
    /// The directions of the four edges that leave it, in radians from +u towards +v, increasing within one turn.
    pub rays_rad: [f64; 4],
    /// Whether the sector after the first ray is the brighter.
    pub is_bright_after: bool,
    /// The difference between bright and dark in grey values.
    pub contrast: f64,
}

impl Saddle {
    /// Tells whether the sector after ray `k` is bright.
    pub fn is_bright_after(&self, k: usize) -> bool {
        self.is_bright_after == k.is_multiple_of(2)
    }
}

/// Returns the saddles of a smoothed plane whose contrast is at least `least_contrast` grey values.
pub(crate) fn find_saddles(smooth: &Plane, least_contrast: f64) -> Vec<Saddle> {
    let mut peaks = response_peaks(smooth, least_contrast);
    if peaks.len() > MOST {
        peaks.select_nth_unstable_by(MOST, |a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        peaks.truncate(MOST);
    }
    peaks.sort_by_key(|peak| peak.1);
    let mut saddles: Vec<Saddle> = Vec::new();
    for (_, at) in peaks {
        let Some(pixel) = stationary_point(smooth, at) else { continue };
        let seen = RADII_PX.iter().find_map(|&radius| examine(smooth, pixel, radius, least_contrast));
        saddles.extend(seen);
    }
    saddles
}

/// Returns the local maxima of `Lxy² - Lxx Lyy`, the negative determinant of the Hessian, with their positions.
fn response_peaks(smooth: &Plane, least_contrast: f64) -> Vec<(f32, usize)> {
    let (width, height) = (smooth.width, smooth.height);
    if width < 13 || height < 13 {
        return Vec::new();
    }
    let mut response = vec![0.0f32; width * height];
    // The smoothed plane has a border of two that is zero, and differences reach two further.
    for y in 4..height - 4 {
        let row = |dy: usize| &smooth.values[(y + dy - 2) * width..][..width];
        let (upper, middle, lower) = (row(0), row(2), row(4));
        let n = width - 8;
        let (u0, u2, u4) = (&upper[2..][..n], &upper[4..][..n], &upper[6..][..n]);
        let (m0, m2, m4) = (&middle[2..][..n], &middle[4..][..n], &middle[6..][..n]);
        let (l0, l2, l4) = (&lower[2..][..n], &lower[4..][..n], &lower[6..][..n]);
        let out = &mut response[y * width + 4..][..n];
        for x in 0..n {
            let xx = m4[x] - 2.0 * m2[x] + m0[x];
            let yy = l2[x] - 2.0 * m2[x] + u2[x];
            let xy = 0.25 * (l4[x] - l0[x] - u4[x] + u0[x]);
            out[x] = xy * xy - xx * yy;
        }
    }
    // A right-angled sharp corner of this contrast has 0.16 of its square; skew and blur leave a tenth of that.
    let least = (0.016 * least_contrast * least_contrast) as f32;
    let mut peaks = Vec::new();
    for y in 6..height - 6 {
        let row = &response[y * width..][..width];
        for x in 6..width - 6 {
            let value = row[x];
            if value <= least || value < row[x - 1] || value <= row[x + 1] {
                continue;
            }
            let at = y * width + x;
            // Of equal neighbours the last is taken.
            let is_peak = (0..5).all(|dy| {
                let from = at + dy * width - 2 * width - 2;
                response[from..from + 5].iter().enumerate().all(|(dx, &other)| {
                    if (dy, dx) < (2, 2) { value >= other } else { (dy, dx) == (2, 2) || value > other }
                })
            });
            if is_peak {
                peaks.push((value, at));
            }
        }
    }
    peaks
}

/// Returns where the gradient of the quadric around a pixel vanishes, or `None` if that is not near.
fn stationary_point(smooth: &Plane, at: usize) -> Option<[f64; 2]> {
    let width = smooth.width;
    let value =
        |dx: isize, dy: isize| f64::from(smooth.values[at.wrapping_add_signed(dy * width as isize + dx)]);
    let (gx, gy) = (0.25 * (value(2, 0) - value(-2, 0)), 0.25 * (value(0, 2) - value(0, -2)));
    let xx = 0.25 * (value(2, 0) - 2.0 * value(0, 0) + value(-2, 0));
    let yy = 0.25 * (value(0, 2) - 2.0 * value(0, 0) + value(0, -2));
    let xy = (value(2, 2) - value(-2, 2) - value(2, -2) + value(-2, -2)) / 16.0;
    let determinant = xx * yy - xy * xy;
    let step = [-(yy * gx - xy * gy) / determinant, -(xx * gy - xy * gx) / determinant];
    let is_near = step.iter().all(|s| s.abs() <= 2.0);
    is_near.then(|| [(at % width) as f64 + step[0], (at / width) as f64 + step[1]])
}

/// Looks at a circle around a place: four changes between bright and dark, opposite each other in pairs.
fn examine(smooth: &Plane, pixel: [f64; 2], radius_px: f64, least_contrast: f64) -> Option<Saddle> {
    let is_inside = [smooth.width, smooth.height]
        .iter()
        .zip(pixel)
        .all(|(side, at)| at - radius_px >= 2.0 && at + radius_px < *side as f64 - 3.0);
    if !is_inside {
        return None;
    }
    let mut ring = [0.0f64; SAMPLES];
    let directions = circle();
    let sample = |[cos, sin]: [f64; 2]| {
        f64::from(smooth.sample_inside([pixel[0] + radius_px * cos, pixel[1] + radius_px * sin]))
    };
    // Every other sample tells whether the rest is worth looking at: in most places there is nothing but noise.
    for i in (0..SAMPLES).step_by(2) {
        ring[i] = sample(directions[i]);
    }
    let halves =
        ring.iter().step_by(2).fold((f64::MAX, f64::MIN), |(low, high), &v| (low.min(v), high.max(v)));
    if halves.1 - halves.0 < 0.7 * least_contrast {
        return None;
    }
    for i in (1..SAMPLES).step_by(2) {
        ring[i] = sample(directions[i]);
    }
    let (low, high) = ring.iter().fold((f64::MAX, f64::MIN), |(low, high), &v| (low.min(v), high.max(v)));
    let contrast = high - low;
    if contrast < least_contrast {
        return None;
    }
    let middle = 0.5 * (low + high);
    let (mut rays_rad, mut first_is_bright, mut n_rays) = ([0.0; 4], false, 0);
    // How far each sector departs from the middle, in the sense of its sign.
    let (mut extremes, mut extreme) = ([0.0f64; 4], 0.0f64);
    for i in 0..SAMPLES {
        let (here, next) = (ring[i] - middle, ring[(i + 1) % SAMPLES] - middle);
        extreme = extreme.max(here.abs());
        if (here > 0.0) != (next > 0.0) {
            if n_rays == 4 {
                return None;
            }
            extremes[n_rays] = extreme;
            extreme = 0.0;
            rays_rad[n_rays] = (i as f64 + here / (here - next)) * TAU / SAMPLES as f64;
            if n_rays == 0 {
                first_is_bright = next > 0.0;
            }
            n_rays += 1;
        }
    }
    // What came before the first change and after the last is one sector.
    extremes[0] = extremes[0].max(extreme);
    let is_even = n_rays == 4 && extremes.iter().all(|&extreme| extreme > 0.18 * contrast);
    let is_straight = (rays_rad[2] - rays_rad[0] - PI).abs() < BEND_RAD
        && (rays_rad[3] - rays_rad[1] - PI).abs() < BEND_RAD;
    (is_even && is_straight).then_some(Saddle { pixel, rays_rad, is_bright_after: first_is_bright, contrast })
}

/// Returns the directions of the samples on a circle.
fn circle() -> &'static [[f64; 2]; SAMPLES] {
    static CIRCLE: std::sync::LazyLock<[[f64; 2]; SAMPLES]> = std::sync::LazyLock::new(|| {
        std::array::from_fn(|i| {
            let angle = i as f64 * TAU / SAMPLES as f64;
            [angle.cos(), angle.sin()]
        })
    });
    &CIRCLE
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a plane with one corner: edges at two directions, softened as a lens does.
    fn corner(at: [f64; 2], edges_rad: [f64; 2], amplitude: f64) -> Plane {
        let side = 31;
        let soft = |distance: f64| (distance / 1.2).tanh();
        let value = |i: usize| {
            let (x, y) = ((i % side) as f64 - at[0], (i / side) as f64 - at[1]);
            let [a, b] = edges_rad.map(|edge| soft(y * edge.cos() - x * edge.sin()));
            (100.0 + amplitude * a * b) as f32
        };
        Plane { width: side, height: side, values: (0..side * side).map(value).collect() }
    }

    /// Checks that the one saddle is at the corner, with its rays along the edges.
    fn check(at: [f64; 2], edges_rad: [f64; 2], amplitude: f64) {
        let saddles = find_saddles(&corner(at, edges_rad, amplitude).smoothed(), 5.0);
        let [saddle] = saddles[..] else { panic!("{at:?} {edges_rad:?}: {saddles:?}") };
        let error = (saddle.pixel[0] - at[0]).hypot(saddle.pixel[1] - at[1]);
        assert!(error < 0.7, "{at:?} {edges_rad:?}: {saddle:?}");
        for edge in edges_rad.iter().flat_map(|edge| [*edge, edge + PI]) {
            let apart = |ray: &f64| ((ray - edge + PI).rem_euclid(TAU) - PI).abs();
            // Where sectors are narrow, blur bends the edges apart.
            assert!(saddle.rays_rad.iter().any(|ray| apart(ray) < 0.2), "{edges_rad:?}: {saddle:?}");
        }
        let middle = 0.5 * (saddle.rays_rad[0] + saddle.rays_rad[1]);
        let [a, b] = edges_rad.map(|edge| (middle - edge).sin());
        assert_eq!(saddle.is_bright_after(0), a * b * amplitude > 0.0, "{edges_rad:?}: {saddle:?}");
    }

    #[test]
    fn corners_are_found_with_their_edges_and_colours() {
        for edges in [[0.0, PI / 2.0], [0.3, 0.3 + PI / 2.0], [0.1, 0.8], [1.0, 1.6], [2.0, 3.0]] {
            for at in [[15.0, 15.0], [14.6, 15.3]] {
                check(at, edges, 60.0);
                check(at, edges, -60.0);
                check(at, edges, 8.0);
            }
        }
    }

    #[test]
    fn edges_blobs_and_junctions_are_no_saddles() {
        let side = 31;
        let patterns: [fn(f64, f64) -> f64; 4] = [
            |x, _| if x > 0.2 { 200.0 } else { 50.0 },
            |x, y| 200.0 * (-(x * x + y * y) / 18.0).exp(),
            |x, y| if x > 0.0 && y > 0.0 { 50.0 } else { 200.0 },
            |x, y| if x.abs() < 2.0 && y > 0.0 { 50.0 } else { 200.0 },
        ];
        for (i, pattern) in patterns.iter().enumerate() {
            let value = |i: usize| pattern((i % side) as f64 - 15.0, (i / side) as f64 - 15.0) as f32;
            let plane = Plane { width: side, height: side, values: (0..side * side).map(value).collect() };
            assert_eq!(find_saddles(&plane.smoothed(), 5.0), [], "pattern {i}");
        }
    }
}
