//! Which triangles lie in one plane.
//!
//! Two uses: a ray that leaves a plane can never meet it again, so "ignore the plane I start from" is an exact
//! self-intersection rule that needs no offset (ARCHITECTURE.md); and a planar mirror is a plane, however many triangles
//! it is made of, so image chains are lists of planes.

use glam::DVec3;
use rustc_hash::FxHashMap;

use catoptric_scene::{Scene, TriangleId};

use crate::extent::{Bounds, Extent};

/// A plane that holds one or more triangles of the scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PlaneId(pub u32);

impl PlaneId {
    /// No plane: the start of eye rays and of rays from punctual lights.
    pub const NONE: Self = Self(u32::MAX);
}

/// The plane of every triangle.
#[derive(Clone, Debug, Default)]
pub struct Planes {
    of_triangle: Vec<PlaneId>,
    planes: Vec<Plane>,
}

/// n·x = offset.
#[derive(Clone, Copy, Debug)]
pub struct Plane {
    /// Unit normal of the first triangle found in the plane.
    pub normal: DVec3,
    /// Distance from the origin along the normal, metres.
    pub offset: f64,
}

/// Rounding of a position relative to the largest coordinate: 2⁻²⁴, doubled for a transform.
const POSITION_ROUNDING: f64 = 1.2e-7;
/// Normals are parallel within the angle that four rounded positions can turn them by, and never beyond this (radians).
const MAX_ANGLE_TOLERANCE: f64 = 2e-3;
/// Planes closer than this share of the [extent](Extent::reach_of) of their triangles are one: a few roundings add up in a transformed mesh.
const OFFSET_TOLERANCE: f64 = 8.0 * POSITION_ROUNDING;

/// A plane while they are gathered.
struct Founded {
    plane: Plane,
    /// How far the triangle that founded it reaches, metres.
    reach: f64,
}

/// Planes by their equation, all founded by triangles that reach alike.
struct Table {
    /// About how large that makes offsets, metres.
    size: f64,
    /// How far those triangles reach at most, metres.
    reach: f64,
    cells: FxHashMap<[i32; 4], Vec<u32>>,
}

/// What is asked for the plane of a triangle.
struct Wanted<'a> {
    normal: DVec3,
    offset: f64,
    corners: &'a [DVec3; 3],
    /// By how much rounding may turn the normal, radians.
    angle: f64,
    /// How far the triangle reaches, metres.
    reach: f64,
}

/// Angle (radians) by which rounding may turn the normal of a triangle that reaches so far (metres).
fn angle(corners: &[DVec3; 3], reach: f64) -> f64 {
    let [a, b, c] = *corners;
    let longest = (b - a).length().max((c - b).length()).max((a - c).length());
    let altitude = (b - a).cross(c - a).length() / longest.max(f64::MIN_POSITIVE);
    (2e-6 + 4.0 * POSITION_ROUNDING * reach / altitude.max(f64::MIN_POSITIVE)).min(MAX_ANGLE_TOLERANCE)
}

impl Planes {
    /// Groups the triangles of `scene`, of this extent, by plane.
    pub fn new(scene: &Scene, extent: &Extent) -> Self {
        let center = extent.inner.center;
        let mut planes: Vec<Founded> = Vec::new();
        let [mut inner, mut outlying] = [extent.inner, extent.all].map(Table::new);
        let mut of_triangle = Vec::with_capacity(scene.triangles().len());

        for index in 0..scene.triangles().len() {
            let triangle = TriangleId(index as u32);
            let corners = scene.corners(triangle).map(|p| p.as_dvec3() - center);
            let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize_or_zero();
            let offset = normal.dot((corners[0] + corners[1] + corners[2]) / 3.0);
            let reach = extent.reach_of(triangle);
            let angle = angle(&corners, reach);
            let find = |normal, offset| {
                let wanted = Wanted { normal, offset, corners: &corners, angle, reach };
                let found = [&inner, &outlying].map(|table| table.find(&planes, &wanted));
                found.into_iter().flatten().min()
            };
            let found = find(normal, offset).or_else(|| find(-normal, -offset));
            let plane = found.unwrap_or_else(|| {
                let id = planes.len() as u32;
                planes.push(Founded { plane: Plane { normal, offset }, reach });
                let table = if extent.is_outlying(triangle) { &mut outlying } else { &mut inner };
                table.add(id, normal, offset);
                id
            });
            of_triangle.push(PlaneId(plane));
        }
        let with_offset = |Plane { normal, offset }| Plane { normal, offset: offset + normal.dot(center) };
        let planes = planes.into_iter().map(|founded| with_offset(founded.plane)).collect();
        Self { of_triangle, planes }
    }

    /// The plane of a triangle.
    #[inline]
    pub fn of(&self, triangle: TriangleId) -> PlaneId {
        self.of_triangle[triangle.index()]
    }

    /// Number of planes.
    pub fn len(&self) -> usize {
        self.planes.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.planes.is_empty()
    }

