//! Pass one from end to end: mesh, sources, coarse solve, final gather.
//!
//! The file is long since it is one list: the steps of pass one in their order, with the parameters of each.

use rayon::prelude::*;

use catoptric_light::{LightParams, Lights, Receiver};
use catoptric_scene::{Progress, Rgb};
use catoptric_solution::{DisplayMesh, PatchRadiosity, Quality, Solution, Term};
use catoptric_trace::sequence::{Key, Purpose};
use catoptric_trace::walk::WalkParams;
use catoptric_trace::{Ledger, Tracer};

use crate::base_mesh::base_mesh;
use crate::caustic::{CausticParams, CausticReport, caustic};
pub use crate::coarse::SolveError;
use crate::coarse::{CoarseParams, CoarseSolution, MAX_FRAMES, rows_by, solve_coarse};
use crate::display::Displayed;
use crate::draft::Draft;
use crate::field::{Values, mean};
use crate::final_gather::{Coarse, Sight, final_gather, spread};
use crate::fit::FitParams;
use crate::frames::Frames;
use crate::method::ElementSet;
use crate::near::{Near, NearParams};
use crate::near_light::{NearLight, NearLightParams};
use crate::patch::{PatchId, PatchMesh};
use crate::reconstruct::{Cells, Reconstruction, unshared};
use crate::refine::{RefineParams, refine};
use crate::rows::{PatchLocator, Row, rows};
use crate::sharing::{Covers, Sharing};
use crate::solver::{SolverParams, Stop};
use crate::source_light::{SourceField, SourceLight, split_glints};

/// Parameters of pass one.
#[derive(Clone, Debug, PartialEq)]
pub struct SolveParams {
    /// Limits of the S* walk; `extended: false` for plain radiosity.
    pub walk: WalkParams,
    /// Sources and their images.
    pub light: LightParams,
    /// Whether receivers look for lamps in what shows them large; else light-side rays own that light, too.
    pub lenses: bool,
    /// Seed of all sequences.
    pub seed: u32,
    /// Base triangles that the diffuse surfaces are cut into, about.
    pub base_triangles: usize,
    /// Refinement for the light of sources; its blur is a multiple of the base edge length. Its vertices are those that it may add
    /// to a mesh of up to three times as many; to larger ones, a third of what they have, up to four times this budget.
    pub sources: RefineParams,
    /// Shadow rays per vertex.
    pub shadow_rays: u32,
    /// Points inside an element of uneven light at which that of sources is sampled for the fit, besides the middles of
    /// edges.
    pub fit_points: u32,
    /// Shadow rays at each of them.
    pub fit_rays: u32,
    /// The least-squares fit.
    pub fit: FitParams,
    /// Rays of a form factor row.
    pub row_rays: u32,
    /// Rays of a final gather.
    pub gather_rays: u32,
    /// When the coarse solver stops where `coarse` does not say otherwise.
    pub solver: SolverParams,
    /// Another form factor method or solver for the coarse solve, and whether it is watched.
    pub coarse: CoarseParams,
    /// The classical pictures instead of the final gather.
    pub reconstruction: Option<Reconstruction>,
    /// Rays of a gather at a vertex, which only holds the fit.
    pub vertex_rays: u32,
    /// Gathers inside a base element.
    pub gather_points: f32,
    /// The mesh of the gathers where surfaces are near to each other.
    pub near: NearParams,
    /// … and where light on near surfaces changes.
    pub near_light: NearLightParams,
    /// The least-squares fit of the gathers; its lengths are multiples of the base edge length.
    pub gather_fit: FitParams,
    /// Light-side rays.
    pub caustic: CausticParams,
}

