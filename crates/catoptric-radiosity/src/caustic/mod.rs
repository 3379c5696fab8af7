//! The caustic term: light of concentrated sources over curved or refracting surfaces, by light-side rays onto the
//! display mesh (Arvo 1986; density on an adaptive mesh as in Heckbert 1990, by projection as in Kavan et al. 2011).
//!
//! Owner of every path whose chain is curved and starts at a lamp, a punctual light or a bright part of the sky
//! ([`catoptric_light::Owner::LightRays`]), but for what receivers see in lenses ([`catoptric_light::Lenses`]). The rays
//! are traced once; what they left is kept and counted on one mesh after the other.

mod density;
mod deposit;
mod emit;
mod projection;
mod smooth;
mod source;
mod table;
mod target;

pub use density::{Change, DensityParams};

use glam::DVec3;
use rayon::prelude::*;

use catoptric_light::Lights;
use catoptric_scene::{Cancelled, Progress, Rgb};
use catoptric_solution::{Quality, Solution, Term};
use catoptric_trace::walk::WalkParams;
use catoptric_trace::{Ledger, Tracer};

use crate::caustic::density::Density;
use crate::caustic::deposit::Deposits;
use crate::caustic::emit::{Emission, Harvest};
use crate::display::Displayed;
use crate::draft::Draft;
use crate::field::mean;

/// Budgets of the caustic term.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CausticParams {
    /// Rays at least, a power of two.
    pub min_rays: u32,
    /// Rays at most, a power of two.
    pub max_rays: u32,
    /// Rays are doubled until their noise is below this share of the light, or until that changes less of it, by area, …
    pub noise: f32,
    /// … and until that changes less than this share where they are bright: a focus is a small part of what is lit, and
    /// shown as coarsely as it has few rays.
    pub focus: f32,
    /// The mesh.
    pub density: DensityParams,
}

impl CausticParams {
    /// The budgets of a quality.
    pub fn for_quality(quality: Quality) -> Self {
        let (max_rays, max_vertices, noise, focus) = match quality {
            Quality::Sketch => (1 << 16, 2_000, 0.1, 0.25),
            Quality::Draft => (1 << 18, 6_000, 0.06, 0.16),
            Quality::Standard => (1 << 21, 20_000, 0.03, 0.08),
            Quality::High => (1 << 22, 200_000, 0.02, 0.05),
        };
        Self {
            min_rays: 1 << 14,
            max_rays,
            noise,
            focus,
            density: DensityParams {
                max_vertices,
                rounds: 10,
                significance: [2.9, 1.85],
                certainty: [8.0, 3.6],
                tolerance: 0.01,
                min_count: 16.0,
                min_edge: 0.0,
                sharpening: 1,
            },
        }
    }
}

/// Everywhere at least this share of the mean light is expected: that of other surfaces is not known yet.
const FLOOR: f32 = 0.2;

/// Where the power went.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CausticReport {
    /// Rays.
    pub rays: u32,
    /// Deposits.
    pub deposits: usize,
    /// Power that left the first deviating surfaces.
    pub sent: DVec3,
    /// Power kept by receivers at the ends of caustic paths.
    pub deposited: DVec3,
    /// Power that arrived without a curved event, or where nothing is stored: other terms have it.
    pub elsewhere: DVec3,
    /// Entries that sum to `sent`.
    pub ledger: Ledger,
    /// Estimated noise before smoothing, against the light there, root mean square over what caustics light.
    pub noise: f32,
    /// What the last doubling of the rays changed.
    pub change: Change,
    /// Vertices of its mesh beyond the base.
    pub vertices: usize,
}

/// The caustic light of a scene.
#[derive(Clone, Debug)]
pub struct Caustic {
    /// The base mesh refined for this term alone.
    draft: Draft,
    /// Irradiance at its vertices.
    values: Vec<Rgb>,
    base_vertices: usize,
    deposits: Deposits,
    /// What was done.
    pub report: CausticReport,
}

