//! Sources between the rays of neighbouring pixels, thrown by what is curved or refracts.
//!
//! Where lamps are seen straight or over planar mirrors their outlines are known ([`crate::outlines`]). In a chrome ball or through glass they
//! are not, and the image of a lamp there may be as small as it likes. The last legs of the paths through the centres of four neighbouring pixels
//! span a bundle (beam tracing to first order: HeckbertHanrahan1984 in docs/references.md). Where a part of a source lies in it, or of its image in a planar
//! mirror, that not all of the four met, they are sampled, and what they find leads on along it. A highlight may be a hundredth of a pixel, and a few hundred
//! times as bright as what is beside it: Newton's method finds where it is, and half of the samples go there.

use glam::{DMat2, DVec2, DVec3, Vec3};
use rayon::prelude::*;

use catoptric_light::chains::{ImageChain, ImageChains};
use catoptric_light::emitter::Cell;
use catoptric_light::lamp::{Lamp, Outline, Sight};
use catoptric_light::{Lights, contour};
use catoptric_scene::Progress;
use catoptric_scene::quantity::LUMINANCE;
use catoptric_trace::PlaneId;
use catoptric_trace::plane::Plane;
use catoptric_trace::walk::split::Way;

use crate::outlines::signed_area;

/// Pairs of a bundle and a source that are looked at, and as many of a bundle and an image, at most, for each band of pixels: some ten
/// milliseconds. The brightest come first.
const MOST_PAIRS: usize = 1 << 20;
/// Images of sources, at most.
const MOST_IMAGES: usize = 1 << 12;
/// Cosine of the angle from their mean up to which four directions are those of one bundle.
const BUNDLED: f32 = 0.9;
/// Sources are looked at more closely if they are nearer to the axis than this multiple of what four straight legs span there.
const SLACK: f32 = 1.5;
/// Sides of the squares of Newton's steps, pixels.
const SIDES: [f64; 3] = [1.0, 0.25, 0.06];
/// Pixels, by area, from which on samples find an image by themselves, …
const SMALL: f64 = 0.25;
/// … and from which on it will not prove to be so small.
const LARGE: f64 = 1.0;
/// Share of the way to a source, or to the mirror that shows it, before which all four legs end if something else is in the way. What is nearer to it
/// may be the rim of a lamp that looks out of a hole.
const HIDDEN: f64 = 0.7;
/// Pixels by which a source is taken to be wider than first order has it, at least.
const MARGIN: f64 = 0.02;
/// … and, for the square of its extent from the middle, as what is curved bends it.
const BEND: f64 = 0.1;
/// Sine of the angle between a quadrilateral's sides up to which nobody knows where something in it is.
const FOLDED: f64 = 1e-3;
/// Share of what a source sends from which on a centre has met it.
const MET: f32 = 0.5;

/// The last leg of a path from the eye, to what it met from what threw it there.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Leg {
    pub(crate) origin: Vec3,
    /// Unit vector.
    pub(crate) direction: Vec3,
    /// Metres to what it met; infinite to the sky.
    pub(crate) length: f32,
    /// What a radiance of one at its end brings to the eye, luminance; 0 if there is no leg.
    pub(crate) strength: f32,
    /// What is emitted at its end brings.
    pub(crate) emission: f32,
    pub(crate) way: Way,
}

impl Leg {
    /// Where it runs: origin and direction.
    fn line(&self) -> (DVec3, DVec3) {
        (self.origin.as_dvec3(), self.direction.as_dvec3())
    }
}

/// Legs of a pixel that are kept: of a glass ball two within, what is seen through it, what it shows and what its back shows, and as many over a
/// mirror.
const KEPT: usize = 8;

/// The strongest legs of the paths through a pixel's centre, by different ways.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Legs([Leg; KEPT]);

impl Legs {
    /// Notes a leg.
    pub(crate) fn note(&mut self, leg: Leg) {
        // The weakest is the last.
        let place = self.0.partition_point(|known| known.strength >= leg.strength);
        if place < KEPT {
            self.0[place..].rotate_right(1);
            self.0[place] = leg;
        }
    }

