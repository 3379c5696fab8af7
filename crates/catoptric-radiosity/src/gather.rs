//! The final gather: irradiance at a point by hemisphere rays that follow S* chains, and what they saw on the way.
//!
//! Malley's mapping of a scrambled (0,2)-sequence: each ray carries π/N of the incoming radiance, less where a guide sends
//! more rays.

use std::f32::consts::PI;
use std::ops::Range;

use glam::Vec3;

use catoptric_light::{Lights, Owner, PathClass, Receiver};
use catoptric_scene::Rgb;
use catoptric_solution::DisplayMesh;
use catoptric_solution::mesh::Located;
use catoptric_trace::sequence::{Key, cosine_hemisphere, frame};
use catoptric_trace::walk::{self, Arrival, End, WalkParams};
use catoptric_trace::{Chain, Hit, Ledger, MediumStack, Ray, Tracer};

use crate::fit::variance_of_halves;
use crate::guide::{Aim, Guide};

/// Irradiance that hemisphere rays found, by the class of the path from its source.
#[derive(Clone, Copy, Debug, Default)]
pub struct Gathered {
    /// Broad emitters seen straight.
    pub direct: Rgb,
    /// Sources over planar mirrors that are on no list.
    pub mirrored: Rgb,
    /// Sources over curved or refracting surfaces, where no light-side pass owns them.
    pub caustic: Rgb,
    /// Light from other diffuse surfaces.
    pub indirect: Rgb,
    /// Variance of their sum, channels added.
    pub noise: f32,
    /// Where the power went, if the rays were sent from here.
    pub ledger: Ledger,
}

/// Diffuse light of the scene as gathers see it: irradiance at the vertices of a display mesh.
pub struct DiffuseLight<'a> {
    /// The mesh.
    pub mesh: &'a DisplayMesh,
    /// Irradiance per vertex: sources and the coarse solution.
    pub irradiance: &'a [Rgb],
}

impl DiffuseLight<'_> {
    /// Irradiance at a place on the mesh.
    #[inline]
    fn at(&self, located: &Located) -> Rgb {
        let [a, b, c] = located.vertices.map(|v| self.irradiance[v as usize]);
        a * located.weights[0] + b * located.weights[1] + c * located.weights[2]
    }

    /// The places whose irradiance a surface sends back to the ray that arrives, and what that counts: ρ/π on its side, τ/π on the
    /// other, and the opacity and the coat there.
    #[inline]
    fn sent_back(&self, arrival: &Arrival, mut visit: impl FnMut(&Located, Rgb)) {
        let interaction = arrival.interaction;
        let (triangle, side) = (arrival.hit.triangle, interaction.side);
        for (share, side) in [(interaction.reflectance, side), (interaction.transmittance, side.opposite())] {
            if share.max_element() > 0.0
                && let Some(located) = self.mesh.locate(triangle, side, arrival.position)
            {
                visit(&located, share * (interaction.receives / PI));
            }
        }
    }
}

/// Gathers at a receiver with `rays` hemisphere rays.
pub fn gather(
    lights: &Lights,
    light: &DiffuseLight,
    receiver: &Receiver,
    rays: u32,
    key: Key,
    params: &WalkParams,
) -> Gathered {
    gather_part(lights, light, receiver, 0..rays, None, key, params, &mut ())
}

/// Who looks on while a gather sends its rays.
pub trait Witness {
    /// A ray was sent like this and found this radiance, all channels.
    fn sent(&mut self, _aim: &Aim, _radiance: f32) {}
    /// A place on the mesh was met; irradiance there counts `share`.
    fn met(&mut self, _located: &Located, _share: Rgb) {}
}

impl Witness for () {}

