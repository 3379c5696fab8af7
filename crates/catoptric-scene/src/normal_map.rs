//! Normal maps: the normal that the eye sees where a texture bends it.
//!
//! glTF 2.0, §3.9.3 and §3.7.2.1: 2·texel − 1 are the components along tangent t, bitangent b and normal n, the first two
//! times the map's scale; b = w·(n × t). Where a file has no tangents it wants those of MikkTSpace, which run along
//! +u, with b against +v (v points down in an image). Ours come from the triangle itself instead of a mean over the
//! triangles around a vertex: nothing is stored, and flat and evenly mapped surfaces get the same.

use glam::{Vec2, Vec3};

use crate::id::TriangleId;
use crate::scene::{Barycentric, Scene};
use crate::texture::{Coding, TextureRef};

impl Scene {
    /// The shading normal, bent by a normal map and its scale. On the front side.
    pub fn bent_normal(&self, triangle: TriangleId, at: Barycentric, map: Option<(TextureRef, f32)>) -> Vec3 {
        let normal = self.shading_normal(triangle, at);
        let Some((texture, scale)) = map else { return normal };
        let Some((tangent, bitangent)) = self.tangents(triangle, at, normal, &texture) else { return normal };
        let coded = self.lookup(&texture, triangle, at, Coding::Linear).truncate() * 2.0 - 1.0;
        let bent = tangent * (coded.x * scale) + bitangent * (coded.y * scale) + normal * coded.z;
        bent.try_normalize().unwrap_or(normal)
    }

    /// Unit tangent and bitangent at a point; None where the coordinates have no direction.
    fn tangents(
        &self,
        triangle: TriangleId,
        at: Barycentric,
        normal: Vec3,
        texture: &TextureRef,
    ) -> Option<(Vec3, Vec3)> {
        let corners = self.triangles()[triangle.index()].vertices.map(|v| &self.vertices()[v as usize]);
        let [a, b, c] = corners.map(|corner| corner.tangent);
        let (along, side) = if [a, b, c].iter().all(|tangent| tangent.w != 0.0) {
            let tangent = a * (1.0 - at.u - at.v) + b * at.u + c * at.v;
            (tangent.truncate(), tangent.w)
        } else {
            let uv = |u, v| texture.transform.apply(self.uv(triangle, Barycentric { u, v }, texture.uv_set));
            let origin = uv(0.0, 0.0);
            let [to_b, to_c]: [Vec2; 2] = [uv(1.0, 0.0) - origin, uv(0.0, 1.0) - origin];
            let [p, q, r] = corners.map(|corner| corner.position);
            // ∂position/∂u times the determinant, whose sign says whether the image is mirrored: it is not where v points
            // down and corners run counter-clockwise.
            let determinant = to_b.perp_dot(to_c);
            (((q - p) * to_c.y - (r - p) * to_b.y) * determinant, -determinant)
        };
        let tangent = (along - normal * normal.dot(along)).try_normalize()?;
        let bitangent = normal.cross(tangent) * side.signum();
        Some((tangent, bitangent))
    }
}
