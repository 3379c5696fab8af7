//! From a file that names others to a self-contained [`Asset`].

use serde_json::{Map, Value};

use super::asset::{Asset, BrokenData};
use super::document::{Entity, Table};
use super::report::Report;
use super::uri::{Folder, UriProblem};

const MESHOPT: &str = "EXT_meshopt_compression";

impl From<UriProblem> for BrokenData {
    fn from(problem: UriProblem) -> Self {
        Self { expected: problem.expected.to_owned(), found: problem.found, hint: problem.hint.to_owned() }
    }
}

/// Where a buffer's bytes lie in the blob.
#[derive(Clone)]
enum Placed {
    At { start: usize, length: usize },
    Missing(BrokenData),
}

/// Reads every buffer and image that `json` names and rewrites it to one blob.
pub(super) fn embed(
    json: Map<String, Value>,
    bin: Option<Vec<u8>>,
    folder: &mut Folder,
    report: &Report,
) -> Asset {
    let mut asset = Asset { json, ..Asset::empty() };
    let placed = place_buffers(&mut asset, bin, folder, report);
    rewrite_views(&mut asset, &placed, report);
    embed_images(&mut asset, folder, report);
    asset.files = std::mem::take(&mut folder.files);

    // Chunks are padded to four bytes: with the padding in it the blob survives writing and reading.
    asset.blob.resize(asset.blob.len().next_multiple_of(4), 0);

    // One buffer is left; its length is written with the file.
    if asset.json.contains_key("buffers") || !asset.blob.is_empty() {
        let mut buffer = match asset.json.get_mut("buffers") {
            Some(Value::Array(buffers)) if buffers.len() == 1 => buffers.remove(0),
            _ => Value::Null,
        };
        match buffer.as_object_mut() {
            Some(object) => {
                object.remove("uri");
            }
            None => buffer = Value::Object(Map::new()),
        }
        if asset.blob.is_empty() {
            asset.json.remove("buffers");
        } else {
            buffer["byteLength"] = Value::from(asset.blob.len());
            asset.json.insert("buffers".to_owned(), Value::Array(vec![buffer]));
        }
    }
    asset
}

fn place_buffers(
    asset: &mut Asset,
    mut bin: Option<Vec<u8>>,
    folder: &mut Folder,
    report: &Report,
) -> Vec<Placed> {
    let mut placed = Vec::new();
    for index in 0..asset.table_len(Table::BUFFERS) {
        let Some(buffer) = asset.root().element(Table::BUFFERS, index, report) else {
            let missing = BrokenData {
                expected: "a buffer object".to_owned(),
                found: "something else".to_owned(),
                hint: String::new(),
            };
            placed.push(Placed::Missing(missing));
            continue;
        };
        let place = buffer.place().to_string();
        let declared = buffer.index("byteLength", report);
        let bytes = match buffer.string("uri", report) {
            Some(uri) => folder.read(uri).map(|(bytes, _)| bytes).map_err(BrokenData::from),
            None if index == 0 && bin.is_some() => Ok(bin.take().unwrap_or_default()),
            None => Err(BrokenData {
                expected: "a buffer with bytes".to_owned(),
                found: "neither a uri nor a binary chunk".to_owned(),
                hint: "the buffer may be a placeholder for compressed data: decompress the file with \
                       `gltf-transform copy in.glb out.glb`"
                    .to_owned(),
            }),
        };
        match bytes {
            Ok(bytes) => {
                if declared.is_some_and(|declared| declared > bytes.len()) {
                    let found = bytes.len();
                    report.warn(&place, format!("byteLength is larger than its {found} bytes of data"));
                }
                let start = append_aligned(&mut asset.blob, bytes);
                placed.push(Placed::At { start, length: asset.blob.len() - start });
            }
            Err(broken) => placed.push(Placed::Missing(broken)),
        }
    }
    placed
}

/// Puts `bytes` at the next multiple of four; the first buffer is moved, not copied.
fn append_aligned(blob: &mut Vec<u8>, bytes: Vec<u8>) -> usize {
    blob.resize(blob.len().next_multiple_of(4), 0);
    let start = blob.len();
    if blob.is_empty() {
        *blob = bytes;
    } else {
        blob.extend_from_slice(&bytes);
    }
    start
}

