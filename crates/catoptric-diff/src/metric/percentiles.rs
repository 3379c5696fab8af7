//! Percentiles and maxima over pixels of the absolute, relative and FLIP error.

use super::{Measure, Reading, Sense, Settings};
use crate::pair::Pair;
use crate::sums::percentile;

pub(super) struct Percentiles;

impl Measure for Percentiles {
    fn measure(&self, pair: &Pair, settings: &Settings) -> Vec<Reading> {
        let maps = [("abs", pair.absolute_map()), ("rel", pair.relative_map()), ("flip", pair.flip_map())];
        let mut readings = Vec::new();
        for (kind, map) in maps {
            let mut pooled = pair.pool(map);
            for &q in &settings.percentiles {
                let name = format!("p{q}_{kind}");
                readings.push(Reading::new(&name, percentile(&mut pooled, q), Sense::LowerIsBetter));
            }
            let (value, at) = pair.largest(map);
            let maximum = Reading::new(&format!("max_{kind}"), value, Sense::LowerIsBetter);
            readings.push(Reading { at: Some(at), ..maximum });
        }
        readings
    }
}
