//! What convex shadows leave of a convex polygon, exactly: its visible parts in the coordinates of its plane.
//!
//! A triangle before an eye hides a cone, which cuts the plane of the polygon in a convex region: half-planes, one per edge. What is
//! left of a convex part outside of it falls into convex parts again, one per half-plane (Weiler & Atherton 1977 cut outlines in the
//! plane of the picture; Nishita & Nakamae 1985 find light behind shadow volumes like this). Keys in docs/references.md:
//! WeilerAtherton1977, NishitaNakamae1985.

use std::ops::Range;

use glam::{DVec2, DVec3};

use catoptric_trace::plane::Plane;

use crate::contour::clip;

/// Coordinates in the plane of a polygon.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Frame {
    origin: DVec3,
    axes: [DVec3; 2],
}

impl Frame {
    fn of(polygon: &[DVec3]) -> Option<Self> {
        let (&origin, rest) = polygon.split_first()?;
        let area: DVec3 = rest.windows(2).map(|w| (w[0] - origin).cross(w[1] - origin)).sum();
        // The corner beside the first may be as near to it as rounding allows.
        let along =
            rest.iter().map(|c| c - origin).max_by(|a, b| a.length_squared().total_cmp(&b.length_squared()));
        let x = along?.try_normalize()?;
        Some(Self { origin, axes: [x, area.try_normalize()?.cross(x)] })
    }

    /// Its image behind mirrors, of which the last one reflects it first.
    pub(crate) fn reflected(self, mirrors: &[Plane]) -> Self {
        mirrors.iter().rev().fold(self, |frame, mirror| Self {
            origin: mirror.reflect_point(frame.origin),
            axes: frame.axes.map(|axis| mirror.reflect_vector(axis)),
        })
    }

    /// A point of the plane in space.
    pub(crate) fn point(&self, at: DVec2) -> DVec3 {
        self.origin + self.axes[0] * at.x + self.axes[1] * at.y
    }

    fn at(&self, point: DVec3) -> DVec2 {
        let offset = point - self.origin;
        DVec2::new(self.axes[0].dot(offset), self.axes[1].dot(offset))
    }
}

/// Where normal·x + offset ≥ 0.
#[derive(Clone, Copy, Debug, Default)]
struct HalfPlane {
    normal: DVec2,
    offset: f64,
}

impl HalfPlane {
    #[inline]
    fn height(&self, at: DVec2) -> f64 {
        self.normal.dot(at) + self.offset
    }
}

/// Corners of a blocker at most: a quadrilateral between two planes.
pub(crate) const MAX_BLOCKER: usize = 6;

/// A rectangle along the axes of a plane.
#[derive(Clone, Copy, Debug)]
struct Bounds {
    low: DVec2,
    high: DVec2,
}

impl Default for Bounds {
    fn default() -> Self {
        Self { low: DVec2::INFINITY, high: DVec2::NEG_INFINITY }
    }
}

impl Bounds {
    const EVERYTHING: Self = Self { low: DVec2::NEG_INFINITY, high: DVec2::INFINITY };

    fn around(corners: &[DVec2]) -> Self {
        let mut bounds = Self::default();
        for &corner in corners {
            bounds.add(corner);
        }
        bounds
    }

    #[inline]
    fn add(&mut self, point: DVec2) {
        (self.low, self.high) = (self.low.min(point), self.high.max(point));
    }

    #[inline]
    fn is_apart(&self, other: &Self) -> bool {
        self.low.cmpgt(other.high).any() || other.low.cmpgt(self.high).any()
    }
}

/// Bounds of a shadow are wider by this share than they are found to be: rounding.
const MARGIN: f64 = 1e-7;

/// The region of a polygon's plane that a blocker hides from an eye.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Shadow {
    sides: [HalfPlane; MAX_BLOCKER],
    count: usize,
    bounds: Bounds,
}

impl Shadow {
    /// Of a convex blocker of no more than [`MAX_BLOCKER`] corners, all of which lie before the plane of `frame`. `None` where it
    /// is seen edge-on.
    pub(crate) fn cast(blocker: &[DVec3], eye: DVec3, frame: &Frame) -> Option<Self> {
        let &first = blocker.first()?;
        let area: DVec3 = blocker.windows(2).skip(1).map(|w| (w[0] - first).cross(w[1] - first)).sum();
        // Seen with the corners counter-clockwise, the inside is left of each edge.
        let turn = area.dot(first - eye);
        if turn == 0.0 || !turn.is_finite() {
            return None;
        }
        let sign = turn.signum();
        let mut shadow = Self { count: blocker.len(), ..Self::default() };
        let to_origin = frame.origin - eye;
        for (index, side) in shadow.sides[..blocker.len()].iter_mut().enumerate() {
            let (from, to) = (blocker[index] - eye, blocker[(index + 1) % blocker.len()] - eye);
            let normal = from.cross(to) * sign;
            *side = HalfPlane {
                normal: DVec2::new(normal.dot(frame.axes[0]), normal.dot(frame.axes[1])),
                offset: normal.dot(to_origin),
            };
        }
        shadow.bounds = Self::bounds(blocker, eye, frame);
        Some(shadow)
    }

