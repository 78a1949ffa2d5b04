//! The gradient of a view through a lens with local support.

use boresight_camera::CameraModel;
use boresight_geometry::Scalar;
use boresight_solver::lanes::{Lanes, MAX_LANES};
use boresight_solver::pulp::Simd;
use boresight_solver::{Scratch, Values};

use super::work::LocalWork;
use super::{CORE, FIRST_SHAPE_COLUMN, Grid, map_row};
use crate::options::Loss;
use crate::reprojection::{BLOCK, Context, Reprojection, n_row_columns};

/// Sums the gradient of a view, and returns its cost.
pub(super) struct SumGradient<'a> {
    pub term: &'a Reprojection,
    pub values: Values<'a>,
    pub grid: Grid,
    /// By the columns of the lens, the shape, and the poses of the chain.
    pub gradient: &'a mut [f64],
    pub scratch: &'a mut Scratch,
}

impl LocalWork for SumGradient<'_> {
    type Output = Option<f64>;

    fn term(&self) -> &Reprojection {
        self.term
    }

    fn undefined() -> Option<f64> {
        None
    }

    #[inline(always)]
    fn work<M: CameraModel, S: Simd, const SHAPE: usize, const SIDE: usize>(
        self,
        simd: S,
        model: M,
    ) -> Option<f64> {
        let Self { term, values, grid, gradient, scratch } = self;
        let context = Context::new(model, term, values, &mut scratch.links);
        let lens = context.lens;
        let n_columns = n_row_columns(CORE, SHAPE);
        let stride = n_columns.next_multiple_of(BLOCK);
        scratch.rows.make_room(2 * stride * S::F64_LANES);
        let (u, v) = scratch.rows.split_at_mut(stride * S::F64_LANES);
        let (u, _) = S::as_mut_simd_f64s(u);
        let (v, _) = S::as_mut_simd_f64s(v);
        let zero = Lanes::splat(simd, 0.0);
        let (mut core, mut pose, mut shape) = ([zero; CORE], [zero; 6], [zero; SHAPE]);
        let (mut squares, mut loss) = (zero, 0.0);
        let (by_core, by_others) = gradient.split_at_mut(CORE);
        let (knots, others) = by_others.split_at_mut(grid.n_params() - CORE);
        let row_stride = 2 * grid.support.columns;
        let n_points = term.points.n_points;
        let mut point = 0;
        while point < n_points {
            let (linear, scale) = context.write_common::<S, SHAPE>(simd, point, [u, v], &mut loss)?;
            let by_u = Lanes::new(simd, u[FIRST_SHAPE_COLUMN + SHAPE + 6]);
            let by_v = Lanes::new(simd, v[FIRST_SHAPE_COLUMN + SHAPE + 6]);
            squares = by_u.mul_add(by_u, by_v.mul_add(by_v, squares));
            core[0] = Lanes::new(simd, u[0]).mul_add(by_u, core[0]);
            core[1] = Lanes::new(simd, v[0]).mul_add(by_v, core[1]);
            core[2] = Lanes::new(simd, u[1]).mul_add(by_u, core[2]);
            core[3] = Lanes::new(simd, v[1]).mul_add(by_v, core[3]);
            for k in 0..6 {
                let along_u = Lanes::new(simd, u[FIRST_SHAPE_COLUMN + SHAPE + k]).mul_add(by_u, pose[k]);
                pose[k] = Lanes::new(simd, v[FIRST_SHAPE_COLUMN + SHAPE + k]).mul_add(by_v, along_u);
            }
            for j in 0..SHAPE {
                let along_u = Lanes::new(simd, u[FIRST_SHAPE_COLUMN + j]).mul_add(by_u, shape[j]);
                shape[j] = Lanes::new(simd, v[FIRST_SHAPE_COLUMN + j]).mul_add(by_v, along_u);
            }
            let knot_u = (by_u * scale).scale(lens[0]).to_array();
            let knot_v = (by_v * scale).scale(lens[1]).to_array();
            let mut weights = [[0.0; MAX_LANES]; 16];
            for (weights, weight) in weights.iter_mut().zip(&linear.weights).take(SIDE * SIDE) {
                *weights = weight.to_array();
            }
            for lane in 0..(n_points - point).min(S::F64_LANES) {
                for row in 0..SIDE {
                    let first = linear.first[lane] - CORE + row * row_stride;
                    let sums = &mut knots[first..first + 2 * SIDE];
                    for column in 0..SIDE {
                        let weight = weights[row * SIDE + column][lane];
                        sums[2 * column] += weight * knot_u[lane];
                        sums[2 * column + 1] += weight * knot_v[lane];
                    }
                }
            }
            point += S::F64_LANES;
        }
        for (entry, sum) in by_core.iter_mut().zip(core) {
            *entry += sum.sum();
        }
        let (by_shape, by_links) = others.split_at_mut(SHAPE);
        for (entry, sum) in by_shape.iter_mut().zip(shape) {
            *entry += sum.sum();
        }
        let mut by_pose = [0.0; 6];
        for (entry, sum) in by_pose.iter_mut().zip(pose) {
            *entry = sum.sum();
        }
        for (entries, map) in by_links.chunks_exact_mut(6).zip(scratch.links.maps()) {
            entries.iter_mut().zip(map_row(map, by_pose)).for_each(|(entry, part)| *entry += part);
        }
        Some(match term.loss {
            Loss::None => squares.sum(),
            Loss::Cauchy { .. } => loss,
        })
    }
}
