//! Every light layer of every scene against the slow twin, in 8×8 block means; and what that comparison catches.
//!
//! One false alarm in a thousand runs of the whole family: the level is divided by the number of all comparisons.
//! A failing scene leaves `NAME.exr` (ours) and `NAME.twin.exr` in the target folder's `tmp`.

use std::path::{Path, PathBuf};

use catoptric_image::Image;
use catoptric_radiosity::{SolveParams, solve};
use catoptric_render::direct::{DirectLight, ShadowRays};
use catoptric_render::{RenderParams, render};
use catoptric_scene::{
    Camera, Lobe, Material, Radiance, Rgb, Scene, SceneParts, Silent, Sky, SkyImage, TriangleId, gltf,
};
use catoptric_solution::Quality;
use catoptric_tests::compare::{Allowance, Mismatch, compare, comparisons};
use catoptric_tests::twin::{self, LAYERS, Twin, TwinParams};
use catoptric_tests::{looking, white_room};
use catoptric_trace::Tracer;
use catoptric_trace::chain::Event;
use glam::Vec3;

const WIDTH: usize = 64;
const FAMILY: f64 = 1e-3;

fn scenes() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes");
    let mut paths: Vec<PathBuf> = std::fs::read_dir(folder)
        .expect("scenes/ is there")
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| path.extension().is_some_and(|e| e == "glb"))
        .collect();
    paths.sort();
    paths
}

fn name_of(path: &Path) -> String {
    path.file_stem().map_or(String::new(), |s| s.to_string_lossy().into_owned())
}

fn load(path: &Path) -> Scene {
    let loaded = gltf::load(path, &gltf::LoadOptions::default()).expect("scenes load");
    let mut parts = loaded.scene.into_parts();
    if name_of(path) == "sky_body" {
        parts.sky = Some(Sky::Uniform(Radiance(Rgb::ONE)));
    }
    Scene::new(parts).expect("a scene with a sky is valid")
}

/// What the twin cannot see: LS⁺D… of punctual lights through S (see its documentation).
fn is_comparable(scene: &Scene, layer: &str) -> bool {
    let found_by_particles = ["specular.mirrored", "specular.caustic", "specular.indirect"].contains(&layer);
    scene.lights().is_empty() || !found_by_particles
}

fn ours(scene: &Scene) -> Image {
    let tracer = Tracer::new(scene);
    let camera = scene.cameras().first().expect("scenes have a camera");
    let solved =
        solve(&tracer, &SolveParams::for_quality(Quality::Standard), &Silent).expect("not cancelled");
    let height = camera.height_for_width(WIDTH);
    let params = RenderParams { layers: true, ..RenderParams::for_quality(Quality::Standard, WIDTH, height) };
    render(&tracer, &solved.solution, camera, &params, &Silent).expect("not cancelled").image
}

fn twin_of(scene: &Scene, samples: u32) -> Twin {
    let camera = scene.cameras().first().expect("scenes have a camera");
    let height = camera.height_for_width(WIDTH);
    let params = TwinParams { width: WIDTH, height, samples, particles: PARTICLES, seed: 11 };
    twin::render(&Tracer::new(scene), camera, &params)
}

/// Leaves the pictures of a failing scene.
fn keep(name: &str, ours: &Image, twin: &Twin) {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let mut image = Image::new(twin.width, twin.height);
    for (name, layer) in LAYERS.iter().zip(&twin.layers) {
        let pixels: Vec<[f32; 3]> = layer.mean.iter().map(|m| m.as_vec3().to_array()).collect();
        image.push_rgb_layer(name, &pixels);
    }
    ours.write_exr(&folder.join(format!("{name}.exr"))).expect("the target folder can be written");
    image.write_exr(&folder.join(format!("{name}.twin.exr"))).expect("the target folder can be written");
}

/// Paths of the twin per pixel, and its light-side particles.
const SAMPLES: u32 = 32;
const PARTICLES: u32 = 300_000;

