//! Adding to a file without touching what is in it: display meshes, named arrays, a new default scene.
//!
//! A file with a solution keeps the source scene as a scene that is not the default one. `asset.extras.catoptric`
//! says which it is, names the arrays that were added, and holds the solution's metadata:
//!
//! ```json
//! { "source": { "scene": 0, "materials": 7, … }, "arrays": { "patch_radiosity": 41 }, "metadata": { … } }
//! ```

use glam::{DVec3, Vec3};
use serde_json::{Map, Value, json};

use super::accessor::Accessor;
use super::asset::Asset;
use super::document::{Table, as_index};
use super::report::Report;

/// Why something could not be added or written.
#[derive(Debug, thiserror::Error)]
pub enum AppendError {
    /// The binary format counts bytes in 32 bits.
    #[error("the file would have {bytes} bytes, but a GLB file has at most 4 GiB")]
    TooLarge {
        /// Bytes of the file.
        bytes: u64,
    },
    /// An array cannot be cut into elements.
    #[error("array {name:?}: {length} values are not a whole number of elements of {components} components")]
    Shape {
        /// Name of the array.
        name: String,
        /// Number of values.
        length: usize,
        /// Components asked for.
        components: usize,
    },
    /// A value that JSON cannot hold.
    #[error("array {name:?} has a value that is not finite")]
    NotFinite {
        /// Name of the array.
        name: String,
    },
    /// A reference that leads nowhere.
    #[error("the file has no {what} {index}")]
    Missing {
        /// What it should be.
        what: &'static str,
        /// Its index.
        index: usize,
    },
    /// The writer failed.
    #[error("cannot write the file: {0}")]
    Write(String),
}

/// The tables in which a solution adds elements that a scene can show.
const ADDED_TO: [Table; 7] = [
    Table::ACCESSORS,
    Table::BUFFER_VIEWS,
    Table::CAMERAS,
    Table::MATERIALS,
    Table::MESHES,
    Table::NODES,
    Table::SCENES,
];

/// One primitive of a display mesh: accessors by their index.
#[derive(Clone, Debug)]
pub struct DisplayPrimitive<'a> {
    /// Semantic (`POSITION`, `_IRRADIANCE_DIRECT`, …) and accessor.
    pub attributes: Vec<(&'a str, usize)>,
    /// Accessor of the indices of a triangle list.
    pub indices: Option<usize>,
    /// Material, an index into the file's materials.
    pub material: Option<usize>,
}

impl Asset {
    /// Adds floats in elements of 1 to 4 components as a named accessor with its bounds; returns its index.
    pub fn append_f32(
        &mut self,
        name: &str,
        values: &[f32],
        components: usize,
    ) -> Result<usize, AppendError> {
        let kind = element_type(name, values.len(), components)?;
        if !values.iter().all(|value| value.is_finite()) {
            return Err(AppendError::NotFinite { name: name.to_owned() });
        }
        let bound = |pick: fn(f32, f32) -> f32| -> Vec<f32> {
            let component = |c: usize| values.iter().skip(c).step_by(components).copied().reduce(pick);
            (0..components).filter_map(component).collect()
        };
        let view =
            self.append_bytes(values.iter().flat_map(|value| value.to_le_bytes()), values.len() * 4)?;
        let mut accessor = json!({
            "name": name, "bufferView": view, "componentType": 5126,
            "count": values.len() / components, "type": kind,
        });
        if !values.is_empty() {
            accessor["min"] = json!(bound(f32::min));
            accessor["max"] = json!(bound(f32::max));
        }
        Ok(self.push("accessors", accessor))
    }

    /// Adds integers as a named scalar accessor; returns its index.
    pub fn append_u32(&mut self, name: &str, values: &[u32]) -> Result<usize, AppendError> {
        let view =
            self.append_bytes(values.iter().flat_map(|value| value.to_le_bytes()), values.len() * 4)?;
        let mut accessor = json!({
            "name": name, "bufferView": view, "componentType": 5125, "count": values.len(), "type": "SCALAR",
        });
        if let (Some(min), Some(max)) = (values.iter().min(), values.iter().max()) {
            accessor["min"] = json!([min]);
            accessor["max"] = json!([max]);
        }
        Ok(self.push("accessors", accessor))
    }

