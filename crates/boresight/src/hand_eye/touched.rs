//! What touched points of the target say of the result: how far the tip is from where it should be.

use boresight_adjust::RobotNoise;
use boresight_data::{Calibration, Dataset, Finding, Id as _, Mounting, Severity, TargetId};
use boresight_geometry::{Pose, Vector3};
use boresight_io::TouchInput;
use serde::Serialize;

/// Touches that miss by more than this many times what their sigma and the robot's noise explain are told, and by more
/// than the second the result fails. Of 27 numbers the root mean square is hardly ever 1.5 times its sigma.
const MISS: [f64; 2] = [3.0, 10.0];

/// Touched points, as the result has them.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TouchedPoints {
    /// How many there are.
    pub touches: usize,
    /// The tip on what bears the cameras, flange or base, in metres.
    pub tip_m: [f64; 3],
    /// Its standard deviations; `None` where it was given, or where they are not known.
    pub tip_sigma_m: Option<[f64; 3]>,
    /// The root mean square, along an axis, of the distance between the tip, by the robot's word, and the touched point.
    pub rms_m: f64,
    /// What the sigma of a touch and the robot's noise explain of it.
    pub expected_m: f64,
}

/// Returns what touches say of a calibration; `None` if it has no robot. `noise` is what the robot's frames tell of it.
pub(super) fn touched_points(
    touches: &TouchInput,
    dataset: &Dataset,
    calibration: &Calibration,
    noise: Option<RobotNoise>,
) -> Option<TouchedPoints> {
    let robot = calibration.scene.robot.as_ref()?;
    let mounting = robot.mounting()?;
    let target = TargetId::from_index(0);
    let (board, belief) = (&dataset.targets[target], &calibration.scene.targets[target]);
    let pairs = touches.points.iter().zip(&touches.base_from_flange).map(|(&point, said)| {
        let base_from_flange = robot.corrected(said);
        let other_from_carrier = match mounting {
            Mounting::RigOnFlange => base_from_flange,
            Mounting::RigInBase => base_from_flange.inverse(),
        };
        (other_from_carrier, robot.other_from_target() * board.point(point, &belief.shape_m))
    });
    let pairs: Vec<(Pose, Vector3<f64>)> = pairs.collect();
    // A pointer in the cell is no part of the robot: unless given, it is where the touched points are in the mean.
    let mean = || {
        let sum: Vector3<f64> = pairs.iter().map(|(pose, point)| pose.inverse() * *point).sum();
        sum / pairs.len() as f64
    };
    let tip = robot.tip_in_flange.or(touches.tip_m.map(Vector3::from)).unwrap_or_else(mean);
    let mut square = 0.0;
    let mut reach_m: f64 = 0.0;
    for &(other_from_carrier, point_in_other) in &pairs {
        square += (other_from_carrier * tip - point_in_other).norm_squared();
        // The flange's turns act over the distance between it and what is touched.
        reach_m = reach_m.max(match mounting {
            Mounting::RigOnFlange => tip.norm(),
            Mounting::RigInBase => point_in_other.norm(),
        });
    }
    let touches_count = touches.points.len();
    let by_robot = noise.map_or(0.0, |noise| noise.translation_m.hypot(noise.rotation_rad * reach_m));
    let bearer = match mounting {
        Mounting::RigOnFlange => "flange",
        Mounting::RigInBase => "base",
    };
    let sigma_m = |axis: &str| calibration.uncertainty.sigma(&format!("robot.tip_in_{bearer}.{axis}_m"));
    let tip_sigma_m = || Some([sigma_m("x")?, sigma_m("y")?, sigma_m("z")?]);
    Some(TouchedPoints {
        touches: touches_count,
        tip_m: tip.into(),
        tip_sigma_m: tip_sigma_m().filter(|_| touches.tip_m.is_none()),
        rms_m: (square / (3 * touches_count).max(1) as f64).sqrt(),
        expected_m: touches.sigma_m.hypot(by_robot),
    })
}

/// Tells that touches are not where the result has them.
pub(super) fn doubt(touched: &TouchedPoints) -> Option<Finding> {
    let ratio = touched.rms_m / touched.expected_m;
    (ratio > MISS[0]).then(|| Finding {
        code: "touches-off".to_owned(),
        severity: if ratio > MISS[1] { Severity::Fail } else { Severity::Caution },
        place: "touches".to_owned(),
        message: format!(
            "the tip misses the {} touched points by {:.2} mm along an axis, {ratio:.1} times what sigmas explain",
            touched.touches,
            1e3 * touched.rms_m
        ),
        measured: Some(ratio),
        limit: Some(MISS[0]),
        fix: "Check tip_mm (or leave it out to have it estimated), the numbers of the touched points, and touch_sigma_mm."
            .to_owned(),
    })
}
