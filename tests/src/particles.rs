//! Light tracing for what the slow twin cannot find from the eye: LS⁺D… of punctual lights.
//!
//! Particles leave the light, take one branch at each event, and at each diffuse vertex are connected with the pinhole
//! (Dutré 1993): a pixel of area A on the film at distance 1 gets Φ·f·cosθ/(d²·cos³θ_film·A). With interpolated normals
//! power is weighed as in Veach 1997, §5.3. Paths to the first diffuse vertex without S⁺ are left to shadow rays.

use std::f32::consts::PI;

use catoptric_scene::light::{PunctualKind, PunctualLight};
use catoptric_scene::{Camera, Projection};
use catoptric_trace::{MediumStack, Ray};
use glam::{DVec3, Vec3};

use crate::twin::{MAX_EVENTS, Random, SPECULAR, Scenery, Twin, TwinParams, Vertex, Way, choose};

/// LS⁺D… of punctual lights, by particles.
pub(crate) fn add(scenery: &Scenery, twin: &mut Twin, camera: &Camera, params: &TwinParams) {
    let Projection::Perspective { yfov } = camera.projection else { return };
    let tan = f64::from(libm::tanf(0.5 * yfov));
    let (width, height) = (params.width as f64, params.height as f64);
    // Area of a pixel on the film at distance 1.
    let film = (2.0 * tan / height).powi(2);
    let eye = Vec3::from(camera.world_from_camera.translation);
    let view_from_world = camera.world_from_camera.inverse();
    let count = f64::from(params.particles);
    for (index, light) in scenery.tracer.scene().lights().iter().enumerate() {
        let mut sums = vec![[(DVec3::ZERO, DVec3::ZERO); 10]; params.width * params.height];
        let mut peaks = [DVec3::ZERO; 10];
        let mut random = Random(params.seed ^ 0xabcd_0000_0000 ^ index as u64);
        for _ in 0..params.particles {
            particle(scenery, light, &mut random, |vertex, power, layer, media| {
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
                let leaves = vertex.transmittance(vertex.cos(direction));
                let weight = f64::from(cos * leaves * scenery.n2(media) / PI / offset.length_squared())
                    / ((-in_view.z).powi(3) * film);
                let value = (power * share).as_dvec3() * weight;
                let sum = &mut sums[row as usize * params.width + column as usize][seen + layer];
                *sum = (sum.0 + value, sum.1 + value * value);
                peaks[seen + layer] = peaks[seen + layer].max(value / count);
            });
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

/// One particle; `deposit` gets each diffuse vertex of a path that began with S⁺, what leaves it and the layer.
fn particle(
    scenery: &Scenery,
    light: &PunctualLight,
    random: &mut Random,
    mut deposit: impl FnMut(&Vertex, Vec3, usize, MediumStack),
) {
    let (tracer, mut media) = (scenery.tracer, MediumStack::AIR);
    let min_cos = match light.kind {
        PunctualKind::Spot { cos_outer, .. } => cos_outer,
        _ => -1.0,
    };
    let (mut ray, mut power) = if light.kind == PunctualKind::Directional {
        let radius = 0.5 * tracer.diagonal();
        let across = random.cosine(light.direction);
        let disk = (across - light.direction * across.dot(light.direction)) * radius;
        let origin = tracer.center() + disk - light.direction * (2.0 * radius);
        (Ray::free(origin, light.direction), light.intensity * (PI * radius * radius))
    } else {
        let axis = if min_cos > -1.0 { light.direction } else { Vec3::Y };
        let direction = random.in_cap(axis, min_cos);
        let solid_angle = 2.0 * PI * (1.0 - min_cos);
        (Ray::free(light.position, direction), light.intensity_towards(direction) * solid_angle)
    };
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
        let ends = bounces == 0 && way.is_straight();
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