/// Points every buffer view into the blob; a view whose bytes are not there is emptied and remembered.
fn rewrite_views(asset: &mut Asset, placed: &[Placed], report: &Report) {
    for index in 0..asset.table_len(Table::BUFFER_VIEWS) {
        let location = asset.root().element(Table::BUFFER_VIEWS, index, report).map_or_else(
            || Err(broken("a bufferView object", "something else")),
            |view| locate(&view, placed, report),
        );
        let view = asset
            .json
            .get_mut("bufferViews")
            .and_then(Value::as_array_mut)
            .and_then(|views| views.get_mut(index))
            .and_then(Value::as_object_mut);
        let (start, length) = match location {
            Ok(range) => range,
            Err(broken) => {
                asset.broken_views.insert(index, broken);
                (0, asset.blob.len().min(1))
            }
        };
        let Some(view) = view else { continue };
        view.insert("buffer".to_owned(), Value::from(0));
        if start > 0 || view.contains_key("byteOffset") {
            view.insert("byteOffset".to_owned(), Value::from(start));
        }
        view.insert("byteLength".to_owned(), Value::from(length));
        if let Some(Value::Object(extensions)) = view.get_mut("extensions") {
            extensions.remove(MESHOPT);
            if extensions.is_empty() {
                view.remove("extensions");
            }
        }
    }
    if let Some(Value::Array(used)) = asset.json.get_mut("extensionsUsed") {
        used.retain(|name| name != MESHOPT);
        if used.is_empty() {
            asset.json.remove("extensionsUsed");
        }
    }
}

fn broken(expected: impl Into<String>, found: impl Into<String>) -> BrokenData {
    BrokenData { expected: expected.into(), found: found.into(), hint: String::new() }
}

/// Start and length of a view in the blob.
fn locate(view: &Entity<'_>, placed: &[Placed], report: &Report) -> Result<(usize, usize), BrokenData> {
    let buffer = view.index("buffer", report).ok_or_else(|| broken("a buffer", "none"))?;
    let offset = view.index("byteOffset", report).unwrap_or(0);
    let length = view.index("byteLength", report).ok_or_else(|| broken("a byteLength", "none"))?;
    match placed.get(buffer) {
        None => {
            Err(broken("an existing buffer", format!("a reference to buffer {buffer} of {}", placed.len())))
        }
        Some(Placed::Missing(broken)) => Err(broken.clone()),
        Some(&Placed::At { start, length: available }) => {
            let end = offset.checked_add(length).filter(|&end| end <= available);
            let found = || format!("{length} bytes at {offset}, but buffer {buffer} has {available} bytes");
            end.map(|_| (start + offset, length))
                .ok_or_else(|| broken("a range inside of the buffer", found()))
        }
    }
}

/// Moves the bytes of every image that has a uri into the blob.
fn embed_images(asset: &mut Asset, folder: &mut Folder, report: &Report) {
    for index in 0..asset.table_len(Table::IMAGES) {
        let Some(image) = asset.root().element(Table::IMAGES, index, report) else { continue };
        let Some(uri) = image.string("uri", report) else { continue };
        let declared = image.raw("mimeType").and_then(Value::as_str).map(str::to_owned);
        let place = image.place().to_string();
        let (bytes, media_type) = match folder.read(uri) {
            Ok(read) => read,
            Err(problem) => {
                report.warn(place, format!("cannot be read: {}", problem.found));
                asset.broken_images.insert(index, problem.into());
                (white_pixel(), None)
            }
        };
        let media_type = sniff(&bytes).map(str::to_owned).or(declared).or(media_type);
        let length = bytes.len();
        let start = append_aligned(&mut asset.blob, bytes);
        let view = asset.push(
            "bufferViews",
            serde_json::json!({ "buffer": 0, "byteOffset": start, "byteLength": length }),
        );
        let image = asset
            .json
            .get_mut("images")
            .and_then(Value::as_array_mut)
            .and_then(|images| images.get_mut(index))
            .and_then(Value::as_object_mut);
        let Some(image) = image else { continue };
        image.remove("uri");
        image.insert("bufferView".to_owned(), Value::from(view));
        if let Some(media_type) = media_type {
            image.insert("mimeType".to_owned(), Value::from(media_type));
        }
    }
}

/// The media type that the first bytes tell.
fn sniff(bytes: &[u8]) -> Option<&'static str> {
    match bytes {
        [0x89, b'P', b'N', b'G', ..] => Some("image/png"),
        [0xFF, 0xD8, 0xFF, ..] => Some("image/jpeg"),
        [b'R', b'I', b'F', b'F', _, _, _, _, b'W', b'E', b'B', b'P', ..] => Some("image/webp"),
        [0xAB, b'K', b'T', b'X', ..] => Some("image/ktx2"),
        _ => None,
    }
}

/// Stands in for an image that is not there, so that the file which is written is whole.
fn white_pixel() -> Vec<u8> {
    let mut png = std::io::Cursor::new(Vec::new());
    let pixel = image::RgbImage::from_pixel(1, 1, image::Rgb([255; 3]));
    // Writing one pixel to memory does not fail; if it did, an empty image would do.
    if pixel.write_to(&mut png, image::ImageFormat::Png).is_err() {
        return Vec::new();
    }
    png.into_inner()
}
