//! LU factorisation of I − ρF with partial pivoting, blocked, in f64 (Golub & Van Loan, alg. 3.4.1 and §3.2.11).
//!
//! The trailing rows of a block are updated in parallel, each by one thread in a fixed order of operations: the same bits
//! for any number of threads.

use rayon::prelude::*;

use super::{Solution, Step, Stop, System};

/// Columns of a block.
const BLOCK: usize = 48;

/// Solves by elimination.
pub fn solve(system: &System, watch: &mut dyn FnMut(&Step) -> bool) -> Solution {
    let count = system.len();
    let mut matrix: Vec<Vec<f64>> = (0..count)
        .map(|i| {
            let mut row = vec![0.0; count];
            system.rows.visit(i, &mut |j, f| row[j] -= system.reflectance[i] * f);
            row[i] += 1.0;
            row
        })
        .collect();
    let mut right = system.emission.to_vec();
    let mut goes_on = || watch(&Step { steps: 0, radiosity: &[], unshot: &[], ambient: 0.0 });
    if !factorise(&mut matrix, &mut right, &mut goes_on) {
        let radiosity = system.emission.to_vec();
        return Solution { radiosity, steps: 0, rows: count, residual: 1.0, stop: Stop::Watcher };
    }
    // L has been applied to the right side on the way; U is left.
    let mut radiosity = vec![0.0; count];
    for i in (0..count).rev() {
        let known: f64 = (i + 1..count).map(|j| matrix[i][j] * radiosity[j]).sum();
        radiosity[i] = (right[i] - known) / matrix[i][i];
    }
    watch(&Step { steps: 1, radiosity: &radiosity, unshot: &[], ambient: 0.0 });
    let residual = system.residual(&radiosity);
    Solution { radiosity, steps: 1, rows: 2 * count, residual, stop: Stop::Exact }
}

/// Brings `matrix` into LU form in place, and `right` along with it; false where `goes_on` said no between two blocks.
fn factorise(matrix: &mut [Vec<f64>], right: &mut [f64], goes_on: &mut dyn FnMut() -> bool) -> bool {
    let count = matrix.len();
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
                for j in k + 1..end {
                    row[j] -= factor * pivot_row[j];
                }
            }
        }
        // The block's own rows to the right of it: triangular solve with L.
        for i in start + 1..end {
            let (above, below) = matrix.split_at_mut(i);
            let row = &mut below[0];
            for k in start..i {
                let factor = row[k];
                for j in end..count {
                    row[j] -= factor * above[k][j];
                }
            }
        }
        // The rest.
        let (above, below) = matrix.split_at_mut(end);
        below.par_iter_mut().for_each(|row| {
            for k in start..end {
                let factor = row[k];
                for (value, pivot) in row[end..].iter_mut().zip(&above[k][end..]) {
                    *value -= factor * pivot;
                }
            }
        });
        start = end;
    }
    true
}
