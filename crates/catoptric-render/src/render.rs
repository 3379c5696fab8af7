//! Pass two from end to end: samples, anti-aliasing, layers.
//!
//! Anti-aliasing is adaptive and unbiased: which pixels get more samples is decided by other samples than those that
//! they are made of. A first ray through each pixel's centre leaves a trail of what it met; pixels whose trail differs
//! from a neighbour's, or whose radiance bends, are sampled again on a grid of their own, and the first ray is not used.

use rayon::prelude::*;

use catoptric_image::Image;
use catoptric_light::irradiance::Scratch;
use catoptric_light::{LightParams, Lights};
use catoptric_scene::quantity::LUMINANCE;
use catoptric_scene::{Camera, Cancelled, Progress, Rgb};
use catoptric_solution::{Quality, Solution};
use catoptric_trace::Tracer;
use catoptric_trace::sequence::{Key, Purpose};
use catoptric_trace::walk::split::SplitParams;

use crate::layers::{LightLayers, NAMES};
use crate::lines::{Footprint, LAYER as LINES};
use crate::pixel::{Eye, FirstHit, Sample};

/// Parameters of pass two.
#[derive(Clone, Debug, PartialEq)]
pub struct RenderParams {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Limits of the eye's walk.
    pub walk: SplitParams,
    /// Sources, as pass one saw them.
    pub light: LightParams,
    /// Seed of all sequences.
    pub seed: u32,
    /// Samples of a pixel on an edge.
    pub edge_samples: u32,
    /// Differences of displayed luminance between neighbours, relative, that call for more samples.
    pub contrast: f32,
    /// Write the light layers and the data layers (albedo, normal, depth, ids) beside the beauty.
    pub layers: bool,
    /// Write the coverage by the lines of the display mesh beside the beauty.
    pub mesh: bool,
}

impl RenderParams {
    /// The budgets of a quality.
    pub fn for_quality(quality: Quality, width: usize, height: usize) -> Self {
        let edge_samples = match quality {
            Quality::Draft => 8,
            Quality::Standard => 16,
            Quality::High => 64,
        };
        Self {
            width,
            height,
            walk: SplitParams::default(),
            light: LightParams::default(),
            seed: 0,
            edge_samples,
            contrast: 0.1,
            layers: false,
            mesh: false,
        }
    }
}

/// What pass two did.
#[derive(Clone, Debug, Default)]
pub struct RenderReport {
    /// Eye rays.
    pub samples: u64,
    /// Pixels that were sampled again.
    pub refined_pixels: u64,
}

/// The result of pass two.
#[derive(Clone, Debug)]
pub struct Rendered {
    /// The image: beauty and, if asked for, layers.
    pub image: Image,
    /// What was done.
    pub report: RenderReport,
}

/// A finished pixel.
#[derive(Clone, Copy, Debug)]
struct Pixel {
    light: LightLayers,
    lines: f32,
    first: FirstHit,
    trail: u32,
}

/// Renders a view.
pub fn render(
    tracer: &Tracer,
    solution: &Solution,
    camera: &Camera,
    params: &RenderParams,
    progress: &dyn Progress,
) -> Result<Rendered, Cancelled> {
    let lights = Lights::new(tracer, params.light);
    let eye = Eye { lights: &lights, solution, params: params.walk };
    let (width, height) = (params.width, params.height);

    // One ray through the centre of every pixel.
    progress.begin("image", 2 * height as u64);
    let first = rows(height, progress, |y, scratch| {
        (0..width)
            .map(|x| {
                let key = Key::new(params.seed, Purpose::Pixel, (y * width + x) as u64);
                let sample = shoot(&eye, camera, params, (x, y), (0.5, 0.5), key, scratch);
                let Sample { light, lines, first, trail } = sample;
                Pixel { light, lines, first, trail }
            })
            .collect()
    })?;

    // Pixels beside an edge are made of new samples.
    let exposure = mean_luminance(&first).max(1e-30);
    let needs: Vec<bool> = (0..width * height)
        .map(|i| needs_more(&first, width, height, i % width, i / width, exposure, params.contrast))
        .collect();
    let refined = rows(height, progress, |y, scratch| {
        (0..width)
            .map(|x| {
                let index = y * width + x;
                if needs[index] {
                    resample(&eye, camera, params, (x, y), &first[index], scratch)
                } else {
                    first[index]
                }
            })
            .collect()
    })?;

    let refined_pixels = needs.iter().filter(|n| **n).count() as u64;
    let report = RenderReport {
        samples: (width * height) as u64 + refined_pixels * u64::from(params.edge_samples),
        refined_pixels,
    };
    Ok(Rendered { image: image(&refined, params), report })
}

