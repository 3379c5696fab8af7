//! Irradiance by lamps that are seen in a lens: the border of what of its view shows them is followed.
//!
//! Directions are those to the ball around the lens, or of the hemisphere inside of it, by the cells of a square. One ray goes into each cell:
//! into small ones where receivers beside saw the border, into larger ones where they saw one thing. Each ray that meets the lens splits as the
//! eye's do, and what glows at the ends of its branches counts. Where all around see the whole lens, and the lamps fill the same share of it,
//! that share is known without a ray.

use std::f32::consts::PI;

use glam::{Vec2, Vec3};

use catoptric_scene::Rgb;
use catoptric_trace::sequence::{Key, concentric_disk, cosine_hemisphere, frame};
use catoptric_trace::slab::Passage;
use catoptric_trace::walk::split::{self, Sight, SplitParams, Waiting};
use catoptric_trace::{Event, MediumStack, Ray, Tracer};

use crate::lens::Lens;
use crate::owner::Source;
use crate::receiver::Receiver;

use super::skylight::Cell;
use super::{Lights, Scratch};

/// Cells along the side of a lens's view.
const SIDE: u32 = 32;
/// Those of a first look are so many times as long, …
const FIRST: u32 = 2;
/// … and so those where others saw one thing.
const PLAIN: u32 = 4;
/// Samples below which the finest cells are not looked into, …
const FINE: u32 = 64;
/// … and lenses from which on the noise of one is little to that of all.
const MANY: usize = 2;
/// Rays that look whether something stands before what others have seen.
const LOOKS: u32 = 4;
/// Child of a key for them.
const LOOK: u32 = 1 << 16;
/// Branches of less throughput go on by roulette.
const ROULETTE_BELOW: f32 = 0.2;
/// Surfaces that a ray passes before it meets the lens, at most.
const MAX_CROSSINGS: u32 = 64;
/// Shares of a lens that lamps fill which differ by less than this, relative, count as equal.
const EQUAL: f32 = 0.25;

/// A bit for each cell, row by row.
type Rows = [u32; SIDE as usize];

/// Irradiance by the lamps in all lenses.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LensLight {
    /// The irradiance.
    pub irradiance: Rgb,
    /// Nothing stands before any lens, or all of it is hidden.
    pub even: bool,
    /// Variance of the irradiance, channels added.
    pub variance: f32,
}

/// What a receiver has seen in one lens.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LensSeen {
    /// Cells in which some rays found a lamp, row by row, …
    lit: Rows,
    /// … and those in which some found none.
    dark: Rows,
    /// Irradiance by that of a lens that shines with unit radiance all over, where that is known: nothing is before it, and all of it is
    /// above the horizon.
    share: Option<Rgb>,
}

/// What receivers beside have seen in one lens.
#[derive(Clone, Copy, Debug, Default)]
pub struct LensBeside {
    seen: Option<LensSeen>,
}

impl LensBeside {
    /// Of some receivers. `between`: what they found alike holds between them.
    pub fn of(all: impl Iterator<Item = LensSeen>, between: bool) -> Self {
        let mut seen: Option<LensSeen> = None;
        let (mut count, mut sum, mut least, mut most) = (0.0, Rgb::ZERO, Rgb::INFINITY, Rgb::ZERO);
        let mut is_known = between;
        for one in all {
            let all = seen.get_or_insert_with(LensSeen::default);
            all.lit.iter_mut().zip(one.lit).for_each(|(all, own)| *all |= own);
            all.dark.iter_mut().zip(one.dark).for_each(|(all, own)| *all |= own);
            is_known &= one.share.is_some();
            let share = one.share.unwrap_or(Rgb::ZERO);
            (count, sum, least, most) = (count + 1.0, sum + share, least.min(share), most.max(share));
        }
        if let Some(seen) = &mut seen {
            let is_equal = (most - least).max_element() <= EQUAL * most.max_element();
            seen.share = (is_known && is_equal && count > 1.0).then(|| sum / count);
        }
        Self { seen }
    }
}