/// What is wrong with one scene; notes in `caught` which layers could not have been dropped or doubled unnoticed.
fn judge(name: &str, scene: &Scene, samples: u32, level: f64, caught: &mut Caught) -> Vec<String> {
    let (image, twin) = (ours(scene), twin_of(scene, samples));
    let mut failures: Vec<String> = Vec::new();
    for (index, layer) in LAYERS.iter().enumerate() {
        if !is_comparable(scene, layer) {
            continue;
        }
        let pixels = image.rgb(layer).expect("every layer is written");
        let test = |factor: f32| -> Vec<Mismatch> {
            let changed: Vec<[f32; 3]> = pixels.iter().map(|p| p.map(|v| v * factor)).collect();
            compare(&changed, &twin, &[layer], level, Allowance::default())
        };
        let mismatches = test(1.0);
        failures.extend(mismatches.iter().take(3).map(|m| format!("{name}: {m}")));
        // The mutations: a term dropped, a term counted twice.
        caught[index][0] |= mismatches.is_empty() && !test(0.0).is_empty();
        caught[index][1] |= mismatches.is_empty() && !test(2.0).is_empty();
    }
    if !failures.is_empty() {
        keep(name, &image, &twin);
    }
    failures
}

/// Per layer: a dropped term was noticed, a doubled one was.
type Caught = [[bool; 2]; LAYERS.len()];

/// Somebody notices if one of these layers is missing or doubled.
fn assert_caught(caught: &Caught, layers: &[&str]) {
    for layer in layers {
        let index = LAYERS.iter().position(|l| l == layer).expect("a layer");
        assert_eq!(caught[index], [true; 2], "nobody would notice if `{layer}` were missing or doubled");
    }
}

