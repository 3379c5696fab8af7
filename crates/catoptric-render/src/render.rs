//! Pass two from end to end: samples, anti-aliasing, layers.
//!
//! Anti-aliasing is adaptive: which pixels get more samples is decided by other samples than those that they are made of, or what is
//! bright and missed would stay so. (A neighbour's second look may depend on a pixel's own first: by measurement, 1e-5 of a picture's light.)
//! A first ray through each pixel's centre leaves a trail of what it met; pixels whose trail differs
//! from a neighbour's, or whose radiance bends, are sampled again on a grid of their own (`supersampling`), and the first ray is not used.
//! As long as their neighbours turn out noisy, they are sampled more. Where the outline of a lamp crosses a pixel, both sides are strata; where
//! a lamp may pass between centres, seen straight, over mirrors or in what is curved (`bundles`), pixels are sampled whatever these met, and where
//! its image is much smaller than a pixel, half of the samples go there. Along what else is thinner than a pixel and passes between
//! centres, pixels are sampled because those before are noisy, or found it on that side.
//! Where a pixel's own samples leave it quite uncertain, as one that met a spark does, there are more of them.
//! Pixels in or beside a penumbra that shadow rays found are sampled again through the centre, by more of them.
//! Where the mesh is too coarse and the light of sources is evaluated, pixels share what is found: it is interpolated between centres where it is
//! smooth (`interpolation`), and recalled by the other samples around them (`irradiance_cache`).

use std::ops::Range;

use glam::DVec2;
use rayon::prelude::*;

use catoptric_image::Image;
use catoptric_light::irradiance::Samples;
use catoptric_light::{LightParams, Lights};
use catoptric_scene::quantity::LUMINANCE;
use catoptric_scene::{Camera, Cancelled, Progress, Scene};
use catoptric_solution::{Quality, Solution};
use catoptric_trace::Tracer;
use catoptric_trace::sequence::{Key, Purpose};
use catoptric_trace::walk::split::SplitParams;

use crate::bundles::{Legs, Missed, Sources};
use crate::direct::{DirectLight, ShadowRays, SourceLight};
use crate::interpolation;
use crate::irradiance_cache::{Around, Records, Request};
use crate::layers::{Beauty, Kept, Layered, NAMES};
use crate::lines::{Footprint, LAYER as LINES};
use crate::needs::{Compared, DARK, Need, SAME, mean_luminance};
use crate::outlines::Outlines;
use crate::penumbrae::Penumbrae;
use crate::pixel::{Eye, FirstHit, Query, Sample, Scratch};
use crate::probes;
use crate::resolution::Resolution;
use crate::supersampling::{again, is_beside_noise, resample, shadow_rays, shoot};

/// Parameters of pass two.
#[derive(Clone, Debug, PartialEq)]
pub struct RenderParams {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Limits of the eye's walk.
    pub walk: SplitParams,
    /// Sources, as pass one saw them.
    pub light: LightParams,
    /// Where their light on diffuse surfaces comes from.
    pub direct: DirectLight,
    /// Seed of all sequences.
    pub seed: u32,
    /// Samples of a pixel on an edge, at least; four times as many to begin with where its contrast is strong.
    pub edge_samples: u32,
    /// … and at most.
    pub most_samples: u32,
    /// Differences of displayed luminance between neighbours, relative, that call for more samples.
    pub contrast: f32,
    /// Standard deviation of the samples of a pixel, relative to its displayed luminance, per sample: pixels on an edge
    /// beside one that has more are made of twice as many samples. (The squared error of a mean of n samples falls
    /// by σ²/n² with the next one: the same everywhere at the least cost.)
    pub noise: f32,
    /// Write the light layers and the data layers (albedo, normal, depth, ids) beside the beauty.
    pub layers: bool,
    /// Write the coverage by the lines of the display mesh beside the beauty.
    pub mesh: bool,
}