impl LensSeen {
    /// Per cell: whether the border of the light may be in it. Beside a receiver things are seen in slightly other directions.
    fn borders(&self) -> Rows {
        let (lit, dark) = (widened(&self.lit), widened(&self.dark));
        std::array::from_fn(|y| lit[y] & dark[y])
    }
}

/// Cells with their neighbours.
fn widened(rows: &Rows) -> Rows {
    let along = rows.map(|row| row | row << 1 | row >> 1);
    std::array::from_fn(|y| {
        let next = along.get(y + 1).copied().unwrap_or(0);
        along[y] | if y > 0 { along[y - 1] } else { 0 } | next
    })
}

impl Cell {
    /// Squares of one size, row by row.
    fn all(size: u32) -> impl Iterator<Item = Self> {
        let side = SIDE / size;
        (0..side * side).map(move |index| Self { x: index % side * size, y: index / side * size, size })
    }

    /// Bits of a row of it.
    fn bits(self) -> u32 {
        (u32::MAX >> (SIDE - self.size)) << self.x
    }

    /// Whether it has any bit.
    fn meets(self, rows: &Rows) -> bool {
        rows[self.y as usize..(self.y + self.size) as usize].iter().any(|row| row & self.bits() != 0)
    }

    fn mark(self, rows: &mut Rows) {
        rows[self.y as usize..(self.y + self.size) as usize].iter_mut().for_each(|row| *row |= self.bits());
    }
}

impl Lights<'_> {
    /// Irradiance by the lamps that are seen in lenses, about as exact as by `samples` shadow rays. `beside`: what other receivers have seen in
    /// each; what is seen here is added to `seen`.
    pub fn through_lenses(
        &self,
        receiver: &Receiver,
        samples: u32,
        beside: impl Fn(usize) -> LensBeside,
        seen: &mut Vec<LensSeen>,
        key: Key,
        scratch: &mut Scratch,
    ) -> LensLight {
        let mut sum = LensLight { even: true, ..LensLight::default() };
        let finest = if samples < FINE || self.lenses.len() >= MANY { 2 } else { 1 };
        for (index, lens) in self.lenses.all().enumerate() {
            let key = key.child(index as u32);
            let Some(mut view) = LensView::new(self, lens, receiver, key, scratch) else {
                seen.push(LensSeen::default());
                continue;
            };
            let beside = beside(index).seen;
            if let (Some(beside), Some(unit)) = (beside, view.unit())
                && let Some(share) = beside.share
                && view.confirms(&beside.lit)
            {
                sum.irradiance += share * unit;
                seen.push(beside);
                continue;
            }
            view.look(beside.map(|seen| seen.borders()).as_ref(), finest);
            let even = view.is_even();
            sum.irradiance += view.found;
            sum.variance += view.variance;
            sum.even &= even;
            view.seen.share = view.unit().filter(|_| even).map(|unit| view.found / unit);
            seen.push(view.seen);
        }
        sum
    }

    /// What each of so many rays to a lens finds: nothing where it does not meet it first.
    pub(crate) fn looks_into(
        &self,
        lens: &Lens,
        receiver: &Receiver,
        rays: u32,
        key: Key,
        scratch: &mut Scratch,
        mut visit: impl FnMut(Rgb),
    ) {
        let Some(mut view) = LensView::new(self, lens, receiver, key.child(0), scratch) else { return };
        for ray in 0..rays {
            let met = view.meets;
            let found = view.arrives(key.point2(ray));
            if view.meets > met {
                visit(found);
            }
        }
    }
}

/// The directions in which a lens may be.
#[derive(Clone, Copy)]
enum Span {
    /// Those to the ball around it: the axis, what spans the plane across, 1 − cos of the half angle, and the distance to the ball.
    Cone { axis: Vec3, across: [Vec3; 2], height: f32, distance: f32 },
    /// The receiver is inside of it.
    Hemisphere { across: [Vec3; 2] },
}

