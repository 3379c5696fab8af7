//! Every method and solver against `reference/analytic/cases.json`: read as it is, every case counted, none left out
//! unseen.

use std::collections::BTreeMap;
use std::path::Path;

use glam::Vec3;
use serde_json::Value;

use catoptric_light::irradiance::Scratch;
use catoptric_light::{LightParams, Lights, Receiver};
use catoptric_radiosity::method::{ElementSet, FactorRow, Method, MethodParams, prepare};
use catoptric_radiosity::solver::{Params, Solver, StoredRows, System, solve_system};
use catoptric_scene::{
    Barycentric, Material, PunctualKind, PunctualLight, Radiance, Rgb, Scene, SceneParts, Side, TriangleId,
};
use catoptric_trace::Tracer;
use catoptric_trace::sequence::{Key, Purpose};

fn cases() -> Vec<Value> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../reference/analytic/cases.json");
    let text = std::fs::read_to_string(path).expect("the cases are there");
    let file: Value = serde_json::from_str(&text).expect("JSON");
    file["cases"].as_array().expect("cases").clone()
}

fn number(value: &Value) -> f64 {
    value.as_f64().expect("a number")
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().expect("a list").iter().map(number).collect()
}

/// The polygons of a case as a scene.
fn scene(geometry: &Value) -> Scene {
    let mut parts = SceneParts::default();
    for surface in geometry["surfaces"].as_array().expect("surfaces") {
        let name = surface["name"].as_str().expect("a name");
        let (diffuse, mirror) = (number(&surface["rho_d"]) as f32, number(&surface["rho_s"]) as f32);
        let material = if mirror > 0.0 {
            Material::mirror(name, Rgb::splat(mirror))
        } else {
            Material::lambertian(name, Rgb::splat(diffuse))
        };
        let material = parts.add_material(material);
        let corners: Vec<Vec3> = surface["vertices"]
            .as_array()
            .expect("vertices")
            .iter()
            .map(|v| {
                let v = numbers(v);
                Vec3::new(v[0] as f32, v[1] as f32, v[2] as f32)
            })
            .collect();
        let indices: Vec<[u32; 3]> = (1..corners.len() as u32 - 1).map(|k| [0, k, k + 1]).collect();
        parts.add_triangles(name, material, &corners, &indices);
    }
    Scene::new(parts).expect("a valid scene")
}

/// The row of a case's sender and the index of its receiver.
fn row(case: &Value, method: Method, params: &MethodParams) -> (FactorRow, u32) {
    let scene = scene(&case["geometry"]);
    let tracer = Tracer::new(&scene);
    let set = ElementSet::surfaces(&tracer);
    let index = |key: &str| {
        let name = case["geometry"][key].as_str().expect("a name");
        set.elements().iter().position(|e| e.name == name).expect("an element") as u32
    };
    let prepared = prepare(method, &tracer, &set, params).expect("polygons and plain mirrors");
    (prepared.row(index("sender")), index("receiver"))
}

fn is_form_factor(case: &Value) -> bool {
    ["A", "B", "C", "D"].contains(&case["group"].as_str().unwrap_or_default())
}

fn name(case: &Value) -> String {
    format!("{} {}", case["id"].as_str().unwrap_or("?"), case["name"].as_str().unwrap_or("?"))
}

/// Bars are the cases' own: 1e-6, image chains included (the truth is known to 1e-10, see `derive.py`), 1e-5 behind blockers. The
/// error that a row tells is an estimate: none may be off by more than ten times that and rounding.
#[test]
fn the_analytic_method_is_exact() {
    let (mut counts, mut worst) = (BTreeMap::new(), BTreeMap::new());
    for case in cases().iter().filter(|c| is_form_factor(c)) {
        let group = case["group"].as_str().unwrap_or_default().to_owned();
        let (row, to) = row(case, Method::Analytic, &MethodParams::default());
        let exact = number(&case["value"]);
        let error = (row.to(to).x / exact - 1.0).abs();
        let bar = number(&case["tolerance"]);
        assert!(error <= bar, "{}: {} for {exact}, {error:.1e} off", name(case), row.to(to).x);
        assert!(bar <= if group == "B" { 1e-5 } else { 1e-6 }, "{}: a bar of {bar}", name(case));
        let told = row.entry(to).map_or(0.0, |e| e.error) / exact;
        assert!(error <= 10.0 * told + 1e-7, "{}: {error:.1e} off, {told:.1e} told", name(case));
        *counts.entry(group.clone()).or_insert(0) += 1;
        let entry = worst.entry(group).or_insert(0.0_f64);
        *entry = entry.max(error);
    }
    println!("analytic: cases {counts:?}, worst relative error {worst:?}");
    assert!(counts.values().sum::<i32>() >= 20);
}

