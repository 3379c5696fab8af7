//! Lamps against their facets, and what hides them against shadow rays.

use std::ops::Range;

use catoptric_light::emitter::Emitters;
use catoptric_light::irradiance::Scratch;
use catoptric_light::{LightParams, Lights, Receiver, contour};
use catoptric_scene::{
    Barycentric, Material, MaterialId, Radiance, Rgb, Scene, SceneParts, Side, TriangleId,
};
use catoptric_trace::sequence::{Key, Purpose, cosine_hemisphere, frame};
use catoptric_trace::{PlaneId, Ray, Tracer};
use glam::{Vec2, Vec3, Vec3Swizzles};

fn glowing(parts: &mut SceneParts) -> MaterialId {
    parts.add_material(Material::emitter("glowing", Radiance(Rgb::splat(3.0))))
}

fn white(parts: &mut SceneParts) -> MaterialId {
    parts.add_material(Material::lambertian("white", Rgb::splat(0.5)))
}

fn point(key: Key, index: u32) -> Vec3 {
    let [a, b] = [key.point2(index), key.child(1).point2(index)];
    Vec3::new(a.x, a.y, b.x) * 2.0 - 1.0
}

fn receiver(tracer: &Tracer, position: Vec3, normal: Vec3) -> Receiver {
    let last = TriangleId(tracer.scene().triangles().len() as u32 - 1);
    let on = Receiver::on(tracer, last, Side::Front, Barycentric { u: 0.3, v: 0.3 });
    Receiver { position, plane: PlaneId::NONE, normal, geometric: normal, ..on }
}

/// Adds a surface of all triangles that two others have.
fn add_joined(parts: &mut SceneParts, material: MaterialId, build: impl Fn(&mut SceneParts, MaterialId)) {
    let mut own = SceneParts::default();
    build(&mut own, material);
    let positions: Vec<Vec3> = own.vertices.iter().map(|v| v.position).collect();
    let triangles: Vec<[u32; 3]> = own.triangles.iter().map(|t| t.vertices).collect();
    parts.add_triangles("joined", material, &positions, &triangles);
}

/// Points on a circle about the y axis.
fn ring(radius: f32, y: f32, count: u32) -> Vec<Vec3> {
    let at = |k: u32| Vec2::from_angle(k as f32 / count as f32 * std::f32::consts::TAU) * radius;
    (0..count).map(|k| Vec3::new(at(k).x, y, -at(k).y)).collect()
}

/// A disc that faces up, of triangles around its middle.
fn add_disc(parts: &mut SceneParts, material: MaterialId, y: f32, count: u32) {
    let mut positions = ring(0.3, y, count);
    positions.push(Vec3::Y * y);
    let triangles: Vec<[u32; 3]> = (0..count).map(|k| [k, (k + 1) % count, count]).collect();
    parts.add_triangles("disc", material, &positions, &triangles);
}

/// The side of a cylinder, open at its ends.
fn add_tube(parts: &mut SceneParts, material: MaterialId, count: u32) {
    let positions = [ring(0.2, -0.3, count), ring(0.2, 0.4, count)].concat();
    let quad = |k: u32| [k, (k + 1) % count, count + (k + 1) % count, count + k];
    let triangles: Vec<[u32; 3]> =
        (0..count).map(quad).flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    parts.add_triangles("tube", material, &positions, &triangles);
}

/// A square that faces down, of 2 n² triangles.
fn add_grid(parts: &mut SceneParts, material: MaterialId, n: u32) {
    let at = |k: u32| Vec3::new((k % (n + 1)) as f32, 0.0, (k / (n + 1)) as f32) * (0.5 / n as f32);
    let positions: Vec<Vec3> = (0..(n + 1) * (n + 1)).map(at).collect();
    let corner = |x: u32, z: u32| z * (n + 1) + x;
    let triangles: Vec<[u32; 3]> = (0..n * n)
        .map(|k| (k % n, k / n))
        .map(|(x, z)| [corner(x, z), corner(x + 1, z), corner(x + 1, z + 1), corner(x, z + 1)])
        .flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]])
        .collect();
    parts.add_triangles("grid", material, &positions, &triangles);
}

