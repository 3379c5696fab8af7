//! A quantity that is refined, and its values at the vertices made so far: how closely each place is looked at, by what is known around
//! it, and which vertices wait for which.

mod doubt;

use rayon::prelude::*;
use rustc_hash::FxHashMap;

use catoptric_scene::{Cancelled, Progress, Rgb};

use crate::JOB;
use crate::draft::Draft;
use crate::refine::RefineParams;
use crate::sharing::Sharing;

/// What is known when a vertex is evaluated.
#[derive(Clone, Copy, Debug)]
pub enum Known<'a> {
    /// Nothing: a look that may help others, and itself.
    Nothing,
    /// Nothing, but it will be asked again when more is known, if it is not calm.
    NotYet,
    /// What was found at these vertices, of which it may be one.
    At(&'a [u32]),
}

/// How closely a field looks at a place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Look {
    /// The field is calm around it: few samples do, if they agree.
    Calm,
    /// With so many times the usual samples.
    Close(u32),
}

impl Look {
    /// Times the usual samples.
    pub fn times(self) -> u32 {
        match self {
            Self::Calm => 1,
            Self::Close(times) => times,
        }
    }
}

/// What is found at a place.
#[derive(Clone, Copy, Debug, Default)]
pub struct Found {
    /// The field's value.
    pub value: Rgb,
    /// Whether the field is calm there.
    pub calm: bool,
    /// Whether some of it took fewer than the usual samples, as [`Look::Calm`] allows.
    pub looked: bool,
    /// Variance of the value, channels added, as far as its samples tell.
    pub variance: f32,
    /// Times the usual samples that it took.
    pub times: u32,
}

/// One quantity that is refined: its values at the draft's vertices, computed on demand.
///
/// Where the field is calm around a place, a look at it may do, with fewer samples; where it is noisy around it, there are more. Samples
/// never decide their own number alone: those that missed what blocks a little of a lamp would be content.
pub trait Field: Sync {
    /// What is found at a vertex.
    fn evaluate(&self, draft: &Draft, vertex: u32, known: Known, look: Look) -> Found;
    /// Value in the middle of a leaf.
    fn evaluate_inside(&self, draft: &Draft, leaf: u32, look: Look) -> Rgb;
    /// Whether it has edges, from one place to the next, and not only slopes.
    fn has_edges(&self) -> bool {
        false
    }
    /// Whether what is found at some vertices helps at others.
    fn learns(&self) -> bool {
        false
    }
    /// How the field varies from vertex to vertex as far as that is known without a look: its values are about in proportion to this where
    /// nothing else happens between them. `None` where nothing is.
    fn foretold(&self, _draft: &Draft, _vertex: u32) -> Option<f32> {
        None
    }
    /// Called when all vertices so far are evaluated.
    fn settle(&self) {}
}

/// Values of all vertices made so far.
#[derive(Default)]
pub struct Values {
    /// Per draft vertex.
    pub values: Vec<Rgb>,
    /// Per draft vertex: what was found there. Nothing is known of those that others sample for.
    found: Vec<Found>,
    /// Which of them are evaluated for others.
    pub sharing: Sharing,
    /// Light that counts at least, where errors are relative to it.
    pub(crate) floor: f32,
    /// Times the usual samples that all have taken together.
    taken: usize,
}

impl Values {
    /// None yet.
    pub fn new(sharing: Sharing) -> Self {
        Self { sharing, ..Self::default() }
    }

    /// Evaluates the vertices from `self.values.len()` on.
    pub fn extend(
        &mut self,
        draft: &Draft,
        field: &dyn Field,
        params: &RefineParams,
        progress: &dyn Progress,
    ) -> Result<(), Cancelled> {
        let is_base = self.values.is_empty();
        let ask = |asked: bool, vertex: u32, known: Known, look: Look| {
            let asked = asked && !progress.is_cancelled();
            if asked { field.evaluate(draft, vertex, known, look) } else { Found::default() }
        };
        let fresh = if is_base {
            self.base(draft, field, params, &ask)
        } else {
            self.between(draft, field, params, &ask)
        };
        if progress.is_cancelled() {
            return Err(Cancelled);
        }
        progress.advance(fresh.len() as u64);
        self.values.extend(fresh.iter().map(|f| f.value));
        self.found.extend(fresh);
        if is_base {
            fill(&self.sharing, &mut self.values);
        }
        Ok(())
    }

