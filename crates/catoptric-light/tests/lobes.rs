//! Area lights with a cosine lobe against closed forms: on and off the axis, whole discs, the power through a box.

use std::f64::consts::PI;

use catoptric_light::irradiance::Scratch;
use catoptric_light::{LightParams, Lights, Receiver};
use catoptric_scene::{
    Barycentric, Lobe, Material, MaterialId, Radiance, Rgb, Scene, SceneParts, Side, TriangleId,
};
use catoptric_trace::Tracer;
use catoptric_trace::sequence::{Key, Purpose};
use glam::Vec3;

const RADIANCE: f64 = 2.0;

fn lamp_of(parts: &mut SceneParts, n: f32) -> MaterialId {
    let lobe = Lobe::new(n).expect("a legal exponent");
    parts.add_material(Material { lobe, ..Material::emitter("lamp", Radiance(Rgb::splat(RADIANCE as f32))) })
}

/// Irradiance at each of the places, in a scene to which a white scrap far below is added.
fn irradiance(mut parts: SceneParts, places: &[(Vec3, Vec3)], samples: u32) -> Vec<f64> {
    let white = parts.add_material(Material::lambertian("white", Rgb::ONE));
    parts.add_quad("scrap", white, Vec3::Y * -50.0, Vec3::Z, Vec3::X);
    let scene = Scene::new(parts).expect("a valid scene");
    let tracer = Tracer::new(&scene);
    let lights = Lights::new(&tracer, LightParams::default());
    let scrap = TriangleId(scene.triangles().len() as u32 - 1);
    let at = Barycentric { u: 0.3, v: 0.3 };
    let (mut scratch, key) = (Scratch::default(), Key::new(0, Purpose::Emitter, 0));
    let ask = |(index, &(position, normal)): (usize, &(Vec3, Vec3))| {
        let receiver =
            Receiver { position, normal, geometric: normal, ..Receiver::on(&tracer, scrap, Side::Front, at) };
        let found = lights.direct(&receiver, samples, key.child(index as u32), &mut scratch);
        f64::from(found.irradiance.x)
    };
    places.iter().enumerate().map(ask).collect()
}

/// E = Φ·S(θ)·cosθ'/r².
#[test]
fn a_small_square_lights_by_its_distribution() {
    let (side, height) = (0.01_f32, 2.0_f32);
    for n in [0.5, 1.0, 2.0, 6.5, 40.0, 1000.0] {
        let mut parts = SceneParts::default();
        let lamp = lamp_of(&mut parts, n);
        let corner = Vec3::new(-0.5 * side, height, -0.5 * side);
        parts.add_quad("lamp", lamp, corner, Vec3::X * side, Vec3::Z * side);
        let across: &[f32] = if n > 100.0 { &[0.0, 0.05] } else { &[0.0, 0.3, 1.5] };
        let places: Vec<(Vec3, Vec3)> = across.iter().map(|&x| (Vec3::X * x, Vec3::Y)).collect();
        let power = PI * RADIANCE * f64::from(side * side);
        for (found, &x) in irradiance(parts, &places, 16).into_iter().zip(across) {
            let r2 = f64::from(x * x + height * height);
            let cos = f64::from(height) / r2.sqrt();
            let share = (f64::from(n) + 1.0) / (2.0 * PI) * libm::pow(cos, f64::from(n));
            let exact = power * share * cos / r2;
            // A square of this size is no point: the error grows with n·(side/height)².
            let allowed = 1e-5 * (3.0 + f64::from(n));
            assert!((found / exact - 1.0).abs() < allowed, "n = {n}, x = {x}: {found}, exactly {exact}");
        }
    }
}

/// On the axis of a disc whose rim is seen at the cosine c: E = L·(n+1)/2 · 2π·∫ cosⁿθ dcosθ = πL(1 − cⁿ⁺¹). 400 cells: more
/// than a receiver takes one by one.
#[test]
fn a_disc_of_many_triangles_gives_its_closed_form() {
    let (count, radius) = (400_u32, 0.7_f64);
    for n in [0.5, 3.0, 25.0] {
        let mut parts = SceneParts::default();
        let lamp = lamp_of(&mut parts, n);
        let rim = |k: u32| {
            let angle = 2.0 * PI * f64::from(k) / f64::from(count);
            // The polygon has the disc's area.
            let half = PI / f64::from(count);
            let reach = radius * (2.0 * half / libm::sin(2.0 * half)).sqrt();
            Vec3::new((reach * libm::cos(angle)) as f32, 1.0, (reach * libm::sin(angle)) as f32)
        };
        let positions: Vec<Vec3> = std::iter::once(Vec3::Y).chain((0..count).map(rim)).collect();
        let fan: Vec<[u32; 3]> = (0..count).map(|k| [0, k + 1, (k + 1) % count + 1]).collect();
        parts.add_triangles("lamp", lamp, &positions, &fan);
        let places = [(Vec3::ZERO, Vec3::Y); 64];
        let found = irradiance(parts, &places, 256);
        let mean = found.iter().sum::<f64>() / 64.0;
        let spread = found.iter().map(|f| (f - mean) * (f - mean)).sum::<f64>() / (64.0 * 63.0);
        let exact = PI * RADIANCE * (1.0 - libm::pow(1.0 + radius * radius, -0.5 * (f64::from(n) + 1.0)));
        let allowed = 4.0 * spread.sqrt() + 2e-4 * exact;
        assert!((mean - exact).abs() < allowed, "n = {n}: {mean} ± {}, exactly {exact}", spread.sqrt());
        assert!(spread.sqrt() < 0.01 * exact, "n = {n}: noise {}", spread.sqrt() / exact);
    }
}

/// Midpoints of a grid on the six walls of a box around the lamp take in Φ = πAL, whatever n is.
#[test]
fn a_box_takes_in_the_whole_power() {
    for n in [0.5, 1.0, 2.5, 12.0, 60.0] {
        let mut parts = SceneParts::default();
        let lamp = lamp_of(&mut parts, n);
        let (a, b) = (Vec3::new(0.5, 0.2, 0.0), Vec3::new(0.0, 0.1, 0.4));
        parts.add_quad("lamp", lamp, Vec3::new(-0.2, 0.1, -0.1), a, b);
        let steps = 60;
        let mut places = Vec::new();
        for axis in [Vec3::X, Vec3::Y, Vec3::Z] {
            for inward in [axis, -axis] {
                let (s, t) = inward.any_orthonormal_pair();
                for index in 0..steps * steps {
                    let at = |k: i32| 2.0 * (k as f32 + 0.5) / steps as f32 - 1.0;
                    places.push((-inward + s * at(index % steps) + t * at(index / steps), inward));
                }
            }
        }
        let cell = 4.0 / f64::from(steps * steps);
        let taken: f64 = irradiance(parts, &places, 4).iter().map(|e| e * cell).sum();
        let sent = PI * RADIANCE * f64::from(a.cross(b).length());
        assert!((taken / sent - 1.0).abs() < 2e-3, "n = {n}: {taken} of {sent}");
    }
}
