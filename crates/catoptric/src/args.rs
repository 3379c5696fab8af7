//! The command line: what can be asked for, with the help that a person reads.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};

use catoptric_radiosity::method::Method;
use catoptric_radiosity::reconstruct::Reconstruction;
use catoptric_radiosity::solver::Solver;

use crate::diff::DiffArgs;
use crate::value::{CameraChoice, Frames, LightFile, Size, SkySource};

const EXIT_CODES: &str = "\
Exit codes:
  0    done
  1    the input, the rendering or an output failed; the message says which and why
  2    the command line was not understood
  130  interrupted (Ctrl-C); outputs are whole or absent, never torn
`catoptric diff` has its own: 0 same, 1 different, 2 error.";

const RENDER_EXAMPLES: &str = "\
Examples:
  catoptric render room.glb -o room.exr --preview room.png
  catoptric render room.glb -o draft.png --size 320 --quality draft
  catoptric render room.glb -o view.exr --camera all --layers
  catoptric render room.glb -o mesh.png --layers mesh
  catoptric render walk.glb -o walk.exr --frames 0..240 --fps 24
  catoptric render statue.glb -o statue.exr --sky studio.hdr
  catoptric render room.glb -o plain.exr --plain

  catoptric solve room.glb -o solved.glb            pass one, once ...
  catoptric render solved.glb -o left.exr --camera Left
  catoptric render solved.glb -o right.exr --camera Right";

const SOLVE_EXAMPLES: &str = "\
Examples:
  catoptric solve room.glb -o solved.glb
  catoptric solve room.glb -o solved.glb --quality high --json=report.json
  catoptric solve room.glb -o solved.glb --solver progressive --every 10 --snapshot steps
  catoptric solve evening.glb -o evening-solved.glb --warm solved.glb
  catoptric render solved.glb -o view.exr           needs no other file

The result is a self-contained glTF: any viewer shows the baked room.";

const INFO_EXAMPLES: &str = "\
Examples:
  catoptric info room.glb
  catoptric info room.glb --json";

const FORM_FACTORS_EXAMPLES: &str = "\
Examples:
  catoptric form-factors room.glb -o F.csv
  catoptric form-factors room.glb -o F.csv --method analytic
  catoptric form-factors room.glb -o F.npz --by patch --patches 2000 --rays 256
  catoptric form-factors room.glb -o plain.csv --plain      no mirrors, no glass
  catoptric form-factors room.glb -o F.csv --repair --json

CSV: from,to,F_r,F_g,F_b,area_from. NPZ: scipy.sparse.load_npz, with areas and names beside the matrix.";

const COMPLETIONS_EXAMPLES: &str = "\
Examples:
  catoptric completions bash > ~/.local/share/bash-completion/completions/catoptric
  catoptric completions zsh > ~/.zfunc/_catoptric
  catoptric completions fish > ~/.config/fish/completions/catoptric.fish";

/// Renders scenes of diffuse surfaces, mirrors and glass by the complete two-pass method.
#[derive(Debug, Parser)]
#[command(name = "catoptric", version, about, after_help = EXIT_CODES, max_term_width = 110)]
#[command(propagate_version = true, subcommand_required = true, arg_required_else_help = true)]
pub(crate) struct Cli {
    #[command(subcommand)]
    pub(crate) command: Command,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Renders a scene: both passes, or pass two alone of a solved one.
    #[command(after_help = RENDER_EXAMPLES)]
    Render(Box<RenderArgs>),
    /// Computes the light of a scene, for any number of views.
    #[command(after_help = SOLVE_EXAMPLES)]
    Solve(SolveArgs),
    /// Computes extended form factors between named surfaces or patches.
    #[command(after_help = FORM_FACTORS_EXAMPLES)]
    FormFactors(FormFactorsArgs),
    /// Says what is in a file, how it is read and what it will cost.
    #[command(after_help = INFO_EXAMPLES)]
    Info(InfoArgs),
    /// Compares a rendered image, or a folder of them, with a reference.
    Diff(Box<DiffArgs>),
    /// Writes a completion script for a shell.
    #[command(after_help = COMPLETIONS_EXAMPLES)]
    Completions {
        /// The shell.
        shell: clap_complete::Shell,
    },
}

