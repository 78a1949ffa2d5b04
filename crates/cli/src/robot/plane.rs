//! `boresight robot plane`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use boresight::{
    Heights, KnownRig, PLANE_SCHEMA, PatternTouch, PlaneDocument, PlaneModel, PlaneOutcome, Pose,
    PoseConvention, PoseDirection, RobotTable, RotationColumns, RotationKind, TipKnowledge, Touch,
    TouchDocument, TouchLens, TouchOptions, TouchedPlane, TriedDocument, TriedModel, UnitQuaternion, Vector3,
    hash, pattern_procedure, plane_to_json, read_robot_job, robot_plane, verdict, write_atomically,
};
use clap::Args;
use serde::Deserialize;

use super::locate::is_job;
use crate::calibrate::{exit_code, tell_findings};
use crate::failure::{Failure, Reason};
use crate::figures::count;
use crate::streams::answer;
use crate::table::{aligned, row};

#[derive(Args, Debug)]
pub(crate) struct PlaneArguments {
    /// A folder or job file with a `[plane]` table, or a table of touches: name,u_px,v_px,x_mm,y_mm,z_mm
    /// (z may be left out; rx_deg,ry_deg,rz_deg, a rotation vector, or qx,qy,qz,qw, or r11 to r33, or angles such
    /// as a_deg,b_deg,c_deg or roll_deg,pitch_deg,yaw_deg with --touches-as make it poses of the flange)
    pub input: PathBuf,
    /// What angles of the flange mean, such as kuka-abc, fanuc-wpr or moving-zyx [default: the job's convention]
    #[arg(long, value_name = "CONVENTION")]
    pub touches_as: Option<PoseConvention>,
    /// The calibration of the camera, for a map free of distortion
    #[arg(long, value_name = "FILE")]
    pub calibration: Option<PathBuf>,
    /// The camera; may be left out where there is only one
    #[arg(long, value_name = "NAME")]
    pub camera: Option<String>,
    /// The standard deviation of a pixel coordinate [default: 0.1]
    #[arg(long, value_name = "PX")]
    pub sigma_px: Option<f64>,
    /// The standard deviation of a touched coordinate [default: estimated from the residuals]
    #[arg(long, value_name = "MM")]
    pub sigma_touch_mm: Option<f64>,
    /// The tip on the flange: its position, or unknown [default: 0,0,0]
    #[arg(long, value_name = "X,Y,Z|unknown", allow_hyphen_values = true)]
    pub tip_mm: Option<String>,
    /// similarity, affine, homography, undistorted-similarity, undistorted-affine,
    /// undistorted-homography, pose or auto [default: auto]
    #[arg(long, value_name = "NAME")]
    pub model: Option<String>,
    /// The folder for plane.json; made if it does not exist
    #[arg(short, long, value_name = "DIR", default_value = "out")]
    pub output: PathBuf,
    /// Print plane.json on stdout instead of the summary
    #[arg(long)]
    pub json: bool,
}

/// The table `[plane]` of a job.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct PlaneJob {
    calibration: Option<PathBuf>,
    camera: Option<String>,
    touches: Option<PathBuf>,
    pattern: Option<PathBuf>,
    sigma_px: Option<f64>,
    sigma_touch_mm: Option<f64>,
    tip_mm: Option<String>,
    model: Option<String>,
    convention: Option<String>,
}

