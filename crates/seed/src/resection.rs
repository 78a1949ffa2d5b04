//! The pose of a target in front of a known lens: closed form from bearings, then robust Gauss-Newton.
//!
//! The closed form is the direct linear transform on bearing vectors rather than on image-plane
//! points, so that it holds at and beyond 90 degrees: for a bearing `b` and a point `m`, `P m` is
//! parallel to `b`, hence perpendicular to any two directions perpendicular to `b` (section 4.1 of
//! Hartley & Zisserman 2004, with the cross product replaced by a tangent basis).

use boresight_camera::Camera;
use boresight_geometry::nalgebra::{Cholesky, SMatrix, SVector};
use boresight_geometry::{Matrix3, Pose, UnitQuaternion, Vector3, Vector6};

use crate::kernel::{Cost, Lens, pose_sum, residual_lengths};
use crate::linear::{exceeds, nearest_rotation, smallest_eigenvector};
use crate::robust::{median, width_for};
use crate::sighting::Sighting;

/// A pose and how well it explains its view.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Resection {
    pub cam_from_target: Pose,
    /// The median length of the residuals, in sigmas.
    pub median: f64,
    /// The cost under the loss width that was asked for.
    pub cost: Cost,
}

/// Finds the pose from several starts, for a lens whose residuals are usually `typical` sigmas long.
///
/// `start` is a guess. The mirror pose of a planar target is tried wherever it comes near; the
/// closed form and random samples only where the guess does not lead to a usual residual.
pub(crate) fn resect(
    camera: &Camera,
    sighting: &Sighting,
    start: Option<&Pose>,
    typical: f64,
) -> Option<Resection> {
    let lens = Lens::of(camera);
    let width = width_for(typical);
    let mut best = start.and_then(|start| refine(lens, start, sighting, width, 8));
    let is_usual = |found: &Option<Resection>| {
        found.as_ref().is_some_and(|found| found.cost.outside == 0 && found.median < 4.0 * typical)
    };
    if !is_usual(&best) {
        let bearings: Vec<Option<Vector3<f64>>> =
            sighting.pixels.iter().map(|pixel| camera.unproject(*pixel)).collect();
        let all: Vec<usize> = (0..sighting.len()).collect();
        let direct = pose_from_bearings(sighting, &bearings, &all)
            .and_then(|start| refine(lens, &start, sighting, width, 12));
        best = better(best, direct);
        if !is_usual(&best) {
            let sampled = pose_from_samples(lens, sighting, &bearings)
                .and_then(|start| refine(lens, &start, sighting, width, 12));
            best = better(best, sampled);
        }
    }
    let found = best?;
    let Some(mirrored) = mirrored(&found.cam_from_target, sighting) else { return Some(found) };
    let mut lengths = Vec::with_capacity(sighting.len());
    let outside = residual_lengths(lens, &mirrored, sighting, &mut lengths);
    // Beyond ten times the residual, the mirror pose is not a rival.
    if outside > found.cost.outside || median(&lengths) > 10.0 * found.median.max(typical) {
        return Some(found);
    }
    better(Some(found), refine(lens, &mirrored, sighting, width, 8))
}

/// Refines a pose by damped Gauss-Newton steps; `None` if no point projects.
///
/// The loss starts as wide as the residuals are and narrows with them down to `width` sigmas.
pub(crate) fn refine(
    lens: Lens<'_>,
    start: &Pose,
    sighting: &Sighting,
    width: f64,
    max_steps: usize,
) -> Option<Resection> {
    let mut pose = *start;
    let mut lengths = Vec::with_capacity(sighting.len());
    residual_lengths(lens, &pose, sighting, &mut lengths);
    if lengths.len() < 3 {
        return None;
    }
    let mut current_width = width_for(median(&lengths)).max(width);
    lengths.clear();
    let mut sum = pose_sum(lens, &pose, sighting, current_width, &mut lengths);
    let mut damping = 1e-7;
    let mut trial_lengths = Vec::with_capacity(sighting.len());
    for _ in 0..max_steps {
        let mut damped = sum.hessian;
        for i in 0..6 {
            damped[(i, i)] *= 1.0 + damping;
        }
        let step: Vector6<f64> = -Cholesky::new(damped)?.solve(&sum.gradient);
        let predicted = -(step.dot(&sum.gradient) + 0.5 * step.dot(&(sum.hessian * step)));
        if !exceeds(predicted, 1e-3 * sum.cost.loss.max(1e-12)) {
            break;
        }
        let trial = pose.perturbed(&step);
        trial_lengths.clear();
        let trial_sum = pose_sum(lens, &trial, sighting, current_width, &mut trial_lengths);
        if trial_sum.cost.is_below(&sum.cost) {
            (pose, sum) = (trial, trial_sum);
            std::mem::swap(&mut lengths, &mut trial_lengths);
            damping = (damping * 0.1).max(1e-9);
            // The next trial is judged under the narrower loss; the weights lag one step behind.
            current_width = width_for(median(&lengths)).clamp(width, current_width.max(width));
            sum.cost = Cost::of(&lengths, sum.cost.outside, current_width);
        } else {
            damping = (damping * 30.0).max(1e-4);
        }
    }
    let cost = Cost::of(&lengths, sum.cost.outside, width);
    Some(Resection { cam_from_target: pose, median: median(&lengths), cost })
}

/// Returns the better of two.
fn better(first: Option<Resection>, second: Option<Resection>) -> Option<Resection> {
    match (first, second) {
        (Some(first), Some(second)) => Some(if second.cost.is_below(&first.cost) { second } else { first }),
        (first, second) => first.or(second),
    }
}

