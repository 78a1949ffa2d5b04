//! The problem's quadratic model at one point: block diagonals, couplings and gradients.

use std::ops::Range;

use pulp::Arch;

use crate::composite::{AddComposite, CompositeSums, CompositeTerm};
use crate::local::{Accumulated, EliminatedSums, LocalTerm};
use crate::problem::{BlockId, GramMut, Problem, Scratch, Term, TermKind, Values};
use crate::step::damping_diagonal;
use crate::structure::{CouplingRun, Group, HELD, Signature, Structure, TermPlace};
use crate::threads::Threads;

/// The side of an eliminated block.
pub(crate) const SIDE: usize = Structure::eliminated_columns();

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
    /// What damping is relative to: the diagonal, but no less than the mean of columns that are alike.
    pub damping: Vec<f64>,
}

/// What one chunk of groups adds up to.
#[derive(Debug, Default)]
struct Chunk {
    /// What a plain term writes.
    gram: Vec<f64>,
    groups: Vec<GroupSums>,
    /// For each signature, its sums; empty for those that none of the chunk's terms has.
    signatures: Vec<SignatureSums>,
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

/// What one chunk adds to a signature's sums.
#[derive(Clone, Debug)]
enum SignatureSums {
    /// As in [`ReducedSums`].
    Plain(Vec<f64>),
    /// Over composite terms.
    Composite(CompositeSums),
    /// Over terms with local support, who know what they mean.
    Local(Vec<f64>),
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
    /// Returns the room for a model of this structure; that of chunks is made by who evaluates them first.
    pub(crate) fn new(structure: &Structure) -> Self {
        Self {
            chunks: structure.chunks.iter().map(|_| Chunk::default()).collect(),
            reduced: ReducedSums {
                signatures: structure
                    .signatures
                    .iter()
                    .map(|signature| match &signature.local {
                        None => vec![0.0; (signature.columns.len() + 1).pow(2)],
                        Some(local) => vec![0.0; local.entries.len()],
                    })
                    .collect(),
                gradient: vec![0.0; structure.n_reduced],
                diagonal: vec![0.0; structure.n_reduced],
                damping: vec![0.0; structure.n_reduced],
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
        let arch = Arch::new();
        threads.for_each_with(&mut self.chunks, |scratch, chunk_idx, chunk| {
            chunk.evaluate(arch, problem, structure, structure.chunks[chunk_idx].clone(), values, scratch);
        });
        if let Some(failure) = self.chunks.iter().find_map(|chunk| chunk.failure) {
            return Err(failure);
        }
        self.sum(problem, structure, values, threads);
        Ok(())
    }

    /// Returns each group's sums, in order.
    pub(crate) fn groups(&self) -> impl Iterator<Item = &GroupSums> {
        self.chunks.iter().flat_map(|chunk| &chunk.groups)
    }

    /// Adds up the chunks, in order.
    fn sum(&mut self, problem: &Problem<'_>, structure: &Structure, values: &[f64], threads: &Threads) {
        let Self { chunks, reduced, .. } = self;
        self.observation_cost = chunks.iter().map(|chunk| chunk.observation_cost).sum();
        self.prior_cost = chunks.iter().map(|chunk| chunk.prior_cost).sum();
        threads.for_each(&mut reduced.signatures, |idx, sum| {
            let signature = &structure.signatures[idx];
            let parts = chunks.iter().map(|chunk| &chunk.signatures[idx]);
            if let Some(local) = &signature.local {
                let term = problem.terms[local.term_idx].local();
                let Some(term) = term else { return };
                let mut total = vec![0.0; local.n_sums];
                for part in parts {
                    if let SignatureSums::Local(part) = part {
                        add(&mut total, part);
                    }
                }
                term.expand(problem.parameters.at(values), &total, sum);
                return;
            }
            sum.fill(0.0);
            if let Some(place) = &signature.composite {
                let mut total = CompositeSums::new(place);
                for part in parts {
                    if let SignatureSums::Composite(part) = part {
                        total.add(part);
                    }
                }
                total.add_to(place, sum);
                return;
            }
            for part in parts {
                if let SignatureSums::Plain(part) = part {
                    add(sum, part);
                }
            }
        });
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
        let damping = reduced.diagonal.iter().map(|&diagonal| damping_diagonal(diagonal));
        reduced.damping.iter_mut().zip(damping).for_each(|(entry, damping)| *entry = damping);
        // What few points touch would move far for little, and be far off where other points come to.
        for columns in &structure.alike {
            let sum: f64 = columns.iter().map(|&column| reduced.diagonal[column as usize]).sum();
            let mean = sum / columns.len() as f64;
            for &column in columns {
                reduced.damping[column as usize] = reduced.damping[column as usize].max(mean);
            }
        }
    }
}

impl Chunk {
    /// Returns the room for a chunk of these groups.
    fn new(structure: &Structure, groups: Range<usize>) -> Self {
        let groups = &structure.groups[groups];
        let empty = |signature: &Signature| match (&signature.composite, &signature.local) {
            (Some(_), _) => SignatureSums::Composite(CompositeSums::default()),
            (None, Some(_)) => SignatureSums::Local(Vec::new()),
            (None, None) => SignatureSums::Plain(Vec::new()),
        };
        let room = |group: &Group| GroupSums {
            coupling: vec![0.0; SIDE * group.columns.len()],
            ..Default::default()
        };
        let mut chunk = Self {
            groups: groups.iter().map(room).collect(),
            signatures: structure.signatures.iter().map(empty).collect(),
            ..Default::default()
        };
        // With many signatures, most chunks see few of them.
        for place in groups.iter().flat_map(|group| &structure.terms[group.terms.clone()]) {
            let n = place.n_columns + 1;
            let signature = &structure.signatures[place.signature];
            match &mut chunk.signatures[place.signature] {
                SignatureSums::Plain(sums) => {
                    sums.resize((signature.columns.len() + 1).pow(2), 0.0);
                    chunk.gram.resize(chunk.gram.len().max(n * n), 0.0);
                }
                SignatureSums::Composite(sums) if sums.is_empty() => {
                    if let Some(place) = &signature.composite {
                        *sums = CompositeSums::new(place);
                    }
                }
                SignatureSums::Composite(_) => {}
                SignatureSums::Local(sums) => {
                    sums.resize(signature.local.as_ref().map_or(0, |local| local.n_sums), 0.0);
                    let room = SIDE * place.support.as_ref().map_or(0, Vec::len);
                    chunk.gram.resize(chunk.gram.len().max(room), 0.0);
                }
            }
        }
        chunk
    }

    fn evaluate(
        &mut self,
        arch: Arch,
        problem: &Problem<'_>,
        structure: &Structure,
        groups: Range<usize>,
        values: &[f64],
        scratch: &mut Scratch,
    ) {
        if self.signatures.is_empty() {
            *self = Self::new(structure, groups.clone());
        }
        let values = problem.parameters.at(values);
        self.observation_cost = 0.0;
        self.prior_cost = 0.0;
        self.failure = None;
        self.signatures.iter_mut().for_each(SignatureSums::clear);
        for (group_idx, group) in structure.groups[groups].iter().enumerate() {
            self.groups[group_idx].clear();
            for place in &structure.terms[group.terms.clone()] {
                let term = problem.terms[place.term_idx];
                let defined = |cost: Option<f64>| cost.map_or(Accumulated::Undefined, Accumulated::Cost);
                let accumulated = match (term.local(), term.composite()) {
                    (Some(local), _) => {
                        let group = (group_idx, group.eliminated.map(BlockId));
                        self.add_local(local, place, group, values, scratch)
                    }
                    (None, Some(term)) => {
                        let machine = (arch, structure);
                        defined(self.add_composite(machine, term, place, group_idx, values, scratch))
                    }
                    (None, None) => defined(self.add_plain(term, place, group_idx, values, scratch)),
                };
                match (accumulated, term.kind()) {
                    (Accumulated::Cost(cost), TermKind::Observation) if cost.is_finite() => {
                        self.observation_cost += cost;
                    }
                    (Accumulated::Cost(cost), TermKind::Prior) if cost.is_finite() => self.prior_cost += cost,
                    (Accumulated::OutsideSupport, _) => {
                        self.failure = Some(Failure::OutsideSupport);
                        return;
                    }
                    _ => {
                        self.failure = Some(Failure::Undefined { term_idx: place.term_idx });
                        return;
                    }
                }
            }
            if let Some(block) = group.eliminated {
                self.groups[group_idx].finish(&problem.parameters.blocks[block].held);
            }
        }
    }

    /// Adds a term to its group and its signature, and returns its cost if it is defined.
    fn add_plain(
        &mut self,
        term: &dyn Term,
        place: &TermPlace,
        group_idx: usize,
        values: Values<'_>,
        scratch: &mut Scratch,
    ) -> Option<f64> {
        let n = place.n_columns + 1;
        let cost = term.linearize(values, &mut GramMut::new(&mut self.gram, n), scratch)?;
        let gram = Local { entries: &self.gram[..n * n], n };
        let eliminated = place.eliminated.clone().unwrap_or(n..n);
        if place.eliminated.is_some() {
            self.groups[group_idx].add(&gram, &eliminated, &place.coupling);
        }
        if let SignatureSums::Plain(sums) = &mut self.signatures[place.signature] {
            gram.add_reduced(&eliminated, sums);
        }
        Some(cost)
    }

    /// The same for a term with local support.
    fn add_local(
        &mut self,
        term: &dyn LocalTerm,
        place: &TermPlace,
        (group_idx, block): (usize, Option<BlockId>),
        values: Values<'_>,
        scratch: &mut Scratch,
    ) -> Accumulated {
        let support = place.support.as_deref().unwrap_or_default();
        let SignatureSums::Local(shared) = &mut self.signatures[place.signature] else {
            return Accumulated::Undefined;
        };
        let n = support.len();
        let coupling = &mut self.gram[..SIDE * n];
        coupling.fill(0.0);
        let (mut own, mut gradient) = ([[0.0; SIDE]; SIDE], [0.0; SIDE]);
        let mut eliminated = EliminatedSums { block, own: &mut own, gradient: &mut gradient, coupling };
        let accumulated = term.accumulate(values, support, shared, &mut eliminated, scratch);
        if place.eliminated.is_some() {
            let group = &mut self.groups[group_idx];
            let n_coupled = group.coupling.len() / SIDE;
            add(&mut group.gradient, &gradient);
            for (k, own) in own.iter().enumerate() {
                add(&mut group.own[k], own);
                let row = &self.gram[k * n..(k + 1) * n];
                for run in place.coupling.iter() {
                    let first = k * n_coupled + run.place;
                    put(run, &mut group.coupling[first..first + run.length], &row[run.column..]);
                }
            }
        }
        accumulated
    }

    /// The same for a term with a composite pose.
    fn add_composite(
        &mut self,
        (arch, structure): (Arch, &Structure),
        term: &dyn CompositeTerm,
        place: &TermPlace,
        group_idx: usize,
        values: Values<'_>,
        scratch: &mut Scratch,
    ) -> Option<f64> {
        let weighed = term.sum_products(values, scratch)?;
        let signature = &structure.signatures[place.signature].composite;
        if let (SignatureSums::Composite(kind), Some(signature)) =
            (&mut self.signatures[place.signature], signature)
        {
            arch.dispatch(AddComposite {
                place: signature,
                factor: weighed.factor,
                scratch,
                kind,
                group: &mut self.groups[group_idx],
                coupling: &place.coupling,
            });
        }
        Some(weighed.cost)
    }
}

impl SignatureSums {
    fn clear(&mut self) {
        match self {
            Self::Plain(sums) | Self::Local(sums) => sums.fill(0.0),
            Self::Composite(sums) => sums.clear(),
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
    /// Forgets the last sums; the first term that has a part of the coupling overwrites it.
    fn clear(&mut self) {
        self.own = Default::default();
        self.gradient = Default::default();
    }

    /// Adds row `k` of the eliminated block, of which `own` is the place of what it has to do with itself.
    #[inline(always)]
    pub(crate) fn add_row(
        &mut self,
        k: usize,
        row: &[f64],
        own: usize,
        residual: usize,
        runs: &[CouplingRun],
    ) {
        let n_coupled = self.coupling.len() / SIDE;
        add(&mut self.own[k], &row[own..own + SIDE]);
        self.gradient[k] += row[residual];
        let coupling = &mut self.coupling[k * n_coupled..(k + 1) * n_coupled];
        for run in runs {
            put(run, &mut coupling[run.place..run.place + run.length], &row[run.column..]);
        }
    }

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
                        *sum = if run.is_first { *part } else { *sum + part };
                    }
                } else {
                    put(run, target, &entries[(eliminated.start + k) * n + run.column..]);
                }
            }
        }
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

/// Writes or adds what a term has to say on a run of columns.
#[inline(always)]
fn put(run: &CouplingRun, target: &mut [f64], parts: &[f64]) {
    if run.is_first {
        // Runs are short: a loop of known end is quicker than a call.
        for (target, part) in target.iter_mut().zip(parts) {
            *target = *part;
        }
    } else {
        add(target, parts);
    }
}

#[inline(always)]
pub(crate) fn add(sums: &mut [f64], parts: &[f64]) {
    for (sum, part) in sums.iter_mut().zip(parts) {
        *sum += part;
    }
}
