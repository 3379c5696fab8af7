//! Bundles: few neighbouring cells of the tree, weighed all at once.

use std::ops::Range;

use glam::{DVec3, Vec3};

use super::SLACK;
use super::build::Source;
use super::view::View;

/// Cells of a bundle at most.
pub(super) const BUNDLE: usize = 32;

/// Few neighbouring cells, one number of each beside the other, to be weighed all at once.
#[derive(Clone, Debug)]
#[repr(align(64))]
pub(super) struct Bundle {
    /// Centroids, from `center`.
    x: [f32; BUNDLE],
    y: [f32; BUNDLE],
    z: [f32; BUNDLE],
    normal_x: [f32; BUNDLE],
    normal_y: [f32; BUNDLE],
    normal_z: [f32; BUNDLE],
    radii: [f32; BUNDLE],
    /// Shares of their power; 0 where there are fewer cells.
    powers: [f32; BUNDLE],
    center: DVec3,
    radius: f64,
    first: u32,
}

impl Bundle {
    /// `order`, the first of which is `first` in the final order, about a center.
    pub(super) fn new(sources: &[Source], order: &[u32], first: u32, center: DVec3, radius: f64) -> Self {
        let [x, y, z, normal_x, normal_y, normal_z, radii, powers] = [[0.0; BUNDLE]; 8];
        let mut bundle = Self { x, y, z, normal_x, normal_y, normal_z, radii, powers, center, radius, first };
        let power: f64 = order.iter().map(|&i| sources[i as usize].strength).sum();
        for (slot, &index) in order.iter().enumerate() {
            let source = &sources[index as usize];
            let offset = (source.centroid - center).as_vec3();
            [bundle.x[slot], bundle.y[slot], bundle.z[slot]] = offset.to_array();
            [bundle.normal_x[slot], bundle.normal_y[slot], bundle.normal_z[slot]] =
                source.normal.as_vec3().to_array();
            bundle.radii[slot] = (source.radius as f32).next_up();
            bundle.powers[slot] = (source.strength / power) as f32;
        }
        bundle
    }

    /// About what each cell sends to a view, times a factor of them all: zero only where it can send none.
    #[inline]
    fn weights(&self, view: &View) -> [f32; BUNDLE] {
        let offset = self.center - view.point;
        // In units of the distance nothing overflows.
        let unit = 1.0 / offset.length().max(self.radius);
        let (offset, normal, unit) = ((offset * unit).as_vec3(), view.normal.as_vec3(), unit as f32);
        let mut weights = [0.0; BUNDLE];
        for i in 0..BUNDLE {
            let x = offset.x + self.x[i] * unit;
            let y = offset.y + self.y[i] * unit;
            let z = offset.z + self.z[i] * unit;
            let radius = self.radii[i] * unit;
            let r2 = (x * x + y * y + z * z).max(radius * radius).max(1e-15);
            let receives = normal.x * x + normal.y * y + normal.z * z + radius + SLACK;
            let emits = SLACK - (self.normal_x[i] * x + self.normal_y[i] * y + self.normal_z[i] * z);
            weights[i] = self.powers[i] * receives.max(0.0) * emits.max(0.0) / (r2 * r2);
        }
        if view.is_limited() {
            // What rounding of f32 moves a center by.
            let slack = 1e-6 * self.radius;
            for i in 0..BUNDLE {
                let center = self.center + Vec3::new(self.x[i], self.y[i], self.z[i]).as_dvec3();
                if !view.may_show(center, f64::from(self.radii[i]) + slack) {
                    weights[i] = 0.0;
                }
            }
        }
        weights
    }

    /// One of its `cells`, chosen by what each sends to a view with `u` in [0, 1): with the probability of the choice and
    /// what is left of `u`.
    #[inline]
    pub(super) fn draw(&self, cells: Range<u32>, view: &View, u: f64) -> Option<(u32, f64, f64)> {
        let weights = self.weights(view);
        let slots = (cells.start - self.first) as usize..(cells.end - self.first) as usize;
        let total: f32 = weights[slots.clone()].iter().sum();
        let mut left = u as f32 * total;
        let mut chosen = None;
        for slot in slots {
            let weight = weights[slot];
            if weight > 0.0 {
                chosen = Some((slot as u32, weight, (left / weight).clamp(0.0, 1.0 - 1e-6)));
                if left < weight {
                    break;
                }
                left -= weight;
            }
        }
        let (slot, weight, rest) = chosen?;
        Some((self.first + slot, f64::from(weight / total), f64::from(rest)))
    }
}