/// A lens from a receiver.
struct LensView<'a> {
    lights: &'a Lights<'a>,
    lens: &'a Lens,
    receiver: &'a Receiver,
    span: Span,
    key: Key,
    rays: u32,
    /// Rays that met the lens, …
    meets: u32,
    /// … and those that met something before the ball around it, …
    blocked: u32,
    /// … by the cells.
    hidden: Rows,
    /// Irradiance, …
    found: Rgb,
    /// … its variance, …
    variance: f32,
    /// … and where it comes from.
    seen: LensSeen,
    scratch: &'a mut Scratch,
}

impl<'a> LensView<'a> {
    /// `None` where all of it is below the horizon.
    fn new(
        lights: &'a Lights<'a>,
        lens: &'a Lens,
        receiver: &'a Receiver,
        key: Key,
        scratch: &'a mut Scratch,
    ) -> Option<Self> {
        let towards = lens.center - receiver.position;
        if towards.dot(receiver.geometric) <= -lens.radius {
            return None;
        }
        let (distance, radius) = (towards.length(), lens.radius);
        let span = if distance > radius {
            let axis = towards / distance;
            // Turning as little as can be from one receiver to the next.
            let a = axis.cross(Vec3::Y).try_normalize().unwrap_or(Vec3::X);
            let b = axis.cross(a);
            // 1 − cos α of sin α = r/d, without cancellation.
            let sine = radius / distance;
            let height = sine * sine / (1.0 + (1.0 - sine * sine).max(0.0).sqrt());
            Span::Cone { axis, across: [a, b], height, distance: distance - radius }
        } else {
            let (a, b) = frame(receiver.normal);
            Span::Hemisphere { across: [a, b] }
        };
        Some(Self {
            lights,
            lens,
            receiver,
            span,
            key,
            rays: 0,
            meets: 0,
            blocked: 0,
            hidden: [0; SIDE as usize],
            found: Rgb::ZERO,
            variance: 0.0,
            seen: LensSeen::default(),
            scratch,
        })
    }

    /// Irradiance by a lens that shines with unit radiance all over, if all of the ball around it is above the horizon: π sin²α cosθ.
    fn unit(&self) -> Option<f32> {
        let Span::Cone { axis, height, .. } = self.span else { return None };
        let squared_sine = height * (2.0 - height);
        let receiver = self.receiver;
        let is_above = |normal: Vec3| axis.dot(normal) > 0.0 && axis.dot(normal).powi(2) > squared_sine;
        (is_above(receiver.geometric) && is_above(receiver.normal))
            .then(|| PI * squared_sine * axis.dot(receiver.normal))
    }

    /// One ray into each cell, down to those of a size: where no border may be, into larger ones.
    fn look(&mut self, borders: Option<&Rows>, finest: u32) {
        match borders {
            Some(borders) => Cell::all(PLAIN).for_each(|cell| self.follow(cell, borders, finest)),
            None => Cell::all(FIRST).for_each(|cell| {
                self.add(cell);
            }),
        }
    }

    fn follow(&mut self, cell: Cell, borders: &Rows, finest: u32) {
        if !cell.meets(borders) {
            self.add(cell);
        } else if cell.size > 2 * finest {
            cell.quarters().into_iter().for_each(|quarter| self.follow(quarter, borders, finest));
        } else {
            self.add_quarters(cell);
        }
    }

    /// Nothing stands before the light, or before all of it.
    fn is_even(&self) -> bool {
        widened(&self.seen.lit).iter().zip(&self.hidden).all(|(lit, hidden)| lit & hidden == 0)
    }

