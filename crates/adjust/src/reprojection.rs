//! The one residual block: what a view's pixels say about lens, target shape and poses.
//!
//! Derivatives are taken once with respect to the composite pose `cam_from_target`, six columns, and
//! mapped to each link of the chain by its adjoint; see section 6 of the design. J is never formed:
//! rows live in scratch as long as it takes to multiply them.

use std::sync::Arc;

use boresight_camera::{CameraModel, Model, ModelVisitor};
use boresight_data::{Observation, Target};
use boresight_geometry::{Matrix3, Matrix6, Pose, Scalar, Vector3};
use boresight_solver::gram::{BLOCK, PairGram, Row};
use boresight_solver::lanes::{Lanes, MAX_LANES};
use boresight_solver::pulp::{Arch, Simd, WithSimd};
use boresight_solver::{BlockId, GramMut, Scratch, Term, Values};

use crate::chain::Chain;
use crate::options::Loss;

/// Points whose rows are in scratch at once; more would spill out of the first-level cache.
const POINTS_AT_ONCE: usize = 104;

/// The largest number of shape coefficients of a target.
const MAX_SHAPE: usize = 2;

/// The first columns of a row: focal length, centre, six of the pose. The lens parameters follow.
const FIRST_POSE_COLUMN: usize = 2;
const FIRST_LENS_COLUMN: usize = 8;

/// Points of a target side by side, padded to whole registers by repeating the last.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TargetPoints {
    n_points: usize,
    /// x, y, z as drawn, then the displacement by each shape coefficient.
    axes: [Vec<f64>; 3 + MAX_SHAPE],
}

/// A view as a term of the sum of squares.
#[derive(Clone, Debug)]
pub struct Reprojection {
    arch: Arch,
    model: Model,
    blocks: Vec<BlockId>,
    n_shape: usize,
    chain: Chain,
    points: Arc<TargetPoints>,
    layout: Arc<Layout>,
    /// The pixels seen, padded likewise.
    pixels: [Vec<f64>; 2],
    weights: Weights,
    n_rows: usize,
    loss: Loss,
}

/// The inverse sigma of each observation, in 1/px; zero where it is rejected.
#[derive(Clone, Debug, PartialEq)]
enum Weights {
    Uniform(f64),
    Each(Vec<f64>),
}

/// The layouts in use, which terms of like lenses and shapes share.
#[derive(Debug, Default)]
pub struct Layouts {
    known: Vec<Arc<Layout>>,
}

impl Layouts {
    fn get(&mut self, n_params: usize, n_shape: usize) -> Arc<Layout> {
        let known = self.known.iter().find(|layout| (layout.n_params, layout.n_shape) == (n_params, n_shape));
        known.cloned().unwrap_or_else(|| {
            struct CountLanes;
            impl WithSimd for CountLanes {
                type Output = usize;
                fn with_simd<S: Simd>(self, _: S) -> usize {
                    S::F64_LANES
                }
            }
            let layout = Arc::new(Layout::new(n_params, n_shape, Arch::new().dispatch(CountLanes)));
            self.known.push(layout.clone());
            layout
        })
    }
}

impl TargetPoints {
    /// Returns the points of `target` that `observations` name, in their order.
    pub fn new(target: &Target, observations: &[Observation]) -> Self {
        let axis = |axis: usize| {
            padded(observations.iter().map(|observation| match axis {
                0..3 => target.drawn_point(observation.point)[axis],
                _ => target.shape_basis(observation.point)[axis - 3],
            }))
        };
        Self { n_points: observations.len(), axes: [0, 1, 2, 3, 4].map(axis) }
    }
}

/// Returns the numbers, the last repeated until they fill whole registers.
fn padded(numbers: impl ExactSizeIterator<Item = f64>) -> Vec<f64> {
    let n = numbers.len().next_multiple_of(MAX_LANES);
    let mut padded = Vec::with_capacity(n);
    padded.extend(numbers);
    if let Some(&last) = padded.last() {
        padded.resize(n, last);
    }
    padded
}

