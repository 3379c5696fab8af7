//! A tube of perfect mirrors: a lamp that closes one end is seen from everywhere as if it closed the other.

use std::f32::consts::PI;

use glam::{DVec3, Vec3};

use catoptric_light::contour::{self, Polygon};
use catoptric_light::{LightParams, Lights, Owner, Source};
use catoptric_radiosity::{SolveParams, solve};
use catoptric_scene::{Material, Radiance, Rgb, Scene, SceneParts, Silent};
use catoptric_solution::{Quality, Term};
use catoptric_trace::{Chain, Event, PlaneId, Tracer};

const SIDES: u16 = 6;
/// Of the tube, metres, and of the lamp.
const RADIUS: f32 = 0.15;
const LENGTH: f32 = 0.6;
const RADIANCE: f32 = 50.0;
/// Depth of the floor below the mouth, and half of its edge, metres.
const DEPTH: f32 = 0.8;
const HALF: f32 = 2.0;

/// Corners of the tube at a height, counter-clockwise from above.
fn ring(height: f32) -> Vec<Vec3> {
    let corner = |k: u16| {
        let (sin, cos) = libm::sincosf(2.0 * PI * (f32::from(k) + 0.3) / f32::from(SIDES));
        Vec3::new(RADIUS * cos, height, -RADIUS * sin)
    };
    (0..SIDES).map(corner).collect()
}

fn pipe() -> Scene {
    let mut parts = SceneParts::default();
    let black = parts.add_material(Material::lambertian("black", Rgb::splat(1e-3)));
    let silver = parts.add_material(Material::mirror("silver", Rgb::ONE));
    let lamp = parts.add_material(Material::emitter("lamp", Radiance(Rgb::splat(RADIANCE))));
    parts.add_quad(
        "floor",
        black,
        Vec3::new(-HALF, -DEPTH, HALF),
        Vec3::X * (2.0 * HALF),
        Vec3::Z * (-2.0 * HALF),
    );
    let (low, high) = (ring(0.0), ring(LENGTH));
    for k in 0..usize::from(SIDES) {
        let next = (k + 1) % usize::from(SIDES);
        // Reflecting inwards.
        parts.add_quad("tube", silver, low[k], high[k] - low[k], low[next] - low[k]);
    }
    let normals = vec![-Vec3::Y; usize::from(SIDES)];
    let fan: Vec<[u32; 3]> = (1..u32::from(SIDES) - 1).map(|k| [0, k + 1, k]).collect();
    parts.add_mesh("lamp", lamp, &high, &normals, &fan, false);
    Scene::new(parts).expect("a valid scene")
}

/// A chain belongs to one term, whichever end it is followed from: to images where it is listed, in the order from the receiver on, and to
/// light-side rays where it is not.
#[test]
fn a_chain_has_one_owner_from_both_ends() {
    let scene = pipe();
    let tracer = Tracer::new(&scene);
    let lights = Lights::new(&tracer, LightParams::default());
    let planes: Vec<PlaneId> = lights.chains().reflectors().iter().map(|r| r.id).collect();
    let chain = |planes: &[PlaneId]| {
        let mut chain = Chain::DIRECT;
        planes.iter().for_each(|&plane| chain.push(Event::Planar(plane)));
        chain
    };
    let (mut one_way, mut unlisted) = (0, 0);
    for index in 0..planes.len().pow(3) {
        let count = planes.len();
        let way = [index % count, index / count % count, index / count / count].map(|k| planes[k]);
        let back = [way[2], way[1], way[0]];
        let is_listed = lights.chains().contains(&way);
        let owner = lights.owner(Source::Concentrated, &chain(&way));
        assert_eq!(owner, if is_listed { Owner::ImageChain } else { Owner::LightRays });
        assert_eq!(lights.owner_from_light(&chain(&back)), owner);
        unlisted += usize::from(!is_listed);
        one_way += usize::from(is_listed && !lights.chains().contains(&back));
    }
    assert!(one_way > 0 && unlisted > 0, "{one_way} are listed one way, {unlisted} not at all");
}

