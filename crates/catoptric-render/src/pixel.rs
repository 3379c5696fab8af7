//! One eye ray: the split driver over S*, and what is read where it meets diffuse surfaces.

use std::f32::consts::PI;

use glam::{Vec2, Vec3};

use catoptric_light::irradiance::Samples;
use catoptric_light::{Lights, Receiver, irradiance};
use catoptric_scene::quantity::LUMINANCE;
use catoptric_scene::{Rgb, Scene};
use catoptric_solution::{Solution, Term};
use catoptric_trace::sequence::Key;
use catoptric_trace::walk::split::{self, Seen, Sight, SplitParams};
use catoptric_trace::{Event, Hit, MediumStack, Ray};

use crate::bundles::{Leg, Legs};
use crate::direct::{Shadows, Wanted, in_proportion};
use crate::irradiance_cache::{Around, Place, Record, Request};
use crate::layers::{Kept, LightLayer};
use crate::lines::{self, Footprint};
use crate::needs::DARK;
use crate::resolution::Resolution;

/// What the eye sees first along a ray, for the data layers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FirstHit {
    /// Distance from the eye, metres; infinite for the sky.
    pub depth: f32,
    /// Unit shading normal towards the eye.
    pub normal: Vec3,
    /// Base reflectance there (diffuse and mirror).
    pub albedo: Rgb,
    /// Surface id + 1, 0 for the sky.
    pub surface: u32,
}

impl FirstHit {
    /// Looks it up. `None` is the sky.
    pub fn of(scene: &Scene, hit: Option<&Hit>) -> Self {
        let Some(hit) = hit else {
            return Self { depth: f32::INFINITY, normal: Vec3::ZERO, albedo: Rgb::ZERO, surface: 0 };
        };
        let side = if hit.back { -1.0 } else { 1.0 };
        let point = scene.surface_point(hit.triangle, hit.at);
        let map = scene.material_of(hit.triangle).normal_texture;
        Self {
            depth: hit.t,
            normal: scene.bent_normal(hit.triangle, hit.at, map) * side,
            albedo: point.diffuse + point.mirror,
            surface: scene.triangles()[hit.triangle.index()].surface.0 + 1,
        }
    }
}

/// One sample of a pixel, or the pixel that is made of some.
#[derive(Clone, Copy, Debug)]
pub struct Sample<L> {
    /// Its light.
    pub light: L,
    /// What is seen where nothing blocks sources that were asked by shadow rays: brightness without the noise of penumbrae.
    pub open: Rgb,
    /// Some of these rays were blocked and some were not.
    pub penumbra: bool,
    /// Variance of its luminance by these rays, as far as one difference tells.
    pub grain: f32,
    /// Share of the pixel that lines along the edges of the display mesh cover, if they were asked for.
    pub lines: f32,
    /// Samples on a grid of its own that a pixel is made of; none if it is the ray through its centre.
    pub samples: u32,
    /// Sum of the squared luminances of what they count.
    pub squares: f32,
    /// Sums of these luminances on either side of a lamp's outline that crosses the pixel, by which it is stratified; `None` if none does.
    pub sides: Option<[f32; 2]>,
    /// Where the pixel is made of samples, what the ray through its centre showed, as displayed.
    pub centre: Rgb,
    /// Neighbours towards which samples found what centres do not show.
    pub between: Neighbours,
    /// Hash of what was met along all but the faintest branches: samples that differ in it straddle an edge.
    pub trail: u32,
    /// Hash of what is curved and reflects or refracts along its bright branches, 0 if nothing is: beside a rim the whole room is shown within
    /// a pixel, beside the border of what is seen through it (which is in the trail) two things are.
    pub rim: u32,
}

impl<L: Kept> Sample<L> {
    /// What is there before a ray is shot.
    pub(crate) const NOTHING: Self = Self {
        light: L::DARK,
        open: Rgb::ZERO,
        penumbra: false,
        grain: 0.0,
        lines: 0.0,
        samples: 0,
        squares: 0.0,
        sides: None,
        centre: Rgb::ZERO,
        between: Neighbours::NONE,
        trail: 0,
        rim: 0,
    };

    /// Goes over to another sample of the same place, by a share: its light and what shadow rays tell.
    pub(crate) fn fade(&mut self, other: Self, share: f32) {
        let Self { mut light, open, penumbra, grain, .. } = other;
        self.light.scale(1.0 - share);
        light.scale(share);
        self.light.accumulate(&light);
        self.open = self.open.lerp(open, share);
        self.penumbra |= penumbra;
        self.grain = self.grain * (1.0 - share).powi(2) + grain * share.powi(2);
    }

