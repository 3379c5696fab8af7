//! OpenEXR in: scan lines and tiles, every compression the `exr` crate knows, several parts.
//!
//! The headers are read first and everything they promise is checked against the limits and the size of the file; only
//! then is memory allocated for pixels. Of mip and rip maps the full resolution is read.

use std::collections::BTreeSet;
use std::io::{Read, Seek};

use exr::block::UncompressedBlock;
use exr::block::chunk::{Chunk, CompressedBlock, CompressedScanLineBlock, CompressedTileBlock};
use exr::block::reader::Reader;
use exr::compression::Compression;
use exr::meta::attribute::{AttributeValue, SampleType, Text};
use exr::meta::header::Header;
use exr::meta::{BlockDescription, MetaData};
use exr::prelude::f16;
use rayon::prelude::*;

use crate::limits::within;
use crate::{Image, ImageError, ReadLimits};

/// Chunks per thread that are decompressed together: the threads do not wait, and the memory stays small.
const BATCH: usize = 4;

/// Decodes a file of `size` bytes, which need not be in memory as a whole.
pub(crate) fn decode(source: impl Read + Seek, size: u64, limits: &ReadLimits) -> Result<Image, ImageError> {
    let reader = exr::block::read(source, false).map_err(damaged)?;
    let meta = reader.meta_data().clone();
    let window = check(&meta, size, limits)?;
    let mut image = Image::new(window.width, window.height);
    for (part, header) in meta.headers.iter().enumerate() {
        for channel in &header.channels.list {
            let name = unique_name(&image, qualified_name(part, header, &channel.name));
            image.push_channel(&name, vec![0.0; window.width * window.height]);
        }
        collect_text(header, &mut image);
    }
    read_pixels(reader, &meta, &window, &mut image)?;
    Ok(image)
}

/// The union of the parts' data windows.
struct Window {
    left: i64,
    top: i64,
    width: usize,
    height: usize,
}

/// Checks all that the headers promise.
fn check(meta: &MetaData, file_size: u64, limits: &ReadLimits) -> Result<Window, ImageError> {
    if meta.requirements.has_deep_data || meta.headers.iter().any(|h| h.deep) {
        return Err(ImageError::unsupported("EXR", "deep data"));
    }
    if meta.headers.is_empty() {
        return Err(ImageError::damaged("EXR", "no parts"));
    }
    let (mut left, mut top, mut right, mut bottom) = (i64::MAX, i64::MAX, i64::MIN, i64::MIN);
    let mut chunks = 0u128;
    for header in &meta.headers {
        let (x, y) = (
            i64::from(header.own_attributes.layer_position.x()),
            i64::from(header.own_attributes.layer_position.y()),
        );
        let (width, height) = (header.layer_size.width() as i64, header.layer_size.height() as i64);
        if width < 1 || height < 1 {
            return Err(ImageError::damaged("EXR", "empty data window"));
        }
        (left, top) = (left.min(x), top.min(y));
        (right, bottom) = (right.max(x + width), bottom.max(y + height));
        chunks += header.chunk_count as u128;
        if let Some(channel) =
            header.channels.list.iter().find(|c| c.sampling.x() != 1 || c.sampling.y() != 1)
        {
            return Err(ImageError::unsupported("EXR", format!("the subsampled channel {}", channel.name)));
        }
        if header.channels.list.is_empty() {
            return Err(ImageError::damaged("EXR", "a part without channels"));
        }
        if let BlockDescription::Tiles(tiles) = header.blocks {
            let tile = tiles.tile_size.width() as u128 * tiles.tile_size.height() as u128;
            within(
                "tile size in bytes",
                tile * header.channels.bytes_per_pixel as u128,
                u128::from(limits.max_bytes),
            )?;
        }
    }
    // Each chunk has an offset of 8 bytes and at least a coordinate and a length of 4 bytes each.
    if chunks * 16 > file_size as u128 {
        let reason = format!("{chunks} chunks promised in {file_size} bytes");
        return Err(ImageError::damaged("EXR", reason));
    }
    let channels = meta.headers.iter().map(|h| h.channels.list.len()).sum();
    let (width, height) = ((right - left) as u64, (bottom - top) as u64);
    limits.check(width, height, channels)?;
    Ok(Window { left, top, width: width as usize, height: height as usize })
}

