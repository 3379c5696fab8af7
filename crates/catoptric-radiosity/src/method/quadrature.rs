//! Gauss rules and the cells of an adaptive quadrature.

use std::cmp::Ordering;
use std::ops::Range;

use glam::DVec3;

/// Nodes and weights.
pub(super) type Rule = &'static [(f64, f64)];

/// Gauss–Legendre nodes and weights on [0, 1].
const GAUSS2: [(f64, f64); 2] = [(0.211_324_865_405_187_1, 0.5), (0.788_675_134_594_812_9, 0.5)];
const GAUSS3: [(f64, f64); 3] = [
    (0.112_701_665_379_258_31, 0.277_777_777_777_777_8),
    (0.5, 0.444_444_444_444_444_4),
    (0.887_298_334_620_741_7, 0.277_777_777_777_777_8),
];
const GAUSS4: [(f64, f64); 4] = [
    (0.069_431_844_202_973_71, 0.173_927_422_568_726_9),
    (0.330_009_478_207_571_9, 0.326_072_577_431_273_1),
    (0.669_990_521_792_428_1, 0.326_072_577_431_273_1),
    (0.930_568_155_797_026_3, 0.173_927_422_568_726_9),
];
const GAUSS5: [(f64, f64); 5] = [
    (0.046_910_077_030_668_0, 0.118_463_442_528_094_5),
    (0.230_765_344_947_158_45, 0.239_314_335_249_683_2),
    (0.5, 0.284_444_444_444_444_4),
    (0.769_234_655_052_841_5, 0.239_314_335_249_683_2),
    (0.953_089_922_969_332, 0.118_463_442_528_094_5),
];

/// Quadrature rules: what it is worth to know well takes the finer two.
pub(super) const FINE: [Rule; 2] = [&GAUSS4, &GAUSS5];
pub(super) const COARSE: [Rule; 2] = [&GAUSS2, &GAUSS3];

/// A triangle of a piece of the sender, and the numbers of reflections that are summed on it.
#[derive(Clone)]
pub(super) struct Place {
    pub(super) corners: [DVec3; 3],
    pub(super) piece: usize,
    pub(super) band: Range<usize>,
}

/// A place with its share of the integral and the difference of two rules on it.
pub(super) struct Cell {
    pub(super) place: Place,
    pub(super) values: Vec<DVec3>,
    pub(super) errors: Vec<f64>,
    /// What thin beams brought, which is where their rays happened to land.
    pub(super) landed: Vec<f64>,
    /// Worst error in units of what is aimed at.
    pub(super) score: f64,
    /// Order of creation: ties are broken the same way every time.
    pub(super) serial: usize,
}

impl PartialEq for Cell {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}
impl Eq for Cell {}
impl PartialOrd for Cell {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}
impl Ord for Cell {
    fn cmp(&self, other: &Self) -> Ordering {
        self.score.total_cmp(&other.score).then(other.serial.cmp(&self.serial))
    }
}

/// What two Gauss rules find on a cell.
pub(super) struct Integral {
    pub(super) values: Vec<DVec3>,
    pub(super) errors: Vec<f64>,
    pub(super) landed: Vec<f64>,
}
