//! Which images of several cameras are of one instant, and how far apart in time cameras are.

/// An image of a camera at a time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Shot {
    pub camera: usize,
    pub time_ns: i64,
}

/// How two cameras are related in time, from the images of the one with fewer and the nearest of the other.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraPair {
    /// The names of the cameras.
    pub cameras: [String; 2],
    /// The median of the second's time less the first's, in nanoseconds.
    pub apart_ns: i64,
    /// How much that varies: 1.4826 times the median absolute deviation, in nanoseconds.
    pub spread_ns: i64,
    /// How many images of the one have an image of the other within the tolerance.
    pub within: usize,
    /// How many pairs of images there are.
    pub pairs: usize,
    /// How often the second's time less the first's falls into each of the equal parts of `histogram_range_ns`.
    pub histogram: Vec<usize>,
    /// Where the histogram begins and ends, in nanoseconds.
    pub histogram_range_ns: [i64; 2],
}

/// The parts of a histogram.
pub const BINS: usize = 9;
/// The largest tolerance that is taken without being told, in nanoseconds.
const LARGEST_NS: i64 = 15_000_000;

/// Returns the tolerance that is taken where none is told: a quarter of the shortest period, 15 ms at most.
pub(crate) fn usual_tolerance_ns(times_ns: &[Vec<i64>]) -> i64 {
    let shortest = times_ns.iter().filter_map(|times| period_ns(times)).min();
    shortest.map_or(LARGEST_NS, |period| (period / 4).min(LARGEST_NS))
}

/// Returns the median time from image to image of a camera, whose times are in order.
pub(crate) fn period_ns(times_ns: &[i64]) -> Option<i64> {
    let mut steps: Vec<i64> = times_ns.windows(2).map(|pair| pair[1].saturating_sub(pair[0])).collect();
    median(&mut steps).filter(|period| *period > 0)
}

/// Returns the frame of each shot: shots of different cameras are of one frame if none is later than the frame's first by
/// more than the tolerance. Shots come in order of time; frames count up in order of time.
pub(crate) fn frames_of(shots: &[Shot], tolerance_ns: i64) -> Vec<usize> {
    let mut frames = Vec::with_capacity(shots.len());
    let (mut frame, mut begin_ns, mut cameras) = (0, i64::MIN, Vec::new());
    for (i, shot) in shots.iter().enumerate() {
        let is_late = shot.time_ns.saturating_sub(begin_ns) > tolerance_ns;
        if i > 0 && (is_late || cameras.contains(&shot.camera)) {
            frame += 1;
            cameras.clear();
        }
        if cameras.is_empty() {
            begin_ns = shot.time_ns;
        }
        cameras.push(shot.camera);
        frames.push(frame);
    }
    frames
}

/// Relates two cameras by their times, which are in order; `None` if one has no image.
pub(crate) fn relate(cameras: [&str; 2], times_ns: [&[i64]; 2], tolerance_ns: i64) -> Option<CameraPair> {
    let is_swapped = times_ns[1].len() < times_ns[0].len();
    let (few, many) = if is_swapped { (times_ns[1], times_ns[0]) } else { (times_ns[0], times_ns[1]) };
    let nearest = |time: i64| {
        let after = many.partition_point(|other| *other < time);
        let candidates = many[after.saturating_sub(1)..].iter().take(2);
        candidates.map(|other| other.saturating_sub(time)).min_by_key(|apart| apart.unsigned_abs())
    };
    let mut aparts: Vec<i64> = few.iter().filter_map(|time| nearest(*time)).collect();
    if is_swapped {
        aparts.iter_mut().for_each(|apart| *apart = apart.saturating_neg());
    }
    let within = aparts.iter().filter(|apart| apart.unsigned_abs() <= tolerance_ns.unsigned_abs()).count();
    let apart_ns = median(&mut aparts)?;
    let mut deviations: Vec<i64> =
        aparts.iter().map(|apart| apart.saturating_sub(apart_ns).saturating_abs()).collect();
    let spread_ns = (1.4826 * median(&mut deviations)? as f64).round() as i64;
    // The outermost hundredth would stretch the histogram until it shows nothing.
    let ends = [aparts.len() / 100, aparts.len() - 1 - aparts.len() / 100].map(|i| aparts[i]);
    let width = (ends[1].saturating_sub(ends[0]) / BINS as i64).saturating_add(1);
    let mut histogram = vec![0; BINS];
    for apart in &aparts {
        let bin = apart.saturating_sub(ends[0]).div_euclid(width).clamp(0, BINS as i64 - 1);
        histogram[bin as usize] += 1;
    }
    Some(CameraPair {
        cameras: cameras.map(str::to_owned),
        apart_ns,
        spread_ns,
        within,
        pairs: aparts.len(),
        histogram,
        histogram_range_ns: [ends[0], ends[0].saturating_add(width.saturating_mul(BINS as i64))],
    })
}