/// Like triangles along each edge of one that is integrated over, and all of them.
const ROWS: u8 = 8;
const PARTS: f64 = (ROWS * ROWS) as f64;

/// The middles of like parts of a triangle.
fn middles([a, b, c]: [DVec3; 3]) -> impl Iterator<Item = DVec3> {
    let rows = (0..ROWS).flat_map(|i| (0..ROWS - i).map(move |j| (i, j)));
    let parts = rows.flat_map(|(i, j)| {
        // One the way of the triangle, and one the other way round where it is inside.
        [(i, j, 1.0 / 3.0), (i, j, 2.0 / 3.0)].into_iter().take(if i + j + 1 < ROWS { 2 } else { 1 })
    });
    parts.map(move |(i, j, middle)| {
        let [u, v] = [i, j].map(|k| (f64::from(k) + middle) / f64::from(ROWS));
        a + (b - a) * u + (c - a) * v
    })
}

/// Chains of mirrors are more than are listed; light over the others is followed from the lamp, which touches the mirrors.
///
/// Rays are sent until their noise is below a share of the light that the quality says, and edges are halved where light on them is off by
/// more than another: the root of the sum of both squares, as a mean over the floor, relative to all light and the floor below which
/// errors count as much. What deviates so in each of hundreds of elements is off by a twentieth of it, or less, in their sum.
#[test]
fn a_lamp_at_one_end_is_as_bright_at_the_other() {
    let scene = pipe();
    let tracer = Tracer::new(&scene);
    assert!(Lights::new(&tracer, LightParams::default()).chains().are_cut_short());
    let corners: Vec<DVec3> = ring(0.0).iter().map(|c| c.as_dvec3()).collect();
    let mouth = Polygon::new(&corners);
    for quality in [Quality::Draft, Quality::Standard] {
        let params = SolveParams::for_quality(quality);
        let tolerance = params.caustic.noise.hypot(params.sources.tolerance);
        let solution = solve(&tracer, &params, &Silent).expect("nobody stops it").solution;
        let mesh = &solution.mesh;
        // Per corner of an element: its share of the area, what is found there, and what should be.
        let mut corners: Vec<[f64; 3]> = Vec::new();
        let exact = |at: DVec3| f64::from(RADIANCE) * contour::irradiance(at, DVec3::Y, &mouth);
        // All that arrives: the mean of what should be at corners is off by as much as elements are coarse, .4 % in a draft.
        let mut arrives = 0.0;
        for (index, element) in mesh.elements.iter().enumerate() {
            let vertices = element.vertices.map(|v| &mesh.vertices[v as usize]);
            if scene.surface_of(vertices[0].triangle).name == "floor" {
                let middle = middles(vertices.map(|v| v.position.as_dvec3()));
                arrives += f64::from(mesh.area(index as u32)) * middle.map(exact).sum::<f64>() / PARTS;
            }
            for v in element.vertices {
                let vertex = &mesh.vertices[v as usize];
                if scene.surface_of(vertex.triangle).name == "floor" {
                    let all = Term::ALL.map(|term| solution.irradiance[term.index()][v as usize].x);
                    let area = f64::from(mesh.area(index as u32)) / 3.0;
                    let expected = exact(vertex.position.as_dvec3());
                    corners.push([area, f64::from(all.iter().sum::<f32>()), expected]);
                }
            }
        }
        let area: f64 = corners.iter().map(|c| c[0]).sum();
        let mean =
            |of: &dyn Fn(f64, f64) -> f64| corners.iter().map(|c| c[0] * of(c[1], c[2])).sum::<f64>() / area;
        let (found, expected) = (mean(&|found, _| found), mean(&|_, exact| exact));
        let floor = f64::from(params.sources.floor) * expected;
        let deviation = mean(&|found, exact| ((found - exact) / (exact + floor)).powi(2)).sqrt();
        assert!(deviation < f64::from(tolerance), "{quality:?}: {deviation}, up to {tolerance}");
        let ratio = found * area / arrives;
        assert!((ratio - 1.0).abs() < 0.05 * f64::from(tolerance), "{quality:?}: {ratio}");
    }
}
