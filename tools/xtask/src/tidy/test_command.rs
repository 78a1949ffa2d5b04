//! The README states the test command once, where `.ci/run` reads it, so that the two cannot drift.

use super::Finding;
use super::tree::{Tree, numbered};

const README: &str = "README.md";
const MARK: &str = "<!-- test command -->";

/// Finds a README without its test command.
pub(super) fn check(tree: &Tree) -> Vec<Finding> {
    let fix = format!("put {MARK} above a fence that holds the one command");
    let Some(text) = tree.text(README) else {
        return vec![Finding::new(README, 1, "there is no README.md", "write it")];
    };
    let marks: Vec<usize> =
        numbered(text).filter(|(_, line)| line.trim() == MARK).map(|(line, _)| line).collect();
    let [line] = marks[..] else {
        return vec![Finding::new(README, 1, format!("{} test commands are marked", marks.len()), fix)];
    };
    let mut below = text.lines().skip(line).filter(|line| !line.trim().is_empty());
    let is_fenced = below.next().is_some_and(|line| line.starts_with("```"));
    let is_command = below.next().is_some_and(|line| line.starts_with("cargo test"));
    let is_closed = below.next() == Some("```");
    if is_fenced && is_command && is_closed {
        Vec::new()
    } else {
        vec![Finding::new(README, line, "no single command follows", fix)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_is_single_and_fenced() {
        for (text, n) in [
            ("<!-- test command -->\n```sh\ncargo test --workspace\n```\n", 0),
            ("<!-- test command -->\n```sh\ncargo test\ncargo doc\n```\n", 1),
            ("<!-- test command -->\nSome text.\n", 1),
            ("No mark.\n", 1),
        ] {
            assert_eq!(check(&Tree::of(&[(README, text)])).len(), n, "{text}");
        }
    }
}
