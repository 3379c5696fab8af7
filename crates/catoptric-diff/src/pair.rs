//! Two layers made ready for the metrics: one region, finite pixels, the values that are compared.

use std::sync::OnceLock;

use catoptric_image::{Encoding, srgb, tone};
use rayon::prelude::*;

use crate::metric::flip::{self, Exposures};
use crate::planes::Planes;
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
    /// Pixels that are finite in the test image but are not in the reference.
    pub gone: usize,
}

/// Standard error of a reference, linear.
#[derive(Clone, Debug, PartialEq)]
pub enum StandardError {
    /// Of every sample.
    Planes(Planes),
    /// Relative to the sample's value.
    Relative(f32),
}

/// A test layer against a reference layer.
pub struct Pair {
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Linear light under test; pixels that are not finite in either image are black in it.
    pub test: Planes,
    /// Linear light of the reference; pixels where it is not finite are black.
    pub reference: Planes,
    /// Standard error of the reference, if it is known.
    pub noise: Option<StandardError>,
    /// Pixels that count; all if `None`.
    pub selected: Option<Vec<bool>>,
    /// Pixels that are not numbers.
    pub non_finite: NonFinite,
    /// Whether both images hold display-referred values.
    pub coded: bool,
    /// Code values times 65535 where the compared values are not the linear ones.
    codes: Option<[Planes; 2]>,
    maps: Maps,
}

/// What several readers want, made when first asked for.
#[derive(Default)]
struct Maps {
    flip: OnceLock<Vec<f32>>,
    exposures: OnceLock<Exposures>,
    gain: OnceLock<f32>,
}

