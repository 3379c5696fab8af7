//! Irradiance by the dim sky, straight: the border of what is seen of it is followed over the hemisphere.
//!
//! Cells of the unit square, which `cosine_hemisphere` maps, are quartered where their corners do not see the same (after
//! Warnock 1969), as long as what is uncertain is more than the eye would notice. Rays to the corners decide, and count nothing; one
//! ray somewhere inside each cell that is left counts for all of it: no sample has a say in its own weight. What receivers beside have
//! seen tells where a border may be at all.

use std::f32::consts::PI;

use glam::{Vec2, Vec3};

use catoptric_scene::{Rgb, Sky};
use catoptric_trace::MediumStack;
use catoptric_trace::sequence::{Key, cosine_hemisphere, frame, hemisphere_point};

use crate::receiver::Receiver;

use super::{Lights, Scratch};

/// Irradiance by the dim sky.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Skylight {
    /// The irradiance.
    pub irradiance: Rgb,
    /// All of the sky is seen, or nothing of it.
    pub even: bool,
    /// Variance of the irradiance, channels added.
    pub variance: f32,
    /// Where it was seen.
    pub view: SkyView,
}

/// Cells along a side of the unit square by which it is kept where the sky is seen.
const SIDE: u32 = 16;
/// Those that are asked first, and by few samples.
const COARSE: u32 = 8;
const COARSE_OF_FEW: u32 = 4;
/// Samples below which they are few.
const FEW_SAMPLES: u32 = 16;

/// Where a receiver sees the sky, and where something else: a bit for each cell of the unit square of its hemisphere, row by row.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SkyView {
    normal: Vec3,
    seen: [u16; SIDE as usize],
    blocked: [u16; SIDE as usize],
}

impl SkyView {
    /// Nothing seen yet.
    fn new(normal: Vec3) -> Self {
        Self { normal, ..Self::default() }
    }

    /// What rays into a square of cells met.
    fn mark(&mut self, (x, y): (u32, u32), size: u32, seen: bool) {
        let bits = (((1_u32 << size) - 1) << x) as u16;
        let rows = if seen { &mut self.seen } else { &mut self.blocked };
        for row in &mut rows[y as usize..(y + size) as usize] {
            *row |= bits;
        }
    }

    /// What receivers beside have seen, from one with this normal; `None` where nobody has looked.
    pub fn beside(normal: Vec3, views: impl Iterator<Item = SkyView>) -> Option<Self> {
        let mut sum: Option<Self> = None;
        for view in views {
            let view = if view.normal == normal { view } else { view.turned(normal) };
            let sum = sum.get_or_insert(Self::new(normal));
            for (all, own) in [(&mut sum.seen, view.seen), (&mut sum.blocked, view.blocked)] {
                all.iter_mut().zip(own).for_each(|(all, own)| *all |= own);
            }
        }
        sum
    }

    /// The same by the hemisphere of another normal; of what was below the horizon nothing is known.
    fn turned(&self, normal: Vec3) -> Self {
        let mut turned = Self::new(normal);
        let (from, to) = (frame(normal), frame(self.normal));
        for y in 0..SIDE {
            for x in 0..SIDE {
                let local = cosine_hemisphere((Vec2::new(x as f32, y as f32) + 0.5) / SIDE as f32);
                let direction = from.0 * local.x + from.1 * local.y + normal * local.z;
                let there = Vec3::new(direction.dot(to.0), direction.dot(to.1), direction.dot(self.normal));
                if there.z > 0.0 {
                    let at = hemisphere_point(there) * SIDE as f32;
                    let [column, row] = [at.x, at.y].map(|c| (c as u32).min(SIDE - 1));
                    for (to, from) in [(&mut turned.seen, &self.seen), (&mut turned.blocked, &self.blocked)] {
                        to[y as usize] |= (from[row as usize] >> column & 1) << x;
                    }
                } else {
                    turned.mark((x, y), 1, true);
                    turned.mark((x, y), 1, false);
                }
            }
        }
        turned
    }

    /// Per cell: whether the border of the sky may be in it. Beside a receiver things are seen in slightly other directions.
    fn borders(&self) -> [u16; SIDE as usize] {
        let wide = |rows: &[u16; SIDE as usize]| -> [u16; SIDE as usize] {
            let along = rows.map(|row| row | row << 1 | row >> 1);
            std::array::from_fn(|y| {
                let next = along.get(y + 1).copied().unwrap_or(0);
                along[y] | if y > 0 { along[y - 1] } else { 0 } | next
            })
        };
        let (seen, blocked) = (wide(&self.seen), wide(&self.blocked));
        std::array::from_fn(|y| seen[y] & blocked[y])
    }
}

