//! `catoptric render`: one solution, any number of cameras and frames.

use std::path::{Path, PathBuf};

use catoptric_image::Image;
use catoptric_radiosity::Solved;
use catoptric_render::direct::{DirectLight, ShadowRays};
use catoptric_render::render::pixel_bytes;
use catoptric_render::{RenderParams, Rendered, render};
use catoptric_scene::{Camera, TriangleId};
use catoptric_solution::Solution;
use catoptric_trace::{Accelerator, Tracer};

use crate::args::{Direct, Layers, Reconstruct, RenderArgs, Shading, TransportArgs};
use crate::failure::{Failure, did_you_mean};
use crate::input::{Input, Light};
use crate::output::{self, Outputs, Tag, in_file_name};
use crate::pass_one::{self, Watch};
use crate::progress::Reporter;
use crate::report::{ImageSummary, Report, SceneSummary, SolveSummary};
use crate::summary;
use crate::value::CameraChoice;

/// One image of the run.
struct View {
    camera: Camera,
    tag: Tag,
    width: usize,
    height: usize,
}

pub(crate) fn run(args: &RenderArgs) -> Result<(), Failure> {
    let reporter = Reporter::new(args.run.quiet);

    // Say what cannot work before anything is computed.
    let mut outputs =
        Outputs::new(args.output.as_deref(), args.preview.as_deref(), &args.layers, args.exposure)?;
    let report_file = args.run.json.clone().flatten();
    reporter.begin_deaf("load");
    let light = args.solution.as_deref().map_or(Light::Own, Light::Beside);
    let mut input = Input::read_with(&args.scene, args.transport.sky.as_ref(), &args.transport.ies, light)?;
    let views = views(args, &input)?;
    check_outputs(&outputs, &views, report_file.as_deref(), &input)?;
    check_memory(&views, args.layers.contains(&Layers::Light))?;
    if let Some(solution) = &input.solution {
        check_settings(args, solution)?;
    }
    if args.frames.is_some() && input.cameras.duration() == 0.0 {
        let file = args.scene.display();
        input.warnings.push(format!("{file}: no camera is animated: all frames show the same"));
    }
    warn_of_empty_views(&views, args, &mut input);
    summary::warn(&reporter, &input.warnings);

    // Light once.
    reporter.begin_deaf("tree");
    let accelerator = input.accelerator.unwrap_or_else(|| Accelerator::new(&input.scene));
    let tracer = Tracer::with(&input.scene, accelerator);
    let (solution, solve_report) = match input.solution {
        Some(solution) => (solution, None),
        None => {
            let Solved { solution, report, .. } =
                pass_one::run(&tracer, input.hash, &args.transport, Watch::default(), &reporter)?;
            reporter.end();
            summary::solved(&reporter, &report);
            (solution, Some(report))
        }
    };

    // Then views.
    let mut images = Vec::new();
    let mut written = Vec::new();
    for (index, view) in views.iter().enumerate() {
        if views.len() > 1 {
            reporter.set_context(format!("{} of {}: {}", index + 1, views.len(), view.camera.name));
        }
        let Rendered { mut image, report } =
            render(&tracer, &solution, &view.camera, &params(args, &solution, view), &reporter)?;
        describe(&mut image, &solution, view, args);
        reporter.begin_write();
        let files = outputs.write(&image, &view.tag)?;
        images.push(ImageSummary {
            file: files[0].clone(),
            camera: view.camera.name.clone(),
            frame: view.tag.frame,
            width: view.width,
            height: view.height,
            samples: report.samples,
            refined_pixels: report.refined_pixels,
        });
        written.extend(files);
    }
    reporter.end();

    summary::written(&reporter, &written);
    if args.run.json.is_some() {
        let scene = SceneSummary::new(&args.scene, &input.scene, input.hash);
        let solve = solve_report.as_ref().map(|report| SolveSummary::new(report, &solution.settings));
        let mut report = Report::new("render", scene, solution.settings, &reporter);
        report.warnings = input.warnings;
        report.solve = solve;
        report.images = images;
        report.outputs = written;
        report.write(report_file.as_deref())?;
    }
    Ok(())
}

