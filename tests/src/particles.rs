//! Light tracing for what the slow twin hardly finds from the eye: LS⁺D… of area and punctual lights.
//!
//! Particles leave the light, take one branch at each event, and at each diffuse vertex are connected with the pinhole
//! (Dutré 1993): a pixel of area A on the film at distance 1 gets Φ·f·cosθ/(d²·cos³θ_film·A). With interpolated normals
//! power is weighed as in Veach 1997, §5.3. Paths to the first diffuse vertex without S⁺ are left to the eye.

use std::f32::consts::PI;

use catoptric_scene::light::{PunctualKind, PunctualLight};
use catoptric_scene::{Barycentric, Camera, Projection, Transmission};
use catoptric_trace::{MediumId, MediumStack, Ray};
use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::path::{Random, SPECULAR, Vertex, Way, choose};
use crate::twin::{MAX_EVENTS, Scenery, Twin, TwinParams};

/// Particles are traced in this many batches, each with its own numbers.
const BATCHES: u32 = 16;

/// Sums and sums of squares, per pixel and layer, and the largest term per layer.
type Sums = (Vec<[(DVec3, DVec3); 10]>, [DVec3; 10]);

/// Adds what particles find: LS⁺D… of punctual and (if `area`) area lights.
pub(crate) fn add(scenery: &Scenery, twin: &mut Twin, camera: &Camera, params: &TwinParams, area: bool) {
    let Projection::Perspective { yfov } = camera.projection else { return };
    let tan = f64::from(libm::tanf(0.5 * yfov));
    let (width, height) = (params.width as f64, params.height as f64);
    // Area of a pixel on the film at distance 1.
    let film = (2.0 * tan / height).powi(2);
    let eye = Vec3::from(camera.world_from_camera.translation);
    let view_from_world = camera.world_from_camera.inverse();
    let per_batch = params.particles.div_ceil(BATCHES);
    let count = f64::from(per_batch * BATCHES);
    let lights = scenery.tracer.scene().lights().iter().map(Some).chain(area.then_some(None));
    for (index, light) in lights.enumerate() {
        let batch = |batch: u32| -> Sums {
            let mut sums = vec![[(DVec3::ZERO, DVec3::ZERO); 10]; params.width * params.height];
            let mut peaks = [DVec3::ZERO; 10];
            let mut random = Random(params.seed ^ (index as u64 + 1) << 40 ^ u64::from(batch) << 32);
            let deposit = |vertex: &Vertex, power: Vec3, layer: usize, media: MediumStack| {
                let offset = eye - vertex.position;
                let direction = offset.normalize_or_zero();
                let in_view = view_from_world.transform_vector3(-direction).as_dvec3();
                let (x, y) = (in_view.x / -in_view.z / tan, in_view.y / -in_view.z / tan);
                let column = (x * height / width + 1.0) * 0.5 * width;
                let row = (1.0 - y) * 0.5 * height;
                let inside = column >= 0.0 && column < width && row >= 0.0 && row < height;
                let cos = vertex.geometric.dot(direction);
                if in_view.z >= 0.0 || !inside || cos <= 0.0 {
                    return;
                }
                let share = scenery.straight(vertex.ray(direction), media, offset.length(), None);
                let seen = if share == Vec3::ONE { 0 } else { SPECULAR };
                // What area lights show through panes is found from the eye.
                if light.is_none() && seen == SPECULAR {
                    return;
                }
                let leaves = vertex.transmittance(vertex.cos(direction));
                let weight = f64::from(cos * leaves * scenery.n2(media) / PI / offset.length_squared())
                    / ((-in_view.z).powi(3) * film);
                let value = (power * share).as_dvec3() * weight;
                let sum = &mut sums[row as usize * params.width + column as usize][seen + layer];
                *sum = (sum.0 + value, sum.1 + value * value);
                peaks[seen + layer] = peaks[seen + layer].max(value / count);
            };
            batch_of(scenery, light, &mut random, per_batch, deposit);
            (sums, peaks)
        };
        let batches: Vec<Sums> = (0..BATCHES).into_par_iter().map(batch).collect();
        let (mut sums, mut peaks) =
            (vec![[(DVec3::ZERO, DVec3::ZERO); 10]; params.width * params.height], [DVec3::ZERO; 10]);
        for (batch, peak) in &batches {
            for (sum, add) in sums.iter_mut().flatten().zip(batch.iter().flatten()) {
                *sum = (sum.0 + add.0, sum.1 + add.1);
            }
            for (total, own) in peaks.iter_mut().zip(peak) {
                *total = total.max(*own);
            }
        }
        for (layer, target) in twin.layers.iter_mut().enumerate() {
            target.peak = target.peak.max(peaks[layer]);
            for (pixel, sum) in sums.iter().enumerate() {
                let (mean, square) = (sum[layer].0 / count, sum[layer].1 / count);
                target.mean[pixel] += mean;
                target.variance[pixel] += (square - mean * mean) / count;
            }
        }
    }
}

fn batch_of(
    scenery: &Scenery,
    light: Option<&PunctualLight>,
    random: &mut Random,
    count: u32,
    mut deposit: impl FnMut(&Vertex, Vec3, usize, MediumStack),
) {
    for _ in 0..count {
        let start = match light {
            Some(light) => Some(from_punctual(scenery, light, random)),
            None => from_area(scenery, random),
        };
        if let Some(start) = start {
            particle(scenery, start, random, &mut deposit);
        }
    }
}

/// Where a particle starts, its power and its media.
type Start = (Ray, Vec3, MediumStack);

