//! Accessors: typed elements in the blob, dense, strided or sparse, floats or quantized integers.

use super::asset::Asset;
use super::document::{Entity, Table};
use super::report::Report;

/// Type of one component.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Component {
    I8,
    U8,
    I16,
    U16,
    U32,
    F32,
}

impl Component {
    pub(super) fn from_code(code: usize) -> Option<Self> {
        Some(match code {
            5120 => Self::I8,
            5121 => Self::U8,
            5122 => Self::I16,
            5123 => Self::U16,
            5125 => Self::U32,
            5126 => Self::F32,
            _ => return None,
        })
    }

    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::U32 | Self::F32 => 4,
        }
    }

    /// KHR_mesh_quantization: f = max(c / (2ᵇ⁻¹ − 1), −1) signed, c / (2ᵇ − 1) unsigned.
    fn read(self, bytes: &[u8], normalized: bool) -> f32 {
        let signed = |value: f32, max: f32| if normalized { (value / max).max(-1.0) } else { value };
        let unsigned = |value: f32, max: f32| if normalized { value / max } else { value };
        match (self, bytes) {
            (Self::I8, &[a, ..]) => signed(f32::from(a as i8), 127.0),
            (Self::U8, &[a, ..]) => unsigned(f32::from(a), 255.0),
            (Self::I16, &[a, b, ..]) => signed(f32::from(i16::from_le_bytes([a, b])), 32767.0),
            (Self::U16, &[a, b, ..]) => unsigned(f32::from(u16::from_le_bytes([a, b])), 65535.0),
            (Self::U32, &[a, b, c, d, ..]) => u32::from_le_bytes([a, b, c, d]) as f32,
            (Self::F32, &[a, b, c, d, ..]) => f32::from_le_bytes([a, b, c, d]),
            // Ranges are checked when an accessor is opened.
            _ => 0.0,
        }
    }

    fn read_u32(self, bytes: &[u8]) -> u32 {
        match (self, bytes) {
            (Self::U8, &[a, ..]) => u32::from(a),
            (Self::U16, &[a, b, ..]) => u32::from(u16::from_le_bytes([a, b])),
            (Self::U32, &[a, b, c, d, ..]) => u32::from_le_bytes([a, b, c, d]),
            _ => 0,
        }
    }
}

/// Elements at a fixed distance from each other.
#[derive(Clone, Copy, Debug)]
struct Strided<'a> {
    /// From the first element to the end of the view.
    bytes: &'a [u8],
    stride: usize,
}

impl<'a> Strided<'a> {
    fn element(&self, index: usize) -> &'a [u8] {
        self.bytes.get(index * self.stride..).unwrap_or_default()
    }
}

/// Elements that replace those of the base.
#[derive(Clone, Debug)]
struct Sparse<'a> {
    /// Ascending.
    indices: Vec<u32>,
    values: Strided<'a>,
}

/// An opened accessor: all its elements are known to lie inside of the blob.
#[derive(Clone, Debug)]
pub(super) struct Accessor<'a> {
    pub(super) count: usize,
    pub(super) components: usize,
    pub(super) component: Component,
    normalized: bool,
    /// None: zeros.
    base: Option<Strided<'a>>,
    sparse: Option<Sparse<'a>>,
}

impl<'a> Accessor<'a> {
    /// Opens accessor `index` for `purpose` ("POSITION of mesh 3"), with one of the given numbers of
    /// components. None if it cannot be read, which has then been reported.
    pub(super) fn open(
        asset: &'a Asset,
        index: usize,
        components: &[usize],
        purpose: &dyn std::fmt::Display,
        report: &Report,
    ) -> Option<Self> {
        let entity = asset.root().element(Table::ACCESSORS, index, report)?;
        let place = || format!("{} ({purpose})", entity.place());
        let fail = |expected: &str, found: String| {
            report.problem(place(), expected, found, "");
            None
        };
        let code = entity.index("componentType", report).unwrap_or(0);
        let Some(component) = Component::from_code(code) else {
            return fail("a componentType of 5120 … 5126", code.to_string());
        };
        let kind = entity.string("type", report).unwrap_or("nothing");
        let width = match kind {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" | "MAT2" => 4,
            "MAT3" => 9,
            "MAT4" => 16,
            other => return fail("a type like VEC3", other.to_owned()),
        };
        if !components.contains(&width) || (width > 4 && component != Component::F32) {
            return fail(&format!("{components:?} components"), format!("{kind} of type {code}"));
        }
        let Some(count) = entity.index("count", report) else {
            return fail("a count", "none".to_owned());
        };
        let size = width * component.size();
        let offset = entity.index("byteOffset", report).unwrap_or(0);
        let base = match entity.index("bufferView", report) {
            None => None,
            Some(view) => Some(strided(asset, view, offset, count, size, &place, report)?),
        };
        let sparse = match entity.object("sparse", report) {
            None => None,
            Some(sparse) => Some(open_sparse(asset, &sparse, count, size, &place, report)?),
        };
        let normalized = entity.flag("normalized", report) && component != Component::F32;
        Some(Self { count, components: width, component, normalized, base, sparse })
    }

    /// Whether no byte stands behind it: all zeros.
    pub(super) fn is_empty_shell(&self) -> bool {
        self.base.is_none() && self.sparse.is_none()
    }

