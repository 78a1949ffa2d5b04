//! Which inputs are images: files, folders of them, and patterns such as `left*.jpg`.

use std::path::{Path, PathBuf};

use crate::assemble::natural_order;
use crate::image_names::match_pattern;
use crate::job::JOB_FILE;
use crate::{Error, Place};

/// The endings of names of images that are read.
pub const IMAGE_EXTENSIONS: [&str; 7] = ["png", "jpg", "jpeg", "tif", "tiff", "pgm", "pnm"];
/// How deep folders within a folder are looked into.
const DEPTH: usize = 3;

/// An image to be read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ImageFile {
    /// Its name: its path from the folder that all images have in common, with `/` between folders.
    pub name: String,
    /// Where it is.
    pub path: PathBuf,
}

/// Splits inputs into images and everything else.
pub(crate) fn find_images(inputs: &[PathBuf]) -> Result<(Vec<ImageFile>, Vec<PathBuf>), Error> {
    let (mut paths, mut others) = (Vec::new(), Vec::new());
    for input in inputs {
        if input.is_dir() && !input.join(JOB_FILE).is_file() {
            let before = paths.len();
            list(input, DEPTH, &mut paths)?;
            if paths.len() == before {
                others.push(input.clone());
            }
        } else if is_pattern(input) && !input.exists() {
            let before = paths.len();
            expand(input, &mut paths)?;
            if paths.len() == before {
                return Err(Error::Config {
                    place: Place::file(input.display().to_string()),
                    message: "no image matches this pattern".to_owned(),
                    fix: Some(format!("images end in {}", IMAGE_EXTENSIONS.join(", "))),
                });
            }
        } else if is_image(input) {
            paths.push(input.clone());
        } else {
            others.push(input.clone());
        }
    }
    paths.sort_by(|a, b| natural_order(&a.to_string_lossy(), &b.to_string_lossy()));
    paths.dedup();
    let common = common_folder(&paths);
    let name = |path: &PathBuf| {
        let rest = path.strip_prefix(&common).unwrap_or(path);
        rest.components().map(|part| part.as_os_str().to_string_lossy()).collect::<Vec<_>>().join("/")
    };
    let images = paths.iter().map(|path| ImageFile { name: name(path), path: path.clone() }).collect();
    Ok((images, others))
}

/// Tells whether a path is a pattern rather than a name.
pub fn is_pattern(path: &Path) -> bool {
    path.to_string_lossy().contains(['*', '?'])
}

fn is_image(path: &Path) -> bool {
    let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase());
    extension.is_some_and(|extension| IMAGE_EXTENSIONS.contains(&extension.as_str()))
}

/// Returns what is in a folder, in order.
fn entries(folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let wrong = |source| Error::Read { file: folder.display().to_string(), source };
    let mut entries: Vec<PathBuf> = std::fs::read_dir(folder)
        .map_err(wrong)?
        .map(|entry| entry.map(|entry| entry.path()))
        .collect::<Result<_, _>>()
        .map_err(wrong)?;
    entries.sort();
    Ok(entries)
}

/// Appends the images in a folder and in those within it.
fn list(folder: &Path, depth: usize, paths: &mut Vec<PathBuf>) -> Result<(), Error> {
    for path in entries(folder)? {
        if path.is_dir() {
            if depth > 0 {
                list(&path, depth - 1, paths)?;
            }
        } else if is_image(&path) {
            paths.push(path);
        }
    }
    Ok(())
}

/// Appends the images that match a pattern; wildcards may stand in the name and in folders.
fn expand(pattern: &Path, paths: &mut Vec<PathBuf>) -> Result<(), Error> {
    let mut found = vec![PathBuf::new()];
    for part in pattern.components() {
        let part = Path::new(part.as_os_str());
        if !is_pattern(part) {
            found.iter_mut().for_each(|path| path.push(part));
            found.retain(|path| path.exists());
            continue;
        }
        let wanted = part.to_string_lossy();
        let mut next = Vec::new();
        for folder in found {
            let listed = if folder.as_os_str().is_empty() { Path::new(".") } else { &folder };
            if !listed.is_dir() {
                continue;
            }
            for path in entries(listed)? {
                let Some(name) = path.file_name() else { continue };
                if match_pattern(&wanted, &name.to_string_lossy()).is_some() {
                    next.push(folder.join(name));
                }
            }
        }
        found = next;
    }
    for path in found {
        if path.is_dir() {
            list(&path, DEPTH, paths)?;
        } else if is_image(&path) {
            paths.push(path);
        }
    }
    Ok(())
}

/// Returns the folder that all paths are in.
fn common_folder(paths: &[PathBuf]) -> PathBuf {
    let mut folders = paths.iter().map(|path| path.parent().unwrap_or(Path::new("")));
    let Some(first) = folders.next() else { return PathBuf::new() };
    folders.fold(first.to_owned(), |common, folder| {
        common.components().zip(folder.components()).take_while(|(a, b)| a == b).map(|(a, _)| a).collect()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_patterns_and_files_are_told_apart() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        for name in ["cam0", "cam1", "job", "empty"] {
            std::fs::create_dir(at(name)).unwrap();
        }
        for name in
            ["cam0/2.png", "cam0/10.PNG", "cam1/2.jpg", "cam1/notes.txt", "job/boresight.toml", "job/1.png"]
        {
            std::fs::write(at(name), "").unwrap();
        }
        let names = |inputs: &[&str]| -> (Vec<String>, usize) {
            let inputs: Vec<PathBuf> = inputs.iter().map(|name| at(name)).collect();
            let (images, others) = find_images(&inputs).unwrap();
            (images.into_iter().map(|image| image.name).collect(), others.len())
        };
        let owned = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>();
        assert_eq!(names(&["cam0", "cam1"]), (owned(&["cam0/2.png", "cam0/10.PNG", "cam1/2.jpg"]), 0));
        assert_eq!(names(&["cam0"]), (owned(&["2.png", "10.PNG"]), 0));
        assert_eq!(names(&["cam?/2.*", "job", "empty"]), (owned(&["cam0/2.png", "cam1/2.jpg"]), 2));
        assert_eq!(names(&["cam1/2.jpg", "cam1/notes.txt"]), (owned(&["2.jpg"]), 1));
        assert!(find_images(&[at("cam0/*.jpg")]).is_err());
    }
}
