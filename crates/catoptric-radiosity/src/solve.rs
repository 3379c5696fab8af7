//! Pass one from end to end: mesh, sources, coarse solve, final gather.

use rayon::prelude::*;

use catoptric_light::irradiance::Scratch;
use catoptric_light::{LightParams, Lights, Receiver};
use catoptric_scene::{Cancelled, Progress, Rgb, TriangleId};
use catoptric_solution::{DisplayMesh, PatchRadiosity, Quality, Solution, Term};
use catoptric_trace::sequence::{Key, Purpose, triangle_point};
use catoptric_trace::walk::WalkParams;
use catoptric_trace::{Ledger, Tracer};

use crate::caustic::{CausticParams, CausticReport, caustic};
pub use crate::coarse::SolveError;
use crate::coarse::{CoarseParams, CoarseSolution, MAX_FRAMES, rows_by, solve_coarse};
use crate::draft::{Displayed, Draft, drawn_inside};
use crate::final_gather::{Coarse, HIDDEN_TRUST, Sight, final_gather};
use crate::fit::{FitParams, FitSample, fit};
use crate::frames::Frames;
use crate::method::ElementSet;
use crate::near::{Near, NearParams};
use crate::patch::{PatchId, PatchMesh};
use crate::reconstruct::{Cells, Reconstruction, unshared};
use crate::refine::{Field, RefineParams, Values, mean, refine};
use crate::rows::{PatchLocator, Row, rows};
use crate::sharing::Sharing;
use crate::solver::{SolverParams, Stop};

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
    /// The least-squares fit of the gathers; its smoothing is a multiple of the base edge length.
    pub gather_fit: FitParams,
    /// Light-side rays.
    pub caustic: CausticParams,
}

impl SolveParams {
    /// The budgets of a quality.
    pub fn for_quality(quality: Quality) -> Self {
        let (base_triangles, max_vertices, tolerance, shadow_rays, row_rays, gather_rays, near_rounds) =
            match quality {
                Quality::Draft => (700, 5_000, 0.06, 16, 64, 48, 1),
                Quality::Standard => (1_200, 4_500, 0.02, 16, 64, 128, 2),
                Quality::High => (3_500, 14_000, 0.008, 32, 128, 256, 3),
            };
        let inside_rounds = match quality {
            Quality::Draft => 0,
            Quality::Standard => 1,
            Quality::High => 2,
        };
        Self {
            walk: WalkParams::default(),
            light: LightParams::default(),
            seed: 0,
            base_triangles,
            sources: RefineParams {
                tolerance,
                floor: 0.1,
                rounds: 7,
                inside_rounds,
                inside_edge: 0.0,
                max_vertices,
                min_edge: 0.0,
            },
            shadow_rays,
            fit_points: 2,
            fit_rays: shadow_rays,
            fit: FitParams::default(),
            row_rays,
            gather_rays,
            vertex_rays: gather_rays,
            gather_points: 4.0,
            near: NearParams {
                ratio: 1.2,
                rounds: near_rounds,
                detail_rounds: near_rounds + 2,
                detail_share: 1.0,
                max_details: DETAILS_PER_TRIANGLE * base_triangles,
            },
            gather_fit: FitParams { prior: 0.1, smoothing: 0.06, ..FitParams::default() },
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

/// Light of sources at a vertex.
#[derive(Clone, Copy, Debug, Default)]
struct SourceLight {
    direct: Rgb,
    mirrored: Rgb,
    punctual: Rgb,
    rays: u32,
}

impl SourceLight {
    fn sum(&self) -> Rgb {
        self.area_sources() + self.punctual
    }

    fn area_sources(&self) -> Rgb {
        self.direct + self.mirrored
    }
}

/// The field that refinement looks at while it keeps what was found.
struct SourceField<'a> {
    lights: &'a Lights<'a>,
    params: &'a SolveParams,
    found: std::sync::Mutex<Vec<(u32, SourceLight)>>,
}

impl SourceField<'_> {
    fn light(&self, receiver: &Receiver, rays: u32, key: Key) -> SourceLight {
        let mut scratch = Scratch::default();
        let mut light = SourceLight::default();
        if self.lights.has_sources() {
            light.direct = self.lights.direct(receiver, rays, key, &mut scratch).irradiance;
            light.mirrored = self.lights.mirrored(receiver, rays, key.child(1), &mut scratch).irradiance;
        }
        let punctual = self.lights.punctual(receiver, &mut scratch);
        light.punctual = punctual.direct + punctual.mirrored;
        light.rays = scratch.rays as u32;
        light
    }
}

impl Field for SourceField<'_> {
    fn evaluate(&self, draft: &Draft, vertex: u32) -> Rgb {
        let receiver = draft.receiver(self.lights.tracer(), vertex);
        let key = Key::new(self.params.seed, Purpose::Emitter, u64::from(vertex));
        let light = self.light(&receiver, self.params.shadow_rays, key);
        if let Ok(mut found) = self.found.lock() {
            found.push((vertex, light));
        }
        light.sum()
    }