    /// Whether there are any.
    pub(crate) fn any(&self) -> bool {
        self.0[0].strength > 0.0
    }

    /// The leg of a way.
    fn by(&self, way: Way) -> Option<&Leg> {
        self.0.iter().find(|leg| leg.strength > 0.0 && leg.way == way)
    }
}

/// Where a source passes between the centres of four pixels that did not all meet it.
#[derive(Clone, Debug)]
pub(crate) struct Missed {
    /// By index.
    pub(crate) pixels: [usize; 4],
    /// What the source sends there, about.
    pub(crate) luminance: f32,
    /// Index of the source, images after all that are seen straight.
    source: usize,
    /// How it got there.
    way: Way,
}

/// What is looked for.
struct Source<'a> {
    /// Of a ball around it, or its image.
    center: Vec3,
    radius: f32,
    /// What of it arrives over the mirrors, at most.
    luminance: f32,
    shape: Shape<'a>,
    /// Over planar mirrors.
    over: Option<Mirrors<'a>>,
}

#[derive(Clone, Copy)]
struct Mirrors<'a> {
    chain: &'a ImageChain,
    /// Plane of the first one.
    plane: Plane,
    /// A ball around it.
    center: Vec3,
    radius: f32,
}

#[derive(Clone, Copy)]
enum Shape<'a> {
    Lamp(&'a Lamp),
    Cell(&'a Cell),
}

/// The sources of a scene and their images in planar mirrors (which curved ones show, too).
pub(crate) struct Sources<'a> {
    chains: &'a ImageChains,
    /// The brightest first.
    straight: Vec<Source<'a>>,
    /// … and likewise.
    images: Vec<Source<'a>>,
}

