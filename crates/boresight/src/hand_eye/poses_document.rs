//! `hand-eye.json` of jobs without pixels.

use boresight_adjust::PoseNoise;
use boresight_data::{Finding, Mounting};
use boresight_geometry::Pose;
use serde::Serialize;

use super::{ClockPair, Joint, JointChain, JointLink, PoseFigures, PoseHandEye};

/// The name and version of the document of a hand-eye calibration from poses.
pub const HAND_EYE_POSES_SCHEMA: &str = "boresight.hand-eye-poses/1";
/// The name and version of the document of a positioner's joints.
pub const JOINTS_SCHEMA: &str = "boresight.joints/1";

#[derive(Serialize)]
struct PoseText {
    name: &'static str,
    rotation_xyzw: [f64; 4],
    translation_m: [f64; 3],
    /// Of a left perturbation, rotation first.
    sigma_rad_m: [f64; 6],
}

impl PoseText {
    fn new(name: &'static str, pose: &Pose, sigma_rad_m: [f64; 6]) -> Self {
        Self {
            name,
            rotation_xyzw: pose.rotation.coords.into(),
            translation_m: pose.translation.into(),
            sigma_rad_m,
        }
    }
}

#[derive(Serialize)]
struct NoiseText {
    rotation_rad: [f64; 3],
    translation_m: [f64; 3],
    /// Of the t distribution; `null` for a normal one.
    degrees_of_freedom: Option<f64>,
}

impl NoiseText {
    fn new(noise: &PoseNoise) -> Self {
        Self {
            rotation_rad: noise.rotation_sigmas_rad(),
            translation_m: noise.translation_sigmas_m(),
            degrees_of_freedom: noise.degrees_of_freedom.is_finite().then_some(noise.degrees_of_freedom),
        }
    }
}

#[derive(Serialize)]
struct MethodText<'a> {
    name: &'a str,
    left_out: Option<PoseFigures>,
}

#[derive(Serialize)]
struct HandEyeText<'a> {
    schema: &'static str,
    mount: &'static str,
    poses: [PoseText; 2],
    clock: Option<ClockPair>,
    sights: usize,
    used: usize,
    far_off: usize,
    blocks: usize,
    noise: NoiseText,
    methods: Vec<MethodText<'a>>,
    converged: bool,
    findings: &'a [Finding],
    inputs: &'a [(String, String)],
}

#[derive(Serialize)]
struct JointsText<'a> {
    schema: &'static str,
    joints: &'a [Joint],
    links: &'a [JointLink],
    poses: [PoseText; 1],
    sights: usize,
    far_off: usize,
    noise: NoiseText,
    fitted: Option<PoseFigures>,
    left_out: Option<PoseFigures>,
    converged: bool,
    findings: &'a [Finding],
    inputs: &'a [(String, String)],
}

fn bytes(document: &impl Serialize) -> Vec<u8> {
    let mut bytes = serde_json::to_vec_pretty(document).expect("plain numbers and texts are JSON");
    bytes.push(b'\n');
    bytes
}

/// Returns the document of a hand-eye calibration from poses, with the files that it was made from.
pub fn pose_hand_eye_to_json(found: &PoseHandEye, inputs: &[(String, String)]) -> Vec<u8> {
    let (mount, names) = match found.mounting {
        Mounting::RigOnFlange => ("on-flange", ["flange_from_rig", "base_from_target"]),
        Mounting::RigInBase => ("fixed", ["base_from_rig", "flange_from_target"]),
    };
    let [sights, used, far_off] = found.sights;
    bytes(&HandEyeText {
        schema: HAND_EYE_POSES_SCHEMA,
        mount,
        poses: [
            PoseText::new(names[0], &found.carrier_from_rig, found.sigmas[0]),
            PoseText::new(names[1], &found.other_from_target, found.sigmas[1]),
        ],
        clock: found.clock,
        sights,
        used,
        far_off,
        blocks: found.blocks,
        noise: NoiseText::new(&found.noise),
        methods: found
            .methods
            .iter()
            .map(|(name, figures)| MethodText { name, left_out: *figures })
            .collect(),
        converged: found.is_converged,
        findings: &found.findings,
        inputs,
    })
}

/// Returns the document of a positioner's joints, with the files that it was made from.
pub fn joints_to_json(found: &JointChain, inputs: &[(String, String)]) -> Vec<u8> {
    let [sights, far_off] = found.sights;
    bytes(&JointsText {
        schema: JOINTS_SCHEMA,
        joints: &found.joints,
        links: &found.links,
        poses: [PoseText::new("rig_from_target", &found.rig_from_target, found.target_sigmas)],
        sights,
        far_off,
        noise: NoiseText::new(&found.noise),
        fitted: found.fitted,
        left_out: found.left_out,
        converged: found.is_converged,
        findings: &found.findings,
        inputs,
    })
}
