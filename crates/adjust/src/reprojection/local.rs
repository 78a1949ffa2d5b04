//! Views through a lens with local support: a point depends on a square of knots around it.
//!
//! With `u = fx (x + Σ w_k a_k) + cx` the row of u has the entries `fx w_k` for the knots of the
//! point's square, that of v the entries `fy w_k` for the same weights. So the products of knots with
//! each other are `Σ w wᵀ`, once for both axes and for all views of a camera, which each cell of the
//! grid sums as a product of its two directions. Knots by pose are summed for each view alone.

mod common;
mod gradient;
mod whole;
mod work;

use std::ops::Range;

use boresight_camera::{CameraModel, LocalLinear, LocalSupport, ModelVisitor};
use boresight_geometry::Scalar;
use boresight_solver::gram::Previous;
use boresight_solver::lanes::{Lanes, MAX_LANES};
use boresight_solver::pulp::Simd;
use boresight_solver::{
    Accumulated, BlockId, EliminatedSums, GramMut, LinkMap, Links, LocalTerm, Scratch, Values,
    expand_composite,
};

use self::gradient::SumGradient;
use self::work::{LocalWork, done};
use super::{
    BLOCK, Context, FEW_SHAPE, FIRST_LENS_COLUMN, MAX_SHAPE, Reprojection, load, n_row_columns,
    write_geometry,
};
use crate::options::Loss;

/// The core is all that a point depends on besides its knots.
const CORE: usize = 4;

/// The columns of a row after the core are those of the shape, the pose and the residual.
const FIRST_SHAPE_COLUMN: usize = FIRST_LENS_COLUMN;

/// Knots this much of a cell beyond those that a point touches count as touched, so that small steps
/// stay within the support.
const MARGIN: f64 = 0.3;

/// Where what is summed for each knot of a view lies: for u, the pose and the shape; for v, the same; then the
/// residuals, the focal lengths and the centre.
struct KnotSums {
    by_v: usize,
    by_residual: usize,
    by_focal: usize,
    by_centre: usize,
    /// How many there are, with room to fill registers.
    count: usize,
}

impl KnotSums {
    const BY_U: usize = 0;
    const BY_SHAPE: usize = 6;
    const MOST: usize = Self::new(MAX_SHAPE).count;

    const fn new(n_shape: usize) -> Self {
        let by_v = 6 + n_shape;
        let by_residual = 2 * by_v;
        let count = (by_residual + 6).next_multiple_of(MAX_LANES);
        Self { by_v, by_residual, by_focal: by_residual + 2, by_centre: by_residual + 4, count }
    }
}

/// Products of the weights of a cell along one axis: pairs `a <= b` of up to four, in rows.
const PAIRS: usize = 10;
/// The same with room to fill registers.
const PAIR_ROOM: usize = 16;
/// What is summed for each cell: pairs along y by pairs along x.
const PER_CELL: usize = PAIRS * PAIR_ROOM;

/// The grid of a lens and where the shared sums of its views are.
#[derive(Clone, Copy, Debug)]
struct Grid {
    support: LocalSupport,
    n_shape: usize,
    /// Poses of the chain that are not eliminated.
    n_links: usize,
}

impl Grid {
    fn n_knots(&self) -> usize {
        self.support.columns * self.support.rows
    }

    fn n_cells(&self) -> [usize; 2] {
        [self.support.columns + 1 - self.support.side, self.support.rows + 1 - self.support.side]
    }

    /// Returns the number of columns that every view has, the residual included.
    fn n_common(&self) -> usize {
        CORE + self.n_shape + 6 * self.n_links + 1
    }

    fn n_params(&self) -> usize {
        CORE + 2 * self.n_knots()
    }

    /// Returns the term's column of a common column.
    fn common_column(&self, common: usize) -> u32 {
        (if common < CORE { common } else { common - CORE + self.n_params() }) as u32
    }

    /// Returns what a knot is summed with, in u and v.
    ///
    /// In u: residual, `fx`, `cx`, shape, links; likewise in v.
    fn per_knot(&self) -> usize {
        2 * (3 + self.n_shape + 6 * self.n_links)
    }

    /// Returns where the sums of knots and of cells begin; those of the common columns come first.
    fn starts(&self) -> [usize; 2] {
        let knots = self.n_common().pow(2);
        [knots, knots + self.n_knots() * self.per_knot()]
    }

