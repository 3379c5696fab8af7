//! Irradiance at a point in closed form (Lambert 1760, evaluated here with code of its own) against what pass one itself
//! uses: [`Lights::direct`] and [`Lights::mirrored`] for glowing polygons, [`gather`] for walls of known radiosity.
//!
//! The receiver lies at the origin and looks up. Each case says which polygons it sees, with what share of their
//! radiance 1: images in mirrors stand where the mirror puts them, and what hides or frames a polygon leaves a polygon.

use std::f64::consts::PI;

use glam::{DVec3, Vec3};

use catoptric_light::irradiance::Scratch;
use catoptric_light::{LightParams, Lights, Receiver};
use catoptric_radiosity::base_mesh::coarse_patches;
use catoptric_radiosity::gather::{DiffuseLight, Gathered, gather, gather_part};
use catoptric_radiosity::guide::{Findings, Guide, Hints, PlaceId, Window};
use catoptric_scene::{Barycentric, Material, Radiance, Rgb, Scene, SceneParts, Side, TriangleId};
use catoptric_trace::Tracer;
use catoptric_trace::sequence::{Key, Purpose, frame, hemisphere_point};
use catoptric_trace::walk::WalkParams;

type Corners = Vec<DVec3>;

/// What is there, and what of it is seen.
struct Case {
    name: &'static str,
    /// Polygons of radiance 1.
    senders: Vec<Corners>,
    blockers: Vec<Corners>,
    mirrors: Vec<(Corners, Rgb)>,
    /// Polygons as seen directly, and in mirrors, with their shares.
    direct: Vec<Corners>,
    mirrored: Vec<(Corners, Rgb)>,
}

fn rectangle(corner: [f64; 3], a: [f64; 3], b: [f64; 3]) -> Corners {
    let [corner, a, b] = [corner, a, b].map(DVec3::from);
    vec![corner, corner + a, corner + a + b, corner + b]
}

/// Irradiance at the origin, looking along z, by a polygon above it: ½ Σ γ_k (z · Γ_k).
fn lambert(corners: &[DVec3]) -> f64 {
    let edge = |k: usize| {
        let (a, b) = (corners[k].normalize(), corners[(k + 1) % corners.len()].normalize());
        libm::acos(a.dot(b).clamp(-1.0, 1.0)) * a.cross(b).normalize_or_zero().z
    };
    (0.5 * (0..corners.len()).map(edge).sum::<f64>()).abs()
}

fn plain(name: &'static str, sender: Corners) -> Case {
    let direct = vec![sender.clone()];
    Case { name, senders: vec![sender], blockers: vec![], mirrors: vec![], direct, mirrored: vec![] }
}

fn reflected(corners: &[DVec3], axis: DVec3, offset: f64) -> Corners {
    corners.iter().map(|c| *c + axis * (2.0 * (offset - axis.dot(*c)))).collect()
}

