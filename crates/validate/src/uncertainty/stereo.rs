//! How well two cameras of a rig measure distance.

use boresight_camera::Camera;
use boresight_data::{Calibration, CameraId, Id as _};
use boresight_geometry::nalgebra::{DMatrix, Matrix4x3, Vector4};
use boresight_geometry::{Pose, Vector3};
use serde::{Deserialize, Serialize};

use super::map::check_distance;
use super::{AXES, Joint, Propagation};
use crate::Error;
use crate::compare::grid::Grid;
use crate::slopes::Slopes;
use crate::statistics::quantile;

/// Points across the first camera's image.
const COLUMNS: usize = 21;
/// Points down.
const ROWS: usize = 15;

/// How well two cameras measure the distance of what both see.
///
/// A point is triangulated from its pixels in both cameras, where the sum of squared residuals is least.
/// Its distance from the first camera's centre does not depend on how that camera's frame is turned.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StereoUncertainty {
    /// The camera from which distance is measured.
    pub from: String,
    /// The other one.
    pub to: String,
    /// The distance of the two centres in millimetres.
    pub baseline_mm: f64,
    /// The standard deviation of that in millimetres.
    pub baseline_sigma_mm: f64,
    /// The distance of the points in metres.
    pub distance_m: f64,
    /// The number of points of a grid over the first camera's image that the other sees as well.
    pub points: usize,
    /// The standard deviation of the measured distance in millimetres that comes from the calibration:
    /// the median over these points.
    pub calibration_sigma_mm: f64,
    /// The largest of these.
    pub calibration_worst_mm: f64,
    /// The median standard deviation in millimetres that comes from noise of a pixel in each image, as
    /// large as the noise of the corners of the calibration.
    pub observation_sigma_mm: f64,
}

/// Returns how well two cameras measure distance, `None` if no point at `distance_m` is seen by both.
pub fn stereo_uncertainty(
    calibration: &Calibration,
    [from, to]: [CameraId; 2],
    distance_m: f64,
    propagation: Propagation,
) -> Result<Option<StereoUncertainty>, Error> {
    check_distance(Some(distance_m))?;
    let joint = Joint::new(&calibration.uncertainty, propagation)?;
    let [from_eye, to_eye] = [from, to].map(|id| Eye::new(calibration, &joint, id));
    let (from_eye, to_eye) = (from_eye?, to_eye?);
    let places: Vec<usize> = from_eye.places().chain(to_eye.places()).collect();
    let covariance = DMatrix::from_row_slice(places.len(), places.len(), &joint.block(&places));
    let gradients = Gradients { eyes: [&from_eye, &to_eye], n: places.len() };

    let grid = Grid { image_size: from_eye.camera.image_size, columns: COLUMNS, rows: ROWS };
    let corner_sigma_px = calibration.corner_sigma_px(|fit| fit.observations);
    let (mut by_calibration, mut by_noise) = (Vec::new(), Vec::new());
    for i in 0..grid.len() {
        let Some(ray) = from_eye.camera.unproject(grid.pixel(i)) else { continue };
        let point_in_rig = from_eye.cam_from_rig.inverse() * (ray * distance_m);
        let Some((by_parameter, by_pixel)) = gradients.of_distance(&point_in_rig) else { continue };
        by_calibration.push((by_parameter.transpose() * &covariance * &by_parameter)[0].max(0.0).sqrt());
        by_noise.push(by_pixel.norm() * corner_sigma_px);
    }
    let Some(median) = quantile(by_calibration.iter().copied(), 0.5) else { return Ok(None) };
    let (baseline, by_parameter) = gradients.of_baseline();
    let baseline_variance = (by_parameter.transpose() * &covariance * &by_parameter)[0];
    Ok(Some(StereoUncertainty {
        from: from_eye.name.clone(),
        to: to_eye.name.clone(),
        baseline_mm: 1e3 * baseline,
        baseline_sigma_mm: 1e3 * baseline_variance.max(0.0).sqrt(),
        distance_m,
        points: by_calibration.len(),
        calibration_sigma_mm: 1e3 * median,
        calibration_worst_mm: 1e3 * by_calibration.iter().copied().fold(0.0, f64::max),
        observation_sigma_mm: 1e3 * quantile(by_noise.iter().copied(), 0.5).unwrap_or(0.0),
    }))
}

/// A camera with the places of what was estimated of it.
pub(crate) struct Eye {
    pub(crate) name: String,
    pub(crate) camera: Camera,
    pub(crate) cam_from_rig: Pose,
    /// The lens parameters that were estimated: index and place.
    pub(crate) lens: Vec<(usize, usize)>,
    /// The columns of the pose that were: column and place.
    pub(crate) pose: Vec<(usize, usize)>,
}

impl Eye {
    fn new(calibration: &Calibration, joint: &Joint<'_>, id: CameraId) -> Result<Self, Error> {
        let name = calibration.cameras.get(id).map_or_else(|| id.index().to_string(), |fit| fit.name.clone());
        let placed = calibration.scene.rig.cameras.get(id).and_then(Option::as_ref);
        let placed = placed.ok_or_else(|| Error::NotCalibrated { camera: name.clone() })?;
        Ok(Self::of(joint, name, placed.camera.clone(), placed.cam_from_rig))
    }

