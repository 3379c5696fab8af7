//! Solvers of B = E + ρ F B: siblings behind one enum; any method's rows will do.
//!
//! Gatherers ([`jacobi`], [`gauss_seidel`]) need all rows in every sweep, [`direct`] all rows at once; shooters
//! ([`southwell`], [`progressive`]) one row per step, which reciprocity turns into a column: w_i F_ij = w_j F_ji.
//! [`two_pass`] is what the program itself solves with: irradiance in three channels, with light that passes through.

pub mod direct;
#[cfg(feature = "faer")]
pub mod direct_faer;
pub mod gauss_seidel;
pub mod jacobi;
pub mod progressive;
pub mod southwell;
pub mod two_pass;

use std::str::FromStr;

pub use two_pass::{PatchSolution, SolverParams, solve_patches, spread_error};

use crate::method::FactorMatrix;

/// Rows of form factors in one channel, stored or computed on demand.
pub trait Rows {
    /// Number of elements.
    fn len(&self) -> usize;

    /// Whether there are none.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Visits the form factors from one element, by ascending receiver.
    fn visit(&self, from: usize, visit: &mut dyn FnMut(usize, f64));

    /// (Σ_{j≠i} F_ij B_j, F_ii) for i = `from`.
    fn gathered(&self, from: usize, radiosity: &[f64]) -> (f64, f64) {
        let (mut sum, mut own) = (0.0, 0.0);
        self.visit(from, &mut |to, factor| {
            if to == from {
                own += factor;
            } else {
                sum += factor * radiosity[to];
            }
        });
        (sum, own)
    }
}

/// A stored matrix in one channel.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StoredRows {
    rows: Vec<Vec<(u32, f64)>>,
}

impl StoredRows {
    /// One channel of a matrix.
    pub fn channel(matrix: &FactorMatrix, channel: usize) -> Self {
        let row = |r: &crate::method::FactorRow| {
            r.entries.iter().map(|e| (e.to, e.factor[channel])).filter(|e| e.1 != 0.0).collect()
        };
        Self { rows: matrix.rows.iter().map(row).collect() }
    }

    /// From dense rows.
    pub fn dense(rows: &[Vec<f64>]) -> Self {
        let sparse = |r: &Vec<f64>| {
            r.iter().enumerate().filter(|e| *e.1 != 0.0).map(|(j, f)| (j as u32, *f)).collect()
        };
        Self { rows: rows.iter().map(sparse).collect() }
    }
}

impl Rows for StoredRows {
    fn len(&self) -> usize {
        self.rows.len()
    }

    fn visit(&self, from: usize, visit: &mut dyn FnMut(usize, f64)) {
        for &(to, factor) in &self.rows[from] {
            visit(to as usize, factor);
        }
    }

    fn gathered(&self, from: usize, radiosity: &[f64]) -> (f64, f64) {
        let row = &self.rows[from];
        match row.binary_search_by_key(&(from as u32), |e| e.0) {
            Ok(own) => (dot(&row[..own], radiosity) + dot(&row[own + 1..], radiosity), row[own].1),
            Err(_) => (dot(row, radiosity), 0.0),
        }
    }
}

/// Σ F_j B_j as four sums side by side: one alone waits for its last addition, and not for memory.
fn dot(entries: &[(u32, f64)], radiosity: &[f64]) -> f64 {
    let mut sums = [0.0; 4];
    let (groups, rest) = entries.as_chunks::<4>();
    for group in groups {
        for (sum, &(to, factor)) in sums.iter_mut().zip(group) {
            *sum += factor * radiosity[to as usize];
        }
    }
    for (sum, &(to, factor)) in sums.iter_mut().zip(rest) {
        *sum += factor * radiosity[to as usize];
    }
    let [a, b, c, d] = sums;
    (a + b) + (c + d)
}

/// The equations of one channel.
#[derive(Clone, Copy)]
pub struct System<'a> {
    /// F.
    pub rows: &'a dyn Rows,
    /// ρ_d of each element.
    pub reflectance: &'a [f64],
    /// E: radiosity that each element emits by itself.
    pub emission: &'a [f64],
    /// What reciprocity weighs rows with: areas (times n² between media).
    pub weights: &'a [f64],
}

impl System<'_> {
    /// Number of elements.
    pub fn len(&self) -> usize {
        self.emission.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.emission.is_empty()
    }

    /// Σ w E: the emitted power.
    pub fn emitted(&self) -> f64 {
        self.emission.iter().zip(self.weights).map(|(e, w)| e.abs() * w).sum()
    }

    /// Σ w |E + ρ F B − B|, relative to the emitted power.
    pub fn residual(&self, radiosity: &[f64]) -> f64 {
        let sum: f64 = (0..self.len())
            .map(|i| {
                let (others, own) = self.rows.gathered(i, radiosity);
                let reflected = self.reflectance[i] * (others + own * radiosity[i]);
                (self.emission[i] + reflected - radiosity[i]).abs() * self.weights[i]
            })
            .sum();
        sum / self.emitted().max(f64::MIN_POSITIVE)
    }
}

/// Which solver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Solver {
    /// LU of I − ρF.
    Direct,
    /// The same by faer.
    #[cfg(feature = "faer")]
    DirectFaer,
    /// Gathering from the radiosities of the sweep before.
    Jacobi,
    /// Gathering from the newest radiosities.
    GaussSeidel,
    /// Relaxation of the largest residual power first.
    Southwell,
    /// Relaxation in the order of the elements, round and round.
    SouthwellUnordered,
    /// Shooting the largest unshot power first, with an ambient estimate of what is unshot.
    Progressive,
}

