//! What the paths of the slow twin are made of: random numbers, choices, classes, diffuse vertices.

use std::f32::consts::PI;

use catoptric_trace::interaction::{Coat, Interaction};
use catoptric_trace::{Event, Hit, PlaneId, Ray, SlabId, Tracer};
use glam::Vec3;

pub(crate) const EMISSION: usize = 0;
pub(crate) const DIRECT: usize = 1;
pub(crate) const MIRRORED: usize = 2;
pub(crate) const CAUSTIC: usize = 3;
pub(crate) const INDIRECT: usize = 4;
/// Added to the others where S⁺ stands before the eye.
pub(crate) const SPECULAR: usize = 5;

/// SplitMix64 (Steele, Lea & Flood 2014): nothing in common with the renderer's sequences.
pub(crate) struct Random(pub(crate) u64);

impl Random {
    pub(crate) fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 40) as f32 / (1_u32 << 24) as f32
    }

    /// A direction about `axis`, uniform over the cap whose cosine is at least `min_cos`.
    pub(crate) fn in_cap(&mut self, axis: Vec3, min_cos: f32) -> Vec3 {
        self.around(axis, |u| 1.0 - u * (1.0 - min_cos))
    }

    /// A direction about `axis` of density cosθ/π.
    pub(crate) fn cosine(&mut self, axis: Vec3) -> Vec3 {
        self.around(axis, |u| (1.0 - u).sqrt())
    }

    /// A direction about `axis` of density (n+1)/2π · cosⁿθ.
    pub(crate) fn lobe(&mut self, axis: Vec3, n: f32) -> Vec3 {
        self.around(axis, |u| libm::powf(1.0 - u, 1.0 / (n + 1.0)))
    }

    fn around(&mut self, axis: Vec3, cos_of: impl Fn(f32) -> f32) -> Vec3 {
        let cos = cos_of(self.next());
        let (sin_phi, cos_phi) = libm::sincosf(2.0 * PI * self.next());
        let tangent = axis.any_orthonormal_vector();
        let across = tangent * cos_phi + axis.cross(tangent) * sin_phi;
        (across * (1.0 - cos * cos).max(0.0).sqrt() + axis * cos).normalize_or_zero()
    }
}

/// What happened since the last diffuse vertex.
#[derive(Clone, Copy, Default)]
pub(crate) struct Way {
    undeviated: bool,
    planar: bool,
    facet: bool,
    curved: bool,
    /// Just entered: what comes next tells.
    slab: Option<SlabId>,
    /// Went through a sheet of glass by refraction, to go on in its direction: next-event estimation does not find that.
    sheet: bool,
}

impl Way {
    pub(crate) fn add(&mut self, event: Event) {
        if let Some(slab) = self.slab.take() {
            if event == Event::Leaves(slab) {
                (self.undeviated, self.sheet) = (true, true);
                return;
            }
            self.curved = true;
        }
        match event {
            Event::Undeviated => self.undeviated = true,
            // A small mirror reflects alone, or as curved ones do.
            Event::Planar(_) => (self.planar, self.curved) = (true, self.curved || self.facet),
            Event::Facet(_) => {
                (self.planar, self.facet, self.curved) = (true, true, self.curved || self.planar);
            }
            Event::Enters(slab) => self.slab = Some(slab),
            Event::Curved | Event::Leaves(_) => self.curved = true,
        }
    }

    pub(crate) fn is_empty(self) -> bool {
        !self.undeviated && self.is_straight()
    }

    pub(crate) fn is_straight(self) -> bool {
        !(self.planar || self.curved || self.slab.is_some())
    }

    /// Whether next-event estimation finds such paths.
    pub(crate) fn is_open(self) -> bool {
        self.is_straight() && !self.sheet
    }

    /// Layer of light that `bounces` diffuse vertices hand on and that came this way to the first of them.
    pub(crate) fn layer(self, bounces: u32) -> usize {
        match bounces {
            0 => EMISSION,
            1 if self.is_straight() => DIRECT,
            1 if !self.curved && self.slab.is_none() => MIRRORED,
            1 => CAUSTIC,
            _ => INDIRECT,
        }
    }
}

/// A diffuse side that light leaves.
pub(crate) struct Vertex {
    pub(crate) position: Vec3,
    pub(crate) normal: Vec3,
    pub(crate) geometric: Vec3,
    from: PlaneId,
    coat: Coat,
}

impl Vertex {
    pub(crate) fn new(
        tracer: &Tracer,
        hit: &Hit,
        surface: &Interaction,
        position: Vec3,
        other: bool,
    ) -> Self {
        let point = tracer.scene().surface_point(hit.triangle, hit.at);
        let side = tracer.diffuse_side(hit.triangle, &point, surface.side);
        let sign = if other { -1.0 } else { 1.0 };
        Self {
            position,
            normal: surface.normal * sign,
            geometric: surface.geometric * sign,
            from: tracer.planes().of(hit.triangle),
            coat: side.map_or(Coat::NONE, |s| s.coat),
        }
    }

    /// Cosine with which light from `direction` counts; 0 from below.
    pub(crate) fn cos(&self, direction: Vec3) -> f32 {
        if direction.dot(self.geometric) > 0.0 { direction.dot(self.normal).max(0.0) } else { 0.0 }
    }

    pub(crate) fn transmittance(&self, cos: f32) -> f32 {
        self.coat.transmittance(cos)
    }

    pub(crate) fn ray(&self, direction: Vec3) -> Ray {
        Ray { origin: self.position, direction, from: self.from }
    }
}

/// Picks one of the weights in proportion; its index and probability.
pub(crate) fn choose(
    weights: impl Iterator<Item = f32> + Clone,
    random: &mut Random,
) -> Option<(usize, f32)> {
    let total: f32 = weights.clone().sum();
    if total <= 0.0 {
        return None;
    }
    let mut pick = random.next() * total;
    let mut last = None;
    for (index, weight) in weights.enumerate().filter(|w| w.1 > 0.0) {
        last = Some((index, weight / total));
        if pick < weight {
            break;
        }
        pick -= weight;
    }
    last
}
