//! The part of a view's pose that any radially symmetric lens reveals, in closed form.
//!
//! The radial alignment constraint: whatever the lens does along a radius, the pixel lies in the
//! direction of the point, seen from the centre of the image. With `u`, `v` relative to the centre
//! and `(x, y, z)` the point in the camera's frame, `u y = v x`, which is linear and homogeneous in
//! the first two rows of the pose: eq. 10 of Tsai 1987 ("A versatile camera calibration technique
//! ..."), eq. 10-11 of Scaramuzza, Martinelli & Siegwart 2006 ("A toolbox for easily calibrating
//! omnidirectional cameras"). It holds to 90 degrees and beyond, and knows no focal length. What it
//! leaves open is the distance along the axis and, for a planar target, the sign of the tilt.

use boresight_geometry::nalgebra::{SMatrix, SVector};
use boresight_geometry::{Matrix3, Pose, Vector3};

use crate::linear::{exceeds, smallest_eigenvector};
use crate::robust::{cauchy_weight, median};
use crate::sighting::Sighting;

/// Passes of reweighting: the first is algebraic, the next are in pixels, the last are robust.
const PASSES: usize = 4;

/// A pose of which the distance along the optical axis is unknown.
#[derive(Clone, Debug)]
pub(crate) struct RadialPose {
    /// The rotation, `cam_from_target`.
    pub rotation: Matrix3<f64>,
    /// The other rotation that explains the directions as well, for a planar target.
    pub mirrored: Option<Matrix3<f64>>,
    /// The x and y of the sighting's centroid in the camera's frame, in metres.
    pub centroid_xy: [f64; 2],
    /// The robust spread of the pixels across the radius, in pixels: the noise, whatever the lens.
    pub spread_px: f64,
    /// How far each point is to be trusted, from 0 to 1: outliers rarely err along the radius alone.
    pub trust: Vec<f64>,
}

impl RadialPose {
    /// Returns the full pose for a distance of the centroid along the axis.
    pub fn at_depth(&self, sighting: &Sighting, depth: f64, is_mirrored: bool) -> Pose {
        let rotation = if is_mirrored { self.mirrored.unwrap_or(self.rotation) } else { self.rotation };
        let centroid_in_cam = Vector3::new(self.centroid_xy[0], self.centroid_xy[1], depth);
        Pose::from_matrix(&rotation, centroid_in_cam - rotation * sighting.centroid)
    }
}

/// Returns what the directions of the pixels from `centre` tell of the pose, or `None` if they are degenerate.
pub(crate) fn radial_pose(sighting: &Sighting, centre: [f64; 2]) -> Option<RadialPose> {
    match &sighting.plane_from_target {
        Some(plane_from_target) => planar(sighting, plane_from_target, centre),
        None => spatial(sighting, centre),
    }
}

/// Solves for `(r11, r12, tx, r21, r22, ty)` up to scale, then for the rest of the rotation.
fn planar(sighting: &Sighting, plane_from_target: &Pose, centre: [f64; 2]) -> Option<RadialPose> {
    if sighting.len() < 5 {
        return None;
    }
    let centroid_in_plane = *plane_from_target * sighting.centroid;
    let relative = |point: &Vector3<f64>| {
        let in_plane = *plane_from_target * *point - centroid_in_plane;
        SVector::<f64, 3>::new(in_plane.x / sighting.extent, in_plane.y / sighting.extent, 1.0)
    };
    let (rows, spread_px, trust) = aligned_rows::<3, 6>(sighting, centre, relative)?;
    let (x_row, y_row) = rows;

    // The columns of the rotation are orthogonal and equally long; their third entries p, q follow
    // from a·b + p q = 0 and a·a + p² = b·b + q².
    let a = [x_row[0], y_row[0]];
    let b = [x_row[1], y_row[1]];
    let a_square = a[0] * a[0] + a[1] * a[1];
    let difference = b[0] * b[0] + b[1] * b[1] - a_square;
    let product = a[0] * b[0] + a[1] * b[1];
    let root = difference.hypot(2.0 * product);
    // Of the two squares the larger comes from a sum without cancellation.
    let (p, q) = if difference >= 0.0 {
        let p = (0.5 * (root + difference)).sqrt();
        (p, if p > 0.0 { -product / p } else { 0.0 })
    } else {
        let q = (0.5 * (root - difference)).sqrt();
        (-product / q, q)
    };
    let length = (a_square + p * p).sqrt();
    if !exceeds(length, 1e-9) {
        return None;
    }
    let cam_from_plane = |sign: f64| {
        let first = Vector3::new(a[0], a[1], sign * p) / length;
        let second = Vector3::new(b[0], b[1], sign * q) / length;
        Matrix3::from_columns(&[first, second, first.cross(&second)])
    };
    let plane_rotation = plane_from_target.rotation_matrix();
    let scale = sighting.extent / length;
    Some(RadialPose {
        rotation: cam_from_plane(1.0) * plane_rotation,
        mirrored: Some(cam_from_plane(-1.0) * plane_rotation),
        centroid_xy: [x_row[2] * scale, y_row[2] * scale],
        spread_px,
        trust,
    })
}

