//! A lattice with fitted corners: refined, completed by prediction, and freed of corners that do not belong.

use std::collections::BTreeMap;

use boresight_data::GrayImage;

use crate::fit::{Enough, FINE, Fit, ROUGH, Start, fit};
use crate::lattice::{Lattice, distance};
use crate::local_map::LocalMap;

/// A corner may move by this share of a step when it is fitted.
const MOVE_SHARE: f64 = 0.3;
/// A predicted corner may be off by this share of a step.
const PREDICTED_SHARE: f64 = 0.2;
/// The residuals of a fit may be this share of the contrast.
const RESIDUAL_SHARE: f64 = 0.22;
/// The sigma of a corner may be this share of a step.
const SIGMA_SHARE: f64 = 0.05;
/// The contrast of a corner may be this share of its neighbours'.
const CONTRAST_SHARE: f64 = 0.3;
/// How many steps away neighbours foretell where a corner is.
const NEAR: i32 = 2;
/// How far the window of a fit reaches, as a share of a step.
pub(crate) const REACH: f64 = 0.55;
/// The four neighbours of a corner.
pub(crate) const SIDES: [[i32; 2]; 4] = [[1, 0], [0, 1], [-1, 0], [0, -1]];

/// Fitted corners by their coordinates.
#[derive(Clone, Debug, Default)]
pub(crate) struct Grid {
    pub corners: BTreeMap<[i32; 2], Fit>,
    /// Whether the square from (0, 0) to (1, 1) is bright; every other one is.
    pub is_bright: bool,
}

impl Grid {
    /// Returns the grid of a lattice whose pixels are those of the full image, or `None` if too few corners can be fitted.
    ///
    /// It grows to at most `most` corners along either axis.
    pub fn refined(image: &GrayImage, lattice: &Lattice, most: i32) -> Option<Self> {
        let guess = |pixel, contrast| Fit {
            pixel,
            sigma_px: 0.0,
            blur_px: 1.0,
            contrast,
            residual: 0.0,
            shape: None,
        };
        let corners =
            lattice.corners.iter().map(|(at, corner)| (*at, guess(corner.pixel, corner.contrast))).collect();
        let mut grid = Self { corners, is_bright: lattice.is_bright };
        grid.refit(image, [0.0; 2], ROUGH);
        grid.grow(image, most);
        grid.refit(image, [1.0; 2], FINE);
        grid.prune();
        (grid.corners.len() >= 4).then_some(grid)
    }

    /// Tells whether all corners of a lattice are corners of this grid, to within a third of a step.
    pub fn covers(&self, lattice: &Lattice) -> bool {
        let is_here = |pixel: [f64; 2]| {
            let near = self.corners.iter().map(|(at, corner)| (distance(corner.pixel, pixel), at));
            near.min_by(|a, b| a.0.total_cmp(&b.0)).is_some_and(|(away_px, at)| {
                let here = self.corners[at].pixel;
                let beside = SIDES.iter().filter_map(|side| self.pixel([at[0] + side[0], at[1] + side[1]]));
                let step_px = beside.map(|pixel| distance(pixel, here)).fold(f64::INFINITY, f64::min);
                3.0 * away_px < step_px
            })
        };
        lattice.corners.len() <= self.corners.len()
            && lattice.corners.values().all(|corner| is_here(corner.pixel))
    }

    /// Tells whether the square from a corner to its neighbour along both axes is bright.
    pub fn is_bright_square(&self, [i, j]: [i32; 2]) -> bool {
        self.is_bright == ((i + j).rem_euclid(2) == 0)
    }

    /// Returns the pixel of a corner, if there is one.
    pub fn pixel(&self, at: [i32; 2]) -> Option<[f64; 2]> {
        self.corners.get(&at).map(|corner| corner.pixel)
    }

    /// Returns the smallest and the largest coordinates; zeros without corners.
    pub fn bounds(&self) -> [[i32; 2]; 2] {
        let first = self.corners.keys().next().copied().unwrap_or_default();
        self.corners.keys().fold([first, first], |[low, high], at| {
            [[low[0].min(at[0]), low[1].min(at[1])], [high[0].max(at[0]), high[1].max(at[1])]]
        })
    }