    /// The vertices of the base mesh: a look at each, then another where it is not calm or beside that. A vertex that is not calm for
    /// one lamp has had no more than a look at another that its few samples agreed on.
    fn base(
        &mut self,
        draft: &Draft,
        field: &dyn Field,
        params: &RefineParams,
        ask: &(impl Fn(bool, u32, Known, Look) -> Found + Sync),
    ) -> Vec<Found> {
        let count = draft.vertices.len();
        let parents = |vertex: u32| &draft.vertices[vertex as usize].parents;
        let is_asked = |vertex: u32| self.sharing.is_asked(vertex);
        let beside = if field.learns() { self.beside(draft) } else { FxHashMap::default() };
        let first = |vertex: u32| {
            let is_root = parents(vertex).is_none();
            let alone = is_root && beside.get(&vertex).is_none_or(|others| others.contains(&vertex));
            let known = if alone { Known::Nothing } else { Known::NotYet };
            ask(is_asked(vertex), vertex, known, if is_root { Look::Calm } else { Look::Close(1) })
        };
        let vertices = (0..count as u32).into_par_iter().with_min_len(16).with_max_len(JOB);
        let mut fresh: Vec<Found> = vertices.map(first).collect();
        field.settle();

        let mut doubtful: Vec<bool> = fresh.iter().map(|found| !found.calm).collect();
        let mut around = vec![Around::default(); count];
        for (a, b) in draft.edges() {
            let length = draft.length((a, b));
            for (a, b) in [(a, b), (b, a)] {
                doubtful[a as usize] |= !fresh[b as usize].calm;
                if is_asked(b) {
                    around[a as usize].add(&fresh[b as usize], length);
                }
            }
        }
        let mut values: Vec<Rgb> = fresh.iter().map(|found| found.value).collect();
        fill(&self.sharing, &mut values);
        self.floor = params.floor * mean(draft, &values);
        let look = |(vertex, around): (usize, &Around)| {
            let asked = doubtful[vertex] && is_asked(vertex as u32);
            if asked { Look::Close(around.times(self.floor, params)) } else { Look::Calm }
        };
        let mut looks: Vec<Look> = around.iter().enumerate().map(look).collect();
        self.taken += afford(&mut looks, MEAN_TIMES * params.max_vertices);
        // Where all had the usual samples, the same would be found again.
        let learns = field.learns();
        let again = |index: usize, found: &Found| {
            doubtful[index] && (learns || found.looked || looks[index] != Look::Close(1))
        };
        let known = |vertex: u32| match parents(vertex) {
            Some(parents) if learns => &parents[..],
            _ => beside.get(&vertex).map_or(&[][..], Vec::as_slice),
        };
        in_waves(0, count, known, |wave| {
            fresh.par_iter_mut().enumerate().with_min_len(16).with_max_len(JOB).for_each(|(index, found)| {
                if wave.contains(index) && again(index, found) {
                    let vertex = index as u32;
                    *found = ask(is_asked(vertex), vertex, Known::At(known(vertex)), looks[index]);
                }
            });
            field.settle();
        });
        fresh
    }

    /// Vertices that halve edges since then. Those that are halves of what is made now wait for their ends.
    fn between(
        &mut self,
        draft: &Draft,
        field: &dyn Field,
        params: &RefineParams,
        ask: &(impl Fn(bool, u32, Known, Look) -> Found + Sync),
    ) -> Vec<Found> {
        let (first, count) = (self.values.len(), draft.vertices.len());
        let ends = |vertex: u32| draft.vertices[vertex as usize].parents.as_slice().as_flattened();
        let is_asked = |vertex: u32| self.sharing.is_asked(vertex);
        let look = |v: u32| if is_asked(v) { self.look(draft, ends(v), params) } else { Look::Calm };
        let fresh = (first as u32..count as u32).into_par_iter();
        let mut looks: Vec<Look> = fresh.with_min_len(1024).map(look).collect();
        self.taken += afford(&mut looks, (MEAN_TIMES * params.max_vertices).saturating_sub(self.taken));
        let mut fresh: Vec<Found> = vec![Found::default(); count - first];
        let known = |v: u32| if field.learns() { ends(v) } else { &[] };
        in_waves(first, count, known, |wave| {
            fresh.par_iter_mut().enumerate().with_min_len(16).with_max_len(JOB).for_each(|(index, found)| {
                if wave.contains(index) {
                    let vertex = (first + index) as u32;
                    *found = ask(is_asked(vertex), vertex, Known::At(ends(vertex)), looks[index]);
                }
            });
            field.settle();
        });
        fresh
    }

