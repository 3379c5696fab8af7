//! How many of the samples for the sky a place gets: fewer where the author's mesh is finer than walls are cut, so that the cost follows
//! the area and not the triangle count.

use crate::draft::{Draft, Leaf};

/// Which share of the samples the sky gets.
pub(crate) struct SkyShares {
    /// At least.
    least: f32,
    /// Edge length of what walls are cut into, metres.
    spacing: f32,
    /// Per vertex of the base mesh its longest edge, metres; none where all get all.
    longest: Vec<f32>,
}

/// Base vertices from which on not all get all, and the least share.
const MANY_VERTICES: f32 = 50_000.0;
const LEAST_SHARE: f32 = 0.25;
/// Edges from this multiple of the spacing on get all: a wall's do, also those that are halved since something is near. (A room of 99 thousand
/// triangles behind a wall of glass: by a quarter of the samples for all, noise splits edges all over the walls, and they are mottled.)
const WHOLE_EDGE: f32 = 0.5;

impl SkyShares {
    /// For a base mesh.
    pub(crate) fn new(draft: &Draft, spacing: f32) -> Self {
        let vertices = draft.vertices.len();
        let least = (MANY_VERTICES / vertices.max(1) as f32).clamp(LEAST_SHARE, 1.0);
        let longest = if least < 1.0 { longest_edges(draft) } else { Vec::new() };
        Self { least, spacing, longest }
    }

    /// That of a place among edges of this length, metres.
    pub(crate) fn beside(&self, length: f32) -> f32 {
        (length / (WHOLE_EDGE * self.spacing)).clamp(self.least, 1.0)
    }

    /// That of a vertex. Later ones than those of the base mesh halve edges.
    pub(crate) fn at(&self, draft: &Draft, vertex: u32) -> f32 {
        if self.least >= 1.0 {
            return 1.0;
        }
        let halved = || draft.vertices[vertex as usize].parents.map_or(0.0, |[a, b]| draft.length((a, b)));
        self.beside(self.longest.get(vertex as usize).copied().unwrap_or_else(halved))
    }
}

/// Per vertex the longest edge, metres.
fn longest_edges(draft: &Draft) -> Vec<f32> {
    let mut longest = vec![0.0_f32; draft.vertices.len()];
    for (a, b) in draft.leaves.iter().flat_map(Leaf::edges) {
        let length = draft.length((a, b));
        for v in [a as usize, b as usize] {
            longest[v] = longest[v].max(length);
        }
    }
    longest
}

#[cfg(test)]
mod tests {
    use catoptric_scene::{Material, Rgb, Scene, SceneParts};
    use catoptric_trace::Tracer;
    use glam::Vec3;

    use super::*;
    use crate::base_mesh::coarse_patches;

    #[test]
    fn walls_get_all_samples_and_what_is_fine_gets_fewer() {
        let mut parts = SceneParts::default();
        let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
        parts.add_quad("wall", white, Vec3::ZERO, Vec3::X * 4.0, Vec3::Y * 4.0);
        // A tile of one centimetre, apart from it.
        parts.add_quad("tile", white, Vec3::Z, Vec3::X * 0.01, Vec3::Y * 0.01);
        let scene = Scene::new(parts).expect("a valid scene");
        let tracer = Tracer::new(&scene);
        let (mut draft, _) = coarse_patches(&tracer, 200);
        let spacing = 0.4;
        let few = SkyShares::new(&draft, spacing);
        assert!((0..draft.vertices.len() as u32).all(|v| few.at(&draft, v) == 1.0));

        // As among many.
        let many = SkyShares { least: 0.25, spacing, longest: longest_edges(&draft) };
        let share_on = |z: f32| {
            let at = |v: &u32| draft.vertices[*v as usize].position.z == z;
            let shares: Vec<f32> =
                (0..draft.vertices.len() as u32).filter(at).map(|v| many.at(&draft, v)).collect();
            assert!(!shares.is_empty());
            shares
        };
        assert!(share_on(0.0).iter().all(|&share| share == 1.0), "{:?}", share_on(0.0));
        assert!(share_on(1.0).iter().all(|&share| share == 0.25), "{:?}", share_on(1.0));

        // A vertex made later gets as much as the edge that it halves: on a wall all, and half on a quarter of the spacing.
        let on_wall =
            |&&(a, b): &&(u32, u32)| [a, b].iter().all(|&v| draft.vertices[v as usize].position.z == 0.0);
        let edges = draft.edges();
        let (a, b) = *edges.iter().find(on_wall).expect("an edge of the wall");
        draft.make_midpoints(&tracer, &[(a, b)]);
        let middle = draft.known_midpoint(a, b).expect("it was made");
        assert_eq!(many.at(&draft, middle), 1.0);
        assert!((many.beside(0.25 * spacing) - 0.5).abs() < 1e-6);
    }
}
