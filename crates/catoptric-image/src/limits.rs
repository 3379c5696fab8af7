//! How much a file may ask for.

use crate::ImageError;

/// Upper bounds that a reader checks before it allocates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReadLimits {
    /// Width times height.
    pub max_pixels: u64,
    /// Channels over all parts of a file.
    pub max_channels: usize,
    /// Bytes of the file, and bytes of the decoded float image.
    pub max_bytes: u64,
}

impl Default for ReadLimits {
    /// 256 megapixels, 256 channels, 2 GiB.
    fn default() -> Self {
        ReadLimits { max_pixels: 256 << 20, max_channels: 256, max_bytes: 2 << 30 }
    }
}

impl ReadLimits {
    /// Checks the size of a decoded image of 4-byte samples and returns its pixel count.
    pub(crate) fn check(&self, width: u64, height: u64, channels: usize) -> Result<usize, ImageError> {
        let pixels = u128::from(width) * u128::from(height);
        within("pixel count", pixels, u128::from(self.max_pixels))?;
        within("channel count", channels as u128, self.max_channels as u128)?;
        within("decoded size in bytes", pixels * channels as u128 * 4, u128::from(self.max_bytes))?;
        usize::try_from(pixels).map_err(|_| too_large("pixel count", pixels, usize::MAX as u128))
    }
}

/// An error if `found` exceeds `limit`.
pub(crate) fn within(what: &'static str, found: u128, limit: u128) -> Result<(), ImageError> {
    if found > limit { Err(too_large(what, found, limit)) } else { Ok(()) }
}

fn too_large(what: &'static str, found: u128, limit: u128) -> ImageError {
    ImageError::TooLarge { name: String::new(), what, found, limit }
}
