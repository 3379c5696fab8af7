//! The S* walk: its ledger, closed lossless systems, reciprocity, agreement of the drivers, lenses and media.
//!
//! Statistical tests use one independent number per decision, fixed seeds and a two-sided normal test. Twenty-one
//! comparisons at |z| < 4.2 (p = 2.7e-5 each) have a family-wise level below 1e-3.

use catoptric_scene::id::TextureId;
use catoptric_scene::texture::{Texture, TextureRef, TextureTransform, Wrap};
use catoptric_scene::{AlphaMode, Material, Radiance, Rgb, Scene, SceneParts, Transmission, TriangleId};
use catoptric_trace::interaction::Coat;
use catoptric_trace::medium::{MediumId, MediumStack};
use catoptric_trace::sequence::{Key, Purpose, cosine_hemisphere, frame, uniform_sphere};
use catoptric_trace::walk::split::{self, Sight, SplitParams, Waiting};
use catoptric_trace::walk::{self, Arrival, End, WalkParams};
use catoptric_trace::{Event, Ledger, PlaneId, Ray, Tracer};
use glam::{DVec3, Vec2, Vec3};

const LEVEL: f64 = 4.2;

/// A closed white room of side 4 about the origin, and what `fill` puts inside.
fn room(wall: Material, fill: impl FnOnce(&mut SceneParts)) -> Scene {
    let mut parts = SceneParts::default();
    let id = parts.add_material(wall);
    parts.add_box("room", id, Vec3::splat(-2.0), Vec3::splat(2.0), true);
    fill(&mut parts);
    Scene::new(parts).expect("a valid scene")
}

fn white() -> Material {
    Material::lambertian("white", Rgb::splat(0.5))
}

fn pane(tint: Rgb) -> Material {
    let glass = Material { base_color: tint, ..Material::glass("pane", 1.5) };
    Material { transmission_kind: Transmission::Pane, ..glass }
}

/// Rooms with each kind of surface, and with all of them.
fn rooms() -> Vec<(&'static str, Scene)> {
    let tinted = || Material::mirror("tinted", Rgb::new(0.9, 0.5, 0.2));
    let blend = || {
        let base = Material::lambertian("veil", Rgb::new(0.8, 0.4, 0.1));
        Material { alpha_mode: AlphaMode::Blend, base_alpha: 0.4, double_sided: true, ..base }
    };
    let coat = || Material { roughness: 0.0, specular: 1.0, ..white() };
    let glass = || Material { absorption: Rgb::new(0.1, 0.5, 1.0), ..Material::glass("glass", 1.5) };
    let quad = |parts: &mut SceneParts, material: Material, x: f32| {
        let id = parts.add_material(material);
        parts.add_quad("quad", id, Vec3::new(x, -1.5, -1.4), Vec3::Y * 2.9, Vec3::Z * 2.7);
    };
    let block = |parts: &mut SceneParts, material: Material, min: Vec3, max: Vec3| {
        let id = parts.add_material(material);
        parts.add_box("block", id, min, max, false);
    };
    vec![
        ("mirror", room(white(), |p| quad(p, Material::mirror("mirror", Rgb::ONE), -1.1))),
        ("tinted mirrors", room(tinted(), |p| quad(p, Material { double_sided: true, ..white() }, 0.3))),
        ("glass", room(white(), |p| block(p, glass(), Vec3::splat(-0.9), Vec3::new(0.8, 0.7, 1.1)))),
        ("smooth glass", {
            room(white(), |p| {
                let id = p.add_material(glass());
                p.add_sphere("ball", id, Vec3::new(0.2, 0.0, -0.1), 1.2, 16);
            })
        }),
        ("pane", room(white(), |p| quad(p, pane(Rgb::new(0.9, 0.8, 0.7)), 0.2))),
        ("coat", room(coat(), |p| quad(p, tinted(), -0.4))),
        ("veil", room(white(), |p| quad(p, blend(), 0.1))),
        ("nested media", {
            room(white(), |p| {
                block(p, Material::glass("water", 1.33), Vec3::splat(-1.5), Vec3::splat(1.5));
                block(p, glass(), Vec3::splat(-0.9), Vec3::splat(0.7));
                block(p, white(), Vec3::splat(-0.3), Vec3::splat(0.2));
            })
        }),
        (
            "black backs",
            room(white(), |p| quad(p, Material { base_alpha: 0.5, double_sided: false, ..blend() }, 0.6)),
        ),
        ("everything", {
            room(coat(), |p| {
                quad(p, tinted(), -1.6);
                quad(p, pane(Rgb::splat(0.9)), -1.2);
                quad(p, blend(), 1.4);
                block(p, glass(), Vec3::splat(-0.9), Vec3::new(0.8, 0.7, 1.1));
            })
        }),
    ]
}

