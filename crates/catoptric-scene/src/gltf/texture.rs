//! Textures that materials use: images decoded under limits, samplers, KHR_texture_transform.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::panic::{AssertUnwindSafe, catch_unwind};

use glam::Vec2;

use crate::id::TextureId;
use crate::texture::{Texture, TextureRef, TextureTransform, Wrap};

use super::accessor::view_bytes;
use super::asset::Asset;
use super::document::{Entity, Table};
use super::options::LoadOptions;
use super::report::Report;

/// Decodes what is referred to, once per image and sampler.
pub(super) struct TextureReader<'a> {
    asset: &'a Asset,
    report: &'a Report,
    pub(super) textures: Vec<Texture>,
    known: BTreeMap<(usize, Option<usize>), Option<TextureId>>,
    pixels_left: u64,
}

impl<'a> TextureReader<'a> {
    pub(super) fn new(asset: &'a Asset, options: &LoadOptions, report: &'a Report) -> Self {
        Self {
            asset,
            report,
            textures: Vec::new(),
            known: BTreeMap::new(),
            pixels_left: options.max_texture_pixels,
        }
    }

    /// The texture that a `textureInfo` of `owner` under `key` refers to.
    pub(super) fn reference(&mut self, owner: &Entity<'a>, key: &str) -> Option<TextureRef> {
        let report = self.report;
        let info = owner.object(key, report)?;
        if info.raw("index").is_none() {
            report.problem(owner.place(), format!("{key}: a texture index"), "none", "");
        }
        let (_, texture) = self.asset.root().follow(&info, "index", Table::TEXTURES, report)?;
        let texture = self.load(&texture)?;

        let mut set = info.index("texCoord", report).unwrap_or(0);
        let mut transform = TextureTransform::IDENTITY;
        if let Some(extension) = info.extension("KHR_texture_transform", report) {
            transform = read_transform(&extension, report);
            set = extension.index("texCoord", report).unwrap_or(set);
        }
        if set > 1 {
            report.warn(
                owner.place(),
                format!("{key} uses TEXCOORD_{set}; only sets 0 and 1 are read, 1 is used"),
            );
            set = 1;
        }
        Some(TextureRef { texture, uv_set: set as u8, transform })
    }

    fn load(&mut self, texture: &Entity<'a>) -> Option<TextureId> {
        let report = self.report;
        if texture.raw("source").is_none() {
            report.warn(texture.place(), "has no PNG or JPEG image and is ignored (convert others to PNG)");
            return None;
        }
        let (source, _) = self.asset.root().follow(texture, "source", Table::IMAGES, report)?;
        let sampler = match texture.raw("sampler") {
            None => None,
            Some(_) => Some(self.asset.root().follow(texture, "sampler", Table::SAMPLERS, report)?.0),
        };
        if let Some(known) = self.known.get(&(source, sampler)) {
            return *known;
        }
        let id = self.decode(source, sampler);
        self.known.insert((source, sampler), id);
        id
    }

