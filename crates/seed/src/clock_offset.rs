//! How far two clocks are apart, from how fast what they time turned.
//!
//! A camera and the flange that bears it turn by the same angle in the same time, however the camera is
//! mounted, and so do a fixed camera's sights of a target on the flange. Their angular speeds, each by its own
//! clock, are shifted against each other until they agree best (Furrer, Fehr, Novkovic, Sommer, Gilitschenski &
//! Siegwart, FSR 2017, section 4).

use boresight_geometry::PoseStream;

/// How far a robot's clock is from a camera's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockOffset {
    /// What the robot's clock shows when the camera's shows zero, in seconds.
    pub offset_s: f64,
    /// The correlation of the angular speeds there.
    pub correlation: f64,
    /// The largest correlation at any shift that is no neighbour of it.
    pub next_correlation: f64,
}

/// The shortest time over which an angle is taken, in seconds: a camera's noise is divided by it.
const SHORTEST_WINDOW_S: f64 = 0.2;
/// Steps in a window.
const STEPS: f64 = 8.0;
/// The share of the shorter recording's speeds that must overlap with the other's.
const LEAST_OVERLAP: f64 = 0.5;
/// The least number of speeds that must overlap.
const LEAST_SPEEDS: usize = 32;
/// Speeds above this share of all are taken as it: trackers jump now and then.
const TRIMMED_AT: f64 = 0.98;
/// The most steps of a recording: all shifts of two such take a second. Longer ones have longer steps.
const MOST_STEPS: f64 = 20_000.0;

/// Returns how far the clocks of a robot and of a camera are apart, or `None` if the recordings are too short.
pub fn clock_offset(base_from_flange: &PoseStream, rig_from_target: &PoseStream) -> Option<ClockOffset> {
    let interval_s = base_from_flange.median_interval_s().max(rig_from_target.median_interval_s());
    let window_s = (4.0 * interval_s).max(SHORTEST_WINDOW_S);
    let span_s = |stream: &PoseStream| Some(stream.times_s().last()? - stream.times_s().first()?);
    let longest_s = span_s(base_from_flange)?.max(span_s(rig_from_target)?);
    let step_s = (window_s / STEPS).max(longest_s / MOST_STEPS);
    let (robot, robot_begin_s) = speeds(base_from_flange, window_s, step_s)?;
    let (sights, sights_begin_s) = speeds(rig_from_target, window_s, step_s)?;
    let count = |speeds: &[Option<f64>]| speeds.iter().flatten().count();
    let least = (LEAST_OVERLAP * count(&robot).min(count(&sights)) as f64) as usize;
    let least = least.max(LEAST_SPEEDS);
    // Shift k lays step i of the sights on step i + k of the robot.
    let first = 1 - sights.len() as i64;
    let shifts: Vec<Option<f64>> =
        (first..robot.len() as i64).map(|shift| correlation(&robot, &sights, shift, least)).collect();
    let at = |i: usize| shifts.get(i).copied().flatten();
    let by_correlation = |a: &usize, b: &usize| at(*a).unwrap_or(-2.0).total_cmp(&at(*b).unwrap_or(-2.0));
    let best = (0..shifts.len()).filter(|&i| at(i).is_some()).max_by(by_correlation)?;
    let correlation = at(best)?;
    // The top of the parabola through the best and its neighbours.
    let part = match (best.checked_sub(1).and_then(at), at(best + 1)) {
        (Some(before), Some(after)) if before + after < 2.0 * correlation => {
            0.5 * (before - after) / (before + after - 2.0 * correlation)
        }
        _ => 0.0,
    };
    let far = 2 * STEPS as usize;
    let next_correlation = (0..shifts.len())
        .filter(|i| i.abs_diff(best) > far && is_top(&shifts, *i))
        .filter_map(at)
        .fold(0.0, f64::max);
    let shift = (first + best as i64) as f64 + part;
    Some(ClockOffset {
        offset_s: robot_begin_s - sights_begin_s + shift * step_s,
        correlation,
        next_correlation,
    })
}

/// Tells whether no neighbour is larger.
fn is_top(shifts: &[Option<f64>], i: usize) -> bool {
    let at = |i: Option<usize>| i.and_then(|i| shifts.get(i).copied().flatten()).unwrap_or(-2.0);
    at(Some(i)) >= at(i.checked_sub(1)) && at(Some(i)) >= at(Some(i + 1))
}

