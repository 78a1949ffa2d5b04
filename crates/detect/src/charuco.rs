//! ChArUco boards: chessboards whose white squares hold markers.
//!
//! The corners are found as those of a chessboard. Then the cells between them are read, and the markers say which
//! corner is which: any part of the board is enough that shows markers. Which of the two patterns the board has is told
//! by its markers, and so is a board of another width.

use std::collections::BTreeMap;

use boresight_data::{Dictionary, Geometry, GrayImage, Target};

use crate::chessboard::{CONTRAST_SHARE, Planes, at_full_size};
use crate::detection::{Detection, Missed, Pattern};
use crate::fit::Hole;
use crate::labelled::{Drawing, complete, is_confirmed};
use crate::lattice::{Lattice, distance, find_lattices};
use crate::marker::{MarkerCell, read_marker};
use crate::saddles::find_saddles;
use crate::votes::{Reading, Vote, count, spans_rows};

/// The fewest corners of a lattice that is looked at.
const FEWEST: usize = 4;
/// The fewest corners of a board that are believed.
pub(crate) const FEWEST_FOUND: usize = 6;
/// The contrast of a marker may be this share of that of the corners around it.
pub(crate) const MARKER_CONTRAST_SHARE: f64 = 0.3;
/// The widest board that is thought of when the markers are not those of the target.
const WIDEST: i32 = 64;
/// When this share of the points is found, no other scale of the image is looked at.
pub(crate) const ENOUGH_SHARE: f64 = 0.6;

/// Tells whether a target is a ChArUco board.
pub(crate) fn handles(geometry: &Geometry) -> bool {
    matches!(geometry, Geometry::Charuco { .. })
}

/// The board in squares.
struct Board {
    columns: i32,
    rows: i32,
    cell: MarkerCell,
    dictionary: Dictionary,
}

/// A lattice with what was read in its cells.
struct ReadLattice {
    lattice: Lattice,
    readings: Vec<Reading>,
}

/// Detects the corners of a ChArUco board.
pub(crate) fn detect(image: &GrayImage, target: &Target) -> Detection {
    let Geometry::Charuco { columns, rows, spacing_m, marker_m, dictionary } = target.geometry else {
        return Detection::missed(Missed::NoBoard);
    };
    let [columns, rows] = [columns, rows].map(|n| i32::try_from(n).unwrap_or(i32::MAX));
    let inset = 0.5 * (1.0 - marker_m / spacing_m);
    let cell = MarkerCell { inset, border: 1, white_at: 0.5 * inset };
    let board = Board { columns, rows, cell, dictionary };
    let need = ENOUGH_SHARE * target.point_count() as f64;
    let planes = Planes::of(image);
    let mut best = Detection::missed(Missed::NoBoard);
    for level in planes.order() {
        let found = detect_at(image, &planes, level, &board);
        if found.is_better_than(&best) {
            best = found;
        }
        // What markers contradict at one scale must not be believed at another.
        if best.observations.len() as f64 >= need || best.missed.is_some_and(|missed| missed.is_certain()) {
            break;
        }
    }
    best
}

