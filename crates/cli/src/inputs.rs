//! From the arguments to a loaded job.

use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Instant;

use boresight::{
    CalibrateOptions, Clock, DetectWatch, DetectionCache, ImageJob, IoError, Job, JobOverrides, RecordingJob,
    RecordingOptions, RobotOverrides, SeenImage, Stages, Target, detect_images, detect_recordings,
    detection_cache, is_pattern, load_images, load_job, load_recordings, with_threads,
};

use crate::arguments::InputArguments;
use crate::failure::{Failure, Reason};
use crate::progress;
use crate::streams::note;

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

/// A time, written with its unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Time {
    /// In nanoseconds.
    pub ns: i64,
}

impl FromStr for Time {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || "write a time with its unit, such as 20ms, 0.5s or 800us".to_owned();
        let units = [("ns", 1.0), ("us", 1e3), ("ms", 1e6), ("s", 1e9)];
        let (number, unit_ns) =
            units.iter().find_map(|(unit, ns)| Some((text.strip_suffix(unit)?, ns))).ok_or_else(wrong)?;
        let number: f64 = number.trim().parse().map_err(|_| wrong())?;
        let ns = number * unit_ns;
        // A million seconds are more than any recording has.
        if (0.0..=1e15).contains(&ns) { Ok(Self { ns: ns.round() as i64 }) } else { Err(wrong()) }
    }
}

/// Which times of a recording are believed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum ClockChoice {
    /// The time stamps in the messages
    Header,
    /// The times of recording
    Log,
}

/// Refuses a second image size for a camera, or for all.
fn refuse_second_sizes(sizes: &[ImageSize]) -> Result<(), Failure> {
    for (i, ImageSize { camera, size: [width, height] }) in sizes.iter().enumerate() {
        if let Some(before) = sizes[..i].iter().find(|before| before.camera == *camera) {
            let of = camera.as_ref().map_or("all cameras".to_owned(), |camera| format!("camera {camera}"));
            let [first_width, first_height] = before.size;
            let message = format!(
                "--image-size is given twice for {of}: {first_width}x{first_height} and {width}x{height}"
            );
            return Err(Failure::new(Reason::Usage, message).with_hint("leave one out"));
        }
    }
    Ok(())
}

/// Returns the inputs that the arguments name; those that do not exist are answered at once, and so is what is said twice.
pub(crate) fn paths(arguments: &InputArguments) -> Result<Vec<PathBuf>, Failure> {
    refuse_second_sizes(&arguments.image_size)?;
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
    let of_all = arguments.image_size.iter().find(|size| size.camera.is_none()).map(|size| size.size);
    let camera = |camera: &CameraImages| (camera.name.clone(), camera.pattern.clone());
    JobOverrides {
        target: arguments.target.clone(),
        image_size: of_all,
        sigma_px: None,
        cameras: arguments.camera.iter().map(camera).collect(),
        robot: RobotOverrides::default(),
        recording: recording_options(arguments),
    }
}

/// Returns what the arguments say of how recordings are read.
fn recording_options(arguments: &InputArguments) -> RecordingOptions {
    RecordingOptions {
        clock: arguments.clock.map(|choice| match choice {
            ClockChoice::Header => Clock::Header,
            ClockChoice::Log => Clock::Log,
        }),
        tolerance_ns: arguments.sync_tolerance.map(|time| time.ns),
    }
}

/// Loads the job that the arguments name, with the corners of images detected.
pub(crate) fn load(arguments: &InputArguments) -> Result<Job, Failure> {
    load_with(arguments, RobotOverrides::default(), None, None)
}

/// Loads the job that the arguments name, with what the command line says of its robot.
pub(crate) fn load_with_robot(arguments: &InputArguments, robot: RobotOverrides) -> Result<Job, Failure> {
    load_with(arguments, robot, None, None)
}