/// A convex body is its outline: the light of balls, boxes, discs and tubes, straight and cut by the horizon, is the sum over their
/// facets, wherever the receiver is, but for what of them is hidden behind others of them. Both are f64 from the same corners, so only
/// roundings differ.
#[test]
fn a_lamp_shines_as_its_facets_do() {
    type Build = fn(&mut SceneParts, MaterialId);
    let cases: [(&str, usize, Build); 6] = [
        ("ball", 1, |p, m| p.add_sphere("lamp", m, Vec3::ZERO, 0.3, 12)),
        ("box", 1, |p, m| p.add_box("lamp", m, Vec3::splat(-0.25), Vec3::new(0.1, 0.3, 0.2), false)),
        ("disc", 1, |p, m| add_disc(p, m, 0.1, 24)),
        ("grid", 1, |p, m| add_grid(p, m, 6)),
        ("tube", 1, |p, m| add_tube(p, m, 16)),
        ("ball and box", 2, |p, m| {
            add_joined(p, m, |p, m| {
                p.add_sphere("", m, Vec3::ZERO, 0.3, 12);
                p.add_box("", m, Vec3::splat(0.4), Vec3::new(0.8, 0.5, 0.6), false);
            });
        }),
    ];
    for (name, lamps, build) in cases {
        let mut parts = SceneParts::default();
        let material = glowing(&mut parts);
        build(&mut parts, material);
        let scrap = white(&mut parts);
        parts.add_quad("scrap", scrap, Vec3::Y * -50.0, Vec3::Z, Vec3::X);
        let scene = Scene::new(parts).expect("a valid scene");
        let tracer = Tracer::new(&scene);
        let lights = Lights::new(&tracer, LightParams::default());
        assert_eq!(lights.emitters().lamps().len(), lamps, "{name}");
        let (mut scratch, key) = (Scratch::default(), Key::new(1, Purpose::Test, 0));
        let mut lit = 0;
        for index in 0..2000 {
            let position = point(key, index);
            let normal = point(key.child(7), index).normalize_or(Vec3::Y);
            let (p, n) = (position.as_dvec3(), normal.as_dvec3());
            let faces = |c: &&catoptric_light::emitter::Cell| c.normal.dot(p - c.point(0.0, 0.0)) > 0.0;
            let facets: f64 = lights
                .emitters()
                .cells()
                .iter()
                .filter(faces)
                .map(|c| 3.0 * contour::irradiance(p, n, &c.polygon()))
                .sum();
            let ball = name.starts_with("ball");
            let inside = if ball { position.length() < 0.3 } else { facets == 0.0 };
            if inside {
                continue;
            }
            let found = lights.direct(&receiver(&tracer, position, normal), 16, key, &mut scratch);
            lit += u32::from(facets > 0.0);
            let found = f64::from(found.unoccluded.x);
            assert!((found - facets).abs() < 1e-9 + 1e-6 * facets, "{name} {index}: {found} {facets}");
        }
        assert!(lit > 500, "{lit} of 2000 see the {name}");
    }
}

/// A finely divided ball is asked as a circle of 16 corners, of its mean silhouette. The facets of one of 32 rings cut into it by .0024 (.0018 in the mean
/// of Cauchy's formula), so that no silhouette differs from the mean one by more than .0048 of its area; of one of 16 rings, the coarsest that is
/// asked so, silhouettes differ by .004 at most where that is looked at. From near, facets one by one.
#[test]
fn a_fine_ball_shines_as_its_facets_do() {
    for rings in [16, 32] {
        fine_ball(rings);
    }
}

