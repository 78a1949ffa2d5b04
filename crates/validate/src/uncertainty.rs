//! How well a calibrated camera's projections are known, over the image and with distance.
//!
//! A pixel is unprojected with the calibration as it is, to a point at a distance (or at infinity), and
//! that point is projected again with lens and frame as they might as well have come out. Of the frame,
//! only what the corners do not tell from a motion of all targets counts: how that motion is found is
//! the [`Method`]. To first order it is linear in everything that was estimated, so the covariance of a
//! pixel is a small matrix between two gradients: no system is solved for a pixel.
//!
//! ```text
//! mean-frame:          dq = L dlens + P (M(p) dcam + R M(p_rig) dmean)
//! cross-reprojection:  dq = L dlens + P M(p) dviews                          M(p) = [-[p]x | I]
//! ```
//!
//! with L and P the pixel's derivatives by lens and point, R the rotation of `cam_from_rig`, `dmean` the
//! mean motion of all targets in the rig and `dviews` the motion of the camera's own views (see
//! [`Motions`](boresight_data::Motions)). At infinity, motions have no translation. The covariances contain
//! the noise as the residuals tell it. What a model cannot describe is in neither.

mod joint;
mod map;
mod stereo;

use boresight_camera::Camera;
use boresight_data::{Calibration, CameraId};
use boresight_geometry::nalgebra::Matrix2;
use boresight_geometry::{Pose, Vector3};
use serde::{Deserialize, Serialize};

use crate::Error;
use crate::slopes::{Slopes, by_turn};
pub(crate) use joint::Joint;
pub use map::{AtDistance, UncertaintyMap};
pub(crate) use stereo::Eye;
pub use stereo::{StereoUncertainty, stereo_uncertainty};

const AXES: [&str; 6] = ["rx_rad", "ry_rad", "rz_rad", "tx_m", "ty_m", "tz_m"];

/// What of the camera's frame is taken to be a motion of the targets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// The motion that explains best how the camera's own corners move. It serves moving cameras too.
    #[default]
    CrossReprojection,
    /// The mean of the motions of all frames: mrcal's `mean-pcam`.
    MeanFrame,
}

/// What the covariance counts as known.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Propagation {
    /// The regularisation counts as knowledge that may be wrong by its sigmas.
    #[default]
    WithBeliefs,
    /// Only noise of the observations is passed on; the regularisation pulls, but is never wrong: mrcal's way.
    ObservationsOnly,
}

/// The scatter of a projected pixel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// The covariance of u and v in px².
    pub covariance_px2: [[f64; 2]; 2],
}

/// How well one camera's projections are known: a joint covariance of two dozen numbers.
#[derive(Clone, Debug)]
pub struct ProjectionUncertainty {
    camera: Camera,
    cam_from_rig: Pose,
    method: Method,
    /// The lens parameters that were estimated, by their index.
    lens: Vec<usize>,
    /// The columns of the camera's own motion that were estimated, where the method needs it.
    own: Vec<usize>,
    /// The covariance of lens, own motion and frame motion, row by row.
    covariance: Vec<f64>,
    n: usize,
}

impl ProjectionUncertainty {
    /// Returns what is known of a camera, or why nothing is.
    pub fn new(
        calibration: &Calibration,
        camera: CameraId,
        method: Method,
        propagation: Propagation,
    ) -> Result<Self, Error> {
        let joint = Joint::new(&calibration.uncertainty, propagation)?;
        let name = calibration.cameras.get(camera).map_or("?", |fit| fit.name.as_str());
        let placed = calibration.scene.rig.cameras.get(camera).and_then(Option::as_ref);
        let placed = placed.ok_or_else(|| Error::NotCalibrated { camera: name.to_owned() })?;
        let params = placed.camera.model.param_names();
        let (lens, mut places): (Vec<usize>, Vec<usize>) = params
            .iter()
            .enumerate()
            .filter_map(|(i, param)| Some((i, joint.place(&format!("{name}.{param}"))?)))
            .unzip();
        let mut own = Vec::new();
        if method == Method::MeanFrame {
            for (k, axis) in AXES.iter().enumerate() {
                if let Some(place) = joint.place(&format!("{name}.cam_from_rig.{axis}")) {
                    own.push(k);
                    places.push(place);
                }
            }
        }
        for axis in AXES {
            let motion = match method {
                Method::MeanFrame => format!("mean.{axis}"),
                Method::CrossReprojection => format!("{name}.views.{axis}"),
            };
            places.push(joint.place(&motion).ok_or_else(|| Error::NoMotions { camera: name.to_owned() })?);
        }
        let covariance = joint.block(&places);
        Ok(Self {
            camera: placed.camera.clone(),
            cam_from_rig: placed.cam_from_rig,
            method,
            lens,
            own,
            covariance,
            n: places.len(),
        })
    }

    /// Returns the camera.
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// Returns the scatter of the projection of what `pixel` sees at a distance in metres (`None` is
    /// infinity), or `None` if the pixel sees nothing.
    pub fn at(&self, pixel: [f64; 2], distance_m: Option<f64>) -> Option<Spread> {
        self.at_with(pixel, distance_m, &mut Room::default())
    }

