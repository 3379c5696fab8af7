//! Light through a shaft of mirrors that a lamp closes: it touches them all.

use catoptric_light::irradiance::{Samples, Scratch};
use catoptric_light::{LightParams, Lights, Receiver};
use catoptric_scene::{Barycentric, Material, Radiance, Rgb, Scene, SceneParts, Side, TriangleId};
use catoptric_trace::sequence::{Key, Purpose};
use catoptric_trace::{Event, MediumStack, PlaneId, Ray, Tracer};
use glam::Vec3;

/// Corners of the mouth, seen from below, and what is above.
const MOUTH: [Vec3; 4] = [
    Vec3::new(-0.2, 2.0, -0.3),
    Vec3::new(0.2, 2.0, -0.3),
    Vec3::new(0.2, 2.0, 0.1),
    Vec3::new(-0.2, 2.0, 0.1),
];
const HEIGHT: Vec3 = Vec3::new(0.0, 1.5, 0.0);
/// Of the mirrors, at every angle.
const SILVER: f32 = 0.9;

/// A shaft in a ceiling over a floor. The lamp's outline begins at its corner `first`; the floor comes last.
fn scene(first: usize) -> Scene {
    let mut parts = SceneParts::default();
    let glowing = parts.add_material(Material::emitter("glowing", Radiance(Rgb::ONE)));
    let silver = parts.add_material(Material::mirror("silver", Rgb::splat(SILVER)));
    let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
    let corner = |k: usize| MOUTH[k % 4];
    for k in 0..4 {
        parts.add_quad("mirror", silver, corner(k), corner(k + 1) - corner(k), HEIGHT);
    }
    let [at, next, before] = [first, first + 1, first + 3].map(|k| corner(k) + HEIGHT);
    parts.add_quad("lamp", glowing, at, next - at, before - at);
    let (low, high) = (Vec3::new(-3.0, 2.0, -3.0), Vec3::new(3.0, 2.0, 3.0));
    let mut ceiling = |a: [f32; 2], b: [f32; 2]| {
        let (x, z) = (Vec3::X * (b[0] - a[0]), Vec3::Z * (b[1] - a[1]));
        parts.add_quad("ceiling", white, Vec3::new(a[0], 2.0, a[1]), x, z);
    };
    ceiling([low.x, low.z], [MOUTH[0].x, high.z]);
    ceiling([MOUTH[1].x, low.z], [high.x, high.z]);
    ceiling([MOUTH[0].x, low.z], [MOUTH[1].x, MOUTH[0].z]);
    ceiling([MOUTH[0].x, MOUTH[2].z], [MOUTH[1].x, high.z]);
    parts.add_quad("floor", white, Vec3::new(-3.0, 0.0, -3.0), Vec3::Z * 6.0, Vec3::X * 6.0);
    Scene::new(parts).expect("a valid scene")
}

/// Points of the mouth in each direction, for the brute force.
const GRID: u32 = 160;

/// Irradiance over the chains that have images, by rays to the midpoints of a grid on the mouth.
fn by_rays(lights: &Lights, receiver: &Receiver) -> f64 {
    let tracer = lights.tracer();
    let [across, along] = [MOUTH[1] - MOUTH[0], MOUTH[3] - MOUTH[0]];
    let area = across.cross(along).length() / (GRID * GRID) as f32;
    let mut sum = 0.0;
    let mut planes: Vec<PlaneId> = Vec::new();
    for i in 0..GRID * GRID {
        let [s, t] = [i % GRID, i / GRID].map(|k| (k as f32 + 0.5) / GRID as f32);
        let offset = MOUTH[0] + across * s + along * t - receiver.position;
        let (r2, direction) = (offset.length_squared(), offset.normalize_or(Vec3::Y));
        let mut light = direction.y * direction.y / r2 * area;
        let mut ray = Ray { origin: receiver.position, direction, from: receiver.plane };
        planes.clear();
        while let Some(hit) = tracer.nearest(&ray, f32::INFINITY) {
            let interaction = tracer.interact(ray.direction, &hit, MediumStack::AIR);
            if interaction.emission.0 != Rgb::ZERO && lights.chains().contains(&planes) {
                sum += f64::from(light * interaction.emission.0.x);
            }
            let [branch] = interaction.branches() else { break };
            let Event::Planar(plane) = branch.event else { break };
            planes.push(plane);
            light *= branch.throughput.x;
            let origin = ray.origin + ray.direction * hit.t;
            ray = Ray { origin, direction: branch.direction, from: plane };
        }
    }
    sum
}

/// At whichever mirror the lamp's outline begins, and though windows end where it does, light comes over all of them.
#[test]
fn a_lamp_that_closes_a_shaft_of_mirrors_is_seen_over_all_of_them() {
    // Edges of what the mouth shows are off by up to half a cell of the grid, evenly distributed: by 1/√12 of a row. It shows the edges
    // of two or three mirrors and of as many ends of the lamp, with gaps where a chain has no image: eight.
    let deviation = (8.0_f64 / 12.0).sqrt() / f64::from(GRID);
    let mut scratch = Scratch::default();
    let (mut count, mut sum) = (0_u32, 0.0);
    for first in 0..4 {
        let scene = scene(first);
        let tracer = Tracer::new(&scene);
        let lights = Lights::new(&tracer, LightParams::default());
        let last = TriangleId(scene.triangles().len() as u32 - 1);
        let on = Receiver::on(&tracer, last, Side::Front, Barycentric { u: 0.3, v: 0.3 });
        for index in 0..24 {
            let key = Key::new(6, Purpose::Test, index);
            let place = key.point2(0) * 2.4 - 1.2;
            let receiver = Receiver { position: Vec3::new(place.x, 0.0, place.y), ..on };
            // Chains that send little are sampled: by as many rays as leave less noise than the grid's.
            let samples = Samples::exact(4096);
            let found = lights.mirrored(&receiver, samples, Rgb::ZERO, key.child(1), &mut scratch).irradiance;
            let expected = by_rays(&lights, &receiver);
            let difference = f64::from(found.x) / expected - 1.0;
            assert!(difference.abs() < 3.0 * deviation, "{first}, {index}: {difference}");
            count += 1;
            sum += difference;
        }
    }
    let mean = sum / f64::from(count);
    assert!(mean.abs() < 3.0 * deviation / f64::from(count).sqrt(), "{mean}");
}
