//! Where the mesh must be finer for what deposits tell.
//!
//! A triangle is split where that explains more than noise: P_c − Q_c, what its parts got less what the interpolated
//! values say, is compared with its variance Σ w², the estimate for independent rays.

use rayon::prelude::*;
use rustc_hash::FxHashMap;

use catoptric_scene::{Cancelled, Progress, Rgb};
use catoptric_trace::Tracer;

use crate::JOB;
use crate::caustic::deposit::{Deposits, LEVELS, Part};
use crate::caustic::projection::{Moments, Projection, strength};
use crate::caustic::smooth::POOLING;
use crate::draft::{Draft, Leaf};

/// When triangles are fine enough for the caustic term.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DensityParams {
    /// Vertices at most beyond the base mesh.
    pub max_vertices: usize,
    /// Rounds of splitting.
    pub rounds: u32,
    /// A triangle asks to be split where the squared differences of its four parts, or sixteen, are above these multiples of
    /// their variance: chance alone passes them once in about fifty times. Neighbours must ask as well: what caustics have to show
    /// are lines.
    pub significance: [f32; 2],
    /// The same for a triangle that asks alone: once in about a million times.
    pub certainty: [f32; 2],
    /// … and above this share of the light there, root mean square.
    pub tolerance: f32,
    /// Rays that a triangle must have got, counted by weight.
    pub min_count: f32,
    /// Edges shorter than this are left alone, metres.
    pub min_edge: f32,
    /// Steps from the lumped towards the consistent mass matrix.
    pub sharpening: u32,
}

/// What is known of a leaf: it holds as long as the leaf, its halved edge and the values at its vertices stay.
#[derive(Clone, Copy, Debug, Default)]
struct Known {
    moments: Moments,
    /// Values at corners and middles of edges when it was judged, and the gain of splitting it.
    judged: Option<([f32; 6], Option<Gain>)>,
}

/// What splitting a leaf would explain.
#[derive(Clone, Copy, Debug)]
struct Gain {
    gain: f32,
    /// By itself: no neighbour must ask as well.
    certain: bool,
}

/// Known leaves by code, level and halved edge.
type Memory = FxHashMap<(u64, u32, Option<usize>), Known>;

/// Irradiance at the draft's vertices with the power of the deposits; zero where no leaf has the vertex.
pub(super) fn project(draft: &Draft, deposits: &Deposits, sharpening: u32) -> Vec<Rgb> {
    let lit = Lit::new(draft, deposits);
    let leaves = look(draft, deposits, &lit, &Memory::default());
    projected(draft, &leaves, sharpening).values
}

fn projected(draft: &Draft, leaves: &[Looked], sharpening: u32) -> Projection {
    let leaves = leaves.iter().map(|looked| (&looked.leaf, looked.halved, &looked.known.moments));
    Projection::new(draft, leaves, sharpening)
}

/// Rings of base triangles around what got deposits in which something is not zero: smoothing pools variances so often,
/// moves light on by one, and asks there for all that is around a vertex.
const RINGS: usize = POOLING + 2;

/// The part of a mesh that deposits have to do with: of many leaves, few.
struct Lit {
    /// By base triangle: it got deposits, …
    roots: Vec<bool>,
    /// … or is in a ring around such.
    reached: Vec<bool>,
}

impl Lit {
    fn new(draft: &Draft, deposits: &Deposits) -> Self {
        let mut roots = vec![false; draft.base.len()];
        deposits.roots().for_each(|root| roots[root as usize] = true);
        let mut reached = roots.clone();
        let mut touched = vec![false; draft.vertices.len()];
        for _ in 0..RINGS {
            for (corners, _) in draft.base.iter().zip(&reached).filter(|(_, reached)| **reached) {
                corners.iter().for_each(|&v| touched[v as usize] = true);
            }
            for (corners, reached) in draft.base.iter().zip(&mut reached) {
                *reached |= corners.iter().any(|&v| touched[v as usize]);
            }
        }
        Self { roots, reached }
    }
}

/// A leaf with its place among the deposits.
#[derive(Clone, Copy, Debug)]
struct Looked {
    /// Which leaf of the draft.
    index: u32,
    leaf: Leaf,
    part: Part,
    /// Which edge is halved, and the vertex there.
    halved: Option<(usize, u32)>,
    known: Known,
}

impl Looked {
    /// What it is known by.
    fn key(&self) -> (u64, u32, Option<usize>) {
        (self.part.code, self.part.level, self.halved.map(|h| h.0))
    }
}

