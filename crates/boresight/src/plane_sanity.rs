//! What no robot and no camera does: touches in another unit, pixels outside the image, parts beside the plane.

use boresight_adjust::{Touch, TouchLens, TouchOptions, TouchedPlane};
use boresight_data::{Finding, RobotPlane, Severity};

use crate::robot_error::RobotError;

/// Touches of a robot span more than the first and less than the second, in metres.
const SPAN_M: [f64; 2] = [5e-3, 20.0];

/// A robot touches better than this, in metres.
const TOUCH_M: f64 = 1e-3;

/// Residuals below this share of the stated sigmas are no chance; of so many degrees of freedom at least.
const TOO_GOOD: f64 = 0.1;
const TOO_GOOD_DEGREES: usize = 6;

/// Parts farther from the middle of the touches than this many times their usual distance are beside them. Of nine
/// touches in three rows the outermost are at 1.2 times.
const BESIDE: f64 = 2.0;

/// A finding of a measured value beyond a limit.
fn finding(
    code: &str,
    severity: Severity,
    place: &str,
    message: String,
    [measured, limit]: [f64; 2],
    fix: &str,
) -> Finding {
    let (code, place, fix) = (code.to_owned(), place.to_owned(), fix.to_owned());
    Finding { code, severity, place, message, measured: Some(measured), limit: Some(limit), fix }
}

/// Tells whether a pixel is outside an image of a size; without a size, whether it is outside any image.
fn is_outside(pixel: [f64; 2], size: Option<[u32; 2]>) -> bool {
    let most = |axis: usize| size.map_or(f64::INFINITY, |size| f64::from(size[axis]) - 0.5);
    !(0..2).all(|axis| (-0.5..=most(axis)).contains(&pixel[axis]))
}

/// Returns what cannot be right about touches.
pub(crate) fn of_touches(
    touched: &TouchedPlane,
    touches: &[Touch],
    lens: Option<TouchLens<'_>>,
    options: &TouchOptions,
) -> Vec<Finding> {
    let mut findings = Vec::new();
    let places = || touches.iter().map(|touch| touch.base_from_flange.translation);
    let span_m = places().flat_map(|one| places().map(move |other| (one - other).norm())).fold(0.0, f64::max);
    let limit = if span_m < SPAN_M[0] { SPAN_M[0] } else { SPAN_M[1] };
    if !(SPAN_M[0]..=SPAN_M[1]).contains(&span_m) {
        let (unit, other) =
            if span_m < SPAN_M[0] { ("metres", "x_m,y_m,z_m") } else { ("millimetres", "x_mm,y_mm,z_mm") };
        let message = format!(
            "the touches span {} mm, {} mm a pixel: no robot's table; are their numbers {unit}?",
            significant(1e3 * span_m),
            significant(1e3 * touched.plane.robot_scale_m / image_extent(touches)),
        );
        let fix = format!("if they are, name the columns {other}");
        findings.push(finding("touch-unit", Severity::Fail, "touches", message, [span_m, limit], &fix));
    }
    let size = lens.map(|lens| lens.camera.image_size);
    let outside: Vec<&Touch> = touches.iter().filter(|touch| is_outside(touch.pixel, size)).collect();
    if let Some(first) = outside.first() {
        let [u, v] = first.pixel;
        let image = size.map_or("any image".to_owned(), |[w, h]| format!("an image of {w}x{h}"));
        let message = format!(
            "{} of {} touches are at pixels outside {image}, such as {} at ({u:.1}, {v:.1})",
            outside.len(),
            touches.len(),
            first.name
        );
        let fix = "check that u and v are pixels and x and y positions, in the columns their names say, and that the \
                   calibration is of this camera at this resolution";
        let share = [outside.len() as f64, 0.0];
        findings.push(finding("touch-outside-image", Severity::Fail, "touches", message, share, fix));
    }
    let degrees = touched.degrees_of_freedom;
    match (options.sigma_touch_m, touched.noise_factor) {
        (None, Some(_)) if touched.sigma_touch_m > TOUCH_M && span_m <= SPAN_M[1] => {
            let message =
                format!("the touches miss the plane's map by {:.2} mm", 1e3 * touched.sigma_touch_m);
            let fix = "a robot touches to some tenths of a millimetre: check that pixels and positions are paired and \
                       in the columns their names say, and give the calibration of the lens, of this camera";
            let measured = [touched.sigma_touch_m, TOUCH_M];
            findings.push(finding("touches-coarse", Severity::Caution, "touches", message, measured, fix));
        }
        (Some(stated_m), Some(factor)) if factor < TOO_GOOD && degrees >= TOO_GOOD_DEGREES => {
            let message = format!(
                "the residuals are {factor:.1e} times what the stated sigmas ({} mm, {} px) explain",
                significant(1e3 * stated_m),
                significant(options.sigma_px)
            );
            let fix = "check the units of touches and sigmas; measured touches scatter";
            let measured = [factor, TOO_GOOD];
            findings.push(finding(
                "touches-better-than-stated",
                Severity::Caution,
                "touches",
                message,
                measured,
                fix,
            ));
        }
        _ => {}
    }
    if let (Some(above_m), true) = (camera_above_m(&touched.plane), touched.plane.facing > 0.0) {
        let message = format!(
            "the camera looks along the robot's z axis, from {:.1} mm below the plane",
            -1e3 * above_m
        );
        let fix = "nothing if it looks up through a window; else u and v, or x and y, are exchanged";
        let measured = [-above_m, 0.0];
        findings.push(finding("camera-below-plane", Severity::Note, "plane", message, measured, fix));
    }
    findings
}

