//! Random rooms as furnaces: whatever emits and reflects a half of what arrives, among mirrors and glass that lose nothing, is 1 wherever one looks. The
//! terms of the method add up to that only if each path of light belongs to one of them, and none is lost on the way.

use catoptric_radiosity::{SolveParams, solve};
use catoptric_render::{RenderParams, render};
use catoptric_scene::{Material, Radiance, Rgb, Scene, SceneParts, Silent, Transmission};
use catoptric_solution::Quality;
use catoptric_tests::looking;
use catoptric_trace::Tracer;
use catoptric_trace::sequence::{Key, Purpose};
use glam::Vec3;

/// Of the grid on which things stand, metres.
const STEP: f32 = 0.25;
const ROOM: Vec3 = Vec3::new(2.0, 2.0, 2.5);

/// A room with blocks and balls that touch it and each other, of walls, mirrors or glass, a pane, a mirror on a wall, and a sheet of two sides.
fn furnace(case: u64) -> Scene {
    let key = Key::new(4, Purpose::Test, case);
    let mut next = 0;
    let mut pick = |most: f32| {
        next += 1;
        (key.uniform(next) * (most + 1.0)).floor()
    };
    let mut parts = SceneParts::default();
    let glow = Material::emitter("glowing", Radiance(Rgb::splat(0.5)));
    let wall = Material { base_color: Rgb::splat(0.5), ..glow };
    let materials = [
        wall.clone(),
        Material::mirror("mirror", Rgb::ONE),
        Material::glass("glass", 1.5),
        Material { transmission_kind: Transmission::Pane, ..Material::glass("pane", 1.5) },
        Material { double_sided: true, ..wall },
    ];
    let [wall, mirror, glass, pane, sheet] = materials.map(|material| parts.add_material(material));
    parts.add_box("room", wall, Vec3::ZERO, ROOM, true);
    let mut taken: Vec<[Vec3; 2]> = Vec::new();
    for _ in 0..12 {
        let size = Vec3::new(1.0 + pick(2.0), 1.0 + pick(3.0), 1.0 + pick(2.0)) * STEP;
        let room = (ROOM - size) / STEP;
        // Most of them stand on the floor; the eye is in the corner that none reaches.
        let y = if pick(2.0) > 0.0 { 0.0 } else { pick(room.y) };
        let low = Vec3::new(pick(room.x - 3.0), y, pick(room.z - 3.0)) * STEP;
        let is_free = |[a, b]: &[Vec3; 2]| low.cmpge(*b).any() || (low + size).cmple(*a).any();
        if !taken.iter().all(is_free) {
            continue;
        }
        taken.push([low, low + size]);
        let material = [wall, wall, mirror, glass][pick(3.0) as usize];
        // What is of glass ends a little before what it stands beside: no surface is of two media.
        let gap = if material == glass { 0.004 } else { 0.0 };
        if pick(3.0) > 0.0 {
            parts.add_box("block", material, low + gap, low + size - gap, false);
        } else {
            let radius = 0.5 * size.min_element() - gap;
            parts.add_sphere("ball", material, low + 0.5 * size, radius, 24);
        }
    }
    let silver = Vec3::new(0.0, 0.5 + STEP * pick(2.0), 0.5);
    parts.add_quad("mirror", mirror, silver, Vec3::Y * 0.75, Vec3::Z * 1.25);
    parts.add_quad("pane", pane, Vec3::new(0.6, 0.3, 1.9), Vec3::new(0.6, 0.0, 0.2), Vec3::Y * 0.9);
    parts.add_quad("sheet", sheet, Vec3::new(1.3, 1.6, 0.4), Vec3::X * 0.4, Vec3::new(0.0, 0.2, 0.5));
    parts.cameras.push(looking(ROOM - 0.1, ROOM * Vec3::new(0.3, 0.3, 0.2), 1.3));
    Scene::new(parts).expect("the room is valid")
}

#[test]
fn all_that_one_sees_in_a_furnace_is_as_bright() {
    for case in 0..6 {
        let scene = furnace(case);
        let tracer = Tracer::new(&scene);
        let quality = Quality::Draft;
        let solved = solve(&tracer, &SolveParams::for_quality(quality), &Silent).expect("nobody stops it");
        let params = RenderParams::for_quality(quality, 96, 96);
        let camera = &scene.cameras()[0];
        let rendered = render(&tracer, &solved.solution, camera, &params, &Silent).expect("nobody stops it");
        let errors: Vec<f64> = rendered
            .image
            .channel("G")
            .expect("a colour")
            .iter()
            .map(|&value| f64::from(value) - 1.0)
            .collect();
        let count = errors.len() as f64;
        let mean = errors.iter().sum::<f64>() / count;
        let deviation = (errors.iter().map(|e| e * e).sum::<f64>() / count).sqrt();
        // One step of a display with 8 bits, where it is brightest: 2.2/255. The mean of all, within a quarter of that.
        let step = 2.2 / 255.0;
        assert!(deviation < step, "room {case}: deviation {deviation}");
        assert!(mean.abs() < 0.25 * step, "room {case}: mean {mean}");
    }
}
