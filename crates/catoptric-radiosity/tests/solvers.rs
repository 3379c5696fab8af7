//! Solvers on the matrices of whole scenes: they agree, whoever computes, and the coarse solve can use any of them.

use std::path::Path;

use glam::Vec3;

use catoptric_radiosity::base_mesh::coarse_patches;
use catoptric_radiosity::coarse::CoarseParams;
use catoptric_radiosity::method::{ElementSet, FactorMatrix, Method, MethodParams, factors, prepare};
use catoptric_radiosity::solver::{Params, Rows, Solver, Stop, StoredRows, System, solve_system};
use catoptric_radiosity::{SolveError, SolveParams, Solved, solve};
use catoptric_scene::gltf::{LoadOptions, load};
use catoptric_scene::{Material, Radiance, Rgb, Scene, SceneParts, Silent};
use catoptric_solution::Quality;
use catoptric_trace::Tracer;

const SCENES: [&str; 5] = ["cornell_box", "cornell_mirror", "two_mirrors", "facing_mirrors", "mirror_corner"];

fn load_scene(name: &str) -> Scene {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../scenes/{name}.glb"));
    load(&path, &LoadOptions::default()).expect("a scene of the repository").scene
}

/// The patches of a scene with their matrix: one channel.
struct Stored {
    matrix: FactorMatrix,
    weights: Vec<f64>,
    reflectance: Vec<f64>,
    emission: Vec<f64>,
}

impl Stored {
    fn new(name: &str, count: usize) -> Self {
        let scene = load_scene(name);
        let tracer = Tracer::new(&scene);
        let (draft, patches) = coarse_patches(&tracer, count);
        let set = ElementSet::patches(&tracer, &draft, &patches);
        let params = MethodParams { rays: 64, ..MethodParams::default() };
        let method = prepare(Method::Rays, &tracer, &set, &params).expect("rays read every scene");
        let matrix = factors(method.as_ref(), &set, &Silent).expect("nobody stops it");
        let reflectance: Vec<f64> = patches.reflectances.iter().map(|r| f64::from(r.x)).collect();
        // Every seventh patch sends: no order is easy for any solver.
        let emission = (0..reflectance.len()).map(|i| if i % 7 == 3 { 1.0 } else { 0.0 }).collect();
        Self { weights: FactorMatrix::weights(&tracer, &set), matrix, reflectance, emission }
    }

    fn solve(&self, solver: Solver, rows: &dyn Rows, emission: &[f64]) -> Vec<f64> {
        let system = System { rows, reflectance: &self.reflectance, emission, weights: &self.weights };
        // Residual in power: the radiosity of a small patch is off by more than that of a large one.
        let params = Params { residual: 1e-11, ..Params::default() };
        solve_system(solver, &system, &params, &mut |_| true).radiosity
    }
}

#[test]
fn all_solvers_agree_with_direct_on_stored_reciprocal_matrices() {
    for name in SCENES {
        let mut stored = Stored::new(name, 150);
        let kept = vec![glam::DVec3::ONE; stored.weights.len()];
        let change = stored.matrix.repair(&stored.weights, &kept, false);
        let rows = StoredRows::channel(&stored.matrix, 0);
        let direct = stored.solve(Solver::Direct, &rows, &stored.emission);
        let largest = direct.iter().copied().fold(0.0, f64::max);
        for solver in Solver::ALL {
            let found = stored.solve(solver, &rows, &stored.emission);
            let worst = found.iter().zip(&direct).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) / largest;
            assert!(worst < 1e-6, "{name}, {}: {worst:.1e}", solver.name());
        }
        println!(
            "{name}: {} patches, made reciprocal by {:.2} % of F (largest change {:.1e})",
            direct.len(),
            100.0 * change.mean,
            change.largest
        );
    }
}

