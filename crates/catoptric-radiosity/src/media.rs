//! In which medium a face lies: receivers inside of water or glass.

use std::collections::BTreeMap;

use glam::Vec3;
use rayon::prelude::*;

use catoptric_scene::{Material, Side, TriangleId};
use catoptric_trace::sequence::{Key, Purpose, cosine_hemisphere, frame};
use catoptric_trace::{MediumId, PlaneId, Ray, Tracer};

use crate::JOB;
use crate::draft::Draft;

/// Rays that vote per face.
const VOTES: u32 = 9;

/// Sets the medium of every base triangle and vertex: rays leave it, and the first border of a solid that they meet says by
/// its side whether they were inside. Opaque things on the way say nothing.
///
/// The surface of water cuts the faces that it crosses, and vertices are not shared across the cut: what hangs together
/// lies in one medium.
pub fn find_media(tracer: &Tracer, draft: &mut Draft) {
    if !has_solids(tracer) {
        return;
    }
    let regions = draft.regions();
    // The largest triangle of each region speaks for it; triangles of curved surfaces speak for themselves.
    let mut largest: BTreeMap<(u32, u32), (f32, u32)> = BTreeMap::new();
    let region = |draft: &Draft, root: usize| {
        let face = draft.face_of_root[root];
        let curved = draft.faces[face as usize].curved;
        (face, if curved { 0 } else { regions[root] })
    };
    for leaf in &draft.leaves {
        let area = draft.area(leaf);
        let best = largest.entry(region(draft, leaf.root as usize)).or_insert((area, leaf.root));
        if area > best.0 {
            *best = (area, leaf.root);
        }
    }
    let largest: Vec<((u32, u32), (f32, u32))> = largest.into_iter().collect();
    let medium_of: BTreeMap<(u32, u32), MediumId> = largest
        .into_par_iter()
        .with_max_len(JOB)
        .map(|(key, (_, root))| {
            let corners = draft.base[root as usize].map(|v| draft.vertices[v as usize].position);
            let center = corners.iter().sum::<Vec3>() / 3.0;
            let face = &draft.faces[key.0 as usize];
            (key, medium_before(tracer, center, face.triangle_at(tracer, center), face.side))
        })
        .collect();
    for root in (0..draft.roots).rev() {
        let medium = medium_of[&region(draft, root)];
        draft.medium_of_root[root] = medium;
        for v in draft.base[root] {
            draft.vertices[v as usize].medium = medium;
        }
    }
}

/// The medium before a side of a triangle at one of its points.
pub(crate) fn medium_before(tracer: &Tracer, origin: Vec3, triangle: TriangleId, side: Side) -> MediumId {
    if !has_solids(tracer) {
        return MediumId::AIR;
    }
    let normal = side.orient(tracer.scene().geometric_normal(triangle));
    let (tangent, bitangent) = frame(normal);
    let key = Key::new(0, Purpose::Test, u64::from(triangle.0) << 1 | side as u64);
    vote(tracer, origin, tracer.planes().of(triangle), |vote| {
        let local = cosine_hemisphere(key.point2(vote));
        tangent * local.x + bitangent * local.y + normal * local.z
    })
}

/// Whether anything is solid glass.
pub(crate) fn has_solids(tracer: &Tracer) -> bool {
    tracer.scene().materials().iter().any(Material::is_solid)
}

/// The medium at a point, by what its rays meet first.
pub(crate) fn vote(
    tracer: &Tracer,
    origin: Vec3,
    from: PlaneId,
    direction: impl Fn(u32) -> Vec3,
) -> MediumId {
    let mut inside = 0;
    let mut outside = 0;
    let mut medium = MediumId::AIR;
    for vote in 0..VOTES {
        match first_border(tracer, origin, direction(vote), from) {
            Some((found, true)) => {
                inside += 1;
                medium = found;
            }
            Some((_, false)) => outside += 1,
            None => {}
        }
    }
    if inside > outside { medium } else { MediumId::AIR }
}

/// The first solid border along a ray: its medium, and whether it is met from inside.
fn first_border(tracer: &Tracer, origin: Vec3, direction: Vec3, from: PlaneId) -> Option<(MediumId, bool)> {
    let scene = tracer.scene();
    let ray = Ray { origin, direction, from };
    let hit = tracer.nearest(&ray, f32::INFINITY)?;
    scene
        .material_of(hit.triangle)
        .is_solid()
        .then(|| (MediumId::inside(scene.material_id_of(hit.triangle)), hit.back))
}