    /// Around where its corners are seen in the plane.
    fn bounds(blocker: &[DVec3], eye: DVec3, frame: &Frame) -> Bounds {
        let normal = frame.axes[0].cross(frame.axes[1]);
        let distance = normal.dot(frame.origin - eye);
        let mut bounds = Bounds::default();
        for &corner in blocker {
            let share = normal.dot(corner - eye) / distance;
            if share.is_nan() || share <= 0.0 {
                return Bounds::EVERYTHING;
            }
            bounds.add(frame.at(eye + (corner - eye) / share));
        }
        let margin = (bounds.high - bounds.low) * MARGIN;
        Bounds { low: bounds.low - margin, high: bounds.high + margin }
    }

    fn sides(&self) -> &[HalfPlane] {
        &self.sides[..self.count]
    }
}

/// Parts at most.
const MAX_PARTS: usize = 64;
/// Parts of less than this share of the whole are left out: rounding, where blockers share edges.
const TINY: f64 = 1e-10;

/// Convex parts of a polygon, and buffers.
#[derive(Clone, Debug, Default)]
pub(crate) struct Parts {
    frame: Frame,
    now: Pieces,
    next: Pieces,
    rest: [Vec<DVec2>; 2],
    tiny: f64,
}

/// Convex polygons, corner after corner.
#[derive(Clone, Debug, Default)]
struct Pieces {
    corners: Vec<DVec2>,
    ends: Vec<usize>,
    bounds: Vec<Bounds>,
}

impl Pieces {
    fn clear(&mut self) {
        self.corners.clear();
        self.ends.clear();
        self.bounds.clear();
    }

    fn range(&self, index: usize) -> Range<usize> {
        let start = if index > 0 { self.ends[index - 1] } else { 0 };
        start..self.ends[index]
    }

    fn iter(&self) -> impl Iterator<Item = &[DVec2]> {
        (0..self.ends.len()).map(|index| &self.corners[self.range(index)])
    }

    fn push(&mut self, corners: &[DVec2]) {
        self.corners.extend_from_slice(corners);
        self.end();
    }

    /// Ends a piece with the corners that have been added.
    fn end(&mut self) {
        let start = self.ends.last().copied().unwrap_or(0);
        self.ends.push(self.corners.len());
        self.bounds.push(Bounds::around(&self.corners[start..]));
    }

    /// Takes the first pieces of another list.
    fn take(&mut self, other: &Self, count: usize) {
        self.clear();
        let corners = if count > 0 { other.ends[count - 1] } else { 0 };
        self.corners.extend_from_slice(&other.corners[..corners]);
        self.ends.extend_from_slice(&other.ends[..count]);
        self.bounds.extend_from_slice(&other.bounds[..count]);
    }

    /// Drops all pieces but the first ones.
    fn truncate(&mut self, count: usize) {
        self.ends.truncate(count);
        self.bounds.truncate(count);
        self.corners.truncate(self.ends.last().copied().unwrap_or(0));
    }
}

impl Parts {
    /// All of a convex polygon; `None` if it has no area.
    pub(crate) fn reset(&mut self, polygon: &[DVec3]) -> Option<()> {
        let frame = Frame::of(polygon)?;
        self.frame = frame;
        self.now.clear();
        self.now.corners.extend(polygon.iter().map(|&corner| frame.at(corner)));
        self.now.end();
        self.tiny = TINY * area(&self.now.corners);
        Some(())
    }

    /// Coordinates in the plane of the polygon.
    pub(crate) fn frame(&self) -> Frame {
        self.frame
    }

