//! The light layers: a partition of the beauty by the class of the light and by how it is seen.

use catoptric_scene::Rgb;

/// Class of the light.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LightLayer {
    /// Sources themselves (and the sky).
    Emission,
    /// LD: sources straight onto a diffuse surface.
    Direct,
    /// LS⁺D over planar mirrors.
    Mirrored,
    /// LS⁺D over curved or refracting surfaces.
    Caustic,
    /// Deeper.
    Indirect,
}

/// Number of light layers seen one way.
pub const CLASSES: usize = 5;

/// Names of the layers: seen directly, then through S.
pub const NAMES: [&str; 2 * CLASSES] = [
    "emission",
    "direct",
    "mirrored",
    "caustic",
    "indirect",
    "specular.emission",
    "specular.direct",
    "specular.mirrored",
    "specular.caustic",
    "specular.indirect",
];

/// Radiance of one sample or pixel, by layer.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LightLayers {
    /// In the order of [`NAMES`].
    pub values: [Rgb; 2 * CLASSES],
}

impl LightLayers {
    /// No light.
    pub const DARK: Self = Self { values: [Rgb::ZERO; 2 * CLASSES] };

    /// Adds radiance to a layer.
    #[inline]
    pub fn add(&mut self, layer: LightLayer, through_specular: bool, radiance: Rgb) {
        self.values[layer as usize + if through_specular { CLASSES } else { 0 }] += radiance;
    }

    /// The beauty: the sum of all layers, always in the same order.
    #[inline]
    pub fn beauty(&self) -> Rgb {
        self.values.iter().copied().sum()
    }

    /// Light of the sources themselves, seen either way.
    pub fn emission(&self) -> Rgb {
        let emission = LightLayer::Emission as usize;
        self.values[emission] + self.values[emission + CLASSES]
    }

    /// Adds another sample.
    #[inline]
    pub fn accumulate(&mut self, other: &Self) {
        for (sum, value) in self.values.iter_mut().zip(&other.values) {
            *sum += *value;
        }
    }

    /// Times a factor.
    #[inline]
    pub fn scale(&mut self, factor: f32) {
        for value in &mut self.values {
            *value *= factor;
        }
    }
}
