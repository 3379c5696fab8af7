//! Small bright places, near or far: the ceiling over a lamp's shade, a patch of sun. What stands before them throws shadows as before a
//! lamp, and some points tell where.

use std::f32::consts::PI;

use rayon::prelude::*;

use catoptric_light::Receiver;
use catoptric_scene::Rgb;
use catoptric_trace::sequence::{Key, Purpose, triangle_point};
use catoptric_trace::{PlaneId, Tracer};
use glam::Vec3;

use crate::draft::Draft;

use super::look::{Surplus, at_asked};
use super::{Known, NearLight};

/// Points that stand for all bright places.
const POINTS: u32 = 32;
/// Times the mean radiance of the scene from which on a place is bright.
const BRIGHT: f32 = 8.0;
/// Share of all light that bright places send, at least, where their shadows are looked for.
const LEAST: f64 = 0.1;

/// A point on a bright place.
#[derive(Clone, Copy, Debug)]
struct Point {
    position: Vec3,
    /// Unit, on the side that sends.
    normal: Vec3,
    plane: PlaneId,
}

/// Irradiance by each point, times their number.
pub(super) type Lit = [f32; POINTS as usize];

/// The bright places of a scene.
#[derive(Clone, Debug, Default)]
pub(super) struct Places {
    points: Vec<Point>,
    /// Radiance times area of all.
    sent: f32,
    /// Area that each point stands for, m².
    area: f32,
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
        let mut points = Vec::with_capacity(POINTS as usize);
        let mut sum = 0.0;
        for (element, &(radiance, own)) in bright() {
            sum += f64::from(radiance) * f64::from(own) / sent;
            while points.len() < POINTS as usize && (points.len() as f64 + 0.5) / f64::from(POINTS) < sum {
                let (u, v) = triangle_point(key.point2(points.len() as u32));
                let corners = mesh.elements[element].vertices.map(|v| &mesh.vertices[v as usize]);
                let [a, b, c] = corners.map(|corner| corner.position);
                points.push(Point {
                    position: a + (b - a) * u + (c - a) * v,
                    normal: corners[0].normal,
                    plane: light.tracer.planes().of(corners[0].triangle),
                });
            }
        }
        Self { points, sent: sent as f32, area: area as f32 / POINTS as f32 }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// What a receiver gets from each.
    fn lit(&self, tracer: &Tracer, receiver: &Receiver) -> Lit {
        let mut lit = [0.0; POINTS as usize];
        for (lit, point) in lit.iter_mut().zip(&self.points) {
            let way = point.position - receiver.position;
            let cosines = way.dot(receiver.normal).max(0.0) * (-way.dot(point.normal)).max(0.0);
            // Beside a place no point stands for more than its area does.
            let distance = way.length_squared();
            let factor = cosines / (distance * distance.max(self.area));
            let seen = || tracer.visibility(receiver.position, receiver.plane, point.position, point.plane);
            if factor > 0.0 && seen() != Rgb::ZERO {
                *lit = self.sent * factor;
            }
        }
        lit
    }

    /// The edges in whose middle their light is not what the ends foretell, with the difference as a multiple of what `left_alone` says, of an edge
    /// and the light there, to leave alone.
    pub(super) fn bent(
        &self,
        tracer: &Tracer,
        draft: &mut Draft,
        mut candidates: Vec<(u32, u32)>,
        known: &mut Known,
        left_alone: impl Fn(&Draft, (u32, u32), f32) -> f32,
    ) -> Vec<(f32, (u32, u32))> {
        let total = |lit: &Lit| lit.iter().sum::<f32>() / POINTS as f32;
        self.look(tracer, draft, candidates.iter().flat_map(|&(a, b)| [a, b]).collect(), &mut known.lit);
        candidates.retain(|&(a, b)| {
            let [Some(one), Some(other)] = [a, b].map(|v| known.lit(v).map(total)) else { return false };
            let there = 0.5 * (known.all[a as usize] + known.all[b as usize]);
            (one - other).abs() > left_alone(draft, (a, b), there.max(0.5 * (one + other)))
        });
        draft.make_midpoints(tracer, &candidates);
        let middles: Vec<u32> = candidates.iter().map(|&(a, b)| draft.midpoint(tracer, a, b)).collect();
        known.fill(draft);
        self.look(tracer, draft, middles.clone(), &mut known.lit);
        let excess = |((a, b), middle): ((u32, u32), u32)| {
            let (one, other, own) = (known.lit(a)?, known.lit(b)?, known.lit(middle)?);
            let bend = Surplus::of_middle(own, [one, other], POINTS);
            let there = known.all[middle as usize].max(total(own));
            let excess = bend.sum.abs() / left_alone(draft, (a, b), there);
            (bend.is_significant() && excess > 1.0).then_some((excess, (a, b)))
        };
        candidates.into_iter().zip(middles).filter_map(excess).collect()
    }

    /// Has vertices look that have not yet.
    fn look(&self, tracer: &Tracer, draft: &Draft, vertices: Vec<u32>, lit: &mut Vec<Option<Box<Lit>>>) {
        at_asked(draft, vertices, lit, |vertex, lit| {
            lit.get_or_insert_with(|| Box::new(self.lit(tracer, &draft.gatherer(tracer, vertex))));
        });
    }
}
