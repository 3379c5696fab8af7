//! Boxes around what is long or flat: tubes and strips are far narrower than a ball around them.

use glam::DVec3;

/// Rounding of positions relative to the size.
const ROUNDING: f64 = 1e-9;

/// A box, turned as what is in it lies.
#[derive(Clone, Copy, Debug)]
pub(super) struct Extent {
    center: DVec3,
    /// From the centre to the middles of three faces, metres.
    half: [DVec3; 3],
}

impl Extent {
    /// A box around points, along the line between two of them that are far from each other. `None` where there is no such line.
    pub(super) fn around(points: &[DVec3]) -> Option<Self> {
        let first = *points.first()?;
        let by = |measure: &dyn Fn(&DVec3) -> f64| {
            points.iter().copied().max_by(|a, b| measure(a).total_cmp(&measure(b)))
        };
        let one = by(&|p| p.distance_squared(first))?;
        let other = by(&|p| p.distance_squared(one))?;
        let along = (other - one).try_normalize()?;
        let off_line = |p: &DVec3| (*p - one).reject_from_normalized(along);
        let widest = off_line(&by(&|p| off_line(p).length_squared())?);
        let across = widest.try_normalize().unwrap_or_else(|| along.any_orthonormal_vector());
        let axes = [along, across, along.cross(across)];
        let range = |axis: DVec3| {
            let places = points.iter().map(|p| axis.dot(*p));
            places.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)))
        };
        let ranges = axes.map(range);
        let size = (other - one).length() + center_of(ranges[0]).abs();
        let center = axes.iter().zip(ranges).map(|(axis, range)| *axis * center_of(range)).sum();
        let half = std::array::from_fn(|i| {
            let (low, high) = ranges[i];
            axes[i] * (0.5 * (high - low) + ROUNDING * size)
        });
        Some(Self { center, half })
    }

    /// Half of its shortest side.
    pub(super) fn least(&self) -> f64 {
        self.half.iter().map(|half| half.length()).fold(f64::INFINITY, f64::min)
    }

    /// The most that a unit normal has along it from `eye`.
    #[inline]
    pub(super) fn most_along(&self, normal: DVec3, eye: DVec3) -> f64 {
        let reach: f64 = self.half.iter().map(|half| half.dot(normal).abs()).sum();
        normal.dot(self.center - eye) + reach
    }
}

fn center_of((low, high): (f64, f64)) -> f64 {
    0.5 * (low + high)
}
