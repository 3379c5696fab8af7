//! Means and standard errors over independent scrambles of one low-discrepancy sequence (Owen 1997): the points of one
//! scramble are not independent of each other, the scrambles are.

use glam::DVec3;

/// Independent scrambles per row.
pub(crate) const SCRAMBLES: u32 = 16;

/// Sums over scrambles of dense rows.
pub(crate) struct Scrambles {
    current: Vec<DVec3>,
    sum: Vec<DVec3>,
    squares: Vec<DVec3>,
    done: f64,
}

impl Scrambles {
    pub(crate) fn new(elements: usize) -> Self {
        let zero = vec![DVec3::ZERO; elements];
        Self { current: zero.clone(), sum: zero.clone(), squares: zero, done: 0.0 }
    }

    /// Adds to the estimate of the current scramble.
    #[inline]
    pub(crate) fn add(&mut self, element: u32, value: DVec3) {
        self.current[element as usize] += value;
    }

    /// Ends a scramble.
    pub(crate) fn next(&mut self) {
        self.done += 1.0;
        for ((current, sum), squares) in self.current.iter_mut().zip(&mut self.sum).zip(&mut self.squares) {
            *sum += *current;
            *squares += *current * *current;
            *current = DVec3::ZERO;
        }
    }

    /// Mean and standard error (largest channel) of each element.
    pub(crate) fn finish(self) -> (Vec<DVec3>, Vec<f64>) {
        let n = self.done;
        let means: Vec<DVec3> = self.sum.iter().map(|s| *s / n).collect();
        let errors = means
            .iter()
            .zip(&self.squares)
            .map(|(mean, squares)| {
                let variance = (*squares / n - *mean * *mean).max(DVec3::ZERO);
                (variance.max_element() / (n - 1.0)).sqrt()
            })
            .collect();
        (means, errors)
    }
}
