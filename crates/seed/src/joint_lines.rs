//! The lines about which a chain's joints turn, from a target's poses and the joints' readings.
//!
//! Near a reference, the tangent of `rig_from_target(q) * rig_from_target(q_0)⁻¹` is linear in the joints'
//! changes, and each joint's column is its twist in the rig's frame: a unit vector along its line and the
//! moment of the line, if the joint turns and its reading is in radians.

use boresight_geometry::nalgebra::{DMatrix, Matrix3};
use boresight_geometry::{Pose, Vector3, Vector6};

/// The start of a chain.
#[derive(Clone, Debug, PartialEq)]
pub struct JointLines {
    /// The row that is the reference.
    pub reference: usize,
    /// For each joint, the frame whose z axis is the line about which it turns, at the reference.
    pub rig_from_joint: Vec<Pose>,
    /// For each joint, how many radians it turns for one unit of its reading.
    pub radians_per_unit: Vec<f64>,
}

/// What keeps the lines from being found.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum JointError {
    /// There are too few rows, or rows have different numbers of joints.
    #[error("{found} rows are given; {need} are needed, each with the same number of joints")]
    TooFew {
        /// How many rows of the usual number of joints there are.
        found: usize,
        /// How many are needed.
        need: usize,
    },
    /// Joints never moved, or always together.
    #[error("the joints' readings leave open which joint turns how: they vary by {share:.1e} of their range")]
    Together {
        /// The least spread of a combination of joints over the largest.
        share: f64,
    },
    /// A joint moves the target without turning it, or hardly.
    #[error(
        "joint {joint} (counted from 1) turns the target by {radians_per_unit:.3} radians for each unit of its reading"
    )]
    NoTurn {
        /// The joint, counted from 1.
        joint: usize,
        /// How far it turns the target for one unit of its reading.
        radians_per_unit: f64,
    },
}

/// The least spread of the readings in any combination, over that of the widest.
const LEAST_SPREAD: f64 = 1e-3;
/// A joint that turns the target by less than this many radians for each unit of its reading does not turn it.
const LEAST_TURN: f64 = 1e-3;

/// Returns the lines by linear least squares over the rows near the most central one.
pub fn joint_lines(readings: &[Vec<f64>], rig_from_target: &[Pose]) -> Result<JointLines, JointError> {
    let n = readings.first().map_or(0, Vec::len);
    let rows = readings.len().min(rig_from_target.len());
    let need = 2 * n + 3;
    if n == 0 || rows < need || readings.iter().any(|row| row.len() != n) {
        return Err(JointError::TooFew { found: rows, need });
    }
    let middle: Vec<f64> = (0..n)
        .map(|joint| {
            let mut sorted: Vec<f64> = readings.iter().map(|row| row[joint]).collect();
            sorted.sort_by(f64::total_cmp);
            sorted[rows / 2]
        })
        .collect();
    let apart =
        |one: &[f64], other: &[f64]| -> f64 { one.iter().zip(other).map(|(a, b)| (a - b).powi(2)).sum() };
    let by_distance = |from: &[f64]| {
        let mut order: Vec<usize> = (0..rows).collect();
        order.sort_by(|a, b| apart(&readings[*a], from).total_cmp(&apart(&readings[*b], from)));
        order
    };
    let reference = by_distance(&middle)[0];
    let order = by_distance(&readings[reference]);
    let inverse = rig_from_target[reference].inverse();
    // As few neighbours as tell all joints apart: the fewer, the more linear.
    let mut share = 0.0;
    let mut count = need.max(4 * n);
    while count <= 2 * rows {
        let near = &order[..count.min(rows)];
        let changes = DMatrix::from_fn(near.len(), n, |row, joint| {
            readings[near[row]][joint] - readings[reference][joint]
        });
        let moments = changes.tr_mul(&changes);
        let eigenvalues = moments.symmetric_eigenvalues();
        share = (eigenvalues.min().max(0.0) / eigenvalues.max().max(f64::MIN_POSITIVE)).sqrt();
        let enough = share > 0.3 || (count >= rows && share > LEAST_SPREAD);
        if let Some(factor) = moments.cholesky().filter(|_| enough) {
            let tangents = DMatrix::from_fn(near.len(), 6, |row, i| {
                let tangent: Vector6<f64> = (rig_from_target[near[row]] * inverse).log();
                tangent[i]
            });
            let twists = factor.solve(&changes.tr_mul(&tangents));
            return lines(reference, &twists);
        }
        count *= 2;
    }
    Err(JointError::Together { share })
}

