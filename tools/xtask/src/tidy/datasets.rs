//! A dataset says where it comes from and what it asks for, and holds no photographs.

use super::Finding;
use super::tree::{Tree, line_of};

/// Endings of photographs, which have owners.
const PHOTOGRAPHS: &[&str] = &["bmp", "gif", "jpeg", "jpg", "pgm", "png", "ppm", "tif", "tiff", "webp"];

/// Finds datasets that are incomplete or hold what they must not.
pub(super) fn check(tree: &Tree) -> Vec<Finding> {
    let mut findings = Vec::new();
    for folder in tree.folders_of("datasets") {
        for (name, purpose) in [
            ("ORIGIN.md", "say where the recording comes from, its licence, how to get the images"),
            ("boresight.toml", "describe the job: target, cameras, inputs"),
        ] {
            if !tree.paths.contains(&format!("{folder}/{name}")) {
                findings.push(Finding::new(&folder, 1, format!("{name} is missing"), purpose));
            }
        }
        findings.extend(check_job(tree, &folder));
    }
    for path in tree.paths.iter().filter(|path| path.starts_with("datasets/")) {
        let ending = path.rsplit_once('.').map(|(_, ending)| ending.to_lowercase());
        if ending.is_some_and(|ending| PHOTOGRAPHS.contains(&ending.as_str())) {
            let fix = "keep images outside the repository and tell in ORIGIN.md how to get them";
            findings.push(Finding::new(path, 1, "photographs are not committed", fix));
        }
    }
    findings
}

fn check_job(tree: &Tree, folder: &str) -> Vec<Finding> {
    let file = format!("{folder}/boresight.toml");
    let Some(text) = tree.text(&file) else { return Vec::new() };
    let job: toml::Table = match text.parse() {
        Ok(job) => job,
        Err(error) => return vec![Finding::new(&file, 1, error.message(), "mend the job file")],
    };
    let corners =
        job.get("input").and_then(|input| input.get("corners")).and_then(|corners| corners.as_array());
    let names = corners.into_iter().flatten().filter_map(|name| name.as_str());
    let missing = names.filter(|name| !tree.paths.contains(&format!("{folder}/{name}")));
    let line = line_of(text, "corners");
    missing
        .map(|name| Finding::new(&file, line, format!("{name} does not exist"), "name a file of the dataset"))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn incomplete_datasets_are_found() {
        let job = "[input]\ncorners = [\"a.csv\", \"gone.csv\"]\n";
        let tree = Tree::of(&[
            ("datasets/good/ORIGIN.md", ""),
            ("datasets/good/boresight.toml", job),
            ("datasets/good/a.csv", ""),
            ("datasets/bad/left01.JPG", ""),
        ]);
        let mut found: Vec<_> =
            check(&tree).into_iter().map(|finding| (finding.file, finding.what)).collect();
        found.sort();
        let files: Vec<&str> = found.iter().map(|(file, _)| file.as_str()).collect();
        assert_eq!(
            files,
            ["datasets/bad", "datasets/bad", "datasets/bad/left01.JPG", "datasets/good/boresight.toml"]
        );
    }
}
