//! The comparison of two images, layer by layer.

use catoptric_image::Image;
use serde::Serialize;

use crate::DiffError;
use crate::metric::{Metric, NoiseVerdict, Reading, Settings, noise_verdict};
use crate::pair::{Pair, Space, StandardError};
use crate::planes::Planes;

/// The layer that holds the standard error of the beauty.
const NOISE_LAYER: &str = "SE";

/// What is compared, and how.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Params {
    /// Left, top, width and height of the region; the whole image if `None`.
    pub crop: Option<[usize; 4]>,
    /// Pixels that count are those of this image (of the uncropped size) that are not black.
    pub mask: Option<Image>,
    /// Layers by name; `""` is the beauty. `None` compares all that both images have.
    pub layers: Option<Vec<String>>,
    /// Which numbers differences are taken of.
    pub space: Space,
    /// Percentiles.
    pub settings: Settings,
    /// Metrics; `None` for all.
    pub metrics: Option<Vec<Metric>>,
    /// Standard error of the reference relative to its value, where it has no layer `SE`.
    pub relative_standard_error: Option<f64>,
}

/// All there is to say about two images.
pub struct Comparison {
    /// One entry per compared layer, the beauty first.
    pub layers: Vec<LayerComparison>,
    /// Colour layers of the test image that the reference lacks.
    pub only_in_test: Vec<String>,
    /// Colour layers of the reference that the test image lacks.
    pub only_in_reference: Vec<String>,
    /// Channels of both that belong to no compared layer, such as depth and ids, with the number of pixels in which they are not the same.
    pub other_channels: Vec<(String, usize)>,
}

/// One layer.
#[derive(Serialize)]
pub struct LayerComparison {
    /// Its name; empty for the beauty.
    pub layer: String,
    /// The numbers.
    pub readings: Vec<Reading>,
    /// Whether the reference's noise explains the difference.
    pub noise: Option<NoiseVerdict>,
    /// The pixels.
    #[serde(skip)]
    pub pair: Pair,
}

impl LayerComparison {
    /// The reading of this name.
    pub fn reading(&self, name: &str) -> Option<&Reading> {
        self.readings.iter().find(|r| r.name == name)
    }

    /// The layer's name for people.
    pub fn title(&self) -> &str {
        if self.layer.is_empty() { "beauty" } else { &self.layer }
    }
}

/// Compares `test` with `reference`, whose planes it takes over.
pub fn compare(test: Image, reference: Image, params: &Params) -> Result<Comparison, DiffError> {
    let [test_size, reference_size] = [&test, &reference].map(|image| [image.width, image.height]);
    if test_size != reference_size {
        return Err(DiffError::Size { test: test_size, reference: reference_size });
    }
    let region = Region::new(&test, params)?;
    let colour = |image: &Image| image.layers().into_iter().filter(|l| l != NOISE_LAYER).collect::<Vec<_>>();
    let (ours, theirs) = (colour(&test), colour(&reference));
    let names = match &params.layers {
        Some(names) => names.clone(),
        None => common_layers(&ours, &theirs, &test, &reference)?,
    };
    let other_channels = match params.layers {
        Some(_) => Vec::new(),
        None => other_channels(&test, &reference, &names, &region),
    };
    // Each plane is taken over by the last layer that wants it.
    let encodings = [test.encoding, reference.encoding];
    let mut test = Stock::new(test, names.clone());
    let noisy = names.iter().flat_map(|layer| [layer.clone(), noise_layer(layer)]).collect();
    let mut reference = Stock::new(reference, noisy);
    let mut layers = Vec::new();
    for layer in names {
        let missing = |which, present: &[String]| DiffError::Layer {
            which,
            layer: layer.clone(),
            present: listed(present),
        };
        let t = test.take(&layer, &region).ok_or_else(|| missing("test image", &ours))?;
        let r = reference.take(&layer, &region).ok_or_else(|| missing("reference", &theirs))?;
        let noise = reference.take(&noise_layer(&layer), &region);
        let mut pair = Pair::new(region.width, region.height, t, r, encodings, params.space);
        pair.selected = region.selected.clone();
        let finite = |v: f32| if v.is_finite() { v } else { 0.0 };
        pair.noise = match (noise, params.relative_standard_error) {
            (Some(planes), _) => Some(StandardError::Planes(planes.map(finite))),
            (None, relative) => relative.map(|relative| StandardError::Relative(relative as f32)),
        };
        let metrics = params.metrics.as_deref().unwrap_or(&Metric::ALL);
        let readings = metrics.iter().flat_map(|m| m.measure(&pair, &params.settings)).collect();
        layers.push(LayerComparison { layer, readings, noise: noise_verdict(&pair), pair });
    }
    let without = |a: &[String], b: &[String]| a.iter().filter(|l| !b.contains(l)).cloned().collect();
    Ok(Comparison {
        layers,
        only_in_test: without(&ours, &theirs),
        only_in_reference: without(&theirs, &ours),
        other_channels,
    })
}

