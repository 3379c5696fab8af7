//! Our LU against faer's, alone: the same dense matrices I − ρF, in turns, one thread each (ours on two as well).
//!
//! `cargo run --release -p catoptric-radiosity --features faer --example lu_against_faer`

use std::time::Instant;

use catoptric_radiosity::solver::{direct, direct_faer};
use faer::Mat;

/// Sizes, and how often each is timed; the best counts.
const SIZES: [(usize, usize); 4] = [(500, 20), (1000, 10), (2000, 5), (4000, 3)];
/// What the two solutions may differ by, of the largest: I − ρF has a condition number of at most (1 + ρ)/(1 − ρ) ≈ 20, and n
/// roundings of 1e-16 each leave at most 4000 × 20 × 1e-16.
const AGREE: f64 = 1e-11;

fn main() -> Result<(), Box<dyn std::error::Error + Send + Sync>> {
    let pool = |threads: usize| rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    let (one, two) = (pool(1)?, pool(2)?);
    println!("     n |    ours, 1 thread |   ours, 2 threads |    faer, 1 thread | largest difference");
    for (count, times) in SIZES {
        let rows = matrix(count);
        let right: Vec<f64> = (0..count).map(|i| if i % 7 == 3 { 1.0 } else { 0.0 }).collect();
        let ours = || {
            let (rows, right) = (rows.clone(), right.clone());
            let start = Instant::now();
            let found = direct::solve_dense(rows, right, &mut || true).unwrap_or_default();
            (start.elapsed().as_secs_f64(), found)
        };
        let theirs = || {
            let (matrix, right) = (Mat::from_fn(count, count, |i, j| rows[i][j]), right.clone());
            let start = Instant::now();
            let found = direct_faer::solve_dense(matrix, right);
            (start.elapsed().as_secs_f64(), found)
        };
        let mut best = [f64::INFINITY; 3];
        let mut worst = 0.0_f64;
        for _ in 0..times {
            let (runs, largest) = {
                let runs = [one.install(ours), two.install(ours), theirs()];
                let largest = runs[0].1.iter().copied().fold(0.0, f64::max);
                (runs, largest)
            };
            if runs[0].1 != runs[1].1 {
                return Err("other bits on two threads".into());
            }
            let off = runs[0].1.iter().zip(&runs[2].1).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            worst = worst.max(off / largest);
            for (best, run) in best.iter_mut().zip(&runs) {
                *best = best.min(run.0);
            }
        }
        let work = 2.0 / 3.0 * (count as f64).powi(3) / 1e9;
        let cells = best.map(|s| format!("{:7.1} ms {:4.1} G/s", 1e3 * s, work / s));
        println!("{count:6} | {} | {worst:.1e}", cells.join(" | "));
        if worst > AGREE {
            return Err(format!("n = {count}: the solutions differ by {worst:.1e}").into());
        }
    }
    Ok(())
}

/// I − ρF of a closed room of `count` patches: rows of F are positive, sum to one and are like no others; ρ is 0.5 to 0.9.
fn matrix(count: usize) -> Vec<Vec<f64>> {
    let mut state = 1_u64;
    let mut uniform = || {
        // Knuth's linear congruential generator, MMIX.
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 53) as f64
    };
    (0..count)
        .map(|i| {
            let reflectance = 0.5 + 0.4 * uniform();
            let mut row: Vec<f64> = (0..count).map(|j| if i == j { 0.0 } else { uniform() }).collect();
            let sum: f64 = row.iter().sum();
            row.iter_mut().for_each(|f| *f *= -reflectance / sum);
            row[i] += 1.0;
            row
        })
        .collect()
}
