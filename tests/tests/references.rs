//! Every source that a comment cites is listed in docs/references.md.

use std::path::{Path, PathBuf};

/// All Rust sources below a folder.
fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).expect("a folder of the workspace can be read") {
        let path = entry.expect("its entries, too").path();
        if path.is_dir() {
            sources(&path, found);
        } else if path.extension().is_some_and(|e| e == "rs") {
            found.push(path);
        }
    }
}

/// Citations in a line of comment: a capitalised word and the year after it, as in "Walter et al. 2005".
fn citations(comment: &str) -> Vec<(String, String)> {
    let words: Vec<&str> = comment.split_whitespace().filter(|w| !["et", "al."].contains(w)).collect();
    let plain = |word: &str| word.trim_matches(|c: char| !c.is_alphanumeric()).to_owned();
    let is_year =
        |word: &str| word.len() == 4 && word.parse::<u32>().is_ok_and(|year| (1700..2100).contains(&year));
    words
        .windows(2)
        // A sentence that ends before the number does not cite.
        .filter(|pair| {
            !pair[0].ends_with(['.', ':', ';', '|']) && pair[0].trim_end_matches([',', '\'']).len() > 1
        })
        .map(|pair| (plain(pair[0]), plain(pair[1])))
        .filter(|(name, year)| name.chars().next().is_some_and(char::is_uppercase) && is_year(year))
        .collect()
}

#[test]
fn every_citation_is_listed() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let list = std::fs::read_to_string(root.join("docs/references.md")).expect("docs/references.md");
    let (mut files, mut missing) = (Vec::new(), Vec::new());
    sources(&root.join("crates"), &mut files);
    sources(&root.join("tests"), &mut files);
    files.sort();
    for file in &files {
        let text = std::fs::read_to_string(file).expect("sources are UTF-8");
        for comment in text.lines().filter_map(|line| Some(line.split_once("//")?.1)) {
            for (name, year) in citations(comment) {
                if !list.lines().any(|entry| entry.contains(&name) && entry.contains(&year)) {
                    missing.push(format!("{}: {name} {year}", file.display()));
                }
            }
        }
    }
    assert!(missing.is_empty(), "add to docs/references.md:\n{}", missing.join("\n"));
}

#[test]
fn citations_are_found_in_the_ways_they_are_written() {
    let pair = |name: &str, year: &str| (name.to_owned(), year.to_owned());
    assert_eq!(citations(" A light tree (Walter et al. 2005)."), [pair("Walter", "2005")]);
    assert_eq!(citations(" Bank, Sherman & Weiser 1983: red"), [pair("Weiser", "1983")]);
    assert_eq!(
        citations(" Source: Lambert 1760; Baum & Winget 1989, eq. 10"),
        [pair("Lambert", "1760"), pair("Winget", "1989")]
    );
    assert!(citations(" 0..2000 and 1983 vertices").is_empty());
}