    fn n_sums(&self) -> usize {
        let [columns, rows] = self.n_cells();
        self.starts()[1] + columns * rows * PER_CELL
    }

    /// Returns the offsets from a knot to those that share a cell with it and come no earlier.
    fn offsets(&self) -> impl Iterator<Item = (usize, isize)> + use<> {
        let reach = self.support.side as isize - 1;
        (0..=reach).flat_map(move |down| {
            let first = if down == 0 { 0 } else { -reach };
            (first..=reach).map(move |across| (down as usize, across))
        })
    }

    /// Calls `visit` for each pair of knots that share a cell.
    fn each_pair(&self, mut visit: impl FnMut(usize, usize)) {
        let LocalSupport { columns, rows, .. } = self.support;
        for knot in 0..self.n_knots() {
            let (row, column) = (knot / columns, knot % columns);
            for (down, across) in self.offsets() {
                let Some(other) = column.checked_add_signed(across).filter(|&other| other < columns) else {
                    continue;
                };
                if row + down < rows {
                    visit(knot, (row + down) * columns + other);
                }
            }
        }
    }
}

/// The rectangle of knots that a view may touch.
#[derive(Clone, Copy, Debug)]
struct Rectangle {
    first_row: usize,
    first_column: usize,
    n_rows: usize,
    n_columns: usize,
}

impl Reprojection {
    fn grid(&self) -> Option<Grid> {
        let support = self.model.local_support()?;
        let n_links = self.blocks.len() - 1 - usize::from(self.n_shape > 0) - 1;
        Some(Grid { support, n_shape: self.n_shape, n_links })
    }
}

impl LocalTerm for Reprojection {
    fn support(&self, values: Values<'_>) -> Vec<u32> {
        let Some(grid) = self.grid() else { return Vec::new() };
        let mut touched = vec![false; grid.n_knots()];
        self.model.visit(Touch { term: self, values, grid, touched: &mut touched });
        let knots = touched.iter().enumerate().filter(|(_, touched)| **touched).map(|(knot, _)| knot);
        let mut columns: Vec<u32> = (0..CORE as u32).collect();
        columns.extend(knots.flat_map(|knot| [0, 1].map(|axis| (CORE + 2 * knot + axis) as u32)));
        columns.extend((CORE..grid.n_common() - 1).map(|common| grid.common_column(common)));
        columns
    }

    fn sum_count(&self) -> usize {
        self.grid().map_or(0, |grid| grid.n_sums())
    }

    fn entries(&self) -> Vec<[u32; 2]> {
        let Some(grid) = self.grid() else { return Vec::new() };
        let mut entries = Vec::new();
        let n_common = grid.n_common();
        for a in 0..n_common - 1 {
            entries.extend((a..n_common).map(|b| [grid.common_column(a), grid.common_column(b)]));
        }
        for knot in 0..grid.n_knots() {
            for axis in 0..2 {
                let column = (CORE + 2 * knot + axis) as u32;
                let residual = grid.common_column(n_common - 1);
                let own = [residual, axis as u32, 2 + axis as u32];
                let rest = (CORE..n_common - 1).map(|common| grid.common_column(common));
                entries.extend(own.into_iter().chain(rest).map(|other| [column, other]));
            }
        }
        grid.each_pair(|a, b| {
            for axis in 0..2 {
                entries.push([(CORE + 2 * a + axis) as u32, (CORE + 2 * b + axis) as u32]);
            }
        });
        entries
    }

    fn expand(&self, values: Values<'_>, sums: &[f64], entries: &mut [f64]) {
        let Some(grid) = self.grid() else { return };
        let [knots, cells] = grid.starts();
        let n_common = grid.n_common();
        let mut entries = entries.iter_mut();
        let mut write = |value: f64| {
            if let Some(entry) = entries.next() {
                *entry = value;
            }
        };
        for a in 0..n_common - 1 {
            sums[a * n_common + a..(a + 1) * n_common].iter().for_each(|&sum| write(sum));
        }
        // A knot's sums are in the order of its entries.
        sums[knots..cells].iter().for_each(|&sum| write(sum));
        let lens = values.vector(self.blocks[0]);
        let squares = [lens[0] * lens[0], lens[1] * lens[1]];
        let products = knot_products(&grid, &sums[cells..]);
        let n_offsets = grid.offsets().count();
        let side = grid.support.side as isize;
        grid.each_pair(|a, b| {
            let (down, across) = (b / grid.support.columns - a / grid.support.columns, {
                (b % grid.support.columns) as isize - (a % grid.support.columns) as isize
            });
            let product = products[a * n_offsets + offset_index(side, down, across)];
            squares.iter().for_each(|square| write(square * product));
        });
    }

