//! What one camera saw of one target, laid out for computing: points, pixels, weights.

use boresight_data::{Target, View};
use boresight_geometry::nalgebra::SymmetricEigen;
use boresight_geometry::{Matrix2, Matrix3, Pose, Vector3};

use crate::LeftOut;
use crate::linear::exceeds;

/// A standard deviation across below this share of the extent counts as none: points on a line or in a plane.
const THIN: f64 = 1e-3;

/// A view's observations, with the points as the target's drawing has them.
#[derive(Clone, Debug)]
pub(crate) struct Sighting {
    /// The view, as an index into the dataset's views.
    pub view_idx: usize,
    /// The points in the target's frame, in metres.
    pub points: Vec<Vector3<f64>>,
    /// Where they were seen.
    pub pixels: Vec<[f64; 2]>,
    /// One over each observation's sigma, in 1/px.
    pub weights: Vec<f64>,
    /// The pose that brings the points to z = 0, if they lie in a plane.
    pub plane_from_target: Option<Pose>,
    /// The mean of the points, in the target's frame.
    pub centroid: Vector3<f64>,
    /// The root mean square distance of the points from their mean, in metres.
    pub extent: f64,
}

impl Sighting {
    /// Returns the observations of `view`, or the reason why they determine no pose.
    pub fn new(view_idx: usize, view: &View, target: &Target, min_points: usize) -> Result<Self, LeftOut> {
        let usable = |pixel: &[f64; 2], sigma: f64| {
            pixel.iter().all(|value| value.is_finite()) && sigma.is_finite() && sigma > 0.0
        };
        let n = view.observations.len();
        let (mut points, mut pixels, mut weights) =
            (Vec::with_capacity(n), Vec::with_capacity(n), Vec::with_capacity(n));
        for observation in &view.observations {
            let known = observation.point.0 < u32::try_from(target.point_count()).unwrap_or(u32::MAX);
            if known && usable(&observation.pixel, observation.sigma_px) {
                points.push(target.drawn_point(observation.point));
                pixels.push(observation.pixel);
                weights.push(1.0 / observation.sigma_px);
            }
        }
        if points.len() < min_points {
            return Err(LeftOut::TooFewPoints { view_idx, found: points.len(), need: min_points });
        }
        let spread = Spread::of(&points);
        let thinness = (spread.variances[1] / spread.variances[0]).sqrt().min(image_thinness(&pixels));
        // A single point repeated gives NaN.
        if !exceeds(thinness, THIN) {
            return Err(LeftOut::Collinear {
                view_idx,
                thinness: if thinness.is_finite() { thinness } else { 0.0 },
            });
        }
        Ok(Self {
            view_idx,
            plane_from_target: spread.plane_from_points(),
            centroid: spread.centroid,
            extent: spread.variances.iter().sum::<f64>().sqrt(),
            points,
            pixels,
            weights,
        })
    }

    /// Returns the number of observations.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Returns at most `limit` of the observations, evenly spread over the list.
    pub fn thinned(&self, limit: usize) -> Self {
        let n = self.len();
        if n <= limit {
            return self.clone();
        }
        let kept = || (0..limit).map(|i| i * (n - 1) / (limit - 1).max(1));
        Self {
            points: kept().map(|i| self.points[i]).collect(),
            pixels: kept().map(|i| self.pixels[i]).collect(),
            weights: kept().map(|i| self.weights[i]).collect(),
            ..*self
        }
    }
}

/// Mean and principal axes of a set of points.
struct Spread {
    centroid: Vector3<f64>,
    /// Variances along the principal axes, largest first, in square metres.
    variances: [f64; 3],
    axes: Matrix3<f64>,
    is_drawn_flat: bool,
}

impl Spread {
    fn of(points: &[Vector3<f64>]) -> Self {
        let n = points.len() as f64;
        let centroid = points.iter().sum::<Vector3<f64>>() / n;
        let mut covariance = Matrix3::zeros();
        for point in points {
            let offset = point - centroid;
            covariance += offset * offset.transpose() / n;
        }
        let eigen = SymmetricEigen::new(covariance);
        let mut order = [0, 1, 2];
        order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
        Self {
            centroid,
            variances: order.map(|i| eigen.eigenvalues[i].max(0.0)),
            axes: Matrix3::from_columns(&order.map(|i| eigen.eigenvectors.column(i).into_owned())),
            is_drawn_flat: points.iter().all(|point| point.z == 0.0),
        }
    }

