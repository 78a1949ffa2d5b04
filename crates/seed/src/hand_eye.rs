//! Where a rig and a target sit on a robot: closed forms from pairs of poses.
//!
//! One equation serves every mount. The rig sits on its *carrier*, the target on the *other* of flange
//! and base: `other_from_carrier(i) * carrier_from_rig * rig_from_target(i) = other_from_target`. For a
//! camera on the flange the carrier is the flange and the other the base; for a fixed camera the carrier
//! is the base and the other the flange. All classical methods are kept, so that they can be compared.

mod four_axis;
mod motion;
mod reading;
mod robot_world;
mod rotation;
mod translation;

use boresight_data::Mounting;
use boresight_geometry::nalgebra::Matrix4;
use boresight_geometry::{Matrix3, Pose, UnitQuaternion, Vector3};

pub use motion::{MotionSpread, motion_spread};
pub use reading::{Reading, RowChange, readings};

use crate::linear::nearest_rotation;

/// What the robot said and what the camera saw in one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PosePair {
    /// Where the robot said the rig's carrier was.
    pub other_from_carrier: Pose,
    /// Where the rig saw the target.
    pub rig_from_target: Pose,
}

/// Where rig and target sit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandEye {
    /// The rig on its carrier: on the flange, or in the base.
    pub carrier_from_rig: Pose,
    /// The target on the other: in the base, or on the flange.
    pub other_from_target: Pose,
}

/// A closed form.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Method {
    /// Tsai & Lenz 1989: rotation from modified Rodrigues vectors, then translation.
    Tsai,
    /// Park & Martin 1994: rotation from rotation vectors, then translation.
    Park,
    /// Horaud & Dornaika 1995: rotation from unit axes, then translation.
    Horaud,
    /// Daniilidis 1999: both at once from dual quaternions.
    Daniilidis,
    /// Shah 2013: both rotations from a Kronecker product, then both translations.
    Shah,
    /// Li, Wang & Wu 2010: all at once from Kronecker products.
    Li,
    /// For robots that turn about one axis only: its direction from rotations, the angle about it and the
    /// translation across it from one linear system. The translation along it stays open and is set to zero.
    FourAxis,
}

impl Method {
    /// All methods for robots that turn about more than one axis.
    pub const SIX_AXIS: [Self; 6] =
        [Self::Tsai, Self::Park, Self::Horaud, Self::Daniilidis, Self::Shah, Self::Li];

    /// Returns the name as people know it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Tsai => "tsai",
            Self::Park => "park",
            Self::Horaud => "horaud",
            Self::Daniilidis => "daniilidis",
            Self::Shah => "shah",
            Self::Li => "li",
            Self::FourAxis => "four-axis",
        }
    }
}

/// Returns where rig and target sit by a closed form, or `None` where the poses do not determine it.
pub fn hand_eye(pairs: &[PosePair], method: Method) -> Option<HandEye> {
    if pairs.len() < 3 {
        return None;
    }
    let motions = motion::motions(pairs);
    let by_rotation = |rotation: Option<UnitQuaternion<f64>>| {
        let rotation = rotation?;
        let translation = translation::of_rig(&motions, &rotation)?;
        Some(with_target(pairs, Pose::new(rotation, translation)))
    };
    let found = match method {
        Method::Tsai => by_rotation(rotation::tsai(&motions)),
        Method::Park => by_rotation(rotation::park(&motions)),
        Method::Horaud => by_rotation(rotation::horaud(&motions)),
        Method::Daniilidis => rotation::daniilidis(&motions).map(|pose| with_target(pairs, pose)),
        Method::Shah => robot_world::shah(pairs),
        Method::Li => robot_world::li(pairs),
        Method::FourAxis => four_axis::four_axis(&motions).map(|pose| with_target(pairs, pose)),
    }?;
    let is_finite = |pose: &Pose| {
        pose.translation.iter().chain(pose.rotation.coords.iter()).all(|number| number.is_finite())
    };
    (is_finite(&found.carrier_from_rig) && is_finite(&found.other_from_target)).then_some(found)
}

impl HandEye {
    /// Returns where the rig should see the target in a frame.
    pub fn rig_from_target(&self, other_from_carrier: &Pose) -> Pose {
        (*other_from_carrier * self.carrier_from_rig).inverse() * self.other_from_target
    }

    /// Returns the distance in metres between where the rig should see each of `points_in_target` and
    /// where it did, root mean square.
    pub fn distance_m(&self, pair: &PosePair, points_in_target: &[Vector3<f64>]) -> f64 {
        let predicted = self.rig_from_target(&pair.other_from_carrier);
        let squares: f64 = points_in_target
            .iter()
            .map(|point| (predicted * *point - pair.rig_from_target * *point).norm_squared())
            .sum();
        (squares / points_in_target.len().max(1) as f64).sqrt()
    }
}

/// Returns the pair of a robot's reading and a sight, for a mounting.
pub fn pose_pair(mounting: Mounting, base_from_flange: &Pose, rig_from_target: &Pose) -> PosePair {
    let other_from_carrier = match mounting {
        Mounting::RigOnFlange => *base_from_flange,
        Mounting::RigInBase => base_from_flange.inverse(),
    };
    PosePair { other_from_carrier, rig_from_target: *rig_from_target }
}

/// Completes a pose of the rig with the mean pose of the target that it asks for.
fn with_target(pairs: &[PosePair], carrier_from_rig: Pose) -> HandEye {
    let mut quaternions = Matrix4::zeros();
    let mut translation = Vector3::zeros();
    for pair in pairs {
        let other_from_target = pair.other_from_carrier * carrier_from_rig * pair.rig_from_target;
        let q = other_from_target.rotation.coords;
        quaternions += q * q.transpose();
        translation += other_from_target.translation;
    }
    let rotation = rotation::quaternion_of(&largest_eigenvector(&quaternions));
    HandEye { carrier_from_rig, other_from_target: Pose::new(rotation, translation / pairs.len() as f64) }
}

/// Returns the unit eigenvector of the largest eigenvalue.
fn largest_eigenvector(matrix: &Matrix4<f64>) -> boresight_geometry::nalgebra::Vector4<f64> {
    let eigen = matrix.symmetric_eigen();
    eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned()
}

/// Returns the rotation nearest to a matrix that is one up to a scale of either sign.
fn rotation_of(matrix: &Matrix3<f64>) -> Option<UnitQuaternion<f64>> {
    let signed = matrix * matrix.determinant().signum();
    Some(Pose::from_matrix(&nearest_rotation(&signed)?, Vector3::zeros()).rotation)
}

#[cfg(test)]
mod tests;
