//! Pure middle, impure edge: floors 0 to 3 touch no file, clock, terminal or environment.

use super::Finding;
use super::tree::{Tree, numbered};

/// The crates of floors 0 to 3.
const PURE: &[&str] = &["geometry", "camera", "solver", "data", "synthetic", "seed", "adjust", "validate"];

/// What is absent from them.
const IMPURE: &[&str] = &[
    "std::fs",
    "std::env",
    "std::process",
    "std::net",
    "std::io::std",
    "Instant::now",
    "SystemTime",
    "println!",
    "eprintln!",
    "print!(",
    "static mut",
    "thread_rng",
    "rand::rng(",
];

/// Files that may, and why.
const EXCEPTIONS: &[(&str, &str)] = &[(
    "crates/solver/src/checkpoint.rs",
    "the state of a long search is kept in a file that the caller names",
)];

/// Finds side effects below floor 4, tests aside.
pub(super) fn check(tree: &Tree) -> Vec<Finding> {
    let mut findings = Vec::new();
    for name in PURE {
        for (file, source) in tree.rust_in(&format!("crates/{name}/src/")) {
            if EXCEPTIONS.iter().any(|(exception, _)| *exception == file) {
                continue;
            }
            for (line, code) in numbered(source.code_without_tests()) {
                if let Some(found) = IMPURE.iter().find(|impure| code.contains(**impure)) {
                    let fix = "move it to floor 4 or above, and pass values down";
                    findings.push(Finding::new(file, line, format!("`{found}` in a pure crate"), fix));
                }
            }
        }
    }
    for (file, _) in EXCEPTIONS {
        if !tree.rust.is_empty()
            && tree.rust.contains_key("crates/solver/src/lib.rs")
            && !tree.rust.contains_key(*file)
        {
            let here = "tools/xtask/src/tidy/pure_middle.rs";
            findings.push(Finding::new(here, 1, format!("{file} does not exist"), "remove the exception"));
        }
    }
    findings
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn side_effects_are_found() {
        let tree = Tree::of(&[
            ("crates/seed/src/a.rs", "use std::fs;\n#[cfg(test)]\nmod tests {\n use std::env;\n}\n"),
            ("crates/solver/src/checkpoint.rs", "use std::fs;\n"),
            ("crates/io/src/b.rs", "use std::fs;\n"),
        ]);
        let found: Vec<_> = check(&tree).into_iter().map(|finding| (finding.file, finding.line)).collect();
        assert_eq!(found, [("crates/seed/src/a.rs".to_owned(), 1)]);
    }
}
