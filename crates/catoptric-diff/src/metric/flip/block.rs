//! One block of the image, a few lines at a time: nothing of the image's size lives between the pixels and the error.
//!
//! Lines enter at the bottom of a window, as many as the column filters reach over plus a batch. Each row of the batch is
//! filtered along its columns into one line, and that along the row. Then the window moves down the image. Both windows fit
//! the second-level cache, the lines the first.
//!
//! Inner loops are over arrays of `LANES` numbers so that no bounds are checked inside and the compiler vectorises them.

use pulp::{Simd, WithSimd};

use super::colour::{hunt_lab, hyab, rgb_of_ycxcz, ycxcz};
use super::fast_math::{larger, pow};
use super::filters::{Filters, Half};
use super::{ACES, P_C, P_T, Q_COLOUR};
use crate::planes::Planes;

/// Columns of a block.
pub(super) const WIDTH: usize = 256;
/// Rows of a block.
pub(super) const HEIGHT: usize = 120;
/// Rows finished between two moves of the window.
const BATCH: usize = 40;
const LANES: usize = 32;

type Lanes = [f32; LANES];

/// How light becomes what a display shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Display {
    /// It is display light already.
    AsItIs,
    /// Multiplied by a gain and tone mapped.
    Exposed(f32),
    /// Multiplied by a gain and rounded to sRGB bytes.
    Bytes(f32),
}

/// Where a block lies, and its part of the error map.
pub(super) struct Block<'a> {
    pub(super) left: usize,
    pub(super) top: usize,
    pub(super) lines: Vec<&'a mut [f32]>,
}

/// An image and its size.
#[derive(Clone, Copy)]
pub(super) struct Picture<'a> {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) planes: &'a Planes,
}

impl Block<'_> {
    fn width(&self) -> usize {
        self.lines.first().map_or(0, |line| line.len())
    }

    /// Whether two images are the same wherever the filters look.
    pub(super) fn sees_no_difference(&self, a: Picture, b: Picture, radius: usize) -> bool {
        let columns = self.left.saturating_sub(radius)..(self.left + self.width() + radius).min(a.width);
        let mut rows = self.top.saturating_sub(radius)..(self.top + self.lines.len() + radius).min(a.height);
        rows.all(|y| {
            let range = y * a.width + columns.start..y * a.width + columns.end;
            (0..3).all(|k| a.planes.channels()[k][range.clone()] == b.planes.channels()[k][range.clone()])
        })
    }
}

/// The work on one block for one display, as [`pulp::Arch::dispatch`] takes it. It takes closures too, but those are not
/// always compiled for its instructions.
pub(super) struct Raise<'a, 'b> {
    pub(super) workspace: &'a mut Workspace,
    pub(super) block: &'a mut Block<'b>,
    /// Reference and test image.
    pub(super) pictures: [Picture<'a>; 2],
    pub(super) display: Display,
    pub(super) filters: &'a Filters,
}

impl WithSimd for Raise<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        self.workspace.raise(self.block, self.pictures, self.display, self.filters);
    }
}

/// Buffers of one thread.
pub(super) struct Workspace {
    images: [Window; 2],
}

impl Workspace {
    pub(super) fn new(filters: &Filters) -> Workspace {
        Workspace { images: [Window::new(filters.radius), Window::new(filters.radius)] }
    }

