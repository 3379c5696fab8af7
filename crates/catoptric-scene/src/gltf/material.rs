//! Materials by the table of the design: what has an ideal counterpart is read as it, the rest is mapped to
//! the nearest one and said.

use crate::lobe::Lobe;
use crate::material::{AlphaMode, Material, MaterialReading, SMOOTH_ROUGHNESS, Transmission};
use crate::quantity::{Radiance, Rgb};
use crate::scene::BRIGHTEST;
use crate::texture::TextureRef;

use super::asset::Asset;
use super::document::{Entity, Table};
use super::light::EXTRAS;
use super::report::Report;
use super::spec_gloss;
use super::texture::TextureReader;

/// Largest index of refraction that is believed (germanium has 4).
const LARGEST_IOR: f32 = 100.0;

/// What is said about one material while it is read.
struct Notes<'a> {
    report: &'a Report,
    place: String,
    notes: Vec<String>,
}

impl Notes<'_> {
    /// For `info` only: nothing is lost that the author would miss.
    fn note(&mut self, text: &str) {
        self.notes.push(text.to_owned());
    }

    /// For `info` and the list of warnings: it will look different.
    fn warn(&mut self, text: &str) {
        self.report.warn(&self.place, text);
        self.note(text);
    }
}

/// The first `count` materials of a file.
pub(super) fn read_materials<'a>(
    asset: &'a Asset,
    count: usize,
    textures: &mut TextureReader<'a>,
    report: &Report,
) -> Vec<Material> {
    (0..count)
        .map(|index| match asset.root().element(Table::MATERIALS, index, report) {
            Some(entity) => read_material(&entity, textures, report),
            None => Material::lambertian(&format!("material {index}"), Rgb::ONE),
        })
        .collect()
}

/// What glTF gives a primitive without a material: all factors at their defaults.
pub(super) fn default_material() -> Material {
    let mut material = Material::lambertian("default material", Rgb::ONE);
    material.metallic = 1.0;
    material.specular = 1.0;
    material.reading = MaterialReading {
        summary: summarise(&material),
        notes: vec!["glTF's default is a rough white metal".to_owned()],
    };
    material
}

fn read_material<'a>(entity: &Entity<'a>, textures: &mut TextureReader<'a>, report: &Report) -> Material {
    let mut notes = Notes { report, place: entity.place().to_string(), notes: Vec::new() };
    let mut material = Material::lambertian(&entity.display_name(), Rgb::ONE);
    material.double_sided = entity.flag("doubleSided", report);
    material.alpha_mode = match entity.string("alphaMode", report) {
        None | Some("OPAQUE") => AlphaMode::Opaque,
        Some("MASK") => AlphaMode::Mask { cutoff: entity.number_or("alphaCutoff", 0.5, report) },
        Some("BLEND") => AlphaMode::Blend,
        Some(other) => {
            notes.warn(&format!("alphaMode {other:?} is unknown: opaque"));
            AlphaMode::Opaque
        }
    };
    material.unlit = entity.extension("KHR_materials_unlit", report).is_some();
    material.specular = 1.0;
    match entity.extension("KHR_materials_pbrSpecularGlossiness", report) {
        Some(extension) => read_specular_glossiness(&mut material, &extension, textures, &mut notes),
        None => read_metallic_roughness(&mut material, entity, textures, report),
    }
    read_interface(&mut material, entity, textures, &mut notes);
    read_transmission(&mut material, entity, textures, &mut notes);
    read_emission(&mut material, entity, textures, report);
    material.normal_texture = normal_map(entity, "normalTexture", textures, report);
    if material.normal_texture.is_some() {
        notes.note(
            "the normal map bends mirrors and the light of punctual lights, for the eye only: irradiance is stored without",
        );
    }
    note_the_rest(&material, entity, &mut notes);
    material.reading = MaterialReading { summary: summarise(&material), notes: notes.notes };
    material
}

/// A normal map with its scale.
fn normal_map<'a>(
    owner: &Entity<'a>,
    key: &str,
    textures: &mut TextureReader<'a>,
    report: &Report,
) -> Option<(TextureRef, f32)> {
    let info = owner.object(key, report)?;
    let texture = textures.reference(owner, key)?;
    Some((texture, info.number_or("scale", 1.0, report)))
}

