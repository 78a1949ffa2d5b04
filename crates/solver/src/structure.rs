//! What the solver works out once: which column is where, and which terms are evaluated together.

use std::collections::BTreeSet;
use std::collections::btree_map::{BTreeMap, Entry};
use std::mem;
use std::ops::Range;
use std::sync::Arc;

use crate::composite::{CompositeColumns, CompositeTerm};
use crate::ordering::{Cliques, Graph, Run};
use crate::pattern::Pattern;
use crate::problem::{Elimination, POSE_COLUMNS, Problem, Term};

/// Marks a column that is held fixed.
pub(crate) const HELD: u32 = u32::MAX;

/// The parts of the work that threads take one at a time. Their number depends on the problem only,
/// so that sums are always formed in the same order.
const MAX_CHUNKS: usize = 32;

/// The same where terms with local support share sums that are longer than their work.
const MAX_LOCAL_CHUNKS: usize = 4;

/// Fewer rows are not worth a part.
const ROWS_PER_CHUNK: usize = 2_000;

/// The parts of what elimination sums, each of which is as large as the reduced system.
const MAX_SCHUR_CHUNKS: usize = 8;

/// Beyond this many numbers, partial sums of the reduced system take fewer chunks instead of more memory.
const MAX_PARTIAL_SUM: usize = 8 << 20;

/// The same for a sparse system, where clearing and adding partial sums costs more than filling them.
const MAX_SPARSE_PARTIAL_SUM: usize = 1 << 20;

/// When the reduced system is sparse.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SparseRule {
    /// With fewer reduced columns, a dense system is factored before a sparse one is thought out.
    pub least_columns: usize,
    /// How much longer an operation takes in a sparse factorization than in a dense one.
    pub toll: f64,
}

/// The rule as measured.
const MEASURED: SparseRule = SparseRule { least_columns: 256, toll: 4.0 };

/// Where everything of a problem is.
#[derive(Debug)]
pub(crate) struct Structure {
    /// For each block, the first of its tangent columns in a full step.
    pub first_column: Vec<usize>,
    /// The number of all tangent columns, held ones included.
    pub n_columns: usize,
    /// For each block, the reduced column of each tangent column, or `HELD`. Empty for eliminated blocks.
    pub reduced_columns: Vec<Vec<u32>>,
    /// The number of reduced columns.
    pub n_reduced: usize,
    /// For each reduced column, which it is when counted in the order of the blocks.
    pub natural_columns: Vec<u32>,
    /// The entries of the reduced system, if it is sparse.
    pub sparse: Option<Pattern>,
    /// The distinct lists of reduced blocks that terms see; sums over terms of one list are kept together.
    pub signatures: Vec<Signature>,
    /// Reduced columns that measure the same thing in the same unit, set by set.
    pub alike: BTreeSet<Vec<u32>>,
    /// The terms, each with the place of its columns, in the order of evaluation.
    pub terms: Vec<TermPlace>,
    /// Terms that share an eliminated block, or a single term without one.
    pub groups: Vec<Group>,
    /// The groups that are worked on together.
    pub chunks: Vec<Range<usize>>,
    /// The chunks over which the Schur complement is summed.
    pub schur_chunks: Vec<Range<usize>>,
}

/// A list of reduced blocks that some terms see.
#[derive(Debug)]
pub(crate) struct Signature {
    /// For each column of the list's blocks, the reduced column or `HELD`.
    pub columns: Vec<u32>,
    /// How terms lie that have a composite pose, if they do.
    pub composite: Option<CompositePlace>,
    /// What sums mean that are no matrix.
    pub local: Option<LocalSignature>,
}

/// What the sums of terms with local support mean.
#[derive(Debug)]
pub(crate) struct LocalSignature {
    /// The term that knows.
    pub term_idx: usize,
    pub n_sums: usize,
    /// Pairs of the list's columns, the residual behind the last.
    pub entries: Vec<[u32; 2]>,
    /// Whether its terms see an eliminated block.
    is_eliminated: bool,
}

/// Where the columns of composite terms of one kind are.
#[derive(Clone, Debug)]
pub(crate) struct CompositePlace {
    pub columns: Arc<CompositeColumns>,
    /// The number of all columns of a term.
    pub n_columns: usize,
    /// The first column of the eliminated link.
    pub eliminated: Option<usize>,
    /// The only link that is left, if it moves the composite as it moves itself: what there is to know
    /// of it stands in the sums of products.
    pub alone: Option<usize>,
}

