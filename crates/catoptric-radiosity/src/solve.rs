//! Pass one from end to end: mesh, sources, coarse solve, final gather.

use rayon::prelude::*;

use catoptric_light::irradiance::Scratch;
use catoptric_light::{LightParams, Lights};
use catoptric_scene::{Cancelled, Progress, Rgb, TriangleId};
use catoptric_solution::{PatchRadiosity, Quality, Solution, Term};
use catoptric_trace::sequence::{Key, Purpose, triangle_point};
use catoptric_trace::walk::WalkParams;
use catoptric_trace::{Ledger, Tracer};

use crate::caustic::{CausticParams, CausticReport, caustic};
use crate::draft::{Displayed, Draft};
use crate::fit::{FitParams, FitSample, fit};
use crate::gather::{DiffuseLight, Gathered, gather};
use crate::media::find_media;
use crate::patch::{PatchId, PatchMesh};
use crate::refine::{Field, RefineParams, Values, refine};
use crate::rows::{PatchLocator, Row, rows};
use crate::solver::{SolverParams, solve_patches};

/// Parameters of pass one.
#[derive(Clone, Debug, PartialEq)]
pub struct SolveParams {
    /// Limits of the S* walk; `extended: false` for plain radiosity.
    pub walk: WalkParams,
    /// Sources and their images.
    pub light: LightParams,
    /// Seed of all sequences.
    pub seed: u32,
    /// Base triangles that the diffuse surfaces are cut into, about.
    pub base_triangles: usize,
    /// Refinement for the light of sources.
    pub sources: RefineParams,
    /// Shadow rays per vertex.
    pub shadow_rays: u32,
    /// Points inside an element at which the light of sources is sampled for the fit, and shadow rays at each.
    pub fit_points: u32,
    /// Shadow rays at each of them.
    pub fit_rays: u32,
    /// The least-squares fit.
    pub fit: FitParams,
    /// Rays of a form factor row.
    pub row_rays: u32,
    /// Rays of a final gather.
    pub gather_rays: u32,
    /// The coarse solver.
    pub solver: SolverParams,
    /// Base edges are split for the gather where they are longer than this multiple of the harmonic mean distance of what
    /// is seen from them.
    pub gather_reach: f32,
    /// Times.
    pub gather_rounds: u32,
    /// Light-side rays.
    pub caustic: CausticParams,
}

impl SolveParams {
    /// The budgets of a quality.
    pub fn for_quality(quality: Quality) -> Self {
        let (base_triangles, max_vertices, tolerance, shadow_rays, row_rays, gather_rays, gather_rounds) =
            match quality {
                Quality::Draft => (500, 2_000, 0.06, 16, 64, 64, 0),
                Quality::Standard => (1_200, 6_000, 0.02, 64, 64, 400, 1),
                Quality::High => (5_000, 60_000, 0.006, 256, 128, 1_600, 2),
            };
        Self {
            walk: WalkParams::default(),
            light: LightParams::default(),
            seed: 0,
            base_triangles,
            sources: RefineParams { tolerance, floor: 0.1, rounds: 7, max_vertices, min_edge: 0.0 },
            shadow_rays,
            fit_points: 2,
            fit_rays: shadow_rays / 2,
            fit: FitParams::default(),
            row_rays,
            gather_rays,
            solver: SolverParams::default(),
            gather_reach: 1.0,
            gather_rounds,
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
    /// Solver iterations.
    pub iterations: usize,
    /// Residual relative to the emitted power where the solver stopped.
    pub residual: f64,
    /// Light-side rays.
    pub caustic: CausticReport,
    /// Image chains.
    pub image_chains: usize,
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
}

/// Light of sources at a vertex.
#[derive(Clone, Copy, Debug, Default)]
struct SourceLight {
    direct: Rgb,
    mirrored: Rgb,
    punctual: Rgb,
    rays: u32,
}

/// The field that refinement looks at while it keeps what was found.
struct SourceField<'a> {
    lights: &'a Lights<'a>,
    params: &'a SolveParams,
    found: std::sync::Mutex<Vec<(u32, SourceLight)>>,
}

impl SourceField<'_> {
    fn light(&self, draft: &Draft, vertex: u32) -> SourceLight {
        let tracer = self.lights.tracer();
        let receiver = draft.receiver(tracer, vertex);
        let key = Key::new(self.params.seed, Purpose::Emitter, u64::from(vertex));
        let mut scratch = Scratch::default();
        let mut light = SourceLight::default();
        if self.lights.has_sources() {
            light.direct =
                self.lights.direct(&receiver, self.params.shadow_rays, key, &mut scratch).irradiance;
            light.mirrored = self
                .lights
                .mirrored(&receiver, self.params.shadow_rays, key.child(1), &mut scratch)
                .irradiance;
        }
        let punctual = self.lights.punctual(&receiver, &mut scratch);
        light.punctual = punctual.direct + punctual.mirrored;
        light.rays = scratch.rays as u32;
        light
    }
}

