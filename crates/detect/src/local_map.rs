//! The homography that maps a drawing to the image near a place.

use boresight_geometry::nalgebra::{SMatrix, SVector};

/// The map from places relative to a place on a drawing to pixels, fitted to what is known around it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LocalMap {
    /// h₁ to h₈, in pixels relative to the origin.
    h: [f64; 8],
    origin: [f64; 2],
    /// Whether there is something known on all four sides.
    pub is_surrounded: bool,
}

impl LocalMap {
    /// Fits to places relative to the one looked at, and their pixels; the place itself does not count.
    ///
    /// `None` if there are fewer than three, or all in a row.
    pub fn fitted(near: impl Iterator<Item = ([f64; 2], [f64; 2])>) -> Option<Self> {
        let mut normal = SMatrix::<f64, 8, 8>::zeros();
        let mut gradient = SVector::<f64, 8>::zeros();
        let (mut n, mut sides) = (0, [false; 4]);
        let mut origin = None;
        let mut square_px = 0.0;
        for ([x, y], pixel) in near.filter(|(at, _)| *at != [0.0; 2]) {
            let origin = *origin.get_or_insert(pixel);
            let [u, v] = [0, 1].map(|i| pixel[i] - origin[i]);
            square_px += u * u + v * v;
            sides = [sides[0] || x > 0.0, sides[1] || y > 0.0, sides[2] || x < 0.0, sides[3] || y < 0.0];
            // u (1 + h₇ x + h₈ y) = h₁ + h₂ x + h₃ y, and the same for v; near neighbours count more.
            let weight = 1.0 / (x * x + y * y);
            for row in [
                (SVector::from([1.0, x, y, 0.0, 0.0, 0.0, -u * x, -u * y]), u),
                (SVector::from([0.0, 0.0, 0.0, 1.0, x, y, -v * x, -v * y]), v),
            ] {
                normal += row.0 * row.0.transpose() * weight;
                gradient += row.0 * (row.1 * weight);
            }
            n += 1;
        }
        let origin = origin.filter(|_| n >= 3)?;
        // With few neighbours an affine map has to do; the last two unknowns are held near zero.
        let hold = if n >= 7 { 1e-6 } else { 1e3 } * (square_px / f64::from(n)).max(1.0);
        for k in 6..8 {
            normal[(k, k)] += hold;
        }
        // Places in a row determine nothing across it.
        let spread = normal[(1, 1)] * normal[(2, 2)] - normal[(1, 2)].powi(2);
        if spread <= 1e-6 * normal[(1, 1)] * normal[(2, 2)] {
            return None;
        }
        let h = normal.cholesky()?.solve(&gradient);
        Some(Self { h: h.into(), origin, is_surrounded: sides == [true; 4] })
    }

    /// Returns the pixel of the place.
    pub fn pixel(&self) -> [f64; 2] {
        [self.origin[0] + self.h[0], self.origin[1] + self.h[3]]
    }

    /// Returns what steps of a length along x and y are in pixels there.
    pub fn steps_px(&self, step: f64) -> [[f64; 2]; 2] {
        let h = &self.h;
        [
            [step * (h[1] - h[6] * h[0]), step * (h[4] - h[6] * h[3])],
            [step * (h[2] - h[7] * h[0]), step * (h[5] - h[7] * h[3])],
        ]
    }

    /// Returns the homography row by row, in pixels relative to that of the place.
    pub fn homography(&self) -> [f64; 9] {
        let [[a, c], [b, d]] = self.steps_px(1.0);
        [a, b, 0.0, c, d, 0.0, self.h[6], self.h[7], 1.0]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image_of([x, y]: [f64; 2]) -> [f64; 2] {
        let w = 1.0 + 0.02 * x - 0.03 * y;
        [(100.0 + 20.0 * x - 3.0 * y) / w, (80.0 + 2.0 * x + 25.0 * y) / w]
    }

    #[test]
    fn a_homography_is_found_again() {
        let places = (0..25).map(|i| [f64::from(i % 5 - 2), f64::from(i / 5 - 2)]);
        let map = LocalMap::fitted(places.map(|at| (at, image_of(at)))).unwrap();
        let near = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]) < 1e-4;
        assert!(near(map.pixel(), [100.0, 80.0]) && map.is_surrounded, "{map:?}");
        let h = map.homography();
        let mapped = |x: f64, y: f64| {
            let w = h[6] * x + h[7] * y + h[8];
            [(h[0] * x + h[1] * y) / w + 100.0, (h[3] * x + h[4] * y) / w + 80.0]
        };
        assert!(near(mapped(1.5, -0.5), image_of([1.5, -0.5])), "{h:?}");
        let steps = map.steps_px(0.5);
        assert!(near(steps[0], [9.0, 0.2]) && near(steps[1], [0.0, 13.7]), "{steps:?}");
    }

    #[test]
    fn too_few_places_and_rows_of_them_are_refused() {
        for places in [vec![[1.0, 0.0], [0.0, 1.0]], vec![[1.0, 1.0], [2.0, 2.0], [-1.0, -1.0], [3.0, 3.0]]] {
            assert!(LocalMap::fitted(places.into_iter().map(|at| (at, image_of(at)))).is_none());
        }
        let affine = [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]];
        let map = LocalMap::fitted(affine.into_iter().map(|at| (at, image_of(at)))).unwrap();
        assert!((map.pixel()[0] - 100.0).abs() < 0.5 && map.is_surrounded, "{map:?}");
    }
}
