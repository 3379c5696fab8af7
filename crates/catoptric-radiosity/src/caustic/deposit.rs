//! Where light-side rays ended, sorted so that every triangle of the refined mesh is a range.
//!
//! A base triangle is split into four again and again as [`Draft::split`] does; the digits of the parts that hold a
//! point are its code. Points of a part, on whatever level, share the first digits.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use catoptric_scene::Rgb;
use catoptric_solution::DisplayMesh;
use catoptric_solution::mesh::Located;

use crate::JOB;
use crate::draft::{Draft, Leaf};

/// Splits that a code tells apart: 1/16384 of a base edge.
pub(super) const LEVELS: u32 = 14;

/// Irradiance × area at a place.
#[derive(Clone, Copy, Debug)]
pub(super) struct Deposit {
    pub(super) code: u64,
    /// Barycentric weights in the base triangle.
    pub(super) weights: [f32; 3],
    pub(super) power: Rgb,
}

/// Deposits in the order of their codes.
#[derive(Clone, Debug, Default)]
pub(super) struct Deposits {
    codes: Vec<u64>,
    /// Barycentric weights in the base triangles.
    weights: Vec<[f32; 3]>,
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
            deposits.par_iter().enumerate().map(|(index, d)| (d.code, index as u32)).collect();
        order.par_sort_unstable();
        let sorted = || order.par_iter().with_min_len(JOB).map(|o| &deposits[o.1 as usize]);
        Self {
            codes: order.iter().map(|o| o.0).collect(),
            weights: sorted().map(|d| d.weights).collect(),
            powers: sorted().map(|d| d.power * scale).collect(),
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

    /// The base triangle of each, in ascending order.
    pub(super) fn roots(&self) -> impl Iterator<Item = u32> {
        self.codes.iter().map(|code| (code >> (2 * LEVELS)) as u32)
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

    /// Weights of a deposit at the corners of the base triangle.
    #[inline]
    pub(super) fn weights(&self, index: usize) -> [f32; 3] {
        self.weights[index]
    }
}

/// How weights in the base triangle become weights in one of its parts: times `scale`, less `offsets`, in the order `from`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Within {
    scale: f32,
    offsets: [f32; 3],
    from: [usize; 3],
}

impl Within {
    /// For a part.
    pub(super) fn of(part: Part) -> Self {
        let mut within = Self { scale: 1.0, offsets: [0.0; 3], from: [0, 1, 2] };
        for level in 1..=part.level {
            let digit = (part.code >> (2 * (LEVELS - level)) & 3) as usize;
            let Self { scale, offsets: [x, y, z], from: [a, b, c] } = within;
            within = if digit == 3 {
                // 1 − 2z, 1 − 2x, 1 − 2y.
                let offsets = [z, x, y].map(|offset| -2.0 * offset - 1.0);
                Self { scale: -2.0 * scale, offsets, from: [c, a, b] }
            } else {
                let mut offsets = [x, y, z].map(|offset| 2.0 * offset);
                offsets[digit] += 1.0;
                Self { scale: 2.0 * scale, offsets, from: [a, b, c] }
            };
        }
        within
    }

    /// The weights of a point at the corners of the part.
    #[inline]
    pub(super) fn weights(&self, base: [f32; 3]) -> [f32; 3] {
        std::array::from_fn(|k| base[self.from[k]] * self.scale - self.offsets[k])
    }
}

impl Deposit {
    /// At a point on a base triangle.
    pub(super) fn at(
        draft: &Draft,
        mesh: &DisplayMesh,
        root: u32,
        located: &Located,
        position: Vec3,
        power: Rgb,
    ) -> Self {
        let [a, b, c] = draft.base[root as usize].map(|v| draft.vertices[v as usize].position);
        let corners = located.vertices.map(|v| mesh.vertices[v as usize].position);
        // Elements are base triangles but for the halves next to split neighbours.
        let weights = if corners == [a, b, c] {
            located.weights.map(f64::from)
        } else {
            weights_in_base(draft, root, position)
        };
        Self::of(root, weights, power)
    }

