//! What was meant to be temporary: marks in comments, macros that stand for missing code, empty places in prose.

use super::Finding;
use super::tree::{Tree, numbered};

/// A reason is at least this long.
const LEAST_REASON: usize = 12;

/// Finds unfinished places that do not say why.
pub(super) fn check(tree: &Tree) -> Vec<Finding> {
    let mut findings = Vec::new();
    for (file, source) in &tree.rust {
        let raw = tree.text(file).unwrap_or_default();
        for ((line, code), (comment, raw)) in
            numbered(&source.code).zip(source.comments.lines().zip(raw.lines()))
        {
            for stub in ["todo!(", "unimplemented!("] {
                if code.contains(stub) && !raw.contains(&format!("{stub}\"")) {
                    findings.push(Finding::new(
                        file,
                        line,
                        format!("{stub}) says nothing"),
                        "write it, or say what is missing",
                    ));
                }
            }
            if code.contains("#[ignore]") {
                findings.push(Finding::new(
                    file,
                    line,
                    "a test is ignored without a reason",
                    "write #[ignore = \"why\"]",
                ));
            }
            let reason =
                comment.split_once("FIXME").map(|(_, reason)| reason.trim_matches([':', ' ', '(', ')']));
            if reason.is_some_and(|reason| reason.len() < LEAST_REASON) {
                let fix = "say what is wrong and what is right";
                findings.push(Finding::new(file, line, "FIXME without a reason", fix));
            }
            if comment.trim() == "//! Placeholder." {
                findings.push(Finding::new(file, line, "the file is empty", "write it, or remove it"));
            }
        }
    }
    for (file, text) in tree.texts_ending(".md") {
        for (line, text) in numbered(text) {
            if text.contains("<!-- lead: fill") {
                findings.push(Finding::new(
                    file,
                    line,
                    "the text is not written yet",
                    "write it and remove the mark",
                ));
            }
        }
    }
    findings
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unfinished_places_are_found() {
        let source = "fn a() { todo!() }\n// FIXME\n// FIXME: off by one at the edge, see Eq. 3.\n#[ignore]\ntodo!(\"x\")\n";
        let page = "Text.\n\n<!-- lead: fill -->\n";
        let findings = check(&Tree::of(&[("a.rs", source), ("b.md", page)]));
        let found: Vec<_> = findings.iter().map(|finding| (finding.file.as_str(), finding.line)).collect();
        assert_eq!(found, [("a.rs", 1), ("a.rs", 2), ("a.rs", 4), ("b.md", 3)]);
    }
}