impl Solver {
    /// Whether it needs all rows at once, as a dense matrix.
    pub fn is_dense(self) -> bool {
        self.name().starts_with("direct")
    }

    const COUNT: usize = if cfg!(feature = "faer") { 7 } else { 6 };

    /// All solvers.
    pub const ALL: [Self; Self::COUNT] = [
        Self::Direct,
        #[cfg(feature = "faer")]
        Self::DirectFaer,
        Self::Jacobi,
        Self::GaussSeidel,
        Self::Southwell,
        Self::SouthwellUnordered,
        Self::Progressive,
    ];

    /// Its word on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Direct => "direct",
            #[cfg(feature = "faer")]
            Self::DirectFaer => "direct-faer",
            Self::Jacobi => "jacobi",
            Self::GaussSeidel => "gauss-seidel",
            Self::Southwell => "southwell",
            Self::SouthwellUnordered => "southwell-unordered",
            Self::Progressive => "progressive",
        }
    }
}

impl FromStr for Solver {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let names = Self::ALL.map(Self::name).join(", ");
        Self::ALL
            .into_iter()
            .find(|s| s.name() == text)
            .ok_or_else(|| format!("expected one of the solvers {names}"))
    }
}

/// When to stop, and where to start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Params<'a> {
    /// Residual relative to the emitted power. Shooters carry it with them: it is what is unshot.
    pub residual: f64,
    /// Sweeps of gatherers, rows shot by shooters, at most.
    pub max_steps: usize,
    /// An earlier solution to start from; without it gatherers start from zero.
    pub warm: Option<&'a [f64]>,
}

impl Default for Params<'_> {
    fn default() -> Self {
        Self { residual: 1e-8, max_steps: 1_000_000, warm: None }
    }
}

/// What stopped a solver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stop {
    /// The answer was computed in a finite number of operations.
    Exact,
    /// The residual is below its limit.
    Residual,
    /// The unshot power is below its limit.
    Unshot,
    /// The limit of steps.
    Steps,
    /// Whoever watched had seen enough.
    Watcher,
}

impl Stop {
    /// What it was, for reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Exact => "exact",
            Self::Residual => "residual",
            Self::Unshot => "unshot power",
            Self::Steps => "steps",
            Self::Watcher => "watcher",
        }
    }
}

/// A radiosity per element, and how it was come by.
#[derive(Clone, Debug, PartialEq)]
pub struct Solution {
    /// B.
    pub radiosity: Vec<f64>,
    /// Sweeps of gatherers, rows shot by shooters.
    pub steps: usize,
    /// Rows that were asked for.
    pub rows: usize,
    /// Residual, or unshot power, relative to the emitted power.
    pub residual: f64,
    /// What stopped it.
    pub stop: Stop,
}

/// A solution on its way.
#[derive(Clone, Copy, Debug)]
pub struct Step<'a> {
    /// Steps so far.
    pub steps: usize,
    /// B; empty while `direct` eliminates.
    pub radiosity: &'a [f64],
    /// ΔB of shooters; empty for others.
    pub unshot: &'a [f64],
    /// Irradiance that stands for what is unshot, for display only: B + ρ × ambient. Zero but for `progressive`.
    pub ambient: f64,
}

/// Solves. `watch` sees every step and may end it by returning false.
pub fn solve_system(
    solver: Solver,
    system: &System,
    params: &Params,
    watch: &mut dyn FnMut(&Step) -> bool,
) -> Solution {
    match solver {
        Solver::Direct => direct::solve(system, watch),
        #[cfg(feature = "faer")]
        Solver::DirectFaer => direct_faer::solve(system, watch),
        Solver::Jacobi => jacobi::solve(system, params, watch),
        Solver::GaussSeidel => gauss_seidel::solve(system, params, watch),
        Solver::Southwell => southwell::solve(system, params, southwell::Order::Largest, watch),
        Solver::SouthwellUnordered => southwell::solve(system, params, southwell::Order::Index, watch),
        Solver::Progressive => progressive::solve(system, params, watch),
    }
}

/// Runs sweeps until a rule strikes. `sweep` improves the radiosities and returns Σ w |change × diagonal|.
fn sweep_until(
    system: &System,
    params: &Params,
    watch: &mut dyn FnMut(&Step) -> bool,
    mut sweep: impl FnMut(&mut Vec<f64>) -> f64,
) -> Solution {
    let count = system.len();
    let emitted = system.emitted().max(f64::MIN_POSITIVE);
    let mut radiosity = params.warm.map_or_else(|| vec![0.0; count], <[f64]>::to_vec);
    let mut rows = 0;
    let mut steps = 0;
    let (residual, stop) = loop {
        if steps >= params.max_steps {
            rows += count;
            break (system.residual(&radiosity), Stop::Steps);
        }
        let change = sweep(&mut radiosity) / emitted;
        steps += 1;
        rows += count;
        if !watch(&Step { steps, radiosity: &radiosity, unshot: &[], ambient: 0.0 }) {
            break (change, Stop::Watcher);
        }
        // The change of a sweep only says when it is worth while to ask for the residual itself.
        if change <= params.residual {
            rows += count;
            let residual = system.residual(&radiosity);
            if residual <= params.residual {
                break (residual, Stop::Residual);
            }
        }
    };
    Solution { radiosity, steps, rows, residual, stop }
}
