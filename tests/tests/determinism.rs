//! Same bits: for any number of threads, any order in which the tree is built, and any instruction set.

use catoptric_radiosity::{SolveParams, solve};
use catoptric_render::direct::{DirectLight, ShadowRays};
use catoptric_render::{RenderParams, render};
use catoptric_scene::{
    Camera, Material, Projection, PunctualKind, PunctualLight, Radiance, Rgb, Scene, SceneParts, Silent,
    Transmission,
};
use catoptric_solution::Quality;
use catoptric_trace::Tracer;
use glam::{Affine3A, Vec3};

/// A room with one of everything: mirror, pane, coat, glass ball, veil, area light, spot, and a doubleSided sheet.
fn room() -> Scene {
    let mut parts = SceneParts::default();
    let white = Material::lambertian("white", Rgb::splat(0.7));
    let coat =
        Material { roughness: 0.0, specular: 1.0, ..Material::lambertian("coat", Rgb::new(0.2, 0.5, 0.7)) };
    let pane = Material { transmission_kind: Transmission::Pane, ..Material::glass("pane", 1.5) };
    let lamp = Material::emitter("lamp", Radiance(Rgb::new(9.0, 8.0, 6.0)));
    let gold = Material::mirror("gold", Rgb::new(0.95, 0.8, 0.5));
    let sheet = Material { double_sided: true, ..white.clone() };
    let [white, coat, pane, lamp, gold, sheet, glass] =
        [white, coat, pane, lamp, gold, sheet, Material::glass("glass", 1.5)].map(|m| parts.add_material(m));
    parts.add_box("room", white, Vec3::splat(-2.0), Vec3::splat(2.0), true);
    parts.add_box("block", coat, Vec3::new(-1.2, -2.0, -1.3), Vec3::new(-0.4, -0.8, -0.2), false);
    parts.add_sphere("ball", glass, Vec3::new(0.7, -1.3, 0.1), 0.5, 12);
    parts.add_quad("mirror", gold, Vec3::new(1.9, -1.5, -1.5), Vec3::Z * 3.0, Vec3::Y * 3.0);
    parts.add_quad("pane", pane, Vec3::new(-1.7, -1.9, -0.5), Vec3::X * 1.5, Vec3::Y * 2.0);
    parts.add_quad("lamp", lamp, Vec3::new(-0.4, 1.9, -0.4), Vec3::X * 0.7, Vec3::Z * 0.6);
    parts.add_quad("sheet", sheet, Vec3::new(0.1, -1.9, -1.5), Vec3::X * 0.9, Vec3::Y * 1.4);
    // A bulb in a globe, which is a lens.
    parts.add_sphere("bulb", lamp, Vec3::new(-0.9, 0.6, -0.9), 0.1, 8);
    parts.add_sphere("globe", glass, Vec3::new(-0.9, 0.6, -0.9), 0.25, 12);
    parts.lights.push(PunctualLight {
        name: "spot".to_owned(),
        position: Vec3::new(-1.5, 1.5, 1.5),
        direction: Vec3::new(1.0, -1.0, -0.6).normalize_or_zero(),
        intensity: Rgb::splat(4.0),
        kind: PunctualKind::Spot { cos_inner: 0.95, cos_outer: 0.8 },
    });
    parts.cameras.push(Camera {
        name: "camera".to_owned(),
        world_from_camera: Affine3A::from_translation(Vec3::new(0.0, 0.0, 1.95)),
        projection: Projection::Perspective { yfov: 1.4 },
        aspect: Some(1.0),
        near: 0.0,
    });
    Scene::new(parts).expect("a valid scene")
}

/// The bytes of the EXRs with all layers: light of sources from the vertices, and at each pixel.
fn picture(scene: &Scene, tracer: &Tracer) -> Vec<u8> {
    let solved = solve(tracer, &SolveParams::for_quality(Quality::Draft), &Silent).expect("not cancelled");
    let params = RenderParams { layers: true, ..RenderParams::for_quality(Quality::Draft, 40, 40) };
    let rays = ShadowRays::for_quality(Quality::Draft);
    let views = [DirectLight::Vertices, DirectLight::Auto(rays), DirectLight::Pixels(rays)]
        .map(|direct| RenderParams { direct, mesh: direct != DirectLight::Vertices, ..params.clone() });
    let picture = |view: &RenderParams| {
        let rendered = render(tracer, &solved.solution, &scene.cameras()[0], view, &Silent);
        rendered.expect("not cancelled").image.encode_exr().expect("an image can be encoded")
    };
    views.iter().flat_map(picture).collect()
}

fn with_threads(threads: usize, work: impl FnOnce() -> Vec<u8> + Send) -> Vec<u8> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads start");
    pool.install(work)
}

#[test]
fn any_number_of_threads_gives_the_same_bytes() {
    let scene = room();
    let bytes = |threads| with_threads(threads, || picture(&scene, &Tracer::new(&scene)));
    let one = bytes(1);
    assert!(one == bytes(2), "two threads give another picture than one");
    assert!(one == bytes(3), "three threads give another picture than one");
}

#[test]
fn any_order_of_the_tree_gives_the_same_bytes() {
    let scene = room();
    let count = scene.triangles().len() as u32;
    let plain = picture(&scene, &Tracer::new(&scene));
    let reversed: Vec<u32> = (0..count).rev().collect();
    // Every triangle once: 7919 is prime and larger than their number.
    let shuffled: Vec<u32> = {
        let mut order: Vec<u32> = (0..count).collect();
        order.sort_by_key(|i| (u64::from(*i) + 1) * 2_654_435_761 % 7919);
        order
    };
    for order in [reversed, shuffled] {
        let other = picture(&scene, &Tracer::with_order(&scene, &order));
        assert!(plain == other, "the order of the build changes the picture");
    }
}

#[test]
fn any_instruction_set_gives_the_same_bytes() {
    let scene = room();
    let plain = picture(&scene, &Tracer::new(&scene));
    let common = picture(&scene, &Tracer::new(&scene).with_common_instructions());
    assert!(plain == common, "the instructions of this machine change the picture");
}
