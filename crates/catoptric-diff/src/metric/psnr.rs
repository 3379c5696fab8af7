//! Peak signal-to-noise ratio in decibels, peak 1: of the compared values, and (`PSNR_srgb`) of the 8-bit sRGB images at
//! the exposure that suits the reference.

use super::{Measure, Reading, Sense, Settings};
use crate::pair::Pair;

pub(super) struct Psnr;

impl Measure for Psnr {
    fn measure(&self, pair: &Pair, _: &Settings) -> Vec<Reading> {
        let values = pair.values();
        let [mse] = pair.mean(|i| {
            let d2 = |k: usize| {
                let d = (f64::from(values.test[i][k]) - f64::from(values.reference[i][k])) * values.unit;
                d * d
            };
            [(d2(0) + d2(1) + d2(2)) / 3.0]
        });
        let [test, reference] = pair.display();
        let [displayed] = pair.mean(|i| {
            let d2 = |k: usize| {
                let d = (f64::from(test[i][k]) - f64::from(reference[i][k])) / 255.0;
                d * d
            };
            [(d2(0) + d2(1) + d2(2)) / 3.0]
        });
        [("PSNR", mse), ("PSNR_srgb", displayed)]
            .map(|(name, mse)| Reading::new(name, -10.0 * libm::log10(mse), Sense::HigherIsBetter))
            .into()
    }
}
