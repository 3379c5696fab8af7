//! How large a scene is, and how exactly its places are known.
//!
//! A position carries 2⁻²⁴ of its largest coordinate, so what counts as touching is a share of how far things reach. What reaches far
//! beyond the others (ground to the horizon around a house, a vertex that went astray) knows its own places so well and no better,
//! and must not blur those of the house.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use catoptric_scene::{Scene, TriangleId};

/// A bounding box by its middle and size.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Bounds {
    /// Centre, metres.
    pub center: DVec3,
    /// Length of the diagonal, metres.
    pub diagonal: f64,
}

/// The bounds of a scene and of what does not lie far outside.
#[derive(Clone, Debug, Default)]
pub struct Extent {
    /// Around everything.
    pub all: Bounds,
    /// Around all but what is outlying. The same where nothing is.
    pub inner: Bounds,
    /// How far each outlying triangle reaches, metres, and 0 for the others; empty where nothing is outlying.
    outlying: Vec<f64>,
}

/// A triangle is outlying that reaches so many times as far as half of the scene, each surface of which counts alike: walls and the
/// smallest things in a room are within ten of each other, mostly.
const OUTLYING: f64 = 16.0;

/// A box around nothing.
const NOTHING: [Vec3; 2] = [Vec3::INFINITY, Vec3::NEG_INFINITY];

impl Bounds {
    fn around<'a>(boxes: impl Iterator<Item = &'a [Vec3; 2]>) -> Self {
        let [min, max] = boxes.fold(NOTHING, |[min, max], &[low, high]| [min.min(low), max.max(high)]);
        if min.x > max.x {
            return Self::default();
        }
        let (min, max) = (min.as_dvec3(), max.as_dvec3());
        Self { center: (min + max) * 0.5, diagonal: (max - min).length() }
    }

    /// Bound of the coordinates and distances within, metres: positions are rounded by a share of it.
    pub fn reach(&self) -> f64 {
        self.diagonal + self.center.abs().max_element()
    }
}

impl Extent {
    /// The extent of a scene.
    pub fn new(scene: &Scene) -> Self {
        let triangles = || (0..scene.triangles().len() as u32).map(TriangleId);
        let around = |id: u32| {
            let corners = scene.corners(TriangleId(id));
            corners.iter().fold(NOTHING, |[min, max], &p| [min.min(p), max.max(p)])
        };
        let boxes: Vec<[Vec3; 2]> =
            (0..scene.triangles().len() as u32).into_par_iter().with_min_len(1024).map(around).collect();
        let all = Bounds::around(boxes.iter());
        let reach = |one: &[Vec3; 2]| Bounds::around(std::iter::once(one)).reach();
        let reaches: Vec<f64> = boxes.par_iter().with_min_len(1024).map(reach).collect();
        let mut count = vec![0_u32; scene.surfaces().len()];
        scene.triangles().iter().for_each(|t| count[t.surface.index()] += 1);
        let weight = |id: TriangleId| 1.0 / f64::from(count[scene.triangles()[id.index()].surface.index()]);
        let whole: f64 = triangles().map(weight).sum();
        let most = reaches.iter().copied().fold(0.0, f64::max);
        let far: f64 = triangles().filter(|id| OUTLYING * reaches[id.index()] >= most).map(weight).sum();
        if far > 0.5 * whole {
            // The median is among those: nothing reaches so far beyond it.
            return Self { all, inner: all, outlying: Vec::new() };
        }
        let mut order: Vec<TriangleId> = triangles().collect();
        order.sort_by(|a, b| reaches[a.index()].total_cmp(&reaches[b.index()]));
        let mut sum = 0.0;
        let median = order.iter().find(|&&id| {
            sum += weight(id);
            sum >= 0.5 * whole
        });
        let limit = OUTLYING * median.map_or(most, |id| reaches[id.index()]);
        let outlying: Vec<f64> = reaches.into_iter().map(|r| if r > limit { r } else { 0.0 }).collect();
        let inner = boxes.iter().zip(&outlying).filter(|&(_, &reach)| reach == 0.0).map(|(one, _)| one);
        let inner = Bounds::around(inner);
        Self { all, inner, outlying }
    }

    /// Whether a triangle reaches far beyond the others.
    pub fn is_outlying(&self, triangle: TriangleId) -> bool {
        self.outlying.get(triangle.index()).is_some_and(|&reach| reach > 0.0)
    }

