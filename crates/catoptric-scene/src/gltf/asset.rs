//! A file in memory: its JSON and all its bytes, self-contained.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::PathBuf;

use serde_json::{Map, Value};

use super::append::AppendError;
use super::document::{Entity, Table};

/// A glTF file with every buffer and image it names packed into one blob.
///
/// The source's own JSON is kept as it was, but for where bytes lie. What is added goes behind it
/// ([`Asset::append_f32`] and its siblings), so indices into the source stay valid.
#[derive(Clone, Debug)]
pub struct Asset {
    pub(super) json: Map<String, Value>,
    pub(super) blob: Vec<u8>,
    /// Buffer views whose bytes are not there, and why.
    pub(super) broken_views: BTreeMap<usize, BrokenData>,
    /// Images whose bytes are not there, and why.
    pub(super) broken_images: BTreeMap<usize, BrokenData>,
    /// Files beside the source that were read.
    pub(super) files: Vec<PathBuf>,
}

/// Why some bytes are missing: a problem only if they are used.
#[derive(Clone, Debug)]
pub(super) struct BrokenData {
    pub(super) expected: String,
    pub(super) found: String,
    pub(super) hint: String,
}

impl Asset {
    /// An asset with nothing in it.
    pub fn empty() -> Self {
        let mut json = Map::new();
        json.insert("asset".to_owned(), serde_json::json!({ "version": "2.0", "generator": "Catoptric" }));
        Self {
            json,
            blob: Vec::new(),
            broken_views: BTreeMap::new(),
            broken_images: BTreeMap::new(),
            files: Vec::new(),
        }
    }

    /// Canonical paths of the files beside the source that were read for it: buffers and images.
    pub fn files(&self) -> &[PathBuf] {
        &self.files
    }

    /// The file's JSON.
    pub fn json(&self) -> &Map<String, Value> {
        &self.json
    }

    /// A self-contained binary file.
    pub fn to_glb(&self) -> Result<Vec<u8>, AppendError> {
        let mut root = self.json.clone();
        if !self.blob.is_empty() {
            let length = Value::from(self.blob.len());
            match root.get_mut("buffers").and_then(Value::as_array_mut).and_then(|b| b.first_mut()) {
                Some(Value::Object(buffer)) => {
                    buffer.insert("byteLength".to_owned(), length);
                }
                _ => {
                    root.insert("buffers".to_owned(), serde_json::json!([{ "byteLength": length }]));
                }
            }
        }
        let json = serde_json::to_vec(&root).map_err(|error| AppendError::Write(error.to_string()))?;
        // The length of the whole file is a u32.
        let total = json.len() as u64 + self.blob.len() as u64 + 64;
        if total > u64::from(u32::MAX) {
            return Err(AppendError::TooLarge { bytes: total });
        }
        let glb = gltf::binary::Glb {
            header: gltf::binary::Header { magic: *b"glTF", version: 2, length: 0 },
            json: Cow::Owned(json),
            bin: (!self.blob.is_empty()).then_some(Cow::Borrowed(self.blob.as_slice())),
        };
        glb.to_vec().map_err(|error| AppendError::Write(error.to_string()))
    }

    /// The root of the JSON, for look-ups.
    pub(super) fn root(&self) -> Entity<'_> {
        Entity::root(&self.json)
    }

    /// Which part of the file is the source scene, if a solution was added to it.
    pub(super) fn source(&self) -> Option<Source> {
        let source = self.extras()?.get("source")?;
        let number = |key: &str| source.get(key).and_then(super::document::as_index);
        Some(Source { scene: number("scene")?, materials: number("materials")? })
    }

    /// The program's own object in `asset.extras`.
    pub(super) fn extras(&self) -> Option<&Map<String, Value>> {
        self.json.get("asset")?.get("extras")?.get("catoptric")?.as_object()
    }

    /// Number of elements of a table.
    pub(super) fn table_len(&self, table: Table) -> usize {
        self.root().table_len(table)
    }
}

/// What belongs to the source in a file with a solution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Source {
    /// Index of the scene.
    pub(super) scene: usize,
    /// Number of materials; those behind are display materials.
    pub(super) materials: usize,
}
