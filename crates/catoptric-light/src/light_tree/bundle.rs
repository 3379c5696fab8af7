//! Bundles: few neighbouring cells of the tree, weighed all at once.

use std::ops::Range;

use glam::{DVec3, Vec3};

use catoptric_scene::Rgb;

use super::build::Source;
use super::view::View;
use super::{GROUP_RATIO, SLACK};

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
    /// Of its largest cell, metres.
    largest: f64,
    /// Σ radiance × area at the lobe's peak, over channels.
    power: f64,
    /// Share of each channel where all are diffuse and of one colour.
    color: Option<Rgb>,
}

impl Bundle {
    /// `order`, the first of which is `first` in the final order, about a center.
    pub(super) fn new(sources: &[Source], order: &[u32], first: u32, center: DVec3, radius: f64) -> Self {
        let [x, y, z, normal_x, normal_y, normal_z, radii, powers] = [[0.0; BUNDLE]; 8];
        let of = |i: &u32| &sources[*i as usize];
        let power: f64 = order.iter().map(|i| of(i).strength).sum();
        let largest = order.iter().map(|i| of(i).radius).fold(0.0, f64::max);
        let color = of(&order[0]).radiance;
        let is_alike = order.iter().all(|i| of(i).radiance == color && !of(i).lobed);
        let color = is_alike.then(|| color / color.element_sum());
        let mut bundle = Self {
            x,
            y,
            z,
            normal_x,
            normal_y,
            normal_z,
            radii,
            powers,
            center,
            radius,
            first,
            largest,
            power,
            color,
        };
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

    /// In units of the distance nothing overflows.
    fn unit(&self, view: &View) -> f64 {
        1.0 / (self.center - view.point).length().max(self.radius)
    }

    /// What each cell sends to a view, as if it were a point, times a factor of them all. `IS_SURE`: zero only where it can send none.
    #[inline]
    fn weights<const IS_SURE: bool>(&self, view: &View) -> [f32; BUNDLE] {
        let (offset, unit) = (self.center - view.point, self.unit(view));
        let (offset, normal, unit) = ((offset * unit).as_vec3(), view.normal.as_vec3(), unit as f32);
        let slack = if IS_SURE { SLACK } else { 0.0 };
        let mut weights = [0.0; BUNDLE];
        for i in 0..BUNDLE {
            let x = offset.x + self.x[i] * unit;
            let y = offset.y + self.y[i] * unit;
            let z = offset.z + self.z[i] * unit;
            let radius = self.radii[i] * unit;
            let r2 = (x * x + y * y + z * z).max(radius * radius).max(1e-15);
            let above = if IS_SURE { radius } else { 0.0 };
            let receives = normal.x * x + normal.y * y + normal.z * z + above + slack;
            let emits = slack - (self.normal_x[i] * x + self.normal_y[i] * y + self.normal_z[i] * z);
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

    /// Whether what it sends is known where its cells count as points.
    pub(super) fn is_known(&self) -> bool {
        self.color.is_some()
    }

    /// Whether each cell counts as a point for a view so far away.
    #[inline]
    pub(super) fn is_far(&self, distance: f64) -> bool {
        self.is_known() && self.largest < GROUP_RATIO * (distance - self.radius)
    }

    /// Irradiance of its `cells`, each as a point, unoccluded: Σ L·A·cosθ'·cosθ/r².
    #[inline]
    pub(super) fn irradiance(&self, cells: Range<u32>, view: &View) -> Rgb {
        self.color.unwrap_or(Rgb::ZERO) * self.sum::<false>(cells, view) as f32
    }

    /// About the irradiance of its `cells` (sum of channels): zero only where they can send none.
    #[inline]
    pub(super) fn estimate(&self, cells: Range<u32>, view: &View) -> f64 {
        self.sum::<true>(cells, view)
    }

    #[inline]
    fn sum<const IS_SURE: bool>(&self, cells: Range<u32>, view: &View) -> f64 {
        let total: f32 = self.weights::<IS_SURE>(view)[self.slots(cells)].iter().sum();
        f64::from(total) * self.power * self.unit(view).powi(2)
    }

    /// Where cells stand in it.
    fn slots(&self, cells: Range<u32>) -> Range<usize> {
        (cells.start - self.first) as usize..(cells.end - self.first) as usize
    }

    /// One of its `cells`, chosen by what each sends to a view with `u` in [0, 1): with the probability of the choice and
    /// what is left of `u`. `IS_SURE`: all may be chosen that can send any; without, those of [`Self::irradiance`] in proportion.
    #[inline]
    pub(super) fn draw<const IS_SURE: bool>(
        &self,
        cells: Range<u32>,
        view: &View,
        u: f64,
    ) -> Option<(u32, f64, f64)> {
        let weights = self.weights::<IS_SURE>(view);
        let slots = self.slots(cells);
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
