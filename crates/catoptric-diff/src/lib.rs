//! Image metrics, limits, heat maps and reports.
//!
//! This crate compares anybody's images: it shares no code with the renderer but the image type, and knows nothing of
//! scenes.

mod certificate;
mod colour;
mod compare;
mod directory;
mod error;
mod job;
mod limits;
pub mod metric;
mod pair;
pub mod pictures;
mod planes;
pub mod report;
mod sums;

pub use certificate::{Approval, Certificate, approve, certificate_path, limits_beside, limits_path};
pub use compare::{Comparison, LayerComparison, Params, compare};
pub use directory::{approve_directory, run_directories};
pub use error::DiffError;
pub use job::{Job, Outcome, run};
pub use limits::{Check, Limits, parse_limit};
pub use metric::{Metric, Reading, Sense};
pub use pair::{NonFinite, Pair, Rgb, Space, StandardError, Values};
pub use planes::Planes;