impl RenderParams {
    /// The budgets of a quality.
    pub fn for_quality(quality: Quality, width: usize, height: usize) -> Self {
        // At 4e-4 the pixels of a furnace with glass stay within 1e-3; at 5e-4 but for one in twenty thousand.
        let (edge_samples, most_samples, noise, roulette_below) = match quality {
            Quality::Sketch => (4, 4, 0.05, 5e-3),
            Quality::Draft => (4, 128, 0.05, 2e-3),
            Quality::Standard => (4, 256, 0.045, 4e-4),
            Quality::High => (16, 256, 0.01, 4e-4),
        };
        // In a sketch or a draft it is enough to see where shadows fall.
        let direct = match quality {
            Quality::Sketch | Quality::Draft => DirectLight::Vertices,
            Quality::Standard | Quality::High => DirectLight::Auto(ShadowRays::for_quality(quality)),
        };
        let mut walk = SplitParams { roulette_below, ..SplitParams::default() };
        if quality == Quality::High {
            // Between lossless mirrors the horizon is a line of what takes more events: it is as much narrower.
            walk.max_depth *= 4;
        }
        Self {
            width,
            height,
            walk,
            light: LightParams::default(),
            direct,
            seed: 0,
            edge_samples,
            most_samples,
            contrast: 0.1,
            noise,
            layers: false,
            mesh: false,
        }
    }
}

/// What pass two did.
#[derive(Clone, Debug, Default)]
pub struct RenderReport {
    /// Eye rays that the picture is made of, and those through the centres.
    pub samples: u64,
    /// Pixels that were sampled again.
    pub refined_pixels: u64,
    /// Of them, those where only a penumbra was seen, by one sample.
    pub penumbra_pixels: u64,
}

/// The result of pass two.
#[derive(Clone, Debug)]
pub struct Rendered {
    /// The image: beauty and, if asked for, layers.
    pub image: Image,
    /// What was done.
    pub report: RenderReport,
}

/// Renders a view.
pub fn render(
    tracer: &Tracer,
    solution: &Solution,
    camera: &Camera,
    params: &RenderParams,
    progress: &dyn Progress,
) -> Result<Rendered, Cancelled> {
    if params.layers {
        render_keeping::<Layered>(tracer, solution, camera, params, progress)
    } else {
        render_keeping::<Beauty>(tracer, solution, camera, params, progress)
    }
}

/// Bytes that a pixel takes in one block of memory while an image is traced, with layers or without.
pub fn pixel_bytes(layers: bool) -> usize {
    if layers { size_of::<Sample<Layered>>() } else { size_of::<Sample<Beauty>>() }
}

