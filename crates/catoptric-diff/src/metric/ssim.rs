//! Structural similarity (Wang, Bovik, Sheikh & Simoncelli 2004): 11×11 Gaussian windows with σ = 1.5, K₁ = 0.01,
//! K₂ = 0.03, L = 1; mean over the windows that lie inside the image, and over the channels.
//!
//! Windows are separable and even: rows first, then columns, in blocks of which a few lines at a time are kept. Double
//! precision: a variance is a difference of moments.

use std::ops::Range;

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use super::{Measure, Reading, Sense, Settings};
use crate::pair::Pair;

const SIZE: usize = 11;
const SIGMA: f64 = 1.5;
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;
const HALF: usize = SIZE / 2 + 1;
/// Columns and rows of windows per task.
const WIDTH: usize = 256;
const HEIGHT: usize = 120;
/// Rows finished between two moves of the filtered lines.
const BATCH: usize = 24;
/// Lanes the inner loops are written for.
const LANES: usize = 8;

type Lanes = [f64; LANES];

pub(super) struct Ssim;

impl Measure for Ssim {
    fn measure(&self, pair: &Pair, _: &Settings) -> Vec<Reading> {
        if pair.width < SIZE || pair.height < SIZE {
            return Vec::new();
        }
        let (across, down) = (pair.width - SIZE + 1, pair.height - SIZE + 1);
        let columns = across.div_ceil(WIDTH);
        let weights = gaussian();
        let arch = Arch::new();
        let parts: Vec<[f64; 2]> = (0..columns * down.div_ceil(HEIGHT))
            .into_par_iter()
            .map_init(Workspace::new, |workspace, block| {
                let (left, top) = (block % columns * WIDTH, block / columns * HEIGHT);
                let rows = top..down.min(top + HEIGHT);
                arch.dispatch(BlockSum { workspace, pair, left, rows, weights: &weights })
            })
            .collect();
        let [sum, count] = parts.into_iter().fold([0.0; 2], |[s, n], [ps, pn]| [s + ps, n + pn]);
        if count == 0.0 {
            return Vec::new();
        }
        vec![Reading::new("SSIM", sum / count, Sense::HigherIsBetter)]
    }
}

/// The four moments of a window: E x, E r, E (x² + r²), E xr.
type Moments = [Vec<f64>; 4];

/// The work on one block, as [`Arch::dispatch`] takes it. It takes closures too, but those are not always compiled for its
/// instructions.
struct BlockSum<'a> {
    workspace: &'a mut Workspace,
    pair: &'a Pair,
    left: usize,
    rows: Range<usize>,
    weights: &'a [f64; HALF],
}

impl WithSimd for BlockSum<'_> {
    type Output = [f64; 2];

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> [f64; 2] {
        self.workspace.block_sum(self.pair, self.left, self.rows, self.weights)
    }
}

/// Buffers of one thread.
struct Workspace {
    /// Of one line of samples.
    products: Moments,
    /// Of the lines the column filter sees, filtered along rows.
    filtered: Moments,
}

impl Workspace {
    fn new() -> Workspace {
        Workspace {
            products: std::array::from_fn(|_| vec![0.0; WIDTH + SIZE - 1 + LANES]),
            filtered: std::array::from_fn(|_| vec![0.0; WIDTH * (BATCH + SIZE - 1)]),
        }
    }

