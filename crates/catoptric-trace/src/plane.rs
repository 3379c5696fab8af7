//! Which triangles lie in one plane.
//!
//! Two uses: a ray that leaves a plane can never meet it again, so "ignore the plane I start from" is an exact
//! self-intersection rule that needs no offset (ARCHITECTURE.md); and a planar mirror is a plane, however many triangles
//! it is made of, so image chains are lists of planes.

use glam::{DVec3, Vec3};
use rustc_hash::FxHashMap;

use catoptric_scene::{Scene, TriangleId};

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
/// Planes closer than this share of the scene's reach are one: a few roundings add up in a transformed mesh.
const OFFSET_TOLERANCE: f64 = 8.0 * POSITION_ROUNDING;

/// What makes two triangles coplanar in this scene.
struct Tolerance {
    /// Metres.
    offset: f64,
    /// Scene size, metres.
    size: f64,
    /// Largest coordinate, metres.
    reach: f64,
}

impl Tolerance {
    /// Angle (radians) by which rounding may turn the normal of a triangle.
    fn angle(&self, corners: &[DVec3; 3]) -> f64 {
        let [a, b, c] = *corners;
        let longest = (b - a).length().max((c - b).length()).max((a - c).length());
        let altitude = (b - a).cross(c - a).length() / longest.max(f64::MIN_POSITIVE);
        (2e-6 + 4.0 * POSITION_ROUNDING * self.reach / altitude.max(f64::MIN_POSITIVE))
            .min(MAX_ANGLE_TOLERANCE)
    }
}

impl Planes {
    /// Groups the triangles of `scene` by plane.
    pub fn new(scene: &Scene) -> Self {
        let (center, size) = bounds_of(scene);
        let size = size.max(f64::MIN_POSITIVE);
        let reach = size + center.abs().max_element();
        let tolerance = Tolerance { offset: OFFSET_TOLERANCE * reach, size, reach };
        let mut planes: Vec<Plane> = Vec::new();
        let mut cells: FxHashMap<[i32; 4], Vec<u32>> = FxHashMap::default();
        let mut of_triangle = Vec::with_capacity(scene.triangles().len());

        for index in 0..scene.triangles().len() {
            let triangle = TriangleId(index as u32);
            let corners = scene.corners(triangle).map(|p| p.as_dvec3() - center);
            let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize_or_zero();
            let offset = normal.dot((corners[0] + corners[1] + corners[2]) / 3.0);
            let angle = tolerance.angle(&corners);
            let find = |normal, offset| find(&planes, &cells, normal, offset, angle, &tolerance, &corners);
            let found = find(normal, offset).or_else(|| find(-normal, -offset));
            let plane = found.unwrap_or_else(|| {
                let id = planes.len() as u32;
                planes.push(Plane { normal, offset });
                cells.entry(cell(normal, offset / size, [0.0; 4])).or_default().push(id);
                id
            });
            of_triangle.push(PlaneId(plane));
        }
        for plane in &mut planes {
            plane.offset += plane.normal.dot(center);
        }
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

/// Centre and diagonal of the scene's bounding box.
pub fn bounds_of(scene: &Scene) -> (DVec3, f64) {
    let mut min = Vec3::INFINITY;
    let mut max = Vec3::NEG_INFINITY;
    for vertex in scene.triangles().iter().flat_map(|t| t.vertices) {
        let position = scene.vertices()[vertex as usize].position;
        min = min.min(position);
        max = max.max(position);
    }
    if min.x > max.x {
        return (DVec3::ZERO, 0.0);
    }
    let (min, max) = (min.as_dvec3(), max.as_dvec3());
    ((min + max) * 0.5, (max - min).length())
}

/// Cells are 5e-3 wide in normal components and relative offset: wider than twice the tolerances.
const CELLS_PER_UNIT: f64 = 200.0;

fn cell(normal: DVec3, offset: f64, shift: [f64; 4]) -> [i32; 4] {
    let values = [normal.x, normal.y, normal.z, offset];
    std::array::from_fn(|i| ((values[i] + shift[i]) * CELLS_PER_UNIT).floor() as i32)
}

fn find(
    planes: &[Plane],
    cells: &FxHashMap<[i32; 4], Vec<u32>>,
    normal: DVec3,
    offset: f64,
    angle: f64,
    tolerance: &Tolerance,
    corners: &[DVec3; 3],
) -> Option<u32> {
    let relative = offset / tolerance.size;
    let slack = tolerance.offset / tolerance.size;
    let low = cell(normal, relative, [-angle, -angle, -angle, -slack]);
    let high = cell(normal, relative, [angle, angle, angle, slack]);
    let mut best: Option<u32> = None;
    for combination in 0..16 {
        let key: [i32; 4] = std::array::from_fn(|i| if combination >> i & 1 == 0 { low[i] } else { high[i] });
        if (0..4).any(|i| combination >> i & 1 == 1 && low[i] == high[i]) {
            continue;
        }
        for &id in cells.get(&key).map_or(&[][..], Vec::as_slice) {
            let plane = &planes[id as usize];
            let parallel = plane.normal.cross(normal).length() < angle && plane.normal.dot(normal) > 0.0;
            // Every corner must lie in the plane: the offset alone would let a large tilted triangle in.
            let inside =
                corners.iter().all(|&c| (plane.normal.dot(c) - plane.offset).abs() < tolerance.offset);
            if parallel && inside && best.is_none_or(|b| id < b) {
                best = Some(id);
            }
        }
    }
    best
}
