//! Irradiance at a point by area emitters and the bright sky: straight, and over image chains.
//!
//! Per emitter cell: Lambert's formula on the part above the horizon and inside the mirrors' windows, times the mean
//! throughput of stratified shadow rays, weighted by the integrand. Unoccluded untextured light is exact, and where the
//! whole pyramid of shadow rays is empty it needs none. Cosine lobes have a contour formula of their own, and their
//! factor is part of the integrand.

use std::ops::Range;

use glam::{DVec3, Vec3};

use catoptric_scene::{Rgb, Sky};
use catoptric_trace::beam::{Base, End, Pyramid};
use catoptric_trace::plane::Plane;
use catoptric_trace::sequence::Key;
use catoptric_trace::{PlaneId, Tracer, walk};

use crate::chains::{ImageChain, ImageChains, Unfolded};
use crate::contour::{self, Polygon};
use crate::emitter::{Cell, Emitters};
use crate::lamp::{Beyond, Outline, Sight};
use crate::light_tree::{Cut, Part, Windows};
use crate::receiver::Receiver;
use crate::sky::BrightSky;

/// How sources are evaluated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LightParams {
    /// Images of sources in planar mirrors (off for plain radiosity).
    pub images: bool,
    /// Whether a light-side pass owns the caustic paths.
    pub light_rays: bool,
}

impl Default for LightParams {
    fn default() -> Self {
        Self { images: true, light_rays: true }
    }
}

/// The sources of a scene, ready to be asked.
#[derive(Clone, Debug)]
pub struct Lights<'a> {
    tracer: &'a Tracer<'a>,
    emitters: Emitters,
    chains: ImageChains,
    bright: BrightSky,
    params: LightParams,
    far: f32,
}

/// Reused buffers of one thread.
#[derive(Clone, Debug, Default)]
pub struct Scratch {
    pieces: Vec<Piece>,
    small: Vec<(u32, f64)>,
    loose: Vec<(u32, f64)>,
    cut: Cut,
    windows: Windows,
    texels: Vec<(u32, f32)>,
    lamps: Vec<LampPart>,
    corners: Vec<DVec3>,
    outline: Outline,
    spare: [Vec<DVec3>; 2],
    pub(crate) targets: Vec<Vec3>,
    /// Shadow rays cast (chains count one).
    pub rays: u64,
}

/// A visible part of a cell.
#[derive(Clone, Copy, Debug)]
struct Piece {
    polygon: Polygon,
    cell: u32,
    whole: bool,
    /// Irradiance by unit radiance.
    unit: f64,
    weight: f64,
}

impl Piece {
    fn irradiance(&self, emitters: &Emitters) -> Rgb {
        emitters.cells()[self.cell as usize].radiance * self.unit as f32
    }
}

/// A visible part of a lamp.
#[derive(Clone, Debug)]
struct LampPart {
    lamp: u32,
    /// Where its corners lie in [`Found::corners`].
    corners: Range<usize>,
    /// Unit normal of the outline's plane, away from the receiver.
    axis: DVec3,
    /// Irradiance by unit radiance.
    unit: f64,
    weight: f64,
}

/// What shadow rays go to.
#[derive(Clone, Copy)]
enum Goal<'a> {
    /// A point in a plane.
    Plane(PlaneId),
    /// The first of some triangles that they meet.
    Triangles(&'a Range<u32>),
}

/// What one receiver sees of the emitters.
struct Found {
    lamps: Vec<LampPart>,
    /// Of the lamps.
    corners: Vec<DVec3>,
    /// Parts of cells, known exactly.
    pieces: Vec<Piece>,
    /// Small and far groups with their irradiance.
    small: Vec<(u32, f64)>,
    /// Groups beyond the budget with the bound of their irradiance.
    loose: Vec<(u32, f64)>,
    windows: Windows,
}

impl Found {
    /// So few that each gets strata of its own.
    fn is_few(&self) -> bool {
        self.lamps.len() + self.pieces.len() + self.small.len() + self.loose.len() <= 4
    }
}

