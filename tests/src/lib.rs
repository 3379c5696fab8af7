//! What the end-to-end tests in `tests/` share: the slow twin of the renderer, and how a picture is compared with it.

pub mod compare;
mod particles;
mod path;
pub mod twin;

use catoptric_scene::{Camera, Material, MaterialId, Projection, Rgb, SceneParts};
use glam::{Affine3A, Mat3, Vec3};

/// A square perspective view from `eye` to `target`; `yfov` in radians.
pub fn looking(eye: Vec3, target: Vec3, yfov: f32) -> Camera {
    let back = (eye - target).normalize_or(Vec3::Z);
    let right = Vec3::Y.cross(back).normalize_or(Vec3::X);
    let turn = Mat3::from_cols(right, back.cross(right), back);
    Camera {
        name: "camera".to_owned(),
        world_from_camera: Affine3A::from_mat3_translation(turn, eye),
        projection: Projection::Perspective { yfov },
        aspect: Some(1.0),
        near: 0.0,
    }
}

/// An empty room of 3 × 2.2 × 3 metres, and its material.
pub fn white_room() -> (SceneParts, MaterialId) {
    let mut parts = SceneParts::default();
    let white = parts.add_material(Material::lambertian("white", Rgb::new(0.7, 0.65, 0.6)));
    let (x, y, z) = (Vec3::X, Vec3::Y, Vec3::Z);
    parts.add_quad("floor", white, Vec3::new(-1.5, 0.0, 1.5), 3.0 * x, -3.0 * z);
    parts.add_quad("ceiling", white, Vec3::new(-1.5, 2.2, -1.5), 3.0 * x, 3.0 * z);
    parts.add_quad("back", white, Vec3::new(-1.5, 0.0, -1.5), 3.0 * x, 2.2 * y);
    parts.add_quad("front", white, Vec3::new(1.5, 0.0, 1.5), -3.0 * x, 2.2 * y);
    parts.add_quad("left", white, Vec3::new(-1.5, 0.0, -1.5), 2.2 * y, 3.0 * z);
    parts.add_quad("right", white, Vec3::new(1.5, 0.0, 1.5), 2.2 * y, -3.0 * z);
    (parts, white)
}