/// Cells of a receiver, while they are quartered.
#[derive(Clone, Debug, Default)]
pub(super) struct Cells {
    /// Radiance at the corners of the finest cells, row by row; NaN where nobody has looked.
    corners: Vec<Rgb>,
    /// Finest cells along a side.
    finest: u32,
    /// Those that are looked at: where they begin, in finest cells.
    open: Vec<(u32, u32)>,
    next: Vec<(u32, u32)>,
}

/// Times that they are quartered, at most.
const LEVELS: u32 = 3;
/// Corners differ by more than this share of the mean radiance.
const DIFFERENT: f32 = 0.25;
/// Cells that see the sky below which all of them are quartered once: some of what is seen may be between all corners.
const FEW: f32 = 8.0;
/// What is left uncertain, times the root of the number of samples, relative to the light there.
const UNCERTAIN: f32 = 0.4;
/// Variance of a ray into a cell whose corners differ by 1: the share of it that is seen may be anything.
const VARIANCE: f32 = 1.0 / 6.0;

impl Lights<'_> {
    /// Whether some of the sky is no source like a lamp.
    pub fn has_skylight(&self) -> bool {
        match self.tracer.scene().sky() {
            Some(Sky::Uniform(radiance)) => radiance.0.max_element() > 0.0,
            Some(Sky::Image(_)) => true,
            None => false,
        }
    }

    /// Irradiance straight from the dim sky beside what is `known` to arrive, as exact as that by `samples` shadow rays, of which none is
    /// a look that may help others; `beside`: what other receivers have seen of it.
    pub fn skylight(
        &self,
        receiver: &Receiver,
        samples: u32,
        known: Rgb,
        beside: Option<&SkyView>,
        key: Key,
        scratch: &mut Scratch,
    ) -> Skylight {
        let nothing = Skylight {
            irradiance: Rgb::ZERO,
            even: true,
            variance: 0.0,
            view: SkyView::new(receiver.normal),
        };
        let Some(sky) = self.tracer.scene().sky().filter(|_| self.has_skylight()) else {
            return nothing;
        };
        let view = View::new(self, sky, receiver);
        let mut cells = std::mem::take(&mut scratch.sky);
        let coarse = if (1..FEW_SAMPLES).contains(&samples) { COARSE_OF_FEW } else { COARSE };
        // Finite, since nothing times it is nothing.
        let uncertain = (UNCERTAIN / (samples as f32).sqrt()).min(f32::MAX);
        let found = cells.sum(&view, beside, (coarse, uncertain, known), key, nothing, scratch);
        scratch.sky = cells;
        found
    }
}

/// The sky from a receiver.
struct View<'a> {
    lights: &'a Lights<'a>,
    sky: &'a Sky,
    receiver: &'a Receiver,
    axes: [Vec3; 2],
    /// What is left of its light behind the medium before the receiver.
    clear: Rgb,
}

impl<'a> View<'a> {
    fn new(lights: &'a Lights<'a>, sky: &'a Sky, receiver: &'a Receiver) -> Self {
        let (tangent, bitangent) = frame(receiver.normal);
        let clear = if receiver.media == MediumStack::AIR {
            Rgb::ONE
        } else {
            lights.tracer.media().transmittance(receiver.media.current(), f32::INFINITY)
        };
        Self { lights, sky, receiver, axes: [tangent, bitangent], clear }
    }

    /// Radiance that arrives from where a point of the unit square is mapped to.
    fn radiance(&self, point: Vec2, scratch: &mut Scratch) -> Rgb {
        let receiver = self.receiver;
        let local = cosine_hemisphere(point);
        let direction = self.axes[0] * local.x + self.axes[1] * local.y + receiver.normal * local.z;
        if direction.dot(receiver.geometric) <= 0.0 || self.lights.bright.holds(self.sky, direction) {
            return Rgb::ZERO;
        }
        let radiance = self.sky.radiance(direction).0 * self.clear * receiver.coat.transmittance(local.z);
        if radiance == Rgb::ZERO {
            return Rgb::ZERO;
        }
        scratch.rays += 1;
        radiance * self.lights.tracer.visibility_to_infinity(receiver.position, receiver.plane, direction)
    }
}

/// Where the quarters of a cell begin, each of `half` finest ones along a side.
fn quarters((x, y): (u32, u32), half: u32) -> [(u32, u32); 4] {
    [(x, y), (x + half, y), (x, y + half), (x + half, y + half)]
}

