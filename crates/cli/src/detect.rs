//! `boresight detect`.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use boresight::{
    Observation, OutputFile, Target, corners_to_csv, detect_images, load_images, overlay_to_png, read_image,
    write_files,
};

use crate::arguments::DetectArguments;
use crate::calibrate::tell_findings;
use crate::failure::{Failure, Reason};
use crate::streams::{answer, note};
use crate::table::{aligned, row};
use crate::{inputs, progress};

/// Detects the target in images, and prints the corners as a table that `calibrate` reads, or writes files.
pub(crate) fn run(arguments: &DetectArguments) -> Result<ExitCode, Failure> {
    let overrides = inputs::overrides(&arguments.input);
    let paths: Vec<PathBuf> = inputs::paths(&arguments.input)?;
    let Some(images) = load_images(&paths, &overrides)? else {
        return Err(Failure::new(Reason::Usage, "there are no images among the inputs")
            .with_hint("name images, folders of images, or patterns such as 'left*.jpg'"));
    };
    let (bar, tell) = progress::of_images();
    let seen = detect_images(&images, &tell);
    bar.finish_and_clear();

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
    let table = aligned(&rows);
    note(&table);
    let job = images.with_detections(seen)?;
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
            note(&total);
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
