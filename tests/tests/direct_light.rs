//! Light of sources from the vertices and at each pixel: the same energy, no path lost, none counted twice.

use std::path::Path;

use catoptric_image::Image;
use catoptric_radiosity::{SolveParams, solve};
use catoptric_render::direct::{DirectLight, ShadowRays};
use catoptric_render::layers::NAMES;
use catoptric_render::{RenderParams, render};
use catoptric_scene::gltf::{LoadOptions, load};
use catoptric_scene::{Radiance, Rgb, Scene, Silent, Sky};
use catoptric_solution::Quality;
use catoptric_trace::Tracer;

const SIZE: usize = 64;
/// Blocks whose means are compared: as wide as a few elements.
const BLOCK: usize = 16;

/// A scene of the repository from the vertices, and per pixel.
fn both(name: &str, sky: Option<Sky>) -> [Image; 2] {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../scenes/{name}.glb"));
    let mut parts = load(&path, &LoadOptions::default()).expect("scenes load").scene.into_parts();
    parts.sky = sky;
    let scene = Scene::new(parts).expect("a valid scene");
    let tracer = Tracer::new(&scene);
    let quality = Quality::Standard;
    let solved = solve(&tracer, &SolveParams::for_quality(quality), &Silent).expect("not cancelled");
    [DirectLight::Vertices, DirectLight::Pixels(ShadowRays::for_quality(quality))].map(|direct| {
        let params = RenderParams { layers: true, direct, ..RenderParams::for_quality(quality, SIZE, SIZE) };
        let view = render(&tracer, &solved.solution, &scene.cameras()[0], &params, &Silent);
        view.expect("not cancelled").image
    })
}

/// Mean green light of a layer per block.
fn blocks(image: &Image, layer: &str) -> Vec<f64> {
    let pixels = image.rgb(layer).expect("every layer is written");
    let side = SIZE / BLOCK;
    let mut means = vec![0.0; side * side];
    for (index, pixel) in pixels.iter().enumerate() {
        let (x, y) = (index % SIZE / BLOCK, index / SIZE / BLOCK);
        means[y * side + x] += f64::from(pixel[1]) / (BLOCK * BLOCK) as f64;
    }
    means
}

#[test]
fn both_have_the_same_energy() {
    for name in ["cornell_box", "cornell_mirror", "two_mirrors", "spot_mirror", "window_pane_room"] {
        let [vertices, pixels] = both(name, None);
        let beauty: f64 = blocks(&vertices, "").iter().sum::<f64>() / (SIZE / BLOCK).pow(2) as f64;
        for layer in NAMES {
            let [ours, other] = [&vertices, &pixels].map(|image| blocks(image, layer));
            let sum = |blocks: &[f64]| blocks.iter().sum::<f64>();
            // What is stored is interpolated: a shadow's edge inside an element moves light by as much as `standard` is off
            // from references, 1.2 % of thrown light and 0.3 % of the beauty.
            let allowed = 0.015 * sum(&ours) + 1e-4 * beauty;
            assert!(
                (sum(&ours) - sum(&other)).abs() <= allowed,
                "{name}, {layer}: {} and {}",
                sum(&ours),
                sum(&other)
            );
            for (block, (a, b)) in ours.iter().zip(&other).enumerate() {
                let allowed = 0.05 * a.max(*b) + 0.01 * beauty;
                assert!((a - b).abs() <= allowed, "{name}, {layer}, block {block}: {a} and {b}");
            }
        }
    }
}

#[test]
fn what_hemisphere_rays_own_is_read_from_the_vertices_either_way() {
    // Glowing walls are broad emitters, a sky without a sun is dim: no shadow ray is cast to either.
    let white = Some(Sky::Uniform(Radiance(Rgb::ONE)));
    for (name, sky) in [("furnace_box", None), ("sky_body", white)] {
        let [vertices, pixels] = both(name, sky);
        let lit = blocks(&vertices, "direct");
        assert!(lit.iter().any(|light| *light > 0.1), "{name}: {lit:?}");
        for layer in NAMES {
            assert_eq!(vertices.rgb(layer), pixels.rgb(layer), "{name}, {layer}");
        }
    }
}
