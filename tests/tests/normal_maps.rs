//! A normal map turns a diffuse surface to and from a punctual light, for the eye.

use catoptric_radiosity::{SolveParams, solve};
use catoptric_render::{RenderParams, render};
use catoptric_scene::{
    Camera, Material, Projection, PunctualKind, PunctualLight, Rgb, Scene, SceneParts, Silent, Texture,
    TextureId, TextureRef, TextureTransform, Wrap,
};
use catoptric_solution::Quality;
use catoptric_trace::Tracer;
use glam::{Affine3A, Mat3, Vec2, Vec3};

/// Mean radiance of a square under a sun that stands straight above it, with a map of one texel or without.
fn brightness(texel: Option<[u8; 4]>) -> f32 {
    let mut parts = SceneParts::default();
    let mut material = Material::lambertian("sheet", Rgb::splat(0.5));
    if let Some(texel) = texel {
        parts.textures.push(Texture {
            name: "map".to_owned(),
            width: 1,
            height: 1,
            texels: vec![texel],
            wrap_u: Wrap::Repeat,
            wrap_v: Wrap::Repeat,
            linear_filter: true,
        });
        let transform = TextureTransform::IDENTITY;
        material.normal_texture = Some((TextureRef { texture: TextureId(0), uv_set: 0, transform }, 1.0));
    }
    let id = parts.add_material(material);
    parts.add_quad("sheet", id, Vec3::new(-1.0, 0.0, -1.0), Vec3::Z * 2.0, Vec3::X * 2.0);
    for vertex in &mut parts.vertices {
        vertex.uv[0] = Vec2::new(vertex.position.x, vertex.position.z);
    }
    parts.lights.push(PunctualLight {
        name: "sun".to_owned(),
        position: Vec3::ZERO,
        direction: Vec3::NEG_Y,
        intensity: Rgb::splat(1000.0),
        kind: PunctualKind::Directional,
    });
    let camera = Camera {
        name: "above".to_owned(),
        world_from_camera: Affine3A::from_mat3_translation(
            Mat3::from_cols(Vec3::X, Vec3::NEG_Z, Vec3::Y),
            Vec3::Y,
        ),
        projection: Projection::Orthographic { xmag: 0.5, ymag: 0.5 },
        aspect: None,
        near: 0.0,
    };
    let scene = Scene::new(parts).expect("a valid scene");
    let tracer = Tracer::new(&scene);
    let solved = solve(&tracer, &SolveParams::for_quality(Quality::Draft), &Silent).expect("nobody stops it");
    let params = RenderParams::for_quality(Quality::Draft, 4, 4);
    let rendered = render(&tracer, &solved.solution, &camera, &params, &Silent).expect("nobody stops it");
    let pixels = rendered.image.rgb("").expect("the beauty");
    pixels.iter().map(|pixel| pixel[1]).sum::<f32>() / pixels.len() as f32
}

/// The texel (0.8, 0, 0.6) has a cosine of 0.6 to the sun; an 8-bit code is off by at most 1/255.
#[test]
fn a_map_that_leans_away_from_the_sun_darkens_the_surface_by_its_cosine() {
    let even = brightness(None);
    assert!((even - 1000.0 * 0.5 / std::f32::consts::PI).abs() < 0.1, "{even}");
    let code = |x: f32| ((x + 1.0) * 127.5).round() as u8;
    let leaning = brightness(Some([code(0.8), code(0.0), code(0.6), 255]));
    assert!((leaning / even - 0.6).abs() < 0.01, "{}", leaning / even);
}
