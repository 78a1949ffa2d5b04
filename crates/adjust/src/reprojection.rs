//! The one residual block: what a view's pixels say about lens, target shape and poses.
//!
//! Derivatives are taken once with respect to the composite pose `cam_from_target`, six columns, and
//! mapped to each link of the chain by its adjoint; see section 6 of the design. J is never formed:
//! rows live in scratch as long as it takes to multiply them.

mod lengths;
mod local;
mod rolling;
mod row_lens;

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::sync::Arc;

use boresight_camera::{CameraModel, Model, ModelVisitor};
use boresight_data::{Id as _, Observation, PointId, Shape, Target};
use boresight_geometry::{Matrix3, Pose, Scalar, Vector3};
use boresight_solver::gram::{BLOCK, Previous, Row};
use boresight_solver::lanes::{Lanes, MAX_LANES};
use boresight_solver::pulp::{Arch, Simd, WithSimd};
use boresight_solver::{
    BlockId, CompositeColumns, CompositeTerm, GramMut, Links, LocalTerm, Scratch, Term, Values, Weighed,
    expand_composite, linearize_composite,
};

use crate::chain::Chain;
use crate::options::Loss;
use crate::reprojection::rolling::RowTimes;
use crate::reprojection::row_lens::{Called, Inlined, RowLens};

/// Points whose rows are in scratch at once; more would spill out of the first-level cache.
const POINTS_AT_ONCE: usize = 104;

/// The numbers of shape coefficients of a target, besides none, that the loops over points are compiled for.
const FEW_SHAPE: usize = Shape::Parabolic2.coefficient_count();
const MAX_SHAPE: usize = Shape::MOST_COEFFICIENTS;

/// The column of the first lens parameter after the core: focal length and centre come before.
///
/// The shape coefficients follow the lens parameters, then the six columns of the pose and the residual.
const FIRST_LENS_COLUMN: usize = 2;

/// Points of a target side by side, padded to whole registers by repeating the last.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TargetPoints {
    n_points: usize,
    /// x, y, z as drawn, then the displacement by each shape coefficient; empty for those that the target has not.
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
    layout: Arc<CompositeColumns>,
    /// When the rows of its points were taken, where that differs; the points then share no composite pose.
    row_times: Option<Box<RowTimes>>,
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

impl Weights {
    /// Returns the weight that all share, or one where each has its own.
    fn uniform(&self) -> f64 {
        match self {
            Weights::Uniform(weight) => *weight,
            Weights::Each(_) => 1.0,
        }
    }
}

/// The layouts in use, which terms of like lenses and shapes share.
#[derive(Debug, Default)]
pub struct Layouts {
    known: RefCell<BTreeMap<(usize, usize), Arc<CompositeColumns>>>,
}

impl Layouts {
    /// Returns the layout of terms with a lens of this model and so many shape coefficients.
    pub(crate) fn get(&self, model: Model, n_shape: usize) -> Arc<CompositeColumns> {
        let n_params = n_whole_params(model);
        let layout = || Arc::new(layout(n_params, n_shape));
        self.known.borrow_mut().entry((n_params, n_shape)).or_insert_with(layout).clone()
    }
}

/// Returns where the products of a term's columns lie.
///
/// The columns are the lens, the shape, the composite pose and the residual; rows have theirs in another order.
fn layout(n_params: usize, n_shape: usize) -> CompositeColumns {
    let n_own = n_params + n_shape;
    let n_row_columns = n_row_columns(n_params, n_shape);
    CompositeColumns::new(n_own, n_row_columns, |column| match column {
        0 => (Some(Row::U), 0),
        1 => (Some(Row::V), 0),
        2 => (Some(Row::U), 1),
        3 => (Some(Row::V), 1),
        // The rest are in the order of the rows, of which two columns stand for four parameters.
        _ => (None, column - 2),
    })
}

impl TargetPoints {
    /// Returns the points of `target` that `observations` name, in their order.
    pub fn new(target: &Target, observations: &[Observation]) -> Self {
        Self::named(target, observations.iter().map(|observation| observation.point))
    }

    /// Returns all points of `target`, in their order.
    pub(crate) fn whole(target: &Target) -> Self {
        Self::named(target, (0..target.point_count()).map(PointId::from_index))
    }

