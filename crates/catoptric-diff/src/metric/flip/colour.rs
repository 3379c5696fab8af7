//! The colour spaces of FLIP: opponent colours for the eye's filters, Hunt-adjusted CIELab for differences.

use super::fast_math::{cbrt, larger};

/// XYZ relative to the D65 white: rows of the matrix of the reference implementation divided by its illuminant.
#[inline(always)]
fn relative_xyz(rgb: [f32; 3]) -> [f32; 3] {
    const X: f32 = 1.052_156_9 / 24_577_794.0;
    const Y: f32 = 1.0 / 12_288_897.0;
    const Z: f32 = 0.918_357_7 / 73_733_382.0;
    let [r, g, b] = rgb;
    [
        (10_135_552.0 * X) * r + (8_788_810.0 * X) * g + (4_435_075.0 * X) * b,
        (2_613_072.0 * Y) * r + (8_788_810.0 * Y) * g + (887_015.0 * Y) * b,
        (1_425_312.0 * Z) * r + (8_788_810.0 * Z) * g + (70_074_185.0 * Z) * b,
    ]
}

/// Opponent colours: lightness, red–green, blue–yellow, all linear in light.
#[inline(always)]
pub(super) fn ycxcz(rgb: [f32; 3]) -> [f32; 3] {
    let [x, y, z] = relative_xyz(rgb);
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

#[inline(always)]
pub(super) fn rgb_of_ycxcz([y, cx, cz]: [f32; 3]) -> [f32; 3] {
    let y = (y + 16.0) * (1.0 / 116.0);
    let x = (y + cx * (1.0 / 500.0)) * 0.950_428_55;
    let z = (y - cz * (1.0 / 200.0)) * 1.088_900_4;
    [
        3.241_003_3 * x - 1.537_398_9 * y - 0.498_615_86 * z,
        -0.969_224_33 * x + 1.875_930_1 * y + 0.041_554_224 * z,
        0.055_639_423 * x - 0.204_011_2 * y + 1.057_148_9 * z,
    ]
}

/// CIELab with chroma scaled by lightness (Hunt effect).
#[inline(always)]
pub(super) fn hunt_lab(rgb: [f32; 3]) -> [f32; 3] {
    let [x, y, z] = relative_xyz(rgb);
    let (x, y, z) = (lab_curve(x), lab_curve(y), lab_curve(z));
    let l = 116.0 * y - 16.0;
    [l, l * (5.0 * (x - y)), l * (2.0 * (y - z))]
}

/// The cube root, near black its tangent.
#[inline(always)]
fn lab_curve(v: f32) -> f32 {
    const DELTA: f32 = 6.0 / 29.0;
    const KNEE: f32 = DELTA * DELTA * DELTA;
    let root = cbrt(larger(v, KNEE));
    if v > KNEE { root } else { v * (1.0 / (3.0 * DELTA * DELTA)) + 4.0 / 29.0 }
}

/// City-block distance in lightness plus Euclidean distance in chroma (Abasi, Amani Tehran & Fairchild 2020).
#[inline(always)]
pub(super) fn hyab(p: [f32; 3], q: [f32; 3]) -> f32 {
    let (a, b) = (p[1] - q[1], p[2] - q[2]);
    (p[0] - q[0]).abs() + (a * a + b * b).sqrt()
}
