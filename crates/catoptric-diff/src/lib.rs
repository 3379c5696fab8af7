//! Image metrics, limits, heat maps and reports.
//!
//! This crate compares anybody's images: it shares no code with the renderer but the image type.

mod error;
pub mod metric;
mod pair;
mod sums;

pub use error::DiffError;
pub use metric::{Metric, Reading, Sense};
pub use pair::{NonFinite, Pair, Rgb, Space, Values};
