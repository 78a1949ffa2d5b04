//! Motions of frames as wholes: what an uncertainty of projections needs of the poses of all frames.
//!
//! A lens is known together with the poses of the targets, so a pixel's uncertainty is not that of the
//! lens alone: what a turn of all targets makes up for does no harm. Two ways to take out such a turn
//! are in use, and both need six numbers only, which are linear in the perturbations of the poses:
//!
//! - *the mean motion* of all frames in the rig, which is mrcal's `mean-pcam`: with left
//!   perturbations every frame has the same part in it;
//! - *the motion of a camera's views*, which is mrcal's cross-reprojection: the one motion in the
//!   camera's frame that explains best, over the camera's own corners and with its lens as it is, how
//!   they move when poses and shapes do. With P the corners' derivatives by a motion in the camera's
//!   frame and Q those by poses and shapes, it is `(PᵀP)⁻¹ Pᵀ Q d`. It does not ask what moves, so it
//!   serves moving cameras as well as moving targets.

use boresight_data::{CameraId, Dataset, Id as _};
use boresight_geometry::Matrix6;
use boresight_geometry::nalgebra::Cholesky;
use boresight_solver::{BlockId, GramMut, LinearFunctions, Scratch, Term as _, Values};

use crate::rig_problem::RigProblem;

const AXES: [&str; 6] = ["rx_rad", "ry_rad", "rz_rad", "tx_m", "ty_m", "tz_m"];

/// Returns the motions of a rig's frames with their names; a camera that sees too little to tell has none.
pub(crate) fn motions(
    dataset: &Dataset,
    rig: &RigProblem,
    values: Values<'_>,
) -> (Vec<String>, LinearFunctions) {
    let sums: Vec<(CameraId, ViewSums)> = rig
        .cameras
        .ids()
        .filter(|&camera| rig.cameras[camera].is_some())
        .map(|camera| (camera, ViewSums::default()))
        .collect();
    let sums = add_views(dataset, rig, values, sums);
    let usable: Vec<(CameraId, Matrix6<f64>, ViewSums)> = sums
        .into_iter()
        .filter_map(|(camera, sums)| Some((camera, Cholesky::new(sums.own)?.inverse(), sums)))
        .collect();

    let mut names: Vec<String> = AXES.iter().map(|axis| format!("mean.{axis}")).collect();
    let mut functions = LinearFunctions::new(6 * (1 + usable.len()));
    let frames: Vec<BlockId> = rig.frames.iter().flatten().copied().collect();
    let share = Matrix6::<f64>::identity() / frames.len().max(1) as f64;
    for &frame in &frames {
        functions.add(0, frame, 6, share.as_slice());
    }
    for (i, (camera, inverse, sums)) in usable.iter().enumerate() {
        names.extend(AXES.iter().map(|axis| format!("{}.views.{axis}", dataset.cameras[*camera].name)));
        for (block, n_columns, products) in &sums.products {
            let mut rows = vec![0.0; 6 * n_columns];
            for k in 0..6 {
                for column in 0..*n_columns {
                    rows[k * n_columns + column] =
                        (0..6).map(|l| inverse[(k, l)] * products[l * n_columns + column]).sum();
                }
            }
            functions.add(6 * (1 + i), *block, *n_columns, &rows);
        }
    }
    (names, functions)
}

/// Sums over a camera's views.
#[derive(Clone, Debug, Default)]
struct ViewSums {
    /// `PᵀP`.
    own: Matrix6<f64>,
    /// `PᵀQ` for each block of each view: six rows of its columns. Blocks may occur again.
    products: Vec<(BlockId, usize, Vec<f64>)>,
}

fn add_views(
    dataset: &Dataset,
    rig: &RigProblem,
    values: Values<'_>,
    mut sums: Vec<(CameraId, ViewSums)>,
) -> Vec<(CameraId, ViewSums)> {
    let mut scratch = Scratch::default();
    let mut entries = Vec::new();
    for (view_idx, term) in &rig.views {
        let camera = dataset.views[*view_idx].camera;
        let Some((_, sums)) = sums.iter_mut().find(|(id, _)| id.index() == camera.index()) else { continue };
        let (n_lens, n_shape, chain) = term.parts();
        // Without a first link nothing of the view can move.
        let n_links = chain.blocks().count();
        if n_links == 0 {
            continue;
        }
        let first_pose = n_lens + n_shape;
        let n = first_pose + 6 * n_links + 1;
        entries.resize(n * n, 0.0);
        let mut gram = GramMut::new(&mut entries, n);
        if term.linearize_common(values, &mut gram, &mut scratch).is_none() {
            continue;
        }
        let first_map = scratch.links.maps()[0];
        // Only the upper triangle is there, and of a pose's own block that alone is right.
        let entry = |a: usize, b: usize| entries[a.min(b) * n + a.max(b)];
        // The first link's columns are the motion's times its adjoint.
        let by_motion = match first_map.map(|map| Matrix6::from(map.matrix()).transpose().try_inverse()) {
            None => Matrix6::identity(),
            Some(Some(inverse)) => inverse.transpose(),
            Some(None) => continue,
        };
        let mapped = |first: usize, n_columns: usize| {
            let mut rows = vec![0.0; 6 * n_columns];
            for k in 0..6 {
                for column in 0..n_columns {
                    rows[k * n_columns + column] =
                        (0..6).map(|l| by_motion[(k, l)] * entry(first_pose + l, first + column)).sum();
                }
            }
            rows
        };
        let own = Matrix6::from_row_slice(&mapped(first_pose, 6));
        sums.own += own * by_motion.transpose();
        let mut first = n_lens;
        for (place, &block) in term.blocks()[1..].iter().enumerate() {
            let n_columns = if n_shape > 0 && place == 0 { n_shape } else { 6 };
            sums.products.push((block, n_columns, mapped(first, n_columns)));
            first += n_columns;
        }
    }
    sums
}
