//! Who may use whom: the table of ARCHITECTURE.md over `cargo metadata`, and what each crate says that it does not know.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::process::Command;

use serde_json::Value;

/// Each crate and the crates of the workspace that it may name. What these may name is allowed as well: who traces may
/// speak of the scene that is traced.
const MAY_USE: [(&str, &[&str]); 9] = [
    ("catoptric-image", &[]),
    ("catoptric-scene", &["catoptric-image"]),
    ("catoptric-trace", &["catoptric-scene"]),
    ("catoptric-light", &["catoptric-trace"]),
    ("catoptric-solution", &["catoptric-scene"]),
    ("catoptric-radiosity", &["catoptric-light", "catoptric-solution"]),
    ("catoptric-render", &["catoptric-light", "catoptric-solution", "catoptric-image"]),
    ("catoptric-diff", &["catoptric-image"]),
    ("catoptric", &["catoptric-radiosity", "catoptric-render", "catoptric-diff"]),
];

/// The sentences "does not know": these hold over any number of steps.
const MUST_NOT_KNOW: [(&str, &str); 10] = [
    ("catoptric-image", "catoptric-scene"),
    ("catoptric-scene", "catoptric-trace"),
    ("catoptric-trace", "catoptric-solution"),
    ("catoptric-light", "catoptric-radiosity"),
    ("catoptric-light", "catoptric-solution"),
    ("catoptric-solution", "catoptric-trace"),
    ("catoptric-radiosity", "catoptric-render"),
    ("catoptric-render", "catoptric-radiosity"),
    ("catoptric-diff", "catoptric-scene"),
    ("catoptric-diff", "catoptric-render"),
];

/// What each crate says of itself, in ARCHITECTURE.md and in the head of its `lib.rs`.
const DOES_NOT_KNOW: [(&str, &str); 8] = [
    ("catoptric-image", "does not know how an image was rendered"),
    ("catoptric-scene", "does not know patches, rays or trees"),
    ("catoptric-trace", "does not know patches, meshes for display, solvers or cameras"),
    ("catoptric-light", "does not know patches, meshes or cameras"),
    ("catoptric-solution", "does not know rays or solvers"),
    ("catoptric-radiosity", "does not know cameras or images"),
    ("catoptric-render", "does not know form factor methods or solvers"),
    ("catoptric-diff", "knows nothing of scenes"),
];

/// Crates from outside that only one of ours may name: nobody else knows the file format.
const ONLY: [(&str, &str); 4] = [
    ("gltf", "catoptric-scene"),
    ("exr", "catoptric-image"),
    ("obvhs", "catoptric-trace"),
    ("clap", "catoptric"),
];

/// Packages around the program: they may use everything, and nothing uses them.
const OUTSIDE: [&str; 2] = ["catoptric-tests", "catoptric-benches"];

/// Normal and build dependencies by crate of the workspace. Unit tests may use what they like.
fn dependencies() -> BTreeMap<String, BTreeSet<String>> {
    let output = Command::new(env!("CARGO"))
        .args(["metadata", "--format-version", "1", "--no-deps", "--offline"])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .expect("cargo runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let metadata: Value = serde_json::from_slice(&output.stdout).expect("cargo metadata is JSON");
    let text = |value: &Value| value["name"].as_str().unwrap_or_default().to_owned();
    let packages = metadata["packages"].as_array().expect("packages");
    packages
        .iter()
        .map(|package| {
            let uses = package["dependencies"].as_array().expect("dependencies").iter();
            (text(package), uses.filter(|d| d["kind"].as_str() != Some("dev")).map(text).collect())
        })
        .filter(|(name, _)| !OUTSIDE.contains(&name.as_str()))
        .collect()
}

/// Everything that `from` may name.
fn reachable<'a>(from: &str, table: &BTreeMap<&'a str, &[&'a str]>) -> BTreeSet<&'a str> {
    let mut found = BTreeSet::new();
    let mut open = table.get(from).map_or(Vec::new(), |uses| uses.to_vec());
    while let Some(next) = open.pop() {
        if found.insert(next) {
            open.extend(table.get(next).into_iter().flat_map(|uses| uses.iter()));
        }
    }
    found
}

#[test]
fn crates_use_only_what_the_table_allows() {
    let (table, found) = (BTreeMap::from(MAY_USE), dependencies());
    assert_eq!(found.len(), table.len(), "the table names every crate: {:?}", found.keys());
    for (name, uses) in &found {
        let allowed = reachable(name, &table);
        for used in uses.iter().filter(|used| found.contains_key(*used) || OUTSIDE.contains(&used.as_str())) {
            assert!(allowed.contains(used.as_str()), "{name} must not use {used}; it may use {allowed:?}");
        }
    }
}

#[test]
fn the_table_keeps_the_sentences() {
    let table = BTreeMap::from(MAY_USE);
    for (name, stranger) in MUST_NOT_KNOW {
        assert!(!reachable(name, &table).contains(stranger), "{name} would know {stranger}");
    }
    let everything: BTreeSet<&str> = table.keys().copied().filter(|name| *name != "catoptric").collect();
    assert_eq!(reachable("catoptric", &table), everything, "the command line may use all");
}

#[test]
fn the_map_and_the_crates_say_what_they_do_not_know() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let read = |path: &str| std::fs::read_to_string(root.join(path)).expect("a file of the workspace");
    let map = read("ARCHITECTURE.md");
    for (name, sentence) in DOES_NOT_KNOW {
        let row = map.lines().find(|line| line.starts_with(&format!("| `{name}` |")));
        let row = row.unwrap_or_else(|| panic!("ARCHITECTURE.md has no row for {name}"));
        assert!(row.contains(sentence), "ARCHITECTURE.md, {name}: expected \"{sentence}\"");
        let head = read(&format!("crates/{name}/src/lib.rs"));
        let head: Vec<&str> =
            head.lines().filter_map(|line| line.strip_prefix("//!")).map(str::trim).collect();
        let head = head.join(" ").to_lowercase();
        assert!(head.contains(sentence), "crates/{name}/src/lib.rs: expected \"{sentence}\" in its head");
    }
}

#[test]
fn file_formats_are_known_in_one_place() {
    for (name, uses) in dependencies() {
        for (foreign, owner) in ONLY {
            assert!(name == owner || !uses.contains(foreign), "{name} uses {foreign}; only {owner} may");
        }
    }
}
