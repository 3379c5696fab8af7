//! Where light comes through the gap below what hangs or stands before a face: it falls off within the width of the gap.

use rayon::prelude::*;

use crate::JOB;
use crate::draft::{Draft, DraftVertex};
use crate::inset::BESIDE_GAP;
use crate::near::Near;

use super::look::Surplus;
use super::{FEW_RAYS, NearLight, NearLightParams, RAYS};

/// Light spills through a gap where there is more of it by this share of what is farther off: less hardly shows.
const SPILL: f32 = 0.5;
/// … unless the gap is below this multiple of the spacing, as between books: nobody sees what is as narrow.
const NARROW: f32 = 0.02;
/// … and on along the gap as long as there is more by this share.
const LEAST_SPILL: f32 = 0.1;
/// By how much of what a surface sends the light beside it may be more there than farther off, at most: beyond its edge, half of it is seen.
const MOST_SPILL: f32 = 0.5;

/// Continues what [`NearLight::spills`] says to the vertices that halve edges since: beside a place where light comes through they gather where
/// they are, too.
pub(super) fn inherit(draft: &mut Draft, sizes: &mut Vec<f32>) {
    for v in sizes.len()..draft.vertices.len() {
        let vertex = &mut draft.vertices[v];
        let [one, other] = vertex.parents.map_or([f32::INFINITY; 2], |p| p.map(|v| sizes[v as usize]));
        let (least, most) = (one.min(other), one.max(other));
        let is_beside = least < f32::INFINITY && vertex.outlook != vertex.sample;
        if is_beside {
            vertex.gather_there();
        }
        sizes.push(if is_beside { least } else { most });
    }
}

impl NearLight<'_> {
    /// Per vertex: how large the gap is below what hangs or stands beside it, metres, where light comes through, such as from the back of a
    /// window's frame before the bright window; infinity for all others. It was to gather farther off, as the dark that shows through most
    /// gaps is narrower than elements.
    pub(super) fn spills(&self, near: &Near, draft: &Draft, params: &NearLightParams) -> Vec<f32> {
        let sent = self.sent();
        let floor = params.floor * self.mean;
        let size = |vertex: &DraftVertex| vertex.outlook.distance(vertex.position) / BESIDE_GAP;
        let is_beside = |v: u32| {
            let vertex = &draft.vertices[v as usize];
            vertex.outlook != vertex.sample && size(vertex) > NARROW * self.spacing && !self.sharing.shares(v)
        };
        let mut may_spill: Vec<bool> = Vec::with_capacity(draft.vertices.len());
        for (v, vertex) in (0_u32..).zip(&draft.vertices) {
            let shown = self.irradiance[v as usize].max_element() + floor;
            let is_bright = |&root: &u32| MOST_SPILL * sent[root as usize] > SPILL * shown;
            let is_near_bright = match vertex.parents {
                Some([a, b]) => may_spill[a as usize] || may_spill[b as usize],
                None => near.beside(v).iter().any(is_bright),
            };
            may_spill.push(is_near_bright && is_beside(v));
        }
        // What more is seen there than farther off, if that is more than a share of what is there.
        let more = |v: u32, rays: u32, least: f32| {
            let receivers = [draft.receiver(self.tracer, v), draft.gatherer(self.tracer, v)];
            let [here, off] = receivers.map(|receiver| self.seen_from(&receiver, rays));
            let more = here.irradiance.iter().zip(&off.irradiance).map(|(here, off)| here - off);
            let more = Surplus::of(more, rays);
            let shown = self.sources[v as usize].max_element() + off.total() + floor;
            (more.sum > least * shown).then_some(more)
        };
        let ask = |vertices: &[u32], spills: &(dyn Fn(u32) -> bool + Sync)| -> Vec<(u32, f32)> {
            let asked = vertices.par_iter().with_min_len(4).with_max_len(JOB);
            asked.filter(|&&v| spills(v)).map(|&v| (v, size(&draft.vertices[v as usize]))).collect()
        };
        let mut sizes = vec![f32::INFINITY; draft.vertices.len()];
        let first: Vec<u32> = (0..may_spill.len() as u32).filter(|&v| may_spill[v as usize]).collect();
        let mut found = ask(&first, &|v| {
            more(v, FEW_RAYS, SPILL).is_some() && more(v, RAYS[0], SPILL).is_some_and(Surplus::is_significant)
        });
        if found.is_empty() {
            return sizes;
        }
        // A gap is as long as what it is below: few rays may have missed a part.
        let edges = draft.edges();
        let mut asked = vec![false; sizes.len()];
        while !found.is_empty() {
            for &(v, size) in &found {
                (sizes[v as usize], asked[v as usize]) = (size, true);
            }
            let mut next = Vec::new();
            for &(a, b) in &edges {
                for (known, other) in [(a, b), (b, a)] {
                    let spills = sizes[known as usize] < f32::INFINITY;
                    if spills && !asked[other as usize] && is_beside(other) {
                        asked[other as usize] = true;
                        next.push(other);
                    }
                }
            }
            found = ask(&next, &|v| more(v, RAYS[0], LEAST_SPILL).is_some());
        }
        sizes
    }
}