    /// Fits every corner from where it is, as well as is enough; `bending` scales the curvature that neighbours give
    /// the edges.
    fn refit(&mut self, image: &GrayImage, bending: [f64; 2], enough: Enough) {
        let fitted = self.corners.iter().filter_map(|(at, corner)| {
            let mut start = self.start(*at, corner.pixel, corner.blur_px, bending)?;
            start.before = corner.shape;
            start.enough = enough;
            let fit = fit(image, &start)?;
            let step_px = start.steps_px.map(|step| step[0].hypot(step[1]));
            let may_move_px = MOVE_SHARE * step_px[0].min(step_px[1]);
            let is_good =
                distance(fit.pixel, corner.pixel) <= may_move_px && is_corner(&fit, corner.contrast, step_px);
            is_good.then_some((*at, fit))
        });
        self.corners = fitted.collect();
    }

    /// Returns what a fit of the corner at `at` begins with, or `None` without a neighbour along each axis.
    fn start(&self, at: [i32; 2], pixel: [f64; 2], blur_px: f64, bending: [f64; 2]) -> Option<Start> {
        let (mut steps_px, mut bends_px) = ([[0.0; 2]; 2], [[0.0; 2]; 2]);
        for axis in 0..2 {
            let along = |n: i32| self.pixel([at[0] + n * SIDES[axis][0], at[1] + n * SIDES[axis][1]]);
            let second =
                |a: [f64; 2], b: [f64; 2], c: [f64; 2]| [0, 1].map(|i| 0.5 * (a[i] - 2.0 * b[i] + c[i]));
            let (step, bend) = match (along(-1), along(1)) {
                (Some(before), Some(after)) => {
                    ([0, 1].map(|i| 0.5 * (after[i] - before[i])), second(before, pixel, after))
                }
                // At the rim, the bend of the next corner inwards is the best guess.
                (None, Some(after)) => {
                    let bend = along(2).map_or([0.0; 2], |far| second(pixel, after, far));
                    ([0, 1].map(|i| after[i] - pixel[i] - bend[i]), bend)
                }
                (Some(before), None) => {
                    let bend = along(-2).map_or([0.0; 2], |far| second(far, before, pixel));
                    ([0, 1].map(|i| pixel[i] - before[i] + bend[i]), bend)
                }
                (None, None) => return None,
            };
            steps_px[axis] = step;
            bends_px[axis] = bend.map(|b| b * bending[axis]);
        }
        Some(Start {
            pixel,
            steps_px,
            bends_px,
            is_bright: self.is_bright_square(at),
            blur_px,
            reach: REACH,
            hole: None,
            before: None,
            enough: ROUGH,
        })
    }

    /// Adds corners next to known ones, where the prediction is a corner in the image.
    fn grow(&mut self, image: &GrayImage, most: i32) {
        let mut tried: BTreeMap<[i32; 2], usize> = BTreeMap::new();
        loop {
            let mut added = Vec::new();
            let [low, high] = self.bounds();
            for at in self.vacancies() {
                let too_many = (0..2).any(|axis| high[axis].max(at[axis]) - low[axis].min(at[axis]) >= most);
                // A place is worth another try when more is known around it.
                let known = SIDES
                    .iter()
                    .filter(|side| self.corners.contains_key(&[at[0] + side[0], at[1] + side[1]]))
                    .count();
                if too_many || tried.insert(at, known).is_some_and(|before| before >= known) {
                    continue;
                }
                added.extend(self.fit_predicted(image, at).map(|fit| (at, fit)));
            }
            if added.is_empty() {
                return;
            }
            self.corners.extend(added);
        }
    }

    /// Returns the empty places beside corners, in order.
    fn vacancies(&self) -> Vec<[i32; 2]> {
        let beside = self.corners.keys().flat_map(|at| SIDES.map(|side| [at[0] + side[0], at[1] + side[1]]));
        let places: std::collections::BTreeSet<[i32; 2]> =
            beside.filter(|at| !self.corners.contains_key(at)).collect();
        places.into_iter().collect()
    }

