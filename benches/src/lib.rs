//! What the kernel benches share: scenes and rays.

use std::path::{Path, PathBuf};

use catoptric_light::Receiver;
use catoptric_scene::{Camera, Scene, Side, gltf};
use catoptric_trace::sequence::{Key, Purpose, cosine_hemisphere};
use catoptric_trace::{Ray, Tracer};
use glam::Vec3;

/// The file of a scene of the repository.
pub fn scene_file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes").join(format!("{name}.glb"))
}

/// Loads a scene.
///
/// # Panics
/// If it does not load, or has no camera.
pub fn load(file: &Path) -> Scene {
    let loaded = gltf::load(file, &gltf::LoadOptions::default());
    let scene = loaded.unwrap_or_else(|error| panic!("{error}")).scene;
    assert!(!scene.cameras().is_empty(), "{}: no camera", file.display());
    scene
}

/// Eye rays through the centres of a picture's pixels, row by row: coherent.
pub fn eye_rays(camera: &Camera, width: usize) -> Vec<Ray> {
    let height = camera.height_for_width(width);
    let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x as f32 + 0.5, y as f32 + 0.5)));
    pixels
        .map(|(x, y)| {
            let (origin, direction) = camera.ray(x, y, width, height);
            Ray::free(origin, direction)
        })
        .collect()
}

/// One cosine-distributed ray from where each of `rays` ends, on the side it came from: incoherent. It starts `offset` off
/// the surface, so that a tracer that knows no planes may trace it too.
pub fn bounced(tracer: &Tracer, rays: &[Ray], offset: f32) -> Vec<Ray> {
    let key = Key::new(7, Purpose::Test, 0);
    let scene = tracer.scene();
    let bounce = |(index, ray): (usize, &Ray)| {
        let hit = tracer.nearest(ray, f32::INFINITY)?;
        let side = if hit.back { Side::Back } else { Side::Front };
        let normal = side.orient(scene.geometric_normal(hit.triangle));
        let (tangent, bitangent) = normal.any_orthonormal_pair();
        let local = cosine_hemisphere(key.point2(index as u32));
        let direction = tangent * local.x + bitangent * local.y + normal * local.z;
        Some(Ray::free(ray.origin + ray.direction * hit.t + normal * offset, direction))
    };
    rays.iter().enumerate().filter_map(bounce).collect()
}

/// Receivers where `rays` end.
pub fn receivers(tracer: &Tracer, rays: &[Ray]) -> Vec<Receiver> {
    let receiver = |ray: &Ray| {
        let hit = tracer.nearest(ray, f32::INFINITY)?;
        let side = if hit.back { Side::Back } else { Side::Front };
        Some(Receiver::on(tracer, hit.triangle, side, hit.at))
    };
    rays.iter().filter_map(receiver).collect()
}

/// A distance that is nothing in a scene of this size, and much more than its rounding.
pub fn offset(tracer: &Tracer) -> f32 {
    1e-4 * tracer.diagonal()
}

/// The origin and direction of rays, six numbers each.
pub fn flat(rays: &[Ray]) -> Vec<f32> {
    let numbers = |ray: &Ray| -> [Vec3; 2] { [ray.origin, ray.direction] };
    rays.iter().flat_map(numbers).flat_map(|v| v.to_array()).collect()
}
