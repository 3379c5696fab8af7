//! What the end-to-end tests in `tests/` share: the slow twin of the renderer, and how a picture is compared with it.

pub mod compare;
mod particles;
mod path;
pub mod twin;

use catoptric_scene::{Camera, Projection};
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
