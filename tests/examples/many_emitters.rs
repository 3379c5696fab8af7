//! What many emitters cost: a box whose lamp is one quad, the same lamp as 20 000 bumpy triangles in one mesh, and 20 000
//! triangles in 2500 small octahedra, of the same power; seconds of pass one and of the whole at `--quality standard`.
//!
//! `cargo run --profile fast -p catoptric-tests --example many_emitters`

use std::f32::consts::PI;
use std::time::Instant;

use catoptric_radiosity::{SolveParams, solve};
use catoptric_render::{RenderParams, render};
use catoptric_scene::{Camera, Material, Projection, Radiance, Rgb, Scene, SceneParts, Silent};
use catoptric_solution::Quality;
use catoptric_trace::Tracer;
use glam::{Affine3A, Vec3};

/// Which lamp hangs below the ceiling.
#[derive(Clone, Copy, Debug)]
enum Lamp {
    Quad,
    Mesh,
    Scattered,
}

/// Edge of the lamp's square, and where it hangs.
const SIZE: f32 = 0.5;
const HEIGHT: f32 = 1.95;
/// Squares on a side of the mesh, octahedra on a side of their grid.
const SQUARES: u32 = 100;
const BODIES: u32 = 50;

fn scene(lamp: Lamp) -> Scene {
    let mut parts = SceneParts::default();
    let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.7)));
    let red = parts.add_material(Material::lambertian("red", Rgb::new(0.6, 0.1, 0.1)));
    let (x, y, z) = (2.0 * Vec3::X, 2.0 * Vec3::Y, 2.0 * Vec3::Z);
    let corner = Vec3::new(-1.0, 0.0, -1.0);
    parts.add_quad("floor", white, corner, z, x);
    parts.add_quad("ceiling", white, corner + y, x, z);
    parts.add_quad("back", white, corner, x, y);
    parts.add_quad("left", red, corner, y, z);
    parts.add_quad("right", red, corner + x, z, y);
    parts.add_box("box", white, Vec3::new(-0.6, 0.0, -0.6), Vec3::new(0.0, 1.1, 0.0), false);
    // Each sends π·10·SIZE².
    let power = 10.0 * PI * SIZE * SIZE;
    let from = Vec3::new(-0.5 * SIZE, HEIGHT, -0.5 * SIZE);
    let (mut positions, mut triangles) = (Vec::new(), Vec::new());
    match lamp {
        Lamp::Quad => {
            positions.extend([
                from,
                from + SIZE * Vec3::X,
                from + SIZE * (Vec3::X + Vec3::Z),
                from + SIZE * Vec3::Z,
            ]);
            triangles.extend([[0, 1, 2], [0, 2, 3]]);
        }
        Lamp::Mesh => {
            let step = SIZE / SQUARES as f32;
            let row = SQUARES + 1;
            for k in 0..row * row {
                let (i, j) = (k % row, k / row);
                let bump = 0.1 * step * ((i * 7 + j * 13) % 5) as f32;
                positions.push(from + Vec3::new(i as f32 * step, bump, j as f32 * step));
            }
            for k in 0..SQUARES * SQUARES {
                let a = k % SQUARES + k / SQUARES * row;
                triangles.extend([[a, a + 1, a + row + 1], [a, a + row + 1, a + row]]);
            }
        }
        Lamp::Scattered => {
            let step = SIZE / BODIES as f32;
            for k in 0..BODIES * BODIES {
                let (i, j) = (k % BODIES, k / BODIES);
                let lift = -0.02 * ((i * 7 + j * 13) % 11) as f32;
                let center = from + Vec3::new((i as f32 + 0.5) * step, lift, (j as f32 + 0.5) * step);
                let first = positions.len() as u32;
                let r = 0.3 * step;
                positions.extend(
                    [Vec3::X, Vec3::NEG_X, Vec3::Y, Vec3::NEG_Y, Vec3::Z, Vec3::NEG_Z]
                        .map(|d| center + r * d),
                );
                for (p, q, s) in [(0, 2, 4), (2, 1, 4), (1, 3, 4), (3, 0, 4)] {
                    triangles.extend([[p, q, s], [q, p, 5]].map(|t| t.map(|v| v + first)));
                }
            }
        }
    }
    let area = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| positions[v as usize]);
        0.5 * (b - a).cross(c - a).length()
    };
    let radiance = power / (PI * triangles.iter().map(area).sum::<f32>());
    let glowing = parts.add_material(Material::emitter("lamp", Radiance(Rgb::splat(radiance))));
    parts.add_triangles("lamp", glowing, &positions, &triangles);
    parts.cameras.push(Camera {
        name: "camera".to_owned(),
        world_from_camera: Affine3A::from_translation(Vec3::new(0.0, 1.0, 3.6)),
        projection: Projection::Perspective { yfov: 0.75 },
        aspect: Some(1.0),
        near: 0.0,
    });
    Scene::new(parts).expect("the scene is valid")
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut first = None;
    for lamp in [Lamp::Quad, Lamp::Mesh, Lamp::Scattered] {
        let scene = scene(lamp);
        let mut best = [f64::INFINITY; 2];
        let mut shadow = 0;
        for _ in 0..3 {
            let start = Instant::now();
            let tracer = Tracer::new(&scene);
            let solved = solve(&tracer, &SolveParams::for_quality(Quality::Standard), &Silent)?;
            let pass_one = start.elapsed().as_secs_f64();
            let params = RenderParams::for_quality(Quality::Standard, 256, 256);
            render(&tracer, &solved.solution, &scene.cameras()[0], &params, &Silent)?;
            let whole = start.elapsed().as_secs_f64();
            best = [best[0].min(pass_one), best[1].min(whole)];
            shadow = solved.report.rays.first().map_or(0, |r| r.1);
        }
        let times = best[1] / *first.get_or_insert(best[1]);
        println!(
            "{lamp:?}: {} triangles, pass one {:.2} s, whole {:.2} s ({times:.1} times the quad), {shadow} shadow rays",
            scene.triangles().len(),
            best[0],
            best[1]
        );
    }
    Ok(())
}
