//! Where light-side rays ended, sorted so that every triangle of the refined mesh is a range.
//!
//! A base triangle is split into four again and again as [`Draft::split`] does; the digits of the parts that hold a
//! point are its code. Points of a part, on whatever level, share the first digits.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use catoptric_scene::Rgb;
use catoptric_solution::DisplayMesh;
use catoptric_solution::mesh::Located;

use crate::draft::{Draft, Leaf};

/// Splits that a code tells apart: 1/16384 of a base edge.
pub(super) const LEVELS: u32 = 14;

/// Irradiance × area at a place.
#[derive(Clone, Copy, Debug)]
pub(super) struct Deposit {
    pub(super) code: u64,
    pub(super) power: Rgb,
}

/// Deposits in the order of their codes.
#[derive(Clone, Debug, Default)]
pub(super) struct Deposits {
    codes: Vec<u64>,
    powers: Vec<Rgb>,
}

/// The part of a base triangle that a leaf is: its code, and the number of splits that made it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Part {
    pub(super) code: u64,
    pub(super) level: u32,
}

impl Part {
    /// Of a leaf, by its place in the base triangle.
    pub(super) fn of(draft: &Draft, leaf: &Leaf) -> Self {
        let weights = weights_in_base(draft, leaf.root, draft.center(leaf));
        let level = u32::from(leaf.level).min(LEVELS);
        let shift = 2 * (LEVELS - level);
        let code = digits(weights) >> shift << shift;
        Self { code: u64::from(leaf.root) << (2 * LEVELS) | code, level }
    }

    /// Codes of its points.
    pub(super) fn codes(self) -> std::ops::Range<u64> {
        self.code..self.code + (1 << (2 * (LEVELS - self.level)))
    }

    /// One of its four parts.
    pub(super) fn child(self, index: u64) -> Self {
        let level = self.level + 1;
        Self { code: self.code | index << (2 * (LEVELS - level)), level }
    }
}

impl Deposits {
    /// Sorts; every power is multiplied by `scale`.
    pub(super) fn new(deposits: &[Deposit], scale: f32) -> Self {
        let mut order: Vec<(u64, u32)> =
            deposits.iter().enumerate().map(|(index, d)| (d.code, index as u32)).collect();
        order.par_sort_unstable();
        Self {
            codes: order.iter().map(|o| o.0).collect(),
            powers: order.iter().map(|o| deposits[o.1 as usize].power * scale).collect(),
        }
    }

    /// Indices of the deposits in a part.
    pub(super) fn range(&self, part: Part) -> std::ops::Range<usize> {
        let codes = part.codes();
        let start = self.codes.partition_point(|&c| c < codes.start);
        let length = self.codes[start..].partition_point(|&c| c < codes.end);
        start..start + length
    }

    /// The same within a known range.
    pub(super) fn range_within(&self, part: Part, within: &std::ops::Range<usize>) -> std::ops::Range<usize> {
        let codes = part.codes();
        let own = &self.codes[within.clone()];
        let start = own.partition_point(|&c| c < codes.start);
        let end = own.partition_point(|&c| c < codes.end);
        within.start + start..within.start + end
    }

    /// Σ of all powers.
    pub(super) fn total(&self) -> Rgb {
        self.powers.iter().map(|p| p.as_dvec3()).sum::<DVec3>().as_vec3()
    }

    /// Power of a deposit.
    #[inline]
    pub(super) fn power(&self, index: usize) -> Rgb {
        self.powers[index]
    }

    /// Powers of a range.
    pub(super) fn powers(&self, range: std::ops::Range<usize>) -> &[Rgb] {
        &self.powers[range]
    }

    /// Weights of a deposit at the corners of a part that holds it.
    #[inline]
    pub(super) fn weights(&self, index: usize, level: u32) -> [f32; 3] {
        let code = self.codes[index];
        let [mut x, mut y, mut z] = [1.0 / 3.0_f32; 3];
        for above in 0..LEVELS - level {
            (x, y, z) = match code >> (2 * above) & 3 {
                0 => (x + 0.5 * (y + z), 0.5 * y, 0.5 * z),
                1 => (0.5 * x, y + 0.5 * (x + z), 0.5 * z),
                2 => (0.5 * x, 0.5 * y, z + 0.5 * (x + y)),
                _ => (0.5 * (x + z), 0.5 * (x + y), 0.5 * (y + z)),
            };
        }
        [x, y, z]
    }
}

/// The code of a point on a base triangle.
pub(super) fn code_of(
    draft: &Draft,
    mesh: &DisplayMesh,
    root: u32,
    located: &Located,
    position: Vec3,
) -> u64 {
    let [a, b, c] = draft.base[root as usize].map(|v| draft.vertices[v as usize].position);
    let corners = located.vertices.map(|v| mesh.vertices[v as usize].position);
    // Elements are base triangles but for the halves next to split neighbours.
    let weights = if corners == [a, b, c] {
        located.weights.map(f64::from)
    } else {
        weights_in_base(draft, root, position)
    };
    u64::from(root) << (2 * LEVELS) | digits(weights)
}

fn weights_in_base(draft: &Draft, root: u32, position: Vec3) -> [f64; 3] {
    let [a, b, c] = draft.base[root as usize].map(|v| draft.vertices[v as usize].position.as_dvec3());
    let (e, f, p): (DVec3, DVec3, DVec3) = (b - a, c - a, position.as_dvec3() - a);
    let n = e.cross(f);
    let d = n.length_squared().max(f64::MIN_POSITIVE);
    let u = (p.cross(f).dot(n) / d).clamp(0.0, 1.0);
    let v = (e.cross(p).dot(n) / d).clamp(0.0, 1.0 - u);
    [1.0 - u - v, u, v]
}

/// The parts that hold a point, as digits to base four.
fn digits([mut x, mut y, mut z]: [f64; 3]) -> u64 {
    let mut code = 0;
    for _ in 0..LEVELS {
        let digit;
        (digit, x, y, z) = if x >= 0.5 {
            (0, 2.0 * x - 1.0, 2.0 * y, 2.0 * z)
        } else if y >= 0.5 {
            (1, 2.0 * x, 2.0 * y - 1.0, 2.0 * z)
        } else if z >= 0.5 {
            (2, 2.0 * x, 2.0 * y, 2.0 * z - 1.0)
        } else {
            (3, x + y - z, y + z - x, x + z - y)
        };
        code = code << 2 | digit;
    }
    code
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_code_leads_back_to_its_point() {
        for (u, v) in [(0.1, 0.2), (0.7, 0.1), (0.05, 0.9), (0.31, 0.36), (0.5, 0.25), (0.0, 1.0)] {
            let weights = [1.0 - u - v, u, v];
            let deposits = [Deposit { code: digits(weights), power: Rgb::ONE }];
            let found = Deposits::new(&deposits, 1.0).weights(0, 0);
            for k in 0..3 {
                assert!((f64::from(found[k]) - weights[k]).abs() < 1e-4, "{weights:?} {found:?}");
            }
        }
    }
}
