//! FLIP: what a viewer notices when two images alternate on a screen.
//!
//! LDR-FLIP: Andersson, Nilsson, Akenine-Möller, Oskarsson, Åström & Fairchild, "FLIP: A Difference Evaluator for
//! Alternating Images", HPG 2020. HDR-FLIP: Andersson, Nilsson, Shirley & Akenine-Möller, "Visualizing Errors in Rendered
//! High Dynamic Range Images", EG 2021. Equations are those of the papers; the constants, the tone mapper (ACES), the
//! exposure range and the separation of the filters follow the reference implementation 1.7 (BSD-3-Clause, NVIDIA).
//!
//! Where we deviate: the two sRGB conversions around the tone mapper cancel and are left out; achromatic and red–green
//! filters are cut where their weights fall below 1e-7 of the largest; powers are polynomials. The tests hold the means to
//! 1e-4 of the reference implementation.
//!
//! Images are walked in tiles that fit the cache, both images of a tile at once, all exposures before the next tile.

use pulp::Arch;
use rayon::prelude::*;

use super::fast_math::{cbrt, pow};

/// Pixels per degree of visual angle: a screen of 3840 pixels over 0.7 m seen from 0.7 m.
pub const DEFAULT_PPD: f32 = 3840.0 * std::f32::consts::PI / 180.0;

const TILE_WIDTH: usize = 256;
const TILE_HEIGHT: usize = 64;
/// Lanes the inner loops are written for.
const LANES: usize = 16;

/// Exponent and remapping of the colour difference, spatial width and exponent of features (paper, table 1).
const Q_COLOUR: f32 = 0.7;
const P_C: f32 = 0.4;
const P_T: f32 = 0.95;
const FEATURE_WIDTH: f32 = 0.082;

/// How an image becomes display-referred.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Exposures {
    /// It is display-referred already: values are linear light in `[0, 1]`.
    None,
    /// The largest error over this range of exposures, in stops, both ends included.
    Range {
        /// First exposure.
        start: f32,
        /// Last exposure.
        stop: f32,
        /// How many, at least two.
        count: usize,
    },
}

impl Exposures {
    /// The range HDR-FLIP derives from the reference: from "its brightest pixel maps to 85 % of white" to "its median
    /// does", about one exposure per stop (EG 2021, section 4).
    pub fn of_reference(reference: &[[f32; 3]]) -> Exposures {
        // Luminance that the tone mapper sends to 0.85: the larger root of a quadratic.
        let [a, b, c] = [ACES[0] - 0.85 * ACES[3], ACES[1] - 0.85 * ACES[4], ACES[2] - 0.85 * ACES[5]];
        let half = -0.5 * (b / a);
        let white = half + (half * half - c / a).sqrt();
        let mut luminance: Vec<f32> = reference
            .par_iter()
            .map(|p| 0.2126 * p[0].max(0.0) + 0.7152 * p[1].max(0.0) + 0.0722 * p[2].max(0.0))
            .collect();
        let n = luminance.len();
        if n == 0 {
            return Exposures::Range { start: 0.0, stop: 0.0, count: 2 };
        }
        let brightest = luminance.par_iter().copied().reduce(|| 0.0, f32::max).max(f32::MIN_POSITIVE);
        // Of an even number of pixels the implementation takes the upper median.
        let (_, &mut median, _) = luminance.select_nth_unstable_by(n / 2, f32::total_cmp);
        let median = median.max(f32::MIN_POSITIVE);
        let (start, stop) = (libm::log2f(white / brightest), libm::log2f(white / median));
        Exposures::Range { start, stop, count: ((stop - start).ceil() as usize).max(2) }
    }

    /// The factors light is multiplied with.
    fn gains(self) -> Vec<Option<f32>> {
        match self {
            Exposures::None => vec![None],
            Exposures::Range { start, stop, count } => (0..count)
                .map(|i| Some(libm::exp2f(start + i as f32 * ((stop - start) / (count.max(2) - 1) as f32))))
                .collect(),
        }
    }
}

/// The ACES tone mapper of the reference implementation: (a x² + b x + c) / (d x² + e x + f).
const ACES: [f32; 6] = [0.6 * 0.6 * 2.51, 0.6 * 0.03, 0.0, 0.6 * 0.6 * 2.43, 0.6 * 0.59, 0.14];