    /// Sum of SSIM over the windows that begin in a block and whose centre counts, and their number.
    #[inline(always)]
    fn block_sum(&mut self, pair: &Pair, left: usize, rows: Range<usize>, weights: &[f64; HALF]) -> [f64; 2] {
        let width = WIDTH.min(pair.width - (SIZE - 1) - left);
        let groups = width.div_ceil(LANES);
        let mut total = [0.0; 2];
        for channel in 0..3 {
            for start in rows.clone().step_by(BATCH) {
                let batch = BATCH.min(rows.end - start);
                // The lines that the batch before saw too are moved to the top.
                let filled = if start == rows.start { 0 } else { SIZE - 1 };
                if filled > 0 {
                    for moment in &mut self.filtered {
                        moment.copy_within(BATCH * WIDTH..(BATCH + SIZE - 1) * WIDTH, 0);
                    }
                }
                for slot in filled..batch + SIZE - 1 {
                    self.enter(pair, channel, (start + slot) * pair.width + left, width, slot, weights);
                }
                for row in 0..batch {
                    for group in 0..groups {
                        let at = row * WIDTH + group * LANES;
                        let mut moments = [[0.0; LANES]; 4];
                        for (moment, lines) in moments.iter_mut().zip(&self.filtered) {
                            *moment = windows(&lines[at..], WIDTH, weights);
                        }
                        let index = index(&moments);
                        let centre = (start + row + SIZE / 2) * pair.width + left + group * LANES + SIZE / 2;
                        for lane in 0..LANES.min(width - group * LANES) {
                            if pair.counts(centre + lane) {
                                total[0] += index[lane];
                                total[1] += 1.0;
                            }
                        }
                    }
                }
            }
        }
        total
    }

    /// Filters the products of one line of samples into a slot.
    #[inline(always)]
    fn enter(
        &mut self,
        pair: &Pair,
        channel: usize,
        start: usize,
        width: usize,
        slot: usize,
        weights: &[f64; HALF],
    ) {
        let values = pair.values();
        let length = width + SIZE - 1;
        let (mut test, mut reference) = ([0.0; WIDTH + SIZE - 1], [0.0; WIDTH + SIZE - 1]);
        test[..length].copy_from_slice(&values.test.channels()[channel][start..start + length]);
        reference[..length].copy_from_slice(&values.reference.channels()[channel][start..start + length]);
        let [a, b, squares, product] = &mut self.products;
        for x in 0..WIDTH + SIZE - 1 {
            let (t, r) = (f64::from(test[x]) * values.unit, f64::from(reference[x]) * values.unit);
            (a[x], b[x], squares[x], product[x]) = (t, r, t * t + r * r, t * r);
        }
        for (product, target) in self.products.iter().zip(&mut self.filtered) {
            for group in 0..width.div_ceil(LANES) {
                let at = slot * WIDTH + group * LANES;
                let filtered = windows(&product[group * LANES..], 1, weights);
                target[at..at + LANES].copy_from_slice(&filtered);
            }
        }
    }
}

/// Windows that begin at the first samples; `step` apart are the samples of a window.
#[inline(always)]
fn windows(source: &[f64], step: usize, weights: &[f64; HALF]) -> Lanes {
    let source = &source[..(SIZE - 1) * step + LANES];
    let mut sum = [0.0; LANES];
    for (k, &weight) in weights.iter().enumerate() {
        let (a, b) = (&source[k * step..][..LANES], &source[(SIZE - 1 - k) * step..][..LANES]);
        for lane in 0..LANES {
            sum[lane] += weight * (a[lane] + b[lane]);
        }
    }
    sum
}

/// Equation 13 of the paper, variances with the window's weights.
#[inline(always)]
fn index([a, b, squares, ab]: &[Lanes; 4]) -> Lanes {
    let mut index = [0.0; LANES];
    for lane in 0..LANES {
        let (means, product) = (a[lane] * a[lane] + b[lane] * b[lane], a[lane] * b[lane]);
        let (variances, covariance) = (squares[lane] - means, ab[lane] - product);
        index[lane] = (2.0 * product + C1) * (2.0 * covariance + C2) / ((means + C1) * (variances + C2));
    }
    index
}

/// The weights of one half of a window; that of the centre is halved, for it is met from both sides.
fn gaussian() -> [f64; HALF] {
    let bell = |i: usize| {
        let x = (HALF - 1 - i) as f64;
        libm::exp(-x * x / (2.0 * SIGMA * SIGMA)) * if i == HALF - 1 { 0.5 } else { 1.0 }
    };
    let sum: f64 = (0..HALF).map(|i| 2.0 * bell(i)).sum();
    std::array::from_fn(|i| bell(i) / sum)
}
