//! glTF in and out.
#![allow(clippy::unwrap_used, reason = "a test that cannot be set up should stop")]

mod files;
mod geometry;
mod materials;
mod problems;
mod support;
