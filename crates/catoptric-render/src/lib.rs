//! Pass two: a Whitted ray tracer that reads the irradiance of pass one as its diffuse term.
//!
//! Does not know form factor methods or solvers.

mod bundles;
pub mod direct;
pub mod layers;
pub mod lines;
mod needs;
mod outlines;
mod penumbrae;
pub mod pixel;
pub mod render;
mod resolution;
mod supersampling;

pub use direct::DirectLight;
pub use render::{RenderParams, RenderReport, Rendered, render};