    /// Leaves what is not in the shadow; `false` if that falls into too many parts.
    pub(crate) fn remove(&mut self, shadow: &Shadow) -> bool {
        let is_outside = |part: &[DVec2], bounds: &Bounds| {
            shadow.bounds.is_apart(bounds)
                || shadow.sides().iter().any(|s| part.iter().all(|&c| s.height(c) <= 0.0))
        };
        let touched = |pieces: &Pieces| {
            pieces.iter().zip(&pieces.bounds).position(|(part, bounds)| !is_outside(part, bounds))
        };
        let Some(first) = touched(&self.now) else { return true };
        let Self { now, next, rest: [rest, spare], tiny, .. } = self;
        next.take(now, first);
        for (index, (part, bounds)) in now.iter().zip(&now.bounds).enumerate().skip(first) {
            if index > first && is_outside(part, bounds) {
                next.push(part);
                continue;
            }
            let whole = next.ends.len();
            rest.clear();
            rest.extend_from_slice(part);
            for side in shadow.sides() {
                if rest.iter().all(|&c| side.height(c) >= 0.0) {
                    continue;
                }
                let start = next.corners.len();
                clip(rest, |c| -side.height(c), DVec2::lerp, |c| next.corners.push(c));
                if area(&next.corners[start..]) > *tiny {
                    next.end();
                } else {
                    next.corners.truncate(start);
                }
                spare.clear();
                clip(rest, |c| side.height(c), DVec2::lerp, |c| spare.push(c));
                std::mem::swap(rest, spare);
                if rest.len() < 3 {
                    break;
                }
            }
            if rest.len() < 3 || area(rest) <= *tiny {
                // Nothing is hidden: the part stays whole.
                next.truncate(whole);
                next.push(part);
            }
        }
        std::mem::swap(&mut self.now, &mut self.next);
        self.now.ends.len() <= MAX_PARTS
    }

    /// Whether nothing is left.
    pub(crate) fn is_empty(&self) -> bool {
        self.now.ends.is_empty()
    }

    /// Visits the corners of each part, in space.
    pub(crate) fn visit(&self, corners: &mut Vec<DVec3>, mut part: impl FnMut(&[DVec3])) {
        for piece in self.now.iter() {
            corners.clear();
            corners.extend(piece.iter().map(|&c| self.frame.point(c)));
            part(corners);
        }
    }

    /// A point of the parts, uniform by area, by unit-square coordinates.
    pub(crate) fn sample(&self, u: f64, v: f64) -> DVec3 {
        let total: f64 = self.now.iter().map(area).sum();
        let mut along = u * total;
        let mut last = DVec2::ZERO;
        for part in self.now.iter() {
            for w in part.windows(2).skip(1) {
                let (a, b, c) = (part[0], w[0], w[1]);
                let own = 0.5 * (b - a).perp_dot(c - a).abs();
                let share = if own > 0.0 { (along / own).clamp(0.0, 1.0).sqrt() } else { 0.0 };
                last = a + (b - a) * (share * (1.0 - v)) + (c - a) * (share * v);
                if along <= own {
                    return self.frame.point(last);
                }
                along -= own;
            }
        }
        self.frame.point(last)
    }
}

fn area(corners: &[DVec2]) -> f64 {
    let Some(&first) = corners.first() else { return 0.0 };
    let doubled: f64 = corners.windows(2).skip(1).map(|w| (w[0] - first).perp_dot(w[1] - first)).sum();
    0.5 * doubled.abs()
}

#[cfg(test)]
mod tests {
    use catoptric_trace::sequence::{Key, Purpose};

    use super::*;

    const SQUARE: [DVec3; 4] = [
        DVec3::new(-1.0, -1.0, 4.0),
        DVec3::new(1.0, -1.0, 4.0),
        DVec3::new(1.0, 1.0, 4.0),
        DVec3::new(-1.0, 1.0, 4.0),
    ];

    fn point(key: Key, index: u32) -> DVec3 {
        let [a, b] = [key.point2(index), key.child(1).point2(index)].map(|p| p.as_dvec2() * 2.0 - 1.0);
        DVec3::new(a.x, a.y, b.x)
    }

    fn square() -> (Parts, Frame) {
        let mut parts = Parts::default();
        parts.reset(&SQUARE).expect("an area");
        let frame = parts.frame();
        (parts, frame)
    }

    /// Whether the segment from the origin to `to` crosses a triangle.
    fn crosses([a, b, c]: [DVec3; 3], to: DVec3) -> bool {
        let normal = (b - a).cross(c - a);
        let t = normal.dot(a) / normal.dot(to);
        let at = to * t;
        let side = |p: DVec3, q: DVec3| (q - p).cross(at - p).dot(normal) > 0.0;
        t > 0.0 && t < 1.0 && side(a, b) && side(b, c) && side(c, a)
    }

