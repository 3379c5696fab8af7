//! Shadows that are cut out of sources, against their brute force.

use catoptric_light::irradiance::Scratch;
use catoptric_light::{LightParams, Lights, Receiver};
use catoptric_scene::{
    AlphaMode, Barycentric, Material, MaterialId, Radiance, Rgb, Scene, SceneParts, Side, TriangleId,
};
use catoptric_trace::sequence::{Key, Purpose};
use catoptric_trace::{PlaneId, Tracer};
use glam::Vec3;

fn point(key: Key, index: u32) -> Vec3 {
    let [a, b] = [key.point2(index), key.child(1).point2(index)];
    Vec3::new(a.x, a.y, b.x) * 2.0 - 1.0
}

/// Corner and edges of the emitter, which shines downwards.
const EMITTER: [Vec3; 3] = [Vec3::new(-0.4, 2.0, -0.3), Vec3::new(0.9, 0.0, 0.0), Vec3::new(0.0, 0.0, 0.7)];

/// An emitter over a few boxes and cards, some of which reach through its plane; the last triangles are receivers' scrap.
fn scene(case: u64, card: Material, more: impl Fn(&mut SceneParts)) -> Scene {
    let key = Key::new(3, Purpose::Test, case);
    let mut parts = SceneParts::default();
    let glowing = parts.add_material(Material::emitter("glowing", Radiance(Rgb::ONE)));
    let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
    let card = parts.add_material(card);
    let [corner, u, v] = EMITTER;
    parts.add_quad("emitter", glowing, corner, u, v);
    for index in 0..2 {
        let low = point(key, index) * Vec3::new(0.6, 0.5, 0.6) + Vec3::Y;
        let size = Vec3::splat(0.15) + point(key.child(2), index).abs() * Vec3::new(0.3, 0.5, 0.3);
        parts.add_box("block", white, low, low + size, false);
        let at = point(key.child(3), index) * Vec3::new(0.6, 0.4, 0.6) + Vec3::Y * 1.2;
        let [u, v] = [4, 5].map(|k| point(key.child(k), index) * 0.4);
        parts.add_quad("card", card, at, u, v);
    }
    more(&mut parts);
    parts.add_quad("scrap", white, Vec3::Y * -50.0, Vec3::Z, Vec3::X);
    Scene::new(parts).expect("a valid scene")
}

fn receiver(tracer: &Tracer, key: Key) -> Receiver {
    let last = TriangleId(tracer.scene().triangles().len() as u32 - 1);
    let on = Receiver::on(tracer, last, Side::Front, Barycentric { u: 0.3, v: 0.3 });
    let position = point(key, 0) * Vec3::new(1.0, 0.3, 1.0);
    let geometric = (point(key, 1) * 0.8 + Vec3::Y).normalize_or(Vec3::Y);
    let normal = (geometric + point(key, 2) * 0.2).normalize_or(Vec3::Y);
    Receiver { position, plane: PlaneId::NONE, normal, geometric, ..on }
}

/// Points of the emitter in each direction, for the brute force.
const GRID: u32 = 48;

/// Irradiance by midpoints of a grid on the emitter; `seen` is what of the light of a point arrives.
fn by_grid(receiver: &Receiver, seen: impl Fn(Vec3) -> (Rgb, Vec3)) -> f64 {
    let [corner, u, v] = EMITTER;
    let area = f64::from(u.cross(v).length()) / f64::from(GRID * GRID);
    let mut sum = 0.0;
    for i in 0..GRID * GRID {
        let [s, t] = [i % GRID, i / GRID].map(|k| (k as f32 + 0.5) / GRID as f32);
        let (share, image) = seen(corner + u * s + v * t);
        let (offset, facing) = (image - receiver.position, (image.y - receiver.position.y).abs());
        let r2 = f64::from(offset.length_squared());
        let cos = receiver.normal.dot(offset).max(0.0);
        if receiver.geometric.dot(offset) > 0.0 {
            sum += f64::from(share.x * cos * facing) / (r2 * r2) * area;
        }
    }
    sum
}

/// Means and deviations over receivers of what is asked less the brute force, relative to the light that nothing blocks.
#[derive(Default)]
struct Differences {
    count: u32,
    partial: u32,
    rayless: u32,
    sum: f64,
    largest: f64,
}

impl Differences {
    fn add(&mut self, found: f64, expected: f64, open: f64, rays: u64) {
        // A thousandth of what arrives where the emitter is faced: of those samples that find what a mirror takes, none may lie
        // above the horizon of the shading normal.
        if open <= 1e-4 {
            return;
        }
        let difference = (found - expected) / open;
        self.count += 1;
        self.partial += u32::from(found > 0.02 * open && found < 0.98 * open);
        self.rayless += u32::from(rays == 0);
        self.sum += difference;
        self.largest = self.largest.max(difference.abs());
    }

