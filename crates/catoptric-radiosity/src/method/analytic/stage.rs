//! The scene as convex polygons, and those in front of a plane: blockers, targets, mirrors.

use glam::DVec3;

use catoptric_light::contour::Polygon;
use catoptric_scene::{Barycentric, TriangleId};
use catoptric_trace::{PlaneId, Tracer};

use super::Analytic;
use crate::method::Piece;
use crate::method::visible::Blocker;

/// A side of a wall that reflects.
#[derive(Clone, Copy, Debug)]
pub(super) struct Mirror {
    pub(super) outline: Polygon,
    pub(super) plane: PlaneId,
    pub(super) normal: DVec3,
    pub(super) offset: f64,
    pub(super) reflectance: DVec3,
}

/// A receiving piece.
#[derive(Clone, Debug)]
pub(super) struct Target {
    pub(super) outline: Polygon,
    pub(super) plane: PlaneId,
    pub(super) normal: DVec3,
    pub(super) offset: f64,
    /// Index of the element; the number of elements for black backs.
    pub(super) element: usize,
}

impl Target {
    pub(super) fn new(piece: &Piece, element: usize) -> Self {
        Self {
            outline: piece.outline,
            plane: piece.plane,
            normal: piece.normal,
            offset: piece.normal.dot(piece.outline.corners()[0]),
            element,
        }
    }
}

/// What lies in front of a plane, clipped to it.
#[derive(Clone, Debug, Default)]
pub(super) struct Stage {
    pub(super) blockers: Vec<Blocker>,
    pub(super) targets: Vec<Target>,
    pub(super) mirrors: Vec<(usize, Polygon)>,
}

impl Analytic<'_> {
    pub(super) fn add_wall(&mut self, piece: &Piece) {
        let Some(wall) = Blocker::new(piece.outline, piece.plane) else { return };
        let back = self.tracer.has_back(piece.triangle);
        if self.params.walk.extended
            && let Some(reflectance) = mirror_of(self.tracer, piece.triangle)
        {
            let front = Mirror {
                outline: piece.outline,
                plane: piece.plane,
                normal: piece.normal,
                offset: piece.normal.dot(piece.outline.corners()[0]),
                reflectance,
            };
            if back {
                self.mirrors.push(Mirror { normal: -front.normal, offset: -front.offset, ..front });
            }
            self.mirrors.push(front);
        }
        if !back {
            let mut target = Target::new(piece, self.set.len());
            target.normal = -target.normal;
            target.offset = -target.offset;
            self.targets.push(target);
        }
        let reflectance = self.params.walk.extended.then(|| mirror_of(self.tracer, piece.triangle)).flatten();
        let corners = wall.outline.corners();
        let edge = |k: usize| {
            let along = corners[(k + 1) % corners.len()] - corners[k];
            (wall.normal.cross(along), -1e-9 * along.length_squared())
        };
        self.edges.push((0..corners.len()).map(edge).collect());
        self.walls.push(wall);
        self.triangles.push(piece.triangle);
        self.reflectances.push(reflectance);
    }

    /// Whether all walls lie on one side of a wall's plane, within the rounding of positions.
    pub(super) fn is_outer(&self, wall: &Blocker) -> bool {
        let heights = self
            .walls
            .iter()
            .filter(|w| w.plane != wall.plane)
            .flat_map(|w| w.outline.corners().iter().map(|c| wall.normal.dot(*c) - wall.offset));
        let (low, high) = heights.fold((0.0_f64, 0.0_f64), |(low, high), h| (low.min(h), high.max(h)));
        let rounding = 1e-6 * self.tracer.extent().inner.diagonal;
        low > -rounding || high < rounding
    }

    /// What is in front of a plane.
    pub(super) fn stage(&self, normal: DVec3, offset: f64, plane: PlaneId) -> Stage {
        let clip = |p: &Polygon| {
            let part = p.clipped(normal, offset);
            // A sliver within rounding of the plane is in it.
            let height = part.corners().iter().map(|c| normal.dot(*c) - offset).fold(0.0, f64::max);
            (!part.is_empty() && height > 1e-9 * (1.0 + offset.abs())).then_some(part)
        };
        let other = |p: PlaneId| p != plane;
        Stage {
            blockers: self
                .walls
                .iter()
                .zip(&self.outer)
                .filter(|(w, outer)| other(w.plane) && !**outer)
                .filter_map(|(w, _)| Some(Blocker { outline: clip(&w.outline)?, ..w.clone() }))
                .collect(),
            targets: self
                .targets
                .iter()
                .filter(|t| other(t.plane))
                .filter_map(|t| Some(Target { outline: clip(&t.outline)?, ..t.clone() }))
                .collect(),
            mirrors: self
                .mirrors
                .iter()
                .enumerate()
                .filter(|(_, m)| other(m.plane))
                .filter_map(|(index, m)| Some((index, clip(&m.outline)?)))
                .collect(),
        }
    }
}

/// The reflectance of a flat mirror (or of the mirror part of a mixed surface) that is the same everywhere and at every
/// angle: its reflections are images.
pub(super) fn mirror_of(tracer: &Tracer, triangle: TriangleId) -> Option<DVec3> {
    tracer.image_plane(triangle)?;
    let scene = tracer.scene();
    let material = scene.material_of(triangle);
    let at = |u, v| scene.surface_point(triangle, Barycentric { u, v });
    let points = [at(0.2, 0.2), at(0.6, 0.2), at(0.2, 0.6)];
    let textured = material.base_texture.is_some()
        || material.metallic_roughness_texture.is_some()
        || material.specular_texture.is_some()
        || material.clearcoat_texture.is_some()
        || material.transmission_texture.is_some();
    let same = points.iter().all(|p| p.mirror == points[0].mirror);
    let plain = points.iter().all(|p| {
        (p.coat == 0.0 || p.coat_share == 0.0)
            && p.clearcoat == 0.0
            && p.transmission == 0.0
            && p.opacity == 1.0
    });
    (same && plain && !textured && points[0].mirror.max_element() > 0.0).then(|| points[0].mirror.as_dvec3())
}
