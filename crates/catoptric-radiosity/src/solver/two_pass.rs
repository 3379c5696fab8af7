//! The default solver of the two-pass program: Gauss–Seidel on the irradiance that patches send each other.
//!
//! H_i = f_i + Σ_j F_ij·B_j with B_j = ρ_j·(S_j + H_j) + τ_j·(S + H) of the other side; S is what sources send directly.

use catoptric_scene::{Rgb, Union};

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

/// The solution for the patches.
#[derive(Clone, Debug, Default)]
pub struct PatchSolution {
    /// Irradiance from other diffuse surfaces, and from sources found by the rows.
    pub indirect: Vec<Rgb>,
    /// Sweeps.
    pub sweeps: usize,
    /// Change of the last sweep relative to what was sent in the first place, in the space where it is greatest.
    pub residual: f64,
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
    let mut solution = PatchSolution::default();
    while solution.sweeps < params.max_sweeps {
        let mut changes = vec![0.0_f64; spaces];
        for index in 0..count {
            let space = space_of[index] as usize;
            if done[space] {
                continue;
            }
            let gathered = found[index] + rows[index].gather(|p: PatchId| sent[p.0 as usize]);
            changes[space] += f64::from(patches.areas[index])
                * f64::from((gathered - irradiance[index]).abs().max_element());
            irradiance[index] = gathered;
            sent[index] = radiosity(index, &irradiance);
            if let Some(other) = patches.opposite[index] {
                sent[other.0 as usize] = radiosity(other.0 as usize, &irradiance);
            }
        }
        solution.sweeps += 1;
        solution.residual = 0.0;
        for (done, (change, scale)) in done.iter_mut().zip(changes.iter().zip(&scales)) {
            solution.residual = (change / scale).max(solution.residual);
            *done |= change / scale < params.tolerance;
        }
        watch(solution.sweeps, &sent);
        if solution.residual < params.tolerance {
            break;
        }
    }
    solution.indirect = irradiance;
    solution
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
