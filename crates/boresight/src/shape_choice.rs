//! Whether the targets' shapes help: decided on views that took no part.

use boresight_camera::{Camera, Model};
use boresight_data::{CameraId, Dataset, Shape};
use rayon::prelude::*;

use crate::select::as_one_camera;
use crate::trial::{Fit, Terms, Trial, ViewErrors, excess, rms_px, without};

/// Whether the shape of the targets helps, and why.
#[derive(Clone, Debug, PartialEq)]
pub struct ShapeSelection {
    /// Whether views that took no part are predicted better with it, by more than a standard error.
    pub helps: bool,
    /// The root of the mean squared distance of corners in views that took no part, in pixels, with the shape.
    pub with_px: f64,
    /// The same without.
    pub without_px: f64,
    /// Both in a sentence.
    pub why: String,
}

/// Tells whether the shapes of the targets of `dataset` help; `models` are the lens models of its cameras, and `known`
/// the lenses that are known.
///
/// Cameras are judged one by one, as what a board's bow does to a view does not depend on the others.
pub(crate) fn choose_shape(
    dataset: &Dataset,
    models: &[Model],
    known: &[(CameraId, Camera)],
    terms: Terms<'_>,
) -> ShapeSelection {
    let mut flat = dataset.clone();
    flat.targets.iter_mut().for_each(|target| target.shape = Shape::Rigid);
    let cameras: Vec<(CameraId, Model)> = dataset.cameras.ids().zip(models.iter().copied()).collect();
    let tried: Vec<Option<[ViewErrors; 2]>> = cameras
        .par_iter()
        .map(|&(camera, model)| {
            let lens = known.iter().find(|(id, _)| *id == camera).map(|(_, lens)| lens);
            let name = dataset.cameras[camera].name.as_str();
            let fits = [dataset, &flat].map(|dataset| {
                let alone = as_one_camera(dataset, &[camera]);
                let fit = Fit::new(&alone, &[name], model, lens, terms).ok()?;
                Some((alone, fit))
            });
            let [Some((bent, with)), Some((flat, without_shape))] = fits else { return None };
            // What both reject is wrong; what one rejects may be what it cannot explain.
            let outliers = &with.outliers & &without_shape.outliers;
            let views = |alone: &Dataset, fit: &Fit| {
                Trial::new(&without(alone, &outliers), fit).ok().map(|trial| trial.views)
            };
            Some([views(&bent, &with)?, views(&flat, &without_shape)?])
        })
        .collect();
    // The views of all cameras one after another.
    let all = |which: usize| -> ViewErrors {
        tried.iter().flatten().flat_map(|both| both[which].iter().copied()).collect()
    };
    let (with, without_shape) = (all(0), all(1));
    let (mean, error) = excess(&without_shape, &with);
    let helps = mean > error;
    let (with_px, without_px) = (rms_px(&with), rms_px(&without_shape));
    let why = if with.is_empty() {
        "too little was seen to tell whether the target's shape helps: it is left out".to_owned()
    } else {
        format!(
            "views that took no part are predicted to {with_px:.4} px with the target's shape and to {without_px:.4} px without: it {}",
            if helps { "helps" } else { "does not help and is left out" }
        )
    };
    ShapeSelection { helps, with_px, without_px, why }
}