fn render_keeping<L: Kept>(
    tracer: &Tracer,
    solution: &Solution,
    camera: &Camera,
    params: &RenderParams,
    progress: &dyn Progress,
) -> Result<Rendered, Cancelled> {
    let (width, height) = (params.width, params.height);
    let film = &camera.film(width, height);
    let (lights, resolution) = rayon::join(
        || Lights::new(tracer, params.light),
        || {
            matches!(params.direct, DirectLight::Auto(_)).then(|| {
                let middle = (0.5 * width as f32, 0.5 * height as f32);
                Resolution::of(solution, Footprint::at(film, middle))
            })
        },
    );
    let eye = Eye {
        lights: &lights,
        solution,
        resolution: resolution.as_ref(),
        everywhere: [false; 2],
        params: params.walk,
    };
    let mut counts = vec![params.edge_samples.clamp(1, params.most_samples.max(1))];
    while let Some(&count) = counts.last().filter(|&&count| count < params.most_samples) {
        counts.push(count.saturating_mul(MORE).min(params.most_samples));
    }

    // One ray through the centre of every pixel.
    progress.begin("image", ((1 + counts.len()) * (width * height).div_ceil(JOB)) as u64);
    let mut pixels: Vec<Sample<L>> = Vec::with_capacity(width * height);
    // The legs of these rays, from the row above a band on. In boxes: most pixels have none, and they are hundreds of bytes.
    let sources = Sources::new(&lights);
    let (mut legs, mut missed): (Vec<Option<Box<Legs>>>, Vec<Missed>) = (Vec::new(), Vec::new());
    let first_query = match params.direct {
        DirectLight::Vertices => Query::Stored,
        DirectLight::Auto(rays) => Query::Defer(Samples::exact(rays.first)),
        DirectLight::Pixels(rays) => Query::Evaluate(Samples::exact(rays.first)),
    };
    let mut records = Records::default();
    let rows = (BAND / width.max(1)).max(1);
    while pixels.len() < width * height {
        let band = pixels.len()..(pixels.len() + rows * width).min(width * height);
        let above = legs.len();
        legs.resize(if sources.are_thrown() { above + band.len() } else { 0 }, None);
        let mut requests: Vec<Box<[Request]>> = vec![Box::default(); band.len()];
        let start = band.start;
        let first = band.into_par_iter().zip(&mut requests).with_min_len(JOB).with_max_len(JOB);
        let shot = |scratch: &mut Scratch, index: usize, requests: &mut Box<[Request]>| {
            if index.is_multiple_of(JOB) {
                progress.advance(1);
            }
            if progress.is_cancelled() {
                return Sample::NOTHING;
            }
            let key = Key::new(params.seed, Purpose::Pixel, index as u64);
            let at = (index % width, index / width);
            let sample = shoot(&eye, film, params, at, (0.5, 0.5), first_query, (key, 0), scratch);
            *requests = scratch.sources.requests.as_slice().into();
            sample
        };
        if sources.are_thrown() {
            pixels.par_extend(first.zip(&mut legs[above..]).map_init(
                Scratch::noting_legs,
                |scratch, ((index, requests), legs)| {
                    let sample = shot(scratch, index, requests);
                    *legs = scratch.legs.filter(Legs::any).map(Box::new);
                    sample
                },
            ));
        } else {
            let shot =
                |scratch: &mut Scratch, (index, requests): (usize, &mut _)| shot(scratch, index, requests);
            pixels.par_extend(first.map_init(Scratch::default, shot));
        }
        if progress.is_cancelled() {
            return Err(Cancelled);
        }
        let asking = (start..).zip(requests).filter(|(_, requests)| !requests.is_empty()).collect();
        let note = |pixel: usize, requests: &[Request], found: &[SourceLight]| {
            records.push(pixel, requests, found);
        };
        interpolation::light(&lights, (&mut pixels, width), asking, true, progress, note)?;
        missed.extend(sources.between(&legs, pixels.len() - legs.len(), width, progress));
        missed.truncate(MOST_MISSED);
        legs.drain(..legs.len().saturating_sub(width + 1));
    }

    let mut are_stray = probes::strays(
        (&mut pixels, &mut records, width),
        (&lights, params.direct),
        progress,
        |index, terms, query, scratch| {
            let key = Key::new(params.seed, Purpose::Pixel, index as u64);
            let at = (index % width, index / width);
            let eye = Eye { everywhere: terms, ..eye };
            shoot(&eye, film, params, at, (0.5, 0.5), query, (key, 0), scratch)
        },
    )?;

    // Pixels beside an edge are made of new samples.
    let strong = counts[0].saturating_mul(STRONG).min(counts[counts.len() - 1]);
    let exposure = mean_luminance(&pixels);
    let same = if params.layers { 0.0 } else { SAME * params.contrast };
    let mut compared = Compared::new(&pixels, width, params.contrast, same, exposure);
    let (mut needs, mut outlines) =
        rayon::join(|| compared.needs(), || Outlines::new(&lights, camera, (width, height)));
    // Few rays in a penumbra may differ as much as an edge does: more of them come first.
    let mut penumbrae = Penumbrae::new(pixels.len());
    for _ in 0..LOOKS {
        let uncertain = those(pixels.len(), |i| penumbrae.is_uncertain(&pixels, width, i, needs[i]));
        if uncertain.is_empty() || params.direct == DirectLight::Vertices {
            break;
        }
        let of = (width, exposure);
        let shoot = |at: (usize, usize), query: Query, scratch: &mut Scratch| {
            let eye = Eye { everywhere: are_stray[at.1 * width + at.0], ..eye };
            shoot(&eye, film, params, at, (0.5, 0.5), query, (again(params, at), 0), scratch)
        };
        penumbrae.look(
            (&mut pixels, &mut records),
            of,
            &uncertain,
            (&lights, params.direct),
            progress,
            shoot,
        )?;
        compared.update(&pixels, &uncertain, &mut needs);
    }
    for thin in outlines.thin() {
        if pixels[thin.pixel].light.emission() < 0.5 * thin.luminance {
            needs[thin.pixel] = Need::Samples;
        }
    }
    let shows = |missed: &Missed, pixel: usize| {
        let beside = pixels[pixel].light.beauty().dot(LUMINANCE) + DARK * exposure;
        missed.luminance > params.contrast * beside
    };
    missed.retain(|missed| missed.pixels.iter().any(|&pixel| shows(missed, pixel)));
    for missed in &missed {
        for &pixel in missed.pixels.iter().filter(|&&pixel| shows(missed, pixel)) {
            needs[pixel] = Need::Samples;
        }
    }
    let place = |scratch: &mut Scratch, missed: &Missed| {
        if progress.is_cancelled() {
            return None;
        }
        let key = Key::new(params.seed, Purpose::Pixel, missed.pixels[0] as u64).child(PLACES);
        sources.outline(missed, width, |place| {
            let (at, within) = (place.as_usizevec2(), place.fract().as_vec2());
            let (at, within) = ((at.x, at.y), (within.x, within.y));
            shoot::<Beauty>(&eye, film, params, at, within, Query::Stored, (key, 0), scratch);
            scratch.legs.unwrap_or_default()
        })
    };
    let placed: Vec<Option<Vec<DVec2>>> =
        missed.par_iter().with_max_len(JOB).map_init(Scratch::noting_legs, place).collect();
    for (missed, outline) in missed.iter().zip(placed) {
        for pixel in missed.pixels {
            outlines.guess(pixel, outline.as_deref().unwrap_or_default(), width);
        }
    }
    let resample = |are_stray: &[[bool; 2]],
                    at: (usize, usize),
                    fresh: Range<u32>,
                    pixel: &mut Sample<L>,
                    scratch: &mut Scratch| {
        let index = at.1 * width + at.0;
        let query = match shadow_rays(params, fresh.end).filter(|_| penumbrae.read[index] < 0.5) {
            None => Query::Stored,
            Some(rays) if matches!(params.direct, DirectLight::Auto(_)) => {
                // Where the contrast is little, that of shadows on an edge is, too.
                let own = if fresh.end < strong { 0 } else { OWN };
                Query::Recall(rays, Around { records: &records, pixel: index, size: (width, height), own })
            }
            Some(rays) => Query::Evaluate(rays),
        };
        let eye = Eye { everywhere: are_stray[index], ..eye };
        resample(&eye, film, params, (outlines.cuts(index), exposure), query, at, fresh, pixel, scratch);
    };
    for_pixels(&mut pixels, width, progress, |at, pixel, scratch| match needs[at.1 * width + at.0] {
        Need::Nothing | Need::Shadows => {}
        Need::FewSamples => resample(&are_stray, at, 0..counts[0], pixel, scratch),
        Need::Samples => resample(&are_stray, at, 0..strong, pixel, scratch),
    })?;
    // What is thinner than a pixel passes between the centres of some.
    let limit = THIN * params.noise * strong as f32;
    let mut ends = those(pixels.len(), |i| pixels[i].samples > 0);
    while !ends.is_empty() {
        let noisy = those(ends.len(), |k| pixels[ends[k]].deviation(exposure) > limit);
        let noisy = noisy.into_iter().flat_map(|k| around(ends[k], width, height));
        // A centre and those around a neighbour span the half of the pixel on that side. An edge that passes between has one of them
        // beyond, and the neighbour is sampled; what is on neither side of one is thin.
        let thin = ends.iter().flat_map(|&i| pixels[i].between.of(i, width, height));
        let mut missed: Vec<usize> = noisy.chain(thin).filter(|&i| pixels[i].samples == 0).collect();
        missed.sort_unstable();
        missed.dedup();
        // Shadows that the mesh does not know go on between the centres, too.
        let beside = |&i: &usize| {
            let near = around(i, width, height).map(|near| are_stray[near]);
            (i, near.fold(are_stray[i], probes::either))
        };
        let strays: Vec<(usize, [bool; 2])> = missed.iter().map(beside).collect();
        strays.into_iter().for_each(|(i, terms)| are_stray[i] = terms);
        for_some(&mut pixels, width, &missed, progress, |at, pixel, scratch| {
            resample(&are_stray, at, 0..strong, pixel, scratch);
        })?;
        ends = missed;
    }
    // What finds noise may be more samples of a pixel whose neighbours had stopped at few.
    let most = counts[counts.len() - 1];
    let mut open = those(pixels.len(), |i| pixels[i].samples > 0);
    while !open.is_empty() {
        let is_open = |&i: &usize| {
            pixels[i].samples < most && is_beside_noise(&pixels, width, i, params.noise, exposure)
        };
        open = open.into_par_iter().with_min_len(FEW).filter(is_open).collect();
        for_some(&mut pixels, width, &open, progress, |at, pixel, scratch| {
            resample(&are_stray, at, more(pixel.samples, most), pixel, scratch);
        })?;
        let near = |&i: &usize| around(i, width, height).chain([i]).collect::<Vec<_>>();
        open = open.iter().flat_map(near).filter(|&i| pixels[i].samples > 0).collect();
        open.sort_unstable();
        open.dedup();
    }
    progress.advance(((counts.len() - 1) * (width * height).div_ceil(JOB)) as u64);
    // One sample in hundreds that met a spark is a bright dot: those pixels are sampled until they are certain.
    let most = params.most_samples.saturating_mul(SPARK_MORE);
    loop {
        let sparks =
            those(pixels.len(), |i| pixels[i].samples < most && pixels[i].error(exposure) > UNCERTAIN);
        if sparks.is_empty() {
            break;
        }
        for_some(&mut pixels, width, &sparks, progress, |at, pixel, scratch| {
            resample(&are_stray, at, more(pixel.samples, most), pixel, scratch);
        })?;
    }
    let edge_samples: u64 = pixels.iter().map(|p| u64::from(p.samples)).sum();

    let is_shadow = |(looked, pixel): &(&bool, &Sample<L>)| **looked && pixel.samples == 0;
    let penumbra_pixels = penumbrae.looked.iter().zip(&pixels).filter(is_shadow).count() as u64;
    let edges = pixels.iter().filter(|p| p.samples > 0).count() as u64;
    let report = RenderReport {
        samples: (width * height) as u64 + edge_samples + penumbra_pixels,
        refined_pixels: edges + penumbra_pixels,
        penumbra_pixels,
    };
    Ok(Rendered { image: image(tracer.scene(), &pixels, params), report })
}

