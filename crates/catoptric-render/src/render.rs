//! Pass two from end to end: samples, anti-aliasing, layers.
//!
//! Anti-aliasing is adaptive and unbiased: which pixels get more samples is decided by other samples than those that
//! they are made of. A first ray through each pixel's centre leaves a trail of what it met; pixels whose trail differs
//! from a neighbour's, or whose radiance bends, are sampled again on a grid of their own, and the first ray is not used.
//! Pixels in or beside a penumbra that shadow rays found are sampled again through the centre, by more of them.

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

use crate::direct::{DirectLight, ShadowRays};
use crate::layers::{LightLayers, NAMES};
use crate::lines::{Footprint, LAYER as LINES};
use crate::pixel::{Eye, Sample};

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
    /// Where their light on diffuse surfaces comes from.
    pub direct: DirectLight,
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
            direct: DirectLight::Vertices,
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
    /// Of them, those where only a penumbra was seen, by one sample.
    pub penumbra_pixels: u64,
}

/// The result of pass two.
#[derive(Clone, Debug)]
pub struct Rendered {
    /// The image: beauty and, if asked for, layers.
    pub image: Image,
    /// What was done.
    pub report: RenderReport,
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
                shoot(&eye, camera, params, (x, y), (0.5, 0.5), shadow_rays(params, 0), key, scratch)
            })
            .collect()
    })?;

    // Pixels beside an edge are made of new samples.
    let exposure = mean_luminance(&first).max(1e-30);
    let needs: Vec<Need> = (0..width * height)
        .map(|i| needs_more(&first, width, height, i % width, i / width, exposure, params.contrast))
        .collect();
    let refined = rows(height, progress, |y, scratch| {
        (0..width)
            .map(|x| {
                let index = y * width + x;
                match needs[index] {
                    Need::Nothing => first[index],
                    Need::Shadows => {
                        let key = again(params, (x, y)).child(0);
                        let rays = shadow_rays(params, 1);
                        let sample = shoot(&eye, camera, params, (x, y), (0.5, 0.5), rays, key, scratch);
                        Sample { light: sample.light, ..first[index] }
                    }
                    Need::Samples => resample(&eye, camera, params, (x, y), &first[index], scratch),
                }
            })
            .collect()
    })?;

    let count = |need: Need| needs.iter().filter(|n| **n == need).count() as u64;
    let (edges, penumbra_pixels) = (count(Need::Samples), count(Need::Shadows));
    let report = RenderReport {
        samples: (width * height) as u64 + edges * u64::from(params.edge_samples) + penumbra_pixels,
        refined_pixels: edges + penumbra_pixels,
        penumbra_pixels,
    };
    Ok(Rendered { image: image(&refined, params), report })
}

/// Rows in parallel, in order.
fn rows(
    height: usize,
    progress: &dyn Progress,
    row: impl Fn(usize, &mut Scratch) -> Vec<Sample> + Sync,
) -> Result<Vec<Sample>, Cancelled> {
    let rows: Result<Vec<Vec<Sample>>, Cancelled> = (0..height)
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
    shadow_rays: Option<u32>,
    key: Key,
    scratch: &mut Scratch,
) -> Sample {
    let (origin, direction) = camera.ray(x as f32 + dx, y as f32 + dy, params.width, params.height);
    let footprint = params.mesh.then(|| {
        let (beside, other) = camera.ray(x as f32 + dx + 1.0, y as f32 + dy, params.width, params.height);
        Footprint { width: origin.distance(beside), spread: direction.distance(other) }
    });
    eye.sample(origin + direction * camera.near, direction, footprint, shadow_rays, key, scratch)
}

/// The mean of a pixel's own grid of samples (box filter).
fn resample(
    eye: &Eye,
    camera: &Camera,
    params: &RenderParams,
    at: (usize, usize),
    first: &Sample,
    scratch: &mut Scratch,
) -> Sample {
    let key = again(params, at);
    let rays = shadow_rays(params, params.edge_samples);
    let mut light = LightLayers::default();
    let mut lines = 0.0;
    for index in 0..params.edge_samples {
        let offset = key.point2(index);
        let sample = shoot(eye, camera, params, at, (offset.x, offset.y), rays, key.child(index), scratch);
        light.accumulate(&sample.light);
        lines += sample.lines;
    }
    let share = 1.0 / params.edge_samples.max(1) as f32;
    light.scale(share);
    Sample { light, lines: lines * share, ..*first }
}

fn mean_luminance(pixels: &[Sample]) -> f32 {
    let sum: f64 = pixels.iter().map(|p| f64::from(p.light.beauty().dot(LUMINANCE))).sum();
    (sum / pixels.len().max(1) as f64) as f32
}

/// What a pixel is sampled again for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Need {
    /// The first ray is enough.
    Nothing,
    /// A penumbra calls for more shadow rays.
    Shadows,
    /// An edge calls for more samples.
    Samples,
}

/// Shadow rays of a sample: the first one of a pixel (`again` = 0), or one of so many that are taken again.
fn shadow_rays(params: &RenderParams, again: u32) -> Option<u32> {
    match params.direct {
        DirectLight::Vertices => None,
        DirectLight::Pixels(ShadowRays { first, .. }) if again == 0 => Some(first),
        // Those of several samples do not share their strata.
        DirectLight::Pixels(ShadowRays { penumbra, .. }) if again == 1 => Some(penumbra),
        DirectLight::Pixels(ShadowRays { penumbra, .. }) => Some((2 * penumbra / again).max(1)),
    }
}

/// Key of the samples that a pixel is made of where its first one is not used.
fn again(params: &RenderParams, (x, y): (usize, usize)) -> Key {
    Key::new(params.seed, Purpose::Pixel, (y * params.width + x) as u64).child(1)
}

/// Times `contrast` by which penumbrae differ from pixel to pixel where they are as sharp as an edge; less may be the noise
/// of few shadow rays.
const SHARP: f32 = 5.0;

/// Whether a pixel's neighbours met other things, or differ in brightness by more than `contrast`.
fn needs_more(
    pixels: &[Sample],
    width: usize,
    height: usize,
    x: usize,
    y: usize,
    exposure: f32,
    contrast: f32,
) -> Need {
    let own = &pixels[y * width + x];
    // Differences count as they are seen: relative in the light, absolute in the dark.
    let shown = |light: Rgb| (light / exposure + Rgb::splat(0.1)).map(libm::logf);
    let (tone, open) = (shown(own.light.beauty()), shown(own.open));
    let mut need = if own.penumbra { Need::Shadows } else { Need::Nothing };
    for (dx, dy) in [(-1_i64, 0_i64), (1, 0), (0, -1), (0, 1), (-1, -1), (1, -1), (-1, 1), (1, 1)] {
        let (nx, ny) = (x as i64 + dx, y as i64 + dy);
        if nx < 0 || ny < 0 || nx >= width as i64 || ny >= height as i64 {
            continue;
        }
        let other = &pixels[ny as usize * width + nx as usize];
        let difference = (shown(other.light.beauty()) - tone).abs().max_element();
        let is_edge = if own.penumbra || other.penumbra {
            need = Need::Shadows;
            difference > SHARP * contrast || (shown(other.open) - open).abs().max_element() > contrast
        } else {
            difference > contrast
        };
        if other.trail != own.trail || is_edge {
            return Need::Samples;
        }
    }
    need
}

/// Puts the layers into an image.
fn image(pixels: &[Sample], params: &RenderParams) -> Image {
    let mut image = Image::new(params.width, params.height);
    let rgb = |value: &dyn Fn(&Sample) -> Rgb| -> Vec<[f32; 3]> {
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
