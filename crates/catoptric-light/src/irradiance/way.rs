//! What is in the way of a source's light, before any shadow ray is shot: nothing, a few triangles whose shadows are cut out
//! exactly, or so much that rays must ask.

use glam::{DVec2, DVec3, Vec3};

use catoptric_scene::{AlphaMode, Material};
use catoptric_trace::beam::{Base, End, Pyramid, Suspect, Suspects};
use catoptric_trace::plane::Plane;
use catoptric_trace::{PlaneId, Tracer};

use crate::chains::Unfolded;
use crate::contour::{self, Polygon};
use crate::lamp::Lamp;
use crate::parts::{Parts, Shadow};

use super::blocker::{Blocker, Walls};
use super::shadow::{Goal, Target};
use super::{Lights, Scratch, Standpoint};

/// What is known of the way to a target.
#[derive(Clone, Copy)]
pub(super) enum Way {
    /// Nothing is in it.
    Free,
    /// What remains of the target is seen.
    Seen {
        /// Its irradiance by unit radiance.
        unit: f64,
        /// What lets light pass before it.
        passes: Passing,
    },
    /// More than is known; but what the walls of the scene leave of the target is all that may be seen.
    Partly {
        /// Irradiance by unit radiance of what they leave.
        unit: f64,
        /// Nothing else than the suspects in the scratch is in the way.
        among: bool,
    },
    /// The suspects in the scratch, at most.
    Among,
    /// No more than that something may be.
    Unknown,
}

/// What may lie before a target and lets its light pass undeviated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Passing {
    /// Nothing.
    #[default]
    Nothing,
    /// Clear panes: as smooth as Fresnel's transmittance, and beside them hardly more arrives.
    Clear,
    /// What is tinted or textured, perhaps beside what is not: what arrives may vary as at edges.
    Varied,
}

/// Tint of a pane, at normal incidence, from which on it is clear.
const CLEAR: f32 = 0.9;
/// Cosine below which a pane's transmittance falls from 0.84 to nothing: less is as a shadow.
const STEEP: f64 = 0.5;

impl Passing {
    /// By the cosine under which light meets it.
    fn of(material: &Material, cosine: f64) -> Self {
        let plain = material.alpha_mode == AlphaMode::Opaque
            && material.base_texture.is_none()
            && material.transmission_texture.is_none();
        let is_clear = plain && material.transmission >= 1.0 && material.base_color.min_element() >= CLEAR;
        if is_clear && cosine >= STEEP { Self::Clear } else { Self::Varied }
    }
}

/// Samples keep to what walls leave of a target if that is less than this share of it.
const MOST: f64 = 0.9;

/// A packet of suspects is worth its finding if so many rays ask it.
const RAYS_PER_SUSPECT: u32 = 8;

