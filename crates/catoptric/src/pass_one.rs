//! Pass one with the settings of the command line.

use std::collections::BTreeMap;

use catoptric_radiosity::{SolveParams, SolveReport, Solved, solve};
use catoptric_scene::SceneHash;
use catoptric_solution::Solution;
use catoptric_trace::Tracer;

use crate::args::TransportArgs;
use crate::failure::Failure;
use crate::progress::Reporter;

/// Computes the light of a scene.
pub(crate) fn run(
    tracer: &Tracer,
    hash: SceneHash,
    args: &TransportArgs,
    reporter: &Reporter,
) -> Result<(Solution, SolveReport), Failure> {
    let mut params = SolveParams::for_quality(args.quality.quality());
    params.walk.max_depth = args.max_depth;
    params.walk.extended = !args.plain;
    params.seed = args.seed;
    let Solved { mut solution, report } = solve(tracer, &params, reporter)?;
    solution.scene_hash = hash;
    solution.settings.extend(settings(args));
    Ok((solution, report))
}

/// The settings that the light depends on, as a solution keeps them.
pub(crate) fn settings(args: &TransportArgs) -> BTreeMap<String, String> {
    let entry = |name: &str, value: String| (name.to_owned(), value);
    BTreeMap::from([
        entry("version", env!("CARGO_PKG_VERSION").to_owned()),
        entry("quality", args.quality.name().to_owned()),
        entry("max_depth", args.max_depth.to_string()),
        entry("plain", args.plain.to_string()),
        entry("seed", args.seed.to_string()),
    ])
}
