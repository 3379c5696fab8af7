//! Lamps through the windows of mirrors, against points on them.

use catoptric_light::contour::Polygon;
use catoptric_light::emitter::Emitters;
use catoptric_light::lamp::Beyond;
use catoptric_light::light_tree::Windows;
use catoptric_scene::{Barycentric, Material, MaterialId, Radiance, Rgb, Scene, SceneParts, TriangleId};
use catoptric_trace::Tracer;
use catoptric_trace::plane::Plane;
use catoptric_trace::sequence::{Key, Purpose, triangle_point};
use glam::{DVec3, Quat, Vec3};

fn point(key: Key, index: u32) -> DVec3 {
    let [a, b] = [key.point2(index), key.child(1).point2(index)];
    DVec3::new(f64::from(a.x), f64::from(a.y), f64::from(b.x)) * 2.0 - 1.0
}

/// The side of a long cylinder, open at its ends.
fn add_tube(parts: &mut SceneParts, material: MaterialId) {
    const COUNT: u32 = 16;
    let at = |k: u32| Quat::from_rotation_y(k as f32 / COUNT as f32 * std::f32::consts::TAU) * Vec3::X;
    let positions: Vec<Vec3> =
        (0..2 * COUNT).map(|k| at(k % COUNT) * 0.04 + Vec3::Y * if k < COUNT { -0.7 } else { 0.7 }).collect();
    let quad = |k: u32| [k, (k + 1) % COUNT, COUNT + (k + 1) % COUNT, COUNT + k];
    let triangles: Vec<[u32; 3]> =
        (0..COUNT).map(quad).flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    parts.add_triangles("tube", material, &positions, &triangles);
}

/// What a lamp is said to show through a window in a mirror's plane, and before that plane, holds for points on its surface; and
/// hardly ever is it said to show something that it does not.
#[test]
fn what_a_lamp_shows_through_a_mirror_is_known() {
    const COUNT: u32 = 4000;
    type Build = fn(&mut SceneParts, MaterialId);
    let cases: [(&str, Build); 3] = [
        ("tube", add_tube),
        ("plate", |p, m| {
            p.add_box("lamp", m, Vec3::new(-0.6, -0.02, -0.2), Vec3::new(0.6, 0.02, 0.2), false);
        }),
        ("ball", |p, m| p.add_sphere("lamp", m, Vec3::ZERO, 0.4, 24)),
    ];
    for (name, build) in cases {
        let mut parts = SceneParts::default();
        let glowing = parts.add_material(Material::emitter("glowing", Radiance(Rgb::splat(3.0))));
        build(&mut parts, glowing);
        let turn = Quat::from_axis_angle(Vec3::new(0.6, 0.0, 0.8), 0.7);
        parts.vertices.iter_mut().for_each(|v| v.position = turn * v.position);
        parts.vertices.iter_mut().for_each(|v| v.normal = turn * v.normal);
        let scene = Scene::new(parts).expect("a valid scene");
        let tracer = Tracer::new(&scene);
        let emitters = Emitters::new(&tracer);
        let [lamp] = emitters.lamps() else { panic!("{name}: {} lamps", emitters.lamps().len()) };
        let key = Key::new(5, Purpose::Test, 0);
        let count = scene.triangles().len() as u32;
        let places: Vec<DVec3> = (0..8192)
            .map(|index| {
                let (u, v) = triangle_point(key.child(9).point2(index));
                scene.position(TriangleId(index % count), Barycentric { u, v }).as_dvec3()
            })
            .collect();
        // Shown, and said to be; cut by the plane, and said to be.
        let [mut shown, mut said, mut cut, mut said_cut] = [0; 4];
        let mut buffer = Vec::new();
        for index in 0..COUNT {
            let eye = point(key, index) * 1.5;
            let corner = point(key.child(2), index) * 0.8;
            let [a, b] = [3, 4].map(|child| point(key.child(child), index) * 0.5);
            let Some(normal) = a.cross(b).try_normalize() else { continue };
            let normal = if normal.dot(eye - corner) > 0.0 { -normal } else { normal };
            let plane = Plane { normal, offset: normal.dot(corner) };
            let mut windows = Windows::default();
            windows.add(eye, &[Polygon::new(&[corner, corner + a, corner + a + b, corner + b])]);
            let is_seen = |p: &&DVec3| windows.may_show(**p - eye, 0.0);
            let seen: Vec<&DVec3> = places.iter().filter(is_seen).collect();
            let may_be_seen = lamp.may_be_seen(eye, &windows);
            assert!(may_be_seen || seen.is_empty(), "{name}, {index}: {} points are seen", seen.len());
            shown += u32::from(!seen.is_empty());
            said += u32::from(may_be_seen);
            let before = seen.iter().filter(|p| plane.distance(***p) > 0.0).count();
            match lamp.beyond(Some(plane), eye, &windows, &mut buffer) {
                Beyond::No => assert_eq!(before, 0, "{name}, {index}"),
                // Points of f32 in the plane or on the edge of a window: none here.
                Beyond::Wholly => assert_eq!(before, seen.len(), "{name}, {index}"),
                Beyond::Partly => said_cut += u32::from(may_be_seen),
            }
            cut += u32::from(before > 0 && before < seen.len());
        }
        assert!(shown > 200 && cut > 20, "{name}: {shown} shown, {cut} cut");
        // Frusta beside a lamp may hold it by each of their planes. By a ball around them, tube and plate were said to be shown in .85 and .73 of the
        // windows in which they are not, and cut in .76 and .66.
        let wrongly = |said: u32, is: u32| f64::from(said - is) / f64::from(COUNT - is);
        let [shown, cut] = [wrongly(said, shown), wrongly(said_cut, cut)];
        assert!(shown < 0.5 && cut < 0.3, "{name}: {shown} wrongly said to be shown, {cut} to be cut");
    }
}