impl CompositePlace {
    fn new(term: &dyn CompositeTerm, n_columns: usize, eliminated: Option<usize>) -> Self {
        let columns = term.columns().clone();
        let n_left = columns.link_count(n_columns) - usize::from(eliminated.is_some());
        let is_left = |link: &usize| eliminated != Some(columns.first_column(*link));
        let alone = term.outer_link().filter(|link| n_left == 1 && is_left(link));
        Self { columns, n_columns, eliminated, alone }
    }

    fn is_like(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.columns, &other.columns)
            && (self.n_columns, self.eliminated, self.alone)
                == (other.n_columns, other.eliminated, other.alone)
    }
}

/// Where a term's columns belong.
#[derive(Clone, Debug)]
pub(crate) struct TermPlace {
    /// The term, as an index into the problem's.
    pub term_idx: usize,
    pub signature: usize,
    /// The columns of the eliminated block among the term's, if it has one.
    pub eliminated: Option<Range<usize>>,
    /// The number of the term's columns.
    pub n_columns: usize,
    /// Where its free reduced columns are in the group's coupling.
    pub coupling: Arc<[CouplingRun]>,
    /// Which of its signature's columns it may touch, for a term with local support; runs of the
    /// coupling then count in these.
    pub support: Option<Vec<u32>>,
}

/// Consecutive columns of a block of a term that are consecutive in its group's coupling.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct CouplingRun {
    /// The first, among the term's columns; for a composite term, where it is in a link's row.
    pub column: usize,
    /// Where it is in the coupling.
    pub place: usize,
    pub length: usize,
    /// Whether no earlier term of the group has these, so that they need not have been cleared.
    pub is_first: bool,
}

/// Terms that share an eliminated block.
#[derive(Debug)]
pub(crate) struct Group {
    pub eliminated: Option<usize>,
    /// Its terms, as a range of [`Structure::terms`].
    pub terms: Range<usize>,
    /// The reduced columns that the eliminated block is coupled with, in increasing order.
    pub columns: Arc<[u32]>,
    /// Maximal runs of consecutive reduced columns: (first position in `columns`, reduced column, length).
    pub runs: Arc<[(usize, usize, usize)]>,
}

impl Group {
    /// Returns how long it takes to eliminate its block, as measured, in multiply-adds of its outer product.
    fn elimination_weight(&self) -> usize {
        let n = self.columns.len();
        self.eliminated.map_or(1, |_| n * n + 32 * n + 2_500)
    }
}

impl Structure {
    /// Returns the structure of a problem, whose terms with local support are near `values`.
    pub(crate) fn new(problem: &Problem<'_>, values: &[f64]) -> Self {
        Self::by_rule(problem, values, MEASURED)
    }

    /// Does what [`new`](Self::new) does, by another rule.
    pub(crate) fn by_rule(problem: &Problem<'_>, values: &[f64], rule: SparseRule) -> Self {
        let blocks = &problem.parameters.blocks;
        let mut first_column = Vec::with_capacity(blocks.len());
        let mut reduced_columns = Vec::with_capacity(blocks.len());
        let (mut n_columns, mut n_reduced) = (0, 0);
        for block in blocks {
            first_column.push(n_columns);
            n_columns += block.n_columns;
            let mut columns = Vec::new();
            if block.elimination == Elimination::Reduced {
                for &held in &block.held {
                    columns.push(if held { HELD } else { n_reduced });
                    n_reduced += u32::from(!held);
                }
            }
            reduced_columns.push(columns);
        }
        let mut structure = Self {
            first_column,
            n_columns,
            reduced_columns,
            n_reduced: n_reduced as usize,
            natural_columns: (0..n_reduced).collect(),
            sparse: None,
            signatures: Vec::new(),
            alike: BTreeSet::new(),
            terms: Vec::new(),
            groups: Vec::new(),
            chunks: Vec::new(),
            schur_chunks: Vec::new(),
        };
        let supports: Vec<Option<Vec<u32>>> = problem
            .terms
            .iter()
            .map(|term| term.local().map(|local| local.support(problem.parameters.at(values))))
            .collect();
        let order = structure.sparse_order(problem, &supports, rule);
        if let Some((graph, nodes)) = &order {
            structure.renumber(graph, nodes);
        }
        structure.place_terms(problem, supports);
        structure.find_alike(problem);
        structure.sparse = order
            .map(|(graph, nodes)| Pattern::new(&graph, &nodes, &structure.signatures, &structure.groups));
        structure.cut_chunks(problem);
        structure
    }

