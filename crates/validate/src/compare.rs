//! The difference of two cameras, over the image and in pixels.
//!
//! Two calibrations of one camera never agree on where its axis points: a turn of the camera frame
//! trades against the principal point, and the poses of the boards make up for it. Only what no
//! turn explains is a difference of the lenses. So the difference at a pixel is taken after an
//! *implied transform* `b_from_a`, which is fitted: a rotation for points at infinity, a pose for
//! points at a distance.
//!
//! **Definition.** With `a(q)` the point that camera a sees at pixel q (at the distance, or its unit
//! direction), `A` its projection, and likewise for b, the residuals one way and the other are
//!
//! ```text
//! r_ab(q) = B(b_from_a a(q)) - B(b(q))        r_ba(q) = A(a_from_b b(q)) - A(a(q))
//! ```
//!
//! (`B(b(q))` is q but for rounding; written so, equal cameras differ by exactly zero). The
//! transform minimises the robust sum of both over the focus region, and the difference at q is
//! `(r_ab - r_ba) / 2`. Both are symmetric by construction: exchanging the cameras inverts the
//! transform and negates the map. mrcal reports `r_ab` alone; to first order it is the same.
//!
//! **Focus region.** Without uncertainties nothing tells where to trust the lenses, so the default
//! is the disc inscribed in the image. It leaves out the corners: there lenses are extrapolated
//! and differ most, over a broad and smooth area that no robust loss can tell from the rest. It
//! keeps the rest, because a smaller disc leaves the turn about the axis to a short lever (mrcal's
//! disc has a third of this radius: a turn that is off by 0.01 px at its rim is off by 0.05 px in a corner).
//! The loss is quadratic below a pixel and linear above, hence convex in the residuals.

pub(crate) mod grid;
mod implied;
mod rigs;
mod significance;

use std::cmp::Ordering;

use boresight_camera::Camera;
use boresight_geometry::{Pose, Vector3};
use serde::{Deserialize, Serialize};

use crate::Error;
use crate::statistics::quantile;
use grid::Grid;
use implied::{Eyes, MIN_POINTS, Sight, fit_implied};
pub use rigs::{
    CameraComparison, ComparedCamera, PairDifference, RigComparison, compare_known_rigs, compare_rigs,
};
pub use significance::{PoseSignificance, Significance, TransferDifference};

/// A fit whose last step moved the pixels by more than this has not found its minimum.
const UNSETTLED_PX: f64 = 1e-6;

/// How to compare two cameras.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CompareOptions {
    /// The number of grid points across the image, 2 to 1000; that of rows follows from the aspect ratio.
    pub columns: usize,
    /// The distance from the cameras at which points are compared, in metres, after a pose fitted
    /// there; `None` compares directions after a rotation, that is, points at infinity.
    pub distance_m: Option<f64>,
    /// The radius in pixels of the disc about the image's middle over which the implied transform
    /// is fitted; `None` is half the smaller side. mrcal's default is a sixth of the smaller side;
    /// any radius beyond half the diagonal takes the whole image.
    pub focus_radius_px: Option<f64>,
}

impl Default for CompareOptions {
    fn default() -> Self {
        Self { columns: 60, distance_m: None, focus_radius_px: None }
    }
}

/// The difference of two cameras a and b.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Comparison {
    /// Width and height of both images in pixels.
    pub image_size: [u32; 2],
    /// The number of grid points across; the first and last are on the image's outermost pixels.
    pub columns: usize,
    /// The number of grid points down.
    pub rows: usize,
    /// By how many pixels, in u and v, camera b sees elsewhere what camera a sees at each grid
    /// point, row by row; `None` where either has no ray, or does not see the other's: not at all,
    /// only beyond its fold, or further away than the image's diagonal.
    pub differences_px: Vec<Option<[f64; 2]>>,
    /// The number of grid points without a difference.
    pub missing: usize,
    /// The root mean square length of the differences, in pixels.
    pub rms_px: f64,
    /// The length that 95 % of the differences do not exceed, in pixels.
    pub p95_px: f64,
    /// The largest length of a difference, in pixels.
    pub max_px: f64,
    /// The root mean square length of the differences within the focus region, in pixels.
    pub focus_rms_px: f64,
    /// The radius in pixels of the disc over which the transform was fitted.
    pub focus_radius_px: f64,
    /// The distance of the points compared in metres; `None` is infinity.
    pub distance_m: Option<f64>,
    /// The rotation of the implied transform `b_from_a`: axis times angle in radians.
    pub rotation_rad: [f64; 3],
    /// The translation of the implied transform `b_from_a` in metres; zero at infinity.
    pub translation_m: [f64; 3],
    /// The steps the fit of the transform took.
    pub fit_steps: usize,
    /// By how much the last step moved the pixels of the focus region (root mean square); the fit
    /// is exact to about this much.
    pub fit_last_step_px: f64,
}

impl Comparison {
    /// Returns the implied transform.
    pub fn b_from_a(&self) -> Pose {
        Pose::from_rodrigues(Vector3::from(self.rotation_rad), Vector3::from(self.translation_m))
    }

