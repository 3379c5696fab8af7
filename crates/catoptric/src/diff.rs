//! `catoptric diff`: compares images and says so with its exit code.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use catoptric_diff::metric::Settings;
use catoptric_diff::report::{Entry, EntryState};
use catoptric_diff::{
    Approval, DiffError, Job, Limits, Metric, Outcome, Params, Space, approve, approve_directory,
    parse_limit, run_directories,
};

use crate::failure::tell;
use crate::output::check_are_no_inputs;
use crate::report;

/// Compares a rendered image, or a directory of them, with a reference.
///
/// Exit codes: 0 within the limits, 1 outside, 2 could not compare. Without limits the images must be equal.
#[derive(clap::Args, Debug)]
#[command(after_help = "Examples:
  catoptric diff out.exr reference.exr --max relMSE=1e-3 --max lum_ratio=0.003
  catoptric diff out.exr reference.exr --max p99_rel=0.2 --html report.html
  catoptric diff out/ reference/ --html report/
  catoptric diff out.exr reference.exr --approve --note 'sharper shadows'")]
pub(crate) struct DiffArgs {
    /// Image or directory under test (EXR, Radiance HDR, PFM, PNG, JPEG).
    test: PathBuf,
    /// Reference image or directory.
    reference: PathBuf,
    /// Upper limit, as METRIC=VALUE or LAYER:METRIC=VALUE; for ratios the distance from one. Repeatable.
    #[arg(long, value_name = "METRIC=VALUE")]
    max: Vec<String>,
    /// Lower limit for SSIM and PSNR. Repeatable.
    #[arg(long, value_name = "METRIC=VALUE")]
    min: Vec<String>,
    /// The reference's own noise must explain the difference.
    #[arg(long)]
    explained_by_noise: bool,
    /// Limits file to use instead of NAME.limits.json or NAME.json beside the reference.
    #[arg(long, value_name = "FILE")]
    limits: Option<PathBuf>,
    /// Region to compare.
    #[arg(long, value_name = "X,Y,WIDTH,HEIGHT", value_parser = parse_crop)]
    crop: Option<[usize; 4]>,
    /// Image whose pixels that are not black are compared.
    #[arg(long, value_name = "FILE")]
    mask: Option<PathBuf>,
    /// Layer to compare, "" for the beauty; all common ones if not given. Repeatable.
    #[arg(long, value_name = "NAME")]
    layer: Vec<String>,
    /// Metric to compute: squared, relative, psnr, ssim, flip, energy, percentiles, noise, health. Repeatable.
    #[arg(long, value_name = "NAME", value_parser = parse_metric)]
    metric: Vec<Metric>,
    /// Numbers that differences are taken of: auto (code values for PNG and JPEG), linear, coded.
    #[arg(long, value_name = "SPACE", value_parser = parse_space, default_value = "auto")]
    space: Space,
    /// Print the outcome as JSON.
    #[arg(long)]
    json: bool,
    /// Write the report to this file; for directories, into this folder.
    #[arg(long, value_name = "PATH")]
    html: Option<PathBuf>,
    /// Write heat maps, side by side, the worst places and the histogram into this folder.
    #[arg(long, value_name = "FOLDER")]
    pictures: Option<PathBuf>,
    /// Make the test image the reference and write its birth certificate, with the limits given.
    #[arg(long, conflicts_with_all = ["crop", "mask", "layer", "metric", "html", "pictures", "limits"])]
    approve: bool,
    /// Let --approve loosen the limits of the birth certificate.
    #[arg(long, requires = "approve")]
    loosen: bool,
    /// Why the reference changes, for its birth certificate.
    #[arg(long, requires = "approve", value_name = "TEXT")]
    note: Option<String>,
    /// Print only what is wrong.
    #[arg(long, short)]
    quiet: bool,
}

/// Runs the command.
pub(crate) fn run(args: &DiffArgs) -> ExitCode {
    let done = if args.approve { approve_files(args) } else { compare_files(args) };
    match done {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::from(1),
        Err(Failure(message)) => {
            if !message.is_empty() {
                tell(format_args!("catoptric diff: {message}"));
            }
            ExitCode::from(2)
        }
    }
}