impl<'a> Sources<'a> {
    pub(crate) fn new(lights: &'a Lights) -> Self {
        let chains = lights.chains();
        let mut sources = Self { chains, straight: Vec::new(), images: Vec::new() };
        if !lights.tracer().has_specular() {
            return sources;
        }
        let emitters = lights.emitters();
        let alone = emitters.lamps().iter().map(|lamp| lamp.cells.start as usize).min();
        let cells = &emitters.cells()[..alone.unwrap_or(emitters.cells().len())];
        let lamp = |lamp: &'a Lamp| {
            let (center, radius) = lamp.ball();
            (center, radius, lamp.radiance.dot(LUMINANCE), Shape::Lamp(lamp))
        };
        let cell = |cell: &'a Cell| {
            let polygon = cell.polygon();
            let corners = polygon.corners();
            let center = corners.iter().sum::<DVec3>() / corners.len() as f64;
            let radius = corners.iter().map(|c| c.distance(center)).fold(0.0, f64::max);
            (center, radius, cell.radiance.dot(LUMINANCE), Shape::Cell(cell))
        };
        let found: Vec<_> = emitters.lamps().iter().map(lamp).chain(cells.iter().map(cell)).collect();
        for &(center, radius, luminance, shape) in &found {
            let (center, radius) = (center.as_vec3(), radius as f32);
            sources.straight.push(Source { center, radius, luminance, shape, over: None });
        }
        let mut targets = Vec::new();
        for chain in chains.chains().iter().take(MOST_IMAGES / found.len().max(1)) {
            let Some((plane, center, radius)) = chains.first_mirror(chain) else { continue };
            let over = Some(Mirrors { chain, plane, center: center.as_vec3(), radius: radius as f32 });
            for &(center, radius, luminance, shape) in &found {
                chains.targets(chain, center, &mut targets);
                let (radius, luminance) = (radius as f32, luminance * chain.strength());
                sources.images.push(Source { center: targets[0], radius, luminance, shape, over });
            }
        }
        for list in [&mut sources.straight, &mut sources.images] {
            list.sort_by(|a, b| b.luminance.total_cmp(&a.luminance));
        }
        sources
    }

    /// Whether there are any, and what may throw rays to them.
    pub(crate) fn are_thrown(&self) -> bool {
        !self.straight.is_empty()
    }

    fn by_index(&self, index: usize) -> &Source<'a> {
        self.straight.get(index).unwrap_or_else(|| &self.images[index - self.straight.len()])
    }

    /// Where a source passes between centres that did not all meet it, and what it sends there: of the pixels from index `first` on in a picture
    /// `width` pixels wide, whose legs are those of `legs`.
    pub(crate) fn between(
        &self,
        legs: &[Option<Box<Legs>>],
        first: usize,
        width: usize,
        progress: &dyn Progress,
    ) -> Vec<Missed> {
        let known = |leg: &Leg| leg.strength > 0.0;
        let bundles = legs.iter().flatten().flat_map(|legs| &legs.0).filter(|leg| known(leg)).count();
        if bundles == 0 {
            return Vec::new();
        }
        let most = (MOST_PAIRS / bundles).max(1);
        let lists = [(&self.straight, 0), (&self.images, self.straight.len())]
            .map(|(list, before)| (&list[..most.min(list.len())], before));
        let below = legs.len().saturating_sub(width + 1);
        (0..below)
            .into_par_iter()
            .with_min_len(1024)
            .flat_map_iter(|index| {
                // The last of a row has no neighbours on its right.
                let is_last = (first + index) % width + 1 == width;
                let four = [0, 1, width + 1, width].map(|step| legs[index + step].as_deref());
                let four = if is_last || progress.is_cancelled() { [None; 4] } else { four };
                let pixels = [0, 1, width + 1, width].map(|step| first + index + step);
                four[0].into_iter().flat_map(|legs| &legs.0).filter(|leg| known(leg)).filter_map(move |leg| {
                    let [_, right, across, below] = four.map(|legs| legs?.by(leg.way));
                    let bundle = Bundle::new([*leg, *right?, *across?, *below?])?;
                    let least = bundle.legs.iter().map(|leg| leg.emission).fold(f32::INFINITY, f32::min);
                    let among = |(list, before): (&[Source], usize)| {
                        list.iter()
                            .map(|source| source.luminance * bundle.strength)
                            .enumerate()
                            .take_while(|(_, sent)| least < MET * sent)
                            .find(|(index, _)| bundle.holds(&list[*index], self.chains))
                            .map(|(index, sent)| (before + index, sent))
                    };
                    let (source, luminance) = match lists.map(among) {
                        [Some(a), Some(b)] if b.1 > a.1 => b,
                        [a, b] => a.or(b)?,
                    };
                    Some(Missed { pixels, luminance, source, way: leg.way })
                })
            })
            .collect()
    }

    /// The outline of a source that was missed as far as it lies in the four pixels, in pixels of the picture, a little wider than it is; `None`
    /// where it cannot be told, or is not so small that samples would miss it. Found by Newton's method: `shoot` gives the legs through a place.
    pub(crate) fn outline(
        &self,
        missed: &Missed,
        width: usize,
        mut shoot: impl FnMut(DVec2) -> Legs,
    ) -> Option<Vec<DVec2>> {
        let source = self.by_index(missed.source);
        let first = DVec2::new((missed.pixels[0] % width) as f64, (missed.pixels[0] / width) as f64);
        let mut middle = first + 1.0;
        let (mut outline, mut area) = (Vec::new(), 0.0);
        for side in SIDES {
            let corner = middle - 0.5 * side;
            let mut lines = [(DVec3::ZERO, DVec3::ZERO); 4];
            for (line, step) in lines.iter_mut().zip(CORNERS) {
                *line = shoot(corner + step * side).by(missed.way)?.line();
            }
            let crossing = Lines(lines).cross(source, self.chains)?;
            let seen: Vec<DVec2> = crossing.in_square()?.into_iter().map(|p| corner + p * side).collect();
            let near = within(&widened(&seen, MARGIN), first, 2.0);
            (middle, area) = (mean(&near)?, signed_area(&near).abs());
            if area > LARGE {
                return None;
            }
            let extent = near.iter().map(|p| p.distance(middle)).fold(0.0, f64::max);
            let margin = MARGIN + side * crossing.bent()? + BEND * extent * extent;
            outline = within(&widened(&seen, margin), first, 2.0);
        }
        (area < SMALL).then_some(outline)
    }
}

