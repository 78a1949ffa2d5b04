//! A plug is one file and one line: what implements a plug is in its registry.

use super::Finding;
use super::tree::{Tree, numbered};

/// A plug that is a trait, with a macro that lists what implements it.
struct TraitPlug {
    what: &'static str,
    folder: &'static str,
    trait_name: &'static str,
    registry: &'static str,
    list: &'static str,
}

const TRAITS: &[TraitPlug] = &[
    TraitPlug {
        what: "lens model",
        folder: "crates/camera/src/",
        trait_name: "CameraModel",
        registry: "crates/camera/src/registry.rs",
        list: "camera_models!",
    },
    TraitPlug {
        what: "finding",
        folder: "crates/validate/src/",
        trait_name: "Diagnostic",
        registry: "crates/validate/src/findings/registry.rs",
        list: "diagnostics!",
    },
];

const FORMATS: &str = "crates/io/src/";
const FORMAT_REGISTRY: &str = "crates/io/src/format.rs";

/// What the functions that a format registers return.
const FORMAT_RESULTS: &[&str] =
    &["-> Result<Vec<NamedCamera>,", "-> Result<SeenFile,", "-> Result<Vec<OutputFile>,"];

/// Finds lens models, findings and formats that are written but not registered.
///
/// Terms of the sum of squares have no registry: a problem is made of whichever terms its caller has.
pub(super) fn check(tree: &Tree) -> Vec<Finding> {
    let mut findings: Vec<Finding> = TRAITS.iter().flat_map(|plug| unregistered(tree, plug)).collect();
    findings.extend(unregistered_formats(tree));
    findings
}

fn unregistered(tree: &Tree, plug: &TraitPlug) -> Vec<Finding> {
    let registry = tree.rust.get(plug.registry).map_or("", |source| source.code.as_str());
    let entries = registry.split_once(&format!("\n{} {{", plug.list)).map_or("", |(_, entries)| entries);
    let entries = entries.split('}').next().unwrap_or_default();
    let implements = format!("{} for ", plug.trait_name);
    let mut findings = Vec::new();
    for (file, source) in tree.rust_in(plug.folder) {
        for (line, code) in numbered(source.code_without_tests()) {
            let Some((head, implementor)) = code.split_once(&implements) else { continue };
            let name = first_word(implementor);
            if head.trim_start().starts_with("impl") && !words(entries).any(|word| word == name) {
                let what = format!("the {} {name} is not registered", plug.what);
                let fix = format!("add a line to {} in {}", plug.list, plug.registry);
                findings.push(Finding::new(file, line, what, fix));
            }
        }
    }
    findings
}

fn unregistered_formats(tree: &Tree) -> Vec<Finding> {
    let registry = tree.rust.get(FORMAT_REGISTRY).map_or("", |source| source.code.as_str());
    let mut findings = Vec::new();
    for (file, source) in tree.rust_in(FORMATS).filter(|(file, _)| *file != FORMAT_REGISTRY) {
        let module = file.rsplit('/').next().unwrap_or_default().trim_end_matches(".rs");
        for (start, _) in source.code_without_tests().match_indices("fn ") {
            let rest = &source.code[start + "fn ".len()..];
            let is_private = !source.code[..start].trim_end_matches(' ').ends_with([')', 'b']);
            let head = rest.split(['{', ';']).next().unwrap_or_default();
            let head = head.split_whitespace().collect::<Vec<_>>().join(" ");
            if is_private || !FORMAT_RESULTS.iter().any(|result| head.contains(result)) {
                continue;
            }
            let name = first_word(rest);
            if !registry.contains(&format!("{module}::{name})")) {
                let line = source.code[..start].lines().count();
                let fix = format!("add {module}::{name} to FORMATS in {FORMAT_REGISTRY}");
                findings.push(Finding::new(
                    file,
                    line,
                    format!("the format's {name} is not registered"),
                    fix,
                ));
            }
        }
    }
    findings
}

fn words(code: &str) -> impl Iterator<Item = &str> {
    code.split(|c: char| !(c == '_' || c.is_alphanumeric())).filter(|word| !word.is_empty())
}

fn first_word(code: &str) -> &str {
    words(code).next().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unregistered_lenses_are_found() {
        let registry =
            "macro_rules! camera_models { () => {} }\ncamera_models! {\n    A => crate::a::Alpha<4>,\n}\n";
        let tree = Tree::of(&[
            (TRAITS[0].registry, registry),
            ("crates/camera/src/a.rs", "impl<const N: usize> CameraModel for Alpha<N> {\n}\n"),
            ("crates/camera/src/b.rs", "\nimpl CameraModel for Beta {\n}\n"),
            ("crates/camera/src/c.rs", "#[cfg(test)]\nmod tests {\nimpl CameraModel for Fake {\n}\n}\n"),
        ]);
        let found = check(&tree);
        assert_eq!(found.len(), 1, "{found:?}");
        assert_eq!((found[0].file.as_str(), found[0].line), ("crates/camera/src/b.rs", 2));
    }

    #[test]
    fn unregistered_formats_are_found() {
        let registry = "const FORMATS: &[Format] = &[Format { export: Some(a::export), ..NONE }];\n";
        let source = "fn helper() -> Result<Vec<OutputFile>, Error> { x }\n\
            pub(crate) fn export(c: &Calibration) -> Result<Vec<OutputFile>, Error> { x }\n";
        let tree = Tree::of(&[
            (FORMAT_REGISTRY, registry),
            ("crates/io/src/a.rs", source),
            ("crates/io/src/b.rs", source),
        ]);
        let found = check(&tree);
        assert_eq!(found.len(), 1, "{found:?}");
        assert_eq!((found[0].file.as_str(), found[0].line), ("crates/io/src/b.rs", 2));
    }
}