/// Rows in parallel, in order.
fn rows(
    height: usize,
    progress: &dyn Progress,
    row: impl Fn(usize, &mut Scratch) -> Vec<Pixel> + Sync,
) -> Result<Vec<Pixel>, Cancelled> {
    let rows: Result<Vec<Vec<Pixel>>, Cancelled> = (0..height)
        .into_par_iter()
        .map(|y| {
            if progress.is_cancelled() {
                return Err(Cancelled);
            }
            let pixels = row(y, &mut Scratch::default());
            progress.advance(1);
            Ok(pixels)
        })
        .collect();
    Ok(rows?.into_iter().flatten().collect())
}

fn shoot(
    eye: &Eye,
    camera: &Camera,
    params: &RenderParams,
    (x, y): (usize, usize),
    (dx, dy): (f32, f32),
    key: Key,
    scratch: &mut Scratch,
) -> Sample {
    let (origin, direction) = camera.ray(x as f32 + dx, y as f32 + dy, params.width, params.height);
    let footprint = params.mesh.then(|| {
        let (beside, other) = camera.ray(x as f32 + dx + 1.0, y as f32 + dy, params.width, params.height);
        Footprint { width: origin.distance(beside), spread: direction.distance(other) }
    });
    eye.sample(origin + direction * camera.near, direction, footprint, key, scratch)
}

/// The mean of a pixel's own grid of samples (box filter).
fn resample(
    eye: &Eye,
    camera: &Camera,
    params: &RenderParams,
    at: (usize, usize),
    first: &Pixel,
    scratch: &mut Scratch,
) -> Pixel {
    let key = Key::new(params.seed, Purpose::Pixel, (at.1 * params.width + at.0) as u64).child(1);
    let mut light = LightLayers::default();
    let mut lines = 0.0;
    for index in 0..params.edge_samples {
        let offset = key.point2(index);
        let sample = shoot(eye, camera, params, at, (offset.x, offset.y), key.child(index), scratch);
        light.accumulate(&sample.light);
        lines += sample.lines;
    }
    let share = 1.0 / params.edge_samples.max(1) as f32;
    light.scale(share);
    Pixel { light, lines: lines * share, ..*first }
}

fn mean_luminance(pixels: &[Pixel]) -> f32 {
    let sum: f64 = pixels.iter().map(|p| f64::from(p.light.beauty().dot(LUMINANCE))).sum();
    (sum / pixels.len().max(1) as f64) as f32
}

/// Whether a pixel's neighbours met other things, or differ in brightness by more than `contrast`.
fn needs_more(
    pixels: &[Pixel],
    width: usize,
    height: usize,
    x: usize,
    y: usize,
    exposure: f32,
    contrast: f32,
) -> bool {
    let own = &pixels[y * width + x];
    let shown = |p: &Pixel| {
        // Differences count as they are seen: relative in the light, absolute in the dark.
        let beauty: Rgb = p.light.beauty();
        (beauty / exposure + Rgb::splat(0.1)).map(libm::logf)
    };
    let tone = shown(own);
    for (dx, dy) in [(-1_i64, 0_i64), (1, 0), (0, -1), (0, 1), (-1, -1), (1, -1), (-1, 1), (1, 1)] {
        let (nx, ny) = (x as i64 + dx, y as i64 + dy);
        if nx < 0 || ny < 0 || nx >= width as i64 || ny >= height as i64 {
            continue;
        }
        let other = &pixels[ny as usize * width + nx as usize];
        if other.trail != own.trail || (shown(other) - tone).abs().max_element() > contrast {
            return true;
        }
    }
    false
}

/// Puts the layers into an image.
fn image(pixels: &[Pixel], params: &RenderParams) -> Image {
    let mut image = Image::new(params.width, params.height);
    let rgb = |value: &dyn Fn(&Pixel) -> Rgb| -> Vec<[f32; 3]> {
        pixels.iter().map(|p| value(p).to_array()).collect()
    };
    image.push_rgb_layer("", &rgb(&|p| p.light.beauty()));
    if params.layers {
        for (index, name) in NAMES.iter().enumerate() {
            image.push_rgb_layer(name, &rgb(&|p| p.light.values[index]));
        }
        image.push_rgb_layer("albedo", &rgb(&|p| p.first.albedo));
        for (axis, name) in ["normal.X", "normal.Y", "normal.Z"].into_iter().enumerate() {
            image.push_channel(name, pixels.iter().map(|p| p.first.normal[axis]).collect());
        }
        image.push_channel("depth.Z", pixels.iter().map(|p| p.first.depth).collect());
        image.push_channel("id.surface", pixels.iter().map(|p| p.first.surface as f32).collect());
    }
    if params.mesh {
        image.push_channel(LINES, pixels.iter().map(|p| p.lines.min(1.0)).collect());
    }
    image
}