/// Cameras times frames.
fn views(args: &RenderArgs, input: &Input) -> Result<Vec<View>, Failure> {
    let rest = input.scene.cameras();
    let chosen: Vec<usize> = match &args.camera {
        CameraChoice::First => vec![0],
        CameraChoice::All => (0..rest.len()).collect(),
        CameraChoice::Named(name) => vec![find_camera(name, rest, &args.scene)?],
    };
    let frames: Vec<Option<u32>> = match args.frames {
        None => vec![None],
        Some(frames) => (frames.first..=frames.last).map(Some).collect(),
    };
    let file_names = output::file_names(rest.iter().map(|camera| camera.name.as_str()));
    let mut views = Vec::new();
    for frame in frames {
        let moved = frame.map(|frame| input.cameras.at((f64::from(frame) / args.fps) as f32));
        let cameras = moved.as_deref().unwrap_or(rest);
        for &index in &chosen {
            let camera = cameras[index].clone();
            let (width, height) = args.size.pixels(&camera).map_err(Failure::Usage)?;
            let several = args.camera == CameraChoice::All && chosen.len() > 1;
            let tag = Tag { camera: several.then(|| file_names[index].clone()), frame };
            views.push(View { camera, tag, width, height });
        }
    }
    Ok(views)
}

/// Says so where nothing of the scene can be in a picture: it lies behind the camera, or before its near plane, as in scenes that were scaled
/// down with the camera in them.
fn warn_of_empty_views(views: &[View], args: &RenderArgs, input: &mut Input) {
    let file = args.scene.display();
    if input.scene.triangles().is_empty() {
        return;
    }
    let ids = || (0..input.scene.triangles().len() as u32).map(TriangleId);
    let mut known: Vec<&str> = Vec::new();
    for View { camera, .. } in views {
        // Of an animation the first frame.
        if known.contains(&camera.name.as_str()) {
            continue;
        }
        known.push(&camera.name);
        let ahead = camera.world_from_camera.inverse();
        let depths = ids().flat_map(|id| input.scene.corners(id)).map(|p| -ahead.transform_point3(p).z);
        let farthest = depths.fold(f32::NEG_INFINITY, f32::max);
        let Camera { name, near, .. } = camera;
        if farthest <= 0.0 {
            input.warnings.push(format!(
                "{file}: camera {name:?} has all of the scene behind it: nothing of it is seen"
            ));
        } else if farthest <= *near {
            input.warnings.push(format!(
                "{file}: camera {name:?} has all of the scene before its near plane, `znear` {near} m; the farthest point is {farthest} m ahead: nothing of it is seen"
            ));
        }
    }
}

fn find_camera(name: &str, cameras: &[Camera], file: &Path) -> Result<usize, Failure> {
    if let Some(index) = cameras.iter().position(|camera| camera.name == name) {
        return Ok(index);
    }
    let names: Vec<&str> = cameras.iter().map(|camera| camera.name.as_str()).collect();
    let message = format!("{}: has no camera {name:?}", file.display());
    let listed = names.iter().map(|name| format!("{name:?}")).collect::<Vec<_>>().join(", ");
    Err(match did_you_mean(name, names.iter().copied()) {
        Some(similar) => Failure::run(message, format_args!("did you mean {similar:?}? It has {listed}")),
        None => Failure::run(message, format_args!("it has {listed}")),
    })
}

/// All outputs of all views can be written, and none is written twice or over an input.
fn check_outputs(
    outputs: &Outputs,
    views: &[View],
    report: Option<&Path>,
    input: &Input,
) -> Result<(), Failure> {
    let mut paths: Vec<PathBuf> = views.iter().flat_map(|view| outputs.paths(&view.tag)).collect();
    paths.extend(report.map(Path::to_owned));
    output::check_distinct(&paths)?;
    // All lie in the folders of the first view's outputs.
    let first = views.first().map_or(0, |view| outputs.paths(&view.tag).len());
    for path in paths.iter().take(first).chain(report.map(Path::to_owned).iter()) {
        output::check(path)?;
    }
    output::check_are_no_inputs(&paths, &input.files)
}

