//! The sky as an emitter: bright texels are sources like lamps; the rest is skylight.

use glam::Vec3;

use catoptric_scene::quantity::LUMINANCE;
use catoptric_scene::{Rgb, Sky, SkyImage};

/// A texel of the sky that is sampled by shadow rays.
#[derive(Clone, Copy, Debug)]
pub struct BrightTexel {
    column: u32,
    row: u32,
    /// Unit direction of its centre.
    pub direction: Vec3,
    /// Radiance × solid angle.
    pub power: Rgb,
}

/// The bright parts of a sky.
#[derive(Clone, Debug, Default)]
pub struct BrightSky {
    texels: Vec<BrightTexel>,
    /// Per texel of the image: bright.
    is_bright: Vec<bool>,
}

/// A texel counts as bright above this multiple of the mean radiance: what few rays would see as noise.
const BRIGHT: f32 = 8.0;
/// Bright texels at most: the strongest are taken.
const MAX_BRIGHT: usize = 4096;

impl BrightSky {
    /// Finds the bright texels.
    pub fn new(sky: Option<&Sky>) -> Self {
        let Some(Sky::Image(image)) = sky else { return Self::default() };
        let solid_angle = |row: usize| solid_angle(image, row);
        let luminance = |index: usize| Rgb::from(image.texels[index]).dot(LUMINANCE);
        let mut total = 0.0_f64;
        for row in 0..image.height {
            for column in 0..image.width {
                total += f64::from(luminance(row * image.width + column) * solid_angle(row));
            }
        }
        let mean = (total / (4.0 * std::f64::consts::PI)) as f32;
        let mut bright: Vec<usize> =
            (0..image.texels.len()).filter(|&i| luminance(i) > BRIGHT * mean).collect();
        bright.sort_by(|&a, &b| {
            let power = |i: usize| luminance(i) * solid_angle(i / image.width);
            power(b).total_cmp(&power(a)).then(a.cmp(&b))
        });
        bright.truncate(MAX_BRIGHT);
        bright.sort_unstable();
        let mut is_bright = vec![false; image.texels.len()];
        let texels = bright
            .iter()
            .map(|&index| {
                is_bright[index] = true;
                let (row, column) = (index / image.width, index % image.width);
                BrightTexel {
                    column: column as u32,
                    row: row as u32,
                    direction: image.direction_of(column as f32 + 0.5, row as f32 + 0.5),
                    power: Rgb::from(image.texels[index]) * solid_angle(row),
                }
            })
            .collect();
        Self { texels, is_bright }
    }

    /// The bright texels.
    pub fn texels(&self) -> &[BrightTexel] {
        &self.texels
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.texels.is_empty()
    }

    /// Whether a direction looks at a bright texel.
    #[inline]
    pub fn holds(&self, sky: &Sky, direction: Vec3) -> bool {
        match sky {
            Sky::Image(image) if !self.texels.is_empty() => {
                let (column, row) = image.texel_of(direction);
                self.is_bright[row * image.width + column]
            }
            _ => false,
        }
    }

    /// Radiance of the sky where it is dim: none of bright texels.
    #[inline]
    pub fn dim_radiance(&self, sky: &Sky, direction: Vec3) -> Rgb {
        match sky {
            Sky::Uniform(radiance) => radiance.0,
            Sky::Image(image) => {
                let (column, row) = image.texel_of(direction);
                let index = row * image.width + column;
                let is_bright = !self.texels.is_empty() && self.is_bright[index];
                if is_bright { Rgb::ZERO } else { Rgb::from(image.texels[index]) }
            }
        }
    }

    /// A direction inside a texel, uniform by solid angle for (s, t) in [0, 1)².
    pub fn direction_in(&self, image: &SkyImage, texel: &BrightTexel, s: f32, t: f32) -> Vec3 {
        // Uniform in cosθ within the row.
        let theta = |row: f32| row / image.height as f32 * std::f32::consts::PI;
        let (top, bottom) = (libm::cosf(theta(texel.row as f32)), libm::cosf(theta(texel.row as f32 + 1.0)));
        let cos = top + (bottom - top) * t;
        let row = libm::acosf(cos.clamp(-1.0, 1.0)) / std::f32::consts::PI * image.height as f32;
        image.direction_of(texel.column as f32 + s, row)
    }
}

/// Solid angle of the texels of a row.
fn solid_angle(image: &SkyImage, row: usize) -> f32 {
    let theta = |r: f32| r / image.height as f32 * std::f32::consts::PI;
    let band = libm::cosf(theta(row as f32)) - libm::cosf(theta(row as f32 + 1.0));
    band * 2.0 * std::f32::consts::PI / image.width as f32
}