/// The FLIP error of every pixel, in `[0, 1]`. `reference` and `test` are linear Rec. 709, finite.
pub fn error_map(
    width: usize,
    height: usize,
    reference: &[[f32; 3]],
    test: &[[f32; 3]],
    exposures: Exposures,
    ppd: f32,
) -> Vec<f32> {
    let filters = Filters::new(ppd);
    let gains = exposures.gains();
    let tiles_x = width.div_ceil(TILE_WIDTH);
    let tiles: Vec<(usize, usize)> = (0..tiles_x * height.div_ceil(TILE_HEIGHT))
        .map(|t| (t % tiles_x * TILE_WIDTH, t / tiles_x * TILE_HEIGHT))
        .collect();
    let arch = Arch::new();
    let errors: Vec<Vec<f32>> = tiles
        .par_iter()
        .map_init(
            || Workspace::new(filters.radius),
            |workspace, &(left, top)| {
                let tile = Tile {
                    left,
                    top,
                    width: TILE_WIDTH.min(width - left),
                    height: TILE_HEIGHT.min(height - top),
                };
                let mut worst = vec![0.0; tile.width * tile.height];
                for &gain in &gains {
                    // The closure is compiled for the widest vectors of this machine; without fused operations the bits
                    // are the same on all.
                    arch.dispatch(|| {
                        workspace.images[0].filter(&tile, reference, width, height, gain, &filters);
                        workspace.images[1].filter(&tile, test, width, height, gain, &filters);
                        workspace.difference(&tile, &filters, &mut worst);
                    });
                }
                worst
            },
        )
        .collect();

    // Put the tiles together.
    let mut map = vec![0.0; width * height];
    for (&(left, top), errors) in tiles.iter().zip(&errors) {
        let tile_width = TILE_WIDTH.min(width - left);
        for (row, line) in errors.chunks_exact(tile_width).enumerate() {
            let start = (top + row) * width + left;
            map[start..start + tile_width].copy_from_slice(line);
        }
    }
    map
}

struct Tile {
    left: usize,
    top: usize,
    width: usize,
    height: usize,
}

/// One-dimensional filters, all of the same odd length so that every pass reads the same neighbourhood.
struct Filters {
    radius: usize,
    /// Contrast sensitivity: achromatic, red–green, and the two Gaussians whose sum is blue–yellow.
    luminance: Taps,
    red_green: Taps,
    blue_yellow: [Taps; 2],
    /// Feature detection: Gaussian and its first and second derivative.
    gauss: Taps,
    edge: Taps,
    point: Taps,
    /// Largest colour difference to the power Q_COLOUR: green against blue.
    largest: f32,
}

/// Weights, and where the first of them lies in the common neighbourhood.
struct Taps {
    first: usize,
    weights: Vec<f32>,
}

impl Taps {
    /// Drops the weights that add nothing in single precision.
    fn new(weights: &[f64], radius: usize) -> Taps {
        let own = weights.len() / 2;
        let largest = weights.iter().fold(0.0f64, |m, w| m.max(w.abs()));
        let keep = (0..=own).rev().find(|k| weights[own + k].abs() > 1e-7 * largest).unwrap_or(0);
        Taps {
            first: radius - keep,
            weights: weights[own - keep..=own + keep].iter().map(|&w| w as f32).collect(),
        }
    }
}

