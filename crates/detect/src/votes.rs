//! Which corner of a board each corner of a lattice is, as the markers in its cells say.

use std::collections::{BTreeMap, BTreeSet};

use crate::grid::SIDES;
use crate::marker::Marker;

/// Markers that are believed have been read by chance at most this often.
const MOST_CHANCE: f64 = 1e-5;

/// A marker that was read in the cell from a corner of a lattice to its neighbour along both axes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Reading {
    pub cell: [i32; 2],
    pub marker: Marker,
}

/// How lattice coordinates become columns and rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Labelling {
    /// The directions of the board's x and y among [`SIDES`].
    pub sides: [usize; 2],
    /// Column and row of the lattice's (0, 0).
    pub shift: [i32; 2],
}

impl Labelling {
    /// Returns column and row of the corner at `at`.
    pub fn label(&self, at: [i32; 2]) -> [i32; 2] {
        [0, 1].map(|axis| along(at, self.sides[axis]) + self.shift[axis])
    }
}

fn along(at: [i32; 2], side: usize) -> i32 {
    at[0] * SIDES[side][0] + at[1] * SIDES[side][1]
}

/// What markers say of a lattice.
#[derive(Clone, Debug)]
pub(crate) struct Vote {
    pub labelling: Labelling,
    /// The cells whose markers say so, and how many markers say something else.
    pub cells: Vec<[i32; 2]>,
    pub against: usize,
    /// How likely it is that chance alone says so.
    pub chance: f64,
}

impl Vote {
    /// Tells whether it is beyond doubt.
    pub fn is_sure(&self) -> bool {
        self.chance < MOST_CHANCE && self.cells.len() > 2 * self.against
    }

    /// Returns the corners of the cells whose markers agree: those of the board, whatever else is in the lattice.
    pub fn corners(&self) -> BTreeSet<[i32; 2]> {
        let around = |[i, j]: &[i32; 2]| [[*i, *j], [i + 1, *j], [*i, j + 1], [i + 1, j + 1]];
        self.cells.iter().flat_map(around).collect()
    }
}

/// Returns the labelling that most markers agree on.
///
/// `corner_of` gives column and row of the first corner of the cell of a marker, or `None` if the board does not have it;
/// `sides_of` the directions of the board's axes for a marker that lies turned so often.
pub(crate) fn count(
    readings: &[Reading],
    corner_of: impl Fn(u32) -> Option<[i32; 2]>,
    sides_of: impl Fn(usize) -> [usize; 2],
) -> Option<Vote> {
    let mut found: BTreeMap<Labelling, (Vec<[i32; 2]>, f64)> = BTreeMap::new();
    for Reading { cell, marker } in readings {
        let Some(corner) = corner_of(marker.id) else { continue };
        let sides = sides_of(marker.turn);
        let shift = [0, 1].map(|axis| {
            // The first corner of the cell in the board's sense.
            let other = [cell[0] + 1, cell[1] + 1];
            corner[axis] - along(*cell, sides[axis]).min(along(other, sides[axis]))
        });
        let (cells, chance) = found.entry(Labelling { sides, shift }).or_insert((Vec::new(), 1.0));
        *chance *= if cells.is_empty() { marker.chance_of_any } else { marker.chance_of_this };
        cells.push(*cell);
    }
    let best = found.into_iter().min_by(|a, b| (a.1.1).total_cmp(&b.1.1).then(a.0.cmp(&b.0)))?;
    let (labelling, (cells, chance)) = best;
    let against = readings.len() - cells.len();
    Some(Vote { labelling, cells, against, chance })
}

/// Tells whether the markers that agree are in more than one row of the board, so that they tell its width.
pub(crate) fn spans_rows<'a>(votes: impl Iterator<Item = &'a Vote>) -> bool {
    let rows: BTreeSet<i32> = votes
        .flat_map(|vote| {
            vote.cells.iter().map(|cell| {
                let other = [cell[0] + 1, cell[1] + 1];
                vote.labelling.label(*cell)[1].min(vote.labelling.label(other)[1])
            })
        })
        .collect();
    rows.len() > 1
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reading(cell: [i32; 2], id: u32, turn: usize) -> Reading {
        Reading { cell, marker: Marker { id, turn, chance_of_any: 0.06, chance_of_this: 1.5e-5 } }
    }

    #[test]
    fn markers_outvote_a_misread_one() {
        // Ten cells in a row, read upside down: id 13 is three columns and one row from id 0.
        let corner_of = |id: u32| Some([(id % 10) as i32, (id / 10) as i32]);
        let sides_of = |turn: usize| [turn, (turn + 1) % 4];
        let readings = [
            reading([0, 0], 13, 2),
            reading([1, 0], 12, 2),
            reading([0, 1], 3, 2),
            reading([1, 1], 2, 2),
            reading([2, 1], 77, 0),
        ];
        let vote = count(&readings, corner_of, sides_of).unwrap();
        assert_eq!((vote.cells.len(), vote.against, vote.is_sure()), (4, 1, true));
        // The cell's corner that comes first on the board is its last in the lattice.
        assert_eq!(vote.labelling.label([1, 1]), [3, 1]);
        assert_eq!(vote.labelling.label([0, 0]), [4, 2]);
        assert_eq!(vote.labelling.label([2, 2]), [2, 0]);
        // The cell that says something else is none of the board's.
        assert_eq!(vote.corners().into_iter().map(|[i, _]| i).max(), Some(2));
        // One marker of so large a dictionary may be chance; two that contradict each other settle nothing.
        assert!(!count(&readings[..1], corner_of, sides_of).unwrap().is_sure());
        assert!(!count(&[readings[0], readings[4]], corner_of, sides_of).unwrap().is_sure());
        assert!(count(&readings, |_| None, sides_of).is_none());
    }
}