impl Reprojection {
    /// Returns the term of `observations` of `points`, seen through the lens of block `lens` (of `model`).
    ///
    /// `shape` is the block of the target's shape coefficients, where it has any.
    pub fn new(
        model: Model,
        lens: BlockId,
        shape: Option<(BlockId, usize)>,
        chain: Chain,
        points: Arc<TargetPoints>,
        observations: &[Observation],
        layouts: &mut Layouts,
    ) -> Self {
        assert_eq!(points.n_points, observations.len(), "each observation has its point");
        let mut blocks = vec![lens];
        blocks.extend(shape.map(|(block, _)| block));
        blocks.extend(chain.blocks());
        let pixels =
            [0, 1].map(|axis| padded(observations.iter().map(|observation| observation.pixel[axis])));
        let n_shape = shape.map_or(0, |(_, n)| n);
        let mut term = Self {
            arch: Arch::new(),
            model,
            blocks,
            n_shape,
            chain,
            points,
            layout: layouts.get(model.param_count(), n_shape),
            pixels,
            weights: Weights::Uniform(0.0),
            n_rows: 0,
            loss: Loss::None,
        };
        term.set_kept(observations, |_| true);
        term
    }

    /// Sets which observations count.
    pub fn set_kept(&mut self, observations: &[Observation], is_kept: impl Fn(usize) -> bool) {
        let sigma_px = observations.first().map_or(1.0, |first| first.sigma_px);
        let n_kept = (0..observations.len()).filter(|&idx| is_kept(idx)).count();
        self.n_rows = 2 * n_kept;
        let is_uniform = observations.iter().all(|observation| observation.sigma_px == sigma_px);
        self.weights = if is_uniform && n_kept == observations.len() {
            Weights::Uniform(1.0 / sigma_px)
        } else {
            let weight = |(idx, observation): (usize, &Observation)| {
                if is_kept(idx) { 1.0 / observation.sigma_px } else { 0.0 }
            };
            let mut weights: Vec<f64> = observations.iter().enumerate().map(weight).collect();
            // The padding weighs nothing, whatever the last observation weighs.
            weights.resize(weights.len().next_multiple_of(MAX_LANES), 0.0);
            Weights::Each(weights)
        };
    }

    /// Sets the loss.
    pub fn set_loss(&mut self, loss: Loss) {
        self.loss = loss;
    }

    /// Returns the number of lens parameters, that of shape coefficients, and the chain, whose blocks'
    /// columns follow these two in the term.
    pub(crate) fn parts(&self) -> (usize, usize, &Chain) {
        (self.model.param_count(), self.n_shape, &self.chain)
    }

    /// Returns the predicted pixel of each observation, or `None` where the lens sees none of it.
    pub fn predict(&self, values: Values<'_>) -> Vec<Option<[f64; 2]>> {
        struct Predict<'a>(&'a Reprojection, Values<'a>);
        impl ModelVisitor for Predict<'_> {
            type Output = Vec<Option<[f64; 2]>>;
            fn visit<M: CameraModel>(self, model: M) -> Self::Output {
                let Self(term, values) = self;
                let lens = values.vector(term.blocks[0]);
                let cam_from_target = term.chain.compose(values);
                let shape = term.shape(values);
                let axes = &term.points.axes;
                (0..term.points.n_points)
                    .map(|i| {
                        let z = axes[2][i] + shape[0] * axes[3][i] + shape[1] * axes[4][i];
                        let point_in_cam = cam_from_target * Vector3::new(axes[0][i], axes[1][i], z);
                        model.project(lens, point_in_cam.into())
                    })
                    .collect()
            }
        }
        self.model.visit(Predict(self, values))
    }

    fn shape(&self, values: Values<'_>) -> [f64; MAX_SHAPE] {
        let mut shape = [0.0; MAX_SHAPE];
        if self.n_shape > 0 {
            shape[..self.n_shape].copy_from_slice(values.vector(self.blocks[1]));
        }
        shape
    }
}

/// Where the products of a term's columns lie among the sums over its rows.
///
/// The columns are the lens, the shape, the composite pose and the residual; rows have theirs in another order.
#[derive(Debug)]
struct Layout {
    n_params: usize,
    n_shape: usize,
    /// For each entry of the upper triangle, row by row, the two sums that make it up; `NOTHING` is zero.
    entries: Vec<[u32; 2]>,
}

/// A sum that is zero: no row has both columns.
const NOTHING: u32 = u32::MAX;

