//! Whether touches can determine a plane and a tip, and how coordinates are normalised.

use boresight_geometry::nalgebra::DMatrix;
use boresight_geometry::{Matrix3, Vector3};

use super::map::{Kind, mapped};
use super::term::Tip;
use super::{LEAST_BREADTH, LEAST_TURN_RAD, TipKnowledge, Touch, TouchError};

/// How image coordinates are normalised.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Normaliser {
    pub(super) centre: [f64; 2],
    pub(super) scale: f64,
}

impl Normaliser {
    pub(super) fn of(points: &[[f64; 2]]) -> Self {
        let n = points.len() as f64;
        let centre = [0, 1].map(|axis| points.iter().map(|point| point[axis]).sum::<f64>() / n);
        let square: f64 =
            points.iter().map(|p| (p[0] - centre[0]).powi(2) + (p[1] - centre[1]).powi(2)).sum();
        Self { centre, scale: (square / n).sqrt() }
    }

    pub(super) fn apply(&self, point: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|axis| (point[axis] - self.centre[axis]) / self.scale)
    }
}

/// Returns what is known of the tip, and the directions on the flange in which it can be sought.
pub(super) fn tip_of(touches: &[Touch], knowledge: TipKnowledge) -> Result<Tip, TouchError> {
    let TipKnowledge::Unknown = knowledge else {
        let TipKnowledge::Known(tip) = knowledge else { return Ok(Tip::default()) };
        return Ok(Tip { known: Vector3::from(tip), sought: Vec::new() });
    };
    let n = touches.len().max(1) as f64;
    let rotations = || touches.iter().map(|touch| touch.base_from_flange.rotation_matrix());
    let mean: Matrix3<f64> = rotations().sum::<Matrix3<f64>>() / n;
    // How far a point one metre out on the flange moves, along each of its axes, as the flange turns.
    let spread: Matrix3<f64> =
        rotations().map(|rotation| (rotation - mean).transpose() * (rotation - mean)).sum::<Matrix3<f64>>()
            / n;
    let eigen = spread.symmetric_eigen();
    let turn = |i: usize| eigen.eigenvalues[i].max(0.0).sqrt();
    let sought: Vec<Vector3<f64>> = (0..3)
        .filter(|&i| turn(i) >= LEAST_TURN_RAD)
        .map(|i| eigen.eigenvectors.column(i).into_owned())
        .collect();
    if sought.len() < 2 {
        let mut turns = [0, 1, 2].map(turn);
        turns.sort_by(f64::total_cmp);
        return Err(TouchError::TipOpen { spread_rad: turns[1], limit_rad: LEAST_TURN_RAD });
    }
    Ok(Tip { known: Vector3::zeros(), sought })
}

/// Checks that points are enough and not on a line.
pub(super) fn check_spread(points: &[[f64; 2]], tip: TipKnowledge) -> Result<(), TouchError> {
    let mut distinct: Vec<[f64; 2]> = points.to_vec();
    distinct.sort_by(|a, b| a.partial_cmp(b).unwrap_or(std::cmp::Ordering::Equal));
    let extent = Normaliser::of(points).scale;
    distinct.dedup_by(|a, b| (a[0] - b[0]).hypot(a[1] - b[1]) <= 1e-9 * extent);
    let need = if tip == TipKnowledge::Unknown { 4 } else { 3 };
    if distinct.len() < need {
        return Err(TouchError::TooFewTouches { found: distinct.len(), need });
    }
    let ratio = breadth(points);
    // NaN is no breadth either.
    let is_broad = ratio >= LEAST_BREADTH;
    if !is_broad {
        return Err(TouchError::Collinear { ratio, limit: LEAST_BREADTH });
    }
    Ok(())
}

/// Returns the extent of points across the line they lie about over that along it.
pub(super) fn breadth(points: &[[f64; 2]]) -> f64 {
    let Normaliser { centre, .. } = Normaliser::of(points);
    let offsets: Vec<f64> = points.iter().flat_map(|p| [p[0] - centre[0], p[1] - centre[1]]).collect();
    let extents = DMatrix::from_column_slice(2, points.len(), &offsets).singular_values();
    extents.min() / extents.max()
}

/// Returns a map of image coordinates that were normalised one way as a map of those normalised another way.
pub(super) fn renormalised(
    kind: Kind,
    facing: f64,
    map: &[f64],
    from: &Normaliser,
    onto: &Normaliser,
) -> Vec<f64> {
    // from.apply(point) = ratio * onto.apply(point) + shift.
    let ratio = onto.scale / from.scale;
    let shift = [0, 1].map(|axis| (onto.centre[axis] - from.centre[axis]) / from.scale);
    match kind {
        Kind::Similarity => {
            let at_shift = mapped(kind, facing, map, shift).unwrap_or([map[2], map[3]]);
            vec![map[0] * ratio, map[1] * ratio, at_shift[0], at_shift[1]]
        }
        _ => {
            let last = |i: usize| map.get(i).copied().unwrap_or(0.0);
            let w = last(6) * shift[0] + last(7) * shift[1] + 1.0;
            let row = |i: usize| {
                let constant = map[i] * shift[0] + map[i + 1] * shift[1] + map[i + 2];
                [map[i] * ratio / w, map[i + 1] * ratio / w, constant / w]
            };
            let mut brought = [row(0), row(3)].concat();
            if kind == Kind::Homography {
                brought.extend([last(6) * ratio / w, last(7) * ratio / w]);
            }
            brought
        }
    }
}