    fn alike(&self) -> Range<usize> {
        self.grid().map_or(0..0, |grid| CORE..grid.n_params())
    }

    fn gradient(&self, values: Values<'_>, gradient: &mut [f64], scratch: &mut Scratch) -> Option<f64> {
        let grid = self.grid()?;
        if self.n_rows == 0 {
            return Some(0.0);
        }
        done(SumGradient { term: self, values, grid, gradient, scratch })
    }

    fn accumulate(
        &self,
        values: Values<'_>,
        support: &[u32],
        sums: &mut [f64],
        eliminated: &mut EliminatedSums<'_>,
        scratch: &mut Scratch,
    ) -> Accumulated {
        let Some(grid) = self.grid() else { return Accumulated::Undefined };
        if self.n_rows == 0 {
            return Accumulated::Cost(0.0);
        }
        done(AccumulateLocally { term: self, values, grid, support, sums, eliminated, scratch })
    }
}

/// Returns the place of an offset in [`Grid::offsets`].
fn offset_index(side: isize, down: usize, across: isize) -> usize {
    match down {
        0 => across as usize,
        _ => (side + (down as isize - 1) * (2 * side - 1) + across + side - 1) as usize,
    }
}

/// Sums the products of weights over cells: for each knot and each offset, those of the two knots.
fn knot_products(grid: &Grid, cells: &[f64]) -> Vec<f64> {
    let [n_across, _] = grid.n_cells();
    let side = grid.support.side;
    let n_offsets = grid.offsets().count();
    let mut products = vec![0.0; grid.n_knots() * n_offsets];
    let pairs: Vec<(usize, usize)> = (0..side).flat_map(|a| (a..side).map(move |b| (a, b))).collect();
    for (cell, sums) in cells.chunks_exact(PER_CELL).enumerate() {
        let corner = cell / n_across * grid.support.columns + cell % n_across;
        for (&(top, bottom), row) in pairs.iter().zip(sums.chunks_exact(PAIR_ROOM)) {
            for (&(left, right), sum) in pairs.iter().zip(row) {
                let down = bottom - top;
                let across = (right - left) as isize;
                let knot = corner + top * grid.support.columns;
                let index = |across| offset_index(side as isize, down, across);
                products[(knot + left) * n_offsets + index(across)] += sum;
                if down > 0 && across > 0 {
                    products[(knot + right) * n_offsets + index(-across)] += sum;
                }
            }
        }
    }
    products
}

/// Marks the knots that a view touches, with a margin.
struct Touch<'a> {
    term: &'a Reprojection,
    values: Values<'a>,
    grid: Grid,
    touched: &'a mut [bool],
}

impl ModelVisitor for Touch<'_> {
    type Output = ();

    fn visit<M: CameraModel>(self, model: M) {
        let Self { term, values, grid, touched } = self;
        let LocalSupport { side, columns, rows } = grid.support;
        let lens = values.vector(term.blocks[0]);
        let cam_from_target = term.chain.compose(values);
        let shape = &term.shape(values)[..term.n_shape];
        for i in 0..term.points.n_points {
            let point: [f64; 3] = (cam_from_target * term.points.bent(i, shape)).into();
            // Where the lens is not defined, the evaluation will tell.
            let Some(linear) = model.linearize_locally(lens, point) else { continue };
            let corner = (linear.first[0] - CORE) / 2;
            let (row, column) = (corner / columns, corner % columns);
            // Splines reproduce straight lines, so the weights tell where the point is in its cell.
            let (mut across, mut down) = (0.0, 0.0);
            for k in 0..side * side {
                across += (k % side) as f64 * linear.weights[k];
                down += (k / side) as f64 * linear.weights[k];
            }
            let begin = if side % 2 == 0 { 1.0 } else { 0.5 };
            let range = |at: usize, within: f64, n: usize| {
                let before = usize::from(within < begin + MARGIN);
                let behind = usize::from(within > begin + 1.0 - MARGIN);
                at.saturating_sub(before)..(at + side + behind).min(n)
            };
            for row in range(row, down, rows) {
                touched[row * columns..(row + 1) * columns][range(column, across, columns)].fill(true);
            }
        }
    }
}

