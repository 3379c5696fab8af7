//! In which medium a face lies: receivers inside of water or glass.

use glam::Vec3;

use catoptric_scene::{Transmission, TriangleId};
use catoptric_trace::sequence::{Key, Purpose, cosine_hemisphere, frame};
use catoptric_trace::{MediumId, Ray, Tracer};

use crate::face::FaceDraft;

/// Rays that vote per face.
const VOTES: u32 = 9;

/// Sets the medium of every face: rays leave it, and the first border of a solid that they meet says by its side
/// whether they were inside. Opaque things on the way say nothing.
pub fn find_media(tracer: &Tracer, faces: &mut [FaceDraft]) {
    let scene = tracer.scene();
    let solid =
        |m: &catoptric_scene::Material| m.transmission > 0.0 && m.transmission_kind == Transmission::Solid;
    if !scene.materials().iter().any(solid) {
        return;
    }
    for (index, face) in faces.iter_mut().enumerate() {
        let triangle = face.triangles[0];
        let normal = face.side.orient(scene.geometric_normal(triangle));
        let [a, b, c] = scene.corners(triangle);
        let origin = (a + b + c) / 3.0;
        let (tangent, bitangent) = frame(normal);
        let key = Key::new(0, Purpose::Test, index as u64);
        let mut inside = 0;
        let mut outside = 0;
        let mut medium = MediumId::AIR;
        for vote in 0..VOTES {
            let local = cosine_hemisphere(key.point2(vote));
            let direction = tangent * local.x + bitangent * local.y + normal * local.z;
            match first_border(tracer, origin, direction, triangle) {
                Some((found, true)) => {
                    inside += 1;
                    medium = found;
                }
                Some((_, false)) => outside += 1,
                None => {}
            }
        }
        if inside > outside {
            face.medium = medium;
        }
    }
}

/// The first solid border along a ray: its medium, and whether it is met from inside.
fn first_border(
    tracer: &Tracer,
    origin: Vec3,
    direction: Vec3,
    from: TriangleId,
) -> Option<(MediumId, bool)> {
    let scene = tracer.scene();
    let ray = Ray { origin, direction, from: tracer.planes().of(from) };
    let hit = tracer.nearest(&ray, f32::INFINITY)?;
    let material = scene.material_of(hit.triangle);
    let solid = material.transmission > 0.0 && material.transmission_kind == Transmission::Solid;
    solid.then(|| (MediumId::inside(scene.material_id_of(hit.triangle)), hit.back))
}
