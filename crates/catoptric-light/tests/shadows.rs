//! Shadows that are cut out of sources, against their brute force.

use catoptric_light::irradiance::{Samples, Scratch};
use catoptric_light::{LightParams, Lights, Receiver};
use catoptric_scene::{
    AlphaMode, Barycentric, Material, Radiance, Rgb, Scene, SceneParts, Side, Transmission, TriangleId,
};
use catoptric_trace::sequence::{Key, Purpose};
use catoptric_trace::{PlaneId, Tracer};
use glam::Vec3;

fn point(key: Key, index: u32) -> Vec3 {
    let [a, b] = [key.point2(index), key.child(1).point2(index)];
    Vec3::new(a.x, a.y, b.x) * 2.0 - 1.0
}

/// Corner and edges of the emitter, which shines downwards.
const EMITTER: [Vec3; 3] = [Vec3::new(-0.4, 2.0, -0.3), Vec3::new(0.9, 0.0, 0.0), Vec3::new(0.0, 0.0, 0.7)];

/// An emitter over a few boxes and cards, some of which reach through its plane; the last triangles are receivers' scrap.
fn scene(case: u64, card: Material, more: impl Fn(&mut SceneParts)) -> Scene {
    let key = Key::new(3, Purpose::Test, case);
    let mut parts = SceneParts::default();
    let glowing = parts.add_material(Material::emitter("glowing", Radiance(Rgb::ONE)));
    let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
    let card = parts.add_material(card);
    let [corner, u, v] = EMITTER;
    parts.add_quad("emitter", glowing, corner, u, v);
    for index in 0..2 {
        let low = point(key, index) * Vec3::new(0.6, 0.5, 0.6) + Vec3::Y;
        let size = Vec3::splat(0.15) + point(key.child(2), index).abs() * Vec3::new(0.3, 0.5, 0.3);
        parts.add_box("block", white, low, low + size, false);
        let at = point(key.child(3), index) * Vec3::new(0.6, 0.4, 0.6) + Vec3::Y * 1.2;
        let [u, v] = [4, 5].map(|k| point(key.child(k), index) * 0.4);
        parts.add_quad("card", card, at, u, v);
    }
    more(&mut parts);
    parts.add_quad("scrap", white, Vec3::Y * -50.0, Vec3::Z, Vec3::X);
    Scene::new(parts).expect("a valid scene")
}

fn receiver(tracer: &Tracer, key: Key) -> Receiver {
    let last = TriangleId(tracer.scene().triangles().len() as u32 - 1);
    let on = Receiver::on(tracer, last, Side::Front, Barycentric { u: 0.3, v: 0.3 });
    let position = point(key, 0) * Vec3::new(1.0, 0.3, 1.0);
    let geometric = (point(key, 1) * 0.8 + Vec3::Y).normalize_or(Vec3::Y);
    let normal = (geometric + point(key, 2) * 0.2).normalize_or(Vec3::Y);
    Receiver { position, plane: PlaneId::NONE, normal, geometric, ..on }
}

/// Points of the emitter in each direction, for the brute force.
const GRID: u32 = 48;

/// Irradiance by midpoints of a grid on the emitter; `seen` is what of the light of a point arrives.
fn by_grid(receiver: &Receiver, seen: impl Fn(Vec3) -> (Rgb, Vec3)) -> f64 {
    let [corner, u, v] = EMITTER;
    let area = f64::from(u.cross(v).length()) / f64::from(GRID * GRID);
    let mut sum = 0.0;
    for i in 0..GRID * GRID {
        let [s, t] = [i % GRID, i / GRID].map(|k| (k as f32 + 0.5) / GRID as f32);
        let (share, image) = seen(corner + u * s + v * t);
        let (offset, facing) = (image - receiver.position, (image.y - receiver.position.y).abs());
        let r2 = f64::from(offset.length_squared());
        let cos = receiver.normal.dot(offset).max(0.0);
        if receiver.geometric.dot(offset) > 0.0 {
            sum += f64::from(share.x * cos * facing) / (r2 * r2) * area;
        }
    }
    sum
}

/// What is asked at a receiver, the brute force, and the light that nothing blocks.
struct Answer {
    found: f64,
    expected: f64,
    open: f64,
}

