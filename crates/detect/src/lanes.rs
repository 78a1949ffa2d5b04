//! SIMD lanes of single precision as numbers, so that formulas read as such.

use std::ops::{Add, Div, Mul, Sub};

use pulp::Simd;

/// The most lanes of any instruction set that `pulp` dispatches to: those of AVX-512.
pub(crate) const MOST_LANES: usize = 16;

/// One SIMD register, with the token that proves the machine has such registers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lanes<S: Simd> {
    simd: S,
    pub value: S::f32s,
}

impl<S: Simd> Lanes<S> {
    #[inline(always)]
    pub fn new(simd: S, value: S::f32s) -> Self {
        Self { simd, value }
    }

    /// Returns `value` in every lane.
    #[inline(always)]
    pub fn splat(simd: S, value: f32) -> Self {
        Self { simd, value: simd.splat_f32s(value) }
    }

    /// Returns `value` in every lane of a register like this.
    #[inline(always)]
    pub fn like(self, value: f32) -> Self {
        Self::splat(self.simd, value)
    }

    /// Returns `self * factor + summand`.
    #[inline(always)]
    pub fn mul_add(self, factor: Self, summand: Self) -> Self {
        Self { simd: self.simd, value: self.simd.mul_add_f32s(self.value, factor.value, summand.value) }
    }

    /// Returns `summand - self * factor`.
    #[inline(always)]
    pub fn negate_mul_add(self, factor: Self, summand: Self) -> Self {
        let value = self.simd.negate_mul_add_f32s(self.value, factor.value, summand.value);
        Self { simd: self.simd, value }
    }

    #[inline(always)]
    pub fn abs(self) -> Self {
        Self { simd: self.simd, value: self.simd.abs_f32s(self.value) }
    }

    #[inline(always)]
    pub fn min(self, other: Self) -> Self {
        Self { simd: self.simd, value: self.simd.min_f32s(self.value, other.value) }
    }

    /// Returns this with the sign changed where `other` is negative.
    #[inline(always)]
    pub fn signed_as(self, other: Self) -> Self {
        let zero = self.simd.splat_f32s(0.0);
        let is_negative = self.simd.less_than_f32s(other.value, zero);
        let negative = self.simd.sub_f32s(zero, self.value);
        Self { simd: self.simd, value: self.simd.select_f32s(is_negative, negative, self.value) }
    }
}

macro_rules! operators {
    ($($operator:ident, $method:ident, $instruction:ident;)*) => {$(
        impl<S: Simd> $operator for Lanes<S> {
            type Output = Self;

            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                Self { simd: self.simd, value: self.simd.$instruction(self.value, other.value) }
            }
        }
    )*};
}

operators! {
    Add, add, add_f32s;
    Sub, sub, sub_f32s;
    Mul, mul, mul_f32s;
    Div, div, div_f32s;
}
