//! Pass one: from a scene to irradiance on a display mesh.
//!
//! Does not know cameras or images.

mod allocation;
mod arrangement;
pub mod base_mesh;
pub mod caustic;
pub mod coarse;
pub mod contact;
mod curve;
mod cut;
mod detail;
pub mod display;
pub mod draft;
pub mod face;
pub mod face_grid;
pub mod field;
mod final_gather;
pub mod fit;
pub mod frames;
pub mod gather;
pub mod guide;
mod hats;
mod inset;
mod lattice;
mod lineage;
pub mod media;
pub mod method;
pub mod near;
pub mod near_light;
pub mod patch;
pub mod reconstruct;
pub mod refine;
pub mod rows;
pub mod sharing;
mod sky_shares;
mod sliver;
pub mod solve;
pub mod solver;
mod source_light;
pub mod triangulate;

pub use base_mesh::{MeshCount, count_mesh};
pub use solve::{SolveError, SolveParams, SolveReport, Solved, solve};

/// Receivers in one parallel job at most. By itself rayon stops splitting after few halves, and a thread that is done waits
/// for the long last piece of another.
const JOB: usize = 32;