    /// Returns the scatter of the projection of a point in the camera frame, in metres, or `None` if the
    /// camera does not see it.
    pub fn at_point(&self, point_in_cam: &Vector3<f64>) -> Option<Spread> {
        self.of(point_in_cam, true, &mut Room::default())
    }

    /// Returns the scatter of the projection of a direction in the camera frame, that is, of a point at
    /// infinity, or `None` if the camera does not see it.
    pub fn at_direction(&self, direction_in_cam: &Vector3<f64>) -> Option<Spread> {
        self.of(direction_in_cam, false, &mut Room::default())
    }

    /// Does what [`at`](Self::at) does in room that is used again.
    fn at_with(&self, pixel: [f64; 2], distance_m: Option<f64>, room: &mut Room) -> Option<Spread> {
        let point_in_cam = self.camera.unproject(pixel)? * distance_m.unwrap_or(1.0);
        self.of(&point_in_cam, distance_m.is_some(), room)
    }

    fn of(&self, point_in_cam: &Vector3<f64>, is_near: bool, room: &mut Room) -> Option<Spread> {
        room.slopes.fill(&self.camera, point_in_cam)?;
        self.fill_gradients(point_in_cam, is_near, room);
        let n = self.n;
        let [by_u, by_v] = &room.gradients;
        let (mut uu, mut uv, mut vv) = (0.0, 0.0, 0.0);
        for (row, (u, v)) in self.covariance.chunks_exact(n).zip(by_u.iter().zip(by_v)) {
            let (mut along_u, mut along_v) = (0.0, 0.0);
            for (entry, (u, v)) in row.iter().zip(by_u.iter().zip(by_v)) {
                along_u += entry * u;
                along_v += entry * v;
            }
            uu += u * along_u;
            uv += v * along_u;
            vv += v * along_v;
        }
        let is_sound = uu >= 0.0 && vv >= 0.0 && uu.is_finite() && vv.is_finite() && uv.is_finite();
        is_sound.then_some(Spread { covariance_px2: [[uu, uv], [uv, vv]] })
    }

    /// Writes how u and v move with each of the joint covariance's numbers.
    fn fill_gradients(&self, point_in_cam: &Vector3<f64>, is_near: bool, room: &mut Room) {
        let [by_u, by_v] = &mut room.gradients;
        by_u.clear();
        by_v.clear();
        by_u.extend(self.lens.iter().map(|&i| room.slopes.by_param[0][i]));
        by_v.extend(self.lens.iter().map(|&i| room.slopes.by_param[1][i]));
        let [by_turn_in_cam, by_shift_in_cam] = room.slopes.by_motion(point_in_cam);
        let near = if is_near { 1.0 } else { 0.0 };
        let mut push = |row: usize, turn: f64, shift: f64, k: usize| {
            let entry = if k < 3 { turn } else { near * shift };
            if row == 0 { by_u.push(entry) } else { by_v.push(entry) }
        };
        match self.method {
            Method::CrossReprojection => {
                for row in 0..2 {
                    for k in 0..6 {
                        push(row, by_turn_in_cam[(row, k % 3)], by_shift_in_cam[(row, k % 3)], k);
                    }
                }
            }
            Method::MeanFrame => {
                let rig_from_cam = self.cam_from_rig.inverse();
                let point_in_rig = if is_near {
                    rig_from_cam * *point_in_cam
                } else {
                    rig_from_cam.rotation * *point_in_cam
                };
                let by_shift = room.slopes.by_point * self.cam_from_rig.rotation_matrix();
                let by_turn = by_shift * by_turn(&point_in_rig);
                for row in 0..2 {
                    for &k in &self.own {
                        push(row, by_turn_in_cam[(row, k % 3)], by_shift_in_cam[(row, k % 3)], k);
                    }
                    for k in 0..6 {
                        push(row, by_turn[(row, k % 3)], by_shift[(row, k % 3)], k);
                    }
                }
            }
        }
    }
}

/// Room for one point's derivatives.
#[derive(Debug, Default)]
pub(crate) struct Room {
    slopes: Slopes,
    gradients: [Vec<f64>; 2],
}

impl Spread {
    /// Returns the standard deviation along the worst direction, in pixels.
    pub fn worst_px(&self) -> f64 {
        let [[uu, uv], [_, vv]] = self.covariance_px2;
        let (mean, half) = (0.5 * (uu + vv), 0.5 * (uu - vv));
        (mean + half.hypot(uv)).max(0.0).sqrt()
    }

    /// Returns the worst direction's angle from u towards v, in degrees from -90 to 90.
    pub fn worst_direction_deg(&self) -> f64 {
        let [[uu, uv], [_, vv]] = self.covariance_px2;
        (0.5 * (2.0 * uv).atan2(uu - vv)).to_degrees()
    }

    /// Returns the root of the mean variance of both coordinates, in pixels.
    pub fn rms_px(&self) -> f64 {
        (0.5 * (self.covariance_px2[0][0] + self.covariance_px2[1][1])).sqrt()
    }

    pub(crate) fn matrix(&self) -> Matrix2<f64> {
        let [[uu, uv], [vu, vv]] = self.covariance_px2;
        Matrix2::new(uu, uv, vu, vv)
    }
}
