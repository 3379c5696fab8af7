//! Pass one: from a scene to irradiance on a display mesh.
//!
//! Does not know cameras or images.

pub mod solve;

pub use solve::{SolveParams, SolveReport, Solved, solve};
