//! Ward's room (Ward 1990): the published radiosities, and those of an independent solver
//! for the room with one and two mirror walls.
//!
//! 10 × 6 × 3 m, z up; a lamp of 0.5 × 0.5 m in the ceiling's centre, radiance 10, black; reflectances 0.7 (ceiling), 0.5
//! (walls), 0.3 (floor); mirror walls 0.75. Published values "mostly within 1 %, a few up to 5 %": held to 5 %. Those of
//! the other solver (images and 3456 patches): held to 1 % and half a unit of their last digit.

use glam::Vec3;

use catoptric_light::irradiance::Scratch;
use catoptric_light::{LightParams, Lights, Receiver};
use catoptric_radiosity::gather::{DiffuseLight, gather};
use catoptric_radiosity::{SolveParams, Solved, solve};
use catoptric_scene::{Barycentric, Material, Radiance, Rgb, Scene, SceneParts, Side, Silent, TriangleId};
use catoptric_solution::{Quality, Term};
use catoptric_trace::Tracer;
use catoptric_trace::sequence::{Key, Purpose};

const SIZE: Vec3 = Vec3::new(10.0, 6.0, 3.0);
const CEILING: f32 = 0.7;
const WALLS: f32 = 0.5;
const FLOOR: f32 = 0.3;
const MIRROR: f32 = 0.75;
/// Reflections after which the figures for facing mirrors stop.
const REFLECTIONS: u32 = 12;

/// The room; `mirrors` says whether the walls y = 0 and y = 6 are mirrors.
fn room(mirrors: [bool; 2]) -> Scene {
    let mut parts = SceneParts::default();
    let gray = |name: &str, reflectance| Material::lambertian(name, Rgb::splat(reflectance));
    let lamp = Material::emitter("lamp", Radiance(Rgb::splat(10.0)));
    let lamp = Material { base_color: Rgb::ZERO, ..lamp };
    let [ceiling, wall, floor, mirror, lamp] = [
        gray("ceiling", CEILING),
        gray("walls", WALLS),
        gray("floor", FLOOR),
        Material::mirror("mirror", Rgb::splat(MIRROR)),
        lamp,
    ]
    .map(|m| parts.add_material(m));
    let (x, y, z) = (Vec3::X * SIZE.x, Vec3::Y * SIZE.y, Vec3::Z * SIZE.z);
    parts.add_quad("floor", floor, Vec3::ZERO, x, y);
    let side = |is_mirror: bool| if is_mirror { mirror } else { wall };
    parts.add_quad("wall y=0", side(mirrors[0]), Vec3::ZERO, z, x);
    parts.add_quad("wall y=6", side(mirrors[1]), y, x, z);
    parts.add_quad("wall x=0", wall, Vec3::ZERO, y, z);
    parts.add_quad("wall x=10", wall, x, z, y);
    // The ceiling has a hole where the lamp is: two surfaces in one place would share the light by chance.
    let mut down = |name: &str, material, from: [f32; 2], to: [f32; 2]| {
        let corner = Vec3::new(from[0], from[1], SIZE.z);
        parts.add_quad(name, material, corner, Vec3::Y * (to[1] - from[1]), Vec3::X * (to[0] - from[0]));
    };
    down("lamp", lamp, [4.75, 2.75], [5.25, 3.25]);
    down("ceiling", ceiling, [0.0, 0.0], [4.75, 6.0]);
    down("ceiling", ceiling, [5.25, 0.0], [10.0, 6.0]);
    down("ceiling", ceiling, [4.75, 0.0], [5.25, 2.75]);
    down("ceiling", ceiling, [4.75, 3.25], [5.25, 6.0]);
    Scene::new(parts).expect("a valid scene")
}

fn params() -> SolveParams {
    let mut params = SolveParams::for_quality(Quality::Standard);
    params.base_triangles = 2_400;
    params.row_rays = 256;
    params.walk.max_depth = REFLECTIONS;
    params
}

/// The triangle of floor (z = 0) or ceiling (z = 3) at a point, and where in it.
fn place(scene: &Scene, point: Vec3) -> (TriangleId, Barycentric) {
    (0..scene.triangles().len() as u32)
        .map(TriangleId)
        .find_map(|t| {
            let [a, b, c] = scene.corners(t);
            let (e, f, p) = (b - a, c - a, point - a);
            let n = e.cross(f);
            let d = n.length_squared();
            let (u, v) = (p.cross(f).dot(n) / d, e.cross(p).dot(n) / d);
            let inside = p.dot(n).abs() < 1e-4 && u >= 0.0 && v >= 0.0 && u + v <= 1.0;
            inside.then_some((t, Barycentric { u, v }))
        })
        .expect("a point of the floor or the ceiling")
}

