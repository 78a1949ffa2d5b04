//! From images to a job: the target is detected in all of them at once.

use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use boresight_data::{Geometry, GrayImage, Target};
use boresight_detect::{DETECTORS_REVISION, Detection, Missed, Pattern, detect};
use boresight_io::{
    DetectionCache, ImageFile, ImageJob, Job, JobOverrides, SeenImage, SizeSeen, image_from_bytes,
    load_images, load_job, load_recordings,
};
use rayon::prelude::*;

use crate::error::Error;
use crate::recordings::detect_recordings;

/// Hears how many images are done, and of how many; called from several threads.
pub type ImageProgress<'a> = &'a (dyn Fn(usize, usize) + Sync);

/// What a detection may use and who follows it.
#[derive(Clone, Copy)]
pub struct DetectWatch<'a> {
    /// Hears of each image.
    pub progress: ImageProgress<'a>,
    /// What was detected before; see [`detection_cache`].
    pub cache: &'a DetectionCache,
    /// Where the time goes is added up here.
    pub stages: &'a Stages,
}

/// Where the time of a detection went, added up over threads.
#[derive(Debug, Default)]
pub struct Stages {
    read_ns: AtomicU64,
    decode_ns: AtomicU64,
    detect_ns: AtomicU64,
    images: AtomicUsize,
    remembered: AtomicUsize,
}

impl Stages {
    /// Returns the time in which bytes were read and unpacked.
    pub fn read(&self) -> Duration {
        Duration::from_nanos(self.read_ns.load(Ordering::Relaxed))
    }

    /// Returns the time in which bytes became grey values.
    pub fn decode(&self) -> Duration {
        Duration::from_nanos(self.decode_ns.load(Ordering::Relaxed))
    }

    /// Returns the time in which the target was looked for.
    pub fn detect(&self) -> Duration {
        Duration::from_nanos(self.detect_ns.load(Ordering::Relaxed))
    }

    /// Returns how many images there were.
    pub fn images(&self) -> usize {
        self.images.load(Ordering::Relaxed)
    }

    /// Returns in how many of them nothing was detected anew, as the cache knew what there is.
    pub fn remembered(&self) -> usize {
        self.remembered.load(Ordering::Relaxed)
    }

    pub(crate) fn add_read(&self, time: Duration) {
        add(&self.read_ns, time);
    }

    pub(crate) fn count(&self) {
        self.images.fetch_add(1, Ordering::Relaxed);
    }
}

fn add(sum: &AtomicU64, time: Duration) {
    sum.fetch_add(u64::try_from(time.as_nanos()).unwrap_or(u64::MAX), Ordering::Relaxed);
}

/// Returns what was detected of `target` before, as a file remembers it.
pub fn detection_cache(path: &std::path::Path, target: &Target) -> DetectionCache {
    DetectionCache::read(path, target, &format!("detectors {DETECTORS_REVISION}"))
}

/// Loads a job from corner files, or detects the target where `inputs` are images or recordings.
pub fn load(inputs: &[PathBuf], overrides: &JobOverrides, progress: ImageProgress) -> Result<Job, Error> {
    let (cache, stages) = (DetectionCache::default(), Stages::default());
    let watch = DetectWatch { progress, cache: &cache, stages: &stages };
    if let Some(recordings) = load_recordings(inputs, overrides)? {
        let (contents, seen) = detect_recordings(&recordings, &watch)?;
        return Ok(recordings.with_detections(contents, seen)?);
    }
    match load_images(inputs, overrides)? {
        Some(images) => {
            let seen = detect_images(&images, &watch);
            Ok(images.with_detections(seen)?)
        }
        None => Ok(load_job(inputs, overrides)?),
    }
}

/// Detects the target of a job in each of its images, several at a time; the result does not depend on how many.
pub fn detect_images(job: &ImageJob, watch: &DetectWatch<'_>) -> Vec<Result<SeenImage, boresight_io::Error>> {
    let done = AtomicUsize::new(0);
    let total = job.images.len();
    (watch.progress)(0, total);
    let look = |image: &ImageFile| {
        let seen = detect_in(image, job, watch);
        (watch.progress)(done.fetch_add(1, Ordering::Relaxed) + 1, total);
        seen
    };
    job.images.par_iter().map(look).collect()
}

fn detect_in(
    image: &ImageFile,
    job: &ImageJob,
    watch: &DetectWatch<'_>,
) -> Result<SeenImage, boresight_io::Error> {
    let begin = Instant::now();
    let file = image.path.display().to_string();
    let wrong = |source| boresight_io::Error::Read { file: file.clone(), source };
    let bytes = std::fs::read(&image.path).map_err(wrong)?;
    let hash = boresight_io::hash(&bytes);
    watch.stages.count();
    watch.stages.add_read(begin.elapsed());
    look_up_or_detect(hash, job.target(), watch, || {
        let read = image_from_bytes(&file, &bytes)?;
        Ok((read.image, read.is_turned))
    })
}

/// Returns what the cache knows of an image, or decodes it and detects the target; `decode` also says whether the image
/// asks to be turned.
pub(crate) fn look_up_or_detect<E>(
    hash: String,
    target: &Target,
    watch: &DetectWatch<'_>,
    decode: impl FnOnce() -> Result<(GrayImage, bool), E>,
) -> Result<SeenImage, E> {
    if let Some(known) = watch.cache.get(&hash) {
        watch.stages.remembered.fetch_add(1, Ordering::Relaxed);
        return Ok(known.clone());
    }
    let begin = Instant::now();
    let (image, is_turned) = decode()?;
    let decoded = Instant::now();
    add(&watch.stages.decode_ns, decoded - begin);
    let detection = detect(&image, target);
    add(&watch.stages.detect_ns, decoded.elapsed());
    let size = size_seen(&detection, target);
    Ok(SeenImage {
        hash,
        image_size: image.size(),
        is_turned,
        observations: detection.observations,
        missed: detection.missed.map(|missed| missed.to_string()),
        size,
        is_legacy: detection.pattern == Some(Pattern::Legacy),
    })
}

/// Returns what a detection says of the size of the target.
fn size_seen(detection: &Detection, target: &Target) -> SizeSeen {
    match detection.missed {
        None if detection.shows_size => SizeSeen::AsDeclared,
        Some(
            Missed::OtherSize { columns, rows }
            | Missed::TooLarge { columns, rows }
            | Missed::OtherSquares { columns, rows }
            | Missed::OtherTags { columns, rows },
        ) => SizeSeen::Other([columns, rows]),
        Some(Missed::OtherDots { columns, rows, layout: seen }) => match target.geometry {
            Geometry::Circles { layout, .. } if layout == seen => SizeSeen::Other([columns, rows]),
            _ => SizeSeen::Open,
        },
        Some(Missed::Short { columns, rows }) => SizeSeen::Short([columns, rows]),
        _ => SizeSeen::Open,
    }
}
