//! Hand-eye and positioners from poses, on synthetic and recorded robots.

use std::path::Path;

use boresight_data::Mounting;
use boresight_geometry::{Pose, Vector3};
use boresight_io::{RobotOverrides, RobotRows, SightsJob, TimedPose, read_sights_job};

use super::*;
use crate::error::Error;

fn pose(a: [f64; 3], b: [f64; 3]) -> Pose {
    Pose::from_rodrigues(a.into(), b.into())
}

/// A robot that waves about all axes, never twice alike.
fn flange(time_s: f64) -> Pose {
    let (a, b, c) =
        ((1.3 * time_s).sin(), (0.9 * time_s + 0.02 * time_s * time_s).sin(), (0.7 * time_s).cos());
    pose([0.5 * a, 2.6 + 0.5 * b, 0.4 * c], [0.5 + 0.2 * c, 0.2 * a, 0.6 + 0.2 * b])
}

/// Numbers in [-1, 1) of no pattern, by the golden ratio.
fn noise(i: usize) -> f64 {
    2.0 * (0.5 + i as f64 * 0.618_033_988_749_895).fract() - 1.0
}

fn sight(pose: &Pose, row: usize, size: f64) -> Pose {
    let at = |k: usize| size * noise(7 * row + 131 * k + row * row % 17);
    let turn = Pose::from_rodrigues(Vector3::new(at(0), at(1), at(2)), Vector3::zeros());
    Pose::new(turn.rotation * pose.rotation, pose.translation + Vector3::new(at(3), at(4), at(5)))
}

const RIG: ([f64; 3], [f64; 3]) = ([0.1, -0.2, 1.5], [0.05, -0.03, 0.1]);
const TARGET: ([f64; 3], [f64; 3]) = ([3.0, 0.2, 0.1], [0.7, 0.1, 0.02]);

/// Sights at 30 Hz by a clock that shows `late_s` more than the robot's, and robot's poses at 100 Hz.
fn recording(mounting: Mounting, late_s: f64) -> (Vec<TimedPose>, Vec<TimedPose>) {
    let (rig, target) = (pose(RIG.0, RIG.1), pose(TARGET.0, TARGET.1));
    let robot = (0..4000).map(|i| 0.01 * f64::from(i));
    let robot = robot.map(|t| TimedPose { time_s: Some(t), fixed_from_moving: flange(t) }).collect();
    let seen = (0..900usize).map(|i| 4.0 + i as f64 / 30.0).enumerate().map(|(row, t)| {
        let carrier_from_other = match mounting {
            Mounting::RigOnFlange => flange(t).inverse(),
            Mounting::RigInBase => flange(t),
        };
        let exact = rig.inverse() * carrier_from_other * target;
        // One in fifty is the pose of something else.
        let wrong = if row % 50 == 7 { pose([0.3, 0.0, 0.0], [0.0, 0.1, 0.0]) } else { Pose::identity() };
        TimedPose { time_s: Some(t + late_s), fixed_from_moving: sight(&(wrong * exact), row, 1e-3) }
    });
    (robot, seen.collect())
}

#[test]
fn rows_without_times_are_paired_by_order() {
    let (_, seen) = recording(Mounting::RigOnFlange, 0.0);
    let robot: Vec<TimedPose> = seen
        .iter()
        .map(|row| TimedPose { time_s: None, fixed_from_moving: flange(row.time_s.unwrap()) })
        .collect();
    let found = hand_eye_of_poses(&robot[..60], &seen[..60], Some(Mounting::RigOnFlange)).unwrap();
    assert!(found.clock.is_none() && found.blocks == 60, "{found:?}");
    let error = (found.carrier_from_rig * pose(RIG.0, RIG.1).inverse()).log();
    assert!(error.norm() < 3e-3, "{error}");
    let unpaired = hand_eye_of_poses(&robot[..50], &seen[..60], None);
    assert!(matches!(unpaired, Err(Error::Unpaired { poses: 50, sights: 60 })));
}

#[test]
fn streams_that_tell_too_little_are_refused() {
    let (robot, seen) = recording(Mounting::RigOnFlange, 0.0);
    let about_z = |t: f64| pose([0.0, 0.0, 0.5 * (1.3 * t).sin() + 0.1 * t], [0.5, 0.1 * t, 0.3]);
    let time = |row: &TimedPose| row.time_s.unwrap();
    let one_axis: Vec<TimedPose> =
        robot.iter().map(|row| TimedPose { fixed_from_moving: about_z(time(row)), ..*row }).collect();
    let (rig, target) = (pose(RIG.0, RIG.1), pose(TARGET.0, TARGET.1));
    let seen_of_it: Vec<TimedPose> = seen
        .iter()
        .map(|row| TimedPose { fixed_from_moving: (about_z(time(row)) * rig).inverse() * target, ..*row })
        .collect();
    let refused = hand_eye_of_poses(&one_axis, &seen_of_it, None);
    assert!(
        matches!(&refused, Err(Error::Degenerate(finding)) if finding.code == "robot-one-axis"),
        "{refused:?}"
    );
    let short = hand_eye_of_poses(&robot[..20], &seen[..5], None);
    assert!(
        matches!(&short, Err(Error::Degenerate(finding)) if finding.code == "clock-offset-unclear"),
        "{short:?}"
    );
}

/// Returns a recorded job, or `None` where it is not there.
fn recorded(name: &str) -> Option<SightsJob> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/recorded");
    let job = read_sights_job(&root.join(name), &RobotOverrides::default());
    if job.is_err() {
        println!("{name} is not there");
    }
    job.ok().flatten()
}

#[test]
fn the_recorded_positioner_is_solved() {
    let Some(job) = recorded("joints-positioner") else { return };
    let RobotRows::Joints(readings) = &job.robot else { panic!("{:?}", job.robot) };
    let found = joint_chain(readings, &job.sights).unwrap();
    let left_out = found.left_out.unwrap();
    println!("{:?} {:?} {left_out:?} {:?}", found.links, found.noise, found.findings);
    // The limits of the recording's own test, on the residuals of its fit; here of sights left out. Its nominal
    // axes meet at a right angle.
    assert!(left_out.distance_m[0] < 2e-3 && left_out.angle_rad[0] < 0.2f64.to_radians(), "{left_out:?}");
    assert!((found.links[0].angle_rad[0].to_degrees() - 90.0).abs() < 0.5, "{:?}", found.links);
    assert!(found.links[0].distance_m[0] < 5e-3, "{:?}", found.links);
}
