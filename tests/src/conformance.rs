//! Where the conformance data lies, beside the project.

use std::io::Write as _;
use std::path::PathBuf;

/// Returns a file of the conformance data, or `None`, saying so, where the data is not present.
pub fn conformance_file(name: &str) -> Option<PathBuf> {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared/conformance").join(name);
    if path.exists() {
        return Some(path);
    }
    // Past the harness, which keeps to itself what passing tests print.
    let _ = writeln!(std::io::stderr(), "skipped: the conformance data beside the project has no {name}");
    None
}
