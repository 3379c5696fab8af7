//! Pass one from end to end.

use catoptric_scene::{Cancelled, Progress};
use catoptric_solution::{Quality, Solution};
use catoptric_trace::walk::WalkParams;
use catoptric_trace::{Ledger, Tracer};

/// Parameters of pass one.
#[derive(Clone, Debug, PartialEq)]
pub struct SolveParams {
    /// Limits of the S* walk; `extended: false` for plain radiosity.
    pub walk: WalkParams,
    /// Seed of all sequences.
    pub seed: u32,
}

impl SolveParams {
    /// The budgets of a quality.
    pub fn for_quality(_quality: Quality) -> Self {
        Self { walk: WalkParams::default(), seed: 0 }
    }
}

/// What pass one did.
#[derive(Clone, Debug, Default)]
pub struct SolveReport {
    /// Rays traced, per stage.
    pub rays: Vec<(&'static str, u64)>,
    /// Patches of the coarse solve.
    pub patches: usize,
    /// Faces, elements and vertices of the display mesh.
    pub faces: usize,
    /// Elements.
    pub elements: usize,
    /// Vertices.
    pub vertices: usize,
    /// Mean ledger of the rows, shares of the power sent.
    pub row_ledger: Ledger,
    /// Solver iterations.
    pub iterations: usize,
    /// Residual relative to the emitted power where the solver stopped.
    pub residual: f64,
    /// Image chains.
    pub image_chains: usize,
    /// Emitting triangles.
    pub emitters: usize,
    /// What a person should know.
    pub notes: Vec<String>,
}

/// The result of pass one.
#[derive(Clone, Debug)]
pub struct Solved {
    /// The solution.
    pub solution: Solution,
    /// What was done.
    pub report: SolveReport,
}

/// Solves the light of a scene.
pub fn solve(tracer: &Tracer, params: &SolveParams, progress: &dyn Progress) -> Result<Solved, Cancelled> {
    let _ = (tracer, params, progress);
    Err(Cancelled)
}
