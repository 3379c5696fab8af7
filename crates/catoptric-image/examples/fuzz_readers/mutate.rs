//! A small deterministic mutation fuzzer for the readers: seeds, mutations, one execution.

use std::io::Cursor;
use std::path::Path;

use catoptric_image::{Image, ImageError, ReadLimits, encode_png8};
use exr::prelude::{Compression, Encoding, SpecificChannels, WritableImage};

/// SplitMix64 (Steele, Lea & Flood 2014).
pub(crate) struct Random(pub(crate) u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn below(&mut self, n: usize) -> usize {
        (self.next() % n.max(1) as u64) as usize
    }
}

/// What the reader did with one mutant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Outcome {
    /// It decoded.
    Decoded,
    /// It was refused.
    Refused,
    /// A decoder panicked and the panic was turned into an error.
    Caught,
}

/// Limits that keep an execution small.
pub(crate) const LIMITS: ReadLimits =
    ReadLimits { max_pixels: 1 << 16, max_channels: 16, max_bytes: 1 << 20 };

/// Small files of every format and compression: generated ones and the small ones of the test data.
pub(crate) fn seeds() -> Vec<Vec<u8>> {
    let pixel = |i: usize| [i as f32, 0.5, -1.0 / (1 + i) as f32];
    let pixels: Vec<[f32; 3]> = (0..13 * 11).map(pixel).collect();
    let mut image = Image::from_rgb(13, 11, &pixels);
    image.attributes.insert("note".into(), "seed".into());
    image.push_channel("depth.Z", vec![1.0; 13 * 11]);
    let mut seeds = vec![image.encode_exr().expect("a legal image")];

    // Every compression and both layouts, through the exr crate.
    use Compression::{B44, B44A, DWAA, DWAB, PIZ, PXR24, RLE, Uncompressed, ZIP1, ZIP16};
    for compression in [Uncompressed, RLE, ZIP1, ZIP16, PIZ, PXR24, B44, B44A, DWAA(None), DWAB(None)] {
        for blocks in [exr::image::Blocks::ScanLines, exr::image::Blocks::Tiles(exr::math::Vec2(8, 8))] {
            let channels = SpecificChannels::rgb(|at: exr::math::Vec2<usize>| {
                (at.0 as f32, exr::prelude::f16::from_f32(at.1 as f32), (at.0 ^ at.1) as u32)
            });
            let encoding = Encoding { compression, blocks, ..Encoding::UNCOMPRESSED };
            let layer = exr::image::Layer::new((13, 11), Default::default(), encoding, channels);
            let mut bytes = Cursor::new(Vec::new());
            if exr::image::Image::from_layer(layer).write().non_parallel().to_buffered(&mut bytes).is_ok() {
                seeds.push(bytes.into_inner());
            }
        }
    }
    seeds.push(encode_png8(7, 5, &[[10, 200, 30]; 35]).expect("a legal image"));
    let mut jpeg = Vec::new();
    let grey: Vec<u8> = (0..16 * 16 * 3).map(|i| i as u8).collect();
    image::codecs::jpeg::JpegEncoder::new(&mut jpeg)
        .encode(&grey, 16, 16, image::ExtendedColorType::Rgb8)
        .expect("a legal image");
    seeds.push(jpeg);
    seeds.push(
        [
            b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 9\n".as_slice(),
            &[2, 2, 0, 9, 137, 5, 137, 6, 137, 7, 137, 8],
        ]
        .concat(),
    );
    seeds.push([b"PF\n3 2\n-1.0\n".as_slice(), &[7; 72]].concat());

    for folder in ["valid", "invalid"] {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(folder);
        let mut paths: Vec<_> =
            std::fs::read_dir(folder).into_iter().flatten().flatten().map(|e| e.path()).collect();
        paths.sort();
        seeds.extend(paths.iter().filter_map(|p| std::fs::read(p).ok()).filter(|bytes| bytes.len() < 1500));
    }
    seeds
}

/// Makes a mutant of one seed and reads it.
pub(crate) fn execute(seeds: &[Vec<u8>], random: &mut Random) -> (Vec<u8>, Outcome) {
    let mut bytes = seeds[random.below(seeds.len())].clone();
    for _ in 0..=random.below(2) * random.below(5) {
        mutate(&mut bytes, seeds, random);
    }
    if bytes.starts_with(b"\x89PNG") && random.below(4) > 0 {
        repair_checksums(&mut bytes);
    }
    let outcome = match Image::decode(&bytes, &LIMITS) {
        Ok(_) => Outcome::Decoded,
        Err(ImageError::Damaged { reason, .. }) if reason == "its decoder gave up on it" => Outcome::Caught,
        Err(_) => Outcome::Refused,
    };
    (bytes, outcome)
}

fn mutate(bytes: &mut Vec<u8>, seeds: &[Vec<u8>], random: &mut Random) {
    if bytes.is_empty() {
        return;
    }
    // Half of the mutations hit the first 400 bytes, where headers are.
    let reach = if random.below(2) == 0 { bytes.len().min(400) } else { bytes.len() };
    let at = random.below(reach);
    match random.below(8) {
        0 => bytes[at] ^= 1 << random.below(8),
        1 => bytes[at] = random.next() as u8,
        2 => {
            const INTERESTING: [u32; 12] = [
                0,
                1,
                2,
                0x7f,
                0xff,
                0x7fff,
                0xffff,
                0x7fff_ffff,
                0x8000_0000,
                u32::MAX,
                0xffff_fff0,
                0x0100_0000,
            ];
            let value = INTERESTING[random.below(INTERESTING.len())];
            let value = if random.below(2) == 0 { value.to_le_bytes() } else { value.to_be_bytes() };
            for (target, source) in bytes[at..].iter_mut().zip(value) {
                *target = source;
            }
        }
        3 => bytes.truncate(at),
        4 => {
            let end = (at + 1 + random.below(16)).min(bytes.len());
            bytes.drain(at..end);
        }
        5 => {
            let end = (at + 1 + random.below(32)).min(bytes.len());
            let copy = bytes[at..end].to_vec();
            bytes.splice(at..at, copy);
        }
        6 => {
            let other = &seeds[random.below(seeds.len())];
            let from = random.below(other.len());
            let end = (from + 1 + random.below(64)).min(other.len());
            bytes.splice(at..at, other[from..end].iter().copied());
        }
        _ => bytes[at] = bytes[at].wrapping_add(if random.below(2) == 0 { 1 } else { 255 }),
    }
}

/// Gives every PNG chunk its right checksum, so that mutants get past the first check.
fn repair_checksums(bytes: &mut [u8]) {
    let mut at = 8;
    while at + 12 <= bytes.len() {
        let length = u32::from_be_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]) as usize;
        let Some(end) = at.checked_add(8 + length).filter(|end| end + 4 <= bytes.len()) else {
            return;
        };
        let mut crc = flate2::Crc::new();
        crc.update(&bytes[at + 4..end]);
        bytes[end..end + 4].copy_from_slice(&crc.sum().to_be_bytes());
        at = end + 4;
    }
}
