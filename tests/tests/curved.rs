//! Light on curved meshes: where other things cross them, and where all of it comes from a small bright place.

use catoptric_radiosity::{SolveParams, Solved, solve};
use catoptric_scene::{Barycentric, Material, MaterialId, Radiance, Rgb, Scene, SceneParts, Silent};
use catoptric_solution::{Quality, Term};
use catoptric_tests::white_room;
use catoptric_trace::Tracer;
use glam::Vec3;

fn solved(scene: &Scene, seed: u32) -> Solved {
    let params = SolveParams { seed, ..SolveParams::for_quality(Quality::Standard) };
    solve(&Tracer::new(scene), &params, &Silent).expect("not cancelled")
}

/// Irradiance, channels added, at the vertices that lie where `is_there`, with their places.
fn light_where(solved: &Solved, is_there: impl Fn(Vec3) -> bool) -> Vec<(Vec3, f64)> {
    let solution = &solved.solution;
    let light = |v: usize| {
        Term::ALL.iter().map(|t| f64::from(solution.irradiance[t.index()][v].element_sum())).sum::<f64>()
    };
    let vertices = solution.mesh.vertices.iter().enumerate().filter(|(_, v)| is_there(v.position));
    vertices.map(|(index, v)| (v.position, light(index))).collect()
}

/// A smooth column of 32 sides and the radius 0.2 m, between two heights.
fn add_column(parts: &mut SceneParts, white: MaterialId, low: f32, high: f32) {
    let (mut positions, mut normals, mut indices) = (Vec::new(), Vec::new(), Vec::new());
    for k in 0..32_u32 {
        let (sin, cos) = libm::sincosf(k as f32 * std::f32::consts::TAU / 32.0);
        let normal = Vec3::new(cos, 0.0, sin);
        positions.extend([0.2 * normal + Vec3::Y * low, 0.2 * normal + Vec3::Y * high]);
        normals.extend([normal; 2]);
        let [a, b, next_a, next_b] = [2 * k, 2 * k + 1, (2 * k + 2) % 64, (2 * k + 3) % 64];
        indices.extend([[a, b, next_b], [a, next_b, next_a]]);
    }
    parts.add_mesh("column", white, &positions, &normals, &indices, true);
}

/// What stands in a plinth is lit like what stands on it: the dark inside does not show above.
#[test]
fn a_column_in_its_plinth_is_as_bright_as_one_on_it() {
    let top = 0.31;
    let [inside, on_top] = [0.0, top].map(|foot| {
        let (mut parts, white) = white_room();
        let lamp = parts.add_material(Material::emitter("lamp", Radiance(Rgb::new(12.0, 11.0, 10.0))));
        parts.add_quad("lamp", lamp, Vec3::new(0.5, 2.19, 0.3), 0.6 * Vec3::X, 0.6 * Vec3::Z);
        parts.add_box("plinth", white, Vec3::new(-0.4, 0.0, -0.4), Vec3::new(0.4, top, 0.4), false);
        add_column(&mut parts, white, foot, 1.8);
        solved(&Scene::new(parts).expect("the room is valid"), 0)
    });
    let inner = light_where(&inside, |p| {
        (0.01..top - 0.05).contains(&p.y) && (p.with_y(0.0).length() - 0.2).abs() < 0.005
    });
    // A thousandth of what is above.
    assert!(!inner.is_empty() && inner.iter().all(|(_, light)| *light < 1e-3), "light inside of the plinth");
    // A band just above it; what lies on the joint belongs to both sides.
    let [band, other] = [&inside, &on_top].map(|solved| {
        light_where(solved, |p| {
            (top + 0.002..top + 0.06).contains(&p.y) && (p.with_y(0.0).length() - 0.2).abs() < 0.005
        })
    });
    assert!(band.len() > 64 && other.len() > 64, "{} and {}", band.len(), other.len());
    let (mut differences, mut sum) = (0.0, 0.0);
    for (p, light) in band {
        let nearest = other.iter().min_by(|(a, _), (b, _)| a.distance(p).total_cmp(&b.distance(p)));
        let nearest = nearest.expect("the band has vertices").1;
        differences += (light - nearest).abs();
        sum += nearest;
    }
    // What refinement leaves alone at this quality, and the noise of gathers, of which there are two: 1.3 % each (below).
    let allowed = 0.02 + 0.02;
    assert!(differences / sum < allowed, "{} of the light differs", differences / sum);
}

