//! LU factorisation of I − ρF with partial pivoting, blocked, in f64 (Golub & Van Loan 2013, alg. 3.4.1 and §3.2.11).
//!
//! The trailing rows of a block are updated in parallel, each by one thread. A tile of a few rows and columns stays in
//! registers while all pivot rows of the block are subtracted from it, one after another (Goto & van de Geijn 2008): every entry
//! sees the same operations in the same order whatever the number of threads, and products are fused into sums on every
//! processor (IEEE 754 fusedMultiplyAdd), so that the width of the vectors does not matter either.

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use super::{Solution, Step, Stop, System};

/// Columns of a block.
const BLOCK: usize = 48;
/// Rows of a tile: with two vectors in each, a part of a pivot row and a factor they fill the sixteen registers of AVX2.
const ROWS: usize = 6;
/// Columns of a tile: two vectors of the widest kind.
const LANES: usize = 16;

/// Solves by elimination.
pub fn solve(system: &System, watch: &mut dyn FnMut(&Step) -> bool) -> Solution {
    let count = system.len();
    let matrix: Vec<Vec<f64>> = (0..count)
        .map(|i| {
            let mut row = vec![0.0; count];
            visit_row(system, i, &mut |j, value| row[j] += value);
            row
        })
        .collect();
    let mut goes_on = || watch(&Step { steps: 0, radiosity: &[], unshot: &[], ambient: 0.0 });
    match solve_dense(matrix, system.emission.to_vec(), &mut goes_on) {
        Some(radiosity) => finished(system, radiosity, watch),
        None => stopped(system),
    }
}

/// Visits the entries of a row of I − ρF; those that are visited twice add up.
pub(super) fn visit_row(system: &System, row: usize, visit: &mut dyn FnMut(usize, f64)) {
    system.rows.visit(row, &mut |j, factor| visit(j, -system.reflectance[row] * factor));
    visit(row, 1.0);
}

/// An answer, with its residual.
pub(super) fn finished(
    system: &System,
    radiosity: Vec<f64>,
    watch: &mut dyn FnMut(&Step) -> bool,
) -> Solution {
    watch(&Step { steps: 1, radiosity: &radiosity, unshot: &[], ambient: 0.0 });
    let residual = system.residual(&radiosity);
    Solution { radiosity, steps: 1, rows: 2 * system.len(), residual, stop: Stop::Exact }
}

/// No answer: whoever watched did not wait for it.
pub(super) fn stopped(system: &System) -> Solution {
    let radiosity = system.emission.to_vec();
    Solution { radiosity, steps: 0, rows: system.len(), residual: 1.0, stop: Stop::Watcher }
}

/// The solution of a dense system; none where `goes_on` said no between two blocks.
pub fn solve_dense(
    mut matrix: Vec<Vec<f64>>,
    mut right: Vec<f64>,
    goes_on: &mut dyn FnMut() -> bool,
) -> Option<Vec<f64>> {
    let count = right.len();
    if !factorise(&mut matrix, &mut right, goes_on) {
        return None;
    }
    // L has been applied to the right side on the way; U is left.
    let mut found = vec![0.0; count];
    for i in (0..count).rev() {
        let known: f64 = (i + 1..count).map(|j| matrix[i][j] * found[j]).sum();
        found[i] = (right[i] - known) / matrix[i][i];
    }
    Some(found)
}

/// Brings `matrix` into LU form in place, and `right` along with it; false where `goes_on` said no between two blocks.
fn factorise(matrix: &mut [Vec<f64>], right: &mut [f64], goes_on: &mut dyn FnMut() -> bool) -> bool {
    let count = matrix.len();
    let arch = Arch::new();
    let mut start = 0;
    while start < count {
        if !goes_on() {
            return false;
        }
        let end = (start + BLOCK).min(count);
        // The panel: eliminate within the block's columns, for all rows below.
        for k in start..end {
            let pivot =
                (k..count).fold(k, |b, i| if matrix[i][k].abs() > matrix[b][k].abs() { i } else { b });
            matrix.swap(k, pivot);
            right.swap(k, pivot);
            let (above, below) = matrix.split_at_mut(k + 1);
            let pivot_row = &above[k];
            let right_k = right[k];
            for (row, right_i) in below.iter_mut().zip(&mut right[k + 1..]) {
                let factor = row[k] / pivot_row[k];
                row[k] = factor;
                *right_i -= factor * right_k;
                for (value, pivot) in row[k + 1..end].iter_mut().zip(&pivot_row[k + 1..end]) {
                    *value -= factor * pivot;
                }
            }
        }
        // The block's own rows to the right of it: triangular solve with L.
        for i in start + 1..end {
            let (above, below) = matrix.split_at_mut(i);
            let row = &mut below[0];
            for k in start..i {
                let factor = row[k];
                for (value, pivot) in row[end..].iter_mut().zip(&above[k][end..]) {
                    *value -= factor * pivot;
                }
            }
        }
        // The rest.
        let (above, below) = matrix.split_at_mut(end);
        let pivots = packed(&above[start..], end);
        below.par_chunks_mut(ROWS).for_each(|rows| {
            arch.dispatch(Update { rows, pivots: &pivots, start, end });
        });
        start = end;
    }
    true
}

