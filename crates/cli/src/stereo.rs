//! `boresight stereo`: lines of pixels in, points with their sigmas out.

use std::io::{BufRead as _, stdin};
use std::path::PathBuf;
use std::process::ExitCode;

use boresight::{KnownRig, Pose, Stereo, Vector3};
use clap::{Args, ValueEnum};

use crate::failure::{Failure, Reason};
use crate::figures::count;
use crate::streams::{answer, note};

#[derive(Args, Debug)]
pub(crate) struct StereoArguments {
    /// A calibration.json or its folder, or another file that tells where cameras sit
    pub result: PathBuf,
    /// The cameras, in the order of the pixels; the first is `left` [default: all]
    #[arg(long, value_name = "NAME,...", value_delimiter = ',')]
    pub cameras: Vec<String>,
    /// One camera that was moved, in place of several: each further pose as the rotation vector and
    /// translation that lead from its first pose to it (cam_from_first); may be repeated
    #[arg(long, value_name = "RX,RY,RZ,TX,TY,TZ (rad, m)", allow_hyphen_values = true)]
    pub moved: Vec<String>,
    /// The standard deviation of a pixel coordinate
    #[arg(long, value_name = "PX", default_value_t = 0.1)]
    pub sigma_px: f64,
    /// How points are found
    #[arg(long, value_enum, default_value_t = Method::Optimal)]
    pub method: Method,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Method {
    /// The most likely point, by the residuals in all images
    Optimal,
    /// The textbook's parallel equations after rectification, for two cameras
    Rectified,
}

/// Prints a point for each line of pixels.
pub(crate) fn run(arguments: &StereoArguments) -> Result<ExitCode, Failure> {
    if !(arguments.sigma_px.is_finite() && arguments.sigma_px > 0.0) {
        return Err(Failure::new(
            Reason::Usage,
            format!("--sigma-px {}: it must be positive", arguments.sigma_px),
        ));
    }
    let rig = KnownRig::read(&arguments.result)?;
    let stereo = if arguments.moved.is_empty() {
        Stereo::of_cameras(&rig, &arguments.cameras)?
    } else {
        let poses: Vec<Pose> = arguments.moved.iter().map(|text| pose(text)).collect::<Result<_, _>>()?;
        if arguments.cameras.len() > 1 {
            let names = arguments.cameras.join(",");
            let message = format!("--moved is of one camera, and --cameras names {names}");
            return Err(Failure::new(Reason::Usage, message).with_hint("name the one that was moved"));
        }
        if poses.iter().all(|pose| pose.translation.norm() == 0.0) {
            let message = "--moved leaves the camera where it was: depth needs a distance between its places";
            let hint =
                "after the rotation, write tx,ty,tz in metres that lead from its first place to the other";
            return Err(Failure::new(Reason::Usage, message).with_hint(hint));
        }
        Stereo::of_moved_camera(&rig, arguments.cameras.first().map(String::as_str), &poses)?
    };
    let n = stereo.names().len();
    if rig.names.is_empty() {
        note("note: the calibration tells no covariance; sigmas are by the pixels alone");
    }
    let mut text = match arguments.method {
        Method::Optimal => "# x_m y_m z_m sigma_x_m sigma_y_m sigma_z_m rms_px\n".to_owned(),
        Method::Rectified => "# x_m y_m z_m row_disparity\n".to_owned(),
    };
    let (mut lines, mut without) = (0, 0);
    let mut large = 0;
    for (i, line) in stdin().lock().lines().enumerate() {
        let bad = |what: String| {
            let hint = format!(
                "each line is u v of {} in this order; nan nan where it sees nothing",
                stereo.names().join(", ")
            );
            Failure::new(Reason::Input, format!("stdin:{}: {what}", i + 1)).with_hint(hint)
        };
        let line = line.map_err(|error| bad(error.to_string()))?;
        let line = line.split('#').next().unwrap_or_default().trim();
        if line.is_empty() {
            continue;
        }
        lines += 1;
        let pixels = pixels(line, n).map_err(bad)?;
        let cells = match arguments.method {
            Method::Optimal => stereo.fix(&pixels, arguments.sigma_px).map(|fix| {
                let chi2 = fix.point.chi2;
                // Four sigmas beyond what so many degrees of freedom have.
                let dof = fix.point.degrees_of_freedom as f64;
                large += usize::from(chi2 > dof + 4.0 * (2.0 * dof).sqrt() + 6.0);
                let sum: f64 =
                    fix.point.residuals_px.iter().flatten().map(|residual| residual * residual).sum();
                let rms = (sum / fix.point.residuals_px.len() as f64).sqrt();
                <[f64; 3]>::from(fix.point.point_in_ref)
                    .into_iter()
                    .chain(fix.sigma_m())
                    .chain([rms])
                    .collect::<Vec<f64>>()
            }),
            Method::Rectified => {
                let both = match pixels[..] {
                    [Some(left), Some(right), ..] => stereo.rectified([left, right]),
                    _ => None,
                };
                let found = both.map(|found| {
                    <[f64; 3]>::from(found.point_in_left).into_iter().chain([found.row_disparity]).collect()
                });
                found.ok_or_else(|| {
                    boresight::RobotError::TooFew { what: "pixels that meet", found: 0, need: 2 }.into()
                })
            }
        };
        let columns = if arguments.method == Method::Optimal { 7 } else { 4 };
        without += usize::from(cells.is_err());
        let cells = cells.unwrap_or_else(|_| vec![f64::NAN; columns]);
        let cells: Vec<String> = cells
            .iter()
            .map(|value| if value.is_nan() { "nan".to_owned() } else { format!("{value:?}") })
            .collect();
        text.push_str(&cells.join(" "));
        text.push('\n');
    }
    answer(text.as_bytes())?;
    if without > 0 {
        note(&format!(
            "note: {} of {} has no point in front of the cameras; `nan` stands for it",
            count(without, "line"),
            lines
        ));
    }
    if large > 0 {
        note(&format!(
            "caution: {} of {lines} misses its pixels by far more than --sigma-px {} explains: is it a true pair, and the calibration still good?",
            count(large, "line"),
            arguments.sigma_px
        ));
    }
    if lines > 0 && without == lines {
        return Err(Failure::new(Reason::Solve, "no line has a point in front of the cameras")
            .with_hint("are the cameras in the order of the pixels?"));
    }
    Ok(ExitCode::SUCCESS)
}

fn pixels(line: &str, n: usize) -> Result<Vec<Option<[f64; 2]>>, String> {
    let words: Vec<&str> = line.split([' ', '\t', ',']).filter(|word| !word.is_empty()).collect();
    if words.len() != 2 * n {
        return Err(format!("the line has {} numbers, {} are needed", words.len(), 2 * n));
    }
    let mut pixels = Vec::with_capacity(n);
    for pair in words.chunks(2) {
        let mut pixel = [0.0; 2];
        for (value, word) in pixel.iter_mut().zip(pair) {
            *value = word.parse::<f64>().map_err(|_| format!("`{word}` is no number"))?;
        }
        pixels.push(pixel.iter().all(|value| value.is_finite()).then_some(pixel));
    }
    Ok(pixels)
}

fn pose(text: &str) -> Result<Pose, Failure> {
    let numbers: Vec<f64> = text.split(',').filter_map(|word| word.trim().parse().ok()).collect();
    match numbers[..] {
        [rx, ry, rz, tx, ty, tz] if numbers.iter().all(|number| number.is_finite()) => {
            Ok(Pose::from_rodrigues(Vector3::new(rx, ry, rz), Vector3::new(tx, ty, tz)))
        }
        _ => Err(Failure::new(Reason::Usage, format!("--moved {text}: six numbers are needed"))
            .with_hint("rx,ry,rz in radians and tx,ty,tz in metres, separated by commas")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_of_pixels_are_read() {
        assert_eq!(pixels("1 2, 3 4", 2), Ok(vec![Some([1.0, 2.0]), Some([3.0, 4.0])]));
        assert_eq!(pixels("1 2 nan nan", 2), Ok(vec![Some([1.0, 2.0]), None]));
        assert!(pixels("1 2 3", 2).is_err() && pixels("a b", 1).is_err());
        assert!(pose("0,0,0,1,2").is_err());
    }
}
