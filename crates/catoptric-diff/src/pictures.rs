//! Pictures of a difference: heat maps, side by side, the worst places, the histogram.

use std::path::{Path, PathBuf};

use catoptric_image::write_png8;

use crate::colour::{magma, red_blue};
use crate::{DiffError, Pair};

/// Side of the places that are ranked.
const PLACE: usize = 32;
const GAP: [u8; 3] = [128, 128, 128];

/// A place and its mean FLIP.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Place {
    /// Left.
    pub x: usize,
    /// Top.
    pub y: usize,
    /// Width.
    pub width: usize,
    /// Height.
    pub height: usize,
    /// Mean FLIP.
    pub flip: f64,
}

/// The worst of the places of 32×32 pixels that tile the image, worst first; those without error are left out.
pub fn worst_places(pair: &Pair, count: usize) -> Vec<Place> {
    let map = pair.flip_map();
    let mut places = Vec::new();
    for y in (0..pair.height).step_by(PLACE) {
        for x in (0..pair.width).step_by(PLACE) {
            let (width, height) = (PLACE.min(pair.width - x), PLACE.min(pair.height - y));
            let pixels = (y..y + height).flat_map(|row| row * pair.width + x..row * pair.width + x + width);
            let sum: f64 = pixels.filter(|&i| pair.counts(i)).map(|i| f64::from(map[i])).sum();
            places.push(Place { x, y, width, height, flip: sum / (width * height) as f64 });
        }
    }
    places.retain(|place| place.flip > 0.0);
    places.sort_by(|a, b| b.flip.total_cmp(&a.flip));
    places.truncate(count);
    places
}

/// Pixel counts over the decades of relative error: below 1e-4, then three bins per decade, to above 10.
pub fn histogram(pair: &Pair) -> Vec<(f64, usize)> {
    const BINS: usize = 17;
    let mut counts = [0; BINS];
    for v in pair.pool(pair.relative_map()) {
        let bin = ((libm::log10(f64::from(v).max(1e-30)) + 4.0) * 3.0).floor() + 1.0;
        counts[(bin.max(0.0) as usize).min(BINS - 1)] += 1;
    }
    let edge = |bin: usize| {
        if bin == 0 { 0.0 } else { libm::pow(10.0, (bin as f64 - 1.0) / 3.0 - 4.0) }
    };
    counts.into_iter().enumerate().map(|(bin, n)| (edge(bin), n)).collect()
}

/// Writes the pictures of a layer into a folder and returns their paths.
pub fn write(pair: &Pair, folder: &Path, prefix: &str) -> Result<Vec<PathBuf>, DiffError> {
    std::fs::create_dir_all(folder).map_err(|error| DiffError::io(folder, error))?;
    let (w, h) = (pair.width, pair.height);
    let mut written = Vec::new();
    let mut write = |name: &str, width, height, pixels: &[[u8; 3]]| -> Result<(), DiffError> {
        let path = folder.join(format!("{prefix}{name}.png"));
        write_png8(&path, width, height, pixels)?;
        written.push(path);
        Ok(())
    };
    let heat: Vec<[u8; 3]> = pair.flip_map().iter().map(|&v| magma(v)).collect();
    let relative: Vec<[u8; 3]> = pair.relative_map().into_iter().map(|v| magma(2.0 * v)).collect();
    let signed: Vec<[u8; 3]> = pair.signed_map().into_iter().map(red_blue).collect();
    let [test, reference] = pair.display();
    write("flip", w, h, &heat)?;
    write("relative", w, h, &relative)?;
    write("signed", w, h, &signed)?;
    let all = beside(&[&test, &reference, &heat], w, h);
    write("side-by-side", 3 * w + 8, h, &all)?;

    // The worst places: test, reference and heat in a row, enlarged.
    let places = worst_places(pair, 6);
    if !places.is_empty() {
        const ZOOM: usize = 4;
        let (width, line) = (3 * PLACE * ZOOM + 8, PLACE * ZOOM + 4);
        let mut sheet = vec![GAP; width * line * places.len()];
        for (row, place) in places.iter().enumerate() {
            for (column, picture) in [&test, &reference, &heat].into_iter().enumerate() {
                for y in 0..place.height * ZOOM {
                    for x in 0..place.width * ZOOM {
                        let source = (place.y + y / ZOOM) * w + place.x + x / ZOOM;
                        sheet[(row * line + y) * width + column * (PLACE * ZOOM + 4) + x] = picture[source];
                    }
                }
            }
        }
        write("worst", width, line * places.len(), &sheet)?;
    }

    // The histogram as bars.
    let bins = histogram(pair);
    let (bar, tall) = (16, 160);
    let most = bins.iter().map(|(_, n)| *n).max().unwrap_or(1).max(1);
    let width = bins.len() * bar;
    let mut chart = vec![[255; 3]; width * tall];
    for (bin, &(_, n)) in bins.iter().enumerate() {
        let top = tall - n * (tall - 4) / most;
        for y in top..tall {
            for x in bin * bar + 1..(bin + 1) * bar - 1 {
                chart[y * width + x] = magma(0.15 + 0.7 * bin as f32 / bins.len() as f32);
            }
        }
    }
    write("histogram", width, tall, &chart)?;
    Ok(written)
}

fn beside(pictures: &[&Vec<[u8; 3]>], width: usize, height: usize) -> Vec<[u8; 3]> {
    let mut out = Vec::with_capacity((pictures.len() * (width + 4)) * height);
    for y in 0..height {
        for (k, picture) in pictures.iter().enumerate() {
            if k > 0 {
                out.extend([GAP; 4]);
            }
            out.extend_from_slice(&picture[y * width..(y + 1) * width]);
        }
    }
    out
}