    /// Fits a corner where its neighbours predict one.
    fn fit_predicted(&self, image: &GrayImage, at: [i32; 2]) -> Option<Fit> {
        let (pixel, blur_px, contrast) = self.predicted(at)?;
        let start = self.start(at, pixel, blur_px, [0.0; 2])?;
        let fit = fit(image, &start)?;
        let step_px = start.steps_px.map(|step| step[0].hypot(step[1]));
        let is_near = distance(fit.pixel, pixel) <= PREDICTED_SHARE * step_px[0].min(step_px[1]);
        let is_like_others = fit.blur_px < 2.5 * blur_px + 0.5;
        (is_near && is_like_others && is_corner(&fit, contrast, step_px)).then_some(fit)
    }

    /// Returns where the corner at `at` should be, its blur and its contrast, by the lines of corners that lead there.
    fn predicted(&self, at: [i32; 2]) -> Option<([f64; 2], f64, f64)> {
        let (mut sum, mut blur, mut contrast, mut n) = ([0.0; 2], 0.0, 0.0f64, 0.0);
        for side in SIDES {
            let along = |k: i32| self.corners.get(&[at[0] + k * side[0], at[1] + k * side[1]]);
            let (Some(first), Some(second)) = (along(1), along(2)) else { continue };
            let far = along(3).unwrap_or(second);
            let bend = |i: usize| match along(3) {
                Some(_) => first.pixel[i] - 2.0 * second.pixel[i] + far.pixel[i],
                None => 0.0,
            };
            for (i, sum) in sum.iter_mut().enumerate() {
                *sum += 2.0 * first.pixel[i] - second.pixel[i] + bend(i);
            }
            blur += first.blur_px;
            contrast += first.contrast;
            n += 1.0;
        }
        (n > 0.0).then(|| (sum.map(|s| s / n), blur / n, contrast / n))
    }

    /// Removes corners that are not where their neighbours put them, the worst first, and those without a square.
    fn prune(&mut self) {
        let misfit = |grid: &Self, at: [i32; 2]| grid.misfit(at).unwrap_or(f64::INFINITY);
        let mut misfits: BTreeMap<[i32; 2], f64> =
            self.corners.keys().map(|at| (*at, misfit(self, *at))).collect();
        loop {
            let worst = misfits.iter().max_by(|a, b| a.1.total_cmp(b.1)).map(|(at, misfit)| (*at, *misfit));
            let Some((at, _)) = worst.filter(|(_, misfit)| *misfit > 1.0) else { return };
            self.corners.remove(&at);
            misfits.remove(&at);
            for (other, stale) in &mut misfits {
                if (0..2).all(|axis| (other[axis] - at[axis]).abs() <= NEAR) {
                    *stale = misfit(self, *other);
                }
            }
        }
    }

    /// Returns how far a corner is from where its neighbours put it, as a share of what is believed.
    ///
    /// `None` if it has not enough neighbours to tell.
    fn misfit(&self, at: [i32; 2]) -> Option<f64> {
        let corner = self.corners.get(&at)?;
        let near = |[i, j]: [i32; 2]| {
            let pixel = self.pixel([at[0] + i, at[1] + j])?;
            Some(([f64::from(i), f64::from(j)], pixel))
        };
        let map =
            LocalMap::fitted((-NEAR..=NEAR).flat_map(|i| (-NEAR..=NEAR).filter_map(move |j| near([i, j]))))?;
        let steps = SIDES.iter().filter_map(|side| near(*side));
        let step_px = steps.map(|(_, pixel)| distance(pixel, corner.pixel)).fold(f64::INFINITY, f64::min);
        let believed_px = 4.0 * corner.sigma_px + step_px * if map.is_surrounded { 0.06 } else { 0.15 };
        step_px.is_finite().then(|| distance(map.pixel(), corner.pixel) / believed_px)
    }
}

/// Tells whether a fit is a corner at all, beside neighbours of this contrast and with steps of these lengths.
pub(crate) fn is_corner(fit: &Fit, contrast: f64, step_px: [f64; 2]) -> bool {
    let is_known = fit.sigma_px < SIGMA_SHARE * step_px[0].min(step_px[1]);
    is_known && fit.contrast > CONTRAST_SHARE * contrast && fit.residual < RESIDUAL_SHARE * fit.contrast
}
