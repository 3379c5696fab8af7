//! Heckbert's path expressions, as far as ownership needs them: what happened between two diffuse ends.

use crate::plane::PlaneId;
use crate::slab::SlabId;

/// What one specular event did to the direction of light.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// A pane or blended alpha: straight on.
    Undeviated,
    /// Reflection at a plane that is large enough to have images.
    Planar(PlaneId),
    /// Reflection at a small flat mirror: alone it has an image, with others it is one of many.
    Facet(PlaneId),
    /// Reflection at a curved surface, or any refraction but those of sheets.
    Curved,
    /// Refraction into a sheet of glass, from air.
    Enters(SlabId),
    /// Refraction out of one, into air. Next after entering the same it undoes what that did to the direction.
    Leaves(SlabId),
}

/// Planar reflections that a chain remembers.
pub const MAX_PLANAR: usize = 8;

/// The events of a path between two diffuse ends, in the order in which they were met.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Chain {
    planes: [PlaneId; MAX_PLANAR],
    planar: u16,
    facets: u16,
    curved: u16,
    length: u16,
    /// Entered by the last event.
    slab: Option<SlabId>,
}

impl Default for Chain {
    fn default() -> Self {
        Self::DIRECT
    }
}

impl Chain {
    /// No event yet.
    pub const DIRECT: Self =
        Self { planes: [PlaneId::NONE; MAX_PLANAR], planar: 0, facets: 0, curved: 0, length: 0, slab: None };

    /// Appends an event.
    #[inline]
    pub fn push(&mut self, event: Event) {
        self.length = self.length.saturating_add(1);
        let entered = self.slab.take();
        if let (Some(slab), Event::Leaves(left)) = (entered, event)
            && slab == left
        {
            return;
        }
        // Light that was bent into a sheet does not go straight through it.
        self.curved = self.curved.saturating_add(entered.is_some().into());
        match event {
            Event::Undeviated => {}
            Event::Enters(slab) => self.slab = Some(slab),
            Event::Curved | Event::Leaves(_) => self.curved = self.curved.saturating_add(1),
            Event::Planar(plane) | Event::Facet(plane) => {
                self.facets = self.facets.saturating_add(matches!(event, Event::Facet(_)).into());
                if let Some(slot) = self.planes.get_mut(usize::from(self.planar)) {
                    *slot = plane;
                }
                self.planar = self.planar.saturating_add(1);
            }
        }
    }

    /// Whether any event was curved or refracting.
    #[inline]
    pub fn is_curved(&self) -> bool {
        self.curved > 0 || self.is_in_slab()
    }

    /// Whether the last event was to enter a sheet of glass: what comes next tells whether that was a bend.
    #[inline]
    pub fn is_in_slab(&self) -> bool {
        self.slab.is_some()
    }

    /// Number of events that were curved or refracting, without that.
    #[inline]
    pub fn curved_count(&self) -> usize {
        usize::from(self.curved)
    }

    /// Number of planar reflections, those at small mirrors among them.
    #[inline]
    pub fn planar_count(&self) -> usize {
        usize::from(self.planar)
    }

    /// Whether a small mirror is among them.
    #[inline]
    pub fn has_facets(&self) -> bool {
        self.facets > 0
    }

    /// Number of all events.
    #[inline]
    pub fn len(&self) -> usize {
        usize::from(self.length)
    }

    /// Whether nothing happened.
    #[inline]
    pub fn is_empty(&self) -> bool {
        self.length == 0
    }

    /// The events of the way back.
    #[must_use]
    pub fn reversed(mut self) -> Self {
        let count = usize::from(self.planar);
        if let Some(planes) = self.planes.get_mut(..count) {
            planes.reverse();
        }
        self
    }

    /// The planes of the planar reflections in order, `None` if there were more than are remembered.
    #[inline]
    pub fn planes(&self) -> Option<&[PlaneId]> {
        self.planes.get(..usize::from(self.planar))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(events: &[Event]) -> Chain {
        let mut chain = Chain::DIRECT;
        events.iter().for_each(|&event| chain.push(event));
        chain
    }

    #[test]
    fn what_enters_a_sheet_and_leaves_it_next_goes_straight() {
        let [own, other] = [SlabId(1), SlabId(2)];
        let through = [Event::Enters(own), Event::Leaves(own)];
        let mirror = Event::Planar(PlaneId(3));
        assert!(!of(&through).is_curved());
        assert_eq!(of(&through).len(), 2);
        let twice = [through, [Event::Enters(other), Event::Leaves(other)]].concat();
        assert!(!of(&twice).is_curved());
        let before_a_mirror = of(&[through.as_slice(), &[mirror], &through].concat());
        assert!(!before_a_mirror.is_curved());
        assert_eq!(before_a_mirror.planes(), Some([PlaneId(3)].as_slice()));
        // Whatever else happens within the glass, and what ends there, is bent.
        for within in [&[][..], &[Event::Curved], &[Event::Undeviated], &[mirror], &[Event::Enters(other)]] {
            let mut events = vec![Event::Enters(own)];
            events.extend(within);
            assert!(of(&events).is_curved(), "{events:?}");
            assert_eq!(of(&events).is_in_slab(), matches!(events.last(), Some(Event::Enters(_))));
            events.push(Event::Leaves(own));
            assert_eq!(of(&events).is_curved(), !within.is_empty(), "{events:?}");
        }
        assert!(of(&[Event::Leaves(own)]).is_curved());
        assert!(of(&[Event::Enters(own), Event::Leaves(other)]).is_curved());
        assert!(of(&[Event::Leaves(own), Event::Enters(own)]).is_curved());
    }
}
