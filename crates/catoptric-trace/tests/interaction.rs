//! What surfaces do to light: energy, reciprocity, limits, and what lies in one plane.

use catoptric_scene::{AlphaMode, Barycentric, Material, Rgb, Scene, SceneParts, Transmission, TriangleId};
use catoptric_trace::fresnel;
use catoptric_trace::interaction::Interaction;
use catoptric_trace::medium::{MediumId, MediumStack};
use catoptric_trace::{Event, Hit, PlaneId, Ray, Tracer, walk};
use glam::Vec3;

/// One square of `material` in the plane y = 0, front up.
fn sheet(material: Material) -> Scene {
    let mut parts = SceneParts::default();
    let id = parts.add_material(material);
    parts.add_quad("sheet", id, Vec3::new(-1.0, 0.0, -1.0), Vec3::Z * 2.0, Vec3::X * 2.0);
    Scene::new(parts).expect("a valid scene")
}

/// The interaction of light that comes from above (`cos` > 0) or below at an angle of cosine |`cos`|.
fn at_angle(tracer: &Tracer, cos: f32, media: MediumStack) -> Interaction {
    let direction = Vec3::new((1.0 - cos * cos).max(0.0).sqrt(), -cos, 0.0);
    let hit = Hit { t: 1.0, triangle: TriangleId(0), at: Barycentric { u: 0.3, v: 0.3 }, back: cos < 0.0 };
    tracer.interact(direction, &hit, media)
}

/// Midpoint cosines of `n` equal steps in cos²θ: means over them are means of cosine-distributed light.
fn cosines(n: usize) -> impl Iterator<Item = f32> {
    (0..n).map(move |i| (((i as f64 + 0.5) / n as f64).sqrt()) as f32)
}

/// White paint under any pair of interfaces returns all the light of a furnace: Σ of what is mirrored and of what is
/// received and sent again, R + H_T·ρ/N·T̄ = 1. 20 000 midpoints have an error of 2e-6 (F has a slope at grazing
/// incidence, where a step in cos²θ is widest); the tables are allowed 2e-5.
#[test]
fn white_paint_under_coats_loses_nothing_in_a_furnace() {
    for (strength, clearcoat) in [(1.0, 0.0), (0.4, 0.0), (0.0, 1.0), (0.0, 0.3), (1.0, 1.0), (0.7, 0.6)] {
        for ior in [1.1, 1.33, 1.5, 2.4] {
            let paint = Material::lambertian("paint", Rgb::ONE);
            let scene = sheet(Material { roughness: 0.0, specular: strength, clearcoat, ior, ..paint });
            let tracer = Tracer::new(&scene);
            let (mut mirrored, mut received, mut sent, mut amount) = (0.0, 0.0, 0.0, 0.0);
            for cos in cosines(20_000) {
                let interaction = at_angle(&tracer, cos, MediumStack::AIR);
                let coat = tracer
                    .diffuse_side(
                        TriangleId(0),
                        &scene.surface_point(TriangleId(0), Barycentric { u: 0.0, v: 0.0 }),
                        interaction.side,
                    )
                    .unwrap()
                    .coat;
                mirrored += f64::from(interaction.passed_on().x);
                received += f64::from(interaction.receives);
                sent += f64::from(interaction.reflectance.x * coat.transmittance(cos));
                amount += 1.0;
                let together = interaction.passed_on().x + interaction.receives;
                assert!(
                    (together - 1.0).abs() < 2e-6,
                    "s {strength} c {clearcoat} n {ior} cos {cos}: {together}"
                );
            }
            let furnace = (mirrored + received * sent / amount) / amount;
            assert!((furnace - 1.0).abs() < 2e-5, "s {strength}, c {clearcoat}, n {ior}: {furnace}");
        }
    }
}

