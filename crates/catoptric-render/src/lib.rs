//! Pass two: a Whitted ray tracer that reads the irradiance of pass one as its diffuse term.
//!
//! Does not know form factor methods or solvers.

mod bundles;
pub mod direct;
mod interpolation;
mod irradiance_cache;
pub mod layers;
pub mod lines;
mod needs;
mod outlines;
mod penumbrae;
pub mod pixel;
mod probes;
pub mod render;
mod resolution;
mod supersampling;

pub use direct::DirectLight;
pub use render::{RenderParams, RenderReport, Rendered, render};
