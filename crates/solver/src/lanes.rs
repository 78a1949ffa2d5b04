//! SIMD lanes as a [`Scalar`]: a formula written once runs on several points at a time.

use std::ops::{Add, Div, Mul, Neg, Sub};

pub use boresight_geometry::MAX_LANES;
use boresight_geometry::Scalar;
use pulp::{Arch, Simd, WithSimd};

/// Returns the number of `f64`s in a register of this machine, as `pulp` dispatches.
pub fn count() -> usize {
    struct Count;
    impl WithSimd for Count {
        type Output = usize;
        fn with_simd<S: Simd>(self, _: S) -> usize {
            S::F64_LANES
        }
    }
    Arch::new().dispatch(Count)
}

/// One SIMD register of `f64`s, with the token that proves the machine has such registers.
///
/// The token takes no room, so this is as wide as the register itself.
#[derive(Clone, Copy, Debug)]
pub struct Lanes<S: Simd> {
    simd: S,
    /// The register.
    pub value: S::f64s,
}

impl<S: Simd> Lanes<S> {
    /// The number of lanes.
    pub const COUNT: usize = S::F64_LANES;

    /// Returns the register `value` as lanes.
    #[inline(always)]
    pub fn new(simd: S, value: S::f64s) -> Self {
        Self { simd, value }
    }

    /// Returns `value` in every lane.
    #[inline(always)]
    pub fn splat(simd: S, value: f64) -> Self {
        Self { simd, value: simd.splat_f64s(value) }
    }

    /// Returns the lanes one by one; those past [`COUNT`](Self::COUNT) are zero.
    #[inline(always)]
    pub fn to_array(self) -> [f64; MAX_LANES] {
        let mut array = [0.0; MAX_LANES];
        // Whole registers: partial loads and stores go through a table of masks.
        S::as_mut_simd_f64s(&mut array[..Self::COUNT]).0[0] = self.value;
        array
    }

    /// Returns the lanes `array`, of which the first [`COUNT`](Self::COUNT) count.
    #[inline(always)]
    pub fn from_array(simd: S, array: &[f64; MAX_LANES]) -> Self {
        Self { simd, value: S::as_simd_f64s(&array[..Self::COUNT]).0[0] }
    }

    /// Returns the sum of all lanes, in an order that depends on their number only.
    #[inline(always)]
    pub fn sum(self) -> f64 {
        self.simd.reduce_sum_f64s(self.value)
    }

    #[inline(always)]
    fn map(self, f: impl Fn(f64) -> f64) -> Self {
        Self::from_array(self.simd, &self.to_array().map(f))
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
    Add, add, add_f64s;
    Sub, sub, sub_f64s;
    Mul, mul, mul_f64s;
    Div, div, div_f64s;
}

impl<S: Simd> Neg for Lanes<S> {
    type Output = Self;

    #[inline(always)]
    fn neg(self) -> Self {
        Self { simd: self.simd, value: self.simd.neg_f64s(self.value) }
    }
}

impl<S: Simd> Scalar for Lanes<S> {
    // The widest register of any instruction set that `pulp` dispatches to is that of AVX-512: eight.
    const LANES: usize = S::F64_LANES;

    #[inline(always)]
    fn like(self, value: f64) -> Self {
        Self::splat(self.simd, value)
    }

    #[inline(always)]
    fn mul_add(self, factor: Self, summand: Self) -> Self {
        Self { simd: self.simd, value: self.simd.mul_add_f64s(self.value, factor.value, summand.value) }
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        Self { simd: self.simd, value: self.simd.sqrt_f64s(self.value) }
    }

    #[inline(always)]
    fn sin(self) -> Self {
        self.map(f64::sin)
    }

    #[inline(always)]
    fn cos(self) -> Self {
        self.map(f64::cos)
    }

    #[inline(always)]
    fn atan2(self, x: Self) -> Self {
        let (y, x) = (self.to_array(), x.to_array());
        let mut angle = [0.0; MAX_LANES];
        for i in 0..Self::COUNT {
            angle[i] = y[i].atan2(x[i]);
        }
        Self::from_array(self.simd, &angle)
    }