fn fine_ball(rings: u32) {
    let mut parts = SceneParts::default();
    let material = glowing(&mut parts);
    parts.add_sphere("ball", material, Vec3::ZERO, 0.3, rings);
    // A few coarse ones would be asked by their outlines. Too far and dim to tell.
    for index in 0..4 {
        parts.add_sphere("far", material, Vec3::new(30.0, 3.0 * index as f32, 0.0), 0.01, rings);
    }
    let scrap = white(&mut parts);
    parts.add_quad("scrap", scrap, Vec3::Y * -50.0, Vec3::Z, Vec3::X);
    let scene = Scene::new(parts).expect("a valid scene");
    let tracer = Tracer::new(&scene);
    let lights = Lights::new(&tracer, LightParams::default());
    assert_eq!(lights.emitters().lamps().len(), 5);
    let (mut scratch, key) = (Scratch::default(), Key::new(1, Purpose::Test, 0));
    let (mut far, mut near, mut sums) = (0, 0, [0.0; 2]);
    for index in 0..1000 {
        let direction = point(key, index).normalize_or(Vec3::X);
        // From between facets and corners on.
        let position = direction * 0.3 * (0.998 + libm::expf(-7.0 + 9.0 * key.point1(index)));
        let normal = point(key.child(7), index).normalize_or(Vec3::Y);
        let (p, n) = (position.as_dvec3(), normal.as_dvec3());
        let cells = lights.emitters().cells().iter();
        let faces = |c: &&catoptric_light::emitter::Cell| c.normal.dot(p - c.point(0.0, 0.0)) > 0.0;
        let facets: f64 = cells.filter(faces).map(|c| 3.0 * contour::irradiance(p, n, &c.polygon())).sum();
        let found = lights.direct(&receiver(&tracer, position, normal), 16, key, &mut scratch);
        let found = f64::from(found.unoccluded.x);
        let whole = 3.0 * std::f64::consts::PI * (0.09 / p.length_squared());
        let error = (found - facets).abs();
        // The polygon stands out of the ball by .0065 of its radius, and facets cut in, by the square of their width: a horizon that touches it
        // cuts off so much less.
        let horizon = 2e-4 * whole * (32.0 / f64::from(rings)).powi(2);
        assert!(error < 0.0048 * facets + horizon, "{index} at {}: {found} {facets}", p.length());
        sums = [sums[0] + found / whole, sums[1] + facets / whole];
        *(if p.length() > 0.6 { &mut far } else { &mut near }) += u32::from(facets > 0.0);
    }
    assert!((sums[0] / sums[1] - 1.0).abs() < 2e-4, "{} in the mean", sums[0] / sums[1]);
    assert!(far > 100 && near > 100, "{far} far, {near} near");
}

/// Nothing is between a receiver and a lamp but the lamp: all its light arrives, by no shadow ray, whatever it lies on or touches.
#[test]
fn a_flat_lamp_or_a_tube_does_not_hide_itself() {
    type Build = fn(&mut SceneParts, MaterialId);
    // Who looks into a tube asks facet by facet.
    let cases: [(Build, Range<f32>); 3] = [
        (|p, m| add_disc(p, m, -0.99, 24), -1.0..1.0),
        (|p, m| add_tube(p, m, 16), -0.3..0.4),
        (|p, m| add_grid(p, m, 6), -1.0..1.0),
    ];
    for (build, heights) in cases {
        let mut parts = SceneParts::default();
        let (material, wall) = (glowing(&mut parts), white(&mut parts));
        build(&mut parts, material);
        parts.add_box("room", wall, Vec3::splat(-1.0), Vec3::ONE, true);
        let scene = Scene::new(parts).expect("a valid scene");
        let tracer = Tracer::new(&scene);
        let lights = Lights::new(&tracer, LightParams::default());
        let (mut scratch, key, mut lit) = (Scratch::default(), Key::new(4, Purpose::Test, 0), 0);
        for index in 0..1000 {
            let (position, normal) =
                (point(key, index) * 0.9, point(key.child(7), index).normalize_or(Vec3::Y));
            if position.xz().length() < 0.5 || !heights.contains(&position.y) {
                continue;
            }
            let found = lights.direct(&receiver(&tracer, position, normal), 16, key, &mut scratch);
            assert!((found.irradiance.x - found.unoccluded.x).abs() <= 1e-6 * found.unoccluded.x, "{index}");
            lit += u32::from(found.irradiance.x > 0.0);
        }
        assert!(lit > 100, "{lit} of 1000 see it");
        assert_eq!(scratch.rays, 0);
    }
}

