//! Hand-eye calibration where poses of the target are given in place of pixels, row by row or over time.
//!
//! Two streams by two clocks are laid on each other first, by how fast they turn. Closed forms on spread-out
//! rows give the start. Rig, target and the clocks' offset are then fitted together, with noise of the sights
//! that is estimated from what is left over; blocks of rows that are left out tell how good all of it is.

use std::sync::Arc;

use boresight_adjust::{Arm, HandEyeModel, PoseFit, PoseModel as _, PoseNoise};
use boresight_data::{Finding, Mounting, Severity};
use boresight_geometry::{Pose, PoseStream, Vector3, Vector6};
use boresight_io::{RobotAxes, TimedPose};
use boresight_seed::hand_eye::{HandEye, Method, PosePair, hand_eye as closed_form, pose_pair};
use boresight_seed::{ClockOffset, clock_offset};
use serde::Serialize;

use super::compare::{mean, median};
use super::{check_motions, doubts};
use crate::error::Error;

/// Rig and target on a robot, from poses.
#[derive(Clone, Debug)]
pub struct PoseHandEye {
    /// Which of rig and target moves.
    pub mounting: Mounting,
    /// The rig on its carrier.
    pub carrier_from_rig: Pose,
    /// The target on the other of flange and base.
    pub other_from_target: Pose,
    /// The sigmas of both, `[rx, ry, rz, tx, ty, tz]` of left perturbations, by the scatter over blocks left out.
    pub sigmas: [[f64; 6]; 2],
    /// How far the clocks are apart, where both sides have times.
    pub clock: Option<ClockPair>,
    /// The noise of the sights.
    pub noise: PoseNoise,
    /// How many sights there are, how many of them the robot tells of, and how many of these are far off.
    pub sights: [usize; 3],
    /// How sights are foretold whose block is left out, by the fit and by closed forms on the same rows.
    pub methods: Vec<(String, Option<PoseFigures>)>,
    /// The number of blocks.
    pub blocks: usize,
    /// Whether the search ended because nothing changed any more.
    pub is_converged: bool,
    /// What is doubtful.
    pub findings: Vec<Finding>,
}

/// How far the clocks of robot and camera are apart.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ClockPair {
    /// What the robot's clock shows when the camera's shows zero, in seconds.
    pub offset_s: f64,
    /// Its sigma.
    pub sigma_s: f64,
    /// The correlation of the angular speeds.
    pub correlation: f64,
}

/// Distances and angles between poses that were foretold and seen.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PoseFigures {
    /// The mean, the median, the 95th percentile and the largest distance in metres.
    pub distance_m: [f64; 4],
    /// The same of angles in radians.
    pub angle_rad: [f64; 4],
}

impl PoseFigures {
    /// Returns the figures of residuals, rotation first; `None` of none.
    pub(super) fn of<'a>(residuals: impl IntoIterator<Item = &'a Vector6<f64>>) -> Option<Self> {
        let (mut distances, mut angles): (Vec<f64>, Vec<f64>) = residuals
            .into_iter()
            .map(|residual| (residual.fixed_rows::<3>(3).norm(), residual.fixed_rows::<3>(0).norm()))
            .unzip();
        let figures = |values: &mut Vec<f64>| -> Option<[f64; 4]> {
            values.sort_by(f64::total_cmp);
            let n = values.len();
            let most = *values.last()?;
            Some([mean(values), median(values), values[(n * 95 / 100).min(n - 1)], most])
        };
        Some(Self { distance_m: figures(&mut distances)?, angle_rad: figures(&mut angles)? })
    }
}

