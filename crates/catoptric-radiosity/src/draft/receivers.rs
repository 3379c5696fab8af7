//! Where vertices and points of the mesh receive light, and gather it.

use glam::Vec3;

use catoptric_light::Receiver;
use catoptric_scene::{Barycentric, TriangleId};
use catoptric_trace::interaction::Coat;
use catoptric_trace::{MediumId, MediumStack, Tracer};

use super::{Draft, Leaf};
use crate::display::Displayed;
use crate::face::FaceDraft;

impl Draft {
    /// Where a vertex receives light.
    pub fn receiver(&self, tracer: &Tracer, vertex: u32) -> Receiver {
        let v = &self.vertices[vertex as usize];
        let face = &self.faces[v.face as usize];
        self.receiver_at(tracer, face, v.medium, v.sample, v.normal, v.triangle)
    }

    /// Where a vertex gathers the light of other surfaces.
    pub fn gatherer(&self, tracer: &Tracer, vertex: u32) -> Receiver {
        let v = &self.vertices[vertex as usize];
        let face = &self.faces[v.face as usize];
        self.receiver_at(tracer, face, v.medium, v.outlook, v.normal, v.triangle)
    }

    /// Where a point inside an element receives light.
    pub fn receiver_inside(
        &self,
        tracer: &Tracer,
        displayed: &Displayed,
        element: u32,
        weights: [f32; 3],
    ) -> Receiver {
        let corners =
            displayed.mesh.elements[element as usize].vertices.map(|v| &displayed.mesh.vertices[v as usize]);
        let mix = |f: &dyn Fn(usize) -> Vec3| f(0) * weights[0] + f(1) * weights[1] + f(2) * weights[2];
        let position = mix(&|k| corners[k].position);
        let leaf = &self.leaves[displayed.leaves[element as usize] as usize];
        self.receiver_of(tracer, leaf, position)
    }

    /// Where a point inside a leaf receives light.
    pub fn receiver_in_leaf(&self, tracer: &Tracer, leaf: u32, weights: [f32; 3]) -> Receiver {
        let leaf = &self.leaves[leaf as usize];
        let corners = leaf.vertices.map(|v| &self.vertices[v as usize]);
        let mix = |f: &dyn Fn(usize) -> Vec3| f(0) * weights[0] + f(1) * weights[1] + f(2) * weights[2];
        let position = mix(&|k| corners[k].position);
        self.receiver_of(tracer, leaf, position)
    }

    /// Where a point of a leaf receives light.
    fn receiver_of(&self, tracer: &Tracer, leaf: &Leaf, position: Vec3) -> Receiver {
        let face = &self.faces[leaf.face as usize];
        let triangle = face.triangle_at(tracer, position);
        let normal = face.normal_at(tracer, triangle, position);
        let medium = self.medium_of_root[leaf.root as usize];
        self.receiver_at(tracer, face, medium, position, normal, triangle)
    }

    /// A receiver at a point of a face.
    pub fn receiver_at(
        &self,
        tracer: &Tracer,
        face: &FaceDraft,
        medium: MediumId,
        position: Vec3,
        normal: Vec3,
        triangle: TriangleId,
    ) -> Receiver {
        let coat = if tracer.is_lambertian(triangle) {
            Coat::NONE
        } else {
            let at = barycentric(tracer, triangle, position);
            let point = tracer.scene().surface_point(triangle, at);
            tracer.diffuse_side(triangle, &point, face.side).map_or(Coat::NONE, |d| d.coat)
        };
        Receiver {
            position,
            plane: tracer.planes().of(triangle),
            normal,
            geometric: face.side.orient(tracer.scene().geometric_normal(triangle)),
            coat,
            media: MediumStack::inside(medium),
        }
    }
}

impl FaceDraft {
    /// Unit shading normal at a point, on the side of the face. On a triangle of a curved mesh the scene's own: halfway between unit
    /// normals is not halfway between their ends, and halved again and again a cone's normals were 2° off.
    pub fn normal_at(&self, tracer: &Tracer, triangle: TriangleId, position: Vec3) -> Vec3 {
        self.side.orient(if self.curved {
            tracer.scene().shading_normal(triangle, barycentric(tracer, triangle, position))
        } else {
            self.frame.normal.as_vec3()
        })
    }
}

/// Barycentric coordinates of a point of a triangle.
pub fn barycentric(tracer: &Tracer, triangle: TriangleId, position: Vec3) -> Barycentric {
    let [a, b, c] = tracer.scene().corners(triangle).map(|p| p.as_dvec3());
    let (e, f, p) = (b - a, c - a, position.as_dvec3() - a);
    let n = e.cross(f);
    let d = n.length_squared().max(f64::MIN_POSITIVE);
    let u = (p.cross(f).dot(n) / d).clamp(0.0, 1.0);
    let v = (e.cross(p).dot(n) / d).clamp(0.0, 1.0 - u);
    Barycentric { u: u as f32, v: v as f32 }
}
