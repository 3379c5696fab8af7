//! What went wrong, in the words of the person at the terminal, and the exit code that says so.

use std::fmt;

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
    fn a_slip_finds_its_word_and_nonsense_finds_none() {
        let names = ["Camera", "Left", "Balcony"];
        assert_eq!(did_you_mean("balcny", names), Some("Balcony"));
        assert_eq!(did_you_mean("LEFT", names), Some("Left"));
        assert_eq!(did_you_mean("zzz", names), None);
    }
}
