//! From the metric image plane to pixels: Eqs 8.1 to 8.8 and 8.11.

use boresight_geometry::nalgebra::Matrix3x4;
use boresight_geometry::{Matrix3, Point3};

/// The optics of a pinhole camera in metric units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensor {
    /// The distance of the image plane from the centre of projection, `fc`, in metres.
    pub focal_length_m: f64,
    /// Width and height of one pixel, `[Dx, Dy]`, in metres.
    pub pixel_pitch_m: [f64; 2],
}

impl Sensor {
    /// Returns the sensor whose focal lengths `[fx, fy]` in pixels belong to this `fc`: Eq. 8.11,
    /// solved for `Dx` and `Dy`.
    pub fn from_focal_length(focal_px: [f64; 2], focal_length_m: f64) -> Self {
        Self { focal_length_m, pixel_pitch_m: focal_px.map(|f| focal_length_m / f) }
    }

    /// Returns the focal lengths `[fx, fy]` in pixels: Eq. 8.11.
    pub fn focal_px(&self) -> [f64; 2] {
        self.pixel_pitch_m.map(|pitch| self.focal_length_m / pitch)
    }

    /// Returns what `fc` would be in metres by `fx` and by `fy`: Eq. 8.11, solved for `fc`.
    ///
    /// The two agree as well as pixel size and calibration do.
    pub fn focal_lengths_m(focal_px: [f64; 2], pixel_pitch_m: [f64; 2]) -> [f64; 2] {
        [focal_px[0] * pixel_pitch_m[0], focal_px[1] * pixel_pitch_m[1]]
    }

    /// Returns the perspective matrix from the camera frame to the image frame: Eq. 8.5.
    pub fn perspective_matrix(&self) -> Matrix3x4<f64> {
        let fc = self.focal_length_m;
        Matrix3x4::new(fc, 0.0, 0.0, 0.0, 0.0, fc, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0)
    }

    /// Returns the point `[xi, yi]` of the image frame, in metres, at which a point given in the
    /// camera frame is seen, or `None` behind the camera: Eqs 8.1 to 8.4.
    pub fn project(&self, point_in_cam: &Point3<f64>) -> Option<[f64; 2]> {
        let scale = self.focal_length_m / point_in_cam.z;
        (point_in_cam.z > 0.0).then(|| [scale * point_in_cam.x, scale * point_in_cam.y])
    }
}

/// What the upper left pixel of an image is called; the textbook allows both.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum IndexOrigin {
    /// The upper left pixel is (0, 0): everywhere else in Boresight, OpenCV, mrcal.
    #[default]
    Zero,
    /// The upper left pixel is (1, 1): MATLAB.
    One,
}

impl IndexOrigin {
    /// Returns the index of the upper left pixel.
    pub fn first_index(self) -> f64 {
        match self {
            Self::Zero => 0.0,
            Self::One => 1.0,
        }
    }

    /// Returns the index coordinates, in this convention, of a zero-based pixel.
    pub fn from_zero_based(self, pixel: [f64; 2]) -> [f64; 2] {
        pixel.map(|x| x + self.first_index())
    }

    /// Returns the zero-based pixel of index coordinates in this convention.
    pub fn to_zero_based(self, index: [f64; 2]) -> [f64; 2] {
        index.map(|x| x - self.first_index())
    }

    /// Returns the matrix by which a zero-based `P` or `H` is multiplied from the left for this convention.
    pub fn matrix_from_zero_based(self) -> Matrix3<f64> {
        let shift = self.first_index();
        Matrix3::new(1.0, 0.0, shift, 0.0, 1.0, shift, 0.0, 0.0, 1.0)
    }
}

/// The relation of the metric image frame and the index frame of pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IndexFrame {
    /// Width and height of one pixel, `[Dx, Dy]`, in metres.
    pub pixel_pitch_m: [f64; 2],
    /// The origin of the image frame, `[u0, v0]`, as a zero-based pixel.
    pub centre_px: [f64; 2],
    /// The convention of the index coordinates.
    pub index_origin: IndexOrigin,
}

