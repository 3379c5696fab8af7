//! Light of lamps, straight and over mirrors, in many random scenes on a grid, against rays of the hemisphere: things touch, stand on each other, lie
//! in one plane, and seams run through them, as where people build them.

use std::f32::consts::TAU;

use catoptric_light::irradiance::{Samples, Scratch};
use catoptric_light::{LightParams, Lights, Receiver};
use catoptric_scene::{
    Barycentric, Material, MaterialId, Radiance, Rgb, Scene, SceneParts, Side, Transmission, TriangleId,
};
use catoptric_trace::sequence::{Key, Purpose, cosine_hemisphere};
use catoptric_trace::{Event, MediumStack, PlaneId, Ray, Tracer};
use glam::Vec3;

/// Of the grid, metres.
const STEP: f32 = 0.25;
/// Half of what the floor measures.
const HALF: f32 = 2.0;
const RADIANCE: f32 = 10.0;

/// Random whole numbers.
struct Dice(Key, u32);

impl Dice {
    fn uniform(&mut self) -> f32 {
        self.1 += 1;
        self.0.uniform(self.1)
    }

    /// One of `from..=to`.
    fn pick(&mut self, from: u8, to: u8) -> u8 {
        from + (self.uniform() * f32::from(to - from + 1)) as u8
    }

    /// A point of the grid over the floor, `low` to `high` steps above it.
    fn place(&mut self, low: u8, high: u8) -> Vec3 {
        let [x, y, z] = [self.pick(0, 8), self.pick(low, high), self.pick(0, 8)].map(f32::from);
        Vec3::new(x - 4.0, y, z - 4.0) * STEP
    }

    /// So many steps along each axis.
    fn size(&mut self, most: u8) -> Vec3 {
        Vec3::new(self.pick(1, most).into(), self.pick(1, most).into(), self.pick(1, most).into()) * STEP
    }

    /// A rectangle across an axis that begins at any of its corners and looks to either side.
    fn add_sheet(&mut self, parts: &mut SceneParts, name: &str, material: MaterialId) {
        let (corner, size) = (self.place(1, 8), self.size(5));
        let axes = [Vec3::X * size.x, Vec3::Y * size.y, Vec3::Z * size.z];
        let across = usize::from(self.pick(0, 2));
        let (mut u, mut v) = (axes[(across + 1) % 3], axes[(across + 2) % 3]);
        if self.pick(0, 1) == 1 {
            std::mem::swap(&mut u, &mut v);
        }
        let (corner, u, v) = match self.pick(0, 3) {
            0 => (corner, u, v),
            1 => (corner + u, v, -u),
            2 => (corner + u + v, -u, -v),
            _ => (corner + v, -v, u),
        };
        parts.add_quad(name, material, corner, u, v);
    }

    fn add_box(&mut self, parts: &mut SceneParts, name: &str, material: MaterialId) {
        let (low, size) = (self.place(0, 7), self.size(3));
        parts.add_box(name, material, low, low + size, false);
    }

    /// A disc or a tube, which may be open, about an axis.
    fn add_tube(&mut self, parts: &mut SceneParts, name: &str, material: MaterialId) {
        let axes = [Vec3::X, Vec3::Y, Vec3::Z];
        let along = usize::from(self.pick(0, 2));
        let (u, v) = (axes[(along + 1) % 3], axes[(along + 2) % 3]);
        let count = [3, 4, 6, 12, 24][usize::from(self.pick(0, 4))];
        let (center, radius) = (self.place(3, 7), 0.5 * STEP * f32::from(self.pick(1, 3)));
        let length = axes[along] * (STEP * f32::from(self.pick(0, 4)));
        let on_ring = |k: u32| {
            let (sin, cos) = libm::sincosf(TAU * k as f32 / count as f32);
            center + (u * cos + v * sin) * radius
        };
        let mut positions: Vec<Vec3> = (0..count).map(on_ring).collect();
        let disc = (1..count - 1).map(|k| [0, k, k + 1]);
        let mut triangles: Vec<[u32; 3]> = Vec::new();
        if length == Vec3::ZERO {
            triangles.extend(disc);
        } else {
            positions.extend((0..count).map(|k| on_ring(k) + length));
            for (k, next) in (0..count).map(|k| (k, (k + 1) % count)) {
                triangles.extend([[k, next, count + next], [k, count + next, count + k]]);
            }
            if self.pick(0, 1) == 1 {
                triangles.extend(disc.flat_map(|[a, b, c]| [[a, c, b], [count + a, count + b, count + c]]));
            }
        }
        parts.add_triangles(name, material, &positions, &triangles);
    }
}

