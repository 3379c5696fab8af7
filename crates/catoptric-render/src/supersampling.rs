//! Samples of a pixel: one through its centre, or a grid of them that it is made of where one is not enough.

use std::ops::Range;

use catoptric_light::irradiance::Samples;
use catoptric_scene::Film;
use catoptric_scene::quantity::LUMINANCE;
use catoptric_trace::sequence::{Key, Purpose};

use crate::direct::DirectLight;
use crate::layers::Kept;
use crate::lines::Footprint;
use crate::needs::shown;
use crate::outlines::Cut;
use crate::pixel::{Eye, Query, Sample, Scratch};
use crate::render::{RenderParams, around};

/// Times the threshold of roulette for pixels on an edge: their own noise is more than what it adds (3e-6 to 9e-6 of squared relative
/// error where everything reflects, for 5 to 20 % of the time; at 5 times, a lamp in a faint reflection is a bright dot).
const EDGE_ROULETTE: f32 = 2.5;

/// Child of a pixel's key for the ray that looks whether a lamp is seen.
const INSIDE: u32 = 1 << 17;

/// What is seen through a place of a pixel, (½, ½) in the middle of it.
pub(crate) fn shoot<L: Kept>(
    eye: &Eye,
    film: &Film,
    params: &RenderParams,
    (x, y): (usize, usize),
    (dx, dy): (f32, f32),
    query: Query,
    sample: (Key, u32),
    scratch: &mut Scratch,
) -> Sample<L> {
    let (origin, direction) = film.ray(x as f32 + dx, y as f32 + dy);
    let place = (x as f32 + dx, y as f32 + dy);
    let footprint = params.mesh.then(|| Footprint::at(film, place));
    eye.sample(origin + direction * film.near, direction, footprint, query, sample, scratch)
}

/// Replaces the light of a pixel by the mean of samples on a grid of its own (box filter), or adds the `fresh` ones among
/// them to the mean of those before. Where the outline of a lamp that is seen cuts the pixel, half of them are inside.
pub(crate) fn resample<L: Kept>(
    eye: &Eye,
    film: &Film,
    params: &RenderParams,
    (cuts, exposure): ([Option<&Cut>; 2], f32),
    query: Query,
    at: (usize, usize),
    fresh: Range<u32>,
    pixel: &mut Sample<L>,
    scratch: &mut Scratch,
) {
    let key = again(params, at);
    let (count, known) = (fresh.end.max(1) as f32, fresh.start as f32);
    if fresh.start == 0 {
        pixel.centre = shown(pixel.light.beauty(), exposure);
        pixel.light.clear();
        (pixel.lines, pixel.squares) = (0.0, 0.0);
    }
    scratch.sources.own.clear();
    // Something else may be before the lamp.
    let shows = |cut: &&Cut| {
        let Some(place) = cut.inside() else { return true };
        let sample = (key.child(INSIDE), 0);
        let Sample::<L> { light, .. } =
            shoot(eye, film, params, at, (place.x, place.y), Query::Stored, sample, scratch);
        light.emission() > 0.0
    };
    let cut = cuts.into_iter().flatten().find(shows);
    if fresh.start == 0 {
        pixel.sides = cut.map(|_| [0.0; 2]);
    }
    pixel.light.scale(known);
    pixel.lines *= known;
    pixel.samples = fresh.end;
    let eye = &Eye { params: eye.params.for_one_of(EDGE_ROULETTE * fresh.end as f32), ..*eye };
    for index in fresh {
        let point = key.point2(index);
        let (offset, side, weight) = cut.map_or((point, 0, 1.0), |cut| cut.place(point));
        let mut sample: Sample<L> =
            shoot(eye, film, params, at, (offset.x, offset.y), query, (key, index), scratch);
        // What shadow rays see a part of may differ by chance.
        if sample.trail != pixel.trail || !(sample.penumbra || pixel.penumbra) {
            let difference = (shown(sample.light.beauty(), exposure) - pixel.centre).abs().max_element();
            if difference > params.contrast {
                pixel.between.add(offset);
            }
        }
        sample.light.scale(weight);
        pixel.light.accumulate(&sample.light);
        pixel.lines += sample.lines * weight;
        let luminance = sample.light.beauty().dot(LUMINANCE);
        pixel.squares += luminance * luminance;
        if let Some(sides) = &mut pixel.sides {
            sides[side] += luminance;
        }
    }
    pixel.light.scale(1.0 / count);
    pixel.lines /= count;
}