/// What shares its samples with others.
#[derive(Clone, Copy)]
enum Shared<'a> {
    Piece(&'a Piece),
    Small(u32),
    Loose(u32),
}

/// Samples of a smooth integrand, where nothing blocks: Fresnel's reflectance of mirrors, the transmittance of a medium.
const FREE_SAMPLES: u32 = 4;
/// Where the keys of lamps begin, beyond those of pieces.
const LAMPS: u32 = 0x8000;
/// Parts that the emitters are cut into for one receiver, at least.
const PARTS: usize = 48;
/// And more the more samples are taken, so that the cut never costs much beside the shadow rays.
const PARTS_PER_SAMPLE: usize = 2;

/// Places in a small piece of a lobe that are weighed for one shadow ray.
const PLACES: u32 = 8;

/// Irradiance with what its shadow rays saw.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SourceIrradiance {
    /// The irradiance.
    pub irradiance: Rgb,
    /// The same if nothing blocked.
    pub unoccluded: Rgb,
    /// Some strata were visible and some were not.
    pub partial: bool,
}

impl<'a> Lights<'a> {
    /// Collects the sources and finds the image chains.
    pub fn new(tracer: &'a Tracer<'a>, params: LightParams) -> Self {
        let emitters = Emitters::new(tracer);
        let scene = tracer.scene();
        let bright = BrightSky::new(scene.sky());
        let far_sources = !scene.lights().is_empty() || !bright.is_empty();
        let chains = if params.images {
            ImageChains::new(tracer, &emitters, far_sources)
        } else {
            ImageChains::default()
        };
        // Far enough that no parallax is left in f32, near enough that nothing overflows.
        let far = (tracer.diagonal() * 1e4).max(1.0);
        Self { tracer, emitters, chains, bright, params, far }
    }

    /// The tracer.
    pub fn tracer(&self) -> &'a Tracer<'a> {
        self.tracer
    }

    /// The area emitters.
    pub fn emitters(&self) -> &Emitters {
        &self.emitters
    }

    /// The image chains.
    pub fn chains(&self) -> &ImageChains {
        &self.chains
    }

    /// The bright sky.
    pub fn bright_sky(&self) -> &BrightSky {
        &self.bright
    }

    /// The parameters.
    pub fn params(&self) -> LightParams {
        self.params
    }

    /// Distance that stands for infinity.
    pub(crate) fn far(&self) -> f32 {
        self.far
    }

    /// Whether there is any area emitter or bright sky.
    pub fn has_sources(&self) -> bool {
        !(self.emitters.is_empty() && self.bright.is_empty())
    }

    /// Irradiance straight from sources, or through what lets light pass undeviated, by about `samples` shadow rays.
    pub fn direct(
        &self,
        receiver: &Receiver,
        samples: u32,
        key: Key,
        scratch: &mut Scratch,
    ) -> SourceIrradiance {
        let image = Unfolded {
            position: receiver.position.as_dvec3(),
            normal: receiver.normal.as_dvec3(),
            geometric: receiver.geometric.as_dvec3(),
            last: PlaneId::NONE,
            beyond: None,
        };
        self.over(receiver, None, &image, samples, key, scratch)
    }

    /// Irradiance over all image chains, by about `samples` followed paths per chain that is seen.
    pub fn mirrored(
        &self,
        receiver: &Receiver,
        samples: u32,
        key: Key,
        scratch: &mut Scratch,
    ) -> SourceIrradiance {
        let mut sum = SourceIrradiance::default();
        let (position, normal) = (receiver.position.as_dvec3(), receiver.normal.as_dvec3());
        for (index, chain) in self.chains.chains().iter().enumerate() {
            let Some(image) = self.chains.unfold(chain, position, normal, receiver.geometric.as_dvec3())
            else {
                continue;
            };
            let key = key.child(index as u32 + 1);
            let part = self.over(receiver, Some(chain), &image, samples, key, scratch);
            sum.irradiance += part.irradiance;
            sum.unoccluded += part.unoccluded;
            sum.partial |= part.partial;
        }
        sum
    }

