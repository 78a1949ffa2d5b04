//! A robot on wheels: its calibration, and what is doubtful about it.

use boresight_data::{Finding, Severity};
use boresight_seed::planar_robot::{PLANAR_NAMES, PlanarMotion, PlanarRobot, planar_robot};
use serde::Serialize;

use crate::error::Error;
use crate::robot_error::RobotError;

/// The name and version of the document's layout.
pub const PLANAR_SCHEMA: &str = "boresight.planar/1";

/// The largest share of intervals that may be left out without a word.
const LEFT_OUT: f64 = 0.1;

/// Wheels of a robot have radii between these, in metres.
const RADII_M: [f64; 2] = [2e-3, 2.0];

/// The largest relative sigma of wheels and axle that is passed without a word.
const RELATIVE_SIGMA: f64 = 0.03;

/// A calibrated robot on wheels.
#[derive(Clone, Debug, PartialEq)]
pub struct PlanarOutcome {
    /// The robot.
    pub robot: PlanarRobot,
    /// How many intervals were given.
    pub given: usize,
    /// What is doubtful.
    pub findings: Vec<Finding>,
}

/// Calibrates wheels, axle and sensor from motions, and judges the result.
pub fn planar(motions: &[PlanarMotion]) -> Result<PlanarOutcome, Error> {
    let robot = planar_robot(motions).map_err(RobotError::from)?;
    let given = motions.len();
    let mut findings = Vec::new();
    let mut add = |code: &str, severity, place: &str, message, measured, limit, fix: &str| {
        let (code, place, fix) = (code.to_owned(), place.to_owned(), fix.to_owned());
        let (measured, limit) = (Some(measured), Some(limit));
        findings.push(Finding { code, severity, place, message, measured, limit, fix });
    };
    for (name, radius_m) in PLANAR_NAMES.iter().zip(robot.values).take(2) {
        let limit = if radius_m.abs() < RADII_M[0] { RADII_M[0] } else { RADII_M[1] };
        if !(RADII_M[0]..=RADII_M[1]).contains(&radius_m) {
            let message = format!("the radius comes out as {:.3} mm", 1e3 * radius_m);
            let fix = "T is in seconds, phi_l and phi_r in radians a second, sm in metres and radians; left is the \
                       wheel on the side of +y, and both turn forward with a positive speed";
            add("planar-unit", Severity::Fail, name, message, radius_m, limit, fix);
        }
    }
    let left_out = 1.0 - robot.used as f64 / given as f64;
    if left_out > LEFT_OUT {
        let message =
            format!("{} of {given} intervals do not fit the others and were left out", given - robot.used);
        let fix =
            "look for slipping wheels, bad scan matches, and intervals whose times do not belong together";
        add("planar-many-left-out", Severity::Caution, "intervals", message, left_out, LEFT_OUT, fix);
    }
    // The two radii and the distance of the wheels; where the sensor is may well be zero.
    for ((name, value), sigma) in PLANAR_NAMES.iter().zip(robot.values).zip(robot.sigmas).take(3) {
        let relative = sigma / value.abs();
        if relative > RELATIVE_SIGMA {
            let message = format!("known to {:.1} % only", 100.0 * relative);
            let fix = "record more intervals, with turns on the spot, straight ways and curves to both sides";
            add("planar-uncertain", Severity::Caution, name, message, relative, RELATIVE_SIGMA, fix);
        }
    }
    findings.sort_by_key(|finding: &Finding| std::cmp::Reverse(finding.severity));
    Ok(PlanarOutcome { robot, given, findings })
}

/// Returns the document of an outcome.
pub fn planar_to_json(outcome: &PlanarOutcome) -> Vec<u8> {
    #[derive(Serialize)]
    struct Parameter {
        name: &'static str,
        value: f64,
        sigma: f64,
    }
    #[derive(Serialize)]
    struct Document<'a> {
        schema: &'static str,
        parameters: Vec<Parameter>,
        intervals: usize,
        used: usize,
        median_residual_m: f64,
        median_residual_rad: f64,
        findings: &'a [Finding],
    }
    let PlanarOutcome { robot, given, findings } = outcome;
    let [median_residual_m, median_residual_rad] = robot.median_residuals;
    let parameter =
        |i: usize| Parameter { name: PLANAR_NAMES[i], value: robot.values[i], sigma: robot.sigmas[i] };
    let document = Document {
        schema: PLANAR_SCHEMA,
        parameters: (0..PLANAR_NAMES.len()).map(parameter).collect(),
        intervals: *given,
        used: robot.used,
        median_residual_m,
        median_residual_rad,
        findings,
    };
    let mut bytes = serde_json::to_vec_pretty(&document).expect("plain numbers and texts are JSON");
    bytes.push(b'\n');
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Turns on the spot and straight ways of a robot with wheels of 20 mm, 90 mm apart, its sensor in the middle.
    fn motions(unit: f64, spoil: impl Fn(usize) -> f64) -> Vec<PlanarMotion> {
        let motion = |i: usize| {
            let (a, b) = ((i as f64).sin(), (1.7 * i as f64).cos());
            let (left, right) = (0.02 * a, 0.02 * b);
            let (turn, way) = ((right - left) / 0.09, 0.5 * (left + right));
            let half = 0.5 * turn;
            let chord = if half.abs() < 1e-9 { way } else { way * half.sin() / half };
            PlanarMotion {
                duration_s: 1.0,
                wheel_rad_per_s: [a * unit, b * unit],
                sensor_motion: [chord * half.cos() + spoil(i), chord * half.sin(), turn],
            }
        };
        (0..100).map(motion).collect()
    }

    #[test]
    fn what_is_doubtful_is_told() {
        let codes = |motions: &[PlanarMotion]| -> Vec<String> {
            planar(motions).unwrap().findings.into_iter().map(|finding| finding.code).collect()
        };
        assert!(codes(&motions(1.0, |_| 0.0)).is_empty());
        // Degrees in place of radians.
        let degrees = codes(&motions(180.0 / std::f64::consts::PI, |_| 0.0));
        assert_eq!(degrees, ["planar-unit", "planar-unit"]);
        let outliers = codes(&motions(1.0, |i| if i % 6 == 0 { 0.3 } else { 1e-6 * (7.0 * i as f64).sin() }));
        assert_eq!(outliers, ["planar-many-left-out"]);
        let json = planar_to_json(&planar(&motions(1.0, |_| 0.0)).unwrap());
        let json: serde_json::Value = serde_json::from_slice(&json).unwrap();
        assert_eq!((json["schema"].as_str(), json["used"].as_u64()), (Some(PLANAR_SCHEMA), Some(100)));
        assert!((json["parameters"][2]["value"].as_f64().unwrap() - 0.09).abs() < 1e-9, "{json}");
    }
}
