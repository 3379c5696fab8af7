//! Lamps in lenses against the same lamps without glass, which does nothing where its index is 1.

use catoptric_light::irradiance::{LensBeside, LensLight, LensSeen, Scratch};
use catoptric_light::{LightParams, Lights, Receiver};
use catoptric_scene::{Barycentric, Material, Radiance, Rgb, Scene, SceneParts, Side, TriangleId};
use catoptric_trace::Tracer;
use catoptric_trace::sequence::{Key, Purpose};
use glam::Vec3;

const BULB: Vec3 = Vec3::new(0.0, 1.0, 0.0);

/// A floor, a bulb of 10 cm above it in a ball of this index and 25 cm, if any, and perhaps something else.
fn scene(ior: Option<f32>, more: impl FnOnce(&mut SceneParts)) -> Scene {
    let mut parts = SceneParts::default();
    let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
    parts.add_quad("floor", white, Vec3::new(-2.0, 0.0, 2.0), Vec3::X * 4.0, Vec3::Z * -4.0);
    let lamp = parts.add_material(Material::emitter("bulb", Radiance(Rgb::new(3.0, 10.0, 5.0))));
    // Not so finely divided that it is a ball to its receivers: the truth is what its facets send.
    parts.add_sphere("bulb", lamp, BULB, 0.1, 12);
    if let Some(ior) = ior {
        let glass = parts.add_material(Material::glass("glass", ior));
        parts.add_sphere("globe", glass, BULB, 0.25, 32);
    }
    more(&mut parts);
    Scene::new(parts).expect("a valid scene")
}

/// A point of the floor, which is the first quad.
fn on_floor(tracer: &Tracer, x: f32, z: f32) -> Receiver {
    let receiver = Receiver::on(tracer, TriangleId(0), Side::Front, Barycentric { u: 0.0, v: 0.0 });
    Receiver { position: Vec3::new(x, 0.0, z), ..receiver }
}

fn lights<'a>(tracer: &'a Tracer<'a>) -> Lights<'a> {
    let mut lights = Lights::new(tracer, LightParams::default());
    let spots = (0..16).map(|k| on_floor(tracer, (k % 4) as f32 * 0.8 - 1.2, (k / 4) as f32 * 0.8 - 1.2));
    lights.find_lenses(&spots.collect::<Vec<_>>(), 1);
    lights
}

/// What a receiver sees in the one lens, beside others, and with how many rays.
fn look(lights: &Lights, receiver: &Receiver, beside: LensBeside, seed: u32) -> (LensLight, LensSeen, u64) {
    let (mut scratch, mut seen) = (Scratch::default(), Vec::new());
    let key = Key::new(seed, Purpose::Emitter, 0);
    let found = lights.through_lenses(receiver, 64, |_| beside, &mut seen, key, &mut scratch);
    (found, seen[0], scratch.rays)
}

/// Mean over seeds of what is found, over what is true, and the deviation of one.
fn statistics(truth: f32, seeds: u32, found: impl Fn(u32) -> LensLight) -> (f32, f32) {
    let shares: Vec<f32> = (0..seeds).map(|seed| found(seed).irradiance.y / truth).collect();
    let mean = shares.iter().sum::<f32>() / seeds as f32;
    let squares: f32 = shares.iter().map(|s| (s - mean).powi(2)).sum();
    (mean, (squares / (seeds - 1) as f32).sqrt())
}

