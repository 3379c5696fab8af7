//! Light of sources at the centres of pixels: evaluated at some, interpolated between those where it is smooth.
//!
//! The picture is divided into cells of [`CELL`] pixels a side. Where the paths through the corners and the middle of a cell ask for light at the same
//! places, and what they get hardly bends between them, the paths inside get what lies between. Other cells are divided again.
//! (Adaptive subdivision in image space: Whitted 1980.) Keys in docs/references.md: Whitted1980.

use rayon::prelude::*;

use catoptric_light::Lights;
use catoptric_scene::quantity::LUMINANCE;
use catoptric_scene::{Progress, Rgb};

use crate::direct::{Part, Shadows, SourceLight};
use crate::irradiance_cache::Request;
use crate::layers::Kept;
use crate::pixel::{Sample, Scratch};

/// Pixels along a side of a cell.
const CELL: usize = 4;
/// What the middle of a cell may differ by from what its corners tell, relative to all light that arrives there. The error between is half of it
/// where light bends evenly. (By measurement, against every pixel by itself: squared error, relative, of 1e-9 to 1e-6 of a picture, less than its own.)
const BENT: f32 = 0.02;
/// What its corners may differ by: where light changes fast, it may begin or end to do so anywhere between.
const STEEP: f32 = 0.3;
/// … and in deviations of what rays find: differences of so many are noise.
const CHANCE: f32 = 1.0;
/// Requests that are evaluated in one parallel job.
const JOB: usize = 4;

/// Finds what some of the pixels of so many columns and rows ask for, by few shadow rays or by many: `asking` are their numbers, ascending.
pub(crate) fn find(
    lights: &Lights,
    (asking, requests): (&[usize], &[Box<[Request]>]),
    (size, by_few): ([usize; 2], bool),
    progress: &dyn Progress,
) -> Vec<Box<[SourceLight]>> {
    if asking.is_empty() {
        return Vec::new();
    }
    let mut slots = vec![NONE; size[0] * size[1]];
    for (slot, &pixel) in asking.iter().enumerate() {
        slots[pixel] = slot as u32;
    }
    let mut band = Band { size, by_few, slots, requests, found: vec![Box::default(); requests.len()] };
    band.find(lights, progress);
    band.found
}

/// Slot of a pixel that does not ask.
const NONE: u32 = u32::MAX;

/// Adds what was found to a pixel without it.
pub(crate) fn add<L: Kept>(pixel: &mut Sample<L>, requests: &[Request], found: &[SourceLight]) {
    let mut shadows = Shadows::default();
    for (request, found) in requests.iter().zip(found) {
        shadows.add(&mut pixel.light, (request.send, request.through), request.wanted, found);
    }
    let Shadows { blocked, penumbra, grain } = shadows;
    *pixel = Sample { open: pixel.light.beauty() + blocked, penumbra, grain, ..*pixel };
}

/// Some rows of a picture.
struct Band<'a> {
    /// Columns and rows.
    size: [usize; 2],
    /// By few rays: what they find is in doubt where it is interpolated.
    by_few: bool,
    /// Per pixel: its place in the following lists, or none.
    slots: Vec<u32>,
    requests: &'a [Box<[Request]>],
    /// What was found so far.
    found: Vec<Box<[SourceLight]>>,
}

/// Pixels between two columns and rows, these included.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Cell {
    low: [usize; 2],
    high: [usize; 2],
}

/// What becomes of a cell.
enum Fate {
    /// Slots of its own have these.
    Smooth(Vec<(usize, Box<[SourceLight]>)>),
    /// It is divided.
    Divided,
}

impl Cell {
    fn middle(&self) -> [usize; 2] {
        [0, 1].map(|axis| usize::midpoint(self.low[axis], self.high[axis]))
    }

    /// Its corners and its middle.
    fn knots(&self) -> [[usize; 2]; 5] {
        let Self { low, high } = self;
        [*low, [high[0], low[1]], [low[0], high[1]], *high, self.middle()]
    }

