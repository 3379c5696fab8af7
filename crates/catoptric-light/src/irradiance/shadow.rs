//! How much of a large source's light arrives: exactly, where what is in the way is known, or by stratified shadow rays. Where few
//! triangles are in the way, the rays ask these.

use std::ops::Range;

use glam::DVec3;

use catoptric_scene::Rgb;
use catoptric_trace::beam::Suspects;
use catoptric_trace::sequence::Key;
use catoptric_trace::{Occlusion, PlaneId, walk};

use crate::contour;
use crate::emitter::{Cell, Emitters};
use crate::lamp::Lamp;
use crate::receiver::Receiver;

use super::seen::{LampPart, Piece};
use super::way::{Passing, Way};
use super::{LOOK, Lights, Scratch, Standpoint};

/// What shadow rays go to.
#[derive(Clone, Copy)]
pub(super) enum Goal<'a> {
    /// A point in a plane.
    Plane(PlaneId),
    /// The first of the triangles of a lamp, which is not flat, that they meet.
    Lamp(&'a Lamp),
}

impl<'a> Goal<'a> {
    /// Points of a lamp.
    pub(super) fn of(lamp: &'a Lamp) -> Self {
        lamp.plane().map_or(Self::Lamp(lamp), Self::Plane)
    }
}

/// What gets strata of its own.
#[derive(Clone, Copy)]
pub(super) struct Target<'a> {
    radiance: Rgb,
    /// Irradiance by unit radiance.
    pub(super) unit: f64,
    /// Unit normal of its plane, away from the receiver.
    axis: DVec3,
    pub(super) corners: &'a [DVec3],
    pub(super) to: Goal<'a>,
    /// Whose lobe and texture it has; a lamp has neither.
    pub(super) cell: Option<&'a Cell>,
    /// The cell that it is all of.
    whole: Option<&'a Cell>,
}

impl<'a> Target<'a> {
    /// A piece of a cell.
    pub(super) fn piece(piece: &Piece, corners: &'a [DVec3], emitters: &'a Emitters) -> Self {
        let cell = &emitters.cells()[piece.cell as usize];
        Self {
            radiance: cell.radiance,
            unit: piece.unit,
            axis: -cell.normal,
            corners: &corners[piece.corners.clone()],
            to: Goal::Plane(cell.plane),
            cell: Some(cell),
            whole: piece.whole.then_some(cell),
        }
    }

    /// A lamp, or what is seen of it.
    pub(super) fn lamp(part: &LampPart, corners: &'a [DVec3], emitters: &'a Emitters) -> Self {
        let lamp = &emitters.lamps()[part.lamp as usize];
        Self {
            radiance: lamp.radiance,
            unit: part.unit,
            axis: part.axis,
            corners: &corners[part.corners.clone()],
            to: Goal::of(lamp),
            cell: None,
            whole: None,
        }
    }

    /// What it sends if nothing blocks.
    pub(super) fn irradiance(&self) -> Rgb {
        self.radiance * self.unit as f32
    }

    /// The point of unit-square coordinates (u, v), uniform by area; `fan` is that of its corners.
    fn point(&self, fan: &[f64], u: f64, v: f64) -> DVec3 {
        self.whole.map_or_else(|| contour::point_in_fan(self.corners, fan, u, v), |cell| cell.point(u, v))
    }
}

/// What one target is worth.
#[derive(Clone, Copy)]
pub(super) struct Budget {
    /// Shadow rays.
    pub(super) count: u32,
    /// See [`Samples::calm`](super::Samples::calm).
    pub(super) calm: bool,
    /// Triangles whose shadows are cut out.
    pub(super) shadows: u32,
}

/// How a target is sampled.
#[derive(Clone, Copy)]
struct Shots {
    count: u32,
    key: Key,
    /// Samples lie in the parts that are seen, which send so much by unit radiance.
    parts: Option<f64>,
    /// Nothing is in the way.
    free: bool,
    /// Nothing else than the suspects in the scratch is.
    among: bool,
}

/// Weights of samples and what they found.
#[derive(Clone, Copy, Default)]
struct Sums {
    all: (f64, DVec3),
    /// Of the first half.
    first: (f64, DVec3),
}

/// Samples of a smooth integrand, where nothing blocks: Fresnel's reflectance of mirrors, the transmittance of a medium.
const FREE_SAMPLES: u32 = 4;