#[test]
fn glass_that_bends_nothing_shows_the_lamp_as_it_is() {
    let bare = scene(None, |_| {});
    let tracer = Tracer::new(&bare);
    let plain = Lights::new(&tracer, LightParams::default());
    let globe = scene(Some(1.0), |_| {});
    let glass = Tracer::new(&globe);
    let lights = lights(&glass);
    assert_eq!(lights.lenses().len(), 1);
    for (x, z) in [(0.0, 0.0), (0.7, -0.4), (-1.8, 1.5)] {
        let key = Key::new(0, Purpose::Emitter, 0);
        let truth = plain.direct(&on_floor(&tracer, x, z), 64, key, &mut Scratch::default()).irradiance.y;
        let receiver = on_floor(&glass, x, z);
        // The lamp takes 41 of 256 cells, whose border is 23 long: √(23/6)/41 = 4.8 % of deviation, of 64 seeds .6 %.
        let (mean, one) =
            statistics(truth, 64, |seed| look(&lights, &receiver, LensBeside::default(), seed).0);
        assert!((mean - 1.0).abs() < 0.02 && one < 0.07, "{mean} {one}");
        // By the border that others have seen, cells of half the length: 1.7 %, and .2 %.
        let near = [0.02, -0.02].map(|step| {
            let beside = on_floor(&glass, x + step, z);
            look(&lights, &beside, LensBeside::default(), 100).1
        });
        let beside = LensBeside::of(near.into_iter(), false);
        let (mean, one) = statistics(truth, 64, |seed| look(&lights, &receiver, beside, seed).0);
        assert!((mean - 1.0).abs() < 0.007 && one < 0.03, "{mean} {one}");
    }
}

#[test]
fn between_receivers_who_see_all_of_it_four_rays_do_and_find_what_stands_before_it() {
    let sheet = |parts: &mut SceneParts| {
        let black = parts.add_material(Material::lambertian("black", Rgb::ZERO));
        parts.add_quad("sheet", black, Vec3::new(-0.2, 0.1, -0.2), Vec3::Z * 0.4, Vec3::X * 0.4);
    };
    let (free, blocked) = (scene(Some(1.0), |_| {}), scene(Some(1.0), sheet));
    let [free, blocked] = [&free, &blocked].map(Tracer::new);
    let [free_lights, blocked_lights] = [&free, &blocked].map(lights);
    let ends: Vec<(LensLight, LensSeen)> = [-1.0, 1.0]
        .map(|x| {
            let (light, seen, rays) =
                look(&blocked_lights, &on_floor(&blocked, x, 0.0), LensBeside::default(), 1);
            assert!(light.even && rays > 256, "{light:?} {rays}");
            (light, seen)
        })
        .to_vec();
    let beside = |between| LensBeside::of(ends.iter().map(|end| end.1), between);
    let (known, _, rays) = look(&free_lights, &on_floor(&free, 0.0, 0.0), beside(true), 2);
    let asked = look(&free_lights, &on_floor(&free, 0.0, 0.0), beside(false), 2).0;
    assert_eq!(rays, 4);
    // The ends are by 4.8 % of deviation each, their mean by 3.4 %.
    assert!((known.irradiance.y / asked.irradiance.y - 1.0).abs() < 0.1, "{known:?} {asked:?}");
    let (dark, _, rays) = look(&blocked_lights, &on_floor(&blocked, 0.0, 0.0), beside(true), 2);
    assert!(dark.irradiance == Rgb::ZERO && rays > 4, "{dark:?} {rays}");
}

#[test]
fn what_shows_lamps_small_or_to_few_is_no_lens() {
    // A lamp beside a ball of glass: all but those in its focus see little of the lamp in it.
    let mut parts = SceneParts::default();
    let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
    parts.add_quad("floor", white, Vec3::new(-2.0, 0.0, 2.0), Vec3::X * 4.0, Vec3::Z * -4.0);
    let lamp = parts.add_material(Material::emitter("bulb", Radiance(Rgb::splat(10.0))));
    parts.add_sphere("bulb", lamp, Vec3::new(0.0, 1.8, 0.0), 0.1, 16);
    let glass = parts.add_material(Material::glass("glass", 1.5));
    parts.add_sphere("ball", glass, BULB, 0.25, 32);
    let scene = Scene::new(parts).expect("a valid scene");
    let tracer = Tracer::new(&scene);
    assert!(lights(&tracer).lenses().is_empty());
}