/// Returns the frames of the lines of twists, one a row.
fn lines(reference: usize, twists: &DMatrix<f64>) -> Result<JointLines, JointError> {
    let (mut rig_from_joint, mut radians_per_unit) = (Vec::new(), Vec::new());
    for joint in 0..twists.nrows() {
        let part = |first: usize| Vector3::from_fn(|i, _| twists[(joint, first + i)]);
        let (turn, moment) = (part(0), part(3));
        let size = turn.norm();
        if size < LEAST_TURN {
            return Err(JointError::NoTurn { joint: joint + 1, radians_per_unit: size });
        }
        // The point of the line nearest to the rig's origin.
        let point = turn.cross(&moment) / (size * size);
        rig_from_joint.push(frame_along(&(turn / size), point));
        radians_per_unit.push(size);
    }
    Ok(JointLines { reference, rig_from_joint, radians_per_unit })
}

/// Returns a frame with its origin at a point and its z axis along a unit vector.
fn frame_along(z: &Vector3<f64>, origin: Vector3<f64>) -> Pose {
    let least = if z.x.abs() <= z.y.abs() && z.x.abs() <= z.z.abs() {
        Vector3::x()
    } else if z.y.abs() <= z.z.abs() {
        Vector3::y()
    } else {
        Vector3::z()
    };
    let x = least.cross(z).normalize();
    Pose::from_matrix(&Matrix3::from_columns(&[x, z.cross(&x), *z]), origin)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn turned(line: &Pose, angle: f64) -> Pose {
        *line * Pose::from_rodrigues(Vector3::z() * angle, Vector3::zeros()) * line.inverse()
    }

    fn recording(per_unit: f64, motion: impl Fn(f64) -> [f64; 2]) -> (Vec<Vec<f64>>, Vec<Pose>, [Pose; 2]) {
        let first = frame_along(&Vector3::new(0.6, 0.0, 0.8), Vector3::new(0.1, 0.2, 2.0));
        let second = frame_along(&Vector3::new(0.0, 1.0, 0.0), Vector3::new(0.3, 0.0, 1.8));
        let zero = Pose::from_rodrigues(Vector3::new(0.2, 0.1, 0.4), Vector3::new(0.0, 0.1, 1.7));
        let readings: Vec<Vec<f64>> = (0..60).map(|i| motion(f64::from(i)).to_vec()).collect();
        let poses = readings
            .iter()
            .map(|q| turned(&first, per_unit * q[0]) * turned(&second, per_unit * q[1]) * zero)
            .collect();
        (readings, poses, [first, second])
    }

    #[test]
    fn lines_are_found_where_joints_turn_apart() {
        let wave = |i: f64| [0.4 * (0.7 * i).sin(), 1.5 * (0.37 * i).cos()];
        let (readings, poses, [first, second]) = recording(1.0, wave);
        let found = joint_lines(&readings, &poses).unwrap();
        // The second line stands where the first joint has turned it at the reference.
        let second = turned(&first, readings[found.reference][0]) * second;
        for (line, truth) in found.rig_from_joint.iter().zip([first, second]) {
            let along = |pose: &Pose| pose.rotation * Vector3::z();
            // The tangent is linear for small turns only: neighbours are up to 0.2 radians away.
            let error_rad = along(line).cross(&along(&truth)).norm();
            let off_m = (line.translation - truth.translation).cross(&along(&truth)).norm();
            assert!(error_rad < 0.1 && off_m < 0.15, "{error_rad} {off_m}");
        }
        assert!(found.radians_per_unit.iter().all(|ratio| (ratio - 1.0).abs() < 0.1), "{found:?}");
        let (readings, poses, _) = recording(0.0174533, |i| wave(i).map(f64::to_degrees));
        let degrees = joint_lines(&readings, &poses).unwrap();
        assert!(degrees.radians_per_unit.iter().all(|ratio| (ratio / 0.01745 - 1.0).abs() < 0.1));
    }

    #[test]
    fn joints_that_tell_too_little_are_refused() {
        let (readings, poses, _) = recording(1.0, |i| [0.1 * i.sin(), 0.2 * i.sin()]);
        assert!(matches!(joint_lines(&readings, &poses), Err(JointError::Together { .. })));
        let (readings, poses, _) = recording(0.0, |i| [0.1 * i.sin(), 0.2 * i.cos()]);
        assert!(matches!(joint_lines(&readings, &poses), Err(JointError::NoTurn { joint: 1, .. })));
        assert!(matches!(joint_lines(&[], &[]), Err(JointError::TooFew { .. })));
    }
}
