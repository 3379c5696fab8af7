//! Hemisphere rays: Nusselt's analogue by Malley's mapping. Points of the unit disk, lifted to the hemisphere, are
//! directions with density cosθ/π, so F_ij is the share of rays from i that arrive at j.
//!
//! Sources: Nusselt 1928; Malley 1988; extended rows Sillion & Puech 1989 (keys in docs/references.md).

use glam::{DVec3, Vec2};

use catoptric_trace::sequence::{Key, Purpose, cosine_hemisphere, frame};
use catoptric_trace::walk::{self, Arrival};
use catoptric_trace::{Ledger, Ray, Tracer};

use super::scrambles::{SCRAMBLES, Scrambles};
use super::{ElementSet, FactorRow, FormFactors, MethodParams};

/// The method.
pub struct Rays<'a> {
    /// The scene.
    pub tracer: &'a Tracer<'a>,
    /// Senders and receivers.
    pub set: &'a ElementSet,
    /// Rays per scramble and their limits.
    pub params: MethodParams,
}

impl FormFactors for Rays<'_> {
    fn row(&self, from: u32) -> FactorRow {
        cast(self.tracer, self.set, &self.params, from, |_, _| 1.0)
    }
}

/// Casts the rays of one element; `weigh` says with which weight an arrival counts, given cosθ at the sender.
pub(crate) fn cast(
    tracer: &Tracer,
    set: &ElementSet,
    params: &MethodParams,
    from: u32,
    mut weigh: impl FnMut(&Arrival, f64) -> f64,
) -> FactorRow {
    let each = params.rays.max(1);
    let key = Key::new(params.seed, Purpose::FormFactor, u64::from(from));
    let roulette = Key::new(params.seed, Purpose::Roulette, u64::from(from) | 1 << 44);
    let media = set.elements()[from as usize].media;
    let mut scrambles = Scrambles::new(set.len());
    let mut ledger = Ledger::default();
    let share = 1.0 / f64::from(each);
    for scramble in 0..SCRAMBLES {
        let points = key.child(scramble);
        for index in 0..each {
            let [a, b, u, v] = points.point4(index);
            let (piece, position) = set.point(from, f64::from(u), f64::from(v));
            let normal = piece.normal.as_vec3();
            let (tangent, bitangent) = frame(normal);
            let local = cosine_hemisphere(Vec2::new(a, b));
            let direction = tangent * local.x + bitangent * local.y + normal * local.z;
            let ray = Ray { origin: position.as_vec3(), direction, from: piece.plane };
            walk::choose_meeting(
                tracer,
                ray,
                media,
                glam::Vec3::ONE,
                roulette.child(scramble).child(index),
                &params.walk,
                &mut ledger,
                |arrival| {
                    if let Some(to) = set.locate(
                        arrival.hit.triangle,
                        arrival.interaction.side,
                        arrival.position.as_dvec3(),
                    ) {
                        let weight = weigh(arrival, f64::from(local.z)) * share;
                        scrambles.add(to, arrival.throughput.as_dvec3() * weight);
                    }
                },
            );
        }
        scrambles.next();
    }
    let (factors, errors) = scrambles.finish();
    let rays = u64::from(each) * u64::from(SCRAMBLES);
    FactorRow::from_dense(&factors, &errors, ledger.scaled(1.0 / rays as f64), rays)
}

/// F to every element and its errors as dense lists, for methods that leave a part to rays.
pub(crate) fn dense(row: &FactorRow, elements: usize) -> (Vec<DVec3>, Vec<f64>) {
    let mut factors = vec![DVec3::ZERO; elements];
    let mut errors = vec![0.0; elements];
    for entry in &row.entries {
        factors[entry.to as usize] = entry.factor;
        errors[entry.to as usize] = entry.error;
    }
    (factors, errors)
}
