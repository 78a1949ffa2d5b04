//! Terms whose poses act through one composite pose, and the short way from their sums to the model.
//!
//! Such a term differentiates with respect to the composite of a chain of poses, which takes six
//! columns however long the chain is; each link moves the composite through a 6x6 map. The sums of
//! the term's own parameters are those of all terms of a kind and are added up as they lie; only the
//! six rows of the composite pose are mapped to the links, term by term.

use std::sync::Arc;

use boresight_geometry::{Matrix3, Vector3, Vector6};
use pulp::{Simd, WithSimd};

use crate::aligned::Aligned;
use crate::gram::{PairGram, Row};
use crate::lanes::MAX_LANES;
use crate::linearization::{GroupSums, SIDE, add};
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

    /// Returns the link whose map is the identity at any values, if there is one.
    fn outer_link(&self) -> Option<usize>;

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

/// How a left perturbation of a link moves the composite pose: the adjoint of a pose, or less that, or one column.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LinkMap {
    /// Row by row; the last two columns are zero and fill the registers.
    rows: [[f64; BLOCK_STRIDE]; POSE_COLUMNS],
}

/// The distance of rows in a map and in what it makes of the composite's columns.
const BLOCK_STRIDE: usize = MAX_LANES;

impl Links {
    /// Forgets all links.
    pub fn clear(&mut self) {
        self.n = 0;
    }

    /// Adds a link whose map is the identity, which spares the products.
    ///
    /// # Panics
    /// If there are more than [`MAX_LINKS`], as the next.
    #[inline(always)]
    pub fn push_identity(&mut self) {
        self.maps[self.n] = None;
        self.n += 1;
    }

    /// Adds a link whose map is `sign` times the adjoint of the pose of this rotation and translation.
    #[inline(always)]
    pub fn push_adjoint(&mut self, rotation: &Matrix3<f64>, translation: &Vector3<f64>, sign: f64) {
        // In its place: a map is large.
        self.maps[self.n].get_or_insert_default().set_adjoint(rotation, translation, sign);
        self.n += 1;
    }

    /// Adds a link of which one number moves the composite pose, by `tangent` for each unit of its `column`,
    /// and the others move nothing.
    pub fn push_along(&mut self, column: usize, tangent: &Vector6<f64>) {
        self.maps[self.n] = Some(LinkMap::along(column, tangent));
        self.n += 1;
    }

    /// Returns the maps.
    pub fn maps(&self) -> &[Option<LinkMap>] {
        &self.maps[..self.n]
    }
}

impl LinkMap {
    #[inline(always)]
    fn set_adjoint(&mut self, rotation: &Matrix3<f64>, t: &Vector3<f64>, sign: f64) {
        let rows = &mut self.rows;
        for k in 0..3 {
            let [x, y, z] = [rotation[(0, k)] * sign, rotation[(1, k)] * sign, rotation[(2, k)] * sign];
            (rows[0][k], rows[1][k], rows[2][k]) = (x, y, z);
            (rows[3][3 + k], rows[4][3 + k], rows[5][3 + k]) = (x, y, z);
            (rows[0][3 + k], rows[1][3 + k], rows[2][3 + k]) = (0.0, 0.0, 0.0);
            (rows[3][k], rows[4][k], rows[5][k]) = (t.y * z - t.z * y, t.z * x - t.x * z, t.x * y - t.y * x);
        }
    }

    fn along(column: usize, tangent: &Vector6<f64>) -> Self {
        let mut map = Self::default();
        for (row, entry) in map.rows.iter_mut().zip(tangent.iter()) {
            row[column] = *entry;
        }
        map
    }