impl Layout {
    fn new(n_params: usize, n_shape: usize, n_lanes: usize) -> Self {
        let n_row_columns = n_row_columns(n_params, n_shape);
        let n_blocks = n_row_columns.div_ceil(BLOCK);
        let n_flat = n_params + n_shape;
        // Which row, if only one, and which column of it one of the term's columns is.
        let row_column = |column: usize| match column {
            0 => (Some(Row::U), 0),
            1 => (Some(Row::V), 0),
            2 => (Some(Row::U), 1),
            3 => (Some(Row::V), 1),
            _ if column < n_flat => (None, FIRST_LENS_COLUMN + column - 4),
            _ if column < n_flat + 6 => (None, FIRST_POSE_COLUMN + column - n_flat),
            _ => (None, n_row_columns - 1),
        };
        let mut entries = Vec::new();
        for a in 0..n_flat + 7 {
            for b in a..n_flat + 7 {
                let ((row_a, column_a), (row_b, column_b)) = (row_column(a), row_column(b));
                let place = |row| PairGram::place(n_blocks, n_lanes, row, column_a, column_b) as u32;
                entries.push(match (row_a, row_b) {
                    (Some(a), Some(b)) if a != b => [NOTHING; 2],
                    (Some(row), _) | (_, Some(row)) => [place(row), NOTHING],
                    _ if column_a.min(column_b) < BLOCK => [place(Row::U), place(Row::V)],
                    _ => [place(Row::U), NOTHING],
                });
            }
        }
        Self { n_params, n_shape, entries }
    }

    /// Returns the number of the term's columns with the composite pose, the residual included.
    fn side(&self) -> usize {
        self.n_params + self.n_shape + 7
    }

    /// Writes `factor` times the upper triangle over lens, shape, composite pose and residual to `matrix`.
    #[inline(always)]
    fn unpack(&self, sums: &[f64], factor: f64, matrix: &mut [f64]) {
        let side = self.side();
        let sum = |place: u32| sums.get(place as usize).copied().unwrap_or(0.0);
        let mut entries = self.entries.iter();
        for a in 0..side {
            for (entry, [first, second]) in matrix[a * side + a..(a + 1) * side].iter_mut().zip(&mut entries)
            {
                *entry = factor * (sum(*first) + sum(*second));
            }
        }
    }
}

/// Maps the composite pose's columns of `matrix` to those of each link and writes all to `gram`.
#[inline(always)]
fn expand(layout: &Layout, matrix: &[f64], adjoints: &[Option<Matrix6<f64>>], gram: &mut GramMut<'_>) {
    let side = layout.side();
    let n_flat = layout.n_params + layout.n_shape;
    let last = gram.size() - 1;
    for a in 0..n_flat {
        let row = &matrix[a * side..(a + 1) * side];
        let target = gram.row_mut(a);
        target[a..n_flat].copy_from_slice(&row[a..n_flat]);
        target[last] = row[side - 1];
        for (link, adjoint) in adjoints.iter().enumerate() {
            let target = &mut target[n_flat + 6 * link..n_flat + 6 * link + 6];
            write_mapped(&row[n_flat..n_flat + 6], adjoint, target);
        }
    }
    gram.row_mut(last)[last] = matrix[side * side - 1];
    let mut own = Matrix6::zeros();
    let mut gradient = [0.0; 6];
    for k in 0..6 {
        let row = &matrix[(n_flat + k) * side + n_flat..(n_flat + k + 1) * side];
        for l in k..6 {
            own[(k, l)] = row[l];
            own[(l, k)] = row[l];
        }
        gradient[k] = row[6];
    }
    for (link, adjoint) in adjoints.iter().enumerate() {
        let first = n_flat + 6 * link;
        let mut mapped = [0.0; 6];
        write_mapped(&gradient, adjoint, &mut mapped);
        let left = adjoint.map_or(own, |adjoint| adjoint.transpose() * own);
        for (k, mapped) in mapped.into_iter().enumerate() {
            gram.row_mut(first + k)[last] = mapped;
        }
        for (other, other_adjoint) in adjoints.iter().enumerate().skip(link) {
            let block = other_adjoint.map_or(left, |adjoint| left * adjoint);
            for k in 0..6 {
                let target = &mut gram.row_mut(first + k)[n_flat + 6 * other..n_flat + 6 * other + 6];
                // The lower triangle of a link's own block is never read.
                for (l, target) in target.iter_mut().enumerate() {
                    *target = block[(k, l)];
                }
            }
        }
    }
}

