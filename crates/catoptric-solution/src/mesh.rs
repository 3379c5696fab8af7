//! The display mesh: flat elements on the diffuse sides of the scene, with irradiance at their vertices.

use glam::{Vec2, Vec3};

use catoptric_scene::{Barycentric, Side, TriangleId};

use crate::locator::Locator;

/// A face of a [`DisplayMesh`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct FaceId(pub u32);

impl FaceId {
    /// The side has no display elements: it is black or ideal.
    pub const NONE: Self = Self(u32::MAX);
}

/// A vertex of the display mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DisplayVertex {
    /// World position, metres.
    pub position: Vec3,
    /// Unit normal on the vertex's side, with which irradiance was gathered.
    pub normal: Vec3,
    /// A triangle of the scene that it lies on.
    pub triangle: TriangleId,
    /// The side.
    pub side: Side,
}

/// A triangle of the display mesh.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Element {
    /// Indices of its vertices.
    pub vertices: [u32; 3],
}

/// A flat region of the mesh: coplanar triangles of one material on one side, or one triangle of a curved surface.
#[derive(Clone, Debug, PartialEq)]
pub struct Face {
    /// Its elements.
    pub elements: std::ops::Range<u32>,
    /// Origin of its plane coordinates, world.
    pub origin: Vec3,
    /// Unit axes of its plane.
    pub axes: [Vec3; 2],
}

impl Face {
    /// Plane coordinates of a point.
    #[inline]
    pub fn plane_point(&self, position: Vec3) -> Vec2 {
        let offset = position - self.origin;
        Vec2::new(offset.dot(self.axes[0]), offset.dot(self.axes[1]))
    }
}

/// Where a point lies in the mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Located {
    /// Vertices of the element.
    pub vertices: [u32; 3],
    /// Their weights, ≥ 0, sum 1.
    pub weights: [f32; 3],
    /// The element.
    pub element: u32,
}

/// The mesh. Elements are grouped by face; a triangle of the scene knows its faces by side.
#[derive(Clone, Debug, Default)]
pub struct DisplayMesh {
    /// Vertices.
    pub vertices: Vec<DisplayVertex>,
    /// Elements, grouped by face.
    pub elements: Vec<Element>,
    /// Faces.
    pub faces: Vec<Face>,
    /// Face of each triangle of the scene: fronts, backs.
    pub face_of: [Vec<FaceId>; 2],
    locator: Locator,
}

impl DisplayMesh {
    /// Builds the look-up structure.
    pub fn new(
        vertices: Vec<DisplayVertex>,
        elements: Vec<Element>,
        faces: Vec<Face>,
        face_of: [Vec<FaceId>; 2],
    ) -> Self {
        let locator = Locator::new(&vertices, &elements, &faces);
        Self { vertices, elements, faces, face_of, locator }
    }

    /// The face of a side of a triangle.
    #[inline]
    pub fn face(&self, triangle: TriangleId, side: Side) -> Option<FaceId> {
        let face = self.face_of[side.index()].get(triangle.index()).copied()?;
        (face != FaceId::NONE).then_some(face)
    }

    /// The element at `position` on a side of a triangle, `None` where that side has none.
    #[inline]
    pub fn locate(&self, triangle: TriangleId, side: Side, position: Vec3) -> Option<Located> {
        let id = self.face(triangle, side)?;
        let face = &self.faces[id.0 as usize];
        let (element, weights) = self.locator.find(id, face, face.plane_point(position))?;
        Some(Located { vertices: self.elements[element as usize].vertices, weights, element })
    }

    /// Position of barycentric coordinates in an element.
    pub fn position_in(&self, element: u32, at: Barycentric) -> Vec3 {
        let [a, b, c] = self.elements[element as usize].vertices.map(|v| self.vertices[v as usize].position);
        a + (b - a) * at.u + (c - a) * at.v
    }

    /// Area of an element, m².
    pub fn area(&self, element: u32) -> f32 {
        let [a, b, c] = self.elements[element as usize].vertices.map(|v| self.vertices[v as usize].position);
        0.5 * (b - a).cross(c - a).length()
    }

    /// Checks the invariants; says what is broken.
    pub fn validate(&self) -> Result<(), String> {
        let vertices = self.vertices.len() as u32;
        if let Some(bad) = self.elements.iter().position(|e| e.vertices.iter().any(|&v| v >= vertices)) {
            return Err(format!("element {bad} points outside of the {vertices} vertices"));
        }
        let mut next = 0;
        for (index, face) in self.faces.iter().enumerate() {
            if face.elements.start != next || face.elements.end < next {
                return Err(format!("the elements of face {index} are not consecutive"));
            }
            next = face.elements.end;
        }
        if next as usize != self.elements.len() {
            return Err("some elements belong to no face".to_owned());
        }
        let faces = self.faces.len() as u32;
        if self.face_of.iter().flatten().any(|f| *f != FaceId::NONE && f.0 >= faces) {
            return Err(format!("a triangle points outside of the {faces} faces"));
        }
        Ok(())
    }
}
