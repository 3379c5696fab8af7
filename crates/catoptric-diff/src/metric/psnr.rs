//! Peak signal-to-noise ratio in decibels, peak 1: of the compared values, and (`PSNR_srgb`) of the 8-bit sRGB images at
//! the exposure that suits the reference.

use catoptric_image::srgb;

use super::{Measure, Reading, Sense, Settings};
use crate::pair::Pair;

pub(super) struct Psnr;

impl Measure for Psnr {
    fn measure(&self, pair: &Pair, _: &Settings) -> Vec<Reading> {
        let values = pair.values();
        let [mse] = pair.mean(|i| {
            let (x, r) = (values.test.at(i), values.reference.at(i));
            let d2 = |k: usize| {
                let d = (f64::from(x[k]) - f64::from(r[k])) * values.unit;
                d * d
            };
            [(d2(0) + d2(1) + d2(2)) / 3.0]
        });
        let gain = pair.display_gain();
        let [displayed] = pair.mean(|i| {
            let (x, r) = (pair.test.at(i), pair.reference.at(i));
            let d2 = |k: usize| {
                let d = (f64::from(srgb::byte(x[k] * gain)) - f64::from(srgb::byte(r[k] * gain))) / 255.0;
                d * d
            };
            [(d2(0) + d2(1) + d2(2)) / 3.0]
        });
        [("PSNR", mse), ("PSNR_srgb", displayed)]
            .map(|(name, mse)| Reading::new(name, -10.0 * libm::log10(mse), Sense::HigherIsBetter))
            .into()
    }
}
