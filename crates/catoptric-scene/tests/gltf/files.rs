//! Whole files: other people's, written and read again, damaged at random, and with a solution in them.

use std::path::{Path, PathBuf};

use super::support::{Builder, fingerprint};
use catoptric_scene::gltf::{Asset, DisplayPrimitive, LoadOptions, Loaded, load, load_asset};
use serde_json::json;

fn data() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data")
}

/// The files and verdicts of `data/README.md`.
fn listed() -> Vec<(PathBuf, bool)> {
    let readme = std::fs::read_to_string(data().join("README.md")).unwrap();
    let rows = readme.lines().filter_map(|line| {
        let mut cells = line.strip_prefix("| ")?.split(" | ");
        let (file, verdict) = (cells.next()?, cells.next()?);
        matches!(verdict, "loaded" | "refused").then(|| (data().join(file), verdict == "loaded"))
    });
    rows.collect()
}

fn reload(asset: &Asset, like: &Path) -> Loaded {
    let folder = tempfile::tempdir().unwrap();
    // The scene is named by the file's stem.
    let path = folder.path().join(like.file_stem().unwrap()).with_extension("glb");
    std::fs::write(&path, asset.to_glb().unwrap()).unwrap();
    load(&path, &LoadOptions::default()).unwrap_or_else(|error| panic!("{error}"))
}

#[test]
fn every_listed_file_gets_its_verdict() {
    let files = listed();
    assert!(files.len() >= 50, "{} files are listed", files.len());
    for (path, expected) in files {
        let loaded = load(&path, &LoadOptions::default());
        let found = loaded.as_ref().map_or_else(|error| error.to_string(), |_| "loaded".to_owned());
        assert_eq!(loaded.is_ok(), expected, "{}: {found}", path.display());
    }
}

#[test]
fn interleaved_and_plain_buffers_give_the_same_triangles() {
    let corners = |name: &str| {
        let scene = load(&data().join("real").join(name), &LoadOptions::default()).unwrap().scene;
        let mut corners: Vec<String> = (0..scene.triangles().len() as u32)
            .map(|i| format!("{:?}", scene.corners(catoptric_scene::TriangleId(i))))
            .collect();
        corners.sort();
        corners
    };
    assert_eq!(corners("Box.glb"), corners("BoxInterleaved.glb"));
}

#[test]
fn a_scene_that_was_written_and_read_again_has_the_same_bits() {
    let mut compared = 0;
    for (path, loads) in listed() {
        if !loads {
            continue;
        }
        let first = load(&path, &LoadOptions::default()).unwrap();
        let second = reload(&first.asset, &path);
        assert_eq!(fingerprint(&first), fingerprint(&second), "{}", path.display());
        assert_eq!(first.scene.hash(), second.scene.hash());
        // Writing is a fixed point: nothing is added or lost the second time.
        assert!(first.asset.to_glb().unwrap() == second.asset.to_glb().unwrap(), "{}", path.display());
        compared += 1;
    }
    assert!(compared >= 30, "{compared} files");
}

/// Adds what a solver adds: a display mesh, baked materials, arrays, metadata and a scene.
fn add_solution(loaded: &Loaded) -> Asset {
    let mut asset = loaded.asset.clone();
    let vertices = loaded.scene.vertices();
    let positions: Vec<f32> = vertices.iter().flat_map(|vertex| vertex.position.to_array()).collect();
    let irradiance: Vec<f32> = (0..vertices.len() * 3).map(|i| 0.1 * i as f32).collect();
    let indices: Vec<u32> = loaded.scene.triangles().iter().flat_map(|triangle| triangle.vertices).collect();
    let position = asset.append_f32("POSITION", &positions, 3).unwrap();
    let light = asset.append_f32("_IRRADIANCE_DIRECT", &irradiance, 3).unwrap();
    let color = asset.append_colors_u8("COLOR_0", &vec![[10, 20, 30, 255]; vertices.len()]).unwrap();
    let index = asset.append_u32("indices", &indices).unwrap();
    let original =
        (!loaded.scene.materials().is_empty() && asset.json().contains_key("materials")).then_some(0);
    let material = asset.append_baked_material(original).unwrap();
    let attributes = vec![("POSITION", position), ("_IRRADIANCE_DIRECT", light), ("COLOR_0", color)];
    let mesh = asset.append_mesh(
        "display",
        &[DisplayPrimitive { attributes, indices: Some(index), material: Some(material) }],
    );
    let node = asset.append_node("display", mesh);
    let patches = asset.append_u32("patches", &[7, 8, 9]).unwrap();
    asset.name_array("irradiance", light);
    asset.name_array("patches", patches);
    asset.set_metadata(json!({ "scene_hash": loaded.scene.hash().to_string(), "quality": "draft" }));
    asset.append_scene("baked", &[node]);
    asset
}

