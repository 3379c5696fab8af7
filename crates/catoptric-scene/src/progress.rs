//! How long work reports and how it is stopped: progress and cancellation come in as a parameter.

/// Receives the progress of a stage and may ask it to stop. Called from many threads, a few hundred times a stage.
pub trait Progress: Sync {
    /// A stage begins; `total` units of work lie ahead (rays, vertices or rows: the stage's name says which).
    fn begin(&self, stage: &str, total: u64);
    /// Some units are done.
    fn advance(&self, units: u64);
    /// Whether to stop now: the stage then ends with an error within a fraction of a second.
    fn is_cancelled(&self) -> bool;
}

/// Says nothing and never stops.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl Progress for Silent {
    fn begin(&self, _stage: &str, _total: u64) {}
    fn advance(&self, _units: u64) {}
    fn is_cancelled(&self) -> bool {
        false
    }
}

/// The work was stopped by [`Progress::is_cancelled`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cancelled;

impl std::fmt::Display for Cancelled {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.write_str("stopped on request")
    }
}

impl std::error::Error for Cancelled {}
