//! From touched points to a robot's plane, and from the plane to the pose of an object: Eqs 8.23 to 8.30.

use boresight_adjust::{
    Heights, TipKnowledge, Touch, TouchLens, TouchOptions, TouchedPlane, contradiction, plane_position,
    plane_spread, touched_plane,
};
use boresight_camera::Camera;
use boresight_camera::textbook::robot_plane::{
    Facing, TouchedPattern, facing_matrix, image_in_robot, planar_pose, pose_in_image, touched_pattern,
};
use boresight_data::{Finding, PlaneModel, RobotPlane, Severity};
use boresight_geometry::nalgebra::{DMatrix, Matrix4};

use crate::error::Error;
use crate::plane_sanity;
use crate::robot_error::RobotError;

/// A touched plane with what is doubtful about it.
#[derive(Clone, Debug, PartialEq)]
pub struct PlaneOutcome {
    /// The plane.
    pub touched: TouchedPlane,
    /// The textbook's own result.
    pub chapter: Chapter,
    /// What is doubtful.
    pub findings: Vec<Finding>,
}

/// The textbook's procedure, as it stands: one factor from pixels to metres, and turns about one axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Chapter {
    /// λ, in metres per pixel.
    pub lambda_m_per_px: f64,
    /// The pose of the image frame in the robot's frame, `Hi`, Eq. 8.27.
    pub image_in_robot: Matrix4<f64>,
    /// Whether the image's z axis points along the robot's.
    pub facing: Facing,
    /// The root of the mean squared distance between touches and where it puts their pixels, in metres.
    pub rms_m: f64,
}

/// What a pattern with marked points adds: λ from its known size.
#[derive(Clone, Debug, PartialEq)]
pub struct PatternOutcome {
    /// The textbook's result with λ and `iHcp` from the pattern, and `Hcp` from the touches.
    pub chapter: Chapter,
    /// `Hcp` and how touches meet it; its scale holds λ against the touched distances.
    pub pattern: TouchedPattern,
    /// `iHcp`.
    pub pattern_in_image: Matrix4<f64>,
}

/// A touched point of a pattern.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PatternTouch {
    /// Where it is on the pattern, in metres.
    pub point_in_pattern_m: [f64; 2],
    /// Where it is seen.
    pub pixel: [f64; 2],
    /// Where it was touched, in metres.
    pub touched_m: [f64; 3],
}

/// The farthest that λ may be from what touches say, as a share.
const LAMBDA_LIMIT: f64 = 0.01;

/// A touch whose left-out error is this many times the usual one stands out.
const OUTLYING: f64 = 4.0;

/// A map that is worse than a perpendicular, undistorted one by this factor of its errors says so.
const NOT_PARALLEL: f64 = 2.0;

/// Fits a plane to touches and judges it.
pub fn robot_plane(
    touches: &[Touch],
    lens: Option<TouchLens<'_>>,
    options: &TouchOptions,
) -> Result<PlaneOutcome, Error> {
    for (option, value) in [("sigma_px", Some(options.sigma_px)), ("sigma_touch_m", options.sigma_touch_m)] {
        if let Some(value) = value.filter(|value| !(value.is_finite() && *value > 0.0)) {
            let need = "a standard deviation must be positive";
            return Err(RobotError::BadOption { option, value, need }.into());
        }
    }
    let touched = touched_plane(touches, lens, options).map_err(RobotError::from)?;
    let mut findings = findings(&touched, options);
    findings.extend(plane_sanity::of_touches(&touched, touches, lens, options));
    let parallel = TouchOptions { model: Some(PlaneModel::Similarity), ..*options };
    let parallel = touched_plane(touches, None, &parallel).map_err(RobotError::from)?;
    Ok(PlaneOutcome { chapter: chapter_of(&parallel), findings, touched })
}

