//! What stands on a face or leans against it: its edges just before the face, and the way from them to what it darkens.

use glam::{DVec2, DVec3};

use crate::face::Frame;

/// What stands before a face with an edge nearer than this share of the edge length, or of the face's size, touches it, as
/// the mesh sees it: light differs as much between its two sides, and what passes below is narrower than elements.
pub(super) const SHORT: f64 = 0.05;
/// Sine of the angle by which smooth surfaces rise, at least: the facets at the foot of a ball do not stand on their edges.
const STEEP: f64 = 0.3;
/// … and of that by which others do: a mirror leans against a wall.
const GENTLE: f64 = 0.02;

/// Edges near a face, to find those on which something stands: cards, mirrors that lean, legs that end just above the floor; and
/// the outlines of what rises from there.
pub(super) struct Feet {
    /// Edges are near below this height, metres.
    gap: f64,
    tolerance: f64,
    /// Edges by the bits of their ends, with what is known of each from one triangle.
    edges: Vec<(Ends, Beside)>,
}

/// Two ends of an edge by their bits, the lesser first.
type Ends = [[u64; 3]; 2];

/// What a triangle is beside one of its edges.
#[derive(Clone, Copy)]
struct Beside {
    foot: Foot,
    way: Way,
}

/// Where a triangle is from one of its edges, seen from the face.
#[derive(Clone, Copy, PartialEq)]
enum Way {
    Left,
    Right,
    /// It is seen edge on.
    Edge,
    /// Part of a smooth surface: outlines are not where its edges are.
    Smooth,
}

impl Beside {
    /// What is on this way of the edge may end on it, for all that this triangle says.
    fn outlines(&self, way: Way) -> bool {
        self.way == way || self.way == Way::Edge && self.foot != Foot::Below
    }
}

/// How a triangle lies beside one of its edges.
#[derive(Clone, Copy, PartialEq)]
enum Foot {
    /// It rises from the edge, which is near.
    Standing,
    /// It reaches below the edge: nothing stands here.
    Below,
    /// Neither.
    Level,
}

/// Edges before a face.
pub(super) struct Found {
    /// From which all triangles that share them rise.
    pub(super) standing: Vec<[DVec3; 2]>,
    /// Others, on which what is seen from the face ends: all triangles that share them are on one side.
    pub(super) outlines: Vec<[DVec3; 2]>,
}

impl Feet {
    /// None yet.
    pub(super) fn new(gap: f64, tolerance: f64) -> Self {
        Self { gap, tolerance, edges: Vec::new() }
    }

    /// Adds the edges of a triangle, whose corners are at `heights` metres before the face and at `flat` in its plane.
    pub(super) fn push(
        &mut self,
        corners: &[DVec3; 3],
        flat: &[DVec2; 3],
        heights: &[f64; 3],
        is_smooth: bool,
    ) {
        let steepness = if is_smooth { STEEP } else { GENTLE };
        for k in 0..3 {
            let (mut a, mut b, apex) = (k, (k + 1) % 3, (k + 2) % 3);
            let near = [a, b].map(|i| (-self.tolerance..self.gap).contains(&heights[i]));
            if near == [false; 2] {
                continue;
            }
            let bits = |i: usize| corners[i].to_array().map(f64::to_bits);
            if bits(b) < bits(a) {
                std::mem::swap(&mut a, &mut b);
            }
            let along = corners[b] - corners[a];
            let across = along.cross(corners[apex] - corners[a]).length() / along.length();
            let foot = if heights[apex] < heights[a].min(heights[b]) - self.tolerance {
                Foot::Below
            } else if near == [true; 2] && heights[apex] - heights[a].max(heights[b]) > steepness * across {
                Foot::Standing
            } else {
                Foot::Level
            };
            let along = flat[b] - flat[a];
            let beside = along.perp_dot(flat[apex] - flat[a]);
            let way = if is_smooth {
                Way::Smooth
            } else if beside.abs() <= self.tolerance * along.length() {
                Way::Edge
            } else if beside > 0.0 {
                Way::Left
            } else {
                Way::Right
            };
            self.edges.push(([bits(a), bits(b)], Beside { foot, way }));
        }
    }

