//! Form factor methods and solvers from the command line.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use serde_json::Value;

use crate::support::Bench;

fn scene(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../scenes/{name}.glb"));
    path.to_str().expect("UTF-8").to_owned()
}

/// (from, to) → F_r of a table.
fn table(text: &str) -> BTreeMap<(String, String), f64> {
    let mut lines = text.lines();
    assert_eq!(lines.next(), Some("from,to,F_r,F_g,F_b,area_from"));
    lines
        .map(|line| {
            let fields: Vec<&str> = line.split(',').collect();
            assert_eq!(fields.len(), 6, "{line}");
            let numbers: Vec<f64> = fields[2..].iter().map(|f| f.parse().expect("a number")).collect();
            assert!(numbers.iter().all(|n| n.is_finite() && *n >= 0.0), "{line}");
            ((fields[0].to_owned(), fields[1].to_owned()), numbers[0])
        })
        .collect()
}

#[test]
fn form_factors_of_a_closed_room_sum_to_one_by_every_method() {
    let bench = Bench::new();
    let room = scene("furnace_box");
    for method in ["rays", "hemicube", "area", "analytic"] {
        let by = ["--method", method, "--plain", "--rays", "256", "--json"];
        let run = bench.run(&[&["form-factors", &room, "-o", "F.csv"], &by[..]].concat());
        assert_eq!(run.code, 0, "{}", run.stderr);
        let factors = table(&fs::read_to_string(bench.path("F.csv")).expect("it was written"));
        let names: std::collections::BTreeSet<&String> = factors.keys().map(|k| &k.0).collect();
        assert_eq!(factors.len(), names.len() * names.len(), "zeros are written for few surfaces");
        assert!(run.stderr.contains("reciprocity: worst"), "{}", run.stderr);
        let report: Value = serde_json::from_str(&run.stdout).expect("JSON");
        let error = report["largest_error"].as_f64().expect("a number");
        for name in &names {
            let sum: f64 = factors.iter().filter(|f| &f.0.0 == *name).map(|f| f.1).sum();
            // A row of a closed room is a whole, and sampled only in who gets how much; pairs of points do not know that:
            // Student's t with 15 degrees of freedom leaves 1e-4 beyond 5.2.
            let bar = if method == "area" { 5.2 * error * names.len() as f64 } else { 1e-4 };
            assert!((sum - 1.0).abs() < bar, "{method}: {name} sums to {sum}");
        }
    }
}