fn detect_at(image: &GrayImage, planes: &Planes, level: usize, board: &Board) -> Detection {
    let scale = f64::from(1u32 << level);
    let smooth = planes.at(image, level).smoothed();
    let [low, high] = smooth.range();
    let least_contrast = CONTRAST_SHARE * f64::from(high - low).max(1.0);
    let saddles = find_saddles(&smooth, least_contrast);
    let lattices: Vec<ReadLattice> = find_lattices(&saddles, &smooth, 0.5 * board.cell.inset)
        .iter()
        .take_while(|lattice| lattice.corners.len() >= FEWEST)
        .map(|lattice| at_full_size(lattice, scale))
        .map(|lattice| ReadLattice { readings: read_all(image, &lattice, board, board.dictionary), lattice })
        .collect();
    let both = [Pattern::Current, Pattern::Legacy].map(|pattern| (pattern, votes(&lattices, board, pattern)));
    let sum = |votes: &[Option<Vote>]| votes.iter().flatten().map(|vote| vote.cells.len()).sum::<usize>();
    let [n_current, n_legacy] = both.each_ref().map(|(_, votes)| sum(votes));
    if n_current.max(n_legacy) == 0 {
        return Detection::missed(other_board(image, &lattices, board));
    }
    if n_current == n_legacy {
        let corners = lattices.iter().map(|lattice| lattice.lattice.corners.len()).sum();
        return Detection::missed(Missed::Ambiguous { corners });
    }
    let [current, legacy] = both;
    let (pattern, votes) = if n_current > n_legacy { current } else { legacy };
    if let Some(missed) = too_far(&lattices, &votes, board, pattern) {
        return Detection::missed(missed);
    }
    let contrast = mean_contrast(
        lattices.iter().zip(&votes).filter_map(|(read, vote)| vote.as_ref().map(|_| &read.lattice)),
    );
    let seen = labelled(lattices.iter().map(|lattice| &lattice.lattice).zip(&votes));
    let drawing = Drawing {
        size: [board.columns - 1, board.rows - 1],
        at: [board.columns, board.rows].map(|n| (-1..n).map(f64::from).collect()),
        window_step: 1.0,
        // Right below the first corner is a square of the colour of the first.
        is_bright: pattern.first_is_white(),
        hole: Some(Hole { is_bright: true, from: board.cell.inset }),
        near: 2,
    };
    let Some(observations) = complete(image, &drawing, &seen, contrast) else {
        return Detection::missed(Missed::Contradiction { corners: seen.len() });
    };
    if observations.len() < FEWEST_FOUND {
        return Detection::missed(Missed::NoBoard);
    }
    let least_contrast = MARKER_CONTRAST_SHARE * contrast;
    let is_right = |[column, row]: [i32; 2], corners: [[f64; 2]; 4]| {
        let marker = read_marker(image, corners, &board.cell, board.dictionary, least_contrast)?;
        let square = square_of(marker.id, board.columns, pattern);
        Some(marker.turn == 0 && square == [column + 1, row + 1])
    };
    let is_white = |[column, row]: [i32; 2]| ((column + row) % 2 == 0) == pattern.first_is_white();
    if !is_confirmed(&drawing, &observations, is_white, is_right) {
        return Detection::missed(Missed::Contradiction { corners: observations.len() });
    }
    // Markers of one row alone are numbered alike on boards of many widths.
    let shows_size = spans_rows(votes.iter().flatten());
    Detection { observations, missed: None, pattern: Some(pattern), shows_size }
}

/// Returns the labelled corners of lattices; where two claim the same label elsewhere, nobody gets it.
pub(crate) fn labelled<'a>(
    lattices: impl Iterator<Item = (&'a Lattice, &'a Option<Vote>)>,
) -> BTreeMap<[i32; 2], [f64; 2]> {
    let mut seen: BTreeMap<[i32; 2], Option<[f64; 2]>> = BTreeMap::new();
    for (lattice, vote) in lattices {
        let Some(vote) = vote else { continue };
        // What else is joined to them may be corners of markers. Where there are more of the board, they are found from these.
        let believed = vote.corners();
        for (at, corner) in lattice.corners.iter().filter(|(at, _)| believed.contains(*at)) {
            let place = seen.entry(vote.labelling.label(*at)).or_insert(Some(corner.pixel));
            if place.is_some_and(|pixel| distance(pixel, corner.pixel) > 2.0) {
                *place = None;
            }
        }
    }
    seen.into_iter().filter_map(|(at, pixel)| Some((at, pixel?))).collect()
}

/// Returns the mean contrast of the corners of some lattices, zero without any.
pub(crate) fn mean_contrast<'a>(lattices: impl Iterator<Item = &'a Lattice>) -> f64 {
    let contrasts = lattices.flat_map(|lattice| lattice.corners.values().map(|corner| corner.contrast));
    let (sum, n) = contrasts.fold((0.0, 0.0), |(sum, n), contrast| (sum + contrast, n + 1.0));
    sum / f64::max(n, 1.0)
}