/// Writes `row * adjoint`, where `None` is the identity.
#[inline(always)]
fn write_mapped(row: &[f64], adjoint: &Option<Matrix6<f64>>, target: &mut [f64]) {
    match adjoint {
        None => {
            target.copy_from_slice(row);
        }
        Some(adjoint) => {
            for (column, target) in adjoint.as_slice().chunks_exact(6).zip(target) {
                let mut sum = 0.0;
                for k in 0..6 {
                    sum += row[k] * column[k];
                }
                *target = sum;
            }
        }
    }
}

/// The longest chain: camera, mount, robot, target mount, target, and room to spare.
const MAX_LINKS: usize = 8;

impl Term for Reprojection {
    fn blocks(&self) -> &[BlockId] {
        &self.blocks
    }

    fn row_count(&self) -> usize {
        self.n_rows
    }

    fn linearize(&self, values: Values<'_>, gram: &mut GramMut<'_>, scratch: &mut Scratch) -> Option<f64> {
        if self.n_rows == 0 {
            gram.clear();
            return Some(0.0);
        }
        let mut adjoints = [None; MAX_LINKS];
        let mut n_links = 0;
        self.chain.each_adjoint(values, |adjoint| {
            adjoints[n_links] = adjoint.copied();
            n_links += 1;
        });
        self.model.visit(Accumulate {
            term: self,
            lens: values.vector(self.blocks[0]),
            cam_from_target: self.chain.compose(values),
            adjoints: &adjoints[..n_links],
            shape: self.shape(values),
            scratch,
            gram,
        })
    }
}

/// Multiplies out the rows of a view, for one lens model.
struct Accumulate<'a, 'g> {
    term: &'a Reprojection,
    lens: &'a [f64],
    cam_from_target: Pose,
    adjoints: &'a [Option<Matrix6<f64>>],
    shape: [f64; MAX_SHAPE],
    scratch: &'a mut Scratch,
    gram: &'a mut GramMut<'g>,
}

impl ModelVisitor for Accumulate<'_, '_> {
    type Output = Option<f64>;

    fn visit<M: CameraModel>(self, model: M) -> Option<f64> {
        let arch = self.term.arch;
        arch.dispatch(AccumulateWith { model, view: self })
    }
}

struct AccumulateWith<'a, 'g, M> {
    model: M,
    view: Accumulate<'a, 'g>,
}

impl<M: CameraModel> WithSimd for AccumulateWith<'_, '_, M> {
    type Output = Option<f64>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Option<f64> {
        // The number of shape coefficients and of lens parameters are constants of the code that each
        // arm becomes, so that rows are written without loops and without checks.
        match self.view.term.n_shape {
            0 => accumulate::<M, S, 0>(simd, self.model, self.view),
            _ => accumulate::<M, S, MAX_SHAPE>(simd, self.model, self.view),
        }
    }
}

