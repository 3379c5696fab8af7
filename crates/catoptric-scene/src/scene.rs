//! The scene: world-space triangles with materials, lights, cameras and a sky. Immutable once built.

use glam::{DVec3, Vec2, Vec3};

use crate::camera::Camera;
use crate::id::{MaterialId, SurfaceId, TriangleId};
use crate::light::{PunctualLight, Sky};
use crate::material::{AlphaMode, Factors, Material, SurfacePoint};
use crate::quantity::{Radiance, Rgb};
use crate::texture::{Coding, Texture, TextureRef};

/// A corner of triangles, world space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vertex {
    /// Position, metres.
    pub position: Vec3,
    /// Unit shading normal; zero where the file has none.
    pub normal: Vec3,
    /// Unit tangent and handedness, zero where the file has none.
    pub tangent: glam::Vec4,
    /// Texture coordinates, sets 0 and 1.
    pub uv: [Vec2; 2],
    /// COLOR_0 (linear RGBA), ones where the file has none.
    pub color: glam::Vec4,
}

/// A triangle: three corners, counter-clockwise seen from the front.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Triangle {
    /// Indices into [`Scene::vertices`].
    pub vertices: [u32; 3],
    /// The surface it belongs to.
    pub surface: SurfaceId,
    /// Its normal is interpolated between those of its corners; else it is the geometric one.
    pub smooth: bool,
}

/// A named surface: one primitive of one glTF node.
#[derive(Clone, Debug)]
pub struct Surface {
    /// `node` or `node/primitive`, unique in the scene.
    pub name: String,
    /// Its material.
    pub material: MaterialId,
    /// First triangle and number of triangles: a surface's triangles are consecutive.
    pub triangles: std::ops::Range<u32>,
}

/// Weights of the second and third corner; the first has 1 − u − v.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Barycentric {
    /// Weight of corner 1.
    pub u: f32,
    /// Weight of corner 2.
    pub v: f32,
}

/// The public tables from which a [`Scene`] is built; any values are legal until [`Scene::new`] has looked.
#[derive(Clone, Debug, Default)]
pub struct SceneParts {
    /// Name for messages: the file's stem.
    pub name: String,
    /// Corners.
    pub vertices: Vec<Vertex>,
    /// Triangles, grouped by surface in ascending order.
    pub triangles: Vec<Triangle>,
    /// Surfaces.
    pub surfaces: Vec<Surface>,
    /// Materials.
    pub materials: Vec<Material>,
    /// Textures.
    pub textures: Vec<Texture>,
    /// Punctual lights.
    pub lights: Vec<PunctualLight>,
    /// Cameras.
    pub cameras: Vec<Camera>,
    /// The sky.
    pub sky: Option<Sky>,
    /// Where positions are counted from, metres in the file's world: what is far from its origin has one of its own.
    pub origin: DVec3,
}

/// Something wrong in the parts of a scene.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SceneIssue {
    /// Where: surface, material, light or camera by name.
    pub place: String,
    /// What is wrong and what was expected.
    pub problem: String,
}

/// The largest coordinate, metres. Squares of lengths, and areas by which scenes are divided, stay far below what f32 holds.
pub const FARTHEST: f32 = 1e12;

/// Whether a position is finite and at most [`FARTHEST`] from each plane through the origin.
pub(crate) fn is_within_reach(position: Vec3) -> bool {
    position.abs().cmple(Vec3::splat(FARTHEST)).all()
}

/// The largest radiance (W/(m² sr)), intensity (W/sr) and irradiance (W/m²) of a light. Products of two, as variances are, stay below what f32
/// holds.
pub const BRIGHTEST: f32 = 1e15;

/// A validated scene. Vertices are finite, indices are in range, triangles have area and are grouped by surface.
#[derive(Clone, Debug)]
pub struct Scene {
    parts: SceneParts,
    /// Per material: its point where no texture and no vertex colour is needed.
    uniform: Vec<Option<SurfacePoint>>,
    geometric_normals: Vec<Vec3>,
    areas: Vec<f32>,
    /// Per triangle: some corner has a colour other than white.
    colored: Vec<bool>,
}

