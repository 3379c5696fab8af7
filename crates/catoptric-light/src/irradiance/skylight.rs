//! Irradiance by the dim sky, straight: the border of what is seen of it is followed over the hemisphere.
//!
//! Cells of the unit square, which `cosine_hemisphere` maps, are quartered where their corners do not see the same (after
//! Warnock 1969), as long as what is uncertain is more than the eye would notice. Rays to the corners decide, and count nothing; one
//! ray somewhere inside each cell that is left counts for all of it: no sample has a say in its own weight. What receivers beside have
//! seen tells where a border may be at all, and where there is much sky it mostly leaves so little uncertain that own looks at corners are not
//! worth their rays.

use std::f32::consts::PI;
use std::sync::LazyLock;

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

impl Skylight {
    fn nothing(receiver: &Receiver) -> Self {
        Self { irradiance: Rgb::ZERO, even: true, variance: 0.0, view: SkyView::new(receiver.normal) }
    }
}

/// Cells along a side of the unit square by which it is kept where the sky is seen.
const SIDE: u32 = 16;
/// Those that are asked first, and by few samples.
const COARSE: u32 = 8;
const COARSE_OF_FEW: u32 = 4;
/// Where the middles of the cells are on the hemisphere about +Z, row by row.
static MIDDLES: LazyLock<Vec<Vec3>> = LazyLock::new(|| {
    let at = |index: u32| (Vec2::new((index % SIDE) as f32, (index / SIDE) as f32) + 0.5) / SIDE as f32;
    (0..SIDE * SIDE).map(|index| cosine_hemisphere(at(index))).collect()
});
/// Samples below which they are few.
const FEW_SAMPLES: u32 = 16;

/// Where a receiver sees the sky, and where something else: a bit for each cell of the unit square of its hemisphere, row by row.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SkyView {
    normal: Vec3,
    seen: [u16; SIDE as usize],
    blocked: [u16; SIDE as usize],
    /// Below the horizon of all who looked.
    unknown: [u16; SIDE as usize],
}

impl SkyView {
    /// Nothing seen yet.
    fn new(normal: Vec3) -> Self {
        Self { normal, ..Self::default() }
    }

    /// Cells that see the sky.
    fn count(&self) -> u32 {
        self.seen.iter().map(|row| row.count_ones()).sum()
    }

    /// What rays into a cell met, by the cells of this view.
    fn mark(&mut self, Cell { x, y, size }: Cell, seen: bool) {
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
            let sum = sum.get_or_insert(Self { unknown: [u16::MAX; SIDE as usize], ..Self::new(normal) });
            for (all, own) in [(&mut sum.seen, view.seen), (&mut sum.blocked, view.blocked)] {
                all.iter_mut().zip(own).for_each(|(all, own)| *all |= own);
            }
            sum.unknown.iter_mut().zip(view.unknown).for_each(|(all, own)| *all &= own);
        }
        sum
    }

    /// The same by the hemisphere of another normal.
    fn turned(&self, normal: Vec3) -> Self {
        let mut turned = Self::new(normal);
        let (from, to) = (frame(normal), frame(self.normal));
        for y in 0..SIDE {
            for x in 0..SIDE {
                let local = MIDDLES[(y * SIDE + x) as usize];
                let direction = from.0 * local.x + from.1 * local.y + normal * local.z;
                let there = Vec3::new(direction.dot(to.0), direction.dot(to.1), direction.dot(self.normal));
                if there.z > 0.0 {
                    let at = hemisphere_point(there) * SIDE as f32;
                    let [column, row] = [at.x, at.y].map(|c| (c as u32).min(SIDE - 1));
                    for (to, from) in [(&mut turned.seen, &self.seen), (&mut turned.blocked, &self.blocked)] {
                        to[y as usize] |= (from[row as usize] >> column & 1) << x;
                    }
                } else {
                    turned.unknown[y as usize] |= 1 << x;
                }
            }
        }
        turned
    }

    /// Whether a cell, of so many finest ones along a side, is no finer than those here, and others saw the sky in it and something else.
    fn is_divided(&self, cell: Cell, finest: u32) -> bool {
        let times = finest / SIDE;
        cell.size >= times
            && has_bits(&self.seen, cell.coarser(times))
            && has_bits(&self.blocked, cell.coarser(times))
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
        std::array::from_fn(|y| seen[y] & blocked[y] | self.unknown[y])
    }
}

