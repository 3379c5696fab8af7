//! Which boxes overlap a box: a tree for questions that are not about rays.

use glam::{DVec3, Vec3};
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::ploc::{PlocBuilder, PlocSearchDistance, SortPrecision};

/// A tree over axis-aligned boxes.
#[derive(Default)]
pub struct BoxTree {
    tree: Bvh2,
    reach: f32,
}

impl BoxTree {
    /// Builds the tree; boxes are known by their index.
    pub fn new(boxes: impl Iterator<Item = [Vec3; 2]>) -> Self {
        let boxes: Vec<Aabb> = boxes.map(|[min, max]| Aabb::new(min.into(), max.into())).collect();
        if boxes.is_empty() {
            return Self::default();
        }
        let reach = boxes.iter().map(|b| b.min.abs().max(b.max.abs()).max_element()).fold(0.0, f32::max);
        let indices = (0..boxes.len() as u32).collect();
        let build = PlocBuilder::with_capacity(boxes.len()).build(
            PlocSearchDistance::Minimum,
            &boxes,
            indices,
            SortPrecision::U64,
            0,
        );
        Self { tree: build, reach }
    }

    /// The boxes that overlap or touch a box, ascending. Some that nearly touch may be among them.
    pub fn overlapping(&self, min: DVec3, max: DVec3) -> Vec<u32> {
        self.overlapping_at_most(min, max, usize::MAX).unwrap_or_default()
    }

    /// The boxes that overlap or touch a box, ascending, or `None` where there are more than `limit`.
    pub fn overlapping_at_most(&self, min: DVec3, max: DVec3, limit: usize) -> Option<Vec<u32>> {
        self.search(min, max, None, limit)
    }

    /// The same of those that reach between the planes normal·x = low and normal·x = high: the box around a slanted face is mostly
    /// empty of it. `None` where there are more than `limit`.
    pub fn overlapping_between(
        &self,
        [min, max]: [DVec3; 2],
        normal: DVec3,
        [low, high]: [f64; 2],
        limit: usize,
    ) -> Option<Vec<u32>> {
        self.search(min, max, Some((normal, low, high)), limit)
    }

    fn search(
        &self,
        min: DVec3,
        max: DVec3,
        slab: Option<(DVec3, f64, f64)>,
        limit: usize,
    ) -> Option<Vec<u32>> {
        if self.tree.nodes.is_empty() {
            return Some(Vec::new());
        }
        // Rounding to f32 must not lose a box that touches.
        let margin = self.reach * f32::EPSILON;
        let query = Aabb::new((min.as_vec3() - margin).into(), (max.as_vec3() + margin).into());
        let reaches = |aabb: &Aabb| {
            slab.is_none_or(|(normal, low, high)| {
                let [min, max] = [aabb.min, aabb.max]
                    .map(|corner| DVec3::new(corner.x.into(), corner.y.into(), corner.z.into()));
                let center = normal.dot(min + max) * 0.5;
                let radius = normal.abs().dot(max - min) * 0.5 + f64::from(margin);
                center + radius >= low && center - radius <= high
            })
        };
        let mut found = Vec::new();
        let mut open = vec![0];
        while let Some(index) = open.pop() {
            let node = &self.tree.nodes[index as usize];
            if !node.aabb.intersect_aabb(&query) || !reaches(&node.aabb) {
                continue;
            }
            if node.is_leaf() {
                let range = node.first_index as usize..(node.first_index + node.prim_count) as usize;
                found.extend(&self.tree.primitive_indices[range]);
                if found.len() > limit {
                    return None;
                }
            } else {
                open.extend([node.first_index, node.first_index + 1]);
            }
        }
        found.sort_unstable();
        Some(found)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sequence::{Key, Purpose};

    #[test]
    fn finds_what_a_loop_over_all_boxes_finds() {
        let key = Key::new(5, Purpose::Test, 0);
        let point = |i: u32, k: u64| {
            let [a, b] = [key.child(2 * k as u32).point2(i), key.child(2 * k as u32 + 1).point2(i)];
            Vec3::new(a.x, a.y, b.x) * 10.0 - 5.0
        };
        for count in [0, 1, 2, 3, 500] {
            let boxes: Vec<[Vec3; 2]> = (0..count)
                .map(|i| point(i, 0))
                .zip((0..count).map(|i| point(i, 1).abs() * 0.2))
                .map(|(p, s)| [p, p + s])
                .collect();
            let tree = BoxTree::new(boxes.iter().copied());
            for query in 0..200 {
                let (min, size) = (point(query, 2), point(query, 3).abs() * 0.3);
                let max = min + size;
                let touches = |b: &[Vec3; 2]| b[0].cmple(max).all() && b[1].cmpge(min).all();
                let expected: Vec<u32> = (0..count).filter(|&i| touches(&boxes[i as usize])).collect();
                let mut found = tree.overlapping(min.as_dvec3(), max.as_dvec3());
                let at_most = |limit| tree.overlapping_at_most(min.as_dvec3(), max.as_dvec3(), limit);
                assert_eq!(at_most(found.len()).as_ref(), Some(&found));
                assert!(found.is_empty() || at_most(found.len() - 1).is_none());
                found.retain(|&i| touches(&boxes[i as usize]));
                assert_eq!(found, expected);

                // A slanted slab through the middle of the query.
                let normal = (point(query, 4) + 0.01).normalize_or(Vec3::X).as_dvec3();
                let (middle, half) = (normal.dot(0.5 * (min + max).as_dvec3()), 0.2);
                let between = [middle - half, middle + half];
                let reaches = |b: &[Vec3; 2], margin: f64| {
                    let corners = (0..8).map(|k| {
                        let side = |axis: u32| if k >> axis & 1 == 0 { b[0] } else { b[1] };
                        normal.dot(Vec3::new(side(0).x, side(1).y, side(2).z).as_dvec3())
                    });
                    let [low, high] = corners.fold([f64::MAX, f64::MIN], |[l, h], c| [l.min(c), h.max(c)]);
                    low <= between[1] + margin && high >= between[0] - margin
                };
                let ends = [min.as_dvec3(), max.as_dvec3()];
                let mut slanted =
                    tree.overlapping_between(ends, normal, between, usize::MAX).expect("no limit");
                // Nothing else than what reaches there, but for the rounding of 12 m.
                assert!(slanted.iter().all(|&i| reaches(&boxes[i as usize], 1e-5)));
                slanted.retain(|&i| touches(&boxes[i as usize]) && reaches(&boxes[i as usize], 0.0));
                let expected: Vec<u32> =
                    expected.into_iter().filter(|&i| reaches(&boxes[i as usize], 0.0)).collect();
                assert_eq!(slanted, expected);
            }
        }
    }
}
