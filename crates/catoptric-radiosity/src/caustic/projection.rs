//! Irradiance at vertices from deposits.
//!
//! Vertex values are the L² projection of the deposits onto piecewise linear functions (Kavan, Bargteil & Sloan 2011): the
//! moments b_v = Σ power × hat_v(x), first with the lumped mass matrix (area around the vertex / 3), which keeps the power
//! exactly, then moved towards the consistent one, which undoes the smoothing of lumping and keeps it as well.

use catoptric_scene::Rgb;

use crate::caustic::deposit::{Deposits, Part, Within};
use crate::caustic::smooth::surprise;
use crate::draft::{Closed, Draft, Leaf};

/// Moments of one leaf: at its corners, and at the vertex that halves one of its edges.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Moments {
    corners: [Rgb; 3],
    middle: Rgb,
    /// Σ (power × hat)² at the corners and the middle, channels added.
    pub(super) squares: [f32; 4],
}

impl Moments {
    /// Of the deposits on `part`, whose edge `halved` is halved.
    pub(super) fn of(deposits: &Deposits, part: Part, halved: Option<usize>) -> Self {
        let mut sums = Self::default();
        let within = Within::of(part);
        for index in deposits.range(part) {
            let mut weights = within.weights(deposits.weights(index));
            let power = deposits.power(index);
            if let Some(k) = halved {
                // The half that holds the point: its corner on the edge gives to the middle.
                let (a, b) = (k, (k + 1) % 3);
                let given = 2.0 * weights[a].min(weights[b]);
                weights[a] -= 0.5 * given;
                weights[b] -= 0.5 * given;
                sums.middle += power * given;
                sums.squares[3] += (strength(power) * given).powi(2);
            }
            for corner in 0..3 {
                sums.corners[corner] += power * weights[corner];
                sums.squares[corner] += (strength(power) * weights[corner]).powi(2);
            }
        }
        sums
    }
}

/// Vertex values for the moments.
pub(super) struct Projection {
    pub(super) values: Vec<Rgb>,
    /// Area around each vertex / 3.
    pub(super) mass: Vec<f32>,
    /// Variance of the lumped values for independent rays, channels added.
    pub(super) variance: Vec<f32>,
    /// The mesh as it is shown, where deposits have to do with it.
    pub(super) triangles: Vec<([u32; 3], f32)>,
}

impl Projection {
    /// `leaves`: with the edge that is halved and the vertex there, and their moments.
    pub(super) fn new<'a>(
        draft: &Draft,
        leaves: impl Iterator<Item = (&'a Leaf, Option<(usize, u32)>, &'a Moments)>,
        sharpening: u32,
    ) -> Self {
        let count = draft.vertices.len();
        let mut right = vec![Rgb::ZERO; count];
        let mut mass = vec![0.0_f32; count];
        let mut variance = vec![0.0_f32; count];
        let mut triangles: Vec<([u32; 3], f32)> = Vec::with_capacity(2 * leaves.size_hint().0);
        for (leaf, halved, moments) in leaves {
            for (corner, &v) in leaf.vertices.iter().enumerate() {
                right[v as usize] += moments.corners[corner];
                variance[v as usize] += moments.squares[corner];
            }
            let mut whole = draft.area(leaf);
            if let Some((_, middle)) = halved {
                right[middle as usize] += moments.middle;
                variance[middle as usize] += moments.squares[3];
                whole *= 0.5;
            }
            for &vertices in Closed::of(leaf.vertices, halved).triangles() {
                for v in vertices {
                    mass[v as usize] += whole / 3.0;
                }
                triangles.push((vertices, whole));
            }
        }
        let lumped: Vec<Rgb> =
            right.iter().zip(&mass).map(|(&b, &m)| if m > 0.0 { b / m } else { Rgb::ZERO }).collect();
        for (variance, &m) in variance.iter_mut().zip(&mass) {
            *variance = if m > 0.0 { *variance / (m * m) } else { 0.0 };
        }
        let mut values = lumped.clone();
        for _ in 0..sharpening {
            values = sharpened(&triangles, &mass, &lumped, &variance, &values);
        }
        Self { values, mass, variance, triangles }
    }
}