impl Filters {
    fn new(ppd: f32) -> Filters {
        use std::f64::consts::PI;
        let ppd = f64::from(ppd);
        // Gaussians of contrast sensitivity, amplitude a and scale b (paper, table 1).
        let spatial = (3.0 * (0.04 / (2.0 * PI * PI)).sqrt() * ppd).ceil() as i32;
        let gaussian = |amplitude: f64, b: f64| -> Vec<f64> {
            (-spatial..=spatial)
                .map(|x| amplitude * libm::exp(-PI * PI * (f64::from(x) / ppd) * (f64::from(x) / ppd) / b))
                .collect()
        };
        let normalised = |weights: Vec<f64>| {
            let sum: f64 = weights.iter().sum();
            weights.into_iter().map(|w| w / sum).collect::<Vec<_>>()
        };
        let amplitude = |a: f64, b: f64| (a * (PI / b).sqrt()).sqrt();
        let [z1, z2] = [gaussian(amplitude(34.1, 0.04), 0.04), gaussian(amplitude(13.5, 0.025), 0.025)];
        let [s1, s2]: [f64; 2] = [z1.iter().sum(), z2.iter().sum()];
        let norm = (s1 * s1 + s2 * s2).sqrt();

        // Feature detectors: positive and negative weights of the derivatives sum to one each.
        let deviation = 0.5 * f64::from(FEATURE_WIDTH) * ppd;
        let reach = (3.0 * deviation).ceil() as i32;
        let bell = |x: i32| libm::exp(-f64::from(x * x) / (2.0 * deviation * deviation));
        let balanced = |weights: Vec<f64>| {
            let positive: f64 = weights.iter().filter(|w| **w > 0.0).sum();
            let negative: f64 = -weights.iter().filter(|w| **w < 0.0).sum::<f64>();
            weights.into_iter().map(|w| if w > 0.0 { w / positive } else { w / negative }).collect::<Vec<_>>()
        };
        let radius = spatial.max(reach) as usize;
        let scaled = |weights: &[f64]| weights.iter().map(|w| w / norm).collect::<Vec<_>>();
        let edge = (-reach..=reach).map(|x| -f64::from(x) * bell(x)).collect();
        let point =
            (-reach..=reach).map(|x| (f64::from(x * x) / (deviation * deviation) - 1.0) * bell(x)).collect();
        let hunt = |rgb: [f32; 3]| hunt_lab(rgb);
        Filters {
            radius,
            luminance: Taps::new(&normalised(gaussian(1.0, 0.0047)), radius),
            red_green: Taps::new(&normalised(gaussian(1.0, 0.0053)), radius),
            blue_yellow: [Taps::new(&scaled(&z1), radius), Taps::new(&scaled(&z2), radius)],
            gauss: Taps::new(&normalised((-reach..=reach).map(bell).collect()), radius),
            edge: Taps::new(&balanced(edge), radius),
            point: Taps::new(&balanced(point), radius),
            largest: pow(hyab(hunt([0.0, 1.0, 0.0]), hunt([0.0, 0.0, 1.0])), Q_COLOUR),
        }
    }
}

/// Buffers of one thread.
struct Workspace {
    images: [Filtered; 2],
}

/// One image of a tile: planes with a border, after the horizontal pass, and after the vertical pass.
struct Filtered {
    stride: usize,
    planes: [Vec<f32>; 3],
    /// Luminance, red–green, blue–yellow twice, Gaussian, edge, point: filtered along rows.
    rows: [Vec<f32>; 7],
    /// Hunt-adjusted Lab, edge and point strength of every pixel of the tile.
    lab: [Vec<f32>; 3],
    edge: Vec<f32>,
    point: Vec<f32>,
}

impl Workspace {
    fn new(radius: usize) -> Workspace {
        Workspace { images: [Filtered::new(radius), Filtered::new(radius)] }
    }

    /// Final error of a tile: the colour difference to the power 1 − feature difference; keeps the largest.
    #[inline(always)]
    fn difference(&self, tile: &Tile, filters: &Filters, worst: &mut [f32]) {
        let [reference, test] = &self.images;
        let knee = P_C * filters.largest;
        for y in 0..tile.height {
            let [l0, a0, b0] = [0, 1, 2].map(|k: usize| line_of(&reference.lab[k], y, tile));
            let [l1, a1, b1] = [0, 1, 2].map(|k: usize| line_of(&test.lab[k], y, tile));
            let (e0, e1) = (line_of(&reference.edge, y, tile), line_of(&test.edge, y, tile));
            let (p0, p1) = (line_of(&reference.point, y, tile), line_of(&test.point, y, tile));
            let out = &mut worst[y * tile.width..(y + 1) * tile.width];
            for x in 0..tile.width {
                let colour = pow(hyab([l0[x], a0[x], b0[x]], [l1[x], a1[x], b1[x]]), Q_COLOUR);
                // Differences below the knee spread over [0, P_T], the others over the rest.
                let low = colour * (P_T / knee);
                let high = P_T + (colour - knee) / (filters.largest - knee) * (1.0 - P_T);
                let colour = if colour < knee { low } else { high };
                let feature = (e0[x] - e1[x]).abs().max((p0[x] - p1[x]).abs());
                let feature = (feature * std::f32::consts::FRAC_1_SQRT_2).sqrt();
                out[x] = out[x].max(pow(colour, 1.0 - feature));
            }
        }
    }
}

#[inline(always)]
fn line_of<'a>(plane: &'a [f32], y: usize, tile: &Tile) -> &'a [f32] {
    &plane[y * TILE_WIDTH..(y + 1) * TILE_WIDTH][..tile.width]
}