    /// Adds RGBA colours in 8-bit shares, as `COLOR_0` wants them; returns the accessor's index.
    pub fn append_colors_u8(&mut self, name: &str, colors: &[[u8; 4]]) -> Result<usize, AppendError> {
        let view = self.append_bytes(colors.iter().flatten().copied(), colors.len() * 4)?;
        Ok(self.push(
            "accessors",
            json!({
                "name": name, "bufferView": view, "componentType": 5121, "normalized": true,
                "count": colors.len(), "type": "VEC4",
            }),
        ))
    }

    /// Adds a mesh of triangle lists; returns its index.
    pub fn append_mesh(&mut self, name: &str, primitives: &[DisplayPrimitive<'_>]) -> usize {
        let primitives: Vec<Value> = primitives
            .iter()
            .map(|primitive| {
                let attributes: Map<String, Value> = primitive
                    .attributes
                    .iter()
                    .map(|&(name, index)| (name.to_owned(), json!(index)))
                    .collect();
                let mut object = json!({ "attributes": attributes });
                if let Some(indices) = primitive.indices {
                    object["indices"] = json!(indices);
                }
                if let Some(material) = primitive.material {
                    object["material"] = json!(material);
                }
                object
            })
            .collect();
        self.push("meshes", json!({ "name": name, "primitives": primitives }))
    }

    /// Adds a material as it is and declares its extensions; returns its index.
    pub fn append_material(&mut self, material: Value) -> usize {
        self.mark_source();
        let extensions = material.get("extensions").and_then(Value::as_object);
        for name in extensions.into_iter().flat_map(Map::keys) {
            self.use_extension(name);
        }
        self.push("materials", material)
    }

    /// Adds a copy of material `original` (None: of glTF's default one) that any viewer shows as baked: unlit,
    /// with the same base colour, so that it multiplies the light in `COLOR_0`. The original goes to `extras`. It is
    /// single-sided: the sides of a sheet are two display faces at one place.
    pub fn append_baked_material(&mut self, original: Option<usize>) -> Result<usize, AppendError> {
        self.mark_source();
        let source = match original {
            None => json!({}),
            Some(index) => self
                .json
                .get("materials")
                .and_then(|materials| materials.get(index))
                .ok_or(AppendError::Missing { what: "material", index })?
                .clone(),
        };
        let mut baked = Map::new();
        for key in ["name", "alphaMode", "alphaCutoff"] {
            if let Some(value) = source.get(key) {
                baked.insert(key.to_owned(), value.clone());
            }
        }
        let mut pbr = Map::new();
        let gloss = source.get("extensions").and_then(|e| e.get("KHR_materials_pbrSpecularGlossiness"));
        let (from, keys) = match gloss {
            Some(gloss) => (Some(gloss), ["diffuseFactor", "diffuseTexture"]),
            None => (source.get("pbrMetallicRoughness"), ["baseColorFactor", "baseColorTexture"]),
        };
        for (key, to) in keys.into_iter().zip(["baseColorFactor", "baseColorTexture"]) {
            if let Some(value) = from.and_then(|from| from.get(key)) {
                pbr.insert(to.to_owned(), value.clone());
            }
        }
        pbr.insert("metallicFactor".to_owned(), json!(0.0));
        baked.insert("pbrMetallicRoughness".to_owned(), Value::Object(pbr));
        baked.insert("extensions".to_owned(), json!({ "KHR_materials_unlit": {} }));
        baked.insert("extras".to_owned(), json!({ "catoptric": { "original": source, "index": original } }));
        self.use_extension("KHR_materials_unlit");
        Ok(self.push("materials", Value::Object(baked)))
    }

    /// Adds a node that shows a mesh; returns its index.
    pub fn append_node(&mut self, name: &str, mesh: usize) -> usize {
        self.mark_source();
        self.push("nodes", json!({ "name": name, "mesh": mesh }))
    }

    /// Adds a node that moves others by an offset, metres; returns its index.
    pub fn append_group(&mut self, name: &str, nodes: &[usize], offset: DVec3) -> usize {
        self.mark_source();
        self.push("nodes", json!({ "name": name, "children": nodes, "translation": offset.to_array() }))
    }

    /// Adds a scene and makes it the one that viewers show. The scene that was shown before is remembered as
    /// the source: [`load`](super::load) keeps reading that one.
    pub fn append_scene(&mut self, name: &str, nodes: &[usize]) -> usize {
        self.mark_source();
        let scene = self.push("scenes", json!({ "name": name, "nodes": nodes }));
        self.json.insert("scene".to_owned(), json!(scene));
        scene
    }

    /// Gives an accessor a name under which [`Asset::array_f32`] finds it.
    pub fn name_array(&mut self, name: &str, accessor: usize) {
        let extras = self.extras_mut();
        let arrays = extras.entry("arrays").or_insert_with(|| json!({}));
        if let Some(arrays) = arrays.as_object_mut() {
            arrays.insert(name.to_owned(), json!(accessor));
        }
    }

    /// The values of a named array of floats, elements one behind the other.
    pub fn array_f32(&self, name: &str) -> Option<Vec<f32>> {
        let accessor = self.open_array(name)?;
        let mut values = Vec::with_capacity(accessor.count * accessor.components);
        for index in 0..accessor.count {
            values.extend_from_slice(&accessor.get::<4>(index)[..accessor.components]);
        }
        Some(values)
    }

    /// The values of a named array of vectors.
    pub fn array_vec3(&self, name: &str) -> Option<Vec<Vec3>> {
        let accessor = self.open_array(name).filter(|accessor| accessor.components == 3)?;
        Some((0..accessor.count).map(|index| Vec3::from(accessor.get::<3>(index))).collect())
    }

    /// The values of a named array of integers.
    pub fn array_u32(&self, name: &str) -> Option<Vec<u32>> {
        let accessor = self.open_array(name).filter(|accessor| accessor.is_unsigned())?;
        Some((0..accessor.count).map(|index| accessor.get_u32::<1>(index)[0]).collect())
    }

    /// Takes out what was added: the file shows its source again.
    pub fn remove_solution(&mut self) {
        let Some(source) = self.extras().and_then(|extras| extras.get("source")).cloned() else { return };
        for table in ADDED_TO {
            let count = source.get("tables").and_then(|tables| tables.get(table.key())).and_then(as_index);
            if let (Some(count), Some(Value::Array(elements))) = (count, self.json.get_mut(table.key())) {
                elements.truncate(count);
                if elements.is_empty() {
                    self.json.remove(table.key());
                }
            }
        }
        self.truncate_lights(source.get("lights").and_then(as_index).unwrap_or(0));
        // The bytes that were added lie behind those of the source.
        let report = Report::new(std::path::Path::new(""));
        let views = 0..self.table_len(Table::BUFFER_VIEWS);
        let end = views.filter_map(|index| {
            let view = self.root().element(Table::BUFFER_VIEWS, index, &report)?;
            Some(view.index("byteOffset", &report).unwrap_or(0) + view.index("byteLength", &report)?)
        });
        let end = end.max().unwrap_or(0);
        self.blob.truncate(end);
        if self.blob.is_empty() {
            self.json.shift_remove("buffers");
        }
        match source.get("shown").filter(|shown| !shown.is_null()) {
            Some(shown) => self.json.insert("scene".to_owned(), shown.clone()),
            None => self.json.shift_remove("scene"),
        };
        for key in ["source", "metadata", "arrays"] {
            self.extras_mut().shift_remove(key);
        }
    }

    /// Replaces the solution's metadata: anything that JSON can hold.
    pub fn set_metadata(&mut self, metadata: Value) {
        self.extras_mut().insert("metadata".to_owned(), metadata);
    }

    /// The solution's metadata, if the file has a solution.
    pub fn metadata(&self) -> Option<&Value> {
        self.extras()?.get("metadata")
    }

    fn open_array(&self, name: &str) -> Option<Accessor<'_>> {
        let index = as_index(self.extras()?.get("arrays")?.get(name)?)?;
        // Damage reads as absence: the caller says what it needs.
        let report = Report::new(std::path::Path::new(""));
        let accessor = Accessor::open(self, index, &[1, 2, 3, 4], &name, &report)?;
        (!accessor.is_empty_shell()).then_some(accessor)
    }

