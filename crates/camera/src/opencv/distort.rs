//! The distortion on the image plane, and its derivatives in closed form.

use boresight_geometry::Scalar;

/// Returns the distorted point of the image-plane point (`x`, `y`), before any tilt.
#[inline(always)]
pub(crate) fn distort<T: Scalar, const N: usize>(lens: &[T], x: T, y: T) -> [T; 2] {
    let r2 = x.mul_add(x, y * y);
    let numerator = numerator::<T, N>(lens, r2).mul_add(r2, r2.like(1.0));
    let radial = if N >= 8 { numerator / denominator(lens, r2).mul_add(r2, r2.like(1.0)) } else { numerator };
    let (p1, p2) = (lens[2], lens[3]);
    let xy_twice = (x * y).scale(2.0);
    let mut distorted = [
        x.mul_add(radial, p1.mul_add(xy_twice, p2 * x.scale(2.0).mul_add(x, r2))),
        y.mul_add(radial, p2.mul_add(xy_twice, p1 * y.scale(2.0).mul_add(y, r2))),
    ];
    if N >= 12 {
        distorted[0] = lens[9].mul_add(r2, lens[8]).mul_add(r2, distorted[0]);
        distorted[1] = lens[11].mul_add(r2, lens[10]).mul_add(r2, distorted[1]);
    }
    distorted
}

/// A distorted point with its derivatives.
pub(super) struct Distorted<T> {
    /// The distorted point, before any tilt.
    pub(super) plane: [T; 2],
    /// Its derivatives by the undistorted point.
    pub(super) d_plane: [[T; 2]; 2],
    r2: T,
    radial: T,
    inverse_denominator: T,
}

/// Returns the distorted point of the image-plane point (`x`, `y`), before any tilt, with derivatives.
#[inline(always)]
pub(super) fn linearize_distortion<T: Scalar, const N: usize>(lens: &[f64], x: T, y: T) -> Distorted<T> {
    let (xx, yy) = (x * x, y * y);
    let r2 = xx + yy;
    let (mut radial, mut slope, mut inverse_denominator);
    // The polynomials and their derivatives by r².
    if N >= 5 {
        radial = x
            .like(lens[4])
            .mul_add(r2, x.like(lens[1]))
            .mul_add(r2, x.like(lens[0]))
            .mul_add(r2, r2.like(1.0));
        slope = r2.like(3.0 * lens[4]).mul_add(r2, r2.like(2.0 * lens[1])).mul_add(r2, x.like(lens[0]));
    } else {
        radial = x.like(lens[1]).mul_add(r2, x.like(lens[0])).mul_add(r2, r2.like(1.0));
        slope = r2.like(2.0 * lens[1]).mul_add(r2, x.like(lens[0]));
    }
    inverse_denominator = r2.like(1.0);
    if N >= 8 {
        let denominator = x
            .like(lens[7])
            .mul_add(r2, x.like(lens[6]))
            .mul_add(r2, x.like(lens[5]))
            .mul_add(r2, r2.like(1.0));
        let denominator_slope =
            r2.like(3.0 * lens[7]).mul_add(r2, r2.like(2.0 * lens[6])).mul_add(r2, x.like(lens[5]));
        inverse_denominator = r2.like(1.0) / denominator;
        radial = radial * inverse_denominator;
        slope = (slope - radial * denominator_slope) * inverse_denominator;
    }
    let (p1, p2) = (x.like(lens[2]), x.like(lens[3]));
    let (x2, y2) = (x + x, y + y);
    let xy2 = x2 * y;
    // 2 p1 y + 2 p2 x, which all derivatives of the tangential terms contain.
    let tangential = p1.mul_add(y2, p2 * x2);
    let slope_x2 = slope * x2;
    let mixed = slope_x2.mul_add(y, p1.mul_add(x2, p2 * y2));
    let mut distorted = Distorted {
        plane: [
            x.mul_add(radial, p1.mul_add(xy2, p2 * x2.mul_add(x, r2))),
            y.mul_add(radial, p2.mul_add(xy2, p1 * y2.mul_add(y, r2))),
        ],
        d_plane: [
            [slope_x2.mul_add(x, x.like(2.0 * lens[3]).mul_add(x2, tangential)) + radial, mixed],
            [mixed, (slope * y2).mul_add(y, x.like(2.0 * lens[2]).mul_add(y2, tangential)) + radial],
        ],
        r2,
        radial,
        inverse_denominator,
    };
    if N >= 12 {
        for (row, first) in [(0, 8), (1, 10)] {
            let prism = x.like(lens[first + 1]).mul_add(r2, x.like(lens[first]));
            let prism_slope = x.like(2.0 * lens[first + 1]).mul_add(r2, x.like(lens[first]));
            distorted.plane[row] = prism.mul_add(r2, distorted.plane[row]);
            distorted.d_plane[row][0] = prism_slope.mul_add(x2, distorted.d_plane[row][0]);
            distorted.d_plane[row][1] = prism_slope.mul_add(y2, distorted.d_plane[row][1]);
        }
    }
    distorted
}

impl<T: Scalar> Distorted<T> {
    /// Writes the derivatives by the distortion parameters, times the focal lengths.
    #[inline(always)]
    pub(super) fn by_lens<const N: usize>(&self, focal: [T; 2], plane: [T; 2], d_lens: [&mut [T]; 2]) {
        let [x, y] = plane;
        let r2 = self.r2;
        let xy2 = (x + x) * y;
        let tangential = [
            [focal[0] * xy2, focal[0] * (x + x).mul_add(x, r2)],
            [focal[1] * (y + y).mul_add(y, r2), focal[1] * xy2],
        ];
        for (row, out) in d_lens.into_iter().enumerate() {
            // One check here spares one at every entry.
            let out = &mut out[..N];
            let mut ray = focal[row] * plane[row];
            if N >= 8 {
                ray = ray * self.inverse_denominator;
            }
            let ray_r2 = ray * r2;
            let ray_r4 = ray_r2 * r2;
            out[0] = ray_r2;
            out[1] = ray_r4;
            out[2] = tangential[row][0];
            out[3] = tangential[row][1];
            if N >= 5 {
                out[4] = ray_r4 * r2;
            }
            if N >= 8 {
                let minus = -self.radial;
                out[5] = minus * ray_r2;
                out[6] = minus * ray_r4;
                out[7] = minus * out[4];
            }
            if N >= 12 {
                let prism = [focal[row] * r2, focal[row] * r2 * r2];
                for i in 0..2 {
                    out[8 + 2 * row + i] = prism[i];
                    out[8 + 2 * (1 - row) + i] = r2.like(0.0);
                }
            }
        }
    }
}

/// Returns (numerator of the radial factor - 1) / r².
#[inline(always)]
fn numerator<T: Scalar, const N: usize>(lens: &[T], r2: T) -> T {
    let upper = if N >= 5 { lens[4].mul_add(r2, lens[1]) } else { lens[1] };
    upper.mul_add(r2, lens[0])
}

/// Returns (denominator of the radial factor - 1) / r².
#[inline(always)]
fn denominator<T: Scalar>(lens: &[T], r2: T) -> T {
    lens[7].mul_add(r2, lens[6]).mul_add(r2, lens[5])
}
