//! Degenerate and hostile scenes through the whole program: every one ends soon, without a panic, in finite light.

use std::time::{Duration, Instant};

use catoptric_radiosity::{SolveParams, SolveReport, solve};
use catoptric_render::{RenderParams, render};
use catoptric_scene::{
    Material, MaterialId, PunctualKind, PunctualLight, Radiance, Rgb, Scene, SceneParts, Silent, Sky,
    Transmission,
};
use catoptric_solution::Quality;
use catoptric_tests::looking;
use catoptric_trace::Tracer;
use glam::Vec3;

/// What no scene of this file may take, on a busy machine, without optimisation.
const PATIENCE: Duration = Duration::from_secs(60);

/// A picture and what was done for it.
struct Picture {
    pixels: Vec<[f32; 3]>,
    report: SolveReport,
    seconds: f64,
}

impl Picture {
    fn mean(&self) -> f64 {
        let sum: f64 = self.pixels.iter().flatten().map(|v| f64::from(*v)).sum();
        sum / (3 * self.pixels.len().max(1)) as f64
    }
}

/// Both passes; everything that comes out is finite and not negative.
fn picture(what: &str, mut parts: SceneParts) -> Picture {
    if parts.cameras.is_empty() {
        parts.cameras.push(looking(Vec3::new(0.3, 0.4, 3.0), Vec3::ZERO, 1.0));
    }
    let start = Instant::now();
    let scene = Scene::new(parts).expect("a valid scene");
    let tracer = Tracer::new(&scene);
    let solved = solve(&tracer, &SolveParams::for_quality(Quality::Draft), &Silent).expect("not cancelled");
    for values in &solved.solution.irradiance {
        assert!(values.iter().all(|v| v.is_finite() && v.min_element() >= 0.0), "{what}: irradiance");
    }
    let params = RenderParams { layers: true, ..RenderParams::for_quality(Quality::Draft, 24, 24) };
    let rendered = render(&tracer, &solved.solution, &scene.cameras()[0], &params, &Silent);
    let pixels = rendered.expect("not cancelled").image.rgb("").expect("a beauty");
    let bad = pixels.iter().flatten().filter(|v| !(v.is_finite() && **v >= 0.0)).count();
    assert_eq!(bad, 0, "{what}: pixels that are not light");
    let taken = start.elapsed();
    assert!(taken < PATIENCE, "{what}: {taken:?}");
    Picture { pixels, report: solved.report, seconds: taken.as_secs_f64() }
}

fn white(parts: &mut SceneParts) -> MaterialId {
    parts.add_material(Material::lambertian("white", Rgb::splat(0.7)))
}

fn lamp(parts: &mut SceneParts) -> MaterialId {
    parts.add_material(Material::emitter("lamp", Radiance(Rgb::splat(10.0))))
}

/// A room with a block and a lamp, `size` metres wide, with its centre at `at`, seen from inside.
fn room(size: f32, at: Vec3) -> SceneParts {
    let mut parts = SceneParts::default();
    let (white, lamp) = (white(&mut parts), lamp(&mut parts));
    let place = |x: f32, y: f32, z: f32| at + Vec3::new(x, y, z) * size;
    parts.add_box("room", white, place(-0.5, -0.5, -0.5), place(0.5, 0.5, 0.5), true);
    parts.add_box("block", white, place(-0.3, -0.5, -0.3), place(0.0, -0.1, 0.0), false);
    let (x, z) = (Vec3::X * (0.3 * size), Vec3::Z * (0.3 * size));
    parts.add_quad("lamp", lamp, place(-0.15, 0.49, -0.15), x, z);
    parts.cameras.push(looking(place(0.0, 0.0, 0.49), place(0.0, -0.1, 0.0), 1.0));
    parts
}

fn sky(parts: &mut SceneParts) {
    parts.sky = Some(Sky::Uniform(Radiance(Rgb::ONE)));
}

fn near(what: &str, value: f64, expected: f64, tolerance: f64) {
    assert!((value - expected).abs() <= tolerance * expected, "{what}: {value}, expected {expected}");
}

#[test]
fn scenes_without_geometry_show_the_sky_or_nothing() {
    let empty = picture("nothing", SceneParts::default());
    assert_eq!(empty.mean(), 0.0);
    let mut parts = SceneParts::default();
    sky(&mut parts);
    near("sky alone", picture("sky alone", parts).mean(), 1.0, 1e-6);
}

#[test]
fn scenes_without_diffuse_surfaces_have_nothing_to_solve() {
    let mut parts = SceneParts::default();
    let mirror = parts.add_material(Material::mirror("mirror", Rgb::splat(0.9)));
    parts.add_box("mirrors", mirror, Vec3::splat(-4.0), Vec3::splat(4.0), true);
    assert_eq!(picture("closed mirrors", parts).mean(), 0.0);

    let mut parts = SceneParts::default();
    let glass = parts.add_material(Material::glass("glass", 1.5));
    parts.add_sphere("ball", glass, Vec3::ZERO, 1.0, 8);
    sky(&mut parts);
    near("glass under a sky", picture("glass under a sky", parts).mean(), 1.0, 0.02);

    let mut parts = SceneParts::default();
    let lamp = lamp(&mut parts);
    parts.add_box("lamps", lamp, Vec3::splat(-4.0), Vec3::splat(4.0), true);
    near("only lamps", picture("only lamps", parts).mean(), 10.0, 1e-3);
}

