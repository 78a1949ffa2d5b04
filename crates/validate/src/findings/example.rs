//! Good calibrations, for findings to be silent on and for their examples to spoil.

use boresight_data::{
    Calibration, CameraFit, CameraId, Dataset, Id as _, PointId, Provenance, Regularization, Rejection,
    RejectionReason, SolveRecord, Uncertainty, ViewFit,
};
use boresight_synthetic::{Recipe, simulate};

/// A dataset and a calibration of it.
#[derive(Clone, Debug)]
pub(super) struct Example {
    pub(super) dataset: Dataset,
    pub(super) calibration: Calibration,
}

impl Example {
    /// One camera, 40 frames, believed to be what it is.
    pub(super) fn mono() -> Self {
        Self::of(Recipe { frames: 40, ..Recipe::mono() })
    }

    /// One fisheye, 40 frames.
    pub(super) fn fisheye() -> Self {
        Self::of(Recipe { frames: 40, ..Recipe::fisheye() })
    }

    /// Two cameras, 40 frames.
    pub(super) fn stereo() -> Self {
        Self::of(Recipe { frames: 40, ..Recipe::stereo() })
    }

    /// What a calibration that found the truth says.
    pub(super) fn of(recipe: Recipe) -> Self {
        // A flat board is good; the ready-made ones are bowed.
        let made = simulate(&Recipe { shape_m: vec![2e-4, -1e-4], ..recipe }, 7);
        let calibration = Calibration {
            scene: made.truth,
            targets: made.dataset.targets.clone(),
            frame_names: made.dataset.frames.iter().map(|frame| frame.name.clone()).collect(),
            cameras: Vec::new().into(),
            views: Vec::new(),
            rms_px: 0.0,
            uncertainty: Uncertainty {
                noise_factor: 1.0,
                degrees_of_freedom: 1000,
                ..Uncertainty::default()
            },
            rejected: Vec::new(),
            regularization: Regularization { kind: "default".to_owned(), rows: 3, chi2: 2.0 },
            solve: SolveRecord {
                chi2: 5000.0,
                iterations: 9,
                stop: "predicted decrease 3.1e-9 below 1e-6".to_owned(),
                converged: true,
                ..SolveRecord::default()
            },
            held_out: None,
            provenance: Provenance::default(),
        };
        let mut example = Self { dataset: made.dataset, calibration };
        example.know_well();
        example.refit();
        example
    }

    /// Removes the views for which `keep` is false.
    pub(super) fn retain_views(&mut self, keep: impl Fn(usize) -> bool) {
        assert!(self.calibration.rejected.is_empty(), "rejections name views by index");
        let mut index = 0..;
        self.dataset.views.retain(|_| index.next().is_some_and(&keep));
        self.refit();
    }

    /// Rejects the first observations of a view as outliers.
    pub(super) fn reject(&mut self, view_idx: usize, n_points: usize) {
        let outlier = || RejectionReason::Outlier { sigmas: 20.0, limit: 4.0 };
        let points = self.dataset.views[view_idx].observations[..n_points].iter();
        let rejections = points.map(|o| Rejection { view_idx, point: o.point, reason: outlier() });
        self.calibration.rejected.extend(rejections);
        self.refit();
    }

    /// Leaves a view out.
    pub(super) fn leave_out(&mut self, view_idx: usize, why: &str) {
        let reason = RejectionReason::LeftOut { why: why.to_owned() };
        let points: Vec<PointId> =
            self.dataset.views[view_idx].observations.iter().map(|o| o.point).collect();
        let rejections =
            points.into_iter().map(|point| Rejection { view_idx, point, reason: reason.clone() });
        self.calibration.rejected.extend(rejections);
        self.refit();
    }

    /// Computes residuals and their sums anew, as an adjustment reports them.
    pub(super) fn refit(&mut self) {
        let (dataset, scene) = (&self.dataset, &self.calibration.scene);
        let mut cameras: Vec<CameraFit> = (dataset.cameras.iter())
            .map(|info| CameraFit { name: info.name.clone(), ..CameraFit::default() })
            .collect();
        let mut squares = vec![0.0; cameras.len()];
        let mut views = Vec::new();
        for (view_idx, view) in dataset.views.iter().enumerate() {
            let reason_of = |point| {
                let rejected = self.calibration.rejected.iter();
                rejected.filter(|r| r.view_idx == view_idx && r.point == point).map(|r| &r.reason).next()
            };
            let is_left_out = |reason: Option<&_>| matches!(reason, Some(RejectionReason::LeftOut { .. }));
            let placed = scene.rig.cameras[view.camera].as_ref().zip(scene.rig_from_target[view.frame]);
            let Some((camera, rig_from_target)) =
                placed.filter(|_| !view.observations.iter().any(|o| is_left_out(reason_of(o.point))))
            else {
                cameras[view.camera.index()].rejected += view.observations.len();
                views.push(ViewFit::default());
                continue;
            };
            let (mut square, mut kept, mut residuals_px) = (0.0, 0, Vec::new());
            for observation in &view.observations {
                let shape_m = &scene.targets[view.target].shape_m;
                let point = dataset.targets[view.target].point(observation.point, shape_m);
                let pixel = camera.camera.project(&(camera.cam_from_rig * (rig_from_target * point)));
                let residual = pixel.map_or([f64::INFINITY; 2], |pixel| {
                    [0, 1].map(|axis| pixel[axis] - observation.pixel[axis])
                });
                residuals_px.push(residual);
                if reason_of(observation.point).is_none() {
                    square += residual[0].powi(2) + residual[1].powi(2);
                    kept += 1;
                }
            }
            let fit = &mut cameras[view.camera.index()];
            fit.views += 1;
            fit.observations += kept;
            fit.rejected += view.observations.len() - kept;
            squares[view.camera.index()] += square;
            let rms_px = (kept > 0).then(|| (square / kept as f64).sqrt());
            views.push(ViewFit { rms_px, residuals_px });
        }
        for (fit, square) in cameras.iter_mut().zip(&squares) {
            fit.rms_px = if fit.observations > 0 { (square / fit.observations as f64).sqrt() } else { 0.0 };
        }
        self.calibration.rms_px = cameras.iter().map(|fit| fit.rms_px).fold(0.0, f64::max);
        self.calibration.cameras = cameras.into();
        self.calibration.views = views;
    }

    /// The calibrated lens of a camera, for change.
    pub(super) fn lens(&mut self, camera: u32) -> &mut boresight_camera::Camera {
        &mut self.calibration.scene.rig.cameras[CameraId(camera)].as_mut().unwrap().camera
    }

    /// Gives every parameter of every lens a variance of half a square pixel.
    fn know_well(&mut self) {
        let mut names = Vec::new();
        for (info, camera) in self.dataset.cameras.iter().zip(&self.calibration.scene.rig.cameras) {
            let params = camera.as_ref().unwrap().camera.model.param_names();
            names.extend(params.iter().map(|param| format!("{}.{param}", info.name)));
        }
        let n = names.len();
        let mut covariance = vec![0.0; n * n];
        (0..n).for_each(|i| covariance[i * n + i] = 0.5);
        self.calibration.uncertainty.names = names;
        self.calibration.uncertainty.covariance = covariance;
    }
}
