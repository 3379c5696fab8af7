//! The outer layer of a file: GLB chunks, JSON text, version.

use std::ops::Range;

use serde_json::{Map, Value};

use super::document::{Entity, kind_of};
use super::options::LoadOptions;
use super::report::Report;

const MAGIC: &[u8; 4] = b"glTF";
const JSON_CHUNK: u32 = 0x4E4F_534A;
const BIN_CHUNK: u32 = 0x004E_4942;
const TRUNCATED: &str = "the file is truncated or damaged: export or download it again";

/// JSON object and binary chunk.
pub(super) type Parsed = (Map<String, Value>, Option<Vec<u8>>);

/// JSON object and binary chunk of a file's bytes.
pub(super) fn parse(mut bytes: Vec<u8>, options: &LoadOptions, report: &Report) -> Option<Parsed> {
    let (json, bin) =
        if bytes.starts_with(MAGIC) { split_glb(&bytes, report)? } else { (0..bytes.len(), None) };
    let json = &bytes[json];

    // The parsed tree is many times larger than its text: estimate before it is built.
    let memory = estimate_memory(json);
    if memory > options.max_json_memory {
        let expected = format!("JSON that needs at most {} MiB of memory", options.max_json_memory >> 20);
        let hint = "merge or instance meshes in the authoring program, or raise the limit";
        report.problem("JSON", expected, format!("about {} MiB", memory >> 20), hint);
        return None;
    }
    let root = match serde_json::from_slice::<Value>(json) {
        Ok(Value::Object(root)) => root,
        Ok(other) => {
            report.problem("JSON", "a glTF object", kind_of(&other), "");
            return None;
        }
        Err(error) => {
            let hint = if json.is_empty() { "the file is empty" } else { "is this a .gltf or .glb file?" };
            report.problem("JSON", "glTF 2.0 JSON in UTF-8, or a binary GLB file", error, hint);
            return None;
        }
    };
    if !check_version(&root, report) {
        return None;
    }
    // Moved to the front of its own memory: a solution is large, and fresh memory is dearer than the copy.
    let bin = bin.map(|bin| {
        bytes.truncate(bin.end);
        bytes.drain(..bin.start);
        bytes
    });
    Some((root, bin))
}

/// Where the JSON and BIN chunks lie; others are skipped, as the specification asks.
fn split_glb(bytes: &[u8], report: &Report) -> Option<(Range<usize>, Option<Range<usize>>)> {
    let word = |at: usize| Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?));
    let (Some(version), Some(length)) = (word(4), word(8)) else {
        report.problem("GLB header", "12 bytes", format!("{} bytes", bytes.len()), TRUNCATED);
        return None;
    };
    if version != 2 {
        let hint = "convert the file to glTF 2.0 (gltf-transform, Blender)";
        report.problem("GLB header", "version 2", format!("version {version}"), hint);
        return None;
    }
    let length = length as usize;
    if length < 12 || length > bytes.len() {
        let found = format!("a length of {length} in a file of {} bytes", bytes.len());
        report.problem("GLB header", "the file's length", found, TRUNCATED);
        return None;
    }
    let (mut json, mut bin) = (None, None);
    let mut at = 12;
    while at < length {
        let (Some(size), Some(kind)) = (word(at), word(at + 4)) else {
            report.problem("GLB", "a chunk header of 8 bytes", "the end of the file", TRUNCATED);
            return None;
        };
        let chunk = at + 8..(at + 8).saturating_add(size as usize);
        if chunk.end > length {
            report.problem("GLB", format!("a chunk of {size} bytes"), "the end of the file", TRUNCATED);
            return None;
        }
        match (kind, json.is_some()) {
            (JSON_CHUNK, false) => json = Some(chunk),
            (_, false) => {
                report.problem("GLB", "the JSON chunk first", "another chunk", "");
                return None;
            }
            (BIN_CHUNK, true) if bin.is_none() => bin = Some(chunk),
            _ => report.warn("GLB", "a chunk that is repeated or of unknown kind was skipped"),
        }
        // Chunks are aligned to four bytes; the last one is often not.
        at += 8 + (size as usize).next_multiple_of(4);
    }
    if json.is_none() {
        report.problem("GLB", "a JSON chunk", "no chunk", TRUNCATED);
    }
    Some((json?, bin))
}

/// An upper estimate of the bytes that the parsed tree takes: a map entry with its key is dear.
fn estimate_memory(json: &[u8]) -> u64 {
    json.iter()
        .map(|byte| match byte {
            b'{' => 250,
            b':' => 150,
            b'[' => 120,
            b',' => 40,
            _ => 1,
        })
        .sum()
}

/// glTF 2.x with a minimum version of at most 2.0 … 2.1 (minor versions are compatible).
fn check_version(root: &Map<String, Value>, report: &Report) -> bool {
    let Some(asset) = Entity::root(root).object("asset", report) else {
        if !report.has_problems() {
            report.problem("file", "`asset.version`", "no `asset`", "is this a glTF 2.0 file?");
        }
        return false;
    };
    let Some(version) = asset.string("version", report) else {
        if !report.has_problems() {
            report.problem("asset", "version \"2.0\"", "no version", "is this a glTF 2.0 file?");
        }
        return false;
    };
    if version.split('.').next() != Some("2") {
        let hint = "convert the file to glTF 2.0 (for glTF 1.0: an old Blender, Cesium's gltf-pipeline)";
        report.problem("asset", "version \"2.0\"", format!("version {version:?}"), hint);
        return false;
    }
    if let Some(minimum) = asset.string("minVersion", report).filter(|minimum| *minimum != "2.0") {
        report.problem("asset", "minVersion \"2.0\"", format!("minVersion {minimum:?}"), "");
    }
    !report.has_problems()
}
