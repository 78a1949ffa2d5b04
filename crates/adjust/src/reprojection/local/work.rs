//! How what is done over a view's points comes to know its lens, and how many columns, as constants of the code.

use boresight_camera::{CameraModel, ModelVisitor};
use boresight_solver::pulp::{Simd, WithSimd};

use super::MAX_SHAPE;
use crate::reprojection::Reprojection;

/// Something done over the points of a view through a lens with local support.
pub(super) trait LocalWork: Sized {
    type Output;

    /// Returns the view.
    fn term(&self) -> &Reprojection;

    /// Returns what it comes to for other lenses, which are never asked.
    fn undefined() -> Self::Output;

    /// Does it, for so many shape coefficients and a point that depends on `SIDE` knots in each direction.
    fn work<M: CameraModel, S: Simd, const SHAPE: usize, const SIDE: usize>(
        self,
        simd: S,
        model: M,
    ) -> Self::Output;
}

/// Does it in the widest registers of the machine.
pub(super) fn done<W: LocalWork>(work: W) -> W::Output {
    let model = work.term().model;
    model.visit(Visit(work))
}

struct Visit<W>(W);

impl<W: LocalWork> ModelVisitor for Visit<W> {
    type Output = W::Output;

    fn visit<M: CameraModel>(self, model: M) -> W::Output {
        if const { !M::IS_LOCAL } {
            return W::undefined();
        }
        let arch = self.0.term().arch;
        arch.dispatch(With { model, work: self.0 })
    }
}

struct With<M, W> {
    model: M,
    work: W,
}

impl<M: CameraModel, W: LocalWork> WithSimd for With<M, W> {
    type Output = W::Output;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> W::Output {
        let Self { model, work } = self;
        let side = work.term().model.local_support().map_or(4, |support| support.side);
        match (work.term().n_shape, side) {
            (0, 3) => work.work::<M, S, 0, 3>(simd, model),
            (0, _) => work.work::<M, S, 0, 4>(simd, model),
            (_, 3) => work.work::<M, S, MAX_SHAPE, 3>(simd, model),
            (_, _) => work.work::<M, S, MAX_SHAPE, 4>(simd, model),
        }
    }
}