impl Lights<'_> {
    /// Throughput from the receiver to a point of a source.
    #[inline]
    pub(super) fn throughput(
        &self,
        at: Standpoint,
        light: DVec3,
        to: Goal,
        distance: f64,
        suspects: Option<&Suspects>,
        scratch: &mut Scratch,
        tally: &mut Tally,
    ) -> Rgb {
        scratch.rays += 1;
        let Standpoint { receiver, chain, .. } = at;
        let (position, plane) = (receiver.position, receiver.plane);
        if let Some(chain) = chain {
            self.chains.targets(chain, light, &mut scratch.targets);
        }
        let share = match (chain, to) {
            (None, Goal::Plane(to)) => match suspects {
                Some(suspects) => {
                    self.tracer.visibility_among(suspects, position, plane, light.as_vec3(), to)
                }
                None => self.tracer.visibility(position, plane, light.as_vec3(), to),
            },
            (None, Goal::Lamp(lamp)) => {
                let direction = light.as_vec3() - position;
                let meets = |s, limit| self.tracer.meets(s, position, plane, direction, limit);
                let before = || lamp.distance(position.as_dvec3()) as f32 / direction.length();
                match suspects {
                    // Where it meets nothing else, it meets the lamp.
                    Some(s) if meets(s, f32::INFINITY) == Occlusion::Free => Rgb::ONE,
                    Some(s) if meets(s, before()) == Occlusion::Blocked => Rgb::ZERO,
                    _ => self.tracer.reaches(position, plane, direction, &lamp.triangles, 0.0),
                }
            }
            (Some(chain), Goal::Plane(to)) => {
                walk::follow(self.tracer, position, plane, &chain.planes, &scratch.targets, to)
            }
            (Some(chain), Goal::Lamp(lamp)) => {
                match walk::over_mirrors(self.tracer, position, plane, &chain.planes, &scratch.targets) {
                    Some(left) => {
                        let direction = left.target - left.origin;
                        left.throughput
                            * self.tracer.reaches(
                                left.origin,
                                left.from,
                                direction,
                                &lamp.triangles,
                                left.distance,
                            )
                    }
                    None => Rgb::ZERO,
                }
            }
        };
        tally.count(share);
        share * self.tracer.media().transmittance(receiver.media.current(), distance as f32)
    }

    /// Whether light that nothing blocks arrives as the contour formula says: no coat, and nothing that absorbs.
    fn is_plain(&self, receiver: &Receiver) -> bool {
        receiver.coat.is_none()
            && self.tracer.media().transmittance(receiver.media.current(), self.far) == Rgb::ONE
    }

    /// Irradiance by one target: exact where that is known, or else by `count` stratified shadow rays, or by the first of them where
    /// they do.
    pub(super) fn strata(
        &self,
        at: Standpoint,
        target: &Target,
        Budget { count, calm, shadows }: Budget,
        key: Key,
        scratch: &mut Scratch,
        tally: &mut Tally,
    ) -> Rgb {
        let is_textured = target.cell.is_some_and(|cell| cell.textured);
        // One sample agrees with itself.
        if is_textured || count == 1 {
            tally.mixed();
        }
        let shots = Shots { count, key, parts: None, free: false, among: false };
        let mut sums = Sums::default();
        if count == 1 {
            return self.shoot(at, target, &shots, 0..1, &mut sums, scratch, tally);
        }
        let look = calm && !is_textured && count > LOOK;
        let mut is_blocked = false;
        if look {
            let shots = match self.way(at, target, count, 0, scratch) {
                Way::Among => Shots { among: true, ..shots },
                Way::Unknown | Way::Partly { .. } => shots,
                way => return self.known(at, target, way, &shots, scratch, tally),
            };
            let found = self.shoot(at, target, &shots, 0..LOOK, &mut sums, scratch, tally);
            is_blocked = found == Rgb::ZERO;
            if tally.is_target_even() && !is_blocked {
                tally.looked = true;
                return found;
            }
        }
        let shots = match self.way(at, target, count, shadows, scratch) {
            Way::Among | Way::Unknown if is_blocked => {
                tally.looked = true;
                return Rgb::ZERO;
            }
            Way::Among => Shots { among: true, ..shots },
            Way::Unknown => shots,
            Way::Partly { unit, among } => {
                tally.hidden(unit / target.unit);
                if unit <= 0.0 {
                    return Rgb::ZERO;
                }
                sums = Sums::default();
                Shots { among, parts: Some(unit), ..shots }
            }
            way => return self.known(at, target, way, &shots, scratch, tally),
        };
        // Of a window behind blinds a fiftieth may be seen, that four samples of all of it miss, and all places around alike: as many look for it
        // in what walls leave.
        if is_blocked {
            let found = self.shoot(at, target, &shots, 0..LOOK, &mut sums, scratch, tally);
            if found == Rgb::ZERO {
                tally.looked = true;
                return found;
            }
        }
        // A prefix of the sequence is stratified, too.
        let first = if is_blocked || look && shots.parts.is_none() { LOOK } else { 0 };
        self.shoot(at, target, &shots, first..count, &mut sums, scratch, tally)
    }

    /// Irradiance by a target that is seen wholly or in parts that are known. What its light passes on the way is smooth, or takes all
    /// the samples.
    fn known(
        &self,
        at: Standpoint,
        target: &Target,
        way: Way,
        shots: &Shots,
        scratch: &mut Scratch,
        tally: &mut Tally,
    ) -> Rgb {
        let (parts, passes) = match way {
            Way::Seen { unit, passes } => (Some(unit), passes),
            _ => (None, Passing::Nothing),
        };
        let unit = parts.unwrap_or(target.unit);
        tally.exact(unit / target.unit);
        let is_textured = target.cell.is_some_and(|cell| cell.textured);
        let passes_nothing = at.chain.is_none() && passes == Passing::Nothing;
        if unit <= 0.0 || passes_nothing && !is_textured && self.is_plain(at.receiver) {
            return target.radiance * unit as f32;
        }
        let varies = is_textured || passes == Passing::Varied;
        let count = if varies { shots.count } else { shots.count.min(FREE_SAMPLES) };
        let shots = Shots { count, parts, free: passes_nothing, ..*shots };
        let sampled = tally.sampled || varies;
        let found = self.shoot(at, target, &shots, 0..count, &mut Sums::default(), scratch, tally);
        tally.sampled = sampled;
        // By so many samples textures are as doubtful as shadows are, though no ray is traced.
        tally.rays = if varies { count } else { 0 };
        found
    }

    /// Irradiance by a target by the samples so far and more of them.
    fn shoot(
        &self,
        at: Standpoint,
        target: &Target,
        shots: &Shots,
        indices: Range<u32>,
        sums: &mut Sums,
        scratch: &mut Scratch,
        tally: &mut Tally,
    ) -> Rgb {
        let Standpoint { receiver, image, .. } = at;
        let textured = target.cell.filter(|cell| cell.textured);
        let lobed = target.cell.filter(|cell| !cell.lobe.is_diffuse());
        if target.whole.is_none() && shots.parts.is_none() {
            contour::fan_of(target.corners, &mut scratch.fan);
        }
        let suspects = shots.among.then(|| std::mem::take(&mut scratch.suspects));
        for index in indices {
            if index == shots.count / 2 {
                sums.first = sums.all;
            }
            let s = shots.key.point2(index).as_dvec2();
            let light = match shots.parts {
                Some(_) => scratch.remainder.sample(s.x, s.y),
                None => target.point(&scratch.fan, s.x, s.y),
            };
            let offset = light - image.position;
            let r2 = offset.length_squared();
            let distance = r2.sqrt();
            let cos = image.normal.dot(offset);
            let leaves = target.axis.dot(offset);
            let mut weight = (cos * leaves).max(0.0) / (r2 * r2).max(1e-300);
            if let Some(cell) = lobed {
                weight *= cell.lobe.factor(leaves / distance);
            }
            if weight <= 0.0 {
                continue;
            }
            sums.all.0 += weight;
            let mut share = if shots.free {
                self.tracer.media().transmittance(receiver.media.current(), distance as f32)
            } else {
                let among = suspects.as_ref();
                self.throughput(at, light, target.to, distance, among, scratch, tally)
            };
            if share == Rgb::ZERO {
                continue;
            }
            if let Some(cell) = textured {
                share *= cell.radiance_at(self.tracer, light) / cell.radiance.max(Rgb::splat(1e-30));
            }
            share *= receiver.coat.transmittance((cos / distance) as f32);
            sums.all.1 += share.as_dvec3() * weight;
        }
        if let Some(suspects) = suspects {
            scratch.suspects = suspects;
        }
        let unit = shots.parts.unwrap_or(target.unit);
        let irradiance = |(weights, sum): (f64, DVec3)| target.radiance * ((sum / weights) * unit).as_vec3();
        let (all, first) = (sums.all, sums.first);
        if all.0 <= 0.0 {
            return Rgb::ZERO;
        }
        if shots.count == 1 && shots.parts.is_none() {
            // The mean of shares by their weights is that of the points, wherever they are, if there is but one: here its weight counts.
            let area = target
                .whole
                .map_or_else(|| scratch.fan.last().map_or(0.0, |twice| 0.5 * twice), |cell| cell.area);
            return target.radiance * (all.1 * area).as_vec3();
        }
        if first.0 > 0.0 && all.0 > first.0 {
            tally.split += irradiance(first) - irradiance((all.0 - first.0, all.1 - first.1));
        }
        irradiance(all)
    }
}

