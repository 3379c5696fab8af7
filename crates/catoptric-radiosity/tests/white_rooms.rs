//! Rooms whose walls reflect everything: light is lost at one black wall alone, and no error fades by itself.

use glam::Vec3;

use catoptric_radiosity::{SolveParams, solve};
use catoptric_scene::{Material, Radiance, Rgb, Scene, SceneParts, Side, Silent};
use catoptric_solution::{Quality, Solution, Term};
use catoptric_trace::Tracer;

/// ∫ H dA over the elements of one side at places where `within` holds, and their area.
fn arriving(solution: &Solution, side: Side, within: impl Fn(Vec3) -> bool) -> (f64, f64) {
    let mesh = &solution.mesh;
    let mut sums = (0.0, 0.0);
    for (index, element) in mesh.elements.iter().enumerate() {
        let corners = element.vertices.map(|v| mesh.vertices[v as usize]);
        let middle = corners.iter().map(|c| c.position).sum::<Vec3>() / 3.0;
        if corners[0].side != side || !within(middle) {
            continue;
        }
        let area = f64::from(mesh.area(index as u32));
        let of = |v: u32| -> f64 {
            Term::ALL.iter().map(|t| f64::from(solution.irradiance[t.index()][v as usize].y)).sum()
        };
        sums.0 += area * element.vertices.iter().map(|&v| of(v)).sum::<f64>() / 3.0;
        sums.1 += area;
    }
    sums
}

/// A white room of side 2, black at z = 1, with a white glowing box as close below the ceiling as a tenth of its width:
/// a sixth of the light between them leaves at each reflection.
fn under_the_ceiling() -> Scene {
    let mut parts = SceneParts::default();
    let white = parts.add_material(Material::lambertian("white", Rgb::ONE));
    let black = parts.add_material(Material::lambertian("black", Rgb::splat(BLACK)));
    let glowing = Material { emission: Radiance(Rgb::ONE), ..Material::lambertian("lamp", Rgb::ONE) };
    let lamp = parts.add_material(glowing);
    let (x, y, z) = (2.0 * Vec3::X, 2.0 * Vec3::Y, 2.0 * Vec3::Z);
    let corner = Vec3::NEG_ONE;
    parts.add_quad("floor", white, corner, z, x);
    parts.add_quad("ceiling", white, corner + y, x, z);
    parts.add_quad("back", white, corner, x, y);
    parts.add_quad("left", white, corner, y, z);
    parts.add_quad("right", white, corner + x, z, y);
    parts.add_quad("open side", black, corner + z, y, x);
    parts.add_box("lamp", lamp, Vec3::new(-0.3, 0.93, -0.3), Vec3::new(0.3, 0.94, 0.3), false);
    Scene::new(parts).expect("the scene is valid")
}

/// Reflectance of the black wall: elements that reflect nothing at all have no irradiance.
const BLACK: f32 = 0.01;
/// Two-sided 99.9 % quantile of Student's t with 7 degrees of freedom.
const T7: f64 = 5.408;

/// The light between lamp and ceiling is reflected six times, and what the final gather finds beyond the coarse
/// solution is reflected on as often: counted twice, it would add a quarter.
///
/// The tolerance: t-test over eight seeds, and 2 % for what is interpolated (as in the comparison with the slow twin).
#[test]
fn all_light_of_a_white_room_ends_in_its_black_wall() {
    let scene = under_the_ceiling();
    let tracer = Tracer::new(&scene);
    let power = f64::from(std::f32::consts::PI) * (2.0 * 0.36 + 4.0 * 0.6 * 0.01);
    let shares: Vec<f64> = (0..8)
        .map(|seed| {
            let params = SolveParams { seed, ..SolveParams::for_quality(Quality::Standard) };
            let solution = solve(&tracer, &params, &Silent).expect("not cancelled").solution;
            let (arrives, _) = arriving(&solution, Side::Front, |p| p.z > 0.9999);
            f64::from(1.0 - BLACK) * arrives / power
        })
        .collect();
    let count = shares.len() as f64;
    let mean = shares.iter().sum::<f64>() / count;
    let variance = shares.iter().map(|s| (s - mean).powi(2)).sum::<f64>() / (count - 1.0);
    let allowed = 0.02 + T7 * (variance / count).sqrt();
    assert!((mean - 1.0).abs() < allowed, "{mean} ± {allowed}: {shares:?}");
}

