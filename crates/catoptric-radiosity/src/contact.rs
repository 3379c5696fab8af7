//! Contact lines: where other surfaces touch or cross a face (Baum et al. 1991). Light and shadow end there, so the
//! mesh must too, with vertices of its own on each side.

use glam::{DVec2, DVec3};

use catoptric_scene::{Scene, TriangleId};
use catoptric_trace::BoxTree;

use crate::face::FaceDraft;

/// A segment in the plane coordinates of a face.
pub type Segment = [DVec2; 2];

/// All triangles of a scene, to be asked which are near a face.
pub struct Obstacles {
    tree: BoxTree,
    reach: f64,
}

/// Distance from a plane that counts as touching, relative to the scene's size: f32 positions carry 2⁻²⁴ each, authored
/// contact is often off by a few of them after transforms.
const TOUCH: f64 = 4e-6;

impl Obstacles {
    /// All triangles of the scene.
    pub fn new(scene: &Scene, center: DVec3, diagonal: f64) -> Self {
        let boxes = (0..scene.triangles().len() as u32).map(|t| {
            let [a, b, c] = scene.corners(TriangleId(t));
            [a.min(b).min(c), a.max(b).max(c)]
        });
        Self { tree: BoxTree::new(boxes), reach: diagonal + center.abs().max_element() }
    }

    /// Distance that counts as touching, metres.
    pub fn tolerance(&self) -> f64 {
        TOUCH * self.reach
    }

    /// The contact lines on a face: every triangle that is not its own and touches or crosses it from the face's side,
    /// and the outlines of what hangs parallel before it nearer than `gap` (metres), like pictures and mirrors: what is
    /// behind them is dark, and nobody sees it.
    pub fn segments(&self, scene: &Scene, face: &FaceDraft, gap: f64) -> Vec<Segment> {
        let tolerance = self.tolerance();
        let frame = &face.frame;
        let (mut min, mut max) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for corner in face.triangles.iter().flat_map(|&t| scene.corners(t)) {
            min = min.min(corner.as_dvec3());
            max = max.max(corner.as_dvec3());
        }
        let (min, max) = (min - tolerance.max(gap), max + tolerance.max(gap));
        let own: Vec<[DVec2; 3]> =
            face.triangles.iter().map(|&t| scene.corners(t).map(|c| frame.flat(c.as_dvec3()))).collect();
        let mut segments = Vec::new();
        let mut hanging: Vec<[DVec2; 3]> = Vec::new();
        for id in self.tree.overlapping(min, max).into_iter().map(TriangleId) {
            if face.triangles.binary_search(&id).is_ok() {
                continue;
            }
            let corners = scene.corners(id).map(|c| c.as_dvec3());
            let heights = corners.map(|c| frame.height(c));
            // Only what rises on the face's own side casts light or shadow there; coplanar outlines do too.
            let side = match face.side {
                catoptric_scene::Side::Front => 1.0,
                catoptric_scene::Side::Back => -1.0,
            };
            let rises = heights.iter().any(|h| h * side > tolerance);
            let flat = heights.iter().all(|h| h.abs() <= tolerance);
            if flat {
                for k in 0..3 {
                    segments.push([frame.flat(corners[k]), frame.flat(corners[(k + 1) % 3])]);
                }
            } else if rises && is_parallel(&heights, gap, tolerance, side) {
                hanging.push(corners.map(|c| frame.flat(c)));
            } else if rises && let Some(segment) = crossing(&corners, &heights, tolerance) {
                segments.push(segment.map(|p| frame.flat(p)));
            }
        }
        segments.extend(crate::triangulate::outline(&hanging, tolerance));
        let clipped: Vec<Segment> =
            segments.iter().flat_map(|s| own.iter().filter_map(|t| clip(s, t, tolerance))).collect();
        clipped
    }
}

/// Whether a triangle hangs nearly parallel before the face, nearer than `gap`.
fn is_parallel(heights: &[f64; 3], gap: f64, tolerance: f64, side: f64) -> bool {
    let above = heights.map(|h| h * side);
    let (low, high) = (above[0].min(above[1]).min(above[2]), above[0].max(above[1]).max(above[2]));
    low > tolerance && high < gap && high - low < 0.1 * gap
}

/// Where a triangle meets the plane of height zero.
fn crossing(corners: &[DVec3; 3], heights: &[f64; 3], tolerance: f64) -> Option<[DVec3; 2]> {
    let mut points: [DVec3; 4] = [DVec3::ZERO; 4];
    let mut count = 0;
    let mut push = |p: DVec3| {
        if count < points.len() {
            points[count] = p;
            count += 1;
        }
    };
    for k in 0..3 {
        if heights[k].abs() <= tolerance {
            push(corners[k]);
        }
        let next = (k + 1) % 3;
        let (a, b) = (heights[k], heights[next]);
        if (a > tolerance && b < -tolerance) || (a < -tolerance && b > tolerance) {
            push(corners[k].lerp(corners[next], a / (a - b)));
        }
    }
    if count < 2 {
        return None;
    }
    let pair = [points[0], points[1]];
    ((pair[1] - pair[0]).length() > 4.0 * tolerance).then_some(pair)
}

/// The part of a segment inside a triangle of plane coordinates.
fn clip(segment: &Segment, triangle: &[DVec2; 3], tolerance: f64) -> Option<Segment> {
    let [mut a, mut b] = *segment;
    let turn = (triangle[1] - triangle[0]).perp_dot(triangle[2] - triangle[0]).signum();
    for k in 0..3 {
        let (p, q) = (triangle[k], triangle[(k + 1) % 3]);
        let edge = (q - p).normalize_or_zero() * turn;
        let (da, db) = (edge.perp_dot(a - p), edge.perp_dot(b - p));
        // Lines along the triangle's own border stay.
        let (ia, ib) = (da >= -tolerance, db >= -tolerance);
        match (ia, ib) {
            (false, false) => return None,
            (true, true) => {}
            (true, false) => b = a.lerp(b, (da / (da - db)).clamp(0.0, 1.0)),
            (false, true) => a = b.lerp(a, (db / (db - da)).clamp(0.0, 1.0)),
        }
    }
    ((b - a).length() > 4.0 * tolerance).then_some([a, b])
}
