//! Which convention do a robot's poses follow? All are tried on the data and ranked by how well they foretell
//! frames that were left out.

use boresight_data::{AngleUnit, LengthUnit, Mounting, PoseConvention, PoseDirection, PoseRow, RotationKind};
use boresight_geometry::{Pose, Vector3};

use super::{HandEye, Method, PosePair, hand_eye, pose_pair};

/// The frames are left out in this many turns.
const FOLDS: usize = 6;
/// A reading is good if it misses the target by less than this share of its distance; wrong rows are then not sought.
const GOOD_SHARE: f64 = 0.02;
/// Readings that are tried with a change of tools at every frame: those that fit half of the frames best.
const TRIED_WITH_TOOLS: usize = 3;
/// How many times better a reading must be with a change of rows, which has more freedom, to be listed.
const BETTER_BY_CHANGE: f64 = 2.0;
/// The least number of frames on either side of a change of tools.
const LEAST_ON_A_SIDE: usize = 4;

/// A way to read a table of poses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// What the numbers mean.
    pub convention: PoseConvention,
    /// Where the cameras are.
    pub mounting: Mounting,
    /// What is wrong with the rows themselves.
    pub change: RowChange,
    /// The root mean square distance in metres by which the target's points are missed in frames left out.
    pub held_out_m: f64,
}

/// What is wrong with the rows of a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RowChange {
    /// Nothing.
    None,
    /// Each row belongs to the frame this many places later.
    Shifted(i32),
    /// From this frame on the rows are of another tool.
    ToolFrom(usize),
}

impl Reading {
    /// Returns the reading that no data can tell from this one: the other mount, the poses inverted.
    pub fn twin(&self) -> Self {
        let mounting = match self.mounting {
            Mounting::RigOnFlange => Mounting::RigInBase,
            Mounting::RigInBase => Mounting::RigOnFlange,
        };
        let direction = match self.convention.direction {
            PoseDirection::BaseFromFlange => PoseDirection::FlangeFromBase,
            PoseDirection::FlangeFromBase => PoseDirection::BaseFromFlange,
        };
        Self { mounting, convention: PoseConvention { direction, ..self.convention }, ..*self }
    }

    /// Tells whether two readings mean the same poses and mount, or are twins.
    pub fn is_alike(&self, other: &Self) -> bool {
        let is_same = |other: &Self| {
            let angle = |reading: &Self| match reading.convention.rotation.has_angles() {
                true => reading.convention.angle,
                false => AngleUnit::Radians,
            };
            self.mounting == other.mounting
                && self.change == other.change
                && angle(self) == angle(other)
                && PoseConvention { angle: AngleUnit::Radians, ..self.convention }
                    == PoseConvention { angle: AngleUnit::Radians, ..other.convention }
        };
        is_same(other) || is_same(&other.twin())
    }
}

/// Tries all readings of the rows, one for each frame, and returns them with the best first, by a closed form.
///
/// Of two twins the one is listed whose shorter offset is on the flange. `points_in_target` are where misfits
/// are measured. Readings by which no row is a pose, or that determine nothing, are not listed.
pub fn readings(
    rows: &[&PoseRow],
    rig_from_target: &[Pose],
    points_in_target: &[Vector3<f64>],
    method: Method,
) -> Vec<Reading> {
    let Some(first) = rows.first() else { return Vec::new() };
    let case = Case { rig_from_target, points_in_target, method };
    let mut found = Vec::new();
    for rotation in RotationKind::all_of(first.rotation.len()) {
        let angles: &[AngleUnit] = if rotation.has_angles() {
            &[AngleUnit::Radians, AngleUnit::Degrees]
        } else {
            &[AngleUnit::Radians]
        };
        for &angle in angles {
            for length in [LengthUnit::Metres, LengthUnit::Millimetres] {
                let plain = PoseConvention { angle, length, ..PoseConvention::plain(rotation) };
                let poses: Option<Vec<Pose>> = rows.iter().map(|row| plain.base_from_flange(row)).collect();
                let Some(poses) = poses else { continue };
                for mounting in [Mounting::RigOnFlange, Mounting::RigInBase] {
                    found.extend(case.reading(plain, mounting, &poses));
                }
            }
        }
    }
    sort(&mut found);
    let Some(best) = found.first().copied() else { return found };
    let mut distances: Vec<f64> = rig_from_target.iter().map(|pose| pose.translation.norm()).collect();
    distances.sort_by(f64::total_cmp);
    if best.held_out_m < GOOD_SHARE * distances[distances.len() / 2] {
        return found;
    }
    // Nothing fits: wrong rows hide the right convention, so all are tried again with either half of the frames,
    // which a change of tools leaves whole, and with rows that are one off.
    let literal = |reading: &Reading| {
        let convention = PoseConvention { direction: PoseDirection::BaseFromFlange, ..reading.convention };
        let is_twin = reading.convention.direction != PoseDirection::BaseFromFlange;
        let mounting = if is_twin { reading.twin().mounting } else { reading.mounting };
        let poses: Vec<Pose> = rows.iter().filter_map(|row| convention.base_from_flange(row)).collect();
        (convention, mounting, poses)
    };
    let mut changed = Vec::new();
    let mut by_half: Vec<(f64, Reading)> = Vec::new();
    for reading in &found {
        let (convention, mounting, poses) = literal(reading);
        changed.extend([1, -1].into_iter().filter_map(|by| case.shifted(convention, mounting, &poses, by)));
        let half = poses.len() / 2;
        let squares = [0..half, half..poses.len()].into_iter().filter_map(|range| {
            let n = range.len() as f64;
            let pairs = case.pairs(mounting, &poses, range);
            (pairs.len() >= LEAST_ON_A_SIDE)
                .then(|| case.held_out(&pairs, 4))
                .flatten()
                .map(|(square, _)| square / n)
        });
        by_half.push((squares.fold(f64::INFINITY, f64::min), *reading));
    }
    by_half.sort_by(|one, other| one.0.total_cmp(&other.0));
    for (_, reading) in by_half.iter().take(TRIED_WITH_TOOLS) {
        let (convention, mounting, poses) = literal(reading);
        changed.extend(case.with_two_tools(convention, mounting, &poses));
    }
    changed.retain(|changed| changed.held_out_m * BETTER_BY_CHANGE < best.held_out_m);
    found.append(&mut changed);
    sort(&mut found);
    found
}

