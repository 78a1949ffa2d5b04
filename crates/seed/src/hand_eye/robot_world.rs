//! Both poses at once: Shah's and Li's Kronecker products.

use boresight_geometry::nalgebra::{DMatrix, DVector, Matrix6, SMatrix, Vector6};
use boresight_geometry::{Matrix3, Pose, UnitQuaternion, Vector3};

use super::{HandEye, PosePair, rotation_of};
use crate::linear::exceeds;

/// Shah 2013, section 3: the dominant singular vectors of the sum of Kronecker products are the rotations.
pub(super) fn shah(pairs: &[PosePair]) -> Option<HandEye> {
    let mut sum = SMatrix::<f64, 9, 9>::zeros();
    for pair in pairs {
        let target_from_rig = pair.rig_from_target.inverse().rotation_matrix();
        // R_arm R_x R_rig = R_z, so vec(R_z) = (R_rigᵀ kron R_arm) vec(R_x).
        sum += target_from_rig.kronecker(&pair.other_from_carrier.rotation_matrix());
    }
    let svd = sum.try_svd(true, true, 1e-14, 200)?;
    let (u, v_t) = (svd.u?, svd.v_t?);
    let mut order: [usize; 9] = std::array::from_fn(|i| i);
    order.sort_by(|a, b| svd.singular_values[*b].total_cmp(&svd.singular_values[*a]));
    let (first, second) = (svd.singular_values[order[0]], svd.singular_values[order[1]]);
    // A second singular value as large as the first: the motions share one axis.
    if !exceeds(first - second, 1e-9 * first) {
        return None;
    }
    let matrix = |numbers: &[f64]| Matrix3::from_column_slice(numbers);
    let rig = rotation_of(&matrix(v_t.row(order[0]).transpose().as_slice()))?;
    let target = rotation_of(&matrix(u.column(order[0]).into_owned().as_slice()))?;
    translations(pairs, rig, target)
}

/// Li, Wang & Wu 2010, section 3.1: one linear system in both rotations and both translations.
pub(super) fn li(pairs: &[PosePair]) -> Option<HandEye> {
    let mut hessian = DMatrix::<f64>::zeros(24, 24);
    let mut right = DVector::<f64>::zeros(24);
    let mut rows = DMatrix::<f64>::zeros(12, 24);
    let identity = Matrix3::<f64>::identity();
    for pair in pairs {
        let arm = pair.other_from_carrier.rotation_matrix();
        let target_from_rig = pair.rig_from_target.inverse();
        let target_from_rig_rotation = target_from_rig.rotation_matrix();
        rows.fill(0.0);
        // R_arm R_x = R_z R_target_from_rig and R_arm t_x + t_arm = R_z t_target_from_rig + t_z, by columns.
        rows.view_mut((0, 0), (9, 9)).copy_from(&identity.kronecker(&arm));
        rows.view_mut((0, 9), (9, 9)).copy_from(&-target_from_rig_rotation.transpose().kronecker(&identity));
        rows.view_mut((9, 9), (3, 9))
            .copy_from(&target_from_rig.translation.transpose().kronecker(&identity));
        rows.view_mut((9, 18), (3, 3)).copy_from(&-arm);
        rows.view_mut((9, 21), (3, 3)).copy_from(&identity);
        hessian += rows.tr_mul(&rows);
        right += rows.rows(9, 3).tr_mul(&pair.other_from_carrier.translation);
    }
    let solved = hessian.cholesky()?.solve(&right);
    let matrix = |start: usize| Matrix3::from_column_slice(&solved.as_slice()[start..start + 9]);
    translations(pairs, rotation_of(&matrix(0))?, rotation_of(&matrix(9))?)
}

/// Solves for both translations, given both rotations; `None` if the motions leave a direction open.
fn translations(
    pairs: &[PosePair],
    rig: UnitQuaternion<f64>,
    target: UnitQuaternion<f64>,
) -> Option<HandEye> {
    let (mut hessian, mut right) = (Matrix6::<f64>::zeros(), Vector6::<f64>::zeros());
    for pair in pairs {
        let mut rows = SMatrix::<f64, 3, 6>::zeros();
        rows.fixed_view_mut::<3, 3>(0, 0).copy_from(&pair.other_from_carrier.rotation_matrix());
        rows.fixed_view_mut::<3, 3>(0, 3).copy_from(&-Matrix3::<f64>::identity());
        let seen = target * pair.rig_from_target.inverse().translation - pair.other_from_carrier.translation;
        hessian += rows.transpose() * rows;
        right += rows.transpose() * seen;
    }
    let eigenvalues = hessian.symmetric_eigenvalues();
    if !exceeds(eigenvalues.min(), 1e-10 * eigenvalues.max()) {
        return None;
    }
    let solved = hessian.cholesky()?.solve(&right);
    let part = |start: usize| Vector3::new(solved[start], solved[start + 1], solved[start + 2]);
    Some(HandEye { carrier_from_rig: Pose::new(rig, part(0)), other_from_target: Pose::new(target, part(3)) })
}
