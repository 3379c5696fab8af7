//! Shadow rays that small sources share, systematically in proportion to what each sends.

use glam::DVec3;

use catoptric_scene::{Rgb, Sky};
use catoptric_trace::PlaneId;
use catoptric_trace::sequence::Key;

use crate::chains::Unfolded;
use crate::contour::{self, Polygon};
use crate::emitter::Cell;

use super::seen::{Found, LampPart, Piece, Spare};
use super::shadow::{Goal, Tally};
use super::{Lights, Scratch, SourceIrradiance, Standpoint};

/// What shares its samples with others.
#[derive(Clone, Copy)]
enum Shared<'a> {
    Lamp(&'a LampPart),
    Piece(&'a Piece),
    Small(u32),
    Bundle(u32, Rgb),
    Loose(u32),
}

/// A sample of what is shared.
struct Drawn<'a> {
    light: DVec3,
    to: Goal<'a>,
    /// Irradiance of the whole, known or by this sample.
    whole: Rgb,
    /// Whose texture it has; a lamp has none.
    cell: Option<&'a Cell>,
}

/// Systematic samples of weights that come one after the other: in proportion to them, begun anywhere in the first step.
struct Systematic {
    step: f64,
    count: u32,
    drawn: u32,
    next: f64,
    position: f64,
}

impl Systematic {
    /// About `expected` samples of weights that sum to `total`: four at least, `most` at most.
    fn new(total: f64, expected: f64, most: u32, key: Key) -> Self {
        let most = most.max(1);
        let count = (expected.ceil() as u32).clamp(4.min(most), most);
        let step = total / f64::from(count);
        Self { step, count, drawn: 0, next: f64::from(key.uniform(0)) * step, position: 0.0 }
    }

    /// The next sample within the present weight: its number, from 1, and its place there in [0, 1). `None` where the next weight
    /// comes.
    fn draw(&mut self, weight: f64) -> Option<(u32, f64)> {
        if self.next >= self.position + weight || self.drawn >= self.count {
            self.position += weight;
            return None;
        }
        let place = ((self.next - self.position) / weight).clamp(0.0, 1.0 - 1e-12);
        self.next += self.step;
        self.drawn += 1;
        Some((self.drawn, place))
    }
}

/// Places in a small piece of a lobe that are weighed for one shadow ray.
const PLACES: u32 = 8;

