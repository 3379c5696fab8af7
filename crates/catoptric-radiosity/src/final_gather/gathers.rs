//! The rays of the final gather: what the vertices find, and by it how many rays go where from the points inside the elements.

use std::ops::Range;

use rayon::prelude::*;

use catoptric_light::{Lights, Receiver};
use catoptric_scene::{Progress, Rgb};
use catoptric_solution::DisplayMesh;
use catoptric_trace::sequence::{Key, Purpose, triangle_point};

use crate::JOB;
use crate::allocation::{Allocation, areas_around, is_refined, relative_deviation, vertex_budgets};
use crate::display::Displayed;
use crate::draft::Draft;
use crate::fit::FitSample;
use crate::gather::{DiffuseLight, Gathered, Witness, gather_part};
use crate::guide::{Findings, Guide, Hints};
use crate::hats::{Hats, POINTS_AROUND};
use crate::inset::drawn_inside;
use crate::sharing::Sharing;
use crate::solve::SolveParams;

use super::links::{Linking, Links};
use super::shared::SharedGathers;
use super::spots::Spots;
use super::turns::{part, turns};

/// Irradiance below this share of the scene's mean counts as that much where rays are shared out.
const FLOOR: f32 = 0.005;

/// Rays inside an element at least where broad emitters are a control variate: coefficients by fewer are noise (furnace_mirror:
/// FLIP 0.0042 by 16 rays, 0.0014 by 64).
const CONTROLLED_RAYS: u32 = 64;

/// How much the fit trusts what vertices share: no samples inside speak against it.
const SHARED_TRUST: f32 = 40.0;

/// Deviation of what a vertex found, relative to all light there, from which its neighbours look once more, …
const NOISY: f32 = 0.1;
/// … and how many times as many rays as they, for what is usual, it must have got for that. (By 8 seeds of a room lit over a mirror: indirect
/// light deviates by 1.03 % of what is displayed, not 1.19 %, and the noisiest thousandth by 11 %, not 13 %, for 1 to 3 % more time in all. At 0.05 and
/// 2 it is 1.01 and 11 %, for 6 to 12 %; a fourth look finds nothing.)
const MORE: u64 = 4;

/// Tells the keys of gathers apart: in the entity of their rays.
const AT_SAMPLE: u64 = 1 << 43;
const AROUND_LEAD: u64 = 1 << 45;
/// … and of the points at which they are.
const SAMPLES: u64 = 1 << 42;
const AROUND: u64 = 1 << 47;
/// … and of the looks for bright places.
const SPOTS: u64 = 1 << 46;

/// A final gather: where it is done, and with what.
pub(super) struct Gathers<'a> {
    lights: &'a Lights<'a>,
    pub(super) draft: &'a Draft,
    /// The draft as it is shown.
    pub(super) displayed: Displayed,
    hats: Hats,
    pub(super) hidden: &'a [bool],
    shared: SharedGathers<'a>,
    params: &'a SolveParams,
    progress: &'a dyn Progress,
    /// Area of a base triangle, m².
    whole: f32,
    /// Broad emitters are a control variate of all rays at once: none are held back for where the others find most.
    at_once: bool,
}

/// What the vertices found.
pub(super) struct Vertices {
    /// Per display vertex.
    pub(super) gathered: Vec<Gathered>,
    /// Rays that were sent, likewise.
    pub(super) rays: Vec<u32>,
    /// Rays in a scene of usual noise, likewise.
    usual: Vec<u32>,
    /// How much the fit trusts them, likewise.
    pub(super) trust: Vec<f32>,
    /// Display vertices that gather for themselves alone.
    own: Vec<u32>,
    /// Per vertex of `own`, then per vertex that gathers for others.
    findings: Vec<Findings>,
    /// Per display vertex: what its rays met.
    pub(super) links: Vec<Links>,
    /// Per display vertex: its place in `findings`; `u32::MAX` for others.
    place: Vec<u32>,
}

/// What the points inside the elements found.
pub(super) struct Inside {
    /// Per sample.
    pub(super) gathered: Vec<Gathered>,
    /// Rays, likewise.
    pub(super) rays: Vec<u32>,
}