#[derive(Debug, Args)]
pub(crate) struct RenderArgs {
    /// A glTF 2.0 scene (.glb or .gltf), or a solution written by `solve`.
    #[arg(value_name = "SCENE")]
    pub(crate) scene: PathBuf,

    /// The image: .exr or .pfm for linear light, .png for a display. Several cameras or frames get their
    /// name before the extension: out.Left.0001.exr.
    #[arg(short, long, value_name = "FILE")]
    pub(crate) output: Option<PathBuf>,

    /// Also writes a PNG for a display.
    #[arg(long, value_name = "FILE.png")]
    pub(crate) preview: Option<PathBuf>,

    /// The camera's name, or `all`. Without it: the first of the file.
    #[arg(long, value_name = "NAME|all", default_value = "", hide_default_value = true)]
    pub(crate) camera: CameraChoice,

    /// Frames of an animated camera, first and last included. Frame n shows the time n / fps.
    #[arg(long, value_name = "FIRST..LAST")]
    pub(crate) frames: Option<Frames>,

    /// Frames per second.
    #[arg(long, value_name = "N", default_value_t = 24.0, value_parser = positive, requires = "frames")]
    pub(crate) fps: f64,

    /// Image size in pixels. A width alone keeps the camera's aspect.
    #[arg(long, value_name = "W|WxH", default_value = "1280")]
    pub(crate) size: Size,

    /// What is written beside the beauty. Without a value: light.
    #[arg(long, value_enum, value_name = "LAYERS", num_args = 0..=1, default_missing_value = "light", value_delimiter = ',')]
    pub(crate) layers: Vec<Layers>,

    /// Light of area emitters on diffuse surfaces, straight and over planar mirrors: read from the mesh, or evaluated at
    /// pixels, slower and sharper.
    #[arg(long, value_enum, default_value_t = Direct::Auto)]
    pub(crate) direct: Direct,

    /// Exposure of PNGs in stops. Without it: chosen by the first image.
    #[arg(long, value_name = "EV", allow_negative_numbers = true)]
    pub(crate) exposure: Option<f32>,

    /// Uses the light of a solution of this scene, written by `solve`.
    #[arg(long, value_name = "FILE.glb")]
    pub(crate) solution: Option<PathBuf>,

    #[command(flatten)]
    pub(crate) transport: TransportArgs,
    #[command(flatten)]
    pub(crate) run: RunArgs,
}

/// Where the light of area emitters comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Direct {
    /// From the mesh, and at the pixels where a shadow in this view is finer than the mesh. `sketch` and `draft` read the mesh.
    Auto,
    /// From the mesh, where it is stored: any number of views cost no more shadow rays.
    Vertices,
    /// From the emitters at each pixel: shadows as sharp as they are, exact behind few triangles, with some noise in the penumbrae
    /// of what is curved or many.
    Pixels,
}

/// Groups of layers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Layers {
    /// Light by class (these layers sum to the beauty), albedo, normal, depth and ids; needs an EXR.
    Light,
    /// Edges of the mesh on which light is stored: drawn over the picture in a PNG, a layer of their own in an EXR.
    Mesh,
}

#[derive(Debug, Args)]
pub(crate) struct SolveArgs {
    /// A glTF 2.0 scene (.glb or .gltf).
    #[arg(value_name = "SCENE")]
    pub(crate) scene: PathBuf,

    /// The solution, a self-contained .glb.
    #[arg(short, long, value_name = "FILE.glb")]
    pub(crate) output: Option<PathBuf>,

    /// Starts from the light of an earlier solution with the same patches (the same scene with other lamps or colours).
    #[arg(long, value_name = "FILE.glb")]
    pub(crate) warm: Option<PathBuf>,

    /// Writes a picture of the room every N steps of the solver, as light spreads: DIR/step.000010.png, and
    /// DIR/step.000010.ambient.png with the ambient term where the solver has one.
    #[arg(long, value_name = "N", requires = "snapshot", value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) every: Option<u32>,