/// Walls that are thick boxes with white insides and end in each other, and a box with a white inside that stands a little
/// in the floor: closed spaces, at the edges of which small triangles lie on both sides of contact lines.
#[test]
fn closed_spaces_stay_dark_however_white_they_are() {
    let mut parts = SceneParts::default();
    let white = Material { double_sided: true, ..Material::lambertian("white", Rgb::ONE) };
    let white = parts.add_material(white);
    let lamp = parts.add_material(Material::emitter("lamp", Radiance(Rgb::ONE)));
    let (wide, thin) = (5.0, 0.05);
    for (name, center, size) in [
        ("back", Vec3::new(0.0, 0.0, -wide), Vec3::new(wide, wide, thin)),
        ("floor", Vec3::new(0.0, -wide, 0.01), Vec3::new(wide, thin, wide)),
        ("left", Vec3::new(-wide, 0.0, 0.0), Vec3::new(thin, wide, wide)),
        ("right", Vec3::new(wide, 0.02, -0.01), Vec3::new(thin, wide, wide)),
        ("box", Vec3::new(-2.5, -2.0, -2.0), Vec3::new(1.25, 3.0, 1.24)),
    ] {
        parts.add_box(name, white, center - size, center + size, false);
    }
    parts.add_quad("lamp", lamp, Vec3::new(-1.0, 5.0, -1.0), 2.0 * Vec3::X, 2.0 * Vec3::Z);
    let scene = Scene::new(parts).expect("the scene is valid");
    let solution = solve(&Tracer::new(&scene), &SolveParams::for_quality(Quality::Draft), &Silent)
        .expect("not cancelled")
        .solution;
    let mean = |(light, area): (f64, f64)| light / area;
    let outside = mean(arriving(&solution, Side::Front, |p| p.abs().max_element() < 5.0));
    let inside = mean(arriving(&solution, Side::Back, |_| true));
    // What enters never leaves: a leak would be as bright as the room.
    assert!(outside > 1e-3, "{outside}");
    assert!(inside < 0.01 * outside, "{inside} inside, {outside} outside");
}

/// A closed room of side 2 whose walls all glow with 1 − ρ, so that all radiances are 1 W/(m²·sr).
fn furnace(reflectance: Rgb) -> Scene {
    let mut parts = SceneParts::default();
    let own = (Rgb::ONE - reflectance).max(Rgb::splat(1e-3));
    let glowing = Material { emission: Radiance(own), ..Material::lambertian("wall", reflectance) };
    let wall = parts.add_material(glowing);
    parts.add_box("room", wall, Vec3::NEG_ONE, Vec3::ONE, true);
    Scene::new(parts).expect("the scene is valid")
}

/// A thousand reflections: what is the same everywhere is balanced at once. An error that the sweeps leave is at most a thousand times
/// the tolerance of 1e-5 of what is sent first, which is a thousandth of the whole; form factors of f32 sum to one to 2e-7, a thousand times that.
#[test]
fn nearly_white_furnaces_are_solved_in_few_sweeps() {
    for reflectance in [0.9, 0.99, 0.999] {
        let scene = furnace(Rgb::splat(reflectance));
        let tracer = Tracer::new(&scene);
        let params = SolveParams::for_quality(Quality::Draft);
        let solved = solve(&tracer, &params, &Silent).expect("not cancelled");
        let (arrives, area) = arriving(&solved.solution, Side::Front, |_| true);
        let mean = arrives / area / std::f64::consts::PI;
        assert!((mean - 1.0).abs() < 3e-4, "{mean} with {reflectance}");
        assert!(solved.report.iterations < 60, "{} sweeps with {reflectance}", solved.report.iterations);
        assert!(solved.report.notes.is_empty(), "{:?}", solved.report.notes);
    }
}

/// In red nothing is lost, and there is no solution: a note says so, and the other channels are what they are.
#[test]
fn light_without_end_is_cut_off_and_told() {
    let scene = furnace(Rgb::new(1.0, 0.5, 0.99));
    let tracer = Tracer::new(&scene);
    let params = SolveParams::for_quality(Quality::Draft);
    let solved = solve(&tracer, &params, &Silent).expect("not cancelled");
    let mesh = &solved.solution.mesh;
    let sum = |vertex: usize| -> Rgb {
        Term::ALL.iter().map(|t| solved.solution.irradiance[t.index()][vertex]).sum()
    };
    for vertex in 0..mesh.vertices.len() {
        let light = sum(vertex) / std::f32::consts::PI;
        assert!((light.y - 1.0).abs() < 1e-3 && (light.z - 1.0).abs() < 1e-3, "{light}");
        assert!(light.x.is_finite() && light.x > 0.02, "{light}");
    }
    assert!(solved.report.iterations < 60, "{} sweeps", solved.report.iterations);
    let notes = &solved.report.notes;
    assert!(notes.len() == 1 && notes[0].contains("1 closed space"), "{notes:?}");
}

/// Without a lamp nothing is looked for.
#[test]
fn without_light_it_is_dark_at_once() {
    let mut parts = SceneParts::default();
    let wall = parts.add_material(Material::lambertian("wall", Rgb::ONE));
    parts.add_box("room", wall, Vec3::NEG_ONE, Vec3::ONE, true);
    let scene = Scene::new(parts).expect("the scene is valid");
    let tracer = Tracer::new(&scene);
    let params = SolveParams::for_quality(Quality::Standard);
    let solved = solve(&tracer, &params, &Silent).expect("not cancelled");
    let (arrives, area) = arriving(&solved.solution, Side::Front, |_| true);
    assert!(arrives == 0.0 && (area - 24.0).abs() < 1e-3, "{arrives} W on {area} m²");
    assert!(solved.report.rays.iter().all(|(_, count)| *count == 0), "{:?}", solved.report.rays);
    assert!(solved.report.notes[0].starts_with("nothing gives light"), "{:?}", solved.report.notes);
}