impl Filtered {
    fn new(radius: usize) -> Filtered {
        // Room for the border, and for the last group of lanes to run over the end.
        let stride = TILE_WIDTH + 2 * radius + LANES;
        let lines = TILE_HEIGHT + 2 * radius;
        let tile = || vec![0.0; TILE_WIDTH * TILE_HEIGHT];
        Filtered {
            stride,
            planes: std::array::from_fn(|_| vec![0.0; stride * lines]),
            rows: std::array::from_fn(|_| vec![0.0; TILE_WIDTH * lines]),
            lab: std::array::from_fn(|_| tile()),
            edge: tile(),
            point: tile(),
        }
    }

    /// Exposes, tone maps and filters one tile of an image.
    #[inline(always)]
    fn filter(
        &mut self,
        tile: &Tile,
        pixels: &[[f32; 3]],
        width: usize,
        height: usize,
        gain: Option<f32>,
        filters: &Filters,
    ) {
        let radius = filters.radius;
        let lines = tile.height + 2 * radius;
        let groups = tile.width.div_ceil(LANES);

        // Opponent colours with a border; pixels outside repeat the nearest one inside.
        for line in 0..lines {
            let y = (tile.top + line).saturating_sub(radius).min(height - 1);
            let source = &pixels[y * width..(y + 1) * width];
            let [first, second, third] = &mut self.planes;
            let range = line * self.stride..(line + 1) * self.stride;
            let (first, second, third) =
                (&mut first[range.clone()], &mut second[range.clone()], &mut third[range]);
            for x in 0..tile.width + 2 * radius {
                let rgb = source[(tile.left + x).saturating_sub(radius).min(width - 1)];
                [first[x], second[x], third[x]] = rgb;
            }
            let groups = (tile.width + 2 * radius).div_ceil(LANES) * LANES;
            let planes =
                first[..groups].chunks_exact_mut(LANES).zip(second[..groups].chunks_exact_mut(LANES));
            for ((first, second), third) in planes.zip(third[..groups].chunks_exact_mut(LANES)) {
                for lane in 0..LANES {
                    let rgb = [first[lane], second[lane], third[lane]].map(|v| display(v, gain));
                    [first[lane], second[lane], third[lane]] = ycxcz(rgb);
                }
            }
        }

        // Filter along rows.
        let [luminance, red_green, blue_yellow] = &self.planes;
        let taps = [
            (luminance, &filters.luminance),
            (red_green, &filters.red_green),
            (blue_yellow, &filters.blue_yellow[0]),
            (blue_yellow, &filters.blue_yellow[1]),
            (luminance, &filters.gauss),
            (luminance, &filters.edge),
            (luminance, &filters.point),
        ];
        for ((source, taps), target) in taps.into_iter().zip(&mut self.rows) {
            for line in 0..lines {
                let source = &source[line * self.stride..(line + 1) * self.stride];
                let target = &mut target[line * TILE_WIDTH..(line + 1) * TILE_WIDTH];
                for group in 0..groups {
                    let sum = along_row(&source[group * LANES + taps.first..], &taps.weights);
                    target[group * LANES..(group + 1) * LANES].copy_from_slice(&sum);
                }
            }
        }

        // Filter along columns and finish each pixel.
        for y in 0..tile.height {
            for group in 0..groups {
                let at = y * TILE_WIDTH + group * LANES;
                let column = |plane: usize, taps: &Taps| {
                    along_column(&self.rows[plane][at + taps.first * TILE_WIDTH..], &taps.weights)
                };
                let y_ = column(0, &filters.luminance);
                let cx = column(1, &filters.red_green);
                let cz1 = column(2, &filters.blue_yellow[0]);
                let cz2 = column(3, &filters.blue_yellow[1]);
                let edge_y = column(4, &filters.edge);
                let point_y = column(4, &filters.point);
                let edge_x = column(5, &filters.gauss);
                let point_x = column(6, &filters.gauss);
                // Whole groups of lanes in arrays: no bounds are checked between them, so they are vectorised.
                let mut out = [[0.0; LANES]; 5];
                for lane in 0..LANES {
                    let rgb = rgb_of_ycxcz([y_[lane], cx[lane], cz1[lane] + cz2[lane]]);
                    let [l, a, b] = hunt_lab(rgb.map(|v| v.clamp(0.0, 1.0)));
                    // Luminance in [0,1] is (Y + 16)/116; the constant falls to the derivatives' zero sum.
                    let edge = length(edge_x[lane], edge_y[lane]);
                    let point = length(point_x[lane], point_y[lane]);
                    out[0][lane] = l;
                    out[1][lane] = a;
                    out[2][lane] = b;
                    out[3][lane] = edge;
                    out[4][lane] = point;
                }
                let [l, a, b] = &mut self.lab;
                for (plane, values) in [l, a, b, &mut self.edge, &mut self.point].into_iter().zip(&out) {
                    plane[at..at + LANES].copy_from_slice(values);
                }
            }
        }
    }
}

