//! Probes: pixels at which the display mesh is held against the sources themselves.
//!
//! The mesh is made where pass one looked. What is thinner than its elements, such as the shadows of wires, may have passed between its
//! vertices, and then it knows nothing of it: no error is seen in it. So the light of sources is evaluated at some pixels all over a picture.
//! From those where it is not what the mesh has, the search goes on to their neighbours, as far as that is so.

use rayon::prelude::*;

use catoptric_light::Lights;
use catoptric_light::irradiance::Samples;
use catoptric_scene::quantity::LUMINANCE;
use catoptric_scene::{Cancelled, Progress};

use crate::direct::{DirectLight, Part, SourceLight};
use crate::interpolation;
use crate::irradiance_cache::{Record, Records, Request};
use crate::layers::Kept;
use crate::needs::{DARK, mean_luminance};
use crate::pixel::{Query, Sample, Scratch};
use crate::render::window;

/// One pixel of so many is a probe, in every row, every column and every diagonal, …
const APART: usize = 17;
/// … each so many columns farther left than those in the row above: no two are nearer than √17 pixels.
const STEP: usize = 4;
/// Pixels around a stray one, in columns and rows, to which the search goes on: shadows that are thinner than a pixel are met by some of them.
const REACH: usize = 2;
/// Displayed luminance that differs by the first share hardly shows, by the second it does: what is displayed goes over from the one to
/// the other, so that no border is seen.
const SHOWN: (f32, f32) = (0.01, 0.03);
/// Share of what is found from which the search goes on.
const GOES_ON: f32 = 0.5;
/// What differs by chance does not count: in deviations of what shadow rays find.
const CHANCE: f32 = 2.5;
/// Chains of mirrors over which each probe asks for light; where more are, fewer do, …
const FEW_CHAINS: usize = 2;
/// … but one of so many.
const MOST_SKIPPED: usize = 8;
/// Pixels in one parallel job.
const JOB: usize = 16;
/// Pixels that are looked at in one go.
const BATCH: usize = 1 << 16;

/// What was found at a pixel.
struct Found<L> {
    pixel: usize,
    sample: Sample<L>,
    /// Share of it that is to be shown.
    share: f32,
    /// Whether the direct and the mirrored light differ from what the mesh has of them.
    terms: [bool; 2],
    records: Vec<Record>,
}

