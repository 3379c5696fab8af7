//! What went wrong, in the words of the person at the terminal, and the exit code that says so.

use std::backtrace::{Backtrace, BacktraceStatus};
use std::fmt;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::process::ExitCode;
use std::sync::{Mutex, PoisonError};

use crate::interrupt;

/// An end other than success.
#[derive(Debug)]
pub(crate) enum Failure {
    /// The input, the rendering or an output failed. Exit code 1.
    Run(String),
    /// The command line asks for something that makes no sense. Exit code 2.
    Usage(String),
    /// Ctrl-C. Exit code 130, as shells have it.
    Interrupted,
}

impl Failure {
    pub(crate) fn exit_code(&self) -> u8 {
        match self {
            Self::Run(_) => 1,
            Self::Usage(_) => 2,
            Self::Interrupted => interrupt::EXIT_CODE,
        }
    }

    /// A failure of the run with something to do about it.
    pub(crate) fn run(message: impl fmt::Display, hint: impl fmt::Display) -> Self {
        Self::Run(format!("{message}\n  hint: {hint}"))
    }

    /// A failure of the command line with something to do about it.
    pub(crate) fn usage(message: impl fmt::Display, hint: impl fmt::Display) -> Self {
        Self::Usage(format!("{message}\n  hint: {hint}"))
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Run(message) | Self::Usage(message) => f.write_str(message),
            Self::Interrupted => f.write_str("interrupted"),
        }
    }
}

impl From<catoptric_scene::Cancelled> for Failure {
    fn from(_: catoptric_scene::Cancelled) -> Self {
        Self::Interrupted
    }
}

impl From<catoptric_image::ImageError> for Failure {
    fn from(error: catoptric_image::ImageError) -> Self {
        Self::Run(error.to_string())
    }
}

/// Says something on standard error. Whoever closed it, or let it fill up, has the exit code.
pub(crate) fn tell(text: impl fmt::Display) {
    use std::io::Write;
    let _ = writeln!(std::io::stderr(), "{text}");
}

/// What a panic ends with, as in any program in Rust.
const PANICKED: u8 = 101;

/// Runs the program. A panic is told where it ends the program, as a fault of it, and not where it is only that of a library which somebody
/// expects: a decoder's of a damaged image, the triangulation's of hard lines.
pub(crate) fn guard(run: impl FnOnce() -> ExitCode) -> ExitCode {
    static LAST: Mutex<String> = Mutex::new(String::new());
    let last = || LAST.lock().unwrap_or_else(PoisonError::into_inner);
    std::panic::set_hook(Box::new(move |panic| {
        let trace = Backtrace::capture();
        let asked_for = trace.status() == BacktraceStatus::Captured;
        *last() = if asked_for { format!("{panic}\n{trace}") } else { panic.to_string() };
    }));
    catch_unwind(AssertUnwindSafe(run)).unwrap_or_else(|_| {
        tell(format_args!(
            "error: {}\n  hint: this is a fault of catoptric: please report it with the scene and the command",
            last()
        ));
        ExitCode::from(PANICKED)
    })
}

/// The candidate that was probably meant by `text`.
pub(crate) fn did_you_mean<'a>(text: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let lower = text.to_lowercase();
    candidates
        .into_iter()
        .map(|candidate| (strsim::jaro_winkler(&lower, &candidate.to_lowercase()), candidate))
        .filter(|(similarity, _)| *similarity > 0.75)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, candidate)| candidate)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_ends_the_program_where_nobody_expects_it() {
        let code = |run: fn() -> ExitCode| format!("{:?}", guard(run));
        let expected =
            || catch_unwind(|| panic!("of a library")).map_or(ExitCode::from(7), |()| ExitCode::SUCCESS);
        let unexpected = || panic!("of the program");
        let codes = [code(|| ExitCode::from(3)), code(expected), code(unexpected)];
        let _ = std::panic::take_hook();
        assert_eq!(codes, [3, 7, PANICKED].map(|code| format!("{:?}", ExitCode::from(code))));
    }

    #[test]
    fn a_slip_finds_its_word_and_nonsense_finds_none() {
        let names = ["Camera", "Left", "Balcony"];
        assert_eq!(did_you_mean("balcny", names), Some("Balcony"));
        assert_eq!(did_you_mean("LEFT", names), Some("Left"));
        assert_eq!(did_you_mean("zzz", names), None);
    }
}
