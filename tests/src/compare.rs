//! How a noise-free picture is compared with the noisy one of the slow twin, layer by layer, in 8×8 blocks.
//!
//! A block's mean is a sum of independent terms x_k (one per path and pixel), each at most b. Their distribution is far
//! from normal where light is found by luck, so the test is not Gauss's but Bernstein's inequality (1924; Boucheron,
//! Lugosi & Massart 2013, th. 2.10): P(|Σ x − μ| > t) ≤ 2 exp(−t²/(2(V + b·t/3))), solved for t at the level of one
//! comparison. V is not known but estimated: by the block's own spread, or, where luck gave it no hits, by what the
//! spread of the whole layer says for the light that we claim (V ∝ μ for rare hits): the larger of the two.
//!
//! Our picture has no noise but is interpolated on a mesh: [`Allowance`].

use glam::DVec3;

use crate::twin::{LAYERS, Layer, Twin};

/// Pixels on a block's side.
pub const BLOCK: usize = 8;

/// What the discretisation of our own answer may cost. Deterministic: it does not grow with the twin's noise.
///
/// A gradient across an element of h pixels is interpolated to second order: the mean over a block of 8×8 pixels that
/// spans elements of the same size is off by h²·L''/12 ≈ 2 % of the block where L changes by a quarter over a block;
/// near contacts and shadow edges, one vertex's error of one unit spreads over an element: 0.2 % of the image mean.
#[derive(Clone, Copy, Debug)]
pub struct Allowance {
    /// Share of the block's value.
    pub relative: f64,
    /// Share of the mean of the whole picture (all layers).
    pub of_image: f64,
}

impl Default for Allowance {
    fn default() -> Self {
        Self { relative: 0.02, of_image: 0.002 }
    }
}

/// A comparison that failed.
#[derive(Clone, Debug)]
pub struct Mismatch {
    /// Name of the layer (or layers).
    pub layer: String,
    /// Column and row of the block; `None` for the whole picture.
    pub block: Option<(usize, usize)>,
    /// Channel.
    pub channel: usize,
    /// Our mean.
    pub ours: f64,
    /// The twin's.
    pub twin: f64,
    /// What was allowed.
    pub allowed: f64,
}

impl std::fmt::Display for Mismatch {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        let Mismatch { layer, block, channel, ours, twin, allowed } = self;
        let place = block.map_or("whole picture".to_owned(), |(x, y)| format!("block {x},{y}"));
        write!(f, "{layer}, {place}, channel {channel}: ours {ours:.6}, twin {twin:.6} ± {allowed:.6}")
    }
}

/// Comparisons of one picture of `width` × `height` with `layers` layers: blocks and the whole, three channels.
pub fn comparisons(width: usize, height: usize, layers: usize) -> usize {
    (width.div_ceil(BLOCK) * height.div_ceil(BLOCK) + 1) * layers * 3
}

