//! Irradiance at a point by area emitters and the sky: straight, and over image chains.
//!
//! Per emitter cell: Lambert's formula on the part above the horizon and inside the mirrors' windows. Where nothing is in the
//! pyramid to it, that is the irradiance; where few triangles are, their shadows are cut out of it, exactly; where more are, those
//! of walls are, and the formula for the rest is multiplied by the mean throughput of stratified shadow rays, weighted by the integrand. Textures, coats and
//! what thins light on the way are sampled. Cosine lobes have a contour formula of their own, and their factor is part of
//! the integrand.
//!
//! The file `seen` holds what a receiver sees of the emitters, `way` what is in the way to a large one, `blocker` the parts of which that is made, `shadow` how much of its light
//! arrives, `shared` that of many small ones, `skylight` that of the dim sky, `lens` that of lamps in what shows them large.

mod blocker;
mod lens;
mod seen;
mod shadow;
mod shared;
mod skylight;
mod way;

use glam::Vec3;

use catoptric_scene::Rgb;
use catoptric_trace::Tracer;
use catoptric_trace::beam::Suspects;
use catoptric_trace::sequence::Key;
use catoptric_trace::walk::split::Waiting;

use crate::chains::{ImageChain, ImageChains, Unfolded};
use crate::contour;
use crate::emitter::Emitters;
use crate::lens::Lenses;
use crate::receiver::Receiver;
use crate::sky::BrightSky;

pub use lens::{LensBeside, LensLight, LensSeen};
pub use skylight::{SkyView, Skylight};

use blocker::Walls;
use seen::{Found, Seeker};
use shadow::{Budget, Tally, Target};
use skylight::Cells;
use way::Remainder;

/// How sources are evaluated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LightParams {
    /// Images of sources in planar mirrors (off for plain radiosity).
    pub images: bool,
    /// Whether a light-side pass owns the caustic paths.
    pub light_rays: bool,
}

impl Default for LightParams {
    fn default() -> Self {
        Self { images: true, light_rays: true }
    }
}

/// The sources of a scene, ready to be asked.
#[derive(Clone, Debug)]
pub struct Lights<'a> {
    tracer: &'a Tracer<'a>,
    emitters: Emitters,
    chains: ImageChains,
    bright: BrightSky,
    pub(crate) lenses: Lenses,
    params: LightParams,
    walls: Walls,
    far: f32,
}

/// Reused buffers of one thread.
#[derive(Debug, Default)]
pub struct Scratch {
    found: Found,
    /// What is seen of sources by what it would send, and their numbers.
    order: Vec<(f64, u32)>,
    seeker: Seeker,
    texels: Vec<(u32, f32)>,
    fan: Vec<f64>,
    suspects: Suspects,
    remainder: Remainder,
    sky: Cells,
    waiting: Waiting,
    pub(crate) targets: Vec<Vec3>,
    /// Over which light may be seen.
    pub(crate) chains: Vec<u32>,
    /// Shadow rays cast (chains count one).
    pub rays: u64,
}

/// Where light arrives: at a receiver, straight or over a chain of mirrors, with its image behind them.
#[derive(Clone, Copy)]
struct Standpoint<'a> {
    receiver: &'a Receiver,
    chain: Option<&'a ImageChain>,
    image: &'a Unfolded,
}

/// Where the keys of lamps begin, beyond those of pieces.
const LAMPS: u32 = 0x8000;

/// Irradiance with what its shadow rays saw.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SourceIrradiance {
    /// The irradiance.
    pub irradiance: Rgb,
    /// The same if nothing blocked.
    pub unoccluded: Rgb,
    /// Some shadow rays were blocked and some were not: more of them would tell more.
    pub partial: bool,
    /// Each source was wholly visible, or wholly blocked, or equally thinned, as far as the samples tell: more of them
    /// would hardly tell more.
    pub even: bool,
    /// Samples told how much of some source is seen, or what of its texture. Else that is known exactly.
    pub sampled: bool,
    /// Of some source no more than the [`LOOK`] samples were taken that a calm place begins with: they agreed.
    pub looked: bool,
    /// What the first half of the samples found beyond the second: a quarter of its square estimates the variance of the
    /// irradiance, as well as one difference can.
    pub split: Rgb,
    /// Deviation that the numbers of samples alone explain, whatever these found, channels added: a few that agree may all have missed
    /// something.
    pub doubt: f32,
}