/// t-tests at a family-wise level of 1e-3 over all cases and counts of a method (31 cases, 4 counts: Student's t with 15
/// degrees of freedom leaves 1e-3/124 beyond 6.7 on both sides together), |ΔF| ≤ 3 N^(−3/4) and the slope. A difference of
/// less than four rays of one scramble is let pass: counts of so few have no such distribution.
fn converges(method: Method, most: u32) {
    let cases: Vec<Value> = cases().into_iter().filter(is_form_factor).collect();
    let mut table: Vec<(f64, f64)> = Vec::new();
    let mut rays = 256;
    while rays <= most {
        let mut squares = 0.0;
        for case in &cases {
            let (row, to) = row(case, method, &MethodParams { rays, ..MethodParams::default() });
            let exact = number(&case["value"]);
            let entry = row.entry(to).copied();
            let (found, error) = entry.map_or((0.0, 0.0), |e| (e.factor.x, e.error));
            let difference = (found - exact).abs();
            let bound = 3.0 * f64::from(rays).powi(-3).sqrt().sqrt();
            assert!(
                difference <= 6.7 * error || difference * f64::from(rays) < 4.0,
                "{} at {rays}: {found} for {exact}, standard error {error:.1e}",
                name(case)
            );
            assert!(difference <= bound, "{} at {rays}: {difference:.1e} > {bound:.1e}", name(case));
            squares += difference * difference;
        }
        table.push((f64::from(rays), (squares / cases.len() as f64).sqrt()));
        rays *= 4;
    }
    let points: Vec<(f64, f64)> = table.iter().map(|(n, e)| (libm::log(*n), libm::log(*e))).collect();
    let n = points.len() as f64;
    let (mx, my) = (points.iter().map(|p| p.0).sum::<f64>() / n, points.iter().map(|p| p.1).sum::<f64>() / n);
    let slope = points.iter().map(|p| (p.0 - mx) * (p.1 - my)).sum::<f64>()
        / points.iter().map(|p| (p.0 - mx).powi(2)).sum::<f64>();
    println!("{}: {} cases, rms error {table:?}, slope {slope:.2}", method.name(), cases.len());
    assert!(slope < -0.5, "{}: slope {slope}", method.name());
}

#[test]
fn rays_converge_within_their_standard_errors() {
    converges(Method::Rays, 16_384);
}

#[test]
fn pairs_of_points_converge_within_their_standard_errors() {
    converges(Method::Area, 4_096);
}

#[test]
fn hemicubes_come_closer_with_their_resolution() {
    let cases: Vec<Value> = cases().into_iter().filter(is_form_factor).collect();
    for resolution in [16, 64] {
        let mut worst = 0.0_f64;
        for case in &cases {
            let (row, to) =
                row(case, Method::Hemicube, &MethodParams { resolution, ..MethodParams::default() });
            let exact = number(&case["value"]);
            worst = worst.max((row.to(to).x - exact).abs());
        }
        println!("hemicube: {} cases, resolution {resolution}, worst error {worst:.1e}", cases.len());
        // The sender is seen from 128 points: that, not the raster, is what is left.
        assert!(worst < 0.02, "{worst}");
    }
}

/// A floor of `size`, small enough to be a point, and a unit square 1 above it, off its middle, cut in two at `cut` or whole.
fn above(size: f32, cut: Option<f32>) -> Scene {
    let mut parts = SceneParts::default();
    let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
    parts.add_quad("floor", white, Vec3::new(-0.5 * size, -0.5 * size, 0.0), Vec3::X * size, Vec3::Y * size);
    let mut part = |name: &str, from: f32, to: f32| {
        parts.add_quad(name, white, Vec3::new(from - 0.3, -0.2, 1.0), Vec3::Y, Vec3::X * (to - from));
    };
    match cut {
        None => part("whole", 0.0, 1.0),
        Some(at) => {
            part("left", 0.0, at);
            part("right", at, 1.0);
        }
    }
    Scene::new(parts).expect("a valid scene")
}