/// Returns the textbook's λ and `Hi` of a similarity of pixels.
fn chapter_of(parallel: &TouchedPlane) -> Chapter {
    let plane = &parallel.plane;
    let [a, b] = [plane.map[0], plane.map[1]];
    let lambda = a.hypot(b) * plane.robot_scale_m / plane.image_scale;
    let facing = if plane.facing > 0.0 { Facing::Same } else { Facing::Opposite };
    // The robot's position of the pixel (0, 0), which is the origin of the image frame.
    let origin = plane_position(plane, None, [0.0, 0.0], 0.0).map_or([f64::NAN; 3], |at| at.in_base_m);
    let squares =
        parallel.touches.iter().map(|touch| touch.residual_m[0].powi(2) + touch.residual_m[1].powi(2));
    let rms_m = (squares.sum::<f64>() / parallel.touches.len().max(1) as f64).sqrt();
    // λ is a part of iHcp, so that Hi itself is a turn and a shift.
    let origin = [origin[0], origin[1], plane.height_m[0]];
    Chapter {
        lambda_m_per_px: lambda,
        image_in_robot: planar_pose(b.atan2(a), origin) * facing_matrix(facing),
        facing,
        rms_m,
    }
}

/// Does what the chapter says with a pattern: λ and `iHcp` from where all its points are seen, `Hcp` from
/// the touched ones, `Hi = Hcp iHcp⁻¹`. `None` where points coincide.
pub fn pattern_procedure(seen: &[([f64; 2], [f64; 2])], touches: &[PatternTouch]) -> Option<PatternOutcome> {
    let (points, pixels): (Vec<[f64; 2]>, Vec<[f64; 2]>) = seen.iter().copied().unzip();
    let pixels: Vec<[f64; 3]> = pixels.iter().map(|[u, v]| [*u, *v, 0.0]).collect();
    // The pattern in the image: a turn, and a scale in pixels per metre.
    let in_image = touched_pattern(&points, &pixels, Facing::Same)?;
    let lambda_m_per_px = 1.0 / in_image.scale;
    // touched_pattern leaves the scale at one, so that the origin is found anew.
    let (sin, cos) = in_image.angle_rad.sin_cos();
    let n = seen.len() as f64;
    let origin = [0, 1].map(|axis| {
        let turned = |[x, y]: [f64; 2]| if axis == 0 { cos * x - sin * y } else { sin * x + cos * y };
        seen.iter().map(|(point, pixel)| pixel[axis] - in_image.scale * turned(*point)).sum::<f64>() / n
    });
    let pattern_in_image = pose_in_image(in_image.angle_rad, lambda_m_per_px, origin);
    let on_pattern: Vec<[f64; 2]> = touches.iter().map(|touch| touch.point_in_pattern_m).collect();
    let touched: Vec<[f64; 3]> = touches.iter().map(|touch| touch.touched_m).collect();
    let square =
        |pattern: &TouchedPattern| pattern.residuals_m.iter().map(|[x, y]| x * x + y * y).sum::<f64>();
    let [same, opposite] =
        [Facing::Same, Facing::Opposite].map(|facing| touched_pattern(&on_pattern, &touched, facing));
    let (same, opposite) = (same?, opposite?);
    let (facing, pattern) =
        if square(&opposite) < square(&same) { (Facing::Opposite, opposite) } else { (Facing::Same, same) };
    let image_in_robot = image_in_robot(&pattern.matrix(facing), &pattern_in_image)?;
    let squares = touches.iter().map(|touch| {
        let at = image_in_robot * pose_in_image(0.0, lambda_m_per_px, touch.pixel).column(3);
        (at.x - touch.touched_m[0]).powi(2) + (at.y - touch.touched_m[1]).powi(2)
    });
    let rms_m = (squares.sum::<f64>() / touches.len().max(1) as f64).sqrt();
    let chapter = Chapter { lambda_m_per_px, image_in_robot, facing, rms_m };
    Some(PatternOutcome { chapter, pattern, pattern_in_image })
}

impl PatternOutcome {
    /// Returns what is doubtful: a λ that the touches contradict.
    pub fn findings(&self) -> Vec<Finding> {
        let off = self.pattern.scale - 1.0;
        if off.abs() <= LAMBDA_LIMIT {
            return Vec::new();
        }
        vec![Finding {
            code: "lambda-mismatch".to_owned(),
            severity: Severity::Fail,
            place: "pattern".to_owned(),
            message: format!("touched distances are {:.4} times those of the pattern", self.pattern.scale),
            measured: Some(off.abs()),
            limit: Some(LAMBDA_LIMIT),
            fix: "check the units of robot and pattern, and the size of its fields".to_owned(),
        }]
    }
}

