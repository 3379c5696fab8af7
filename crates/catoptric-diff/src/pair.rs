//! Two layers made ready for the metrics: one region, finite pixels, the values that are compared.

use std::sync::OnceLock;

use catoptric_image::{Encoding, tone};
use rayon::prelude::*;

use crate::metric::flip::{self, Exposures};
use crate::sums::sum;

/// A pixel.
pub type Rgb = [f32; 3];

/// What kind of numbers the metrics of differences (MSE, PSNR, SSIM, …) see.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Space {
    /// Code values where both files hold sRGB codes (PNG, JPEG), linear light otherwise.
    #[default]
    Auto,
    /// Linear light always.
    Linear,
    /// Code values always: samples of float files are taken as sRGB codes in `[0, 1]`.
    Coded,
}

/// Pixels that are not numbers, by image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NonFinite {
    /// Pixels with a NaN in the test image.
    pub nan: usize,
    /// Pixels with an infinity in the test image.
    pub inf: usize,
    /// Pixels of the reference with either.
    pub reference: usize,
    /// Pixels that are not finite in the test image but are in the reference.
    pub new: usize,
}

/// A test layer against a reference layer.
pub struct Pair {
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Linear light under test; pixels that are not finite in either image are black in it.
    pub test: Vec<Rgb>,
    /// Linear light of the reference; pixels where it is not finite are black.
    pub reference: Vec<Rgb>,
    /// Standard error of the reference, per channel, linear.
    pub noise: Option<Vec<Rgb>>,
    /// Pixels that count; all if `None`.
    pub selected: Option<Vec<bool>>,
    /// Pixels that are not numbers.
    pub non_finite: NonFinite,
    /// Whether both images hold display-referred values.
    pub coded: bool,
    /// Code values times 65535 where the compared values are not the linear ones.
    codes: Option<[Vec<Rgb>; 2]>,
    maps: Maps,
}

/// Error maps, made when first asked for.
#[derive(Default)]
struct Maps {
    flip: OnceLock<Vec<f32>>,
    exposures: OnceLock<Exposures>,
    relative: OnceLock<Vec<f32>>,
    absolute: OnceLock<Vec<f32>>,
}

/// The numbers that differences are taken of: sample × unit.
#[derive(Clone, Copy)]
pub struct Values<'a> {
    /// The test image.
    pub test: &'a [Rgb],
    /// The reference.
    pub reference: &'a [Rgb],
    /// 1, or 1/65535 for code values, which are then exact integers.
    pub unit: f64,
}

impl Pair {
    /// Prepares two layers of one size.
    ///
    /// # Panics
    /// If a plane does not have width × height elements.
    pub fn new(
        width: usize,
        height: usize,
        mut test: Vec<Rgb>,
        mut reference: Vec<Rgb>,
        encodings: [Encoding; 2],
        space: Space,
    ) -> Pair {
        assert!(test.len() == width * height && reference.len() == width * height, "planes do not fit");
        // Count what is not finite, and make it black.
        let mut non_finite = NonFinite::default();
        for (t, r) in test.iter_mut().zip(&mut reference) {
            let (t_bad, r_bad) = (t.iter().any(|v| !v.is_finite()), r.iter().any(|v| !v.is_finite()));
            if t_bad || r_bad {
                non_finite.nan += usize::from(t.iter().any(|v| v.is_nan()));
                non_finite.inf += usize::from(t.iter().any(|v| v.is_infinite()));
                non_finite.reference += usize::from(r_bad);
                non_finite.new += usize::from(t_bad && !r_bad);
                *t = [0.0; 3];
            }
            if r_bad {
                *r = [0.0; 3];
            }
        }
        // Code values are kept as integers of 16 bits: exact for files of 8 and of 16 bits.
        let files_are_coded = encodings == [Encoding::Srgb; 2];
        let coded = space == Space::Coded || (space == Space::Auto && files_are_coded);
        let mut codes = None;
        if coded {
            let planes = [(&mut test, encodings[0]), (&mut reference, encodings[1])];
            codes = Some(planes.map(|(plane, encoding)| match encoding {
                Encoding::Srgb => map(plane, |v| (catoptric_image::srgb::encode(v) * 65535.0).round()),
                Encoding::Linear => {
                    let codes = map(plane, |v| v * 65535.0);
                    *plane = map(plane, catoptric_image::srgb::decode);
                    codes
                }
            }));
        }
        Pair {
            width,
            height,
            test,
            reference,
            noise: None,
            selected: None,
            non_finite,
            coded,
            codes,
            maps: Maps::default(),
        }
    }

