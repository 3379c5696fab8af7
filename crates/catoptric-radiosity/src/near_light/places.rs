//! Small bright places, near or far: the ceiling over a lamp's shade, a patch of sun. What stands before them throws shadows as before a
//! lamp, and some points tell where.

use std::f32::consts::PI;

use rayon::prelude::*;

use catoptric_light::Receiver;
use catoptric_scene::Rgb;
use catoptric_trace::sequence::{Key, Purpose, triangle_point};
use catoptric_trace::{PlaneId, Tracer};
use glam::Vec3;

use crate::JOB;
use crate::draft::Draft;

use super::beside::{Beside, Bright};
use super::look::{Surplus, at_asked};
use super::{Known, NearLight};

/// Points that stand for all bright places, at first, …
const FEW_POINTS: u32 = 32;
/// … and all that there are, for long edges of which fewer do not tell: shorter ones are worth as many less as they cover less.
const POINTS: u32 = 256;
/// Times the mean radiance of the scene from which on a place is bright.
const BRIGHT: f32 = 8.0;
/// Share of all light that bright places send, at least, where their shadows are looked for.
const LEAST: f64 = 0.1;

/// Places no farther off than this multiple of an edge's length are beside it: the light of others bends by an eighth of six times the inverse of
/// its square at most, a fifth of that light, and points tell.
const NEAR: f32 = 2.0;

/// A point on a bright place.
#[derive(Clone, Copy, Debug)]
struct Point {
    position: Vec3,
    /// Unit, on the side that sends.
    normal: Vec3,
    plane: PlaneId,
}

/// Irradiance by each of the first points, if all sent what it does.
pub(super) type Lit = Vec<f32>;

/// The bright places of a scene.
#[derive(Clone, Debug, Default)]
pub(super) struct Places {
    /// The first of them, as many as a power of two, are spread over the places as all are.
    points: Vec<Point>,
    /// Radiance times area of all.
    sent: f32,
    /// Area that each of few points stands for, m².
    area: f32,
    beside: Beside,
}

