//! Where what others sampled is not to be trusted: their neighbours contradict it, or what sources would send does.

use rayon::prelude::*;

use catoptric_scene::{Cancelled, Progress, Rgb};

use crate::JOB;
use crate::draft::Draft;
use crate::field::{Field, Known, Look, Values, mean};
use crate::refine::{RefineParams, shows};

/// What others found is off if it differs from what is foretold by more than this multiple of its deviation.
const STRAYED: f32 = 2.0;
/// Neighbours that differ by this multiple of the tolerance do not share.
const DOUBTFUL: f32 = 2.0;
/// Difference along an edge, relative to the mean of its ends, from which on the mesh is not finer than the light on it: of the light that
/// sources send if nothing blocks them, and of what was found.
const STEEP: f32 = 0.5;

impl Values {
    /// Where what is shared differs from one neighbour to the next, or from what is foretold, every vertex is evaluated: the worst first,
    /// as far as the budget goes.
    pub(crate) fn resolve(
        &mut self,
        draft: &Draft,
        field: &dyn Field,
        params: &RefineParams,
        progress: &dyn Progress,
    ) -> Result<(), Cancelled> {
        let floor = params.floor * mean(draft, &self.values);
        let most = DOUBTFUL * params.tolerance;
        let edges = draft.edges();
        let foretold = self.foretold(draft, field);
        let strayed = self.strayed(&foretold, floor);
        let mut worst = strayed.clone();
        for &(a, b) in &edges {
            if self.sharing.shares(a) && self.sharing.shares(b) {
                let [p, q] = [a, b].map(|v| self.values[v as usize]);
                let light = (p + q) * 0.5 + Rgb::splat(floor.max(f32::MIN_POSITIVE));
                let relative = ((p - q).abs() / light).max_element();
                for v in [a, b] {
                    worst[v as usize] = worst[v as usize].max(relative);
                }
            }
        }
        let mut doubtful: Vec<u32> = (0..self.values.len() as u32)
            .filter(|&v| !self.sharing.is_asked(v) && worst[v as usize] > most)
            .collect();
        doubtful.sort_by(|&a, &b| worst[b as usize].total_cmp(&worst[a as usize]).then(a.cmp(&b)));
        doubtful.truncate(params.max_vertices);
        let found: Vec<Rgb> = doubtful
            .par_iter()
            .with_min_len(16)
            .with_max_len(JOB)
            .map(|&v| {
                if progress.is_cancelled() {
                    return Rgb::ZERO;
                }
                let leads: Vec<u32> = self.sharing.parts(v).iter().map(|part| part.0).collect();
                field.evaluate(draft, v, Known::At(&leads), Look::Close(1)).value
            })
            .collect();
        if progress.is_cancelled() {
            return Err(Cancelled);
        }
        field.settle();
        for (&vertex, value) in doubtful.iter().zip(found) {
            self.values[vertex as usize] = value;
            self.sharing.ask(vertex);
        }
        // Where it differs along edges as well they are as others. So they are where none is off but edges are too long for the light along
        // them: that of a lamp beside.
        let contrast =
            |[one, other]: [f32; 2]| (one - other).abs() / (0.5 * (one + other)).max(f32::MIN_POSITIVE);
        for (a, b) in edges {
            // A mesh of which one edge is as wide as a shadow that shows is no finer than the light on it.
            let is_asked = [a, b].iter().all(|&v| self.sharing.is_asked(v));
            let shares = [a, b].iter().any(|&v| self.sharing.shares(v));
            if is_asked && shares && shows(draft, &self.values, (a, b), floor, params) {
                self.sharing.part(a);
                self.sharing.part(b);
            }
            if let [Some(one), Some(other)] = [a, b].map(|v| foretold[v as usize]) {
                let known = contrast([one, other]);
                let found = || contrast([a, b].map(|v| self.values[v as usize].max_element() + floor));
                let is_steep = known > STEEP && found() > STEEP;
                for v in [a, b] {
                    let differs = is_steep || known > most && strayed[v as usize] > most;
                    if differs && self.sharing.is_asked(v) {
                        self.sharing.part(v);
                    }
                }
            }
        }
        Ok(())
    }

    /// What is foretold of the vertices that share.
    fn foretold(&self, draft: &Draft, field: &dyn Field) -> Vec<Option<f32>> {
        (0..self.values.len() as u32)
            .into_par_iter()
            .with_max_len(8 * JOB)
            .map(|v| self.sharing.shares(v).then(|| field.foretold(draft, v)).flatten())
            .collect()
    }

    /// Per vertex that others sample for: by how much what they found differs from what is foretold of it, relative to both.
    ///
    /// The vertices that share may be all that a small thing has, and a lamp inside of it as near as they are to each other: what one of
    /// them samples for all, no neighbour contradicts.
    fn strayed(&self, foretold: &[Option<f32>], floor: f32) -> Vec<f32> {
        let foretold = |v: u32| foretold[v as usize].unwrap_or(0.0);
        (0..self.values.len() as u32)
            .map(|v| {
                let parts = self.sharing.parts(v);
                let mean: f32 = parts.iter().map(|&(lead, weight)| foretold(lead) * weight).sum();
                let light = self.values[v as usize].max_element();
                if mean <= 0.0 || light <= 0.0 {
                    return 0.0;
                }
                let own = light * foretold(v) / mean;
                // A sample of its own would be as noisy.
                let variance = |lead: u32| self.found[lead as usize].variance / 3.0;
                let variance: f32 = parts.iter().map(|&(lead, weight)| variance(lead) * weight).sum();
                if (own - light).abs() < STRAYED * variance.sqrt() {
                    return 0.0;
                }
                (own - light).abs() / (0.5 * (own + light) + floor.max(f32::MIN_POSITIVE))
            })
            .collect()
    }
}
