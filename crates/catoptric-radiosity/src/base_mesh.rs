//! What a scene is cut into before its light is known.

use catoptric_scene::TriangleId;
use catoptric_trace::Tracer;

use crate::contact::Obstacles;
use crate::draft::Draft;
use crate::face::faces;
use crate::lattice::{Lattice, spacing_for};
use crate::patch::PatchMesh;
use crate::solve::SolveParams;

/// Triangles of the author that hold light, for each that walls are cut into.
const OWN_PER_TRIANGLE: usize = 40;

/// The diffuse surfaces of a scene, cut into triangles.
pub(crate) fn base_mesh(tracer: &Tracer, params: &SolveParams) -> (Draft, Lattice) {
    let base_triangles = lattice_budget(params.base_triangles, diffuse_triangles(tracer).count());
    let ((faces, lattice), obstacles) = rayon::join(
        || {
            let faces = faces(tracer);
            let lattice = Lattice::new(tracer, &faces, base_triangles);
            (faces, lattice)
        },
        || Obstacles::new(tracer),
    );
    let draft = Draft::on(tracer, &obstacles, faces, &lattice, params.near.finest(lattice.spacing));
    (draft, lattice)
}

/// What a scene is cut into before its light is known: patches, and vertices, of which light asks for more.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MeshCount {
    /// Patches of the coarse solve.
    pub patches: usize,
    /// Vertices.
    pub vertices: usize,
}

/// Cuts a scene as [`solve`](crate::solve::solve) begins with, and counts.
pub fn count_mesh(tracer: &Tracer, params: &SolveParams) -> MeshCount {
    let (draft, lattice) = base_mesh(tracer, params);
    let patches = PatchMesh::new(tracer, &draft, lattice.spacing);
    MeshCount { patches: patches.len(), vertices: draft.vertices.len() }
}

/// The draft and the patches of a coarse solve with about `count` base triangles.
pub fn coarse_patches(tracer: &Tracer, count: usize) -> (Draft, PatchMesh) {
    let spacing = spacing(tracer, count);
    let draft = Draft::new(tracer, spacing);
    let patches = PatchMesh::new(tracer, &draft, spacing);
    (draft, patches)
}

/// Edge length for which the diffuse area gives about `count` triangles.
fn spacing(tracer: &Tracer, count: usize) -> f32 {
    spacing_for(diffuse_area(tracer), count.max(1) as f32)
}

/// Area of the author's triangles that hold light, on all their sides, m².
pub(crate) fn diffuse_area(tracer: &Tracer) -> f64 {
    let sides = |t| if tracer.has_back(t) { 2.0 } else { 1.0 };
    diffuse_triangles(tracer).map(|t| f64::from(tracer.scene().area(t)) * sides(t)).sum()
}

/// The author's triangles that hold light.
fn diffuse_triangles(tracer: &Tracer) -> impl Iterator<Item = TriangleId> {
    let scene = tracer.scene();
    let all = (0..scene.triangles().len() as u32).map(TriangleId);
    all.filter(|&t| scene.material_of(t).may_be_diffuse())
}

/// Triangles of walls: a share of the author's own where that is more than the budget. Among so many, twice as many of ours cost
/// little.
fn lattice_budget(budget: usize, own: usize) -> usize {
    (own / OWN_PER_TRIANGLE).clamp(budget, 2 * budget)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lattice_follows_what_the_author_has_made_within_bounds() {
        // A simple room, one whose own triangles outnumber the budget forty times and a half, and a city.
        assert_eq!([100, 12_000, 10_000_000].map(|own| lattice_budget(200, own)), [200, 300, 400]);
    }
}
