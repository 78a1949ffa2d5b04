//! A positioner's kinematics: the lines about which its joints turn, from sights of a target on it.

use std::sync::Arc;

use boresight_adjust::{JointModel, PoseFit, PoseModel as _, PoseNoise};
use boresight_data::{Finding, Severity};
use boresight_geometry::nalgebra::{DMatrix, DVector};
use boresight_geometry::{Pose, Vector3};
use boresight_io::TimedPose;
use boresight_seed::joint_lines;
use serde::Serialize;

use super::sighted_poses::{FAR_SIGMAS, PoseFigures, blocks_of_rows, of_far};
use crate::error::Error;

/// A chain of turning joints with a target at its end, seen by a camera that stands.
#[derive(Clone, Debug)]
pub struct JointChain {
    /// The joints, the one nearest to the camera first, where all of them read zero.
    pub joints: Vec<Joint>,
    /// Where the target is then, `rig_from_target`.
    pub rig_from_target: Pose,
    /// The sigmas of its left perturbation, `[rx, ry, rz, tx, ty, tz]`.
    pub target_sigmas: [f64; 6],
    /// How each joint's line lies to the next one's.
    pub links: Vec<JointLink>,
    /// The noise of the sights.
    pub noise: PoseNoise,
    /// How many sights there are, and how many of them are far off.
    pub sights: [usize; 2],
    /// How sights are met by the fit to all, and foretold by the fit to all others.
    pub fitted: Option<PoseFigures>,
    /// See `fitted`.
    pub left_out: Option<PoseFigures>,
    /// Whether the search ended because nothing changed any more.
    pub is_converged: bool,
    /// What is doubtful.
    pub findings: Vec<Finding>,
}

/// The line about which a joint turns, where all joints read zero.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Joint {
    /// Its direction in the rig's frame: the joint turns by the right hand about it.
    pub direction: [f64; 3],
    /// The sigma of the direction along its worst tilt, in radians.
    pub direction_sigma_rad: f64,
    /// The point on it that is nearest to the rig's origin, in metres.
    pub point_m: [f64; 3],
    /// The sigma of this point along its worst direction, in metres.
    pub point_sigma_m: f64,
}

/// How the lines of two joints lie to each other, which the joints before them do not change.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct JointLink {
    /// The angle between them in radians, with its sigma.
    pub angle_rad: [f64; 2],
    /// Their distance in metres, with its sigma.
    pub distance_m: [f64; 2],
}

/// A joint may turn by this share more or less than its reading says before it is told.
const UNIT_LIMIT: f64 = 0.2;

/// Finds the joints of a positioner from readings in radians and sights, row by row.
pub fn joint_chain(readings_rad: &[Vec<f64>], sights: &[TimedPose]) -> Result<JointChain, Error> {
    if readings_rad.len() != sights.len() {
        return Err(Error::UnpairedJoints { readings: readings_rad.len(), sights: sights.len() });
    }
    let seen: Vec<Pose> = sights.iter().map(|sight| sight.fixed_from_moving).collect();
    let start = joint_lines(readings_rad, &seen)?;
    if let Some(finding) = of_unit(&start.radians_per_unit) {
        return Err(Error::Degenerate(Box::new(finding)));
    }
    let reference = &readings_rad[start.reference];
    let relative = |row: &Vec<f64>| row.iter().zip(reference).map(|(angle, zero)| angle - zero).collect();
    let model = JointModel {
        angles_rad: Arc::new(readings_rad.iter().map(relative).collect()),
        rig_from_joint: start.rig_from_joint,
        rig_from_target: seen[start.reference],
    };
    let fit = model.fitted(&seen, &blocks_of_rows(seen.len()))?;
    let far = fit.sigmas.iter().flatten().filter(|sigmas| **sigmas > FAR_SIGMAS).count();
    let mut findings: Vec<Finding> = of_far(far, seen.len()).into_iter().collect();
    findings.sort_by_key(|finding| std::cmp::Reverse(finding.severity));
    let zero = at_zero(&fit.model, reference);
    let n = zero.rig_from_joint.len();
    let joints = (0..n).map(|i| joint(&fit, reference, i)).collect();
    let of_target = spread(&fit, &|model| {
        let moved = at_zero(model, reference).rig_from_target * zero.rig_from_target.inverse();
        moved.log().iter().copied().collect()
    });
    Ok(JointChain {
        joints,
        rig_from_target: zero.rig_from_target,
        target_sigmas: std::array::from_fn(|i| of_target[(i, i)].sqrt()),
        links: (1..n).map(|i| link(&fit, i - 1)).collect(),
        noise: fit.noise,
        sights: [seen.len(), far],
        fitted: PoseFigures::of(fit.residuals.iter().flatten()),
        left_out: PoseFigures::of(fit.held_out.iter().flatten()),
        is_converged: fit.is_converged,
        findings,
    })
}