    /// Whether no byte stands behind element `index`: it is zero.
    pub(super) fn is_absent(&self, index: usize) -> bool {
        self.base.is_none()
            && self
                .sparse
                .as_ref()
                .is_none_or(|sparse| sparse.indices.binary_search(&(index as u32)).is_err())
    }

    /// Bytes of element `index`; none where it is all zeros.
    fn bytes(&self, index: usize) -> &'a [u8] {
        if let Some(sparse) = &self.sparse
            && let Ok(at) = sparse.indices.binary_search(&(index as u32))
        {
            return sparse.values.element(at);
        }
        self.base.map_or(&[], |base| base.element(index))
    }

    /// The first N components of element `index` (of fewer: zeros behind).
    pub(super) fn get<const N: usize>(&self, index: usize) -> [f32; N] {
        let bytes = self.bytes(index);
        let size = self.component.size();
        std::array::from_fn(|c| {
            if c >= self.components {
                return 0.0;
            }
            self.component.read(bytes.get(c * size..).unwrap_or_default(), self.normalized)
        })
    }

    /// Element `index` as integers, for indices and joints.
    pub(super) fn get_u32<const N: usize>(&self, index: usize) -> [u32; N] {
        let bytes = self.bytes(index);
        let size = self.component.size();
        std::array::from_fn(|c| {
            if c >= self.components {
                return 0;
            }
            self.component.read_u32(bytes.get(c * size..).unwrap_or_default())
        })
    }

    /// Integers read as shares of their largest value, whether the file says `normalized` or not: colours
    /// and weights have no other meaning.
    pub(super) fn into_shares(self) -> Self {
        Self { normalized: self.component != Component::F32, ..self }
    }

    /// Whether its elements are unsigned integers.
    pub(super) fn is_unsigned(&self) -> bool {
        matches!(self.component, Component::U8 | Component::U16 | Component::U32)
    }
}

/// The bytes of a buffer view.
pub(super) fn view_bytes<'a>(
    asset: &'a Asset,
    view: usize,
    place: &dyn Fn() -> String,
    report: &Report,
) -> Option<&'a [u8]> {
    if let Some(broken) = asset.broken_views.get(&view) {
        report.problem(
            format!("bufferView {view} of {}", place()),
            &broken.expected,
            &broken.found,
            &broken.hint,
        );
        return None;
    }
    let entity = asset.root().element(Table::BUFFER_VIEWS, view, report)?;
    let offset = entity.index("byteOffset", report).unwrap_or(0);
    let length = entity.index("byteLength", report)?;
    let bytes = asset.blob.get(offset..).and_then(|rest| rest.get(..length));
    if bytes.is_none() {
        let found = format!("{length} bytes at {offset} of {}", asset.blob.len());
        report.problem(entity.place(), "a range inside of the buffer", found, "");
    }
    bytes
}

fn strided<'a>(
    asset: &'a Asset,
    view: usize,
    offset: usize,
    count: usize,
    size: usize,
    place: &dyn Fn() -> String,
    report: &Report,
) -> Option<Strided<'a>> {
    let bytes = view_bytes(asset, view, place, report)?;
    let entity = asset.root().element(Table::BUFFER_VIEWS, view, report)?;
    let stride = entity.index("byteStride", report).filter(|stride| *stride > 0).unwrap_or(size);
    // The last element must end inside of the view.
    let end = count
        .saturating_sub(1)
        .checked_mul(stride)
        .and_then(|last| last.checked_add(if count == 0 { 0 } else { size })?.checked_add(offset));
    if end.is_none_or(|end| end > bytes.len()) || stride < size {
        let expected = format!("{count} elements of {size} bytes inside of bufferView {view}");
        let found = format!("offset {offset}, stride {stride} in {} bytes", bytes.len());
        report.problem(place(), expected, found, "the file is damaged: export it again");
        return None;
    }
    Some(Strided { bytes: bytes.get(offset..)?, stride })
}

fn open_sparse<'a>(
    asset: &'a Asset,
    sparse: &Entity<'a>,
    count: usize,
    size: usize,
    place: &dyn Fn() -> String,
    report: &Report,
) -> Option<Sparse<'a>> {
    let missing = || report.problem(place(), "sparse with count, indices and values", "some are missing", "");
    let (Some(number), Some(indices), Some(values)) =
        (sparse.index("count", report), sparse.object("indices", report), sparse.object("values", report))
    else {
        missing();
        return None;
    };
    let component = indices.index("componentType", report).and_then(Component::from_code);
    let component = component.filter(|c| matches!(c, Component::U8 | Component::U16 | Component::U32));
    let (Some(component), Some(index_view), Some(value_view)) =
        (component, indices.index("bufferView", report), values.index("bufferView", report))
    else {
        missing();
        return None;
    };
    let offset = indices.index("byteOffset", report).unwrap_or(0);
    let index_bytes = strided(asset, index_view, offset, number, component.size(), place, report)?;
    let offset = values.index("byteOffset", report).unwrap_or(0);
    let values = strided(asset, value_view, offset, number, size, place, report)?;
    let indices: Vec<u32> = (0..number).map(|i| component.read_u32(index_bytes.element(i))).collect();
    let ascending = indices.windows(2).all(|pair| pair[0] < pair[1]);
    if !ascending || indices.last().is_some_and(|&last| last as usize >= count) {
        report.problem(place(), format!("ascending sparse indices below {count}"), "others", "");
        return None;
    }
    Some(Sparse { indices, values })
}
