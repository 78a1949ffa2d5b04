//! The pose that most of several estimates agree on.

use boresight_geometry::{Pose, Vector6};

use crate::robust::{cauchy_weight, median, width_for};

/// Estimates beyond this many are not tried as a centre; all are averaged.
const MAX_CENTRES: usize = 24;

/// Returns the robust mean of poses that estimate the same thing, each with a weight, or `None` of none.
///
/// Rotations (radians) and translations (metres) are compared at `length_m`, the distance at which
/// things are seen. The estimate nearest to all others starts, so that up to half of them may be
/// wrong; reweighted means on the manifold follow (section 4 of Hartley, Trumpf, Dai & Li 2013).
pub(crate) fn average(estimates: &[(Pose, f64)], length_m: f64) -> Option<Pose> {
    let difference = |from: &Pose, to: &Pose| {
        let mut tangent = Vector6::zeros();
        tangent.fixed_rows_mut::<3>(0).copy_from(&(to.rotation * from.rotation.inverse()).scaled_axis());
        tangent.fixed_rows_mut::<3>(3).copy_from(&(to.translation - from.translation));
        tangent
    };
    let distance = |from: &Pose, to: &Pose| {
        let tangent = difference(from, to);
        let rotation = tangent.fixed_rows::<3>(0).norm();
        rotation.hypot(tangent.fixed_rows::<3>(3).norm() / length_m)
    };
    let stride = estimates.len().div_ceil(MAX_CENTRES).max(1);
    let score = |(centre, _): &(Pose, f64)| {
        let distances: Vec<f64> = estimates.iter().map(|(other, _)| distance(centre, other)).collect();
        median(&distances)
    };
    let scored = estimates.iter().step_by(stride).map(|estimate| (score(estimate), estimate.0));
    let (_, mut mean) = scored.min_by(|a, b| a.0.total_cmp(&b.0))?;
    for _ in 0..8 {
        let distances: Vec<f64> = estimates.iter().map(|(other, _)| distance(&mean, other)).collect();
        let width = width_for(median(&distances)).max(1e-12);
        let (mut sum, mut weights) = (Vector6::zeros(), 0.0);
        for ((other, weight), distance) in estimates.iter().zip(distances) {
            let weight = weight * cauchy_weight(distance, width);
            sum += difference(&mean, other) * weight;
            weights += weight;
        }
        let step = sum / weights;
        let turn = boresight_geometry::UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(0).into_owned());
        mean = Pose::new(turn * mean.rotation, mean.translation + step.fixed_rows::<3>(3));
        if step.norm() < 1e-10 {
            break;
        }
    }
    Some(mean)
}

#[cfg(test)]
mod tests {
    use boresight_geometry::Vector3;

    use super::*;

    #[test]
    fn a_third_of_wrong_estimates_does_not_move_the_mean() {
        let truth = Pose::from_rodrigues(Vector3::new(0.3, -1.0, 0.2), Vector3::new(0.5, 0.1, -0.2));
        let mut estimates = Vec::new();
        for i in 0..30 {
            let phase = f64::from(i);
            let small = Vector3::new(phase.sin(), (2.3 * phase).cos(), (3.1 * phase).sin());
            let size = if i % 3 == 0 { 0.8 } else { 0.002 };
            let error = Pose::from_rodrigues(small * size, small.yzx() * size);
            estimates.push((error * truth, 1.0));
        }
        let mean = average(&estimates, 1.0).unwrap();
        let error = mean * truth.inverse();
        assert!(error.angle() < 0.002 && error.translation.norm() < 0.003, "{error:?}");
        assert_eq!(average(&[], 1.0), None);
        assert_eq!(average(&[(truth, 2.0)], 1.0), Some(truth));
    }
}
