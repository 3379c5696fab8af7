//! Light of sources at the hits of an image, shared between neighbouring pixels.
//!
//! Ward, Rubinstein & Clear's irradiance cache, for what sources send, and in image space: what is found where the rays through centres meet
//! surfaces serves the other samples of the pixels around. Keys in docs/references.md: Ward1988.

use std::ops::Range;

use glam::{Mat3, Vec3};

use catoptric_light::irradiance::{Samples, Scratch};
use catoptric_light::{Lights, Receiver};
use catoptric_scene::{MaterialId, Rgb, Side};
use catoptric_trace::sequence::Key;
use catoptric_trace::walk::split::Way;

use crate::direct::{Part, SourceLight, Wanted};
use crate::render::window;

/// A part of what eye paths meet on which source light is compared: the same surface, seen the same way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Place {
    /// Plane or smooth surface.
    pub(crate) facet: u32,
    /// Coats let through what others in the plane do not.
    pub(crate) material: MaterialId,
    pub(crate) way: Way,
    pub(crate) side: Side,
    /// Whether direct and mirrored light are wanted.
    pub(crate) terms: [bool; 2],
}

impl Place {
    /// Whether what is known at this place is all that is wanted at the other.
    fn serves(&self, other: &Self) -> bool {
        *self == Self { terms: self.terms, ..*other }
            && self.terms.iter().zip(other.terms).all(|(known, wanted)| *known || !wanted)
    }
}

/// Source light that is wanted at a hit.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Request {
    pub(crate) place: Place,
    pub(crate) receiver: Receiver,
    pub(crate) samples: Samples,
    pub(crate) key: Key,
    pub(crate) wanted: Wanted,
    /// What the eye gets of irradiance.
    pub(crate) send: Rgb,
    /// Seen through mirrors or glass.
    pub(crate) through: bool,
    /// Luminous irradiance by all light, as far as the mesh knows, …
    pub(crate) arriving: f32,
    /// … and what is wanted of it, of the direct and of the mirrored term.
    pub(crate) stored: [f32; 2],
    /// Direction of the eye path there.
    pub(crate) direction: Vec3,
    /// How far apart pixels are there, across it, metres.
    pub(crate) pixel: f32,
}

impl Request {
    /// Finds it.
    pub(crate) fn evaluate(&self, lights: &Lights, scratch: &mut Scratch) -> SourceLight {
        SourceLight::at(lights, &self.receiver, self.wanted, self.samples, self.key, scratch)
    }

    /// Whether as much light arrives by the mesh as is expected by what arrives around.
    pub(crate) fn is_as_expected(&self, expected: f32) -> bool {
        (self.arriving - expected).abs() <= UNEXPECTED * self.arriving.max(expected)
    }
}

/// What the mesh may have beyond what it has around, as a share.
const UNEXPECTED: f32 = 0.05;

/// What is known at a hit.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Record {
    place: Place,
    position: Vec3,
    /// Direct and mirrored irradiance, W/m².
    irradiance: [Rgb; 2],
    /// Standard deviations of their luminance.
    deviation: [f32; 2],
    /// Luminous irradiance by all light, as far as the mesh knows.
    arriving: f32,
}

impl Record {
    pub(crate) fn of(request: &Request, found: &SourceLight) -> Self {
        let parts = [found.direct, found.mirrored];
        Self {
            place: request.place,
            position: request.receiver.position,
            irradiance: parts.map(|part| part.irradiance),
            deviation: parts.map(|part| part.variance().sqrt()),
            arriving: request.arriving,
        }
    }

    /// Adds it to those of a pixel, unless they have enough at its place.
    pub(crate) fn add_to(self, own: &mut Vec<Self>) {
        if own.iter().filter(|other| other.place == self.place).count() < MOST_KEPT {
            own.push(self);
        }
    }
}

/// What is known at the hits of the rays through the centres of pixels.
#[derive(Clone, Debug, Default)]
pub(crate) struct Records {
    records: Vec<Record>,
    /// Per pixel: the end of its records. Those that are not listed have none.
    ends: Vec<u32>,
}

/// Records at most: 134 MB. What is known of fewer pixels serves fewer.
const MOST_RECORDS: usize = 1 << 21;