    /// Folder of the pictures; made if it is not there.
    #[arg(long, value_name = "DIR", requires = "every")]
    pub(crate) snapshot: Option<PathBuf>,

    /// Size of the pictures in pixels, seen by the first camera.
    #[arg(long, value_name = "W|WxH", default_value = "320", requires = "snapshot")]
    pub(crate) snapshot_size: Size,

    #[command(flatten)]
    pub(crate) transport: TransportArgs,
    #[command(flatten)]
    pub(crate) run: RunArgs,
}

#[derive(Debug, Args)]
pub(crate) struct FormFactorsArgs {
    /// A glTF 2.0 scene (.glb or .gltf).
    #[arg(value_name = "SCENE")]
    pub(crate) scene: PathBuf,

    /// The matrix: .csv or .npz. Where mirrors are tinted, .npz writes one file per channel: F.r.npz, F.g.npz, F.b.npz.
    #[arg(short, long, value_name = "FILE")]
    pub(crate) output: Option<PathBuf>,

    /// Between what.
    #[arg(long, value_enum, default_value_t = By::Surface)]
    pub(crate) by: By,

    /// How: rays, hemicube, area or analytic.
    #[arg(long, value_name = "METHOD", default_value = "rays")]
    pub(crate) method: Method,

    /// Samples per sender (`area`: per pair; `hemicube`: cells) in each of 16 independent scrambles, from whose scatter the
    /// standard errors come. Without it: 16384 by surface, 64 by patch (`area`: 4).
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000_000))]
    pub(crate) rays: Option<u32>,

    /// Cells along an edge of a hemicube's top.
    #[arg(long, value_name = "N", default_value_t = 64, value_parser = clap::value_parser!(u32).range(2..=2048))]
    pub(crate) resolution: u32,

    /// Relative error that `analytic` aims at.
    #[arg(long, value_name = "E", default_value_t = 1e-7, value_parser = positive)]
    pub(crate) tolerance: f64,

    /// Patches, about.
    #[arg(long, value_name = "N", default_value_t = 1200, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub(crate) patches: u32,

    /// Plain form factors: light ends at the first surface.
    #[arg(long)]
    pub(crate) plain: bool,

    /// Restores reciprocity and closure, and says by how much it moved anything.
    #[arg(long)]
    pub(crate) repair: bool,

    /// Reflections and refractions in a row after which a path of `rays` and `hemicube` is given up (and booked). `area` and `analytic` take
    /// images in planar mirrors, of up to eight reflections.
    #[arg(long, value_name = "N", default_value_t = 1000, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub(crate) max_depth: u32,

    /// Seed of all sampling sequences. The same seed gives the same bits.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub(crate) seed: u32,

    #[command(flatten)]
    pub(crate) run: RunArgs,
}

/// What form factors are taken between.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum By {
    /// glTF nodes (or node/primitive).
    Surface,
    /// The patches of the coarse solve.
    Patch,
}

#[derive(Debug, Args)]
pub(crate) struct InfoArgs {
    /// A glTF 2.0 scene (.glb or .gltf), or a solution written by `solve`.
    #[arg(value_name = "SCENE")]
    pub(crate) scene: PathBuf,

    /// Writes the same as JSON to standard output.
    #[arg(long)]
    pub(crate) json: bool,
}

/// How light is computed: the same words for both passes.
#[derive(Debug, Args)]
#[command(next_help_heading = "Light")]
pub(crate) struct TransportArgs {
    /// How much work to spend.
    #[arg(long, value_enum, default_value_t = QualityWord::Standard)]
    pub(crate) quality: QualityWord,

    /// Reflections and refractions in a row after which a path is given up (and booked): 1000, at `high` 4000 for what the eye sees. Light
    /// of lamps by way of planar mirrors is not followed but taken from images, of up to eight reflections.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub(crate) max_depth: Option<u32>,

    /// Plain radiosity: mirrors and glass are seen but light nothing. For teaching.
    #[arg(long)]
    pub(crate) plain: bool,

    /// Photometric file (IES LM-63) of a punctual light: its candela instead of the light's own, tinted by its colour.
    #[arg(long, value_name = "LIGHT=FILE")]
    pub(crate) ies: Vec<LightFile>,