/// Four legs, in turn.
struct Bundle {
    legs: [Leg; 4],
    origin: Vec3,
    direction: Vec3,
    /// Farthest origin from the mean, metres.
    shift: f32,
    /// Farthest direction from the mean.
    spread: f32,
    strength: f32,
}

impl Bundle {
    fn new(legs: [Leg; 4]) -> Option<Self> {
        let origin = legs.iter().map(|leg| leg.origin).sum::<Vec3>() / 4.0;
        let direction = legs.iter().map(|leg| leg.direction).sum::<Vec3>().try_normalize()?;
        let shift = legs.iter().map(|leg| leg.origin.distance(origin)).fold(0.0, f32::max);
        let spread = legs.iter().map(|leg| leg.direction.distance(direction)).fold(0.0, f32::max);
        let strength = legs.iter().map(|leg| leg.strength).fold(f32::INFINITY, f32::min);
        let is_one = legs.iter().all(|leg| leg.direction.dot(direction) > BUNDLED);
        is_one.then_some(Self { legs, origin, direction, shift, spread, strength })
    }

    /// Whether a part of a source, or of its image, lies between the legs, as far as nothing else is in the way.
    fn holds(&self, source: &Source, chains: &ImageChains) -> bool {
        let to = source.center - self.origin;
        let along = to.dot(self.direction);
        if along + source.radius <= 0.0 {
            return false;
        }
        let reach = self.shift + self.spread * (along.max(0.0) + source.radius);
        if (to - self.direction * along).length() > source.radius + SLACK * reach {
            return false;
        }
        if let Some(Mirrors { plane, center, radius, .. }) = source.over {
            // Where the axis to the image meets the mirror.
            let normal = plane.normal.as_vec3();
            let share = (plane.offset as f32 - normal.dot(self.origin)) / normal.dot(to);
            let is_between = (0.0..=1.0).contains(&share);
            let far = share * (self.spread * to.length() + source.radius);
            if !is_between || (self.origin + to * share).distance(center) > radius + self.shift + far {
                return false;
            }
        }
        let lines = Lines(self.legs.map(|leg| leg.line()));
        let is_hidden = |distances: [f64; 4]| {
            let mut legs = self.legs.iter().zip(distances);
            legs.all(|(leg, distance)| f64::from(leg.length) < HIDDEN * distance)
        };
        let to_mirror = |mirrors: Mirrors| lines.distances(mirrors.plane.normal, mirrors.plane.offset);
        if source.over.is_some_and(|mirrors| is_hidden(to_mirror(mirrors))) {
            return false;
        }
        let Some(crossing) = lines.cross(source, chains) else { return false };
        !(source.over.is_none() && is_hidden(crossing.distances)) && crossing.overlaps()
    }
}

/// Where four legs run, in turn: origins and directions.
struct Lines([(DVec3, DVec3); 4]);

/// The corners of the unit square, in turn.
const CORNERS: [DVec2; 4] = [DVec2::ZERO, DVec2::X, DVec2::ONE, DVec2::Y];

impl Lines {
    /// Where they cross the plane of a source that is turned to them, or over the mirrors of its image.
    fn cross(mut self, source: &Source, chains: &ImageChains) -> Option<Crossing> {
        if let Some(mirrors) = source.over {
            for (origin, direction) in &mut self.0 {
                let image = chains.unfold(mirrors.chain, *origin, *direction, *direction)?;
                (*origin, *direction) = (image.position, image.normal);
            }
        }
        let origin = self.0.iter().map(|line| line.0).sum::<DVec3>() / 4.0;
        match source.shape {
            Shape::Cell(cell) => {
                let polygon = cell.polygon();
                let is_turned = cell.normal.dot(origin - polygon.corners()[0]) > 0.0;
                is_turned.then(|| self.cross_plane(polygon.corners(), cell.normal))?
            }
            Shape::Lamp(lamp) => {
                let mut outline = Outline::default();
                let seen = lamp.outline(origin, lamp.ball().0 - origin, PlaneId::NONE, &mut outline);
                (seen == Sight::Outline).then(|| self.cross_plane(&outline.corners, outline.axis))?
            }
        }
    }

