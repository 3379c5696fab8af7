//! Visibility: what share of light gets straight from place to place, through what lets it pass undeviated.

use std::ops::Range;

use glam::Vec3;

use catoptric_scene::Rgb;

use super::{Hit, Ray, Tracer};
use crate::beam::{Pyramid, Suspect, Suspects};
use crate::packet::{Nearest, Occlusion, Probe};
use crate::plane::PlaneId;
use crate::slab::Passage;

/// Each pass crosses one plane; a hundred layers of panes are opaque.
const MAX_LAYERS: u32 = 128;

impl Tracer<'_> {
    /// Share of light that gets straight from `origin` (in the plane `from`) to `target` (in the plane `to`): 0 or 1,
    /// or the throughput of the panes and blended surfaces between.
    #[inline]
    pub fn visibility(&self, origin: Vec3, from: PlaneId, target: Vec3, to: PlaneId) -> Rgb {
        self.visibility_at_last(origin, from, target, to, 0.0)
    }

    /// The same where light has come `before` metres to `origin`, over mirrors.
    #[inline]
    pub(crate) fn visibility_at_last(
        &self,
        origin: Vec3,
        from: PlaneId,
        target: Vec3,
        to: PlaneId,
        before: f32,
    ) -> Rgb {
        self.segment(origin, from, target - origin, 1.0, to, before)
    }

    /// Share of light that gets straight from `origin` along `direction` to the first of `triangles` that it meets, or to the end of `direction`, which
    /// leads to a point of their outline: what shows as a ball, or by rounding, may be a little larger than they are. Light has come
    /// `before` metres to `origin`, over mirrors.
    pub fn reaches(
        &self,
        origin: Vec3,
        from: PlaneId,
        direction: Vec3,
        triangles: &Range<u32>,
        before: f32,
    ) -> Rgb {
        let mut ray = Ray { origin, direction, from };
        let length = direction.length();
        let mut passage = Passage::new(self, direction.normalize_or_zero(), before + length);
        let mut left = 1.0;
        for _ in 0..MAX_LAYERS {
            let Some(hit) = self.nearest(&ray, f32::INFINITY) else { return passage.share() };
            if hit.t >= left || triangles.contains(&hit.triangle.0) {
                return passage.share();
            }
            if !self.accelerator.passes_anything || !passage.passes(&hit, hit.t * length) {
                return Rgb::ZERO;
            }
            left -= hit.t;
            ray.origin += direction * hit.t;
            ray.from = self.accelerator.planes.of(hit.triangle);
        }
        Rgb::ZERO
    }

    /// Finds what may be in the way in a pyramid; `false` if that is more than `most` triangles. On the safe side: nothing else
    /// is, for certain.
    pub fn suspects_in(&self, pyramid: &Pyramid, most: usize, suspects: &mut Suspects) -> bool {
        self.accelerator.tree.suspects_in(pyramid, most, suspects)
    }

    /// The triangles that are suspected.
    pub fn suspected<'s>(&'s self, suspects: &'s Suspects) -> impl Iterator<Item = Suspect> + 's {
        suspects.triangles(&self.accelerator.tree)
    }

    /// [`visibility`](Self::visibility) where nothing but what is suspected can be in the way.
    #[inline]
    pub fn visibility_among(
        &self,
        suspects: &Suspects,
        origin: Vec3,
        from: PlaneId,
        target: Vec3,
        to: PlaneId,
    ) -> Rgb {
        let direction = target - origin;
        let probe = Probe::new(origin, direction, [from, to]);
        match self.accelerator.tree.occlusion_among(suspects, &probe, 1.0, |n| self.is_solid_here(n)) {
            Occlusion::Blocked => Rgb::ZERO,
            Occlusion::Free => Rgb::ONE,
            Occlusion::Passing => self.undeviated(origin, from, direction, 1.0, to, 0.0),
        }
    }

    /// What a ray meets of what is suspected, within `limit` times its direction.
    #[inline]
    pub fn meets(
        &self,
        suspects: &Suspects,
        origin: Vec3,
        from: PlaneId,
        direction: Vec3,
        limit: f32,
    ) -> Occlusion {
        let probe = Probe::new(origin, direction, [from, PlaneId::NONE]);
        self.accelerator.tree.occlusion_among(suspects, &probe, limit, |n| self.is_solid_here(n))
    }

    /// Share of light that gets straight from `origin` out of the scene along `direction`.
    #[inline]
    pub fn visibility_to_infinity(&self, origin: Vec3, from: PlaneId, direction: Vec3) -> Rgb {
        self.segment(origin, from, direction, f32::INFINITY, PlaneId::NONE, 0.0)
    }

    /// Share of light that gets straight along `length` times a direction, to the plane `to`, after `before` metres over mirrors.
    #[inline]
    fn segment(
        &self,
        origin: Vec3,
        from: PlaneId,
        direction: Vec3,
        length: f32,
        to: PlaneId,
        before: f32,
    ) -> Rgb {
        let probe = Probe::new(origin, direction, [from, to]);
        if self.accelerator.passes_anything {
            return self
                .among_sheets(&probe, direction, length, before)
                .unwrap_or_else(|| self.undeviated(origin, from, direction, length, to, before));
        }
        match self.accelerator.tree.occlusion(&probe, length, |n| self.is_solid_here(n), |_| {}) {
            Occlusion::Free => Rgb::ONE,
            Occlusion::Passing | Occlusion::Blocked => Rgb::ZERO,
        }
    }

    /// The same where something may let light pass: what does is kept while the tree is asked what blocks. `None` if it is too much.
    #[inline(never)]
    fn among_sheets(&self, probe: &Probe, direction: Vec3, length: f32, before: f32) -> Option<Rgb> {
        let mut sheets = Sheets::default();
        let accept = |n: &Nearest| self.is_solid_here(n);
        match self.accelerator.tree.occlusion(probe, length, accept, |n| sheets.add(n)) {
            Occlusion::Blocked => Some(Rgb::ZERO),
            Occlusion::Free => Some(Rgb::ONE),
            Occlusion::Passing => Some(self.through(sheets.in_order()?, direction, length, before)),
        }
    }

    /// Share of light that gets through all that is in the way, in order.
    fn through(&self, sheets: &[Nearest], direction: Vec3, length: f32, before: f32) -> Rgb {
        let scale = direction.length();
        let mut passage = Passage::new(self, direction.normalize_or_zero(), before + scale * length);
        let mut last = (0.0, PlaneId::NONE);
        for sheet in sheets {
            // An edge between two triangles belongs to both.
            if sheet.plane == last.1 {
                continue;
            }
            if !passage.passes(&Hit::new(sheet), (sheet.t - last.0) * scale) {
                return Rgb::ZERO;
            }
            last = (sheet.t, sheet.plane);
        }
        passage.share()
    }

    /// Whether shadow rays may meet things that let a part pass.
    pub fn passes_anything(&self) -> bool {
        self.accelerator.passes_anything
    }

    /// Follows a segment through everything that lets light pass undeviated.
    fn undeviated(
        &self,
        mut origin: Vec3,
        mut from: PlaneId,
        direction: Vec3,
        length: f32,
        to: PlaneId,
        before: f32,
    ) -> Rgb {
        let mut remaining = length;
        let scale = direction.length();
        let mut passage = Passage::new(self, direction.normalize_or_zero(), before + scale * length);
        for _ in 0..MAX_LAYERS {
            let probe = Probe::new(origin, direction, [from, to]);
            let Some(nearest) = self.accelerator.tree.nearest(&probe, remaining, |n| self.is_solid_here(n))
            else {
                return passage.share();
            };
            if nearest.t >= remaining {
                return passage.share();
            }
            let hit = Hit::new(&nearest);
            if !passage.passes(&hit, hit.t * scale) {
                return Rgb::ZERO;
            }
            origin += direction * hit.t;
            remaining -= hit.t;
            from = self.accelerator.planes.of(hit.triangle);
        }
        Rgb::ZERO
    }
}

/// Sheets on a segment that are remembered: two panes of two surfaces, each met along an edge.
const MOST_SHEETS: usize = 8;

/// What a segment meets that lets light pass undeviated.
struct Sheets {
    found: [Nearest; MOST_SHEETS],
    /// How many there are, those that did not fit included.
    count: usize,
}

impl Default for Sheets {
    fn default() -> Self {
        Self { found: [Nearest::NONE; MOST_SHEETS], count: 0 }
    }
}

impl Sheets {
    fn add(&mut self, sheet: Nearest) {
        if let Some(place) = self.found.get_mut(self.count) {
            *place = sheet;
        }
        self.count += 1;
    }

    /// By distance, and by id where that is the same; `None` if there are more.
    fn in_order(&mut self) -> Option<&[Nearest]> {
        let found = self.found.get_mut(..self.count)?;
        found.sort_unstable_by(|a, b| a.t.total_cmp(&b.t).then(a.id.cmp(&b.id)));
        Some(found)
    }
}
