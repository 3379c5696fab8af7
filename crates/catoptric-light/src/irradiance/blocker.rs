//! Convex parts of what blocks light: triangles, and pairs of them; of a scene the largest, which are cut out of sources wherever so much is
//! in the way that it is not known as a whole.

use glam::Vec3;

use catoptric_scene::{AlphaMode, Scene, TriangleId};
use catoptric_trace::{PlaneId, Planes};

/// A triangle, or a convex quadrilateral of two that share an edge.
#[derive(Clone, Copy, Debug)]
pub(super) struct Blocker {
    corners: [Vec3; 4],
    count: usize,
    plane: PlaneId,
}

impl Blocker {
    pub(super) fn triangle([a, b, c]: [Vec3; 3], plane: PlaneId) -> Self {
        Self { corners: [a, b, c, c], count: 3, plane }
    }

    /// Its corners, in order around it.
    pub(super) fn corners(&self) -> &[Vec3] {
        &self.corners[..self.count]
    }

    /// Whether a triangle in a plane may be its other half.
    pub(super) fn may_join(&self, plane: PlaneId) -> bool {
        self.plane == plane && self.count == 3
    }

    fn area(&self) -> f32 {
        let [a, b, c, d] = self.corners;
        0.5 * ((b - a).cross(c - a).length() + (c - a).cross(d - a).length())
    }

    /// Adds a triangle of the same plane to one whose edge it shares, if the two are convex.
    pub(super) fn join(&mut self, other: [Vec3; 3]) -> bool {
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
    pub(super) fn angle(&self, from: Vec3) -> f32 {
        let [a, b, c, d] = self.corners.map(|corner| corner - from);
        let squared = ((a + b + c) / 3.0).length_squared();
        (a.cross(b).dot(c).abs() + a.cross(c).dot(d).abs()) / (2.0 * squared * squared.sqrt())
    }
}

/// The largest blockers of a scene: walls, floors, doors, the tops of tables.
#[derive(Clone, Debug, Default)]
pub(super) struct Walls(Vec<Blocker>);

/// Walls at most: each is looked at for every source before which so much is in the way that rays must ask.
const MAX_WALLS: usize = 32;
/// Walls have at least this share of the area of a scene.
const MIN_WALL: f32 = 1e-4;

impl Walls {
    /// Those that let no light pass.
    pub(super) fn new(scene: &Scene, planes: &Planes) -> Self {
        let ids = || (0..scene.triangles().len() as u32).map(TriangleId);
        let total: f64 = ids().map(|id| f64::from(scene.area(id))).sum();
        let least = MIN_WALL * total as f32;
        let is_opaque = |id: TriangleId| {
            let material = scene.material_of(id);
            material.alpha_mode == AlphaMode::Opaque && material.transmission <= 0.0
        };
        let mut walls: Vec<Blocker> = Vec::new();
        for id in ids().filter(|&id| scene.area(id) > 0.5 * least && is_opaque(id)) {
            let (corners, plane) = (scene.corners(id), planes.of(id));
            // The two halves of a rectangle come one after the other.
            if !walls.last_mut().is_some_and(|last| last.may_join(plane) && last.join(corners)) {
                walls.push(Blocker::triangle(corners, plane));
            }
        }
        walls.retain(|wall| wall.area() > least);
        walls.sort_by(|a, b| b.area().total_cmp(&a.area()));
        walls.truncate(MAX_WALLS);
        Self(walls)
    }

    /// Those in other planes than these two.
    pub(super) fn beside(&self, planes: [PlaneId; 2]) -> impl Iterator<Item = &Blocker> {
        self.0.iter().filter(move |wall| !planes.contains(&wall.plane))
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
