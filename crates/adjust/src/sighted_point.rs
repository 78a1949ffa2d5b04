//! A point seen by two or more cameras, or by one that moved: where it is, and how well that is known.
//!
//! The point with the least sum of squared residuals in all images, which for normal noise is the most
//! likely one. Its covariance has two parts: the noise of the pixels, and the errors of the calibration,
//! to which the derivatives here lead.

use boresight_camera::Camera;
use boresight_geometry::nalgebra::{DMatrix, Matrix3x6, Matrix3xX};
use boresight_geometry::{Matrix3, Pose, Vector3};

use crate::object_pose::{pixel_by_pose, scaled_inverse};

/// A pixel of one camera in one pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sight<'a> {
    /// The camera.
    pub camera: &'a Camera,
    /// Where it was.
    pub cam_from_ref: Pose,
    /// Where it saw the point.
    pub pixel: [f64; 2],
    /// The standard deviation of either pixel coordinate.
    pub sigma_px: f64,
}

/// A point and how well it is known.
#[derive(Clone, Debug, PartialEq)]
pub struct SightedPoint {
    /// The point in the reference frame.
    pub point_in_ref: Vector3<f64>,
    /// Predicted minus seen pixel of each sight.
    pub residuals_px: Vec<[f64; 2]>,
    /// The sum of squared residuals in units of their sigma.
    pub chi2: f64,
    /// Equations minus unknowns: two for each sight, less three.
    pub degrees_of_freedom: usize,
    /// The covariance of the point by the noise of the pixels, in m².
    pub covariance_by_pixels: Matrix3<f64>,
    /// How the point moves with the lens parameters of each sight's camera.
    pub d_by_lens: Vec<Matrix3xX<f64>>,
    /// How the point moves with a left perturbation of each sight's `cam_from_ref`.
    pub d_by_pose: Vec<Matrix3x6<f64>>,
    /// The largest angle between two rays, in radians.
    pub parallax_rad: f64,
}

/// What keeps a point from being found.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SightedPointError {
    /// There are fewer than two sights.
    #[error("{found} sights are given; {need} are needed for a point")]
    TooFewSights {
        /// How many are given.
        found: usize,
        /// How many are needed.
        need: usize,
    },
    /// A pixel sees nothing.
    #[error("the pixel ({:.1}, {:.1}) of sight {sight} (counted from 0) has no direction in its lens", pixel[0], pixel[1])]
    NoDirection {
        /// The sight, counted from 0.
        sight: usize,
        /// The pixel.
        pixel: [f64; 2],
    },
    /// The rays do not meet in front of the cameras.
    #[error("the rays do not meet in front of all cameras: they are {parallax_rad:.1e} rad apart")]
    NoMeeting {
        /// The largest angle between two rays, in radians.
        parallax_rad: f64,
    },
}

