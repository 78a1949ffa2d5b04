//! The problem's quadratic model at one point: block diagonals, couplings and gradients.

use rayon::prelude::*;

use crate::local::{Accumulated, EliminatedSums, LocalTerm};
use crate::problem::{GramMut, Problem, Scratch, TermKind, Values};
use crate::structure::{CouplingRun, HELD, Signature, Structure, TermPlace};

/// The side of an eliminated block.
pub(crate) const SIDE: usize = Structure::eliminated_columns();

/// Threads, or none.
#[derive(Debug)]
pub(crate) struct Threads(pub Option<rayon::ThreadPool>);

impl Threads {
    /// Does `work` on each item; the items are independent, so the number of threads cannot show.
    pub(crate) fn for_each<T: Send>(&self, items: &mut [T], work: impl Fn(usize, &mut T) + Sync + Send) {
        match &self.0 {
            None => items.iter_mut().enumerate().for_each(|(idx, item)| work(idx, item)),
            Some(pool) => pool.install(|| {
                items.par_iter_mut().enumerate().with_max_len(1).for_each(|(idx, item)| work(idx, item));
            }),
        }
    }
}

/// The quadratic model at one point.
#[derive(Debug, Default)]
pub(crate) struct Linearization {
    chunks: Vec<Chunk>,
    /// The upper triangle of the reduced blocks' own matrix, before any elimination.
    pub reduced: ReducedSums,
    /// The cost of the observations.
    pub observation_cost: f64,
    /// The cost of the priors.
    pub prior_cost: f64,
}

/// Sums over all terms of what falls on reduced columns.
#[derive(Debug, Default)]
pub(crate) struct ReducedSums {
    /// For each signature, the square matrix of its columns and the residual, upper triangle; or the
    /// entries that a local signature lists.
    pub signatures: Vec<Vec<f64>>,
    /// The gradient by reduced column.
    pub gradient: Vec<f64>,
    /// The diagonal by reduced column.
    pub diagonal: Vec<f64>,
}

/// What one chunk of groups adds up to.
#[derive(Debug, Default)]
struct Chunk {
    scratch: Scratch,
    gram: Vec<f64>,
    groups: Vec<GroupSums>,
    /// As in [`ReducedSums`], or the sums of a local signature; empty for those that none of the
    /// chunk's terms has.
    signatures: Vec<Vec<f64>>,
    observation_cost: f64,
    prior_cost: f64,
    failure: Option<Failure>,
}

/// Why there is no model at some values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Failure {
    /// This term is not defined there.
    Undefined { term_idx: usize },
    /// A term touches columns outside its support, so that another structure is needed.
    OutsideSupport,
}

/// The model's parts that touch an eliminated block.
#[derive(Clone, Debug, Default)]
pub(crate) struct GroupSums {
    /// The block's own matrix, row by row, both triangles.
    pub own: [[f64; SIDE]; SIDE],
    /// The gradient.
    pub gradient: [f64; SIDE],
    /// The coupling with the group's reduced columns: `SIDE` rows of them.
    pub coupling: Vec<f64>,
}

impl Linearization {
    /// Returns the room for a model of this structure.
    pub(crate) fn new(structure: &Structure) -> Self {
        let n_sums = |signature: &Signature| match &signature.local {
            None => (signature.columns.len() + 1).pow(2),
            Some(local) => local.n_sums,
        };
        let room = |term: &TermPlace| match &term.support {
            None => (term.n_columns + 1).pow(2),
            Some(support) => SIDE * support.len(),
        };
        let largest = structure.terms.iter().map(room).max().unwrap_or(0);
        let chunk = |groups: &std::ops::Range<usize>| {
            let groups = &structure.groups[groups.clone()];
            let mut chunk = Chunk {
                gram: vec![0.0; largest],
                groups: groups
                    .iter()
                    .map(|group| GroupSums {
                        coupling: vec![0.0; SIDE * group.columns.len()],
                        ..Default::default()
                    })
                    .collect(),
                signatures: vec![Vec::new(); structure.signatures.len()],
                ..Default::default()
            };
            // With many signatures, most chunks see few of them.
            for place in groups.iter().flat_map(|group| &structure.terms[group.terms.clone()]) {
                let n_sums = n_sums(&structure.signatures[place.signature]);
                chunk.signatures[place.signature].resize(n_sums, 0.0);
            }
            chunk
        };
        Self {
            chunks: structure.chunks.iter().map(chunk).collect(),
            reduced: ReducedSums {
                signatures: structure
                    .signatures
                    .iter()
                    .map(|signature| match &signature.local {
                        None => vec![0.0; n_sums(signature)],
                        Some(local) => vec![0.0; local.entries.len()],
                    })
                    .collect(),
                gradient: vec![0.0; structure.n_reduced],
                diagonal: vec![0.0; structure.n_reduced],
            },
            observation_cost: 0.0,
            prior_cost: 0.0,
        }
    }

