//! Small dense linear algebra that the closed forms share.

use boresight_geometry::nalgebra::{Cholesky, SMatrix, SVector};
use boresight_geometry::{Matrix3, Vector3};

/// Tells whether `value` is above `limit`. NaN is not.
pub(crate) fn exceeds(value: f64, limit: f64) -> bool {
    value > limit
}

/// Returns the unit eigenvector of the smallest eigenvalue of a positive semidefinite matrix, or
/// `None` if the matrix is zero or not finite.
///
/// Inverse iteration: the smallest eigenvalue is that of the noise here, far below the next, so that
/// a few solves do; a full decomposition costs ten times as much.
pub(crate) fn smallest_eigenvector<const N: usize>(matrix: &SMatrix<f64, N, N>) -> Option<SVector<f64, N>> {
    let trace = matrix.trace();
    if !(trace.is_finite() && trace > 0.0) {
        return None;
    }
    let scaled = matrix / trace;
    // The shift keeps the factor away from zero; where rounding defeats it, a larger one is tried.
    let factor = [1e-14, 1e-12, 1e-9]
        .into_iter()
        .find_map(|shift| Cholesky::new(scaled + SMatrix::<f64, N, N>::identity() * shift))?;
    // No special direction, so that the start has a part along the one sought.
    let mut vector = SVector::<f64, N>::from_fn(|row, _| 1.0 + 0.37 * row as f64 - 0.11 * (row * row) as f64);
    for _ in 0..20 {
        let next = factor.solve(&vector).try_normalize(0.0)?;
        let moved = (next - vector).norm().min((next + vector).norm());
        vector = next;
        if moved < 1e-10 {
            break;
        }
    }
    vector.iter().all(|value| value.is_finite()).then_some(vector)
}

/// Returns the rotation nearest to a matrix in the Frobenius norm, or `None` if the matrix is singular.
pub(crate) fn nearest_rotation(matrix: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    let svd = matrix.try_svd(true, true, 1e-14, 100)?;
    let (u, v_t) = (svd.u?, svd.v_t?);
    if !exceeds(svd.singular_values[1], 1e-9 * svd.singular_values[0]) {
        return None;
    }
    let mirror = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v_t).determinant().signum()));
    Some(u * mirror * v_t)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_smallest_eigenvector_of_a_known_matrix() {
        let axis = SVector::<f64, 4>::new(1.0, -2.0, 0.5, 3.0).normalize();
        for smallest in [0.0, 1e-9, 1e-3] {
            let matrix = SMatrix::<f64, 4, 4>::identity() * 3.0 - axis * axis.transpose() * (3.0 - smallest);
            let found = smallest_eigenvector(&matrix).unwrap();
            assert!((found.dot(&axis).abs() - 1.0).abs() < 1e-10, "{smallest}: {found}");
        }
        assert_eq!(smallest_eigenvector(&SMatrix::<f64, 3, 3>::zeros()), None);
    }

    #[test]
    fn the_nearest_rotation_is_right_handed() {
        let mirror = Matrix3::from_diagonal(&Vector3::new(2.0, 1.9, -0.3));
        let rotation = nearest_rotation(&mirror).unwrap();
        assert!((rotation - Matrix3::identity()).norm() < 1e-12);
        assert_eq!(nearest_rotation(&Matrix3::zeros()), None);
    }
}
