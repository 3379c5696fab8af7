//! Colours of error maps: magma for magnitudes, red–white–blue for signs.

/// Every sixteenth colour of matplotlib's magma (van der Walt & Smith 2015, CC0) and its last.
pub(crate) const MAGMA: [[u8; 3]; 17] = [
    [0, 0, 4],
    [10, 8, 34],
    [29, 17, 71],
    [54, 16, 107],
    [81, 18, 124],
    [106, 28, 129],
    [131, 38, 129],
    [156, 46, 127],
    [183, 55, 121],
    [208, 65, 111],
    [231, 82, 99],
    [245, 107, 92],
    [252, 137, 97],
    [254, 167, 114],
    [254, 196, 136],
    [253, 226, 163],
    [252, 253, 191],
];

/// A magnitude in `[0, 1]`.
pub(crate) fn magma(value: f32) -> [u8; 3] {
    let at = value.clamp(0.0, 1.0) * 16.0;
    let index = (at as usize).min(15);
    let t = at - index as f32;
    std::array::from_fn(|k| mix(MAGMA[index][k], MAGMA[index + 1][k], t))
}

/// A sign in [−1,1]: blue where the test image is darker, red where it is brighter, white where equal.
pub(crate) fn red_blue(value: f32) -> [u8; 3] {
    const RED: [u8; 3] = [178, 24, 43];
    const BLUE: [u8; 3] = [33, 102, 172];
    let end = if value > 0.0 { RED } else { BLUE };
    // The root shows small biases.
    let t = value.abs().min(1.0).sqrt();
    end.map(|c| mix(247, c, t))
}

fn mix(a: u8, b: u8, t: f32) -> u8 {
    (f32::from(a) + (f32::from(b) - f32::from(a)) * t).round() as u8
}
