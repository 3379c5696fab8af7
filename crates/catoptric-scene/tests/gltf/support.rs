//! Builds small glTF files for the tests.

use std::path::{Path, PathBuf};

use catoptric_scene::gltf::{LoadError, LoadOptions, Loaded, load};
use serde_json::{Map, Value, json};

/// A file in the making: JSON, and one buffer that is written beside it.
pub(crate) struct Builder {
    pub(crate) json: Map<String, Value>,
    pub(crate) bytes: Vec<u8>,
}

impl Builder {
    pub(crate) fn new() -> Self {
        let json = json!({ "asset": { "version": "2.0" } });
        Self { json: json.as_object().unwrap().clone(), bytes: Vec::new() }
    }

    pub(crate) fn push(&mut self, table: &str, element: Value) -> usize {
        let elements = self.json.entry(table).or_insert_with(|| json!([])).as_array_mut().unwrap();
        elements.push(element);
        elements.len() - 1
    }

    pub(crate) fn view(&mut self, bytes: &[u8], stride: Option<usize>) -> usize {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        let start = self.bytes.len();
        self.bytes.extend_from_slice(bytes);
        let mut view = json!({ "buffer": 0, "byteOffset": start, "byteLength": bytes.len() });
        if let Some(stride) = stride {
            view["byteStride"] = json!(stride);
        }
        self.push("bufferViews", view)
    }

    pub(crate) fn accessor(
        &mut self,
        bytes: &[u8],
        component: u32,
        kind: &str,
        count: usize,
        normalized: bool,
    ) -> usize {
        let view = self.view(bytes, None);
        self.push(
            "accessors",
            json!({ "bufferView": view, "componentType": component, "type": kind, "count": count, "normalized": normalized }),
        )
    }

    pub(crate) fn floats(&mut self, values: &[f32], kind: &str) -> usize {
        let width = match kind {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" => 4,
            _ => 16,
        };
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.accessor(&bytes, 5126, kind, values.len() / width, false)
    }

    pub(crate) fn indices(&mut self, values: &[u32]) -> usize {
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.accessor(&bytes, 5125, "SCALAR", values.len(), false)
    }

    /// A node that shows one primitive.
    pub(crate) fn show(&mut self, name: &str, primitive: Value) -> usize {
        let mesh = self.push("meshes", json!({ "primitives": [primitive] }));
        self.push("nodes", json!({ "name": name, "mesh": mesh }))
    }

    /// A triangle in the plane z = 0 with the given material.
    pub(crate) fn show_triangle(&mut self, name: &str, material: Option<usize>) -> usize {
        let at = self.json.get("nodes").map_or(0, |nodes| nodes.as_array().unwrap().len()) as f32;
        let position = self.floats(&[at, 0.0, 0.0, at + 1.0, 0.0, 0.0, at, 1.0, 0.0], "VEC3");
        let mut primitive = json!({ "attributes": { "POSITION": position } });
        if let Some(material) = material {
            primitive["material"] = json!(material);
        }
        self.show(name, primitive)
    }

    /// Writes `scene.gltf` and `scene.bin` to a folder.
    /// Moves a node 8 m along x within two seconds.
    pub(crate) fn slide(&mut self, node: usize) {
        let input = self.floats(&[0.0, 2.0], "SCALAR");
        let output = self.floats(&[0.0, 0.0, 0.0, 8.0, 0.0, 0.0], "VEC3");
        self.push(
            "animations",
            json!({ "samplers": [{ "input": input, "output": output }],
            "channels": [{ "sampler": 0, "target": { "node": node, "path": "translation" } }] }),
        );
    }

    pub(crate) fn write(mut self, folder: &Path) -> PathBuf {
        if !self.bytes.is_empty() {
            self.push("buffers", json!({ "uri": "scene.bin", "byteLength": self.bytes.len() }));
            std::fs::write(folder.join("scene.bin"), &self.bytes).unwrap();
        }
        let path = folder.join("scene.gltf");
        std::fs::write(&path, serde_json::to_vec(&self.json).unwrap()).unwrap();
        path
    }

    pub(crate) fn try_load(self) -> Result<Loaded, LoadError> {
        let folder = tempfile::tempdir().unwrap();
        load(&self.write(folder.path()), &LoadOptions::default())
    }

    pub(crate) fn load(self) -> Loaded {
        self.try_load().unwrap_or_else(|error| panic!("{error}"))
    }
}

/// Everything in a scene, bit for bit: floats print in their shortest form that reads back the same.
pub(crate) fn fingerprint(loaded: &Loaded) -> String {
    format!("{:?}", loaded.scene.clone().into_parts())
}

/// A closed box from −`half` to `half`, corners shared; inside out if `inverted`.
pub(crate) fn box_mesh(builder: &mut Builder, half: f32, inverted: bool) -> (usize, usize) {
    let corners: Vec<f32> =
        (0..8).flat_map(|i| [0, 1, 2].map(|axis| if i >> axis & 1 == 1 { half } else { -half })).collect();
    let mut indices: Vec<u32> = vec![
        0, 2, 1, 1, 2, 3, 4, 5, 6, 5, 7, 6, 0, 1, 4, 1, 5, 4, 2, 6, 3, 3, 6, 7, 0, 4, 2, 2, 4, 6, 1, 3, 5, 3,
        7, 5,
    ];
    if inverted {
        indices.chunks_mut(3).for_each(|triangle| triangle.swap(1, 2));
    }
    (builder.floats(&corners, "VEC3"), builder.indices(&indices))
}