/// How many rays a gather gets by what is found beside it.
pub(super) struct Budget {
    allocation: Allocation,
    /// Per display vertex: the least light of sources at it and its neighbours, which hides errors.
    least: Vec<f32>,
    /// Light that hides errors everywhere.
    floor: f32,
}

impl Budget {
    fn deviation(&self, guide: &Guide, least: f32) -> f32 {
        relative_deviation(guide, least + self.floor)
    }
}

impl<'a> Gathers<'a> {
    /// On the vertices and elements of `draft`.
    pub(super) fn new(
        lights: &'a Lights<'a>,
        draft: &'a Draft,
        hidden: &'a [bool],
        sharing: &'a Sharing,
        params: &'a SolveParams,
        spacing: f32,
        progress: &'a dyn Progress,
    ) -> Self {
        let displayed = draft.display(lights.tracer());
        Self {
            lights,
            draft,
            hats: Hats::new(&displayed, draft.vertices.len()),
            hidden,
            shared: SharedGathers::new(sharing, &displayed),
            displayed,
            params,
            progress,
            whole: 0.5 * spacing * spacing,
            at_once: !lights.emitters().broad().is_empty(),
        }
    }

    /// Points inside the elements at which to gather.
    pub(super) fn samples(&self) -> Vec<FitSample> {
        let Displayed { mesh, origin, .. } = &self.displayed;
        let sharing = self.shared.sharing;
        (0..mesh.elements.len() as u32)
            .flat_map(|element| {
                let area = mesh.area(element);
                let key = Key::new(self.params.seed, Purpose::ElementPoint, u64::from(element) | SAMPLES);
                // Refined elements are small because surfaces are near: they get one at least every other time.
                let refined = is_refined(self.draft, &self.displayed, element as usize, self.whole);
                let floor = if refined { 0.5 } else { 0.0 };
                let corners = mesh.elements[element as usize].vertices.map(|v| origin[v as usize]);
                let covered = corners.iter().all(|&v| self.hidden[v as usize])
                    || corners.iter().all(|&v| sharing.shares(v));
                let expected = if covered {
                    0.0
                } else {
                    (self.params.gather_points * (area / self.whole).min(1.0)).max(floor)
                };
                let count = (expected + key.uniform(0)).floor() as u32;
                (0..count).map(move |index| {
                    let weights = drawn_inside(triangle_point(key.point2(index)));
                    FitSample { element, weights, area: area / expected.max(count as f32) }
                })
            })
            .collect()
    }

    /// One gather, by a part of the rays of an entity.
    fn gather(
        &self,
        light: &DiffuseLight,
        receiver: &Receiver,
        part: Range<u32>,
        guide: Option<&Guide>,
        entity: u64,
        witness: &mut impl Witness,
    ) -> Gathered {
        if self.progress.is_cancelled() {
            return Gathered::default();
        }
        let key = Key::new(self.params.seed, Purpose::Hemisphere, entity);
        let found = gather_part(self.lights, light, receiver, part, guide, key, &self.params.walk, witness);
        self.progress.advance(1);
        found
    }

    /// Gathers at points around a draft vertex, together by about so many rays.
    fn around(
        &self,
        light: &DiffuseLight,
        vertex: u32,
        rays: u32,
        bit: u64,
        guide: Option<&Guide>,
        witness: &mut impl Witness,
    ) -> Gathered {
        let mut sum = Gathered::default();
        let key = Key::new(self.params.seed, Purpose::ElementPoint, u64::from(vertex) | bit | AROUND);
        for index in 0..POINTS_AROUND {
            let Some((element, weights)) = self.hats.point(&self.displayed, vertex, key, index) else {
                break;
            };
            let receiver =
                self.draft.receiver_inside(self.lights.tracer(), &self.displayed, element, weights);
            let entity = u64::from(vertex) | bit | u64::from(index) << 50;
            let part = 0..rays.div_ceil(POINTS_AROUND);
            let found = self.gather(light, &receiver, part, guide, entity, witness);
            sum.add(&found, 1.0 / POINTS_AROUND as f32);
        }
        sum
    }

    /// Of the rays of a vertex, those that it sends before it knows what its neighbours find.
    fn first_rays(&self, rays: u32) -> u32 {
        if self.at_once { rays } else { rays.div_ceil(2) }
    }

