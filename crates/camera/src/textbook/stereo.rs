//! Stereo vision: the parallel equations 8.17 to 8.22 as they stand, and general pairs brought to them.

use boresight_geometry::{Matrix3, Pose, Vector3};

use crate::Camera;

/// Two parallel cameras with one focal length, side by side along their x axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ParallelStereo {
    /// The focal length `fc`, in the unit of the image frame (metres, or 1 for directions with z = 1).
    pub focal_length: f64,
    /// The distance `dc` of the right camera from the left one, in metres.
    pub baseline_m: f64,
}

impl ParallelStereo {
    /// Returns the distance `zQ` of a point from the disparity `xi,l - xi,r`: Eq. 8.20.
    ///
    /// `None` where the disparity is not positive: no point in front of both cameras has it.
    pub fn depth_m(&self, left_x: f64, right_x: f64) -> Option<f64> {
        let disparity = left_x - right_x;
        (disparity > 0.0).then(|| self.focal_length * self.baseline_m / disparity)
    }

    /// Returns the point `(xQ, yQ, zQ)` in the frame of the left camera, in metres, that is seen at
    /// `[xi,l, yi,l]` by the left and at `xi,r` by the right camera: Eqs 8.18, 8.20 and 8.22, which solve
    /// Eqs 8.17, 8.19 and 8.21. `None` where the disparity is not positive.
    pub fn point(&self, left: [f64; 2], right_x: f64) -> Option<Vector3<f64>> {
        let z = self.depth_m(left[0], right_x)?;
        Some(Vector3::new(left[0] / self.focal_length * z, left[1] / self.focal_length * z, z))
    }

    /// Returns the sigma of the distance for a sigma of the disparity: the derivative of Eq. 8.20,
    /// `zQ² / (fc dc)` times the latter.
    pub fn depth_sigma_m(&self, depth_m: f64, disparity_sigma: f64) -> f64 {
        depth_m * depth_m / (self.focal_length * self.baseline_m) * disparity_sigma
    }
}

/// A pair of cameras turned, in thought, until they are parallel: for directions with z = 1 the
/// parallel equations hold with a focal length of one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rectified {
    /// The rotation from the frame of the left camera to the common, rectified one.
    pub rect_from_left: Matrix3<f64>,
    /// The rotation from the frame of the right camera to the rectified one.
    pub rect_from_right: Matrix3<f64>,
    /// The parallel pair.
    pub stereo: ParallelStereo,
}

/// What a pair of pixels came to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StereoPoint {
    /// The point in the frame of the left camera, in metres.
    pub point_in_left: Vector3<f64>,
    /// `yi,l - yi,r` of the rectified directions, with z = 1. It is zero for an exact pair of an exact calibration.
    pub row_disparity: f64,
}

impl Rectified {
    /// Returns the rectification of two cameras, or `None` if their centres coincide.
    ///
    /// Each camera is turned as little as possible: the common x axis is the baseline, the common z
    /// axis the mean of the optical axes, made perpendicular to it.
    pub fn new(right_from_left: &Pose) -> Option<Self> {
        let left_from_right = right_from_left.inverse();
        let baseline = left_from_right.translation;
        let x = baseline.try_normalize(0.0)?;
        let mean = Vector3::z() + left_from_right.rotation * Vector3::z();
        // Cameras that look along the baseline have any perpendicular as their common z.
        let across = |axis: Vector3<f64>| (axis - x * x.dot(&axis)).try_normalize(1e-9);
        let z = across(mean).or_else(|| across(Vector3::z())).or_else(|| across(Vector3::y()))?;
        let y = z.cross(&x);
        let rect_from_left = Matrix3::from_rows(&[x.transpose(), y.transpose(), z.transpose()]);
        Some(Self {
            rect_from_left,
            rect_from_right: rect_from_left * left_from_right.rotation_matrix(),
            stereo: ParallelStereo { focal_length: 1.0, baseline_m: baseline.norm() },
        })
    }