    /// The numbers differences are taken of.
    pub fn values(&self) -> Values<'_> {
        match &self.codes {
            Some([test, reference]) => Values { test, reference, unit: 1.0 / 65535.0 },
            None => Values { test: &self.test, reference: &self.reference, unit: 1.0 },
        }
    }

    /// Whether a pixel counts.
    pub fn counts(&self, i: usize) -> bool {
        self.selected.as_ref().is_none_or(|s| s[i])
    }

    /// How many pixels count.
    pub fn count(&self) -> usize {
        self.selected.as_ref().map_or(self.test.len(), |s| s.iter().filter(|s| **s).count())
    }

    /// Means over the pixels that count.
    pub(crate) fn mean<const K: usize>(&self, term: impl Fn(usize) -> [f64; K] + Sync) -> [f64; K] {
        let total = sum(self.test.len(), |i| if self.counts(i) { term(i) } else { [0.0; K] });
        total.map(|t| t / self.count().max(1) as f64)
    }

    /// The values of a map at the pixels that count.
    pub(crate) fn pool(&self, map: &[f32]) -> Vec<f32> {
        match &self.selected {
            None => map.to_vec(),
            Some(selected) => map.iter().zip(selected).filter(|(_, s)| **s).map(|(v, _)| *v).collect(),
        }
    }

    /// The largest value of a map and its pixel; the first one of equals.
    pub(crate) fn largest(&self, map: &[f32]) -> (f64, [usize; 2]) {
        let mut best = (f32::NEG_INFINITY, 0);
        for (i, &v) in map.iter().enumerate() {
            if v > best.0 && self.counts(i) {
                best = (v, i);
            }
        }
        (f64::from(best.0), [best.1 % self.width, best.1 / self.width])
    }

    /// Mean luminance of the reference, linear.
    pub(crate) fn mean_luminance(&self) -> f64 {
        self.mean(|i| [luminance(self.reference[i])])[0]
    }

    /// The exposures HDR-FLIP uses for this reference.
    pub fn exposures(&self) -> Exposures {
        *self.maps.exposures.get_or_init(|| {
            if self.coded { Exposures::None } else { Exposures::of_reference(&self.reference) }
        })
    }

    /// FLIP of every pixel: LDR for display-referred pairs, HDR otherwise.
    pub fn flip_map(&self) -> &[f32] {
        self.maps.flip.get_or_init(|| {
            flip::error_map(
                self.width,
                self.height,
                &self.reference,
                &self.test,
                self.exposures(),
                flip::DEFAULT_PPD,
            )
        })
    }

    /// |lum(test) − lum(reference)| / (lum(reference) + 1 % of the mean luminance) of every pixel.
    pub fn relative_map(&self) -> &[f32] {
        self.maps.relative.get_or_init(|| {
            let floor = 0.01 * self.mean_luminance();
            self.per_pixel(|i| {
                let (t, r) = (luminance(self.test[i]), luminance(self.reference[i]));
                let difference = (t - r).abs();
                if difference == 0.0 { 0.0 } else { difference / (r + floor).max(f64::MIN_POSITIVE) }
            })
        })
    }

    /// Largest absolute difference of the compared values over the channels of every pixel.
    pub fn absolute_map(&self) -> &[f32] {
        self.maps.absolute.get_or_init(|| {
            let values = self.values();
            self.per_pixel(|i| {
                let d = |k: usize| (f64::from(values.test[i][k]) - f64::from(values.reference[i][k])).abs();
                d(0).max(d(1)).max(d(2)) * values.unit
            })
        })
    }

    /// Signed relative difference of luminance: positive where the test image is brighter; in [−1, 1].
    pub fn signed_map(&self) -> Vec<f32> {
        let floor = 0.01 * self.mean_luminance();
        self.per_pixel(|i| {
            let (t, r) = (luminance(self.test[i]), luminance(self.reference[i]));
            let scale = t.abs() + r.abs() + floor;
            if scale > 0.0 { 2.0 * (t - r) / scale } else { 0.0 }.clamp(-1.0, 1.0)
        })
    }

    fn per_pixel(&self, value: impl Fn(usize) -> f64 + Sync) -> Vec<f32> {
        (0..self.test.len()).into_par_iter().map(|i| value(i) as f32).collect()
    }

    /// Both images as sRGB bytes at the exposure that suits the reference; display-referred images as they are.
    pub fn display(&self) -> [Vec<[u8; 3]>; 2] {
        let exposure_ev = if self.coded { 0.0 } else { tone::auto_exposure(&self.reference) };
        let tone = tone::ToneMap { exposure_ev, curve: tone::Curve::Clip };
        [tone::to_srgb8(&self.test, &tone), tone::to_srgb8(&self.reference, &tone)]
    }
}

fn map(plane: &[Rgb], f: impl Fn(f32) -> f32 + Sync) -> Vec<Rgb> {
    plane.par_iter().map(|p| p.map(&f)).collect()
}

/// Rec. 709 luminance in double precision.
pub(crate) fn luminance(rgb: Rgb) -> f64 {
    0.2126 * f64::from(rgb[0]) + 0.7152 * f64::from(rgb[1]) + 0.0722 * f64::from(rgb[2])
}
