//! The slow twin: the same [`Scene`](catoptric_scene::Scene) by path tracing, each class of light path apart.
//!
//! No mesh, no images, no patches, its own random numbers. It shares with the renderer what exists once on purpose:
//! `Tracer::nearest`, the surface interaction and the optical constants (they have their own tests). Formulas: path
//! tracing with the balance heuristic (Veach 1997, §9.2), and for punctual lights light tracing (Dutré 1993).
//!
//! The layers are a partition of the light (Heckbert's classes; S* of panes and blended surfaces is *undeviated*):
//!
//! | layer | paths |
//! |---|---|
//! | `emission` | LE |
//! | `direct` | LDE, on the way from L to D nothing or undeviated |
//! | `mirrored` | LS⁺DE, also planar reflections |
//! | `caustic` | LS⁺DE, also curved reflections or refractions |
//! | `indirect` | two or more D |
//! | `specular.…` | the same, S⁺ between the last D (or L) and E |
//!
//! From the eye, area lights and the sky are found by hitting them, area lights also by next-event estimation. What
//! luck seldom finds is left to particles from the lights, each diffuse vertex of which is connected with the pinhole
//! (`particles.rs`): LS⁺D… of area lights seen directly, and all LS⁺D… of punctual lights, which cannot be hit. What a
//! particle lights is **not seen through S** other than straight through panes: the `specular.` layers lack LS⁺D… of
//! punctual lights, and orthographic cameras lack all of it.
//!
//! Radiance along a path scales with n²: (n_eye/n_source)² in all. Coats: H_T (see `catoptric_trace::interaction`).

use std::f32::consts::PI;

use catoptric_scene::light::{PunctualKind, PunctualLight};
use catoptric_scene::{Barycentric, Camera, Projection, Rgb, TriangleId};

use catoptric_trace::interaction::Interaction;
use catoptric_trace::{Event, Hit, MediumStack, Ray, Tracer};
use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::particles;
use crate::path::{DIRECT, INDIRECT, Random, SPECULAR, Vertex, Way, choose};

/// Names of the layers, in the order of [`Twin::layers`].
pub const LAYERS: [&str; 10] = [
    "emission",
    "direct",
    "mirrored",
    "caustic",
    "indirect",
    "specular.emission",
    "specular.direct",
    "specular.mirrored",
    "specular.caustic",
    "specular.indirect",
];
/// How much work.
#[derive(Clone, Copy, Debug)]
pub struct TwinParams {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Paths per pixel, at least 2 for a standard error.
    pub samples: u32,
    /// Particles per punctual light and for all area lights together; 0: LS⁺D… of area lights is found from the eye.
    pub particles: u32,
    /// Seed.
    pub seed: u64,
}

/// One layer: an estimate per pixel.
#[derive(Clone, Debug)]
pub struct Layer {
    /// Mean radiance.
    pub mean: Vec<DVec3>,
    /// Square of the standard error of the mean.
    pub variance: Vec<DVec3>,
    /// The largest share that one path had in a pixel's mean.
    pub peak: DVec3,
}

/// The answer, row-major.
#[derive(Clone, Debug)]
pub struct Twin {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// In the order of [`LAYERS`].
    pub layers: Vec<Layer>,
}

/// What one path adds to the layers.
type Shares = [DVec3; 10];

/// Events after which a path is given up. Eye rays along a duct of perfect mirrors meet 1/slope of them: a picture of
/// it lacks the share 1e-5 of its horizon.
pub(crate) const MAX_EVENTS: u32 = 100_000;

pub(crate) struct Scenery<'a> {
    pub(crate) tracer: &'a Tracer<'a>,
    /// Emitting triangles and their cumulative probabilities.
    emitters: Vec<(TriangleId, f64)>,
    /// Probability per area of each triangle.
    density: Vec<f32>,
    /// LS⁺D… of area lights, seen directly, is found by particles.
    particles: bool,
}

