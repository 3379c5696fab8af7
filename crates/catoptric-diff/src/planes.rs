//! An image as three planes: what an EXR file holds, taken over without a copy.

use rayon::prelude::*;

use crate::pair::Rgb;

/// Red, green and blue, row-major, of one size.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Planes([Vec<f32>; 3]);

impl Planes {
    /// Takes three planes over.
    ///
    /// # Panics
    /// If they are not of one size.
    pub fn new(channels: [Vec<f32>; 3]) -> Planes {
        assert!(channels.iter().all(|c| c.len() == channels[0].len()), "planes of different sizes");
        Planes(channels)
    }

    /// Pixels.
    pub fn len(&self) -> usize {
        self.0[0].len()
    }

    /// Whether there are no pixels.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The planes.
    pub fn channels(&self) -> &[Vec<f32>; 3] {
        &self.0
    }

    /// One pixel.
    #[inline(always)]
    pub fn at(&self, pixel: usize) -> Rgb {
        [self.0[0][pixel], self.0[1][pixel], self.0[2][pixel]]
    }

    /// Makes one pixel black.
    pub(crate) fn blacken(&mut self, pixel: usize) {
        for plane in &mut self.0 {
            plane[pixel] = 0.0;
        }
    }

    /// All samples through `f`.
    pub(crate) fn map(&self, f: impl Fn(f32) -> f32 + Sync) -> Planes {
        Planes(self.0.each_ref().map(|plane| plane.par_iter().map(|&v| f(v)).collect()))
    }

    /// The pixels, one after the other.
    pub(crate) fn pixels(&self) -> impl Iterator<Item = Rgb> + '_ {
        let [r, g, b] = &self.0;
        r.iter().zip(g).zip(b).map(|((&r, &g), &b)| [r, g, b])
    }
}

impl From<Vec<Rgb>> for Planes {
    fn from(pixels: Vec<Rgb>) -> Planes {
        Planes([0, 1, 2].map(|k: usize| pixels.iter().map(|p| p[k]).collect()))
    }
}
