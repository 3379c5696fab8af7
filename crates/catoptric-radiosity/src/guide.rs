//! Where in the hemisphere a gather looks: more rays go to where those of the gathers beside differ from each other, such
//! as a patch of light that comes over a mirror, or the border of a bright wall.
//!
//! Cells of the unit square, which `cosine_hemisphere` maps, are strata (a histogram of the hemisphere as in Jensen 1995).
//! Rays are shared out in proportion to the deviation in each, which makes the variance of the sum least (Neyman 1934), over a
//! share that goes everywhere; each counts by the inverse of its density. A wrong guess costs rays, not light, as long as
//! no ray decides its own weight: a guide is made of what others found.

use glam::Vec2;

use crate::gather::Gathered;

/// Cells along a side of the unit square.
const SIDE: usize = 8;
/// Cells.
const CELLS: usize = SIDE * SIDE;
/// Share of rays that go everywhere alike: what no ray beside has met yet is at most two times as noisy as without a guide.
/// Half to a quarter make no difference in rooms.
const EVERYWHERE: f32 = 0.5;

/// Number of rays, sum and sum of squares of what they found.
#[derive(Clone, Copy, Debug, Default)]
struct Cell([f32; 3]);

impl Cell {
    #[inline]
    fn add(&mut self, other: Self, times: f32) {
        for (own, other) in self.0.iter_mut().zip(other.0) {
            *own += other * times;
        }
    }

    fn mean(self) -> f32 {
        let [count, sum, _] = self.0;
        if count > 0.0 { sum / count } else { 0.0 }
    }

    fn variance(self) -> f32 {
        let [count, _, squares] = self.0;
        if count > 0.0 { (squares / count - self.mean().powi(2)).max(0.0) } else { 0.0 }
    }
}

/// What rays found, by the cell that they came from.
#[derive(Clone, Debug)]
pub struct Findings([Cell; CELLS]);

impl Default for Findings {
    fn default() -> Self {
        Self([Cell::default(); CELLS])
    }
}

impl Findings {
    /// Adds the radiance that the ray from `point` of the unit square found.
    #[inline]
    pub fn add(&mut self, point: Vec2, radiance: f32) {
        self.0[cell_of(point)].add(Cell([1.0, radiance, radiance * radiance]), 1.0);
    }

    /// Variance of one ray beside that between the cells.
    pub fn variance(&self) -> f32 {
        self.0.iter().map(|cell| cell.variance()).sum::<f32>() / CELLS as f32
    }

    /// Adds all that others found.
    pub fn merge(&mut self, others: &Self) {
        for (own, &other) in self.0.iter_mut().zip(&others.0) {
            own.add(other, 1.0);
        }
    }

    /// Every cell with some of those around it: from beside, things are seen in slightly other directions.
    fn spread(&self) -> Self {
        const KERNEL: [(isize, f32); 3] = [(-1, 0.25), (0, 0.5), (1, 0.25)];
        let along = |from: &Self, step: usize| {
            let mut to = Self::default();
            for (index, cell) in to.0.iter_mut().enumerate() {
                let place = index / step % SIDE;
                for (offset, share) in KERNEL {
                    if let Some(at) = place.checked_add_signed(offset).filter(|&at| at < SIDE) {
                        cell.add(from.0[index - place * step + at * step], share);
                    }
                }
            }
            to
        };
        along(&along(self, 1), SIDE)
    }
}

/// What is known of the light besides, by cell: its part of the variance of one ray, whose radiance is in all channels.
#[derive(Clone, Debug)]
pub struct Hints([f32; CELLS]);

impl Default for Hints {
    fn default() -> Self {
        Self([0.0; CELLS])
    }
}

impl Hints {
    /// Adds to the variance of one ray what comes from a point of the unit square.
    #[inline]
    pub fn add(&mut self, point: Vec2, variance: f32) {
        self.0[cell_of(point)] += variance;
    }
}

/// The cell that holds a point of the unit square.
#[inline]
fn cell_of(point: Vec2) -> usize {
    let [x, y] = [point.x, point.y].map(|c| ((c * SIDE as f32) as usize).min(SIDE - 1));
    x * SIDE + y
}

/// A density of rays over the unit square, even inside each cell.
#[derive(Clone, Debug)]
pub struct Guide {
    /// Where the rows of cells begin, and 1.
    rows: [f32; SIDE + 1],
    /// Where the cells of each row begin, and 1.
    cells: [[f32; SIDE + 1]; SIDE],
    expected: Gathered,
    mean: f32,
    deviations: [f32; 2],
}

impl Guide {
    /// The guide that others' findings and hints suggest; `expected`: the irradiance that the others found in all.
    pub fn new(findings: &Findings, hints: &Hints, expected: Gathered) -> Self {
        let cells = findings.spread().0;
        let even = 1.0 / CELLS as f32;
        // Of one ray in the cell: what is hinted at may have been found.
        let deviations: [f32; CELLS] =
            std::array::from_fn(|cell| cells[cell].variance().max(hints.0[cell] / even).sqrt());
        let total: f32 = deviations.iter().sum();
        let share = |cell: usize| {
            // Neither nothing nor too much to compare.
            if total > 0.0 && total < f32::INFINITY {
                EVERYWHERE * even + (1.0 - EVERYWHERE) * deviations[cell] / total
            } else {
                even
            }
        };
        let mut guide = Self {
            rows: [1.0; SIDE + 1],
            cells: [[1.0; SIDE + 1]; SIDE],
            expected,
            mean: cells.iter().map(|cell| cell.mean()).sum::<f32>() * even,
            deviations: [0.0; 2],
        };
        let mut row_start = 0.0;
        for row in 0..SIDE {
            let shares: [f32; SIDE] = std::array::from_fn(|column| share(row * SIDE + column));
            let whole: f32 = shares.iter().sum();
            guide.rows[row] = row_start;
            row_start += whole;
            let mut start = 0.0;
            for (column, own) in shares.iter().enumerate() {
                guide.cells[row][column] = start;
                start += own / whole;
                let deviation = deviations[row * SIDE + column] * even;
                guide.deviations[0] += deviation * deviation / even;
                guide.deviations[1] += deviation * deviation / own;
            }
        }
        guide.deviations = guide.deviations.map(f32::sqrt);
        guide
    }

