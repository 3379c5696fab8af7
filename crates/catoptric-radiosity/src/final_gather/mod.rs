//! The final gather: light that other diffuse surfaces send, at the vertices and inside the elements of a mesh, fitted, and
//! corrected by what it found beyond what it saw.
//!
//! The file `gathers` sends the rays, `links` keeps what those of the vertices met, `bright` finds what is small and bright
//! and `spots` where it is seen, `seams` joins faces in one plane, `shared` hands on what some vertices take from others, `turns` shares out one sequence among the points inside the elements.

mod bright;
mod gathers;
mod links;
mod seams;
mod shared;
mod spots;
mod turns;

use catoptric_light::Lights;
use catoptric_scene::{Cancelled, Progress, Rgb};
use catoptric_solution::DisplayMesh;

use crate::display::Displayed;
use crate::draft::Draft;
use crate::fit::{FitMesh, FitParams, FitSample, FitTerm, fit, pooled};
use crate::gather::{DiffuseLight, Gathered};
use crate::patch::PatchMesh;
use crate::rows::Row;
use crate::sharing::Sharing;
use crate::solve::SolveParams;
use crate::solver::{SolverParams, spread_error};

use gathers::{Gathers, Vertices};
use seams::Seams;
use spots::Spots;

/// Patch values at the vertices of the draft: means over the base triangles around, then along the hierarchy.
pub(crate) fn spread(draft: &Draft, patches: &PatchMesh, values: &[Rgb]) -> Vec<Rgb> {
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

/// Gathered light.
pub(crate) struct GatheredLight {
    /// Direct, mirrored, caustic and indirect per draft vertex of what was looked at; `None` where nothing was gathered.
    pub(crate) terms: Vec<Option<[Rgb; 4]>>,
    /// Hemisphere rays sent.
    pub(crate) rays: u64,
}

/// What gathers look at: the refined mesh with the light of sources on it.
pub(crate) struct Sight<'a> {
    pub(crate) displayed: &'a Displayed,
    pub(crate) draft: &'a Draft,
    pub(crate) sources: &'a [Rgb],
    /// Its draft vertex, for each of the mesh of the gathers.
    pub(crate) of_gathers: &'a [u32],
}

impl Sight<'_> {
    /// Irradiance per vertex of the display mesh when `more` (per draft vertex) comes to what sources send.
    fn with(&self, more: &[Rgb]) -> Vec<Rgb> {
        self.displayed.origin.iter().map(|&v| self.sources[v as usize] + more[v as usize]).collect()
    }

    /// What the vertices of the gathers have of values per draft vertex.
    fn at_gathers(&self, values: &[Rgb]) -> Vec<Rgb> {
        self.of_gathers.iter().map(|&v| values[v as usize]).collect()
    }

    /// Area-weighted mean of the sum of channels of irradiance per vertex of the display mesh; large triangles count less.
    fn mean(&self, irradiance: &[Rgb]) -> f32 {
        let mesh = &self.displayed.mesh;
        let (mut sum, mut area) = (0.0_f64, 0.0_f64);
        for (index, element) in mesh.elements.iter().enumerate() {
            let own = f64::from(mesh.area(index as u32).min(self.draft.most_weight));
            let mean =
                element.vertices.iter().map(|&v| irradiance[v as usize].element_sum()).sum::<f32>() / 3.0;
            sum += own * f64::from(mean);
            area += own;
        }
        if area > 0.0 { (sum / area) as f32 } else { 0.0 }
    }

    /// Values known at vertices of the gathers, per draft vertex.
    fn scattered<T: Copy>(&self, known: &[Option<T>]) -> Vec<Option<T>> {
        let mut all = vec![None; self.draft.vertices.len()];
        for (&v, &known) in self.of_gathers.iter().zip(known) {
            all[v as usize] = known;
        }
        all
    }

    /// Values known at some vertices of the gathers, at all: children are the mean of their parents.
    fn spread(&self, known: &[Option<Rgb>]) -> Vec<Rgb> {
        let mut all: Vec<Rgb> = Vec::with_capacity(self.draft.vertices.len());
        for (own, vertex) in self.scattered(known).into_iter().zip(&self.draft.vertices) {
            all.push(own.unwrap_or_else(|| {
                vertex.parents.map_or(Rgb::ZERO, |[a, b]| (all[a as usize] + all[b as usize]) * 0.5)
            }));
        }
        all
    }
}

/// The coarse solution and what it takes to correct it.
pub(crate) struct Coarse<'a> {
    pub(crate) patches: &'a PatchMesh,
    pub(crate) rows: &'a [Row],
    pub(crate) indirect: &'a [Rgb],
}

