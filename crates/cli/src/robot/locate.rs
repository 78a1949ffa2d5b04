//! `boresight robot locate`.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use boresight::{
    Candidate, KnownRig, LocatePoint, Located, RobotTable, locate, read_robot_job, triangle_from_sides,
};
use clap::Args;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::calibrate::tell_findings;
use crate::failure::{Failure, Reason};
use crate::figures::{count, significant, with_sigma};
use crate::streams::answer;
use crate::table::{aligned, row};

#[derive(Args, Debug)]
pub(crate) struct LocateArguments {
    /// A folder or job file with a `[locate]` table, or a table of points: name,x_mm,y_mm,z_mm,u_px,v_px
    /// (a point without u_px and v_px is predicted)
    pub input: PathBuf,
    /// The calibration: calibration.json or its folder, a .cameramodel or an OpenCV .yml
    #[arg(long, value_name = "FILE")]
    pub calibration: Option<PathBuf>,
    /// The camera; may be left out where there is only one
    #[arg(long, value_name = "NAME")]
    pub camera: Option<String>,
    /// The standard deviation of a pixel coordinate [default: 0.1]
    #[arg(long, value_name = "PX")]
    pub sigma_px: Option<f64>,
    /// The sides 12, 23 and 31 of a triangle, in place of the coordinates of three points
    #[arg(long, value_name = "L12,L23,L31", value_delimiter = ',')]
    pub sides_mm: Vec<f64>,
    /// Print one JSON document
    #[arg(long)]
    pub json: bool,
}

/// The table `[locate]` of a job.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct LocateJob {
    calibration: Option<PathBuf>,
    camera: Option<String>,
    points: Option<PathBuf>,
    sigma_px: Option<f64>,
    #[serde(default)]
    sides_mm: Vec<f64>,
}

