//! What a ray travels in: air, or the inside of a solid glass.

use catoptric_scene::{MaterialId, Rgb, Scene};

/// Air, or the inside of a material's solids.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct MediumId(pub u16);

impl MediumId {
    /// Outside of everything: index 1, no absorption.
    pub const AIR: Self = Self(0);

    /// The inside of a material's solids.
    pub fn inside(material: MaterialId) -> Self {
        Self(u16::try_from(material.0 + 1).unwrap_or(u16::MAX))
    }
}

/// Nested media, innermost last. Entering pushes, leaving pops: a bubble in water in a bowl keeps track. Four levels;
/// deeper nesting forgets the outermost.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct MediumStack(u64);

impl MediumStack {
    /// In air.
    pub const AIR: Self = Self(0);

    /// Inside one medium, with air around it.
    pub fn inside(medium: MediumId) -> Self {
        Self(u64::from(medium.0))
    }

    /// The medium here.
    #[inline]
    pub fn current(self) -> MediumId {
        MediumId((self.0 & 0xffff) as u16)
    }

    /// After entering `medium`.
    #[inline]
    pub fn entered(self, medium: MediumId) -> Self {
        Self(self.0 << 16 | u64::from(medium.0))
    }

    /// After leaving `medium` through its own border, wherever it stands in the stack.
    #[inline]
    pub fn left(self, medium: MediumId) -> Self {
        let entries = [self.0 & 0xffff, self.0 >> 16 & 0xffff, self.0 >> 32 & 0xffff, self.0 >> 48];
        match entries.iter().position(|&e| e == u64::from(medium.0)) {
            None => self,
            Some(level) => {
                let shift = 16 * level as u32;
                let below = self.0 & ((1_u64 << shift) - 1);
                let above = if level == 3 { 0 } else { self.0 >> (shift + 16) << shift };
                Self(above | below)
            }
        }
    }
}

/// Optical constants per medium.
#[derive(Clone, Debug)]
pub struct Media {
    table: Vec<(f32, Rgb)>,
}

impl Media {
    /// Reads every material of the scene.
    pub fn new(scene: &Scene) -> Self {
        let mut table = vec![(1.0, Rgb::ZERO)];
        table.extend(scene.materials().iter().map(|m| (m.ior, m.absorption)));
        Self { table }
    }

    /// Index of refraction.
    #[inline]
    pub fn ior(&self, medium: MediumId) -> f32 {
        self.table.get(usize::from(medium.0)).map_or(1.0, |m| m.0)
    }

    /// (n_here / n_there)²: radiance grows where light enters a denser medium.
    #[inline]
    pub fn radiance_scale(&self, here: MediumId, there: MediumId) -> f32 {
        if here == there {
            return 1.0;
        }
        let ratio = self.ior(here) / self.ior(there);
        ratio * ratio
    }

    /// Beer–Lambert transmittance of `distance` metres.
    #[inline]
    pub fn transmittance(&self, medium: MediumId, distance: f32) -> Rgb {
        if medium == MediumId::AIR {
            return Rgb::ONE;
        }
        let sigma = self.table.get(usize::from(medium.0)).map_or(Rgb::ZERO, |m| m.1);
        if sigma == Rgb::ZERO {
            return Rgb::ONE;
        }
        let e = |s: f32| libm::expf(-s * distance);
        Rgb::new(e(sigma.x), e(sigma.y), e(sigma.z))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn leaving_takes_out_the_medium_that_is_left() {
        let [glass, water, oil] = [1, 2, 3].map(MediumId);
        let stack = MediumStack::AIR.entered(water).entered(glass);
        assert_eq!(stack.current(), glass);
        assert_eq!(stack.left(glass).current(), water);
        assert_eq!(stack.left(water).current(), glass);
        assert_eq!(stack.left(water).left(glass), MediumStack::AIR);
        assert_eq!(stack.left(oil), stack);
    }
}
