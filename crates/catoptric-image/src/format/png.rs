//! PNG: 1 to 16 bits, grey, palette and colour in; 8-bit RGB out.

use std::io::Cursor;
use std::path::Path;

use image::codecs::png::PngDecoder;
use image::{ColorType, ImageDecoder};

use crate::{Image, ImageError, ReadLimits, write_bytes_atomically};

pub(crate) fn decode(bytes: &[u8], limits: &ReadLimits) -> Result<Image, ImageError> {
    let damaged = |error: image::ImageError| ImageError::damaged("PNG", error);
    let mut bounds = image::Limits::no_limits();
    bounds.max_alloc = Some(limits.max_bytes);
    let decoder = PngDecoder::with_limits(Cursor::new(bytes), bounds).map_err(damaged)?;
    decode_with(decoder, "PNG", limits)
}

/// Decodes whatever 8- or 16-bit decoder of the `image` crate.
pub(super) fn decode_with(
    decoder: impl ImageDecoder,
    format: &'static str,
    limits: &ReadLimits,
) -> Result<Image, ImageError> {
    let (width, height) = decoder.dimensions();
    let colour = decoder.color_type();
    let channels = usize::from(colour.channel_count());
    limits.check(u64::from(width), u64::from(height), channels)?;
    if width == 0 || height == 0 {
        return Err(ImageError::damaged(format, "no pixels"));
    }
    let mut buffer = vec![0; decoder.total_bytes() as usize];
    decoder.read_image(&mut buffer).map_err(|error| ImageError::damaged(format, error))?;
    let (width, height) = (width as usize, height as usize);
    match colour {
        ColorType::L8 | ColorType::La8 | ColorType::Rgb8 | ColorType::Rgba8 => {
            Ok(super::from_bytes(width, height, channels, &buffer))
        }
        ColorType::L16 | ColorType::La16 | ColorType::Rgb16 | ColorType::Rgba16 => {
            Ok(super::from_words(width, height, channels, &buffer))
        }
        other => Err(ImageError::unsupported(format, format!("samples of type {other:?}"))),
    }
}

/// The bytes of an 8-bit RGB PNG tagged as sRGB.
///
/// # Panics
/// If `pixels` does not have width × height elements.
pub fn encode_png8(width: usize, height: usize, pixels: &[[u8; 3]]) -> Result<Vec<u8>, ImageError> {
    assert_eq!(pixels.len(), width * height, "pixels do not fit {width}x{height}");
    let refused = |error: png::EncodingError| ImageError::Inconsistent(error.to_string());
    let side =
        |n: usize| u32::try_from(n).map_err(|_| ImageError::Inconsistent(format!("{n} pixels on a side")));
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, side(width)?, side(height)?);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
    // A quarter of the time of the default level, for 7 % more bytes.
    encoder.set_deflate_compression(png::DeflateCompression::Level(3));
    let mut writer = encoder.write_header().map_err(refused)?;
    writer.write_image_data(pixels.as_flattened()).map_err(refused)?;
    writer.finish().map_err(refused)?;
    Ok(bytes)
}

/// Writes [`encode_png8`] atomically.
pub fn write_png8(path: &Path, width: usize, height: usize, pixels: &[[u8; 3]]) -> Result<(), ImageError> {
    let bytes = encode_png8(width, height, pixels)?;
    write_bytes_atomically(path, &bytes).map_err(|error| ImageError::io(path, error))
}
