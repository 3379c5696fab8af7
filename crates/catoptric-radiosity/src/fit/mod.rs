//! Vertex values by least squares (Kavan, Bargteil & Sloan 2011): the piecewise-linear irradiance that is nearest to
//! samples taken anywhere inside the elements, instead of one that touches them at the vertices.
//!
//! Minimises Σ_s a_s (f(x_s) − h_s)² + λ Σ_v m_v (f_v − p_v)², a_s the area that a sample stands for, p_v the point
//! sample at the vertex and m_v a third of the area around it. Hat functions sum to one, so without the prior the fit
//! keeps the integral: Σ a_s (f(x_s) − h_s) = 0. The prior holds vertices that few samples reach. A membrane
//! ℓ² ∫|∇f|² averages over the length ℓ where elements are finer than that; it keeps the integral, too. A strong prior does not:
//! point samples at vertices see the dark of corners. What it takes from the samples is given back, spread so wide that no noise
//! returns with it: Σ a_s (h_s − f(x_s)) is fitted in turn, with a wide membrane. Noise bends the fit from element to element;
//! it is fitted again with edges as stiff as the noise around them allows (see `bending`), which keeps the integral as well.

mod bending;
mod lift;
mod parts;
mod system;

use catoptric_scene::Rgb;
use catoptric_solution::DisplayMesh;

use bending::stiffness;
use lift::lift;
pub use parts::FitMesh;
use system::minimum;

/// A sample inside an element.
#[derive(Clone, Copy, Debug)]
pub struct FitSample {
    /// The element.
    pub element: u32,
    /// Barycentric weights of its corners.
    pub weights: [f32; 3],
    /// Area that it stands for, m².
    pub area: f32,
}

/// Parameters of the fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FitParams {
    /// λ: weight of the point samples at the vertices.
    pub prior: f32,
    /// ℓ: light is averaged over this length where the mesh is finer, metres.
    pub smoothing: f32,
    /// Stiffness of edges, as a share of what the noise around them calls for; 0: none. Each vertex has three edges which tell the
    /// same: a third is due.
    pub bending: f32,
    /// What the prior takes from the samples is given back over this length, metres; 0: it is not.
    pub balance: f32,
    /// Steps of the conjugate gradients at most.
    pub max_steps: usize,
    /// Residual relative to the right-hand side at which they stop.
    pub tolerance: f64,
}

impl Default for FitParams {
    fn default() -> Self {
        Self { prior: 0.05, smoothing: 0.0, bending: 0.25, balance: 0.0, max_steps: 60, tolerance: 1e-4 }
    }
}

/// The square of the membrane's length is at most this multiple of the area of what hangs together: light is as good as the same all over
/// that, and a wider one would only drown the prior of a crumb in its rounding.
const WIDEST: f32 = 25.0;

/// What holds the balance where there are no samples, and the residual at which its fit stops: it is small.
const BALANCE_PRIOR: f32 = 0.01;
const BALANCE_TOLERANCE: f64 = 1e-2;

/// A quantity that is fitted.
#[derive(Clone, Copy, Debug)]
pub struct FitTerm<'a> {
    /// Per sample.
    pub values: &'a [Rgb],
    /// Per vertex: what the fit starts from and is held by.
    pub prior: &'a [Rgb],
}