/// Mirrors, cards, panes and blocks, one or two lamps of any shape, and a floor, whose triangles come last.
fn scene(case: u64) -> Scene {
    let mut dice = Dice(Key::new(11, Purpose::Test, case), 0);
    let mut parts = SceneParts::default();
    let mirror = Material::mirror("mirror", Rgb::splat(0.9));
    let sheet = parts.add_material(Material { double_sided: true, ..mirror.clone() });
    let [mirror, white, pane, lamp] = [
        mirror,
        Material::lambertian("white", Rgb::splat(0.5)),
        Material { transmission_kind: Transmission::Pane, ..Material::glass("pane", 1.5) },
        Material::emitter("lamp", Radiance(Rgb::splat(RADIANCE))),
    ]
    .map(|material| parts.add_material(material));
    for _ in 0..dice.pick(2, 4) {
        let material = if dice.pick(0, 2) == 0 { sheet } else { mirror };
        dice.add_sheet(&mut parts, "mirror", material);
    }
    for _ in 0..dice.pick(0, 4) {
        match dice.pick(0, 5) {
            0 => dice.add_sheet(&mut parts, "pane", pane),
            1 => dice.add_box(&mut parts, "block", mirror),
            2 | 3 => dice.add_box(&mut parts, "block", white),
            _ => dice.add_sheet(&mut parts, "card", white),
        }
    }
    for _ in 0..dice.pick(1, 2) {
        match dice.pick(0, 3) {
            0 => dice.add_box(&mut parts, "lamp", lamp),
            1 => dice.add_tube(&mut parts, "lamp", lamp),
            2 => parts.add_sphere("lamp", lamp, dice.place(4, 7), 0.5 * STEP, 16),
            _ => dice.add_sheet(&mut parts, "lamp", lamp),
        }
    }
    let corner = Vec3::new(-HALF, 0.0, -HALF);
    parts.add_quad("floor", white, corner, Vec3::Z * 2.0 * HALF, Vec3::X * 2.0 * HALF);
    Scene::new(parts).expect("a valid scene")
}

/// Follows what goes straight on and what planar mirrors and panes reflect; `visit` gets what lamps send back along the ray, and over which planes.
fn follow(
    lights: &Lights,
    ray: &Ray,
    throughput: f32,
    planes: &mut Vec<PlaneId>,
    room: u32,
    visit: &mut impl FnMut(f32, &[PlaneId]),
) {
    let tracer = lights.tracer();
    let Some(hit) = tracer.nearest(ray, f32::INFINITY).filter(|_| room > 0) else { return };
    let interaction = tracer.interact(ray.direction, &hit, MediumStack::AIR);
    // Whole walls are found by hemisphere rays, not as sources.
    if !lights.emitters().is_broad(hit.triangle) {
        visit(throughput * interaction.emission.0.x, planes);
    }
    for branch in interaction.branches() {
        let from = match branch.event {
            Event::Planar(plane) => plane,
            Event::Undeviated => tracer.planes().of(hit.triangle),
            _ => continue,
        };
        let is_reflected = branch.event != Event::Undeviated;
        if is_reflected {
            planes.push(from);
        }
        let origin = ray.origin + ray.direction * hit.t;
        let next = Ray { origin, direction: branch.direction, from };
        follow(lights, &next, throughput * branch.throughput.x, planes, room - 1, visit);
        if is_reflected {
            planes.pop();
        }
    }
}

/// Straight, and over the chains of mirrors that have images.
fn by_hemisphere(lights: &Lights, receiver: &Receiver, key: Key, rays: u32) -> [f64; 2] {
    let mut sums = [0.0; 2];
    let mut planes = Vec::new();
    let weight = std::f64::consts::PI / f64::from(rays);
    for index in 0..rays {
        let local = cosine_hemisphere(key.point2(index));
        let direction = Vec3::new(local.x, local.z, local.y);
        let ray = Ray { origin: receiver.position, direction, from: receiver.plane };
        follow(lights, &ray, 1.0, &mut planes, 12, &mut |found, planes| {
            let is_straight = planes.is_empty();
            if is_straight || lights.chains().contains(planes) {
                sums[usize::from(!is_straight)] += f64::from(found) * weight;
            }
        });
    }
    sums
}

#[test]
fn lamps_on_a_grid_send_what_rays_of_the_hemisphere_find() {
    const RAYS: u32 = 1 << 15;
    const SAMPLES: u32 = 1024;
    let mut scratch = Scratch::default();
    let (mut lit, mut mirrored) = (0, 0);
    for case in 0..400 {
        let scene = scene(case);
        let tracer = Tracer::new(&scene);
        let lights = Lights::new(&tracer, LightParams::default());
        let last = TriangleId(scene.triangles().len() as u32 - 1);
        let on = Receiver::on(&tracer, last, Side::Front, Barycentric { u: 0.3, v: 0.3 });
        for index in 0..3 {
            let key = Key::new(12, Purpose::Test, case * 10 + index);
            let place = key.point2(0) * 3.0 - 1.5;
            // One of them is on the grid, too.
            let place = if index == 0 { (place / STEP).round() * STEP } else { place };
            let receiver = Receiver { position: Vec3::new(place.x, 0.0, place.y), ..on };
            let samples = Samples::exact(SAMPLES);
            let direct = lights.direct(&receiver, samples, key.child(1), &mut scratch).irradiance.x;
            let over =
                lights.mirrored(&receiver, samples, Rgb::ZERO, key.child(2), &mut scratch).irradiance.x;
            let sums = by_hemisphere(&lights, &receiver, key.child(3), RAYS);
            let all = f64::from(direct + over);
            for (name, found, sum) in [("direct", direct, sums[0]), ("mirrored", over, sums[1])] {
                // A ray brings at most so much, and independent ones deviate by no more than the root of that times the sum; stratified ones are
                // better. Five times that: none of 2400 is off by as much by chance. Sources that send little get few samples: 1 % of all.
                let ray = f64::from(RADIANCE) * std::f64::consts::PI / f64::from(RAYS);
                let error = 5.0 * (ray * sum.max(f64::from(found))).sqrt() + 0.01 * all;
                let difference = f64::from(found) - sum;
                assert!(
                    difference.abs() <= error,
                    "{name}, scene {case} at {}: {found}, by rays {}",
                    receiver.position,
                    sum
                );
            }
            lit += u32::from(sums[0] > 0.0);
            mirrored += u32::from(sums[1] > 0.0);
        }
    }
    assert!(lit > 600 && mirrored > 200, "{lit} places of 1200 are lit, {mirrored} over mirrors");
}
