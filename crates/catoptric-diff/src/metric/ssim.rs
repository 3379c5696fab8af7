//! Structural similarity (Wang, Bovik, Sheikh & Simoncelli 2004): 11×11 Gaussian windows with σ = 1.5, K₁ = 0.01,
//! K₂ = 0.03, L = 1; mean over the windows that lie inside the image, and over the channels.
//!
//! Windows are separable: rows first, then columns, a strip of rows at a time so that nothing of the image's size is kept.

use pulp::Arch;
use rayon::prelude::*;

use super::{Measure, Reading, Sense, Settings};
use crate::pair::Pair;

const SIZE: usize = 11;
const SIGMA: f64 = 1.5;
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;
/// Window rows per task.
const STRIP: usize = 32;

pub(super) struct Ssim;

impl Measure for Ssim {
    fn measure(&self, pair: &Pair, _: &Settings) -> Vec<Reading> {
        if pair.width < SIZE || pair.height < SIZE {
            return Vec::new();
        }
        let windows = pair.height - SIZE + 1;
        let arch = Arch::new();
        let parts: Vec<[f64; 2]> = (0..windows.div_ceil(STRIP))
            .into_par_iter()
            .map(|strip| {
                let rows = strip * STRIP..windows.min((strip + 1) * STRIP);
                arch.dispatch(|| strip_sum(pair, rows.clone()))
            })
            .collect();
        let [sum, count] = parts.into_iter().fold([0.0; 2], |[s, n], [ps, pn]| [s + ps, n + pn]);
        if count == 0.0 {
            return Vec::new();
        }
        vec![Reading::new("SSIM", sum / count, Sense::HigherIsBetter)]
    }
}

/// The five moments of a window: E x, E r, E x², E r², E xr.
type Moments = [Vec<f64>; 5];

/// Sum of SSIM over the windows that begin in `rows` and whose centre counts, and their number.
#[inline(always)]
fn strip_sum(pair: &Pair, rows: std::ops::Range<usize>) -> [f64; 2] {
    let weights = gaussian();
    let values = pair.values();
    let (width, across) = (pair.width, pair.width - SIZE + 1);
    let lines = rows.len() + SIZE - 1;
    let mut total = [0.0; 2];
    let mut filtered: Moments = std::array::from_fn(|_| vec![0.0; lines * across]);
    let mut products: Moments = std::array::from_fn(|_| vec![0.0; width]);
    let mut column: Moments = std::array::from_fn(|_| vec![0.0; across]);
    for channel in 0..3 {
        // Moments along rows.
        for line in 0..lines {
            let start = (rows.start + line) * width;
            for x in 0..width {
                let a = f64::from(values.test[start + x][channel]) * values.unit;
                let b = f64::from(values.reference[start + x][channel]) * values.unit;
                for (product, value) in products.iter_mut().zip([a, b, a * a, b * b, a * b]) {
                    product[x] = value;
                }
            }
            for (product, target) in products.iter().zip(&mut filtered) {
                let target = &mut target[line * across..(line + 1) * across];
                target.fill(0.0);
                for (k, &weight) in weights.iter().enumerate() {
                    for (sum, value) in target.iter_mut().zip(&product[k..k + across]) {
                        *sum += weight * value;
                    }
                }
            }
        }
        // Along columns, then the index of each window.
        for row in rows.clone() {
            for (moment, target) in filtered.iter().zip(&mut column) {
                target.fill(0.0);
                for (k, &weight) in weights.iter().enumerate() {
                    let line = &moment[(row - rows.start + k) * across..][..across];
                    for (sum, value) in target.iter_mut().zip(line) {
                        *sum += weight * value;
                    }
                }
            }
            for x in 0..across {
                if pair.counts((row + SIZE / 2) * width + x + SIZE / 2) {
                    total[0] += index(std::array::from_fn(|m| column[m][x]));
                    total[1] += 1.0;
                }
            }
        }
    }
    total
}

/// Equation 13 of the paper, variances with the window's weights.
#[inline(always)]
fn index([a, b, aa, bb, ab]: [f64; 5]) -> f64 {
    let (variances, covariance) = (aa - a * a + bb - b * b, ab - a * b);
    (2.0 * a * b + C1) * (2.0 * covariance + C2) / ((a * a + b * b + C1) * (variances + C2))
}

fn gaussian() -> [f64; SIZE] {
    let bell: [f64; SIZE] = std::array::from_fn(|i| {
        let x = i as f64 - (SIZE / 2) as f64;
        libm::exp(-x * x / (2.0 * SIGMA * SIGMA))
    });
    let sum: f64 = bell.iter().sum();
    bell.map(|w| w / sum)
}
