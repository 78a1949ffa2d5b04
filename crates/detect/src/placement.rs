//! Which corner of the board each corner of a grid is, or why that cannot be told.
//!
//! All placements of the grid on the board are tried: four turns, and every shift that fits. What is seen rules them
//! out: the ends of the board (squares, then only white) must be at its rim, what goes on beyond the grid must not be,
//! and where a turn of the board changes its colours, the square below its first corner must be dark. What is left must
//! be one placement, up to turns that the board itself does not tell.

use crate::detection::Missed;
use crate::grid::{Grid, SIDES};
use crate::plane::Plane;

/// What is beyond one side of a grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Side {
    /// The board ends: one more row of squares, then white.
    Ends,
    /// The board goes on.
    GoesOn,
    /// The next row would be outside the image.
    Outside,
    /// The next row would be in the image, and neither corners nor the end of the board are seen there.
    Unclear,
}

/// Where a grid is on the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Placed {
    pub placement: Placement,
    /// Whether the board ends on all four sides, where it should.
    pub is_whole: bool,
}

/// How grid coordinates become columns and rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Placement {
    /// The direction of the board's x among [`SIDES`]; y is the next one.
    pub turn: usize,
    /// Column and row of the grid's (0, 0).
    pub shift: [i32; 2],
}

impl Placement {
    /// Returns column and row of the corner at `at`.
    pub fn label(&self, at: [i32; 2]) -> [i32; 2] {
        let along = |side: [i32; 2]| at[0] * side[0] + at[1] * side[1];
        [along(SIDES[self.turn]) + self.shift[0], along(SIDES[(self.turn + 1) % 4]) + self.shift[1]]
    }
}

/// Returns the placement of a grid on a board of this many columns and rows, or why it has none.
///
/// What the board has more than the grid must be outside the image, or be seen to go on there: a smaller board is not
/// a part of a larger one. `smooth` is the image at 1/`scale` of its size.
pub(crate) fn place(
    grid: &Grid,
    [columns, rows]: [i32; 2],
    smooth: &Plane,
    scale: f64,
) -> Result<Placed, Missed> {
    let [low, high] = grid.bounds();
    let extent = [high[0] - low[0] + 1, high[1] - low[1] + 1];
    let [longer, shorter] = [extent[0].max(extent[1]) as u32, extent[0].min(extent[1]) as u32];
    let corners = grid.corners.len();
    let sides = [0, 1, 2, 3].map(|side| beyond(grid, side, smooth, scale));
    let is_whole = sides.iter().all(|side| *side == Side::Ends);
    let fits = |board: [i32; 2]| extent[0] <= board[0] && extent[1] <= board[1];
    let matches = extent == [columns, rows] || extent == [rows, columns];
    if is_whole && !matches {
        return Err(Missed::OtherSize { columns: longer, rows: shorter });
    }
    if !fits([columns, rows]) && !fits([rows, columns]) {
        return Err(Missed::TooLarge { columns: longer, rows: shorter });
    }
    // Half a turn changes the colours of boards with an odd sum; a quarter turn those of squares with odd sides.
    let colours_tell = (columns + rows) % 2 != 0 || (columns == rows && columns % 2 == 1);
    let Some(&probe) = grid.corners.keys().next() else { return Err(Missed::Contradiction { corners }) };
    let mut possible: Vec<Placement> = Vec::new();
    let (mut is_loose, mut is_short) = (false, false);
    for turn in 0..4 {
        // Bounds of the grid along the board's axes.
        let ends = [turn, (turn + 1) % 4].map(|side| {
            let along = |at: [i32; 2]| at[0] * SIDES[side][0] + at[1] * SIDES[side][1];
            let (a, b) = (along(low), along(high));
            [a.min(b), a.max(b)]
        });
        for shift_x in -ends[0][0]..=columns - 1 - ends[0][1] {
            for shift_y in -ends[1][0]..=rows - 1 - ends[1][1] {
                let placement = Placement { turn, shift: [shift_x, shift_y] };
                // Sides of the board in the order of SIDES, seen from the grid's side `turn`.
                let at_rim = [
                    ends[0][1] + shift_x == columns - 1,
                    ends[1][1] + shift_y == rows - 1,
                    ends[0][0] + shift_x == 0,
                    ends[1][0] + shift_y == 0,
                ];
                // A board that is seen in part is held by one of its ends.
                let is_held = [0, 1].iter().all(|&axis| {
                    let is_end = |k: usize| sides[(turn + k) % 4] == Side::Ends;
                    (at_rim[axis] && at_rim[axis + 2]) || is_end(axis) || is_end(axis + 2)
                });
                let agrees = (0..4).all(|k| match sides[(turn + k) % 4] {
                    Side::Ends => at_rim[k],
                    Side::GoesOn => !at_rim[k],
                    Side::Outside | Side::Unclear => true,
                });
                let lacks_corners = (0..4).any(|k| sides[(turn + k) % 4] == Side::Unclear && !at_rim[k]);
                let [column, row] = placement.label(probe);
                let is_bright = grid.is_bright_square(probe) != (turn % 2 == 1);
                let has_colours = !colours_tell || is_bright == ((column + row) % 2 != 0);
                if agrees && has_colours && lacks_corners {
                    is_short = true;
                } else if agrees && has_colours {
                    is_loose |= !is_held;
                    possible.push(placement);
                }
            }
        }
    }
    // Of turns that the board does not tell apart, the most upright is taken.
    let upright = |placement: &Placement| -> f64 {
        let [du, dv] = mean_step(grid, placement.turn);
        du / du.hypot(dv).max(1e-9)
    };
    let Some(best) = possible.iter().copied().max_by(|a, b| upright(a).total_cmp(&upright(b))) else {
        return Err(match is_short {
            true => Missed::Short { columns: longer, rows: shorter },
            false => Missed::Contradiction { corners },
        });
    };
    let is_same =
        |other: &Placement| (0..4).any(|turns| turned(best, turns, [columns, rows]) == Some(*other));
    match !is_loose && possible.iter().all(is_same) {
        true => Ok(Placed { placement: best, is_whole }),
        false => Err(Missed::Ambiguous { corners }),
    }
}

