//! What a person reads at the end of a run.

use std::path::PathBuf;

use catoptric_radiosity::SolveReport;
use catoptric_radiosity::solver::Stop;

use crate::progress::Reporter;

/// The first warnings; `info` and the JSON report have them all.
pub(crate) fn warn(reporter: &Reporter, warnings: &[String]) {
    const SHOWN: usize = 10;
    for warning in warnings.iter().take(SHOWN) {
        reporter.say(&format!("warning: {warning}"));
    }
    if warnings.len() > SHOWN {
        reporter.say(&format!("warning: {} more: see `catoptric info`", warnings.len() - SHOWN));
    }
}

/// Size and effort of pass one.
pub(crate) fn solved(reporter: &Reporter, report: &SolveReport) {
    let rays: u64 = report.rays.iter().map(|(_, rays)| rays).sum();
    reporter.say(&format!(
        "solved: {} patches, {} vertices, {} rays",
        count(report.patches as u64),
        count(report.vertices as u64),
        count(rays)
    ));
    reporter.say(&format!(
        "solver: {} steps, residual {:.1e}, stopped by {}",
        count(report.iterations as u64),
        report.residual,
        report.stop.map_or("", Stop::name)
    ));
    for note in &report.notes {
        reporter.say(&format!("note: {note}"));
    }
    if report.rays.is_empty() {
        reporter.say("      a sky is light: --sky 1,1,1");
    }
}

/// What was written, and how long everything took.
pub(crate) fn written(reporter: &Reporter, files: &[PathBuf]) {
    let seconds = reporter.seconds();
    match files {
        [] => {}
        [file] => reporter.say(&format!("wrote {} in {seconds:.2} s", file.display())),
        [first, second] => {
            reporter.say(&format!("wrote {} and {} in {seconds:.2} s", first.display(), second.display()));
        }
        [first, .., last] => reporter.say(&format!(
            "wrote {} files, {} to {}, in {seconds:.2} s",
            files.len(),
            first.display(),
            last.display()
        )),
    }
}

/// A number that a person can grasp: 950, 12.3 k, 4.56 M.
pub(crate) fn count(number: u64) -> String {
    let value = number as f64;
    match number {
        0..1_000 => number.to_string(),
        1_000..1_000_000 => format!("{:.1} k", value / 1e3),
        1_000_000..1_000_000_000 => format!("{:.2} M", value / 1e6),
        _ => format!("{:.2} G", value / 1e9),
    }
}