/// Gathers at a receiver with some rays of a sequence, sent as `guide` wants: what they find alone.
pub fn gather_part(
    lights: &Lights,
    light: &DiffuseLight,
    receiver: &Receiver,
    part: Range<u32>,
    guide: Option<&Guide>,
    key: Key,
    params: &WalkParams,
    witness: &mut impl Witness,
) -> Gathered {
    let tracer = lights.tracer();
    let mut result = Gathered::default();
    let mut ledger = Ledger::default();
    let (tangent, bitangent) = frame(receiver.normal);
    let coated = !receiver.coat.is_none();
    // Broad emitters: their unoccluded irradiance is known exactly and serves as control variate.
    let controlled = !coated && receiver.media == MediumStack::AIR && !lights.emitters().broad().is_empty();
    let mut halves = [Half::default(); 2];
    let mut before = Rgb::ZERO;
    let rays = part.len() as u32;
    let each = PI / rays.max(1) as f32;
    for index in part.clone() {
        let half = usize::from(2 * (index - part.start) >= rays);
        let point =
            if controlled && half == 1 { key.child(SECOND_HALF).point2(index) } else { key.point2(index) };
        let aim = guide.map_or(Aim::even(point), |guide| guide.warp(point));
        // What the ray counts, beside π/N.
        let share = aim.share;
        let local = cosine_hemisphere(aim.point);
        let direction = tangent * local.x + bitangent * local.y + receiver.normal * local.z;
        if direction.dot(receiver.geometric) <= 0.0 {
            // Below the surface itself: nothing arrives.
            ledger.absorbed += Rgb::splat(share).as_dvec3();
            halves[half].add(Rgb::ZERO, share);
            witness.sent(&aim, 0.0);
            continue;
        }
        let weight = share * if coated { receiver.coat.transmittance(local.z) } else { 1.0 };
        let ray = Ray { origin: receiver.position, direction, from: receiver.plane };
        // Rays that a guide sends densely count little, each, and are no weaker for that.
        let params = WalkParams { roulette_below: params.roulette_below * share.min(1.0), ..*params };
        let end = walk::choose(
            tracer,
            ray,
            receiver.media,
            Rgb::splat(weight),
            key.child(index),
            &params,
            &mut ledger,
            |arrival| {
                let scale = tracer.media().radiance_scale(receiver.media.current(), arrival.media.current());
                let share = arrival.throughput * scale;
                light.sent_back(arrival, |located, sent| {
                    result.indirect += light.at(located) * (share * sent);
                    witness.met(located, share * sent * each);
                });
                let emission = arrival.interaction.emission.0;
                if emission.max_element() > 0.0
                    && lights.owner(lights.source_at(arrival.hit.triangle), arrival.chain)
                        == Owner::Hemisphere
                {
                    *result.class(arrival.chain) += arrival.throughput * emission * scale;
                }
            },
        );
        match end {
            End::Escaped { direction, throughput, chain, media } => {
                if let Some(sky) = tracer.scene().sky()
                    && lights.owner(lights.sky_source(sky, direction), &chain) == Owner::Hemisphere
                {
                    let scale = tracer.media().radiance_scale(receiver.media.current(), media.current());
                    *result.class(&chain) += throughput * sky.radiance(direction).0 * scale;
                }
            }
            End::Inside => {}
        }
        let total = result.total();
        let found = total - before;
        before = total;
        let single = found.element_sum() / share;
        witness.sent(&aim, single);
        halves[half].add(found, share);
        if controlled {
            let (origin, from) = (receiver.position.as_dvec3(), receiver.plane);
            let control = lights.emitters().broad_along(origin, from, direction.as_dvec3());
            halves[half].compare(single, control, share);
        }
    }
    for sum in [&mut result.direct, &mut result.mirrored, &mut result.caustic, &mut result.indirect] {
        *sum *= each;
    }
    let mut found = halves.each_ref().map(|half| half.found * each);
    if let Some(guide) = guide {
        for (found, half) in found.iter_mut().zip(&halves) {
            let missing = (half.rays - half.shares) / rays.max(1) as f32;
            result.add(guide.expected(), missing);
            *found += guide.expected().total() * missing;
        }
    }
    if controlled {
        let exact = lights.broad_unoccluded(receiver);
        // Each half is corrected with the coefficient of the other, so that no sample decides its own weight; with its own
        // where the other met no broad emitter.
        for k in 0..2 {
            let (own, other) = (&halves[k], &halves[1 - k]);
            let missing = exact * (own.weight / rays.max(1) as f32) - own.control * each;
            let missing = missing * other.coefficient().or(own.coefficient()).unwrap_or(1.0);
            result.direct += missing;
            found[k] += missing;
        }
    }
    if rays > 1 {
        let [one, other] = [0, 1].map(|k| found[k] * (rays as f32 / halves[k].rays));
        result.noise = variance_of_halves(one - other);
    }
    result.ledger = ledger;
    result
}

/// Key of the second half of the rays where each half decides what the other's control variate is worth: halves of one sequence
/// know of each other, and short ones leaned (furnace_mirror was 0.3 % too dark by 16 rays).
const SECOND_HALF: u32 = 1 << 30;

