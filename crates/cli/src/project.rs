//! `boresight project` and `boresight unproject`: lines of stdin in, lines of stdout out.

use std::io::{BufRead as _, BufWriter, ErrorKind, Write as _, stdin, stdout};
use std::path::Path;
use std::process::ExitCode;

use boresight::{NamedCamera, Pose, Vector3};

use crate::arguments::{PointFrame, ProjectArguments};
use crate::compare::read_any;
use crate::failure::{Failure, Reason};
use crate::streams::note;

/// Projects points to pixels; a point that the camera does not see gives `nan nan`.
pub(crate) fn project(arguments: &ProjectArguments) -> Result<ExitCode, Failure> {
    let (NamedCamera { camera, name, .. }, cam_from_frame) = camera_and_pose(arguments)?;
    let unseen =
        each_line("x y z", |[x, y, z]: [f64; 3]| camera.project(&(cam_from_frame * Vector3::new(x, y, z))))?;
    if unseen > 0 {
        note(&format!("note: camera {name} does not see {unseen} of the points; their lines are `nan nan`"));
    }
    Ok(ExitCode::SUCCESS)
}

/// Turns pixels into unit directions; a pixel that sees nothing gives `nan nan nan`.
pub(crate) fn unproject(arguments: &ProjectArguments) -> Result<ExitCode, Failure> {
    let (NamedCamera { camera, name, .. }, cam_from_frame) = camera_and_pose(arguments)?;
    let frame_from_cam = cam_from_frame.inverse();
    let unseen = each_line("u v", |pixel: [f64; 2]| {
        camera.unproject(pixel).map(|direction| <[f64; 3]>::from(frame_from_cam.rotation * direction))
    })?;
    if unseen > 0 {
        note(&format!(
            "note: {unseen} of the pixels of camera {name} have no direction; their lines are `nan nan nan`"
        ));
    }
    Ok(ExitCode::SUCCESS)
}

/// Returns the camera, and its pose relative to the frame of the points.
fn camera_and_pose(arguments: &ProjectArguments) -> Result<(NamedCamera, Pose), Failure> {
    let camera = choose(&arguments.result, arguments.camera.as_deref())?;
    let pose = match arguments.frame {
        PointFrame::Camera => Pose::identity(),
        PointFrame::Rig => camera.cam_from_rig.ok_or_else(|| {
            let message = format!(
                "{}: the file does not tell where camera {} sits",
                arguments.result.display(),
                camera.name
            );
            Failure::new(Reason::Usage, message).with_hint("use --frame camera")
        })?,
    };
    Ok((camera, pose))
}

fn choose(path: &Path, name: Option<&str>) -> Result<NamedCamera, Failure> {
    let mut cameras = read_any(path)?;
    let known = cameras.iter().map(|camera| camera.name.as_str()).collect::<Vec<_>>().join(", ");
    let position = match name {
        Some(name) => cameras.iter().position(|camera| camera.name == name),
        None => (cameras.len() == 1).then_some(0),
    };
    let Some(position) = position else {
        let message = match name {
            Some(name) => format!("--camera {name}: {} has no camera `{name}`", path.display()),
            None => format!("{} has {} cameras; --camera must say which", path.display(), cameras.len()),
        };
        return Err(Failure::new(Reason::Usage, message).with_hint(format!("the cameras are {known}")));
    };
    Ok(cameras.swap_remove(position))
}

/// Writes one line for each line of stdin, and returns for how many there was no answer.
fn each_line<const N: usize, const M: usize>(
    columns: &str,
    map: impl Fn([f64; N]) -> Option<[f64; M]>,
) -> Result<usize, Failure> {
    let mut out = BufWriter::new(stdout().lock());
    let mut unseen = 0;
    for (i, line) in stdin().lock().lines().enumerate() {
        let bad = |what: String| {
            let hint = format!("each line is {columns}, separated by spaces");
            Failure::new(Reason::Input, format!("stdin:{}: {what}", i + 1)).with_hint(hint)
        };
        let line = line.map_err(|error| bad(error.to_string()))?;
        let line = line.split('#').next().unwrap_or_default().trim();
        if line.is_empty() {
            continue;
        }
        let values = numbers::<N>(line).map_err(bad)?;
        let answer = map(values);
        unseen += usize::from(answer.is_none());
        let cells = answer
            .unwrap_or([f64::NAN; M])
            .map(|value| if value.is_nan() { "nan".to_owned() } else { format!("{value:?}") });
        match writeln!(out, "{}", cells.join(" ")) {
            Err(error) if error.kind() == ErrorKind::BrokenPipe => return Ok(unseen),
            Err(error) => return Err(cannot_write(&error)),
            Ok(()) => {}
        }
    }
    match out.flush() {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(cannot_write(&error)),
        _ => Ok(unseen),
    }
}

fn cannot_write(error: &std::io::Error) -> Failure {
    Failure::new(Reason::CannotWrite, format!("stdout: cannot be written: {error}"))
}

/// Returns the numbers of a line, separated by spaces, tabs or commas.
fn numbers<const N: usize>(line: &str) -> Result<[f64; N], String> {
    let words: Vec<&str> = line.split([' ', '\t', ',']).filter(|word| !word.is_empty()).collect();
    if words.len() != N {
        return Err(format!("the line has {} numbers, {N} are needed", words.len()));
    }
    let mut values = [0.0; N];
    for (value, word) in values.iter_mut().zip(words) {
        let parsed = word.parse::<f64>().ok().filter(|value| value.is_finite());
        *value = parsed.ok_or_else(|| format!("`{word}` is no finite number"))?;
    }
    Ok(values)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_read() {
        assert_eq!(numbers::<3>("1, -2.5\t3e-1"), Ok([1.0, -2.5, 0.3]));
        assert_eq!(numbers::<2>("1"), Err("the line has 1 numbers, 2 are needed".to_owned()));
        assert_eq!(numbers::<2>("1 x"), Err("`x` is no finite number".to_owned()));
        assert!(numbers::<1>("nan").is_err() && numbers::<1>("inf").is_err());
    }
}