/// Each event books three products of f32 with a rounding of at most ε·w each (w ≤ 2, the weight: a tint keeps at
/// most the strongest channel at 1, three branches share it), and divides once more: 5·ε·2 per event, 64 events.
#[test]
fn every_walk_books_exactly_what_it_was_sent_with() {
    let tolerance = 64.0 * 5.0 * 2.0 * f64::from(f32::EPSILON) / 2.0;
    for (name, scene) in rooms() {
        let tracer = Tracer::new(&scene);
        let key = Key::new(1, Purpose::Test, 0);
        let params = WalkParams { max_depth: 64, ..WalkParams::default() };
        let mut total = Ledger::default();
        let mut arrived = DVec3::ZERO;
        let walks = 4000;
        for i in 0..walks {
            let mut ledger = Ledger::default();
            let origin = Vec3::new(-0.11, 1.73, 0.07);
            let ray = Ray::free(origin, uniform_sphere(key.point2(i)));
            let arrive = |a: &Arrival| {
                arrived += (a.throughput * (Rgb::ONE - a.interaction.passed_on())).as_dvec3();
            };
            let air = MediumStack::AIR;
            walk::choose(&tracer, ray, air, Rgb::ONE, key.child(i), &params, &mut ledger, arrive);
            let error = (ledger.sum() - DVec3::ONE).abs().max_element();
            assert!(error < tolerance, "{name}: walk {i} misses {error:e}: {ledger:?}");
            total.add(&ledger);
        }
        let scale = f64::from(walks);
        assert!((total.arrived - arrived).abs().max_element() < tolerance * scale, "{name}");
        assert!(total.escaped == DVec3::ZERO, "{name} leaks: {total:?}");
        if ["tinted mirrors", "glass", "smooth glass", "pane", "everything"].contains(&name) {
            assert!(total.absorbed.max_element() > 1e-3 * scale, "{name}: {total:?}");
        }
        if name == "black backs" {
            assert!(total.black_backs.x > 1e-2 * scale, "{total:?}");
        }
    }
}

/// A hall of perfect mirrors and clear glass with one small receiver: nothing escapes through edges and corners in
/// half a million bounces, and what is sent arrives but for f32 rounding (ε per event) and walks of 1000 events.
#[test]
fn lossless_closed_systems_lose_nothing() {
    let scene = room(Material::mirror("mirror", Rgb::ONE), |p| {
        let receiver = p.add_material(Material { double_sided: true, ..white() });
        p.add_quad("receiver", receiver, Vec3::new(-1.0, -0.5, 0.3), Vec3::X * 1.1, Vec3::Y * 0.9);
        let glass = p.add_material(Material::glass("glass", 1.5));
        p.add_box("block", glass, Vec3::new(0.2, -1.9, -0.9), Vec3::new(1.5, -0.6, 1.1), false);
        let clear = p.add_material(pane(Rgb::ONE));
        p.add_quad("pane", clear, Vec3::new(-1.2, -1.5, -1.4), Vec3::Y * 2.9, Vec3::Z * 2.7);
    });
    let tracer = Tracer::new(&scene);
    let key = Key::new(2, Purpose::Test, 0);
    let mut ledger = Ledger::default();
    let mut bounces = 0_usize;
    let walks = 10_000;
    for i in 0..walks {
        let ray = Ray::free(Vec3::new(0.11, 1.43, 0.07), uniform_sphere(key.point2(i)));
        let params = WalkParams::default();
        let arrive = |a: &Arrival| bounces += a.chain.len();
        let air = MediumStack::AIR;
        let end = walk::choose(&tracer, ray, air, Rgb::ONE, key.child(i), &params, &mut ledger, arrive);
        assert!(matches!(end, End::Inside));
    }
    assert!(bounces > 500_000, "{bounces}");
    let share = |power: DVec3| power.max_element() / f64::from(walks);
    assert_eq!(ledger.escaped, DVec3::ZERO);
    assert_eq!(ledger.black_backs, DVec3::ZERO);
    assert!(share(ledger.absorbed.abs()) < 1e-5, "{ledger:?}");
    assert!((share(ledger.arrived + ledger.cut_off) - 1.0).abs() < 1e-4, "{ledger:?}");
}

