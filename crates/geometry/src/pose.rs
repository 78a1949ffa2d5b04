//! Rigid motions of space, SE(3), with left perturbations.

use std::ops::Mul;

use nalgebra::{Matrix3, Matrix6, Point3, Rotation3, UnitQuaternion, Vector3, Vector6};

/// A pose `b_from_a`: maps points given in frame `a` to frame `b`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// The rotation part.
    pub rotation: UnitQuaternion<f64>,
    /// The translation part: the origin of frame `a`, given in frame `b`.
    pub translation: Vector3<f64>,
}

impl Default for Pose {
    fn default() -> Self {
        Self::identity()
    }
}

impl Pose {
    /// Returns the pose that moves nothing.
    pub fn identity() -> Self {
        Self { rotation: UnitQuaternion::identity(), translation: Vector3::zeros() }
    }

    /// Returns the pose with this rotation and translation.
    pub fn new(rotation: UnitQuaternion<f64>, translation: Vector3<f64>) -> Self {
        Self { rotation, translation }
    }

    /// Returns the pose with a Rodrigues vector (axis times angle in radians) and a translation.
    pub fn from_rodrigues(rotation_vector: Vector3<f64>, translation: Vector3<f64>) -> Self {
        Self { rotation: UnitQuaternion::from_scaled_axis(rotation_vector), translation }
    }

    /// Returns the pose with a rotation matrix, which must be orthonormal and right-handed.
    pub fn from_matrix(rotation: &Matrix3<f64>, translation: Vector3<f64>) -> Self {
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(*rotation));
        Self { rotation, translation }
    }

    /// Returns the Rodrigues vector of the rotation: axis times angle in radians, at most π long.
    pub fn rodrigues(&self) -> Vector3<f64> {
        self.rotation.scaled_axis()
    }

    /// Returns the rotation as a matrix.
    pub fn rotation_matrix(&self) -> Matrix3<f64> {
        *self.rotation.to_rotation_matrix().matrix()
    }

    /// Returns the pose `a_from_b` of this `b_from_a`.
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.inverse();
        Self { rotation, translation: -(rotation * self.translation) }
    }

    /// Returns the rotation angle in radians, in [0, π].
    pub fn angle(&self) -> f64 {
        self.rotation.angle()
    }

    /// Returns the pose reached from the identity along the tangent `[rotation, translation]`.
    pub fn exp(tangent: &Vector6<f64>) -> Self {
        let rotation_vector = tangent.fixed_rows::<3>(0).into_owned();
        let translation = tangent.fixed_rows::<3>(3).into_owned();
        Self {
            rotation: UnitQuaternion::from_scaled_axis(rotation_vector),
            translation: left_jacobian(&rotation_vector) * translation,
        }
    }

    /// Returns the tangent `[rotation, translation]` whose [`exp`](Self::exp) is this pose.
    pub fn log(&self) -> Vector6<f64> {
        let rotation_vector = self.rodrigues();
        let translation = left_jacobian_inverse(&rotation_vector) * self.translation;
        let mut tangent = Vector6::zeros();
        tangent.fixed_rows_mut::<3>(0).copy_from(&rotation_vector);
        tangent.fixed_rows_mut::<3>(3).copy_from(&translation);
        tangent
    }

    /// Returns `exp(tangent) * self`, with the rotation normalised anew.
    pub fn perturbed(&self, tangent: &Vector6<f64>) -> Self {
        let moved = Self::exp(tangent) * *self;
        Self { rotation: UnitQuaternion::new_normalize(*moved.rotation.quaternion()), ..moved }
    }

    /// Returns the 6x6 adjoint: `self * exp(d) = exp(adjoint * d) * self`.
    pub fn adjoint(&self) -> Matrix6<f64> {
        let rotation = self.rotation_matrix();
        let mut adjoint = Matrix6::zeros();
        adjoint.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
        adjoint.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation);
        adjoint.fixed_view_mut::<3, 3>(3, 0).copy_from(&(skew(&self.translation) * rotation));
        adjoint
    }
}

impl Mul for Pose {
    type Output = Pose;

    fn mul(self, b_from_a: Pose) -> Pose {
        Pose {
            rotation: self.rotation * b_from_a.rotation,
            translation: self.rotation * b_from_a.translation + self.translation,
        }
    }
}

impl Mul<Point3<f64>> for Pose {
    type Output = Point3<f64>;

    fn mul(self, point: Point3<f64>) -> Point3<f64> {
        self.rotation * point + self.translation
    }
}

impl Mul<Vector3<f64>> for Pose {
    type Output = Vector3<f64>;

    /// Transforms a point that is held as a vector; a free direction takes the rotation only.
    fn mul(self, point: Vector3<f64>) -> Vector3<f64> {
        self.rotation * point + self.translation
    }
}

