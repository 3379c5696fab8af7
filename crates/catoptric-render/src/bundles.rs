//! Sources between the rays of neighbouring pixels, thrown by what is curved or refracts.
//!
//! Where lamps are seen straight or over planar mirrors their outlines are known ([`crate::outlines`]). In a chrome ball or through glass they
//! are not, and the image of a lamp there may be as small as it likes. The last legs of the paths through the centres of four neighbouring pixels
//! span a bundle (beam tracing to first order: HeckbertHanrahan1984 in docs/references.md). Where a part of a source lies in it that none of the
//! four met, they are sampled, and what they find leads on along it.

use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;

use catoptric_light::Lights;
use catoptric_light::emitter::Cell;
use catoptric_light::lamp::{Lamp, Outline, Sight};
use catoptric_scene::quantity::LUMINANCE;
use catoptric_trace::PlaneId;

use crate::layers::Kept;
use crate::outlines::Thin;
use crate::pixel::Sample;

/// Pairs of a bundle and a source that are looked at, at most: some ten milliseconds. The brightest sources come first.
const MOST_PAIRS: usize = 1 << 20;
/// Cosine of the angle from their mean up to which four directions are those of one bundle.
const BUNDLED: f32 = 0.9;
/// Sources are looked at more closely if they are nearer to the axis than this multiple of what four straight legs span there.
const SLACK: f32 = 1.5;
/// Share of what a source sends from which on a centre has met it.
const MET: f32 = 0.5;

/// The last leg of a path from the eye, to what it met from what threw it there.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Leg {
    origin: Vec3,
    /// Unit vector.
    direction: Vec3,
    /// Throughput of the path, luminance; 0 if there is none.
    strength: f32,
    events: u32,
}

/// The strongest leg of the paths through a pixel's centre after one event (what a ball shows), and after more (what is seen through it).
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Legs([Leg; 2]);

impl Legs {
    /// Notes what a path of so many events brings to the eye.
    pub(crate) fn note(&mut self, origin: Vec3, direction: Vec3, strength: f32, events: u32) {
        if events == 0 {
            return;
        }
        let known = &mut self.0[usize::from(events > 1)];
        if strength > known.strength {
            *known = Leg { origin, direction, strength, events };
        }
    }
}

/// What is looked for.
struct Source<'a> {
    center: Vec3,
    radius: f32,
    luminance: f32,
    shape: Shape<'a>,
}

enum Shape<'a> {
    Lamp(&'a Lamp),
    Cell(&'a Cell),
}

/// The sources of a scene, the brightest first.
pub(crate) struct Sources<'a>(Vec<Source<'a>>);