    fn named(target: &Target, points: impl ExactSizeIterator<Item = PointId> + Clone) -> Self {
        let axis = |axis: usize| {
            padded(points.clone().map(|point| match axis {
                0..3 => target.drawn_point(point)[axis],
                _ => target.shape_basis(point)[axis - 3],
            }))
        };
        let n_axes = 3 + target.shape.coefficient_count();
        let axes = std::array::from_fn(|i| if i < n_axes { axis(i) } else { Vec::new() });
        Self { n_points: points.len(), axes }
    }

    /// Returns where a point is on a target with these shape coefficients.
    fn bent(&self, point: usize, shape: &[f64]) -> Vector3<f64> {
        let [x, y, drawn, bends @ ..] = &self.axes;
        let mut z = drawn[point];
        for (bend, coefficient) in bends.iter().zip(shape) {
            z += coefficient * bend[point];
        }
        Vector3::new(x[point], y[point], z)
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
        layouts: &Layouts,
    ) -> Self {
        let layout = layouts.get(model, shape.map_or(0, |(_, n)| n));
        Self::laid_out(model, lens, shape, chain, points, observations, layout)
    }

    /// Does what [`new`](Self::new) does, with the layout of its model and shape.
    pub(crate) fn laid_out(
        model: Model,
        lens: BlockId,
        shape: Option<(BlockId, usize)>,
        chain: Chain,
        points: Arc<TargetPoints>,
        observations: &[Observation],
        layout: Arc<CompositeColumns>,
    ) -> Self {
        assert_eq!(points.n_points, observations.len(), "each observation has its point");
        assert!(
            shape.is_none_or(|(_, n)| [FEW_SHAPE, MAX_SHAPE].contains(&n)),
            "a shape is one that a target may have"
        );
        // Room that has to grow is locked by the allocator where it came from, which may be where another thread works.
        let mut blocks = Vec::with_capacity(2 + chain.links.len());
        blocks.push(lens);
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
            layout,
            row_times: None,
            pixels,
            weights: Weights::Uniform(0.0),
            n_rows: 0,
            loss: Loss::None,
        };
        term.set_kept(observations, |_| true);
        term
    }

    /// Has each point seen as its row was taken, which is so many rows below the middle of the image.
    ///
    /// A chain without a [`Link::Late`](crate::Link::Late) has no motion, and rows make no difference to it. A lens with
    /// local support has no place for its sums here.
    pub fn with_row_times(mut self, rows_from_middle: Vec<f64>) -> Self {
        assert_eq!(self.points.n_points, rows_from_middle.len(), "each observation has its row");
        self.row_times = RowTimes::new(&self.chain, rows_from_middle).map(Box::new);
        self
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

    /// Returns the same term for other pixels and sigmas of the same points.
    pub fn with_pixels(&self, observations: &[Observation]) -> Self {
        assert_eq!(self.points.n_points, observations.len(), "each observation has its point");
        let pixels =
            [0, 1].map(|axis| padded(observations.iter().map(|observation| observation.pixel[axis])));
        let mut term = Self { pixels, ..self.clone() };
        term.set_kept(observations, |_| true);
        term
    }

    /// Sets the loss.
    pub fn set_loss(&mut self, loss: Loss) {
        self.loss = loss;
    }

    /// Returns the number of lens parameters that every point depends on, that of shape coefficients, and
    /// the chain, whose blocks' columns follow these two in [`linearize_common`](Self::linearize_common).
    pub(crate) fn parts(&self) -> (usize, usize, &Chain) {
        (n_whole_params(self.model), self.n_shape, &self.chain)
    }

    /// Writes what [`Term::linearize`] does, but leaves out the lens parameters that not every point depends on.
    pub fn linearize_common(
        &self,
        values: Values<'_>,
        gram: &mut GramMut<'_>,
        scratch: &mut Scratch,
    ) -> Option<()> {
        if let Some(times) = &self.row_times {
            self.chain.linearize(values, &mut scratch.links);
            return self.linearize_rolling(times, values, gram).map(|_| ());
        }
        if self.model.local_support().is_none() {
            return linearize_composite(self, values, gram, scratch).map(|_| ());
        }
        self.sum_common(values, scratch)?;
        expand_composite(&self.layout, 1.0, gram, scratch);
        Some(())
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
                let shape = &term.shape(values)[..term.n_shape];
                let project = |i| model.project(lens, (cam_from_target * term.points.bent(i, shape)).into());
                (0..term.points.n_points).map(project).collect()
            }
        }
        match &self.row_times {
            Some(times) => self.predict_rolling(times, values),
            None => self.model.visit(Predict(self, values)),
        }
    }

    /// Returns where the target stands in front of the camera, as the middle row is taken where rows have times.
    pub fn cam_from_target(&self, values: Values<'_>) -> Pose {
        self.chain.compose(values)
    }

    fn shape(&self, values: Values<'_>) -> [f64; MAX_SHAPE] {
        let mut shape = [0.0; MAX_SHAPE];
        if self.n_shape > 0 {
            shape[..self.n_shape].copy_from_slice(values.vector(self.blocks[1]));
        }
        shape
    }
}

