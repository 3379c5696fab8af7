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

fn look(lights: &Lights, receiver: &Receiver, closely: bool, seed: u32) -> Skylight {
    lights.look_at_sky(receiver, closely, Key::new(seed, Purpose::Emitter, 0), &mut Scratch::default())
}

#[test]
fn where_nothing_is_in_the_way_it_is_exact() {
    let scene = under_the_sky(|parts| {
        let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
        parts.add_quad("floor", white, Vec3::new(-2.0, 0.0, 2.0), Vec3::X * 4.0, Vec3::Z * -4.0);
    });
    let tracer = Tracer::new(&scene);
    let lights = Lights::new(&tracer, LightParams::default());
    let receiver = on_floor(&tracer, 0.3, -0.2);
    let looks = [true, false].map(|closely| look(&lights, &receiver, closely, 1));
    for found in [skylight(&lights, &receiver, None, 1).0].into_iter().chain(looks) {
        assert!(found.even && found.variance == 0.0, "{found:?}");
        // Sums of 64 equal parts, or of 256.
        assert!((found.irradiance / RADIANCE - PI).abs().max_element() < 1e-5, "{}", found.irradiance);
    }
}

/// A window in the wall x = −2: its low and high corner, (y, z).
struct Window {
    low: (f32, f32),
    high: (f32, f32),
}

const LARGE: Window = Window { low: (0.8, -0.6), high: (2.1, 0.7) };
/// 6° to 12° above the floor at the other end of the room, a thousandth of the light there.
const SMALL: Window = Window { low: (0.4, -0.2), high: (0.8, 0.6) };

/// A closed room but for a window.
fn room_with_window(parts: &mut SceneParts, window: &Window) {
    let &Window { low, high } = window;
    let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
    let (x, y, z) = (Vec3::X, Vec3::Y, Vec3::Z);
    parts.add_quad("floor", white, Vec3::new(-2.0, 0.0, 2.0), 4.0 * x, -4.0 * z);
    parts.add_quad("ceiling", white, Vec3::new(-2.0, 2.5, -2.0), 4.0 * x, 4.0 * z);
    parts.add_quad("back", white, Vec3::new(-2.0, 0.0, -2.0), 4.0 * x, 2.5 * y);
    parts.add_quad("front", white, Vec3::new(2.0, 0.0, 2.0), -4.0 * x, 2.5 * y);
    parts.add_quad("right", white, Vec3::new(2.0, 0.0, -2.0), 4.0 * z, 2.5 * y);
    let mut wall = |from: (f32, f32), to: (f32, f32)| {
        let corner = Vec3::new(-2.0, from.0, from.1);
        parts.add_quad("left", white, corner, (to.0 - from.0) * y, (to.1 - from.1) * z);
    };
    wall((0.0, -2.0), (2.5, low.1));
    wall((0.0, high.1), (2.5, 2.0));
    wall((0.0, low.1), (low.0, high.1));
    wall((high.0, low.1), (2.5, high.1));
}

