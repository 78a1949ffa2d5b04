//! Images of a target through any lens, with the blur, vignetting and noise of a camera.

use boresight_camera::Camera;
use boresight_data::{GrayImage, GrayPixels, Shape, Target};
use boresight_geometry::{Pose, Vector3};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use crate::drawing::{Drawing, Print};

/// How a scene becomes grey values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exposure {
    /// The grey value of black ink, paper, and whatever is behind the target, of 255.
    pub black: f64,
    /// The grey value of paper.
    pub white: f64,
    /// The grey value beyond the target.
    pub background: f64,
    /// The width of the white margin around what is printed, in squares, tags or distances of dots.
    pub margin_squares: f64,
    /// The standard deviation of the lens's Gaussian blur in pixels, beyond that of the pixels' own area. Zero is off.
    pub blur_px: f64,
    /// By which share the corners of the image are darker than its middle. Zero is off.
    pub vignetting: f64,
    /// The standard deviation of the noise in grey values of 255. Zero is off.
    pub noise: f64,
    /// Whether grey values are stored in eight or in sixteen bits.
    pub depth: Depth,
    /// What the target's geometry leaves open about its print.
    pub print: Print,
}

/// How many bits a grey value has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Depth {
    /// 0 to 255.
    Eight,
    /// 0 to 65535; the grey values of an [`Exposure`] count as 257 of these.
    Sixteen,
}

impl Default for Exposure {
    fn default() -> Self {
        Self {
            black: 40.0,
            white: 210.0,
            background: 110.0,
            margin_squares: 1.0,
            blur_px: 0.6,
            vignetting: 0.2,
            noise: 2.0,
            depth: Depth::Eight,
            print: Print::default(),
        }
    }
}

/// Renders what `camera` sees of `target`; `None` for a target that has no drawing, only points.
///
/// A pixel is the mean over its square; (0, 0) is the centre of the top left one. The same seed gives the same noise.
pub fn render(
    camera: &Camera,
    cam_from_target: &Pose,
    target: &Target,
    shape_m: &[f64],
    exposure: &Exposure,
    seed: u64,
) -> Option<GrayImage> {
    let board = Board::new(target, shape_m, exposure)?;
    let [width, height] = camera.image_size.map(|side| side as usize);
    let target_from_cam = cam_from_target.inverse();
    // A row more on every side, for the derivatives of the map from pixels to the board.
    let (columns, rows) = (width + 2, height + 2);
    let seen: Vec<Option<[f64; 2]>> = (0..columns * rows)
        .map(|i| {
            let pixel = [(i % columns) as f64 - 1.0, (i / columns) as f64 - 1.0];
            board.seen_along(&target_from_cam, &camera.unproject(pixel)?)
        })
        .collect();
    let mut grey = vec![exposure.background; width * height];
    for (i, value) in grey.iter_mut().enumerate() {
        let at = (i / width + 1) * columns + i % width + 1;
        let around = [at, at - 1, at + 1, at - columns, at + columns].map(|j| seen[j]);
        let [Some(here), Some(left), Some(right), Some(up), Some(down)] = around else { continue };
        let du = [0, 1].map(|axis| 0.5 * (right[axis] - left[axis]));
        let dv = [0, 1].map(|axis| 0.5 * (down[axis] - up[axis]));
        *value = board.mean_over_pixel(here, du, dv);
    }
    blur(&mut grey, width, height, exposure.blur_px);
    let middle = [0.5 * (width as f64 - 1.0), 0.5 * (height as f64 - 1.0)];
    let corner = middle[0].hypot(middle[1]).max(1.0);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    for (i, value) in grey.iter_mut().enumerate() {
        let radius = ((i % width) as f64 - middle[0]).hypot((i / width) as f64 - middle[1]) / corner;
        *value *= 1.0 - exposure.vignetting * radius * radius;
        let noise: f64 = rng.sample(StandardNormal);
        *value += exposure.noise * noise;
    }
    let pixels = match exposure.depth {
        Depth::Eight => GrayPixels::Eight(grey.iter().map(|value| value.round() as u8).collect()),
        Depth::Sixteen => {
            GrayPixels::Sixteen(grey.iter().map(|value| (value * 257.0).round() as u16).collect())
        }
    };
    GrayImage::new(camera.image_size, pixels)
}