    /// Whether the mesh is finer at an edge of this length, metres, than the light on it.
    pub(crate) fn is_fine(&self, edge: (u32, u32), length: f32) -> bool {
        self.sharing.shares(edge.0) && self.sharing.shares(edge.1) && length < 2.0 * self.sharing.cell()
    }

    /// How closely to look between some vertices.
    pub(crate) fn look(&self, draft: &Draft, ends: &[u32], params: &RefineParams) -> Look {
        let known = || ends.iter().enumerate().map(|(k, &v)| (k, self.found.get(v as usize)));
        if known().all(|(_, found)| found.is_some_and(|found| found.calm)) {
            return Look::Calm;
        }
        let mut around = Around::default();
        for (k, found) in known() {
            if let Some(found) = found {
                around.add(found, draft.length((ends[k], ends[(k + 1) % ends.len()])));
            }
        }
        Look::Close(around.times(self.floor, params))
    }

    /// The vertices by which each of the base mesh knows more: itself and its neighbours; of a fine mesh, those as near as vertices that
    /// share, if there are such, none of which is beside another.
    fn beside(&self, draft: &Draft) -> FxHashMap<u32, Vec<u32>> {
        let is_alone = |v: u32| draft.vertices[v as usize].parents.is_none() && self.sharing.is_asked(v);
        let mut edges = draft.edges();
        edges.retain(|edge| is_alone(edge.0) && is_alone(edge.1));
        // By their larger end: whether it waits is known when those before it are.
        edges.sort_unstable_by_key(|&(a, b)| (b, a));
        let mut near: FxHashMap<u32, Vec<u32>> = FxHashMap::default();
        for &(a, b) in &edges {
            if draft.length((a, b)) < self.sharing.cell() && !near.contains_key(&a) {
                near.entry(b).or_default().push(a);
            }
        }
        let mut beside: FxHashMap<u32, Vec<u32>> = FxHashMap::default();
        for (a, b) in edges {
            for (a, b) in [(a, b), (b, a)] {
                if !near.contains_key(&a) && !near.contains_key(&b) {
                    beside.entry(a).or_insert_with(|| vec![a]).push(b);
                }
            }
        }
        beside.extend(near);
        // Those without neighbours of their kind know at least what they have seen themselves.
        for v in (0..draft.vertices.len() as u32).filter(|&v| is_alone(v)) {
            beside.entry(v).or_insert_with(|| vec![v]);
        }
        beside
    }
}

/// Gives those that others sample for what these have.
fn fill(sharing: &Sharing, values: &mut [Rgb]) {
    sharing.fill(values, |parts| parts.map(|(value, weight)| value * weight).sum());
}

/// Share of what refinement leaves alone that noise may make up: three deviations of it split no edge.
const NOISE: f32 = 1.0 / 3.0;
/// Times the usual samples, at most.
const MOST_TIMES: u32 = 16;

/// Times the usual samples of all vertices together, at most: where all is noise, as in a cloud of dust, it is seen as such.
const MEAN_TIMES: usize = 6;

/// Halves the samples of those that have most until all together can be afforded by `room`, or are usual. Returns their sum.
fn afford(looks: &mut [Look], room: usize) -> usize {
    loop {
        let (mut sum, mut most) = (0, 1);
        for look in &*looks {
            if let Look::Close(times) = look {
                (sum, most) = (sum + *times as usize, most.max(*times));
            }
        }
        if sum <= room || most == 1 {
            return sum;
        }
        for look in looks.iter_mut().filter(|look| **look == Look::Close(most)) {
            *look = Look::Close(most / 2);
        }
    }
}

/// Sums over what was found around a place.
#[derive(Clone, Copy, Debug, Default)]
struct Around {
    count: f32,
    light: Rgb,
    /// As if each had taken the usual samples.
    variance: f32,
    length: f32,
    most_times: u32,
}

impl Around {
    /// Adds what was found at the end of an edge of this length.
    fn add(&mut self, found: &Found, length: f32) {
        self.count += 1.0;
        self.light += found.value;
        // Of stratified samples of an edge the deviation falls by n^-3/4.
        self.variance += found.variance * libm::powf(found.times as f32, 1.5);
        self.length += length;
        self.most_times = self.most_times.max(found.times);
    }

