//! Light of lamps in lenses, all of pass one: what receivers see in them is what light-side rays would bring.

use catoptric_radiosity::solve::{SolveParams, solve};
use catoptric_scene::{Material, Radiance, Rgb, Scene, SceneParts, Silent};
use catoptric_solution::{Quality, Solution, Term};
use catoptric_trace::Tracer;
use glam::Vec3;

/// A room with a bulb in a globe of real glass, a block before it, and a mirror on a wall.
fn room() -> Scene {
    let mut parts = SceneParts::default();
    let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
    parts.add_box("room", white, Vec3::splat(-1.0), Vec3::splat(1.0), true);
    parts.add_box("block", white, Vec3::new(-0.6, -1.0, -0.3), Vec3::new(-0.2, -0.3, 0.1), false);
    let mirror = parts.add_material(Material::mirror("mirror", Rgb::splat(0.9)));
    parts.add_quad("mirror", mirror, Vec3::new(0.99, -0.5, 0.5), Vec3::Z * -1.0, Vec3::Y * 1.0);
    let lamp = parts.add_material(Material::emitter("bulb", Radiance(Rgb::new(3.0, 10.0, 5.0))));
    parts.add_sphere("bulb", lamp, Vec3::new(0.1, 0.2, 0.0), 0.1, 16);
    let glass = parts.add_material(Material::glass("glass", 1.5));
    parts.add_sphere("globe", glass, Vec3::new(0.1, 0.2, 0.0), 0.25, 32);
    Scene::new(parts).expect("a valid scene")
}

/// Power of the caustic term, and its first moments about a corner of the room.
fn moments(solution: &Solution) -> [f64; 4] {
    let light = &solution.irradiance[Term::Caustic.index()];
    let mut sums = [0.0; 4];
    for element in 0..solution.mesh.elements.len() as u32 {
        let corners = solution.mesh.elements[element as usize].vertices.map(|v| v as usize);
        for v in corners {
            let power = f64::from(light[v].y * solution.mesh.area(element)) / 3.0;
            let arm = solution.mesh.vertices[v].position.as_dvec3() + 1.0;
            for (sum, times) in sums.iter_mut().zip([1.0, arm.x, arm.y, arm.z]) {
                *sum += power * times;
            }
        }
    }
    sums
}

#[test]
fn receivers_see_in_lenses_what_light_side_rays_bring() {
    let scene = room();
    let tracer = Tracer::new(&scene);
    let solved = [true, false].map(|lenses| {
        let params = SolveParams { lenses, ..SolveParams::for_quality(Quality::Draft) };
        let solved = solve(&tracer, &params, &Silent).expect("a solution");
        assert_eq!(solved.report.lenses, usize::from(lenses));
        moments(&solved.solution)
    });
    // Some 10⁵ deposits leave .3 % of noise, and thousands of vertices, each of which sees 5 % too much or too little, less than that.
    for (seen, brought) in solved[0].iter().zip(solved[1]) {
        assert!((seen / brought - 1.0).abs() < 0.005, "{solved:?}");
    }
}
