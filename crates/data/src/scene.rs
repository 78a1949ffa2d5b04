//! What is believed: lenses, where cameras sit, where targets stood. Seeds, solutions and truths are scenes.

use boresight_camera::Camera;
use boresight_geometry::{Matrix3, Pose, Vector3, Vector6};
use serde::{Deserialize, Serialize};

use crate::{CameraId, FrameId, IdVec, TargetId};

/// A complete belief about cameras, targets and their poses.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scene {
    /// The cameras and where they sit.
    pub rig: Rig,
    /// The robot, where there is one.
    pub robot: Option<Robot>,
    /// The shape and arrangement of the targets.
    pub targets: IdVec<TargetId, TargetBelief>,
    /// Where the first target stood in each frame, seen from the rig; `None` where nothing tells.
    pub rig_from_target: IdVec<FrameId, Option<Pose>>,
    /// How it moved there; `None` where nothing tells, and empty unless that was asked for.
    pub motion: IdVec<FrameId, Option<FrameMotion>>,
}

/// How the first target moved in a frame, seen from the rig: `t` seconds after the frame's time it stood at
/// `exp(t * velocity + t² / 2 * acceleration) * rig_from_target`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameMotion {
    /// The tangent `[rotation, translation]` per second, in radians and metres.
    pub velocity: Vector6<f64>,
    /// The same per square second.
    pub acceleration: Vector6<f64>,
}

/// The cameras of a rig. The rig's frame is that of its reference camera, the first one calibrated.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rig {
    /// Each camera; `None` where it could not be calibrated.
    pub cameras: IdVec<CameraId, Option<RigCamera>>,
}

/// A camera and where it sits in the rig.
#[derive(Clone, Debug, PartialEq)]
pub struct RigCamera {
    /// The lens.
    pub camera: Camera,
    /// The camera's pose; the textbook's M with the rig as the reference frame.
    pub cam_from_rig: Pose,
    /// How much later than a frame's time the camera took its image of it, in seconds; zero unless that was estimated.
    pub time_offset_s: f64,
    /// How much later than the row above it each row of an image was taken, in seconds; zero for a global shutter. An
    /// image's time is that of its middle row.
    pub line_delay_s: f64,
}

/// What is believed of a target beyond its drawing.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TargetBelief {
    /// The shape coefficients, in metres; none for a rigid target.
    pub shape_m: Vec<f64>,
    /// Where this target stands relative to the first; the identity for the first.
    pub first_from_target: Pose,
}

/// A robot, and how rig and target relate to it.
#[derive(Clone, Debug, PartialEq)]
pub struct Robot {
    /// Where the rig is mounted.
    pub mount: Mount,
    /// Where the target is mounted.
    pub target_mount: TargetMount,
    /// The touching tip, where one was used.
    pub tip_in_flange: Option<Vector3<f64>>,
    /// How the robot's positions are off as a whole, where that was estimated.
    pub stretch: Option<Stretch>,
}

/// A robot's positions are off by a linear map of the distance from a centre: a wrong length of an arm, a slanted
/// axis, or a target whose spacing is not what is stated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stretch {
    /// The centre in the base, in metres.
    pub centre_in_base: Vector3<f64>,
    /// What is to be added to a position, for each metre from the centre.
    pub matrix: Matrix3<f64>,
}

impl Stretch {
    /// Returns where the flange is when the robot says that it is at `base_from_flange`.
    pub fn corrected(&self, base_from_flange: &Pose) -> Pose {
        let offset = self.matrix * (base_from_flange.translation - self.centre_in_base);
        Pose::new(base_from_flange.rotation, base_from_flange.translation + offset)
    }
}

/// Where the rig is mounted.
#[derive(Clone, Debug, PartialEq)]
pub enum Mount {
    /// On the robot's flange: a mobile camera.
    OnFlange {
        /// The rig's pose on the flange.
        flange_from_rig: Pose,
    },
    /// In the work cell: a fixed camera.
    Fixed {
        /// The rig's pose in the robot's base frame.
        base_from_rig: Pose,
    },
}

