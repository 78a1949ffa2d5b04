//! Every crate takes the workspace's lints and the workspace's versions.

use super::Finding;
use super::tree::{Tree, line_of};

/// Finds manifests that go their own way.
pub(super) fn check(tree: &Tree) -> Vec<Finding> {
    let mut findings = Vec::new();
    for (file, text) in tree.texts_ending("/Cargo.toml") {
        let manifest: toml::Table = match text.parse() {
            Ok(manifest) => manifest,
            Err(error) => {
                findings.push(Finding::new(file, 1, error.message(), "mend the manifest"));
                continue;
            }
        };
        let from_workspace = |value: Option<&toml::Value>| {
            value.and_then(|value| value.get("workspace")).and_then(|value| value.as_bool()) == Some(true)
        };
        if !from_workspace(manifest.get("lints")) {
            findings.push(Finding::new(
                file,
                1,
                "the workspace's lints are not taken",
                "add [lints] workspace = true",
            ));
        }
        for kind in ["dependencies", "dev-dependencies", "build-dependencies"] {
            let Some(table) = manifest.get(kind).and_then(|table| table.as_table()) else { continue };
            for (name, value) in table {
                if !from_workspace(Some(value)) {
                    let what = format!("{name} has a version of its own");
                    let fix = "put the version into the top Cargo.toml and write .workspace = true here";
                    findings.push(Finding::new(file, line_of(text, name), what, fix));
                }
            }
        }
    }
    findings
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn own_ways_are_found() {
        let good =
            "[lints]\nworkspace = true\n[dependencies]\na.workspace = true\nb = { workspace = true }\n";
        let bad = "[dependencies]\na = \"1\"\n";
        let tree = Tree::of(&[("good/Cargo.toml", good), ("bad/Cargo.toml", bad)]);
        let found: Vec<_> = check(&tree).into_iter().map(|finding| (finding.file, finding.line)).collect();
        assert_eq!(found, [("bad/Cargo.toml".to_owned(), 1), ("bad/Cargo.toml".to_owned(), 2)]);
    }
}