/// The channels of both images that none of some layers has, with the number of pixels of the region in which they are not the same.
fn other_channels(
    test: &Image,
    reference: &Image,
    layers: &[String],
    region: &Region,
) -> Vec<(String, usize)> {
    let used: Vec<usize> =
        layers.iter().filter_map(|layer| reference.layer_channels(layer)).flatten().flatten().collect();
    let is_noise = |name: &str| name == NOISE_LAYER || name.starts_with(&format!("{NOISE_LAYER}."));
    let mut others = Vec::new();
    for (index, channel) in reference.channels.iter().enumerate() {
        let name = channel.name.as_str();
        let (false, false, Some(ours)) = (used.contains(&index), is_noise(name), test.channel(name)) else {
            continue;
        };
        let theirs = &channel.samples;
        let differs = |&(index, pixel): &(usize, usize)| {
            let (a, b) = (ours[pixel], theirs[pixel]);
            region.selected.as_ref().is_none_or(|selected| selected[index])
                && a != b
                && !(a.is_nan() && b.is_nan())
        };
        let rows = region.top..region.top + region.height;
        let pixels = rows.flat_map(|y| (region.left..region.left + region.width).map(move |x| (y, x)));
        let pixels = pixels.map(|(y, x)| y * reference.width + x).enumerate();
        others.push((name.to_owned(), pixels.filter(differs).count()));
    }
    others
}

/// Layers of both; images without any are compared by their only channel.
fn common_layers(
    ours: &[String],
    theirs: &[String],
    test: &Image,
    reference: &Image,
) -> Result<Vec<String>, DiffError> {
    let common: Vec<String> = ours.iter().filter(|l| theirs.contains(l)).cloned().collect();
    if !common.is_empty() {
        return Ok(common);
    }
    let same = test.channels.iter().map(|c| c.name.clone()).filter(|name| reference.channel(name).is_some());
    let same: Vec<String> = same.collect();
    if same.is_empty() {
        let names =
            |image: &Image| listed(&image.channels.iter().map(|c| c.name.clone()).collect::<Vec<_>>());
        let both = format!("{} against {}", names(test), names(reference));
        return Err(DiffError::Layer { which: "reference", layer: "in common".into(), present: both });
    }
    Ok(same)
}

fn listed(names: &[String]) -> String {
    let names: Vec<&str> =
        names.iter().map(|n| if n.is_empty() { "the beauty" } else { n.as_str() }).collect();
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

/// The layer of the standard error of a layer.
fn noise_layer(layer: &str) -> String {
    if layer.is_empty() { NOISE_LAYER.to_owned() } else { format!("{NOISE_LAYER}.{layer}") }
}

/// The planes of an image and how often each is still wanted.
struct Stock {
    image: Image,
    wanted: Vec<usize>,
}

impl Stock {
    fn new(mut image: Image, layers: Vec<String>) -> Stock {
        let mut wanted = vec![0; image.channels.len()];
        for layer in layers {
            for channel in image.layer_channels(&layer).into_iter().flatten().flatten() {
                wanted[channel] += 1;
            }
        }
        for (channel, &wanted) in image.channels.iter_mut().zip(&wanted) {
            if wanted == 0 {
                channel.samples = Vec::new();
            }
        }
        Stock { image, wanted }
    }

    /// The region of a layer; `None` if the image has no such layer.
    fn take(&mut self, layer: &str, region: &Region) -> Option<Planes> {
        let channels = self.image.layer_channels(layer)?;
        let (width, size) = (self.image.width, self.image.width * self.image.height);
        let whole = region.width * region.height == size;
        Some(Planes::new(channels.map(|channel| {
            let Some(channel) = channel else { return vec![0.0; region.width * region.height] };
            self.wanted[channel] -= 1;
            let samples = &mut self.image.channels[channel].samples;
            match (whole, self.wanted[channel]) {
                (true, 0) => std::mem::take(samples),
                (true, _) => samples.clone(),
                (false, _) => region.cut(samples, width),
            }
        })))
    }
}

/// The part of the image that is compared.
struct Region {
    left: usize,
    top: usize,
    width: usize,
    height: usize,
    selected: Option<Vec<bool>>,
}

impl Region {
    fn new(image: &Image, params: &Params) -> Result<Region, DiffError> {
        let [left, top, width, height] = params.crop.unwrap_or([0, 0, image.width, image.height]);
        let fits = |start: usize, size: usize, whole| {
            size > 0 && start.checked_add(size).is_some_and(|end| end <= whole)
        };
        if !fits(left, width, image.width) || !fits(top, height, image.height) {
            let (w, h) = (image.width, image.height);
            return Err(DiffError::Region(format!(
                "the crop {left},{top},{width},{height} is not inside {w}x{h}"
            )));
        }
        let mut region = Region { left, top, width, height, selected: None };
        if let Some(mask) = &params.mask {
            if (mask.width, mask.height) != (image.width, image.height) {
                let (w, h) = (mask.width, mask.height);
                return Err(DiffError::Region(format!(
                    "the mask is {w}x{h}, the images {}x{}",
                    image.width, image.height
                )));
            }
            let name = mask.layers().into_iter().next().unwrap_or_else(|| mask.channels[0].name.clone());
            let pixels = mask.rgb(&name).unwrap_or_default();
            let selected: Vec<bool> =
                region.cut(&pixels, mask.width).iter().map(|p| p.iter().any(|&v| v > 0.0)).collect();
            if !selected.contains(&true) {
                return Err(DiffError::Region("the mask selects no pixel of the region".to_owned()));
            }
            region.selected = Some(selected);
        }
        Ok(region)
    }

    fn cut<T: Copy>(&self, pixels: &[T], width: usize) -> Vec<T> {
        let rows = pixels.chunks_exact(width.max(1)).skip(self.top).take(self.height);
        rows.flat_map(|row| &row[self.left..self.left + self.width]).copied().collect()
    }
}