#[test]
fn a_file_with_a_solution_still_gives_its_source_scene_and_gives_the_solution_back() {
    for name in
        ["cornell_bevy.glb", "TextureSettingsTest.glb", "TriangleWithoutIndices/TriangleWithoutIndices.gltf"]
    {
        let path = data().join("real").join(name);
        let source = load(&path, &LoadOptions::default()).unwrap();
        let asset = add_solution(&source);
        let written = reload(&asset, &path);
        assert_eq!(fingerprint(&source), fingerprint(&written), "{name}");
        let in_memory = load_asset(asset.clone(), &path, &LoadOptions::default()).unwrap();
        assert_eq!(fingerprint(&source), fingerprint(&in_memory), "{name}");

        // What a viewer opens is the baked scene.
        let json = written.asset.json();
        let shown = &json["scenes"][json["scene"].as_u64().unwrap() as usize];
        assert_eq!(shown["name"], "baked");
        let vertices = source.scene.vertices().len();
        let expected: Vec<f32> = (0..vertices * 3).map(|i| 0.1 * i as f32).collect();
        assert_eq!(written.asset.array_f32("irradiance"), Some(expected));
        assert_eq!(written.asset.array_u32("patches"), Some(vec![7, 8, 9]));
        assert_eq!(written.asset.array_f32("nothing"), None);
        assert_eq!(written.asset.metadata().unwrap()["scene_hash"], source.scene.hash().to_string());

        // Taking it out leaves a file without a solution, which can take another one.
        let mut bare = written.asset;
        bare.remove_solution();
        assert!(bare.metadata().is_none() && bare.array_u32("patches").is_none());
        assert_eq!(fingerprint(&source), fingerprint(&reload(&bare, &path)), "{name}");
    }
}

#[test]
fn a_baked_material_is_unlit_keeps_its_colour_and_remembers_its_original() {
    let mut builder = Builder::new();
    let pbr = json!({ "baseColorFactor": [0.5, 0.25, 0.125, 1], "roughnessFactor": 0.5 });
    let original = json!({ "name": "wall", "doubleSided": true, "pbrMetallicRoughness": pbr });
    let material = builder.push("materials", original.clone());
    builder.show_triangle("wall", Some(material));
    let mut asset = builder.load().asset;
    let baked = asset.append_baked_material(Some(0)).unwrap();
    let baked = &asset.json()["materials"][baked];
    assert_eq!(
        baked["pbrMetallicRoughness"]["baseColorFactor"],
        original["pbrMetallicRoughness"]["baseColorFactor"]
    );
    assert_eq!(baked["extensions"], json!({ "KHR_materials_unlit": {} }));
    assert_eq!(baked["extras"]["catoptric"]["original"], original);
    assert_eq!(asset.json()["extensionsUsed"], json!(["KHR_materials_unlit"]));
    assert!(asset.append_baked_material(Some(99)).is_err());
}

#[test]
fn arrays_that_cannot_be_written_are_refused() {
    let mut asset = Asset::empty();
    assert!(asset.append_f32("odd", &[1.0; 4], 3).is_err(), "4 values are no whole number of triples");
    assert!(asset.append_f32("wide", &[1.0; 5], 5).is_err(), "there is no VEC5");
    assert!(asset.append_f32("nan", &[f32::NAN], 1).is_err(), "JSON has no bounds for it");
    let accessor = asset.append_f32("good", &[3.0, -1.0, 2.0, 5.0], 2).unwrap();
    assert_eq!(asset.json()["accessors"][accessor]["min"], json!([2.0, -1.0]));
    assert_eq!(asset.json()["accessors"][accessor]["max"], json!([3.0, 5.0]));
}