    /// Half of the rays of the vertices.
    pub(super) fn look(&self, light: &DiffuseLight, spots: &Spots) -> Vertices {
        let Displayed { mesh, origin, .. } = &self.displayed;
        let (draft, params, sharing) = (self.draft, self.params, self.shared.sharing);
        let (mut usual, mut trust) = vertex_budgets(draft, &self.displayed, self.hidden, params, self.whole);
        for (i, &v) in origin.iter().enumerate().filter(|(_, v)| sharing.shares(**v)) {
            // What they find is only looked at: those that sample for others gather again later.
            usual[i] = if sharing.is_asked(v) { params.vertex_rays.div_ceil(3) } else { 0 };
            trust[i] = SHARED_TRUST;
        }
        let (shares, own): (Vec<u32>, Vec<u32>) = (0..origin.len() as u32)
            .filter(|&i| usual[i as usize] > 0)
            .partition(|&i| sharing.shares(origin[i as usize]));
        let mut rays = usual.clone();
        own.iter().for_each(|&i| rays[i as usize] = self.first_rays(usual[i as usize]));
        let mut place = vec![u32::MAX; origin.len()];
        for (index, &i) in own.iter().chain(&shares).enumerate() {
            place[i as usize] = index as u32;
        }
        let mut gathered = vec![Gathered::default(); mesh.vertices.len()];
        let (of_groups, of_leads): (Vec<(Gathered, Links)>, Vec<Findings>) = shares
            .par_iter()
            .with_min_len(8)
            .with_max_len(JOB)
            .map(|&i| {
                let mut witness = Linking::new(rays[i as usize], Findings::default(), spots);
                let found = self.around(light, origin[i as usize], rays[i as usize], 0, None, &mut witness);
                witness.links.scale(1.0 / POINTS_AROUND as f32);
                ((found, witness.links), witness.findings)
            })
            .unzip();
        let (first, mut findings): (Vec<(Gathered, Links)>, Vec<Findings>) = own
            .par_iter()
            .with_min_len(8)
            .with_max_len(JOB)
            .map(|&i| {
                let v = origin[i as usize];
                let receiver = draft.gatherer(self.lights.tracer(), v);
                let first = rays[i as usize];
                let mut witness = Linking::new(first, Findings::default(), spots);
                let found = self.gather(light, &receiver, 0..first, None, u64::from(v), &mut witness);
                ((found, witness.links), witness.findings)
            })
            .unzip();
        findings.extend(of_leads);
        let mut links = vec![Links::default(); mesh.vertices.len()];
        for (&i, (found, seen)) in shares.iter().chain(&own).zip(of_groups.into_iter().chain(first)) {
            gathered[i as usize] = found;
            links[i as usize] = seen;
        }
        Vertices { gathered, rays, usual, trust, own, findings, links, place }
    }

    /// The guides of the vertices that gather for themselves, by what their neighbours found; of those that are `asked`. A vertex's own rays
    /// have no say in it, or those that missed what is bright would be content.
    pub(super) fn guides(
        &self,
        vertices: &Vertices,
        spots: &Spots,
        asked: impl Fn(u32) -> bool + Sync,
    ) -> Vec<Option<Guide>> {
        let Displayed { origin, .. } = &self.displayed;
        let beside = |&i: &u32| {
            let receiver = self.draft.gatherer(self.lights.tracer(), origin[i as usize]);
            let hints = |known| self.hints(spots, &receiver, known, u64::from(origin[i as usize]));
            vertices.guide(self.beside(i), hints)
        };
        let guide = |i: &u32| asked(*i).then(|| beside(i));
        vertices.own.par_iter().with_max_len(JOB).map(guide).collect()
    }

    /// The other corners of the elements around a display vertex, some of them twice.
    fn beside(&self, vertex: u32) -> impl Iterator<Item = u32> {
        let Displayed { mesh, origin, .. } = &self.displayed;
        let around = self.hats.around(origin[vertex as usize]).iter();
        around.flat_map(|&e| mesh.elements[e as usize].vertices).filter(move |&other| other != vertex)
    }

