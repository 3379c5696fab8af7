//! Faces: coplanar triangles of one surface kind become one polygon, whatever soup they came in; curved surfaces keep
//! their triangles.

use std::collections::{BTreeMap, HashMap};

use glam::{DVec2, DVec3, Vec3};

use catoptric_scene::{Side, TriangleId, Union};
use catoptric_trace::{PlaneId, Tracer};

use crate::face_grid::FaceGrid;

/// A flat region of one material on one side.
#[derive(Clone, Debug)]
pub struct FaceDraft {
    /// Its triangles, ascending.
    pub triangles: Vec<TriangleId>,
    /// The side.
    pub side: Side,
    /// Its plane.
    pub plane: PlaneId,
    /// One triangle of a mesh with smooth normals.
    pub curved: bool,
    /// Frame of plane coordinates.
    pub frame: Frame,
    /// Finds triangles by place where there are many.
    pub grid: Option<FaceGrid>,
}

/// Plane coordinates: p = origin + x·axes\[0\] + y·axes\[1\].
#[derive(Clone, Copy, Debug)]
pub struct Frame {
    /// A corner of the face.
    pub origin: DVec3,
    /// Orthonormal axes in the plane.
    pub axes: [DVec3; 2],
    /// Unit normal of the front.
    pub normal: DVec3,
}

impl Frame {
    /// The frame of a triangle: origin at a corner, first axis along the longest edge.
    pub fn of(corners: [Vec3; 3]) -> Self {
        let p = corners.map(|c| c.as_dvec3());
        let longest = (0..3)
            .max_by(|&i, &j| {
                let length = |k: usize| (p[(k + 1) % 3] - p[k]).length();
                length(i).total_cmp(&length(j)).then(j.cmp(&i))
            })
            .unwrap_or(0);
        let normal = (p[1] - p[0]).cross(p[2] - p[0]).normalize_or_zero();
        // A right angle makes the legs the better axes: most rooms are made of rectangles.
        let right = (0..3).find(|&k| {
            let (a, b) = (p[(k + 1) % 3] - p[k], p[(k + 2) % 3] - p[k]);
            a.dot(b).abs() < 1e-4 * a.length() * b.length()
        });
        let start = right.unwrap_or(longest);
        let x = (p[(start + 1) % 3] - p[start]).normalize_or_zero();
        Self { origin: p[start], axes: [x, normal.cross(x)], normal }
    }

    /// Plane coordinates of a point.
    pub fn flat(&self, point: DVec3) -> DVec2 {
        let offset = point - self.origin;
        DVec2::new(offset.dot(self.axes[0]), offset.dot(self.axes[1]))
    }

    /// The point of plane coordinates.
    pub fn lift(&self, point: DVec2) -> DVec3 {
        self.origin + self.axes[0] * point.x + self.axes[1] * point.y
    }

    /// Signed distance of a point along the normal, metres.
    pub fn height(&self, point: DVec3) -> f64 {
        self.normal.dot(point - self.origin)
    }
}

/// Groups the diffuse sides of the scene.
pub fn faces(tracer: &Tracer) -> Vec<FaceDraft> {
    let scene = tracer.scene();
    let mut groups: BTreeMap<(u32, u32, bool, u32), Vec<TriangleId>> = BTreeMap::new();
    let mut curved: Vec<TriangleId> = Vec::new();
    for (index, _) in scene.triangles().iter().enumerate() {
        let id = TriangleId(index as u32);
        let material = scene.material_of(id);
        if !(material.may_be_diffuse() || (material.emits() && material.base_color.max_element() > 0.0)) {
            continue;
        }
        if !receives(tracer, id) {
            continue;
        }
        if scene.is_smooth(id) {
            curved.push(id);
            continue;
        }
        let plane = tracer.planes().of(id);
        let along = tracer.planes().plane(plane).normal.dot(scene.geometric_normal(id).as_dvec3()) > 0.0;
        // Textured materials keep their surfaces apart: display vertices carry texture coordinates for viewers.
        let surface =
            if material.base_texture.is_some() { scene.triangles()[index].surface.0 } else { u32::MAX };
        groups.entry((plane.0, scene.material_id_of(id).0, along, surface)).or_default().push(id);
    }

    let mut faces = Vec::new();
    for ((plane, ..), members) in groups {
        for triangles in islands(tracer, members) {
            // The largest triangle gives the most accurate frame.
            let largest = triangles
                .iter()
                .copied()
                .max_by(|&a, &b| scene.area(a).total_cmp(&scene.area(b)).then(b.cmp(&a)))
                .unwrap_or(triangles[0]);
            let frame = Frame::of(scene.corners(largest));
            push_sides(tracer, &mut faces, triangles, PlaneId(plane), false, frame);
        }
    }
    for id in curved {
        let frame = Frame::of(scene.corners(id));
        push_sides(tracer, &mut faces, vec![id], tracer.planes().of(id), true, frame);
    }
    faces
}

/// Whether any light that arrives matters: pure emitters (black base colour) need no irradiance.
fn receives(tracer: &Tracer, id: TriangleId) -> bool {
    let material = tracer.scene().material_of(id);
    material.base_color.max_element() > 0.0 || material.diffuse_transmission.max_element() > 0.0
}

fn push_sides(
    tracer: &Tracer,
    faces: &mut Vec<FaceDraft>,
    triangles: Vec<TriangleId>,
    plane: PlaneId,
    curved: bool,
    frame: Frame,
) {
    let back = tracer.has_back(triangles[0]);
    let grid = FaceGrid::new(tracer.scene(), &frame, &triangles);
    let front = FaceDraft { triangles, side: Side::Front, plane, curved, frame, grid };
    if back {
        faces.push(FaceDraft { side: Side::Back, ..front.clone() });
    }
    faces.push(front);
}

/// Splits triangles into groups that hang together by common corners.
fn islands(tracer: &Tracer, members: Vec<TriangleId>) -> Vec<Vec<TriangleId>> {
    if members.len() == 1 {
        return vec![members];
    }
    let scene = tracer.scene();
    let mut parts = Union::new(members.len());
    let mut seen: HashMap<[u32; 3], u32> = HashMap::new();
    for (index, &id) in members.iter().enumerate() {
        for corner in scene.corners(id) {
            let key = [corner.x, corner.y, corner.z].map(|c| (c + 0.0).to_bits());
            parts.join(index as u32, *seen.entry(key).or_insert(index as u32));
        }
    }
    let (part, count) = parts.numbered();
    let mut groups = vec![Vec::new(); count];
    for (part, id) in part.into_iter().zip(members) {
        groups[part as usize].push(id);
    }
    groups
}

#[cfg(test)]
mod tests {
    use catoptric_scene::{Material, Rgb, Scene, SceneParts};

    use super::*;

    /// A room and a ball as one mesh with normals: its walls are walls.
    #[test]
    fn walls_of_a_mesh_that_is_smooth_elsewhere_are_faces() {
        let mut parts = SceneParts::default();
        let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
        parts.add_box("room", white, Vec3::ZERO, Vec3::ONE, true);
        parts.add_sphere("ball", white, Vec3::splat(0.5), 0.2, 6);
        parts.join_surfaces();
        let scene = Scene::new(parts).expect("a valid scene");
        let faces = faces(&Tracer::new(&scene));
        let (curved, flat): (Vec<&FaceDraft>, Vec<&FaceDraft>) = faces.iter().partition(|face| face.curved);
        assert_eq!(flat.len(), 6);
        assert!(flat.iter().all(|face| face.triangles.len() == 2));
        assert_eq!(curved.len(), scene.triangles().len() - 12);
    }
}
