//! The equations of a fit, and conjugate gradients for them.

use std::ops::Range;

use rayon::prelude::*;

use catoptric_scene::Rgb;

use super::parts::FitMesh;
use super::{FitParams, Normal};

/// Minimum of the squares of `normal` and of the bends times `stiffness` (empty: none), from `start` on, per vertex.
pub(super) fn minimum(
    parts: &FitMesh,
    normal: &Normal,
    stiffness: &[f32],
    start: &[Rgb],
    params: &FitParams,
) -> Vec<Rgb> {
    let found: Vec<Vec<Rgb>> = parts
        .jobs
        .par_windows(2)
        .with_max_len(1)
        .map(|job| {
            let mut system = System::new(parts, job[0]..job[1], normal, stiffness, start);
            (job[0]..job[1]).for_each(|part| system.solve(parts, part, params));
            system.x
        })
        .collect();
    let mut x = vec![Rgb::ZERO; start.len()];
    for (&v, value) in parts.vertices.iter().zip(found.into_iter().flatten()) {
        x[v as usize] = value;
    }
    x
}

/// The equations of the parts of a job, and what is known of the minimum.
struct System {
    /// The first vertex, element and bend in the lists of the parts.
    first: [u32; 3],
    diagonal: Vec<f32>,
    /// Corners of the elements among the vertices of the job, and what couples those opposite to each.
    elements: Vec<([u32; 3], [f32; 3])>,
    bends: Vec<StiffBend>,
    right: Vec<Rgb>,
    x: Vec<Rgb>,
}

/// A bend among the vertices of a job.
struct StiffBend {
    vertices: [u32; 4],
    weights: [f32; 4],
    stiffness: f32,
}

impl System {
    fn new(parts: &FitMesh, job: Range<usize>, normal: &Normal, stiffness: &[f32], start: &[Rgb]) -> Self {
        let (first, end) = (parts.starts[job.start], parts.starts[job.end]);
        let range = |k: usize| first[k] as usize..end[k] as usize;
        let (vertices, elements) = (&parts.vertices[range(0)], &parts.elements[range(1)]);
        let place = |v: u32| parts.place[v as usize] - first[0];
        let corners = |e: u32| parts.mesh.elements[e as usize].vertices.map(place);
        let stiff = |(bend, &stiffness): (&super::bending::Bend, &f32)| StiffBend {
            vertices: bend.vertices.map(place),
            weights: bend.weights,
            stiffness,
        };
        let bends = match stiffness.get(range(2)) {
            Some(stiffness) => parts.bends[range(2)].iter().zip(stiffness).map(stiff).collect(),
            None => Vec::new(),
        };
        Self {
            first,
            diagonal: vertices.iter().map(|&v| normal.diagonal[v as usize]).collect(),
            elements: elements.iter().map(|&e| (corners(e), normal.coupling[e as usize])).collect(),
            bends,
            right: vertices.iter().map(|&v| normal.right[v as usize]).collect(),
            x: vertices.iter().map(|&v| start[v as usize]).collect(),
        }
    }

    /// Conjugate gradients, preconditioned by the diagonal (Jacobi), for one of the parts: one system for all channels. Each
    /// part has steps and an end of its own: beside the inside of a lamp, a wall would not count.
    fn solve(&mut self, parts: &FitMesh, part: usize, params: &FitParams) {
        let [from, to] = [part, part + 1].map(|p| parts.starts[p]);
        let range = |k: usize| (from[k] - self.first[k]) as usize..(to[k] - self.first[k]) as usize;
        let vertices = range(0);
        let elements = &self.elements[range(1)];
        let bends = self.bends.get(range(2)).unwrap_or_default();
        let (diagonal, right) = (&self.diagonal[vertices.clone()], &self.right[vertices.clone()]);
        let own = |v: u32| v as usize - vertices.start;
        let apply = |x: &[Rgb], out: &mut Vec<Rgb>| {
            out.clear();
            out.extend(x.iter().zip(diagonal).map(|(&x, &d)| x * d));
            for (corners, [bc, ca, ab]) in elements {
                let [a, b, c] = corners.map(own);
                out[a] += x[b] * *ab + x[c] * *ca;
                out[b] += x[c] * *bc + x[a] * *ab;
                out[c] += x[a] * *ca + x[b] * *bc;
            }
            for bend in bends {
                let ([a, b, c, d], [wa, wb, wc, wd]) = (bend.vertices.map(own), bend.weights);
                let force = (x[a] * wa + x[b] * wb + x[c] * wc + x[d] * wd) * bend.stiffness;
                out[a] += force * wa;
                out[b] += force * wb;
                out[c] += force * wc;
                out[d] += force * wd;
            }
        };
        let dot = |a: &[Rgb], b: &[Rgb]| a.iter().zip(b).map(|(a, b)| f64::from(a.dot(*b))).sum::<f64>();
        let mut whole = diagonal.to_vec();
        for bend in bends {
            for (&v, w) in bend.vertices.iter().zip(bend.weights) {
                whole[own(v)] += w * w * bend.stiffness;
            }
        }
        let inverse: Vec<f32> = whole.iter().map(|&d| if d > 0.0 { 1.0 / d } else { 0.0 }).collect();
        let scaled = |r: &[Rgb]| -> Vec<Rgb> { r.iter().zip(&inverse).map(|(&r, &i)| r * i).collect() };

        let x = &mut self.x[vertices.clone()];
        let mut product = Vec::with_capacity(x.len());
        apply(x, &mut product);
        let mut residual: Vec<Rgb> = right.iter().zip(&product).map(|(&r, &p)| r - p).collect();
        let mut direction = scaled(&residual);
        let mut energy = dot(&residual, &direction);
        let goal = dot(right, &scaled(right)) * (params.tolerance * params.tolerance);
        let mut steps = 0;
        // What is not a number is an end, too.
        while energy > goal && steps < params.max_steps {
            steps += 1;
            apply(&direction, &mut product);
            let curvature = dot(&direction, &product);
            if curvature.is_nan() || curvature <= 0.0 {
                break;
            }
            let step = (energy / curvature) as f32;
            for (i, x) in x.iter_mut().enumerate() {
                *x += direction[i] * step;
                residual[i] -= product[i] * step;
            }
            let last = energy;
            energy = residual.iter().zip(&inverse).map(|(&r, &i)| f64::from(r.dot(r * i))).sum();
            let ratio = (energy / last) as f32;
            for (i, direction) in direction.iter_mut().enumerate() {
                *direction = residual[i] * inverse[i] + *direction * ratio;
            }
        }
    }
}