/// Cells of a receiver, while they are quartered.
#[derive(Clone, Debug, Default)]
pub(super) struct Cells {
    /// Radiance at the corners of the finest cells, row by row; NaN where nobody has looked.
    corners: Vec<Rgb>,
    /// Those where somebody has.
    looked_at: Vec<u32>,
    /// Where they are on the hemisphere about +Z.
    directions: Vec<Vec3>,
    /// Finest cells along a side.
    finest: u32,
    /// Those that are looked at, all of one size, …
    open: Vec<Cell>,
    /// … what arrives at their corners, …
    looks: Vec<[Rgb; 4]>,
    /// … and those that are quartered next.
    next: Vec<Cell>,
}

/// Times that they are quartered, at most.
const LEVELS: u32 = 3;
/// Corners differ by more than this share of the mean radiance.
const DIFFERENT: f32 = 0.25;
/// Cells that see the sky below which all of them are quartered once: some of what is seen may be between all corners.
const FEW: f32 = 8.0;
/// One in so many rays of a look meets the sky, at most, where that is little.
const LITTLE: u32 = 8;
/// … and so many of them where it is next to nothing.
const LEAST: u32 = 2;
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

    /// A first look at the dim sky, which tells others where to look closer: by 256 rays and more where windows are small, or by 64.
    pub fn look_at_sky(
        &self,
        receiver: &Receiver,
        closely: bool,
        key: Key,
        scratch: &mut Scratch,
    ) -> Skylight {
        match self.tracer.scene().sky().filter(|_| self.has_skylight()) {
            Some(sky) => Hemisphere::new(self, sky, receiver, scratch).look(closely, key),
            None => Skylight::nothing(receiver),
        }
    }

    /// Irradiance straight from the dim sky, about as exact as by `samples` shadow rays. `known`: what arrives besides, which makes errors
    /// less visible; `beside`: what other receivers have seen of the sky.
    pub fn skylight(
        &self,
        receiver: &Receiver,
        samples: u32,
        known: Rgb,
        beside: Option<&SkyView>,
        key: Key,
        scratch: &mut Scratch,
    ) -> Skylight {
        let Some(sky) = self.tracer.scene().sky().filter(|_| self.has_skylight()) else {
            return Skylight::nothing(receiver);
        };
        let mut cells = std::mem::take(&mut scratch.sky);
        let mut hemisphere = Hemisphere::new(self, sky, receiver, scratch);
        let side = if samples < FEW_SAMPLES { COARSE_OF_FEW } else { COARSE };
        let mut count =
            Count { key, drawn: 0, seen: 0, finest: side << LEVELS, found: Skylight::nothing(receiver) };
        cells.begin(side, beside, &mut hemisphere, &mut count);
        let uncertain = UNCERTAIN / (samples as f32).sqrt();
        // Where others know where borders are, own looks at corners are often not worth their rays.
        if beside.is_none() || !cells.count_open(uncertain, known, &mut hemisphere, &mut count) {
            cells.quarter(beside, uncertain, known, &mut hemisphere, &mut count);
        }
        scratch.sky = cells;
        count.found
    }
}

/// The sky from a receiver.
struct Hemisphere<'a> {
    lights: &'a Lights<'a>,
    sky: &'a Sky,
    receiver: &'a Receiver,
    axes: [Vec3; 2],
    /// What is left of its light behind the medium before the receiver.
    clear: Rgb,
    scratch: &'a mut Scratch,
}

