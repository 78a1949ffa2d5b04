//! `boresight robot pose`.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use boresight::{
    Finding, ObjectSeen, PlacedObject, RobotTable, place_object, read_plane, read_robot_job, verdict,
};
use clap::Args;
use serde::Deserialize;
use serde_json::{Value, json};

use super::locate::is_job;
use crate::calibrate::{exit_code, tell_findings};
use crate::failure::{Failure, Reason};
use crate::figures::with_sigma;
use crate::streams::answer;
use crate::table::{aligned, row};

#[derive(Args, Debug)]
pub(crate) struct PoseArguments {
    /// A folder or job file with a `[pose]` table, or a table of objects: name,u_px,v_px,phi_deg; with
    /// x_mm,y_mm in place of phi_deg, the rows of one name are points of one object
    pub input: PathBuf,
    /// The plane.json that `boresight robot plane` wrote, or its folder
    #[arg(long, value_name = "FILE")]
    pub plane: Option<PathBuf>,
    /// The standard deviation of a pixel coordinate [default: 0.1]
    #[arg(long, value_name = "PX")]
    pub sigma_px: Option<f64>,
    /// The standard deviation of an angle in the image [default: 0.1]
    #[arg(long, value_name = "DEG")]
    pub sigma_phi_deg: Option<f64>,
    /// The height of the seen points above the plane, unless the table has a column height_mm
    #[arg(long, value_name = "MM", allow_hyphen_values = true)]
    pub height_mm: Option<f64>,
    /// The standard deviation of the height [default: 0]
    #[arg(long, value_name = "MM")]
    pub height_sigma_mm: Option<f64>,
    /// Print one JSON document
    #[arg(long)]
    pub json: bool,
}

/// The table `[pose]` of a job.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct PoseJob {
    plane: Option<PathBuf>,
    objects: Option<PathBuf>,
    sigma_px: Option<f64>,
    sigma_phi_deg: Option<f64>,
    height_mm: Option<f64>,
    height_sigma_mm: Option<f64>,
}

/// An object of the table.
struct Asked {
    name: String,
    seen: ObjectSeen,
    height_m: Option<f64>,
}

/// Prints where objects are in the robot's base frame.
pub(crate) fn run(arguments: &PoseArguments) -> Result<ExitCode, Failure> {
    let (job, folder) = if is_job(&arguments.input) {
        let job = read_robot_job::<PoseJob>(&arguments.input, "pose")?;
        (job.table, job.folder)
    } else {
        (PoseJob::default(), PathBuf::new())
    };
    let plane = arguments.plane.clone().or_else(|| job.plane.as_ref().map(|path| folder.join(path)));
    let plane = plane.ok_or_else(|| {
        Failure::new(Reason::Usage, "no plane is given")
            .with_hint("add --plane FILE; `boresight robot plane` makes one")
    })?;
    let document = read_plane(&plane)?;
    let objects = match (&job.objects, is_job(&arguments.input)) {
        (Some(path), _) => folder.join(path),
        (None, false) => arguments.input.clone(),
        (None, true) => {
            let message = format!("{}: [pose] names no objects", arguments.input.display());
            return Err(Failure::new(Reason::Usage, message).with_hint("add objects = \"objects.csv\""));
        }
    };
    let sigma_phi = arguments.sigma_phi_deg.or(job.sigma_phi_deg).unwrap_or(0.1).to_radians();
    let height_m = arguments.height_mm.or(job.height_mm).map(|mm| 1e-3 * mm);
    let height_sigma_m = 1e-3 * arguments.height_sigma_mm.or(job.height_sigma_mm).unwrap_or(0.0);
    let sigma_px = arguments.sigma_px.or(job.sigma_px).unwrap_or(0.1);
    let mut placed = Vec::new();
    let mut findings: Vec<Finding> = Vec::new();
    for asked in read_objects(&objects, sigma_phi, height_m)? {
        let object = format!("object {}", asked.name);
        let found = place_object(&document.plane, &asked.seen, asked.height_m, height_sigma_m, sigma_px)
            .map_err(|error| Failure::from(error).of(&object))?;
        findings.extend(
            found.findings.iter().cloned().map(|finding| Finding { place: object.clone(), ..finding }),
        );
        placed.push((asked.name, found));
    }
    tell_findings(&findings);
    if arguments.json {
        let objects: Vec<Value> = placed.iter().map(|(name, found)| as_json(name, found)).collect();
        let document = json!({ "schema": "boresight.pose/1", "objects": objects, "findings": findings });
        let mut bytes = serde_json::to_vec_pretty(&document)
            .map_err(|error| Failure::new(Reason::CannotWrite, error.to_string()))?;
        bytes.push(b'\n');
        answer(&bytes)?;
    } else {
        answer(text(&placed, document.plane.model.name()).as_bytes())?;
    }
    Ok(exit_code(verdict(&findings)))
}