/// The moments of every leaf that deposits have to do with.
fn look(draft: &Draft, deposits: &Deposits, lit: &Lit, memory: &Memory) -> Vec<Looked> {
    let reached = |leaf: &&Leaf| lit.reached[leaf.root as usize];
    let indices: Vec<u32> =
        draft.leaves.iter().zip(0..).filter(|(leaf, _)| reached(leaf)).map(|(_, index)| index).collect();
    indices
        .par_iter()
        .with_min_len(64)
        .with_max_len(8 * JOB)
        .map(|&index| {
            let leaf = draft.leaves[index as usize];
            let part = Part::of(draft, &leaf);
            let halved = draft.halved_edge(leaf.vertices);
            let mut looked = Looked { index, leaf, part, halved, known: Known::default() };
            if lit.roots[leaf.root as usize] {
                let fresh =
                    || Known { moments: Moments::of(deposits, part, halved.map(|h| h.0)), judged: None };
                looked.known = memory.get(&looked.key()).copied().unwrap_or_else(fresh);
            }
            looked
        })
        .collect()
}

/// Splits triangles until what is left is noise, small, or the budget is spent. `other` is the light of other terms at
/// the vertices of the base mesh: differences are seen against it. Returns the values at the vertices.
pub(super) fn refine(
    tracer: &Tracer,
    draft: &mut Draft,
    deposits: &Deposits,
    other: &[Rgb],
    params: &DensityParams,
    progress: &dyn Progress,
) -> Result<Density, Cancelled> {
    let first = draft.vertices.len();
    let lit = Lit::new(draft, deposits);
    let mut memory = Memory::default();
    for round in 0.. {
        if progress.is_cancelled() {
            return Err(Cancelled);
        }
        let mut leaves = look(draft, deposits, &lit, &memory);
        let mut projection = projected(draft, &leaves, params.sharpening);
        let values = &projection.values;
        leaves.par_iter_mut().with_min_len(64).with_max_len(8 * JOB).for_each(|looked| {
            let at = around(draft, &looked.leaf, values);
            if looked.known.judged.is_none_or(|j| j.0 != at) {
                let gain = gain(draft, deposits, &looked.leaf, looked.part, &at, other, params);
                looked.known.judged = Some((at, gain));
            }
        });
        let mut wanted = wanted(draft, &leaves);
        // The largest gain first, as far as the budget goes: a split makes about one and a half vertices.
        wanted.sort_unstable_by(|x, y| y.0.total_cmp(&x.0).then(x.1.cmp(&y.1)));
        let room = params.max_vertices.saturating_sub(draft.vertices.len() - first);
        wanted.truncate(room * 2 / 3);
        if wanted.is_empty() || round == params.rounds {
            let noise = noise(draft, deposits, &leaves, other);
            let mut light: Vec<f32> = other.iter().map(|&own| strength(own)).collect();
            draft.fill(&mut light, |a, b| 0.5 * (a + b));
            projection.smooth(&light);
            return Ok(Density { values: projection.values, mass: projection.mass, light, noise });
        }
        let marks: Vec<(u32, u32)> = wanted
            .iter()
            .flat_map(|&(_, index)| {
                let [a, b, c] = draft.leaves[index as usize].vertices;
                [(a, b), (b, c), (c, a)]
            })
            .collect();
        draft.split(tracer, &marks);
        // Those that got nothing are as quickly looked at again.
        let lit = leaves.iter().filter(|l| l.known.moments.squares != [0.0; 4]);
        memory = lit.map(|l| (l.key(), l.known)).collect();
    }
    Ok(Density::default())
}

/// Gains of the leaves that are to be split: those that are certain, and those that do not ask alone.
fn wanted(draft: &Draft, leaves: &[Looked]) -> Vec<(f32, u32)> {
    let gain = |looked: &Looked| looked.known.judged.and_then(|j| j.1);
    let mut asked = vec![0_u32; draft.vertices.len()];
    for looked in leaves {
        if gain(looked).is_some() {
            looked.leaf.vertices.iter().for_each(|&v| asked[v as usize] += 1);
        }
    }
    let is_supported =
        |leaf: &Leaf| leaf.vertices.iter().filter(|&&v| asked[v as usize] > 1).count() >= SUPPORTED;
    leaves
        .iter()
        .filter_map(|looked| {
            let Gain { gain, certain } = gain(looked)?;
            (certain || is_supported(&looked.leaf)).then_some((gain, looked.index))
        })
        .collect()
}

/// Corners of a leaf at which others ask, too, if its neighbours do.
const SUPPORTED: usize = 2;