impl Coarse<'_> {
    /// What becomes, per patch, of light of which the vertices of `draft` hold too little.
    fn onward(&self, draft: &Draft, lack: &[Rgb], solver: &SolverParams) -> Vec<Rgb> {
        spread_error(self.patches, self.rows, &self.means(draft, lack), solver).indirect
    }

    /// Means per patch of values at the vertices of `draft`.
    fn means(&self, draft: &Draft, values: &[Rgb]) -> Vec<Rgb> {
        let mut mean = vec![Rgb::ZERO; self.patches.len()];
        for leaf in &draft.leaves {
            let patch = self.patches.of_root[leaf.root as usize].0 as usize;
            let share = draft.area(leaf) / self.patches.areas[patch].max(f32::MIN_POSITIVE);
            mean[patch] += leaf.vertices.iter().map(|&v| values[v as usize]).sum::<Rgb>() * (share / 3.0);
        }
        mean
    }
}

/// What was found beyond what was seen.
fn difference(found: &[Rgb], seen: &[Rgb]) -> Vec<Rgb> {
    found.iter().zip(seen).map(|(found, seen)| *found - *seen).collect()
}

/// Hidden corners of elements that can be seen in part show what their neighbours found: nobody sees the dark behind them.
fn beside_hidden(draft: &Draft, known: &mut [Option<Rgb>]) {
    let mut sums = vec![(Rgb::ZERO, 0.0_f32); known.len()];
    for leaf in &draft.leaves {
        for &v in &leaf.vertices {
            for value in leaf.vertices.iter().filter_map(|&corner| known[corner as usize]) {
                sums[v as usize].0 += value;
                sums[v as usize].1 += 1.0;
            }
        }
    }
    for (known, (sum, count)) in known.iter_mut().zip(sums) {
        if known.is_none() && count > 0.0 {
            *known = Some(sum / count);
        }
    }
}

/// Gathers at the vertices and inside the elements of `draft`, and fits.
///
/// The vertices, with few rays, see the coarse solution, and are solved on what these rays met; the points inside, with many, see
/// what the vertices hold by that; and what they find beyond it is reflected on over the coarse patches (Lischinski, Tampieri &
/// Greenberg 1993 gather once, from the coarse solution).
pub(crate) fn final_gather(
    lights: &Lights,
    sight: &Sight,
    coarse: &Coarse,
    draft: &Draft,
    hidden: &[bool],
    sharing: &Sharing,
    params: &SolveParams,
    spacing: f32,
    progress: &dyn Progress,
) -> Result<GatheredLight, Cancelled> {
    let mesh = &sight.displayed.mesh;
    let ((gathers, samples), (coarse_seen, irradiance)) = rayon::join(
        || {
            let gathers = Gathers::new(lights, draft, hidden, sharing, params, spacing, progress);
            let samples = gathers.samples();
            (gathers, samples)
        },
        || {
            let coarse_seen = spread(sight.draft, coarse.patches, coarse.indirect);
            let irradiance = sight.with(&coarse_seen);
            (coarse_seen, irradiance)
        },
    );
    progress.begin("gather", (samples.len() + gathers.displayed.origin.len()) as u64);
    let light = DiffuseLight { mesh, irradiance: &irradiance };
    let spots = Spots::new(lights, sight, coarse.patches, &irradiance);
    let mut vertices = gathers.look(&light, &spots);
    // All guides stand before the first vertex finds more.
    let guides = gathers.guides(&vertices, &spots, |_| true);
    let sources = sight.at_gathers(sight.sources);
    let budget = gathers.budget(&vertices, &guides, &sources, sight.mean(&irradiance));
    gathers.look_again(&light, &mut vertices, &guides, &spots, &budget);
    // Kilobytes each.
    drop(guides);
    // Some knew nothing of what is bright, since all around missed it with their first rays.
    let guides = gathers.guides(&vertices, &spots, |v| gathers.is_surprised(&vertices, &budget, v));
    gathers.look_again(&light, &mut vertices, &guides, &spots, &budget);
    drop(guides);
    gathers.share(&mut vertices);

    let looked_at = solved(&gathers, sight, &coarse_seen, &mut vertices);
    let irradiance = sight.with(&looked_at);
    let light = DiffuseLight { mesh, irradiance: &irradiance };
    let (inside, seams) = rayon::join(
        || gathers.inside(&light, &samples, &vertices, &spots, &budget),
        || Seams::new(lights.tracer(), draft, &gathers.displayed, hidden, spacing),
    );
    let fitted_mesh = seams.as_ref().map_or(&gathers.displayed.mesh, Seams::mesh);
    let ((), fit_mesh) =
        rayon::join(|| gathers.lead(&light, &mut vertices, &spots, &budget), || FitMesh::new(fitted_mesh));
    if progress.is_cancelled() {
        return Err(Cancelled);
    }

    let FitParams { smoothing, balance, .. } = params.gather_fit;
    let fit_params =
        FitParams { smoothing: smoothing * spacing, balance: balance * spacing, ..params.gather_fit };
    let mut terms =
        fit_terms(&gathers, (&fit_mesh, seams.as_ref()), &samples, &inside.gathered, &vertices, &fit_params);

    // What was found beyond what was seen is missing from all further reflections.
    let looked_at = sight.at_gathers(&looked_at);
    let found: Vec<Rgb> = terms
        .iter()
        .zip(&looked_at)
        .map(|(terms, seen)| terms.map_or(*seen, |t| t.iter().copied().sum::<Rgb>()))
        .collect();
    let lack = difference(&found, &looked_at);
    let mut more = spread(draft, coarse.patches, &coarse.onward(draft, &lack, &params.solver));
    if let Some(seams) = &seams {
        seams.even(&mut more, &gathers.displayed.origin);
    }
    for (terms, more) in terms.iter_mut().zip(&more) {
        if let Some([.., indirect]) = terms {
            *indirect = (*indirect + *more).max(Rgb::ZERO);
        }
    }
    let rays = vertices.rays.iter().chain(&inside.rays).map(|&r| u64::from(r)).sum::<u64>()
        + sharing.leads().len() as u64 * u64::from(params.gather_rays);
    Ok(GatheredLight { terms: sight.scattered(&terms), rays })
}