    #[inline(always)]
    fn all_above(self, limit: f64) -> bool {
        let above = self.simd.greater_than_f64s(self.value, self.simd.splat_f64s(limit));
        let all = self.simd.less_than_f64s(self.simd.splat_f64s(0.0), self.simd.splat_f64s(1.0));
        self.simd.first_true_m64s(self.simd.xor_m64s(above, all)) >= Self::COUNT
    }

    #[inline(always)]
    fn select_below(self, limit: f64, if_below: Self, otherwise: Self) -> Self {
        let below = self.simd.less_than_f64s(self.value, self.simd.splat_f64s(limit));
        Self { simd: self.simd, value: self.simd.select_f64s(below, if_below.value, otherwise.value) }
    }

    #[inline(always)]
    fn lane(self, lane: usize) -> f64 {
        self.to_array()[lane]
    }

    #[inline(always)]
    fn look_up(self, table: &[f64], places: &[usize; MAX_LANES]) -> Self {
        let mut array = [0.0; MAX_LANES];
        for lane in 0..Self::COUNT {
            array[lane] = table[places[lane]];
        }
        Self::from_array(self.simd, &array)
    }

    #[inline(always)]
    fn with_lane(self, lane: usize, other: Self) -> Self {
        let mut array = self.to_array();
        array[lane] = other.to_array()[lane];
        Self::from_array(self.simd, &array)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Checks that lanes compute what `f64` computes, one by one.
    struct SameAsOneByOne;

    impl WithSimd for SameAsOneByOne {
        type Output = ();

        fn with_simd<S: Simd>(self, simd: S) {
            let input = [0.3, -1.2, 2.5, 0.0, 1e-9, 4.0, -0.7, 0.5];
            let x = Lanes::from_array(simd, &input);
            let check = |lanes: Lanes<S>, one: &dyn Fn(f64) -> f64| {
                for (i, &input) in input.iter().enumerate().take(Lanes::<S>::COUNT) {
                    let (found, expected) = (lanes.to_array()[i], one(input));
                    // Fused and unfused results differ in the last bit.
                    assert!((found - expected).abs() <= 1e-15 * (1.0 + expected.abs()), "{found} {expected}");
                }
            };
            check(x * x + x.like(2.0), &|x| x * x + 2.0);
            check(-(x - x.like(1.0)) / x.like(3.0), &|x| -(x - 1.0) / 3.0);
            check(x.mul_add(x, x), &|x| x * x + x);
            check((x * x).sqrt(), &|x| x.abs());
            check(x.sin() + x.cos(), &|x| x.sin() + x.cos());
            check(x.atan2(x.like(0.5)), &|x| x.atan2(0.5));
            check(x.select_below(0.4, x.like(1.0), x), &|x| if x < 0.4 { 1.0 } else { x });
            assert!((0..Lanes::<S>::COUNT).all(|i| x.lane(i) == input[i]));
            let last = Lanes::<S>::COUNT - 1;
            let mixed = x.with_lane(last, x.like(7.0));
            assert!((0..last).all(|i| mixed.lane(i) == input[i]) && mixed.lane(last) == 7.0);
            let places = [3, 0, 2, 1, 1, 0, 3, 2];
            let found = x.look_up(&[10.0, 11.0, 12.0, 13.0], &places);
            assert!((0..Lanes::<S>::COUNT).all(|i| found.lane(i) == 10.0 + places[i] as f64));
            assert!(x.like(1.0).all_above(0.5) && !x.like(f64::NAN).all_above(0.5));
            if Lanes::<S>::COUNT > 1 {
                assert!(!x.all_above(-1.0));
            }
        }
    }

    #[test]
    fn lanes_compute_as_one_by_one() {
        Arch::new().dispatch(SameAsOneByOne);
        SameAsOneByOne.with_simd(pulp::Scalar::new());
    }
}
