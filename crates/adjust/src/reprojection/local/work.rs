//! How what is done over a view's points comes to know its lens, and how many columns, as constants of the code.

use boresight_camera::{CameraModel, ModelVisitor};
use boresight_solver::pulp::{Simd, WithSimd};

use super::{FEW_SHAPE, MAX_SHAPE};
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
        if const { M::LOCAL_SIDE.is_none() } {
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
        // Each lens has one side, and only that is compiled.
        if const { matches!(M::LOCAL_SIDE, Some(3)) } {
            shaped::<M, S, W, 3>(simd, model, work)
        } else {
            shaped::<M, S, W, 4>(simd, model, work)
        }
    }
}

#[inline(always)]
fn shaped<M: CameraModel, S: Simd, W: LocalWork, const SIDE: usize>(simd: S, model: M, work: W) -> W::Output {
    match work.term().n_shape {
        0 => work.work::<M, S, 0, SIDE>(simd, model),
        FEW_SHAPE => work.work::<M, S, FEW_SHAPE, SIDE>(simd, model),
        _ => work.work::<M, S, MAX_SHAPE, SIDE>(simd, model),
    }
}