    /// At barycentric weights in a base triangle.
    pub(super) fn of(root: u32, weights: [f64; 3], power: Rgb) -> Self {
        let code = u64::from(root) << (2 * LEVELS) | digits(weights);
        Self { code, weights: weights.map(|w| w as f32), power }
    }
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
fn digits([x, y, _]: [f64; 3]) -> u64 {
    // The smallest part by the whole numbers of its weights: they sum to one less than the size, or two where it stands on its head.
    let size = 1_i32 << LEVELS;
    let (x, y) = (x * f64::from(size), y * f64::from(size));
    let (mut i, mut j) = ((x as i32).min(size - 1), (y as i32).min(size - 1));
    let over = x - f64::from(i) + y - f64::from(j) > 1.0;
    let mut k = size - 1 - i - j - i32::from(over);
    if k < 0 {
        // On the edge, or rounded beyond it.
        k = 0;
        if i + j >= size {
            (i, j) = if i > j { (size - 1 - j, j) } else { (i, size - 1 - i) };
        }
    }
    // Each level looks at one bit of each. The middle part stands on its head: its weights are 1 − 2z, 1 − 2x, 1 − 2y of the whole,
    // so that bits are turned over and belong to the next corner.
    let (mut turned, mut shift) = (0, 0);
    let mut code = 0;
    for level in (0..LEVELS).rev() {
        let bit = |w: i32| (w >> level & 1 ^ turned) as u32;
        let (a, b, c) = (bit(i), bit(j), bit(k));
        let corner = (b + 2 * c + shift) % 3;
        let is_middle = a | b | c == 0;
        code = code << 2 | if is_middle { 3 } else { u64::from(corner) };
        turned ^= i32::from(is_middle);
        shift = (shift + u32::from(is_middle)) % 3;
    }
    code
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Weights of the middle of the part that digits name, by the way in which triangles are split.
    fn middle(code: u64, levels: u32) -> [f64; 3] {
        let [mut x, mut y, mut z] = [1.0 / 3.0; 3];
        for above in 0..levels {
            (x, y, z) = match code >> (2 * above) & 3 {
                0 => (x + 0.5 * (y + z), 0.5 * y, 0.5 * z),
                1 => (0.5 * x, y + 0.5 * (x + z), 0.5 * z),
                2 => (0.5 * x, 0.5 * y, z + 0.5 * (x + y)),
                _ => (0.5 * (x + z), 0.5 * (x + y), 0.5 * (y + z)),
            };
        }
        [x, y, z]
    }

    const POINTS: [(f64, f64); 10] = [
        (0.1, 0.2),
        (0.7, 0.1),
        (0.05, 0.9),
        (0.31, 0.36),
        (0.5, 0.25),
        (0.0, 0.0),
        (0.0, 1.0),
        (1.0, 0.0),
        (0.5, 0.5),
        (0.300_000_000_000_000_04, 0.7),
    ];

    #[test]
    fn a_code_leads_back_to_its_point() {
        for (u, v) in POINTS {
            let weights = [1.0 - u - v, u, v];
            let found = middle(digits(weights), LEVELS);
            for k in 0..3 {
                // The smallest part around it.
                assert!(
                    (found[k] - weights[k]).abs() < 1.0 / f64::from(1 << LEVELS),
                    "{weights:?} {found:?}"
                );
            }
        }
    }

    #[test]
    fn weights_in_a_part_are_those_of_the_digits_that_are_left() {
        for (u, v) in POINTS {
            let code = digits([1.0 - u - v, u, v]);
            let base = middle(code, LEVELS).map(|w| w as f32);
            for level in 0..LEVELS {
                let shift = 2 * (LEVELS - level);
                let found = Within::of(Part { code: code >> shift << shift, level }).weights(base);
                let rest = middle(code, LEVELS - level);
                // Rounding grows with the scale.
                let tolerance = f64::from(1 << level) * f64::from(f32::EPSILON);
                for k in 0..3 {
                    assert!((f64::from(found[k]) - rest[k]).abs() < tolerance, "{level}: {found:?} {rest:?}");
                }
            }
        }
    }
}
