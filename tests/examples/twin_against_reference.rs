//! Compares the slow twin with a path-traced reference that has standard errors: z-scores of 8×8 block means.
//!
//! `cargo run --release -p catoptric-tests --example twin_against_reference -- SCENE.glb REFERENCE.exr [WIDTH] [SAMPLES]`
//!
//! The reference is box-filtered down to WIDTH (default 64). Over honest noise, z has a mean square of 1; where light
//! is found by luck (caustics), few blocks carry most of it, so the energy ratio and its error are printed too.

use std::path::Path;

use catoptric_image::{Image, ReadLimits};
use catoptric_scene::gltf;
use catoptric_tests::twin::{self, LAYERS, TwinParams};
use catoptric_trace::Tracer;
use glam::DVec3;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [scene, reference, rest @ ..] = arguments.as_slice() else {
        return Err("usage: twin_against_reference SCENE.glb REFERENCE.exr [WIDTH] [SAMPLES]".into());
    };
    let width: usize = rest.first().map_or(Ok(64), |w| w.parse())?;
    let samples: u32 = rest.get(1).map_or(Ok(256), |s| s.parse())?;
    let loaded = gltf::load(Path::new(scene), &gltf::LoadOptions::default()).map_err(|e| e.to_string())?;
    let image = Image::read(Path::new(reference), &ReadLimits::default())?;
    let factor = image.width / width;
    let height = image.height / factor;
    let tracer = Tracer::new(&loaded.scene);
    let camera = loaded.scene.cameras().first().ok_or("no camera")?;
    let params = TwinParams { width, height, samples, particles: 1_000_000, seed: 1 };
    let started = std::time::Instant::now();
    let twin = twin::render(&tracer, camera, &params);
    let seconds = started.elapsed().as_secs_f64();

    let expected = image.rgb("").ok_or("no beauty")?;
    let error = image.rgb("SE").unwrap_or_else(|| vec![[0.0; 3]; expected.len()]);
    let block = 8;
    let (mut squares, mut worst, mut count) = (0.0, 0.0_f64, 0.0);
    let (mut total, mut variance, mut truth) = (DVec3::ZERO, DVec3::ZERO, DVec3::ZERO);
    for by in 0..height.div_ceil(block) {
        for bx in 0..width.div_ceil(block) {
            let (mut ours, mut our_variance) = (DVec3::ZERO, DVec3::ZERO);
            let (mut theirs, mut their_variance, mut pixels) = (DVec3::ZERO, DVec3::ZERO, 0.0);
            for y in by * block..((by + 1) * block).min(height) {
                for x in bx * block..((bx + 1) * block).min(width) {
                    pixels += 1.0;
                    for layer in &twin.layers {
                        ours += layer.mean[y * width + x];
                        our_variance += layer.variance[y * width + x];
                    }
                    for sub in 0..factor * factor {
                        let at = (y * factor + sub / factor) * image.width + x * factor + sub % factor;
                        let n = (factor * factor) as f64;
                        theirs += DVec3::from(expected[at].map(f64::from)) / n;
                        their_variance += DVec3::from(error[at].map(f64::from)).powf(2.0) / (n * n);
                    }
                }
            }
            let deviation = ((our_variance + their_variance).map(f64::sqrt)).max(theirs * 1e-5);
            let z = (ours - theirs) / deviation.max(DVec3::splat(1e-12));
            squares += z.length_squared();
            worst = worst.max(z.abs().max_element());
            count += 3.0;
            total += ours;
            truth += theirs;
            variance += our_variance + their_variance;
            if z.abs().max_element() > 5.0 {
                println!(
                    "  block {bx},{by}: {:.5} against {:.5}, z {:.1}",
                    ours / pixels,
                    theirs / pixels,
                    z
                );
            }
        }
    }
    let z = (total - truth) / variance.map(f64::sqrt);
    println!("{scene}: {width}x{height}, {samples} paths a pixel, {seconds:.1} s");
    println!("  blocks: rms z {:.3}, max |z| {worst:.2} of {count}", f64::sqrt(squares / count));
    println!("  whole: ratio {:.5} ± {:.5}, z {z:.2}", total / truth, variance.map(f64::sqrt) / truth);
    for (name, layer) in LAYERS.iter().zip(&twin.layers) {
        let sum: DVec3 = layer.mean.iter().sum();
        let error = layer.variance.iter().sum::<DVec3>().map(f64::sqrt);
        println!("  {name:20} {:.5} of the light, ± {:.5}", sum / total, error / total);
    }
    Ok(())
}
