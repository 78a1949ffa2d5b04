//! Corners that are known by their labels: fitted, completed where the board must have more, and freed of those that are
//! not where their neighbours put them.
//!
//! What a neighbourhood of corners foretells comes from the homography that maps the drawing to the image there.

use std::collections::BTreeMap;

use boresight_data::{GrayImage, Observation, PointId};

use crate::fit::{FINE, Fit, Hole, ROUGH, Start, fit};
use crate::grid::{REACH, is_corner};
use crate::lattice::distance;
use crate::local_map::LocalMap;
use crate::statistics::median;

/// A corner may move by this share of its window's step when it is fitted.
const MOVE_SHARE: f64 = 0.3;
/// A predicted corner may be off by this share of its window's step.
const PREDICTED_SHARE: f64 = 0.25;
/// How much more than the median of the board the residuals of a corner may be, as a share of its contrast.
const RESIDUAL_FACTOR: f64 = 2.5;
/// Residuals of this share of the contrast are always believed.
const RESIDUAL_SHARE: f64 = 0.05;

/// The corners of a board as they are drawn.
pub(crate) struct Drawing {
    /// Corners along x and along y.
    pub size: [i32; 2],
    /// Where each column and each row of corners is, in steps of the board; first what would come before them, last
    /// what would follow.
    pub at: [Vec<f64>; 2],
    /// The step beside a corner that its window is measured in.
    pub window_step: f64,
    /// Whether the square from the first corner towards x and y is bright.
    pub is_bright: bool,
    /// What is in the squares.
    pub hole: Option<Hole>,
    /// How many columns and rows away neighbours are looked at.
    pub near: i32,
}

impl Drawing {
    fn is_bright_square(&self, [column, row]: [i32; 2]) -> bool {
        self.is_bright == ((column + row).rem_euclid(2) == 0)
    }

    fn has(&self, at: [i32; 2]) -> bool {
        (0..2).all(|axis| (0..self.size[axis]).contains(&at[axis]))
    }
}

/// Returns the observations of a board of which some corners are known to within a pixel or so, or `None` if the board
/// goes on where it should end.
pub(crate) fn complete(
    image: &GrayImage,
    drawing: &Drawing,
    seen: &BTreeMap<[i32; 2], [f64; 2]>,
    contrast: f64,
) -> Option<Vec<Observation>> {
    let guess = |pixel| Fit { pixel, sigma_px: 0.0, blur_px: 1.0, contrast, residual: 0.0, shape: None };
    let corners = seen.iter().filter(|(at, _)| drawing.has(**at)).map(|(at, pixel)| (*at, guess(*pixel)));
    let mut board = Labelled { image, drawing, corners: corners.collect() };
    board.prune(0.5);
    board.refit(false);
    board.grow();
    board.refit(true);
    board.drop_unlike();
    board.prune(1.0);
    if board.goes_on() {
        return None;
    }
    let id = |[column, row]: [i32; 2]| PointId((row * drawing.size[0] + column) as u32);
    let mut observations: Vec<Observation> = board
        .corners
        .iter()
        .map(|(at, fit)| Observation { point: id(*at), pixel: fit.pixel, sigma_px: fit.sigma_px })
        .collect();
    observations.sort_by_key(|observation| observation.point);
    Some(observations)
}

/// Tells whether the markers between the corners of a board confirm its labels.
///
/// `has_marker` says of the first corner of a cell whether there is a marker in it, `is_right` whether that is the one
/// which belongs there, or `None` if it cannot be read. Few may be wrong, and a fifth must be read.
pub(crate) fn is_confirmed(
    drawing: &Drawing,
    observations: &[Observation],
    has_marker: impl Fn([i32; 2]) -> bool,
    is_right: impl Fn([i32; 2], [[f64; 2]; 4]) -> Option<bool>,
) -> bool {
    let columns = drawing.size[0];
    let seen: BTreeMap<[i32; 2], [f64; 2]> = observations
        .iter()
        .map(|observation| {
            let point = observation.point.0 as i32;
            ([point % columns, point / columns], observation.pixel)
        })
        .collect();
    let (mut n_cells, mut n_right, mut n_wrong) = (0, 0, 0);
    for at in seen.keys().filter(|at| has_marker(**at)) {
        let pixel = |i: i32, j: i32| seen.get(&[at[0] + i, at[1] + j]).copied();
        let corners = [pixel(0, 0), pixel(1, 0), pixel(1, 1), pixel(0, 1)];
        let [Some(a), Some(b), Some(c), Some(d)] = corners else { continue };
        n_cells += 1;
        match is_right(*at, [a, b, c, d]) {
            Some(true) => n_right += 1,
            Some(false) => n_wrong += 1,
            None => {}
        }
    }
    n_right > 0 && 4 * n_wrong <= n_right && 5 * n_right >= n_cells
}

