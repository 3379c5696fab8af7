//! Pyramids of shadow rays against the rays themselves.

use std::ops::Range;

use catoptric_scene::{AlphaMode, Material, MaterialId, Rgb, Scene, SceneParts, TriangleId};
use catoptric_trace::beam::{Base, End, Pyramid, Suspects};
use catoptric_trace::sequence::{Key, Purpose};
use catoptric_trace::{PlaneId, Tracer};
use glam::{DVec3, Vec3};

fn white(parts: &mut SceneParts) -> MaterialId {
    parts.add_material(Material::lambertian("white", Rgb::splat(0.5)))
}

fn point(key: Key, index: u32) -> Vec3 {
    let [a, b] = [key.point2(index), key.child(1).point2(index)];
    Vec3::new(a.x, a.y, b.x) * 2.0 - 1.0
}

/// What says that it is empty is: no shadow ray in it is blocked. And it says so of most that are.
#[test]
fn an_empty_pyramid_has_no_shadow() {
    let mut parts = SceneParts::default();
    let wall = white(&mut parts);
    parts.add_box("room", wall, Vec3::splat(-1.0), Vec3::ONE, true);
    parts.add_box("block", wall, Vec3::new(-0.5, -1.0, -0.3), Vec3::new(0.0, -0.2, 0.3), false);
    parts.add_sphere("ball", wall, Vec3::new(0.5, -0.7, 0.2), 0.3, 16);
    let scene = Scene::new(parts).expect("a valid scene");
    let tracer = Tracer::new(&scene);
    let key = Key::new(4, Purpose::Test, 0);
    let lamp = [(0.2, 0.2), (0.6, 0.2), (0.6, 0.6), (0.2, 0.6)].map(|(x, z)| DVec3::new(x, 0.99, z));
    let base = Base::around(&lamp).expect("a polygon");
    let (mut empty, mut unblocked, mut blocked) = (0, 0, 0);
    for index in 0..3000 {
        // On the floor and on the walls, in their planes.
        let at = point(key, index);
        let (position, normal) = if index % 2 == 0 {
            (Vec3::new(at.x, -1.0, at.z), Vec3::Y)
        } else {
            (Vec3::new(-1.0, at.y, at.z), Vec3::X)
        };
        let triangle = (0..scene.triangles().len() as u32)
            .map(TriangleId)
            .find(|&t| {
                scene.geometric_normal(t).dot(normal) > 0.99
                    && (scene.corners(t)[0] - position).dot(normal).abs() < 1e-6
            })
            .expect("a wall");
        let from = tracer.planes().of(triangle);
        let eye = position.as_dvec3();
        let near = End::new(eye, normal.as_dvec3(), from);
        let far = End::behind(&base, eye, PlaneId::NONE).expect("a polygon");
        let mut suspects = Suspects::default();
        let pyramid = Pyramid::new(eye, &base, near, far, 0..0);
        let says = pyramid.is_some_and(|p| tracer.suspects_in(&p, 0, &mut suspects));
        let seen = (0..256).all(|ray| {
            let at = key.child(9).child(index).point2(ray);
            let target = Vec3::new(0.2 + 0.4 * at.x, 0.99, 0.2 + 0.4 * at.y);
            tracer.visibility(position, from, target, PlaneId::NONE) != Rgb::ZERO
        });
        assert!(seen || !says, "{position} is said to see all of the lamp");
        empty += u32::from(says);
        unblocked += u32::from(seen);
        blocked += u32::from(!seen);
    }
    assert!(blocked > 500, "{blocked} in shadow");
    assert!(empty * 10 > unblocked * 9, "{empty} of {unblocked} without shadow are told");
}

/// A wall that stands right before an eye is in the way, also where positions are rounded to a few thousandths of a millimetre.
#[test]
fn what_stands_right_before_an_eye_is_not_taken_for_what_touches_its_view() {
    for center in [Vec3::ZERO, Vec3::new(30.0, 10.0, -50.0)] {
        for gap in [1e-2_f32, 1e-3, 1e-4, 3e-5] {
            let mut parts = SceneParts::default();
            let grey = white(&mut parts);
            parts.add_quad("floor", grey, center - Vec3::new(1.5, 0.0, 1.5), Vec3::Z * 3.0, Vec3::X * 3.0);
            parts.add_quad("wall", grey, center + Vec3::new(gap, 0.0, -0.3), Vec3::Z * 0.6, Vec3::Y * 0.05);
            let scene = Scene::new(parts).expect("a valid scene");
            let tracer = Tracer::new(&scene);
            let eye = center.as_dvec3();
            let lamp = [(0.0, 0.0), (0.2, 0.0), (0.2, 0.2), (0.0, 0.2)]
                .map(|(y, z)| eye + DVec3::new(0.9, 0.6 + y, z - 0.1));
            let base = Base::around(&lamp).expect("a polygon");
            let near = End::new(eye, DVec3::Y, tracer.planes().of(TriangleId(0)));
            let far = End::behind(&base, eye, PlaneId::NONE).expect("a polygon");
            let pyramid = Pyramid::new(eye, &base, near, far, 0..0).expect("wide enough");
            let mut suspects = Suspects::default();
            assert!(tracer.suspects_in(&pyramid, 8, &mut suspects));
            assert!(!suspects.is_empty(), "{gap} m before {center}");
        }
    }
}

