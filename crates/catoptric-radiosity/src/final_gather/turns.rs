//! The order in which points inside the elements take their rays from one sequence.
//!
//! Points that stand beside each other take successive parts of it: the rays of each are stratified, and those of all together as well.
//! What one finds too much of, its neighbours find too little of, and the fit evens that out.

use std::ops::Range;

use glam::Vec3;
use rayon::prelude::*;

use catoptric_trace::Tracer;

use crate::curve::on_curve;
use crate::display::Displayed;
use crate::draft::Draft;
use crate::fit::FitSample;

/// The turn of each point along a curve that fills each face in turn, or each curved surface.
pub(super) fn turns(
    tracer: &Tracer,
    draft: &Draft,
    displayed: &Displayed,
    samples: &[FitSample],
) -> Vec<u32> {
    let mesh = &displayed.mesh;
    let key = |(s, index): (&FitSample, u32)| {
        let corners = mesh.elements[s.element as usize].vertices;
        let corner = |k: usize| mesh.vertices[corners[k] as usize].position * s.weights[k];
        let place: Vec3 = (0..3).map(corner).sum();
        let face = &draft.faces[draft.leaves[displayed.leaves[s.element as usize] as usize].face as usize];
        let triangle = face.triangles[0];
        let surface = tracer.scene().triangles()[triangle.index()].surface.0;
        let group = if face.curved { surface << 1 } else { tracer.planes().of(triangle).0 << 1 | 1 };
        (group, on_curve(tracer, place), index)
    };
    let mut order: Vec<(u32, u32, u32)> = samples.par_iter().zip(0..samples.len() as u32).map(key).collect();
    order.par_sort_unstable();
    let mut turns = vec![0; samples.len()];
    for (turn, (.., index)) in (0_u32..).zip(order) {
        turns[index as usize] = turn;
    }
    turns
}

/// So many points of a sequence, a power of two, where it is somebody's turn: they are a net by themselves.
pub(super) fn part(turn: u32, rays: u32) -> Range<u32> {
    let first = turn % (u32::MAX / rays.max(1)) * rays;
    first..first + rays
}

#[cfg(test)]
mod tests {
    use catoptric_trace::sequence::{Key, Purpose};

    use super::*;

    #[test]
    fn parts_are_nets_and_so_are_those_of_neighbours() {
        let key = Key::new(1, Purpose::Test, 0);
        for (turns, rays) in
            [(0..1, 64), (5..6, 64), (4..8, 16), (1024..1040, 64), (u32::MAX - 1..u32::MAX, 256)]
        {
            let points: Vec<_> = turns.flat_map(|turn| part(turn, rays)).map(|i| key.point2(i)).collect();
            // One in each of n columns, and in each of n rows.
            let mut seen = [vec![false; points.len()], vec![false; points.len()]];
            for point in &points {
                for (seen, v) in seen.iter_mut().zip(point.to_array()) {
                    seen[(v * points.len() as f32) as usize] = true;
                }
            }
            assert!(seen.iter().flatten().all(|seen| *seen), "{} points", points.len());
        }
    }
}
