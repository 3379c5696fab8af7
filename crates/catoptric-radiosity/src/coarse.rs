//! The coarse solve with any form factor method and any solver.
//!
//! H_i = f_i + Σ_j G_ij B_j with B_j = ρ_j (S_j + H_j) + τ_j (S + H) of the other side: S is what sources send directly, f what
//! rays find besides patches, G_ij = F_ij (n_i/n_j)². For the solvers of [`crate::solver`] a channel reads
//! B = E + ρ G B with E = ρ (S + f) + τ (S + H of the other side); power A B/n² is what their shooting keeps. Where diffuse
//! transmission couples the two sides of a surface, its part of E is carried from one solve to the next.

use std::fmt;

use catoptric_scene::{Cancelled, Progress, Rgb};
use catoptric_trace::Tracer;
use catoptric_trace::walk::WalkParams;

use crate::method::{self, ElementSet, FactorRow, Method, MethodError, MethodParams};
use crate::patch::{PatchId, PatchMesh};
use crate::rows::{Row, Weights};
use crate::solver::{
    self, PatchSolution, Rows, Solver, SolverParams, Stop, System, solve_patches, solve_system,
};

/// How the coarse equations are set up and solved.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CoarseParams {
    /// What finds the form factors. `None`: the program's own rays, as many as a row is worth.
    pub method: Option<Method>,
    /// What solves. `None`: [`solver::two_pass`].
    pub solver: Option<Solver>,
    /// Residual (of shooters: unshot power) relative to the emitted power. `None`: that of [`SolverParams`].
    pub residual: Option<f64>,
    /// Sweeps of gatherers, rows shot by shooters, at most. `None`: 500 sweeps or a million rows.
    pub max_steps: Option<usize>,
    /// Radiosities of an earlier solution with the same patches; empty to start from nothing.
    pub warm: Vec<Rgb>,
    /// Every how many steps a frame is kept; 0 for never.
    pub every: usize,
}

/// The patches' light after some steps.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// Steps.
    pub steps: usize,
    /// B of each patch.
    pub radiosity: Vec<Rgb>,
    /// Irradiance that stands for what is unshot, to be added everywhere. Zero but for `progressive`.
    pub ambient: Rgb,
}

/// What came out.
#[derive(Clone, Debug, PartialEq)]
pub struct CoarseSolution {
    /// H of each patch: what other patches and what rays found sends.
    pub indirect: Vec<Rgb>,
    /// Sweeps, or rows shot, of the channel that took most.
    pub steps: usize,
    /// Rows that the solver asked for, all channels together.
    pub rows: usize,
    /// Residual relative to the emitted power, worst channel.
    pub residual: f64,
    /// The rule that struck, in the channel that is worst off.
    pub stop: Stop,
    /// The way there, if it was asked for.
    pub frames: Vec<Frame>,
    /// Closed spaces that reflect all of their light, where the default solver finds any.
    pub endless: usize,
}

/// Frames at most: what they hold would otherwise grow with the steps without bound.
pub const MAX_FRAMES: usize = 4_000;
/// Patches of a dense solve, at most: half a gigabyte.
const MAX_DIRECT: usize = 8_000;
/// Shooting steps, at most.
const MAX_SHOTS: usize = 1_000_000;
/// Solves with light carried to the other sides, at most: each carries at least as much as a sweep does.
const MAX_CARRIES: usize = 200;

/// One channel of ray rows.
struct Channel<'a> {
    rows: &'a [Row],
    channel: usize,
}

impl Rows for Channel<'_> {
    fn len(&self) -> usize {
        self.rows.len()
    }

    fn visit(&self, from: usize, visit: &mut dyn FnMut(usize, f64)) {
        let row = &self.rows[from];
        match &row.weights {
            Weights::Gray(weights) => {
                row.patches.iter().zip(weights).for_each(|(p, &w)| visit(p.0 as usize, f64::from(w)));
            }
            Weights::Tinted(weights) => row
                .patches
                .iter()
                .zip(weights)
                .for_each(|(p, w)| visit(p.0 as usize, f64::from(w[self.channel]))),
        }
    }
}

