//! The products of the columns that every point of a view has, without the knots.

use boresight_camera::CameraModel;
use boresight_solver::gram::Previous;
use boresight_solver::pulp::Simd;
use boresight_solver::{Scratch, Values};

use super::work::{LocalWork, done};
use super::{CORE, POINTS_AT_ONCE};
use crate::reprojection::{BLOCK, Context, Reprojection, n_row_columns};

impl Reprojection {
    /// Leaves the sums of the products in `scratch.gram` and the maps of the links in `scratch.links`, or
    /// returns `None` where the view is not defined.
    pub(in crate::reprojection) fn sum_common(
        &self,
        values: Values<'_>,
        scratch: &mut Scratch,
    ) -> Option<()> {
        done(SumCommon { term: self, values, scratch })
    }
}

struct SumCommon<'a> {
    term: &'a Reprojection,
    values: Values<'a>,
    scratch: &'a mut Scratch,
}

impl LocalWork for SumCommon<'_> {
    type Output = Option<()>;

    fn term(&self) -> &Reprojection {
        self.term
    }

    fn undefined() -> Option<()> {
        None
    }

    #[inline(always)]
    fn work<M: CameraModel, S: Simd, const SHAPE: usize, const SIDE: usize>(
        self,
        simd: S,
        model: M,
    ) -> Option<()> {
        let Self { term, values, scratch } = self;
        let context = Context::new(model, term, values, &mut scratch.links);
        let n_columns = n_row_columns(CORE, SHAPE);
        let n_in_chunk = n_columns.next_multiple_of(BLOCK) * S::F64_LANES;
        scratch.rows.make_room(2 * POINTS_AT_ONCE / S::F64_LANES * n_in_chunk);
        let n_points = term.points.n_points;
        let mut loss = 0.0;
        scratch.gram.clear(n_columns);
        for first in (0..n_points).step_by(POINTS_AT_ONCE) {
            let n_chunks = (n_points - first).min(POINTS_AT_ONCE).div_ceil(S::F64_LANES);
            let (u, v) = scratch.rows[..2 * n_chunks * n_in_chunk].split_at_mut(n_chunks * n_in_chunk);
            let chunks = u.chunks_exact_mut(n_in_chunk).zip(v.chunks_exact_mut(n_in_chunk));
            for (chunk, (u, v)) in chunks.enumerate() {
                let rows = [S::as_mut_simd_f64s(u).0, S::as_mut_simd_f64s(v).0];
                context.write_common::<S, SHAPE>(simd, first + chunk * S::F64_LANES, rows, &mut loss)?;
            }
            scratch.gram.sum(simd, n_columns, u, v, Previous::Kept);
        }
        Some(())
    }
}
