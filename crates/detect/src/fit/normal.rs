//! The inner loop of a fit: the model at every pixel of a window, and the normal equations.
//!
//! A register holds as many pixels as there are lanes. The columns of the Jacobian are kept for a block of pixels, then
//! their products are summed, two columns with all that follow at a time: that many sums stay in registers.

use boresight_geometry::nalgebra::{SMatrix, SVector};
use pulp::{Arch, Simd, WithSimd};

use super::N;
use crate::lanes::{Lanes, MOST_LANES};

/// The most pixels of a window, in whole registers: what is looked at, and what is on the rim.
pub(super) const MOST_PIXELS: usize = 1664;
/// The unknowns, and the residual.
const COLUMNS: usize = N + 1;
/// The pixels whose columns are kept at a time: so many fit into the nearest cache.
const BLOCK: usize = 256;

/// The pixels of a window side by side: places and grey values, scaled.
pub(super) struct Pixels {
    pub u: [f32; MOST_PIXELS],
    pub v: [f32; MOST_PIXELS],
    pub grey: [f32; MOST_PIXELS],
    /// One for a pixel, zero behind the last.
    weight: [f32; MOST_PIXELS],
    columns: [f32; COLUMNS * BLOCK],
    pub count: usize,
}

/// `JᵀJ`, `Jᵀr` and `rᵀr` for residuals `model - seen`.
pub(super) struct Normal {
    pub matrix: SMatrix<f64, N, N>,
    pub gradient: SVector<f64, N>,
    pub cost: f64,
}

impl Pixels {
    pub fn none() -> Self {
        let zeros = [0.0; MOST_PIXELS];
        let columns = [0.0; COLUMNS * BLOCK];
        Self { u: zeros, v: zeros, grey: zeros, weight: zeros, columns, count: 0 }
    }

    /// Adds a pixel; what is more than there is room for is left out.
    #[inline]
    pub fn push(&mut self, u: f64, v: f64, grey: f64) {
        if self.count < MOST_PIXELS {
            self.u[self.count] = u as f32;
            self.v[self.count] = v as f32;
            self.grey[self.count] = grey as f32;
            self.weight[self.count] = 1.0;
            self.count += 1;
        }
    }

    /// Takes the mean off the grey values and divides them by their spread; returns both.
    pub fn normalise(&mut self) -> [f64; 2] {
        let n = self.count.max(1) as f64;
        let greys = &mut self.grey[..self.count];
        let mean = sum(greys, |grey| grey) / n;
        let spread = (sum(greys, |grey| (grey - mean).powi(2)) / n).sqrt();
        if spread > 0.0 {
            let scale = 1.0 / spread;
            greys.iter_mut().for_each(|grey| *grey = ((f64::from(*grey) - mean) * scale) as f32);
        }
        [mean, spread]
    }

    /// Returns the normal equations at `x`, for edges of these curvatures.
    pub fn normal_equations(&mut self, x: &SVector<f64, N>, curvatures: [f64; 2]) -> Normal {
        let mut sums = [[0.0; COLUMNS]; COLUMNS];
        let x = std::array::from_fn(|i| x[i]);
        Arch::new().dispatch(Sum { pixels: self, x, curvatures, sums: &mut sums });
        Normal {
            matrix: SMatrix::from_fn(|i, j| f64::from(sums[i.min(j)][i.max(j)])),
            gradient: SVector::from_fn(|i, _| f64::from(sums[i][N])),
            cost: f64::from(sums[N][N]),
        }
    }
}

/// Returns the sum of a function of numbers, in eight sums at a time that need not wait for each other.
fn sum(numbers: &[f32], of: impl Fn(f64) -> f64) -> f64 {
    let (eights, rest) = numbers.as_chunks::<8>();
    let mut sums = [0.0; 8];
    for eight in eights {
        for (sum, number) in sums.iter_mut().zip(eight) {
            *sum += of(f64::from(*number));
        }
    }
    sums.iter().sum::<f64>() + rest.iter().map(|number| of(f64::from(*number))).sum::<f64>()
}

/// Sums the products of all pairs of columns over the pixels; those above the diagonal are of use.
struct Sum<'a> {
    pixels: &'a mut Pixels,
    x: [f64; N],
    curvatures: [f64; 2],
    sums: &'a mut [[f32; COLUMNS]; COLUMNS],
}