    /// What the edges are.
    pub(super) fn find(mut self) -> Found {
        self.edges.sort_unstable_by_key(|&(ends, _)| ends);
        let mut found = Found { standing: Vec::new(), outlines: Vec::new() };
        for edge in self.edges.chunk_by(|a, b| a.0 == b.0) {
            let ends = edge[0].0;
            let is_outline = |way: Way| {
                edge.iter().any(|(_, b)| b.way == way) && edge.iter().all(|(_, b)| b.outlines(way))
            };
            let list = if edge.iter().any(|(_, b)| b.foot == Foot::Standing)
                && edge.iter().all(|(_, b)| b.foot != Foot::Below)
            {
                &mut found.standing
            } else if is_outline(Way::Left) || is_outline(Way::Right) {
                &mut found.outlines
            } else {
                continue;
            };
            list.push(ends.map(|bits| DVec3::from_array(bits.map(f64::from_bits))));
        }
        found
    }
}

/// Slope of an outline, at most: what rises more steeply is high before it is far.
const SLOPE: f64 = 0.5;

/// Whether an edge that is `length` metres long, seen from the face, leans over it: it does not come from behind the face, is neither
/// level (plates have outlines of their own) nor steep, and at least as long as its lower end is high.
pub(super) fn is_leaning(heights: [f64; 2], length: f64, tolerance: f64) -> bool {
    let [low, high] = [heights[0].min(heights[1]), heights[0].max(heights[1])];
    low > -tolerance && (GENTLE..=SLOPE).contains(&((high - low) / length)) && low <= length
}

/// Parts of an edge whose ends differ in height, as shares of its length, that are as high as `low..high`, and how high the upper end
/// of each is: twice as high as the lower one at most. `low` is above 0.
pub(super) fn by_height(ends: [f64; 2], [low, high]: [f64; 2]) -> Vec<([f64; 2], f64)> {
    let (mut from, top) = (ends[0].min(ends[1]).max(low), ends[0].max(ends[1]).min(high));
    let share = |height: f64| ((height - ends[0]) / (ends[1] - ends[0])).clamp(0.0, 1.0);
    let mut parts = Vec::new();
    while from < top {
        let to = (2.0 * from).min(top);
        parts.push(([share(from), share(to)], to));
        from = to;
    }
    parts
}

/// Sine of the angle at which something stands on a face, at least, that counts as upright.
const UPRIGHT: f64 = 0.9;

/// [`Contact::foot`](super::Contact::foot) of a triangle that stands on a face, if it is upright; it darkens what it shows its front to.
pub(super) fn foot(corners: &[DVec3; 3], frame: &Frame, side: f64) -> DVec2 {
    let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize_or_zero();
    let along = frame.flat(frame.origin + normal) - frame.flat(frame.origin);
    let height = corners.iter().map(|&c| frame.height(c) * side).fold(0.0, f64::max);
    if along.length() < UPRIGHT { DVec2::ZERO } else { along.normalize_or_zero() * height }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edges_lean_that_rise_slowly_from_before_the_face() {
        assert!(is_leaning([0.0, 0.25], 1.0, 1e-6) && is_leaning([0.25, 0.01], 1.0, 1e-6));
        for (heights, length) in
            [([0.1, 0.1], 1.0), ([0.0, 0.6], 1.0), ([-0.1, 0.1], 1.0), ([0.1, 0.12], 0.06)]
        {
            assert!(!is_leaning(heights, length, 1e-6), "{heights:?} along {length}");
        }
    }

    #[test]
    fn edges_are_divided_by_their_height() {
        assert!(by_height([0.02, 0.05], [0.1, 1.0]).is_empty());
        assert!(by_height([1.0, 2.0], [0.1, 1.0]).is_empty());
        // From 0 at one end to 8 at the other: 1 to 2 to 4 to 5.
        for ends in [[0.0, 8.0], [8.0, 0.0]] {
            let parts = by_height(ends, [1.0, 5.0]);
            let heights: Vec<f64> = parts.iter().map(|p| p.1).collect();
            assert_eq!(heights, [2.0, 4.0, 5.0]);
            let mut low = 1.0;
            for ([from, to], height) in parts {
                assert_eq!(ends[0] + (ends[1] - ends[0]) * from, low);
                assert_eq!(ends[0] + (ends[1] - ends[0]) * to, height);
                low = height;
            }
        }
    }
}