/// The result of refinement.
#[derive(Clone, Debug, Default)]
pub(super) struct Density {
    /// Irradiance at the vertices.
    pub(super) values: Vec<Rgb>,
    /// Area around each vertex / 3.
    mass: Vec<f32>,
    /// Light of other terms at the vertices, channels added.
    light: Vec<f32>,
    /// Standard error of the triangles before smoothing, against the light there, root mean square over what caustics
    /// light.
    pub(super) noise: f32,
}

/// Caustics weaker than this share of the other light do not count.
const LIT: f32 = 0.02;

/// What more rays changed, against the light there, root mean square over what caustics light.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Change {
    /// By area: of large, weak caustics.
    pub by_area: f32,
    /// By area and the square of their light: of small, bright ones, of which area knows nothing.
    pub in_focus: f32,
}

impl Change {
    /// Nothing to compare with.
    pub(super) const UNKNOWN: Self = Self { by_area: f32::INFINITY, in_focus: f32::INFINITY };
}

impl Density {
    /// Difference to what was found `before` on another refinement of the same base mesh, of `first` vertices, against the
    /// light there, over the surface that either says caustics light.
    ///
    /// Noise, its smoothing and detail that had not been told from it all show: an estimate from variances alone is blind
    /// to what smoothing blurred.
    pub(super) fn change(&self, draft: &Draft, before: &Density, coarser: &Draft, first: usize) -> Change {
        // The vertices that both have, by way of their parents: of `coarser` here, then its values at this mesh's.
        let mut there: Vec<Option<u32>> = (0..first as u32).map(Some).collect();
        for vertex in &coarser.vertices[first..] {
            let known = vertex
                .parents
                .and_then(|[a, b]| draft.known_midpoint(there[a as usize]?, there[b as usize]?));
            there.push(known);
        }
        let mut known = vec![None; draft.vertices.len()];
        for (&here, &value) in there.iter().zip(&before.values) {
            if let Some(here) = here {
                known[here as usize] = Some(value);
            }
        }
        let mut old: Vec<Rgb> = Vec::with_capacity(draft.vertices.len());
        for (vertex, known) in draft.vertices.iter().zip(known) {
            let between =
                || vertex.parents.map_or(Rgb::ZERO, |[a, b]| (old[a as usize] + old[b as usize]) * 0.5);
            old.push(known.unwrap_or_else(between));
        }
        let (mut area, mut bright) = ([0.0_f64; 2], [0.0_f64; 2]);
        for (v, (&now, &old)) in self.values.iter().zip(&old).enumerate() {
            let caustic = strength(now).max(strength(old));
            if caustic > LIT * self.light[v] {
                let relative = f64::from(strength(now - old) / (self.light[v] + strength(now)));
                let mass = f64::from(self.mass[v]);
                for (sums, weight) in [(&mut area, mass), (&mut bright, mass * f64::from(caustic).powi(2))] {
                    sums[0] += weight * relative * relative;
                    sums[1] += weight;
                }
            }
        }
        let mean = |[sum, weight]: [f64; 2]| if weight > 0.0 { (sum / weight).sqrt() as f32 } else { 0.0 };
        Change { by_area: mean(area), in_focus: mean(bright) }
    }
}

fn noise(draft: &Draft, deposits: &Deposits, leaves: &[Looked], other: &[Rgb]) -> f32 {
    let (mut sum, mut lit) = (0.0_f64, 0.0_f64);
    for looked in leaves {
        let area = draft.area(&looked.leaf);
        let (power, squares) = totals(deposits, deposits.range(looked.part));
        let background = background(draft, &looked.leaf, other);
        if power > LIT * background * area {
            let light = power + background * area;
            sum += f64::from(area * squares / (light * light));
            lit += f64::from(area);
        }
    }
    if lit > 0.0 { (sum / lit).sqrt() as f32 } else { 0.0 }
}

/// Light of other terms at a leaf.
fn background(draft: &Draft, leaf: &Leaf, other: &[Rgb]) -> f32 {
    draft.base[leaf.root as usize].iter().map(|&v| strength(other[v as usize])).sum::<f32>() / 3.0
}

/// Values at the corners of a leaf, and in the middles of its edges.
fn around(draft: &Draft, leaf: &Leaf, values: &[Rgb]) -> [f32; 6] {
    let corners = leaf.vertices.map(|v| strength(values[v as usize]));
    let middles: [f32; 3] = std::array::from_fn(|k| {
        let (a, b) = (leaf.vertices[k], leaf.vertices[(k + 1) % 3]);
        match draft.marked_midpoint(a, b) {
            Some(m) => strength(values[m as usize]),
            None => 0.5 * (corners[k] + corners[(k + 1) % 3]),
        }
    });
    [corners[0], corners[1], corners[2], middles[0], middles[1], middles[2]]
}

