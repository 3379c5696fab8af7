//! `catoptric info`: what is in a file, how it was read, what it will cost.

use std::fmt::Write;

use catoptric_scene::{Camera, Material, Projection, PunctualKind, PunctualLight, Scene, Sky};
use catoptric_solution::Solution;
use serde::Serialize;

use crate::args::InfoArgs;
use crate::estimate::{Estimate, estimate};
use crate::failure::Failure;
use crate::input::{Input, Light};
use crate::report::{SceneSummary, print, to_json};
use crate::summary::count;

/// Everything that is said, in the keys of `--json`.
#[derive(Debug, Serialize)]
struct Info {
    program: &'static str,
    version: &'static str,
    scene: SceneSummary,
    materials: Vec<MaterialInfo>,
    lights: Vec<LightInfo>,
    cameras: Vec<CameraInfo>,
    animation_seconds: f32,
    sky: Option<String>,
    solution: Option<SolutionInfo>,
    estimates: Vec<Estimate>,
    warnings: Vec<String>,
}

#[derive(Debug, Serialize)]
struct MaterialInfo {
    name: String,
    read_as: String,
    emits: bool,
    double_sided: bool,
    triangles: usize,
    area: f64,
    notes: Vec<String>,
}

#[derive(Debug, Serialize)]
struct LightInfo {
    name: String,
    kind: &'static str,
    /// Candela, or lux for directional lights.
    intensity: [f32; 3],
}

#[derive(Debug, Serialize)]
struct CameraInfo {
    name: String,
    projection: String,
    aspect: Option<f32>,
}

#[derive(Debug, Serialize)]
struct SolutionInfo {
    patches: usize,
    vertices: usize,
    elements: usize,
    settings: std::collections::BTreeMap<String, String>,
}

pub(crate) fn run(args: &InfoArgs) -> Result<(), Failure> {
    let input = Input::read(&args.scene, None, Light::Own)?;
    let scene = &input.scene;
    let info = Info {
        program: "catoptric",
        version: env!("CARGO_PKG_VERSION"),
        scene: SceneSummary::new(&args.scene, scene, input.hash),
        materials: materials(scene),
        lights: scene.lights().iter().map(LightInfo::new).collect(),
        cameras: scene.cameras().iter().map(CameraInfo::new).collect(),
        animation_seconds: input.cameras.duration(),
        sky: scene.sky().map(describe_sky),
        solution: input.solution.as_ref().map(SolutionInfo::new),
        estimates: estimate(scene),
        warnings: input.warnings,
    };
    if args.json { print(&to_json(&info)?) } else { print(&info.text()) }
}

impl Info {
    fn text(&self) -> String {
        let mut text = String::new();
        // Writing to a string does not fail.
        let _ = self.write(&mut text);
        text
    }

