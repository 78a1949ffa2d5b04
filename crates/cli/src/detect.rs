//! `boresight detect`.

use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use boresight::{
    Job, Observation, OutputFile, RecordingJob, SeenImage, Target, corners_to_csv, load_images,
    load_recordings, overlay_to_png, read_image, refuse_other_size, write_files,
};

use crate::arguments::DetectArguments;
use crate::calibrate::tell_findings;
use crate::failure::{Failure, Reason};
use crate::inputs::{self, InputKind};
use crate::streams::{answer, note};
use crate::table::{aligned, row};

/// Detects the target in images, and prints the corners as a table that `calibrate` reads, or writes files.
pub(crate) fn run(arguments: &DetectArguments) -> Result<ExitCode, Failure> {
    let overrides = inputs::overrides(&arguments.input);
    let paths: Vec<PathBuf> = inputs::paths(&arguments.input)?;
    if let Some(recordings) = load_recordings(&paths, &overrides)? {
        inputs::refuse_idle_flags(&arguments.input, InputKind::Recordings)?;
        return in_recordings(arguments, recordings);
    }
    let Some(images) = load_images(&paths, &overrides)? else {
        return Err(Failure::new(Reason::Usage, "there are no images among the inputs")
            .with_hint("name images, folders of images, patterns such as 'left*.jpg', or MCAP recordings"));
    };
    inputs::refuse_idle_flags(&arguments.input, InputKind::Images)?;
    let mut seen = inputs::detect_in_images(&images, None)?;
    refuse_other_size(images.target(), &mut seen.iter_mut().flatten().collect::<Vec<_>>());

    let mut rows = vec![row(["image", "size", "points", "sigma px", "why not"])];
    for (image, seen) in images.images.iter().zip(&seen) {
        rows.push(match seen {
            Ok(seen) => {
                let [width, height] = seen.image_size;
                let (n, sigma) = (seen.observations.len(), median_sigma(&seen.observations));
                let sigma = sigma.map_or_else(|| "-".to_owned(), |sigma| format!("{sigma:.3}"));
                let why = seen.missed.as_deref().unwrap_or_default();
                row([&image.name, &format!("{width}x{height}"), &n.to_string(), &sigma, why])
            }
            Err(error) => row([&image.name, "-", "0", "-", &error.to_string()]),
        });
    }
    let n_used = seen.iter().flatten().filter(|seen| !seen.observations.is_empty()).count();
    let total = format!("{n_used} of {} images show the target", images.images.len());

    if let Some(folder) = &arguments.overlays {
        let columns = columns_of(images.target());
        for (image, seen) in images.images.iter().zip(&seen) {
            let Ok(seen) = seen else { continue };
            let (read, _) = read_image(image)?;
            let bytes = overlay_to_png(&read.image, &seen.observations, columns)?;
            let name = format!("{}.png", image.name.replace(['/', '\\'], "-"));
            write_files(folder, &[OutputFile { name, bytes }])?;
        }
        note(&format!("overlays: {}", folder.display()));
    }
    note(&aligned(&rows));
    give_corners(arguments, &images.with_detections(seen)?, &total)
}

/// Detects the target in the images of recordings.
fn in_recordings(arguments: &DetectArguments, recordings: RecordingJob) -> Result<ExitCode, Failure> {
    let (contents, mut seen) = inputs::detect_in_recordings(&recordings, None)?;
    let seen_images = seen.iter_mut().filter_map(|seen| Some(&mut seen.seen.as_mut().ok()?.1));
    refuse_other_size(recordings.target(), &mut seen_images.collect::<Vec<_>>());
    let mut rows = vec![row(["topic", "images", "with the target", "points", "sigma px", "unreadable"])];
    let mut n_used = 0;
    for (topic_idx, topic) in contents.topics.iter().enumerate().filter(|(_, topic)| topic.is_of_images()) {
        let of_topic = || seen.iter().filter(|seen| seen.topic_idx == topic_idx);
        if of_topic().next().is_none() {
            rows.push(row([&topic.name, &topic.messages.to_string(), "not used"]));
            continue;
        }
        let readable = || of_topic().filter_map(|seen| seen.seen.as_ref().ok());
        let used = readable().filter(|(_, seen)| !seen.observations.is_empty()).count();
        n_used += used;
        let observations: Vec<Observation> =
            readable().flat_map(|(_, seen)| seen.observations.iter().copied()).collect();
        let sigma = median_sigma(&observations);
        rows.push(row([
            &topic.name,
            &of_topic().count().to_string(),
            &used.to_string(),
            &observations.len().to_string(),
            &sigma.map_or_else(|| "-".to_owned(), |sigma| format!("{sigma:.3}")),
            &(of_topic().count() - readable().count()).to_string(),
        ]));
    }
    let total = format!("{n_used} of {} images show the target", seen.len());
    if let Some(folder) = &arguments.overlays {
        let known: BTreeMap<(usize, usize), &SeenImage> = seen
            .iter()
            .filter_map(|seen| Some(((seen.topic_idx, seen.index), &seen.seen.as_ref().ok()?.1)))
            .collect();
        let columns = columns_of(recordings.target());
        let mut wrong = None;
        recordings.read(&mut |image| {
            let Some(seen) = known.get(&(image.topic_idx, image.index)) else {
                return ControlFlow::Continue(());
            };
            let Ok(image_seen) = image.open().and_then(|opened| opened.decode()) else {
                return ControlFlow::Continue(());
            };
            let topic = contents.topics.get(image.topic_idx).map_or("", |topic| topic.name.as_str());
            let name =
                format!("{}-{:06}.png", topic.trim_matches('/').replace(['/', '\\'], "-"), image.index);
            let written = overlay_to_png(&image_seen, &seen.observations, columns)
                .and_then(|bytes| write_files(folder, &[OutputFile { name, bytes }]));
            match written {
                Ok(()) => ControlFlow::Continue(()),
                Err(error) => {
                    wrong = Some(error);
                    ControlFlow::Break(())
                }
            }
        })?;
        if let Some(error) = wrong {
            return Err(error.into());
        }
        note(&format!("overlays: {}", folder.display()));
    }
    note(&aligned(&rows));
    give_corners(arguments, &recordings.with_detections(contents, seen)?, &total)
}

/// Tells what was noticed, and prints or writes the corners.
fn give_corners(arguments: &DetectArguments, job: &Job, total: &str) -> Result<ExitCode, Failure> {
    tell_findings(&job.findings);
    let corners = corners_to_csv(&job.dataset).into_bytes();
    match &arguments.output {
        Some(path) => {
            let folder = path.parent().unwrap_or(Path::new(""));
            let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
            write_files(folder, &[OutputFile { name, bytes: corners }])?;
            answer(format!("{total}\nwritten: {}\n", path.display()).as_bytes())?;
        }
        None => {
            note(total);
            answer(&corners)?;
        }
    }
    Ok(ExitCode::SUCCESS)
}

fn median_sigma(observations: &[Observation]) -> Option<f64> {
    let mut sigmas: Vec<f64> = observations.iter().map(|observation| observation.sigma_px).collect();
    sigmas.sort_by(f64::total_cmp);
    sigmas.get(sigmas.len() / 2).copied()
}

fn columns_of(target: &Target) -> u32 {
    target.geometry.grid().map_or(1, |[columns, _]| columns)
}
