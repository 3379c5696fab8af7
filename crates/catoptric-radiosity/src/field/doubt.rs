//! Where what others sampled is not to be trusted: their neighbours contradict it, or what sources would send does, or what is inside.

use rayon::prelude::*;

use catoptric_scene::{Cancelled, Progress, Rgb};

use crate::JOB;
use crate::draft::Draft;
use crate::field::{Field, Known, Look, Values, mean};
use crate::refine::{RefineParams, misses, shows};

/// What others found is off if it differs from what is foretold by more than this multiple of its deviation.
const STRAYED: f32 = 2.0;
/// Neighbours that differ by this multiple of the tolerance do not share.
const DOUBTFUL: f32 = 2.0;
/// Difference along an edge, relative to the mean of its ends, from which on the mesh is not finer than the light on it: of the light that
/// sources send if nothing blocks them, and of what was found.
const STEEP: f32 = 0.5;
/// Vertices of the budget for each small region that is looked into.
const PER_REGION: usize = 4;

/// A part of the mesh that hangs together.
#[derive(Clone, Copy, Default)]
struct Region {
    /// Its largest leaf, …
    leaf: u32,
    area: f32,
    /// … and the longest edge of that, metres.
    longest: f32,
    /// The middles of some edges will be looked at.
    is_halved: bool,
}

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
        self.evaluate_apart(draft, field, doubtful, progress)?;
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

    /// Looks into the small parts of the mesh of which refinement will look at no edge, the largest first: where all corners stand in the
    /// shadow of what they touch, as those of the post of a chair between its seat and its back, none contradicts another. Those that hold
    /// something else share no longer; returns edges of theirs that are to be halved.
    pub(crate) fn look_into_small(
        &mut self,
        draft: &Draft,
        field: &dyn Field,
        params: &RefineParams,
        progress: &dyn Progress,
    ) -> Result<Vec<(u32, u32)>, Cancelled> {
        let floor = params.floor * mean(draft, &self.values);
        let region_of = draft.regions();
        let wrong: Vec<u32> = self
            .small_regions(draft, &region_of, params)
            .par_iter()
            .with_min_len(16)
            .with_max_len(JOB)
            .filter(|region| {
                if progress.is_cancelled() {
                    return false;
                }
                let corners = draft.leaves[region.leaf as usize].vertices;
                let look = self.look(draft, &corners, params);
                let foretold = corners.iter().map(|&v| self.values[v as usize]).sum::<Rgb>() / 3.0;
                let found = field.evaluate_inside(draft, region.leaf, look);
                misses([foretold, found], region.longest, floor, params).is_some()
            })
            .map(|region| region.leaf)
            .collect();
        let of = |leaf: u32| region_of[draft.leaves[leaf as usize].root as usize];
        let mut is_wrong = vec![false; draft.vertices.len()];
        wrong.iter().for_each(|&leaf| is_wrong[of(leaf) as usize] = true);
        let mut apart: Vec<u32> = draft
            .leaves
            .iter()
            .filter(|leaf| is_wrong[region_of[leaf.root as usize] as usize])
            .flat_map(|leaf| leaf.vertices)
            .collect();
        apart.sort_unstable();
        apart.dedup();
        let unasked = apart.iter().copied().filter(|&v| !self.sharing.is_asked(v)).collect();
        self.evaluate_apart(draft, field, unasked, progress)?;
        apart.into_iter().for_each(|v| self.sharing.part(v));
        Ok(wrong.into_iter().flat_map(|leaf| draft.leaves[leaf as usize].edges()).collect())
    }

    /// Parts of the mesh, by base triangle in `region_of`, of which refinement will look at no edge: the largest, as many as there is room
    /// for.
    fn small_regions(&self, draft: &Draft, region_of: &[u32], params: &RefineParams) -> Vec<Region> {
        let mut regions = vec![Region::default(); draft.vertices.len()];
        for (index, leaf) in draft.leaves.iter().enumerate() {
            let region = &mut regions[region_of[leaf.root as usize] as usize];
            let mut longest = 0.0_f32;
            for (a, b) in leaf.edges() {
                let length = draft.length((a, b));
                longest = longest.max(length);
                region.is_halved |= length > params.short_edge && !self.is_fine((a, b), length);
            }
            let area = draft.area(leaf);
            if area > region.area {
                *region = Region { leaf: index as u32, area, longest, ..*region };
            }
        }
        // Smaller ones would not be split, whatever is in them.
        let is_small =
            |region: &Region| region.area > 0.0 && !region.is_halved && region.longest > params.blur;
        let mut small: Vec<Region> = regions.into_iter().filter(is_small).collect();
        small.sort_by(|a, b| b.longest.total_cmp(&a.longest).then(a.leaf.cmp(&b.leaf)));
        small.truncate(params.max_vertices / PER_REGION);
        small
    }

    /// Evaluates vertices that others sampled for until now.
    fn evaluate_apart(
        &mut self,
        draft: &Draft,
        field: &dyn Field,
        vertices: Vec<u32>,
        progress: &dyn Progress,
    ) -> Result<(), Cancelled> {
        let found: Vec<Rgb> = vertices
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
        for (vertex, value) in vertices.into_iter().zip(found) {
            self.values[vertex as usize] = value;
            self.sharing.ask(vertex);
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