/// Half of a ball below a ceiling, and a ball behind a screen with a straight edge: the light that is left is that of the
/// facets that are left, within the error of stratified visibility at 4096 samples (perimeter of the edge over √n strata,
/// about n^(−3/4)).
#[test]
fn a_lamp_is_covered_as_its_facets_are() {
    let scene_of = |lamp: bool| {
        let mut parts = SceneParts::default();
        let material = glowing(&mut parts);
        parts.add_sphere("lamp", material, Vec3::Y, 0.3, 12);
        if !lamp {
            // A dent of a ten-thousandth.
            parts.vertices[100].position *= 0.999_9;
        }
        let wall = white(&mut parts);
        parts.add_quad("ceiling", wall, Vec3::new(-2.0, 1.0, -2.0), Vec3::X * 4.0, Vec3::Z * 4.0);
        parts.add_quad("screen", wall, Vec3::new(0.05, 0.2, -2.0), Vec3::Y * 0.4, Vec3::Z * 4.0);
        Scene::new(parts).expect("a valid scene")
    };
    let (with, without) = (scene_of(true), scene_of(false));
    let (with, without) = (Tracer::new(&with), Tracer::new(&without));
    let lights = [&with, &without].map(|t| Lights::new(t, LightParams::default()));
    assert_eq!(lights.each_ref().map(|l| l.emitters().lamps().len()), [1, 0]);
    let (mut scratch, key) = (Scratch::default(), Key::new(2, Purpose::Test, 0));
    for index in 0..60 {
        let at = point(key, index);
        let position = Vec3::new(at.x, 0.0, at.z);
        let [a, b] = lights.each_ref().map(|l| {
            let receiver = receiver(l.tracer(), position, Vec3::Y);
            l.direct(&receiver, 4096, key.child(index), &mut scratch).irradiance.x
        });
        assert!((a - b).abs() < 0.01 * b.max(a) + 1e-4, "{position}: {a} {b}");
    }
}

/// Discs so many that they share a few rays give what each with its own gives, behind a screen that covers a part of
/// them: the mean of 4000 looks, within four of its standard errors (found by the looks) and that of what it is held against
/// (4096 rays for each disc: edges are crossed by a fiftieth of their strata, 1e-3).
#[test]
fn many_flat_lamps_share_their_rays_without_bias() {
    let mut parts = SceneParts::default();
    let (glow, wall) = (glowing(&mut parts), white(&mut parts));
    add_joined(&mut parts, glow, |p, m| {
        let triangles: Vec<[u32; 3]> = (1..11).map(|k| [0, k + 1, k]).collect();
        for index in 0..64 {
            let place = Vec3::new((index % 8) as f32 - 3.5, 1.0, (index / 8) as f32 - 3.5);
            let corners: Vec<Vec3> = ring(0.1, 0.0, 12).into_iter().map(|c| place + c).collect();
            p.add_triangles("disc", m, &corners, &triangles);
        }
    });
    // Of so many slats that their shadows are not cut out.
    for slat in 0..1500 {
        let at = Vec3::new(-4.0, 0.5, -1.0 + slat as f32 * 1e-3);
        parts.add_quad("slat", wall, at, Vec3::X * 4.3, Vec3::Z * 1e-3);
    }
    let scene = Scene::new(parts).expect("a valid scene");
    let tracer = Tracer::new(&scene);
    let lights = Lights::new(&tracer, LightParams::default());
    assert_eq!(lights.emitters().lamps().len(), 64);
    let receiver = receiver(&tracer, Vec3::new(0.2, 0.0, 0.1), Vec3::Y);
    let mut scratch = Scratch::default();
    let mut look = |samples: u32, key: u32| {
        lights.direct(&receiver, samples, Key::new(key, Purpose::Test, 0), &mut scratch)
    };
    let truth = f64::from(look(64 * 4096, 0).irradiance.x);
    let whole = f64::from(look(16, 0).unoccluded.x);
    assert!(truth > 0.3 * whole && truth < 0.8 * whole, "{truth} of {whole}");
    let looks: Vec<f64> = (0..4000).map(|k| f64::from(look(16, k).irradiance.x)).collect();
    let mean = looks.iter().sum::<f64>() / 4000.0;
    let variance = looks.iter().map(|l| (l - mean).powi(2)).sum::<f64>() / 4000.0;
    let allowed = 4.0 * (variance / 4000.0).sqrt() + 1e-3 * truth;
    assert!((mean - truth).abs() < allowed, "{mean} {truth} ± {allowed}");
    // As noisy as systematic samples of half the rays at worst: a binomial's share.
    assert!(variance < whole * whole / 32.0, "{variance}");
}

