//! The page over a directory of comparisons, worst first.

use std::fmt::Write;

use super::{STYLE, escape, number};

/// What became of one name.
#[derive(Clone, Debug, PartialEq)]
pub enum EntryState {
    /// Compared; all limits hold.
    Within,
    /// Compared; a limit is broken.
    Outside,
    /// Only the reference exists.
    Missing,
    /// Only the test image exists.
    Extra,
    /// It could not be compared, and why.
    Failed(String),
}

/// One line of the index.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// Path below the two folders.
    pub name: String,
    /// What became of it.
    pub state: EntryState,
    /// Mean FLIP, relMSE and luminance ratio of the beauty, where it was compared.
    pub numbers: Option<[f64; 3]>,
    /// The report, relative to the index.
    pub report: Option<String>,
}

impl Entry {
    /// Worst first: what could not be compared, what is missing or extra, then by broken limits and FLIP.
    pub fn order(&self, other: &Entry) -> std::cmp::Ordering {
        let rank = |entry: &Entry| match entry.state {
            EntryState::Failed(_) => 0,
            EntryState::Missing => 1,
            EntryState::Extra => 2,
            EntryState::Outside => 3,
            EntryState::Within => 4,
        };
        let flip = |entry: &Entry| entry.numbers.map_or(f64::INFINITY, |n| n[0]);
        rank(self)
            .cmp(&rank(other))
            .then(flip(other).total_cmp(&flip(self)))
            .then_with(|| self.name.cmp(&other.name))
    }
}

/// The page; entries are sorted.
pub fn index_page(test: &str, reference: &str, entries: &[Entry]) -> String {
    let mut sorted: Vec<&Entry> = entries.iter().collect();
    sorted.sort_by(|a, b| a.order(b));
    let mut rows = String::new();
    for entry in sorted {
        let (class, word) = match &entry.state {
            EntryState::Within => ("good", "within limits".to_owned()),
            EntryState::Outside => ("bad", "outside limits".to_owned()),
            EntryState::Missing => ("bad", "missing: only the reference exists".to_owned()),
            EntryState::Extra => ("bad", "extra: no reference".to_owned()),
            EntryState::Failed(reason) => ("bad", format!("not compared: {reason}")),
        };
        let name = match &entry.report {
            Some(report) => format!("<a href=\"{}\">{}</a>", link(report), escape(&entry.name)),
            None => escape(&entry.name),
        };
        let numbers: String = match entry.numbers {
            Some(numbers) => {
                numbers.iter().map(|&n| format!("<td class=\"number\">{}</td>", number(n))).collect()
            }
            None => "<td></td><td></td><td></td>".to_owned(),
        };
        let _ = write!(
            rows,
            "<tr class=\"{class}\"><th scope=\"row\">{name}</th><td>{}</td>{numbers}</tr>",
            escape(&word)
        );
    }
    let failures = entries.iter().filter(|e| e.state != EntryState::Within).count();
    format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\">\
         <title>{test} against {reference}</title><style>{STYLE}</style></head><body><header><h1>{test} <small>against</small> {reference}</h1>\
         <p class=\"verdict {}\">{failures} of {} fail</p></header><main><table><caption>Images, worst first</caption><thead><tr>\
         <th scope=\"col\">image</th><th scope=\"col\">verdict</th><th scope=\"col\">FLIP</th><th scope=\"col\">relMSE</th>\
         <th scope=\"col\">lum_ratio</th></tr></thead><tbody>{rows}</tbody></table></main></body></html>\n",
        if failures == 0 { "good" } else { "bad" },
        entries.len(),
        test = escape(test),
        reference = escape(reference),
    )
}

/// A reference to a file below the page (RFC 3986, section 4.2): `#`, `?`, `%` and spaces of its name are no syntax, nor is a colon a scheme.
fn link(path: &str) -> String {
    let mut link = String::from("./");
    for byte in path.bytes() {
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'-' | b'.' | b'_' | b'~' | b'/' => {
                link.push(char::from(byte));
            }
            _ => {
                let _ = write!(link, "%{byte:02X}");
            }
        }
    }
    link
}
