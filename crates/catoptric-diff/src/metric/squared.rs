//! Mean squared error, its root, and mean absolute error over pixels and channels.

use super::{Measure, Reading, Sense, Settings};
use crate::pair::Pair;

pub(super) struct Squared;

impl Measure for Squared {
    fn measure(&self, pair: &Pair, _: &Settings) -> Vec<Reading> {
        let values = pair.values();
        let [squared, absolute] = pair.mean(|i| {
            let (x, r) = (values.test.at(i), values.reference.at(i));
            let d = [0, 1, 2].map(|k: usize| (f64::from(x[k]) - f64::from(r[k])) * values.unit);
            [d.iter().map(|d| d * d).sum::<f64>() / 3.0, d.iter().map(|d| d.abs()).sum::<f64>() / 3.0]
        });
        [("MSE", squared), ("RMSE", squared.sqrt()), ("MAE", absolute)]
            .map(|(name, value)| Reading::new(name, value, Sense::LowerIsBetter))
            .into()
    }
}