    /// Irradiance by the broad emitters if nothing blocked them: the control variate of the hemisphere rays, which see
    /// what does block. Without a coat only: the contour formula knows none.
    pub fn broad_unoccluded(&self, receiver: &Receiver) -> Rgb {
        let (position, normal) = (receiver.position.as_dvec3(), receiver.normal.as_dvec3());
        let geometric = receiver.geometric.as_dvec3();
        self.emitters
            .broad()
            .iter()
            .filter(|cell| cell.normal.dot(position - cell.point(0.0, 0.0)) > 0.0)
            .map(|cell| {
                let above = cell.polygon().clipped(geometric, geometric.dot(position));
                cell.radiance * contour::irradiance(position, normal, &above) as f32
            })
            .sum()
    }

    fn over(
        &self,
        receiver: &Receiver,
        chain: Option<&ImageChain>,
        image: &Unfolded,
        samples: u32,
        key: Key,
        scratch: &mut Scratch,
    ) -> SourceIrradiance {
        let mut result = SourceIrradiance::default();
        let mut tally = Tally::default();
        self.gather_pieces(chain, image, samples, scratch);
        let found = Found {
            pieces: std::mem::take(&mut scratch.pieces),
            small: std::mem::take(&mut scratch.small),
            loose: std::mem::take(&mut scratch.loose),
            windows: std::mem::take(&mut scratch.windows),
            lamps: std::mem::take(&mut scratch.lamps),
            corners: std::mem::take(&mut scratch.corners),
        };
        let Found { lamps, pieces, small, loose, .. } = &found;
        let groups: f64 = small.iter().chain(loose).map(|s| s.1).sum();
        let whole: f64 = lamps.iter().map(|l| l.weight).sum::<f64>()
            + pieces.iter().map(|p| p.weight).sum::<f64>()
            + groups;
        if whole > 0.0 {
            // Large pieces get strata of their own, small ones share.
            let share = f64::from(samples) / whole;
            let mut leftover = 0.0;
            for (index, piece) in pieces.iter().enumerate() {
                let expected = piece.weight * share;
                if expected < 1.5 && !found.is_few() {
                    leftover += piece.weight;
                    continue;
                }
                let count = (expected.round() as u32).clamp(4, samples.max(4)).next_power_of_two();
                let part = self.piece(
                    receiver,
                    chain,
                    image,
                    piece,
                    count,
                    key.child(index as u32),
                    scratch,
                    &mut tally,
                );
                result.irradiance += part;
                result.unoccluded += self.emitters.cells()[piece.cell as usize].radiance * piece.unit as f32;
            }
            for (index, part) in lamps.iter().enumerate() {
                let expected = (part.weight * share).ceil() as u32;
                let count =
                    if expected < 2 { 1 } else { expected.clamp(4, samples.max(4)).next_power_of_two() };
                let key = key.child(LAMPS + index as u32);
                result.irradiance +=
                    self.lamp(receiver, chain, image, part, &found.corners, count, key, scratch, &mut tally);
                result.unoccluded += self.emitters.lamps()[part.lamp as usize].radiance * part.unit as f32;
            }
            let total_small = leftover + groups;
            if total_small > 0.0 {
                let part = self.shared(
                    receiver,
                    chain,
                    image,
                    &found,
                    (total_small, share, samples),
                    key,
                    scratch,
                    &mut tally,
                );
                result.irradiance += part.irradiance;
                result.unoccluded += part.unoccluded;
            }
        }
        scratch.pieces = found.pieces;
        scratch.small = found.small;
        scratch.loose = found.loose;
        scratch.windows = found.windows;
        scratch.lamps = found.lamps;
        scratch.corners = found.corners;
        if !self.bright.is_empty() {
            let part = self.bright_part(receiver, chain, image, samples, key, scratch, &mut tally);
            result.irradiance += part.irradiance;
            result.unoccluded += part.unoccluded;
        }
        result.partial = tally.seen && tally.missed;
        result
    }