/// Rays of a look-up: their error is far below the 1 % that is asked for.
const RAYS: u32 = 1 << 16;

/// Radiosity at points, by one more gather from the solution.
fn radiosities(tracer: &Tracer, solved: &Solved, points: &[(f32, f32, f32)]) -> Vec<f32> {
    let params = params();
    let lights = Lights::new(tracer, LightParams::default());
    let solution = &solved.solution;
    let total: Vec<Rgb> = (0..solution.mesh.vertices.len())
        .map(|v| Term::ALL.iter().map(|t| solution.irradiance[t.index()][v]).sum())
        .collect();
    let light = DiffuseLight { mesh: &solution.mesh, irradiance: &total };
    points
        .iter()
        .enumerate()
        .map(|(index, &(x, y, z))| {
            let (triangle, at) = place(tracer.scene(), Vec3::new(x, y, z));
            let receiver = Receiver::on(tracer, triangle, Side::Front, at);
            let key = Key::new(1, Purpose::Hemisphere, index as u64);
            let mut scratch = Scratch::default();
            let direct = lights.direct(&receiver, 256, key.child(1), &mut scratch).irradiance;
            let mirrored = lights.mirrored(&receiver, 256, Rgb::ZERO, key.child(2), &mut scratch).irradiance;
            let g = gather(&lights, &light, &receiver, RAYS, key, &params.walk);
            let h = direct + mirrored + g.direct + g.mirrored + g.caustic + g.indirect;
            h.x * if z > 0.0 { CEILING } else { FLOOR }
        })
        .collect()
}

/// Mean radiosity over a surface.
fn mean(tracer: &Tracer, solved: &Solved, name: &str, reflectance: f32) -> f64 {
    let solution = &solved.solution;
    let (mut sum, mut area) = (0.0, 0.0);
    for (index, element) in solution.mesh.elements.iter().enumerate() {
        let vertices = element.vertices;
        let triangle = solution.mesh.vertices[vertices[0] as usize].triangle;
        if !tracer.scene().surface_of(triangle).name.starts_with(name) {
            continue;
        }
        let light =
            |v: u32| Term::ALL.iter().map(|t| solution.irradiance[t.index()][v as usize].x).sum::<f32>();
        let a = f64::from(solution.mesh.area(index as u32));
        sum += a * f64::from(vertices.iter().map(|&v| light(v)).sum::<f32>() / 3.0);
        area += a;
    }
    sum / area * f64::from(reflectance)
}

/// Prints and checks found values; `bar` is relative, and half a unit of the last printed digit comes on top.
fn compare(what: &str, places: &[String], found: &[f64], expected: &[f64], bar: f64, last_digit: f64) {
    let mut worst = 0.0_f64;
    let mut failures = Vec::new();
    for ((place, found), expected) in places.iter().zip(found).zip(expected) {
        let off = (found - expected).abs();
        worst = worst.max(off / expected);
        if off > bar * expected + 0.5 * last_digit {
            failures.push(format!("{place}: {found:.5} for {expected}"));
        }
    }
    println!(
        "{what}: {} values, worst {:.2} % off (bar {} % and rounding)",
        found.len(),
        100.0 * worst,
        100.0 * bar
    );
    assert!(failures.is_empty(), "{what}: {failures:#?}");
}

/// Points (x, y, z) with their radiosities.
fn check_points(what: &str, tracer: &Tracer, solved: &Solved, table: &[(f32, f32, f32, f64)], bar: f64) {
    let points: Vec<(f32, f32, f32)> = table.iter().map(|p| (p.0, p.1, p.2)).collect();
    let found: Vec<f64> = radiosities(tracer, solved, &points).into_iter().map(f64::from).collect();
    let expected: Vec<f64> = table.iter().map(|p| p.3).collect();
    let places: Vec<String> = points.iter().map(|p| format!("{p:?}")).collect();
    compare(what, &places, &found, &expected, bar, 1e-4);
}

fn check_means(what: &str, tracer: &Tracer, solved: &Solved, table: &[(&str, f32, f64)]) {
    let found: Vec<f64> = table.iter().map(|&(name, rho, _)| mean(tracer, solved, name, rho)).collect();
    let expected: Vec<f64> = table.iter().map(|t| t.2).collect();
    let places: Vec<String> = table.iter().map(|t| t.0.to_owned()).collect();
    compare(what, &places, &found, &expected, 0.01, 1e-5);
}

const TOP: f32 = SIZE.z;

