//! A planar robot with two driven wheels and a sensor that measures its own motion: wheel radii, axle and the
//! sensor's pose, in closed form and then refined.
//!
//! Censi, Franchi, Marchionni & Oriolo 2013: the rotation of each interval is linear in two ratios of the wheels;
//! given these, the motion of the sensor is linear in the axle, the sensor's position and the cosine and sine of its
//! orientation, of which the last two have length one. Intervals that do not fit are left out in rounds.

use boresight_geometry::nalgebra::{Matrix2, Matrix2x3, SMatrix, SVector, Vector2};
use boresight_geometry::{Dual, Matrix3, Scalar};

use crate::linear::exceeds;
use crate::robust::median;

/// What wheels and sensor said of an interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanarMotion {
    /// Its duration in seconds.
    pub duration_s: f64,
    /// The mean angular velocities of the left and the right wheel, in radians per second.
    pub wheel_rad_per_s: [f64; 2],
    /// The sensor's motion in its own first frame: x and y in metres, and the turn in radians.
    pub sensor_motion: [f64; 3],
}

/// A planar robot as it was calibrated.
#[derive(Clone, Debug, PartialEq)]
pub struct PlanarRobot {
    /// The radii of the left and the right wheel in metres, the axle in metres, and the sensor's pose on the robot:
    /// x and y in metres, and the angle in radians.
    pub values: [f64; 6],
    /// Their standard deviations, from the scatter of the residuals.
    pub sigmas: [f64; 6],
    /// The number of intervals used.
    pub used: usize,
    /// The median size of the residuals of all intervals: metres, radians.
    pub median_residuals: [f64; 2],
}

/// The names of [`PlanarRobot::values`].
pub const PLANAR_NAMES: [&str; 6] =
    ["r_left_m", "r_right_m", "axle_m", "sensor_x_m", "sensor_y_m", "sensor_theta_rad"];

/// What keeps a planar robot from being calibrated.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PlanarError {
    /// There are too few intervals.
    #[error("there are {found} intervals; {need} are needed")]
    TooFew {
        /// How many there are.
        found: usize,
        /// How many it takes.
        need: usize,
    },
    /// The wheels always turned in the same ratio.
    #[error(
        "the wheels turned in nearly one ratio: the smaller share is {share:.1e} of the larger; turn on the spot and \
         drive straight"
    )]
    OneRatio {
        /// The smaller eigenvalue of the wheels' moments over the larger.
        share: f64,
    },
    /// The motions leave the sensor's pose or the axle open.
    #[error("the motions leave axle or sensor open: drive curves to both sides")]
    Open,
}

const LEAST: usize = 10;
/// Residuals beyond this many robust sigmas are left out.
const LIMIT_SIGMAS: f64 = 4.0;
const ROUNDS: usize = 12;

/// Calibrates a planar robot.
pub fn planar_robot(motions: &[PlanarMotion]) -> Result<PlanarRobot, PlanarError> {
    if motions.len() < LEAST {
        return Err(PlanarError::TooFew { found: motions.len(), need: LEAST });
    }
    let mut kept: Vec<PlanarMotion> = motions.to_vec();
    let mut values = closed_form(&kept)?;
    for _ in 0..4 {
        let scales = scales(motions, &values);
        kept = motions.iter().filter(|motion| fits(motion, &values, scales)).copied().collect();
        if kept.len() < LEAST {
            return Err(PlanarError::TooFew { found: kept.len(), need: LEAST });
        }
        values = closed_form(&kept)?;
    }
    let mut covariance = SMatrix::<f64, 6, 6>::zeros();
    for _ in 0..ROUNDS {
        let scales = scales(motions, &values);
        kept = motions.iter().filter(|motion| fits(motion, &values, scales)).copied().collect();
        let (mut hessian, mut gradient, mut cost) =
            (SMatrix::<f64, 6, 6>::zeros(), SVector::<f64, 6>::zeros(), 0.0);
        for motion in &kept {
            let variables: [Dual<f64, 6>; 6] = std::array::from_fn(|i| Dual::variable(values[i], i));
            for (row, residual) in residuals(motion, &variables).into_iter().enumerate() {
                let weight = 1.0 / scales[usize::from(row == 2)];
                let slope = SVector::<f64, 6>::from(residual.derivative) * weight;
                hessian += slope * slope.transpose();
                gradient += slope * (residual.value * weight);
                cost += (residual.value * weight).powi(2);
            }
        }
        let factor = hessian.cholesky().ok_or(PlanarError::Open)?;
        let step = -factor.solve(&gradient);
        values = std::array::from_fn(|i| values[i] + step[i]);
        covariance = factor.inverse() * (cost / (3 * kept.len() - 6) as f64);
    }
    let sizes = |rows: std::ops::Range<usize>| -> f64 {
        let size = |motion: &PlanarMotion| {
            let all = residuals(motion, &values);
            all[rows.clone()].iter().map(|residual| residual * residual).sum::<f64>().sqrt()
        };
        median(&motions.iter().map(size).collect::<Vec<f64>>())
    };
    Ok(PlanarRobot {
        values,
        sigmas: std::array::from_fn(|i| covariance[(i, i)].sqrt()),
        used: kept.len(),
        median_residuals: [sizes(0..2), sizes(2..3)],
    })
}