/// Reads the markers of a dictionary in the bright cells of a lattice.
fn read_all(image: &GrayImage, lattice: &Lattice, board: &Board, dictionary: Dictionary) -> Vec<Reading> {
    let least_contrast = MARKER_CONTRAST_SHARE * mean_contrast(std::iter::once(lattice));
    cells(lattice, true)
        .filter_map(|(cell, corners)| {
            let marker = read_marker(image, corners, &board.cell, dictionary, least_contrast)?;
            Some(Reading { cell, marker })
        })
        .collect()
}

/// Returns the cells of a lattice that are bright, or dark, with their corners in the order of [`read_marker`].
pub(crate) fn cells(lattice: &Lattice, bright: bool) -> impl Iterator<Item = ([i32; 2], [[f64; 2]; 4])> {
    lattice.corners.keys().filter_map(move |&at| {
        let is_bright = lattice.is_bright == ((at[0] + at[1]).rem_euclid(2) == 0);
        let pixel = |i: i32, j: i32| lattice.corners.get(&[at[0] + i, at[1] + j]).map(|corner| corner.pixel);
        let corners = [pixel(0, 0)?, pixel(1, 0)?, pixel(1, 1)?, pixel(0, 1)?];
        (is_bright == bright).then_some((at, corners))
    })
}

/// Returns what is sure of each lattice if the board has this pattern.
fn votes(lattices: &[ReadLattice], board: &Board, pattern: Pattern) -> Vec<Option<Vote>> {
    // Boards with an odd number of rows are the same in both.
    if pattern == Pattern::Legacy && board.rows % 2 == 1 {
        return vec![None; lattices.len()];
    }
    let vote = |lattice: &ReadLattice| {
        let corner_of = |id| {
            let square = square_of(id, board.columns, pattern);
            Some([square[0] - 1, square[1] - 1])
        };
        let size = [board.columns - 1, board.rows - 1];
        let vote = count(&lattice.readings, corner_of, upright).filter(Vote::is_sure)?;
        // A board one of whose columns is missing on one side and too many on the other is of the other pattern.
        has_place(&vote, size).then_some(vote)
    };
    lattices.iter().map(vote).collect()
}

/// Tells whether a board of so many corners has a place for those around the markers that agree.
///
/// It has none if a row that would be its last goes on as a row of which half is there, or a third is beyond its ends.
pub(crate) fn has_place(vote: &Vote, size: [i32; 2]) -> bool {
    let labels: Vec<[i32; 2]> = vote.corners().into_iter().map(|at| vote.labelling.label(at)).collect();
    let is_on = |label: &&[i32; 2]| (0..2).all(|axis| (0..size[axis]).contains(&label[axis]));
    let n_on = labels.iter().filter(is_on).count();
    let goes_on = |axis: usize, last: i32, beyond: i32| {
        let of = |line: i32| labels.iter().filter(|label| label[axis] == line).count();
        of(beyond) >= 2 && 2 * of(beyond) >= of(last)
    };
    let any_goes_on = (0..2).any(|axis| goes_on(axis, 0, -1) || goes_on(axis, size[axis] - 1, size[axis]));
    3 * n_on >= 2 * labels.len() && !any_goes_on
}

/// Returns the directions of the board's axes where a marker that is upright on the board lies turned so often.
fn upright(turn: usize) -> [usize; 2] {
    [turn, (turn + 1) % 4]
}

/// Returns the square of a marker on a board of so many columns: ids go through the white squares, row by row.
fn square_of(id: u32, columns: i32, pattern: Pattern) -> [i32; 2] {
    let id = i32::try_from(id).unwrap_or(i32::MAX);
    let first = i32::from(!pattern.first_is_white());
    // White squares in rows 0, 2, 4, ...
    let in_even = (columns + 1 - first) / 2;
    let (pair, rest) = (id / columns, id % columns);
    if rest < in_even {
        [2 * rest + first, 2 * pair]
    } else {
        [2 * (rest - in_even) + 1 - first, 2 * pair + 1]
    }
}