/// Returns the pose of the flat target tilted the other way about the line of sight, which a distant
/// or small target is easily mistaken for: a half turn about the line of sight and one about the
/// target's normal (the ambiguity of Schweighofer & Pinz 2006).
fn mirrored(cam_from_target: &Pose, sighting: &Sighting) -> Option<Pose> {
    let plane_from_target = sighting.plane_from_target?;
    let centroid_in_cam = *cam_from_target * sighting.centroid;
    let line_of_sight = boresight_geometry::nalgebra::Unit::try_new(centroid_in_cam, 1e-12)?;
    let normal_in_target = plane_from_target.rotation.inverse() * Vector3::z_axis();
    let about_sight = UnitQuaternion::from_axis_angle(&line_of_sight, std::f64::consts::PI);
    let about_normal = UnitQuaternion::from_axis_angle(&normal_in_target, std::f64::consts::PI);
    let rotation = about_sight * cam_from_target.rotation * about_normal;
    Some(Pose::new(rotation, centroid_in_cam - rotation * sighting.centroid))
}

/// Returns the pose that brings the chosen points onto their bearings, by a linear least squares fit.
fn pose_from_bearings(
    sighting: &Sighting,
    bearings: &[Option<Vector3<f64>>],
    chosen: &[usize],
) -> Option<Pose> {
    match sighting.plane_from_target {
        Some(plane_from_target) => {
            let centroid = plane_from_target * sighting.centroid;
            let columns = linear_map::<3, 9>(chosen, bearings, |i| {
                let in_plane = (plane_from_target * sighting.points[i] - centroid) / sighting.extent;
                SVector::<f64, 3>::new(in_plane.x, in_plane.y, 1.0)
            })?;
            let (first, second) = (columns.column(0).into_owned(), columns.column(1).into_owned());
            let scale = (first.norm() * second.norm()).sqrt();
            let guess = Matrix3::from_columns(&[
                first / scale,
                second / scale,
                first.cross(&second) / (scale * scale),
            ]);
            let rotation = nearest_rotation(&guess)?;
            let centroid_in_cam = columns.column(2) * (sighting.extent / scale);
            let cam_from_plane = Pose::from_matrix(&rotation, centroid_in_cam - rotation * centroid);
            Some(cam_from_plane * plane_from_target)
        }
        None => {
            let columns = linear_map::<4, 12>(chosen, bearings, |i| {
                let offset = (sighting.points[i] - sighting.centroid) / sighting.extent;
                SVector::<f64, 4>::new(offset.x, offset.y, offset.z, 1.0)
            })?;
            let linear = columns.fixed_columns::<3>(0).into_owned();
            let scale = linear.determinant().abs().cbrt();
            let rotation = nearest_rotation(&(linear / scale))?;
            let centroid_in_cam = columns.column(3) * (sighting.extent / scale);
            Some(Pose::from_matrix(&rotation, centroid_in_cam - rotation * sighting.centroid))
        }
    }
}

/// Solves for the 3xN matrix that maps each point's homogeneous coordinates onto its bearing, up to a
/// positive factor. `N3` is three times `N`.
fn linear_map<const N: usize, const N3: usize>(
    chosen: &[usize],
    bearings: &[Option<Vector3<f64>>],
    coordinates: impl Fn(usize) -> SVector<f64, N>,
) -> Option<SMatrix<f64, 3, N>> {
    let mut moments = SMatrix::<f64, N3, N3>::zeros();
    let mut n_rows = 0;
    for &i in chosen {
        let Some(bearing) = bearings[i] else { continue };
        let m = coordinates(i);
        // The projector across the bearing is the sum over both tangents of their outer products.
        let across = Matrix3::identity() - bearing * bearing.transpose();
        for (column, row) in (0..N).flat_map(|column| (0..N).map(move |row| (column, row))) {
            let product = m[row] * m[column];
            let mut block = moments.fixed_view_mut::<3, 3>(3 * row, 3 * column);
            block += across * product;
        }
        n_rows += 2;
    }
    if n_rows + 1 < N3 {
        return None;
    }
    let stacked = smallest_eigenvector(&moments)?;
    let map = SMatrix::<f64, 3, N>::from_column_slice(stacked.as_slice());
    let ahead = |i: &usize| bearings[*i].map(|bearing| bearing.dot(&(map * coordinates(*i))).signum());
    let agreement: f64 = chosen.iter().filter_map(ahead).sum();
    Some(if agreement < 0.0 { -map } else { map })
}

/// Returns the best pose among those of small random samples of the points, by the median residual.
fn pose_from_samples(lens: Lens<'_>, sighting: &Sighting, bearings: &[Option<Vector3<f64>>]) -> Option<Pose> {
    const SAMPLES: usize = 60;
    let n = sighting.len();
    let size = if sighting.plane_from_target.is_some() { 4 } else { 6 };
    // A fixed linear congruential sequence (Knuth's MMIX constants): the same data give the same answer.
    let mut state = 0x9E37_79B9_7F4A_7C15u64;
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((state >> 33) as usize) % n
    };
    let mut best: Option<(f64, Pose)> = None;
    let mut lengths = Vec::with_capacity(n);
    for _ in 0..SAMPLES {
        let mut sample = Vec::with_capacity(size);
        for _ in 0..4 * size {
            let i = next();
            if sample.len() < size && !sample.contains(&i) {
                sample.push(i);
            }
        }
        let Some(pose) = pose_from_bearings(sighting, bearings, &sample) else { continue };
        lengths.clear();
        let outside = residual_lengths(lens, &pose, sighting, &mut lengths);
        lengths.resize(lengths.len() + outside, f64::INFINITY);
        let residual = median(&lengths);
        if residual.is_finite() && best.as_ref().is_none_or(|(lowest, _)| residual < *lowest) {
            best = Some((residual, pose));
        }
    }
    best.map(|(_, pose)| pose)
}
