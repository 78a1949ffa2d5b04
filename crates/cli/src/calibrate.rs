//! `boresight calibrate`.

use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use boresight::{
    CalibrateOptions, Finding, Job, Outcome, RESULT_FILES, Severity, Verdict, Watch, result_files,
    write_files,
};

use crate::arguments::CalibrateArguments;
use crate::failure::{Failure, Reason};
use crate::figures::count;
use crate::streams::{answer, note};
use crate::{inputs, progress, summary};

/// The file, within the output's folder, in which detections are remembered.
pub(crate) const DETECTIONS_FILE: &str = "detections.json";

/// Calibrates, writes, and prints the summary or the calibration.
pub(crate) fn run(arguments: &CalibrateArguments) -> Result<ExitCode, Failure> {
    let begin = Instant::now();
    inputs::refuse_file(&arguments.output)?;
    let detections = arguments.output.join(DETECTIONS_FILE);
    let job = inputs::load_remembering(&arguments.input, &detections, arguments.jobs)?;
    let options = layered(&job, arguments)?;
    let cancel = cancelled_by_ctrl_c()?;
    let (bar, observer) = progress::start();
    let watch = Watch { observer: Some(observer), cancel: Some(cancel.clone()) };
    let outcome = boresight::calibrate(&job, &options, &watch);
    bar.finish_and_clear();
    if cancel.load(Ordering::Relaxed) {
        // What was detected in images is remembered.
        return Err(Failure::new(Reason::Cancelled, "stopped by Ctrl-C; no result was written"));
    }
    let outcome = outcome?;
    let files = result_files(&outcome)?;
    write_files(&arguments.output, &files)?;

    for selection in &outcome.lenses {
        note(&format!("model[{}]: {}", selection.camera, selection.why));
    }
    if let Some(shape) = &outcome.shape {
        note(&format!("shape: {}", shape.why));
    }
    let conclusion = conclusion(&outcome, &arguments.output);
    if arguments.json {
        tell_findings(&outcome.findings);
        conclusion.lines().for_each(note);
        // The first file is the calibration.
        answer(files.first().map_or(&[], |file| &file.bytes))?;
    } else {
        let dataset = summary::of_dataset(&outcome.dataset);
        let calibration = summary::of_calibration(&outcome.calibration);
        answer(format!("{dataset}\n{calibration}\n").as_bytes())?;
        tell_findings(&outcome.findings);
        answer(conclusion.as_bytes())?;
    }
    note(&format!("done in {:.2} s", begin.elapsed().as_secs_f64()));
    Ok(match outcome.calibration.solve.converged {
        false => ExitCode::from(Reason::Solve.code()),
        true => exit_code(outcome.verdict),
    })
}

/// Returns the job file's options with those of the flags before them.
fn layered(job: &Job, arguments: &CalibrateArguments) -> Result<CalibrateOptions, Failure> {
    let stated = CalibrateOptions::of_job(job)?;
    Ok(CalibrateOptions {
        model: arguments.model.clone().unwrap_or(stated.model),
        shape: arguments.shape.unwrap_or(stated.shape),
        regularization: arguments.regularization.unwrap_or(stated.regularization),
        loss: arguments.loss.unwrap_or(stated.loss),
        reject: arguments.reject.unwrap_or(stated.reject),
        holdout: arguments.holdout.unwrap_or(stated.holdout),
        hold: if arguments.hold.is_empty() { stated.hold } else { arguments.hold.clone() },
        prior: arguments.prior.clone().or(stated.prior),
        share_lens: if arguments.share_lens.is_empty() {
            stated.share_lens
        } else {
            arguments.share_lens.clone()
        },
        time_offset: arguments.time_offset.unwrap_or(stated.time_offset),
        line_delay: arguments.line_delay.clone().unwrap_or(stated.line_delay),
        cameras: if arguments.cameras.is_empty() { stated.cameras } else { arguments.cameras.clone() },
        jobs: arguments.jobs.unwrap_or(stated.jobs),
    })
}

/// Returns a flag that the first Ctrl-C raises; the second ends the process at once.
fn cancelled_by_ctrl_c() -> Result<Arc<AtomicBool>, Failure> {
    let cancel = Arc::new(AtomicBool::new(false));
    let raised = cancel.clone();
    let handler = move || {
        if raised.swap(true, Ordering::Relaxed) {
            std::process::exit(i32::from(Reason::Cancelled.code()));
        }
    };
    ctrlc::set_handler(handler)
        .map_err(|error| Failure::new(Reason::Usage, format!("Ctrl-C cannot be listened for: {error}")))?;
    Ok(cancel)
}

/// Returns the verdict, what was written, and the next command.
fn conclusion(outcome: &Outcome, folder: &Path) -> String {
    let written: Vec<String> =
        RESULT_FILES.iter().map(|name| folder.join(name).display().to_string()).collect();
    let verdict = summary::verdict_line(outcome.verdict, &outcome.findings);
    let next = if outcome.verdict == Verdict::Good {
        format!("boresight export {} --to opencv -o {0}", quoted(folder))
    } else {
        let code = outcome.findings.first().map_or("", |finding| finding.code.as_str());
        format!("boresight explain {code}")
    };
    format!("{verdict}\nwritten: {}\nnext:    {next}\n", written.join(", "))
}

/// Returns a path as a shell takes it.
fn quoted(path: &Path) -> String {
    let text = path.display().to_string();
    let is_plain = !text.is_empty() && text.chars().all(|c| c.is_alphanumeric() || "/._-+,:@%".contains(c));
    if is_plain { text } else { format!("'{}'", text.replace('\'', r"'\''")) }
}

/// Returns the exit code of a verdict on what was written.
pub(crate) fn exit_code(verdict: Verdict) -> ExitCode {
    match verdict {
        Verdict::Fail => ExitCode::from(1),
        Verdict::Good | Verdict::Caution => ExitCode::SUCCESS,
    }
}

/// Tells the findings on stderr: what, where, and what to do.
pub(crate) fn tell_findings(findings: &[Finding]) {
    let text = describe_findings(findings);
    if !text.is_empty() {
        note(&text);
    }
}

/// Returns the findings in words: what, where, and what to do.
pub(crate) fn describe_findings(findings: &[Finding]) -> String {
    let mut text = String::new();
    for finding in findings {
        let word = match finding.severity {
            Severity::Note => "note",
            Severity::Caution => "caution",
            Severity::Fail => "fail",
        };
        text.push_str(&format!("{word}[{}]: {}: {}\n", finding.code, finding.place, finding.message));
        text.push_str(&format!("  fix: {}\n", finding.fix));
    }
    if !findings.is_empty() {
        text.push_str(&format!(
            "{}; `boresight explain CODE` tells more\n",
            count(findings.len(), "finding")
        ));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_quoted_for_the_shell() {
        assert_eq!(quoted(Path::new("out/a-1.b")), "out/a-1.b");
        assert_eq!(quoted(Path::new("my out")), "'my out'");
        assert_eq!(quoted(Path::new("it's")), r"'it'\''s'");
    }
}