/// Compares the sum of the layers `names` of `ours` (row-major pixels of that sum) with the twin's. `level` is the
/// probability of one false alarm per comparison: the family's, divided by the number of all comparisons (Bonferroni).
pub fn compare(
    ours: &[[f32; 3]],
    twin: &Twin,
    names: &[&str],
    level: f64,
    allowance: Allowance,
) -> Vec<Mismatch> {
    assert_eq!(ours.len(), twin.width * twin.height, "pictures of one size");
    let layers: Vec<&Layer> =
        names.iter().filter_map(|n| LAYERS.iter().position(|l| l == n)).map(|i| &twin.layers[i]).collect();
    assert_eq!(layers.len(), names.len(), "known layers: {LAYERS:?}");
    let image = mean(twin.layers.iter().flat_map(|l| &l.mean)) * LAYERS.len() as f64;
    let all = Spread::of(&layers, 0..ours.len());
    let brightest = twin.layers.iter().fold(DVec3::ZERO, |peak, layer| peak.max(layer.peak));
    let logarithm = -libm::log(0.5 * level);

    let mut blocks = vec![(None, (0..ours.len()).collect::<Vec<usize>>())];
    for y in 0..twin.height.div_ceil(BLOCK) {
        for x in 0..twin.width.div_ceil(BLOCK) {
            let rows = y * BLOCK..((y + 1) * BLOCK).min(twin.height);
            let columns = x * BLOCK..((x + 1) * BLOCK).min(twin.width);
            let pixels = rows.flat_map(|r| columns.clone().map(move |c| r * twin.width + c)).collect();
            blocks.push((Some((x, y)), pixels));
        }
    }
    let mut mismatches = Vec::new();
    for (block, pixels) in blocks {
        let sum = Spread::of(&layers, pixels.iter().copied());
        let count = pixels.len() as f64;
        for channel in 0..3 {
            let ours: f64 = pixels.iter().map(|&p| f64::from(ours[p][channel])).sum::<f64>() / count;
            // Fewer than ten hits in the whole layer do not show how large a hit can be: the brightest of any layer.
            let few = all.sum[channel] <= 10.0 * all.peak[channel];
            let b = if few { brightest[channel] } else { all.peak[channel] };
            // Variance per light, of the whole layer (terms of [0, b] have at most b): what our claim would show.
            let per_light = if few { b } else { all.variance[channel] / all.sum[channel] };
            let variance = sum.variance[channel].max(per_light * ours.max(0.0) * count);
            // t² = 2(V + b·t/3)·log: the positive root.
            let b = b * logarithm / 3.0;
            let noise = (b + (b * b + 2.0 * variance * logarithm).sqrt()) / count;
            let twin = sum.sum[channel] / count;
            let systematic =
                allowance.relative * twin.abs().max(ours.abs()) + allowance.of_image * image[channel];
            let allowed = noise + systematic;
            if (ours - twin).abs() > allowed || ours.is_nan() {
                mismatches.push(Mismatch { layer: names.join(" + "), block, channel, ours, twin, allowed });
            }
        }
    }
    mismatches
}

/// Sums over pixels and layers. Layers are summed as if independent: the same path seldom adds to two of them.
struct Spread {
    sum: DVec3,
    variance: DVec3,
    peak: DVec3,
}

impl Spread {
    fn of(layers: &[&Layer], pixels: impl Iterator<Item = usize> + Clone) -> Self {
        let mut spread = Self { sum: DVec3::ZERO, variance: DVec3::ZERO, peak: DVec3::ZERO };
        for layer in layers {
            spread.sum += pixels.clone().map(|p| layer.mean[p]).sum::<DVec3>();
            spread.variance += pixels.clone().map(|p| layer.variance[p]).sum::<DVec3>();
            spread.peak = spread.peak.max(layer.peak);
        }
        spread
    }
}