    /// Times the usual samples by which noise alone does not split edges of this length. Not less than half of what was taken around,
    /// on edges of twice the length: what many samples find exactly, few may not.
    fn times(&self, floor: f32, params: &RefineParams) -> u32 {
        let mean = 1.0 / self.count.max(1.0);
        let light = self.light.element_sum() * mean / 3.0 + floor.max(f32::MIN_POSITIVE);
        let deviation = (self.variance * mean / 3.0).sqrt() / light;
        let excess = deviation * self.length * mean / (NOISE * params.blur).max(f32::MIN_POSITIVE);
        let mut times = (self.most_times / 2).max(1);
        while times < MOST_TIMES && excess > libm::powf(times as f32, 0.75) {
            times *= 2;
        }
        times
    }
}

/// Vertices that are evaluated together, by their number since the first that is new.
struct Wave<'a> {
    waves: &'a [u32],
    number: u32,
}

impl Wave<'_> {
    fn contains(&self, index: usize) -> bool {
        self.waves[index] == self.number
    }
}

/// Runs `work` on the vertices from `first` on, of `count` in all, in waves: each comes after those that `known` names for it. Those that
/// name themselves have been looked at already, and come first.
fn in_waves<'a>(first: usize, count: usize, known: impl Fn(u32) -> &'a [u32], mut work: impl FnMut(&Wave)) {
    let mut waves: Vec<u32> = Vec::with_capacity(count - first);
    for vertex in first as u32..count as u32 {
        let names_itself = known(vertex).contains(&vertex);
        let after = |&v: &u32| {
            (v as usize).checked_sub(first).and_then(|index| waves.get(index)).map_or(0, |wave| wave + 1)
        };
        waves.push(if names_itself { 0 } else { known(vertex).iter().map(after).max().unwrap_or(0) });
    }
    for number in 0..=waves.iter().copied().max().unwrap_or(0) {
        work(&Wave { waves: &waves, number });
    }
}

