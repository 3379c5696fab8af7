//! A whole comparison job: files in, verdict, report and pictures out. The command line is a thin layer over this.

use std::path::{Path, PathBuf};

use catoptric_image::{Image, ReadLimits, write_bytes_atomically};
use serde_json::{Value, json};

use crate::certificate::{Certificate, limits_beside};
use crate::limits::Check;
use crate::report::{self, Heading};
use crate::{Comparison, DiffError, Limits, Params, compare, pictures};

/// What is asked of a pair of files.
#[derive(Clone, Debug, Default)]
pub struct Job {
    /// Region, layers, metrics. Its mask and standard error are taken from the files below.
    pub params: Params,
    /// Image whose pixels that are not black count.
    pub mask: Option<PathBuf>,
    /// Limits that replace those beside the reference.
    pub limits: Limits,
    /// Limits file to use instead of the one beside the reference.
    pub limits_file: Option<PathBuf>,
    /// Where the report goes: a file, or a folder for directories.
    pub html: Option<PathBuf>,
    /// Folder for pictures.
    pub pictures: Option<PathBuf>,
    /// How much a file may ask for.
    pub read: ReadLimits,
}

/// What came of a job.
pub struct Outcome {
    /// The numbers.
    pub comparison: Comparison,
    /// The limits against them.
    pub checks: Vec<Check>,
    /// Sentences for people.
    pub notes: Vec<String>,
}

impl Outcome {
    /// Whether every limit holds.
    pub fn within(&self) -> bool {
        self.checks.iter().all(|check| check.holds)
    }

    /// The outcome for machines. Infinite numbers are `null`.
    pub fn to_json(&self, test: &Path, reference: &Path) -> Value {
        let layers: Vec<Value> = self
            .comparison
            .layers
            .iter()
            .map(|layer| {
                let metrics: serde_json::Map<String, Value> =
                    layer.readings.iter().map(|r| (r.name.clone(), json!(r.value))).collect();
                let places: serde_json::Map<String, Value> =
                    layer.readings.iter().filter_map(|r| Some((r.name.clone(), json!(r.at?)))).collect();
                json!({ "layer": layer.layer, "metrics": metrics, "at": places, "noise": layer.noise })
            })
            .collect();
        json!({
            "test": test.display().to_string(),
            "reference": reference.display().to_string(),
            "verdict": if self.within() { "within" } else { "outside" },
            "exit_code": if self.within() { 0 } else { 1 },
            "layers": layers,
            "checks": self.checks,
            "notes": self.notes,
        })
    }
}

/// Compares two files, checks the limits and writes what was asked for.
pub fn run(job: &Job, test: &Path, reference: &Path) -> Result<Outcome, DiffError> {
    let (t, r) = rayon::join(|| Image::read(test, &job.read), || Image::read(reference, &job.read));
    let (test_image, reference_image) = (t?, r?);
    let standing = match &job.limits_file {
        Some(file) => Limits::read(file)?,
        None => limits_beside(reference)?,
    };
    let limits = standing.overridden_by(&job.limits);
    let mut params = job.params.clone();
    params.relative_standard_error =
        params.relative_standard_error.or(Certificate::beside(reference)?.relative_standard_error());
    if let Some(mask) = &job.mask {
        params.mask = Some(Image::read(mask, &job.read)?);
    }
    for q in limits.percentiles() {
        if !params.settings.percentiles.contains(&q) {
            params.settings.percentiles.push(q);
        }
    }
    let comparison = compare(test_image, reference_image, &params)?;
    let checks = limits.check(&comparison)?;
    let notes = notes(&comparison, &params, &limits);
    let outcome = Outcome { comparison, checks, notes };

    if let Some(path) = &job.html {
        let [test, reference] = [test, reference].map(|p| p.display().to_string());
        let heading =
            Heading { test: &test, reference: &reference, checks: &outcome.checks, notes: &outcome.notes };
        write_page(path, &report::html(&outcome.comparison, &heading))?;
    }
    if let Some(folder) = &job.pictures {
        for layer in &outcome.comparison.layers {
            let prefix = if layer.layer.is_empty() {
                String::new()
            } else {
                format!("{}-", layer.layer.replace('/', "_"))
            };
            pictures::write(&layer.pair, folder, &prefix)?;
        }
    }
    Ok(outcome)
}

/// Writes a page, making the folders it lies in.
pub(crate) fn write_page(path: &Path, html: &str) -> Result<(), DiffError> {
    if let Some(folder) = path.parent().filter(|p| !p.as_os_str().is_empty()) {
        std::fs::create_dir_all(folder).map_err(|error| DiffError::io(folder, error))?;
    }
    write_bytes_atomically(path, html.as_bytes()).map_err(|error| DiffError::io(path, error))
}

/// What the numbers do not say.
fn notes(comparison: &Comparison, params: &Params, limits: &Limits) -> Vec<String> {
    let mut notes = Vec::new();
    let names = |layers: &[String]| {
        let names: Vec<&str> =
            layers.iter().map(|l| if l.is_empty() { "the beauty" } else { l.as_str() }).collect();
        names.join(", ")
    };
    if params.layers.is_none() {
        for (layers, which) in
            [(&comparison.only_in_test, "test image"), (&comparison.only_in_reference, "reference")]
        {
            if !layers.is_empty() {
                notes.push(format!("Not compared, because only the {which} has them: {}.", names(layers)));
            }
        }
    }
    if limits.is_empty() {
        notes.push("No limits were given: the images must be equal.".to_owned());
    }
    if comparison.layers.first().is_some_and(|l| l.pair.coded) {
        notes.push("Both hold sRGB codes: differences are those of code values in [0,1], energy is that of linear light.".to_owned());
    }
    notes
}
