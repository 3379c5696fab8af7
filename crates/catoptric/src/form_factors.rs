//! `catoptric form-factors`: extended form factors for people who need the numbers.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use glam::DVec3;
use serde::Serialize;

use catoptric_image::write_bytes_atomically;
use catoptric_radiosity::base_mesh::coarse_patches;
use catoptric_radiosity::method::{self, ElementSet, FactorMatrix, Method, MethodParams};
use catoptric_scene::Barycentric;
use catoptric_trace::Tracer;

use crate::args::{By, FormFactorsArgs};
use crate::failure::Failure;
use crate::input::{Input, Light};
use crate::interrupt;
use crate::npz::Npz;
use crate::output;
use crate::progress::Reporter;
use crate::report::{print, to_json};
use crate::summary;

/// Rays per sender and scramble where nobody says.
const RAYS_BY_SURFACE: u32 = 16_384;
const RAYS_BY_PATCH: u32 = 64;
/// Shares above which a scene is called open or inside out.
const OPEN: f64 = 1e-4;
const INSIDE_OUT: f64 = 0.05;
/// Elements up to which zeros are written, too.
const WRITE_ZEROS: usize = 200;

/// What is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Csv,
    Npz,
}

#[derive(Debug, Serialize)]
struct RowReport {
    name: String,
    area: f64,
    row_sum: [f64; 3],
    arrived: [f64; 3],
    absorbed_by_mirrors_and_glass: [f64; 3],
    black_backs: [f64; 3],
    escaped: [f64; 3],
    cut_off: [f64; 3],
    roulette: [f64; 3],
    largest_error: f64,
}

#[derive(Debug, Serialize)]
struct RepairReport {
    largest_change: f64,
    mean_relative_change: f64,
    rounds: usize,
    closure_left: f64,
}

#[derive(Debug, Serialize)]
struct Report {
    program: &'static str,
    version: &'static str,
    command: &'static str,
    method: &'static str,
    elements: usize,
    samples: u64,
    seconds: f64,
    worst_reciprocity: f64,
    worst_reciprocity_pair: Option<[String; 2]>,
    mean_reciprocity_relative: f64,
    largest_error: f64,
    escaped: f64,
    black_backs: f64,
    rows: Vec<RowReport>,
    repair: Option<RepairReport>,
    warnings: Vec<String>,
    outputs: Vec<PathBuf>,
}

