//! JPEG in.

use std::io::Cursor;

use image::codecs::jpeg::JpegDecoder;

use crate::{Image, ImageError, ReadLimits};

pub(crate) fn decode(bytes: &[u8], limits: &ReadLimits) -> Result<Image, ImageError> {
    let decoder = JpegDecoder::new(Cursor::new(bytes)).map_err(|error| ImageError::damaged("JPEG", error))?;
    super::png::decode_with(decoder, "JPEG", limits)
}