/// A clearcoat over rough metal is a coat over its whole diffuse colour: the light trapped under it counts.
#[test]
fn rough_metal_under_a_clearcoat_is_as_dark_as_paint_of_its_colour() {
    let reflectance = |metallic: f32| {
        let base = Material::lambertian("paint", Rgb::splat(0.5));
        let scene = sheet(Material { metallic, clearcoat: 1.0, ..base });
        let tracer = Tracer::new(&scene);
        at_angle(&tracer, 1.0, MediumStack::AIR).reflectance.x
    };
    for metallic in [0.5, 1.0] {
        assert!(
            (reflectance(metallic) - reflectance(0.0)).abs() < 1e-6,
            "{metallic}: {}",
            reflectance(metallic)
        );
    }
}

/// A perfect mirror stays one under a lossless coat.
#[test]
fn a_clearcoat_takes_nothing_from_a_perfect_mirror() {
    let scene = sheet(Material { clearcoat: 1.0, ..Material::mirror("mirror", Rgb::ONE) });
    let tracer = Tracer::new(&scene);
    for cos in cosines(100) {
        let passed = at_angle(&tracer, cos, MediumStack::AIR).passed_on().x;
        assert!((passed - 1.0).abs() < 2e-6, "{cos}: {passed}");
    }
}

/// Every lossless material passes on or receives exactly what came, at every angle and from both sides.
#[test]
fn lossless_surfaces_keep_all_light() {
    let blend =
        Material { alpha_mode: AlphaMode::Blend, base_alpha: 0.3, ..Material::lambertian("b", Rgb::ONE) };
    let pane = Material { transmission_kind: Transmission::Pane, ..Material::glass("pane", 1.52) };
    let half = Material { transmission: 0.5, double_sided: true, ..pane.clone() };
    let materials = [
        Material::mirror("mirror", Rgb::ONE),
        Material::glass("glass", 1.5),
        Material::glass("nothing", 1.0),
        Material { double_sided: true, roughness: 0.0, ..blend },
        Material { clearcoat: 1.0, ..pane.clone() },
        pane,
        half,
    ];
    for material in materials {
        let both = material.double_sided || material.transmission > 0.0;
        let scene = sheet(material);
        let tracer = Tracer::new(&scene);
        let inside = MediumStack::inside(MediumId(1));
        for cos in cosines(200).chain([0.0, 1.0]) {
            for cos in if both { vec![cos, -cos] } else { vec![cos] } {
                let solid = scene.materials()[0].transmission_kind == Transmission::Solid;
                let media = if solid && cos < 0.0 { inside } else { MediumStack::AIR };
                let interaction = at_angle(&tracer, cos, media);
                let kept = interaction.passed_on() + Rgb::splat(interaction.receives);
                // `receives` is the diffuse share's; a half pane has a diffuse half that is received with T, counted
                // by the walk as what is not passed on.
                let all = if scene.materials()[0].transmission == 0.5 { Rgb::ONE } else { kept };
                assert!(
                    (all - Rgb::ONE).abs().max_element() < 3e-6,
                    "{} {cos}: {kept}",
                    scene.materials()[0].name
                );
                assert!(interaction.passed_on().max_element() <= 1.0 + 2e-6);
            }
        }
    }
}

/// Refraction is Snell's law, reversible, with the same Fresnel transmittance both ways (Stokes; Born & Wolf §1.6).
#[test]
fn refraction_is_reversible() {
    let scene = sheet(Material::glass("glass", 1.5));
    let tracer = Tracer::new(&scene);
    let inside = MediumStack::inside(MediumId(1));
    for cos in cosines(500) {
        let into = at_angle(&tracer, cos, MediumStack::AIR);
        let refracted = into.branches()[1];
        assert_eq!(refracted.media, inside);
        let sin = (1.0 - cos * cos).sqrt();
        assert!((refracted.direction.x * 1.5 - sin).abs() < 1e-6);
        // The same path backwards.
        let hit = Hit { t: 1.0, triangle: TriangleId(0), at: Barycentric { u: 0.3, v: 0.3 }, back: true };
        let out = tracer.interact(-refracted.direction, &hit, inside);
        let back = out.branches().last().unwrap();
        assert_eq!(back.media, MediumStack::AIR);
        let start = Vec3::new(sin, -cos, 0.0);
        // Near grazing exit the direction is ill-conditioned: an error ε of the inner cosine turns it by √ε.
        assert!((back.direction + start).length() < 2e-6 / cos.max(1e-3), "{cos}");
        assert!((back.throughput - refracted.throughput).abs().max_element() < 1e-5 / cos.max(1e-3), "{cos}");
    }
    // Beyond the critical angle everything is reflected.
    let critical = (1.0 - 1.0 / 2.25_f32).sqrt();
    for cos in [0.01, 0.3, critical - 1e-4] {
        let total = at_angle(&tracer, -cos, inside);
        assert_eq!(total.branches().len(), 1);
        assert_eq!(total.passed_on(), Rgb::ONE);
    }
}