#[test]
fn the_room_of_1990_comes_out_as_published() {
    let scene = room([false, false]);
    let tracer = Tracer::new(&scene);
    let solved = solve(&tracer, &params(), &Silent).expect("nobody stops it");
    let columns = [0.25, 0.75, 1.25, 1.75, 2.25, 2.75];
    let rows: [(f32, &[f64]); 4] = [
        (0.25, &[0.0113, 0.0131, 0.0140, 0.0149, 0.0151, 0.0155]),
        (0.75, &[0.0131, 0.0150, 0.0162, 0.0168, 0.0173, 0.0177]),
        (1.25, &[0.0147, 0.0166, 0.0177, 0.0185, 0.0189, 0.0191]),
        (1.75, &[0.0163, 0.0184]),
    ];
    let published: Vec<(f32, f32, f32, f64)> = rows
        .iter()
        .flat_map(|(x, values)| values.iter().zip(columns).map(move |(b, y)| (*x, y, TOP, *b)))
        .collect();
    check_points("published, ceiling", &tracer, &solved, &published, 0.05);
    let derived = [
        (0.25, 0.25, TOP, 0.0115),
        (0.25, 2.75, TOP, 0.0155),
        (0.75, 0.75, TOP, 0.0150),
        (1.25, 0.25, TOP, 0.0147),
        (1.25, 2.75, TOP, 0.0192),
        (1.75, 0.25, TOP, 0.0163),
        (1.75, 0.75, TOP, 0.0184),
        (4.75, 0.25, TOP, 0.0260),
        (0.25, 0.25, 0.0, 0.0102),
        (0.25, 2.75, 0.0, 0.0138),
        (0.75, 0.75, 0.0, 0.0129),
        (1.25, 0.25, 0.0, 0.0137),
        (1.25, 2.75, 0.0, 0.0195),
        (1.75, 0.25, 0.0, 0.0162),
        (1.75, 0.75, 0.0, 0.0182),
        (4.75, 0.25, 0.0, 0.0358),
        (4.75, 2.75, 0.0, 0.0890),
    ];
    check_points("derived, no mirror", &tracer, &solved, &derived, 0.01);
    let means = [("floor", FLOOR, 0.03336), ("wall y", WALLS, 0.03093), ("wall x", WALLS, 0.02081)];
    check_means("means, no mirror", &tracer, &solved, &means);
}

#[test]
fn one_wall_as_a_mirror_comes_out_as_by_images() {
    let scene = room([true, false]);
    let tracer = Tracer::new(&scene);
    let solved = solve(&tracer, &params(), &Silent).expect("nobody stops it");
    let derived = [
        (0.25, 0.25, TOP, 0.0148),
        (0.25, 2.75, TOP, 0.0163),
        (1.25, 0.25, TOP, 0.0181),
        (1.25, 2.75, TOP, 0.0201),
        (4.75, 0.25, TOP, 0.0263),
        (4.75, 5.75, TOP, 0.0263),
        (0.25, 0.25, 0.0, 0.0139),
        (0.25, 2.75, 0.0, 0.0153),
        (1.25, 0.25, 0.0, 0.0179),
        (1.25, 2.75, 0.0, 0.0212),
        (4.75, 0.25, 0.0, 0.0443),
        (4.75, 5.75, 0.0, 0.0367),
    ];
    check_points("derived, one mirror", &tracer, &solved, &derived, 0.01);
    let means = [("floor", FLOOR, 0.03565), ("wall y=6", WALLS, 0.03207), ("wall x", WALLS, 0.02311)];
    check_means("means, one mirror", &tracer, &solved, &means);
}

#[test]
fn two_facing_mirrors_come_out_as_by_images_of_twelve_reflections() {
    let scene = room([true, true]);
    let tracer = Tracer::new(&scene);
    let solved = solve(&tracer, &params(), &Silent).expect("nobody stops it");
    let derived = [
        (0.25, 0.25, TOP, 0.0150),
        (0.25, 2.75, TOP, 0.0168),
        (1.25, 0.25, TOP, 0.0185),
        (1.25, 2.75, TOP, 0.0207),
        (4.75, 0.25, TOP, 0.0266),
        (4.75, 5.75, TOP, 0.0266),
        (0.25, 0.25, 0.0, 0.0148),
        (0.25, 2.75, 0.0, 0.0169),
        (1.25, 0.25, 0.0, 0.0188),
        (1.25, 2.75, 0.0, 0.0227),
        (4.75, 0.25, 0.0, 0.0454),
        (4.75, 5.75, 0.0, 0.0454),
    ];
    check_points("derived, two mirrors", &tracer, &solved, &derived, 0.01);
    let means = [("floor", FLOOR, 0.03812), ("wall x", WALLS, 0.02544)];
    check_means("means, two mirrors", &tracer, &solved, &means);
}