/// What belongs to the light is no suspect: the same are left as where it is asked for one by one.
#[test]
fn what_belongs_to_the_light_is_not_suspected() {
    let mut parts = SceneParts::default();
    let wall = white(&mut parts);
    let key = Key::new(8, Purpose::Test, 0);
    for index in 0..20 {
        let at = point(key, index) * 0.5;
        let [u, v] = [1, 2].map(|k| point(key.child(k), index) * 0.2);
        parts.add_quad("scrap", wall, at, u, v);
    }
    parts.add_sphere("ball", wall, Vec3::Y * 0.4, 0.3, 12);
    let scene = Scene::new(parts).expect("a valid scene");
    let own = scene.surfaces()[20].triangles.clone();
    let tracer = Tracer::new(&scene);
    let (mut left, mut dropped) = (0, 0);
    for index in 0..500 {
        let eye = (point(key.child(3), index) - 1.2 * Vec3::Y).as_dvec3();
        let corner = point(key.child(4), index).as_dvec3() * 0.3 + DVec3::Y * 0.4;
        let [u, v] = [DVec3::X * 0.3, DVec3::Z * 0.2];
        let base = Base::around(&[corner, corner + u, corner + u + v, corner + v]).expect("a polygon");
        let far = End::behind(&base, eye, PlaneId::NONE).expect("a polygon");
        let near = End::new(eye, DVec3::Y, PlaneId::NONE);
        let ids = |skip: Range<u32>| {
            let pyramid = Pyramid::new(eye, &base, near, far, skip)?;
            let mut suspects = Suspects::default();
            assert!(tracer.suspects_in(&pyramid, 1000, &mut suspects), "there are fewer");
            let mut ids: Vec<u32> = tracer.suspected(&suspects).map(|s| s.id.0).collect();
            ids.sort_unstable();
            Some(ids)
        };
        let (Some(mut all), Some(others)) = (ids(0..0), ids(own.clone())) else { continue };
        let before = all.len();
        all.retain(|id| !own.contains(id));
        assert_eq!(all, others);
        left += all.len();
        dropped += before - all.len();
    }
    assert!(left > 500 && dropped > 5000, "{left} left, {dropped} dropped");
}

/// Nothing but the suspects of a pyramid is in the way of shadow rays in it, be they opaque or panes.
#[test]
fn suspects_block_what_the_scene_blocks() {
    let mut parts = SceneParts::default();
    let wall = white(&mut parts);
    let grey = Material::lambertian("pane", Rgb::splat(0.5));
    let pane = parts.add_material(Material { alpha_mode: AlphaMode::Blend, base_alpha: 0.3, ..grey });
    let key = Key::new(6, Purpose::Test, 0);
    for index in 0..60 {
        let at = point(key, index) * Vec3::new(1.0, 0.5, 1.0);
        let [u, v] = [1, 2].map(|k| point(key.child(k), index) * 0.2);
        parts.add_quad("scrap", if index % 3 == 0 { pane } else { wall }, at, u, v);
    }
    let scene = Scene::new(parts).expect("a valid scene");
    let tracer = Tracer::new(&scene);
    let reversed: Vec<u32> = (0..scene.triangles().len() as u32).rev().collect();
    let other = Tracer::with_order(&scene, &reversed);
    let (mut blocked, mut thinned, mut free, mut many) = (0, 0, 0, 0);
    for index in 0..2000 {
        let eye = (point(key.child(3), index) - Vec3::Y).as_dvec3();
        let corner = point(key.child(4), index).as_dvec3() * 0.8 + DVec3::Y;
        let [u, v] = [DVec3::X * 0.3, DVec3::Z * 0.2];
        let base = Base::around(&[corner, corner + u, corner + u + v, corner + v]).expect("a polygon");
        let far = End::behind(&base, eye, PlaneId::NONE).expect("a polygon");
        let near = End::new(eye, DVec3::Y, PlaneId::NONE);
        let mut suspects = Suspects::default();
        let pyramid = Pyramid::new(eye, &base, near, far, 0..0);
        let Some(pyramid) = pyramid else { continue };
        // The same ones in any tree.
        let mut others = Suspects::default();
        let is_few = tracer.suspects_in(&pyramid, 32, &mut suspects);
        assert_eq!(is_few, other.suspects_in(&pyramid, 32, &mut others));
        if !is_few {
            many += 1;
            continue;
        }
        let ids = |tracer: &Tracer, suspects: &Suspects| {
            let mut ids: Vec<TriangleId> = tracer.suspected(suspects).map(|s| s.id).collect();
            ids.sort();
            ids
        };
        assert_eq!(ids(&tracer, &suspects), ids(&other, &others));
        for ray in 0..16 {
            let at = key.child(9).child(index).point2(ray).as_dvec2() * 0.998 + 0.001;
            let (origin, target) = (eye.as_vec3(), (corner + u * at.x + v * at.y).as_vec3());
            let expected = tracer.visibility(origin, PlaneId::NONE, target, PlaneId::NONE);
            let found = tracer.visibility_among(&suspects, origin, PlaneId::NONE, target, PlaneId::NONE);
            assert_eq!(found, expected, "from {origin} to {target}");
            match expected {
                Rgb::ZERO => blocked += 1,
                Rgb::ONE => free += 1,
                _ => thinned += 1,
            }
        }
    }
    assert!(
        blocked > 1000 && thinned > 1000 && free > 1000,
        "{blocked} blocked, {thinned} thinned, {free} free"
    );
    assert!(many < 1000, "{many} of 2000 pyramids hold too much");
}
