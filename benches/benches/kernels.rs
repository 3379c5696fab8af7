//! The kernels against the clock: `cargo bench -p catoptric-benches [-- FILTER]`.
//!
//! | bench | one element is |
//! |---|---|
//! | traversal | a nearest hit of an eye ray or of a cosine ray from a surface |
//! | walk | an S* walk from a surface to where its light is diffuse |
//! | contour | the irradiance by a rectangle, half of them cut by the horizon |
//! | gather | a receiver with 64 hemisphere rays that follow S* |
//! | solve | pass one at quality draft, all threads |
//!
//! All but the last on one thread.

use std::hint::black_box;

use catoptric_benches::{bounced, eye_rays, load, offset, receivers, scene_file};
use catoptric_light::contour::{self, Polygon};
use catoptric_light::{LightParams, Lights};
use catoptric_radiosity::gather::{DiffuseLight, gather};
use catoptric_radiosity::{SolveParams, solve};
use catoptric_scene::{Rgb, Silent};
use catoptric_solution::Quality;
use catoptric_trace::sequence::{Key, Purpose};
use catoptric_trace::walk::{self, WalkParams};
use catoptric_trace::{Ledger, MediumStack, Ray, Tracer};
use criterion::{BatchSize, Criterion, Throughput};
use glam::DVec3;

fn traversal(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("traversal");
    for name in ["cornell_box", "interior"] {
        let scene = load(&scene_file(name));
        let tracer = Tracer::new(&scene);
        let eye = eye_rays(&scene.cameras()[0], 128);
        let bounced = bounced(&tracer, &eye, offset(&tracer));
        for (kind, rays) in [("eye", eye), ("bounced", bounced)] {
            group.throughput(Throughput::Elements(rays.len() as u64));
            let trace = |ray: &Ray| tracer.nearest(ray, f32::INFINITY).map_or(0.0, |hit| hit.t);
            group.bench_function(format!("{name}/{kind}"), |b| {
                b.iter(|| black_box(&rays).iter().map(trace).sum::<f32>());
            });
        }
    }
}

fn walks(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("walk");
    for name in ["cornell_mirror", "glass_sphere", "ring_caustic"] {
        let scene = load(&scene_file(name));
        let tracer = Tracer::new(&scene);
        let rays = bounced(&tracer, &eye_rays(&scene.cameras()[0], 64), offset(&tracer));
        let (key, params) = (Key::new(1, Purpose::Test, 0), WalkParams::default());
        group.throughput(Throughput::Elements(rays.len() as u64));
        group.bench_function(name, |b| {
            b.iter(|| {
                let mut ledger = Ledger::default();
                for (index, ray) in black_box(&rays).iter().enumerate() {
                    let key = key.child(index as u32);
                    walk::choose(
                        &tracer,
                        *ray,
                        MediumStack::AIR,
                        Rgb::ONE,
                        key,
                        &params,
                        &mut ledger,
                        |_| {},
                    );
                }
                ledger
            });
        });
    }
}

fn contours(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("contour");
    // Rectangles around a point whose normal is up: every second one reaches below the horizon.
    let polygons: Vec<Polygon> = (0..1024)
        .map(|i| {
            let (u, v) = (f64::from(i % 32) / 32.0, f64::from(i / 32) / 32.0);
            let low = if i % 2 == 0 { 0.1 } else { -0.4 };
            let corner = DVec3::new(1.0 + u, v - 0.5, low);
            let (a, b) = (DVec3::new(0.3, 0.8, 0.0), DVec3::new(0.0, 0.1, 0.9));
            Polygon::new(&[corner, corner + a, corner + a + b, corner + b])
        })
        .collect();
    group.throughput(Throughput::Elements(polygons.len() as u64));
    group.bench_function("rectangle", |b| {
        let irradiance = |polygon: &Polygon| contour::irradiance(DVec3::ZERO, DVec3::Z, polygon);
        b.iter(|| black_box(&polygons).iter().map(irradiance).sum::<f64>());
    });
}

fn gathers(criterion: &mut Criterion) {
    const RAYS: u32 = 64;
    let mut group = criterion.benchmark_group("gather");
    for name in ["cornell_box", "cornell_mirror"] {
        let scene = load(&scene_file(name));
        let tracer = Tracer::new(&scene);
        let lights = Lights::new(&tracer, LightParams::default());
        let params = SolveParams::for_quality(Quality::Draft);
        let solution = solve(&tracer, &params, &Silent).expect("nobody cancels").solution;
        let irradiance: Vec<Rgb> = (0..solution.irradiance[0].len())
            .map(|vertex| solution.irradiance.iter().map(|term| term[vertex]).sum())
            .collect();
        let light = DiffuseLight { mesh: &solution.mesh, irradiance: &irradiance };
        let receivers = receivers(&tracer, &eye_rays(&scene.cameras()[0], 16));
        let key = Key::new(1, Purpose::Hemisphere, 0);
        group.throughput(Throughput::Elements(receivers.len() as u64));
        group.bench_function(name, |b| {
            b.iter(|| {
                let mut total = Rgb::ZERO;
                for (index, receiver) in black_box(&receivers).iter().enumerate() {
                    let key = key.child(index as u32);
                    total += gather(&lights, &light, receiver, RAYS, key, &params.walk).indirect;
                }
                total
            });
        });
    }
}

fn solves(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("solve");
    group.sample_size(10);
    for name in ["cornell_box", "cornell_mirror"] {
        let scene = load(&scene_file(name));
        let params = SolveParams::for_quality(Quality::Draft);
        group.bench_function(name, |b| {
            let tracer = || Tracer::new(&scene);
            let run = |tracer: Tracer| solve(&tracer, &params, &Silent).expect("nobody cancels").report;
            b.iter_batched(tracer, run, BatchSize::PerIteration);
        });
    }
}

fn main() {
    let mut criterion = Criterion::default().configure_from_args();
    for bench in [traversal, walks, contours, gathers, solves] {
        bench(&mut criterion);
    }
    criterion.final_summary();
}
