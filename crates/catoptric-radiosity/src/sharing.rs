//! Vertices of meshes that are much finer than the light on them share their samples: one of each group is asked, the
//! others take the mean of the asked ones around them. The cost of pass one follows the area and the budget, not the
//! triangle count.

use std::collections::HashMap;

use glam::Vec3;
use rayon::prelude::*;

use catoptric_scene::Rgb;
use catoptric_trace::{PlaneId, Ray, Tracer};

use crate::JOB;
use crate::draft::Draft;

/// Which vertices sample for others.
#[derive(Clone, Debug, Default)]
pub struct Sharing {
    /// Per draft vertex: its place in `mixes`; `ASKED` if it samples itself.
    mix_of: Vec<u32>,
    /// Asked vertices that a vertex takes its light from, with weights that sum to one.
    mixes: Vec<Mix>,
    /// Vertices that others take light from, ascending.
    leads: Vec<u32>,
    /// What a mean around each of them is made of, likewise.
    around_leads: Vec<Mix>,
    /// Per draft vertex: it takes or gives.
    shares: Vec<bool>,
    cell: f32,
}

/// Up to four leads with their weights; unused ones weigh nothing.
type Mix = [(u32, f32); 4];

const ASKED: u32 = u32::MAX;

/// Where vertices must agree to share: place, direction, side, medium, and how closely something covers them.
type GroupKey = ([i32; 3], [i8; 3], u32);

/// Normals of vertices that share directly are within about half of this (as a difference of unit vectors).
const NORMAL_STEP: f32 = 0.5;
/// Leads whose normals turn away further than this cosine do not count for a vertex.
const MIN_COS: f32 = 0.7;
/// Flat faces below this share of the spacing squared are details; larger ones are cut at contacts on purpose.
const DETAIL: f32 = 0.25;
/// Rounds in which the cells grow until the budget holds.
const MAX_ROUNDS: u32 = 24;

/// A vertex that samples for its group.
struct Lead {
    vertex: u32,
    position: Vec3,
    normal: Vec3,
    /// How closely something covers it: [`Covers::closeness`].
    covered: f32,
}

/// What light does under what covers it more and more closely.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Covers {
    /// It ends somewhere, as that of a lamp does: steps of height keep apart.
    Part,
    /// It dies away: heights that are alike share.
    Dim,
}

impl Covers {
    /// How closely something covers a vertex, by the logarithm of its height: 0 where nothing does within a cell, more by one for each of
    /// [`COVERS`] that it is below.
    fn closeness(self, free: f32, cell: f32) -> f32 {
        match self {
            Self::Part => COVERS.iter().filter(|cover| free < **cover * cell).count() as f32,
            Self::Dim => (-0.5 * libm::log2f(free / cell)).clamp(0.0, COVERS.len() as f32),
        }
    }

    /// Difference of that from which on nothing is shared.
    fn reach(self) -> f32 {
        match self {
            Self::Part => 1.0,
            Self::Dim => 1.25,
        }
    }
}

