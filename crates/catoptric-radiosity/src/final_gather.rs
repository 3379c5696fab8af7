//! The final gather: light that other diffuse surfaces send, at the vertices and inside the elements of a mesh, fitted, and
//! corrected by what it found beyond what it saw.

use std::ops::Range;

use glam::Vec2;
use rayon::prelude::*;

use catoptric_light::{Lights, Receiver};
use catoptric_scene::{Cancelled, Progress, Rgb};
use catoptric_solution::DisplayMesh;
use catoptric_trace::sequence::{Key, Purpose, triangle_point};

use crate::JOB;
use crate::allocation::{Allocation, areas_around, relative_deviation, vertex_budgets};
use crate::draft::{Displayed, Draft, drawn_inside};
use crate::fit::{FitParams, FitSample, fit};
use crate::gather::{DiffuseLight, Gathered, gather_part};
use crate::guide::{Findings, Guide};
use crate::hats::{Hats, POINTS_AROUND};
use crate::patch::PatchMesh;
use crate::rows::Row;
use crate::sharing::Sharing;
use crate::solve::SolveParams;
use crate::solver::{SolverParams, reflect_error, spread_error};

/// Patch values at the vertices of the draft: means over the base triangles around, then along the hierarchy.
pub(crate) fn spread(draft: &Draft, patches: &PatchMesh, values: &[Rgb]) -> Vec<Rgb> {
    let mut sums = vec![(Rgb::ZERO, 0.0_f32); draft.vertices.len()];
    for (root, corners) in draft.base.iter().enumerate() {
        let patch = patches.of_root[root].0 as usize;
        for &v in corners {
            sums[v as usize].0 += values[patch];
            sums[v as usize].1 += 1.0;
        }
    }
    let mut result: Vec<Rgb> = Vec::with_capacity(sums.len());
    for (index, (sum, count)) in sums.iter().enumerate() {
        let value = if *count > 0.0 {
            *sum / *count
        } else {
            draft.vertices[index]
                .parents
                .map_or(Rgb::ZERO, |[a, b]| (result[a as usize] + result[b as usize]) * 0.5)
        };
        result.push(value);
    }
    result
}

/// Irradiance below this share of the scene's mean counts as that much where rays are shared out.
const FLOOR: f32 = 0.005;

/// Rays inside an element at least where broad emitters are a control variate: coefficients by fewer are noise (furnace_mirror:
/// FLIP 0.0042 by 16 rays, 0.0014 by 64).
const CONTROLLED_RAYS: u32 = 64;

/// The least value at each vertex and its neighbours.
fn least_beside(mesh: &DisplayMesh, value: impl Fn(u32) -> f32) -> Vec<f32> {
    let mut least = vec![f32::INFINITY; mesh.vertices.len()];
    for element in &mesh.elements {
        let own = element.vertices.iter().map(|&v| value(v)).fold(f32::INFINITY, f32::min);
        for &v in &element.vertices {
            least[v as usize] = least[v as usize].min(own);
        }
    }
    least
}

/// Gathered light at the vertices of the mesh of the gathers.
pub(crate) struct GatheredLight {
    /// Direct, mirrored, caustic and indirect per draft vertex; `None` where no element touches it.
    pub(crate) terms: Vec<Option<[Rgb; 4]>>,
    /// Hemisphere rays sent.
    pub(crate) rays: u64,
}

/// What gathers look at: the refined mesh with the light of sources on it.
pub(crate) struct Sight<'a> {
    pub(crate) displayed: &'a Displayed,
    pub(crate) draft: &'a Draft,
    pub(crate) sources: &'a [Rgb],
}

impl Sight<'_> {
    /// Irradiance per vertex of the display mesh when `more` (per draft vertex) comes to what sources send.
    fn with(&self, more: &[Rgb]) -> Vec<Rgb> {
        self.displayed.origin.iter().map(|&v| self.sources[v as usize] + more[v as usize]).collect()
    }

    /// Area-weighted mean of the sum of channels of irradiance per vertex of the display mesh.
    fn mean(&self, irradiance: &[Rgb]) -> f32 {
        let mesh = &self.displayed.mesh;
        let (mut sum, mut area) = (0.0_f64, 0.0_f64);
        for (index, element) in mesh.elements.iter().enumerate() {
            let own = f64::from(mesh.area(index as u32));
            let mean =
                element.vertices.iter().map(|&v| irradiance[v as usize].element_sum()).sum::<f32>() / 3.0;
            sum += own * f64::from(mean);
            area += own;
        }
        if area > 0.0 { (sum / area) as f32 } else { 0.0 }
    }

    /// Values known at some vertices, at all: children are the mean of their parents.
    fn spread(&self, known: &[Option<Rgb>]) -> Vec<Rgb> {
        let mut all: Vec<Rgb> = Vec::with_capacity(self.draft.vertices.len());
        for (index, vertex) in self.draft.vertices.iter().enumerate() {
            let own = known.get(index).copied().flatten();
            all.push(own.unwrap_or_else(|| {
                vertex.parents.map_or(Rgb::ZERO, |[a, b]| (all[a as usize] + all[b as usize]) * 0.5)
            }));
        }
        all
    }
}

