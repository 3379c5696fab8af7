//! OpenEXR out: one part, float32, scan lines, ZIP in blocks of 16 lines.
//!
//! The layout follows "OpenEXR File Layout" (Academy Software Foundation). It is written here, and not through the `exr`
//! crate, because that crate iterates a hash map over custom attributes: two runs would give two files.

use std::io::Write;

use flate2::Compression;
use flate2::write::ZlibEncoder;
use rayon::prelude::*;

use crate::{Channel, Image, ImageError};

const LINES_PER_BLOCK: usize = 16;
/// Level 4, which the OpenEXR library uses, takes more than twice as long for files 2 to 4 % smaller (pictures of cornell_box and, with
/// layers, interior).
const ZIP_LEVEL: u32 = 1;
const FLOAT: u32 = 2;
const ZIP16: u8 = 3;

pub(crate) fn encode(image: &Image) -> Result<Vec<u8>, ImageError> {
    let channels = sorted_channels(image)?;
    let (right, bottom) = last_pixel(image)?;

    // Write the header.
    let mut file = Vec::new();
    file.extend([0x76, 0x2f, 0x31, 0x01]);
    let long_names =
        channels.iter().map(|c| c.name.len()).chain(image.attributes.keys().map(String::len)).any(|n| n > 31);
    file.extend(u32::to_le_bytes(if long_names { 2 | 0x400 } else { 2 }));
    attribute(&mut file, "channels", "chlist", &channel_list(&channels));
    attribute(&mut file, "compression", "compression", &[ZIP16]);
    let window: Vec<u8> = [0, 0, right, bottom].into_iter().flat_map(i32::to_le_bytes).collect();
    attribute(&mut file, "dataWindow", "box2i", &window);
    attribute(&mut file, "displayWindow", "box2i", &window);
    attribute(&mut file, "lineOrder", "lineOrder", &[0]);
    attribute(&mut file, "pixelAspectRatio", "float", &1f32.to_le_bytes());
    attribute(&mut file, "screenWindowCenter", "v2f", &[0; 8]);
    attribute(&mut file, "screenWindowWidth", "float", &1f32.to_le_bytes());
    for (name, text) in &image.attributes {
        attribute(&mut file, name, "string", text.as_bytes());
    }
    file.push(0);

    // Compress the blocks, then write where each begins and the blocks themselves.
    let blocks: Vec<Vec<u8>> = (0..image.height.div_ceil(LINES_PER_BLOCK))
        .into_par_iter()
        .map(|b| block(image, &channels, b))
        .collect();
    let mut offset = (file.len() + 8 * blocks.len()) as u64;
    for block in &blocks {
        file.extend(offset.to_le_bytes());
        offset += block.len() as u64;
    }
    for block in blocks {
        file.extend(block);
    }
    Ok(file)
}

/// Channels in the order the format demands. Names must be unique, 1 to 255 bytes and free of zeros.
fn sorted_channels(image: &Image) -> Result<Vec<&Channel>, ImageError> {
    let mut channels: Vec<&Channel> = image.channels.iter().collect();
    channels.sort_by(|a, b| a.name.cmp(&b.name));
    if let Some(pair) = channels.windows(2).find(|pair| pair[0].name == pair[1].name) {
        return Err(ImageError::Inconsistent(format!("two channels are called {}", pair[0].name)));
    }
    if channels.is_empty() {
        return Err(ImageError::Inconsistent("it has no channels".to_owned()));
    }
    for name in channels.iter().map(|c| &c.name).chain(image.attributes.keys()) {
        if !(1..256).contains(&name.len()) || name.bytes().any(|b| b == 0) {
            return Err(ImageError::Inconsistent(format!("{name:?} is not a name OpenEXR can hold")));
        }
    }
    if let Some(wrong) = channels.iter().find(|c| c.samples.len() != image.width * image.height) {
        let (found, name) = (wrong.samples.len(), &wrong.name);
        return Err(ImageError::Inconsistent(format!(
            "channel {name} has {found} samples, not {}x{}",
            image.width, image.height
        )));
    }
    Ok(channels)
}

fn last_pixel(image: &Image) -> Result<(i32, i32), ImageError> {
    let last = |n: usize| i32::try_from(n).ok().filter(|&n| n > 0).map(|n| n - 1);
    match (last(image.width), last(image.height)) {
        (Some(right), Some(bottom)) => Ok((right, bottom)),
        _ => Err(ImageError::Inconsistent(format!("its size is {}x{}", image.width, image.height))),
    }
}

fn attribute(file: &mut Vec<u8>, name: &str, kind: &str, value: &[u8]) {
    file.extend(name.as_bytes());
    file.push(0);
    file.extend(kind.as_bytes());
    file.push(0);
    file.extend((value.len() as u32).to_le_bytes());
    file.extend(value);
}

fn channel_list(channels: &[&Channel]) -> Vec<u8> {
    let mut list = Vec::new();
    for channel in channels {
        list.extend(channel.name.as_bytes());
        list.push(0);
        list.extend(FLOAT.to_le_bytes());
        list.extend([0; 4]); // pLinear and three reserved bytes
        list.extend(1u32.to_le_bytes()); // x sampling
        list.extend(1u32.to_le_bytes()); // y sampling
    }
    list.push(0);
    list
}

/// First line, byte count and data of one block of lines.
fn block(image: &Image, channels: &[&Channel], index: usize) -> Vec<u8> {
    let first = index * LINES_PER_BLOCK;
    let lines = first..image.height.min(first + LINES_PER_BLOCK);
    let mut raw = Vec::with_capacity(lines.len() * image.width * channels.len() * 4);
    for y in lines {
        for channel in channels {
            let line = &channel.samples[y * image.width..(y + 1) * image.width];
            raw.extend(line.iter().flat_map(|v| v.to_le_bytes()));
        }
    }
    let packed = zip(&raw);
    // A block that does not shrink is stored as it is.
    let data = if packed.len() < raw.len() { &packed } else { &raw };
    let mut block = Vec::with_capacity(8 + data.len());
    block.extend((first as u32).to_le_bytes());
    block.extend((data.len() as u32).to_le_bytes());
    block.extend(data);
    block
}

/// OpenEXR's ZIP: even bytes before odd bytes, then differences, then zlib.
fn zip(raw: &[u8]) -> Vec<u8> {
    let mut bytes: Vec<u8> = raw.iter().step_by(2).chain(raw.iter().skip(1).step_by(2)).copied().collect();
    for i in (1..bytes.len()).rev() {
        bytes[i] = bytes[i].wrapping_sub(bytes[i - 1]).wrapping_add(128);
    }
    let mut encoder = ZlibEncoder::new(Vec::with_capacity(bytes.len() / 2), Compression::new(ZIP_LEVEL));
    encoder.write_all(&bytes).and_then(|()| encoder.finish()).expect("writing to memory does not fail")
}
