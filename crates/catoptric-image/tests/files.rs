//! The readers and writers on whole files: round trips, hostile input, limits.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use catoptric_image::{Encoding, Image, ImageError, ReadLimits, srgb, tone, write_png8};

fn data(folder: &str) -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(folder);
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)
        .expect("the folder is in the repository")
        .map(|e| e.expect("readable").path())
        .collect();
    files.sort();
    files
}

fn gradient(width: usize, height: usize) -> Vec<[f32; 3]> {
    (0..width * height)
        .map(|i| [i as f32 * 0.25 - 3.0, 1.0 / (1 + i) as f32, (i % width) as f32 * 1e4])
        .collect()
}

#[test]
fn an_exr_comes_back_bit_for_bit_with_its_layers_and_attributes() {
    let mut image = Image::from_rgb(37, 21, &gradient(37, 21));
    image.push_rgb_layer("direct", &vec![[f32::NAN, f32::INFINITY, -0.0]; 37 * 21]);
    image.push_channel("depth.Z", vec![7.5; 37 * 21]);
    image.attributes.insert("scene".into(), "häuschen.glb".into());
    image.attributes.insert("seed".into(), "17".into());
    let bytes = image.encode_exr().unwrap();
    let back = Image::decode(&bytes, &ReadLimits::default()).unwrap();
    assert_eq!((back.width, back.height, back.encoding), (37, 21, Encoding::Linear));
    assert_eq!(back.attributes, image.attributes);
    assert_eq!(back.layers(), ["", "direct"]);
    for channel in &image.channels {
        let bits = |s: &[f32]| s.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(back.channel(&channel.name).unwrap()), bits(&channel.samples), "{}", channel.name);
    }
}

#[test]
fn the_same_image_gives_the_same_file_whatever_the_order_and_the_threads() {
    let mut one = Image::from_rgb(64, 100, &gradient(64, 100));
    let mut other = Image::new(64, 100);
    one.push_channel("id", vec![3.0; 6400]);
    other.push_channel("id", vec![3.0; 6400]);
    other.push_rgb_layer("", &gradient(64, 100));
    for k in 0..20 {
        one.attributes.insert(format!("key{k}"), k.to_string());
        other.attributes.insert(format!("key{}", 19 - k), (19 - k).to_string());
    }
    assert_eq!(one.encode_exr().unwrap(), other.encode_exr().unwrap());
}

#[test]
fn what_openexr_cannot_hold_is_refused() {
    let mut twice = Image::from_rgb(2, 2, &[[0.0; 3]; 4]);
    twice.push_channel("R", vec![0.0; 4]);
    assert!(matches!(twice.encode_exr(), Err(ImageError::Inconsistent(_))));
    assert!(matches!(Image::new(2, 2).encode_exr(), Err(ImageError::Inconsistent(_))));
    assert!(matches!(Image::new(0, 0).encode_exr(), Err(ImageError::Inconsistent(_))));
}

#[test]
fn pfm_keeps_rows_and_floats() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("picture.exr"); // the name lies: content decides
    let image = Image::from_rgb(5, 3, &gradient(5, 3));
    image.write_pfm(&path).unwrap();
    let back = Image::read(&path, &ReadLimits::default()).unwrap();
    assert_eq!(back.rgb(""), image.rgb(""));
}

/// A flat image of one code: 128 is a half, and the exponent 129 doubles it.
#[test]
fn exposure_and_colour_correction_of_radiance_hdr_are_divided_out() {
    let read = |header: &str| {
        let text = format!("{header}FORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 1\n");
        let bytes = [text.as_bytes(), &[128, 128, 128, 129]].concat();
        Image::decode(&bytes, &ReadLimits::default()).map(|image| image.rgb("").expect("colour")[0])
    };
    let plain = read("#?RADIANCE\n").expect("read");
    assert_eq!(read("#?RGBE\n").expect("read"), plain);
    assert_eq!(read("#?RADIANCE\nEXPOSURE=2\nEXPOSURE=4\n").expect("read"), plain.map(|v| v / 8.0));
    let corrected = read("#?RADIANCE\nCOLORCORR=1 2 4\n").expect("read");
    assert_eq!(corrected, [plain[0], plain[1] / 2.0, plain[2] / 4.0]);
    assert!(read("#?RADIANCE\nEXPOSURE=0\n").is_err());
}

#[test]
fn radiance_hdr_is_read() {
    let mut bytes = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\n".to_vec();
    bytes.extend([128, 64, 32, 129, 128, 128, 128, 136]);
    let image = Image::decode(&bytes, &ReadLimits::default()).unwrap();
    assert_eq!(image.rgb("").unwrap(), [[1.0, 0.5, 0.25], [128.0, 128.0, 128.0]]);
}

