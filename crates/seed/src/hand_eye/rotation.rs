//! Rotation first: Tsai, Park, Horaud; and Daniilidis' dual quaternions.

use boresight_geometry::nalgebra::{Matrix4, Quaternion, SMatrix, Vector4};
use boresight_geometry::{Matrix3, Pose, UnitQuaternion, Vector3, skew};

use super::motion::Motion;
use crate::linear::{exceeds, nearest_rotation};

/// Motions that turn by less say nothing about a rotation, in radians.
const LEAST_TURN_RAD: f64 = 1e-6;

/// Returns the unit quaternion of x, y, z, w.
pub(super) fn quaternion_of(xyzw: &Vector4<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::new_normalize(Quaternion::new(xyzw.w, xyzw.x, xyzw.y, xyzw.z))
}

/// Returns the rotation vectors of all motions that turn, the carrier's and the rig's.
fn turns(motions: &[Motion]) -> impl Iterator<Item = (Vector3<f64>, Vector3<f64>)> + '_ {
    motions
        .iter()
        .map(|motion| {
            (motion.later_from_earlier_carrier.rodrigues(), motion.later_from_earlier_rig.rodrigues())
        })
        .filter(|(carrier, rig)| carrier.norm() > LEAST_TURN_RAD && rig.norm() > LEAST_TURN_RAD)
}

/// Park & Martin 1994, Eq. 13 with all motions: the rotation that turns the rig's rotation vectors best
/// into the carrier's.
pub(super) fn park(motions: &[Motion]) -> Option<UnitQuaternion<f64>> {
    let sum: Matrix3<f64> = turns(motions).map(|(carrier, rig)| carrier * rig.transpose()).sum();
    Some(Pose::from_matrix(&nearest_rotation(&sum)?, Vector3::zeros()).rotation)
}

/// Horaud & Dornaika 1995, section 4: the quaternion that turns unit axes best into each other.
pub(super) fn horaud(motions: &[Motion]) -> Option<UnitQuaternion<f64>> {
    let mut sum = Matrix4::zeros();
    for (carrier, rig) in turns(motions) {
        let (carrier, rig) = (carrier.normalize(), rig.normalize());
        // q rig - carrier q = 0, linear in q = (x, y, z, w).
        let mut rows = Matrix4::zeros();
        rows.fixed_view_mut::<3, 3>(0, 0).copy_from(&-skew(&(carrier + rig)));
        rows.fixed_view_mut::<3, 1>(0, 3).copy_from(&(rig - carrier));
        rows.fixed_view_mut::<1, 3>(3, 0).copy_from(&(carrier - rig).transpose());
        sum += rows.transpose() * rows;
    }
    let eigen = sum.symmetric_eigen();
    let mut order = [0, 1, 2, 3];
    order.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
    // Two small eigenvalues: the motions share one axis.
    exceeds(eigen.eigenvalues[order[1]], 1e-9 * eigen.eigenvalues[order[3]])
        .then(|| quaternion_of(&eigen.eigenvectors.column(order[0]).into_owned()))
}

