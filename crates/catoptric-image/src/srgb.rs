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

/// The byte code at the beginning of each stretch of light whose numbers share their upper 16 bits, from 2⁻¹³, below all
/// boundaries, to 1.
static STRETCHES: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let stretches = (DARKEST..1f32.to_bits() >> 16).map(|upper| f32::from_bits(upper << 16));
    stretches.map(|light| BYTE_BOUNDARIES.partition_point(|&boundary| boundary <= light) as u8).collect()
});

/// Upper 16 bits of 2⁻¹³.
const DARKEST: u32 = 114 << 7;

/// The nearest byte code; light outside `[0, 1]` is clipped, NaN is black.
#[inline]
pub fn byte(linear: f32) -> u8 {
    if linear >= 1.0 {
        return 255;
    }
    let boundaries = &*BYTE_BOUNDARIES;
    let stretch = ((linear.max(0.0).to_bits() >> 16).saturating_sub(DARKEST)) as usize;
    let mut code = STRETCHES[stretch];
    while code < 255 && boundaries[usize::from(code)] <= linear {
        code += 1;
    }
    code
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_are_those_of_a_search_through_all_boundaries() {
        let search = |light: f32| BYTE_BOUNDARIES.partition_point(|&boundary| boundary <= light) as u8;
        let near = BYTE_BOUNDARIES.iter().flat_map(|b| [b.next_down(), *b, b.next_up()]);
        let spread = (0..200_000).map(|i| f32::from_bits(i * 21_000));
        let odd = [-1.0, -0.0, 0.0, 1.0, 1f32.next_down(), 7.0, f32::INFINITY, f32::NEG_INFINITY, f32::NAN];
        for light in near.chain(spread).chain(odd) {
            assert_eq!(byte(light), search(light), "{light}");
        }
    }
}
