//! Limits: which numbers are good enough.

use std::collections::BTreeMap;
use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::metric::Sense;
use crate::{Comparison, DiffError, LayerComparison};

/// Bounds by name. A name is a metric's (`relMSE`, `p99_rel`), of the beauty, or `layer:metric`.
///
/// `max` bounds errors from above, and how far ratios (`lum_ratio`, `energy_R`) are from one; `min` bounds similarities
/// (`SSIM`, `PSNR`) from below. In a file: `{"max": {"relMSE": 1e-3}, "min": {"SSIM": 0.98}}`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Limits {
    /// Upper bounds.
    pub max: BTreeMap<String, f64>,
    /// Lower bounds.
    pub min: BTreeMap<String, f64>,
    /// The reference's noise must explain the difference.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub explained_by_noise: bool,
}

/// One limit against one number.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Check {
    /// The layer; empty for the beauty.
    pub layer: String,
    /// The metric.
    pub metric: String,
    /// What was measured.
    pub value: f64,
    /// The limit in words: `≤ 0.001`, `1 ± 0.003`, `≥ 0.98`.
    pub limit: String,
    /// Whether it holds.
    pub holds: bool,
}

impl Limits {
    /// Reads a limits file.
    pub fn read(path: &Path) -> Result<Limits, DiffError> {
        let text = std::fs::read_to_string(path).map_err(|error| DiffError::io(path, error))?;
        let wrong = |error: serde_json::Error| DiffError::Json {
            path: path.to_path_buf(),
            reason: error.to_string(),
        };
        serde_json::from_str(&text).map_err(wrong)
    }

    /// Whether nothing is limited.
    pub fn is_empty(&self) -> bool {
        self.max.is_empty() && self.min.is_empty() && !self.explained_by_noise
    }

    /// These limits, replaced by those of `other` where both speak of the same.
    pub fn overridden_by(mut self, other: &Limits) -> Limits {
        self.max.extend(other.max.clone());
        self.min.extend(other.min.clone());
        self.explained_by_noise |= other.explained_by_noise;
        self
    }

    /// Percentiles that the names ask for.
    pub fn percentiles(&self) -> Vec<f64> {
        let names = self.max.keys().chain(self.min.keys());
        names.filter_map(|name| percentile_of(split(name).1)).collect()
    }

    /// What of `self` would be looser under `new`, in words.
    pub fn loosened_by(&self, new: &Limits) -> Vec<String> {
        let mut looser = Vec::new();
        for (name, &old) in &self.max {
            match new.max.get(name) {
                None => looser.push(format!("max {name} {old} would be dropped")),
                Some(&value) if value > old || value.is_nan() => {
                    looser.push(format!("max {name} {old} would become {value}"));
                }
                Some(_) => {}
            }
        }
        for (name, &old) in &self.min {
            match new.min.get(name) {
                None => looser.push(format!("min {name} {old} would be dropped")),
                Some(&value) if value < old || value.is_nan() => {
                    looser.push(format!("min {name} {old} would become {value}"));
                }
                Some(_) => {}
            }
        }
        if self.explained_by_noise && !new.explained_by_noise {
            looser.push("explained_by_noise would be dropped".to_owned());
        }
        looser
    }