impl Places {
    /// Where the light that is known makes a mesh bright. Triangles larger than `most_weight`, m², count as that in the mean.
    pub(super) fn new(light: &NearLight, most_weight: f32) -> Self {
        let mesh = &light.displayed.mesh;
        let own = |element: u32| {
            let received = mesh.elements[element as usize].vertices.map(|v| light.of_shown(v));
            let sent = received.into_iter().sum::<Rgb>() * light.reflectance(element) / 3.0;
            (sent.max_element() / PI, mesh.area(element))
        };
        let all: Vec<(f32, f32)> = (0..mesh.elements.len() as u32).into_par_iter().map(own).collect();
        let (mut power, mut whole) = (0.0_f64, 0.0_f64);
        for &(radiance, area) in &all {
            let counted = f64::from(area.min(most_weight));
            power += f64::from(radiance) * counted;
            whole += counted;
        }
        let least = BRIGHT * (power / whole) as f32;
        let bright = || all.iter().enumerate().filter(|(_, (radiance, _))| *radiance > least);
        let (mut sent, mut area) = (0.0_f64, 0.0_f64);
        for (_, &(radiance, own)) in bright() {
            sent += f64::from(radiance) * f64::from(own);
            area += f64::from(own);
        }
        if sent <= LEAST * power {
            return Self::default();
        }
        // In proportion to what they send.
        let key = Key::new(light.seed, Purpose::Hemisphere, 1 << 41);
        let mut ordered = Vec::with_capacity(POINTS as usize);
        let mut sum = 0.0;
        for (element, &(radiance, own)) in bright() {
            sum += f64::from(radiance) * f64::from(own) / sent;
            while ordered.len() < POINTS as usize && (ordered.len() as f64 + 0.5) / f64::from(POINTS) < sum {
                let (u, v) = triangle_point(key.point2(ordered.len() as u32));
                let corners = mesh.elements[element].vertices.map(|v| &mesh.vertices[v as usize]);
                let [a, b, c] = corners.map(|corner| corner.position);
                ordered.push(Point {
                    position: a + (b - a) * u + (c - a) * v,
                    normal: corners[0].normal,
                    plane: light.tracer.planes().of(corners[0].triangle),
                });
            }
        }
        let unused = u32::BITS - POINTS.trailing_zeros();
        let turned = (0..POINTS).filter_map(|k| ordered.get((k.reverse_bits() >> unused) as usize).copied());
        let element = |(element, &(radiance, area)): (usize, &(f32, f32))| {
            let corners = mesh.elements[element].vertices.map(|v| &mesh.vertices[v as usize]);
            let plane = light.tracer.planes().of(corners[0].triangle);
            Bright { corners: corners.map(|c| c.position), normal: corners[0].normal, plane, radiance, area }
        };
        Self {
            points: turned.collect(),
            sent: sent as f32,
            area: area as f32 / FEW_POINTS as f32,
            beside: Beside::new(bright().map(element).collect()),
        }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// What a receiver gets from a point.
    fn lit_by(&self, tracer: &Tracer, receiver: &Receiver, point: &Point) -> f32 {
        let way = point.position - receiver.position;
        let cosines = way.dot(receiver.normal).max(0.0) * (-way.dot(point.normal)).max(0.0);
        // Beside a place no point stands for more than its area does.
        let distance = way.length_squared();
        let factor = cosines / (distance * distance.max(self.area));
        let seen = || tracer.visibility(receiver.position, receiver.plane, point.position, point.plane);
        if factor > 0.0 && seen() != Rgb::ZERO { self.sent * factor } else { 0.0 }
    }

    /// The edges in whose middle their light is not what the ends foretell, with the difference as a multiple of what `left_alone` says, of an edge
    /// and the light there, to leave alone. Edges of length `wide` are worth all points.
    pub(super) fn bent(
        &self,
        tracer: &Tracer,
        draft: &mut Draft,
        mut candidates: Vec<(u32, u32)>,
        known: &mut Known,
        wide: f32,
        left_alone: impl Fn(&Draft, (u32, u32), f32) -> f32,
    ) -> Vec<(f32, (u32, u32))> {
        let total = |lit: &Lit| lit.iter().sum::<f32>() / lit.len() as f32;
        let ends = candidates.iter().flat_map(|&(a, b)| [a, b]).collect();
        self.look(tracer, draft, ends, FEW_POINTS, &mut known.lit);
        candidates.retain(|&(a, b)| {
            let [Some(one), Some(other)] = [a, b].map(|v| known.lit(v).map(total)) else { return false };
            let there = 0.5 * (known.all[a as usize] + known.all[b as usize]);
            (one - other).abs() > left_alone(draft, (a, b), there.max(0.5 * (one + other)))
        });
        draft.make_midpoints(tracer, &candidates);
        let middles: Vec<u32> = candidates.iter().map(|&(a, b)| draft.midpoint(tracer, a, b)).collect();
        known.fill(draft);
        let mut open: Vec<((u32, u32), u32)> = candidates.into_iter().zip(middles).collect();
        let mut bent = Vec::new();
        let mut points = FEW_POINTS;
        while !open.is_empty() && points <= POINTS {
            let asked = open.iter().flat_map(|&((a, b), middle)| [a, b, middle]).collect();
            self.look(tracer, draft, asked, points, &mut known.lit);
            open.retain(|&((a, b), middle)| {
                let [Some(one), Some(other), Some(own)] = [a, b, middle].map(|v| known.lit(v)) else {
                    return false;
                };
                let bend = Surplus::of_middle(own, [one, other], points);
                let there = known.all[middle as usize].max(total(own));
                let left_alone = left_alone(draft, (a, b), there);
                if bend.sum.abs() > left_alone && bend.is_significant() {
                    bent.push((bend.sum.abs() / left_alone, (a, b)));
                    return false;
                }
                let is_worth = (2 * points) as f32 <= POINTS as f32 * (draft.length((a, b)) / wide).powi(2);
                is_worth && bend.may_be(left_alone)
            });
            points *= 2;
        }
        bent
    }

    /// The edges in whose middle the light of places beside them is not what the ends foretell, likewise: however small these are, by their
    /// exact form.
    pub(super) fn bent_beside(
        &self,
        tracer: &Tracer,
        draft: &mut Draft,
        candidates: &[(u32, u32)],
        known: &mut Known,
        left_alone: impl Fn(&Draft, (u32, u32), f32) -> f32 + Sync,
    ) -> Vec<(f32, (u32, u32))> {
        let bend = |[one, own, other]: [f32; 3]| (own - 0.5 * (one + other)).abs();
        let middle = |draft: &Draft, (a, b): (u32, u32)| {
            let [from, to] = [a, b].map(|v| &draft.vertices[v as usize]);
            (0.5 * (from.sample + to.sample), (from.normal + to.normal).normalize_or_zero())
        };
        let is_near = |ends: &(u32, u32)| {
            let (point, normal) = middle(draft, *ends);
            self.beside.is_near(point, normal, NEAR * draft.length(*ends))
        };
        let near = candidates.par_iter().with_min_len(64).copied().filter(is_near);
        let near: Vec<(u32, u32)> = near.collect();
        let ends = near.iter().flat_map(|&(a, b)| [a, b]).collect();
        at_asked(draft, ends, &mut known.free, |vertex, free| {
            free.get_or_insert_with(|| {
                let at = &draft.vertices[vertex as usize];
                self.beside.free(at.sample, at.normal)
            });
        });
        // Most see no more of them than points tell, even if nothing is in the way.
        let is_bent = |&(a, b): &(u32, u32)| {
            let [Some(one), Some(other)] = [a, b].map(|v| known.free[v as usize]) else { return false };
            let (point, normal) = middle(draft, (a, b));
            let own = self.beside.free(point, normal);
            let there = 0.5 * (known.all[a as usize] + known.all[b as usize]);
            bend([one, own, other]) > left_alone(draft, (a, b), there.max(own))
        };
        let own = near.par_iter().with_max_len(JOB).copied().filter(is_bent);
        let candidates: Vec<(u32, u32)> = own.collect();
        draft.make_midpoints(tracer, &candidates);
        let middles: Vec<u32> = candidates.iter().map(|&(a, b)| draft.midpoint(tracer, a, b)).collect();
        known.fill(draft);
        let asked = candidates.iter().zip(&middles).flat_map(|(&(a, b), &middle)| [a, b, middle]).collect();
        at_asked(draft, asked, &mut known.beside, |vertex, seen| {
            seen.get_or_insert_with(|| self.beside.seen(tracer, &draft.gatherer(tracer, vertex)));
        });
        let excess = |(ends, middle): ((u32, u32), u32)| {
            let [one, own, other] = [ends.0, middle, ends.1].map(|v| known.beside[v as usize].unwrap_or(0.0));
            let there = known.all[middle as usize].max(own);
            (bend([one, own, other]) / left_alone(draft, ends, there), ends)
        };
        candidates.into_iter().zip(middles).map(excess).filter(|mark| mark.0 > 1.0).collect()
    }

    /// Has vertices look at so many points that have not yet.
    fn look(
        &self,
        tracer: &Tracer,
        draft: &Draft,
        vertices: Vec<u32>,
        points: u32,
        lit: &mut Vec<Option<Lit>>,
    ) {
        at_asked(draft, vertices, lit, |vertex, lit| {
            let lit = lit.get_or_insert_default();
            let receiver = draft.gatherer(tracer, vertex);
            for point in self.points.iter().take(points as usize).skip(lit.len()) {
                lit.push(self.lit_by(tracer, &receiver, point));
            }
        });
    }
}
