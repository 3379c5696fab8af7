//! What stands on a face: its edges just before the face, and the way from them to what it darkens.

use glam::{DVec2, DVec3};

use crate::face::Frame;

/// What stands before a face with an edge nearer than this share of the edge length, or of the face's size, touches it, as
/// the mesh sees it: light differs as much between its two sides, and what passes below is narrower than elements.
pub(super) const SHORT: f64 = 0.05;
/// Sine of the angle by which it rises, at least: the facets at the foot of a ball do not stand on their edges.
const STEEP: f64 = 0.3;

/// Edges near a face, to find those on which something stands: cards, mirrors that lean, legs that end just above the floor.
pub(super) struct Feet {
    /// Edges are near below this height, metres.
    gap: f64,
    tolerance: f64,
    /// Edges by the bits of their ends, with what is known of each from one triangle.
    edges: Vec<([[u64; 3]; 2], Foot)>,
}

/// How a triangle lies beside one of its edges.
#[derive(Clone, Copy)]
enum Foot {
    /// It rises from the edge steeply.
    Standing,
    /// It reaches below the edge: nothing ends here.
    Below,
}

impl Feet {
    /// None yet.
    pub(super) fn new(gap: f64, tolerance: f64) -> Self {
        Self { gap, tolerance, edges: Vec::new() }
    }

    /// Adds the edges of a triangle, whose corners are at `heights` metres before the face.
    pub(super) fn push(&mut self, corners: &[DVec3; 3], heights: &[f64; 3]) {
        for k in 0..3 {
            let (a, b, apex) = (k, (k + 1) % 3, (k + 2) % 3);
            let is_near = |h: f64| (-self.tolerance..self.gap).contains(&h);
            if !is_near(heights[a]) || !is_near(heights[b]) {
                continue;
            }
            let along = corners[b] - corners[a];
            let across = along.cross(corners[apex] - corners[a]).length() / along.length();
            let foot = if heights[apex] - heights[a].max(heights[b]) > STEEP * across {
                Foot::Standing
            } else if heights[apex] < heights[a].min(heights[b]) - self.tolerance {
                Foot::Below
            } else {
                continue;
            };
            let ends = [a, b].map(|i| corners[i].to_array().map(f64::to_bits));
            self.edges.push(([ends[0].min(ends[1]), ends[0].max(ends[1])], foot));
        }
    }

    /// The edges from which all triangles that share them rise.
    pub(super) fn standing(mut self) -> Vec<[DVec3; 2]> {
        self.edges.sort_unstable_by_key(|&(ends, _)| ends);
        let alike = self.edges.chunk_by(|a, b| a.0 == b.0);
        let standing = alike.filter(|edge| edge.iter().all(|(_, foot)| matches!(foot, Foot::Standing)));
        standing.map(|edge| edge[0].0.map(|bits| DVec3::from_array(bits.map(f64::from_bits)))).collect()
    }
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