/// Evaluates the light of sources where it is not what the mesh has, and tells of every pixel whether the direct and the mirrored light are to be evaluated
/// there from now on: they are in those, and in the ones beside them. `shoot` gives what is seen through the centre of a pixel, with the direct and the mirrored light of
/// sources, or one of them, as it is asked for.
pub(crate) fn strays<L: Kept>(
    (pixels, records, width): (&mut [Sample<L>], &mut Records, usize),
    (lights, direct): (&Lights, DirectLight),
    progress: &dyn Progress,
    shoot: impl Fn(usize, [bool; 2], Query, &mut Scratch) -> Sample<L> + Sync,
) -> Result<Vec<[bool; 2]>, Cancelled> {
    let mut are_stray = vec![[false; 2]; pixels.len()];
    let DirectLight::Auto(rays) = direct else { return Ok(are_stray) };
    if !lights.has_sources() {
        return Ok(are_stray);
    }
    let query = Query::Defer(Samples::exact(rays.penumbra));
    let size = (width, pixels.len() / width.max(1));
    let exposure = mean_luminance(pixels);
    let skipped = (lights.chains().chains().len() / FEW_CHAINS).clamp(1, MOST_SKIPPED);
    let asked = |(index, pixel): (usize, usize)| (pixel, [true, index % skipped == 0]);
    let unknown = probes(size).filter(|&probe| !records.knows(probe));
    let mut next: Vec<(usize, [bool; 2])> = unknown.enumerate().map(asked).collect();
    let mut were_asked = vec![[false; 2]; pixels.len()];
    let mut fresh: Vec<(usize, Vec<Record>)> = Vec::new();
    let mut is_glance = true;
    while !next.is_empty() {
        let mut strays: Vec<(usize, [bool; 2])> = Vec::new();
        for some in next.chunks(BATCH) {
            let look = |scratch: &mut Scratch, &(pixel, terms): &(usize, [bool; 2])| {
                if progress.is_cancelled() {
                    return None;
                }
                let sample = shoot(pixel, terms, query, scratch);
                let stored = &pixels[pixel];
                let requests = std::mem::take(&mut scratch.sources.requests);
                let mut evaluate = |samples: Option<Samples>| {
                    let evaluate = |request: &Request| {
                        let samples = samples.unwrap_or(request.samples);
                        Request { samples, ..*request }.evaluate(lights, &mut scratch.sources.light)
                    };
                    requests.iter().map(evaluate).collect::<Vec<SourceLight>>()
                };
                let with = |found: &[SourceLight]| {
                    let mut sample = sample;
                    interpolation::add(&mut sample, &requests, found);
                    sample
                };
                let mut may_stray = || {
                    let found = evaluate(Some(Samples::glance()));
                    let doubt = doubt(&requests, &found, |part| part.penumbra);
                    share(stored, &Sample { grain: 0.0, ..with(&found) }, exposure, doubt) > 0.0
                };
                let found = (!requests.is_empty() && (!is_glance || may_stray())).then(|| {
                    let found = evaluate(None);
                    let sample = with(&found);
                    let doubt = doubt(&requests, &found, |_| true);
                    let share = share(stored, &sample, exposure, doubt);
                    let terms = which_differ(&requests, &found, displayed(&sample, exposure));
                    let records = requests.iter().zip(&found).map(|(r, f)| Record::of(r, f)).collect();
                    Found { pixel, sample, share, terms, records }
                });
                scratch.sources.requests = requests;
                Some(found)
            };
            let found: Option<Vec<Option<Found<L>>>> =
                some.par_iter().with_max_len(JOB).map_init(Scratch::default, look).collect();
            for Found { pixel, sample, share, terms, records } in
                found.ok_or(Cancelled)?.into_iter().flatten()
            {
                if share > 0.0 {
                    pixels[pixel].fade(sample, share);
                }
                if share >= GOES_ON {
                    strays.push((pixel, terms));
                }
                // Those around a stray pixel tell where its shadow ends.
                fresh.push((pixel, records));
            }
        }
        for (pixel, terms) in next {
            were_asked[pixel] = terms;
        }
        let mut wanted = Vec::new();
        for (stray, terms) in strays {
            window(stray, size, 1).for_each(|near| are_stray[near] = either(are_stray[near], terms));
            wanted.extend(window(stray, size, REACH).map(|near| (near, terms)));
        }
        // By pixel: what was asked there, and what is to be.
        wanted.sort_unstable();
        next = Vec::new();
        for terms in wanted.chunk_by(|one, other| one.0 == other.0) {
            let (pixel, asked) = (terms[0].0, were_asked[terms[0].0]);
            let terms = terms.iter().fold(asked, |all, (_, terms)| either(all, *terms));
            if terms != asked {
                next.push((pixel, terms));
            }
        }
        is_glance = false;
    }
    records.insert(&last_of_each(fresh));
    Ok(are_stray)
}

/// By pixel, what was found there last: one that was asked for direct light alone may have been asked again.
fn last_of_each<T>(mut found: Vec<(usize, T)>) -> Vec<(usize, T)> {
    found.sort_by_key(|found| found.0);
    found.dedup_by(|later, earlier| {
        let is_same = later.0 == earlier.0;
        if is_same {
            std::mem::swap(later, earlier);
        }
        is_same
    });
    found
}

/// The probes in a picture of so many columns and rows, ascending.
fn probes((width, height): (usize, usize)) -> impl Iterator<Item = usize> {
    let first = |y: usize| (APART - STEP * y % APART) % APART;
    (0..height).flat_map(move |y| (first(y)..width).step_by(APART).map(move |x| y * width + x))
}

/// The terms that are one's or the other's.
pub(crate) fn either(one: [bool; 2], other: [bool; 2]) -> [bool; 2] {
    [one[0] || other[0], one[1] || other[1]]
}

/// Luminance by which differences are seen: relative in the light, absolute in the dark.
fn displayed<L: Kept>(sample: &Sample<L>, exposure: f32) -> f32 {
    sample.light.beauty().dot(LUMINANCE) + DARK * exposure
}

/// Whether the direct and the mirrored light that were found differ from what the mesh has of them, by what shows beside so much luminance.
fn which_differ(requests: &[Request], found: &[SourceLight], displayed: f32) -> [bool; 2] {
    let mut differences = [0.0; 2];
    for (request, found) in requests.iter().zip(found) {
        let parts = [(found.direct, request.wanted.direct), (found.mirrored, request.wanted.mirrored)];
        for (term, (part, share)) in parts.into_iter().enumerate() {
            let difference = part.irradiance.dot(LUMINANCE) - request.stored[term];
            differences[term] += share * request.send.dot(LUMINANCE) * difference;
        }
    }
    differences.map(|difference: f32| difference.abs() > SHOWN.0 * displayed)
}