/// Replaces the form factors of rows by those of another method; what rays found besides patches stays.
pub fn rows_by(
    method: Method,
    tracer: &Tracer,
    set: &ElementSet,
    patches: &PatchMesh,
    rows: &mut [Row],
    rays: u32,
    seed: u32,
    walk: &WalkParams,
    progress: &dyn Progress,
) -> Result<(), SolveError> {
    // Patches of a coarse solve need not be known to seven digits, and have neighbours that average with them.
    let params = MethodParams {
        walk: *walk,
        rays: match method {
            Method::Area => 1,
            _ => rays.div_ceil(16),
        },
        seed,
        resolution: 16,
        tolerance: 1e-3,
        max_cells: 16,
    };
    let prepared =
        method::prepare(method, tracer, set, &params).map_err(|error| SolveError::Method(method, error))?;
    let matrix = method::factors(prepared.as_ref(), set, progress)?;
    let ior = |patch: u32| tracer.media().ior(patches.media[patch as usize]);
    for (from, (row, found)) in rows.iter_mut().zip(matrix.rows).enumerate() {
        let gathered = |e: &method::Entry| {
            let ratio = ior(from as u32) / ior(e.to);
            e.factor.as_vec3() * (ratio * ratio)
        };
        let FactorRow { entries, ledger, .. } = found;
        let weights: Vec<Rgb> = entries.iter().map(gathered).collect();
        row.patches = entries.iter().map(|e| PatchId(e.to)).collect();
        row.weights = Weights::of(weights);
        row.ledger = ledger;
    }
    Ok(())
}

/// Why there is no solution.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SolveError {
    /// Stopped on request.
    Cancelled(Cancelled),
    /// The form factor method cannot read the scene.
    Method(Method, MethodError),
    /// The dense matrix of `direct` would not fit.
    TooManyPatches {
        /// Patches.
        found: usize,
        /// At most.
        limit: usize,
    },
    /// The earlier solution has other patches.
    OtherPatches {
        /// Its number of patches.
        found: usize,
        /// Ours.
        expected: usize,
    },
}

impl From<Cancelled> for SolveError {
    fn from(cancelled: Cancelled) -> Self {
        Self::Cancelled(cancelled)
    }
}

impl fmt::Display for SolveError {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Cancelled(cancelled) => cancelled.fmt(f),
            Self::Method(method, error) => write!(f, "method {}: {error}", method.name()),
            Self::TooManyPatches { found, limit } => {
                write!(
                    f,
                    "{found} patches are too many for solver direct, which stores all pairs (at most {limit})"
                )
            }
            Self::OtherPatches { found, expected } => {
                write!(f, "the solution to start from has {found} patches, this solve {expected}")
            }
        }
    }
}

impl std::error::Error for SolveError {}

/// Solves for the irradiance that patches send each other, given what sources send to each.
pub fn solve_coarse(
    tracer: &Tracer,
    patches: &PatchMesh,
    rows: &[Row],
    sources: &[Rgb],
    default: &SolverParams,
    params: &CoarseParams,
    progress: &dyn Progress,
) -> Result<CoarseSolution, SolveError> {
    let (count, warm) = (patches.len(), params.warm.len());
    if warm != 0 && warm != count {
        return Err(SolveError::OtherPatches { found: warm, expected: count });
    }
    match params.solver {
        None => Ok(by_two_pass(patches, rows, sources, default, params)),
        Some(solver) if solver.is_dense() && count > MAX_DIRECT => {
            Err(SolveError::TooManyPatches { found: count, limit: MAX_DIRECT })
        }
        Some(solver) => {
            let solution = by_channel(solver, tracer, patches, rows, sources, default, params, progress);
            if progress.is_cancelled() { Err(Cancelled.into()) } else { Ok(solution) }
        }
    }
}