    /// Irradiance that others found: a control variate that is the same in all directions. Without it, rays that all find the
    /// same would differ by what they count.
    pub fn expected(&self) -> &Gathered {
        &self.expected
    }

    /// Mean radiance that others found.
    pub fn mean(&self) -> f32 {
        self.mean
    }

    /// Deviation to expect of the mean of N rays times √N, when they are stratified and go everywhere alike.
    pub fn even_deviation(&self) -> f32 {
        self.deviations[0]
    }

    /// The same when they follow the guide.
    pub fn deviation(&self) -> f32 {
        self.deviations[1]
    }

    /// Where the guide sends the ray of a uniform point of the unit square, and what it counts there: 1/density.
    #[inline]
    pub fn warp(&self, point: Vec2) -> (Vec2, f32) {
        let (x, row, width) = place(&self.rows, point.x);
        let (y, _, height) = place(&self.cells[row], point.y);
        (Vec2::new(x, y), 1.0 / (CELLS as f32 * width * height))
    }
}

/// Where `value` lies if the intervals between `bounds` were equal; which of them it is in, and how long that is.
#[inline]
fn place(bounds: &[f32; SIDE + 1], value: f32) -> (f32, usize, f32) {
    let index = bounds[1..SIDE].iter().filter(|&&bound| bound <= value).count();
    let length = bounds[index + 1] - bounds[index];
    // Below one: the next point of the unit square is in the next cell.
    let inside = ((value - bounds[index]) / length).clamp(0.0, 1.0 - f32::EPSILON);
    ((index as f32 + inside) / SIDE as f32, index, length)
}

#[cfg(test)]
mod tests {
    use catoptric_trace::sequence::{Key, Purpose};

    use super::*;

    /// A small bright spot on a slope.
    fn radiance(point: Vec2) -> f32 {
        let spot = (point - Vec2::new(0.7, 0.3)).length() < 0.08;
        point.x * 0.2 + if spot { 20.0 } else { 0.0 }
    }

    const EXACT: f32 = 0.1 + 20.0 * std::f32::consts::PI * 0.08 * 0.08;

    fn key(index: u64) -> Key {
        Key::new(7, Purpose::Test, index)
    }

    /// What four gathers of 64 rays beside found.
    fn findings(seed: u64) -> Findings {
        let mut findings = Findings::default();
        for gather in 0..4 {
            for index in 0..64 {
                let point = key(1000 + 4 * seed + gather).point2(index);
                findings.add(point, radiance(point));
            }
        }
        findings
    }

    /// Mean, and mean squared error, over many gathers of 64 rays.
    fn errors(guide: impl Fn(u64) -> Option<Guide>) -> [f32; 2] {
        let runs = 400;
        let (mut mean, mut square) = (0.0, 0.0);
        for run in 0..runs {
            let guide = guide(run);
            let sum: f32 = (0..64)
                .map(|index| {
                    let point = key(run).point2(index);
                    let (point, share) = guide.as_ref().map_or((point, 1.0), |guide| guide.warp(point));
                    radiance(point) * share
                })
                .sum();
            mean += sum / 64.0 / runs as f32;
            square += (sum / 64.0 - EXACT).powi(2) / runs as f32;
        }
        [mean, square]
    }

    #[test]
    fn guided_rays_find_the_same_with_less_noise() {
        let [even, guided] = [
            errors(|_| None),
            errors(|run| Some(Guide::new(&findings(run), &Hints::default(), Gathered::default()))),
        ];
        // Within three standard errors of the truth, and a third of the variance at most.
        for [mean, square] in [even, guided] {
            assert!((mean - EXACT).abs() < 3.0 * (square / 400.0).sqrt(), "{mean} of {EXACT}");
        }
        assert!(guided[1] < even[1] / 3.0, "{} of {}", guided[1], even[1]);
    }

    #[test]
    fn the_guide_knows_its_deviation() {
        // A guide that has seen many rays: spread cells overstate both deviations, by the same cause.
        let mut all = Findings::default();
        (0..50).for_each(|run| all.merge(&findings(run)));
        let guide = Guide::new(&all, &Hints::default(), Gathered::default());
        let measured =
            [errors(|_| None), errors(|_| Some(guide.clone()))].map(|[_, square]| (square * 64.0).sqrt());
        let expected = [guide.even_deviation(), guide.deviation()];
        for (measured, expected) in measured.into_iter().zip(expected) {
            assert!(expected > 0.8 * measured && expected < 3.0 * measured, "{expected} for {measured}");
        }
        assert!((guide.mean() - EXACT).abs() < 0.1 * EXACT, "{} of {EXACT}", guide.mean());
    }

    #[test]
    fn without_findings_all_directions_are_alike() {
        let guide = Guide::new(&Findings::default(), &Hints::default(), Gathered::default());
        assert_eq!([guide.mean(), guide.deviation(), guide.even_deviation()], [0.0; 3]);
        for index in 0..256 {
            let point = key(1).point2(index);
            let (to, share) = guide.warp(point);
            assert!((to - point).length() < 1e-6 && (share - 1.0).abs() < 1e-5, "{point} to {to}, {share}");
        }
    }
}
