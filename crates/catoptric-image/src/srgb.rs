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

/// The code above `linear` light if its place between the two codes around it is beyond `threshold`, else the one below: over
/// all thresholds of `[0, 1)` their mean is the light. Light outside `[0, 1]` is clipped, NaN is black.
#[inline]
pub fn byte_at(linear: f32, threshold: f32) -> u8 {
    let codes = &*LINEAR_OF_BYTE;
    let linear = linear.max(0.0);
    let nearest = byte(linear);
    let below = if codes[usize::from(nearest)] > linear { nearest - 1 } else { nearest };
    let (low, high) = match codes.get(usize::from(below) + 1) {
        Some(&high) => (codes[usize::from(below)], high),
        None => return below,
    };
    below + u8::from(linear - low > threshold * (high - low))
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

    #[test]
    fn codes_stay_and_the_mean_over_thresholds_is_the_light() {
        let thresholds = || (0..1000).map(|k| k as f32 / 1000.0);
        for (code, &light) in LINEAR_OF_BYTE.iter().enumerate() {
            assert!(thresholds().all(|t| usize::from(byte_at(light, t)) == code), "{code}");
        }
        for k in 0..500 {
            let light = libm::powf(k as f32 / 500.0, 3.0);
            let codes = thresholds().map(|t| f64::from(LINEAR_OF_BYTE[usize::from(byte_at(light, t))]));
            let mean = codes.sum::<f64>() / 1000.0;
            // A thousandth of the widest step, 0.0089.
            assert!((mean - f64::from(light)).abs() < 9e-6, "{light} {mean}");
        }
        assert_eq!([f32::NAN, -1.0, 2.0, f32::INFINITY].map(|v| byte_at(v, 0.5)), [0, 0, 255, 255]);
    }
}