/// How much a split would explain, if that is significant and large enough to be seen.
fn gain(
    draft: &Draft,
    deposits: &Deposits,
    leaf: &Leaf,
    part: Part,
    around: &[f32; 6],
    other: &[Rgb],
    params: &DensityParams,
) -> Option<Gain> {
    let area = draft.area(leaf);
    if part.level + 2 > LEVELS || area < 0.4 * params.min_edge * params.min_edge {
        return None;
    }
    let range = deposits.range(part);
    if range.is_empty() {
        return None;
    }
    let (sum, squares) = totals(deposits, range.clone());
    if sum * sum < params.min_count * squares {
        return None;
    }
    // Parts in the order of the codes, with the values at their corners.
    let [a, b, c, ab, bc, ca] = *around;
    let parts = [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]];
    let background = background(draft, leaf, other);
    let light = sum / area + background;
    let mut best: Option<Gain> = None;
    let mut judge = |difference: f32, variance: f32, cells: f32, which: usize| {
        // Root mean square of the irradiance that is not explained, noise taken off.
        let unexplained = (difference - variance).max(0.0) * cells;
        let relative = unexplained.sqrt() / (area * light.max(f32::MIN_POSITIVE));
        if difference > params.significance[which] * variance && relative > params.tolerance {
            let gain = unexplained / area / light.max(f32::MIN_POSITIVE);
            let certain = difference > params.certainty[which] * variance;
            best = Some(best.map_or(Gain { gain, certain }, |b| Gain {
                gain: b.gain.max(gain),
                certain: b.certain || certain,
            }));
        }
    };
    let (mut coarse, mut fine) = ((0.0, 0.0), (0.0, 0.0));
    for (index, values) in parts.iter().enumerate() {
        let child = part.child(index as u64);
        let within = deposits.range_within(child, &range);
        let (got, variance) = totals(deposits, within.clone());
        let expected = area / 4.0 * (values[0] + values[1] + values[2]) / 3.0;
        coarse.0 += (got - expected) * (got - expected);
        coarse.1 += variance;
        let [p, q, r] = *values;
        let [pq, qr, rp] = [0.5 * (p + q), 0.5 * (q + r), 0.5 * (r + p)];
        for (index, values) in [[p, pq, rp], [pq, q, qr], [rp, qr, r], [pq, qr, rp]].iter().enumerate() {
            let (got, variance) = totals(deposits, deposits.range_within(child.child(index as u64), &within));
            let expected = area / 16.0 * (values[0] + values[1] + values[2]) / 3.0;
            fine.0 += (got - expected) * (got - expected);
            fine.1 += variance;
        }
    }
    judge(coarse.0, coarse.1, 4.0, 0);
    judge(fine.0, fine.1, 16.0, 1);
    best
}

/// Σ w and Σ w² of a range.
fn totals(deposits: &Deposits, range: std::ops::Range<usize>) -> (f32, f32) {
    deposits.powers(range).iter().fold((0.0, 0.0), |(sum, squares), power| {
        let w = power.element_sum();
        (sum + w, squares + w * w)
    })
}

#[cfg(test)]
mod tests {
    use catoptric_scene::{Material, Scene, SceneParts, Silent};
    use catoptric_solution::Quality;
    use catoptric_trace::sequence::{Key, Purpose};
    use glam::{Vec2, Vec3};

    use super::*;
    use crate::caustic::CausticParams;
    use crate::caustic::deposit::Deposit;

