//! Typed look-ups in the JSON of a file: each knows where it is and reports what is wrong there.

use std::fmt;

use serde_json::{Map, Value};

use super::report::Report;

/// An object of the JSON with its place: an element of a top-level table, or something inside of it.
#[derive(Clone, Copy)]
pub(super) struct Entity<'a> {
    value: &'a Map<String, Value>,
    place: Place<'a>,
}

/// `node 3 "lamp"`.
#[derive(Clone, Copy)]
pub(super) struct Place<'a> {
    kind: &'static str,
    index: Option<usize>,
    name: Option<&'a str>,
}

impl fmt::Display for Place<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.kind)?;
        if let Some(index) = self.index {
            write!(f, " {index}")?;
        }
        if let Some(name) = self.name {
            write!(f, " {name:?}")?;
        }
        Ok(())
    }
}

/// The top-level tables: JSON key and what one element is called.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) struct Table {
    key: &'static str,
    kind: &'static str,
}

impl Table {
    /// The key of the table in the JSON.
    pub(super) fn key(self) -> &'static str {
        self.key
    }

    pub(super) const ACCESSORS: Self = Self { key: "accessors", kind: "accessor" };
    pub(super) const ANIMATIONS: Self = Self { key: "animations", kind: "animation" };
    pub(super) const BUFFERS: Self = Self { key: "buffers", kind: "buffer" };
    pub(super) const BUFFER_VIEWS: Self = Self { key: "bufferViews", kind: "bufferView" };
    pub(super) const CAMERAS: Self = Self { key: "cameras", kind: "camera" };
    pub(super) const IMAGES: Self = Self { key: "images", kind: "image" };
    pub(super) const MATERIALS: Self = Self { key: "materials", kind: "material" };
    pub(super) const MESHES: Self = Self { key: "meshes", kind: "mesh" };
    pub(super) const NODES: Self = Self { key: "nodes", kind: "node" };
    pub(super) const SAMPLERS: Self = Self { key: "samplers", kind: "sampler" };
    pub(super) const SCENES: Self = Self { key: "scenes", kind: "scene" };
    pub(super) const SKINS: Self = Self { key: "skins", kind: "skin" };
    pub(super) const TEXTURES: Self = Self { key: "textures", kind: "texture" };
}

impl<'a> Entity<'a> {
    /// The root object of a file.
    pub(super) fn root(value: &'a Map<String, Value>) -> Self {
        Self { value, place: Place { kind: "file", index: None, name: None } }
    }