/// Places between centres where sources are looked for more closely, at most: some hundred megabytes.
const MOST_MISSED: usize = 1 << 20;
/// Child of a pixel's key for the rays that look where a source is.
const PLACES: u32 = 2;

/// Pixels in one parallel job. A row is too long: where a horizon lies between mirrors, it takes as long as the rest.
const JOB: usize = 32;
/// Pixels that get their first ray before somebody may stop it, and before what they ask for is found: those of a large picture take gigabytes.
const BAND: usize = 1 << 16;

/// Pixels that are looked at in one go, where nothing is traced.
const FEW: usize = 1024;

/// Those of so many, ascending.
fn those(count: usize, is_one: impl Fn(usize) -> bool + Sync + Send) -> Vec<usize> {
    (0..count).into_par_iter().with_min_len(FEW).filter(|&index| is_one(index)).collect()
}

/// Works on every pixel, in parallel.
fn for_pixels<L: Kept>(
    pixels: &mut [Sample<L>],
    width: usize,
    progress: &dyn Progress,
    work: impl Fn((usize, usize), &mut Sample<L>, &mut Scratch) + Sync,
) -> Result<(), Cancelled> {
    // By itself rayon stops splitting after few halves: hence one chunk at most.
    pixels.par_chunks_mut(JOB).with_max_len(1).enumerate().try_for_each_init(
        Scratch::default,
        |scratch, (job, pixels)| {
            if progress.is_cancelled() {
                return Err(Cancelled);
            }
            for (index, pixel) in (job * JOB..).zip(pixels) {
                work((index % width, index / width), pixel, scratch);
            }
            progress.advance(1);
            Ok(())
        },
    )
}