impl Sharing {
    /// Groups the vertices of fine meshes by cubes of `cell` metres, larger ones if more than `budget` groups came of
    /// it. `alone`: vertices that neither take nor give. Those that do not see each other do not share, nor do those that are not covered alike
    /// where the budget holds all such groups.
    pub fn new(
        tracer: &Tracer,
        draft: &Draft,
        spacing: f32,
        cell: f32,
        covers: Covers,
        budget: usize,
        alone: &[bool],
    ) -> Self {
        let eligible = eligible(draft, spacing, alone);
        let mut free = free_heights(tracer, draft, &eligible);
        let mut cell = cell;
        let mut members = group(draft, &eligible, &free, cell);
        let are_too_many = |members: &[(GroupKey, u32)]| members.chunk_by(|a, b| a.0 == b.0).count() > budget;
        if are_too_many(&members) {
            // Smaller cells are worth more: in dense foliage all leaves are covered by some.
            free.fill(f32::INFINITY);
            members = group(draft, &eligible, &free, cell);
        }
        for _ in 0..MAX_ROUNDS {
            if !are_too_many(&members) {
                break;
            }
            cell *= 1.5;
            members = group(draft, &eligible, &free, cell);
        }

        // The member nearest to the middle leads.
        let mut around: HashMap<([i32; 3], u32), Vec<Lead>> = HashMap::new();
        let mut led: Vec<(u32, u32)> = Vec::new();
        for group in members.chunk_by(|a, b| a.0 == b.0) {
            let position = |m: &(GroupKey, u32)| draft.vertices[m.1 as usize].position;
            let mean = group.iter().map(position).sum::<Vec3>() / group.len() as f32;
            let off = |m: &(GroupKey, u32)| (position(m) - mean).length_squared();
            let nearest = group.iter().min_by(|a, b| off(a).total_cmp(&off(b)).then(a.1.cmp(&b.1)));
            let vertex = nearest.map_or(group[0].1, |m| m.1);
            let own = &draft.vertices[vertex as usize];
            let (place, _, kind) = group[0].0;
            around.entry((place, kind >> COVER_BITS)).or_default().push(Lead {
                vertex,
                position: own.position,
                normal: own.normal,
                covered: covers.closeness(free[vertex as usize], cell),
            });
            led.extend(group.iter().filter(|m| m.1 != vertex).map(|m| (m.1, vertex)));
        }
        let mixes: Vec<Mix> = led
            .par_iter()
            .with_min_len(64)
            .with_max_len(8 * JOB)
            .map(|&(v, own)| seen(tracer, draft, v, cell, mix(draft, v, own, &free, covers, cell, &around)))
            .collect();

        let count = draft.vertices.len();
        let mut sharing = Self {
            mix_of: vec![ASKED; count],
            mixes,
            leads: Vec::new(),
            around_leads: Vec::new(),
            shares: vec![false; count],
            cell,
        };
        for (index, (&(member, _), mix)) in led.iter().zip(&sharing.mixes).enumerate() {
            if mix.iter().all(|part| part.1 == 0.0) {
                continue;
            }
            sharing.mix_of[member as usize] = index as u32;
            sharing.shares[member as usize] = true;
            sharing.leads.extend(mix.iter().filter(|part| part.1 > 0.0).map(|part| part.0));
        }
        sharing.leads.sort_unstable();
        sharing.leads.dedup();
        for &lead in &sharing.leads {
            sharing.shares[lead as usize] = true;
        }
        sharing.around_leads = sharing
            .leads
            .par_iter()
            .with_min_len(64)
            .with_max_len(8 * JOB)
            .map(|&v| seen(tracer, draft, v, cell, mix(draft, v, v, &free, covers, cell, &around)))
            .collect();
        sharing
    }

    /// Size of the cubes, metres.
    pub fn cell(&self) -> f32 {
        self.cell
    }

    /// The vertices that others take light from.
    pub fn leads(&self) -> &[u32] {
        &self.leads
    }

    /// Per lead: what its light is made of where it is not exact, itself and those around it.
    pub fn around_leads(&self) -> impl Iterator<Item = (u32, &[(u32, f32)])> {
        self.leads.iter().zip(&self.around_leads).map(|(&lead, mix)| (lead, &mix[..]))
    }

    /// What a vertex takes its light from; nothing if it is asked itself.
    pub fn parts(&self, vertex: u32) -> &[(u32, f32)] {
        match self.mix_of.get(vertex as usize) {
            None | Some(&ASKED) => &[],
            Some(&index) => &self.mixes[index as usize],
        }
    }

    /// Whether a vertex is asked itself.
    pub fn is_asked(&self, vertex: u32) -> bool {
        self.parts(vertex).is_empty()
    }

    /// Whether a vertex is part of a fine mesh that shares.
    pub fn shares(&self, vertex: u32) -> bool {
        self.shares.get(vertex as usize).copied().unwrap_or(false)
    }