    /// Bound of the coordinates and distances among which a triangle lies, metres: its corners are rounded by a share of it.
    pub fn reach_of(&self, triangle: TriangleId) -> f64 {
        self.inner.reach().max(self.outlying.get(triangle.index()).copied().unwrap_or(0.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use catoptric_scene::{Material, MaterialId, Rgb, SceneParts};

    fn extent(build: impl FnOnce(&mut SceneParts, MaterialId)) -> (Scene, Extent) {
        let mut parts = SceneParts::default();
        let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
        build(&mut parts, white);
        let scene = Scene::new(parts).expect("the scene is valid");
        let extent = Extent::new(&scene);
        (scene, extent)
    }

    fn add_room(parts: &mut SceneParts, white: MaterialId) {
        parts.add_box("room", white, Vec3::ZERO, Vec3::new(4.0, 2.5, 5.0), true);
        parts.add_box("table", white, Vec3::new(1.0, 0.0, 1.0), Vec3::new(2.0, 0.8, 2.0), false);
    }

    fn add_ground(parts: &mut SceneParts, white: MaterialId, side: f32) {
        let corner = Vec3::new(-0.5 * side, -0.1, 0.5 * side);
        parts.add_quad("ground", white, corner, Vec3::X * side, Vec3::Z * -side);
    }

    #[test]
    fn in_a_room_nothing_is_outlying() {
        let (scene, extent) = extent(add_room);
        assert_eq!(extent.inner, extent.all);
        assert_eq!(extent.all.diagonal, DVec3::new(4.0, 2.5, 5.0).length());
        let all_alike = |t| extent.reach_of(TriangleId(t)) == extent.all.reach();
        assert!((0..scene.triangles().len() as u32).all(all_alike));
    }

    /// Whatever it is made of: the room is one surface, the ground another, of more triangles or of fewer.
    #[test]
    fn the_ground_around_a_house_does_not_blur_it() {
        let (_, room) = extent(add_room);
        for (side, tiles) in [(400.0, 1), (2e4, 1), (2e6, 1), (2e4, 30)] {
            let (scene, extent) = extent(|parts, white| {
                add_room(parts, white);
                let (mut positions, mut indices) = (Vec::new(), Vec::new());
                let corner = |i: u32| (i as f32 / tiles as f32 - 0.5) * side;
                for (i, j) in (0..tiles).flat_map(|i| (0..tiles).map(move |j| (i, j))) {
                    let first = positions.len() as u32;
                    let of = [(i, j), (i, j + 1), (i + 1, j + 1), (i + 1, j)];
                    positions.extend(of.map(|(i, j)| Vec3::new(corner(i), -0.1, corner(j))));
                    indices.extend([[0, 1, 2], [0, 2, 3]].map(|t| t.map(|v| first + v)));
                }
                parts.add_triangles("ground", white, &positions, &indices);
            });
            assert_eq!(extent.inner, room.inner, "{side} m");
            let of_room = 24;
            for t in (0..scene.triangles().len() as u32).map(TriangleId) {
                assert_eq!(extent.is_outlying(t), t.0 >= of_room, "{side} m, {t:?}");
                assert_eq!(extent.reach_of(t) > 10.0 * room.inner.reach(), t.0 >= of_room, "{side} m, {t:?}");
            }
        }
    }

    /// A vertex that went astray takes its own triangles with it, and not what else its surface holds.
    #[test]
    fn a_stray_vertex_does_not_blur_its_surface() {
        let (_, extent) = extent(|parts, white| {
            let mut positions: Vec<Vec3> =
                (0..64).map(|i| Vec3::new((i % 8) as f32, 0.0, (i / 8) as f32)).collect();
            positions[63] = Vec3::new(3e7, 4.0, 0.0);
            let quads = (0..49).map(|i| i % 7 + i / 7 * 8);
            let indices: Vec<[u32; 3]> = quads.flat_map(|q| [[q, q + 8, q + 9], [q, q + 9, q + 1]]).collect();
            parts.add_triangles("floor", white, &positions, &indices);
        });
        assert_eq!(extent.outlying.iter().filter(|&&reach| reach > 0.0).count(), 2);
        assert!(extent.inner.diagonal < 10.0 && extent.all.diagonal > 1e7);
    }

    #[test]
    fn a_field_alone_is_what_its_scene_is_about() {
        let (_, field) = extent(|parts, white| add_ground(parts, white, 1e4));
        assert_eq!(field.inner, field.all);
        let (_, nothing) = extent(|_, _| ());
        assert_eq!((nothing.inner, nothing.all), (Bounds::default(), Bounds::default()));
    }
}
