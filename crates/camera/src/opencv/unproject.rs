//! Undoing the distortion to machine precision, and how far out it can be undone.

use super::distort::linearize_distortion;
use crate::roots::{evaluate, smallest_positive_root};

/// Returns the image-plane point whose distorted point is `distorted` within `tolerance`, or `None`
/// if there is none within the range where the radial map grows.
pub(crate) fn undistort<const N: usize>(
    lens: &[f64],
    distorted: [f64; 2],
    tolerance: f64,
) -> Option<[f64; 2]> {
    if !distorted.iter().all(|x| x.is_finite()) {
        return None;
    }
    let accept = |[x, y]: &[f64; 2]| radius_limit::<N>(lens, x.hypot(*y)).is_none();
    // Newton from the distorted point itself nearly always arrives; it may arrive beyond a fold,
    // and then the search starts again from the radial map's own inverse.
    newton::<N>(lens, distorted, distorted, tolerance).filter(accept).or_else(|| {
        newton::<N>(lens, radial_start::<N>(lens, distorted), distorted, tolerance).filter(accept)
    })
}

/// Returns the radius on the undistorted image plane, below `upper`, at which the radial map stops
/// growing or has a pole.
pub(super) fn radius_limit<const N: usize>(lens: &[f64], upper: f64) -> Option<f64> {
    let (numerator, denominator) = radial_polynomials::<N>(lens);
    // With s = r², d/dr (r N(s)/D(s)) = (N D + 2 s (N' D - N D')) / D², term by term:
    let mut growth = [0.0; 7];
    for (i, n) in numerator.iter().enumerate() {
        for (j, d) in denominator.iter().enumerate() {
            growth[i + j] += n * d * (1.0 + 2.0 * i as f64 - 2.0 * j as f64);
        }
    }
    let fold = smallest_positive_root(&growth, upper * upper);
    let pole = smallest_positive_root(&denominator, upper * upper);
    let first = [fold, pole].into_iter().flatten().fold(f64::INFINITY, f64::min);
    first.is_finite().then(|| first.sqrt())
}

/// Returns numerator and denominator of the radial factor as polynomials in r².
fn radial_polynomials<const N: usize>(lens: &[f64]) -> ([f64; 4], [f64; 4]) {
    let k = |i: usize| if i < N { lens[i] } else { 0.0 };
    ([1.0, k(0), k(1), k(4)], [1.0, k(5), k(6), k(7)])
}

/// Returns the point in the direction of `distorted` from which the radial terms alone lead there,
/// or as far out as they grow.
fn radial_start<const N: usize>(lens: &[f64], distorted: [f64; 2]) -> [f64; 2] {
    let (numerator, denominator) = radial_polynomials::<N>(lens);
    let image = |r: f64| r * evaluate(&numerator, r * r) / evaluate(&denominator, r * r);
    let wanted = distorted[0].hypot(distorted[1]);
    if wanted == 0.0 {
        return [0.0; 2];
    }
    let mut low = 0.0;
    // Beyond 1e3 (89.9 degrees) a rectilinear formula has no business.
    let mut high = radius_limit::<N>(lens, 1e3).unwrap_or(1e3);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if image(middle) < wanted { low = middle } else { high = middle }
    }
    // Low rather than high: at a fold the Jacobian is singular, and low is on the inner side.
    distorted.map(|x| x * (low / wanted))
}

/// Solves `distort(point) = target` by Newton's method with step halving.
fn newton<const N: usize>(
    lens: &[f64],
    start: [f64; 2],
    target: [f64; 2],
    tolerance: f64,
) -> Option<[f64; 2]> {
    // Quadratic convergence needs about 6 steps; a start near a fold needs some halvings more.
    const MAX_STEPS: usize = 40;
    let evaluate = |[x, y]: [f64; 2]| {
        let distorted = linearize_distortion::<f64, N>(lens, x, y);
        let residual = [distorted.plane[0] - target[0], distorted.plane[1] - target[1]];
        (residual, residual[0].hypot(residual[1]), distorted.d_plane)
    };
    let mut point = start;
    let (mut residual, mut size, mut jacobian) = evaluate(point);
    'steps: for _ in 0..MAX_STEPS {
        if size == 0.0 {
            break;
        }
        let [[a, b], [c, d]] = jacobian;
        let determinant = a * d - b * c;
        let step = [
            (b * residual[1] - d * residual[0]) / determinant,
            (c * residual[0] - a * residual[1]) / determinant,
        ];
        let mut fraction = 1.0;
        for _ in 0..30 {
            let trial = [point[0] + fraction * step[0], point[1] + fraction * step[1]];
            let (trial_residual, trial_size, trial_jacobian) = evaluate(trial);
            if trial_size < size {
                (point, residual, size, jacobian) = (trial, trial_residual, trial_size, trial_jacobian);
                continue 'steps;
            }
            if size <= 1e-3 * tolerance {
                break;
            }
            fraction *= 0.5;
        }
        // No step improves: either rounding is reached, or nothing is there.
        break;
    }
    (size <= tolerance).then_some(point)
}