    /// Standard deviation of the samples that a pixel is made of, relative to its displayed luminance where `exposure` is
    /// the mean luminance of the picture.
    pub(crate) fn deviation(&self, exposure: f32) -> f32 {
        if self.samples < 2 {
            return 0.0;
        }
        let (count, mean) = (self.samples as f32, self.light.beauty().dot(LUMINANCE));
        // Half of the samples are on each side.
        let (between, means) = match self.sides {
            None => (count * mean * mean, 1.0),
            Some([inside, outside]) => ((inside * inside + outside * outside) / (0.5 * count), 2.0),
        };
        let variance = (self.squares - between).max(0.0) / (count - means).max(1.0);
        variance.sqrt() / (mean + DARK * exposure)
    }

    /// Standard error of the pixel, by its own samples, likewise.
    pub(crate) fn error(&self, exposure: f32) -> f32 {
        self.deviation(exposure) / (self.samples.max(1) as f32).sqrt()
    }
}

/// Some of the eight neighbours of a pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Neighbours(u8);

impl Neighbours {
    /// None.
    pub(crate) const NONE: Self = Self(0);

    /// Adds those on whose side of the centre a place in the pixel's unit square lies.
    pub(crate) fn add(&mut self, place: Vec2) {
        let [x, y] = [place.x, place.y].map(|v| usize::from(v >= 0.5));
        // Beside, below or above, and across the corner: by the bits of `STEPS`.
        self.0 |= [[0b0000_1011, 0b0001_0110], [0b0110_1000, 0b1101_0000]][y][x];
    }

    /// Their indices in a picture of so many columns and rows.
    pub(crate) fn of(self, index: usize, width: usize, height: usize) -> impl Iterator<Item = usize> {
        let (x, y) = ((index % width) as i64, (index / width) as i64);
        let steps = STEPS.into_iter().enumerate().filter(move |(bit, _)| self.0 >> bit & 1 == 1);
        let places = steps.map(move |(_, (dx, dy))| (x + dx, y + dy));
        let inside =
            move |p: &(i64, i64)| (0..width as i64).contains(&p.0) && (0..height as i64).contains(&p.1);
        places.filter(inside).map(move |(x, y)| y as usize * width + x as usize)
    }
}

/// From a pixel to its neighbours, row by row.
const STEPS: [(i64, i64); 8] = [(-1, -1), (0, -1), (1, -1), (-1, 0), (1, 0), (-1, 1), (0, 1), (1, 1)];

/// Source light along an eye path.
#[derive(Debug, Default)]
pub(crate) struct Answers {
    pub(crate) light: irradiance::Scratch,
    /// What the last sample left to be found later.
    pub(crate) requests: Vec<Request>,
    /// What samples of the present pixel found.
    pub(crate) own: Vec<Record>,
}

/// Reused buffers of one thread.
#[derive(Debug, Default)]
pub struct Scratch {
    pub(crate) sources: Answers,
    waiting: split::Waiting,
    /// Of the last sample, if they are asked for.
    pub(crate) legs: Option<Legs>,
}

impl Scratch {
    /// … with the legs of the last sample.
    pub(crate) fn noting_legs() -> Self {
        Self { legs: Some(Legs::default()), ..Self::default() }
    }
}

/// What a view needs.
pub struct Eye<'a> {
    /// Sources, for punctual lights per pixel.
    pub lights: &'a Lights<'a>,
    /// Irradiance.
    pub solution: &'a Solution,
    /// Where the light of sources is to be evaluated, if that is not everywhere.
    pub(crate) resolution: Option<&'a Resolution>,
    /// Whether that of the direct and of the mirrored term is to be evaluated wherever the eye sees shadows, whatever that says.
    pub(crate) everywhere: [bool; 2],
    /// Limits.
    pub params: SplitParams,
}