    fn write(&self, out: &mut String) -> std::fmt::Result {
        let scene = &self.scene;
        writeln!(out, "{}", scene.file.display())?;
        writeln!(
            out,
            "  {} triangles in {} surfaces, {} textures",
            count(scene.triangles as u64),
            scene.surfaces,
            scene.textures
        )?;
        writeln!(out, "  hash {}", scene.hash)?;

        writeln!(out, "\nMaterials ({})", self.materials.len())?;
        for material in &self.materials {
            let mut marks = String::new();
            if material.emits {
                marks.push_str(", emits");
            }
            if material.double_sided {
                marks.push_str(", double-sided");
            }
            writeln!(
                out,
                "  {}: {}{marks}; {} triangles, {:.3} m²",
                material.name,
                material.read_as,
                count(material.triangles as u64),
                material.area
            )?;
            for note in &material.notes {
                writeln!(out, "    note: {note}")?;
            }
        }

        let emitters = self.materials.iter().filter(|m| m.emits && m.triangles > 0).count();
        writeln!(out, "\nLights ({} punctual, {emitters} emitting materials)", self.lights.len())?;
        for light in &self.lights {
            let unit = if light.kind == "directional" { "lux" } else { "candela" };
            writeln!(out, "  {}: {}, {:?} {unit}", light.name, light.kind, light.intensity)?;
        }
        match &self.sky {
            Some(sky) => writeln!(out, "  sky: {sky}")?,
            None if self.lights.is_empty() && emitters == 0 => {
                writeln!(out, "  none: the picture will be black; add some with --sky 1,1,1")?;
            }
            None => {}
        }

        writeln!(out, "\nCameras ({})", self.cameras.len())?;
        for camera in &self.cameras {
            writeln!(out, "  {}: {}", camera.name, camera.projection)?;
        }
        if self.animation_seconds > 0.0 {
            writeln!(out, "  animated for {} s: see --frames", self.animation_seconds)?;
        }

        if let Some(solution) = &self.solution {
            writeln!(
                out,
                "\nSolution: {} patches, {} vertices, {} elements",
                count(solution.patches as u64),
                count(solution.vertices as u64),
                count(solution.elements as u64)
            )?;
            for (name, value) in &solution.settings {
                writeln!(out, "  {name}: {value}")?;
            }
        } else {
            writeln!(out, "\nCost of pass one, in orders of magnitude")?;
            for estimate in &self.estimates {
                writeln!(
                    out,
                    "  {:<9} {} patches, {} rays, {} MiB, about {:.1} s on this machine",
                    estimate.quality,
                    count(estimate.patches),
                    count(estimate.rays),
                    estimate.bytes >> 20,
                    estimate.seconds
                )?;
            }
        }

        if !self.warnings.is_empty() {
            writeln!(out, "\nWarnings ({})", self.warnings.len())?;
            for warning in &self.warnings {
                writeln!(out, "  {warning}")?;
            }
        }
        Ok(())
    }
}

/// The materials with what uses them.
fn materials(scene: &Scene) -> Vec<MaterialInfo> {
    let mut materials: Vec<MaterialInfo> = scene.materials().iter().map(MaterialInfo::new).collect();
    for surface in scene.surfaces() {
        let material = &mut materials[surface.material.index()];
        material.triangles += surface.triangles.len();
        let triangles = surface.triangles.clone().map(catoptric_scene::TriangleId);
        material.area += triangles.map(|t| f64::from(scene.area(t))).sum::<f64>();
    }
    materials
}

impl MaterialInfo {
    fn new(material: &Material) -> Self {
        Self {
            name: material.name.clone(),
            read_as: material.reading.summary.clone(),
            emits: material.emits(),
            double_sided: material.double_sided,
            triangles: 0,
            area: 0.0,
            notes: material.reading.notes.clone(),
        }
    }
}

impl LightInfo {
    fn new(light: &PunctualLight) -> Self {
        let kind = match light.kind {
            PunctualKind::Point => "point",
            PunctualKind::Spot { .. } => "spot",
            PunctualKind::Directional => "directional",
            PunctualKind::Lobe { .. } => "cosine lobe",
            PunctualKind::Photometric { .. } => "photometric",
        };
        Self { name: light.name.clone(), kind, intensity: light.intensity.to_array() }
    }
}

impl CameraInfo {
    fn new(camera: &Camera) -> Self {
        let projection = match camera.projection {
            Projection::Perspective { yfov } => {
                format!("perspective, {:.1}° high", yfov.to_degrees())
            }
            Projection::Orthographic { xmag, ymag } => {
                format!("orthographic, {} × {} m", 2.0 * xmag, 2.0 * ymag)
            }
        };
        Self { name: camera.name.clone(), projection, aspect: camera.aspect }
    }
}

impl SolutionInfo {
    fn new(solution: &Solution) -> Self {
        Self {
            patches: solution.patches.areas.len(),
            vertices: solution.mesh.vertices.len(),
            elements: solution.mesh.elements.len(),
            settings: solution.settings.clone(),
        }
    }
}

fn describe_sky(sky: &Sky) -> String {
    match sky {
        Sky::Uniform(radiance) => format!("uniform, radiance {:?}", radiance.0.to_array()),
        Sky::Image(image) => format!("equirectangular image of {}x{}", image.width, image.height),
    }
}