/// A sight more than so many sigmas off is far off: one in ten thousand of normal ones is.
pub(super) const FAR_SIGMAS: f64 = 5.3;
/// The share of sights far off beyond which it is told.
const MANY_FAR: f64 = 0.01;
/// Blocks that are left out, where rows follow each other in time.
const BLOCKS: usize = 20;
/// The correlation of angular speeds below which clocks are not matched, and how near the next may come.
const LEAST_CORRELATION: f64 = 0.5;
const NEXT_CORRELATION: f64 = 0.95;
/// Sigmas by which the offset may differ between the halves of a recording.
const STEADY_SIGMAS: f64 = 5.0;
/// The most rows of a closed form, and how many choices of rows are tried.
const CLOSED_FORM_ROWS: usize = 48;
const CLOSED_FORM_CHOICES: usize = 12;

/// Calibrates rig and target from a robot's poses and from sights of the target.
///
/// Where every row of both has a time, the robot's poses are taken between their samples, by a clock of their
/// own; else there must be as many poses as sights.
pub fn hand_eye_of_poses(
    robot: &[TimedPose],
    sights: &[TimedPose],
    stated: Option<Mounting>,
) -> Result<PoseHandEye, Error> {
    let mut findings = Vec::new();
    let (arm, matched) = arm_of(robot, sights)?;
    if let Some(matched) = &matched {
        findings.extend(of_match(matched));
    }
    let offset_s = matched.map_or(0.0, |matched| matched.offset_s);
    let seen: Vec<Pose> = sights.iter().map(|sight| sight.fixed_from_moving).collect();
    let told = told(&arm, offset_s);
    let poses: Vec<Pose> = spread(&told.iter().flatten().copied().collect::<Vec<_>>(), 200);
    findings.extend(check_motions(&poses, RobotAxes::Six)?);
    let start = |mounting| start(mounting, &told, &seen);
    let (on_flange, in_base) = (start(Mounting::RigOnFlange), start(Mounting::RigInBase));
    let misfit = |start: &Option<(HandEye, f64)>| start.as_ref().map(|(_, misfit_m)| *misfit_m);
    let likelier = if misfit(&in_base).unwrap_or(f64::INFINITY) < misfit(&on_flange).unwrap_or(f64::INFINITY)
    {
        Mounting::RigInBase
    } else {
        Mounting::RigOnFlange
    };
    let mounting = stated.unwrap_or(likelier);
    let (own, other) = match mounting {
        Mounting::RigOnFlange => (on_flange, misfit(&in_base)),
        Mounting::RigInBase => (in_base, misfit(&on_flange)),
    };
    let (hand_eye, misfit_m) = own.ok_or(Error::NoClosedForm { poses: poses.len() })?;
    findings.extend(doubts::of_mounting(mounting, misfit_m, other));

    let model = HandEyeModel {
        arm: Arc::new(arm),
        mounting,
        carrier_from_rig: hand_eye.carrier_from_rig,
        other_from_target: hand_eye.other_from_target,
        offset_s,
    };
    let blocks = blocks(&model);
    let fit = model.fitted(&seen, &blocks)?;
    let clock = matched.map(|matched| ClockPair {
        offset_s: fit.model.offset_s,
        sigma_s: fit.covariance[(12, 12)].sqrt(),
        correlation: matched.correlation,
    });
    let used = fit.residuals.iter().flatten().count();
    let far = fit.sigmas.iter().flatten().filter(|sigmas| **sigmas > FAR_SIGMAS).count();
    findings.extend(of_far(far, used));
    if let Some(clock) = &clock {
        findings.extend(of_clock(clock, &fit, &seen));
    }
    findings.sort_by_key(|finding: &Finding| std::cmp::Reverse(finding.severity));
    let mut methods = closed_forms(&fit, &seen, &blocks);
    methods.push(("fitted".to_owned(), PoseFigures::of(fit.held_out.iter().flatten())));
    let sigma = |first: usize| std::array::from_fn(|i| fit.covariance[(first + i, first + i)].sqrt());
    Ok(PoseHandEye {
        mounting,
        carrier_from_rig: fit.model.carrier_from_rig,
        other_from_target: fit.model.other_from_target,
        sigmas: [sigma(0), sigma(6)],
        clock,
        noise: fit.noise,
        sights: [sights.len(), used, far],
        methods,
        blocks: fit.blocks,
        is_converged: fit.is_converged,
        findings,
    })
}

