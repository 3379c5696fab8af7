//! Light of the sources at the vertices of the display mesh: sampled where refinement asks, then fitted.

use std::sync::{Mutex, RwLock};

use rayon::prelude::*;

use catoptric_light::irradiance::{
    LensBeside, LensLight, LensSeen, Samples, Scratch, SkyView, Skylight, SourceIrradiance,
};
use catoptric_light::{Lights, Receiver};
use catoptric_scene::{Cancelled, Progress, Rgb};
use catoptric_trace::sequence::{Key, Purpose, triangle_point};

use crate::JOB;
use crate::allocation::HIDDEN_TRUST;
use crate::detail::{Detail, Details};
use crate::display::Displayed;
use crate::draft::Draft;
use crate::field::{Field, Found, Known, Look, mean};
use crate::fit::{FitMesh, FitParams, FitSample, FitTerm, fit, variance_of_halves};
use crate::inset::drawn_inside;
use crate::sky_shares::SkyShares;
use crate::solve::SolveParams;

/// Light of sources at a vertex.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SourceLight {
    pub(crate) direct: Rgb,
    pub(crate) mirrored: Rgb,
    pub(crate) punctual: Rgb,
    /// The dim sky, straight.
    pub(crate) sky: Rgb,
    /// Lamps in lenses.
    pub(crate) lens: Rgb,
    /// No source is partly blocked, as far as the samples tell.
    pub(crate) calm: bool,
    /// Of some source fewer than the usual samples were taken: in calm surroundings they agreed.
    pub(crate) looked: bool,
    /// Times the usual samples that it took.
    pub(crate) times: u32,
    /// Shadow rays that it took.
    pub(crate) rays: u32,
    /// Variance of direct and of mirrored light, of the sky's and of that in lenses, channels added, as far as the samples tell; that of
    /// punctual lights has none.
    pub(crate) noise: [f32; TERMS],
}

impl SourceLight {
    pub(crate) fn sum(&self) -> Rgb {
        self.terms().into_iter().sum()
    }

    /// Between two vertices, without rays of its own.
    pub(crate) fn mean(a: Self, b: Self) -> Self {
        Self {
            direct: (a.direct + b.direct) * 0.5,
            mirrored: (a.mirrored + b.mirrored) * 0.5,
            punctual: (a.punctual + b.punctual) * 0.5,
            sky: (a.sky + b.sky) * 0.5,
            lens: (a.lens + b.lens) * 0.5,
            ..Self::default()
        }
    }

    /// What is fitted, term by term.
    fn terms(&self) -> [Rgb; TERMS] {
        [self.direct, self.mirrored, self.sky, self.lens, self.punctual]
    }
}

/// Terms of the light of sources that are fitted.
const TERMS: usize = 5;

/// What a vertex has seen that helps others: of the sky, and in each lens.
#[derive(Clone, Debug, Default)]
struct Views {
    sky: Option<SkyView>,
    lenses: Vec<LensSeen>,
}

/// The field that refinement looks at while it keeps what was found.
pub(crate) struct SourceField<'a> {
    lights: &'a Lights<'a>,
    params: &'a SolveParams,
    sky_shares: SkyShares,
    /// Buffers that no thread uses just now.
    scratch: Mutex<Vec<Scratch>>,
    found: Mutex<Vec<(u32, SourceLight)>>,
    /// What vertices have seen since the last round.
    fresh: Mutex<Vec<(u32, Views)>>,
    /// … and each vertex in the rounds before.
    views: RwLock<Vec<Option<Views>>>,
}

impl<'a> SourceField<'a> {
    /// For a base mesh with about such edges, metres.
    pub(crate) fn new(lights: &'a Lights<'a>, params: &'a SolveParams, draft: &Draft, spacing: f32) -> Self {
        Self {
            lights,
            params,
            sky_shares: SkyShares::new(draft, spacing),
            scratch: Mutex::default(),
            found: Mutex::default(),
            fresh: Mutex::default(),
            views: RwLock::default(),
        }
    }

    /// What was found, by vertex, of which there are `count`, and which vertices were asked for.
    pub(crate) fn collect(&self, count: usize) -> (Vec<SourceLight>, Vec<bool>) {
        let mut known = vec![SourceLight::default(); count];
        let mut asked = vec![false; count];
        if let Ok(mut found) = self.found.lock() {
            for (vertex, light) in found.drain(..) {
                known[vertex as usize] = light;
                asked[vertex as usize] = true;
            }
        }
        (known, asked)
    }