/// All light of the room is what a small lamp throws on the ceiling beside it: few rays find it.
#[test]
fn a_ball_in_light_from_a_small_bright_place_is_even() {
    let (mut parts, white) = white_room();
    let lamp = parts.add_material(Material::emitter("lamp", Radiance(Rgb::splat(400.0))));
    parts.add_quad("lamp", lamp, Vec3::new(-1.2, 1.95, 1.0), 0.1 * Vec3::Z, 0.1 * Vec3::X);
    parts.add_sphere("ball", white, Vec3::new(0.4, 0.3, -0.3), 0.25, 40);
    let scene = Scene::new(parts).expect("the room is valid");
    let is_there = |p: Vec3| ((p - Vec3::new(0.4, 0.3, -0.3)).length() - 0.25).abs() < 0.01;
    let [one, other] = [1, 2].map(|seed| light_where(&solved(&scene, seed), is_there));
    assert!(one.len() > 1000 && one.len() == other.len(), "{} and {}", one.len(), other.len());
    let squares: f64 = one.iter().zip(&other).map(|((_, a), (_, b))| (2.0 * (a - b) / (a + b)).powi(2)).sum();
    let deviation = (squares / (2.0 * one.len() as f64)).sqrt();
    // Rays are shared out so that gathers deviate by USUAL_DEVIATION/√n of their light, with n = 64 at this quality.
    assert!(deviation < 0.4 / 8.0, "{deviation}");
}

/// However far corners turn away from each other, vertices between them have the normal that the eye and the path tracers see there:
/// that of the triangle, interpolated once.
#[test]
fn vertices_of_a_coarse_smooth_mesh_have_the_normals_of_the_scene() {
    let (mut parts, white) = white_room();
    let lamp = parts.add_material(Material::emitter("lamp", Radiance(Rgb::new(12.0, 11.0, 10.0))));
    parts.add_quad("lamp", lamp, Vec3::new(0.5, 2.19, 0.3), 0.6 * Vec3::X, 0.6 * Vec3::Z);
    let normals = [Vec3::X, Vec3::NEG_X, Vec3::Y, Vec3::NEG_Y, Vec3::Z, Vec3::NEG_Z];
    let corners = normals.map(|n| Vec3::new(0.0, 1.0, 0.0) + 0.5 * n);
    let faces = [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]].map(
        |[a, b, c]| {
            let turned = (corners[b] - corners[a]).cross(corners[c] - corners[a]).dot(normals[a]) > 0.0;
            if turned { [a, b, c].map(|v| v as u32) } else { [a, c, b].map(|v| v as u32) }
        },
    );
    parts.add_mesh("octahedron", white, &corners, &normals, &faces, true);
    let scene = Scene::new(parts).expect("the room is valid");
    let solution = solved(&scene, 0).solution;
    let mut inside = 0;
    for vertex in &solution.mesh.vertices {
        if scene.surface_of(vertex.triangle).name != "octahedron" {
            continue;
        }
        let [a, b, c] = scene.corners(vertex.triangle);
        let (e, f, p) = (b - a, c - a, vertex.position - a);
        let n = e.cross(f);
        let [u, v] = [p.cross(f), e.cross(p)].map(|area| area.dot(n) / n.length_squared());
        let expected = scene.shading_normal(vertex.triangle, Barycentric { u, v });
        // Positions of 1 m round by 6e-8, a ten-millionth of the edges, along which normals turn by a right angle; a few times.
        assert!(vertex.normal.distance(expected) < 2e-6, "{}: {} {expected}", vertex.position, vertex.normal);
        inside += u32::from(u.min(v).min(1.0 - u - v) > 0.05);
    }
    assert!(inside > 100, "{inside} vertices inside the triangles");
}
