//! The inner loop: `[J r]ᵀ [J r]` of pairs of rows, accumulated in registers.
//!
//! A pixel gives two rows, u and v. Rows of many points are held side by side, a SIMD lane each, in
//! chunks: one register per column. The columns come in blocks of four. All products are summed over
//! both rows, except that those with the first block are kept apart for u and v, because it holds the
//! columns in which the two rows mean different parameters (`fx` and `fy`, `cx` and `cy`).

use pulp::Simd;

use crate::lanes::MAX_LANES;

/// The number of columns in a block.
pub const BLOCK: usize = 4;

/// The number of products in a tile, which is a block times a block.
const TILE: usize = BLOCK * BLOCK;

/// Which of the two rows of a pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Row {
    /// The horizontal pixel coordinate.
    U,
    /// The vertical pixel coordinate.
    V,
}

/// The products of all pairs of columns, summed over rows.
#[derive(Clone, Debug, Default)]
pub struct PairGram {
    n_blocks: usize,
    /// Tiles of the first block for u, those for v, then the others by rows of the upper triangle.
    tiles: Vec<f64>,
}

/// Where in a tile the product of columns (r, c) lies, at `r * BLOCK + c`, after the transposing reduction of eight lanes.
const ORDER_OF_EIGHT_LANES: [u8; TILE] = [0, 8, 2, 10, 1, 9, 3, 11, 4, 12, 6, 14, 5, 13, 7, 15];

/// Where they lie when each is reduced by itself.
const ORDER_OF_ROWS: [u8; TILE] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15];

impl PairGram {
    /// Forgets all sums and takes `n_blocks` blocks of columns.
    pub fn reset(&mut self, n_blocks: usize) {
        self.n_blocks = n_blocks;
        self.tiles.clear();
        self.tiles.resize((2 * n_blocks + n_blocks * (n_blocks - 1) / 2) * TILE, 0.0);
    }

    /// Adds the products of the rows in `u` and `v`, each a sequence of chunks of `n_blocks` blocks.
    #[inline(always)]
    pub fn add<S: Simd>(&mut self, simd: S, u: &[[S::f64s; BLOCK]], v: &[[S::f64s; BLOCK]]) {
        let n_blocks = self.n_blocks;
        let (tiles, _) = self.tiles.as_chunks_mut::<TILE>();
        let mut tiles = tiles.iter_mut();
        for rows in [u, v] {
            for (tile, j) in (&mut tiles).take(n_blocks).zip(0..n_blocks) {
                add_tile(simd, [rows, &[]], n_blocks, 0, j, tile);
            }
        }
        for i in 1..n_blocks {
            for (tile, j) in (&mut tiles).take(n_blocks - i).zip(i..n_blocks) {
                add_tile(simd, [u, v], n_blocks, i, j, tile);
            }
        }
    }

    /// Returns all sums as they lie; see [`place`](Self::place).
    pub fn sums(&self) -> &[f64] {
        &self.tiles
    }

    /// Returns where in [`sums`](Self::sums) the products of columns `a` and `b` lie, over the rows `row`.
    ///
    /// A single row is known only where one of the columns is in the first block, and there it takes
    /// both rows to make the sum over both. The place depends on the number of lanes of the machine.
    pub fn place(n_blocks: usize, n_lanes: usize, row: Row, a: usize, b: usize) -> usize {
        let (a, b) = (a.min(b), a.max(b));
        let (i, j) = (a / BLOCK, b / BLOCK);
        let order = if n_lanes == MAX_LANES { &ORDER_OF_EIGHT_LANES } else { &ORDER_OF_ROWS };
        let tile = match (i, row) {
            (0, Row::U) => j,
            (0, Row::V) => n_blocks + j,
            // Rows 1..i of the upper triangle hold n-1, n-2, … tiles.
            _ => 2 * n_blocks + (i - 1) * n_blocks - i * (i - 1) / 2 + j - i,
        };
        tile * TILE + order[(a % BLOCK) * BLOCK + b % BLOCK] as usize
    }
}

/// Adds the products of block `i` with block `j`, with as many accumulators as the machine has room for.
#[inline(always)]
fn add_tile<S: Simd>(
    simd: S,
    families: [&[[S::f64s; BLOCK]]; 2],
    n_blocks: usize,
    i: usize,
    j: usize,
    tile: &mut [f64; TILE],
) {
    if S::REGISTER_COUNT >= 32 {
        let sums: [[S::f64s; BLOCK]; 4] = multiply(simd, families, n_blocks, i, j, 0);
        add_sums(simd, &sums, tile);
    } else {
        // Sixteen accumulators would spill where there are sixteen registers in all.
        let [a, b]: [[S::f64s; BLOCK]; 2] = multiply(simd, families, n_blocks, i, j, 0);
        let [c, d]: [[S::f64s; BLOCK]; 2] = multiply(simd, families, n_blocks, i, j, 2);
        add_sums(simd, &[a, b, c, d], tile);
    }
}

