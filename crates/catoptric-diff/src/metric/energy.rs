//! Energy: mean test over mean reference, in linear light. Noise leaves it at one, bias does not.
//!
//! `lum_ratio_trim` leaves out the pixels at and above the reference's 99th luminance percentile, where lights are.

use super::{Measure, Reading, Sense, Settings};
use crate::pair::{Pair, luminance};
use crate::sums::{percentile, sum};

pub(super) struct Energy;

impl Measure for Energy {
    fn measure(&self, pair: &Pair, _: &Settings) -> Vec<Reading> {
        let means = pair.mean(|i| {
            let (t, r) = (pair.test.at(i).map(f64::from), pair.reference.at(i).map(f64::from));
            [t[0], t[1], t[2], r[0], r[1], r[2], luminance(pair.test.at(i)), luminance(pair.reference.at(i))]
        });
        let plane: Vec<f32> = pair.reference.pixels().map(|p| luminance(p) as f32).collect();
        let bright = percentile(&mut pair.pool(plane), 99.0);
        let trimmed = sum(pair.test.len(), |i| {
            let r = luminance(pair.reference.at(i));
            if pair.counts(i) && f64::from(r as f32) < bright {
                [luminance(pair.test.at(i)), r]
            } else {
                [0.0; 2]
            }
        });
        let ratio = ratio(means[6], means[7]);
        let trimmed_ratio = if trimmed[1] != 0.0 { trimmed[0] / trimmed[1] } else { ratio };
        [
            ("energy_R", self::ratio(means[0], means[3])),
            ("energy_G", self::ratio(means[1], means[4])),
            ("energy_B", self::ratio(means[2], means[5])),
            ("lum_ratio", ratio),
            ("lum_ratio_trim", trimmed_ratio),
        ]
        .map(|(name, value)| Reading::new(name, value, Sense::NearOne))
        .into()
    }
}

/// Nothing against nothing is equal.
fn ratio(test: f64, reference: f64) -> f64 {
    if test == reference { 1.0 } else { test / reference }
}