/// Works on some pixels, in parallel: few, near each other, and each a long job.
fn for_some<L: Kept>(
    pixels: &mut [Sample<L>],
    width: usize,
    indices: &[usize],
    progress: &dyn Progress,
    work: impl Fn((usize, usize), &mut Sample<L>, &mut Scratch) + Sync,
) -> Result<(), Cancelled> {
    let found: Vec<Sample<L>> = indices
        .par_iter()
        .with_max_len(1)
        .map_init(Scratch::default, |scratch, &index| {
            let mut pixel = pixels[index];
            if !progress.is_cancelled() {
                work((index % width, index / width), &mut pixel, scratch);
            }
            pixel
        })
        .collect();
    if progress.is_cancelled() {
        return Err(Cancelled);
    }
    for (&index, pixel) in indices.iter().zip(found) {
        pixels[index] = pixel;
    }
    Ok(())
}

/// Samples of a pixel beside a noisy one (the rim of a glass, with lamps in it) for each that it has already.
const MORE: u32 = 2;
/// The samples that come next in a pixel that has so many, and may have `most`.
fn more(known: u32, most: u32) -> Range<u32> {
    known..known.saturating_mul(MORE).min(most)
}

/// Samples where the contrast is strong, for each where it is not: a power of `MORE`.
const STRONG: u32 = 4;