impl<'a> Hemisphere<'a> {
    fn new(lights: &'a Lights<'a>, sky: &'a Sky, receiver: &'a Receiver, scratch: &'a mut Scratch) -> Self {
        let (tangent, bitangent) = frame(receiver.normal);
        let clear = if receiver.media == MediumStack::AIR {
            Rgb::ONE
        } else {
            lights.tracer.media().transmittance(receiver.media.current(), f32::INFINITY)
        };
        Self { lights, sky, receiver, axes: [tangent, bitangent], clear, scratch }
    }

    /// A direction of the hemisphere about +Z, in the scene, and what arrives from there if nothing is in between.
    fn open(&self, local: Vec3) -> (Vec3, Rgb) {
        let receiver = self.receiver;
        let direction = self.axes[0] * local.x + self.axes[1] * local.y + receiver.normal * local.z;
        if direction.dot(receiver.geometric) <= 0.0 {
            return (direction, Rgb::ZERO);
        }
        let radiance = self.lights.bright.dim_radiance(self.sky, direction);
        (direction, radiance * self.clear * receiver.coat.transmittance(local.z))
    }

    /// Radiance that arrives from a direction of the hemisphere about +Z.
    fn radiance(&mut self, local: Vec3) -> Rgb {
        let (direction, radiance) = self.open(local);
        if radiance == Rgb::ZERO {
            return Rgb::ZERO;
        }
        self.scratch.rays += 1;
        let Receiver { position, plane, .. } = *self.receiver;
        radiance * self.lights.tracer.visibility_to_infinity(position, plane, direction)
    }

    /// A ray into each cell of a view, or into every fourth, somewhere: between the corners of larger ones, small windows may hide. Where
    /// little is seen, more rays around that tell how far it reaches.
    fn look(&mut self, closely: bool, key: Key) -> Skylight {
        let mut found = Skylight::nothing(self.receiver);
        let (side, size) = if closely { (SIDE, 2) } else { (SIDE / 2, 4) };
        let cells =
            (0..side * side).map(|index| Cell { x: index % side * size, y: index / side * size, size });
        let mut seen = 0;
        for (cell, index) in cells.zip(0..) {
            let radiance = self.look_into(cell, key.point2(index), &mut found.view);
            found.irradiance += radiance * (PI / (side * side) as f32);
            seen += u32::from(radiance != Rgb::ZERO);
        }
        if LITTLE * seen <= side * side {
            // All where next to nothing is seen, and else those around what is.
            let all = closely && seen <= LEAST;
            let borders = if all { [u16::MAX; SIDE as usize] } else { found.view.borders() };
            let cells = (0..SIDE * SIDE).map(|index| Cell { x: index % SIDE, y: index / SIDE, size: 1 });
            let around = cells.filter(|&cell| has_bits(&borders, cell)).map(|cell| cell.finer(2));
            for (cell, index) in around.flat_map(Cell::quarters).zip(side * side..) {
                self.look_into(cell, key.point2(index), &mut found.view);
            }
        }
        found.even = found.view.count() == 0 || seen == side * side;
        found
    }

    /// Radiance at a place in a cell, of which two of size 1 are along the side of one of the view's.
    fn look_into(&mut self, cell: Cell, place: Vec2, view: &mut SkyView) -> Rgb {
        let at = Vec2::new(cell.x as f32, cell.y as f32) + place * cell.size as f32;
        let radiance = self.radiance(cosine_hemisphere(at / (2 * SIDE) as f32));
        let [x, y] = [at.x, at.y].map(|c| (c as u32 / 2).min(SIDE - 1));
        view.mark(Cell { x, y, size: 1 }, radiance != Rgb::ZERO);
        radiance
    }
}

/// A square of the finest cells.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cell {
    /// Where it begins, …
    pub(super) x: u32,
    pub(super) y: u32,
    /// … and how many are along its side.
    pub(super) size: u32,
}

impl Cell {
    pub(super) fn quarters(self) -> [Self; 4] {
        let size = self.size / 2;
        [(0, 0), (size, 0), (0, size), (size, size)].map(|(x, y)| Self { x: self.x + x, y: self.y + y, size })
    }

    /// In a grid that is finer.
    fn finer(self, times: u32) -> Self {
        Self { x: self.x * times, y: self.y * times, size: self.size * times }
    }

