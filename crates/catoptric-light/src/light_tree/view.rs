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
        for outline in outlines {
            self.normals.extend(outline.sight_planes(eye));
        }
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
        self.may_show_where(|normal| normal.dot(offset) > -radius)
    }

    /// Whether anything may be seen through them that is in part before the planes of which that is said.
    pub fn may_show_where(&self, is_before: impl Fn(&DVec3) -> bool) -> bool {
        self.is_empty() || self.iter().any(|window| window.iter().all(&is_before))
    }

    /// Whether nothing of what is spanned by some points is seen through them: all are behind one plane of each window.
    pub fn show_none_of(&self, eye: DVec3, points: &[DVec3]) -> bool {
        !self.may_show_where(|normal| points.iter().any(|p| normal.dot(*p - eye) > 0.0))
    }

    /// Whether all that `eye` sees of a ball through them lies where n·x > offset, the last mirror's plane: its lines of sight cross that in
    /// the windows alone, so that nothing is hidden as long as they do not meet what of the ball is behind it.
    pub fn show_beyond(&self, eye: DVec3, center: DVec3, radius: f64, plane: &Plane) -> bool {
        let height = plane.distance(center);
        if height >= radius {
            return true;
        }
        // The most of a window's normal in the cap behind the plane: at the ball's own end if that is behind, else on the circle.
        let circle = (radius * radius - height * height).max(0.0).sqrt();
        let middle = center - plane.normal * height;
        let misses = |normal: &DVec3| {
            let along = normal.dot(plane.normal);
            let (from, reach) = match height + radius * along {
                ..0.0 => (center, radius),
                _ => (middle, circle * (1.0 - along * along).max(0.0).sqrt()),
            };
            normal.dot(from - eye) + reach <= 0.0
        };
        !self.is_empty() && self.iter().all(|window| window.iter().any(misses))
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
        self.beyond.is_none_or(|plane| plane.distance(center) > -radius)
            && self.windows.may_show(center - self.point, radius)
    }

    /// Whether all that is seen of a ball lies beyond the plane.
    pub(super) fn shows_beyond(&self, center: DVec3, radius: f64) -> bool {
        self.beyond.is_none_or(|plane| self.windows.show_beyond(self.point, center, radius, &plane))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use catoptric_trace::sequence::{Key, Purpose};

    fn point(key: Key, index: u32) -> DVec3 {
        let [a, b] = [key.point2(index), key.child(1).point2(index)];
        DVec3::new(f64::from(a.x), f64::from(a.y), f64::from(b.x)) * 2.0 - 1.0
    }

    /// Points of a ball behind the mirror are in no window where they are said not to be; and where all that are seen through the windows lie
    /// before it, that is known nearly always.
    #[test]
    fn what_is_behind_a_mirror_is_not_seen_through_it() {
        let key = Key::new(3, Purpose::Test, 0);
        let plane = Plane { normal: DVec3::X, offset: 0.0 };
        let [mut said, mut unsaid, mut cut] = [0, 0, 0];
        for index in 0..2000 {
            let eye = point(key, index) - DVec3::X * 1.2;
            let center = point(key.child(2), index) * DVec3::new(0.3, 1.0, 1.0);
            let radius = 0.1 + 0.3 * f64::from(key.child(3).point1(index));
            let corner = point(key.child(4), index).with_x(0.0) * 0.5;
            let (u, v) = (DVec3::Y * 0.6, DVec3::Z * 0.4);
            let mut windows = Windows::default();
            windows.add(eye, &[Polygon::new(&[corner, corner + u, corner + u + v, corner + v])]);
            if !windows.may_show(center - eye, radius) || center.x.abs() >= radius {
                continue;
            }
            let places = (0..1000).map(|place| center + point(key.child(5).child(index), place) * radius);
            let behind = |p: &DVec3| p.x < 0.0 && (*p - center).length() < radius;
            let is_seen = |p: DVec3| windows.may_show(p - eye, 0.0);
            let is_cut = places.filter(behind).any(is_seen);
            let shows = windows.show_beyond(eye, center, radius, &plane);
            assert!(!(shows && is_cut), "{index}");
            cut += u32::from(is_cut);
            said += u32::from(shows);
            unsaid += u32::from(!shows && !is_cut);
        }
        assert!(cut > 100 && said > 50 && unsaid < said, "{cut} cut, {said} said, {unsaid} unsaid");
    }
}