/// Renders a view.
pub fn render(tracer: &Tracer, camera: &Camera, params: &TwinParams) -> Twin {
    let scenery = Scenery::new(tracer, camera, params);
    let pixels = params.width * params.height;
    let samples = f64::from(params.samples);
    let sampled: Vec<[(DVec3, DVec3, DVec3); 10]> = (0..pixels)
        .into_par_iter()
        .map(|pixel| {
            let mut random = Random(params.seed.wrapping_mul(0x2545_f491_4f6c_dd1d) ^ (pixel as u64) << 24);
            let mut sums = [(DVec3::ZERO, DVec3::ZERO, DVec3::ZERO); 10];
            for _ in 0..params.samples {
                let x = (pixel % params.width) as f32 + random.next();
                let y = (pixel / params.width) as f32 + random.next();
                let (origin, direction) = camera.ray(x, y, params.width, params.height);
                let shares = scenery.path(Ray::free(origin, direction), &mut random);
                for (sum, share) in sums.iter_mut().zip(shares) {
                    *sum = (sum.0 + share, sum.1 + share * share, sum.2.max(share));
                }
            }
            sums
        })
        .collect();
    let layer = |index: usize| {
        let mean: Vec<DVec3> = sampled.iter().map(|s| s[index].0 / samples).collect();
        let of_mean = |s: &[(DVec3, DVec3, DVec3); 10]| {
            let mean = s[index].0 / samples;
            (s[index].1 / samples - mean * mean).max(DVec3::ZERO) / (samples - 1.0).max(1.0)
        };
        let peak = sampled.iter().fold(DVec3::ZERO, |peak, s| peak.max(s[index].2 / samples));
        Layer { mean, variance: sampled.iter().map(of_mean).collect(), peak }
    };
    let mut twin = Twin { width: params.width, height: params.height, layers: (0..10).map(layer).collect() };
    particles::add(&scenery, &mut twin, camera, params, scenery.particles);
    twin
}

impl<'a> Scenery<'a> {
    fn new(tracer: &'a Tracer<'a>, camera: &Camera, params: &TwinParams) -> Self {
        let scene = tracer.scene();
        let power = |t: TriangleId| {
            let material = scene.material_of(t);
            if material.emits() { scene.area(t) * material.emission.0.max_element() } else { 0.0 }
        };
        let all = (0..scene.triangles().len() as u32).map(TriangleId);
        let total: f64 = all.clone().map(|t| f64::from(power(t))).sum();
        let mut sum = 0.0;
        let emitters = all.clone().filter(|&t| power(t) > 0.0).map(|t| {
            sum += f64::from(power(t)) / total;
            (t, sum)
        });
        let emitters = emitters.collect();
        let density = all.map(|t| power(t) / total.max(1e-30) as f32 / scene.area(t)).collect();
        let particles = params.particles > 0 && matches!(camera.projection, Projection::Perspective { .. });
        Self { tracer, emitters, density, particles }
    }

