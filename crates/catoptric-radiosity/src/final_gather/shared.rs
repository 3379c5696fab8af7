//! Vertices that take what they find from others.

use crate::display::Displayed;
use crate::gather::Gathered;
use crate::sharing::Sharing;

/// Gathers at the vertices of a display mesh, some of which are shared.
pub(super) struct SharedGathers<'a> {
    pub(super) sharing: &'a Sharing,
    /// Display vertex of each draft vertex.
    pub(super) shown: Vec<u32>,
}

impl<'a> SharedGathers<'a> {
    pub(super) fn new(sharing: &'a Sharing, displayed: &Displayed) -> Self {
        let count = displayed.origin.iter().max().map_or(0, |v| *v as usize + 1);
        let mut shown = vec![u32::MAX; count];
        for (index, &v) in displayed.origin.iter().enumerate() {
            shown[v as usize] = index as u32;
        }
        Self { sharing, shown }
    }

    pub(super) fn fill(&self, displayed: &Displayed, gathered: &mut [Gathered]) {
        self.mix(displayed, gathered, Gathered::add);
    }

    /// Gives every vertex that shares the weighted sum of those that it takes light from.
    pub(super) fn mix<T: Default>(
        &self,
        displayed: &Displayed,
        values: &mut [T],
        add: impl Fn(&mut T, &T, f32),
    ) {
        let mixed = |parts: &[(u32, f32)]| {
            let mut sum = T::default();
            for &(lead, weight) in parts {
                add(&mut sum, &values[self.shown[lead as usize] as usize], weight);
            }
            sum
        };
        // The leads, too, or their noise would stand out of what is around them.
        let leads: Vec<(u32, T)> = self
            .sharing
            .around_leads()
            .map(|(lead, parts)| (self.shown[lead as usize], mixed(parts)))
            .collect();
        let others = displayed.origin.iter().enumerate().filter(|(_, v)| !self.sharing.is_asked(**v));
        let others: Vec<(u32, T)> =
            others.map(|(index, &v)| (index as u32, mixed(self.sharing.parts(v)))).collect();
        for (index, value) in leads.into_iter().chain(others) {
            values[index as usize] = value;
        }
    }
}
