//! FLIP: what a viewer notices when two images alternate on a screen.
//!
//! LDR-FLIP: Andersson, Nilsson, Akenine-Möller, Oskarsson, Åström & Fairchild, "FLIP: A Difference Evaluator for
//! Alternating Images", HPG 2020. HDR-FLIP: Andersson, Nilsson, Shirley & Akenine-Möller, "Visualizing Errors in Rendered
//! High Dynamic Range Images", EG 2021. Equations are those of the papers; the constants, the tone mapper (ACES), the
//! exposure range and the separation of the filters follow the reference implementation 1.7 (BSD-3-Clause, NVIDIA).
//!
//! Where we deviate: the two sRGB conversions around the tone mapper cancel and are left out; achromatic and red–green
//! filters are cut where their weights fall below 1e-7 of the largest; powers are polynomials. The tests hold the means to
//! 1e-4 of the reference implementation. That one adds up its mean in single precision: on millions of pixels the mean of
//! its own map is what ours agrees with.
//!
//! Images are walked in blocks, both at once, all exposures before the next block. The inner loops are compiled for the
//! widest vectors of the machine; without fused operations the bits are the same on all.

mod block;
mod colour;
mod fast_math;
mod filters;

use pulp::Arch;
use rayon::prelude::*;

use self::block::{Block, Display, HEIGHT, Picture, Raise, WIDTH, Workspace};
use self::filters::Filters;
use crate::planes::Planes;

/// Pixels per degree of visual angle: a screen of 3840 pixels over 0.7 m seen from 0.7 m.
pub const DEFAULT_PPD: f32 = 3840.0 * std::f32::consts::PI / 180.0;

/// Exponent and remapping of the colour difference, spatial width and exponent of features (paper, table 1).
const Q_COLOUR: f32 = 0.7;
const P_C: f32 = 0.4;
const P_T: f32 = 0.95;
const FEATURE_WIDTH: f32 = 0.082;

/// The ACES tone mapper of the reference implementation: (a x² + b x + c) / (d x² + e x + f).
const ACES: [f32; 6] = [0.6 * 0.6 * 2.51, 0.6 * 0.03, 0.0, 0.6 * 0.6 * 2.43, 0.6 * 0.59, 0.14];

/// How an image becomes display-referred.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Exposures {
    /// It is display-referred already: values are linear light in `[0, 1]`.
    None,
    /// It is shown as sRGB bytes, its light multiplied by this gain.
    Bytes {
        /// Factor of light.
        gain: f32,
    },
    /// The largest error over this range of exposures, in stops, both ends included.
    Range {
        /// First exposure.
        start: f32,
        /// Last exposure.
        stop: f32,
        /// How many, at least two.
        count: usize,
    },
}

impl Exposures {
    /// The range HDR-FLIP derives from the reference: from "its brightest pixel maps to 85 % of white" to "its median
    /// does", about one exposure per stop (EG 2021, section 4).
    pub fn of_reference(reference: &Planes) -> Exposures {
        // Luminance that the tone mapper sends to 0.85: the larger root of a quadratic.
        let [a, b, c] = [ACES[0] - 0.85 * ACES[3], ACES[1] - 0.85 * ACES[4], ACES[2] - 0.85 * ACES[5]];
        let half = -0.5 * (b / a);
        let white = half + (half * half - c / a).sqrt();
        let mut luminance: Vec<f32> = reference
            .pixels()
            .map(|p| 0.2126 * p[0].max(0.0) + 0.7152 * p[1].max(0.0) + 0.0722 * p[2].max(0.0))
            .collect();
        let n = luminance.len();
        if n == 0 {
            return Exposures::Range { start: 0.0, stop: 0.0, count: 2 };
        }
        let brightest = luminance.iter().copied().fold(0.0, f32::max).max(f32::MIN_POSITIVE);
        // Of an even number of pixels the implementation takes the upper median.
        let (_, &mut median, _) = luminance.select_nth_unstable_by(n / 2, f32::total_cmp);
        let median = median.max(f32::MIN_POSITIVE);
        let (start, stop) = (libm::log2f(white / brightest), libm::log2f(white / median));
        Exposures::Range { start, stop, count: ((stop - start).ceil() as usize).max(2) }
    }

    fn displays(self) -> Vec<Display> {
        match self {
            Exposures::None => vec![Display::AsItIs],
            Exposures::Bytes { gain } => vec![Display::Bytes(gain)],
            Exposures::Range { start, stop, count } => (0..count)
                .map(|i| start + i as f32 * ((stop - start) / (count.max(2) - 1) as f32))
                .map(|stops| Display::Exposed(libm::exp2f(stops)))
                .collect(),
        }
    }
}