    /// Skylight beside that of `lamps`, by a share of so many samples; `around`: the vertices that are nearest.
    fn skylight(
        &self,
        receiver: &Receiver,
        (samples, share): (u32, f32),
        lamps: Rgb,
        around: &[u32],
        key: Key,
        scratch: &mut Scratch,
    ) -> Skylight {
        let beside = self.views.read().ok().and_then(|views| {
            let skies = around.iter().filter_map(|&v| views.get(v as usize)?.as_ref()?.sky);
            SkyView::beside(receiver.normal, skies)
        });
        let samples = ((samples as f32 * share) as u32).max(1);
        self.lights.skylight(receiver, samples, lamps, beside.as_ref(), key.child(SKY), scratch)
    }

    /// Light of lamps in lenses; `around`: the vertices that are nearest, and whether the receiver lies between them.
    fn through_lenses(
        &self,
        receiver: &Receiver,
        (around, between): (&[u32], bool),
        seen: &mut Vec<LensSeen>,
        key: Key,
        scratch: &mut Scratch,
    ) -> LensLight {
        let beside = |lens: usize| {
            let views = self.views.read();
            let at = |&v: &u32| views.as_ref().ok()?.get(v as usize)?.as_ref()?.lenses.get(lens).copied();
            LensBeside::of(around.iter().filter_map(at), between)
        };
        let samples = self.params.shadow_rays;
        self.lights.through_lenses(receiver, samples, beside, seen, key.child(LENS), scratch)
    }

    /// Light of the sources, and what is seen of the sky. Where the surroundings are calm few samples do, unless they see that it is not.
    fn light(
        &self,
        receiver: &Receiver,
        (known, between): (Known, bool),
        (look, sky_share): (Look, f32),
        key: Key,
    ) -> (SourceLight, Views) {
        let mut scratch = self.take_scratch();
        let mut light = SourceLight { calm: true, times: look.times(), ..SourceLight::default() };
        if self.lights.has_sources() {
            let found = area_sources(self.lights, receiver, self.params.shadow_rays, look, key, &mut scratch);
            [light.direct, light.mirrored] = found.map(|f| f.irradiance);
            [light.noise[0], light.noise[1]] = found.map(|f| variance_of_halves(f.split));
            light.calm = found.iter().all(|f| f.even);
            light.looked = found.iter().any(|f| f.looked);
        }
        let mut views = Views::default();
        if self.lights.has_skylight() {
            let lamps = light.direct + light.mirrored;
            let sky = match known {
                Known::Nothing => {
                    let closely = sky_share > CLOSE_SHARE;
                    Some(self.lights.look_at_sky(receiver, closely, key.child(SKY + 1), &mut scratch))
                }
                Known::NotYet => None,
                Known::At(around) => Some(self.skylight(
                    receiver,
                    (self.params.shadow_rays, sky_share),
                    lamps,
                    around,
                    key,
                    &mut scratch,
                )),
            };
            light.sky = sky.map_or(Rgb::ZERO, |sky| sky.irradiance);
            light.noise[2] = sky.map_or(0.0, |sky| sky.variance);
            light.calm &= sky.is_some_and(|sky| sky.even);
            views.sky = sky.map(|sky| sky.view);
        }
        if !self.lights.lenses().is_empty() {
            let around = match known {
                Known::Nothing => Some((&[][..], false)),
                Known::NotYet => None,
                Known::At(around) => Some((around, between)),
            };
            let lens = around
                .map(|around| self.through_lenses(receiver, around, &mut views.lenses, key, &mut scratch));
            light.lens = lens.map_or(Rgb::ZERO, |lens| lens.irradiance);
            light.noise[3] = lens.map_or(0.0, |lens| lens.variance);
            light.calm &= lens.is_some_and(|lens| lens.even);
        }
        let punctual = self.lights.punctual(receiver, &mut scratch);
        light.punctual = punctual.direct + punctual.mirrored;
        light.rays = scratch.rays as u32;
        self.put_back(scratch);
        (light, views)
    }

    fn take_scratch(&self) -> Scratch {
        let mut scratch = self.scratch.lock().ok().and_then(|mut all| all.pop()).unwrap_or_default();
        scratch.rays = 0;
        scratch
    }