/// Where the target is mounted.
#[derive(Clone, Debug, PartialEq)]
pub enum TargetMount {
    /// In the work cell.
    Fixed {
        /// The target's pose in the robot's base frame.
        base_from_target: Pose,
    },
    /// On the robot's flange.
    OnFlange {
        /// The target's pose on the flange.
        flange_from_target: Pose,
    },
}

/// Which of rig and target moves with the robot's flange; the other stays in the work cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Mounting {
    /// A mobile camera: the rig is on the flange, the target in the work cell.
    RigOnFlange,
    /// A fixed camera: the rig is in the work cell, the target on the flange.
    RigInBase,
}

impl Robot {
    /// Returns a robot whose carrier bears the rig at `carrier_from_rig` and whose other end bears the target.
    pub fn mounted(mounting: Mounting, carrier_from_rig: Pose, other_from_target: Pose) -> Self {
        let (mount, target_mount) = match mounting {
            Mounting::RigOnFlange => (
                Mount::OnFlange { flange_from_rig: carrier_from_rig },
                TargetMount::Fixed { base_from_target: other_from_target },
            ),
            Mounting::RigInBase => (
                Mount::Fixed { base_from_rig: carrier_from_rig },
                TargetMount::OnFlange { flange_from_target: other_from_target },
            ),
        };
        Self { mount, target_mount, tip_in_flange: None, stretch: None }
    }

    /// Returns which of rig and target moves, or `None` if both do or neither does.
    pub fn mounting(&self) -> Option<Mounting> {
        match (&self.mount, &self.target_mount) {
            (Mount::OnFlange { .. }, TargetMount::Fixed { .. }) => Some(Mounting::RigOnFlange),
            (Mount::Fixed { .. }, TargetMount::OnFlange { .. }) => Some(Mounting::RigInBase),
            _ => None,
        }
    }

    /// Returns the rig's pose on the flange or in the base, whichever bears it.
    pub fn carrier_from_rig(&self) -> Pose {
        match self.mount {
            Mount::OnFlange { flange_from_rig } => flange_from_rig,
            Mount::Fixed { base_from_rig } => base_from_rig,
        }
    }

    /// Returns the first target's pose in the base or on the flange, whichever bears it.
    pub fn other_from_target(&self) -> Pose {
        match self.target_mount {
            TargetMount::Fixed { base_from_target } => base_from_target,
            TargetMount::OnFlange { flange_from_target } => flange_from_target,
        }
    }

    /// Returns where the flange is when the robot says that it is at `base_from_flange`.
    pub fn corrected(&self, base_from_flange: &Pose) -> Pose {
        self.stretch.map_or(*base_from_flange, |stretch| stretch.corrected(base_from_flange))
    }

    /// Returns where the rig sees the first target when the flange is at `base_from_flange`.
    pub fn rig_from_target(&self, base_from_flange: &Pose) -> Pose {
        let other_from_carrier = match (&self.mount, &self.target_mount) {
            (Mount::OnFlange { .. }, TargetMount::Fixed { .. }) => *base_from_flange,
            (Mount::Fixed { .. }, TargetMount::OnFlange { .. }) => base_from_flange.inverse(),
            // Both on the same body: the robot's pose plays no part.
            _ => Pose::identity(),
        };
        (other_from_carrier * self.carrier_from_rig()).inverse() * self.other_from_target()
    }
}

impl FrameMotion {
    /// Returns by what the target moves until `time_s` after the frame's time: a factor of `rig_from_target` from
    /// the left.
    pub fn after(&self, time_s: f64) -> Pose {
        Pose::exp(&self.tangent(time_s))
    }

    /// Returns the left perturbation of [`after`](Self::after) per second of `time_s`.
    pub fn rate(&self, time_s: f64) -> Vector6<f64> {
        // The left Jacobian as a series of brackets, sum of adⁿ / (n + 1)!; what is left out is below 1e-4 of the rate for
        // motions of a tenth, and below 1e-6 for those of a few hundredths.
        let tangent = self.tangent(time_s);
        let rate = self.velocity + self.acceleration * time_s;
        let once = bracket(&tangent, &rate);
        rate + once / 2.0 + bracket(&tangent, &once) / 6.0
    }