impl Term for Reprojection {
    fn blocks(&self) -> &[BlockId] {
        &self.blocks
    }

    fn row_count(&self) -> usize {
        self.n_rows
    }

    fn linearize(&self, values: Values<'_>, gram: &mut GramMut<'_>, scratch: &mut Scratch) -> Option<f64> {
        match (&self.row_times, self.local()) {
            (Some(times), _) => self.linearize_rolling(times, values, gram),
            (None, None) => linearize_composite(self, values, gram, scratch),
            (None, Some(term)) => self.linearize_whole(term, values, gram, scratch),
        }
    }

    fn composite(&self) -> Option<&dyn CompositeTerm> {
        (self.model.local_support().is_none() && self.row_times.is_none()).then_some(self)
    }

    fn local(&self) -> Option<&dyn LocalTerm> {
        self.model.local_support().map(|_| self as &dyn LocalTerm)
    }
}

impl CompositeTerm for Reprojection {
    fn columns(&self) -> &Arc<CompositeColumns> {
        &self.layout
    }

    fn outer_link(&self) -> Option<usize> {
        self.chain.outer_link()
    }

    fn sum_products(&self, values: Values<'_>, scratch: &mut Scratch) -> Option<Weighed> {
        if self.n_rows == 0 {
            self.chain.linearize(values, &mut scratch.links);
            scratch.gram.clear(n_row_columns(self.model.param_count(), self.n_shape));
            return Some(Weighed { factor: 1.0, cost: 0.0 });
        }
        self.model.visit(Accumulate { term: self, values, scratch })
    }
}

/// Multiplies out the rows of a view, for one lens model.
struct Accumulate<'a> {
    term: &'a Reprojection,
    values: Values<'a>,
    scratch: &'a mut Scratch,
}

impl ModelVisitor for Accumulate<'_> {
    type Output = Option<Weighed>;

    fn visit<M: CameraModel>(self, model: M) -> Option<Weighed> {
        let arch = self.term.arch;
        if const { M::IS_INLINED } && self.term.n_shape <= Inlined::<M>::MAX_SHAPE {
            arch.dispatch(AccumulateWith { lens: Inlined(model), view: self })
        } else {
            arch.dispatch(AccumulateWith { lens: Called(self.term.model), view: self })
        }
    }
}

struct AccumulateWith<'a, L> {
    lens: L,
    view: Accumulate<'a>,
}

impl<L: RowLens> WithSimd for AccumulateWith<'_, L> {
    type Output = Option<Weighed>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Option<Weighed> {
        // The number of shape coefficients and of lens parameters are constants of the code that each
        // arm becomes, so that rows are written without loops and without checks.
        match self.view.term.n_shape {
            0 => accumulate::<L, S, 0>(simd, self.lens, self.view),
            FEW_SHAPE => accumulate::<L, S, FEW_SHAPE>(simd, self.lens, self.view),
            _ if const { L::MAX_SHAPE == MAX_SHAPE } => {
                accumulate::<L, S, MAX_SHAPE>(simd, self.lens, self.view)
            }
            _ => unreachable!("a lens that is part of the loop is not asked for more"),
        }
    }
}