fn sort(readings: &mut [Reading]) {
    readings.sort_by(|one, other| {
        one.held_out_m.total_cmp(&other.held_out_m).then(one.convention.cmp(&other.convention))
    });
}

struct Case<'a> {
    rig_from_target: &'a [Pose],
    points_in_target: &'a [Vector3<f64>],
    method: Method,
}

impl Case<'_> {
    fn pairs(&self, mounting: Mounting, poses: &[Pose], range: std::ops::Range<usize>) -> Vec<PosePair> {
        let both = poses[range.clone()].iter().zip(&self.rig_from_target[range]);
        both.map(|(pose, seen)| pose_pair(mounting, pose, seen)).collect()
    }

    fn reading(&self, convention: PoseConvention, mounting: Mounting, poses: &[Pose]) -> Option<Reading> {
        let pairs = self.pairs(mounting, poses, 0..poses.len());
        let (square, found) = self.held_out(&pairs, FOLDS)?;
        let held_out_m = (square / pairs.len() as f64).sqrt();
        let reading = Reading { convention, mounting, change: RowChange::None, held_out_m };
        Some(self.likelier_twin(reading, &found))
    }

    /// Returns the sum over frames of the squared misfits when they are left out, and the solution of all.
    fn held_out(&self, pairs: &[PosePair], folds: usize) -> Option<(f64, HandEye)> {
        let mut square = 0.0;
        for fold in 0..folds.min(pairs.len()) {
            let in_fold = |(i, pair): (usize, &PosePair)| (i % folds == fold).then_some(*pair);
            let out: Vec<PosePair> = pairs.iter().enumerate().filter_map(in_fold).collect();
            let others: Vec<PosePair> =
                pairs.iter().enumerate().filter(|(i, _)| i % folds != fold).map(|(_, pair)| *pair).collect();
            let found = hand_eye(&others, self.method)?;
            square +=
                out.iter().map(|pair| found.distance_m(pair, self.points_in_target).powi(2)).sum::<f64>();
        }
        Some((square, hand_eye(pairs, self.method)?))
    }

    /// Tries rows that belong to the frame `by` places later.
    fn shifted(
        &self,
        convention: PoseConvention,
        mounting: Mounting,
        poses: &[Pose],
        by: i32,
    ) -> Option<Reading> {
        let kept = poses.len().checked_sub(1)?;
        let (rows, seen) = if by > 0 { (0, 1) } else { (1, 0) };
        let both = poses[rows..rows + kept].iter().zip(&self.rig_from_target[seen..seen + kept]);
        let pairs: Vec<PosePair> = both.map(|(pose, seen)| pose_pair(mounting, pose, seen)).collect();
        let (square, found) = self.held_out(&pairs, FOLDS)?;
        let held_out_m = (square / kept as f64).sqrt();
        let change = RowChange::Shifted(by.signum());
        Some(self.likelier_twin(Reading { convention, mounting, change, held_out_m }, &found))
    }

    /// Tries every frame as the first with another tool.
    fn with_two_tools(
        &self,
        convention: PoseConvention,
        mounting: Mounting,
        poses: &[Pose],
    ) -> Option<Reading> {
        let n = poses.len();
        let mut best: Option<(f64, usize, HandEye)> = None;
        for split in LEAST_ON_A_SIDE..=n.saturating_sub(LEAST_ON_A_SIDE) {
            let sides = [self.pairs(mounting, poses, 0..split), self.pairs(mounting, poses, split..n)];
            // Each frame of a short side is left out by itself.
            let [Some((first, found)), Some((second, _))] =
                sides.map(|side| self.held_out(&side, side.len().min(8)))
            else {
                continue;
            };
            if best.as_ref().is_none_or(|(square, ..)| first + second < *square) {
                best = Some((first + second, split, found));
            }
        }
        let (square, split, found) = best?;
        let held_out_m = (square / n as f64).sqrt();
        Some(self.likelier_twin(
            Reading { convention, mounting, change: RowChange::ToolFrom(split), held_out_m },
            &found,
        ))
    }

    /// Returns the reading or its twin: what is on the flange is nearer to it than what is in the base is to that.
    fn likelier_twin(&self, reading: Reading, found: &HandEye) -> Reading {
        let distance = |pose: &Pose| match self.method {
            // The height, along z, is open.
            Method::FourAxis => pose.translation.xy().norm(),
            _ => pose.translation.norm(),
        };
        let (rig, target) = (distance(&found.carrier_from_rig), distance(&found.other_from_target));
        let is_likely = match reading.mounting {
            Mounting::RigOnFlange => rig <= target,
            Mounting::RigInBase => target <= rig,
        };
        if is_likely { reading } else { reading.twin() }
    }
}