/// Fits a plane, writes it and tells how good it is.
pub(crate) fn run(arguments: &PlaneArguments) -> Result<ExitCode, Failure> {
    let (job, folder) = if is_job(&arguments.input) {
        let job = read_robot_job::<PlaneJob>(&arguments.input, "plane")?;
        (job.table, job.folder)
    } else {
        (PlaneJob::default(), PathBuf::new())
    };
    let in_job = |path: &PathBuf| folder.join(path);
    let touches_file = match (&job.touches, is_job(&arguments.input)) {
        (Some(path), _) => in_job(path),
        (None, false) => arguments.input.clone(),
        (None, true) => {
            let message = format!("{}: [plane] names no touches", arguments.input.display());
            return Err(Failure::new(Reason::Usage, message).with_hint("add touches = \"touches.csv\""));
        }
    };
    let table = RobotTable::read(&touches_file)?;
    let (touches, heights) = read_touches(&table, convention(arguments, &job)?)?;
    let calibration = arguments.calibration.clone().or_else(|| job.calibration.as_ref().map(in_job));
    let rig = calibration.as_ref().map(|path| KnownRig::read(path)).transpose()?;
    let camera = rig.as_ref().map(|rig| rig.camera(arguments.camera.as_deref().or(job.camera.as_deref())));
    let camera = camera.transpose()?;
    let covariance = rig.as_ref().zip(camera).and_then(|(rig, camera)| rig.lens_covariance(camera));
    let lens = camera.map(|camera| TouchLens {
        name: &camera.name,
        camera: &camera.camera,
        covariance: covariance.as_ref(),
    });
    let options = TouchOptions {
        sigma_px: arguments.sigma_px.or(job.sigma_px).unwrap_or(0.1),
        sigma_touch_m: arguments.sigma_touch_mm.or(job.sigma_touch_mm).map(|sigma| 1e-3 * sigma),
        tip: tip(arguments.tip_mm.as_deref().or(job.tip_mm.as_deref()))?,
        heights,
        model: model(arguments.model.as_deref().or(job.model.as_deref()))?,
    };
    let mut outcome = robot_plane(&touches, lens, &options)?;
    let mut by_pattern = None;
    if let Some(pattern) = &job.pattern {
        let found = read_pattern(&in_job(pattern), &table, &touches)?;
        outcome.findings.extend(found.findings());
        by_pattern = Some(format!(
            "pattern    touched distances are {:.5} times its own, touches meet it to {:.3} mm",
            found.pattern.scale,
            1e3 * rms(found.pattern.residuals_m.iter().copied())
        ));
        outcome.chapter = found.chapter;
    }
    outcome.findings.sort_by_key(|finding| std::cmp::Reverse(finding.severity));

    let mut inputs = BTreeMap::new();
    for path in
        [Some(&touches_file), calibration.as_ref()].into_iter().flatten().filter(|path| path.is_file())
    {
        let unreadable = |error| Failure::new(Reason::Input, format!("{}: {error}", path.display()));
        let bytes = std::fs::read(path).map_err(unreadable)?;
        let name = path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        inputs.insert(name, hash(&bytes));
    }
    let document = document(&outcome, inputs);
    let bytes = plane_to_json(&document)?;
    let file = arguments.output.join("plane.json");
    write_atomically(&file, &bytes)?;
    tell_findings(&outcome.findings);
    if arguments.json {
        answer(&bytes)?;
    } else {
        let pattern = by_pattern.map_or_else(String::new, |line| line + "\n");
        answer(format!("{}{pattern}\nwritten: {}\n", text(&outcome, &options), file.display()).as_bytes())?;
    }
    Ok(exit_code(verdict(&outcome.findings)))
}

/// Returns the touches of a table, and whether they have heights.
fn read_touches(
    table: &RobotTable,
    convention: Option<PoseConvention>,
) -> Result<(Vec<Touch>, Heights), Failure> {
    let (u, v) = (table.pixels("u")?, table.pixels("v")?);
    let (x, y) = (table.lengths_m("x")?, table.lengths_m("y")?);
    let heights = if table.has("z") { Heights::Known } else { Heights::Unknown };
    let z = match heights {
        Heights::Known => table.lengths_m("z")?,
        Heights::Unknown => vec![Some(0.0); table.len()],
    };
    let turns = turns(table, convention)?;
    let direction = convention.map_or(PoseDirection::BaseFromFlange, |convention| convention.direction);
    if direction == PoseDirection::FlangeFromBase && heights == Heights::Unknown {
        let message = "the touches are of the base as the flange sees it, and have no z";
        return Err(
            Failure::new(Reason::Usage, message).with_hint("add a column z_mm, or leave :inverse out")
        );
    }
    let mut touches = Vec::new();
    for (i, name) in table.names().into_iter().enumerate() {
        let value = |column: &[Option<f64>], name: &str| column[i].ok_or_else(|| table.missing(i, name));
        let rotation = match &turns {
            Some(turns) => turns.of_row(table, i, &name)?,
            None => Pose::identity().rotation,
        };
        let place = Vector3::new(value(&x, "x")?, value(&y, "y")?, value(&z, "z")?);
        let pixel = [value(&u, "u_px")?, value(&v, "v_px")?];
        let written = Pose::new(rotation, place);
        let base_from_flange = match direction {
            PoseDirection::BaseFromFlange => written,
            PoseDirection::FlangeFromBase => written.inverse(),
        };
        touches.push(Touch { name, pixel, base_from_flange });
    }
    Ok((touches, heights))
}

