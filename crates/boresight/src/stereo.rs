//! Points from the pixels of several cameras of a calibration, or of one that moved: Eqs 8.17 to 8.22.

use std::collections::BTreeSet;

use boresight_adjust::{Sight, SightedPoint, sighted_point};
use boresight_camera::textbook::stereo::{Rectified, StereoPoint};
use boresight_geometry::nalgebra::DMatrix;
use boresight_geometry::{Matrix3, Pose, Vector3};
use boresight_io::NamedCamera;

use crate::error::Error;
use crate::known_rig::{KnownRig, POSE_COLUMNS, lens_names};
use crate::robot_error::RobotError;

/// The places from which points are seen: cameras of a rig, or one camera in several poses.
#[derive(Clone, Debug, PartialEq)]
pub struct Stereo<'a> {
    rig: &'a KnownRig,
    places: Vec<Place<'a>>,
}

#[derive(Clone, Debug, PartialEq)]
struct Place<'a> {
    camera: &'a NamedCamera,
    cam_from_ref: Pose,
    /// Whether the pose is the calibration's, whose errors are then known.
    is_calibrated: bool,
}

/// A point and how well it is known.
#[derive(Clone, Debug, PartialEq)]
pub struct StereoFix {
    /// The point with its residuals and its covariance by the pixels' noise.
    pub point: SightedPoint,
    /// Its covariance by the errors of the calibration, in m²; `None` where these are not known.
    pub covariance_by_calibration: Option<Matrix3<f64>>,
}

impl StereoFix {
    /// Returns the covariance of the point by pixels and calibration together, in m².
    pub fn covariance(&self) -> Matrix3<f64> {
        self.point.covariance_by_pixels + self.covariance_by_calibration.unwrap_or_else(Matrix3::zeros)
    }

    /// Returns the sigmas along x, y and z, in metres.
    pub fn sigma_m(&self) -> [f64; 3] {
        let covariance = self.covariance();
        [0, 1, 2].map(|axis| covariance[(axis, axis)].sqrt())
    }
}