    /// The parts of the emitters that the receiver may see, clipped to horizon and windows.
    fn gather_pieces(
        &self,
        chain: Option<&ImageChain>,
        image: &Unfolded,
        samples: u32,
        scratch: &mut Scratch,
    ) {
        self.gather_lamps(chain, image, scratch);
        let Scratch { pieces, small, loose, cut, windows, .. } = scratch;
        small.clear();
        loose.clear();
        let budget = PARTS + PARTS_PER_SAMPLE * samples as usize;
        self.emitters.tree().cut(self.emitters.cells(), &image.view(windows), budget, cut);
        for part in cut.parts() {
            match part {
                Part::Group(group) => {
                    let irradiance = self.emitters.tree().irradiance(group, image.position, image.normal);
                    if irradiance.max_element() > 0.0 {
                        small.push((group, f64::from(irradiance.element_sum())));
                    }
                }
                Part::Loose(group, bound) => loose.push((group, bound)),
                Part::Cell(index) => self.pieces_of(index, image, windows, |piece| pieces.push(piece)),
            }
        }
    }

    /// The windows, and the parts of the lamps that the receiver may see; those that are too near, by their cells.
    fn gather_lamps(&self, chain: Option<&ImageChain>, image: &Unfolded, scratch: &mut Scratch) {
        let Scratch { pieces, windows, lamps, corners, outline, spare: [part, spare], .. } = scratch;
        pieces.clear();
        lamps.clear();
        corners.clear();
        windows.clear();
        for outlines in chain.iter().flat_map(|c| &c.windows) {
            windows.add(image.position, outlines);
        }
        let horizon = image.geometric.dot(image.position);
        for (index, lamp) in self.emitters.lamps().iter().enumerate() {
            if !lamp.may_be_seen(image.position, windows) {
                continue;
            }
            let sight = match lamp.beyond(image.beyond) {
                Beyond::No => Sight::Hidden,
                Beyond::Partly => Sight::Facets,
                Beyond::Wholly => lamp.outline(image.position, image.geometric, image.last, outline),
            };
            match sight {
                Sight::Hidden => {}
                Sight::Facets => {
                    for cell in lamp.cells.clone() {
                        if self.emitters.cells()[cell as usize].faces(image.position) {
                            self.pieces_of(cell, image, windows, |piece| pieces.push(piece));
                        }
                    }
                }
                Sight::Outline => {
                    contour::cut(&mut outline.corners, image.geometric, horizon, spare);
                    let axis = outline.axis;
                    let mut add = |seen: &[DVec3], spare: &mut Vec<DVec3>| {
                        let unit = contour::irradiance_of(image.position, image.normal, seen, spare);
                        if unit > 0.0 {
                            let weight = unit * f64::from(lamp.radiance.element_sum());
                            let start = corners.len();
                            corners.extend(seen);
                            let range = start..corners.len();
                            lamps.push(LampPart { lamp: index as u32, corners: range, axis, unit, weight });
                        }
                    };
                    if windows.is_empty() {
                        add(&outline.corners, spare);
                    }
                    for window in windows.iter() {
                        part.clone_from(&outline.corners);
                        for normal in window {
                            contour::cut(part, *normal, normal.dot(image.position), spare);
                        }
                        add(part, spare);
                    }
                }
            }
        }
    }