impl Scene {
    /// Validates `parts`: every value finite, every index in range, no triangle without area,
    /// consecutive triangles per surface. Reports all problems at once.
    pub fn new(parts: SceneParts) -> Result<Self, Vec<SceneIssue>> {
        let mut issues = Vec::new();
        let mut issue = |place: String, problem: &str| {
            if issues.len() < 100 {
                issues.push(SceneIssue { place, problem: problem.to_owned() });
            }
        };

        // Every index points into its table.
        for (index, triangle) in parts.triangles.iter().enumerate() {
            let in_range = triangle.vertices.iter().all(|&v| (v as usize) < parts.vertices.len());
            if !in_range || triangle.surface.index() >= parts.surfaces.len() {
                issue(format!("triangle {index}"), "points outside of the vertex or surface table");
            }
        }
        let mut expected_start = 0;
        for (index, surface) in parts.surfaces.iter().enumerate() {
            if surface.material.index() >= parts.materials.len() {
                issue(surface.name.clone(), "points outside of the material table");
            }
            let range = surface.triangles.clone();
            let consecutive = range.start == expected_start
                && range.end >= range.start
                && range.end as usize <= parts.triangles.len();
            if !consecutive
                || parts.triangles[range.start as usize..range.end as usize]
                    .iter()
                    .any(|t| t.surface.index() != index)
            {
                issue(surface.name.clone(), "its triangles are not consecutive");
            }
            expected_start = range.end;
        }
        if expected_start as usize != parts.triangles.len() {
            issue("scene".to_owned(), "has triangles that belong to no surface");
        }
        for vertex in &parts.vertices {
            if !(is_within_reach(vertex.position) && vertex.normal.is_finite()) {
                issue(
                    "vertex".to_owned(),
                    "has a position or normal that is not finite, or lies too far off",
                );
            }
        }
        for material in &parts.materials {
            let emission = material.emission.0;
            let base = material.base_color;
            if !(emission.is_finite() && emission.min_element() >= 0.0 && emission.max_element() <= BRIGHTEST)
            {
                issue(material.name.clone(), "has an emission that is negative, not finite or too large");
            }
            if !(base.is_finite() && base.min_element() >= 0.0 && base.max_element() <= 1.0) {
                issue(material.name.clone(), "has a base colour outside of [0, 1]");
            }
            if !(material.ior.is_finite() && material.ior >= 1.0) {
                issue(material.name.clone(), "has an index of refraction below 1");
            }
        }
        if !issues.is_empty() {
            return Err(issues);
        }

        // Geometry of each triangle in f64, rounded once.
        let mut geometric_normals = Vec::with_capacity(parts.triangles.len());
        let mut areas = Vec::with_capacity(parts.triangles.len());
        for (index, triangle) in parts.triangles.iter().enumerate() {
            let [a, b, c] = triangle.vertices.map(|v| parts.vertices[v as usize].position.as_dvec3());
            let cross = (b - a).cross(c - a);
            let twice_area = cross.length();
            if twice_area.is_nan() || twice_area <= 0.0 || (0.5 * twice_area) as f32 <= 0.0 {
                let surface = &parts.surfaces[triangle.surface.index()].name;
                issues.push(SceneIssue {
                    place: surface.clone(),
                    problem: format!("triangle {index} has no area"),
                });
                continue;
            }
            geometric_normals.push((cross / twice_area).as_vec3());
            areas.push((0.5 * twice_area) as f32);
        }
        if !issues.is_empty() {
            issues.truncate(100);
            return Err(issues);
        }

        let uniform = parts.materials.iter().map(uniform_point).collect();
        let is_colored = |&v: &u32| parts.vertices[v as usize].color != glam::Vec4::ONE;
        let colored = parts.triangles.iter().map(|t| t.vertices.iter().any(is_colored)).collect();
        Ok(Self { parts, uniform, geometric_normals, areas, colored })
    }

    /// Name for messages.
    pub fn name(&self) -> &str {
        &self.parts.name
    }