/// The flange's rotations in a table of touches.
struct Turns {
    kind: RotationKind,
    names: &'static [&'static str],
    /// Angles in radians, or the numbers of a quaternion or a matrix.
    columns: Vec<Vec<Option<f64>>>,
}

impl Turns {
    fn of_row(&self, table: &RobotTable, row: usize, touch: &str) -> Result<UnitQuaternion<f64>, Failure> {
        let number = |(column, name): (&Vec<Option<f64>>, &&str)| {
            column[row].ok_or_else(|| Failure::from(table.missing(row, name)))
        };
        let numbers: Vec<f64> = self.columns.iter().zip(self.names).map(number).collect::<Result<_, _>>()?;
        self.kind.rotation(&numbers).ok_or_else(|| {
            let message = format!("touch {touch}: its numbers are no rotation read as {}", self.kind);
            Failure::new(Reason::Input, message).with_hint("check the order of the columns, and --touches-as")
        })
    }
}

/// Returns the columns of rotations, and what their numbers mean; `None` if there are none.
fn turns(table: &RobotTable, convention: Option<PoseConvention>) -> Result<Option<Turns>, Failure> {
    let present = |names: &[&str]| names.iter().any(|name| table.has(name));
    let Some(named) = RotationColumns::ALL.into_iter().find(|columns| present(columns.names())) else {
        return match convention {
            None => Ok(None),
            Some(convention) => {
                let message = format!("the touches have no rotations that could be read as {convention}");
                Err(Failure::new(Reason::Usage, message)
                    .with_hint("add their columns, such as a_deg,b_deg,c_deg, or leave --touches-as out"))
            }
        };
    };
    let names = named.names();
    let kind = match (convention.map(|convention| convention.rotation), named.kind()) {
        // Names say which number of a quaternion or a matrix is which, in whatever order the maker writes them.
        (said, Some(own)) if said.is_none_or(|said| said.number_count() == own.number_count()) => {
            said.filter(|said| said.has_angles()).unwrap_or(own)
        }
        (Some(said), None) if said.has_angles() => said,
        (Some(said), _) => {
            let message = format!("the touches have {}, which cannot be read as {said}", names.join(", "));
            return Err(Failure::new(Reason::Usage, message)
                .with_hint("state the convention of these columns with --touches-as, or leave it out"));
        }
        (None, _) => {
            let message =
                format!("the touches have angles {}, and nothing says what they mean", names.join(", "));
            return Err(Failure::new(Reason::Usage, message)
                .with_hint("add convention = \"kuka-abc\" (or another) to [plane], or --touches-as"));
        }
    };
    let numbers = |name: &'static str| match kind.has_angles() {
        true => table.angles_rad(name),
        false => table.numbers(name),
    };
    let columns = names.iter().map(|name| numbers(name)).collect::<Result<_, _>>()?;
    Ok(Some(Turns { kind, names, columns }))
}

/// Returns what the angles of touches mean, where it is said.
fn convention(arguments: &PlaneArguments, job: &PlaneJob) -> Result<Option<PoseConvention>, Failure> {
    if arguments.touches_as.is_some() {
        return Ok(arguments.touches_as);
    }
    let stated = job.convention.as_ref().map(|text| text.parse::<PoseConvention>()).transpose();
    stated.map_err(|error| Failure::new(Reason::Usage, format!("[plane] convention: {error}")))
}

