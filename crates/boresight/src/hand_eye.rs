//! Where cameras and targets sit on a robot: hand-eye and robot-world calibration in one adjustment.
//!
//! The cameras are calibrated first, each frame by itself, which tells the outliers and where the target was
//! seen. Closed forms place rig and target on the robot. One bundle adjustment of pixels follows, of lenses,
//! rig, target shape and the robot's two poses together, with and without noise of the robot's readings; what
//! foretells frames best that were left out is the answer.

mod checks;
mod compare;
mod document;
mod doubts;
mod held_lenses;
mod joint_chain;
mod pose_doctor;
mod poses_document;
#[cfg(test)]
mod poses_tests;
mod sighted_poses;
mod stretch;
mod touched;
mod while_moving;
mod working_points;

use boresight_adjust::{
    AdjustOptions, EstimatedNoise, HeldOut, Hold, Rejection, RobotNoise, RobotTouch, RobotTouches,
    TipKnowledge, adjust, estimate_robot_noise, leave_one_out, optimize,
};
use boresight_data::{
    Calibration, CameraId, Dataset, Finding, FrameId, Id as _, Mounting, RejectionReason, Robot, Scene,
    TargetId,
};
use boresight_geometry::{Pose, Vector3};
use boresight_io::{Job, RobotAxes, RobotInput, TouchInput};
use boresight_seed::hand_eye::{HandEye, Method, PosePair, hand_eye as closed_form, pose_pair};
use boresight_validate::verdict;

use crate::calibrate::{Outcome, Watch, calibrate};
use crate::error::Error;
use crate::options::CalibrateOptions;

pub use checks::{ROBOT_CODES, check_motions};
pub use compare::{Figures, MethodFigures};
pub use document::{HAND_EYE_SCHEMA, HandEyeDocument};
pub use joint_chain::{Joint, JointChain, JointLink, joint_chain};
pub use pose_doctor::{PoseReadings, describe as describe_reading, read_poses};
pub use poses_document::{HAND_EYE_POSES_SCHEMA, JOINTS_SCHEMA, joints_to_json, pose_hand_eye_to_json};
pub use sighted_poses::{ClockPair, PoseFigures, PoseHandEye, hand_eye_of_poses};
pub use stretch::PlainAnswer;
pub use touched::TouchedPoints;
pub use working_points::{SigmaSource, WorkingPoint};

/// The name of the adjustment with the robot's noise as the data tell it.
const NOISE_ESTIMATED: &str = "adjusted, robot noise estimated";

/// Frames below which a map of the robot's errors of position is not estimated.
const LEAST_FRAMES_FOR_STRETCH: usize = 8;

/// How a robot is calibrated.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct HandEyeOptions {
    /// How the cameras are calibrated.
    pub cameras: CalibrateOptions,
    /// How far the robot's readings are off.
    pub noise: NoiseChoice,
}

/// How far a robot's readings are off.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum NoiseChoice {
    /// Estimated from the data, and used if frames that are left out are then foretold better.
    #[default]
    Estimated,
    /// Not at all.
    None,
    /// By these standard deviations.
    Known(RobotNoise),
}

/// What a robot's calibration came to.
#[derive(Clone, Debug)]
pub struct HandEyeOutcome {
    /// The calibration and its findings; its scene has the robot.
    pub outcome: Outcome,
    /// Which of rig and target moves.
    pub mounting: Mounting,
    /// All methods, the closed forms first, as they foretell frames that were left out.
    pub methods: Vec<MethodFigures>,
    /// Which of them is the answer.
    pub chosen: usize,
    /// The answer without the robot's `stretch`, where the scene has one.
    pub without_stretch: Option<PlainAnswer>,
    /// How each frame is foretold by all others: its name, and the mean distance of its points in metres.
    pub frames: Vec<(String, f64)>,
    /// The robot's noise as the data tell it, where it was estimated.
    pub noise: Option<EstimatedNoise>,
    /// What touched points say of the result, where there are any.
    pub touched: Option<TouchedPoints>,
    /// How well points are known in the robot's base, one a frame.
    pub working_points: Vec<WorkingPoint>,
    /// How far the clocks of robot and camera are apart, where the robot moved.
    pub clock: Option<ClockPair>,
    /// The scatter of the robot's two poses over the frames that were left out, one after another: the
    /// jackknife's standard deviations `[rx, ry, rz, tx, ty, tz]` of the rig's pose.
    pub jackknife: [f64; 6],
}

