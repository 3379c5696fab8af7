//! What a run did, as JSON: the keys are a promise (docs/cli.md).

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use catoptric_image::write_bytes_atomically;
use catoptric_radiosity::SolveReport;
use catoptric_radiosity::solver::Stop;
use catoptric_scene::{Scene, SceneHash};
use catoptric_trace::Ledger;
use serde::Serialize;

use crate::failure::Failure;
use crate::memory;
use crate::progress::{Reporter, StageTime};

/// The whole report.
#[derive(Debug, Serialize)]
pub(crate) struct Report {
    pub(crate) program: &'static str,
    pub(crate) version: &'static str,
    pub(crate) command: &'static str,
    pub(crate) scene: SceneSummary,
    pub(crate) settings: BTreeMap<String, String>,
    /// Wall-clock seconds from start to report.
    pub(crate) seconds: f64,
    pub(crate) stages: Vec<StageTime>,
    /// Absent where the light came from a file.
    pub(crate) solve: Option<SolveSummary>,
    pub(crate) images: Vec<ImageSummary>,
    pub(crate) outputs: Vec<PathBuf>,
    pub(crate) memory: MemorySummary,
    pub(crate) warnings: Vec<String>,
}

#[derive(Debug, Serialize)]
pub(crate) struct SceneSummary {
    pub(crate) file: PathBuf,
    pub(crate) hash: String,
    pub(crate) triangles: usize,
    pub(crate) vertices: usize,
    pub(crate) surfaces: usize,
    pub(crate) materials: usize,
    pub(crate) textures: usize,
    pub(crate) lights: usize,
    pub(crate) cameras: Vec<String>,
    pub(crate) sky: bool,
}

#[derive(Debug, Serialize)]
pub(crate) struct SolveSummary {
    pub(crate) rays: BTreeMap<&'static str, u64>,
    pub(crate) rays_total: u64,
    pub(crate) patches: usize,
    pub(crate) faces: usize,
    pub(crate) elements: usize,
    pub(crate) vertices: usize,
    pub(crate) emitters: usize,
    pub(crate) image_chains: usize,
    pub(crate) lenses: usize,
    pub(crate) method: String,
    pub(crate) solver: String,
    /// The rule that stopped the solver.
    pub(crate) stop: &'static str,
    /// Sweeps, or rows shot.
    pub(crate) iterations: usize,
    /// Rows that the solver asked for.
    pub(crate) solver_rows: usize,
    /// Relative to the emitted power.
    pub(crate) residual: f64,
    /// Mean of the rows: shares of the power sent, per channel; they sum to 1.
    pub(crate) ledger: BTreeMap<&'static str, [f64; 3]>,
    pub(crate) notes: Vec<String>,
}

#[derive(Debug, Serialize)]
pub(crate) struct ImageSummary {
    pub(crate) file: PathBuf,
    pub(crate) camera: String,
    pub(crate) frame: Option<u32>,
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) samples: u64,
    pub(crate) refined_pixels: u64,
}

#[derive(Debug, Serialize)]
pub(crate) struct MemorySummary {
    /// Largest resident set, where the system tells.
    pub(crate) peak_bytes: Option<u64>,
}

impl SceneSummary {
    pub(crate) fn new(file: &Path, scene: &Scene, hash: SceneHash) -> Self {
        Self {
            file: file.to_owned(),
            hash: hash.to_string(),
            triangles: scene.triangles().len(),
            vertices: scene.vertices().len(),
            surfaces: scene.surfaces().len(),
            materials: scene.materials().len(),
            textures: scene.textures().len(),
            lights: scene.lights().len(),
            cameras: scene.cameras().iter().map(|camera| camera.name.clone()).collect(),
            sky: scene.sky().is_some(),
        }
    }
}

impl SolveSummary {
    pub(crate) fn new(report: &SolveReport, settings: &BTreeMap<String, String>) -> Self {
        let setting =
            |name: &str, default: &str| settings.get(name).map_or(default, String::as_str).to_owned();
        Self {
            rays: report.rays.iter().copied().collect(),
            rays_total: report.rays.iter().map(|(_, rays)| rays).sum(),
            patches: report.patches,
            faces: report.faces,
            elements: report.elements,
            vertices: report.vertices,
            emitters: report.emitters,
            image_chains: report.image_chains,
            lenses: report.lenses,
            method: setting("method", "rays"),
            solver: setting("solver", "two-pass"),
            stop: report.stop.map_or("", Stop::name),
            iterations: report.iterations,
            solver_rows: report.solver_rows,
            residual: report.residual,
            ledger: ledger(&report.row_ledger),
            notes: report.notes.clone(),
        }
    }
}

fn ledger(ledger: &Ledger) -> BTreeMap<&'static str, [f64; 3]> {
    ledger.entries().into_iter().map(|(name, share)| (name, share.to_array())).collect()
}

impl Report {
    /// Fills in what is known at the end of a run.
    pub(crate) fn new(
        command: &'static str,
        scene: SceneSummary,
        settings: BTreeMap<String, String>,
        reporter: &Reporter,
    ) -> Self {
        Self {
            program: "catoptric",
            version: env!("CARGO_PKG_VERSION"),
            command,
            scene,
            settings,
            seconds: reporter.seconds(),
            stages: reporter.times(),
            solve: None,
            images: Vec::new(),
            outputs: Vec::new(),
            memory: MemorySummary { peak_bytes: memory::peak_bytes() },
            warnings: Vec::new(),
        }
    }

    /// Writes the report to a file, or to standard output.
    pub(crate) fn write(&self, file: Option<&Path>) -> Result<(), Failure> {
        let text = to_json(self)?;
        match file {
            None => print(&text),
            Some(path) => write_bytes_atomically(path, text.as_bytes())
                .map_err(|error| Failure::Run(format!("{}: cannot be written: {error}", path.display()))),
        }
    }
}

/// Indented JSON with a line end.
pub(crate) fn to_json(value: &impl Serialize) -> Result<String, Failure> {
    let text = serde_json::to_string_pretty(value)
        .map_err(|error| Failure::Run(format!("the report cannot be written: {error}")))?;
    Ok(text + "\n")
}

/// Writes to standard output; a reader that has gone away (`| head`) is no failure.
pub(crate) fn print(text: &str) -> Result<(), Failure> {
    use std::io::Write;
    let mut out = std::io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => {
            Err(Failure::Run(format!("standard output: {error}")))
        }
        _ => Ok(()),
    }
}
