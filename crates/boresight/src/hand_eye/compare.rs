//! All methods side by side, as they foretell frames that were left out.

use boresight_adjust::{HeldOut, SightErrors, sight_errors};
use boresight_data::{Dataset, Mounting, Scene};
use boresight_geometry::Vector3;
use boresight_io::RobotAxes;
use boresight_seed::hand_eye::{PosePair, hand_eye as closed_form, pose_pair};
use rayon::prelude::*;
use serde::Serialize;

use super::{FrameTold, methods_for};

/// How well a method foretells frames that were left out.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MethodFigures {
    /// The method.
    pub name: String,
    /// The figures; `None` if the method failed.
    pub figures: Option<Figures>,
}

/// Distances between points and where the rays of their pixels meet the target, in frames left out.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Figures {
    /// The mean.
    pub mean_m: f64,
    /// The 95th percentile.
    pub p95_m: f64,
    /// The largest.
    pub max_m: f64,
    /// The root mean square distance in the image.
    pub rms_px: f64,
}

impl MethodFigures {
    /// Returns the figures of an adjustment.
    pub(super) fn of(name: &str, held_out: &[HeldOut]) -> Self {
        let mut errors = SightErrors::default();
        held_out.iter().for_each(|held_out| errors.add(held_out.errors.clone()));
        Self { name: name.to_owned(), figures: Figures::of(errors) }
    }
}

impl Figures {
    fn of(mut errors: SightErrors) -> Option<Self> {
        errors.distances_m.sort_by(f64::total_cmp);
        let n = errors.distances_m.len();
        let max_m = *errors.distances_m.last()?;
        if !max_m.is_finite() {
            return None;
        }
        let square: f64 = errors.distances_px.iter().map(|distance| distance * distance).sum();
        Some(Self {
            mean_m: mean(&errors.distances_m),
            p95_m: errors.distances_m[(n * 95 / 100).min(n - 1)],
            max_m,
            rms_px: (square / n as f64).sqrt(),
        })
    }
}

/// Returns the mean; zero of none.
pub(super) fn mean(numbers: &[f64]) -> f64 {
    numbers.iter().sum::<f64>() / numbers.len().max(1) as f64
}

/// Returns the figures of all closed forms, with lenses and sights from the cameras' own calibration of all
/// frames, the ones left out included.
pub(super) fn closed_forms(
    dataset: &Dataset,
    scene: &Scene,
    mounting: Mounting,
    frames: &[FrameTold],
    axes: RobotAxes,
) -> Vec<MethodFigures> {
    let pairs: Vec<PosePair> = frames
        .iter()
        .map(|told| pose_pair(mounting, &told.base_from_flange, &told.rig_from_target))
        .collect();
    let figures = |method| {
        let foretold = frames.par_iter().enumerate().map(|(i, told)| {
            let mut others = pairs.clone();
            others.remove(i);
            let rig_from_target = closed_form(&others, method)?.rig_from_target(&pairs[i].other_from_carrier);
            let views = dataset.views.iter().filter(|view| view.frame == told.frame);
            Some(views.map(|view| sight_errors(dataset, scene, view, &rig_from_target)).collect())
        });
        let foretold: Vec<Vec<SightErrors>> = foretold.collect::<Option<_>>()?;
        let mut errors = SightErrors::default();
        foretold.into_iter().flatten().for_each(|of_view| errors.add(of_view));
        Figures::of(errors)
    };
    methods_for(axes)
        .iter()
        .map(|&method| MethodFigures { name: method.name().to_owned(), figures: figures(method) })
        .collect()
}

/// Returns the median of numbers, NaN of none.
pub(super) fn median(numbers: &[f64]) -> f64 {
    let mut sorted = numbers.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN)
}

/// Returns the length of a vector of sigmas.
pub(super) fn length(sigmas: [f64; 3]) -> f64 {
    Vector3::from(sigmas).norm()
}
