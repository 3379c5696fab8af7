//! The caustic term against closed forms, its own books, and hemisphere gathers.

use catoptric_light::{LightParams, Lights};
use catoptric_radiosity::caustic::{Caustic, CausticParams, caustic};
use catoptric_radiosity::display::Displayed;
use catoptric_radiosity::draft::Draft;
use catoptric_radiosity::gather::{DiffuseLight, gather};
use catoptric_scene::{
    Material, PunctualKind, PunctualLight, Radiance, Rgb, Scene, SceneParts, Side, Silent, Transmission,
    TriangleId,
};
use catoptric_solution::{Quality, Solution, Term};
use catoptric_trace::Tracer;
use catoptric_trace::sequence::{Key, Purpose};
use catoptric_trace::walk::WalkParams;
use glam::Vec3;
use rayon::prelude::*;

/// A scene cut into a base mesh, and its caustic light.
struct Case {
    draft: Draft,
    base: Displayed,
    caustic: Option<Caustic>,
}

fn solve(tracer: &Tracer, spacing: f32, rays: u32) -> Case {
    let standard = CausticParams::for_quality(Quality::Standard);
    solve_by(tracer, spacing, &CausticParams { min_rays: rays, max_rays: rays, ..standard }, Rgb::ZERO)
}

/// With other light everywhere, against which that of caustics is seen.
fn solve_by(tracer: &Tracer, spacing: f32, params: &CausticParams, other: Rgb) -> Case {
    let lights = Lights::new(tracer, LightParams::default());
    let draft = Draft::new(tracer, spacing);
    let base = draft.display(tracer);
    let other = vec![other; draft.vertices.len()];
    let walk = WalkParams::default();
    let found = caustic(&lights, &draft, &base, &other, walk, 1, params, &Silent);
    Case { caustic: found.expect("nobody cancels"), draft, base }
}

/// The caustic light alone, on the mesh that is shown.
fn shown(tracer: &Tracer, draft: &Draft, base: &Displayed, caustic: &Caustic) -> Solution {
    let vertices = base.mesh.vertices.len();
    let empty = Solution {
        mesh: base.mesh.clone(),
        irradiance: std::array::from_fn(|_| vec![Rgb::ZERO; vertices]),
        punctual: vec![Rgb::ZERO; vertices],
        ..Solution::default()
    };
    caustic.add_to(tracer, &mut draft.clone(), &base.origin, empty)
}

/// Σ of area × mean of the corners over a draft's leaves, those at which `count` says so.
fn power(draft: &Draft, values: &[Rgb], count: impl Fn(Vec3) -> bool) -> f64 {
    let leaves = draft.leaves.iter().filter(|leaf| count(draft.center(leaf)));
    leaves
        .map(|leaf| {
            let sum: f32 = leaf.vertices.iter().map(|&v| values[v as usize].y).sum();
            f64::from(draft.area(leaf)) * f64::from(sum) / 3.0
        })
        .sum()
}

fn room(parts: &mut SceneParts, half: f32) {
    let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.7)));
    parts.add_box("room", white, Vec3::splat(-half), Vec3::splat(half), true);
}

fn lamp(parts: &mut SceneParts, corner: Vec3, size: f32) {
    let light = parts.add_material(Material::emitter("lamp", Radiance(Rgb::new(3.0, 10.0, 5.0))));
    parts.add_quad("lamp", light, corner, Vec3::X * size, Vec3::Z * size);
}

fn sun(parts: &mut SceneParts, direction: Vec3) {
    parts.lights.push(PunctualLight {
        name: "sun".to_owned(),
        position: Vec3::ZERO,
        direction: direction.normalize_or_zero(),
        intensity: Rgb::splat(2.0),
        kind: PunctualKind::Directional,
    });
}

fn glass_ball() -> Scene {
    let mut parts = SceneParts::default();
    room(&mut parts, 1.0);
    lamp(&mut parts, Vec3::new(-0.2, 0.99, -0.2), 0.4);
    let glass = parts.add_material(Material::glass("glass", 1.5));
    parts.add_sphere("ball", glass, Vec3::ZERO, 0.4, 32);
    Scene::new(parts).expect("valid")
}