/// Returns the point that explains all sights best.
pub fn sighted_point(sights: &[Sight<'_>]) -> Result<SightedPoint, SightedPointError> {
    const MAX_STEPS: usize = 50;
    if sights.len() < 2 {
        return Err(SightedPointError::TooFewSights { found: sights.len(), need: 2 });
    }
    let mut rays = Vec::with_capacity(sights.len());
    for (sight, seen) in sights.iter().enumerate() {
        let direction = seen.camera.unproject(seen.pixel);
        let direction = direction.ok_or(SightedPointError::NoDirection { sight, pixel: seen.pixel })?;
        let ref_from_cam = seen.cam_from_ref.inverse();
        rays.push((ref_from_cam.translation, ref_from_cam.rotation * direction));
    }
    let parallax_rad = largest_angle(&rays);
    let no_meeting = SightedPointError::NoMeeting { parallax_rad };
    let mut point = nearest_to_rays(&rays).ok_or(no_meeting)?;
    let is_ahead = |point: &Vector3<f64>| rays.iter().all(|(from, ray)| (point - from).dot(ray) > 0.0);
    if !is_ahead(&point) {
        return Err(no_meeting);
    }
    let mut system = System::at(sights, &point).ok_or(no_meeting)?;
    for _ in 0..MAX_STEPS {
        let Some(factor) = system.normal.cholesky() else { return Err(no_meeting) };
        let mut step = -factor.solve(&system.gradient);
        let predicted = -0.5 * step.dot(&system.gradient);
        if predicted.is_nan() || predicted < 1e-18 * (1.0 + system.chi2) {
            break;
        }
        // Steps that lead out of sight or uphill are halved.
        let mut moved = None;
        for _ in 0..30 {
            let trial = point + step;
            match System::at(sights, &trial) {
                Some(next) if next.chi2 < system.chi2 && is_ahead(&trial) => {
                    moved = Some((trial, next));
                    break;
                }
                _ => step *= 0.5,
            }
        }
        let Some((trial, next)) = moved else { break };
        (point, system) = (trial, next);
    }
    system.assess(sights, point, parallax_rad).ok_or(no_meeting)
}

/// The normal equations of the reprojection errors.
struct System {
    normal: Matrix3<f64>,
    gradient: Vector3<f64>,
    chi2: f64,
}

impl System {
    fn at(sights: &[Sight<'_>], point_in_ref: &Vector3<f64>) -> Option<Self> {
        let mut system = Self { normal: Matrix3::zeros(), gradient: Vector3::zeros(), chi2: 0.0 };
        for seen in sights {
            let point_in_cam = seen.cam_from_ref * *point_in_ref;
            let at = seen.camera.linearize(&point_in_cam)?;
            let weight = seen.sigma_px.powi(-2);
            for row in 0..2 {
                let slope = seen.cam_from_ref.rotation.inverse() * Vector3::from(at.d_point[row]);
                let residual = at.pixel[row] - seen.pixel[row];
                system.normal += slope * slope.transpose() * weight;
                system.gradient += slope * (weight * residual);
                system.chi2 += weight * residual * residual;
            }
        }
        Some(system)
    }

    /// Returns the point with its covariance and its derivatives, or `None` if the rays are parallel.
    fn assess(
        &self,
        sights: &[Sight<'_>],
        point_in_ref: Vector3<f64>,
        parallax_rad: f64,
    ) -> Option<SightedPoint> {
        let covariance_by_pixels = scaled_inverse(&self.normal).0?;
        let (mut d_by_lens, mut d_by_pose, mut residuals_px) = (Vec::new(), Vec::new(), Vec::new());
        for seen in sights {
            let point_in_cam = seen.cam_from_ref * point_in_ref;
            let at = seen.camera.linearize(&point_in_cam)?;
            let d_point = Matrix3::from_rows(&[
                Vector3::from(at.d_point[0]).transpose(),
                Vector3::from(at.d_point[1]).transpose(),
                Vector3::zeros().transpose(),
            ]);
            let slopes = (d_point * seen.cam_from_ref.rotation_matrix()).fixed_rows::<2>(0).into_owned();
            // The optimum moves against what moves the predictions.
            let gain = -(covariance_by_pixels * slopes.transpose()) * seen.sigma_px.powi(-2);
            let lens = DMatrix::from_fn(2, seen.camera.params.len(), |row, i| at.d_params[row][i]);
            d_by_lens.push(gain * lens);
            d_by_pose.push(gain * pixel_by_pose(&at.d_point, &point_in_cam));
            residuals_px.push([0, 1].map(|row| at.pixel[row] - seen.pixel[row]));
        }
        Some(SightedPoint {
            point_in_ref,
            residuals_px,
            chi2: self.chi2,
            degrees_of_freedom: 2 * sights.len() - 3,
            covariance_by_pixels,
            d_by_lens,
            d_by_pose,
            parallax_rad,
        })
    }
}

/// Returns the point with the least sum of squared distances from rays, or `None` if they are parallel.
fn nearest_to_rays(rays: &[(Vector3<f64>, Vector3<f64>)]) -> Option<Vector3<f64>> {
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for (from, ray) in rays {
        let across = Matrix3::identity() - ray * ray.transpose();
        normal += across;
        right += across * from;
    }
    let (inverse, _) = scaled_inverse(&normal);
    inverse.map(|inverse| inverse * right)
}

fn largest_angle(rays: &[(Vector3<f64>, Vector3<f64>)]) -> f64 {
    let mut largest = 0f64;
    for (i, (_, one)) in rays.iter().enumerate() {
        for (_, other) in &rays[i + 1..] {
            largest = largest.max(one.cross(other).norm().atan2(one.dot(other)));
        }
    }
    largest
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_numbers::Normals;

    fn camera(fx: f64) -> Camera {
        let params = vec![fx, fx - 10.0, 800.5, 610.0, -0.2, 0.05, 1e-3, -5e-4, 0.02];
        Camera::new("opencv5".parse().unwrap(), params, [1600, 1200]).unwrap()
    }

    /// Cameras in a row, 0.15 m apart, turned inwards.
    fn poses(n: usize) -> Vec<Pose> {
        let pose = |i: usize| {
            let x = 0.15 * i as f64;
            Pose::from_rodrigues(
                Vector3::new(0.01 * i as f64, 0.1 * i as f64, 0.02),
                Vector3::new(-x, 0.01, 0.02),
            )
        };
        (0..n).map(pose).collect()
    }

    const POINT: Vector3<f64> = Vector3::new(0.1, -0.05, 1.2);

    #[test]
    fn exact_sights_give_the_point() {
        let camera = camera(1200.0);
        for n in [2, 3, 5] {
            let poses = poses(n);
            let sights: Vec<Sight<'_>> = poses
                .iter()
                .map(|&cam_from_ref| Sight {
                    camera: &camera,
                    cam_from_ref,
                    pixel: camera.project(&(cam_from_ref * POINT)).unwrap(),
                    sigma_px: 0.2,
                })
                .collect();
            let found = sighted_point(&sights).unwrap();
            assert!((found.point_in_ref - POINT).norm() < 1e-10, "{n}: {}", found.point_in_ref);
            assert_eq!(found.degrees_of_freedom, 2 * n - 3);
        }
    }

    /// Pixels, lenses and poses perturbed together: the stated covariance is the scatter.
    fn check_scatter(n: usize, lenses_are_one: bool) {
        let nominal = [camera(1200.0), camera(1150.0), camera(1250.0)];
        let poses = poses(n);
        let lens_sigmas = [0.5, 0.5, 0.8, 0.8, 1e-3, 3e-3, 1e-4, 1e-4, 2e-3];
        let pose_sigmas = [2e-4, 2e-4, 2e-4, 3e-4, 3e-4, 3e-4];
        let lens_of = |i: usize| if lenses_are_one { 0 } else { i };
        let mut normals = Normals::new(n as u64);
        let runs = 3000;
        let (mut scatter, mut stated) = (Matrix3::zeros(), Matrix3::zeros());
        for _ in 0..runs {
            let mut lenses = nominal.clone();
            for lens in &mut lenses {
                for (param, sigma) in lens.params.iter_mut().zip(lens_sigmas) {
                    *param += sigma * normals.next();
                }
            }
            let sights: Vec<Sight<'_>> = poses
                .iter()
                .enumerate()
                .map(|(i, &cam_from_ref)| {
                    // The first camera is the reference.
                    let share = if i == 0 { 0.0 } else { 1.0 };
                    let off = pose_sigmas.map(|sigma| share * sigma * normals.next());
                    let true_pose = cam_from_ref.perturbed(&off.into());
                    let pixel = lenses[lens_of(i)].project(&(true_pose * POINT)).unwrap();
                    let pixel = pixel.map(|x| x + 0.2 * normals.next());
                    Sight { camera: &nominal[lens_of(i)], cam_from_ref, pixel, sigma_px: 0.2 }
                })
                .collect();
            let found = sighted_point(&sights).unwrap();
            let error = found.point_in_ref - POINT;
            scatter += error * error.transpose() / f64::from(runs);
            let mut covariance = found.covariance_by_pixels;
            let spread = |gain: &Matrix3xX<f64>| {
                (0..9)
                    .map(|k| gain.column(k) * gain.column(k).transpose() * lens_sigmas[k].powi(2))
                    .sum::<Matrix3<f64>>()
            };
            if lenses_are_one {
                let gain = found.d_by_lens.iter().fold(Matrix3xX::zeros(9), |sum, gain| sum + gain);
                covariance += spread(&gain);
            } else {
                found.d_by_lens.iter().for_each(|gain| covariance += spread(gain));
            }
            for gain in &found.d_by_pose[1..] {
                for (k, sigma) in pose_sigmas.iter().enumerate() {
                    covariance += gain.column(k) * gain.column(k).transpose() * sigma.powi(2);
                }
            }
            stated += covariance / f64::from(runs);
        }
        for axis in 0..3 {
            // The scatter of 3000 runs is known to 1.3 %; four sigmas of that.
            let ratio = (stated[(axis, axis)] / scatter[(axis, axis)]).sqrt();
            assert!((ratio - 1.0).abs() < 0.055, "{n} sights, axis {axis}: {ratio}");
        }
    }

    #[test]
    fn stated_sigmas_are_the_scatter() {
        check_scatter(2, false);
        check_scatter(3, false);
        // One camera moved: its lens errs alike in both poses.
        check_scatter(2, true);
    }

    #[test]
    fn rays_that_do_not_meet_say_so() {
        let camera = camera(1200.0);
        let pixel = camera.project(&POINT).unwrap();
        let sight = |cam_from_ref| Sight { camera: &camera, cam_from_ref, pixel, sigma_px: 0.2 };
        let aside = Pose::new(Pose::identity().rotation, Vector3::new(-0.1, 0.0, 0.0));
        let parallel = sighted_point(&[sight(Pose::identity()), sight(aside)]).unwrap_err();
        assert!(
            matches!(parallel, SightedPointError::NoMeeting { parallax_rad } if parallax_rad < 1e-9),
            "{parallel}"
        );
        let apart = Pose::from_rodrigues(Vector3::new(0.0, -0.3, 0.0), Vector3::new(-0.1, 0.0, 0.0));
        assert!(matches!(
            sighted_point(&[sight(Pose::identity()), sight(apart)]),
            Err(SightedPointError::NoMeeting { .. })
        ));
        assert_eq!(
            sighted_point(&[sight(Pose::identity())]),
            Err(SightedPointError::TooFewSights { found: 1, need: 2 })
        );
    }
}
