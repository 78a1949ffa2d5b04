//! The inner loop: `[J r]ᵀ [J r]` of pairs of rows, accumulated in registers.
//!
//! A pixel gives two rows, u and v. Rows of many points are held side by side, a SIMD lane each, in
//! chunks: one register per column. The columns come in blocks of four. All products are summed over
//! both rows, except that those with the first block are kept apart for u and v, because it holds the
//! columns in which the two rows mean different parameters (`fx` and `fy`, `cx` and `cy`).

use pulp::{Simd, WithSimd};

use crate::aligned::Aligned;
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
    /// Tiles of the first block for u, those for v, then the others by rows of the upper triangle; then a zero.
    tiles: Aligned,
}

/// Where in a tile the product of columns (r, c) lies, at `r * BLOCK + c`, after the transposing reduction of eight lanes.
const ORDER_OF_EIGHT_LANES: [u8; TILE] = [0, 8, 2, 10, 1, 9, 3, 11, 4, 12, 6, 14, 5, 13, 7, 15];

/// Where they lie when each is reduced by itself.
const ORDER_OF_ROWS: [u8; TILE] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15];

impl PairGram {
    /// Returns the number of sums over rows of `n_columns`.
    pub fn sum_count(n_columns: usize) -> usize {
        let n_blocks = n_columns.div_ceil(BLOCK);
        (2 * n_blocks + n_blocks * (n_blocks - 1) / 2) * TILE
    }

    /// Makes all sums over rows of `n_columns` zero.
    pub fn clear(&mut self, n_columns: usize) {
        self.tiles.make_room(Self::sum_count(n_columns) + 1);
        self.tiles.fill(0.0);
    }

    /// Makes the sums those over the rows in `u` and `v`, or adds them to what is there.
    ///
    /// Rows are sequences of chunks, each of a register for each column and as many idle ones as fill
    /// the last block.
    #[inline(always)]
    pub fn sum<S: Simd>(&mut self, simd: S, n_columns: usize, u: &[f64], v: &[f64], previous: Previous) {
        let n_sums = Self::sum_count(n_columns);
        self.tiles.make_room(n_sums + 1);
        self.tiles[n_sums] = 0.0;
        // A function of its own, whose code is there once and not in every caller.
        simd.vectorize(Sum { n_columns, u, v, previous, tiles: &mut self.tiles });
    }

    /// Returns all sums as they lie, see [`place`](Self::place), and after them a zero.
    pub fn sums(&self) -> &[f64] {
        &self.tiles
    }

    /// Returns where in [`sums`](Self::sums) the products of columns `a` and `b` lie, over the rows `row`.
    ///
    /// A single row is known only where one of the columns is in the first block, and there it takes
    /// both rows to make the sum over both. The place depends on the number of lanes of the machine.
    pub fn place(n_columns: usize, n_lanes: usize, row: Row, a: usize, b: usize) -> usize {
        let n_blocks = n_columns.div_ceil(BLOCK);
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

/// What becomes of the sums that are there already.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Previous {
    /// They are added to.
    Kept,
    /// They are forgotten.
    Forgotten,
}

/// Sums the products of some rows.
struct Sum<'a> {
    n_columns: usize,
    u: &'a [f64],
    v: &'a [f64],
    previous: Previous,
    tiles: &'a mut [f64],
}

impl WithSimd for Sum<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { n_columns, u, v, previous, tiles: sums } = self;
        let ((u, _), (v, _)) = (S::as_simd_f64s(u), S::as_simd_f64s(v));
        let tiles = Tiles { n_blocks: n_columns.div_ceil(BLOCK), previous };
        // The last block of columns may be narrow; its width is a constant of the code.
        match (n_columns - 1) % BLOCK {
            0 => tiles.sum::<S, 1>(simd, u, v, sums),
            1 => tiles.sum::<S, 2>(simd, u, v, sums),
            2 => tiles.sum::<S, 3>(simd, u, v, sums),
            _ => tiles.sum::<S, BLOCK>(simd, u, v, sums),
        }
    }
}

/// The tiles of a matrix of products.
#[derive(Clone, Copy)]
struct Tiles {
    n_blocks: usize,
    previous: Previous,
}

impl Tiles {
    /// Sums all tiles; the last block has `LAST` columns.
    #[inline(always)]
    fn sum<S: Simd, const LAST: usize>(self, simd: S, u: &[S::f64s], v: &[S::f64s], tiles: &mut [f64]) {
        let (u, _) = u.as_chunks::<BLOCK>();
        let (v, _) = v.as_chunks::<BLOCK>();
        let (tiles, _) = tiles.as_chunks_mut::<TILE>();
        let mut tiles = tiles.iter_mut();
        for rows in [u, v] {
            self.row::<S, LAST>(simd, [rows, &[]], 0, &mut tiles);
        }
        for i in 1..self.n_blocks {
            self.row::<S, LAST>(simd, [u, v], i, &mut tiles);
        }
    }

