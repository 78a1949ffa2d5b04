//! Minimal reprojection error of a calibration matrix.

use boresight_geometry::nalgebra::{Matrix3x4, SMatrix, SVector};

use super::NormalisedPair;

type Vector12 = SVector<f64, 12>;
type Matrix12 = SMatrix<f64, 12, 12>;

/// Returns the matrix with the least sum of squared distances, and that sum, both normalised.
///
/// Levenberg and Marquardt over the 11 degrees of freedom that a matrix of unit norm has. A step
/// that takes a point through the camera's plane is refused.
pub(super) fn refine(pairs: &[NormalisedPair], start: &Matrix3x4<f64>) -> (Matrix3x4<f64>, f64) {
    const MAX_STEPS: usize = 100;
    let side = pairs.first().map_or(1.0, |(point, _)| (start * point).z.signum());
    let mut h = start * (side / start.norm());
    let Some(mut system) = System::at(pairs, &h) else { return (h, f64::INFINITY) };
    let mut damping = 1e-6;
    for _ in 0..MAX_STEPS {
        // The cost does not change along h itself; its outer product fixes that direction.
        let direction = flat(&h);
        let mut matrix = system.gram + direction * direction.transpose() * system.gram.trace();
        for i in 0..12 {
            matrix[(i, i)] += damping * system.gram.trace() / 12.0;
        }
        let step = match matrix.cholesky() {
            Some(factor) => factor.solve(&-system.gradient),
            None => break,
        };
        let moved = h + Matrix3x4::from_row_iterator(step.iter().copied());
        let moved = moved / moved.norm();
        match System::at(pairs, &moved) {
            Some(next) if next.cost < system.cost => {
                (h, system) = (moved, next);
                damping = (damping * 0.1).max(1e-15);
            }
            // Nothing smaller is left to gain, in the numbers' precision.
            _ if step.norm() < 1e-15 || damping > 1e6 => break,
            _ => damping *= 10.0,
        }
    }
    (h, system.cost)
}

/// The normal equations of the reprojection error.
struct System {
    cost: f64,
    gram: Matrix12,
    gradient: Vector12,
}

impl System {
    /// Returns the system at `h`, or `None` if a point is not in front of the camera.
    fn at(pairs: &[NormalisedPair], h: &Matrix3x4<f64>) -> Option<Self> {
        let mut system = Self { cost: 0.0, gram: Matrix12::zeros(), gradient: Vector12::zeros() };
        for (point, pixel) in pairs {
            let image = h * point;
            if image.z.is_nan() || image.z <= 0.0 {
                return None;
            }
            let inverse = 1.0 / image.z;
            for row in 0..2 {
                let projected = image[row] * inverse;
                let residual = projected - pixel[row];
                let mut derivative = Vector12::zeros();
                for k in 0..4 {
                    derivative[4 * row + k] = point[k] * inverse;
                    derivative[8 + k] = -projected * point[k] * inverse;
                }
                system.cost += residual * residual;
                system.gram.ger(1.0, &derivative, &derivative, 1.0);
                system.gradient.axpy(residual, &derivative, 1.0);
            }
        }
        Some(system)
    }
}

/// Returns the entries row by row.
fn flat(h: &Matrix3x4<f64>) -> Vector12 {
    Vector12::from_iterator(h.transpose().iter().copied())
}