impl CameraPair {
    /// Returns how the two are related in time, in a sentence.
    pub fn describe(&self) -> String {
        let [first, second] = &self.cameras;
        let decimals = if self.spread_ns >= 1_000_000 { 0 } else { 2 };
        let [apart, spread] = [self.apart_ns.saturating_abs(), self.spread_ns].map(|time| time as f64 / 1e6);
        format!("{first} and {second} are {apart:.decimals$} ± {spread:.decimals$} ms apart")
    }
}

/// Returns a time in milliseconds with as many decimals as tell something.
pub(crate) fn milliseconds(time_ns: i64) -> String {
    let value = time_ns as f64 / 1e6;
    if value.abs() >= 10.0 { format!("{value:.0}") } else { format!("{value:.2}") }
}

/// Sorts, and returns the middle one.
fn median(values: &mut [i64]) -> Option<i64> {
    values.sort_unstable();
    values.get(values.len() / 2).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    /// Returns `n` times, `period` apart from `begin` on, shifted by what `jitter` says, in ms.
    fn times(n: i64, period: i64, begin: i64, jitter: impl Fn(i64) -> i64) -> Vec<i64> {
        (0..n).map(|i| (begin + i * period + jitter(i)) * MS).collect()
    }

    fn frames(of: &[Vec<i64>], tolerance_ms: i64) -> Vec<Vec<usize>> {
        let shots = of
            .iter()
            .enumerate()
            .flat_map(|(camera, times)| times.iter().map(move |time| Shot { camera, time_ns: *time }));
        let mut shots: Vec<Shot> = shots.collect();
        shots.sort_by_key(|shot| (shot.time_ns, shot.camera));
        let frames = frames_of(&shots, tolerance_ms * MS);
        let mut members = vec![Vec::new(); frames.last().map_or(0, |last| last + 1)];
        for (shot, frame) in shots.iter().zip(frames) {
            members[frame].push(shot.camera);
        }
        members
    }

    #[test]
    fn images_within_the_tolerance_are_of_one_frame() {
        let [a, b] = [times(5, 100, 0, |_| 0), times(5, 100, 0, |i| i - 2)];
        assert!(frames(&[a.clone(), b.clone()], 5).iter().all(|members| members.len() == 2));
        // A dropped image leaves its frame to the other camera.
        let dropped: Vec<i64> = b.iter().copied().filter(|time| *time != b[2]).collect();
        let members = frames(&[a.clone(), dropped], 5);
        assert_eq!(members.iter().map(Vec::len).collect::<Vec<_>>(), [2, 2, 1, 2, 2]);
        // No camera is twice in a frame, however large the tolerance.
        assert!(frames(&[a, b], 1000).iter().all(|members| members.len() == 2));
        assert!(frames(&[], 5).is_empty());
    }

    #[test]
    fn a_constant_offset_is_told_with_its_spread() {
        let jitter = |i: i64| [-2, 0, 2, -1, 1, 0][i as usize % 6];
        let (a, b) = (times(60, 200, 0, |_| 0), times(59, 200, 51, jitter));
        let pair = relate(["cam0", "cam1"], [&a, &b], 15 * MS).unwrap();
        assert_eq!((pair.apart_ns, pair.within, pair.pairs), (51 * MS, 0, 59));
        assert_eq!(pair.describe(), "cam0 and cam1 are 51 ± 1 ms apart");
        assert_eq!(pair.histogram.iter().sum::<usize>(), 59);
        let other = relate(["cam1", "cam0"], [&b, &a], 60 * MS).unwrap();
        assert_eq!((other.apart_ns, other.within), (-51 * MS, 59));
        assert!(relate(["a", "b"], [&a, &[]], MS).is_none());
    }

    #[test]
    fn the_usual_tolerance_follows_the_fastest_camera() {
        assert_eq!(usual_tolerance_ns(&[times(9, 20, 0, |_| 0), times(9, 100, 0, |_| 0)]), 5 * MS);
        assert_eq!(usual_tolerance_ns(&[times(9, 1000, 0, |_| 0)]), 15 * MS);
        assert_eq!(usual_tolerance_ns(&[vec![], vec![7]]), 15 * MS);
    }

    #[test]
    fn times_at_the_ends_of_what_can_be_said_do_no_harm() {
        let ends = [i64::MIN, 0, i64::MAX];
        let pair = relate(["a", "b"], [&ends, &ends], MS).unwrap();
        assert_eq!(pair.apart_ns, 0);
        relate(["a", "b"], [&[i64::MIN], &[i64::MAX]], MS).unwrap();
        let shots = ends.map(|time_ns| Shot { camera: 0, time_ns });
        assert_eq!(frames_of(&shots, MS), [0, 1, 2]);
    }
}
