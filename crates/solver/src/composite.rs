//! Terms whose poses act through one composite pose, and the short way from their sums to the model.
//!
//! Such a term differentiates with respect to the composite of a chain of poses, which takes six
//! columns however long the chain is; each link moves the composite through a 6x6 map. The sums of
//! the term's own parameters are those of all terms of a kind and are added up as they lie; only the
//! six rows of the composite pose are mapped to the links, term by term.

use std::sync::Arc;

use boresight_geometry::{Matrix3, Vector3};
use pulp::{Simd, WithSimd};

use crate::gram::{PairGram, Row};
use crate::linearization::{GroupSums, SIDE};
use crate::problem::{GramMut, POSE_COLUMNS, Scratch, Term, Values};
use crate::structure::{CompositePlace, CouplingRun};

/// The most links of a chain that are blocks: camera, mount, robot, target mount, target, and room to spare.
pub const MAX_LINKS: usize = 8;

/// A term whose poses act through one composite pose.
///
/// Its columns are its own parameters', then those of the links of the chain, in order.
pub trait CompositeTerm: Term {
    /// Returns where the products of its columns lie.
    fn columns(&self) -> &Arc<CompositeColumns>;

    /// Leaves the sums of the products of all rows in `scratch.gram` and the maps of the links in
    /// `scratch.links`, or returns `None` where the term is not defined.
    fn sum_products(&self, values: Values<'_>, scratch: &mut Scratch) -> Option<Weighed>;
}

/// What the sums of products of a term stand for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weighed {
    /// What the sums are to be multiplied by.
    pub factor: f64,
    /// The term's cost, as [`Term::linearize`] has it.
    pub cost: f64,
}

/// The maps of a chain's links, in order.
#[derive(Clone, Debug, Default)]
pub struct Links {
    maps: [Option<LinkMap>; MAX_LINKS],
    n: usize,
}

/// How a left perturbation of a link moves the composite pose: the adjoint of a pose, or less that.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinkMap {
    rotation: [[f64; 3]; 3],
    /// What a rotation of the link moves the composite by.
    lever: [[f64; 3]; 3],
}

impl Links {
    /// Forgets all links.
    pub fn clear(&mut self) {
        self.n = 0;
    }

    /// Adds a link; `None` is the identity, which spares the products.
    ///
    /// # Panics
    /// If there are more than [`MAX_LINKS`].
    #[inline(always)]
    pub fn push(&mut self, map: Option<LinkMap>) {
        self.maps[self.n] = map;
        self.n += 1;
    }

    /// Returns the maps.
    pub fn maps(&self) -> &[Option<LinkMap>] {
        &self.maps[..self.n]
    }
}

impl LinkMap {
    /// Returns `sign` times the adjoint of the pose of this rotation and translation.
    #[inline(always)]
    pub fn adjoint(rotation: &Matrix3<f64>, t: &Vector3<f64>, sign: f64) -> Self {
        let mut map = Self { rotation: [[0.0; 3]; 3], lever: [[0.0; 3]; 3] };
        for k in 0..3 {
            let column = [rotation[(0, k)] * sign, rotation[(1, k)] * sign, rotation[(2, k)] * sign];
            for l in 0..3 {
                map.rotation[l][k] = column[l];
            }
            map.lever[0][k] = t.y * column[2] - t.z * column[1];
            map.lever[1][k] = t.z * column[0] - t.x * column[2];
            map.lever[2][k] = t.x * column[1] - t.y * column[0];
        }
        map
    }

    /// Returns `row`, derivatives by the composite's perturbation, as derivatives by the link's.
    #[inline(always)]
    pub fn map_row(&self, row: [f64; POSE_COLUMNS]) -> [f64; POSE_COLUMNS] {
        let mut mapped = [0.0; POSE_COLUMNS];
        for k in 0..3 {
            for l in 0..3 {
                mapped[k] += row[l] * self.rotation[l][k] + row[3 + l] * self.lever[l][k];
                mapped[3 + k] += row[3 + l] * self.rotation[l][k];
            }
        }
        mapped
    }
}

