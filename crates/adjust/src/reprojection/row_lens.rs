//! How the loop over corners comes by a lens: short formulas are part of its code, long ones are called.
//!
//! The loop is compiled for each lens that it contains, for each instruction set and shape. Lenses whose
//! derivatives are dual numbers would make that code very long, and gain little; so would shapes of many coefficients,
//! for which all lenses are called.

use boresight_camera::{CameraModel, Model, ModelVisitor};
use boresight_solver::lanes::{Lanes, MAX_LANES};
use boresight_solver::pulp::{Simd, WithSimd};

use super::{FEW_SHAPE, MAX_LENS, MAX_SHAPE};

/// A lens as the loop over corners sees it.
pub(super) trait RowLens: Copy {
    /// The largest number of shape coefficients that the loop is compiled for.
    const MAX_SHAPE: usize;

    /// Returns the number of parameters, the core included.
    fn param_count(&self) -> usize;

    /// Returns pixels and derivatives as [`CameraModel::linearize`] does.
    fn linearize<S: Simd>(
        &self,
        simd: S,
        params: &[f64],
        point_in_cam: [Lanes<S>; 3],
        d_point: &mut [[Lanes<S>; 3]; 2],
        d_lens: [&mut [Lanes<S>]; 2],
    ) -> Option<[Lanes<S>; 2]>;
}

/// A lens that becomes part of the loop.
#[derive(Clone, Copy)]
pub(super) struct Inlined<M>(pub M);

impl<M: CameraModel> RowLens for Inlined<M> {
    const MAX_SHAPE: usize = FEW_SHAPE;

    #[inline(always)]
    fn param_count(&self) -> usize {
        self.0.param_count()
    }

    #[inline(always)]
    fn linearize<S: Simd>(
        &self,
        _: S,
        params: &[f64],
        point_in_cam: [Lanes<S>; 3],
        d_point: &mut [[Lanes<S>; 3]; 2],
        d_lens: [&mut [Lanes<S>]; 2],
    ) -> Option<[Lanes<S>; 2]> {
        self.0.linearize(params, point_in_cam, d_point, d_lens)
    }
}

/// A lens that the loop calls.
#[derive(Clone, Copy)]
pub(super) struct Called(pub Model);

impl RowLens for Called {
    const MAX_SHAPE: usize = MAX_SHAPE;

    #[inline(always)]
    fn param_count(&self) -> usize {
        self.0.param_count()
    }

    #[inline(always)]
    fn linearize<S: Simd>(
        &self,
        simd: S,
        params: &[f64],
        point_in_cam: [Lanes<S>; 3],
        d_point: &mut [[Lanes<S>; 3]; 2],
        d_lens: [&mut [Lanes<S>]; 2],
    ) -> Option<[Lanes<S>; 2]> {
        let mut point = [[0.0; MAX_LANES]; 3];
        for (to, from) in point.iter_mut().zip(point_in_cam) {
            *to = from.to_array();
        }
        let mut answer = Answer::default();
        let is_defined = self.0.visit(Call { simd, params, point, answer: &mut answer });
        if !is_defined {
            return None;
        }
        let [u, v] = d_lens;
        for (row, (d_point, d_lens)) in d_point.iter_mut().zip([u, v]).enumerate() {
            for (to, from) in d_point.iter_mut().zip(&answer.d_point[row]) {
                *to = Lanes::from_array(simd, from);
            }
            for (to, from) in d_lens.iter_mut().zip(&answer.d_lens[row]) {
                *to = Lanes::from_array(simd, from);
            }
        }
        Some([Lanes::from_array(simd, &answer.pixel[0]), Lanes::from_array(simd, &answer.pixel[1])])
    }
}

/// What a lens answers, a number for each lane.
#[derive(Default)]
struct Answer {
    pixel: [[f64; MAX_LANES]; 2],
    d_point: [[[f64; MAX_LANES]; 3]; 2],
    d_lens: [[[f64; MAX_LANES]; MAX_LENS]; 2],
}

/// Asks a lens about the points of a chunk; the answer is whether it is defined.
struct Call<'a, S> {
    simd: S,
    params: &'a [f64],
    point: [[f64; MAX_LANES]; 3],
    answer: &'a mut Answer,
}

impl<S: Simd> ModelVisitor for Call<'_, S> {
    type Output = bool;

    fn visit<M: CameraModel>(self, model: M) -> bool {
        let Self { simd, params, point, answer } = self;
        if const { M::LOCAL_SIDE.is_some() } {
            // Never asked: it has a loop of its own.
            return false;
        }
        simd.vectorize(CallWith { model, params, point, answer })
    }
}

struct CallWith<'a, M> {
    model: M,
    params: &'a [f64],
    point: [[f64; MAX_LANES]; 3],
    answer: &'a mut Answer,
}

impl<M: CameraModel> WithSimd for CallWith<'_, M> {
    type Output = bool;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> bool {
        let Self { model, params, point, answer } = self;
        let zero = Lanes::splat(simd, 0.0);
        let point = [
            Lanes::from_array(simd, &point[0]),
            Lanes::from_array(simd, &point[1]),
            Lanes::from_array(simd, &point[2]),
        ];
        let mut d_point = [[zero; 3]; 2];
        let (mut u, mut v) = ([zero; MAX_LENS], [zero; MAX_LENS]);
        let n_lens = model.param_count() - 4;
        let d_lens = [&mut u[..n_lens], &mut v[..n_lens]];
        let Some(pixel) = model.linearize(params, point, &mut d_point, d_lens) else { return false };
        for row in 0..2 {
            answer.pixel[row] = pixel[row].to_array();
            for (to, from) in answer.d_point[row].iter_mut().zip(d_point[row]) {
                *to = from.to_array();
            }
            let from = if row == 0 { &u } else { &v };
            for (to, from) in answer.d_lens[row].iter_mut().zip(&from[..n_lens]) {
                *to = from.to_array();
            }
        }
        true
    }
}
