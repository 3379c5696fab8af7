//! How much work to spend.

/// One word for all budgets of both passes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub enum Quality {
    /// Where lamps and cameras go: about a tenth of a second on rooms of a few dozen surfaces.
    Sketch,
    /// A first look: under a second on rooms of a few dozen surfaces.
    Draft,
    /// What one shows.
    #[default]
    Standard,
    /// Indistinguishable from converged at the size of a screen.
    High,
}
