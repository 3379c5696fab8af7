//! KHR_materials_pbrSpecularGlossiness read as metallic-roughness.
//!
//! The formula is that of the extension's own repository (glTF, archived extensions,
//! `convert-between-workflows/js/three.pbrUtilities.js`, function `convertToMetallicRoughness`):
//! the metallic factor m is the root of a quadratic in the perceived brightness of diffuse and specular.

use crate::quantity::Rgb;

/// Reflectance of a dielectric of index 1.5 at normal incidence.
const DIELECTRIC: f32 = 0.04;

/// Factors of the other workflow.
pub(super) struct Converted {
    pub(super) base_color: Rgb,
    pub(super) metallic: f32,
    /// Of KHR_materials_specular: what is left of the dielectric reflection.
    pub(super) specular: f32,
}

/// Base colour, metallic and specular of a diffuse and a specular colour.
pub(super) fn convert(diffuse: Rgb, specular: Rgb) -> Converted {
    const TINY: f32 = 1e-6;
    let one_minus_specular = 1.0 - specular.max_element();
    let metallic = solve_metallic(brightness(diffuse), brightness(specular), one_minus_specular);
    // A coat that reflects less takes less of what is below.
    let share = (specular.max_element() / DIELECTRIC).min(1.0);
    let from_diffuse =
        diffuse * (one_minus_specular / (1.0 - DIELECTRIC * share) / (1.0 - metallic).max(TINY));
    let from_specular = (specular - Rgb::splat(DIELECTRIC * (1.0 - metallic))) / metallic.max(TINY);
    let base_color = from_diffuse.lerp(from_specular, metallic * metallic).clamp(Rgb::ZERO, Rgb::ONE);
    Converted { base_color, metallic, specular: share }
}

fn brightness(color: Rgb) -> f32 {
    (color * color).dot(Rgb::new(0.299, 0.587, 0.114)).sqrt()
}

fn solve_metallic(diffuse: f32, specular: f32, one_minus_specular: f32) -> f32 {
    if specular < DIELECTRIC {
        return 0.0;
    }
    let a = DIELECTRIC;
    let b = diffuse * one_minus_specular / (1.0 - DIELECTRIC) + specular - 2.0 * DIELECTRIC;
    let c = DIELECTRIC - specular;
    let discriminant = (b * b - 4.0 * a * c).max(0.0);
    let root = ((-b + discriminant.sqrt()) / (2.0 * a)).clamp(0.0, 1.0);
    // The root is known to some roundings over 2a = 0.08: what may be pure is pure.
    const ROUNDING: f32 = 16.0 * f32::EPSILON / (2.0 * DIELECTRIC);
    match root {
        _ if root < ROUNDING => 0.0,
        _ if root > 1.0 - ROUNDING => 1.0,
        _ => root,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dielectric_keeps_its_diffuse_colour_and_a_metal_takes_its_specular_colour() {
        let dielectric = convert(Rgb::new(0.5, 0.2, 0.1), Rgb::splat(0.04));
        assert_eq!(dielectric.metallic, 0.0);
        assert!((dielectric.base_color - Rgb::new(0.5, 0.2, 0.1)).abs().max_element() < 1e-5);
        let metal = convert(Rgb::ZERO, Rgb::new(1.0, 0.8, 0.3));
        assert_eq!(metal.metallic, 1.0);
        assert!((metal.base_color - Rgb::new(1.0, 0.8, 0.3)).abs().max_element() < 1e-6);
    }

    #[test]
    fn a_coat_is_as_weak_as_the_specular_colour_and_takes_as_little() {
        for level in [0.0, 0.02] {
            let converted = convert(Rgb::splat(0.5), Rgb::splat(level));
            assert_eq!(converted.specular, level / DIELECTRIC);
            // The extension: diffuse · (1 − max specular), of which the coat takes its reflectance.
            assert!((converted.base_color.x - 0.5).abs() < 1e-6, "{level}");
        }
    }
}
