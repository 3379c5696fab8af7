//! What can go wrong with an image file, in the words of the person who passed it.

use std::path::{Path, PathBuf};

/// Why an image could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum ImageError {
    /// The operating system refused.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The first bytes belong to no format we read.
    #[error("{name}: not an EXR, PNG, JPEG, Radiance HDR or PFM file (it begins with {start})")]
    UnknownFormat {
        /// File name, empty for bytes in memory.
        name: String,
        /// The first bytes in hexadecimal.
        start: String,
    },
    /// The file contradicts its own format.
    #[error("{name}: damaged {format} file: {reason}")]
    Damaged {
        /// File name, empty for bytes in memory.
        name: String,
        /// The format that was recognised.
        format: &'static str,
        /// What was wrong.
        reason: String,
    },
    /// The file is legal but holds something this reader does not handle.
    #[error("{name}: unsupported {format} file: {feature}")]
    Unsupported {
        /// File name, empty for bytes in memory.
        name: String,
        /// The format that was recognised.
        format: &'static str,
        /// The feature.
        feature: String,
    },
    /// The file asks for more than the limits allow.
    #[error("{name}: {what} is {found}, more than the limit of {limit}")]
    TooLarge {
        /// File name, empty for bytes in memory.
        name: String,
        /// The quantity that is too large.
        what: &'static str,
        /// What the file asks for.
        found: u128,
        /// What is allowed.
        limit: u128,
    },
    /// The image itself cannot be written.
    #[error("cannot write the image: {0}")]
    Inconsistent(String),
}

impl ImageError {
    pub(crate) fn io(path: &Path, source: std::io::Error) -> Self {
        ImageError::Io { path: path.to_path_buf(), source }
    }

    pub(crate) fn damaged(format: &'static str, reason: impl ToString) -> Self {
        ImageError::Damaged { name: String::new(), format, reason: one_line(&reason.to_string()) }
    }

    pub(crate) fn unsupported(format: &'static str, feature: impl ToString) -> Self {
        ImageError::Unsupported { name: String::new(), format, feature: one_line(&feature.to_string()) }
    }

    /// The same error, naming the file it is about.
    pub(crate) fn in_file(mut self, path: &Path) -> Self {
        match &mut self {
            ImageError::UnknownFormat { name, .. }
            | ImageError::Damaged { name, .. }
            | ImageError::Unsupported { name, .. }
            | ImageError::TooLarge { name, .. } => *name = path.display().to_string(),
            ImageError::Io { .. } | ImageError::Inconsistent(_) => {}
        }
        self
    }
}

/// Decoders quote what they found in the file: keep it printable and short.
fn one_line(text: &str) -> String {
    let printable: String = text.chars().map(|c| if c.is_control() { ' ' } else { c }).take(200).collect();
    printable.trim().to_owned()
}