pub(crate) fn run(args: &FormFactorsArgs) -> Result<(), Failure> {
    let reporter = Reporter::new(args.run.quiet);
    let (path, format) = check_output(args)?;

    reporter.begin_deaf("load");
    let input = Input::read(&args.scene, None, Light::New)?;
    let outputs = std::iter::once(&path).chain(args.run.json.iter().flatten());
    output::check_are_no_inputs(outputs, &input.files)?;
    let mut warnings = input.warnings.clone();
    reporter.begin_deaf("tree");
    let tracer = Tracer::new(&input.scene);
    let set = match args.by {
        By::Surface => ElementSet::surfaces(&tracer),
        By::Patch => {
            let (draft, patches) = coarse_patches(&tracer, args.patches as usize);
            ElementSet::patches(&tracer, &draft, &patches)
        }
    };
    if set.is_empty() {
        return Err(Failure::run(
            format_args!("{}: has nothing to take form factors between", args.scene.display()),
            "the scene needs at least one surface with triangles (--by patch: a diffuse one)",
        ));
    }
    let mut params = params(args);
    if args.method == Method::Area && args.by == By::Patch {
        // Pairs: the same work as for surfaces would be rows × columns × rays.
        params.rays = args.rays.unwrap_or(4);
    }
    let prepared = method::prepare(args.method, &tracer, &set, &params).map_err(|error| {
        Failure::run(
            format_args!("{}: --method {}: {error}", args.scene.display(), args.method.name()),
            "use --method rays",
        )
    })?;
    let mut matrix = method::factors(prepared.as_ref(), &set, &reporter)?;
    reporter.end();

    let weights = FactorMatrix::weights(&tracer, &set);
    let before = matrix.closure(&weights);
    open_or_inside_out(&matrix, &set, &mut warnings);
    let repair = args.repair.then(|| {
        let kept = kept(&tracer, &set, !args.plain);
        let complete = args.by == By::Surface || !tracer.has_specular() || args.plain;
        if !complete {
            warnings.push(
                "--repair: patches do not cover mirrors and glass: only reciprocity is restored".to_owned(),
            );
        }
        let done = matrix.repair(&weights, &kept, complete);
        RepairReport {
            largest_change: done.largest,
            mean_relative_change: done.mean,
            rounds: done.rounds,
            closure_left: done.left,
        }
    });
    let closure = if repair.is_some() { matrix.closure(&weights) } else { before.clone() };

    interrupt::write();
    let outputs = match format {
        Format::Csv => {
            write(&path, csv(&matrix, &set).as_bytes())?;
            vec![path]
        }
        Format::Npz => write_npz(&path, &matrix, &set)?,
    };

    // What a person checks before trusting the numbers.
    summary::warn(&reporter, &warnings);
    let name = |index: u32| set.elements()[index as usize].name.clone();
    let pair = closure.worst_pair.map(|(i, j)| [name(i), name(j)]);
    let samples = matrix.rows.iter().map(|r| r.samples).sum();
    reporter.say(&format!(
        "{} elements, {} samples, {}",
        set.len(),
        summary::count(samples),
        args.method.name()
    ));
    for (row, element) in matrix.rows.iter().zip(set.elements()).take(SAY_ROWS) {
        let error = row.entries.iter().map(|e| e.error).fold(0.0, f64::max);
        let sum: DVec3 = row.entries.iter().map(|e| e.factor).sum();
        reporter.say(&format!(
            "  {}: sum {:.6}, mirrors and glass {:.6}, backs {:.6}, escaped {:.6}, error {:.1e}",
            element.name, sum.x, row.ledger.absorbed.x, row.ledger.black_backs.x, row.ledger.escaped.x, error
        ));
    }
    if set.len() > SAY_ROWS {
        reporter.say(&format!("  … {} more: --json has all", set.len() - SAY_ROWS));
    }
    let between = pair.as_ref().map_or(String::new(), |[a, b]| format!(" between {a} and {b}"));
    reporter
        .say(&format!("reciprocity: worst |A_i F_ij - A_j F_ji| = {:.3e} m²{between}", closure.reciprocity));
    if let Some(repair) = &repair {
        reporter.say(&format!(
            "repair: before {:.3e} m²; largest change of F {:.3e}, mean {:.3e} of F; closure left {:.1e}",
            before.reciprocity, repair.largest_change, repair.mean_relative_change, repair.closure_left
        ));
    }
    summary::written(&reporter, &outputs);
    if let Some(file) = &args.run.json {
        let report = Report {
            program: "catoptric",
            version: env!("CARGO_PKG_VERSION"),
            command: "form-factors",
            method: args.method.name(),
            elements: set.len(),
            samples,
            seconds: reporter.seconds(),
            worst_reciprocity: closure.reciprocity,
            worst_reciprocity_pair: pair,
            mean_reciprocity_relative: closure.reciprocity_relative,
            largest_error: closure.largest_error,
            escaped: closure.escaped,
            black_backs: closure.black_backs,
            rows: rows(&matrix, &set),
            repair,
            warnings,
            outputs,
        };
        let text = to_json(&report)?;
        match file {
            None => print(&text)?,
            Some(file) => write(file, text.as_bytes())?,
        }
    }
    Ok(())
}

/// Rows that are listed on the terminal.
const SAY_ROWS: usize = 24;

fn check_output(args: &FormFactorsArgs) -> Result<(PathBuf, Format), Failure> {
    let Some(path) = &args.output else {
        return Err(Failure::usage("no output was named", "add -o F.csv or -o F.npz"));
    };
    let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    let format = match extension.as_str() {
        "csv" => Format::Csv,
        "npz" => Format::Npz,
        _ => {
            return Err(Failure::usage(
                format_args!("{}: unknown kind of table", path.display()),
                "form factors are written as .csv or .npz: name the output like F.csv",
            ));
        }
    };
    let files: Vec<PathBuf> = std::iter::once(path.clone()).chain(args.run.json.clone().flatten()).collect();
    output::check_distinct(&files)?;
    for file in &files {
        output::check(file)?;
    }
    Ok((path.clone(), format))
}

fn params(args: &FormFactorsArgs) -> MethodParams {
    let default = match args.by {
        By::Surface => RAYS_BY_SURFACE,
        By::Patch => RAYS_BY_PATCH,
    };
    let mut params = MethodParams {
        rays: args.rays.unwrap_or(default),
        seed: args.seed,
        resolution: args.resolution,
        tolerance: args.tolerance,
        ..MethodParams::default()
    };
    params.walk.extended = !args.plain;
    params.walk.max_depth = args.max_depth;
    params
}