#[test]
fn shooting_never_takes_back_and_the_ambient_estimate_is_closer_all_the_way() {
    for name in SCENES {
        let mut stored = Stored::new(name, 150);
        let kept = vec![glam::DVec3::ONE; stored.weights.len()];
        stored.matrix.repair(&stored.weights, &kept, false);
        // Rows of small patches are noisy: made reciprocal, they may send more than they have. Less of all is reciprocal, too.
        let sums = stored.matrix.rows.iter().map(|r| r.entries.iter().map(|e| e.factor.x).sum::<f64>());
        let most = sums.fold(1.0, f64::max);
        for entry in stored.matrix.rows.iter_mut().flat_map(|r| &mut r.entries) {
            entry.factor /= most;
        }
        let rows = StoredRows::channel(&stored.matrix, 0);
        let exact = stored.solve(Solver::Direct, &rows, &stored.emission);
        let system = System {
            rows: &rows,
            reflectance: &stored.reflectance,
            emission: &stored.emission,
            weights: &stored.weights,
        };
        let (mut before, mut unshot_before) = (stored.emission.clone(), f64::INFINITY);
        let (mut first, mut last) = (None, 0.0);
        solve_system(Solver::Progressive, &system, &Params::default(), &mut |step| {
            let unshot: f64 = step.unshot.iter().zip(&stored.weights).map(|(u, w)| u * w).sum();
            assert!(unshot <= unshot_before * (1.0 + 1e-12), "{name}, step {}", step.steps);
            assert!(
                step.radiosity.iter().zip(&before).all(|(now, b)| now >= b),
                "{name}, step {}",
                step.steps
            );
            let off = |ambient: f64| -> f64 {
                let parts = step.radiosity.iter().zip(&exact).zip(&stored.reflectance).zip(&stored.weights);
                parts.map(|(((b, exact), r), w)| (b + r * ambient - exact).abs() * w).sum()
            };
            let (shot, estimate) = (off(0.0), off(step.ambient));
            assert!(estimate <= shot, "{name}, step {}: {estimate} with ambient, {shot} without", step.steps);
            first.get_or_insert((shot, estimate));
            last = estimate;
            before.copy_from_slice(step.radiosity);
            unshot_before = unshot;
            true
        });
        let (shot, estimate) = first.expect("at least one step");
        println!("{name}: after one shot {estimate:.2} off with the ambient term, {shot:.2} without");
        assert!(last < 1e-6 * shot, "{name}: the estimate ends {last} off");
    }
}

/// With rows as they are sampled, w_i F_ij and w_j F_ji differ. Gatherers solve B = E + ρFB, shooters B̃ = E + ρF̃B̃ with
/// F̃_ij = w_j F_ji/w_i, so B̃ − B = (I − ρF̃)⁻¹ ρ(F̃ − F)B and, as the inverse has no negative entries,
/// |B̃ − B| ≤ (I − ρF̃)⁻¹ |ρ(F̃ − F)B|: one more solve gives the bound, patch by patch.
#[test]
fn with_rows_as_sampled_solvers_differ_by_no_more_than_the_asymmetry_allows() {
    for name in SCENES {
        let stored = Stored::new(name, 150);
        let count = stored.weights.len();
        let f = |i: usize, j: usize| stored.matrix.get(i as u32, j as u32).x;
        let turned: Vec<Vec<f64>> = (0..count)
            .map(|i| (0..count).map(|j| f(j, i) * stored.weights[j] / stored.weights[i]).collect())
            .collect();
        let rows = StoredRows::channel(&stored.matrix, 0);
        let turned = StoredRows::dense(&turned);
        let direct = stored.solve(Solver::Direct, &rows, &stored.emission);
        let gathered = |rows: &StoredRows, i: usize| {
            let mut sum = 0.0;
            rows.visit(i, &mut |j, f| sum += f * direct[j]);
            sum
        };
        let difference: Vec<f64> = (0..count)
            .map(|i| (stored.reflectance[i] * (gathered(&turned, i) - gathered(&rows, i))).abs())
            .collect();
        let bound = stored.solve(Solver::Direct, &turned, &difference);
        let largest = direct.iter().copied().fold(0.0, f64::max);
        let (mut worst, mut allowed) = (0.0_f64, 0.0_f64);
        for solver in [Solver::Southwell, Solver::SouthwellUnordered, Solver::Progressive] {
            let found = stored.solve(solver, &rows, &stored.emission);
            for i in 0..count {
                let off = (found[i] - direct[i]).abs();
                assert!(off <= bound[i] + 1e-8 * largest, "{name}, {}, patch {i}: {off}", solver.name());
                worst = worst.max(off / largest);
                allowed = allowed.max(bound[i] / largest);
            }
        }
        println!("{name}: shooters off by {worst:.1e} at most, the asymmetry allows {allowed:.1e}");
    }
}