    /// A plane's equation.
    pub fn plane(&self, id: PlaneId) -> Plane {
        self.planes[id.0 as usize]
    }
}

impl Plane {
    /// The mirror image of a point.
    #[inline]
    pub fn reflect_point(&self, point: DVec3) -> DVec3 {
        point - self.normal * (2.0 * (self.normal.dot(point) - self.offset))
    }

    /// The mirror image of a direction.
    #[inline]
    pub fn reflect_vector(&self, vector: DVec3) -> DVec3 {
        vector - self.normal * (2.0 * self.normal.dot(vector))
    }

    /// Signed distance of a point, metres.
    #[inline]
    pub fn distance(&self, point: DVec3) -> f64 {
        self.normal.dot(point) - self.offset
    }
}

/// Cells are 5e-3 wide in normal components and relative offset: wider than twice the tolerances.
const CELLS_PER_UNIT: f64 = 200.0;

fn cell(normal: DVec3, offset: f64, shift: [f64; 4]) -> [i32; 4] {
    let values = [normal.x, normal.y, normal.z, offset];
    std::array::from_fn(|i| ((values[i] + shift[i]) * CELLS_PER_UNIT).floor() as i32)
}

impl Table {
    fn new(bounds: Bounds) -> Self {
        let size = bounds.diagonal.max(f64::MIN_POSITIVE);
        Self { size, reach: bounds.reach(), cells: FxHashMap::default() }
    }

    fn add(&mut self, id: u32, normal: DVec3, offset: f64) {
        self.cells.entry(cell(normal, offset / self.size, [0.0; 4])).or_default().push(id);
    }

    /// The first plane in which a triangle lies.
    fn find(&self, planes: &[Founded], wanted: &Wanted) -> Option<u32> {
        let &Wanted { normal, offset, corners, angle, reach } = wanted;
        let relative = offset / self.size;
        let slack = OFFSET_TOLERANCE * reach.min(self.reach) / self.size;
        let low = cell(normal, relative, [-angle, -angle, -angle, -slack]);
        let high = cell(normal, relative, [angle, angle, angle, slack]);
        let mut best: Option<u32> = None;
        for combination in 0..16 {
            let key: [i32; 4] =
                std::array::from_fn(|i| if combination >> i & 1 == 0 { low[i] } else { high[i] });
            if (0..4).any(|i| combination >> i & 1 == 1 && low[i] == high[i]) {
                continue;
            }
            for &id in self.cells.get(&key).map_or(&[][..], Vec::as_slice) {
                let Founded { plane, reach: founded } = &planes[id as usize];
                // The ground to the horizon, known to a centimetre, does not swallow the rug on it.
                let tolerance = OFFSET_TOLERANCE * reach.min(*founded);
                let parallel = plane.normal.cross(normal).length() < angle && plane.normal.dot(normal) > 0.0;
                // Every corner must lie in the plane: the offset alone would let a large tilted triangle in.
                let inside = corners.iter().all(|&c| (plane.normal.dot(c) - plane.offset).abs() < tolerance);
                if parallel && inside && best.is_none_or(|b| id < b) {
                    best = Some(id);
                }
            }
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use catoptric_scene::{Material, Rgb, SceneParts};
    use glam::Vec3;

    /// On ground to the horizon, known to centimetres, a rug of half a centimetre lies in its own plane, and so do the two halves of the
    /// ground, whichever comes first.
    #[test]
    fn a_rug_on_the_ground_is_not_the_ground() {
        for (side, rug_first) in [(4e2, true), (4e4, true), (4e4, false), (4e6, true), (4e6, false)] {
            let mut parts = SceneParts::default();
            let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
            let add_rug = |parts: &mut SceneParts| {
                parts.add_quad("rug", white, Vec3::new(-1.0, 0.005, 1.0), Vec3::X * 2.0, Vec3::Z * -2.0);
                parts.add_box("room", white, Vec3::new(-3.0, 0.0, -3.0), Vec3::new(3.0, 2.5, 3.0), true);
            };
            if rug_first {
                add_rug(&mut parts);
            }
            let first = parts.triangles.len() as u32;
            // It leans: no coordinate is round.
            let (x, z) = (Vec3::new(1.0, 0.02, 0.0), Vec3::new(0.0, 0.01, -1.0));
            parts.add_quad("ground", white, (x - z) * (-0.5 * side) - Vec3::Y * 0.02, x * side, z * side);
            if !rug_first {
                add_rug(&mut parts);
            }
            let scene = Scene::new(parts).expect("the scene is valid");
            let planes = Planes::new(&scene, &Extent::new(&scene));
            let ground = planes.of(TriangleId(first));
            assert_eq!(ground, planes.of(TriangleId(first + 1)), "{side} m");
            assert_eq!(planes.len(), 1 + 1 + 6, "{side} m, rug first: {rug_first}");
        }
    }
}