/// Multiplies out the rows of a view.
struct AccumulateLocally<'a, 'e> {
    term: &'a Reprojection,
    values: Values<'a>,
    grid: Grid,
    support: &'a [u32],
    sums: &'a mut [f64],
    eliminated: &'a mut EliminatedSums<'e>,
    scratch: &'a mut Scratch,
}

/// Points whose rows of common columns are multiplied at once.
const POINTS_AT_ONCE: usize = 104;

impl LocalWork for AccumulateLocally<'_, '_> {
    type Output = Accumulated;

    fn term(&self) -> &Reprojection {
        self.term
    }

    fn undefined() -> Accumulated {
        Accumulated::Undefined
    }

    #[inline(always)]
    fn work<M: CameraModel, S: Simd, const SHAPE: usize, const SIDE: usize>(
        self,
        simd: S,
        model: M,
    ) -> Accumulated {
        let Self { term, values, grid, support, sums, eliminated, scratch } = self;
        let Some(rectangle) = rectangle(&grid, support) else { return Accumulated::OutsideSupport };
        let context = Context::new(model, term, values, &mut scratch.links);
        let n_columns = n_row_columns(CORE, SHAPE);
        let stride = n_columns.next_multiple_of(BLOCK);
        let room = POINTS_AT_ONCE / S::F64_LANES * stride * S::F64_LANES;
        let n_knot_sums = rectangle.n_rows * rectangle.n_columns * const { KnotSums::new(SHAPE).count };
        let rows = &mut scratch.rows;
        rows.make_room(2 * room + n_knot_sums);
        let (u_rows, rest) = rows.split_at_mut(room);
        let (v_rows, knots) = rest.split_at_mut(room);
        knots.fill(0.0);
        let n_in_chunk = stride * S::F64_LANES;
        let [knots_start, cells_start] = grid.starts();
        let n_points = term.points.n_points;
        let mut loss = 0.0;
        let mut first = 0;
        let mut previous = Previous::Forgotten;
        while first < n_points {
            let n_chunks = (n_points - first).min(POINTS_AT_ONCE).div_ceil(S::F64_LANES);
            for chunk in 0..n_chunks {
                let point = first + chunk * S::F64_LANES;
                let (u, _) = S::as_mut_simd_f64s(&mut u_rows[chunk * n_in_chunk..(chunk + 1) * n_in_chunk]);
                let (v, _) = S::as_mut_simd_f64s(&mut v_rows[chunk * n_in_chunk..(chunk + 1) * n_in_chunk]);
                let Some((linear, weights)) =
                    context.write_common::<S, SHAPE>(simd, point, [u, v], &mut loss)
                else {
                    return Accumulated::Undefined;
                };
                let local = LocalRows { u, v, linear: &linear, weights };
                let n_lanes = (n_points - point).min(S::F64_LANES);
                let is_inside = local.add::<SHAPE, SIDE>(
                    simd,
                    (&grid, context.lens, n_lanes),
                    rectangle,
                    knots,
                    &mut sums[cells_start..],
                );
                if !is_inside {
                    return Accumulated::OutsideSupport;
                }
            }
            let (u, v) = (&u_rows[..n_chunks * n_in_chunk], &v_rows[..n_chunks * n_in_chunk]);
            scratch.gram.sum(simd, n_columns, u, v, previous);
            previous = Previous::Kept;
            first += POINTS_AT_ONCE;
        }
        let cost = match term.loss {
            Loss::None => term.layout.squares(scratch.gram.sums()),
            Loss::Cauchy { .. } => loss,
        };
        let knots = std::mem::take(&mut scratch.rows);
        let chain = ViewChain::new(term, &scratch.links, eliminated.block);
        chain.add_common(term, &grid, scratch, sums, eliminated, support.len());
        let (_, knot_sums) = knots.split_at(2 * room);
        let shared = &mut sums[knots_start..cells_start];
        let is_inside = chain.add_knots(&grid, rectangle, knot_sums, support, shared, eliminated);
        scratch.rows = knots;
        if is_inside { Accumulated::Cost(cost) } else { Accumulated::OutsideSupport }
    }
}