    /// Where they cross the plane of a convex polygon with the unit normal `normal`. Not if one of them does not.
    fn cross_plane(&self, polygon: &[DVec3], normal: DVec3) -> Option<Crossing> {
        let [u, v] = [normal.any_orthonormal_vector(), normal.cross(normal.any_orthonormal_vector())];
        let flat = |p: DVec3| DVec2::new(u.dot(p - polygon[0]), v.dot(p - polygon[0]));
        let distances = self.distances(normal, normal.dot(polygon[0]));
        if !distances.iter().all(|&distance| distance > 0.0 && distance.is_finite()) {
            return None;
        }
        let mut quad = [DVec2::ZERO; 4];
        for ((corner, (origin, direction)), distance) in quad.iter_mut().zip(self.0).zip(distances) {
            *corner = flat(origin + direction * distance);
        }
        Some(Crossing { quad, distances, polygon: polygon.iter().map(|&p| flat(p)).collect() })
    }

    /// How far it is along each of them to the plane n·x = offset, metres.
    fn distances(&self, normal: DVec3, offset: f64) -> [f64; 4] {
        self.0.map(|(origin, direction)| (offset - normal.dot(origin)) / normal.dot(direction))
    }
}

/// Where four legs cross the plane of a source, and its convex outline there.
struct Crossing {
    quad: [DVec2; 4],
    /// How far along the legs, metres.
    distances: [f64; 4],
    polygon: Vec<DVec2>,
}

impl Crossing {
    fn overlaps(&self) -> bool {
        !is_apart(&self.polygon, &self.quad) && !is_apart(&self.quad, &self.polygon)
    }

    /// How the corners of the quadrilateral move with those of the unit square. `None` where it is folded flat.
    fn square(&self) -> Option<DMat2> {
        let [a, b, c, d] = self.quad;
        let square = DMat2::from_cols(0.5 * (b - a + c - d), 0.5 * (d - a + c - b));
        let flat = FOLDED * square.x_axis.length() * square.y_axis.length();
        (square.determinant().abs() > flat).then_some(square)
    }

    /// By how much its corners lie beside those of a parallelogram, in sides of the unit square.
    fn bent(&self) -> Option<f64> {
        let [a, b, c, d] = self.quad;
        Some((self.square()?.inverse() * (a - b + c - d)).length())
    }

    /// The outline where the quadrilateral is the unit square, to first order.
    fn in_square(&self) -> Option<Vec<DVec2>> {
        let (inverse, middle) = (self.square()?.inverse(), self.quad.iter().sum::<DVec2>() / 4.0);
        Some(self.polygon.iter().map(|&p| 0.5 + inverse * (p - middle)).collect())
    }
}

/// Moves the edges of a convex polygon outwards. Sharp corners are cut off as far from where they were.
fn widened(polygon: &[DVec2], margin: f64) -> Vec<DVec2> {
    let count = polygon.len();
    let turn = signed_area(polygon).signum();
    let out = |a: DVec2, b: DVec2| (a - b).perp().normalize_or_zero() * turn;
    let corner = |k: usize| {
        let [before, own, after] = [k + count - 1, k, k + 1].map(|k| polygon[k % count]);
        let [a, b] = [out(before, own), out(own, after)];
        if 1.0 + a.dot(b) > 0.5 {
            let moved = own + (a + b) * (margin / (1.0 + a.dot(b)));
            return [moved; 2];
        }
        let ahead =
            ((own - before).normalize_or_zero() + (own - after).normalize_or_zero()).normalize_or_zero();
        [a, b].map(|out| own + (out + ahead) * margin)
    };
    let mut wider: Vec<DVec2> = (0..count).flat_map(corner).collect();
    wider.dedup();
    wider
}