/// Returns the matrix of the cross product with `v` from the left.
pub fn skew(v: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -v.z, v.y, v.z, 0.0, -v.x, -v.y, v.x, 0.0)
}

/// Angles in radians below which the Jacobians use series: closer to zero, their closed forms
/// subtract nearly equal numbers.
const SMALL_ANGLE: f64 = 1.0;

/// Returns the left Jacobian of SO(3): eq. 145 of Solà, Deray & Atchuthan 2018.
pub(crate) fn left_jacobian(rotation_vector: &Vector3<f64>) -> Matrix3<f64> {
    let angle = rotation_vector.norm();
    let w = skew(rotation_vector);
    // (1 - cos θ)/θ², written with the half angle so that nothing cancels.
    let a = 0.5 * sinc(0.5 * angle).powi(2);
    let b = if angle < SMALL_ANGLE {
        factorial_series(angle * angle, |_| 1.0)
    } else {
        (angle - angle.sin()) / (angle * angle * angle)
    };
    Matrix3::identity() + w * a + w * w * b
}

/// Returns the inverse of the left Jacobian of SO(3): eq. 146 of Solà, Deray & Atchuthan 2018.
pub fn left_jacobian_inverse(rotation_vector: &Vector3<f64>) -> Matrix3<f64> {
    let angle = rotation_vector.norm();
    let w = skew(rotation_vector);
    // Written with the half angle h, this is (1 - h cot h)/θ², which stays finite at π.
    let half = 0.5 * angle;
    let c = if angle < SMALL_ANGLE {
        // (sin h - h cos h)/h³ has the terms of (h - sin h)/h³, each times 2k + 2.
        factorial_series(half * half, |k| 2.0 * k + 2.0) / (4.0 * sinc(half))
    } else {
        (1.0 - half * half.cos() / half.sin()) / (angle * angle)
    };
    Matrix3::identity() - w * 0.5 + w * w * c
}

/// Returns sin x / x.
fn sinc(x: f64) -> f64 {
    if x == 0.0 { 1.0 } else { x.sin() / x }
}