/// Where the products of a term's columns lie among its sums.
///
/// The columns are its own parameters', the composite pose's and the residual.
#[derive(Clone, Debug)]
pub struct CompositeColumns {
    n_own: usize,
    n_sums: usize,
    /// For each entry of the upper triangle over own columns and residual, the two sums that make it up.
    own: Vec<[u32; 2]>,
    /// The same for all columns of the six rows of the composite pose, rows [`stride`](Self::stride) apart.
    pose: Vec<[u32; 2]>,
}

impl CompositeColumns {
    /// Returns where the products lie, given for each column which column of the rows it is, and in
    /// which of a pixel's two rows it alone is not zero, if in one only.
    ///
    /// The columns are `n_own` own ones, six of the composite pose, and the residual. The rows have
    /// `n_row_columns`; columns of one row alone must be among the first [`BLOCK`](crate::gram::BLOCK).
    pub fn new(n_own: usize, n_row_columns: usize, column: impl Fn(usize) -> (Option<Row>, usize)) -> Self {
        let n_lanes = crate::lanes::count();
        let n_sums = PairGram::sum_count(n_row_columns);
        let nothing = n_sums as u32;
        let residual = n_own + POSE_COLUMNS;
        let sums = |a: usize, b: usize| {
            let ((row_a, a), (row_b, b)) = (column(a), column(b));
            let place = |row| PairGram::place(n_row_columns, n_lanes, row, a, b) as u32;
            match (row_a, row_b) {
                (Some(a), Some(b)) if a != b => [nothing; 2],
                (Some(row), _) | (_, Some(row)) => [place(row), nothing],
                _ if a.min(b) < crate::gram::BLOCK => [place(Row::U), place(Row::V)],
                _ => [place(Row::U), nothing],
            }
        };
        let of_own: Vec<usize> = (0..n_own).chain([residual]).collect();
        let mut own = Vec::new();
        for (k, &a) in of_own.iter().enumerate() {
            own.extend(of_own[k..].iter().map(|&b| sums(a, b)));
        }
        let mut columns = Self { n_own, n_sums, own, pose: Vec::new() };
        let stride = columns.stride();
        for row in 0..POSE_COLUMNS {
            columns.pose.extend((0..=residual).map(|b| sums(n_own + row, b)));
            columns.pose.resize((row + 1) * stride, [nothing; 2]);
        }
        columns
    }

    /// Returns the number of the term's own columns.
    pub fn own_count(&self) -> usize {
        self.n_own
    }

    /// Returns the place of the residual's products with itself.
    pub fn squares(&self, sums: &[f64]) -> f64 {
        self.own.last().map_or(0.0, |&places| at(sums, places))
    }

    fn stride(&self) -> usize {
        (self.n_own + POSE_COLUMNS + 1).next_multiple_of(crate::lanes::MAX_LANES)
    }

    fn residual(&self) -> usize {
        self.n_own + POSE_COLUMNS
    }

    /// Calls `write` with each entry of the upper triangle over own columns and residual, whose
    /// column is `n_own` here.
    pub(crate) fn each_own(&self, sums: &[f64], mut write: impl FnMut(usize, usize, f64)) {
        let mut places = self.own.iter();
        for a in 0..=self.n_own {
            for (b, places) in (a..=self.n_own).zip(&mut places) {
                write(a, b, at(sums, *places));
            }
        }
    }
}

#[inline(always)]
fn at(sums: &[f64], [first, second]: [u32; 2]) -> f64 {
    sums[first as usize] + sums[second as usize]
}

/// Writes what a term's products amount to as a plain matrix of all its columns.
///
/// This is what [`Term::linearize`] of a composite term does; the solver itself goes the short way.
pub fn linearize_composite(
    term: &dyn CompositeTerm,
    values: Values<'_>,
    gram: &mut GramMut<'_>,
    scratch: &mut Scratch,
) -> Option<f64> {
    let Weighed { factor, cost } = term.sum_products(values, scratch)?;
    expand_composite(term.columns(), factor, gram, scratch);
    Some(cost)
}

