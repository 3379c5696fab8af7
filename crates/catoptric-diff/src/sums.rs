//! Sums that do not depend on the number of threads: fixed chunks in parallel, their results in order.

use rayon::prelude::*;

const CHUNK: usize = 1 << 14;

/// Σ of `term` over 0..n, K sums at once, in double precision.
pub(crate) fn sum<const K: usize>(n: usize, term: impl Fn(usize) -> [f64; K] + Sync) -> [f64; K] {
    let add = |mut total: [f64; K], part: [f64; K]| {
        for k in 0..K {
            total[k] += part[k];
        }
        total
    };
    let parts: Vec<[f64; K]> = (0..n.div_ceil(CHUNK))
        .into_par_iter()
        .map(|chunk| {
            (chunk * CHUNK..n.min((chunk + 1) * CHUNK)).fold([0.0; K], |total, i| add(total, term(i)))
        })
        .collect();
    parts.into_iter().fold([0.0; K], add)
}

/// The q-th percentile (0 to 100) of unordered values, linear between order statistics; reorders them. NaN when empty.
pub(crate) fn percentile(values: &mut [f32], q: f64) -> f64 {
    if values.is_empty() {
        return f64::NAN;
    }
    let rank = (q / 100.0).clamp(0.0, 1.0) * (values.len() - 1) as f64;
    let below = rank as usize;
    let (_, &mut low, rest) = values.select_nth_unstable_by(below, f32::total_cmp);
    let high = rest.iter().copied().min_by(f32::total_cmp).unwrap_or(low);
    f64::from(low) + (rank - below as f64) * (f64::from(high) - f64::from(low))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_are_the_same_bits_for_any_number_of_threads() {
        let value = |i: usize| [libm::sqrt(i as f64), 1.0 / (1 + i) as f64];
        let with = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            pool.install(|| sum(100_000, value)).map(f64::to_bits)
        };
        assert_eq!(with(1), with(2));
        assert_eq!(with(1), with(7));
    }

    #[test]
    fn percentiles_interpolate() {
        let mut values = [4.0, 1.0, 3.0, 2.0];
        assert_eq!(percentile(&mut values, 50.0), 2.5);
        assert_eq!(percentile(&mut values, 0.0), 1.0);
        assert_eq!(percentile(&mut values, 100.0), 4.0);
        assert!((percentile(&mut values, 95.0) - 3.85).abs() < 1e-12);
    }
}