impl Eye<'_> {
    /// Traces one eye ray, sample `index` of those with the same `key`. With a `footprint`, finds the lines of the display
    /// mesh, too.
    pub(crate) fn sample<L: Kept>(
        &self,
        origin: Vec3,
        direction: Vec3,
        footprint: Option<Footprint>,
        query: Query,
        (key, index): (Key, u32),
        scratch: &mut Scratch,
    ) -> Sample<L> {
        let tracer = self.lights.tracer();
        let scene = tracer.scene();
        let (mut light, mut first) = (L::DARK, None);
        let mut asked =
            Asked { query, key: key.child(index).child(SHADOWS), count: 0, shadows: Shadows::default() };
        scratch.sources.requests.clear();
        let mut lines = 0.0;
        if let Some(legs) = &mut scratch.legs {
            *legs = Legs::default();
        }
        let (mut trail, mut rim) = (0x811c_9dc5_u32, 0);
        split::trace(
            tracer,
            Ray::free(origin, direction),
            MediumStack::AIR,
            (key, index),
            &self.params,
            &mut scratch.waiting,
            |hit| first = Some(*hit),
            |sight| match sight {
                Sight::Sky { origin, direction, throughput, events, way } => {
                    if let Some(legs) = scratch.legs.as_mut().filter(|_| way.bends()) {
                        let strength = throughput.dot(LUMINANCE);
                        legs.note(Leg {
                            origin,
                            direction,
                            length: f32::INFINITY,
                            strength,
                            emission: 0.0,
                            way,
                        });
                    }
                    if throughput.max_element() > FAINT {
                        trail = step(trail, 0, events);
                    }
                    if let Some(sky) = scene.sky() {
                        let radiance = throughput * sky.radiance(direction).0;
                        light.add(LightLayer::Emission, events > 0, radiance);
                    }
                }
                Sight::Surface(seen) => {
                    let surface = scene.triangles()[seen.hit.triangle.index()].surface.0;
                    let smooth = scene.is_smooth(seen.hit.triangle);
                    let facet =
                        if smooth { 1 << 31 | surface } else { tracer.planes().of(seen.hit.triangle).0 + 1 };
                    if seen.throughput.max_element() > FAINT {
                        trail = step(trail, facet, seen.events);
                        if smooth
                            && seen.throughput.max_element() > BRIGHT
                            && scene.material_of(seen.hit.triangle).may_be_specular()
                        {
                            rim = step(rim, facet, seen.events);
                        }
                    }
                    // Outlines over planar mirrors alone are known, and what a pane or a hole lets pass goes on.
                    let ends = || seen.interaction.branches().iter().all(|b| b.event != Event::Undeviated);
                    if let Some(legs) = scratch.legs.as_mut().filter(|_| seen.way.bends() && ends()) {
                        let ior = tracer.media().ior(seen.media.current());
                        let weight = seen.throughput / (ior * ior);
                        legs.note(Leg {
                            origin: seen.position - seen.direction * seen.hit.t,
                            direction: seen.direction,
                            length: seen.hit.t,
                            strength: weight.dot(LUMINANCE),
                            emission: (weight * seen.interaction.emission.0).dot(LUMINANCE),
                            way: seen.way,
                        });
                    }
                    self.see(&seen, facet, &mut light, &mut asked, &mut scratch.sources);
                    if let Some(footprint) = footprint {
                        lines += lines::coverage(&self.solution.mesh, &seen, footprint);
                    }
                }
            },
        );
        if let Some(hit) = &first {
            light.meet(hit);
        }
        let Shadows { blocked, penumbra, grain } = asked.shadows;
        Sample {
            open: light.beauty() + blocked,
            light,
            penumbra,
            grain,
            lines,
            samples: 0,
            squares: 0.0,
            sides: None,
            centre: Rgb::ZERO,
            between: Neighbours::NONE,
            trail,
            rim,
        }
    }

    /// Adds what a surface sends to the eye.
    fn see<L: Kept>(&self, seen: &Seen, facet: u32, light: &mut L, asked: &mut Asked, answers: &mut Answers) {
        let tracer = self.lights.tracer();
        let interaction = seen.interaction;
        let material = tracer.scene().material_of(seen.hit.triangle);
        let through = seen.events > 0;
        // The eye is in air; light that starts in a denser medium is thinned by n².
        let ior = tracer.media().ior(seen.media.current());
        let weight = seen.throughput / (ior * ior);
        if material.unlit {
            let point = tracer.scene().surface_point(seen.hit.triangle, seen.hit.at);
            light.add(LightLayer::Emission, through, weight * point.tint * point.opacity);
            return;
        }
        light.add(LightLayer::Emission, through, weight * interaction.emission.0);
        if interaction.receives <= 0.0 {
            return;
        }
        let send = weight * (interaction.receives / PI);
        for (share, side) in [
            (interaction.reflectance, interaction.side),
            (interaction.transmittance, interaction.side.opposite()),
        ] {
            if share.max_element() <= 0.0 {
                continue;
            }
            let send = send * share;
            let is_asked = asked.query.samples().is_some();
            let mut wanted =
                if is_asked && self.resolution.is_none() { Wanted::ALL } else { Wanted::NOTHING };
            let (mut arriving, mut from_sources) = (0.0, [0.0; 2]);
            if let Some(at) = self.solution.mesh.locate(seen.hit.triangle, side, seen.position) {
                if let Some(resolution) = self.resolution.filter(|_| is_asked) {
                    let stored =
                        [Term::Direct, Term::Mirrored].map(|term| self.solution.irradiance(term, &at).0);
                    wanted = resolution.wanted(&at, stored, seen, self.everywhere);
                }
                for (term, layer) in [
                    (Term::Direct, LightLayer::Direct),
                    (Term::Mirrored, LightLayer::Mirrored),
                    (Term::Caustic, LightLayer::Caustic),
                    (Term::Indirect, LightLayer::Indirect),
                ] {
                    let share = wanted.of(term);
                    let stored = || self.solution.irradiance(term, &at).0;
                    let beside = || self.solution.gathered(term, &at).0;
                    let read = if share <= 0.0 {
                        stored()
                    } else if share >= 1.0 {
                        beside()
                    } else {
                        stored().lerp(beside(), share)
                    };
                    light.add(layer, through, send * read);
                }
                if !wanted.is_nothing() {
                    for term in Term::ALL {
                        let stored = self.solution.irradiance(term, &at).0;
                        arriving += stored.dot(LUMINANCE);
                    }
                    from_sources = [Term::Direct, Term::Mirrored].map(|term| {
                        let stored = || self.solution.irradiance(term, &at).0;
                        let beside = || self.solution.gathered(term, &at).0;
                        if wanted.of(term) > 0.0 { (stored() - beside()).dot(LUMINANCE) } else { 0.0 }
                    });
                }
            }
            if !wanted.is_nothing() || !tracer.scene().lights().is_empty() {
                let mut receiver = Receiver::on(tracer, seen.hit.triangle, side, seen.hit.at);
                receiver.position = seen.position;
                receiver.media = seen.media;
                let as_stored = receiver.normal;
                let map = material.normal_texture;
                if map.is_some() {
                    let bent = tracer.scene().bent_normal(seen.hit.triangle, seen.hit.at, map);
                    receiver.normal = side.orient(bent);
                }
                let punctual = self.lights.punctual(&receiver, &mut answers.light);
                light.add(LightLayer::Direct, through, send * punctual.direct);
                light.add(LightLayer::Mirrored, through, send * punctual.mirrored);
                let Some(samples) = asked.query.samples().filter(|_| !wanted.is_nothing()) else { continue };
                // Beside what the mesh holds, bent normals would be seen as a patch.
                let mut pixel = 0.0;
                if let Some(resolution) = self.resolution {
                    receiver.normal = as_stored;
                    pixel = resolution.pixel_at(seen);
                }
                let terms = [wanted.direct, wanted.mirrored].map(|share| share > 0.0);
                let material = tracer.scene().material_id_of(seen.hit.triangle);
                asked.count += 1;
                let request = Request {
                    place: Place { facet, material, way: seen.way, side, terms },
                    receiver,
                    samples: in_proportion(samples, send),
                    key: asked.key.child(asked.count),
                    wanted,
                    send,
                    through,
                    arriving,
                    stored: from_sources,
                    direction: seen.direction,
                    pixel,
                };
                let found = match asked.query {
                    Query::Defer(_) => {
                        answers.requests.push(request);
                        continue;
                    }
                    Query::Recall(_, around) => around.recall(&answers.own, &request).unwrap_or_else(|| {
                        let found = request.evaluate(self.lights, &mut answers.light);
                        Record::of(&request, &found).add_to(&mut answers.own);
                        found
                    }),
                    Query::Stored | Query::Evaluate(_) => request.evaluate(self.lights, &mut answers.light),
                };
                asked.shadows.add(light, (send, through), wanted, &found);
            }
        }
    }
}

