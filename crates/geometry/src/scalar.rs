//! The numbers that a formula is written in: plain, with derivatives, or many at once.

use std::ops::{Add, Div, Mul, Neg, Sub};

/// The largest number of values that one [`Scalar`] stands for.
pub const MAX_LANES: usize = 8;

/// A number that a projection formula can be written in once.
///
/// Implemented by `f64`, by [`Dual`](crate::Dual) over any scalar, and by the SIMD lanes of the
/// solver, where one value stands for several points. Comparisons therefore speak of *all* lanes,
/// or select lane by lane; they look at values only, never at derivatives.
pub trait Scalar:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self> + Neg<Output = Self>
{
    /// The number of values that one number stands for, at most [`MAX_LANES`].
    const LANES: usize;

    /// Returns the constant `value`, with zero derivatives, in as many lanes as `self` has.
    ///
    /// A constant is made from a number at hand because SIMD lanes cannot be conjured without the
    /// proof, which every one of them carries, that the machine has the instructions.
    fn like(self, value: f64) -> Self;

    /// Returns `self * factor + summand`, fused where the machine can.
    fn mul_add(self, factor: Self, summand: Self) -> Self;

    /// Returns the square root.
    fn sqrt(self) -> Self;

    /// Returns the sine of an angle in radians.
    fn sin(self) -> Self;

    /// Returns the cosine of an angle in radians.
    fn cos(self) -> Self;

    /// Returns the angle of the point (`x`, `self`) in radians, in (-π, π].
    fn atan2(self, x: Self) -> Self;

    /// Tells whether the value exceeds `limit` in every lane. NaN exceeds nothing.
    fn all_above(self, limit: f64) -> bool;

    /// Returns, lane by lane, `if_below` where the value of `self` is below `limit`, else `otherwise`.
    fn select_below(self, limit: f64, if_below: Self, otherwise: Self) -> Self;

    /// Returns the value in one lane.
    fn lane(self, lane: usize) -> f64;

    /// Returns `self`, but in one lane the value and the derivatives of `other`.
    ///
    /// With this a formula looks numbers up in a table, where each lane may want another entry.
    fn with_lane(self, lane: usize, other: Self) -> Self;

    /// Returns `self * factor`.
    #[inline(always)]
    fn scale(self, factor: f64) -> Self {
        self * self.like(factor)
    }
}

impl Scalar for f64 {
    const LANES: usize = 1;

    #[inline(always)]
    fn like(self, value: f64) -> Self {
        value
    }

    #[inline(always)]
    fn mul_add(self, factor: Self, summand: Self) -> Self {
        // `f64::mul_add` is a slow library call where the target lacks the instruction.
        self * factor + summand
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        f64::sqrt(self)
    }

    #[inline(always)]
    fn sin(self) -> Self {
        f64::sin(self)
    }

    #[inline(always)]
    fn cos(self) -> Self {
        f64::cos(self)
    }

    #[inline(always)]
    fn atan2(self, x: Self) -> Self {
        f64::atan2(self, x)
    }

    #[inline(always)]
    fn all_above(self, limit: f64) -> bool {
        self > limit
    }

    #[inline(always)]
    fn select_below(self, limit: f64, if_below: Self, otherwise: Self) -> Self {
        if self < limit { if_below } else { otherwise }
    }

    #[inline(always)]
    fn lane(self, _: usize) -> f64 {
        self
    }

    #[inline(always)]
    fn with_lane(self, _: usize, other: Self) -> Self {
        other
    }
}