fn with_threads<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads start").install(work)
}

#[test]
fn every_method_and_solver_gives_the_same_bits_at_one_two_and_three_threads() {
    let scene = load_scene("cornell_mirror");
    let tracer = Tracer::new(&scene);
    let (draft, patches) = coarse_patches(&tracer, 40);
    let set = ElementSet::patches(&tracer, &draft, &patches);
    let weights = FactorMatrix::weights(&tracer, &set);
    let reflectance: Vec<f64> = patches.reflectances.iter().map(|r| f64::from(r.x)).collect();
    let emission: Vec<f64> = (0..weights.len()).map(|i| if i % 7 == 3 { 1.0 } else { 0.0 }).collect();
    for method in Method::ALL {
        let params =
            MethodParams { rays: 8, resolution: 8, tolerance: 1e-2, max_cells: 8, ..MethodParams::default() };
        let solved = |threads: usize| {
            with_threads(threads, || {
                let prepared = prepare(method, &tracer, &set, &params).expect("plain mirrors");
                let matrix = factors(prepared.as_ref(), &set, &Silent).expect("nobody stops it");
                let rows = StoredRows::channel(&matrix, 0);
                let system =
                    System { rows: &rows, reflectance: &reflectance, emission: &emission, weights: &weights };
                let solutions = Solver::ALL
                    .map(|solver| solve_system(solver, &system, &Params::default(), &mut |_| true));
                (matrix, solutions)
            })
        };
        let one = solved(1);
        for threads in [2, 3] {
            let other = solved(threads);
            assert!(one.0 == other.0, "{}: another matrix at {threads} threads", method.name());
            for (solver, (a, b)) in Solver::ALL.iter().zip(one.1.iter().zip(&other.1)) {
                assert!(a == b, "{}, {}: other bits at {threads} threads", method.name(), solver.name());
            }
        }
    }
}

/// A closed room with a lamp, a mirror and a sheet that lets light through.
fn room() -> Scene {
    let mut parts = SceneParts::default();
    let walls = Material::lambertian("walls", Rgb::new(0.7, 0.5, 0.3));
    let lamp = Material::emitter("lamp", Radiance(Rgb::splat(5.0)));
    let mirror = Material::mirror("mirror", Rgb::new(0.9, 0.8, 0.7));
    let sheet = Material {
        double_sided: true,
        diffuse_transmission: Rgb::splat(0.5),
        diffuse_transmission_factor: 0.5,
        ..Material::lambertian("sheet", Rgb::splat(0.8))
    };
    let [walls, lamp, mirror, sheet] = [walls, lamp, mirror, sheet].map(|m| parts.add_material(m));
    parts.add_box("room", walls, Vec3::splat(-1.0), Vec3::splat(1.0), true);
    parts.add_quad("lamp", lamp, Vec3::new(-0.2, 0.99, -0.2), Vec3::X * 0.4, Vec3::Z * 0.4);
    parts.add_quad("mirror", mirror, Vec3::new(-0.99, -0.5, -0.5), Vec3::Y, Vec3::Z);
    parts.add_quad("sheet", sheet, Vec3::new(0.3, -1.0, -0.5), Vec3::Y, Vec3::Z);
    Scene::new(parts).expect("a valid scene")
}

/// A closed room with a lamp, and nothing for which the analytic method would need long.
fn plain_room() -> Scene {
    let mut parts = SceneParts::default();
    let walls = parts.add_material(Material::lambertian("walls", Rgb::new(0.7, 0.5, 0.3)));
    let lamp = parts.add_material(Material::emitter("lamp", Radiance(Rgb::splat(5.0))));
    parts.add_box("room", walls, Vec3::splat(-1.0), Vec3::splat(1.0), true);
    parts.add_quad("lamp", lamp, Vec3::new(-0.2, 0.0, -0.2), Vec3::X * 0.4, Vec3::Z * 0.4);
    Scene::new(parts).expect("a valid scene")
}

fn solve_with(scene: &Scene, coarse: CoarseParams) -> Result<Solved, SolveError> {
    solve_seeded(scene, coarse, 0)
}