    fn put_back(&self, scratch: Scratch) {
        if let Ok(mut all) = self.scratch.lock() {
            all.push(scratch);
        }
    }
}

/// Direct and mirrored light of area sources by `count` shadow rays per chain, by fewer where the surroundings are `calm` and
/// it turns out so here.
fn area_sources(
    lights: &Lights,
    receiver: &Receiver,
    count: u32,
    look: Look,
    key: Key,
    scratch: &mut Scratch,
) -> [SourceIrradiance; 2] {
    let samples = Samples { calm: look == Look::Calm, ..Samples::from(count * look.times()) };
    let direct = lights.direct(receiver, samples, key, scratch);
    let mirrored = lights.mirrored(receiver, samples, direct.irradiance, key.child(1), scratch);
    [direct, mirrored]
}

impl Field for SourceField<'_> {
    fn evaluate(&self, draft: &Draft, vertex: u32, known: Known, look: Look) -> Found {
        let receiver = draft.receiver(self.lights.tracer(), vertex);
        let key = Key::new(self.params.seed, Purpose::Emitter, u64::from(vertex));
        let between = !matches!(known, Known::At(around) if around.contains(&vertex));
        let (light, views) =
            self.light(&receiver, (known, between), (look, self.sky_shares.at(draft, vertex)), key);
        if self.learns()
            && let Ok(mut fresh) = self.fresh.lock()
        {
            fresh.push((vertex, views));
        }
        if let Ok(mut found) = self.found.lock() {
            found.push((vertex, light));
        }
        let variance = light.noise[0] + light.noise[1];
        Found { value: light.sum(), calm: light.calm, looked: light.looked, variance, times: look.times() }
    }

    /// Shadows of punctual lights have edges. Those of area lights are slopes as wide as the elements beside them, or nearly: there it
    /// makes no difference that can be measured.
    fn has_edges(&self) -> bool {
        !self.lights.tracer().scene().lights().is_empty()
    }

    /// As the sources send if nothing blocked them.
    fn foretold(&self, draft: &Draft, vertex: u32) -> Option<f32> {
        let mut scratch = self.take_scratch();
        let open = self.lights.open(&draft.receiver(self.lights.tracer(), vertex), &mut scratch);
        self.put_back(scratch);
        Some(open)
    }

    fn learns(&self) -> bool {
        self.lights.has_skylight() || !self.lights.lenses().is_empty()
    }

    fn settle(&self) {
        if let (Ok(mut fresh), Ok(mut all)) = (self.fresh.lock(), self.views.write()) {
            for (vertex, views) in fresh.drain(..) {
                let count = all.len().max(vertex as usize + 1);
                all.resize(count, None);
                all[vertex as usize] = Some(views);
            }
        }
    }

    fn evaluate_inside(&self, draft: &Draft, leaf: u32, look: Look) -> Rgb {
        let receiver = draft.receiver_in_leaf(self.lights.tracer(), leaf, [1.0 / 3.0; 3]);
        let key = Key::new(self.params.seed, Purpose::Emitter, u64::from(leaf) | 1 << 44);
        let leaf = &draft.leaves[leaf as usize];
        let share = self.sky_shares.beside(draft.longest_edge(leaf));
        self.light(&receiver, (Known::At(&leaf.vertices), true), (look, share), key).0.sum()
    }
}

/// Share below which vertices are so near to each other that coarser looks do.
const CLOSE_SHARE: f32 = 0.5;

/// Tells the keys of skylight from those of other sources.
const SKY: u32 = 1 << 30;
/// … and those of light in lenses.
const LENS: u32 = 1 << 29;

/// Rounds in which the elements that hold a glint are halved: to a 64th of a base triangle.
const GLINT_ROUNDS: u32 = 6;

/// Splits the elements that light over small mirrors falls on to the width of that light, where no vertex may see it: to edges
/// of `shortest` metres at most, by `room` triangles at most. `base` shows the base mesh.
pub(crate) fn split_glints(
    lights: &Lights,
    base: &Displayed,
    draft: &mut Draft,
    seed: u32,
    shortest: f32,
    room: usize,
) {
    let details = lights.glints(seed).into_iter().filter_map(|glint| {
        let position = glint.position.as_vec3();
        let located = base.mesh.locate(glint.triangle, glint.side, position)?;
        let root = base.roots[located.element as usize];
        Some(Detail { root, position, size: glint.width as f32 })
    });
    let details = Details::new(details.collect());
    let limit = draft.leaves.len() + room;
    for _ in 0..GLINT_ROUNDS {
        let marks = details.marks(draft, 1.0, shortest, limit.saturating_sub(draft.leaves.len()));
        if marks.is_empty() {
            return;
        }
        draft.split(lights.tracer(), &marks);
    }
}