#[test]
fn what_is_open_or_dented_or_many_is_no_lamp() {
    let lamps = |build: &dyn Fn(&mut SceneParts, MaterialId)| {
        let mut parts = SceneParts::default();
        let material = glowing(&mut parts);
        build(&mut parts, material);
        let scene = Scene::new(parts).expect("a valid scene");
        Emitters::new(&Tracer::new(&scene)).lamps().len()
    };
    assert_eq!(lamps(&|p, m| p.add_sphere("ball", m, Vec3::ZERO, 1.0, 8)), 1);
    // Inside out it lights its inside.
    assert_eq!(lamps(&|p, m| p.add_box("room", m, Vec3::ZERO, Vec3::ONE, true)), 0);
    assert_eq!(lamps(&|p, m| p.add_quad("sheet", m, Vec3::ZERO, Vec3::X, Vec3::Z)), 0);
    assert_eq!(lamps(&|p, m| add_disc(p, m, 0.0, 12)), 1);
    // With a bite, with a dent in its border, with a hole, folded.
    let disc = |count: u32, change: fn(&mut SceneParts)| {
        lamps(&move |p: &mut SceneParts, m| {
            add_disc(p, m, 0.0, count);
            change(p);
        })
    };
    assert_eq!(disc(12, |_| {}), 1);
    let bite = |p: &mut SceneParts| {
        p.triangles.truncate(9);
        p.surfaces[0].triangles.end = 9;
    };
    assert_eq!(disc(12, bite), 0);
    assert_eq!(disc(12, |p| p.vertices[3].position *= 0.8), 0);
    assert_eq!(disc(12, |p| p.vertices[12].position.y = -0.1), 0);
    // As a hat, convex and open below, it is one.
    assert_eq!(disc(12, |p| p.vertices[12].position.y = 0.1), 1);
    let ring_of = |p: &mut SceneParts, m| {
        let positions = [ring(0.3, 0.0, 8), ring(0.1, 0.0, 8)].concat();
        let triangles: Vec<[u32; 3]> =
            (0..8).flat_map(|k| [[k, (k + 1) % 8, 8 + k], [(k + 1) % 8, 8 + (k + 1) % 8, 8 + k]]).collect();
        p.add_triangles("ring", m, &positions, &triangles);
    };
    assert_eq!(lamps(&ring_of), 0);
    let dented = |p: &mut SceneParts, m| {
        p.add_sphere("ball", m, Vec3::ZERO, 1.0, 8);
        p.vertices[20].position *= 0.8;
    };
    assert_eq!(lamps(&dented), 0);
    let many = |count: u32, around: u32| {
        lamps(&move |p: &mut SceneParts, m| {
            for index in 0..count {
                p.add_sphere(&format!("ball {index}"), m, Vec3::X * index as f32, 0.3, around);
            }
        })
    };
    assert_eq!(many(250, 6), 250);
    assert_eq!(many(260, 6), 0);
    // More than 130 000 facets together; those of fine balls do not count.
    assert_eq!(many(190, 14), 0);
    assert_eq!(many(140, 16), 140);
    assert_eq!(many(40, 32), 40);
}

