//! Whether points can determine a calibration matrix at all.

use boresight_geometry::nalgebra::DMatrix;
use boresight_geometry::{Matrix3, Vector3};

use super::{Error, MIN_POINTS, MIN_THICKNESS, PointPair};

/// Checks that the points are finite, enough, and that neither all nor all but one lie in a plane.
pub(super) fn check_points(pairs: &[PointPair]) -> Result<(), Error> {
    let is_finite = |pair: &PointPair| pair.point_in_ref.iter().chain(&pair.pixel).all(|x| x.is_finite());
    if let Some(index) = pairs.iter().position(|pair| !is_finite(pair)) {
        return Err(Error::PointNotFinite { index });
    }
    let mut distinct: Vec<[f64; 3]> = pairs.iter().map(|pair| pair.point_in_ref.into()).collect();
    distinct.sort_by(|a, b| a.partial_cmp(b).unwrap_or(std::cmp::Ordering::Equal));
    distinct.dedup();
    if distinct.len() < MIN_POINTS {
        return Err(Error::TooFewPoints { found: distinct.len(), need: MIN_POINTS });
    }
    let ratio = thickness(&distinct);
    if ratio < MIN_THICKNESS {
        return Err(Error::Coplanar { ratio, limit: MIN_THICKNESS });
    }
    check_without_each(pairs, &distinct)
}

/// Returns the thinnest extent of the points over their widest.
fn thickness(points: &[[f64; 3]]) -> f64 {
    let mean = mean(points);
    let offsets: Vec<f64> =
        points.iter().flat_map(|&point| <[f64; 3]>::from(Vector3::from(point) - mean)).collect();
    // Singular values, not the eigenvalues of the scatter, which would be good to 1e-8 only.
    let extents = DMatrix::from_column_slice(3, points.len(), &offsets).singular_values();
    extents[2] / extents[0]
}

/// Checks that no single point is all that keeps the points from lying in a plane.
///
/// Such points satisfy the linear system in two ways: the second maps the whole plane to nothing.
fn check_without_each(pairs: &[PointPair], distinct: &[[f64; 3]]) -> Result<(), Error> {
    let n = distinct.len() as f64;
    let mean = mean(distinct);
    let offsets = || distinct.iter().map(|&point| Vector3::from(point) - mean);
    let scatter: Matrix3<f64> = offsets().map(|offset| offset * offset.transpose()).sum();
    for (i, offset) in offsets().enumerate() {
        // The scatter of the others about their own mean picks candidates at little cost.
        let rest = scatter - offset * offset.transpose() * (n / (n - 1.0));
        let eigenvalues = rest.symmetric_eigenvalues();
        if eigenvalues.min() > (2.0 * MIN_THICKNESS).powi(2) * eigenvalues.max() {
            continue;
        }
        let ratio = thickness(&[&distinct[..i], &distinct[i + 1..]].concat());
        if ratio < MIN_THICKNESS {
            let is_it = |pair: &PointPair| <[f64; 3]>::from(pair.point_in_ref) == distinct[i];
            let index = pairs.iter().position(is_it).unwrap_or(0);
            return Err(Error::CoplanarButOne { index, ratio, limit: MIN_THICKNESS });
        }
    }
    Ok(())
}

fn mean(points: &[[f64; 3]]) -> Vector3<f64> {
    points.iter().map(|&point| Vector3::from(point)).sum::<Vector3<f64>>() / points.len() as f64
}
