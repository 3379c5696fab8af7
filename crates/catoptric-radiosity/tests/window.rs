//! Sharp patches of light on a floor: what passes a window arrives.

use glam::{DVec3, Vec3};

use catoptric_light::contour::{self, Polygon};
use catoptric_radiosity::{SolveParams, solve};
use catoptric_scene::{Material, Radiance, Rgb, Scene, SceneParts, Silent};
use catoptric_solution::{Quality, Term};
use catoptric_trace::Tracer;

/// Half of the edges of the floor, and of the roof above it, metres: no light passes beside the roof.
const FLOOR: f32 = 5.0;
const ROOF: f32 = 8.0;
const HEIGHT: f32 = 1.5;
/// Edges of the panes along x and z, in the roof, metres; what is between them are bars.
const ALONG_X: [[f32; 2]; 2] = [[-1.3, -0.72], [-0.68, 0.0]];
const ALONG_Z: [[f32; 2]; 2] = [[-0.7, -0.05], [-0.01, 0.9]];
/// From the window to a lamp that is so far that its light is linear over a pane: from the middle of one it is 0.46 m to its edge, at most, and what is not
/// linear is of the order of the square of that over 45 m, 1e-4.
const TO_LAMP: Vec3 = Vec3::new(-24.0, 38.0, 5.0);
const LAMP: f32 = 0.25;
const RADIANCE: f32 = 3e4;

/// A roof with four panes, and its lamp.
fn room() -> (Scene, [Vec3; 4]) {
    let mut parts = SceneParts::default();
    let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
    let sun = parts.add_material(Material::emitter("sun", Radiance(Rgb::splat(RADIANCE))));
    let from = Vec3::new(-FLOOR, 0.0, FLOOR);
    parts.add_quad("floor", white, from, Vec3::X * (2.0 * FLOOR), Vec3::Z * (-2.0 * FLOOR));
    // Strips across the window, between them its bars.
    let mut piece = |[x0, x1]: [f32; 2], [z0, z1]: [f32; 2]| {
        let from = Vec3::new(x0, HEIGHT, z0);
        parts.add_quad("roof", white, from, Vec3::X * (x1 - x0), Vec3::Z * (z1 - z0));
    };
    let [[left, _], [_, right]] = ALONG_X;
    piece([-ROOF, left], [-ROOF, ROOF]);
    piece([right, ROOF], [-ROOF, ROOF]);
    let [[back, before], [after, front]] = ALONG_Z;
    for across in [[-ROOF, back], [before, after], [front, ROOF]] {
        piece([left, right], across);
    }
    for between in ALONG_Z {
        piece([ALONG_X[0][1], ALONG_X[1][0]], between);
    }
    let middle = Vec3::Y * HEIGHT + TO_LAMP;
    let (u, v) = (TO_LAMP.cross(Vec3::Z).normalize_or_zero() * LAMP, Vec3::Z * LAMP);
    let corner = middle - u - v;
    // Shining down.
    parts.add_quad("sun", sun, corner, 2.0 * u, 2.0 * v);
    let corners = [corner, corner + 2.0 * u, corner + 2.0 * (u + v), corner + 2.0 * v];
    (Scene::new(parts).expect("a valid scene"), corners)
}

/// Power through the panes, watts.
fn passes(lamp: &[Vec3; 4]) -> f64 {
    let lamp = Polygon::new(&lamp.map(|c| c.as_dvec3()));
    let mut power = 0.0;
    for [x0, x1] in ALONG_X {
        for [z0, z1] in ALONG_Z {
            // The middle tells the mean of what is linear.
            let at = DVec3::new(f64::from(x0 + x1) / 2.0, f64::from(HEIGHT), f64::from(z0 + z1) / 2.0);
            let area = f64::from((x1 - x0) * (z1 - z0));
            power += area * f64::from(RADIANCE) * contour::irradiance(at, DVec3::Y, &lamp);
        }
    }
    power
}

/// Edges are halved where light on them is off by more than a share of it that the quality says: what deviates so in each of
/// hundreds of elements is off by a twentieth of it, or less, in their sum.
#[test]
fn patches_of_light_hold_what_passes_the_window() {
    let (scene, lamp) = room();
    let tracer = Tracer::new(&scene);
    let expected = passes(&lamp);
    for seed in 0..4 {
        let params = SolveParams { seed, ..SolveParams::for_quality(Quality::Standard) };
        let solution = solve(&tracer, &params, &Silent).expect("nobody stops it").solution;
        let (mesh, direct) = (&solution.mesh, &solution.irradiance[Term::Direct.index()]);
        let mut arrives = 0.0;
        for (index, element) in mesh.elements.iter().enumerate() {
            let [a, ..] = element.vertices;
            if scene.surface_of(mesh.vertices[a as usize].triangle).name == "floor" {
                let sum: f64 = element.vertices.iter().map(|&v| f64::from(direct[v as usize].x)).sum();
                arrives += f64::from(mesh.area(index as u32)) * sum / 3.0;
            }
        }
        let ratio = arrives / expected;
        let tolerance = 0.05 * f64::from(params.sources.tolerance);
        assert!((ratio - 1.0).abs() < tolerance, "seed {seed}: {ratio}, within {tolerance}");
    }
}
