//! Emitters, image chains, irradiance at a point by term, and **who owns a light path**.
//!
//! Does not know patches, meshes or cameras.

mod broad;
mod chain_tree;
pub mod chains;
pub mod contour;
pub mod emitter;
pub mod glint;
pub mod irradiance;
pub mod lamp;
pub mod lens;
pub mod light_tree;
pub mod owner;
mod parts;
pub mod punctual;
mod reach;
pub mod receiver;
pub mod sky;

pub use chains::{ImageChain, ImageChains};
pub use emitter::Emitters;
pub use glint::Glint;
pub use irradiance::{LightParams, Lights};
pub use lens::Lenses;
pub use owner::{Owner, PathClass, Source};
pub use receiver::Receiver;