impl Field for SourceField<'_> {
    fn evaluate(&self, draft: &Draft, vertex: u32) -> Rgb {
        let light = self.light(draft, vertex);
        if let Ok(mut found) = self.found.lock() {
            found.push((vertex, light));
        }
        light.direct + light.mirrored + light.punctual
    }
}

/// Solves the light of a scene.
pub fn solve(tracer: &Tracer, params: &SolveParams, progress: &dyn Progress) -> Result<Solved, Cancelled> {
    let mut report = SolveReport::default();
    let lights = Lights::new(tracer, params.light);
    report.image_chains = lights.chains().chains().len();
    report.emitters = lights.emitters().triangle_count();

    // Cut the diffuse surfaces into triangles.
    progress.begin("mesh", 1);
    let spacing = spacing(tracer, params.base_triangles);
    let mut draft = Draft::new(tracer, spacing);
    find_media(tracer, &mut draft.faces);
    let patches = PatchMesh::new(tracer, &draft, spacing);
    let base = draft.display(tracer);
    let of_element: Vec<PatchId> = base.roots.iter().map(|&r| patches.of_root[r as usize]).collect();
    report.patches = patches.len();
    progress.advance(1);

    // Light that sources send, refined where it varies.
    progress.begin("sources", params.sources.max_vertices as u64);
    let field = SourceField { lights: &lights, params, found: std::sync::Mutex::default() };
    let mut values = Values { values: Vec::new() };
    let base_vertices = draft.vertices.len();
    let source_params = RefineParams {
        min_edge: tracer.diagonal() / 2000.0,
        max_vertices: params.sources.max_vertices + base_vertices,
        ..params.sources
    };
    let unrefined = draft.clone();
    refine(tracer, &mut draft, &field, &mut values, &source_params, progress)?;
    let mut sources = collect(&field, draft.vertices.len());

    // Light over curved mirrors and glass.
    let (walk, seed) = (params.walk, params.seed);
    let other = &values.values[..base_vertices];
    let caustic = caustic(&lights, &unrefined, &base, other, walk, seed, &params.caustic, progress)?;
    let mut source_light = values.values.clone();
    if let Some(caustic) = &caustic {
        report.caustic = caustic.report;
        source_light.iter_mut().zip(caustic.on(&draft)).for_each(|(light, more)| *light += more);
    }

    // The coarse solve.
    let displayed = draft.display(tracer);
    let sent = patch_sources(&displayed, &patches, &source_light);
    let locator = PatchLocator { mesh: &base.mesh, of_element: &of_element };
    let rows =
        rows(&lights, &draft, &patches, &locator, params.row_rays, params.seed, &params.walk, progress)?;
    let solution = solve_patches(&patches, &rows, &sent, &params.solver);
    report.iterations = solution.sweeps;
    report.residual = solution.residual;
    report.row_ledger = mean_ledger(&patches, &rows);

    // What gathers see: sources at the refined vertices, and the coarse solution.
    let coarse = spread(&draft, &patches, &solution.indirect);
    let seen: Vec<Rgb> =
        displayed.origin.iter().map(|&v| source_light[v as usize] + coarse[v as usize]).collect();
    let light = DiffuseLight { mesh: &displayed.mesh, irradiance: &seen };

    // The final gather, at base vertices and where surfaces are near.
    progress.begin("gather", base_vertices as u64);
    let mut gathered: Vec<Option<Gathered>> = vec![None; draft.vertices.len()];
    let gather_at = |draft: &Draft, wanted: &[u32]| -> Result<Vec<Gathered>, Cancelled> {
        wanted
            .par_iter()
            .with_min_len(4)
            .map(|&vertex| {
                if progress.is_cancelled() {
                    return Err(Cancelled);
                }
                let receiver = draft.receiver(tracer, vertex);
                let key = Key::new(params.seed, Purpose::Hemisphere, u64::from(vertex));
                let result = gather(&lights, &light, &receiver, params.gather_rays, key, &params.walk);
                progress.advance(1);
                Ok(result)
            })
            .collect()
    };
    let mut wanted: Vec<u32> = base_corners(&draft);
    let mut gathers = 0;
    for round in 0..=params.gather_rounds {
        let results = gather_at(&draft, &wanted)?;
        gathers += wanted.len();
        for (&vertex, result) in wanted.iter().zip(results) {
            gathered[vertex as usize] = Some(result);
        }
        if round == params.gather_rounds {
            break;
        }
        let marks = near_edges(&draft, &gathered, params.gather_reach, spacing, round);
        draft.split(tracer, &marks);
        values.extend(&draft, &field, progress)?;
        gathered.resize(draft.vertices.len(), None);
        wanted = marks
            .iter()
            .filter_map(|&(a, b)| draft.known_midpoint(a, b))
            .filter(|&m| gathered[m as usize].is_none())
            .collect();
        wanted.sort_unstable();
        wanted.dedup();
    }
    sources = merged(sources, &field, draft.vertices.len());
    report.rays = vec![
        ("shadow", sources.iter().map(|s| u64::from(s.rays)).sum()),
        ("rows", patches.len() as u64 * u64::from(params.row_rays)),
        ("gather", gathers as u64 * u64::from(params.gather_rays)),
        ("light", u64::from(report.caustic.rays)),
    ];

    // The display mesh with every term.
    let mut result = assemble(tracer, &draft, &sources, &gathered, &patches, &solution.indirect, &sent);
    fit_sources(&lights, &draft, &sources, &mut result, params, spacing, progress)?;
    if let Some(caustic) = &caustic {
        result = caustic.add_to(tracer, &mut draft, result);
    }
    report.faces = result.mesh.faces.len();
    report.elements = result.mesh.elements.len();
    report.vertices = result.mesh.vertices.len();
    Ok(Solved { solution: result, report })
}