/// Solves for the whole first two rows of the pose up to scale; there is no mirrored solution.
fn spatial(sighting: &Sighting, centre: [f64; 2]) -> Option<RadialPose> {
    if sighting.len() < 7 {
        return None;
    }
    let relative = |point: &Vector3<f64>| {
        let offset = (point - sighting.centroid) / sighting.extent;
        SVector::<f64, 4>::new(offset.x, offset.y, offset.z, 1.0)
    };
    let ((x_row, y_row), spread_px, trust) = aligned_rows::<4, 8>(sighting, centre, relative)?;
    let x_axis = Vector3::new(x_row[0], x_row[1], x_row[2]);
    let y_axis = Vector3::new(y_row[0], y_row[1], y_row[2]);
    let length = 0.5 * (x_axis.norm() + y_axis.norm());
    if !exceeds(length, 1e-9) {
        return None;
    }
    // The two rows are made orthogonal by turning both by the same angle.
    let sum = (x_axis.normalize() + y_axis.normalize()).try_normalize(1e-9)?;
    let difference = (x_axis.normalize() - y_axis.normalize()).try_normalize(1e-9)?;
    let half = 0.5f64.sqrt();
    let (first, second) = ((sum + difference) * half, (sum - difference) * half);
    let rotation =
        Matrix3::from_rows(&[first.transpose(), second.transpose(), first.cross(&second).transpose()]);
    let scale = sighting.extent / length;
    Some(RadialPose {
        rotation,
        mirrored: None,
        centroid_xy: [x_row[3] * scale, y_row[3] * scale],
        spread_px,
        trust,
    })
}

/// The first two rows of a pose up to a common positive factor.
type Rows<const N: usize> = (SVector<f64, N>, SVector<f64, N>);

/// Solves `u (y_row · m) = v (x_row · m)` robustly for the two rows; returns them with the spread of the
/// pixels across the radius and the trust in each point. `N2` is twice `N`.
fn aligned_rows<const N: usize, const N2: usize>(
    sighting: &Sighting,
    centre: [f64; 2],
    relative: impl Fn(&Vector3<f64>) -> SVector<f64, N>,
) -> Option<(Rows<N>, f64, Vec<f64>)> {
    let offsets: Vec<[f64; 2]> =
        sighting.pixels.iter().map(|pixel| [pixel[0] - centre[0], pixel[1] - centre[1]]).collect();
    let points: Vec<SVector<f64, N>> = sighting.points.iter().map(relative).collect();
    let mut row_weights: Vec<f64> = offsets.iter().map(|[u, v]| 1.0 / (u * u + v * v).max(1.0)).collect();
    let mut across = vec![0.0; points.len()];
    let mut rows = (SVector::zeros(), SVector::zeros());
    let mut spread_px = 0.0;
    for pass in 0..PASSES {
        let solution = smallest_direction::<N, N2>(&points, &offsets, &row_weights)?;
        rows = (solution.fixed_rows::<N>(0).into_owned(), solution.fixed_rows::<N>(N).into_owned());
        let mut largest: f64 = 0.0;
        for (m, weight) in points.iter().zip(&mut row_weights) {
            *weight = length(rows.0.dot(m), rows.1.dot(m));
            largest = largest.max(*weight);
        }
        // The distance of the pixel from the line through the centre along (x, y), in pixels.
        for (i, m) in points.iter().enumerate() {
            let [u, v] = offsets[i];
            let radius = row_weights[i].max(1e-3 * largest);
            across[i] = (u * rows.1.dot(m) - v * rows.0.dot(m)).abs() / radius;
            row_weights[i] = (sighting.weights[i] / radius).powi(2);
        }
        spread_px = 1.4826 * median(&across);
        if pass > 0 {
            for (weight, distance) in row_weights.iter_mut().zip(&across) {
                *weight *= cauchy_weight(*distance, (2.5 * spread_px).max(1e-6));
            }
        }
    }
    // The pixel lies on the side of the centre where the point does.
    let agreement: f64 =
        points.iter().zip(&offsets).map(|(m, [u, v])| (u * rows.0.dot(m) + v * rows.1.dot(m)).signum()).sum();
    if agreement < 0.0 {
        rows = (-rows.0, -rows.1);
    }
    let width = (2.5 * spread_px).max(1e-6);
    let trust = across.into_iter().map(|distance| cauchy_weight(distance, width)).collect();
    Some((rows, spread_px, trust))
}

/// Returns the length of a vector; `hypot` guards against overflow, which cannot happen here, at ten times the price.
pub(crate) fn length(x: f64, y: f64) -> f64 {
    (x * x + y * y).sqrt()
}

/// Returns the unit vector that minimises the weighted sum of squares of `u (y·m) - v (x·m)`.
fn smallest_direction<const N: usize, const N2: usize>(
    points: &[SVector<f64, N>],
    offsets: &[[f64; 2]],
    weights: &[f64],
) -> Option<SVector<f64, N2>> {
    // All blocks of the moment matrix are outer products of m, weighed by v², -u v and u².
    let (mut vv, mut uv, mut uu) =
        (SMatrix::<f64, N, N>::zeros(), SMatrix::<f64, N, N>::zeros(), SMatrix::<f64, N, N>::zeros());
    for ((m, [u, v]), weight) in points.iter().zip(offsets).zip(weights) {
        let (wv, wu) = (weight * v, weight * u);
        for column in 0..N {
            for row in 0..=column {
                let product = m[row] * m[column];
                vv[(row, column)] += wv * v * product;
                uv[(row, column)] -= wv * u * product;
                uu[(row, column)] += wu * u * product;
            }
        }
    }
    let mut moments = SMatrix::<f64, N2, N2>::zeros();
    for column in 0..N {
        for row in 0..N {
            let (low, high) = (row.min(column), row.max(column));
            moments[(row, column)] = vv[(low, high)];
            moments[(row, N + column)] = uv[(low, high)];
            moments[(N + row, column)] = uv[(low, high)];
            moments[(N + row, N + column)] = uu[(low, high)];
        }
    }
    smallest_eigenvector(&moments)
}