/// Says what is seen where corners or markers are beyond the target, which is then not the board.
fn too_far(
    lattices: &[ReadLattice],
    votes: &[Option<Vote>],
    board: &Board,
    pattern: Pattern,
) -> Option<Missed> {
    let (mut n, mut beyond) = (0, 0);
    let mut most = [0, 0];
    for (lattice, vote) in lattices.iter().zip(votes) {
        let Some(vote) = vote else { continue };
        for reading in &lattice.readings {
            let square = square_of(reading.marker.id, board.columns, pattern);
            let label = vote.labelling.label(reading.cell);
            // Only markers that agree with the others count.
            if (0..2).any(|axis| (label[axis] + 1 - square[axis]).abs() > 1) {
                continue;
            }
            n += 1;
            // A marker between four corners has a row of squares below it.
            beyond += usize::from(square[1] + 1 >= board.rows);
            most = [0, 1].map(|axis| most[axis].max(square[axis] + 2));
        }
    }
    let is_other = beyond >= 2 && 10 * beyond >= n;
    is_other.then_some(Missed::OtherSquares { columns: board.columns as u32, rows: most[1] as u32 })
}

/// Says which board the markers are of, if they are not the target's.
fn other_board(image: &GrayImage, lattices: &[ReadLattice], board: &Board) -> Missed {
    let corners = lattices.iter().map(|lattice| lattice.lattice.corners.len()).max().unwrap_or(0);
    if corners < 2 * FEWEST {
        return Missed::NoBoard;
    }
    if let Some((pattern, [columns, rows])) = numbered(lattices, board.columns) {
        // Boards with an odd number of rows have no legacy pattern; those that have it end with an even row.
        let is_of_even = pattern == Pattern::Legacy && board.rows % 2 == 1;
        let rows = if is_of_even { rows + rows % 2 } else { rows };
        let is_other = columns != board.columns || rows > board.rows || is_of_even;
        return match is_other {
            true => Missed::OtherSquares { columns: columns as u32, rows: rows as u32 },
            false => Missed::Contradiction { corners },
        };
    }
    // Of dictionaries that begin alike, the smallest that holds all ids comes first.
    for dictionary in Dictionary::all().filter(|dictionary| *dictionary != board.dictionary) {
        let read = |lattice: &ReadLattice| ReadLattice {
            lattice: lattice.lattice.clone(),
            readings: read_all(image, &lattice.lattice, board, dictionary),
        };
        let read: Vec<ReadLattice> = lattices.iter().map(read).collect();
        if numbered(&read, board.columns).is_some() {
            return Missed::OtherDictionary(dictionary);
        }
    }
    Missed::NoMarkers { corners }
}

/// Returns the width of board on which the markers of the largest lattice agree, the declared one before others, how many
/// rows of it are seen, and its pattern.
fn numbered(lattices: &[ReadLattice], declared: i32) -> Option<(Pattern, [i32; 2])> {
    let largest = lattices.iter().max_by_key(|lattice| lattice.readings.len())?;
    let mut best: Option<(usize, i32, Pattern)> = None;
    for width in std::iter::once(declared).chain((2..=WIDEST).filter(|width| *width != declared)) {
        for pattern in [Pattern::Current, Pattern::Legacy] {
            let corner_of = |id| {
                let square = square_of(id, width, pattern);
                Some([square[0] - 1, square[1] - 1])
            };
            let vote = count(&largest.readings, corner_of, upright);
            let votes = vote.filter(Vote::is_sure).map_or(0, |vote| vote.cells.len());
            if votes >= 3 && best.is_none_or(|(most, ..)| votes > most) {
                best = Some((votes, width, pattern));
            }
        }
    }
    let (_, columns, pattern) = best?;
    let row = |reading: &Reading| square_of(reading.marker.id, columns, pattern)[1];
    // A marker between four corners has a row of squares below it.
    Some((pattern, [columns, largest.readings.iter().map(row).max()? + 2]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_go_through_the_white_squares() {
        for columns in [4, 5, 9, 14] {
            for pattern in [Pattern::Current, Pattern::Legacy] {
                let mut id = 0;
                for row in 0..8 {
                    for column in 0..columns {
                        if ((row + column) % 2 == 0) == pattern.first_is_white() {
                            assert_eq!(
                                square_of(id, columns, pattern),
                                [column, row],
                                "{columns} {pattern:?} {id}"
                            );
                            id += 1;
                        }
                    }
                }
            }
        }
    }
}
