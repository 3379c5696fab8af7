//! Renders a scene with timings (development aid).
use catoptric_scene::{Progress, gltf};
use catoptric_solution::Quality;
use std::time::Instant;
struct Timed(std::sync::Mutex<(Instant, String)>);
impl Progress for Timed {
    fn begin(&self, stage: &str, _t: u64) {
        let mut g = self.0.lock().expect("lock");
        if !g.1.is_empty() {
            eprintln!("  {:>8.1} ms {}", g.0.elapsed().as_secs_f64() * 1e3, g.1);
        }
        *g = (Instant::now(), stage.to_owned());
    }
    fn advance(&self, _u: u64) {}
    fn is_cancelled(&self) -> bool {
        false
    }
}
#[allow(clippy::too_many_lines)]
fn main() {
    let args: Vec<String> = std::env::args().collect();
    let start = Instant::now();
    let loaded = gltf::load(std::path::Path::new(&args[1]), &gltf::LoadOptions::default()).expect("load");
    let quality = match args.get(3).map(String::as_str) {
        Some("draft") => Quality::Draft,
        Some("high") => Quality::High,
        _ => Quality::Standard,
    };
    let progress = Timed(std::sync::Mutex::new((Instant::now(), String::new())));
    progress.begin("tree", 1);
    let tracer = catoptric_trace::Tracer::new(&loaded.scene);
    let mut params = catoptric_radiosity::SolveParams::for_quality(quality);
    let env = |n: &str| std::env::var(n).ok().and_then(|v| v.parse::<f32>().ok());
    if let Some(v) = env("BASE") {
        params.base_triangles = v as usize;
    }
    if let Some(v) = env("ROWS") {
        params.row_rays = v as u32;
    }
    if let Some(v) = env("GATHER") {
        params.gather_rays = v as u32;
    }
    if let Some(v) = env("VERT") {
        params.vertex_rays = v as u32;
    }
    if let Some(v) = env("TOL") {
        params.sources.tolerance = v;
    }
    if let Some(v) = env("MAXV") {
        params.sources.max_vertices = v as usize;
    }
    if let Some(v) = env("SHADOW") {
        params.shadow_rays = v as u32;
        params.fit_rays = v as u32 / 2;
    }
    if let Some(v) = env("NEAR") {
        params.near = v;
    }
    if let Some(v) = env("ROUNDS") {
        params.near_rounds = v as u32;
    }
    if let Some(v) = env("SMOOTH") {
        params.gather_fit.smoothing = v;
    }
    if let Some(v) = env("POINTS") {
        params.gather_points = v;
    }
    if let Some(v) = env("FITP") {
        params.fit_points = v as u32;
    }
    if let Some(v) = env("SEED") {
        params.seed = v as u32;
    }
    let solved = catoptric_radiosity::solve(&tracer, &params, &progress).expect("solve");
    let camera = &loaded.scene.cameras()[0];
    let width = 256;
    let mut rp = catoptric_render::RenderParams::for_quality(quality, width, camera.height_for_width(width));
    rp.layers = args.get(4).is_some();
    let rendered =
        catoptric_render::render(&tracer, &solved.solution, camera, &rp, &progress).expect("render");
    progress.begin("write", 1);
    rendered.image.write_exr(std::path::Path::new(&args[2])).expect("write");
    progress.begin("", 1);
    eprintln!(
        "total {:.1} ms; {:?} {:?}",
        start.elapsed().as_secs_f64() * 1e3,
        solved.report,
        rendered.report
    );
}