/// A colour of shares: each in `[0, 1]`, others brought there with a warning.
fn reflectance(entity: &Entity<'_>, key: &str, default: Rgb, report: &Report) -> Rgb {
    let Some(color) = entity.numbers::<3>(key, report) else { return default };
    share(Rgb::from_array(color.map(|x| x as f32)), entity, key, report)
}

fn share(color: Rgb, entity: &Entity<'_>, key: &str, report: &Report) -> Rgb {
    let clamped = color.clamp(Rgb::ZERO, Rgb::ONE);
    if clamped != color {
        report.warn(entity.place(), format!("{key} {color} is outside of [0, 1]; {clamped} is used"));
    }
    clamped
}

/// Base colour factor with alpha, under the given key.
fn base_color(material: &mut Material, entity: &Entity<'_>, key: &str, report: &Report) {
    if let Some([r, g, b, a]) = entity.numbers::<4>(key, report) {
        material.base_color = share(Rgb::new(r as f32, g as f32, b as f32), entity, key, report);
        material.base_alpha = (a as f32).clamp(0.0, 1.0);
    }
}

fn read_metallic_roughness<'a>(
    material: &mut Material,
    entity: &Entity<'a>,
    textures: &mut TextureReader<'a>,
    report: &Report,
) {
    (material.metallic, material.roughness) = (1.0, 1.0);
    let Some(pbr) = entity.object("pbrMetallicRoughness", report) else { return };
    base_color(material, &pbr, "baseColorFactor", report);
    material.base_texture = textures.reference(&pbr, "baseColorTexture");
    material.metallic = pbr.number_within("metallicFactor", 1.0, 0.0, 1.0, report);
    material.roughness = pbr.number_within("roughnessFactor", 1.0, 0.0, 1.0, report);
    material.metallic_roughness_texture = textures.reference(&pbr, "metallicRoughnessTexture");
}

fn read_specular_glossiness<'a>(
    material: &mut Material,
    extension: &Entity<'a>,
    textures: &mut TextureReader<'a>,
    notes: &mut Notes<'_>,
) {
    let report = notes.report;
    base_color(material, extension, "diffuseFactor", report);
    material.base_texture = textures.reference(extension, "diffuseTexture");
    let specular = reflectance(extension, "specularFactor", Rgb::ONE, report);
    let glossiness = extension.number_within("glossinessFactor", 1.0, 0.0, 1.0, report);
    notes.note("specular-glossiness was converted to metallic-roughness");
    if extension.raw("specularGlossinessTexture").is_some() {
        // Without the texture its factors say nothing: read the body as a rough dielectric.
        notes.warn("its specularGlossinessTexture is ignored: read as a rough dielectric");
        (material.metallic, material.roughness) = (0.0, 1.0);
        return;
    }
    let converted = spec_gloss::convert(material.base_color, specular);
    material.base_color = converted.base_color;
    material.metallic = converted.metallic;
    material.specular = converted.specular;
    material.roughness = 1.0 - glossiness;
}

/// The dielectric's own interface and the clearcoat.
fn read_interface<'a>(
    material: &mut Material,
    entity: &Entity<'a>,
    textures: &mut TextureReader<'a>,
    notes: &mut Notes<'_>,
) {
    let report = notes.report;
    if let Some(extension) = entity.extension("KHR_materials_specular", report) {
        material.specular *= extension.number_within("specularFactor", 1.0, 0.0, 1.0, report);
        material.specular_texture = textures.reference(&extension, "specularTexture");
        let color = extension.numbers::<3>("specularColorFactor", report);
        if color.is_some_and(|color| color != [1.0; 3]) || extension.raw("specularColorTexture").is_some() {
            notes.warn("its specular colour is ignored: coats reflect without a tint");
        }
    }
    if let Some(extension) = entity.extension("KHR_materials_ior", report) {
        let ior = extension.number_or("ior", 1.5, report);
        material.ior = if ior == 0.0 {
            notes.warn("ior 0 (total reflection) has no ideal counterpart: 1.5 is used");
            1.5
        } else {
            extension.number_within("ior", 1.5, 1.0, LARGEST_IOR, report)
        };
    }
    if let Some(extension) = entity.extension("KHR_materials_clearcoat", report) {
        material.clearcoat = extension.number_within("clearcoatFactor", 0.0, 0.0, 1.0, report);
        let roughness = extension.number_or("clearcoatRoughnessFactor", 0.0, report);
        if material.clearcoat > 0.0 {
            material.clearcoat_texture = textures.reference(&extension, "clearcoatTexture");
            if roughness > SMOOTH_ROUGHNESS && extension.raw("clearcoatRoughnessTexture").is_none() {
                notes.warn("its rough clearcoat has no ideal counterpart and is ignored");
                material.clearcoat = 0.0;
                material.clearcoat_texture = None;
            } else if extension.raw("clearcoatRoughnessTexture").is_some() {
                notes.warn("its clearcoatRoughnessTexture is ignored: the coat is smooth");
            }
            material.clearcoat_normal_texture =
                normal_map(&extension, "clearcoatNormalTexture", textures, report);
            if material.clearcoat > 0.0 && material.clearcoat_normal_texture.is_some() {
                notes.note("the clearcoat's normal map bends what it mirrors, for the eye only");
            }
        }
    }
}

