//! What vertices see of the light that is known, by rays that all of them send alike, and how much more one sees than others.

use std::f32::consts::PI;

use rayon::prelude::*;

use catoptric_light::Receiver;
use catoptric_scene::{Rgb, Side, TriangleId};
use catoptric_trace::sequence::{Key, Purpose};
use catoptric_trace::{Ledger, Ray, walk};
use glam::Vec3;

use crate::JOB;
use crate::draft::Draft;
use crate::gather::look_around;

use super::NearLight;

/// A difference counts if it is more than this multiple of its standard error.
const SIGNIFICANT: f32 = 2.0;

/// What a vertex sees.
#[derive(Clone, Debug)]
pub(super) struct Seen {
    /// Irradiance if all rays met what this one does, by what surfaces send first: the largest channel. Per ray.
    pub(super) irradiance: Vec<f32>,
    /// Harmonic mean distance, metres.
    pub(super) distance: f32,
}

impl Seen {
    /// Before the first look.
    const NOTHING: Self = Self { irradiance: Vec::new(), distance: f32::INFINITY };

    pub(super) fn total(&self) -> f32 {
        self.irradiance.iter().sum::<f32>() / self.irradiance.len().max(1) as f32
    }

    /// How much it is more or less than what another sees by the same rays.
    pub(super) fn difference(&self, other: &Self) -> f32 {
        let rays = self.irradiance.len().min(other.irradiance.len());
        let differences = self.irradiance.iter().zip(&other.irradiance).map(|(a, b)| a - b);
        differences.sum::<f32>().abs() / rays.max(1) as f32
    }
}

/// What one place sees more than another by the same rays.
#[derive(Clone, Copy, Debug)]
pub(super) struct Surplus {
    pub(super) sum: f32,
    variance: f32,
}

impl Surplus {
    /// Of the middle of an edge over the mean of its ends, by the first rays of each.
    pub(super) fn of_middle(middle: &[f32], [one, other]: [&[f32]; 2], rays: u32) -> Self {
        let ends = one.iter().zip(other).map(|(a, b)| 0.5 * (a + b));
        Self::of(ends.zip(middle).map(|(ends, m)| m - ends), rays)
    }

    /// Of the differences ray by ray of so many rays.
    pub(super) fn of(differences: impl Iterator<Item = f32>, rays: u32) -> Self {
        let each = 1.0 / rays as f32;
        let (mut sum, mut squares) = (0.0_f32, 0.0_f32);
        for difference in differences.take(rays as usize) {
            let difference = difference * each;
            sum += difference;
            squares += difference * difference;
        }
        Self { sum, variance: (squares - sum * sum * each).max(0.0) }
    }

    /// Whether the rays agree that there is one.
    pub(super) fn is_significant(self) -> bool {
        self.sum.abs() > SIGNIFICANT * self.variance.sqrt()
    }

    /// Whether it may be as much as that.
    pub(super) fn may_be(self, sum: f32) -> bool {
        self.sum.abs() + SIGNIFICANT * self.variance.sqrt() > sum
    }
}

impl NearLight<'_> {
    /// Has vertices look around by so many rays that have not yet.
    pub(super) fn look(&self, draft: &Draft, vertices: Vec<u32>, rays: u32, seen: &mut Vec<Option<Seen>>) {
        at_asked(draft, vertices, seen, |vertex, seen| {
            let receiver = draft.gatherer(self.tracer, vertex);
            self.look_from(&receiver, rays, seen.get_or_insert(Seen::NOTHING));
        });
    }

    /// What a receiver sees by so many rays.
    pub(super) fn seen_from(&self, receiver: &Receiver, rays: u32) -> Seen {
        let mut seen = Seen::NOTHING;
        self.look_from(receiver, rays, &mut seen);
        seen
    }

    /// Has a receiver look on until it has seen so many rays.
    fn look_from(&self, receiver: &Receiver, rays: u32, seen: &mut Seen) {
        let before = seen.irradiance.len() as u32;
        if before >= rays {
            return;
        }
        seen.irradiance.resize(rays as usize, 0.0);
        let key = Key::new(self.seed, Purpose::Hemisphere, 1 << 40);
        let around = look_around(self.tracer, receiver, before..rays, key, |index, hit, position| {
            let side = if hit.back { Side::Back } else { Side::Front };
            let way = position - receiver.position;
            let sent = self.radiance(hit.triangle, side, position, way).unwrap_or_else(|| {
                let is_passed_on = self.tracer.scene().material_of(hit.triangle).may_be_specular();
                if is_passed_on { self.passed_on(receiver, way, key.child(index)) } else { 0.0 }
            });
            seen.irradiance[index as usize] = PI * sent;
        });
        let more = (rays - before) as f32;
        seen.distance = rays as f32 / (before as f32 / seen.distance + more / around.distance);
    }

    /// What a place sends, against `way`, of the light that is known and as part of a broad emitter: the largest channel. `None` where it holds no
    /// light and sends none.
    fn radiance(&self, triangle: TriangleId, side: Side, position: Vec3, way: Vec3) -> Option<f32> {
        let emitted = self.lights.emitters().broad_from(triangle, way.as_dvec3()).map(Rgb::max_element);
        let Some(at) = self.displayed.mesh.locate(triangle, side, position) else { return emitted };
        let vertices = at.vertices.iter().zip(at.weights);
        let irradiance: Rgb = vertices.map(|(&v, weight)| self.of_shown(v) * weight).sum();
        let reflected = (irradiance * self.reflectance(at.element)).max_element() / PI;
        Some(reflected + emitted.unwrap_or(0.0))
    }

    /// The same of what is seen over mirrors and through glass along a way from a receiver.
    fn passed_on(&self, receiver: &Receiver, way: Vec3, key: Key) -> f32 {
        let ray = Ray { origin: receiver.position, direction: way.normalize_or_zero(), from: receiver.plane };
        let mut sum = 0.0;
        let mut ledger = Ledger::default();
        walk::choose(self.tracer, ray, receiver.media, Rgb::ONE, key, self.walk, &mut ledger, |arrival| {
            let (triangle, side) = (arrival.hit.triangle, arrival.interaction.side);
            let sent = self.radiance(triangle, side, arrival.position, arrival.direction);
            sum += sent.unwrap_or(0.0) * arrival.throughput.max_element();
        });
        sum
    }
}

/// Does something with what is known of each of some vertices of `draft`, which may be nothing yet.
pub(super) fn at_asked<T: Clone + Send>(
    draft: &Draft,
    vertices: Vec<u32>,
    known: &mut Vec<Option<T>>,
    see: impl Fn(u32, &mut Option<T>) + Sync,
) {
    known.resize(draft.vertices.len(), None);
    let mut asked = vec![false; draft.vertices.len()];
    for v in vertices {
        asked[v as usize] = true;
    }
    known.par_iter_mut().enumerate().with_min_len(16).with_max_len(JOB).for_each(|(vertex, known)| {
        if asked[vertex] {
            see(vertex as u32, known);
        }
    });
}