    /// Has a vertex asked itself from now on. Those that were made later than this are.
    pub fn ask(&mut self, vertex: u32) {
        if let Some(mix) = self.mix_of.get_mut(vertex as usize) {
            *mix = ASKED;
        }
    }

    /// Has a vertex asked itself from now on, as one whose light varies around it as on any other mesh.
    pub fn part(&mut self, vertex: u32) {
        self.ask(vertex);
        if let Some(shares) = self.shares.get_mut(vertex as usize) {
            *shares = false;
        }
    }

    /// Gives every vertex that is not asked the mean of the asked ones around it.
    pub fn fill<T: Copy>(&self, values: &mut [T], mean: impl Fn(&mut dyn Iterator<Item = (T, f32)>) -> T) {
        for vertex in 0..values.len().min(self.mix_of.len()) {
            let parts = self.parts(vertex as u32);
            if !parts.is_empty() {
                let value = mean(&mut parts.iter().map(|&(lead, w)| (values[lead as usize], w)));
                values[vertex] = value;
            }
        }
    }
}

/// The nearest leads around a vertex that look the same way; its own counts at least a little.
fn mix(
    draft: &Draft,
    member: u32,
    own: u32,
    free: &[f32],
    covers: Covers,
    cell: f32,
    around: &HashMap<([i32; 3], u32), Vec<Lead>>,
) -> Mix {
    let at = &draft.vertices[member as usize];
    let (place, kind) = (place(at.position, cell), kind(draft, free, cell, member) >> COVER_BITS);
    let covered = covers.closeness(free[member as usize], cell);
    let mut mix = [(own, 0.0_f32); 4];
    for offset in 0..27 {
        let shift = [offset % 3 - 1, offset / 3 % 3 - 1, offset / 9 - 1];
        let near: [i32; 3] = std::array::from_fn(|i| place[i].saturating_add(shift[i]));
        for lead in around.get(&(near, kind)).map_or(&[][..], Vec::as_slice) {
            let along = (at.normal.dot(lead.normal) - MIN_COS) / (1.0 - MIN_COS);
            let floor = if lead.vertex == own { 1e-3 } else { 0.0 };
            if along <= 0.0 && floor == 0.0 {
                continue;
            }
            let offset = lead.position - at.position;
            let inside = 1.0 - offset.length() / (2.0 * cell);
            // Another layer sees other things.
            let level = 1.0 - at.normal.dot(offset).abs() / (0.5 * cell);
            let alike = 1.0 - (covered - lead.covered).abs() / covers.reach();
            let weight =
                (inside.max(0.0).powi(2) * level.max(0.0) * along.max(0.0) * alike.max(0.0)).max(floor);
            // The strongest four stay.
            let mut next = (lead.vertex, weight);
            for slot in &mut mix {
                if next.1 > slot.1 {
                    std::mem::swap(slot, &mut next);
                }
            }
        }
    }
    let sum: f32 = mix.iter().map(|part| part.1).sum();
    if sum > 0.0 {
        mix.map(|(lead, weight)| (lead, weight / sum))
    } else {
        [(own, 1.0), (own, 0.0), (own, 0.0), (own, 0.0)]
    }
}

/// Height above the surface, in cells, at which vertices that share must see each other: above what curves between them.
const LIFT: f32 = 0.25;
/// Heights, likewise, below which what covers vertices tells them apart: what a leaf lies on another by is in other light than what is free.
/// (By measurement: leaves that cross in a greenhouse were at .88 of their light with the second one alone, at .97 with these.)
const COVERS: [f32; 3] = [1.0, 0.25, 0.0625];

/// A mix without the leads that the vertex does not see: the foot of a leg under a carpet and the leg above it are near to
/// each other, but in other light. No weight at all where none is left.
fn seen(tracer: &Tracer, draft: &Draft, member: u32, cell: f32, mix: Mix) -> Mix {
    let above = |v: u32| {
        let receiver = draft.receiver(tracer, v);
        receiver.position + receiver.normal * (LIFT * cell)
    };
    let own = above(member);
    let sees = |lead: u32| tracer.visibility(own, PlaneId::NONE, above(lead), PlaneId::NONE) != Rgb::ZERO;
    let kept = mix.map(|(lead, weight)| (lead, if weight > 0.0 && sees(lead) { weight } else { 0.0 }));
    let sum: f32 = kept.iter().map(|part| part.1).sum();
    kept.map(|(lead, weight)| (lead, if sum > 0.0 { weight / sum } else { 0.0 }))
}

