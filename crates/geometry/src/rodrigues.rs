//! Derivatives in the parametrisation that others use: a Rodrigues vector and a translation.

use nalgebra::{Matrix3, Matrix6, Vector3};

use crate::pose::{Pose, left_jacobian, left_jacobian_inverse, skew};

impl Pose {
    /// Returns the 6x6 derivative of the left perturbation `[rotation, translation]` of this pose by its
    /// `[Rodrigues vector, translation]`.
    ///
    /// A perturbation (w, v) turns by w and moves the translation t by w × t + v.
    pub fn tangent_by_rodrigues(&self) -> Matrix6<f64> {
        let turn = left_jacobian(&self.rodrigues());
        let mut derivative = Matrix6::identity();
        derivative.fixed_view_mut::<3, 3>(0, 0).copy_from(&turn);
        derivative.fixed_view_mut::<3, 3>(3, 0).copy_from(&(skew(&self.translation) * turn));
        derivative
    }

    /// Returns the 6x6 derivative of `[Rodrigues vector, translation]` by a left perturbation: the
    /// inverse of [`tangent_by_rodrigues`](Self::tangent_by_rodrigues).
    pub fn rodrigues_by_tangent(&self) -> Matrix6<f64> {
        let mut derivative = Matrix6::identity();
        derivative.fixed_view_mut::<3, 3>(0, 0).copy_from(&left_jacobian_inverse(&self.rodrigues()));
        derivative.fixed_view_mut::<3, 3>(3, 0).copy_from(&-skew(&self.translation));
        derivative
    }
}

/// Returns the derivative of the rotation matrix by each component of its Rodrigues vector.
pub fn rotation_by_rodrigues(rotation_vector: &Vector3<f64>) -> [Matrix3<f64>; 3] {
    let rotation = Pose::from_rodrigues(*rotation_vector, Vector3::zeros()).rotation_matrix();
    let turn = left_jacobian(rotation_vector);
    [0, 1, 2].map(|axis| skew(&turn.column(axis).into_owned()) * rotation)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(rt: &[f64; 6]) -> Pose {
        Pose::from_rodrigues(Vector3::new(rt[0], rt[1], rt[2]), Vector3::new(rt[3], rt[4], rt[5]))
    }

    #[test]
    fn derivatives_match_differences_and_invert_each_other() {
        for angle in [0.0, 1e-9, 1e-3, 0.5, 2.0, 3.1] {
            let rt = [0.6 * angle, -0.48 * angle, 0.64 * angle, 1.0, -2.0, 0.5];
            let here = pose(&rt);
            let product = here.tangent_by_rodrigues() * here.rodrigues_by_tangent();
            assert!((product - Matrix6::identity()).norm() < 1e-13, "{angle}");
            for k in 0..6 {
                let step = 1e-6;
                let moved = |sign: f64| {
                    let mut rt = rt;
                    rt[k] += sign * step;
                    pose(&rt)
                };
                let difference = ((moved(1.0) * here.inverse()).log() - (moved(-1.0) * here.inverse()).log())
                    / (2.0 * step);
                let error = difference - here.tangent_by_rodrigues().column(k);
                // Central differences: the square of the step, and rounding over the step.
                assert!(error.norm() < 1e-9, "{angle} {k}: {error}");
                if k < 3 {
                    let difference =
                        (moved(1.0).rotation_matrix() - moved(-1.0).rotation_matrix()) / (2.0 * step);
                    let error = difference - rotation_by_rodrigues(&here.rodrigues())[k];
                    assert!(error.norm() < 1e-9, "{angle} {k}: {error}");
                }
            }
        }
    }
}