/// One step from the lumped values towards those that the consistent mass matrix of a triangle, area/12·(1 + δ), gives:
/// x ← L⁻¹(b − (M − L)x) with b = L·lumped. As the rows of L − M are zero in sum, the step moves the power
/// area/12·(xᵢ − xⱼ) from j to i along every edge.
///
/// Beside a bright edge of light a vertex would lose more than it has: what leaves it is scaled to that, so that no light
/// is negative and the power stays (flux-corrected transport, Zalesak 1979, with zero as the only bound). Differences that noise explains are not
/// sharpened: that would nearly double it.
fn sharpened(
    triangles: &[([u32; 3], f32)],
    mass: &[f32],
    lumped: &[Rgb],
    variance: &[f32],
    values: &[Rgb],
) -> Vec<Rgb> {
    let moved = |visit: &mut dyn FnMut(usize, usize, Rgb)| {
        for ([a, b, c], area) in triangles {
            for (i, j) in [(*a, *b), (*b, *c), (*c, *a)] {
                let (i, j) = (i as usize, j as usize);
                let difference = strength(lumped[i]) - strength(lumped[j]);
                let told = 1.0 - 1.0 / surprise(difference, variance[i] + variance[j]);
                visit(i, j, (values[i] - values[j]) * (told * area / 12.0));
            }
        }
    };
    let mut lost = vec![Rgb::ZERO; values.len()];
    moved(&mut |i, j, power| {
        lost[i] += (-power).max(Rgb::ZERO);
        lost[j] += power.max(Rgb::ZERO);
    });
    let mut power: Vec<Rgb> = lumped.iter().zip(mass).map(|(&x, &m)| x * m).collect();
    // The least positive number keeps 0 / 0 away where nothing is lost.
    let share = |(&has, &lost): (&Rgb, &Rgb)| (has / lost.max(Rgb::splat(f32::MIN_POSITIVE))).min(Rgb::ONE);
    let kept: Vec<Rgb> = power.iter().zip(&lost).map(share).collect();
    moved(&mut |i, j, flow| {
        let flow = flow.max(Rgb::ZERO) * kept[j] + flow.min(Rgb::ZERO) * kept[i];
        power[i] += flow;
        power[j] -= flow;
    });
    power.iter().zip(mass).map(|(&p, &m)| if m > 0.0 { (p / m).max(Rgb::ZERO) } else { Rgb::ZERO }).collect()
}

/// Of all channels together.
pub(super) fn strength(light: Rgb) -> f32 {
    light.element_sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A bright vertex in a dark strip: the consistent mass matrix alone would leave negative light beside it.
    #[test]
    fn sharpening_keeps_the_power_and_takes_from_nobody_what_he_does_not_have() {
        let triangles: Vec<([u32; 3], f32)> = (0..6).map(|k| ([k, k + 1, k + 2], 0.5)).collect();
        let mut mass = vec![0.0; 8];
        for (vertices, area) in &triangles {
            for &v in vertices {
                mass[v as usize] += area / 3.0;
            }
        }
        let mut lumped = vec![Rgb::splat(0.01); 8];
        lumped[4] = Rgb::new(1.0, 2.0, 0.01);
        let power = |x: &[Rgb]| -> Rgb { x.iter().zip(&mass).map(|(&x, &m)| x * m).sum() };
        let mut values = lumped.clone();
        for _ in 0..4 {
            values = sharpened(&triangles, &mass, &lumped, &[0.0; 8], &values);
            assert!(values.iter().all(|v| v.min_element() >= 0.0), "{values:?}");
            assert!((power(&values) - power(&lumped)).abs().max_element() < 1e-6);
        }
        assert!(values[4].x > 1.01 && (values[4].z - 0.01).abs() < 1e-6);

        // Noise of a deviation of a twentieth, light where it is bright and dark where it is not.
        let noise: Vec<Rgb> = (0..8).map(|v| Rgb::splat([0.95, 1.05][v % 2])).collect();
        let range = |variance: f32| {
            let values = sharpened(&triangles, &mass, &noise, &[variance; 8], &noise);
            let luminances = values.iter().map(|v| v.x);
            luminances.clone().fold(0.0, f32::max) - luminances.fold(f32::MAX, f32::min)
        };
        // The matrix alone adds three quarters to what alternates. Squared differences are half of those that count as noise (of channels
        // that are added, the variance is nine times as large): a fifth of that is left.
        let (sharp, noisy) = (range(0.0), range(9.0 * 0.05 * 0.05));
        assert!((sharp - 0.175).abs() < 1e-5 && (noisy - 0.115).abs() < 1e-5, "{sharp} {noisy}");
    }
}