/// Writes what the sums and links in `scratch` amount to, times `factor`, as a plain matrix of all columns.
pub fn expand_composite(
    columns: &CompositeColumns,
    factor: f64,
    gram: &mut GramMut<'_>,
    scratch: &mut Scratch,
) {
    let last = gram.size() - 1;
    let place = |column: usize| if column == columns.n_own { last } else { column };
    columns.each_own(scratch.gram.sums(), |a, b, sum| gram.row_mut(place(a))[place(b)] = factor * sum);
    let Scratch { links, gram: sums, pose_rows, .. } = scratch;
    let pose_rows = gather(columns, sums.sums(), factor, pose_rows);
    let (stride, n_own) = (columns.stride(), columns.n_own);
    for (link, map) in links.maps().iter().enumerate() {
        let mut mapped = vec![0.0; POSE_COLUMNS * stride];
        map_rows(pose_rows, map, stride, &mut mapped);
        for (k, row) in mapped.chunks_exact(stride).enumerate() {
            let column = n_own + POSE_COLUMNS * link + k;
            for (a, entry) in row[..n_own].iter().enumerate() {
                gram.row_mut(a)[column] = *entry;
            }
            gram.row_mut(column)[last] = row[columns.residual()];
            for (other, map) in links.maps().iter().enumerate().skip(link) {
                let block = map_pose(&row[n_own..], map);
                let first = n_own + POSE_COLUMNS * other;
                gram.row_mut(column)[first..first + POSE_COLUMNS].copy_from_slice(&block);
            }
        }
    }
}

/// Returns the rows of the composite pose, in `room`.
#[inline(always)]
fn gather<'r>(columns: &CompositeColumns, sums: &[f64], factor: f64, room: &'r mut Vec<f64>) -> &'r [f64] {
    let n = columns.pose.len();
    if room.len() < n {
        room.resize(n, 0.0);
    }
    let rows = &mut room[..n];
    for (entry, &places) in rows.iter_mut().zip(&columns.pose) {
        *entry = factor * at(sums, places);
    }
    rows
}

/// Writes the rows of the composite pose as those of a link.
#[inline(always)]
fn map_rows(rows: &[f64], map: &Option<LinkMap>, stride: usize, mapped: &mut [f64]) {
    let Some(map) = map else {
        mapped.copy_from_slice(rows);
        return;
    };
    for k in 0..3 {
        let (turned, moved) = mapped.split_at_mut(3 * stride);
        let turned = &mut turned[k * stride..(k + 1) * stride];
        let moved = &mut moved[k * stride..(k + 1) * stride];
        for column in 0..stride {
            let (mut turn, mut shift) = (0.0, 0.0);
            for l in 0..3 {
                let (by_turn, by_shift) = (rows[l * stride + column], rows[(3 + l) * stride + column]);
                turn += by_turn * map.rotation[l][k] + by_shift * map.lever[l][k];
                shift += by_shift * map.rotation[l][k];
            }
            turned[column] = turn;
            moved[column] = shift;
        }
    }
}

#[inline(always)]
fn map_pose(row: &[f64], map: &Option<LinkMap>) -> [f64; POSE_COLUMNS] {
    let mut pose = [0.0; POSE_COLUMNS];
    pose.copy_from_slice(&row[..POSE_COLUMNS]);
    map.as_ref().map_or(pose, |map| map.map_row(pose))
}

/// Sums over composite terms of one kind, as they lie.
#[derive(Clone, Debug, Default)]
pub(crate) struct CompositeSums {
    /// Of the products of rows, and a zero.
    pub sums: Vec<f64>,
    /// For each link, six rows over the term's columns and the residual; nothing for an eliminated one.
    pub links: Vec<f64>,
}

impl CompositeSums {
    /// Returns the room for terms of `n_columns` in all.
    pub(crate) fn new(columns: &CompositeColumns, n_columns: usize) -> Self {
        let n_links = (n_columns - columns.n_own) / POSE_COLUMNS;
        Self {
            sums: vec![0.0; columns.n_sums + 1],
            links: vec![0.0; n_links * POSE_COLUMNS * (n_columns + 1)],
        }
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.sums.is_empty()
    }