struct Labelled<'a> {
    image: &'a GrayImage,
    drawing: &'a Drawing,
    corners: BTreeMap<[i32; 2], Fit>,
}

/// What the neighbours of a place foretell.
struct Foretold {
    pixel: [f64; 2],
    /// The steps of its window along x and y in pixels.
    steps_px: [[f64; 2]; 2],
    /// Whether there are neighbours on all sides.
    is_surrounded: bool,
    blur_px: f64,
    contrast: f64,
}

impl Labelled<'_> {
    /// Fits every corner from where it is, along edges that bend with their neighbours or are straight.
    fn refit(&mut self, bends: bool) {
        let fitted: Vec<([i32; 2], Fit)> = self
            .corners
            .iter()
            .filter_map(|(at, corner)| {
                let foretold = self.foretold(*at)?;
                let start = Start { before: corner.shape, ..self.start(*at, corner.pixel, &foretold, bends) };
                let fit = fit(self.image, &start)?;
                let step_px = lengths(start.steps_px);
                let is_near =
                    distance(fit.pixel, corner.pixel) <= MOVE_SHARE * step_px[0].min(step_px[1]).max(4.0);
                (is_near && is_corner(&fit, foretold.contrast, step_px)).then_some((*at, fit))
            })
            .collect();
        self.corners = fitted.into_iter().collect();
    }

    fn start(&self, at: [i32; 2], pixel: [f64; 2], foretold: &Foretold, bends: bool) -> Start {
        let second = |axis: usize| {
            let along = |n: i32| {
                let mut place = at;
                place[axis] += n;
                self.corners.get(&place).map(|corner| corner.pixel)
            };
            let (Some(before), Some(after)) = (along(-1), along(1)) else { return [0.0; 2] };
            [0, 1].map(|i| 0.5 * (after[i] - 2.0 * pixel[i] + before[i]))
        };
        // Where steps differ in length, second differences do not tell how edges bend.
        let is_even = self.drawing.window_step == 1.0;
        Start {
            pixel,
            steps_px: foretold.steps_px,
            bends_px: if bends && is_even { [second(0), second(1)] } else { [[0.0; 2]; 2] },
            is_bright: self.drawing.is_bright_square(at),
            blur_px: foretold.blur_px,
            reach: REACH,
            hole: self.drawing.hole,
            before: None,
            enough: if bends { FINE } else { ROUGH },
        }
    }

    /// Adds corners where their neighbours foretell them and the image shows them.
    fn grow(&mut self) {
        let mut tried: BTreeMap<[i32; 2], usize> = BTreeMap::new();
        loop {
            let mut added = Vec::new();
            let places =
                (0..self.drawing.size[1]).flat_map(|row| (0..self.drawing.size[0]).map(move |c| [c, row]));
            for at in places.filter(|at| !self.corners.contains_key(at)) {
                let n_beside = (0..9)
                    .filter(|k| self.corners.contains_key(&[at[0] + k % 3 - 1, at[1] + k / 3 - 1]))
                    .count();
                // A place is worth another try when more is known around it.
                if n_beside == 0 || tried.insert(at, n_beside).is_some_and(|before| before >= n_beside) {
                    continue;
                }
                added.extend(self.fit_foretold(at).map(|fit| (at, fit)));
            }
            if added.is_empty() {
                return;
            }
            self.corners.extend(added);
        }
    }

    /// Tells whether there are corners beyond one of the ends of the board.
    fn goes_on(&self) -> bool {
        let [columns, rows] = self.drawing.size;
        let ends: [Vec<[i32; 2]>; 4] = [
            (0..rows).map(|row| [-1, row]).collect(),
            (0..rows).map(|row| [columns, row]).collect(),
            (0..columns).map(|column| [column, -1]).collect(),
            (0..columns).map(|column| [column, rows]).collect(),
        ];
        ends.iter().any(|end| {
            let beside = |at: &&[i32; 2]| {
                let inside = [at[0].clamp(0, columns - 1), at[1].clamp(0, rows - 1)];
                self.corners.contains_key(&inside)
            };
            let looked_at: Vec<&[i32; 2]> = end.iter().filter(beside).collect();
            let is_seen = |at: &[i32; 2]| {
                self.fit_foretold(*at).is_some_and(|fit| residual_share(&fit) <= self.most_residual())
            };
            let n_seen = looked_at.iter().filter(|at| is_seen(at)).count();
            n_seen >= 2 && 4 * n_seen >= looked_at.len()
        })
    }

    fn fit_foretold(&self, at: [i32; 2]) -> Option<Fit> {
        let foretold = self.foretold(at)?;
        let start = self.start(at, foretold.pixel, &foretold, false);
        let fit = fit(self.image, &start)?;
        let step_px = lengths(start.steps_px);
        let may_miss_px = PREDICTED_SHARE * step_px[0].min(step_px[1]);
        let is_near = distance(fit.pixel, foretold.pixel) <= may_miss_px;
        let is_like_others = fit.blur_px < 2.5 * foretold.blur_px + 0.5;
        (is_near && is_like_others && is_corner(&fit, foretold.contrast, step_px)).then_some(fit)
    }

    /// Removes corners whose grey values are less of a corner than those of the others: something may cover them.
    fn drop_unlike(&mut self) {
        let most = self.most_residual();
        self.corners.retain(|_, fit| residual_share(fit) <= most);
    }

    /// Returns the residual of a corner that is believed, as a share of its contrast.
    fn most_residual(&self) -> f64 {
        let median = median(self.corners.values().map(residual_share)).unwrap_or(0.0);
        RESIDUAL_SHARE.max(RESIDUAL_FACTOR * median)
    }

    /// Removes corners that are not where their neighbours put them, the worst first; `strictness` scales what is believed.
    fn prune(&mut self, strictness: f64) {
        let mut misfits: BTreeMap<[i32; 2], Option<(f64, f64)>> =
            self.corners.keys().map(|at| (*at, self.misfit(*at))).collect();
        // What a smooth lens does to neighbourhoods is alike all over a board.
        let median = median(misfits.values().flatten().map(|(misfit, _)| *misfit)).unwrap_or(0.0);
        loop {
            let worst = misfits
                .iter()
                .map(|(at, misfit)| {
                    let Some((misfit_px, believed_px)) = *misfit else {
                        return (f64::INFINITY, *at);
                    };
                    let alike_px = 0.3 + 8.0 * median;
                    let sigma_px = self.corners[at].sigma_px;
                    let limit_px = 4.0 * sigma_px + believed_px.min(alike_px / strictness.powi(2));
                    (strictness * misfit_px / limit_px, *at)
                })
                .max_by(|a, b| a.0.total_cmp(&b.0));
            let Some((_, at)) = worst.filter(|(misfit, _)| *misfit > 1.0) else { return };
            self.corners.remove(&at);
            misfits.remove(&at);
            for (other, stale) in &mut misfits {
                if (0..2).all(|axis| (other[axis] - at[axis]).abs() <= self.drawing.near) {
                    *stale = self.misfit(*other);
                }
            }
        }
    }

    /// Returns how many pixels a corner is from where its neighbours put it, and how many are believed at most.
    fn misfit(&self, at: [i32; 2]) -> Option<(f64, f64)> {
        let corner = self.corners.get(&at)?;
        let foretold = self.foretold(at)?;
        let step_px = lengths(foretold.steps_px);
        let share = if foretold.is_surrounded { 0.06 } else { 0.15 };
        Some((distance(foretold.pixel, corner.pixel), share * step_px[0].min(step_px[1])))
    }

    /// Returns what the corners near a place, without it, foretell; `None` if they are too few or in a row.
    fn foretold(&self, at: [i32; 2]) -> Option<Foretold> {
        let reach = self.drawing.near;
        let places = (at[1] - reach..=at[1] + reach)
            .flat_map(|row| (at[0] - reach..=at[0] + reach).map(move |column| [column, row]));
        let near: Vec<([f64; 2], &Fit)> = places
            .filter(|place| *place != at)
            .filter_map(|place| {
                let corner = self.corners.get(&place)?;
                let away = [0, 1].map(|axis| {
                    let along = &self.drawing.at[axis];
                    along[(place[axis] + 1) as usize] - along[(at[axis] + 1) as usize]
                });
                Some((away, corner))
            })
            .collect();
        let map = LocalMap::fitted(near.iter().map(|(away, corner)| (*away, corner.pixel)))?;
        let (mut blur_px, mut contrast, mut weights) = (0.0, 0.0, 0.0);
        for ([x, y], corner) in &near {
            let weight = 1.0 / (x * x + y * y);
            blur_px += weight * corner.blur_px;
            contrast += weight * corner.contrast;
            weights += weight;
        }
        Some(Foretold {
            pixel: map.pixel(),
            steps_px: map.steps_px(self.drawing.window_step),
            is_surrounded: map.is_surrounded,
            blur_px: blur_px / weights,
            contrast: contrast / weights,
        })
    }
}

fn residual_share(fit: &Fit) -> f64 {
    fit.residual / fit.contrast.max(1e-9)
}

fn lengths(steps_px: [[f64; 2]; 2]) -> [f64; 2] {
    steps_px.map(|step| step[0].hypot(step[1]))
}
