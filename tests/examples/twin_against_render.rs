//! Prints each layer of a quick render beside the slow twin's: `-- SCENE.glb [WIDTH] [SAMPLES]`.

use std::path::Path;
use std::time::Instant;

use catoptric_radiosity::{SolveParams, solve};
use catoptric_render::{RenderParams, render};
use catoptric_scene::{Silent, gltf};
use catoptric_solution::Quality;
use catoptric_tests::compare::{Allowance, compare, comparisons};
use catoptric_tests::twin::{self, LAYERS, TwinParams};
use catoptric_trace::Tracer;
use glam::DVec3;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [scene, rest @ ..] = arguments.as_slice() else {
        return Err("usage: twin_against_render SCENE.glb [WIDTH] [SAMPLES]".into());
    };
    let width: usize = rest.first().map_or(Ok(64), |w| w.parse())?;
    let samples: u32 = rest.get(1).map_or(Ok(64), |s| s.parse())?;
    let loaded = gltf::load(Path::new(scene), &gltf::LoadOptions::default()).map_err(|e| e.to_string())?;
    let camera = loaded.scene.cameras().first().ok_or("no camera")?;
    let height = camera.height_for_width(width);
    let tracer = Tracer::new(&loaded.scene);
    let start = Instant::now();
    let solved = solve(&tracer, &SolveParams::for_quality(Quality::Standard), &Silent)?;
    let params = RenderParams { layers: true, ..RenderParams::for_quality(Quality::Standard, width, height) };
    let ours = render(&tracer, &solved.solution, camera, &params, &Silent)?.image;
    let middle = Instant::now();
    let params = TwinParams { width, height, samples, particles: 1_000_000, seed: 7 };
    let twin = twin::render(&tracer, camera, &params);
    println!(
        "{scene}: ours {:.2} s, twin {:.2} s",
        (middle - start).as_secs_f64(),
        middle.elapsed().as_secs_f64()
    );
    let level = 1e-3 / (8 * comparisons(width, height, 10)) as f64;
    for (name, layer) in LAYERS.iter().zip(&twin.layers) {
        let pixels = ours.rgb(name).ok_or("layer is missing")?;
        let count = pixels.len() as f64;
        let own: DVec3 = pixels.iter().map(|p| DVec3::from(p.map(f64::from))).sum::<DVec3>() / count;
        let mean = layer.mean.iter().sum::<DVec3>() / count;
        let error = layer.variance.iter().sum::<DVec3>().map(f64::sqrt) / count;
        println!("  {name:20} {own:.5} against {mean:.5} ± {error:.5}");
        let mismatches = compare(&pixels, &twin, &[name], level, Allowance::default());
        for mismatch in mismatches.iter().take(6) {
            println!("    {mismatch}");
        }
        if mismatches.len() > 6 {
            println!("    ... {} in all", mismatches.len());
        }
        if mismatches.is_empty() && (own - mean).abs().max_element() < 4.0 * error.max_element() {
            continue;
        }
        // Which surfaces differ most.
        let mut by_surface = std::collections::BTreeMap::<u32, (f64, f64, f64)>::new();
        for (pixel, id) in ours.channel("id.surface").unwrap_or_default().iter().enumerate() {
            let sum = by_surface.entry(*id as u32).or_default();
            let own = f64::from(pixels[pixel][1]);
            *sum = (sum.0 + own, sum.1 + layer.mean[pixel].y, sum.2 + layer.variance[pixel].y);
        }
        let mut rows: Vec<_> = by_surface.into_iter().collect();
        rows.sort_by(|a, b| (b.1.0 - b.1.1).abs().total_cmp(&(a.1.0 - a.1.1).abs()));
        for (id, (own, mean, variance)) in rows.into_iter().take(8) {
            let name = id.checked_sub(1).map_or("sky", |i| &loaded.scene.surfaces()[i as usize].name);
            println!("    on {name}: {own:.3} against {mean:.3} ± {:.3}", variance.sqrt());
        }
    }
    Ok(())
}