    /// Returns the point that two pixels see, by the parallel equations on rectified directions; lens
    /// distortion is taken out first. `None` where a pixel has no direction, one in front of the
    /// rectified pair, or the disparity is not positive.
    pub fn point(&self, cameras: [&Camera; 2], pixels: [[f64; 2]; 2]) -> Option<StereoPoint> {
        let left = in_front(self.rect_from_left * cameras[0].unproject(pixels[0])?)?;
        let right = in_front(self.rect_from_right * cameras[1].unproject(pixels[1])?)?;
        let point_in_rect = self.stereo.point(left, right[0])?;
        Some(StereoPoint {
            point_in_left: self.rect_from_left.transpose() * point_in_rect,
            row_disparity: left[1] - right[1],
        })
    }
}

/// Returns where a direction meets the plane z = 1.
fn in_front(direction: Vector3<f64>) -> Option<[f64; 2]> {
    (direction.z > 0.0).then(|| [direction.x / direction.z, direction.y / direction.z])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_parallel_equations_give_back_a_point() {
        // fc = 8 mm, dc = 100 mm, Q = (0.3, -0.2, 2) m: Eqs 8.17 and 8.21 by hand.
        let stereo = ParallelStereo { focal_length: 0.008, baseline_m: 0.1 };
        let left = [0.008 * 0.3 / 2.0, 0.008 * -0.2 / 2.0];
        let right_x = 0.008 * (0.3 - 0.1) / 2.0;
        let point = stereo.point(left, right_x).unwrap();
        assert!((point - Vector3::new(0.3, -0.2, 2.0)).norm() < 1e-14);
        assert_eq!(stereo.point(left, left[0]), None);
        // 4 µm of disparity at 2 m: 4 / (0.0008) * 4e-6 = 20 mm, and the difference quotient agrees.
        let sigma = stereo.depth_sigma_m(2.0, 4e-6);
        assert!((sigma - 0.02).abs() < 1e-15);
        let moved = stereo.depth_m(left[0] - 4e-9, right_x).unwrap() - 2.0;
        assert!((moved / 1e-3 / sigma - 1.0).abs() < 1e-4, "{moved}");
    }

    #[test]
    fn a_general_pair_is_rectified() {
        let left = Camera::new(
            "opencv5".parse().unwrap(),
            vec![1200.0, 1190.0, 800.5, 610.0, -0.2, 0.05, 1e-3, -5e-4, 0.0],
            [1600, 1200],
        )
        .unwrap();
        let mut right = left.clone();
        right.params[0] = 1100.0;
        let poses = [
            ([0.03, -0.15, 0.02], [-0.2, 0.01, 0.03]),
            // The right camera may be on the left, above, or ahead.
            ([0.0, 0.1, 0.0], [0.2, 0.0, 0.0]),
            ([0.1, 0.0, 1.5], [0.02, 0.3, 0.0]),
        ];
        for (turn, place) in poses {
            let right_from_left = Pose::from_rodrigues(Vector3::from(turn), Vector3::from(place));
            let rectified = Rectified::new(&right_from_left).unwrap();
            let point = Vector3::new(0.2, 0.1, 1.7);
            let pixels = [left.project(&point).unwrap(), right.project(&(right_from_left * point)).unwrap()];
            let found = rectified.point([&left, &right], pixels).unwrap();
            // Unprojection is good to 1e-12 or so, ten times the baseline away.
            assert!((found.point_in_left - point).norm() < 1e-9, "{found:?}");
            assert!(found.row_disparity.abs() < 1e-10, "{found:?}");
            assert!(
                (rectified.rect_from_right * rectified.rect_from_right.transpose() - Matrix3::identity())
                    .norm()
                    < 1e-14
            );
        }
        assert_eq!(Rectified::new(&Pose::identity()), None);
    }
}
