//! Fresnel reflectance of a smooth dielectric interface, unpolarised (average of both polarisations at each
//! interface), and its diffuse averages.
//!
//! Source: Born & Wolf, Principles of Optics, §1.5.2; diffuse averages by Gauss–Legendre quadrature.

/// Refraction at an interface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Refraction {
    /// Reflectance F ∈ `[0, 1]`; 1 at total internal reflection.
    pub reflectance: f32,
    /// Cosine of the refracted direction; 0 at total internal reflection.
    pub cos_transmitted: f32,
}

/// F and Snell's law for light that comes from index `n1` at `cos_incident` ≥ 0 and meets index `n2`.
#[inline]
pub fn refract(cos_incident: f32, n1: f32, n2: f32) -> Refraction {
    let cos_incident = cos_incident.clamp(0.0, 1.0);
    if n1 == n2 {
        return Refraction { reflectance: 0.0, cos_transmitted: cos_incident };
    }
    let ratio = n1 / n2;
    let sin2_transmitted = ratio * ratio * (1.0 - cos_incident * cos_incident);
    if sin2_transmitted >= 1.0 {
        return Refraction { reflectance: 1.0, cos_transmitted: 0.0 };
    }
    let cos_transmitted = (1.0 - sin2_transmitted).sqrt();
    let perpendicular =
        (n1 * cos_incident - n2 * cos_transmitted) / (n1 * cos_incident + n2 * cos_transmitted);
    let parallel = (n2 * cos_incident - n1 * cos_transmitted) / (n2 * cos_incident + n1 * cos_transmitted);
    let reflectance = 0.5 * (perpendicular * perpendicular + parallel * parallel);
    Refraction { reflectance, cos_transmitted }
}

/// Hemispherical averages of F for cosine-distributed light: from outside (air) and from inside.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DiffuseFresnel {
    /// ∫ F(θ) 2 cosθ sinθ dθ from outside.
    pub external: f32,
    /// The same from inside; 1 − (1 − external)/n² by reciprocity.
    pub internal: f32,
}

/// Averages for the index `n`.
pub fn diffuse(n: f32) -> DiffuseFresnel {
    let external = cosine_mean(1024, |cos| f64::from(refract(cos, 1.0, n).reflectance));
    let internal = 1.0 - (1.0 - external) / f64::from(n * n);
    DiffuseFresnel { external: external as f32, internal: internal as f32 }
}

/// ∫ f(μ) 2μ dμ over `[0, 1]` by Simpson's rule of `steps` (even) intervals. In μ = cosθ the functions of Fresnel are
/// smooth; in μ², where the weight is uniform, they have a root at grazing incidence.
pub(crate) fn cosine_mean(steps: usize, f: impl Fn(f32) -> f64) -> f64 {
    let sum: f64 = (0..=steps)
        .map(|step| {
            let mu = step as f64 / steps as f64;
            let weight = match step {
                0 => 1.0,
                _ if step == steps => 1.0,
                _ if step % 2 == 1 => 4.0,
                _ => 2.0,
            };
            weight * 2.0 * mu * f(mu as f32)
        })
        .sum();
    sum / (3.0 * steps as f64)
}

/// A thin pane of internal transmittance `tint` per pass: reflectance and transmittance with all internal bounces,
/// R' = R + R(1−R)²a²/(1−R²a²), T' = (1−R)²a/(1−R²a²).
#[inline]
pub fn pane(cos_incident: f32, n: f32, tint: glam::Vec3) -> (glam::Vec3, glam::Vec3) {
    let r = refract(cos_incident, 1.0, n).reflectance;
    let t2 = (1.0 - r) * (1.0 - r);
    let denominator = (glam::Vec3::ONE - tint * tint * (r * r)).max(glam::Vec3::splat(1e-12));
    // A full mirror at exactly grazing incidence: nothing passes.
    let transmitted = tint * t2 / denominator;
    let reflected = glam::Vec3::splat(r) + transmitted * tint * r;
    (reflected, transmitted)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// ((n−1)/(n+1))² at normal incidence; 1 beyond the critical angle; Brewster's angle for p-polarisation leaves
    /// half of the s-reflectance: F = ½((n²−1)/(n²+1))².
    #[test]
    fn known_angles_have_known_reflectances() {
        let n = 1.5_f32;
        assert!((refract(1.0, 1.0, n).reflectance - 0.04).abs() < 1e-6);
        assert!((refract(1.0, n, 1.0).reflectance - 0.04).abs() < 1e-6);
        assert_eq!(refract(0.5, n, 1.0).reflectance, 1.0);
        let brewster = 1.0 / (1.0 + n * n).sqrt();
        let s = ((n * n - 1.0) / (n * n + 1.0)).powi(2);
        assert!((refract(brewster, 1.0, n).reflectance - 0.5 * s).abs() < 1e-6);
        assert!(refract(0.0, 1.0, n).reflectance > 0.999_999);
    }

    /// 0.0918 is the external average of n = 1.5 (Egan & Hilgeman 1979 tabulate 0.092); 0.5964 the internal one.
    #[test]
    fn diffuse_averages_match_the_literature() {
        let d = diffuse(1.5);
        assert!((d.external - 0.0918).abs() < 2e-4, "{d:?}");
        assert!((d.internal - 0.5964).abs() < 2e-4, "{d:?}");
    }

    /// A lossless pane loses nothing at any angle, and transmits 2n/(n²+1) at normal incidence.
    #[test]
    fn a_lossless_pane_conserves_power() {
        for i in 0..=100 {
            let (r, t) = pane(i as f32 / 100.0, 1.52, glam::Vec3::ONE);
            assert!(((r + t).x - 1.0).abs() < 2e-6, "cos {i}: {r} {t}");
        }
        let (_, t) = pane(1.0, 1.52, glam::Vec3::ONE);
        assert!((t.x - 2.0 * 1.52 / (1.52 * 1.52 + 1.0)).abs() < 1e-6);
    }
}