    /// The cells between its corners, the middles of its sides and its own.
    fn parts(self) -> impl Iterator<Item = Self> {
        let [columns, rows] = [0, 1].map(|axis| {
            let [low, middle, high] = [self.low[axis], self.middle()[axis], self.high[axis]];
            // Where it is one pixel wide, or two, one of them is all of it.
            let first = usize::from(low == middle);
            [(low, middle), (middle, high)].into_iter().skip(first)
        });
        rows.flat_map(move |y| columns.clone().map(move |x| Self { low: [x.0, y.0], high: [x.1, y.1] }))
    }

    /// Bilinear weights of the corners at a pixel.
    fn bilinear(&self, at: [usize; 2]) -> [f32; 4] {
        let [u, v] = [0, 1].map(|axis| {
            let length = (self.high[axis] - self.low[axis]).max(1);
            (at[axis] - self.low[axis]) as f32 / length as f32
        });
        [(1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v]
    }

    /// Weights of the corners and of the middle at a pixel: bilinear, and what is as round as a bowl on it that meets the middle. Light that bends
    /// one way only is missed by half of that, at the middles of the sides.
    fn weights(&self, at: [usize; 2]) -> [f32; 5] {
        let middle = self.middle();
        let (mut bowl, mut ways, mut share) = (0.0, 0.0, 1.0);
        for axis in 0..2 {
            let [low, middle, high, at] = [self.low[axis], middle[axis], self.high[axis], at[axis]];
            if middle == low {
                // No pixels lie between, and the middle is on the side.
                share *= if at == low { 1.0 } else { 0.0 };
                continue;
            }
            let reach = if at < middle { middle - low } else { high - middle };
            bowl += (at.abs_diff(middle) as f32 / reach as f32).powi(2);
            ways += 1.0;
        }
        let bent = if ways > 0.0 { share * (1.0 - bowl / ways) } else { share };
        let [plain, below] = [self.bilinear(at), self.bilinear(middle)];
        let [a, b, c, d] = std::array::from_fn(|corner| plain[corner] - bent * below[corner]);
        [a, b, c, d, bent]
    }
}

impl Band<'_> {
    fn slot(&self, [x, y]: [usize; 2]) -> Option<usize> {
        let slot = self.slots[y * self.size[0] + x];
        (slot != NONE).then_some(slot as usize)
    }

    /// Where nothing is found yet, of some pixels.
    fn open(&self, pixels: impl Iterator<Item = [usize; 2]>) -> impl Iterator<Item = ([usize; 2], usize)> {
        pixels.filter_map(|at| Some((at, self.slot(at)?))).filter(|&(_, slot)| self.found[slot].is_empty())
    }

    /// Pixels of a cell that are its own: the last column and row belong to the next cell, if there is one.
    fn own(&self, cell: &Cell) -> impl Iterator<Item = [usize; 2]> + use<> {
        let end = [0, 1].map(|axis| {
            let high = cell.high[axis];
            high + usize::from(high + 1 == self.size[axis])
        });
        let (low, [right, bottom]) = (cell.low, end);
        (low[1]..bottom).flat_map(move |y| (low[0]..right).map(move |x| [x, y]))
    }

    /// Finds what every pixel asks for.
    fn find(&mut self, lights: &Lights, progress: &dyn Progress) {
        let lines = |count: usize| -> Vec<usize> {
            let mut lines: Vec<usize> = (0..count).step_by(CELL).chain(count.checked_sub(1)).collect();
            lines.dedup();
            lines
        };
        let [columns, rows] = self.size.map(lines);
        let spans = |lines: &[usize]| -> Vec<(usize, usize)> {
            match lines {
                [only] => vec![(*only, *only)],
                _ => lines.windows(2).map(|pair| (pair[0], pair[1])).collect(),
            }
        };
        let columns = spans(&columns);
        let all = spans(&rows).into_iter().flat_map(|y| columns.iter().map(move |&x| (x, y)));
        let mut cells: Vec<Cell> = all.map(|(x, y)| Cell { low: [x.0, y.0], high: [x.1, y.1] }).collect();
        while !cells.is_empty() {
            let is_open = |cell: &Cell| self.open(self.own(cell)).next().is_some();
            cells = cells.into_par_iter().with_min_len(256).filter(is_open).collect();
            let knots = cells.iter().flat_map(Cell::knots);
            self.evaluate(self.open(knots).map(|(_, slot)| slot).collect(), lights, progress);
            if progress.is_cancelled() {
                return;
            }
            let fates: Vec<Fate> = cells.par_iter().with_min_len(64).map(|cell| self.fate(cell)).collect();
            let mut next = Vec::new();
            let mut rest = Vec::new();
            for (cell, fate) in cells.into_iter().zip(fates) {
                match fate {
                    Fate::Smooth(found) => {
                        found.into_iter().for_each(|(slot, found)| self.found[slot] = found);
                        rest.extend(self.open(self.own(&cell)).map(|(_, slot)| slot));
                    }
                    Fate::Divided => next.extend(cell.parts()),
                }
            }
            self.evaluate(rest, lights, progress);
            cells = next;
        }
    }