#[test]
fn the_books_balance_and_the_mesh_holds_the_power_that_arrived() {
    let scene = glass_ball();
    let tracer = Tracer::new(&scene);
    let case = solve(&tracer, 0.25, 1 << 16);
    let caustic = case.caustic.expect("there are caustics");
    let report = caustic.report;
    let balance = (report.ledger.sum() - report.sent).abs().max_element() / report.sent.max_element();
    assert!(balance < 1e-4, "{report:?}");
    let kept = (report.deposited + report.elsewhere - report.ledger.arrived).abs().max_element();
    assert!(kept / report.sent.max_element() < 1e-6, "{report:?}");

    let everywhere = |_: Vec3| true;
    let on_base = power(&case.draft, &caustic.on(&case.draft), everywhere);
    assert!((on_base / report.deposited.y - 1.0).abs() < 1e-3, "{on_base} {report:?}");

    // The same on the mesh that is shown, whose green halves count as triangles.
    let shown = shown(&tracer, &case.draft, &case.base, &caustic);
    shown.validate().expect("valid");
    let values = &shown.irradiance[Term::Caustic.index()];
    let on_shown: f64 = (0..shown.mesh.elements.len() as u32)
        .map(|e| {
            let corners = shown.mesh.elements[e as usize].vertices;
            let mean = corners.iter().map(|&v| values[v as usize].y).sum::<f32>() / 3.0;
            f64::from(shown.mesh.area(e) * mean)
        })
        .sum();
    assert!(shown.mesh.elements.len() > case.base.mesh.elements.len());
    assert!((on_shown / report.deposited.y - 1.0).abs() < 1e-3, "{on_shown} {report:?}");
}

#[test]
fn a_paraboloid_sends_the_sun_to_its_focus() {
    // y = (x² + z²)/4f, f = 1, rim at 0.5; a square at the focus looks down and shades the middle.
    let mut parts = SceneParts::default();
    let mirror = parts.add_material(Material::mirror("dish", Rgb::ONE));
    let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
    let (rings, columns) = (24_u32, 96_u32);
    let mut positions = vec![Vec3::ZERO];
    for ring in 1..=rings {
        for column in 0..columns {
            let (sin, cos) = libm::sincosf(std::f32::consts::TAU * column as f32 / columns as f32);
            let r = 0.5 * ring as f32 / rings as f32;
            positions.push(Vec3::new(r * cos, 0.25 * r * r, -r * sin));
        }
    }
    let normals: Vec<Vec3> =
        positions.iter().map(|p| Vec3::new(-0.5 * p.x, 1.0, -0.5 * p.z).normalize_or_zero()).collect();
    let mut indices = Vec::new();
    for column in 0..columns {
        let next = (column + 1) % columns;
        indices.push([0, 1 + column, 1 + next]);
        for ring in 0..rings - 1 {
            let (a, b) = (1 + ring * columns + column, 1 + ring * columns + next);
            indices.extend([[a, a + columns, b], [b, a + columns, b + columns]]);
        }
    }
    parts.add_mesh("dish", mirror, &positions, &normals, &indices, true);
    let half = 0.02;
    parts.add_quad("screen", white, Vec3::new(-half, 1.0, -half), Vec3::X * 2.0 * half, Vec3::Z * 2.0 * half);
    sun(&mut parts, -Vec3::Y);
    let scene = Scene::new(parts).expect("valid");
    let tracer = Tracer::new(&scene);
    let case = solve(&tracer, 0.02, 1 << 16);
    let caustic = case.caustic.expect("there are caustics");
    let found = power(&case.draft, &caustic.on(&case.draft), |_| true);
    // Area of the polygon under the rim, less the shadow of the screen.
    let n = f64::from(columns);
    let dish = 0.5 * n * 0.25 * libm::sin(2.0 * std::f64::consts::PI / n);
    let expected = 2.0 * (dish - 4.0 * f64::from(half * half));
    assert!((found / expected - 1.0).abs() < 5e-3, "{found} {expected}");
}