/// Replaces the point samples of direct and mirrored light by their least-squares fit.
fn fit_sources(
    lights: &Lights,
    draft: &Draft,
    sources: &[SourceLight],
    result: &mut Solution,
    params: &SolveParams,
    spacing: f32,
    progress: &dyn Progress,
) -> Result<(), Cancelled> {
    if !lights.has_sources() || params.fit_points == 0 {
        return Ok(());
    }
    let tracer = lights.tracer();
    let displayed = draft.display(tracer);
    let mesh = &displayed.mesh;
    progress.begin("fit", mesh.elements.len() as u64);
    // Small elements of finely tessellated surfaces share: as many points as their area is worth, but refined ones, which
    // are small because light varies there, get all.
    let whole = 0.5 * spacing * spacing;
    let level_of: Vec<u8> = displayed.leaves.iter().map(|&l| draft.leaves[l as usize].level).collect();
    let samples: Vec<FitSample> = (0..mesh.elements.len() as u32)
        .flat_map(|element| {
            let area = mesh.area(element);
            let key = Key::new(params.seed, Purpose::ElementPoint, u64::from(element));
            let expected = params.fit_points as f32 * (area / whole).min(1.0);
            let count = if level_of[element as usize] > 0 {
                params.fit_points
            } else {
                (expected + key.uniform(0)).floor() as u32
            };
            (0..count).map(move |index| {
                let (u, v) = triangle_point(key.point2(index));
                FitSample { element, weights: [1.0 - u - v, u, v], area: area / count as f32 }
            })
        })
        .collect();
    let found: Vec<(Rgb, Rgb)> = samples
        .par_iter()
        .enumerate()
        .with_min_len(32)
        .map_init(Scratch::default, |scratch, (index, sample)| {
            if progress.is_cancelled() {
                return (Rgb::ZERO, Rgb::ZERO);
            }
            let receiver = draft.receiver_inside(tracer, &displayed, sample.element, sample.weights);
            let key = Key::new(params.seed, Purpose::Emitter, index as u64 | 1 << 40);
            let direct = lights.direct(&receiver, params.fit_rays, key, scratch).irradiance;
            let mirrored = lights.mirrored(&receiver, params.fit_rays, key.child(1), scratch).irradiance;
            (direct, mirrored)
        })
        .collect();
    if progress.is_cancelled() {
        return Err(Cancelled);
    }
    for (term, values) in [
        (Term::Direct, found.iter().map(|f| f.0).collect::<Vec<Rgb>>()),
        (Term::Mirrored, found.iter().map(|f| f.1).collect()),
    ] {
        let prior: Vec<Rgb> = displayed
            .origin
            .iter()
            .map(|&v| {
                let source = &sources[v as usize];
                if term == Term::Direct { source.direct } else { source.mirrored }
            })
            .collect();
        if prior.iter().all(|p| *p == Rgb::ZERO) && values.iter().all(|v| *v == Rgb::ZERO) {
            continue;
        }
        let fitted = fit(mesh, &samples, &values, &prior, &params.fit);
        // What the gather added to the term (the dim sky, chains on no list) stays.
        for ((kept, fitted), prior) in result.irradiance[term.index()].iter_mut().zip(fitted).zip(prior) {
            *kept += fitted - prior;
        }
    }
    Ok(())
}