/// Prints all poses of an object.
pub(crate) fn run(arguments: &LocateArguments) -> Result<ExitCode, Failure> {
    let (job, folder) = job(&arguments.input)?;
    let in_job = |path: &PathBuf| folder.join(path);
    let calibration = arguments.calibration.clone().or_else(|| job.calibration.as_ref().map(in_job));
    let calibration = calibration.ok_or_else(|| super::locate::no_calibration("locate"))?;
    let points = job.points.as_ref().map_or_else(|| arguments.input.clone(), in_job);
    let rig = KnownRig::read(&calibration)?;
    let camera = rig.camera(arguments.camera.as_deref().or(job.camera.as_deref()))?;
    let lens_covariance = rig.lens_covariance(camera);
    let sides_mm = if arguments.sides_mm.is_empty() { &job.sides_mm } else { &arguments.sides_mm };
    let points = read_points(&points, sides_mm)?;
    let sigma_px = arguments.sigma_px.or(job.sigma_px).unwrap_or(0.1);
    let found = locate(&camera.camera, lens_covariance.as_ref(), &points, sigma_px)
        .map_err(boresight::Error::from)?;
    tell_findings(&found.findings);
    if arguments.json {
        let mut bytes = serde_json::to_vec_pretty(&document(&points, &found, &camera.name, sigma_px))
            .map_err(|error| Failure::new(Reason::CannotWrite, error.to_string()))?;
        bytes.push(b'\n');
        answer(&bytes)?;
    } else {
        answer(text(&points, &found, &camera.name, lens_covariance.is_some()).as_bytes())?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Returns the failure of a command that needs a calibration.
pub(super) fn no_calibration(table: &str) -> Failure {
    Failure::new(Reason::Usage, "no calibration is given")
        .with_hint(format!("add --calibration FILE, or `calibration = \"FILE\"` to [{table}] of the job"))
}

/// Tells whether an input is a job rather than a table.
pub(super) fn is_job(input: &Path) -> bool {
    input.is_dir() || input.extension().is_some_and(|extension| extension == "toml")
}

fn job(input: &Path) -> Result<(LocateJob, PathBuf), Failure> {
    if !is_job(input) {
        return Ok((LocateJob::default(), PathBuf::new()));
    }
    let job = read_robot_job::<LocateJob>(input, "locate")?;
    if job.table.points.is_none() {
        let message = format!("{}: [locate] names no points", job.input.0);
        return Err(Failure::new(Reason::Usage, message).with_hint("add points = \"points.csv\""));
    }
    Ok((job.table, job.folder))
}

fn read_points(path: &Path, sides_mm: &[f64]) -> Result<Vec<LocatePoint>, Failure> {
    let table = RobotTable::read(path)?;
    let (u, v) = (table.pixels("u")?, table.pixels("v")?);
    let pixel = |i: usize| match (u[i], v[i]) {
        (Some(u), Some(v)) => Ok(Some([u, v])),
        (None, None) => Ok(None),
        (None, Some(_)) => Err(table.missing(i, "u_px")),
        (Some(_), None) => Err(table.missing(i, "v_px")),
    };
    let mut points = Vec::new();
    if !sides_mm.is_empty() {
        let bad = |message: String| {
            Failure::new(Reason::Usage, message).with_hint("three sides belong to three points")
        };
        let [ab, bc, ca] = sides_mm else {
            return Err(bad(format!("{} sides are given, three are needed", sides_mm.len())));
        };
        if table.len() != 3 {
            return Err(bad(format!(
                "{}: {} points are given with three sides",
                path.display(),
                table.len()
            )));
        }
        let corners = triangle_from_sides([ab * 1e-3, bc * 1e-3, ca * 1e-3])
            .map_err(|error| boresight::Error::from(boresight::RobotError::from(error)))?;
        for (i, (name, corner)) in table.names().into_iter().zip(corners).enumerate() {
            points.push(LocatePoint { name, point_m: corner.into(), pixel: pixel(i)? });
        }
        return Ok(points);
    }
    let axes = ["x", "y", "z"].map(|axis| table.lengths_m(axis));
    let [x, y, z] = axes;
    let (x, y, z) = (x?, y?, z?);
    for (i, name) in table.names().into_iter().enumerate() {
        let coordinate = |column: &[Option<f64>], name: &str| column[i].ok_or_else(|| table.missing(i, name));
        let point_m = [coordinate(&x, "x")?, coordinate(&y, "y")?, coordinate(&z, "z")?];
        points.push(LocatePoint { name, point_m, pixel: pixel(i)? });
    }
    Ok(points)
}

fn text(points: &[LocatePoint], found: &Located, camera: &str, lens_is_known: bool) -> String {
    let by = if lens_is_known {
        "pixels and calibration"
    } else {
        "pixels alone: the calibration tells no covariance"
    };
    let mut text = format!(
        "{}, camera {camera}: {}\nsigmas by {by}\n\n",
        count(points.len(), "point"),
        count(found.candidates.len(), "pose")
    );
    let mut rows =
        vec![row(["pose", "x mm", "y mm", "z mm", "rx deg", "ry deg", "rz deg", "RMS px", "condition"])];
    for (i, candidate) in found.candidates.iter().enumerate() {
        let pose = &candidate.pose;
        let covariance = pose.origin_covariance();
        let sigma = |k: usize| covariance[(k, k)].sqrt();
        let place = pose.cam_from_object.translation;
        let turn = pose.cam_from_object.rodrigues();
        let mut cells = vec![(i + 1).to_string()];
        cells.extend((0..3).map(|k| with_sigma(1e3 * place[k], Some(1e3 * sigma(3 + k)))));
        cells.extend((0..3).map(|k| with_sigma(turn[k].to_degrees(), Some(sigma(k).to_degrees()))));
        cells.push(format!("{:.4}", pose.rms_px()));
        cells.push(candidate.condition.map_or("-".to_owned(), |condition| format!("{condition:.1e}")));
        rows.push(cells);
    }
    text.push_str(&aligned(&rows));
    text.push_str(
        "position of the object's origin and Rodrigues vector of its turn, in the camera frame\n\n",
    );
    let mut rows = vec![vec!["point".to_owned(), "seen px".to_owned()]];
    rows[0].extend((1..=found.candidates.len()).map(|i| format!("off by pose {i}")));
    for (k, point) in points.iter().enumerate() {
        let seen = point.pixel.map_or("-".to_owned(), |[u, v]| format!("{u:.2} {v:.2}"));
        let mut cells = vec![point.name.clone(), seen];
        cells.extend(found.candidates.iter().map(|candidate| off(candidate, point, k)));
        rows.push(cells);
    }
    text.push_str(&aligned(&rows));
    text
}

/// Returns by how much a pose misses a point, or where it puts one that was not seen.
fn off(candidate: &Candidate, point: &LocatePoint, k: usize) -> String {
    match (candidate.predicted_px[k], point.pixel) {
        (None, _) => "out of sight".to_owned(),
        (Some([u, v]), None) => format!("at {u:.2} {v:.2}"),
        (Some([u, v]), Some([seen_u, seen_v])) => {
            let left_out = if candidate.is_used[k] { "" } else { " (left out)" };
            format!("{}{left_out}", significant((u - seen_u).hypot(v - seen_v)))
        }
    }
}

fn document(points: &[LocatePoint], found: &Located, camera: &str, sigma_px: f64) -> Value {
    let poses = found.candidates.iter().map(|candidate| {
        let pose = &candidate.pose;
        let [x, y, z, w]: [f64; 4] = pose.cam_from_object.rotation.coords.into();
        let covariance: Vec<Vec<f64>> =
            pose.origin_covariance().row_iter().map(|row| row.iter().copied().collect()).collect();
        json!({
            "cam_from_object": { "rotation_xyzw": [x, y, z, w], "translation_m": <[f64; 3]>::from(pose.cam_from_object.translation) },
            "covariance_of_rotation_rad_and_origin_m": covariance,
            "rms_px": pose.rms_px(),
            "chi2": pose.chi2,
            "degrees_of_freedom": pose.degrees_of_freedom,
            "condition": candidate.condition.filter(|condition| condition.is_finite()),
            "predicted_px": candidate.predicted_px,
            "used": candidate.is_used,
        })
    });
    json!({
        "schema": "boresight.locate/1",
        "camera": camera,
        "sigma_px": sigma_px,
        "points": points.iter().map(|point| &point.name).collect::<Vec<_>>(),
        "poses": poses.collect::<Vec<_>>(),
        "findings": found.findings,
    })
}