/// Tsai & Lenz 1989, Eqs 12 and 14.
pub(super) fn tsai(motions: &[Motion]) -> Option<UnitQuaternion<f64>> {
    let (mut hessian, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for motion in motions {
        let sine = |pose: &Pose| {
            // 2 sin(θ/2) along the axis, for an angle of at most π.
            let rotation = pose.rotation;
            2.0 * rotation.imag() * if rotation.w < 0.0 { -1.0 } else { 1.0 }
        };
        let (carrier, rig) = (sine(&motion.later_from_earlier_carrier), sine(&motion.later_from_earlier_rig));
        let rows = skew(&(carrier + rig));
        hessian += rows.transpose() * rows;
        right += rows.transpose() * (rig - carrier);
    }
    let eigenvalues = hessian.symmetric_eigenvalues();
    if !exceeds(eigenvalues.min(), 1e-9 * eigenvalues.max()) {
        return None;
    }
    let modified = hessian.cholesky()?.solve(&right);
    // R_carrier = R X R_rig: the vector solved for turns the rig's into the carrier's.
    let p = 2.0 * modified / (1.0 + modified.norm_squared()).sqrt();
    let matrix = Matrix3::identity() * (1.0 - 0.5 * p.norm_squared())
        + 0.5 * (p * p.transpose() + skew(&p) * (4.0 - p.norm_squared()).max(0.0).sqrt());
    Some(Pose::from_matrix(&nearest_rotation(&matrix)?, Vector3::zeros()).rotation)
}

/// Daniilidis 1999, section 4: the dual quaternion in the null space of all motions' equations.
pub(super) fn daniilidis(motions: &[Motion]) -> Option<Pose> {
    let mut moments = SMatrix::<f64, 8, 8>::zeros();
    let mut n = 0;
    for motion in motions {
        let (real_a, dual_a) = dual_quaternion(&motion.later_from_earlier_carrier);
        let (real_b, dual_b) = dual_quaternion(&motion.later_from_earlier_rig);
        let (a, b) = (real_a.imag(), real_b.imag());
        if a.norm() < LEAST_TURN_RAD || b.norm() < LEAST_TURN_RAD {
            continue;
        }
        let (dual_a, dual_b) = (dual_a.imag(), dual_b.imag());
        let mut rows = SMatrix::<f64, 6, 8>::zeros();
        rows.fixed_view_mut::<3, 1>(0, 0).copy_from(&(a - b));
        rows.fixed_view_mut::<3, 3>(0, 1).copy_from(&skew(&(a + b)));
        rows.fixed_view_mut::<3, 1>(3, 0).copy_from(&(dual_a - dual_b));
        rows.fixed_view_mut::<3, 3>(3, 1).copy_from(&skew(&(dual_a + dual_b)));
        rows.fixed_view_mut::<3, 1>(3, 4).copy_from(&(a - b));
        rows.fixed_view_mut::<3, 3>(3, 5).copy_from(&skew(&(a + b)));
        moments += rows.transpose() * rows;
        n += 1;
    }
    if n < 2 {
        return None;
    }
    let eigen = moments.symmetric_eigen();
    let mut order: [usize; 8] = std::array::from_fn(|i| i);
    order.sort_by(|x, y| eigen.eigenvalues[*x].total_cmp(&eigen.eigenvalues[*y]));
    // Three small eigenvalues instead of two: the motions share one axis.
    if !exceeds(eigen.eigenvalues[order[2]], 1e-9 * eigen.eigenvalues[order[7]]) {
        return None;
    }
    let vector = |i: usize| eigen.eigenvectors.column(order[i]).into_owned();
    let (first, second) = (vector(0), vector(1));
    let part = |v: &SMatrix<f64, 8, 1>, start: usize| v.fixed_rows::<4>(start).into_owned();
    let (u1, v1, u2, v2) = (part(&first, 0), part(&first, 4), part(&second, 0), part(&second, 4));
    // The real and the dual part are perpendicular: a quadratic in the ratio of the two.
    let (a, b, c) = (u1.dot(&v1), u1.dot(&v2) + u2.dot(&v1), u2.dot(&v2));
    let norm = |s: f64| s * s * u1.dot(&u1) + 2.0 * s * u1.dot(&u2) + u2.dot(&u2);
    let (scale1, scale2) = if a.abs() < 1e-14 {
        (0.0, 1.0 / u2.norm())
    } else {
        let root = (b * b - 4.0 * a * c).max(0.0).sqrt();
        let ratios = [(-b + root) / (2.0 * a), (-b - root) / (2.0 * a)];
        let s = if norm(ratios[0]) > norm(ratios[1]) { ratios[0] } else { ratios[1] };
        (s / norm(s).sqrt(), 1.0 / norm(s).sqrt())
    };
    let real = u1 * scale1 + u2 * scale2;
    let dual = v1 * scale1 + v2 * scale2;
    let quaternion = |v: &Vector4<f64>| Quaternion::new(v[0], v[1], v[2], v[3]);
    let rotation = UnitQuaternion::try_new(quaternion(&real), 1e-12)?;
    let translation = (quaternion(&dual) * quaternion(&real).conjugate()).imag() * 2.0;
    Some(Pose::new(rotation, translation))
}

/// Returns the real and the dual part of a pose's dual quaternion, the real part's scalar not negative.
fn dual_quaternion(pose: &Pose) -> (Quaternion<f64>, Quaternion<f64>) {
    let real = *pose.rotation.quaternion();
    let real = if real.w < 0.0 { -real } else { real };
    let dual = Quaternion::from_imag(pose.translation) * real * 0.5;
    (real, dual)
}
