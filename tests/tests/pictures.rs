//! Pictures at `standard` against their references, by the judge that users have: the limits are those of the birth
//! certificates. A picture outside of its limits leaves its report and says where.

use std::path::{Path, PathBuf};

use catoptric_diff::{Job, run};
use catoptric_radiosity::{SolveParams, solve};
use catoptric_render::{RenderParams, render};
use catoptric_scene::{Silent, gltf};
use catoptric_solution::Quality;
use catoptric_trace::Tracer;

/// Scenes whose limits hold and that render in seconds: diffuse, planar mirror, glass, an exact furnace.
const SCENES: [&str; 4] = ["cornell_box", "cornell_mirror", "glass_sphere", "furnace_box"];

/// Renders a scene 256 pixels wide.
fn picture(root: &Path, name: &str, folder: &Path, extended: bool) -> PathBuf {
    let path = root.join("scenes").join(format!("{name}.glb"));
    let loaded = gltf::load(&path, &gltf::LoadOptions::default()).expect("the scene is in the repository");
    let tracer = Tracer::new(&loaded.scene);
    let mut params = SolveParams::for_quality(Quality::Standard);
    params.walk.extended = extended;
    params.light.images = extended;
    params.light.light_rays = extended;
    let solved = solve(&tracer, &params, &Silent).expect("nobody stops it");
    let camera = &loaded.scene.cameras()[0];
    let params = RenderParams::for_quality(Quality::Standard, 256, camera.height_for_width(256));
    let rendered = render(&tracer, &solved.solution, camera, &params, &Silent).expect("nobody stops it");
    let out = folder.join(format!("{name}.exr"));
    rendered.image.write_exr(&out).expect("the folder is ours");
    out
}

#[test]
fn pictures_are_within_the_limits_of_their_birth_certificates() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let folder = root.join("target").join("pictures");
    std::fs::create_dir_all(&folder).expect("target is ours");
    let mut failures = Vec::new();
    for name in SCENES {
        let ours = picture(&root, name, &folder, true);
        let reference = root.join("reference").join(format!("{name}.exr"));
        let report = folder.join(format!("{name}.html"));
        let job = Job { html: Some(report.clone()), ..Job::default() };
        let outcome = run(&job, &ours, &reference).expect("both images can be read");
        // A certificate without limits would let everything pass.
        assert!(!outcome.checks.is_empty(), "{name} has no limits");
        if !outcome.within() {
            let broken: Vec<String> =
                outcome.checks.iter().filter(|c| !c.holds).map(|c| format!("{c:?}")).collect();
            failures.push(format!("{name}: {} (report: {})", broken.join(", "), report.display()));
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

/// Power and squared error in the regions of the caustics (masks made by the example `caustic_mask`). The bars are those of
/// a person who looks at a caustic: 2 % of its power, and an error in its shape of 0.03 of its light squared.
#[test]
fn caustics_have_their_power_and_their_shape() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let folder = root.join("target").join("pictures").join("caustics");
    std::fs::create_dir_all(&folder).expect("target is ours");
    for name in ["ring_caustic", "glass_sphere"] {
        let ours = picture(&root, name, &folder, true);
        let reference = root.join("reference").join(format!("{name}.exr"));
        let mask = root.join("reference").join(format!("{name}.caustic.png"));
        let job = Job { mask: Some(mask), ..Job::default() };
        let outcome = run(&job, &ours, &reference).expect("all images can be read");
        let value = |metric: &str| {
            let reading = outcome.comparison.layers[0].reading(metric);
            reading.unwrap_or_else(|| panic!("{metric} is measured")).value
        };
        let (power, error) = (value("lum_ratio"), value("relMSE"));
        println!("{name}: power {power:.4}, relMSE {error:.2e}");
        assert!((power - 1.0).abs() < 0.02, "{name}: power {power}");
        assert!(error < 0.03, "{name}: relMSE {error}");
    }
}

/// The far side of the shaft gets most of its light over the mirror. Without extended form factors it is not black: the
/// partition ends a metre before the end wall, and diffuse light finds its way through the gap (12 % of the whole).
#[test]
fn the_far_side_of_the_shaft_is_lit_by_the_mirror() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let folder = root.join("target").join("pictures");
    std::fs::create_dir_all(&folder).expect("target is ours");
    let mean = |extended: bool| {
        let path = picture(&root, "mirror_light_shaft", &folder, extended);
        let image = catoptric_image::Image::read(&path, &catoptric_image::ReadLimits::default())
            .expect("just written");
        // The right third of the picture shows the far side's wall.
        let (mut sum, mut count) = (0.0_f64, 0);
        for (index, pixel) in image.rgb("").expect("a beauty").iter().enumerate() {
            if index % image.width > 200 {
                sum += f64::from(pixel[0] + pixel[1] + pixel[2]);
                count += 1;
            }
        }
        sum / f64::from(count)
    };
    let (lit, plain) = (mean(true), mean(false));
    assert!(lit > 0.01, "{lit}");
    assert!(plain < 0.2 * lit, "too much light without the mirror: {plain} against {lit}");
}