/// Traces the caustic light of a scene. `base` shows `draft`, which is not refined yet; `other` is the light of sources
/// at its vertices. `None` where no light takes such paths.
pub fn caustic(
    lights: &Lights,
    draft: &Draft,
    base: &Displayed,
    other: &[Rgb],
    walk: WalkParams,
    seed: u32,
    params: &CausticParams,
    progress: &dyn Progress,
) -> Result<Option<Caustic>, Cancelled> {
    if !lights.params().light_rays {
        return Ok(None);
    }
    let Some(mut emission) = Emission::new(lights, draft, base, walk, seed) else { return Ok(None) };
    progress.begin("caustics", u64::from(params.max_rays));
    emission.learn(seed, progress)?;
    let tracer = lights.tracer();
    let density = DensityParams {
        min_edge: params.density.min_edge.max(tracer.extent().inner.diagonal as f32 / 4000.0),
        ..params.density
    };
    let area: f32 = draft.leaves.iter().map(|leaf| draft.weight(leaf)).sum();
    let mut harvest = Harvest::default();
    let mut rays = 0;
    let mut next = params.min_rays.min(params.max_rays);
    let mut before: Option<(Draft, Density)> = None;
    let (own, found, deposits, change) = loop {
        harvest.add(emission.send(rays..next, seed, progress)?);
        rays = next;
        let deposits = Deposits::new(&harvest.deposits, 1.0 / rays as f32);
        let floor = FLOOR * (mean(draft, other) + (deposits.total() / area).max_element());
        let light: Vec<Rgb> = other.iter().map(|&l| l + Rgb::splat(floor)).collect();
        let mut own = draft.clone();
        let found = density::refine(tracer, &mut own, &deposits, &light, &density, progress)?;
        let change = before
            .as_ref()
            .map_or(Change::UNKNOWN, |(coarser, b)| found.change(&own, b, coarser, draft.vertices.len()));
        let is_settled = change.by_area.min(found.noise) < params.noise && change.in_focus < params.focus;
        if rays >= params.max_rays || is_settled {
            break (own, found, deposits, change);
        }
        before = Some((own, found));
        next = (rays * 2).min(params.max_rays);
    };
    let share = 1.0 / f64::from(rays);
    let report = CausticReport {
        rays,
        deposits: harvest.deposits.len(),
        sent: harvest.sent * share,
        deposited: harvest.deposited * share,
        elsewhere: harvest.elsewhere * share,
        ledger: harvest.ledger.scaled(share),
        noise: found.noise,
        change,
        vertices: own.vertices.len() - draft.vertices.len(),
    };
    let base_vertices = draft.vertices.len();
    Ok(Some(Caustic { draft: own, values: found.values, base_vertices, deposits, report }))
}

impl Caustic {
    /// Irradiance at the vertices of another refinement of the same base mesh, with the same power.
    pub fn on(&self, draft: &Draft) -> Vec<Rgb> {
        density::project(draft, &self.deposits, 0)
    }

    /// Refines the mesh of a solution where this term needs it, and adds the term. `draft` is what the solution shows, `origin`
    /// the draft's vertex of each of its vertices.
    pub fn add_to(&self, tracer: &Tracer, draft: &mut Draft, origin: &[u32], solution: Solution) -> Solution {
        // Values of the solution at the draft's vertices.
        let mut position = vec![u32::MAX; draft.vertices.len()];
        for (index, &v) in origin.iter().enumerate() {
            position[v as usize] = index as u32;
        }

        // The same splits as in the own mesh, whose vertices beyond the base get new numbers.
        let there = draft.split_as(tracer, &self.draft, self.base_vertices);

        let mut own = vec![None; draft.vertices.len()];
        for (index, &v) in there.iter().enumerate() {
            own[v as usize] = Some(self.values[index]);
        }
        // Vertices that a term does not have are the mean of the edge that they halve.
        let mut terms: Vec<[Rgb; 7]> = Vec::with_capacity(draft.vertices.len());
        let mut caustic: Vec<Rgb> = Vec::with_capacity(draft.vertices.len());
        for (index, vertex) in draft.vertices.iter().enumerate() {
            let mean = |of: &dyn Fn(usize) -> Rgb| {
                vertex.parents.map_or(Rgb::ZERO, |[a, b]| (of(a as usize) + of(b as usize)) * 0.5)
            };
            let known = position.get(index).copied().filter(|&p| p != u32::MAX);
            let values = std::array::from_fn(|t| match known {
                Some(p) if t < 4 => solution.irradiance[t][p as usize],
                Some(p) if t == 4 => solution.punctual[p as usize],
                Some(p) => solution.gathered[t - 5].get(p as usize).copied().unwrap_or(Rgb::ZERO),
                None => mean(&|v| terms[v][t]),
            });
            let value = own[index].unwrap_or_else(|| mean(&|v| caustic[v]));
            terms.push(values);
            caustic.push(value);
        }
        let displayed = draft.display(tracer);
        let mut result = Solution { mesh: displayed.mesh, ..solution };
        let of = |value: &(dyn Fn(usize) -> Rgb + Sync)| -> Vec<Rgb> {
            displayed.origin.par_iter().with_min_len(1024).map(|&v| value(v as usize)).collect()
        };
        for (t, term) in Term::ALL.into_iter().enumerate() {
            let is_own = term == Term::Caustic;
            result.irradiance[t] = of(&|v| terms[v][t] + if is_own { caustic[v] } else { Rgb::ZERO });
        }
        for (t, values) in result.gathered.iter_mut().enumerate().filter(|(_, values)| !values.is_empty()) {
            *values = of(&|v| terms[v][t + 5]);
        }
        result.punctual = of(&|v| terms[v][4]);
        result
    }
}
