//! Light over a mirror that is narrow beside the mesh: a strip of it on a floor, where and how bright the image says.

use glam::Vec3;

use catoptric_light::{Glint, LightParams, Lights};
use catoptric_radiosity::{SolveParams, solve};
use catoptric_scene::{
    Material, PunctualKind, PunctualLight, Radiance, Rgb, Scene, SceneParts, Side, Silent,
};
use catoptric_solution::{Quality, Term};
use catoptric_trace::Tracer;

/// Edge of the lamp, metres, its radiance, and the mirror's reflectance.
const LAMP: f32 = 0.02;
const RADIANCE: f32 = 1000.0;
const MIRROR: f32 = 0.9;
/// The mirror stands in x = 0, between these heights and |z| ≤ 1.
const HEIGHTS: [f32; 2] = [0.10, 0.14];

/// A floor of 4 × 4 m and the mirror.
fn mirror_over_a_floor() -> SceneParts {
    let mut parts = SceneParts::default();
    let floor = parts.add_material(Material::lambertian("floor", Rgb::splat(0.5)));
    let mirror = parts.add_material(Material::mirror("mirror", Rgb::splat(MIRROR)));
    parts.add_quad("floor", floor, Vec3::new(-0.5, 0.0, 2.0), Vec3::X * 4.0, Vec3::Z * -4.0);
    let up = Vec3::Y * (HEIGHTS[1] - HEIGHTS[0]);
    parts.add_quad("mirror", mirror, Vec3::new(0.0, HEIGHTS[0], -1.0), up, Vec3::Z * 2.0);
    parts
}

/// Besides, in (2, 2, 0), a lamp that looks down and at the mirror, which looks back.
fn scene() -> Scene {
    let mut parts = mirror_over_a_floor();
    let lamp =
        Material { base_color: Rgb::ZERO, ..Material::emitter("lamp", Radiance(Rgb::splat(RADIANCE))) };
    let lamp = parts.add_material(lamp);
    // Its normal is (−1, −1, 0)/√2.
    let (a, b) = (Vec3::Z * LAMP, Vec3::new(-1.0, 1.0, 0.0) * (LAMP * std::f32::consts::FRAC_1_SQRT_2));
    parts.add_quad("lamp", lamp, Vec3::new(2.0, 2.0, 0.0) - 0.5 * (a + b), a, b);
    Scene::new(parts).expect("a valid scene")
}

/// Where light from the lamp's centre over the mirror at a height meets the floor: x of the straight line from the lamp's image
/// at x = −2.
fn thrown(height: f32) -> f32 {
    2.0 * height / (2.0 - height)
}

#[test]
fn glints_lie_where_the_image_throws_the_mirror() {
    let scene = scene();
    let tracer = Tracer::new(&scene);
    let lights = Lights::new(&tracer, LightParams::default());
    assert_eq!(lights.chains().chains().len(), 1);
    let [near, far] = HEIGHTS.map(thrown);
    let glints = lights.glints(0);
    // The strip is 2.1 m long: for each of its widths a path, and all of them arrive.
    let width = f64::from(far - near);
    assert!(glints.len() as f64 > 2.0 / width, "{} glints", glints.len());
    for Glint { triangle, side, position, width: found, length } in glints {
        assert_eq!((scene.surface_of(triangle).name.as_str(), side), ("floor", Side::Front));
        // The lamp is half its edge away from its centre, the floor a fourteenth of that from the mirror.
        let blur = f64::from(LAMP) * 0.1;
        let x = position.x;
        assert!(x > f64::from(near) - blur && x < f64::from(far) + blur, "x = {x}, not in {near} to {far}");
        assert!(position.z.abs() < 1.1);
        // The lamp's points are 0.007 m of 2 m off in x and in y, which widens the strip by 0.35 % each, and its diagonal is longer
        // than its edge by less than 1 %.
        assert!((found / width - 1.0).abs() < 0.02, "width {found}, not {width}");
        assert!(length > 2.0 && length < 2.3, "length {length}");
    }
}

/// The sun, in the direction of that lamp, throws the strip between x = y for both heights.
#[test]
fn glints_of_the_sun_are_as_wide_as_the_mirror_in_its_light() {
    let mut parts = mirror_over_a_floor();
    let direction = Vec3::new(-1.0, -1.0, 0.0) * std::f32::consts::FRAC_1_SQRT_2;
    parts.lights.push(PunctualLight {
        name: "sun".to_owned(),
        kind: PunctualKind::Directional,
        intensity: Rgb::ONE,
        position: Vec3::ZERO,
        direction,
    });
    let scene = Scene::new(parts).expect("a valid scene");
    let tracer = Tracer::new(&scene);
    let glints = Lights::new(&tracer, LightParams::default()).glints(0);
    // Its diagonal is 50.02 times as long as it is wide: a path for each, and none is lost.
    assert_eq!(glints.len(), 51);
    for glint in glints {
        // f32 rays from two diagonals away.
        assert!(glint.position.x > 0.0999 && glint.position.x < 0.1401, "{glint:?}");
        // Its diagonal is longer than its edge by 2e-4 of it.
        assert!((glint.width / 0.04 - 1.0).abs() < 1e-3, "{glint:?}");
    }
}

/// The mesh of a sketch is 0.4 m wide, the strip of light 0.045 m: all along it the mesh shows the lamp's image.
#[test]
fn a_coarse_mesh_shows_a_narrow_strip_of_light() {
    let scene = scene();
    let tracer = Tracer::new(&scene);
    let params = SolveParams::for_quality(Quality::Sketch);
    let solution = solve(&tracer, &params, &Silent).expect("nobody stops it").solution;
    let floor = scene.surfaces().iter().find(|s| s.name == "floor").expect("there is one").triangles.clone();
    let x = thrown(0.5 * (HEIGHTS[0] + HEIGHTS[1]));
    let mut sums = [0.0_f64; 2];
    for step in 0..81 {
        let z = -0.8 + 0.02 * f32::from(step as u8);
        let position = Vec3::new(x, 0.0, z);
        // The lamp's image: E = ρ·L·A·cos·cos / d², the lamp small beside its distance.
        let towards = Vec3::new(-2.0, 2.0, 0.0) - position;
        let distance = towards.length();
        let at_lamp = Vec3::new(1.0, -1.0, 0.0).dot(-towards) / (distance * std::f32::consts::SQRT_2);
        let exact =
            MIRROR * RADIANCE * LAMP * LAMP * at_lamp * (towards.y / distance) / (distance * distance);
        let located = floor
            .clone()
            .find_map(|t| solution.mesh.locate(catoptric_scene::TriangleId(t), Side::Front, position))
            .expect("the floor has elements");
        let shown = solution.irradiance(Term::Mirrored, &located).0.x;
        assert!(shown > 0.25 * exact, "z = {z}: {shown} of {exact}");
        sums[0] += f64::from(shown);
        sums[1] += f64::from(exact);
    }
    // Elements as wide as the strip halve its peak at most, or raise it by the fit's overshoot.
    let ratio = sums[0] / sums[1];
    assert!((0.6..1.3).contains(&ratio), "{ratio}");
}
