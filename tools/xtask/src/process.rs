//! Where things are, and running other programs.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context as _, bail};

/// Returns the top of the repository.
pub(crate) fn root() -> &'static Path {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    here.ancestors().nth(2).unwrap_or(here)
}

/// Returns the folder that cargo builds into.
pub(crate) fn target() -> PathBuf {
    std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root().join("target"), |folder| root().join(folder))
}

/// Returns the folder of the pinned Python environment.
pub(crate) fn reference_environment() -> PathBuf {
    std::env::var_os("BORESIGHT_REFENV").map_or_else(|| root().join("target/refenv"), PathBuf::from)
}

/// Returns a command that runs at the top of the repository.
pub(crate) fn command(program: impl AsRef<std::ffi::OsStr>) -> Command {
    let mut command = Command::new(program);
    command.current_dir(root());
    command
}

/// Returns the cargo that runs us.
pub(crate) fn cargo() -> Command {
    command(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()))
}

/// Returns where `boresight` is, built as users have it.
pub(crate) fn boresight() -> anyhow::Result<PathBuf> {
    built("--bin", "boresight", "release")
}

/// Returns where an example of the workspace is, built as users have the rest.
pub(crate) fn example(name: &str) -> anyhow::Result<PathBuf> {
    built("--example", name, "release/examples")
}

/// Builds with the features of the whole workspace, so that nothing is built twice.
fn built(kind: &str, name: &str, folder: &str) -> anyhow::Result<PathBuf> {
    run(cargo().args(["build", "--release", "--workspace", kind, name]))
        .with_context(|| format!("building {name}"))?;
    Ok(target().join(folder).join(name))
}

/// Runs a command whose output is for the developer, and fails if it does.
pub(crate) fn run(command: &mut Command) -> anyhow::Result<()> {
    // Only our own answer may go to stdout.
    let status = command.stdout(std::io::stderr()).status().with_context(|| shown(command))?;
    if !status.success() {
        bail!("{}: {status}", shown(command));
    }
    Ok(())
}

/// Tells whether a command can be run and ends well; what it says is dropped.
pub(crate) fn succeeds(command: &mut Command) -> bool {
    let quiet = command.stdout(Stdio::null()).stderr(Stdio::null());
    quiet.status().is_ok_and(|status| status.success())
}

/// Returns what a command writes to stdout; what it says on stderr goes to the developer.
pub(crate) fn output(command: &mut Command) -> anyhow::Result<String> {
    let output = command.stderr(Stdio::inherit()).output().with_context(|| shown(command))?;
    if !output.status.success() {
        bail!("{}: {}", shown(command), output.status);
    }
    String::from_utf8(output.stdout).with_context(|| shown(command))
}

/// Returns a command as one would type it.
pub(crate) fn shown(command: &Command) -> String {
    let words = std::iter::once(command.get_program()).chain(command.get_args());
    words.map(|word| word.to_string_lossy()).collect::<Vec<_>>().join(" ")
}
