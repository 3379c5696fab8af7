//! In which medium a face lies: receivers inside of water or glass.

use glam::Vec3;

use catoptric_scene::Transmission;
use catoptric_trace::sequence::{Key, Purpose, cosine_hemisphere, frame};
use catoptric_trace::{MediumId, PlaneId, Ray, Tracer};

use crate::face::FaceDraft;

/// Rays that vote per face.
const VOTES: u32 = 9;

/// Sets the medium of every face: rays leave it, and the first border of a solid that they meet says by its side
/// whether they were inside. Opaque things on the way say nothing.
pub fn find_media(tracer: &Tracer, faces: &mut [FaceDraft]) {
    let scene = tracer.scene();
    if !has_solids(tracer) {
        return;
    }
    for (index, face) in faces.iter_mut().enumerate() {
        let triangle = face.triangles[0];
        let normal = face.side.orient(scene.geometric_normal(triangle));
        let [a, b, c] = scene.corners(triangle);
        let origin = (a + b + c) / 3.0;
        let (tangent, bitangent) = frame(normal);
        let key = Key::new(0, Purpose::Test, index as u64);
        let from = tracer.planes().of(triangle);
        face.medium = vote(tracer, origin, from, |vote| {
            let local = cosine_hemisphere(key.point2(vote));
            tangent * local.x + bitangent * local.y + normal * local.z
        });
    }
}

/// Whether anything is solid glass.
pub(crate) fn has_solids(tracer: &Tracer) -> bool {
    let solid =
        |m: &catoptric_scene::Material| m.transmission > 0.0 && m.transmission_kind == Transmission::Solid;
    tracer.scene().materials().iter().any(solid)
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
    let material = scene.material_of(hit.triangle);
    let solid = material.transmission > 0.0 && material.transmission_kind == Transmission::Solid;
    solid.then(|| (MediumId::inside(scene.material_id_of(hit.triangle)), hit.back))
}
