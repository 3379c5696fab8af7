//! What both passes share: the display mesh and its irradiance, per vertex and term.
//!
//! Does not know rays or solvers: pass one fills a [`Solution`], pass two reads it, and a file keeps it.

mod baked;
pub mod file;
pub mod locator;
pub mod mesh;
pub mod quality;
pub mod solution;

pub use mesh::{DisplayMesh, DisplayVertex, Element, Face, FaceId, Located};
pub use quality::Quality;
pub use solution::{PatchRadiosity, Solution, Term};
