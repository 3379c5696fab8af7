//! Irradiance by the sky against closed forms.

use std::f32::consts::PI;

use catoptric_light::irradiance::{LightParams, Scratch, SkyView, Skylight};
use catoptric_light::{Lights, Receiver};
use catoptric_scene::{Barycentric, Material, Radiance, Rgb, Scene, SceneParts, Side, Sky, TriangleId};
use catoptric_trace::Tracer;
use catoptric_trace::sequence::{Key, Purpose};
use glam::Vec3;

const RADIANCE: Rgb = Rgb::new(1.0, 2.0, 3.0);
const SAMPLES: u32 = 32;

fn under_the_sky(build: impl FnOnce(&mut SceneParts)) -> Scene {
    let mut parts = SceneParts { sky: Some(Sky::Uniform(Radiance(RADIANCE))), ..SceneParts::default() };
    build(&mut parts);
    Scene::new(parts).expect("a valid scene")
}

/// A point of the floor, which is the first quad of a scene.
fn on_floor(tracer: &Tracer, x: f32, z: f32) -> Receiver {
    let receiver = Receiver::on(tracer, TriangleId(0), Side::Front, Barycentric { u: 0.0, v: 0.0 });
    Receiver { position: Vec3::new(x, 0.0, z), ..receiver }
}

fn skylight(lights: &Lights, receiver: &Receiver, beside: Option<&SkyView>, seed: u32) -> (Skylight, u64) {
    let mut scratch = Scratch::default();
    let key = Key::new(seed, Purpose::Emitter, 0);
    (lights.skylight(receiver, SAMPLES, Rgb::ZERO, beside, key, &mut scratch), scratch.rays)
}

#[test]
fn where_nothing_is_in_the_way_it_is_exact() {
    let scene = under_the_sky(|parts| {
        let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
        parts.add_quad("floor", white, Vec3::new(-2.0, 0.0, 2.0), Vec3::X * 4.0, Vec3::Z * -4.0);
    });
    let tracer = Tracer::new(&scene);
    let lights = Lights::new(&tracer, LightParams::default());
    let (found, _) = skylight(&lights, &on_floor(&tracer, 0.3, -0.2), None, 1);
    assert!(found.even && found.variance == 0.0, "{found:?}");
    // Sums of 64 equal parts.
    assert!((found.irradiance / RADIANCE - PI).abs().max_element() < 1e-5, "{}", found.irradiance);
}

/// Sides of the window in the wall x = −2.
const LOW: (f32, f32) = (0.8, -0.6);
const HIGH: (f32, f32) = (2.1, 0.7);

/// A closed room but for a window, and what stands in it.
fn room_with_window(parts: &mut SceneParts) {
    let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
    let (x, y, z) = (Vec3::X, Vec3::Y, Vec3::Z);
    parts.add_quad("floor", white, Vec3::new(-2.0, 0.0, 2.0), 4.0 * x, -4.0 * z);
    parts.add_quad("ceiling", white, Vec3::new(-2.0, 2.5, -2.0), 4.0 * x, 4.0 * z);
    parts.add_quad("back", white, Vec3::new(-2.0, 0.0, -2.0), 4.0 * x, 2.5 * y);
    parts.add_quad("front", white, Vec3::new(2.0, 0.0, 2.0), -4.0 * x, 2.5 * y);
    parts.add_quad("right", white, Vec3::new(2.0, 0.0, -2.0), 4.0 * z, 2.5 * y);
    let mut wall = |low: (f32, f32), high: (f32, f32)| {
        let corner = Vec3::new(-2.0, low.0, low.1);
        parts.add_quad("left", white, corner, (high.0 - low.0) * y, (high.1 - low.1) * z);
    };
    wall((0.0, -2.0), (2.5, LOW.1));
    wall((0.0, HIGH.1), (2.5, 2.0));
    wall((0.0, LOW.1), (LOW.0, HIGH.1));
    wall((HIGH.0, LOW.1), (2.5, HIGH.1));
}

/// Lambert's formula for the window, by unit radiance.
fn window_from(position: Vec3) -> f32 {
    let corners = [(LOW.0, LOW.1), (LOW.0, HIGH.1), (HIGH.0, HIGH.1), (HIGH.0, LOW.1)]
        .map(|(y, z)| Vec3::new(-2.0, y, z));
    let directions = corners.map(|c| (c - position).normalize_or_zero().as_dvec3());
    let edge = |k: usize| {
        let (a, b) = (directions[k], directions[(k + 1) % 4]);
        a.angle_between(b) * a.cross(b).normalize().y
    };
    (0.5 * (0..4).map(edge).sum::<f64>().abs()) as f32
}

/// Cells are quartered until 0.4/√32 of the light is left uncertain. The root of the mean square of 64 values is known to a
/// sixteenth of itself times √2: three times that.
fn uncertain() -> f32 {
    0.4 / (SAMPLES as f32).sqrt() * 1.27
}

