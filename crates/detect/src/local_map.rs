//! The map from a drawing to the image near a place: a homography, and how a lens bends it.

use boresight_geometry::nalgebra::{SMatrix, SVector};

/// The unknowns: for u and for v the factors of 1, x, y and their squares, then the perspective that both share.
const N: usize = 12;
/// Which of them are h₁ to h₈.
const HOMOGRAPHY: [usize; 8] = [0, 1, 2, 5, 6, 7, 10, 11];
/// Which of them are of squares.
const SQUARES: [usize; 4] = [3, 4, 8, 9];
/// With so many places around, the bend of a lens can be told too.
const BENT_FROM: i32 = 14;

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
        // The blocks of the normal equations below the diagonal, and the gradient: of u and v what they share once.
        let (mut own, mut perspective) = (SMatrix::<f64, 5, 5>::zeros(), SMatrix::<f64, 2, 2>::zeros());
        let mut coupling = [SMatrix::<f64, 2, 5>::zeros(); 2];
        let mut own_gradient = [SVector::<f64, 5>::zeros(); 2];
        let mut perspective_gradient = SVector::<f64, 2>::zeros();
        let (mut n, mut sides) = (0, [false; 4]);
        let mut origin = None;
        let mut square_px = 0.0;
        for ([x, y], pixel) in near.filter(|(at, _)| *at != [0.0; 2]) {
            let origin = *origin.get_or_insert(pixel);
            let [u, v] = [0, 1].map(|i| pixel[i] - origin[i]);
            square_px += u * u + v * v;
            sides = [sides[0] || x > 0.0, sides[1] || y > 0.0, sides[2] || x < 0.0, sides[3] || y < 0.0];
            // u (1 + h₇ x + h₈ y) = h₁ + h₂ x + h₃ y + h₉ x² + h₁₀ y², and the same for v; near neighbours count more.
            let (powers, at) = (SVector::from([1.0, x, y, x * x, y * y]), SVector::from([x, y]));
            let weighed = powers / (x * x + y * y);
            own += weighed * powers.transpose();
            for (axis, c) in [u, v].into_iter().enumerate() {
                own_gradient[axis] += weighed * c;
                coupling[axis] -= at * (weighed * c).transpose();
            }
            let shared = at * ((u * u + v * v) / (x * x + y * y));
            perspective += shared * at.transpose();
            perspective_gradient -= shared;
            n += 1;
        }
        let origin = origin.filter(|_| n >= 3)?;
        let mut normal = SMatrix::<f64, N, N>::zeros();
        let mut gradient = SVector::<f64, N>::zeros();
        for axis in 0..2 {
            normal.fixed_view_mut::<5, 5>(5 * axis, 5 * axis).copy_from(&own);
            normal.fixed_view_mut::<2, 5>(10, 5 * axis).copy_from(&coupling[axis]);
            gradient.fixed_rows_mut::<5>(5 * axis).copy_from(&own_gradient[axis]);
        }
        normal.fixed_view_mut::<2, 2>(10, 10).copy_from(&perspective);
        gradient.fixed_rows_mut::<2>(10).copy_from(&perspective_gradient);
        // With few neighbours an affine map has to do; perspective is held near zero. So are bends, but for many.
        let square_px = (square_px / f64::from(n)).max(1.0);
        for k in 10..N {
            normal[(k, k)] += if n >= 7 { 1e-6 } else { 1e3 } * square_px;
        }
        if n < BENT_FROM {
            for k in SQUARES {
                normal.row_mut(k).fill(0.0);
                normal.column_mut(k).fill(0.0);
                normal[(k, k)] = 1.0;
                gradient[k] = 0.0;
            }
        }
        // Places in a row determine nothing across it.
        let spread = normal[(1, 1)] * normal[(2, 2)] - normal[(1, 2)].powi(2);
        if spread <= 1e-6 * normal[(1, 1)] * normal[(2, 2)] {
            return None;
        }
        for k in SQUARES {
            normal[(k, k)] *= 1.0 + 1e-9;
        }
        let h = normal.cholesky()?.solve(&gradient);
        Some(Self { h: HOMOGRAPHY.map(|k| h[k]), origin, is_surrounded: sides == [true; 4] })
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
    fn what_a_lens_bends_is_followed() {
        // Barrel distortion that moves the ends of five steps by half a step.
        let bent = |[x, y]: [f64; 2]| {
            let [u, v] = image_of([x + 3.0, y + 2.0]);
            let square = (u - 100.0).powi(2) + (v - 80.0).powi(2);
            [u, v].map(|c| c * (1.0 - 2e-6 * square))
        };
        let places = |from: i32| (0..25).map(move |i| [f64::from(i % 5 + from), f64::from(i / 5 - 2)]);
        let error = |from| {
            let map = LocalMap::fitted(places(from).map(|at| (at, bent(at)))).unwrap();
            let truth = bent([0.0; 2]);
            (map.pixel()[0] - truth[0]).hypot(map.pixel()[1] - truth[1])
        };
        // In the middle and at the rim; a step is 20 pixels.
        assert!(error(-2) < 0.1 && error(0) < 0.6, "{} {}", error(-2), error(0));
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
