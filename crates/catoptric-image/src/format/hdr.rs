//! Radiance HDR in. The exposure and the colour correction that a header says were applied are divided out.

use std::borrow::Cow;
use std::io::Cursor;

use image::ImageDecoder;
use image::codecs::hdr::HdrDecoder;

use crate::{Image, ImageError, ReadLimits};

pub(crate) fn decode(bytes: &[u8], limits: &ReadLimits) -> Result<Image, ImageError> {
    let damaged = |error: image::ImageError| ImageError::damaged("Radiance HDR", error);
    // The other name that writers give themselves, which the decoder does not know.
    let bytes = match bytes.strip_prefix(b"#?RGBE") {
        Some(rest) => Cow::Owned([b"#?RADIANCE", rest].concat()),
        None => Cow::Borrowed(bytes),
    };
    let decoder = HdrDecoder::new(Cursor::new(&*bytes)).map_err(damaged)?;
    let header = decoder.metadata();
    let exposure = header.exposure.unwrap_or(1.0);
    let correction = header.color_correction.map_or([1.0; 3], |(r, g, b)| [r, g, b]);
    let applied = correction.map(|correction| exposure * correction);
    if applied.iter().any(|factor| !(factor.is_normal() && *factor > 0.0)) {
        return Err(ImageError::damaged("Radiance HDR", "an exposure that is not above zero"));
    }
    let (width, height) = decoder.dimensions();
    let pixels = limits.check(u64::from(width), u64::from(height), 3)?;
    if pixels == 0 {
        return Err(ImageError::damaged("Radiance HDR", "no pixels"));
    }
    // The shortest code of a scan line covers 127 pixels with 2 bytes per component.
    if pixels as u64 / 127 > bytes.len() as u64 {
        return Err(ImageError::damaged("Radiance HDR", "it ends before its pixels"));
    }
    let mut buffer = vec![0; pixels * 12];
    decoder.read_image(&mut buffer).map_err(damaged)?;
    let mut image = Image::new(width as usize, height as usize);
    for (k, name) in ["R", "G", "B"].into_iter().enumerate() {
        let plane = buffer
            .chunks_exact(12)
            .map(|p| f32::from_ne_bytes([p[4 * k], p[4 * k + 1], p[4 * k + 2], p[4 * k + 3]]) / applied[k]);
        image.push_channel(name, plane.collect());
    }
    Ok(image)
}
