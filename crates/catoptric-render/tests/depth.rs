//! What many reflections in a row bring.

use std::f32::consts::FRAC_PI_4;

use catoptric_render::{RenderParams, render};
use catoptric_scene::{Camera, Material, Projection, Radiance, Rgb, Scene, SceneParts, Silent};
use catoptric_solution::{Quality, Solution};
use catoptric_trace::Tracer;
use glam::{Affine3A, Vec3};

/// A lamp at the end of a duct of lossless mirrors, 2000 reflections away: further than paths of `standard` go, which end dark. At `high`
/// they go four times as far.
#[test]
fn a_lamp_behind_two_thousand_reflections_shows_at_high() {
    let mut parts = SceneParts::default();
    let mirror = parts.add_material(Material::mirror("mirror", Rgb::ONE));
    let glowing = parts.add_material(Material::emitter("glowing", Radiance(Rgb::ONE)));
    // Rays at 45° meet a mirror every 0.1 m of the way.
    let (gap, length) = (0.1, 200.0);
    let (across, along) = (Vec3::X * 6.0, Vec3::Z * -length);
    parts.add_quad("below", mirror, Vec3::new(-3.0, 0.0, 0.0), across, along);
    parts.add_quad("above", mirror, Vec3::new(-3.0, gap, -length), across, -along);
    parts.add_quad("lamp", glowing, Vec3::new(-3.0, 0.0, -length), across, Vec3::Y * gap);
    let scene = Scene::new(parts).expect("a valid scene");
    let eye = Vec3::new(0.0, 0.5 * gap, -0.01);
    let camera = Camera {
        name: "eye".to_owned(),
        world_from_camera: Affine3A::from_translation(eye) * Affine3A::from_rotation_x(FRAC_PI_4),
        // One in a hundred reflections more or less, and 1.4 m of the duct's width.
        projection: Projection::Perspective { yfov: 0.01 },
        aspect: None,
        near: 0.0,
    };
    let tracer = Tracer::new(&scene);
    for (quality, shown) in [(Quality::Standard, 0.0), (Quality::High, 1.0)] {
        let params = RenderParams::for_quality(quality, 8, 8);
        let rendered = render(&tracer, &Solution::default(), &camera, &params, &Silent).expect("not stopped");
        let pixels = rendered.image.channel("G").expect("a picture");
        // Nothing is lost on the way, and no edge is in the picture.
        assert!(pixels.iter().all(|&value| (value - shown).abs() < 1e-6), "{quality:?}: {pixels:?}");
    }
}