/// Shares that are known exactly are 0 or 1 to within this: rounding.
const WHOLE: f64 = 1e-6;

/// Shares of the samples of a target that differ by less than this, relative, count as equal.
const EQUAL: f32 = 0.05;

/// Deviation of n stratified samples of a target of which some part is seen, relative to all of it, times n^¾: a border of half the light through 2 × 4
/// strata is off by a tenth.
const OFF: f32 = 0.5;

/// What the samples of the targets saw.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tally {
    seen: bool,
    missed: bool,
    uneven: bool,
    /// See [`SourceIrradiance::sampled`](super::SourceIrradiance::sampled).
    pub(super) sampled: bool,
    /// See [`SourceIrradiance::looked`](super::SourceIrradiance::looked).
    pub(super) looked: bool,
    /// Of the present target.
    least: f32,
    most: f32,
    /// Sum over all targets: see [`SourceIrradiance::split`].
    pub(super) split: Rgb,
    /// Samples of the present target that tell how much of it is seen, or how bright it is.
    rays: u32,
    /// Sum over those before: the square of [`SourceIrradiance::doubt`](super::SourceIrradiance::doubt).
    doubt: f32,
}

impl Default for Tally {
    fn default() -> Self {
        Self {
            seen: false,
            missed: false,
            uneven: false,
            sampled: false,
            looked: false,
            least: f32::INFINITY,
            most: 0.0,
            split: Rgb::ZERO,
            rays: 0,
            doubt: 0.0,
        }
    }
}