    fn tangent(&self, time_s: f64) -> Vector6<f64> {
        self.velocity * time_s + self.acceleration * (0.5 * time_s * time_s)
    }
}

/// Returns the Lie bracket of two tangents `[rotation, translation]`.
fn bracket(a: &Vector6<f64>, b: &Vector6<f64>) -> Vector6<f64> {
    let part = |tangent: &Vector6<f64>, first: usize| {
        Vector3::new(tangent[first], tangent[first + 1], tangent[first + 2])
    };
    let (turn_a, shift_a, turn_b, shift_b) = (part(a, 0), part(a, 3), part(b, 0), part(b, 3));
    let (turn, shift) = (turn_a.cross(&turn_b), turn_a.cross(&shift_b) + shift_a.cross(&turn_b));
    Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z)
}

impl Scene {
    /// Returns the first target's pose in a camera as it took the middle row of its image of a frame; `None` where either
    /// is unknown.
    ///
    /// Where nothing tells how the target moved, it is taken to have stood still.
    pub fn cam_from_first(&self, camera: CameraId, frame: FrameId) -> Option<Pose> {
        self.cam_from_first_after(camera, frame, self.rig.cameras.get(camera)?.as_ref()?.time_offset_s)
    }

    /// Returns the same as the camera took row `v_px` of its image.
    pub fn cam_from_first_at_row(&self, camera: CameraId, frame: FrameId, v_px: f64) -> Option<Pose> {
        self.cam_from_first_after(camera, frame, self.rig.cameras.get(camera)?.as_ref()?.late_s(v_px))
    }

    fn cam_from_first_after(&self, camera: CameraId, frame: FrameId, time_s: f64) -> Option<Pose> {
        let camera = self.rig.cameras.get(camera)?.as_ref()?;
        let rig_from_target = (*self.rig_from_target.get(frame)?)?;
        let motion = self.motion.get(frame).copied().flatten().filter(|_| time_s != 0.0);
        Some(match motion {
            Some(motion) => camera.cam_from_rig * motion.after(time_s) * rig_from_target,
            None => camera.cam_from_rig * rig_from_target,
        })
    }
}

impl RigCamera {
    /// Returns a camera that takes its images at the frames' times, all rows at once.
    pub fn new(camera: Camera, cam_from_rig: Pose) -> Self {
        Self { camera, cam_from_rig, time_offset_s: 0.0, line_delay_s: 0.0 }
    }

    /// Returns how many rows below the middle of its images row `v_px` is.
    pub fn rows_from_middle(&self, v_px: f64) -> f64 {
        v_px - 0.5 * (f64::from(self.camera.image_size[1]) - 1.0)
    }

    /// Returns how much later than a frame's time the camera took row `v_px` of its image of it, in seconds.
    pub fn late_s(&self, v_px: f64) -> f64 {
        self.time_offset_s + self.line_delay_s * self.rows_from_middle(v_px)
    }
}

impl Rig {
    /// Returns the reference camera: the first that is calibrated.
    pub fn reference(&self) -> Option<CameraId> {
        self.cameras.enumerate().find(|(_, camera)| camera.is_some()).map(|(id, _)| id)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rate_of_a_motion_matches_differences() {
        let motion = FrameMotion {
            velocity: Vector6::new(0.8, -0.5, 0.3, 0.4, 0.2, -0.6),
            acceleration: Vector6::new(-1.0, 2.0, 0.7, 1.5, -0.8, 0.9),
        };
        for time_s in [0.0, 0.02, -0.05] {
            let step_s = 1e-5;
            let [before, after] = [-step_s, step_s].map(|step_s| motion.after(time_s + step_s));
            let difference = (after * before.inverse()).log() / (2.0 * step_s);
            // Central differences are good to 1e-9 here, the series to 1e-6.
            assert!((difference - motion.rate(time_s)).norm() < 2e-6, "{time_s}");
        }
    }
}
