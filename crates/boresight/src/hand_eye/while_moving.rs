//! Frames taken while the robot moved: its poses at their times, by the clocks' offset.

use boresight_data::{Dataset, Finding, Id as _, Scene};
use boresight_geometry::PoseStream;
use boresight_io::{RobotInput, TimedPose};

use super::sighted_poses::{ClockPair, hand_eye_of_poses};
use crate::error::Error;

/// What a robot that moved adds.
#[derive(Clone, Debug)]
pub(super) struct Moving {
    /// The robot, with the row nearest in time for each frame.
    pub robot: RobotInput,
    /// How far the clocks are apart.
    pub clock: ClockPair,
    /// What is doubtful about the clocks.
    pub findings: Vec<Finding>,
}

/// Finds the offset of the clocks from where the target was seen, and gives each frame the robot's pose at its
/// time. `None` for a robot that stood.
///
/// A frame outside the robot's recording, or in a gap of it, gets no pose.
pub(super) fn place_frames(
    robot: &RobotInput,
    dataset: &mut Dataset,
    scene: &Scene,
) -> Result<Option<Moving>, Error> {
    if robot.frame_times_s.is_empty() {
        return Ok(None);
    }
    let read = |row: &boresight_data::PoseRow| {
        Some(TimedPose { time_s: row.time_s, fixed_from_moving: robot.convention.base_from_flange(row)? })
    };
    let rows: Option<Vec<TimedPose>> = robot.rows.iter().map(read).collect();
    let rows = rows.ok_or(Error::UnreadablePoses { convention: robot.convention, finding: None })?;
    let sights: Vec<TimedPose> = dataset
        .frames
        .ids()
        .filter_map(|frame| {
            let time_s = robot.frame_times_s[frame.index()]?;
            Some(TimedPose { time_s: Some(time_s), fixed_from_moving: scene.rig_from_target[frame]? })
        })
        .collect();
    let found = hand_eye_of_poses(&rows, &sights, robot.mounting)?;
    let clock = found.clock.ok_or(Error::NoClosedForm { poses: rows.len() })?;
    let stream = PoseStream::new(rows.iter().filter_map(|row| Some((row.time_s?, row.fixed_from_moving))));
    let mut tied = robot.clone();
    let apart = |row: usize, time_s: f64| rows[row].time_s.map_or(f64::INFINITY, |at| (at - time_s).abs());
    for (id, frame) in dataset.frames.iter_mut().enumerate() {
        let time_s = robot.frame_times_s[id].map(|time_s| time_s + clock.offset_s);
        frame.base_from_flange = time_s.and_then(|time_s| stream.at(time_s));
        // What is read of rows, such as their convention, is read of the nearest.
        tied.row_of_frame[id] = time_s.filter(|_| frame.base_from_flange.is_some()).and_then(|time_s| {
            (0..rows.len()).min_by(|one, other| apart(*one, time_s).total_cmp(&apart(*other, time_s)))
        });
    }
    let of_clock = |finding: &Finding| finding.code.starts_with("clock");
    let findings = found.findings.into_iter().filter(of_clock).collect();
    Ok(Some(Moving { robot: tied, clock, findings }))
}
