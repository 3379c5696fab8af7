//! What a render will cost, before it is paid: rays, memory and time of both passes.

use std::time::Instant;

use catoptric_radiosity::SolveParams;
use catoptric_scene::{Scene, TriangleId};
use catoptric_solution::Quality;
use catoptric_trace::{Ray, Tracer};
use rayon::prelude::*;
use serde::Serialize;

/// Bytes per triangle: geometry, tree and tables (measured on rooms of 10³ to 10⁵ triangles).
const BYTES_PER_TRIANGLE: u64 = 500;
/// Bytes per form factor: a ray makes at most one.
const BYTES_PER_FACTOR: u64 = 16;
/// Program and threads.
const BYTES_AT_REST: u64 = 20 << 20;
/// Rays whose speed is measured.
const PROBES: u32 = 1 << 15;

/// The cost of one quality, in orders of magnitude.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Estimate {
    pub(crate) quality: &'static str,
    /// Patches of the coarse solve, at most.
    pub(crate) patches: u64,
    /// Rays of pass one.
    pub(crate) rays: u64,
    pub(crate) bytes: u64,
    /// Wall-clock seconds of pass one on this machine.
    pub(crate) seconds: f64,
}

/// One estimate per quality.
pub(crate) fn estimate(scene: &Scene) -> Vec<Estimate> {
    let rate = rays_per_second(scene);
    let (sketch, draft) = (("sketch", Quality::Sketch), ("draft", Quality::Draft));
    // Flat surfaces are cut to the budget, curved ones keep their triangles.
    let is_curved = |t: &TriangleId| scene.is_smooth(*t) && scene.material_of(*t).may_be_diffuse();
    let curved = (0..scene.triangles().len() as u32).map(TriangleId).filter(is_curved).count() as u64;
    [sketch, draft, ("standard", Quality::Standard), ("high", Quality::High)]
        .into_iter()
        .map(|(name, quality)| {
            let params = SolveParams::for_quality(quality);
            let patches = params.base_triangles as u64 + curved;
            let vertices = params.sources.max_vertices as u64 + curved;
            let rows = patches * u64::from(params.row_rays);
            let shadows = vertices * u64::from(params.shadow_rays);
            let gathers = patches * u64::from(params.gather_rays);
            let rays = rows + shadows + gathers;
            let triangles = scene.triangles().len() as u64;
            let bytes = BYTES_AT_REST + triangles * BYTES_PER_TRIANGLE + rows * BYTES_PER_FACTOR;
            Estimate { quality: name, patches, rays, bytes, seconds: rays as f64 / rate }
        })
        .collect()
}

/// Nearest hits per second along incoherent rays between the scene's triangles, on all threads.
fn rays_per_second(scene: &Scene) -> f64 {
    let triangles = scene.triangles().len() as u64;
    if triangles == 0 {
        return 1e6;
    }
    let tracer = Tracer::new(scene);
    let center = |index: u64| {
        let triangle = TriangleId((index % triangles) as u32);
        let [a, b, c] = scene.corners(triangle);
        (triangle, (a + b + c) / 3.0)
    };
    let start = Instant::now();
    let hits: usize = (0..PROBES)
        .into_par_iter()
        .filter(|&probe| {
            // Multiplicative hashing scatters the pairs of triangles.
            let pair = u64::from(probe).wrapping_mul(0x9E37_79B9_7F4A_7C15);
            let ((from, origin), (_, target)) = (center(pair >> 32), center(pair & 0xFFFF_FFFF));
            let direction = (target - origin).try_normalize().unwrap_or(scene.geometric_normal(from));
            let ray = Ray { origin, direction, from: tracer.planes().of(from) };
            tracer.nearest(&ray, f32::INFINITY).is_some()
        })
        .count();
    // A room without hits is fast, not infinitely so.
    let seconds = start.elapsed().as_secs_f64().max(1e-4);
    (f64::from(PROBES) / seconds).max(hits as f64)
}
