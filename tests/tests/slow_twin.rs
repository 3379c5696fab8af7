//! Every light layer of every scene against the slow twin, in 8×8 block means; and what that comparison catches.
//!
//! One false alarm in a thousand runs of the whole family: the level is divided by the number of all comparisons.
//! A failing scene leaves `NAME.exr` (ours) and `NAME.twin.exr` in the target folder's `tmp`.

use std::path::{Path, PathBuf};

use catoptric_image::Image;
use catoptric_radiosity::{SolveParams, solve};
use catoptric_render::{RenderParams, render};
use catoptric_scene::{Radiance, Rgb, Scene, Silent, Sky, gltf};
use catoptric_solution::Quality;
use catoptric_tests::compare::{Allowance, Mismatch, compare, comparisons};
use catoptric_tests::twin::{self, LAYERS, Twin, TwinParams};
use catoptric_trace::Tracer;

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

fn twin_of(scene: &Scene) -> Twin {
    let camera = scene.cameras().first().expect("scenes have a camera");
    let height = camera.height_for_width(WIDTH);
    let params = TwinParams { width: WIDTH, height, samples: 32, particles: 300_000, seed: 11 };
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

/// Layers that are known to be off, and why. Their blocks are not judged, and the whole picture only within 35 %: enough
/// to see a term that is missing or counted twice. Whoever mends one takes its line out.
const KNOWN: [(&str, &str, &str); 1] = [(
    "mirror_corner",
    "indirect",
    "the foot of the cone, where the contact with the floor is not cut, is too dark",
)];

/// What is known of a layer, seen directly or through S.
fn known(scene: &str, layer: &str) -> Option<&'static str> {
    let class = layer.trim_start_matches("specular.");
    KNOWN.iter().find(|(s, l, _)| *s == scene && *l == class).map(|(_, _, why)| *why)
}

#[test]
fn every_layer_of_every_scene_agrees_and_no_term_can_go_missing() {
    let scenes = scenes();
    assert!(scenes.len() >= 8, "{scenes:?}");
    let level = FAMILY / (scenes.len() * comparisons(WIDTH, WIDTH, LAYERS.len())) as f64;
    let mut failures: Vec<String> = Vec::new();
    let mut caught = [[false; 2]; LAYERS.len()];
    for path in &scenes {
        let name = name_of(path);
        let scene = load(path);
        let (image, twin) = (ours(&scene), twin_of(&scene));
        let before = failures.len();
        for (index, layer) in LAYERS.iter().enumerate() {
            if !is_comparable(&scene, layer) {
                continue;
            }
            let pixels = image.rgb(layer).expect("every layer is written");
            let test = |factor: f32| -> Vec<Mismatch> {
                let changed: Vec<[f32; 3]> = pixels.iter().map(|p| p.map(|v| v * factor)).collect();
                if known(&name, layer).is_none() {
                    return compare(&changed, &twin, &[layer], level, Allowance::default());
                }
                let wide = Allowance { relative: 0.35, ..Allowance::default() };
                let mut mismatches = compare(&changed, &twin, &[layer], level, wide);
                mismatches.retain(|m| m.block.is_none());
                mismatches
            };
            let mismatches = test(1.0);
            failures.extend(mismatches.iter().take(3).map(|m| format!("{name}: {m}")));
            // The mutations: a term dropped, a term counted twice.
            caught[index][0] |= mismatches.is_empty() && !test(0.0).is_empty();
            caught[index][1] |= mismatches.is_empty() && !test(2.0).is_empty();
        }
        if failures.len() > before {
            keep(&name, &image, &twin);
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
    for (layer, [dropped, doubled]) in LAYERS.iter().zip(caught) {
        assert!(dropped, "nobody would notice if `{layer}` were missing");
        assert!(doubled, "nobody would notice if `{layer}` were counted twice");
    }
}