    /// Whether a few rays find what others have found: nothing before the places that these saw lit, or, if they saw none, something before
    /// all of the lens.
    fn confirms(&mut self, lit: &Rows) -> bool {
        let count: u32 = lit.iter().map(|row| row.count_ones()).sum();
        let places = self.key.child(LOOK);
        if count == 0 {
            return (0..LOOKS).all(|look| !self.meets_first(places.point2(look)));
        }
        (0..LOOKS).all(|look| {
            let place = places.point2(look);
            // One in each quarter of the cells, row by row.
            let mut number = (count * look + (place.x * count as f32) as u32) / LOOKS;
            let found = lit.iter().zip(0..).find_map(|(&row, y)| {
                if row.count_ones() <= number {
                    number -= row.count_ones();
                    return None;
                }
                let mut left = row;
                (0..number).for_each(|_| left &= left - 1);
                Some(Vec2::new(left.trailing_zeros() as f32, y as f32))
            });
            found.is_none_or(|cell| self.meets_first((cell + place) / SIDE as f32))
        })
    }

    /// Whether a ray meets the lens before anything else.
    fn meets_first(&mut self, point: Vec2) -> bool {
        let (direction, weight) = self.towards(point);
        let Receiver { position: origin, plane: from, .. } = *self.receiver;
        self.scratch.rays += 1;
        let hit = self.lights.tracer.nearest(&Ray { origin, direction, from }, f32::INFINITY);
        weight > 0.0 && hit.is_some_and(|hit| self.lens.holds(hit.triangle))
    }

    /// One ray somewhere inside a cell counts for all of it. Returns its share.
    fn add(&mut self, cell: Cell) -> Rgb {
        let at = Vec2::new(cell.x as f32, cell.y as f32) + self.key.point2(self.rays) * cell.size as f32;
        let blocked = self.blocked;
        let arrived = self.arrives(at / SIDE as f32);
        if self.blocked > blocked {
            cell.mark(&mut self.hidden);
        }
        let share = arrived * (PI * (cell.size as f32 / SIDE as f32).powi(2));
        self.found += share;
        cell.mark(if arrived == Rgb::ZERO { &mut self.seen.dark } else { &mut self.seen.lit });
        share
    }

    /// One ray into each quarter of a cell. By how much they differ tells the variance of their sum, about half of it: beside a border that is
    /// nearly straight they differ most in what each knows of its place.
    fn add_quarters(&mut self, cell: Cell) {
        let shares = cell.quarters().map(|quarter| self.add(quarter));
        let mean = shares.iter().copied().sum::<Rgb>() / 4.0;
        let squares: f32 = shares.iter().map(|&share| (share - mean).length_squared()).sum();
        self.variance += 0.5 * squares * 4.0 / 3.0;
    }

    /// Radiance that arrives from a point of the unit square, as it counts.
    fn arrives(&mut self, point: Vec2) -> Rgb {
        let (direction, weight) = self.towards(point);
        if weight > 0.0 {
            self.radiance(direction) * weight
        } else {
            self.rays += 1;
            Rgb::ZERO
        }
    }

    /// The direction of a point of the unit square, and what a radiance that arrives from there counts.
    fn towards(&self, point: Vec2) -> (Vec3, f32) {
        let receiver = self.receiver;
        let (direction, density) = match self.span {
            Span::Cone { axis, across, height, .. } => {
                // Archimedes: equal areas on the disk and on the cap.
                let disk = concentric_disk(point);
                let drop = height * disk.length_squared();
                let scale = (height * (2.0 - drop)).sqrt();
                let across = across[0] * (disk.x * scale) + across[1] * (disk.y * scale);
                // The cap has 2π(1 − cos α), the square counts π.
                (across + axis * (1.0 - drop), 2.0 * height)
            }
            Span::Hemisphere { across } => {
                let local = cosine_hemisphere(point);
                let direction = across[0] * local.x + across[1] * local.y + receiver.normal * local.z;
                (direction, 1.0 / local.z.max(f32::MIN_POSITIVE))
            }
        };
        if direction.dot(receiver.geometric) <= 0.0 {
            return (direction, 0.0);
        }
        let cosine = direction.dot(receiver.normal).max(0.0);
        (direction, density * cosine * receiver.coat.transmittance(cosine))
    }