impl Records {
    /// Adds those of a pixel, after those of all before it.
    pub(crate) fn push(&mut self, pixel: usize, requests: &[Request], found: &[SourceLight]) {
        if self.records.len() + found.len() <= MOST_RECORDS {
            self.ends.resize(pixel, self.records.len() as u32);
            self.records
                .extend(requests.iter().zip(found).map(|(request, found)| Record::of(request, found)));
            self.ends.push(self.records.len() as u32);
        }
    }

    /// Replaces those of a pixel by what the same requests found by more rays.
    pub(crate) fn replace(&mut self, pixel: usize, requests: &[Request], found: &[SourceLight]) {
        let range = self.range(pixel);
        for (record, (request, found)) in self.records[range].iter_mut().zip(requests.iter().zip(found)) {
            *record = Record::of(request, found);
        }
    }

    /// Those of some pixels, ascending and each once, are now these.
    pub(crate) fn insert(&mut self, fresh: &[(usize, Vec<Record>)]) {
        let old = std::mem::take(self);
        let pixels = fresh.last().map_or(0, |last| last.0 + 1).max(old.ends.len());
        let mut fresh = fresh.iter().peekable();
        for pixel in 0..pixels {
            let own = fresh.next_if(|next| next.0 == pixel).map_or(old.of(pixel), |next| &next.1);
            if self.records.len() + own.len() <= MOST_RECORDS {
                self.records.extend(own);
            }
            self.ends.push(self.records.len() as u32);
        }
    }

    /// Whether anything is known of a pixel.
    pub(crate) fn knows(&self, pixel: usize) -> bool {
        !self.range(pixel).is_empty()
    }

    fn of(&self, pixel: usize) -> &[Record] {
        &self.records[self.range(pixel)]
    }

    fn range(&self, pixel: usize) -> Range<usize> {
        let end = |pixel: usize| self.ends.get(pixel).map_or(self.records.len(), |&end| end as usize);
        pixel.checked_sub(1).map_or(0, end)..end(pixel)
    }
}

/// What is known around a pixel.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Around<'a> {
    pub(crate) records: &'a Records,
    pub(crate) pixel: usize,
    /// Columns and rows of the picture.
    pub(crate) size: (usize, usize),
    /// Records of the pixel's own at a place that must be among them: shadows between centres are seen by the pixel alone.
    pub(crate) own: usize,
}

/// Pixels around one, in columns and rows, whose records serve it.
const RING: usize = 2;
/// Pixels from a hit at which records are near it: many of them, or else those next to it.
const NEAR: [f32; 2] = [2.5, 0.75];
/// Records through which a plane may be laid: one that three decide tells nothing.
const ENOUGH: usize = 5;
/// Records of a pixel's own at a place from which on no plane is laid through them: where so many lie in none, further ones would not either.
const MOST_OWN: usize = 24;
/// … and so many that their mean is what the other samples have there, wherever that is: in a rim that shows half of the room, no two are near to
/// each other, and of thousands of samples that look for the spark of a lamp each would ask for its own light of lamps. (The mean is off by an eighth of
/// what they differ by, 64^-½; pixels that need no more samples than that ask as ever.)
const MOST_KEPT: usize = 64;
/// What records may lie off it, relative to all light that arrives, for each of [`NEAR`]; …
const OFF: [f32; 2] = [0.02, 0.05];
/// … and in deviations.
const CHANCE: f32 = 2.0;
/// Weights of records fall with the square of their distance, from this share of the farthest on.
const FLAT: f32 = 0.1;

/// Determinant of the moments of records, relative to the cube of their weight, below which they lie along a line.
const THIN: f32 = 1e-3;

