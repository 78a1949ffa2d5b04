//! A lens that folds back inside the image.

use boresight_camera::Camera;
use boresight_data::{CameraId, Severity};

use super::case::Case;
#[cfg(test)]
use super::example::Example;
use super::{Diagnostic, Found};

/// A lens that reaches this far off axis may leave the corners of the image black.
const FISHEYE_DEG: f64 = 85.0;

/// A circular fisheye ends where it folds back: corners are seen up to this share of the angle there.
const RIM_SHARE: f64 = 0.9;

/// A lens that folds back inside the image.
pub(super) struct NotMonotonic;

impl Diagnostic for NotMonotonic {
    const CODE: &'static str = "not-monotonic";

    const EXPLANATION: &'static str = "\
What it means: going outward from the middle, the image of a ray first moves
outward and then, still inside the image, turns back. From there on no ray of
the lens leads to the pixels, or two do. The message says how far along the way
to a corner of the image this happens.

Why it matters: no real lens does that. A polynomial was fitted where there were
corners and runs away where there were none. Undistorting an image leaves holes
or folds there, and points outside the field of view are projected into the
image. The residuals do not show it. For a fisheye that sees beyond 85 degrees
it is a caution only, as long as the fold is in the corners, or targets were
seen up to nine tenths of its angle: what is beyond may be black, and then
nothing is lost.

How to fix it: take views with the board in the corners of the image, so that
the data reach as far as the lens. Otherwise take a lens model with fewer
coefficients (opencv5 and not opencv8, opencv4 and not opencv5), regularise, or,
for lenses beyond 100 degrees, take a fisheye model.";

    fn find(case: &Case) -> Vec<Found> {
        let found = case.cameras().filter_map(|(id, name, placed)| {
            let camera = &placed.camera;
            let [right, bottom] = camera.image_size.map(|size| f64::from(size) - 1.0);
            let corners = [
                ([0.0, 0.0], "top-left"),
                ([right, 0.0], "top-right"),
                ([0.0, bottom], "bottom-left"),
                ([right, bottom], "bottom-right"),
            ];
            let reach = corners.map(|(corner, corner_name)| (reach(camera, corner), corner_name));
            let (least, corner_name) = reach.into_iter().min_by(|one, other| one.0.total_cmp(&other.0))?;
            if least >= 1.0 {
                return None;
            }
            let limit_deg = camera.monotonic_limit().map(f64::to_degrees);
            let edges = [[0.5 * right, 0.0], [0.5 * right, bottom], [0.0, 0.5 * bottom], [right, 0.5 * bottom]];
            let sees_edges = edges.into_iter().all(|edge| camera.unproject(edge).is_some());
            let is_fisheye = limit_deg.is_some_and(|limit| limit >= FISHEYE_DEG);
            let is_seen_to = |limit| farthest_deg(case, id, camera).is_some_and(|far| far >= RIM_SHARE * limit);
            let ends_there = sees_edges || limit_deg.is_some_and(is_seen_to);
            let at = limit_deg.map_or(String::new(), |limit| format!(", {limit:.1} degrees off axis"));
            Some(Found {
                severity: if is_fisheye && ends_there { Severity::Caution } else { Severity::Fail },
                place: name.to_owned(),
                message: format!(
                    "the lens folds back at {:.0} % of the way from the middle to the {corner_name} corner{at}",
                    100.0 * least
                ),
                measured: Some(least),
                limit: Some(1.0),
                fix: format!(
                    "Take views with the board in the {corner_name} corner, or a lens model with fewer coefficients."
                ),
            })
        });
        found.collect()
    }

    #[cfg(test)]
    fn examples() -> Vec<(Example, Severity)> {
        let mut common = Example::mono();
        // Folds where 1 + 3 k1 r² + 5 k2 r⁴ vanishes; the corners are at 0.9.
        common.lens(0).params[4..].copy_from_slice(&[-0.5, 0.0, 0.0, 0.0, 0.0]);
        let mut fisheye = Example::fisheye();
        // Folds at 95 degrees and 553 px times 1.2.
        let at_rad = 95f64.to_radians();
        *fisheye.lens(0) = Camera {
            params: vec![600.0, 600.0, 799.5, 599.5, -1.0 / (3.0 * at_rad * at_rad), 0.0, 0.0, 0.0],
            ..fisheye.lens(0).clone()
        };
        let mut narrow = fisheye.clone();
        narrow.lens(0).params[..2].copy_from_slice(&[400.0, 400.0]);
        let mut wide = fisheye.clone();
        wide.lens(0).params[..2].copy_from_slice(&[800.0, 800.0]);
        // The same lens, where all corners lie inside its circle and some near its rim.
        let mut circular = narrow.clone();
        let lens = circular.lens(0).clone();
        for observation in circular.dataset.views.iter_mut().flat_map(|view| &mut view.observations) {
            let [x, y] = [0, 1].map(|axis| observation.pixel[axis] - lens.params[2 + axis]);
            let shrink = (436.0 / x.hypot(y)).min(1.0);
            observation.pixel = [lens.params[2] + shrink * x, lens.params[3] + shrink * y];
        }
        vec![
            (common, Severity::Fail),
            (narrow, Severity::Fail),
            (wide, Severity::Caution),
            (circular, Severity::Caution),
        ]
    }
}

/// Returns how far off axis a camera saw corners that are used, in degrees, or `None` if one lies beyond the fold.
fn farthest_deg(case: &Case, id: CameraId, camera: &Camera) -> Option<f64> {
    let mut kept = case.used_views_of(id).flat_map(|used| case.kept(used));
    kept.try_fold(0.0, |farthest: f64, observation| {
        let ray = camera.unproject(observation.pixel)?;
        Some(farthest.max(ray.xy().norm().atan2(ray.z).to_degrees()))
    })
}

/// Returns the share of the way from the middle of the image to `corner` up to which pixels see something.
fn reach(camera: &Camera, corner: [f64; 2]) -> f64 {
    let sees = |share: f64| {
        let middle = camera.image_size.map(|size| 0.5 * (f64::from(size) - 1.0));
        camera.unproject([0, 1].map(|axis| middle[axis] + share * (corner[axis] - middle[axis]))).is_some()
    };
    if sees(1.0) {
        return 1.0;
    }
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..20 {
        let middle = 0.5 * (low + high);
        if sees(middle) { low = middle } else { high = middle }
    }
    low
}

#[cfg(test)]
mod tests {
    use boresight_camera::Model;

    use super::*;

    #[test]
    fn the_fold_is_where_the_formula_says() {
        // r - 0.4 r³ is largest at r² = 1/1.2, where it is 2/3 of r; the corner is at sqrt(0.8² + 0.6²) = 1.
        let params = vec![1000.0, 1000.0, 800.0, 600.0, -0.4, 0.0, 0.0, 0.0, 0.0];
        let camera = Camera::new(Model::OpenCv5(Default::default()), params, [1601, 1201]).unwrap();
        let expected = 2.0 / 3.0 / 1.2f64.sqrt();
        assert!((reach(&camera, [0.0, 0.0]) - expected).abs() < 1e-5);
        let pinhole =
            Camera::new(Model::Pinhole(Default::default()), camera.params[..4].to_vec(), [1601, 1201]);
        assert_eq!(reach(&pinhole.unwrap(), [1600.0, 0.0]), 1.0);
    }
}
