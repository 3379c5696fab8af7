//! From scene-referred light to a display: exposure, curve, sRGB bytes.

use rayon::prelude::*;

use crate::srgb;

/// Luminance weights of Rec. 709.
pub const LUMINANCE: [f32; 3] = [0.2126, 0.7152, 0.0722];

/// The shape between exposed light and the display.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Curve {
    /// Clip at white: what is below stays proportional.
    #[default]
    Clip,
    /// Narkowicz's fit of the ACES curve (2015), which rolls highlights off.
    Aces,
}

/// An exposure and a curve.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct ToneMap {
    /// Exposure in stops: light is multiplied by 2 to this power.
    pub exposure_ev: f32,
    /// The curve after the exposure.
    pub curve: Curve,
}

/// Exposure in stops that brings the 95th percentile of the lit pixels' luminance to 0.9; 0 for a black image.
pub fn auto_exposure(pixels: impl IntoIterator<Item = [f32; 3]>) -> f32 {
    let mut lit: Vec<f32> =
        pixels.into_iter().map(luminance).filter(|&y| y > 1e-6 && y.is_finite()).collect();
    if lit.is_empty() {
        return 0.0;
    }
    // Interpolate linearly between order statistics.
    let rank = 0.95 * (lit.len() - 1) as f64;
    let below = rank as usize;
    let (_, &mut low, rest) = lit.select_nth_unstable_by(below, f32::total_cmp);
    let high = rest.iter().copied().fold(f32::INFINITY, f32::min);
    let high = if high.is_finite() { high } else { low };
    let p95 = f64::from(low) + (rank - below as f64) * f64::from(high - low);
    libm::log2(0.9 / p95) as f32
}

/// Rec. 709 luminance.
pub fn luminance(rgb: [f32; 3]) -> f32 {
    LUMINANCE[0] * rgb[0] + LUMINANCE[1] * rgb[1] + LUMINANCE[2] * rgb[2]
}

/// Display bytes of linear pixels in rows of `width`: of the two codes around a pixel's light one is taken so that their
/// mean over some pixels is that light. Smooth light without noise has steps to be seen if each pixel is rounded.
///
/// Places between two codes are compared with interleaved gradient noise (Jimenez 2014), the same for all channels: what lies on a
/// code keeps it, and the same light in the same place gets the same byte.
pub fn to_srgb8(pixels: &[[f32; 3]], width: usize, tone: &ToneMap) -> Vec<[u8; 3]> {
    let gain = libm::exp2f(tone.exposure_ev);
    let width = width.max(1);
    let byte = |(index, pixel): (usize, &[f32; 3])| {
        let threshold = interleaved_gradient_noise((index % width) as f32, (index / width) as f32);
        pixel.map(|v| srgb::byte_at(tone.curve.of(v * gain), threshold))
    };
    pixels.par_iter().enumerate().map(byte).collect()
}

/// Evenly spread over `[0, 1)` in every 3 × 3 pixels.
fn interleaved_gradient_noise(x: f32, y: f32) -> f32 {
    (52.982_918 * (0.067_110_56 * x + 0.005_837_15 * y).fract()).fract()
}

impl Curve {
    fn of(self, light: f32) -> f32 {
        match self {
            Self::Clip => light,
            Self::Aces => aces(light),
        }
    }
}

fn aces(v: f32) -> f32 {
    let v = 0.6 * v.max(0.0);
    (v * (2.51 * v + 0.03)) / (v * (2.43 * v + 0.59) + 0.14)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Light between two codes, the same everywhere: each is rounded to one code, dithered all small squares are near it.
    #[test]
    fn dithered_light_is_even_in_every_small_square() {
        let (low, high) = (srgb::LINEAR_OF_BYTE[100], srgb::LINEAR_OF_BYTE[101]);
        let (width, height) = (200, 150);
        for share in [0.1_f32, 0.3, 0.5, 0.8] {
            let light = low + share * (high - low);
            let bytes = to_srgb8(&vec![[light; 3]; width * height], width, &ToneMap::default());
            assert!(bytes.iter().all(|b| b[0] == b[1] && b[1] == b[2] && (100..=101).contains(&b[0])));
            for (x, y) in (0..height - 9).flat_map(|y| (0..width - 9).map(move |x| (x, y))) {
                let square = (0..81).map(|k| bytes[(y + k / 9) * width + x + k % 9][0]);
                let above = square.filter(|&b| b == 101).count() as f32 / 81.0;
                // One deviation of 81 that are drawn by chance, √(¼ / 81): of the squares of such a picture a third are further off.
                assert!((above - share).abs() < 0.055, "{share} {above} at {x} {y}");
            }
        }
    }
}
