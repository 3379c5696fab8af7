//! A floor of tiles of two materials: what arrives on it knows nothing of them.

use std::collections::BTreeMap;

use glam::Vec3;

use catoptric_radiosity::{SolveParams, solve};
use catoptric_scene::{Material, Radiance, Rgb, Scene, SceneParts, Silent};
use catoptric_solution::{Quality, Term};
use catoptric_trace::Tracer;

/// A closed room of side 2 with a lamp below the ceiling, on a chequered floor.
fn room() -> Scene {
    let mut parts = SceneParts::default();
    let grey = parts.add_material(Material::lambertian("grey", Rgb::splat(0.6)));
    let tiles = [0.1, 0.7].map(|r| parts.add_material(Material::lambertian("tile", Rgb::splat(r))));
    let lamp = parts.add_material(Material::emitter("lamp", Radiance(Rgb::splat(10.0))));
    let (x, y, z) = (2.0 * Vec3::X, 2.0 * Vec3::Y, 2.0 * Vec3::Z);
    let corner = Vec3::NEG_ONE;
    parts.add_quad("ceiling", grey, corner + y, x, z);
    parts.add_quad("back", grey, corner, x, y);
    parts.add_quad("left", grey, corner, y, z);
    parts.add_quad("right", grey, corner + x, z, y);
    parts.add_quad("front", grey, corner + z, y, x);
    for (i, j) in (0..8_u8).flat_map(|i| (0..8_u8).map(move |j| (i, j))) {
        let at = corner + Vec3::new(f32::from(i), 0.0, f32::from(j)) * 0.25;
        parts.add_quad("tile", tiles[usize::from((i + j) % 2)], at, 0.25 * Vec3::Z, 0.25 * Vec3::X);
    }
    parts.add_quad("lamp", lamp, Vec3::new(-0.2, 0.98, -0.2), 0.4 * Vec3::X, 0.4 * Vec3::Z);
    Scene::new(parts).expect("the scene is valid")
}

#[test]
fn light_goes_on_across_the_seams_of_a_floor() {
    let scene = room();
    let tracer = Tracer::new(&scene);
    let params = SolveParams::for_quality(Quality::Draft);
    let solution = solve(&tracer, &params, &Silent).expect("not cancelled").solution;
    let light = &solution.irradiance[Term::Indirect.index()];
    let mut places: BTreeMap<[i32; 2], Vec<f32>> = BTreeMap::new();
    for (vertex, light) in solution.mesh.vertices.iter().zip(light) {
        let Vec3 { x, y, z } = vertex.position;
        if y == -1.0 && vertex.normal == Vec3::Y && x.abs() < 0.99 && z.abs() < 0.99 {
            let place = [x, z].map(|c| (c * 1000.0).round() as i32);
            places.entry(place).or_default().push(light.y);
        }
    }
    // 49 corners at least, where vertices of both materials meet.
    let met: Vec<&Vec<f32>> = places.values().filter(|lights| lights.len() > 1).collect();
    assert!(met.len() >= 49, "{}", met.len());
    for lights in met {
        let (low, high) = lights.iter().fold((f32::INFINITY, 0.0_f32), |(l, h), &e| (l.min(e), h.max(e)));
        // What each material gathers by itself differs by up to 18 %; rounding by 1e-6, ten times that is allowed.
        assert!(high - low < 1e-5 * high, "{lights:?}");
    }
}