    /// Returns the comparison of b with a.
    fn reversed(mut self) -> Self {
        let a_from_b = self.b_from_a().inverse();
        self.rotation_rad = self.rotation_rad.map(|component| -component);
        self.translation_m = a_from_b.translation.into();
        for difference in self.differences_px.iter_mut().flatten() {
            *difference = difference.map(|component| -component);
        }
        self
    }

    /// Returns each grid point's pixel with the difference there, row by row.
    pub fn points(&self) -> impl Iterator<Item = ([f64; 2], Option<[f64; 2]>)> {
        let grid = Grid { image_size: self.image_size, columns: self.columns, rows: self.rows };
        self.differences_px.iter().enumerate().map(move |(i, difference)| (grid.pixel(i), *difference))
    }
}

/// Returns how far two cameras with images of one size differ, apart from the implied transform.
///
/// The result is the same every time; exchanging the cameras negates the differences and inverts
/// the transform; a camera does not differ from itself at all.
pub fn compare(a: &Camera, b: &Camera, options: &CompareOptions) -> Result<Comparison, Error> {
    // The definition is symmetric; rounding is not, and where lenses have so little in common that
    // there are several minima, neither is the way to one of them.
    let order = a.model.name().cmp(b.model.name()).then_with(|| {
        let params = a.params.iter().zip(&b.params).map(|(one, other)| one.total_cmp(other));
        params.fold(Ordering::Equal, Ordering::then)
    });
    match order {
        Ordering::Greater => {
            compare_in_order(b, a, options).map(Comparison::reversed).map_err(Error::reversed)
        }
        _ => compare_in_order(a, b, options),
    }
}

fn compare_in_order(a: &Camera, b: &Camera, options: &CompareOptions) -> Result<Comparison, Error> {
    let grid = Grid::new(a, b, options)?;
    let distance = options.distance_m;
    if let Some(value) = distance.filter(|distance| !(*distance > 0.0 && distance.is_finite())) {
        return Err(Error::NotPositive { option: "distance_m", value });
    }
    let focus_radius_px = match options.focus_radius_px {
        None => 0.5 * f64::from(a.image_size[0].min(a.image_size[1])),
        Some(radius) if radius > 0.0 && radius.is_finite() => radius,
        Some(value) => return Err(Error::NotPositive { option: "focus_radius_px", value }),
    };

    let eyes = Eyes::new(a, b);
    let sights: Vec<Option<Sight>> =
        (0..grid.len()).map(|i| eyes.sight(grid.pixel(i), distance.unwrap_or(1.0))).collect();
    let is_in_focus: Vec<bool> = (0..grid.len()).map(|i| grid.radius(i) <= focus_radius_px).collect();
    let focus: Vec<Sight> = sights
        .iter()
        .zip(&is_in_focus)
        .filter(|(_, is_in)| **is_in)
        .filter_map(|(sight, _)| *sight)
        .collect();
    let too_few = |found| Error::TooFewPoints {
        found,
        tried: is_in_focus.iter().filter(|is_in| **is_in).count(),
        need: MIN_POINTS,
        focus_radius_px,
    };
    let fit = fit_implied(eyes, &focus, distance).map_err(|few| too_few(few.found))?;
    if fit.last_step_px > UNSETTLED_PX {
        return Err(Error::NoTransform { steps: fit.steps, last_step_px: fit.last_step_px });
    }
    let n_seen = focus.iter().filter(|sight| eyes.seen_residuals(sight, &fit.b_from_a).is_some()).count();
    if n_seen < MIN_POINTS {
        return Err(too_few(n_seen));
    }

    let difference = |sight: &Option<Sight>| {
        let [ab, ba] = eyes.seen_residuals(sight.as_ref()?, &fit.b_from_a)?;
        Some([0, 1].map(|axis| 0.5 * (ab[axis] - ba[axis])))
    };
    let differences_px: Vec<Option<[f64; 2]>> = sights.iter().map(difference).collect();
    let lengths: Vec<f64> = differences_px.iter().flatten().map(|[u, v]| u.hypot(*v)).collect();
    let focus_lengths = differences_px.iter().zip(&is_in_focus).filter(|(_, is_in)| **is_in);
    Ok(Comparison {
        image_size: grid.image_size,
        columns: grid.columns,
        rows: grid.rows,
        missing: differences_px.len() - lengths.len(),
        rms_px: root_mean_square(lengths.iter().copied()),
        p95_px: quantile(lengths.iter().copied(), 0.95).unwrap_or(0.0),
        max_px: lengths.iter().copied().fold(0.0, f64::max),
        focus_rms_px: root_mean_square(focus_lengths.filter_map(|(d, _)| *d).map(|[u, v]| u.hypot(v))),
        focus_radius_px,
        differences_px,
        distance_m: distance,
        rotation_rad: fit.b_from_a.rodrigues().into(),
        translation_m: fit.b_from_a.translation.into(),
        fit_steps: fit.steps,
        fit_last_step_px: fit.last_step_px,
    })
}

fn root_mean_square(values: impl Iterator<Item = f64>) -> f64 {
    let (n, sum) = values.fold((0usize, 0.0), |(n, sum), value| (n + 1, sum + value * value));
    if n == 0 { 0.0 } else { (sum / n as f64).sqrt() }
}

#[cfg(test)]
mod tests;