/// Returns the lane-wise products of columns `first..first + R` of block `i` with those of block `j`.
#[inline(always)]
fn multiply<S: Simd, const R: usize>(
    simd: S,
    families: [&[[S::f64s; BLOCK]]; 2],
    n_blocks: usize,
    i: usize,
    j: usize,
    first: usize,
) -> [[S::f64s; BLOCK]; R] {
    let mut sums = [[simd.splat_f64s(0.0); BLOCK]; R];
    for rows in families {
        for chunk in rows.chunks_exact(n_blocks) {
            let (a, b) = (&chunk[i], &chunk[j]);
            for r in 0..R {
                for c in 0..BLOCK {
                    sums[r][c] = simd.mul_add_f64s(a[first + r], b[c], sums[r][c]);
                }
            }
        }
    }
    sums
}

/// Reduces each of 4x4 registers to its sum and adds that to the tile.
#[inline(always)]
fn add_sums<S: Simd>(simd: S, sums: &[[S::f64s; BLOCK]; BLOCK], tile: &mut [f64; TILE]) {
    if S::F64_LANES == MAX_LANES {
        // The first transposition leaves two partial sums for each column, the second adds those:
        // 54 instructions where sixteen separate reductions take twice as many.
        // Plain loops here and elsewhere: a closure given to `map` is a function without the caller's
        // SIMD instructions, and is then called instead of inlined.
        let mut halves = sums[0];
        for r in 0..BLOCK {
            let [a, b, c, d] = simd.deinterleave_shfl_f64s(sums[r]);
            halves[r] = simd.add_f64s(simd.add_f64s(a, b), simd.add_f64s(c, d));
        }
        let [a, b, c, d] = simd.deinterleave_shfl_f64s(halves);
        // Whole registers: partial loads go through a table of masks.
        let (registers, _) = S::as_mut_simd_f64s(tile);
        registers[0] = simd.add_f64s(registers[0], simd.add_f64s(a, c));
        registers[1] = simd.add_f64s(registers[1], simd.add_f64s(b, d));
    } else {
        for (sums, tile) in sums.iter().zip(tile.chunks_exact_mut(BLOCK)) {
            for (&sum, tile) in sums.iter().zip(tile) {
                *tile += simd.reduce_sum_f64s(sum);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use pulp::{Arch, WithSimd};

    use super::*;

    /// Fills rows with arbitrary numbers and compares every product with the plain double loop.
    struct SameAsPlainLoop {
        n_blocks: usize,
        n_chunks: usize,
    }

    impl WithSimd for SameAsPlainLoop {
        type Output = ();

        fn with_simd<S: Simd>(self, simd: S) {
            let n_columns = self.n_blocks * BLOCK;
            let n_points = self.n_chunks * S::F64_LANES;
            let entry = |row: usize, point: usize, column: usize| {
                ((row * 7919 + point * 104_729 + column * 1_299_709) % 1013) as f64 / 1013.0 - 0.4
            };
            let rows = |row: usize| -> Vec<[S::f64s; BLOCK]> {
                let register = |chunk: usize, column: usize| {
                    let lanes: Vec<f64> =
                        (0..S::F64_LANES).map(|l| entry(row, chunk * S::F64_LANES + l, column)).collect();
                    simd.partial_load_f64s(&lanes)
                };
                let block = |k: usize| {
                    [0, 1, 2, 3].map(|c| register(k / self.n_blocks, k % self.n_blocks * BLOCK + c))
                };
                (0..self.n_chunks * self.n_blocks).map(block).collect()
            };
            let mut gram = PairGram::default();
            gram.reset(self.n_blocks);
            gram.add(simd, &rows(0), &rows(1));
            for a in 0..n_columns {
                for b in 0..n_columns {
                    let plain = |row| (0..n_points).map(|p| entry(row, p, a) * entry(row, p, b)).sum::<f64>();
                    let sum = |row| gram.sums()[PairGram::place(self.n_blocks, S::F64_LANES, row, a, b)];
                    // Sums of a hundred products near one are good to 1e-13.
                    if a.min(b) < BLOCK {
                        assert!((sum(Row::U) - plain(0)).abs() < 1e-11, "{a} {b}");
                        assert!((sum(Row::V) - plain(1)).abs() < 1e-11, "{a} {b}");
                    } else {
                        assert!((sum(Row::U) - plain(0) - plain(1)).abs() < 1e-11, "{a} {b}");
                    }
                }
            }
        }
    }

    #[test]
    fn products_match_the_plain_loop() {
        for n_blocks in 1..=6 {
            for n_chunks in [1, 2, 13] {
                Arch::new().dispatch(SameAsPlainLoop { n_blocks, n_chunks });
                SameAsPlainLoop { n_blocks, n_chunks }.with_simd(pulp::Scalar::new());
            }
        }
    }
}