/// Two slabs' transmittances at normal incidence and at 60°: unpolarised at each interface, T = (1−R)/(1+R) for all
/// internal bounces, R of Fresnel in f64.
#[test]
fn a_pane_is_the_sum_of_all_internal_bounces() {
    let scene = sheet(Material { transmission_kind: Transmission::Pane, ..Material::glass("pane", 1.5) });
    let tracer = Tracer::new(&scene);
    for angle in [0.0_f64, 30.0, 45.0, 60.0, 80.0, 89.0] {
        let (n, cos) = (1.5_f64, libm::cos(angle.to_radians()));
        let cos_t = (1.0 - (1.0 - cos * cos) / (n * n)).sqrt();
        let s = ((cos - n * cos_t) / (cos + n * cos_t)).powi(2);
        let p = ((n * cos - cos_t) / (n * cos + cos_t)).powi(2);
        let r = 0.5 * (s + p);
        let interaction = at_angle(&tracer, cos as f32, MediumStack::AIR);
        let straight = interaction.branches().iter().find(|b| b.event == Event::Undeviated).unwrap();
        assert!((f64::from(straight.throughput.x) - (1.0 - r) / (1.0 + r)).abs() < 3e-6, "{angle}");
    }
}

/// The exact average of Walsh 1926 (quoted by Duntley 1942) for n = 1.5 is 0.091 777.
#[test]
fn the_diffuse_average_is_exact() {
    let walsh = |n: f64| {
        let (n2, n4) = (n * n, n.powi(4));
        0.5 + (n - 1.0) * (3.0 * n + 1.0) / (6.0 * (n + 1.0).powi(2))
            + n2 * (n2 - 1.0).powi(2) / (n2 + 1.0).powi(3) * libm::log((n - 1.0) / (n + 1.0))
            - 2.0 * n.powi(3) * (n2 + 2.0 * n - 1.0) / ((n2 + 1.0) * (n4 - 1.0))
            + 8.0 * n4 * (n4 + 1.0) / ((n2 + 1.0) * (n4 - 1.0).powi(2)) * libm::log(n)
    };
    for n in [1.1, 1.33, 1.5, 2.0, 2.4] {
        let error = f64::from(fresnel::diffuse(n as f32).external) - walsh(n);
        assert!(error.abs() < 2e-6, "n {n}: {error:e}");
    }
}

/// An interface between equal indices does nothing, at grazing incidence too.
#[test]
fn equal_indices_reflect_nothing() {
    for cos in [0.0, 1e-20, 1e-4, 0.5, 1.0] {
        assert_eq!(fresnel::refract(cos, 1.5, 1.5).reflectance, 0.0, "{cos}");
    }
}

