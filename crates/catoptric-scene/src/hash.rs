//! A scene's fingerprint: equal scenes have equal hashes, on every machine.

use std::fmt;
use std::str::FromStr;

use glam::{Affine3A, Vec2, Vec3, Vec4};
use xxhash_rust::xxh3::Xxh3;

use crate::camera::{Camera, Projection};
use crate::light::{PunctualKind, PunctualLight, Sky};
use crate::material::{AlphaMode, Material, Transmission};
use crate::scene::Scene;
use crate::texture::{Texture, TextureRef, Wrap};

/// XXH3-128 of all data of a scene that light transport reads: geometry, materials, textures, lights, sky.
/// Cameras and names do not matter: one solution serves all views.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SceneHash(pub u128);

impl fmt::Display for SceneHash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:032x}", self.0)
    }
}

impl FromStr for SceneHash {
    type Err = std::num::ParseIntError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        u128::from_str_radix(text, 16).map(Self)
    }
}

/// Feeds numbers by their bits, little-endian, and lengths before lists.
struct Feed(Xxh3);

/// Bump when what is fed changes, so that old solutions are not taken for new ones.
const VERSION: u32 = 1;

impl Scene {
    /// The fingerprint of everything that pass one depends on.
    pub fn hash(&self) -> SceneHash {
        let mut feed = Feed(Xxh3::new());
        feed.word(VERSION);
        feed.length(self.vertices().len());
        for vertex in self.vertices() {
            feed.vec3(vertex.position);
            feed.vec3(vertex.normal);
            feed.vec4(vertex.tangent);
            vertex.uv.iter().for_each(|&uv| feed.vec2(uv));
            feed.vec4(vertex.color);
        }
        feed.length(self.triangles().len());
        for triangle in self.triangles() {
            triangle.vertices.iter().for_each(|&vertex| feed.word(vertex));
            feed.word(triangle.surface.0);
            feed.flag(triangle.smooth);
        }
        feed.length(self.surfaces().len());
        for surface in self.surfaces() {
            feed.word(surface.material.0);
        }
        feed.length(self.materials().len());
        self.materials().iter().for_each(|material| feed.material(material));
        feed.length(self.textures().len());
        self.textures().iter().for_each(|texture| feed.texture(texture));
        feed.length(self.lights().len());
        self.lights().iter().for_each(|light| feed.light(light));
        feed.sky(self.sky());
        SceneHash(feed.0.digest128())
    }
}

/// The fingerprint of a camera: what a picture depends on beside the scene.
pub fn camera_hash(camera: &Camera) -> u128 {
    let mut feed = Feed(Xxh3::new());
    feed.word(VERSION);
    let Affine3A { matrix3, translation } = camera.world_from_camera;
    [matrix3.x_axis, matrix3.y_axis, matrix3.z_axis, translation].iter().for_each(|&v| feed.vec3(v.into()));
    match camera.projection {
        Projection::Perspective { yfov } => feed.floats(&[0.0, yfov]),
        Projection::Orthographic { xmag, ymag } => feed.floats(&[1.0, xmag, ymag]),
    }
    feed.floats(&[camera.aspect.unwrap_or(0.0), camera.near]);
    feed.0.digest128()
}

impl Feed {
    fn word(&mut self, word: u32) {
        self.0.update(&word.to_le_bytes());
    }

    fn length(&mut self, length: usize) {
        self.0.update(&(length as u64).to_le_bytes());
    }

    fn flag(&mut self, flag: bool) {
        self.word(u32::from(flag));
    }

    fn floats(&mut self, values: &[f32]) {
        values.iter().for_each(|value| self.word(value.to_bits()));
    }

    fn vec2(&mut self, v: Vec2) {
        self.floats(&v.to_array());
    }

    fn vec3(&mut self, v: Vec3) {
        self.floats(&v.to_array());
    }

    fn vec4(&mut self, v: Vec4) {
        self.floats(&v.to_array());
    }

    fn texture_ref(&mut self, texture: Option<TextureRef>) {
        self.flag(texture.is_some());
        if let Some(texture) = texture {
            self.word(texture.texture.0);
            self.word(u32::from(texture.uv_set));
            [texture.transform.x, texture.transform.y, texture.transform.offset]
                .into_iter()
                .for_each(|v| self.vec2(v));
        }
    }