#[test]
fn a_single_triangle_has_the_irradiance_of_its_sky() {
    let mut parts = SceneParts::default();
    let white = white(&mut parts);
    let corners = [Vec3::new(-9.0, -9.0, 0.0), Vec3::new(9.0, -9.0, 0.0), Vec3::new(0.0, 18.0, 0.0)];
    parts.add_triangles("one", white, &corners, &[[0, 1, 2]]);
    sky(&mut parts);
    near("one triangle", picture("one triangle", parts).mean(), 0.7, 0.01);
}

#[test]
fn a_room_looks_the_same_at_any_size() {
    let usual = picture("a room", room(4.0, Vec3::ZERO)).mean();
    assert!(usual > 0.0);
    for size in [1e-4, 1e-2, 1e3, 1e6] {
        let mean = picture("a room of another size", room(size, Vec3::ZERO)).mean();
        near(&format!("{size} m"), mean, usual, 0.03);
    }
}

#[test]
fn rooms_far_from_the_origin_keep_what_f32_leaves_of_them() {
    let usual = picture("a room", room(4.0, Vec3::ZERO)).mean();
    let far = picture("10 km away", room(4.0, Vec3::new(1e4, 0.0, -1e4))).mean();
    near("10 km away", far, usual, 0.05);
    // At 10⁶ m a coordinate is rounded to 6 cm: the room is a little crooked, but it is lit.
    let farther = picture("1000 km away", room(16.0, Vec3::new(1e6, 1e6, 1e6))).mean();
    assert!(farther > 0.3 * usual && farther < 3.0 * usual, "{farther} {usual}");
}

#[test]
fn flat_scenes_are_lit_by_what_is_not_in_their_plane() {
    let mut parts = SceneParts::default();
    let (white, lamp) = (white(&mut parts), lamp(&mut parts));
    for k in 0..5 {
        let corner = Vec3::new(k as f32 - 2.5, -2.5, 0.0);
        parts.add_quad("stripe", if k % 2 == 0 { white } else { lamp }, corner, Vec3::X, Vec3::Y * 5.0);
    }
    let dark = picture("a flat scene", parts.clone());
    // Emission is seen, and lights nothing: neither its own plane nor itself.
    assert!(dark.mean() > 0.0);
    assert_eq!(dark.report.rays.iter().filter(|r| r.0 == "light").map(|r| r.1).sum::<u64>(), 0);
    sky(&mut parts);
    assert!(picture("a flat scene under a sky", parts).mean() > 0.5);
}

#[test]
fn the_camera_may_be_in_a_wall_or_at_a_corner_or_in_a_lamp() {
    for eye in [
        Vec3::new(0.0, 0.0, 2.0),
        Vec3::splat(2.0),
        Vec3::splat(-2.0),
        Vec3::new(0.0, 1.96, 0.0),
        Vec3::new(-0.5, -1.0, -0.5),
        Vec3::ZERO,
    ] {
        let mut parts = room(4.0, Vec3::ZERO);
        parts.cameras = vec![looking(eye, Vec3::new(0.1, -0.3, 0.2), 1.0)];
        picture(&format!("a camera at {eye}"), parts);
    }
}

#[test]
fn images_without_pixels_are_no_images() {
    let scene = Scene::new(room(4.0, Vec3::ZERO)).expect("a valid scene");
    let tracer = Tracer::new(&scene);
    let solved = solve(&tracer, &SolveParams::for_quality(Quality::Draft), &Silent).expect("not cancelled");
    for (width, height) in [(0, 0), (0, 5), (5, 0), (1, 1), (1, 300)] {
        let params = RenderParams::for_quality(Quality::Draft, width, height);
        let rendered = render(&tracer, &solved.solution, &scene.cameras()[0], &params, &Silent);
        let image = rendered.expect("not cancelled").image;
        assert_eq!((image.width, image.height), (width, height));
    }
}

#[test]
fn thousands_of_sheets_in_one_place_and_through_each_other() {
    let mut parts = room(4.0, Vec3::ZERO);
    let white = white(&mut parts);
    for k in 0..2000 {
        let shift = Vec3::new(0.0, 0.0, if k % 2 == 0 { 0.0 } else { 1e-7 * k as f32 });
        parts.add_quad("sheet", white, Vec3::new(-0.5, -1.5, 0.5) + shift, Vec3::X, Vec3::Y);
    }
    assert!(picture("coincident sheets", parts).mean() > 0.0);

    let mut parts = room(4.0, Vec3::ZERO);
    let white = self::white(&mut parts);
    for k in 0..300 {
        let (sin, cos) = libm::sincosf(k as f32 * 0.021);
        let across = Vec3::new(cos, 0.3 * sin, sin);
        parts.add_quad("fan", white, -across * 0.8 - Vec3::Y, across * 1.6, Vec3::Y * 1.5);
    }
    assert!(picture("a fan of sheets through one line", parts).mean() > 0.0);
}

