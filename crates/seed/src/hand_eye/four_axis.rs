//! Robots that turn about one axis only, such as SCARA robots and palletisers.

use boresight_geometry::nalgebra::{SMatrix, SVector, Unit};
use boresight_geometry::{Matrix3, Pose, UnitQuaternion, Vector3};

use super::motion::Motion;
use crate::linear::exceeds;

/// Returns the rig's pose on its carrier, with the translation along the common axis set to zero.
///
/// The common axis is that of all motions, seen from the carrier and from the rig. With any rotation
/// `start` that aligns the two, the rotation is `turn(φ) start` about the axis, and the translation `t`
/// across it solves `(R - I) t - turn(φ) start t_rig = -t_carrier`, which is linear in `t`, cos φ and sin φ.
pub(super) fn four_axis(motions: &[Motion]) -> Option<Pose> {
    let axis_in_carrier =
        common_axis(motions.iter().map(|motion| motion.later_from_earlier_carrier.rodrigues()))?;
    let mut axis_in_rig =
        common_axis(motions.iter().map(|motion| motion.later_from_earlier_rig.rodrigues()))?;
    // Both axes have a sign that only the motions themselves can tell.
    let agreement: f64 = motions
        .iter()
        .map(|motion| {
            motion.later_from_earlier_carrier.rodrigues().dot(&axis_in_carrier)
                * motion.later_from_earlier_rig.rodrigues().dot(&axis_in_rig)
        })
        .sum();
    if agreement < 0.0 {
        axis_in_rig = -axis_in_rig;
    }
    let start = UnitQuaternion::rotation_between(&axis_in_rig, &axis_in_carrier).unwrap_or_else(|| {
        // Opposite axes: half a turn about anything across.
        let across = axis_in_carrier.cross(&any_other(&axis_in_carrier));
        UnitQuaternion::from_axis_angle(&Unit::new_normalize(across), std::f64::consts::PI)
    });
    let first = Unit::new_normalize(axis_in_carrier.cross(&any_other(&axis_in_carrier))).into_inner();
    let second = axis_in_carrier.cross(&first);
    let (mut hessian, mut right) = (SMatrix::<f64, 4, 4>::zeros(), SVector::<f64, 4>::zeros());
    for motion in motions {
        let by_translation = motion.later_from_earlier_carrier.rotation_matrix() - Matrix3::identity();
        let seen = start * motion.later_from_earlier_rig.translation;
        let along = axis_in_carrier * axis_in_carrier.dot(&seen);
        let across = seen - along;
        let mut rows = SMatrix::<f64, 3, 4>::zeros();
        rows.set_column(0, &(by_translation * first));
        rows.set_column(1, &(by_translation * second));
        rows.set_column(2, &-across);
        rows.set_column(3, &-axis_in_carrier.cross(&across));
        hessian += rows.transpose() * rows;
        right += rows.transpose() * (along - motion.later_from_earlier_carrier.translation);
    }
    let eigenvalues = hessian.symmetric_eigenvalues();
    if !exceeds(eigenvalues.min(), 1e-10 * eigenvalues.max()) {
        return None;
    }
    let solved = hessian.cholesky()?.solve(&right);
    let angle = solved[3].atan2(solved[2]);
    let turn = UnitQuaternion::from_axis_angle(&Unit::new_normalize(axis_in_carrier), angle);
    Some(Pose::new(turn * start, first * solved[0] + second * solved[1]))
}

/// Returns the unit axis that rotation vectors share, up to its sign.
fn common_axis(rotation_vectors: impl Iterator<Item = Vector3<f64>>) -> Option<Vector3<f64>> {
    let scatter: Matrix3<f64> = rotation_vectors.map(|vector| vector * vector.transpose()).sum();
    let eigen = scatter.symmetric_eigen();
    let largest = eigen.eigenvalues.imax();
    exceeds(eigen.eigenvalues[largest], 1e-12).then(|| eigen.eigenvectors.column(largest).into_owned())
}

/// Returns a unit vector that is not along `axis`.
fn any_other(axis: &Vector3<f64>) -> Vector3<f64> {
    let mut other = Vector3::zeros();
    other[axis.iamin()] = 1.0;
    other
}