    /// Every field by name: a new one does not compile until it is fed or left out on purpose.
    fn material(&mut self, material: &Material) {
        let Material {
            name: _,
            double_sided,
            alpha_mode,
            base_color,
            base_alpha,
            base_texture,
            metallic,
            roughness,
            metallic_roughness_texture,
            specular,
            specular_texture,
            ior,
            clearcoat,
            clearcoat_texture,
            transmission,
            transmission_texture,
            transmission_kind,
            absorption,
            diffuse_transmission,
            diffuse_transmission_factor,
            emission,
            lobe,
            emission_texture,
            normal_texture,
            clearcoat_normal_texture,
            unlit,
            reading: _,
        } = material;
        self.flag(*double_sided);
        match alpha_mode {
            AlphaMode::Opaque => self.word(0),
            AlphaMode::Mask { cutoff } => self.floats(&[1.0, *cutoff]),
            AlphaMode::Blend => self.word(2),
        }
        self.flag(*transmission_kind == Transmission::Solid);
        self.flag(*unlit);
        [*base_color, *absorption, *diffuse_transmission, emission.0].into_iter().for_each(|v| self.vec3(v));
        if !lobe.is_diffuse() {
            self.floats(&[lobe.exponent()]);
        }
        self.floats(&[*base_alpha, *metallic, *roughness, *specular, *ior, *clearcoat, *transmission]);
        let bends = [normal_texture, clearcoat_normal_texture].map(|map| map.map_or(0.0, |(_, scale)| scale));
        self.floats(&[*diffuse_transmission_factor, bends[0], bends[1]]);
        [
            *base_texture,
            *metallic_roughness_texture,
            *specular_texture,
            *clearcoat_texture,
            *transmission_texture,
            *emission_texture,
            normal_texture.map(|(texture, _)| texture),
            clearcoat_normal_texture.map(|(texture, _)| texture),
        ]
        .into_iter()
        .for_each(|texture| self.texture_ref(texture));
    }

    fn texture(&mut self, texture: &Texture) {
        self.word(texture.width);
        self.word(texture.height);
        for wrap in [texture.wrap_u, texture.wrap_v] {
            self.word(match wrap {
                Wrap::ClampToEdge => 0,
                Wrap::MirroredRepeat => 1,
                Wrap::Repeat => 2,
            });
        }
        self.flag(texture.linear_filter);
        self.0.update(texture.texels.as_flattened());
    }

    fn light(&mut self, light: &PunctualLight) {
        [light.position, light.direction, light.intensity].into_iter().for_each(|v| self.vec3(v));
        match &light.kind {
            PunctualKind::Point => self.word(0),
            PunctualKind::Lobe { exponent } => self.floats(&[3.0, *exponent]),
            PunctualKind::Photometric { table, across } => {
                self.word(4);
                self.vec3(*across);
                table.numbers().for_each(|n| self.floats(&[n]));
            }
            &PunctualKind::Spot { cos_inner, cos_outer } => self.floats(&[1.0, cos_inner, cos_outer]),
            PunctualKind::Directional => self.word(2),
        }
    }

    fn sky(&mut self, sky: Option<&Sky>) {
        match sky {
            None => self.word(0),
            Some(Sky::Uniform(radiance)) => {
                self.word(1);
                self.vec3(radiance.0);
            }
            Some(Sky::Image(image)) => {
                self.word(2);
                self.length(image.width);
                self.length(image.height);
                image.texels.iter().for_each(|texel| self.floats(texel));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::material::Material;
    use crate::quantity::{Radiance, Rgb};
    use crate::scene::{SceneParts, Surface, Triangle, Vertex};
    use crate::{MaterialId, SurfaceId};

    fn parts() -> SceneParts {
        let vertex = |position: Vec3| Vertex {
            position,
            normal: Vec3::ZERO,
            tangent: Vec4::ZERO,
            uv: [Vec2::ZERO; 2],
            color: Vec4::ONE,
        };
        SceneParts {
            name: "scene".to_owned(),
            vertices: [Vec3::ZERO, Vec3::X, Vec3::Y].map(vertex).to_vec(),
            triangles: vec![Triangle { vertices: [0, 1, 2], surface: SurfaceId(0), smooth: false }],
            surfaces: vec![Surface { name: "surface".to_owned(), material: MaterialId(0), triangles: 0..1 }],
            materials: vec![Material::lambertian("grey", Rgb::splat(0.5))],
            ..SceneParts::default()
        }
    }

    fn hash(change: impl FnOnce(&mut SceneParts)) -> SceneHash {
        let mut parts = parts();
        change(&mut parts);
        Scene::new(parts).map(|scene| scene.hash()).unwrap_or(SceneHash(0))
    }

    #[test]
    fn the_hash_follows_what_light_follows_and_nothing_else() {
        let original = hash(|_| {});
        assert_eq!(original.to_string().parse(), Ok(original));
        assert_eq!(hash(|parts| parts.name = "other".to_owned()), original);
        assert_eq!(hash(|parts| parts.materials[0].name = "gray".to_owned()), original);
        let changes: [fn(&mut SceneParts); 9] = [
            |parts| parts.vertices[0].position.z = 1e-30,
            |parts| parts.vertices[0].uv[1].x = 1.0,
            |parts| parts.triangles[0].vertices = [1, 2, 0],
            |parts| parts.triangles[0].smooth = true,
            |parts| parts.materials[0].double_sided = true,
            |parts| parts.materials[0].emission = Radiance(Rgb::X),
            |parts| parts.materials[0].lobe = crate::Lobe::new(2.0).unwrap_or(crate::Lobe::DIFFUSE),
            |parts| parts.materials[0].absorption = Rgb::Z,
            |parts| parts.sky = Some(Sky::Uniform(Radiance(Rgb::ONE))),
        ];
        let mut hashes: Vec<SceneHash> = changes.into_iter().map(hash).collect();
        hashes.push(original);
        hashes.sort();
        hashes.dedup();
        assert_eq!(hashes.len(), 10, "every change has its own hash");
    }
}
