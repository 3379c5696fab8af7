//! `catoptric diff` from outside: exit codes, limits files, approval, directories, hostile files.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use catoptric_image::{Channel, Image};

fn diff(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_catoptric"));
    command.arg("diff").args(arguments).output().expect("the binary runs")
}

fn code(arguments: &[&str]) -> i32 {
    diff(arguments).status.code().expect("an exit code")
}

fn text(path: &Path) -> &str {
    path.to_str().expect("UTF-8")
}

/// Writes a flat grey image with a `direct` layer.
fn write(path: &Path, light: f32) {
    let pixels = vec![[light; 3]; 32 * 24];
    let mut image = Image::from_rgb(32, 24, &pixels);
    image.push_rgb_layer("direct", &pixels);
    image.attributes.insert("software".into(), "test".into());
    image.write_exr(path).expect("written");
}

struct Files {
    folder: tempfile::TempDir,
}

impl Files {
    fn new() -> Files {
        Files { folder: tempfile::tempdir().expect("a folder") }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn image(&self, name: &str, light: f32) -> PathBuf {
        let path = self.path(name);
        std::fs::create_dir_all(path.parent().expect("a folder")).expect("made");
        write(&path, light);
        path
    }
}

#[test]
fn exit_codes_are_0_within_1_outside_2_not_compared() {
    let files = Files::new();
    let (a, b) = (files.image("a.exr", 0.5), files.image("b.exr", 0.51));
    let (a, b) = (text(&a), text(&b));
    assert_eq!(code(&[a, a]), 0);
    assert_eq!(code(&[a, b]), 1);
    assert_eq!(code(&[a, b, "--max", "relMSE=1e-3", "--max", "lum_ratio=0.05", "--min", "SSIM=0.9"]), 0);
    assert_eq!(code(&[a, b, "--max", "lum_ratio=0.01"]), 1);
    assert_eq!(code(&[a, b, "--max", "p99.5_rel=0.03", "--max", "direct:MSE=1"]), 0);
    assert_eq!(code(&[a, b, "--max", "p99.5_rel=0.01"]), 1);
    for wrong in [
        &[a, "missing.exr"][..],
        &[a, b, "--max", "relMSE"],
        &[a, b, "--max", "nonsense=1"],
        &[a, b, "--max", "PSNR=3"],
        &[a, b, "--max", "indirect:MSE=1"],
        &[a, b, "--layer", "indirect"],
        &[a, b, "--crop", "30,0,8,8"],
        &[a, b, "--explained-by-noise"],
        &[a],
    ] {
        assert_eq!(code(wrong), 2, "{wrong:?}");
    }
    let small = files.path("small.exr");
    Image::from_rgb(2, 2, &[[0.5; 3]; 4]).write_exr(&small).expect("written");
    let output = diff(&[text(&small), b]);
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("[2, 2]"), "{output:?}");
}

#[test]
fn images_are_not_equal_by_what_one_of_them_does_not_hold() {
    let files = Files::new();
    let with = |name: &str, hole: f32, depth: f32| {
        let mut image = Image::from_rgb(8, 8, &[[0.5; 3]; 64]);
        image.channels[0].samples[9] = hole;
        image.channels.push(Channel { name: "depth.Z".into(), samples: vec![depth; 64] });
        let path = files.path(name);
        image.write_exr(&path).expect("written");
        path
    };
    let whole = with("whole.exr", 0.5, 1.0);
    let (holed, farther) = (with("holed.exr", f32::NAN, 1.0), with("farther.exr", 0.5, 3.0));
    assert_eq!(code(&[text(&holed), text(&holed)]), 0);
    assert_eq!(code(&[text(&whole), text(&holed)]), 1);
    assert_eq!(code(&[text(&whole), text(&farther)]), 1);
    assert_eq!(code(&[text(&whole), text(&farther), "--max", "relMSE=0"]), 0, "a limit of the beauty");
    let nothing = files.image("nothing.exr", f32::NAN);
    let grey = files.image("grey.exr", 0.5);
    assert_eq!(code(&[text(&grey), text(&nothing)]), 2);
    assert_eq!(code(&[text(&grey), text(&nothing), "--max", "relMSE=1"]), 2);
}

#[test]
fn a_report_overwrites_no_input() {
    let files = Files::new();
    let (a, b) = (files.image("a.exr", 0.5), files.image("b.exr", 0.5));
    let before = std::fs::read(&b).expect("it is there");
    assert_eq!(code(&[text(&a), text(&b), "--html", text(&files.path("./b.exr"))]), 2);
    assert_eq!(std::fs::read(&b).expect("it is there"), before);
}

#[test]
fn approval_knows_the_names_of_limits() {
    let files = Files::new();
    let (a, b) = (files.image("a.exr", 0.5), files.path("b.exr"));
    assert_eq!(code(&[text(&a), text(&b), "--approve", "--max", "foo=1"]), 2);
    assert!(!b.exists());
    assert_eq!(code(&[text(&a), text(&b), "--approve", "--max", "p99.9_rel=1", "--max", "direct:MSE=1"]), 0);
}

#[cfg(target_os = "linux")]
#[test]
fn streams_that_take_nothing_are_no_panic() {
    let files = Files::new();
    let a = files.image("a.exr", 0.5);
    let run = |out: &str, err: &str, arguments: &[&str]| {
        let stream = |path: &str| std::fs::OpenOptions::new().write(true).open(path).expect("Linux has it");
        let mut command = Command::new(env!("CARGO_BIN_EXE_catoptric"));
        command
            .args(arguments)
            .stdout(stream(out))
            .stderr(stream(err))
            .status()
            .expect("the binary runs")
            .code()
    };
    assert_eq!(run("/dev/full", "/dev/null", &["diff", text(&a), text(&a)]), Some(2));
    assert_eq!(run("/dev/null", "/dev/full", &["diff", text(&a), "missing.exr"]), Some(2));
    assert_eq!(run("/dev/null", "/dev/full", &["info", "missing.glb"]), Some(1));
}