    /// The parts of a cell above the horizon, one for each window that shows some.
    fn pieces_of(&self, index: u32, image: &Unfolded, windows: &Windows, mut visit: impl FnMut(Piece)) {
        let cell = &self.emitters.cells()[index as usize];
        if cell.plane == image.last {
            return;
        }
        let mut add = |polygon: Polygon, whole: bool| {
            let unit = cell.unit_irradiance(image.position, image.normal, &polygon);
            if unit > 0.0 {
                let weight = unit * f64::from(cell.radiance.element_sum());
                let (polygon, whole) = if cell.lobe.exponent() > 1.0 {
                    (cell.lit_part(image.position, polygon), false)
                } else {
                    (polygon, whole)
                };
                visit(Piece { polygon, cell: index, whole, unit, weight });
            }
        };
        let outline = cell.polygon();
        let mut horizon = outline.clipped(image.geometric, image.geometric.dot(image.position));
        // What lies between the receiver's image and the last mirror is not before that mirror.
        if let Some(Plane { normal, offset }) = image.beyond {
            horizon = horizon.clipped(normal, offset);
        }
        if horizon.is_empty() {
            return;
        }
        if windows.is_empty() {
            add(horizon, horizon.corners() == outline.corners());
        }
        for window in windows.iter() {
            let mut polygon = horizon;
            for normal in window {
                polygon = polygon.clipped(*normal, normal.dot(image.position));
                if polygon.is_empty() {
                    break;
                }
            }
            if !polygon.is_empty() {
                add(polygon, false);
            }
        }
    }

    /// Throughput from the receiver to a point of a source.
    #[inline]
    fn throughput(
        &self,
        receiver: &Receiver,
        chain: Option<&ImageChain>,
        light: DVec3,
        to: Goal,
        distance: f64,
        scratch: &mut Scratch,
        tally: &mut Tally,
    ) -> Rgb {
        scratch.rays += 1;
        let (position, plane) = (receiver.position, receiver.plane);
        if let Some(chain) = chain {
            self.chains.targets(chain, light, &mut scratch.targets);
        }
        let share = match (chain, to) {
            (None, Goal::Plane(to)) => self.tracer.visibility(position, plane, light.as_vec3(), to),
            (None, Goal::Triangles(lamp)) => {
                self.tracer.reaches(position, plane, light.as_vec3() - position, lamp)
            }
            (Some(chain), Goal::Plane(to)) => {
                walk::follow(self.tracer, position, plane, &chain.planes, &scratch.targets, to)
            }
            (Some(chain), Goal::Triangles(lamp)) => {
                match walk::over_mirrors(self.tracer, position, plane, &chain.planes, &scratch.targets) {
                    Some(left) => {
                        let direction = left.target - left.origin;
                        left.throughput * self.tracer.reaches(left.origin, left.from, direction, lamp)
                    }
                    None => Rgb::ZERO,
                }
            }
        };
        tally.count(share);
        share * self.tracer.media().transmittance(receiver.media.current(), distance as f32)
    }

    /// Whether all shadow rays to a polygon, over the mirrors of a chain, are certain to arrive.
    fn is_free(&self, receiver: &Receiver, chain: Option<&ImageChain>, base: &[DVec3], to: Goal) -> bool {
        let Some(base) = Base::around(base) else { return false };
        let (goal, lamp) = match to {
            Goal::Plane(plane) => (plane, 0..0),
            Goal::Triangles(lamp) => (PlaneId::NONE, lamp.clone()),
        };
        let position = receiver.position.as_dvec3();
        let mut near = End::new(position, receiver.geometric.as_dvec3(), receiver.plane);
        let mut eye = position;
        for (chain, level) in chain.iter().flat_map(|c| (0..c.planes.len()).map(move |level| (c, level))) {
            // Up to each mirror, towards the image of the light behind it.
            let Some((mirrors, id)) = chain.mirrors_from(level) else { return false };
            let image = mirrors.iter().rev().fold(base, |base, plane| base.reflected(plane));
            let far = End::mirror(&mirrors[0], id, eye);
            let pyramid = Pyramid::new(eye, &image, near, far, 0..0);
            if !pyramid.is_some_and(|p| self.tracer.is_empty_in(&p)) {
                return false;
            }
            eye = mirrors[0].reflect_point(eye);
            near = End::mirror(&mirrors[0], id, image.reflected(&mirrors[0]).corners()[0]);
        }
        let Some(far) = End::behind(&base, eye, goal) else { return false };
        Pyramid::new(eye, &base, near, far, lamp).is_some_and(|p| self.tracer.is_empty_in(&p))
    }

    /// Whether light that nothing blocks arrives as the contour formula says: no coat, and nothing that absorbs.
    fn is_plain(&self, receiver: &Receiver) -> bool {
        receiver.coat.is_none()
            && self.tracer.media().transmittance(receiver.media.current(), self.far) == Rgb::ONE
    }