/// Holds what is asked against the brute force at receivers below many scenes of blocks and cards, by `most_rays` each.
fn compare(
    name: &str,
    (seed, most_rays): (u32, u64),
    card: &Material,
    more: impl Fn(&mut SceneParts),
    mut ask: impl FnMut(&Lights, &Receiver, Key, &mut Scratch) -> Answer,
) {
    let (mut count, mut partial, mut sum) = (0_u32, 0, 0.0);
    // A shadow edge along the rows is off by up to half a cell, evenly distributed: by 1/√12 of a row. Two boxes have 6 edges each in
    // their outline, two cards 4: √(20/12)/GRID of the light on the whole, and three times that at most.
    let deviation = (20.0_f64 / 12.0).sqrt() / f64::from(GRID);
    for case in 0..40 {
        let scene = scene(case, card.clone(), &more);
        let tracer = Tracer::new(&scene);
        let lights = Lights::new(&tracer, LightParams::default());
        for index in 0..12 {
            let key = Key::new(seed, Purpose::Test, case * 100 + index);
            let receiver = receiver(&tracer, key);
            let mut scratch = Scratch::default();
            let Answer { found, expected, open } = ask(&lights, &receiver, key, &mut scratch);
            // A thousandth of what arrives where the emitter is faced: of those samples that find what a mirror takes, none may
            // lie above the horizon of the shading normal.
            if open <= 1e-4 {
                continue;
            }
            let difference = (found - expected) / open;
            assert!(difference.abs() < 3.0 * deviation, "{name}, {case}, {index}: {difference}");
            assert!(scratch.rays <= most_rays, "{name}: {} rays", scratch.rays);
            count += 1;
            partial += u32::from(found > 0.02 * open && found < 0.98 * open);
            sum += difference;
        }
    }
    assert!(count > 300 && partial > count / 5, "{name}: {partial} of {count} in penumbrae");
    let mean = sum / f64::from(count);
    assert!(mean.abs() < 3.0 * deviation / f64::from(count).sqrt(), "{name}: {mean}");
}

fn white_card() -> Material {
    Material::lambertian("card", Rgb::splat(0.5))
}

fn emitter(lights: &Lights) -> PlaneId {
    lights.emitters().cells()[0].plane
}

#[test]
fn light_behind_blockers_is_exact_and_takes_no_rays() {
    compare(
        "direct",
        (5, 0),
        &white_card(),
        |_| {},
        |lights, receiver, key, scratch| {
            let found = lights.direct(receiver, 32, key, scratch);
            let expected = by_grid(receiver, |p| {
                (lights.tracer().visibility(receiver.position, PlaneId::NONE, p, emitter(lights)), p)
            });
            let [found, open] = [found.irradiance, found.unoccluded].map(|light| f64::from(light.x));
            Answer { found, expected, open }
        },
    );
}

/// Mean of what many keys find behind panes, and the brute force.
fn behind_panes(lights: &Lights, receiver: &Receiver, key: Key, scratch: &mut Scratch) -> Answer {
    let found: Vec<_> = (0..64).map(|k| lights.direct(receiver, 32, key.child(k), scratch)).collect();
    let expected = by_grid(receiver, |p| {
        (lights.tracer().visibility(receiver.position, PlaneId::NONE, p, emitter(lights)), p)
    });
    let mean = found.iter().map(|f| f64::from(f.irradiance.x)).sum::<f64>() / found.len() as f64;
    Answer { found: mean, expected, open: f64::from(found[0].unoccluded.x) }
}

/// Deviation of single looks behind panes, relative to the light that nothing blocks; their mean over many keys is that of the brute force.
fn deviation_behind(name: &str, pane: &Material) -> f64 {
    let (mut squares, mut count) = (0.0, 0.0);
    let ask = |lights: &Lights, receiver: &Receiver, key: Key, scratch: &mut Scratch| {
        let Answer { found, expected, open } = behind_panes(lights, receiver, key, scratch);
        let one = lights.direct(receiver, 32, key, scratch).irradiance.x;
        if open > 1e-4 {
            squares += ((f64::from(one) - found) / open).powi(2);
            count += 1.0;
        }
        Answer { found, expected, open }
    };
    compare(name, (6, 65 * 32), pane, |_| {}, ask);
    let mean: f64 = squares / count;
    mean.sqrt()
}