/// Samples of [`STRONG`] ones that evaluate the light of sources at a place before any may recall it.
const OWN: usize = 3;

/// Rounds in which pixels beside grainy penumbrae are looked at, at most.
const LOOKS: u32 = 8;

/// Times the noise for which a pixel of [`STRONG`] samples gets more: beside one that has as much, pixels are sampled whatever
/// their first ray met. A slit or a wire is a row of them, a plain edge of usual contrast is not.
const THIN: f32 = 2.0;

/// Standard error of a pixel, relative to its displayed luminance, above which it is sampled for its own sake. That is biased: what is smaller
/// than a sample's share of the pixel is missed in most pictures, as before, but is no longer many times too bright in the few that meet it.
const UNCERTAIN: f32 = 0.2;
/// Samples of such a pixel at most, for each that others may have.
const SPARK_MORE: u32 = 16;

/// The pixels of a picture up to so many columns and rows from one, and that one, by index.
pub(crate) fn window(
    index: usize,
    (width, height): (usize, usize),
    radius: usize,
) -> impl Iterator<Item = usize> {
    let range = |at: usize, count: usize| at.saturating_sub(radius)..(at + radius + 1).min(count);
    let (columns, rows) = (range(index % width, width), range(index / width, height));
    rows.flat_map(move |row| columns.clone().map(move |column| row * width + column))
}

/// The neighbours of a pixel, by index.
pub(crate) fn around(index: usize, width: usize, height: usize) -> impl Iterator<Item = usize> {
    window(index, (width, height), 1).filter(move |&other| other != index)
}

/// Puts the layers into an image.
fn image<L: Kept>(scene: &Scene, pixels: &[Sample<L>], params: &RenderParams) -> Image {
    let mut image = Image::new(params.width, params.height);
    let beauty: Vec<[f32; 3]> =
        pixels.par_iter().with_min_len(FEW).map(|p| p.light.beauty().to_array()).collect();
    image.push_rgb_layer("", &beauty);
    let layered: Vec<&Layered> = pixels.iter().filter_map(|p| p.light.layered()).collect();
    if !layered.is_empty() {
        for (index, name) in NAMES.iter().enumerate() {
            let value = |layered: &&Layered| layered.light.values[index].to_array();
            let layer: Vec<[f32; 3]> = layered.par_iter().with_min_len(FEW).map(value).collect();
            image.push_rgb_layer(name, &layer);
        }
        let first = |layered: &&Layered| FirstHit::of(scene, layered.first.as_ref());
        let hits: Vec<FirstHit> = layered.par_iter().with_min_len(FEW).map(first).collect();
        let albedo: Vec<[f32; 3]> = hits.iter().map(|hit| hit.albedo.to_array()).collect();
        image.push_rgb_layer("albedo", &albedo);
        for (axis, name) in ["normal.X", "normal.Y", "normal.Z"].into_iter().enumerate() {
            image.push_channel(name, hits.iter().map(|hit| hit.normal[axis]).collect());
        }
        image.push_channel("depth.Z", hits.iter().map(|hit| hit.depth).collect());
        image.push_channel("id.surface", hits.iter().map(|hit| hit.surface as f32).collect());
    }
    if params.mesh {
        image.push_channel(LINES, pixels.iter().map(|p| p.lines.min(1.0)).collect());
    }
    image
}