    /// Returns the map as a matrix, row by row.
    pub fn matrix(&self) -> [[f64; POSE_COLUMNS]; POSE_COLUMNS] {
        self.rows.map(|row| std::array::from_fn(|k| row[k]))
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
    /// The same for all columns of the six rows of the composite pose, rows [`stride`](Self::stride)
    /// apart: the first sum of each, then the second of the few that have one, with the entry.
    pose: Vec<u32>,
    pose_seconds: Vec<(u32, u32)>,
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
        let mut columns = Self { n_own, n_sums, own, pose: Vec::new(), pose_seconds: Vec::new() };
        let stride = columns.stride();
        for row in 0..POSE_COLUMNS {
            for b in 0..=residual {
                let [first, second] = sums(n_own + row, b);
                if second != nothing {
                    columns.pose_seconds.push((columns.pose.len() as u32, second));
                }
                columns.pose.push(first);
            }
            columns.pose.resize((row + 1) * stride, nothing);
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
        (self.n_own + POSE_COLUMNS + 1).next_multiple_of(MAX_LANES)
    }

    fn residual(&self) -> usize {
        self.n_own + POSE_COLUMNS
    }

    /// Returns the number of links of a term with `n_columns` in all.
    pub(crate) fn link_count(&self, n_columns: usize) -> usize {
        (n_columns - self.n_own) / POSE_COLUMNS
    }

    /// Returns the first column of a link among a term's.
    pub(crate) fn first_column(&self, link: usize) -> usize {
        self.n_own + POSE_COLUMNS * link
    }

    /// Returns where a term's column is in the rows of a link.
    pub(crate) fn place_in_row(&self, column: usize) -> usize {
        match column.checked_sub(self.n_own) {
            None => column,
            Some(column) => self.block(column / POSE_COLUMNS) + column % POSE_COLUMNS,
        }
    }

    /// Returns where in the rows of a link its block with `other` begins.
    fn block(&self, other: usize) -> usize {
        self.stride() + other * BLOCK_STRIDE
    }

    /// Writes `factor` times the rows of the composite pose.
    #[inline(always)]
    fn gather(&self, sums: &[f64], factor: f64, rows: &mut [f64]) {
        for (entry, &place) in rows.iter_mut().zip(&self.pose) {
            *entry = factor * sums[place as usize];
        }
        for &(entry, place) in &self.pose_seconds {
            rows[entry as usize] += factor * sums[place as usize];
        }
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
    let n_own = columns.n_own;
    let last = gram.size() - 1;
    let place = |column: usize| if column == n_own { last } else { column };
    columns.each_own(scratch.gram.sums(), |a, b, sum| gram.row_mut(place(a))[place(b)] = factor * sum);
    let mut rows = vec![0.0; POSE_COLUMNS * columns.stride()];
    columns.gather(scratch.gram.sums(), factor, &mut rows);
    let entry = |row: usize, column: usize| rows[row * columns.stride() + column];
    let identity: [[f64; 6]; 6] =
        std::array::from_fn(|k| std::array::from_fn(|l| f64::from(u8::from(k == l))));
    let maps: Vec<_> =
        scratch.links.maps().iter().map(|map| map.map_or(identity, |map| map.matrix())).collect();
    for (link, map) in maps.iter().enumerate() {
        for k in 0..POSE_COLUMNS {
            let mapped =
                |column: usize| map.iter().enumerate().map(|(l, row)| row[k] * entry(l, column)).sum::<f64>();
            let column = n_own + POSE_COLUMNS * link + k;
            for a in 0..n_own {
                gram.row_mut(a)[column] = mapped(a);
            }
            gram.row_mut(column)[last] = mapped(columns.residual());
            let row: [f64; POSE_COLUMNS] = std::array::from_fn(|l| mapped(n_own + l));
            for (other, map) in maps.iter().enumerate().skip(link) {
                let first = n_own + POSE_COLUMNS * other;
                for (l, entry) in gram.row_mut(column)[first..first + POSE_COLUMNS].iter_mut().enumerate() {
                    *entry = row.iter().zip(map).map(|(row, map)| row * map[l]).sum();
                }
            }
        }
    }
}

/// Sums over composite terms of one kind.
#[derive(Clone, Debug, Default)]
pub(crate) struct CompositeSums {
    /// Of the products of rows, as they lie, and a zero.
    pub sums: Aligned,
    /// For each link six rows, which have the mapped columns of the composite term and then
    /// [`BLOCK_STRIDE`] for each link; zeros for an eliminated link, and nothing if one is alone.
    pub links: Aligned,
}

impl CompositeSums {
    /// Returns the room for terms of this kind.
    pub(crate) fn new(place: &CompositePlace) -> Self {
        let columns = &place.columns;
        let n_links = columns.link_count(place.n_columns);
        let n_link_rows = if place.alone.is_some() { 0 } else { n_links * POSE_COLUMNS };
        Self {
            sums: Aligned::zeros(columns.n_sums + 1),
            links: Aligned::zeros(n_link_rows * columns.block(n_links)),
        }
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.sums.is_empty()
    }

    pub(crate) fn clear(&mut self) {
        self.sums.fill(0.0);
        self.links.fill(0.0);
    }

    /// Adds sums of the same kind, or none.
    pub(crate) fn add(&mut self, part: &Self) {
        add(&mut self.sums, &part.sums);
        add(&mut self.links, &part.links);
    }

    /// Adds everything to the upper triangle `matrix` over the term's columns without the eliminated ones.
    pub(crate) fn add_to(&self, place: &CompositePlace, matrix: &mut [f64]) {
        let &CompositePlace { ref columns, n_columns, eliminated, alone } = place;
        let (n_own, n_links) = (columns.n_own, columns.link_count(n_columns));
        let side = n_columns + 1 - eliminated.map_or(0, |_| POSE_COLUMNS);
        let own_place = |column: usize| if column == n_own { side - 1 } else { column };
        columns.each_own(&self.sums, |a, b, sum| matrix[own_place(a) * side + own_place(b)] += sum);
        let stride = columns.block(n_links);
        let mut rows_alone = Vec::new();
        if let Some(link) = alone {
            // Its rows are the composite pose's.
            let mut rows = vec![0.0; POSE_COLUMNS * columns.stride()];
            columns.gather(&self.sums, 1.0, &mut rows);
            rows_alone.resize(POSE_COLUMNS * stride, 0.0);
            for (row, into) in rows.chunks_exact(columns.stride()).zip(rows_alone.chunks_exact_mut(stride)) {
                into[..row.len()].copy_from_slice(row);
                into[columns.block(link)..][..POSE_COLUMNS]
                    .copy_from_slice(&row[n_own..n_own + POSE_COLUMNS]);
            }
        }
        // The links that are left, and where their columns begin.
        let left = (0..n_links).filter(|&link| Some(columns.first_column(link)) != eliminated);
        let left: Vec<(usize, usize)> =
            left.enumerate().map(|(place, link)| (link, columns.first_column(place))).collect();
        for (at, &(link, first)) in left.iter().enumerate() {
            for k in 0..POSE_COLUMNS {
                let row = match alone {
                    Some(_) => &rows_alone[k * stride..][..stride],
                    None => &self.links[(POSE_COLUMNS * link + k) * stride..][..stride],
                };
                let column = first + k;
                for (own, entry) in row[..n_own].iter().enumerate() {
                    matrix[own * side + column] += entry;
                }
                matrix[column * side + side - 1] += row[columns.residual()];
                for &(other, other_first) in &left[at..] {
                    for l in (0..POSE_COLUMNS).filter(|&l| other != link || l >= k) {
                        matrix[column * side + other_first + l] += row[columns.block(other) + l];
                    }
                }
            }
        }
    }
}

/// Adds a composite term to the sums of its kind and of its group.
pub(crate) struct AddComposite<'a> {
    pub place: &'a CompositePlace,
    pub factor: f64,
    pub scratch: &'a mut Scratch,
    pub kind: &'a mut CompositeSums,
    pub group: &'a mut GroupSums,
    pub coupling: &'a [CouplingRun],
}

impl WithSimd for AddComposite<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { place, factor, scratch, kind, group, coupling } = self;
        let &CompositePlace { ref columns, n_columns, eliminated, alone } = place;
        let Scratch { gram, links, pose_rows, link_rows, .. } = scratch;
        let (stride, n_own) = (columns.stride(), columns.n_own);
        let row_stride = columns.block(columns.link_count(n_columns));
        // A block is read where the row of its columns may end one number before it.
        pose_rows.make_room(POSE_COLUMNS * stride + BLOCK_STRIDE);
        link_rows.make_room(POSE_COLUMNS * row_stride + BLOCK_STRIDE);
        add_scaled(simd, &mut kind.sums[..columns.n_sums], &gram.sums()[..columns.n_sums], factor);
        columns.gather(gram.sums(), factor, pose_rows);
        for (link, map) in links.maps().iter().enumerate().filter(|(link, _)| alone != Some(*link)) {
            let is_eliminated = eliminated == Some(columns.first_column(link));
            match map {
                None => {
                    for (row, pose) in
                        link_rows.chunks_exact_mut(row_stride).zip(pose_rows.chunks_exact(stride))
                    {
                        copy(simd, &mut row[..stride], pose);
                    }
                }
                Some(map) => map_rows(simd, map, stride, pose_rows, row_stride, link_rows),
            }
            for (other, map) in links.maps().iter().enumerate() {
                // What the eliminated link has to do with another stands in its own rows; of two others,
                // in those of the first.
                if other != link
                    && !is_eliminated
                    && (other < link || eliminated == Some(columns.first_column(other)))
                {
                    continue;
                }
                let block = columns.block(other);
                for row in link_rows[..].chunks_exact_mut(row_stride) {
                    match map {
                        None => row.copy_within(n_own..n_own + POSE_COLUMNS, block),
                        Some(map) => map_block(simd, map, row, n_own, block),
                    }
                }
            }
            if is_eliminated {
                let own = columns.block(link);
                for (k, row) in link_rows.chunks_exact(row_stride).enumerate() {
                    group.add_row(k, row, own, columns.residual(), coupling);
                }
            } else {
                let n = POSE_COLUMNS * row_stride;
                add_scaled(simd, &mut kind.links[link * n..(link + 1) * n], &link_rows[..n], 1.0);
            }
        }
    }
}

