//! Ray tracing, the surface interaction and the S* walk.
//!
//! Does not know patches, meshes for display, solvers or cameras. The interaction of light with a surface exists once,
//! in [`interaction`]; every pass drives it through [`walk`].

pub mod beam;
pub mod boxes;
pub mod chain;
mod eight;
pub mod extent;
mod flat;
pub mod fresnel;
pub mod interaction;
pub mod ledger;
pub mod medium;
mod overlap;
mod packet;
pub mod plane;
pub mod sequence;
pub mod slab;
pub mod tracer;
mod tree;
pub mod walk;

pub use boxes::BoxTree;
pub use chain::{Chain, Event};
pub use extent::Extent;
pub use ledger::Ledger;
pub use medium::{MediumId, MediumStack};
pub use packet::Occlusion;
pub use plane::{PlaneId, Planes};
pub use slab::SlabId;
pub use tracer::{Accelerator, Hit, Ray, Tracer};
