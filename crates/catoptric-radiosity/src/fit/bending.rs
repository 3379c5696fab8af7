//! How fitted light bends at the edges between elements, and how stiff each edge is: like a thin plate where nothing but
//! noise bends it, loose where light does.
//!
//! A membrane flattens gradients long before it removes noise; what resists bending leaves linear light alone. How much is
//! noise the samples tell: from how far they lie from the fit follows the variance of the fitted light (White 1980), and from
//! that how far noise alone would bend it. Bends beyond that are light, and their mean square is the variance that the
//! smoothing spline of a random field takes as given (Wahba 1990). Keys in docs/references.md: White1980, Wahba1990.

use rayon::prelude::*;

use catoptric_scene::Rgb;
use catoptric_solution::DisplayMesh;

/// An edge between two elements, unfolded: the weighted sum of the light at its ends and at the two corners opposite to it is how
/// far the edge lies from the straight line between these corners. Zero for light that is linear across both elements.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bend {
    /// Ends and opposite corners.
    pub(super) vertices: [u32; 4],
    pub(super) weights: [f32; 4],
}

impl Bend {
    /// How far light bends there.
    pub(super) fn of(&self, light: impl Fn(u32) -> Rgb) -> Rgb {
        self.vertices.iter().zip(self.weights).map(|(&v, w)| light(v) * w).sum()
    }
}

/// Slivers reach beyond their edge by this multiple of its length at most: farther ones tell nothing about light at the edge.
const REACH: f32 = 4.0;

/// All edges between two elements.
pub(super) fn bends(mesh: &DisplayMesh) -> Vec<Bend> {
    let mut sides: Vec<[u32; 3]> = mesh
        .elements
        .iter()
        .flat_map(|element| {
            let v = element.vertices;
            (0..3).map(move |k| {
                let [a, b] = [v[(k + 1) % 3], v[(k + 2) % 3]];
                [a.min(b), a.max(b), v[k]]
            })
        })
        .collect();
    sides.par_sort_unstable();
    sides.chunk_by(|x, y| x[..2] == y[..2]).filter_map(|sides| bend(mesh, sides)).collect()
}

/// The bend of an edge by its sides, if there are two of them: ends and opposite corner of each.
fn bend(mesh: &DisplayMesh, sides: &[[u32; 3]]) -> Option<Bend> {
    let &[[a, b, c], [.., d]] = sides else { return None };
    let at = |v: u32| mesh.vertices[v as usize].position;
    let along = at(b) - at(a);
    let squared = along.length_squared();
    // Height of a corner above the edge, and its foot: 0 at a, 1 at b.
    let above = |v: u32| {
        let to = at(v) - at(a);
        let foot = to.dot(along) / squared;
        ((to - along * foot).length(), foot)
    };
    let ((high, foot), (other_high, other_foot)) = (above(c), above(d));
    let [w, other_w] = [other_high, high].map(|h| h / (high + other_high));
    let at_b = w * foot + other_w * other_foot;
    // What is not a number is no bend, either.
    let reaches = foot.abs().max(other_foot.abs()) < REACH && w.is_finite();
    reaches.then_some(Bend { vertices: [a, b, c, d], weights: [at_b - 1.0, -at_b, w, other_w] })
}

/// Noise bends light farther than independent noise at the vertices would: fits overshoot from one vertex to the next. On
/// oscillations the mass matrix of hat functions is half of its diagonal.
const OVERSHOOT: f32 = 2.0;

/// A bend counts for itself with this share beside the mean of those around it: edges of shadows stay sharp.
const OWN_SHARE: f32 = 0.5;

/// Light bends at least as far as this share of the variance that noise causes: estimates of few samples are not that sure.
const LEAST: f32 = 0.05;

/// Stiffness of each of `bends`, where `light` was fitted without. Per vertex: `weights` is the sum of the squared
/// weights of samples (the diagonal of the normal equations), `scatter` that of these weights times residuals, squared.
pub(super) fn stiffness(bends: &[Bend], light: &[Rgb], weights: &[f32], scatter: &[f32]) -> Vec<f32> {
    let variance: Vec<f32> =
        scatter.iter().zip(weights).map(|(s, w)| if *w > 0.0 { s / (w * w) } else { 0.0 }).collect();
    // Squared: how far light bends, and how far noise alone would bend it.
    let squares: Vec<[f32; 2]> = bends
        .iter()
        .map(|bend| {
            let noise = bend.vertices.iter().zip(bend.weights).map(|(&v, w)| variance[v as usize] * w * w);
            [bend.of(|v| light[v as usize]).length_squared(), OVERSHOOT * noise.sum::<f32>()]
        })
        .collect();
    let mut around = vec![[0.0_f32; 2]; light.len()];
    for (bend, squares) in bends.iter().zip(&squares) {
        for &v in &bend.vertices {
            (0..2).for_each(|k| around[v as usize][k] += squares[k]);
        }
    }
    bends
        .iter()
        .zip(&squares)
        .map(|(bend, &[found, noise])| {
            let [mut all_found, mut all_noise, mut weight] = [0.0_f32; 3];
            for &v in &bend.vertices {
                all_found += around[v as usize][0];
                all_noise += around[v as usize][1];
                weight += 0.25 * variance[v as usize] * weights[v as usize];
            }
            let ratio = (all_found / all_noise).max(OWN_SHARE * found / noise);
            let stiffness = weight / (noise * (ratio - 1.0).max(LEAST));
            // Without noise there is nothing to smooth.
            if stiffness.is_finite() { stiffness } else { 0.0 }
        })
        .collect()
}