    pub(crate) fn clear(&mut self) {
        self.sums.fill(0.0);
        self.links.fill(0.0);
    }

    /// Adds everything to the upper triangle `matrix` over the term's columns without the eliminated ones.
    pub(crate) fn add_to(&self, place: &CompositePlace, matrix: &mut [f64]) {
        let &CompositePlace { ref columns, n_columns, eliminated } = place;
        let n_own = columns.n_own;
        let side = n_columns + 1 - eliminated.map_or(0, |_| POSE_COLUMNS);
        let place = |column: usize| match eliminated {
            Some(first) if column > first => column - POSE_COLUMNS,
            _ => column,
        };
        let own_place = |column: usize| if column == n_own { side - 1 } else { column };
        columns.each_own(&self.sums, |a, b, sum| matrix[own_place(a) * side + own_place(b)] += sum);
        for (k, row) in self.links.chunks_exact(n_columns + 1).enumerate() {
            let column = n_own + k;
            if eliminated.is_some_and(|first| (first..first + POSE_COLUMNS).contains(&column)) {
                continue;
            }
            for (other, entry) in row.iter().enumerate() {
                if eliminated.is_some_and(|first| (first..first + POSE_COLUMNS).contains(&other)) {
                    continue;
                }
                let (row, other) = (place(column), place(other));
                if other < n_own || other >= row {
                    matrix[row.min(other) * side + row.max(other)] += entry;
                }
            }
        }
    }
}

/// Adds a composite term to the sums of its kind and of its group.
pub(crate) struct AddComposite<'a> {
    pub columns: &'a CompositeColumns,
    pub factor: f64,
    /// The number of all the term's columns.
    pub n_columns: usize,
    /// The first column of the eliminated link.
    pub eliminated: Option<usize>,
    pub scratch: &'a mut Scratch,
    pub kind: &'a mut CompositeSums,
    pub group: &'a mut GroupSums,
    pub coupling: &'a [CouplingRun],
}

impl WithSimd for AddComposite<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { columns, factor, n_columns, eliminated, scratch, kind, group, coupling } = self;
        let Scratch { gram, links, pose_rows, link_rows, .. } = scratch;
        let (stride, n_own) = (columns.stride(), columns.n_own);
        for (sum, part) in kind.sums.iter_mut().zip(gram.sums()) {
            *sum += factor * part;
        }
        let pose_rows = gather(columns, gram.sums(), factor, pose_rows);
        let n_mapped = POSE_COLUMNS * stride;
        if link_rows.len() < n_mapped + n_columns + 1 {
            link_rows.resize(n_mapped + n_columns + 1, 0.0);
        }
        let (mapped, expanded) = link_rows.split_at_mut(n_mapped);
        let expanded = &mut expanded[..n_columns + 1];
        let maps = links.maps();
        for (link, map) in maps.iter().enumerate() {
            let first = n_own + POSE_COLUMNS * link;
            map_rows(pose_rows, map, stride, mapped);
            for k in 0..POSE_COLUMNS {
                let row = &mapped[k * stride..(k + 1) * stride];
                expanded[..n_own].copy_from_slice(&row[..n_own]);
                expanded[n_columns] = row[columns.residual()];
                for (other, other_map) in maps.iter().enumerate() {
                    let other = n_own + POSE_COLUMNS * other;
                    if eliminated == Some(other) && other != first {
                        continue;
                    }
                    let block = map_pose(&row[n_own..], other_map);
                    expanded[other..other + POSE_COLUMNS].copy_from_slice(&block);
                }
                if eliminated == Some(first) {
                    group.add_row(k, expanded, first, coupling);
                } else {
                    let start = (POSE_COLUMNS * link + k) * (n_columns + 1);
                    add(&mut kind.links[start..start + n_columns + 1], expanded);
                }
            }
        }
    }
}

#[inline(always)]
fn add(sums: &mut [f64], parts: &[f64]) {
    for (sum, part) in sums.iter_mut().zip(parts) {
        *sum += part;
    }
}

const _: () = assert!(SIDE == POSE_COLUMNS);