fn read_transmission<'a>(
    material: &mut Material,
    entity: &Entity<'a>,
    textures: &mut TextureReader<'a>,
    notes: &mut Notes<'_>,
) {
    let report = notes.report;
    if let Some(extension) = entity.extension("KHR_materials_transmission", report) {
        material.transmission = extension.number_within("transmissionFactor", 0.0, 0.0, 1.0, report);
        if material.transmission > 0.0 {
            material.transmission_texture = textures.reference(&extension, "transmissionTexture");
        }
    }
    if let Some(extension) = entity.extension("KHR_materials_volume", report) {
        if extension.number_or("thicknessFactor", 0.0, report) > 0.0 {
            material.transmission_kind = Transmission::Solid;
        }
        if extension.raw("thicknessTexture").is_some() {
            notes.note("the thickness texture is ignored: the mesh is the solid");
        }
        let color = reflectance(&extension, "attenuationColor", Rgb::ONE, report);
        material.absorption = match extension.number("attenuationDistance", report) {
            Some(distance) if distance > 0.0 => absorption(color, distance),
            Some(distance) => {
                notes.warn(&format!("attenuationDistance {distance} is not above 0 and is ignored"));
                Rgb::ZERO
            }
            None => Rgb::ZERO,
        };
    }
    if let Some(extension) = entity.extension("KHR_materials_diffuse_transmission", report) {
        let factor = extension.number_within("diffuseTransmissionFactor", 0.0, 0.0, 1.0, report);
        let color = reflectance(&extension, "diffuseTransmissionColorFactor", Rgb::ONE, report);
        material.diffuse_transmission_factor = factor;
        material.diffuse_transmission = color * factor;
        let textured = ["diffuseTransmissionTexture", "diffuseTransmissionColorTexture"];
        if textured.iter().any(|key| extension.raw(key).is_some()) {
            notes.warn("its diffuse transmission textures are ignored");
        }
    }
}

/// KHR_materials_volume: σ = −ln(attenuationColor)/attenuationDistance; black absorbs as the smallest colour does.
fn absorption(color: Rgb, distance: f32) -> Rgb {
    let sigma = Rgb::from_array(color.to_array().map(|c| -libm::logf(c.max(f32::MIN_POSITIVE)) / distance));
    // −ln 1 = −0; and a distance near zero must not become infinite.
    sigma.clamp(Rgb::ZERO, Rgb::splat(1e30)) + Rgb::ZERO
}

fn read_emission<'a>(
    material: &mut Material,
    entity: &Entity<'a>,
    textures: &mut TextureReader<'a>,
    report: &Report,
) {
    let factor = entity.numbers::<3>("emissiveFactor", report).unwrap_or([0.0; 3]);
    let mut factor = Rgb::from_array(factor.map(|x| x as f32));
    if factor.min_element() < 0.0 {
        report.warn(entity.place(), "its emissiveFactor is negative; 0 is used");
        factor = factor.max(Rgb::ZERO);
    }
    let strength = entity
        .extension("KHR_materials_emissive_strength", report)
        .map_or(1.0, |extension| extension.number_within("emissiveStrength", 1.0, 0.0, f32::MAX, report));
    let emission = factor * strength;
    if emission.max_element() > BRIGHTEST {
        let expected = format_args!("an emission of at most {BRIGHTEST:e} W/(m² sr)");
        report.problem(entity.place(), expected, emission, "lower emissiveStrength");
        return;
    }
    material.emission = Radiance(emission);
    read_lobe(material, entity, report);
    if emission.max_element() > 0.0 {
        material.emission_texture = textures.reference(entity, "emissiveTexture");
    }
}