/// Fits each term at `samples`. `trust` scales the prior per vertex: near zero where nobody looks, so that the membrane carries
/// the light of the neighbours over; above one where a vertex has seen more per area than the samples. `noise` is the variance of
/// the prior per vertex, channels added (empty: not known). Never negative.
///
/// Edges are as stiff as the noise of the *sum* of the terms allows: noise that cancels between them, as in a furnace, still does.
pub fn fit(
    parts: &FitMesh,
    samples: &[FitSample],
    terms: &[FitTerm],
    trust: &[f32],
    noise: &[f32],
    params: &FitParams,
) -> Vec<Vec<Rgb>> {
    let noise = pooled(parts.mesh, noise);
    let shared = Problem { parts, samples, term: FitTerm { values: &[], prior: &[] }, trust, noise: &noise };
    let loose: Vec<Loose> = terms.iter().map(|&term| Problem { term, ..shared }.loose(params)).collect();
    let stiffness = match loose.first() {
        Some(first) if params.bending > 0.0 => {
            let values = sum(terms.iter().map(|t| t.values));
            let prior = sum(terms.iter().map(|t| t.prior));
            let light = sum(loose.iter().map(|l| l.x.as_slice()));
            let term = FitTerm { values: &values, prior: &prior };
            Problem { term, ..shared }.stiffness(&first.normal, &light, params)
        }
        _ => Vec::new(),
    };
    let fitted = |(&term, loose): (&FitTerm, Loose)| {
        let mut x = loose.stiffened(parts, &stiffness, params);
        if params.balance > 0.0 {
            let balance = Problem { term, ..shared }.balance(&x, params);
            x.iter_mut().zip(balance).for_each(|(x, more)| *x += more);
        }
        lift(parts.mesh, &mut x);
        x
    };
    terms.iter().zip(loose).map(fitted).collect()
}

/// Sum of lists of one length.
fn sum<'a>(mut lists: impl Iterator<Item = &'a [Rgb]>) -> Vec<Rgb> {
    let mut sum = lists.next().map_or_else(Vec::new, <[Rgb]>::to_vec);
    for list in lists {
        sum.iter_mut().zip(list).for_each(|(sum, value)| *sum += *value);
    }
    sum
}

/// What is fitted.
#[derive(Clone, Copy)]
struct Problem<'a> {
    parts: &'a FitMesh<'a>,
    samples: &'a [FitSample],
    term: FitTerm<'a>,
    /// Per vertex.
    trust: &'a [f32],
    /// Variance of the prior, per vertex; empty: not known.
    noise: &'a [f32],
}

/// Variance, channels added, of a mean over stratified samples whose halves differ by so much, as well as one difference can tell.
///
/// A quarter of the square is that of independent samples. Of n strata those that an edge crosses, √n, are noise: V(n) ∝ n^-3/2.
/// With V(n) = V(n/2) (1 + r)/2 for halves of correlation r, the quarter is V(n/2) (1 − r)/2 = 1.8 V(n): half of it is taken.
pub(crate) fn variance_of_halves(difference: Rgb) -> f32 {
    0.125 * difference.length_squared()
}

/// Times that variances are pooled with those of neighbours: each is one difference.
const POOLING: usize = 2;

/// Values per vertex as means over the elements around.
pub(crate) fn pooled(mesh: &DisplayMesh, values: &[f32]) -> Vec<f32> {
    let mut pooled = values.to_vec();
    for _ in 0..if values.is_empty() { 0 } else { POOLING } {
        let mut sums = vec![(0.0_f32, 0.0_f32); values.len()];
        for element in &mesh.elements {
            let mean = element.vertices.iter().map(|&v| pooled[v as usize]).sum::<f32>() / 3.0;
            for &v in &element.vertices {
                sums[v as usize] = (sums[v as usize].0 + mean, sums[v as usize].1 + 1.0);
            }
        }
        for (pooled, (sum, count)) in pooled.iter_mut().zip(sums) {
            *pooled = if count > 0.0 { sum / count } else { *pooled };
        }
    }
    pooled
}

/// Leverage of a sample beyond which its residual tells no more about noise.
const MAX_LEVERAGE: f32 = 0.8;

/// The minimum without stiffness, which may be below zero, and its equations.
struct Loose {
    normal: Normal,
    x: Vec<Rgb>,
}

impl Loose {
    /// The minimum with stiff edges.
    fn stiffened(self, parts: &FitMesh, stiffness: &[f32], params: &FitParams) -> Vec<Rgb> {
        if stiffness.is_empty() { self.x } else { minimum(parts, &self.normal, stiffness, &self.x, params) }
    }
}

