//! The metrics. Each is a file with one `Measure`; adding one is a file, a `mod` line and an entry of [`Metric`]: the
//! battery of `tests/metrics.rs`, the command line, the JSON and the report find it there.

mod energy;
pub mod flip;
mod flip_metric;
mod health;
mod noise;
mod percentiles;
mod psnr;
mod relative;
mod squared;
mod ssim;

pub use noise::NoiseVerdict;
use serde::Serialize;

use crate::pair::Pair;

/// Which way a number is good.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Sense {
    /// Zero is equal.
    LowerIsBetter,
    /// More is more alike.
    HigherIsBetter,
    /// A ratio: one is equal.
    NearOne,
    /// It says something about the reference or the pair, not about how good the test image is.
    Information,
}

/// One number about a pair.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Reading {
    /// Its name: what `--max` takes.
    pub name: String,
    /// The number; infinite for the PSNR of equal images.
    pub value: f64,
    /// Which way it is good.
    pub sense: Sense,
    /// The pixel it was found at, for extremes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub at: Option<[usize; 2]>,
}

impl Reading {
    fn new(name: &str, value: f64, sense: Sense) -> Reading {
        Reading { name: name.to_owned(), value, sense, at: None }
    }

    /// How far the value is from a perfect score, for readings of the two senses that have a distance.
    pub fn distance(&self) -> f64 {
        match self.sense {
            Sense::NearOne => (self.value - 1.0).abs(),
            _ => self.value,
        }
    }
}

/// What a metric is told.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Percentiles to report of the error maps.
    pub percentiles: Vec<f64>,
}

impl Default for Settings {
    fn default() -> Self {
        Settings { percentiles: vec![50.0, 95.0, 99.0] }
    }
}

/// Something that can be measured of a pair.
trait Measure {
    fn measure(&self, pair: &Pair, settings: &Settings) -> Vec<Reading>;
}

/// All metrics, in the order of the tables.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Metric {
    /// MSE, RMSE, MAE.
    Squared,
    /// relMSE, relMSE_n, MRSE.
    Relative,
    /// PSNR, and PSNR of the displayed images.
    Psnr,
    /// SSIM.
    Ssim,
    /// FLIP and LDR-FLIP.
    Flip,
    /// Energy per channel and luminance, as ratios.
    Energy,
    /// Percentiles and maxima of absolute, relative and FLIP errors.
    Percentiles,
    /// What the reference's noise explains.
    Noise,
    /// NaN, infinities, fireflies.
    Health,
}

impl Metric {
    /// Every metric.
    pub const ALL: [Metric; 9] = [
        Metric::Squared,
        Metric::Relative,
        Metric::Psnr,
        Metric::Ssim,
        Metric::Flip,
        Metric::Energy,
        Metric::Percentiles,
        Metric::Noise,
        Metric::Health,
    ];

    /// The name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Metric::Squared => "squared",
            Metric::Relative => "relative",
            Metric::Psnr => "psnr",
            Metric::Ssim => "ssim",
            Metric::Flip => "flip",
            Metric::Energy => "energy",
            Metric::Percentiles => "percentiles",
            Metric::Noise => "noise",
            Metric::Health => "health",
        }
    }

    /// The numbers of this metric for a pair.
    pub fn measure(self, pair: &Pair, settings: &Settings) -> Vec<Reading> {
        let measure: &dyn Measure = match self {
            Metric::Squared => &squared::Squared,
            Metric::Relative => &relative::Relative,
            Metric::Psnr => &psnr::Psnr,
            Metric::Ssim => &ssim::Ssim,
            Metric::Flip => &flip_metric::Flip,
            Metric::Energy => &energy::Energy,
            Metric::Percentiles => &percentiles::Percentiles,
            Metric::Noise => &noise::Noise,
            Metric::Health => &health::Health,
        };
        measure.measure(pair, settings)
    }
}

/// Whether the reference's noise explains the difference; `None` without a standard error.
pub fn noise_verdict(pair: &Pair) -> Option<NoiseVerdict> {
    noise::verdict(pair)
}