/// The part of a convex polygon in a square.
fn within(polygon: &[DVec2], corner: DVec2, side: f64) -> Vec<DVec2> {
    let mut polygon = polygon.to_vec();
    for (axis, end) in [(0, corner.x), (1, corner.y)] {
        for (sign, end) in [(1.0, end), (-1.0, end + side)] {
            let mut rest = Vec::new();
            contour::clip(&polygon, |p| sign * (p[axis] - end), DVec2::lerp, |p| rest.push(p));
            polygon = rest;
        }
    }
    polygon
}

/// The mean of the corners of a polygon, if there are any.
fn mean(polygon: &[DVec2]) -> Option<DVec2> {
    (!polygon.is_empty()).then(|| polygon.iter().sum::<DVec2>() / polygon.len() as f64)
}

/// Whether an edge of a convex polygon parts it from other points.
fn is_apart(polygon: &[DVec2], others: &[DVec2]) -> bool {
    let next = polygon.iter().cycle().skip(1);
    polygon.iter().zip(next).any(|(&a, &b)| {
        let range = |points: &[DVec2]| {
            let heights = points.iter().map(|&p| (b - a).perp_dot(p - a));
            heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), h| (low.min(h), high.max(h)))
        };
        let ((low, high), (least, greatest)) = (range(polygon), range(others));
        greatest < low || least > high
    })
}

#[cfg(test)]
mod tests {
    use catoptric_trace::Event;

    use crate::outlines::edges;

    use super::*;

