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

/// What a ray found on a small bright place that is known.
#[derive(Clone, Copy, Debug)]
struct Bright {
    place: PlaceId,
    /// The cell that the ray came from.
    cell: u8,
    radiance: f32,
    even: f32,
    /// What the ray counts among all.
    share: f32,
}

/// What rays found, by the cell that they came from.
#[derive(Clone, Debug)]
pub struct Findings {
    /// All rays, and what those found that met no bright place.
    cells: [Cell; CELLS],
    bright: Vec<Bright>,
    rays: f32,
}

impl Default for Findings {
    fn default() -> Self {
        Self { cells: [Cell::default(); CELLS], bright: Vec::new(), rays: 0.0 }
    }
}

impl Findings {
    /// Adds the radiance that a ray found, and the bright place that it found it on.
    #[inline]
    pub fn add(&mut self, aim: &Aim, radiance: f32, place: Option<PlaceId>) {
        let (cell, even) = (cell_of(aim.point), aim.even);
        self.rays += 1.0;
        if let Some(place) = place {
            self.cells[cell].add(Cell([1.0, 0.0, 0.0]), even);
            self.bright.push(Bright { place, cell: cell as u8, radiance, even, share: aim.share });
        } else {
            self.cells[cell].add(Cell([1.0, radiance, radiance * radiance]), even);
        }
    }

    /// Variance of one ray beside that between the cells and that by bright places.
    pub fn variance(&self) -> f32 {
        self.cells.iter().map(|cell| cell.variance()).sum::<f32>() / CELLS as f32
    }

    /// Adds all that others found.
    pub fn merge(&mut self, others: &Self) {
        for (own, &other) in self.cells.iter_mut().zip(&others.cells) {
            own.add(other, 1.0);
        }
        self.bright.extend_from_slice(&others.bright);
        self.rays += others.rays;
    }
}

/// Every cell with some of those around it: from beside, things are seen in slightly other directions.
fn spread(cells: &[Cell; CELLS]) -> [Cell; CELLS] {
    const KERNEL: [(isize, f32); 3] = [(-1, 0.25), (0, 0.5), (1, 0.25)];
    let along = |from: &[Cell; CELLS], step: usize| {
        let mut to = [Cell::default(); CELLS];
        for (index, cell) in to.iter_mut().enumerate() {
            let place = index / step % SIDE;
            for (offset, share) in KERNEL {
                if let Some(at) = place.checked_add_signed(offset).filter(|&at| at < SIDE) {
                    cell.add(from[index - place * step + at * step], share);
                }
            }
        }
        to
    };
    along(&along(cells, 1), SIDE)
}

/// Index of a small bright place, of those that a scene is known to have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PlaceId(pub u16);

/// A rectangle of the unit square in which a small bright place is seen.
#[derive(Clone, Copy, Debug, Default)]
pub struct Window {
    low: Vec2,
    high: Vec2,
    /// What it adds to the variance of one ray that goes everywhere alike.
    variance: f32,
    /// What it may add that nobody saw: rays are sent there, but no more rays in all.
    unseen: f32,
}

impl Window {
    /// Around points of the unit square.
    pub fn around(points: impl Iterator<Item = Vec2>) -> Self {
        let (low, high) = points.fold((Vec2::ONE, Vec2::ZERO), |(low, high), p| (low.min(p), high.max(p)));
        Self { low, high, variance: 0.0, unseen: 0.0 }
    }

    /// Share of the unit square.
    #[inline]
    pub fn area(&self) -> f32 {
        let [width, height] = (self.high - self.low).to_array();
        width * height
    }

    /// Whether it is worth its while: the cells tell as much of what is large.
    pub fn is_small(&self) -> bool {
        let area = self.area();
        area > 0.0 && area <= LARGEST / CELLS as f32
    }

    #[inline]
    fn contains(&self, point: Vec2) -> bool {
        point.cmpge(self.low).all() && point.cmple(self.high).all()
    }