impl SolveParams {
    /// The budgets of a quality.
    pub fn for_quality(quality: Quality) -> Self {
        let (base_triangles, row_rays, vertex_rays, gather_rays) = match quality {
            Quality::Sketch => (200, 32, 32, 32),
            Quality::Draft => (1_000, 32, 96, 64),
            Quality::Standard => (1_400, 64, 128, 64),
            Quality::High => (5_000, 64, 192, 256),
        };
        let (near_rounds, detail_rounds, detail_share, near_light_rounds) = match quality {
            Quality::Sketch => (0, 0, 0.0, 0),
            // A twentieth of a draft's time for a thirtieth of its error.
            Quality::Draft => (1, 2, 0.2, 0),
            Quality::Standard => (1, 4, 0.8, 4),
            Quality::High => (2, 5, 0.7, 4),
        };
        let (max_vertices, tolerance, blur, shadow_rays, inside_rounds) = match quality {
            Quality::Sketch => (4_000, 0.06, 0.04, 8, 0),
            Quality::Draft => (8_000, 0.06, 0.06, 16, 0),
            Quality::Standard => (20_000, 0.03, 0.03, 32, 1),
            Quality::High => (30_000, 0.008, 0.015, 64, 2),
        };
        // The last rounds cost a sketch a tenth of its time and change its errors by 2 %.
        let (rounds, gather_points) = if quality == Quality::Sketch { (5, 3.0) } else { (7, 4.0) };
        Self {
            walk: WalkParams::default(),
            light: LightParams::default(),
            // They would take most of a sketch's time.
            lenses: quality != Quality::Sketch,
            seed: 0,
            base_triangles,
            sources: RefineParams {
                tolerance,
                floor: 0.1,
                rounds,
                inside_rounds,
                inside_edge: 0.0,
                blur,
                max_vertices,
                min_edge: 0.0,
                short_edge: 0.0,
            },
            shadow_rays,
            fit_points: 1,
            fit_rays: shadow_rays,
            fit: FitParams::default(),
            row_rays,
            gather_rays,
            vertex_rays,
            gather_points,
            near: NearParams {
                ratio: 1.2,
                rounds: near_rounds,
                detail_rounds,
                detail_share,
                max_details: DETAILS_PER_TRIANGLE * base_triangles,
            },
            near_light: NearLightParams {
                tolerance: 0.05,
                floor: 0.1,
                ratio: 0.8,
                shortest: 0.1,
                shortest_shared: 0.25,
                rounds: near_light_rounds,
                share: 0.7,
                max_triangles: NEAR_LIGHT_PER_TRIANGLE * base_triangles,
            },
            gather_fit: FitParams { prior: 0.45, smoothing: 0.01, balance: 1.0, ..FitParams::default() },
            solver: SolverParams::default(),
            coarse: CoarseParams::default(),
            reconstruction: None,
            caustic: CausticParams::for_quality(quality),
        }
    }
}