fn hemicube_row(scene: &Scene, resolution: u32) -> FactorRow {
    let tracer = Tracer::new(scene);
    let set = ElementSet::surfaces(&tracer);
    let params = MethodParams { resolution, rays: 1, ..MethodParams::default() };
    prepare(Method::Hemicube, &tracer, &set, &params).expect("polygons").row(0)
}

#[test]
fn form_factors_of_a_hemicube_add_up_over_the_parts_of_a_receiver() {
    for cut in [0.25, 0.37] {
        for resolution in [8, 64, 256] {
            let whole = hemicube_row(&above(1.0, None), resolution).to(1).x;
            let parts = hemicube_row(&above(1.0, Some(cut)), resolution);
            // Every cell sees one thing, so the parts have the cells of the whole: equal but for rounding of their sum.
            let sum = parts.to(1).x + parts.to(2).x;
            assert!((sum - whole).abs() < 1e-12, "cut at {cut}, {resolution} cells: {sum} for {whole}");
            assert!(parts.to(1).x > 0.0 && parts.to(2).x > parts.to(1).x);
        }
    }
}

/// Seen from a point, nothing but the raster errs. A cell is in or out as a whole: each of the ~4n cells along the outline
/// errs by up to half of its delta form factor, at most 4/(πn²), of either sign; 128 cubes turned at random take the mean.
/// Were they one cube, that is 2/(πn²)·√(4n), 1.3 n^(−3/2); the plaid of a fixed cube does not average, and is of order 1/n.
#[test]
fn the_error_of_a_hemicube_falls_with_its_resolution() {
    let over = |x: f64, y: f64| {
        let (rx, ry) = ((1.0 + x * x).sqrt(), (1.0 + y * y).sqrt());
        (x / rx * libm::atan(y / rx) + y / ry * libm::atan(x / ry)) / (2.0 * std::f64::consts::PI)
    };
    // Howell B-3 for the rectangle [−0.3, 0.7] × [−0.2, 0.8], one term per corner.
    let exact = over(0.7, 0.8) + over(0.3, 0.8) + over(0.7, 0.2) + over(0.3, 0.2);
    let mut table = Vec::new();
    for resolution in [8_u32, 16, 32, 64, 128, 256] {
        let error = (hemicube_row(&above(1e-3, None), resolution).to(1).x - exact).abs();
        let bound = 1.3 * f64::from(resolution).powi(-3).sqrt();
        assert!(error <= bound, "{resolution}: {error:.1e} > {bound:.1e}");
        table.push((resolution, error));
    }
    println!("hemicube over a point: error by resolution {table:?}");
}

#[test]
fn the_item_buffer_sees_what_one_ray_per_cell_sees() {
    for case in cases().iter().filter(|c| is_form_factor(c)) {
        let scene = scene(&case["geometry"]);
        let tracer = Tracer::new(&scene);
        let set = ElementSet::surfaces(&tracer);
        let params = MethodParams { resolution: 32, ..MethodParams::default() };
        let hemicube = catoptric_radiosity::method::hemicube::Hemicube::new(&tracer, &set, &params);
        let twin = hemicube.row_by_rays(0);
        let row = catoptric_radiosity::method::FormFactors::row(&hemicube, 0);
        for to in 0..set.len() as u32 {
            // f32 rays may decide otherwise for a cell whose centre is on an edge: a cell is 1e-3 of one of 128 cubes.
            let difference = (row.to(to) - twin.to(to)).abs().max_element();
            assert!(difference < 1e-3, "{}: {:?} by rays {:?}", name(case), row.to(to), twin.to(to));
        }
    }
}