fn solve_seeded(scene: &Scene, coarse: CoarseParams, seed: u32) -> Result<Solved, SolveError> {
    let mut params = SolveParams::for_quality(Quality::Draft);
    params.seed = seed;
    params.base_triangles = 60;
    params.coarse = coarse;
    solve(&Tracer::new(scene), &params, &Silent)
}

/// Largest difference of the patches' radiosity, relative to the largest radiosity.
fn difference(a: &Solved, b: &Solved) -> f32 {
    let (a, b) = (&a.solution.patches.radiosity, &b.solution.patches.radiosity);
    assert_eq!(a.len(), b.len());
    let largest = b.iter().flatten().copied().fold(0.0, f32::max);
    a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max) / largest
}

#[test]
fn the_coarse_solve_gives_the_same_light_by_every_gathering_solver() {
    let scene = room();
    let tight = |solver| CoarseParams { solver, residual: Some(1e-7), ..CoarseParams::default() };
    let expected = solve_with(&scene, tight(None)).expect("nothing is wrong");
    for solver in [Solver::Direct, Solver::Jacobi, Solver::GaussSeidel] {
        let found = solve_with(&scene, tight(Some(solver))).expect("nothing is wrong");
        // f32 rows and values: 1e-7 each, a few dozen of them, times 1/(1 − ρ) ≈ 4.
        let off = difference(&found, &expected);
        assert!(off < 2e-5, "{}: {off}", solver.name());
        let stop = if solver == Solver::Direct { Stop::Exact } else { Stop::Residual };
        assert_eq!(found.report.stop, Some(stop));
    }
}

#[test]
fn shooting_in_the_coarse_solve_gives_the_same_light_where_rows_are_reciprocal() {
    let scene = plain_room();
    let by = |solver| CoarseParams {
        method: Some(Method::Analytic),
        solver,
        residual: Some(1e-6),
        ..CoarseParams::default()
    };
    let expected = solve_with(&scene, by(None)).expect("nothing is wrong");
    for solver in [Solver::Southwell, Solver::SouthwellUnordered, Solver::Progressive] {
        let found = solve_with(&scene, by(Some(solver))).expect("nothing is wrong");
        // Rows aim at 1e-3 of each form factor: shot and gathered light differ by twice that, times 1/(1 − ρ) ≈ 4.
        let off = difference(&found, &expected);
        println!("{}: off by {off:.1e}, {} rows", solver.name(), found.report.solver_rows);
        assert!(off < 8e-3, "{}: {off}", solver.name());
        assert_eq!(found.report.stop, Some(Stop::Unshot));
    }
}

#[test]
fn any_method_lights_the_room_alike() {
    let scene = plain_room();
    let by = |method| CoarseParams { method, ..CoarseParams::default() };
    let power = |solved: &Solved| -> f64 {
        let patches = &solved.solution.patches;
        patches.areas.iter().zip(&patches.radiosity).map(|(a, b)| f64::from(a * b[0])).sum()
    };
    let seeds = 8_u32;
    let solved = |method, seed| power(&solve_seeded(&scene, by(method), seed).expect("nothing is wrong"));
    let exact: Vec<f64> = (0..seeds).map(|seed| solved(Some(Method::Analytic), seed)).collect();
    for method in [None, Some(Method::Rays), Some(Method::Hemicube), Some(Method::Area)] {
        let off: Vec<f64> = (0..seeds).map(|s| solved(method, s) / exact[s as usize] - 1.0).collect();
        let n = f64::from(seeds);
        let mean = off.iter().sum::<f64>() / n;
        let error = (off.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n * (n - 1.0))).sqrt();
        println!("{method:?}: power off by {mean:.1e}, standard error {error:.1e}");
        // Student's t with 7 degrees of freedom leaves 1e-3/4 beyond 6.7 on both sides together; rows aim at 1e-3.
        assert!(mean.abs() <= 6.7 * error + 1e-3, "{method:?}: {mean:.1e}, standard error {error:.1e}");
    }
}