    /// Returns the number of entries of the reduced system that partial sums are made of.
    pub(crate) fn n_entries(&self) -> usize {
        self.sparse.as_ref().map_or(self.n_reduced * self.n_reduced, Pattern::n_entries)
    }

    /// Returns the order in which a sparse reduced system is best factored, or `None` if it should be dense.
    fn sparse_order(
        &self,
        problem: &Problem<'_>,
        supports: &[Option<Vec<u32>>],
        rule: SparseRule,
    ) -> Option<(Graph, Vec<u32>)> {
        if self.n_reduced < rule.least_columns {
            return None;
        }
        let dense_operations = (self.n_reduced as f64).powi(3) / 6.0;
        let graph = Graph::new(self.n_reduced, &self.cliques(problem, supports));
        let ordering = graph.best_order();
        (rule.toll * ordering.operations < dense_operations).then_some((graph, ordering.nodes))
    }

    /// Returns the sets of reduced columns that terms and eliminations make dense.
    fn cliques(&self, problem: &Problem<'_>, supports: &[Option<Vec<u32>>]) -> Cliques {
        let blocks = &problem.parameters.blocks;
        let mut of_block: BTreeMap<usize, Vec<u32>> = BTreeMap::new();
        let mut cliques = Cliques::new();
        let all_columns = |term: &&dyn Term| -> Vec<u32> {
            let columns = term.blocks().iter().flat_map(|block| &self.reduced_columns[block.0]);
            columns.copied().collect()
        };
        for (term, support) in problem.terms.iter().zip(supports) {
            let is_first = |block: usize| blocks[block].elimination == Elimination::First;
            let touched: Vec<u32> = match support {
                None => all_columns(term).into_iter().filter(|&column| column != HELD).collect(),
                Some(support) => {
                    let all = all_columns(term);
                    support.iter().map(|&k| all[k as usize]).filter(|&column| column != HELD).collect()
                }
            };
            match term.blocks().iter().find(|block| is_first(block.0)) {
                Some(block) => of_block.entry(block.0).or_default().extend(touched),
                None => match term.local() {
                    None => {
                        cliques.insert(sorted_runs(touched));
                    }
                    // Each of its pairs of columns, but not all of them together.
                    Some(local) => {
                        let all = all_columns(term);
                        let column = |column: u32| all.get(column as usize).filter(|&&c| c != HELD);
                        let pairs = local.entries().into_iter().filter(|[a, b]| a != b);
                        let pairs = pairs.filter_map(|[a, b]| Some(vec![*column(a)?, *column(b)?]));
                        cliques.extend(pairs.map(sorted_runs));
                    }
                },
            }
        }
        cliques.extend(of_block.into_values().map(sorted_runs));
        cliques
    }

    /// Counts the reduced columns in the order of the graph's nodes.
    fn renumber(&mut self, graph: &Graph, nodes: &[u32]) {
        self.natural_columns = nodes.iter().flat_map(|&node| graph.columns(node)).collect();
        let mut new = vec![0; self.n_reduced];
        for (column, &natural) in self.natural_columns.iter().enumerate() {
            new[natural as usize] = column as u32;
        }
        for column in self.reduced_columns.iter_mut().flatten().filter(|column| **column != HELD) {
            *column = new[*column as usize];
        }
    }

