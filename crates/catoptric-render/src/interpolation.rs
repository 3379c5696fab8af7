//! Light of sources at the centres of pixels: evaluated at some, interpolated between those where it is smooth.
//!
//! The picture is divided into cells of [`CELL`] pixels a side. Where the paths through the corners and the middle of a cell ask for light at the same
//! places, and what they get hardly bends between them, the paths inside get what lies between. Other cells are divided again.
//! (Adaptive subdivision in image space: Whitted 1980.) Keys in docs/references.md: Whitted1980.

use rayon::prelude::*;

use catoptric_light::Lights;
use catoptric_scene::quantity::LUMINANCE;
use catoptric_scene::{Cancelled, Progress, Rgb};

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
/// What is found at the corners and the middle may differ from what the mesh has, relative to all light, …
const SMEARED: f32 = 0.05;
/// … and in deviations: where it is more, the mesh may smear a shadow that is thinner than a cell and passes between them.
const STRAYED: f32 = 2.5;
/// Pixels from which on some share what they find.
const MANY: usize = 256;
/// Requests that are evaluated in one parallel job.
const JOB: usize = 4;

/// Adds the light of sources to the pixels of a picture that ask for some, by few shadow rays or by many, and tells `note` what is found.
/// `asking` are numbers of pixels, ascending, with what they ask for: something.
pub(crate) fn light<L: Kept>(
    lights: &Lights,
    (pixels, width): (&mut [Sample<L>], usize),
    asking: Vec<(usize, Box<[Request]>)>,
    by_few: bool,
    progress: &dyn Progress,
    mut note: impl FnMut(usize, &[Request], &[SourceLight]),
) -> Result<(), Cancelled> {
    let (asking, requests): (Vec<usize>, Vec<Box<[Request]>>) = asking.into_iter().unzip();
    let found = find(lights, (&asking, &requests), (width, by_few), progress)?;
    for (pixel, (requests, found)) in asking.into_iter().zip(requests.iter().zip(&found)) {
        add(&mut pixels[pixel], requests, found);
        note(pixel, requests, found);
    }
    Ok(())
}

/// Adds what was found to a pixel without it.
pub(crate) fn add<L: Kept>(pixel: &mut Sample<L>, requests: &[Request], found: &[SourceLight]) {
    let mut shadows = Shadows::default();
    for (request, found) in requests.iter().zip(found) {
        shadows.add(&mut pixel.light, (request.send, request.through), request.wanted, found);
    }
    let Shadows { blocked, penumbra, grain } = shadows;
    *pixel = Sample { open: pixel.light.beauty() + blocked, penumbra, grain, ..*pixel };
}

/// Finds what is asked for.
fn find(
    lights: &Lights,
    (asking, requests): (&[usize], &[Box<[Request]>]),
    (width, by_few): (usize, bool),
    progress: &dyn Progress,
) -> Result<Vec<Box<[SourceLight]>>, Cancelled> {
    debug_assert!(requests.iter().all(|requests| !requests.is_empty()), "a pixel asks for nothing");
    let (Some(first), Some(last)) = (asking.first(), asking.last()) else { return Ok(Vec::new()) };
    let start = first / width * width;
    let size = [width, last / width + 1 - first / width];
    let mut band =
        Band { size, by_few, slots: Vec::new(), requests, found: vec![Box::default(); requests.len()] };
    if asking.len() < MANY {
        band.evaluate((0..requests.len()).collect(), lights, progress)?;
    } else {
        band.slots = vec![NONE; size[0] * size[1]];
        for (slot, &pixel) in asking.iter().enumerate() {
            band.slots[pixel - start] = slot as u32;
        }
        band.find(lights, progress)?;
    }
    Ok(band.found)
}