/// What lets light pass is no blocker. Four rays find what a clear pane takes that light meets at less than 60°; where it is met at more, it has
/// edges as a tinted one, and all rays are taken.
#[test]
fn panes_before_a_source_thin_its_light_where_it_is_seen() {
    let pane = Material { transmission_kind: Transmission::Pane, ..Material::glass("pane", 1.5) };
    // As below. Half of the panes are met at less than 60°: what is beside them is brighter by a tenth, and an edge crosses √4 · 4/π of
    // 4 strata, √(2 · 2.5 · 0.01/6)/4 = 0.023. Beyond, by 0.4 on average, and all 32 are taken: √(2 · 7.2 · 0.16/6)/32 = 0.019. Were four
    // taken there, it would be 0.09 by the same count.
    let deviation = deviation_behind("panes", &pane);
    assert!(deviation < (0.5 * (0.023_f64.powi(2) + 0.019_f64.powi(2))).sqrt(), "{deviation}");
    // All light meets a window over everything at 45° or less.
    let window = |parts: &mut SceneParts| {
        let pane = parts.add_material(pane.clone());
        parts.add_quad("window", pane, Vec3::new(-4.0, 1.95, -4.0), Vec3::X * 8.0, Vec3::Z * 8.0);
    };
    compare("a window", (6, 64 * 4), &white_card(), window, behind_panes);
}

/// What is tinted has edges in the light: all rays are taken, and one key's are off by no more than strata on its edges allow.
#[test]
fn tinted_panes_before_a_source_take_all_rays() {
    let pane = Material { alpha_mode: AlphaMode::Blend, base_alpha: 0.3, ..white_card() };
    // An edge crosses some √32 · 4/π of 32 strata. Where it does, a sample of what is 0.3 lower beyond has a variance of 0.09/6
    // (the mean of x(1 − x)). Cards are half as large as the emitter seems from below: with one edge of each across, it is
    // √(2 · 7.2 · 0.015)/32 = 0.0145. Four samples deviate by 0.028.
    let deviation = deviation_behind("tinted panes", &pane);
    assert!(deviation < (2.0_f64 * 7.2 * 0.015).sqrt() / 32.0, "{deviation}");
}

/// A wall of silver on the left: its plane, and its outline.
const SILVER: f32 = -1.2;
const WALL: [Vec3; 3] = [Vec3::new(SILVER, 0.2, 1.0), Vec3::new(0.0, 0.0, -2.0), Vec3::new(0.0, 1.5, 0.0)];

/// Silver whose reflectance is 1 at every angle.
fn silver(parts: &mut SceneParts, [corner, u, v]: [Vec3; 3]) {
    let silver = parts.add_material(Material::mirror("silver", Rgb::ONE));
    parts.add_quad("mirror", silver, corner, u, v);
}

/// The brute force over the wall of silver, of which `reflects` tells where it does.
fn by_grid_in_silver(lights: &Lights, receiver: &Receiver, reflects: impl Fn(Vec3) -> bool) -> f64 {
    by_grid_in_wall(lights, receiver, |at| if reflects(at) { Rgb::ONE } else { Rgb::ZERO })
}

/// The same over a wall that reflects some share where it is met.
fn by_grid_in_wall(lights: &Lights, receiver: &Receiver, share: impl Fn(Vec3) -> Rgb) -> f64 {
    let [chain] = lights.chains().chains() else { panic!("one mirror, one chain") };
    let mirror = chain.planes[0];
    let free =
        |from, leaving, to, arriving| lights.tracer().visibility(from, leaving, to, arriving) == Rgb::ONE;
    by_grid(receiver, |p| {
        let image = Vec3::new(2.0 * SILVER - p.x, p.y, p.z);
        let t = (SILVER - receiver.position.x) / (image.x - receiver.position.x);
        let at = receiver.position.lerp(image, t);
        let is_seen = (0.2..1.7).contains(&at.y)
            && at.z.abs() < 1.0
            && free(receiver.position, PlaneId::NONE, at, mirror)
            && free(at, mirror, p, emitter(lights));
        (if is_seen { share(at) } else { Rgb::ZERO }, image)
    })
}

/// Blockers between receiver and mirror, and between mirror and source. Four rays find what the mirror takes. A sheet may be two mirrors
/// back to back in one plane: light comes over one of them.
#[test]
fn light_over_a_mirror_is_exact_behind_blockers() {
    let [corner, u, v] = WALL;
    for other_side in [false, true] {
        let wall = |parts: &mut SceneParts| {
            silver(parts, WALL);
            if other_side {
                silver(parts, [corner, v, u]);
            }
        };
        compare("mirrored", (7, 4), &white_card(), wall, |lights, receiver, key, scratch| {
            let found = lights.mirrored(receiver, 32, Rgb::ZERO, key, scratch);
            let [found, open] = [found.irradiance, found.unoccluded].map(|light| f64::from(light.x));
            Answer { found, expected: by_grid_in_silver(lights, receiver, |_| true), open }
        });
    }
}