    /// Sums the tiles of block `i` with itself and those after it.
    #[inline(always)]
    fn row<'t, S: Simd, const LAST: usize>(
        self,
        simd: S,
        families: [&[[S::f64s; BLOCK]]; 2],
        i: usize,
        tiles: &mut impl Iterator<Item = &'t mut [f64; TILE]>,
    ) {
        let last = self.n_blocks - 1;
        for j in i..=last {
            let Some(tile) = tiles.next() else { return };
            match (i == j, j == last) {
                (false, false) => self.tile::<S, BLOCK, false>(simd, families, i, j, tile),
                (false, true) => self.tile::<S, LAST, false>(simd, families, i, j, tile),
                (true, false) => self.tile::<S, BLOCK, true>(simd, families, i, j, tile),
                (true, true) => self.tile::<S, LAST, true>(simd, families, i, j, tile),
            }
        }
    }

    /// Sums the products of block `i` with `C` columns of block `j`, with as many accumulators as the
    /// machine has room for; below the diagonal of a `DIAGONAL` tile nothing is multiplied.
    #[inline(always)]
    fn tile<S: Simd, const C: usize, const DIAGONAL: bool>(
        self,
        simd: S,
        families: [&[[S::f64s; BLOCK]]; 2],
        i: usize,
        j: usize,
        tile: &mut [f64; TILE],
    ) {
        let n_blocks = self.n_blocks;
        let zero = simd.splat_f64s(0.0);
        let mut sums = [[zero; BLOCK]; BLOCK];
        if S::REGISTER_COUNT >= 32 {
            for rows in families {
                multiply::<S, C, 0, BLOCK, DIAGONAL>(simd, rows, n_blocks, i, j, &mut sums);
            }
        } else {
            // Sixteen accumulators would spill where there are sixteen registers in all.
            for rows in families {
                multiply::<S, C, 0, 2, DIAGONAL>(simd, rows, n_blocks, i, j, &mut sums);
            }
            for rows in families {
                multiply::<S, C, 2, BLOCK, DIAGONAL>(simd, rows, n_blocks, i, j, &mut sums);
            }
        }
        reduce(simd, &sums, self.previous, tile);
    }
}

/// Adds the lane-wise products of columns `FIRST..END` of block `i` with `C` columns of block `j`.
#[inline(always)]
fn multiply<S: Simd, const C: usize, const FIRST: usize, const END: usize, const DIAGONAL: bool>(
    simd: S,
    rows: &[[S::f64s; BLOCK]],
    n_blocks: usize,
    i: usize,
    j: usize,
    sums: &mut [[S::f64s; BLOCK]; BLOCK],
) {
    for chunk in rows.chunks_exact(n_blocks) {
        let (a, b) = (&chunk[i], &chunk[j]);
        for r in FIRST..END {
            if DIAGONAL && r >= C {
                break;
            }
            for c in 0..C {
                if !DIAGONAL || c >= r {
                    sums[r][c] = simd.mul_add_f64s(a[r], b[c], sums[r][c]);
                }
            }
        }
    }
}

/// Reduces each of 4x4 registers to its sum and puts it in the tile.
#[inline(always)]
fn reduce<S: Simd>(simd: S, sums: &[[S::f64s; BLOCK]; BLOCK], previous: Previous, tile: &mut [f64; TILE]) {
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
        let mut found = [simd.add_f64s(a, c), simd.add_f64s(b, d)];
        // Whole registers: partial loads go through a table of masks.
        let (registers, _) = S::as_mut_simd_f64s(tile);
        if previous == Previous::Kept {
            found = [simd.add_f64s(registers[0], found[0]), simd.add_f64s(registers[1], found[1])];
        }
        registers[..2].copy_from_slice(&found);
    } else {
        for (sums, tile) in sums.iter().zip(tile.chunks_exact_mut(BLOCK)) {
            for (&sum, tile) in sums.iter().zip(tile) {
                let before = if previous == Previous::Kept { *tile } else { 0.0 };
                *tile = before + simd.reduce_sum_f64s(sum);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use pulp::Arch;

    use super::*;

    /// Fills rows with arbitrary numbers and compares every product with the plain double loop.
    struct SameAsPlainLoop {
        n_columns: usize,
        n_chunks: usize,
    }

    impl WithSimd for SameAsPlainLoop {
        type Output = ();

        fn with_simd<S: Simd>(self, simd: S) {
            let n_columns = self.n_columns;
            let n_blocks = n_columns.div_ceil(BLOCK);
            let n_points = self.n_chunks * S::F64_LANES;
            let entry = |row: usize, point: usize, column: usize| {
                ((row * 7919 + point * 104_729 + column * 1_299_709) % 1013) as f64 / 1013.0 - 0.4
            };
            let rows = |row: usize| -> Vec<f64> {
                let register = |chunk: usize, column: usize| {
                    (0..S::F64_LANES).map(move |l| entry(row, chunk * S::F64_LANES + l, column))
                };
                // What stands in idle columns does not matter.
                let stride = n_blocks * BLOCK;
                (0..self.n_chunks * stride).flat_map(|k| register(k / stride, k % stride)).collect()
            };
            let (u, v) = (rows(0), rows(1));
            let mut gram = PairGram::default();
            // The second time in two parts.
            gram.sum(simd, n_columns, &u, &v, Previous::Forgotten);
            let cut = self.n_chunks / 2 * n_blocks * BLOCK * S::F64_LANES;
            gram.sum(simd, n_columns, &u[..cut], &v[..cut], Previous::Forgotten);
            gram.sum(simd, n_columns, &u[cut..], &v[cut..], Previous::Kept);
            for a in 0..n_columns {
                for b in 0..n_columns {
                    let plain = |row| (0..n_points).map(|p| entry(row, p, a) * entry(row, p, b)).sum::<f64>();
                    let sum = |row| gram.sums()[PairGram::place(n_columns, S::F64_LANES, row, a, b)];
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
        for n_columns in 1..=22 {
            for n_chunks in [1, 2, 13] {
                Arch::new().dispatch(SameAsPlainLoop { n_columns, n_chunks });
                SameAsPlainLoop { n_columns, n_chunks }.with_simd(pulp::Scalar::new());
            }
        }
    }
}