impl SourceIrradiance {
    /// No source.
    const DARK: Self = Self {
        irradiance: Rgb::ZERO,
        unoccluded: Rgb::ZERO,
        partial: false,
        even: true,
        sampled: false,
        looked: false,
        split: Rgb::ZERO,
        doubt: 0.0,
    };
}

/// How many shadow rays look at the sources from one receiver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Samples {
    /// Of all sources together, about.
    pub count: u32,
    /// The places around see each source wholly, or not at all: of one whose first [`LOOK`] samples agree, no more are
    /// taken. Samples alone must not decide this: those that missed what blocks a little would be content.
    pub calm: bool,
    /// Triangles whose shadows may be cut out of the sources: equal shares for all but minor ones (what is brightest may be hidden), no
    /// more than half for one.
    pub shadows: u32,
    /// Of a source over mirrors at least: chains are many, and one is enough where the places around smooth what it finds.
    pub least: u32,
    /// Sources share their samples, and have no shadows cut out, if so many times what they are due is little.
    pub apart: u32,
}

/// Triangles that are cut out for each shadow ray that they save.
const SHADOWS_PER_SAMPLE: u32 = 3;
/// Sources that would send less than this share of all light have no shadows cut out: their noise is as small.
const MINOR: f64 = 0.05;
/// Samples are shared out as if no more could arrive than so many times what does, as far as is known by then: where the brightest is
/// hidden, the rest gets more.
const HIDDEN: f64 = 4.0;
/// [`Samples::apart`] where samples must not show noise. (By measurement: of stairs with a strip of light under each step no grain is left that is seen at 8,
/// some at 3; images take between 7 % less time and 2 % more.)
const APART: u32 = 8;
/// Bounds what one receiver costs.
const MAX_SHADOWS: u32 = 384;

impl Samples {
    /// With as many shadows cut out as ever, of nearly all sources, however few the samples are: where they must not show noise by
    /// themselves, as at pixels.
    pub fn exact(count: u32) -> Self {
        Self { count, calm: false, shadows: MAX_SHADOWS, least: LOOK, apart: APART }
    }

    /// As few as tell whether something is in the way.
    pub fn glance() -> Self {
        Self { count: 1, calm: false, shadows: 0, least: 1, apart: 1 }
    }

    /// So many times the rays, and the shadows that are cut out.
    #[must_use]
    pub fn times(self, times: u32) -> Self {
        Self { count: self.count * times, shadows: self.shadows * times, ..self }
    }
}

impl From<u32> for Samples {
    fn from(count: u32) -> Self {
        let shadows = (SHADOWS_PER_SAMPLE * count).min(MAX_SHADOWS);
        Self { count, calm: false, shadows, least: 1, apart: 1 }
    }
}

/// Samples in proportion to its light from which on a source is worth strata of its own.
const OWN_STRATA: f64 = 1.5;

/// Groups of emitters are told apart as for so many samples where none are taken.
const OPEN_SAMPLES: u32 = 64;

/// Samples of a source that do where the surroundings are calm and they agree.
pub const LOOK: u32 = 4;

impl<'a> Lights<'a> {
    /// Collects the sources and finds the image chains.
    pub fn new(tracer: &'a Tracer<'a>, params: LightParams) -> Self {
        let emitters = Emitters::new(tracer);
        let scene = tracer.scene();
        let bright = BrightSky::new(scene.sky());
        let chains = if params.images {
            ImageChains::new(tracer, &emitters, !bright.is_empty())
        } else {
            ImageChains::default()
        };
        // Far enough that no parallax is left in f32, near enough that nothing overflows.
        let far = (tracer.diagonal() * 1e4).max(1.0);
        let walls = Walls::new(scene, tracer.planes());
        Self { tracer, emitters, chains, bright, lenses: Lenses::default(), params, walls, far }
    }

    /// The tracer.
    pub fn tracer(&self) -> &'a Tracer<'a> {
        self.tracer
    }

    /// The area emitters.
    pub fn emitters(&self) -> &Emitters {
        &self.emitters
    }

    /// The image chains.
    pub fn chains(&self) -> &ImageChains {
        &self.chains
    }

