//! Two directories of images, paired by name.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use crate::job::{Job, Outcome, run, write_page};
use crate::report::{Entry, EntryState, index_page};
use crate::{Approval, DiffError, approve};

const EXTENSIONS: [&str; 6] = ["exr", "hdr", "pfm", "png", "jpg", "jpeg"];
/// Folders below folders that are entered.
const DEPTH: usize = 16;

/// Compares every image of both directories, `each` after the other, and writes the index page and the reports into the
/// job's `html` folder. Entries come back worst first.
pub fn run_directories(
    job: &Job,
    test: &Path,
    reference: &Path,
    mut each: impl FnMut(&Entry, Option<&Outcome>),
) -> Result<Vec<Entry>, DiffError> {
    let (ours, theirs) = (images(test)?, images(reference)?);
    if ours.is_empty() && theirs.is_empty() {
        let (t, r) = (test.display(), reference.display());
        return Err(DiffError::Region(format!("neither {t} nor {r} holds an image")));
    }
    let mut entries = Vec::new();
    for name in ours.union(&theirs) {
        let title = name.display().to_string();
        let mut entry =
            Entry { name: title.clone(), state: EntryState::Missing, numbers: None, report: None };
        let mut outcome = None;
        if !theirs.contains(name) {
            entry.state = EntryState::Extra;
        } else if ours.contains(name) {
            let mut own = job.clone();
            own.html = job.html.as_ref().map(|folder| folder.join(format!("{title}.html")));
            own.pictures = job.pictures.as_ref().map(|folder| folder.join(name));
            match run(&own, &test.join(name), &reference.join(name)) {
                Ok(found) => {
                    entry.state = if found.within() { EntryState::Within } else { EntryState::Outside };
                    entry.report = job.html.as_ref().map(|_| format!("{title}.html"));
                    let beauty = found.comparison.layers.first();
                    let number = |name| beauty.and_then(|l| l.reading(name)).map_or(f64::NAN, |r| r.value);
                    entry.numbers = Some(["FLIP", "relMSE", "lum_ratio"].map(number));
                    outcome = Some(found);
                }
                Err(error) => entry.state = EntryState::Failed(error.to_string()),
            }
        }
        each(&entry, outcome.as_ref());
        entries.push(entry);
    }
    entries.sort_by(Entry::order);
    if let Some(folder) = &job.html {
        let page = index_page(&test.display().to_string(), &reference.display().to_string(), &entries);
        write_page(&folder.join("index.html"), &page)?;
    }
    Ok(entries)
}

/// Approves every image of a directory; references without a test image stay as they are. Returns the names.
///
/// Everything is refused if one limit would become looser, before anything is written.
pub fn approve_directory(
    test: &Path,
    reference: &Path,
    approval: &Approval,
) -> Result<Vec<PathBuf>, DiffError> {
    let names: Vec<PathBuf> = images(test)?.into_iter().collect();
    for name in &names {
        crate::certificate::check_approval(&test.join(name), &reference.join(name), approval)?;
    }
    for name in &names {
        let target = reference.join(name);
        if let Some(folder) = target.parent() {
            std::fs::create_dir_all(folder).map_err(|error| DiffError::io(folder, error))?;
        }
        approve(&test.join(name), &target, approval)?;
    }
    Ok(names)
}

/// Paths of the images below a folder, relative to it.
fn images(folder: &Path) -> Result<BTreeSet<PathBuf>, DiffError> {
    let mut found = BTreeSet::new();
    collect(folder, Path::new(""), DEPTH, &mut found)?;
    Ok(found)
}

fn collect(root: &Path, below: &Path, depth: usize, found: &mut BTreeSet<PathBuf>) -> Result<(), DiffError> {
    let folder = root.join(below);
    let entries = std::fs::read_dir(&folder).map_err(|error| DiffError::io(&folder, error))?;
    for entry in entries {
        let entry = entry.map_err(|error| DiffError::io(&folder, error))?;
        let name = below.join(entry.file_name());
        let path = root.join(&name);
        if entry.file_name().to_string_lossy().starts_with('.') {
            continue;
        }
        if path.is_dir() {
            if depth > 0 {
                collect(root, &name, depth - 1, found)?;
            }
        } else if name
            .extension()
            .is_some_and(|e| EXTENSIONS.iter().any(|known| e.eq_ignore_ascii_case(known)))
        {
            found.insert(name);
        }
    }
    Ok(())
}
