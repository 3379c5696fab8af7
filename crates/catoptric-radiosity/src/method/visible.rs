//! What a point sees of a convex polygon behind convex blockers, exactly.
//!
//! The shadow of a convex blocker is convex: behind its plane and inside of its edges' planes through the eye. What is
//! left of a convex polygon falls into convex parts, one per plane (Weiler & Atherton 1977 cut outlines in the plane of
//! the picture; here the cuts are planes in space, so that parts stay polygons of the scene).

use glam::DVec3;

use catoptric_light::contour::Polygon;
use catoptric_trace::PlaneId;

/// A convex polygon that hides what is behind it, from both sides.
#[derive(Clone, Debug)]
pub(crate) struct Blocker {
    pub(crate) outline: Polygon,
    pub(crate) plane: PlaneId,
    pub(crate) normal: DVec3,
    pub(crate) offset: f64,
}

impl Blocker {
    pub(crate) fn new(outline: Polygon, plane: PlaneId) -> Option<Self> {
        let vector = outline.vector_area();
        let normal = vector.try_normalize()?;
        let offset = normal.dot(outline.corners()[0]);
        Some(Self { outline, plane, normal, offset })
    }

    /// The half-spaces whose intersection is the shadow: planes (normal, offset) with the shadow at n·x ≥ offset.
    /// False where the eye lies in the blocker's plane: it is seen edge-on and hides nothing.
    fn shadow(&self, eye: DVec3, planes: &mut Vec<(DVec3, f64)>) -> bool {
        planes.clear();
        let height = self.normal.dot(eye) - self.offset;
        let corners = self.outline.corners();
        if corners.len() < 3 || height == 0.0 {
            return false;
        }
        let side = if height > 0.0 { -1.0 } else { 1.0 };
        planes.push((self.normal * side, self.offset * side));
        for (index, &a) in corners.iter().enumerate() {
            let b = corners[(index + 1) % corners.len()];
            // With the corners counter-clockwise about the normal, the inside is to the left of each edge.
            let normal = (a - eye).cross(b - eye) * side;
            if let Some(normal) = normal.try_normalize() {
                planes.push((normal, normal.dot(eye)));
            }
        }
        true
    }
}

/// Removes from `parts` what `blockers` hide from `eye`.
pub(crate) fn subtract(
    parts: &mut Vec<Polygon>,
    blockers: &[Blocker],
    eye: DVec3,
    except: PlaneId,
    scratch: &mut Scratch,
) {
    for blocker in blockers {
        if parts.is_empty() {
            return;
        }
        if blocker.plane == except || !blocker.shadow(eye, &mut scratch.planes) {
            continue;
        }
        scratch.kept.clear();
        for part in parts.drain(..) {
            remove(part, &scratch.planes, &mut scratch.kept);
        }
        std::mem::swap(parts, &mut scratch.kept);
    }
}

/// Buffers of [`subtract`], and what a row of the analytic method keeps account of.
pub(crate) struct Scratch {
    planes: Vec<(DVec3, f64)>,
    kept: Vec<Polygon>,
    /// Polygons that were looked at.
    pub(crate) work: u64,
    /// Looking ends where more have been looked at.
    pub(crate) stop: u64,
    /// Beams that carry less are thin.
    pub(crate) thin: f64,
    /// What thin beams brought to each element from the present eye.
    pub(crate) landed: Vec<f64>,
}

impl Default for Scratch {
    fn default() -> Self {
        let (planes, kept, landed) = Default::default();
        Self { planes, kept, work: 0, stop: u64::MAX, thin: 0.0, landed }
    }
}

/// The parts of `polygon` outside of the intersection of half-spaces.
fn remove(polygon: Polygon, planes: &[(DVec3, f64)], kept: &mut Vec<Polygon>) {
    // Rounding of a plane's distance: nothing is cut for less than that.
    let outside =
        |n: DVec3, d: f64| polygon.corners().iter().all(|c| n.dot(*c) - d <= 1e-12 * (1.0 + d.abs()));
    if planes.iter().any(|&(n, d)| outside(n, d)) {
        kept.push(polygon);
        return;
    }
    let mut rest = polygon;
    let mut cut: Vec<Polygon> = Vec::new();
    for &(normal, offset) in planes {
        let out = rest.clipped(-normal, -offset);
        if !out.is_empty() {
            cut.push(out);
        }
        rest = rest.clipped(normal, offset);
        if rest.is_empty() {
            // Nothing is hidden: the polygon stays whole.
            kept.push(polygon);
            return;
        }
    }
    kept.extend(cut);
}
