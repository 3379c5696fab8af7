//! What lies in an emitter's plane: on it, and places of its own.

use catoptric_light::contour::{self, Polygon};
use catoptric_light::irradiance::Scratch;
use catoptric_light::{LightParams, Lights, Receiver};
use catoptric_scene::{
    Barycentric, Material, MaterialId, Radiance, Rgb, Scene, SceneParts, Side, TriangleId,
};
use catoptric_trace::sequence::{Key, Purpose};
use catoptric_trace::{PlaneId, Tracer};
use glam::Vec3;

/// Corner and edges of what shines down and of what lies on it, as large or larger in one direction.
const LAMP: [Vec3; 3] = [Vec3::new(-0.4, 2.0, -0.3), Vec3::new(0.9, 0.0, 0.0), Vec3::new(0.0, 0.0, 0.7)];
const COVER: [Vec3; 3] = [Vec3::new(-0.1, 2.0, -0.5), Vec3::new(0.3, 0.0, 0.0), Vec3::new(0.0, 0.0, 0.6)];

/// Irradiance by a quadrilateral of unit radiance that nothing blocks.
fn sent(receiver: &Receiver, [corner, u, v]: [Vec3; 3]) -> f32 {
    let corners = [corner, corner + u, corner + u + v, corner + v].map(|c| c.as_dvec3());
    let (position, normal) = (receiver.position.as_dvec3(), receiver.normal.as_dvec3());
    contour::irradiance(position, normal, &Polygon::new(&corners)) as f32
}

/// What of the cover lies on the lamp.
fn both() -> [Vec3; 3] {
    let low = LAMP[0].max(COVER[0]);
    let high = (LAMP[0] + LAMP[1] + LAMP[2]).min(COVER[0] + COVER[1] + COVER[2]);
    [low, Vec3::X * (high.x - low.x), Vec3::Z * (high.z - low.z)]
}

/// The eye meets the smaller on the larger: a card, a mirror or another lamp on a lamp. Receivers get the light that it sees, and none of what
/// is covered; whether the lamp is a sheet or a side of a box.
#[test]
fn an_emitter_sends_nothing_from_where_something_lies_on_it() {
    const SAMPLES: u32 = 4096;
    let glowing = |parts: &mut SceneParts, radiance: f32| {
        parts.add_material(Material::emitter("glowing", Radiance(Rgb::splat(radiance))))
    };
    type Kind = fn(&mut SceneParts) -> MaterialId;
    let kinds: [(&str, f32, Kind); 3] = [
        ("card", 0.0, |parts| parts.add_material(Material::lambertian("card", Rgb::splat(0.5)))),
        ("mirror", 0.0, |parts| parts.add_material(Material::mirror("mirror", Rgb::splat(0.9)))),
        ("lamp", 5.0, |parts| parts.add_material(Material::emitter("bright", Radiance(Rgb::splat(5.0))))),
    ];
    for (name, radiance, kind) in kinds {
        for is_box in [false, true] {
            let mut parts = SceneParts::default();
            let (lamp, cover) = (glowing(&mut parts, 1.0), kind(&mut parts));
            if is_box {
                let high = LAMP[0] + LAMP[1] + LAMP[2] + Vec3::Y * 0.2;
                parts.add_box("lamp", lamp, LAMP[0], high, false);
            } else {
                parts.add_quad("lamp", lamp, LAMP[0], LAMP[1], LAMP[2]);
            }
            parts.add_quad("cover", cover, COVER[0], COVER[1], COVER[2]);
            let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
            parts.add_quad("floor", white, Vec3::new(-9.0, 0.0, -9.0), Vec3::Z * 18.0, Vec3::X * 18.0);
            let scene = Scene::new(parts).expect("a valid scene");
            let tracer = Tracer::new(&scene);
            let lights = Lights::new(&tracer, LightParams::default());
            let last = TriangleId(scene.triangles().len() as u32 - 1);
            let on = Receiver::on(&tracer, last, Side::Front, Barycentric { u: 0.3, v: 0.3 });
            let mut scratch = Scratch::default();
            for index in 0..20 {
                let key = Key::new(8, Purpose::Test, index);
                // Below it: the sides of a box are not seen.
                let place = key.point2(0) * 0.6 - 0.3;
                let receiver =
                    Receiver { position: Vec3::new(place.x, 0.0, place.y), plane: PlaneId::NONE, ..on };
                let found = lights.direct(&receiver, SAMPLES, key.child(1), &mut scratch).irradiance.x;
                let open = sent(&receiver, LAMP);
                let expected = open - sent(&receiver, both()) + radiance * sent(&receiver, COVER);
                // The cover's outline crosses at most four strata for each of the 64 rows; within them samples are as good as random, of
                // halves: 1/2 · √(4 · 64) / 4096 of the light. Three times that.
                let noise = 0.5 * 256_f32.sqrt() / SAMPLES as f32;
                assert!(
                    (found - expected).abs() < 3.0 * noise * open,
                    "{name}, box: {is_box}, {index}: {found}, expected {expected}"
                );
            }
        }
    }
}

/// Of a sheet that shines on both sides, whichever way it is turned, neither side lights the other, though by rounding places of it lie before
/// its plane or behind.
#[test]
fn a_sheet_that_shines_on_both_sides_does_not_light_itself() {
    let mut scratch = Scratch::default();
    for turn in 0..40 {
        let key = Key::new(9, Purpose::Test, turn);
        let [a, b] = [key.point2(0), key.point2(1)].map(|p| p * 2.0 - 1.0);
        let (u, v) = (Vec3::new(a.x, a.y, b.x), Vec3::new(b.y, a.x - b.x, 0.3 - a.y));
        let mut parts = SceneParts::default();
        let glowing = Material { double_sided: true, ..Material::emitter("glowing", Radiance(Rgb::ONE)) };
        let glowing = parts.add_material(glowing);
        parts.add_quad("sheet", glowing, Vec3::new(0.1, -0.7, 0.4), u, v);
        let scene = Scene::new(parts).expect("a valid scene");
        let tracer = Tracer::new(&scene);
        let lights = Lights::new(&tracer, LightParams::default());
        for index in 0..20 {
            let at = Barycentric { u: 0.04 * index as f32, v: 0.2 };
            for side in [Side::Front, Side::Back] {
                let receiver = Receiver::on(&tracer, TriangleId(index % 2), side, at);
                let found = lights.direct(&receiver, 64, key.child(index), &mut scratch);
                assert_eq!(found.irradiance, Rgb::ZERO, "{turn}, {index}, {side:?}");
            }
        }
    }
}