impl Problem<'_> {
    fn loose(&self, params: &FitParams) -> Loose {
        let normal = Normal::new(self, params);
        let x = minimum(self.parts, &normal, &[], self.term.prior, params);
        Loose { normal, x }
    }

    /// Stiffness of the edges, where `light` is the minimum without.
    fn stiffness(&self, normal: &Normal, light: &[Rgb], params: &FitParams) -> Vec<f32> {
        let scatter = self.scatter(normal, light);
        let mut stiffness = stiffness(&self.parts.bends, light, &normal.diagonal, &scatter);
        stiffness.iter_mut().for_each(|s| *s *= params.bending);
        stiffness
    }

    /// What the prior has taken from the samples in `x`, spread widely.
    fn balance(&self, x: &[Rgb], params: &FitParams) -> Vec<Rgb> {
        let left: Vec<Rgb> =
            self.samples.iter().zip(self.term.values).map(|(s, &value)| value - self.at(s, x)).collect();
        let wide = FitParams {
            prior: BALANCE_PRIOR,
            smoothing: params.balance,
            tolerance: BALANCE_TOLERANCE,
            ..*params
        };
        let nothing = vec![Rgb::ZERO; x.len()];
        let term = FitTerm { values: &left, prior: &nothing };
        Problem { term, ..*self }.loose(&wide).x
    }

    /// Light `x` at the place of a sample.
    fn at(&self, s: &FitSample, x: &[Rgb]) -> Rgb {
        let corners = self.parts.mesh.elements[s.element as usize].vertices;
        corners.iter().zip(s.weights).map(|(&v, w)| x[v as usize] * w).sum()
    }

    /// Per vertex: the sum of squares of residuals, freed of what the fit follows each sample, times the weight of the sample at
    /// the vertex.
    fn scatter(&self, normal: &Normal, x: &[Rgb]) -> Vec<f32> {
        let own = |weight: f32, v: usize| weight / normal.diagonal[v].max(f32::MIN_POSITIVE);
        // What decides alone has no residual: there the prior's noise tells, if it is known.
        let squared = |residual: Rgb, leverage: f32, told: Option<f32>| match told {
            Some(told) if leverage > MAX_LEVERAGE => told,
            _ => residual.length_squared() / (1.0 - leverage.min(MAX_LEVERAGE)),
        };
        let of_prior = |(v, &mass): (usize, &f32)| {
            let told = self.noise.get(v).copied();
            mass * mass * squared(self.term.prior[v] - x[v], own(mass, v), told)
        };
        let mut scatter: Vec<f32> = normal.masses.iter().enumerate().map(of_prior).collect();
        for (s, &value) in self.samples.iter().zip(self.term.values) {
            let corners = self.parts.mesh.elements[s.element as usize].vertices;
            let weights = corners.iter().zip(s.weights).map(|(&v, w)| (v as usize, w));
            let leverage: f32 = weights.clone().map(|(v, w)| own(w * w * s.area, v)).sum();
            let told = weights.clone().map(|(v, w)| self.noise.get(v).map(|noise| w * noise)).sum();
            let squared = squared(value - self.at(s, x), leverage, told);
            weights.for_each(|(v, w)| scatter[v] += (w * s.area) * (w * s.area) * squared);
        }
        scatter
    }
}

/// The normal equations.
struct Normal {
    /// Per vertex.
    diagonal: Vec<f32>,
    /// Per element: what couples the corners opposite to each corner.
    coupling: Vec<[f32; 3]>,
    /// Right-hand side, per vertex.
    right: Vec<Rgb>,
    /// What the prior has of the diagonal, per vertex.
    masses: Vec<f32>,
}

impl Normal {
    fn new(problem: &Problem, params: &FitParams) -> Self {
        let &Problem { parts, samples, term: FitTerm { values, prior }, trust, .. } = problem;
        let mesh = parts.mesh;
        let mut masses = vec![0.0_f32; mesh.vertices.len()];
        for element in 0..mesh.elements.len() as u32 {
            let third = mesh.area(element) / 3.0;
            for v in mesh.elements[element as usize].vertices {
                masses[v as usize] += third * params.prior * trust[v as usize];
            }
        }
        let mut diagonal = masses.clone();
        let mut right: Vec<Rgb> = prior.iter().zip(&masses).map(|(&p, &m)| p * m).collect();
        let mut coupling = vec![[0.0_f32; 3]; mesh.elements.len()];
        for (s, &value) in samples.iter().zip(values) {
            for (k, &v) in mesh.elements[s.element as usize].vertices.iter().enumerate() {
                let w = s.weights[k] * s.area;
                right[v as usize] += value * w;
                diagonal[v as usize] += w * s.weights[k];
                coupling[s.element as usize][(k + 2) % 3] += w * s.weights[(k + 1) % 3];
            }
        }
        if params.smoothing > 0.0 {
            for elements in parts.elements_of_parts() {
                let area: f32 = elements.iter().map(|&e| mesh.area(e)).sum();
                let length = params.smoothing.min((WIDEST * area).sqrt());
                for &e in elements {
                    let (element, coupling) = (&mesh.elements[e as usize], &mut coupling[e as usize]);
                    for (k, w) in cotangents(mesh, e, length).into_iter().enumerate() {
                        coupling[k] -= w;
                        diagonal[element.vertices[(k + 1) % 3] as usize] += w;
                        diagonal[element.vertices[(k + 2) % 3] as usize] += w;
                    }
                }
            }
        }
        Self { diagonal, coupling, right, masses }
    }
}