/// The coarse solution and what it takes to correct it.
pub(crate) struct Coarse<'a> {
    pub(crate) patches: &'a PatchMesh,
    pub(crate) rows: &'a [Row],
    pub(crate) indirect: &'a [Rgb],
}

impl Coarse<'_> {
    /// What becomes, per patch, of light of which the vertices of `draft` hold too little.
    fn onward(&self, draft: &Draft, lack: &[Rgb], solver: &SolverParams) -> Vec<Rgb> {
        spread_error(self.patches, self.rows, &self.means(draft, lack), solver).indirect
    }

    /// The same after one reflection.
    fn reflected(&self, draft: &Draft, lack: &[Rgb]) -> Vec<Rgb> {
        reflect_error(self.patches, self.rows, &self.means(draft, lack))
    }

    /// Means per patch of values at the vertices of `draft`.
    fn means(&self, draft: &Draft, values: &[Rgb]) -> Vec<Rgb> {
        let mut mean = vec![Rgb::ZERO; self.patches.len()];
        for leaf in &draft.leaves {
            let patch = self.patches.of_root[leaf.root as usize].0 as usize;
            let share = draft.area(leaf) / self.patches.areas[patch].max(f32::MIN_POSITIVE);
            mean[patch] += leaf.vertices.iter().map(|&v| values[v as usize]).sum::<Rgb>() * (share / 3.0);
        }
        mean
    }
}

/// Hidden corners of elements that can be seen in part show what their neighbours found: nobody sees the dark behind them.
fn beside_hidden(draft: &Draft, known: &mut [Option<Rgb>]) {
    let mut sums = vec![(Rgb::ZERO, 0.0_f32); known.len()];
    for leaf in &draft.leaves {
        for &v in &leaf.vertices {
            for value in leaf.vertices.iter().filter_map(|&corner| known[corner as usize]) {
                sums[v as usize].0 += value;
                sums[v as usize].1 += 1.0;
            }
        }
    }
    for (known, (sum, count)) in known.iter_mut().zip(sums) {
        if known.is_none() && count > 0.0 {
            *known = Some(sum / count);
        }
    }
}

/// Where the findings of display vertices lie.
struct Beside {
    /// Per display vertex; `u32::MAX` for one that does not gather for itself alone.
    place: Vec<u32>,
}

impl Beside {
    fn new(own: &[u32], count: usize) -> Self {
        let mut place = vec![u32::MAX; count];
        for (index, &i) in own.iter().enumerate() {
            place[i as usize] = index as u32;
        }
        Self { place }
    }

    /// The guide by what some vertices found.
    fn guide(
        &self,
        findings: &[Findings],
        gathered: &[Gathered],
        vertices: impl Iterator<Item = u32>,
    ) -> Guide {
        let (mut all, mut sum, mut count) = (Findings::default(), Gathered::default(), 0.0_f32);
        for v in vertices {
            if let Some(own) = findings.get(self.place[v as usize] as usize) {
                all.merge(own);
                sum.add(&gathered[v as usize], 1.0);
                count += 1.0;
            }
        }
        let mut expected = Gathered::default();
        expected.add(&sum, 1.0 / count.max(1.0));
        Guide::new(&all, expected)
    }
}