/// Returns the smallest rectangle around the knots of the support.
fn rectangle(grid: &Grid, support: &[u32]) -> Option<Rectangle> {
    let columns = grid.support.columns;
    let mut range: Option<[usize; 4]> = None;
    let knots = support.iter().filter(|&&column| (CORE..grid.n_params()).contains(&(column as usize)));
    for knot in knots.map(|&column| (column as usize - CORE) / 2) {
        let (row, column) = (knot / columns, knot % columns);
        let [top, bottom, left, right] = range.unwrap_or([row, row, column, column]);
        range = Some([top.min(row), bottom.max(row), left.min(column), right.max(column)]);
    }
    let [top, bottom, left, right] = range?;
    Some(Rectangle {
        first_row: top,
        first_column: left,
        n_rows: bottom + 1 - top,
        n_columns: right + 1 - left,
    })
}

impl<M: CameraModel> Context<'_, M> {
    /// Writes the rows of a chunk over the common columns, in sigmas, and returns what its points
    /// depend on with their weights; those of the padding are zero.
    #[inline(always)]
    fn write_common<S: Simd, const SHAPE: usize>(
        &self,
        simd: S,
        point: usize,
        rows: [&mut [S::f64s]; 2],
        loss: &mut f64,
    ) -> Option<(LocalLinear<Lanes<S>>, Lanes<S>)> {
        let Self { model, term, lens, by_focal, rotation, .. } = self;
        let zero = Lanes::splat(simd, 0.0);
        let (p, basis) = self.place::<S, SHAPE>(simd, point);
        let linear = model.linearize_locally(lens, p)?;
        let mut scale = self.weights(simd, point, term.weights.uniform());
        let mut residuals = [
            linear.pixel[0] - load(simd, &term.pixels[0], point),
            linear.pixel[1] - load(simd, &term.pixels[1], point),
        ];
        *loss += self.weigh(&mut scale, &mut residuals);
        for (row, columns) in rows.into_iter().enumerate() {
            let [a, b, c] = linear.d_point[row];
            let (a, b, c) = (a * scale, b * scale, c * scale);
            let by_focal = (linear.pixel[row] - zero.like(lens[2 + row])).scale(by_focal[row]);
            columns[0] = (by_focal * scale).value;
            columns[1] = scale.value;
            write_geometry(
                rotation,
                &p,
                [a, b, c],
                &basis,
                residuals[row],
                &mut columns[FIRST_SHAPE_COLUMN..],
            );
        }
        Some((linear, scale))
    }
}

/// A chunk's rows and what its points depend on.
struct LocalRows<'a, S: Simd> {
    u: &'a [S::f64s],
    v: &'a [S::f64s],
    linear: &'a LocalLinear<Lanes<S>>,
    weights: Lanes<S>,
}