/// Says now, not after pass one, that there is no memory for an image: a block of it is asked for, and given back untouched.
fn check_memory(views: &[View], layers: bool) -> Result<(), Failure> {
    let Some(largest) = views.iter().max_by_key(|view| view.width * view.height) else { return Ok(()) };
    let View { width, height, .. } = largest;
    let bytes = width.saturating_mul(*height).saturating_mul(pixel_bytes(layers));
    Vec::<u8>::new().try_reserve_exact(bytes).map_err(|_| {
        let gigabytes = bytes as f64 * 1e-9;
        Failure::run(
            format_args!(
                "an image of {width}x{height} takes {gigabytes:.1} GB of memory, more than there is"
            ),
            "make it smaller: --size 3840",
        )
    })
}

/// Options of pass one cannot change light that was computed before.
fn check_settings(args: &RenderArgs, solution: &Solution) -> Result<(), Failure> {
    if args.transport.plain && !pass_one::is_plain(solution) {
        let file = args.solution.as_ref().unwrap_or(&args.scene);
        return Err(Failure::usage(
            format_args!("--plain: the light of {} was solved with mirrors and glass", file.display()),
            "solve the source scene again with --plain, or leave it out",
        ));
    }
    let TransportArgs { method, solver, residual, max_steps, reconstruct, shading, .. } = &args.transport;
    let given = [
        ("--method", method.is_some()),
        ("--solver", solver.is_some()),
        ("--residual", residual.is_some()),
        ("--max-steps", max_steps.is_some()),
        ("--reconstruct", *reconstruct != Reconstruct::Gather),
        ("--shading", *shading != Shading::Gouraud),
    ];
    match given.iter().find(|(_, is_given)| *is_given) {
        None => Ok(()),
        Some((option, _)) => {
            let file = args.solution.as_ref().unwrap_or(&args.scene);
            Err(Failure::usage(
                format_args!("{option}: the light of {} was solved before", file.display()),
                format_args!("solve the source scene again with {option}, or leave it out"),
            ))
        }
    }
}

fn params(args: &RenderArgs, solution: &Solution, view: &View) -> RenderParams {
    let mut params = RenderParams::for_quality(args.transport.quality.quality(), view.width, view.height);
    params.walk.max_depth = args.transport.max_depth.unwrap_or(params.walk.max_depth);
    params.light = pass_one::light_of(solution);
    match args.direct {
        Direct::Auto if !pass_one::is_classical(solution) => {}
        Direct::Auto | Direct::Vertices => params.direct = DirectLight::Vertices,
        Direct::Pixels => {
            params.direct = DirectLight::Pixels(ShadowRays::for_quality(args.transport.quality.quality()));
        }
    }
    params.seed = args.transport.seed;
    params.layers = args.layers.contains(&Layers::Light);
    params.mesh = args.layers.contains(&Layers::Mesh);
    params
}

/// Writes into the image where it came from. The same for the same picture: no times, no file names.
fn describe(image: &mut Image, solution: &Solution, view: &View, args: &RenderArgs) {
    let mut attribute = |name: String, value: String| image.attributes.insert(name, value);
    attribute("software".to_owned(), format!("Catoptric {}", env!("CARGO_PKG_VERSION")));
    attribute("camera".to_owned(), in_file_name(&view.camera.name));
    attribute("sceneHash".to_owned(), solution.scene_hash.to_string());
    for (name, value) in &solution.settings {
        attribute(format!("solve.{name}"), value.clone());
    }
    for (name, value) in pass_one::settings(&args.transport) {
        if name != "plain" && name != "version" && name != "max_depth" {
            attribute(format!("render.{name}"), value);
        }
    }
    let depth = params(args, solution, view).walk.max_depth;
    attribute("render.max_depth".to_owned(), depth.to_string());
    let direct = match args.direct {
        Direct::Auto => None,
        Direct::Vertices => Some("vertices"),
        Direct::Pixels => Some("pixels"),
    };
    if let Some(direct) = direct {
        attribute("render.direct".to_owned(), direct.to_owned());
    }
    if let Some(frame) = view.tag.frame {
        attribute("frame".to_owned(), frame.to_string());
        attribute("framesPerSecond".to_owned(), args.fps.to_string());
    }
}