#[test]
fn a_warm_start_takes_fewer_steps_and_ends_at_the_same_light() {
    let scene = room();
    let cold = solve_with(&scene, CoarseParams::default()).expect("nothing is wrong");
    let warm: Vec<Rgb> = cold.solution.patches.radiosity.iter().map(|&b| b.into()).collect();
    for solver in [None, Some(Solver::Jacobi), Some(Solver::GaussSeidel)] {
        let again = |warm| CoarseParams { solver, warm, ..CoarseParams::default() };
        let from_nothing = solve_with(&scene, again(Vec::new())).expect("nothing is wrong");
        let from_there = solve_with(&scene, again(warm.clone())).expect("nothing is wrong");
        let (few, many) = (from_there.report.iterations, from_nothing.report.iterations);
        assert!(few < many / 2, "{solver:?}: {few} steps instead of {many}");
        // Both have stopped at a residual of 1e-5 of the power; single patches are off by more.
        assert!(difference(&from_there, &from_nothing) < 1e-3);
    }
    let wrong = CoarseParams { warm: vec![Rgb::ONE; 3], ..CoarseParams::default() };
    assert!(matches!(solve_with(&scene, wrong), Err(SolveError::OtherPatches { found: 3, .. })));
}

#[test]
fn a_limit_of_steps_strikes_and_is_told() {
    for solver in [None, Some(Solver::Jacobi), Some(Solver::Progressive)] {
        let few = CoarseParams { solver, max_steps: Some(2), ..CoarseParams::default() };
        let solved = solve_with(&room(), few).expect("nothing is wrong");
        assert_eq!(solved.report.stop, Some(Stop::Steps), "{solver:?}");
        assert_eq!(solved.report.iterations, 2);
    }
}

#[test]
fn frames_show_light_that_grows_to_the_solution() {
    for solver in [None, Some(Solver::Progressive)] {
        let watched = CoarseParams { solver, every: 1, max_steps: Some(40), ..CoarseParams::default() };
        let solved = solve_with(&room(), watched).expect("nothing is wrong");
        let frames = solved.frames.expect("it was watched");
        assert!(frames.frames().len() >= 5);
        let mut before = -1.0;
        for frame in frames.frames() {
            let shot = frames.solution(frame, false);
            shot.validate().expect("a valid solution");
            let sum: f64 = shot.irradiance.iter().flatten().map(|h| f64::from(h.element_sum())).sum();
            assert!(sum >= before * (1.0 - 1e-6), "step {}: {sum} after {before}", frame.steps);
            before = sum;
            let estimate = frames.solution(frame, true);
            let more: f64 = estimate.irradiance.iter().flatten().map(|h| f64::from(h.element_sum())).sum();
            assert!(more >= sum && (more > sum) == (frame.ambient != Rgb::ZERO));
        }
    }
}

/// Rows that count how often they are asked for.
struct Counted<'a> {
    rows: &'a StoredRows,
    asked: std::cell::Cell<usize>,
}

impl Rows for Counted<'_> {
    fn len(&self) -> usize {
        self.rows.len()
    }

    fn visit(&self, from: usize, visit: &mut dyn FnMut(usize, f64)) {
        self.asked.set(self.asked.get() + 1);
        self.rows.visit(from, visit);
    }
}

#[test]
fn solvers_ask_for_the_rows_that_they_say() {
    let stored = Stored::new("cornell_mirror", 60);
    let rows = StoredRows::channel(&stored.matrix, 0);
    for solver in Solver::ALL {
        let counted = Counted { rows: &rows, asked: std::cell::Cell::new(0) };
        let system = System {
            rows: &counted,
            reflectance: &stored.reflectance,
            emission: &stored.emission,
            weights: &stored.weights,
        };
        let params = Params { residual: 1e-4, ..Params::default() };
        let solution = solve_system(solver, &system, &params, &mut |_| true);
        assert_eq!(solution.rows, counted.asked.get(), "{}", solver.name());
    }
}

#[test]
fn whoever_watches_can_stop_every_solver() {
    let stored = Stored::new("cornell_mirror", 60);
    let rows = StoredRows::channel(&stored.matrix, 0);
    let system = System {
        rows: &rows,
        reflectance: &stored.reflectance,
        emission: &stored.emission,
        weights: &stored.weights,
    };
    for solver in Solver::ALL {
        let mut seen = 0;
        let solution = solve_system(solver, &system, &Params::default(), &mut |_| {
            seen += 1;
            seen < 2
        });
        assert_eq!((solution.stop, seen), (Stop::Watcher, 2), "{}", solver.name());
        assert_eq!(solution.radiosity.len(), system.len());
    }
}
