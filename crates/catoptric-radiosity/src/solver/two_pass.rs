//! The default solver of the two-pass program: Gauss–Seidel on the irradiance that patches send each other.
//!
//! H_i = f_i + Σ_j F_ij·B_j with B_j = ρ_j·(S_j + H_j) + τ_j·(S + H) of the other side; S is what sources send directly.
//!
//! White closed rooms want thousands of sweeps for what is the same everywhere. So that, after some sweeps, is balanced at once in each space:
//! as much is added to all H as makes up for what it loses (coarse-mesh rebalance, Reed 1971; two-level multigrid of one coarse unknown a space).

use catoptric_scene::{Rgb, Union};
use glam::DVec3;

use crate::patch::{PatchId, PatchMesh};
use crate::rows::Row;

/// When to stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolverParams {
    /// Change of the irradiance in a sweep, area-weighted, relative to what was sent in the first place, in each space that
    /// no light leaves.
    pub tolerance: f64,
    /// Sweeps at most.
    pub max_sweeps: usize,
}

impl Default for SolverParams {
    fn default() -> Self {
        Self { tolerance: 1e-5, max_sweeps: 500 }
    }
}

/// Sweeps without balance: most scenes need no more.
const UNBALANCED: usize = 32;
/// Change of the irradiance relative to itself below which it is rounding (2⁻²⁴ and sums of hundreds of terms).
const ROUNDING: f64 = 2e-7;
/// Share of its light that a space loses, below which it has no end: rounding of form factors (f32) that sum to one.
const ENDLESS: f64 = 1e-6;

/// The solution for the patches.
#[derive(Clone, Debug, Default)]
pub struct PatchSolution {
    /// Irradiance from other diffuse surfaces, and from sources found by the rows.
    pub indirect: Vec<Rgb>,
    /// Sweeps.
    pub sweeps: usize,
    /// Change of the last sweep relative to what was sent in the first place, in the space where it is greatest.
    pub residual: f64,
    /// Spaces with light that reflect all of it: they have no solution, and what they have is that of so many sweeps.
    pub endless: usize,
}

/// Solves for the indirect irradiance of the patches, given what sources send to each. `start` is the irradiance of an earlier
/// solution, or empty; `watch` sees the radiosities after every sweep.
pub fn solve_patches(
    patches: &PatchMesh,
    rows: &[Row],
    sources: &[Rgb],
    start: &[Rgb],
    params: &SolverParams,
    watch: &mut dyn FnMut(usize, &[Rgb]),
) -> PatchSolution {
    let found: Vec<Rgb> = rows.iter().map(|r| r.found).collect();
    sweep(patches, rows, [sources, &found], start, params, watch)
}

/// What becomes of an error of the irradiance after at least one more reflection: Σ_{n ≥ 1} (F ρ)ⁿ·`error`.
///
/// The defect correction of multigrid methods (Brandt 1977): where a finer operator finds H₁ = L·H_c for the coarse
/// solution H_c, the error of H₁ is L·e with e = (I − L)⁻¹ (H₁ − H_c), for which the coarse L is good enough.
pub fn spread_error(
    patches: &PatchMesh,
    rows: &[Row],
    error: &[Rgb],
    params: &SolverParams,
) -> PatchSolution {
    sweep(patches, rows, [error, &vec![Rgb::ZERO; rows.len()]], &[], params, &mut |_, _| ())
}

/// What a patch sends: ρ of its irradiance, and τ of the other side's.
fn radiosity(patches: &PatchMesh, index: usize, irradiance: impl Fn(usize) -> Rgb) -> Rgb {
    let own = patches.reflectances[index] * irradiance(index);
    match patches.opposite[index] {
        Some(other) => own + patches.transmittances[index] * irradiance(other.0 as usize),
        None => own,
    }
}

