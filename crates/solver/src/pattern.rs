//! Which entries of a sparse reduced system exist, and where contributions to it belong.

use crate::ordering::Graph;
use crate::structure::{Group, HELD, Signature};

/// Marks a contribution that belongs nowhere, because a column is held or nothing is there.
pub(crate) const NOWHERE: u32 = u32::MAX;

/// The lower triangle of a sparse reduced system, by columns.
#[derive(Debug)]
pub(crate) struct Pattern {
    /// Where each column starts, and the number of entries at the end.
    pub starts: Vec<u32>,
    /// The row of each entry, increasing within a column, the diagonal first.
    pub rows: Vec<u32>,
    /// For each signature, where the entries of its sums belong: those of the upper triangle row by
    /// row, or those that a local signature lists.
    pub signatures: Vec<Vec<u32>>,
    /// For each group, where the outer product of its columns belongs: for each column, and each run
    /// from its own on, the first row (its own, in its own run).
    pub groups: Vec<Vec<u32>>,
}

impl Pattern {
    /// Returns the pattern over the nodes of `graph` in the order `nodes`; columns count in that order.
    pub(crate) fn new(graph: &Graph, nodes: &[u32], signatures: &[Signature], groups: &[Group]) -> Self {
        let (starts, rows) = entries(graph, nodes);
        let mut pattern = Self { starts, rows, signatures: Vec::new(), groups: Vec::new() };
        pattern.signatures =
            signatures.iter().map(|signature| pattern.places_of_signature(signature)).collect();
        pattern.groups = groups.iter().map(|group| pattern.places_of_group(group)).collect();
        pattern
    }

    /// Returns the number of entries.
    pub(crate) fn n_entries(&self) -> usize {
        self.rows.len()
    }

    /// Returns where the entry of two columns is, or `NOWHERE`.
    fn place(&self, a: u32, b: u32) -> u32 {
        let (row, column) = (a.max(b), a.min(b));
        let start = self.starts[column as usize];
        let rows = &self.rows[start as usize..self.starts[column as usize + 1] as usize];
        rows.binary_search(&row).map_or(NOWHERE, |at| start + at as u32)
    }

    fn places_of_signature(&self, signature: &Signature) -> Vec<u32> {
        let place = |a: u32, b: u32| if a == HELD || b == HELD { NOWHERE } else { self.place(a, b) };
        let columns = &signature.columns;
        match &signature.local {
            None => {
                let row = |a: usize| columns[a..].iter().map(move |&b| place(columns[a], b));
                (0..columns.len()).flat_map(row).collect()
            }
            Some(local) => {
                let column = |column: u32| columns.get(column as usize).copied().unwrap_or(HELD);
                local.entries.iter().map(|&[a, b]| place(column(a), column(b))).collect()
            }
        }
    }

    fn places_of_group(&self, group: &Group) -> Vec<u32> {
        let mut places = Vec::new();
        for (idx, &(_, first, length)) in group.runs.iter().enumerate() {
            for column in first..first + length {
                places.push(self.starts[column]);
                let others = group.runs[idx + 1..].iter();
                places.extend(others.map(|&(_, row, _)| self.place(column as u32, row as u32)));
            }
        }
        places
    }
}

/// Returns where columns start, and the rows of their entries.
fn entries(graph: &Graph, nodes: &[u32]) -> (Vec<u32>, Vec<u32>) {
    let mut first_column = vec![0; nodes.len()];
    let mut n_columns = 0;
    for &node in nodes {
        first_column[node as usize] = n_columns;
        n_columns += graph.columns(node).len() as u32;
    }
    let (mut starts, mut rows) = (vec![0], Vec::new());
    let mut below: Vec<u32> = Vec::new();
    for &node in nodes {
        let first = first_column[node as usize];
        let end = first + graph.columns(node).len() as u32;
        below.clear();
        let later =
            graph.neighbours[node as usize].iter().filter(|&&other| first_column[other as usize] > first);
        below.extend(later.flat_map(|&other| {
            let first = first_column[other as usize];
            first..first + graph.columns(other).len() as u32
        }));
        below.sort_unstable();
        for column in first..end {
            rows.extend(column..end);
            rows.extend_from_slice(&below);
            starts.push(rows.len() as u32);
        }
    }
    (starts, rows)
}
