//! Light of area emitters and the bright sky at a diffuse hit: read from the vertices, or evaluated there.
//!
//! Evaluated, it replaces of the direct and the mirrored term just what emitter cells and image chains own
//! (`catoptric_light::Owner`): pass one computed it by the same function. What hemisphere rays own of these terms is read from
//! the vertices as ever.

use catoptric_light::irradiance::{Samples, Scratch};
use catoptric_light::{Lights, Receiver};
use catoptric_scene::Rgb;
use catoptric_solution::{Quality, Term};
use catoptric_trace::sequence::Key;

/// Where the light of sources comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DirectLight {
    /// From the vertices of the display mesh, where pass one stored it.
    Vertices,
    /// From the vertices, and from the sources where the mesh is too coarse for the view.
    Auto(ShadowRays),
    /// From the sources, by shadow rays at each hit.
    Pixels(ShadowRays),
}

/// Shadow rays, about: per emitter in sight, and per chain of mirrors by which sources are seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ShadowRays {
    /// At the first sample of a pixel, which also finds the penumbrae.
    pub first: u32,
    /// In a pixel where a penumbra was found; four times as many where they leave it grainy.
    pub penumbra: u32,
}

impl ShadowRays {
    /// The budgets of a quality.
    pub fn for_quality(quality: Quality) -> Self {
        match quality {
            Quality::Sketch => Self { first: 2, penumbra: 8 },
            Quality::Draft => Self { first: 4, penumbra: 16 },
            Quality::Standard => Self { first: 8, penumbra: 64 },
            Quality::High => Self { first: 16, penumbra: 256 },
        }
    }
}

/// Shares of the light of sources that are evaluated at a hit. The rest is read from the mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Wanted {
    /// Of what they send straight.
    pub(crate) direct: f32,
    /// Of what they send over planar mirrors.
    pub(crate) mirrored: f32,
    /// Direct light that arrives, by the mesh: little mirrored light beside it takes fewer rays.
    pub(crate) known: Rgb,
}

impl Wanted {
    /// Nothing.
    pub(crate) const NOTHING: Self = Self { direct: 0.0, mirrored: 0.0, known: Rgb::ZERO };
    /// All.
    pub(crate) const ALL: Self = Self { direct: 1.0, mirrored: 1.0, known: Rgb::ZERO };

    /// Whether it is nothing.
    pub(crate) fn is_nothing(&self) -> bool {
        self.direct <= 0.0 && self.mirrored <= 0.0
    }

    /// The share of a term.
    pub(crate) fn of(&self, term: Term) -> f32 {
        match term {
            Term::Direct => self.direct,
            Term::Mirrored => self.mirrored,
            Term::Caustic | Term::Indirect => 0.0,
        }
    }
}

/// Irradiance by sources at a hit.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SourceLight {
    pub(crate) direct: Rgb,
    pub(crate) mirrored: Rgb,
    /// What nothing blocks of both.
    pub(crate) unoccluded: Rgb,
    /// Some shadow rays were blocked and some were not.
    pub(crate) penumbra: bool,
    /// What half of the rays found beyond the other half: twice the deviation of the sum.
    pub(crate) split: Rgb,
}

impl SourceLight {
    /// What is wanted of it, by about so many shadow rays.
    pub(crate) fn at(
        lights: &Lights,
        receiver: &Receiver,
        wanted: Wanted,
        samples: Samples,
        key: Key,
        scratch: &mut Scratch,
    ) -> Self {
        let Wanted { direct, mirrored, mut known } = wanted;
        let mut sum = Self::default();
        if direct > 0.0 {
            let found = lights.direct(receiver, samples, key, scratch);
            known = found.irradiance;
            sum.direct = found.irradiance * direct;
            sum.unoccluded = found.unoccluded * direct;
            sum.penumbra = found.partial;
            sum.split = found.split * direct;
        }
        if mirrored > 0.0 {
            let found = lights.mirrored(receiver, samples, known, key.child(1), scratch);
            sum.mirrored = found.irradiance * mirrored;
            sum.unoccluded += found.unoccluded * mirrored;
            sum.penumbra |= found.partial;
            sum.split += found.split * mirrored;
        }
        sum
    }
}
