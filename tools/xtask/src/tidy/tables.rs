//! Figures in the documentation name the command that makes them, and the command exists.

use crate::COMMANDS;
use crate::table::{BEGIN, CLOSE, END};

use super::Finding;
use super::tree::{Tree, numbered};

/// Finds made tables whose command does not exist, and marks without their other half.
pub(super) fn check(tree: &Tree) -> Vec<Finding> {
    let mut findings = Vec::new();
    for (file, text) in tree.texts_ending(".md") {
        let mut open = None;
        for (line, text) in numbered(text) {
            if let Some(rest) = text.trim().strip_prefix(BEGIN) {
                if let Some(begun) = open.replace(line) {
                    findings.push(Finding::new(
                        file,
                        begun,
                        "the made table has no end",
                        format!("close it with {END}"),
                    ));
                }
                let name = rest.strip_suffix(CLOSE).and_then(|command| command.strip_prefix("cargo xtask "));
                let name = name.and_then(|words| words.split_whitespace().next());
                if !name.is_some_and(|name| COMMANDS.iter().any(|command| command.name == name)) {
                    let what = format!("`{}` is no command", rest.trim_end_matches(CLOSE));
                    findings.push(Finding::new(
                        file,
                        line,
                        what,
                        "name the cargo xtask command that makes the table",
                    ));
                }
            } else if text.trim() == END && open.take().is_none() {
                findings.push(Finding::new(
                    file,
                    line,
                    "nothing begins what ends here",
                    format!("begin it with {BEGIN}COMMAND{CLOSE}"),
                ));
            }
        }
        if let Some(begun) = open {
            findings.push(Finding::new(
                file,
                begun,
                "the made table has no end",
                format!("close it with {END}"),
            ));
        }
    }
    findings
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_without_a_maker_are_found() {
        let mark = |command: &str| format!("{BEGIN}{command}{CLOSE}\n");
        let good = format!("{}| a |\n{END}\n", mark("cargo xtask bench"));
        let unknown = format!("{}{END}\n", mark("cargo xtask nothing"));
        let open = mark("cargo xtask bench").repeat(2);
        let tree =
            Tree::of(&[("good.md", &good), ("open.md", &open), ("unknown.md", &unknown), ("x.md", END)]);
        let found: Vec<_> = check(&tree).into_iter().map(|finding| (finding.file, finding.line)).collect();
        let expected = [("open.md", 1), ("open.md", 2), ("unknown.md", 1), ("x.md", 1)];
        assert_eq!(found, expected.map(|(file, line)| (file.to_owned(), line)));
    }
}