    /// Evaluates what some slots ask for.
    fn evaluate(&mut self, mut slots: Vec<usize>, lights: &Lights, progress: &dyn Progress) {
        slots.sort_unstable();
        slots.dedup();
        let evaluate = |scratch: &mut Scratch, &slot: &usize| {
            if progress.is_cancelled() {
                return Box::default();
            }
            let requests = self.requests[slot].iter();
            requests.map(|request| request.evaluate(lights, &mut scratch.sources.light)).collect()
        };
        let found: Vec<Box<[SourceLight]>> =
            slots.par_iter().with_max_len(JOB).map_init(Scratch::default, evaluate).collect();
        for (slot, found) in slots.into_iter().zip(found) {
            self.found[slot] = found;
        }
    }

    /// Whether two slots ask for light at the same places.
    fn are_alike(&self, one: usize, other: usize) -> bool {
        let places = |slot: usize| self.requests[slot].iter().map(|request| request.place);
        places(one).eq(places(other))
    }

    fn fate(&self, cell: &Cell) -> Fate {
        let [Some(a), Some(b), Some(c), Some(d), Some(middle)] = cell.knots().map(|at| self.slot(at)) else {
            return Fate::Divided;
        };
        let knots = [a, b, c, d, middle];
        let is_smooth = knots.iter().all(|&knot| self.are_alike(a, knot))
            && (0..self.requests[a].len()).all(|request| self.is_smooth(cell, knots, request));
        if !is_smooth {
            return Fate::Divided;
        }
        let alike = self.open(self.own(cell)).filter(|&(_, slot)| self.are_alike(a, slot));
        let between = alike.filter_map(|(at, slot)| {
            let weights = cell.weights(at);
            let is_as_expected = |(index, request): (usize, &Request)| {
                let around = knots.iter().zip(weights);
                let arriving = around.map(|(&knot, weight)| self.requests[knot][index].arriving * weight);
                request.is_as_expected(arriving.sum())
            };
            let are_as_expected = self.requests[slot].iter().enumerate().all(is_as_expected);
            are_as_expected.then(|| (slot, self.between(knots, weights)))
        });
        Fate::Smooth(between.collect())
    }

    /// Whether what a cell's corners and middle found for one request hardly bends.
    fn is_smooth(&self, cell: &Cell, knots: [usize; 5], request: usize) -> bool {
        let below = cell.bilinear(cell.middle());
        let arriving = knots.map(|knot| self.requests[knot][request].arriving);
        let level = arriving.into_iter().fold(f32::INFINITY, f32::min);
        let found = knots.map(|knot| self.found[knot][request]);
        [found.map(|found| found.direct), found.map(|found| found.mirrored)].iter().all(|parts| {
            let luminance = parts.map(|part| part.irradiance.dot(LUMINANCE));
            let variance = parts.map(|part| (0.5 * part.split.dot(LUMINANCE)).powi(2));
            let [corners @ .., middle] = &luminance;
            let between: f32 = corners.iter().zip(below).map(|(light, weight)| light * weight).sum();
            let [noises @ .., noise] = &variance;
            let noises: f32 = noises.iter().zip(below).map(|(noise, weight)| noise * weight * weight).sum();
            let noise = (noise + noises).sqrt();
            let [low, high] =
                [f32::min, f32::max].map(|pick| luminance.into_iter().reduce(pick).unwrap_or_default());
            let most_noise = variance.into_iter().fold(0.0, f32::max).sqrt();
            (middle - between).abs() <= BENT * level + CHANCE * noise
                && high - low <= STEEP * level + CHANCE * most_noise
        })
    }