/// Glass that stands on a table shares a plane with it. Light inside must arrive at the table, not leave through the
/// bottom of the glass and, as rays never meet the plane they start from, pass the table.
#[test]
fn light_does_not_leak_through_a_table_under_glass() {
    let blend =
        Material { alpha_mode: AlphaMode::Blend, base_alpha: 0.5, ..Material::lambertian("b", Rgb::ONE) };
    let pane = Material { transmission_kind: Transmission::Pane, ..Material::glass("pane", 1.52) };
    for (material, first) in [
        (Material::glass("glass", 1.5), true),
        (pane, true),
        (blend, true),
        (Material::glass("glass", 1.5), false),
    ] {
        let mut parts = SceneParts::default();
        let white = parts.add_material(Material::lambertian("table", Rgb::splat(0.5)));
        let clear = parts.add_material(material);
        let block = |parts: &mut SceneParts| {
            parts.add_box("block", clear, Vec3::new(-0.31, 0.7, -0.29), Vec3::new(0.37, 1.3, 0.33), false);
        };
        if first {
            block(&mut parts);
        }
        parts.add_quad("table", white, Vec3::new(-1.13, 0.7, -1.07), Vec3::Z * 2.0, Vec3::X * 2.0);
        if !first {
            block(&mut parts);
        }
        let scene = Scene::new(parts).unwrap();
        let tracer = Tracer::new(&scene);
        for i in 0..2000 {
            let x = -0.3 + 0.6 * (i as f32 + 0.5) / 2000.0;
            let ray = Ray::free(
                Vec3::new(0.02, 1.0, 0.01),
                (Vec3::new(x, 0.7, 0.1 * x) - Vec3::new(0.02, 1.0, 0.01)).normalize_or_zero(),
            );
            let hit = tracer.nearest(&ray, f32::INFINITY).unwrap();
            assert_eq!(scene.surface_of(hit.triangle).name, "table", "{i}");
        }
    }
}

/// A coated lamp is a mirror in its own plane, whose image is the lamp itself: light over it would be counted twice. Oblique, so
/// that points on the lamp are rounded to either side of it.
#[test]
fn a_lamp_has_no_image_in_its_own_plane() {
    let mut parts = SceneParts::default();
    let coat = Material::lambertian("lamp", Rgb::ONE);
    let lamp = parts.add_material(Material { roughness: 0.0, specular: 1.0, double_sided: true, ..coat });
    parts.add_quad(
        "lamp",
        lamp,
        Vec3::new(-1.1, 0.3, -0.9),
        Vec3::new(0.13, 0.71, 1.9),
        Vec3::new(1.7, 0.37, -0.2),
    );
    let scene = Scene::new(parts).unwrap();
    let tracer = Tracer::new(&scene);
    let plane = tracer.planes().of(TriangleId(0));
    assert!(tracer.plane_has_images(plane));
    let origin =
        scene.position(TriangleId(0), Barycentric { u: 0.4, v: 0.2 }) + scene.geometric_normal(TriangleId(0));
    for i in 0..1000_u32 {
        let [u, v] = [i % 32, i / 32].map(|k| k as f32 / 64.0);
        let point = scene.position(TriangleId(0), Barycentric { u, v });
        let image = tracer.planes().plane(plane).reflect_point(point.as_dvec3()).as_vec3();
        let seen = walk::follow(&tracer, origin, PlaneId::NONE, &[plane], &[image, point], plane);
        assert_eq!(seen, Rgb::ZERO, "{point}");
    }
}

/// A light behind a mirror is not lit by it: the path must leave the mirror on the side from which it came.
#[test]
fn chains_end_in_front_of_their_mirror() {
    let scene = sheet(Material::mirror("mirror", Rgb::ONE));
    let tracer = Tracer::new(&scene);
    let plane = tracer.planes().of(TriangleId(0));
    assert!(tracer.plane_has_images(plane));
    let origin = Vec3::new(0.1, 0.5, 0.1);
    let see = |light: Vec3| {
        let image = light * Vec3::new(1.0, -1.0, 1.0);
        walk::follow(&tracer, origin, PlaneId::NONE, &[plane], &[image, light], PlaneId::NONE)
    };
    assert_eq!(see(Vec3::new(-0.2, 0.7, 0.0)), Rgb::ONE);
    // The image of a light below the sheet lies above it.
    assert_eq!(see(Vec3::new(-0.2, -0.3, 0.0)), Rgb::ZERO);
    // Here the line of sight falls, and meets the mirror beyond the image.
    assert_eq!(see(Vec3::new(0.0, -0.45, 0.1)), Rgb::ZERO);
}