impl<S: Simd> LocalRows<'_, S> {
    /// Adds the products of each point's knots with all else; tells whether all knots are inside.
    #[inline(always)]
    fn add<const SHAPE: usize, const SIDE: usize>(
        &self,
        simd: S,
        (grid, lens, n_lanes): (&Grid, &[f64], usize),
        rectangle: Rectangle,
        knots: &mut [f64],
        cells: &mut [f64],
    ) -> bool {
        let Self { u, v, linear, weights } = self;
        let zero = Lanes::splat(simd, 0.0);
        let at = const { KnotSums::new(SHAPE) };
        // What a point's knots are multiplied with, as rows of a point rather than of a lane.
        let mut factors = [[0.0; KnotSums::MOST]; MAX_LANES];
        let mut across_pairs = [[0.0; PAIR_ROOM]; MAX_LANES];
        let mut down_pairs = [[0.0; PAIRS]; MAX_LANES];
        let mut knot_weights = [[0.0; 16]; MAX_LANES];
        let by_axis = [weights.scale(lens[0]), weights.scale(lens[1])];
        let mut transpose = |place: usize, lanes: Lanes<S>| {
            let array = lanes.to_array();
            for lane in 0..S::F64_LANES {
                factors[lane][place] = array[lane];
            }
        };
        for (axis, rows) in [u, v].into_iter().enumerate() {
            let row = |column: usize| Lanes::new(simd, rows[column]) * by_axis[axis];
            let first = if axis == 0 { KnotSums::BY_U } else { at.by_v };
            for k in 0..6 {
                transpose(first + k, row(FIRST_SHAPE_COLUMN + SHAPE + k));
            }
            for j in 0..SHAPE {
                transpose(first + KnotSums::BY_SHAPE + j, row(FIRST_SHAPE_COLUMN + j));
            }
            transpose(at.by_residual + axis, row(FIRST_SHAPE_COLUMN + SHAPE + 6));
            transpose(at.by_focal + axis, row(0));
            transpose(at.by_centre + axis, row(1));
        }
        // Weights along one axis are the sums over the other, where they sum to one.
        let mut across = [zero; SIDE];
        let mut down = [zero; SIDE];
        for (k, weight) in linear.weights.iter().enumerate().take(SIDE * SIDE) {
            across[k % SIDE] = across[k % SIDE] + *weight;
            down[k / SIDE] = down[k / SIDE] + *weight;
            let array = weight.to_array();
            for lane in 0..S::F64_LANES {
                knot_weights[lane][k] = array[lane];
            }
        }
        let square = *weights * *weights;
        let mut pair = 0;
        for a in 0..SIDE {
            for b in a..SIDE {
                let (x, y) = ((across[a] * across[b] * square).to_array(), (down[a] * down[b]).to_array());
                for lane in 0..S::F64_LANES {
                    across_pairs[lane][pair] = x[lane];
                    down_pairs[lane][pair] = y[lane];
                }
                pair += 1;
            }
        }
        let n_pairs = SIDE * (SIDE + 1) / 2;
        let [n_across, _] = grid.n_cells();
        for lane in 0..n_lanes {
            let corner = (linear.first[lane] - CORE) / 2;
            let (row, column) = (corner / grid.support.columns, corner % grid.support.columns);
            let Some((below, right)) =
                row.checked_sub(rectangle.first_row).zip(column.checked_sub(rectangle.first_column))
            else {
                return false;
            };
            if below + SIDE > rectangle.n_rows || right + SIDE > rectangle.n_columns {
                return false;
            }
            let (factors, _) = S::as_simd_f64s(&factors[lane][..at.count]);
            for (k, weight) in knot_weights[lane][..SIDE * SIDE].iter().enumerate() {
                let weight = simd.splat_f64s(*weight);
                let knot = (below + k / SIDE) * rectangle.n_columns + right + k % SIDE;
                let (sums, _) = S::as_mut_simd_f64s(&mut knots[knot * at.count..(knot + 1) * at.count]);
                for (sum, factor) in sums.iter_mut().zip(factors) {
                    *sum = simd.mul_add_f64s(weight, *factor, *sum);
                }
            }
            let cell = &mut cells[(row * n_across + column) * PER_CELL..][..PER_CELL];
            let (pairs, _) = S::as_simd_f64s(&across_pairs[lane]);
            for (pair, sums) in cell.chunks_exact_mut(PAIR_ROOM).take(n_pairs).enumerate() {
                let factor = simd.splat_f64s(down_pairs[lane][pair]);
                let (sums, _) = S::as_mut_simd_f64s(sums);
                for (sum, pair) in sums.iter_mut().zip(pairs) {
                    *sum = simd.mul_add_f64s(factor, *pair, *sum);
                }
            }
        }
        true
    }
}

/// The poses of a view's chain: the one that is eliminated and the others.
struct ViewChain {
    links: Links,
    /// Which of them is eliminated.
    eliminated: usize,
}

impl ViewChain {
    fn new(term: &Reprojection, links: &Links, block: Option<BlockId>) -> Self {
        let eliminated = term.chain.blocks().position(|link| Some(link) == block).unwrap_or(0);
        Self { links: links.clone(), eliminated }
    }

    /// Returns the maps of the links that are not eliminated.
    fn others(&self) -> impl Iterator<Item = &Option<LinkMap>> {
        let links = self.links.maps().iter().enumerate();
        links.filter(|&(link, _)| link != self.eliminated).map(|(_, map)| map)
    }