    /// Radiance of lamps that arrives from a direction by way of the lens, at the receiver's side.
    fn radiance(&mut self, direction: Vec3) -> Rgb {
        let tracer = self.lights.tracer;
        let Receiver { position, plane, media, .. } = *self.receiver;
        let mut ray = Ray { origin: position, direction, from: plane };
        let mut throughput = Rgb::ONE;
        let mut passage = Passage::new(tracer, direction, f32::INFINITY);
        let (mut sum, mut distance) = (Rgb::ZERO, 0.0);
        self.rays += 1;
        for _ in 0..MAX_CROSSINGS {
            self.scratch.rays += 1;
            let Some(hit) = tracer.nearest(&ray, f32::INFINITY) else { break };
            throughput *= tracer.media().transmittance(media.current(), hit.t);
            distance += hit.t;
            let is_lens = self.lens.holds(hit.triangle);
            if is_lens {
                self.meets += 1;
            } else if matches!(self.span, Span::Cone { distance: before, .. } if distance < before) {
                self.blocked += 1;
            }
            let at = ray.origin + direction * hit.t;
            let from = tracer.planes().of(hit.triangle);
            if media == MediumStack::AIR && tracer.slab_of(hit.triangle).is_some() {
                if !passage.passes(&hit, hit.t) {
                    break;
                }
                (ray.origin, ray.from) = (at, from);
                continue;
            }
            let throughput_here = throughput * passage.share();
            let interaction = tracer.interact(direction, &hit, media);
            let mut goes_on = Rgb::ZERO;
            for (branch, number) in interaction.branches().iter().zip(0..) {
                match branch.event {
                    Event::Undeviated => goes_on += branch.throughput,
                    Event::Curved if is_lens => {
                        let origin = tracer.departure(&hit, at);
                        let ray = Ray { origin, direction: branch.direction, from };
                        sum += self.beyond(ray, branch.media, throughput_here * branch.throughput, number);
                    }
                    // Others own it.
                    Event::Curved
                    | Event::Planar(_)
                    | Event::Facet(_)
                    | Event::Enters(_)
                    | Event::Leaves(_) => {}
                }
            }
            throughput *= goes_on;
            if throughput.max_element() <= 0.0 {
                break;
            }
            (ray.origin, ray.from) = (at, from);
        }
        sum
    }

    /// What lamps send along a ray that has left the lens, or is in it.
    fn beyond(&mut self, ray: Ray, media: MediumStack, mut throughput: Rgb, branch: u32) -> Rgb {
        let lights = self.lights;
        let tracer: &Tracer = lights.tracer;
        let key = self.key.child(1 + branch);
        let strength = throughput.max_element();
        if strength < ROULETTE_BELOW {
            if key.child(1).point1(self.rays) * ROULETTE_BELOW >= strength {
                return Rgb::ZERO;
            }
            throughput *= ROULETTE_BELOW / strength;
        }
        let here = self.receiver.media.current();
        let params = SplitParams { roulette_below: ROULETTE_BELOW, ..SplitParams::default() };
        let (mut sum, mut rays) = (Rgb::ZERO, 0);
        let waiting: &mut Waiting = &mut self.scratch.waiting;
        split::trace_on(tracer, ray, media, throughput, (key, self.rays), &params, waiting, |sight| {
            rays += 1;
            if let Sight::Surface(seen) = sight {
                let emission = seen.interaction.emission.0;
                if emission != Rgb::ZERO && lights.source_at(seen.hit.triangle) == Source::Concentrated {
                    let scale = tracer.media().radiance_scale(here, seen.media.current());
                    sum += seen.throughput * emission * scale;
                }
            }
        });
        self.scratch.rays += rays;
        sum
    }
}
