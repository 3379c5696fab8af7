//! Light of area emitters and the bright sky at a diffuse hit: read from the vertices, or evaluated there.
//!
//! Evaluated, it replaces of the direct and the mirrored term just what emitter cells and image chains own
//! (`catoptric_light::Owner`): pass one computed it by the same function. What hemisphere rays own of these terms is read from
//! the vertices as ever.

use catoptric_light::irradiance::{Samples, Scratch};
use catoptric_light::{Lights, Receiver};
use catoptric_scene::Rgb;
use catoptric_solution::Quality;
use catoptric_trace::sequence::Key;

/// Where the light of sources comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DirectLight {
    /// From the vertices of the display mesh, where pass one stored it.
    Vertices,
    /// From the sources, by shadow rays at each hit.
    Pixels(ShadowRays),
}

/// Shadow rays, about: per emitter in sight, and per chain of mirrors by which sources are seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ShadowRays {
    /// At the first sample of a pixel, which also finds the penumbrae.
    pub first: u32,
    /// In a pixel where a penumbra was found.
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

/// Irradiance by sources at a hit.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SourceLight {
    pub(crate) direct: Rgb,
    pub(crate) mirrored: Rgb,
    /// What nothing blocks of both.
    pub(crate) unoccluded: Rgb,
    /// Some shadow rays were blocked and some were not.
    pub(crate) penumbra: bool,
}

impl SourceLight {
    /// By about `rays` shadow rays.
    pub(crate) fn at(
        lights: &Lights,
        receiver: &Receiver,
        rays: u32,
        key: Key,
        scratch: &mut Scratch,
    ) -> Self {
        let samples = Samples::exact(rays);
        let direct = lights.direct(receiver, samples, key, scratch);
        let mirrored = lights.mirrored(receiver, samples, direct.irradiance, key.child(1), scratch);
        Self {
            direct: direct.irradiance,
            mirrored: mirrored.irradiance,
            unoccluded: direct.unoccluded + mirrored.unoccluded,
            penumbra: direct.partial || mirrored.partial,
        }
    }
}
