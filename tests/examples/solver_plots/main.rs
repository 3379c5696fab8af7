//! Measures every solver and form factor method on a room and on a mirror room and draws the plots of docs/solvers.md.
//!
//! `cargo run --release -p catoptric-tests --example solver_plots -- docs/images`; with `plaid` behind it, only the
//! picture of the hemicube's error, with `throughput` only rows, bytes and operations per second, without a plot.

mod plaid;
mod plot;
mod throughput;

use std::path::Path;
use std::time::Instant;

use catoptric_light::irradiance::Scratch;
use catoptric_light::{LightParams, Lights};
use catoptric_radiosity::base_mesh::coarse_patches;
use catoptric_radiosity::method::{
    ElementSet, FactorMatrix, FormFactors, Method, MethodParams, factors, prepare,
};
use catoptric_radiosity::patch::PatchId;
use catoptric_radiosity::solver::{Params, Solver, StoredRows, System, solve_system};
use catoptric_scene::Rgb;
use catoptric_scene::{Scene, Silent, gltf};
use catoptric_trace::Tracer;
use catoptric_trace::sequence::{Key, Purpose};
use plot::{Curve, Panel};

const SCENES: [&str; 2] = ["cornell_box", "cornell_mirror"];
/// Patches of the rooms that solvers are compared on, about.
const PATCHES: usize = 800;
/// Points of a patch at which the lamps' light is looked at.
const POINTS: u32 = 8;
/// Error at which a curve ends, relative to the power of the solution.
const END: f64 = 1e-6;

type Failure = Box<dyn std::error::Error + Send + Sync>;

fn main() -> Result<(), Failure> {
    let folder = std::env::args().nth(1).ok_or("usage: solver_plots FOLDER [plaid|throughput]")?;
    let only = std::env::args().nth(2).unwrap_or_default();
    let threads = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    if only == "throughput" {
        return threads.install(throughput::measure);
    }
    let (picture, deviations) = plaid::svg();
    std::fs::write(Path::new(&folder).join("hemicube-plaid.svg"), picture)?;
    let [alike, turned] = deviations.map(|d| 100.0 * d);
    println!("hemicube of {} cells: {alike:.2} % turned alike, {turned:.2} % by chance", plaid::RESOLUTION);
    if only == "plaid" {
        return Ok(());
    }
    threads.install(|| -> Result<(), Failure> {
        println!("one thread");
        throughput::memory_bandwidth();
        for name in SCENES {
            let scene = load(name)?;
            let tracer = Tracer::new(&scene);
            println!("\n{name}");
            let solvers = compare_solvers(&tracer)?;
            std::fs::write(Path::new(&folder).join(format!("solvers-{name}.svg")), plot::svg(&solvers))?;
            let methods = compare_methods(&tracer)?;
            std::fs::write(Path::new(&folder).join(format!("methods-{name}.svg")), plot::svg(&[methods]))?;
        }
        println!("\nrows of 1024 rays, extended against plain");
        for name in ["cornell_mirror", "two_mirrors", "mirror_corner", "facing_mirrors", "mirror_light_shaft"]
        {
            let scene = load(name)?;
            mirrors_cost(name, &Tracer::new(&scene))?;
        }
        Ok(())
    })
}

fn load(name: &str) -> Result<Scene, Failure> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../scenes/{name}.glb"));
    Ok(gltf::load(&path, &gltf::LoadOptions::default()).map_err(|e| e.to_string())?.scene)
}