    /// Groups terms by eliminated block; groups that are coupled with the same columns follow each other.
    fn place_terms(&mut self, problem: &Problem<'_>, mut supports: Vec<Option<Vec<u32>>>) {
        let blocks = &problem.parameters.blocks;
        let is_eliminated = |block: usize| blocks[block].elimination == Elimination::First;
        // Most groups see what another sees, and their terms lie as those of the first one.
        let mut first_like: BTreeMap<Vec<usize>, usize> = BTreeMap::new();
        let mut signatures_of: BTreeMap<Vec<usize>, Vec<usize>> = BTreeMap::new();
        // Where each reduced column is in the coupling of the group at hand.
        let mut places: Vec<Option<u32>> = vec![None; self.n_reduced];
        for (eliminated, term_idxs) in members(problem) {
            if let Some(likeness) = eliminated.and_then(|_| likeness(problem, &term_idxs, &supports)) {
                match first_like.entry(likeness) {
                    Entry::Occupied(first) => {
                        self.place_like(*first.get(), eliminated, &term_idxs);
                        continue;
                    }
                    Entry::Vacant(place) => {
                        place.insert(self.groups.len());
                    }
                }
            }
            let reduced_blocks = |term_idx: usize| {
                problem.terms[term_idx]
                    .blocks()
                    .iter()
                    .map(|block| block.0)
                    .filter(|&block| !is_eliminated(block))
            };
            let mut columns: Vec<u32> = Vec::new();
            if eliminated.is_some() {
                for &term_idx in &term_idxs {
                    let all =
                        reduced_blocks(term_idx).flat_map(|block| &self.reduced_columns[block]).copied();
                    match &supports[term_idx] {
                        None => columns.extend(all),
                        Some(support) => {
                            let all: Vec<u32> = all.collect();
                            columns.extend(support.iter().map(|&column| all[column as usize]));
                        }
                    }
                }
                // Most columns are those of several terms; the first mention counts.
                columns.retain(|&column| column != HELD && places[column as usize].replace(0).is_none());
                columns.sort_unstable();
                for (place, &column) in columns.iter().enumerate() {
                    places[column as usize] = Some(place as u32);
                }
            }
            // No held column is in it.
            let place_of = |column: u32| places.get(column as usize)?.map(|place| place as usize);
            let mut is_first = vec![true; columns.len()];
            let first_term = self.terms.len();
            for term_idx in term_idxs {
                let list: Vec<usize> = reduced_blocks(term_idx).collect();
                let signature_columns = || -> Vec<u32> {
                    list.iter().flat_map(|&block| &self.reduced_columns[block]).copied().collect()
                };
                let support = supports[term_idx].take();
                let mut coupling: Vec<CouplingRun> = Vec::new();
                let mut extend = |column: usize, place: usize, is_new: bool| {
                    let is_first = mem::replace(&mut is_first[place], false);
                    extend(&mut coupling, CouplingRun { column, place, length: 1, is_first }, is_new);
                };
                let mut eliminated_columns = None;
                let mut n_columns = 0;
                for block in problem.terms[term_idx].blocks() {
                    let end = n_columns + blocks[block.0].n_columns;
                    if is_eliminated(block.0) {
                        eliminated_columns = Some(n_columns..end);
                    } else if eliminated.is_some() && support.is_none() {
                        for (k, &column) in self.reduced_columns[block.0].iter().enumerate() {
                            if let Some(place) = place_of(column) {
                                extend(n_columns + k, place, k == 0);
                            }
                        }
                    }
                    n_columns = end;
                }
                if let Some(support) = &support {
                    let all = signature_columns();
                    for (k, &column) in support.iter().enumerate() {
                        if let Some(place) = place_of(all[column as usize]) {
                            extend(k, place, k == 0);
                        }
                    }
                }
                let composite = problem.terms[term_idx].composite().filter(|_| support.is_none());
                let first_eliminated = eliminated_columns.as_ref().map(|columns| columns.start);
                let composite = composite.map(|term| CompositePlace::new(term, n_columns, first_eliminated));
                if let Some(place) = &composite {
                    coupling.iter_mut().for_each(|run| run.column = place.columns.place_in_row(run.column));
                }
                let known = match signatures_of.get_mut(&list) {
                    Some(known) => known,
                    None => signatures_of.entry(list.clone()).or_default(),
                };
                let found = known.iter().copied().find(|&known| {
                    let Signature { composite: known, local, .. } = &self.signatures[known];
                    match (known, &composite) {
                        (Some(known), Some(composite)) => known.is_like(composite),
                        (None, None) => {
                            let is_eliminated = eliminated.is_some();
                            local.as_ref().map(|local| local.is_eliminated)
                                == support.as_ref().map(|_| is_eliminated)
                        }
                        _ => false,
                    }
                });
                let signature = found.unwrap_or_else(|| {
                    known.push(self.signatures.len());
                    let local = problem.terms[term_idx].local().map(|local| LocalSignature {
                        term_idx,
                        n_sums: local.sum_count(),
                        entries: local.entries(),
                        is_eliminated: eliminated.is_some(),
                    });
                    self.signatures.push(Signature { columns: signature_columns(), composite, local });
                    self.signatures.len() - 1
                });
                self.terms.push(TermPlace {
                    term_idx,
                    signature,
                    eliminated: eliminated_columns,
                    n_columns,
                    coupling: coupling.into(),
                    support,
                });
            }
            for &column in &columns {
                places[column as usize] = None;
            }
            let (runs, terms) = (runs(&columns).into(), first_term..self.terms.len());
            self.groups.push(Group { eliminated, terms, columns: columns.into(), runs });
        }
        // Groups with the same columns are eliminated together.
        self.groups.sort_by(|a, b| a.columns.cmp(&b.columns));
    }