impl Lights<'_> {
    /// What is in the way to a target, over the mirrors of a chain. The shadows of up to `shadows` triangles are cut out; where they are
    /// more, or holes are among them, what else is worth to know for `rays` shadow rays.
    pub(super) fn way(
        &self,
        at: Standpoint,
        target: &Target,
        rays: u32,
        shadows: u32,
        scratch: &mut Scratch,
    ) -> Way {
        let Scratch { remainder, suspects, .. } = scratch;
        self.look(at, target, (rays / RAYS_PER_SUSPECT) as usize, shadows as usize, remainder, suspects)
            .unwrap_or(Way::Unknown)
    }

    fn look(
        &self,
        at: Standpoint,
        target: &Target,
        packets: usize,
        shadows: usize,
        remainder: &mut Remainder,
        suspects: &mut Suspects,
    ) -> Option<Way> {
        let base = Base::around(target.corners)?;
        let (goal, lamp) = match target.to {
            Goal::Plane(plane) => (plane, 0..0),
            Goal::Lamp(lamp) => (PlaneId::NONE, lamp.triangles.clone()),
        };
        let receiver = at.receiver;
        let position = receiver.position.as_dvec3();
        let mut near = End::new(position, receiver.geometric.as_dvec3(), receiver.plane);
        let mut eye = position;
        remainder.reset();
        let mut is_known = true;
        let mut from = receiver.plane;
        for (chain, level) in at.chain.iter().flat_map(|c| (0..c.planes.len()).map(move |level| (c, level))) {
            // Up to each mirror, towards the image of the light behind it.
            let (mirrors, id) = chain.mirrors_from(level)?;
            let image = mirrors.iter().rev().fold(base, |base, plane| base.reflected(plane));
            // Light comes and goes on one side of it: of the eye and of the image of what is next, where one may touch the mirror.
            let beside = eye.midpoint(mirrors[0].reflect_point(image.center()));
            let far = End::mirror(&mirrors[0], id, beside);
            let pyramid = Pyramid::new(eye, &image, near, far, 0..0)?;
            let before = (level > 0).then_some(near);
            if !self.tracer.suspects_in(&pyramid, shadows, suspects) {
                if shadows == 0 {
                    return None;
                }
                let ends = [before, Some(far)];
                remainder.cut_out_walls(&self.walls, target, &pyramid, eye, mirrors, ends, [from, id])?;
                is_known = false;
            } else if !suspects.is_empty() {
                remainder.cut_out(self.tracer, target, eye, mirrors, [before, Some(far)], suspects)?;
            }
            eye = mirrors[0].reflect_point(eye);
            near = far;
            from = id;
        }
        let far = End::behind(&base, eye, goal)?;
        // Rays over mirrors do not ask suspects: what stands between two mirrors is not among them.
        let packets = if at.chain.is_some() { 0 } else { packets };
        let pyramid = Pyramid::new(eye, &base, near, far, lamp)?;
        let are_listed = self.tracer.suspects_in(&pyramid, (4 * packets).max(shadows), suspects);
        let before = at.chain.map(|_| near);
        let ends = [before, Some(far)];
        let are_cut = are_listed
            && (suspects.is_empty()
                || suspects.triangle_count() <= shadows
                    && self.stand_before(target, suspects, eye)
                    && remainder.cut_out(self.tracer, target, eye, &[], ends, suspects).is_some());
        if are_cut && is_known {
            let passes = remainder.passes;
            let unit = remainder.is_begun.then(|| remainder.unit(target, at.image));
            return Some(unit.map_or(Way::Free, |unit| Way::Seen { unit, passes }));
        }
        let among = at.chain.is_none() && are_listed && suspects.packet_count() <= packets;
        if shadows > 0 {
            if !are_cut {
                remainder.cut_out_walls(&self.walls, target, &pyramid, eye, &[], ends, [from, goal])?;
            }
            if remainder.is_begun {
                let unit = remainder.unit(target, at.image);
                if unit < MOST * target.unit {
                    return Some(Way::Partly { unit, among });
                }
            }
        }
        among.then_some(Way::Among)
    }

    /// Whether all suspects stand before a target, as its shadow's blockers must: some may stand beside a lamp, or behind it.
    fn stand_before(&self, target: &Target, suspects: &Suspects, eye: DVec3) -> bool {
        let Goal::Lamp(lamp) = target.to else { return true };
        let distance = lamp.distance(eye);
        let is_before = |c: &Vec3| (c.as_dvec3() - eye).length() < distance;
        self.tracer.suspected(suspects).all(|s| s.corners.iter().all(is_before))
    }
}

/// What remains of a target as shadows are cut out of it.
#[derive(Clone, Debug, Default)]
pub(super) struct Remainder {
    parts: Parts,
    is_begun: bool,
    passes: Passing,
    triangles: Vec<Suspect>,
    blockers: Vec<Blocker>,
    order: Vec<(f32, u32)>,
    corners: [Vec<DVec3>; 2],
}

impl Remainder {
    fn reset(&mut self) {
        self.is_begun = false;
        self.passes = Passing::Nothing;
    }