impl Around<'_> {
    /// What is wanted, by a plane through the records nearby, the pixel's `own` among them. `None` where these are few, or not in one, unless
    /// the pixel has many there.
    pub(crate) fn recall(&self, own: &[Record], request: &Request) -> Option<SourceLight> {
        let count = own.iter().filter(|record| record.place.serves(&request.place)).count();
        if count >= MOST_KEPT {
            return Some(mean(own, request));
        }
        if !(self.own..MOST_OWN).contains(&count) {
            return None;
        }
        NEAR.iter()
            .zip(OFF)
            .find_map(|(near, off)| self.recall_within((near * request.pixel, off), own, request))
    }

    /// … up to a distance in metres (weighted least squares).
    fn recall_within(
        &self,
        (reach, most): (f32, f32),
        own: &[Record],
        request: &Request,
    ) -> Option<SourceLight> {
        // Across the ray, as pixels lie beside each other.
        let (over, up) = request.direction.any_orthonormal_pair();
        let [over, up] = [over / reach, up / reach];
        let near = || {
            let pixels = window(self.pixel, self.size, RING);
            let known = pixels.flat_map(|pixel| self.records.of(pixel)).chain(own);
            known.filter_map(|record| {
                let offset = record.position - request.receiver.position;
                let at = Vec3::new(1.0, offset.dot(over), offset.dot(up));
                let square = at.y * at.y + at.z * at.z;
                let is_near = record.place.serves(&request.place) && square <= 1.0;
                is_near.then_some((at, 1.0 / (square + FLAT), record))
            })
        };
        near().nth(ENOUGH - 1)?;
        let by = |light: Vec3, at: Vec3| Mat3::from_cols(light * at.x, light * at.y, light * at.z);
        let sum = near().fold(Mat3::ZERO, |sum, (at, weight, _)| sum + by(at, at) * weight);
        let flat = sum.determinant() / sum.x_axis.x.powi(3);
        if flat < THIN {
            return None;
        }
        let inverse = sum.inverse();
        let plane = |term: usize| {
            let add = |sum, (at, weight, record): (Vec3, f32, &Record)| {
                sum + by(record.irradiance[term], at) * weight
            };
            near().fold(Mat3::ZERO, add) * inverse
        };
        let planes = [0, 1].map(plane);
        let are_near = near().all(|(at, _, record)| {
            [0, 1].into_iter().filter(|&term| request.place.terms[term]).all(|term| {
                let off = (planes[term] * at - record.irradiance[term]).abs().max_element();
                off <= most * request.arriving + CHANCE * record.deviation[term]
            })
        });
        // What is thin, and passes between them, the mesh may know.
        let add = |sum, (at, weight, record): (Vec3, f32, &Record)| sum + at * (weight * record.arriving);
        let arriving = (inverse * near().fold(Vec3::ZERO, add)).x;
        let is_known = request.is_as_expected(arriving);
        (are_near && is_known).then(|| {
            // What few rays found in the dark of something is no less grainy by a plane.
            let is_grainy =
                |term: usize| near().any(|(_, _, record)| record.deviation[term] > most * request.arriving);
            let [direct, mirrored] = [0, 1].map(|term| {
                let irradiance = planes[term].x_axis.max(Rgb::ZERO);
                Part { irradiance, unoccluded: irradiance, penumbra: is_grainy(term), ..Part::default() }
            });
            SourceLight { direct, mirrored }
        })
    }
}

/// The mean of the records that serve a request, of which there are some.
fn mean(records: &[Record], request: &Request) -> SourceLight {
    let serving = || records.iter().filter(|record| record.place.serves(&request.place));
    let share = 1.0 / serving().count() as f32;
    let [direct, mirrored] = [0, 1].map(|term| {
        let irradiance = serving().map(|record| record.irradiance[term]).sum::<Rgb>() * share;
        let is_grainy = serving().any(|record| record.deviation[term] > 0.0);
        Part { irradiance, unoccluded: irradiance, penumbra: is_grainy, ..Part::default() }
    });
    SourceLight { direct, mirrored }
}

#[cfg(test)]
mod tests {
    use catoptric_light::Receiver;
    use catoptric_trace::interaction::Coat;
    use catoptric_trace::sequence::Purpose;
    use catoptric_trace::{MediumStack, PlaneId};

    use super::*;

    const WIDTH: usize = 9;

