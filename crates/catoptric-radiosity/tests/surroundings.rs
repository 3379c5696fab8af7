//! What lies far outside of a room changes nothing in it.

use glam::Vec3;

use catoptric_radiosity::{SolveParams, solve};
use catoptric_scene::{Material, MaterialId, Radiance, Rgb, Scene, SceneParts, Side, Silent, TriangleId};
use catoptric_solution::{Quality, Solution, Term};
use catoptric_trace::Tracer;

/// A closed room with a lamp, a mirror and a book as thick as a finger, before whatever else is added.
fn room(add: impl FnOnce(&mut SceneParts, MaterialId)) -> Scene {
    let mut parts = SceneParts::default();
    let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.6)));
    let lamp = Material { emission: Radiance(Rgb::splat(8.0)), ..Material::lambertian("lamp", Rgb::ZERO) };
    let lamp = parts.add_material(lamp);
    let mirror = parts.add_material(Material::mirror("mirror", Rgb::splat(0.9)));
    parts.add_box("room", white, Vec3::new(-2.0, 0.0, -2.0), Vec3::new(2.0, 2.5, 2.0), true);
    parts.add_quad("lamp", lamp, Vec3::new(-0.4, 2.49, -0.4), Vec3::X * 0.8, Vec3::Z * 0.8);
    parts.add_quad("mirror", mirror, Vec3::new(-1.99, 0.5, 1.0), Vec3::Z * -2.0, Vec3::Y * 1.5);
    parts.add_box("book", white, Vec3::new(0.2, 0.0, 0.2), Vec3::new(0.9, 0.02, 0.7), false);
    add(&mut parts, white);
    Scene::new(parts).expect("the scene is valid")
}

/// Green irradiance in a lattice of places on the floor, beneath the book and beside it, and on the book.
fn irradiance(scene: &Scene, seed: u32) -> Vec<f32> {
    let tracer = Tracer::new(scene);
    let params = SolveParams { seed, ..SolveParams::for_quality(Quality::Draft) };
    let solution = solve(&tracer, &params, &Silent).expect("not cancelled").solution;
    let triangles = 0..scene.triangles().len() as u32;
    let named = |name: &str| {
        let is_named =
            |t: &TriangleId| &*scene.surfaces()[scene.triangles()[t.index()].surface.index()].name == name;
        triangles.clone().map(TriangleId).filter(is_named).collect::<Vec<_>>()
    };
    let up = |t: &TriangleId| scene.geometric_normal(*t).y > 0.9;
    let at = |solution: &Solution, triangle: TriangleId, place: Vec3| {
        let located = solution.mesh.locate(triangle, Side::Front, place).expect("it holds light");
        let value =
            |v: u32| Term::ALL.iter().map(|t| solution.irradiance[t.index()][v as usize].y).sum::<f32>();
        located.vertices.iter().zip(located.weights).map(|(&v, weight)| value(v) * weight).sum::<f32>()
    };
    let mut found = Vec::new();
    for (name, [x, z], size) in [("room", [-1.9, -1.9], 3.8), ("book", [0.25, 0.25], 0.4)] {
        let surface: Vec<TriangleId> = named(name).into_iter().filter(up).collect();
        for (i, j) in (0..12).flat_map(|i| (0..12).map(move |j| (i, j))) {
            let place = Vec3::new(x, scene.corners(surface[0])[0].y, z)
                + Vec3::new(i as f32, 0.0, j as f32) * (size / 11.0);
            found.push(at(&solution, surface[0], place));
        }
    }
    found
}

/// RMS of the difference over the mean.
fn difference(a: &[f32], b: &[f32]) -> f32 {
    let mean = a.iter().sum::<f32>() / a.len() as f32;
    let squares: f32 = a.iter().zip(b).map(|(a, b)| ((a - b) / mean).powi(2)).sum();
    (squares / a.len() as f32).sqrt()
}

/// Ground, and a vertex that went astray, so far that 2⁻²⁴ of it is more than the book is thick. (Where planes within a millionth of the
/// ground are one, the book's cover is the floor.)
///
/// The tolerance: the mesh is another, so its error is, too; that is about as large as the noise. Twice the root of two of what two seeds
/// differ by.
#[test]
fn a_room_is_as_bright_wherever_the_horizon_is() {
    let alone = room(|_, _| ());
    let [alone, again] = [0, 1].map(|seed| irradiance(&alone, seed));
    let allowed = 2.0 * 2.0_f32.sqrt() * difference(&alone, &again);
    assert!(allowed < 0.05, "{allowed}");
    let ground = |side: f32| {
        room(move |parts, white| {
            let corner = Vec3::new(-0.5 * side, -0.3, 0.5 * side);
            parts.add_quad("ground", white, corner, Vec3::X * side, Vec3::Z * -side);
        })
    };
    let stray = room(|parts, white| {
        let corners = [Vec3::new(3.0, 0.0, 0.0), Vec3::new(1e6, 0.0, 0.0), Vec3::new(3.0, 1.0, 0.0)];
        parts.add_triangles("stray", white, &corners, &[[0, 1, 2]]);
    });
    for (name, scene) in
        [("1 km", ground(1e3)), ("40 km", ground(4e4)), ("2000 km", ground(2e6)), ("stray", stray)]
    {
        let difference = difference(&alone, &irradiance(&scene, 0));
        assert!(difference < allowed, "{name}: {difference}, allowed {allowed}");
    }
}