    /// One lamp, or what is seen of it.
    fn lamp(
        &self,
        receiver: &Receiver,
        chain: Option<&ImageChain>,
        image: &Unfolded,
        part: &LampPart,
        corners: &[DVec3],
        count: u32,
        key: Key,
        scratch: &mut Scratch,
        tally: &mut Tally,
    ) -> Rgb {
        let lamp = &self.emitters.lamps()[part.lamp as usize];
        let corners = &corners[part.corners.clone()];
        let to = Goal::Triangles(&lamp.triangles);
        let free = count > 1 && self.is_free(receiver, chain, corners, to);
        if free && chain.is_none() && self.is_plain(receiver) {
            tally.count(Rgb::ONE);
            return lamp.radiance * part.unit as f32;
        }
        let count = if free { count.min(FREE_SAMPLES) } else { count };
        let mut weights = 0.0_f64;
        let mut sum = DVec3::ZERO;
        for index in 0..count {
            let s = key.point2(index).as_dvec2();
            let light = contour::point_in(corners, s.x, s.y);
            let offset = light - image.position;
            let r2 = offset.length_squared();
            let cos = image.normal.dot(offset);
            let weight = (cos * part.axis.dot(offset)).max(0.0) / (r2 * r2).max(1e-300);
            if weight <= 0.0 {
                continue;
            }
            weights += weight;
            let distance = r2.sqrt();
            let share = if free && chain.is_none() {
                self.tracer.media().transmittance(receiver.media.current(), distance as f32)
            } else {
                self.throughput(receiver, chain, light, to, distance, scratch, tally)
            };
            sum += (share * receiver.coat.transmittance((cos / distance) as f32)).as_dvec3() * weight;
        }
        if weights <= 0.0 {
            return Rgb::ZERO;
        }
        lamp.radiance * ((sum / weights) * part.unit).as_vec3()
    }

    /// One piece with strata of its own.
    fn piece(
        &self,
        receiver: &Receiver,
        chain: Option<&ImageChain>,
        image: &Unfolded,
        piece: &Piece,
        count: u32,
        key: Key,
        scratch: &mut Scratch,
        tally: &mut Tally,
    ) -> Rgb {
        let cell = &self.emitters.cells()[piece.cell as usize];
        let to = Goal::Plane(cell.plane);
        let free = self.is_free(receiver, chain, piece.polygon.corners(), to);
        if free && chain.is_none() && !cell.textured && self.is_plain(receiver) {
            tally.count(Rgb::ONE);
            return cell.radiance * piece.unit as f32;
        }
        let count = if free && !cell.textured { count.min(FREE_SAMPLES) } else { count };
        let mut weights = 0.0_f64;
        let mut sum = DVec3::ZERO;
        for index in 0..count {
            let s = key.point2(index).as_dvec2();
            let light = if piece.whole { cell.point(s.x, s.y) } else { piece.polygon.point(s.x, s.y) };
            let offset = light - image.position;
            let r2 = offset.length_squared();
            let cos = image.normal.dot(offset);
            let mut weight = (cos * -cell.normal.dot(offset)).max(0.0) / (r2 * r2).max(1e-300);
            if !cell.lobe.is_diffuse() {
                weight *= cell.lobe.factor(-cell.normal.dot(offset) / r2.sqrt());
            }
            if weight <= 0.0 {
                continue;
            }
            weights += weight;
            let distance = r2.sqrt();
            let mut share = if free && chain.is_none() {
                self.tracer.media().transmittance(receiver.media.current(), distance as f32)
            } else {
                self.throughput(receiver, chain, light, to, distance, scratch, tally)
            };
            if share == Rgb::ZERO {
                continue;
            }
            if cell.textured {
                share *= cell.radiance_at(self.tracer, light) / cell.radiance.max(Rgb::splat(1e-30));
            }
            share *= receiver.coat.transmittance((cos / distance) as f32);
            sum += share.as_dvec3() * weight;
        }
        if weights <= 0.0 {
            return Rgb::ZERO;
        }
        cell.radiance * ((sum / weights) * piece.unit).as_vec3()
    }

