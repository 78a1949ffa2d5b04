//! Zhang's closed form for the intrinsics of a narrow lens, from homographies of planar targets.

use boresight_geometry::nalgebra::SMatrix;
use boresight_geometry::{Matrix3, Vector3};

use crate::linear::smallest_eigenvector;
use crate::sighting::Sighting;

/// Intrinsics `fx, fy, cx, cy` in pixels.
pub(crate) type Core = [f64; 4];

/// Returns the homography from a planar target to the pixels, taken relative to `centre` in units of
/// `unit_px`, by the normalised direct linear transform (algorithm 4.2 of Hartley & Zisserman 2004),
/// each point weighed by the `trust` in it; `None` for a target that is not flat.
pub(crate) fn homography(
    sighting: &Sighting,
    trust: &[f64],
    centre: [f64; 2],
    unit_px: f64,
) -> Option<Matrix3<f64>> {
    let plane_from_target = sighting.plane_from_target?;
    let centroid = plane_from_target * sighting.centroid;
    let total: f64 = trust.iter().sum();
    let weighed = || sighting.pixels.iter().zip(trust);
    let mean = [0, 1].map(|axis| weighed().map(|(pixel, trust)| trust * pixel[axis]).sum::<f64>() / total);
    let square: f64 =
        weighed().map(|([u, v], trust)| trust * ((u - mean[0]).powi(2) + (v - mean[1]).powi(2))).sum();
    let spread = (square / total).sqrt();
    let mut moments = SMatrix::<f64, 9, 9>::zeros();
    for ((point, pixel), trust) in sighting.points.iter().zip(&sighting.pixels).zip(trust) {
        let in_plane = (plane_from_target * *point - centroid) / sighting.extent;
        let m = Vector3::new(in_plane.x, in_plane.y, 1.0);
        let outer = m * m.transpose() * *trust;
        let (u, v) = ((pixel[0] - mean[0]) / spread, (pixel[1] - mean[1]) / spread);
        // The rows are (m, 0, -u m) and (0, m, -v m).
        for (block, factor) in [((0, 0), 1.0), ((3, 3), 1.0), ((6, 6), u * u + v * v)] {
            let mut block = moments.fixed_view_mut::<3, 3>(block.0, block.1);
            block += outer * factor;
        }
        for (row, factor) in [(0, -u), (3, -v)] {
            let mut block = moments.fixed_view_mut::<3, 3>(row, 6);
            block += outer * factor;
        }
    }
    moments.fill_lower_triangle_with_upper_triangle();
    let h = smallest_eigenvector(&moments)?;
    let normalised = Matrix3::from_row_slice(h.as_slice());
    let scale = spread / unit_px;
    let offset = [0, 1].map(|axis| (mean[axis] - centre[axis]) / unit_px);
    Some(Matrix3::new(scale, 0.0, offset[0], 0.0, scale, offset[1], 0.0, 0.0, 1.0) * normalised)
}

/// Returns the focal length, in the homographies' unit, of a lens with square pixels centred at the
/// origin: eq. 3-4 of Zhang 2000 with one unknown, by least squares.
pub(crate) fn focal_length(homographies: &[Matrix3<f64>]) -> Option<f64> {
    // Both constraints read a w + b = 0 with w = 1/f².
    let (mut aa, mut ab) = (0.0, 0.0);
    for h in homographies {
        for [a, _, _, b] in constraints(h).map(|c| [c[0] + c[1], c[2], c[3], c[4]]) {
            aa += a * a;
            ab += a * b;
        }
    }
    let inverse_square = -ab / aa;
    (inverse_square > 0.0 && inverse_square.is_finite()).then(|| inverse_square.sqrt().recip())
}

/// Returns focal lengths and centre in the homographies' unit: section 3.1 and appendix B of Zhang
/// 2000 without skew. It takes at least two views that are tilted differently.
pub(crate) fn core(homographies: &[Matrix3<f64>]) -> Option<Core> {
    if homographies.len() < 3 {
        return None;
    }
    let mut moments = SMatrix::<f64, 5, 5>::zeros();
    for h in homographies {
        for row in constraints(h) {
            for i in 0..5 {
                for j in 0..5 {
                    moments[(i, j)] += row[i] * row[j];
                }
            }
        }
    }
    let b = smallest_eigenvector(&moments)?;
    let [b11, b22, b13, b23, b33] = [b[0], b[1], b[2], b[3], b[4]];
    let (cx, cy) = (-b13 / b11, -b23 / b22);
    let lambda = b33 - b13 * b13 / b11 - b23 * b23 / b22;
    let (fx_square, fy_square) = (lambda / b11, lambda / b22);
    let is_real =
        fx_square > 0.0 && fy_square > 0.0 && [fx_square, fy_square, cx, cy].iter().all(|v| v.is_finite());
    is_real.then(|| [fx_square.sqrt(), fy_square.sqrt(), cx, cy])
}

/// Returns the two constraints of a homography on `(B11, B22, B13, B23, B33)`: its first two columns
/// are images of orthogonal directions of equal length.
fn constraints(h: &Matrix3<f64>) -> [[f64; 5]; 2] {
    // The scale of a homography is arbitrary; the mean length of the columns in question is made one.
    let (first, second): (Vector3<f64>, Vector3<f64>) = (h.column(0).into(), h.column(1).into());
    let scale = (first.norm() * second.norm()).max(f64::MIN_POSITIVE);
    let v = |a: &Vector3<f64>, b: &Vector3<f64>| {
        [a.x * b.x, a.y * b.y, a.x * b.z + a.z * b.x, a.y * b.z + a.z * b.y, a.z * b.z]
            .map(|value| value / scale)
    };
    let (v12, v11, v22) = (v(&first, &second), v(&first, &first), v(&second, &second));
    let mut difference = [0.0; 5];
    for (i, value) in difference.iter_mut().enumerate() {
        *value = v11[i] - v22[i];
    }
    [v12, difference]
}