/// Why there is no verdict; empty if that was said already.
struct Failure(String);

impl From<DiffError> for Failure {
    fn from(error: DiffError) -> Self {
        Failure(error.to_string())
    }
}

fn compare_files(args: &DiffArgs) -> Result<bool, Failure> {
    let job = Job {
        params: Params {
            crop: args.crop,
            layers: (!args.layer.is_empty()).then(|| args.layer.clone()),
            space: args.space,
            settings: Settings::default(),
            metrics: (!args.metric.is_empty()).then(|| args.metric.clone()),
            ..Params::default()
        },
        mask: args.mask.clone(),
        limits: limits(args)?,
        limits_file: args.limits.clone(),
        html: args.html.clone(),
        pictures: args.pictures.clone(),
        ..Job::default()
    };
    if directories(args)? {
        return compare_directories(args, &job);
    }
    if let Some(page) = &args.html {
        let also = [&args.mask, &args.limits].into_iter().flatten();
        let inputs: Vec<PathBuf> = [&args.test, &args.reference].into_iter().chain(also).cloned().collect();
        check_are_no_inputs([page], &inputs).map_err(|error| Failure(error.to_string()))?;
    }
    let outcome = catoptric_diff::run(&job, &args.test, &args.reference)?;
    if args.json {
        print_json(&outcome.to_json(&args.test, &args.reference))?;
    } else {
        print_outcome(&outcome, args)?;
    }
    Ok(outcome.within())
}

fn compare_directories(args: &DiffArgs, job: &Job) -> Result<bool, Failure> {
    let mut objects = Vec::new();
    let mut printed = Ok(());
    let entries = run_directories(job, &args.test, &args.reference, |entry, outcome| {
        if args.json {
            let name = Path::new(&entry.name);
            let details = outcome.map(|o| o.to_json(&args.test.join(name), &args.reference.join(name)));
            objects.push(
                serde_json::json!({ "name": entry.name, "state": describe(entry), "outcome": details }),
            );
        } else if !args.quiet || entry.state != EntryState::Within {
            let line = print(&format!("{}: {}\n", entry.name, describe(entry)));
            printed = std::mem::replace(&mut printed, Ok(())).and(line);
        }
    })?;
    printed?;
    if args.json {
        print_json(&serde_json::Value::Array(objects))?;
    }
    if entries.iter().any(|e| matches!(e.state, EntryState::Failed(_))) {
        return Err(Failure(String::new()));
    }
    Ok(entries.iter().all(|e| e.state == EntryState::Within))
}

fn describe(entry: &Entry) -> String {
    let numbers = entry.numbers.map_or(String::new(), |[flip, relative, energy]| {
        format!(", FLIP {flip:.4}, relMSE {relative:.3e}, lum_ratio {energy:.4}")
    });
    match &entry.state {
        EntryState::Within => format!("within limits{numbers}"),
        EntryState::Outside => format!("OUTSIDE LIMITS{numbers}"),
        EntryState::Missing => "MISSING: only the reference exists".to_owned(),
        EntryState::Extra => "EXTRA: no reference".to_owned(),
        EntryState::Failed(reason) => format!("NOT COMPARED: {reason}"),
    }
}

fn approve_files(args: &DiffArgs) -> Result<bool, Failure> {
    let approval =
        Approval { limits: limits(args)?, loosen: args.loosen, note: args.note.clone(), date: today() };
    if args.test.is_dir() {
        for name in approve_directory(&args.test, &args.reference, &approval)? {
            print(&format!("approved {}\n", args.reference.join(name).display()))?;
        }
    } else {
        approve(&args.test, &args.reference, &approval)?;
        print(&format!("approved {}\n", args.reference.display()))?;
    }
    Ok(true)
}

fn limits(args: &DiffArgs) -> Result<Limits, Failure> {
    let parse = |texts: &[String]| texts.iter().map(|t| parse_limit(t)).collect::<Result<_, _>>();
    Ok(Limits { max: parse(&args.max)?, min: parse(&args.min)?, explained_by_noise: args.explained_by_noise })
}

