//! What a render will cost, before it is paid: rays, memory and time of both passes.

use std::time::Instant;

use clap::ValueEnum;

use catoptric_radiosity::{SolveParams, count_mesh};
use catoptric_scene::{Scene, TriangleId};
use catoptric_solution::Quality;
use catoptric_trace::{Ray, Tracer};
use rayon::prelude::*;
use serde::Serialize;

use crate::args::QualityWord;

/// Bytes per triangle: geometry, tree and tables (measured on rooms of 10³ to 10⁵ triangles).
const BYTES_PER_TRIANGLE: u64 = 500;
/// Program and threads.
const BYTES_AT_REST: u64 = 10 << 20;
/// Most rays over curved mirrors and glass, for each that is expected: they end where their noise is low enough.
const CAUSTIC_SHARE: u32 = 2;
/// Rays whose speed is measured.
const PROBES: u32 = 1 << 15;

/// The cost of one quality, in orders of magnitude.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Estimate {
    pub(crate) quality: &'static str,
    /// Patches of the coarse solve.
    pub(crate) patches: u64,
    /// Rays of pass one.
    pub(crate) rays: u64,
    pub(crate) bytes: u64,
    /// Wall-clock seconds of pass one on this machine.
    pub(crate) seconds: f64,
}

/// What becomes of a vertex of the mesh before light is known.
struct PerVertex {
    /// Gathers, at it and at those that light asks for beside it.
    gathers: u64,
    bytes: u64,
}

impl PerVertex {
    /// Of rooms with few and many things, with and without caustics, the mean; they are between a half and twice of that, and three times where
    /// a lamp is in glass (cornell_box, interior, showcase, pool, bulb_in_glass).
    fn for_quality(quality: Quality) -> Self {
        match quality {
            Quality::Sketch => Self { gathers: 2, bytes: 4_500 },
            Quality::Draft => Self { gathers: 2, bytes: 8_000 },
            Quality::Standard => Self { gathers: 3, bytes: 13_000 },
            Quality::High => Self { gathers: 8, bytes: 26_000 },
        }
    }
}

/// One estimate per quality.
pub(crate) fn estimate(scene: &Scene) -> Vec<Estimate> {
    let tracer = Tracer::new(scene);
    let rate = rays_per_second(&tracer);
    let makes_caustics = |t: &TriangleId| {
        let material = scene.material_of(*t);
        material.may_be_specular() && (scene.is_smooth(*t) || material.transmission > 0.0)
    };
    let has_caustics = (0..scene.triangles().len() as u32).map(TriangleId).any(|t| makes_caustics(&t));
    QualityWord::value_variants()
        .par_iter()
        .map(|word| {
            let quality = word.quality();
            let params = SolveParams::for_quality(quality);
            let mesh = count_mesh(&tracer, &params);
            let (patches, vertices) = (mesh.patches as u64, mesh.vertices as u64);
            let of = PerVertex::for_quality(quality);
            let rows = patches * u64::from(params.row_rays);
            let gathers = vertices * of.gathers * u64::from(params.vertex_rays);
            let light = if has_caustics { u64::from(params.caustic.max_rays / CAUSTIC_SHARE) } else { 0 };
            let rays = rows + gathers + light;
            let triangles = scene.triangles().len() as u64;
            let bytes = BYTES_AT_REST + triangles * BYTES_PER_TRIANGLE + vertices * of.bytes;
            Estimate { quality: word.name(), patches, rays, bytes, seconds: rays as f64 / rate }
        })
        .collect()
}

/// Nearest hits per second along incoherent rays between the scene's triangles, on all threads.
fn rays_per_second(tracer: &Tracer) -> f64 {
    let scene = tracer.scene();
    let triangles = scene.triangles().len() as u64;
    if triangles == 0 {
        return 1e6;
    }
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

#[cfg(test)]
mod tests {
    use catoptric_radiosity::solve;
    use catoptric_scene::{Material, Radiance, Rgb, SceneParts, Silent};
    use glam::Vec3;

    use super::*;

    #[test]
    fn an_estimate_is_of_the_order_of_what_a_solve_takes() {
        let mut parts = SceneParts::default();
        let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.6)));
        let lamp = parts.add_material(Material::emitter("lamp", Radiance(Rgb::splat(20.0))));
        parts.add_box("room", white, Vec3::ZERO, Vec3::splat(2.0), true);
        parts.add_box("chest", white, Vec3::new(0.4, 0.0, 0.5), Vec3::new(1.0, 0.6, 1.0), false);
        parts.add_sphere("ball", white, Vec3::new(1.4, 0.3, 1.2), 0.3, 24);
        parts.add_quad("lamp", lamp, Vec3::new(0.8, 1.99, 0.8), Vec3::X * 0.4, Vec3::Z * 0.4);
        let scene = Scene::new(parts).expect("a valid scene");
        let tracer = Tracer::new(&scene);
        for (estimated, quality) in
            estimate(&scene).iter().zip([Quality::Sketch, Quality::Draft, Quality::Standard])
        {
            let solved = solve(&tracer, &SolveParams::for_quality(quality), &Silent).expect("solved");
            assert_eq!(estimated.patches, solved.report.patches as u64, "{}", estimated.quality);
            let taken: u64 = solved.report.rays.iter().map(|stage| stage.1).sum();
            let ratio = estimated.rays as f64 / taken as f64;
            // Three times is what a lamp in glass is off.
            assert!((0.25..4.0).contains(&ratio), "{}: {} of {taken}", estimated.quality, estimated.rays);
        }
    }
}