/// Returns what is doubtful about a plane.
fn findings(touched: &TouchedPlane, options: &TouchOptions) -> Vec<Finding> {
    let mut findings = Vec::new();
    let mut add = |code: &str, severity, place: String, message, measured, limit, fix: &str| {
        let (code, fix) = (code.to_owned(), fix.to_owned());
        findings.push(Finding {
            code,
            severity,
            place,
            message,
            measured: Some(measured),
            limit: Some(limit),
            fix,
        });
    };
    let length = |[x, y]: [f64; 2]| x.hypot(y);
    let left_out: Vec<f64> =
        touched.touches.iter().filter_map(|touch| touch.left_out_m.map(length)).collect();
    let mut sorted = left_out.clone();
    sorted.sort_by(f64::total_cmp);
    let median = sorted.get(sorted.len() / 2).copied().unwrap_or(f64::INFINITY);
    let limit = OUTLYING * median.max(touched.sigma_touch_m);
    for touch in &touched.touches {
        let Some(error) = touch.left_out_m.map(length).filter(|error| *error > limit) else { continue };
        let message = format!(
            "{:.3} mm from where the other touches put it; the usual touch is {:.3} mm off",
            1e3 * error,
            1e3 * median
        );
        let fix = "touch it again; is it paired with the right pixel?";
        add("outlying-touch", Severity::Caution, format!("touch {}", touch.name), message, error, limit, fix);
    }
    let height_limit = 5.0 * touched.sigma_touch_m;
    for touch in touched.touches.iter().filter(|touch| touch.residual_m[2].abs() > height_limit) {
        let message =
            format!("touched {:.3} mm off the plane of all touches", 1e3 * touch.residual_m[2].abs());
        let fix = "was the tip pressed into the sheet, or worn? touch it again";
        let place = format!("touch {}", touch.name);
        add(
            "height-of-touch",
            Severity::Caution,
            place,
            message,
            touch.residual_m[2].abs(),
            height_limit,
            fix,
        );
    }
    if let (Some(_), Some(factor)) = (options.sigma_touch_m, touched.noise_factor) {
        let most = contradiction(touched.degrees_of_freedom);
        if factor > most {
            let message = format!(
                "the residuals are {factor:.1} times what the stated sigmas explain; the covariance was widened by it"
            );
            let fix = "state the robot's true accuracy, mend outlying touches, or use a calibrated lens";
            add(
                "touches-worse-than-stated",
                Severity::Caution,
                "touches".to_owned(),
                message,
                factor,
                most,
                fix,
            );
        }
    }
    let error_of = |model: PlaneModel| {
        touched.tried.iter().find(|tried| tried.model == model).and_then(|tried| tried.left_out_rms_m)
    };
    if let (Some(chosen), Some(parallel)) = (error_of(touched.plane.model), error_of(PlaneModel::Similarity))
        && parallel > NOT_PARALLEL * chosen
    {
        let message = format!(
            "taking the image plane for parallel to the robot's predicts touches to {:.3} mm, model {} to {:.3} mm",
            1e3 * parallel,
            touched.plane.model.name(),
            1e3 * chosen
        );
        let fix = "nothing, as long as this plane is used and not the textbook's Hi";
        add(
            "image-not-parallel",
            Severity::Note,
            "plane".to_owned(),
            message,
            parallel / chosen,
            NOT_PARALLEL,
            fix,
        );
    }
    if touched.degrees_of_freedom < 6 {
        let message = format!(
            "{} touches leave {} degrees of freedom",
            touched.touches.len(),
            touched.degrees_of_freedom
        );
        let fix = "touch nine points, over the whole area where parts will lie";
        let dof = touched.degrees_of_freedom as f64;
        add("few-touches", Severity::Caution, "touches".to_owned(), message, dof, 6.0, fix);
    }
    if options.tip == TipKnowledge::Unknown && touched.tip_directions < 3 {
        let message = "the flange turned about one axis only: the tip's length along it is not known, and the plane's height with it".to_owned();
        let fix = "tilt the flange by 30 degrees in some touches if heights matter";
        add(
            "tip-partly-open",
            Severity::Caution,
            "tip".to_owned(),
            message,
            touched.tip_directions as f64,
            3.0,
            fix,
        );
    }
    if options.heights == Heights::Unknown {
        let message = "touches have no heights: the plane is taken for z = 0 of the table".to_owned();
        add(
            "no-heights",
            Severity::Note,
            "touches".to_owned(),
            message,
            0.0,
            0.0,
            "give z as well if parts have a height",
        );
    }
    findings
}

