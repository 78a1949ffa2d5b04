//! The gradient of the sum of squares alone, for steps along a model that is kept.

use std::ops::Range;

use crate::problem::{GramMut, Problem, Scratch};
use crate::structure::Structure;
use crate::threads::Threads;

/// The gradient at one point, and the room in which it is summed.
#[derive(Debug)]
pub(crate) struct Gradient {
    chunks: Vec<Chunk>,
    /// By all tangent columns; zero for held ones.
    pub entries: Vec<f64>,
    /// The cost there.
    pub cost: f64,
}

/// What one chunk of groups adds up to.
#[derive(Clone, Debug, Default)]
struct Chunk {
    entries: Vec<f64>,
    /// A term's part, by its columns.
    part: Vec<f64>,
    /// What a plain term writes.
    gram: Vec<f64>,
    /// `None` where a term is not defined.
    cost: Option<f64>,
}

impl Gradient {
    /// Returns the room for gradients of this structure.
    pub(crate) fn new(structure: &Structure) -> Self {
        Self { chunks: Vec::new(), entries: vec![0.0; structure.n_columns], cost: 0.0 }
    }

    /// Makes this the gradient at `values`; tells whether all terms are defined there.
    pub(crate) fn evaluate(
        &mut self,
        problem: &Problem<'_>,
        structure: &Structure,
        values: &[f64],
        threads: &Threads,
    ) -> bool {
        self.chunks.resize_with(structure.chunks.len(), Chunk::default);
        threads.for_each_with(&mut self.chunks, |scratch, chunk_idx, chunk| {
            chunk.evaluate(problem, structure, structure.chunks[chunk_idx].clone(), values, scratch);
        });
        self.entries.fill(0.0);
        self.cost = 0.0;
        for chunk in &self.chunks {
            let Some(cost) = chunk.cost else { return false };
            self.cost += cost;
            self.entries.iter_mut().zip(&chunk.entries).for_each(|(sum, part)| *sum += part);
        }
        for (block, &first) in problem.parameters.blocks.iter().zip(&structure.first_column) {
            for (k, _) in block.held.iter().enumerate().filter(|(_, held)| **held) {
                self.entries[first + k] = 0.0;
            }
        }
        self.cost.is_finite()
    }
}

impl Chunk {
    fn evaluate(
        &mut self,
        problem: &Problem<'_>,
        structure: &Structure,
        groups: Range<usize>,
        values: &[f64],
        scratch: &mut Scratch,
    ) {
        let values = problem.parameters.at(values);
        self.entries.clear();
        self.entries.resize(structure.n_columns, 0.0);
        self.cost = None;
        let mut total = 0.0;
        for place in structure.groups[groups].iter().flat_map(|group| &structure.terms[group.terms.clone()]) {
            let term = problem.terms[place.term_idx];
            let n = place.n_columns;
            self.part.clear();
            self.part.resize(n, 0.0);
            let cost = match term.local() {
                Some(local) => local.gradient(values, &mut self.part, scratch),
                None => {
                    let side = n + 1;
                    self.gram.resize(self.gram.len().max(side * side), 0.0);
                    let cost = term.linearize(values, &mut GramMut::new(&mut self.gram, side), scratch);
                    for (column, part) in self.part.iter_mut().enumerate() {
                        *part = self.gram[column * side + n];
                    }
                    cost
                }
            };
            let Some(cost) = cost else { return };
            total += cost;
            let mut part = self.part.as_slice();
            for block in term.blocks() {
                let (own, rest) = part.split_at(problem.parameters.blocks[block.0].n_columns);
                let first = structure.first_column[block.0];
                self.entries[first..].iter_mut().zip(own).for_each(|(sum, part)| *sum += part);
                part = rest;
            }
        }
        self.cost = Some(total);
    }
}