/// The channel's name in the image: the first part's names stay, others carry their part's name once.
fn qualified_name(part: usize, header: &Header, channel: &Text) -> String {
    let channel = utf8(channel);
    match &header.own_attributes.layer_name {
        Some(layer) if part > 0 => {
            let prefix = format!("{}.", utf8(layer));
            if channel.starts_with(&prefix) { channel } else { prefix + &channel }
        }
        None if part > 0 => format!("part{part}.{channel}"),
        _ => channel,
    }
}

/// The `exr` crate prints bytes as Latin-1; files hold UTF-8.
fn utf8(text: &Text) -> String {
    String::from_utf8_lossy(text.as_slice()).into_owned()
}

/// Two parts of one name are told apart by a number.
fn unique_name(image: &Image, name: String) -> String {
    if image.channel(&name).is_none() {
        return name;
    }
    (2..).map(|n| format!("{n}.{name}")).find(|name| image.channel(name).is_none()).unwrap_or(name)
}

/// Keeps what the header says in words.
fn collect_text(header: &Header, image: &mut Image) {
    let own = &header.own_attributes;
    for (name, text) in [("comments", &own.comments), ("software", &own.software_name), ("owner", &own.owner)]
    {
        if let Some(text) = text {
            image.attributes.insert(name.to_owned(), utf8(text));
        }
    }
    for (name, value) in own.other.iter().chain(&header.shared_attributes.other) {
        if let AttributeValue::Text(text) = value {
            image.attributes.insert(utf8(name), utf8(text));
        }
    }
}

/// Decompresses all chunks and puts their lines where they belong.
fn read_pixels(
    reader: Reader<impl Read + Seek>,
    meta: &MetaData,
    window: &Window,
    image: &mut Image,
) -> Result<(), ImageError> {
    let mut seen = BTreeSet::new();
    let mut chunks = reader.all_chunks(false).map_err(damaged)?;
    let together = BATCH * rayon::current_num_threads();
    loop {
        // Take a batch of chunks. Problems keep their place: the first in the file is reported, whatever the batch.
        let mut batch = Vec::with_capacity(together);
        for chunk in chunks.by_ref().take(together) {
            batch.push(chunk.map_err(damaged).and_then(|chunk| {
                let new = seen.insert(chunk_key(&chunk));
                if new { Ok(chunk) } else { Err(ImageError::damaged("EXR", "the same chunk twice")) }
            }));
        }
        if batch.is_empty() {
            return Ok(());
        }
        // Decompress in parallel, copy in order.
        let blocks: Vec<Result<Option<UncompressedBlock>, ImageError>> =
            batch.into_par_iter().map(|chunk| decompress(chunk?, meta).map_err(damaged)).collect();
        for block in blocks {
            if let Some(block) = block? {
                place(&block, meta, window, image)?;
            }
        }
    }
}

/// The pixels of a chunk; `None` for one of lower resolution.
fn decompress(chunk: Chunk, meta: &MetaData) -> Result<Option<UncompressedBlock>, exr::error::Error> {
    if let CompressedBlock::Tile(tile) = &chunk.compressed_block
        && tile.coordinates.level_index.0 + tile.coordinates.level_index.1 > 0
    {
        return Ok(None);
    }
    check_dwa(&chunk, meta)?;
    UncompressedBlock::decompress_chunk(chunk, meta, false).map(Some)
}

