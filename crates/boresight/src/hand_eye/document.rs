//! `hand-eye.json`: the robot's part of a result.

use boresight_data::Mounting;
use boresight_geometry::Pose;
use serde::Serialize;

use super::compare::{length, median};
use super::stretch::StretchDocument;
use super::{HandEyeOutcome, MethodFigures, TouchedPoints, WorkingPoint};

/// The name and version of the document's layout.
pub const HAND_EYE_SCHEMA: &str = "boresight.hand-eye/1";

/// What `hand-eye.json` says.
#[derive(Clone, Debug, Serialize)]
pub struct HandEyeDocument {
    schema: &'static str,
    mount: &'static str,
    poses: Vec<PoseDocument>,
    /// How positions of the robot are to be corrected before `poses` are used with them; `None`: not at all.
    stretch: Option<StretchDocument>,
    /// The poses for positions as the robot says them, where there is a stretch.
    without_stretch: Option<PlainDocument>,
    /// The headline: how frames are foretold that were left out, by the method that was chosen.
    leave_one_out: MethodFigures,
    /// Each frame's mean distance in metres when it is left out.
    frames: Vec<(String, f64)>,
    methods: Vec<MethodFigures>,
    robot_noise: Option<NoiseDocument>,
    /// How far the clocks of robot and camera are apart, where the robot moved.
    clock: Option<super::ClockPair>,
    /// What touched points say of the result, where there are any.
    touched: Option<TouchedPoints>,
    working_points: Vec<WorkingPoint>,
    median_sigma_m: f64,
    worst_sigma_m: f64,
    findings: Vec<boresight_data::Finding>,
}

#[derive(Clone, Debug, Serialize)]
struct PoseDocument {
    name: &'static str,
    rotation_xyzw: [f64; 4],
    translation_m: [f64; 3],
    /// Of a left perturbation, rotation first; only where the robot's noise is part of the adjustment.
    sigma_rad_m: Option<[f64; 6]>,
    jackknife_sigma_rad_m: Option<[f64; 6]>,
}

#[derive(Clone, Debug, Serialize)]
struct PlainDocument {
    poses: Vec<PoseDocument>,
    leave_one_out: MethodFigures,
}

impl PoseDocument {
    /// Returns a pose of which no sigma is told.
    fn plain(name: &'static str, pose: Pose) -> Self {
        Self {
            name,
            rotation_xyzw: pose.rotation.coords.into(),
            translation_m: pose.translation.into(),
            sigma_rad_m: None,
            jackknife_sigma_rad_m: None,
        }
    }
}

#[derive(Clone, Debug, Serialize)]
struct NoiseDocument {
    rotation_rad: f64,
    translation_m: f64,
    relative_sigma_rotation: f64,
    relative_sigma_translation: f64,
    is_used: bool,
    rounds: usize,
    settled: bool,
}

impl HandEyeDocument {
    /// Returns the document of an outcome.
    pub fn new(outcome: &HandEyeOutcome) -> Self {
        let calibration = &outcome.outcome.calibration;
        let is_noise_used = outcome.methods[outcome.chosen].name.contains("noise");
        let names = match outcome.mounting {
            Mounting::RigOnFlange => ["flange_from_rig", "base_from_target"],
            Mounting::RigInBase => ["base_from_rig", "flange_from_target"],
        };
        let poses = calibration.scene.robot.as_ref().map_or(Vec::new(), |robot| {
            let pose = |which: usize, pose: Pose| PoseDocument {
                sigma_rad_m: is_noise_used
                    .then(|| {
                        let columns = ["rx_rad", "ry_rad", "rz_rad", "tx_m", "ty_m", "tz_m"];
                        let sigmas = columns.map(|column| {
                            calibration.uncertainty.sigma(&format!("robot.{}.{column}", names[which]))
                        });
                        sigmas
                            .iter()
                            .all(Option::is_some)
                            .then(|| sigmas.map(|sigma| sigma.unwrap_or(f64::NAN)))
                    })
                    .flatten(),
                jackknife_sigma_rad_m: (which == 0
                    && outcome.jackknife.iter().all(|sigma| sigma.is_finite()))
                .then_some(outcome.jackknife),
                ..PoseDocument::plain(names[which], pose)
            };
            vec![pose(0, robot.carrier_from_rig()), pose(1, robot.other_from_target())]
        });
        let sigmas: Vec<f64> = outcome.working_points.iter().map(|point| length(point.sigma_m)).collect();
        Self {
            schema: HAND_EYE_SCHEMA,
            mount: match outcome.mounting {
                Mounting::RigOnFlange => "on-flange",
                Mounting::RigInBase => "fixed",
            },
            poses,
            stretch: calibration
                .scene
                .robot
                .as_ref()
                .and_then(|robot| robot.stretch.as_ref())
                .map(StretchDocument::new),
            without_stretch: outcome.without_stretch.as_ref().map(|plain| PlainDocument {
                poses: vec![
                    PoseDocument::plain(names[0], plain.carrier_from_rig),
                    PoseDocument::plain(names[1], plain.other_from_target),
                ],
                leave_one_out: plain.method.clone(),
            }),
            leave_one_out: outcome.methods[outcome.chosen].clone(),
            frames: outcome.frames.clone(),
            methods: outcome.methods.clone(),
            robot_noise: outcome.noise.as_ref().map(|noise| NoiseDocument {
                rotation_rad: noise.noise.rotation_rad,
                translation_m: noise.noise.translation_m,
                relative_sigma_rotation: noise.relative_sigmas[0],
                relative_sigma_translation: noise.relative_sigmas[1],
                is_used: is_noise_used,
                rounds: noise.rounds.0,
                settled: noise.rounds.1,
            }),
            clock: outcome.clock,
            touched: outcome.touched.clone(),
            working_points: outcome.working_points.clone(),
            median_sigma_m: median(&sigmas),
            worst_sigma_m: sigmas.iter().copied().fold(f64::NAN, f64::max),
            findings: outcome.outcome.findings.clone(),
        }
    }

    /// Returns the document as JSON.
    pub fn to_json(&self) -> Vec<u8> {
        let mut bytes = serde_json::to_vec_pretty(self).expect("plain numbers and texts are JSON");
        bytes.push(b'\n');
        bytes
    }
}
