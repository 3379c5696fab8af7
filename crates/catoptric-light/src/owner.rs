//! Who owns a light path: one function of its event chain, used by all passes (the table in ARCHITECTURE.md).

use catoptric_scene::{Sky, TriangleId};
use catoptric_trace::Chain;
use glam::Vec3;

use crate::irradiance::Lights;

/// Heckbert class of the events between a source and a diffuse receiver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PathClass {
    /// None, or only undeviated ones.
    Direct,
    /// Also planar reflections, of which one at a small mirror is alone.
    Mirrored,
    /// Any curved or refracting event, or several reflections, one of them at a small mirror.
    Caustic,
}

impl PathClass {
    /// The class of a chain.
    #[inline]
    pub fn of(chain: &Chain) -> Self {
        if chain.is_curved() || chain.has_facets() && chain.planar_count() > 1 {
            PathClass::Caustic
        } else if chain.planar_count() > 0 {
            PathClass::Mirrored
        } else {
            PathClass::Direct
        }
    }
}

/// Which computation accounts for a path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Owner {
    /// Emitter cells with shadow rays.
    EmitterCells,
    /// Cells of the sky with shadow rays.
    SkyCells,
    /// Emitter cells through an image chain of the list.
    ImageChain,
    /// Receivers that look for lamps in a lens.
    LensView,
    /// Light-side rays.
    LightRays,
    /// Hemisphere rays: whatever nobody else takes.
    Hemisphere,
}

/// What a path starts from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// A lamp, or a bright part of the sky: small in the view of most receivers.
    Concentrated,
    /// A whole glowing wall: hemisphere rays find it.
    Broad,
    /// The dim sky.
    Sky,
}

impl Lights<'_> {
    /// The owner of a path from `source` whose events are `chain`, in the order from the receiver on. Every path has exactly one; of those of light-side rays, receivers take what
    /// lamps send by way of a lens: [`Self::owner_from_lamp`].
    #[inline]
    pub fn owner(&self, source: Source, chain: &Chain) -> Owner {
        match (source, PathClass::of(chain)) {
            (Source::Broad, _) => Owner::Hemisphere,
            (Source::Sky, PathClass::Direct) => Owner::SkyCells,
            (Source::Sky, _) => Owner::Hemisphere,
            (Source::Concentrated, class) => self.owner_of_lamps(class, chain),
        }
    }

    /// The owner of a path that a light-side ray has found, whose events are `chain`, in the order from the source on.
    #[inline]
    pub fn owner_from_light(&self, chain: &Chain) -> Owner {
        self.owner(Source::Concentrated, &chain.reversed())
    }

    /// The same from a lamp: beyond that, whether receivers see it in a lens. `bend`: the curved or refracting surface that was the last to
    /// change its direction, if it was one.
    #[inline]
    pub fn owner_from_lamp(&self, chain: &Chain, bend: Option<TriangleId>) -> Owner {
        match self.owner_from_light(chain) {
            Owner::LightRays if bend.is_some_and(|t| self.lenses().hold(t)) => Owner::LensView,
            owner => owner,
        }
    }

    #[inline]
    fn owner_of_lamps(&self, class: PathClass, chain: &Chain) -> Owner {
        match class {
            PathClass::Direct => Owner::EmitterCells,
            PathClass::Mirrored => match chain.planes() {
                Some(planes) if self.chains().contains(planes) => Owner::ImageChain,
                _ if (chain.has_facets() || self.chains().are_cut_short()) && self.params().light_rays => {
                    Owner::LightRays
                }
                _ => Owner::Hemisphere,
            },
            PathClass::Caustic if self.params().light_rays => Owner::LightRays,
            PathClass::Caustic => Owner::Hemisphere,
        }
    }

    /// What a hit emitter counts as.
    #[inline]
    pub fn source_at(&self, triangle: TriangleId) -> Source {
        if self.emitters().is_broad(triangle) { Source::Broad } else { Source::Concentrated }
    }

    /// What the sky in a direction counts as.
    #[inline]
    pub fn sky_source(&self, sky: &Sky, direction: Vec3) -> Source {
        if self.bright_sky().holds(sky, direction) { Source::Concentrated } else { Source::Sky }
    }
}
