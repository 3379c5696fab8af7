//! The birth certificate of a reference image: a JSON file of the same name beside it.

use std::path::{Path, PathBuf};

use catoptric_image::{Image, ReadLimits, write_bytes_atomically};
use serde_json::{Map, Value, json};

use crate::{DiffError, Limits, Params, compare};

/// `cornell.exr` → `cornell.json`.
pub fn certificate_path(reference: &Path) -> PathBuf {
    reference.with_extension("json")
}

/// `cornell.exr` → `cornell.limits.json`.
pub fn limits_path(reference: &Path) -> PathBuf {
    reference.with_extension("limits.json")
}

/// What a certificate says; a reference without one has an empty one.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Certificate {
    /// All its fields.
    pub fields: Map<String, Value>,
}

impl Certificate {
    /// Reads the certificate beside a reference, if there is one.
    pub fn beside(reference: &Path) -> Result<Certificate, DiffError> {
        let path = certificate_path(reference);
        let text = match std::fs::read_to_string(&path) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                return Ok(Certificate::default());
            }
            Err(error) => return Err(DiffError::io(&path, error)),
        };
        match serde_json::from_str(&text) {
            Ok(fields) => Ok(Certificate { fields }),
            Err(error) => Err(DiffError::Json { path, reason: error.to_string() }),
        }
    }

    /// The limits it states.
    pub fn limits(&self, reference: &Path) -> Result<Limits, DiffError> {
        let Some(limits) = self.fields.get("limits") else {
            return Ok(Limits::default());
        };
        serde_json::from_value(limits.clone()).map_err(|error| DiffError::Json {
            path: certificate_path(reference),
            reason: format!("limits: {error}"),
        })
    }

    /// The reference's standard error relative to its value, for references without a layer `SE`.
    pub fn relative_standard_error(&self) -> Option<f64> {
        let keys = ["relative_standard_error", "mean_relative_standard_error"];
        keys.iter()
            .find_map(|key| self.fields.get(*key))
            .and_then(Value::as_f64)
            .filter(|v| v.is_finite() && *v > 0.0)
    }
}

/// The limits that hold for a reference: those of `NAME.limits.json`, or else of its certificate.
pub fn limits_beside(reference: &Path) -> Result<Limits, DiffError> {
    let path = limits_path(reference);
    if path.is_file() { Limits::read(&path) } else { Certificate::beside(reference)?.limits(reference) }
}

/// How a reference is approved.
#[derive(Clone, Debug, Default)]
pub struct Approval {
    /// Limits for the new certificate, over those of the old one.
    pub limits: Limits,
    /// Limits may become looser.
    pub loosen: bool,
    /// Why, in the words of the person who approves.
    pub note: Option<String>,
    /// The day, as YYYY-MM-DD.
    pub date: String,
}

/// Replaces a reference by a test image and writes its birth certificate. The reference may be new.
///
/// Refuses if the image cannot be read, if the two names ask for different formats, or if a limit would become looser
/// without [`Approval::loosen`].
pub fn approve(test: &Path, reference: &Path, approval: &Approval) -> Result<(), DiffError> {
    let (image, limits) = check_approval(test, reference, approval)?;
    let old = Certificate::beside(reference)?;

    // The certificate: what the image says of itself, what it replaces, what it must be held to.
    let bytes = std::fs::read(test).map_err(|error| DiffError::io(test, error))?;
    let replaced = std::fs::read(reference).ok().map(|bytes| json!(fingerprint(&bytes)));
    let mut fields = Map::new();
    for (key, text) in &image.attributes {
        fields.insert(key.clone(), json!(text));
    }
    for key in ["scene", "scene_hash", "licence", "license"] {
        if let Some(value) = old.fields.get(key) {
            fields.entry(key.to_owned()).or_insert_with(|| value.clone());
        }
    }
    fields.insert("size".into(), json!([image.width, image.height]));
    fields.insert("fnv1a64".into(), json!(fingerprint(&bytes)));
    fields.insert("replaces_fnv1a64".into(), replaced.unwrap_or(Value::Null));
    fields.insert("approved".into(), json!(approval.date));
    fields.insert("approved_with".into(), json!(concat!("catoptric-diff ", env!("CARGO_PKG_VERSION"))));
    fields.insert("note".into(), json!(approval.note));
    fields.insert("limits".into(), json!(limits));
    let text = serde_json::to_string_pretty(&fields).map_err(|e| DiffError::Approve(e.to_string()))? + "\n";

    write_bytes_atomically(reference, &bytes).map_err(|error| DiffError::io(reference, error))?;
    // A limits file of its own would hide the limits of the certificate: keep the two equal.
    let own = limits_path(reference);
    if own.is_file() {
        let text =
            serde_json::to_string_pretty(&limits).map_err(|e| DiffError::Approve(e.to_string()))? + "\n";
        write_bytes_atomically(&own, text.as_bytes()).map_err(|error| DiffError::io(&own, error))?;
    }
    let path = certificate_path(reference);
    write_bytes_atomically(&path, text.as_bytes()).map_err(|error| DiffError::io(&path, error))
}

/// FNV-1a, 64 bits: tells files apart, no more.
fn fingerprint(bytes: &[u8]) -> String {
    let hash = bytes
        .iter()
        .fold(0xcbf2_9ce4_8422_2325u64, |h, &b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3));
    format!("{hash:016x}")
}

/// The image and its limits, if [`approve`] would accept them.
pub(crate) fn check_approval(
    test: &Path,
    reference: &Path,
    approval: &Approval,
) -> Result<(Image, Limits), DiffError> {
    if test.extension() != reference.extension() {
        let (t, r) = (test.display(), reference.display());
        return Err(DiffError::Approve(format!("{t} cannot replace {r}: their names end differently")));
    }
    let image = Image::read(test, &ReadLimits::default())?;
    let standing = limits_beside(reference)?;
    let limits = standing.clone().overridden_by(&approval.limits);
    // Names that the next comparison would not know are found now: the image against itself has all that it can be held to.
    let mut params = Params { relative_standard_error: Some(1.0), ..Params::default() };
    params.settings.percentiles.extend(limits.percentiles());
    Limits { explained_by_noise: false, ..limits.clone() }.check(&compare(
        image.clone(),
        image.clone(),
        &params,
    )?)?;
    let looser = standing.loosened_by(&limits);
    if !looser.is_empty() && !approval.loosen {
        let what = looser.join("; ");
        return Err(DiffError::Approve(format!(
            "{}: {what}; say --loosen if that is meant",
            reference.display()
        )));
    }
    Ok((image, limits))
}
