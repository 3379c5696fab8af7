//! What a point sees: targets straight, and mirrors, through which it looks on as its image.

use std::f64::consts::PI;
use std::ops::Range;

use glam::DVec3;

use catoptric_light::contour::{Polygon, irradiance};
use catoptric_scene::Side;
use catoptric_trace::PlaneId;

use super::Analytic;
use super::stage::Stage;
use crate::method::beams::{Beam, Beams, without_short_edges};
use crate::method::visible::{Shadows, Sight};

/// Strips into which thin beams are cut.
pub(super) const STRIPS: usize = 8;
/// Share of the power below which a strip's ray has nothing left: far less than sums round off.
const NOTHING: f64 = 1e-13;
/// Reflections after which a beam goes on as its central ray, and a central ray ends.
const MAX_REFLECTIONS: usize = 1_000;

/// An eye, or its image in the last mirror, and the opening through which it looks.
pub(super) struct View<'s> {
    eye: DVec3,
    normal: DVec3,
    stage: &'s Stage,
    window: Option<&'s Polygon>,
    weight: DVec3,
}

impl<'s> View<'s> {
    pub(super) fn from(eye: DVec3, normal: DVec3, stage: &'s Stage) -> Self {
        Self { eye, normal, stage, window: None, weight: DVec3::ONE }
    }

    fn of(beam: &'s Beam, stages: &'s [Stage]) -> Self {
        let &Beam { mirror, eye, normal, weight, ref window, .. } = beam;
        Self { eye, normal, stage: &stages[mirror], window: Some(window), weight }
    }
}

/// What a row keeps account of.
pub(super) struct Scratch {
    pub(super) shadows: Shadows,
    pub(super) buffers: [Polygon; 2],
    pub(super) parts: Vec<Polygon>,
    /// Polygons that were looked at.
    pub(super) work: u64,
    /// Looking ends where more have been looked at.
    pub(super) stop: u64,
    /// Beams that carry less are thin.
    pub(super) thin: f64,
    /// What thin beams brought to each element from the present eye.
    pub(super) landed: Vec<f64>,
}

impl Scratch {
    /// Visits the parts of a polygon in the plane `plane` that are in sight and in no shadow.
    fn visible(&mut self, sight: &Sight, outline: &Polygon, plane: PlaneId, mut visit: impl FnMut(&Polygon)) {
        let seen = sight.clip(outline, &mut self.buffers);
        if seen.is_empty() {
            return;
        }
        if !self.shadows.touch(seen, plane) {
            visit(seen);
            return;
        }
        self.parts.clear();
        self.parts.push(*seen);
        self.shadows.subtract(&mut self.parts, plane);
        self.parts.iter().for_each(visit);
    }
}

