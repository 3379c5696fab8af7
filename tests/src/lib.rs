//! What the end-to-end tests in `tests/` share: the slow twin of the renderer, and how a picture is compared with it.

pub mod compare;
mod particles;
mod path;
pub mod twin;