/// Returns what the robot said of each row, and how clocks were matched where there are times.
fn arm_of(robot: &[TimedPose], sights: &[TimedPose]) -> Result<(Arm, Option<ClockOffset>), Error> {
    let stream = |rows: &[TimedPose]| -> Option<PoseStream> {
        let samples: Option<Vec<(f64, Pose)>> =
            rows.iter().map(|row| row.time_s.map(|time_s| (time_s, row.fixed_from_moving))).collect();
        Some(PoseStream::new(samples?))
    };
    match (stream(robot), stream(sights)) {
        (Some(base_from_flange), Some(rig_from_target)) => {
            let matched = clock_offset(&base_from_flange, &rig_from_target);
            let matched = matched.ok_or_else(|| Error::Degenerate(Box::new(too_short(robot, sights))))?;
            let times_s = sights.iter().filter_map(|sight| sight.time_s).collect();
            Ok((Arm::Stream { base_from_flange, times_s }, Some(matched)))
        }
        _ if robot.len() == sights.len() => {
            Ok((Arm::Rows(robot.iter().map(|row| row.fixed_from_moving).collect()), None))
        }
        _ => Err(Error::Unpaired { poses: robot.len(), sights: sights.len() }),
    }
}

/// Returns what the robot said of each row by the offset that was matched.
fn told(arm: &Arm, offset_s: f64) -> Vec<Option<Pose>> {
    match arm {
        Arm::Rows(poses) => poses.iter().copied().map(Some).collect(),
        Arm::Stream { base_from_flange, times_s } => {
            times_s.iter().map(|time_s| base_from_flange.at(time_s + offset_s)).collect()
        }
    }
}

/// Returns at most `most` of the items, evenly spread.
fn spread<T: Copy>(items: &[T], most: usize) -> Vec<T> {
    let step = items.len().div_ceil(most.max(1)).max(1);
    items.iter().copied().step_by(step).collect()
}

/// Returns for each of so many rows the block it is left out with: itself of few rows, else a twentieth.
pub(super) fn blocks_of_rows(count: usize) -> Vec<usize> {
    let blocks = if count <= 5 * BLOCKS { count } else { BLOCKS };
    (0..count).map(|row| row * blocks / count).collect()
}

/// Returns the same, of streams by the time of the rows that the robot tells of.
fn blocks(model: &HandEyeModel) -> Vec<usize> {
    match &*model.arm {
        Arm::Rows(poses) => blocks_of_rows(poses.len()),
        Arm::Stream { times_s, .. } => {
            let told = |row: &usize| model.pose(*row).is_some();
            let of_told = (0..times_s.len()).filter(told).map(|row| times_s[row]);
            let first = of_told.clone().fold(f64::INFINITY, f64::min);
            let last = of_told.fold(f64::NEG_INFINITY, f64::max);
            let block = |time_s: &f64| {
                let share = (time_s - first) / (last - first).max(f64::MIN_POSITIVE);
                ((share * BLOCKS as f64) as usize).min(BLOCKS - 1)
            };
            times_s.iter().map(block).collect()
        }
    }
}

/// Returns the closed form that misses the usual sight least, with its median misfit in metres: of several
/// methods and choices of rows, so that sights of another target do not matter.
fn start(mounting: Mounting, told: &[Option<Pose>], seen: &[Pose]) -> Option<(HandEye, f64)> {
    let pairs: Vec<PosePair> = told
        .iter()
        .zip(seen)
        .filter_map(|(told, seen)| told.map(|told| pose_pair(mounting, &told, seen)))
        .collect();
    let points = points_at(&pairs);
    let tested = spread(&pairs, 400);
    let stride = pairs.len().div_ceil(CLOSED_FORM_ROWS).max(1);
    let choices = stride.min(CLOSED_FORM_CHOICES);
    let mut best: Option<(HandEye, f64)> = None;
    for choice in 0..choices {
        let chosen: Vec<PosePair> =
            pairs.iter().copied().skip(choice * stride / choices).step_by(stride).collect();
        for method in Method::SIX_AXIS {
            let Some(found) = closed_form(&chosen, method) else { continue };
            let misfits: Vec<f64> = tested.iter().map(|pair| found.distance_m(pair, &points)).collect();
            let misfit_m = median(&misfits);
            if best.as_ref().is_none_or(|(_, least)| misfit_m < *least) {
                best = Some((found, misfit_m));
            }
        }
    }
    best
}