/// Edge length for which the diffuse area gives about `count` triangles.
fn spacing(tracer: &Tracer, count: usize) -> f32 {
    let scene = tracer.scene();
    let area: f64 = (0..scene.triangles().len())
        .map(|t| TriangleId(t as u32))
        .filter(|&t| scene.material_of(t).may_be_diffuse())
        .map(|t| f64::from(scene.area(t)) * if tracer.has_back(t) { 2.0 } else { 1.0 })
        .sum();
    // A right triangle with legs h has the area h²/2.
    ((2.0 * area / count.max(1) as f64).sqrt() as f32).max(f32::MIN_POSITIVE)
}

fn collect(field: &SourceField, count: usize) -> Vec<SourceLight> {
    merged(Vec::new(), field, count)
}

/// Sorts what the field found by vertex.
fn merged(mut known: Vec<SourceLight>, field: &SourceField, count: usize) -> Vec<SourceLight> {
    known.resize(count, SourceLight::default());
    if let Ok(mut found) = field.found.lock() {
        for (vertex, light) in found.drain(..) {
            known[vertex as usize] = light;
        }
    }
    known
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

/// Patch values at the vertices of the draft: means over the base triangles around, then along the hierarchy.
fn spread(draft: &Draft, patches: &PatchMesh, values: &[Rgb]) -> Vec<Rgb> {
    let mut sums = vec![(Rgb::ZERO, 0.0_f32); draft.vertices.len()];
    for (root, corners) in draft.base.iter().enumerate() {
        let patch = patches.of_root[root].0 as usize;
        for &v in corners {
            sums[v as usize].0 += values[patch];
            sums[v as usize].1 += 1.0;
        }
    }
    let mut result: Vec<Rgb> = Vec::with_capacity(sums.len());
    for (index, (sum, count)) in sums.iter().enumerate() {
        let value = if *count > 0.0 {
            *sum / *count
        } else {
            draft.vertices[index]
                .parents
                .map_or(Rgb::ZERO, |[a, b]| (result[a as usize] + result[b as usize]) * 0.5)
        };
        result.push(value);
    }
    result
}

/// Corners of base triangles, ascending.
fn base_corners(draft: &Draft) -> Vec<u32> {
    let mut corners: Vec<u32> = draft.base.iter().flatten().copied().collect();
    corners.sort_unstable();
    corners.dedup();
    corners
}

/// Edges along which other surfaces are near: the irradiance from them bends on the scale of their distance.
fn near_edges(
    draft: &Draft,
    gathered: &[Option<Gathered>],
    reach: f32,
    spacing: f32,
    round: u32,
) -> Vec<(u32, u32)> {
    let shortest = spacing * 0.6_f32.powi(round as i32 + 1) * 0.5;
    let base: Vec<(u32, u32)> = draft.edges();
    base.into_iter()
        .filter(|&(a, b)| {
            let (Some(p), Some(q)) = (&gathered[a as usize], &gathered[b as usize]) else { return false };
            let [x, y] = [a, b].map(|v| draft.vertices[v as usize].position);
            let length = (y - x).length();
            length > shortest && length > reach * p.distance.min(q.distance)
        })
        .collect()
}

/// Fills every vertex of the display mesh with every term.
fn assemble(
    tracer: &Tracer,
    draft: &Draft,
    sources: &[SourceLight],
    gathered: &[Option<Gathered>],
    patches: &PatchMesh,
    indirect: &[Rgb],
    sent: &[Rgb],
) -> Solution {
    // Vertices without a gather of their own are the mean of the edge that they halve.
    let mut terms: Vec<[Rgb; 4]> = Vec::with_capacity(draft.vertices.len());
    for (index, vertex) in draft.vertices.iter().enumerate() {
        let own = gathered[index].map(|g| [g.direct, g.mirrored, g.caustic, g.indirect]);
        let value = own.unwrap_or_else(|| match vertex.parents {
            Some([a, b]) => std::array::from_fn(|t| (terms[a as usize][t] + terms[b as usize][t]) * 0.5),
            None => [Rgb::ZERO; 4],
        });
        terms.push(value);
    }
    let displayed = draft.display(tracer);
    let mut solution = Solution { mesh: displayed.mesh, ..Solution::default() };
    for &v in &displayed.origin {
        let source = &sources[v as usize];
        let [direct, mirrored, caustic, indirect] = terms[v as usize];
        solution.irradiance[Term::Direct.index()].push(source.direct + direct);
        solution.irradiance[Term::Mirrored.index()].push(source.mirrored + mirrored);
        solution.irradiance[Term::Caustic.index()].push(caustic);
        solution.irradiance[Term::Indirect.index()].push(indirect);
        solution.punctual.push(source.punctual);
    }
    solution.patches = PatchRadiosity {
        areas: patches.areas.clone(),
        centers: patches.centers.iter().map(|c| c.to_array()).collect(),
        radiosity: (0..patches.len())
            .map(|i| (patches.reflectances[i] * (sent[i] + indirect[i])).to_array())
            .collect(),
    };
    solution
}