#[test]
fn through_a_window_it_is_what_the_window_would_send() {
    let scene = under_the_sky(room_with_window);
    let tracer = Tracer::new(&scene);
    let lights = Lights::new(&tracer, LightParams::default());
    const SEEDS: u32 = 64;
    let mut rays_of = [0; 2];
    for at in [-1.5, -0.5, 0.5, 1.7] {
        let receiver = on_floor(&tracer, at, 0.4);
        let expected = window_from(receiver.position);
        // What others see an arm's length away.
        let views = [-0.3, 0.3].map(|offset| {
            skylight(&lights, &on_floor(&tracer, (at + offset).max(-1.95), 0.4), None, 1000).0.view
        });
        let beside = SkyView::beside(receiver.normal, views.into_iter());
        for (way, beside) in [None, beside.as_ref()].into_iter().enumerate() {
            let (mut sum, mut squares, mut foretold) = (0.0, 0.0, 0.0);
            for seed in 0..SEEDS {
                let (found, rays) = skylight(&lights, &receiver, beside, seed);
                let value = f64::from(found.irradiance.x / expected);
                assert!((found.irradiance / RADIANCE - found.irradiance.x).abs().max_element() < 1e-5);
                sum += value;
                squares += (value - 1.0).powi(2);
                // Of all three channels together.
                foretold += f64::from(found.variance / (6.0 * expected).powi(2));
                rays_of[way] += rays;
            }
            let count = f64::from(SEEDS);
            let (mean, deviation) = (sum / count, (squares / count).sqrt());
            assert!(deviation < f64::from(uncertain()), "{at}, {way}: {deviation}");
            assert!((mean - 1.0).abs() < 4.0 * deviation / count.sqrt(), "{at}, {way}: {mean} ± {deviation}");
            // The variance that is told is an expectation over all borders: this one by a factor.
            let told = (foretold / count).sqrt();
            assert!(told < 3.0 * deviation && deviation < 3.0 * told, "{at}, {way}: {told} for {deviation}");
        }
    }
    // Most of both follow the border.
    assert!(5 * rays_of[1] < 4 * rays_of[0], "{rays_of:?}");
}

/// A long wall of height h leaves (1 + cosθ)/2 of the sky at its foot, tanθ = h/d; this one ends 100 m away, by the square of that.
#[test]
fn beside_a_wall_it_is_what_the_wall_leaves() {
    let scene = under_the_sky(|parts| {
        let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
        parts.add_quad("floor", white, Vec3::new(-9.0, 0.0, 9.0), Vec3::X * 18.0, Vec3::Z * -18.0);
        parts.add_quad("wall", white, Vec3::new(-1.0, 0.0, 100.0), Vec3::Z * -200.0, Vec3::Y * 2.0);
    });
    let tracer = Tracer::new(&scene);
    let lights = Lights::new(&tracer, LightParams::default());
    for distance in [0.2_f32, 1.0, 5.0] {
        let receiver = on_floor(&tracer, -1.0 + distance, 0.0);
        let expected = 0.5 * PI * (1.0 + distance / distance.hypot(2.0));
        let found: Vec<f32> =
            (0..64).map(|seed| skylight(&lights, &receiver, None, seed).0.irradiance.x / expected).collect();
        let mean = found.iter().sum::<f32>() / 64.0;
        let deviation = (found.iter().map(|v| (v - 1.0).powi(2)).sum::<f32>() / 64.0).sqrt();
        assert!(deviation < uncertain(), "{distance}: {deviation}");
        assert!((mean - 1.0).abs() < 4.0 * deviation / 8.0, "{distance}: {mean} ± {deviation}");
    }
}

/// What a receiver has seen is the same for one that is turned the other way round, and known for one that leans.
#[test]
fn views_turn_with_the_receiver() {
    let scene = under_the_sky(room_with_window);
    let tracer = Tracer::new(&scene);
    let lights = Lights::new(&tracer, LightParams::default());
    let upright = on_floor(&tracer, -0.5, 0.0);
    let (from_above, _) = skylight(&lights, &upright, None, 3);
    let leaning = Receiver { normal: Vec3::new(-0.5, 0.7, 0.1).normalize_or_zero(), ..upright };
    let beside = SkyView::beside(leaning.normal, std::iter::once(from_above.view));
    let values = |beside: Option<&SkyView>| -> Vec<f32> {
        (0..64).map(|seed| skylight(&lights, &leaning, beside, seed).0.irradiance.x).collect()
    };
    let mean = |values: &[f32]| values.iter().sum::<f32>() / 64.0;
    let [alone, helped] = [None, beside.as_ref()].map(values);
    let deviation = |values: &[f32]| {
        let mean = mean(values);
        (values.iter().map(|v| (v - mean).powi(2)).sum::<f32>() / 64.0).sqrt()
    };
    // As exact with as without: nothing that matters is missed.
    assert!(deviation(&helped) < 2.0 * deviation(&alone), "{} {}", deviation(&helped), deviation(&alone));
    let error = 4.0 * (deviation(&helped) + deviation(&alone)) / 8.0;
    assert!((mean(&helped) - mean(&alone)).abs() < error, "{} {}", mean(&helped), mean(&alone));
}
