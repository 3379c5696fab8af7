//! A point on a diffuse side that receives light.

use glam::Vec3;

use catoptric_scene::{Barycentric, Scene, Side, TriangleId};
use catoptric_trace::interaction::Coat;
use catoptric_trace::{MediumStack, PlaneId, Tracer};

/// Where light is gathered.
#[derive(Clone, Copy, Debug)]
pub struct Receiver {
    /// Position, metres.
    pub position: Vec3,
    /// The plane it lies in, which its rays ignore.
    pub plane: PlaneId,
    /// Unit normal for the cosine (interpolated where the mesh is smooth), on the receiving side.
    pub normal: Vec3,
    /// Unit geometric normal on the receiving side: nothing arrives from below it.
    pub geometric: Vec3,
    /// Coat over the diffuse side: irradiance is H_T = ∫ L·T·cosθ dω.
    pub coat: Coat,
    /// Medium on this side.
    pub media: MediumStack,
}

impl Receiver {
    /// A receiver on a side of a triangle, without a coat and in air.
    pub fn on(tracer: &Tracer, triangle: TriangleId, side: Side, at: Barycentric) -> Self {
        let scene: &Scene = tracer.scene();
        let point = scene.surface_point(triangle, at);
        let coat = tracer.diffuse_side(triangle, &point, side).map_or(Coat::NONE, |d| d.coat);
        Self {
            position: scene.position(triangle, at),
            plane: tracer.planes().of(triangle),
            normal: side.orient(scene.shading_normal(triangle, at)),
            geometric: side.orient(scene.geometric_normal(triangle)),
            coat,
            media: MediumStack::AIR,
        }
    }
}
