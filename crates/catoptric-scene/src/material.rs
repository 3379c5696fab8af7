//! Materials: what glTF says, read as ideal components (Lambertian, mirror, coat, pane, solid glass).
//!
//! A [`Material`] keeps factors and textures; [`Scene::surface_point`](crate::Scene::surface_point)
//! evaluates them at one point into a [`SurfacePoint`], the only thing that light transport looks at.

use crate::lobe::Lobe;
use crate::quantity::{Radiance, Rgb};
use crate::texture::TextureRef;

/// Roughness up to which a surface counts as smooth.
pub const SMOOTH_ROUGHNESS: f32 = 0.08;

/// What alpha does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AlphaMode {
    /// Alpha is ignored.
    Opaque,
    /// Below the cut-off there is no surface.
    Mask {
        /// The cut-off.
        cutoff: f32,
    },
    /// The share 1 − α passes undeviated.
    Blend,
}

/// How light passes a transmissive surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Transmission {
    /// A thin pane: undeviated, Fresnel at both faces with all internal bounces.
    Pane,
    /// The border of a solid: Snell, Fresnel, total internal reflection, Beer–Lambert inside.
    Solid,
}

/// A glTF material in factors and textures.
#[derive(Clone, Debug)]
pub struct Material {
    /// Name for messages (never empty: `material 3` where the file has none).
    pub name: String,
    /// Both sides are surfaces.
    pub double_sided: bool,
    /// Alpha.
    pub alpha_mode: AlphaMode,
    /// Base colour factor.
    pub base_color: Rgb,
    /// Alpha factor.
    pub base_alpha: f32,
    /// Base colour texture (sRGB, alpha in A).
    pub base_texture: Option<TextureRef>,
    /// Metallic factor.
    pub metallic: f32,
    /// Roughness factor.
    pub roughness: f32,
    /// Roughness in G, metallic in B.
    pub metallic_roughness_texture: Option<TextureRef>,
    /// KHR_materials_specular: scales the dielectric's own reflection. 0: plain Lambertian.
    pub specular: f32,
    /// Specular factor in A.
    pub specular_texture: Option<TextureRef>,
    /// KHR_materials_ior: index of refraction, ≥ 1.
    pub ior: f32,
    /// KHR_materials_clearcoat factor of a smooth coat over everything (0: none).
    pub clearcoat: f32,
    /// Clearcoat factor in R.
    pub clearcoat_texture: Option<TextureRef>,
    /// KHR_materials_transmission factor.
    pub transmission: f32,
    /// Transmission factor in R.
    pub transmission_texture: Option<TextureRef>,
    /// Pane or solid.
    pub transmission_kind: Transmission,
    /// Absorption coefficient σ of the inside, 1/m (KHR_materials_volume: −ln(colour)/distance).
    pub absorption: Rgb,
    /// KHR_materials_diffuse_transmission factor × colour: Lambertian τ to the other side.
    pub diffuse_transmission: Rgb,
    /// The share taken from reflection by diffuse transmission, in `[0, 1]`.
    pub diffuse_transmission_factor: f32,
    /// Emitted radiance factor (emissiveFactor × emissiveStrength).
    pub emission: Radiance,
    /// How emission is spread over angles.
    pub lobe: Lobe,
    /// Emission texture (sRGB).
    pub emission_texture: Option<TextureRef>,
    /// Normal map with its scale: for directions and punctual light at eye hits only.
    pub normal_texture: Option<(TextureRef, f32)>,
    /// The clearcoat's own normal map with its scale.
    pub clearcoat_normal_texture: Option<(TextureRef, f32)>,
    /// Seen by the eye only (KHR_materials_unlit): its base colour is its radiance.
    pub unlit: bool,
    /// How the file's material was read, for `info`.
    pub reading: MaterialReading,
}

/// How a material was read, in words.
#[derive(Clone, Debug, Default)]
pub struct MaterialReading {
    /// One phrase: "Lambertian", "ideal mirror", "solid glass, ior 1.5", …
    pub summary: String,
    /// What had to be mapped away, one sentence each.
    pub notes: Vec<String>,
}

impl Material {
    /// A Lambertian material of reflectance `reflectance`.
    pub fn lambertian(name: &str, reflectance: Rgb) -> Self {
        Self {
            name: name.to_owned(),
            double_sided: false,
            alpha_mode: AlphaMode::Opaque,
            base_color: reflectance,
            base_alpha: 1.0,
            base_texture: None,
            metallic: 0.0,
            roughness: 1.0,
            metallic_roughness_texture: None,
            specular: 0.0,
            specular_texture: None,
            ior: 1.5,
            clearcoat: 0.0,
            clearcoat_texture: None,
            transmission: 0.0,
            transmission_texture: None,
            transmission_kind: Transmission::Pane,
            absorption: Rgb::ZERO,
            diffuse_transmission: Rgb::ZERO,
            diffuse_transmission_factor: 0.0,
            emission: Radiance::ZERO,
            lobe: Lobe::DIFFUSE,
            emission_texture: None,
            normal_texture: None,
            clearcoat_normal_texture: None,
            unlit: false,
            reading: MaterialReading { summary: "Lambertian".to_owned(), notes: Vec::new() },
        }
    }

    /// An ideal mirror of reflectance `reflectance` at every angle.
    pub fn mirror(name: &str, reflectance: Rgb) -> Self {
        Self { metallic: 1.0, roughness: 0.0, ..Self::lambertian(name, reflectance) }
    }

    /// Clear solid glass.
    pub fn glass(name: &str, ior: f32) -> Self {
        Self {
            roughness: 0.0,
            specular: 1.0,
            ior,
            transmission: 1.0,
            transmission_kind: Transmission::Solid,
            ..Self::lambertian(name, Rgb::ONE)
        }
    }

