//! Mean FLIP: of the kind that fits the pair, and LDR-FLIP of the displayed images.

use super::{Measure, Reading, Sense, Settings};
use crate::pair::Pair;

pub(super) struct Flip;

impl Measure for Flip {
    fn measure(&self, pair: &Pair, _: &Settings) -> Vec<Reading> {
        let mean = |map: &[f32]| pair.mean(|i| [f64::from(map[i])])[0];
        let flip = mean(pair.flip_map());
        let displayed = if pair.coded { flip } else { mean(&pair.displayed_flip_map()) };
        vec![
            Reading::new("FLIP", flip, Sense::LowerIsBetter),
            Reading::new("FLIP_LDR", displayed, Sense::LowerIsBetter),
        ]
    }
}
