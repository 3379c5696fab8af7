//! Prints what is in a glTF file and how it was read: `cargo run --example inspect -- scene.glb …`.

use std::path::Path;
use std::process::ExitCode;

use catoptric_scene::TriangleId;
use catoptric_scene::gltf::{LoadOptions, Loaded, load};

fn main() -> ExitCode {
    let mut files = std::env::args().skip(1).peekable();
    let brief = files.next_if(|argument| argument == "--brief").is_some();
    let mut refused = false;
    for file in files {
        let started = std::time::Instant::now();
        let loaded = load(Path::new(&file), &LoadOptions::default());
        let milliseconds = started.elapsed().as_millis();
        match loaded {
            Ok(loaded) if brief => {
                let (scene, warnings) = (&loaded.scene, loaded.warnings.len());
                println!(
                    "loaded  {file} | {} triangles | {warnings} warnings | {milliseconds} ms",
                    scene.triangles().len()
                );
            }
            Ok(loaded) => print_scene(&file, &loaded),
            Err(error) => {
                refused = true;
                let first = error.to_string();
                let shown = if brief { first.lines().next().unwrap_or_default() } else { &first };
                println!("refused {file} | {milliseconds} ms | {} problems: {shown}", error.problems.len());
            }
        }
    }
    if refused { ExitCode::FAILURE } else { ExitCode::SUCCESS }
}

fn print_scene(file: &str, loaded: &Loaded) {
    let scene = &loaded.scene;
    println!("{file}");
    println!(
        "  {} triangles, {} vertices, hash {}",
        scene.triangles().len(),
        scene.vertices().len(),
        scene.hash()
    );
    for surface in scene.surfaces() {
        let material = &scene.materials()[surface.material.index()].name;
        let smooth = surface.triangles.clone().filter(|&t| scene.is_smooth(TriangleId(t))).count();
        println!(
            "  surface {:?}: {} triangles of {material:?}, {smooth} of them smooth",
            surface.name,
            surface.triangles.len()
        );
    }
    for material in scene.materials() {
        println!("  material {:?}: {}", material.name, material.reading.summary);
        for note in &material.reading.notes {
            println!("    {note}");
        }
    }
    for texture in scene.textures() {
        println!("  texture {:?}: {}×{}", texture.name, texture.width, texture.height);
    }
    for light in scene.lights() {
        println!("  light {:?}: {:?} {}", light.name, light.kind, light.intensity);
    }
    for camera in scene.cameras() {
        let from = camera.world_from_camera.translation;
        println!("  camera {:?}: {:?} at {from}", camera.name, camera.projection);
    }
    if loaded.cameras.duration() > 0.0 {
        println!("  cameras move for {} s", loaded.cameras.duration());
    }
    for warning in &loaded.warnings {
        println!("  warning: {warning}");
    }
}
