//! Lines along the edges of the display mesh, as wide as a pixel: the refinement made visible.
//!
//! A line belongs to the surface, so it is seen in mirrors and through glass. Its width is that of the pixel at the length of
//! the path, as planar mirrors keep it; curved surfaces magnify lines like all else.

use glam::Vec3;

use catoptric_scene::Film;
use catoptric_scene::quantity::LUMINANCE;
use catoptric_solution::{DisplayMesh, Located};
use catoptric_trace::walk::split::Seen;

/// Name of the layer: the share of a pixel that lines cover, by what of their light reaches the eye.
pub const LAYER: &str = "mesh.Y";

/// How wide a pixel is, across the ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Footprint {
    /// At the eye, metres: 0 in perspective.
    pub width: f32,
    /// Growth per metre of path.
    pub spread: f32,
}

impl Footprint {
    /// That of the pixel with this corner or centre.
    pub fn at(film: &Film, (x, y): (f32, f32)) -> Self {
        let (origin, direction) = film.ray(x, y);
        let (beside, other) = film.ray(x + 1.0, y);
        Self { width: origin.distance(beside), spread: direction.distance(other) }
    }
}

/// What lines cover where an eye path meets a surface, times the share of the surface's light that reaches the eye.
pub fn coverage(mesh: &DisplayMesh, seen: &Seen, footprint: Footprint) -> f32 {
    let interaction = seen.interaction;
    let locate = |side| mesh.locate(seen.hit.triangle, side, seen.position);
    let Some(at) = locate(interaction.side).or_else(|| locate(interaction.side.opposite())) else {
        return 0.0;
    };
    let pixel = footprint.width + footprint.spread * seen.distance;
    let covered = (1.0 - distance(mesh, &at, seen.position, seen.direction) / pixel).clamp(0.0, 1.0);
    covered * interaction.receives * seen.throughput.dot(LUMINANCE)
}

/// Distance from a point to the nearest edge of its element, across the direction of view.
///
/// Seen along ω, a point at w from a line along e spans the area |(w × e)·ω| with it, over a base as long as e appears.
fn distance(mesh: &DisplayMesh, at: &Located, position: Vec3, direction: Vec3) -> f32 {
    let corners = at.vertices.map(|v| mesh.vertices[v as usize].position);
    let across = |start: Vec3, end: Vec3| {
        let edge = end - start;
        let area = (start - position).cross(edge).dot(direction).abs();
        let base = edge.cross(direction).length();
        if base > 0.0 { area / base } else { f32::INFINITY }
    };
    let [a, b, c] = corners;
    across(a, b).min(across(b, c)).min(across(c, a))
}

#[cfg(test)]
mod tests {
    use catoptric_scene::{Side, TriangleId};
    use catoptric_solution::{DisplayVertex, Element, Face, FaceId};

    use super::*;

    fn triangle() -> DisplayMesh {
        let vertex = |x, y| DisplayVertex {
            position: Vec3::new(x, y, 0.0),
            normal: Vec3::Z,
            triangle: TriangleId(0),
            side: Side::Front,
        };
        let face = Face { elements: 0..1, origin: Vec3::ZERO, axes: [Vec3::X, Vec3::Y] };
        let vertices = vec![vertex(0.0, 0.0), vertex(4.0, 0.0), vertex(0.0, 4.0)];
        let face_of = [vec![FaceId(0)], vec![FaceId::NONE]];
        DisplayMesh::new(vertices, vec![Element { vertices: [0, 1, 2] }], vec![face], face_of)
    }

    #[test]
    fn distance_to_an_edge_is_foreshortened_with_the_surface() {
        let mesh = triangle();
        let position = Vec3::new(1.0, 0.5, 0.0);
        let at = mesh.locate(TriangleId(0), Side::Front, position).expect("inside");
        // Straight down: half a metre to the edge along x.
        assert!((distance(&mesh, &at, position, Vec3::NEG_Z) - 0.5).abs() < 1e-6);
        // Tilted by 60° about the x axis, that edge looks half as far; about the y axis, unchanged.
        let tilted = |x: f32, y: f32| Vec3::new(x, y, -0.5).normalize_or_zero();
        let root = 0.75_f32.sqrt();
        assert!((distance(&mesh, &at, position, tilted(0.0, root)) - 0.25).abs() < 1e-6);
        assert!((distance(&mesh, &at, position, tilted(root, 0.0)) - 0.5).abs() < 1e-6);
    }
}
