//! Values of options that are more than a number or a word.

use std::path::PathBuf;
use std::str::FromStr;

use catoptric_scene::BRIGHTEST;

/// Longest side of an image: above it a typing error is more likely than a wish.
const LARGEST_SIDE: usize = 65_536;
/// Most pixels of an image, as [`catoptric_image::ReadLimits`] reads them back.
const MOST_PIXELS: usize = 256 << 20;
/// Most frames of one run.
const MOST_FRAMES: u32 = 1_000_000;

/// `1280` or `1280x720`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Size {
    pub(crate) width: usize,
    /// `None`: by the camera's aspect.
    pub(crate) height: Option<usize>,
}

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let side = |text: &str| {
            let pixels = text.parse::<usize>().ok().filter(|n| (1..=LARGEST_SIDE).contains(n));
            pixels.ok_or_else(|| {
                format!(
                    "expected a width like 1280 or a size like 1280x720, each from 1 to {LARGEST_SIDE} pixels"
                )
            })
        };
        let size = match text.split_once(['x', 'X', '×']) {
            None => Self { width: side(text)?, height: None },
            Some((width, height)) => Self { width: side(width)?, height: Some(side(height)?) },
        };
        match size.height {
            Some(height) if size.width * height > MOST_PIXELS => {
                Err(format!("{} pixels are more than the limit of {MOST_PIXELS}", size.width * height))
            }
            _ => Ok(size),
        }
    }
}

impl Size {
    /// Columns and rows for a camera; an error where its aspect makes the image too large.
    pub(crate) fn pixels(&self, camera: &catoptric_scene::Camera) -> Result<(usize, usize), String> {
        let height = self.height.unwrap_or_else(|| camera.height_for_width(self.width));
        if height > LARGEST_SIDE || self.width.saturating_mul(height) > MOST_PIXELS {
            return Err(format!(
                "{}x{height} pixels, as the aspect of camera {:?} asks for, are too many",
                self.width, camera.name
            ));
        }
        Ok((self.width, height))
    }
}

/// `1..24`, both included, or a single frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Frames {
    pub(crate) first: u32,
    pub(crate) last: u32,
}

impl FromStr for Frames {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || "expected frames like 1..24, first and last included".to_owned();
        let frame = |text: &str| text.trim().parse::<u32>().map_err(|_| wrong());
        let (first, last) = match text.split_once("..") {
            None => (frame(text)?, frame(text)?),
            Some((first, last)) => (frame(first)?, frame(last.strip_prefix('=').unwrap_or(last))?),
        };
        if last < first {
            return Err(format!("the last frame {last} is before the first, {first}"));
        }
        if last - first >= MOST_FRAMES {
            let count = u64::from(last - first) + 1;
            return Err(format!("{count} frames are more than the limit of {MOST_FRAMES}"));
        }
        Ok(Self { first, last })
    }
}

/// Which cameras.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum CameraChoice {
    First,
    All,
    Named(String),
}

impl FromStr for CameraChoice {
    type Err = std::convert::Infallible;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Ok(match text {
            "" => Self::First,
            "all" => Self::All,
            name => Self::Named(name.to_owned()),
        })
    }
}

/// Where the sky's light comes from.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum SkySource {
    Uniform([f32; 3]),
    File(PathBuf),
}

impl FromStr for SkySource {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts: Vec<Result<f32, _>> = text.split(',').map(|part| part.trim().parse::<f32>()).collect();
        if parts.iter().any(Result::is_err) {
            // Something like `1,2,x` is a slip of the finger, not a file.
            return match parts.iter().filter(|part| part.is_ok()).count() {
                0 => Ok(Self::File(PathBuf::from(text))),
                _ => Err("expected a radiance like 1,1,1 or an .exr or .hdr file".to_owned()),
            };
        }
        let numbers: Vec<f32> = parts.into_iter().flatten().collect();
        if !numbers.iter().all(|n| (0.0..=BRIGHTEST).contains(n)) {
            return Err(format!("expected radiances from 0 to {BRIGHTEST:e}"));
        }
        match numbers[..] {
            [grey] => Ok(Self::Uniform([grey; 3])),
            [r, g, b] => Ok(Self::Uniform([r, g, b])),
            _ => Err(format!("expected one number or three (R,G,B), found {}", numbers.len())),
        }
    }
}

/// A light and the file that says how it shines.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct LightFile {
    pub(crate) light: String,
    pub(crate) file: PathBuf,
}

impl FromStr for LightFile {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.rsplit_once('=') {
            Some((light, file)) if !light.is_empty() && !file.is_empty() => {
                Ok(Self { light: light.to_owned(), file: file.into() })
            }
            _ => Err("expected LIGHT=FILE, the name of a light and of a photometric file".to_owned()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_a_width_or_both_sides() {
        assert_eq!("1280".parse(), Ok(Size { width: 1280, height: None }));
        assert_eq!("640x360".parse(), Ok(Size { width: 640, height: Some(360) }));
        for bad in ["", "0", "x", "12x", "-3", "1e3", "70000", "65536x65536", "4x0"] {
            assert!(bad.parse::<Size>().is_err(), "{bad}");
        }
    }

    #[test]
    fn frames_include_both_ends() {
        assert_eq!("3..5".parse(), Ok(Frames { first: 3, last: 5 }));
        assert_eq!("3..=5".parse(), Ok(Frames { first: 3, last: 5 }));
        assert_eq!("7".parse(), Ok(Frames { first: 7, last: 7 }));
        for bad in ["", "5..3", "a..b", "..", "1..", "-1..2", "0..4000000000"] {
            assert!(bad.parse::<Frames>().is_err(), "{bad}");
        }
        // One more than a u32 holds.
        let error = "0..4294967295".parse::<Frames>().expect_err("too many");
        assert!(error.starts_with("4294967296 frames"), "{error}");
    }

    #[test]
    fn a_sky_is_numbers_or_a_file_but_not_half_of_each() {
        assert_eq!("1,0.5,2".parse(), Ok(SkySource::Uniform([1.0, 0.5, 2.0])));
        assert_eq!("2".parse(), Ok(SkySource::Uniform([2.0; 3])));
        assert_eq!("sky.hdr".parse(), Ok(SkySource::File("sky.hdr".into())));
        for bad in ["1,2", "1,2,x", "-1,0,0", "nan,1,1", "1,2,3,4"] {
            assert!(bad.parse::<SkySource>().is_err(), "{bad}");
        }
    }
}
