//! Textures: bilinear look-ups with glTF wrap modes and `KHR_texture_transform`.

use glam::{Vec2, Vec4};

use crate::id::TextureId;

/// What happens outside of `[0, 1]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wrap {
    /// The border texel goes on.
    ClampToEdge,
    /// The image repeats, every second time mirrored.
    MirroredRepeat,
    /// The image repeats.
    Repeat,
}

/// A decoded image with its sampler.
#[derive(Clone, Debug)]
pub struct Texture {
    /// Name for messages.
    pub name: String,
    /// Texels in a row.
    pub width: u32,
    /// Rows, the first at v = 0 (glTF: top).
    pub height: u32,
    /// Row-major RGBA, as coded in the file (8 bit; 16-bit files are rounded).
    pub texels: Vec<[u8; 4]>,
    /// Wrap mode along u.
    pub wrap_u: Wrap,
    /// Wrap mode along v.
    pub wrap_v: Wrap,
    /// False: the nearest texel is taken.
    pub linear_filter: bool,
}

/// `KHR_texture_transform`: uv' = translate · rotate · scale · uv.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TextureTransform {
    /// Columns of the 2×2 part and the translation: uv' = x·u + y·v + offset.
    pub x: Vec2,
    /// Image of the v axis.
    pub y: Vec2,
    /// Translation.
    pub offset: Vec2,
}

impl TextureTransform {
    /// No change.
    pub const IDENTITY: Self = Self { x: Vec2::X, y: Vec2::Y, offset: Vec2::ZERO };

    /// The transformed coordinates.
    #[inline]
    pub fn apply(&self, uv: Vec2) -> Vec2 {
        self.x * uv.x + self.y * uv.y + self.offset
    }
}

/// A use of a texture by a material: which image, which coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TextureRef {
    /// The image.
    pub texture: TextureId,
    /// Coordinate set: 0 or 1.
    pub uv_set: u8,
    /// Transform of the coordinates.
    pub transform: TextureTransform,
}

/// How the colour channels of a texel are coded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Coding {
    /// Colours: the sRGB transfer function.
    Srgb,
    /// Data: factors, normals.
    Linear,
}

impl Wrap {
    /// Index of a texel along an axis of `size` texels.
    #[inline]
    fn texel(self, index: i64, size: i64) -> usize {
        let wrapped = match self {
            Wrap::ClampToEdge => index.clamp(0, size - 1),
            Wrap::Repeat => index.rem_euclid(size),
            Wrap::MirroredRepeat => {
                let period = index.rem_euclid(2 * size);
                if period < size { period } else { 2 * size - 1 - period }
            }
        };
        wrapped as usize
    }
}

impl Texture {
    /// Looks up `uv`: colours to linear light if `coding` says so, alpha always linear.
    pub fn sample(&self, uv: Vec2, coding: Coding) -> Vec4 {
        if !uv.is_finite() {
            return Vec4::ONE;
        }
        let (width, height) = (i64::from(self.width), i64::from(self.height));
        let texel = |x: i64, y: i64| {
            let (x, y) = (self.wrap_u.texel(x, width), self.wrap_v.texel(y, height));
            decode(self.texels[y * self.width as usize + x], coding)
        };
        // Coordinates far outside lose their fraction anyway: keep the integer part in range.
        let position =
            (uv * Vec2::new(width as f32, height as f32)).clamp(Vec2::splat(-1e9), Vec2::splat(1e9));
        if !self.linear_filter {
            return texel(position.x.floor() as i64, position.y.floor() as i64);
        }
        let corner = (position - 0.5).floor();
        let weight = position - 0.5 - corner;
        let (x, y) = (corner.x as i64, corner.y as i64);
        let top = texel(x, y).lerp(texel(x + 1, y), weight.x);
        let bottom = texel(x, y + 1).lerp(texel(x + 1, y + 1), weight.x);
        top.lerp(bottom, weight.y)
    }
}

/// A texel in linear light, channels in `[0, 1]`.
#[inline]
fn decode(texel: [u8; 4], coding: Coding) -> Vec4 {
    let [r, g, b, a] = texel;
    let alpha = f32::from(a) / 255.0;
    match coding {
        Coding::Linear => Vec4::new(f32::from(r) / 255.0, f32::from(g) / 255.0, f32::from(b) / 255.0, alpha),
        Coding::Srgb => {
            let table = srgb_table();
            Vec4::new(table[usize::from(r)], table[usize::from(g)], table[usize::from(b)], alpha)
        }
    }
}

/// IEC 61966-2-1 transfer function of the 256 codes.
fn srgb_table() -> &'static [f32; 256] {
    static TABLE: std::sync::OnceLock<[f32; 256]> = std::sync::OnceLock::new();
    TABLE.get_or_init(|| {
        std::array::from_fn(|code| {
            let coded = code as f64 / 255.0;
            let linear =
                if coded <= 0.04045 { coded / 12.92 } else { libm::pow((coded + 0.055) / 1.055, 2.4) };
            linear as f32
        })
    })
}