    /// Returns the cost: the sum of squares.
    pub(crate) fn cost(&self) -> f64 {
        self.observation_cost + self.prior_cost
    }

    /// Makes this the model at `values`, or returns why there is none.
    pub(crate) fn evaluate(
        &mut self,
        problem: &Problem<'_>,
        structure: &Structure,
        values: &[f64],
        threads: &Threads,
    ) -> Result<(), Failure> {
        threads.for_each(&mut self.chunks, |chunk_idx, chunk| {
            chunk.evaluate(problem, structure, structure.chunks[chunk_idx].clone(), values);
        });
        if let Some(failure) = self.chunks.iter().find_map(|chunk| chunk.failure) {
            return Err(failure);
        }
        self.sum(problem, structure, values);
        Ok(())
    }

    /// Returns each group's sums, in order.
    pub(crate) fn groups(&self) -> impl Iterator<Item = &GroupSums> {
        self.chunks.iter().flat_map(|chunk| &chunk.groups)
    }

    /// Adds up the chunks, in order.
    fn sum(&mut self, problem: &Problem<'_>, structure: &Structure, values: &[f64]) {
        self.observation_cost = self.chunks.iter().map(|chunk| chunk.observation_cost).sum();
        self.prior_cost = self.chunks.iter().map(|chunk| chunk.prior_cost).sum();
        let reduced = &mut self.reduced;
        for (idx, (sum, signature)) in reduced.signatures.iter_mut().zip(&structure.signatures).enumerate() {
            if let Some(local) = &signature.local {
                let term = problem.terms[local.term_idx].local();
                let Some(term) = term else { continue };
                let mut total = vec![0.0; local.n_sums];
                for chunk in &self.chunks {
                    add(&mut total, &chunk.signatures[idx]);
                }
                term.expand(problem.parameters.at(values), &total, sum);
                continue;
            }
            sum.fill(0.0);
            for chunk in &self.chunks {
                for (sum, part) in sum.iter_mut().zip(&chunk.signatures[idx]) {
                    *sum += part;
                }
            }
        }
        reduced.gradient.fill(0.0);
        reduced.diagonal.fill(0.0);
        for (signature, sum) in structure.signatures.iter().zip(&reduced.signatures) {
            let n = signature.columns.len() + 1;
            if let Some(local) = &signature.local {
                let column = |column: u32| signature.columns.get(column as usize).filter(|&&c| c != HELD);
                for (&[a, b], entry) in local.entries.iter().zip(sum) {
                    match (column(a.min(b)), a.max(b) as usize + 1 == n) {
                        (Some(&column), true) => reduced.gradient[column as usize] += entry,
                        (Some(&column), false) if a == b => reduced.diagonal[column as usize] += entry,
                        _ => {}
                    }
                }
                continue;
            }
            for (a, &column) in signature.columns.iter().enumerate().filter(|&(_, &column)| column != HELD) {
                reduced.gradient[column as usize] += sum[a * n + n - 1];
                reduced.diagonal[column as usize] += sum[a * n + a];
            }
        }
    }
}

impl Chunk {
    fn evaluate(
        &mut self,
        problem: &Problem<'_>,
        structure: &Structure,
        groups: std::ops::Range<usize>,
        values: &[f64],
    ) {
        let values = problem.parameters.at(values);
        self.observation_cost = 0.0;
        self.prior_cost = 0.0;
        self.failure = None;
        self.signatures.iter_mut().for_each(|sums| sums.fill(0.0));
        for (group, sums) in structure.groups[groups].iter().zip(&mut self.groups) {
            sums.own = Default::default();
            sums.gradient = Default::default();
            sums.coupling.fill(0.0);
            for place in &structure.terms[group.terms.clone()] {
                let term = problem.terms[place.term_idx];
                let n = place.n_columns + 1;
                let shared = &mut self.signatures[place.signature];
                let accumulated = match (term.local(), &place.support) {
                    (Some(local), Some(_)) => {
                        sums.add_local(local, place, values, (shared, &mut self.gram), &mut self.scratch)
                    }
                    _ => {
                        let mut gram = GramMut::new(&mut self.gram, n);
                        let cost = term.linearize(values, &mut gram, &mut self.scratch);
                        cost.map_or(Accumulated::Undefined, Accumulated::Cost)
                    }
                };
                match accumulated {
                    Accumulated::Cost(cost) if cost.is_finite() => match term.kind() {
                        TermKind::Observation => self.observation_cost += cost,
                        TermKind::Prior => self.prior_cost += cost,
                    },
                    Accumulated::OutsideSupport => {
                        self.failure = Some(Failure::OutsideSupport);
                        return;
                    }
                    _ => {
                        self.failure = Some(Failure::Undefined { term_idx: place.term_idx });
                        return;
                    }
                }
                if place.support.is_some() {
                    continue;
                }
                let gram = Local { entries: &self.gram[..n * n], n };
                let eliminated = place.eliminated.clone().unwrap_or(n..n);
                if group.eliminated.is_some() {
                    sums.add(&gram, &eliminated, &place.coupling);
                }
                gram.add_reduced(&eliminated, shared);
            }
            if let Some(block) = group.eliminated {
                sums.finish(&problem.parameters.blocks[block].held);
            }
        }
    }
}