impl WithSimd for Sum<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { pixels, x, curvatures, sums } = self;
        let formula = Formula::new(simd, &x, curvatures);
        let lanes = S::F32_LANES;
        let n_chunks = pixels.count.div_ceil(MOST_LANES) * MOST_LANES / lanes;
        let (u, _) = S::as_simd_f32s(&pixels.u);
        let (v, _) = S::as_simd_f32s(&pixels.v);
        let (grey, _) = S::as_simd_f32s(&pixels.grey);
        let (weight, _) = S::as_simd_f32s(&pixels.weight);
        let (columns, _) = S::as_mut_simd_f32s(&mut pixels.columns);
        let (columns, _) = columns.as_chunks_mut::<COLUMNS>();
        let zero = simd.splat_f32s(0.0);
        let mut products = [[zero; COLUMNS]; COLUMNS];
        let mut first = 0;
        while first < n_chunks {
            let end = n_chunks.min(first + BLOCK / lanes);
            for i in first..end {
                let pixel = [u[i], v[i], grey[i], weight[i]];
                formula.columns(simd, pixel, &mut columns[i - first]);
            }
            let block = &columns[..end - first];
            multiply::<S, 0, 10>(simd, block, &mut products);
            multiply::<S, 1, 9>(simd, block, &mut products);
            multiply::<S, 2, 8>(simd, block, &mut products);
            multiply::<S, 3, 7>(simd, block, &mut products);
            multiply::<S, 4, 6>(simd, block, &mut products);
            multiply::<S, 5, COLUMNS>(simd, block, &mut products);
            first = end;
        }
        for i in 0..COLUMNS {
            for j in i..COLUMNS {
                sums[i][j] = simd.reduce_sum_f32s(products[i][j]);
            }
        }
    }
}

/// Adds the products of columns `A` and `B` with themselves and those that follow.
#[inline(always)]
fn multiply<S: Simd, const A: usize, const B: usize>(
    simd: S,
    block: &[[S::f32s; COLUMNS]],
    products: &mut [[S::f32s; COLUMNS]; COLUMNS],
) {
    let (mut of_a, mut of_b) = (products[A], products[B.min(N)]);
    for columns in block {
        for j in A..COLUMNS {
            of_a[j] = simd.mul_add_f32s(columns[A], columns[j], of_a[j]);
        }
        for j in B..COLUMNS {
            of_b[j] = simd.mul_add_f32s(columns[B], columns[j], of_b[j]);
        }
    }
    products[A] = of_a;
    if B < COLUMNS {
        products[B] = of_b;
    }
}

/// The model and its derivatives, with what is the same for all pixels.
struct Formula<S: Simd> {
    x: [Lanes<S>; N],
    /// Sine and cosine of the edges' angles over their blurs, and the curvatures times these: lengths are in blurs.
    sin: [Lanes<S>; 2],
    cos: [Lanes<S>; 2],
    curvatures: [Lanes<S>; 2],
    /// The cosine of the angle between the edges, half its square, a sixth of its cube.
    powers: [Lanes<S>; 3],
    /// By how much that cosine grows with the direction of the second edge.
    turn: Lanes<S>,
}

impl<S: Simd> Formula<S> {
    #[inline(always)]
    fn new(simd: S, x: &[f64; N], curvatures: [f64; 2]) -> Self {
        let splat = Splat(simd);
        let [(sin1, cos1), (sin2, cos2)] = [x[2].sin_cos(), x[3].sin_cos()];
        // The square between the two steps is where d₁ and d₂ are positive; this is minus ρ.
        let cosine = sin1 * sin2 + cos1 * cos2;
        let blurs = [x[4].exp(), x[5].exp()];
        let zero = splat.of(0.0);
        let mut all = [zero; N];
        for i in 0..N {
            all[i] = splat.of(x[i]);
        }
        Self {
            x: all,
            sin: [splat.of(sin1 / blurs[0]), splat.of(sin2 / blurs[1])],
            cos: [splat.of(cos1 / blurs[0]), splat.of(cos2 / blurs[1])],
            curvatures: [splat.of(curvatures[0] * blurs[0]), splat.of(curvatures[1] * blurs[1])],
            powers: [splat.of(cosine), splat.of(0.5 * cosine * cosine), splat.of(cosine.powi(3) / 6.0)],
            turn: splat.of(sin1 * cos2 - cos1 * sin2),
        }
    }

