//! Area-to-area Monte Carlo, stratified over both surfaces, with images in planar mirrors.
//!
//! F_ij = 1/A_i ∫∫ G(x, y) V(x, y) dy dx with G = cosθ cosθ'/(π r²) (Goral et al. 1984). Between surfaces that touch, G has
//! no bound and the plain estimator no variance. It is therefore combined with hemisphere rays by the balance
//! heuristic (Veach & Guibas 1995): per m² of j a pair has the density 1/A_j, a ray G, so a pair counts with
//! (1/A_j)/(1/A_j + G), a ray with G/(1/A_j + G), and no sample counts more than 1. Rays alone find what no image
//! shows: curved mirrors, glass, chains that are too long.

use glam::{DVec3, Vec3};

use catoptric_trace::sequence::{Key, Purpose};
use catoptric_trace::walk::{Arrival, follow};
use catoptric_trace::{PlaneId, Tracer};

use super::scrambles::{SCRAMBLES, Scrambles};
use super::{ElementSet, Entry, FactorRow, FormFactors, MethodParams, Piece, rays};
use crate::method::elements::Element;

/// Image chains, at most: every pair of points is tried through each.
const MAX_CHAINS: usize = 48;
/// Planar reflections of an image, at most.
const MAX_REFLECTIONS: usize = 4;

/// The method.
pub struct Area<'a> {
    tracer: &'a Tracer<'a>,
    set: &'a ElementSet,
    params: MethodParams,
    /// Sequences of mirror planes, shortest first; the first is the direct path.
    chains: Vec<Vec<PlaneId>>,
}

impl<'a> Area<'a> {
    /// Lists the image chains.
    pub fn new(tracer: &'a Tracer<'a>, set: &'a ElementSet, params: &MethodParams) -> Self {
        let mut planes: Vec<PlaneId> = (0..tracer.planes().len() as u32)
            .map(PlaneId)
            .filter(|&p| params.walk.extended && tracer.plane_has_images(p))
            .collect();
        planes.sort();
        let mut chains: Vec<Vec<PlaneId>> = vec![Vec::new()];
        let mut front = chains.clone();
        for _ in 0..MAX_REFLECTIONS {
            let next: Vec<Vec<PlaneId>> = front
                .iter()
                .flat_map(|chain| {
                    let longer = planes.iter().filter(|p| chain.last() != Some(p));
                    longer.map(|&p| chain.iter().copied().chain([p]).collect())
                })
                .collect();
            // A length is on the list with all its chains or not at all.
            if next.is_empty() || chains.len() + next.len() > MAX_CHAINS {
                break;
            }
            chains.extend(next.iter().cloned());
            front = next;
        }
        Self { tracer, set, params: *params, chains }
    }

    /// Density of rays per m² at the end of a path: G.
    fn kernel(cos_from: f64, cos_to: f64, distance: f64) -> f64 {
        if cos_from <= 0.0 || cos_to <= 0.0 || distance <= 0.0 {
            return 0.0;
        }
        cos_from * cos_to / (std::f64::consts::PI * distance * distance)
    }

    /// G V through every chain between two points, weighted against rays.
    fn pair(
        &self,
        (piece, x): (&Piece, DVec3),
        (other, y): (&Piece, DVec3),
        target: &Element,
        targets: &mut Vec<Vec3>,
    ) -> DVec3 {
        let mut sum = DVec3::ZERO;
        for chain in &self.chains {
            if chain.first() == Some(&piece.plane) || (chain.is_empty() && piece.plane == other.plane) {
                continue;
            }
            // The image of y and of its normal through the mirrors, the last one first.
            let (mut image, mut normal) = (y, other.normal);
            targets.clear();
            targets.push(image.as_vec3());
            for &plane in chain.iter().rev() {
                let mirror = self.tracer.planes().plane(plane);
                image = mirror.reflect_point(image);
                normal = mirror.reflect_vector(normal);
                targets.push(image.as_vec3());
            }
            targets.reverse();
            let towards = image - x;
            let distance = towards.length();
            let direction = towards / distance.max(f64::MIN_POSITIVE);
            let g = Self::kernel(direction.dot(piece.normal), -direction.dot(normal), distance);
            if g <= 0.0 {
                continue;
            }
            let passes = follow(self.tracer, x.as_vec3(), piece.plane, chain, targets, other.plane);
            // A target counts with G V A_j; the balance heuristic makes that G V / (1/A_j + G).
            sum += passes.as_dvec3() * (g / (1.0 / target.area + g));
        }
        sum
    }

    /// Whether pairs of points find a path, too.
    fn is_image(&self, arrival: &Arrival) -> bool {
        if !self.params.walk.extended {
            return true;
        }
        let chain = arrival.chain;
        let planes = chain.planes();
        !chain.is_curved() && planes.is_some_and(|p| self.chains.iter().any(|c| c == p))
    }
}

impl FormFactors for Area<'_> {
    fn row(&self, from: u32) -> FactorRow {
        // Hemisphere rays, each weighted against the pairs that could have found its path.
        let cast = rays::cast(self.tracer, self.set, &self.params, from, |arrival, cos_from| {
            let interaction = arrival.interaction;
            let position = arrival.position.as_dvec3();
            let to = self.set.locate(arrival.hit.triangle, interaction.side, position);
            let Some(to) = to.filter(|_| self.is_image(arrival)) else { return 1.0 };
            let cos_to = f64::from(-arrival.direction.dot(interaction.geometric));
            let g = Self::kernel(cos_from, cos_to, f64::from(arrival.distance));
            g / (1.0 / self.set.elements()[to as usize].area + g)
        });

        // Pairs of points.
        let each = self.params.rays.max(1);
        let key = Key::new(self.params.seed, Purpose::FormFactor, u64::from(from) | 1 << 40);
        let mut scrambles = Scrambles::new(self.set.len());
        let share = 1.0 / f64::from(each);
        let mut targets = Vec::new();
        for scramble in 0..SCRAMBLES {
            for (to, target) in self.set.elements().iter().enumerate() {
                let to = to as u32;
                if !self.can_see(from, to) {
                    continue;
                }
                let points = key.child(scramble).child(to);
                let mut sum = DVec3::ZERO;
                for index in 0..each {
                    let [u, v, s, t] = points.point4(index).map(f64::from);
                    let (start, end) = (self.set.point(from, u, v), self.set.point(to, s, t));
                    sum += self.pair(start, end, target, &mut targets);
                }
                scrambles.add(to, sum * share);
            }
            scrambles.next();
        }
        let (mut factors, mut errors) = scrambles.finish();
        for Entry { to, factor, error } in cast.entries {
            factors[to as usize] += factor;
            errors[to as usize] = libm::hypot(errors[to as usize], error);
        }
        let pairs = u64::from(each) * u64::from(SCRAMBLES) * self.set.len() as u64;
        FactorRow::from_dense(&factors, &errors, cast.ledger, cast.samples + pairs)
    }
}

impl Area<'_> {
    /// Whether any path could lead from one element to another: without mirrors the two must face each other.
    fn can_see(&self, from: u32, to: u32) -> bool {
        self.chains.len() > 1
            || self
                .set
                .pieces(from)
                .iter()
                .any(|p| self.set.pieces(to).iter().any(|q| p.plane != q.plane && faces(p, q) && faces(q, p)))
    }
}

/// Whether any corner of `other` is in front of `piece`.
fn faces(piece: &Piece, other: &Piece) -> bool {
    let offset = piece.normal.dot(piece.outline.corners()[0]);
    other.outline.corners().iter().any(|c| piece.normal.dot(*c) > offset)
}
