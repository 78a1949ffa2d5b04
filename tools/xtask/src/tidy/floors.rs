//! Floors: a crate depends only on crates of strictly lower floors, and ARCHITECTURE.md says which is where.

use std::collections::BTreeMap;

use super::Finding;
use super::tree::{Tree, line_of, numbered};

/// May be used by the tests of any crate on its floor or above.
const FOR_TESTS: &str = "boresight-synthetic";

const MAP: &str = "ARCHITECTURE.md";

/// A crate of ours.
struct Package {
    file: String,
    folder: String,
    name: String,
    floor: Option<i64>,
    manifest: toml::Table,
}

/// Finds crates without a floor, dependencies that do not lead down, and floors that the map gets wrong.
pub(super) fn check(tree: &Tree) -> Vec<Finding> {
    let packages = packages(tree);
    let floors: BTreeMap<&str, i64> =
        packages.iter().filter_map(|package| Some((package.name.as_str(), package.floor?))).collect();
    let mut findings = Vec::new();
    for package in &packages {
        let Some(floor) = package.floor else {
            let fix = "add [package.metadata.boresight] with floor = N";
            findings.push(Finding::new(&package.file, 1, format!("{} has no floor", package.name), fix));
            continue;
        };
        for (kind, dependency) in dependencies(&package.manifest) {
            let Some(&below) = floors.get(dependency.as_str()) else { continue };
            let for_tests = kind == "dev-dependencies" && dependency == FOR_TESTS && below <= floor;
            if below >= floor && !for_tests {
                let line = line_of(tree.text(&package.file).unwrap_or_default(), &dependency);
                let what =
                    format!("{} on floor {floor} depends on {dependency} on floor {below}", package.name);
                findings.push(Finding::new(
                    &package.file,
                    line,
                    what,
                    "depend on strictly lower floors only",
                ));
            }
        }
        if package.folder.starts_with("crates/") {
            findings.extend(check_map(tree, package, floor));
        }
    }
    findings
}

/// Holds the map's line `| FLOOR | `FOLDER` | ...` against the manifest.
fn check_map(tree: &Tree, package: &Package, floor: i64) -> Option<Finding> {
    let folder = format!("`{}`", package.folder);
    let line = numbered(tree.text(MAP)?).find(|(_, line)| line.starts_with('|') && line.contains(&folder));
    let Some((number, line)) = line else {
        return Some(Finding::new(
            MAP,
            1,
            format!("the code map lacks {folder}"),
            format!("add a row | {floor} | {folder} | ... |"),
        ));
    };
    let stated = line.trim_start_matches('|').split('|').next().unwrap_or_default().trim();
    (stated != floor.to_string()).then(|| {
        Finding::new(
            MAP,
            number,
            format!("{folder} is on floor {floor}, not {stated}"),
            "correct the code map",
        )
    })
}

fn packages(tree: &Tree) -> Vec<Package> {
    let manifests = tree.texts_ending("/Cargo.toml");
    let package = |(file, text): (&str, &str)| {
        let manifest: toml::Table = text.parse().ok()?;
        let about = manifest.get("package")?;
        let name = about.get("name")?.as_str()?.to_owned();
        let floor = about.get("metadata").and_then(|data| data.get("boresight")?.get("floor")?.as_integer());
        let folder = file.trim_end_matches("/Cargo.toml").to_owned();
        Some(Package { file: file.to_owned(), folder, name, floor, manifest })
    };
    manifests.filter_map(package).collect()
}

/// Returns each dependency with the table it stands in, those of a target platform included.
fn dependencies(manifest: &toml::Table) -> Vec<(&'static str, String)> {
    let platforms = manifest.get("target").and_then(|target| target.as_table());
    let platforms =
        platforms.into_iter().flat_map(|target| target.values()).filter_map(|value| value.as_table());
    let mut found = Vec::new();
    for tables in std::iter::once(manifest).chain(platforms) {
        for kind in ["dependencies", "dev-dependencies", "build-dependencies"] {
            let table = tables.get(kind).and_then(|table| table.as_table());
            found.extend(table.into_iter().flat_map(|table| table.keys()).map(|name| (kind, name.clone())));
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn manifest(name: &str, floor: &str, dependencies: &str) -> String {
        format!("[package]\nname = \"{name}\"\n[package.metadata.boresight]\n{floor}\n{dependencies}\n")
    }

    #[test]
    fn dependencies_lead_down() {
        let low = manifest("boresight-low", "floor = 0", "[dependencies]\nboresight-high.workspace = true");
        let high = manifest("boresight-high", "floor = 1", "[dependencies]\nboresight-low.workspace = true");
        let lost = manifest("boresight-lost", "", "");
        let made = manifest(FOR_TESTS, "floor = 1", "");
        let user = manifest(
            "user",
            "floor = 1",
            &format!("[dev-dependencies]\n{FOR_TESTS}.workspace = true\nboresight-high = \"1\""),
        );
        let map =
            "| 0 | `crates/low` |\n| 2 | `crates/high` |\n| 1 | `crates/made` |\n| 1 | `crates/user` |\n";
        let tree = Tree::of(&[
            ("crates/low/Cargo.toml", &low),
            ("crates/high/Cargo.toml", &high),
            ("crates/lost/Cargo.toml", &lost),
            ("crates/made/Cargo.toml", &made),
            ("crates/user/Cargo.toml", &user),
            (MAP, map),
        ]);
        let mut found: Vec<_> =
            check(&tree).into_iter().map(|finding| (finding.file, finding.line)).collect();
        found.sort();
        let expected = [
            (MAP, 2),
            ("crates/lost/Cargo.toml", 1),
            ("crates/low/Cargo.toml", 6),
            ("crates/user/Cargo.toml", 7),
        ];
        assert_eq!(found, expected.map(|(file, line)| (file.to_owned(), line)));
    }
}