#[test]
fn json_has_the_numbers_of_every_layer() {
    let files = Files::new();
    let (a, b) = (files.image("a.exr", 0.5), files.image("b.exr", 0.25));
    let output = diff(&[text(&a), text(&b), "--json"]);
    let value: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(value["verdict"], "outside");
    assert_eq!(value["layers"][0]["metrics"]["lum_ratio"], 2.0);
    assert_eq!(value["layers"][1]["layer"], "direct");
    assert_eq!(value["layers"][1]["metrics"]["MSE"], 0.0625);
}

#[test]
fn limits_lie_beside_the_reference() {
    let files = Files::new();
    let (a, b) = (files.image("a.exr", 0.5), files.image("b.exr", 0.51));
    std::fs::write(files.path("b.limits.json"), r#"{"max": {"relMSE": 1e-3}}"#).expect("written");
    assert_eq!(code(&[text(&a), text(&b)]), 0);
    assert_eq!(code(&[text(&a), text(&b), "--max", "relMSE=1e-9"]), 1);
    std::fs::write(files.path("b.limits.json"), r#"{"maximum": {}}"#).expect("written");
    assert_eq!(code(&[text(&a), text(&b)]), 2);
}

#[test]
fn approval_writes_a_certificate_and_does_not_loosen_silently() {
    let files = Files::new();
    let (a, b) = (files.image("a.exr", 0.5), files.image("ref/b.exr", 0.51));
    let (a, b) = (text(&a), text(&b));
    assert_eq!(code(&[a, b, "--approve", "--max", "relMSE=1e-4", "--note", "first"]), 0);
    assert_eq!(std::fs::read(a).expect("a"), std::fs::read(b).expect("b"));
    let certificate = || -> serde_json::Value {
        serde_json::from_slice(&std::fs::read(files.path("ref/b.json")).expect("a certificate"))
            .expect("JSON")
    };
    assert_eq!(certificate()["limits"]["max"]["relMSE"], 1e-4);
    assert_eq!(certificate()["software"], "test");
    assert_eq!(certificate()["note"], "first");

    let brighter = files.image("c.exr", 0.8);
    let before = std::fs::read(b).expect("b");
    assert_eq!(code(&[text(&brighter), b]), 1);
    assert_eq!(code(&[text(&brighter), b, "--approve", "--max", "relMSE=1"]), 2);
    assert_eq!(std::fs::read(b).expect("b"), before, "a refused approval changed the reference");
    assert_eq!(code(&[text(&brighter), b, "--approve", "--max", "relMSE=1", "--loosen"]), 0);
    assert_eq!(certificate()["limits"]["max"]["relMSE"], 1.0);
    assert_eq!(code(&[text(&brighter), b]), 0);
}

#[test]
fn directories_are_paired_by_name_and_indexed_worst_first() {
    let files = Files::new();
    for (name, light) in [("out/good #1.exr", 0.5), ("out/sub/bad.exr", 0.9), ("out/extra.exr", 0.5)] {
        files.image(name, light);
    }
    for (name, light) in [("ref/good #1.exr", 0.5), ("ref/sub/bad.exr", 0.5), ("ref/missing.exr", 0.5)] {
        files.image(name, light);
    }
    let (out, reference, report) = (files.path("out"), files.path("ref"), files.path("report"));
    let output = diff(&[text(&out), text(&reference), "--html", text(&report)]);
    assert_eq!(output.status.code(), Some(1));
    let index = std::fs::read_to_string(report.join("index.html")).expect("an index");
    let position = |name: &str| index.find(&format!("{name}</")).unwrap_or_else(|| panic!("no {name}"));
    assert!(position("missing.exr") < position("extra.exr"));
    assert!(position("extra.exr") < position("sub/bad.exr"));
    assert!(position("sub/bad.exr") < position("good #1.exr"));
    assert!(report.join("sub/bad.exr.html").is_file());
    assert!(index.contains("href=\"./sub/bad.exr.html\""));
    assert!(report.join("good #1.exr.html").is_file());
    assert!(index.contains("href=\"./good%20%231.exr.html\""));

    std::fs::write(out.join("good #1.exr"), b"damaged").expect("written");
    assert_eq!(code(&[text(&out), text(&reference)]), 2);
}

#[test]
fn pictures_are_written() {
    let files = Files::new();
    let (a, b) = (files.image("a.exr", 0.5), files.image("b.exr", 0.25));
    let folder = files.path("pictures");
    assert_eq!(code(&[text(&a), text(&b), "--pictures", text(&folder)]), 1);
    for name in ["flip", "relative", "signed", "side-by-side", "worst", "histogram", "direct-flip"] {
        assert!(folder.join(format!("{name}.png")).is_file(), "{name}");
    }
}

#[test]
fn hostile_files_end_with_code_2_and_a_message() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../catoptric-image/tests/data/invalid");
    let mut seen = 0;
    for entry in std::fs::read_dir(folder).expect("in the repository") {
        let path = entry.expect("readable").path();
        let output = diff(&[text(&path), text(&path)]);
        assert_eq!(output.status.code(), Some(2), "{path:?}: {output:?}");
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(message.starts_with("catoptric diff: ") && !message.contains("panicked"), "{message}");
        seen += 1;
    }
    assert!(seen > 50);
}
