//! Cameras of a file, and one that frames the scene where the file has none.

use glam::{Affine3A, DMat4, DVec3, Mat3A, Vec3, Vec3A};

use crate::camera::{Camera, Projection};
use crate::scene::Vertex;

use super::asset::Asset;
use super::document::{Entity, Table};
use super::node::Hierarchy;
use super::report::Report;

/// A camera and the position of its node in the hierarchy.
pub(super) struct CameraNode {
    pub(super) camera: Camera,
    pub(super) node: usize,
}

/// The cameras of all visible nodes.
pub(super) fn read_cameras(asset: &Asset, hierarchy: &Hierarchy, report: &Report) -> Vec<CameraNode> {
    let root = asset.root();
    let mut cameras: Vec<CameraNode> = Vec::new();
    let mut names = std::collections::BTreeSet::new();
    for (position, node) in hierarchy.nodes.iter().enumerate().filter(|(_, node)| node.visible) {
        let Some(entity) = root.element(Table::NODES, node.index, report) else { continue };
        let Some((_, camera)) = root.follow(&entity, "camera", Table::CAMERAS, report) else { continue };
        let Some((projection, aspect, near)) = read_projection(&camera, report) else { continue };
        let Some(world_from_camera) = camera_frame(&node.world) else {
            report.problem(entity.place(), "a camera with directions", "a node scaled to nothing", "");
            continue;
        };
        let plain = entity.name().or(camera.name()).map_or_else(|| node.name.clone(), str::to_owned);
        let mut name = plain.clone();
        let mut copies = 1;
        while !names.insert(name.clone()) {
            copies += 1;
            name = format!("{plain} ({copies})");
        }
        cameras.push(CameraNode {
            camera: Camera { name, world_from_camera, projection, aspect, near },
            node: position,
        });
    }
    cameras
}

/// Projection, aspect and near plane of a camera.
pub(super) fn read_projection(
    camera: &Entity<'_>,
    report: &Report,
) -> Option<(Projection, Option<f32>, f32)> {
    let positive = |from: &Entity<'_>, key: &str| {
        let number = from.number(key, report);
        if number.is_none_or(|number| number == 0.0) {
            report.problem(camera.place(), format!("{key} other than 0"), "none", "");
        }
        number.map(f32::abs).filter(|number| *number > 0.0)
    };
    let near = |from: &Entity<'_>| from.number_or("znear", 0.0, report).max(0.0);
    match camera.string("type", report) {
        Some("perspective") => {
            let Some(perspective) = camera.object("perspective", report) else {
                report.problem(camera.place(), "an object `perspective`", "none", "");
                return None;
            };
            let yfov = positive(&perspective, "yfov")?;
            if yfov >= std::f32::consts::PI {
                report.problem(camera.place(), "yfov below π radians", yfov, "is it in degrees?");
                return None;
            }
            let aspect = perspective.number("aspectRatio", report).filter(|aspect| *aspect > 0.0);
            Some((Projection::Perspective { yfov }, aspect, near(&perspective)))
        }
        Some("orthographic") => {
            let Some(orthographic) = camera.object("orthographic", report) else {
                report.problem(camera.place(), "an object `orthographic`", "none", "");
                return None;
            };
            let (xmag, ymag) = (positive(&orthographic, "xmag")?, positive(&orthographic, "ymag")?);
            let projection = Projection::Orthographic { xmag, ymag };
            Some((projection, Some(xmag / ymag), near(&orthographic)))
        }
        other => {
            let found = other.unwrap_or("none");
            report.problem(camera.place(), "type \"perspective\" or \"orthographic\"", found, "");
            None
        }
    }
}

/// The camera's orthonormal axes: scale is no part of a view; −Z and the upper half plane are kept.
pub(super) fn camera_frame(world: &DMat4) -> Option<Affine3A> {
    let back = world.z_axis.truncate().try_normalize()?;
    let right = world.y_axis.truncate().cross(back).try_normalize()?;
    let up = back.cross(right);
    let axis = |v: DVec3| Vec3A::from(v.as_vec3());
    let frame = Affine3A {
        matrix3: Mat3A::from_cols(axis(right), axis(up), axis(back)),
        translation: axis(world.w_axis.truncate()),
    };
    frame.is_finite().then_some(frame)
}

/// A camera that sees all of the scene from the front, the right and above.
pub(super) fn framed_camera(vertices: &[Vertex]) -> Camera {
    const YFOV: f32 = 0.7;
    const ASPECT: f32 = 4.0 / 3.0;
    const MARGIN: f64 = 1.05;
    let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    for vertex in vertices {
        low = low.min(vertex.position);
        high = high.max(vertex.position);
    }
    if vertices.is_empty() {
        (low, high) = (Vec3::splat(-1.0), Vec3::ONE);
    }
    let (low, high) = (low.as_dvec3(), high.as_dvec3());
    let centre = 0.5 * (low + high);
    let half = 0.5 * (high - low);

    let back = DVec3::new(0.45, 0.35, 1.0).normalize_or_zero();
    let right = DVec3::Y.cross(back).normalize_or_zero();
    let up = back.cross(right);
    // The nearest distance at which every corner of the box is inside of the frustum.
    let tan_y = f64::from(libm::tanf(0.5 * YFOV));
    let tan_x = f64::from(ASPECT) * tan_y;
    let mut distance = 0.0_f64;
    for corner in 0..8 {
        let sign = |bit: u32| if corner >> bit & 1 == 1 { 1.0 } else { -1.0 };
        let offset = half * DVec3::new(sign(0), sign(1), sign(2));
        let needed = (offset.dot(right).abs() / tan_x).max(offset.dot(up).abs() / tan_y);
        distance = distance.max(offset.dot(back) + MARGIN * needed);
    }
    let axis = |v: DVec3| Vec3A::from(v.as_vec3());
    Camera {
        name: "framed".to_owned(),
        world_from_camera: Affine3A {
            matrix3: Mat3A::from_cols(axis(right), axis(up), axis(back)),
            translation: axis(centre + back * distance),
        },
        projection: Projection::Perspective { yfov: YFOV },
        aspect: Some(ASPECT),
        near: 0.0,
    }
}