#[test]
fn a_png_comes_back_through_linear_light_with_every_code() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("codes.png");
    let codes: Vec<[u8; 3]> = (0..=255).map(|c| [c, 255 - c, 128]).collect();
    write_png8(&path, 16, 16, &codes).unwrap();
    let image = Image::read(&path, &ReadLimits::default()).unwrap();
    assert_eq!(image.encoding, Encoding::Srgb);
    assert_eq!(tone::to_srgb8(&image.rgb("").unwrap(), image.width, &tone::ToneMap::default()), codes);
    assert!((srgb::decode(188.0 / 255.0) - 0.502_886).abs() < 1e-5);
}

#[test]
fn sixteen_bit_codes_are_decoded_at_full_precision() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/valid/basn2c16.png");
    let image = Image::read(&path, &ReadLimits::default()).unwrap();
    let distinct: std::collections::BTreeSet<u32> =
        image.channel("R").unwrap().iter().map(|v| v.to_bits()).collect();
    assert_eq!((image.width, image.height), (32, 32));
    assert_eq!(image.channel("R").unwrap()[0], 1.0);
    assert!(distinct.len() >= 32);
}

#[test]
fn a_single_channel_is_a_grey_picture() {
    let mut image = Image::new(2, 1);
    image.push_channel("Y", vec![0.25, 4.0]);
    image.push_channel("depth.Z", vec![1.0, 2.0]);
    assert_eq!(image.layers(), [""]);
    assert_eq!(image.rgb("").unwrap(), [[0.25; 3], [4.0; 3]]);
    assert_eq!(image.rgb("depth.Z").unwrap(), [[1.0; 3], [2.0; 3]]);
    assert_eq!(image.rgb("missing"), None);
}

#[test]
fn valid_files_decode() {
    for path in data("valid") {
        let image = Image::read(&path, &ReadLimits::default()).unwrap_or_else(|e| panic!("{e}"));
        assert!(image.rgb("").is_some_and(|p| p.len() == image.width * image.height), "{path:?}");
    }
}

#[test]
fn invalid_files_are_refused_quickly_and_by_name() {
    for path in data("invalid") {
        let start = Instant::now();
        let error = Image::read(&path, &ReadLimits::default()).expect_err(&format!("{path:?}"));
        assert!(start.elapsed() < Duration::from_secs(2), "{path:?} took {:?}", start.elapsed());
        let text = error.to_string();
        assert!(text.starts_with(path.to_str().unwrap()) && !text.contains('\n'), "{text}");
    }
}

#[test]
fn every_truncation_of_a_small_exr_is_an_error() {
    let bytes = Image::from_rgb(9, 40, &gradient(9, 40)).encode_exr().unwrap();
    for length in 0..bytes.len() {
        assert!(
            Image::decode(&bytes[..length], &ReadLimits::default()).is_err(),
            "{length} of {}",
            bytes.len()
        );
    }
}

#[test]
fn limits_hold_before_memory_is_taken() {
    let tight = ReadLimits { max_pixels: 100, max_channels: 2, max_bytes: 1 << 20 };
    let exr = Image::from_rgb(9, 40, &gradient(9, 40)).encode_exr().unwrap();
    assert!(matches!(Image::decode(&exr, &tight), Err(ImageError::TooLarge { what: "pixel count", .. })));
    let small = Image::from_rgb(9, 4, &gradient(9, 4)).encode_exr().unwrap();
    assert!(matches!(Image::decode(&small, &tight), Err(ImageError::TooLarge { what: "channel count", .. })));
    let pfm = b"PF\n4000000000 4000000000\n-1.0\n";
    assert!(matches!(Image::decode(pfm, &ReadLimits::default()), Err(ImageError::TooLarge { .. })));
    let hdr = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 100000 +X 100000\n";
    assert!(matches!(Image::decode(hdr, &ReadLimits::default()), Err(ImageError::TooLarge { .. })));
}

#[test]
fn auto_exposure_brings_the_95th_percentile_to_nine_tenths() {
    let pixels: Vec<[f32; 3]> = (0..=100).map(|i| [i as f32 * 0.1; 3]).collect();
    // 100 lit pixels 0.1, 0.2 … 10: rank 94.05 of them is 9.505.
    assert!((tone::auto_exposure(pixels.iter().copied()) - (0.9f32 / 9.505).log2()).abs() < 1e-5);
    assert_eq!(tone::auto_exposure([[0.0; 3]; 4]), 0.0);
}
