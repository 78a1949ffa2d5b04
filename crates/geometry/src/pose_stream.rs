//! Poses over time, and where they lead between two samples.

use crate::{Pose, UnitQuaternion, Vector6};

/// A moving frame, sampled: `b_from_a` at increasing times.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PoseStream {
    times_s: Vec<f64>,
    poses: Vec<Pose>,
    longest_gap_s: f64,
}

/// Neighbours further apart than this many median intervals are not joined.
const LONGEST_GAP: f64 = 6.0;

impl PoseStream {
    /// Returns the stream of samples in any order; of several at one time the first is kept, and samples
    /// with a time that is not finite are left out.
    ///
    /// Samples further apart than six times their median interval have a gap between them, in which the
    /// stream has no pose.
    pub fn new(samples: impl IntoIterator<Item = (f64, Pose)>) -> Self {
        let mut sorted: Vec<(f64, Pose)> =
            samples.into_iter().filter(|(time_s, _)| time_s.is_finite()).collect();
        sorted.sort_by(|one, other| one.0.total_cmp(&other.0));
        sorted.dedup_by(|later, earlier| later.0 <= earlier.0);
        let mut intervals: Vec<f64> = sorted.windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
        intervals.sort_by(f64::total_cmp);
        let median = intervals.get(intervals.len() / 2).copied().unwrap_or(0.0);
        let (times_s, poses) = sorted.into_iter().unzip();
        Self { times_s, poses, longest_gap_s: LONGEST_GAP * median }
    }

    /// Returns the times of the samples in seconds, ascending.
    pub fn times_s(&self) -> &[f64] {
        &self.times_s
    }

    /// Returns the poses of the samples, in the order of their times.
    pub fn poses(&self) -> &[Pose] {
        &self.poses
    }

    /// Returns the median interval between samples in seconds; zero of fewer than two.
    pub fn median_interval_s(&self) -> f64 {
        self.longest_gap_s / LONGEST_GAP
    }

    /// Returns the pose at a time: the rotation along the shortest arc between its neighbours, the translation
    /// along the line. `None` before the first sample, after the last, and in gaps.
    pub fn at(&self, time_s: f64) -> Option<Pose> {
        let next = self.times_s.partition_point(|sample| *sample < time_s);
        if self.times_s.get(next) == Some(&time_s) {
            return Some(self.poses[next]);
        }
        let (pose, _) = self.along(next.checked_sub(1)?, time_s)?;
        Some(pose)
    }

    /// Returns the pose at a time, and how it moves there: the left tangent `[rotation, translation]` per second, of
    /// the piece that ends at a sample where the time is a sample's. `None` where [`at`](Self::at) is, and for a
    /// sample with gaps on both sides.
    pub fn at_moving(&self, time_s: f64) -> Option<(Pose, Vector6<f64>)> {
        let next = self.times_s.partition_point(|sample| *sample < time_s);
        let ending = next.checked_sub(1).and_then(|before| self.along(before, time_s));
        let is_sample = self.times_s.get(next) == Some(&time_s);
        let (pose, twist) = ending.or_else(|| is_sample.then(|| self.along(next, time_s))?)?;
        Some((if is_sample { self.poses[next] } else { pose }, twist))
    }

    /// Returns the pose on the piece from a sample to the next, and how it moves there; `None` for gaps.
    fn along(&self, before: usize, time_s: f64) -> Option<(Pose, Vector6<f64>)> {
        let (begin_s, end_s) = (*self.times_s.get(before)?, *self.times_s.get(before + 1)?);
        let interval_s = end_s - begin_s;
        if interval_s > self.longest_gap_s {
            return None;
        }
        let share = (time_s - begin_s) / interval_s;
        let (one, other) = (&self.poses[before], &self.poses[before + 1]);
        let turn = (other.rotation * one.rotation.inverse()).scaled_axis();
        let shift = other.translation - one.translation;
        let turned = UnitQuaternion::from_scaled_axis(turn * share) * one.rotation;
        let pose = Pose::new(turned, one.translation + shift * share);
        // A left perturbation (w, v) moves the translation by w × t + v.
        let rotation = turn / interval_s;
        let translation = shift / interval_s - rotation.cross(&pose.translation);
        let mut twist = Vector6::zeros();
        twist.fixed_rows_mut::<3>(0).copy_from(&rotation);
        twist.fixed_rows_mut::<3>(3).copy_from(&translation);
        Some((pose, twist))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Vector3;

    fn moving(time_s: f64) -> Pose {
        Pose::from_rodrigues(Vector3::new(0.2, 0.5 * time_s, -0.1), Vector3::new(time_s, 1.0, -0.5 * time_s))
    }

    #[test]
    fn samples_and_what_is_between_them() {
        let times = [0.0, 0.1, 0.2, 0.3, 0.4, 5.0, 5.1];
        let stream = PoseStream::new(times.iter().rev().map(|&time| (time, moving(time))));
        assert_eq!(stream.at(0.3), Some(moving(0.3)));
        let between = stream.at(0.34).unwrap();
        // A tenth of a second of a curved path is off its chord by 1e-4.
        assert!((between * moving(0.34).inverse()).log().norm() < 2e-4, "{between:?}");
        for time in [-0.1, 2.0, 5.2, f64::NAN] {
            assert_eq!(stream.at(time), None, "{time}");
        }
        for time in [-0.1, 2.0, 5.2, f64::NAN] {
            assert_eq!(stream.at_moving(time), None, "{time}");
        }
        // The derivative of what is between the samples, and at them that of the piece before, or else behind.
        let step = 1e-7;
        for (time, sides) in [(0.25, [-1.0, 1.0]), (0.3, [-1.0, 0.0]), (0.0, [0.0, 1.0]), (5.0, [0.0, 1.0])] {
            let (pose, twist) = stream.at_moving(time).unwrap();
            assert_eq!(Some(pose), stream.at(time));
            let [before, after] = sides.map(|side| stream.at(time + side * step).unwrap());
            let expected = (after * before.inverse()).log() / (step * (sides[1] - sides[0]));
            // One-sided differences are off by the step times the speeds' product.
            assert!((twist - expected).norm() < 1e-6, "{time}: {twist} {expected}");
        }
        assert!(PoseStream::default().at(0.0).is_none() && PoseStream::default().at_moving(0.0).is_none());
        let alone = PoseStream::new([(1.0, moving(1.0))]);
        assert!(alone.at(1.0).is_some() && alone.at_moving(1.0).is_none());
    }

    #[test]
    fn samples_at_one_time_count_once() {
        let samples = [(1.0, moving(1.0)), (1.0, moving(9.0)), (f64::NAN, moving(2.0)), (0.0, moving(0.0))];
        let stream = PoseStream::new(samples);
        assert_eq!((stream.times_s(), stream.poses()), (&[0.0, 1.0][..], &[moving(0.0), moving(1.0)][..]));
    }
}