/// Adds `factor` times `parts` to `sums`, which are whole registers.
#[inline(always)]
fn add_scaled<S: Simd>(simd: S, sums: &mut [f64], parts: &[f64], factor: f64) {
    let factor = simd.splat_f64s(factor);
    let (sums, _) = S::as_mut_simd_f64s(sums);
    let (parts, _) = S::as_simd_f64s(parts);
    for (sum, part) in sums.iter_mut().zip(parts) {
        *sum = simd.mul_add_f64s(factor, *part, *sum);
    }
}

/// Writes `from` to `to`, which are whole registers.
#[inline(always)]
fn copy<S: Simd>(_: S, to: &mut [f64], from: &[f64]) {
    let (to, _) = S::as_mut_simd_f64s(to);
    let (from, _) = S::as_simd_f64s(from);
    to.copy_from_slice(from);
}

/// Writes the rows of a link, `row_stride` apart: what its map makes of the composite pose's, `stride` apart.
#[inline(always)]
fn map_rows<S: Simd>(
    simd: S,
    map: &LinkMap,
    stride: usize,
    pose_rows: &[f64],
    row_stride: usize,
    link_rows: &mut [f64],
) {
    for at in (0..stride).step_by(S::F64_LANES) {
        let mut pose = [simd.splat_f64s(0.0); POSE_COLUMNS];
        for (l, pose) in pose.iter_mut().enumerate() {
            *pose = S::as_simd_f64s(&pose_rows[l * stride + at..][..S::F64_LANES]).0[0];
        }
        for (k, row) in link_rows.chunks_exact_mut(row_stride).enumerate().take(POSE_COLUMNS) {
            let mut sum = simd.splat_f64s(0.0);
            for (pose, map) in pose.into_iter().zip(&map.rows) {
                sum = simd.mul_add_f64s(simd.splat_f64s(map[k]), pose, sum);
            }
            S::as_mut_simd_f64s(&mut row[at..at + S::F64_LANES]).0[0] = sum;
        }
    }
}

/// Writes the block of a link's row with another link: what that one's map makes of the row's six
/// columns of the composite pose, which begin at `own`.
#[inline(always)]
fn map_block<S: Simd>(simd: S, map: &LinkMap, row: &mut [f64], own: usize, block: usize) {
    let mut pose = [0.0; POSE_COLUMNS];
    pose.copy_from_slice(&row[own..own + POSE_COLUMNS]);
    let (block, _) = S::as_mut_simd_f64s(&mut row[block..block + BLOCK_STRIDE]);
    for (at, block) in block.iter_mut().enumerate() {
        let mut sum = simd.splat_f64s(0.0);
        for (pose, map) in pose.into_iter().zip(&map.rows) {
            sum = simd.mul_add_f64s(simd.splat_f64s(pose), S::as_simd_f64s(map).0[at], sum);
        }
        *block = sum;
    }
}

const _: () = assert!(SIDE == POSE_COLUMNS);