impl Cells {
    /// The sum over all cells, quartered until what is uncertain is less than a share of the light.
    fn sum(
        &mut self,
        view: &View,
        beside: Option<&SkyView>,
        (side, uncertain, known): (u32, f32, Rgb),
        key: Key,
        nothing: Skylight,
        scratch: &mut Scratch,
    ) -> Skylight {
        let finest = side << LEVELS;
        self.finest = finest;
        self.corners.clear();
        self.corners.resize(((finest + 1) * (finest + 1)) as usize, Rgb::NAN);
        self.open.clear();
        let area_of = |size: u32| (size as f32 / finest as f32).powi(2);
        let mut result = nothing;
        let mut drawn = 0;
        let mut inside = |(x, y): (u32, u32), size: u32, scratch: &mut Scratch| {
            drawn += 1;
            let at = Vec2::new(x as f32, y as f32) + key.point2(drawn) * size as f32;
            view.radiance(at / finest as f32, scratch)
        };
        let borders = beside.map(SkyView::borders);
        let (coarse, wide) = (finest / side, SIDE / side);
        for cell in 0..side * side {
            let (column, row) = (cell % side, cell / side);
            let (at, shown) = ((column * coarse, row * coarse), (column * wide, row * wide));
            let is_border = borders.is_none_or(|borders| {
                let bits = (1 << wide) - 1;
                (shown.1..shown.1 + wide).any(|row| borders[row as usize] >> shown.0 & bits != 0)
            });
            if is_border && borders.is_some() {
                self.open.extend(quarters(at, coarse / 2));
            } else if is_border {
                self.open.push(at);
            } else {
                let found = inside(at, coarse, scratch);
                result.irradiance += found * (area_of(coarse) * PI);
                result.view.mark(shown, wide, found != Rgb::ZERO);
            }
        }
        let mut limit = 0.0;
        let mut brightest = 0.0_f32;
        let first = u32::from(borders.is_some());
        for level in first.. {
            let size = coarse >> level;
            let area = area_of(size);
            let open = std::mem::take(&mut self.open);
            // The light by what is known of it now, and what it leaves open.
            let (mut light, mut doubt) = (result.irradiance / PI, 0.0_f32);
            for &at in &open {
                let corners = self.corners_of(at, size, view, scratch);
                brightest = corners.iter().fold(brightest, |most, corner| most.max(corner.max_element()));
                light += corners.iter().copied().sum::<Rgb>() * (0.25 * area);
            }
            if level == first {
                limit = DIFFERENT * light.max_element();
            }
            let few = level == 0 && borders.is_none() && light.max_element() <= FEW * area * brightest;
            self.next.clear();
            for &at in &open {
                let corners = self.corners_of(at, size, view, scratch);
                let most = corners.iter().copied().fold(Rgb::ZERO, Rgb::max);
                let least = corners.iter().copied().fold(Rgb::INFINITY, Rgb::min);
                let difference = most - least;
                let differ = difference.max_element() > limit;
                let shown = (at.0 * SIDE / finest, at.1 * SIDE / finest);
                let wide = (size * SIDE / finest).max(1);
                if most != Rgb::ZERO {
                    result.view.mark(shown, wide, true);
                }
                if corners.contains(&Rgb::ZERO) {
                    result.view.mark(shown, wide, false);
                }
                if differ {
                    doubt += VARIANCE * (difference * area).element_sum().powi(2);
                }
                if differ || few {
                    self.next.push(at);
                } else {
                    let found = inside(at, size, scratch);
                    result.view.mark(shown, wide, found != Rgb::ZERO);
                    result.even &= few || (found == Rgb::ZERO) == (most == Rgb::ZERO);
                    result.irradiance += found * (area * PI);
                }
            }
            self.open = open;
            result.even &= self.next.is_empty() || few;
            let allowed = uncertain * (light + known / PI).element_sum();
            if size == 1 || !few && doubt <= allowed * allowed {
                for &at in &self.next {
                    result.irradiance += inside(at, size, scratch) * (area * PI);
                }
                result.variance = doubt * PI * PI;
                break;
            }
            self.open.clear();
            self.open.extend(self.next.iter().flat_map(|&at| quarters(at, size / 2)));
        }
        result
    }

    /// Radiance at the corners of a cell.
    fn corners_of(&mut self, (x, y): (u32, u32), size: u32, view: &View, scratch: &mut Scratch) -> [Rgb; 4] {
        [(x, y), (x + size, y), (x, y + size), (x + size, y + size)].map(|(x, y)| {
            let index = (y * (self.finest + 1) + x) as usize;
            if self.corners[index].is_nan() {
                // At the rim nothing arrives from below the surface.
                let at = Vec2::new(x as f32, y as f32) / self.finest as f32;
                let rim = Vec2::splat(0.5 / self.finest as f32);
                self.corners[index] = view.radiance(at.clamp(rim, 1.0 - rim), scratch);
            }
            self.corners[index]
        })
    }
}