    /// All corners.
    pub fn vertices(&self) -> &[Vertex] {
        &self.parts.vertices
    }

    /// All triangles.
    pub fn triangles(&self) -> &[Triangle] {
        &self.parts.triangles
    }

    /// All surfaces.
    pub fn surfaces(&self) -> &[Surface] {
        &self.parts.surfaces
    }

    /// All materials.
    pub fn materials(&self) -> &[Material] {
        &self.parts.materials
    }

    /// All textures.
    pub fn textures(&self) -> &[Texture] {
        &self.parts.textures
    }

    /// All punctual lights.
    pub fn lights(&self) -> &[PunctualLight] {
        &self.parts.lights
    }

    /// All cameras.
    pub fn cameras(&self) -> &[Camera] {
        &self.parts.cameras
    }

    /// The sky, if there is one.
    pub fn sky(&self) -> Option<&Sky> {
        self.parts.sky.as_ref()
    }

    /// Where positions are counted from, metres in the file's world.
    pub fn origin(&self) -> DVec3 {
        self.parts.origin
    }

    /// The parts, to change and build again.
    pub fn into_parts(self) -> SceneParts {
        self.parts
    }

    /// The three corners' positions.
    #[inline]
    pub fn corners(&self, triangle: TriangleId) -> [Vec3; 3] {
        self.parts.triangles[triangle.index()].vertices.map(|v| self.parts.vertices[v as usize].position)
    }

    /// Unit normal of the front.
    #[inline]
    pub fn geometric_normal(&self, triangle: TriangleId) -> Vec3 {
        self.geometric_normals[triangle.index()]
    }

    /// Area, m².
    #[inline]
    pub fn area(&self, triangle: TriangleId) -> f32 {
        self.areas[triangle.index()]
    }

    /// Whether a triangle's normal is interpolated.
    #[inline]
    pub fn is_smooth(&self, triangle: TriangleId) -> bool {
        self.parts.triangles[triangle.index()].smooth
    }

    /// The surface a triangle belongs to.
    #[inline]
    pub fn surface_of(&self, triangle: TriangleId) -> &Surface {
        &self.parts.surfaces[self.parts.triangles[triangle.index()].surface.index()]
    }

    /// The id of a triangle's material.
    #[inline]
    pub fn material_id_of(&self, triangle: TriangleId) -> MaterialId {
        self.surface_of(triangle).material
    }

    /// A triangle's material.
    #[inline]
    pub fn material_of(&self, triangle: TriangleId) -> &Material {
        &self.parts.materials[self.material_id_of(triangle).index()]
    }

    /// The point of barycentric coordinates `at`.
    #[inline]
    pub fn position(&self, triangle: TriangleId, at: Barycentric) -> Vec3 {
        let [a, b, c] = self.corners(triangle);
        a + (b - a) * at.u + (c - a) * at.v
    }

    /// The unit normal with which mirrors, glass and displayed irradiance work: interpolated where the
    /// mesh has smooth normals, geometric elsewhere. On the front side.
    #[inline]
    pub fn shading_normal(&self, triangle: TriangleId, at: Barycentric) -> Vec3 {
        let Triangle { vertices, smooth, .. } = self.parts.triangles[triangle.index()];
        if !smooth {
            return self.geometric_normals[triangle.index()];
        }
        let [a, b, c] = vertices.map(|v| self.parts.vertices[v as usize].normal);
        let normal = a * (1.0 - at.u - at.v) + b * at.u + c * at.v;
        normal.try_normalize().unwrap_or(self.geometric_normals[triangle.index()])
    }

    /// What the surface does to light at a point: factors, textures and vertex colours evaluated.
    #[inline]
    pub fn surface_point(&self, triangle: TriangleId, at: Barycentric) -> SurfacePoint {
        match &self.uniform[self.material_id_of(triangle).index()] {
            Some(point) if !self.colored[triangle.index()] => *point,
            _ => self.textured_point(triangle, at),
        }
    }