/// How the light of sources is got along an eye path.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Query<'a> {
    /// What the mesh holds is read.
    Stored,
    /// It is evaluated where that is wanted, by about so many shadow rays.
    Evaluate(Samples),
    /// It is left to be found later.
    Defer(Samples),
    /// What is known around a pixel is taken, where that agrees, or it is evaluated.
    Recall(Samples, Around<'a>),
}

impl Query<'_> {
    fn samples(&self) -> Option<Samples> {
        match *self {
            Self::Stored => None,
            Self::Evaluate(samples) | Self::Defer(samples) | Self::Recall(samples, _) => Some(samples),
        }
    }
}

/// What is asked along an eye path.
struct Asked<'a> {
    query: Query<'a>,
    key: Key,
    count: u32,
    shadows: Shadows,
}

/// Branches of less throughput draw no edges: what is bright enough to be seen through them differs in radiance.
const FAINT: f32 = 0.03;

/// Rims in branches of less throughput are edges as others: what they show of the room is in proportion.
const BRIGHT: f32 = 0.1;

/// Keys of shadow rays are children of a sample's key with this number: the pixel's own use small ones.
const SHADOWS: u32 = 1 << 16;

/// One step of the trail's hash (FNV-1a).
#[inline]
fn step(trail: u32, facet: u32, events: u32) -> u32 {
    let mixed = (trail ^ facet).wrapping_mul(0x0100_0193);
    (mixed ^ events).wrapping_mul(0x0100_0193)
}
