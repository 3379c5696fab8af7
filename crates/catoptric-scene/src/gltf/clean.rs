//! Makes the triangles fit for transport: no area, no triangle; one of several that coincide; normals on
//! the front side; which of them are smooth.

use std::hash::{DefaultHasher, Hash, Hasher};

use glam::{DVec3, Vec3};

use crate::id::{MaterialId, SurfaceId};
use crate::scene::{SceneParts, Triangle, Vertex};

use super::report::Report;

/// How many triangles of different materials may lie on the same three points.
const MOST_COINCIDENT: usize = 8;

/// Drops triangles without area and repeated ones, then surfaces without triangles. `normal_precision`
/// runs along the surfaces.
pub(super) fn clean(parts: &mut SceneParts, normal_precision: &mut Vec<f32>, report: &Report) {
    let kept = choose_triangles(parts, report);
    let mut triangles = Vec::with_capacity(parts.triangles.len());
    let mut surfaces = Vec::with_capacity(parts.surfaces.len());
    let mut precision = Vec::with_capacity(surfaces.len());
    for (index, mut surface) in std::mem::take(&mut parts.surfaces).into_iter().enumerate() {
        let start = triangles.len() as u32;
        let id = SurfaceId(surfaces.len() as u32);
        for at in surface.triangles.clone().map(|at| at as usize) {
            if kept[at] {
                let mut triangle = parts.triangles[at];
                triangle.surface = id;
                triangles.push(triangle);
            }
        }
        surface.triangles = start..triangles.len() as u32;
        if !surface.triangles.is_empty() {
            surfaces.push(surface);
            precision.push(normal_precision[index]);
        }
    }
    parts.triangles = triangles;
    parts.surfaces = surfaces;
    *normal_precision = precision;
}

/// What is said of the triangles of a surface.
#[derive(Clone, Copy, Default)]
struct Counts {
    flat: usize,
    repeated: usize,
    fighting: usize,
}

/// Per triangle: whether it stays.
fn choose_triangles(parts: &SceneParts, report: &Report) -> Vec<bool> {
    let mut kept = vec![true; parts.triangles.len()];
    let mut counts = vec![Counts::default(); parts.surfaces.len()];
    let mut places: Vec<(u64, u32)> = Vec::with_capacity(parts.triangles.len());
    for (surface, counts) in parts.surfaces.iter().zip(&mut counts) {
        for at in surface.triangles.clone() {
            let key = key_of(parts, at as usize);
            if has_area(key.map(Vec3::from_array)) {
                let mut hasher = DefaultHasher::new();
                key.map(|corner| corner.map(f32::to_bits)).hash(&mut hasher);
                places.push((hasher.finish(), at));
            } else {
                kept[at as usize] = false;
                counts.flat += 1;
            }
        }
    }
    // Triangles on the same three points, by hash; the first of a material stays.
    places.sort_unstable();
    let surface_of = |at: u32| parts.triangles[at as usize].surface.index();
    for group in places.chunk_by(|a, b| a.0 == b.0).filter(|group| group.len() > 1) {
        let mut here: Vec<u32> = Vec::new();
        for &(_, at) in group {
            let key = key_of(parts, at as usize);
            let material = |at: u32| parts.surfaces[surface_of(at)].material;
            let coincident = here.iter().filter(|&&other| key_of(parts, other as usize) == key);
            let materials: Vec<MaterialId> = coincident.map(|&other| material(other)).collect();
            let counts = &mut counts[surface_of(at)];
            if materials.contains(&material(at)) || materials.len() >= MOST_COINCIDENT {
                kept[at as usize] = false;
                counts.repeated += 1;
            } else {
                counts.fighting += usize::from(!materials.is_empty());
                here.push(at);
            }
        }
    }
    for (surface, &Counts { flat, repeated, fighting }) in parts.surfaces.iter().zip(&counts) {
        let say = |count: usize, what: &str| {
            if count > 0 {
                report.warn(format!("surface {:?}", surface.name), format!("{count} {what}"));
            }
        };
        say(flat, "triangles have no area and were dropped");
        say(repeated, "triangles lie exactly on others of the same material and were dropped");
        say(
            fighting,
            "triangles lie exactly on others of another material: of two that show a face, the one of the surface that is smaller in \
             that plane is seen",
        );
    }
    kept
}

/// The corners, turned so that the smallest comes first: equal for equal triangles of equal winding.
fn key_of(parts: &SceneParts, triangle: usize) -> [[f32; 3]; 3] {
    let mut corners = parts.triangles[triangle]
        .vertices
        // Adding zero turns −0 into 0.
        .map(|v| (parts.vertices[v as usize].position + Vec3::ZERO).to_array());
    let bits = |corner: &[f32; 3]| corner.map(f32::to_bits);
    let first = (0..3).min_by_key(|&i| bits(&corners[i])).unwrap_or(0);
    corners.rotate_left(first);
    corners
}