/// Corners of leaves on curved surfaces and small flat faces.
fn eligible(draft: &Draft, spacing: f32, alone: &[bool]) -> Vec<u32> {
    let mut area = vec![0.0_f32; draft.faces.len()];
    for leaf in &draft.leaves {
        area[leaf.face as usize] += draft.area(leaf);
    }
    let detail =
        |face: u32| draft.faces[face as usize].curved || area[face as usize] < DETAIL * spacing * spacing;
    let on_lines = draft.on_lines();
    let mut used = vec![false; draft.vertices.len()];
    for vertex in draft.leaves.iter().flat_map(|l| l.vertices) {
        used[vertex as usize] = true;
    }
    (0..draft.vertices.len() as u32)
        .filter(|&v| used[v as usize] && !alone.get(v as usize).copied().unwrap_or(false))
        // Seen from a little before the surface, they may be on the other side of what crosses it.
        .filter(|&v| !on_lines[v as usize])
        .filter(|&v| detail(draft.vertices[v as usize].face))
        .collect()
}

/// The vertices with their keys, sorted.
fn group(draft: &Draft, eligible: &[u32], free: &[f32], cell: f32) -> Vec<(GroupKey, u32)> {
    let mut members: Vec<(GroupKey, u32)> = eligible
        .par_iter()
        .with_min_len(1024)
        .map(|&v| {
            let vertex = &draft.vertices[v as usize];
            let direction = (vertex.normal / NORMAL_STEP).round();
            let direction = [direction.x as i8, direction.y as i8, direction.z as i8];
            ((place(vertex.position, cell), direction, kind(draft, free, cell, v)), v)
        })
        .collect();
    members.par_sort_unstable();
    members
}

fn place(position: Vec3, cell: f32) -> [i32; 3] {
    let cube = (position / cell).floor();
    [cube.x as i32, cube.y as i32, cube.z as i32]
}

/// Bits of a kind that tell how closely something covers the vertex.
const COVER_BITS: u32 = 2;

/// Medium, side, and how closely something covers the vertex.
fn kind(draft: &Draft, free: &[f32], cell: f32, vertex: u32) -> u32 {
    let cover = Covers::Part.closeness(free[vertex as usize], cell) as u32;
    let vertex = &draft.vertices[vertex as usize];
    let side = draft.faces[vertex.face as usize].side as u32;
    (u32::from(vertex.medium.0) << 1 | side) << COVER_BITS | cover
}