/// A target in units of its drawing.
struct Board<'a> {
    drawing: Drawing,
    shape_m: Vec<f64>,
    exposure: &'a Exposure,
}

impl<'a> Board<'a> {
    fn new(target: &Target, shape_m: &[f64], exposure: &'a Exposure) -> Option<Self> {
        let drawing = Drawing::new(target, &exposure.print)?;
        let shape_m = shape_m.iter().copied().take(target.shape.coefficient_count()).collect();
        Some(Self { drawing, shape_m, exposure })
    }

    /// Returns where a ray meets the front of the board, in units of the drawing.
    fn seen_along(&self, target_from_cam: &Pose, ray: &Vector3<f64>) -> Option<[f64; 2]> {
        let direction = target_from_cam.rotation * ray;
        let origin = target_from_cam.translation;
        // Whoever sees the front looks against its normal.
        if -self.drawing.front * direction.z <= 1e-9 {
            return None;
        }
        let mut met = [0.0; 2];
        let mut z_m = 0.0;
        // The bend is a millimetre over decimetres, so each pass gains three digits.
        let is_flat = self.shape_m.iter().all(|coefficient| *coefficient == 0.0);
        for _ in 0..if is_flat { 1 } else { 5 } {
            let length = (z_m - origin.z) / direction.z;
            if length <= 0.0 {
                return None;
            }
            let point = origin + direction * length;
            met = [point.x / self.drawing.unit_m, point.y / self.drawing.unit_m];
            let bends = Shape::bends([0, 1].map(|axis| met[axis] / self.drawing.extent[axis]));
            z_m = self.shape_m.iter().zip(bends).map(|(coefficient, bend)| coefficient * bend).sum();
        }
        Some(met)
    }

    /// Returns the mean over a pixel at `here` whose sides are `du` and `dv` on the board.
    fn mean_over_pixel(&self, here: [f64; 2], du: [f64; 2], dv: [f64; 2]) -> f64 {
        const SAMPLES: usize = 12;
        let reach = [0, 1].map(|axis| 0.5 * (du[axis].abs() + dv[axis].abs()) + 1e-9);
        // The pixel may touch the rim of the print or of the margin.
        let near_rim = |width: f64| {
            let most = reach[0].max(reach[1]);
            self.drawing.is_beyond(here, width - most) != self.drawing.is_beyond(here, width + most)
        };
        let is_plain =
            self.drawing.is_plain(here, reach) && !near_rim(0.0) && !near_rim(self.exposure.margin_squares);
        if is_plain {
            return self.value_at(here);
        }
        let step = |i: usize| (i as f64 + 0.5) / SAMPLES as f64 - 0.5;
        let mut sum = 0.0;
        for down in (0..SAMPLES).map(step) {
            for across in (0..SAMPLES).map(step) {
                sum += self.value_at([0, 1].map(|axis| here[axis] + across * du[axis] + down * dv[axis]));
            }
        }
        sum / (SAMPLES * SAMPLES) as f64
    }

    /// Returns the grey value at a place on the board.
    fn value_at(&self, at: [f64; 2]) -> f64 {
        if self.drawing.is_beyond(at, self.exposure.margin_squares) {
            self.exposure.background
        } else if self.drawing.is_ink(at) {
            self.exposure.black
        } else {
            self.exposure.white
        }
    }
}