    /// Four legs one metre up, a tenth of a metre apart, that spread upwards.
    fn legs(spread: f64) -> Lines {
        let line = |(x, z): (f64, f64)| {
            let direction = DVec3::new(spread * (x - 0.5), 1.0, spread * (z - 0.5));
            (DVec3::new(0.1 * x, 1.0, 0.1 * z), direction.normalize_or_zero())
        };
        Lines([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)].map(line))
    }

    fn strip(x: f64, width: f64) -> Vec<DVec3> {
        [(x, -3.0), (x + width, -3.0), (x + width, 3.0), (x, 3.0)]
            .map(|(x, z)| DVec3::new(x, 2.0, z))
            .to_vec()
    }

    fn overlap(spread: f64, polygon: &[DVec3], normal: DVec3) -> bool {
        legs(spread).cross_plane(polygon, normal).is_some_and(|crossing| crossing.overlaps())
    }

    #[test]
    fn a_strip_is_found_between_legs_however_thin() {
        // One metre on, legs of no spread are 0.1 m apart, others 0.3 m.
        for (spread, reach) in [(0.0, [0.0, 0.1]), (0.2, [-0.1, 0.2])] {
            for width in [0.0, 1e-6, 1e-3] {
                for step in 0..40 {
                    let x = -0.3 + 0.0171 * f64::from(step);
                    let is_inside = x + width > reach[0] && x < reach[1];
                    let is_near = (x - reach[0]).abs().min((x - reach[1]).abs()) < 1e-6;
                    assert!(
                        is_near || overlap(spread, &strip(x, width), DVec3::NEG_Y) == is_inside,
                        "{x} {width}"
                    );
                }
            }
        }
        // Behind the legs, nothing is.
        let below: Vec<DVec3> = strip(0.05, 0.01).iter().map(|p| *p - DVec3::Y * 1.5).collect();
        assert!(!overlap(0.0, &below, DVec3::Y));
    }

    #[test]
    fn the_strongest_legs_are_kept_and_found_by_their_ways() {
        let strengths = [0.04, 0.9, 0.02, 0.03, 0.01, 0.05, 0.5, 0.6, 0.7, 0.8];
        // One event more each.
        let next = |way: &Way| Some(way.through(Event::Curved, false));
        let ways: Vec<Way> = std::iter::successors(Some(Way::default()), next).skip(1).take(10).collect();
        let mut legs = Legs::default();
        assert!(ways.iter().all(|way| legs.by(*way).is_none()));
        assert!(!legs.any());
        for (&way, strength) in ways.iter().zip(strengths) {
            legs.note(Leg { strength, way, ..Leg::default() });
        }
        assert!(legs.any());
        for (&way, strength) in ways.iter().zip(strengths) {
            let kept = (strength > 0.02).then_some(strength);
            assert_eq!(legs.by(way).map(|leg| leg.strength), kept);
        }
        assert_ne!(Way::default().through(Event::Curved, false), Way::default().through(Event::Curved, true));
    }

    #[test]
    fn a_source_is_placed_where_it_is_between_the_legs() {
        // One metre on, from −0.1 to 0.2 m.
        let square = strip(0.02, 0.03).into_iter().map(|p| DVec3::new(p.x, p.y, p.z.clamp(0.1, 0.12)));
        let square: Vec<DVec3> = square.collect();
        let crossing = legs(0.2).cross_plane(&square, DVec3::NEG_Y).expect("they cross it");
        let seen = crossing.in_square().expect("they are not folded");
        let placed = |x: f64, z: f64| DVec2::new((x + 0.1) / 0.3, (z + 0.1) / 0.3);
        let expected = [placed(0.02, 0.1), placed(0.05, 0.1), placed(0.05, 0.12), placed(0.02, 0.12)];
        assert!(seen.iter().zip(expected).all(|(seen, expected)| seen.distance(expected) < 1e-12));
        assert!(crossing.bent().is_some_and(|bent| bent < 1e-12));
        // Legs in one plane leave open where it is.
        let flat = legs(0.2).0.map(|(origin, direction)| (origin.with_z(0.0), direction.with_z(0.0)));
        let crossing = Lines(flat).cross_plane(&square, DVec3::NEG_Y).expect("they cross it");
        assert!(crossing.in_square().is_none());
    }

    #[test]
    fn slivers_are_wider_at_their_tips_too() {
        let at = DVec2::new;
        let sliver = [at(0.0, 0.0), at(0.5, 0.01), at(1.0, 0.0), at(0.5, -0.01)];
        let wider = widened(&sliver, 0.1);
        assert!(signed_area(&wider) * signed_area(&sliver) > 0.0);
        let distance = |p: DVec2| {
            let turn = signed_area(&wider).signum();
            let height = |(a, b): (DVec2, DVec2)| turn * (b - a).normalize_or_zero().perp_dot(p - a);
            edges(&wider).map(height).fold(f64::INFINITY, f64::min)
        };
        // Half of it at least where corners are cut off.
        assert!(sliver.iter().all(|&p| distance(p) > 0.05), "{wider:?}");
    }

    #[test]
    fn polygons_are_cut_to_squares() {
        let at = DVec2::new;
        let diamond = [at(0.0, -1.0), at(1.0, 0.0), at(0.0, 1.0), at(-1.0, 0.0)];
        let part = within(&diamond, DVec2::ZERO, 2.0);
        let corners = [at(0.0, 0.0), at(1.0, 0.0), at(0.0, 1.0)];
        assert!(part.iter().all(|p| corners.iter().any(|c| p.distance(*c) < 1e-12)));
        assert!(corners.iter().all(|c| part.iter().any(|p| p.distance(*c) < 1e-12)));
        assert!(within(&diamond, at(1.5, 1.5), 2.0).is_empty());
        // Its edges are √½ from the middle.
        let wider = diamond.map(|p| p * (1.0 + 0.1 / 0.5_f64.sqrt()));
        let turned = |polygon: &[DVec2]| polygon.iter().rev().copied().collect::<Vec<_>>();
        for (polygon, wider) in [(diamond.to_vec(), wider.to_vec()), (turned(&diamond), turned(&wider))] {
            let found = widened(&polygon, 0.1);
            assert!(found.iter().zip(wider).all(|(found, p)| found.distance(p) < 1e-12));
        }
    }
}