/// Gathers at the vertices and inside the elements of `draft`, and fits.
///
/// Three bounces of refinement for one: the vertices, with few rays, see the coarse solution; the points inside, with many,
/// see what the vertices found; and what they found beyond what they saw is reflected on over the coarse patches
/// (Lischinski, Tampieri & Greenberg 1993 gather once, from the coarse solution).
pub(crate) fn final_gather(
    lights: &Lights,
    sight: &Sight,
    coarse: &Coarse,
    draft: &Draft,
    hidden: &[bool],
    sharing: &Sharing,
    params: &SolveParams,
    spacing: f32,
    progress: &dyn Progress,
) -> Result<GatheredLight, Cancelled> {
    let tracer = lights.tracer();
    let displayed = draft.display(tracer);
    let mesh = &displayed.mesh;
    let whole = 0.5 * spacing * spacing;
    let samples: Vec<FitSample> = (0..mesh.elements.len() as u32)
        .flat_map(|element| {
            let area = mesh.area(element);
            let key = Key::new(params.seed, Purpose::ElementPoint, u64::from(element) | 1 << 42);
            // Refined elements are small because surfaces are near: they get one at least every other time.
            let refined = draft.leaves[displayed.leaves[element as usize] as usize].level > 0;
            let floor = if refined { 0.5 } else { 0.0 };
            let corners = mesh.elements[element as usize].vertices;
            let covered = corners.iter().map(|&v| displayed.origin[v as usize]).all(|v| hidden[v as usize])
                || corners.iter().all(|&v| sharing.shares(displayed.origin[v as usize]));
            let expected =
                if covered { 0.0 } else { (params.gather_points * (area / whole).min(1.0)).max(floor) };
            let count = (expected + key.uniform(0)).floor() as u32;
            (0..count).map(move |index| {
                let weights = drawn_inside(triangle_point(key.point2(index)));
                FitSample { element, weights, area: area / expected.max(count as f32) }
            })
        })
        .collect();
    progress.begin("gather", (samples.len() + mesh.vertices.len()) as u64);
    let coarse_seen = spread(sight.draft, coarse.patches, coarse.indirect);
    let seen = sight.with(&coarse_seen);
    let light = DiffuseLight { mesh: &sight.displayed.mesh, irradiance: &seen };
    let work = |light: &DiffuseLight,
                receiver: &Receiver,
                part: Range<u32>,
                guide: Option<&Guide>,
                entity: u64,
                note: &mut dyn FnMut(Vec2, f32)| {
        if progress.is_cancelled() {
            return Gathered::default();
        }
        let key = Key::new(params.seed, Purpose::Hemisphere, entity);
        let result = gather_part(lights, light, receiver, part, guide, key, &params.walk, note);
        progress.advance(1);
        result
    };
    let hats = Hats::new(&displayed, draft.vertices.len());
    let around = |light: &DiffuseLight, vertex: u32, rays: u32, bit: u64| {
        let mut sum = Gathered::default();
        let key = Key::new(params.seed, Purpose::ElementPoint, u64::from(vertex) | bit | 1 << 47);
        for index in 0..POINTS_AROUND {
            let Some((element, weights)) = hats.point(&displayed, vertex, key, index) else { break };
            let receiver = draft.receiver_inside(tracer, &displayed, element, weights);
            let entity = u64::from(vertex) | bit | u64::from(index) << 50;
            let part = 0..rays.div_ceil(POINTS_AROUND);
            let found = work(light, &receiver, part, None, entity, &mut |_, _| ());
            sum.add(&found, 1.0 / POINTS_AROUND as f32);
        }
        sum
    };
    let (mut vertex_rays, mut trust) = vertex_budgets(draft, &displayed, hidden, params, whole);
    for (i, &v) in displayed.origin.iter().enumerate().filter(|(_, v)| sharing.shares(**v)) {
        // What they find is only looked at: those that sample for others gather again below.
        vertex_rays[i] = if sharing.is_asked(v) { params.vertex_rays.div_ceil(3) } else { 0 };
        trust[i] = SHARED_TRUST;
    }
    // Half of the rays first, then where to, and as many as, the neighbours' halves call for. A vertex's own rays have no
    // say in it, or those that missed what is bright would be content. Broad emitters are a control variate of all rays
    // at once.
    let at_once = !lights.emitters().broad().is_empty();
    let first_rays = |rays: u32| if at_once { rays } else { rays.div_ceil(2) };
    // Those that gather for themselves alone: only what they find is kept by direction.
    let own: Vec<u32> = (0..displayed.origin.len() as u32)
        .filter(|&i| vertex_rays[i as usize] > 0 && !sharing.shares(displayed.origin[i as usize]))
        .collect();
    let mut at_vertices = vec![Gathered::default(); mesh.vertices.len()];
    let leads: Vec<(u32, Gathered)> = (0..displayed.origin.len() as u32)
        .into_par_iter()
        .with_min_len(8)
        .with_max_len(JOB)
        .filter(|&i| vertex_rays[i as usize] > 0 && sharing.shares(displayed.origin[i as usize]))
        .map(|i| (i, around(&light, displayed.origin[i as usize], vertex_rays[i as usize], 0)))
        .collect();
    let (first, mut findings): (Vec<Gathered>, Vec<Findings>) = own
        .par_iter()
        .with_min_len(8)
        .with_max_len(JOB)
        .map(|&i| {
            let (v, mut findings) = (displayed.origin[i as usize], Findings::default());
            let note = &mut |point, radiance| findings.add(point, radiance);
            let part = 0..first_rays(vertex_rays[i as usize]);
            let found = work(&light, &draft.receiver(tracer, v), part, None, u64::from(v), note);
            (found, findings)
        })
        .unzip();
    for (i, found) in leads.into_iter().chain(own.iter().copied().zip(first)) {
        at_vertices[i as usize] = found;
    }
    let beside = Beside::new(&own, mesh.vertices.len());
    let floor = FLOOR * sight.mean(&seen);
    let least = least_beside(mesh, |v| sight.sources[displayed.origin[v as usize] as usize].element_sum());
    let guides: Vec<Guide> = own
        .par_iter()
        .with_max_len(JOB)
        .map(|&i| {
            let around = hats.around(displayed.origin[i as usize]).iter();
            let others = around.flat_map(|&e| mesh.elements[e as usize].vertices).filter(|&other| other != i);
            beside.guide(&findings, &at_vertices, others)
        })
        .collect();
    let deviation_of = |guide: &Guide, least: f32| relative_deviation(guide, least + floor);
    let area = areas_around(mesh);
    let allocation = Allocation::new(
        own.iter()
            .zip(&guides)
            .filter(|(i, _)| !hidden[displayed.origin[**i as usize] as usize])
            .map(|(&i, guide)| (deviation_of(guide, least[i as usize]), area[i as usize])),
    );
    if !at_once {
        let more: Vec<(Gathered, u32)> = own
            .par_iter()
            .zip(&guides)
            .zip(&mut findings)
            .with_min_len(8)
            .with_max_len(JOB)
            .map(|((&i, guide), findings)| {
                let (v, gathered, rays) =
                    (displayed.origin[i as usize], at_vertices[i as usize], vertex_rays[i as usize]);
                let known = first_rays(rays);
                let all = allocation.rays(rays, deviation_of(guide, least[i as usize]));
                if all <= known {
                    return (gathered, known);
                }
                let note = &mut |point, radiance| findings.add(point, radiance);
                let receiver = draft.receiver(tracer, v);
                let more = work(&light, &receiver, known..all, Some(guide), u64::from(v), note);
                // Each counts by the inverse of its variance.
                let [even, guided] = [guide.even_deviation(), guide.deviation()].map(|d| d * d);
                let (first, second) = (known as f32 * guided, (all - known) as f32 * even);
                (gathered.mixed(&more, first / (first + second).max(f32::MIN_POSITIVE)), all)
            })
            .collect();
        for (&i, (gathered, rays)) in own.iter().zip(more) {
            at_vertices[i as usize] = gathered;
            vertex_rays[i as usize] = rays;
        }
    }
    drop(guides);
    let shared = SharedGathers::new(sharing, &displayed);
    shared.fill(&mut at_vertices);
    let mut known: Vec<Option<Rgb>> = vec![None; draft.vertices.len()];
    for (&v, g) in displayed.origin.iter().zip(&at_vertices).filter(|(v, _)| !hidden[**v as usize]) {
        known[v as usize] = Some(g.direct + g.mirrored + g.caustic + g.indirect);
    }
    beside_hidden(draft, &mut known);
    let looked_at = sight.spread(&known);
    let seen = sight.with(&looked_at);
    let light = DiffuseLight { mesh: &sight.displayed.mesh, irradiance: &seen };
    let (inside, inside_rays): (Vec<Gathered>, Vec<u32>) = samples
        .par_iter()
        .enumerate()
        .with_min_len(4)
        .with_max_len(JOB)
        .map(|(index, s)| {
            let receiver = draft.receiver_inside(tracer, &displayed, s.element, s.weights);
            let corners = mesh.elements[s.element as usize].vertices;
            let guide = beside.guide(&findings, &at_vertices, corners.into_iter());
            let least = corners.iter().map(|&v| least[v as usize]).fold(f32::INFINITY, f32::min);
            let rays = allocation.rays(params.gather_rays, deviation_of(&guide, least));
            let rays = if at_once { rays.max(CONTROLLED_RAYS) } else { rays };
            let entity = index as u64 | 1 << 43;
            (work(&light, &receiver, 0..rays, Some(&guide), entity, &mut |_, _| ()), rays)
        })
        .unzip();
    // Shared vertices have no points inside: those that sample for the others gather once more.
    let again: Vec<Gathered> = sharing
        .leads()
        .par_iter()
        .with_min_len(4)
        .with_max_len(JOB)
        .map(|&v| around(&light, v, params.gather_rays, 1 << 45))
        .collect();
    for (&lead, gathered) in sharing.leads().iter().zip(again) {
        at_vertices[shared.shown[lead as usize] as usize] = gathered;
    }
    shared.fill(&mut at_vertices);
    if progress.is_cancelled() {
        return Err(Cancelled);
    }

    let FitParams { smoothing, balance, .. } = params.gather_fit;
    let fit_params =
        FitParams { smoothing: smoothing * spacing, balance: balance * spacing, ..params.gather_fit };
    let mut terms: Vec<Option<[Rgb; 4]>> = vec![None; draft.vertices.len()];
    for &v in &displayed.origin {
        terms[v as usize] = Some([Rgb::ZERO; 4]);
    }
    let fit_term = |terms: &mut [Option<[Rgb; 4]>], at_vertices: &[Gathered], term: usize| {
        let value = |g: &Gathered| [g.direct, g.mirrored, g.caustic, g.indirect][term];
        let prior: Vec<Rgb> = at_vertices.iter().map(value).collect();
        let values: Vec<Rgb> = inside.iter().map(value).collect();
        if prior.iter().chain(&values).all(|v| *v == Rgb::ZERO) {
            return;
        }
        for (&v, fitted) in
            displayed.origin.iter().zip(fit(mesh, &samples, &values, &prior, &trust, &fit_params))
        {
            if let Some(terms) = &mut terms[v as usize] {
                terms[term] = fitted;
            }
        }
    };
    // The vertices saw the coarse solution, the points inside what the vertices found. What these found beyond what they
    // saw, reflected once, brings them to where the points are, so that they hold the fit where it belongs.
    let difference = |found: &[Rgb], seen: &[Rgb]| -> Vec<Rgb> {
        found.iter().zip(seen).map(|(found, seen)| *found - *seen).collect()
    };
    let once = spread(draft, coarse.patches, &coarse.reflected(draft, &difference(&looked_at, &coarse_seen)));
    for (&v, gathered) in displayed.origin.iter().zip(&mut at_vertices).filter(|(v, _)| !sharing.shares(**v))
    {
        gathered.indirect = (gathered.indirect + once[v as usize]).max(Rgb::ZERO);
    }
    for term in 0..4 {
        fit_term(&mut terms, &at_vertices, term);
    }
    // What was found beyond what was seen is missing from all further reflections.
    let found: Vec<Rgb> = terms
        .iter()
        .zip(&looked_at)
        .map(|(terms, seen)| terms.map_or(*seen, |t| t.iter().copied().sum::<Rgb>()))
        .collect();
    let lack = difference(&found, &looked_at);
    let more = spread(draft, coarse.patches, &coarse.onward(draft, &lack, &params.solver));
    for (terms, more) in terms.iter_mut().zip(&more) {
        if let Some([.., indirect]) = terms {
            *indirect = (*indirect + *more).max(Rgb::ZERO);
        }
    }
    let rays = vertex_rays.iter().chain(&inside_rays).map(|&r| u64::from(r)).sum::<u64>()
        + sharing.leads().len() as u64 * u64::from(params.gather_rays);
    Ok(GatheredLight { terms, rays })
}

/// How much the fit trusts what vertices share: no samples inside speak against it.
const SHARED_TRUST: f32 = 40.0;

/// Gathers at the vertices of a display mesh, some of which are shared.
struct SharedGathers<'a> {
    sharing: &'a Sharing,
    origin: &'a [u32],
    /// Display vertex of each draft vertex.
    shown: Vec<u32>,
}

impl<'a> SharedGathers<'a> {
    fn new(sharing: &'a Sharing, displayed: &'a Displayed) -> Self {
        let count = displayed.origin.iter().max().map_or(0, |v| *v as usize + 1);
        let mut shown = vec![u32::MAX; count];
        for (index, &v) in displayed.origin.iter().enumerate() {
            shown[v as usize] = index as u32;
        }
        Self { sharing, origin: &displayed.origin, shown }
    }

    fn fill(&self, gathered: &mut [Gathered]) {
        for (index, &v) in self.origin.iter().enumerate().filter(|(_, v)| !self.sharing.is_asked(**v)) {
            let mut sum = Gathered::default();
            for &(lead, weight) in self.sharing.parts(v) {
                let from = &gathered[self.shown[lead as usize] as usize];
                sum.add(from, weight);
            }
            gathered[index] = sum;
        }
    }
}
