//! The image: named float channels of one size.

use std::collections::BTreeMap;
use std::path::Path;

use crate::format;
use crate::{ImageError, ReadLimits, write_bytes_atomically};

/// How the source coded its values. The samples of an [`Image`] are linear either way.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Encoding {
    /// Scene-referred floats.
    #[default]
    Linear,
    /// sRGB code values, decoded with the sRGB transfer function.
    Srgb,
}

/// One plane of an image.
#[derive(Clone, Debug, PartialEq)]
pub struct Channel {
    /// Full name: `R`, `albedo.G`, `depth.Z`.
    pub name: String,
    /// Row-major, row 0 at the top; width × height samples.
    pub samples: Vec<f32>,
}

/// A linear-light image of named float channels.
///
/// The beauty is the channels `R`, `G`, `B`; every other layer is `name.R`, `name.G`, `name.B`. Colours are Rec. 709.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Image {
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// The planes, in the order they were pushed or read.
    pub channels: Vec<Channel>,
    /// Free text: what the renderer wrote about itself.
    pub attributes: BTreeMap<String, String>,
    /// How the source coded its values.
    pub encoding: Encoding,
}

impl Image {
    /// An image without channels.
    pub fn new(width: usize, height: usize) -> Image {
        Image { width, height, ..Image::default() }
    }

    /// An image whose beauty is `pixels`.
    pub fn from_rgb(width: usize, height: usize, pixels: &[[f32; 3]]) -> Image {
        let mut image = Image::new(width, height);
        image.push_rgb_layer("", pixels);
        image
    }

    /// Adds the three channels of a layer; the beauty's name is empty.
    ///
    /// # Panics
    /// If `pixels` does not have width × height elements.
    pub fn push_rgb_layer(&mut self, layer: &str, pixels: &[[f32; 3]]) {
        for (k, suffix) in ["R", "G", "B"].into_iter().enumerate() {
            self.push_channel(&channel_name(layer, suffix), pixels.iter().map(|p| p[k]).collect());
        }
    }

    /// Adds one channel.
    ///
    /// # Panics
    /// If `samples` does not have width × height elements.
    pub fn push_channel(&mut self, name: &str, samples: Vec<f32>) {
        assert_eq!(
            samples.len(),
            self.width * self.height,
            "channel {name} does not fit {}x{}",
            self.width,
            self.height
        );
        self.channels.push(Channel { name: name.to_owned(), samples });
    }

    /// The samples of the channel with exactly this name.
    pub fn channel(&self, name: &str) -> Option<&[f32]> {
        self.channels.iter().find(|c| c.name == name).map(|c| c.samples.as_slice())
    }

    /// Names of the colour layers: the beauty (`""`) first, then in alphabetical order. A layer is a colour layer when it
    /// has any of the channels R, G, B or Y.
    pub fn layers(&self) -> Vec<String> {
        let mut names: Vec<String> =
            self.channels.iter().filter_map(|c| colour_layer(&c.name)).map(str::to_owned).collect();
        names.sort();
        names.dedup();
        names
    }

    /// The channels that are red, green and blue of a layer, by index; `None` for black.
    ///
    /// A layer with a luminance `Y` or with one colour channel only is replicated; of two colour channels the third is
    /// black; the full name of any channel (`depth.Z`) gives that channel three times. `None` if nothing has this name.
    pub fn layer_channels(&self, layer: &str) -> Option<[Option<usize>; 3]> {
        let find = |name: &str| self.channels.iter().position(|c| c.name == name);
        let [r, g, b, y] = ["R", "G", "B", "Y"].map(|s| find(&channel_name(layer, s)));
        let present: Vec<usize> = [r, g, b].into_iter().flatten().collect();
        match (present.as_slice(), y) {
            ([], y) => y.or_else(|| find(layer)).map(|only| [Some(only); 3]),
            ([only], _) => Some([Some(*only); 3]),
            _ => Some([r, g, b]),
        }
    }

    /// The pixels of a layer, from its [`Image::layer_channels`].
    pub fn rgb(&self, layer: &str) -> Option<Vec<[f32; 3]>> {
        let planes =
            self.layer_channels(layer)?.map(|channel| channel.map(|c| self.channels[c].samples.as_slice()));
        let pixel = |i: usize| planes.map(|plane| plane.map_or(0.0, |p| p[i]));
        Some((0..self.width * self.height).map(pixel).collect())
    }

    /// Reads a file. Its content decides the format, not its name.
    pub fn read(path: &Path, limits: &ReadLimits) -> Result<Image, ImageError> {
        format::read(path, limits)
    }

    /// Decodes the bytes of a file.
    pub fn decode(bytes: &[u8], limits: &ReadLimits) -> Result<Image, ImageError> {
        format::decode(bytes, limits)
    }

    /// The bytes of a one-part float OpenEXR file: the same for the same image, on any machine.
    pub fn encode_exr(&self) -> Result<Vec<u8>, ImageError> {
        format::exr_write::encode(self)
    }

    /// Writes [`Image::encode_exr`] atomically.
    pub fn write_exr(&self, path: &Path) -> Result<(), ImageError> {
        let bytes = self.encode_exr()?;
        write_bytes_atomically(path, &bytes).map_err(|error| ImageError::io(path, error))
    }

    /// Writes the beauty as a little-endian portable float map, atomically.
    pub fn write_pfm(&self, path: &Path) -> Result<(), ImageError> {
        let bytes = format::pfm::encode(self)?;
        write_bytes_atomically(path, &bytes).map_err(|error| ImageError::io(path, error))
    }
}

/// `R` of the layer `albedo` is `albedo.R`; of the beauty, `R`.
fn channel_name(layer: &str, suffix: &str) -> String {
    if layer.is_empty() { suffix.to_owned() } else { format!("{layer}.{suffix}") }
}

/// The layer a colour channel belongs to.
fn colour_layer(channel: &str) -> Option<&str> {
    let (layer, suffix) = channel.rsplit_once('.').unwrap_or(("", channel));
    matches!(suffix, "R" | "G" | "B" | "Y").then_some(layer)
}