/// Returns the angular speeds in equal steps, and the time of the first.
fn speeds(stream: &PoseStream, window_s: f64, step_s: f64) -> Option<(Vec<Option<f64>>, f64)> {
    let (begin_s, end_s) = (*stream.times_s().first()?, *stream.times_s().last()?);
    let begin_s = begin_s + 0.5 * window_s;
    let n = ((end_s - 0.5 * window_s - begin_s) / step_s).floor().max(0.0) as usize;
    let speed = |i: usize| {
        let time_s = begin_s + i as f64 * step_s;
        let (before, after) = (stream.at(time_s - 0.5 * window_s)?, stream.at(time_s + 0.5 * window_s)?);
        Some((after.rotation * before.rotation.inverse()).angle() / window_s)
    };
    let mut speeds: Vec<Option<f64>> = (0..n).map(speed).collect();
    let mut sorted: Vec<f64> = speeds.iter().flatten().copied().collect();
    sorted.sort_by(f64::total_cmp);
    let most = *sorted.get((TRIMMED_AT * sorted.len() as f64) as usize)?;
    speeds.iter_mut().flatten().for_each(|speed| *speed = speed.min(most));
    Some((speeds, begin_s))
}

/// Returns the correlation of what overlaps at a shift, or `None` if that is too little, or nothing moves.
fn correlation(robot: &[Option<f64>], sights: &[Option<f64>], shift: i64, least: usize) -> Option<f64> {
    let begin = usize::try_from(-shift).unwrap_or(0);
    let ahead = usize::try_from(shift).unwrap_or(0);
    let (sights, robot) = (sights.get(begin..)?, robot.get(ahead..)?);
    if sights.len().min(robot.len()) < least {
        return None;
    }
    let overlap = sights.iter().zip(robot);
    let (mut n, mut x, mut y, mut xx, mut xy, mut yy) = (0usize, 0.0, 0.0, 0.0, 0.0, 0.0);
    for (one, other) in overlap {
        let (Some(one), Some(other)) = (one, other) else { continue };
        n += 1;
        (x, y) = (x + one, y + other);
        (xx, xy, yy) = (xx + one * one, xy + one * other, yy + other * other);
    }
    if n < least {
        return None;
    }
    let n = n as f64;
    let (of_x, of_y) = (xx - x * x / n, yy - y * y / n);
    (of_x > 0.0 && of_y > 0.0).then(|| (xy - x * y / n) / (of_x * of_y).sqrt())
}

#[cfg(test)]
mod tests {
    use boresight_geometry::{Pose, Vector3};

    use super::*;

    fn flange(time_s: f64) -> Pose {
        // No period in the time of the recording.
        let turn = Vector3::new(
            0.5 * (1.1 * time_s).sin(),
            0.4 * (0.7 * time_s + 0.03 * time_s * time_s).sin(),
            0.3 * (1.9 * time_s).cos(),
        );
        Pose::from_rodrigues(turn, Vector3::new(0.1 * time_s, 0.0, 0.5))
    }

    #[test]
    fn the_offset_of_two_clocks_is_found() {
        let flange_from_rig = Pose::from_rodrigues(Vector3::new(0.3, 1.2, -0.4), Vector3::new(0.1, 0.0, 0.2));
        let base_from_target = Pose::from_rodrigues(Vector3::new(3.0, 0.1, 0.2), Vector3::new(0.7, 0.0, 0.0));
        let robot = PoseStream::new((0..2400).map(|i| f64::from(i) / 60.0).map(|t| (1000.0 + t, flange(t))));
        for late_s in [0.0, 0.37, -3.2] {
            // The camera's clock begins elsewhere, and shows 20 s of the robot's 40.
            let sights = PoseStream::new((0..600).map(|i| 10.0 + f64::from(i) / 30.0).map(|t| {
                let sight = (flange(t) * flange_from_rig).inverse() * base_from_target;
                (t + late_s, sight)
            }));
            let found = clock_offset(&robot, &sights).unwrap();
            let error_s = found.offset_s - (1000.0 - late_s);
            // A tenth of a step of 1/30 of a second.
            assert!(error_s.abs() < 3e-3 && found.correlation > 0.99, "{late_s}: {found:?}");
            assert!(found.next_correlation < 0.9, "{late_s}: {found:?}");
        }
        // Two hours, in steps of more than the window's eighth.
        let slow = |t: f64| {
            let turn = Vector3::new(
                0.5 * (0.31 * t).sin(),
                0.4 * (0.17 * t + 2.0 * (0.0123 * t).sin()).sin(),
                0.3 * (0.23 * t + 3.0 * (0.0071 * t).cos()).cos(),
            );
            Pose::from_rodrigues(turn, Vector3::zeros())
        };
        let hours = |late_s: f64| {
            PoseStream::new((0..36_000).map(|i| f64::from(i) / 5.0).map(|t| (t, slow(t + late_s))))
        };
        let found = clock_offset(&hours(0.0), &hours(33.0)).unwrap();
        assert!((found.offset_s - 33.0).abs() < 0.05, "{found:?}");
        let short = PoseStream::new((0..5).map(|i| (f64::from(i), flange(f64::from(i)))));
        assert_eq!(clock_offset(&robot, &short), None);
        assert_eq!(clock_offset(&PoseStream::default(), &robot), None);
    }
}
