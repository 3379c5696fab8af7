//! Light of area emitters and the bright sky at a diffuse hit: read from the vertices, or evaluated there.
//!
//! Evaluated, it replaces of the direct and the mirrored term just what emitter cells and image chains own
//! (`catoptric_light::Owner`): pass one computed it by the same function. What hemisphere rays own of these terms is read from
//! the vertices as ever.

use std::f32::consts::PI;

use catoptric_light::irradiance::{Samples, Scratch, SourceIrradiance};
use catoptric_light::{Lights, Receiver};
use catoptric_scene::Rgb;
use catoptric_scene::quantity::LUMINANCE;
use catoptric_solution::{Quality, Term};
use catoptric_trace::sequence::Key;

use crate::layers::{Kept, LightLayer};

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

/// Light of sources by one way.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Part {
    /// Irradiance, W/m².
    pub(crate) irradiance: Rgb,
    /// What nothing blocks of it.
    pub(crate) unoccluded: Rgb,
    /// What half of the rays found beyond the other half: twice the deviation of the sum.
    pub(crate) split: Rgb,
    /// Some shadow rays were blocked and some were not.
    pub(crate) penumbra: bool,
    /// Shadow rays told how much is seen.
    pub(crate) sampled: bool,
    /// Deviation that their number alone explains, relative to what nothing blocks.
    pub(crate) doubt: f32,
}

impl Part {
    /// Of its luminance, as well as one difference tells.
    pub(crate) fn variance(&self) -> f32 {
        (0.5 * self.split.dot(LUMINANCE)).powi(2)
    }
}

impl From<SourceIrradiance> for Part {
    fn from(found: SourceIrradiance) -> Self {
        let SourceIrradiance { irradiance, unoccluded, split, partial, sampled, doubt, .. } = found;
        let doubt = doubt / unoccluded.element_sum().max(f32::MIN_POSITIVE);
        Self { irradiance, unoccluded, split, penumbra: partial, sampled, doubt }
    }
}

/// Irradiance by sources at a hit: what was asked for of it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct SourceLight {
    pub(crate) direct: Part,
    pub(crate) mirrored: Part,
}

impl SourceLight {
    /// What is wanted of it, whole, by about so many shadow rays.
    pub(crate) fn at(
        lights: &Lights,
        receiver: &Receiver,
        wanted: Wanted,
        samples: Samples,
        key: Key,
        scratch: &mut Scratch,
    ) -> Self {
        let mut found = Self::default();
        let mut known = wanted.known;
        if wanted.direct > 0.0 {
            found.direct = lights.direct(receiver, samples, key, scratch).into();
            known = found.direct.irradiance;
        }
        if wanted.mirrored > 0.0 {
            found.mirrored = lights.mirrored(receiver, samples, known, key.child(1), scratch).into();
        }
        found
    }
}

/// Shadow rays for light of which the eye gets the share `send`.
pub(crate) fn in_proportion(samples: Samples, send: Rgb) -> Samples {
    let share = (send.max_element() * PI).min(1.0);
    Samples { count: ((samples.count as f32 * share).ceil() as u32).max(1), ..samples }
}

/// What source light that was evaluated for a sample tells beside its radiance.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Shadows {
    /// Radiance that is missing because something blocks it.
    pub(crate) blocked: Rgb,
    /// Some shadow rays were blocked and some were not.
    pub(crate) penumbra: bool,
    /// Variance of the luminance found.
    pub(crate) grain: f32,
}

impl Shadows {
    /// Adds what is wanted of the light that was found at a hit, of which the eye gets the share `send`.
    pub(crate) fn add<L: Kept>(
        &mut self,
        light: &mut L,
        (send, through): (Rgb, bool),
        wanted: Wanted,
        found: &SourceLight,
    ) {
        for (part, share, layer) in [
            (found.direct, wanted.direct, LightLayer::Direct),
            (found.mirrored, wanted.mirrored, LightLayer::Mirrored),
        ] {
            let send = send * share;
            light.add(layer, through, send * part.irradiance);
            self.blocked += send * (part.unoccluded - part.irradiance);
            self.penumbra |= part.penumbra;
            self.grain += Part { split: send * part.split, ..part }.variance();
        }
    }
}
