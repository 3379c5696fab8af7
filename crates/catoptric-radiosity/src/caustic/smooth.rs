//! What is left of the noise goes by diffusion that keeps the power: on surfaces whose own tessellation is finer than the
//! rays are dense, and where a refined region ends.

use catoptric_scene::Rgb;

use crate::caustic::density::{Projection, strength};

/// Steps of smoothing at most: noise spreads over about their square root of edges.
const SMOOTHING: usize = 32;
/// Times that variances are pooled.
pub(super) const POOLING: usize = 2;
/// Standard error against the light that smoothing aims at.
const SMOOTH_TO: f32 = 0.03;
/// Squared differences up to this multiple of their variance count as noise.
const LIKELY: f32 = 4.0;

impl Projection {
    /// Evens out noise that is above `SMOOTH_TO` of the light at a vertex (`other` and its own): power flows along edges
    /// until the values around have been averaged that widely, but not across differences that noise does not explain
    /// (diffusion with an edge-stopping function, Perona & Malik 1990, whose scale is the local noise). What one vertex
    /// loses another gets, so the power stays.
    pub(super) fn smooth(&mut self, other: &[f32]) {
        let mut edges: Vec<(u32, u32)> = self
            .triangles
            .iter()
            .flat_map(|(t, _)| (0..3).map(|k| (t[k].min(t[(k + 1) % 3]), t[k].max(t[(k + 1) % 3]))))
            .collect();
        edges.sort_unstable();
        edges.dedup();
        let mut degree = vec![0_u32; self.values.len()];
        for &(a, b) in &edges {
            degree[a as usize] += 1;
            degree[b as usize] += 1;
        }
        let mut flow = vec![Rgb::ZERO; self.values.len()];
        // Neighbours pool their variances: one that got little by chance would think itself certain.
        for _ in 0..POOLING {
            let mut sums: Vec<(f32, f32)> =
                self.variance.iter().zip(&self.mass).map(|(&v, &m)| (v * m, m)).collect();
            for &(a, b) in &edges {
                let [p, q] = [a, b].map(|v| (self.variance[v as usize], self.mass[v as usize]));
                sums[a as usize] = (sums[a as usize].0 + q.0 * q.1, sums[a as usize].1 + q.1);
                sums[b as usize] = (sums[b as usize].0 + p.0 * p.1, sums[b as usize].1 + p.1);
            }
            for (variance, (sum, mass)) in self.variance.iter_mut().zip(sums) {
                *variance = if mass > 0.0 { sum / mass } else { 0.0 };
            }
        }
        let light = |v: usize| other[v] + strength(self.values[v]).max(0.0);
        // After t steps of free flow a value is the mean of about 6t vertices: the effective area of the heat kernel.
        let steps: Vec<f32> = (0..self.values.len())
            .map(|v| (self.variance[v] / (SMOOTH_TO * light(v)).powi(2).max(f32::MIN_POSITIVE) - 1.0) / 6.0)
            .collect();
        for step in 0..SMOOTHING {
            flow.fill(Rgb::ZERO);
            let open = |v: usize| (steps[v] - step as f32).clamp(0.0, 1.0);
            let mut flows = false;
            for &(a, b) in &edges {
                let (a, b) = (a as usize, b as usize);
                let wanted = 0.5 * (open(a) + open(b));
                if wanted <= 0.0 {
                    continue;
                }
                flows = true;
                let difference = strength(self.values[a]) - strength(self.values[b]);
                let unlikely = difference * difference / (LIKELY * (self.variance[a] + self.variance[b]));
                let conductance = wanted / (1.0 + unlikely * unlikely);
                let exchanged =
                    conductance * self.mass[a].min(self.mass[b]) / (degree[a].max(degree[b]) + 1) as f32;
                flow[a] += (self.values[b] - self.values[a]) * (exchanged / self.mass[a]);
                flow[b] += (self.values[a] - self.values[b]) * (exchanged / self.mass[b]);
            }
            if !flows {
                return;
            }
            for (value, flow) in self.values.iter_mut().zip(&flow) {
                *value += *flow;
            }
        }
    }
}