/// An adjustment that may become the answer.
struct Candidate {
    options: AdjustOptions,
    /// The scene it starts from.
    start: Scene,
    /// How it foretells each frame.
    held_out: Vec<HeldOut>,
}

impl Candidate {
    fn is_stretched(&self) -> bool {
        self.options.robot_noise.is_some_and(|noise| noise.stretch.is_some())
    }
}

/// Calibrates cameras and robot of a job.
pub fn hand_eye(job: &Job, options: &HandEyeOptions, watch: &Watch) -> Result<HandEyeOutcome, Error> {
    let robot = job.robot.as_ref().ok_or(Error::NoRobotPoses)?;
    let first = calibrate(job, &options.cameras, watch)?;
    // Frames that the chosen cameras did not see are gone.
    let robot = robot.for_frames(&job.dataset, &first.dataset);
    let mut dataset = without_rejected(&first.dataset, &first.calibration);
    let moving = while_moving::place_frames(&robot, &mut dataset, &first.calibration.scene)?;
    let robot = moving.as_ref().map_or(&robot, |moving| &moving.robot);
    let frames = frames_told(&dataset, &first.calibration.scene);
    let poses: Vec<Pose> = frames.iter().map(|told| told.base_from_flange).collect();
    let told = robot.row_of_frame.iter().flatten().count();
    let readings = pose_doctor::pose_readings(robot, &dataset, &first.calibration.scene);
    if poses.len() < told
        && dataset
            .frames
            .iter()
            .zip(&robot.row_of_frame)
            .any(|(frame, row)| row.is_some() && frame.base_from_flange.is_none())
    {
        return Err(Error::UnreadablePoses {
            convention: robot.convention,
            finding: readings.finding.map(Box::new),
        });
    }
    let misread = readings.finding;
    let mut findings = check_motions(&poses, robot.axes).map_err(|why| or_misread(why, misread.as_ref()))?;
    findings.extend(misread.clone());
    findings.extend(doubts::of_pairs(robot, &dataset));
    findings.extend(moving.iter().flat_map(|moving| moving.findings.clone()));
    let pairs = |mounting| -> Vec<PosePair> {
        frames.iter().map(|told| pose_pair(mounting, &told.base_from_flange, &told.rig_from_target)).collect()
    };
    let corners = corners_of(&dataset);
    let start = |mounting| best_start(&pairs(mounting), &corners, robot.axes);
    let mounting = match robot.mounting {
        Some(mounting) => mounting,
        None => likelier(start(Mounting::RigOnFlange), start(Mounting::RigInBase)),
    };
    let other = if mounting == Mounting::RigOnFlange { Mounting::RigInBase } else { Mounting::RigOnFlange };
    let (_, mut hand_eye, misfit_m) = start(mounting).ok_or(Error::NoClosedForm { poses: poses.len() })?;
    findings.extend(doubts::of_mounting(mounting, misfit_m, start(other).map(|(.., misfit_m)| misfit_m)));
    if let (RobotAxes::Four, Some(pair)) = (robot.axes, pairs(mounting).first()) {
        hand_eye = at_height(hand_eye, mounting, &pair.other_from_carrier, robot.height_m);
    }

    let mut exact =
        AdjustOptions { rejection: Rejection::None, cancel: watch.cancel.clone(), ..first.adjust.clone() };
    if robot.axes == RobotAxes::Four && !is_height_touched(robot) {
        exact.holds.push(Hold::BaseHeight);
    }
    let factor = first.calibration.uncertainty.noise_factor.max(1e-9);
    exact.robot_touches = robot.touches.as_ref().map(|touches| touched(touches, factor));
    let mut seed = first.calibration.scene.clone();
    seed.robot = Some(Robot::mounted(mounting, hand_eye.carrier_from_rig, hand_eye.other_from_target));
    let seed = optimize(&dataset, &seed, &exact).map_err(|why| not_begun(why, misread.as_ref()))?.scene;
    let failed = |why: boresight_adjust::Error| not_fitted(why, misread.as_ref());

    let mut methods =
        compare::closed_forms(&dataset, &first.calibration.scene, mounting, &frames, robot.axes);
    let mut candidates: Vec<Candidate> = Vec::new();
    let mut offer = |name: &str, options: AdjustOptions, start: &Scene| -> Result<(), Error> {
        let held_out = leave_one_out(&dataset, start, &options).map_err(failed)?;
        methods.push(MethodFigures::of(name, &held_out));
        candidates.push(Candidate { options, start: start.clone(), held_out });
        Ok(())
    };
    offer("adjusted, robot exact", exact.clone(), &seed)?;
    let lenses = dataset.cameras.ids().map(Hold::Lens);
    let held = AdjustOptions { holds: exact.holds.iter().copied().chain(lenses).collect(), ..exact.clone() };
    let mut with_first_lenses = seed.clone();
    with_first_lenses.rig = first.calibration.scene.rig.clone();
    offer("adjusted, lenses held", held, &with_first_lenses)?;
    let mut noises: [Option<EstimatedNoise>; 2] = [None, None];
    // What touches are judged by.
    let mut noise_of_frames = None;
    match options.noise {
        NoiseChoice::None => {}
        NoiseChoice::Known(noise) => {
            noise_of_frames = Some(noise);
            let relative = RobotNoise {
                rotation_rad: noise.rotation_rad / factor,
                translation_m: noise.translation_m / factor,
                stretch: None,
            };
            offer(
                "adjusted, robot noise known",
                AdjustOptions { robot_noise: Some(relative), ..exact.clone() },
                &seed,
            )?;
        }
        NoiseChoice::Estimated => {
            let start =
                RobotNoise { rotation_rad: 1e-3 / factor, translation_m: 1e-3 / factor, stretch: None };
            let noise = estimate_robot_noise(&dataset, &with_first_lenses, start, &exact).map_err(failed)?;
            if exact.robot_touches.is_some() {
                // Touches of something else would make the robot's noise so large that it explains them.
                let mut frames_alone = AdjustOptions { robot_touches: None, ..exact.clone() };
                if robot.axes == RobotAxes::Four && !frames_alone.holds.contains(&Hold::BaseHeight) {
                    frames_alone.holds.push(Hold::BaseHeight);
                }
                let found = estimate_robot_noise(&dataset, &with_first_lenses, start, &frames_alone)
                    .map_err(failed)?;
                noise_of_frames = found.map(|found| found.noise);
            }
            if let Some(plain) = &noise {
                let with = AdjustOptions { robot_noise: Some(plain.relative), ..exact.clone() };
                offer(NOISE_ESTIMATED, with, &plain.scene)?;
            }
            let stretched = match &noise {
                // The map's nine numbers take more than they give from few frames, and need all axes to move.
                Some(plain) if frames.len() >= LEAST_FRAMES_FOR_STRETCH && robot.axes == RobotAxes::Six => {
                    let start = RobotNoise { stretch: Some(1e-2 / factor), ..plain.relative };
                    let is_there = |noise: &EstimatedNoise| noise.noise.stretch > Some(stretch::NEGLIGIBLE);
                    estimate_robot_noise(&dataset, &plain.scene, start, &exact)
                        .map_err(failed)?
                        .filter(is_there)
                }
                _ => None,
            };
            if let Some(stretched) = &stretched {
                let with = AdjustOptions { robot_noise: Some(stretched.relative), ..exact.clone() };
                offer("adjusted, robot noise and stretch estimated", with, &stretched.scene)?;
            }
            noises = [noise, stretched];
        }
    }
    let n_closed = methods.len() - candidates.len();
    // What foretells best with positions as the robot says them, and what needs them corrected.
    let stretched = candidates.iter().position(Candidate::is_stretched);
    let plain = best_of(&methods[n_closed..n_closed + stretched.unwrap_or(candidates.len())]);
    let is_needed =
        |&which: &usize| stretch::is_needed(&candidates[which].held_out, &candidates[plain].held_out);
    let needed = stretched.filter(is_needed);
    let chosen = needed.unwrap_or(plain);
    let Candidate { options: chosen_options, start, held_out } = &candidates[chosen];
    let mut calibration = adjust(&dataset, start, chosen_options, watch.observer.clone()).map_err(failed)?;
    if let Some(camera) = mirrored(&dataset, &first.calibration.scene, &calibration.scene) {
        return Err(Error::MirroredPoses { camera: camera.to_owned() });
    }
    // Lenses that are held for the robot's sake are not known exactly.
    if chosen_options.holds.len() > exact.holds.len() {
        let free = adjust(&dataset, start, &exact, None).map_err(failed)?.uncertainty;
        held_lenses::carry(&mut calibration, &free, &first.calibration.uncertainty, &dataset);
    }
    let without_stretch = match needed {
        None => None,
        Some(_) => {
            let Candidate { options, start, .. } = &candidates[plain];
            let scene = optimize(&dataset, start, options).map_err(failed)?.scene;
            scene.robot.map(|robot| PlainAnswer {
                method: methods[n_closed + plain].clone(),
                carrier_from_rig: robot.carrier_from_rig(),
                other_from_target: robot.other_from_target(),
            })
        }
    };
    let [plain_noise, stretched_noise] = noises;
    let noise = if needed.is_some() { stretched_noise } else { plain_noise };
    calibration.provenance = first.calibration.provenance.clone();
    calibration.provenance.options.insert("robot-poses-as".to_owned(), robot.convention.to_string());
    restore_rejected(&mut calibration, &first, &dataset);
    let jackknife = working_points::jackknife(held_out);
    let is_noise_used = chosen_options.robot_noise.is_some();
    let working_points =
        working_points::working_points(&dataset, &calibration, mounting, &jackknife, is_noise_used);
    // Where the robot's word is taken as exact although it is not, the covariance knows nothing of its errors.
    let is_tip_sigma_told = is_noise_used || options.noise == NoiseChoice::None;
    let touched = robot.touches.as_ref().and_then(|touches| {
        let touched = touched::touched_points(touches, &dataset, &calibration, noise_of_frames)?;
        let tip_sigma_m = touched.tip_sigma_m.filter(|_| is_tip_sigma_told);
        Some(TouchedPoints { tip_sigma_m, ..touched })
    });
    findings.extend(touched.as_ref().and_then(touched::doubt));
    findings.extend(doubts::of_misfit(&methods[n_closed + chosen], &frames, noise.as_ref()));
    findings.extend(doubts::of_noise(&methods, noise.as_ref(), is_noise_used));
    findings.extend(doubts::of_frames(&dataset, held_out));
    findings.extend(doubts::of_height(robot.axes, robot.height_m).filter(|_| !is_height_touched(robot)));
    findings.extend(doubts::of_stretch(&calibration, without_stretch.as_ref()));
    // Of the cameras it is their own calibration that tells; here residuals have the robot's errors in them.
    findings.extend(first.findings.iter().cloned());
    findings.sort_by_key(|finding: &Finding| std::cmp::Reverse(finding.severity));
    let frames = held_out.iter().map(|held_out| {
        let name = dataset.frames[held_out.frame].name.clone();
        (name, compare::mean(&held_out.errors.distances_m))
    });
    let frames = frames.collect();
    let verdict = verdict(&findings);
    let adjust = AdjustOptions { cancel: None, ..chosen_options.clone() };
    let outcome = Outcome { calibration, dataset, findings, verdict, adjust, ..first };
    let jackknife = jackknife.map(|(sigmas, _)| sigmas).unwrap_or([f64::NAN; 6]);
    let chosen = n_closed + chosen;
    let clock = moving.as_ref().map(|moving| moving.clock);
    Ok(HandEyeOutcome {
        outcome,
        mounting,
        methods,
        chosen,
        without_stretch,
        frames,
        noise,
        touched,
        working_points,
        clock,
        jackknife,
    })
}

