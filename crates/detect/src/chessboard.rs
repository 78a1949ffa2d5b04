//! Chessboards: whole or in part, at any size and turn, through any lens.
//!
//! Saddles of the grey values become lattices along the edges between them, at one scale of the image after the other.
//! A lattice is fitted at full size, completed by prediction, and placed on the board. Nothing is labelled that is not
//! held in place by what is seen.

use std::borrow::Cow;

use boresight_data::{Geometry, GrayImage, Observation, PointId, Target};

use crate::detection::{Detection, Missed};
use crate::grid::Grid;
use crate::lattice::{ASIDE, Corner, Lattice, find_lattices};
use crate::placement::{Placed, Placement, place};
use crate::plane::Plane;
use crate::saddles::find_saddles;

/// Detection begins at a scale at which the image has at most this many pixels.
const FIRST_PIXELS: usize = 100_000;
/// The shortest side of an image in which a board is looked for.
const LEAST_SIDE: usize = 40;
/// The lattices of an image that are looked at closely.
const MOST_LATTICES: usize = 4;
/// The least contrast of a corner, as a share of the range of the image.
pub(crate) const CONTRAST_SHARE: f64 = 0.04;
/// The fewest corners that are believed to be a board.
const FEWEST: usize = 8;

/// Tells whether a target is a chessboard.
pub(crate) fn handles(geometry: &Geometry) -> bool {
    matches!(geometry, Geometry::Chessboard { .. })
}

/// Detects the corners of a chessboard.
pub(crate) fn detect(image: &GrayImage, target: &Target) -> Detection {
    let Geometry::Chessboard { columns, rows, .. } = target.geometry else {
        return Detection::missed(Missed::NoBoard);
    };
    let board = [columns, rows].map(|n| i32::try_from(n).unwrap_or(i32::MAX));
    let planes = Planes::of(image);
    let mut best = Detection::missed(Missed::NoBoard);
    let mut seen = Grid::default();
    for level in planes.order() {
        let found = detect_at(image, &planes, level, board, &mut seen);
        if found.is_better_than(&best) {
            best = found;
        }
        if best.observations.len() == count(board) {
            break;
        }
    }
    best
}

/// Detects at one scale; the result is the best of all lattices there.
///
/// `seen` is the largest grid so far: what is part of it is not fitted again.
fn detect_at(
    image: &GrayImage,
    planes: &Planes,
    level: usize,
    board: [i32; 2],
    seen: &mut Grid,
) -> Detection {
    let scale = f64::from(1u32 << level);
    let smooth = planes.at(image, level).smoothed();
    let [low, high] = smooth.range();
    let least_contrast = CONTRAST_SHARE * f64::from(high - low).max(1.0);
    let saddles = find_saddles(&smooth, least_contrast);
    let mut best = Detection::missed(Missed::NoBoard);
    for lattice in find_lattices(&saddles, &smooth, ASIDE).iter().take(MOST_LATTICES) {
        let is_small = 2 * lattice.corners.len() < best.observations.len();
        if lattice.corners.len() < FEWEST / 2 || is_small {
            continue;
        }
        let lattice = at_full_size(lattice, scale);
        let found = if seen.covers(&lattice) {
            label(seen, &smooth, scale, board)
        } else {
            let most = board[0].max(board[1]).saturating_add(2);
            let Some(grid) = Grid::refined(image, &lattice, most) else { continue };
            let found = label(&grid, &smooth, scale, board);
            if grid.corners.len() > seen.corners.len() {
                *seen = grid;
            }
            found
        };
        if found.is_better_than(&best) {
            best = found;
        }
        if best.observations.len() == count(board) {
            break;
        }
    }
    best
}

/// Returns the number of corners of a board.
fn count(board: [i32; 2]) -> usize {
    board[0] as usize * board[1] as usize
}

/// Returns the labelled corners of a grid, or why it has no labels.
fn label(grid: &Grid, smooth: &Plane, scale: f64, board: [i32; 2]) -> Detection {
    if grid.corners.len() < FEWEST.min(count(board)) {
        return Detection::missed(Missed::NoBoard);
    }
    match place(grid, board, smooth, scale) {
        Ok(Placed { placement, is_whole }) => Detection {
            observations: observations(grid, placement, board[0]),
            missed: None,
            pattern: None,
            shows_size: is_whole,
        },
        Err(missed) => Detection::missed(missed),
    }
}

fn observations(grid: &Grid, placement: Placement, columns: i32) -> Vec<Observation> {
    let mut observations: Vec<Observation> = grid
        .corners
        .iter()
        .map(|(at, fit)| {
            let [column, row] = placement.label(*at);
            Observation {
                point: PointId((row * columns + column) as u32),
                pixel: fit.pixel,
                sigma_px: fit.sigma_px,
            }
        })
        .collect();
    observations.sort_by_key(|observation| observation.point);
    observations
}

/// Returns a lattice found at 1/`scale` of the image's size in pixels of the image.
pub(crate) fn at_full_size(lattice: &Lattice, scale: f64) -> Lattice {
    let corner = |corner: &Corner| Corner { pixel: corner.pixel.map(|c| (c + 0.5) * scale - 0.5), ..*corner };
    Lattice {
        corners: lattice.corners.iter().map(|(at, found)| (*at, corner(found))).collect(),
        is_bright: lattice.is_bright,
    }
}

/// The image at full size, half, a quarter and so on.
pub(crate) struct Planes {
    halves: Vec<Plane>,
    first: usize,
}

impl Planes {
    pub fn of(image: &GrayImage) -> Self {
        let mut halves: Vec<Plane> = Vec::new();
        let [width, height] = image.size().map(|side| side as usize);
        let mut pixels = width * height;
        let mut first = 0;
        while pixels > FIRST_PIXELS {
            let half = match halves.last() {
                Some(plane) => plane.halved(),
                None => Plane::half_of(image),
            };
            pixels = half.values.len();
            halves.push(half);
            first += 1;
        }
        // Blurred images may need to be smaller still.
        for _ in 0..2 {
            let half = match halves.last() {
                Some(plane) => plane.halved(),
                None => Plane::half_of(image),
            };
            if half.width.min(half.height) < LEAST_SIDE {
                break;
            }
            halves.push(half);
        }
        Self { halves, first }
    }

    /// Returns the scales in the order in which they are tried: the first, the finer ones, the coarser ones.
    pub fn order(&self) -> impl Iterator<Item = usize> + use<> {
        (0..=self.first).rev().chain(self.first + 1..=self.halves.len())
    }

    pub fn at(&self, image: &GrayImage, level: usize) -> Cow<'_, Plane> {
        match level.checked_sub(1).and_then(|i| self.halves.get(i)) {
            Some(plane) => Cow::Borrowed(plane),
            None => Cow::Owned(Plane::of(image)),
        }
    }
}