/// How an object is seen in the image.
#[derive(Clone, Debug, PartialEq)]
pub enum ObjectSeen {
    /// Its origin, and the turn of its x axis from the image's u towards v, in radians: Eqs 8.28 and 8.29.
    Origin {
        /// Where its origin is seen.
        pixel: [f64; 2],
        /// The angle.
        angle_rad: f64,
        /// The sigma of the angle.
        angle_sigma_rad: f64,
    },
    /// Two or more of its points: their positions in its own plane, in metres, and where they are seen.
    Points(Vec<([f64; 2], [f64; 2])>),
}

/// The pose of an object in the robot's base frame.
#[derive(Clone, Debug, PartialEq)]
pub struct PlacedObject {
    /// `Ho`: a turn about the base frame's z axis, and a position in metres; Eq. 8.30.
    pub object_in_robot: Matrix4<f64>,
    /// x, y, z in metres and the turn in radians.
    pub values: [f64; 4],
    /// Their covariance, row by row.
    pub covariance: DMatrix<f64>,
    /// How far each metre of height moves the object sideways, in metres; `None` where the camera's
    /// place is not known.
    pub shift_per_height: Option<f64>,
    /// By how much the points fail to fit, as a root mean square in metres; `None` for an origin and angle.
    pub rms_m: Option<f64>,
    /// What is doubtful.
    pub findings: Vec<Finding>,
}

/// Returns where an object is, whose seen points are `height_m` above the plane, with a sigma of its own.
///
/// `None` for the height says that nothing is known of it, and the plane's is taken.
pub fn place_object(
    plane: &RobotPlane,
    seen: &ObjectSeen,
    height_m: Option<f64>,
    height_sigma_m: f64,
    sigma_px: f64,
) -> Result<PlacedObject, Error> {
    if !(sigma_px.is_finite() && sigma_px > 0.0) {
        let need = "the standard deviation of a pixel must be positive";
        return Err(RobotError::BadOption { option: "sigma_px", value: sigma_px, need }.into());
    }
    let angle_sigma_rad = match seen {
        ObjectSeen::Origin { angle_sigma_rad, .. } => *angle_sigma_rad,
        ObjectSeen::Points(_) => 0.0,
    };
    plane_sanity::check_stated(height_m, height_sigma_m, angle_sigma_rad)?;
    let lens = lens_of(plane)?;
    let height = height_m.unwrap_or(0.0);
    plane_sanity::check_height(plane, height)?;
    // Everything measured, in one row: pixels, the angle where it is given, and the height.
    let (inputs, sigmas) = match seen {
        ObjectSeen::Origin { pixel, angle_rad, angle_sigma_rad } => {
            (vec![pixel[0], pixel[1], *angle_rad], vec![sigma_px, sigma_px, *angle_sigma_rad])
        }
        ObjectSeen::Points(points) if points.len() < 2 => {
            return Err(
                RobotError::TooFew { what: "points of the object", found: points.len(), need: 2 }.into()
            );
        }
        ObjectSeen::Points(points) => {
            (points.iter().flat_map(|(_, pixel)| *pixel).collect(), vec![sigma_px; 2 * points.len()])
        }
    };
    let inputs: Vec<f64> = inputs.into_iter().chain([height]).collect();
    let sigmas: Vec<f64> = sigmas.into_iter().chain([height_sigma_m]).collect();
    let evaluate =
        |plane: &RobotPlane, lens: Option<&Camera>, inputs: &[f64]| placed(plane, lens, seen, inputs);
    let no_place = || Error::from(RobotError::NoPlace);
    let (values, rms_m) = evaluate(plane, lens.as_ref(), &inputs).ok_or_else(no_place)?;
    // Angles are compared near the found one, not across the cut at half a turn.
    let near = |mut found: [f64; 4]| {
        found[3] = values[3]
            + (found[3] - values[3] + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU)
            - std::f64::consts::PI;
        found.to_vec()
    };
    let by_plane = plane_spread(plane, lens.as_ref(), &|plane, lens| {
        evaluate(plane, lens, &inputs).map(|(found, _)| near(found))
    });
    let mut covariance = by_plane.ok_or_else(no_place)?;
    for (i, sigma) in sigmas.iter().enumerate().filter(|(_, sigma)| **sigma > 0.0) {
        let step = 0.1 * sigma;
        let at = |step: f64| {
            let mut moved = inputs.clone();
            moved[i] += step;
            evaluate(plane, lens.as_ref(), &moved).map(|(found, _)| near(found))
        };
        let (up, down) = (at(step).ok_or_else(no_place)?, at(-step).ok_or_else(no_place)?);
        let gain: Vec<f64> = up.iter().zip(&down).map(|(up, down)| (up - down) / 0.2).collect();
        covariance += DMatrix::from_fn(4, 4, |a, b| gain[a] * gain[b]);
    }
    let facing = if plane.facing > 0.0 { Facing::Same } else { Facing::Opposite };
    let object_in_robot = planar_pose(values[3], [values[0], values[1], values[2]]) * facing_matrix(facing);
    let first = [inputs[0], inputs[1]];
    let shift_per_height = plane_position(plane, lens.as_ref(), first, height)
        .and_then(|at| at.shift_per_height)
        .map(|[x, y]| x.hypot(y));
    let sigma_m = covariance[(0, 0)].max(covariance[(1, 1)]).sqrt();
    let mut findings = plane_sanity::of_height(height_m, height_sigma_m, shift_per_height, sigma_m);
    let pixels = match seen {
        ObjectSeen::Origin { pixel, .. } => vec![*pixel],
        ObjectSeen::Points(points) => points.iter().map(|(_, pixel)| *pixel).collect(),
    };
    findings.extend(plane_sanity::of_object(plane, &pixels, [values[0], values[1]]));
    if let Some(rms_m) = rms_m.filter(|rms_m| *rms_m > 5.0 * sigma_m) {
        findings.push(Finding {
            code: "object-misfit".to_owned(),
            severity: Severity::Caution,
            place: "object".to_owned(),
            message: format!("the points fit the object to {:.3} mm only", 1e3 * rms_m),
            measured: Some(rms_m),
            limit: Some(5.0 * sigma_m),
            fix: "check the object's points, their order, their height and their unit".to_owned(),
        });
    }
    Ok(PlacedObject { object_in_robot, values, covariance, shift_per_height, rms_m, findings })
}