    /// Adds an element to a top-level table; returns its index.
    pub(super) fn push(&mut self, table: &str, element: Value) -> usize {
        let entry = self.json.entry(table).or_insert_with(|| Value::Array(Vec::new()));
        if !entry.is_array() {
            *entry = Value::Array(Vec::new());
        }
        match entry.as_array_mut() {
            Some(elements) => {
                elements.push(element);
                elements.len() - 1
            }
            None => 0,
        }
    }

    /// Adds bytes behind the blob; returns the index of their view.
    fn append_bytes(&mut self, bytes: impl Iterator<Item = u8>, length: usize) -> Result<usize, AppendError> {
        self.mark_source();
        // Views have at least one byte, start at and are followed by multiples of four.
        let start = self.blob.len().next_multiple_of(4);
        let end = (start as u64 + length.max(1) as u64).next_multiple_of(4);
        if end > u64::from(u32::MAX) {
            return Err(AppendError::TooLarge { bytes: end });
        }
        self.blob.reserve(end as usize - self.blob.len());
        self.blob.resize(start, 0);
        self.blob.extend(bytes);
        self.blob.resize(end as usize, 0);
        if !self.json.contains_key("buffers") {
            self.json.insert("buffers".to_owned(), json!([{ "byteLength": length }]));
        }
        Ok(self.push("bufferViews", json!({ "buffer": 0, "byteOffset": start, "byteLength": length.max(1) })))
    }