    /// Checks a comparison. Without limits all that both images hold must be equal. Pixels that are not finite where the reference's are
    /// always break a limit, unless `nonfinite` has one of its own.
    pub fn check(&self, comparison: &Comparison) -> Result<Vec<Check>, DiffError> {
        let mut checks = Vec::new();
        for layer in &comparison.layers {
            if layer.pair.non_finite.reference == layer.pair.width * layer.pair.height {
                let title = layer.title();
                return Err(DiffError::Limit(format!(
                    "{title}: the reference has no finite pixel to compare with"
                )));
            }
            let own = |name: &str, value: f64, allowed: f64| Check {
                layer: layer.layer.clone(),
                metric: name.to_owned(),
                value,
                limit: format!("≤ {allowed}"),
                holds: value <= allowed,
            };
            if self.is_empty() {
                let (largest, _) = layer.pair.largest(|i| layer.pair.absolute_error(i));
                checks.push(own("max_abs", largest, 0.0));
                if layer.pair.non_finite.gone > 0 {
                    checks.push(own("nonfinite_gone", layer.pair.non_finite.gone as f64, 0.0));
                }
            }
            if !self.max.contains_key(&qualified(&layer.layer, "nonfinite")) {
                checks.push(own("nonfinite", layer.pair.non_finite.new as f64, 0.0));
            }
        }
        if self.is_empty() {
            let differing = comparison.other_channels.iter().filter(|(_, pixels)| *pixels > 0);
            checks.extend(differing.map(|(name, pixels)| Check {
                layer: name.clone(),
                metric: "differing_pixels".to_owned(),
                value: *pixels as f64,
                limit: "≤ 0".to_owned(),
                holds: false,
            }));
        }
        for (name, &limit) in &self.max {
            checks.push(upper(comparison, name, limit)?);
        }
        for (name, &limit) in &self.min {
            let (layer, metric, reading) = find(comparison, name)?;
            let (value, limit_text) = (reading.value, format!("≥ {limit}"));
            checks.push(Check { layer, metric, value, limit: limit_text, holds: value >= limit });
        }
        if self.explained_by_noise {
            let layer = beauty(comparison)?;
            let verdict = layer.noise.ok_or_else(|| {
                DiffError::Limit("explained_by_noise needs the reference's standard error: a layer SE, or relative_standard_error in its birth certificate".into())
            })?;
            checks.push(Check {
                layer: layer.layer.clone(),
                metric: "explained_by_noise".into(),
                value: verdict.chi2_per_degree,
                limit: "explained".into(),
                holds: verdict.explained,
            });
        }
        Ok(checks)
    }
}

/// Parses `METRIC=VALUE`.
pub fn parse_limit(text: &str) -> Result<(String, f64), DiffError> {
    let wrong =
        || DiffError::Limit(format!("{text:?} is not METRIC=VALUE, as in relMSE=1e-3 or direct:p99_rel=0.1"));
    let (name, value) = text.split_once('=').ok_or_else(wrong)?;
    let value: f64 = value.trim().parse().map_err(|_| wrong())?;
    if name.trim().is_empty() || value.is_nan() {
        return Err(wrong());
    }
    Ok((name.trim().to_owned(), value))
}

fn upper(comparison: &Comparison, name: &str, limit: f64) -> Result<Check, DiffError> {
    let (layer, metric, reading) = find(comparison, name)?;
    if reading.sense == Sense::HigherIsBetter {
        return Err(DiffError::Limit(format!("{name} is better when it is higher: give it with --min")));
    }
    let text = if reading.sense == Sense::NearOne { format!("1 ± {limit}") } else { format!("≤ {limit}") };
    Ok(Check { layer, metric, value: reading.value, limit: text, holds: reading.distance() <= limit })
}

fn find<'a>(
    comparison: &'a Comparison,
    name: &str,
) -> Result<(String, String, &'a crate::Reading), DiffError> {
    let (layer, metric) = split(name);
    let found = match layer {
        None => beauty(comparison)?,
        Some(layer) => comparison
            .layers
            .iter()
            .find(|l| l.layer == layer)
            .ok_or_else(|| DiffError::Limit(format!("{name}: no layer {layer:?} was compared")))?,
    };
    let reading = found.reading(metric).ok_or_else(|| {
        let known: Vec<&str> = found.readings.iter().map(|r| r.name.as_str()).collect();
        let noise = if found.noise.is_none() {
            " (those about noise need the reference's standard error)"
        } else {
            ""
        };
        DiffError::Limit(format!("no metric is called {metric:?}; there are {}{noise}", known.join(", ")))
    })?;
    Ok((found.layer.clone(), metric.to_owned(), reading))
}

fn beauty(comparison: &Comparison) -> Result<&LayerComparison, DiffError> {
    comparison.layers.first().ok_or_else(|| DiffError::Limit("nothing was compared".to_owned()))
}

fn split(name: &str) -> (Option<&str>, &str) {
    name.rsplit_once(':').map_or((None, name), |(layer, metric)| (Some(layer), metric))
}

fn qualified(layer: &str, metric: &str) -> String {
    if layer.is_empty() { metric.to_owned() } else { format!("{layer}:{metric}") }
}

/// The q of `p<q>_abs`, `p<q>_rel`, `p<q>_flip`.
fn percentile_of(metric: &str) -> Option<f64> {
    let (q, kind) = metric.strip_prefix('p')?.split_once('_')?;
    let q: f64 = q.parse().ok()?;
    (matches!(kind, "abs" | "rel" | "flip") && (0.0..=100.0).contains(&q)).then_some(q)
}