/// The test of [`Scene::new`](crate::Scene::new), which refuses triangles without area.
fn has_area([a, b, c]: [Vec3; 3]) -> bool {
    let twice_area = (b.as_dvec3() - a.as_dvec3()).cross(c.as_dvec3() - a.as_dvec3()).length();
    twice_area.is_finite() && ((0.5 * twice_area) as f32) > 0.0 && ((0.5 * twice_area) as f32).is_finite()
}

/// Difference between the normals of a flat triangle's corners, in a mesh that is smooth elsewhere: exporters give them from one
/// face or from a plane of several, within their rounding. Those of curved meshes differ by as much as they do from the face's.
const SAME_NORMAL: f64 = 1e-4;
/// … and between them and the face's.
const OWN_NORMAL: f64 = 1e-3;

/// Completes normals, turns those that point against their faces, and finds out which triangles are smooth: those of a surface
/// if some normal differs from its face's by more than both are known to, but for the flat ones among them, such as walls in a mesh
/// of a whole building.
pub(super) fn finish_normals(parts: &mut SceneParts, normal_precision: &[f32], report: &Report) {
    for (surface, &precision) in parts.surfaces.iter().zip(normal_precision) {
        let range = surface.triangles.start as usize..surface.triangles.end as usize;
        let triangles = &mut parts.triangles[range];
        if !triangles.iter().any(|triangle| triangle.smooth) {
            continue;
        }

        // The vertices of a surface are consecutive: sum the faces' area vectors at each, and count on
        // which side of the faces its normal lies.
        let first = triangles.iter().flat_map(|t| t.vertices).min().unwrap_or(0) as usize;
        let last = triangles.iter().flat_map(|t| t.vertices).max().unwrap_or(0) as usize;
        let mut faces = vec![DVec3::ZERO; last - first + 1];
        let mut sides = vec![(0_u32, 0_u32); last - first + 1];
        for triangle in &*triangles {
            let [a, b, c] = triangle.vertices.map(|v| parts.vertices[v as usize].position.as_dvec3());
            let face = (b - a).cross(c - a);
            for vertex in triangle.vertices.map(|v| v as usize) {
                faces[vertex - first] += face;
                let side = face.dot(parts.vertices[vertex].normal.as_dvec3());
                if side > 0.0 {
                    sides[vertex - first].0 += 1;
                } else if side < 0.0 {
                    sides[vertex - first].1 += 1;
                }
            }
        }
        let mut turned = 0_usize;
        for (vertex, (face, (front, back))) in
            parts.vertices[first..=last].iter_mut().zip(faces.iter().zip(&sides))
        {
            if vertex.normal == Vec3::ZERO {
                vertex.normal = face.try_normalize().unwrap_or(DVec3::ZERO).as_vec3();
            } else if *front == 0 && *back > 0 {
                vertex.normal = -vertex.normal;
                turned += 1;
            }
        }
        if turned > 0 {
            let message = format!("{turned} normals pointed to the back of all their faces and were turned");
            report.warn(format!("surface {:?}", surface.name), message);
        }

        let tilts: Vec<Tilt> = triangles.iter().map(|triangle| Tilt::of(&parts.vertices, triangle)).collect();
        let is_smooth = tilts.iter().any(|tilt| tilt.from_face > f64::from(precision) + tilt.rounding);
        for (triangle, tilt) in triangles.iter_mut().zip(tilts) {
            let is_flat = tilt.apart <= SAME_NORMAL && tilt.from_face <= OWN_NORMAL + tilt.rounding;
            triangle.smooth = is_smooth && !is_flat;
        }
    }
}

/// How far the normals of a triangle's corners are from one another, as sines.
struct Tilt {
    /// From the face's, at most.
    from_face: f64,
    /// From each other, at most.
    apart: f64,
    /// How much rounded corners may tilt the face.
    rounding: f64,
}

impl Tilt {
    fn of(vertices: &[Vertex], triangle: &Triangle) -> Self {
        let corners = triangle.vertices.map(|v| vertices[v as usize]);
        let [a, b, c] = corners.map(|corner| corner.position.as_dvec3());
        let normals = corners.map(|corner| corner.normal.as_dvec3());
        let cross = (b - a).cross(c - a);
        let face = cross.try_normalize().unwrap_or(DVec3::ZERO);
        // Rounding moves a corner by at most 2⁻²⁴·|p| per axis, which tilts the face by that over its height.
        let size = [a, b, c].into_iter().map(|p| p.abs().max_element()).fold(0.0, f64::max);
        let longest = (b - a).length().max((c - a).length()).max((c - b).length());
        let height = cross.length() / longest;
        Self {
            from_face: normals.iter().map(|normal| face.cross(*normal).length()).fold(0.0, f64::max),
            apart: (0..3).map(|k| (normals[k] - normals[(k + 1) % 3]).length()).fold(0.0, f64::max),
            rounding: 2.0 * 3.0_f64.sqrt() * size * f64::from(f32::EPSILON) / height,
        }
    }
}