/// Relative difference between the least and the most light around an element below which its edges tell enough.
const EVEN: f32 = 0.2;

/// Refined elements get all points down to this share of the area of a base triangle.
const FINE: f32 = 0.01;

/// Where light is sampled for the fit.
struct FitPoints {
    /// Points inside elements, …
    inside: Vec<FitSample>,
    /// … and how closely to look there.
    looks: Vec<Look>,
    /// The middles of edges that refinement has looked at and left whole, and their vertices.
    middles: Vec<(FitSample, u32)>,
}

impl SourceField<'_> {
    /// Replaces the point samples of sources, sky and lenses by their least-squares fit. `asked`: the vertices with a sample of their own.
    pub(crate) fn fit(
        &self,
        draft: &Draft,
        displayed: &Displayed,
        hidden: &[bool],
        asked: &[bool],
        sources: &mut [SourceLight],
        spacing: f32,
        progress: &dyn Progress,
    ) -> Result<(), Cancelled> {
        let is_dark = !self.lights.has_sources() && !self.lights.has_skylight();
        if is_dark && self.lights.tracer().scene().lights().is_empty() {
            return Ok(());
        }
        let FitPoints { inside: mut samples, looks, middles } =
            self.fit_points(draft, displayed, asked, sources, spacing);
        let mut found = self.light_inside(draft, displayed, &samples, &looks, progress);
        samples.extend(middles.iter().map(|m| m.0));
        found.extend(middles.iter().map(|m| sources[m.1 as usize].terms()));
        if progress.is_cancelled() {
            return Err(Cancelled);
        }
        let params = FitParams { smoothing: self.params.fit.smoothing * spacing, ..self.params.fit };
        let trust: Vec<f32> =
            displayed.origin.iter().map(|&v| if hidden[v as usize] { HIDDEN_TRUST } else { 1.0 }).collect();
        let parts = FitMesh::new(&displayed.mesh);
        let fitted: Vec<Vec<Rgb>> = (0..TERMS)
            .into_par_iter()
            .map(|term| {
                let values: Vec<Rgb> = found.iter().map(|f| f[term]).collect();
                let prior: Vec<Rgb> =
                    displayed.origin.iter().map(|&v| sources[v as usize].terms()[term]).collect();
                if prior.iter().chain(&values).all(|v| *v == Rgb::ZERO) {
                    return prior;
                }
                let noise: Vec<f32> =
                    displayed.origin.iter().map(|&v| sources[v as usize].noise[term]).collect();
                let term = FitTerm { values: &values, prior: &prior };
                fit(&parts, &samples, &[term], &trust, &noise, &params).remove(0)
            })
            .collect();
        for (index, &v) in displayed.origin.iter().enumerate() {
            let source = &mut sources[v as usize];
            [source.direct, source.mirrored, source.sky, source.lens, source.punctual] =
                std::array::from_fn(|term| fitted[term][index]);
        }
        Ok(())
    }

    /// Small elements of finely tessellated surfaces share: as many points as their area is worth. Refined ones are small because light
    /// varies there: they get all, unless they are tiny.
    ///
    /// Middles of edges that refinement knows are samples already: with its three, an element knows all quadratic light (the midpoint
    /// rule). Where light is uneven, points inside are asked besides. One or two middles are none, and those of halved edges that were then
    /// left whole for being short are none: refinement has chosen them. Along the border of a shadow more are left on the side of the light, where
    /// the same difference is less of what is there. (With them the floor below a window had 0.3 % too much light.)
    fn fit_points(
        &self,
        draft: &Draft,
        displayed: &Displayed,
        asked: &[bool],
        sources: &[SourceLight],
        spacing: f32,
    ) -> FitPoints {
        let (params, mesh) = (self.params, &displayed.mesh);
        let whole = 0.5 * spacing * spacing;
        let sums: Vec<Rgb> = sources.iter().map(SourceLight::sum).collect();
        let floor = (params.sources.floor * mean(draft, &sums)).max(f32::MIN_POSITIVE);
        // Of an edge as short as this a difference is left alone that is as much as all light there.
        let blur = params.sources.blur * spacing;
        let mut points = FitPoints { inside: Vec::new(), looks: Vec::new(), middles: Vec::new() };
        for element in 0..mesh.elements.len() as u32 {
            let corners = mesh.elements[element as usize].vertices.map(|v| displayed.origin[v as usize]);
            let area = mesh.area(element);
            let key = Key::new(params.seed, Purpose::ElementPoint, u64::from(element));
            let leaf = &draft.leaves[displayed.leaves[element as usize] as usize];
            let is_refined = leaf.level > 0;
            let full = if is_refined { FINE * whole } else { whole };
            let expected = params.fit_points as f32 * (area / full).min(1.0);
            let count = (expected + key.uniform(0)).floor() as u32;
            let middles: [Option<u32>; 3] = std::array::from_fn(|k| {
                draft.known_midpoint(corners[k], corners[(k + 1) % 3]).filter(|&m| asked[m as usize])
            });
            let known = || corners.into_iter().chain(middles.into_iter().flatten());
            let (mut least, mut most) = (Rgb::INFINITY, Rgb::ZERO);
            for light in known().map(|v| sources[v as usize].sum()) {
                (least, most) = (least.min(light), most.max(light));
            }
            let even = ((most - least) / (0.5 * (most + least) + Rgb::splat(floor))).max_element() < EVEN;
            let calm_around = known().all(|v| sources[v as usize].calm);
            let is_chosen = is_refined && blur >= EVEN * draft.longest_edge(leaf);
            let all = middles.iter().all(Option::is_some) && !is_chosen;
            let count = if even && all { 0 } else { count };
            let share = area / (count + if all { 3 } else { 0 }).max(1) as f32;
            for (k, middle) in middles.into_iter().flatten().enumerate().filter(|_| all) {
                let mut weights = [0.5; 3];
                weights[(k + 2) % 3] = 0.0;
                points.middles.push((FitSample { element, weights, area: share }, middle));
            }
            let times = corners.iter().map(|&v| sources[v as usize].times).min();
            let look = if calm_around { Look::Calm } else { Look::Close(times.unwrap_or(1).max(1)) };
            points.looks.extend((0..count).map(|_| look));
            points.inside.extend((0..count).map(|index| {
                let weights = drawn_inside(triangle_point(key.point2(index)));
                FitSample { element, weights, area: share }
            }));
        }
        points
    }

    /// Light of sources, term by term, at points inside elements.
    fn light_inside(
        &self,
        draft: &Draft,
        displayed: &Displayed,
        points: &[FitSample],
        looks: &[Look],
        progress: &dyn Progress,
    ) -> Vec<[Rgb; TERMS]> {
        let count = self.params.fit_rays;
        points
            .par_iter()
            .zip(looks)
            .enumerate()
            .with_min_len(JOB)
            .with_max_len(JOB)
            .map_init(Scratch::default, |scratch, (index, (point, &look))| {
                if progress.is_cancelled() {
                    return [Rgb::ZERO; TERMS];
                }
                let lights = self.lights;
                let receiver =
                    draft.receiver_inside(lights.tracer(), displayed, point.element, point.weights);
                let key = Key::new(self.params.seed, Purpose::Emitter, index as u64 | 1 << 40);
                let [direct, mirrored] =
                    area_sources(lights, &receiver, count, look, key, scratch).map(|f| f.irradiance);
                let element = &displayed.mesh.elements[point.element as usize];
                let around = element.vertices.map(|v| displayed.origin[v as usize]);
                let sky = if lights.has_skylight() {
                    let lamps = direct + mirrored;
                    let leaf = &draft.leaves[displayed.leaves[point.element as usize] as usize];
                    let share = self.sky_shares.beside(draft.longest_edge(leaf));
                    self.skylight(&receiver, (count, share), lamps, &around, key, scratch).irradiance
                } else {
                    Rgb::ZERO
                };
                let lens = if lights.lenses().is_empty() {
                    Rgb::ZERO
                } else {
                    self.through_lenses(&receiver, (&around, true), &mut Vec::new(), key, scratch).irradiance
                };
                let punctual = lights.punctual(&receiver, scratch);
                [direct, mirrored, sky, lens, punctual.direct + punctual.mirrored]
            })
            .collect()
    }
}