    /// Cuts the shadows of what is suspected between two ends out of a target, whose image behind `mirrors` is seen from `eye`.
    /// `None` where they have holes, or where the rest falls into too many parts.
    fn cut_out(
        &mut self,
        tracer: &Tracer,
        target: &Target,
        eye: DVec3,
        mirrors: &[Plane],
        ends: [Option<End>; 2],
        suspects: &Suspects,
    ) -> Option<()> {
        if !self.is_begun {
            self.is_begun = true;
            self.parts.reset(target.corners)?;
        }
        let frame = self.parts.frame().reflected(mirrors);
        // In an order that is not the tree's.
        self.triangles.clear();
        self.triangles.extend(tracer.suspected(suspects));
        self.triangles.sort_unstable_by_key(|suspect| suspect.id);
        self.blockers.clear();
        for &Suspect { id, corners, plane, passes, cut_out } in &self.triangles {
            if cut_out {
                return None;
            }
            if passes {
                let along = frame.point(DVec2::ZERO) - eye;
                let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).as_dvec3();
                let cosine = normal.dot(along).abs() / (normal.length() * along.length());
                self.passes = self.passes.max(Passing::of(tracer.scene().material_of(id), cosine));
                continue;
            }
            let mut triangles = self.blockers.iter_mut().filter(|b| b.may_join(plane));
            if !triangles.any(|triangle| triangle.join(corners)) {
                self.blockers.push(Blocker::triangle(corners, plane));
            }
        }
        // What hides most goes first: less is left to cut.
        let from = eye.as_vec3();
        let angles = self.blockers.iter().zip(0..).map(|(blocker, index)| (blocker.angle(from), index));
        self.order.clear();
        self.order.extend(angles);
        self.order.sort_unstable_by(|x, y| y.0.total_cmp(&x.0).then(x.1.cmp(&y.1)));
        let [corners, spare] = &mut self.corners;
        for &(_, index) in &self.order {
            corners.clear();
            corners.extend(self.blockers[index as usize].corners().iter().map(|c| c.as_dvec3()));
            for end in ends.iter().flatten() {
                contour::cut(corners, end.normal(), end.offset(), spare);
            }
            if let Some(shadow) = Shadow::cast(corners, eye, &frame) {
                if !self.parts.remove(&shadow) {
                    return None;
                }
                if self.parts.is_empty() {
                    break;
                }
            }
        }
        Some(())
    }

    /// Cuts out the shadows of the walls of a scene, in other planes than `beside`, as [`cut_out`](Self::cut_out) does: what is left may be
    /// hidden by other things. `None` where the target has no area.
    fn cut_out_walls(
        &mut self,
        walls: &Walls,
        target: &Target,
        pyramid: &Pyramid,
        eye: DVec3,
        mirrors: &[Plane],
        ends: [Option<End>; 2],
        beside: [PlaneId; 2],
    ) -> Option<()> {
        let [corners, spare] = &mut self.corners;
        for wall in walls.beside(beside).filter(|wall| !pyramid.misses(wall.corners())) {
            if !self.is_begun {
                self.is_begun = true;
                self.parts.reset(target.corners)?;
            }
            let frame = self.parts.frame().reflected(mirrors);
            corners.clear();
            corners.extend(wall.corners().iter().map(|c| c.as_dvec3()));
            for end in ends.iter().flatten() {
                contour::cut(corners, end.normal(), end.offset(), spare);
            }
            let is_before = |lamp: &Lamp| corners.iter().all(|c| (*c - eye).length() < lamp.distance(eye));
            if matches!(target.to, Goal::Lamp(lamp) if !is_before(lamp)) {
                continue;
            }
            let Some(shadow) = Shadow::cast(corners, eye, &frame) else { continue };
            if !self.parts.remove(&shadow) || self.parts.is_empty() {
                break;
            }
        }
        Some(())
    }

    /// Irradiance by unit radiance.
    fn unit(&mut self, target: &Target, image: &Unfolded) -> f64 {
        let lobed = target.cell.filter(|cell| !cell.lobe.is_diffuse());
        let [corners, spare] = &mut self.corners;
        let mut unit = 0.0;
        self.parts.visit(corners, |part| {
            unit += match lobed {
                Some(cell) => cell.unit_irradiance(image.position, image.normal, &Polygon::new(part)),
                None => contour::irradiance_of(image.position, image.normal, part, spare),
            };
        });
        unit
    }

    /// A point of it, uniform by area, by unit-square coordinates.
    pub(super) fn sample(&self, u: f64, v: f64) -> DVec3 {
        self.parts.sample(u, v)
    }
}
