//! Small files: nobody reviews a very long one whole.

use super::Finding;
use super::tree::{Tree, numbered};

/// A file with more lines states a reason.
const MOST_LINES: usize = 800;

/// The header in which the reason may stand.
const HEADER_LINES: usize = 40;

/// Begins the reason.
const REASON: &str = "Long because ";

/// Finds long files without a reason.
pub(super) fn check(tree: &Tree) -> Vec<Finding> {
    let mut findings = Vec::new();
    for (file, text) in &tree.texts {
        let n_lines = text.lines().count();
        let has_reason = numbered(text).take(HEADER_LINES).any(|(_, line)| {
            line.trim_start_matches(['/', '!', '#', ' ', '*', '<', '-']).starts_with(REASON)
        });
        let is_source = !file.ends_with(".toml");
        if is_source && n_lines > MOST_LINES && !has_reason {
            let what = format!("{n_lines} lines, {MOST_LINES} are the most");
            let fix = format!("split it, or say in its header: //! {REASON}...");
            findings.push(Finding::new(file, MOST_LINES + 1, what, fix));
        }
    }
    findings
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_files_need_a_reason() {
        let long = "\n".repeat(900);
        let explained = format!("//! A table.\n//! Long because it is generated.\n{long}");
        let tree = Tree::of(&[("long.rs", &long), ("explained.rs", &explained), ("short.rs", "\n")]);
        let findings = check(&tree);
        assert_eq!(findings.iter().map(|finding| finding.file.as_str()).collect::<Vec<_>>(), ["long.rs"]);
    }
}