/// SplitMix64 (Steele, Lea & Flood 2014): a fixed sequence per seed.
struct SplitMix(u64);

impl SplitMix {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    fn below(&mut self, end: usize) -> usize {
        (self.next() % end.max(1) as u64) as usize
    }
}

/// Changes some bytes: flips, numbers made large or negative, pieces cut out or repeated.
fn damage(bytes: &mut Vec<u8>, random: &mut SplitMix) {
    const NUMBERS: [&str; 9] =
        ["-1", "0", "4294967295", "18446744073709551615", "1e300", "1.5", "null", "[]", "\"x\""];
    for _ in 0..=random.below(3) {
        if bytes.is_empty() {
            return;
        }
        let at = random.below(bytes.len());
        match random.below(8) {
            0 => bytes[at] ^= 1 << random.below(8),
            1 => bytes[at] = random.next() as u8,
            2 => {
                let end = (at + random.below(64)).min(bytes.len());
                bytes.drain(at..end);
            }
            3 => {
                let end = (at + random.below(64)).min(bytes.len());
                let piece = bytes[at..end].to_vec();
                bytes.splice(at..at, piece);
            }
            // The next number in the text becomes a hostile one; a GLB's chunk lengths no longer fit then,
            // so the JSON of GLB files is damaged by the other kinds only.
            _ => {
                let Some(start) = (at..bytes.len()).find(|&i| bytes[i].is_ascii_digit()) else { continue };
                let end = (start..bytes.len()).find(|&i| !bytes[i].is_ascii_digit()).unwrap_or(bytes.len());
                let number = NUMBERS[random.below(NUMBERS.len())];
                if bytes.starts_with(b"glTF") {
                    let digits = number.bytes().cycle();
                    bytes[start..end].iter_mut().zip(digits).for_each(|(byte, digit)| *byte = digit);
                } else {
                    bytes.splice(start..end, number.bytes());
                }
            }
        }
    }
}

/// Loads damaged copies of all test files. `CATOPTRIC_FUZZ_ROUNDS=100000 cargo test --release -p
/// catoptric-scene --test gltf damaged -- --nocapture` runs for long.
#[test]
fn damaged_files_neither_panic_nor_hang_nor_take_memory() {
    let rounds = std::env::var("CATOPTRIC_FUZZ_ROUNDS").ok().and_then(|r| r.parse().ok()).unwrap_or(20);
    // Small limits: what a damaged count may cost is part of the promise.
    let options = LoadOptions {
        max_triangles: 100_000,
        max_texture_pixels: 1 << 20,
        max_file_bytes: 1 << 24,
        max_json_memory: 1 << 27,
        ..LoadOptions::default()
    };
    let (mut loaded, mut refused) = (0, 0);
    for (number, (path, _)) in listed().into_iter().enumerate() {
        // Damaged copies lie beside copies of the files that the original names.
        let folder = tempfile::tempdir().unwrap();
        for entry in std::fs::read_dir(path.parent().unwrap()).unwrap().flatten() {
            if entry.path().is_file() {
                std::fs::copy(entry.path(), folder.path().join(entry.file_name())).unwrap();
            }
        }
        let original = std::fs::read(&path).unwrap();
        let copy = folder.path().join(path.file_name().unwrap());
        std::fs::remove_file(&copy).unwrap();
        for round in 0..rounds {
            let mut random = SplitMix((number as u64) << 32 | round);
            let mut bytes = original.clone();
            damage(&mut bytes, &mut random);
            std::fs::write(&copy, &bytes).unwrap();
            let started = std::time::Instant::now();
            match load(&copy, &options) {
                Ok(result) => {
                    loaded += 1;
                    // What loads can be written.
                    assert!(result.asset.to_glb().is_ok());
                }
                Err(error) => {
                    refused += 1;
                    assert!(!error.problems.is_empty());
                }
            }
            let seconds = started.elapsed().as_secs_f32();
            assert!(seconds < 10.0, "{}, round {round}: {seconds} s", path.display());
        }
    }
    println!("{loaded} damaged files loaded, {refused} refused");
    assert!(loaded > 0 && refused > 0, "the damage must be neither always fatal nor never");
}