/// A mirror and a chrome ball as one mesh with normals: the mirror has an image, the ball's facets have none.
#[test]
fn flat_mirrors_of_smooth_meshes_have_images() {
    let mut parts = SceneParts::default();
    let chrome = parts.add_material(Material::mirror("chrome", Rgb::ONE));
    parts.add_quad("all", chrome, Vec3::ZERO, Vec3::Z, Vec3::X);
    parts.add_sphere("ball", chrome, Vec3::new(0.5, 1.0, 0.5), 0.3, 4);
    parts.join_surfaces();
    let scene = Scene::new(parts).expect("a valid scene");
    let tracer = Tracer::new(&scene);
    for index in 0..scene.triangles().len() as u32 {
        assert_eq!(tracer.image_plane(TriangleId(index)).is_some(), index < 2, "{index}");
    }
}

/// Surfaces that are for the eye only neither send nor receive light.
#[test]
fn unlit_surfaces_take_no_part_in_the_exchange() {
    let scene = sheet(Material { unlit: true, ..Material::lambertian("sign", Rgb::ONE) });
    let tracer = Tracer::new(&scene);
    let interaction = at_angle(&tracer, 0.7, MediumStack::AIR);
    assert_eq!(interaction.receives, 0.0);
    assert_eq!(interaction.passed_on(), Rgb::ZERO);
}

/// An ideal mirror in the plane y = 0 with a normal map of one texel; seen from above with −z up, u runs to the right (or, if
/// `mirrored`, to the left) and v down.
fn mapped_mirror(texel: [u8; 4], mirrored: bool, tangents: bool) -> Scene {
    let mut parts = SceneParts::default();
    let map = catoptric_scene::Texture {
        name: "map".to_owned(),
        width: 1,
        height: 1,
        texels: vec![texel],
        wrap_u: catoptric_scene::Wrap::Repeat,
        wrap_v: catoptric_scene::Wrap::Repeat,
        linear_filter: true,
    };
    parts.textures.push(map);
    let reference = catoptric_scene::TextureRef {
        texture: catoptric_scene::TextureId(0),
        uv_set: 0,
        transform: catoptric_scene::TextureTransform::IDENTITY,
    };
    let mirror = Material {
        normal_texture: Some((reference, 1.0)),
        double_sided: true,
        ..Material::mirror("m", Rgb::ONE)
    };
    let id = parts.add_material(mirror);
    parts.add_quad("sheet", id, Vec3::new(-1.0, 0.0, -1.0), Vec3::Z * 2.0, Vec3::X * 2.0);
    for vertex in &mut parts.vertices {
        let (u, v) = (vertex.position.x, vertex.position.z);
        vertex.uv[0] = glam::Vec2::new(if mirrored { -u } else { u }, v);
        if tangents {
            // b = w·(n × t): seen from above n × x points to −z, against +v.
            vertex.tangent =
                if mirrored { glam::Vec4::new(-1.0, 0.0, 0.0, -1.0) } else { Vec3::X.extend(1.0) };
        }
    }
    Scene::new(parts).expect("a valid scene")
}

