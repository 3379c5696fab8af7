//! `catoptric solve`: pass one, saved for any number of views.

use catoptric_image::write_bytes_atomically;
use catoptric_scene::Progress;
use catoptric_solution::file;
use catoptric_trace::Tracer;

use crate::args::SolveArgs;
use crate::failure::Failure;
use crate::input::{Input, Light};
use crate::output;
use crate::pass_one;
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
        output::check(output, &[])?;
    }

    reporter.begin_deaf("load");
    let mut input = Input::read(&args.scene, args.transport.sky.as_ref(), Light::New)?;
    summary::warn(&reporter, &input.warnings);
    reporter.begin_deaf("tree");
    let tracer = Tracer::new(&input.scene);
    let (solution, solve_report) = pass_one::run(&tracer, input.hash, &args.transport, &reporter)?;

    reporter.begin("write", 0);
    file::append(&mut input.asset, &input.scene, &solution)
        .and_then(|()| input.asset.to_glb().map_err(Into::into))
        .map_err(|error| Failure::Run(format!("{}: {error}", path.display())))
        .and_then(|bytes| {
            write_bytes_atomically(path, &bytes)
                .map_err(|error| Failure::Run(format!("{}: cannot be written: {error}", path.display())))
        })?;
    reporter.end();

    summary::solved(&reporter, &solve_report);
    summary::written(&reporter, &outputs[..1]);
    if args.run.json.is_some() {
        let scene = SceneSummary::new(&args.scene, &input.scene, input.hash);
        let mut report = Report::new("solve", scene, solution.settings, &reporter);
        report.warnings = input.warnings;
        report.solve = Some(SolveSummary::new(&solve_report));
        report.outputs = vec![path.clone()];
        report.write(report_file.as_deref())?;
    }
    Ok(())
}