    /// Whether neighbours of a vertex found, or looked for, what was not known when its rays were sent.
    pub(super) fn is_surprised(&self, vertices: &Vertices, budget: &Budget, vertex: u32) -> bool {
        let Vertices { gathered, rays, usual, .. } = vertices;
        let [own_rays, own_usual] = [rays, usual].map(|of| u64::from(of[vertex as usize]));
        let known = budget.least[vertex as usize] + budget.floor;
        // Those that share look for nothing themselves.
        let mut looked = self.beside(vertex).map(|other| other as usize).filter(|&other| rays[other] > 0);
        !self.at_once
            && looked.any(|other| {
                let found = &gathered[other];
                let is_noisy = found.noise.sqrt() > NOISY * (found.indirect.element_sum() + known);
                is_noisy || u64::from(rays[other]) * own_usual >= MORE * own_rays * u64::from(usual[other])
            })
    }

    /// Where small bright places are seen from a gather, if they add to the variance of a ray that is known.
    fn hints(&self, spots: &Spots, receiver: &Receiver, known: f32, entity: u64) -> Hints {
        let key = Key::new(self.params.seed, Purpose::Hemisphere, entity | SPOTS);
        spots.seen_from(self.lights, receiver, known, key)
    }

    /// How many rays go where, by what the vertices found. `sources`: light of the sources per draft vertex; `mean`: of all light.
    pub(super) fn budget(
        &self,
        vertices: &Vertices,
        guides: &[Option<Guide>],
        sources: &[Rgb],
        mean: f32,
    ) -> Budget {
        let Displayed { mesh, origin, .. } = &self.displayed;
        let floor = FLOOR * mean;
        let least = least_beside(mesh, |v| sources[origin[v as usize] as usize].element_sum());
        let area = areas_around(mesh);
        let deviations = vertices
            .own
            .iter()
            .map(|&i| i as usize)
            .zip(guides)
            .filter_map(|(i, guide)| guide.as_ref().map(|guide| (i, guide)))
            .filter(|(i, _)| !self.hidden[origin[*i] as usize])
            // A field of large triangles must not decide how many rays the house gets.
            .map(|(i, guide)| {
                (relative_deviation(guide, least[i] + floor), area[i].min(2.0 * self.draft.most_weight))
            });
        Budget { allocation: Allocation::new(deviations), least, floor }
    }

    /// More rays of the vertices that have guides, as many as these call for, where they point to.
    pub(super) fn look_again(
        &self,
        light: &DiffuseLight,
        vertices: &mut Vertices,
        guides: &[Option<Guide>],
        spots: &Spots,
        budget: &Budget,
    ) {
        if !self.at_once {
            let Vertices { gathered, rays, usual, own, findings, links, .. } = vertices;
            let more: Vec<Option<Again>> = own
                .par_iter()
                .zip(guides)
                .zip(findings)
                .with_min_len(8)
                .with_max_len(JOB)
                .map(|((&i, guide), findings)| {
                    let guide = guide.as_ref()?;
                    let (v, before) = (self.displayed.origin[i as usize], gathered[i as usize]);
                    let known = rays[i as usize];
                    let deviation = budget.deviation(guide, budget.least[i as usize]);
                    let all = budget.allocation.rays(usual[i as usize], deviation);
                    if all <= known {
                        return None;
                    }
                    let receiver = self.draft.gatherer(self.lights.tracer(), v);
                    let mut witness = Linking::new(all - known, std::mem::take(findings), spots);
                    let more =
                        self.gather(light, &receiver, known..all, Some(guide), u64::from(v), &mut witness);
                    *findings = witness.findings;
                    // Each counts by the inverse of its variance; all known ones as if none was guided.
                    let [even, guided] = [guide.even_deviation(), guide.deviation()].map(|d| d * d);
                    let (one, other) = (known as f32 * guided, (all - known) as f32 * even);
                    let share = one / (one + other).max(f32::MIN_POSITIVE);
                    witness.links.scale(1.0 - share);
                    Some(Again { found: before.mixed(&more, share), share, links: witness.links, rays: all })
                })
                .collect();
            for (&i, again) in own.iter().zip(more) {
                let i = i as usize;
                let Some(again) = again else { continue };
                gathered[i] = again.found;
                rays[i] = again.rays;
                links[i].scale(again.share);
                links[i].append(again.links);
            }
        }
    }