impl IndexFrame {
    /// Returns the point `[xi, yi]` of the image frame, in metres, at index coordinates `[u, v]`: Eq. 8.6.
    pub fn image_from_index(&self, index: [f64; 2]) -> [f64; 2] {
        let pixel = self.index_origin.to_zero_based(index);
        [0, 1].map(|i| (pixel[i] - self.centre_px[i]) * self.pixel_pitch_m[i])
    }

    /// Returns the index coordinates `[u, v]` of the point `[xi, yi]` of the image frame, in metres: Eq. 8.7.
    pub fn index_from_image(&self, image: [f64; 2]) -> [f64; 2] {
        let pixel = [0, 1].map(|i| self.centre_px[i] + image[i] / self.pixel_pitch_m[i]);
        self.index_origin.from_zero_based(pixel)
    }

    /// Returns the matrix from the image frame, in metres, to the index frame: Eq. 8.8.
    pub fn matrix(&self) -> Matrix3<f64> {
        let [dx, dy] = self.pixel_pitch_m;
        let [u0, v0] = self.index_origin.from_zero_based(self.centre_px);
        Matrix3::new(1.0 / dx, 0.0, u0, 0.0, 1.0 / dy, v0, 0.0, 0.0, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use boresight_geometry::Vector3;

    use super::*;
    use crate::textbook::p_matrix;

    const SENSOR: Sensor = Sensor { focal_length_m: 0.008, pixel_pitch_m: [4e-6, 5e-6] };

    fn close(a: [f64; 2], b: [f64; 2], limit: f64) {
        assert!((a[0] - b[0]).abs() <= limit && (a[1] - b[1]).abs() <= limit, "{a:?} {b:?}");
    }

    #[test]
    fn focal_lengths_convert_both_ways() {
        close(SENSOR.focal_px(), [2000.0, 1600.0], 1e-12);
        let back = Sensor::from_focal_length(SENSOR.focal_px(), SENSOR.focal_length_m);
        close(back.pixel_pitch_m, SENSOR.pixel_pitch_m, 1e-20);
        close(Sensor::focal_lengths_m(SENSOR.focal_px(), SENSOR.pixel_pitch_m), [0.008; 2], 1e-17);
    }

    #[test]
    fn index_frames_count_from_zero_or_one() {
        for (index_origin, expected) in
            [(IndexOrigin::Zero, [640.0, 479.5]), (IndexOrigin::One, [641.0, 480.5])]
        {
            let frame =
                IndexFrame { pixel_pitch_m: SENSOR.pixel_pitch_m, centre_px: [640.0, 479.5], index_origin };
            close(frame.index_from_image([0.0, 0.0]), expected, 0.0);
            close(frame.index_from_image([4e-6, -5e-5]), [expected[0] + 1.0, expected[1] - 10.0], 1e-11);
            close(frame.image_from_index(frame.index_from_image([3e-4, -2e-4])), [3e-4, -2e-4], 1e-17);
            let by_matrix = frame.matrix() * Vector3::new(3e-4, -2e-4, 1.0);
            close(frame.index_from_image([3e-4, -2e-4]), [by_matrix.x, by_matrix.y], 1e-11);
        }
    }

    #[test]
    fn projection_composes_to_p() {
        // Eq. 8.9: index frame times perspective matrix is P, in both conventions.
        for index_origin in [IndexOrigin::Zero, IndexOrigin::One] {
            let frame =
                IndexFrame { pixel_pitch_m: SENSOR.pixel_pitch_m, centre_px: [640.0, 479.5], index_origin };
            let p = index_origin.matrix_from_zero_based() * p_matrix([2000.0, 1600.0, 640.0, 479.5]);
            assert!((frame.matrix() * SENSOR.perspective_matrix() - p).norm() < 1e-11);
        }
        let image = SENSOR.project(&Point3::new(0.5, -0.25, 2.0)).unwrap();
        close(image, [0.002, -0.001], 1e-18);
        assert_eq!(SENSOR.project(&Point3::new(0.5, -0.25, 0.0)), None);
    }
}
