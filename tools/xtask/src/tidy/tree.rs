//! The repository's files, read once for all rules.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use anyhow::Context as _;

use super::rust_text::RustText;

/// Folders that hold nothing of ours, and the fuzzers, which are a workspace of their own for another compiler.
const SKIPPED: &[&str] = &[".git", "target", "out", "__pycache__", "fuzz"];

/// Endings of the files whose text some rule reads.
const TEXT: &[&str] = &["rs", "md", "toml", "py", "cpp", "h", "html", "css", "js"];

/// All files of the repository.
#[derive(Default)]
pub(crate) struct Tree {
    /// Every file and folder, from the top of the repository, with `/` between folders.
    pub paths: BTreeSet<String>,
    /// The contents of text files.
    pub texts: BTreeMap<String, String>,
    /// The Rust sources, taken apart.
    pub rust: BTreeMap<String, RustText>,
}

impl Tree {
    /// Reads the tree below `root`.
    pub(crate) fn read(root: &Path) -> anyhow::Result<Self> {
        let mut tree = Self::default();
        tree.read_folder(root, "")?;
        Ok(tree)
    }

    /// Returns a tree of made-up files.
    #[cfg(test)]
    pub(crate) fn of(files: &[(&str, &str)]) -> Self {
        let mut tree = Self::default();
        for (path, text) in files {
            for (slash, _) in path.match_indices('/') {
                tree.paths.insert(path[..slash].to_owned());
            }
            tree.add((*path).to_owned(), Some((*text).to_owned()));
        }
        tree
    }

    fn read_folder(&mut self, folder: &Path, name: &str) -> anyhow::Result<()> {
        for entry in fs::read_dir(folder).with_context(|| folder.display().to_string())? {
            let entry = entry?;
            let file_name = entry.file_name().to_string_lossy().into_owned();
            let path = if name.is_empty() { file_name.clone() } else { format!("{name}/{file_name}") };
            let kind = entry.file_type()?;
            if kind.is_dir() {
                if !SKIPPED.contains(&file_name.as_str()) && !entry.path().join("pyvenv.cfg").exists() {
                    self.paths.insert(path.clone());
                    self.read_folder(&entry.path(), &path)?;
                }
            } else if kind.is_file() {
                let is_text = file_name.rsplit_once('.').is_some_and(|(_, ending)| TEXT.contains(&ending));
                let text = is_text.then(|| fs::read_to_string(entry.path()).with_context(|| path.clone()));
                self.add(path, text.transpose()?);
            }
        }
        Ok(())
    }

    fn add(&mut self, path: String, text: Option<String>) {
        if let Some(text) = text {
            if path.ends_with(".rs") {
                self.rust.insert(path.clone(), RustText::new(&text));
            }
            self.texts.insert(path.clone(), text);
        }
        self.paths.insert(path);
    }

    /// Returns the Rust sources whose path begins with `prefix`.
    pub(crate) fn rust_in<'a>(&'a self, prefix: &'a str) -> impl Iterator<Item = (&'a str, &'a RustText)> {
        self.rust
            .iter()
            .filter(move |(path, _)| path.starts_with(prefix))
            .map(|(path, text)| (path.as_str(), text))
    }

    /// Returns the text files with this ending.
    pub(crate) fn texts_ending<'a>(&'a self, ending: &'a str) -> impl Iterator<Item = (&'a str, &'a str)> {
        let texts = self.texts.iter().map(|(path, text)| (path.as_str(), text.as_str()));
        texts.filter(move |(path, _)| path.ends_with(ending))
    }

    /// Returns the text of a file.
    pub(crate) fn text(&self, path: &str) -> Option<&str> {
        self.texts.get(path).map(String::as_str)
    }

    /// Returns the folders directly below `parent`, such as `crates/solver` of `crates`.
    pub(crate) fn folders_of(&self, parent: &str) -> BTreeSet<String> {
        let prefix = format!("{parent}/");
        let is_folder = |path: &&String| {
            path.strip_prefix(&prefix).is_some_and(|rest| !rest.contains('/'))
                && self
                    .paths
                    .range(format!("{path}/")..)
                    .next()
                    .is_some_and(|next| next.starts_with(&format!("{path}/")))
        };
        self.paths.iter().filter(is_folder).cloned().collect()
    }
}

/// Returns each line with its number, counted from 1.
pub(crate) fn numbered(text: &str) -> impl Iterator<Item = (usize, &str)> {
    (1..).zip(text.lines())
}

/// Returns the number of the first line that begins with `start`, or 1.
pub(crate) fn line_of(text: &str, start: &str) -> usize {
    numbered(text).find(|(_, line)| line.trim_start().starts_with(start)).map_or(1, |(number, _)| number)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_are_told_from_files() {
        let tree =
            Tree::of(&[("crates/a/src/lib.rs", ""), ("crates/b/Cargo.toml", ""), ("crates/notes.md", "")]);
        assert_eq!(tree.folders_of("crates").into_iter().collect::<Vec<_>>(), ["crates/a", "crates/b"]);
        assert_eq!(line_of("[a]\n  b = 1\n", "b ="), 2);
    }
}