/// Returns the placement on the board turned by quarters, or `None` if it does not cover itself then.
fn turned(placement: Placement, quarters: usize, [columns, rows]: [i32; 2]) -> Option<Placement> {
    let Placement { turn, shift: [x, y] } = placement;
    let shift = match quarters {
        0 => [x, y],
        2 => [columns - 1 - x, rows - 1 - y],
        // The new x is the old y, and the new y runs against the old x.
        1 if columns == rows => [y, columns - 1 - x],
        3 if columns == rows => [rows - 1 - y, x],
        _ => return None,
    };
    Some(Placement { turn: (turn + quarters) % 4, shift })
}

/// Returns the mean step in pixels along one of the [`SIDES`].
fn mean_step(grid: &Grid, side: usize) -> [f64; 2] {
    let step = |(at, corner): (&[i32; 2], &crate::fit::Fit)| {
        let next = grid.pixel([at[0] + SIDES[side][0], at[1] + SIDES[side][1]])?;
        Some([next[0] - corner.pixel[0], next[1] - corner.pixel[1]])
    };
    let steps: Vec<[f64; 2]> = grid.corners.iter().filter_map(step).collect();
    let n = steps.len().max(1) as f64;
    [0, 1].map(|axis| steps.iter().map(|step| step[axis]).sum::<f64>() / n)
}

/// Looks beyond one side of the grid.
///
/// Walking outwards from each pair of corners on that side, a dark square turns bright where the squares end. If the
/// board ends there, the bright squares beside it stay bright a little further; if it goes on, they turn dark.
fn beyond(grid: &Grid, side: usize, smooth: &Plane, scale: f64) -> Side {
    let [low, high] = grid.bounds();
    let out = SIDES[side];
    let bound = if out[0] + out[1] > 0 { high } else { low };
    let on_line = |k: i32| if out[0] != 0 { [bound[0], k] } else { [k, bound[1]] };
    let range = if out[0] != 0 { [low[1], high[1]] } else { [low[0], high[0]] };
    let mut strips = Vec::new();
    let (mut n_next, mut n_inside) = (0, 0);
    for k in range[0]..=range[1] {
        let at = on_line(k);
        let (Some(here), Some(inner)) = (grid.pixel(at), grid.pixel([at[0] - out[0], at[1] - out[1]])) else {
            continue;
        };
        // Steps outwards shorten as they did before, by bends of the lens and perspective.
        let further = grid.pixel([at[0] - 2 * out[0], at[1] - 2 * out[1]]);
        let step = [0, 1].map(|i| {
            let step = here[i] - inner[i];
            further.map_or(step, |further| 2.0 * step - (inner[i] - further[i]))
        });
        let room_px = ROOM * step[0].hypot(step[1]);
        n_next += 1;
        n_inside += usize::from(smooth.holds([0, 1].map(|i| here[i] + step[i]), scale, room_px));
    }
    for k in range[0]..range[1] {
        let (a, b) = (on_line(k), on_line(k + 1));
        let inwards = |at: [i32; 2]| grid.pixel([at[0] - out[0], at[1] - out[1]]);
        let [Some(a_px), Some(b_px), Some(a_in), Some(b_in)] =
            [grid.pixel(a), grid.pixel(b), inwards(a), inwards(b)]
        else {
            continue;
        };
        let middle = [0, 1].map(|i| 0.5 * (a_px[i] + b_px[i]));
        let inner = [0, 1].map(|i| 0.5 * (a_in[i] + b_in[i]));
        let grey = |steps: f64| {
            let pixel = [0, 1].map(|i| middle[i] + steps * (middle[i] - inner[i]));
            smooth.sample(pixel.map(|c| (c + 0.5) / scale - 0.5), 2.0)
        };
        // The square outside, between the corners; its neighbour inwards has the other colour.
        let lesser = [a[0].min(a[0] + out[0]), a[1].min(a[1] + out[1])];
        strips.push(Strip {
            is_bright: grid.is_bright_square(lesser),
            greys: STEPS.map(grey),
            inner: grey(-0.5),
        });
    }
    judge(&strips).unwrap_or(match n_inside >= 2 && 4 * n_inside >= n_next {
        true => Side::Unclear,
        false => Side::Outside,
    })
}

