//! No source file is forgotten: each is a module of the file above it.

use super::Finding;
use super::tree::Tree;

/// Finds Rust files that nothing declares, which the compiler never sees.
pub(super) fn check(tree: &Tree) -> Vec<Finding> {
    let mut findings = Vec::new();
    for file in tree.rust.keys() {
        let Some((folder, name)) = file.rsplit_once('/') else { continue };
        let Some(stem) = name.strip_suffix(".rs") else { continue };
        if is_root(folder, stem) {
            continue;
        }
        let parents = parents(folder, stem);
        let is_declared = parents.iter().any(|parent| {
            let code = tree.rust.get(parent).map_or("", |source| source.code.as_str());
            let by_path =
                tree.text(parent).is_some_and(|text| text.contains(&format!("#[path = \"{name}\"]")));
            by_path || declares(code, stem)
        });
        // The siblings of a file may name it by its path too.
        let siblings = tree
            .texts
            .range(format!("{folder}/")..)
            .take_while(|(path, _)| path.starts_with(&format!("{folder}/")));
        let by_path = format!("#[path = \"{name}\"]");
        if !is_declared && !siblings.into_iter().any(|(_, text)| text.contains(&by_path)) {
            let what = format!("no file declares mod {stem}");
            findings.push(Finding::new(file, 1, what, format!("declare it in {}", parents.join(" or "))));
        }
    }
    findings
}

/// Tells whether cargo itself finds the file.
fn is_root(folder: &str, stem: &str) -> bool {
    let parts: Vec<&str> = folder.split('/').collect();
    let last = parts.last().copied().unwrap_or_default();
    let above = parts.len().checked_sub(2).map_or("", |i| parts[i]);
    let in_targets = |name: &str| matches!(name, "tests" | "examples" | "benches" | "bin");
    // `tests/src` is the package of end-to-end tests, not a target folder.
    matches!(stem, "lib" | "main" | "build")
        || in_targets(last) && last != "src"
        || (in_targets(above) && stem == "main")
}

/// Returns the files that may declare `stem` in `folder`.
fn parents(folder: &str, stem: &str) -> Vec<String> {
    // A `mod.rs` stands for its folder.
    let folder = match stem {
        "mod" => folder.rsplit_once('/').map_or("", |(folder, _)| folder),
        _ => folder,
    };
    ["/lib.rs", "/main.rs", "/mod.rs", ".rs"].map(|ending| format!("{folder}{ending}")).to_vec()
}

fn declares(code: &str, stem: &str) -> bool {
    code.lines().any(|line| {
        let line = line.trim().trim_end_matches('{').trim_end();
        line.strip_suffix(';')
            .and_then(|line| line.strip_suffix(stem))
            .is_some_and(|head| head.ends_with("mod "))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn forgotten_files_are_found() {
        let tree = Tree::of(&[
            ("crates/a/src/lib.rs", "mod b;\npub(crate) mod c;\n// mod lost;\n"),
            ("crates/a/src/b.rs", "#[cfg(test)]\n#[path = \"b_tests.rs\"]\nmod tests;\n"),
            ("crates/a/src/b_tests.rs", ""),
            ("crates/a/src/c.rs", "mod d;\n"),
            ("crates/a/src/c/d.rs", ""),
            ("crates/a/src/lost.rs", ""),
            ("crates/a/tests/golden.rs", ""),
            ("crates/a/tests/runner/main.rs", "mod e;\n"),
            ("crates/a/tests/runner/e.rs", ""),
            ("crates/a/tests/runner/f.rs", ""),
            ("crates/a/examples/g.rs", ""),
        ]);
        let found: Vec<_> = check(&tree).into_iter().map(|finding| finding.file).collect();
        assert_eq!(found, ["crates/a/src/lost.rs", "crates/a/tests/runner/f.rs"]);
    }
}