/// Blurs with a Gaussian; beyond the border the image goes on as it ends there.
fn blur(grey: &mut [f64], width: usize, height: usize, sigma_px: f64) {
    if sigma_px <= 0.0 {
        return;
    }
    let reach = (4.0 * sigma_px).ceil() as isize;
    let weights: Vec<f64> = (-reach..=reach).map(|i| (-0.5 * (i as f64 / sigma_px).powi(2)).exp()).collect();
    let sum: f64 = weights.iter().sum();
    let mut along = |count: usize, n_lines: usize, stride: usize, line_stride: usize| {
        let mut line = vec![0.0; count];
        for first in (0..n_lines).map(|line| line * line_stride) {
            for (i, value) in line.iter_mut().enumerate() {
                let tap = |(k, weight): (usize, &f64)| {
                    let at = (i as isize + k as isize - reach).clamp(0, count as isize - 1) as usize;
                    weight * grey[first + at * stride]
                };
                *value = weights.iter().enumerate().map(tap).sum::<f64>() / sum;
            }
            for (i, value) in line.iter().enumerate() {
                grey[first + i * stride] = *value;
            }
        }
    };
    along(width, height, 1, width);
    along(height, width, width, 1);
}

#[cfg(test)]
mod tests {
    use boresight_camera::Model;
    use boresight_data::Geometry;

    use super::*;

    fn camera() -> Camera {
        let params = vec![100.0, 100.0, 50.0, 40.0];
        Camera { model: Model::Pinhole(Default::default()), params, image_size: [101, 81] }
    }

    fn board() -> Target {
        let geometry = Geometry::Chessboard { columns: 4, rows: 3, spacing_m: 0.1 };
        Target { name: "board".to_owned(), geometry, shape: Shape::Rigid }
    }

    fn plain() -> Exposure {
        Exposure { blur_px: 0.0, vignetting: 0.0, noise: 0.0, ..Exposure::default() }
    }

    fn eight(image: &GrayImage) -> Vec<u8> {
        match image.pixels() {
            GrayPixels::Eight(values) => values.clone(),
            GrayPixels::Sixteen(_) => panic!("eight bits were asked for"),
        }
    }

    #[test]
    fn squares_are_where_the_camera_projects_them() {
        // A square is 10 pixels wide, and the first corner is at the centre of pixel (20, 30).
        let cam_from_target = Pose::new(Pose::identity().rotation, Vector3::new(-0.3, -0.1, 1.0));
        let image = render(&camera(), &cam_from_target, &board(), &[], &plain(), 0).unwrap();
        let at = |u: usize, v: usize| eight(&image)[v * 101 + u];
        assert_eq!((at(25, 35), at(15, 25), at(35, 35), at(25, 25)), (40, 40, 210, 210));
        // An edge through the middle of a pixel makes it half black; a corner too.
        assert_eq!((at(20, 35), at(20, 30), at(25, 30)), (125, 125, 125));
        // The outer squares, the margin, and what is beyond.
        assert_eq!((at(55, 45), at(65, 35), at(75, 35), at(5, 35)), (40, 210, 110, 210));
        let points = Target { geometry: Geometry::Points { points_m: vec![] }, ..board() };
        assert_eq!(render(&camera(), &cam_from_target, &points, &[], &plain(), 0), None);
    }

    #[test]
    fn noise_vignetting_and_depth_are_as_ordered() {
        let behind = Pose::new(Pose::identity().rotation, Vector3::new(0.0, 0.0, -1.0));
        let exposure = Exposure { noise: 3.0, depth: Depth::Sixteen, ..plain() };
        let image = render(&camera(), &behind, &board(), &[], &exposure, 7).unwrap();
        let GrayPixels::Sixteen(values) = image.pixels() else { panic!("sixteen bits were asked for") };
        let n = values.len() as f64;
        let mean = values.iter().map(|&value| f64::from(value) / 257.0).sum::<f64>() / n;
        let square = values.iter().map(|&value| (f64::from(value) / 257.0 - mean).powi(2)).sum::<f64>() / n;
        // Of 8181 draws: the mean is within 0.03 and the deviation within one percent.
        assert!((mean - 110.0).abs() < 0.1 && (square.sqrt() - 3.0).abs() < 0.1, "{mean} {square}");
        let dark = Exposure { vignetting: 0.5, ..plain() };
        let image = render(&camera(), &behind, &board(), &[], &dark, 7).unwrap();
        assert_eq!((eight(&image)[0], eight(&image)[40 * 101 + 50]), (55, 110));
    }
}