/// The FLIP error of every pixel, in `[0, 1]`. `reference` and `test` are linear Rec. 709, finite.
pub fn error_map(
    width: usize,
    height: usize,
    reference: &Planes,
    test: &Planes,
    exposures: Exposures,
    ppd: f32,
) -> Vec<f32> {
    let pictures = [reference, test].map(|planes| Picture { width, height, planes });
    error_map_on(Arch::new(), pictures, exposures, ppd)
}

/// [`error_map`] with the vectors of `arch`.
fn error_map_on(arch: Arch, [reference, test]: [Picture; 2], exposures: Exposures, ppd: f32) -> Vec<f32> {
    let mut map = vec![0.0; reference.width * reference.height];
    if map.is_empty() {
        return map;
    }
    let filters = Filters::new(ppd);
    let displays = exposures.displays();
    blocks(&mut map, reference.width).into_par_iter().for_each_init(
        || Workspace::new(&filters),
        |workspace, mut block| {
            if block.sees_no_difference(reference, test, filters.radius) {
                return;
            }
            for &display in &displays {
                let (block, filters) = (&mut block, &filters);
                arch.dispatch(Raise { workspace, block, pictures: [reference, test], display, filters });
            }
        },
    );
    map
}

/// Cuts a map into blocks.
fn blocks(map: &mut [f32], width: usize) -> Vec<Block<'_>> {
    let mut blocks = Vec::new();
    for (strip, lines) in map.chunks_mut(width * HEIGHT).enumerate() {
        let first = blocks.len();
        for (row, line) in lines.chunks_mut(width).enumerate() {
            for (column, piece) in line.chunks_mut(WIDTH).enumerate() {
                if row == 0 {
                    let (left, top) = (column * WIDTH, strip * HEIGHT);
                    blocks.push(Block { left, top, lines: Vec::with_capacity(HEIGHT) });
                }
                blocks[first + column].lines.push(piece);
            }
        }
    }
    blocks
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An image of noise: larger than a block both ways, of odd size.
    fn noise(seed: u32) -> Planes {
        let sample = |channel: u32| {
            move |i: u32| {
                let hash = (i * 3 + channel + seed).wrapping_mul(0x9e37_79b9) ^ (i << 7);
                (hash.wrapping_mul(0x85eb_ca6b) >> 8) as f32 / (1 << 20) as f32
            }
        };
        Planes::new([0, 1, 2].map(|channel| (0..WIDE * HIGH).map(sample(channel)).collect()))
    }

    const WIDE: u32 = 301;
    const HIGH: u32 = 131;

    #[test]
    fn maps_are_the_same_bits_for_any_vectors_and_any_number_of_threads() {
        let (reference, test) = (noise(1), noise(2));
        let pictures =
            [&reference, &test].map(|planes| Picture { width: WIDE as usize, height: HIGH as usize, planes });
        let bits = |arch: Arch, threads: usize| -> Vec<u32> {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            let range = Exposures::Range { start: -3.0, stop: 1.0, count: 3 };
            let map = pool.install(|| error_map_on(arch, pictures, range, DEFAULT_PPD));
            map.into_iter().map(f32::to_bits).collect()
        };
        let expected = bits(Arch::Scalar, 1);
        assert!(expected.iter().any(|&v| f32::from_bits(v) > 0.1), "noise differs");
        assert!(expected == bits(Arch::new(), 1), "vectors change the bits");
        assert!(expected == bits(Arch::new(), 5), "threads change the bits");
    }

    #[test]
    fn equal_images_have_no_error_and_a_changed_pixel_shows_only_as_far_as_the_filters_reach() {
        let reference = noise(1);
        let mut channels = reference.channels().clone();
        let (x, y) = (260_usize, 119_usize);
        channels[1][y * WIDE as usize + x] += 1.0;
        let test = Planes::new(channels);
        let map = error_map(
            WIDE as usize,
            HIGH as usize,
            &reference,
            &test,
            Exposures::Range { start: -3.0, stop: 1.0, count: 2 },
            DEFAULT_PPD,
        );
        let reach = Filters::new(DEFAULT_PPD).radius;
        for (i, &error) in map.iter().enumerate() {
            let (dx, dy) = ((i % WIDE as usize).abs_diff(x), (i / WIDE as usize).abs_diff(y));
            assert!(error == 0.0 || dx.max(dy) <= reach, "{dx} {dy}: {error}");
        }
        assert!(map[y * WIDE as usize + x] > 0.0);
        let none = error_map(WIDE as usize, HIGH as usize, &test, &test, Exposures::None, DEFAULT_PPD);
        assert!(none.iter().all(|&error| error == 0.0));
    }
}