/// Whether a pixel on an edge stands beside one that is noisy for as many samples. Its own noise has no say: those whose samples
/// missed what is bright would keep them, and the picture would be too dark.
pub(crate) fn is_beside_noise<L: Kept>(
    pixels: &[Sample<L>],
    width: usize,
    index: usize,
    noise: f32,
    exposure: f32,
) -> bool {
    let limit = noise * pixels[index].samples as f32;
    around(index, width, pixels.len() / width.max(1)).any(|i| pixels[i].deviation(exposure) > limit)
}

/// Shadow rays of each of so many samples that a pixel is made of.
pub(crate) fn shadow_rays(params: &RenderParams, count: u32) -> Option<Samples> {
    match params.direct {
        DirectLight::Vertices => None,
        DirectLight::Auto(rays) | DirectLight::Pixels(rays) => Some(match count {
            ..2 => Samples::exact(rays.penumbra),
            // Those of several samples do not share their strata: their mean hides noise, but less than one of cut-out shadows has.
            _ => Samples::exact((2 * rays.penumbra / count).max(1)),
        }),
    }
}

/// Key of the samples that a pixel is made of where its first one is not used.
pub(crate) fn again(params: &RenderParams, (x, y): (usize, usize)) -> Key {
    Key::new(params.seed, Purpose::Pixel, (y * params.width + x) as u64).child(1)
}

#[cfg(test)]
mod tests {
    use catoptric_scene::Rgb;

    use super::*;
    use crate::layers::{Beauty, LightLayer};

    /// A pixel made of samples with these luminances.
    fn pixel(luminances: &[f32]) -> Sample<Beauty> {
        let mut pixel: Sample<Beauty> = Sample { samples: luminances.len() as u32, ..Sample::NOTHING };
        pixel.squares = luminances.iter().map(|l| l * l).sum();
        let mean = luminances.iter().sum::<f32>() / luminances.len() as f32;
        pixel.light.add(LightLayer::Emission, false, Rgb::splat(mean));
        pixel
    }

    #[test]
    fn the_deviation_of_samples_is_relative_to_what_is_seen() {
        // Mean 1, variance (0 + 0 + 0 + 16 − 4·1²) / 3 = 4; a tenth of the mean of the picture is added to the light.
        assert!((pixel(&[0.0, 0.0, 0.0, 4.0]).deviation(2.0) - 2.0 / 1.2).abs() < 1e-6);
        assert_eq!(pixel(&[3.0; 4]).deviation(1.0), 0.0);
        assert_eq!(Sample::<Beauty>::NOTHING.deviation(1.0), 0.0);
    }

    #[test]
    fn pixels_get_more_samples_for_the_noise_beside_them_and_not_for_their_own() {
        let (calm, noisy) = (pixel(&[1.0; 4]), pixel(&[0.0, 0.0, 2.0, 2.0]));
        let mut pixels = vec![calm, noisy, calm, calm, calm];
        pixels[2].samples = 16;
        // The deviation of the noisy one is 1.05: more than 4 samples are worth at 0.25, less than at 0.3.
        let sampled_on = |noise: f32| -> Vec<usize> {
            (0..5).filter(|&i| is_beside_noise(&pixels, 5, i, noise, 1.0)).collect()
        };
        assert_eq!(sampled_on(0.25), [0]);
        assert!(sampled_on(0.3).is_empty());
    }
}