/// Slot of a pixel that does not ask.
const NONE: u32 = u32::MAX;

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
    fn find(&mut self, lights: &Lights, progress: &dyn Progress) -> Result<(), Cancelled> {
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
            self.evaluate(self.open(knots).map(|(_, slot)| slot).collect(), lights, progress)?;
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
            self.evaluate(rest, lights, progress)?;
            cells = next;
        }
        Ok(())
    }

    /// Evaluates what some slots ask for.
    fn evaluate(
        &mut self,
        mut slots: Vec<usize>,
        lights: &Lights,
        progress: &dyn Progress,
    ) -> Result<(), Cancelled> {
        slots.sort_unstable();
        slots.dedup();
        let evaluate = |scratch: &mut Scratch, &slot: &usize| {
            let requests = self.requests[slot].iter();
            let evaluate = |request: &Request| request.evaluate(lights, &mut scratch.sources.light);
            (!progress.is_cancelled()).then(|| requests.map(evaluate).collect())
        };
        let found: Option<Vec<Box<[SourceLight]>>> =
            slots.par_iter().with_max_len(JOB).map_init(Scratch::default, evaluate).collect();
        for (slot, found) in slots.into_iter().zip(found.ok_or(Cancelled)?) {
            self.found[slot] = found;
        }
        Ok(())
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

    /// Whether what a cell's corners and middle found for one request hardly bends, and is what the mesh has, about.
    fn is_smooth(&self, cell: &Cell, knots: [usize; 5], request: usize) -> bool {
        let below = cell.bilinear(cell.middle());
        let requests = knots.map(|knot| &self.requests[knot][request]);
        let found = knots.map(|knot| self.found[knot][request]);
        let level = requests.iter().fold(f32::INFINITY, |level, request| level.min(request.arriving));
        let is_smeared = |(request, found): (&&Request, &SourceLight)| {
            let luminance = (found.direct.irradiance + found.mirrored.irradiance).dot(LUMINANCE);
            let noise = (found.direct.variance() + found.mirrored.variance()).sqrt();
            (luminance - request.stored.iter().sum::<f32>()).abs()
                > SMEARED * request.arriving + STRAYED * noise
        };
        if requests.iter().zip(&found).any(is_smeared) {
            return false;
        }
        [found.map(|found| found.direct), found.map(|found| found.mirrored)].iter().all(|parts| {
            let [corners @ .., middle] = parts.map(|part| part.irradiance);
            let between: Rgb = corners.iter().zip(below).map(|(&light, weight)| light * weight).sum();
            let [noises @ .., noise] = parts.map(|part| part.variance());
            let most = noises.into_iter().fold(noise, f32::max).sqrt();
            let noises: f32 = noises.iter().zip(below).map(|(noise, weight)| noise * weight * weight).sum();
            let [low, high] = [Rgb::min, Rgb::max].map(|pick| corners.into_iter().fold(middle, pick));
            (middle - between).abs().max_element() <= BENT * level + CHANCE * (noise + noises).sqrt()
                && (high - low).max_element() <= STEEP * level + CHANCE * most
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
    use catoptric_scene::{
        Barycentric, Material, MaterialId, Radiance, Scene, SceneParts, Side, Silent, TriangleId,
    };
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

    /// What the pixels of a picture of so many columns and rows over all of the floor ask for. The mesh has what sources send where nothing
    /// blocks, times a share, and half as much of other light.
    fn requests(lights: &Lights, (width, height): (usize, usize), share: f32) -> Vec<Box<[Request]>> {
        let tracer = lights.tracer();
        let mut scratch = Scratch::default();
        let mut request = |index: usize| {
            let [x, z] = [(index % width, width), (index / width, height)]
                .map(|(at, count)| (at as f32 + 0.5) / count as f32 * 2.0 - 1.0);
            let mut receiver =
                Receiver::on(tracer, TriangleId(0), Side::Front, Barycentric { u: 0.3, v: 0.3 });
            receiver.position = Vec3::new(x, 0.0, z);
            let request = Request {
                place: Place {
                    facet: 1,
                    material: MaterialId(0),
                    way: Way::default(),
                    side: Side::Front,
                    terms: [true, false],
                },
                receiver,
                samples: Samples::exact(16),
                key: Key::new(0, Purpose::Test, index as u64),
                wanted: Wanted { direct: 1.0, mirrored: 0.0, known: Rgb::ZERO },
                send: Rgb::ONE,
                through: false,
                arriving: 0.0,
                stored: [0.0; 2],
                direction: Vec3::NEG_Y,
                pixel: 2.0 / width as f32,
            };
            let open = request.evaluate(lights, &mut scratch.sources.light).direct.unoccluded;
            let stored = share * open.dot(LUMINANCE);
            Box::from([Request {
                arriving: stored + 0.5 * open.dot(LUMINANCE),
                stored: [stored, 0.0],
                ..request
            }])
        };
        (0..width * height).map(&mut request).collect()
    }

    /// The largest error relative to all light, against each pixel by itself, and the share of pixels that were evaluated.
    fn compared(scene: &Scene, size: (usize, usize), share: f32) -> (f32, f32) {
        let tracer = Tracer::new(scene);
        let lights = Lights::new(&tracer, LightParams::default());
        let requests = requests(&lights, size, share);
        let asking: Vec<usize> = (0..requests.len()).collect();
        let found = find(&lights, (&asking, &requests), (size.0, false), &Silent).expect("not cancelled");
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
        for size in [(1, 1), (5, 5), (300, 1), (1, 301), (2, 130), (3, 97), (16, 16), (17, 19), (22, 23)] {
            let (worst, _) = compared(&scene, size, 1.0);
            // Half of it where light bends evenly: pixels that are wider than the lamp see more of it.
            assert!(worst <= 1.5 * BENT, "{size:?}: {worst}");
        }
    }

    #[test]
    fn smooth_light_is_evaluated_at_few_pixels() {
        // Cells of four pixels a side have a corner and a middle each: an eighth of all pixels.
        let (worst, evaluated) = compared(&floor(0.5, 0.0), (96, 96), 1.0);
        assert!(worst <= 0.5 * BENT && evaluated < 0.15, "{worst}, {evaluated}");
    }

    #[test]
    fn shadows_are_as_sharp_as_pixel_by_pixel() {
        // Penumbrae from a fifth of a pixel to a tenth of the picture wide.
        for side in [0.5, 0.1, 0.01] {
            let (worst, evaluated) = compared(&floor(side, 0.3), (90, 70), 1.0);
            // Half of it where light bends evenly, as much again where a penumbra begins.
            assert!(worst <= BENT, "{side}: {worst}");
            assert!(evaluated < 0.6, "{side}: {evaluated}");
        }
    }

    #[test]
    fn shadows_thinner_than_a_cell_are_found_where_the_mesh_has_smeared_them() {
        // One pixel wide, of the 90: a mesh of elements of eight has an eighth less light around.
        let (worst, _) = compared(&floor(0.01, 0.015), (90, 70), 0.875);
        assert!(worst <= BENT, "{worst}");
        let (unknown, _) = compared(&floor(0.01, 0.015), (90, 70), 1.0);
        assert!(unknown > 0.3, "it is no challenge: {unknown}");
    }

    #[test]
    fn what_asks_at_other_places_is_not_mixed() {
        let scene = floor(0.5, 0.0);
        let tracer = Tracer::new(&scene);
        let lights = Lights::new(&tracer, LightParams::default());
        let mut requests = requests(&lights, (40, 40), 1.0);
        // A board of its own light in the picture, and a hole that asks for nothing.
        for (index, requests) in requests.iter_mut().enumerate() {
            if index % 40 > 21 {
                requests[0].place.facet = 2;
                requests[0].receiver.position.y = 0.5;
            }
        }
        let asks = |index: &usize| !(10..15).contains(&(index % 40)) || !(3..30).contains(&(index / 40));
        let asking: Vec<usize> = (0..1600).filter(asks).collect();
        let asked: Vec<Box<[Request]>> = asking.iter().map(|&index| requests[index].clone()).collect();
        let found = find(&lights, (&asking, &asked), (40, false), &Silent).expect("not cancelled");
        for (requests, found) in asked.iter().zip(&found) {
            let exact = requests[0].evaluate(&lights, &mut Scratch::default().sources.light);
            let off = (found[0].direct.irradiance - exact.direct.irradiance).abs().max_element();
            // The board has the light of a lamp half as far.
            assert!(off <= BENT * exact.direct.irradiance.max_element().max(requests[0].arriving), "{off}");
        }
    }

    #[test]
    fn any_number_of_threads_finds_the_same() {
        let scene = floor(0.1, 0.3);
        let tracer = Tracer::new(&scene);
        let lights = Lights::new(&tracer, LightParams::default());
        let requests = requests(&lights, (90, 70), 1.0);
        let asking: Vec<usize> = (0..requests.len()).collect();
        let found = [1, 2, 5].map(|threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            pool.install(|| find(&lights, (&asking, &requests), (90, true), &Silent).expect("not cancelled"))
        });
        assert!(found[0] == found[1] && found[0] == found[2]);
    }

    #[test]
    fn few_rays_leave_doubts_and_noise_does_not_cancel() {
        let part = |split: f32| Part { split: Rgb::splat(split), sampled: true, ..Part::default() };
        let found = [0.2, -0.2, 0.2, -0.2, 0.2].map(|split| {
            let light = SourceLight { direct: part(split), mirrored: Part::default() };
            Box::from([light]) as Box<[SourceLight]>
        });
        let scene = floor(0.5, 0.0);
        let tracer = Tracer::new(&scene);
        let lights = Lights::new(&tracer, LightParams::default());
        let requests = requests(&lights, (5, 1), 1.0);
        for by_few in [false, true] {
            let band =
                Band { size: [5, 1], by_few, slots: Vec::new(), requests: &requests, found: found.to_vec() };
            let between = band.between([0, 1, 2, 3, 4], [0.25, 0.25, 0.25, 0.25, 0.0]);
            assert_eq!(between[0].direct.penumbra, by_few);
            assert!((between[0].direct.split.x - 0.2).abs() < 1e-6, "{between:?}");
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
