//! Dual numbers: a value together with `N` first derivatives.

use std::ops::{Add, Div, Mul, Neg, Sub};

use crate::Scalar;

/// A value over any scalar `T`, with its derivatives along `N` directions.
///
/// Over `f64` it differentiates one point; over SIMD lanes it differentiates several points at once.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dual<T, const N: usize> {
    /// The value.
    pub value: T,
    /// The derivative along each direction.
    pub derivative: [T; N],
}

/// Makes the array of `N` whose entry `i` is the expression.
///
/// A plain loop, because the closures that `array::from_fn` and `map` take are functions of their own:
/// they do not have the SIMD instructions of the caller, and are then called instead of inlined.
macro_rules! each {
    ($i:ident, $entry:expr) => {{
        let $i = 0;
        let mut entries: [T; N] = [$entry; N];
        for $i in 1..N {
            entries[$i] = $entry;
        }
        entries
    }};
}

impl<T: Scalar, const N: usize> Dual<T, N> {
    /// Returns a variable: `value`, with derivative one along `direction`.
    #[inline(always)]
    pub fn variable(value: T, direction: usize) -> Self {
        let derivative = each!(i, value.like(if i == direction { 1.0 } else { 0.0 }));
        Self { value, derivative }
    }

    /// Returns a number that does not vary.
    #[inline(always)]
    pub fn fixed(value: T) -> Self {
        Self { value, derivative: [value.like(0.0); N] }
    }

    /// Returns `value` with the derivatives of `self` times `slope`: the chain rule.
    #[inline(always)]
    fn chain(self, value: T, slope: T) -> Self {
        Self { value, derivative: each!(i, self.derivative[i] * slope) }
    }
}

impl<T: Scalar, const N: usize> Add for Dual<T, N> {
    type Output = Self;

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self {
            value: self.value + other.value,
            derivative: each!(i, self.derivative[i] + other.derivative[i]),
        }
    }
}

impl<T: Scalar, const N: usize> Sub for Dual<T, N> {
    type Output = Self;

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self {
            value: self.value - other.value,
            derivative: each!(i, self.derivative[i] - other.derivative[i]),
        }
    }
}

impl<T: Scalar, const N: usize> Mul for Dual<T, N> {
    type Output = Self;

    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        Self {
            value: self.value * other.value,
            derivative: each!(i, self.derivative[i].mul_add(other.value, self.value * other.derivative[i])),
        }
    }
}

impl<T: Scalar, const N: usize> Div for Dual<T, N> {
    type Output = Self;

    #[inline(always)]
    fn div(self, other: Self) -> Self {
        let inverse = other.value.like(1.0) / other.value;
        let value = self.value * inverse;
        Self { value, derivative: each!(i, (self.derivative[i] - value * other.derivative[i]) * inverse) }
    }
}

impl<T: Scalar, const N: usize> Neg for Dual<T, N> {
    type Output = Self;

    #[inline(always)]
    fn neg(self) -> Self {
        Self { value: -self.value, derivative: each!(i, -self.derivative[i]) }
    }
}

impl<T: Scalar, const N: usize> Scalar for Dual<T, N> {
    const LANES: usize = T::LANES;

    #[inline(always)]
    fn like(self, value: f64) -> Self {
        Self::fixed(self.value.like(value))
    }

    #[inline(always)]
    fn mul_add(self, factor: Self, summand: Self) -> Self {
        Self {
            value: self.value.mul_add(factor.value, summand.value),
            derivative: each!(i, {
                let by_factor = self.value.mul_add(factor.derivative[i], summand.derivative[i]);
                self.derivative[i].mul_add(factor.value, by_factor)
            }),
        }
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        let root = self.value.sqrt();
        self.chain(root, root.like(0.5) / root)
    }

    #[inline(always)]
    fn sin(self) -> Self {
        self.chain(self.value.sin(), self.value.cos())
    }

    #[inline(always)]
    fn cos(self) -> Self {
        self.chain(self.value.cos(), -self.value.sin())
    }

    #[inline(always)]
    fn atan2(self, x: Self) -> Self {
        // d atan2(y, x) = (x dy - y dx) / (x² + y²).
        let inverse = self.value.like(1.0) / self.value.mul_add(self.value, x.value * x.value);
        let (along_y, along_x) = (x.value * inverse, self.value * inverse);
        Self {
            value: self.value.atan2(x.value),
            derivative: each!(i, along_y * self.derivative[i] - along_x * x.derivative[i]),
        }
    }

    #[inline(always)]
    fn all_above(self, limit: f64) -> bool {
        self.value.all_above(limit)
    }

    #[inline(always)]
    fn select_below(self, limit: f64, if_below: Self, otherwise: Self) -> Self {
        Self {
            value: self.value.select_below(limit, if_below.value, otherwise.value),
            derivative: each!(
                i,
                self.value.select_below(limit, if_below.derivative[i], otherwise.derivative[i])
            ),
        }
    }

    #[inline(always)]
    fn lane(self, lane: usize) -> f64 {
        self.value.lane(lane)
    }

    #[inline(always)]
    fn with_lane(self, lane: usize, other: Self) -> Self {
        Self {
            value: self.value.with_lane(lane, other.value),
            derivative: each!(i, self.derivative[i].with_lane(lane, other.derivative[i])),
        }
    }

    #[inline(always)]
    fn scale(self, factor: f64) -> Self {
        self.chain(self.value.scale(factor), self.value.like(factor))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Checks the derivative of `f` at `at` against a central difference.
    fn check(f: impl Fn(Dual<f64, 1>) -> Dual<f64, 1>, at: f64) {
        let step = 1e-6;
        let derivative = f(Dual::variable(at, 0)).derivative[0];
        let difference = (f(Dual::fixed(at + step)).value - f(Dual::fixed(at - step)).value) / (2.0 * step);
        // A central difference with this step is good to about 1e-9 on values near one.
        assert!((derivative - difference).abs() < 1e-8, "{derivative} against {difference} at {at}");
    }

    #[test]
    fn derivatives_match_differences() {
        let c = Dual::<f64, 1>::fixed;
        for at in [0.3, 0.9, 1.7] {
            check(|x| x * x + c(2.0) * x, at);
            check(|x| c(1.0) / (x + c(0.5)), at);
            check(|x| x.sqrt(), at);
            check(|x| x.sin() * x.cos(), at);
            check(|x| x.atan2(c(0.7) - x), at);
            check(|x| -x.mul_add(x, x.scale(3.0)), at);
            check(|x| x.mul_add(x.sin(), x / c(3.0)), at);
            check(|x| x.select_below(1.0, x * x, x.scale(2.0)), at);
            check(|x| x.with_lane(0, x * x), at);
        }
    }
}