#[inline(always)]
fn accumulate<L: RowLens, S: Simd, const SHAPE: usize>(
    simd: S,
    model: L,
    view: Accumulate<'_>,
) -> Option<Weighed> {
    let Accumulate { term, values, scratch } = view;
    let n_points = term.points.n_points;
    let n_columns = n_row_columns(model.param_count(), SHAPE);
    let stride = n_columns.next_multiple_of(BLOCK);
    let n_chunks_at_once = POINTS_AT_ONCE / S::F64_LANES;
    let room = n_chunks_at_once * stride * S::F64_LANES;
    scratch.rows.make_room(2 * room);
    let (u_rows, v_rows) = scratch.rows.split_at_mut(room);
    let context = Context::new(model, term, values, &mut scratch.links);
    // A weight that all rows share is applied to their sums.
    let (uniform, factor) = match (&term.weights, term.loss) {
        (Weights::Uniform(weight), Loss::None) => (true, weight * weight),
        _ => (false, 1.0),
    };
    let mut loss = 0.0;
    let mut first = 0;
    let mut previous = Previous::Forgotten;
    let n_in_chunk = stride * S::F64_LANES;
    while first < n_points {
        let n_chunks = (n_points - first).min(POINTS_AT_ONCE).div_ceil(S::F64_LANES);
        for chunk in 0..n_chunks {
            let point = first + chunk * S::F64_LANES;
            let (u, _) = S::as_mut_simd_f64s(&mut u_rows[chunk * n_in_chunk..(chunk + 1) * n_in_chunk]);
            let (v, _) = S::as_mut_simd_f64s(&mut v_rows[chunk * n_in_chunk..(chunk + 1) * n_in_chunk]);
            if uniform && point + S::F64_LANES <= n_points {
                context.write_rows::<S, SHAPE, false>(simd, point, [u, v])?;
            } else {
                loss += context.write_rows::<S, SHAPE, true>(simd, point, [u, v])?;
            }
        }
        let (u, v) = (&u_rows[..n_chunks * n_in_chunk], &v_rows[..n_chunks * n_in_chunk]);
        scratch.gram.sum(simd, n_columns, u, v, previous);
        previous = Previous::Kept;
        first += POINTS_AT_ONCE;
    }
    let cost = match term.loss {
        Loss::None => factor * term.layout.squares(scratch.gram.sums()),
        Loss::Cauchy { .. } => loss,
    };
    Some(Weighed { factor, cost })
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
    /// The inverse focal lengths.
    by_focal: [f64; 2],
    rotation: Matrix3<f64>,
    translation: [f64; 3],
    shape: [f64; MAX_SHAPE],
}

impl<'a, L> Context<'a, L> {
    /// Returns what is the same for all points of a view at these values, and leaves in `links` how each
    /// block's left perturbation moves the view's pose.
    #[inline(always)]
    fn new(model: L, term: &'a Reprojection, values: Values<'a>, links: &mut Links) -> Self {
        let (rotation, translation) = term.chain.linearize(values, links);
        let lens = values.vector(term.blocks[0]);
        Self {
            model,
            term,
            lens,
            by_focal: [1.0 / lens[0], 1.0 / lens[1]],
            rotation,
            translation: translation.into(),
            shape: term.shape(values),
        }
    }
}

impl<L: RowLens> Context<'_, L> {
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
        let Self { model, term, lens, by_focal, rotation, .. } = self;
        let n_lens = model.param_count() - 4;
        let zero = Lanes::splat(simd, 0.0);
        let (p, basis) = self.place::<S, SHAPE>(simd, point);
        let mut by_point = [[zero; 3]; 2];
        let mut by_lens_u = [zero; MAX_LENS];
        let mut by_lens_v = [zero; MAX_LENS];
        let pixel = model.linearize(
            simd,
            lens,
            p,
            &mut by_point,
            [&mut by_lens_u[..n_lens], &mut by_lens_v[..n_lens]],
        )?;
        let mut residuals =
            [pixel[0] - load(simd, &term.pixels[0], point), pixel[1] - load(simd, &term.pixels[1], point)];
        let mut loss = 0.0;
        let mut scale = zero.like(1.0);
        if WEIGHTED {
            // A weight that all rows share is applied to their sums where there is no loss.
            let uniform = if term.loss == Loss::None { 1.0 } else { term.weights.uniform() };
            scale = self.weights(simd, point, uniform);
            loss = self.weigh(&mut scale, &mut residuals);
        }
        for (row, columns) in rows.into_iter().enumerate() {
            let columns = &mut columns[..n_row_columns(model.param_count(), SHAPE).div_ceil(BLOCK) * BLOCK];
            let by_lens = if row == 0 { &by_lens_u } else { &by_lens_v };
            let [mut a, mut b, mut c] = by_point[row];
            let mut by_focal = (pixel[row] - zero.like(lens[2 + row])).scale(by_focal[row]);
            if WEIGHTED {
                (a, b, c) = (a * scale, b * scale, c * scale);
                by_focal = by_focal * scale;
            }
            columns[0] = by_focal.value;
            columns[1] = scale.value;
            for i in 0..n_lens {
                let by_param = if WEIGHTED { by_lens[i] * scale } else { by_lens[i] };
                columns[FIRST_LENS_COLUMN + i] = by_param.value;
            }
            let rest = &mut columns[FIRST_LENS_COLUMN + n_lens..];
            write_geometry(rotation, &p, [a, b, c], &basis, residuals[row], rest);
        }
        Some(loss)
    }
}

