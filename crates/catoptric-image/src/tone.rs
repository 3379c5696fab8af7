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

/// Display bytes of linear pixels.
pub fn to_srgb8(pixels: &[[f32; 3]], tone: &ToneMap) -> Vec<[u8; 3]> {
    let gain = libm::exp2f(tone.exposure_ev);
    pixels
        .par_iter()
        .map(|pixel| {
            pixel.map(|v| {
                srgb::byte(match tone.curve {
                    Curve::Clip => v * gain,
                    Curve::Aces => aces(v * gain),
                })
            })
        })
        .collect()
}

fn aces(v: f32) -> f32 {
    let v = 0.6 * v.max(0.0);
    (v * (2.51 * v + 0.03)) / (v * (2.43 * v + 0.59) + 0.14)
}