/// Returns the motion that wheels and parameters ask of the sensor, minus the one it saw.
fn residuals<T: Scalar>(motion: &PlanarMotion, values: &[T; 6]) -> [T; 3] {
    let [r_left, r_right, axle, x, y, angle] = *values;
    let [left, right] = motion.wheel_rad_per_s.map(|speed| speed * motion.duration_s);
    let turn = (r_right.scale(right) - r_left.scale(left)) / axle;
    let way = (r_right.scale(right) + r_left.scale(left)).scale(0.5);
    let half = turn.scale(0.5);
    // An arc: its chord is the way times sin(h)/h, half a turn to the side.
    let square = half * half;
    let series = half.like(1.0) - square.scale(1.0 / 6.0);
    let exact = half.sin() / half;
    let chord = way * square.select_below(1e-10, series, exact);
    let (c, s) = (turn.cos(), turn.sin());
    let moved = [chord * half.cos() + c * x - s * y - x, chord * half.sin() + s * x + c * y - y];
    let (c, s) = (angle.cos(), angle.sin());
    let [seen_x, seen_y, seen_turn] = motion.sensor_motion;
    [
        c * moved[0] + s * moved[1] - x.like(seen_x),
        c * moved[1] - s * moved[0] - x.like(seen_y),
        turn - x.like(seen_turn),
    ]
}

/// Returns robust sigmas of positions and turns.
fn scales(motions: &[PlanarMotion], values: &[f64; 6]) -> [f64; 2] {
    let all: Vec<[f64; 3]> = motions.iter().map(|motion| residuals(motion, values)).collect();
    let sizes = |rows: std::ops::Range<usize>| -> f64 {
        let sizes: Vec<f64> =
            all.iter().flat_map(|residual| residual[rows.clone()].iter().map(|r| r.abs())).collect();
        // The median of the absolute values of normal numbers is 0.6745 sigmas.
        (median(&sizes) / 0.6745).max(1e-12)
    };
    [sizes(0..2), sizes(2..3)]
}

fn fits(motion: &PlanarMotion, values: &[f64; 6], scales: [f64; 2]) -> bool {
    let [x, y, turn] = residuals(motion, values);
    x.hypot(y) <= LIMIT_SIGMAS * scales[0] && turn.abs() <= LIMIT_SIGMAS * scales[1]
}

/// Censi et al. 2013, section V.
fn closed_form(motions: &[PlanarMotion]) -> Result<[f64; 6], PlanarError> {
    let (mut moments, mut right) = (Matrix2::<f64>::zeros(), Vector2::<f64>::zeros());
    for motion in motions {
        let wheels = Vector2::from(motion.wheel_rad_per_s) * motion.duration_s;
        moments += wheels * wheels.transpose();
        right += wheels * motion.sensor_motion[2];
    }
    let eigenvalues = moments.symmetric_eigenvalues();
    let share = eigenvalues.min() / eigenvalues.max();
    if !exceeds(share, 1e-6) {
        return Err(PlanarError::OneRatio { share });
    }
    let ratios = moments.cholesky().ok_or(PlanarError::Open)?.solve(&right);
    let mut sums = SMatrix::<f64, 5, 5>::zeros();
    for motion in motions {
        let wheels = Vector2::from(motion.wheel_rad_per_s) * motion.duration_s;
        let turn = ratios.dot(&wheels);
        let way = 0.5 * (ratios[1] * wheels[1] - ratios[0] * wheels[0]);
        let half = 0.5 * turn;
        let chord = way * if half.abs() < 1e-5 { 1.0 } else { half.sin() / half };
        let (c, s) = (turn.cos(), turn.sin());
        let [x, y, _] = motion.sensor_motion;
        // The unknowns are axle, x, y, cos and sin of the sensor's angle: R(angle) seen = axle chord + (R(turn) - I) p.
        let rows = SMatrix::<f64, 2, 5>::from_row_slice(&[
            chord * half.cos(),
            c - 1.0,
            -s,
            -x,
            y,
            chord * half.sin(),
            s,
            c - 1.0,
            -y,
            -x,
        ]);
        sums += rows.transpose() * rows;
    }
    let first: Matrix3<f64> = sums.fixed_view::<3, 3>(0, 0).into_owned();
    let coupling: Matrix2x3<f64> = sums.fixed_view::<2, 3>(3, 0).into_owned();
    let own: Matrix2<f64> = sums.fixed_view::<2, 2>(3, 3).into_owned();
    let eigenvalues = first.symmetric_eigenvalues();
    if !exceeds(eigenvalues.min(), 1e-9 * eigenvalues.max()) {
        return Err(PlanarError::Open);
    }
    let inverse = first.try_inverse().ok_or(PlanarError::Open)?;
    let eigen = (own - coupling * inverse * coupling.transpose()).symmetric_eigen();
    let direction: Vector2<f64> = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
    let rest = -inverse * coupling.transpose() * direction;
    // An axle is positive.
    let sign = rest[0].signum();
    let (rest, direction) = (rest * sign, direction * sign);
    let axle = rest[0];
    Ok([-ratios[0] * axle, ratios[1] * axle, axle, rest[1], rest[2], direction[1].atan2(direction[0])])
}