    /// One path from the eye.
    fn path(&self, mut ray: Ray, random: &mut Random) -> Shares {
        let tracer = self.tracer;
        let mut shares = [DVec3::ZERO; 10];
        let mut media = MediumStack::AIR;
        let mut throughput = Vec3::ONE;
        let (mut way, mut bounces, mut seen) = (Way::default(), 0, 0);
        let mut met = false;
        // The last diffuse vertex and the density cosθ/π of the direction that left it.
        let (mut start, mut density_out) = (Vec3::ZERO, 0.0);
        for _ in 0..MAX_EVENTS {
            let Some(hit) = tracer.nearest(&ray, f32::INFINITY) else {
                let sky = tracer.scene().sky().map_or(Rgb::ZERO, |sky| sky.radiance(ray.direction).0);
                shares[seen + way.layer(bounces)] += (throughput * sky * self.n2(media)).as_dvec3();
                break;
            };
            let position = ray.origin + ray.direction * hit.t;
            let from = tracer.planes().of(hit.triangle);
            if !met && hit.back && tracer.is_culled_from_behind(hit.triangle) {
                ray = Ray { origin: position, from, ..ray };
                continue;
            }
            met = true;
            throughput *= tracer.media().transmittance(media.current(), hit.t);
            let surface = tracer.interact(ray.direction, &hit, media);

            // Emission that is met; where next-event estimation finds it too, each has its share.
            let mut emitted = self.emitted(&hit, &surface, ray.direction);
            if bounces == 0 {
                emitted += surface.shown.0;
            } else if seen == 0 && self.particles && !way.is_open() {
                emitted = Rgb::ZERO;
            } else if way.is_open() {
                let cos = ray.direction.dot(surface.geometric).abs();
                let towards = self.density[hit.triangle.index()] * position.distance_squared(start);
                emitted *= density_out * cos / (density_out * cos + towards).max(f32::MIN_POSITIVE);
            }
            shares[seen + way.layer(bounces)] += (throughput * emitted * self.n2(media)).as_dvec3();

            // One of: the diffuse side, its other side, the specular branches.
            let diffuse = surface.reflectance * surface.receives;
            let through = surface.transmittance * surface.receives;
            let weights =
                [diffuse, through].into_iter().chain(surface.branches().iter().map(|b| b.throughput));
            let Some((choice, probability)) = choose(weights.map(|w| (throughput * w).max_element()), random)
            else {
                break;
            };
            throughput /= probability;
            if let Some(branch) = choice.checked_sub(2).map(|i| surface.branches()[i]) {
                throughput *= branch.throughput;
                media = branch.media;
                ray = Ray { origin: position, direction: branch.direction, from };
                way.add(branch.event);
            } else {
                bounces += 1;
                let other = choice == 1;
                throughput *= if other { through } else { diffuse };
                let vertex = Vertex::new(tracer, &hit, &surface, position, other);
                let layer = seen + if bounces == 1 { DIRECT } else { INDIRECT };
                let light = self.next_event(&vertex, media, random) + self.punctual(&vertex, media);
                shares[layer] += (throughput * light * self.n2(media)).as_dvec3();
                let direction = random.cosine(vertex.normal);
                if direction.dot(vertex.geometric) <= 0.0 {
                    break;
                }
                let cos = direction.dot(vertex.normal);
                throughput *= vertex.transmittance(cos);
                (start, density_out) = (position, cos / PI);
                way = Way::default();
                ray = Ray { origin: position, direction, from };
            }
            if bounces == 0 && !way.is_empty() {
                seen = SPECULAR;
            }

            // Unbiased roulette.
            let survival = throughput.max_element().min(1.0);
            if survival < 0.2 {
                if random.next() * 0.2 >= survival {
                    break;
                }
                throughput *= 0.2 / survival;
            }
        }
        shares
    }

    /// Radiance that a surface emits against `direction`: Φ·S(θ)/(A·cosθ) with S = (n+1)/2π · cosⁿθ.
    fn emitted(&self, hit: &Hit, surface: &Interaction, direction: Vec3) -> Vec3 {
        let scene = self.tracer.scene();
        let material = scene.material_of(hit.triangle);
        let n = material.lobe.exponent();
        if n == 1.0 || surface.emission.0 == Rgb::ZERO {
            return surface.emission.0;
        }
        let point = scene.surface_point(hit.triangle, hit.at);
        let power_per_area = point.emission.0 * (point.opacity * PI);
        let cos = direction.dot(scene.geometric_normal(hit.triangle)).abs().max(1e-4);
        power_per_area * ((n + 1.0) / (2.0 * PI) * libm::powf(cos, n) / cos)
    }

    /// (n_eye/n_here)², the eye in air.
    pub(crate) fn n2(&self, media: MediumStack) -> f32 {
        1.0 / self.tracer.media().ior(media.current()).powi(2)
    }

