//! Pixels that are not light: NaN, infinities, fireflies.
//!
//! A firefly is a pixel brighter than 10 times the median of its neighbours plus a tenth of the reference's mean luminance,
//! where the same pixel of the reference is not one.

use rayon::prelude::*;

use super::{Measure, Reading, Sense, Settings};
use crate::pair::{Pair, luminance};
use crate::planes::Planes;

pub(super) struct Health;

impl Measure for Health {
    fn measure(&self, pair: &Pair, _: &Settings) -> Vec<Reading> {
        let floor = 0.1 * pair.mean_luminance();
        let fireflies = (0..pair.test.len())
            .into_par_iter()
            .filter(|&i| {
                pair.counts(i)
                    && sticks_out(pair, &pair.test, i, floor)
                    && !sticks_out(pair, &pair.reference, i, floor)
            })
            .count();
        let found = pair.non_finite;
        vec![
            Reading::new("nan", found.nan as f64, Sense::LowerIsBetter),
            Reading::new("inf", found.inf as f64, Sense::LowerIsBetter),
            Reading::new("nonfinite", found.new as f64, Sense::LowerIsBetter),
            Reading::new("ref_nonfinite", found.reference as f64, Sense::Information),
            Reading::new("fireflies", fireflies as f64, Sense::LowerIsBetter),
        ]
    }
}

fn sticks_out(pair: &Pair, planes: &Planes, i: usize, floor: f64) -> bool {
    let own = luminance(planes.at(i));
    if own <= floor {
        return false;
    }
    let (x, y) = (i % pair.width, i / pair.width);
    // It exceeds the median (of an even number the upper one) if it exceeds more than half of them.
    let (mut exceeded, mut n) = (0, 0);
    for ny in y.saturating_sub(1)..(y + 2).min(pair.height) {
        for nx in x.saturating_sub(1)..(x + 2).min(pair.width) {
            if (nx, ny) != (x, y) {
                n += 1;
                exceeded += usize::from(own > 10.0 * luminance(planes.at(ny * pair.width + nx)) + floor);
            }
        }
    }
    n > 0 && exceeded > n / 2
}