/// Does the textbook's procedure with the pattern: all its seen points, and which of them were touched.
fn read_pattern(
    path: &Path,
    touched: &RobotTable,
    touches: &[Touch],
) -> Result<boresight::PatternOutcome, Failure> {
    let table = RobotTable::read(path)?;
    let columns = (table.lengths_m("x")?, table.lengths_m("y")?, table.pixels("u")?, table.pixels("v")?);
    let mut seen = Vec::new();
    for i in 0..table.len() {
        let value = |column: &[Option<f64>], name: &str| column[i].ok_or_else(|| table.missing(i, name));
        let (x, y, u, v) = &columns;
        seen.push(([value(x, "x")?, value(y, "y")?], [value(u, "u_px")?, value(v, "v_px")?]));
    }
    let names = table.names();
    let mut on_pattern = Vec::new();
    for (name, touch) in touched.names().iter().zip(touches) {
        let Some(i) = names.iter().position(|known| known == name) else {
            let message = format!("{}: the pattern has no point `{name}`, which was touched", path.display());
            return Err(Failure::new(Reason::Input, message)
                .with_hint("touches and points of the pattern are paired by their column name"));
        };
        let touched_m = touch.base_from_flange.translation.into();
        on_pattern.push(PatternTouch { point_in_pattern_m: seen[i].0, pixel: seen[i].1, touched_m });
    }
    pattern_procedure(&seen, &on_pattern).ok_or_else(|| {
        Failure::new(Reason::Solve, format!("{}: the points of the pattern coincide", path.display()))
    })
}

fn tip(text: Option<&str>) -> Result<TipKnowledge, Failure> {
    let Some(text) = text else { return Ok(TipKnowledge::Known([0.0; 3])) };
    if text == "unknown" {
        return Ok(TipKnowledge::Unknown);
    }
    let numbers: Vec<f64> = text.split(',').filter_map(|word| word.trim().parse().ok()).collect();
    match numbers[..] {
        [x, y, z] if text.split(',').count() == 3 && numbers.iter().all(|number| number.is_finite()) => {
            Ok(TipKnowledge::Known([x, y, z].map(|mm: f64| 1e-3 * mm)))
        }
        _ => Err(Failure::new(Reason::Usage, format!("--tip-mm {text}: it is neither x,y,z nor unknown"))),
    }
}

fn model(name: Option<&str>) -> Result<Option<PlaneModel>, Failure> {
    let Some(name) = name.filter(|name| *name != "auto") else { return Ok(None) };
    let found = PlaneModel::ALL.into_iter().find(|model| model.name() == name);
    found.map(Some).ok_or_else(|| {
        let known: Vec<&str> = PlaneModel::ALL.iter().map(|model| model.name()).collect();
        Failure::new(Reason::Usage, format!("there is no model `{name}` of a plane"))
            .with_hint(format!("the models are auto, {}", known.join(", ")))
    })
}

fn rms(errors: impl ExactSizeIterator<Item = [f64; 2]>) -> f64 {
    let n = errors.len().max(1) as f64;
    (errors.map(|[x, y]| x * x + y * y).sum::<f64>() / n).sqrt()
}

fn document(outcome: &PlaneOutcome, inputs: BTreeMap<String, String>) -> PlaneDocument {
    let PlaneOutcome { touched, chapter, findings } = outcome;
    let matrix = &chapter.image_in_robot;
    PlaneDocument {
        schema: PLANE_SCHEMA.to_owned(),
        plane: touched.plane.clone(),
        lambda_m_per_px: chapter.lambda_m_per_px,
        image_in_robot: [0, 1, 2, 3].map(|i| [0, 1, 2, 3].map(|j| matrix[(i, j)])),
        textbook_rms_m: chapter.rms_m,
        tried: touched
            .tried
            .iter()
            .map(|tried| TriedDocument {
                model: tried.model,
                left_out_rms_m: tried.left_out_rms_m,
                rms_m: tried.rms_m,
            })
            .collect(),
        touches: touched
            .touches
            .iter()
            .map(|touch| TouchDocument {
                name: touch.name.clone(),
                residual_m: touch.residual_m,
                left_out_m: touch.left_out_m,
            })
            .collect(),
        noise_factor: touched.noise_factor,
        degrees_of_freedom: touched.degrees_of_freedom,
        sigma_touch_m: touched.sigma_touch_m,
        findings: findings.clone(),
        version: boresight::VERSION.to_owned(),
        inputs,
    }
}