/// Returns why no adjustment begins from the robot's poses: the poses, where they put points out of view, or anything else.
fn not_begun(why: boresight_adjust::Error, misread: Option<&Finding>) -> Error {
    use boresight_adjust::Error as Of;
    match why {
        Of::SeedOutOfView { .. } | Of::Solver(_) => {
            Error::PosesMisfit { why, finding: misread.cloned().map(Box::new) }
        }
        why => why.into(),
    }
}

/// Returns why an adjustment failed that had begun: the poses, where they put points out of view or another reading is
/// known to fit far better.
fn not_fitted(why: boresight_adjust::Error, misread: Option<&Finding>) -> Error {
    match (&why, misread) {
        (boresight_adjust::Error::SeedOutOfView { .. }, _) | (_, Some(_)) => not_begun(why, misread),
        (_, None) => why.into(),
    }
}

/// Adds to a refusal of motions that another reading of the poses is known to fit far better.
fn or_misread(why: Error, misread: Option<&Finding>) -> Error {
    match (why, misread) {
        (Error::Degenerate(mut refused), Some(misread)) => {
            refused.fix =
                format!("{} Or they are misread: {}. {}", refused.fix, misread.message, misread.fix);
            Error::Degenerate(refused)
        }
        (why, _) => why,
    }
}