    /// Raises the errors of a block to those of this display.
    #[inline(always)]
    fn raise(
        &mut self,
        block: &mut Block,
        [reference, test]: [Picture; 2],
        display: Display,
        filters: &Filters,
    ) {
        let (left, top, width, height) = (block.left, block.top, block.width(), block.lines.len());
        let border = 2 * filters.radius;
        let [ours, theirs] = &mut self.images;
        let mut start = 0;
        while start < height {
            let rows = BATCH.min(height - start);
            // The first batch fills the whole window, later ones find the border above in it.
            let filled = if start == 0 { 0 } else { border };
            for slot in filled..border + rows {
                let y = (top + start + slot).saturating_sub(filters.radius).min(reference.height - 1);
                ours.enter(reference, left, y, width, slot, display, filters.radius);
                theirs.enter(test, left, y, width, slot, display, filters.radius);
            }
            for row in 0..rows {
                ours.filter_columns(row, width, filters);
                theirs.filter_columns(row, width, filters);
                let line = &mut block.lines[start + row];
                for (group, worst) in line.chunks_mut(LANES).enumerate() {
                    let a = ours.pixels(group * LANES, filters);
                    let b = theirs.pixels(group * LANES, filters);
                    for (worst, error) in worst.iter_mut().zip(difference(&a, &b, filters)) {
                        *worst = larger(*worst, error);
                    }
                }
            }
            ours.advance(rows, border);
            theirs.advance(rows, border);
            start += rows;
        }
    }
}

/// The lines of one image that the column filters can see.
struct Window {
    stride: usize,
    /// Opponent colours, with a border of columns on both sides.
    lines: [Vec<f32>; 3],
    /// The current line filtered along columns: luminance, red–green, blue–yellow twice, Gaussian, edge and point of
    /// luminance.
    line: [Vec<f32>; 7],
}

/// What FLIP compares: Hunt-adjusted Lab, edge and point strength.
type Seen = [Lanes; 5];

impl Window {
    fn new(radius: usize) -> Window {
        // Room for the last group of lanes to run over the end.
        let stride = (WIDTH + 2 * radius).next_multiple_of(LANES);
        Window {
            stride,
            lines: std::array::from_fn(|_| vec![0.0; stride * (BATCH + 2 * radius)]),
            line: std::array::from_fn(|_| vec![0.0; stride]),
        }
    }

    /// Displays row `y` of an image in a slot of the window.
    #[inline(always)]
    fn enter(
        &mut self,
        picture: Picture,
        left: usize,
        y: usize,
        width: usize,
        slot: usize,
        display: Display,
        radius: usize,
    ) {
        let slot = slot * self.stride..(slot + 1) * self.stride;
        let [first, second, third] = &mut self.lines;
        let mut lines = [&mut first[slot.clone()], &mut second[slot.clone()], &mut third[slot]];
        // Copy the row with its border; pixels outside the image repeat the nearest one inside.
        let first = left.saturating_sub(radius);
        let last = (left + width + radius).min(picture.width);
        let (before, length) = (first + radius - left, last - first);
        for (line, plane) in lines.iter_mut().zip(picture.planes.channels()) {
            let source = &plane[y * picture.width + first..y * picture.width + last];
            line[..before].fill(source[0]);
            line[before..before + length].copy_from_slice(source);
            line[before + length..width + 2 * radius].fill(source[length - 1]);
        }
        // To opponent colours.
        for group in 0..(width + 2 * radius).div_ceil(LANES) {
            let at = group * LANES;
            let mut rgb = [lanes(lines[0], at), lanes(lines[1], at), lanes(lines[2], at)];
            for channel in &mut rgb {
                show(channel, display);
            }
            let mut out = [[0.0; LANES]; 3];
            for lane in 0..LANES {
                let [y, cx, cz] = ycxcz([rgb[0][lane], rgb[1][lane], rgb[2][lane]]);
                (out[0][lane], out[1][lane], out[2][lane]) = (y, cx, cz);
            }
            for (line, out) in lines.iter_mut().zip(&out) {
                line[at..at + LANES].copy_from_slice(out);
            }
        }
    }