    /// Returns the pose of the points' frame in their plane's, if they lie in one.
    fn plane_from_points(&self) -> Option<Pose> {
        if self.is_drawn_flat {
            return Some(Pose::identity());
        }
        let is_flat = self.variances[2].sqrt() < THIN * self.variances[0].sqrt();
        is_flat.then(|| {
            let (x, y) = (self.axes.column(0).into_owned(), self.axes.column(1).into_owned());
            let rotation = Matrix3::from_rows(&[x.transpose(), y.transpose(), x.cross(&y).transpose()]);
            Pose::from_matrix(&rotation, -(rotation * self.centroid))
        })
    }
}

/// Returns the ratio of the standard deviations of `pixels` across and along.
fn image_thinness(pixels: &[[f64; 2]]) -> f64 {
    let n = pixels.len() as f64;
    let mean = [0, 1].map(|axis| pixels.iter().map(|pixel| pixel[axis]).sum::<f64>() / n);
    let mut covariance = Matrix2::zeros();
    for pixel in pixels {
        let [du, dv] = [pixel[0] - mean[0], pixel[1] - mean[1]];
        covariance += Matrix2::new(du * du, du * dv, du * dv, dv * dv);
    }
    let eigenvalues = covariance.symmetric_eigenvalues();
    (eigenvalues.min().max(0.0) / eigenvalues.max()).sqrt()
}

#[cfg(test)]
mod tests {
    use boresight_data::{CameraId, FrameId, Geometry, Observation, PointId, Shape, TargetId};

    use super::*;

    fn view(points: &[u32], pixel: impl Fn(u32) -> [f64; 2]) -> View {
        View {
            camera: CameraId(0),
            frame: FrameId(0),
            target: TargetId(0),
            image: None,
            observations: points
                .iter()
                .map(|&point| Observation { point: PointId(point), pixel: pixel(point), sigma_px: 0.5 })
                .collect(),
        }
    }

    fn board() -> Target {
        let geometry = Geometry::Chessboard { columns: 5, rows: 4, spacing_m: 0.1 };
        Target { name: "board".into(), geometry, shape: Shape::Rigid }
    }

    fn grid_pixel(point: u32) -> [f64; 2] {
        [f64::from(point % 5) * 30.0, f64::from(point / 5) * 30.0]
    }

    #[test]
    fn degenerate_views_are_told_apart() {
        let few = Sighting::new(3, &view(&[0, 1, 2], grid_pixel), &board(), 6);
        assert_eq!(few.unwrap_err(), LeftOut::TooFewPoints { view_idx: 3, found: 3, need: 6 });
        let row = Sighting::new(1, &view(&[0, 1, 2, 3, 4], grid_pixel), &board(), 4);
        assert!(matches!(row, Err(LeftOut::Collinear { view_idx: 1, .. })));
        let edge_on = Sighting::new(1, &view(&[0, 1, 5, 6], |p| [grid_pixel(p)[0], 7.0]), &board(), 4);
        assert!(matches!(edge_on, Err(LeftOut::Collinear { .. })));
        let not_a_number = view(&[0, 1, 5, 6], |p| if p == 5 { [f64::NAN, 0.0] } else { grid_pixel(p) });
        assert!(matches!(
            Sighting::new(0, &not_a_number, &board(), 4),
            Err(LeftOut::TooFewPoints { found: 3, .. })
        ));
    }

    #[test]
    fn tilted_planes_are_recognised() {
        let points: Vec<[f64; 3]> =
            (0..12).map(|i| [f64::from(i % 4), f64::from(i / 4), 0.5 * f64::from(i % 4)]).collect();
        let target = Target {
            name: "wedge".into(),
            geometry: Geometry::Points { points_m: points },
            shape: Shape::Rigid,
        };
        let all: Vec<u32> = (0..12).collect();
        let pixel = |p: u32| [f64::from(p % 4) * 9.0, f64::from(p / 4) * 9.0];
        let sighting = Sighting::new(0, &view(&all, pixel), &target, 4).unwrap();
        let plane_from_target = sighting.plane_from_target.unwrap();
        for point in &sighting.points {
            assert!((plane_from_target * *point).z.abs() < 1e-12);
        }
        assert_eq!(sighting.thinned(5).len(), 5);
    }
}