/// Returns the first camera that an adjustment turned into its mirror image, by the signs of its focal lengths.
fn mirrored<'a>(dataset: &'a Dataset, before: &Scene, after: &Scene) -> Option<&'a str> {
    let is_turned = |scene: &Scene, camera: CameraId| {
        // Every lens model begins with fx and fy.
        scene.rig.cameras[camera].as_ref().map(|found| found.camera.params[0] * found.camera.params[1] < 0.0)
    };
    let changes = |camera: CameraId| is_turned(before, camera) != is_turned(after, camera);
    dataset.cameras.enumerate().find(|(camera, _)| changes(*camera)).map(|(_, info)| info.name.as_str())
}

/// Tells whether touches with a known tip tell the height that a four-axis robot leaves open, and nothing else does.
fn is_height_touched(robot: &RobotInput) -> bool {
    let is_tip_known = |touches: &TouchInput| touches.tip_m.is_some() && !touches.points.is_empty();
    robot.height_m.is_none() && robot.touches.as_ref().is_some_and(is_tip_known)
}

/// Returns touches for an adjustment whose residuals are in units of the pixels' stated sigmas.
fn touched(touches: &TouchInput, noise_factor: f64) -> RobotTouches {
    let target = TargetId::from_index(0);
    let of_points = touches.points.iter().zip(&touches.base_from_flange);
    RobotTouches {
        tip_in_carrier: touches.tip_m.map_or(TipKnowledge::Unknown, TipKnowledge::Known),
        sigma_m: touches.sigma_m / noise_factor,
        touches: of_points
            .map(|(&point, &base_from_flange)| RobotTouch { base_from_flange, target, point })
            .collect(),
    }
}