    /// In a grid that is coarser.
    fn coarser(self, times: u32) -> Self {
        Self { x: self.x / times, y: self.y / times, size: (self.size / times).max(1) }
    }
}

/// What the rays inside cells have counted.
struct Count {
    key: Key,
    drawn: u32,
    /// Those that met the sky.
    seen: u32,
    /// Finest cells along a side.
    finest: u32,
    found: Skylight,
}

impl Count {
    /// Share of the unit square.
    fn area(&self, cell: Cell) -> f32 {
        (cell.size as f32 / self.finest as f32).powi(2)
    }

    /// One ray somewhere inside a cell counts for all of it; whether it met the sky.
    fn add(&mut self, cell: Cell, hemisphere: &mut Hemisphere) -> bool {
        self.drawn += 1;
        let at = Vec2::new(cell.x as f32, cell.y as f32) + self.key.point2(self.drawn) * cell.size as f32;
        let radiance = hemisphere.radiance(cosine_hemisphere(at / self.finest as f32));
        let is_seen = radiance != Rgb::ZERO;
        self.found.irradiance += radiance * (self.area(cell) * PI);
        self.seen += u32::from(is_seen);
        self.mark(cell, is_seen);
        is_seen
    }

    fn mark(&mut self, cell: Cell, is_seen: bool) {
        self.found.view.mark(cell.coarser(self.finest / SIDE), is_seen);
    }
}

impl Cells {
    /// All cells, `side` along each side, are open, and quartered once where the border of what is seen may be, if others have looked;
    /// the rest is counted.
    fn begin(&mut self, side: u32, beside: Option<&SkyView>, hemisphere: &mut Hemisphere, count: &mut Count) {
        if self.finest == count.finest {
            for corner in self.looked_at.drain(..) {
                self.corners[corner as usize] = Rgb::NAN;
            }
        } else {
            self.set_finest(count.finest);
        }
        self.open.clear();
        let borders = beside.map(SkyView::borders);
        let size = self.finest / side;
        for index in 0..side * side {
            let cell = Cell { x: index % side * size, y: index / side * size, size };
            match borders.map(|borders| has_bits(&borders, cell.coarser(self.finest / SIDE))) {
                None => self.open.push(cell),
                Some(true) => self.open.extend(cell.quarters()),
                Some(false) => {
                    count.add(cell, hemisphere);
                }
            }
        }
    }

    /// Nobody has looked at the corners of so many cells along a side.
    fn set_finest(&mut self, finest: u32) {
        self.finest = finest;
        self.looked_at.clear();
        self.corners.clear();
        self.corners.resize(((finest + 1) * (finest + 1)) as usize, Rgb::NAN);
        // At the rim nothing arrives from below the surface.
        let rim = Vec2::splat(0.5 / finest as f32);
        let corners = (0..=finest)
            .flat_map(|y| (0..=finest).map(move |x| Vec2::new(x as f32, y as f32) / finest as f32));
        self.directions.clear();
        self.directions.extend(corners.map(|at| cosine_hemisphere(at.clamp(rim, 1.0 - rim))));
    }

    /// Counts the open cells as they are, if a border in each of them left no more uncertain than that; whether it did.
    fn count_open(&self, uncertain: f32, known: Rgb, hemisphere: &mut Hemisphere, count: &mut Count) -> bool {
        // As if half of each were seen.
        let (mut light, mut doubt) = (count.found.irradiance / PI, 0.0_f32);
        for &cell in &self.open {
            let middle = self.corner(cell.x + cell.size / 2, cell.y + cell.size / 2);
            let whole = hemisphere.open(self.directions[middle]).1 * count.area(cell);
            light += whole * 0.5;
            doubt += VARIANCE * whole.element_sum().powi(2);
        }
        let allowed = uncertain * (light + known / PI).element_sum();
        if doubt > allowed * allowed {
            return false;
        }
        for &cell in &self.open {
            count.add(cell, hemisphere);
        }
        count.found.variance = doubt * PI * PI;
        count.found.even = count.seen == 0 || count.seen == count.drawn;
        true
    }