    /// Adds the products of the common columns with each other.
    fn add_common(
        &self,
        term: &Reprojection,
        grid: &Grid,
        scratch: &mut Scratch,
        sums: &mut [f64],
        eliminated: &mut EliminatedSums<'_>,
        n_support: usize,
    ) {
        let n_flat = CORE + grid.n_shape;
        let n = n_flat + 6 * self.links.maps().len() + 1;
        let mut entries = vec![0.0; n * n];
        expand_composite(&term.layout, 1.0, &mut GramMut::new(&mut entries, n), scratch);
        let own = n_flat + 6 * self.eliminated;
        let entry = |a: usize, b: usize| entries[a.min(b) * n + a.max(b)];
        let rest: Vec<usize> = (0..own).chain(own + 6..n).collect();
        let n_common = grid.n_common();
        // Of the support, the core comes first and the other common columns last.
        let place = |common: usize| if common < CORE { common } else { n_support + common + 1 - n_common };
        for k in 0..6 {
            for l in k..6 {
                eliminated.own[k][l] += entry(own + k, own + l);
            }
            eliminated.gradient[k] += entry(own + k, n - 1);
            for (common, &column) in rest[..n_common - 1].iter().enumerate() {
                eliminated.coupling[k * n_support + place(common)] += entry(own + k, column);
            }
        }
        for (a, &row) in rest.iter().enumerate() {
            for (b, &column) in rest.iter().enumerate().skip(a) {
                sums[a * n_common + b] += entry(row, column);
            }
        }
    }

    /// Adds the products of knots with the common columns; tells whether all are in the support.
    fn add_knots(
        &self,
        grid: &Grid,
        rectangle: Rectangle,
        knots: &[f64],
        support: &[u32],
        sums: &mut [f64],
        eliminated: &mut EliminatedSums<'_>,
    ) -> bool {
        let n_support = support.len();
        let per_knot = grid.per_knot();
        let at = KnotSums::new(grid.n_shape);
        let own = &self.links.maps()[self.eliminated];
        // Knots of the support are in the order of the rectangle.
        let mut places = support.iter().enumerate().skip(CORE).step_by(2).peekable();
        for (idx, knot) in knots.chunks_exact(at.count).enumerate() {
            let row = rectangle.first_row + idx / rectangle.n_columns;
            let column = rectangle.first_column + idx % rectangle.n_columns;
            let number = row * grid.support.columns + column;
            let param = (CORE + 2 * number) as u32;
            let Some((place, _)) = places.next_if(|&(_, &found)| found == param) else {
                if knot.iter().any(|&sum| sum != 0.0) {
                    return false;
                }
                continue;
            };
            let sums = &mut sums[number * per_knot..(number + 1) * per_knot];
            for (axis, sums) in sums.chunks_exact_mut(per_knot / 2).enumerate() {
                let by_pose = if axis == 0 { &knot[..at.by_v] } else { &knot[at.by_v..at.by_residual] };
                sums[0] += knot[at.by_residual + axis];
                sums[1] += knot[at.by_focal + axis];
                sums[2] += knot[at.by_centre + axis];
                for j in 0..grid.n_shape {
                    sums[3 + j] += by_pose[KnotSums::BY_SHAPE + j];
                }
                let mut row = [0.0; 6];
                row.copy_from_slice(&by_pose[..6]);
                let mapped = map_row(own, row);
                for (k, mapped) in mapped.iter().enumerate() {
                    eliminated.coupling[k * n_support + place + axis] += mapped;
                }
                for (link, adjoint) in self.others().enumerate() {
                    let mapped = map_row(adjoint, row);
                    let first = 3 + grid.n_shape + 6 * link;
                    for (sum, mapped) in sums[first..first + 6].iter_mut().zip(mapped) {
                        *sum += mapped;
                    }
                }
            }
        }
        true
    }
}

/// Returns derivatives by the composite pose as those by a link.
fn map_row(map: &Option<LinkMap>, row: [f64; 6]) -> [f64; 6] {
    let Some(map) = map else { return row };
    let mut mapped = [0.0; 6];
    for (entry, by_link) in row.iter().zip(map.matrix()) {
        mapped.iter_mut().zip(by_link).for_each(|(mapped, by_link)| *mapped += entry * by_link);
    }
    mapped
}