/// Solves the vertices on what their rays met, and returns what the mesh of `sight` holds by that: irradiance per draft vertex. The
/// rays saw the coarse solution, `seen`; Jacobi steps put what the vertices find in its place.
fn solved(gathers: &Gathers, sight: &Sight, seen: &[Rgb], vertices: &mut Vertices) -> Vec<Rgb> {
    let first: Vec<Rgb> = vertices.gathered.iter().map(|g| g.indirect).collect();
    let mut found = held(gathers, sight, vertices);
    for _ in 0..MAX_STEPS {
        let beyond = difference(&found, seen);
        let shown: Vec<Rgb> = sight.displayed.origin.iter().map(|&v| beyond[v as usize]).collect();
        let (mut change, mut sum) = (0.0_f64, 0.0_f64);
        let more = vertices.linked(gathers, &sight.displayed.mesh, &shown);
        for ((gathered, first), more) in vertices.gathered.iter_mut().zip(&first).zip(more) {
            let next = (*first + more).max(Rgb::ZERO);
            change += f64::from((next - gathered.indirect).abs().element_sum());
            sum += f64::from(next.element_sum());
            gathered.indirect = next;
        }
        found = held(gathers, sight, vertices);
        if change <= SETTLED * sum {
            break;
        }
    }
    // Kilobytes each.
    vertices.links = Vec::new();
    found
}

/// What the vertices found, on the mesh of `sight`: irradiance per draft vertex.
fn held(gathers: &Gathers, sight: &Sight, vertices: &Vertices) -> Vec<Rgb> {
    let mut known: Vec<Option<Rgb>> = vec![None; gathers.draft.vertices.len()];
    for (&v, g) in gathers.displayed.origin.iter().zip(&vertices.gathered) {
        known[v as usize] = (!gathers.hidden[v as usize]).then(|| g.total());
    }
    beside_hidden(gathers.draft, &mut known);
    sight.spread(&known)
}

/// Jacobi steps at most.
const MAX_STEPS: u32 = 16;
/// Mean change of the light by a step, relative, that ends them: smooth errors are left to the coarse solver.
const SETTLED: f64 = 1e-3;

/// Fits each term: direct, mirrored, caustic and indirect per draft vertex.
fn fit_terms(
    gathers: &Gathers,
    (fit_mesh, seams): (&FitMesh, Option<&Seams>),
    samples: &[FitSample],
    inside: &[Gathered],
    vertices: &Vertices,
    params: &FitParams,
) -> Vec<Option<[Rgb; 4]>> {
    let Displayed { mesh, origin, .. } = &gathers.displayed;
    let mesh = seams.map_or(mesh, Seams::mesh);
    let mut terms: Vec<Option<[Rgb; 4]>> = vec![None; gathers.draft.vertices.len()];
    for &v in origin {
        terms[v as usize] = Some([Rgb::ZERO; 4]);
    }
    // A term with what the points inside and the vertices found of it.
    let found = |term: usize| {
        let value = |g: &Gathered| [g.direct, g.mirrored, g.caustic, g.indirect][term];
        let values: Vec<Rgb> = inside.iter().map(value).collect();
        let prior: Vec<Rgb> = vertices.gathered.iter().map(value).collect();
        let prior = seams.map(|seams| seams.means(&prior, &vertices.trust)).unwrap_or(prior);
        let is_lit = prior.iter().chain(&values).any(|v| *v != Rgb::ZERO);
        is_lit.then_some((term, values, prior))
    };
    let lit: Vec<(usize, Vec<Rgb>, Vec<Rgb>)> = (0..4).filter_map(found).collect();
    let together: Vec<FitTerm> = lit.iter().map(|(_, values, prior)| FitTerm { values, prior }).collect();
    let noise: Vec<f32> = vertices.gathered.iter().map(|g| g.noise).collect();
    let noise = seams.map(|seams| seams.variances(&noise, &vertices.trust)).unwrap_or(noise);
    let trust = seams.map_or_else(|| vertices.trust.clone(), |seams| seams.trust(&vertices.trust));
    let trust = trusted(mesh, &trust, &noise);
    let fitted = fit(fit_mesh, samples, &together, &trust, &noise, params);
    for ((term, ..), fitted) in lit.iter().zip(fitted) {
        let fitted = seams.map(|seams| seams.parted(&fitted)).unwrap_or(fitted);
        for (&v, fitted) in origin.iter().zip(fitted) {
            if let Some(terms) = &mut terms[v as usize] {
                terms[*term] = fitted;
            }
        }
    }
    terms
}

