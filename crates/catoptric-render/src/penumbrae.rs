//! Pixels in and beside penumbrae that shadow rays found: they are looked at by more rays, before anything else is concluded from what they
//! show.
//!
//! Shadows of few triangles are cut out of a source, exactly. Behind more, as where a row of bulbs shines past a moulding and past
//! each other, rays are counted, and that may be grainy. Those pixels get more rays once more; where it is hopeless, the mesh has
//! what it was solved by, which is smooth, and the picture fades over to that.

use rayon::prelude::*;

use catoptric_light::Lights;
use catoptric_light::irradiance::Samples;
use catoptric_scene::quantity::LUMINANCE;
use catoptric_scene::{Cancelled, Progress};

use crate::direct::{DirectLight, SourceLight};
use crate::interpolation;
use crate::irradiance_cache::{Records, Request};
use crate::layers::Kept;
use crate::needs::{DARK, Need};
use crate::pixel::{Query, Sample, Scratch};
use crate::render::{around, window};

/// Deviation of what shadow rays find, relative to the displayed luminance, that may show as grain beside what is smooth …
const GRAIN: f32 = 0.01;
/// … and that from which it does, much more than what the mesh gets wrong. (At .02, deviations of .015 are left as .008 beside a mesh that is 1 % off by itself: together more
/// than 1 %. By measurement on bulbs behind a board: grain of .0124 of the light, .0113 with .017.)
const HOPELESS: f32 = 0.017;
/// Shadow rays, and shadows that are cut out, in a grainy pixel for each of those in others.
const GRAINY: u32 = 4;
/// Mean squares of the difference of mesh and rays, in variances of these, up to which the mesh is read, and from which on it is not: it is then off
/// by .7 to 1.4 of what the rays are, and smooth. By and by, so that no border is seen. (Of the 8 bulbs of the test, grain of .7 % of the light was left at 4, .85 % at
/// these; but at 4, patches of a mesh that was 4 % off had borders on the floor of an elevator.)
const EXPLAINED: (f32, f32) = (1.5, 3.0);
/// Pixels that are looked at in one go.
const BATCH: usize = 1 << 16;
/// Pixels around over which the variance is pooled: that of one is known by a single difference.
const POOLED: usize = 2;

/// Penumbrae in a picture.
pub(crate) struct Penumbrae {
    /// Pixels that were looked at.
    pub(crate) looked: Vec<bool>,
    /// Share of the light of sources that is read from the mesh after all.
    pub(crate) read: Vec<f32>,
}

impl Penumbrae {
    /// In a picture of so many pixels, before anything is looked at.
    pub(crate) fn new(count: usize) -> Self {
        Self { looked: vec![false; count], read: vec![0.0; count] }
    }

    /// Whether a pixel is to be looked at that has a need: where penumbrae are, or few rays saw none beside one that is grainy.
    pub(crate) fn is_uncertain<L: Kept>(
        &self,
        pixels: &[Sample<L>],
        width: usize,
        index: usize,
        need: Need,
    ) -> bool {
        let is_grainy = |i: usize| self.looked[i] && (self.read[i] > 0.0 || pixels[i].grain > 0.0);
        need != Need::Nothing
            && !self.looked[index]
            && (need == Need::Shadows
                || pixels[index].grain > 0.0
                || around(index, width, pixels.len() / width.max(1)).any(is_grainy))
    }

