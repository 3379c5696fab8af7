//! What the reference's own noise explains, given its standard error per pixel and channel.
//!
//! `relMSE_nc` is relMSE minus its expectation for an exact image, an unbiased estimate of our error; `relMSE_b8` the same
//! of 8×8 block means with the scale-free denominator of relMSE_n. `z_rms` and `z_max` are of the block means.
//!
//! The verdict tests "test = truth": every z² = ((x − r)/se)² is χ² with one degree of freedom. Two tests share the level:
//! the largest z² over all samples with Šidák's correction, and Σ z² over each channel against χ² with as many degrees of
//! freedom (Wilson & Hilferty 1931). Channels are tested apart because their noise is correlated. A standard error below
//! 1e-4 of the mean is raised to it: directly seen lights have none, and float rounding would be significant.

use serde::Serialize;

use super::relative::EPSILON;
use super::{Measure, Reading, Sense, Settings};
use crate::pair::{Pair, Rgb, StandardError};
use crate::planes::Planes;
use crate::sums::sum;

const BLOCK: usize = 8;
/// Probability of a false alarm of the whole verdict.
const LEVEL: f64 = 0.01;

pub(super) struct Noise;

impl Measure for Noise {
    fn measure(&self, pair: &Pair, _: &Settings) -> Vec<Reading> {
        let Some(noise) = &pair.noise else {
            return Vec::new();
        };
        let noise = |i: usize| standard_error(pair, noise, i);
        let mut readings = per_pixel(pair, noise);
        readings.extend(per_block(pair, noise));
        if let Some(verdict) = verdict(pair) {
            readings.push(Reading::new("chi2_dof", verdict.chi2_per_degree, Sense::LowerIsBetter));
            let excess = Reading::new("noise_excess", verdict.excess_pixels as f64, Sense::LowerIsBetter);
            readings.push(Reading { at: Some(verdict.worst_pixel), ..excess });
        }
        readings
    }
}

/// The standard error of one pixel of the reference.
fn standard_error(pair: &Pair, noise: &StandardError, i: usize) -> Rgb {
    match noise {
        StandardError::Planes(planes) => planes.at(i),
        StandardError::Relative(relative) => pair.reference.at(i).map(|v| v.abs() * relative),
    }
}

fn per_pixel(pair: &Pair, noise: impl Fn(usize) -> Rgb + Sync) -> Vec<Reading> {
    let [relative, floor] = pair.mean(|i| {
        let mut sums = [0.0; 2];
        let (x, r, se) = (pair.test.at(i), pair.reference.at(i), noise(i));
        for k in 0..3 {
            let (x, r, se) = (f64::from(x[k]), f64::from(r[k]), f64::from(se[k]));
            let scale = 3.0 * (r * r + EPSILON);
            sums[0] += (x - r) * (x - r) / scale;
            sums[1] += se * se / scale;
        }
        sums
    });
    vec![
        Reading::new("relMSE_nc", relative - floor, Sense::LowerIsBetter),
        Reading::new("relMSE_floor", floor, Sense::Information),
    ]
}

/// Sums over the complete 8×8 blocks whose pixels all count.
fn per_block(pair: &Pair, noise: impl Fn(usize) -> Rgb + Sync) -> Vec<Reading> {
    let mean = mean_of_reference(pair);
    let (columns, rows) = (pair.width / BLOCK, pair.height / BLOCK);
    // Per block: count, error and noise of relMSE_b8, then Σ z², their number and the largest |z|.
    let block = |b: usize| {
        let mut out = [0.0; 6];
        let (left, top) = (b % columns * BLOCK, b / columns * BLOCK);
        let pixels = (0..BLOCK * BLOCK).map(|p| (top + p / BLOCK) * pair.width + left + p % BLOCK);
        if !pixels.clone().all(|i| pair.counts(i)) {
            return out;
        }
        out[0] = 1.0;
        let n = (BLOCK * BLOCK) as f64;
        for k in 0..3 {
            let average =
                |planes: &Planes| pixels.clone().map(|i| f64::from(planes.channels()[k][i])).sum::<f64>() / n;
            let (x, r) = (average(&pair.test), average(&pair.reference));
            let variance = pixels.clone().map(|i| f64::from(noise(i)[k]).powi(2)).sum::<f64>() / (n * n);
            let scale = 3.0 * (r * r + EPSILON * mean * mean);
            if scale > 0.0 {
                out[1] += ((x - r) * (x - r) - variance) / scale;
                out[2] += variance / scale;
            }
            if variance.sqrt() > 1e-4 * mean {
                let z2 = (x - r) * (x - r) / variance;
                out[3] += z2;
                out[4] += 1.0;
                out[5] = f64::max(out[5], z2);
            }
        }
        out
    };
    let blocks = columns * rows;
    let [count, error, floor, z2, tested, _] = sum(blocks, block);
    if count == 0.0 {
        return Vec::new();
    }
    let largest = (0..blocks).map(|b| block(b)[5]).fold(0.0, f64::max);
    let mut readings = vec![
        Reading::new("relMSE_b8", error / count, Sense::LowerIsBetter),
        Reading::new("relMSE_b8_floor", floor / count, Sense::Information),
    ];
    if tested > 0.0 {
        readings.push(Reading::new("z_rms", (z2 / tested).sqrt(), Sense::LowerIsBetter));
        readings.push(Reading::new("z_max", largest.sqrt(), Sense::LowerIsBetter));
    }
    readings
}