/// A card in a mirror's own plane lies on it; mirrors that overlap are one. Found by rays, by their mean over many keys.
#[test]
fn mirrors_lie_on_each_other_once_and_cards_on_mirrors() {
    let [corner, u, v] = WALL;
    let half = [corner, 0.5 * u, v];
    let within = [corner + 0.1 * u, 0.5 * u, 0.5 * v];
    let across = [corner + 0.25 * u, 0.75 * u, v];
    let pieces: [(&str, &[[Vec3; 3]], bool); 3] = [
        ("one within another", &[WALL, within], false),
        ("halves that overlap", &[half, across], false),
        ("a card on a mirror", &[WALL], true),
    ];
    for (name, mirrors, has_card) in pieces {
        let wall = |parts: &mut SceneParts| {
            for &mirror in mirrors {
                silver(parts, mirror);
            }
            if has_card {
                let white = parts.add_material(white_card());
                parts.add_quad("card", white, half[0], half[1], half[2]);
            }
        };
        compare(name, (8, 64 * 32), &white_card(), wall, |lights, receiver, key, scratch| {
            let mut ask = |k| lights.mirrored(receiver, 32, Rgb::ZERO, key.child(k), scratch);
            let found: Vec<_> = (0..64).map(&mut ask).collect();
            let mean = found.iter().map(|f| f64::from(f.irradiance.x)).sum::<f64>() / found.len() as f64;
            // The wall runs from z = 1 to −1, the card to its middle.
            let expected = by_grid_in_silver(lights, receiver, |at| !has_card || at.z < 0.0);
            Answer { found: mean, expected, open: f64::from(found[0].unoccluded.x) }
        });
    }
}

/// Chips of four centimetres, about a hundred between receiver and emitter: more than shadows are cut out of.
fn chips(parts: &mut SceneParts) {
    let white = parts.add_material(white_card());
    let key = Key::new(9, Purpose::Test, 0);
    for index in 0..150 {
        let at = point(key, index) * Vec3::new(0.7, 0.35, 0.6) + Vec3::new(0.0, 1.1, 0.0);
        let [u, v] = [1, 2].map(|k| point(key.child(k), index) * 0.04);
        parts.add_quad("chip", white, at, u, v);
    }
}

/// What is known to arrive already, in times of what a dim mirror would reflect if it were silver: one sample does for its light …
const KNOWN: f32 = 4.0;
/// … and so many of these find the mean: the deviation of one is at most half, of all half a row of the grid at most.
const ALONE: u32 = 2048;

/// Reflectance of that mirror, at every angle.
const DIM: f32 = 0.05;

/// Light over a mirror that reflects a twentieth is worth one sample beside what is known, not those that silver would get, and right in
/// the mean.
#[test]
fn dim_mirrors_get_few_samples() {
    let dim = |parts: &mut SceneParts| {
        let [corner, u, v] = WALL;
        let dark = parts.add_material(Material::mirror("dark", Rgb::splat(DIM)));
        parts.add_quad("mirror", dark, corner, u, v);
        chips(parts);
    };
    compare("dim", (12, u64::from(ALONE)), &white_card(), dim, |lights, receiver, key, scratch| {
        let open = lights.mirrored(receiver, 32, Rgb::ZERO, key, scratch).unoccluded.x;
        scratch.rays = 0;
        let mut ask = |k| lights.mirrored(receiver, 32, Rgb::splat(KNOWN * open), key.child(k), scratch);
        let sum: f64 = (0..ALONE).map(|k| f64::from(ask(k).irradiance.x)).sum();
        let expected = by_grid_in_wall(lights, receiver, |_| Rgb::splat(DIM));
        Answer { found: sum / f64::from(ALONE), expected, open: f64::from(DIM * open) }
    });
}