    /// Filters along columns: fills `line` for a row of the batch.
    #[inline(always)]
    fn filter_columns(&mut self, row: usize, width: usize, filters: &Filters) {
        let (radius, stride) = (filters.radius, self.stride);
        let [luminance, red_green, blue_yellow] = &self.lines;
        for group in 0..(width + 2 * radius).div_ceil(LANES) {
            let from = group * LANES;
            let at = row * stride + from;
            let [l, gauss, edge, point] = features(&luminance[at..], stride, filters);
            let rg = even(&red_green[at..], stride, radius, &filters.red_green);
            let by1 = even(&blue_yellow[at..], stride, radius, &filters.blue_yellow[0]);
            let by2 = even(&blue_yellow[at..], stride, radius, &filters.blue_yellow[1]);
            for (target, values) in self.line.iter_mut().zip([l, rg, by1, by2, gauss, edge, point]) {
                target[from..from + LANES].copy_from_slice(&values);
            }
        }
    }

    /// Filters `line` along the row and finishes a group of pixels.
    #[inline(always)]
    fn pixels(&self, column: usize, filters: &Filters) -> Seen {
        let radius = filters.radius;
        let [luminance, red_green, by1, by2, gauss, edge, point] = &self.line;
        let y_ = even(&luminance[column..], 1, radius, &filters.luminance);
        let cx = even(&red_green[column..], 1, radius, &filters.red_green);
        let cz1 = even(&by1[column..], 1, radius, &filters.blue_yellow[0]);
        let cz2 = even(&by2[column..], 1, radius, &filters.blue_yellow[1]);
        let edge_y = even(&edge[column..], 1, radius, &filters.gauss);
        let point_y = even(&point[column..], 1, radius, &filters.gauss);
        let [edge_x, point_x] = derivatives(&gauss[column..], 1, filters);
        let mut out = [[0.0; LANES]; 5];
        for lane in 0..LANES {
            let rgb = rgb_of_ycxcz([y_[lane], cx[lane], cz1[lane] + cz2[lane]]);
            let [l, a, b] =
                hunt_lab([rgb[0].clamp(0.0, 1.0), rgb[1].clamp(0.0, 1.0), rgb[2].clamp(0.0, 1.0)]);
            (out[0][lane], out[1][lane], out[2][lane]) = (l, a, b);
            // Luminance in [0,1] is (Y + 16)/116; the constant falls to the derivatives' zero sum.
            out[3][lane] = length(edge_x[lane], edge_y[lane]);
            out[4][lane] = length(point_x[lane], point_y[lane]);
        }
        out
    }

    /// Moves the lines that the next batch sees too to the top.
    fn advance(&mut self, rows: usize, border: usize) {
        for plane in &mut self.lines {
            plane.copy_within(rows * self.stride..(rows + border) * self.stride, 0);
        }
    }
}

#[inline(always)]
fn lanes(line: &[f32], at: usize) -> Lanes {
    let mut lanes = [0.0; LANES];
    lanes.copy_from_slice(&line[at..at + LANES]);
    lanes
}

/// Adds weight × (a + b).
#[inline(always)]
fn add_even(sum: &mut Lanes, weight: f32, a: &Lanes, b: &Lanes) {
    for lane in 0..LANES {
        sum[lane] += weight * (a[lane] + b[lane]);
    }
}

/// Adds weight × (b − a).
#[inline(always)]
fn add_odd(sum: &mut Lanes, weight: f32, a: &Lanes, b: &Lanes) {
    for lane in 0..LANES {
        sum[lane] += weight * (b[lane] - a[lane]);
    }
}

#[inline(always)]
fn times(weight: f32, lanes: &Lanes) -> Lanes {
    let mut out = [0.0; LANES];
    for lane in 0..LANES {
        out[lane] = weight * lanes[lane];
    }
    out
}

/// An even filter of samples that lie `step` apart. `source` begins `radius` steps before the first lane.
#[inline(always)]
fn even(source: &[f32], step: usize, radius: usize, half: &Half) -> Lanes {
    let source = &source[..2 * radius * step + LANES];
    let mut sum = times(half[0], &lanes(source, radius * step));
    for (k, &weight) in half.iter().enumerate().skip(1) {
        let (a, b) = (lanes(source, (radius - k) * step), lanes(source, (radius + k) * step));
        add_even(&mut sum, weight, &a, &b);
    }
    sum
}