    /// Whether it overlaps a cell or one of those around it: what was found from beside was seen in slightly other directions.
    fn is_near(&self, cell: usize) -> bool {
        let cell = Vec2::new((cell / SIDE) as f32, (cell % SIDE) as f32);
        let side = SIDE as f32;
        (cell + 2.0).cmpgt(self.low * side).all() && (cell - 1.0).cmplt(self.high * side).all()
    }
}

/// Area of a window at most, in cells. (Four times as much sends more rays for the same errors, half as much costs two to five hundredths of them.)
const LARGEST: f32 = 1.0;
/// Windows of a guide at most.
pub const WINDOWS: usize = 16;

/// What is known of the light besides.
#[derive(Clone, Debug)]
pub struct Hints {
    /// By cell: its part of the variance of one ray, whose radiance is in all channels.
    cells: [f32; CELLS],
    windows: [(Option<PlaceId>, Window); WINDOWS],
}

impl Default for Hints {
    fn default() -> Self {
        Self { cells: [0.0; CELLS], windows: [(None, Window::default()); WINDOWS] }
    }
}

impl Hints {
    /// Says where a bright place may be seen, and what it may add to the variance of one ray though no look sees it. The first
    /// [`WINDOWS`] get rays.
    pub fn open(&mut self, place: PlaceId, window: Window, unseen: f32) {
        if let Some(free) = self.windows.iter_mut().find(|(known, _)| known.is_none()) {
            *free = (Some(place), Window { unseen, ..window });
        }
    }

    /// Adds to the variance of one ray what comes from a point of the unit square, in one of the windows or in none of them.
    #[inline]
    pub fn add(&mut self, window: Option<usize>, point: Vec2, variance: f32) {
        match window {
            Some(index) => self.windows[index].1.variance += variance,
            None => self.cells[cell_of(point)] += variance,
        }
    }
}

/// The cell that holds a point of the unit square.
#[inline]
fn cell_of(point: Vec2) -> usize {
    let [x, y] = [point.x, point.y].map(|c| ((c * SIDE as f32) as usize).min(SIDE - 1));
    x * SIDE + y
}

/// How a ray is sent.
#[derive(Clone, Copy, Debug)]
pub struct Aim {
    /// The point of the unit square that stands for its direction.
    pub point: Vec2,
    /// What it counts: 1/density.
    pub share: f32,
    /// What it counts among those in the same cell, where they are to tell what rays find that are even inside it.
    pub even: f32,
}

impl Aim {
    /// As all others.
    #[inline]
    pub fn even(point: Vec2) -> Self {
        Self { point, share: 1.0, even: 1.0 }
    }
}

/// A density of rays over the unit square, even inside each cell but for small windows.
#[derive(Clone, Debug)]
pub struct Guide {
    /// Where the rows of cells begin, and 1.
    rows: [f32; SIDE + 1],
    /// Where the cells of each row begin, and 1.
    cells: [[f32; SIDE + 1]; SIDE],
    /// Share of the rays that follow the cells; the windows get the others.
    in_cells: f32,
    /// The windows, with the share of each.
    windows: [(Window, f32); WINDOWS],
    count: usize,
    expected: Gathered,
    mean: f32,
    deviations: [f32; 2],
}

