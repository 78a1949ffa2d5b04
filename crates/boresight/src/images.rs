//! From images to a job: the target is detected in all of them at once.

use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};

use boresight_detect::{Missed, detect};
use boresight_io::{ImageFile, ImageJob, Job, JobOverrides, SeenImage, load_images, load_job, read_image};
use rayon::prelude::*;

use crate::error::Error;

/// Hears how many images are done, and of how many; called from several threads.
pub type ImageProgress<'a> = &'a (dyn Fn(usize, usize) + Sync);

/// Loads a job from corner files, or detects the target in images where `inputs` are images.
pub fn load(inputs: &[PathBuf], overrides: &JobOverrides, progress: ImageProgress) -> Result<Job, Error> {
    match load_images(inputs, overrides)? {
        Some(images) => {
            let seen = detect_images(&images, progress);
            Ok(images.with_detections(seen)?)
        }
        None => Ok(load_job(inputs, overrides)?),
    }
}

/// Detects the target of a job in each of its images, several at a time; the result does not depend on how many.
pub fn detect_images(job: &ImageJob, progress: ImageProgress) -> Vec<Result<SeenImage, boresight_io::Error>> {
    let done = AtomicUsize::new(0);
    let total = job.images.len();
    progress(0, total);
    let look = |image: &ImageFile| {
        let seen = detect_in(image, job);
        progress(done.fetch_add(1, Ordering::Relaxed) + 1, total);
        seen
    };
    job.images.par_iter().map(look).collect()
}

fn detect_in(image: &ImageFile, job: &ImageJob) -> Result<SeenImage, boresight_io::Error> {
    let (read, hash) = read_image(image)?;
    let detection = detect(&read.image, job.target());
    let other_size = match detection.missed {
        Some(Missed::OtherSize { columns, rows }) => Some([columns, rows]),
        _ => None,
    };
    Ok(SeenImage {
        hash,
        image_size: read.image.size(),
        is_turned: read.is_turned,
        observations: detection.observations,
        missed: detection.missed.map(|missed| missed.to_string()),
        other_size,
    })
}