/// Returns points about the target at which misfits are measured: a tenth of its distance from its origin.
fn points_at(pairs: &[PosePair]) -> Vec<Vector3<f64>> {
    let distances: Vec<f64> = pairs.iter().map(|pair| pair.rig_from_target.translation.norm()).collect();
    let reach = 0.1 * median(&distances);
    vec![Vector3::zeros(), Vector3::x() * reach, Vector3::y() * reach, Vector3::z() * reach]
}

/// Returns how closed forms foretell blocks that were left out, with the offset of the clocks that was fitted and
/// without the rows that the fit finds far off.
fn closed_forms(
    fit: &PoseFit<HandEyeModel>,
    seen: &[Pose],
    blocks: &[usize],
) -> Vec<(String, Option<PoseFigures>)> {
    let model = &fit.model;
    let told = told(&model.arm, model.offset_s);
    let rows: Vec<(usize, usize, PosePair)> = (0..seen.len())
        .filter_map(|row| Some((row, blocks[row], pose_pair(model.mounting, &told[row]?, &seen[row]))))
        .collect();
    let last = rows.iter().map(|(_, block, _)| *block).max().unwrap_or(0);
    let figures = |method: Method| {
        let mut residuals = Vec::new();
        for block in 0..=last {
            let others: Vec<PosePair> = rows
                .iter()
                .filter(|(row, of, _)| *of != block && fit.sigmas[*row].is_some_and(|s| s <= FAR_SIGMAS))
                .map(|(.., pair)| *pair)
                .collect();
            let found = closed_form(&spread(&others, CLOSED_FORM_ROWS), method)?;
            for (.., pair) in rows.iter().filter(|(_, of, _)| *of == block) {
                let predicted = found.rig_from_target(&pair.other_from_carrier);
                let turn = predicted.rotation * pair.rig_from_target.rotation.inverse();
                let off = predicted.translation - pair.rig_from_target.translation;
                residuals.push(Vector6::from_iterator(turn.scaled_axis().iter().chain(off.iter()).copied()));
            }
        }
        PoseFigures::of(&residuals)
    };
    Method::SIX_AXIS.iter().map(|&method| (method.name().to_owned(), figures(method))).collect()
}

fn finding(code: &str, severity: Severity, message: String, measured: f64, limit: f64, fix: &str) -> Finding {
    Finding {
        code: code.to_owned(),
        severity,
        place: "robot".to_owned(),
        message,
        measured: Some(measured),
        limit: Some(limit),
        fix: fix.to_owned(),
    }
}

fn too_short(robot: &[TimedPose], sights: &[TimedPose]) -> Finding {
    let span_s = |rows: &[TimedPose]| {
        let times = || rows.iter().filter_map(|row| row.time_s);
        let (first, last) =
            (times().fold(f64::INFINITY, f64::min), times().fold(f64::NEG_INFINITY, f64::max));
        (last - first).max(0.0)
    };
    let (robot_s, sights_s) = (span_s(robot), span_s(sights));
    let message = format!(
        "{} poses over {robot_s:.2} s and {} sights over {sights_s:.2} s are too few, or overlap too little, to tell how \
         far the clocks are apart",
        robot.len(),
        sights.len()
    );
    let fix = "Record both for 20 s or more while the robot turns about changing axes, with times in seconds, or leave the \
               times out and pair rows.";
    finding("clock-offset-unclear", Severity::Fail, message, sights.len() as f64, 32.0, fix)
}