    /// Counts the open cells, quartered until what is uncertain is less than a share of the light. Those that others saw a part of
    /// are uncertain, whatever their corners see: small windows hide between them.
    fn quarter(
        &mut self,
        beside: Option<&SkyView>,
        uncertain: f32,
        known: Rgb,
        hemisphere: &mut Hemisphere,
        count: &mut Count,
    ) {
        let mut brightest = 0.0_f32;
        let mut different = None;
        // They are quartered once already where others have looked.
        for level in u32::from(beside.is_some()).. {
            // The light by what is known of it now, and what it leaves open.
            let (mut light, mut doubt) = (count.found.irradiance / PI, 0.0_f32);
            self.looks.clear();
            for index in 0..self.open.len() {
                let cell = self.open[index];
                let corners = self.corners_of(cell, hemisphere);
                brightest = corners.iter().fold(brightest, |most, corner| most.max(corner.max_element()));
                light += corners.iter().copied().sum::<Rgb>() * (0.25 * count.area(cell));
                self.looks.push(corners);
            }
            let different = *different.get_or_insert(DIFFERENT * light.max_element());
            let least = self.open.first().map_or(0.0, |&cell| FEW * count.area(cell) * brightest);
            let is_few = level == 0 && light.max_element() <= least;
            self.next.clear();
            for (&cell, corners) in self.open.iter().zip(&self.looks) {
                let most = corners.iter().copied().fold(Rgb::ZERO, Rgb::max);
                let mut difference = most - corners.iter().copied().fold(Rgb::INFINITY, Rgb::min);
                if beside.is_some_and(|view| view.is_divided(cell, self.finest)) {
                    let middle = Vec2::new(cell.x as f32, cell.y as f32) + 0.5 * cell.size as f32;
                    let middle = cosine_hemisphere(middle / self.finest as f32);
                    difference = difference.max(hemisphere.open(middle).1);
                }
                let differ = difference.max_element() > different;
                if most != Rgb::ZERO {
                    count.mark(cell, true);
                }
                if corners.contains(&Rgb::ZERO) {
                    count.mark(cell, false);
                }
                if differ {
                    doubt += VARIANCE * (difference * count.area(cell)).element_sum().powi(2);
                }
                if differ || is_few {
                    self.next.push(cell);
                } else {
                    let is_seen = count.add(cell, hemisphere);
                    count.found.even &= is_seen == (most != Rgb::ZERO);
                }
            }
            count.found.even &= self.next.is_empty() || is_few;
            let allowed = uncertain * (light + known / PI).element_sum();
            let is_finest = self.next.first().is_none_or(|cell| cell.size == 1);
            if is_finest || !is_few && doubt <= allowed * allowed {
                for &cell in &self.next {
                    count.add(cell, hemisphere);
                }
                count.found.variance = doubt * PI * PI;
                return;
            }
            self.open.clear();
            self.open.extend(self.next.iter().flat_map(|cell| cell.quarters()));
        }
    }

    /// Radiance at the corners of a cell.
    fn corners_of(&mut self, Cell { x, y, size }: Cell, hemisphere: &mut Hemisphere) -> [Rgb; 4] {
        [(x, y), (x + size, y), (x, y + size), (x + size, y + size)].map(|(x, y)| {
            let index = self.corner(x, y);
            if self.corners[index].is_nan() {
                self.corners[index] = hemisphere.radiance(self.directions[index]);
                self.looked_at.push(index as u32);
            }
            self.corners[index]
        })
    }

    fn corner(&self, x: u32, y: u32) -> usize {
        (y * (self.finest + 1) + x) as usize
    }
}

/// Whether a cell has a bit.
fn has_bits(rows: &[u16; SIDE as usize], Cell { x, y, size }: Cell) -> bool {
    let bits = ((1_u32 << size) - 1) as u16;
    rows[y as usize..(y + size) as usize].iter().any(|row| row >> x & bits != 0)
}
