//! Kalibr's grids of AprilTags with small black squares between them.
//!
//! The corners of tags and small squares are those of a chessboard with two widths of squares, so they are found as
//! such. The tags are read in the cells, with a border of two modules or of one, and say which corner is which.

use boresight_data::{Geometry, GrayImage, Target};

use crate::charuco::{
    ENOUGH_SHARE, FEWEST_FOUND, MARKER_CONTRAST_SHARE, cells, has_place, labelled, mean_contrast,
};
use crate::chessboard::{CONTRAST_SHARE, Planes, at_full_size};
use crate::detection::{Detection, Missed};
use crate::fit::Hole;
use crate::labelled::{Drawing, complete, is_confirmed};
use crate::lattice::{Lattice, find_lattices};
use crate::marker::{MarkerCell, read_marker};
use crate::saddles::find_saddles;
use crate::votes::{Reading, Vote, count, spans_rows};

/// The fewest corners of a lattice that is looked at: those of a tag.
const FEWEST: usize = 4;
/// How far aside of an edge it is black, as a share of its length: half the border of a tag, with room.
const ASIDE: f64 = 0.06;
/// Widths of the border of a tag in modules. Kalibr prints two unless told otherwise.
const BORDERS: [usize; 2] = [2, 1];
/// The widest grid that is thought of when the tags are not numbered as the target's.
const WIDEST: i32 = 64;

/// Tells whether a target is a grid of AprilTags.
pub(crate) fn handles(geometry: &Geometry) -> bool {
    matches!(geometry, Geometry::AprilGrid { .. })
}

/// Detects the corners of a grid of AprilTags.
pub(crate) fn detect(image: &GrayImage, target: &Target) -> Detection {
    let need = ENOUGH_SHARE * target.point_count() as f64;
    let planes = Planes::of(image);
    let mut best = Detection::missed(Missed::NoBoard);
    for level in planes.order() {
        let found = detect_at(image, &planes, level, target);
        if found.is_better_than(&best) {
            best = found;
        }
        // What tags contradict at one scale must not be believed at another.
        if best.observations.len() as f64 >= need || best.missed.is_some_and(|missed| missed.is_certain()) {
            break;
        }
    }
    best
}

