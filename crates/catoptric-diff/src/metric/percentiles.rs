//! Percentiles and maxima over pixels of the absolute, relative and FLIP error.

use super::{Measure, Reading, Sense, Settings};
use crate::pair::Pair;
use crate::sums::percentile;

pub(super) struct Percentiles;

impl Measure for Percentiles {
    fn measure(&self, pair: &Pair, settings: &Settings) -> Vec<Reading> {
        let mut readings = Vec::new();
        // One map at a time: it is reordered, and gone before the next.
        for kind in ["abs", "rel", "flip"] {
            let map = match kind {
                "abs" => pair.absolute_map(),
                "rel" => pair.relative_map(),
                _ => pair.flip_map().to_vec(),
            };
            let (value, at) = pair.largest(|i| map[i]);
            let mut pooled = pair.pool(map);
            for &q in &settings.percentiles {
                let name = format!("p{q}_{kind}");
                readings.push(Reading::new(&name, percentile(&mut pooled, q), Sense::LowerIsBetter));
            }
            let maximum = Reading::new(&format!("max_{kind}"), value, Sense::LowerIsBetter);
            readings.push(Reading { at: Some(at), ..maximum });
        }
        readings
    }
}