/// Returns the sum over k of `weight(k)` (-`square`)ᵏ/(2k + 3)!, for a square up to one.
///
/// With weight one this is (x - sin x)/x³.
fn factorial_series(square: f64, weight: impl Fn(f64) -> f64) -> f64 {
    let mut term = 1.0 / 6.0;
    let mut sum = weight(0.0) * term;
    // The first term left out is below 1e-20 at one.
    for k in 1..10 {
        let k = f64::from(k);
        term *= -square / ((2.0 * k + 2.0) * (2.0 * k + 3.0));
        sum += weight(k) * term;
    }
    sum
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_PI_2, PI};

    use proptest::prelude::*;

    use super::*;

    /// Angles at which formulas for rotations tend to break.
    const ANGLES: [f64; 16] = [
        0.0,
        1e-300,
        1e-15,
        1e-12,
        1e-8,
        9.9e-5,
        1.1e-4,
        1e-3,
        0.03,
        0.999,
        1.001,
        FRAC_PI_2,
        3.0,
        PI - 1e-6,
        PI - 1e-9,
        PI - 1e-12,
    ];

    fn axis() -> Vector3<f64> {
        Vector3::new(0.6, -0.48, 0.64)
    }

    #[test]
    fn jacobians_invert_each_other() {
        for angle in ANGLES {
            let rotation_vector = axis() * angle;
            let product = left_jacobian(&rotation_vector) * left_jacobian_inverse(&rotation_vector);
            assert!((product - Matrix3::identity()).norm() < 4e-15, "{angle}: {product}");
        }
    }

    #[test]
    fn left_jacobian_matches_high_precision() {
        // (θ - sin θ)/θ³ and (1 - (θ/2) cot(θ/2))/θ², by series with 60 digits (Python 3's decimal).
        let expected = [
            (1e-3, 0.1666666583333335, 0.08333333472222225),
            (0.03, 0.1666591668273789, 0.08333458336011965),
            (0.999, 0.1585448973593093, 0.08475322555824443),
            (1.001, 0.1585131186579002, 0.084759055929927),
        ];
        for (angle, b, c) in expected {
            let x = Vector3::new(angle, 0.0, 0.0);
            // The yy entry is 1 - b θ² and 1 - c θ².
            let square = angle * angle;
            let errors = [
                left_jacobian(&x)[(1, 1)] - (1.0 - b * square),
                left_jacobian_inverse(&x)[(1, 1)] - (1.0 - c * square),
                factorial_series(square, |_| 1.0) / b - 1.0,
            ];
            // A few units in the last place of one.
            assert!(errors.iter().all(|error| error.abs() < 5e-16), "{angle}: {errors:?}");
        }
    }

    #[test]
    fn log_inverts_exp() {
        for angle in ANGLES {
            let rotation_vector = axis() * angle;
            let translation = Vector3::new(0.3, 20.0, -1e-3);
            let mut tangent = Vector6::zeros();
            tangent.fixed_rows_mut::<3>(0).copy_from(&rotation_vector);
            tangent.fixed_rows_mut::<3>(3).copy_from(&translation);
            let back = Pose::exp(&tangent).log();
            // Rotations to the precision of their angle, translations to that of 20 m.
            assert!((back - tangent).fixed_rows::<3>(0).norm() < 1e-15, "{angle}: {back}");
            assert!((back - tangent).fixed_rows::<3>(3).norm() < 3e-14, "{angle}: {back}");
        }
    }

    #[test]
    fn rodrigues_turns_right_handed() {
        let about_z = Pose::from_rodrigues(Vector3::new(0.0, 0.0, FRAC_PI_2), Vector3::new(1.0, 2.0, 3.0));
        let point = about_z * Point3::new(1.0, 0.0, 0.0);
        assert!((point - Point3::new(1.0, 3.0, 3.0)).norm() < 1e-15);
    }

    #[test]
    fn half_turns_keep_their_axis() {
        for axis in [Vector3::x(), Vector3::y(), Vector3::z(), axis()] {
            let pose = Pose::from_rodrigues(axis * PI, Vector3::zeros());
            let back = Pose::from_matrix(&pose.rotation_matrix(), Vector3::zeros()).rodrigues();
            // The sign of the axis of a half turn is anybody's.
            assert!((back.dot(&axis).abs() - PI).abs() < 1e-15 && back.cross(&axis).norm() < 1e-15);
        }
    }

    fn tangents() -> impl Strategy<Value = Vector6<f64>> {
        // In the cube of half side 1.8 rotations reach 3.12, just short of π.
        (prop::array::uniform3(-1.8..1.8), prop::array::uniform3(-5.0..5.0))
            .prop_map(|(r, t)| Vector6::new(r[0], r[1], r[2], t[0], t[1], t[2]))
    }

    fn distance(one: &Pose, other: &Pose) -> f64 {
        (one.rotation_matrix() - other.rotation_matrix()).norm()
            + (one.translation - other.translation).norm()
    }

    proptest! {
        #[test]
        fn log_inverts_exp_anywhere(tangent in tangents()) {
            prop_assert!((Pose::exp(&tangent).log() - tangent).norm() < 1e-13);
        }

        #[test]
        fn inverses_cancel(tangent in tangents()) {
            let pose = Pose::exp(&tangent);
            // Translations of several metres cancel to their rounding.
            let rounding = 16.0 * f64::EPSILON * (1.0 + pose.translation.norm());
            prop_assert!(distance(&(pose * pose.inverse()), &Pose::identity()) < rounding);
            prop_assert!(distance(&Pose::exp(&-tangent), &pose.inverse()) < 1e-13);
        }

        #[test]
        fn composition_is_associative(a in tangents(), b in tangents(), point in prop::array::uniform3(-5.0..5.0)) {
            let (c_from_b, b_from_a) = (Pose::exp(&a), Pose::exp(&b));
            let point_in_a = Point3::from(point);
            let both = c_from_b * b_from_a * point_in_a;
            prop_assert!((both - c_from_b * (b_from_a * point_in_a)).norm() < 1e-13);
        }

        #[test]
        fn adjoint_moves_perturbations_to_the_left(a in tangents(), small in tangents()) {
            let pose = Pose::exp(&a);
            let left = Pose::exp(&(pose.adjoint() * small)) * pose;
            prop_assert!(distance(&(pose * Pose::exp(&small)), &left) < 1e-12);
        }

        #[test]
        fn perturbation_is_on_the_left(a in tangents(), b in tangents()) {
            let pose = Pose::exp(&a);
            prop_assert!(distance(&pose.perturbed(&b), &(Pose::exp(&b) * pose)) < 1e-14);
            // To first order, a point moves by ω x p + v.
            let point = pose.translation;
            let moved = pose.perturbed(&(b * 1e-6)) * Vector3::zeros();
            let expected = b.fixed_rows::<3>(0).cross(&point) + b.fixed_rows::<3>(3);
            // The second order is 1e-12 |ω|² |p|.
            prop_assert!(((moved - point) - expected * 1e-6).norm() < 1e-10);
        }

        #[test]
        fn matrices_keep_rotations(tangent in tangents()) {
            let pose = Pose::exp(&tangent);
            prop_assert!(distance(&Pose::from_matrix(&pose.rotation_matrix(), pose.translation), &pose) < 2e-15);
        }
    }
}