    /// Shared vertices get what is known around them.
    pub(super) fn share(&self, vertices: &mut Vertices) {
        self.shared.fill(&self.displayed, &mut vertices.gathered);
    }

    /// Gathers at points inside the elements.
    pub(super) fn inside(
        &self,
        light: &DiffuseLight,
        samples: &[FitSample],
        vertices: &Vertices,
        spots: &Spots,
        budget: &Budget,
    ) -> Inside {
        let turns = turns(self.lights.tracer(), self.draft, &self.displayed, samples);
        let (gathered, rays) = samples
            .par_iter()
            .enumerate()
            .with_min_len(4)
            .with_max_len(JOB)
            .map(|(index, s)| {
                let receiver =
                    self.draft.receiver_inside(self.lights.tracer(), &self.displayed, s.element, s.weights);
                let corners = self.displayed.mesh.elements[s.element as usize].vertices;
                let entity = index as u64 | AT_SAMPLE;
                let guide =
                    vertices.guide(corners.into_iter(), |known| self.hints(spots, &receiver, known, entity));
                let least = corners.iter().map(|&v| budget.least[v as usize]).fold(f32::INFINITY, f32::min);
                let rays = budget.allocation.rays(self.params.gather_rays, budget.deviation(&guide, least));
                let rays = if self.at_once { rays.max(CONTROLLED_RAYS) } else { rays };
                let part = part(turns[index], rays);
                (self.gather(light, &receiver, part, Some(&guide), AT_SAMPLE, &mut ()), rays)
            })
            .unzip();
        Inside { gathered, rays }
    }

    /// The guide of a vertex that samples for others, by what it and those that share with its neighbours found.
    fn lead_guide(&self, vertices: &Vertices, spots: &Spots, lead: u32) -> Guide {
        let Displayed { mesh, origin, .. } = &self.displayed;
        let sharing = self.shared.sharing;
        let around = self.hats.around(lead).iter().flat_map(|&e| mesh.elements[e as usize].vertices);
        let mut beside: Vec<u32> = around
            .flat_map(|i| {
                let v = origin[i as usize];
                sharing
                    .parts(v)
                    .iter()
                    .filter(|part| part.1 > 0.0)
                    .map(|part| part.0)
                    .chain(sharing.is_asked(v).then_some(v))
            })
            .map(|v| self.shared.shown[v as usize])
            .collect();
        beside.sort_unstable();
        beside.dedup();
        let receiver = self.draft.gatherer(self.lights.tracer(), lead);
        let entity = u64::from(lead) | AROUND_LEAD;
        vertices.guide(beside.into_iter(), |known| self.hints(spots, &receiver, known, entity))
    }

    /// Shared vertices have no points inside: those that sample for the others gather once more.
    pub(super) fn lead(&self, light: &DiffuseLight, vertices: &mut Vertices, spots: &Spots, budget: &Budget) {
        let leads = self.shared.sharing.leads();
        let again: Vec<Gathered> = leads
            .par_iter()
            .with_min_len(4)
            .with_max_len(JOB)
            .map(|&v| {
                let guide = self.lead_guide(vertices, spots, v);
                let least = budget.least[self.shared.shown[v as usize] as usize];
                // Never fewer than usual: no points inside and no fit smooth what they find.
                let usual = self.params.gather_rays;
                let rays = budget.allocation.rays(usual, budget.deviation(&guide, least)).max(usual);
                let rays = if self.at_once { rays.max(CONTROLLED_RAYS) } else { rays };
                self.around(light, v, rays, AROUND_LEAD, Some(&guide), &mut ())
            })
            .collect();
        for (&lead, found) in leads.iter().zip(again) {
            vertices.gathered[self.shared.shown[lead as usize] as usize] = found;
        }
        self.share(vertices);
    }
}

/// More rays of a vertex.
struct Again {
    /// What all its rays found.
    found: Gathered,
    /// What those before count.
    share: f32,
    /// What those after met, by what they count.
    links: Links,
    /// All rays.
    rays: u32,
}