/// Most of what caustics light is the wide, weak light of a large ball of mirror, which few rays tell well: the focus of a
/// small ball of glass, a hundredth of the surface, needs more.
#[test]
fn a_small_focus_beside_a_wide_caustic_gets_the_rays_it_needs() {
    let mut parts = SceneParts::default();
    room(&mut parts, 1.0);
    lamp(&mut parts, Vec3::new(-0.05, 0.8, -0.05), 0.1);
    let mirror = parts.add_material(Material::mirror("mirror", Rgb::ONE));
    parts.add_sphere("large", mirror, Vec3::new(-0.5, -0.3, 0.0), 0.3, 32);
    let glass = parts.add_material(Material::glass("glass", 1.5));
    parts.add_sphere("small", glass, Vec3::new(0.5, -0.8, 0.0), 0.12, 32);
    let scene = Scene::new(parts).expect("valid");
    let tracer = Tracer::new(&scene);
    let standard = CausticParams::for_quality(Quality::Standard);
    let all = CausticParams { min_rays: 1 << 22, max_rays: 1 << 22, ..standard };
    let around_focus = |params: &CausticParams| -> (u32, Vec<f32>) {
        let case = solve_by(&tracer, 0.1, params, Rgb::splat(0.02));
        let caustic = case.caustic.expect("there are caustics");
        let solution = shown(&tracer, &case.draft, &case.base, &caustic);
        let at = |x: f32, z: f32| -> f32 {
            let floor = Vec3::new(x, -1.0, z);
            let mut triangles = (0..scene.triangles().len() as u32).map(TriangleId);
            let found = triangles
                .find_map(|t| {
                    let height = scene.corners(t).map(|c| c.y);
                    if height == [-1.0; 3] { solution.mesh.locate(t, Side::Front, floor) } else { None }
                })
                .expect("the floor holds light");
            solution.irradiance(Term::Caustic, &found).0.y
        };
        let grid =
            (0..40).flat_map(|i| (0..40).map(move |k| (0.5 + 0.005 * i as f32, -0.1 + 0.005 * k as f32)));
        (caustic.report.rays, grid.map(|(x, z)| at(x, z)).collect())
    };
    let (rays, found) = around_focus(&standard);
    let (_, expected) = around_focus(&all);
    let difference: f32 = found.iter().zip(&expected).map(|(a, b)| (a - b).abs()).sum();
    let share = difference / expected.iter().sum::<f32>();
    // That is what the last doubling may have changed where it is bright, root mean square; by area alone 32 768 rays do, and .16 is off.
    assert!(share < standard.focus, "{rays} rays, {share}");
}

#[test]
fn a_glass_slab_passes_what_fresnel_s_equations_say() {
    for sine in [0.0_f64, 0.5] {
        let mut parts = SceneParts::default();
        let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
        let glass = parts.add_material(Material::glass("glass", 1.5));
        parts.add_quad("floor", white, Vec3::new(-2.0, 0.0, -2.0), Vec3::Z * 4.0, Vec3::X * 4.0);
        parts.add_box("slab", glass, Vec3::new(-1.0, 0.1, -1.0), Vec3::new(1.0, 0.15, 1.0), false);
        let cos = (1.0 - sine * sine).sqrt();
        sun(&mut parts, Vec3::new(sine as f32, -cos as f32, 0.0));
        let scene = Scene::new(parts).expect("valid");
        let tracer = Tracer::new(&scene);
        let case = solve(&tracer, 0.2, 1 << 16);
        let caustic = case.caustic.expect("there are caustics");
        let inner = |p: Vec3| p.x.abs() < 0.5 && p.z.abs() < 0.5;
        let area = power(&case.draft, &vec![Rgb::ONE; case.draft.vertices.len()], inner);
        let found = power(&case.draft, &caustic.on(&case.draft), inner) / area;
        // All internal bounces, both polarisations: they mix in a renderer without polarisation.
        let inside = (1.0 - (sine / 1.5).powi(2)).sqrt();
        let s = ((cos - 1.5 * inside) / (cos + 1.5 * inside)).powi(2);
        let p = ((1.5 * cos - inside) / (1.5 * cos + inside)).powi(2);
        let r = 0.5 * (s + p);
        let expected = 2.0 * cos * (1.0 - r) / (1.0 + r);
        assert!((found / expected - 1.0).abs() < 5e-3, "sin {sine}: {found} {expected}");
    }
}

