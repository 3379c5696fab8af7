//! The light layers: a partition of the beauty by the class of the light and by how it is seen; and what a pixel keeps of them.

use std::fmt::Debug;

use catoptric_scene::Rgb;
use catoptric_scene::quantity::LUMINANCE;
use catoptric_trace::Hit;

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
}

/// What a sample or pixel keeps of the light that it meets: no more than is written, for a picture has millions.
pub trait Kept: Copy + Debug + Send + Sync {
    /// No light.
    const DARK: Self;

    /// The eye's ray has met its first surface.
    fn meet(&mut self, hit: &Hit);

    /// Adds radiance of a layer.
    fn add(&mut self, layer: LightLayer, through_specular: bool, radiance: Rgb);

    /// All radiance.
    fn beauty(&self) -> Rgb;

    /// Luminance of the sources themselves, seen either way.
    fn emission(&self) -> f32;

    /// Adds another sample.
    fn accumulate(&mut self, other: &Self);

    /// Times a factor.
    fn scale(&mut self, factor: f32);

    /// No light any more, from where the first ray went.
    fn clear(&mut self);

    /// The layers, if they are kept.
    fn layered(&self) -> Option<&Layered>;
}

/// The beauty alone.
#[derive(Clone, Copy, Debug)]
pub struct Beauty {
    beauty: Rgb,
    emission: f32,
}

/// The layers, and what the data layers are made of.
#[derive(Clone, Copy, Debug)]
pub struct Layered {
    /// The light layers.
    pub light: LightLayers,
    /// The first hit; `None` for the sky.
    pub first: Option<Hit>,
}

impl Kept for Beauty {
    const DARK: Self = Self { beauty: Rgb::ZERO, emission: 0.0 };

    #[inline]
    fn meet(&mut self, _: &Hit) {}

    #[inline]
    fn add(&mut self, layer: LightLayer, _: bool, radiance: Rgb) {
        self.beauty += radiance;
        if layer == LightLayer::Emission {
            self.emission += radiance.dot(LUMINANCE);
        }
    }

    #[inline]
    fn beauty(&self) -> Rgb {
        self.beauty
    }

    #[inline]
    fn emission(&self) -> f32 {
        self.emission
    }

    #[inline]
    fn accumulate(&mut self, other: &Self) {
        self.beauty += other.beauty;
        self.emission += other.emission;
    }

    #[inline]
    fn scale(&mut self, factor: f32) {
        self.beauty *= factor;
        self.emission *= factor;
    }

    fn clear(&mut self) {
        *self = Self::DARK;
    }

    fn layered(&self) -> Option<&Layered> {
        None
    }
}

impl Kept for Layered {
    const DARK: Self = Self { light: LightLayers::DARK, first: None };

    #[inline]
    fn meet(&mut self, hit: &Hit) {
        self.first = Some(*hit);
    }

    #[inline]
    fn add(&mut self, layer: LightLayer, through_specular: bool, radiance: Rgb) {
        self.light.add(layer, through_specular, radiance);
    }

    #[inline]
    fn beauty(&self) -> Rgb {
        self.light.beauty()
    }

    fn emission(&self) -> f32 {
        let emission = LightLayer::Emission as usize;
        (self.light.values[emission] + self.light.values[emission + CLASSES]).dot(LUMINANCE)
    }

    #[inline]
    fn accumulate(&mut self, other: &Self) {
        for (sum, value) in self.light.values.iter_mut().zip(&other.light.values) {
            *sum += *value;
        }
    }

    #[inline]
    fn scale(&mut self, factor: f32) {
        for value in &mut self.light.values {
            *value *= factor;
        }
    }

    fn clear(&mut self) {
        self.light = LightLayers::DARK;
    }

    fn layered(&self) -> Option<&Layered> {
        Some(self)
    }
}
