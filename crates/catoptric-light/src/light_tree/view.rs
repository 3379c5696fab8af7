//! Where light arrives, and what it may come through.

use glam::DVec3;

use catoptric_trace::plane::Plane;

use crate::contour::Polygon;

/// Windows that light must come through, one or the other: the outlines of mirrors as seen from the receiver.
#[derive(Clone, Debug, Default)]
pub struct Windows {
    /// Inward normals of the planes through the receiver and the outlines' edges, window after window.
    normals: Vec<DVec3>,
    /// Where the normals of each window end.
    ends: Vec<usize>,
}

impl Windows {
    /// No windows: light may come from everywhere.
    pub fn clear(&mut self) {
        self.normals.clear();
        self.ends.clear();
    }

    /// Adds the window of `outlines`, all of which must be passed, seen from `eye`.
    pub fn add(&mut self, eye: DVec3, outlines: &[Polygon]) {
        self.normals.extend(outlines.iter().flat_map(|outline| outline.sight_planes(eye)).flatten());
        self.ends.push(self.normals.len());
    }

    /// Whether light may come from everywhere.
    pub fn is_empty(&self) -> bool {
        self.ends.is_empty()
    }

    /// The normals of each window.
    pub fn iter(&self) -> impl Iterator<Item = &[DVec3]> {
        let starts = std::iter::once(0).chain(self.ends.iter().copied());
        starts.zip(&self.ends).map(|(start, &end)| &self.normals[start..end])
    }

    /// Whether any of a ball about the eye + `offset` may be seen through them.
    pub fn may_show(&self, offset: DVec3, radius: f64) -> bool {
        self.is_empty() || self.iter().any(|window| window.iter().all(|n| n.dot(offset) > -radius))
    }

    /// Whether all that `eye` sees of a ball through them lies where n·x > offset, the last mirror's plane: its lines of sight cross that in
    /// the windows alone, so that nothing is hidden as long as they do not meet what of the ball is behind it.
    pub fn show_beyond(&self, eye: DVec3, center: DVec3, radius: f64, plane: &Plane) -> bool {
        let height = plane.normal.dot(center) - plane.offset;
        if height >= radius {
            return true;
        }
        // A ball around the cap behind the plane.
        let (middle, reach) = match height {
            0.0.. => (center - plane.normal * height, (radius * radius - height * height).sqrt()),
            _ => (center, radius),
        };
        !self.is_empty() && !self.may_show(middle - eye, reach)
    }
}

/// Where light arrives.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    /// The point.
    pub point: DVec3,
    /// Unit normal of the cosine.
    pub normal: DVec3,
    /// Unit normal of the surface.
    pub geometric: DVec3,
    /// Light must come through one of these, unless there are none.
    pub windows: &'a Windows,
    /// And from where n·x > offset.
    pub beyond: Option<Plane>,
}

impl View<'_> {
    /// Whether light may come from some places only.
    pub(super) fn is_limited(&self) -> bool {
        self.beyond.is_some() || !self.windows.is_empty()
    }

    /// Whether any of a ball may be seen through the windows, and lies beyond the plane.
    pub(super) fn may_show(&self, center: DVec3, radius: f64) -> bool {
        self.beyond.is_none_or(|p| p.normal.dot(center) - p.offset > -radius)
            && self.windows.may_show(center - self.point, radius)
    }

    /// Whether all that is seen of a ball lies beyond the plane.
    pub(super) fn shows_beyond(&self, center: DVec3, radius: f64) -> bool {
        self.beyond.is_none_or(|plane| self.windows.show_beyond(self.point, center, radius, &plane))
    }
}
