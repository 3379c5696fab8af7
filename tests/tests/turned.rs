//! Scenes that do not lie along the axes: as bright as those that do.

use catoptric_radiosity::{SolveParams, solve};
use catoptric_scene::{Material, Radiance, Rgb, Scene, SceneParts, Side, Silent, TriangleId};
use catoptric_solution::{Quality, Solution, Term};
use catoptric_tests::white_room;
use catoptric_trace::Tracer;
use glam::{Quat, Vec3};

/// Along no axis, nor anywhere near one.
const SLANTED: Quat = Quat::from_xyzw(0.327_327, 0.545_545, 0.109_109, 0.763_763);

fn turned(mut parts: SceneParts) -> Scene {
    for vertex in &mut parts.vertices {
        vertex.position = SLANTED * vertex.position;
        vertex.normal = SLANTED * vertex.normal;
    }
    Scene::new(parts).expect("a turned scene is as valid")
}

fn solved(scene: &Scene) -> Solution {
    let params = SolveParams::for_quality(Quality::Standard);
    solve(&Tracer::new(scene), &params, &Silent).expect("not cancelled").solution
}

/// Irradiance at a vertex, channels added.
fn light(solution: &Solution, vertex: usize) -> f64 {
    Term::ALL.iter().map(|t| f64::from(solution.irradiance[t.index()][vertex].element_sum())).sum()
}

/// Walls that emit 1 and reflect a half: π/(1 − ½) arrives everywhere, from broad emitters and from what they light. By rounding a
/// slanted wall lies before itself.
#[test]
fn a_slanted_furnace_is_as_bright_as_any() {
    let mut parts = SceneParts::default();
    let glow = Material::emitter("glowing", Radiance(Rgb::ONE));
    let wall = parts.add_material(Material { base_color: Rgb::splat(0.5), ..glow });
    parts.add_box("furnace", wall, Vec3::splat(-1.0), Vec3::ONE, true);
    let solution = solved(&turned(parts));
    let exact = 3.0 * 2.0 * std::f64::consts::PI;
    for vertex in 0..solution.mesh.vertices.len() {
        let found = light(&solution, vertex) / exact;
        // The coarse solver stops at 1e-5 of the light; sums of some hundred f32 round by less.
        assert!((found - 1.0).abs() < 3e-5, "{}: {found}", solution.mesh.vertices[vertex].position);
    }
}

/// A rug hides the floor beneath it, and no dark comes out at its sides, however many triangles the box around a slanted floor holds.
#[test]
fn light_ends_at_the_sides_of_a_rug_in_a_slanted_and_crowded_room() {
    let [straight, slanted] = [false, true].map(|is_turned| {
        let (mut parts, white) = white_room();
        let lamp = parts.add_material(Material::emitter("lamp", Radiance(Rgb::new(12.0, 11.0, 10.0))));
        parts.add_quad("lamp", lamp, Vec3::new(-0.3, 2.19, -0.3), 0.6 * Vec3::X, 0.6 * Vec3::Z);
        parts.add_box("rug", white, Vec3::new(-0.6, 0.0, -0.5), Vec3::new(0.6, 0.01, 0.5), false);
        // As many triangles as a furnished room has.
        parts.add_sphere("ball", white, Vec3::new(1.0, 0.3, 1.0), 0.2, 160);
        let scene = if is_turned { turned(parts) } else { Scene::new(parts).expect("the room is valid") };
        assert!(scene.triangles().len() > 50_000, "{}", scene.triangles().len());
        let solution = solved(&scene);
        // What is shown a hand's breadth along the rug, two centimetres off it.
        let floor = scene.surfaces().iter().find(|s| s.name == "floor").expect("there is a floor");
        let shown = |p: Vec3| -> f64 {
            let p = if is_turned { SLANTED * p } else { p };
            let at = |t| solution.mesh.locate(TriangleId(t), Side::Front, p);
            let at = floor.triangles.clone().find_map(at).expect("it is on the floor");
            Term::ALL.iter().map(|&term| f64::from(solution.irradiance(term, &at).0.element_sum())).sum()
        };
        let places = (0..80).map(|k| 0.01 * k as f32 - 0.4).flat_map(|x| [-0.52, 0.52].map(|z| (x, z)));
        places.map(|(x, z)| shown(Vec3::new(x, 0.0, z))).sum::<f64>()
    });
    // Gathers deviate by 1.3 %, and some ten vertices have a say; what the mesh leaves alone is as much as one of them.
    assert!((slanted / straight - 1.0).abs() < 0.013, "{slanted} {straight}");
}
