//! Links in the documentation resolve, and paths of ours that prose names exist.

use super::Finding;
use super::tree::{Tree, numbered};

/// Begins a path of ours that stands in backquotes.
const OURS: &[&str] = &[".ci/", "crates/", "datasets/", "docs/", "tests/", "tools/"];

/// Finds links and paths that lead nowhere.
pub(super) fn check(tree: &Tree) -> Vec<Finding> {
    let mut findings = Vec::new();
    for (file, text) in tree.texts_ending(".md") {
        let folder = file.rsplit_once('/').map_or("", |(folder, _)| folder);
        let mut in_fence = false;
        for (line, text) in numbered(text) {
            if text.trim_start().starts_with("```") {
                in_fence = !in_fence;
            }
            if in_fence || text.starts_with("    ") {
                continue;
            }
            for target in link_targets(text) {
                if let Some(what) = broken(tree, file, folder, target) {
                    findings.push(Finding::new(file, line, what, "correct the link"));
                }
            }
            for path in text.split('`').skip(1).step_by(2) {
                let is_path = OURS.iter().any(|prefix| path.starts_with(prefix))
                    && path.chars().all(|c| c.is_ascii_alphanumeric() || "._-/".contains(c))
                    // NAME and the like stand for something.
                    && !path.split('/').any(|part| part.len() > 1 && part.chars().all(|c| c.is_ascii_uppercase()));
                let path = path.trim_end_matches('/');
                let exists = |path: &str| tree.paths.contains(path);
                if is_path && !exists(path) && !exists(&format!("{folder}/{path}")) {
                    findings.push(Finding::new(
                        file,
                        line,
                        format!("`{path}` does not exist"),
                        "name what is there",
                    ));
                }
            }
        }
    }
    findings
}

/// Returns the targets of `[text](target)` on a line, outside of backquotes.
fn link_targets(line: &str) -> Vec<&str> {
    let is_quoted = |at: usize| line[..at].matches('`').count() % 2 == 1;
    let starts = line.match_indices("](").filter(|&(at, _)| !is_quoted(at)).map(|(at, _)| at + 2);
    starts.filter_map(|start| line[start..].split(')').next()).collect()
}

/// Says what is wrong with a link, if anything is.
fn broken(tree: &Tree, file: &str, folder: &str, target: &str) -> Option<String> {
    let target = target.split_whitespace().next().unwrap_or_default().trim_matches(['<', '>']);
    if target.contains("://") || target.starts_with("mailto:") {
        return None;
    }
    let (path, anchor) = target.split_once('#').map_or((target, None), |(path, anchor)| (path, Some(anchor)));
    let path = if path.is_empty() { file.to_owned() } else { resolved(folder, path) };
    if !path.is_empty() && !tree.paths.contains(&path) {
        return Some(format!("the link to {target} leads nowhere"));
    }
    let anchor = anchor?;
    let headings = tree.text(&path).unwrap_or_default().lines().filter(|line| line.starts_with('#'));
    let has_heading =
        headings.map(|line| anchor_of(line.trim_start_matches('#'))).any(|found| found == anchor);
    (!has_heading).then(|| format!("{path} has no heading #{anchor}"))
}

fn resolved(folder: &str, path: &str) -> String {
    let mut parts: Vec<&str> = folder.split('/').filter(|part| !part.is_empty()).collect();
    for part in path.split('/') {
        match part {
            "" | "." => {}
            ".." => drop(parts.pop()),
            part => parts.push(part),
        }
    }
    parts.join("/")
}

/// Returns the anchor that a heading gets on the usual hosts.
fn anchor_of(heading: &str) -> String {
    let kept = heading.trim().to_lowercase();
    kept.chars()
        .filter(|c| c.is_alphanumeric() || "_- ".contains(*c))
        .map(|c| if c == ' ' { '-' } else { c })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dead_links_are_found() {
        let page = "# Two words\n[a](../README.md) [b](gone.md) [c](#two-words) [d](#other) `[e](f.md)`\n\
            ```\n[g](h.md)\n```\n`docs/page.md` `docs/gone.md` `datasets/NAME/x` [web](https://example.org)\n";
        let tree = Tree::of(&[("README.md", ""), ("docs/page.md", page)]);
        let found: Vec<_> = check(&tree).into_iter().map(|finding| (finding.line, finding.what)).collect();
        let expected = [
            (2, "the link to gone.md leads nowhere"),
            (2, "docs/page.md has no heading #other"),
            (6, "`docs/gone.md` does not exist"),
        ];
        assert_eq!(found, expected.map(|(line, what)| (line, what.to_owned())));
    }
}
