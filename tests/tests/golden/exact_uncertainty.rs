//! mrcal's mean-frame uncertainty at a stored optimum by QR decompositions of the Jacobian, which do not square its
//! condition as normal equations do. Nothing of the solver or of the uncertainty's own code takes part.
//!
//! The scaled condition of the Jacobian is 3e4 with regularisation and 3e5 without, so that its rounding shows as
//! 1e-11 here and as 1e-6 to 1e-5 in what normal equations say of the most ill-determined pixels. The same
//! decomposition in 80-bit floating point, with mrcal's parametrisation, agrees.

use std::collections::BTreeMap;

use boresight_data::{CameraId, Dataset, Scene, TargetId};
use boresight_geometry::nalgebra::{DMatrix, Matrix2, Matrix2x3, Matrix3x6};
use boresight_geometry::{Matrix3, Pose, Vector3, skew};

use super::sigma_reference::Linearize;

/// The Jacobian's triangular factor. Its columns: six for each frame, then lens and pose of each camera (the first
/// has no pose), then the target's shape.
pub(super) struct ExactUncertainty<'a> {
    scene: &'a Scene,
    /// For each frame its own triangle and its rows of the columns that all frames share.
    frames: Vec<[DMatrix<f64>; 2]>,
    /// The triangle of the shared columns, by the observations alone.
    observed: DMatrix<f64>,
    /// The same with what is believed.
    believed: DMatrix<f64>,
    n_lens: usize,
}

impl<'a> ExactUncertainty<'a> {
    /// Takes the Jacobian at `scene` apart; `beliefs` are the rows of regularisation, for each its camera, the
    /// column of its lens, and the factor.
    pub(super) fn new(
        dataset: &Dataset,
        scene: &'a Scene,
        beliefs: &[(usize, usize, f64)],
    ) -> ExactUncertainty<'a> {
        let n_lens = scene.rig.cameras[CameraId(0)].as_ref().unwrap().camera.params.len();
        let n_shared = shared_columns(scene, n_lens);
        let mut by_frame: BTreeMap<u32, Vec<f64>> = BTreeMap::new();
        for view in &dataset.views {
            let placed = scene.rig.cameras[view.camera].as_ref().unwrap();
            let rig_from_target = scene.rig_from_target[view.frame].unwrap();
            let (in_cam, in_rig) = (placed.cam_from_rig.rotation_matrix(), rig_from_target.rotation_matrix());
            let rows = by_frame.entry(view.frame.0).or_default();
            for observation in &view.observations {
                let target = &dataset.targets[TargetId(0)];
                let point = target.point(observation.point, &scene.targets[TargetId(0)].shape_m);
                let point_in_rig = rig_from_target * point;
                let point_in_cam = placed.cam_from_rig * point_in_rig;
                let lens = Slopes::new(scene, view.camera, &point_in_cam);
                let by_frame = lens.by_point * in_cam * by_motion(&point_in_rig, 1.0);
                let by_pose = lens.by_point * by_motion(&point_in_cam, 1.0);
                let along_z = lens.by_point * in_cam * in_rig.column(2);
                let basis = target.shape_basis(observation.point);
                for axis in 0..2 {
                    let mut row = vec![0.0; 6 + n_shared];
                    (0..6).for_each(|k| row[k] = by_frame[(axis, k)]);
                    let shared = &mut row[6..];
                    let first = first_column(view.camera, n_lens);
                    shared[first..first + n_lens].copy_from_slice(&lens.by_param[axis]);
                    if view.camera.0 > 0 {
                        (0..6).for_each(|k| shared[first + n_lens + k] = by_pose[(axis, k)]);
                    }
                    (0..2).for_each(|j| shared[n_shared - 2 + j] = along_z[axis] * basis[j]);
                    rows.extend(row);
                }
            }
        }
        let mut frames = Vec::new();
        let mut left: Vec<f64> = Vec::new();
        for rows in by_frame.values() {
            let n_columns = 6 + n_shared;
            let triangle = DMatrix::from_row_slice(rows.len() / n_columns, n_columns, rows).qr().r();
            frames.push([triangle.view((0, 0), (6, 6)).into(), triangle.view((0, 6), (6, n_shared)).into()]);
            let rest = triangle.view((6, 6), (triangle.nrows() - 6, n_shared));
            rest.row_iter().for_each(|row| left.extend(row.iter()));
        }
        let observed = DMatrix::from_row_slice(left.len() / n_shared, n_shared, &left).qr().r();
        let mut believed = observed.clone().insert_rows(n_shared, beliefs.len(), 0.0);
        for (i, &(camera, column, factor)) in beliefs.iter().enumerate() {
            believed[(n_shared + i, first_column(CameraId(camera as u32), n_lens) + column)] = factor;
        }
        Self { scene, frames, observed, believed: believed.qr().r(), n_lens }
    }

    /// Returns the covariance, for observations with a noise of one pixel, of where a point in the camera's frame is
    /// seen; without a shift it is a direction.
    pub(super) fn at(&self, camera: CameraId, point_in_cam: &Vector3<f64>, shift: f64) -> Matrix2<f64> {
        let placed = self.scene.rig.cameras[camera].as_ref().unwrap();
        let rig_from_cam: Pose = placed.cam_from_rig.inverse();
        let point_in_rig = rig_from_cam.rotation * *point_in_cam + rig_from_cam.translation * shift;
        let lens = Slopes::new(self.scene, camera, point_in_cam);
        let turned: Matrix3<f64> = placed.cam_from_rig.rotation_matrix();
        let by_frame = lens.by_point * turned * by_motion(&point_in_rig, shift) / self.frames.len() as f64;
        let by_pose = lens.by_point * by_motion(point_in_cam, shift);
        let n_shared = self.observed.ncols();
        let mut by_shared = DMatrix::zeros(n_shared, 2);
        let first = first_column(camera, self.n_lens);
        for axis in 0..2 {
            (0..self.n_lens).for_each(|i| by_shared[(first + i, axis)] = lens.by_param[axis][i]);
            if camera.0 > 0 {
                (0..6).for_each(|k| by_shared[(first + self.n_lens + k, axis)] = by_pose[(axis, k)]);
            }
        }
        // With the triangle R and the gradients F, R^-T F and, of what is shared, J_o R^-1 R^-T F.
        let by_frame = DMatrix::from_fn(6, 2, |k, axis| by_frame[(axis, k)]);
        let mut covariance = Matrix2::zeros();
        for [own, shared] in &self.frames {
            let carried = own.tr_solve_upper_triangular(&by_frame).unwrap();
            covariance += carried.tr_mul(&carried);
            by_shared -= shared.tr_mul(&carried);
        }
        let carried = self.believed.tr_solve_upper_triangular(&by_shared).unwrap();
        let carried = &self.observed * self.believed.solve_upper_triangular(&carried).unwrap();
        covariance + carried.tr_mul(&carried)
    }
}

