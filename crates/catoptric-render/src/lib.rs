//! Pass two: a Whitted ray tracer that reads the irradiance of pass one as its diffuse term.
//!
//! Does not know form factor methods or solvers.

pub mod layers;
pub mod lines;
pub mod pixel;
pub mod render;

pub use render::{RenderParams, RenderReport, Rendered, render};