    /// A diffuse emitter of constant radiance.
    pub fn emitter(name: &str, radiance: Radiance) -> Self {
        Self { emission: radiance, ..Self::lambertian(name, Rgb::ZERO) }
    }

    /// Whether any point may emit.
    pub fn emits(&self) -> bool {
        self.emission.0.max_element() > 0.0 && !self.unlit
    }

    /// Whether anything about it varies over the surface.
    pub fn has_textures(&self) -> bool {
        let textures = [
            self.base_texture,
            self.metallic_roughness_texture,
            self.specular_texture,
            self.clearcoat_texture,
            self.transmission_texture,
            self.emission_texture,
        ];
        let normals = [self.normal_texture, self.clearcoat_normal_texture];
        textures.iter().any(Option::is_some) || normals.iter().any(Option::is_some)
    }

    /// The normal map of the outermost interface, in whose direction mirrors reflect: a clearcoat has its own, or is even.
    pub fn outer_normal_texture(&self) -> Option<(TextureRef, f32)> {
        if self.clearcoat > 0.0 { self.clearcoat_normal_texture } else { self.normal_texture }
    }

    /// Whether some point may have a diffuse side (so that it needs patches and display vertices).
    pub fn may_be_diffuse(&self) -> bool {
        if self.unlit {
            return false;
        }
        let smooth = self.roughness <= SMOOTH_ROUGHNESS || self.metallic_roughness_texture.is_some();
        let full_mirror = smooth && self.metallic >= 1.0 && self.metallic_roughness_texture.is_none();
        let full_glass =
            self.transmission >= 1.0 && self.metallic <= 0.0 && self.transmission_texture.is_none();
        !(full_mirror || full_glass)
    }

    /// Whether its surfaces are the border of a body that transmits light.
    pub fn is_solid(&self) -> bool {
        self.transmission > 0.0 && self.transmission_kind == Transmission::Solid
    }

    /// Whether some point may reflect or transmit specularly, or pass light by alpha.
    pub fn may_be_specular(&self) -> bool {
        let smooth = self.roughness <= SMOOTH_ROUGHNESS || self.metallic_roughness_texture.is_some();
        self.transmission > 0.0
            || self.clearcoat > 0.0
            || (smooth && (self.metallic > 0.0 || self.specular > 0.0))
            || self.alpha_mode == AlphaMode::Blend
    }

    /// Evaluates the ideal components from looked-up factors.
    ///
    /// The shares are glTF's: metallic m is mirror (or, where rough, diffuse); of the rest, the
    /// transmission factor t passes and 1 − t is diffuse under the dielectric's own smooth interface.
    #[inline]
    pub(crate) fn evaluate(&self, f: &Factors) -> SurfacePoint {
        let smooth = f.roughness <= SMOOTH_ROUGHNESS;
        let metal = f.metallic.clamp(0.0, 1.0);
        let transmission = f.transmission.clamp(0.0, 1.0) * (1.0 - metal);
        let body = (1.0 - metal) * (1.0 - f.transmission.clamp(0.0, 1.0));
        let (mirror, rough_metal) = if smooth { (f.base * metal, 0.0) } else { (Rgb::ZERO, metal) };
        let reflected = 1.0 - self.diffuse_transmission_factor;
        let coat = if smooth { f.specular.clamp(0.0, 1.0) } else { 0.0 };
        SurfacePoint {
            diffuse: f.base * (body * reflected + rough_metal),
            diffuse_transmission: self.diffuse_transmission * body,
            mirror,
            coat: if body > 0.0 { coat } else { 0.0 },
            coat_share: body + rough_metal,
            clearcoat: f.clearcoat.clamp(0.0, 1.0),
            transmission,
            transmission_kind: self.transmission_kind,
            tint: f.base,
            ior: self.ior,
            opacity: f.opacity,
            emission: f.emission,
        }
    }
}

/// The factors of a material at a point, textures multiplied in.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Factors {
    pub(crate) base: Rgb,
    pub(crate) opacity: f32,
    pub(crate) metallic: f32,
    pub(crate) roughness: f32,
    pub(crate) specular: f32,
    pub(crate) clearcoat: f32,
    pub(crate) transmission: f32,
    pub(crate) emission: Radiance,
}

/// What one point of a surface does to light: shares of ideal components. Before opacity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// Lambertian reflectance ρ_d (share multiplied in; a coat's transmittance is not).
    pub diffuse: Rgb,
    /// Lambertian transmittance τ to the other side.
    pub diffuse_transmission: Rgb,
    /// Mirror reflectance ρ_s, the same at every angle (share multiplied in).
    pub mirror: Rgb,
    /// Strength s ∈ `[0, 1]` of the dielectric interface over the diffuse share: reflects s·F(θ), transmits 1 − s·F(θ).
    pub coat: f32,
    /// Share of the surface that is diffuse, rough metal included: it lies under `coat` and `clearcoat`.
    pub coat_share: f32,
    /// Strength of a clearcoat (ior 1.5) over everything.
    pub clearcoat: f32,
    /// Share that transmits specularly (0: none).
    pub transmission: f32,
    /// Pane or solid.
    pub transmission_kind: Transmission,
    /// Colour of each crossing.
    pub tint: Rgb,
    /// Index of refraction of the coat, pane or solid.
    pub ior: f32,
    /// α: the share 1 − α passes undeviated. 1 for opaque and masked materials.
    pub opacity: f32,
    /// Emitted power per area over π, front side (and back if doubleSided): the radiance where the material's lobe is
    /// diffuse, else to be multiplied by [`Lobe::factor`].
    pub emission: Radiance,
}
