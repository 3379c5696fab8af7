//! Many small emitters: what is drawn by chance is right in the mean.

use catoptric_light::irradiance::Scratch;
use catoptric_light::{LightParams, Lights, Receiver, contour};
use catoptric_scene::{Barycentric, Material, Radiance, Rgb, Scene, SceneParts, Side, TriangleId};
use catoptric_trace::sequence::{Key, Purpose};
use catoptric_trace::{PlaneId, Tracer};
use glam::Vec3;

/// Bodies on a side of their grid: eight triangles each, far more than parts.
const BODIES: u32 = 10;

/// Octahedra in a wavy layer at height 1, all `scale` times as large, and a quad that nothing sees.
fn scattered(scale: f32) -> Scene {
    let mut parts = SceneParts::default();
    let (mut positions, mut triangles) = (Vec::new(), Vec::new());
    let step = 1.0 / BODIES as f32;
    for k in 0..BODIES * BODIES {
        let (i, j) = (k % BODIES, k / BODIES);
        let lift = 1.0 + 0.03 * ((i * 7 + j * 13) % 11) as f32;
        let center = Vec3::new((i as f32 + 0.5) * step - 0.5, lift, (j as f32 + 0.5) * step - 0.5);
        let first = positions.len() as u32;
        let corners = [Vec3::X, Vec3::NEG_X, Vec3::Y, Vec3::NEG_Y, Vec3::Z, Vec3::NEG_Z];
        positions.extend(corners.map(|d| (center + d * 0.3 * step) * scale));
        for (p, q, s) in [(0, 2, 4), (2, 1, 4), (1, 3, 4), (3, 0, 4)] {
            triangles.extend([[p, q, s], [q, p, 5]].map(|t| t.map(|v| v + first)));
        }
    }
    // Bodies in a row would be lamps: their halves are not.
    let (above, below): (Vec<_>, Vec<_>) = triangles.chunks(2).map(|pair| (pair[0], pair[1])).unzip();
    let triangles = [above, below].concat();
    let glowing = parts.add_material(Material::emitter("glowing", Radiance(Rgb::splat(3.0))));
    parts.add_triangles("bodies", glowing, &positions, &triangles);
    let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
    parts.add_quad("scrap", white, Vec3::Y * -50.0 * scale, Vec3::Z * scale, Vec3::X * scale);
    Scene::new(parts).expect("a valid scene")
}

/// The mean over seeds of what arrives if nothing blocks is the sum over the facets, below the layer, within it and above
/// it, whatever the unit of length. Five standard errors, and what a group may be off (0.25 %).
#[test]
fn drawn_facets_send_in_the_mean_what_all_send() {
    for scale in [1e-6, 1.0, 1e6] {
        let scene = scattered(scale);
        let tracer = Tracer::new(&scene);
        let lights = Lights::new(&tracer, LightParams::default());
        let mut scratch = Scratch::default();
        let last = TriangleId(scene.triangles().len() as u32 - 1);
        let on = Receiver::on(&tracer, last, Side::Front, Barycentric { u: 0.3, v: 0.3 });
        let places = [
            (Vec3::new(0.1, 0.0, 0.2), Vec3::Y),
            (Vec3::new(0.8, 0.3, 0.0), Vec3::new(-0.8, 0.6, 0.0)),
            (Vec3::new(0.03, 1.15, -0.21), Vec3::X),
            (Vec3::new(-0.2, 1.5, 0.1), Vec3::NEG_Y),
        ];
        for (index, (place, normal)) in places.into_iter().enumerate() {
            let position = place * scale;
            let receiver = Receiver { position, plane: PlaneId::NONE, normal, geometric: normal, ..on };
            let (p, n) = (position.as_dvec3(), normal.as_dvec3());
            let faces = |c: &&catoptric_light::emitter::Cell| c.normal.dot(p - c.point(0.0, 0.0)) > 0.0;
            let facets = lights.emitters().cells().iter().filter(faces);
            let exact: f64 = 3.0 * facets.map(|c| contour::irradiance(p, n, &c.polygon())).sum::<f64>();
            let (mut sum, mut squares) = (0.0_f64, 0.0_f64);
            let count = 2000;
            for seed in 0..count {
                let key = Key::new(seed, Purpose::Test, index as u64);
                let found = f64::from(lights.direct(&receiver, 16, key, &mut scratch).unoccluded.x);
                sum += found;
                squares += found * found;
            }
            let mean = sum / f64::from(count);
            let error = ((squares / f64::from(count) - mean * mean).max(0.0) / f64::from(count)).sqrt();
            assert!(
                (mean - exact).abs() < 5.0 * error + 0.0025 * exact,
                "times {scale} at {place}: {mean} ± {error}, exactly {exact}"
            );
        }
    }
}

/// The halves of an odd number of samples differ by as little as those of the even number before it: what differs is their
/// noise, not their size.
#[test]
fn halves_of_an_odd_number_are_as_large_as_each_other() {
    let scene = scattered(1.0);
    let tracer = Tracer::new(&scene);
    let lights = Lights::new(&tracer, LightParams::default());
    assert_eq!(lights.emitters().lamps().len(), 0);
    let mut scratch = Scratch::default();
    let last = TriangleId(scene.triangles().len() as u32 - 1);
    let on = Receiver::on(&tracer, last, Side::Front, Barycentric { u: 0.3, v: 0.3 });
    let mut between = |samples: u32| -> f64 {
        // Systematic samples and a grid of bodies make patterns: another place each time.
        let seeds = 0..2000;
        let relative = seeds.clone().map(|seed| {
            let key = Key::new(seed, Purpose::Test, 7);
            let place = key.point2(1000) - 0.5;
            let (position, normal) = (Vec3::new(place.x, 0.0, place.y), Vec3::Y);
            let receiver = Receiver { position, plane: PlaneId::NONE, normal, geometric: normal, ..on };
            let found = lights.direct(&receiver, samples, key, &mut scratch);
            f64::from(found.split.x / found.irradiance.x).powi(2)
        });
        relative.sum::<f64>() / seeds.len() as f64
    };
    // Half as many are drawn: 4 and 5, 6 and 7, 8 and 9. Means of 2000 squares are known to some 5 %.
    for samples in [8, 12, 16] {
        let (even, odd) = (between(samples), between(samples + 2));
        assert!(odd < 1.15 * even, "{samples}: {odd} after {even}");
    }
}
