//! Where the power of walks went: each entry is summed from its own events, none is a remainder (docs/conventions.md).

use glam::DVec3;

use catoptric_scene::Rgb;

/// Power that ended in walks, per channel. With arrivals (before the receiver splits them, less what it passes on)
/// the entries add up to what was sent.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ledger {
    /// Kept by diffuse sides: Σ (1 − ρ_s) × arrivals.
    pub arrived: DVec3,
    /// Absorbed by mirrors, glass, panes, media, and by directions below the geometric surface.
    pub absorbed: DVec3,
    /// Absorbed by the backs of single-sided surfaces.
    pub black_backs: DVec3,
    /// Left the scene: the sky's share.
    pub escaped: DVec3,
    /// Given up at the maximum depth.
    pub cut_off: DVec3,
    /// Roulette: what was dropped less what was added to survivors. Zero on average.
    pub roulette: DVec3,
    /// Light-side walks over interpolated normals: what the factor for adjoint scattering took less what it gave.
    pub shading: DVec3,
}

impl Ledger {
    /// Adds every entry of `other`.
    pub fn add(&mut self, other: &Ledger) {
        self.arrived += other.arrived;
        self.absorbed += other.absorbed;
        self.black_backs += other.black_backs;
        self.escaped += other.escaped;
        self.cut_off += other.cut_off;
        self.roulette += other.roulette;
        self.shading += other.shading;
    }

    /// Every entry times `factor`.
    pub fn scaled(&self, factor: f64) -> Ledger {
        Ledger {
            arrived: self.arrived * factor,
            absorbed: self.absorbed * factor,
            black_backs: self.black_backs * factor,
            escaped: self.escaped * factor,
            cut_off: self.cut_off * factor,
            roulette: self.roulette * factor,
            shading: self.shading * factor,
        }
    }

    /// The sum of all entries: what was sent.
    pub fn sum(&self) -> DVec3 {
        self.arrived
            + self.absorbed
            + self.black_backs
            + self.escaped
            + self.cut_off
            + self.roulette
            + self.shading
    }

    /// The entries by name.
    pub fn entries(&self) -> [(&'static str, DVec3); 7] {
        [
            ("arrived", self.arrived),
            ("absorbed", self.absorbed),
            ("black_backs", self.black_backs),
            ("escaped", self.escaped),
            ("cut_off", self.cut_off),
            ("roulette", self.roulette),
            ("shading", self.shading),
        ]
    }
}

/// A throughput as a ledger entry.
#[inline]
pub(crate) fn entry(weight: Rgb) -> DVec3 {
    weight.as_dvec3()
}