    /// Evaluates the derivatives by the unknowns and the residual of some pixels: place, grey value and weight.
    #[inline(always)]
    fn columns(&self, simd: S, [u, v, grey, weight]: [S::f32s; 4], columns: &mut [S::f32s; COLUMNS]) {
        let [u, v, grey, weight] =
            [Lanes::new(simd, u), Lanes::new(simd, v), Lanes::new(simd, grey), Lanes::new(simd, weight)];
        let Self { x, sin, cos, curvatures, powers, turn } = *self;
        let (zero, one) = (x[0].like(0.0), x[0].like(1.0));
        let (dx, dy) = (u - x[0], v - x[1]);
        let along1 = dx.mul_add(cos[0], dy * sin[0]);
        let along2 = dx.mul_add(cos[1], dy * sin[1]);
        let h = dx.negate_mul_add(sin[0], dy * cos[0]);
        let h = (curvatures[0] * along1).negate_mul_add(along1, h);
        let k = dy.negate_mul_add(cos[1], dx * sin[1]);
        let k = (curvatures[1] * along2).mul_add(along2, k);
        let ([e1, p1], [e2, p2]) = (error_function(h), error_function(k));
        let (h2, k2) = (h.mul_add(h, zero - one), k.mul_add(k, zero - one));
        let (hk, h2k2) = (h * k, h2 * k2);
        // p is 2 φ, so the series' 4 φ φ is p p.
        let both = p1 * p2;
        let [c, half_c2, sixth_c3] = powers;
        let third_c3 = sixth_c3 + sixth_c3;
        let bracket = sixth_c3.negate_mul_add(h2k2, half_c2.mul_add(hk, zero - c));
        let model = e1.mul_add(e2, both * bracket);
        let scale = x[9] * weight;
        let by_h = third_c3.mul_add(k2, bracket).negate_mul_add(h, half_c2 * k);
        let by_h = scale * both.mul_add(by_h, p1 * e2);
        let by_k = third_c3.mul_add(h2, bracket).negate_mul_add(k, half_c2 * h);
        let by_k = scale * both.mul_add(by_k, p2 * e1);
        let by_c = scale * both * half_c2.negate_mul_add(h2k2, c.mul_add(hk, zero - one));
        let by_turn = by_c * turn;
        let residual = x[9].mul_add(model, x[8].mul_add(v, x[7].mul_add(u, x[6]))) - grey;
        *columns = [
            by_k.negate_mul_add(sin[1], by_h * sin[0]).value,
            by_h.negate_mul_add(cos[0], by_k * cos[1]).value,
            (zero - by_h.mul_add(along1, by_turn)).value,
            by_k.mul_add(along2, by_turn).value,
            (zero - by_h * h).value,
            (zero - by_k * k).value,
            weight.value,
            // Behind the last pixel, both places are zero.
            u.value,
            v.value,
            (weight * model).value,
            (weight * residual).value,
        ];
    }
}

#[derive(Clone, Copy)]
struct Splat<S: Simd>(S);

impl<S: Simd> Splat<S> {
    #[inline(always)]
    fn of(self, value: f64) -> Lanes<S> {
        Lanes::splat(self.0, value as f32)
    }
}

