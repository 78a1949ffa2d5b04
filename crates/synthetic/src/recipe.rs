//! What to simulate, and ready-made recipes.

use std::f64::consts::TAU;

use boresight_camera::Camera;
use boresight_data::{Geometry, Shape, Target};
use boresight_geometry::{Pose, Vector3};

use crate::lenses;

/// What to simulate: every field may be changed.
#[derive(Clone, Debug, PartialEq)]
pub struct Recipe {
    /// The rig; its frame should be that of the first camera, as calibrations have it.
    pub cameras: Vec<PlacedCamera>,
    /// The target that is waved about.
    pub target: Target,
    /// The shape coefficients of the real target, in metres.
    pub shape_m: Vec<f64>,
    /// The number of instants.
    pub frames: usize,
    /// How the target is waved about.
    pub placement: Placement,
    /// The standard deviation of the normal noise on either pixel coordinate. Zero is off; the
    /// observations then state a sigma of one pixel.
    pub sigma_px: f64,
    /// Gross errors.
    pub outliers: Outliers,
    /// The share of corners that are not detected although they are in the image. Zero is off.
    pub hidden_share: f64,
    /// A view with fewer points than this is not in the dataset.
    pub min_points: usize,
}

/// A camera and where it sits.
#[derive(Clone, Debug, PartialEq)]
pub struct PlacedCamera {
    /// The name, unique in a recipe.
    pub name: String,
    /// The lens.
    pub camera: Camera,
    /// Where it sits.
    pub cam_from_rig: Pose,
}

/// How the target is waved about: in each frame, one camera in turn has it in view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// The smallest and the largest distance of the target's centre from that camera, in metres.
    pub distance_m: [f64; 2],
    /// The largest angle between the target's normal and the line of sight, in radians.
    pub tilt_rad: f64,
    /// The largest turn about the normal, in radians.
    pub roll_rad: f64,
    /// The share of the image, about its middle, in which the target's centre lies. Beyond 0.5 or
    /// so, boards are cut by the border.
    pub image_share: f64,
}

/// Gross errors among the observations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outliers {
    /// The share of observations that get one. Zero is off.
    pub share: f64,
    /// The standard deviation of the error on either pixel coordinate.
    pub sigma_px: f64,
}

impl PlacedCamera {
    /// Returns the camera with an image of another size that shows the same.
    pub fn scaled_to(&self, image_size: [u32; 2]) -> Self {
        let mut scaled = self.clone();
        scaled.camera.image_size = image_size;
        let params = &mut scaled.camera.params;
        for (axis, (new, old)) in image_size.into_iter().zip(self.camera.image_size).enumerate() {
            let scale = f64::from(new) / f64::from(old);
            params[axis] *= scale;
            // Pixel (0, 0) is a centre; the image begins half a pixel before it.
            params[2 + axis] = (params[2 + axis] + 0.5) * scale - 0.5;
        }
        scaled
    }
}

impl Recipe {
    /// Returns one camera with a common lens (`opencv5`, 1600x1200, 72 by 54 degrees), 20 frames.
    pub fn mono() -> Self {
        Self::with_cameras(vec![lenses::common()], |_| Pose::identity())
    }

    /// Returns one fisheye (`kannala-brandt4`, 1600x1200) that sees 180 degrees across its width, 20 frames.
    pub fn fisheye() -> Self {
        let mut recipe = Self::with_cameras(vec![lenses::fisheye()], |_| Pose::identity());
        recipe.placement.distance_m = [0.35, 0.7];
        recipe.placement.image_share = 0.85;
        recipe
    }

    /// Returns two cameras 0.2 m apart with slightly different lenses, 20 frames.
    pub fn stereo() -> Self {
        let turn = Vector3::new(0.004, 0.02, -0.007);
        Self::with_cameras(vec![lenses::common(), lenses::other()], |i| match i {
            0 => Pose::identity(),
            _ => Pose::from_rodrigues(turn, Vector3::new(-0.2, 0.003, -0.002)),
        })
    }

    /// Returns `n_cameras` on a circle of 1.5 m radius that look at its middle, at most 45 degrees
    /// apart, with ten frames for each.
    pub fn ring(n_cameras: usize) -> Self {
        let radius_m = 1.5;
        let spacing_rad = (TAU / n_cameras.max(1) as f64).min(TAU / 8.0);
        let cameras = (0..n_cameras).map(|i| if i % 2 == 0 { lenses::common() } else { lenses::other() });
        let mut recipe = Self::with_cameras(cameras.collect(), |i| {
            let middle_in_cam = Vector3::new(0.0, 0.0, radius_m);
            let about_y = Vector3::new(0.0, spacing_rad * i as f64, 0.0);
            let cam_from_middle = Pose::from_rodrigues(about_y, middle_in_cam);
            let reference_from_middle = Pose::new(Pose::identity().rotation, middle_in_cam);
            cam_from_middle * reference_from_middle.inverse()
        });
        recipe.frames = 10 * n_cameras;
        recipe.placement.distance_m = [1.2, 1.8];
        recipe
    }

    /// Returns a recipe with these lenses, placed by index, and everything else as usual.
    fn with_cameras(lenses: Vec<Camera>, cam_from_rig: impl Fn(usize) -> Pose) -> Self {
        let placed = lenses.into_iter().enumerate().map(|(i, camera)| PlacedCamera {
            name: format!("cam{i}"),
            camera,
            cam_from_rig: cam_from_rig(i),
        });
        Self {
            cameras: placed.collect(),
            target: Target {
                name: "board".to_owned(),
                geometry: Geometry::Chessboard { columns: 10, rows: 8, spacing_m: 0.05 },
                shape: Shape::Parabolic2,
            },
            shape_m: vec![0.0005, -0.0008],
            frames: 20,
            placement: Placement { distance_m: [0.6, 1.4], tilt_rad: 0.7, roll_rad: 0.5, image_share: 0.7 },
            sigma_px: 0.2,
            outliers: Outliers { share: 0.0, sigma_px: 20.0 },
            hidden_share: 0.0,
            min_points: 12,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scaled_image_shows_the_same() {
        let recipe = Recipe::mono();
        let (whole, half) = (&recipe.cameras[0], recipe.cameras[0].scaled_to([800, 300]));
        assert_eq!((half.camera.image_size, &half.name), ([800, 300], &whole.name));
        let point = Vector3::new(0.3, -0.2, 1.0);
        let [whole, half] = [&whole.camera, &half.camera].map(|camera| camera.project(&point).unwrap());
        // Of the 1600x1200 pixels, 2 by 4 become one.
        let expected = [(whole[0] + 0.5) / 2.0 - 0.5, (whole[1] + 0.5) / 4.0 - 0.5];
        assert!((0..2).all(|axis| (half[axis] - expected[axis]).abs() < 1e-9), "{half:?} {expected:?}");
    }
}