/// The distribution that extras give an area light: the exponent `lobe` that punctual lights have, too.
fn read_lobe(material: &mut Material, entity: &Entity<'_>, report: &Report) {
    let Some(own) = entity.object("extras", report).and_then(|extras| extras.object(EXTRAS, report)) else {
        return;
    };
    if own.raw("lobe").is_none() {
        return;
    }
    let Some(exponent) = own.number("lobe", report) else { return };
    match Lobe::new(exponent) {
        Some(lobe) => material.lobe = lobe,
        None => {
            let hint = "1 is diffuse, greater is narrower";
            report.problem(entity.place(), "an emitter's lobe in (0, 1000]", exponent, hint);
        }
    }
    if !material.emits() {
        report.warn(entity.place(), "it has a lobe but does not emit");
    }
}

/// What is read as something else, or not at all.
fn note_the_rest(material: &Material, entity: &Entity<'_>, notes: &mut Notes<'_>) {
    let report = notes.report;
    let rough = material.roughness > SMOOTH_ROUGHNESS;
    if material.unlit {
        notes.note("unlit: seen by the eye only, neither lit nor lighting");
        return;
    }
    if material.metallic > 0.0 && rough {
        let text = match material.metallic_roughness_texture {
            None => "a rough metal has no ideal counterpart: diffuse with its base colour",
            Some(_) => "where its texture says rough metal it is diffuse with its base colour",
        };
        notes.warn(text);
    }
    if material.transmission > 0.0 && rough {
        notes.warn("its rough transmission is read as ideal");
    }
    if material.metallic < 1.0 && rough && material.specular > 0.0 && material.transmission < 1.0 {
        notes.note("its rough highlight is not shown");
    }
    if entity.raw("occlusionTexture").is_some() {
        notes.note("the occlusion map is ignored: light is computed");
    }
    for (extension, name) in [
        ("KHR_materials_sheen", "sheen"),
        ("KHR_materials_iridescence", "iridescence"),
        ("KHR_materials_anisotropy", "anisotropy"),
        ("KHR_materials_dispersion", "dispersion"),
    ] {
        if entity.extension(extension, report).is_some() {
            notes.warn(&format!("its {name} is ignored"));
        }
    }
}

/// One phrase that says which ideal components a material has.
fn summarise(material: &Material) -> String {
    if material.unlit {
        return "unlit".to_owned();
    }
    let smooth = material.roughness <= SMOOTH_ROUGHNESS;
    let percent = |share: f32| if share >= 1.0 { String::new() } else { format!("{:.0} % ", share * 100.0) };
    let mut components = Vec::new();
    if material.metallic > 0.0 {
        let kind = match (material.metallic_roughness_texture.is_some(), smooth) {
            (true, _) => "textured metal",
            (false, true) => "ideal mirror",
            (false, false) => "diffuse metal",
        };
        components.push(percent(material.metallic) + kind);
    }
    let dielectric = 1.0 - material.metallic;
    let (passing, body) = (dielectric * material.transmission, dielectric * (1.0 - material.transmission));
    if passing > 0.0 {
        let kind = match material.transmission_kind {
            Transmission::Pane => "thin pane",
            Transmission::Solid => "solid glass",
        };
        components.push(format!("{}{kind}, ior {}", percent(passing), material.ior));
    }
    if body > 0.0 {
        let coated = material.specular > 0.0 && (smooth || material.metallic_roughness_texture.is_some());
        let black = material.base_color == Rgb::ZERO && material.emits() && !coated;
        let kind = if coated { "coated Lambertian" } else { "Lambertian" };
        if !black {
            components.push(percent(body) + kind);
        }
    }
    if material.diffuse_transmission_factor > 0.0 {
        components.push("diffuse transmission".to_owned());
    }
    if material.clearcoat > 0.0 {
        components.push("clearcoat".to_owned());
    }
    if material.emits() {
        components.push(match material.lobe.is_diffuse() {
            true => "emitter".to_owned(),
            false => format!("emitter, cosine lobe n = {}", material.lobe.exponent()),
        });
    }
    match material.alpha_mode {
        AlphaMode::Opaque => {}
        AlphaMode::Mask { cutoff } => components.push(format!("cut out below alpha {cutoff}")),
        AlphaMode::Blend => components.push("blended by alpha".to_owned()),
    }
    components.join(" + ")
}