fn by_two_pass(
    patches: &PatchMesh,
    rows: &[Row],
    sources: &[Rgb],
    default: &SolverParams,
    params: &CoarseParams,
) -> CoarseSolution {
    let limits = SolverParams {
        tolerance: params.residual.unwrap_or(default.tolerance),
        max_sweeps: params.max_steps.unwrap_or(default.max_sweeps),
    };
    let start: Vec<Rgb> = match params.warm.is_empty() {
        true => Vec::new(),
        false => rows.iter().map(|r| r.found + r.gather(|p| params.warm[p.0 as usize])).collect(),
    };
    let mut frames = Vec::new();
    // The last state is a frame, whatever the steps between frames.
    let mut last = None;
    let PatchSolution { indirect, sweeps, residual, endless } =
        solve_patches(patches, rows, sources, &start, &limits, &mut |steps, sent| {
            if params.every == 0 {
                return;
            }
            let frame = Frame { steps, radiosity: sent.to_vec(), ambient: Rgb::ZERO };
            if steps % params.every == 0 && frames.len() < MAX_FRAMES {
                frames.push(frame);
                last = None;
            } else {
                last = Some(frame);
            }
        });
    frames.extend(last);
    let stop = if residual < limits.tolerance { Stop::Residual } else { Stop::Steps };
    CoarseSolution { indirect, steps: sweeps, rows: sweeps * rows.len(), residual, stop, frames, endless }
}

/// What a channel's solve leaves.
struct Solved {
    irradiance: Vec<f64>,
    solution: solver::Solution,
    /// Steps, B and the ambient irradiance.
    frames: Vec<(usize, Vec<f32>, f64)>,
}

fn by_channel(
    solver: Solver,
    tracer: &Tracer,
    patches: &PatchMesh,
    rows: &[Row],
    sources: &[Rgb],
    default: &SolverParams,
    params: &CoarseParams,
    progress: &dyn Progress,
) -> CoarseSolution {
    // Power that shooting keeps: B is the greater by n² inside of a medium.
    let weights: Vec<f64> = (0..patches.len())
        .map(|i| {
            let ior = f64::from(tracer.media().ior(patches.media[i]));
            f64::from(patches.areas[i]) / (ior * ior)
        })
        .collect();
    // One after the other: `direct` is parallel inside, and its matrix need not be there three times.
    let channels: Vec<Solved> = (0..3)
        .map(|c| one_channel(solver, c, patches, rows, sources, &weights, default, params, progress))
        .collect();

    let count = patches.len();
    let rgb = |value: &dyn Fn(usize) -> f64| Rgb::new(value(0) as f32, value(1) as f32, value(2) as f32);
    let indirect = (0..count).map(|i| rgb(&|c| channels[c].irradiance[i])).collect();
    // A channel that has ended stays as it is while the others go on.
    let longest = channels.iter().map(|c| c.frames.len()).max().unwrap_or(0);
    let frames = (0..longest)
        .map(|k| {
            let at = |c: usize| &channels[c].frames[k.min(channels[c].frames.len() - 1)];
            Frame {
                steps: (0..3).map(|c| at(c).0).max().unwrap_or(0),
                radiosity: (0..count).map(|i| rgb(&|c| f64::from(at(c).1[i]))).collect(),
                ambient: rgb(&|c| at(c).2),
            }
        })
        .collect();
    let worst = |stop: Stop| match stop {
        Stop::Exact => 0,
        Stop::Residual | Stop::Unshot => 1,
        Stop::Steps => 2,
        Stop::Watcher => 3,
    };
    let solutions = || channels.iter().map(|c| &c.solution);
    CoarseSolution {
        indirect,
        steps: solutions().map(|s| s.steps).max().unwrap_or(0),
        rows: solutions().map(|s| s.rows).sum(),
        residual: solutions().map(|s| s.residual).fold(0.0, f64::max),
        stop: solutions().map(|s| s.stop).max_by_key(|s| worst(*s)).unwrap_or(Stop::Exact),
        frames,
        endless: 0,
    }
}