/// The end of a pole that stands in a glowing globe is seen by nobody, and would have cut the globe into facets for every receiver. One that
/// stands out of it has images, as one in a tube whose ends are open.
#[test]
fn a_mirror_inside_of_a_lamp_has_no_images() {
    type Build = fn(&mut SceneParts, MaterialId);
    let bodies: [(&str, Build, bool); 4] = [
        ("ball", |p, m| p.add_sphere("lamp", m, Vec3::ZERO, 0.3, 12), true),
        ("fine ball", |p, m| p.add_sphere("lamp", m, Vec3::ZERO, 0.3, 48), true),
        ("box", |p, m| p.add_box("lamp", m, Vec3::splat(-0.3), Vec3::splat(0.3), false), true),
        ("tube", |p, m| add_tube(p, m, 16), false),
    ];
    for (name, build, is_closed) in bodies {
        for (half, is_inside) in [(0.1_f32, true), (0.5, false)] {
            let mut parts = SceneParts::default();
            let material = glowing(&mut parts);
            build(&mut parts, material);
            // Its own light does not fall into it.
            parts.add_quad("panel", material, Vec3::new(-0.5, 3.0, -0.5), Vec3::X, Vec3::Z);
            let silver = parts.add_material(Material::mirror("silver", Rgb::splat(0.9)));
            let corner = Vec3::new(-half, -0.1, half);
            parts.add_quad("mirror", silver, corner, Vec3::X * (2.0 * half), Vec3::Z * (-2.0 * half));
            let scene = Scene::new(parts).expect("a valid scene");
            let tracer = Tracer::new(&scene);
            let lights = Lights::new(&tracer, LightParams::default());
            let expected = usize::from(!(is_inside && is_closed));
            assert_eq!(lights.chains().chains().len(), expected, "{name}, {half}");
        }
    }
}

/// Four shadow rays tell whether a lamp is seen wholly or not at all, of a weak lamp beside a strong one, too: each of few
/// has as many of its own.
#[test]
fn few_samples_tell_whether_each_lamp_is_seen_evenly() {
    let look = |hidden: Option<(f32, f32)>| {
        let mut parts = SceneParts::default();
        let (glow, plate) = (glowing(&mut parts), white(&mut parts));
        parts.add_box("strong", glow, Vec3::new(-1.5, 2.0, -0.5), Vec3::new(-0.5, 2.5, 0.5), false);
        parts.add_box("weak", glow, Vec3::new(1.0, 2.0, -0.1), Vec3::new(1.2, 2.2, 0.1), false);
        if let Some((from, to)) = hidden {
            parts.add_quad("plate", plate, Vec3::new(0.3, 1.0, from), Vec3::X * 0.5, Vec3::Z * (to - from));
        }
        parts.add_quad("scrap", plate, Vec3::Y * -50.0, Vec3::Z, Vec3::X);
        let scene = Scene::new(parts).expect("a valid scene");
        let tracer = Tracer::new(&scene);
        let lights = Lights::new(&tracer, LightParams::default());
        assert_eq!(lights.emitters().lamps().len(), 2);
        let receiver = receiver(&tracer, Vec3::ZERO, Vec3::Y);
        let mut scratch = Scratch::default();
        let found: Vec<_> = (0..100)
            .map(|k| lights.direct(&receiver, 4, Key::new(k, Purpose::Test, 0), &mut scratch))
            .collect();
        (found.iter().filter(|f| f.even).count(), found[0].irradiance.x)
    };
    let (even, open) = look(None);
    assert_eq!(even, 100);
    let (even, dark) = look(Some((-0.3, 0.3)));
    assert_eq!(even, 100);
    // So weak that in proportion it would get one ray of the four.
    assert!(dark < open && dark > 0.75 * open, "{dark} of {open}");
    // Four independent samples of a half agree with probability 2/16: of 100 trials 12.5 ± 3.3. Three deviations more.
    let even = look(Some((0.0, 0.3))).0;
    assert!(even <= 22, "{even} of 100");
}

