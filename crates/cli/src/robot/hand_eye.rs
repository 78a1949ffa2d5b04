//! `boresight robot hand-eye`.

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

use boresight::{
    CalibrateOptions, HandEyeDocument, HandEyeOptions, HandEyeOutcome, Mounting, NoiseChoice, OutputFile,
    Pose, PoseConvention, RobotNoise, RobotOverrides, RobotRows, SightsJob, SigmaSource, Watch,
    read_sights_job, result_files, write_files,
};
use clap::{Args, ValueEnum};

use super::sighted_poses::{self, Answer};
use crate::arguments::InputArguments;
use crate::calibrate::{exit_code, tell_findings};
use crate::failure::{Failure, Reason};
use crate::figures::{significant, with_sigma};
use crate::inputs::{self, InputKind};
use crate::streams::{answer, note};
use crate::summary;
use crate::table::{aligned, row};

#[derive(Args, Debug)]
pub(crate) struct HandEyeArguments {
    #[command(flatten)]
    pub input: InputArguments,
    #[command(flatten)]
    pub robot: RobotArguments,
    /// The robot's noise: estimated, none, or its sigmas, such as 0.02deg,0.1mm [default: estimated]
    #[arg(long, value_name = "NOISE", value_parser = parse_noise)]
    pub robot_noise: Option<NoiseChoice>,
    /// The folder for the results; made if it does not exist
    #[arg(short, long, value_name = "DIR", default_value = "out")]
    pub output: PathBuf,
    /// Print hand-eye.json on stdout instead of the summary
    #[arg(long)]
    pub json: bool,
}