/// Error against time, steps and rows, for every solver.
fn compare_solvers(tracer: &Tracer) -> Result<Vec<Panel>, Failure> {
    let (draft, patches) = coarse_patches(tracer, PATCHES);
    let set = ElementSet::patches(tracer, &draft, &patches);
    let weights = FactorMatrix::weights(tracer, &set);
    let params = MethodParams { rays: 64, ..MethodParams::default() };
    let method = prepare(Method::Rays, tracer, &set, &params)?;
    let mut matrix = factors(method.as_ref(), &set, &Silent).map_err(|e| e.to_string())?;
    let repair = matrix.repair(&weights, &vec![glam::DVec3::ONE; set.len()], false);
    println!("{} patches, made reciprocal by {:.1} % of F", set.len(), 100.0 * repair.mean);
    let rows = StoredRows::channel(&matrix, 1);
    let reflectance: Vec<f64> = patches.reflectances.iter().map(|r| f64::from(r.y)).collect();
    // What lamps send to each patch, once reflected: where the coarse solve of the program starts.
    let lights = Lights::new(tracer, LightParams::default());
    let mut scratch = Scratch::default();
    let emission: Vec<f64> = (0..patches.len() as u32)
        .map(|i| {
            let key = Key::new(0, Purpose::Emitter, u64::from(i));
            let sent: f32 = (0..POINTS)
                .map(|k| {
                    let receiver = patches.receiver(tracer, &draft, PatchId(i), key, k);
                    let direct = lights.direct(&receiver, 16, key.child(k), &mut scratch).irradiance;
                    let mirrored =
                        lights.mirrored(&receiver, 16, Rgb::ZERO, key.child(k), &mut scratch).irradiance;
                    (direct + mirrored).y
                })
                .sum();
            f64::from(patches.reflectances[i as usize].y * sent) / f64::from(POINTS)
        })
        .collect();
    let system = System { rows: &rows, reflectance: &reflectance, emission: &emission, weights: &weights };
    sweep_speed(&system, &matrix);

    let start = Instant::now();
    let exact = solve_system(Solver::Direct, &system, &Params::default(), &mut |_| true).radiosity;
    let direct = start.elapsed().as_secs_f64();
    let n = set.len() as f64;
    println!("direct: {:.1} ms, {:.2} GFLOP/s", 1e3 * direct, 2.0 / 3.0 * n.powi(3) / direct / 1e9);
    let scale: f64 = exact.iter().zip(&weights).map(|(b, w)| b * w).sum();
    let off = |radiosity: &[f64], ambient: f64| -> f64 {
        let parts = radiosity.iter().zip(&exact).zip(&reflectance).zip(&weights);
        parts.map(|(((b, e), r), w)| (b + r * ambient - e).abs() * w).sum::<f64>() / scale
    };
    let mut panels = [
        Panel::new("milliseconds on a stored matrix", "error of B, share of the power"),
        Panel::new("steps (sweeps; rows shot)", ""),
        Panel::new("form factor rows asked for", ""),
    ];
    panels[0].points.push(("direct".to_owned(), (1e3 * direct, END)));
    for solver in Solver::ALL.into_iter().filter(|s| !s.is_dense()) {
        let gatherer = matches!(solver, Solver::Jacobi | Solver::GaussSeidel);
        let mut curves: Vec<[Curve; 3]> = vec![std::array::from_fn(|_| Curve::new(solver.name()))];
        if solver == Solver::Progressive {
            curves.push(std::array::from_fn(|_| Curve::new("progressive + ambient")));
        }
        // Errors are measured with the clock stopped.
        let (mut spent, mut next, mut since) = (0.0, 1.0, Instant::now());
        solve_system(solver, &system, &Params { residual: 0.0, ..Params::default() }, &mut |step| {
            spent += since.elapsed().as_secs_f64();
            let mut goes_on = true;
            if gatherer || step.steps as f64 >= next {
                next = (step.steps as f64 * 1.05).max(next + 1.0);
                let rows = if gatherer { step.steps * set.len() } else { step.steps };
                for (curve, ambient) in curves.iter_mut().zip([0.0, step.ambient]) {
                    let error = off(step.radiosity, ambient);
                    for (axis, x) in curve.iter_mut().zip([1e3 * spent, step.steps as f64, rows as f64]) {
                        axis.points.push((x, error));
                    }
                }
                goes_on = off(step.radiosity, 0.0) > END;
            }
            since = Instant::now();
            goes_on
        });
        let reached =
            |curve: &Curve, error: f64| curve.points.iter().find(|p| p.1 <= error).map_or(f64::NAN, |p| p.0);
        for curve in &curves {
            println!(
                "{:>22}: to 10 % {:.0} rows {:.2} ms, to 1 % {:.0} rows {:.2} ms, to 1e-4 {:.0} rows {:.1} ms",
                curve[0].name,
                reached(&curve[2], 0.1),
                reached(&curve[0], 0.1),
                reached(&curve[2], 0.01),
                reached(&curve[0], 0.01),
                reached(&curve[2], 1e-4),
                reached(&curve[0], 1e-4)
            );
        }
        for curve in curves {
            for (panel, curve) in panels.iter_mut().zip(curve) {
                panel.curves.push(curve);
            }
        }
    }
    Ok(panels.into())
}