#[test]
fn the_report_of_form_factors_accounts_for_all_power() {
    let bench = Bench::new();
    let run = bench.run(&["form-factors", "scene.gltf", "-o", "F.csv", "--rays", "256", "--json"]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let report: Value = serde_json::from_str(&run.stdout).expect("JSON");
    for row in report["rows"].as_array().expect("rows") {
        let share = |key: &str| row[key][0].as_f64().expect("a number");
        let booked =
            ["arrived", "absorbed_by_mirrors_and_glass", "black_backs", "escaped", "cut_off", "roulette"];
        let sum: f64 = booked.iter().map(|key| share(key)).sum();
        // Shares are sums of thousands of f32 throughputs.
        assert!((sum - 1.0).abs() < 1e-4, "{row}: {sum}");
    }
    // A floor, a lamp and a mirror in the open.
    assert!(run.stderr.contains("the scene is open"), "{}", run.stderr);
    assert!(report["warnings"].to_string().contains("open"));
}

#[test]
fn mirrors_add_form_factors_and_plain_ones_leave_them_out() {
    let bench = Bench::new();
    let factor = |more: &[&str]| {
        let run =
            bench.run(&[&["form-factors", "scene.gltf", "-o", "F.csv", "--rays", "1024"], more].concat());
        assert_eq!(run.code, 0, "{}", run.stderr);
        let factors = table(&fs::read_to_string(bench.path("F.csv")).expect("it was written"));
        (
            factors[&("Lamp".to_owned(), "Floor".to_owned())],
            factors[&("Floor".to_owned(), "Floor".to_owned())],
        )
    };
    let (extended, plain) = (factor(&[]), factor(&["--plain"]));
    // The mirror stands upright on the floor's edge: the lamp lights more of the floor; the floor's image lies in its own
    // plane and sends nothing.
    assert!(extended.0 > plain.0 + 0.01, "{extended:?} {plain:?}");
    assert!(extended.1 == 0.0 && plain.1 == 0.0, "{extended:?} {plain:?}");
}

#[test]
fn repair_restores_reciprocity_and_says_what_it_moved() {
    let bench = Bench::new();
    let room = scene("furnace_box");
    let run = bench.run(&[
        "form-factors",
        &room,
        "-o",
        "F.csv",
        "--by",
        "patch",
        "--patches",
        "60",
        "--repair",
        "--json",
        "r.json",
    ]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let report: Value =
        serde_json::from_slice(&fs::read(bench.path("r.json")).expect("it was written")).expect("JSON");
    let number = |value: &Value| value.as_f64().expect("a number");
    assert!(number(&report["repair"]["largest_change"]) > 0.0);
    assert!(number(&report["worst_reciprocity"]) < 1e-12);
    // A closed room: every row sums to 1 again, within the repair's own tolerance.
    for row in report["rows"].as_array().expect("rows") {
        assert!((number(&row["row_sum"][0]) - 1.0).abs() < 1e-9, "{row}");
    }
}

#[test]
fn tinted_mirrors_give_one_npz_per_channel_and_gray_ones_a_single_file() {
    let bench = Bench::new();
    let run = bench.run(&["form-factors", "scene.gltf", "-o", "F.npz", "--rays", "64"]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    for name in ["F.r.npz", "F.g.npz", "F.b.npz"] {
        let bytes = fs::read(bench.path(name)).expect("it was written");
        assert!(bytes.starts_with(b"PK\x03\x04"), "{name} is no zip archive");
    }
    let run = bench.run(&["form-factors", "scene.gltf", "-o", "P.npz", "--rays", "64", "--plain"]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    assert!(bench.path("P.npz").is_file() && !bench.path("P.r.npz").exists());
}

#[test]
fn form_factors_have_the_same_bytes_with_any_number_of_threads() {
    let bench = Bench::new();
    let room = scene("cornell_mirror");
    let bytes = |threads: &str| {
        let by = ["--rays", "8", "--by", "patch", "--patches", "50", "--threads", threads];
        let run = bench.run(&[&["form-factors", &room, "-o", "F.csv"], &by[..]].concat());
        assert_eq!(run.code, 0, "{}", run.stderr);
        fs::read(bench.path("F.csv")).expect("it was written")
    };
    let one = bytes("1");
    assert!(one == bytes("2") && one == bytes("3"));
}

#[test]
fn form_factors_that_cannot_be_are_refused_with_a_hint() {
    let bench = Bench::new();
    bench.run(&["form-factors", "scene.gltf"]).fails_with(2, &["no output", "F.csv"]);
    bench.run(&["form-factors", "scene.gltf", "-o", "F.txt"]).fails_with(2, &["F.txt", ".npz"]);
    bench
        .run(&["form-factors", "scene.gltf", "-o", "F.csv", "--method", "magic"])
        .fails_with(2, &["magic", "hemicube", "analytic"]);
    bench.run(&["form-factors", "scene.gltf", "-o", "no/F.csv"]).fails_with(1, &["no/F.csv", "mkdir"]);
    bench.run(&["form-factors", "absent.glb", "-o", "F.csv"]).fails_with(1, &["absent.glb", "no such file"]);
}

fn solve(bench: &Bench, arguments: &[&str]) -> Value {
    let common = ["solve", "scene.gltf", "-o", "solved.glb", "--quality", "draft", "--json"];
    let run = bench.run(&[&common, arguments].concat());
    assert_eq!(run.code, 0, "{}", run.stderr);
    serde_json::from_str(&run.stdout).expect("JSON")
}

#[test]
fn solve_says_which_method_solver_and_stopping_rule_it_used() {
    let bench = Bench::new();
    let default = solve(&bench, &[]);
    assert_eq!(default["solve"]["solver"], "two-pass");
    assert_eq!(default["solve"]["method"], "rays");
    assert_eq!(default["solve"]["stop"], "residual");
    assert!(default["settings"].get("solver").is_none());
    for (solver, stop) in [
        ("direct", "exact"),
        ("jacobi", "residual"),
        ("gauss-seidel", "residual"),
        ("southwell", "unshot power"),
        ("southwell-unordered", "unshot power"),
        ("progressive", "unshot power"),
    ] {
        let report = solve(&bench, &["--solver", solver]);
        assert_eq!(report["solve"]["solver"], solver);
        assert_eq!(report["solve"]["stop"], stop, "{solver}");
        assert_eq!(report["settings"]["solver"], solver);
    }
    let report = solve(&bench, &["--solver", "jacobi", "--max-steps", "1", "--method", "hemicube"]);
    assert_eq!(report["solve"]["stop"], "steps");
    assert_eq!(report["solve"]["iterations"], 1);
    assert_eq!(report["solve"]["method"], "hemicube");
}

#[test]
fn snapshots_show_the_light_as_it_spreads_with_and_without_the_ambient_term() {
    let bench = Bench::new();
    let room = scene("cornell_mirror");
    let run = bench.run(&[
        "solve",
        &room,
        "-o",
        "solved.glb",
        "--quality",
        "draft",
        "--json",
        "--solver",
        "progressive",
        "--every",
        "5",
        "--snapshot",
        "steps",
        "--snapshot-size",
        "24",
        "--max-steps",
        "10",
    ]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let report: Value = serde_json::from_str(&run.stdout).expect("JSON");
    let listed: Vec<&str> =
        report["outputs"].as_array().expect("outputs").iter().filter_map(Value::as_str).collect();
    let distinct: std::collections::BTreeSet<&&str> = listed.iter().collect();
    assert_eq!(distinct.len(), listed.len(), "{listed:?}");
    for name in ["steps/step.000005.png", "steps/step.000005.ambient.png", "steps/step.000010.png"] {
        assert!(bench.path(name).is_file() && listed.contains(&name), "{name} is missing: {listed:?}");
    }
    let bytes = |name: &str| fs::read(bench.path(name)).expect("it was written");
    assert!(bytes("steps/step.000005.png") != bytes("steps/step.000005.ambient.png"));
    bench.run(&["solve", "scene.gltf", "-o", "solved.glb", "--every", "5"]).fails_with(2, &["--snapshot"]);
}

#[test]
fn the_last_snapshot_is_the_solution_by_every_solver() {
    for solver in [&["--solver", "jacobi"][..], &["--solver", "progressive"], &[]] {
        let bench = Bench::new();
        let report = solve(&bench, &[solver, &["--every", "1000000", "--snapshot", "steps"]].concat());
        let steps = report["solve"]["iterations"].as_u64().expect("a number");
        assert!(bench.path(&format!("steps/step.{steps:06}.png")).is_file(), "{solver:?}: {report}");
    }
}

#[test]
fn a_solve_can_start_from_an_earlier_one() {
    let bench = Bench::new();
    let cold = solve(&bench, &["--solver", "jacobi"]);
    fs::rename(bench.path("solved.glb"), bench.path("earlier.glb")).expect("it was written");
    let warm = solve(&bench, &["--solver", "jacobi", "--warm", "earlier.glb"]);
    let steps = |report: &Value| report["solve"]["iterations"].as_u64().expect("a number");
    assert!(steps(&warm) < steps(&cold), "{} steps after {}", steps(&warm), steps(&cold));
    let refused = |file: &str| bench.run(&["solve", "scene.gltf", "-o", "s.glb", "--warm", file]);
    refused("scene.gltf").fails_with(1, &["--warm", "no solution"]);
    // Standard quality has more patches than the draft that `earlier.glb` is.
    refused("earlier.glb").fails_with(1, &["--warm", "patches", "--quality"]);
}

#[test]
fn the_classical_pictures_are_made_by_name() {
    let bench = Bench::new();
    let room = scene("cornell_box");
    let render = |more: &[&str]| {
        let common = ["render", &room, "-o", "out.pfm", "--size", "48", "--json"];
        let quality: &[&str] = if more.contains(&"--quality") { &[] } else { &["--quality", "draft"] };
        let run = bench.run(&[&common, quality, more].concat());
        assert_eq!(run.code, 0, "{}", run.stderr);
        let report: Value = serde_json::from_str(&run.stdout).expect("JSON");
        (fs::read(bench.path("out.pfm")).expect("it was written"), report)
    };
    let (gathered, report) = render(&[]);
    assert!(report["settings"].get("reconstruct").is_none());
    let mut pictures = vec![gathered];
    for (word, arguments) in [
        ("averaged", ["--reconstruct", "averaged"]),
        ("extrapolated", ["--reconstruct", "extrapolated"]),
        ("flat", ["--shading", "flat"]),
    ] {
        let (picture, report) = render(&arguments);
        assert_eq!(report["settings"]["reconstruct"], word);
        assert!(report["solve"]["rays"].get("gather").is_none(), "{word} gathers");
        assert!(!pictures.contains(&picture), "{word} shows what another rule shows");
        pictures.push(picture);
    }
    // They show patches, at any quality: nothing is evaluated beside them unless it is asked for.
    let classical = |direct: &[&str]| {
        render(&[&["--reconstruct", "averaged", "--quality", "standard"], direct].concat()).0
    };
    let shown = classical(&[]);
    assert!(shown == classical(&["--direct", "vertices"]));
    assert!(shown != classical(&["--direct", "pixels"]));
}

#[test]
fn a_photometric_file_travels_with_the_solution() {
    let bench = Bench::new();
    let lamp = scene("spot_mirror");
    // 100 cd straight ahead and nothing to the side.
    let ies = "IESNA:LM-63-2002\nTILT=NONE\n1 1000 1 3 1 1 2 0 0 0\n1 1 10\n0 45 90\n0\n100 60 0\n";
    fs::write(bench.path("lamp.ies"), ies).expect("a temporary folder that works");
    let run = bench.run(&["info", &lamp, "--json"]);
    let info: Value = serde_json::from_str(&run.stdout).expect("JSON");
    let name = info["lights"][0]["name"].as_str().expect("a light").to_owned();
    let with = format!("{name}=lamp.ies");
    let render = |scene: &str, output: &str, more: &[&str]| {
        let common = ["render", scene, "-o", output, "--quality", "draft", "--size", "32"];
        let run = bench.run(&[&common, more].concat());
        assert_eq!(run.code, 0, "{}", run.stderr);
        fs::read(bench.path(output)).expect("it was written")
    };
    let own = render(&lamp, "own.pfm", &[]);
    let straight = render(&lamp, "straight.pfm", &["--ies", &with]);
    assert!(own != straight);
    let solved = bench.run(&["solve", &lamp, "-o", "solved.glb", "--quality", "draft", "--ies", &with]);
    assert_eq!(solved.code, 0, "{}", solved.stderr);
    fs::remove_file(bench.path("lamp.ies")).expect("it was there");
    assert!(render("solved.glb", "later.pfm", &[]) == straight);
    bench.run(&["render", &lamp, "-o", "x.pfm", "--ies", &with]).fails_with(1, &["--ies", "lamp.ies"]);
    fs::write(bench.path("lamp.ies"), ies).expect("a temporary folder that works");
    bench
        .run(&["render", &lamp, "-o", "x.pfm", "--ies", "Nobody=lamp.ies"])
        .fails_with(1, &["Nobody", &name]);
    bench.run(&["render", &lamp, "-o", "x.pfm", "--ies", "lamp.ies"]).fails_with(2, &["LIGHT=FILE"]);
}