/// Says why the model is the one it is.
fn how_chosen(touched: &TouchedPlane, options: &TouchOptions) -> &'static str {
    let error = |tried: &TriedModel| tried.left_out_rms_m.unwrap_or(f64::INFINITY);
    let of_chosen = touched.tried.iter().find(|tried| tried.model == touched.plane.model).map(error);
    let least = touched.tried.iter().map(error).fold(f64::INFINITY, f64::min);
    match (options.model, of_chosen) {
        (Some(_), _) => "as asked for",
        (None, Some(own)) if own > least => {
            "of the models that predict left-out touches alike, the one with the fewest unknowns"
        }
        _ => "it predicts left-out touches best",
    }
}

fn text(outcome: &PlaneOutcome, options: &TouchOptions) -> String {
    let PlaneOutcome { touched, chapter, .. } = outcome;
    let plane = &touched.plane;
    let mm = |metres: Option<f64>| metres.map_or("-".to_owned(), |metres| format!("{:.4}", 1e3 * metres));
    let how = how_chosen(touched, options);
    let mut text = format!(
        "{}; model {}: {how}\n\n",
        count(touched.touches.len(), "touch").replace("touchs", "touches"),
        plane.model.name()
    );
    let mut rows = vec![row(["model", "left out mm", "fitted mm"])];
    for tried in &touched.tried {
        rows.push(vec![tried.model.name().to_owned(), mm(tried.left_out_rms_m), mm(tried.rms_m)]);
    }
    text.push_str(&aligned(&rows));
    text.push_str(
        "root mean square distance in the plane: of touches left out of the fit, and of those in it\n\n",
    );
    let mut rows = vec![row(["touch", "dx mm", "dy mm", "dz mm", "left out mm"])];
    for touch in &touched.touches {
        let mut cells = vec![touch.name.clone()];
        cells.extend(touch.residual_m.iter().map(|residual| format!("{:.4}", 1e3 * residual)));
        cells.push(mm(touch.left_out_m.map(|[x, y]| x.hypot(y))));
        rows.push(cells);
    }
    text.push_str(&aligned(&rows));
    let [height, slope_x, slope_y] = plane.height_m;
    text.push_str(&format!(
        "\nplane      {:.3} mm high at ({:.3}, {:.3}) mm, tilted by {:.4} deg\n",
        1e3 * height,
        1e3 * plane.robot_centre_m[0],
        1e3 * plane.robot_centre_m[1],
        slope_x.hypot(slope_y).atan().to_degrees()
    ));
    if let Some([x, y, z]) = plane.camera_in_base_m {
        text.push_str(&format!(
            "camera     at ({:.2}, {:.2}, {:.2}) mm in the base frame\n",
            1e3 * x,
            1e3 * y,
            1e3 * z
        ));
    }
    if let Some([x, y, z]) = plane.tip_in_flange_m {
        text.push_str(&format!(
            "tip        at ({:.3}, {:.3}, {:.3}) mm on the flange\n",
            1e3 * x,
            1e3 * y,
            1e3 * z
        ));
    }
    let factor = touched.noise_factor.map_or("-".to_owned(), |factor| format!("{factor:.3}"));
    text.push_str(&format!(
        "noise      {factor} times the stated sigmas, {} degrees of freedom; touches are good to {:.4} mm\n",
        touched.degrees_of_freedom,
        1e3 * touched.sigma_touch_m
    ));
    let facing = if plane.facing > 0.0 { "along" } else { "against" };
    text.push_str(&format!(
        "textbook   lambda {:.6} mm/px, image z {facing} the robot's z, misses touches by {:.4} mm; Hi in mm:\n",
        1e3 * chapter.lambda_m_per_px,
        1e3 * chapter.rms_m
    ));
    let mut rows = Vec::new();
    for i in 0..4 {
        let cell = |j: usize| {
            let unit = if j == 3 && i < 3 { 1e3 } else { 1.0 };
            format!("{:.6}", unit * chapter.image_in_robot[(i, j)])
        };
        rows.push([vec![String::new()], (0..4).map(cell).collect()].concat());
    }
    text.push_str(&aligned(&rows));
    text
}
