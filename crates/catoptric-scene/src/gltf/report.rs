//! Problems and warnings: collected while a file is read, so that its author sees all of them at once.

use std::cell::{Cell, RefCell};
use std::fmt;
use std::path::{Path, PathBuf};

/// How many problems and how many warnings are kept in full.
const KEPT: usize = 200;

/// One thing that keeps a file from being loaded.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Problem {
    /// The file it is in.
    pub file: PathBuf,
    /// Where in the file: node, material, accessor, by index and name.
    pub place: String,
    /// What was expected there.
    pub expected: String,
    /// What is there.
    pub found: String,
    /// What to do about it; may be empty.
    pub hint: String,
}

/// Something that was read in another way than the author may have meant.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Warning {
    /// Where: node, material, texture, by index and name.
    pub place: String,
    /// What was done.
    pub message: String,
}

/// All problems of a file.
#[derive(Clone, Debug)]
pub struct LoadError {
    /// In the order in which they were met; never empty.
    pub problems: Vec<Problem>,
    /// How many more there were.
    pub omitted: usize,
    /// What was noticed besides.
    pub warnings: Vec<Warning>,
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{}: {}: expected {}, found {}",
            self.file.display(),
            self.place,
            self.expected,
            self.found
        )?;
        if !self.hint.is_empty() {
            write!(f, "\n  hint: {}", self.hint)?;
        }
        Ok(())
    }
}

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.place, self.message)
    }
}

impl fmt::Display for LoadError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, problem) in self.problems.iter().enumerate() {
            if index > 0 {
                writeln!(f)?;
            }
            write!(f, "{problem}")?;
        }
        if self.omitted > 0 {
            write!(f, "\nand {} more problems", self.omitted)?;
        }
        Ok(())
    }
}

impl std::error::Error for LoadError {}

/// Collects problems and warnings of one file. Shared by reference: every reader may add to it.
#[derive(Debug)]
pub(super) struct Report {
    file: PathBuf,
    problems: RefCell<Vec<Problem>>,
    warnings: RefCell<Vec<Warning>>,
    omitted_problems: Cell<usize>,
    omitted_warnings: Cell<usize>,
}

impl Report {
    pub(super) fn new(file: &Path) -> Self {
        Self {
            file: file.to_owned(),
            problems: RefCell::default(),
            warnings: RefCell::default(),
            omitted_problems: Cell::new(0),
            omitted_warnings: Cell::new(0),
        }
    }

    /// Adds a problem; the file will be refused once everything has been read.
    pub(super) fn problem(
        &self,
        place: impl fmt::Display,
        expected: impl fmt::Display,
        found: impl fmt::Display,
        hint: &str,
    ) {
        let mut problems = self.problems.borrow_mut();
        if problems.len() >= KEPT {
            self.omitted_problems.set(self.omitted_problems.get() + 1);
            return;
        }
        let problem = Problem {
            file: self.file.clone(),
            place: place.to_string(),
            expected: expected.to_string(),
            found: shorten(&found.to_string()),
            hint: hint.to_owned(),
        };
        if !problems.contains(&problem) {
            problems.push(problem);
        }
    }

    /// Adds a warning once.
    pub(super) fn warn(&self, place: impl fmt::Display, message: impl fmt::Display) {
        let mut warnings = self.warnings.borrow_mut();
        if warnings.len() >= KEPT {
            self.omitted_warnings.set(self.omitted_warnings.get() + 1);
            return;
        }
        let warning = Warning { place: place.to_string(), message: message.to_string() };
        if !warnings.contains(&warning) {
            warnings.push(warning);
        }
    }

    pub(super) fn has_problems(&self) -> bool {
        !self.problems.borrow().is_empty()
    }

    /// The warnings if there was no problem, else the error.
    pub(super) fn finish(self) -> Result<Vec<Warning>, LoadError> {
        let mut warnings = self.warnings.into_inner();
        if self.omitted_warnings.get() > 0 {
            let message = format!("{} more warnings are not shown", self.omitted_warnings.get());
            warnings.push(Warning { place: "file".to_owned(), message });
        }
        let problems = self.problems.into_inner();
        if problems.is_empty() {
            Ok(warnings)
        } else {
            Err(LoadError { problems, omitted: self.omitted_problems.get(), warnings })
        }
    }
}

/// The first characters of something the file contains, so that a message stays a message.
fn shorten(text: &str) -> String {
    const LONGEST: usize = 120;
    if text.chars().count() <= LONGEST {
        return text.to_owned();
    }
    text.chars().take(LONGEST).chain("…".chars()).collect()
}
