//! A lattice with fitted corners: refined, completed by prediction, and freed of corners that do not belong.

use std::collections::BTreeMap;

use boresight_data::GrayImage;
use boresight_geometry::nalgebra::{SMatrix, SVector};

use crate::fit::{Fit, Start, fit};
use crate::lattice::{Lattice, distance};

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
/// How far the window of a fit reaches, as a share of a step.
pub(crate) const REACH: f64 = 0.55;
/// The four neighbours of a corner.
pub(crate) const SIDES: [[i32; 2]; 4] = [[1, 0], [0, 1], [-1, 0], [0, -1]];

/// Fitted corners by their coordinates.
#[derive(Clone, Debug)]
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
        grid.refit(image, [0.0; 2]);
        grid.grow(image, most);
        grid.refit(image, [1.0; 2]);
        grid.prune();
        (grid.corners.len() >= 4).then_some(grid)
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

    /// Fits every corner from where it is; `bending` scales the curvature that neighbours give the edges.
    fn refit(&mut self, image: &GrayImage, bending: [f64; 2]) {
        let fitted = self.corners.iter().filter_map(|(at, corner)| {
            let mut start = self.start(*at, corner.pixel, corner.blur_px, bending)?;
            start.before = corner.shape;
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

    /// Removes corners that are not where the homography of their neighbours puts them, and those without a square.
    fn prune(&mut self) {
        loop {
            let misfit = |at: &[i32; 2]| self.misfit(*at).unwrap_or(f64::INFINITY);
            let worst = self.corners.keys().map(|at| (misfit(at), *at)).max_by(|a, b| a.0.total_cmp(&b.0));
            match worst {
                Some((misfit, at)) if misfit > 1.0 => self.corners.remove(&at),
                _ => return,
            };
        }
    }

    /// Returns how far a corner is from where its neighbours put it, as a share of what is believed.
    ///
    /// `None` if it has not enough neighbours to tell.
    fn misfit(&self, at: [i32; 2]) -> Option<f64> {
        let corner = self.corners.get(&at)?;
        let mut normal = SMatrix::<f64, 8, 8>::zeros();
        let mut gradient = SVector::<f64, 8>::zeros();
        let (mut n, mut step_px) = (0, f64::INFINITY);
        let mut sides = [false; 4];
        for i in -2i32..=2 {
            for j in -2i32..=2 {
                let Some(other) = self.pixel([at[0] + i, at[1] + j]).filter(|_| (i, j) != (0, 0)) else {
                    continue;
                };
                let (x, y) = (f64::from(i), f64::from(j));
                let [u, v] = [0, 1].map(|axis| other[axis] - corner.pixel[axis]);
                if i.abs() + j.abs() == 1 {
                    step_px = step_px.min(u.hypot(v));
                }
                for (k, is_on) in sides.iter_mut().enumerate() {
                    *is_on |= i * SIDES[k][0] + j * SIDES[k][1] > 0;
                }
                // u (1 + h₇ x + h₈ y) = h₁ + h₂ x + h₃ y, and the same for v; near neighbours count more.
                let weight = 1.0 / (x * x + y * y);
                for row in [
                    (SVector::from([1.0, x, y, 0.0, 0.0, 0.0, -u * x, -u * y]), u),
                    (SVector::from([0.0, 0.0, 0.0, 1.0, x, y, -v * x, -v * y]), v),
                ] {
                    normal += row.0 * row.0.transpose() * weight;
                    gradient += row.0 * (row.1 * weight);
                }
                n += 1;
            }
        }
        if n < 3 || !step_px.is_finite() {
            return None;
        }
        let is_surrounded = sides.iter().all(|is_on| *is_on);
        // With few neighbours an affine map has to do; the last two unknowns are held near zero.
        let hold = if n >= 7 { 1e-6 } else { 1e3 } * step_px * step_px;
        for k in 6..8 {
            normal[(k, k)] += hold;
        }
        let solution = normal.cholesky()?.solve(&gradient);
        let believed_px = 4.0 * corner.sigma_px + step_px * if is_surrounded { 0.06 } else { 0.15 };
        Some(solution[0].hypot(solution[3]) / believed_px)
    }
}

/// Tells whether a fit is a corner at all, beside neighbours of this contrast and with steps of these lengths.
pub(crate) fn is_corner(fit: &Fit, contrast: f64, step_px: [f64; 2]) -> bool {
    let is_known = fit.sigma_px < SIGMA_SHARE * step_px[0].min(step_px[1]);
    is_known && fit.contrast > CONTRAST_SHARE * contrast && fit.residual < RESIDUAL_SHARE * fit.contrast
}
