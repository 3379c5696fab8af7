//! What is left of the noise goes by diffusion that keeps the power: on surfaces whose own tessellation is finer than the
//! rays are dense, and where a refined region ends.

use catoptric_scene::Rgb;

use crate::caustic::projection::{Projection, strength};

/// Steps of smoothing at most: noise spreads over about their square root of edges.
const SMOOTHING: usize = 32;
/// Times that variances are pooled.
pub(super) const POOLING: usize = 2;
/// Standard error against the light that smoothing aims at.
const SMOOTH_TO: f32 = 0.02;
/// Squared differences up to this multiple of their variance count as noise.
const LIKELY: f32 = 4.0;

/// How surprising a difference is as noise of this variance: from 1 on (1 / the second edge-stopping function of Perona & Malik 1990, whose
/// scale is the noise).
pub(super) fn surprise(difference: f32, variance: f32) -> f32 {
    let unlikely = difference * difference / (LIKELY * variance).max(f32::MIN_POSITIVE);
    1.0 + unlikely * unlikely
}

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
        // A corner of triangles without area has no light to give.
        edges.retain(|&(a, b)| self.mass[a as usize].min(self.mass[b as usize]) > 0.0);
        let mut degree = vec![0_u32; self.values.len()];
        for &(a, b) in &edges {
            degree[a as usize] += 1;
            degree[b as usize] += 1;
        }
        let mut flow = vec![Rgb::ZERO; self.values.len()];
        // Neighbours pool their variances, as of rays that are as dense and as strong: one that got little by chance would think itself certain.
        // (That of a value is in proportion to 1 / mass. Its mean would make small triangles think themselves as certain as those beside.)
        for _ in 0..POOLING {
            let mut sums: Vec<(f32, f32)> =
                self.variance.iter().zip(&self.mass).map(|(&v, &m)| (v * m * m, m)).collect();
            for &(a, b) in &edges {
                let [p, q] = [a, b].map(|v| (self.variance[v as usize], self.mass[v as usize]));
                sums[a as usize] = (sums[a as usize].0 + q.0 * q.1 * q.1, sums[a as usize].1 + q.1);
                sums[b as usize] = (sums[b as usize].0 + p.0 * p.1 * p.1, sums[b as usize].1 + p.1);
            }
            for ((variance, &own), (sum, mass)) in self.variance.iter_mut().zip(&self.mass).zip(sums) {
                *variance = if own > 0.0 { sum / mass / own } else { 0.0 };
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
                let conductance = wanted / surprise(difference, self.variance[a] + self.variance[b]);
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

#[cfg(test)]
mod tests {
    use catoptric_trace::sequence::{Key, Purpose};

    use super::*;

    /// A sheet of light 1 whose columns are a metre apart, and two of them a centimetre: along the foot of something that stands on it. What `rays`
    /// for each square metre found. With a corner of triangles without area.
    fn sheet(rays: f32) -> Projection {
        let columns = [0.0_f32, 1.0, 2.0, 3.0, 3.01, 3.02, 4.0, 5.0, 6.0, 7.0];
        let rows = 40_u32;
        let wide = columns.len() as u32;
        let mut triangles = Vec::new();
        let mut mass = vec![0.0_f32; (wide * rows + 1) as usize];
        for y in 0..rows - 1 {
            for x in 0..wide - 1 {
                let area = 0.5 * (columns[x as usize + 1] - columns[x as usize]);
                let at = y * wide + x;
                for corners in [[at, at + 1, at + wide + 1], [at, at + wide + 1, at + wide]] {
                    corners.iter().for_each(|&v| mass[v as usize] += area / 3.0);
                    triangles.push((corners, area));
                }
            }
        }
        triangles.push(([0, 1, wide * rows], 0.0));
        let key = Key::new(0, Purpose::Test, 0);
        let variance: Vec<f32> = mass.iter().map(|&m| if m > 0.0 { 1.0 / (rays * m) } else { 0.0 }).collect();
        // Twelve uniform numbers have the variance of one deviate.
        let noise = |v: u32| (0..12).map(|k| key.uniform(12 * v + k) - 0.5).sum::<f32>();
        let values =
            (0..).zip(&variance).map(|(v, s)| Rgb::splat((1.0 + s.sqrt() * noise(v)) / 3.0)).collect();
        Projection { values, mass, variance, triangles }
    }

    /// Root mean square of what the vertices of less or more mass are off, each.
    fn off(projection: &Projection) -> [f32; 2] {
        [true, false].map(|small| {
            let of: Vec<f32> = (projection.values.iter().zip(&projection.mass))
                .filter(|(_, m)| **m > 0.0 && (**m < 0.1) == small)
                .map(|(&value, _)| (strength(value) - 1.0).powi(2))
                .collect();
            (of.iter().sum::<f32>() / of.len() as f32).sqrt()
        })
    }

    #[test]
    fn small_triangles_in_even_light_are_as_even_as_large_ones() {
        let mut projection = sheet(1500.0);
        let power =
            |p: &Projection| -> f32 { p.values.iter().zip(&p.mass).map(|(&v, m)| strength(v) * m).sum() };
        let (before, sent) = (off(&projection), power(&projection));
        projection.smooth(&vec![0.0; projection.values.len()]);
        let after = off(&projection);
        assert!(before[0] > 0.2 && before[1] > SMOOTH_TO, "no challenge: {before:?}");
        assert!(after[0] < before[1] && after[1] < before[1], "{before:?}, smooth {after:?}");
        assert!((power(&projection) / sent - 1.0).abs() < 1e-5);
        assert!(projection.values.iter().all(|value| value.is_finite()));
    }
}
