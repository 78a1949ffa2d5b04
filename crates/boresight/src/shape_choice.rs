//! Which shape of the targets helps: decided on views that took no part.

use std::collections::BTreeSet;

use boresight_camera::{Camera, Model};
use boresight_data::{CameraId, Dataset, PointId, Shape};
use rayon::prelude::*;

use crate::calibrate::set_shape;
use crate::select::as_one_camera;
use crate::trial::{Fit, Terms, Trial, ViewErrors, comparable_rms_px, excess, without};

/// Which shape of the targets helps, and why.
#[derive(Clone, Debug, PartialEq)]
pub struct ShapeSelection {
    /// The shape with the fewest coefficients of those that predict views that took no part about as well as any: one with
    /// more must predict them better by more than a standard error.
    pub shape: Shape,
    /// The root of the mean squared distance of corners in views that took no part, in pixels, with each shape tried; over
    /// the views that all of them kept.
    pub held_out_px: Vec<(Shape, f64)>,
    /// Both in a sentence.
    pub why: String,
}

/// Tells which of `shapes` of the targets of `dataset` helps; `models` are the lens models of its cameras, and `known`
/// the lenses that are known. The first of the shapes has no coefficients.
///
/// Cameras are judged one by one, as what a board's shape does to a view does not depend on the others.
pub(crate) fn choose_shape(
    dataset: &Dataset,
    shapes: &[Shape],
    models: &[Model],
    known: &[(CameraId, Camera)],
    terms: Terms<'_>,
) -> ShapeSelection {
    let shaped: Vec<Dataset> = shapes
        .iter()
        .map(|&shape| {
            let mut dataset = dataset.clone();
            set_shape(&mut dataset, shape);
            dataset
        })
        .collect();
    let cameras: Vec<(CameraId, Model)> = dataset.cameras.ids().zip(models.iter().copied()).collect();
    let mut tried: Vec<(&str, Vec<Option<ViewErrors>>)> = cameras
        .par_iter()
        .map(|&(camera, model)| {
            let lens = known.iter().find(|(id, _)| *id == camera).map(|(_, lens)| lens);
            let name = dataset.cameras[camera].name.as_str();
            let fit = |dataset: &Dataset| {
                let alone = as_one_camera(dataset, &[camera]);
                let fit = Fit::new(&alone, &[name], model, lens, terms).ok()?;
                Some((alone, fit))
            };
            let fits: Vec<Option<(Dataset, Fit)>> = shaped.par_iter().map(fit).collect();
            // What all reject is wrong; what one rejects may be what it cannot explain.
            let rejected = fits.iter().flatten().map(|(_, fit)| fit.outliers.clone());
            let outliers: BTreeSet<(usize, PointId)> = rejected.reduce(|a, b| &a & &b).unwrap_or_default();
            let trial = |fit: &Option<(Dataset, Fit)>| {
                let (alone, fit) = fit.as_ref()?;
                Trial::new(&without(alone, &outliers), fit).ok().map(|trial| trial.views)
            };
            (name, fits.par_iter().map(trial).collect())
        })
        .collect();
    // A camera that saw too little even for a bend along each side tells nothing of shapes.
    tried.retain(|(_, by_shape)| by_shape.iter().take(2).all(Option::is_some));
    // The views of all cameras one after another, where all cameras have them.
    let all = |which: usize| -> Option<ViewErrors> {
        let views: Option<Vec<&ViewErrors>> =
            tried.iter().map(|(_, by_shape)| by_shape[which].as_ref()).collect();
        Some(views?.into_iter().flatten().copied().collect())
    };
    let views: Vec<(Shape, ViewErrors)> =
        shapes.iter().enumerate().filter_map(|(which, &shape)| Some((shape, all(which)?))).collect();
    let mut selection = select(&views);
    for (which, shape) in shapes.iter().enumerate() {
        let without = tried.iter().filter(|(_, by_shape)| by_shape[which].is_none());
        let names: Vec<&str> = without.map(|(name, _)| *name).collect();
        if !names.is_empty() {
            let (n, names) = (shape.coefficient_count(), names.join(", "));
            selection.why += &format!("; {n} were not tried, as {names} saw too little for them");
        }
    }
    selection
}

/// Chooses by the errors of views that took no part.
fn select(views: &[(Shape, ViewErrors)]) -> ShapeSelection {
    let (shapes, errors): (Vec<Shape>, Vec<&ViewErrors>) =
        views.iter().map(|(shape, views)| (*shape, views)).unzip();
    let held_out_px: Vec<(Shape, f64)> = shapes.into_iter().zip(comparable_rms_px(&errors)).collect();
    let mut chosen: Option<&(Shape, ViewErrors)> = None;
    for rival in views.iter().filter(|(_, views)| views.iter().any(Option::is_some)) {
        let is_better = chosen.is_none_or(|(_, known)| {
            let (mean, error) = excess(known, &rival.1);
            mean > error
        });
        if is_better {
            chosen = Some(rival);
        }
    }
    let Some(&(shape, _)) = chosen else {
        let why = "too little was seen to tell whether the target's shape helps: it is left out".to_owned();
        return ShapeSelection { shape: Shape::Rigid, held_out_px, why };
    };
    let said = held_out_px.iter().map(|(shape, px)| match shape.coefficient_count() {
        0 => format!("to {px:.4} px with the target as drawn"),
        n => format!("to {px:.4} px with {n} shape coefficients"),
    });
    let said: Vec<String> = said.collect();
    let why = format!(
        "views that took no part are predicted {}: {}",
        said.join(", "),
        match shape.coefficient_count() {
            0 => "the shape does not help and is left out".to_owned(),
            n => format!("{n} help"),
        }
    );
    ShapeSelection { shape, held_out_px, why }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Checks what is chosen where views have these sums of squares with each shape.
    fn check(by_shape: &[&[f64]], expected: Shape) {
        let views = |squares: &&[f64]| squares.iter().map(|square| Some((*square, 50))).collect();
        let views: Vec<(Shape, ViewErrors)> =
            Shape::ALL.into_iter().zip(by_shape.iter().map(views)).collect();
        let selection = select(&views);
        assert_eq!(selection.shape, expected, "{}", selection.why);
    }

    #[test]
    fn more_coefficients_must_help_by_more_than_a_standard_error() {
        let flat = [9.0, 10.0, 9.5, 10.5];
        let better = [8.0, 9.1, 8.4, 9.4];
        let best = [7.0, 8.1, 7.4, 8.4];
        let as_good = [9.05, 9.9, 9.45, 10.6];
        check(&[&flat, &better, &best], Shape::Twisted6);
        check(&[&flat, &better, &better], Shape::Parabolic2);
        check(&[&flat, &as_good, &as_good], Shape::Rigid);
        // What is twisted alone is not told by bends.
        check(&[&flat, &as_good, &best], Shape::Twisted6);
        check(&[&flat, &better], Shape::Parabolic2);
        check(&[&[], &[], &[]], Shape::Rigid);
        check(&[], Shape::Rigid);
    }
}