/// Quads of `edge` metres, scattered over a ball of radius 1.
fn scatter(parts: &mut SceneParts, material: MaterialId, count: u32, edge: f32) {
    let (mut positions, mut indices) = (Vec::new(), Vec::new());
    let mut state = 1_u32;
    let mut random = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / 16_777_216.0 * 2.0 - 1.0
    };
    for k in 0..count {
        let at = Vec3::new(random(), random(), random()) * 0.8;
        let a = Vec3::new(random(), random(), random()).normalize_or_zero() * edge;
        let b = a.any_orthogonal_vector().normalize_or_zero() * edge;
        positions.extend([at, at + a, at + a + b, at + b]);
        indices.extend([[4 * k, 4 * k + 1, 4 * k + 2], [4 * k, 4 * k + 2, 4 * k + 3]]);
    }
    parts.add_triangles("scatter", material, &positions, &indices);
}

#[test]
fn a_hundred_thousand_tiny_quads_cost_a_budget() {
    let mut parts = room(4.0, Vec3::ZERO);
    let white = white(&mut parts);
    scatter(&mut parts, white, 100_000, 0.01);
    let dust = picture("dust", parts);
    assert!(dust.mean() > 0.0);
    let rays: u64 = dust.report.rays.iter().map(|r| r.1).sum();
    // Of shared vertices and of walls, which get twice the budget among so many. Each vertex by itself, 400 000 would take 16 shadow
    // rays and 96 of a gather, 45 million in all. Three quarters are shadow rays: the shadows of dust are noise.
    assert!(rays < 8_000_000, "{rays} rays");
}

#[test]
fn tens_of_thousands_of_emitters_cost_little_more_than_one() {
    let one = picture("one lamp", room(4.0, Vec3::ZERO));
    let mut parts = room(4.0, Vec3::ZERO);
    let glow = Material { double_sided: true, ..Material::emitter("glow", Radiance(Rgb::splat(10.0))) };
    let glow = parts.add_material(glow);
    scatter(&mut parts, glow, 10_000, 0.01);
    let many = picture("glowing dust", parts);
    assert!(many.mean() > one.mean());
    // One lamp is worth as many shadow rays at a vertex as the budget says; ten thousand, all of whose light is noise, no more than
    // refinement spends on noise, six times that (`MEAN_TIMES`).
    let budget = u64::from(SolveParams::for_quality(Quality::Draft).shadow_rays);
    let shadow = many.report.rays.iter().find(|r| r.0 == "shadow").map_or(0, |r| r.1);
    let vertices = many.report.vertices as u64;
    assert!(shadow < 6 * budget * vertices, "{shadow} rays at {vertices} vertices");
    assert!(many.seconds < 30.0, "{} s", many.seconds);
}

#[test]
fn mirrors_and_panes_by_the_thousand_are_left_to_the_hemisphere() {
    let mut parts = room(4.0, Vec3::ZERO);
    let mirror = parts.add_material(Material::mirror("mirror", Rgb::splat(0.9)));
    scatter(&mut parts, mirror, 3_000, 0.05);
    let pane = Material { transmission_kind: Transmission::Pane, ..Material::glass("pane", 1.5) };
    let pane = parts.add_material(pane);
    scatter(&mut parts, pane, 1_000, 0.05);
    assert!(picture("mirrors by the thousand", parts).mean() > 0.0);
}

#[test]
fn lamps_on_walls_and_lights_in_corners_stay_finite() {
    let mut parts = room(4.0, Vec3::ZERO);
    let lamp = MaterialId(1);
    // In the wall's own plane, across it, and a micrometre wide: a triangle without area is an error of the scene, which
    // says so.
    parts.add_quad("in the wall", lamp, Vec3::new(-2.0, -1.0, -1.0), Vec3::Y, Vec3::Z);
    parts.add_quad("through the wall", lamp, Vec3::new(-2.5, 0.5, -1.0), Vec3::X, Vec3::Z);
    parts.add_quad("a thread", lamp, Vec3::ZERO, Vec3::X, Vec3::new(0.5, 1e-6, 0.0));
    for position in [Vec3::splat(2.0), Vec3::new(2.0, 0.0, 0.0), Vec3::new(-0.2, -0.4, 0.0)] {
        parts.lights.push(PunctualLight {
            name: "point".to_owned(),
            position,
            direction: Vec3::NEG_Y,
            intensity: Rgb::splat(5.0),
            kind: PunctualKind::Point,
        });
    }
    assert!(picture("lamps on walls", parts).mean() > 0.0);
}