fn one_channel(
    solver: Solver,
    channel: usize,
    patches: &PatchMesh,
    rows: &[Row],
    sources: &[Rgb],
    weights: &[f64],
    default: &SolverParams,
    params: &CoarseParams,
    progress: &dyn Progress,
) -> Solved {
    let count = patches.len();
    let of = |values: &[Rgb]| -> Vec<f64> { values.iter().map(|v| f64::from(v[channel])).collect() };
    let channel_rows = Channel { rows, channel };
    let (reflectance, transmittance) = (of(&patches.reflectances), of(&patches.transmittances));
    let sent = of(sources);
    let found: Vec<f64> = rows.iter().map(|r| f64::from(r.found[channel])).collect();
    let gatherer = matches!(solver, Solver::Jacobi | Solver::GaussSeidel);
    let most = if gatherer { default.max_sweeps } else { MAX_SHOTS };
    let limit = params.residual.unwrap_or(default.tolerance);
    let coupled = (0..count).any(|i| transmittance[i] > 0.0 && patches.opposite[i].is_some());

    let mut warm = (!params.warm.is_empty()).then(|| of(&params.warm));
    let mut irradiance = vec![0.0; count];
    if let Some(warm) = &warm {
        gather_all(&channel_rows, &found, warm, &mut irradiance);
    }
    let mut frames: Vec<(usize, Vec<f32>, f64)> = Vec::new();
    let (mut steps, mut asked) = (0, 0);
    let mut carries = 0;
    loop {
        let emission: Vec<f64> = (0..count)
            .map(|i| {
                let own = reflectance[i] * (sent[i] + found[i]);
                let other =
                    patches.opposite[i].map_or(0.0, |o| sent[o.0 as usize] + irradiance[o.0 as usize]);
                own + transmittance[i] * other
            })
            .collect();
        let system = System { rows: &channel_rows, reflectance: &reflectance, emission: &emission, weights };
        let limits = solver::Params {
            residual: limit,
            max_steps: params.max_steps.unwrap_or(most).saturating_sub(steps),
            warm: warm.as_deref(),
        };
        let before = steps;
        let mut solution = solve_system(solver, &system, &limits, &mut |step| {
            let steps = before + step.steps;
            let known = !step.radiosity.is_empty();
            if known && params.every > 0 && steps % params.every == 0 && frames.len() < MAX_FRAMES {
                let radiosity = step.radiosity.iter().map(|b| *b as f32).collect();
                frames.push((steps, radiosity, step.ambient));
            }
            !progress.is_cancelled()
        });
        steps += solution.steps;
        asked += solution.rows;
        carries += 1;
        let last = irradiance.clone();
        gather_all(&channel_rows, &found, &solution.radiosity, &mut irradiance);
        asked += count;
        let change: f64 = if coupled {
            let parts = irradiance.iter().zip(&last).zip(weights).zip(&transmittance);
            parts.map(|(((now, last), w), t)| (now - last).abs() * w * t).sum()
        } else {
            0.0
        };
        let done = change <= limit * system.emitted()
            || matches!(solution.stop, Stop::Steps | Stop::Watcher)
            || carries >= MAX_CARRIES;
        if done {
            if params.every > 0 && frames.last().is_none_or(|f| f.0 != steps) {
                let radiosity = solution.radiosity.iter().map(|b| *b as f32).collect();
                frames.push((steps, radiosity, 0.0));
            }
            solution.steps = steps;
            solution.rows = asked;
            return Solved { irradiance, solution, frames };
        }
        warm = Some(solution.radiosity);
    }
}

/// H = f + G B.
fn gather_all(rows: &Channel, found: &[f64], radiosity: &[f64], irradiance: &mut [f64]) {
    for (from, value) in irradiance.iter_mut().enumerate() {
        *value = found[from];
        rows.visit(from, &mut |to, factor| *value += factor * radiosity[to]);
    }
}
