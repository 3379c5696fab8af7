//! File formats: recognised by content, decoded within limits.

pub(crate) mod exr_read;
pub(crate) mod exr_write;
mod hdr;
mod jpeg;
pub(crate) mod pfm;
pub(crate) mod png;

use std::io::{BufReader, Cursor, Read, Seek};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use crate::limits::within;
use crate::{Encoding, Image, ImageError, ReadLimits, srgb};

/// The formats that are read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Exr,
    Png,
    Jpeg,
    Hdr,
    Pfm,
}

impl Format {
    /// Recognises a format by the first bytes.
    fn of(bytes: &[u8]) -> Option<Format> {
        const MAGIC: [(&[u8], Format); 8] = [
            (&[0x76, 0x2f, 0x31, 0x01], Format::Exr),
            (b"\x89PNG\r\n\x1a\n", Format::Png),
            (&[0xff, 0xd8, 0xff], Format::Jpeg),
            (b"#?RADIANCE", Format::Hdr),
            (b"#?RGBE", Format::Hdr),
            (b"PF\n", Format::Pfm),
            (b"Pf\n", Format::Pfm),
            (b"PF\r\n", Format::Pfm),
        ];
        MAGIC.iter().find(|(magic, _)| bytes.starts_with(magic)).map(|&(_, format)| format)
    }

    fn name(self) -> &'static str {
        match self {
            Format::Exr => "EXR",
            Format::Png => "PNG",
            Format::Jpeg => "JPEG",
            Format::Hdr => "Radiance HDR",
            Format::Pfm => "PFM",
        }
    }
}

/// Reads a file. An OpenEXR file is decoded chunk by chunk, others are held as a whole.
pub(crate) fn read(path: &Path, limits: &ReadLimits) -> Result<Image, ImageError> {
    let at = |error| ImageError::io(path, error);
    let mut file = std::fs::File::open(path).map_err(at)?;
    let metadata = file.metadata().map_err(at)?;
    if metadata.is_dir() {
        return Err(at(std::io::Error::new(std::io::ErrorKind::IsADirectory, "is a folder, not an image")));
    }
    let size_within = |size: u64| {
        within("file size in bytes", u128::from(size), u128::from(limits.max_bytes))
            .map_err(|e| e.in_file(path))
    };
    if metadata.is_file() {
        size_within(metadata.len())?;
        let mut magic = Vec::new();
        file.by_ref().take(4).read_to_end(&mut magic).map_err(at)?;
        file.rewind().map_err(at)?;
        if Format::of(&magic) == Some(Format::Exr) {
            let decode = || exr_read::decode(BufReader::new(file), metadata.len(), limits);
            return guarded(Format::Exr, decode).map_err(|error| error.in_file(path));
        }
    }
    // The size is measured while reading: a pipe or a device has no length to ask for.
    let mut bytes = Vec::new();
    file.take(limits.max_bytes + 1).read_to_end(&mut bytes).map_err(at)?;
    size_within(bytes.len() as u64)?;
    decode(&bytes, limits).map_err(|error| error.in_file(path))
}

/// Decodes by content.
pub(crate) fn decode(bytes: &[u8], limits: &ReadLimits) -> Result<Image, ImageError> {
    let Some(format) = Format::of(bytes) else {
        let start = bytes.iter().take(8).map(|b| format!("{b:02x}")).collect::<Vec<_>>().join(" ");
        let start = if start.is_empty() { "nothing: it is empty".to_owned() } else { start };
        return Err(ImageError::UnknownFormat { name: String::new(), start });
    };
    guarded(format, || match format {
        Format::Exr => exr_read::decode(Cursor::new(bytes), bytes.len() as u64, limits),
        Format::Png => png::decode(bytes, limits),
        Format::Jpeg => jpeg::decode(bytes, limits),
        Format::Hdr => hdr::decode(bytes, limits),
        Format::Pfm => pfm::decode(bytes, limits),
    })
}

/// A panic inside a decoder is a damaged file.
fn guarded(format: Format, decode: impl FnOnce() -> Result<Image, ImageError>) -> Result<Image, ImageError> {
    catch_unwind(AssertUnwindSafe(decode))
        .unwrap_or_else(|_| Err(ImageError::damaged(format.name(), "its decoder gave up on it")))
}

/// An image of sRGB samples: colours are decoded to linear light, an alpha channel is kept as it is.
fn from_coded(width: usize, height: usize, channels: usize, sample: impl Fn(usize) -> f32) -> Image {
    let mut image = Image { encoding: Encoding::Srgb, ..Image::new(width, height) };
    let names: &[&str] = match channels {
        1 => &["Y"],
        2 => &["Y", "A"],
        3 => &["R", "G", "B"],
        _ => &["R", "G", "B", "A"],
    };
    for (k, name) in names.iter().enumerate() {
        let coded = (0..width * height).map(|i| sample(i * channels + k));
        let samples = if *name == "A" { coded.collect() } else { coded.map(srgb::decode).collect() };
        image.push_channel(name, samples);
    }
    image
}

/// An image of sRGB bytes.
fn from_bytes(width: usize, height: usize, channels: usize, bytes: &[u8]) -> Image {
    let table = &*srgb::LINEAR_OF_BYTE;
    let mut image = from_coded(width, height, channels, |_| 0.0);
    for (k, channel) in image.channels.iter_mut().enumerate() {
        let coded = bytes.iter().skip(k).step_by(channels);
        if channel.name == "A" {
            channel.samples = coded.map(|&b| f32::from(b) / 255.0).collect();
        } else {
            channel.samples = coded.map(|&b| table[usize::from(b)]).collect();
        }
    }
    image
}

/// An image of sRGB 16-bit codes in the machine's byte order.
fn from_words(width: usize, height: usize, channels: usize, bytes: &[u8]) -> Image {
    from_coded(width, height, channels, |i| {
        f32::from(u16::from_ne_bytes([bytes[2 * i], bytes[2 * i + 1]])) / 65535.0
    })
}
