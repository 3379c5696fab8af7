//! Extended form factor rows by hemisphere rays: F_ij is the share of the power leaving patch i that arrives at patch
//! j, directly or over ideal mirrors and glass (Sillion & Puech 1989). Sparse: memory O(patches × rays).

use rayon::prelude::*;

use catoptric_light::{Lights, Owner};
use catoptric_scene::{Cancelled, Progress, Rgb};
use catoptric_solution::DisplayMesh;
use catoptric_trace::sequence::{Key, Purpose, cosine_hemisphere, frame};
use catoptric_trace::walk::{self, End, WalkParams};
use catoptric_trace::{Ledger, Ray};

use crate::JOB;
use crate::draft::Draft;
use crate::patch::{PatchId, PatchMesh};

/// Form factors of a row: one number where no mirror tints, else three.
#[derive(Clone, Debug, PartialEq)]
pub enum Weights {
    /// The same for every channel.
    Gray(Vec<f32>),
    /// One per channel.
    Tinted(Vec<Rgb>),
}

impl Weights {
    /// One number each where no channel differs from the others.
    pub fn of(weights: Vec<Rgb>) -> Self {
        if weights.iter().all(|w| w.x == w.y && w.y == w.z) {
            Self::Gray(weights.iter().map(|w| w.x).collect())
        } else {
            Self::Tinted(weights)
        }
    }
}

/// One row of extended form factors, sorted by patch.
#[derive(Clone, Debug)]
pub struct Row {
    /// Receiving patches, ascending.
    pub patches: Vec<PatchId>,
    /// F_ij, times (n_i/n_j)² so that radiosities can be gathered across media.
    pub weights: Weights,
    /// Irradiance from what rays found besides patches: the dim sky, and sources that no other term owns.
    pub found: Rgb,
    /// Shares of the power sent.
    pub ledger: Ledger,
}

impl Row {
    /// Σ_j F_ij·value_j.
    #[inline]
    pub fn gather(&self, value: impl Fn(PatchId) -> Rgb) -> Rgb {
        match &self.weights {
            Weights::Gray(weights) => self.patches.iter().zip(weights).map(|(&p, &w)| value(p) * w).sum(),
            Weights::Tinted(weights) => self.patches.iter().zip(weights).map(|(&p, &w)| value(p) * w).sum(),
        }
    }

    /// Calls `visit` with each patch and its F_ij.
    pub fn visit(&self, mut visit: impl FnMut(PatchId, Rgb)) {
        match &self.weights {
            Weights::Gray(weights) => {
                self.patches.iter().zip(weights).for_each(|(&p, &w)| visit(p, Rgb::splat(w)));
            }
            Weights::Tinted(weights) => self.patches.iter().zip(weights).for_each(|(&p, &w)| visit(p, w)),
        }
    }

    /// Σ_j F_ij.
    pub fn sum(&self) -> Rgb {
        self.gather(|_| Rgb::ONE)
    }
}

/// What finds the patch at a hit: the unrefined mesh.
pub struct PatchLocator<'a> {
    /// The display mesh of the unrefined draft, whose elements are the base triangles in order of faces.
    pub mesh: &'a DisplayMesh,
    /// Patch of each element of that mesh.
    pub of_element: &'a [PatchId],
}

/// Computes the row of one patch with `rays` rays.
pub fn row(
    lights: &Lights,
    draft: &Draft,
    patches: &PatchMesh,
    locator: &PatchLocator,
    patch: PatchId,
    rays: u32,
    seed: u32,
    params: &WalkParams,
) -> Row {
    let tracer = lights.tracer();
    let points = Key::new(seed, Purpose::PatchPoint, u64::from(patch.0));
    let directions = Key::new(seed, Purpose::Hemisphere, u64::from(patch.0) | 1 << 40);
    let roulette = Key::new(seed, Purpose::Roulette, u64::from(patch.0));
    let mut ledger = Ledger::default();
    let mut found = Rgb::ZERO;
    let mut entries: Vec<(PatchId, Rgb)> = Vec::with_capacity(rays as usize);
    for index in 0..rays {
        let receiver = patches.receiver(tracer, draft, patch, points, index);
        let (tangent, bitangent) = frame(receiver.normal);
        let local = cosine_hemisphere(directions.point2(index));
        let direction = tangent * local.x + bitangent * local.y + receiver.normal * local.z;
        let sent = Rgb::splat(receiver.coat.transmittance(local.z));
        let ray = Ray { origin: receiver.position, direction, from: receiver.plane };
        let end = walk::choose(
            tracer,
            ray,
            receiver.media,
            sent,
            roulette.child(index),
            params,
            &mut ledger,
            |arrival| {
                let scale = tracer.media().radiance_scale(receiver.media.current(), arrival.media.current());
                let interaction = arrival.interaction;
                if interaction.receives > 0.0
                    && let Some(located) =
                        locator.mesh.locate(arrival.hit.triangle, interaction.side, arrival.position)
                {
                    let target = locator.of_element[located.element as usize];
                    entries.push((target, arrival.throughput * (interaction.receives * scale)));
                }
                let emission = interaction.emission.0;
                if emission.max_element() > 0.0
                    && lights.owner(lights.source_at(arrival.hit.triangle), arrival.chain)
                        == Owner::Hemisphere
                {
                    found += arrival.throughput * emission * scale;
                }
            },
        );
        if let End::Escaped { direction, throughput, chain, media } = end
            && let Some(sky) = tracer.scene().sky()
            && lights.owner(lights.sky_source(sky, direction), &chain) == Owner::Hemisphere
        {
            let scale = tracer.media().radiance_scale(receiver.media.current(), media.current());
            found += throughput * sky.radiance(direction).0 * scale;
        }
    }
    finish(entries, found, ledger, rays)
}

/// Merges arrivals by patch, in ray order within a patch.
fn finish(mut entries: Vec<(PatchId, Rgb)>, found: Rgb, ledger: Ledger, rays: u32) -> Row {
    // Stable: equal patches keep the order of their rays, so sums have the same bits every time.
    entries.sort_by_key(|e| e.0);
    let each = 1.0 / rays.max(1) as f32;
    let mut patches: Vec<PatchId> = Vec::new();
    let mut weights: Vec<Rgb> = Vec::new();
    for (patch, weight) in entries {
        match (patches.last(), weights.last_mut()) {
            (Some(&last), Some(sum)) if last == patch => *sum += weight * each,
            _ => {
                patches.push(patch);
                weights.push(weight * each);
            }
        }
    }
    let weights = Weights::of(weights);
    let ledger = ledger.scaled(1.0 / f64::from(rays.max(1)));
    Row { patches, weights, found: found * (std::f32::consts::PI * each), ledger }
}

/// All rows.
pub fn rows(
    lights: &Lights,
    draft: &Draft,
    patches: &PatchMesh,
    locator: &PatchLocator,
    rays: u32,
    seed: u32,
    params: &WalkParams,
    progress: &dyn Progress,
) -> Result<Vec<Row>, Cancelled> {
    progress.begin("form factors", patches.len() as u64);
    (0..patches.len() as u32)
        .into_par_iter()
        .with_min_len(8)
        .with_max_len(JOB)
        .map(|index| {
            if progress.is_cancelled() {
                return Err(Cancelled);
            }
            let row = row(lights, draft, patches, locator, PatchId(index), rays, seed, params);
            progress.advance(1);
            Ok(row)
        })
        .collect()
}