    /// A request at a place of the picture whose pixels are 0.1 m apart, where so much arrives by the mesh.
    fn request(at: [f32; 2], arriving: f32) -> Request {
        let receiver = Receiver {
            position: Vec3::new(0.1 * at[0], 0.1 * at[1], 0.0),
            plane: PlaneId::NONE,
            normal: Vec3::Z,
            geometric: Vec3::Z,
            coat: Coat::NONE,
            media: MediumStack::AIR,
        };
        Request {
            place: Place {
                facet: 1,
                material: MaterialId(0),
                way: Way::default(),
                side: Side::Front,
                terms: [true, true],
            },
            receiver,
            samples: Samples::exact(8),
            key: Key::new(0, Purpose::Test, 0),
            wanted: Wanted::ALL,
            send: Rgb::ONE,
            through: false,
            arriving,
            stored: [0.0; 2],
            direction: Vec3::NEG_Z,
            pixel: 0.1,
        }
    }

    fn found(light: f32) -> SourceLight {
        let part = |light: f32| Part { irradiance: Rgb::new(light, 0.5 * light, 2.0), ..Part::default() };
        SourceLight { direct: part(light), mirrored: part(3.0 - light) }
    }

    /// What is known where direct light is a function of the place.
    fn known(light: impl Fn([f32; 2]) -> f32) -> Records {
        let mut records = Records::default();
        for index in 0..WIDTH * WIDTH {
            let at = [index % WIDTH, index / WIDTH].map(|at| at as f32 + 0.5);
            records.push(index, &[request(at, 4.0)], &[found(light(at))]);
        }
        records
    }

