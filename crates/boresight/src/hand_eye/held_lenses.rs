//! Lenses that an answer holds as the cameras' own calibration has them: how well they are known there is carried into it.
//!
//! The covariance of an answer is then that of all else, x, for given lenses l. With Σ from the cameras' own calibration,
//! Cov(x, l) = G Σ and Cov(x) = Cov(x | l) + G Σ Gᵀ, where G = C_xl C_ll⁻¹ is how x follows the lenses: C is the joint
//! covariance of an adjustment in which they are free. These are eqs. 2.81 and 2.82 of Bishop 2006 for a Gaussian, read
//! backwards.

use std::collections::BTreeMap;

use boresight_data::{Calibration, Dataset, Motions, Uncertainty};
use boresight_geometry::Vector3;
use boresight_geometry::nalgebra::DMatrix;

/// Gives an answer with held lenses the covariance of these, and of all else with them.
///
/// `free` is of an adjustment that differs from the answer in its free lenses alone, `own` of the cameras' calibration.
/// Where one of them has no covariance, the answer keeps its own, in which lenses are not.
pub(super) fn carry(answer: &mut Calibration, free: &Uncertainty, own: &Uncertainty, dataset: &Dataset) {
    let placed = answer.scene.rig.cameras.enumerate();
    let places = placed.filter_map(|(camera, placed)| {
        Some((dataset.cameras[camera].name.as_str(), placed.as_ref()?.cam_from_rig.translation))
    });
    if let Some(carried) = carried(&answer.uncertainty, free, own, &places.collect()) {
        answer.uncertainty = carried;
    }
}

/// Returns the covariance with the lenses in it; `None` where the three are not of the same parameters.
fn carried(
    held: &Uncertainty,
    free: &Uncertainty,
    own: &Uncertainty,
    places: &BTreeMap<&str, Vector3<f64>>,
) -> Option<Uncertainty> {
    let (n, n_all) = (free.names.len(), free.names.len() + free.motions.names.len());
    let (of_held, of_free, of_own) = (joint(held)?, joint(free)?, joint(own)?);
    let own_place = |name: &String| own.names.iter().position(|own| own == name);
    // Where everything of `free` is in the answer; what is nowhere there is of a lens.
    let names = || free.names.iter().chain(&free.motions.names);
    let held_names: Vec<&String> = held.names.iter().chain(&held.motions.names).collect();
    let held_places: Vec<Option<usize>> =
        names().map(|name| held_names.iter().position(|held| *held == name)).collect();
    let lens: Vec<usize> = (0..n_all).filter(|i| held_places[*i].is_none()).collect();
    let rest: Vec<usize> = (0..n_all).filter(|i| held_places[*i].is_some()).collect();
    let own_places: Vec<usize> =
        lens.iter().map(|i| own_place(names().nth(*i)?)).collect::<Option<Vec<usize>>>()?;
    if rest.len() != held_names.len() {
        return None;
    }
    let sigma = of_own.select_rows(&own_places).select_columns(&own_places);
    let free_lens = of_free.select_rows(&lens).select_columns(&lens);
    let across = of_free.select_rows(&lens).select_columns(&rest);
    let follows = free_lens.cholesky()?.solve(&across).transpose();
    let with_lens = &follows * &sigma;
    let by_lens = &with_lens * follows.transpose();
    let mut all = DMatrix::zeros(n_all, n_all);
    for (a, &i) in lens.iter().enumerate() {
        lens.iter().enumerate().for_each(|(b, &j)| all[(i, j)] = sigma[(a, b)]);
    }
    for (a, &i) in rest.iter().enumerate() {
        for (b, &j) in lens.iter().enumerate() {
            (all[(i, j)], all[(j, i)]) = (with_lens[(a, b)], with_lens[(a, b)]);
        }
        for (b, &j) in rest.iter().enumerate() {
            all[(i, j)] =
                of_held[(held_places[i]?, held_places[j]?)] + 0.5 * (by_lens[(a, b)] + by_lens[(b, a)]);
        }
    }
    let entries = |rows: std::ops::Range<usize>, n_columns: usize| -> Vec<f64> {
        rows.flat_map(|i| (0..n_columns).map(move |j| (i, j))).map(|place| all[place]).collect()
    };
    let mut carried = Uncertainty {
        names: free.names.clone(),
        covariance: entries(0..n, n),
        motions: Motions { names: free.motions.names.clone(), covariance: entries(n..n_all, n_all) },
        regularization_information: free.regularization_information.clone(),
        regularization_pairs: free.regularization_pairs.clone(),
        ..held.clone()
    };
    let baselines_m = held.baselines_m.iter().map(|(camera, [length, sigma])| {
        let known = places.get(camera.as_str()).and_then(|place| carried.baseline_sigma_m(camera, place));
        (camera.clone(), [*length, known.unwrap_or(*sigma)])
    });
    carried.baselines_m = baselines_m.collect();
    Some(carried)
}

/// Returns the joint covariance of parameters and motions, or `None` without one.
fn joint(uncertainty: &Uncertainty) -> Option<DMatrix<f64>> {
    let (n, n_motions) = (uncertainty.names.len(), uncertainty.motions.names.len());
    let is_there = n > 0 && uncertainty.covariance.len() == n * n;
    let has_motions = uncertainty.motions.covariance.len() == n_motions * (n + n_motions);
    (is_there && has_motions).then(|| {
        DMatrix::from_fn(n + n_motions, n + n_motions, |i, j| {
            let (high, low) = (i.max(j), i.min(j));
            match high < n {
                true => uncertainty.covariance[i * n + j],
                false => uncertainty.motions.covariance[(high - n) * (n + n_motions) + low],
            }
        })
    })
}