/// What pass one did.
#[derive(Clone, Debug, Default)]
pub struct SolveReport {
    /// Rays traced, per stage.
    pub rays: Vec<(&'static str, u64)>,
    /// Patches of the coarse solve.
    pub patches: usize,
    /// Faces of the display mesh.
    pub faces: usize,
    /// Elements.
    pub elements: usize,
    /// Vertices.
    pub vertices: usize,
    /// Mean ledger of the rows, shares of the power sent.
    pub row_ledger: Ledger,
    /// Solver iterations: sweeps, or rows shot.
    pub iterations: usize,
    /// Rows that the solver asked for.
    pub solver_rows: usize,
    /// The rule that stopped the solver.
    pub stop: Option<Stop>,
    /// Residual relative to the emitted power where the solver stopped.
    pub residual: f64,
    /// Light-side rays.
    pub caustic: CausticReport,
    /// Image chains.
    pub image_chains: usize,
    /// Bodies in which receivers look for lamps.
    pub lenses: usize,
    /// Emitting triangles.
    pub emitters: usize,
    /// What a person should know.
    pub notes: Vec<String>,
}

/// The result of pass one.
#[derive(Clone, Debug)]
pub struct Solved {
    /// The solution.
    pub solution: Solution,
    /// What was done.
    pub report: SolveReport,
    /// The light as it spread, if it was to be watched.
    pub frames: Option<Frames>,
}

/// Triangles of the sources' mesh with edges above this multiple of the spacing are tested inside.
const INSIDE_EDGE: f32 = 0.25;
/// The author's edges below this multiple of the spacing are looked at where light differs along them.
const SHORT_EDGE: f32 = 0.125;
/// Vertices of fine meshes share samples of sources, and gathers, in cubes of this multiple of the spacing.
const SOURCE_CELL: f32 = 0.25;
/// … and gathers in cubes of this.
const GATHER_CELL: f32 = 0.125;
/// Triangles that details may add, per triangle of the budget, at most.
const DETAILS_PER_TRIANGLE: usize = 21;
/// … and light on near surfaces.
const NEAR_LIGHT_PER_TRIANGLE: usize = 40;
/// Most vertices that shadows may add in large scenes, as a multiple of the budget.
const MAX_BUDGETS: usize = 4;
/// Groups that share, per base triangle of the budget, at most.
const SHARED_PER_TRIANGLE: usize = 14;

/// Whether there is no light at all.
fn is_dark(lights: &Lights) -> bool {
    let scene = lights.tracer().scene();
    lights.emitters().triangle_count() == 0 && scene.sky().is_none() && scene.lights().is_empty()
}

/// Solves the light of a scene.
pub fn solve(tracer: &Tracer, params: &SolveParams, progress: &dyn Progress) -> Result<Solved, SolveError> {
    let mut report = SolveReport::default();
    let mut lights = Lights::new(tracer, params.light);
    report.image_chains = lights.chains().chains().len();
    report.emitters = lights.emitters().triangle_count();

    // Cut the diffuse surfaces into triangles.
    progress.begin("mesh", 1);
    let (mut draft, lattice) = base_mesh(tracer, params);
    let spacing = lattice.spacing;
    let ((patches, base), ()) = rayon::join(
        || rayon::join(|| PatchMesh::new(tracer, &draft, spacing), || draft.display(tracer)),
        || {
            if params.lenses && params.walk.extended {
                lights.find_lenses(&onlookers(tracer, &draft, params.seed), params.seed);
            }
        },
    );
    let of_element: Vec<PatchId> = base.roots.iter().map(|&r| patches.of_root[r as usize]).collect();
    report.patches = patches.len();
    report.lenses = lights.lenses().len();
    let set = params.coarse.method.map(|_| ElementSet::patches(tracer, &draft, &patches));
    progress.advance(1);
    if is_dark(&lights) && params.coarse.every == 0 {
        // Nothing to look for, and to refine the mesh for.
        report.stop = Some(Stop::Exact);
        report
            .notes
            .push("nothing gives light (no emission, punctual light or sky): pictures are black".into());
        let (sources, none) =
            (vec![SourceLight::default(); draft.vertices.len()], vec![Rgb::ZERO; patches.len()]);
        let Displayed { mesh, origin, .. } = base;
        let solution = assemble((mesh, &origin), &draft, &sources, &[], &patches, &none, &none);
        report.faces = solution.mesh.faces.len();
        report.elements = solution.mesh.elements.len();
        report.vertices = solution.mesh.vertices.len();
        return Ok(Solved { solution, report, frames: None });
    }

    // Finer where other surfaces are near: that is the mesh of the gathers.
    let near = Near::new(tracer, &draft, &base, spacing, params.seed);
    let distances = near.refine(tracer, &mut draft, &params.near, &lattice, params.seed);
    let mut mesh_of_gathers = draft.clone();

    // Light that sources send, refined where it varies.
    progress.begin("sources", params.sources.max_vertices as u64);
    let base_vertices = draft.vertices.len();
    let field = SourceField::new(&lights, params, &draft, spacing);
    let budget = SHARED_PER_TRIANGLE * params.base_triangles;
    let sharing = Sharing::new(tracer, &draft, spacing, SOURCE_CELL * spacing, Covers::Part, budget, &[]);
    let mut values = Values::new(sharing);
    let source_params = RefineParams {
        min_edge: tracer.extent().inner.diagonal as f32 / 2000.0,
        inside_edge: INSIDE_EDGE * spacing,
        short_edge: SHORT_EDGE * spacing,
        blur: params.sources.blur * spacing,
        max_vertices: base_vertices + vertex_budget(params.sources.max_vertices, base_vertices),
        ..params.sources
    };
    if lights.has_sources() || lights.has_skylight() || !tracer.scene().lights().is_empty() {
        split_glints(&lights, &base, &mut draft, params.seed, source_params.min_edge, base_vertices);
        refine(tracer, &mut draft, &field, &mut values, &source_params, progress)?;
    } else {
        values.values.resize(base_vertices, Rgb::ZERO);
    }
    let (mut sources, asked) = field.collect(draft.vertices.len());
    values.sharing.fill(&mut sources, |parts| {
        parts.fold(SourceLight::default(), |sum, (light, weight)| SourceLight {
            direct: sum.direct + light.direct * weight,
            mirrored: sum.mirrored + light.mirrored * weight,
            punctual: sum.punctual + light.punctual * weight,
            sky: sum.sky + light.sky * weight,
            lens: sum.lens + light.lens * weight,
            noise: std::array::from_fn(|k| sum.noise[k] + light.noise[k] * weight * weight),
            ..SourceLight::default()
        })
    });
    let mut displayed = draft.display(tracer);
    let hidden = near.hidden_vertices(&draft);

    // The fit of that, and beside it light over curved mirrors and glass, on a mesh of its own: it only wants to know about how
    // bright it is.
    progress.begin("fit", displayed.mesh.elements.len() as u64);
    let samples: Vec<Rgb> = sources[..base_vertices].iter().map(SourceLight::sum).collect();
    let (fitted, caustic) = rayon::join(
        || field.fit(&draft, &displayed, &hidden, &asked, &mut sources, spacing, progress),
        || {
            let base = mesh_of_gathers.display(tracer);
            let (walk, seed) = (params.walk, params.seed);
            caustic(&lights, &mesh_of_gathers, &base, &samples, walk, seed, &params.caustic, progress)
        },
    );
    fitted?;
    let caustic = caustic?;
    for &v in &displayed.origin {
        values.values[v as usize] = sources[v as usize].sum();
    }
    if let Some(caustic) = &caustic {
        report.caustic = caustic.report;
        values.values.iter_mut().zip(caustic.on(&draft)).for_each(|(light, more)| *light += more);
    }

    // The coarse solve.
    let sent = patch_sources(&displayed, &patches, &values.values);
    let locator = PatchLocator { mesh: &base.mesh, of_element: &of_element };
    let mut rows =
        rows(&lights, &draft, &patches, &locator, params.row_rays, params.seed, &params.walk, progress)?;
    if let (Some(method), Some(set)) = (params.coarse.method, &set) {
        let (rays, seed) = (params.row_rays, params.seed);
        rows_by(method, tracer, set, &patches, &mut rows, rays, seed, &params.walk, progress)?;
    }
    let coarse = &params.coarse;
    let solution = solve_coarse(tracer, &patches, &rows, &sent, &params.solver, coarse, progress)?;
    let CoarseSolution { indirect, steps, rows: solver_rows, residual, stop, frames, endless } = solution;
    report.iterations = steps;
    report.solver_rows = solver_rows;
    report.residual = residual;
    report.stop = Some(stop);
    if frames.len() == MAX_FRAMES {
        report.notes.push(format!("only the first {MAX_FRAMES} frames of the solver were kept"));
    }
    if endless > 0 {
        let spaces = if endless == 1 {
            "1 closed space reflects".into()
        } else {
            format!("{endless} closed spaces reflect")
        };
        report
            .notes
            .push(format!("{spaces} all light (reflectance 1): it was cut off after {steps} reflections"));
    }
    report.row_ledger = mean_ledger(&patches, &rows);

    // A finer mesh of the gathers where the light of near surfaces bends.
    let coarse_light = spread(&draft, &patches, &indirect);
    let all: Vec<Rgb> = values.values.iter().zip(coarse_light).map(|(sent, more)| *sent + more).collect();
    let light = NearLight {
        tracer,
        lights: &lights,
        displayed: &displayed,
        patches: &patches,
        irradiance: &all,
        sources: &values.values,
        mean: mean(&draft, &all),
        sharing: &values.sharing,
        spacing,
        walk: &params.walk,
        seed: params.seed,
    };
    let mut of_gathers: Vec<u32> = (0..base_vertices as u32).collect();
    if light.refine(&mut mesh_of_gathers, &near, &distances, &params.near_light) {
        of_gathers = draft.split_as(tracer, &mesh_of_gathers, base_vertices);
        displayed = draft.display(tracer);
        draft.fill(&mut sources, SourceLight::mean);
        draft.fill(&mut values.values, |a, b| (a + b) * 0.5);
    }

    // The light as it spread.
    let frames = (params.coarse.every > 0).then(|| {
        let caustic = caustic.as_ref().map(|c| c.on(&draft));
        let light = |&v: &u32| {
            let SourceLight { direct, mirrored, punctual, sky, lens, .. } = sources[v as usize];
            [direct + sky, mirrored, lens + caustic.as_ref().map_or(Rgb::ZERO, |c| c[v as usize]), punctual]
        };
        let sources = displayed.origin.iter().map(light).collect();
        Frames::new(&displayed, &draft, &patches, sources, sent.clone(), frames)
    });
    if let Some(rule) = params.reconstruction {
        report.rays = vec![
            ("shadow", sources.iter().map(|s| u64::from(s.rays)).sum()),
            ("rows", patches.len() as u64 * u64::from(params.row_rays)),
            ("light", u64::from(report.caustic.rays)),
        ];
        let caustic = caustic.as_ref().map(|c| c.on(&draft));
        let of = |value: &dyn Fn(usize) -> Rgb| {
            let values: Vec<Rgb> = (0..draft.vertices.len()).map(value).collect();
            patch_sources(&displayed, &patches, &values)
        };
        let light = [
            of(&|v| sources[v].direct + sources[v].sky),
            of(&|v| sources[v].mirrored),
            of(&|v| sources[v].lens + caustic.as_ref().map_or(Rgb::ZERO, |c| c[v])),
            indirect.clone(),
            of(&|v| sources[v].punctual),
        ];
        let result = from_patches(&base.mesh, &of_element, &light, rule);
        let result = Solution { patches: patch_radiosity(&patches, &indirect, &sent), ..result };
        report.faces = result.mesh.faces.len();
        report.elements = result.mesh.elements.len();
        report.vertices = result.mesh.vertices.len();
        return Ok(Solved { solution: result, report, frames });
    }

    // The final gather sees what sources send and the coarse solution first, then what it found at the vertices.
    let coarse = Coarse { patches: &patches, rows: &rows, indirect: &indirect };
    let sight =
        Sight { displayed: &displayed, draft: &draft, sources: &values.values, of_gathers: &of_gathers };
    let hidden = near.hidden_vertices(&mesh_of_gathers);
    let sharing =
        Sharing::new(tracer, &mesh_of_gathers, spacing, GATHER_CELL * spacing, Covers::Dim, budget, &hidden);
    let gathered = final_gather(
        &lights,
        &sight,
        &coarse,
        &mesh_of_gathers,
        &hidden,
        &sharing,
        params,
        spacing,
        progress,
    )?;
    report.rays = vec![
        ("shadow", sources.iter().map(|s| u64::from(s.rays)).sum()),
        ("rows", patches.len() as u64 * u64::from(params.row_rays)),
        ("gather", gathered.rays),
        ("light", u64::from(report.caustic.rays)),
    ];

    // The display mesh with every term.
    let Displayed { mesh, origin, .. } = displayed;
    let mut result = assemble((mesh, &origin), &draft, &sources, &gathered.terms, &patches, &indirect, &sent);
    if let Some(caustic) = &caustic {
        result = caustic.add_to(tracer, &mut draft, &origin, result);
    }
    report.faces = result.mesh.faces.len();
    report.elements = result.mesh.elements.len();
    report.vertices = result.mesh.vertices.len();
    Ok(Solved { solution: result, report, frames })
}

/// Receivers that say which bodies are lenses.
const ONLOOKERS: u32 = 32;

/// Some receivers, spread evenly over the surfaces, of large ground only as many as [`Draft::weight`] says.
fn onlookers(tracer: &Tracer, draft: &Draft, seed: u32) -> Vec<Receiver> {
    let key = Key::new(seed, Purpose::Lens, 1 << 32);
    let mut sum = 0.0;
    let reach: Vec<f64> = draft
        .leaves
        .iter()
        .map(|leaf| {
            sum += f64::from(draft.weight(leaf));
            sum
        })
        .collect();
    if reach.is_empty() {
        return Vec::new();
    }
    (0..ONLOOKERS)
        .map(|index| {
            let pick = f64::from(key.point1(index)) * sum;
            let leaf = reach.partition_point(|&s| s <= pick).min(reach.len() - 1);
            draft.receiver_in_leaf(tracer, leaf as u32, [1.0 / 3.0; 3])
        })
        .collect()
}

/// Vertices that shadows may add: `least`, more where many things cast shadows.
fn vertex_budget(least: usize, base_vertices: usize) -> usize {
    (base_vertices / 3).clamp(least, MAX_BUDGETS * least)
}

/// Mean irradiance of sources on each patch.
fn patch_sources(displayed: &Displayed, patches: &PatchMesh, values: &[Rgb]) -> Vec<Rgb> {
    let mut sums = vec![Rgb::ZERO; patches.len()];
    for (element, &root) in displayed.roots.iter().enumerate() {
        let corners = displayed.mesh.elements[element].vertices;
        let mean = corners.iter().map(|&v| values[displayed.origin[v as usize] as usize]).sum::<Rgb>() / 3.0;
        let patch = patches.of_root[root as usize].0 as usize;
        sums[patch] +=
            mean * (displayed.mesh.area(element as u32) / patches.areas[patch].max(f32::MIN_POSITIVE));
    }
    sums
}

/// Area-weighted mean of the rows' ledgers.
fn mean_ledger(patches: &PatchMesh, rows: &[Row]) -> Ledger {
    let mut sum = Ledger::default();
    let total: f64 = patches.areas.iter().map(|a| f64::from(*a)).sum();
    for (row, &area) in rows.iter().zip(&patches.areas) {
        let share = f64::from(area) / total.max(f64::MIN_POSITIVE);
        sum.add(&row.ledger.scaled(share));
    }
    sum
}

/// Fills every vertex of the display mesh with every term.
fn assemble(
    (mesh, origin): (DisplayMesh, &[u32]),
    draft: &Draft,
    sources: &[SourceLight],
    gathered: &[Option<[Rgb; 4]>],
    patches: &PatchMesh,
    indirect: &[Rgb],
    sent: &[Rgb],
) -> Solution {
    // Vertices without a gather of their own are the mean of the edge that they halve.
    let mut terms: Vec<[Rgb; 4]> = Vec::with_capacity(draft.vertices.len());
    for (index, vertex) in draft.vertices.iter().enumerate() {
        let own = gathered.get(index).copied().flatten();
        let value = own.unwrap_or_else(|| match vertex.parents {
            Some([a, b]) => std::array::from_fn(|t| (terms[a as usize][t] + terms[b as usize][t]) * 0.5),
            None => [Rgb::ZERO; 4],
        });
        terms.push(value);
    }
    let of = |value: &(dyn Fn(&SourceLight, [Rgb; 4]) -> Rgb + Sync)| -> Vec<Rgb> {
        let own = |&v: &u32| value(&sources[v as usize], terms[v as usize]);
        origin.par_iter().with_min_len(1024).map(own).collect()
    };
    let mut solution = Solution { mesh, ..Solution::default() };
    let [d, m, c, i] = Term::ALL.map(Term::index);
    solution.gathered[d] = of(&|source, terms| source.sky + terms[d]);
    solution.gathered[m] = of(&|_, terms| terms[m]);
    solution.irradiance[d] = of(&|source, terms| source.direct + (source.sky + terms[d]));
    solution.irradiance[m] = of(&|source, terms| source.mirrored + terms[m]);
    solution.irradiance[c] = of(&|source, terms| source.lens + terms[c]);
    solution.irradiance[i] = of(&|_, terms| terms[i]);
    solution.punctual = of(&|source, _| source.punctual);
    for values in solution.gathered.iter_mut().filter(|values| values.iter().all(|v| *v == Rgb::ZERO)) {
        values.clear();
    }
    solution.patches = patch_radiosity(patches, indirect, sent);
    solution
}

/// Radiosity of the patches: what they reflect, and what comes through from the other side.
fn patch_radiosity(patches: &PatchMesh, indirect: &[Rgb], sent: &[Rgb]) -> PatchRadiosity {
    PatchRadiosity {
        areas: patches.areas.clone(),
        centers: patches.centers.iter().map(|c| c.to_array()).collect(),
        radiosity: (0..patches.len())
            .map(|i| {
                let through = patches.opposite[i].map_or(Rgb::ZERO, |other| {
                    let other = other.0 as usize;
                    patches.transmittances[i] * (sent[other] + indirect[other])
                });
                (patches.reflectances[i] * (sent[i] + indirect[i]) + through).to_array()
            })
            .collect(),
    }
}

/// Direct, mirrored, caustic, indirect and punctual light of the patches on the base mesh by one of the classical rules.
fn from_patches(
    mesh: &DisplayMesh,
    of_element: &[PatchId],
    light: &[Vec<Rgb>; 5],
    rule: Reconstruction,
) -> Solution {
    let cells = Cells::new(mesh);
    let shown = light.each_ref().map(|light| {
        let elements: Vec<Rgb> = of_element.iter().map(|p| light[p.0 as usize]).collect();
        match rule {
            Reconstruction::Flat => cells.flat(mesh, &elements).into_iter().flat_map(|v| [v; 3]).collect(),
            Reconstruction::Averaged => cells.at_vertices(mesh, &elements, false),
            Reconstruction::Extrapolated => cells.at_vertices(mesh, &elements, true),
        }
    });
    let mesh = if rule == Reconstruction::Flat { unshared(mesh) } else { mesh.clone() };
    let [direct, mirrored, caustic, indirect, punctual] = shown;
    Solution { mesh, irradiance: [direct, mirrored, caustic, indirect], punctual, ..Solution::default() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn budgets_follow_what_the_author_has_made_within_bounds() {
        // A simple room, one of many things, and a city.
        assert_eq!(
            [100, 36_000, 10_000_000].map(|base| vertex_budget(10_000, base)),
            [10_000, 12_000, 40_000]
        );
    }
}