/// Luminance's contrast sensitivity, Gaussian, edge and point: four filters of the same samples.
#[inline(always)]
fn features(source: &[f32], step: usize, filters: &Filters) -> [Lanes; 4] {
    let radius = filters.radius;
    let source = &source[..2 * radius * step + LANES];
    let centre = lanes(source, radius * step);
    let mut luminance = times(filters.luminance[0], &centre);
    let mut gauss = times(filters.gauss[0], &centre);
    let mut point = times(filters.point[0], &centre);
    let mut edge = [0.0; LANES];
    for k in 1..filters.gauss.len() {
        let (a, b) = (lanes(source, (radius - k) * step), lanes(source, (radius + k) * step));
        if let Some(&weight) = filters.luminance.get(k) {
            add_even(&mut luminance, weight, &a, &b);
        }
        add_even(&mut gauss, filters.gauss[k], &a, &b);
        add_even(&mut point, filters.point[k], &a, &b);
        add_odd(&mut edge, filters.edge[k], &a, &b);
    }
    [luminance, gauss, edge, point]
}

/// Edge and point of the same samples.
#[inline(always)]
fn derivatives(source: &[f32], step: usize, filters: &Filters) -> [Lanes; 2] {
    let radius = filters.radius;
    let source = &source[..2 * radius * step + LANES];
    let mut point = times(filters.point[0], &lanes(source, radius * step));
    let mut edge = [0.0; LANES];
    for k in 1..filters.edge.len() {
        let (a, b) = (lanes(source, (radius - k) * step), lanes(source, (radius + k) * step));
        add_even(&mut point, filters.point[k], &a, &b);
        add_odd(&mut edge, filters.edge[k], &a, &b);
    }
    [edge, point]
}

/// Final error: the colour difference to the power 1 − feature difference.
#[inline(always)]
fn difference(a: &Seen, b: &Seen, filters: &Filters) -> Lanes {
    let knee = P_C * filters.largest;
    let mut out = [0.0; LANES];
    for lane in 0..LANES {
        let colour =
            pow(hyab([a[0][lane], a[1][lane], a[2][lane]], [b[0][lane], b[1][lane], b[2][lane]]), Q_COLOUR);
        // Differences below the knee spread over [0, P_T], the others over the rest.
        let low = colour * (P_T / knee);
        let high = P_T + (colour - knee) * ((1.0 - P_T) / (filters.largest - knee));
        let colour = if colour < knee { low } else { high };
        let feature = larger((a[3][lane] - b[3][lane]).abs(), (a[4][lane] - b[4][lane]).abs());
        let feature = (feature * std::f32::consts::FRAC_1_SQRT_2).sqrt();
        out[lane] = pow(colour, 1.0 - feature);
    }
    out
}

/// Length of a gradient of luminance Y, for luminance in `[0, 1]`.
#[inline(always)]
fn length(x: f32, y: f32) -> f32 {
    (x * x + y * y).sqrt() * (1.0 / 116.0)
}

/// Linear light in `[0, 1]` on the display.
#[inline(always)]
fn show(light: &mut Lanes, display: Display) {
    match display {
        Display::AsItIs => {
            for light in light {
                *light = light.clamp(0.0, 1.0);
            }
        }
        Display::Exposed(gain) => {
            for light in light {
                // Beyond 1e6 the curve is flat; without the bound its terms overflow.
                let x = (*light * gain).clamp(0.0, 1e6);
                let shown = (x * (ACES[0] * x + ACES[1]) + ACES[2]) / (x * (ACES[3] * x + ACES[4]) + ACES[5]);
                *light = shown.clamp(0.0, 1.0);
            }
        }
        Display::Bytes(gain) => {
            for light in light {
                *light = catoptric_image::srgb::LINEAR_OF_BYTE
                    [usize::from(catoptric_image::srgb::byte(*light * gain))];
            }
        }
    }
}