#[test]
fn closed_rooms_close_and_reciprocity_holds() {
    for case in cases().iter().filter(|c| c["group"] == "C") {
        let scene = scene(&case["geometry"]);
        let tracer = Tracer::new(&scene);
        let set = ElementSet::surfaces(&tracer);
        for method in Method::ALL {
            let prepared = prepare(method, &tracer, &set, &MethodParams::default()).expect("polygons");
            let mut matrix =
                catoptric_radiosity::method::factors(prepared.as_ref(), &set, &catoptric_scene::Silent)
                    .expect("not cancelled");
            let weights = catoptric_radiosity::method::FactorMatrix::weights(&tracer, &set);
            let report = matrix.closure(&weights);
            let bar = if method == Method::Analytic { 1e-6 } else { 3e-2 };
            assert!(report.reciprocity < bar, "{}: {report:?}", method.name());
            let kept = vec![glam::DVec3::ONE; set.len()];
            matrix.repair(&weights, &kept, true);
            let repaired = matrix.closure(&weights);
            assert!(repaired.reciprocity < 1e-12, "{}", method.name());
            for row in &matrix.rows {
                let sum: glam::DVec3 = row.entries.iter().map(|e| e.factor).sum();
                assert!((sum.x - 1.0).abs() < 1e-3, "{}: {sum}", method.name());
            }
        }
    }
}

fn vector(value: &Value) -> Vec3 {
    let v = numbers(value);
    Vec3::new(v[0] as f32, v[1] as f32, v[2] as f32)
}

/// Irradiance of lamps and lights of group E at a point.
fn irradiance_at(case: &Value) -> f64 {
    let geometry = &case["geometry"];
    let mut parts = SceneParts::default();
    for surface in geometry["surfaces"].as_array().expect("surfaces") {
        let name = surface["name"].as_str().expect("a name");
        let material = match surface["emission"].as_f64() {
            // Exitance M is π L.
            Some(exitance) => {
                Material::emitter(name, Radiance(Rgb::splat((exitance / std::f64::consts::PI) as f32)))
            }
            None => Material::mirror(name, Rgb::splat(number(&surface["rho_s"]) as f32)),
        };
        let material = parts.add_material(material);
        let corners: Vec<Vec3> =
            surface["vertices"].as_array().expect("vertices").iter().map(vector).collect();
        parts.add_triangles(name, material, &corners, &[[0, 1, 2], [0, 2, 3]]);
    }
    let (point, normal) = (vector(&geometry["point"]), vector(&geometry["normal"]));
    if let Some(light) = geometry["light"].as_object() {
        let kind = match light["exponent"].as_f64() {
            Some(exponent) => PunctualKind::Lobe { exponent: exponent as f32 },
            None => PunctualKind::Point,
        };
        parts.lights.push(PunctualLight {
            name: "light".to_owned(),
            position: vector(&light["position"]),
            direction: vector(&light["direction"]),
            intensity: Rgb::splat(number(&light["peak"]) as f32),
            kind,
        });
    }
    // The receiver itself: a scrap of white.
    let white = parts.add_material(Material::lambertian("white", Rgb::ONE));
    let (a, b) = normal.any_orthonormal_pair();
    parts.add_quad("receiver", white, point - (a + b) * 0.001, a * 0.002, b * 0.002);
    let scene = Scene::new(parts).expect("a valid scene");
    let tracer = Tracer::new(&scene);
    let lights = Lights::new(&tracer, LightParams::default());
    let triangle = TriangleId(scene.triangles().len() as u32 - 2);
    let scrap = Receiver::on(&tracer, triangle, Side::Front, Barycentric { u: 0.3, v: 0.3 });
    // A scrap's corners, rounded to f32, say little of its normal.
    let receiver = Receiver { position: point, normal, geometric: normal, ..scrap };
    let mut scratch = Scratch::default();
    let key = Key::new(0, Purpose::Emitter, 0);
    let area = lights.direct(&receiver, 64, key, &mut scratch).irradiance
        + lights.mirrored(&receiver, 64, Rgb::ZERO, key, &mut scratch).irradiance;
    let punctual = lights.punctual(&receiver, &mut scratch);
    f64::from((area + punctual.direct + punctual.mirrored).x)
}

