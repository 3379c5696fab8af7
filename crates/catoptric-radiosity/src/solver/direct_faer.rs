//! LU of I − ρF by faer, a library tuned for it: what [`super::direct`] is held against, and a faster choice for thousands of patches.
//!
//! Compiled with the feature `faer` only, since that takes minutes. It runs on one thread, so that the number of threads cannot matter.
//! faer chooses its kernels by the instructions of the processor and fuses products into sums: other processors, other
//! last bits. That is why `direct` stays our own.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::lu::partial_pivoting::{factor, solve as substitution};
use faer::{Mat, MatMut, Par};

use super::direct::{finished, stopped, visit_row};
use super::{Solution, Step, System};

/// Solves by elimination. It can be stopped before it and not on the way.
pub fn solve(system: &System, watch: &mut dyn FnMut(&Step) -> bool) -> Solution {
    let count = system.len();
    let mut goes_on = || watch(&Step { steps: 0, radiosity: &[], unshot: &[], ambient: 0.0 });
    if !goes_on() {
        return stopped(system);
    }
    let mut matrix = Mat::<f64>::zeros(count, count);
    for i in 0..count {
        visit_row(system, i, &mut |j, value| matrix[(i, j)] += value);
    }
    if !goes_on() {
        return stopped(system);
    }
    let radiosity = solve_dense(matrix, system.emission.to_vec());
    finished(system, radiosity, watch)
}

/// The solution of a dense system.
pub fn solve_dense(mut matrix: Mat<f64>, mut right: Vec<f64>) -> Vec<f64> {
    let count = right.len();
    let (mut order, mut back) = (vec![0_usize; count], vec![0_usize; count]);
    let needed = factor::lu_in_place_scratch::<usize, f64>(count, count, Par::Seq, Default::default());
    let mut buffer = MemBuffer::new(needed);
    let (_, order) = factor::lu_in_place(
        matrix.as_mut(),
        &mut order,
        &mut back,
        Par::Seq,
        MemStack::new(&mut buffer),
        Default::default(),
    );
    let needed = substitution::solve_in_place_scratch::<usize, f64>(count, 1, Par::Seq);
    let mut buffer = MemBuffer::new(needed);
    let column = MatMut::from_column_major_slice_mut(&mut right, count, 1);
    // L below the diagonal, U on it and above.
    let both = matrix.as_ref();
    substitution::solve_in_place(both, both, order, column, Par::Seq, MemStack::new(&mut buffer));
    right
}