/// Returns x, y, z and turn of an object, and how well its points fit.
fn placed(
    plane: &RobotPlane,
    lens: Option<&Camera>,
    seen: &ObjectSeen,
    inputs: &[f64],
) -> Option<([f64; 4], Option<f64>)> {
    let height = inputs[inputs.len() - 1];
    let at = |pixel: [f64; 2]| Some(plane_position(plane, lens, pixel, height)?.in_base_m);
    match seen {
        ObjectSeen::Origin { .. } => {
            let origin = at([inputs[0], inputs[1]])?;
            // The direction is that over a pixel, to both sides.
            let (sin, cos) = inputs[2].sin_cos();
            let [ahead, behind] =
                [0.5, -0.5].map(|step| at([inputs[0] + step * cos, inputs[1] + step * sin]));
            let (ahead, behind) = (ahead?, behind?);
            let turn = (ahead[1] - behind[1]).atan2(ahead[0] - behind[0]);
            Some(([origin[0], origin[1], origin[2], turn], None))
        }
        ObjectSeen::Points(points) => {
            let model: Vec<[f64; 2]> = points.iter().map(|(point, _)| *point).collect();
            let positions: Option<Vec<[f64; 3]>> =
                (0..points.len()).map(|i| at([inputs[2 * i], inputs[2 * i + 1]])).collect();
            let facing = if plane.facing > 0.0 { Facing::Same } else { Facing::Opposite };
            let found = touched_pattern(&model, &positions?, facing)?;
            let square: f64 = found.residuals_m.iter().flatten().map(|residual| residual * residual).sum();
            let rms_m = (square / points.len() as f64).sqrt();
            let [x, y, z] = found.translation_m;
            Some(([x, y, z, found.angle_rad], Some(rms_m)))
        }
    }
}

/// Returns the lens that a plane keeps.
pub fn lens_of(plane: &RobotPlane) -> Result<Option<Camera>, Error> {
    let lens = plane.lens.as_ref();
    lens.map(|lens| Ok(Camera::new(lens.model.parse()?, lens.params.clone(), lens.image_size)?)).transpose()
}