fn mean<'a>(values: impl Iterator<Item = &'a DVec3>) -> DVec3 {
    let (sum, count) = values.fold((DVec3::ZERO, 0.0), |(s, n), v| (s + *v, n + 1.0));
    sum / f64::max(count, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use catoptric_trace::sequence::{Key, Purpose};

    const SIDE: usize = 32;

    /// A twin of ten layers of mean 1, 2, … 10 whose light arrives in the share `luck` of `samples` paths.
    fn synthetic(luck: f32, samples: u32, seed: u64) -> Twin {
        let layers = (0..LAYERS.len()).map(|layer| {
            let key = Key::new(1, Purpose::Test, seed * 100 + layer as u64);
            let value = (layer + 1) as f64 / f64::from(luck);
            let n = f64::from(samples);
            let hits = |pixel: usize| {
                let key = key.child(pixel as u32);
                (0..samples).filter(|&s| key.uniform(s) < luck).count() as f64
            };
            let means: Vec<f64> = (0..SIDE * SIDE).map(|p| value * hits(p) / n).collect();
            let variance = |mean: f64| (mean * value - mean * mean) / (n - 1.0);
            Layer {
                mean: means.iter().map(|&m| DVec3::splat(m)).collect(),
                variance: means.iter().map(|&m| DVec3::splat(variance(m))).collect(),
                peak: DVec3::splat(value / n),
            }
        });
        Twin { width: SIDE, height: SIDE, layers: layers.collect() }
    }

    fn truth(layer: usize, factor: f32) -> Vec<[f32; 3]> {
        vec![[(layer + 1) as f32 * factor; 3]; SIDE * SIDE]
    }

    fn level() -> f64 {
        1e-3 / comparisons(SIDE, SIDE, LAYERS.len()) as f64
    }

    const EXACT: Allowance = Allowance { relative: 0.0, of_image: 0.0 };

    /// Forty pictures of ten layers at a family-wise level of 1e-3 each: a false alarm has a probability of 4 %.
    #[test]
    fn the_truth_is_never_called_wrong() {
        for luck in [0.5, 0.05, 0.003] {
            for seed in 0..40 {
                let twin = synthetic(luck, 16, seed);
                for (layer, name) in LAYERS.iter().enumerate() {
                    let mismatches = compare(&truth(layer, 1.0), &twin, &[name], level(), EXACT);
                    assert!(mismatches.is_empty(), "luck {luck}, seed {seed}: {}", mismatches[0]);
                }
            }
        }
    }

    /// The brighter layers also 15 % too dark or too bright: above the allowance (0.02 + 0.002 · 55/4 of layer 4) and
    /// the noise of the whole picture (2 % · 5).
    #[test]
    fn a_layer_dropped_doubled_or_changed_is_found() {
        let twin = synthetic(0.2, 32, 7);
        for (layer, name) in LAYERS.iter().enumerate() {
            let factors: &[f32] = if layer < 3 { &[0.0, 2.0] } else { &[0.0, 0.85, 1.15, 2.0] };
            for &factor in factors {
                let allowance = Allowance::default();
                let mismatches = compare(&truth(layer, factor), &twin, &[name], level(), allowance);
                assert!(!mismatches.is_empty(), "{name} × {factor} is not found");
            }
        }
    }

    /// The twin's own terms: one of them dropped or doubled, ours right.
    #[test]
    fn a_term_that_the_twin_lacks_or_doubles_is_found() {
        for (layer, name) in LAYERS.iter().enumerate() {
            for factor in [0.0, 2.0] {
                let mut twin = synthetic(0.2, 32, 8);
                for mean in &mut twin.layers[layer].mean {
                    *mean *= factor;
                }
                for variance in &mut twin.layers[layer].variance {
                    *variance *= factor * factor;
                }
                twin.layers[layer].peak *= factor;
                let mismatches = compare(&truth(layer, 1.0), &twin, &[name], level(), Allowance::default());
                assert!(!mismatches.is_empty(), "{name} × {factor} is not found");
            }
        }
    }

    /// Light in one corner only, of a layer that is dark elsewhere.
    #[test]
    fn a_local_error_is_found_in_its_block() {
        let twin = synthetic(0.5, 32, 9);
        let mut ours = truth(4, 1.0);
        for y in 8..16 {
            for x in 16..24 {
                ours[y * SIDE + x] = [6.0; 3];
            }
        }
        let mismatches = compare(&ours, &twin, &["indirect"], level(), EXACT);
        assert!(
            mismatches.iter().all(|m| m.block == Some((2, 1))) && mismatches.len() == 3,
            "{mismatches:?}"
        );
    }

    #[test]
    fn a_picture_with_nan_is_never_right() {
        let twin = synthetic(0.5, 32, 10);
        let mut ours = truth(0, 1.0);
        ours[17] = [f32::NAN; 3];
        assert!(!compare(&ours, &twin, &["emission"], level(), Allowance::default()).is_empty());
    }
}
