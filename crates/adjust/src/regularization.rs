//! What is believed of lenses before any data: mild beliefs of our own, or the rows of mrcal.

use std::collections::BTreeSet;

use boresight_camera::{Camera, LocalSupport, ParamGroup};
use boresight_data::{Dataset, Rig, Scene};
use boresight_solver::{Belief, BlockId, SparsePrior, VectorPrior};

use crate::options::{AdjustOptions, Quantity, Regularization};
use crate::rig_problem::RigProblem;

/// Expected size of a rational lens's radial coefficients.
const RATIONAL_SIGMA: f64 = 2.0;
/// Expected size of thin-prism coefficients, and of tilts in radians.
const PRISM_AND_TILT_SIGMA: f64 = 0.1;
/// Expected size of what a spline's knot moves the image by, in units of the focal length.
const SPLINE_SIGMA: f64 = 1.0;

/// Returns the regularisation rows of mrcal up to 2.5.2, whose residuals are in pixels.
///
/// `n_rows` counts all rows of pixels, rejected ones included. The scale of distortions is 2, that of
/// the centre 500 px; the denominators of a rational lens weigh five times as much. Each row is a
/// column of the lens, its mean, and the inverse of its sigma.
pub fn mrcal22_rows(
    n_rows: usize,
    n_cameras: usize,
    n_params: usize,
    is_rational: bool,
    image_size: [u32; 2],
) -> Vec<(usize, f64, f64)> {
    let share = n_rows as f64 * 0.005 / 2.0 / n_cameras as f64;
    let n_distortions = n_params - 4;
    let distortion = (share / (n_distortions as f64 * 4.0)).sqrt();
    let centre = (share / (2.0 * 500.0 * 500.0)).sqrt();
    let mut rows: Vec<(usize, f64, f64)> = (0..n_distortions)
        .map(|i| {
            let factor = if is_rational && (5..8).contains(&i) { 5.0 } else { 1.0 };
            (4 + i, 0.0, factor * distortion)
        })
        .collect();
    for (axis, &size) in image_size.iter().enumerate() {
        rows.push((2 + axis, (f64::from(size) - 1.0) / 2.0, centre));
    }
    rows
}

impl RigProblem {
    /// Adds what is believed of lenses before any data, but for what the priors of `options` are about.
    pub(crate) fn add_regularization(&mut self, dataset: &Dataset, scene: &Scene, options: &AdjustOptions) {
        // What an earlier calibration says contains its regularisation already.
        let quantities = options.priors.iter().flat_map(|prior| &prior.quantities);
        let believed: BTreeSet<(BlockId, usize)> = quantities
            .filter_map(|quantity| match quantity {
                Quantity::LensParam(id, param, _) => Some((self.cameras.get(*id)?.as_ref()?.lens, *param)),
                _ => None,
            })
            .collect();
        // A lens that cameras share counts once.
        let mut done = BTreeSet::new();
        let n_cameras = self.cameras.iter().flatten().count();
        let n_rows: usize =
            self.views.iter().map(|(view_idx, _)| 2 * dataset.views[*view_idx].observations.len()).sum();
        for (blocks, camera) in self.cameras.iter().zip(&scene.rig.cameras) {
            let (Some(blocks), Some(camera)) = (blocks, camera) else { continue };
            if !done.insert(blocks.lens) {
                continue;
            }
            let is_open = |column: usize| !believed.contains(&(blocks.lens, column));
            let camera = &camera.camera;
            if let Some(grid) = camera.model.local_support() {
                let mut beliefs = match options.regularization {
                    Regularization::None => continue,
                    Regularization::Default => spline_beliefs(camera.params.len()),
                    Regularization::Mrcal22 => {
                        mrcal_spline_beliefs(&grid, n_rows, n_cameras, camera.image_size)
                    }
                };
                // mrcal has these rows for parameters that it solves for, so that others cost nothing.
                beliefs.retain(|belief| {
                    let mut columns = belief.factors.iter().map(|&(column, _)| column);
                    columns.any(|column| is_open(column) && !self.parameters.is_held(blocks.lens, column))
                });
                self.sparse_priors.push(SparsePrior::new(blocks.lens, camera.params.len(), beliefs));
                continue;
            }
            let mut rows = match options.regularization {
                Regularization::None => Vec::new(),
                Regularization::Default => default_rows(&camera.model.param_groups()),
                Regularization::Mrcal22 => {
                    let is_rational = camera.model.param_groups().contains(&ParamGroup::Rational);
                    let n_params = camera.params.len();
                    mrcal22_rows(n_rows, n_cameras, n_params, is_rational, camera.image_size)
                }
            };
            rows.retain(|(column, ..)| is_open(*column));
            if !rows.is_empty() {
                self.priors.push(VectorPrior::new(blocks.lens, rows));
            }
        }
    }