/// The pivot rows from a column on: tile after tile, in each row after row.
fn packed(rows: &[Vec<f64>], from: usize) -> Vec<[f64; LANES]> {
    let count = rows.first().map_or(0, Vec::len);
    let mut tiles = Vec::with_capacity(rows.len() * count.saturating_sub(from).div_ceil(LANES));
    for left in (from..count).step_by(LANES) {
        let width = LANES.min(count - left);
        tiles.extend(rows.iter().map(|row| {
            let mut lanes = [0.0; LANES];
            lanes[..width].copy_from_slice(&row[left..left + width]);
            lanes
        }));
    }
    tiles
}

/// Subtracts from a few rows their factors (columns `start..end`) times the pivot rows.
struct Update<'a> {
    rows: &'a mut [Vec<f64>],
    pivots: &'a [[f64; LANES]],
    start: usize,
    end: usize,
}

impl WithSimd for Update<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { rows, pivots, start, end } = self;
        let mut factors = [[0.0; ROWS]; BLOCK];
        for (r, row) in rows.iter().enumerate() {
            for (factors, factor) in factors.iter_mut().zip(&row[start..end]) {
                factors[r] = -factor;
            }
        }
        let mut values = [[0.0; LANES]; ROWS];
        for (tile, pivots) in pivots.chunks_exact(end - start).enumerate() {
            let left = end + tile * LANES;
            let width = LANES.min(rows[0].len() - left);
            for (values, row) in values.iter_mut().zip(rows.iter()) {
                values[..width].copy_from_slice(&row[left..left + width]);
            }
            for pair in 0..LANES / (2 * S::F64_LANES) {
                let mut sums = [[simd.splat_f64s(0.0); 2]; ROWS];
                for (sums, values) in sums.iter_mut().zip(&values) {
                    sums.copy_from_slice(&S::as_simd_f64s(values).0[2 * pair..2 * pair + 2]);
                }
                for (pivot, factors) in pivots.iter().zip(&factors) {
                    let pivot = &S::as_simd_f64s(pivot).0[2 * pair..2 * pair + 2];
                    for (sums, factor) in sums.iter_mut().zip(factors) {
                        let factor = simd.splat_f64s(*factor);
                        sums[0] = simd.mul_add_f64s(factor, pivot[0], sums[0]);
                        sums[1] = simd.mul_add_f64s(factor, pivot[1], sums[1]);
                    }
                }
                for (sums, values) in sums.iter().zip(&mut values) {
                    S::as_mut_simd_f64s(values).0[2 * pair..2 * pair + 2].copy_from_slice(sums);
                }
            }
            for (values, row) in values.iter().zip(rows.iter_mut()) {
                row[left..left + width].copy_from_slice(&values[..width]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pulp::{Scalar, Scalar256b, Scalar512b};

    #[test]
    fn vectors_of_every_width_give_the_same_bits() {
        let (start, end, count) = (5, 5 + BLOCK, 5 + BLOCK + 3 * LANES + 7);
        let entry = |i: usize, j: usize| 1.0 / (1.0 + ((i * 31 + j * 17) % 97) as f64);
        let row = |i: usize| -> Vec<f64> { (0..count).map(|j| entry(i, j)).collect() };
        let above: Vec<Vec<f64>> = (start..end).map(row).collect();
        let pivots = packed(&above, end);
        let updated = |work: &dyn Fn(Update)| {
            let mut rows: Vec<Vec<f64>> = (end..end + ROWS).map(row).collect();
            work(Update { rows: &mut rows, pivots: &pivots, start, end });
            rows
        };
        let ours = updated(&|update| Arch::new().dispatch(update));
        assert_eq!(ours, updated(&|update| update.with_simd(Scalar)), "one lane");
        assert_eq!(ours, updated(&|update| update.with_simd(Scalar256b)), "four lanes");
        assert_eq!(ours, updated(&|update| update.with_simd(Scalar512b)), "eight lanes");
        // And what they give is right: fused or not, 48 roundings of numbers below 1 differ by less than 48 × 1e-16.
        for (i, found) in (end..).zip(&ours) {
            for j in end..count {
                let product: f64 = (start..end).map(|k| entry(i, k) * entry(k, j)).sum();
                assert!((found[j] - (entry(i, j) - product)).abs() < 1e-13, "{i} {j}");
            }
        }
    }
}