impl<'a> Sources<'a> {
    pub(crate) fn new(lights: &'a Lights) -> Self {
        if !lights.tracer().has_specular() {
            return Self(Vec::new());
        }
        let emitters = lights.emitters();
        let alone = emitters.lamps().iter().map(|lamp| lamp.cells.start as usize).min();
        let cells = &emitters.cells()[..alone.unwrap_or(emitters.cells().len())];
        let lamp = |lamp: &'a Lamp| {
            let (center, radius) = lamp.ball();
            let luminance = lamp.radiance.dot(LUMINANCE);
            Source { center: center.as_vec3(), radius: radius as f32, luminance, shape: Shape::Lamp(lamp) }
        };
        let cell = |cell: &'a Cell| {
            let polygon = cell.polygon();
            let corners = polygon.corners();
            let center = corners.iter().sum::<DVec3>() / corners.len() as f64;
            let radius = corners.iter().map(|c| c.distance(center)).fold(0.0, f64::max);
            let luminance = cell.radiance.dot(LUMINANCE);
            Source { center: center.as_vec3(), radius: radius as f32, luminance, shape: Shape::Cell(cell) }
        };
        let mut sources: Vec<Source> =
            emitters.lamps().iter().map(lamp).chain(cells.iter().map(cell)).collect();
        sources.sort_by(|a, b| b.luminance.total_cmp(&a.luminance));
        Self(sources)
    }

    /// Whether there are any, and what may throw rays to them.
    pub(crate) fn are_thrown(&self) -> bool {
        !self.0.is_empty()
    }

    /// Pixels beside which a source passes that no centre met, and what it sends there: of those from index `first` on in a picture
    /// `width` pixels wide, whose legs are those of `legs`.
    pub(crate) fn between<L: Kept>(
        &self,
        pixels: &[Sample<L>],
        legs: &[Legs],
        first: usize,
        width: usize,
    ) -> Vec<Thin> {
        let known = |leg: &Leg| leg.strength > 0.0;
        let bundles = legs.iter().flat_map(|legs| &legs.0).filter(|leg| known(leg)).count();
        let most = (MOST_PAIRS / bundles.max(1)).max(1).min(self.0.len());
        let sources = &self.0[..most];
        if bundles == 0 || sources.is_empty() {
            return Vec::new();
        }
        let below = legs.len().saturating_sub(width + 1);
        (0..below)
            .into_par_iter()
            .with_min_len(1024)
            .flat_map_iter(|index| {
                let corners = [0, 1, width + 1, width].map(|step| index + step);
                let is_last = (first + index) % width + 1 == width;
                let found = |slot: usize| {
                    let quad = corners.map(|corner| legs[corner].0[slot]);
                    if is_last
                        || !quad.iter().all(known)
                        || quad.iter().any(|leg| leg.events != quad[0].events)
                    {
                        return None;
                    }
                    let bundle = Bundle::new(quad)?;
                    let met = |corner: &usize| pixels[first + corner].light.emission();
                    let brightest = corners.iter().map(met).fold(0.0, f32::max);
                    sources
                        .iter()
                        .map(|source| (source, source.luminance * bundle.strength))
                        .take_while(|(_, sent)| brightest < MET * sent)
                        .find(|(source, _)| bundle.holds(source))
                        .map(|(_, sent)| sent)
                };
                let luminance = found(0).or_else(|| found(1));
                luminance.into_iter().flat_map(move |luminance| {
                    corners.map(|corner| Thin { pixel: first + corner, luminance })
                })
            })
            .collect()
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

    /// Whether a part of a source lies between the legs, as far as nothing else is in the way.
    fn holds(&self, source: &Source) -> bool {
        let to = source.center - self.origin;
        let along = to.dot(self.direction);
        if along + source.radius <= 0.0 {
            return false;
        }
        let reach = self.shift + self.spread * (along.max(0.0) + source.radius);
        if (to - self.direction * along).length() > source.radius + SLACK * reach {
            return false;
        }
        match source.shape {
            Shape::Cell(cell) => {
                let polygon = cell.polygon();
                cell.normal.dot(self.origin.as_dvec3() - polygon.corners()[0]) > 0.0
                    && self.crosses(polygon.corners(), cell.normal)
            }
            Shape::Lamp(lamp) => {
                let mut outline = Outline::default();
                let seen = lamp.outline(self.origin.as_dvec3(), to.as_dvec3(), PlaneId::NONE, &mut outline);
                seen == Sight::Outline && self.crosses(&outline.corners, outline.axis)
            }
        }
    }

    /// Whether a convex polygon in a plane with the unit normal `normal` meets the quadrilateral of where the legs cross that plane. Not where
    /// one of them does not.
    fn crosses(&self, polygon: &[DVec3], normal: DVec3) -> bool {
        let [u, v] = [normal.any_orthonormal_vector(), normal.cross(normal.any_orthonormal_vector())];
        let flat = |p: DVec3| DVec2::new(u.dot(p - polygon[0]), v.dot(p - polygon[0]));
        let mut quad = [DVec2::ZERO; 4];
        for (corner, leg) in quad.iter_mut().zip(&self.legs) {
            let (origin, direction) = (leg.origin.as_dvec3(), leg.direction.as_dvec3());
            let distance = normal.dot(polygon[0] - origin) / normal.dot(direction);
            if !(distance > 0.0 && distance.is_finite()) {
                return false;
            }
            *corner = flat(origin + direction * distance);
        }
        let polygon: Vec<DVec2> = polygon.iter().map(|&p| flat(p)).collect();
        !is_apart(&polygon, &quad) && !is_apart(&quad, &polygon)
    }
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
    use super::*;

    /// Four legs one metre up, a tenth of a metre apart, that spread upwards.
    fn bundle(spread: f32) -> Bundle {
        let leg = |(x, z): (f32, f32)| Leg {
            origin: Vec3::new(0.1 * x, 1.0, 0.1 * z),
            direction: Vec3::new(spread * (x - 0.5), 1.0, spread * (z - 0.5)).normalize_or_zero(),
            strength: 1.0,
            events: 1,
        };
        Bundle::new([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)].map(leg)).expect("one bundle")
    }

    fn strip(x: f64, width: f64) -> Vec<DVec3> {
        [(x, -3.0), (x + width, -3.0), (x + width, 3.0), (x, 3.0)]
            .map(|(x, z)| DVec3::new(x, 2.0, z))
            .to_vec()
    }

    #[test]
    fn a_strip_is_found_between_legs_however_thin() {
        // One metre on, legs of no spread are 0.1 m apart, others 0.3 m.
        for (spread, reach) in [(0.0, [0.0, 0.1]), (0.2, [-0.1, 0.2])] {
            let bundle = bundle(spread);
            for width in [0.0, 1e-6, 1e-3] {
                for step in 0..40 {
                    let x = -0.3 + 0.0171 * f64::from(step);
                    let is_inside = x + width > reach[0] && x < reach[1];
                    let is_near = (x - reach[0]).abs().min((x - reach[1]).abs()) < 1e-6;
                    assert!(
                        is_near || bundle.crosses(&strip(x, width), DVec3::NEG_Y) == is_inside,
                        "{x} {width}"
                    );
                }
            }
        }
        // Behind the legs, nothing is.
        let below: Vec<DVec3> = strip(0.05, 0.01).iter().map(|p| *p - DVec3::Y * 1.5).collect();
        assert!(!bundle(0.0).crosses(&below, DVec3::Y));
    }

    #[test]
    fn the_strongest_legs_are_noted_by_their_events() {
        let mut legs = Legs::default();
        legs.note(Vec3::ZERO, Vec3::X, 1.0, 0);
        assert!(legs.0.iter().all(|leg| leg.strength == 0.0));
        for (strength, events) in [(0.04, 1), (0.9, 2), (0.02, 3), (0.03, 1)] {
            legs.note(Vec3::ZERO, Vec3::X, strength, events);
        }
        assert_eq!(legs.0.map(|leg| (leg.strength, leg.events)), [(0.04, 1), (0.9, 2)]);
    }
}