    /// Looks at some pixels of a picture: `shoot` gives what is seen through the centre of one, with the light of sources as it is asked for.
    pub(crate) fn look<L: Kept>(
        &mut self,
        (pixels, records): (&mut [Sample<L>], &mut Records),
        (width, exposure): (usize, f32),
        first: &[usize],
        (lights, direct): (&Lights, DirectLight),
        progress: &dyn Progress,
        shoot: impl Fn((usize, usize), Query, &mut Scratch) -> Sample<L> + Sync,
    ) -> Result<(), Cancelled> {
        let (DirectLight::Auto(rays) | DirectLight::Pixels(rays)) = direct else { return Ok(()) };
        let rays = Samples::exact(rays.penumbra);
        let query = |rays: Samples| match direct {
            // What pixels beside each other find is interpolated where it is smooth, as that of first rays is.
            DirectLight::Auto(_) => Query::Defer(rays),
            DirectLight::Pixels(_) | DirectLight::Vertices => Query::Evaluate(rays),
        };
        let mut look = |pixels: &mut [Sample<L>], some: &[usize], query: Query| {
            let shoot = |scratch: &mut Scratch, &index: &usize| {
                if progress.is_cancelled() {
                    return None;
                }
                let seen = shoot((index % width, index / width), query, scratch);
                let asked: Box<[Request]> = scratch.sources.requests.as_slice().into();
                Some((seen, asked))
            };
            let seen: Option<Vec<_>> =
                some.par_iter().with_max_len(1).map_init(Scratch::default, shoot).collect();
            let mut asking = Vec::new();
            for (&index, (seen, asked)) in some.iter().zip(seen.ok_or(Cancelled)?) {
                let (pixel, Sample { light, open, penumbra, grain, .. }) = (&mut pixels[index], seen);
                *pixel = Sample { light, open, penumbra, grain, ..*pixel };
                if !asked.is_empty() {
                    asking.push((index, asked));
                }
            }
            let note = |pixel: usize, requests: &[Request], found: &[SourceLight]| {
                records.replace(pixel, requests, found);
            };
            interpolation::light(lights, (pixels, width), asking, false, progress, note)
        };
        // So many at a time: what they ask for takes a few hundred bytes each.
        first.chunks(BATCH).try_for_each(|some| look(pixels, some, query(rays)))?;
        first.iter().for_each(|&i| self.looked[i] = true);

        let more: Vec<usize> =
            self.grainy(pixels, (width, exposure), first).into_iter().map(|g| g.0).collect();
        more.chunks(BATCH).try_for_each(|some| look(pixels, some, query(rays.times(GRAINY))))?;
        if !matches!(direct, DirectLight::Auto(_)) {
            return Ok(());
        }
        let grainy = self.grainy(pixels, (width, exposure), &more);
        let places: Vec<usize> = grainy.iter().map(|g| g.0).collect();
        // What the mesh has.
        let stored: Vec<Sample<L>> = places
            .par_iter()
            .with_max_len(1)
            .map_init(Scratch::default, |scratch, &index| {
                shoot((index % width, index / width), Query::Stored, scratch)
            })
            .collect();
        for (index, deviation) in grainy {
            let x = ((deviation - GRAIN) / (HOPELESS - GRAIN)).min(1.0);
            self.read[index] = x * x * (3.0 - 2.0 * x) * explained(pixels, (&places, &stored), width, index);
        }
        for (index, stored) in places.into_iter().zip(stored) {
            pixels[index].fade(stored, self.read[index]);
        }
        Ok(())
    }

    /// Those of some pixels that are grainy, with their deviation, relative.
    fn grainy<L: Kept>(
        &self,
        pixels: &[Sample<L>],
        (width, exposure): (usize, f32),
        some: &[usize],
    ) -> Vec<(usize, f32)> {
        let height = pixels.len() / width.max(1);
        let deviation = |&index: &usize| {
            let (mut sum, mut count) = (0.0_f32, 0.0_f32);
            for near in window(index, (width, height), POOLED).filter(|&near| self.looked[near]) {
                sum += pixels[near].grain;
                count += 1.0;
            }
            let beside = pixels[index].light.beauty().dot(LUMINANCE) + DARK * exposure;
            let deviation = (sum / count.max(1.0)).sqrt() / beside;
            (deviation > GRAIN).then_some((index, deviation))
        };
        some.par_iter().with_min_len(256).filter_map(deviation).collect()
    }
}

/// How far around a pixel noise explains what the mesh differs by, which has `stored` at some `places`, ascending. At the edge of a sharp
/// shadow it does not: there the mesh is wrong.
fn explained<L: Kept>(
    pixels: &[Sample<L>],
    (places, stored): (&[usize], &[Sample<L>]),
    width: usize,
    index: usize,
) -> f32 {
    let (mut squares, mut variances) = (0.0_f32, 0.0_f32);
    for near in window(index, (width, pixels.len() / width.max(1)), POOLED) {
        if let Ok(place) = places.binary_search(&near) {
            let [own, other] = [&pixels[near], &stored[place]].map(|p| p.light.beauty().dot(LUMINANCE));
            squares += (own - other).powi(2);
            variances += pixels[near].grain;
        }
    }
    let (least, most) = EXPLAINED;
    let ratio = squares / variances.max(f32::MIN_POSITIVE);
    ((most - ratio) / (most - least)).clamp(0.0, 1.0)
}
