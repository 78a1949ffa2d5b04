//! What sphere models share: a point seen from a second centre, halfway to a pinhole's.
//!
//! With `d` the length of a point (or of something like it) and `z` its depth, sphere models divide by
//! `α d + (1 - α) z`. The image radius grows as long as `α z + (1 - α) d` is positive as well, eqs. 21,
//! 30, 43 of Usenko, Demmel & Cremers 2018 in one.

use boresight_geometry::Scalar;

/// Returns `α d + (1 - α) z`, or `None` where it is not positive or where the image radius shrinks.
#[inline(always)]
pub(crate) fn mixed_depth<T: Scalar>(alpha: T, length: T, depth: T) -> Option<T> {
    let difference = length - depth;
    let mixed = alpha.mul_add(difference, depth);
    let growth = length - alpha * difference;
    (mixed.all_above(0.0) && growth.all_above(0.0)).then_some(mixed)
}

/// Returns the depth of the point of mixed depth one whose squared distance off axis is `r2`, or `None`
/// if there is none in the domain.
pub(crate) fn depth_of_radius(alpha: f64, r2: f64) -> Option<f64> {
    // α² (r² + z²) = (1 - (1 - α) z)², of whose roots this one is z = 1 at r = 0.
    let root = (1.0 - (2.0 * alpha - 1.0) * r2).sqrt();
    let depth = if alpha < 0.0 {
        (1.0 - alpha - alpha * root) / (1.0 - 2.0 * alpha)
    } else {
        (1.0 - alpha * alpha * r2) / (alpha * root + 1.0 - alpha)
    };
    depth.is_finite().then_some(depth)
}

/// Returns the ray if all of it is finite.
pub(crate) fn finite(ray: [f64; 3]) -> Option<[f64; 3]> {
    ray.iter().all(|x| x.is_finite()).then_some(ray)
}
