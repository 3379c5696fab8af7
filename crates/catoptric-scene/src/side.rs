//! The two sides of a surface.

use glam::Vec3;

/// A side of a triangle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Side {
    /// Corners appear counter-clockwise.
    Front,
    /// The other one.
    Back,
}

impl Side {
    /// 0 for the front, 1 for the back.
    #[inline]
    pub fn index(self) -> usize {
        self as usize
    }

    /// `normal` (of the front) on this side.
    #[inline]
    pub fn orient(self, normal: Vec3) -> Vec3 {
        match self {
            Side::Front => normal,
            Side::Back => -normal,
        }
    }

    /// The other side.
    #[inline]
    pub fn opposite(self) -> Self {
        match self {
            Side::Front => Side::Back,
            Side::Back => Side::Front,
        }
    }
}