/// ℓ² times the edge weights of the element's stiffness matrix: half the cotangent of the opposite angle (Pinkall &
/// Polthier 1993), not below zero.
fn cotangents(mesh: &DisplayMesh, element: u32, length: f32) -> [f32; 3] {
    let p = mesh.elements[element as usize].vertices.map(|v| mesh.vertices[v as usize].position);
    std::array::from_fn(|k| {
        let (a, b) = (p[(k + 1) % 3] - p[k], p[(k + 2) % 3] - p[k]);
        let sine = a.cross(b).length();
        let cotangent = if sine > 0.0 { a.dot(b) / sine } else { 0.0 };
        0.5 * cotangent.clamp(0.0, 20.0) * length * length
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use catoptric_scene::{Side, TriangleId};
    use catoptric_solution::{DisplayVertex, Element, Face, FaceId};
    use catoptric_trace::sequence::{Key, Purpose};
    use glam::Vec3;

    /// The fit of one term.
    fn fit(
        mesh: &DisplayMesh,
        samples: &[FitSample],
        values: &[Rgb],
        prior: &[Rgb],
        noise: &[f32],
        params: &FitParams,
    ) -> Vec<Rgb> {
        let trust = vec![1.0; prior.len()];
        super::fit(&FitMesh::new(mesh), samples, &[FitTerm { values, prior }], &trust, noise, params)
            .remove(0)
    }

    /// Squares of edge one, each cut into two triangles.
    fn grid(columns: u32, rows: u32) -> DisplayMesh {
        let vertex = |x: f32, y: f32| DisplayVertex {
            position: Vec3::new(x, y, 0.0),
            normal: Vec3::Z,
            triangle: TriangleId(0),
            side: Side::Front,
        };
        let column = |i: u32| (0..=rows).map(move |k| vertex(i as f32, k as f32));
        let vertices = (0..=columns).flat_map(column).collect();
        let square = |i: u32, k: u32| {
            let (a, b) = (i * (rows + 1) + k, (i + 1) * (rows + 1) + k);
            [Element { vertices: [a, b, b + 1] }, Element { vertices: [a, b + 1, a + 1] }]
        };
        let elements: Vec<Element> =
            (0..columns).flat_map(|i| (0..rows).flat_map(move |k| square(i, k))).collect();
        let count = elements.len() as u32;
        let face = Face { elements: 0..count, origin: Vec3::ZERO, axes: [Vec3::X, Vec3::Y] };
        DisplayMesh::new(vertices, elements, vec![face], [vec![FaceId(0)], vec![FaceId::NONE]])
    }

    pub(super) fn strip(n: u32) -> DisplayMesh {
        grid(n, 1)
    }

    fn samples(mesh: &DisplayMesh) -> Vec<FitSample> {
        let at = [[0.6, 0.2, 0.2], [0.2, 0.6, 0.2], [0.2, 0.2, 0.6]];
        (0..mesh.elements.len() as u32)
            .flat_map(|element| {
                at.map(|weights| FitSample { element, weights, area: mesh.area(element) / 3.0 })
            })
            .collect()
    }

    fn position(mesh: &DisplayMesh, s: &FitSample) -> Vec3 {
        mesh.elements[s.element as usize]
            .vertices
            .iter()
            .zip(s.weights)
            .map(|(&v, w)| mesh.vertices[v as usize].position * w)
            .sum()
    }

    #[test]
    fn linear_light_is_reproduced() {
        let mesh = strip(8);
        let samples = samples(&mesh);
        let light = |p: Vec3| Rgb::new(1.0 + p.x, 2.0 + p.y, 3.0);
        let values: Vec<Rgb> = samples.iter().map(|s| light(position(&mesh, s))).collect();
        let prior = vec![Rgb::ONE; mesh.vertices.len()];
        let params = FitParams { prior: 1e-6, max_steps: 400, tolerance: 1e-7, ..FitParams::default() };
        for (v, value) in fit(&mesh, &samples, &values, &prior, &[], &params).iter().enumerate() {
            assert!((*value - light(mesh.vertices[v].position)).length() < 1e-3, "vertex {v}: {value}");
        }
    }

    /// A strong prior that is a tenth too dark on one half of a strip takes light there; the balance gives it back there, and
    /// leaves the other half alone.
    #[test]
    fn what_the_prior_takes_is_given_back_where_it_was() {
        let mesh = strip(40);
        let samples = samples(&mesh);
        let values = vec![Rgb::ONE; samples.len()];
        let is_dark = |v: usize| mesh.vertices[v].position.x < 20.0;
        let prior: Vec<Rgb> =
            (0..mesh.vertices.len()).map(|v| Rgb::splat(if is_dark(v) { 0.9 } else { 1.0 })).collect();
        let held = FitParams { prior: 0.5, ..FitParams::default() };
        let mean = |params: &FitParams, dark: bool| {
            let fitted = fit(&mesh, &samples, &values, &prior, &[], params);
            // Away from the ends and from where the halves meet.
            let far = |v: &usize| (mesh.vertices[*v].position.x - 20.0).abs() > 4.0 && is_dark(*v) == dark;
            let values: Vec<f32> = (0..fitted.len()).filter(far).map(|v| fitted[v].x).collect();
            values.iter().sum::<f32>() / values.len() as f32
        };
        // The mass of the prior is half of that of the samples: a third of what it lacks is taken.
        assert!((mean(&held, true) - (1.0 - 0.1 / 3.0)).abs() < 1e-3, "{}", mean(&held, true));
        let balanced = FitParams { balance: 2.0, ..held };
        // The prior of the balance, a hundredth, keeps as much of it.
        assert!((mean(&balanced, true) - 1.0).abs() < 0.02 * 0.1, "{}", mean(&balanced, true));
        assert!((mean(&balanced, false) - 1.0).abs() < 0.02 * 0.1, "{}", mean(&balanced, false));
    }

    /// A part a million times as bright neither ends nor disturbs the fit of another.
    #[test]
    fn parts_that_do_not_hang_together_are_fitted_apart() {
        let (one, n) = (strip(8), 8);
        let mut mesh = one.clone();
        let count = one.vertices.len() as u32;
        mesh.vertices.extend(one.vertices.iter().copied());
        let shifted = |e: &Element| Element { vertices: e.vertices.map(|v| v + count) };
        mesh.elements.extend(one.elements.iter().map(shifted).collect::<Vec<_>>());
        let both = samples(&mesh);
        let light = |p: Vec3| Rgb::splat(1.0 + (p.x - 0.5 * n as f32).powi(2));
        let of = |mesh: &DisplayMesh, s: &FitSample| {
            light(position(mesh, s)) * if s.element < 2 * n { 1.0 } else { 1e6 }
        };
        let params = FitParams::default();
        let fitted = |mesh: &DisplayMesh, samples: &[FitSample]| {
            let values: Vec<Rgb> = samples.iter().map(|s| of(mesh, s)).collect();
            let prior = vec![Rgb::ONE; mesh.vertices.len()];
            fit(mesh, samples, &values, &prior, &[], &params)
        };
        let alone = fitted(&one, &samples(&one));
        assert_eq!(fitted(&mesh, &both)[..count as usize], alone);
    }

    /// A sample that is no number leaves its part of the mesh as the vertices found it.
    #[test]
    fn what_is_not_a_number_does_not_spread() {
        let mesh = strip(4);
        let samples = samples(&mesh);
        let mut values = vec![Rgb::ONE; samples.len()];
        values[3] = Rgb::splat(f32::NAN);
        let prior = vec![Rgb::splat(2.0); mesh.vertices.len()];
        let params = FitParams { balance: 1.0, ..FitParams::default() };
        assert_eq!(fit(&mesh, &samples, &values, &prior, &[], &params), prior);
    }

    /// A crumb half a metre long and a picometre high, as authors' meshes have them, keeps what is known of it.
    #[test]
    fn a_wide_membrane_does_not_drown_the_light_of_a_crumb() {
        let vertex = |position: Vec3| DisplayVertex {
            position,
            normal: Vec3::Z,
            triangle: TriangleId(0),
            side: Side::Front,
        };
        let corners = [Vec3::new(0.5, 0.0, 0.0), Vec3::new(0.0, 1e-12, 0.0), Vec3::new(0.500003, 0.0, 0.0)];
        let face = Face { elements: 0..1, origin: Vec3::ZERO, axes: [Vec3::X, Vec3::Y] };
        let elements = vec![Element { vertices: [0, 1, 2] }];
        let surfaces = [vec![FaceId(0)], vec![FaceId::NONE]];
        let mesh = DisplayMesh::new(corners.map(vertex).to_vec(), elements, vec![face], surfaces);
        let prior = [1.0, 1.3, 1.1].map(Rgb::splat);
        let params = FitParams { smoothing: 0.1, balance: 6.0, ..FitParams::default() };
        for value in fit(&mesh, &[], &[], &prior, &[], &params) {
            // Rounding of the membrane against the prior: 2⁻²⁴ · 10 · WIDEST / (λ / 3) and as much for what is given back.
            assert!((1.0 - 1e-2..1.3 + 1e-2).contains(&value.x), "{value}");
        }
    }

    /// Root mean square of what a fit misses of `light`, where samples and prior are off by noise of deviation one, at
    /// the vertices for which `counts`.
    fn missed(bending: f32, light: impl Fn(Vec3) -> f32, counts: impl Fn(Vec3) -> bool) -> f32 {
        let mesh = grid(24, 24);
        let samples = samples(&mesh);
        let noise = |entity: u64| {
            let key = Key::new(7, Purpose::Test, entity);
            // Uniform of variance one.
            (key.uniform(0) - 0.5) * 12.0_f32.sqrt()
        };
        let noisy = |(index, p): (usize, Vec3)| Rgb::splat(light(p) + noise(index as u64));
        let values: Vec<Rgb> = samples.iter().map(|s| position(&mesh, s)).enumerate().map(noisy).collect();
        let at = |v: usize| mesh.vertices[v].position;
        let prior: Vec<Rgb> = (0..mesh.vertices.len()).map(|v| noisy((1_000_000 + v, at(v)))).collect();
        let params = FitParams { bending, ..FitParams::default() };
        let fitted = fit(&mesh, &samples, &values, &prior, &[], &params);
        let squares: Vec<f32> = (0..fitted.len())
            .filter(|&v| counts(at(v)))
            .map(|v| (fitted[v].x - light(at(v))).powi(2))
            .collect();
        (squares.iter().sum::<f32>() / squares.len() as f32).sqrt()
    }

    /// Six samples a vertex leave .6 of their noise there, as hats overshoot; stiff edges leave less than half of that, and no less of
    /// a gradient than of even light.
    #[test]
    fn noise_is_smoothed_and_gradients_are_not() {
        for slope in [0.0, 5.0] {
            let light = |p: Vec3| 100.0 + slope * p.x;
            let (loose, stiff) = (missed(0.0, light, |_| true), missed(0.25, light, |_| true));
            assert!((0.4..0.8).contains(&loose), "{loose}");
            assert!(stiff < 0.5 * loose, "slope {slope}: {stiff} instead of {loose}");
        }
    }

    /// On fine meshes there are no samples inside: the vertices alone decide, and are smoothed if their noise is known.
    #[test]
    fn vertices_alone_are_smoothed_by_the_noise_that_they_are_said_to_have() {
        let mesh = grid(24, 24);
        let count = mesh.vertices.len();
        let light = |v: usize| 100.0 + 5.0 * mesh.vertices[v].position.x;
        let noise = |v: usize| (Key::new(7, Purpose::Test, v as u64).uniform(0) - 0.5) * 12.0_f32.sqrt();
        let prior: Vec<Rgb> = (0..count).map(|v| Rgb::splat(light(v) + noise(v))).collect();
        let fitted = |told: &[f32]| fit(&mesh, &[], &[], &prior, told, &FitParams::default());
        assert_eq!(fitted(&[]), prior);
        // Three channels of variance one.
        let squares = |(v, x): (usize, &Rgb)| (x.x - light(v)).powi(2);
        let missed = fitted(&vec![3.0; count]).iter().enumerate().map(squares).sum::<f32>() / count as f32;
        assert!(missed < 0.25, "{missed} of 1");
    }

    /// Light that comes to one of three terms by chance, the same in all: its sum stays what it is. Each smoothed by its own
    /// noise, it would not.
    #[test]
    fn noise_that_cancels_between_terms_still_does() {
        let mesh = grid(24, 24);
        let samples = samples(&mesh);
        // So much that no fit is below zero, which would be lifted.
        let part = |place: u64, term: u64| {
            let key = Key::new(7, Purpose::Test, place);
            let [a, b] = [0, 1].map(|k| 2.0 + key.uniform(k));
            Rgb::splat([a, b, 9.0 - a - b][term as usize])
        };
        let of = |term: u64| -> [Vec<Rgb>; 2] {
            let values = (0..samples.len() as u64).map(|s| part(s, term)).collect();
            [values, (0..mesh.vertices.len() as u64).map(|v| part(1_000_000 + v, term)).collect()]
        };
        let found = [0, 1, 2].map(of);
        let terms = found.each_ref().map(|[values, prior]| FitTerm { values, prior });
        let params = FitParams { max_steps: 400, tolerance: 1e-6, ..FitParams::default() };
        let trust = vec![1.0; mesh.vertices.len()];
        let fitted = super::fit(&FitMesh::new(&mesh), &samples, &terms, &trust, &[], &params);
        for v in 0..mesh.vertices.len() {
            let sum: Rgb = fitted.iter().map(|term| term[v]).sum();
            // Each is off by about a hundred times where its conjugate gradients end.
            assert!((sum - Rgb::splat(9.0)).abs().max_element() < 1e-3, "{sum}");
        }
    }

    /// Beside a shadow's edge twenty deviations high the fit is as far off as it was: what is smoothed away of the noise outweighs
    /// what is taken from the edge.
    #[test]
    fn edges_of_shadows_stay_where_they_are() {
        let light = |p: Vec3| if p.x < 11.5 { 100.0 } else { 120.0 };
        let beside = |p: Vec3| (p.x - 11.5).abs() < 2.0;
        let (loose, stiff) = (missed(0.0, light, beside), missed(0.25, light, beside));
        assert!(stiff < 1.1 * loose, "{stiff} instead of {loose}");
    }

    /// A bump that point samples at the vertices would overestimate keeps its integral.
    #[test]
    fn the_integral_of_the_samples_is_kept() {
        let mesh = strip(6);
        let samples = samples(&mesh);
        let values: Vec<Rgb> =
            samples.iter().map(|s| Rgb::splat(1.0 / (1.0 + (position(&mesh, s).x - 3.0).powi(2)))).collect();
        let prior = vec![Rgb::ONE; mesh.vertices.len()];
        let params = FitParams {
            prior: 1e-7,
            smoothing: 0.3,
            bending: 1.0,
            max_steps: 400,
            tolerance: 1e-8,
            ..FitParams::default()
        };
        let fitted = fit(&mesh, &samples, &values, &prior, &[], &params);
        let sent: f32 = samples.iter().zip(&values).map(|(s, v)| s.area * v.x).sum();
        let kept: f32 = (0..mesh.elements.len() as u32)
            .map(|e| {
                let corners = mesh.elements[e as usize].vertices;
                mesh.area(e) * corners.iter().map(|&v| fitted[v as usize].x).sum::<f32>() / 3.0
            })
            .sum();
        assert!((kept / sent - 1.0).abs() < 1e-3, "{kept} {sent}");
    }
}