#[cfg(test)]
mod tests {
    use super::*;

    const TRUTH: [f64; 6] = [0.0206, 0.0207, 0.088, -0.003, 0.006, -1.55];

    fn motions(wheels: impl Fn(f64) -> [f64; 2]) -> Vec<PlanarMotion> {
        let motion = |i: usize| {
            let still =
                PlanarMotion { duration_s: 0.8, wheel_rad_per_s: wheels(i as f64), sensor_motion: [0.0; 3] };
            PlanarMotion { sensor_motion: residuals(&still, &TRUTH), ..still }
        };
        (0..200).map(motion).collect()
    }

    #[test]
    fn exact_motions_give_the_truth_and_outliers_do_not_matter() {
        let mut motions = motions(|i| [0.6 * i.sin(), 0.5 * (1.7 * i).cos()]);
        for i in (0..200).step_by(40) {
            motions[i].sensor_motion = [0.3, -0.2, 0.4];
        }
        let found = planar_robot(&motions).unwrap();
        for (name, (value, truth)) in PLANAR_NAMES.iter().zip(found.values.iter().zip(TRUTH)) {
            assert!((value - truth).abs() < 1e-7, "{name}: {value} {truth}");
        }
        assert_eq!(found.used, 195);
    }

    #[test]
    fn motions_that_tell_too_little_are_refused() {
        let straight = planar_robot(&motions(|i| [0.5 + 0.1 * i.sin(), 0.5 + 0.1 * i.sin()]));
        assert!(matches!(straight, Err(PlanarError::OneRatio { .. })), "{straight:?}");
        assert_eq!(planar_robot(&[]), Err(PlanarError::TooFew { found: 0, need: LEAST }));
    }

    #[test]
    fn the_published_robot_is_found_where_its_recording_is_present() {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("../../../shared/datasets/planar-khepera-censi/raw/reference-output");
        for (name, published) in [
            // *_results.json: l_diam / 2, r_diam / 2, axle, l_x, l_y, l_theta.
            ("l90", [0.0205898, 0.0207204, 0.0880134, -0.00262327, 0.00584952, -1.55772]),
        ] {
            let Ok(text) = std::fs::read_to_string(folder.join(format!("{name}.tuple"))) else {
                println!("{name} is not present");
                continue;
            };
            let number = |line: &str, key: &str| -> Vec<f64> {
                let rest = line.split_once(&format!("\"{key}\":")).unwrap().1;
                let numbers = rest.split([',', ']', '}', '[']).map(str::trim);
                numbers
                    .map_while(|word| if word.is_empty() { Some(f64::NAN) } else { word.parse().ok() })
                    .filter(|n| n.is_finite())
                    .collect()
            };
            let motions: Vec<PlanarMotion> = text
                .lines()
                .filter(|line| line.contains("phi_l"))
                .map(|line| PlanarMotion {
                    duration_s: number(line, "T")[0],
                    wheel_rad_per_s: [number(line, "phi_l")[0], number(line, "phi_r")[0]],
                    sensor_motion: number(line, "sm")[..3].try_into().unwrap(),
                })
                .collect();
            let found = planar_robot(&motions).unwrap();
            println!(
                "{name}: {:?} ± {:?}, {} of {} used, {:?}",
                found.values,
                found.sigmas,
                found.used,
                motions.len(),
                found.median_residuals
            );
            // The published covariance's roots are 6e-4, 6e-4, 2.7e-3 and 1.6e-3, 8e-4, 6e-2.
            let limits = [3e-4, 3e-4, 1.3e-3, 1.6e-3, 1.6e-3, 0.03];
            for i in 0..6 {
                let error = (found.values[i] - published[i]).abs();
                assert!(error < limits[i], "{}: {} {}", PLANAR_NAMES[i], found.values[i], published[i]);
            }
        }
    }
}