/// Tells that angular speeds do not match well, or match elsewhere as well.
fn of_match(matched: &ClockOffset) -> Option<Finding> {
    let fix = "Let the robot turn faster, with stops and about changing axes; check that both files are of one recording.";
    let ClockOffset { correlation, next_correlation, offset_s } = *matched;
    if correlation < LEAST_CORRELATION {
        let message = format!(
            "the angular speeds of robot and sights agree to {correlation:.2} at best, at {offset_s:.3} s"
        );
        return Some(finding(
            "clock-offset-unclear",
            Severity::Fail,
            message,
            correlation,
            LEAST_CORRELATION,
            fix,
        ));
    }
    (next_correlation > NEXT_CORRELATION * correlation).then(|| {
        let message = format!(
            "the angular speeds agree to {correlation:.3} at an offset of {offset_s:.3} s, and to {next_correlation:.3} elsewhere"
        );
        let limit = NEXT_CORRELATION * correlation;
        finding("clock-offset-unclear", Severity::Caution, message, next_correlation, limit, fix)
    })
}

/// Tells how far the clocks are apart, and whether they stay so.
fn of_clock(clock: &ClockPair, fit: &PoseFit<HandEyeModel>, seen: &[Pose]) -> Vec<Finding> {
    let mut findings = Vec::new();
    if clock.offset_s.abs() > STEADY_SIGMAS * clock.sigma_s {
        let message = format!(
            "the robot's clock shows {:.4} s when the camera's shows zero; the result holds for poses taken so",
            clock.offset_s
        );
        findings.push(finding(
            "clock-offset",
            Severity::Note,
            message,
            clock.offset_s.abs(),
            STEADY_SIGMAS * clock.sigma_s,
            "Add it to the camera's times wherever both are used together.",
        ));
    }
    let Arm::Stream { base_from_flange, times_s } = &*fit.model.arm else { return findings };
    let rows: Vec<usize> = (0..seen.len()).filter(|&row| fit.model.pose(row).is_some()).collect();
    let (early, late) = rows.split_at(rows.len() / 2);
    let [early, late] = [early, late].map(|half| {
        let arm = Arm::Stream {
            base_from_flange: base_from_flange.clone(),
            times_s: half.iter().map(|&row| times_s[row]).collect(),
        };
        let poses: Vec<Pose> = half.iter().map(|&row| seen[row]).collect();
        let blocks: Vec<usize> = (0..half.len()).map(|row| row * BLOCKS / 2 / half.len()).collect();
        let half = HandEyeModel { arm: Arc::new(arm), ..fit.model.clone() }.fitted(&poses, &blocks).ok()?;
        Some((half.model.offset_s, half.covariance[(12, 12)]))
    });
    if let (Some((early_s, early_variance)), Some((late_s, late_variance))) = (early, late) {
        let (apart, sigma) = ((late_s - early_s).abs(), (early_variance + late_variance).sqrt());
        if apart > STEADY_SIGMAS * sigma {
            let message = format!(
                "the clocks are {early_s:.4} s apart in the first half and {late_s:.4} s in the second"
            );
            findings.push(finding(
                "clock-not-steady",
                Severity::Caution,
                message,
                apart,
                STEADY_SIGMAS * sigma,
                "Use one clock for both, or shorter recordings; times should be those of exposure, not of arrival.",
            ));
        }
    }
    findings
}

/// Tells that many sights are far off.
pub(super) fn of_far(far: usize, used: usize) -> Option<Finding> {
    let share = far as f64 / used.max(1) as f64;
    (share > MANY_FAR).then(|| {
        let message = format!("{far} of {used} sights are more than {FAR_SIGMAS} sigmas off and count for little");
        finding(
            "sights-far-off",
            Severity::Caution,
            message,
            share,
            MANY_FAR,
            "Look for frames in which another target, or the mirrored pose of the same, was taken, and for times that jump.",
        )
    })
}