/// Sweeps until the irradiance stays. `sources` are reflected and not part of the result; `found` is both.
fn sweep(
    patches: &PatchMesh,
    rows: &[Row],
    [sources, found]: [&[Rgb]; 2],
    start: &[Rgb],
    params: &SolverParams,
    watch: &mut dyn FnMut(usize, &[Rgb]),
) -> PatchSolution {
    let count = patches.len();
    let mut irradiance: Vec<Rgb> = if start.is_empty() { vec![Rgb::ZERO; count] } else { start.to_vec() };
    let radiosity =
        |index: usize, irradiance: &[Rgb]| radiosity(patches, index, |i| sources[i] + irradiance[i]);
    let mut sent: Vec<Rgb> = (0..count).map(|i| radiosity(i, &irradiance)).collect();
    // Each space that no light leaves ends by itself: a lamp that is bright inside does not say when a room is done.
    let (space_of, spaces) = spaces(patches, rows);
    let mut scales = vec![f64::MIN_POSITIVE; spaces];
    for (index, &space) in space_of.iter().enumerate() {
        let first = (sources[index] + found[index]).abs().max_element();
        scales[space as usize] += f64::from(patches.areas[index]) * f64::from(first);
    }
    let mut done = vec![false; spaces];
    let mut balance: Option<Balance> = None;
    let mut solution = PatchSolution::default();
    while solution.sweeps < params.max_sweeps {
        let mut changes = vec![0.0_f64; spaces];
        let mut totals = vec![0.0_f64; spaces];
        for index in 0..count {
            let space = space_of[index] as usize;
            if done[space] {
                continue;
            }
            let gathered = found[index] + rows[index].gather(|p: PatchId| sent[p.0 as usize]);
            let ends = balance.as_ref().map_or(Rgb::ONE, |b| b.ends[space]);
            changes[space] += f64::from(patches.areas[index])
                * f64::from(((gathered - irradiance[index]) * ends).abs().max_element());
            totals[space] +=
                f64::from(patches.areas[index]) * f64::from((gathered * ends).abs().max_element());
            irradiance[index] = gathered;
            sent[index] = radiosity(index, &irradiance);
            if let Some(other) = patches.opposite[index] {
                sent[other.0 as usize] = radiosity(other.0 as usize, &irradiance);
            }
        }
        solution.sweeps += 1;
        solution.residual = 0.0;
        for space in 0..spaces {
            let change = (changes[space] - ROUNDING * totals[space]).max(0.0) / scales[space];
            solution.residual = change.max(solution.residual);
            done[space] |= change < params.tolerance;
        }
        watch(solution.sweeps, &sent);
        if solution.residual < params.tolerance {
            break;
        }
        if solution.sweeps >= UNBALANCED {
            let balance = balance.get_or_insert_with(|| Balance::new(patches, rows, &space_of, spaces));
            let missing = balance.missing(patches, found, &irradiance, &sent, &space_of);
            for index in 0..count {
                if !done[space_of[index] as usize] {
                    irradiance[index] += missing[space_of[index] as usize];
                }
            }
            sent = (0..count).map(|i| radiosity(i, &irradiance)).collect();
        }
    }
    solution.endless = balance.map_or(0, |balance| balance.endless(&scales));
    solution.indirect = irradiance;
    solution
}

/// What each space keeps and loses of irradiance that is the same everywhere in it.
struct Balance {
    /// Per patch j: Σ_i A_i·F_ij, m².
    arriving: Vec<DVec3>,
    /// Per space: what it loses of 1 W/m² everywhere, W.
    loss: Vec<DVec3>,
    /// Per space and channel: 1 where light ends, else 0.
    ends: Vec<Rgb>,
}

impl Balance {
    fn new(patches: &PatchMesh, rows: &[Row], space_of: &[u32], spaces: usize) -> Self {
        let count = patches.len();
        let mut arriving = vec![DVec3::ZERO; count];
        for (index, row) in rows.iter().enumerate() {
            let area = f64::from(patches.areas[index]);
            row.visit(|patch, weight| arriving[patch.0 as usize] += weight.as_dvec3() * area);
        }
        let mut areas = vec![0.0; spaces];
        let mut loss = vec![DVec3::ZERO; spaces];
        for index in 0..count {
            let (space, area) = (space_of[index] as usize, f64::from(patches.areas[index]));
            let sent = radiosity(patches, index, |_| Rgb::ONE).as_dvec3();
            areas[space] += area;
            loss[space] += DVec3::splat(area) - arriving[index] * sent;
        }
        let ends = loss.iter().zip(&areas).map(|(loss, area)| {
            let ends = loss.cmpgt(DVec3::splat(ENDLESS * area));
            Rgb::select(ends, Rgb::ONE, Rgb::ZERO)
        });
        let ends = ends.collect();
        Self { arriving, loss, ends }
    }

    /// What all patches of each space lack alike, so that as much arrives in all of it as is lost.
    fn missing(
        &self,
        patches: &PatchMesh,
        found: &[Rgb],
        irradiance: &[Rgb],
        sent: &[Rgb],
        space_of: &[u32],
    ) -> Vec<Rgb> {
        let mut lack = vec![DVec3::ZERO; self.loss.len()];
        for (index, &space) in space_of.iter().enumerate() {
            let own = (found[index] - irradiance[index]).as_dvec3() * f64::from(patches.areas[index]);
            lack[space as usize] += own + self.arriving[index] * sent[index].as_dvec3();
        }
        let shares = lack.iter().zip(&self.loss).zip(&self.ends);
        shares
            .map(|((lack, loss), ends)| {
                Rgb::select(ends.cmpgt(Rgb::ZERO), (lack / loss).as_vec3(), Rgb::ZERO)
            })
            .collect()
    }

    /// Spaces with light that has no end.
    fn endless(&self, scales: &[f64]) -> usize {
        let lit = scales.iter().map(|scale| *scale > f64::MIN_POSITIVE);
        self.ends.iter().zip(lit).filter(|(ends, lit)| *lit && ends.min_element() == 0.0).count()
    }
}

/// The space that each patch belongs to, and their number: patches that send each other light, directly or by way of others.
fn spaces(patches: &PatchMesh, rows: &[Row]) -> (Vec<u32>, usize) {
    let mut joined = Union::new(rows.len());
    for (index, row) in rows.iter().enumerate() {
        for patch in row.patches.iter().chain(&patches.opposite[index]) {
            joined.join(index as u32, patch.0);
        }
    }
    joined.numbered()
}
