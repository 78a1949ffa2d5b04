//! The summary of a dataset or a calibration, for people.

use std::fmt::Write as _;

use boresight::{
    Calibration, Camera, CameraFit, CircleLayout, Dataset, Finding, Geometry, HeldOut, Id as _,
    RejectionReason, RigCamera, Severity, Shape, Target, Verdict,
};

use crate::figures::{count, significant, to_sigma, with_sigma};
use crate::table::{aligned, row};

/// As many cameras stand side by side as 100 columns hold.
const CAMERAS_ABREAST: usize = 4;

/// Returns what a dataset holds, in one line for each thing.
pub(crate) fn of_dataset(dataset: &Dataset) -> String {
    let mut text = format!(
        "{}, {}, {}, {}\n",
        count(dataset.cameras.len(), "camera"),
        count(dataset.frames.len(), "frame"),
        count(dataset.views.len(), "view"),
        count(dataset.observation_count(), "corner"),
    );
    for target in &dataset.targets {
        let _ = writeln!(text, "target {}", describe(target));
    }
    text
}

/// Returns a target in a few words.
fn describe(target: &Target) -> String {
    match &target.geometry {
        Geometry::Chessboard { columns, rows, spacing_m } => {
            format!("chessboard, {columns}x{rows} inner corners, {} mm apart", trimmed(1e3 * spacing_m))
        }
        Geometry::Charuco { columns, rows, spacing_m, marker_m, dictionary } => {
            let (square, marker) = (trimmed(1e3 * spacing_m), trimmed(1e3 * marker_m));
            format!(
                "ChArUco board, {columns}x{rows} squares of {square} mm, {marker} mm markers of {}",
                dictionary.name()
            )
        }
        Geometry::AprilGrid { columns, rows, tag_m, spacing, dictionary } => {
            let (tag, gap) = (trimmed(1e3 * tag_m), trimmed(1e3 * tag_m * spacing));
            format!("AprilGrid, {columns}x{rows} tags of {tag} mm, {gap} mm apart, of {}", dictionary.name())
        }
        Geometry::Circles { columns, rows, spacing_m, layout } => {
            let kind = match layout {
                CircleLayout::Symmetric => "symmetric",
                CircleLayout::Asymmetric => "asymmetric",
            };
            format!("{kind} grid of {columns}x{rows} circles, {} mm apart", trimmed(1e3 * spacing_m))
        }
        Geometry::Points { points_m } => format!("of {}", count(points_m.len(), "point")),
    }
}