    pub(super) fn use_extension(&mut self, name: &str) {
        let used = self.json.get("extensionsUsed").and_then(Value::as_array);
        if !used.is_some_and(|used| used.iter().any(|other| other == name)) {
            self.push("extensionsUsed", json!(name));
        }
    }

    /// Remembers what belongs to the source, before anything is added that a scene could show.
    pub(super) fn mark_source(&mut self) {
        if self.source().is_some() {
            return;
        }
        let shown = self.json.get("scene").cloned();
        let tables: Map<String, Value> =
            ADDED_TO.iter().map(|table| (table.key().to_owned(), json!(self.table_len(*table)))).collect();
        let scene = match shown.as_ref().and_then(as_index) {
            Some(scene) => scene,
            None if self.table_len(Table::SCENES) > 0 => 0,
            None => {
                let roots = super::node::parentless(self, self.table_len(Table::NODES));
                self.push("scenes", if roots.is_empty() { json!({}) } else { json!({ "nodes": roots }) })
            }
        };
        let materials = self.table_len(Table::MATERIALS);
        let source = json!({
            "scene": scene, "materials": materials, "shown": shown, "tables": tables,
            "lights": self.lights_len(),
        });
        self.extras_mut().insert("source".to_owned(), source);
    }

    fn extras_mut(&mut self) -> &mut Map<String, Value> {
        let mut at = &mut self.json;
        for key in ["asset", "extras", "catoptric"] {
            let entry = at.entry(key).or_insert_with(|| Value::Object(Map::new()));
            if !entry.is_object() {
                *entry = Value::Object(Map::new());
            }
            at = match entry {
                Value::Object(object) => object,
                _ => unreachable!("made an object above"),
            };
        }
        at
    }
}

/// The accessor type of elements of `components` components.
fn element_type(name: &str, length: usize, components: usize) -> Result<&'static str, AppendError> {
    match components {
        1..=4 if length.is_multiple_of(components) => Ok(["SCALAR", "VEC2", "VEC3", "VEC4"][components - 1]),
        _ => Err(AppendError::Shape { name: name.to_owned(), length, components }),
    }
}