impl Guide {
    /// The guide that others' findings and hints suggest; `expected`: the irradiance that the others found in all.
    pub fn new(findings: &Findings, hints: &Hints, expected: Gathered) -> Self {
        let even = 1.0 / CELLS as f32;
        let mut cells = findings.cells;
        let mut mean = 0.0;
        // What was found on places that have windows is theirs.
        let mut found = [0.0_f32; WINDOWS];
        for hit in &findings.bright {
            let cell = usize::from(hit.cell);
            let is_there = |(place, window): &(Option<PlaceId>, Window)| {
                *place == Some(hit.place) && window.is_near(cell)
            };
            if let Some(window) = hints.windows.iter().position(is_there) {
                // Not by the cell: where a window overlaps a corner of it, all rays in it may be the window's.
                let share = hit.share / findings.rays;
                mean += hit.radiance * share;
                found[window] += hit.radiance * hit.radiance * share;
            } else {
                cells[cell].add(Cell([0.0, hit.radiance, hit.radiance * hit.radiance]), hit.even);
            }
        }
        let cells = spread(&cells);
        let mut windows = [(Window::default(), 0.0); WINDOWS];
        let mut count = 0;
        for ((_, window), found) in hints.windows.iter().zip(found) {
            // What is hinted at may have been found.
            let variance = window.variance.max(found);
            let deviation = (variance.max(window.unseen) * window.area()).sqrt();
            if deviation > 0.0 {
                windows[count] = (Window { variance, ..*window }, deviation);
                count += 1;
            }
        }
        // Of one ray in the cell.
        let deviations: [f32; CELLS] =
            std::array::from_fn(|cell| cells[cell].variance().max(hints.cells[cell] / even).sqrt());
        let total: f32 = deviations.iter().sum::<f32>() + windows.iter().map(|w| w.1).sum::<f32>() / even;
        // Neither nothing nor too much to compare.
        let is_known = total > 0.0 && total < f32::INFINITY;
        let follow = |deviation: f32| if is_known { (1.0 - EVERYWHERE) * deviation / total } else { 0.0 };
        let everywhere = if is_known { EVERYWHERE } else { 1.0 };
        let mut in_cells = 1.0;
        for (_, share) in &mut windows[..count] {
            *share = follow(*share / even);
            in_cells -= *share;
        }
        mean += cells.iter().map(|cell| cell.mean()).sum::<f32>() * even;
        let mut guide = Self {
            rows: [1.0; SIDE + 1],
            cells: [[1.0; SIDE + 1]; SIDE],
            in_cells,
            windows,
            count,
            expected,
            mean,
            deviations: [0.0; 2],
        };
        let mut row_start = 0.0;
        for row in 0..SIDE {
            let shares: [f32; SIDE] =
                std::array::from_fn(|column| everywhere * even + follow(deviations[row * SIDE + column]));
            let whole: f32 = shares.iter().sum();
            guide.rows[row] = row_start;
            row_start += whole / in_cells;
            let mut start = 0.0;
            for (column, own) in shares.iter().enumerate() {
                guide.cells[row][column] = start;
                start += own / whole;
                let deviation = deviations[row * SIDE + column] * even;
                guide.deviations[0] += deviation * deviation / even;
                guide.deviations[1] += deviation * deviation / own;
            }
        }
        for (window, share) in &guide.windows[..count] {
            let area = window.area();
            guide.deviations[0] += window.variance;
            guide.deviations[1] += window.variance * area / (share + everywhere * area);
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

    /// Where the guide sends the ray of a uniform point of the unit square.
    #[inline]
    pub fn warp(&self, point: Vec2) -> Aim {
        if self.count == 0 {
            let (point, density) = self.in_cell(point);
            return Aim { point, share: 1.0 / density, even: 1.0 };
        }
        let windows = &self.windows[..self.count];
        let (point, cells) = if point.x < self.in_cells {
            self.in_cell(Vec2::new(below_one(point.x / self.in_cells), point.y))
        } else {
            let (mut rest, mut index) = (point.x - self.in_cells, 0);
            while index + 1 < windows.len() && rest >= windows[index].1 {
                rest -= windows[index].1;
                index += 1;
            }
            let (window, share) = windows[index];
            let inside = Vec2::new(below_one(rest / share), point.y);
            let point = window.low + (window.high - window.low) * inside;
            let cell = cell_of(point);
            (point, self.density(cell / SIDE, cell % SIDE))
        };
        let cells = cells * self.in_cells;
        let there = windows.iter().filter(|(window, _)| window.contains(point));
        let density = cells + there.map(|(window, share)| share / window.area()).sum::<f32>();
        Aim { point, share: 1.0 / density, even: cells / density }
    }

    /// Where the cells alone send the ray of a uniform point, and their density there.
    #[inline]
    fn in_cell(&self, point: Vec2) -> (Vec2, f32) {
        let (x, row) = place(&self.rows, point.x);
        let (y, column) = place(&self.cells[row], point.y);
        (Vec2::new(x, y), self.density(row, column))
    }

    /// Density of the rays that follow the cells.
    #[inline]
    fn density(&self, row: usize, column: usize) -> f32 {
        let [width, height] = [(&self.rows, row), (&self.cells[row], column)].map(|(b, i)| b[i + 1] - b[i]);
        CELLS as f32 * width * height
    }
}

/// Where `value` lies if the intervals between `bounds` were equal, and which of them it is in.
#[inline]
fn place(bounds: &[f32; SIDE + 1], value: f32) -> (f32, usize) {
    let index = bounds[1..SIDE].iter().filter(|&&bound| bound <= value).count();
    let inside = below_one((value - bounds[index]) / (bounds[index + 1] - bounds[index]));
    ((index as f32 + inside) / SIDE as f32, index)
}

/// At 1 the next point of the unit square would be in the next cell.
#[inline]
fn below_one(value: f32) -> f32 {
    value.clamp(0.0, 1.0 - f32::EPSILON)
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
                findings.add(&Aim::even(point), radiance(point), None);
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
                    let aim = guide.as_ref().map_or(Aim::even(point), |guide| guide.warp(point));
                    radiance(aim.point) * aim.share
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

    /// A place of a tenth of a cell, at which every second ray finds twice as much.
    const PLACE: Vec2 = Vec2::new(0.31, 0.56);
    const HALF: f32 = 0.02;

    fn bright(point: Vec2) -> Option<f32> {
        let away = (point - PLACE).abs();
        let found = if away.x < 0.5 * HALF { 400.0 } else { 200.0 };
        (away.max_element() < HALF).then_some(found)
    }

    fn find(findings: &mut Findings, aim: &Aim) {
        let radiance = aim.point.x * 0.2 + bright(aim.point).unwrap_or(0.0);
        findings.add(aim, radiance, bright(aim.point).map(|_| PlaceId(3)));
    }

    #[test]
    fn windows_find_what_is_small_with_little_noise() {
        let exact = 0.1 + 300.0 * (2.0 * HALF).powi(2);
        let window = Window::around([PLACE - 1.2 * HALF, PLACE + 1.2 * HALF].into_iter());
        let mut hints = Hints::default();
        hints.open(PlaceId(3), window, 0.0);
        // Four gathers of 64 rays found what they found; somebody looked and saw it.
        let squares = 0.5 * (400.0_f32.powi(2) + 200.0_f32.powi(2)) * (2.0 * HALF).powi(2);
        hints.add(Some(0), PLACE, squares);
        let guide = |run: u64, hints: &Hints| {
            let mut findings = Findings::default();
            (0..256).for_each(|i| find(&mut findings, &Aim::even(key(1000 + run).point2(i))));
            Guide::new(&findings, hints, Gathered::default())
        };
        let runs: u16 = 200;
        let errors = |hints: &Hints| {
            let (mut mean, mut square) = (0.0, 0.0);
            for run in 0..u64::from(runs) {
                let guide = guide(run, hints);
                let sum: f32 = (0..64)
                    .map(|i| guide.warp(key(run).point2(i)))
                    .map(|aim| (aim.point.x * 0.2 + bright(aim.point).unwrap_or(0.0)) * aim.share)
                    .sum();
                mean += sum / 64.0 / f32::from(runs);
                square += (sum / 64.0 - exact).powi(2) / f32::from(runs);
            }
            // Within three standard errors of the truth.
            assert!((mean - exact).abs() < 3.0 * (square / f32::from(runs)).sqrt(), "{mean} of {exact}");
            square
        };
        let mut cell = Hints::default();
        cell.add(None, PLACE, squares);
        // The window has a sixth of the cell's area, and as much of the variance within it; the rest of the light has next to none.
        let [by_cell, by_window] = [errors(&cell), errors(&hints)];
        assert!(by_window < by_cell / 4.0, "{by_window} of {by_cell}");
    }

    /// What guided rays find tells of the same light as what even ones find, though every third is sent to one place.
    #[test]
    fn rays_of_windows_do_not_count_more_among_findings() {
        let window = Window::around([PLACE - 1.2 * HALF, PLACE + 1.2 * HALF].into_iter());
        let mut hints = Hints::default();
        hints.open(PlaceId(3), window, 100.0);
        let guide = Guide::new(&Findings::default(), &hints, Gathered::default());
        let [mut even, mut guided] = [Findings::default(), Findings::default()];
        let mut in_window = 0;
        for index in 0..1 << 16 {
            let point = key(1).point2(index);
            find(&mut even, &Aim::even(point));
            let aim = guide.warp(point);
            in_window += u32::from(window.contains(aim.point));
            find(&mut guided, &aim);
        }
        assert!(in_window > 1 << 14, "{in_window}");
        // Of 105 even rays on the place the squares deviate by 0.6/√105, 6 %.
        for hints in [&hints, &Hints::default()] {
            let [even, guided] = [&even, &guided].map(|f| Guide::new(f, hints, Gathered::default()));
            for (one, other) in
                [(even.mean(), guided.mean()), (even.even_deviation(), guided.even_deviation())]
            {
                assert!((one / other - 1.0).abs() < 0.12, "{one} {other}");
            }
        }
    }

    /// Where a place lies across the corners of cells, most of those hold no rays but the window's.
    #[test]
    fn few_guided_rays_tell_of_a_place_what_many_do() {
        let corner = Vec2::new(3.0, 4.0) / SIDE as f32;
        let is_there = |point: Vec2| (point - corner).abs().max_element() < HALF;
        let mut hints = Hints::default();
        hints.open(PlaceId(3), Window::around([corner - 1.5 * HALF, corner + 1.5 * HALF].into_iter()), 100.0);
        let guide = Guide::new(&Findings::default(), &hints, Gathered::default());
        let runs: u16 = 400;
        let (mut mean, mut variance) = (0.0, 0.0);
        for run in 0..u64::from(runs) {
            let mut findings = Findings::default();
            for index in 0..32 {
                let aim = guide.warp(key(run).point2(index));
                let found = if is_there(aim.point) { 300.0 } else { 0.0 };
                findings.add(&aim, found, is_there(aim.point).then_some(PlaceId(3)));
            }
            let told = Guide::new(&findings, &hints, Gathered::default());
            mean += told.mean() / f32::from(runs);
            variance += told.even_deviation().powi(2) / f32::from(runs);
        }
        // Of the 32 rays 7 meet it, binomially: √(1/7 · 25/32) = 33 % each time, 2 % in all. Five times that.
        let exact = 300.0 * (2.0 * HALF).powi(2);
        assert!((mean / exact - 1.0).abs() < 0.1, "{mean} of {exact}");
        assert!((variance / (300.0 * exact) - 1.0).abs() < 0.1, "{variance} of {}", 300.0 * exact);
    }

    #[test]
    fn without_findings_all_directions_are_alike() {
        let guide = Guide::new(&Findings::default(), &Hints::default(), Gathered::default());
        assert_eq!([guide.mean(), guide.deviation(), guide.even_deviation()], [0.0; 3]);
        for index in 0..256 {
            let point = key(1).point2(index);
            let Aim { point: to, share, .. } = guide.warp(point);
            assert!((to - point).length() < 1e-6 && (share - 1.0).abs() < 1e-5, "{point} to {to}, {share}");
        }
    }
}
