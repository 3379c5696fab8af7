//! Scenes made by code: what tests and generators need to add geometry to [`SceneParts`].

use glam::{Vec2, Vec3, Vec4};

use crate::id::{MaterialId, SurfaceId};
use crate::material::Material;
use crate::scene::{SceneParts, Surface, Triangle, Vertex};

impl SceneParts {
    /// Adds a material.
    pub fn add_material(&mut self, material: Material) -> MaterialId {
        self.materials.push(material);
        MaterialId(self.materials.len() as u32 - 1)
    }

    /// Adds a surface of flat triangles.
    pub fn add_triangles(
        &mut self,
        name: &str,
        material: MaterialId,
        positions: &[Vec3],
        indices: &[[u32; 3]],
    ) {
        let normals = vec![Vec3::ZERO; positions.len()];
        self.add_mesh(name, material, positions, &normals, indices, false);
    }

    /// Adds a surface with a normal per corner.
    pub fn add_mesh(
        &mut self,
        name: &str,
        material: MaterialId,
        positions: &[Vec3],
        normals: &[Vec3],
        indices: &[[u32; 3]],
        smooth: bool,
    ) {
        let base = self.vertices.len() as u32;
        self.vertices.extend(positions.iter().zip(normals).map(|(&position, &normal)| Vertex {
            position,
            normal,
            tangent: Vec4::ZERO,
            uv: [Vec2::ZERO; 2],
            color: Vec4::ONE,
        }));
        let surface = SurfaceId(self.surfaces.len() as u32);
        let start = self.triangles.len() as u32;
        let triangle = |t: &[u32; 3]| Triangle { vertices: t.map(|i| i + base), surface, smooth };
        self.triangles.extend(indices.iter().map(triangle));
        self.surfaces.push(Surface {
            name: name.to_owned(),
            material,
            triangles: start..self.triangles.len() as u32,
        });
    }

    /// Makes all surfaces one, of the first one's name and material, as exporters do with whole buildings.
    pub fn join_surfaces(&mut self) {
        self.surfaces.truncate(1);
        let count = self.triangles.len() as u32;
        self.surfaces.iter_mut().for_each(|surface| surface.triangles = 0..count);
        self.triangles.iter_mut().for_each(|triangle| triangle.surface = SurfaceId(0));
    }

    /// Adds the parallelogram corner, corner + a, corner + a + b, corner + b; its front looks along a × b.
    pub fn add_quad(&mut self, name: &str, material: MaterialId, corner: Vec3, a: Vec3, b: Vec3) {
        let positions = [corner, corner + a, corner + a + b, corner + b];
        self.add_triangles(name, material, &positions, &[[0, 1, 2], [0, 2, 3]]);
    }

    /// Adds a box as one surface; `inward`: its fronts look inside.
    pub fn add_box(&mut self, name: &str, material: MaterialId, min: Vec3, max: Vec3, inward: bool) {
        let corner = |i: usize| {
            Vec3::new(
                if i & 1 == 0 { min.x } else { max.x },
                if i & 2 == 0 { min.y } else { max.y },
                if i & 4 == 0 { min.z } else { max.z },
            )
        };
        let positions: Vec<Vec3> = (0..8).map(corner).collect();
        let faces = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
        let mut indices = Vec::new();
        for [a, b, c, d] in faces {
            if inward {
                indices.extend([[a, c, b], [a, d, c]]);
            } else {
                indices.extend([[a, b, c], [a, c, d]]);
            }
        }
        self.add_triangles(name, material, &positions, &indices);
    }

    /// Adds a sphere of `rings` × 2·`rings` quads with smooth normals, front outside.
    pub fn add_sphere(&mut self, name: &str, material: MaterialId, center: Vec3, radius: f32, rings: u32) {
        let columns = 2 * rings;
        let mut normals = Vec::new();
        for ring in 0..=rings {
            let theta = std::f32::consts::PI * ring as f32 / rings as f32;
            let (sin_theta, cos_theta) = libm::sincosf(theta);
            for column in 0..columns {
                let phi = 2.0 * std::f32::consts::PI * column as f32 / columns as f32;
                let (sin_phi, cos_phi) = libm::sincosf(phi);
                let pole = ring == 0 || ring == rings;
                let sin_theta = if pole { 0.0 } else { sin_theta };
                let normal = Vec3::new(sin_theta * cos_phi, cos_theta, -sin_theta * sin_phi);
                normals.push(normal.normalize_or_zero());
            }
        }
        let positions: Vec<Vec3> = normals.iter().map(|&n| center + n * radius).collect();
        let mut indices = Vec::new();
        for ring in 0..rings {
            for column in 0..columns {
                let next = (column + 1) % columns;
                let [a, b] = [ring * columns + column, ring * columns + next];
                let [c, d] = [(ring + 1) * columns + column, (ring + 1) * columns + next];
                if ring > 0 {
                    indices.push([a, c, b]);
                }
                if ring + 1 < rings {
                    indices.push([b, c, d]);
                }
            }
        }
        self.add_mesh(name, material, &positions, &normals, &indices, true);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::id::TriangleId;
    use crate::quantity::Rgb;
    use crate::scene::Scene;

    #[test]
    fn fronts_of_boxes_and_spheres_look_where_they_should() {
        let mut parts = SceneParts::default();
        let white = parts.add_material(Material::lambertian("white", Rgb::ONE));
        parts.add_box("in", white, Vec3::splat(-1.0), Vec3::ONE, true);
        parts.add_box("out", white, Vec3::splat(-1.0), Vec3::ONE, false);
        parts.add_sphere("ball", white, Vec3::ZERO, 0.5, 8);
        let scene = Scene::new(parts).unwrap();
        for surface in scene.surfaces() {
            for t in surface.triangles.clone() {
                let id = TriangleId(t);
                let [a, b, c] = scene.corners(id);
                let outward = scene.geometric_normal(id).dot(a + b + c) > 0.0;
                assert_eq!(outward, surface.name != "in", "{} {t}", surface.name);
            }
        }
        // 6 faces of side 2, twice.
        let area: f32 = (0..24).map(|t| scene.area(TriangleId(t))).sum();
        assert!((area - 48.0).abs() < 1e-4);
    }
}
