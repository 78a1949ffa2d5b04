//! `boresight robot hand-eye` of a job without pixels: poses of the target in their place.

use std::path::Path;
use std::process::ExitCode;

use boresight::{
    Finding, JointChain, Mounting, OutputFile, Pose, PoseFigures, PoseHandEye, RobotRows, SightsJob,
    hand_eye_of_poses, joint_chain, joints_to_json, pose_hand_eye_to_json, verdict, write_files,
};

use crate::calibrate::{exit_code, tell_findings};
use crate::failure::{Failure, Reason};
use crate::figures::with_sigma;
use crate::streams::{answer, note};
use crate::summary;
use crate::table::{aligned, row};

/// How the answer is printed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Answer {
    /// As tables.
    Summary,
    /// As the document.
    Json,
}

/// Calibrates, writes, and prints the summary or the document.
pub(super) fn run(job: &SightsJob, output: &Path, print: Answer) -> Result<ExitCode, Failure> {
    let (text, document, findings, is_converged) = match &job.robot {
        RobotRows::Poses(poses) => {
            let found = hand_eye_of_poses(poses, &job.sights, job.mounting)?;
            let document = pose_hand_eye_to_json(&found, &job.inputs);
            (of_hand_eye(&found), document, found.findings, found.is_converged)
        }
        RobotRows::Joints(readings) => {
            let found = joint_chain(readings, &job.sights)?;
            let document = joints_to_json(&found, &job.inputs);
            (of_joints(&found), document, found.findings, found.is_converged)
        }
    };
    write_files(output, &[OutputFile { name: "hand-eye.json".to_owned(), bytes: document.clone() }])?;
    match print {
        Answer::Summary => answer(text.as_bytes())?,
        Answer::Json => answer(&document)?,
    }
    Ok(end(output, &findings, is_converged))
}

fn end(output: &Path, findings: &[Finding], is_converged: bool) -> ExitCode {
    tell_findings(findings);
    let verdict = verdict(findings);
    note(&format!("{}; written to {}", summary::verdict_line(verdict, findings), output.display()));
    match is_converged {
        false => ExitCode::from(Reason::Solve.code()),
        true => exit_code(verdict),
    }
}

/// Returns the rows of a pose: in mm and degrees, with sigmas.
fn pose_row(name: &str, pose: &Pose, sigmas: &[f64; 6]) -> Vec<String> {
    let mut cells = vec![name.to_owned()];
    let translation = pose.translation.iter().zip(&sigmas[3..]);
    cells.extend(translation.map(|(metres, sigma)| with_sigma(1e3 * metres, Some(1e3 * sigma))));
    let rotation = pose.rodrigues();
    let degrees = rotation.iter().zip(&sigmas[..3]);
    cells.extend(degrees.map(|(angle, sigma)| with_sigma(angle.to_degrees(), Some(sigma.to_degrees()))));
    cells
}

const FIGURES_HEAD: [&str; 7] =
    ["left-out sights", "mean mm", "median", "95 %", "mean deg", "median", "95 %"];

fn figures_row(name: &str, figures: Option<&PoseFigures>) -> Vec<String> {
    let mut cells = vec![name.to_owned()];
    match figures {
        Some(figures) => {
            cells.extend(figures.distance_m[..3].iter().map(|metres| format!("{:.3}", 1e3 * metres)));
            cells.extend(figures.angle_rad[..3].iter().map(|angle| format!("{:.4}", angle.to_degrees())));
        }
        None => cells.push("failed".to_owned()),
    }
    cells
}

fn noise(noise: &boresight::PoseNoise) -> String {
    let [rx, ry, rz] = noise.rotation_sigmas_rad().map(f64::to_degrees);
    let [x, y, z] = noise.translation_sigmas_m().map(|sigma| 1e3 * sigma);
    let tails = if noise.degrees_of_freedom.is_finite() {
        format!("t distribution with {} degrees of freedom", noise.degrees_of_freedom)
    } else {
        "normal distribution".to_owned()
    };
    format!(
        "a sight's noise: ({rx:.3}, {ry:.3}, {rz:.3}) deg, ({x:.2}, {y:.2}, {z:.2}) mm along the camera's axes, {tails}\n"
    )
}

fn of_hand_eye(found: &PoseHandEye) -> String {
    let names = match found.mounting {
        Mounting::RigOnFlange => ["flange_from_rig", "base_from_target"],
        Mounting::RigInBase => ["base_from_rig", "flange_from_target"],
    };
    let [sights, used, far] = found.sights;
    let mut text = format!("{sights} sights, {used} of which the robot tells, {far} of these far off\n\n");
    let mut rows = vec![FIGURES_HEAD.map(str::to_owned).to_vec()];
    rows.extend(found.methods.iter().map(|(name, figures)| figures_row(name, figures.as_ref())));
    text.push_str(&aligned(&rows));
    text.push_str(&format!("each of {} blocks is left out in turn\n\n", found.blocks));
    let mut rows = vec![row(["pose", "x mm", "y mm", "z mm", "rx deg", "ry deg", "rz deg"])];
    rows.push(pose_row(names[0], &found.carrier_from_rig, &found.sigmas[0]));
    rows.push(pose_row(names[1], &found.other_from_target, &found.sigmas[1]));
    text.push_str(&aligned(&rows));
    if let Some(clock) = &found.clock {
        text.push_str(&format!(
            "clocks: the robot's shows {} ms when the camera's shows zero; angular speeds correlate by {:.3}\n",
            with_sigma(1e3 * clock.offset_s, Some(1e3 * clock.sigma_s)),
            clock.correlation
        ));
    }
    text.push_str(&noise(&found.noise));
    text
}

fn of_joints(found: &JointChain) -> String {
    let [sights, far] = found.sights;
    let mut text = format!("{sights} sights, {far} of them far off\n\n");
    let mut rows = vec![FIGURES_HEAD.map(str::to_owned).to_vec()];
    rows.push(figures_row("left out", found.left_out.as_ref()));
    rows.push(figures_row("fitted", found.fitted.as_ref()));
    text.push_str(&aligned(&rows));
    text.push('\n');
    let mut rows = vec![row(["joint", "direction", "sigma deg", "point mm", "sigma mm"])];
    for (i, joint) in found.joints.iter().enumerate() {
        let [a, b, c] = joint.direction;
        let [x, y, z] = joint.point_m.map(|metres| 1e3 * metres);
        rows.push(vec![
            (i + 1).to_string(),
            format!("({a:.5}, {b:.5}, {c:.5})"),
            format!("{:.4}", joint.direction_sigma_rad.to_degrees()),
            format!("({x:.2}, {y:.2}, {z:.2})"),
            format!("{:.3}", 1e3 * joint.point_sigma_m),
        ]);
    }
    text.push_str(&aligned(&rows));
    for (i, link) in found.links.iter().enumerate() {
        let [angle, angle_sigma] = link.angle_rad.map(f64::to_degrees);
        let [distance, distance_sigma] = link.distance_m.map(|metres| 1e3 * metres);
        text.push_str(&format!(
            "joints {} and {}: {} deg, {} mm apart\n",
            i + 1,
            i + 2,
            with_sigma(angle, Some(angle_sigma)),
            with_sigma(distance, Some(distance_sigma))
        ));
    }
    text.push('\n');
    let mut rows = vec![row(["pose at zero", "x mm", "y mm", "z mm", "rx deg", "ry deg", "rz deg"])];
    rows.push(pose_row("rig_from_target", &found.rig_from_target, &found.target_sigmas));
    text.push_str(&aligned(&rows));
    text.push_str(&noise(&found.noise));
    text
}