    /// The bright sky.
    pub fn bright_sky(&self) -> &BrightSky {
        &self.bright
    }

    /// The lenses, once they are found.
    pub fn lenses(&self) -> &Lenses {
        &self.lenses
    }

    /// The parameters.
    pub fn params(&self) -> LightParams {
        self.params
    }

    /// Distance that stands for infinity.
    pub(crate) fn far(&self) -> f32 {
        self.far
    }

    /// Whether there is any area emitter or bright sky.
    pub fn has_sources(&self) -> bool {
        !(self.emitters.is_empty() && self.bright.is_empty())
    }

    /// Irradiance straight from sources, or through what lets light pass undeviated, by about `samples` shadow rays.
    pub fn direct(
        &self,
        receiver: &Receiver,
        samples: impl Into<Samples>,
        key: Key,
        scratch: &mut Scratch,
    ) -> SourceIrradiance {
        let image = Unfolded::straight(receiver);
        self.over(
            Standpoint { receiver, chain: None, image: &image },
            samples.into(),
            Rgb::ZERO,
            key,
            scratch,
        )
    }

    /// Irradiance straight from area emitters if nothing blocked it, channels added: how their light varies from place to place where
    /// their shadows do not, without a ray. W/m².
    pub fn open(&self, receiver: &Receiver, scratch: &mut Scratch) -> f32 {
        let image = Unfolded::straight(receiver);
        let at = Standpoint { receiver, chain: None, image: &image };
        self.gather(at, OPEN_SAMPLES, &mut scratch.found, &mut scratch.seeker);
        scratch.found.weight() as f32
    }

    /// Irradiance over all image chains, by about `samples` followed paths per chain that is seen; by fewer where that light
    /// is little beside what is `known` to arrive already.
    pub fn mirrored(
        &self,
        receiver: &Receiver,
        samples: impl Into<Samples>,
        known: Rgb,
        key: Key,
        scratch: &mut Scratch,
    ) -> SourceIrradiance {
        let samples = samples.into();
        let mut sum = SourceIrradiance::DARK;
        let (position, normal) = (receiver.position.as_dvec3(), receiver.normal.as_dvec3());
        let geometric = receiver.geometric.as_dvec3();
        let mut seen = std::mem::take(&mut scratch.chains);
        self.chains.seen_from(position, geometric, &mut seen);
        for &index in &seen {
            let chain = &self.chains.chains()[index as usize];
            if !chain.may_light(position, geometric) {
                continue;
            }
            let Some(image) = self.chains.unfold(chain, position, normal, geometric) else { continue };
            let key = key.child(index + 1);
            let at = Standpoint { receiver, chain: Some(chain), image: &image };
            let part = self.over(at, samples, known + sum.irradiance, key, scratch);
            sum.irradiance += part.irradiance;
            sum.unoccluded += part.unoccluded;
            sum.partial |= part.partial;
            sum.even &= part.even;
            sum.sampled |= part.sampled;
            sum.looked |= part.looked;
            sum.split += part.split;
            sum.doubt = sum.doubt.hypot(part.doubt);
        }
        scratch.chains = seen;
        sum
    }

    /// Irradiance by the broad emitters if nothing blocked them: the control variate of the hemisphere rays, which see
    /// what does block. Without a coat only: the contour formula knows none.
    pub fn broad_unoccluded(&self, receiver: &Receiver) -> Rgb {
        let (position, normal) = (receiver.position.as_dvec3(), receiver.normal.as_dvec3());
        let geometric = receiver.geometric.as_dvec3();
        self.emitters
            .broad()
            .iter()
            // By rounding a receiver may seem to lie before its own plane.
            .filter(|cell| {
                cell.plane != receiver.plane && cell.normal.dot(position - cell.point(0.0, 0.0)) > 0.0
            })
            .map(|cell| {
                let above = cell.polygon().clipped(geometric, geometric.dot(position));
                cell.radiance * contour::irradiance(position, normal, &above) as f32
            })
            .sum()
    }

