//! Normal numbers for tests, the same on every machine and in every run.

/// A sequence of normal numbers: xorshift64 of Marsaglia 2003 through Box and Muller 1958.
pub(crate) struct Normals(u64);

impl Normals {
    /// Returns the sequence of a seed.
    pub(crate) fn new(seed: u64) -> Self {
        let mut numbers = Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1);
        (0..20).for_each(|_| _ = numbers.uniform());
        numbers
    }

    /// Returns a number in [0, 1).
    pub(crate) fn uniform(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Returns a number of mean zero and variance one.
    pub(crate) fn next(&mut self) -> f64 {
        let (radius, angle) = (1.0 - self.uniform(), self.uniform());
        (-2.0 * radius.ln()).sqrt() * (std::f64::consts::TAU * angle).cos()
    }
}