/// Halves of the samples tell how noisy their mean is. Half of the lamp is hidden by a slanted edge. The halves of a stratified
/// sequence are noisier than half a sample of chance would be: of `n` strata those that the edge crosses, √n, disagree, so that
/// the variance goes with n^-1.5, and a quarter of the squared difference of independent halves is √2 times the variance of
/// the mean; up to twice that where they balance each other.
#[test]
fn halves_of_the_samples_tell_their_noise() {
    let mut parts = SceneParts::default();
    let (glow, plate) = (glowing(&mut parts), white(&mut parts));
    parts.add_quad("lamp", glow, Vec3::new(-0.5, 2.0, -0.5), Vec3::X, Vec3::Z);
    // Of so many slats that their shadows are not cut out.
    for slat in 0..1500 {
        let at = Vec3::new(0.0, 1.0, -1.0) + Vec3::new(0.2, 0.0, 2.0) * (slat as f32 / 1500.0);
        parts.add_quad("plate", plate, at, Vec3::X * 2.0, Vec3::new(0.2, 0.0, 2.0) / 1500.0);
    }
    parts.add_quad("scrap", plate, Vec3::Y * -50.0, Vec3::Z, Vec3::X);
    let scene = Scene::new(parts).expect("a valid scene");
    let tracer = Tracer::new(&scene);
    let lights = Lights::new(&tracer, LightParams::default());
    let receiver = receiver(&tracer, Vec3::ZERO, Vec3::Y);
    let (mut scratch, runs) = (Scratch::default(), 1000);
    let (mut mean, mut squares, mut told) = (0.0_f64, 0.0_f64, 0.0_f64);
    for k in 0..runs {
        let found = lights.direct(&receiver, 32, Key::new(k, Purpose::Test, 0), &mut scratch);
        let irradiance = f64::from(found.irradiance.x);
        assert!(
            found.irradiance.x > 0.1 * found.unoccluded.x && found.irradiance.x < 0.9 * found.unoccluded.x
        );
        mean += irradiance / f64::from(runs);
        squares += irradiance * irradiance / f64::from(runs);
        told += 0.25 * f64::from(found.split.x).powi(2) / f64::from(runs);
    }
    let ratio = told / (squares - mean * mean);
    // Of a thousand squares, each estimate is sure to 5 %.
    assert!((0.9..3.2).contains(&ratio), "{ratio}");
    // What is wholly seen has no noise.
    let free = Receiver { position: Vec3::new(-3.0, 0.0, 0.0), ..receiver };
    assert_eq!(lights.direct(&free, 32, Key::new(0, Purpose::Test, 0), &mut scratch).split, Rgb::ZERO);
}