/// Returns the chain with all joints turned back from the reference to zero.
fn at_zero(model: &JointModel, reference: &[f64]) -> JointModel {
    let mut zero = model.clone();
    let mut before = Pose::identity();
    for (frame, reading) in zero.rig_from_joint.iter_mut().zip(reference) {
        let own = *frame;
        *frame = before * own;
        let back = Pose::from_rodrigues(Vector3::z() * -*reading, Vector3::zeros());
        before = before * own * back * own.inverse();
    }
    zero.rig_from_target = before * zero.rig_from_target;
    zero
}

/// Returns the covariance of a function of the model, by differences over a tenth of a sigma.
fn spread(fit: &PoseFit<JointModel>, f: &dyn Fn(&JointModel) -> Vec<f64>) -> DMatrix<f64> {
    let n = fit.model.columns();
    let mut gain = DMatrix::zeros(f(&fit.model).len(), n);
    for column in 0..n {
        let step = (0.1 * fit.covariance[(column, column)].sqrt()).max(1e-9);
        let moved = |step: f64| {
            let mut along = DVector::zeros(n);
            along[column] = step;
            f(&fit.model.moved(&along))
        };
        for (row, (up, down)) in moved(step).into_iter().zip(moved(-step)).enumerate() {
            gain[(row, column)] = (up - down) / (2.0 * step);
        }
    }
    &gain * &fit.covariance * gain.transpose()
}

/// Returns a joint's line where all joints read zero.
fn joint(fit: &PoseFit<JointModel>, reference: &[f64], joint: usize) -> Joint {
    let line = |model: &JointModel| -> Vec<f64> {
        let frame = at_zero(model, reference).rig_from_joint[joint];
        let direction = frame.rotation * Vector3::z();
        let point = frame.translation - direction * direction.dot(&frame.translation);
        direction.iter().chain(point.iter()).copied().collect()
    };
    let at = line(&fit.model);
    let covariance = spread(fit, &line);
    let largest = |first: usize| {
        covariance.fixed_view::<3, 3>(first, first).into_owned().symmetric_eigenvalues().max().max(0.0).sqrt()
    };
    Joint {
        direction: [at[0], at[1], at[2]],
        direction_sigma_rad: largest(0),
        point_m: [at[3], at[4], at[5]],
        point_sigma_m: largest(3),
    }
}

/// Returns how a joint's line lies to the next one's.
fn link(fit: &PoseFit<JointModel>, joint: usize) -> JointLink {
    let measured = |model: &JointModel| -> Vec<f64> {
        let [one, other] = [joint, joint + 1].map(|joint| model.rig_from_joint[joint]);
        let (a, b) = (one.rotation * Vector3::z(), other.rotation * Vector3::z());
        let across = a.cross(&b);
        let apart = other.translation - one.translation;
        // Of parallel lines the common normal has no one place.
        let distance = if across.norm() > 1e-6 {
            apart.dot(&across) / across.norm()
        } else {
            (apart - a * a.dot(&apart)).norm()
        };
        vec![across.norm().atan2(a.dot(&b)), distance]
    };
    let at = measured(&fit.model);
    let covariance = spread(fit, &measured);
    let sigma = |i: usize| covariance[(i, i)].max(0.0).sqrt();
    JointLink { angle_rad: [at[0], sigma(0)], distance_m: [at[1].abs(), sigma(1)] }
}

/// Tells that a joint does not turn as its reading says.
fn of_unit(radians_per_unit: &[f64]) -> Option<Finding> {
    let (joint, ratio) =
        radians_per_unit.iter().enumerate().find(|(_, ratio)| (**ratio - 1.0).abs() > UNIT_LIMIT)?;
    let degree = std::f64::consts::PI / 180.0;
    let looks =
        if (ratio / degree - 1.0).abs() < UNIT_LIMIT { ": the readings look like degrees" } else { "" };
    Some(Finding {
        code: "joint-unit".to_owned(),
        severity: Severity::Fail,
        place: format!("joint {}", joint + 1),
        message: format!(
            "the target turns by {ratio:.4} radians for each radian of the joint's reading{looks}"
        ),
        measured: Some((ratio - 1.0).abs()),
        limit: Some(UNIT_LIMIT),
        fix: "Check the unit in the column's name, the gear ratio, and which column is which joint."
            .to_owned(),
    })
}