/// The same power arrives at the walls of a room if each of their points asks by hemisphere rays. The coarse ball has
/// interpolated normals far from its geometry: without the factor for adjoint scattering the two differ.
#[test]
fn light_side_rays_and_hemisphere_gathers_agree() {
    for glass in [false, true] {
        let mut parts = SceneParts::default();
        room(&mut parts, 1.0);
        lamp(&mut parts, Vec3::new(-0.5, 0.9, -0.5), 1.0);
        let material = if glass { Material::glass("ball", 1.5) } else { Material::mirror("ball", Rgb::ONE) };
        let ball = parts.add_material(material);
        parts.add_sphere("ball", ball, Vec3::new(0.0, -0.2, 0.1), 0.5, 6);
        let scene = Scene::new(parts).expect("valid");
        let tracer = Tracer::new(&scene);
        let case = solve(&tracer, 0.25, 1 << 18);
        let caustic = case.caustic.expect("there are caustics");
        let lights = Lights::new(&tracer, LightParams { light_rays: false, ..LightParams::default() });
        let dark = vec![Rgb::ZERO; case.base.mesh.vertices.len()];
        let light = DiffuseLight { mesh: &case.base.mesh, irradiance: &dark };
        // Uniform points by area on the floor and on one wall.
        for (axis, name) in [(1, "floor"), (0, "wall")] {
            let side = |p: Vec3| p[axis] < -0.999;
            let found = power(&case.draft, &caustic.on(&case.draft), side) / 4.0;
            let count = 1 << 14;
            let key = Key::new(3, Purpose::Test, axis as u64);
            let draft = &case.draft;
            let leaf = draft.leaves.iter().find(|l| side(draft.center(l))).expect("a face");
            let face = &draft.faces[leaf.face as usize];
            let mut normal = Vec3::ZERO;
            normal[axis] = 1.0;
            let values: Vec<f64> = (0..count)
                .into_par_iter()
                .map(|index| {
                    let at = key.point2(index) * 2.0 - 1.0;
                    let mut position = Vec3::splat(-1.0);
                    position[(axis + 1) % 3] = at.x;
                    position[(axis + 2) % 3] = at.y;
                    let triangle = face.triangle_at(&tracer, position);
                    let receiver = draft.receiver_at(
                        &tracer,
                        face,
                        draft.medium_of_root[leaf.root as usize],
                        position,
                        normal,
                        triangle,
                    );
                    let walk = WalkParams::default();
                    f64::from(gather(&lights, &light, &receiver, 128, key.child(index), &walk).caustic.y)
                })
                .collect();
            let sum: f64 = values.iter().sum();
            let squares: f64 = values.iter().map(|v| v * v).sum();
            let n = f64::from(count);
            let mean = sum / n;
            let error = ((squares / n - mean * mean) / n).sqrt();
            // Four standard errors of the gathers; those of the light rays are not counted.
            assert!(
                (found - mean).abs() < 4.0 * error + 1e-3 * mean,
                "glass {glass}, {name}: {found} and {mean} ± {error}"
            );
            assert!(error < 0.04 * mean, "{error} {mean}");
        }
    }
}

#[test]
fn there_is_nothing_to_do_without_curved_things_or_concentrated_lights() {
    let mut parts = SceneParts::default();
    room(&mut parts, 1.0);
    lamp(&mut parts, Vec3::new(-0.2, 0.99, -0.2), 0.4);
    let mirror = parts.add_material(Material::mirror("mirror", Rgb::splat(0.9)));
    parts.add_quad("mirror", mirror, Vec3::new(-0.5, -0.5, -0.9), Vec3::X, Vec3::Y);
    let pane = Material { transmission_kind: Transmission::Pane, ..Material::glass("pane", 1.5) };
    let pane = parts.add_material(pane);
    parts.add_quad("pane", pane, Vec3::new(-0.5, -0.5, 0.5), Vec3::X, Vec3::Y);
    let scene = Scene::new(parts).expect("valid");
    let tracer = Tracer::new(&scene);
    assert!(solve(&tracer, 0.5, 1 << 12).caustic.is_none());

    let mut parts = SceneParts::default();
    let glowing = Material { emission: Radiance(Rgb::ONE), ..Material::lambertian("walls", Rgb::splat(0.5)) };
    let glowing = parts.add_material(glowing);
    parts.add_box("room", glowing, Vec3::splat(-1.0), Vec3::splat(1.0), true);
    let glass = parts.add_material(Material::glass("glass", 1.5));
    parts.add_sphere("ball", glass, Vec3::ZERO, 0.4, 8);
    let scene = Scene::new(parts).expect("valid");
    let tracer = Tracer::new(&scene);
    assert!(solve(&tracer, 0.5, 1 << 12).caustic.is_none());
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let scene = glass_ball();
    let tracer = Tracer::new(&scene);
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| {
            let case = solve(&tracer, 0.25, 1 << 14);
            let caustic = case.caustic.expect("there are caustics");
            (caustic.on(&case.draft), caustic.report)
        })
    };
    assert_eq!(with(1), with(3));
}