fn detect_at(image: &GrayImage, planes: &Planes, level: usize, target: &Target) -> Detection {
    let Geometry::AprilGrid { columns, rows, spacing, dictionary, .. } = target.geometry else {
        return Detection::missed(Missed::NoBoard);
    };
    let [columns, rows] = [columns, rows].map(|n| i32::try_from(n).unwrap_or(i32::MAX));
    let scale = f64::from(1u32 << level);
    let smooth = planes.at(image, level).smoothed();
    let [low, high] = smooth.range();
    let least_contrast = CONTRAST_SHARE * f64::from(high - low).max(1.0);
    let saddles = find_saddles(&smooth, least_contrast);
    let lattices: Vec<Lattice> = find_lattices(&saddles, &smooth, ASIDE)
        .iter()
        .take_while(|lattice| lattice.corners.len() >= FEWEST)
        .map(|lattice| at_full_size(lattice, scale))
        .collect();
    let Some(largest) = lattices.first() else { return Detection::missed(Missed::NoBoard) };
    let read = |lattice: &Lattice, border: usize| -> Vec<Reading> {
        let cell = MarkerCell { inset: 0.0, border, white_at: -0.5 * spacing };
        let least_contrast = MARKER_CONTRAST_SHARE * mean_contrast(std::iter::once(lattice));
        let marker = |corners| read_marker(image, corners, &cell, dictionary, least_contrast);
        cells(lattice, false)
            .filter_map(|(cell, corners)| Some(Reading { cell, marker: marker(corners)? }))
            .collect()
    };
    let mut best: Option<(usize, usize, Vec<Option<Vote>>)> = None;
    let mut other = None;
    for border in BORDERS {
        let readings: Vec<Vec<Reading>> = lattices.iter().map(|lattice| read(lattice, border)).collect();
        let has_tag = |id: u32| i32::try_from(id).is_ok_and(|id| id < columns.saturating_mul(rows));
        let corner_of = |id: u32| has_tag(id).then(|| first_corner(id, columns));
        let vote = |readings: &Vec<Reading>| {
            let vote = count(readings, corner_of, lying).filter(Vote::is_sure)?;
            has_place(&vote, [2 * columns, 2 * rows]).then_some(vote)
        };
        let votes: Vec<Option<Vote>> = readings.iter().map(vote).collect();
        let n = votes.iter().flatten().map(|vote| vote.cells.len()).sum();
        if n > best.as_ref().map_or(0, |(n, ..)| *n) {
            best = Some((n, border, votes));
        }
        other = other.or_else(|| other_size(&readings, [columns, rows]));
    }
    let Some((_, border, votes)) = best else {
        let corners = largest.corners.len();
        let nothing = if corners < 4 * FEWEST { Missed::NoBoard } else { Missed::NoMarkers { corners } };
        return Detection::missed(other.unwrap_or(nothing));
    };
    if let Some(other) = other {
        return Detection::missed(other);
    }
    let seen = labelled(lattices.iter().zip(&votes));
    let contrast = mean_contrast(
        lattices.iter().zip(&votes).filter_map(|(lattice, vote)| vote.as_ref().map(|_| lattice)),
    );
    let pitch = 1.0 + spacing;
    let along = |n: i32| {
        (-1..=2 * n).map(|k| f64::from(k.div_euclid(2)) + f64::from(k.rem_euclid(2)) / pitch).collect()
    };
    let modules = (dictionary.bits_across() + 2 * border) as f64;
    let drawing = Drawing {
        size: [2 * columns, 2 * rows],
        at: [along(columns), along(rows)],
        window_step: spacing / pitch,
        is_bright: false,
        hole: Some(Hole { is_bright: false, from: border as f64 / modules / spacing }),
        near: 3,
    };
    let Some(observations) = complete(image, &drawing, &seen, contrast) else {
        return Detection::missed(Missed::Contradiction { corners: seen.len() });
    };
    if observations.len() < FEWEST_FOUND {
        return Detection::missed(Missed::NoBoard);
    }
    let cell = MarkerCell { inset: 0.0, border, white_at: -0.5 * spacing };
    let least_contrast = MARKER_CONTRAST_SHARE * contrast;
    let is_right = |at: [i32; 2], [a, b, c, d]: [[f64; 2]; 4]| {
        // Seen from the front, y is upwards.
        let marker = read_marker(image, [d, c, b, a], &cell, dictionary, least_contrast)?;
        Some(marker.turn == 2 && first_corner(marker.id, columns) == at)
    };
    let is_tag = |[column, row]: [i32; 2]| column % 2 == 0 && row % 2 == 0;
    if !is_confirmed(&drawing, &observations, is_tag, is_right) {
        return Detection::missed(Missed::Contradiction { corners: observations.len() });
    }
    // Tags of one row alone are numbered alike on grids of any width.
    let shows_size = spans_rows(votes.iter().flatten());
    Detection { observations, missed: None, pattern: None, shows_size }
}

/// Returns column and row of the first corner of a tag.
fn first_corner(id: u32, columns: i32) -> [i32; 2] {
    let id = i32::try_from(id).unwrap_or(i32::MAX);
    [2 * (id % columns), 2 * (id / columns)]
}

/// Returns the directions of the grid's axes where a tag lies turned so often.
///
/// On Kalibr's grids tags lie upside down, as their families are drawn, and y is upwards.
fn lying(turn: usize) -> [usize; 2] {
    [(turn + 2) % 4, (turn + 1) % 4]
}

/// Says how the tags are numbered, if not as on a grid of this size.
fn other_size(readings: &[Vec<Reading>], [columns, rows]: [i32; 2]) -> Option<Missed> {
    let readings = readings.iter().max_by_key(|readings| readings.len())?;
    let of_width =
        |width: i32| count(readings, |id| Some(first_corner(id, width)), lying).filter(Vote::is_sure);
    let votes = |vote: &Option<Vote>| vote.as_ref().map_or(0, |vote| vote.cells.len());
    let declared = of_width(columns);
    let highest = |width: i32| {
        // A misread id must not make the grid higher.
        let mut in_rows: Vec<i32> = readings.iter().map(|reading| reading.marker.id as i32 / width).collect();
        in_rows.sort_unstable();
        in_rows.get(in_rows.len().saturating_sub(2)).map_or(0, |row| row + 1)
    };
    if 2 * votes(&declared) > readings.len() {
        let n_rows = highest(columns);
        let is_other = n_rows > rows;
        return is_other.then_some(Missed::OtherTags { columns: columns as u32, rows: n_rows as u32 });
    }
    let best = (1..=WIDEST).map(|width| (votes(&of_width(width)), -width)).max()?;
    let (n_votes, width) = (best.0, -best.1);
    (n_votes >= 4 && 2 * n_votes > readings.len())
        .then(|| Missed::OtherTags { columns: width as u32, rows: highest(width) as u32 })
}
