//! Rows per second of every method, a dense sweep against the memory, and our LU: `solver_plots FOLDER throughput`.

use std::time::Instant;

use catoptric_radiosity::base_mesh::coarse_patches;
use catoptric_radiosity::method::{ElementSet, Method, MethodParams, prepare};
use catoptric_radiosity::solver::{Params, Solver, StoredRows, System, direct, solve_system};
use catoptric_trace::Tracer;

use crate::{Failure, SCENES, load};

/// Elements of the dense matrix: 256 MB, more than any cache keeps.
const DENSE: usize = 4_000;
const SWEEPS: usize = 8;
/// Elements of the matrix that is factorised.
const LU: usize = 2_000;
/// Patches that rows are found for, about.
const PATCHES: usize = 400;
/// Rows of each method are counted for at least so many seconds.
const SECONDS: f64 = 2.0;

pub(crate) fn measure() -> Result<(), Failure> {
    println!("one thread");
    memory_bandwidth();
    dense_sweep();
    lu();
    for name in SCENES {
        let scene = load(name)?;
        rows(name, &Tracer::new(&scene))?;
    }
    Ok(())
}

/// Reads 256 MB and says how fast: what a sweep over a stored matrix is held against.
pub(crate) fn memory_bandwidth() {
    let numbers: Vec<f64> = (0..32 << 20).map(f64::from).collect();
    let best = (0..5)
        .map(|_| {
            let start = Instant::now();
            let lanes = numbers.chunks_exact(16).fold([0.0; 16], |mut sums: [f64; 16], chunk| {
                sums.iter_mut().zip(chunk).for_each(|(s, x)| *s += x);
                sums
            });
            let seconds = start.elapsed().as_secs_f64();
            std::hint::black_box(lanes);
            (numbers.len() * size_of::<f64>()) as f64 / seconds
        })
        .fold(0.0, f64::max);
    println!("memory: {:.1} GB/s read by one thread", best / 1e9);
}

/// A row of a closed room in which all see all alike.
fn uniform(count: usize) -> Vec<Vec<f64>> {
    vec![vec![1.0 / count as f64; count]; count]
}

fn dense_sweep() {
    let rows = StoredRows::dense(&uniform(DENSE));
    let (reflectance, emission, weights) = (vec![0.5; DENSE], vec![1.0; DENSE], vec![1.0; DENSE]);
    let system = System { rows: &rows, reflectance: &reflectance, emission: &emission, weights: &weights };
    let params = Params { residual: 0.0, max_steps: SWEEPS, warm: None };
    let mut since = Instant::now();
    let mut best = f64::INFINITY;
    solve_system(Solver::GaussSeidel, &system, &params, &mut |_| {
        best = best.min(since.elapsed().as_secs_f64());
        since = Instant::now();
        true
    });
    let bytes = DENSE * DENSE * size_of::<(u32, f64)>();
    println!("Gauss-Seidel sweep, dense, {DENSE} elements: {:.1} GB/s", bytes as f64 / best / 1e9);
}

fn lu() {
    let mut matrix = uniform(LU);
    for (i, row) in matrix.iter_mut().enumerate() {
        row.iter_mut().for_each(|f| *f *= -0.5);
        row[i] += 1.0;
    }
    let best = (0..3)
        .map(|_| {
            let matrix = matrix.clone();
            let start = Instant::now();
            std::hint::black_box(direct::solve_dense(matrix, vec![1.0; LU], &mut || true));
            start.elapsed().as_secs_f64()
        })
        .fold(f64::INFINITY, f64::min);
    let work = 2.0 / 3.0 * (LU as f64).powi(3);
    println!("LU, {LU} elements: {:.0} ms, {:.1} GFLOP/s", 1e3 * best, work / best / 1e9);
}

/// With the settings of the coarse solve: 128 rays a row and what costs other methods no less.
fn rows(name: &str, tracer: &Tracer) -> Result<(), Failure> {
    let (draft, patches) = coarse_patches(tracer, PATCHES);
    let set = ElementSet::patches(tracer, &draft, &patches);
    println!("{name}, {} patches: rows per second", set.len());
    for method in Method::ALL {
        let rates = [true, false].map(|extended| -> Result<f64, Failure> {
            let rays = if method == Method::Area { 1 } else { 8 };
            let mut params = MethodParams {
                rays,
                resolution: 16,
                tolerance: 1e-3,
                max_cells: 16,
                ..MethodParams::default()
            };
            params.walk.extended = extended;
            let prepared = prepare(method, tracer, &set, &params)?;
            let start = Instant::now();
            let mut done = 0_usize;
            // Every 37th patch, round and round: a sample of all walls.
            while start.elapsed().as_secs_f64() < SECONDS {
                std::hint::black_box(prepared.row((done * 37 % set.len()) as u32));
                done += 1;
            }
            Ok(done as f64 / start.elapsed().as_secs_f64())
        });
        let [extended, plain] = rates;
        println!("{:>10}: {:.1} extended, {:.1} plain", method.name(), extended?, plain?);
    }
    Ok(())
}