/// Length of a gradient of luminance Y, for luminance in `[0, 1]`.
#[inline(always)]
fn length(x: f32, y: f32) -> f32 {
    (x * x + y * y).sqrt() / 116.0
}

#[inline(always)]
fn along_row(source: &[f32], weights: &[f32]) -> [f32; LANES] {
    let mut sum = [0.0; LANES];
    let source = &source[..weights.len() - 1 + LANES];
    for (k, &weight) in weights.iter().enumerate() {
        let values = &source[k..k + LANES];
        for lane in 0..LANES {
            sum[lane] += weight * values[lane];
        }
    }
    sum
}

#[inline(always)]
fn along_column(source: &[f32], weights: &[f32]) -> [f32; LANES] {
    let mut sum = [0.0; LANES];
    let source = &source[..(weights.len() - 1) * TILE_WIDTH + LANES];
    for (k, &weight) in weights.iter().enumerate() {
        let values = &source[k * TILE_WIDTH..k * TILE_WIDTH + LANES];
        for lane in 0..LANES {
            sum[lane] += weight * values[lane];
        }
    }
    sum
}

/// Linear light in `[0, 1]` on the display.
#[inline(always)]
fn display(light: f32, gain: Option<f32>) -> f32 {
    let shown = match gain {
        None => light,
        Some(gain) => {
            // Beyond 1e6 the curve is flat; without the bound its terms overflow.
            let x = (light * gain).clamp(0.0, 1e6);
            (x * (ACES[0] * x + ACES[1]) + ACES[2]) / (x * (ACES[3] * x + ACES[4]) + ACES[5])
        }
    };
    shown.clamp(0.0, 1.0)
}

/// XYZ relative to the D65 white: rows of the matrix of the reference implementation divided by its illuminant.
#[inline(always)]
fn relative_xyz(rgb: [f32; 3]) -> [f32; 3] {
    const X: f32 = 1.052_156_9 / 24_577_794.0;
    const Y: f32 = 1.0 / 12_288_897.0;
    const Z: f32 = 0.918_357_7 / 73_733_382.0;
    let [r, g, b] = rgb;
    [
        (10_135_552.0 * X) * r + (8_788_810.0 * X) * g + (4_435_075.0 * X) * b,
        (2_613_072.0 * Y) * r + (8_788_810.0 * Y) * g + (887_015.0 * Y) * b,
        (1_425_312.0 * Z) * r + (8_788_810.0 * Z) * g + (70_074_185.0 * Z) * b,
    ]
}

#[inline(always)]
fn ycxcz(rgb: [f32; 3]) -> [f32; 3] {
    let [x, y, z] = relative_xyz(rgb);
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

#[inline(always)]
fn rgb_of_ycxcz([y, cx, cz]: [f32; 3]) -> [f32; 3] {
    let y = (y + 16.0) / 116.0;
    let x = (y + cx / 500.0) * 0.950_428_55;
    let z = (y - cz / 200.0) * 1.088_900_4;
    [
        3.241_003_3 * x - 1.537_398_9 * y - 0.498_615_86 * z,
        -0.969_224_33 * x + 1.875_930_1 * y + 0.041_554_224 * z,
        0.055_639_423 * x - 0.204_011_2 * y + 1.057_148_9 * z,
    ]
}

/// CIELab with chroma scaled by lightness (Hunt effect).
#[inline(always)]
fn hunt_lab(rgb: [f32; 3]) -> [f32; 3] {
    const DELTA: f32 = 6.0 / 29.0;
    let f = |v: f32| {
        let root = cbrt(v.max(1e-6));
        if v > DELTA * DELTA * DELTA { root } else { v / (3.0 * DELTA * DELTA) + 4.0 / 29.0 }
    };
    let [x, y, z] = relative_xyz(rgb).map(f);
    let l = 116.0 * y - 16.0;
    [l, 0.01 * l * (500.0 * (x - y)), 0.01 * l * (200.0 * (y - z))]
}

/// City-block distance in lightness plus Euclidean distance in chroma (Abasi, Amani Tehran & Fairchild 2020).
#[inline(always)]
fn hyab(p: [f32; 3], q: [f32; 3]) -> f32 {
    let (a, b) = (p[1] - q[1], p[2] - q[2]);
    (p[0] - q[0]).abs() + (a * a + b * b).sqrt()
}
