//! The sRGB transfer function (IEC 61966-2-1), both ways.

use std::sync::LazyLock;

/// Linear light of a code value in `[0, 1]`.
pub fn decode(code: f32) -> f32 {
    if code <= 0.04045 { code / 12.92 } else { libm::powf((code + 0.055) / 1.055, 2.4) }
}

/// Code value of linear light in `[0, 1]`.
pub fn encode(linear: f32) -> f32 {
    if linear <= 0.003_130_8 { linear * 12.92 } else { 1.055 * libm::powf(linear, 1.0 / 2.4) - 0.055 }
}

/// Linear light of the 256 byte codes.
pub static LINEAR_OF_BYTE: LazyLock<[f32; 256]> =
    LazyLock::new(|| std::array::from_fn(|code| decode(code as f32 / 255.0)));

/// Linear light at which byte code k+1 begins: the middle between two codes, decoded.
static BYTE_BOUNDARIES: LazyLock<[f32; 255]> =
    LazyLock::new(|| std::array::from_fn(|code| decode((code as f32 + 0.5) / 255.0)));

/// The nearest byte code; light outside `[0, 1]` is clipped, NaN is black.
pub fn byte(linear: f32) -> u8 {
    BYTE_BOUNDARIES.partition_point(|&boundary| boundary <= linear) as u8
}
