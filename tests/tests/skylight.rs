//! Skylight end to end: through a window it is what a lamp in the window would send.

use catoptric_radiosity::{SolveParams, solve};
use catoptric_scene::{Material, Radiance, Rgb, Scene, SceneParts, Silent, Sky};
use catoptric_solution::{Quality, Solution, Term};
use catoptric_trace::Tracer;
use glam::Vec3;

const RADIANCE: Rgb = Rgb::new(6.0, 6.5, 7.0);

/// A room with a box in it and a window in the wall x = −2, before which is the sky, or in which is a lamp.
fn room(is_lamp: bool) -> Scene {
    let sky = (!is_lamp).then_some(Sky::Uniform(Radiance(RADIANCE)));
    let mut parts = SceneParts { sky, ..SceneParts::default() };
    let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.6)));
    let (x, y, z) = (Vec3::X, Vec3::Y, Vec3::Z);
    parts.add_quad("floor", white, Vec3::new(-2.0, 0.0, 2.0), 4.0 * x, -4.0 * z);
    parts.add_quad("ceiling", white, Vec3::new(-2.0, 2.5, -2.0), 4.0 * x, 4.0 * z);
    parts.add_quad("back", white, Vec3::new(-2.0, 0.0, -2.0), 4.0 * x, 2.5 * y);
    parts.add_quad("front", white, Vec3::new(2.0, 0.0, 2.0), -4.0 * x, 2.5 * y);
    parts.add_quad("right", white, Vec3::new(2.0, 0.0, -2.0), 4.0 * z, 2.5 * y);
    let mut wall = |low: [f32; 2], high: [f32; 2]| {
        let corner = Vec3::new(-2.0, low[0], low[1]);
        parts.add_quad("left", white, corner, (high[0] - low[0]) * y, (high[1] - low[1]) * z);
    };
    wall([0.0, -2.0], [2.5, -0.6]);
    wall([0.0, 0.7], [2.5, 2.0]);
    wall([0.0, -0.6], [0.8, 0.7]);
    wall([2.1, -0.6], [2.5, 0.7]);
    if is_lamp {
        let lamp = parts.add_material(Material::emitter("lamp", Radiance(RADIANCE)));
        parts.add_quad("lamp", lamp, Vec3::new(-2.0, 0.8, -0.6), 1.3 * y, 1.3 * z);
    }
    parts.add_box("box", white, Vec3::new(-0.6, 0.0, -0.9), Vec3::new(0.3, 0.8, -0.2), false);
    Scene::new(parts).expect("the room is valid")
}

fn solved(is_lamp: bool) -> Solution {
    let params = SolveParams::for_quality(Quality::Standard);
    solve(&Tracer::new(&room(is_lamp)), &params, &Silent).expect("not cancelled").solution
}

#[test]
fn a_window_to_the_sky_is_as_good_as_a_lamp_in_it() {
    let [by_sky, by_lamp] = [false, true].map(solved);
    // Where both have a vertex: those of the base mesh, which is the same.
    let light = |solution: &Solution| -> Vec<(Vec3, Vec3, [f32; 2])> {
        let of = |v: usize| [Term::Direct, Term::Indirect].map(|t| solution.irradiance[t.index()][v].y);
        solution.mesh.vertices.iter().enumerate().map(|(v, at)| (at.position, at.normal, of(v))).collect()
    };
    let [sky, lamp] = [&by_sky, &by_lamp].map(light);
    let mut sums = [[0.0_f64; 3]; 2];
    let mut pairs = 0;
    for (position, normal, own) in &lamp {
        let same = |(p, n, _): &&(Vec3, Vec3, _)| p.distance(*position) < 1e-5 && n.dot(*normal) > 0.99;
        let Some((.., other)) = sky.iter().find(same) else { continue };
        // At the foot of the box several sides meet: only what lies alone.
        if position.y < 0.9 && (-0.7..0.4).contains(&position.x) && (-1.0..-0.1).contains(&position.z) {
            continue;
        }
        pairs += 1;
        for (sums, (own, other)) in sums.iter_mut().zip(own.iter().zip(other)) {
            sums[0] += f64::from(*own);
            sums[1] += f64::from(*other);
            sums[2] += f64::from((own - other).abs());
        }
    }
    assert!(pairs > 500, "{pairs}");
    let [direct, indirect] = sums;
    // Lambert's formula has no noise. Of the sky 0.4/√32 is left uncertain at each vertex, and the fit halves that by what those
    // around say. All of them together are as good as the mean of some hundred.
    assert!(direct[2] / direct[0] < 0.5 * 0.4 / 32_f64.sqrt(), "{direct:?}");
    assert!((direct[1] / direct[0] - 1.0).abs() < 0.005, "{direct:?}");
    // Both are gathers with noise of 1 to 2 % each.
    assert!(indirect[2] / indirect[0] < 0.04, "{indirect:?}");
    assert!((indirect[1] / indirect[0] - 1.0).abs() < 0.01, "{indirect:?}");
}