    /// Leaves of a sheet of 1 m that random rays, `each` for a leaf, would split in one round, where beyond a line light is `step`
    /// times as strong: shares of those that the line crosses, and of the others.
    fn split(each: u32, step: f32, seed: u32) -> [f64; 2] {
        let mut parts = SceneParts::default();
        let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
        parts.add_quad("sheet", white, Vec3::ZERO, Vec3::X, Vec3::Y);
        let scene = Scene::new(parts).expect("a valid scene");
        let tracer = Tracer::new(&scene);
        let mut draft = Draft::new(&tracer, 0.05);
        let beyond = |p: Vec3| p.x + 0.3 * p.y > 0.6;
        let crossed = |draft: &Draft, leaf: &Leaf| {
            let count =
                leaf.vertices.iter().filter(|&&v| beyond(draft.vertices[v as usize].position)).count();
            count == 1 || count == 2
        };
        let mut deposits = Vec::new();
        for leaf in &draft.leaves {
            let key = Key::new(seed, Purpose::Test, u64::from(leaf.root));
            for ray in 0..2 * each {
                let s = Vec2::new(key.uniform(3 * ray), key.uniform(3 * ray + 1));
                let (u, v) = if s.x + s.y > 1.0 { (1.0 - s.x, 1.0 - s.y) } else { (s.x, s.y) };
                let [a, b, c] = leaf.vertices.map(|v| draft.vertices[v as usize].position);
                let strength = if beyond(a + (b - a) * u + (c - a) * v) { step } else { 1.0 };
                // Rays of one power: more of them where light is stronger.
                if key.uniform(3 * ray + 2) < 0.5 * strength {
                    let (u, v) = (f64::from(u), f64::from(v));
                    deposits.push(Deposit::of(leaf.root, [1.0 - u - v, u, v], Rgb::ONE));
                }
            }
        }
        let leaves = draft.leaves.clone();
        let is_crossed: Vec<bool> = leaves.iter().map(|leaf| crossed(&draft, leaf)).collect();
        let params = DensityParams { rounds: 1, ..CausticParams::for_quality(Quality::High).density };
        let dark = vec![Rgb::ZERO; draft.vertices.len()];
        refine(&tracer, &mut draft, &Deposits::new(&deposits, 1.0), &dark, &params, &Silent)
            .expect("not stopped");
        // What conformity asked for is not counted: only leaves of which all three edges are halved were split for their own sake.
        let was_split = |leaf: &Leaf| !draft.leaves.iter().any(|l| l.root == leaf.root && l.level == 0);
        [true, false].map(|wanted| {
            let of: Vec<&Leaf> =
                leaves.iter().zip(&is_crossed).filter(|l| *l.1 == wanted).map(|l| l.0).collect();
            of.iter().filter(|leaf| was_split(leaf)).count() as f64 / of.len().max(1) as f64
        })
    }

    #[test]
    fn lines_of_light_are_told_from_noise() {
        for seed in 0..4 {
            // By either test a leaf asks by chance once in fifty times; that a neighbour does across an edge, or others at both ends of
            // one, is a tenth of that.
            let [_, noise] = split(1000, 1.0, seed);
            assert!(noise < 0.01, "{noise}");
            // A line leaves up to a fifth of a leaf's light on the wrong side, 300 of 1450 rays where chance is 38; at the corners that
            // it cuts off it leaves less.
            let [line, beside] = split(1000, 1.9, seed);
            assert!(line > 0.85 && beside < 0.05, "{line} {beside}");
        }
    }

    /// What few deposits do to a large mesh is the same where all of it is looked at.
    #[test]
    fn beyond_the_rings_nothing_happens() {
        let mut parts = SceneParts::default();
        let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
        parts.add_quad("sheet", white, Vec3::ZERO, Vec3::X, Vec3::Y);
        let scene = Scene::new(parts).expect("a valid scene");
        let draft = Draft::new(&Tracer::new(&scene), 0.03);
        let middle = |leaf: &&Leaf| draft.center(leaf).distance(Vec3::new(0.5, 0.5, 0.0)) < 0.1;
        let key = Key::new(0, Purpose::Test, 0);
        // One ray each, of uneven power: all is noise, and smoothed as far as it goes.
        let deposits: Vec<Deposit> = draft
            .leaves
            .iter()
            .filter(middle)
            .map(|leaf| Deposit::of(leaf.root, [1.0 / 3.0; 3], Rgb::splat(key.uniform(leaf.root))))
            .collect();
        let deposits = Deposits::new(&deposits, 1.0);
        let lit = Lit::new(&draft, &deposits);
        let all = Lit { roots: lit.roots.clone(), reached: vec![true; draft.base.len()] };
        let [few, every] = [&lit, &all].map(|lit| {
            let leaves = look(&draft, &deposits, lit, &Memory::default());
            let mut projection = projected(&draft, &leaves, 1);
            projection.smooth(&vec![1e-3; draft.vertices.len()]);
            (leaves.len(), projection.values)
        });
        assert!(few.0 < every.0 / 2 && every.0 == draft.leaves.len(), "{} of {}", few.0, every.0);
        assert_eq!(few.1, every.1);
        // Smoothing has moved light to where no deposit's triangle has a corner.
        let lumped = project(&draft, &deposits, 1);
        assert!(
            few.1.iter().zip(&lumped).any(|(smooth, lumped)| *lumped == Rgb::ZERO && *smooth != Rgb::ZERO)
        );
    }
}
