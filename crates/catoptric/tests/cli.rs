//! The command line from outside: outputs, messages and exit codes of small scenes.

mod methods;
mod support;

use std::fs;

use catoptric_image::{Image, ReadLimits};
use serde_json::Value;
use support::Bench;

/// Everything that a report promises (docs/cli.md).
const REPORT_KEYS: [&str; 12] = [
    "program", "version", "command", "scene", "settings", "seconds", "stages", "solve", "images", "outputs",
    "memory", "warnings",
];

#[test]
fn help_of_every_command_shows_examples_defaults_and_exit_codes() {
    let bench = Bench::new();
    let main = bench.run(&["--help"]);
    assert_eq!(main.code, 0);
    for command in ["render", "solve", "info", "diff", "completions"] {
        assert!(main.stdout.contains(command), "{command} is missing:\n{}", main.stdout);
        let help = bench.run(&[command, "--help"]);
        assert_eq!(help.code, 0);
        assert!(help.stdout.contains("Examples:"), "{command} has no examples:\n{}", help.stdout);
    }
    assert!(main.stdout.contains("130"), "{}", main.stdout);
    let render = bench.run(&["render", "--help"]).stdout;
    for text in
        ["[default: standard]", "[default: 1280]", "[default: 24]", "--solution", "--exposure", "--plain"]
    {
        assert!(render.contains(text), "{text} is missing:\n{render}");
    }
    assert!(bench.run(&["completions", "bash"]).stdout.contains("_catoptric"));
}

#[test]
fn outputs_are_told_apart_by_where_they_lie() {
    let bench = Bench::new();
    let run = bench.render(&["-o", "out.png", "--preview", "./out.png", "--size", "8"]);
    assert_eq!(run.code, 2, "{}", run.stderr);
    assert!(run.stderr.contains("two outputs"), "{}", run.stderr);
}

#[test]
fn options_of_pass_one_do_not_change_light_that_is_there() {
    let bench = Bench::new();
    assert_eq!(bench.run(&["solve", "scene.gltf", "--quality", "draft", "-o", "solved.glb"]).code, 0);
    let view = ["render", "solved.glb", "--size", "8", "-q", "-o", "out.png"];
    assert_eq!(bench.run(&view).code, 0);
    for option in [&["--method", "area"][..], &["--solver", "jacobi"], &["--shading", "flat"]] {
        let run = bench.run(&[&view[..], option].concat());
        assert_eq!(run.code, 2, "{}", run.stderr);
        assert!(run.stderr.contains(option[0]), "{}", run.stderr);
    }
}

