//! The translation, once the rotation is known.

use boresight_geometry::{Matrix3, UnitQuaternion, Vector3};

use super::motion::Motion;
use crate::linear::exceeds;

/// Solves `(R - I) t = rotation * t_rig - t_carrier` over all motions; `None` if they leave a direction open.
pub(super) fn of_rig(motions: &[Motion], rotation: &UnitQuaternion<f64>) -> Option<Vector3<f64>> {
    let (mut hessian, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for motion in motions {
        let rows = motion.later_from_earlier_carrier.rotation_matrix() - Matrix3::identity();
        hessian += rows.transpose() * rows;
        right += rows.transpose()
            * (rotation * motion.later_from_earlier_rig.translation
                - motion.later_from_earlier_carrier.translation);
    }
    let eigenvalues = hessian.symmetric_eigenvalues();
    if !exceeds(eigenvalues.min(), 1e-10 * eigenvalues.max()) {
        return None;
    }
    Some(hessian.cholesky()?.solve(&right))
}