    fn evaluate_inside(&self, draft: &Draft, leaf: u32, weights: [f32; 3]) -> Rgb {
        let receiver = draft.receiver_in_leaf(self.lights.tracer(), leaf, weights);
        let entity =
            u64::from(leaf) << 3 | (weights[0].to_bits() ^ weights[1].to_bits()) as u64 & 7 | 1 << 44;
        let key = Key::new(self.params.seed, Purpose::Emitter, entity);
        self.light(&receiver, self.params.shadow_rays, key).sum()
    }
}

/// Triangles of the sources' mesh with edges above this multiple of the spacing are tested inside.
const INSIDE_EDGE: f32 = 0.25;
/// Vertices of fine meshes share samples of sources, and gathers, in cubes of this multiple of the spacing.
const SOURCE_CELL: f32 = 0.25;
/// … and gathers in cubes of this.
const GATHER_CELL: f32 = 0.125;
/// Relative difference between the least and the most light around an element below which its edges tell enough.
const EVEN: f32 = 0.2;
/// Triangles that details may add, per triangle of the budget, at most.
const DETAILS_PER_TRIANGLE: usize = 18;
/// Groups that share, per base triangle of the budget, at most.
const SHARED_PER_TRIANGLE: usize = 14;

/// Solves the light of a scene.
pub fn solve(tracer: &Tracer, params: &SolveParams, progress: &dyn Progress) -> Result<Solved, SolveError> {
    let mut report = SolveReport::default();
    let lights = Lights::new(tracer, params.light);
    report.image_chains = lights.chains().chains().len();
    report.emitters = lights.emitters().triangle_count();

    // Cut the diffuse surfaces into triangles.
    progress.begin("mesh", 1);
    let spacing = spacing(tracer, params.base_triangles);
    let (mut draft, patches) = coarse_patches(tracer, params.base_triangles);
    let base = draft.display(tracer);
    let of_element: Vec<PatchId> = base.roots.iter().map(|&r| patches.of_root[r as usize]).collect();
    report.patches = patches.len();
    let set = params.coarse.method.map(|_| ElementSet::patches(tracer, &draft, &patches));
    progress.advance(1);

    // Finer where other surfaces are near: that is the mesh of the gathers.
    let near = Near::new(tracer, &draft, &base, spacing, params.seed);
    let mesh_of_gathers = {
        near.refine(tracer, &mut draft, &params.near, spacing, params.seed);
        draft.clone()
    };

    // Light that sources send, refined where it varies.
    progress.begin("sources", params.sources.max_vertices as u64);
    let field = SourceField { lights: &lights, params, found: std::sync::Mutex::default() };
    let base_vertices = draft.vertices.len();
    let budget = SHARED_PER_TRIANGLE * params.base_triangles;
    let sharing = Sharing::new(&draft, spacing, SOURCE_CELL * spacing, budget, &[]);
    let mut values = Values { values: Vec::new(), sharing };
    let source_params = RefineParams {
        min_edge: tracer.diagonal() / 2000.0,
        inside_edge: INSIDE_EDGE * spacing,
        max_vertices: params.sources.max_vertices + base_vertices,
        ..params.sources
    };
    if lights.has_sources() || !tracer.scene().lights().is_empty() {
        refine(tracer, &mut draft, &field, &mut values, &source_params, progress)?;
    } else {
        values.values.resize(base_vertices, Rgb::ZERO);
    }
    let (mut sources, asked) = collect(&field, draft.vertices.len());
    values.sharing.fill(&mut sources, |parts| {
        parts.fold(SourceLight::default(), |sum, (light, weight)| SourceLight {
            direct: sum.direct + light.direct * weight,
            mirrored: sum.mirrored + light.mirrored * weight,
            punctual: sum.punctual + light.punctual * weight,
            rays: 0,
        })
    });
    let displayed = draft.display(tracer);
    let hidden = near.hidden_vertices(&draft);
    fit_sources(&lights, &draft, &displayed, &hidden, &asked, &mut sources, params, spacing, progress)?;
    for &v in &displayed.origin {
        values.values[v as usize] = sources[v as usize].sum();
    }

    // Light over curved mirrors and glass, on a mesh of its own.
    let shown = mesh_of_gathers.display(tracer);
    let caustic = caustic(
        &lights,
        &mesh_of_gathers,
        &shown,
        &values.values[..base_vertices],
        params.walk,
        params.seed,
        &params.caustic,
        progress,
    )?;
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
    let CoarseSolution { indirect, steps, rows: solver_rows, residual, stop, frames } = solution;
    report.iterations = steps;
    report.solver_rows = solver_rows;
    report.residual = residual;
    report.stop = Some(stop);
    if frames.len() == MAX_FRAMES {
        report.notes.push(format!("only the first {MAX_FRAMES} frames of the solver were kept"));
    }
    report.row_ledger = mean_ledger(&patches, &rows);

    // The light as it spread.
    let frames = (params.coarse.every > 0).then(|| {
        let caustic = caustic.as_ref().map(|c| c.on(&draft));
        let light = |&v: &u32| {
            let SourceLight { direct, mirrored, punctual, .. } = sources[v as usize];
            [direct, mirrored, caustic.as_ref().map_or(Rgb::ZERO, |c| c[v as usize]), punctual]
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
            of(&|v| sources[v].direct),
            of(&|v| sources[v].mirrored),
            of(&|v| caustic.as_ref().map_or(Rgb::ZERO, |c| c[v])),
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
    let sight = Sight { displayed: &displayed, draft: &draft, sources: &values.values };
    let sharing = Sharing::new(&mesh_of_gathers, spacing, GATHER_CELL * spacing, budget, &hidden);
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
    let mut result = assemble(displayed, &draft, &sources, &gathered.terms, &patches, &indirect, &sent);
    if let Some(caustic) = &caustic {
        result = caustic.add_to(tracer, &mut draft, result);
    }
    report.faces = result.mesh.faces.len();
    report.elements = result.mesh.elements.len();
    report.vertices = result.mesh.vertices.len();
    Ok(Solved { solution: result, report, frames })
}

/// Replaces the point samples of direct and mirrored light by their least-squares fit.
fn fit_sources(
    lights: &Lights,
    draft: &Draft,
    displayed: &Displayed,
    hidden: &[bool],
    asked: &[bool],
    sources: &mut [SourceLight],
    params: &SolveParams,
    spacing: f32,
    progress: &dyn Progress,
) -> Result<(), Cancelled> {
    if !lights.has_sources() {
        return Ok(());
    }
    let tracer = lights.tracer();
    let mesh = &displayed.mesh;
    progress.begin("fit", mesh.elements.len() as u64);
    // Small elements of finely tessellated surfaces share: as many points as their area is worth, but refined ones, which
    // are small because light varies there, get all.
    let whole = 0.5 * spacing * spacing;
    let level_of: Vec<u8> = displayed.leaves.iter().map(|&l| draft.leaves[l as usize].level).collect();
    let sums: Vec<Rgb> = sources.iter().map(SourceLight::sum).collect();
    let floor = (params.sources.floor * mean(draft, &sums)).max(f32::MIN_POSITIVE);
    let mut samples: Vec<FitSample> = Vec::new();
    // The middles of edges that refinement has looked at and left whole are samples already: with their three middles,
    // elements know all quadratic light (the midpoint rule). Where light is uneven, points inside are asked besides.
    let mut middles: Vec<(FitSample, u32)> = Vec::new();
    for element in 0..mesh.elements.len() as u32 {
        let corners = mesh.elements[element as usize].vertices.map(|v| displayed.origin[v as usize]);
        let area = mesh.area(element);
        let key = Key::new(params.seed, Purpose::ElementPoint, u64::from(element));
        let expected = params.fit_points as f32 * (area / whole).min(1.0);
        let count = if level_of[element as usize] > 0 {
            params.fit_points
        } else {
            (expected + key.uniform(0)).floor() as u32
        };
        let first = middles.len();
        let (mut least, mut most) = (Rgb::INFINITY, Rgb::ZERO);
        for (k, &corner) in corners.iter().enumerate() {
            let middle = draft.known_midpoint(corner, corners[(k + 1) % 3]).filter(|&m| asked[m as usize]);
            for light in
                [Some(corner), middle].into_iter().flatten().map(|v| sources[v as usize].area_sources())
            {
                (least, most) = (least.min(light), most.max(light));
            }
            let mut weights = [0.5; 3];
            weights[(k + 2) % 3] = 0.0;
            middles.extend(middle.map(|m| (FitSample { element, weights, area }, m)));
        }
        let even = ((most - least) / (0.5 * (most + least) + Rgb::splat(floor))).max_element() < EVEN;
        let count = if even && middles.len() == first + 3 { 0 } else { count };
        let share = area / (count as usize + middles.len() - first).max(1) as f32;
        middles[first..].iter_mut().for_each(|m| m.0.area = share);
        samples.extend((0..count).map(|index| {
            let weights = drawn_inside(triangle_point(key.point2(index)));
            FitSample { element, weights, area: share }
        }));
    }
    let mut found: Vec<(Rgb, Rgb)> = samples
        .par_iter()
        .enumerate()
        .with_min_len(32)
        .map_init(Scratch::default, |scratch, (index, sample)| {
            if progress.is_cancelled() {
                return (Rgb::ZERO, Rgb::ZERO);
            }
            let receiver = draft.receiver_inside(tracer, displayed, sample.element, sample.weights);
            let key = Key::new(params.seed, Purpose::Emitter, index as u64 | 1 << 40);
            let direct = lights.direct(&receiver, params.fit_rays, key, scratch).irradiance;
            let mirrored = lights.mirrored(&receiver, params.fit_rays, key.child(1), scratch).irradiance;
            (direct, mirrored)
        })
        .collect();
    samples.extend(middles.iter().map(|m| m.0));
    found.extend(middles.iter().map(|m| (sources[m.1 as usize].direct, sources[m.1 as usize].mirrored)));
    if progress.is_cancelled() {
        return Err(Cancelled);
    }
    let direct: Vec<Rgb> = found.iter().map(|f| f.0).collect();
    let mirrored: Vec<Rgb> = found.iter().map(|f| f.1).collect();
    let fit_params = FitParams { smoothing: params.fit.smoothing * spacing, ..params.fit };
    let trust: Vec<f32> =
        displayed.origin.iter().map(|&v| if hidden[v as usize] { HIDDEN_TRUST } else { 1.0 }).collect();
    let fitted = |values: &[Rgb], term: fn(&SourceLight) -> Rgb| {
        let prior: Vec<Rgb> = displayed.origin.iter().map(|&v| term(&sources[v as usize])).collect();
        if prior.iter().chain(values).all(|v| *v == Rgb::ZERO) {
            return prior;
        }
        fit(mesh, &samples, values, &prior, &trust, &fit_params)
    };
    let (direct, mirrored) =
        rayon::join(|| fitted(&direct, |s| s.direct), || fitted(&mirrored, |s| s.mirrored));
    for ((&v, direct), mirrored) in displayed.origin.iter().zip(direct).zip(mirrored) {
        let source = &mut sources[v as usize];
        (source.direct, source.mirrored) = (direct, mirrored);
    }
    Ok(())
}

/// The draft and the patches of a coarse solve with about `count` base triangles.
pub fn coarse_patches(tracer: &Tracer, count: usize) -> (Draft, PatchMesh) {
    let spacing = spacing(tracer, count);
    let draft = Draft::new(tracer, spacing);
    let patches = PatchMesh::new(tracer, &draft, spacing);
    (draft, patches)
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

/// What the field found, by vertex, and which vertices it was asked for.
fn collect(field: &SourceField, count: usize) -> (Vec<SourceLight>, Vec<bool>) {
    let mut known = vec![SourceLight::default(); count];
    let mut asked = vec![false; count];
    if let Ok(mut found) = field.found.lock() {
        for (vertex, light) in found.drain(..) {
            known[vertex as usize] = light;
            asked[vertex as usize] = true;
        }
    }
    (known, asked)
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
    displayed: Displayed,
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
    let mut solution = Solution { mesh: displayed.mesh, ..Solution::default() };
    for &v in &displayed.origin {
        let source = &sources[v as usize];
        let [direct, mirrored, caustic, indirect] = terms[v as usize];
        solution.irradiance[Term::Direct.index()].push(source.direct + direct);
        solution.irradiance[Term::Mirrored.index()].push(source.mirrored + mirrored);
        solution.gathered[Term::Direct.index()].push(direct);
        solution.gathered[Term::Mirrored.index()].push(mirrored);
        solution.irradiance[Term::Caustic.index()].push(caustic);
        solution.irradiance[Term::Indirect.index()].push(indirect);
        solution.punctual.push(source.punctual);
    }
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