/// A pixel's derivatives.
struct Slopes {
    by_point: Matrix2x3<f64>,
    by_param: [Vec<f64>; 2],
}

impl Slopes {
    fn new(scene: &Scene, camera: CameraId, point_in_cam: &Vector3<f64>) -> Self {
        let camera = &scene.rig.cameras[camera].as_ref().unwrap().camera;
        let linear = camera.model.visit(Linearize(&camera.params, (*point_in_cam).into()));
        let (pixel, by_point, by_rest) = linear.unwrap();
        let core = |axis: usize| {
            let mut core = [0.0; 4];
            core[axis] = (pixel[axis] - camera.params[2 + axis]) / camera.params[axis];
            core[2 + axis] = 1.0;
            core
        };
        let by_param = [0, 1].map(|axis| core(axis).into_iter().chain(by_rest[axis].clone()).collect());
        Self { by_point: Matrix2x3::from_fn(|i, j| by_point[i][j]), by_param }
    }
}

/// Returns how a point moves with a left perturbation of what it is fixed to.
fn by_motion(point: &Vector3<f64>, shift: f64) -> Matrix3x6<f64> {
    let turned = skew(point);
    Matrix3x6::from_fn(|i, k| match k {
        0..3 => -turned[(i, k)],
        k if k - 3 == i => shift,
        _ => 0.0,
    })
}

/// Returns the number of columns that all frames share.
fn shared_columns(scene: &Scene, n_lens: usize) -> usize {
    let n_cameras = scene.rig.cameras.len();
    n_lens * n_cameras + 6 * (n_cameras - 1) + 2
}

/// Returns the first of a camera's columns among those.
fn first_column(camera: CameraId, n_lens: usize) -> usize {
    let camera = camera.0 as usize;
    n_lens * camera + 6 * camera.saturating_sub(1)
}