impl Analytic<'_> {
    /// Adds F(eye → j) for all j, as far as it comes over a number of reflections within `band`, to `out`.
    pub(super) fn look(&self, eye: &View, band: &Range<usize>, out: &mut [DVec3], scratch: &mut Scratch) {
        let diagonal = self.tracer.extent().inner.diagonal;
        let mut beams = Beams::new(diagonal);
        self.look_once(eye, 0, band, out, &mut beams, scratch);
        for depth in 1..=MAX_REFLECTIONS {
            let level = beams.finished();
            if level.is_empty() {
                return;
            }
            beams = Beams::new(diagonal);
            for beam in &level {
                if scratch.work > scratch.stop {
                    return;
                }
                if depth < MAX_REFLECTIONS && beam.factor * beam.weight.max_element() >= scratch.thin {
                    self.look_once(&View::of(beam, &self.stages), depth, band, out, &mut beams, scratch);
                } else if band.contains(&depth) {
                    self.follow_strips(beam, out, &mut scratch.landed);
                }
            }
        }
    }

    /// What is seen without a further reflection: targets add to `out`, mirrors to `beams`.
    fn look_once(
        &self,
        view: &View,
        depth: usize,
        band: &Range<usize>,
        out: &mut [DVec3],
        beams: &mut Beams,
        scratch: &mut Scratch,
    ) {
        scratch.work += (view.stage.targets.len() + view.stage.mirrors.len()) as u64;
        let sight = Sight::through(view.eye, view.window);
        scratch.shadows.cast(view.stage.blockers.iter().filter(|b| sight.meets(&b.outline)), view.eye);
        if band.contains(&depth) {
            for target in &view.stage.targets {
                if target.normal.dot(view.eye) > target.offset && sight.meets(&target.outline) {
                    let mut factor = 0.0;
                    scratch.visible(&sight, &target.outline, target.plane, |part| {
                        factor += irradiance(view.eye, view.normal, part);
                    });
                    out[target.element] += view.weight * (factor / PI);
                }
            }
        }
        if depth + 1 < band.end {
            for (index, outline) in &view.stage.mirrors {
                let mirror = &self.mirrors[*index];
                if mirror.normal.dot(view.eye) > mirror.offset && sight.meets(outline) {
                    let reflect = |v: DVec3| v - mirror.normal * (2.0 * mirror.normal.dot(v));
                    let image = reflect(view.eye) + mirror.normal * (2.0 * mirror.offset);
                    let (normal, weight) = (reflect(view.normal), view.weight * mirror.reflectance);
                    scratch.visible(&sight, outline, mirror.plane, |part| {
                        let window = without_short_edges(part);
                        let factor = irradiance(view.eye, view.normal, &window) / PI;
                        if factor > 0.0 {
                            beams.add(Beam { mirror: *index, eye: image, normal, weight, window, factor });
                        }
                    });
                }
            }
        }
    }

    /// A thin beam goes on as the central rays of strips across its longest extent. From far down a duct windows are narrow
    /// but tall: what leaves them low goes on for many reflections more than what leaves them high.
    fn follow_strips(&self, beam: &Beam, out: &mut [DVec3], landed: &mut [f64]) {
        let corners = beam.window.corners();
        let edges = (0..corners.len()).map(|k| corners[(k + 1) % corners.len()] - corners[k]);
        let longest =
            edges.fold(DVec3::ZERO, |a, b| if b.length_squared() > a.length_squared() { b } else { a });
        let Some(axis) = longest.try_normalize() else { return };
        let (low, high) = corners
            .iter()
            .map(|c| axis.dot(*c))
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), h| (low.min(h), high.max(h)));
        let at = |k: usize| low + (high - low) * k as f64 / STRIPS as f64;
        let mut rest = beam.window;
        for k in 1..=STRIPS {
            let strip = if k == STRIPS { rest } else { rest.clipped(-axis, -at(k)) };
            rest = rest.clipped(axis, at(k));
            if strip.is_empty() {
                continue;
            }
            let factor = irradiance(beam.eye, beam.normal, &strip) / PI;
            if factor > 0.0 {
                self.follow_center(beam, &strip, beam.weight * factor, out, landed);
            }
        }
    }

    /// A strip lands where its central ray does: its power is kept, its place is right within its width.
    fn follow_center(
        &self,
        beam: &Beam,
        strip: &Polygon,
        mut weight: DVec3,
        out: &mut [DVec3],
        landed: &mut [f64],
    ) {
        let sent = weight.max_element();
        let corners = strip.corners();
        let mut origin = corners.iter().copied().sum::<DVec3>() / corners.len() as f64;
        // The eye is the mirror's image already.
        let mut direction = (origin - beam.eye).normalize_or_zero();
        let mut from = self.mirrors[beam.mirror].plane;
        for _ in 0..MAX_REFLECTIONS {
            let Some((wall, t)) = self.nearest(origin, direction, from) else { return };
            origin += direction * t;
            let (blocker, triangle) = (&self.walls[wall], self.triangles[wall]);
            let front = self.tracer.scene().geometric_normal(triangle).as_dvec3();
            let side = if front.dot(direction) < 0.0 { Side::Front } else { Side::Back };
            if side == Side::Back && !self.tracer.has_back(triangle) {
                out[self.set.len()] += weight;
                return;
            }
            if let Some(element) = self.set.locate(triangle, side, origin) {
                out[element as usize] += weight;
                landed[element as usize] += sent;
            }
            let Some(reflectance) = self.reflectances[wall] else { return };
            weight *= reflectance;
            if weight.max_element() < NOTHING {
                return;
            }
            direction -= blocker.normal * (2.0 * blocker.normal.dot(direction));
            from = blocker.plane;
        }
    }

    fn nearest(&self, origin: DVec3, direction: DVec3, from: PlaneId) -> Option<(usize, f64)> {
        let mut best: Option<(usize, f64)> = None;
        for (index, wall) in self.walls.iter().enumerate() {
            let speed = wall.normal.dot(direction);
            if wall.plane == from || speed == 0.0 {
                continue;
            }
            let t = (wall.offset - wall.normal.dot(origin)) / speed;
            if t <= 0.0 || best.is_some_and(|(_, b)| t >= b) {
                continue;
            }
            let point = origin + direction * t;
            let corners = wall.outline.corners();
            let inside = self.edges[index]
                .iter()
                .zip(corners)
                .all(|(&(inward, slack), &a)| inward.dot(point - a) >= slack);
            if inside {
                best = Some((index, t));
            }
        }
        best
    }
}
