//! Where the conformance data lies, beside the project.

use std::path::PathBuf;

/// Returns a file of the conformance data, or `None`, saying so, where the data is not present.
#[allow(clippy::print_stderr, reason = "a skipped test says that it was skipped")]
pub fn conformance_file(name: &str) -> Option<PathBuf> {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared/conformance").join(name);
    if path.exists() {
        return Some(path);
    }
    eprintln!("skipped: the conformance data beside the project has no {name}");
    None
}
