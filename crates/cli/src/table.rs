//! Plain-text tables: the first column to the left, all others to the right.

/// Returns the rows with columns aligned and two spaces between them; no line ends in a space.
pub(crate) fn aligned(rows: &[Vec<String>]) -> String {
    let n_columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let width = |text: &str| text.chars().count();
    let widths: Vec<usize> = (0..n_columns)
        .map(|column| {
            rows.iter().filter_map(|row| row.get(column)).map(|cell| width(cell)).max().unwrap_or(0)
        })
        .collect();
    let mut text = String::new();
    for row in rows {
        let cells: Vec<String> = row
            .iter()
            .zip(&widths)
            .enumerate()
            .map(|(column, (cell, most))| {
                let padding = " ".repeat(most - width(cell));
                if column == 0 { format!("{cell}{padding}") } else { format!("{padding}{cell}") }
            })
            .collect();
        text.push_str(cells.join("  ").trim_end());
        text.push('\n');
    }
    text
}

/// Returns a row of cells.
pub(crate) fn row<const N: usize>(cells: [&str; N]) -> Vec<String> {
    cells.map(str::to_owned).to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_aligned_by_characters() {
        let rows = [row(["a", "± 1", "x"]), row(["long", "22"]), row(["", "", "yy"])];
        assert_eq!(aligned(&rows), "a     ± 1   x\nlong   22\n           yy\n");
    }
}