/// What large blockers leave of a source is sampled, on average over many keys as the brute force finds it: straight, and over a mirror.
#[test]
fn what_walls_leave_is_sampled_among_chips() {
    let mean = |found: &[f64]| found.iter().sum::<f64>() / found.len() as f64;
    let rays = 64 * 32;
    compare("chips", (11, rays), &white_card(), chips, |lights, receiver, key, scratch| {
        let all: Vec<_> = (0..64).map(|k| lights.direct(receiver, 32, key.child(k), scratch)).collect();
        let found: Vec<f64> = all.iter().map(|f| f64::from(f.irradiance.x)).collect();
        let expected = by_grid(receiver, |p| {
            (lights.tracer().visibility(receiver.position, PlaneId::NONE, p, emitter(lights)), p)
        });
        Answer { found: mean(&found), expected, open: f64::from(all[0].unoccluded.x) }
    });
    let more = |parts: &mut SceneParts| {
        silver(parts, WALL);
        chips(parts);
    };
    compare("chips before a mirror", (7, rays), &white_card(), more, |lights, receiver, key, scratch| {
        let mut ask = |k| lights.mirrored(receiver, 32, Rgb::ZERO, key.child(k), scratch);
        let all: Vec<_> = (0..64).map(&mut ask).collect();
        let found: Vec<f64> = all.iter().map(|f| f64::from(f.irradiance.x)).collect();
        let expected = by_grid_in_silver(lights, receiver, |_| true);
        Answer { found: mean(&found), expected, open: f64::from(all[0].unoccluded.x) }
    });
}

/// Holds what the number of samples explains against what they are off by, and that is nothing where no sample decides.
fn doubt_is_as_large_as_samples_are_off(more: impl Fn(&mut SceneParts)) {
    let scene = scene(11, white_card(), more);
    let tracer = Tracer::new(&scene);
    let lights = Lights::new(&tracer, LightParams::default());
    let mut scratch = Scratch::default();
    for count in [8, 64] {
        let (mut off, mut doubt, mut sampled) = (0.0, 0.0, 0);
        for case in 0..256 {
            let key = Key::new(5, Purpose::Test, case);
            let receiver = receiver(&tracer, key);
            let all: Vec<_> =
                (0..16).map(|k| lights.direct(&receiver, count, key.child(k), &mut scratch)).collect();
            let first = all[0];
            assert_eq!(first.doubt > 0.0, first.sampled, "{first:?}");
            if first.sampled {
                let found = all.iter().map(|found| f64::from(found.irradiance.element_sum()));
                let mean = found.clone().sum::<f64>() / 16.0;
                off += found.map(|found| (found - mean).powi(2)).sum::<f64>() / 15.0;
                doubt += f64::from(first.doubt).powi(2);
                sampled += 1;
            }
        }
        assert!(sampled >= 64, "{sampled}");
        // It is said of a border, ½ n^-¾. Behind chips as small as strata n samples are as independent ones, ½ n^-½ at most.
        let ratio = (off / doubt).sqrt();
        let most = f64::from(count).sqrt().sqrt();
        assert!(ratio > 0.5 && ratio < most, "{count}: {ratio}");
    }
}

#[test]
fn doubt_of_shadows_is_as_large_as_samples_are_off() {
    doubt_is_as_large_as_samples_are_off(chips);
}

/// A lamp in the plane of another covers half of it: how bright they are changes at a border, though nothing blocks.
#[test]
fn doubt_of_what_shines_unevenly_is_as_large_as_samples_are_off() {
    doubt_is_as_large_as_samples_are_off(|parts| {
        let bright = parts.add_material(Material::emitter("bright", Radiance(Rgb::splat(3.0))));
        let [corner, u, v] = EMITTER;
        parts.add_quad("beside", bright, corner + 0.5 * u, u, v);
    });
}

