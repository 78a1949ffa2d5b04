//! How the robot moved between frames, and what such motions can tell.

use boresight_geometry::{Matrix3, Pose, Vector3};

use super::PosePair;

/// A motion between two frames, as the robot and as the rig saw it: `carrier * X = X * rig`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Motion {
    /// The later carrier from the earlier.
    pub later_from_earlier_carrier: Pose,
    /// The later rig from the earlier.
    pub later_from_earlier_rig: Pose,
}

/// Frames beyond this many are paired with their neighbours up to that distance only.
const MAX_PARTNERS: usize = 60;

/// Returns the motions between frames, each pair once.
pub(super) fn motions(pairs: &[PosePair]) -> Vec<Motion> {
    let mut motions = Vec::new();
    for (i, earlier) in pairs.iter().enumerate() {
        for later in pairs[i + 1..].iter().take(MAX_PARTNERS) {
            motions.push(Motion {
                later_from_earlier_carrier: later.other_from_carrier.inverse() * earlier.other_from_carrier,
                later_from_earlier_rig: later.rig_from_target * earlier.rig_from_target.inverse(),
            });
        }
    }
    motions
}

/// How different a robot's poses were.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionSpread {
    /// The number of poses that differ from all before by more than the limits.
    pub distinct: usize,
    /// The largest rotation between any two poses, in radians.
    pub largest_rotation_rad: f64,
    /// The largest translation between any two poses, in metres.
    pub largest_translation_m: f64,
    /// The root mean square sines of half the rotations about the three principal axes, largest first:
    /// how much the robot turned about each.
    pub spread: [f64; 3],
    /// The principal axes in the frame of the carrier, in the same order.
    pub axes: [[f64; 3]; 3],
}

impl MotionSpread {
    /// Returns how much the robot turned about its second axis, relative to the first.
    pub fn second_axis(&self) -> f64 {
        if self.spread[0] > 0.0 { self.spread[1] / self.spread[0] } else { 0.0 }
    }
}

/// Poses that differ by less count as the same.
const SAME_ROTATION_RAD: f64 = 0.5 * std::f64::consts::PI / 180.0;
const SAME_TRANSLATION_M: f64 = 1e-3;

/// Returns how different the robot's poses were. Axes are those of the motions seen from the carrier.
pub fn motion_spread(other_from_carrier: &[Pose]) -> MotionSpread {
    let mut distinct: Vec<Pose> = Vec::new();
    let (mut largest_rotation_rad, mut largest_translation_m) = (0.0f64, 0.0f64);
    let mut scatter = Matrix3::zeros();
    let mut n_motions = 0;
    for (i, one) in other_from_carrier.iter().enumerate() {
        let is_new = distinct.iter().all(|known| {
            (known.inverse() * *one).angle() > SAME_ROTATION_RAD
                || (known.translation - one.translation).norm() > SAME_TRANSLATION_M
        });
        if is_new {
            distinct.push(*one);
        }
        for other in &other_from_carrier[i + 1..] {
            let motion = one.inverse() * *other;
            let half = motion.rotation.imag();
            scatter += half * half.transpose();
            n_motions += 1;
            largest_rotation_rad = largest_rotation_rad.max(motion.angle());
            largest_translation_m = largest_translation_m.max((one.translation - other.translation).norm());
        }
    }
    let eigen = (scatter / f64::from(n_motions.max(1))).symmetric_eigen();
    let mut order = [0, 1, 2];
    order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
    MotionSpread {
        distinct: distinct.len(),
        largest_rotation_rad,
        largest_translation_m,
        spread: order.map(|i| eigen.eigenvalues[i].max(0.0).sqrt()),
        axes: order.map(|i| {
            let axis: Vector3<f64> = eigen.eigenvectors.column(i).into_owned();
            axis.into()
        }),
    }
}