    /// Light from the sky: a radiance, or an equirectangular image (.exr, .hdr).
    #[arg(long, value_name = "R,G,B|FILE")]
    pub(crate) sky: Option<SkySource>,

    /// Seed of all sampling sequences. The same seed gives the same bits.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub(crate) seed: u32,

    /// Form factors of the coarse solve: rays, hemicube, area or analytic. Without it: rays, as many as the quality says.
    #[arg(long, value_name = "METHOD")]
    pub(crate) method: Option<Method>,

    /// Solver of the coarse solve: direct, jacobi, gauss-seidel, southwell, southwell-unordered or progressive; direct-faer where
    /// the program was built with it. Without it: Gauss-Seidel on irradiance, three channels at once.
    #[arg(long, value_name = "SOLVER")]
    pub(crate) solver: Option<Solver>,

    /// Residual (of shooters: unshot power), relative to the emitted power, at which the solver stops. Without it: 1e-5.
    #[arg(long, value_name = "E", value_parser = positive)]
    pub(crate) residual: Option<f64>,

    /// Light at vertices: by a final gather, or from the patches around them as in the first radiosity pictures.
    #[arg(long, value_enum, default_value_t = Reconstruct::Gather)]
    pub(crate) reconstruct: Reconstruct,

    /// Smooth light between vertices, or the patches themselves.
    #[arg(long, value_enum, default_value_t = Shading::Gouraud)]
    pub(crate) shading: Shading,

    /// Steps after which the solver stops: sweeps, or rows shot. Without it: 500 sweeps, or a million rows.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) max_steps: Option<u32>,
}

/// Light at vertices.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Reconstruct {
    /// Hemisphere rays from every vertex, and a fit.
    Gather,
    /// Means of the patches around a vertex.
    Averaged,
    /// The same, extrapolated to the border of a surface.
    Extrapolated,
}

/// Light between vertices.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Shading {
    /// Every patch has one radiosity.
    Flat,
    /// Interpolated.
    Gouraud,
}

impl TransportArgs {
    /// The classical picture that is asked for, and its word.
    pub(crate) fn reconstruction(&self) -> Option<(Reconstruction, &'static str)> {
        match (self.shading, self.reconstruct) {
            (Shading::Flat, _) => Some((Reconstruction::Flat, "flat")),
            (_, Reconstruct::Gather) => None,
            (_, Reconstruct::Averaged) => Some((Reconstruction::Averaged, "averaged")),
            (_, Reconstruct::Extrapolated) => Some((Reconstruction::Extrapolated, "extrapolated")),
        }
    }
}

/// How the program behaves.
#[derive(Debug, Args)]
#[command(next_help_heading = "Program")]
pub(crate) struct RunArgs {
    /// Threads; the result does not depend on it. Without it: all processors.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub(crate) threads: Option<u16>,

    /// Says nothing but errors.
    #[arg(short, long)]
    pub(crate) quiet: bool,

    /// Writes a report as JSON (times, rays, patches, memory, ledger, warnings) to FILE, or to standard output.
    #[arg(long, value_name = "FILE", num_args = 0..=1)]
    pub(crate) json: Option<Option<PathBuf>>,
}

/// One word for all budgets.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum QualityWord {
    /// Where lamps and cameras go.
    Sketch,
    /// A first look.
    Draft,
    /// What one shows.
    Standard,
    /// Indistinguishable from converged at the size of a screen.
    High,
}

impl QualityWord {
    pub(crate) fn quality(self) -> catoptric_solution::Quality {
        match self {
            Self::Sketch => catoptric_solution::Quality::Sketch,
            Self::Draft => catoptric_solution::Quality::Draft,
            Self::Standard => catoptric_solution::Quality::Standard,
            Self::High => catoptric_solution::Quality::High,
        }
    }

    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Sketch => "sketch",
            Self::Draft => "draft",
            Self::Standard => "standard",
            Self::High => "high",
        }
    }
}

fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(number) if number > 0.0 && number.is_finite() => Ok(number),
        _ => Err("expected a number above 0".to_owned()),
    }
}
