//! `catoptric solve`: pass one, saved for any number of views.

use std::path::{Path, PathBuf};

use catoptric_image::write_bytes_atomically;
use catoptric_radiosity::Solved;
use catoptric_radiosity::frames::Frames;
use catoptric_render::direct::DirectLight;
use catoptric_render::{RenderParams, render};
use catoptric_scene::Rgb;
use catoptric_solution::file;
use catoptric_trace::Tracer;

use crate::args::SolveArgs;
use crate::failure::Failure;
use crate::input::{Input, Light};
use crate::output::{self, Outputs, Tag};
use crate::pass_one::{self, Watch};
use crate::progress::Reporter;
use crate::report::{Report, SceneSummary, SolveSummary};
use crate::summary;

pub(crate) fn run(args: &SolveArgs) -> Result<(), Failure> {
    let reporter = Reporter::new(args.run.quiet);

    // Say what cannot work before anything is computed.
    let Some(path) = &args.output else {
        return Err(Failure::usage("no output was named", "add -o FILE.glb"));
    };
    if path.extension().is_none_or(|extension| !extension.eq_ignore_ascii_case("glb")) {
        return Err(Failure::usage(
            format_args!("{}: a solution is a .glb file", path.display()),
            "name the output like solved.glb",
        ));
    }
    let report_file = args.run.json.clone().flatten();
    let outputs: Vec<_> = std::iter::once(path.clone()).chain(report_file.clone()).collect();
    output::check_distinct(&outputs)?;
    for output in &outputs {
        output::check(output)?;
    }

    if let Some(folder) = &args.snapshot {
        std::fs::create_dir_all(folder)
            .map_err(|error| Failure::Run(format!("{}: cannot be made: {error}", folder.display())))?;
        output::check(&folder.join("step.png"))?;
    }

    reporter.begin_deaf("load");
    let mut input =
        Input::read_with(&args.scene, args.transport.sky.as_ref(), &args.transport.ies, Light::New)?;
    output::check_are_no_inputs(&outputs, &input.files)?;
    summary::warn(&reporter, &input.warnings);
    reporter.begin_deaf("tree");
    let tracer = Tracer::new(&input.scene);
    let watch = Watch {
        warm: args.warm.as_deref().map_or(Ok(Vec::new()), warm_start)?,
        every: args.every.map_or(0, |every| every as usize),
    };
    let Solved { solution, report: solve_report, frames } =
        pass_one::run(&tracer, input.hash, &args.transport, watch, &reporter)?;
    let mut written = vec![path.clone()];
    if let (Some(frames), Some(folder)) = (&frames, &args.snapshot) {
        written.extend(snapshots(args, &tracer, frames, folder, &reporter)?);
    }

    reporter.begin_write();
    file::append(&mut input.asset, &input.scene, &solution)
        .and_then(|()| input.asset.to_glb().map_err(Into::into))
        .map_err(|error| Failure::Run(format!("{}: {error}", path.display())))
        .and_then(|bytes| {
            write_bytes_atomically(path, &bytes)
                .map_err(|error| Failure::Run(format!("{}: cannot be written: {error}", path.display())))
        })?;
    reporter.end();

    summary::solved(&reporter, &solve_report);
    summary::written(&reporter, &written);
    if args.run.json.is_some() {
        let scene = SceneSummary::new(&args.scene, &input.scene, input.hash);
        let solve = SolveSummary::new(&solve_report, &solution.settings);
        let mut report = Report::new("solve", scene, solution.settings, &reporter);
        report.warnings = input.warnings;
        report.solve = Some(solve);
        report.outputs = written;
        report.write(report_file.as_deref())?;
    }
    Ok(())
}

/// Radiosities of the patches of an earlier solution.
fn warm_start(path: &Path) -> Result<Vec<Rgb>, Failure> {
    let earlier = Input::read(path, None, Light::Own)?;
    let Some(solution) = earlier.solution else {
        return Err(Failure::run(
            format_args!("--warm {}: holds no solution", path.display()),
            "name a file that `catoptric solve` wrote",
        ));
    };
    Ok(solution.patches.radiosity.iter().map(|&b| b.into()).collect())
}

/// Renders every frame, all with the exposure of the last, which is the brightest.
fn snapshots(
    args: &SolveArgs,
    tracer: &Tracer,
    frames: &Frames,
    folder: &Path,
    reporter: &Reporter,
) -> Result<Vec<PathBuf>, Failure> {
    let Some(camera) = tracer.scene().cameras().first() else { return Ok(Vec::new()) };
    let (width, height) = args.snapshot_size.pixels(camera).map_err(Failure::Usage)?;
    let mut params = RenderParams::for_quality(args.transport.quality.quality(), width, height);
    params.walk.max_depth = args.transport.max_depth.unwrap_or(params.walk.max_depth);
    params.light = pass_one::light(&args.transport);
    params.seed = args.transport.seed;
    // What has arrived by then is in the mesh.
    params.direct = DirectLight::Vertices;
    let mut outputs = Outputs::new(Some(&folder.join("step.png")), None, &[], None)?;
    let mut written = Vec::new();
    for frame in frames.frames().iter().rev() {
        for ambient in [false, true] {
            if ambient && frame.ambient == Rgb::ZERO {
                continue;
            }
            let picture = render(tracer, &frames.solution(frame, ambient), camera, &params, reporter)?;
            let tag = Tag {
                camera: Some(format!("{:06}{}", frame.steps, if ambient { ".ambient" } else { "" })),
                frame: None,
            };
            written.extend(outputs.write(&picture.image, &tag)?);
        }
    }
    written.reverse();
    Ok(written)
}
