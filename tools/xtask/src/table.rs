//! Tables in the documentation, and the marks between which a command writes them.

use std::fmt::Write as _;
use std::path::Path;

use anyhow::{Context as _, bail};

use crate::process::root;

/// What begins the mark above a made table; the command and ` -->` follow.
pub(crate) const BEGIN: &str = "<!-- begin made by: ";

/// What ends a mark.
pub(crate) const CLOSE: &str = " -->";

/// The mark below a made table.
pub(crate) const END: &str = "<!-- end -->";

/// Returns a Markdown table whose columns line up in the source, numbers (all but the first column) to the right.
pub(crate) fn markdown(head: &[&str], rows: &[Vec<String>]) -> String {
    let width = |column: usize| {
        let cells = rows.iter().filter_map(|row| row.get(column)).map(String::as_str);
        cells.chain([head[column]]).map(|cell| cell.chars().count()).max().unwrap_or(0)
    };
    let widths: Vec<usize> = (0..head.len()).map(width).collect();
    let mut text = String::new();
    let mut line = |cells: &[&str]| {
        for (column, (cell, &width)) in cells.iter().zip(&widths).enumerate() {
            // Writing to a string cannot fail.
            let _ = if column == 0 {
                write!(text, "| {cell:<width$} ")
            } else {
                write!(text, "| {cell:>width$} ")
            };
        }
        text.push_str("|\n");
    };
    line(head);
    let rules: Vec<String> = widths
        .iter()
        .enumerate()
        .map(
            |(column, &width)| {
                if column == 0 { "-".repeat(width) } else { format!("{}:", "-".repeat(width.max(2) - 1)) }
            },
        )
        .collect();
    line(&rules.iter().map(String::as_str).collect::<Vec<_>>());
    for row in rows {
        line(&row.iter().map(String::as_str).collect::<Vec<_>>());
    }
    text
}

/// Returns `text` with what is between the marks of `command` replaced by `made`.
pub(crate) fn replaced(text: &str, command: &str, made: &str) -> anyhow::Result<String> {
    let begin = format!("{BEGIN}{command}{CLOSE}");
    let Some((before, rest)) = text.split_once(&begin) else { bail!("the line {begin} is missing") };
    let Some((_, after)) = rest.split_once(END) else { bail!("{END} is missing after {begin}") };
    Ok(format!("{before}{begin}\n\n{}\n\n{END}{after}", made.trim_end()))
}

/// Rewrites the part of a file, named from the top of the repository, that `command` makes.
pub(crate) fn rewrite(file: &str, command: &str, made: &str) -> anyhow::Result<()> {
    let path: &Path = &root().join(file);
    let text = std::fs::read_to_string(path).with_context(|| file.to_owned())?;
    let text = replaced(&text, command, made).with_context(|| file.to_owned())?;
    let temporary = path.with_extension("partial");
    std::fs::write(&temporary, text)
        .and_then(|()| std::fs::rename(&temporary, path))
        .with_context(|| file.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_line_up() {
        let rows = vec![vec!["a".to_owned(), "10.5".to_owned()], vec!["bcd".to_owned(), "µ".to_owned()]];
        let expected = "| x   |   ms |\n| --- | ---: |\n| a   | 10.5 |\n| bcd |    µ |\n";
        assert_eq!(markdown(&["x", "ms"], &rows), expected);
    }

    #[test]
    fn prose_outside_the_marks_stays() {
        let text = format!("before\n{BEGIN}cargo xtask bench{CLOSE}\nold\n{END}\nafter\n");
        let expected = format!("before\n{BEGIN}cargo xtask bench{CLOSE}\n\nnew\n\n{END}\nafter\n");
        let found = replaced(&text, "cargo xtask bench", "new\n").unwrap();
        assert_eq!(found, expected);
        assert_eq!(replaced(&found, "cargo xtask bench", "new").unwrap(), expected);
        assert!(replaced(&text, "cargo xtask other", "new").is_err());
        assert!(replaced(&text.replace(END, ""), "cargo xtask bench", "new").is_err());
    }
}