/// Whether both are directories; a file and a directory cannot be compared.
fn directories(args: &DiffArgs) -> Result<bool, Failure> {
    match (args.test.is_dir(), args.reference.is_dir()) {
        (true, true) => Ok(true),
        (false, false) => Ok(false),
        _ => Err(Failure(format!(
            "{} and {}: one is a directory",
            args.test.display(),
            args.reference.display()
        ))),
    }
}

/// Prints text; a reader that has gone away is no failure.
fn print(text: &str) -> Result<(), Failure> {
    report::print(text).map_err(|error| Failure(error.to_string()))
}

fn print_json(value: &serde_json::Value) -> Result<(), Failure> {
    print(&format!("{value:#}\n"))
}

fn print_outcome(outcome: &Outcome, args: &DiffArgs) -> Result<(), Failure> {
    let mut lines: Vec<String> = Vec::new();
    if !args.quiet {
        for layer in &outcome.comparison.layers {
            lines.push(layer.title().to_owned());
            for reading in &layer.readings {
                let at = reading.at.map_or(String::new(), |[x, y]| format!("  at {x},{y}"));
                lines.push(format!("  {:<16} {:<12.6}{at}", reading.name, Number(reading.value)));
            }
            if let Some(noise) = &layer.noise {
                let verdict = if noise.explained { "explains" } else { "does not explain" };
                lines.push(format!("  the reference's noise {verdict} the difference"));
            }
        }
        lines.extend(outcome.notes.iter().map(ToString::to_string));
    }
    for check in outcome.checks.iter().filter(|check| !check.holds) {
        let layer = if check.layer.is_empty() { String::new() } else { format!("{}:", check.layer) };
        let (metric, value, limit) = (&check.metric, Number(check.value), &check.limit);
        lines.push(format!("OUTSIDE: {layer}{metric} is {value}, the limit {limit}"));
    }
    if let Some(path) = &args.html {
        lines.push(format!("report: {}", path.display()));
    }
    if !args.quiet && outcome.within() {
        lines.push("within limits".to_owned());
    }
    lines.iter().try_for_each(|line| print(&format!("{line}\n")))
}

/// A number that keeps six digits whatever its size.
struct Number(f64);

impl std::fmt::Display for Number {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let v = self.0;
        let text = if v != 0.0 && (v.abs() < 1e-3 || v.abs() >= 1e6) {
            format!("{v:.5e}")
        } else {
            format!("{v:.6}")
        };
        f.pad_integral(true, "", &text)
    }
}

fn parse_crop(text: &str) -> Result<[usize; 4], String> {
    let numbers: Result<Vec<usize>, _> = text.split(',').map(|n| n.trim().parse::<usize>()).collect();
    numbers
        .ok()
        .and_then(|n| n.try_into().ok())
        .ok_or_else(|| "four numbers: left,top,width,height".to_owned())
}

fn parse_metric(text: &str) -> Result<Metric, String> {
    Metric::ALL
        .into_iter()
        .find(|m| m.name() == text)
        .ok_or_else(|| format!("one of {}", Metric::ALL.map(Metric::name).join(", ")))
}

fn parse_space(text: &str) -> Result<Space, String> {
    match text {
        "auto" => Ok(Space::Auto),
        "linear" => Ok(Space::Linear),
        "coded" => Ok(Space::Coded),
        _ => Err("one of auto, linear, coded".to_owned()),
    }
}

/// The day in UTC, by Hinnant's civil-from-days.
fn today() -> String {
    let seconds =
        std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).map_or(0, |d| d.as_secs());
    let days = (seconds / 86_400) as i64 + 719_468;
    let era = days.div_euclid(146_097);
    let day_of_era = days.rem_euclid(146_097);
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let shifted_month = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * shifted_month + 2) / 5 + 1;
    let month = if shifted_month < 10 { shifted_month + 3 } else { shifted_month - 9 };
    let year = year_of_era + era * 400 + i64::from(month <= 2);
    format!("{year:04}-{month:02}-{day:02}")
}