/// The upper triangle that a term wrote.
struct Local<'a> {
    entries: &'a [f64],
    n: usize,
}

impl Local<'_> {
    /// Adds the rows and columns other than the eliminated ones to the upper triangle of `sums`.
    fn add_reduced(&self, eliminated: &std::ops::Range<usize>, sums: &mut [f64]) {
        let Self { entries, n } = *self;
        let side = n - eliminated.len();
        for (a, row) in (0..eliminated.start).chain(eliminated.end..n).enumerate() {
            let row_entries = &entries[row * n..(row + 1) * n];
            let target = &mut sums[a * side..(a + 1) * side];
            // What is left of the eliminated columns, from the diagonal on, and what is right of them.
            let (left, right) = target.split_at_mut(eliminated.start);
            if row < eliminated.start {
                add(&mut left[row..], &row_entries[row..eliminated.start]);
                add(right, &row_entries[eliminated.end..]);
            } else {
                add(&mut right[row - eliminated.end..], &row_entries[row..]);
            }
        }
    }
}

impl GroupSums {
    /// Adds a term's eliminated columns: against themselves, the reduced columns and the residual.
    fn add(&mut self, gram: &Local<'_>, eliminated: &std::ops::Range<usize>, runs: &[CouplingRun]) {
        let &Local { entries, n } = gram;
        let n_coupled = self.coupling.len() / SIDE;
        for k in 0..SIDE {
            let row = (eliminated.start + k) * n;
            for l in k..SIDE {
                self.own[k][l] += entries[row + eliminated.start + l];
            }
            self.gradient[k] += entries[row + n - 1];
        }
        for run in runs {
            for k in 0..SIDE {
                let first = k * n_coupled + run.place;
                let target = &mut self.coupling[first..first + run.length];
                if run.column < eliminated.start {
                    // Above the eliminated rows: down their columns.
                    let column = &entries[run.column * n + eliminated.start + k..];
                    for (sum, part) in target.iter_mut().zip(column.iter().step_by(n)) {
                        *sum += part;
                    }
                } else {
                    add(target, &entries[(eliminated.start + k) * n + run.column..]);
                }
            }
        }
    }

    /// Adds a term with local support to these sums and to the `shared` ones.
    fn add_local(
        &mut self,
        term: &dyn LocalTerm,
        place: &TermPlace,
        values: Values<'_>,
        (shared, room): (&mut [f64], &mut [f64]),
        scratch: &mut Scratch,
    ) -> Accumulated {
        let support = place.support.as_deref().unwrap_or_default();
        let n = support.len();
        let coupling = &mut room[..SIDE * n];
        coupling.fill(0.0);
        let (mut own, mut gradient) = ([[0.0; SIDE]; SIDE], [0.0; SIDE]);
        let mut eliminated = EliminatedSums { own: &mut own, gradient: &mut gradient, coupling };
        let accumulated = term.accumulate(values, support, shared, &mut eliminated, scratch);
        let n_coupled = self.coupling.len() / SIDE;
        for k in 0..SIDE {
            add(&mut self.own[k], &own[k]);
            for run in &place.coupling {
                let first = k * n_coupled + run.place;
                add(&mut self.coupling[first..first + run.length], &room[k * n + run.column..(k + 1) * n]);
            }
        }
        add(&mut self.gradient, &gradient);
        accumulated
    }

    /// Completes the lower triangle, and leaves nothing of held columns but a one on the diagonal.
    fn finish(&mut self, held: &[bool]) {
        for k in 0..SIDE {
            for l in 0..k {
                self.own[k][l] = self.own[l][k];
            }
        }
        let n_coupled = self.coupling.len() / SIDE;
        for k in (0..SIDE).filter(|&k| held[k]) {
            for l in 0..SIDE {
                (self.own[k][l], self.own[l][k]) = (0.0, 0.0);
            }
            self.own[k][k] = 1.0;
            self.gradient[k] = 0.0;
            self.coupling[k * n_coupled..(k + 1) * n_coupled].fill(0.0);
        }
    }
}

fn add(sums: &mut [f64], parts: &[f64]) {
    for (sum, part) in sums.iter_mut().zip(parts) {
        *sum += part;
    }
}
