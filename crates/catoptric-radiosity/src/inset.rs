//! Where vertices on the borders of flat faces are sampled: a little inside their own triangles, on their own side of what touches or
//! hangs before the face.

use glam::Vec3;
use rustc_hash::FxHashMap;

use crate::draft::{Draft, edge};

/// Share of the way to the element's centre by which gathering points of border vertices are drawn inside: above f32
/// rounding at any scale, below what a pixel shows.
pub(crate) const INSET: f32 = 0.01;

/// Beside what hangs or stands before a face light is gathered as far inside as this multiple of its gap, as the dark that
/// shows through the gap is narrower than elements: as far as that a tenth of the light from an upright side is missing
/// (1 − 2/√5).
pub(crate) const BESIDE_GAP: f32 = 2.0;
/// … but not by more than this share of the way.
const MAX_INSET: f32 = 0.15;

/// Weights of a random point of an element, drawn inside as far: on a contact line, f32 may round it to the other side.
pub(crate) fn drawn_inside((u, v): (f32, f32)) -> [f32; 3] {
    [1.0 - u - v, u, v].map(|weight| weight + (1.0 / 3.0 - weight) * INSET)
}

/// Where a vertex's own triangles lie.
#[derive(Clone, Copy, Default)]
struct Around {
    /// Sum of the offsets of their centres.
    centers: Vec3,
    count: f32,
    /// The integral of the unit vectors over the angle that they span: along its middle.
    middle: Vec3,
}

/// Cosine of the angle from its middle within which an offset lies in an angle of half a turn or more.
const NEAR_MIDDLE: f32 = 0.5;

impl Around {
    /// Adds a triangle, by the offsets of its centre and of its other two corners.
    fn push(&mut self, center: Vec3, sides: [Vec3; 2]) {
        self.centers += center;
        self.count += 1.0;
        let [a, b] = sides.map(Vec3::normalize_or_zero);
        // tan(θ/2) = sin θ / (1 + cos θ).
        self.middle += (a + b) * (a.cross(b).length() / (1.0 + a.dot(b)).max(1e-6));
    }

    /// From the vertex into its triangles: to the mean of their centres, unless that lies in what they surround by more than half a turn, such
    /// as the foot of a box.
    fn inwards(&self) -> Vec3 {
        let (center, middle) = (self.centers / self.count, self.middle.normalize_or_zero());
        let way = center.length();
        if center.dot(middle) >= NEAR_MIDDLE * way { center } else { middle * way }
    }
}

impl Draft {
    /// Draws the gathering points of flat border vertices inside, farther where a gap is beside them (metres, by vertex).
    pub(crate) fn inset_borders(&mut self, gaps: &[f64]) {
        let mut count: FxHashMap<(u32, u32), u32> = FxHashMap::default();
        for leaf in &self.leaves {
            for k in 0..3 {
                *count.entry(edge(leaf.vertices[k], leaf.vertices[(k + 1) % 3])).or_default() += 1;
            }
        }
        let mut border = vec![false; self.vertices.len()];
        for leaf in &self.leaves {
            for k in 0..3 {
                let (a, b) = (leaf.vertices[k], leaf.vertices[(k + 1) % 3]);
                if count[&edge(a, b)] == 1 {
                    border[a as usize] = true;
                    border[b as usize] = true;
                }
            }
        }
        let mut around = vec![Around::default(); self.vertices.len()];
        for leaf in &self.leaves {
            let center = self.center(leaf);
            for k in 0..3 {
                let [v, p, q] = [0, 1, 2].map(|i| leaf.vertices[(k + i) % 3] as usize);
                let position = self.vertices[v].position;
                let sides = [p, q].map(|end| self.vertices[end].position - position);
                around[v].push(center - position, sides);
            }
        }
        for (index, vertex) in self.vertices.iter_mut().enumerate() {
            if border[index] && around[index].count > 0.0 && !self.faces[vertex.face as usize].curved {
                let inwards = around[index].inwards();
                let beside = BESIDE_GAP * gaps[index] as f32 / inwards.length().max(f32::MIN_POSITIVE);
                vertex.sample = vertex.position + inwards * INSET;
                vertex.outlook = vertex.position + inwards * beside.clamp(INSET, MAX_INSET);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use catoptric_scene::{Material, Rgb, Scene, SceneParts};
    use catoptric_trace::Tracer;

    use crate::base_mesh::coarse_patches;
    use crate::detail::is_inside;

    /// Around the corners of a picture just before it, a wall spans three quarters of a turn in triangles of all sizes: each vertex still
    /// looks from the side of its own, and not from behind the picture.
    #[test]
    fn every_vertex_is_sampled_on_the_side_of_its_own_triangles() {
        let mut checked = 0;
        for case in 0..256_u16 {
            let mut parts = SceneParts::default();
            let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
            parts.add_quad("wall", white, Vec3::new(-1.5, 0.0, 0.0), Vec3::X * 3.0, Vec3::Y * 2.2);
            let [a, b, c] = [case % 8, case / 8 % 8, case / 64].map(f32::from);
            let corner = Vec3::new(-1.4 + 0.1 * a, 0.1 + 0.1 * b, 1e-4);
            parts.add_quad("picture", white, corner, Vec3::X * (0.4 + 0.2 * c), Vec3::Y);
            let scene = Scene::new(parts).expect("a valid scene");
            let (draft, _) = coarse_patches(&Tracer::new(&scene), 200 + 20 * usize::from(case / 64));
            let mut own = vec![Vec::new(); draft.vertices.len()];
            for leaf in &draft.leaves {
                for v in leaf.vertices {
                    own[v as usize].push(leaf.vertices.map(|v| draft.vertices[v as usize].position));
                }
            }
            for (vertex, own) in draft.vertices.iter().zip(own) {
                // Those in the interior are sampled where they are; some are left from triangles that were divided otherwise.
                let moved = vertex.sample.distance(vertex.position) > 1e-4 && !own.is_empty();
                if moved && vertex.position.z == 0.0 {
                    // On the way there: the smallest may end before it.
                    let way = vertex.position.lerp(vertex.sample, 0.05);
                    assert!(
                        own.iter().any(|&corners| is_inside(way, corners)),
                        "{case}: {}",
                        vertex.position
                    );
                    checked += 1;
                }
            }
        }
        assert!(checked > 256 * 40, "{checked}");
    }
}