    /// All small pieces and groups together: systematic samples in proportion to their weights.
    fn shared(
        &self,
        receiver: &Receiver,
        chain: Option<&ImageChain>,
        image: &Unfolded,
        found: &Found,
        (total, share, samples): (f64, f64, u32),
        key: Key,
        scratch: &mut Scratch,
        tally: &mut Tally,
    ) -> SourceIrradiance {
        let mut result = SourceIrradiance::default();
        let count = ((total * share).ceil() as u32).clamp(4.min(samples.max(1)), samples.max(1));
        let step = total / f64::from(count);
        let key = key.child(0xffff);
        let mut next = f64::from(key.uniform(0)) * step;
        let mut position = 0.0;
        let mut drawn = 0;
        let few = found.is_few();
        let shares = |p: &Piece| p.weight * share < 1.5 && !few;
        let pieces = found.pieces.iter().filter(|p| shares(p)).map(|p| (Shared::Piece(p), p.weight));
        let small = found.small.iter().map(|s| (Shared::Small(s.0), s.1));
        let loose = found.loose.iter().map(|s| (Shared::Loose(s.0), s.1));
        for (which, weight) in pieces.chain(small).chain(loose) {
            let known = match which {
                Shared::Small(group) => self.emitters.tree().irradiance(group, image.position, image.normal),
                Shared::Piece(piece) => piece.irradiance(&self.emitters),
                Shared::Loose(_) => Rgb::ZERO,
            };
            result.unoccluded += known;
            while next < position + weight && drawn < count {
                let inner = ((next - position) / weight).clamp(0.0, 1.0 - 1e-12);
                let sampled = self.sample(which, known, image, &found.windows, inner, key, drawn + 1);
                next += step;
                drawn += 1;
                let Some((index, light, whole)) = sampled else { continue };
                let cell = &self.emitters.cells()[index as usize];
                // Each sample stands for an equal share of the weight.
                let mut each = whole * (step / weight) as f32;
                if let Shared::Loose(_) = which {
                    result.unoccluded += each;
                }
                let offset = light - image.position;
                let distance = offset.length();
                let cos = (image.normal.dot(offset) / distance) as f32;
                if cell.textured {
                    each *= cell.radiance_at(self.tracer, light) / cell.radiance.max(Rgb::splat(1e-30));
                }
                let seen = self.throughput(
                    receiver,
                    chain,
                    light,
                    Goal::Plane(cell.plane),
                    distance,
                    scratch,
                    tally,
                );
                result.irradiance += each * seen * receiver.coat.transmittance(cos);
            }
            position += weight;
        }
        result
    }

    /// A point of what is shared: its cell, the point, and the irradiance of the whole (`known`, or by this sample).
    fn sample(
        &self,
        which: Shared,
        known: Rgb,
        image: &Unfolded,
        windows: &Windows,
        inner: f64,
        key: Key,
        number: u32,
    ) -> Option<(u32, DVec3, Rgb)> {
        let other = f64::from(key.point1(number));
        let tree = self.emitters.tree();
        match which {
            Shared::Piece(piece) => {
                let light = self.place(piece, image, (inner, other), key.child(number));
                Some((piece.cell, light, known))
            }
            Shared::Small(group) => {
                let (index, rest) = tree.choose(group, inner);
                Some((index, self.emitters.cells()[index as usize].point(rest, other), known))
            }
            Shared::Loose(group) => {
                let (index, probability, rest) = tree.draw(group, &image.view(windows), inner)?;
                // Of the parts of the cell, seen through several windows, one in proportion.
                let mut chosen: Option<Piece> = None;
                let (mut total, mut count) = (0.0, 0);
                let key = key.child(number);
                let cell = &self.emitters.cells()[index as usize];
                if cell.faces(image.position) {
                    self.pieces_of(index, image, windows, |piece| {
                        total += piece.unit;
                        count += 1;
                        if f64::from(key.uniform(count)) * total < piece.unit {
                            chosen = Some(piece);
                        }
                    });
                }
                let light = self.place(&chosen?, image, (rest, other), key.child(0));
                Some((index, light, cell.radiance * (total / probability) as f32))
            }
        }
    }

