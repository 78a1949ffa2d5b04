//! The tilted sensor (Scheimpflug) of OpenCV's 14-parameter lens.
//!
//! OpenCV turns the image plane by `R = R_y(tau_y) R_x(tau_x)` and looks at it from the centre of
//! projection: `matTilt = [R33 0 -R13; 0 R33 -R23; 0 0 1] R` (Louhichi et al. 2007, as documented
//! in `calib3d`). Multiplied out, the homography has two zeros above its last row.

use boresight_geometry::Scalar;

/// Returns the point on the tilted sensor, or `None` behind it. `angles` are tau_x, tau_y in radians.
#[inline(always)]
pub(super) fn tilt<T: Scalar>(angles: [T; 2], [x, y]: [T; 2]) -> Option<[T; 2]> {
    let [(sin_x, cos_x), (sin_y, cos_y)] =
        [(angles[0].sin(), angles[0].cos()), (angles[1].sin(), angles[1].cos())];
    let depth = sin_y.mul_add(x, cos_y * (cos_x - sin_x * y));
    if !depth.all_above(0.0) {
        return None;
    }
    let inverse = depth.like(1.0) / depth;
    Some([cos_x * x * inverse, (cos_y * y - sin_x * sin_y * x) * inverse])
}

/// Returns the point before the tilt, or `None` if there is none in front of the tilted sensor.
pub(super) fn untilt(angles: [f64; 2], [u, v]: [f64; 2]) -> Option<[f64; 2]> {
    let [(sin_x, cos_x), (sin_y, cos_y)] = angles.map(f64::sin_cos);
    // u depth = cos_x x and v depth = cos_y y - sin_x sin_y x are linear in x and y.
    let [a, b] = [cos_x - u * sin_y, u * cos_y * sin_x];
    let [c, d] = [-sin_y * (sin_x + v), cos_y * (1.0 + v * sin_x)];
    let [e, f] = [u * cos_y * cos_x, v * cos_y * cos_x];
    let determinant = a * d - b * c;
    let (x, y) = ((e * d - b * f) / determinant, (a * f - e * c) / determinant);
    let depth = sin_y * x + cos_y * (cos_x - sin_x * y);
    (depth > 0.0 && x.is_finite() && y.is_finite()).then_some([x, y])
}