/// Returns a number without rounding noise and trailing zeros.
fn trimmed(value: f64) -> String {
    let text = format!("{value:.6}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// Returns cameras, lenses, rig, target and solve of a calibration.
pub(crate) fn of_calibration(calibration: &Calibration) -> String {
    let mut blocks = vec![cameras(calibration)];
    blocks.extend(lenses(calibration));
    blocks.extend(rig(calibration));
    blocks.extend(rows_in_time(calibration));
    blocks.push(solve(calibration));
    blocks.join("\n")
}

/// Returns the verdict in one line, with the number of findings of each kind.
pub(crate) fn verdict_line(verdict: Verdict, findings: &[Finding]) -> String {
    let kinds = [(Severity::Fail, "failure"), (Severity::Caution, "caution"), (Severity::Note, "note")];
    let counts: Vec<String> = kinds
        .iter()
        .map(|(severity, noun)| {
            (findings.iter().filter(|finding| finding.severity == *severity).count(), noun)
        })
        .filter(|(n, _)| *n > 0)
        .map(|(n, noun)| count(n, noun))
        .collect();
    if counts.is_empty() {
        format!("verdict: {verdict}")
    } else {
        format!("verdict: {verdict} ({})", counts.join(", "))
    }
}

/// Returns each calibrated camera with its fit.
fn calibrated(calibration: &Calibration) -> impl Iterator<Item = (&CameraFit, &RigCamera)> {
    let cameras = calibration.cameras.iter().zip(&calibration.scene.rig.cameras);
    cameras.filter_map(|(fit, camera)| Some((fit, camera.as_ref()?)))
}

fn cameras(calibration: &Calibration) -> String {
    let head =
        ["camera", "model", "fx px", "fy px", "cx px", "cy px", "RMS px", "views", "corners", "rejected"];
    let mut rows = vec![row(head)];
    for (fit, camera) in calibration.cameras.iter().zip(&calibration.scene.rig.cameras) {
        let Some(RigCamera { camera, .. }) = camera else {
            rows.push(row([&fit.name, "-", "-", "-", "-", "-", "-", "0", "0", &fit.rejected.to_string()]));
            continue;
        };
        let sigma = |param: &str| calibration.uncertainty.sigma(&format!("{}.{param}", fit.name));
        let [fx, fy, cx, cy] = [0, 1, 2, 3].map(|i| camera.params[i]);
        rows.push(row([
            &fit.name,
            camera.model.name(),
            &with_sigma(fx, sigma("fx")),
            &to_sigma(fy, sigma("fy")),
            &to_sigma(cx, sigma("cx")),
            &to_sigma(cy, sigma("cy")),
            &format!("{:.4}", fit.rms_px),
            &fit.views.to_string(),
            &fit.observations.to_string(),
            &fit.rejected.to_string(),
        ]));
    }
    let mut text = aligned(&rows);
    let outliers = |reason: &RejectionReason| matches!(reason, RejectionReason::Outlier { .. });
    let n_outliers = calibration.rejected.iter().filter(|rejection| outliers(&rejection.reason)).count();
    let n_left_out = calibration.rejected.len() - n_outliers;
    if n_left_out > 0 {
        let _ = writeln!(
            text,
            "rejected: {}, {n_left_out} in views that were left out",
            count(n_outliers, "outlier")
        );
    }
    let _ = writeln!(
        text,
        "all cameras: RMS {:.4} px, by OpenCV's definition: sqrt(sum(du² + dv²) / corners)",
        calibration.rms_px
    );
    text
}

/// Returns a table of lens coefficients for each few cameras: parameters down, cameras across.
fn lenses(calibration: &Calibration) -> Vec<String> {
    let (splines, all): (Vec<_>, Vec<_>) =
        calibrated(calibration).partition(|(_, placed)| placed.camera.model.local_support().is_some());
    let splines =
        splines.into_iter().filter_map(|(fit, placed)| knots(calibration, &fit.name, &placed.camera));
    let tables = all.chunks(CAMERAS_ABREAST).filter_map(|some| {
        let mut names: Vec<&str> = Vec::new();
        for (_, RigCamera { camera, .. }) in some {
            let params = camera.model.param_names();
            names.extend(params.into_iter().skip(4).filter(|name| !names.contains(name)).collect::<Vec<_>>());
        }
        if names.is_empty() {
            return None;
        }
        let mut head = vec!["lens".to_owned()];
        head.extend(some.iter().map(|(fit, _)| fit.name.clone()));
        let mut rows = vec![head];
        for name in names {
            let mut cells = vec![name.to_owned()];
            for (fit, RigCamera { camera, .. }) in some {
                let i = camera.model.param_names().iter().position(|param| *param == name);
                let sigma = calibration.uncertainty.sigma(&format!("{}.{name}", fit.name));
                cells.push(i.map_or_else(|| "-".to_owned(), |i| with_sigma(camera.params[i], sigma)));
            }
            rows.push(cells);
        }
        Some(aligned(&rows))
    });
    tables.chain(splines).collect()
}

/// Says how many knots of a splined lens are known. Their sigmas are not those of pixels: all of them turn together.
fn knots(calibration: &Calibration, name: &str, camera: &Camera) -> Option<String> {
    let grid = camera.model.local_support()?;
    let params = camera.model.param_names().into_iter().skip(4);
    let shares = params.map(|param| calibration.uncertainty.believed_share(&format!("{name}.{param}")));
    let told = shares.collect::<Option<Vec<f64>>>()?.into_iter().filter(|share| *share < 0.5).count();
    Some(format!(
        "spline  {name}: {} x {} knots along x and y; corners tell {told} of their {} numbers, the others are believed alone;\n        \
         `boresight uncertainty` says how well it projects\n",
        grid.columns,
        grid.rows,
        camera.params.len() - 4,
    ))
}

/// Returns where the cameras sit, or `None` of a single camera.
fn rig(calibration: &Calibration) -> Option<String> {
    let reference = calibration.scene.rig.reference()?;
    let head = ["rig", "baseline mm", "x mm", "y mm", "z mm", "rx deg", "ry deg", "rz deg", "angle deg"];
    let mut rows = vec![row(head)];
    for (fit, RigCamera { cam_from_rig, .. }) in calibrated(calibration).skip(1) {
        let rig_from_cam = cam_from_rig.inverse();
        let [length, sigma] = calibration
            .uncertainty
            .baselines_m
            .get(&fit.name)
            .map_or([cam_from_rig.translation.norm(), f64::NAN], |b| *b);
        let [x, y, z]: [f64; 3] = rig_from_cam.translation.into();
        let [rx, ry, rz]: [f64; 3] = rig_from_cam.rodrigues().into();
        let mm = |metres: f64| to_sigma(1e3 * metres, Some(1e3 * sigma));
        let degrees = |radians: f64| format!("{:.4}", radians.to_degrees());
        rows.push(row([
            &fit.name,
            &with_sigma(1e3 * length, Some(1e3 * sigma)),
            &mm(x),
            &mm(y),
            &mm(z),
            &degrees(rx),
            &degrees(ry),
            &degrees(rz),
            &degrees(cam_from_rig.angle()),
        ]));
    }
    let name = &calibration.cameras.as_slice()[reference.index()].name;
    let mut note =
        format!("position and orientation (Rodrigues vector) of each camera in the frame of {name}\n");
    for (fit, RigCamera { time_offset_s, .. }) in calibrated(calibration) {
        let sigma_s = calibration.uncertainty.sigma(&format!("{}.time_offset_s", fit.name));
        if *time_offset_s != 0.0 || sigma_s.is_some() {
            let late_ms = with_sigma(1e3 * time_offset_s, sigma_s.map(|sigma_s| 1e3 * sigma_s));
            let _ = writeln!(note, "{}: {late_ms} ms later than {name}", fit.name);
        }
    }
    (rows.len() > 1).then(|| aligned(&rows) + &note)
}

/// Returns how late the rows of cameras are, or `None` where they are taken as of one instant.
fn rows_in_time(calibration: &Calibration) -> Option<String> {
    let mut rows = vec![row(["rows", "delay us", "first to last ms"])];
    for (fit, RigCamera { camera, line_delay_s, .. }) in calibrated(calibration) {
        let sigma_s = calibration.uncertainty.sigma(&format!("{}.line_delay_s", fit.name));
        if *line_delay_s != 0.0 || sigma_s.is_some() {
            let delay_us = with_sigma(1e6 * line_delay_s, sigma_s.map(|sigma_s| 1e6 * sigma_s));
            let n_delays = f64::from(camera.image_size[1].saturating_sub(1));
            rows.push(row([&fit.name, &delay_us, &format!("{:.2}", 1e3 * line_delay_s * n_delays)]));
        }
    }
    (rows.len() > 1).then(|| aligned(&rows))
}

/// Returns how well frames are predicted that were left out.
pub(crate) fn unseen(held_out: &HeldOut) -> String {
    let HeldOut { folds, frames, rms_px, in_sample_rms_px, ratio, transfer, .. } = held_out;
    let mut text = format!(
        "{rms_px:.4} px on frames left out of the solve, {in_sample_rms_px:.4} px on those in it: {ratio:.3} times\n        \
         per degree of freedom, over {}, {}",
        count(*frames, "frame"),
        if folds == frames { "each left out alone".to_owned() } else { format!("in {folds} parts") },
    );
    if let Some(transfer) = transfer {
        text.push_str(&format!(
            "\n        {:.4} px and {:.4} mm at the target from one camera's view of such a frame to another's",
            transfer.rms_px, transfer.rms_mm
        ));
    }
    text
}

fn solve(calibration: &Calibration) -> String {
    let mut rows = Vec::new();
    for (target, belief) in calibration.targets.iter().zip(&calibration.scene.targets) {
        let value = match target.shape {
            Shape::Rigid => "as drawn".to_owned(),
            Shape::Parabolic2 | Shape::Twisted6 => {
                let coefficient = |j: usize, value: f64| {
                    let sigma = calibration.uncertainty.sigma(&format!("{}.shape{j}_m", target.name));
                    with_sigma(1e3 * value, sigma.map(|sigma| 1e3 * sigma))
                };
                let bends: Vec<String> =
                    belief.shape_m.iter().enumerate().map(|(j, value)| coefficient(j, *value)).collect();
                match bends.as_slice() {
                    [x, y] => format!("{x} and {y} mm out of flat at its middle, by the bends along x and y"),
                    _ => format!(
                        "{} mm out of flat, by the bends along x and y, a twist, the changes of both bends from edge to edge, and the bend of the middle",
                        bends.join(", ")
                    ),
                }
            }
        };
        rows.push(("target", value));
    }
    let uncertainty = &calibration.uncertainty;
    rows.push((
        "noise",
        match &uncertainty.unavailable {
            Some(why) => format!("no sigmas: {why}"),
            None => format!(
                "the residuals scatter by {} times the stated sigma of a corner; {} degrees of freedom",
                significant(uncertainty.noise_factor),
                uncertainty.degrees_of_freedom
            ),
        },
    ));
    if let Some(held_out) = &calibration.held_out {
        rows.push(("unseen", unseen(held_out)));
    }
    let solve = &calibration.solve;
    rows.push((
        "solve",
        format!(
            "{}; {}, {}",
            solve.stop,
            count(solve.passes, "pass").replace("passs", "passes"),
            count(solve.iterations, "step")
        ),
    ));
    rows.iter().map(|(name, value)| format!("{name:<6}  {value}\n")).collect()
}
