//! A lens with local support from another lens: its parameters are linear in the pixels.

use boresight_camera::{Camera, CameraModel, LocalSupport, Model, ModelVisitor};
use boresight_geometry::Vector3;

/// Samples per knot along each axis of the image.
const SAMPLES_PER_KNOT: usize = 3;
/// The weight of second differences of the knots against that of a sample. Where there are samples it
/// counts for nothing; elsewhere it continues the surface straight on.
const STRAIGHTNESS: f64 = 1e-8;

/// Returns the camera of `model`, which has local support, nearest to `source` over its image, or
/// `None` if `source` sees too little of it.
///
/// What the model's configuration leaves open is chosen so that the image is covered.
pub(crate) fn camera_from_lens(model: Model, source: &Camera) -> Option<Camera> {
    let model = model.completed(&edge_rays(source));
    let support = model.local_support()?;
    let samples = samples(source, support);
    let stereographic = Model::Stereographic(Default::default());
    let core = core_of(stereographic, source, &samples)?;
    let base = Camera::new(model, model.undistorted(core), source.image_size).ok()?;
    let mut normal = Banded::new(support);
    model.visit(Accumulate { params: &base.params, samples: &samples, normal: &mut normal });
    normal.straighten(support);
    let knots = normal.solve()?;
    let mut params = base.params;
    for (pair, knot) in params[4..].as_chunks_mut::<2>().0.iter_mut().zip(knots) {
        *pair = knot;
    }
    Camera::new(model, params, source.image_size).ok()
}

/// A pixel and the direction that it sees.
struct Sample {
    pixel: [f64; 2],
    ray: Vector3<f64>,
}

/// Returns the directions that pixels along the edge of the image see.
fn edge_rays(source: &Camera) -> Vec<[f64; 3]> {
    const STEPS: u32 = 32;
    let [right, bottom] = source.image_size.map(|size| f64::from(size) - 1.0);
    let mut rays = Vec::new();
    for i in 0..=STEPS {
        let share = f64::from(i) / f64::from(STEPS);
        for pixel in
            [[share * right, 0.0], [share * right, bottom], [0.0, share * bottom], [right, share * bottom]]
        {
            rays.extend(source.unproject(pixel).map(<[f64; 3]>::from));
        }
    }
    rays
}

/// Returns samples over the whole image, its edge included, where the source sees something.
fn samples(source: &Camera, support: LocalSupport) -> Vec<Sample> {
    let [columns, rows] = [support.columns, support.rows].map(|knots| SAMPLES_PER_KNOT * knots);
    let [right, bottom] = source.image_size.map(|size| f64::from(size) - 1.0);
    let mut samples = Vec::with_capacity(columns * rows);
    for row in 0..rows {
        for column in 0..columns {
            let share = [column as f64 / (columns - 1) as f64, row as f64 / (rows - 1) as f64];
            let pixel = [share[0] * right, share[1] * bottom];
            samples.extend(source.unproject(pixel).map(|ray| Sample { pixel, ray }));
        }
    }
    samples
}

/// Returns the core with which `model`, which has no other parameters, is nearest to the samples about
/// the source's centre.
fn core_of(model: Model, source: &Camera, samples: &[Sample]) -> Option<[f64; 4]> {
    let [cx, cy] = [source.params[2], source.params[3]];
    let unit = Camera::new(model, vec![1.0, 1.0, 0.0, 0.0], source.image_size).ok()?;
    let (mut along, mut square) = ([0.0; 2], [0.0; 2]);
    for sample in samples {
        let Some(plane) = unit.project(&sample.ray) else { continue };
        for (axis, centre) in [cx, cy].into_iter().enumerate() {
            along[axis] += (sample.pixel[axis] - centre) * plane[axis];
            square[axis] += plane[axis] * plane[axis];
        }
    }
    let focal = [along[0] / square[0], along[1] / square[1]];
    focal.iter().all(|focal| focal.is_finite() && *focal > 0.0).then_some([focal[0], focal[1], cx, cy])
}

/// Adds the samples to the normal equations of the knots.
struct Accumulate<'a> {
    params: &'a [f64],
    samples: &'a [Sample],
    normal: &'a mut Banded,
}

impl ModelVisitor for Accumulate<'_> {
    type Output = ();

    fn visit<M: CameraModel>(self, model: M) {
        let Some(support) = model.local_support() else { return };
        let n_weights = support.side * support.side;
        for sample in self.samples {
            let Some(local) = model.linearize_locally(self.params, sample.ray.into()) else { continue };
            let knot = |k: usize| (support.param(local.first[0], k, 0) - 4) / 2;
            let wanted = [0, 1].map(|axis| (sample.pixel[axis] - local.pixel[axis]) / self.params[axis]);
            for i in 0..n_weights {
                for j in 0..=i {
                    self.normal.add(knot(i), knot(j), local.weights[i] * local.weights[j]);
                }
                let right = &mut self.normal.right[knot(i)];
                for (right, wanted) in right.iter_mut().zip(wanted) {
                    *right += local.weights[i] * wanted;
                }
            }
        }
    }
}