/// A corner is seen if it is at least this share of a step away from the border of the image.
const ROOM: f64 = 0.4;

/// Where along the way outwards grey values are looked at, in steps of the grid.
const STEPS: [f64; 30] = {
    let mut steps = [0.0; 30];
    let mut i = 0;
    while i < 30 {
        steps[i] = 0.15 + 0.05 * i as f64;
        i += 1;
    }
    steps
};

/// For how many of these steps a bright square must stay bright where dark ones have ended: a tenth of a square.
const MARGIN: usize = 2;

/// Grey values on the way outwards from between two corners.
struct Strip {
    /// Whether the first square outside is bright.
    is_bright: bool,
    greys: [Option<f32>; 30],
    /// The grey value of the square inside.
    inner: Option<f32>,
}

/// Returns whether the board ends or goes on; `None` if that cannot be told.
fn judge(strips: &[Strip]) -> Option<Side> {
    let mean = |bright: bool| {
        let values: Vec<f32> =
            strips.iter().filter(|strip| strip.is_bright != bright).filter_map(|strip| strip.inner).collect();
        (!values.is_empty()).then(|| values.iter().sum::<f32>() / values.len() as f32)
    };
    let (Some(white), Some(black)) = (mean(true), mean(false)) else { return None };
    let middle = 0.5 * (white + black);
    let is_bright = |grey: &Option<f32>| grey.map(|grey| grey > middle);
    // Where a strip leaves the colour it begins with, in indices of STEPS.
    let leaves = |strip: &&Strip| {
        let first = is_bright(&strip.greys[0])?;
        let end = strip.greys.iter().position(|grey| is_bright(grey) != Some(first))?;
        (first == strip.is_bright && strip.greys[end].is_some()).then_some(end)
    };
    let (dark, bright): (Vec<&Strip>, Vec<&Strip>) = strips.iter().partition(|strip| !strip.is_bright);
    let mut ends: Vec<usize> = dark.iter().filter_map(leaves).collect();
    ends.sort_unstable();
    let &end = ends.get(ends.len() / 2)?;
    let most = |n: usize, of: usize| n > 0 && 10 * n >= 7 * of;
    if bright.is_empty() || !most(ends.len(), dark.len()) {
        return None;
    }
    let stays = |strip: &&&Strip| {
        let greys = &strip.greys[..(end + MARGIN).min(STEPS.len())];
        greys.len() == end + MARGIN && greys.iter().all(|grey| is_bright(grey) == Some(true))
    };
    // Where the board goes on, all strips change at once, one step out, and then keep their new colour.
    let changes = |strip: &&Strip| {
        let keeps = |end: usize| {
            strip.greys[end + 2..end + 6].iter().all(|grey| is_bright(grey) != Some(strip.is_bright))
        };
        leaves(strip).is_some_and(|own| own.abs_diff(end) <= 1 && own + 6 <= STEPS.len() && keeps(own))
    };
    if most(bright.iter().filter(stays).count(), bright.len()) {
        Some(Side::Ends)
    } else if (STEPS[end] - 1.0).abs() < 0.2 && most(strips.iter().filter(changes).count(), strips.len()) {
        Some(Side::GoesOn)
    } else {
        None
    }
}