/// Loads the job that the arguments name; what is detected, on so many threads, is remembered in a file.
pub(crate) fn load_remembering(
    arguments: &InputArguments,
    cache: &Path,
    jobs: Option<usize>,
) -> Result<Job, Failure> {
    load_with(arguments, RobotOverrides::default(), Some(cache), jobs)
}

/// Returns an error if there is a file where a folder is to be.
pub(crate) fn refuse_file(folder: &Path) -> Result<(), Failure> {
    if !folder.is_file() {
        return Ok(());
    }
    let message = format!("{} cannot be written: it is a file, and results take a folder", folder.display());
    Err(Failure::new(Reason::CannotWrite, message).with_hint("name another folder with -o"))
}

/// What inputs are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum InputKind {
    /// Recordings.
    Recordings,
    /// Images.
    Images,
    /// Files of corners.
    Corners,
    /// Poses of a target in place of pixels.
    Sights,
    /// Cameras that are calibrated.
    Calibrations,
}

/// Refuses flags that say nothing of inputs of this kind.
pub(crate) fn refuse_idle_flags(arguments: &InputArguments, kind: InputKind) -> Result<(), Failure> {
    use InputKind::{Calibrations, Corners, Images, Recordings, Sights};
    let flags = [
        ("--target", arguments.target.is_some(), &[Recordings, Images, Corners][..]),
        ("--image-size", !arguments.image_size.is_empty(), &[Corners]),
        ("--camera", !arguments.camera.is_empty(), &[Recordings, Images, Corners]),
        ("--clock", arguments.clock.is_some(), &[Recordings]),
        ("--sync-tolerance", arguments.sync_tolerance.is_some(), &[Recordings]),
    ];
    let idle = flags.into_iter().find(|(_, is_given, kinds)| *is_given && !kinds.contains(&kind));
    match idle {
        None => Ok(()),
        Some((flag, ..)) => {
            let what = match kind {
                Recordings => "recordings",
                Images => "images",
                Corners => "files of corners",
                Sights => "poses of a target",
                Calibrations => "calibrations",
            };
            let message = format!("{flag} says nothing of {what}, which the inputs are");
            Err(Failure::new(Reason::Usage, message).with_hint("leave it out"))
        }
    }
}

/// Detects the target in images, tells where the time went, and remembers what was seen.
pub(crate) fn detect_in_images(
    images: &ImageJob,
    cache_path: Option<&Path>,
) -> Result<Vec<Result<SeenImage, IoError>>, Failure> {
    let detecting = Detecting::new(images.target(), cache_path);
    let seen = detecting.watched(|watch| detect_images(images, watch));
    detecting.finish(seen.iter().flatten())?;
    Ok(seen)
}

/// Detects the target in the images of recordings, tells where the time went, and remembers what was seen.
pub(crate) fn detect_in_recordings(
    recordings: &RecordingJob,
    cache_path: Option<&Path>,
) -> Result<(boresight::Contents, Vec<boresight::SeenRecorded>), Failure> {
    let detecting = Detecting::new(recordings.target(), cache_path);
    let (contents, seen) = detecting.watched(|watch| detect_recordings(recordings, watch))?;
    detecting.finish(seen.iter().filter_map(|seen| seen.seen.as_ref().ok().map(|(_, seen)| seen)))?;
    Ok((contents, seen))
}

/// A detection that is followed and remembered.
struct Detecting<'a> {
    cache: DetectionCache,
    cache_path: Option<&'a Path>,
    stages: Stages,
    begin: Instant,
}

impl<'a> Detecting<'a> {
    fn new(target: &Target, cache_path: Option<&'a Path>) -> Self {
        let cache = cache_path.map(|path| detection_cache(path, target)).unwrap_or_default();
        Self { cache, cache_path, stages: Stages::default(), begin: Instant::now() }
    }