/// Symmetric equations whose matrix is zero far from the diagonal, for x and y at once.
struct Banded {
    /// Row by row the entries left of the diagonal, then the diagonal.
    lower: Vec<f64>,
    width: usize,
    right: Vec<[f64; 2]>,
}

impl Banded {
    fn new(support: LocalSupport) -> Self {
        let n = support.columns * support.rows;
        // From one corner of a square to the other, and at least the three knots of a second difference.
        let width = ((support.side - 1) * (support.columns + 1)).max(2 * support.columns) + 1;
        Self { lower: vec![0.0; n * width], width, right: vec![[0.0; 2]; n] }
    }

    fn add(&mut self, i: usize, j: usize, value: f64) {
        let (row, column) = (i.max(j), i.min(j));
        self.lower[row * self.width + self.width - 1 + column - row] += value;
    }

    /// Draws three knots in a row to a straight line, along both axes.
    fn straighten(&mut self, support: LocalSupport) {
        let LocalSupport { columns, rows, .. } = support;
        for (step, n_columns, n_rows) in
            [(1, columns.saturating_sub(2), rows), (columns, columns, rows.saturating_sub(2))]
        {
            for row in 0..n_rows {
                for column in 0..n_columns {
                    let first = row * columns + column;
                    let terms = [(first, 1.0), (first + step, -2.0), (first + 2 * step, 1.0)];
                    for (i, (knot, factor)) in terms.into_iter().enumerate() {
                        for &(other, other_factor) in &terms[..=i] {
                            self.add(knot, other, STRAIGHTNESS * factor * other_factor);
                        }
                    }
                }
            }
        }
    }

    /// Solves by Cholesky's method, or returns `None` if the matrix is not positive definite.
    fn solve(mut self) -> Option<Vec<[f64; 2]>> {
        let (n, width) = (self.right.len(), self.width);
        for i in 0..n {
            let reach = |row: usize| row.saturating_sub(width - 1);
            for j in reach(i)..=i {
                let first = reach(i).max(reach(j));
                let row = |row: usize| row * width + width - 1 + first - row;
                let (a, b) = (row(i), row(j));
                let dot: f64 = (0..j - first).map(|k| self.lower[a + k] * self.lower[b + k]).sum();
                let rest = self.lower[a + j - first] - dot;
                self.lower[a + j - first] = if i == j {
                    // Against a sample's weight near one, below this the knot is not determined.
                    if rest.is_nan() || rest < 1e-14 {
                        return None;
                    }
                    rest.sqrt()
                } else {
                    rest / self.lower[j * width + width - 1]
                };
            }
        }
        let entry = |i: usize, j: usize| self.lower[i * width + width - 1 + j - i];
        for axis in 0..2 {
            for i in 0..n {
                let known: f64 =
                    (i.saturating_sub(width - 1)..i).map(|j| entry(i, j) * self.right[j][axis]).sum();
                self.right[i][axis] = (self.right[i][axis] - known) / entry(i, i);
            }
            for i in (0..n).rev() {
                let known: f64 = (i + 1..n.min(i + width)).map(|j| entry(j, i) * self.right[j][axis]).sum();
                self.right[i][axis] = (self.right[i][axis] - known) / entry(i, i);
            }
        }
        Some(self.right)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[track_caller]
    fn check(source: (&str, &[f64]), model: &str, limit_px: f64) {
        let source = Camera::new(source.0.parse().unwrap(), source.1.to_vec(), [1600, 1200]).unwrap();
        let fitted = camera_from_lens(model.parse().unwrap(), &source).unwrap();
        let mut largest: f64 = 0.0;
        for column in 0..=80 {
            for row in 0..=60 {
                let pixel = [f64::from(column) * 1599.0 / 80.0, f64::from(row) * 1199.0 / 60.0];
                let Some(ray) = source.unproject(pixel) else { continue };
                let found = fitted.project(&ray).unwrap();
                largest = largest.max((found[0] - pixel[0]).hypot(found[1] - pixel[1]));
            }
        }
        assert!(largest < limit_px, "{model} of {}: {largest} px", source.model);
    }

    #[test]
    fn a_spline_follows_any_lens_over_the_image() {
        let common = ("opencv5", &[1250.0, 1245.0, 790.0, 610.0, -0.27, 0.12, 1.8e-3, -3e-4, -0.02][..]);
        let fisheye = ("kannala-brandt4", &[380.0, 381.0, 795.0, 605.0, -0.01, 0.005, -0.002, 3e-4][..]);
        // What is left is what cells of this size cannot follow, at the corners.
        check(common, "splined3", 2e-2);
        check(common, "splined2", 2e-2);
        check(common, "splined3:12x10:80deg", 4e-2);
        check(fisheye, "splined3", 5e-2);
        check(fisheye, "splined2:40", 5e-2);
    }
}