#[inline(always)]
fn accumulate<M: CameraModel, S: Simd, const SHAPE: usize>(
    simd: S,
    model: M,
    view: Accumulate<'_, '_>,
) -> Option<f64> {
    let Accumulate { term, lens, cam_from_target, adjoints, shape, scratch, gram } = view;
    let n_points = term.points.n_points;
    let stride = n_row_columns(model.param_count(), SHAPE).div_ceil(BLOCK) * BLOCK;
    scratch.gram.reset(stride / BLOCK);
    let n_chunks_at_once = POINTS_AT_ONCE / S::F64_LANES;
    let room = n_chunks_at_once * stride * S::F64_LANES;
    // Loads that straddle cache lines take twice as long.
    const LINE: usize = 64 / size_of::<f64>();
    scratch.rows.resize(2 * room + LINE, 0.0);
    let aligned = scratch.rows.as_ptr().align_offset(64).min(LINE);
    let (u_rows, v_rows) = scratch.rows[aligned..aligned + 2 * room].split_at_mut(room);
    let (u_rows, _) = S::as_mut_simd_f64s(u_rows);
    let (v_rows, _) = S::as_mut_simd_f64s(v_rows);
    let context = Context {
        model,
        term,
        lens,
        rotation: cam_from_target.rotation_matrix(),
        translation: cam_from_target.translation.into(),
        shape,
    };
    // A weight that all rows share is applied to their sums.
    let (uniform, shared) = match (&term.weights, term.loss) {
        (Weights::Uniform(weight), Loss::None) => (true, weight * weight),
        _ => (false, 1.0),
    };
    let mut loss = 0.0;
    let mut first = 0;
    while first < n_points {
        let n_chunks = (n_points - first).min(POINTS_AT_ONCE).div_ceil(S::F64_LANES);
        for chunk in 0..n_chunks {
            let point = first + chunk * S::F64_LANES;
            let u = &mut u_rows[chunk * stride..(chunk + 1) * stride];
            let v = &mut v_rows[chunk * stride..(chunk + 1) * stride];
            if uniform && point + S::F64_LANES <= n_points {
                context.write_rows::<S, SHAPE, false>(simd, point, [u, v])?;
            } else {
                loss += context.write_rows::<S, SHAPE, true>(simd, point, [u, v])?;
            }
        }
        let (u, _) = u_rows[..n_chunks * stride].as_chunks::<BLOCK>();
        let (v, _) = v_rows[..n_chunks * stride].as_chunks::<BLOCK>();
        scratch.gram.add(simd, u, v);
        first += POINTS_AT_ONCE;
    }
    let layout = &*term.layout;
    let side = layout.side();
    scratch.matrix.resize(side * side, 0.0);
    layout.unpack(scratch.gram.sums(), shared, &mut scratch.matrix);
    expand(layout, &scratch.matrix, adjoints, gram);
    Some(match term.loss {
        Loss::None => scratch.matrix[side * side - 1],
        Loss::Cauchy { .. } => loss,
    })
}

/// Returns the numbers from `point` on, one a lane.
#[inline(always)]
fn load<S: Simd>(simd: S, numbers: &[f64], point: usize) -> Lanes<S> {
    Lanes::new(simd, S::as_simd_f64s(&numbers[point..point + S::F64_LANES]).0[0])
}

/// What is the same for all points of a view.
struct Context<'a, M> {
    model: M,
    term: &'a Reprojection,
    lens: &'a [f64],
    rotation: Matrix3<f64>,
    translation: [f64; 3],
    shape: [f64; MAX_SHAPE],
}