/// Sums over half of the rays of a gather.
#[derive(Clone, Copy, Debug, Default)]
struct Half {
    rays: f32,
    /// What they count: their number where no guide changes it.
    shares: f32,
    /// Σ wf.
    found: Rgb,
    /// Σ w of those that the control variate was asked about.
    weight: f32,
    /// Σ wg.
    control: Rgb,
    /// Σ wf, Σ wg, Σ wfg, Σ wg² of the summed channels.
    moments: [f64; 4],
}

impl Half {
    /// A ray that counts `share`, and brought `found` with it.
    #[inline]
    fn add(&mut self, found: Rgb, share: f32) {
        self.rays += 1.0;
        self.shares += share;
        self.found += found;
    }

    /// What a control variate says to what was found, channels summed.
    #[inline]
    fn compare(&mut self, found: f32, control: Rgb, weight: f32) {
        let (f, g) = (f64::from(found), f64::from(control.element_sum()));
        self.weight += weight;
        self.control += control * weight;
        for (sum, value) in self.moments.iter_mut().zip([f, g, f * g, g * g]) {
            *sum += value * f64::from(weight);
        }
    }

    /// Cov(f, g)/Var(g): 1 where the broad emitters are all there is, 0 in a furnace, where every ray finds the same. `None`
    /// where g does not vary.
    fn coefficient(&self) -> Option<f32> {
        let n = f64::from(self.weight.max(1.0));
        let [f, g, fg, gg] = self.moments.map(|m| m / n);
        let variance = gg - g * g;
        (variance > 1e-6 * gg).then(|| ((fg - f * g) / variance).clamp(0.0, 1.0) as f32)
    }
}

impl Gathered {
    /// Adds a share of the light of another gather; ledgers stay apart.
    #[inline]
    pub fn add(&mut self, other: &Self, share: f32) {
        self.direct += other.direct * share;
        self.mirrored += other.mirrored * share;
        self.caustic += other.caustic * share;
        self.indirect += other.indirect * share;
        self.noise += other.noise * share * share;
    }

    /// The light of this gather and another, of which this one counts by a share; ledgers stay apart.
    pub fn mixed(&self, other: &Self, share: f32) -> Self {
        let mut sum = Self { ledger: self.ledger, ..Self::default() };
        sum.add(self, share);
        sum.add(other, 1.0 - share);
        sum
    }

    /// All classes.
    #[inline]
    pub fn total(&self) -> Rgb {
        self.direct + self.mirrored + self.caustic + self.indirect
    }

    #[inline]
    fn class(&mut self, chain: &Chain) -> &mut Rgb {
        match PathClass::of(chain) {
            PathClass::Direct => &mut self.direct,
            PathClass::Mirrored => &mut self.mirrored,
            PathClass::Caustic => &mut self.caustic,
        }
    }
}

/// What a receiver sees first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surroundings {
    /// Harmonic mean distance, metres: the scale on which irradiance from near surfaces varies (Ward & Heckbert 1992).
    /// Infinite where nothing is seen.
    pub distance: f32,
    /// Only black backs and nothing else: the inside of a solid, or the gap behind a mirror. Nobody looks there.
    pub hidden: bool,
}

/// Share of rays that meet black backs beyond which a place counts as hidden: a place beside a single sheet sees half.
const HIDDEN_SHARE: f32 = 0.9;

/// Looks around with some hemisphere rays of a sequence; `visit` is told what each meets, by its number, and where.
pub fn look_around(
    tracer: &Tracer,
    receiver: &Receiver,
    part: Range<u32>,
    key: Key,
    mut visit: impl FnMut(u32, &Hit, Vec3),
) -> Surroundings {
    let (tangent, bitangent) = frame(receiver.normal);
    let mut inverse = 0.0_f32;
    let mut backs = 0;
    let rays = part.len() as f32;
    for index in part {
        let local = cosine_hemisphere(key.point2(index));
        let direction = tangent * local.x + bitangent * local.y + receiver.normal * local.z;
        let ray = Ray { origin: receiver.position, direction, from: receiver.plane };
        if let Some(hit) = tracer.nearest(&ray, f32::INFINITY) {
            visit(index, &hit, ray.origin + ray.direction * hit.t);
            inverse += 1.0 / hit.t.max(1e-6);
            backs += u32::from(hit.back && tracer.is_culled_from_behind(hit.triangle));
        }
    }
    Surroundings {
        distance: if inverse > 0.0 { rays / inverse } else { f32::INFINITY },
        hidden: backs as f32 > HIDDEN_SHARE * rays,
    }
}
