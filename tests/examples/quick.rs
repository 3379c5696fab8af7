//! Renders a scene 256 pixels wide and prints the time of every stage: for trying budgets out.
//!
//! `cargo run --profile fast -p catoptric-tests --example quick -- SCENE.glb OUT.exr [sketch|draft|standard|high] [layers]`
//!
//! Variables of the environment replace budgets of pass one: `BASE`, `ROWS`, `GATHER`, `VERT`, `TOL`, `BLUR`, `FLOOR`, `MAXV`, `SHADOW`,
//! `NEAR`, `DETAIL`, `MAXD`, `DROUNDS`, `ROUNDS`, `SMOOTH`, `BEND`, `FITBEND`, `POINTS`, `FITP`, `FITR`, `LIGHT`, `CNOISE`, `CMAXV` and `SEED` (see [`SolveParams`]), `NOISE`, `EDGE`, `MOST` and `ROULETTE` (see [`RenderParams`]);
//! `SKY` is the radiance of a uniform sky, bluish.

use std::path::Path;
use std::sync::Mutex;
use std::time::Instant;

use catoptric_radiosity::{SolveParams, solve};
use catoptric_render::{RenderParams, render};
use catoptric_scene::{Progress, Radiance, Rgb, Scene, SceneParts, Sky, gltf};
use catoptric_solution::Quality;
use catoptric_trace::Tracer;

/// Prints how long each stage took when the next one begins, and the processor time of all threads in it.
struct Stopwatch(Mutex<(Instant, f64, String)>);

/// Seconds that the threads of this process have run, where the system tells (Linux).
fn processor_seconds() -> f64 {
    let Ok(tasks) = std::fs::read_dir("/proc/self/task") else { return f64::NAN };
    let of_task = |path: std::path::PathBuf| {
        std::fs::read_to_string(path.join("schedstat")).ok()?.split(' ').next()?.parse::<f64>().ok()
    };
    tasks.flatten().filter_map(|task| of_task(task.path())).sum::<f64>() * 1e-9
}

impl Progress for Stopwatch {
    fn begin(&self, stage: &str, _total: u64) {
        let Ok(mut running) = self.0.lock() else { return };
        let (now, processor) = (Instant::now(), processor_seconds());
        if !running.2.is_empty() {
            let (wall, busy) = ((now - running.0).as_secs_f64(), processor - running.1);
            eprintln!("  {:>8.1} ms ({:>8.1} of processors) {}", wall * 1e3, busy * 1e3, running.2);
        }
        *running = (now, processor, stage.to_owned());
    }

    fn advance(&self, _units: u64) {}

    fn is_cancelled(&self) -> bool {
        false
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [scene, output, rest @ ..] = arguments.as_slice() else {
        return Err("usage: quick SCENE.glb OUT.exr [sketch|draft|standard|high] [layers]".into());
    };
    let quality = match rest.first().map(String::as_str) {
        Some("sketch") => Quality::Sketch,
        Some("draft") => Quality::Draft,
        Some("high") => Quality::High,
        _ => Quality::Standard,
    };

    let start = Instant::now();
    let progress = Stopwatch(Mutex::new((start, processor_seconds(), "load".to_owned())));
    let loaded = gltf::load(Path::new(scene), &gltf::LoadOptions::default()).map_err(|e| e.to_string())?;
    let scene = match value("SKY") {
        Some(radiance) => {
            let sky = Sky::Uniform(Radiance(Rgb::new(1.0, 1.0, 1.2) * radiance));
            Scene::new(SceneParts { sky: Some(sky), ..loaded.scene.into_parts() })
                .map_err(|_| "the sky is refused")?
        }
        None => loaded.scene,
    };
    progress.begin("tree", 1);
    let tracer = Tracer::new(&scene);
    let solved = solve(&tracer, &budgets(quality), &progress).map_err(|_| "stopped")?;

    let camera = scene.cameras().first().ok_or("the scene has no camera")?;
    let width = std::env::var("WIDTH").ok().and_then(|v| v.parse().ok()).unwrap_or(256);
    let layers = rest.len() > 1;
    let view = RenderParams::for_quality(quality, width, camera.height_for_width(width));
    let mut view = RenderParams { layers, ..view };
    view.noise = std::env::var("NOISE").ok().and_then(|v| v.parse().ok()).unwrap_or(view.noise);
    view.most_samples = std::env::var("MOST").ok().and_then(|v| v.parse().ok()).unwrap_or(view.most_samples);
    view.edge_samples = std::env::var("EDGE").ok().and_then(|v| v.parse().ok()).unwrap_or(view.edge_samples);
    view.walk.roulette_below = value("ROULETTE").unwrap_or(view.walk.roulette_below);
    let rendered = render(&tracer, &solved.solution, camera, &view, &progress).map_err(|_| "stopped")?;
    progress.begin("write", 1);
    rendered.image.write_exr(Path::new(output))?;
    progress.begin("", 1);
    let total = start.elapsed().as_secs_f64() * 1e3;
    eprintln!("total {total:.1} ms; {:?} {:?}", solved.report, rendered.report);
    Ok(())
}

/// A number of the environment.
fn value(name: &str) -> Option<f32> {
    std::env::var(name).ok()?.parse().ok()
}

/// The budgets of a quality with what the environment replaces.
fn budgets(quality: Quality) -> SolveParams {
    let mut params = SolveParams::for_quality(quality);
    let count = |name: &str, budget: &mut u32| *budget = value(name).map_or(*budget, |v| v as u32);
    let size = |name: &str, budget: &mut usize| *budget = value(name).map_or(*budget, |v| v as usize);
    let share = |name: &str, budget: &mut f32| *budget = value(name).unwrap_or(*budget);
    size("BASE", &mut params.base_triangles);
    count("ROWS", &mut params.row_rays);
    count("GATHER", &mut params.gather_rays);
    count("VERT", &mut params.vertex_rays);
    share("PRIOR", &mut params.gather_fit.prior);
    share("TOL", &mut params.sources.tolerance);
    share("BLUR", &mut params.sources.blur);
    share("FLOOR", &mut params.sources.floor);
    size("MAXV", &mut params.sources.max_vertices);
    count("SHADOW", &mut params.shadow_rays);
    params.fit_rays = value("SHADOW").map_or(params.fit_rays, |v| v as u32);
    share("NEAR", &mut params.near.ratio);
    share("DETAIL", &mut params.near.detail_share);
    size("MAXD", &mut params.near.max_details);
    count("DROUNDS", &mut params.near.detail_rounds);
    count("ROUNDS", &mut params.near.rounds);
    share("SMOOTH", &mut params.gather_fit.smoothing);
    share("BEND", &mut params.gather_fit.bending);
    share("FITBEND", &mut params.fit.bending);
    share("POINTS", &mut params.gather_points);
    count("FITP", &mut params.fit_points);
    count("FITR", &mut params.fit_rays);
    share("NLTOL", &mut params.near_light.tolerance);
    count("NLROUNDS", &mut params.near_light.rounds);
    share("NLSHORT", &mut params.near_light.shortest);
    share("NLFLOOR", &mut params.near_light.floor);
    share("NLSHARE", &mut params.near_light.share);
    count("SEED", &mut params.seed);
    count("LIGHT", &mut params.caustic.max_rays);
    share("CNOISE", &mut params.caustic.noise);
    size("CMAXV", &mut params.caustic.density.max_vertices);
    params
}