impl<M: CameraModel> Context<'_, M> {
    /// Writes the two rows of each point of a chunk and returns the chunk's robust loss, if there is one.
    ///
    /// Rows that are not `WEIGHTED` are in pixels; others are in sigmas, and zero in the padding.
    #[inline(always)]
    fn write_rows<S: Simd, const SHAPE: usize, const WEIGHTED: bool>(
        &self,
        simd: S,
        point: usize,
        rows: [&mut [S::f64s]; 2],
    ) -> Option<f64> {
        let Self { model, term, lens, rotation, translation, shape } = self;
        let n_lens = model.param_count() - 4;
        let zero = Lanes::splat(simd, 0.0);
        let axes = &term.points.axes;
        let (x, y, mut z) =
            (load(simd, &axes[0], point), load(simd, &axes[1], point), load(simd, &axes[2], point));
        let mut basis = [zero; SHAPE];
        for j in 0..SHAPE {
            basis[j] = load(simd, &axes[3 + j], point);
            z = basis[j].mul_add(zero.like(shape[j]), z);
        }
        let mut p = [zero; 3];
        for i in 0..3 {
            let along_z = z.mul_add(zero.like(rotation[(i, 2)]), zero.like(translation[i]));
            let along_y = y.mul_add(zero.like(rotation[(i, 1)]), along_z);
            p[i] = x.mul_add(zero.like(rotation[(i, 0)]), along_y);
        }
        let mut by_point = [[zero; 3]; 2];
        let mut by_lens_u = [zero; MAX_LENS];
        let mut by_lens_v = [zero; MAX_LENS];
        let pixel =
            model.linearize(lens, p, &mut by_point, [&mut by_lens_u[..n_lens], &mut by_lens_v[..n_lens]])?;
        let mut residuals =
            [pixel[0] - load(simd, &term.pixels[0], point), pixel[1] - load(simd, &term.pixels[1], point)];
        let mut loss = 0.0;
        let mut scale = zero.like(1.0);
        if WEIGHTED {
            scale = self.weights(simd, point);
            residuals = [residuals[0] * scale, residuals[1] * scale];
            if let Loss::Cauchy { sigmas } = term.loss {
                // ρ(s) = c² ln(1 + s/c²), whose weight is 1 / (1 + s/c²).
                let square = residuals[0].mul_add(residuals[0], residuals[1] * residuals[1]);
                let one_more = square.scale(1.0 / (sigmas * sigmas)) + zero.like(1.0);
                let by_root = zero.like(1.0) / one_more.sqrt();
                loss =
                    sigmas * sigmas * one_more.to_array()[..S::F64_LANES].iter().map(|x| x.ln()).sum::<f64>();
                scale = scale * by_root;
                residuals = [residuals[0] * by_root, residuals[1] * by_root];
            }
        }
        for (row, columns) in rows.into_iter().enumerate() {
            let columns = &mut columns[..n_row_columns(model.param_count(), SHAPE).div_ceil(BLOCK) * BLOCK];
            let by_lens = if row == 0 { &by_lens_u } else { &by_lens_v };
            let [mut a, mut b, mut c] = by_point[row];
            let mut by_focal = (pixel[row] - zero.like(lens[2 + row])).scale(1.0 / lens[row]);
            if WEIGHTED {
                (a, b, c) = (a * scale, b * scale, c * scale);
                by_focal = by_focal * scale;
            }
            columns[0] = by_focal.value;
            columns[1] = scale.value;
            // A left perturbation (w, v) moves the point by w × p + v, so w counts by p × gradient.
            columns[2] = (p[1] * c - p[2] * b).value;
            columns[3] = (p[2] * a - p[0] * c).value;
            columns[4] = (p[0] * b - p[1] * a).value;
            (columns[5], columns[6], columns[7]) = (a.value, b.value, c.value);
            for i in 0..n_lens {
                let by_param = if WEIGHTED { by_lens[i] * scale } else { by_lens[i] };
                columns[FIRST_LENS_COLUMN + i] = by_param.value;
            }
            let rest = &mut columns[FIRST_LENS_COLUMN + n_lens..];
            if SHAPE > 0 {
                // A shape coefficient moves the point along the target's z axis.
                let along_z = a.mul_add(
                    zero.like(rotation[(0, 2)]),
                    b.mul_add(zero.like(rotation[(1, 2)]), c * zero.like(rotation[(2, 2)])),
                );
                for j in 0..SHAPE {
                    rest[j] = (along_z * basis[j]).value;
                }
            }
            rest[SHAPE] = residuals[row].value;
            for rest in &mut rest[SHAPE + 1..] {
                *rest = zero.value;
            }
        }
        Some(loss)
    }

    /// Returns the inverse sigmas of a chunk; zero in the padding.
    ///
    /// A weight that all rows share is applied to their sums where there is no loss, so it is one here.
    #[inline(always)]
    fn weights<S: Simd>(&self, simd: S, point: usize) -> Lanes<S> {
        match &self.term.weights {
            Weights::Each(weights) => load(simd, weights, point),
            Weights::Uniform(weight) => {
                let weight = if self.term.loss == Loss::None { 1.0 } else { *weight };
                let n_left = self.term.points.n_points - point;
                if n_left >= S::F64_LANES {
                    return Lanes::splat(simd, weight);
                }
                let mut weights = [0.0; MAX_LANES];
                weights[..n_left].fill(weight);
                Lanes::from_array(simd, &weights)
            }
        }
    }
}

/// Returns the number of columns of a row: the core, the pose, the lens, the shape, the residual.
#[inline(always)]
const fn n_row_columns(n_params: usize, n_shape: usize) -> usize {
    FIRST_LENS_COLUMN + (n_params - 4) + n_shape + 1
}

/// The largest number of lens parameters beyond the core.
const MAX_LENS: usize = boresight_camera::MAX_PARAMS - 4;
