//! Why two images could not be compared.

use std::path::PathBuf;

use catoptric_image::ImageError;

/// Why a comparison gave no verdict.
#[derive(Debug, thiserror::Error)]
pub enum DiffError {
    /// An image could not be read or written.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// Images of different sizes.
    #[error("sizes differ: the test image is {test:?}, the reference {reference:?}")]
    Size {
        /// Width and height of the test image.
        test: [usize; 2],
        /// Width and height of the reference.
        reference: [usize; 2],
    },
    /// A layer that was asked for is missing.
    #[error("the {which} has no layer {layer:?}; it has {present}")]
    Layer {
        /// Test image or reference.
        which: &'static str,
        /// The layer's name.
        layer: String,
        /// What there is.
        present: String,
    },
    /// The crop or the mask leaves nothing to compare.
    #[error("{0}")]
    Region(String),
    /// A limit that cannot be understood.
    #[error("{0}")]
    Limit(String),
    /// A JSON file beside the reference that cannot be understood.
    #[error("{path}: {reason}")]
    Json {
        /// The file.
        path: PathBuf,
        /// What was wrong.
        reason: String,
    },
    /// The operating system refused.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A reference is not replaced.
    #[error("{0}")]
    Approve(String),
}

impl DiffError {
    pub(crate) fn io(path: &std::path::Path, source: std::io::Error) -> Self {
        DiffError::Io { path: path.to_path_buf(), source }
    }
}