    /// Irradiance at a standpoint beside what is `known`: samples are shared out by what each source sends, which makes the
    /// error of the sum least.
    fn over(
        &self,
        at: Standpoint,
        Samples { count: samples, calm, shadows, least, apart }: Samples,
        known: Rgb,
        key: Key,
        scratch: &mut Scratch,
    ) -> SourceIrradiance {
        let known_light = f64::from(known.element_sum());
        let mut result = SourceIrradiance::DARK;
        let mut tally = Tally::default();
        let mut found = std::mem::take(&mut scratch.found);
        // What blocks one of many blocks few others: they share half as many rays, and the search for them is cheaper.
        let shared = samples.div_ceil(2);
        self.gather(at, shared, &mut found, &mut scratch.seeker);
        let whole = found.weight();
        if whole > 0.0 {
            // What mirrors take of it all: what a pane reflects is worth few samples beside what is known.
            let reflected = at
                .chain
                .map_or(1.0, |chain| self.chains.reflectance(chain, found.towards(at.image.position)));
            let known = known_light / reflected;
            // Large pieces get strata of their own, small ones share.
            let mut leftover = 0.0;
            let targets = (found.pieces.len() + found.lamps.len()) as u32;
            let each = shadows.div_ceil(targets.max(2));
            // The brightest first: where these are hidden, what is left is all the light, and worth their samples.
            let mut order = std::mem::take(&mut scratch.order);
            order.clear();
            order.extend(found.pieces.iter().zip(0..).map(|(piece, index)| (piece.weight, index)));
            order.extend(found.lamps.iter().zip(LAMPS..).map(|(part, index)| (part.weight, index)));
            order.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
            // What arrives, as far as is known by now, and what else may.
            let mut all = whole + known;
            let worth = |all: f64| (HIDDEN * all).min(whole + known);
            for &(weight, index) in &order {
                let worth = worth(all).max(weight);
                let due = f64::from(samples) * weight / worth;
                let lamp = index.checked_sub(LAMPS).map(|lamp| lamp as usize);
                if lamp.is_none_or(|lamp| found.lamps[lamp].is_flat)
                    && found.is_shared(due * f64::from(apart))
                {
                    match lamp {
                        None => found.pieces[index as usize].shares = true,
                        Some(lamp) => found.lamps[lamp].shares = true,
                    }
                    leftover += weight;
                    continue;
                }
                let part = lamp.map(|lamp| &found.lamps[lamp]);
                let budget = |count: u32| Budget {
                    count: match count {
                        ..2 if at.chain.is_some() => least,
                        _ => count.clamp(LOOK, samples.max(LOOK)).next_power_of_two(),
                    },
                    calm,
                    shadows: if weight < MINOR * worth { 0 } else { each },
                };
                let (target, budget) = match part {
                    None => {
                        let piece = &found.pieces[index as usize];
                        (Target::piece(piece, &found.corners, &self.emitters), budget(due.round() as u32))
                    }
                    Some(part) => {
                        let budget = match due.ceil() as u32 {
                            ..2 if !found.is_few() => Budget { count: 1, calm, shadows: 0 },
                            count => budget(count),
                        };
                        (Target::lamp(part, &found.corners, &self.emitters), budget)
                    }
                };
                let sent = self.strata(at, &target, budget, key.child(index), scratch, &mut tally);
                result.irradiance += sent;
                result.unoccluded += target.irradiance();
                tally.next_target(target.irradiance().element_sum());
                all = all - weight + f64::from(sent.element_sum()) / reflected;
            }
            scratch.order = order;
            let total = leftover + found.groups();
            if total > 0.0 {
                tally.mixed();
                let share = f64::from(samples) / worth(all).max(total);
                let part = self.shared(at, &found, (total, share, shared), key, scratch, &mut tally);
                result.irradiance += part.irradiance;
                result.unoccluded += part.unoccluded;
                tally.next(total as f32);
            }
        }
        scratch.found = found;
        if !self.bright.is_empty() {
            tally.mixed();
            let part = self.bright_part(at, samples, known_light, key, scratch, &mut tally);
            result.irradiance += part.irradiance;
            result.unoccluded += part.unoccluded;
            tally.next(part.unoccluded.element_sum());
        }
        result.partial = tally.is_partial();
        result.even = tally.is_even();
        result.sampled = tally.sampled;
        result.looked = tally.looked;
        result.split = tally.split;
        result.doubt = tally.doubt();
        result
    }
}