/// Mirrors in panels, and a ball before them or that their plane cuts, above them or in one of them: light over the panels is what rays of the hemisphere
/// find over them, be they few, each with a window of its own, or so many that one frame is around all and following finds the gaps.
/// Within four standard errors of both as if all samples were independent (stratified ones are better), in the sum and in the mean square; for where
/// few rays of the hemisphere find the lamp, with a ten-thousandth of what fills it added: one and a half rays.
#[test]
fn panels_of_a_mirror_show_the_lamp_that_their_plane_cuts() {
    const RAYS: u32 = 16_384;
    const SAMPLES: u32 = 256;
    const RECEIVERS: u32 = 100;
    let places = [[1.4, 0.4], [0.3, 0.8], [0.3, 0.3], [-0.1, 0.8], [-0.1, 0.3]];
    for ([x, y], count) in places.into_iter().flat_map(|place| [(place, 2), (place, 3)]) {
        let mut parts = SceneParts::default();
        let (material, wall) = (glowing(&mut parts), white(&mut parts));
        let silver = parts.add_material(Material::mirror("silver", Rgb::ONE));
        parts.add_sphere("ball", material, Vec3::new(x, y, 0.1), 0.4, 10);
        for (row, column) in (0..count * count).map(|index| (index / count, index % count)) {
            let corner = Vec3::new(0.0, -0.3 - 0.7 * row as f32, -1.0 + 0.65 * column as f32);
            parts.add_quad("panel", silver, corner, Vec3::Y * 0.6, Vec3::Z * 0.5);
        }
        parts.add_quad("scrap", wall, Vec3::Y * -50.0, Vec3::Z, Vec3::X);
        let scene = Scene::new(parts).expect("a valid scene");
        let ball = scene.surfaces()[0].triangles.clone();
        let tracer = Tracer::new(&scene);
        let lights = Lights::new(&tracer, LightParams::default());
        // Its facets are asked by a tree of their own where the plane of the panels, x = 0, cuts it.
        assert_eq!(lights.emitters().lamps()[0].root.is_some(), x < 0.4, "{x}");
        let (mut scratch, key) = (Scratch::default(), Key::new(2, Purpose::Test, 0));
        let [mut sum, mut errors, mut variances, mut squares] = [0.0; 4];
        for index in 0..RECEIVERS {
            let position = point(key, index) * Vec3::new(0.35, 1.0, 1.0) + Vec3::new(0.65, -2.0, 0.0);
            let normal = (point(key.child(7), index) + Vec3::new(-0.5, 1.0, 0.0)).normalize_or(Vec3::Y);
            let at = receiver(&tracer, position, normal);
            let (right, up) = frame(normal);
            let directions = key.child(8).child(index);
            let finds = |ray: &u32| {
                let local = cosine_hemisphere(directions.point2(*ray));
                let direction = right * local.x + up * local.y + normal * local.z;
                let Some(first) = tracer.nearest(&Ray::free(position, direction), f32::INFINITY) else {
                    return false;
                };
                let met = position + direction * first.t;
                let reflected = direction * Vec3::new(-1.0, 1.0, 1.0);
                let again =
                    Ray { origin: met, direction: reflected, from: tracer.planes().of(first.triangle) };
                !ball.contains(&first.triangle.0)
                    && tracer
                        .nearest(&again, f32::INFINITY)
                        .is_some_and(|hit| ball.contains(&hit.triangle.0) && !hit.back)
            };
            let share = (0..RAYS).filter(finds).count() as f64 / f64::from(RAYS);
            let found = lights.mirrored(&at, SAMPLES, Rgb::ZERO, key.child(index), &mut scratch);
            let unit = 3.0 * std::f64::consts::PI;
            let (light, whole) = (f64::from(found.irradiance.x), f64::from(found.unoccluded.x));
            let variance = unit * unit * share * (1.0 - share) / f64::from(RAYS)
                + light * (whole - light).max(0.0) / f64::from(SAMPLES)
                + (1e-4 * unit).powi(2);
            sum += light;
            errors += light - unit * share;
            variances += variance;
            squares += (light - unit * share).powi(2) / variance;
        }
        let error = errors.abs() / variances.sqrt();
        assert!(sum > 1.0, "{sum} arrives at all of them");
        assert!(error < 4.0, "{count} × {count}, {x} {y}: {error} standard errors of {sum}");
        let mean = squares / f64::from(RECEIVERS);
        assert!(
            mean < 1.0 + 4.0 * (2.0 / f64::from(RECEIVERS)).sqrt(),
            "{count} × {count}, {x} {y}: squares of {mean}"
        );
    }
}