    pub(crate) fn of(joint: &Joint<'_>, name: String, camera: Camera, cam_from_rig: Pose) -> Self {
        let place = |i: usize, parameter: &str| Some((i, joint.place(&format!("{name}.{parameter}"))?));
        let lens =
            camera.model.param_names().iter().enumerate().filter_map(|(i, param)| place(i, param)).collect();
        let pose = AXES
            .iter()
            .enumerate()
            .filter_map(|(k, axis)| place(k, &format!("cam_from_rig.{axis}")))
            .collect();
        Self { name, camera, cam_from_rig, lens, pose }
    }

    /// Returns the places of lens and pose, in this order.
    pub(crate) fn places(&self) -> impl Iterator<Item = usize> + '_ {
        self.lens.iter().chain(&self.pose).map(|(_, place)| *place)
    }

    /// Tells whether a pixel is in the image.
    pub(crate) fn is_inside(&self, [u, v]: [f64; 2]) -> bool {
        let [width, height] = self.camera.image_size.map(f64::from);
        (-0.5..=width - 0.5).contains(&u) && (-0.5..=height - 0.5).contains(&v)
    }
}

/// How distances vary with what was estimated of two cameras.
struct Gradients<'a> {
    eyes: [&'a Eye; 2],
    n: usize,
}

impl Gradients<'_> {
    /// Returns the derivatives of a triangulated point's distance from the first camera by the
    /// parameters and by the four pixel coordinates; `None` if a camera does not see it.
    fn of_distance(&self, point_in_rig: &Vector3<f64>) -> Option<(DMatrix<f64>, Vector4<f64>)> {
        let mut by_point = Matrix4x3::zeros();
        let mut by_parameter = DMatrix::zeros(4, self.n);
        let mut slopes = Slopes::default();
        let mut first = 0;
        for (which, eye) in self.eyes.iter().enumerate() {
            let point_in_cam = eye.cam_from_rig * *point_in_rig;
            slopes.fill(&eye.camera, &point_in_cam)?;
            if !eye.is_inside(slopes.pixel) && which > 0 {
                return None;
            }
            let in_rig = slopes.by_point * eye.cam_from_rig.rotation_matrix();
            by_point.fixed_view_mut::<2, 3>(2 * which, 0).copy_from(&in_rig);
            let [by_turn, by_shift] = slopes.by_motion(&point_in_cam);
            for (i, _) in &eye.lens {
                (0..2).for_each(|row| by_parameter[(2 * which + row, first)] = slopes.by_param[row][*i]);
                first += 1;
            }
            for (k, _) in &eye.pose {
                let motion = if *k < 3 { &by_turn } else { &by_shift };
                (0..2).for_each(|row| by_parameter[(2 * which + row, first)] = motion[(row, *k % 3)]);
                first += 1;
            }
        }
        // The least sum of squares: (JᵀJ) dX = Jᵀ (dq - Jp dp).
        let normal = (by_point.transpose() * by_point).try_inverse()?;
        let by_pixel = normal * by_point.transpose();
        // The distance is |C X|, with C X = point_in_cam: along the ray for the point, and for the
        // camera's own motion as well, of which only the translation matters.
        let from = self.eyes[0];
        let ray = (from.cam_from_rig * *point_in_rig).normalize();
        let ray_in_rig = from.cam_from_rig.rotation.inverse() * ray;
        let by_pixel = (ray_in_rig.transpose() * by_pixel).transpose();
        let mut of_distance = -(by_parameter.transpose() * by_pixel);
        for (i, (k, _)) in from.pose.iter().enumerate().filter(|(_, (k, _))| *k >= 3) {
            of_distance[from.lens.len() + i] += ray[*k - 3];
        }
        Some((DMatrix::from_column_slice(self.n, 1, of_distance.as_slice()), by_pixel))
    }

    /// Returns the distance of the centres in metres, with its derivatives.
    fn of_baseline(&self) -> (f64, DMatrix<f64>) {
        let [from, to] = self.eyes;
        let from_centre = from.cam_from_rig.inverse().translation;
        let to_centre = to.cam_from_rig.inverse().translation;
        let apart = to_centre - from_centre;
        let direction = apart / apart.norm().max(f64::MIN_POSITIVE);
        let mut gradient = DMatrix::zeros(self.n, 1);
        let mut first = 0;
        for (eye, sign) in [(from, 1.0), (to, -1.0)] {
            first += eye.lens.len();
            // A left perturbation (w, v) moves the centre by -Rᵀ v.
            let along = eye.cam_from_rig.rotation * direction;
            for (k, _) in &eye.pose {
                if *k >= 3 {
                    gradient[first] = sign * along[*k - 3];
                }
                first += 1;
            }
        }
        (apart.norm(), gradient)
    }
}
