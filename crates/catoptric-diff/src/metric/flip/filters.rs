//! The filters of FLIP, separated into lines and folded: all are even or odd, so half of the weights is enough.

use super::colour::{hunt_lab, hyab};
use super::fast_math::pow;
use super::{FEATURE_WIDTH, Q_COLOUR};

/// Weights at the distances 0, 1, 2, … from the centre.
pub(super) type Half = Vec<f32>;

/// One-dimensional filters.
pub(super) struct Filters {
    /// The largest distance any of them reaches.
    pub(super) radius: usize,
    /// Contrast sensitivity: achromatic, red–green, and the two Gaussians whose sum is blue–yellow.
    pub(super) luminance: Half,
    pub(super) red_green: Half,
    pub(super) blue_yellow: [Half; 2],
    /// Feature detection: Gaussian, its first derivative (odd: of the positive side), its second. Of one length, at least
    /// that of `luminance`.
    pub(super) gauss: Half,
    pub(super) edge: Half,
    pub(super) point: Half,
    /// Largest colour difference to the power Q_COLOUR: green against blue.
    pub(super) largest: f32,
}

impl Filters {
    pub(super) fn new(ppd: f32) -> Filters {
        use std::f64::consts::PI;
        let ppd = f64::from(ppd);
        // Gaussians of contrast sensitivity, amplitude a and scale b (paper, table 1).
        let spatial = (3.0 * (0.04 / (2.0 * PI * PI)).sqrt() * ppd).ceil() as i32;
        let gaussian = |amplitude: f64, b: f64| -> Vec<f64> {
            (0..=spatial)
                .map(|x| amplitude * libm::exp(-PI * PI * (f64::from(x) / ppd) * (f64::from(x) / ppd) / b))
                .collect()
        };
        let sum = |half: &[f64]| half[0] + 2.0 * half[1..].iter().sum::<f64>();
        let normalised = |half: Vec<f64>| {
            let sum = sum(&half);
            half.into_iter().map(|w| w / sum).collect::<Vec<_>>()
        };
        let amplitude = |a: f64, b: f64| (a * (PI / b).sqrt()).sqrt();
        let [z1, z2] = [gaussian(amplitude(34.1, 0.04), 0.04), gaussian(amplitude(13.5, 0.025), 0.025)];
        let (s1, s2) = (sum(&z1), sum(&z2));
        let norm = (s1 * s1 + s2 * s2).sqrt();
        let scaled = |half: &[f64]| half.iter().map(|w| w / norm).collect::<Vec<_>>();
        let luminance = single(normalised(gaussian(1.0, 0.0047)));

        // Feature detectors: positive and negative weights of the derivatives sum to one each.
        let deviation = 0.5 * f64::from(FEATURE_WIDTH) * ppd;
        let reach = (3.0 * deviation).ceil() as i32;
        let bell = |x: i32| libm::exp(-f64::from(x * x) / (2.0 * deviation * deviation));
        let bump = |x: i32| (f64::from(x * x) / (deviation * deviation) - 1.0) * bell(x);
        let edge: Vec<f64> = (0..=reach).map(|x| f64::from(x) * bell(x)).collect();
        let slope: f64 = edge.iter().sum();
        let point: Vec<f64> = (0..=reach).map(bump).collect();
        let side = |x: usize, w: f64| if x == 0 { w } else { 2.0 * w };
        let share = |sign: f64| -> f64 {
            let weights = point.iter().enumerate().map(|(x, &w)| side(x, (sign * w).max(0.0)));
            weights.sum()
        };
        let (rise, fall) = (share(1.0), share(-1.0));
        let balanced = point.iter().map(|&w| if w > 0.0 { w / rise } else { w / fall }).collect::<Vec<_>>();
        let padded = |half: Vec<f64>| {
            let mut half: Half = half.into_iter().map(|w| w as f32).collect();
            half.resize(half.len().max(luminance.len()), 0.0);
            half
        };
        Filters {
            radius: (spatial.max(reach) as usize).max(luminance.len() - 1),
            red_green: single(normalised(gaussian(1.0, 0.0053))),
            blue_yellow: [single(scaled(&z1)), single(scaled(&z2))],
            gauss: padded(normalised((0..=reach).map(bell).collect())),
            edge: padded(edge.into_iter().map(|w| w / slope).collect()),
            point: padded(balanced),
            luminance,
            largest: pow(hyab(hunt_lab([0.0, 1.0, 0.0]), hunt_lab([0.0, 0.0, 1.0])), Q_COLOUR),
        }
    }
}

/// Drops the weights that add nothing in single precision.
fn single(half: Vec<f64>) -> Half {
    let keep = half.iter().rposition(|w| w.abs() > 1e-7 * half[0]).unwrap_or(0);
    half[..=keep].iter().map(|&w| w as f32).collect()
}