    /// A point of a piece for what shares its samples. Small pieces that are diffuse send about the same from
    /// everywhere; of a lobe, however small the piece, one of some places is taken in proportion to what it sends, so
    /// that the piece's irradiance is exact where nothing blocks.
    fn place(&self, piece: &Piece, image: &Unfolded, (u, v): (f64, f64), key: Key) -> DVec3 {
        let cell = &self.emitters.cells()[piece.cell as usize];
        if cell.lobe.is_diffuse() {
            piece.polygon.point(u, v)
        } else {
            place_in_lobe(cell, piece, image, (u, v), key)
        }
    }

    /// Bright texels of the sky, by systematic samples in proportion to what they send.
    fn bright_part(
        &self,
        receiver: &Receiver,
        chain: Option<&ImageChain>,
        image: &Unfolded,
        samples: u32,
        key: Key,
        scratch: &mut Scratch,
        tally: &mut Tally,
    ) -> SourceIrradiance {
        let mut result = SourceIrradiance::default();
        let Some(Sky::Image(map)) = self.tracer.scene().sky() else { return result };
        let mut texels = std::mem::take(&mut scratch.texels);
        texels.clear();
        let mut total = 0.0_f64;
        for (index, texel) in self.bright.texels().iter().enumerate() {
            let direction = texel.direction.as_dvec3();
            let cos = image.normal.dot(direction);
            if cos > 0.0 && image.geometric.dot(direction) > 0.0 {
                let weight = texel.power.element_sum() * cos as f32;
                total += f64::from(weight);
                texels.push((index as u32, weight));
                result.unoccluded += texel.power * cos as f32;
            }
        }
        let count = samples.max(1);
        let step = total / f64::from(count);
        let key = key.child(0xfffe);
        let mut next = f64::from(key.uniform(0)) * step;
        let mut position = 0.0;
        let mut drawn = 0;
        for &(index, weight) in &texels {
            let weight = f64::from(weight);
            let texel = &self.bright.texels()[index as usize];
            while next < position + weight && drawn < count {
                let jitter = key.point2(drawn + 1);
                let direction = self.bright.direction_in(map, texel, jitter.x, jitter.y);
                let cos = image.normal.dot(direction.as_dvec3()).max(0.0);
                let light = image.position + direction.as_dvec3() * f64::from(self.far);
                let seen =
                    self.throughput(receiver, chain, light, Goal::Plane(PlaneId::NONE), 0.0, scratch, tally);
                let center_cos = image.normal.dot(texel.direction.as_dvec3());
                let each = texel.power * (center_cos * step / weight) as f32;
                let tilt = (cos / center_cos) as f32;
                result.irradiance += each * tilt * seen * receiver.coat.transmittance(cos as f32);
                next += step;
                drawn += 1;
            }
            position += weight;
        }
        scratch.texels = texels;
        result
    }
}

#[cold]
fn place_in_lobe(cell: &Cell, piece: &Piece, image: &Unfolded, (u, v): (f64, f64), key: Key) -> DVec3 {
    let (mut chosen, mut total) = (piece.polygon.point(u, v), 0.0);
    for index in 0..PLACES {
        // A rank-1 lattice about (u, v).
        let (s, t) = (u + f64::from(index) / f64::from(PLACES), v + f64::from(index) * 0.375);
        let light = piece.polygon.point(s.fract(), t.fract());
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

/// Whether some samples were seen and some not.
#[derive(Clone, Copy, Debug, Default)]
struct Tally {
    seen: bool,
    missed: bool,
}

impl Tally {
    #[inline]
    fn count(&mut self, share: Rgb) {
        if share == Rgb::ZERO {
            self.missed = true;
        } else {
            self.seen = true;
        }
    }
}
