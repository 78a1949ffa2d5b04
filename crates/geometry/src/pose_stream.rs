//! Poses over time, and where they lead between two samples.

use crate::{Pose, Vector6};

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
        let (before, after, share) = self.between(time_s)?;
        if share == 1.0 {
            return Some(self.poses[after]);
        }
        let (one, other) = (&self.poses[before], &self.poses[after]);
        let turn = Pose::new(other.rotation * one.rotation.inverse(), other.translation).rodrigues() * share;
        let turned = Pose::from_rodrigues(turn, one.translation).rotation * one.rotation;
        Some(Pose::new(turned, one.translation + (other.translation - one.translation) * share))
    }

    /// Returns the samples about a time and how far it is from the first to the second; `None` where no pose is.
    fn between(&self, time_s: f64) -> Option<(usize, usize, f64)> {
        let next = self.times_s.partition_point(|sample| *sample < time_s);
        if self.times_s.get(next) == Some(&time_s) {
            return Some((next, next, 1.0));
        }
        let before = next.checked_sub(1)?;
        let (begin, end) = (*self.times_s.get(before)?, *self.times_s.get(next)?);
        (end - begin <= self.longest_gap_s).then(|| (before, next, (time_s - begin) / (end - begin)))
    }

    /// Tells whether there is a [`twist`](Self::twist) at a time, without working it out.
    pub fn has_twist(&self, time_s: f64) -> bool {
        let half = 0.5 * self.median_interval_s();
        self.between(time_s - half).is_some() && self.between(time_s + half).is_some()
    }

    /// Returns the twist at a time: the tangent `[rotation, translation]` per second by which the pose moves,
    /// from the left, over one median interval. `None` where [`at`](Self::at) is at either end of it.
    pub fn twist(&self, time_s: f64) -> Option<Vector6<f64>> {
        let half = 0.5 * self.median_interval_s();
        let (before, after) = (self.at(time_s - half)?, self.at(time_s + half)?);
        Some((after * before.inverse()).log() / (2.0 * half))
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
        for time in [-0.1, 0.0, 0.04, 0.06, 0.25, 0.34, 0.36, 0.41, 2.0, 5.05, f64::NAN] {
            assert_eq!(stream.has_twist(time), stream.twist(time).is_some(), "{time}");
        }
        let twist = stream.twist(0.25).unwrap();
        let step = 1e-6;
        let expected = (moving(0.25 + step) * moving(0.25 - step).inverse()).log() / (2.0 * step);
        assert!((twist - expected).norm() < 1e-3, "{twist} {expected}");
        assert!(PoseStream::default().at(0.0).is_none() && PoseStream::default().twist(0.0).is_none());
    }

    #[test]
    fn samples_at_one_time_count_once() {
        let samples = [(1.0, moving(1.0)), (1.0, moving(9.0)), (f64::NAN, moving(2.0)), (0.0, moving(0.0))];
        let stream = PoseStream::new(samples);
        assert_eq!((stream.times_s(), stream.poses()), (&[0.0, 1.0][..], &[moving(0.0), moving(1.0)][..]));
    }
}