/// A diffuse end of an exchange: a parallelogram, its medium and its coat.
struct Patch {
    name: &'static str,
    corner: Vec3,
    a: Vec3,
    b: Vec3,
    media: MediumStack,
    coat: Coat,
}

impl Patch {
    fn area(&self) -> f64 {
        f64::from(self.a.cross(self.b).length())
    }

    /// A_i F_ij n_i² and its variance: rows leave with T(θ)·cosθ and arrive with T.
    fn exchange(&self, other: &str, tracer: &Tracer, seed: u64, samples: u32) -> (DVec3, DVec3) {
        let key = Key::new(3, Purpose::Test, seed);
        let normal = self.a.cross(self.b).normalize_or_zero();
        let (tangent, bitangent) = frame(normal);
        let plane = (0..tracer.scene().triangles().len() as u32)
            .map(TriangleId)
            .find(|&t| tracer.scene().surface_of(t).name == self.name)
            .map(|t| tracer.planes().of(t))
            .expect("the patch is a surface");
        let (mut sum, mut squares) = (DVec3::ZERO, DVec3::ZERO);
        for i in 0..samples {
            let u = |k: u32| key.child(i).uniform(0x4000_0000 + k);
            let local = cosine_hemisphere(Vec2::new(u(0), u(1)));
            let direction = tangent * local.x + bitangent * local.y + normal * local.z;
            let origin = self.corner + self.a * u(2) + self.b * u(3);
            let ray = Ray { origin, direction, from: plane };
            let mut found = DVec3::ZERO;
            let arrive = |a: &Arrival| {
                if tracer.scene().surface_of(a.hit.triangle).name == other {
                    found += (a.throughput * a.interaction.receives).as_dvec3();
                }
            };
            let (params, mut ledger) = (WalkParams::default(), Ledger::default());
            walk::choose(tracer, ray, self.media, Rgb::ONE, key.child(i), &params, &mut ledger, arrive);
            found *= f64::from(self.coat.transmittance(local.z));
            sum += found;
            squares += found * found;
        }
        let n = f64::from(samples);
        let mean = sum / n;
        let scale = self.area() * f64::from(tracer.media().ior(self.media.current())).powi(2);
        (mean * scale, (squares / n - mean * mean) / n * scale * scale)
    }
}