/// A frame of which both the robot and the cameras tell.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FrameTold {
    pub frame: FrameId,
    pub base_from_flange: Pose,
    pub rig_from_target: Pose,
}

fn frames_told(dataset: &Dataset, scene: &Scene) -> Vec<FrameTold> {
    let told = dataset.frames.enumerate().filter_map(|(frame, info)| {
        let has_views = dataset.views.iter().any(|view| view.frame == frame);
        let (base_from_flange, rig_from_target) = (info.base_from_flange?, scene.rig_from_target[frame]?);
        has_views.then_some(FrameTold { frame, base_from_flange, rig_from_target })
    });
    told.collect()
}

/// Returns the best of all closed forms, with the median distance in metres by which it misses the target.
fn best_start(
    pairs: &[PosePair],
    corners: &[Vector3<f64>],
    axes: RobotAxes,
) -> Option<(Method, HandEye, f64)> {
    let methods = methods_for(axes);
    let found = methods.iter().filter_map(|&method| {
        let found = closed_form(pairs, method)?;
        let mut misfits: Vec<f64> = pairs.iter().map(|pair| found.distance_m(pair, corners)).collect();
        misfits.sort_by(f64::total_cmp);
        Some((method, found, misfits[misfits.len() / 2]))
    });
    found.min_by(|one, other| one.2.total_cmp(&other.2))
}

