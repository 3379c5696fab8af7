//! Long triangles of the author's curved meshes, such as the wall of a cylinder: bisected until they are as wide as they are
//! long, or light is interpolated along them.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use rustc_hash::FxHashMap;

use catoptric_trace::Tracer;

use crate::draft::{Draft, Leaf, edge};

/// Edges that are longer than this multiple of the shortest one of the author's triangle beside them are halved.
const LONG: f32 = 2.0;
/// Triangles that this may add, at most: the longest edges come first, and an author's slivers may be any number.
const MOST: usize = 20_000;

impl Draft {
    /// Bisects edges of curved faces, the longest first, with the triangles on both sides (no T-vertices): those longer than
    /// `shortest` metres beside slivers. (Red–green refinement keeps the shape of triangles, good or bad.)
    pub(crate) fn bisect_slivers(&mut self, tracer: &Tracer, shortest: f32) {
        // The triangles beside each edge that is long enough.
        let mut beside: FxHashMap<(u32, u32), Vec<u32>> = FxHashMap::default();
        // Shortest edge of each curved face: it is one triangle.
        let mut widths = vec![f32::INFINITY; self.faces.len()];
        for (index, leaf) in self.leaves.iter().enumerate() {
            if self.faces[leaf.face as usize].curved {
                let [a, b, c] = tracer.scene().corners(self.faces[leaf.face as usize].triangles[0]);
                widths[leaf.face as usize] = (b - a).length().min((c - b).length()).min((a - c).length());
                for key in leaf.edges() {
                    if self.length(key) > shortest {
                        beside.entry(key).or_default().push(index as u32);
                    }
                }
            }
        }
        let mut heap: BinaryHeap<(u32, Reverse<(u32, u32)>)> = BinaryHeap::new();
        for (&key, leaves) in &beside {
            heap.extend(self.sliver(&widths, key, leaves));
        }
        let most = self.leaves.len() + MOST;
        while let Some((_, Reverse(long))) = heap.pop() {
            // What has been bisected since is no edge any more.
            let Some(own) = beside.remove(&long) else { continue };
            if self.leaves.len() + own.len() > most {
                break;
            }
            let middle = self.midpoint(tracer, long.0, long.1);
            let mut changed = Vec::with_capacity(5 * own.len());
            for index in own {
                let leaf = self.leaves[index as usize];
                let new = self.leaves.len() as u32;
                let Some(at) = leaf.edges().iter().position(|&key| key == long) else { continue };
                let [a, b, c] = [0, 1, 2].map(|k| leaf.vertices[(at + k) % 3]);
                let halves =
                    [Leaf { vertices: [a, middle, c], ..leaf }, Leaf { vertices: [middle, b, c], ..leaf }];
                self.leaves[index as usize] = halves[0];
                self.leaves.push(halves[1]);
                for half in halves {
                    self.note_edges(half.face, half.vertices);
                    changed.extend(half.edges());
                }
                if let Some(other) =
                    beside.get_mut(&edge(b, c)).and_then(|l| l.iter_mut().find(|l| **l == index))
                {
                    *other = new;
                }
                for (p, half) in [(a, index), (b, new), (c, index), (c, new)] {
                    if self.length((p, middle)) > shortest {
                        beside.entry(edge(p, middle)).or_default().push(half);
                    }
                }
            }
            changed.sort_unstable();
            changed.dedup();
            for key in changed {
                heap.extend(beside.get(&key).and_then(|leaves| self.sliver(&widths, key, leaves)));
            }
        }
        self.leaves.sort_by_key(|leaf| leaf.face);
    }

    /// An edge that is to be bisected, by its length. The author's triangles tell what is narrow: a half of a triangle with two
    /// long edges is as long for its width as the whole.
    fn sliver(&self, widths: &[f32], key: (u32, u32), leaves: &[u32]) -> Option<(u32, Reverse<(u32, u32)>)> {
        let own = self.length(key);
        let width = |&leaf: &u32| widths[self.leaves[leaf as usize].face as usize];
        let narrowest = leaves.iter().map(width).fold(f32::INFINITY, f32::min);
        // Positive floats are ordered as their bits.
        (own > LONG * narrowest).then(|| (own.to_bits(), Reverse(key)))
    }
}

#[cfg(test)]
mod tests {
    use catoptric_scene::{Material, Rgb, Scene, SceneParts};
    use glam::Vec3;
    use std::collections::BTreeMap;

    use super::*;

    /// A tube 1 m high with the radius 0.3 m, smooth, of 24 quads; and a ball, whose edges are short.
    fn tube_and_ball() -> Scene {
        let mut parts = SceneParts::default();
        let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
        let (mut positions, mut normals, mut indices) = (Vec::new(), Vec::new(), Vec::new());
        for k in 0..24_u32 {
            let (sin, cos) = libm::sincosf(k as f32 * std::f32::consts::TAU / 24.0);
            let normal = Vec3::new(cos, 0.0, sin);
            positions.extend([0.3 * normal, 0.3 * normal + Vec3::Y]);
            normals.extend([normal; 2]);
            let [low, high, next_low, next_high] = [2 * k, 2 * k + 1, (2 * k + 2) % 48, (2 * k + 3) % 48];
            indices.extend([[low, high, next_high], [low, next_high, next_low]]);
        }
        parts.add_mesh("tube", white, &positions, &normals, &indices, true);
        parts.add_sphere("ball", white, Vec3::X * 2.0, 0.3, 16);
        Scene::new(parts).expect("a valid scene")
    }

    #[test]
    fn slivers_of_a_tube_are_bisected_without_t_vertices() {
        let scene = tube_and_ball();
        let tracer = Tracer::new(&scene);
        // Edges of 0.4 m: those of more than 0.1 m may be bisected.
        let draft = Draft::new(&tracer, 0.4);
        let mut count: BTreeMap<(u32, u32), usize> = BTreeMap::new();
        let (mut tube, mut ball, mut area) = (0, 0, 0.0);
        // Of the author's triangles.
        let width = 0.6 * libm::sinf(std::f32::consts::PI / 24.0);
        for leaf in &draft.leaves {
            for key in leaf.edges() {
                *count.entry(key).or_default() += 1;
            }
            if draft.center(leaf).x > 1.0 {
                ball += 1;
            } else {
                let longest = draft.longest_edge(leaf);
                assert!(longest <= LONG * width + 1e-6, "{longest} m beside {width} m");
                (tube, area) = (tube + 1, area + draft.area(leaf));
            }
        }
        // Edges of 1 m are halved three times, the new ones between them too, and a triangle with three such edges becomes three (four)
        // each time. The ball is as it was.
        assert!((48 * 8..=48 * 64).contains(&tube), "{tube}");
        assert_eq!(ball, 2 * 32 * 15);
        assert!((area - 24.0 * width).abs() < 1e-4, "{area}");
        // The rims alone have one triangle.
        let rim = |key: &(u32, u32)| {
            let [p, q] = [key.0, key.1].map(|v| draft.vertices[v as usize].position);
            p.y == q.y && (p.y == 0.0 || p.y == 1.0) && p.x < 1.0
        };
        for (key, n) in &count {
            assert_eq!(*n, if rim(key) { 1 } else { 2 }, "{key:?}");
        }
    }
}
