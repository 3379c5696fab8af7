//! Places where something is smaller than elements: those that hold one are split.

use glam::Vec3;
use rayon::prelude::*;

use crate::JOB;
use crate::draft::Draft;

/// A place where something is small.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Detail {
    /// Base triangle.
    pub(crate) root: u32,
    pub(crate) position: Vec3,
    /// How small, metres.
    pub(crate) size: f32,
}

/// Details, by base triangle.
#[derive(Default)]
pub(crate) struct Details(Vec<Detail>);

impl Details {
    pub(crate) fn new(mut details: Vec<Detail>) -> Self {
        details.sort_by_key(|d| d.root);
        Self(details)
    }

    /// Edges of the triangles with an edge longer than `shortest` and than `ratio` times the smallest detail that they hold:
    /// as many as may make `room` triangles.
    pub(crate) fn marks(&self, draft: &Draft, ratio: f32, shortest: f32, room: usize) -> Vec<(u32, u32)> {
        let mut large: Vec<(f32, u32)> = draft
            .leaves
            .par_iter()
            .enumerate()
            .with_min_len(64)
            .with_max_len(JOB)
            .filter_map(|(index, leaf)| {
                let [a, b, c] = leaf.vertices.map(|v| draft.vertices[v as usize].position);
                let size = (b - a).length().max((c - b).length()).max((a - c).length());
                if size <= shortest {
                    return None;
                }
                let start = self.0.partition_point(|d| d.root < leaf.root);
                let own = self.0[start..].iter().take_while(|d| d.root == leaf.root);
                let smallest = own
                    .filter(|d| is_inside(d.position, [a, b, c]))
                    .map(|d| d.size)
                    .fold(f32::INFINITY, f32::min);
                (size > ratio * smallest).then_some((size / smallest, index as u32))
            })
            .collect();
        // The worst first. Each triangle becomes four, and its neighbours are halved.
        large.sort_by(|x, y| y.0.total_cmp(&x.0).then(x.1.cmp(&y.1)));
        large.truncate(room / 5);
        large
            .iter()
            .flat_map(|&(_, leaf)| {
                let [a, b, c] = draft.leaves[leaf as usize].vertices;
                [(a, b), (b, c), (c, a)]
            })
            .collect()
    }
}

/// Whether the foot of a point's perpendicular on a triangle lies inside of it.
pub(crate) fn is_inside(point: Vec3, [a, b, c]: [Vec3; 3]) -> bool {
    let normal = (b - a).cross(c - a);
    [(a, b), (b, c), (c, a)].iter().all(|(p, q)| (*q - *p).cross(point - *p).dot(normal) >= 0.0)
}
