//! Which pixels are sampled again: those whose neighbours met other things, differ in brightness, or are in a penumbra.

use rayon::prelude::*;

use catoptric_scene::Rgb;
use catoptric_scene::quantity::LUMINANCE;

use crate::layers::Kept;
use crate::pixel::Sample;
use crate::render::around;

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

/// … and differences up to so many of their deviations are chance.
const CHANCE: f32 = 3.0;

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
    /// Variance of the tone by shadow rays.
    grain: f32,
}

/// Share of the mean luminance of a picture that is added to luminances where they are compared: differences count as they
/// are seen, relative in the light, absolute in the dark.
pub(crate) const DARK: f32 = 0.1;

/// The pixels of a picture, as they are compared with their neighbours.
pub(crate) struct Compared {
    looks: Vec<Look>,
    width: usize,
    /// Difference of displayed luminance that calls for samples, …
    contrast: f32,
    /// … and that which does on a border.
    same: f32,
    /// Mean luminance of the picture.
    exposure: f32,
}

impl Compared {
    pub(crate) fn new<L: Kept>(
        pixels: &[Sample<L>],
        width: usize,
        contrast: f32,
        same: f32,
        exposure: f32,
    ) -> Self {
        let look = |pixel: &Sample<L>| Look::of(pixel, exposure);
        let looks = pixels.par_iter().with_min_len(1024).map(look).collect();
        Self { looks, width, contrast, same, exposure }
    }

    /// The need of every pixel.
    pub(crate) fn needs(&self) -> Vec<Need> {
        (0..self.looks.len()).into_par_iter().with_min_len(1024).map(|i| self.need(i)).collect()
    }

    /// The needs after some pixels have changed.
    pub(crate) fn update<L: Kept>(&mut self, pixels: &[Sample<L>], changed: &[usize], needs: &mut [Need]) {
        for &index in changed {
            self.looks[index] = Look::of(&pixels[index], self.exposure);
        }
        let height = self.looks.len() / self.width.max(1);
        let near = |&index: &usize| around(index, self.width, height).chain([index]);
        let mut near: Vec<usize> = changed.iter().flat_map(near).collect();
        near.sort_unstable();
        near.dedup();
        let found: Vec<Need> = near.par_iter().with_min_len(256).map(|&index| self.need(index)).collect();
        near.into_iter().zip(found).for_each(|(index, need)| needs[index] = need);
    }

    fn need(&self, index: usize) -> Need {
        let Self { looks, width, contrast, same, .. } = self;
        let own = looks[index];
        let beside = || around(index, *width, looks.len() / width).map(|i| looks[i]);
        let mut need = if own.penumbra { Need::Shadows } else { Need::Nothing };
        // Few rays may see no difference between two: all around tell how grainy it is. Two tones differ by √2 of one's deviation.
        let grain = if own.penumbra {
            let add = |(sum, count): (f32, f32), look: Look| (sum + look.grain, count + 1.0);
            let (sum, count) = beside().filter(|look| look.penumbra).fold((own.grain, 1.0), add);
            (2.0 * sum / count).sqrt()
        } else {
            0.0
        };
        for other in beside() {
            let difference = (other.tone - own.tone).abs().max_element();
            let is_edge = if own.penumbra || other.penumbra {
                if need == Need::Nothing {
                    need = Need::Shadows;
                }
                difference > (SHARP * contrast).max(CHANCE * grain)
                    || (other.open - own.open).abs().max_element() > *contrast
            } else {
                difference > *contrast
            };
            let is_rim = other.rim != own.rim;
            let is_border = other.trail != own.trail && (difference >= *same || is_rim);
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
}

impl Look {
    fn of<L: Kept>(pixel: &Sample<L>, exposure: f32) -> Self {
        let beauty = pixel.light.beauty();
        let tone = shown(beauty, exposure);
        let open = if pixel.open == beauty { tone } else { shown(pixel.open, exposure) };
        let grain = pixel.grain / (beauty.dot(LUMINANCE) + DARK * exposure).powi(2);
        Self { tone, open, trail: pixel.trail, rim: pixel.rim, penumbra: pixel.penumbra, grain }
    }
}

/// Light as it is displayed, in natural logarithms, where `exposure` is the mean luminance of the picture.
pub(crate) fn shown(light: Rgb, exposure: f32) -> Rgb {
    (light / exposure + Rgb::splat(DARK)).map(libm::logf)
}

/// Mean luminance of a picture as a display shows it, more than zero: what is among the brightest twentieth of what is lit, such as lamps and
/// windows in sight, is white, however bright. By the mean of all light a room beside a window would count as dark.
pub(crate) fn mean_luminance<L: Kept>(pixels: &[Sample<L>]) -> f32 {
    let luminances: Vec<f32> =
        pixels.par_iter().with_min_len(1024).map(|p| p.light.beauty().dot(LUMINANCE)).collect();
    let mut lit: Vec<f32> = luminances.iter().copied().filter(|&luminance| luminance > 0.0).collect();
    let rank = (lit.len() as f32 * WHITE) as usize;
    let white = if lit.is_empty() { 0.0 } else { *lit.select_nth_unstable_by(rank, f32::total_cmp).1 };
    let sum: f64 = luminances.into_iter().map(|luminance| f64::from(luminance.min(white))).sum();
    ((sum / pixels.len().max(1) as f64) as f32).max(1e-30)
}

/// Share of lit pixels that are not white, by the exposure of previews.
const WHITE: f32 = 0.95;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layers::{Beauty, LightLayer};

    /// Two pixels of the same brightness that met other things.
    fn beside(left: Sample<Beauty>, right: Sample<Beauty>) -> Vec<Need> {
        Compared::new(&[left, right], 2, 0.05, SAME * 0.05, 1.0).needs()
    }

    #[test]
    fn a_window_in_sight_makes_no_room_dark() {
        let of = |luminances: &[f32]| {
            let pixel = |&luminance: &f32| {
                let mut pixel: Sample<Beauty> = Sample::NOTHING;
                pixel.light.add(LightLayer::Emission, false, Rgb::splat(luminance));
                pixel
            };
            mean_luminance(&luminances.iter().map(pixel).collect::<Vec<_>>())
        };
        assert!((of(&[0.5; 100]) - 0.5).abs() < 1e-6);
        // Four of a hundred are as white as a display is: as the brightest beside them.
        let mut room = [0.5; 100];
        room[10..14].fill(1000.0);
        assert!((of(&room) - 0.5).abs() < 1e-6);
        // What is black is not lit, but seen.
        room[50..].fill(0.0);
        assert!(of(&room) > 0.25);
        assert!(of(&[0.0; 4]) > 0.0 && of(&[]) > 0.0);
    }

    #[test]
    fn borders_are_sampled_where_they_are_seen_and_rims_always() {
        let pixel = |trail, light| {
            let mut pixel: Sample<Beauty> = Sample { trail, open: Rgb::splat(light), ..Sample::NOTHING };
            pixel.light.add(LightLayer::Emission, false, pixel.open);
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
