//! `cargo xtask tidy`: the rules of the house that can be checked by looking.
//!
//! A rule is one file with a function from the [`Tree`] to findings, and one line in [`RULES`]. The
//! rules also run as a test, so that `cargo test` knows them.

mod datasets;
mod floors;
mod frame_names;
mod invariants;
mod leftovers;
mod length;
mod links;
mod manifests;
mod modules;
mod plugs;
mod pure_middle;
mod rust_text;
mod tables;
mod test_command;
mod tree;

use std::fmt;
use std::process::ExitCode;

use crate::arguments::Arguments;
use crate::process::root;
use crate::tidy::tree::Tree;

type Rule = fn(&Tree) -> Vec<Finding>;

/// All rules, by the name of their file.
const RULES: &[(&str, Rule)] = &[
    ("datasets", datasets::check),
    ("floors", floors::check),
    ("frame_names", frame_names::check),
    ("invariants", invariants::check),
    ("leftovers", leftovers::check),
    ("length", length::check),
    ("links", links::check),
    ("manifests", manifests::check),
    ("modules", modules::check),
    ("plugs", plugs::check),
    ("pure_middle", pure_middle::check),
    ("tables", tables::check),
    ("test_command", test_command::check),
];

/// Something that breaks a rule.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Finding {
    file: String,
    /// Counted from 1.
    line: usize,
    what: String,
    fix: String,
}

impl Finding {
    fn new(file: &str, line: usize, what: impl Into<String>, fix: impl Into<String>) -> Self {
        Self { file: file.to_owned(), line, what: what.into(), fix: fix.into() }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}: {}; {}", self.file, self.line, self.what, self.fix)
    }
}

/// Prints what breaks the rules. Exit codes: 0 nothing, 1 something.
pub(crate) fn run(arguments: Arguments) -> anyhow::Result<ExitCode> {
    arguments.finish()?;
    let findings = all_findings(&Tree::read(root())?);
    for finding in &findings {
        println!("{finding}");
    }
    eprintln!("tidy: {} rules, {} findings", RULES.len(), findings.len());
    Ok(if findings.is_empty() { ExitCode::SUCCESS } else { ExitCode::from(1) })
}

fn all_findings(tree: &Tree) -> Vec<Finding> {
    let mut findings: Vec<Finding> = RULES.iter().flat_map(|(_, rule)| rule(tree)).collect();
    findings.sort();
    findings
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_house_is_tidy() {
        let findings = all_findings(&Tree::read(root()).unwrap());
        let lines: Vec<String> = findings.iter().map(Finding::to_string).collect();
        assert!(lines.is_empty(), "\n{}", lines.join("\n"));
    }

    #[test]
    fn every_rule_is_listed() {
        let tree = Tree::read(root()).unwrap();
        for (file, source) in tree.rust_in("tools/xtask/src/tidy/") {
            let name = file.trim_start_matches("tools/xtask/src/tidy/").trim_end_matches(".rs");
            let is_rule =
                source.code.contains("fn check(tree: &Tree)") || source.code.contains("fn check(_: &Tree)");
            assert_eq!(is_rule, RULES.iter().any(|(rule, _)| *rule == name), "{file}");
        }
    }
}