    /// Places the terms of a group as those of another that it is like.
    fn place_like(&mut self, like: usize, eliminated: Option<usize>, term_idxs: &[usize]) {
        let Group { columns, runs, terms, .. } = &self.groups[like];
        let (columns, runs) = (columns.clone(), runs.clone());
        let first_term = self.terms.len();
        for (&term_idx, place) in term_idxs.iter().zip(terms.clone()) {
            self.terms.push(TermPlace { term_idx, ..self.terms[place].clone() });
        }
        self.groups.push(Group { eliminated, terms: first_term..self.terms.len(), columns, runs });
    }

    /// Finds the columns that are damped alike.
    fn find_alike(&mut self, problem: &Problem<'_>) {
        for Signature { columns, local, .. } in &self.signatures {
            let Some(term) = local.as_ref().and_then(|local| problem.terms[local.term_idx].local()) else {
                continue;
            };
            let free: Vec<u32> = columns[term.alike()].iter().copied().filter(|&c| c != HELD).collect();
            if !free.is_empty() {
                self.alike.insert(free);
            }
        }
    }

    /// Returns each full tangent column that is reduced, with its reduced column.
    pub(crate) fn each_reduced(&self) -> impl Iterator<Item = (usize, usize)> {
        self.first_column.iter().zip(&self.reduced_columns).flat_map(|(&first, columns)| {
            let reduced = columns.iter().enumerate().filter(|&(_, &column)| column != HELD);
            reduced.map(move |(k, &column)| (first + k, column as usize))
        })
    }

    /// Tells whether a model and its factor cost so much more than a gradient that it pays to keep them.
    pub(crate) fn is_worth_keeping(&self) -> bool {
        !self.alike.is_empty()
    }

    /// Cuts the groups into chunks of about equal work.
    fn cut_chunks(&mut self, problem: &Problem<'_>) {
        let rows = |group: &Group| -> usize {
            self.terms[group.terms.clone()]
                .iter()
                .map(|term| problem.terms[term.term_idx].row_count() + 16)
                .sum()
        };
        let weights: Vec<usize> = self.groups.iter().map(rows).collect();
        let has_local = self.signatures.iter().any(|signature| signature.local.is_some());
        let most = if has_local { MAX_LOCAL_CHUNKS } else { MAX_CHUNKS };
        self.chunks = cut(&weights, (weights.iter().sum::<usize>() / ROWS_PER_CHUNK).clamp(1, most));
        let weights: Vec<usize> = self.groups.iter().map(Group::elimination_weight).collect();
        let room = if self.sparse.is_some() { MAX_SPARSE_PARTIAL_SUM } else { MAX_PARTIAL_SUM };
        let n_sums = (room / self.n_entries().max(1)).clamp(2, MAX_SCHUR_CHUNKS);
        if self.groups.iter().any(|group| group.eliminated.is_some()) {
            self.schur_chunks = cut(&weights, n_sums);
        }
    }

    /// Returns the number of columns of the eliminated block of a group.
    pub(crate) const fn eliminated_columns() -> usize {
        POSE_COLUMNS
    }
}

