//! What hangs parallel before a face, by what hangs together.

use std::collections::BTreeMap;

use glam::{DVec2, DVec3};

use catoptric_scene::Union;

use crate::arrangement::Points;

/// What hangs parallel before a face nearer than this share of the edge length leaves its outline there.
pub(super) const HANGING: f64 = 0.2;
/// … and parts light there if it hangs lower than this share of the root of its area: behind a lamp of 12 cm, 2 cm before the ceiling,
/// the dark comes and goes within centimetres, and is seen past the lamp.
pub(super) const SOFT: f64 = 0.05;

/// Heights of the corners of what hangs parallel differ by less than this share of its longest edge: the facets of a ball on a
/// table do not hang, and what is below them is seen.
const SLANT: f64 = 0.05;
/// … and by less than this share of the gap.
const LEVEL: f64 = 0.1;

/// Whether a triangle hangs nearly parallel before the face, nearer than `gap`.
pub(super) fn is_parallel(
    corners: &[DVec3; 3],
    heights: &[f64; 3],
    gap: f64,
    tolerance: f64,
    side: f64,
) -> bool {
    let above = heights.map(|h| h * side);
    let (low, high) = (above[0].min(above[1]).min(above[2]), above[0].max(above[1]).max(above[2]));
    let longest = (0..3).map(|k| (corners[(k + 1) % 3] - corners[k]).length()).fold(0.0, f64::max);
    low > tolerance && high < gap && high - low < (LEVEL * gap).min(SLANT * longest)
}

/// What hangs before a face, in its plane coordinates.
pub(super) struct Plate {
    pub(super) triangles: Vec<[DVec2; 3]>,
    /// Of its lowest corner before the face, metres.
    pub(super) height: f64,
}

/// The unit vector square to a segment, away from a point beside it.
pub(super) fn outwards([a, b]: [DVec2; 2], inside: DVec2) -> DVec2 {
    let across = (b - a).perp().normalize_or_zero();
    if across.dot(inside - a) > 0.0 { -across } else { across }
}

/// Triangles (with the heights of their lowest corners), by what hangs together.
pub(super) fn plates(triangles: &[([DVec2; 3], f64)], tolerance: f64) -> Vec<Plate> {
    let mut points = Points::new(tolerance);
    let ids: Vec<[u32; 3]> = triangles.iter().map(|(corners, _)| corners.map(|p| points.id(p))).collect();
    let mut together = Union::new(points.len());
    for [a, b, c] in &ids {
        together.join(*a, *b);
        together.join(*b, *c);
    }
    let mut plates: BTreeMap<u32, Plate> = BTreeMap::new();
    for (&(corners, height), ids) in triangles.iter().zip(&ids) {
        let plate = plates
            .entry(together.find(ids[0]))
            .or_insert(Plate { triangles: Vec::new(), height: f64::INFINITY });
        plate.triangles.push(corners);
        plate.height = plate.height.min(height);
    }
    plates.into_values().collect()
}