impl Lights<'_> {
    /// All small pieces and groups together: systematic samples in proportion to their weights.
    pub(super) fn shared(
        &self,
        at: Standpoint,
        found: &Found,
        (total, share, samples): (f64, f64, u32),
        key: Key,
        scratch: &mut Scratch,
        tally: &mut Tally,
    ) -> SourceIrradiance {
        let (receiver, image) = (at.receiver, at.image);
        let mut result = SourceIrradiance::DARK;
        let key = key.child(0xffff);
        let mut systematic = Systematic::new(total, total * share, samples, key);
        let flat = found.lamps.iter().filter(|l| l.shares);
        let lamps = flat.map(|l| (Shared::Lamp(l), l.weight));
        let pieces = found.pieces.iter().filter(|p| p.shares);
        let pieces = pieces.map(|p| (Shared::Piece(p), p.weight));
        let small = found.small.iter().map(|s| (Shared::Small(s.0), s.1));
        let bundles = found.bundles.iter().map(|b| (Shared::Bundle(b.0, b.1), f64::from(b.1.element_sum())));
        let loose = found.loose.iter().map(|s| (Shared::Loose(s.0), s.1));
        for (which, weight) in lamps.chain(pieces).chain(small).chain(bundles).chain(loose) {
            let known = match which {
                Shared::Small(group) => self.emitters.tree().irradiance(group, image.position, image.normal),
                Shared::Bundle(_, irradiance) => irradiance,
                Shared::Piece(piece) => piece.irradiance(&self.emitters),
                Shared::Lamp(part) => part.irradiance(&self.emitters),
                Shared::Loose(_) => Rgb::ZERO,
            };
            result.unoccluded += known;
            while let Some((number, inner)) = systematic.draw(weight) {
                let sampled = self.sample(which, known, image, found, inner, key, number, &mut scratch.fan);
                let Some(Drawn { light, to, whole, cell }) = sampled else { continue };
                // Each sample stands for an equal share of the weight.
                let mut each = whole * (systematic.step / weight) as f32;
                if let Shared::Loose(_) = which {
                    result.unoccluded += each;
                }
                let offset = light - image.position;
                let distance = offset.length();
                let cos = (image.normal.dot(offset) / distance) as f32;
                if let Some(cell) = cell.filter(|cell| cell.textured) {
                    each *= cell.radiance_at(self.tracer, light) / cell.radiance.max(Rgb::splat(1e-30));
                }
                let seen = self.throughput(at, light, to, distance, None, scratch, tally);
                let found = each * seen * receiver.coat.transmittance(cos);
                result.irradiance += found;
                tally.systematic(number, systematic.count, found);
            }
        }
        result
    }

    /// A point of what is shared, whose irradiance is `known` or found by this sample.
    fn sample(
        &self,
        which: Shared,
        known: Rgb,
        image: &Unfolded,
        found: &Found,
        inner: f64,
        key: Key,
        number: u32,
        fan: &mut Vec<f64>,
    ) -> Option<Drawn<'_>> {
        let other = f64::from(key.point1(number));
        let tree = self.emitters.tree();
        let of_cell = |index: u32, light: DVec3, whole: Rgb| {
            let cell = &self.emitters.cells()[index as usize];
            Drawn { light, to: Goal::Plane(cell.plane), whole, cell: Some(cell) }
        };
        match which {
            Shared::Lamp(part) => {
                let corners = &found.corners[part.corners.clone()];
                contour::fan_of(corners, fan);
                let light = contour::point_in_fan(corners, fan, inner, other);
                let to = Goal::of(&self.emitters.lamps()[part.lamp as usize]);
                Some(Drawn { light, to, whole: known, cell: None })
            }
            Shared::Piece(piece) => {
                let corners = &found.corners[piece.corners.clone()];
                let light = self.place(piece.cell, corners, image, (inner, other), key.child(number));
                Some(of_cell(piece.cell, light, known))
            }
            Shared::Small(group) => {
                let (index, rest) = tree.choose(group, inner);
                Some(of_cell(index, self.emitters.cells()[index as usize].point(rest, other), known))
            }
            Shared::Bundle(group, _) => {
                let (index, rest) = tree.choose_of_bundle(group, &image.view(&found.windows), inner)?;
                Some(of_cell(index, self.emitters.cells()[index as usize].point(rest, other), known))
            }
            Shared::Loose(group) => {
                let (index, probability, rest) = tree.draw(group, &image.view(&found.windows), inner)?;
                let cell = &self.emitters.cells()[index as usize];
                if !cell.faces(image.position) {
                    return None;
                }
                if let Some(unit) = Self::unit_of_whole(cell, image, &found.windows) {
                    let whole = cell.radiance * (unit / probability) as f32;
                    return (unit > 0.0).then(|| of_cell(index, cell.point(rest, other), whole));
                }
                // Of the parts of the cell, seen through several windows, one in proportion.
                let mut chosen = Polygon::default();
                let (mut total, mut count) = (0.0, 0);
                let key = key.child(number);
                self.pieces_of(index, image, &found.windows, &mut Spare::default(), |part| {
                    total += part.unit;
                    count += 1;
                    if f64::from(key.uniform(count)) * total < part.unit {
                        chosen.assign(part.corners);
                    }
                });
                if chosen.is_empty() {
                    return None;
                }
                let light = self.place(index, chosen.corners(), image, (rest, other), key.child(0));
                Some(of_cell(index, light, cell.radiance * (total / probability) as f32))
            }
        }
    }

    /// A point of a piece for what shares its samples. Small pieces that are diffuse send about the same from
    /// everywhere; of a lobe, however small the piece, one of some places is taken in proportion to what it sends, so
    /// that the piece's irradiance is exact where nothing blocks.
    fn place(&self, cell: u32, corners: &[DVec3], image: &Unfolded, (u, v): (f64, f64), key: Key) -> DVec3 {
        let cell = &self.emitters.cells()[cell as usize];
        if cell.lobe.is_diffuse() {
            contour::point_in(corners, u, v)
        } else {
            place_in_lobe(cell, corners, image, (u, v), key)
        }
    }

    /// Bright texels of the sky, by systematic samples in proportion to what they send.
    pub(super) fn bright_part(
        &self,
        at: Standpoint,
        samples: u32,
        known: f64,
        key: Key,
        scratch: &mut Scratch,
        tally: &mut Tally,
    ) -> SourceIrradiance {
        let (receiver, image) = (at.receiver, at.image);
        let mut result = SourceIrradiance::DARK;
        let Some(Sky::Image(map)) = self.tracer.scene().sky() else { return result };
        let mut texels = std::mem::take(&mut scratch.texels);
        texels.clear();
        let (mut total, mut middle) = (0.0_f64, DVec3::ZERO);
        for (index, texel) in self.bright.texels().iter().enumerate() {
            let direction = texel.direction.as_dvec3();
            let cos = image.normal.dot(direction);
            if cos > 0.0 && image.geometric.dot(direction) > 0.0 {
                let weight = texel.power.element_sum() * cos as f32;
                total += f64::from(weight);
                middle += direction * f64::from(weight);
                texels.push((index as u32, weight));
                result.unoccluded += texel.power * cos as f32;
            }
        }
        let reflected = at.chain.map_or(1.0, |chain| self.chains.reflectance(chain, middle));
        let expected = f64::from(samples) * total / (total + known / reflected).max(f64::MIN_POSITIVE);
        let key = key.child(0xfffe);
        let mut systematic = Systematic::new(total, expected, samples, key);
        for &(index, weight) in &texels {
            let weight = f64::from(weight);
            let texel = &self.bright.texels()[index as usize];
            while let Some((number, _)) = systematic.draw(weight) {
                let jitter = key.point2(number);
                let direction = self.bright.direction_in(map, texel, jitter.x, jitter.y);
                let cos = image.normal.dot(direction.as_dvec3()).max(0.0);
                let light = image.position + direction.as_dvec3() * f64::from(self.far);
                let seen = self.throughput(at, light, Goal::Plane(PlaneId::NONE), 0.0, None, scratch, tally);
                let center_cos = image.normal.dot(texel.direction.as_dvec3());
                let each = texel.power * (center_cos * systematic.step / weight) as f32;
                let tilt = (cos / center_cos) as f32;
                let found = each * tilt * seen * receiver.coat.transmittance(cos as f32);
                result.irradiance += found;
                tally.systematic(number, systematic.count, found);
            }
        }
        scratch.texels = texels;
        result
    }
}

#[cold]
fn place_in_lobe(cell: &Cell, corners: &[DVec3], image: &Unfolded, (u, v): (f64, f64), key: Key) -> DVec3 {
    let (mut chosen, mut total) = (contour::point_in(corners, u, v), 0.0);
    for index in 0..PLACES {
        // A rank-1 lattice about (u, v).
        let (s, t) = (u + f64::from(index) / f64::from(PLACES), v + f64::from(index) * 0.375);
        let light = contour::point_in(corners, s.fract(), t.fract());
        let offset = light - image.position;
        let r2 = offset.length_squared();
        let leaves = -cell.normal.dot(offset) / r2.sqrt();
        let sent = (image.normal.dot(offset) * leaves).max(0.0) / (r2 * r2.sqrt()).max(1e-300);
        let weight = sent * cell.lobe.factor(leaves);
        total += weight;
        if f64::from(key.uniform(index)) * total < weight {
            chosen = light;
        }
    }
    chosen
}