impl Vertices {
    /// What irradiance per vertex of `mesh`, which the gathers look at, brings to each vertex.
    pub(super) fn linked(&self, gathers: &Gathers, mesh: &DisplayMesh, irradiance: &[Rgb]) -> Vec<Rgb> {
        let own = |links: &Links| links.gathered(mesh, irradiance);
        let mut all: Vec<Rgb> = self.links.par_iter().with_min_len(256).map(own).collect();
        gathers.shared.mix(&gathers.displayed, &mut all, |sum, value, weight| *sum += *value * weight);
        all
    }

    /// The guide by what some display vertices found.
    fn guide(&self, vertices: impl Iterator<Item = u32>, hints: impl FnOnce(f32) -> Hints) -> Guide {
        let (mut all, mut sum, mut count) = (Findings::default(), Gathered::default(), 0.0_f32);
        for v in vertices {
            if let Some(own) = self.findings.get(self.place[v as usize] as usize) {
                all.merge(own);
                sum.add(&self.gathered[v as usize], 1.0);
                count += 1.0;
            }
        }
        let mut expected = Gathered::default();
        expected.add(&sum, 1.0 / count.max(1.0));
        Guide::new(&all, &hints(all.variance()), expected)
    }
}

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

#[cfg(test)]
mod tests {
    use catoptric_light::LightParams;
    use catoptric_scene::{Scene, Silent};
    use catoptric_solution::Quality;
    use catoptric_trace::Tracer;
    use glam::Vec3;

    use super::super::tests::floor;
    use super::*;

    #[test]
    fn vertices_beside_what_was_not_known_look_again_and_no_others() {
        let scene = Scene::new(floor().0).expect("a valid scene");
        let tracer = Tracer::new(&scene);
        let lights = Lights::new(&tracer, LightParams::default());
        let draft = Draft::new(&tracer, 0.5);
        let hidden = vec![false; draft.vertices.len()];
        let params = SolveParams::for_quality(Quality::Standard);
        let sharing = Sharing::default();
        let gathers = Gathers::new(&lights, &draft, &hidden, &sharing, &params, 0.5, &Silent);
        let count = gathers.displayed.origin.len();
        let budget =
            Budget { allocation: Allocation::new(std::iter::empty()), least: vec![1.0; count], floor: 0.0 };
        let calm = || Vertices {
            gathered: vec![Gathered { indirect: Rgb::ONE, noise: 0.01, ..Gathered::default() }; count],
            rays: vec![8; count],
            usual: vec![16; count],
            trust: vec![1.0; count],
            own: (0..count as u32).collect(),
            findings: Vec::new(),
            links: Vec::new(),
            place: vec![u32::MAX; count],
        };
        let surprised = |vertices: &Vertices| -> Vec<u32> {
            (0..count as u32).filter(|&v| gathers.is_surprised(vertices, &budget, v)).collect()
        };
        assert!(surprised(&calm()).is_empty());
        let place = |v: &usize| gathers.displayed.mesh.vertices[*v].position;
        let middle = Vec3::new(2.0, 0.0, 2.0);
        let off = |v: &usize| place(v).distance(middle);
        let one = (0..count).min_by(|a, b| off(a).total_cmp(&off(b))).expect("the floor has vertices");
        let mut beside: Vec<u32> = gathers.beside(one as u32).collect();
        beside.sort_unstable();
        beside.dedup();
        assert!(beside.len() >= 4 && beside.len() < count / 2);
        // Four times the rays; or a deviation of a tenth of all light: 3 that it found, channels added, and 1 of sources.
        for (rays, noise, expected) in
            [(31, 0.01, &[][..]), (32, 0.01, &beside), (8, 0.159, &[]), (8, 0.161, &beside)]
        {
            let mut vertices = calm();
            vertices.rays[one] = rays;
            vertices.gathered[one].noise = noise;
            assert_eq!(surprised(&vertices), expected, "{rays} {noise}");
        }
        // One that takes its light from others.
        let mut vertices = calm();
        (vertices.rays[one], vertices.usual[one]) = (0, 0);
        vertices.gathered[one] = Gathered::default();
        assert!(!surprised(&vertices).iter().any(|v| beside.contains(v)));
    }
}
