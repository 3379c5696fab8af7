//! Errors relative to the reference.
//!
//! relMSE = mean (x − r)²/(r² + 0.01) over pixels and channels (Rousselle, Knaus & Zwicker 2011, ε = 0.01);
//! relMSE_n replaces 0.01 by 0.01 m², m the mean of the reference, and does not depend on the light's scale;
//! MRSE = mean over pixels of |x − r|²/(|r|² + 1e-4 mean |r|²), RGB norms.

use super::{Measure, Reading, Sense, Settings};
use crate::pair::Pair;
use crate::planes::Planes;

pub(super) const EPSILON: f64 = 0.01;

pub(super) struct Relative;

impl Measure for Relative {
    fn measure(&self, pair: &Pair, _: &Settings) -> Vec<Reading> {
        let values = pair.values();
        let at = |planes: &Planes, i: usize| planes.at(i).map(|v| f64::from(v) * values.unit);
        let [mean, square] = pair.mean(|i| {
            let r = at(values.reference, i);
            [r.iter().sum::<f64>() / 3.0, r.iter().map(|r| r * r).sum()]
        });
        let [relative, normalised, pixelwise] = pair.mean(|i| {
            let (x, r) = (at(values.test, i), at(values.reference, i));
            let mut sums = [0.0; 3];
            let (mut error, mut norm) = (0.0, 0.0);
            for k in 0..3 {
                let d2 = (x[k] - r[k]) * (x[k] - r[k]);
                sums[0] += d2 / (r[k] * r[k] + EPSILON) / 3.0;
                sums[1] += ratio(d2, r[k] * r[k] + EPSILON * mean * mean) / 3.0;
                error += d2;
                norm += r[k] * r[k];
            }
            sums[2] = ratio(error, norm + 1e-4 * square);
            sums
        });
        [("relMSE", relative), ("relMSE_n", normalised), ("MRSE", pixelwise)]
            .map(|(name, value)| Reading::new(name, value, Sense::LowerIsBetter))
            .into()
    }
}

/// Equal pixels of a black reference are equal.
fn ratio(error: f64, scale: f64) -> f64 {
    if error == 0.0 { 0.0 } else { error / scale }
}
