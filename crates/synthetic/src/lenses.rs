//! The lenses of the ready-made recipes, all 1600x1200.

use boresight_camera::{Camera, Model};

const IMAGE_SIZE: [u32; 2] = [1600, 1200];

/// Returns a common lens with mild barrel distortion.
pub(crate) fn common() -> Camera {
    let params = vec![1100.0, 1102.0, 812.0, 591.0, -0.12, 0.05, 4e-4, -6e-4, -0.01];
    Camera { model: Model::OpenCv5(Default::default()), params, image_size: IMAGE_SIZE }
}

/// Returns another of the same make.
pub(crate) fn other() -> Camera {
    let params = vec![1118.0, 1116.0, 786.0, 607.0, -0.115, 0.046, -5e-4, 3e-4, -0.008];
    Camera { model: Model::OpenCv5(Default::default()), params, image_size: IMAGE_SIZE }
}

/// Returns a fisheye that sees 90 degrees off axis at 800 pixels from its centre.
pub(crate) fn fisheye() -> Camera {
    let params = vec![500.0, 500.5, 795.0, 604.0, 0.02, -0.008, 0.001, -2e-4];
    Camera { model: Model::KannalaBrandt4(Default::default()), params, image_size: IMAGE_SIZE }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_lenses_are_valid() {
        for camera in [common(), other(), fisheye()] {
            let checked = Camera::new(camera.model, camera.params.clone(), camera.image_size);
            assert_eq!(checked, Ok(camera));
        }
    }
}