    /// A straight shadow edge is off by half a cell at most in each of the rows that it crosses, and a third of that on the whole: 12
    /// edges come to 12/GRID/3 of the light if all err to one side. On average they err to neither: n receivers' mean is n^-½ of
    /// that.
    fn check(&self, name: &str) {
        let largest = 12.0 / f64::from(GRID) / 3.0;
        assert!(
            self.count > 300 && self.partial > self.count / 5,
            "{name}: {} of {}",
            self.partial,
            self.count
        );
        assert!(self.largest < largest, "{name}: {}", self.largest);
        let mean = self.sum / f64::from(self.count);
        assert!(mean.abs() < largest / f64::from(self.count).sqrt(), "{name}: {mean}");
    }
}

fn white_card() -> Material {
    Material::lambertian("card", Rgb::splat(0.5))
}

#[test]
fn light_behind_blockers_is_exact_and_takes_no_rays() {
    let mut differences = Differences::default();
    for case in 0..40 {
        let scene = scene(case, white_card(), |_| {});
        let tracer = Tracer::new(&scene);
        let lights = Lights::new(&tracer, LightParams::default());
        for index in 0..12 {
            let key = Key::new(5, Purpose::Test, case * 100 + index);
            let receiver = receiver(&tracer, key);
            let mut scratch = Scratch::default();
            let found = lights.direct(&receiver, 32, key, &mut scratch);
            let expected = by_grid(&receiver, |p| {
                (
                    tracer.visibility(
                        receiver.position,
                        PlaneId::NONE,
                        p,
                        lights.emitters().cells()[0].plane,
                    ),
                    p,
                )
            });
            differences.add(
                f64::from(found.irradiance.x),
                expected,
                f64::from(found.unoccluded.x),
                scratch.rays,
            );
        }
    }
    differences.check("direct");
    assert_eq!(differences.rayless, differences.count);
}

/// What lets light pass is no blocker: a few rays find what it takes.
#[test]
fn panes_before_a_source_thin_its_light_where_it_is_seen() {
    let pane = Material { alpha_mode: AlphaMode::Blend, base_alpha: 0.3, ..white_card() };
    let mut differences = Differences::default();
    for case in 0..40 {
        let scene = scene(case, pane.clone(), |_| {});
        let tracer = Tracer::new(&scene);
        let lights = Lights::new(&tracer, LightParams::default());
        for index in 0..12 {
            let key = Key::new(6, Purpose::Test, case * 100 + index);
            let receiver = receiver(&tracer, key);
            let mut scratch = Scratch::default();
            // As many samples of the panes as need be.
            let found: f64 = (0..64)
                .map(|k| f64::from(lights.direct(&receiver, 32, key.child(k), &mut scratch).irradiance.x))
                .sum();
            let open = f64::from(lights.direct(&receiver, 32, key, &mut scratch).unoccluded.x);
            let plane = lights.emitters().cells()[0].plane;
            let expected =
                by_grid(&receiver, |p| (tracer.visibility(receiver.position, PlaneId::NONE, p, plane), p));
            differences.add(found / 64.0, expected, open, scratch.rays);
        }
    }
    differences.check("panes");
    assert!(differences.rayless < differences.count);
}

/// Blockers between receiver and mirror, and between mirror and source.
#[test]
fn light_over_a_mirror_is_exact_behind_blockers() {
    // A wall of silver at x = −1.2; its reflectance is 1 at every angle.
    let side = -1.2;
    let silver =
        |parts: &mut SceneParts| -> MaterialId { parts.add_material(Material::mirror("silver", Rgb::ONE)) };
    let mut differences = Differences::default();
    for case in 0..40 {
        let scene = scene(case, white_card(), |parts| {
            let silver = silver(parts);
            parts.add_quad("mirror", silver, Vec3::new(side, 0.2, 1.0), Vec3::Z * -2.0, Vec3::Y * 1.5);
        });
        let tracer = Tracer::new(&scene);
        let lights = Lights::new(&tracer, LightParams::default());
        assert_eq!(lights.chains().chains().len(), 1);
        let mirror = lights.chains().chains()[0].planes[0];
        let emitter = lights.emitters().cells()[0].plane;
        for index in 0..12 {
            let key = Key::new(7, Purpose::Test, case * 100 + index);
            let receiver = receiver(&tracer, key);
            let mut scratch = Scratch::default();
            let found = lights.mirrored(&receiver, 32, Rgb::ZERO, key, &mut scratch);
            let expected = by_grid(&receiver, |p| {
                let image = Vec3::new(2.0 * side - p.x, p.y, p.z);
                let t = (side - receiver.position.x) / (image.x - receiver.position.x);
                let at = receiver.position.lerp(image, t);
                let is_inside = (0.2..1.7).contains(&at.y) && at.z.abs() < 1.0;
                let free =
                    |from, leaving, to, arriving| tracer.visibility(from, leaving, to, arriving) == Rgb::ONE;
                let is_seen = is_inside
                    && free(receiver.position, PlaneId::NONE, at, mirror)
                    && free(at, mirror, p, emitter);
                (if is_seen { Rgb::ONE } else { Rgb::ZERO }, image)
            });
            differences.add(
                f64::from(found.irradiance.x),
                expected,
                f64::from(found.unoccluded.x),
                scratch.rays,
            );
        }
    }
    differences.check("mirrored");
}
