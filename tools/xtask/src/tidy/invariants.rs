//! Every crate writes down what is absent from it.

use super::Finding;
use super::tree::Tree;

const SENTENCE: &str = "Architecture invariant:";

/// Finds crates whose first file states no invariant.
pub(super) fn check(tree: &Tree) -> Vec<Finding> {
    let mut findings = Vec::new();
    for folder in tree.folders_of("crates") {
        let sources = ["lib.rs", "main.rs"].map(|name| format!("{folder}/src/{name}"));
        let Some((file, text)) = sources.iter().find_map(|file| Some((file, tree.text(file)?))) else {
            findings.push(Finding::new(
                &folder,
                1,
                "the crate has no source",
                "write it, or remove the folder",
            ));
            continue;
        };
        let stated = text.lines().any(|line| line.starts_with("//! ") && line.contains(SENTENCE));
        if !stated {
            let fix = format!("add to its header: //! {SENTENCE} ...");
            findings.push(Finding::new(file, 1, "the crate does not say what is absent from it", fix));
        }
    }
    findings
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn silent_crates_are_found() {
        let good = "//! A crate.\n//!\n//! Architecture invariant: no files here.\n";
        let tree = Tree::of(&[("crates/a/src/lib.rs", good), ("crates/b/src/main.rs", "//! Another.\n")]);
        let findings = check(&tree);
        assert_eq!(findings.len(), 1);
        assert_eq!(findings[0].file, "crates/b/src/main.rs");
    }
}