impl Tally {
    /// Some samples were seen and some not.
    pub(super) fn is_partial(self) -> bool {
        self.seen && self.missed
    }

    /// All samples of a target saw the same, of each target.
    pub(super) fn is_even(self) -> bool {
        !self.uneven
    }

    /// This share of the present target is known to be seen.
    fn exact(&mut self, share: f64) {
        self.least = self.least.min(if share < 1.0 - WHOLE { 0.0 } else { 1.0 });
        self.most = self.most.max(if share > WHOLE { 1.0 } else { 0.0 });
    }

    /// No more than this share of the present target may be seen.
    fn hidden(&mut self, share: f64) {
        self.least = self.least.min(if share < 1.0 - WHOLE { 0.0 } else { 1.0 });
    }

    /// All samples of the present target so far saw the same.
    fn is_target_even(&self) -> bool {
        self.most - self.least <= EQUAL * self.most
    }

    /// See [`SourceIrradiance::doubt`](super::SourceIrradiance::doubt).
    pub(super) fn doubt(self) -> f32 {
        self.doubt.sqrt()
    }

    /// What follows are samples of something else. The present target, or all of a kind, sends `whole` if nothing blocks, channels added.
    pub(super) fn next(&mut self, whole: f32) {
        let rays = std::mem::take(&mut self.rays) as f32;
        if rays > 0.0 {
            self.doubt += (OFF * whole).powi(2) / (rays * rays.sqrt());
        }
    }

    /// What follows is another target; see [`Tally::next`].
    pub(super) fn next_target(&mut self, whole: f32) {
        self.next(whole);
        self.uneven |= !self.is_target_even();
        (self.least, self.most) = (f32::INFINITY, 0.0);
    }

    /// Samples of different things: what they see tells nothing about what others would.
    pub(super) fn mixed(&mut self) {
        self.uneven = true;
    }

    /// Halves of systematic samples are every other one; `number` from 1. The last of an odd number is in neither: one half would be
    /// larger, whatever it found.
    pub(super) fn systematic(&mut self, number: u32, count: u32, found: Rgb) {
        if number <= count / 2 * 2 {
            self.split += if number.is_multiple_of(2) { found } else { -found } * 2.0;
        }
    }

    #[inline]
    fn count(&mut self, share: Rgb) {
        self.sampled = true;
        self.rays += 1;
        if share == Rgb::ZERO {
            self.missed = true;
        } else {
            self.seen = true;
        }
        let share = share.max_element();
        self.least = self.least.min(share);
        self.most = self.most.max(share);
    }
}