/// Returns the closed forms for a robot.
pub(crate) fn methods_for(axes: RobotAxes) -> &'static [Method] {
    match axes {
        RobotAxes::Six => &Method::SIX_AXIS,
        RobotAxes::Four => &[Method::FourAxis],
    }
}

fn likelier(on_flange: Option<(Method, HandEye, f64)>, in_base: Option<(Method, HandEye, f64)>) -> Mounting {
    let misfit =
        |start: &Option<(Method, HandEye, f64)>| start.as_ref().map_or(f64::INFINITY, |(.., misfit)| *misfit);
    if misfit(&in_base) < misfit(&on_flange) { Mounting::RigInBase } else { Mounting::RigOnFlange }
}

/// Moves rig and target together along the base's z, so that what stands in the base has its known height.
fn at_height(
    found: HandEye,
    mounting: Mounting,
    other_from_carrier: &Pose,
    height_m: Option<f64>,
) -> HandEye {
    let lifted = |pose: Pose, by: Vector3<f64>| Pose::new(pose.rotation, pose.translation + by);
    let height_m = height_m.unwrap_or(0.0);
    // What rises in the base rises on the flange too, along the base's z as the flange has it in any pose.
    match mounting {
        Mounting::RigOnFlange => {
            let lift = Vector3::z() * (height_m - found.other_from_target.translation.z);
            HandEye {
                carrier_from_rig: lifted(
                    found.carrier_from_rig,
                    other_from_carrier.rotation.inverse() * lift,
                ),
                other_from_target: lifted(found.other_from_target, lift),
            }
        }
        Mounting::RigInBase => {
            let lift = Vector3::z() * (height_m - found.carrier_from_rig.translation.z);
            HandEye {
                carrier_from_rig: lifted(found.carrier_from_rig, lift),
                other_from_target: lifted(found.other_from_target, other_from_carrier.rotation * lift),
            }
        }
    }
}

/// Returns the points at which misfits are measured: the outermost of the first target.
pub(crate) fn corners_of(dataset: &Dataset) -> Vec<Vector3<f64>> {
    let Some(target) = dataset.targets.iter().next() else { return Vec::new() };
    let all: Vec<Vector3<f64>> = (0..target.point_count())
        .map(|i| target.drawn_point(boresight_data::PointId::from_index(i)))
        .collect();
    let mut corners = Vec::new();
    for axis in 0..3 {
        let by_axis = |a: &&Vector3<f64>, b: &&Vector3<f64>| a[axis].total_cmp(&b[axis]);
        corners.extend(all.iter().min_by(by_axis));
        corners.extend(all.iter().max_by(by_axis));
    }
    if target.geometry.grid().is_some() {
        let most = |axis: usize| all.iter().map(|point| point[axis]).fold(0.0, f64::max);
        let (x, y) = (most(0), most(1));
        corners = vec![
            Vector3::zeros(),
            Vector3::new(x, 0.0, 0.0),
            Vector3::new(0.0, y, 0.0),
            Vector3::new(x, y, 0.0),
        ];
    }
    corners
}

/// Returns the index of the method that foretells best.
fn best_of(methods: &[MethodFigures]) -> usize {
    let means = methods.iter().map(|method| method.figures.map_or(f64::INFINITY, |figures| figures.mean_m));
    means.enumerate().min_by(|one, other| one.1.total_cmp(&other.1)).map_or(0, |(i, _)| i)
}

/// Returns the dataset without the observations that a calibration rejected.
fn without_rejected(dataset: &Dataset, calibration: &Calibration) -> Dataset {
    let mut kept = dataset.clone();
    for rejection in &calibration.rejected {
        kept.views[rejection.view_idx]
            .observations
            .retain(|observation| observation.point != rejection.point);
    }
    kept
}

/// Adds what the cameras' own calibration had rejected to the final one.
fn restore_rejected(calibration: &mut Calibration, first: &Outcome, dataset: &Dataset) {
    calibration.rejected.extend(first.calibration.rejected.iter().cloned());
    for rejection in &first.calibration.rejected {
        if let RejectionReason::Outlier { .. } = rejection.reason {
            calibration.cameras[dataset.views[rejection.view_idx].camera].rejected += 1;
        }
    }
}

#[cfg(test)]
mod tests;