/// Luminance that the numbers of shadow rays explain, where what they found of a term is `uncertain`.
fn doubt(requests: &[Request], found: &[SourceLight], uncertain: impl Fn(&Part) -> bool) -> f32 {
    let of = |(request, found): (&Request, &SourceLight)| {
        let parts = [(found.direct, request.wanted.direct), (found.mirrored, request.wanted.mirrored)];
        let doubtful = parts.iter().filter(|(part, _)| uncertain(part));
        let square = |(part, share): &(Part, f32)| {
            (part.doubt * share * (request.send * part.unoccluded).dot(LUMINANCE)).powi(2)
        };
        doubtful.map(square).sum::<f32>()
    };
    requests.iter().zip(found).map(of).sum::<f32>().sqrt()
}

/// Share of what the sources send at a pixel that is to be shown instead of what the mesh has: none where they hardly differ, or may do so
/// by chance.
fn share<L: Kept>(stored: &Sample<L>, found: &Sample<L>, exposure: f32, doubt: f32) -> f32 {
    let [stored, own] = [stored, found].map(|sample| displayed(sample, exposure));
    let chance = CHANCE * found.grain.sqrt().max(doubt);
    let relative = ((own - stored).abs() - chance) / stored.max(own);
    let way = ((relative - SHOWN.0) / (SHOWN.1 - SHOWN.0)).clamp(0.0, 1.0);
    way * way * (3.0 - 2.0 * way)
}

#[cfg(test)]
mod tests {
    use super::*;
    use catoptric_scene::Rgb;

    use crate::layers::{Beauty, LightLayer};

    #[test]
    fn a_line_of_seventeen_pixels_is_met_whichever_way_it_lies() {
        for (width, height) in [(64, 64), (37, 50)] {
            let mut is_probe = vec![false; width * height];
            probes((width, height)).for_each(|probe| is_probe[probe] = true);
            let count = is_probe.iter().filter(|is| **is).count();
            let share = count as f32 / is_probe.len() as f32;
            assert!((share * 17.0 - 1.0).abs() < 0.05, "{share}");
            let sorted: Vec<usize> = probes((width, height)).collect();
            assert!(sorted.is_sorted_by(|a, b| a < b));
            for (x, y) in (17..width - 17).flat_map(|x| (0..height - 17).map(move |y| (x, y))) {
                for step in [(1, 0), (0, 1), (1, 1), (-1, 1)] {
                    let mut on_line = (0..17_i64).map(|k| {
                        let [x, y] = [x as i64 + k * step.0, y as i64 + k * step.1].map(|at| at as usize);
                        is_probe[y * width + x]
                    });
                    assert!(on_line.any(|is| is), "from ({x}, {y}) by {step:?}");
                }
            }
        }
        assert_eq!(probes((3, 2)).collect::<Vec<_>>(), [0]);
    }

    #[test]
    fn what_is_found_last_at_a_pixel_counts() {
        let found = vec![(5, 'a'), (2, 'b'), (5, 'c'), (9, 'd'), (2, 'e'), (5, 'f')];
        assert_eq!(last_of_each(found), [(2, 'e'), (5, 'f'), (9, 'd')]);
    }

    #[test]
    fn what_is_shown_goes_over_where_it_differs_by_more_than_chance() {
        let sample = |light: f32, grain: f32| {
            let mut sample: Sample<Beauty> = Sample { grain, ..Sample::NOTHING };
            sample.light.add(LightLayer::Direct, false, Rgb::splat(light));
            sample
        };
        // A tenth of the exposure is added: differences of 0.011 and 0.033 are 1 % and 3 %.
        let share = |found: f32, grain: f32, doubt: f32| {
            share(&sample(1.0, 0.0), &sample(1.0 - found, grain), 1.0, doubt)
        };
        assert_eq!([0.0, 0.0109].map(|found| share(found, 0.0, 0.0)), [0.0; 2]);
        assert!((share(0.022, 0.0, 0.0) - 0.5).abs() < 1e-3);
        assert_eq!([0.0331, 1.0].map(|found| share(found, 0.0, 0.0)), [1.0; 2]);
        // Deviations of 0.1, by halves or by the count of rays, explain a quarter, and no more.
        for (grain, doubt) in [(0.01, 0.0), (0.0, 0.1)] {
            assert_eq!([0.25, 0.3].map(|found| share(found, grain, doubt)), [0.0, 1.0]);
        }
    }
}