/// Bytes of a stored matrix per second in a sweep.
fn sweep_speed(system: &System, matrix: &FactorMatrix) {
    let entries: usize = matrix.rows.iter().map(|r| r.entries.len()).sum();
    let values = vec![1.0; system.len()];
    let seconds = (0..10)
        .map(|_| {
            let start = Instant::now();
            let sum: f64 = (0..system.len()).map(|i| system.rows.gathered(i, &values).0).sum();
            std::hint::black_box(sum);
            start.elapsed().as_secs_f64()
        })
        .fold(f64::INFINITY, f64::min);
    let bytes = entries * size_of::<(u32, f64)>();
    println!("a sweep over {entries} entries: {:.1} GB/s", bytes as f64 / seconds / 1e9);
}

/// Error of F between surfaces against time per row, for every method at several budgets.
fn compare_methods(tracer: &Tracer) -> Result<Panel, Failure> {
    let set = ElementSet::surfaces(tracer);
    let truth = MethodParams { tolerance: 1e-6, ..MethodParams::default() };
    let all = |method: Method, params: &MethodParams| -> Result<(Vec<Vec<f64>>, f64), Failure> {
        let prepared: Box<dyn FormFactors> = prepare(method, tracer, &set, params)?;
        let start = Instant::now();
        let rows: Vec<Vec<f64>> = (0..set.len() as u32)
            .map(|from| {
                let row = prepared.row(from);
                (0..set.len() as u32).map(|to| row.to(to).y).collect()
            })
            .collect();
        Ok((rows, start.elapsed().as_secs_f64() / set.len() as f64))
    };
    let (exact, seconds) = all(Method::Analytic, &truth)?;
    println!("{} surfaces; truth: analytic, {:.1} ms per row", set.len(), 1e3 * seconds);
    let mut panel = Panel::new("milliseconds per row", "rms error of F between surfaces");
    for method in Method::ALL {
        let base = MethodParams::default();
        let budgets: Vec<MethodParams> = match method {
            Method::Rays => (0..7).map(|k| MethodParams { rays: 4 << (2 * k), ..base }).collect(),
            Method::Area => (0..6).map(|k| MethodParams { rays: 1 << (2 * k), ..base }).collect(),
            // 128 cubes for a sender, then more of them: the raster is not what errs (see the test of its resolution).
            Method::Hemicube => {
                let cubes =
                    |k: u32| MethodParams { resolution: 32, rays: (3 * 32 * 32 * 8) << (2 * k), ..base };
                (0..4).map(cubes).collect()
            }
            Method::Analytic => (0..5).map(|k| MethodParams { tolerance: 0.1_f64.powi(k), ..base }).collect(),
        };
        let mut curve = Curve::new(method.name());
        for params in budgets {
            let (rows, seconds) = all(method, &params)?;
            let squares: f64 =
                rows.iter().flatten().zip(exact.iter().flatten()).map(|(a, b)| (a - b).powi(2)).sum();
            let error = (squares / (set.len() * set.len()) as f64).sqrt();
            println!("{:>10}: {:>9.3} ms per row, error {error:.1e}", method.name(), 1e3 * seconds);
            curve.points.push((1e3 * seconds, error.max(1e-9)));
        }
        panel.curves.push(curve);
    }
    Ok(panel)
}

/// Time of extended rows against plain ones.
fn mirrors_cost(name: &str, tracer: &Tracer) -> Result<(), Failure> {
    let (draft, patches) = coarse_patches(tracer, 400);
    let set = ElementSet::patches(tracer, &draft, &patches);
    let seconds = |extended: bool| -> Result<f64, Failure> {
        let mut params = MethodParams { rays: 64, ..MethodParams::default() };
        params.walk.extended = extended;
        let method = prepare(Method::Rays, tracer, &set, &params)?;
        let start = Instant::now();
        for from in 0..set.len() as u32 {
            std::hint::black_box(method.row(from));
        }
        Ok(start.elapsed().as_secs_f64())
    };
    // Alternating, the best of each: other work on the machine strikes both alike.
    let (mut plain, mut extended) = (f64::INFINITY, f64::INFINITY);
    for _ in 0..3 {
        plain = plain.min(seconds(false)?);
        extended = extended.min(seconds(true)?);
    }
    println!(
        "{name:>20}: {:.0} plain rows/s, {:.0} extended rows/s: {:+.1} %",
        set.len() as f64 / plain,
        set.len() as f64 / extended,
        100.0 * (extended / plain - 1.0)
    );
    Ok(())
}