/// Metres above each eligible vertex in which nothing is; zero for others.
fn free_heights(tracer: &Tracer, draft: &Draft, eligible: &[u32]) -> Vec<f32> {
    let height = |&vertex: &u32| {
        let receiver = draft.receiver(tracer, vertex);
        let ray = Ray { origin: receiver.position, direction: receiver.normal, from: receiver.plane };
        (vertex, tracer.nearest(&ray, f32::INFINITY).map_or(f32::INFINITY, |hit| hit.t))
    };
    let heights: Vec<(u32, f32)> =
        eligible.par_iter().with_min_len(64).with_max_len(8 * JOB).map(height).collect();
    let mut free = vec![0.0; draft.vertices.len()];
    for (vertex, height) in heights {
        free[vertex as usize] = height;
    }
    free
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base_mesh::coarse_patches;
    use crate::draft::DraftVertex;
    use catoptric_scene::{Material, Scene, SceneParts, Side};

    #[test]
    fn a_leg_above_a_rug_does_not_share_with_its_foot_below() {
        let mut parts = SceneParts::default();
        let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
        let thick = 0.012;
        parts.add_quad("floor", white, Vec3::new(-2.0, 0.0, 2.0), Vec3::X * 4.0, Vec3::Z * -4.0);
        parts.add_box("rug", white, Vec3::new(-1.0, 0.0, -1.0), Vec3::new(1.0, thick, 1.0), false);
        parts.add_box("leg", white, Vec3::new(0.1, 0.0, 0.1), Vec3::new(0.14, 0.4, 0.14), false);
        let scene = Scene::new(parts).expect("a valid scene");
        let tracer = Tracer::new(&scene);
        let (draft, _) = coarse_patches(&tracer, 200);
        let sharing = Sharing::new(&tracer, &draft, 0.5, 0.1, Covers::Part, 1000, &[]);
        let side = |v: u32| draft.vertices[v as usize].sample.y > thick;
        let upright = |v: u32| draft.vertices[v as usize].normal.y.abs() < 0.5;
        let mut pairs = 0;
        for v in (0..draft.vertices.len() as u32).filter(|&v| upright(v)) {
            for &(lead, _) in sharing.parts(v).iter().filter(|part| part.1 > 0.0) {
                assert_eq!(side(v), side(lead), "{:?} takes light from {lead}", draft.vertices[v as usize]);
                pairs += 1;
            }
        }
        // The leg is cut at the rug and, above, into pieces of a few cells.
        assert!(pairs > 8, "{pairs}");
    }

    /// Angle between two leaves.
    const TURN: f32 = 15.0 * std::f32::consts::PI / 180.0;

    #[test]
    fn what_a_leaf_covers_of_another_does_not_share_with_what_is_free() {
        let mut parts = SceneParts::default();
        let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
        parts.add_quad("floor", white, Vec3::new(-3.0, -0.5, 3.0), Vec3::X * 6.0, Vec3::Z * -6.0);
        // Two upright leaves that cross in the y axis by fifteen degrees, the second one wider: all of one half of the first is behind it, 8 mm
        // at most.
        let turned = Vec3::new(libm::sinf(TURN), 0.0, libm::cosf(TURN));
        for piece in 0..6 {
            let (from, up) = (Vec3::Y * (0.05 * piece as f32), Vec3::Y * 0.05);
            parts.add_quad("straight", white, from - Vec3::Z * 0.03, up, Vec3::Z * 0.06);
            parts.add_quad("turned", white, from - turned * 0.05, up, turned * 0.1);
        }
        let scene = Scene::new(parts).expect("a valid scene");
        let tracer = Tracer::new(&scene);
        let (draft, _) = coarse_patches(&tracer, 200);
        let sharing = Sharing::new(&tracer, &draft, 0.8, 0.1, Covers::Part, 1000, &[]);
        // What is seen along a normal: the first leaf hides the middle of the other's half.
        let is_free = |v: u32| {
            let Vec3 { x, z, .. } = draft.vertices[v as usize].sample;
            let is_first = x.abs() < 1e-3 * z.abs();
            if is_first { z < 0.0 } else { z > 0.0 || z < -0.03 * libm::cosf(TURN) }
        };
        let mut pairs = [0, 0];
        let faces_x = |v: u32| draft.vertices[v as usize].normal.x > 0.9;
        for v in (0..draft.vertices.len() as u32).filter(|&v| faces_x(v)) {
            for &(lead, _) in sharing.parts(v).iter().filter(|part| part.1 > 0.0) {
                assert_eq!(
                    is_free(v),
                    is_free(lead),
                    "{:?} takes light from {lead}",
                    draft.vertices[v as usize]
                );
                pairs[usize::from(is_free(v))] += 1;
            }
        }
        assert!(pairs[0] > 4 && pairs[1] > 4, "{pairs:?}");
    }

    /// Under a ball on a floor: light that dies away has no steps where heights pass a bound.
    #[test]
    fn light_that_dies_away_has_no_steps() {
        let mut parts = SceneParts::default();
        let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
        parts.add_quad("floor", white, Vec3::new(-2.0, 0.0, 2.0), Vec3::X * 4.0, Vec3::Z * -4.0);
        parts.add_sphere("ball", white, Vec3::new(0.0, 0.2, 0.0), 0.2, 64);
        let scene = Scene::new(parts).expect("a valid scene");
        let tracer = Tracer::new(&scene);
        let (draft, _) = coarse_patches(&tracer, 200);
        let cell = 0.1;
        let false_rise = |covers: Covers| {
            let sharing = Sharing::new(&tracer, &draft, 0.8, cell, covers, 1000, &[]);
            let light = |v: &DraftVertex| -Covers::Dim.closeness(2.0 * v.sample.y, cell);
            let mut values: Vec<f32> = draft.vertices.iter().map(light).collect();
            sharing.fill(&mut values, |parts| parts.map(|(value, weight)| value * weight).sum());
            let is_low = |v: u32| {
                let DraftVertex { sample, normal, .. } = draft.vertices[v as usize];
                sharing.shares(v) && sample.y < 0.05 && normal.y < 0.0
            };
            let rise = |(a, b): (u32, u32)| {
                let own = light(&draft.vertices[a as usize]) - light(&draft.vertices[b as usize]);
                (values[a as usize] - values[b as usize] - own).abs()
            };
            let low = draft.edges().into_iter().filter(|&(a, b)| is_low(a) && is_low(b));
            let squares: Vec<f32> = low.map(|edge| rise(edge).powi(2)).collect();
            assert!(squares.len() > 1000, "{}", squares.len());
            (squares.iter().sum::<f32>() / squares.len() as f32).sqrt()
        };
        // A value that is the same all over a step differs from a slope by 1/√12 of it; the mean of two that are alike, by 1/√2 of that.
        let [parted, dim] = [Covers::Part, Covers::Dim].map(false_rise);
        assert!(dim < parted * std::f32::consts::FRAC_1_SQRT_2, "{dim} {parted}");
    }

    #[test]
    fn nothing_covers_a_ball_not_even_its_own_facets() {
        let mut parts = SceneParts::default();
        let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
        parts.add_sphere("ball", white, Vec3::new(0.3, 0.7, -0.2), 0.4, 24);
        let scene = Scene::new(parts).expect("a valid scene");
        let tracer = Tracer::new(&scene);
        let (draft, _) = coarse_patches(&tracer, 200);
        let outside = |v: &u32| draft.faces[draft.vertices[*v as usize].face as usize].side == Side::Front;
        let vertices: Vec<u32> = eligible(&draft, 0.5, &[]).into_iter().filter(outside).collect();
        let free = free_heights(&tracer, &draft, &vertices);
        assert!(vertices.len() > 100, "{}", vertices.len());
        assert!(vertices.iter().all(|&v| free[v as usize] == f32::INFINITY));
    }

    #[test]
    fn vertices_made_later_are_asked_whatever_is_said_of_them() {
        let mut parts = SceneParts::default();
        let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
        parts.add_box("leg", white, Vec3::new(0.1, 0.0, 0.1), Vec3::new(0.14, 0.4, 0.14), false);
        let scene = Scene::new(parts).expect("a valid scene");
        let tracer = Tracer::new(&scene);
        let (mut draft, _) = coarse_patches(&tracer, 200);
        let mut sharing = Sharing::new(&tracer, &draft, 0.5, 0.1, Covers::Part, 1000, &[]);
        // As elements that hold a glint are split before any is evaluated.
        let edges: Vec<(u32, u32)> = draft.edges();
        let before = draft.vertices.len() as u32;
        draft.split(&tracer, &edges);
        let last = draft.vertices.len() as u32 - 1;
        assert!(last >= before);
        sharing.ask(last);
        sharing.part(last);
        assert!(sharing.is_asked(last) && !sharing.shares(last));
        let old = (0..before).find(|&v| sharing.shares(v)).expect("one that shares");
        sharing.part(old);
        assert!(sharing.is_asked(old) && !sharing.shares(old));
    }
}
