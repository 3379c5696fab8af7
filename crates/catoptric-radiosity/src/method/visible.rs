//! What a point sees of a convex polygon behind convex blockers, exactly.
//!
//! The shadow of a convex blocker is convex: behind its plane and inside of its edges' planes through the eye. What is
//! left of a convex polygon falls into convex parts, one per plane (Weiler & Atherton 1977 cut outlines in the plane of
//! the picture; here the cuts are planes in space, so that parts stay polygons of the scene).

use glam::DVec3;

use catoptric_light::contour::{MAX_CORNERS, Polygon};
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

    /// Adds the half-spaces whose intersection is the shadow: planes (normal, offset) with the shadow at n·x ≥ offset.
    /// False where the eye lies in the blocker's plane: it is seen edge-on and hides nothing.
    fn shadow(&self, eye: DVec3, planes: &mut Vec<(DVec3, f64)>) -> bool {
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

/// The shadows of blockers as one eye sees them: found once, for all that may lie behind.
#[derive(Default)]
pub(crate) struct Shadows {
    planes: Vec<(DVec3, f64)>,
    /// Per shadow: the plane of its blocker, and where its half-spaces start and end.
    spans: Vec<(PlaneId, usize, usize)>,
    kept: Vec<Polygon>,
}

impl Shadows {
    /// Forgets all shadows and casts those of the blockers of which the eye sees something.
    pub(crate) fn cast<'b>(&mut self, blockers: impl Iterator<Item = &'b Blocker>, eye: DVec3) {
        self.planes.clear();
        self.spans.clear();
        for blocker in blockers {
            let start = self.planes.len();
            if blocker.shadow(eye, &mut self.planes) {
                self.spans.push((blocker.plane, start, self.planes.len()));
            }
        }
    }

    /// Whether any of the shadows, but for those of blockers in the plane `except`, may reach a polygon.
    pub(crate) fn touch(&self, polygon: &Polygon, except: PlaneId) -> bool {
        self.spans
            .iter()
            .any(|&(plane, start, end)| plane != except && !outside(polygon, &self.planes[start..end]))
    }

    /// Removes from `parts` what lies in a shadow, but for those of blockers in the plane `except`.
    pub(crate) fn subtract(&mut self, parts: &mut Vec<Polygon>, except: PlaneId) {
        for &(plane, start, end) in &self.spans {
            let planes = &self.planes[start..end];
            if plane == except || parts.iter().all(|part| outside(part, planes)) {
                continue;
            }
            self.kept.clear();
            for part in parts.drain(..) {
                remove(part, planes, &mut self.kept);
            }
            std::mem::swap(parts, &mut self.kept);
        }
    }
}

/// Whether a polygon lies outside of one of the half-spaces, and so of their intersection.
fn outside(polygon: &Polygon, planes: &[(DVec3, f64)]) -> bool {
    // Rounding of a plane's distance: nothing is cut for less than that.
    let all = |n: DVec3, d: f64| polygon.corners().iter().all(|c| n.dot(*c) - d <= 1e-12 * (1.0 + d.abs()));
    planes.iter().any(|&(n, d)| all(n, d))
}

/// The planes through an eye and the edges of the window that it looks through; none without a window.
pub(crate) struct Sight {
    planes: [(DVec3, f64); MAX_CORNERS],
    count: usize,
}

impl Sight {
    pub(crate) fn through(eye: DVec3, window: Option<&Polygon>) -> Self {
        let mut sight = Self { planes: [(DVec3::ZERO, 0.0); MAX_CORNERS], count: 0 };
        let corners = window.map_or(&[][..], Polygon::corners);
        let center = corners.iter().copied().sum::<DVec3>() / corners.len().max(1) as f64;
        for (k, &a) in corners.iter().enumerate() {
            let b = corners[(k + 1) % corners.len()];
            if let Some(n) = (a - eye).cross(b - eye).try_normalize() {
                let inward = if n.dot(center - eye) < 0.0 { -n } else { n };
                sight.planes[sight.count] = (inward, inward.dot(eye));
                sight.count += 1;
            }
        }
        sight
    }

    /// Whether something of a polygon may be seen: not all of it lies outside of one plane.
    pub(crate) fn meets(&self, outline: &Polygon) -> bool {
        let planes = &self.planes[..self.count];
        planes.iter().all(|&(n, d)| outline.corners().iter().any(|c| n.dot(*c) >= d))
    }

    /// The part of a polygon that is seen: itself, or in one of the buffers. Only planes that cut it are clipped by.
    pub(crate) fn clip<'p>(
        &self,
        outline: &'p Polygon,
        [first, second]: &'p mut [Polygon; 2],
    ) -> &'p Polygon {
        let cuts = |(n, d): &&(DVec3, f64)| outline.corners().iter().any(|c| n.dot(*c) < *d);
        let mut planes = self.planes[..self.count].iter().filter(cuts);
        let Some(&(n, d)) = planes.next() else { return outline };
        let (mut seen, mut spare) = (first, second);
        outline.clip_into(n, d, seen);
        for &(n, d) in planes {
            seen.clip_into(n, d, spare);
            std::mem::swap(&mut seen, &mut spare);
        }
        seen
    }
}

/// The parts of `polygon` outside of the intersection of half-spaces.
fn remove(polygon: Polygon, planes: &[(DVec3, f64)], kept: &mut Vec<Polygon>) {
    if outside(&polygon, planes) {
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