/// A vertex is trusted less if its deviation is more than this multiple of what those around it have.
const OUTLIER: f32 = 2.0;

/// Times the usual deviations are found again without what stands out of them: a lone one counts two thirds of what it did each time.
const ROUNDS: usize = 6;

/// Trust per vertex without outliers: where one of few rays met what is small and bright, and next to none of the neighbours' did. By
/// as much less as its variance, of which `noise` is the estimate, stands out.
fn trusted(mesh: &DisplayMesh, trust: &[f32], noise: &[f32]) -> Vec<f32> {
    let deviations: Vec<f32> = noise.iter().map(|variance| variance.sqrt()).collect();
    // What stands out is part of the means around it, by less every time.
    let mut usual = pooled(mesh, &deviations);
    for _ in 0..ROUNDS {
        let bounded: Vec<f32> =
            deviations.iter().zip(&usual).map(|(deviation, usual)| deviation.min(OUTLIER * usual)).collect();
        usual = pooled(mesh, &bounded);
    }
    let own = |((&trust, &deviation), &usual): ((&f32, &f32), &f32)| {
        let most = OUTLIER * usual;
        if deviation > most { trust * (most / deviation).powi(2) } else { trust }
    };
    trust.iter().zip(&deviations).zip(&usual).map(own).collect()
}

#[cfg(test)]
mod tests {
    use catoptric_scene::{Material, MaterialId, Scene, SceneParts, Side};
    use catoptric_trace::Tracer;
    use glam::Vec3;

    use super::*;

    /// A white floor of 4 × 4 m, seen from above, and its material.
    pub(super) fn floor() -> (SceneParts, MaterialId) {
        let mut parts = SceneParts::default();
        let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
        parts.add_quad("floor", white, Vec3::ZERO, Vec3::Z * 4.0, Vec3::X * 4.0);
        (parts, white)
    }

    #[test]
    fn only_what_stands_out_of_its_neighbours_is_trusted_less() {
        let scene = Scene::new(floor().0).expect("a valid scene");
        let tracer = Tracer::new(&scene);
        let mesh = Draft::new(&tracer, 0.4).display(&tracer).mesh;
        assert!(mesh.vertices.iter().all(|v| v.side == Side::Front));
        // Noise that grows over the floor, and one vertex with a hundred times the variance.
        let noise = |outlier: Option<usize>| -> Vec<f32> {
            let own = |(index, p): (usize, Vec3)| {
                (1.0 + p.x).powi(2) * if outlier == Some(index) { 100.0 } else { 1.0 }
            };
            mesh.vertices.iter().map(|v| v.position).enumerate().map(own).collect()
        };
        let trust = vec![3.0; mesh.vertices.len()];
        assert_eq!(trusted(&mesh, &trust, &noise(None)), trust);
        let off_middle = |v: usize| mesh.vertices[v].position.distance(Vec3::new(2.0, 0.0, 2.0));
        let outlier = (0..mesh.vertices.len()).min_by(|&a, &b| off_middle(a).total_cmp(&off_middle(b)));
        let outlier = outlier.expect("the floor has vertices");
        let less = trusted(&mesh, &trust, &noise(Some(outlier)));
        for (index, &trust) in less.iter().enumerate() {
            // Two rounds of means leave at most a third of what it counts in what is usual there, u beside 1: 4 at first, then
            // u ← ⅔ + ⅔ u, 2.2 after six times; it is trusted by (2 u ∕ 10)².
            assert!(if index == outlier { trust < 3.0 * 0.19 } else { trust == 3.0 });
        }
    }
}
