//! Lights without area: `KHR_lights_punctual`, and the sky.

use std::sync::Arc;

use glam::Vec3;

use crate::photometry::Photometry;
use crate::quantity::{Radiance, Rgb};

/// What a punctual light sends where.
#[derive(Clone, Debug, PartialEq)]
pub enum PunctualKind {
    /// Intensity in candela (per channel), the same in every direction.
    Point,
    /// Intensity falls from the inner to the outer cone by glTF's own formula.
    Spot {
        /// Cosine of the inner cone's half angle.
        cos_inner: f32,
        /// Cosine of the outer cone's half angle.
        cos_outer: f32,
    },
    /// Parallel light; `intensity` is in lux.
    Directional,
    /// Intensity falls with the cosine from the direction: `intensity` × cosⁿθ in front, nothing behind. With
    /// S(θ) = (n+1)/2π · cosⁿθ, which integrates to 1 over the hemisphere, `intensity` is Φ(n+1)/2π for the power Φ.
    Lobe {
        /// n.
        exponent: f32,
    },
    /// Intensity by a table; `intensity` is its peak.
    Photometric {
        /// The table.
        table: Arc<Photometry>,
        /// Unit vector across the direction: where the table's horizontal angle is 0.
        across: Vec3,
    },
}

/// A light of `KHR_lights_punctual` in world space; `range` is ignored.
#[derive(Clone, Debug)]
pub struct PunctualLight {
    /// Name of its node or light.
    pub name: String,
    /// Position in metres (no meaning for directional lights).
    pub position: Vec3,
    /// Unit vector along which the light shines (no meaning for point lights).
    pub direction: Vec3,
    /// Candela, or lux for directional lights, times colour.
    pub intensity: Rgb,
    /// Its distribution.
    pub kind: PunctualKind,
}

impl PunctualLight {
    /// Intensity (candela, or lux) towards `direction_out`, the unit vector from the light.
    pub fn intensity_towards(&self, direction_out: Vec3) -> Rgb {
        match &self.kind {
            PunctualKind::Point | PunctualKind::Directional => self.intensity,
            PunctualKind::Lobe { exponent } => {
                let cos = self.direction.dot(direction_out);
                if cos > 0.0 { self.intensity * libm::powf(cos, *exponent) } else { Rgb::ZERO }
            }
            PunctualKind::Photometric { table, across } => {
                let cos = self.direction.dot(direction_out).clamp(-1.0, 1.0);
                let (x, y) = (across.dot(direction_out), self.direction.cross(*across).dot(direction_out));
                let (vertical, horizontal) = (libm::acosf(cos), libm::atan2f(y, x));
                self.intensity * table.share(vertical.to_degrees(), horizontal.to_degrees())
            }
            &PunctualKind::Spot { cos_inner, cos_outer } => {
                // KHR_lights_punctual: angularAttenuation = saturate(cd·scale + offset)².
                let cos = self.direction.dot(direction_out);
                let scale = 1.0 / (cos_inner - cos_outer).max(1e-3);
                let attenuation = ((cos - cos_outer) * scale).clamp(0.0, 1.0);
                self.intensity * (attenuation * attenuation)
            }
        }
    }
}

/// Light from infinitely far away, where rays leave the scene.
#[derive(Clone, Debug)]
pub enum Sky {
    /// The same radiance from every direction.
    Uniform(Radiance),
    /// An equirectangular image.
    Image(SkyImage),
}

/// An equirectangular radiance map, +Y up; the image's centre column looks along −Z... see [`SkyImage::direction_of`].
#[derive(Clone, Debug)]
pub struct SkyImage {
    /// Columns.
    pub width: usize,
    /// Rows; row 0 is the zenith.
    pub height: usize,
    /// Row-major radiance.
    pub texels: Vec<[f32; 3]>,
}

impl SkyImage {
    /// Texel (column, row) that a unit direction falls into: u = atan2(x, −z)/2π + ½, v = acos(y)/π.
    #[inline]
    pub fn texel_of(&self, direction: Vec3) -> (usize, usize) {
        let u = libm::atan2f(direction.x, -direction.z) * (0.5 / std::f32::consts::PI) + 0.5;
        let v = libm::acosf(direction.y.clamp(-1.0, 1.0)) * (1.0 / std::f32::consts::PI);
        let column = (u * self.width as f32) as usize;
        let row = (v * self.height as f32) as usize;
        (column.min(self.width - 1), row.min(self.height - 1))
    }

    /// Unit direction of the continuous texel coordinates (column, row).
    pub fn direction_of(&self, column: f32, row: f32) -> Vec3 {
        let phi = (column / self.width as f32 - 0.5) * (2.0 * std::f32::consts::PI);
        let theta = row / self.height as f32 * std::f32::consts::PI;
        let (sin_theta, cos_theta) = libm::sincosf(theta);
        let (sin_phi, cos_phi) = libm::sincosf(phi);
        Vec3::new(sin_theta * sin_phi, cos_theta, -sin_theta * cos_phi)
    }
}

impl Sky {
    /// Radiance that arrives from the unit direction `direction` (pointing away from the scene).
    /// Images are constant over each texel, so that what is sampled by texel is what is seen.
    #[inline]
    pub fn radiance(&self, direction: Vec3) -> Radiance {
        match self {
            Sky::Uniform(radiance) => *radiance,
            Sky::Image(image) => {
                let (column, row) = image.texel_of(direction);
                Radiance(Rgb::from(image.texels[row * image.width + column]))
            }
        }
    }
}
