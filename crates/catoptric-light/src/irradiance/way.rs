//! What is in the way of a source's light, before any shadow ray is shot: nothing, a few triangles whose shadows are cut out
//! exactly, or so much that rays must ask.

use glam::{DVec3, Vec3};

use catoptric_scene::{AlphaMode, Material};
use catoptric_trace::beam::{Base, End, Pyramid, Suspect, Suspects};
use catoptric_trace::plane::Plane;
use catoptric_trace::{PlaneId, Tracer};

use crate::chains::Unfolded;
use crate::contour::{self, Polygon};
use crate::parts::{Parts, Shadow};

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

impl Passing {
    fn of(material: &Material) -> Self {
        let plain = material.alpha_mode == AlphaMode::Opaque
            && material.base_texture.is_none()
            && material.transmission_texture.is_none();
        let is_clear = plain && material.transmission >= 1.0 && material.base_color.min_element() >= CLEAR;
        if is_clear { Self::Clear } else { Self::Varied }
    }
}

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
        for (chain, level) in at.chain.iter().flat_map(|c| (0..c.planes.len()).map(move |level| (c, level))) {
            // Up to each mirror, towards the image of the light behind it.
            let (mirrors, id) = chain.mirrors_from(level)?;
            let image = mirrors.iter().rev().fold(base, |base, plane| base.reflected(plane));
            let far = End::mirror(&mirrors[0], id, eye);
            let pyramid = Pyramid::new(eye, &image, near, far, 0..0)?;
            if !self.tracer.suspects_in(&pyramid, shadows, suspects) {
                return None;
            }
            if !suspects.is_empty() {
                let before = (level > 0).then_some(near);
                remainder.cut_out(self.tracer, target, eye, mirrors, [before, Some(far)], suspects)?;
            }
            eye = mirrors[0].reflect_point(eye);
            near = End::mirror(&mirrors[0], id, image.reflected(&mirrors[0]).corners()[0]);
        }
        let far = End::behind(&base, eye, goal)?;
        // Rays over mirrors do not ask suspects: what stands between two mirrors is not among them.
        let packets = if at.chain.is_some() { 0 } else { packets };
        let pyramid = Pyramid::new(eye, &base, near, far, lamp)?;
        if !self.tracer.suspects_in(&pyramid, (4 * packets).max(shadows), suspects) {
            return None;
        }
        if !suspects.is_empty() {
            let before = at.chain.map(|_| near);
            let is_cut = suspects.triangle_count() <= shadows
                && self.stand_before(target, suspects, eye)
                && remainder.cut_out(self.tracer, target, eye, &[], [before, Some(far)], suspects).is_some();
            if !is_cut {
                return (suspects.packet_count() <= packets).then_some(Way::Among);
            }
        }
        Some(if remainder.is_begun {
            Way::Seen { unit: remainder.unit(target, at.image), passes: remainder.passes }
        } else {
            Way::Free
        })
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
                self.passes = self.passes.max(Passing::of(tracer.scene().material_of(id)));
                continue;
            }
            let mut triangles = self.blockers.iter_mut().filter(|b| b.plane == plane && b.count == 3);
            if !triangles.any(|triangle| triangle.join(corners)) {
                let [a, b, c] = corners;
                self.blockers.push(Blocker { corners: [a, b, c, c], count: 3, plane });
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

/// A triangle, or a convex quadrilateral of two that share an edge.
#[derive(Clone, Copy, Debug)]
struct Blocker {
    corners: [Vec3; 4],
    count: usize,
    plane: PlaneId,
}

impl Blocker {
    fn corners(&self) -> &[Vec3] {
        &self.corners[..self.count]
    }

    /// Adds a triangle of the same plane to one whose edge it shares, if the two are convex.
    fn join(&mut self, other: [Vec3; 3]) -> bool {
        for k in 0..3 {
            let [a, b, c] = [0, 1, 2].map(|i| self.corners[(k + i) % 3]);
            for m in 0..3 {
                let [p, q, d] = [0, 1, 2].map(|i| other[(m + i) % 3]);
                if a != q || b != p {
                    continue;
                }
                let quad = [a, d, b, c];
                let turn = |i: usize| {
                    let [p, q, r] = [i, i + 1, i + 2].map(|i| quad[i % 4]);
                    (q - p).cross(r - q)
                };
                let is_convex = (1..4).all(|i| turn(i).dot(turn(0)) > 0.0);
                if is_convex {
                    (self.corners, self.count) = (quad, 4);
                }
                return is_convex;
            }
        }
        false
    }

    /// Solid angle from a point, about.
    fn angle(&self, from: Vec3) -> f32 {
        let [a, b, c, d] = self.corners.map(|corner| corner - from);
        let squared = ((a + b + c) / 3.0).length_squared();
        (a.cross(b).dot(c).abs() + a.cross(c).dot(d).abs()) / (2.0 * squared * squared.sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn triangles_that_share_an_edge_are_one_blocker_where_it_is_convex() {
        let [a, b, c] = [Vec3::ZERO, Vec3::X, Vec3::Y];
        let triangle = Blocker { corners: [a, b, c, c], count: 3, plane: PlaneId::NONE };
        let joined = |far: Vec3, turn: usize| {
            let mut blocker = triangle;
            let other = [0, 1, 2].map(|i| [c, b, far][(i + turn) % 3]);
            blocker.join(other).then_some(blocker)
        };
        for turn in 0..3 {
            let far = Vec3::new(0.9, 0.8, 0.0);
            let quad = joined(far, turn).expect("convex");
            let sides = |corners: &[Vec3]| -> f32 {
                (0..corners.len()).map(|i| corners[i].cross(corners[(i + 1) % corners.len()]).z).sum()
            };
            // The shoelace formula: twice the area, that of the first triangle and of the second.
            assert!((sides(quad.corners()) - (1.0 + 0.7)).abs() < 1e-6, "{quad:?}");
            // Beyond the line through a and b the quadrilateral would have a dent at b.
            assert!(joined(Vec3::new(2.0, -0.5, 0.0), turn).is_none());
        }
        // The other way round, and apart.
        let mut blocker = triangle;
        assert!(!blocker.join([b, c, Vec3::ONE]));
        assert!(!blocker.join([b * 2.0, c * 2.0, Vec3::ONE]));
        // A right triangle of legs 1 at a distance of 10: 1/2 / 10².
        let far = triangle.angle(Vec3::new(1.0 / 3.0, 1.0 / 3.0, 10.0));
        assert!((far / 0.005 - 1.0).abs() < 0.02, "{far}");
    }
}
