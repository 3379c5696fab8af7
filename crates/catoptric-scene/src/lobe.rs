//! How an area light spreads its power over directions.
//!
//! S(θ) = (n+1)/2π · cosⁿθ is the share of the power per solid angle, the emitter's own cosine included: ∫ S dω = 1. With the
//! area A and the power Φ the radiance is L(θ) = Φ·S(θ)/(A·cosθ). A file gives the radiance L of the *diffuse* emitter,
//! Φ = π·A·L; the lobe keeps that power, so that L(θ) = L · (n+1)/2 · cosⁿ⁻¹θ. n = 1 is diffuse.

/// A cosine lobe about the surface's geometric normal. Always valid: n is in (0, 1000].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lobe {
    exponent: f32,
}

/// The narrowest lobe: half its power within 2.1°.
const MAX_EXPONENT: f32 = 1000.0;
/// Below n = 1 radiance grows without bound towards grazing angles. From here on it stays: beyond lies a share of
/// 1e-4ⁿ⁺¹ of the power.
const MIN_COS: f64 = 1e-4;

impl Lobe {
    /// L(θ) = L.
    pub const DIFFUSE: Self = Self { exponent: 1.0 };

    /// The lobe of exponent n, if n is in (0, 1000].
    pub fn new(exponent: f32) -> Option<Self> {
        (exponent > 0.0 && exponent <= MAX_EXPONENT).then_some(Self { exponent })
    }

    /// n.
    #[inline]
    pub fn exponent(self) -> f32 {
        self.exponent
    }

    /// Whether n = 1: then every factor is 1.
    #[inline]
    pub fn is_diffuse(self) -> bool {
        self.exponent == 1.0
    }

    /// L(θ)/L = (n+1)/2 · cosⁿ⁻¹θ at the angle of departure. The only place that knows it.
    #[inline]
    pub fn factor(self, cos: f64) -> f64 {
        if self.is_diffuse() { 1.0 } else { self.shape(cos) }
    }

    /// Out of line: nearly all emitters are diffuse.
    #[cold]
    fn shape(self, cos: f64) -> f64 {
        let exponent = f64::from(self.exponent);
        0.5 * (exponent + 1.0) * libm::pow(cos.clamp(MIN_COS, 1.0), exponent - 1.0)
    }

    /// The most that [`Lobe::factor`] is, grazing angles below n = 1 aside.
    #[inline]
    pub fn peak(self) -> f64 {
        0.5 * (f64::from(self.exponent).max(1.0) + 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_lobe_sends_the_power_of_the_diffuse_emitter() {
        for n in [0.2, 0.5, 1.0, 1.5, 2.0, 7.0, 80.0, 1000.0] {
            let lobe = Lobe::new(n).expect("a legal exponent");
            // ∫ L(θ)/L · cosθ dω/π = ∫₀¹ 2·cos·factor dcos by midpoints in the angle.
            let steps = 200_000;
            let width = std::f64::consts::FRAC_PI_2 / f64::from(steps);
            let power: f64 = (0..steps)
                .map(|k| {
                    let (sin, cos) = libm::sincos((f64::from(k) + 0.5) * width);
                    2.0 * sin * cos * lobe.factor(cos) * width
                })
                .sum();
            let cut = libm::pow(MIN_COS, f64::from(n) + 1.0);
            assert!((power - 1.0).abs() < 1e-6 + cut, "n = {n}: {power}");
        }
    }

    #[test]
    fn exponents_out_of_range_are_no_lobes() {
        for n in [0.0, -1.0, 1000.1, f32::NAN, f32::INFINITY] {
            assert_eq!(Lobe::new(n), None, "{n}");
        }
    }
}