    /// What lies between.
    fn between(&self, knots: [usize; 5], weights: [f32; 5]) -> Box<[SourceLight]> {
        let part = |parts: [Part; 5]| {
            let mut sum = Part::default();
            let mut squares = Rgb::ZERO;
            for (part, weight) in parts.into_iter().zip(weights) {
                sum.irradiance += part.irradiance * weight;
                sum.unoccluded += part.unoccluded * weight;
                // Noise that neighbours share is seen as that of each would be.
                squares += part.split * part.split * weight.abs();
                // Few rays that were not blocked tell nothing of those between.
                sum.penumbra |= part.penumbra || self.by_few && part.sampled;
                sum.sampled |= part.sampled;
            }
            sum.irradiance = sum.irradiance.max(Rgb::ZERO);
            Part { split: squares.map(f32::sqrt), ..sum }
        };
        let of = |request: usize| {
            let found = knots.map(|knot| self.found[knot][request]);
            let [direct, mirrored] =
                [found.map(|found| found.direct), found.map(|found| found.mirrored)].map(part);
            SourceLight { direct, mirrored }
        };
        (0..self.requests[knots[0]].len()).map(of).collect()
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use catoptric_light::irradiance::Samples;
    use catoptric_light::{LightParams, Receiver};
    use catoptric_scene::{Barycentric, Material, Radiance, Scene, SceneParts, Side, Silent, TriangleId};
    use catoptric_trace::Tracer;
    use catoptric_trace::sequence::{Key, Purpose};
    use catoptric_trace::walk::split::Way;

    use super::*;
    use crate::direct::Wanted;
    use crate::irradiance_cache::Place;

    /// A floor of 2 m a side, 1 m below a lamp of `side` metres, with a bar between them or without.
    fn floor(side: f32, bar: f32) -> Scene {
        let mut parts = SceneParts::default();
        let grey = parts.add_material(Material::lambertian("grey", Rgb::splat(0.5)));
        let glowing = parts.add_material(Material::emitter("lamp", Radiance(Rgb::ONE)));
        parts.add_quad("floor", grey, Vec3::new(-1.0, 0.0, 1.0), Vec3::X * 2.0, Vec3::Z * -2.0);
        let corner = Vec3::new(-0.5 * side, 1.0, -0.5 * side);
        parts.add_quad("lamp", glowing, corner, Vec3::X * side, Vec3::Z * side);
        if bar > 0.0 {
            let corner = Vec3::new(0.1, 0.3, -2.0);
            parts.add_quad("bar", grey, corner, Vec3::new(bar, 0.0, 0.1 * bar), Vec3::Z * 4.0);
        }
        Scene::new(parts).expect("a valid scene")
    }

    /// What the pixels of a picture of so many columns and rows over all of the floor ask for.
    fn requests(lights: &Lights, (width, height): (usize, usize)) -> Vec<Box<[Request]>> {
        let tracer = lights.tracer();
        let mut scratch = Scratch::default();
        let mut request = |index: usize| {
            let [x, z] = [(index % width, width), (index / width, height)]
                .map(|(at, count)| (at as f32 + 0.5) / count as f32 * 2.0 - 1.0);
            let mut receiver =
                Receiver::on(tracer, TriangleId(0), Side::Front, Barycentric { u: 0.3, v: 0.3 });
            receiver.position = Vec3::new(x, 0.0, z);
            let request = Request {
                place: Place { facet: 1, way: Way::default(), side: Side::Front, terms: [true, false] },
                receiver,
                samples: Samples::exact(16),
                key: Key::new(0, Purpose::Test, index as u64),
                wanted: Wanted { direct: 1.0, mirrored: 0.0, known: Rgb::ZERO },
                send: Rgb::ONE,
                through: false,
                arriving: 0.0,
                direction: Vec3::NEG_Y,
                pixel: 2.0 / width as f32,
            };
            let light = request.evaluate(lights, &mut scratch.sources.light).direct.irradiance;
            // Half as much again of other light than there is at most.
            Box::from([Request { arriving: light.dot(LUMINANCE) + 0.5, ..request }])
        };
        (0..width * height).map(&mut request).collect()
    }

    /// The largest error relative to all light, against each pixel by itself, and the share of pixels that were evaluated.
    fn compared(scene: &Scene, size: (usize, usize)) -> (f32, f32) {
        let tracer = Tracer::new(scene);
        let lights = Lights::new(&tracer, LightParams::default());
        let requests = requests(&lights, size);
        let asking: Vec<usize> = (0..requests.len()).collect();
        let found = find(&lights, (&asking, &requests), (size.into(), false), &Silent);
        let (mut worst, mut evaluated) = (0.0_f32, 0);
        for (requests, found) in requests.iter().zip(&found) {
            assert_eq!(found.len(), requests.len(), "a pixel was forgotten: {size:?}");
            let exact = requests[0].evaluate(&lights, &mut Scratch::default().sources.light);
            let off = (found[0].direct.irradiance - exact.direct.irradiance).abs().max_element();
            worst = worst.max(off / requests[0].arriving);
            evaluated += usize::from(found[0] == exact);
        }
        (worst, evaluated as f32 / requests.len() as f32)
    }

    #[test]
    fn pictures_of_any_size_are_found_whole() {
        let scene = floor(0.5, 0.0);
        for size in [(1, 1), (1, 7), (6, 1), (2, 2), (3, 4), (4, 4), (5, 5), (6, 9), (13, 10)] {
            let (worst, _) = compared(&scene, size);
            // Where pixels are as wide as the lamp, light may bend between as it does not at the middle, but no more than corners differ.
            assert!(worst <= STEEP, "{size:?}: {worst}");
        }
    }

    #[test]
    fn smooth_light_is_evaluated_at_few_pixels() {
        // Cells of four pixels a side have a corner and a middle each: an eighth of all pixels.
        let (worst, evaluated) = compared(&floor(0.5, 0.0), (96, 96));
        assert!(worst <= 0.5 * BENT && evaluated < 0.15, "{worst}, {evaluated}");
    }

    #[test]
    fn shadows_are_as_sharp_as_pixel_by_pixel() {
        // Penumbrae from less than a pixel to a tenth of the picture wide.
        for (side, bar) in [(0.5, 0.3), (0.1, 0.3), (0.01, 0.3), (0.02, 0.03)] {
            let (worst, evaluated) = compared(&floor(side, bar), (90, 70));
            // Half of it where light bends evenly, as much again where a penumbra begins.
            assert!(worst <= BENT, "{side}, {bar}: {worst}");
            assert!(evaluated < 0.6, "{side}, {bar}: {evaluated}");
        }
    }

    #[test]
    fn weights_meet_corners_and_the_middle_and_what_is_linear() {
        for high in [[4, 4], [3, 2], [1, 4], [0, 3], [2, 1]] {
            let cell = Cell { low: [5, 7], high: [5 + high[0], 7 + high[1]] };
            let knots = cell.knots().into_iter();
            let light = |[x, y]: [usize; 2]| 3.0 - 0.5 * x as f32 + 0.25 * y as f32;
            let known: Vec<f32> = knots.clone().map(light).collect();
            for at in (cell.low[1]..=cell.high[1]).flat_map(|y| (5..=cell.high[0]).map(move |x| [x, y])) {
                let weights = cell.weights(at);
                let between: f32 = weights.iter().zip(&known).map(|(weight, light)| weight * light).sum();
                assert!((weights.iter().sum::<f32>() - 1.0).abs() < 1e-5, "{cell:?} {at:?}");
                assert!((between - light(at)).abs() < 1e-4, "{cell:?} {at:?}");
            }
            assert_eq!(cell.weights(cell.middle())[4], 1.0, "{cell:?}");
        }
    }
}