/// DWA chunks begin with eleven 64-bit sizes that the decompressor allocates unseen: none may exceed what a block of this
/// part can need.
fn check_dwa(chunk: &Chunk, meta: &MetaData) -> Result<(), exr::error::Error> {
    let header = &meta.headers[chunk.layer_index];
    let (CompressedBlock::Tile(CompressedTileBlock { compressed_pixels_le: data, .. })
    | CompressedBlock::ScanLine(CompressedScanLineBlock { compressed_pixels_le: data, .. })) =
        &chunk.compressed_block
    else {
        return Ok(());
    };
    if !matches!(header.compression, Compression::DWAA(_) | Compression::DWAB(_)) {
        return Ok(());
    }
    // A block that did not shrink is stored as it is, without sizes.
    let tile = header.get_block_data_indices(&chunk.compressed_block)?;
    let pixels = header.get_absolute_block_pixel_coordinates(tile)?.size;
    let block = (pixels.area() * header.channels.bytes_per_pixel) as u64;
    if data.len() as u64 == block {
        return Ok(());
    }
    let sizes =
        data.chunks_exact(8).take(11).map(|b| b.iter().rev().fold(0u64, |n, &byte| n << 8 | u64::from(byte)));
    if sizes.into_iter().any(|size| size > 4 * block + 65_536) {
        return Err(exr::error::Error::Invalid("DWA section size".into()));
    }
    Ok(())
}

/// What makes a chunk itself: part, position, level.
fn chunk_key(chunk: &Chunk) -> (usize, i64, i64, usize, usize) {
    match &chunk.compressed_block {
        CompressedBlock::Tile(t) => {
            let (tile, level) = (t.coordinates.tile_index, t.coordinates.level_index);
            (chunk.layer_index, tile.0 as i64, tile.1 as i64, level.0, level.1)
        }
        CompressedBlock::ScanLine(s) => (chunk.layer_index, 0, i64::from(s.y_coordinate), 0, 0),
        CompressedBlock::DeepScanLine(_) | CompressedBlock::DeepTile(_) => (chunk.layer_index, 0, 0, 0, 0),
    }
}

/// Copies the lines of one block into the channels.
fn place(
    block: &UncompressedBlock,
    meta: &MetaData,
    window: &Window,
    image: &mut Image,
) -> Result<(), ImageError> {
    let layer = block.index.layer;
    let header = &meta.headers[layer];
    let first_channel: usize = meta.headers[..layer].iter().map(|h| h.channels.list.len()).sum();
    let position = header.own_attributes.layer_position;
    let dx = (i64::from(position.x()) - window.left) as usize;
    let dy = (i64::from(position.y()) - window.top) as usize;
    let width = block.index.pixel_size.width();
    let mut at = 0;
    for y in 0..block.index.pixel_size.height() {
        for (k, channel) in header.channels.list.iter().enumerate() {
            let size = width * channel.sample_type.bytes_per_sample();
            let line =
                block.data.get(at..at + size).ok_or_else(|| ImageError::damaged("EXR", "a short block"))?;
            at += size;
            let start = (block.index.pixel_position.y() + y + dy) * window.width
                + block.index.pixel_position.x()
                + dx;
            let target = &mut image.channels[first_channel + k].samples[start..start + width];
            match channel.sample_type {
                SampleType::F16 => {
                    for (sample, raw) in target.iter_mut().zip(line.chunks_exact(2)) {
                        *sample = f16::from_ne_bytes([raw[0], raw[1]]).to_f32();
                    }
                }
                SampleType::F32 => {
                    for (sample, raw) in target.iter_mut().zip(line.chunks_exact(4)) {
                        *sample = f32::from_ne_bytes([raw[0], raw[1], raw[2], raw[3]]);
                    }
                }
                SampleType::U32 => {
                    for (sample, raw) in target.iter_mut().zip(line.chunks_exact(4)) {
                        *sample = u32::from_ne_bytes([raw[0], raw[1], raw[2], raw[3]]) as f32;
                    }
                }
            }
        }
    }
    Ok(())
}

fn damaged(error: exr::error::Error) -> ImageError {
    match error {
        exr::error::Error::NotSupported(feature) => {
            ImageError::unsupported("EXR", feature.trim_end_matches(" not supported yet"))
        }
        exr::error::Error::Io(_) => ImageError::damaged("EXR", "it ends before what its headers promise"),
        error => ImageError::damaged("EXR", error),
    }
}