/// A sky of 6 m behind a window of half a metre with two hundred slats: of 32 rays to anywhere in the sky less than one would pass the window.
#[test]
fn rays_go_where_walls_leave_a_window() {
    let mut parts = SceneParts::default();
    let glowing = parts.add_material(Material::emitter("glowing", Radiance(Rgb::ONE)));
    let white = parts.add_material(white_card());
    parts.add_quad("sky", glowing, Vec3::new(-3.0, -3.0, -2.0), Vec3::X * 6.0, Vec3::Y * 6.0);
    let (low, high) = (0.25, 4.0);
    for (from, to) in [
        ([-high, low], [high, high]),
        ([-high, -high], [high, -low]),
        ([-high, -low], [-low, low]),
        ([low, -low], [high, low]),
    ] {
        let corner = Vec3::new(from[0], from[1], -1.0);
        parts.add_quad("wall", white, corner, Vec3::X * (to[0] - from[0]), Vec3::Y * (to[1] - from[1]));
    }
    // Half of the window is open.
    for slat in 0..200_u8 {
        let y = -low + 0.0025 * f32::from(slat);
        parts.add_quad("slat", white, Vec3::new(-low, y, -0.98), Vec3::X * 0.5, Vec3::Y * 0.00125);
    }
    parts.add_quad("scrap", white, Vec3::new(-0.1, 0.05, 0.0), Vec3::X * 0.2, Vec3::Y * 0.2);
    let scene = Scene::new(parts).expect("a valid scene");
    let tracer = Tracer::new(&scene);
    let lights = Lights::new(&tracer, LightParams::default());
    let last = TriangleId(scene.triangles().len() as u32 - 1);
    // Turned to the window.
    let on = Receiver::on(&tracer, last, Side::Front, Barycentric { u: 0.3, v: 0.3 });
    let receiver = Receiver { normal: -on.normal, geometric: -on.geometric, ..on };
    let mut scratch = Scratch::default();
    let mut ask = |samples: Samples, key: u64| {
        let found = lights.direct(&receiver, samples, Key::new(5, Purpose::Test, key), &mut scratch);
        f64::from(found.irradiance.x)
    };
    let expected = ask(Samples { shadows: 0, ..Samples::from(1 << 18) }, 0);
    let squares: f64 = (1..101).map(|key| (ask(Samples::from(32), key) / expected - 1.0).powi(2)).sum();
    // Of rays to the window each passes with a half: at random they would deviate by 1/√32, those to all of the sky by more than 1.
    // The deviation of a hundred keys is known to 1/√200 of it; a fifth is nearly three times that.
    let deviation = (squares / 100.0).sqrt();
    assert!(deviation < 1.2 / 32_f64.sqrt(), "{deviation}");
}

/// Lamps behind a card, a hundred times as bright as a window that is seen at a grazing angle past a bar: the window is all the light.
#[test]
fn where_the_brightest_is_hidden_the_rest_is_as_exact() {
    // Of so many sources the window would share its rays with others, as long as it seems to be little of the light.
    for lamps in [1, 9] {
        brightest_hidden(lamps);
    }
}

fn brightest_hidden(lamps: u8) {
    let mut parts = SceneParts::default();
    let glowing = |strength: f32| Material::emitter("glowing", Radiance(Rgb::splat(strength)));
    let (bright, dim) = (parts.add_material(glowing(1000.0)), parts.add_material(glowing(10.0)));
    let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
    let width = 0.4 / f32::from(lamps);
    for lamp in 0..lamps {
        let (left, height) = (-0.2 + f32::from(lamp) * width, 2.0 + 0.01 * f32::from(lamp));
        parts.add_quad("lamp", bright, Vec3::new(left, height, -0.2), Vec3::X * width, Vec3::Z * 0.4);
    }
    parts.add_quad("card", white, Vec3::new(-0.3, 1.9, -0.3), Vec3::X * 0.6, Vec3::Z * 0.6);
    parts.add_quad("window", dim, Vec3::new(-1.0, -0.5, -1.5), Vec3::X * 2.0, Vec3::Y * 0.8);
    parts.add_quad("bar", white, Vec3::new(-0.1, -0.5, -1.4), Vec3::X * 0.2, Vec3::Y * 0.8);
    parts.add_quad("floor", white, Vec3::new(-1.0, 0.0, 1.0), Vec3::X * 2.0, Vec3::Z * -2.0);
    let scene = Scene::new(parts).expect("a valid scene");
    let tracer = Tracer::new(&scene);
    let lights = Lights::new(&tracer, LightParams::default());
    let last = TriangleId(scene.triangles().len() as u32 - 1);
    let receiver = Receiver::on(&tracer, last, Side::Front, Barycentric { u: 0.4, v: 0.3 });
    let mut scratch = Scratch::default();
    let mut ask = |samples: Samples, key: u64| {
        let found = lights.direct(&receiver, samples, Key::new(5, Purpose::Test, key), &mut scratch);
        (f64::from(found.irradiance.x), f64::from(found.unoccluded.x))
    };
    // Nothing cut out: all rays. Their stratified shares are off by about n^(−3/4), 7e-4; one key in ten thousand by four times that.
    let (expected, open) = ask(Samples { shadows: 0, ..Samples::from(1 << 14) }, 0);
    assert!(expected > 0.01 && open > 50.0 * expected, "{expected} of {open}");
    for samples in [Samples::from(16), Samples::exact(8)] {
        for key in 1..9 {
            let (found, _) = ask(samples, key);
            assert!(
                (found / expected - 1.0).abs() < 3e-3,
                "{lamps} lamps, {samples:?}: {found}, expected {expected}"
            );
        }
    }
}