#[cfg(unix)]
#[test]
fn links_and_devices_are_written_through() {
    let bench = Bench::new();
    std::os::unix::fs::symlink("real.exr", bench.path("link.exr")).expect("linked");
    let run = bench.render(&["-o", "link.exr", "--size", "8", "-q", "--json=/dev/null"]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    assert!(bench.path("link.exr").is_symlink() && bench.path("real.exr").is_file());
    assert!(!std::path::Path::new("/dev/null").is_file());
}

#[test]
fn render_writes_the_image_the_preview_and_a_report_with_the_promised_keys() {
    let bench = Bench::new();
    let run = bench.render(&["-o", "out.exr", "--preview", "out.png", "--size", "40x24", "--json"]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let report: Value = serde_json::from_str(&run.stdout).unwrap();
    for key in REPORT_KEYS {
        assert!(report.get(key).is_some(), "{key} is missing");
    }
    assert_eq!(report["command"], "render");
    assert_eq!(report["images"][0]["width"], 40);
    assert_eq!(report["images"][0]["height"], 24);
    for key in ["rays", "rays_total", "patches", "vertices", "iterations", "residual", "ledger"] {
        assert!(report["solve"].get(key).is_some(), "solve.{key} is missing");
    }
    let stages: Vec<&str> =
        report["stages"].as_array().unwrap().iter().map(|stage| stage["name"].as_str().unwrap()).collect();
    assert!(stages.contains(&"load") && stages.contains(&"write"), "{stages:?}");
    assert!(bench.path("out.exr").is_file() && bench.path("out.png").is_file());
    // Written beside and renamed: nothing else is left.
    assert!(bench.files().iter().all(|name| !name.contains("tmp")), "{:?}", bench.files());
}

#[test]
fn reports_go_to_a_file_and_quiet_says_nothing() {
    let bench = Bench::new();
    let run = bench.render(&["-o", "out.exr", "--size", "16", "--quiet", "--json", "report.json"]);
    assert_eq!((run.code, run.stdout.as_str(), run.stderr.as_str()), (0, "", ""));
    let report: Value = serde_json::from_slice(&fs::read(bench.path("report.json")).unwrap()).unwrap();
    assert_eq!(report["outputs"], serde_json::json!(["out.exr"]));
}

#[test]
fn a_solution_gives_the_same_bits_by_every_way() {
    let bench = Bench::new();
    let size = ["--size", "24"];
    assert_eq!(bench.render(&["-o", "straight.exr", "--size", "24", "--threads", "1"]).code, 0);
    let solved = bench.run(&["solve", "scene.gltf", "-o", "solved.glb", "--quality", "draft"]);
    assert_eq!(solved.code, 0, "{}", solved.stderr);
    let own =
        bench.run(&[&["render", "solved.glb", "-o", "own.exr", "--quality", "draft"], &size[..]].concat());
    assert_eq!(own.code, 0, "{}", own.stderr);
    let beside =
        bench.render(&["-o", "beside.exr", "--solution", "solved.glb", "--size", "24", "--threads", "2"]);
    assert_eq!(beside.code, 0, "{}", beside.stderr);
    let bytes = |name: &str| fs::read(bench.path(name)).unwrap();
    assert!(bytes("straight.exr") == bytes("own.exr"), "the solved file gives another picture");
    assert!(bytes("straight.exr") == bytes("beside.exr"), "--solution gives another picture");

    // A solution can be solved again, and does not grow.
    let again = bench.run(&["solve", "solved.glb", "-o", "again.glb", "--quality", "draft"]);
    assert_eq!(again.code, 0, "{}", again.stderr);
    assert_eq!(bytes("solved.glb"), bytes("again.glb"));
}

#[test]
fn the_sky_travels_with_the_solution() {
    let bench = Bench::new();
    let sky = ["--sky", "0.5,1,2"];
    let solve = ["solve", "scene.gltf", "-o", "solved.glb", "--quality", "draft"];
    assert_eq!(bench.run(&[&solve[..], &sky[..]].concat()).code, 0);
    let render = ["render", "solved.glb", "-o", "own.exr", "--size", "16", "--quality", "draft"];
    // At each pixel, too, where light of the sky and of lamps part.
    for direct in [["--direct", "vertices"], ["--direct", "pixels"]] {
        let straight = [&["-o", "straight.exr", "--size", "16"], &sky[..], &direct].concat();
        assert_eq!(bench.render(&straight).code, 0);
        assert_eq!(bench.run(&[&render[..], &direct].concat()).code, 0);
        let bytes = |name: &str| fs::read(bench.path(name)).unwrap();
        assert!(
            bytes("straight.exr") == bytes("own.exr"),
            "the solved file gives another picture: {direct:?}"
        );
    }

    // Another sky is other light.
    let other = bench.run(&[&render[..], &["--sky", "1"]].concat());
    assert_eq!(other.code, 1);
    assert!(other.stderr.contains("another scene") && other.stderr.contains("--sky"), "{}", other.stderr);
}

#[test]
fn light_of_another_scene_is_refused() {
    let bench = Bench::new();
    let solved = bench.run(&["solve", "scene.gltf", "-o", "solved.glb", "--quality", "draft"]);
    assert_eq!(solved.code, 0, "{}", solved.stderr);
    bench.write_scene("other.gltf", [0.1, 0.2, 0.3]);
    let run =
        bench.run(&["render", "other.gltf", "-o", "out.exr", "--solution", "solved.glb", "--size", "16"]);
    run.fails_with(1, &["solved.glb", "other.gltf", "another scene", "hint: "]);
    let run =
        bench.run(&["render", "other.gltf", "-o", "out.exr", "--solution", "scene.gltf", "--size", "16"]);
    run.fails_with(1, &["scene.gltf", "without a solution", "catoptric solve"]);
    let run = bench.run(&["render", "solved.glb", "-o", "out.exr", "--plain", "--size", "16"]);
    run.fails_with(2, &["--plain", "solved.glb"]);
}

#[test]
fn mirrors_light_the_floor_and_with_plain_they_do_not() {
    let bench = Bench::new();
    for (name, options, lit) in [("lit.exr", &[][..], true), ("plain.exr", &["--plain"][..], false)] {
        let run = bench.render(&[&["-o", name, "--size", "16", "--layers"], options].concat());
        assert_eq!(run.code, 0, "{}", run.stderr);
        let image = Image::read(&bench.path(name), &ReadLimits::default()).unwrap();
        let layers = ["mirrored", "caustic", "specular.mirrored", "specular.caustic"];
        let light = |layer: &str| image.rgb(layer).unwrap().iter().flatten().sum::<f32>();
        let thrown: f32 = layers.into_iter().map(light).sum();
        assert_eq!(thrown > 0.0, lit, "{name}: {thrown}");
        assert!(light("direct") > 0.0, "{name}");
    }
}

/// … as it was, not as it is by default.
#[test]
fn an_exr_says_how_deep_the_eye_looked() {
    let bench = Bench::new();
    for (options, depth) in [
        (&["--quality", "draft"][..], "1000"),
        (&["--quality", "draft", "--max-depth", "7"], "7"),
        (&["--quality", "high"], "4000"),
    ] {
        let run = bench.run(&[&["render", "scene.gltf", "-o", "deep.exr", "--size", "8"], options].concat());
        assert_eq!(run.code, 0, "{}", run.stderr);
        let image = Image::read(&bench.path("deep.exr"), &ReadLimits::default()).unwrap();
        assert_eq!(image.attributes["render.max_depth"], depth);
    }
}

#[test]
fn the_mesh_is_drawn_over_a_picture_and_is_a_layer_of_an_exr() {
    let bench = Bench::new();
    for options in [&["-o", "plain.png"][..], &["-o", "mesh.png", "--layers", "mesh"][..]] {
        let run = bench.render(&[options, &["--size", "32"]].concat());
        assert_eq!(run.code, 0, "{}", run.stderr);
    }
    let [plain, mesh] = ["plain.png", "mesh.png"].map(|name| fs::read(bench.path(name)).unwrap());
    assert_ne!(plain, mesh);

    let run = bench.render(&["-o", "mesh.exr", "--layers", "mesh", "--size", "32"]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let image = Image::read(&bench.path("mesh.exr"), &ReadLimits::default()).unwrap();
    let lines = image.channel("mesh.Y").unwrap();
    assert!(lines.iter().all(|covered| (0.0..=1.0).contains(covered)));
    assert!(lines.iter().any(|covered| *covered > 0.5) && lines.iter().any(|covered| *covered < 0.1));
    assert!(image.rgb("direct").is_none());
}

#[test]
fn cameras_and_frames_have_their_names_before_the_extension() {
    let bench = Bench::new();
    let run = bench.render(&["-o", "v.exr", "--camera", "all", "--size", "8", "--json"]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let report: Value = serde_json::from_str(&run.stdout).unwrap();
    assert_eq!(report["outputs"], serde_json::json!(["v.Left.exr", "v.Right.exr"]));
    // The light was computed once.
    let stages = report["stages"].as_array().unwrap();
    assert!(stages.iter().filter(|stage| stage["name"] == "gather").all(|stage| stage["runs"] == 1));

    let run = bench.render(&["-o", "v.exr", "--camera", "Right", "--frames", "9..10", "--size", "8"]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let frames = ["v.0009.exr", "v.0010.exr"].map(|name| bench.path(name).is_file());
    assert_eq!(frames, [true, true], "{:?}", bench.files());

    // The second frame would replace the sky.
    let run = bench.render(&["-o", "v.exr", "--frames", "9..10", "--size", "8", "--sky", "v.0010.exr"]);
    run.fails_with(2, &["v.0010.exr", "overwritten"]);
}

#[test]
fn info_lists_what_was_read_in_text_and_json() {
    let bench = Bench::new();
    let text = bench.run(&["info", "scene.gltf"]);
    assert_eq!(text.code, 0, "{}", text.stderr);
    for part in ["ideal mirror", "Lambertian", "Left", "Right", "Cost"] {
        assert!(text.stdout.contains(part), "{part} is missing:\n{}", text.stdout);
    }
    let json: Value = serde_json::from_str(&bench.run(&["info", "scene.gltf", "--json"]).stdout).unwrap();
    assert_eq!(json["scene"]["triangles"], 6);
    assert_eq!(json["cameras"][1]["name"], "Right");
    let qualities: Vec<&Value> =
        json["estimates"].as_array().unwrap().iter().map(|e| &e["quality"]).collect();
    assert_eq!(qualities, ["sketch", "draft", "standard", "high"]);
}

#[test]
fn a_file_that_is_missing_or_no_gltf_is_named_with_a_hint() {
    let bench = Bench::new();
    bench
        .run(&["render", "scne.gltf", "-o", "a.exr"])
        .fails_with(1, &["scne.gltf: no such file", "scene.gltf?"]);
    fs::write(bench.path("noise.glb"), b"this is not a scene").unwrap();
    bench.run(&["info", "noise.glb"]).fails_with(1, &["noise.glb", "expected", "found"]);
    let sky = bench.render(&["-o", "a.exr", "--sky", "nowhere.hdr"]);
    sky.fails_with(1, &["nowhere.hdr: no such sky file", "--sky takes"]);
    fs::write(bench.path("bad.hdr"), b"this is no image").unwrap();
    bench.render(&["-o", "a.exr", "--sky", "bad.hdr"]).fails_with(1, &["bad.hdr"]);
}

#[test]
fn a_camera_that_is_not_there_gets_a_suggestion() {
    let bench = Bench::new();
    let run = bench.render(&["-o", "a.exr", "--camera", "rigth"]);
    run.fails_with(1, &["has no camera \"rigth\"", "did you mean \"Right\"", "\"Left\""]);
}

#[test]
fn words_that_make_no_sense_are_usage_errors() {
    let bench = Bench::new();
    bench.render(&[]).fails_with(2, &["no output was named", "-o FILE.exr"]);
    bench.render(&["-o", "a.exr", "--size", "0x10"]).fails_with(2, &["--size", "1280x720"]);
    bench.render(&["-o", "a.exr", "--frames", "9..3"]).fails_with(2, &["--frames", "before the first"]);
    bench.render(&["-o", "a.exr", "--sky", "1,2,x"]).fails_with(2, &["--sky"]);
    bench.render(&["-o", "a.exr", "--qualty", "high"]).fails_with(2, &["--quality"]);
    bench.render(&["-o", "a.gif"]).fails_with(2, &["a.gif", ".exr, .pfm or .png"]);
    bench.render(&["-o", "a.png", "--layers"]).fails_with(2, &["--layers", "OpenEXR"]);
    bench.render(&["-o", "a.png", "--preview", "a.png"]).fails_with(2, &["a.png", "two outputs"]);
    bench.render(&["-o", "a.exr", "--json", "scene.gltf"]).fails_with(2, &["scene.gltf", "overwritten"]);
    let over_input = ["solve", "scene.gltf", "-o", "a.glb", "--json", "scene.gltf"];
    bench.run(&over_input).fails_with(2, &["scene.gltf", "overwritten"]);
    let over_input = ["form-factors", "scene.gltf", "-o", "a.csv", "--json", "scene.gltf"];
    bench.run(&over_input).fails_with(2, &["scene.gltf", "overwritten"]);
    bench.render(&["-o", "a.exr", "--sky", "1e16"]).fails_with(2, &["--sky", "1e15"]);
    bench.run(&["solve", "scene.gltf", "-o", "a.exr"]).fails_with(2, &["a.exr", ".glb"]);
    bench.run(&["rendr", "scene.gltf"]).fails_with(2, &["render"]);
}

#[test]
fn an_output_that_cannot_be_written_is_refused_before_the_work() {
    let bench = Bench::new();
    bench
        .render(&["-o", "no/such/folder/a.exr"])
        .fails_with(1, &["no/such/folder", "does not exist", "mkdir"]);
    fs::create_dir(bench.path("folder.exr")).unwrap();
    bench.render(&["-o", "folder.exr"]).fails_with(1, &["folder.exr: is a folder"]);
    // The old file stays where the run fails.
    fs::write(bench.path("old.exr"), b"old").unwrap();
    bench.render(&["-o", "old.exr", "--camera", "none"]).fails_with(1, &[]);
    assert_eq!(fs::read(bench.path("old.exr")).unwrap(), b"old");
}

#[cfg(unix)]
#[test]
fn an_interrupt_stops_within_a_second_with_130_and_leaves_nothing() {
    let commands = [
        &["render", "scene.gltf", "-o", "a.exr", "--quality", "high", "--size", "8000"][..],
        // Does not ask for as long as one pair takes.
        &["form-factors", "scene.gltf", "-o", "a.csv", "--rays", "100000000"],
    ];
    for command in commands {
        let bench = Bench::new();
        let mut child = bench.spawn(command);
        std::thread::sleep(std::time::Duration::from_millis(700));
        let id = child.id().to_string();
        let sent = std::process::Command::new("kill").args(["-INT", &id]).status().unwrap();
        assert!(sent.success());
        let start = std::time::Instant::now();
        let status = child.wait().unwrap();
        // A second, and as much again for a machine that is busy with other tests.
        assert!(start.elapsed().as_secs_f64() < 2.0, "{command:?} took {:?}", start.elapsed());
        assert_eq!(status.code(), Some(130), "{command:?}");
        assert_eq!(bench.files(), ["quad.bin", "scene.gltf"]);
    }
}

#[test]
fn views_of_nothing_are_told() {
    let bench = Bench::new();
    let text = fs::read_to_string(bench.path("scene.gltf")).expect("the scene is there");
    let write = |change: &dyn Fn(&mut Value)| {
        let mut scene: Value = serde_json::from_str(&text).expect("JSON");
        change(&mut scene);
        fs::write(bench.path("scene.gltf"), scene.to_string()).expect("a temporary folder that works");
        bench.render(&["-o", "a.exr", "--size", "8"])
    };
    // The floor's far edge is five metres ahead.
    let near = |metres: f64| {
        write(&|scene| scene["cameras"][0]["perspective"]["znear"] = serde_json::json!(metres)).stderr
    };
    assert!(near(6.0).contains("\"Left\" has all of the scene before its near plane"), "{}", near(6.0));
    assert!(!near(4.0).contains("camera"), "{}", near(4.0));
    // Turned around.
    let away = write(&|scene| scene["nodes"][3]["rotation"] = serde_json::json!([0, 1, 0, 0])).stderr;
    assert!(away.contains("\"Left\" has all of the scene behind it"), "{away}");
}
