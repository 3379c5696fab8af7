//! Linear images: EXR, HDR, PFM, PNG and JPEG in and out, exposure and tone map.
//!
//! An [`Image`] is a set of named float channels of one size, in linear light. What a file looked like on disk (half or
//! float, tiles or scan lines, sRGB code values, several parts) ends at the reader; only [`Encoding`] remembers whether
//! the file held display-referred values. This crate does not know how an image was rendered.
//!
//! Readers take hostile input: sizes are checked against [`ReadLimits`] before anything is allocated for them.

mod atomic;
mod error;
mod format;
mod image;
mod limits;
pub mod srgb;
pub mod tone;

pub use atomic::{is_stream, place_of_output, write_bytes_atomically};
pub use error::ImageError;
pub use format::png::{encode_png8, write_png8};
pub use image::{Channel, Encoding, Image};
pub use limits::ReadLimits;