fn cases() -> Vec<Case> {
    let overhead = rectangle([-0.5, -0.5, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
    let aside = rectangle([0.5, 0.3, 0.8], [0.7, 0.0, 0.0], [0.0, 1.1, 0.0]);
    let wall = rectangle([0.6, -1.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 1.5]);
    let tilted = rectangle([0.2, -0.4, 0.5], [0.6, 0.0, 0.6], [0.0, 0.8, 0.0]);
    let touching = rectangle([0.01, -1.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 1.0]);
    let triangle = [[-0.4, 0.1, 0.7], [0.5, 0.2, 0.9], [0.1, 0.8, 1.3]].map(DVec3::from).to_vec();
    // Its lower half lies below the horizon.
    let crossing = rectangle([0.7, -0.5, -0.6], [0.0, 1.0, 0.0], [0.0, 0.0, 1.5]);
    let risen = rectangle([0.7, -0.5, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.9]);
    let mut list = vec![
        plain("parallel", overhead.clone()),
        plain("parallel, aside", aside.clone()),
        plain("perpendicular", wall),
        plain("tilted", tilted),
        plain("touching", touching),
        plain("triangle", triangle),
        Case { direct: vec![risen], ..plain("crossing the horizon", crossing) },
    ];
    // Half-way up, half as large: hides all that has x < 0 of the first, y > 0.3 of the second.
    let half = rectangle([-0.4, -0.4, 0.5], [0.4, 0.0, 0.0], [0.0, 0.8, 0.0]);
    let left = rectangle([0.0, -0.5, 1.0], [0.5, 0.0, 0.0], [0.0, 1.0, 0.0]);
    list.push(Case { blockers: vec![half], direct: vec![left], ..plain("half hidden", overhead.clone()) });
    let screen = rectangle([-0.2, 0.3, 0.4], [1.5, 0.0, 0.0], [0.0, 1.0, 0.0]);
    let left = rectangle([0.5, 0.3, 0.8], [0.7, 0.0, 0.0], [0.0, 0.3, 0.0]);
    list.push(Case { blockers: vec![screen], direct: vec![left], ..plain("hidden but for a strip", aside) });

    let white = Rgb::ONE;
    let tint = Rgb::new(0.9, 0.5, 0.2);
    let (x, y) = (DVec3::X, DVec3::Y);
    let at = |x: f64| rectangle([x, -20.0, 0.0], [0.0, 40.0, 0.0], [0.0, 0.0, 20.0]);
    let one = reflected(&overhead, x, 1.0);
    let with = |name, mirrors: Vec<(Corners, Rgb)>, mirrored: Vec<(Corners, Rgb)>| Case {
        mirrors,
        mirrored,
        ..plain(name, overhead.clone())
    };
    list.push(with("one mirror", vec![(at(1.0), white)], vec![(one.clone(), white)]));
    list.push(with("a tinted mirror", vec![(at(1.0), tint)], vec![(one.clone(), tint)]));
    // So large that its image fills the frame of the mirror: what is seen is the frame.
    let wide = rectangle([-1.3, -0.9, 1.5], [0.7, 0.0, 0.0], [0.0, 1.8, 0.0]);
    let frame = rectangle([1.0, -0.2, 0.5], [0.0, 0.4, 0.0], [0.0, 0.0, 0.05]);
    list.push(Case {
        mirrors: vec![(frame.clone(), white)],
        mirrored: vec![(frame, white)],
        ..plain("framed by a mirror", wide)
    });
    // Two mirrors at a right angle: both orders of reflection show one image, each a part of it.
    let corner = rectangle([-39.0, 1.0, 0.0], [40.0, 0.0, 0.0], [0.0, 0.0, 20.0]);
    let before = rectangle([1.0, -39.0, 0.0], [0.0, 40.0, 0.0], [0.0, 0.0, 20.0]);
    let two = reflected(&one, y, 1.0);
    let images = vec![(one, white), (reflected(&overhead, y, 1.0), tint), (two, tint)];
    list.push(with("two mirrors in sequence", vec![(before, white), (corner, tint)], images));
    // Facing mirrors at ±1: an image at each even x, as what is shown is symmetric, 0.3 times as bright for each reflection;
    // those below 2e-3 are no longer followed, and hold less than 1e-4 of the light.
    let dim = Rgb::splat(0.3);
    let image = |k: i32| {
        let moved = overhead.iter().map(|c| *c + x * f64::from(2 * k)).collect();
        (moved, Rgb::splat(0.3_f32.powi(k.abs())))
    };
    let images = (-12..=12).filter(|k| *k != 0).map(image).collect();
    list.push(with("facing mirrors", vec![(at(1.0), dim), (at(-1.0), dim)], images));
    list
}

fn scene(case: &Case, glowing: bool) -> Scene {
    let mut parts = SceneParts::default();
    let sender = match glowing {
        true => Material::emitter("sender", Radiance(Rgb::ONE)),
        false => Material::lambertian("sender", Rgb::splat(0.5)),
    };
    let sender = parts.add_material(sender);
    let black = Material { double_sided: true, ..Material::lambertian("black", Rgb::ZERO) };
    let black = parts.add_material(black);
    let add = |parts: &mut SceneParts, name: &str, material, corners: &[DVec3], towards: DVec3| {
        let mut corners: Vec<Vec3> = corners.iter().map(|c| c.as_vec3()).collect();
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
        if normal.dot(towards.as_vec3() - corners[0]) < 0.0 {
            corners.reverse();
        }
        let fan: Vec<[u32; 3]> = (1..corners.len() as u32 - 1).map(|k| [0, k, k + 1]).collect();
        parts.add_triangles(name, material, &corners, &fan);
    };
    let eye = DVec3::new(0.0, 0.0, 0.02);
    case.senders.iter().for_each(|s| add(&mut parts, "sender", sender, s, eye));
    case.blockers.iter().for_each(|b| add(&mut parts, "blocker", black, b, eye));
    for (mirror, share) in &case.mirrors {
        let material = parts.add_material(Material::mirror("mirror", *share));
        add(&mut parts, "mirror", material, mirror, eye);
    }
    let floor = rectangle([-0.001, -0.001, 0.0], [0.003, 0.0, 0.0], [0.0, 0.003, 0.0]);
    add(&mut parts, "floor", black, &floor, eye);
    Scene::new(parts).expect("the scene is valid")
}

fn receiver(tracer: &Tracer) -> Receiver {
    let last = TriangleId(tracer.scene().triangles().len() as u32 - 1);
    let on = Receiver::on(tracer, last, Side::Front, Barycentric { u: 0.3, v: 0.3 });
    Receiver { position: Vec3::ZERO, normal: Vec3::Z, geometric: Vec3::Z, ..on }
}

/// Scrambles of each estimate.
const SCRAMBLES: u64 = 16;
/// Student's t with 15 degrees of freedom leaves 1e-3/120 beyond it on both sides together: 45 comparisons of three channels
/// are a family at the level 1e-3.
const T15: f64 = 6.7;
/// Positions and throughputs are f32: a hundred roundings.
const ROUNDING: f64 = 1e-5;

/// Whether the mean of scrambles meets the truth: within its own error estimate, and to 1e-3 of `scale`.
fn judge(name: &str, exact: DVec3, scale: f64, found: impl Fn(Key) -> Rgb) -> Vec<String> {
    let all: Vec<DVec3> =
        (0..SCRAMBLES).map(|s| found(Key::new(s as u32, Purpose::Test, s)).as_dvec3()).collect();
    let n = SCRAMBLES as f64;
    let mean = all.iter().sum::<DVec3>() / n;
    let variance = all.iter().map(|v| (*v - mean) * (*v - mean)).sum::<DVec3>() / (n * (n - 1.0));
    let mut wrong = Vec::new();
    for channel in 0..3 {
        let (difference, error) = ((mean[channel] - exact[channel]).abs(), variance[channel].sqrt());
        if difference > T15 * error + ROUNDING * scale || difference > 1e-3 * scale {
            wrong.push(format!(
                "{name}, channel {channel}: {} ± {error:.1e} for {}",
                mean[channel], exact[channel]
            ));
        }
    }
    wrong
}

#[test]
fn light_of_sources_is_what_the_closed_forms_say() {
    let mut wrong = Vec::new();
    for case in cases() {
        let scene = scene(&case, true);
        let tracer = Tracer::new(&scene);
        let lights = Lights::new(&tracer, LightParams::default());
        let at = receiver(&tracer);
        let direct = DVec3::splat(case.direct.iter().map(|p| lambert(p)).sum());
        let ask = |key| lights.direct(&at, 4096, key, &mut Scratch::default()).irradiance;
        wrong.extend(judge(&format!("{}, direct", case.name), direct, direct.x, ask));
        let mirrored: DVec3 = case.mirrored.iter().map(|(p, share)| share.as_dvec3() * lambert(p)).sum();
        let ask = |key| lights.mirrored(&at, 1024, Rgb::ZERO, key, &mut Scratch::default()).irradiance;
        wrong.extend(judge(&format!("{}, mirrored", case.name), mirrored, mirrored.x, ask));
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Has `look` gather in a scene whose diffuse surfaces have one irradiance everywhere.
fn evenly_lit(scene: &Scene, irradiance: f64, look: impl FnOnce(&Tracer, &Lights, &DiffuseLight)) {
    let tracer = Tracer::new(scene);
    let lights = Lights::new(&tracer, LightParams::default());
    let (draft, _) = coarse_patches(&tracer, 50);
    let shown = draft.display(&tracer);
    let irradiance = vec![Rgb::splat(irradiance as f32); shown.mesh.vertices.len()];
    look(&tracer, &lights, &DiffuseLight { mesh: &shown.mesh, irradiance: &irradiance });
}

/// Walls of radiosity π, where the mirrors are in the way of the hemisphere rays like everything else.
#[test]
fn gathered_light_is_what_the_closed_forms_say() {
    let mut wrong = Vec::new();
    for case in cases() {
        let direct: f64 = case.direct.iter().map(|p| lambert(p)).sum();
        let mirrored: DVec3 = case.mirrored.iter().map(|(p, share)| share.as_dvec3() * lambert(p)).sum();
        let exact = direct + mirrored;
        evenly_lit(&scene(&case, false), 2.0 * PI, |tracer, lights, light| {
            let at = receiver(tracer);
            let ask = |key| gather(lights, light, &at, 1 << 18, key, &WalkParams::default()).indirect;
            wrong.extend(judge(&format!("{}, gathered", case.name), exact, exact.x, ask));
        });
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// What a gather says of its own noise, against what gathers with other keys differ by. Where strata follow the edges of what is seen,
/// halves may differ by several times as much; in the mean of all cases they do not.
#[test]
fn gathers_know_their_noise() {
    let mut logarithms: Vec<f64> = Vec::new();
    for case in cases() {
        evenly_lit(&scene(&case, false), 2.0 * PI, |tracer, lights, light| {
            let at = receiver(tracer);
            for rays in [16, 17, 64] {
                let seeds = 0..400;
                let (mut sum, mut squares, mut told) = (DVec3::ZERO, 0.0, 0.0);
                for seed in seeds.clone() {
                    let key = Key::new(seed, Purpose::Test, 11);
                    let found = gather(lights, light, &at, rays, key, &WalkParams::default());
                    let total = found.total().as_dvec3();
                    sum += total;
                    squares += total.length_squared();
                    told += f64::from(found.noise);
                }
                let ratio = told / (squares - sum.length_squared() / seeds.len() as f64);
                assert!((0.25..5.0).contains(&ratio), "{}, {rays} rays: {ratio} times", case.name);
                logarithms.push(libm::log(ratio));
            }
        });
    }
    let mean = libm::exp(logarithms.iter().sum::<f64>() / logarithms.len() as f64);
    assert!((0.5..1.5).contains(&mean), "{mean} times the variance");
}

/// Where every ray finds the same there is no noise, not even by an odd ray: halves are compared by their means.
#[test]
fn a_furnace_has_no_noise() {
    let mut parts = SceneParts::default();
    let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
    parts.add_box("room", white, Vec3::ZERO, Vec3::new(3.0, 2.0, 4.0), true);
    let scene = Scene::new(parts).expect("a valid scene");
    evenly_lit(&scene, 1.0, |tracer, lights, light| {
        let at = Receiver::on(tracer, TriangleId(0), Side::Front, Barycentric { u: 0.3, v: 0.2 });
        for rays in [1, 2, 5, 16] {
            let key = Key::new(3, Purpose::Test, 0);
            let found = gather(lights, light, &at, rays, key, &WalkParams::default());
            assert!(
                (found.indirect - Rgb::splat(0.5)).length() < 1e-5,
                "{rays} rays find {}",
                found.indirect
            );
            // Sums of a few f32.
            assert!(found.noise < 1e-12, "{rays} rays: {}", found.noise);
        }
    });
}

/// Rays that a guide sends densely to what is small find the same over a mirror as where the mirror shows it, however little each counts.
#[test]
fn guided_rays_go_on_over_mirrors() {
    let sender = rectangle([-0.05, -0.05, 1.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0]);
    let image = reflected(&sender, DVec3::X, 1.0);
    let mirror = rectangle([1.0, -2.0, 0.0], [0.0, 4.0, 0.0], [0.0, 0.0, 2.0]);
    let blocker = rectangle([-0.1, -0.1, 0.5], [0.2, 0.0, 0.0], [0.0, 0.2, 0.0]);
    let straight = plain("where its image is", image.clone());
    let over = Case {
        blockers: vec![blocker],
        mirrors: vec![(mirror, Rgb::splat(0.9))],
        ..plain("over a mirror", sender)
    };
    let (tangent, bitangent) = frame(Vec3::Z);
    let corners = image.iter().map(|c| c.normalize().as_vec3());
    let window = Window::around(
        corners.map(|way| hemisphere_point(Vec3::new(way.dot(tangent), way.dot(bitangent), way.z))),
    );
    let mut hints = Hints::default();
    hints.open(PlaceId(0), window, 1.0);
    let guide = Guide::new(&Findings::default(), &hints, Gathered::default());
    // The window gets half of the rays: each of them counts twice its area, and roulette that knew nothing of that would end most.
    let counts = 2.0 * window.area();
    assert!(counts < 0.1 * WalkParams::default().roulette_below, "{counts}");
    let [straight, over] = [straight, over].map(|case| {
        let mut found = Vec::new();
        evenly_lit(&scene(&case, false), 2.0 * PI, |tracer, lights, light| {
            let at = receiver(tracer);
            let ask = |seed| {
                let (key, walk) = (Key::new(seed, Purpose::Test, 12), WalkParams::default());
                gather_part(lights, light, &at, 0..64, Some(&guide), key, &walk, &mut ()).indirect.x
            };
            found = (0..32).map(ask).collect();
        });
        found
    });
    let exact = lambert(&image) as f32;
    for (straight, over) in straight.into_iter().zip(over) {
        // By 32 rays in the window, of which three quarters meet it: five times the √(1/3 · 1/32) of independent ones.
        assert!((straight / exact - 1.0).abs() < 0.5, "{straight} of {exact}");
        // Roundings of places beside the border.
        assert!((over / (0.9 * straight) - 1.0).abs() < 1e-3, "{over} for {straight}");
    }
}