/// Returns the root of the mean squared distance of pixels from their middle.
fn image_extent(touches: &[Touch]) -> f64 {
    let n = touches.len() as f64;
    let middle = [0, 1].map(|axis| touches.iter().map(|touch| touch.pixel[axis]).sum::<f64>() / n);
    let square = |touch: &Touch| (touch.pixel[0] - middle[0]).powi(2) + (touch.pixel[1] - middle[1]).powi(2);
    (touches.iter().map(square).sum::<f64>() / n).sqrt()
}

/// Returns three digits of a number, however large or small.
fn significant(value: f64) -> String {
    if (1e-3..1e4).contains(&value.abs()) {
        let places = (2.0 - value.abs().log10().floor()).max(0.0) as usize;
        format!("{value:.places$}")
    } else {
        format!("{value:.2e}")
    }
}

/// Checks numbers that are stated of an object.
pub(crate) fn check_stated(
    height_m: Option<f64>,
    height_sigma_m: f64,
    angle_sigma_rad: f64,
) -> Result<(), RobotError> {
    let numbers = [
        ("height_m", height_m.unwrap_or(0.0), f64::NEG_INFINITY, "a height must be a finite number"),
        ("height_sigma_m", height_sigma_m, 0.0, "a standard deviation must not be negative"),
        ("sigma_phi_rad", angle_sigma_rad, 0.0, "a standard deviation must not be negative"),
    ];
    match numbers.into_iter().find(|(_, value, least, _)| !(value.is_finite() && *value >= *least)) {
        Some((option, value, _, need)) => Err(RobotError::BadOption { option, value, need }),
        None => Ok(()),
    }
}

/// Returns how high the camera is above the plane, along the base frame's z, in metres; `None` where that is not known.
fn camera_above_m(plane: &RobotPlane) -> Option<f64> {
    let [x, y, z] = plane.camera_in_base_m?;
    let [level, slope_x, slope_y] = plane.height_m;
    let [cx, cy] = plane.robot_centre_m;
    Some(z - level - slope_x * (x - cx) - slope_y * (y - cy))
}

/// Refuses a part that is as far from the plane as the camera, or beyond it.
pub(crate) fn check_height(plane: &RobotPlane, height_m: f64) -> Result<(), RobotError> {
    match camera_above_m(plane) {
        Some(camera_m) if height_m / camera_m >= 1.0 => Err(RobotError::AboveCamera { height_m, camera_m }),
        _ => Ok(()),
    }
}

/// Returns what is doubtful about where an object is seen, and where that puts it.
pub(crate) fn of_object(plane: &RobotPlane, pixels: &[[f64; 2]], at_m: [f64; 2]) -> Vec<Finding> {
    let mut findings = Vec::new();
    let size = plane.lens.as_ref().map(|lens| lens.image_size);
    let outside: Vec<[f64; 2]> = pixels.iter().copied().filter(|pixel| is_outside(*pixel, size)).collect();
    if let Some([u, v]) = outside.first() {
        let image = size.map_or("any image".to_owned(), |[w, h]| format!("the image of {w}x{h}"));
        let message = format!(
            "{} of {} pixels are outside {image}, such as ({u:.1}, {v:.1})",
            outside.len(),
            pixels.len()
        );
        let fix = "check the columns u_px and v_px, and the resolution at which the object was seen";
        let share = [outside.len() as f64, 0.0];
        findings.push(finding("object-outside-image", Severity::Fail, "object", message, share, fix));
    }
    let [cx, cy] = plane.robot_centre_m;
    let away = (at_m[0] - cx).hypot(at_m[1] - cy);
    let limit = BESIDE * plane.robot_scale_m;
    if away > limit {
        let message = format!(
            "it lies {:.1} mm from the middle of the touches, which are {:.1} mm from it themselves",
            1e3 * away,
            1e3 * plane.robot_scale_m
        );
        let fix = "touch points around the place where parts lie; the plane is extrapolated there, and a bend of it is \
                   not in the sigmas";
        findings.push(finding(
            "object-beside-touches",
            Severity::Caution,
            "object",
            message,
            [away, limit],
            fix,
        ));
    }
    findings
}

/// Returns what is doubtful about heights.
pub(crate) fn of_height(
    height_m: Option<f64>,
    height_sigma_m: f64,
    shift_per_height: Option<f64>,
    sigma_m: f64,
) -> Vec<Finding> {
    let caution = |code: &str, message: String, measured: [f64; 2], fix: &str| {
        vec![finding(code, Severity::Caution, "object", message, measured, fix)]
    };
    match (height_m, shift_per_height) {
        (None, Some(shift)) => caution(
            "height-unknown",
            format!(
                "the points are taken to lie in the plane; each mm above it would move them by {shift:.3} mm"
            ),
            [shift, 0.0],
            "state the height of the points above the plane",
        ),
        (Some(height), None) if height != 0.0 => caution(
            "height-ignored",
            format!(
                "the points are {:.2} mm above the plane, which moves them sideways by an amount that is not known \
                 without the camera's place; they are only moved up",
                1e3 * height
            ),
            [height.abs(), 0.0],
            "calibrate the plane with a calibrated camera",
        ),
        (Some(height), Some(shift)) if height_sigma_m == 0.0 && shift * height.abs() > 100.0 * sigma_m => {
            caution(
                "height-matters",
                format!(
                    "the height of {:.2} mm moves the object by {:.3} mm; an error of it counts {shift:.3} times",
                    1e3 * height,
                    1e3 * shift * height.abs()
                ),
                [shift * height.abs(), 100.0 * sigma_m],
                "state the sigma of the height as well",
            )
        }
        _ => Vec::new(),
    }
}