/// Returns the terms that each eliminated block has, and those without one, each alone, in the order of the terms.
fn members(problem: &Problem<'_>) -> Vec<(Option<usize>, Vec<usize>)> {
    let blocks = &problem.parameters.blocks;
    let mut members: Vec<(Option<usize>, Vec<usize>)> = Vec::new();
    let mut group_of_block = vec![None; blocks.len()];
    for (term_idx, term) in problem.terms.iter().enumerate() {
        let mut touched = term.blocks().iter().map(|block| block.0);
        match touched.find(|&block| blocks[block].elimination == Elimination::First) {
            Some(block) => {
                let group = *group_of_block[block].get_or_insert(members.len());
                if group == members.len() {
                    members.push((Some(block), Vec::new()));
                }
                members[group].1.push(term_idx);
            }
            None => members.push((None, vec![term_idx])),
        }
    }
    members
}

/// Returns what says where the columns of a group's terms lie, whichever block is eliminated; `None` if the terms'
/// supports say it.
fn likeness(problem: &Problem<'_>, term_idxs: &[usize], supports: &[Option<Vec<u32>>]) -> Option<Vec<usize>> {
    let blocks = &problem.parameters.blocks;
    let mut likeness = Vec::with_capacity(8 * term_idxs.len());
    for &term_idx in term_idxs {
        if supports[term_idx].is_some() {
            return None;
        }
        let term = problem.terms[term_idx];
        likeness.push(term.blocks().len());
        likeness.extend(term.blocks().iter().map(|block| match blocks[block.0].elimination {
            Elimination::First => usize::MAX,
            Elimination::Reduced => block.0,
        }));
        let composite = term.composite();
        likeness.push(composite.map_or(0, |term| Arc::as_ptr(term.columns()).addr()));
        likeness.push(composite.and_then(|term| term.outer_link()).map_or(0, |link| link + 1));
    }
    Some(likeness)
}

/// Adds a column to the last run if it continues that and is not the first of a block, else begins a new one.
fn extend(runs: &mut Vec<CouplingRun>, one: CouplingRun, is_new: bool) {
    match runs.last_mut() {
        Some(run)
            if !is_new
                && run.is_first == one.is_first
                && run.column + run.length == one.column
                && run.place + run.length == one.place =>
        {
            run.length += 1;
        }
        _ => runs.push(one),
    }
}

/// Returns the maximal runs of a set of columns in any order.
fn sorted_runs(mut columns: Vec<u32>) -> Vec<Run> {
    columns.sort_unstable();
    columns.dedup();
    runs(&columns).into_iter().map(|(_, first, length)| (first as u32, (first + length) as u32)).collect()
}

/// Returns the maximal runs of consecutive numbers in a sorted list.
fn runs(columns: &[u32]) -> Vec<(usize, usize, usize)> {
    let mut runs: Vec<(usize, usize, usize)> = Vec::new();
    for (position, &column) in columns.iter().enumerate() {
        match runs.last_mut() {
            Some((_, first, length)) if *first + *length == column as usize => *length += 1,
            _ => runs.push((position, column as usize, 1)),
        }
    }
    runs
}

/// Cuts a list into at most `n_parts` contiguous parts of about equal weight.
fn cut(weights: &[usize], n_parts: usize) -> Vec<Range<usize>> {
    let total: usize = weights.iter().sum();
    let mut parts = Vec::new();
    let (mut start, mut sum) = (0, 0);
    for (idx, weight) in weights.iter().enumerate() {
        sum += weight;
        if sum * n_parts >= total * (parts.len() + 1) {
            parts.push(start..idx + 1);
            start = idx + 1;
        }
    }
    if start < weights.len() {
        parts.push(start..weights.len());
    }
    parts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cuts_cover_everything_once() {
        for (weights, n_parts) in
            [(vec![1; 100], 16), (vec![5], 16), (vec![], 4), (vec![0, 0, 7, 0], 3), (vec![9, 1, 1], 2)]
        {
            let parts = cut(&weights, n_parts);
            let covered: Vec<usize> = parts.iter().cloned().flatten().collect();
            assert_eq!(covered, (0..weights.len()).collect::<Vec<_>>());
            assert!(parts.len() <= n_parts.max(1), "{parts:?}");
        }
    }

    #[test]
    fn runs_are_maximal() {
        assert_eq!(runs(&[0, 1, 2, 5, 6, 9]), [(0, 0, 3), (3, 5, 2), (5, 9, 1)]);
        assert_eq!(runs(&[]), []);
    }
}