#[test]
fn irradiance_of_lamps_and_lights_is_exact() {
    let (mut count, mut worst) = (0, 0.0_f64);
    for case in cases().iter().filter(|c| c["group"] == "E") {
        let (found, exact) = (irradiance_at(case), number(&case["value"]));
        let error = (found / exact - 1.0).abs();
        assert!(error <= number(&case["tolerance"]), "{}: {found} for {exact}, {error:.1e} off", name(case));
        worst = worst.max(error);
        count += 1;
    }
    println!("irradiance: {count} cases, worst relative error {worst:.1e}");
    assert!(count >= 10);
}

struct Room {
    rows: StoredRows,
    reflectance: Vec<f64>,
    emission: Vec<f64>,
    areas: Vec<f64>,
    exact: Vec<f64>,
}

impl Room {
    fn of(case: &Value) -> Self {
        let g = &case["geometry"];
        let rows: Vec<Vec<f64>> = g["F"].as_array().expect("F").iter().map(numbers).collect();
        Self {
            rows: StoredRows::dense(&rows),
            reflectance: numbers(&g["rho_d"]),
            emission: numbers(&g["emission"]),
            areas: numbers(&g["areas"]),
            exact: numbers(&case["value"]["radiosity"]),
        }
    }

    fn system(&self) -> System<'_> {
        System {
            rows: &self.rows,
            reflectance: &self.reflectance,
            emission: &self.emission,
            weights: &self.areas,
        }
    }

    fn error(&self, radiosity: &[f64]) -> f64 {
        let difference = radiosity.iter().zip(&self.exact).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        difference / self.exact.iter().copied().fold(0.0, f64::max)
    }
}

#[test]
fn solvers_agree_and_take_the_known_number_of_steps() {
    let mut counted = 0;
    for case in cases().iter().filter(|c| c["group"] == "F") {
        let room = Room::of(case);
        for solver in Solver::ALL {
            let tight = Params { residual: 1e-12, ..Params::default() };
            let solution = solve_system(solver, &room.system(), &tight, &mut |_| true);
            assert!(room.error(&solution.radiosity) < 1e-9, "{}: {solution:?}", solver.name());
            if let Some(steps) = case["value"].get(solver.name()) {
                let bar = number(&case["tolerance"]);
                let params = Params { residual: 0.0, max_steps: 10_000, warm: None };
                let mut seen = 0;
                solve_system(solver, &room.system(), &params, &mut |step| {
                    seen = step.steps;
                    room.error(step.radiosity) > bar
                });
                assert_eq!(Some(seen as u64), steps.as_u64(), "{} {}", name(case), solver.name());
                counted += 1;
            }
        }
    }
    println!("solvers: {counted} step counts");
    assert!(counted >= 9);
}

#[test]
fn shooting_only_adds_and_the_ambient_estimate_is_closer() {
    for case in cases().iter().filter(|c| c["group"] == "F") {
        let room = Room::of(case);
        let (mut before, mut unshot_before) = (room.emission.clone(), f64::INFINITY);
        solve_system(Solver::Progressive, &room.system(), &Params::default(), &mut |step| {
            let unshot: f64 = step.unshot.iter().zip(&room.areas).map(|(u, a)| u * a).sum();
            assert!(unshot <= unshot_before * (1.0 + 1e-12));
            assert!(step.radiosity.iter().zip(&before).all(|(now, b)| now >= b));
            let mean = |ambient: f64| -> f64 {
                let terms = step.radiosity.iter().zip(&room.exact).zip(&room.reflectance).zip(&room.areas);
                terms.map(|(((b, exact), r), a)| (b + r * ambient - exact).abs() * a).sum()
            };
            assert!(mean(step.ambient) <= mean(0.0) + 1e-9, "step {}", step.steps);
            before = step.radiosity.to_vec();
            unshot_before = unshot;
            true
        });
    }
}

#[test]
fn a_warm_start_from_the_solution_has_nothing_left_to_do() {
    for case in cases().iter().filter(|c| c["group"] == "F") {
        let room = Room::of(case);
        for solver in [Solver::Jacobi, Solver::GaussSeidel, Solver::Southwell, Solver::Progressive] {
            let params = Params { residual: 1e-9, warm: Some(&room.exact), ..Params::default() };
            let solution = solve_system(solver, &room.system(), &params, &mut |_| true);
            assert!(solution.steps <= 1, "{}: {}", solver.name(), solution.steps);
        }
    }
}