/// Returns erf(x/√2) and its derivative √(2/π) exp(-x²/2), both to 5e-7: the formula is good to 1.5e-7, single precision adds the rest.
///
/// Eq. 7.1.26 of Abramowitz & Stegun 1964; the exponential is the 16th power of a Taylor polynomial.
#[inline(always)]
fn error_function<S: Simd>(x: Lanes<S>) -> [Lanes<S>; 2] {
    let like = x;
    // Beyond six, the error function is one to nine digits.
    let size = x.abs().min(like.like(6.0));
    let z = size * size * like.like(-1.0 / 32.0);
    let mut power = z.mul_add(like.like(1.0 / 120.0), like.like(1.0 / 24.0));
    power = power.mul_add(z, like.like(1.0 / 6.0));
    power = power.mul_add(z, like.like(0.5));
    power = power.mul_add(z, like.like(1.0));
    power = power.mul_add(z, like.like(1.0));
    power = power * power;
    power = power * power;
    power = power * power;
    power = power * power;
    let t = like.like(1.0)
        / size.mul_add(like.like(0.327_591_1 * std::f32::consts::FRAC_1_SQRT_2), like.like(1.0));
    let mut rest = t.mul_add(like.like(1.061_405_4), like.like(-1.453_152));
    rest = rest.mul_add(t, like.like(1.421_413_7));
    rest = rest.mul_add(t, like.like(-0.284_496_74));
    rest = rest.mul_add(t, like.like(0.254_829_6));
    let value = (rest * t).negate_mul_add(power, like.like(1.0));
    // √(2/π)
    [value.signed_as(x), power * like.like(0.797_884_6)]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Evaluates the error function at some places.
    struct ErrorFunctions<'a>(&'a [f32; MOST_LANES]);

    impl WithSimd for ErrorFunctions<'_> {
        type Output = [[f32; 2]; MOST_LANES];

        fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
            let mut all = [[0.0; 2]; MOST_LANES];
            let (places, _) = S::as_simd_f32s(self.0);
            for (i, place) in places.iter().enumerate() {
                for (k, found) in error_function(Lanes::new(simd, *place)).iter().enumerate() {
                    let mut values = [0.0; MOST_LANES];
                    S::as_mut_simd_f32s(&mut values).0[0] = found.value;
                    for lane in 0..S::F32_LANES {
                        all[i * S::F32_LANES + lane][k] = values[lane];
                    }
                }
            }
            all
        }
    }

    #[test]
    fn the_error_function_is_one() {
        // erf(x/√2) to 16 digits, from Python's math.erf.
        let known = [
            (0.0, 0.0),
            (0.3, 0.23582284437790524),
            (1.0, 0.6826894921370859),
            (4.1, 0.9999586849861749),
            (50.0, 1.0),
        ];
        let mut places = [0.0; MOST_LANES];
        for (i, (x, _)) in known.iter().enumerate() {
            (places[2 * i], places[2 * i + 1]) = (*x, -x);
        }
        for values in
            [Arch::new().dispatch(ErrorFunctions(&places)), Arch::Scalar.dispatch(ErrorFunctions(&places))]
        {
            for (i, (x, expected)) in known.iter().enumerate() {
                let density = (2.0 / std::f64::consts::PI).sqrt() * (-0.5 * f64::from(x * x)).exp();
                for (value, sign) in [(values[2 * i], 1.0), (values[2 * i + 1], -1.0)] {
                    let [error, slope] = value.map(f64::from);
                    assert!((error - sign * expected).abs() < 5e-7, "{x}: {error}");
                    assert!((slope - density).abs() < 5e-7, "{x}: {slope}");
                }
            }
        }
    }

    #[test]
    fn derivatives_are_those_of_the_residuals() {
        // Two pixels: the gradient is the derivative of half the cost, by central differences.
        let mut pixels = Pixels::none();
        for i in 0..37 {
            let (u, v) = (f64::from(i % 7) - 3.2, f64::from(i / 7) - 2.9);
            pixels.push(u, v, (0.3 * u).sin() + 0.1 * v);
        }
        let x = SVector::from([0.2, -0.3, 0.1, 1.2, 0.3, 0.1, 0.05, 0.02, -0.03, 0.8]);
        let curvatures = [0.0, 0.0];
        let normal = pixels.normal_equations(&x, curvatures);
        for i in 0..N {
            let step = 2e-2;
            let mut cost = |by: f64| {
                let mut at = x;
                at[i] += by;
                pixels.normal_equations(&at, curvatures).cost
            };
            let differences = [step, 0.5 * step].map(|h| 0.5 * (cost(h) - cost(-h)) / (2.0 * h));
            // Richardson's extrapolation of two steps.
            let derivative = (4.0 * differences[1] - differences[0]) / 3.0;
            let size = normal.matrix[(i, i)].sqrt() * normal.cost.sqrt();
            assert!(
                (normal.gradient[i] - derivative).abs() < 1e-4 * size,
                "{i}: {} {derivative}",
                normal.gradient[i]
            );
        }
        let symmetric = normal.matrix - normal.matrix.transpose();
        assert!(symmetric.amax() == 0.0 && normal.matrix.cholesky().is_some());
    }
}
