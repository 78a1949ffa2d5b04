//! `boresight init`.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use boresight::{Job, OutputFile, target_spec, write_files};
use clap::Args;

use crate::arguments::InputArguments;
use crate::calibrate::tell_findings;
use crate::failure::{Failure, Reason};
use crate::figures::count;
use crate::inputs;
use crate::streams::answer;

#[derive(Args, Debug)]
pub(crate) struct InitArguments {
    #[command(flatten)]
    pub input: InputArguments,
    /// The file to write
    #[arg(short, long, value_name = "JOB.toml", default_value = "boresight.toml")]
    pub output: PathBuf,
}

/// Looks at the data, and writes a job file that says what the command line said.
pub(crate) fn run(arguments: &InitArguments) -> Result<ExitCode, Failure> {
    let path = &arguments.output;
    if path.exists() {
        let message = format!("{} is there already", path.display());
        return Err(Failure::new(Reason::Usage, message).with_hint("take it away, or name another with -o"));
    }
    let folder = path.parent().unwrap_or(Path::new(""));
    let job = inputs::load(&arguments.input)?;
    let names = names_in(folder, &arguments.input.inputs)?;
    let text = job_text(&job, &names, &arguments.input)?;
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    write_files(folder, &[OutputFile { name, bytes: text.clone().into_bytes() }])?;
    tell_findings(&job.findings);
    let next = format!("written: {}\nnext:    boresight calibrate {0}\n", path.display());
    answer(format!("{text}\n{next}").as_bytes())?;
    Ok(ExitCode::SUCCESS)
}

/// Returns the inputs as the job file has to name them, which is relative to its folder.
fn names_in(folder: &Path, inputs: &[PathBuf]) -> Result<Vec<String>, Failure> {
    if inputs.is_empty() {
        return Err(Failure::new(Reason::Usage, "nothing was named that a job file could be written from"));
    }
    let is_here = folder.as_os_str().is_empty();
    let here = std::env::current_dir().map_err(|error| {
        Failure::new(Reason::Input, format!("the working folder cannot be told: {error}"))
    })?;
    let name = |input: &PathBuf| {
        let path = if is_here || input.is_absolute() { input.clone() } else { here.join(input) };
        path.display().to_string()
    };
    Ok(inputs.iter().map(name).collect())
}

/// Returns the text of the job file.
fn job_text(job: &Job, names: &[String], input: &InputArguments) -> Result<String, Failure> {
    let targets: Vec<_> = job.dataset.targets.iter().collect();
    let spec = targets.first().and_then(|target| target_spec(target)).ok_or_else(|| {
        Failure::new(Reason::Usage, "a target of points cannot be written in a line")
            .with_hint("write [target] kind = \"points\" and file = \"points.csv\" by hand")
    })?;
    let ends_in = |extensions: &[&str]| {
        names.iter().any(|name| extensions.iter().any(|extension| name.to_lowercase().ends_with(extension)))
    };
    let key = match (ends_in(&[".mcap"]), ends_in(&[".csv", ".vnl"])) {
        (true, _) => "recordings",
        (_, true) => "corners",
        _ => "images",
    };
    let quoted = |text: &str| format!("\"{}\"", text.replace('\\', "\\\\").replace('"', "\\\""));
    let mut text =
        String::from("# Written by `boresight init`; lines that begin with # show what is taken anyway.\n\n");
    // Writing to a string cannot fail.
    let _ = writeln!(text, "[target]\nkind = {}\n", quoted(&spec));
    for (id, camera) in job.dataset.cameras.enumerate() {
        let [width, height] = camera.image_size;
        let pattern = input.camera.iter().find(|images| images.name == camera.name);
        let views: Vec<_> = job.dataset.views.iter().filter(|view| view.camera == id).collect();
        let corners = views.iter().map(|view| view.observations.len()).sum();
        let _ =
            writeln!(text, "# {}: {}, {}", camera.name, count(views.len(), "view"), count(corners, "corner"));
        // Corners do not tell the size of the image; images tell it, and their names mostly tell whose they are.
        let mark = if key == "corners" || pattern.is_some() { "" } else { "# " };
        let _ = writeln!(text, "{mark}[[camera]]\n{mark}name = {}", quoted(&camera.name));
        let _ = writeln!(text, "{mark}image_size = [{width}, {height}]");
        if let Some(images) = pattern {
            let _ = writeln!(text, "images = {}", quoted(&images.pattern));
        }
        text.push('\n');
    }
    let names: Vec<String> = names.iter().map(|name| quoted(name)).collect();
    let _ = writeln!(text, "[input]\n{key} = [{}]", names.join(", "));
    if let Some(tolerance) = input.sync_tolerance {
        let _ = writeln!(text, "sync_tolerance_ms = {:?}", tolerance.ns as f64 / 1e6);
    }
    if let Some(clock) = input.clock {
        let _ = writeln!(text, "clock = \"{}\"", format!("{clock:?}").to_lowercase());
    }
    text.push_str("\n[options]\n");
    let stated = boresight::CalibrateOptions::default().stated();
    for (name, value) in stated {
        let _ = writeln!(text, "# {name} = {}", quoted(&value));
    }
    Ok(text)
}