    #[test]
    fn each_point_is_left_that_no_blocker_hides_and_in_one_part_only() {
        let (mut left, mut hidden) = (0, 0);
        for case in 0..300 {
            let key = Key::new(1, Purpose::Test, case);
            let (mut parts, frame) = square();
            // Around the pyramid: some reach behind the eye, none behind the square.
            let triangles: Vec<[DVec3; 3]> = (0..6)
                .map(|i| {
                    let middle = point(key, i) * DVec3::new(1.0, 1.0, 1.5) + DVec3::Z * 1.6;
                    [10, 20, 30].map(|k| middle + point(key.child(k), i) * 0.8)
                })
                .collect();
            for triangle in &triangles {
                if let Some(shadow) = Shadow::cast(triangle, DVec3::ZERO, &frame) {
                    assert!(parts.remove(&shadow), "case {case}");
                }
            }
            for index in 0..200 {
                let at = point(key.child(5), index);
                let to = DVec3::new(at.x, at.y, 4.0);
                let is_hidden = triangles.iter().any(|&t| crosses(t, to));
                let mut holders = 0;
                parts.visit(&mut Vec::new(), |part| {
                    let turn = |k: usize| (part[(k + 1) % part.len()] - part[k]).cross(to - part[k]).z;
                    let turns: Vec<f64> = (0..part.len()).map(turn).collect();
                    holders += i32::from(turns.iter().all(|t| *t > 0.0) || turns.iter().all(|t| *t < 0.0));
                });
                assert_eq!(holders, i32::from(!is_hidden), "case {case}, {to}");
                left += u32::from(!is_hidden);
                hidden += u32::from(is_hidden);
            }
        }
        assert!(left > 10_000 && hidden > 10_000, "{left} left, {hidden} hidden");
    }

    #[test]
    fn blockers_that_share_an_edge_leave_no_seam() {
        let (mut parts, frame) = square();
        let [a, b, c, d] =
            [(-0.5, -0.6), (0.7, -0.5), (0.6, 0.8), (-0.7, 0.9)].map(|(x, y)| DVec3::new(x, y, 1.0));
        for triangle in [[a, b, c], [a, c, d]] {
            let shadow = Shadow::cast(&triangle, DVec3::ZERO, &frame).expect("a shadow");
            assert!(!parts.is_empty() && parts.remove(&shadow));
        }
        assert!(parts.is_empty());
    }

    #[test]
    fn what_is_edge_on_or_behind_the_eye_hides_nothing() {
        let (mut parts, frame) = square();
        let edge_on = [DVec3::ZERO, DVec3::new(0.1, 0.1, 2.0), DVec3::new(0.2, 0.2, 1.0)];
        assert!(Shadow::cast(&edge_on, DVec3::ZERO, &frame).is_none());
        let behind = [DVec3::new(-1.0, -1.0, -1.0), DVec3::new(1.0, -1.0, -1.0), DVec3::new(0.0, 1.0, -1.0)];
        let shadow = Shadow::cast(&behind, DVec3::ZERO, &frame).expect("a cone");
        assert!(parts.remove(&shadow));
        parts.visit(&mut Vec::new(), |part| assert_eq!(part.len(), 4));
    }

    /// Bars across bars: squares in so many pieces are left to rays.
    #[test]
    fn too_many_parts_are_told() {
        let (mut parts, frame) = square();
        let bar = |index: i32, turned: bool| {
            let x = -0.23 + 0.05 * f64::from(index);
            let corners = [(x, -1.0), (x + 0.02, -1.0), (x + 0.02, 1.0), (x, 1.0)];
            corners.map(|(x, y)| if turned { DVec3::new(y, x, 1.0) } else { DVec3::new(x, y, 1.0) })
        };
        let mut cut = |turned: bool| {
            (0..10).all(|index| {
                parts.remove(&Shadow::cast(&bar(index, turned), DVec3::ZERO, &frame).expect("a shadow"))
            })
        };
        assert!(cut(false));
        assert!(!cut(true));
    }

    /// Uniform by area: of n = 1000 stratified ones, one
    /// more or less.
    #[test]
    fn samples_lie_in_the_parts_by_area() {
        let (mut parts, frame) = square();
        let bar =
            [(-0.125, -1.0), (0.2, -1.0), (0.2, 1.0), (-0.125, 1.0)].map(|(x, y)| DVec3::new(x, y, 1.0));
        assert!(parts.remove(&Shadow::cast(&bar, DVec3::ZERO, &frame).expect("a shadow")));
        let (mut left, mut right) = (0, 0);
        for index in 0..1000 {
            let at = parts.sample((f64::from(index) + 0.5) / 1000.0, 0.3);
            assert!(at.x.abs() <= 1.0 && at.y.abs() <= 1.0 && (at.z - 4.0).abs() < 1e-12, "{at}");
            left += i32::from(at.x < -0.5);
            right += i32::from(at.x > 0.8);
        }
        // The strips are 0.5 and 0.2 wide.
        assert_eq!(left + right, 1000);
        assert!((left - 714).abs() <= 1, "{left} and {right}");
    }
}