fn from_punctual(scenery: &Scenery, light: &PunctualLight, random: &mut Random) -> Start {
    let tracer = scenery.tracer;
    if light.kind == PunctualKind::Directional {
        let radius = 0.5 * tracer.diagonal();
        let across = random.cosine(light.direction);
        let disk = (across - light.direction * across.dot(light.direction)) * radius;
        let origin = tracer.extent().all.center.as_vec3() + disk - light.direction * (2.0 * radius);
        let power = light.intensity * (PI * radius * radius);
        return (Ray::free(origin, light.direction), power, MediumStack::AIR);
    }
    let (axis, min_cos) = match light.kind {
        PunctualKind::Spot { cos_outer, .. } => (light.direction, cos_outer),
        _ => (Vec3::Y, -1.0),
    };
    let direction = random.in_cap(axis, min_cos);
    let power = light.intensity_towards(direction) * (2.0 * PI * (1.0 - min_cos));
    let ray = Ray::free(light.position, direction);
    (ray, power, media_at(scenery, ray))
}

fn from_area(scenery: &Scenery, random: &mut Random) -> Option<Start> {
    let (tracer, scene) = (scenery.tracer, scenery.tracer.scene());
    let (triangle, density) = scenery.pick(random)?;
    let root = random.next().sqrt();
    let at = Barycentric { u: root * random.next(), v: 1.0 - root };
    let both = tracer.has_back(triangle);
    let sign = if both && random.next() < 0.5 { -1.0 } else { 1.0 };
    // Directions have the density S(θ), so that every particle carries the same power.
    let axis = scene.geometric_normal(triangle) * sign;
    let lobe = scene.material_of(triangle).lobe.exponent();
    let direction = if lobe == 1.0 { random.cosine(axis) } else { random.lobe(axis, lobe) };
    let point = scene.surface_point(triangle, at);
    let sides = if both { 2.0 } else { 1.0 };
    let power = point.emission.0 * (point.opacity * PI * sides / density);
    let ray = Ray { origin: scene.position(triangle, at), direction, from: tracer.planes().of(triangle) };
    Some((ray, power, media_at(scenery, ray)))
}

/// The solids around the start of a ray: those whose back it meets before their front.
fn media_at(scenery: &Scenery, mut ray: Ray) -> MediumStack {
    let (tracer, scene) = (scenery.tracer, scenery.tracer.scene());
    let (mut inside, mut entered) = (Vec::new(), Vec::new());
    for _ in 0..MAX_EVENTS {
        let Some(hit) = tracer.nearest(&ray, f32::INFINITY) else { break };
        let material = scene.material_of(hit.triangle);
        if material.transmission > 0.0 && material.transmission_kind == Transmission::Solid {
            let medium = MediumId::inside(scene.material_id_of(hit.triangle));
            match entered.iter().rposition(|&m| m == medium) {
                _ if !hit.back => entered.push(medium),
                Some(index) => drop(entered.remove(index)),
                None => inside.push(medium),
            }
        }
        let from = tracer.planes().of(hit.triangle);
        ray = Ray { origin: ray.origin + ray.direction * hit.t, from, ..ray };
    }
    inside.iter().rev().fold(MediumStack::AIR, |stack, &medium| stack.entered(medium))
}

/// One particle; `deposit` gets each diffuse vertex of a path that began with S⁺, what
/// leaves it and the layer.
fn particle(
    scenery: &Scenery,
    (mut ray, mut power, mut media): Start,
    random: &mut Random,
    deposit: &mut impl FnMut(&Vertex, Vec3, usize, MediumStack),
) {
    let tracer = scenery.tracer;
    let strength = power.max_element();
    let (mut way, mut bounces) = (Way::default(), 0);
    for _ in 0..MAX_EVENTS {
        let Some(hit) = tracer.nearest(&ray, f32::INFINITY) else { return };
        let position = ray.origin + ray.direction * hit.t;
        power *= tracer.media().transmittance(media.current(), hit.t);
        let surface = tracer.interact(ray.direction, &hit, media);
        // Veach 1997, §5.3: with interpolated normals, power weighs |ω·n_s|/|ω·n_g| on arrival.
        let tilt = |d: Vec3| d.dot(surface.normal).abs() / d.dot(surface.geometric).abs().max(1e-6);
        let arrives = power * surface.receives * tilt(ray.direction);
        let (diffuse, through) = (arrives * surface.reflectance, arrives * surface.transmittance);
        let ends = bounces == 0 && way.is_open();
        let weights = [diffuse, through].into_iter().map(|w| if ends { Vec3::ZERO } else { w });
        let weights = weights.chain(surface.branches().iter().map(|b| power * b.throughput));
        let Some((choice, probability)) = choose(weights.map(|w| w.max_element()), random) else { return };
        let from = tracer.planes().of(hit.triangle);
        if let Some(branch) = choice.checked_sub(2).map(|i| surface.branches()[i]) {
            power *= branch.throughput * (tilt(ray.direction) / tilt(branch.direction) / probability);
            media = branch.media;
            ray = Ray { origin: position, direction: branch.direction, from };
            way.add(branch.event);
        } else {
            bounces += 1;
            let vertex = Vertex::new(tracer, &hit, &surface, position, choice == 1);
            power = if choice == 1 { through } else { diffuse } / probability;
            deposit(&vertex, power, way.layer(bounces), media);
            let direction = random.cosine(vertex.normal);
            let cos = direction.dot(vertex.normal);
            power *= vertex.transmittance(cos) / tilt(direction);
            if direction.dot(vertex.geometric) <= 0.0 {
                return;
            }
            ray = Ray { origin: position, direction, from };
        }
        let survival = power.max_element() / strength;
        if survival < 0.2 {
            if random.next() * 0.2 >= survival {
                return;
            }
            power *= 0.2 / survival;
        }
    }
}