/// Area-weighted mean of the largest channel; large triangles count less.
pub fn mean(draft: &Draft, values: &[Rgb]) -> f32 {
    // Sums of pieces of one size: the same for any number of threads.
    let pieces: Vec<(f64, f64)> = draft
        .leaves
        .par_chunks(4096)
        .map(|leaves| {
            let (mut sum, mut area) = (0.0_f64, 0.0_f64);
            for leaf in leaves {
                let a = f64::from(draft.weight(leaf));
                let corners = leaf.vertices.iter().map(|&v| values[v as usize].max_element());
                sum += a * f64::from(corners.sum::<f32>() / 3.0);
                area += a;
            }
            (sum, area)
        })
        .collect();
    let (sum, area) = pieces.iter().fold((0.0, 0.0), |(sum, area), piece| (sum + piece.0, area + piece.1));
    if area > 0.0 { (sum / area) as f32 } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;
    use std::sync::atomic::{AtomicUsize, Ordering};

    use glam::Vec3;

    use super::*;
    use crate::base_mesh::coarse_patches;
    use crate::sharing::Covers;
    use crate::solve::SolveParams;
    use catoptric_scene::{Material, Scene, SceneParts, Silent};
    use catoptric_solution::Quality;
    use catoptric_trace::Tracer;

    fn standard() -> RefineParams {
        SolveParams::for_quality(Quality::Standard).sources
    }

    /// Light that few samples miss, calm or not as its place says.
    #[derive(Default)]
    struct Missed {
        /// A look takes the usual samples, too, and misses nothing.
        is_exact: bool,
        asked: AtomicUsize,
    }

    impl Field for Missed {
        fn evaluate(&self, draft: &Draft, vertex: u32, _: Known, look: Look) -> Found {
            self.asked.fetch_add(1, Ordering::Relaxed);
            let calm = draft.vertices[vertex as usize].position.x < 0.0;
            let looked = look == Look::Calm && !self.is_exact;
            Found { value: if looked { Rgb::ZERO } else { Rgb::ONE }, calm, looked, ..Found::default() }
        }

        fn evaluate_inside(&self, _: &Draft, _: u32, _: Look) -> Rgb {
            Rgb::ONE
        }
    }

    #[test]
    fn samples_grow_with_noise_and_halve_with_edges() {
        let params = RefineParams { blur: 0.03, ..standard() };
        let times = |deviation: f32, taken: u32, length: f32| {
            let variance = 3.0 * deviation * deviation;
            let mut around = Around::default();
            around.add(&Found { value: Rgb::ONE, variance, times: taken, ..Found::default() }, length);
            around.times(0.0, &params)
        };
        // A hundredth of the light is left alone: above it by 2^(3/4), twice the samples are taken.
        assert_eq!([0.0, 0.01, 0.0101, 0.0169, 0.02, 1.0].map(|d| times(d, 1, 1.0)), [1, 1, 2, 4, 4, 16]);
        assert_eq!(times(0.04, 1, 0.25), 1);
        // What four times the samples left of that noise.
        assert_eq!(times(0.0169 / libm::powf(4.0, 0.75), 4, 1.0), 4);
        // What many samples found without noise, few might not.
        assert_eq!([1, 2, 8, 16].map(|taken| times(0.0, taken, 1.0)), [1, 1, 4, 8]);
    }

    /// What one lamp is uneven for may be missed of another by few samples: neither that nor its neighbours go with a look.
    #[test]
    fn where_it_is_not_calm_and_beside_that_a_look_does_not_do() {
        let mut parts = SceneParts::default();
        let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
        parts.add_quad("floor", white, Vec3::new(-2.0, 0.0, 2.0), Vec3::X * 4.0, Vec3::Z * -4.0);
        let scene = Scene::new(parts).expect("a valid scene");
        let tracer = Tracer::new(&scene);
        let (draft, _) = coarse_patches(&tracer, 200);
        let mut values = Values::default();
        let missed = Missed::default();
        values.extend(&draft, &missed, &standard(), &Silent).expect("not cancelled");
        let is_calm = |v: u32| draft.vertices[v as usize].position.x < 0.0;
        let mut beside = vec![false; draft.vertices.len()];
        for (a, b) in draft.edges() {
            beside[a as usize] |= !is_calm(b);
            beside[b as usize] |= !is_calm(a);
        }
        let (mut looked, mut asked) = (0, 0);
        for (v, value) in values.values.iter().enumerate() {
            let full = !is_calm(v as u32) || beside[v];
            assert_eq!(*value, if full { Rgb::ONE } else { Rgb::ZERO }, "{:?}", draft.vertices[v].position);
            if full { asked += 1 } else { looked += 1 }
        }
        assert!(looked > 10 && asked > looked, "{looked} {asked}");
        assert_eq!(missed.asked.into_inner(), draft.vertices.len() + asked);

        // Where the look was as close already, nobody is asked twice.
        let exact = Missed { is_exact: true, ..Missed::default() };
        Values::default().extend(&draft, &exact, &standard(), &Silent).expect("not cancelled");
        assert_eq!(exact.asked.into_inner(), draft.vertices.len());
    }

    /// Keeps what vertices knew that were asked again.
    #[derive(Default)]
    struct Learner(Mutex<Vec<(u32, Vec<u32>)>>);

    impl Field for Learner {
        fn evaluate(&self, _: &Draft, vertex: u32, known: Known, _: Look) -> Found {
            if let Known::At(others) = known {
                self.0.lock().expect("no panic").push((vertex, others.to_vec()));
            }
            Found::default()
        }

        fn evaluate_inside(&self, _: &Draft, _: u32, _: Look) -> Rgb {
            Rgb::ZERO
        }

        fn learns(&self) -> bool {
            true
        }
    }

    /// On a fine mesh those that are asked have none of their kind beside them: what they saw at first would be lost, and an
    /// edge of the sky be looked for all over again.
    #[test]
    fn whoever_is_asked_again_knows_at_least_what_it_saw_itself() {
        let mut parts = SceneParts::default();
        let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
        parts.add_sphere("ball", white, Vec3::ZERO, 1.0, 32);
        let scene = Scene::new(parts).expect("a valid scene");
        let tracer = Tracer::new(&scene);
        let (draft, _) = coarse_patches(&tracer, 200);
        // Cubes of three edges: most vertices take what a few find.
        let sharing = Sharing::new(&tracer, &draft, 1.0, 0.3, Covers::Part, 1000, &[]);
        let mut values = Values::new(sharing);
        let field = Learner::default();
        values.extend(&draft, &field, &standard(), &Silent).expect("not cancelled");
        let again = field.0.into_inner().expect("no panic");
        let alone = again.iter().filter(|(vertex, known)| known.as_slice() == [*vertex]).count();
        assert!(alone > 10, "{alone} of {}", again.len());
        for (vertex, known) in &again {
            assert!(!known.is_empty(), "vertex {vertex} knows nothing");
        }
    }
}
