//! Choice of one of many by weight, by inversion of the cumulative distribution.

/// Cumulative weights, the last one 1.
#[derive(Clone, Debug, Default)]
pub(super) struct Table {
    cumulative: Vec<f32>,
    /// Σ of the weights.
    pub(super) total: f64,
}

impl Table {
    /// The table of some weights ≥ 0.
    pub(super) fn new(weights: impl Iterator<Item = f32> + Clone) -> Self {
        let total: f64 = weights.clone().map(f64::from).sum();
        let mut sum = 0.0;
        let mut cumulative: Vec<f32> = weights
            .map(|w| {
                sum += f64::from(w);
                (sum / total) as f32
            })
            .collect();
        // Rounding must not leave a gap at the end: the last one of any weight takes it.
        let end = cumulative.last().copied().unwrap_or(1.0);
        for value in cumulative.iter_mut().rev().take_while(|v| **v == end) {
            *value = 1.0;
        }
        Self { cumulative, total }
    }

    /// The exact probability of a choice.
    #[inline]
    pub(super) fn share(&self, index: usize) -> f32 {
        self.cumulative[index] - if index == 0 { 0.0 } else { self.cumulative[index - 1] }
    }

    /// The choice for `u` ∈ [0, 1), its exact probability, and what is left of `u`, again in [0, 1).
    #[inline]
    pub(super) fn pick(&self, u: f32) -> (usize, f32, f32) {
        let index = self.cumulative.partition_point(|&c| c <= u).min(self.cumulative.len() - 1);
        let low = if index == 0 { 0.0 } else { self.cumulative[index - 1] };
        let probability = self.cumulative[index] - low;
        let left = ((u - low) / probability).clamp(0.0, 0.999_999_94);
        (index, probability, left)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn choices_follow_their_weights_and_nothing_is_chosen_without() {
        let weights = [0.0_f32, 1.0, 0.0, 3.0, 0.0];
        let table = Table::new(weights.iter().copied());
        let n = 1 << 12;
        let mut counts = [0; 5];
        for i in 0..n {
            let (index, probability, left) = table.pick((i as f32 + 0.5) / n as f32);
            counts[index] += 1;
            assert_eq!(probability, weights[index] / 4.0);
            assert!((0.0..1.0).contains(&left));
        }
        assert_eq!(counts, [0, n / 4, 0, 3 * n / 4, 0]);
        assert_eq!(table.total, 4.0);
    }
}