/// Lambert's formula for a window, by unit radiance.
fn window_from(position: Vec3, &Window { low, high }: &Window) -> f32 {
    let corners = [(low.0, low.1), (low.0, high.1), (high.0, high.1), (high.0, low.1)]
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

/// Deviation and mean of the irradiance on the floor, relative to what the window sends, over seeds; the deviation that is told; rays.
/// `others`: whether receivers an arm's length away have looked before.
fn through_window(window: &Window, x: f32, others: bool) -> ([f64; 3], u64) {
    let scene = under_the_sky(|parts| room_with_window(parts, window));
    let tracer = Tracer::new(&scene);
    let lights = Lights::new(&tracer, LightParams::default());
    let receiver = on_floor(&tracer, x, 0.4);
    let expected = window_from(receiver.position, window);
    let (mut sum, mut squares, mut foretold, mut rays) = (0.0, 0.0, 0.0, 0);
    for seed in 0..SEEDS {
        let views = AROUND.iter().zip(0..).map(|(&(dx, dz), index)| {
            let beside = on_floor(&tracer, (x + dx).clamp(-1.95, 1.95), 0.4 + dz);
            look(&lights, &beside, true, 1000 + AROUND.len() as u32 * seed + index).view
        });
        let beside = SkyView::beside(receiver.normal, views).filter(|_| others);
        let (found, own) = skylight(&lights, &receiver, beside.as_ref(), seed);
        let value = f64::from(found.irradiance.x / expected);
        assert!((found.irradiance / RADIANCE - found.irradiance.x).abs().max_element() < 1e-5);
        sum += value;
        squares += (value - 1.0).powi(2);
        // Of all three channels together.
        foretold += f64::from(found.variance / (6.0 * expected).powi(2));
        rays += own;
    }
    let count = f64::from(SEEDS);
    ([(squares / count).sqrt(), sum / count, (foretold / count).sqrt()], rays)
}

const SEEDS: u32 = 64;

/// The neighbours of a vertex in a mesh of squares cut in two, (x, z).
const AROUND: [(f32, f32); 6] = [(-0.3, 0.0), (0.3, 0.0), (0.0, -0.3), (0.0, 0.3), (-0.3, -0.3), (0.3, 0.3)];

#[test]
fn through_a_window_it_is_what_the_window_would_send() {
    let mut rays = [0; 2];
    for x in [-1.5, -0.5, 0.5, 1.7] {
        for others in [false, true] {
            let ([deviation, mean, told], own) = through_window(&LARGE, x, others);
            rays[usize::from(others)] += own;
            assert!(deviation < f64::from(uncertain()), "{x}, {others}: {deviation}");
            let error = deviation / f64::from(SEEDS).sqrt();
            assert!((mean - 1.0).abs() < 4.0 * error, "{x}, {others}: {mean} ± {error}");
            // The variance that is told is an expectation over all borders: this one by a factor.
            assert!(
                told < 3.0 * deviation && deviation < 3.0 * told,
                "{x}, {others}: {told} for {deviation}"
            );
        }
    }
    // Most of both follow the border.
    assert!(5 * rays[1] < 4 * rays[0], "{rays:?}");
}

#[test]
fn small_windows_are_found_by_what_others_saw() {
    for x in [0.5, 1.2, 1.7] {
        let (alone, among) = (through_window(&SMALL, x, false), through_window(&SMALL, x, true));
        let ([deviation, mean, _], rays) = among;
        // A window of n finest cells, a 4096th of the hemisphere each, has a border of 4√n of them, and a variance of 1/6 in each;
        // known to within 1.27 as above.
        let n = 4096.0 * f64::from(window_from(Vec3::new(x, 0.0, 0.4), &SMALL) / PI);
        assert!(deviation < 1.27 * (4.0 * n.sqrt() / 6.0).sqrt() / n, "{x}: {deviation} of {n}");
        assert!((mean - 1.0).abs() < 4.0 * deviation / f64::from(SEEDS).sqrt(), "{x}: {mean}");
        assert!(2 * rays < alone.1, "{x}: {rays} of {}", alone.1);
    }
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
        let at = |dx: f32, dz: f32| on_floor(&tracer, -1.0 + (distance + dx).max(0.05), dz);
        let receiver = at(0.0, 0.0);
        let expected = 0.5 * PI * (1.0 + distance / distance.hypot(2.0));
        for others in [false, true] {
            let (mut found, mut rays) = (Vec::new(), 0);
            for seed in 0..64 {
                let views = AROUND.iter().zip(0..).map(|(&(dx, dz), index)| {
                    look(&lights, &at(dx, dz), true, 1000 + AROUND.len() as u32 * seed + index).view
                });
                let beside = SkyView::beside(receiver.normal, views).filter(|_| others);
                let (sky, own) = skylight(&lights, &receiver, beside.as_ref(), seed);
                found.push(sky.irradiance.x / expected);
                rays += own;
            }
            let mean = found.iter().sum::<f32>() / 64.0;
            let deviation = (found.iter().map(|v| (v - 1.0).powi(2)).sum::<f32>() / 64.0).sqrt();
            assert!(deviation < uncertain(), "{distance}, {others}: {deviation}");
            assert!((mean - 1.0).abs() < 4.0 * deviation / 8.0, "{distance}, {others}: {mean} ± {deviation}");
            // Others know the border well enough: no own look at corners, but a ray into each of 64 cells or their quarters.
            assert!(!others || rays <= 64 * 4 * 64, "{distance}: {rays}");
        }
    }
}

/// What a receiver has seen is the same for one that is turned the other way round, and known for one that leans.
#[test]
fn views_turn_with_the_receiver() {
    let scene = under_the_sky(|parts| room_with_window(parts, &LARGE));
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
