//! Knots of a spline that are hardly known.

use boresight_data::Severity;

use super::case::Case;
#[cfg(test)]
use super::example::Example;
use super::{Diagnostic, Found};

/// The sigma of a knot, in focal lengths, above which what it does is far from linear. Of synthetic splines with such knots
/// everything scattered up to three times as much as was stated, without them as stated.
const LOOSE: f64 = 0.1;
/// Knots of which at least this share is believed are touched by next to no corner, and change no projection of one.
const BELIEVED: f64 = 0.9;

/// Knots of a spline that are hardly known.
pub(super) struct LooseKnots;

impl Diagnostic for LooseKnots {
    const CODE: &'static str = "loose-knots";

    const EXPLANATION: &'static str = "\
What it means: some numbers of a splined lens have corners near them, and yet a
sigma of more than a tenth of the focal length: a few corners at the rim of what
was seen are all that tells them.

Why it matters: sigmas and uncertainties assume that the lens follows small
errors in proportion. Where a knot may be anywhere it does not, and it pulls the
rest of the surface along: noise drawn anew moved all knots up to three times as
far as was stated. Held-out error and `boresight validate`, which compares odd
and even frames, do not assume that.

How to fix it: take fewer knots, or more views with the board at the rim of the
image and beyond it. Where the spline reaches far beyond the image, give it a
smaller field of view.";

    fn find(case: &Case) -> Vec<Found> {
        let found = case.cameras().filter_map(|(_, name, placed)| {
            let grid = placed.camera.model.local_support()?;
            let params = placed.camera.model.param_names().into_iter().skip(4);
            let names: Vec<String> = params.map(|param| format!("{name}.{param}")).collect();
            let is_loose = |name: &&String| {
                let is_told = |share: f64| share < BELIEVED;
                case.sigma(name).is_some_and(|sigma| sigma > LOOSE)
                    && case.calibration.uncertainty.believed_share(name).is_some_and(is_told)
            };
            let loose = names.iter().filter(is_loose).count();
            (loose > 0).then(|| Found {
                severity: Severity::Caution,
                place: name.to_owned(),
                message: format!(
                    "{loose} of the {} numbers of its {} x {} knots are known to no better than a tenth of the focal \
                     length: uncertainties of this lens may be several times too small",
                    names.len(),
                    grid.columns,
                    grid.rows
                ),
                measured: Some(loose as f64),
                limit: Some(0.0),
                fix: "Take fewer knots, or more views with the board at the rim of the image.".to_owned(),
            })
        });
        found.collect()
    }

    #[cfg(test)]
    fn examples() -> Vec<(Example, Severity)> {
        let mut example = Example::mono();
        let placed = example.calibration.scene.rig.cameras.iter_mut().flatten().next().unwrap();
        let mut params = placed.camera.params[..4].to_vec();
        params.resize(4 + 24, 0.0);
        placed.camera.model = "splined2:4x3:100deg".parse().unwrap();
        placed.camera.params = params;
        let uncertainty = &mut example.calibration.uncertainty;
        uncertainty.names =
            placed.camera.model.param_names().iter().map(|name| format!("cam0.{name}")).collect();
        let n = uncertainty.names.len();
        // One that corners tell a little, and one that is believed alone.
        uncertainty.covariance = vec![0.0; n * n];
        for i in 0..n {
            let sigma: f64 = match i {
                9 => 0.2,
                11 => 1.0,
                _ => 0.01,
            };
            uncertainty.covariance[i * (n + 1)] = sigma * sigma;
        }
        uncertainty.regularization_information = (0..n).map(|i| if i < 4 { 0.0 } else { 1.0 }).collect();
        vec![(example, Severity::Caution)]
    }
}