    fn decode(&mut self, source: usize, sampler: Option<usize>) -> Option<TextureId> {
        let report = self.report;
        let image = self.asset.root().element(Table::IMAGES, source, report)?;
        if let Some(broken) = self.asset.broken_images.get(&source) {
            report.problem(image.place(), &broken.expected, &broken.found, &broken.hint);
            return None;
        }
        let sampler = match sampler {
            None => None,
            Some(index) => Some(self.asset.root().element(Table::SAMPLERS, index, report)?),
        };
        let wrap = |key: &str| {
            let mode = sampler.as_ref().and_then(|sampler| sampler.index(key, report)).unwrap_or(10497);
            match mode {
                33071 => Wrap::ClampToEdge,
                33648 => Wrap::MirroredRepeat,
                10497 => Wrap::Repeat,
                other => {
                    report.warn(image.place(), format!("its sampler's {key} {other} is unknown; it repeats"));
                    Wrap::Repeat
                }
            }
        };
        let (wrap_u, wrap_v) = (wrap("wrapS"), wrap("wrapT"));
        let filter = sampler.as_ref().and_then(|sampler| sampler.index("magFilter", report));

        // An image that another sampler has already decoded is copied.
        let same = self.known.range((source, None)..).next().filter(|((other, _), _)| *other == source);
        let pixels = match same.and_then(|(_, id)| *id).and_then(|id| self.textures.get(id.index())) {
            Some(texture) => (texture.width, texture.height, texture.texels.clone()),
            None => {
                let Some(view) = image.index("bufferView", report) else {
                    report.problem(image.place(), "a uri or a bufferView", "neither", "");
                    return None;
                };
                let bytes = view_bytes(self.asset, view, &|| image.place().to_string(), report)?;
                match decode_image(bytes, self.pixels_left) {
                    Ok(pixels) => pixels,
                    Err(found) => {
                        let hint = "convert the image to PNG or JPEG, or make it smaller";
                        let expected = format!("a PNG or JPEG image of at most {} pixels", self.pixels_left);
                        report.problem(image.place(), expected, found, hint);
                        return None;
                    }
                }
            }
        };
        let (width, height, texels) = pixels;
        let Some(left) = self.pixels_left.checked_sub(texels.len() as u64) else {
            report.problem(image.place(), "textures within the limit of texels", "more", "make them smaller");
            return None;
        };
        self.pixels_left = left;
        let id = TextureId(self.textures.len() as u32);
        self.textures.push(Texture {
            name: image.display_name(),
            width,
            height,
            texels,
            wrap_u,
            wrap_v,
            linear_filter: filter != Some(9728),
        });
        Some(id)
    }
}

type Pixels = (u32, u32, Vec<[u8; 4]>);

/// Decodes PNG or JPEG of at most `most` pixels. A decoder that panics is an error like any other.
fn decode_image(bytes: &[u8], most: u64) -> Result<Pixels, String> {
    let format = image::guess_format(bytes).map_err(|_| "another format".to_owned())?;
    if !matches!(format, image::ImageFormat::Png | image::ImageFormat::Jpeg) {
        return Err(format!("{format:?}"));
    }
    let reader = || image::ImageReader::with_format(Cursor::new(bytes), format);
    let decode = || {
        let (width, height) = reader().into_dimensions().map_err(|error| error.to_string())?;
        let pixels = u64::from(width) * u64::from(height);
        if pixels > most || pixels == 0 {
            return Err(format!("{width}×{height} pixels"));
        }
        // 16-bit RGBA and its 8-bit copy, with room for the decoder.
        let mut limits = image::Limits::default();
        limits.max_alloc = Some(pixels * 32 + (64 << 20));
        let mut reader = reader();
        reader.limits(limits);
        let image = reader.decode().map_err(|error| error.to_string())?.to_rgba8();
        let texels = image.pixels().map(|pixel| pixel.0).collect();
        Ok((image.width(), image.height(), texels))
    };
    catch_unwind(AssertUnwindSafe(decode))
        .unwrap_or_else(|_| Err("an image that its decoder cannot take".to_owned()))
}

/// KHR_texture_transform: translation · rotation · scale, the rotation counter-clockwise with v down.
fn read_transform(extension: &Entity<'_>, report: &Report) -> TextureTransform {
    let pair = |key: &str, default: Vec2| {
        let numbers = extension.numbers::<2>(key, report);
        numbers.map_or(default, |[x, y]| Vec2::new(x as f32, y as f32))
    };
    let offset = pair("offset", Vec2::ZERO);
    let scale = pair("scale", Vec2::ONE);
    let (sin, cos) = libm::sincosf(extension.number_or("rotation", 0.0, report));
    TextureTransform { x: Vec2::new(cos, -sin) * scale.x, y: Vec2::new(sin, cos) * scale.y, offset }
}