    /// Where this is.
    pub(super) fn place(&self) -> Place<'a> {
        self.place
    }

    /// Its name, if it has one that is not empty.
    pub(super) fn name(&self) -> Option<&'a str> {
        self.value.get("name").and_then(Value::as_str).filter(|name| !name.is_empty())
    }

    /// Its name, or `node 3`.
    pub(super) fn display_name(&self) -> String {
        self.name().map_or_else(
            || Place { name: None, ..self.place }.to_string(),
            // Control characters and line breaks would break lists and messages.
            |name| name.chars().map(|c| if c.is_control() { ' ' } else { c }).collect(),
        )
    }

    /// Number of elements of a top-level table.
    pub(super) fn table_len(&self, table: Table) -> usize {
        self.value.get(table.key).and_then(Value::as_array).map_or(0, Vec::len)
    }

    /// Element `index` of a top-level table of this root; reports a reference that leads nowhere.
    pub(super) fn element(&self, table: Table, index: usize, report: &Report) -> Option<Self> {
        let elements = match self.value.get(table.key) {
            Some(Value::Array(elements)) => elements.as_slice(),
            Some(other) => {
                report.problem(self.place, format!("an array `{}`", table.key), kind_of(other), "");
                return None;
            }
            None => &[],
        };
        let place = Place { kind: table.kind, index: Some(index), name: None };
        match elements.get(index) {
            Some(Value::Object(value)) => {
                let name = value.get("name").and_then(Value::as_str);
                Some(Self { value, place: Place { name, ..place } })
            }
            Some(other) => {
                report.problem(place, "an object", kind_of(other), "");
                None
            }
            None => {
                let found = format!("a reference to {place}, but the file has {}", elements.len());
                report.problem(self.place, format!("an existing {}", table.kind), found, "");
                None
            }
        }
    }

    /// What the index under `key` of `from` refers to in a top-level table of this root. A reference that
    /// leads nowhere is reported where it stands.
    pub(super) fn follow(
        &self,
        from: &Entity<'_>,
        key: &str,
        table: Table,
        report: &Report,
    ) -> Option<(usize, Self)> {
        let index = from.index(key, report)?;
        let count = self.table_len(table);
        if index >= count {
            let found = format!("{} {index} of {count}", table.kind);
            report.problem(from.place, format!("{key}: an existing {}", table.kind), found, "");
            return None;
        }
        Some((index, self.element(table, index, report)?))
    }

    /// The value of a key, whatever it is; null counts as absent.
    pub(super) fn raw(&self, key: &str) -> Option<&'a Value> {
        self.value.get(key).filter(|value| !value.is_null())
    }

    fn wrong(&self, key: &str, expected: &str, found: &Value, report: &Report) {
        report.problem(self.place, format!("{key}: {expected}"), kind_of(found), "");
    }

    /// A number, finite as f32.
    pub(super) fn number(&self, key: &str, report: &Report) -> Option<f32> {
        let value = self.raw(key)?;
        let number = value.as_f64().map(|number| number as f32).filter(|number| number.is_finite());
        if number.is_none() {
            self.wrong(key, "a finite number", value, report);
        }
        number
    }

    /// A number or its default.
    pub(super) fn number_or(&self, key: &str, default: f32, report: &Report) -> f32 {
        self.number(key, report).unwrap_or(default)
    }

    /// A number in [low, high]; others are brought there with a warning.
    pub(super) fn number_within(&self, key: &str, default: f32, low: f32, high: f32, report: &Report) -> f32 {
        let number = self.number_or(key, default, report);
        let clamped = number.clamp(low, high);
        if clamped != number {
            report.warn(self.place, format!("{key} {number} is outside of its range; {clamped} is used"));
        }
        clamped
    }

    /// An index or count: an integer ≥ 0, also if written as 3.0.
    pub(super) fn index(&self, key: &str, report: &Report) -> Option<usize> {
        let value = self.raw(key)?;
        let index = as_index(value);
        if index.is_none() {
            self.wrong(key, "an integer of at least 0", value, report);
        }
        index
    }

    /// A string.
    pub(super) fn string(&self, key: &str, report: &Report) -> Option<&'a str> {
        let value = self.raw(key)?;
        let string = value.as_str();
        if string.is_none() {
            self.wrong(key, "a string", value, report);
        }
        string
    }

    /// A Boolean, false if absent.
    pub(super) fn flag(&self, key: &str, report: &Report) -> bool {
        match self.raw(key) {
            None => false,
            Some(Value::Bool(flag)) => *flag,
            Some(other) => {
                self.wrong(key, "true or false", other, report);
                false
            }
        }
    }

    /// Exactly N finite numbers.
    pub(super) fn numbers<const N: usize>(&self, key: &str, report: &Report) -> Option<[f64; N]> {
        let value = self.raw(key)?;
        let read = || {
            let elements = value.as_array().filter(|elements| elements.len() == N)?;
            let mut numbers = [0.0; N];
            for (number, element) in numbers.iter_mut().zip(elements) {
                *number = element.as_f64().filter(|x| (*x as f32).is_finite())?;
            }
            Some(numbers)
        };
        let numbers = read();
        if numbers.is_none() {
            self.wrong(key, &format!("{N} finite numbers"), value, report);
        }
        numbers
    }

    /// All numbers of an array, of any length.
    pub(super) fn number_list(&self, key: &str, report: &Report) -> Option<Vec<f32>> {
        let elements = self.array(key, report)?;
        let numbers: Option<Vec<f32>> = elements
            .iter()
            .map(|element| element.as_f64().map(|x| x as f32).filter(|x| x.is_finite()))
            .collect();
        if numbers.is_none() {
            report.problem(self.place, format!("{key}: finite numbers"), "something else", "");
        }
        numbers
    }

    /// An array.
    pub(super) fn array(&self, key: &str, report: &Report) -> Option<&'a [Value]> {
        match self.raw(key)? {
            Value::Array(elements) => Some(elements),
            other => {
                self.wrong(key, "an array", other, report);
                None
            }
        }
    }

    /// All indices of an array.
    pub(super) fn indices(&self, key: &str, report: &Report) -> Option<Vec<usize>> {
        let elements = self.array(key, report)?;
        let indices: Option<Vec<usize>> = elements.iter().map(as_index).collect();
        if indices.is_none() {
            report.problem(self.place, format!("{key}: integers of at least 0"), "something else", "");
        }
        indices
    }

    /// The elements of an array of objects, at this place.
    pub(super) fn objects(&self, key: &str, report: &Report) -> Vec<Self> {
        let elements = self.array(key, report).unwrap_or_default();
        elements
            .iter()
            .filter_map(|element| match element {
                Value::Object(value) => Some(Self { value, place: self.place }),
                other => {
                    self.wrong(key, "an array of objects", other, report);
                    None
                }
            })
            .collect()
    }

    /// An object inside of this one, at this place.
    pub(super) fn object(&self, key: &str, report: &Report) -> Option<Self> {
        match self.raw(key)? {
            Value::Object(value) => Some(Self { value, place: self.place }),
            other => {
                self.wrong(key, "an object", other, report);
                None
            }
        }
    }

    /// The keys of this object.
    pub(super) fn keys(&self) -> impl Iterator<Item = &'a str> {
        self.value.keys().map(String::as_str)
    }

    /// The object of an extension of this one.
    pub(super) fn extension(&self, name: &str, report: &Report) -> Option<Self> {
        self.object("extensions", report)?.object(name, report)
    }
}

/// An integer ≥ 0, also if it is written as a float.
pub(super) fn as_index(value: &Value) -> Option<usize> {
    if let Some(index) = value.as_u64() {
        return usize::try_from(index).ok();
    }
    let float = value.as_f64()?;
    // Above 2⁵³ floats skip integers.
    (float >= 0.0 && float.fract() == 0.0 && float <= 9_007_199_254_740_992.0).then_some(float as usize)
}

/// What a JSON value is, for messages.
pub(super) fn kind_of(value: &Value) -> String {
    match value {
        Value::Null => "null".to_owned(),
        Value::Bool(flag) => flag.to_string(),
        Value::Number(number) => number.to_string(),
        Value::String(text) => format!("the string {text:?}"),
        Value::Array(elements) if elements.len() <= 4 => Value::Array(elements.clone()).to_string(),
        Value::Array(elements) => format!("an array of {} elements", elements.len()),
        Value::Object(_) => "an object".to_owned(),
    }
}