#[test]
fn every_layer_of_every_scene_agrees_and_no_term_can_go_missing() {
    let scenes = scenes();
    assert!(scenes.len() >= 8, "{scenes:?}");
    let level = FAMILY / (scenes.len() * comparisons(WIDTH, WIDTH, LAYERS.len())) as f64;
    let mut failures: Vec<String> = Vec::new();
    let mut caught: Caught = Default::default();
    for path in &scenes {
        failures.extend(judge(&name_of(path), &load(path), SAMPLES, level, &mut caught));
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
    for (layer, [dropped, doubled]) in LAYERS.iter().zip(caught) {
        assert!(dropped, "nobody would notice if `{layer}` were missing");
        assert!(doubled, "nobody would notice if `{layer}` were counted twice");
    }
}

/// A ground with a block, a mirror that throws the sun back at it and a ball of glass, under a sky of 16 × 32 texels one
/// of which, the sun, is 150 times as bright.
fn under_the_sun() -> Scene {
    let mut parts = SceneParts::default();
    let ground = parts.add_material(Material::lambertian("ground", Rgb::new(0.6, 0.55, 0.5)));
    let block = parts.add_material(Material::lambertian("block", Rgb::new(0.3, 0.5, 0.7)));
    let mirror = parts.add_material(Material::mirror("mirror", Rgb::new(0.9, 0.85, 0.8)));
    let glass = parts.add_material(Material::glass("glass", 1.5));
    parts.add_quad("ground", ground, Vec3::new(-4.0, 0.0, 4.0), Vec3::X * 8.0, Vec3::NEG_Z * 8.0);
    parts.add_box("block", block, Vec3::new(-1.4, 0.0, -0.9), Vec3::new(-0.4, 1.2, 0.1), false);
    parts.add_quad("mirror", mirror, Vec3::new(0.2, 0.0, -1.5), Vec3::X * 1.6, Vec3::new(0.0, 1.6, -0.3));
    parts.add_sphere("ball", glass, Vec3::new(0.9, 0.51, 0.4), 0.5, 24);
    let (width, height) = (32, 16);
    let mut texels = vec![[0.4, 0.5, 0.7]; width * height];
    // In front of the mirror, half-way up.
    texels[4 * width + 29] = [150.0, 140.0, 120.0];
    parts.sky = Some(Sky::Image(SkyImage { width, height, texels }));
    parts.cameras.push(looking(Vec3::new(0.4, 1.9, 4.2), Vec3::new(0.1, 0.4, 0.0), 0.7));
    Scene::new(parts).expect("the scene is valid")
}

#[test]
fn a_sky_with_a_small_sun_agrees() {
    let scene = under_the_sun();
    let level = FAMILY / comparisons(WIDTH, WIDTH, LAYERS.len()) as f64;
    let mut caught: Caught = Default::default();
    // The twin meets the sun by chance: one path in a hundred.
    let failures = judge("under_the_sun", &scene, 16 * SAMPLES, level, &mut caught);
    assert!(failures.is_empty(), "{}", failures.join("\n"));
    assert_caught(&caught, &["direct", "mirrored", "indirect"]);
}

/// A closed room with a lamp behind a screen of tinted glass that has both its faces, a mirror that shows the lamp through it, and a block.
fn behind_a_sheet(thickness: f32) -> Scene {
    let (mut parts, white) = white_room();
    let mirror = parts.add_material(Material::mirror("mirror", Rgb::new(0.9, 0.85, 0.8)));
    let lamp = parts.add_material(Material::emitter("lamp", Radiance(Rgb::splat(20.0))));
    let tinted = Material { absorption: Rgb::new(20.0, 5.0, 0.0), ..Material::glass("sheet", 1.5) };
    let glass = parts.add_material(tinted);
    parts.add_quad("lamp", lamp, Vec3::new(-0.2, 1.5, -1.3), Vec3::X * 0.4, Vec3::new(0.0, 0.4, 0.1));
    let low = Vec3::new(-1.0, 0.1, -0.8);
    parts.add_box("sheet", glass, low, low + Vec3::new(2.0, 1.85, thickness), false);
    parts.add_quad("mirror", mirror, Vec3::new(-1.49, 0.2, 1.2), Vec3::NEG_Z * 1.6, Vec3::Y * 1.6);
    parts.add_box("block", white, Vec3::new(0.3, 0.0, -0.2), Vec3::new(0.7, 0.9, 0.2), false);
    parts.cameras.push(looking(Vec3::new(1.2, 1.6, 1.45), Vec3::new(-0.5, 0.5, -0.3), 1.2));
    Scene::new(parts).expect("the scene is valid")
}

#[test]
fn sheets_of_glass_agree() {
    let mut caught: Caught = Default::default();
    let level = FAMILY / (2 * comparisons(WIDTH, WIDTH, LAYERS.len())) as f64;
    // As a sheet that is straight for shadow rays, and as one that is too thick for it.
    for (thickness, is_sheet) in [(0.015, true), (0.08, false)] {
        let scene = behind_a_sheet(thickness);
        let tracer = Tracer::new(&scene);
        let mut triangles = (0..scene.triangles().len() as u32).map(TriangleId);
        assert_eq!(triangles.any(|t| tracer.slab_of(t).is_some()), is_sheet);
        // The twin meets the lamp by chance: one path in fifty.
        let failures = judge("behind_a_sheet", &scene, 16 * SAMPLES, level, &mut caught);
        assert!(failures.is_empty(), "{}", failures.join("\n"));
    }
    assert_caught(&caught, &["direct", "mirrored", "caustic", "indirect"]);
}

/// A closed room with a lamp that looks at a hundred small mirrors, which all throw its light at one place on the opposite wall, beside a
/// larger mirror, in which they are seen.
fn burning_mirrors() -> Scene {
    let (mut parts, _) = white_room();
    let mirror = parts.add_material(Material::mirror("mirror", Rgb::new(0.9, 0.85, 0.8)));
    let lamp = parts.add_material(Material::emitter("lamp", Radiance(Rgb::splat(5.0))));
    parts.add_quad("wall mirror", mirror, Vec3::new(-1.49, 0.3, -0.5), Vec3::NEG_Z * 0.9, Vec3::Y * 1.6);
    let (source, aim) = (Vec3::new(0.0, 1.1, -0.9), Vec3::new(-1.5, 1.0, 0.6));
    // Its normal is (3, 0, 1)/√10.
    let across = Vec3::new(0.15, 0.0, -0.45);
    parts.add_quad("lamp", lamp, source - 0.5 * (across + Vec3::Y * 0.5), across, Vec3::Y * 0.5);
    for number in 0..100_u8 {
        let (row, column) = (f32::from(number / 10), f32::from(number % 10));
        let center = Vec3::new(1.3, 0.6 + 0.1 * row, -0.2 + 0.1 * column);
        let towards = |place: Vec3| (place - center).normalize_or_zero();
        let out = towards(source) + towards(aim);
        let across = Vec3::Y.cross(out).normalize_or_zero() * 0.07;
        let up = out.cross(across).normalize_or_zero() * 0.07;
        parts.add_quad("tile", mirror, center - 0.5 * (across + up), across, up);
    }
    parts.cameras.push(looking(Vec3::new(0.6, 1.3, 1.45), Vec3::new(-0.9, 1.0, 0.0), 1.3));
    Scene::new(parts).expect("the scene is valid")
}

#[test]
fn small_mirrors_agree() {
    let scene = burning_mirrors();
    let tracer = Tracer::new(&scene);
    let facets = (0..scene.triangles().len() as u32)
        .filter(|&t| matches!(tracer.reflection(TriangleId(t)), Event::Facet(_)));
    assert_eq!(facets.count(), 200, "the tiles are facets, and nothing else is");
    let level = FAMILY / comparisons(WIDTH, WIDTH, LAYERS.len()) as f64;
    let mut caught: Caught = Default::default();
    let failures = judge("burning_mirrors", &scene, 8 * SAMPLES, level, &mut caught);
    assert!(failures.is_empty(), "{}", failures.join("\n"));
    assert_caught(&caught, &["direct", "mirrored", "indirect"]);
}

/// Light of sources at each pixel, of which the mesh and pass one have no part.
fn per_pixel(scene: &Scene) -> Image {
    let tracer = Tracer::new(scene);
    let camera = scene.cameras().first().expect("scenes have a camera");
    let solved = solve(&tracer, &SolveParams::for_quality(Quality::Draft), &Silent).expect("not cancelled");
    let params = RenderParams::for_quality(Quality::Standard, WIDTH, camera.height_for_width(WIDTH));
    let direct = DirectLight::Pixels(ShadowRays::for_quality(Quality::Standard));
    let params = RenderParams { layers: true, direct, ..params };
    render(&tracer, &solved.solution, camera, &params, &Silent).expect("not cancelled").image
}

#[test]
fn light_of_sources_at_each_pixel_agrees() {
    let layers = ["direct", "mirrored", "specular.direct", "specular.mirrored"];
    let names = ["cornell_box", "cornell_mirror", "mirror_corner", "spot_mirror", "window_pane_room", "pool"];
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes");
    let mut scenes: Vec<(&str, Scene)> =
        names.iter().map(|name| (*name, load(&folder.join(format!("{name}.glb"))))).collect();
    // The dim sky is read from the vertices of a draft, its sun is evaluated.
    scenes.push(("under_the_sun", under_the_sun()));
    let level = FAMILY / (scenes.len() * comparisons(WIDTH, WIDTH, layers.len())) as f64;
    let mut caught = [[false; 2]; 4];
    for (name, scene) in &scenes {
        let (image, twin) = (per_pixel(scene), twin_of(scene, 4 * SAMPLES));
        for (layer, caught) in layers.iter().zip(&mut caught).filter(|(l, _)| is_comparable(scene, l)) {
            // A sixteenth of the pixels' own samples: their noise is far below the twin's.
            let allowance = match *name {
                "under_the_sun" => Allowance::default(),
                _ => Allowance { relative: 0.005, of_image: 0.0005 },
            };
            let test = |factor: f32| -> Vec<Mismatch> {
                let pixels = image.rgb(layer).expect("every layer is written");
                let changed: Vec<[f32; 3]> = pixels.iter().map(|p| p.map(|v| v * factor)).collect();
                compare(&changed, &twin, &[layer], level, allowance)
            };
            let mismatches = test(1.0);
            if let Some(first) = mismatches.first() {
                keep(name, &image, &twin);
                panic!("{name}: {first}");
            }
            caught[0] |= !test(0.0).is_empty();
            caught[1] |= !test(2.0).is_empty();
        }
    }
    assert_eq!(caught, [[true; 2]; 4], "a layer could be missing or doubled unnoticed: {layers:?}");
}

/// A box with a lamp of exponent `n` under its ceiling, a mirror on its left and a ball of glass below the lamp.
fn under_a_lobe(n: f32) -> Scene {
    let mut parts = SceneParts::default();
    let white = parts.add_material(Material::lambertian("white", Rgb::new(0.7, 0.65, 0.6)));
    let red = parts.add_material(Material::lambertian("red", Rgb::new(0.6, 0.2, 0.15)));
    let mirror = parts.add_material(Material::mirror("mirror", Rgb::new(0.9, 0.85, 0.8)));
    let glass = parts.add_material(Material::glass("glass", 1.5));
    let lobe = Lobe::new(n).expect("a legal exponent");
    let lamp = Material { lobe, ..Material::emitter("lamp", Radiance(Rgb::new(9.0, 8.0, 6.0))) };
    let lamp = parts.add_material(lamp);
    let (x, y, z) = (Vec3::X, Vec3::Y, Vec3::Z);
    parts.add_quad("floor", white, Vec3::new(-1.0, 0.0, 1.0), 2.0 * x, -2.0 * z);
    parts.add_quad("ceiling", white, Vec3::new(-1.0, 2.0, -1.0), 2.0 * x, 2.0 * z);
    parts.add_quad("back", white, Vec3::new(-1.0, 0.0, -1.0), 2.0 * x, 2.0 * y);
    parts.add_quad("right", red, Vec3::new(1.0, 0.0, 1.0), 2.0 * y, -2.0 * z);
    parts.add_quad("left", white, Vec3::new(-1.0, 0.0, -1.0), 2.0 * y, 2.0 * z);
    parts.add_quad("mirror", mirror, Vec3::new(-0.98, 0.2, -0.6), 1.4 * y, 1.2 * z);
    // Tilted towards the mirror, which a narrow lobe would miss.
    parts.add_quad("lamp", lamp, Vec3::new(-0.2, 1.95, -0.25), Vec3::new(0.5, -0.2, 0.0), 0.5 * z);
    parts.add_sphere("ball", glass, Vec3::new(0.05, 0.5, 0.1), 0.3, 24);
    parts.cameras.push(looking(Vec3::new(0.2, 1.0, 3.6), Vec3::new(0.2, 1.0, 0.0), 0.75));
    Scene::new(parts).expect("the scene is valid")
}

#[test]
fn area_lights_with_a_lobe_agree() {
    let lobes = [0.5, 8.0, 50.0];
    let level = FAMILY / (lobes.len() * comparisons(WIDTH, WIDTH, LAYERS.len())) as f64;
    for n in lobes {
        let mut caught: Caught = Default::default();
        let name = format!("under_a_lobe_{n}");
        let failures = judge(&name, &under_a_lobe(n), 4 * SAMPLES, level, &mut caught);
        assert!(failures.is_empty(), "{}", failures.join("\n"));
        for layer in ["direct", "mirrored", "caustic", "indirect"] {
            let index = LAYERS.iter().position(|l| *l == layer).expect("a layer");
            assert_eq!(caught[index], [true; 2], "n = {n}: `{layer}` could be missing or doubled unnoticed");
        }
    }
}

/// A ball on the floor of a closed room, seen from the floor before it.
fn under_a_ball() -> Scene {
    let (mut parts, white) = white_room();
    let lamp = parts.add_material(Material::emitter("lamp", Radiance(Rgb::new(12.0, 11.0, 10.0))));
    parts.add_quad("lamp", lamp, Vec3::new(-0.4, 2.19, -0.4), 0.8 * Vec3::X, 0.8 * Vec3::Z);
    parts.add_sphere("ball", white, Vec3::new(0.0, 0.35, 0.0), 0.35, 48);
    parts.cameras.push(looking(Vec3::new(0.0, 0.02, 0.35), Vec3::new(0.0, 0.0, 0.06), 0.3));
    Scene::new(parts).expect("the scene is valid")
}

/// A part of an image layer beside the same part of the twin: means of the sum of channels over pixels, and a standard error.
struct Part {
    ours: f64,
    found: f64,
    error: f64,
}

/// The indirect light where a pixel's ray meets a plane at such places.
fn indirect_where(
    (image, twin): (&Image, &Twin),
    camera: &Camera,
    (point, normal): (Vec3, Vec3),
    is_there: impl Fn(Vec3) -> bool,
) -> Part {
    let layer = &twin.layers[LAYERS.iter().position(|l| *l == "indirect").expect("a layer")];
    let pixels = image.rgb("indirect").expect("every layer is written");
    let (mut ours, mut found, mut variance, mut count) = (0.0, 0.0, 0.0, 0);
    for index in 0..WIDTH * WIDTH {
        let at = ((index % WIDTH) as f32 + 0.5, (index / WIDTH) as f32 + 0.5);
        let (origin, direction) = camera.ray(at.0, at.1, WIDTH, WIDTH);
        let distance = (point - origin).dot(normal) / direction.dot(normal);
        if distance > 0.0 && is_there(origin + direction * distance) {
            ours += f64::from(pixels[index].iter().sum::<f32>());
            found += layer.mean[index].element_sum();
            variance += layer.variance[index].element_sum() * 3.0;
            count += 1;
        }
    }
    let count = f64::from(count);
    Part { ours: ours / count, found: found / count, error: variance.sqrt() / count }
}

/// Near the foot of a ball, light that goes to and fro between it and the floor is all there is, and dies away within less than a
/// patch.
#[test]
fn light_dies_away_under_a_ball() {
    let scene = under_a_ball();
    let (image, twin) = (ours(&scene), twin_of(&scene, 16 * SAMPLES));
    for (near, far) in [(0.03, 0.05), (0.05, 0.07), (0.07, 0.1), (0.1, 0.15)] {
        let is_there = |place: Vec3| place.z > 0.0 && (near..far).contains(&place.length());
        let Part { ours, found, error } =
            indirect_where((&image, &twin), &scene.cameras()[0], (Vec3::ZERO, Vec3::Y), is_there);
        // What is left to the coarse patches is the same all over one: it may be a tenth of the light at the border of the patch, which
        // is 0.21. One reflection off the patch's mean, what a gather does by itself, leaves 0.15 to 0.2 at the foot.
        let allowed = 0.021 + 4.0 * error;
        assert!((ours - found).abs() < allowed, "{near} m to {far} m: {ours} instead of {found} ± {error}");
    }
}

/// Where a shadow meets the foot of what throws it, the light that the floor sends changes within less than a patch: at a corner of
/// the short block of the Cornell box.
#[test]
fn light_ends_at_the_corner_of_a_dark_foot() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes/cornell_box.glb");
    let mut parts = load(&path).into_parts();
    // The foot of its dark side.
    let (corner, other) = (Vec3::new(-0.136, 0.0, 1.656), Vec3::new(0.664, 0.0, 1.901));
    let along = (other - corner).normalize_or_zero();
    let normal = along.cross(Vec3::Y);
    let target = corner + along * 0.2 + Vec3::Y * 0.06;
    parts.cameras = vec![looking(target + normal * 1.2 + Vec3::Y * 0.2, target, 0.35)];
    let scene = Scene::new(parts).expect("a close-up is valid");
    let (image, twin) = (ours(&scene), twin_of(&scene, 16 * SAMPLES));
    let between = |near: f32, far: f32| {
        let is_there = |place: Vec3| {
            (0.005..0.04).contains(&place.y) && (near..far).contains(&(place - corner).dot(along))
        };
        indirect_where((&image, &twin), &scene.cameras()[0], (corner, normal), is_there)
    };
    // Edges of base triangles are 0.2 m long there. What is shown must come nearer than a straight line along one of them between what
    // is right at its ends.
    let [start, end] = [between(0.0, 0.03), between(0.17, 0.2)];
    for (near, far) in [(0.06, 0.1), (0.1, 0.15)] {
        let Part { ours, found, error } = between(near, far);
        let share = f64::from(0.5 * (near + far) - 0.015) / (0.185 - 0.015);
        let straight = start.found + (end.found - start.found) * share;
        let allowed = (straight - found).abs() + 4.0 * error;
        assert!(straight - found > 8.0 * error, "nothing bends there: {found} ± {error}, {straight}");
        assert!((ours - found).abs() < allowed, "{near} m to {far} m: {ours} instead of {found} ± {error}");
    }
}