    /// α at a point, for cut-outs: cheaper than the whole [`Scene::surface_point`].
    pub fn alpha(&self, triangle: TriangleId, at: Barycentric) -> f32 {
        let material = self.material_of(triangle);
        let texel = material.base_texture.map_or(1.0, |t| self.lookup(&t, triangle, at, Coding::Srgb).w);
        material.base_alpha * self.vertex_color(triangle, at).w * texel
    }

    /// Whether a cut-out has a hole at this point.
    pub fn is_cut_out(&self, triangle: TriangleId, at: Barycentric) -> bool {
        match self.material_of(triangle).alpha_mode {
            AlphaMode::Mask { cutoff } => self.alpha(triangle, at) < cutoff,
            AlphaMode::Opaque | AlphaMode::Blend => false,
        }
    }

    fn vertex_color(&self, triangle: TriangleId, at: Barycentric) -> glam::Vec4 {
        let [a, b, c] =
            self.parts.triangles[triangle.index()].vertices.map(|v| self.parts.vertices[v as usize].color);
        a * (1.0 - at.u - at.v) + b * at.u + c * at.v
    }

    /// Texture coordinates of set `set`.
    pub fn uv(&self, triangle: TriangleId, at: Barycentric, set: u8) -> Vec2 {
        let set = usize::from(set.min(1));
        let [a, b, c] =
            self.parts.triangles[triangle.index()].vertices.map(|v| self.parts.vertices[v as usize].uv[set]);
        a * (1.0 - at.u - at.v) + b * at.u + c * at.v
    }

    /// A texture at a point.
    pub(crate) fn lookup(
        &self,
        texture: &TextureRef,
        triangle: TriangleId,
        at: Barycentric,
        coding: Coding,
    ) -> glam::Vec4 {
        let uv = texture.transform.apply(self.uv(triangle, at, texture.uv_set));
        self.parts.textures[texture.texture.index()].sample(uv, coding)
    }

    fn textured_point(&self, triangle: TriangleId, at: Barycentric) -> SurfacePoint {
        let material = self.material_of(triangle);
        let color = self.vertex_color(triangle, at);
        let read = |texture: &Option<TextureRef>, coding| {
            texture.as_ref().map_or(glam::Vec4::ONE, |t| self.lookup(t, triangle, at, coding))
        };
        let base = read(&material.base_texture, Coding::Srgb) * color;
        let metallic_roughness = read(&material.metallic_roughness_texture, Coding::Linear);
        material.evaluate(&Factors {
            base: (material.base_color * base.truncate()).clamp(Rgb::ZERO, Rgb::ONE),
            opacity: opacity(material, material.base_alpha * base.w),
            metallic: material.metallic * metallic_roughness.z,
            roughness: material.roughness * metallic_roughness.y,
            specular: material.specular * read(&material.specular_texture, Coding::Linear).w,
            clearcoat: material.clearcoat * read(&material.clearcoat_texture, Coding::Linear).x,
            transmission: material.transmission * read(&material.transmission_texture, Coding::Linear).x,
            emission: Radiance(
                material.emission.0 * read(&material.emission_texture, Coding::Srgb).truncate(),
            ),
        })
    }
}

/// α as a share: masked and opaque materials are whole where they are.
fn opacity(material: &Material, alpha: f32) -> f32 {
    match material.alpha_mode {
        AlphaMode::Blend => alpha.clamp(0.0, 1.0),
        AlphaMode::Opaque | AlphaMode::Mask { .. } => 1.0,
    }
}

/// The point of a material without textures.
fn uniform_point(material: &Material) -> Option<SurfacePoint> {
    let textured = material.base_texture.is_some()
        || material.metallic_roughness_texture.is_some()
        || material.specular_texture.is_some()
        || material.clearcoat_texture.is_some()
        || material.transmission_texture.is_some()
        || material.emission_texture.is_some();
    (!textured).then(|| {
        material.evaluate(&Factors {
            base: material.base_color,
            opacity: opacity(material, material.base_alpha),
            metallic: material.metallic,
            roughness: material.roughness,
            specular: material.specular,
            clearcoat: material.clearcoat,
            transmission: material.transmission,
            emission: material.emission,
        })
    })
}
