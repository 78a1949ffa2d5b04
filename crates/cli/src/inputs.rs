//! From the arguments to a loaded job.

use std::path::PathBuf;
use std::str::FromStr;

use boresight::{
    Job, JobOverrides, RobotOverrides, Target, detect_images, is_pattern, load_images, load_job,
};

use crate::arguments::InputArguments;
use crate::failure::{Failure, Reason};
use crate::progress;

/// The size of the images of a camera, or of all.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ImageSize {
    /// The camera; `None` is all.
    pub camera: Option<String>,
    /// Width and height in pixels.
    pub size: [u32; 2],
}

impl FromStr for ImageSize {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (camera, size) = match text.rsplit_once('=') {
            Some((name, size)) => (Some(name.to_owned()), size),
            None => (None, text),
        };
        let parts: Vec<Option<u32>> =
            size.split(['x', 'X', '×']).map(|part| part.parse().ok().filter(|side| *side > 0)).collect();
        match parts[..] {
            [Some(width), Some(height)] if camera.as_deref() != Some("") => {
                Ok(Self { camera, size: [width, height] })
            }
            _ => {
                Err("write width x height in pixels, such as 640x480, or NAME=640x480 for one camera"
                    .to_owned())
            }
        }
    }
}

/// Reads a target; a mistake is told with the way to write it.
pub(crate) fn parse_target(spec: &str) -> Result<Target, String> {
    boresight::parse_target(spec).map_err(|error| match error.hint() {
        Some(hint) => format!("{error}; {hint}"),
        None => error.to_string(),
    })
}

/// A camera and the pattern of its images' names.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct CameraImages {
    /// The camera.
    pub name: String,
    /// The pattern, with `*` and `?`.
    pub pattern: String,
}

impl FromStr for CameraImages {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.split_once('=') {
            Some((name, pattern)) if !name.is_empty() && !pattern.is_empty() => {
                Ok(Self { name: name.to_owned(), pattern: pattern.to_owned() })
            }
            _ => Err("write NAME=PATTERN, such as left='left*.png'".to_owned()),
        }
    }
}

/// Returns the inputs that the arguments name; those that do not exist are answered at once.
pub(crate) fn paths(arguments: &InputArguments) -> Result<Vec<PathBuf>, Failure> {
    let inputs: Vec<PathBuf> = arguments.config.iter().chain(&arguments.inputs).cloned().collect();
    for path in inputs.iter().filter(|path| !is_pattern(path)) {
        // Otherwise a mistyped name would be answered with a question about the target.
        if let Err(error) = std::fs::metadata(path) {
            let message = format!("{}: cannot be read: {error}", path.display());
            return Err(Failure::new(Reason::Input, message).with_hint("is the path right?"));
        }
    }
    Ok(inputs)
}

/// Returns what the arguments say in place of a job file.
pub(crate) fn overrides(arguments: &InputArguments) -> JobOverrides {
    let of_all = arguments.image_size.iter().rev().find(|size| size.camera.is_none()).map(|size| size.size);
    let camera = |camera: &CameraImages| (camera.name.clone(), camera.pattern.clone());
    JobOverrides {
        target: arguments.target.clone(),
        image_size: of_all,
        sigma_px: None,
        cameras: arguments.camera.iter().map(camera).collect(),
        robot: RobotOverrides::default(),
    }
}

/// Loads the job that the arguments name, with the corners of images detected.
pub(crate) fn load(arguments: &InputArguments) -> Result<Job, Failure> {
    load_with_robot(arguments, RobotOverrides::default())
}

/// Loads the job that the arguments name, with what the command line says of its robot.
pub(crate) fn load_with_robot(arguments: &InputArguments, robot: RobotOverrides) -> Result<Job, Failure> {
    let inputs = paths(arguments)?;
    let mut overrides = JobOverrides { robot, ..overrides(arguments) };
    if let Some(images) = load_images(&inputs, &overrides)? {
        let (bar, tell) = progress::of_images();
        let seen = detect_images(&images, &tell);
        bar.finish_and_clear();
        return Ok(images.with_detections(seen)?);
    }
    let sizes = &arguments.image_size;
    let named = || sizes.iter().filter_map(|size| Some((size.camera.as_deref()?, size.size)));
    let largest = named().map(|(_, size)| size).reduce(|a, b| [a[0].max(b[0]), a[1].max(b[1])]);
    let mut must_be_named = false;
    let loaded = match (load_job(&inputs, &overrides), largest) {
        (Err(boresight::IoError::NoImageSize { .. }), Some(_)) => {
            // Without a job the sizes of all cameras come from the command line, one by one.
            overrides.image_size = largest;
            must_be_named = true;
            load_job(&inputs, &overrides)
        }
        (loaded, _) => loaded,
    };
    let mut job = loaded.map_err(|error| match error {
        boresight::IoError::NoImageSize { ref camera } => {
            let hint = format!(
                "add --image-size WIDTHxHEIGHT, or --image-size {camera}=WIDTHxHEIGHT for this camera"
            );
            Failure::new(Reason::Usage, error.to_string()).with_hint(hint)
        }
        error => error.into(),
    })?;
    for (name, size) in named() {
        let Some(camera) = job.dataset.cameras.iter_mut().find(|camera| camera.name == name) else {
            let known: Vec<&str> = job.dataset.cameras.iter().map(|camera| camera.name.as_str()).collect();
            let message = format!("--image-size {name}={}x{}: there is no camera `{name}`", size[0], size[1]);
            return Err(Failure::new(Reason::Usage, message)
                .with_hint(format!("the cameras are {}", known.join(", "))));
        };
        camera.image_size = size;
    }
    if must_be_named {
        let unnamed = job.dataset.cameras.iter().find(|camera| named().all(|(name, _)| name != camera.name));
        if let Some(camera) = unnamed {
            let message = format!("camera {}: the size of its image is not known", camera.name);
            let hint = format!("add --image-size {}=WIDTHxHEIGHT", camera.name);
            return Err(Failure::new(Reason::Usage, message).with_hint(hint));
        }
    }
    Ok(job)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn image_sizes_are_read() {
        let size = |text: &str| text.parse::<ImageSize>();
        assert_eq!(size("640x480"), Ok(ImageSize { camera: None, size: [640, 480] }));
        assert_eq!(size("a=b=640X480"), Ok(ImageSize { camera: Some("a=b".to_owned()), size: [640, 480] }));
        for text in ["", "640", "640x", "0x480", "640x480x3", "=640x480", "-1x2", "left=640"] {
            assert!(size(text).is_err(), "{text}");
        }
    }
}