    /// An emitting triangle and its probability per area.
    pub(crate) fn pick(&self, random: &mut Random) -> Option<(TriangleId, f32)> {
        let pick = f64::from(random.next());
        let index = self.emitters.partition_point(|e| e.1 <= pick).min(self.emitters.len().saturating_sub(1));
        self.emitters.get(index).map(|&(triangle, _)| (triangle, self.density[triangle.index()]))
    }

    /// H_T/π at a vertex by a point on an emitter, with its share of the balance heuristic.
    fn next_event(&self, vertex: &Vertex, media: MediumStack, random: &mut Random) -> Vec3 {
        let Some((triangle, density)) = self.pick(random) else { return Vec3::ZERO };
        let root = random.next().sqrt();
        let at = Barycentric { u: root * random.next(), v: 1.0 - root };
        let offset = self.tracer.scene().position(triangle, at) - vertex.position;
        let (direction, distance2) = (offset.normalize_or_zero(), offset.length_squared());
        let cos = vertex.cos(direction);
        let cos_light = direction.dot(self.tracer.scene().geometric_normal(triangle)).abs();
        if cos <= 0.0 || cos_light <= 0.0 {
            return Vec3::ZERO;
        }
        let radiance = self.straight(vertex.ray(direction), media, offset.length(), Some(triangle));
        // Densities per solid angle, both times cosθ of the light.
        let towards = density * distance2;
        let by_cosine = cos / PI * cos_light;
        radiance * (vertex.transmittance(cos) * cos / PI * cos_light / (towards + by_cosine))
    }

    /// H_T/π at a vertex by punctual lights.
    fn punctual(&self, vertex: &Vertex, media: MediumStack) -> Vec3 {
        let lit = |light: &PunctualLight| {
            let (direction, distance) = match light.kind {
                PunctualKind::Directional => (-light.direction, f32::INFINITY),
                _ => (
                    (light.position - vertex.position).normalize_or_zero(),
                    light.position.distance(vertex.position),
                ),
            };
            let cos = vertex.cos(direction);
            if cos <= 0.0 {
                return Vec3::ZERO;
            }
            let falloff = if distance.is_finite() { 1.0 / (distance * distance) } else { 1.0 };
            let share = self.straight(vertex.ray(direction), media, distance, None);
            light.intensity_towards(-direction) * share * (vertex.transmittance(cos) * cos * falloff / PI)
        };
        self.tracer.scene().lights().iter().map(lit).sum()
    }

    /// Follows undeviated branches: to the emission of `target`, or (without one) to `distance`, where 1 arrives.
    pub(crate) fn straight(
        &self,
        mut ray: Ray,
        media: MediumStack,
        distance: f32,
        target: Option<TriangleId>,
    ) -> Vec3 {
        let mut share = Vec3::ONE;
        let mut left = distance;
        for _ in 0..MAX_EVENTS {
            let Some(hit) = self.tracer.nearest(&ray, f32::INFINITY) else {
                return if target.is_none() { share } else { Vec3::ZERO };
            };
            share *= self.tracer.media().transmittance(media.current(), hit.t.min(left));
            if target.is_none() && hit.t >= left {
                return share;
            }
            let surface = self.tracer.interact(ray.direction, &hit, media);
            if target == Some(hit.triangle) {
                return share * self.emitted(&hit, &surface, ray.direction);
            }
            left -= hit.t;
            let passing = surface.branches().iter().filter(|b| b.event == Event::Undeviated);
            share *= passing.map(|b| b.throughput).sum::<Vec3>();
            if share.max_element() <= 0.0 {
                return Vec3::ZERO;
            }
            let from = self.tracer.planes().of(hit.triangle);
            ray = Ray { origin: ray.origin + ray.direction * hit.t, from, ..ray };
        }
        Vec3::ZERO
    }
}