/// Says what an author of a room would want to know: power gets out, or surfaces turn their backs.
fn open_or_inside_out(matrix: &FactorMatrix, set: &ElementSet, warnings: &mut Vec<String>) {
    let worst = |share: &dyn Fn(&method::FactorRow) -> f64| {
        let shares = matrix.rows.iter().map(share).zip(set.elements());
        shares.max_by(|a, b| a.0.total_cmp(&b.0)).map(|(share, e)| (share, e.name.clone()))
    };
    if let Some((share, name)) = worst(&|r| r.ledger.escaped.max_element()).filter(|w| w.0 > OPEN) {
        warnings.push(format!(
            "the scene is open: up to {:.2} % of the power escapes (from {name}); its rows do not sum to 1",
            100.0 * share
        ));
    }
    if let Some((share, name)) = worst(&|r| r.ledger.black_backs.max_element()).filter(|w| w.0 > INSIDE_OUT) {
        warnings.push(format!(
            "surfaces are inside out: up to {:.2} % of the power meets black backs (from {name}); \
             turn them round or make them doubleSided",
            100.0 * share
        ));
    }
}

/// 1 − ρ_s of each element: what it keeps of what arrives.
fn kept(tracer: &Tracer, set: &ElementSet, extended: bool) -> Vec<DVec3> {
    (0..set.len() as u32)
        .map(|index| {
            let piece = set.pieces(index).first().filter(|_| extended);
            piece.map_or(DVec3::ONE, |p| {
                let point = tracer.scene().surface_point(p.triangle, Barycentric { u: 0.3, v: 0.3 });
                DVec3::ONE - point.mirror.as_dvec3()
            })
        })
        .collect()
}

fn rows(matrix: &FactorMatrix, set: &ElementSet) -> Vec<RowReport> {
    let rows = matrix.rows.iter().zip(set.elements());
    rows.map(|(row, element)| RowReport {
        name: element.name.clone(),
        area: element.area,
        row_sum: row.entries.iter().map(|e| e.factor).sum::<DVec3>().to_array(),
        arrived: row.ledger.arrived.to_array(),
        absorbed_by_mirrors_and_glass: row.ledger.absorbed.to_array(),
        black_backs: row.ledger.black_backs.to_array(),
        escaped: row.ledger.escaped.to_array(),
        cut_off: row.ledger.cut_off.to_array(),
        roulette: row.ledger.roulette.to_array(),
        largest_error: row.entries.iter().map(|e| e.error).fold(0.0, f64::max),
    })
    .collect()
}

/// A field, quoted where it has to be.
fn field(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}

fn csv(matrix: &FactorMatrix, set: &ElementSet) -> String {
    let names: Vec<String> = set.elements().iter().map(|e| field(&e.name)).collect();
    let mut text = "from,to,F_r,F_g,F_b,area_from\n".to_owned();
    let mut line = |from: usize, to: usize, f: DVec3| {
        let area = set.elements()[from].area;
        let _ = writeln!(text, "{},{},{},{},{},{area}", names[from], names[to], f.x, f.y, f.z);
    };
    for from in 0..set.len() {
        if set.len() <= WRITE_ZEROS {
            for to in 0..set.len() {
                line(from, to, matrix.get(from as u32, to as u32));
            }
        } else {
            for entry in &matrix.rows[from].entries {
                line(from, entry.to as usize, entry.factor);
            }
        }
    }
    text
}

fn write_npz(path: &Path, matrix: &FactorMatrix, set: &ElementSet) -> Result<Vec<PathBuf>, Failure> {
    let channels: &[(usize, &str)] =
        if matrix.is_gray() { &[(0, "")] } else { &[(0, "r"), (1, "g"), (2, "b")] };
    let mut outputs = Vec::new();
    for &(channel, tag) in channels {
        let mut npz = Npz::default();
        let (mut data, mut indices, mut starts) = (Vec::new(), Vec::new(), vec![0_i64]);
        for row in &matrix.rows {
            for entry in &row.entries {
                data.push(entry.factor[channel]);
                indices.push(i64::from(entry.to));
            }
            starts.push(data.len() as i64);
        }
        npz.add_i64("indices", &indices);
        npz.add_i64("indptr", &starts);
        npz.add_bytes("format", "csr");
        npz.add_i64("shape", &[set.len() as i64, set.len() as i64]);
        npz.add_f64("data", &data);
        npz.add_f64("areas", &set.elements().iter().map(|e| e.area).collect::<Vec<_>>());
        npz.add_strings("names", &set.elements().iter().map(|e| e.name.as_str()).collect::<Vec<_>>());
        let file = if tag.is_empty() { path.to_owned() } else { path.with_extension(format!("{tag}.npz")) };
        let Some(bytes) = npz.finish() else {
            return Err(Failure::run(
                format_args!("{}: the matrix is larger than 4 GB", file.display()),
                "use fewer patches, or .csv",
            ));
        };
        write(&file, &bytes)?;
        outputs.push(file);
    }
    Ok(outputs)
}

fn write(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    write_bytes_atomically(path, bytes)
        .map_err(|error| Failure::Run(format!("{}: cannot be written: {error}", path.display())))
}
