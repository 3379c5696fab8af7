//! Which pixels are sampled again: those whose neighbours met other things, differ in brightness, or are in a penumbra.

use rayon::prelude::*;

use catoptric_scene::Rgb;
use catoptric_scene::quantity::LUMINANCE;

use crate::pixel::Sample;

/// What a pixel is sampled again for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Need {
    /// The first ray is enough.
    Nothing,
    /// A penumbra calls for more shadow rays.
    Shadows,
    /// An edge of little contrast calls for a few samples.
    FewSamples,
    /// An edge of much contrast, or the rim of what is curved and specular, calls for samples.
    Samples,
}

/// Times the contrast by which penumbrae differ from pixel to pixel where they are as sharp as an edge; less may be the
/// noise of few shadow rays.
const SHARP: f32 = 5.0;

/// Times the contrast from which a few samples are too few to begin with: most pixels beside a bright edge would miss what
/// is bright.
const STRONG: f32 = 4.0;

/// Times the contrast below which two sides of a border look the same: an edge that nobody sees needs no samples, unless layers are
/// written, in which it may be seen.
pub(crate) const SAME: f32 = 0.05;

/// What is compared with neighbours.
#[derive(Clone, Copy)]
struct Look {
    tone: Rgb,
    /// The tone if nothing blocked shadow rays.
    open: Rgb,
    trail: u32,
    rim: u32,
    penumbra: bool,
}

/// Share of the mean luminance of a picture that is added to luminances where they are compared: differences count as they
/// are seen, relative in the light, absolute in the dark.
pub(crate) const DARK: f32 = 0.1;

/// The need of every pixel; `contrast` is the difference of displayed luminance that calls for samples, `same` that which does on a border,
/// `exposure` the mean luminance.
pub(crate) fn needs(
    pixels: &[Sample],
    width: usize,
    height: usize,
    contrast: f32,
    same: f32,
    exposure: f32,
) -> Vec<Need> {
    let shown = |light| shown(light, exposure);
    let looks: Vec<Look> = pixels
        .par_iter()
        .with_min_len(1024)
        .map(|p| {
            let beauty = p.light.beauty();
            let tone = shown(beauty);
            let open = if p.open == beauty { tone } else { shown(p.open) };
            Look { tone, open, trail: p.trail, rim: p.rim, penumbra: p.penumbra }
        })
        .collect();
    (0..width * height)
        .into_par_iter()
        .with_min_len(1024)
        .map(|i| need(&looks, width, height, i % width, i / width, contrast, same))
        .collect()
}

/// Light as it is displayed, in natural logarithms, where `exposure` is the mean luminance of the picture.
pub(crate) fn shown(light: Rgb, exposure: f32) -> Rgb {
    (light / exposure + Rgb::splat(DARK)).map(libm::logf)
}

/// Mean luminance of a picture, more than zero.
pub(crate) fn mean_luminance(pixels: &[Sample]) -> f32 {
    let sum: f64 = pixels.iter().map(|p| f64::from(p.light.beauty().dot(LUMINANCE))).sum();
    ((sum / pixels.len().max(1) as f64) as f32).max(1e-30)
}

fn need(looks: &[Look], width: usize, height: usize, x: usize, y: usize, contrast: f32, same: f32) -> Need {
    let own = looks[y * width + x];
    let mut need = if own.penumbra { Need::Shadows } else { Need::Nothing };
    for (dx, dy) in [(-1_i64, 0_i64), (1, 0), (0, -1), (0, 1), (-1, -1), (1, -1), (-1, 1), (1, 1)] {
        let (nx, ny) = (x as i64 + dx, y as i64 + dy);
        if nx < 0 || ny < 0 || nx >= width as i64 || ny >= height as i64 {
            continue;
        }
        let other = looks[ny as usize * width + nx as usize];
        let difference = (other.tone - own.tone).abs().max_element();
        let is_edge = if own.penumbra || other.penumbra {
            if need == Need::Nothing {
                need = Need::Shadows;
            }
            difference > SHARP * contrast || (other.open - own.open).abs().max_element() > contrast
        } else {
            difference > contrast
        };
        let is_rim = other.rim != own.rim;
        let is_border = other.trail != own.trail && (difference >= same || is_rim);
        if is_edge || is_border {
            // By few samples the dark of a rim, thinner than a pixel, is a dot here and there.
            if is_edge && difference > STRONG * contrast || is_rim {
                return Need::Samples;
            }
            need = Need::FewSamples;
        }
    }
    need
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two pixels of the same brightness that met other things.
    fn beside(left: Sample, right: Sample) -> Vec<Need> {
        needs(&[left, right], 2, 1, 0.05, SAME * 0.05, 1.0)
    }

    #[test]
    fn borders_are_sampled_where_they_are_seen_and_rims_always() {
        let pixel = |trail, light| {
            let mut pixel = Sample { trail, open: Rgb::splat(light), ..Sample::NOTHING };
            pixel.light.values[0] = pixel.open;
            pixel
        };
        let (one, two) = (pixel(1, 1.0), pixel(2, 1.0));
        assert_eq!(beside(one, one), [Need::Nothing; 2]);
        // Less than a twentieth of the contrast of 0.05 between them, or more: of a luminance of 1.1 with what is added in the dark.
        assert_eq!(beside(one, pixel(2, 1.002)), [Need::Nothing; 2]);
        assert_eq!(beside(one, pixel(2, 1.004)), [Need::FewSamples; 2]);
        let curved = Sample { rim: 1, ..two };
        assert_eq!(beside(one, curved), [Need::Samples; 2]);
        assert_eq!(beside(curved, one), [Need::Samples; 2]);
        assert_eq!(beside(curved, curved), [Need::Nothing; 2]);
    }
}