/// A_i F_ij n_i² = A_j F_ji n_j² over mirrors, panes, glass, absorbing media, coats and veils, the ends under coats or in glass.
#[test]
fn exchange_is_reciprocal() {
    let bare = Coat::NONE;
    let coated = || Material { roughness: 0.0, specular: 1.0, ior: 1.8, ..white() };
    let coat = Coat { strength: 1.0, ior: 1.8, clearcoat: 0.0 };
    let both = Coat { strength: 1.0, ior: 1.8, clearcoat: 0.7 };
    let twice = || Material { clearcoat: 0.7, ..coated() };
    let air = MediumStack::AIR;
    let inside = MediumStack::inside(MediumId(3));
    let veil = || Material { alpha_mode: AlphaMode::Blend, base_alpha: 0.4, double_sided: true, ..white() };
    let glass = || Material { absorption: Rgb::new(0.1, 0.5, 1.0), ..Material::glass("glass", 1.5) };
    let clearcoat_glass = || Material { clearcoat: 1.0, ..glass() };
    let tinted = || Material::mirror("tinted", Rgb::new(0.9, 0.6, 0.3));
    type Case = (&'static str, Material, Coat, Material, MediumStack, bool);
    let cases: [Case; 7] = [
        ("tinted mirror walls", white(), bare, tinted(), air, false),
        ("a coat and a mirror", coated(), coat, tinted(), air, false),
        ("two interfaces over white", twice(), both, tinted(), air, false),
        ("through a pane", white(), bare, pane(Rgb::new(0.9, 0.8, 0.7)), air, false),
        ("through a veil", white(), bare, veil(), air, false),
        ("through glass, one end inside", white(), bare, glass(), inside, true),
        ("through coated glass, one end inside", white(), bare, clearcoat_glass(), inside, true),
    ];
    for (seed, (name, ends, coat, between, media, solid)) in cases.into_iter().enumerate() {
        let first = Patch {
            name: "first",
            corner: Vec3::new(-1.3, 1.2, -1.2),
            a: Vec3::X * 1.7,
            b: Vec3::Z * 1.4,
            media: air,
            coat,
        };
        let y = if solid { -0.6 } else { -1.1 };
        let second = Patch {
            name: "second",
            corner: Vec3::new(-0.5, y, -0.7),
            a: Vec3::Z * 0.6,
            b: Vec3::X * 0.9,
            media,
            coat,
        };
        let scene = room(Material::lambertian("dark", Rgb::splat(0.1)), |p| {
            let end = p.add_material(ends);
            let filter = p.add_material(between);
            for patch in [&first, &second] {
                p.add_quad(patch.name, end, patch.corner, patch.a, patch.b);
            }
            if solid {
                p.add_box("between", filter, Vec3::new(-0.9, -1.0, -1.1), Vec3::new(0.8, 0.5, 0.9), false);
            } else {
                p.add_quad("between", filter, Vec3::new(-0.8, -1.5, -1.5), Vec3::Y * 3.0, Vec3::Z * 3.0);
                p.add_quad("over", filter, Vec3::new(-1.5, 0.1, -1.5), Vec3::X * 1.6, Vec3::Z * 1.9);
            }
        });
        assert_eq!(scene.materials()[2].ior, tracer_ior(&scene, MediumId(3)));
        let tracer = Tracer::new(&scene);
        let (forward, variance) = first.exchange("second", &tracer, seed as u64 * 2, 120_000);
        let (backward, other) = second.exchange("first", &tracer, seed as u64 * 2 + 1, 120_000);
        for channel in 0..3 {
            let (f, b) = (forward[channel], backward[channel]);
            let z = (f - b) / (variance[channel] + other[channel]).sqrt();
            assert!(f > 0.0 && z.abs() < LEVEL, "{name}, channel {channel}: {f} against {b}, z = {z}");
        }
    }
}

fn tracer_ior(scene: &Scene, medium: MediumId) -> f32 {
    Tracer::new(scene).media().ior(medium)
}

/// Three mirrors (tinted, textured, plain) in a corner and a pane before one of them: *choose*, aimed at the image, takes
/// the same chain with the same throughput; exactly without a pane, on average with it.
#[test]
fn following_a_chain_agrees_with_choosing_it() {
    for with_pane in [false, true] {
        let mut parts = SceneParts::default();
        let red = parts.add_material(Material::mirror("red", Rgb::new(0.9, 0.3, 0.2)));
        parts.textures.push(Texture {
            name: "checks".to_owned(),
            width: 2,
            height: 2,
            texels: vec![[255, 128, 10, 255], [30, 200, 90, 255], [90, 90, 90, 255], [200, 10, 250, 255]],
            wrap_u: Wrap::Repeat,
            wrap_v: Wrap::Repeat,
            linear_filter: true,
        });
        let base_texture =
            Some(TextureRef { texture: TextureId(0), uv_set: 0, transform: TextureTransform::IDENTITY });
        let checks =
            parts.add_material(Material { base_texture, ..Material::mirror("checks", Rgb::splat(0.9)) });
        let clear = parts.add_material(pane(Rgb::new(0.9, 0.95, 0.8)));
        let lamp = parts.add_material(Material::emitter("lamp", Radiance(Rgb::ONE)));
        parts.add_quad("floor", red, Vec3::new(-3.0, 0.0, -3.0), Vec3::Z * 9.0, Vec3::X * 9.0);
        parts.add_quad("wall", checks, Vec3::new(0.0, -3.0, -3.0), Vec3::Y * 9.0, Vec3::Z * 9.0);
        for (i, vertex) in parts.vertices.iter_mut().enumerate() {
            vertex.uv[0] = Vec2::new([0.0, 3.0, 3.0, 0.0][i % 4], [0.0, 0.0, 2.0, 2.0][i % 4]);
        }
        if with_pane {
            parts.add_quad("pane", clear, Vec3::new(0.3, -3.0, -3.0), Vec3::Y * 9.0, Vec3::Z * 9.0);
        }
        parts.add_quad("lamp", lamp, Vec3::new(1.4, 2.2, 0.2), Vec3::X * 0.5, Vec3::Z * 0.5);
        let scene = Scene::new(parts).unwrap();
        let tracer = Tracer::new(&scene);
        let plane_of = |name: &str| {
            let surface = scene.surfaces().iter().find(|s| s.name == name).unwrap();
            tracer.planes().of(TriangleId(surface.triangles.start))
        };
        let (floor, wall, end) = (plane_of("floor"), plane_of("wall"), plane_of("lamp"));
        let key = Key::new(4, Purpose::Test, 0);
        for i in 0..40 {
            let light = Vec3::new(1.4 + 0.5 * key.uniform(2 * i), 2.2, 0.2 + 0.5 * key.uniform(2 * i + 1));
            let origin = Vec3::new(0.9 + key.uniform(9000 + i), 0.6, 0.3);
            // Floor first, then wall.
            let last = light * Vec3::new(-1.0, 1.0, 1.0);
            let first = last * Vec3::new(1.0, -1.0, 1.0);
            let planes = [floor, wall];
            let followed = walk::follow(&tracer, origin, PlaneId::NONE, &planes, &[first, last, light], end);
            if followed == Rgb::ZERO {
                continue;
            }
            let ray = Ray::free(origin, (first - origin).normalize_or_zero());
            let tries = if with_pane { 3000 } else { 1 };
            let (mut sum, mut squares) = (DVec3::ZERO, DVec3::ZERO);
            for attempt in 0..tries {
                let mut found = DVec3::ZERO;
                let arrive = |a: &Arrival| {
                    let undeviated = a.chain.planes() == Some(&planes);
                    if tracer.planes().of(a.hit.triangle) == end && undeviated {
                        found += a.throughput.as_dvec3();
                        assert!((a.position - light).length() < 1e-4);
                    }
                };
                let params = WalkParams { roulette_below: 0.0, ..WalkParams::default() };
                let mut ledger = Ledger::default();
                let random = key.child(i).child(attempt);
                walk::choose(&tracer, ray, MediumStack::AIR, Rgb::ONE, random, &params, &mut ledger, arrive);
                sum += found;
                squares += found * found;
            }
            let mean = sum / f64::from(tries);
            let variance = (squares / f64::from(tries) - mean * mean) / f64::from(tries);
            for channel in 0..3 {
                let difference = (mean[channel] - f64::from(followed[channel])).abs();
                // Texture look-ups at positions with a rounding of 1e-6 of a checker that changes by 1 in half a metre.
                let allowed = 1e-5 + 5.0 * variance[channel].max(0.0).sqrt();
                assert!(difference < allowed, "pane {with_pane}, {i}: {mean} against {followed}");
            }
        }
    }
}

/// A box of flat glass with water in it, and a pane, in a closed black room that glows.
fn glass_in_a_furnace() -> Scene {
    room(Material { emission: Radiance(Rgb::ONE), ..Material::lambertian("hot", Rgb::ZERO) }, |p| {
        let glass = p.add_material(Material::glass("glass", 1.5));
        let water = p.add_material(Material::glass("water", 1.33));
        p.add_box("block", glass, Vec3::new(-0.9, -0.8, -0.7), Vec3::new(0.8, 0.7, 0.6), false);
        p.add_box("inner", water, Vec3::new(-0.4, -0.4, -0.3), Vec3::new(0.3, 0.2, 0.4), false);
        let clear = p.add_material(pane(Rgb::ONE));
        p.add_quad("pane", clear, Vec3::new(1.2, -1.5, -1.4), Vec3::Y * 2.9, Vec3::Z * 2.7);
    })
}

/// What the eye gets along a ray, of light that depends on the place it comes from.
fn seen(
    tracer: &Tracer,
    ray: Ray,
    sample: (Key, u32),
    params: SplitParams,
    radiance: impl Fn(Vec3) -> f32,
) -> f64 {
    let mut sum = 0.0;
    let see = |sight: Sight| {
        if let Sight::Surface(a) = sight {
            sum += f64::from(a.throughput.x * a.interaction.emission.0.x * radiance(a.position));
        }
    };
    split::trace(tracer, ray, MediumStack::AIR, sample, &params, &mut Waiting::default(), |_| {}, see);
    sum
}

/// From any view, lossless glass in a closed furnace of radiance 1 shows radiance 1, whatever roulette decides: the
/// throughputs of all ends sum to unity. A box of flat faces has no directions below the surface. Systematic draws sum to
/// what they stand for within the threshold, and so do those of all samples of a pixel, at as many times the threshold; the
/// rest is rounding, at some twenty events per path.
#[test]
fn lossless_glass_vanishes_in_a_furnace() {
    let scene = glass_in_a_furnace();
    let tracer = Tracer::new(&scene);
    let key = Key::new(5, Purpose::Test, 0);
    for roulette_below in [1e-5, 1e-3, 0.1] {
        let params = SplitParams { roulette_below, ..SplitParams::default() };
        for i in 0..400 {
            let ray = Ray::free(Vec3::new(0.2, 1.5, 1.4), uniform_sphere(key.point2(i)));
            let allowed = f64::from(roulette_below) + 5e-6;
            let radiance = seen(&tracer, ray, (key.child(i), 0), params, |_| 1.0);
            assert!((radiance - 1.0).abs() < allowed, "{i}: {radiance}");
            let (of_pixel, samples) = (params.for_one_of(8.0), 8);
            let all = (0..samples).map(|index| seen(&tracer, ray, (key.child(i), index), of_pixel, |_| 1.0));
            let mean = all.sum::<f64>() / f64::from(samples);
            assert!((mean - 1.0).abs() < allowed, "{i}: {mean} of {samples} samples");
        }
    }
}

/// Where light is not the same everywhere, what roulette lets go on stands in the mean for what it does not: within five
/// standard errors of a trace that follows all but branches of 1e-7.
#[test]
fn what_the_eye_does_not_follow_is_made_up_for_in_the_mean() {
    let scene = glass_in_a_furnace();
    let tracer = Tracer::new(&scene);
    // Lamps in two corners, and walls that differ.
    let radiance = |p: Vec3| if p.x * p.y > 0.5 { 20.0 } else { 1.0 + p.z };
    let all = SplitParams { roulette_below: 1e-7, ..SplitParams::default() };
    for i in 0..20 {
        let key = Key::new(6, Purpose::Test, u64::from(i));
        let eye = Vec3::new(0.2, 1.5, 1.4);
        let aim = uniform_sphere(key.point2(i)) * 0.5;
        let ray = Ray::free(eye, (aim - eye).normalize_or_zero());
        let exact = seen(&tracer, ray, (key, 0), all, radiance);
        for few in [
            SplitParams { roulette_below: 0.02, ..all },
            SplitParams { roulette_below: 0.02, ..all }.for_one_of(10.0),
        ] {
            let (mut sum, mut squares) = (0.0, 0.0);
            let count = 2000;
            for k in 0..count {
                let found = seen(&tracer, ray, (key.child(k), 0), few, radiance);
                sum += found;
                squares += found * found;
            }
            let mean = sum / f64::from(count);
            let error = ((squares / f64::from(count) - mean * mean).max(0.0) / f64::from(count)).sqrt();
            assert!(
                (mean - exact).abs() < 5.0 * error + 1e-5 * exact,
                "{i}: {mean} ± {error}, exactly {exact}"
            );
        }
    }
}

/// Where a ray that meets a sphere of index n at height h crosses the axis: h / sin 2(θ_i − θ_t) from the centre (it
/// keeps its distance h from the centre). 128 rings: facets turn the interpolated normal by up to 1e-4, a ray of
/// deviation δ thus crosses the axis within 2e-4/δ of the exact place.
#[test]
fn a_glass_sphere_focuses_where_it_should() {
    let mut parts = SceneParts::default();
    let glass = parts.add_material(Material::glass("glass", 1.5));
    parts.add_sphere("ball", glass, Vec3::ZERO, 1.0, 128);
    let scene = Scene::new(parts).unwrap();
    let tracer = Tracer::new(&scene);
    for (h, turn) in [(0.05_f32, 0.3_f32), (0.2, 1.1), (0.5, 2.0), (0.8, 4.0)] {
        let (sin_turn, cos_turn) = libm::sincosf(turn);
        let height = Vec3::new(0.0, h * sin_turn, h * cos_turn);
        let mut ray = Ray::free(Vec3::new(-3.0, 0.0, 0.0) + height, Vec3::X);
        let mut media = MediumStack::AIR;
        for crossing in 0..2 {
            let hit = tracer.nearest(&ray, f32::INFINITY).unwrap();
            let interaction = tracer.interact(ray.direction, &hit, media);
            let branch = interaction.branches().iter().find(|b| b.media != media).unwrap();
            assert_eq!(branch.event, Event::Curved);
            assert_eq!(branch.media == MediumStack::AIR, crossing == 1);
            let from = tracer.planes().of(hit.triangle);
            ray = Ray { origin: ray.origin + ray.direction * hit.t, direction: branch.direction, from };
            media = branch.media;
        }
        let (h, n) = (f64::from(h), 1.5);
        let deviation = 2.0 * (libm::asin(h) - libm::asin(h / n));
        let expected = h / libm::sin(deviation);
        // Nearest approach to the axis.
        let (o, d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
        let t = -(o.y * d.y + o.z * d.z) / (d.y * d.y + d.z * d.z);
        let crossing = o + d * t;
        assert!(
            (crossing.x / expected - 1.0).abs() < 2e-4 / deviation,
            "h {h}: {crossing} against {expected}"
        );
        assert!(crossing.y.hypot(crossing.z) < 1e-3, "h {h}: {crossing}");
    }
}

/// Straight through water, glass in it and water again: the product of the transmittances, Beer–Lambert per length.
#[test]
fn nested_slabs_transmit_the_product_of_their_parts() {
    let sigma = Rgb::new(0.2, 0.7, 1.5);
    let mut parts = SceneParts::default();
    let water = parts.add_material(Material { absorption: sigma * 0.5, ..Material::glass("water", 1.33) });
    let glass = parts.add_material(Material { absorption: sigma, ..Material::glass("glass", 1.6) });
    parts.add_box("tank", water, Vec3::new(-9.0, -1.0, -9.0), Vec3::new(9.0, 1.0, 9.0), false);
    parts.add_box("plate", glass, Vec3::new(-8.0, -0.25, -8.0), Vec3::new(8.0, 0.5, 8.0), false);
    let scene = Scene::new(parts).unwrap();
    let tracer = Tracer::new(&scene);
    for angle in [0.0_f64, 35.0, 70.0] {
        let (sin, cos) = (libm::sin(angle.to_radians()), libm::cos(angle.to_radians()));
        let mut ray = Ray::free(Vec3::new(0.1, 3.0, 0.2), Vec3::new(sin as f32, -cos as f32, 0.0));
        let (mut media, mut share) = (MediumStack::AIR, Rgb::ONE);
        for _ in 0..4 {
            let hit = tracer.nearest(&ray, f32::INFINITY).unwrap();
            share *= tracer.media().transmittance(media.current(), hit.t);
            let interaction = tracer.interact(ray.direction, &hit, media);
            let branch = *interaction.branches().iter().find(|b| b.media != media).unwrap();
            let from = tracer.planes().of(hit.triangle);
            ray = Ray { origin: ray.origin + ray.direction * hit.t, direction: branch.direction, from };
            (share, media) = (share * branch.throughput, branch.media);
        }
        assert_eq!(media, MediumStack::AIR);
        assert!((ray.direction - Vec3::new(sin as f32, -cos as f32, 0.0)).length() < 1e-5, "{angle}");
        // The same in f64.
        let cos_in = |n: f64| (1.0 - (sin / n).powi(2)).sqrt();
        let fresnel = |n1: f64, n2: f64| {
            let (c1, c2) = (cos_in(n1), cos_in(n2));
            let s = ((n1 * c1 - n2 * c2) / (n1 * c1 + n2 * c2)).powi(2);
            let p = ((n2 * c1 - n1 * c2) / (n2 * c1 + n1 * c2)).powi(2);
            0.5 * (s + p)
        };
        let interfaces = ((1.0 - fresnel(1.0, 1.33)) * (1.0 - fresnel(1.33, 1.6))).powi(2);
        for channel in 0..3 {
            let sigma = f64::from(sigma[channel]);
            let depth = 0.5 * sigma * 1.25 / cos_in(1.33) + sigma * 0.75 / cos_in(1.6);
            let expected = interfaces * libm::exp(-depth);
            let got = f64::from(share[channel]);
            assert!((got / expected - 1.0).abs() < 2e-5, "{angle}: {got} against {expected}");
        }
    }
}

/// Light that has gone into a body of glass comes out of it: whatever edge or corner it is near, what arrives on the walls of the room
/// travels in air.
#[test]
fn no_light_takes_the_glass_with_it() {
    let hot = Material { emission: Radiance(Rgb::ONE), ..Material::lambertian("hot", Rgb::ZERO) };
    let scene = room(hot, |p| {
        let glass = p.add_material(Material::glass("glass", 1.5));
        p.add_sphere("ball", glass, Vec3::new(0.31, 0.2, -0.4), 0.7, 24);
        p.add_box("block", glass, Vec3::new(-1.3, -1.2, 0.2), Vec3::new(-0.5, -0.3, 1.1), false);
    });
    let tracer = Tracer::new(&scene);
    let key = Key::new(9, Purpose::Test, 0);
    let (mut arrivals, mut inside) = (0, 0);
    for i in 0..200_000 {
        let random = key.child(i);
        let from = uniform_sphere(random.point2(0)) * 1.8;
        // At an edge, a corner or anywhere on a triangle.
        let triangle = TriangleId(random.bits(1) % scene.triangles().len() as u32);
        let [a, b, c] = scene.corners(triangle);
        let target = match i % 3 {
            0 => a.lerp(b, random.uniform(2)),
            1 => a,
            _ => a.lerp(b, random.uniform(2)).lerp(c, random.uniform(3)),
        };
        let ray = Ray::free(from, (target - from).normalize_or_zero());
        let see = |sight: Sight| {
            if let Sight::Surface(arrival) = sight
                && arrival.interaction.emission.0.x > 0.0
            {
                arrivals += 1;
                inside += u32::from(arrival.media != MediumStack::AIR);
            }
        };
        let params = SplitParams { roulette_below: 0.01, ..SplitParams::default() };
        split::trace(
            &tracer,
            ray,
            MediumStack::AIR,
            (random, 0),
            &params,
            &mut Waiting::default(),
            |_| {},
            see,
        );
    }
    assert!(arrivals > 400_000, "{arrivals}");
    assert_eq!(inside, 0, "of {arrivals}");
}