impl<'a> Stereo<'a> {
    /// Returns the stereo of some cameras of a rig; points are in the frame of the rig.
    pub fn of_cameras(rig: &'a KnownRig, names: &[String]) -> Result<Self, Error> {
        let chosen: Vec<&NamedCamera> = if names.is_empty() {
            rig.cameras.iter().collect()
        } else {
            names.iter().map(|name| rig.camera(Some(name))).collect::<Result<_, _>>()?
        };
        let names: BTreeSet<&str> = chosen.iter().map(|camera| camera.name.as_str()).collect();
        if names.len() < 2 {
            return Err(RobotError::OneCamera {
                name: names.first().copied().unwrap_or_default().to_owned(),
            }
            .into());
        }
        let place = |camera: &'a NamedCamera| match camera.cam_from_rig {
            Some(cam_from_ref) => Ok(Place { camera, cam_from_ref, is_calibrated: true }),
            None => Err(Error::from(RobotError::NoPose { name: camera.name.clone() })),
        };
        Ok(Self { rig, places: chosen.into_iter().map(place).collect::<Result<_, _>>()? })
    }

    /// Returns the stereo of one camera that was moved: `cam_from_first` of each further pose. Points are in
    /// the camera's frame in its first pose.
    pub fn of_moved_camera(
        rig: &'a KnownRig,
        name: Option<&str>,
        cam_from_first: &[Pose],
    ) -> Result<Self, Error> {
        let camera = rig.camera(name)?;
        let poses = [Pose::identity()].into_iter().chain(cam_from_first.iter().copied());
        let places = poses.map(|cam_from_ref| Place { camera, cam_from_ref, is_calibrated: false });
        Ok(Self { rig, places: places.collect() })
    }

    /// Returns the names of the cameras, place by place.
    pub fn names(&self) -> Vec<&str> {
        self.places.iter().map(|place| place.camera.name.as_str()).collect()
    }

    /// Returns the most likely point for one pixel of each place, `None` where it was not seen.
    pub fn fix<'b>(&'b self, pixels: &[Option<[f64; 2]>], sigma_px: f64) -> Result<StereoFix, Error> {
        let seen: Vec<(&'b Place<'a>, [f64; 2])> =
            self.places.iter().zip(pixels).filter_map(|(place, pixel)| Some((place, (*pixel)?))).collect();
        let sight = |(place, pixel): &(&'b Place<'a>, [f64; 2])| Sight {
            camera: &place.camera.camera,
            cam_from_ref: place.cam_from_ref,
            pixel: *pixel,
            sigma_px,
        };
        let sights: Vec<Sight<'_>> = seen.iter().map(sight).collect();
        let point = sighted_point(&sights).map_err(RobotError::from)?;
        let places: Vec<&Place<'_>> = seen.iter().map(|(place, _)| *place).collect();
        let covariance_by_calibration = self.by_calibration(&places, &point);
        Ok(StereoFix { point, covariance_by_calibration })
    }

    /// Propagates the joint covariance of lenses and poses; what two places share errs alike in both.
    fn by_calibration(&self, places: &[&Place<'_>], point: &SightedPoint) -> Option<Matrix3<f64>> {
        let mut names: Vec<String> = Vec::new();
        let mut gains: Vec<Vector3<f64>> = Vec::new();
        let mut add = |name: String, gain: Vector3<f64>| match names.iter().position(|known| *known == name) {
            Some(i) => gains[i] += gain,
            None => {
                names.push(name);
                gains.push(gain);
            }
        };
        for (i, place) in places.iter().enumerate() {
            let camera = place.camera;
            for (k, name) in lens_names(&camera.name, &camera.camera).into_iter().enumerate() {
                add(name, point.d_by_lens[i].column(k).into_owned());
            }
            if place.is_calibrated {
                for (k, column) in POSE_COLUMNS.iter().enumerate() {
                    let gain = point.d_by_pose[i].column(k).into_owned();
                    add(format!("{}.cam_from_rig.{column}", camera.name), gain);
                }
            }
        }
        let covariance = self.rig.covariance_of(&names)?;
        let gain = DMatrix::from_fn(3, gains.len(), |row, column| gains[column][row]);
        let spread = &gain * covariance * gain.transpose();
        Some(Matrix3::from_iterator(spread.iter().copied()))
    }

    /// Returns the point of the first two places by the textbook's parallel equations, after rectification,
    /// in the reference frame; `None` where they have none.
    pub fn rectified(&self, pixels: [[f64; 2]; 2]) -> Option<StereoPoint> {
        let [left, right] = [self.places.first()?, self.places.get(1)?];
        let right_from_left = right.cam_from_ref * left.cam_from_ref.inverse();
        let rectified = Rectified::new(&right_from_left)?;
        let mut found = rectified.point([&left.camera.camera, &right.camera.camera], pixels)?;
        found.point_in_left = left.cam_from_ref.inverse() * found.point_in_left;
        Some(found)
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    #[test]
    fn a_calibrated_pair_sees_depth_with_its_sigma() {
        let job = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../datasets/opencv-stereo");
        let job = boresight_io::load_job(&[job], &boresight_io::JobOverrides::default()).unwrap();
        let options = crate::CalibrateOptions::of_job(&job).unwrap();
        let outcome = crate::calibrate(&job, &options, &crate::Watch::default()).unwrap();
        let folder = tempfile::tempdir().unwrap();
        crate::write_results(&outcome, folder.path()).unwrap();
        let rig = KnownRig::read(folder.path()).unwrap();
        let stereo = Stereo::of_cameras(&rig, &[]).unwrap();
        let point = Vector3::new(0.05, -0.03, 0.6);
        let pixels: Vec<[f64; 2]> = rig
            .cameras
            .iter()
            .map(|camera| camera.camera.project(&(camera.cam_from_rig.unwrap() * point)).unwrap())
            .collect();
        let fix = stereo.fix(&[Some(pixels[0]), Some(pixels[1])], 0.1).unwrap();
        assert!((fix.point.point_in_ref - point).norm() < 1e-9, "{}", fix.point.point_in_ref);
        // z² / (f b) times the root of two of 0.1 px: 0.36 / (535 * 0.0832) * 0.141 = 1.1 mm.
        let by_pixels = fix.point.covariance_by_pixels[(2, 2)].sqrt();
        assert!((by_pixels / 1.15e-3 - 1.0).abs() < 0.1, "{by_pixels}");
        assert!(fix.sigma_m()[2] > by_pixels && fix.sigma_m()[2] < 3.0 * by_pixels, "{:?}", fix.sigma_m());
        let rectified = stereo.rectified([pixels[0], pixels[1]]).unwrap();
        assert!((rectified.point_in_left - point).norm() < 1e-9, "{rectified:?}");
        assert!(stereo.fix(&[Some(pixels[0]), None], 0.1).is_err());
    }
}
