//! How well points are known in the robot's base, where the robot works: at the target, frame by frame.

use boresight_adjust::HeldOut;
use boresight_data::{Calibration, Dataset, Mounting, Robot};
use boresight_geometry::nalgebra::SMatrix;
use boresight_geometry::{Matrix6, Pose, Vector3, Vector6, skew};
use serde::Serialize;

use super::corners_of;

/// Where sigmas come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum SigmaSource {
    /// The covariance at the optimum, the robot's noise included.
    Covariance,
    /// The scatter of the solutions without each frame in turn, which no assumption about the robot enters.
    Jackknife,
}

/// How well a point is known in the robot's base.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct WorkingPoint {
    /// The frame in which it was seen.
    pub frame: String,
    /// Where it is in the base, in metres: the middle of the target as seen in this frame.
    pub point_in_base_m: [f64; 3],
    /// The standard deviation along each axis of the base, in metres, that the calibration brings to a
    /// point whose place in the rig is known.
    pub sigma_m: [f64; 3],
    /// Where the sigmas come from.
    pub source: SigmaSource,
}

/// Returns the jackknife's sigmas of the rig's pose, and its covariance; `None` of fewer than three frames.
pub(super) fn jackknife(held_out: &[HeldOut]) -> Option<([f64; 6], Matrix6<f64>)> {
    let poses: Vec<Pose> = held_out
        .iter()
        .filter_map(|held_out| held_out.scene.robot.as_ref().map(Robot::carrier_from_rig))
        .collect();
    let first = poses.first().filter(|_| poses.len() > 2)?;
    let n = poses.len() as f64;
    let tangents: Vec<Vector6<f64>> = poses.iter().map(|pose| (*pose * first.inverse()).log()).collect();
    let mean = tangents.iter().sum::<Vector6<f64>>() / n;
    let scatter: Matrix6<f64> =
        tangents.iter().map(|tangent| (tangent - mean) * (tangent - mean).transpose()).sum();
    // Efron & Stein 1981: (n - 1) / n times the sum of squares.
    let covariance = scatter * ((n - 1.0) / n);
    Some((std::array::from_fn(|i| covariance[(i, i)].sqrt()), covariance))
}

/// Returns how well the target's middle is known in the base in each frame.
pub(super) fn working_points(
    dataset: &Dataset,
    calibration: &Calibration,
    mounting: Mounting,
    jackknife: &Option<([f64; 6], Matrix6<f64>)>,
    is_noise_used: bool,
) -> Vec<WorkingPoint> {
    let Some(robot) = &calibration.scene.robot else { return Vec::new() };
    let covariance = is_noise_used.then(|| covariance_of(calibration, mounting)).flatten();
    let (covariance, source) = match (covariance, jackknife) {
        (Some(covariance), _) => (covariance, SigmaSource::Covariance),
        (None, Some((_, covariance))) => (*covariance, SigmaSource::Jackknife),
        (None, None) => return Vec::new(),
    };
    let corners = corners_of(dataset);
    let middle = corners.iter().sum::<Vector3<f64>>() / corners.len().max(1) as f64;
    let points = dataset.frames.enumerate().filter_map(|(id, frame)| {
        let rig_from_target = calibration.scene.rig_from_target[id]?;
        let base_from_carrier = match mounting {
            Mounting::RigOnFlange => robot.corrected(&frame.base_from_flange?),
            Mounting::RigInBase => Pose::identity(),
        };
        dataset.views.iter().any(|view| view.frame == id).then_some(())?;
        let point_in_carrier = robot.carrier_from_rig() * (rig_from_target * middle);
        let own = base_covariance(&base_from_carrier, &point_in_carrier, &covariance);
        Some(WorkingPoint {
            frame: frame.name.clone(),
            point_in_base_m: (base_from_carrier * point_in_carrier).into(),
            sigma_m: [0, 1, 2].map(|axis| own[(axis, axis)].max(0.0).sqrt()),
            source,
        })
    });
    points.collect()
}

/// Maps the covariance of a left perturbation of the carrier's pose of the rig to a point in the base.
fn base_covariance(
    base_from_carrier: &Pose,
    point_in_carrier: &Vector3<f64>,
    covariance: &Matrix6<f64>,
) -> SMatrix<f64, 3, 3> {
    // A perturbation (w, v) moves the point by w × p + v.
    let mut jacobian = SMatrix::<f64, 3, 6>::zeros();
    jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&-skew(point_in_carrier));
    jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&SMatrix::<f64, 3, 3>::identity());
    let jacobian = base_from_carrier.rotation_matrix() * jacobian;
    jacobian * covariance * jacobian.transpose()
}

/// Returns the covariance of the rig's pose on its carrier, if there is one.
fn covariance_of(calibration: &Calibration, mounting: Mounting) -> Option<Matrix6<f64>> {
    let prefix = match mounting {
        Mounting::RigOnFlange => "robot.flange_from_rig.",
        Mounting::RigInBase => "robot.base_from_rig.",
    };
    let uncertainty = &calibration.uncertainty;
    let first = uncertainty.names.iter().position(|name| name.starts_with(prefix))?;
    let n = uncertainty.names.len();
    Some(Matrix6::from_fn(|row, column| uncertainty.covariance[(first + row) * n + first + column]))
}