    fn around(records: &Records, pixel: [usize; 2], own: usize) -> Around<'_> {
        Around { records, pixel: pixel[1] * WIDTH + pixel[0], size: (WIDTH, WIDTH), own }
    }

    #[test]
    fn light_in_a_plane_is_recalled() {
        let light = |[x, y]: [f32; 2]| 1.0 + 0.05 * x - 0.03 * y;
        let records = known(light);
        for (pixel, at) in [([4, 4], [4.1, 4.9]), ([0, 0], [0.4, 0.3]), ([8, 3], [8.7, 3.2])] {
            let recalled = around(&records, pixel, 0).recall(&[], &request(at, 4.0)).expect("it is one");
            for (part, expected) in [(recalled.direct, light(at)), (recalled.mirrored, 3.0 - light(at))] {
                // f32, and moments of up to 25 records.
                let expected = Rgb::new(expected, 0.5 * expected, 2.0);
                assert!((part.irradiance - expected).abs().max_element() < 1e-4, "{at:?}: {recalled:?}");
                assert_eq!(part.unoccluded, part.irradiance);
            }
        }
    }

    #[test]
    fn what_may_be_a_shadow_is_not() {
        // An edge, of 1 of the 4 that arrive.
        let edge = known(|[x, _]| if x < 4.0 { 1.0 } else { 2.0 });
        assert!(around(&edge, [4, 4], 0).recall(&[], &request([4.3, 4.5], 4.0)).is_none());
        // One that the mesh has, and centres do not.
        let even = known(|_| 1.0);
        let [expected, less] = [4.0, 3.7].map(|arriving| request([4.3, 4.5], arriving));
        assert!(around(&even, [4, 4], 0).recall(&[], &expected).is_some());
        assert!(around(&even, [4, 4], 0).recall(&[], &less).is_none());
        // One that the pixel's own samples found.
        let [dark, lit] = [0.0, 1.0].map(|light| Record::of(&request([4.2, 4.6], 4.0), &found(light)));
        assert!(around(&even, [4, 4], 0).recall(&[dark], &expected).is_none());
        assert!(around(&even, [4, 4], 2).recall(&[lit], &expected).is_none());
        assert!(around(&even, [4, 4], 2).recall(&[lit; 2], &expected).is_some());
        assert!(around(&even, [4, 4], 2).recall(&[lit; MOST_OWN], &expected).is_none());
    }

    #[test]
    fn a_pixel_that_has_asked_often_at_a_place_takes_the_mean() {
        let request = request([4.3, 4.5], 4.0);
        let mut own = Vec::new();
        for index in 0..2 * MOST_KEPT {
            // A shadow's edge: every other one is dark. What comes late is not kept.
            let light = if index < MOST_KEPT { (index % 2) as f32 } else { 9.0 };
            let is_asked = around(&Records::default(), [4, 4], 2).recall(&own, &request).is_none();
            assert_eq!(is_asked, index < MOST_KEPT);
            Record::of(&request, &found(light)).add_to(&mut own);
        }
        assert_eq!(own.len(), MOST_KEPT);
        let recalled = around(&Records::default(), [4, 4], 2).recall(&own, &request).expect("there are many");
        for (part, expected) in [(recalled.direct, 0.5), (recalled.mirrored, 2.5)] {
            assert_eq!(part.irradiance, Rgb::new(expected, 0.5 * expected, 2.0));
        }
        let elsewhere = Request { place: Place { facet: 2, ..request.place }, ..request };
        assert!(around(&Records::default(), [4, 4], 2).recall(&own, &elsewhere).is_none());
    }

    #[test]
    fn places_do_not_mix_and_few_records_tell_nothing() {
        let records = known(|_| 1.0);
        let other = |change: fn(&mut Request)| {
            let mut request = request([4.3, 4.5], 4.0);
            change(&mut request);
            around(&records, [4, 4], 0).recall(&[], &request)
        };
        assert!(other(|_| {}).is_some());
        assert!(other(|request| request.place.facet = 2).is_none());
        assert!(other(|request| request.place.material = MaterialId(1)).is_none());
        assert!(other(|request| request.place.side = Side::Back).is_none());
        // What is wanted is known, and more.
        assert!(other(|request| request.place.terms = [true, false]).is_some());
        assert!(other(|request| request.receiver.position.x += 1.0).is_none());
        assert!(other(|request| request.pixel = 0.03).is_none());
    }

    #[test]
    fn what_is_recalled_of_grainy_records_counts_as_a_penumbra() {
        // A fiftieth of the 4 that arrive is 0.08.
        let grainy = |deviation: f32| {
            let mut records = known(|_| 1.0);
            for index in 0..WIDTH * WIDTH {
                let at = [index % WIDTH, index / WIDTH].map(|at| at as f32 + 0.5);
                let mut own = found(1.0);
                own.direct.split = Rgb::splat(2.0 * deviation);
                records.replace(index, &[request(at, 4.0)], &[own]);
            }
            let recalled = around(&records, [4, 4], 0).recall(&[], &request([4.5, 4.5], 4.0));
            let recalled = recalled.expect("they lie in a plane");
            [recalled.direct.penumbra, recalled.mirrored.penumbra]
        };
        assert_eq!([0.0, 0.07, 0.09].map(grainy), [[false; 2], [false; 2], [true, false]]);
    }

    #[test]
    fn more_rays_replace_what_few_found() {
        let mut records = known(|_| 1.0);
        for index in 0..WIDTH * WIDTH {
            let at = [index % WIDTH, index / WIDTH].map(|at| at as f32 + 0.5);
            records.replace(index, &[request(at, 4.0)], &[found(1.5)]);
        }
        let recalled = around(&records, [4, 4], 0).recall(&[], &request([4.5, 4.5], 4.0));
        assert!(recalled.is_some_and(|light| (light.direct.irradiance.x - 1.5).abs() < 1e-5));
    }

    #[test]
    fn records_are_put_in_their_places() {
        let record = |light: f32| Record::of(&request([0.5, 0.5], 4.0), &found(light));
        let mut records = Records::default();
        for pixel in [1, 2, 4] {
            records.push(pixel, &[request([0.5, 0.5], 4.0)], &[found(pixel as f32)]);
        }
        records.insert(&[
            (0, vec![record(10.0), record(11.0)]),
            (2, vec![record(12.0)]),
            (6, vec![record(16.0)]),
        ]);
        let lights = |pixel| records.of(pixel).iter().map(|r| r.irradiance[0].x).collect::<Vec<_>>();
        let expected: [&[f32]; 8] = [&[10.0, 11.0], &[1.0], &[12.0], &[], &[4.0], &[], &[16.0], &[]];
        for (pixel, expected) in expected.into_iter().enumerate() {
            assert_eq!(lights(pixel), expected, "pixel {pixel}");
            assert_eq!(records.knows(pixel), !expected.is_empty());
        }
    }
}