/// Whether the difference is what the reference's noise alone would give.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct NoiseVerdict {
    /// The difference is explained by the noise at a level of 1 %.
    pub explained: bool,
    /// Pixels with a |z| that no pixel of an exact image would have, at half the level.
    pub excess_pixels: usize,
    /// The |z| above which a pixel is in excess.
    pub bound: f64,
    /// The largest |z|.
    pub worst_z: f64,
    /// Where it is.
    pub worst_pixel: [usize; 2],
    /// Σ z²/n of the worst channel; 1 is expected.
    pub chi2_per_degree: f64,
    /// Probability of a sum as large in the worst of three channels.
    pub probability: f64,
}

pub(super) fn verdict(pair: &Pair) -> Option<NoiseVerdict> {
    let noise = pair.noise.as_ref()?;
    let least = 1e-4 * mean_of_reference(pair);
    let z = |i: usize, k: usize| {
        let se = f64::from(standard_error(pair, noise, i)[k]).max(least).max(f64::MIN_POSITIVE);
        (f64::from(pair.test.at(i)[k]) - f64::from(pair.reference.at(i)[k])) / se
    };
    let n = pair.count();
    if n == 0 {
        return None;
    }
    // Largest |z|: Šidák's bound over 3n samples at half the level.
    let single = -libm::expm1(libm::log1p(-LEVEL / 2.0) / (3 * n) as f64);
    let bound = two_sided_bound(single);
    let largest = |i: usize| (0..3).map(|k| z(i, k).abs()).fold(0.0, f64::max) as f32;
    let [excess] =
        sum(pair.test.len(), |i| [f64::from(u8::from(pair.counts(i) && f64::from(largest(i)) > bound))]);
    let excess_pixels = excess as usize;
    let (worst_z, worst_pixel) = pair.largest(largest);
    // Σ z² per channel: Bonferroni over three channels at the other half.
    let chi2 = pair.mean(|i| [z(i, 0).powi(2), z(i, 1).powi(2), z(i, 2).powi(2)]);
    let chi2_per_degree = chi2.into_iter().fold(0.0, f64::max);
    let probability = (3.0 * chi2_upper_tail(chi2_per_degree, n as f64)).min(1.0);
    let explained = excess_pixels == 0 && probability >= LEVEL / 2.0;
    Some(NoiseVerdict { explained, excess_pixels, bound, worst_z, worst_pixel, chi2_per_degree, probability })
}

/// Mean over pixels and channels.
fn mean_of_reference(pair: &Pair) -> f64 {
    pair.mean(|i| [pair.reference.at(i).iter().map(|&v| f64::from(v)).sum::<f64>() / 3.0])[0]
}

/// The z whose two-sided tail of the normal distribution is `probability`.
fn two_sided_bound(probability: f64) -> f64 {
    let (mut low, mut high) = (0.0, 38.0);
    for _ in 0..80 {
        let middle = 0.5 * (low + high);
        if libm::erfc(middle / std::f64::consts::SQRT_2) > probability {
            low = middle;
        } else {
            high = middle;
        }
    }
    high
}

/// P(χ²/n > ratio) for n degrees of freedom, by Wilson & Hilferty's cube root.
fn chi2_upper_tail(ratio: f64, n: f64) -> f64 {
    let spread = 2.0 / (9.0 * n);
    let z = (libm::cbrt(ratio) - (1.0 - spread)) / spread.sqrt();
    0.5 * libm::erfc(z / std::f64::consts::SQRT_2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounds_and_tails_are_those_of_the_tables() {
        assert!((two_sided_bound(0.05) - 1.959_964).abs() < 1e-5);
        assert!((two_sided_bound(1e-9) - 6.109_41).abs() < 1e-4);
        // χ² with 100 degrees of freedom: 5 % above 124.342.
        assert!((chi2_upper_tail(1.243_42, 100.0) - 0.05).abs() < 2e-4);
    }
}