/// What the command line says of a robot in place of the job.
#[derive(Args, Debug)]
pub(crate) struct RobotArguments {
    /// Files of robot poses, in place of the job's: CSV with a header, or 6, 7, 8, 12 or 16 numbers in a line
    #[arg(long, value_name = "FILE")]
    pub poses: Vec<PathBuf>,
    /// What the poses' numbers mean, such as kuka-abc, fanuc-wpr, universal-robots, abb, ros or moving-zyx:deg:mm
    #[arg(long, value_name = "CONVENTION")]
    pub poses_as: Option<PoseConvention>,
    /// Where the cameras are [default: the job's, or what fits better]
    #[arg(long, value_enum)]
    pub mount: Option<MountChoice>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum MountChoice {
    /// They move with the robot
    OnFlange,
    /// They stand in the work cell, and the target moves
    Fixed,
}

impl RobotArguments {
    /// Returns what the arguments say in place of the job's `[robot]`.
    pub(super) fn overrides(&self) -> RobotOverrides {
        RobotOverrides {
            mounting: self.mount.map(|mount| match mount {
                MountChoice::OnFlange => Mounting::RigOnFlange,
                MountChoice::Fixed => Mounting::RigInBase,
            }),
            poses: self.poses.clone(),
            convention: self.poses_as,
        }
    }
}

fn parse_noise(text: &str) -> Result<NoiseChoice, String> {
    let bad = || {
        format!("`{text}` is none of: estimated, none, or a rotation and a translation such as 0.02deg,0.1mm")
    };
    match text {
        "estimated" => return Ok(NoiseChoice::Estimated),
        "none" => return Ok(NoiseChoice::None),
        _ => {}
    }
    let (rotation, translation) = text.split_once(',').ok_or_else(bad)?;
    let number = |text: &str, unit: &str, factor: f64| {
        let number = text.trim().strip_suffix(unit)?.parse::<f64>().ok()?;
        (number > 0.0 && number.is_finite()).then_some(number * factor)
    };
    let degree = std::f64::consts::PI / 180.0;
    let rotation_rad = number(rotation, "deg", degree).or_else(|| number(rotation, "rad", 1.0));
    let translation_m = number(translation, "mm", 1e-3).or_else(|| number(translation, "m", 1.0));
    let (rotation_rad, translation_m) = rotation_rad.zip(translation_m).ok_or_else(bad)?;
    Ok(NoiseChoice::Known(RobotNoise { rotation_rad, translation_m, stretch: None }))
}

/// Calibrates cameras and robot, writes, and prints the summary or the document.
pub(crate) fn run(arguments: &HandEyeArguments) -> Result<ExitCode, Failure> {
    let begin = Instant::now();
    inputs::refuse_file(&arguments.output)?;
    let given: Vec<&PathBuf> = arguments.input.config.iter().chain(&arguments.input.inputs).collect();
    if let [only] = given[..]
        && only.exists()
        && let Some(job) = read_sights_job(only, &arguments.robot.overrides())?
    {
        refuse_idle_flags(arguments, &job)?;
        let print = if arguments.json { Answer::Json } else { Answer::Summary };
        return sighted_poses::run(&job, &arguments.output, print);
    }
    let job = inputs::load_with_robot(&arguments.input, arguments.robot.overrides())?;
    let options = HandEyeOptions {
        cameras: CalibrateOptions::of_job(&job)?,
        noise: arguments.robot_noise.unwrap_or_default(),
    };
    let result = boresight::hand_eye(&job, &options, &Watch::default())?;
    let document = HandEyeDocument::new(&result).to_json();
    let mut files = result_files(&result.outcome)?;
    files.push(OutputFile { name: "hand-eye.json".to_owned(), bytes: document.clone() });
    write_files(&arguments.output, &files)?;
    if arguments.json {
        answer(&document)?;
    } else {
        answer(summary(&result).as_bytes())?;
    }
    tell_findings(&result.outcome.findings);
    let verdict = summary::verdict_line(result.outcome.verdict, &result.outcome.findings);
    note(&format!("{verdict}; written to {}", arguments.output.display()));
    note(&format!("done in {:.2} s", begin.elapsed().as_secs_f64()));
    Ok(match result.outcome.calibration.solve.converged {
        false => ExitCode::from(Reason::Solve.code()),
        true => exit_code(result.outcome.verdict),
    })
}

/// Refuses flags that say nothing of a job of poses, or of one of joints.
fn refuse_idle_flags(arguments: &HandEyeArguments, job: &SightsJob) -> Result<(), Failure> {
    inputs::refuse_idle_flags(&arguments.input, InputKind::Sights)?;
    let has_joints = matches!(job.robot, RobotRows::Joints(_));
    let RobotArguments { poses, poses_as, mount } = &arguments.robot;
    let flags = [
        ("--robot-noise", arguments.robot_noise.is_some(), "a job of poses, whose noise is the sights'"),
        ("--poses", has_joints && !poses.is_empty(), "a job of joints"),
        ("--poses-as", has_joints && poses_as.is_some(), "a job of joints"),
        ("--mount", has_joints && mount.is_some(), "a job of joints"),
    ];
    match flags.into_iter().find(|(_, is_idle, _)| *is_idle) {
        None => Ok(()),
        Some((flag, _, what)) => {
            let message = format!("{flag} says nothing of {what}");
            Err(Failure::new(Reason::Usage, message).with_hint("leave it out"))
        }
    }
}

fn mm(metres: f64) -> String {
    format!("{:.3}", 1e3 * metres)
}

fn summary(result: &HandEyeOutcome) -> String {
    let mut text = format!("{}\n", summary::of_dataset(&result.outcome.dataset));
    let chosen = &result.methods[result.chosen];
    if let Some(figures) = chosen.figures {
        text.push_str(&format!(
            "leave one frame out: {} mm mean, {} mm at 95 %, {} mm at most ({})\n\n",
            mm(figures.mean_m),
            mm(figures.p95_m),
            mm(figures.max_m),
            chosen.name
        ));
    }
    let mut rows = vec![row(["left-out frames, mm", "mean", "95 %", "most", "RMS px"])];
    for (i, method) in result.methods.iter().enumerate() {
        let mark = if i == result.chosen { " *" } else { "" };
        let mut cells = vec![format!("{}{mark}", method.name)];
        match method.figures {
            Some(figures) => {
                cells.extend([mm(figures.mean_m), mm(figures.p95_m), mm(figures.max_m)]);
                cells.push(format!("{:.3}", figures.rms_px));
            }
            None => cells.push("failed".to_owned()),
        }
        rows.push(cells);
    }
    text.push_str(&aligned(&rows));
    text.push('\n');
    text.push_str(&poses(result));
    text.push_str(&stretch(result));
    if let Some(clock) = &result.clock {
        text.push_str(&format!(
            "clocks: the robot's shows {} ms when the camera's shows zero\n",
            with_sigma(1e3 * clock.offset_s, Some(1e3 * clock.sigma_s))
        ));
    }
    if let Some(noise) = &result.noise {
        let use_of_it = match chosen.name.contains("noise") {
            true => "",
            false => "; not used, as left-out frames are foretold better without",
        };
        text.push_str(&format!(
            "robot noise: {} deg ± {:.0} %, {} mm ± {:.0} %, per axis{use_of_it}\n",
            significant(noise.noise.rotation_rad.to_degrees()),
            100.0 * noise.relative_sigmas[0],
            significant(1e3 * noise.noise.translation_m),
            100.0 * noise.relative_sigmas[1],
        ));
    }
    if let Some(touched) = &result.touched {
        let tip = |axis: usize| {
            with_sigma(1e3 * touched.tip_m[axis], touched.tip_sigma_m.map(|sigma| 1e3 * sigma[axis]))
        };
        text.push_str(&format!(
            "touches: {} points, missed by {} mm along an axis where {} mm are expected; tip at ({}, {}, {}) mm\n",
            touched.touches,
            mm(touched.rms_m),
            mm(touched.expected_m),
            tip(0),
            tip(1),
            tip(2)
        ));
    }
    let lengths = result.working_points.iter().map(|point| {
        let [x, y, z] = point.sigma_m;
        ((x * x + y * y + z * z).sqrt(), point)
    });
    let mut lengths: Vec<_> = lengths.collect();
    lengths.sort_by(|one, other| one.0.total_cmp(&other.0));
    if let (Some(middle), Some(worst)) = (lengths.get(lengths.len() / 2), lengths.last()) {
        let source = match middle.1.source {
            SigmaSource::Covariance => "covariance with the robot's noise",
            SigmaSource::Jackknife => "jackknife over frames",
        };
        text.push_str(&format!(
            "a point in the robot's base: 1 sigma {} mm (median), {} mm at worst (frame {}), by {source}\n",
            mm(middle.0),
            mm(worst.0),
            worst.1.frame
        ));
    }
    text
}

/// Returns the names of the robot's two poses.
fn pose_names(result: &HandEyeOutcome) -> [&'static str; 2] {
    match result.mounting {
        Mounting::RigOnFlange => ["flange_from_rig", "base_from_target"],
        Mounting::RigInBase => ["base_from_rig", "flange_from_target"],
    }
}

fn pose_table(names: [&str; 2], poses: [&Pose; 2]) -> String {
    let mut rows = vec![row(["pose", "x mm", "y mm", "z mm", "rx deg", "ry deg", "rz deg"])];
    for (name, pose) in names.into_iter().zip(poses) {
        let mut cells = vec![name.to_owned()];
        cells.extend(pose.translation.iter().map(|metres| mm(*metres)));
        cells.extend(pose.rodrigues().iter().map(|angle| format!("{:.4}", angle.to_degrees())));
        rows.push(cells);
    }
    aligned(&rows)
}

/// Says how positions are to be corrected, and what holds without; nothing where they are not.
fn stretch(result: &HandEyeOutcome) -> String {
    let robot = result.outcome.calibration.scene.robot.as_ref();
    let Some(stretch) = robot.and_then(|robot| robot.stretch) else { return String::new() };
    let [x, y, z] = stretch.centre_in_base.into();
    let mut text = format!(
        "\nstretch: these poses hold for the flange at position + S (position - centre); centre ({}, {}, {}) mm, S in mm/m:\n",
        mm(x),
        mm(y),
        mm(z)
    );
    let rows = [0, 1, 2].map(|i| {
        let numbers = [0, 1, 2].map(|j| format!("{:.4}", 1e3 * stretch.matrix[(i, j)]));
        [vec![String::new()], numbers.to_vec()].concat()
    });
    text.push_str(&aligned(&rows));
    if let Some(plain) = &result.without_stretch {
        let mean = plain.method.figures.map_or("-".to_owned(), |figures| mm(figures.mean_m));
        text.push_str(&format!(
            "positions as the robot says them (leave one out {mean} mm, {}):\n",
            plain.method.name
        ));
        text.push_str(&pose_table(pose_names(result), [&plain.carrier_from_rig, &plain.other_from_target]));
        text.push('\n');
    }
    text
}

/// Returns the robot's two poses as a table.
fn poses(result: &HandEyeOutcome) -> String {
    let Some(robot) = &result.outcome.calibration.scene.robot else { return String::new() };
    let names = pose_names(result);
    let mut text = pose_table(names, [&robot.carrier_from_rig(), &robot.other_from_target()]);
    text.push_str("position and orientation (Rodrigues vector)\n");
    let [_, _, _, x, y, z] = result.jackknife;
    if x.is_finite() {
        text.push_str(&format!(
            "{}: 1 sigma ({}, {}, {}) mm over frames left out (jackknife)\n",
            names[0],
            mm(x),
            mm(y),
            mm(z)
        ));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_is_read_with_its_units() {
        assert_eq!(parse_noise("none"), Ok(NoiseChoice::None));
        let Ok(NoiseChoice::Known(noise)) = parse_noise("0.5rad,0.1mm") else { panic!() };
        assert!((noise.rotation_rad - 0.5).abs() + (noise.translation_m - 1e-4).abs() < 1e-12);
        for text in ["", "1,2", "1deg", "-1deg,1mm", "1mm,1deg"] {
            assert!(parse_noise(text).is_err(), "{text}");
        }
    }
}
