//! A dataset and its calibration, with the look-ups that findings share.

use std::collections::BTreeSet;

use boresight_data::{
    Calibration, CameraFit, CameraId, Dataset, Geometry, Observation, PointId, RejectionReason, RigCamera,
    Target, View, ViewFit,
};
use boresight_geometry::{Matrix3, Pose, Vector3};

/// Sigmas that an image tells all differ; with no more different ones than this they were stated.
const STATED_SIGMAS: usize = 8;

/// A dataset and the calibration made from it. Look-ups of what is missing return `None`.
pub(crate) struct Case<'a> {
    pub(crate) dataset: &'a Dataset,
    pub(crate) calibration: &'a Calibration,
    /// The observations that are not used, for whatever reason.
    rejected: BTreeSet<(usize, PointId)>,
    /// For each view, the number of outliers.
    outliers: Vec<usize>,
}

/// A view that took part in the solve.
#[derive(Clone, Copy)]
pub(crate) struct UsedView<'a> {
    pub(crate) index: usize,
    pub(crate) view: &'a View,
    pub(crate) fit: &'a ViewFit,
}

impl<'a> Case<'a> {
    pub(crate) fn new(dataset: &'a Dataset, calibration: &'a Calibration) -> Self {
        let mut outliers = vec![0; dataset.views.len()];
        let mut rejected = BTreeSet::new();
        for rejection in &calibration.rejected {
            rejected.insert((rejection.view_idx, rejection.point));
            if let (RejectionReason::Outlier { .. }, Some(n)) =
                (&rejection.reason, outliers.get_mut(rejection.view_idx))
            {
                *n += 1;
            }
        }
        Self { dataset, calibration, rejected, outliers }
    }

    /// Returns the calibrated cameras with their names.
    pub(crate) fn cameras(&self) -> impl Iterator<Item = (CameraId, &'a str, &'a RigCamera)> {
        let cameras = self.calibration.scene.rig.cameras.enumerate();
        cameras.filter_map(|(id, camera)| {
            Some((id, self.dataset.cameras.get(id)?.name.as_str(), camera.as_ref()?))
        })
    }

    /// Returns the fit of a camera.
    pub(crate) fn camera_fit(&self, camera: CameraId) -> Option<&'a CameraFit> {
        self.calibration.cameras.get(camera)
    }

    /// Tells whether the lens was given and not estimated. Without a covariance there is no telling, and it is not.
    pub(crate) fn lens_is_held(&self, camera: &str) -> bool {
        let names = &self.calibration.uncertainty.names;
        let is_of_lens = |name: &String| {
            let param = name.strip_prefix(camera).and_then(|rest| rest.strip_prefix('.'));
            param.is_some_and(|param| !param.contains('.'))
        };
        !names.is_empty() && !names.iter().any(is_of_lens)
    }

    /// Returns the sigma of a parameter, or `None` where there is none.
    pub(crate) fn sigma(&self, parameter: &str) -> Option<f64> {
        self.calibration.uncertainty.sigma(parameter)
    }

    /// Returns the views that took part in the solve.
    pub(crate) fn used_views(&self) -> impl Iterator<Item = UsedView<'a>> {
        let views = self.dataset.views.iter().zip(&self.calibration.views).enumerate();
        views.filter(|(_, (_, fit))| !fit.residuals_px.is_empty()).map(|(index, (view, fit))| UsedView {
            index,
            view,
            fit,
        })
    }

    /// Returns the views of a camera that took part in the solve.
    pub(crate) fn used_views_of(&self, camera: CameraId) -> impl Iterator<Item = UsedView<'a>> {
        self.used_views().filter(move |used| used.view.camera == camera)
    }

    /// Returns the observations of a view that are not rejected.
    pub(crate) fn kept(&self, used: UsedView<'a>) -> impl Iterator<Item = &'a Observation> {
        let observations = used.view.observations.iter();
        observations.filter(move |observation| !self.rejected.contains(&(used.index, observation.point)))
    }

    /// Returns the observations of a view that are not rejected, with their residuals.
    pub(crate) fn kept_with_residuals(
        &self,
        used: UsedView<'a>,
    ) -> impl Iterator<Item = (&'a Observation, &'a [f64; 2])> {
        let both = used.view.observations.iter().zip(&used.fit.residuals_px);
        both.filter(move |(observation, _)| !self.rejected.contains(&(used.index, observation.point)))
    }

    /// Tells whether the sigmas of a camera's corners were stated, and not told by images.
    pub(crate) fn sigmas_are_stated(&self, camera: CameraId) -> bool {
        let seen = self.used_views_of(camera).flat_map(|used| &used.view.observations);
        let different: BTreeSet<u64> = seen.map(|observation| observation.sigma_px.to_bits()).collect();
        different.len() <= STATED_SIGMAS
    }

    /// Returns the number of outliers in a view.
    pub(crate) fn outliers_in(&self, view_idx: usize) -> usize {
        self.outliers.get(view_idx).copied().unwrap_or(0)
    }

    /// Returns what a person calls a view: its image, or else its camera and frame.
    pub(crate) fn view_name(&self, view: &View) -> String {
        let camera = self.dataset.cameras.get(view.camera).map_or("?", |camera| camera.name.as_str());
        let frame = self.dataset.frames.get(view.frame).map_or("?", |frame| frame.name.as_str());
        view.image.clone().unwrap_or_else(|| format!("{camera}, frame {frame}"))
    }

    /// Returns where a view's target stood in front of its camera, as believed.
    pub(crate) fn cam_from_target(&self, view: &View) -> Option<Pose> {
        let scene = &self.calibration.scene;
        let first_from_target = scene.targets.get(view.target)?.first_from_target;
        Some(scene.cam_from_first(view.camera, view.frame)? * first_from_target)
    }

    /// Returns the target of a view.
    pub(crate) fn target(&self, view: &View) -> Option<&'a Target> {
        self.dataset.targets.get(view.target)
    }
}

/// Returns the normal of a flat target in its own frame, or `None` if its points do not lie in a plane.
pub(crate) fn normal_in_target(target: &Target) -> Option<Vector3<f64>> {
    let points_m = match &target.geometry {
        Geometry::Points { points_m } => points_m,
        _ => return Some(Vector3::z()),
    };
    let points: Vec<Vector3<f64>> = points_m.iter().map(|&point| Vector3::from(point)).collect();
    let mean = points.iter().sum::<Vector3<f64>>() / points.len().max(1) as f64;
    let scatter: Matrix3<f64> = points.iter().map(|point| (point - mean) * (point - mean).transpose()).sum();
    let eigen = scatter.symmetric_eigen();
    let (thinnest, variance) = eigen.eigenvalues.argmin();
    // A thickness of a hundredth of the extent does not tell more than a plane does.
    (variance <= 1e-4 * eigen.eigenvalues.max()).then(|| eigen.eigenvectors.column(thinnest).into_owned())
}

#[cfg(test)]
mod tests {
    use boresight_data::Shape;

    use super::*;

    fn target(points_m: Vec<[f64; 3]>) -> Target {
        Target { name: "t".to_owned(), geometry: Geometry::Points { points_m }, shape: Shape::Rigid }
    }

    #[test]
    fn flat_targets_have_normals() {
        let flat = target(vec![[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 0.0, 2.0], [1.0, 0.0, 2.0]]);
        let normal = normal_in_target(&flat).unwrap();
        assert!((normal.y.abs() - 1.0).abs() < 1e-12, "{normal}");
        let solid = target(vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.3]]);
        assert_eq!(normal_in_target(&solid), None);
    }
}
