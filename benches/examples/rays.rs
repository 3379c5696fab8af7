//! Our side of `bench/against_embree.py`: writes a scene's triangles and rays and times their traversal.
//!
//! `cargo run --release -p catoptric-benches --example rays -- SCENE.glb FOLDER [WIDTH]` writes `triangles.f32` (9 numbers each) and
//! per set `NAME.rays.f32` (origin, direction) and `NAME.hits.f32` (distances, infinite where nothing is hit), and prints JSON.

use std::path::Path;
use std::time::Instant;

use catoptric_benches::{bounced, eye_rays, flat, load, offset};
use catoptric_scene::TriangleId;
use catoptric_trace::{Ray, Tracer};
use rayon::prelude::*;
use serde_json::json;

/// Each figure is the best of so many runs.
const RUNS: usize = 5;
/// Rays a task takes at a time.
const CHUNK: usize = 4096;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [scene, folder, rest @ ..] = arguments.as_slice() else {
        return Err("usage: rays SCENE.glb FOLDER [WIDTH]".into());
    };
    let width: usize = rest.first().map_or(Ok(1024), |w| w.parse())?;
    let scene = load(Path::new(scene));
    let started = Instant::now();
    let tracer = Tracer::new(&scene);
    let build = started.elapsed().as_secs_f64();

    let triangles = (0..scene.triangles().len() as u32).flat_map(|id| scene.corners(TriangleId(id)));
    let triangles: Vec<f32> = triangles.flat_map(|corner| corner.to_array()).collect();
    write(folder, "triangles.f32", &triangles)?;
    let eye = eye_rays(&scene.cameras()[0], width);
    let first = bounced(&tracer, &eye, offset(&tracer));
    let mut sets = serde_json::Map::new();
    for (name, rays) in [("eye", &eye), ("bounced", &first)] {
        write(folder, &format!("{name}.rays.f32"), &flat(rays))?;
        let mut hits = vec![0.0; rays.len()];
        let trace = |(ray, hit): (&Ray, &mut f32)| {
            *hit = tracer.nearest(ray, f32::INFINITY).map_or(f32::INFINITY, |hit| hit.t);
        };
        let one = best(|| rays.iter().zip(&mut hits).for_each(trace));
        let all = best(|| {
            let chunks = rays.par_chunks(CHUNK).zip(hits.par_chunks_mut(CHUNK));
            chunks.for_each(|(rays, hits)| rays.iter().zip(hits).for_each(trace));
        });
        write(folder, &format!("{name}.hits.f32"), &hits)?;
        sets.insert(name.to_owned(), json!({ "rays": rays.len(), "one_thread": one, "all_threads": all }));
    }
    let threads = rayon::current_num_threads();
    println!(
        "{}",
        json!({ "triangles": triangles.len() / 9, "build": build, "threads": threads, "sets": sets })
    );
    Ok(())
}

/// Seconds of the fastest run.
fn best(mut run: impl FnMut()) -> f64 {
    let time = |_| {
        let started = Instant::now();
        run();
        started.elapsed().as_secs_f64()
    };
    (0..RUNS).map(time).fold(f64::INFINITY, f64::min)
}

fn write(folder: &str, name: &str, numbers: &[f32]) -> std::io::Result<()> {
    let bytes: Vec<u8> = numbers.iter().flat_map(|v| v.to_le_bytes()).collect();
    std::fs::write(Path::new(folder).join(name), bytes)
}