    /// Returns what the regularisation adds to the cost where the parameters are.
    pub(crate) fn regularization_cost(&self) -> f64 {
        let values = self.parameters.values();
        let mild: f64 = self.priors.iter().map(|prior| prior.cost(values)).sum();
        let sparse: f64 = self.sparse_priors.iter().map(|prior| prior.cost(values)).sum();
        mild + sparse
    }
}

/// Returns what is believed of a lens with local support before a problem is there; mild beliefs where
/// nothing is asked for.
pub(crate) fn spline_regularization(
    dataset: &Dataset,
    rig: &Rig,
    camera: &Camera,
    regularization: Regularization,
) -> Vec<Belief> {
    let n_rows = dataset.views.iter().map(|view| 2 * view.observations.len()).sum();
    match camera.model.local_support() {
        Some(grid) if regularization == Regularization::Mrcal22 => {
            mrcal_spline_beliefs(&grid, n_rows, rig.cameras.iter().flatten().count(), camera.image_size)
        }
        _ => spline_beliefs(camera.params.len()),
    }
}

/// Returns mild beliefs about the parameters that data alone constrain badly.
fn default_rows(groups: &[ParamGroup]) -> Vec<(usize, f64, f64)> {
    let is_rational = groups.contains(&ParamGroup::Rational);
    let sigma = |group: &ParamGroup| match group {
        // In a rational lens the numerator trades against the denominator.
        ParamGroup::Radial if is_rational => Some(RATIONAL_SIGMA),
        ParamGroup::Rational => Some(RATIONAL_SIGMA),
        ParamGroup::ThinPrism | ParamGroup::Tilt => Some(PRISM_AND_TILT_SIGMA),
        _ => None,
    };
    groups.iter().enumerate().filter_map(|(i, group)| Some((i, 0.0, 1.0 / sigma(group)?))).collect()
}

/// Returns mild beliefs about the knots of a spline, many of which may be seen by nothing.
fn spline_beliefs(n_params: usize) -> Vec<Belief> {
    (4..n_params).map(|column| Belief { factors: vec![(column, 1.0 / SPLINE_SIGMA)], mean: 0.0 }).collect()
}

/// Returns the regularisation rows of mrcal up to 2.5.2 for a splined lens, whose residuals are in pixels.
///
/// The scale of the knots is 0.2; across the direction from the centre of the grid they weigh ten times
/// as much as along it.
fn mrcal_spline_beliefs(
    grid: &LocalSupport,
    n_rows: usize,
    n_cameras: usize,
    image_size: [u32; 2],
) -> Vec<Belief> {
    let share = n_rows as f64 * 0.005 / 2.0 / n_cameras as f64;
    let n_knots = grid.columns * grid.rows;
    let along = (share / (2.0 * n_knots as f64 * 0.2 * 0.2)).sqrt();
    let mut beliefs = Vec::new();
    for knot in 0..n_knots {
        let (row, column) = (knot / grid.columns, knot % grid.columns);
        let x = 2.0 * column as f64 + 1.0 - grid.columns as f64;
        let y = 2.0 * row as f64 + 1.0 - grid.rows as f64;
        let length = x.hypot(y);
        let (x, y, across) =
            if length > 0.0 { (x / length, y / length, 10.0 * along) } else { (1.0, 0.0, along) };
        let first = 4 + 2 * knot;
        beliefs.push(Belief { factors: vec![(first, along * x), (first + 1, along * y)], mean: 0.0 });
        beliefs.push(Belief { factors: vec![(first, across * y), (first + 1, -across * x)], mean: 0.0 });
    }
    let centre = (share / (2.0 * 500.0 * 500.0)).sqrt();
    for (axis, &size) in image_size.iter().enumerate() {
        let mean = centre * (f64::from(size) - 1.0) / 2.0;
        beliefs.push(Belief { factors: vec![(2 + axis, centre)], mean });
    }
    beliefs
}
