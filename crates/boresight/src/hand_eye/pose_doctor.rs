//! The convention doctor for poses: all readings of a table, tried on the data. Never applied, only told.

use boresight_data::{Dataset, Finding, Mounting, PoseConvention, PoseRow, Scene, Severity};
use boresight_geometry::Pose;
use boresight_io::{Job, RobotAxes, RobotInput};
use boresight_seed::hand_eye::{Method, Reading, RowChange, readings};

use super::compare::median;
use super::{corners_of, doubts, without_rejected};
use crate::calibrate::{Watch, calibrate};
use crate::error::Error;
use crate::options::CalibrateOptions;

/// How many times better another reading must fit to be told as a finding.
const BETTER_READING: f64 = 3.0;

/// The share of the target's distance by which the best reading may miss it and still be told as the right one.
const BEST_SHARE: f64 = 0.05;

/// An error below this is rounding, in metres, and no reading is better than another by it.
const EXACT_M: f64 = 1e-9;

/// The readings of a table of poses.
#[derive(Clone, Debug)]
pub struct PoseReadings {
    /// All readings, the best first.
    pub readings: Vec<Reading>,
    /// The place of the stated one among them; `None` if the rows are no poses in the stated convention or the
    /// mount is not stated.
    pub stated: Option<usize>,
    /// What the readings amount to, where another than the stated one fits far better.
    pub finding: Option<Finding>,
    /// The names of the frames, which changes of tools refer to.
    pub frames: Vec<String>,
    /// The median distance of the target, in metres.
    pub distance_m: f64,
}

/// Calibrates the cameras of a job and tries all readings of its robot's poses.
pub fn read_poses(job: &Job, options: &CalibrateOptions) -> Result<PoseReadings, Error> {
    let robot = job.robot.as_ref().ok_or(Error::NoRobotPoses)?;
    if !robot.frame_times_s.is_empty() {
        return Err(Error::MovingRobot);
    }
    let first = calibrate(job, options, &Watch::default())?;
    let robot = robot.for_frames(&job.dataset, &first.dataset);
    let dataset = without_rejected(&first.dataset, &first.calibration);
    let mut read = pose_readings(&robot, &dataset, &first.calibration.scene);
    if let (None, Some(best)) = (&read.finding, read.readings.first()) {
        let what = "the best reading misses frames left out";
        read.finding = doubts::misfit(best.held_out_m, read.distance_m, BEST_SHARE, what);
    }
    Ok(read)
}

/// Tries all readings on calibrated cameras.
pub(super) fn pose_readings(robot: &RobotInput, dataset: &Dataset, scene: &Scene) -> PoseReadings {
    let mut rows: Vec<&PoseRow> = Vec::new();
    let mut seen: Vec<Pose> = Vec::new();
    let mut frames = Vec::new();
    for (id, frame) in dataset.frames.enumerate() {
        let row = robot.row_of_frame.get(boresight_data::Id::index(id)).copied().flatten();
        let has_views = dataset.views.iter().any(|view| view.frame == id);
        if let (Some(row), Some(pose), true) = (row, scene.rig_from_target[id], has_views) {
            rows.push(&robot.rows[row]);
            seen.push(pose);
            frames.push(frame.name.clone());
        }
    }
    let method = match robot.axes {
        RobotAxes::Six => Method::Park,
        RobotAxes::Four => Method::FourAxis,
    };
    let readings = readings(&rows, &seen, &corners_of(dataset), method);
    let stated = robot.mounting.and_then(|mounting| {
        let stated =
            Reading { convention: robot.convention, mounting, change: RowChange::None, held_out_m: 0.0 };
        readings.iter().position(|reading| reading.is_alike(&stated) && is_named_alike(reading, &stated))
    });
    let distances: Vec<f64> = seen.iter().map(|pose| pose.translation.norm()).collect();
    let distance_m = median(&distances);
    let finding = finding(robot, &readings, stated, &frames);
    // What misses the target itself is no better reading. Changes of rows are only sought where they are far better.
    let is_good =
        |best: &Reading| best.change != RowChange::None || best.held_out_m < BEST_SHARE * distance_m;
    let finding = finding.filter(|_| readings.first().is_some_and(is_good));
    PoseReadings { readings, stated, finding, frames, distance_m }
}

/// Tells whether two alike readings are so without turning one into its twin.
fn is_named_alike(one: &Reading, other: &Reading) -> bool {
    one.mounting == other.mounting || one.twin().mounting == other.mounting
}

fn finding(
    robot: &RobotInput,
    readings: &[Reading],
    stated: Option<usize>,
    frames: &[String],
) -> Option<Finding> {
    let best = readings.first()?;
    let of_stated = match (stated, robot.mounting) {
        (Some(stated), _) => readings[stated].held_out_m,
        (None, Some(_)) => f64::INFINITY,
        // No mount was stated: the convention is what counts.
        (None, None) => {
            let alike = readings
                .iter()
                .find(|reading| reading.change == RowChange::None && reading.convention == robot.convention);
            alike.map_or(f64::INFINITY, |reading| reading.held_out_m)
        }
    };
    let ratio = of_stated.max(EXACT_M) / best.held_out_m.max(EXACT_M);
    if ratio < BETTER_READING {
        return None;
    }
    let times =
        if ratio.is_finite() { format!("{ratio:.0} times better") } else { "where these do not".to_owned() };
    Some(Finding {
        code: "robot-poses-read".to_owned(),
        severity: Severity::Fail,
        place: "robot".to_owned(),
        message: format!("the poses fit {times} read as {}", describe(best, frames)),
        measured: ratio.is_finite().then_some(ratio),
        limit: Some(BETTER_READING),
        fix: format!(
            "Check this against the robot's manual, then state it: --poses-as {} --mount {}.{}",
            best.convention,
            mount(best.mounting),
            of_header(&best.convention, &robot.convention)
        ),
    })
}

/// Says that the names of columns count, where a reading differs from the stated one in what these may say.
fn of_header(best: &PoseConvention, stated: &PoseConvention) -> &'static str {
    let has_angles = best.rotation.has_angles();
    let is_as_named = best.length == stated.length
        && (!has_angles || best.angle == stated.angle)
        && (has_angles || best.rotation == stated.rotation);
    match is_as_named {
        true => "",
        false => {
            " Where the table has a header, its names count before that: mend those that say otherwise, such as x_m for x_mm."
        }
    }
}

/// Returns the word for a mount.
pub fn mount(mounting: Mounting) -> &'static str {
    match mounting {
        Mounting::RigOnFlange => "on-flange",
        Mounting::RigInBase => "fixed",
    }
}

/// Says a reading in words, such as `moving-zyx:deg:mm (kuka-abc), cameras on-flange`.
pub fn describe(reading: &Reading, frames: &[String]) -> String {
    let makers = reading.convention.makers();
    let makers = if makers.is_empty() { String::new() } else { format!(" ({})", makers.join(", ")) };
    let change = match reading.change {
        RowChange::None => String::new(),
        RowChange::Shifted(by) if by > 0 => ", each row for the next frame".to_owned(),
        RowChange::Shifted(_) => ", each row for the frame before".to_owned(),
        RowChange::ToolFrom(frame) => {
            format!(", with another tool from frame {} on", frames.get(frame).map_or("?", String::as_str))
        }
    };
    format!("{}{makers}, cameras {}{change}", reading.convention, mount(reading.mounting))
}