/// The numbers that differences are taken of: sample × unit.
#[derive(Clone, Copy)]
pub struct Values<'a> {
    /// The test image.
    pub test: &'a Planes,
    /// The reference.
    pub reference: &'a Planes,
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
        test: impl Into<Planes>,
        reference: impl Into<Planes>,
        encodings: [Encoding; 2],
        space: Space,
    ) -> Pair {
        let (mut test, mut reference) = (test.into(), reference.into());
        assert!(test.len() == width * height && reference.len() == width * height, "planes do not fit");
        let non_finite = blacken_non_finite(&mut test, &mut reference);
        // Code values are kept as integers of 16 bits: exact for files of 8 and of 16 bits.
        let files_are_coded = encodings == [Encoding::Srgb; 2];
        let coded = space == Space::Coded || (space == Space::Auto && files_are_coded);
        let mut codes = None;
        if coded {
            let planes = [(&mut test, encodings[0]), (&mut reference, encodings[1])];
            codes = Some(planes.map(|(plane, encoding)| match encoding {
                Encoding::Srgb => plane.map(|v| (srgb::encode(v) * 65535.0).round()),
                Encoding::Linear => {
                    let codes = plane.map(|v| v * 65535.0);
                    *plane = plane.map(srgb::decode);
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
    pub(crate) fn pool(&self, mut map: Vec<f32>) -> Vec<f32> {
        let mut i = 0;
        if self.selected.is_some() {
            map.retain(|_| {
                i += 1;
                self.counts(i - 1)
            });
        }
        map
    }

    /// The largest value of a map and its pixel; the first one of equals.
    pub(crate) fn largest(&self, value: impl Fn(usize) -> f32 + Sync) -> (f64, [usize; 2]) {
        let better = |a: (f32, usize), b: (f32, usize)| {
            if b.0 > a.0 || (b.0 == a.0 && b.1 < a.1) { b } else { a }
        };
        let none = (f32::NEG_INFINITY, usize::MAX);
        let of = |i: usize| if self.counts(i) { (value(i), i) } else { none };
        let best = (0..self.test.len()).into_par_iter().map(of).reduce(|| none, better);
        let pixel = if best.1 == usize::MAX { 0 } else { best.1 };
        (f64::from(best.0), [pixel % self.width, pixel / self.width])
    }

    /// Mean luminance of the reference, linear.
    pub(crate) fn mean_luminance(&self) -> f64 {
        self.mean(|i| [luminance(self.reference.at(i))])[0]
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

    /// LDR-FLIP of every pixel as [`Pair::display`] shows the images.
    pub(crate) fn displayed_flip_map(&self) -> Vec<f32> {
        let exposures = Exposures::Bytes { gain: self.display_gain() };
        flip::error_map(self.width, self.height, &self.reference, &self.test, exposures, flip::DEFAULT_PPD)
    }

    /// |lum(test) − lum(reference)| / (lum(reference) + 1 % of the mean luminance) of every pixel.
    pub fn relative_map(&self) -> Vec<f32> {
        let floor = 0.01 * self.mean_luminance();
        self.per_pixel(|i| {
            let (t, r) = (luminance(self.test.at(i)), luminance(self.reference.at(i)));
            let difference = (t - r).abs();
            if difference == 0.0 { 0.0 } else { difference / (r + floor).max(f64::MIN_POSITIVE) }
        })
    }

    /// Largest absolute difference of the compared values over the channels of a pixel.
    pub(crate) fn absolute_error(&self, pixel: usize) -> f32 {
        let values = self.values();
        let (t, r) = (values.test.at(pixel), values.reference.at(pixel));
        let d = |k: usize| (f64::from(t[k]) - f64::from(r[k])).abs();
        (d(0).max(d(1)).max(d(2)) * values.unit) as f32
    }

    /// [`Pair::absolute_error`] of every pixel.
    pub(crate) fn absolute_map(&self) -> Vec<f32> {
        (0..self.test.len()).into_par_iter().map(|i| self.absolute_error(i)).collect()
    }

    /// Signed relative difference of luminance: positive where the test image is brighter; in [−1, 1].
    pub fn signed_map(&self) -> Vec<f32> {
        let floor = 0.01 * self.mean_luminance();
        self.per_pixel(|i| {
            let (t, r) = (luminance(self.test.at(i)), luminance(self.reference.at(i)));
            let scale = t.abs() + r.abs() + floor;
            if scale > 0.0 { 2.0 * (t - r) / scale } else { 0.0 }.clamp(-1.0, 1.0)
        })
    }

    fn per_pixel(&self, value: impl Fn(usize) -> f64 + Sync) -> Vec<f32> {
        (0..self.test.len()).into_par_iter().map(|i| value(i) as f32).collect()
    }

    /// Stops that suit the reference on a display; none for display-referred images.
    pub(crate) fn display_exposure(&self) -> f32 {
        if self.coded { 0.0 } else { tone::auto_exposure(self.reference.pixels()) }
    }

    /// The same as a factor of light.
    pub(crate) fn display_gain(&self) -> f32 {
        *self.maps.gain.get_or_init(|| libm::exp2f(self.display_exposure()))
    }

    /// Both images as sRGB bytes at the exposure that suits the reference; display-referred images as they are.
    pub fn display(&self) -> [Vec<[u8; 3]>; 2] {
        let gain = self.display_gain();
        [&self.test, &self.reference].map(|planes| {
            let pixels = (0..planes.len()).into_par_iter();
            pixels.map(|i| planes.at(i).map(|v| srgb::byte(v * gain))).collect()
        })
    }
}

/// Counts the pixels that are not numbers, and makes them black.
fn blacken_non_finite(test: &mut Planes, reference: &mut Planes) -> NonFinite {
    let mut found = NonFinite::default();
    // Most stretches are finite and pass as a whole: no exponent of all ones.
    const STRETCH: usize = 1 << 14;
    let finite = |samples: &[f32]| {
        samples.iter().fold(0, |m, v| m.max(v.to_bits() << 1)) < f32::INFINITY.to_bits() << 1
    };
    let stretches: Vec<_> =
        (0..test.len()).step_by(STRETCH).map(|start| start..(start + STRETCH).min(test.len())).collect();
    let suspects: Vec<_> = stretches
        .into_par_iter()
        .filter(|range| {
            let mut channels = test.channels().iter().chain(reference.channels());
            !channels.all(|channel| finite(&channel[range.clone()]))
        })
        .collect();
    for range in suspects {
        for i in range {
            let (t, r) = (test.at(i), reference.at(i));
            let (t_bad, r_bad) = (t.iter().any(|v| !v.is_finite()), r.iter().any(|v| !v.is_finite()));
            if t_bad || r_bad {
                found.nan += usize::from(t.iter().any(|v| v.is_nan()));
                found.inf += usize::from(t.iter().any(|v| v.is_infinite()));
                found.reference += usize::from(r_bad);
                found.new += usize::from(t_bad && !r_bad);
                found.gone += usize::from(r_bad && !t_bad);
                test.blacken(i);
            }
            if r_bad {
                reference.blacken(i);
            }
        }
    }
    found
}

/// Rec. 709 luminance in double precision.
pub(crate) fn luminance(rgb: Rgb) -> f64 {
    0.2126 * f64::from(rgb[0]) + 0.7152 * f64::from(rgb[1]) + 0.0722 * f64::from(rgb[2])
}
