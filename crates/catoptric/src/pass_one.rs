//! Pass one with the settings of the command line.

use std::collections::BTreeMap;

use catoptric_light::LightParams;
use catoptric_radiosity::{SolveParams, SolveReport, Solved, solve};
use catoptric_scene::SceneHash;
use catoptric_solution::Solution;
use catoptric_trace::Tracer;

use crate::args::TransportArgs;
use crate::failure::Failure;
use crate::progress::Reporter;

/// Sources of plain radiosity: no images in mirrors, no light-side rays.
const PLAIN_LIGHT: LightParams = LightParams { images: false, light_rays: false };

/// Sources as pass one saw them, for pass two.
pub(crate) fn light_of(solution: &Solution) -> LightParams {
    if is_plain(solution) { PLAIN_LIGHT } else { LightParams::default() }
}

/// Whether a solution is plain radiosity.
pub(crate) fn is_plain(solution: &Solution) -> bool {
    solution.settings.get("plain").is_some_and(|plain| plain == "true")
}

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
    if args.plain {
        params.light = PLAIN_LIGHT;
    }
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