/// Writes the columns of the shape, the pose and the residual, and zeros in idle ones.
///
/// `p` is the point in the camera frame, `[a, b, c]` the row's derivative by it, `basis` what each shape
/// coefficient adds to the point's z on the target.
#[inline(always)]
fn write_geometry<S: Simd, const SHAPE: usize>(
    rotation: &Matrix3<f64>,
    p: &[Lanes<S>; 3],
    [a, b, c]: [Lanes<S>; 3],
    basis: &[Lanes<S>; SHAPE],
    residual: Lanes<S>,
    columns: &mut [S::f64s],
) {
    if SHAPE > 0 {
        // A shape coefficient moves the point along the target's z axis.
        let along_z = a.mul_add(
            a.like(rotation[(0, 2)]),
            b.mul_add(a.like(rotation[(1, 2)]), c * a.like(rotation[(2, 2)])),
        );
        for j in 0..SHAPE {
            columns[j] = (along_z * basis[j]).value;
        }
    }
    let rest = &mut columns[SHAPE..];
    // A left perturbation (w, v) moves the point by w × p + v, so w counts by p × gradient.
    rest[0] = (p[1] * c - p[2] * b).value;
    rest[1] = (p[2] * a - p[0] * c).value;
    rest[2] = (p[0] * b - p[1] * a).value;
    (rest[3], rest[4], rest[5]) = (a.value, b.value, c.value);
    rest[6] = residual.value;
    for idle in &mut rest[7..] {
        *idle = a.like(0.0).value;
    }
}

impl<L> Context<'_, L> {
    /// Returns the points of a chunk in the camera frame, and what each shape coefficient adds to
    /// their z on the target.
    #[inline(always)]
    fn place<S: Simd, const SHAPE: usize>(
        &self,
        simd: S,
        point: usize,
    ) -> ([Lanes<S>; 3], [Lanes<S>; SHAPE]) {
        let Self { term, rotation, translation, shape, .. } = self;
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
        (p, basis)
    }

    /// Returns the inverse sigmas of a chunk, `uniform` where all are alike; zero in the padding.
    #[inline(always)]
    fn weights<S: Simd>(&self, simd: S, point: usize, uniform: f64) -> Lanes<S> {
        if let Weights::Each(weights) = &self.term.weights {
            return load(simd, weights, point);
        }
        let n_left = self.term.points.n_points - point;
        if n_left >= S::F64_LANES {
            return Lanes::splat(simd, uniform);
        }
        let mut weights = [0.0; MAX_LANES];
        weights[..n_left].fill(uniform);
        Lanes::from_array(simd, &weights)
    }

    /// Brings residuals from pixels to sigmas and weighs them and what their rows are multiplied with as
    /// the loss wants it; returns the chunk's robust loss, if there is one.
    #[inline(always)]
    fn weigh<S: Simd>(&self, scale: &mut Lanes<S>, residuals: &mut [Lanes<S>; 2]) -> f64 {
        *residuals = [residuals[0] * *scale, residuals[1] * *scale];
        let Loss::Cauchy { sigmas } = self.term.loss else { return 0.0 };
        // ρ(s) = c² ln(1 + s/c²), whose weight is 1 / (1 + s/c²).
        let one = scale.like(1.0);
        let square = residuals[0].mul_add(residuals[0], residuals[1] * residuals[1]);
        let one_more = square.scale(1.0 / (sigmas * sigmas)) + one;
        let by_root = one / one_more.sqrt();
        *scale = *scale * by_root;
        *residuals = [residuals[0] * by_root, residuals[1] * by_root];
        let mut loss = 0.0;
        for ratio in &one_more.to_array()[..S::F64_LANES] {
            loss += sigmas * sigmas * ratio.ln();
        }
        loss
    }
}

/// Returns the number of lens parameters that every point depends on.
fn n_whole_params(model: Model) -> usize {
    if model.local_support().is_some() { 4 } else { model.param_count() }
}

/// Returns the number of columns of a row: the core, the lens, the shape, the pose, the residual.
#[inline(always)]
const fn n_row_columns(n_params: usize, n_shape: usize) -> usize {
    FIRST_LENS_COLUMN + (n_params - 4) + n_shape + 6 + 1
}

/// The largest number of lens parameters beyond the core.
const MAX_LENS: usize = boresight_camera::MAX_PARAMS - 4;
