//! Pass one with the settings of the command line.

use std::collections::BTreeMap;

use catoptric_light::LightParams;
use catoptric_radiosity::coarse::CoarseParams;
use catoptric_radiosity::{SolveError, SolveParams, Solved, solve};
use catoptric_scene::{Rgb, SceneHash};
use catoptric_solution::Solution;
use catoptric_trace::Tracer;
use catoptric_trace::walk::WalkParams;

use crate::args::TransportArgs;
use crate::failure::Failure;
use crate::progress::Reporter;

/// Sources of plain radiosity: no images in mirrors, no light-side rays.
const PLAIN_LIGHT: LightParams = LightParams { images: false, light_rays: false };

/// Sources as pass one saw them, for pass two.
pub(crate) fn light_of(solution: &Solution) -> LightParams {
    if is_plain(solution) { PLAIN_LIGHT } else { LightParams::default() }
}

/// Sources as pass one will see them.
pub(crate) fn light(args: &TransportArgs) -> LightParams {
    if args.plain { PLAIN_LIGHT } else { LightParams::default() }
}

/// Whether a solution is plain radiosity.
pub(crate) fn is_plain(solution: &Solution) -> bool {
    solution.settings.get("plain").is_some_and(|plain| plain == "true")
}

/// Whether a solution shows patches, as the first radiosity pictures did.
pub(crate) fn is_classical(solution: &Solution) -> bool {
    solution.settings.contains_key("reconstruct")
}

/// How a solve is watched, and where it starts.
#[derive(Debug, Default)]
pub(crate) struct Watch {
    /// Radiosities of the patches to start from; empty for none.
    pub(crate) warm: Vec<Rgb>,
    /// Steps between frames; 0 for none.
    pub(crate) every: usize,
}

/// Computes the light of a scene.
pub(crate) fn run(
    tracer: &Tracer,
    hash: SceneHash,
    args: &TransportArgs,
    watch: Watch,
    reporter: &Reporter,
) -> Result<Solved, Failure> {
    let mut params = SolveParams::for_quality(args.quality.quality());
    params.walk.max_depth = max_depth(args);
    params.walk.extended = !args.plain;
    params.light = light(args);
    params.seed = args.seed;
    params.coarse = CoarseParams {
        method: args.method,
        solver: args.solver,
        residual: args.residual,
        max_steps: args.max_steps.map(|steps| steps as usize),
        warm: watch.warm,
        every: watch.every,
    };
    params.reconstruction = args.reconstruction().map(|(rule, _)| rule);
    let mut solved = solve(tracer, &params, reporter).map_err(explain)?;
    solved.solution.scene_hash = hash;
    solved.solution.settings.extend(settings(args));
    Ok(solved)
}

/// Events after which pass one gives a path up.
fn max_depth(args: &TransportArgs) -> u32 {
    args.max_depth.unwrap_or(WalkParams::default().max_depth)
}

/// What to do about it.
fn explain(error: SolveError) -> Failure {
    match &error {
        SolveError::Cancelled(_) => Failure::Interrupted,
        SolveError::Method(method, reason) => Failure::run(
            format_args!("--method {}: {reason}", method.name()),
            "leave --method out, or use rays",
        ),
        SolveError::TooManyPatches { .. } => {
            Failure::run(error, "use --solver gauss-seidel, or --quality draft for fewer patches")
        }
        SolveError::OtherPatches { .. } => Failure::run(
            format_args!("--warm: {error}"),
            "the earlier solution must be of a scene of the same shape, with the same --quality",
        ),
    }
}

/// The settings that the light depends on, as a solution keeps them.
pub(crate) fn settings(args: &TransportArgs) -> BTreeMap<String, String> {
    let entry = |name: &str, value: String| (name.to_owned(), value);
    let mut settings = BTreeMap::from([
        entry("version", env!("CARGO_PKG_VERSION").to_owned()),
        entry("quality", args.quality.name().to_owned()),
        entry("max_depth", max_depth(args).to_string()),
        entry("plain", args.plain.to_string()),
        entry("seed", args.seed.to_string()),
    ]);
    settings.extend(args.method.map(|method| entry("method", method.name().to_owned())));
    settings.extend(args.reconstruction().map(|(_, word)| entry("reconstruct", word.to_owned())));
    settings.extend(args.solver.map(|solver| entry("solver", solver.name().to_owned())));
    settings.extend(args.residual.map(|residual| entry("residual", residual.to_string())));
    settings.extend(args.max_steps.map(|steps| entry("max_steps", steps.to_string())));
    settings
}
