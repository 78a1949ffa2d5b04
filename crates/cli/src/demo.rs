//! `boresight demo`.

use std::path::PathBuf;
use std::process::ExitCode;

use boresight::{OutputFile, Recovery, demo, read_calibration, recovery, write_files};
use clap::{Args, Parser as _};

use crate::arguments::Arguments;
use crate::failure::{Failure, Reason};
use crate::figures::{to_sigma, with_sigma};
use crate::streams::{answer, note};
use crate::table::{aligned, row};

#[derive(Args, Debug)]
pub(crate) struct DemoArguments {
    /// The folder for images, job, truth and results; made if it does not exist
    #[arg(short, long, value_name = "DIR", default_value = "demo")]
    pub output: PathBuf,
    /// Another seed gives other poses and noise
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
}

/// Renders a stereo recording, calibrates it, and holds the result against the truth.
pub(crate) fn run(arguments: &DemoArguments) -> Result<ExitCode, Failure> {
    let folder = &arguments.output;
    let names = ["boresight.toml", "images", "truth", "out"];
    if let Some(there) = names.map(|name| folder.join(name)).into_iter().find(|path| path.exists()) {
        let message = format!("{} is there already", there.display());
        return Err(Failure::new(Reason::Usage, message).with_hint("name another folder with -o"));
    }
    let made = demo(arguments.seed)?;
    let job = format!("[target]\nkind = \"{}\"\n\n[input]\nimages = [\"images\"]\n", made.target);
    write_files(&folder.join("images"), &made.images)?;
    write_files(&folder.join("truth"), &made.truth_files)?;
    write_files(folder, &[OutputFile { name: "boresight.toml".to_owned(), bytes: job.into_bytes() }])?;
    let out = folder.join("out");
    let [folder, shown_out] = [folder, &out].map(|path| path.display().to_string());
    note(&format!(
        "{} images of {}, rendered with known truth: {folder}/images\n",
        made.images.len(),
        made.target
    ));
    let calibrated = step(&["calibrate", &folder, "-o", &shown_out])?;
    let (calibration, _) = read_calibration(&out)?;
    let Some(recovery) = recovery(&calibration, &made.truth) else {
        answer(b"\nthere is no covariance to hold the truth against\n")?;
        return Ok(ExitCode::from(1));
    };
    answer(format!("\n{}", describe(&recovery)).as_bytes())?;
    note(&format!("\nlook at {folder}/images, and compare lenses over the image:"));
    note(&format!("next:    boresight compare {shown_out} {folder}/truth --distance-m 0.85"));
    Ok(if recovery.is_explained() { calibrated } else { ExitCode::from(1) })
}

/// Returns truth and estimate of each number, and how far they are apart as a whole.
fn describe(recovery: &Recovery) -> String {
    let mut rows = vec![row(["", "truth", "estimate", "off by", "in sigmas"])];
    for number in &recovery.numbers {
        let off = number.estimate - number.truth;
        let name = if number.unit.is_empty() {
            number.name.clone()
        } else {
            format!("{} {}", number.name, number.unit)
        };
        rows.push(row([
            &name,
            &to_sigma(number.truth, Some(number.sigma)),
            &with_sigma(number.estimate, Some(number.sigma)),
            &to_sigma(off, Some(number.sigma)),
            &format!("{:+.1}", off / number.sigma),
        ]));
    }
    let n = recovery.numbers.len();
    let beyond = recovery
        .numbers
        .iter()
        .filter(|number| (number.estimate - number.truth).abs() > number.sigma)
        .count();
    let word = if recovery.is_explained() { "the noise explains it" } else { "more than noise explains" };
    format!(
        "{}\nall {n} numbers together, with their correlations: {:.2} sigmas from the truth on average, where 1 is \
         expected: {word}\n{beyond} of {n} are off by more than a sigma, where a third is expected\n",
        aligned(&rows),
        (recovery.chi2 / n.max(1) as f64).sqrt()
    )
}

/// Runs another command as if it had been typed.
fn step(words: &[&str]) -> Result<ExitCode, Failure> {
    answer(format!("$ boresight {}\n", words.join(" ")).as_bytes())?;
    let arguments = Arguments::try_parse_from(["boresight"].iter().chain(words))
        .map_err(|error| Failure::new(Reason::Usage, error.to_string()))?;
    crate::run(arguments.command)
}