/// A texel of (0.8, 0, 0.6) leans to +u, one of (0, 0.8, 0.6) to −v: light from straight above leaves
/// along 2(n·up)n − up. With or without tangents, images mirrored or not, and for the back as for the front. An 8-bit code
/// is off by at most 1/255 per component: 0.02 in the direction. Light itself does not see the map.
/// A triangle whose normals are smooth over an edge, as exporters write them: from every direction, a mirror and glass send all light away from the
/// side where it came from and into the other one.
#[test]
fn normals_that_are_smooth_over_an_edge_lose_no_light() {
    for material in [Material::mirror("mirror", Rgb::ONE), Material::glass("glass", 1.5)] {
        let solid = material.is_solid();
        let mut parts = SceneParts::default();
        let id = parts.add_material(material);
        let corners = [Vec3::ZERO, Vec3::new(0.0, 0.0, 4.0), Vec3::new(4.0, 0.0, 0.0)];
        let normals = [Vec3::Y, Vec3::new(0.8, 0.6, 0.0), Vec3::new(0.9, 0.3, 0.3)];
        let normals = normals.map(|normal| normal.normalize_or_zero());
        parts.add_mesh("leaning", id, &corners, &normals, &[[0, 1, 2]], true);
        let scene = Scene::new(parts).unwrap();
        let tracer = Tracer::new(&scene);
        let mut is_flat = 0;
        for step in 0..4000 {
            let turn = 2.4 * step as f32;
            let cos = (step as f32 + 0.5) / 4000.0;
            let sin = (1.0 - cos * cos).sqrt();
            for back in if solid { vec![false, true] } else { vec![false] } {
                let down = if back { cos } else { -cos };
                let direction = Vec3::new(sin * libm::cosf(turn), down, sin * libm::sinf(turn));
                let at = Barycentric { u: 0.4, v: 0.5 };
                let hit = Hit { t: 1.0, triangle: TriangleId(0), at, back };
                let media = if back { MediumStack::inside(MediumId(1)) } else { MediumStack::AIR };
                let seen = tracer.interact_as_seen(direction, &hit, media, true);
                assert!((seen.passed_on() - Rgb::ONE).abs().max_element() < 3e-6, "{direction}: {seen:?}");
                for branch in seen.branches() {
                    let through = branch.direction.y * down > 0.0;
                    assert_eq!(through, branch.media != media, "{direction}: {branch:?}");
                }
                is_flat += u32::from(seen.normal == seen.geometric);
            }
        }
        assert!(is_flat > 100, "no direction called for it");
    }
}

#[test]
fn normal_maps_bend_what_the_eye_sees_in_a_mirror_and_nothing_else() {
    let code = |x: f32| ((x + 1.0) * 127.5).round() as u8;
    let seen = |texel: [f32; 3], mirrored, tangents, back: bool| {
        let [x, y, z] = texel.map(code);
        let scene = mapped_mirror([x, y, z, 255], mirrored, tangents);
        let tracer = Tracer::new(&scene);
        let direction = if back { Vec3::Y } else { Vec3::NEG_Y };
        let hit = Hit { t: 1.0, triangle: TriangleId(0), at: Barycentric { u: 0.3, v: 0.3 }, back };
        let light = tracer.interact(direction, &hit, MediumStack::AIR);
        assert_eq!(light.branches()[0].direction, -direction, "light must not see the map");
        tracer.interact_as_seen(direction, &hit, MediumStack::AIR, true).branches()[0].direction
    };
    for tangents in [false, true] {
        for (texel, mirrored, expected) in [
            ([0.8, 0.0, 0.6], false, Vec3::new(0.96, -0.28, 0.0)),
            ([0.6, 0.0, 0.8], false, Vec3::new(0.96, 0.28, 0.0)),
            ([0.6, 0.0, 0.8], true, Vec3::new(-0.96, 0.28, 0.0)),
            ([0.0, 0.6, 0.8], false, Vec3::new(0.0, 0.28, -0.96)),
            ([0.0, 0.6, 0.8], true, Vec3::new(0.0, 0.28, -0.96)),
        ] {
            let found = seen(texel, mirrored, tangents, false);
            // A reflection that would go below the surface grazes it.
            let expected = if expected.y < 0.0 { Vec3::X } else { expected };
            assert!(
                (found - expected).length() < 0.02,
                "{texel:?}, mirrored {mirrored}, tangents {tangents}: {found}"
            );
            let behind = seen(texel, mirrored, tangents, true);
            assert!((behind + found).length() < 1e-5, "the back is the front turned over: {behind}");
        }
    }
}