    fn watched<T>(&self, detect: impl FnOnce(&DetectWatch<'_>) -> T) -> T {
        let (bar, tell) = progress::of_images();
        let detected = detect(&DetectWatch { progress: &tell, cache: &self.cache, stages: &self.stages });
        bar.finish_and_clear();
        detected
    }

    /// Tells where the time went, and writes what was seen.
    fn finish<'s>(self, seen: impl Iterator<Item = &'s SeenImage>) -> Result<(), Failure> {
        let stages = &self.stages;
        let remembered = match stages.remembered() {
            0 => String::new(),
            n => format!(", {n} remembered"),
        };
        note(&format!(
            "{} images in {:.2} s: read {:.2} s; on all threads together decode {:.2} s, detect {:.2} s{remembered}",
            stages.images(),
            self.begin.elapsed().as_secs_f64(),
            stages.read().as_secs_f64(),
            stages.decode().as_secs_f64(),
            stages.detect().as_secs_f64(),
        ));
        match self.cache_path {
            Some(path) => Ok(self.cache.write(path, seen)?),
            None => Ok(()),
        }
    }
}

fn load_with(
    arguments: &InputArguments,
    robot: RobotOverrides,
    cache: Option<&Path>,
    jobs: Option<usize>,
) -> Result<Job, Failure> {
    let inputs = paths(arguments)?;
    let mut overrides = JobOverrides { robot, ..overrides(arguments) };
    // A mistake in the options is told before the time of a detection is spent.
    let check_cache = || cache.and_then(Path::parent).map_or(Ok(()), refuse_file);
    if let Some(recordings) = load_recordings(&inputs, &overrides)? {
        refuse_idle_flags(arguments, InputKind::Recordings)?;
        check_cache()?;
        let (table, place) = recordings.options();
        let threads = jobs.unwrap_or(CalibrateOptions::of_table(table, place)?.jobs);
        let (contents, seen) = with_threads(threads, || detect_in_recordings(&recordings, cache))?;
        return Ok(recordings.with_detections(contents, seen)?);
    }
    if let Some(images) = load_images(&inputs, &overrides)? {
        refuse_idle_flags(arguments, InputKind::Images)?;
        check_cache()?;
        let (table, place) = images.options();
        let threads = jobs.unwrap_or(CalibrateOptions::of_table(table, place)?.jobs);
        let seen = with_threads(threads, || detect_in_images(&images, cache))?;
        return Ok(images.with_detections(seen)?);
    }
    refuse_idle_flags(arguments, InputKind::Corners)?;
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
    fn times_are_read() {
        let ns = |text: &str| text.parse::<Time>().map(|time| time.ns).ok();
        assert_eq!(
            [ns("20ms"), ns("0.5 s"), ns("800us"), ns("7ns")],
            [20_000_000, 500_000_000, 800_000, 7].map(Some)
        );
        for text in ["", "20", "ms", "-1ms", "1h", "nans", "1e99s"] {
            assert_eq!(ns(text), None, "{text}");
        }
    }

    #[test]
    fn image_sizes_are_read() {
        let size = |text: &str| text.parse::<ImageSize>();
        assert_eq!(size("640x480"), Ok(ImageSize { camera: None, size: [640, 480] }));
        assert_eq!(size("a=b=640X480"), Ok(ImageSize { camera: Some("a=b".to_owned()), size: [640, 480] }));
        for text in ["", "640", "640x", "0x480", "640x480x3", "=640x480", "-1x2", "left=640"] {
            assert!(size(text).is_err(), "{text}");
        }
        let twice = |texts: &[&str]| {
            let sizes: Vec<ImageSize> = texts.iter().map(|text| size(text).unwrap()).collect();
            refuse_second_sizes(&sizes).is_err()
        };
        assert!(
            !twice(&["1x1", "a=1x2", "b=1x2"])
                && twice(&["1x1", "1x2"])
                && twice(&["a=1x1", "b=1x1", "a=1x1"])
        );
    }
}