fn read_objects(path: &Path, sigma_phi: f64, height_m: Option<f64>) -> Result<Vec<Asked>, Failure> {
    let table = RobotTable::read(path)?;
    let (u, v) = (table.pixels("u")?, table.pixels("v")?);
    let heights = if table.has("height") { table.lengths_m("height")? } else { vec![height_m; table.len()] };
    let has_points = table.has("x");
    let (x, y) = if has_points { (table.lengths_m("x")?, table.lengths_m("y")?) } else { Default::default() };
    let phi = if has_points { Vec::new() } else { table.angles_rad("phi")? };
    let mut objects: Vec<Asked> = Vec::new();
    for (i, name) in table.names().into_iter().enumerate() {
        let value = |column: &[Option<f64>], name: &str| column[i].ok_or_else(|| table.missing(i, name));
        let pixel = [value(&u, "u_px")?, value(&v, "v_px")?];
        if has_points {
            let point = ([value(&x, "x")?, value(&y, "y")?], pixel);
            match objects.iter_mut().find(|object| object.name == name) {
                Some(Asked { seen: ObjectSeen::Points(points), .. }) => points.push(point),
                _ => {
                    objects.push(Asked { name, seen: ObjectSeen::Points(vec![point]), height_m: heights[i] })
                }
            }
        } else {
            let angle_rad = value(&phi, "phi")?;
            let seen = ObjectSeen::Origin { pixel, angle_rad, angle_sigma_rad: sigma_phi };
            objects.push(Asked { name, seen, height_m: heights[i] });
        }
    }
    Ok(objects)
}

fn as_json(name: &str, found: &PlacedObject) -> Value {
    let matrix = &found.object_in_robot;
    let rows: Vec<Vec<f64>> = matrix.row_iter().map(|row| row.iter().copied().collect()).collect();
    let covariance: Vec<Vec<f64>> =
        found.covariance.row_iter().map(|row| row.iter().copied().collect()).collect();
    let [x_m, y_m, z_m, turn_rad] = found.values;
    json!({
        "name": name,
        "x_m": x_m,
        "y_m": y_m,
        "z_m": z_m,
        "turn_rad": turn_rad,
        "covariance_x_y_z_m_turn_rad": covariance,
        "object_in_robot": rows,
        "shift_per_height": found.shift_per_height,
        "rms_m": found.rms_m,
    })
}

fn text(placed: &[(String, PlacedObject)], model: &str) -> String {
    let mut rows = vec![row(["object", "x mm", "y mm", "z mm", "turn deg", "mm per mm of height"])];
    for (name, found) in placed {
        let sigma = |i: usize| found.covariance[(i, i)].max(0.0).sqrt();
        let mut cells = vec![name.clone()];
        cells.extend((0..3).map(|i| with_sigma(1e3 * found.values[i], Some(1e3 * sigma(i)))));
        cells.push(with_sigma(found.values[3].to_degrees(), Some(sigma(3).to_degrees())));
        cells.push(found.shift_per_height.map_or("-".to_owned(), |shift| format!("{shift:.4}")));
        rows.push(cells);
    }
    format!("{}in the robot's base frame, by a plane of model {model}\n", aligned(&rows))
}
