//! Outlines of lamps in the picture, seen straight or over planar mirrors.
//!
//! A lamp is a hundred times as bright as what is beside it. Where its outline crosses a pixel, samples on either side are
//! strata, whose areas are known: what they leave of the noise is that of each side. And where a lamp is thinner than a pixel, the
//! centres of all may miss it, and nothing else would call for more samples.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;

use glam::{Affine3A, DVec2, DVec3, Vec2, Vec3};

use catoptric_light::chains::ImageChain;
use catoptric_light::emitter::Cell;
use catoptric_light::lamp::{Outline, Sight};
use catoptric_light::{Lights, contour};
use catoptric_scene::quantity::LUMINANCE;
use catoptric_scene::{Camera, Rgb};
use catoptric_trace::PlaneId;
use catoptric_trace::sequence::triangle_point;

/// Width in pixels from which on the centre of some pixel sees a lamp: a square of that width holds an upright one of a pixel.
const WIDE: f64 = std::f64::consts::SQRT_2;
/// Lamps and cells, times mirror chains, that are looked at: a few milliseconds.
const MOST_LOOKS: usize = 1 << 14;
/// Pixels that all outlines together may cross, for each of the picture: lamps may lie behind each other.
const MOST_CROSSED: usize = 4;
/// Share of the pixels that are found, at most: in a cloud of sparks, those of the brightest.
const MOST_PIXELS: f64 = 0.1;
/// Shares of a pixel on one side of an outline below which the other is all that counts.
const LEAST_SHARE: f64 = 1e-4;
/// Nothing nearer to the eye than this is projected, metres.
const NEAREST: f64 = 1e-4;
/// Distance from which an eye sees in parallel, in diameters of the scene.
const FAR: f64 = 1e4;

/// The pixels that outlines cross.
#[derive(Debug, Default)]
pub(crate) struct Outlines {
    /// By index, with what of it lies inside the one outline that crosses it; none where there are several.
    crossed: BTreeMap<usize, Option<Cut>>,
    /// By index, how pixels may be cut by what is about there.
    guessed: BTreeMap<usize, Cut>,
    /// Those that something thinner than a pixel crosses.
    thin: Vec<Thin>,
    /// Pixels crossed so far, again and again.
    count: usize,
}

/// A pixel that a lamp thinner than a pixel crosses.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Thin {
    /// By index.
    pub(crate) pixel: usize,
    /// What the lamp sends there, about.
    pub(crate) luminance: f32,
}

/// A pixel in two parts: inside an outline and outside. Samples are shared out evenly.
#[derive(Clone, Debug)]
pub(crate) struct Cut {
    /// Triangles of each part, in the unit square.
    parts: [Vec<[DVec2; 3]>; 2],
    /// Area of all triangles before each, and of all.
    sums: [Vec<f64>; 2],
    /// All inside shows the lamp, if nothing is before it.
    is_exact: bool,
}

impl Outlines {
    /// Projects the sources.
    pub(crate) fn new(lights: &Lights, camera: &Camera, size: (usize, usize)) -> Self {
        let emitters = lights.emitters();
        let alone = emitters.lamps().iter().map(|lamp| lamp.cells.start as usize).min();
        let mut cells: Vec<&Cell> =
            emitters.cells()[..alone.unwrap_or(emitters.cells().len())].iter().collect();
        let power = |cell: &Cell| f64::from(cell.radiance.dot(LUMINANCE)) * cell.area;
        cells.sort_by(|a, b| power(b).total_cmp(&power(a)));
        cells.truncate(MOST_LOOKS);
        let each = (cells.len() + emitters.lamps().len()).max(1);
        let views = (MOST_LOOKS / each).max(1) - 1;

        let mut outlines = Self::default();
        let straight = View::new(lights, camera, size);
        let mirrored = lights.chains().chains().iter().take(views).filter_map(|chain| straight.over(chain));
        let mut outline = Outline::default();
        for view in std::iter::once(straight.clone()).chain(mirrored) {
            let mut add = |corners: &[DVec3], radiance: Rgb| {
                outlines.add(&view.projected(corners), view.strength * radiance.dot(LUMINANCE), size);
            };
            for lamp in emitters.lamps() {
                if lamp.outline(view.eye, view.ahead, PlaneId::NONE, &mut outline) == Sight::Outline {
                    add(&outline.corners, lamp.radiance);
                }
            }
            for cell in &cells {
                let polygon = cell.polygon();
                if polygon.corners().iter().any(|&c| cell.normal.dot(view.eye - c) > 0.0) {
                    add(polygon.corners(), cell.radiance);
                }
            }
        }
        outlines
    }

    /// Adds an outline in pixels.
    fn add(&mut self, outline: &[DVec2], luminance: f32, size: (usize, usize)) {
        let all = size.0 * size.1;
        let is_full = self.crossed.len() as f64 > MOST_PIXELS * all as f64 || self.count > MOST_CROSSED * all;
        if outline.len() < 3 || is_full {
            return;
        }
        let mut pixels = Vec::new();
        crossed(outline, size, |index| pixels.push(index));
        pixels.sort_unstable();
        pixels.dedup();
        self.count += pixels.len();
        for &index in &pixels {
            match self.crossed.entry(index) {
                Entry::Vacant(entry) => {
                    let corner = DVec2::new((index % size.0) as f64, (index / size.0) as f64);
                    entry.insert(Cut::new(outline, corner));
                }
                Entry::Occupied(mut entry) => {
                    entry.insert(None);
                }
            }
        }
        if least_width(outline) < WIDE {
            self.thin.extend(pixels.into_iter().map(|pixel| Thin { pixel, luminance }));
        }
    }

    /// Cuts a pixel by a convex outline of what is about there, in pixels of a picture so wide, if nothing has before.
    pub(crate) fn guess(&mut self, index: usize, outline: &[DVec2], width: usize) {
        if outline.len() < 3 {
            return;
        }
        if let Entry::Vacant(entry) = self.guessed.entry(index) {
            let corner = DVec2::new((index % width) as f64, (index / width) as f64);
            if let Some(cut) = Cut::new(outline, corner) {
                entry.insert(Cut { is_exact: false, ..cut });
            }
        }
    }

    /// How a pixel is cut, and how it may be if that shows no lamp.
    pub(crate) fn cuts(&self, index: usize) -> [Option<&Cut>; 2] {
        [self.crossed.get(&index).and_then(Option::as_ref), self.guessed.get(&index)]
    }

    /// Pixels that are crossed by what all centres may miss.
    pub(crate) fn thin(&self) -> &[Thin] {
        &self.thin
    }
}

/// An eye that sees the lamps where they are: the camera, or its image behind mirrors.
#[derive(Clone)]
struct View<'a> {
    lights: &'a Lights<'a>,
    camera: &'a Camera,
    camera_from_world: Affine3A,
    size: (usize, usize),
    chain: Option<&'a ImageChain>,
    eye: DVec3,
    ahead: DVec3,
    /// Reflectance of the mirrors.
    strength: f32,
}

impl<'a> View<'a> {
    fn new(lights: &'a Lights<'a>, camera: &'a Camera, size: (usize, usize)) -> Self {
        let ahead = camera.world_from_camera.transform_vector3(Vec3::NEG_Z).as_dvec3();
        let eye = camera.world_from_camera.translation.as_dvec3();
        let back = if camera.is_perspective() { 0.0 } else { FAR * f64::from(lights.tracer().diagonal()) };
        Self {
            lights,
            camera,
            camera_from_world: camera.world_from_camera.inverse(),
            size,
            chain: None,
            eye: eye - ahead * back,
            ahead,
            strength: 1.0,
        }
    }

    /// Over a chain of mirrors, if its first is turned to the eye.
    fn over(&self, chain: &'a ImageChain) -> Option<Self> {
        let image = self.lights.chains().unfold(chain, self.eye, self.ahead, self.ahead)?;
        let (eye, ahead, strength) = (image.position, image.normal, chain.strength());
        Some(Self { chain: Some(chain), eye, ahead, strength, ..self.clone() })
    }

    /// What is in front of the camera of a polygon, in pixels.
    fn projected(&self, corners: &[DVec3]) -> Vec<DVec2> {
        let (mut targets, mut spare) = (Vec::new(), Vec::new());
        let mut corners: Vec<DVec3> = corners
            .iter()
            .map(|&corner| {
                let seen = self.chain.map_or(corner.as_vec3(), |chain| {
                    self.lights.chains().targets(chain, corner, &mut targets);
                    targets[0]
                });
                self.camera_from_world.transform_point3(seen).as_dvec3()
            })
            .collect();
        let near = f64::from(self.camera.near).max(NEAREST);
        contour::cut(&mut corners, DVec3::NEG_Z, near, &mut spare);
        let at = |c: &DVec3| self.camera.pixel_of(c.as_vec3(), self.size.0, self.size.1).as_dvec2();
        corners.iter().map(at).collect()
    }
}

impl Cut {
    /// The pixel at `corner`, cut by a convex outline; none where next to nothing lies on one side.
    fn new(outline: &[DVec2], corner: DVec2) -> Option<Self> {
        let turn = if signed_area(outline) < 0.0 { -1.0 } else { 1.0 };
        let mut inside = vec![DVec2::ZERO, DVec2::X, DVec2::ONE, DVec2::Y];
        let mut parts = [Vec::new(), Vec::new()];
        for (a, b) in edges(outline) {
            let (a, b) = (a - corner, b - corner);
            // Positive on the side of the outline.
            let height = |p: DVec2| turn * (b - a).perp_dot(p - a);
            if inside.iter().all(|&p| height(p) >= 0.0) {
                continue;
            }
            let mut outside = Vec::new();
            contour::clip(&inside, |p| -height(p), DVec2::lerp, |p| outside.push(p));
            let mut rest = Vec::new();
            contour::clip(&inside, height, DVec2::lerp, |p| rest.push(p));
            push_fan(&mut parts[1], &outside);
            inside = rest;
        }
        push_fan(&mut parts[0], &inside);
        let sums = parts.each_ref().map(|part| {
            let before = part.iter().scan(0.0, |sum, triangle| {
                *sum += signed_area(triangle).abs();
                Some(*sum)
            });
            std::iter::once(0.0).chain(before).collect::<Vec<f64>>()
        });
        let cut = Self { parts, sums, is_exact: true };
        (0..2).all(|side| cut.area(side) > LEAST_SHARE).then_some(cut)
    }

    /// Share of the pixel on a side.
    fn area(&self, side: usize) -> f64 {
        self.sums[side].last().copied().unwrap_or(0.0)
    }

    /// Where in the pixel the sample of a uniform point of the unit square lies, on which side, and what it counts.
    pub(crate) fn place(&self, point: Vec2) -> (Vec2, usize, f32) {
        let side = usize::from(point.x >= 0.5);
        let along = f64::from(2.0 * point.x) - side as f64;
        let (sums, all) = (&self.sums[side], self.area(side));
        let index = sums[1..].partition_point(|&sum| sum <= along * all).min(self.parts[side].len() - 1);
        let within = (along * all - sums[index]) / (sums[index + 1] - sums[index]);
        let (u, v) = triangle_point(Vec2::new(within.clamp(0.0, 1.0) as f32, point.y));
        let [a, b, c] = self.parts[side][index];
        let place = a + (b - a) * f64::from(u) + (c - a) * f64::from(v);
        (place.as_vec2().clamp(Vec2::ZERO, Vec2::ONE), side, 2.0 * all as f32)
    }

    /// A place inside the outline, which shows the lamp if nothing is before it; none if that is not certain.
    pub(crate) fn inside(&self) -> Option<Vec2> {
        if !self.is_exact {
            return None;
        }
        let weighed = self.parts[0].iter().map(|t| (t[0] + t[1] + t[2]) / 3.0 * signed_area(t).abs());
        Some((weighed.sum::<DVec2>() / self.area(0)).as_vec2())
    }
}

/// Adds the triangles of a convex polygon that have any area.
fn push_fan(triangles: &mut Vec<[DVec2; 3]>, polygon: &[DVec2]) {
    for k in 2..polygon.len() {
        let triangle = [polygon[0], polygon[k - 1], polygon[k]];
        if signed_area(&triangle) != 0.0 {
            triangles.push(triangle);
        }
    }
}

/// The edges of a polygon, from corner to corner.
pub(crate) fn edges(polygon: &[DVec2]) -> impl Iterator<Item = (DVec2, DVec2)> {
    polygon.iter().copied().zip(polygon.iter().copied().cycle().skip(1))
}

/// Area of a polygon, positive if it runs from x to y.
pub(crate) fn signed_area(polygon: &[DVec2]) -> f64 {
    0.5 * edges(polygon).map(|(a, b)| a.perp_dot(b)).sum::<f64>()
}

/// Width of a convex outline where it is narrowest: the least, over its edges, of the greatest distance from an edge.
fn least_width(outline: &[DVec2]) -> f64 {
    let height = |(a, b): (DVec2, DVec2)| {
        let along = (b - a).normalize_or_zero();
        outline.iter().map(|c| along.perp_dot(*c - a).abs()).fold(0.0, f64::max)
    };
    edges(outline).filter(|(a, b)| a != b).map(height).fold(f64::INFINITY, f64::min)
}

/// Visits the pixels that the edges of an outline cross, column by column; some of them twice.
fn crossed(outline: &[DVec2], (width, height): (usize, usize), mut visit: impl FnMut(usize)) {
    let inside = |value: f64, end: usize| value.clamp(0.0, end as f64) as usize;
    for (a, b) in edges(outline) {
        let (a, b) = if a.x <= b.x { (a, b) } else { (b, a) };
        if b.x < 0.0 || a.x >= width as f64 {
            continue;
        }
        let y_at = |x: f64| a.y + (b.y - a.y) * (x - a.x) / (b.x - a.x);
        for x in inside(a.x, width)..inside(b.x.floor() + 1.0, width) {
            let ends = if b.x > a.x {
                [y_at((x as f64).max(a.x)), y_at((x as f64 + 1.0).min(b.x))]
            } else {
                [a.y, b.y]
            };
            let (top, bottom) = (ends[0].min(ends[1]), ends[0].max(ends[1]));
            if bottom >= 0.0 {
                for y in inside(top, height)..inside(bottom.floor() + 1.0, height) {
                    visit(y * width + x);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use catoptric_trace::sequence::{Key, Purpose};

    use super::*;

    fn pixels(outline: &[DVec2]) -> Vec<(usize, usize)> {
        let mut pixels = Vec::new();
        crossed(outline, (8, 8), |index| pixels.push((index % 8, index / 8)));
        pixels.sort_unstable();
        pixels.dedup();
        pixels
    }

    #[test]
    fn an_outline_crosses_pixels() {
        let at = DVec2::new;
        // A strip between two rows of centres.
        let strip = [at(1.2, 2.6), at(4.5, 2.6), at(4.5, 2.9), at(1.2, 2.9)];
        assert_eq!(pixels(&strip), [(1, 2), (2, 2), (3, 2), (4, 2)]);
        assert!((least_width(&strip) - 0.3).abs() < 1e-12);
        // One that leans, partly outside.
        let leaning = [at(-2.0, -0.5), at(2.5, 1.75), at(2.5, 1.8)];
        assert_eq!(pixels(&leaning), [(0, 0), (0, 1), (1, 1), (2, 1)]);
        // Upright, a hair.
        let hair = [at(3.5, 1.5), at(3.5, 3.5), at(3.5, 3.0)];
        assert_eq!(pixels(&hair), [(3, 1), (3, 2), (3, 3)]);
        assert!(least_width(&hair) == 0.0);
        // What is wholly inside is not crossed.
        let square = [at(0.5, 0.5), at(0.5, 3.5), at(3.5, 3.5), at(3.5, 0.5)];
        assert_eq!(pixels(&square).len(), 12);
        assert!(!pixels(&square).contains(&(2, 1)));
        for outside in [at(9.0, 0.0), at(-9.0, 0.0), at(0.0, 9.0), at(0.0, -9.0)] {
            assert!(pixels(&strip.map(|c| c + outside)).is_empty());
        }
    }

    #[test]
    fn both_parts_of_a_pixel_are_sampled_by_their_areas() {
        let at = DVec2::new;
        let corner = at(5.0, 7.0);
        // A corner, a strip across, one from the other side round, and a many-sided disc inside.
        let disc: Vec<DVec2> =
            (0..40).map(|k| at(0.5, 0.4) + 0.3 * DVec2::from_angle(f64::from(k) * 0.157)).collect();
        let outlines = [
            vec![at(-1.0, -1.0), at(1.4, -1.0), at(-1.0, 1.4)],
            vec![at(-3.0, 0.1), at(4.0, 0.5), at(4.0, 0.7), at(-3.0, 0.3)],
            vec![at(-1.0, 1.4), at(1.4, -1.0), at(-1.0, -1.0)],
            disc,
        ];
        for outline in outlines {
            let is_inside = |p: DVec2| {
                let turn = signed_area(&outline).signum();
                edges(&outline).map(|(a, b)| turn * (b - a).perp_dot(p - a)).fold(f64::INFINITY, f64::min)
            };
            let moved: Vec<DVec2> = outline.iter().map(|c| *c + corner).collect();
            let cut = Cut::new(&moved, corner).expect("both sides");
            assert!((cut.area(0) + cut.area(1) - 1.0).abs() < 1e-12);
            // By a fine grid: its cells on the border are at most 3 · 1000 of a million.
            let grid = (0..1_000_000)
                .filter(|k| is_inside(at((k % 1000) as f64 + 0.5, (k / 1000) as f64 + 0.5) / 1000.0) > 0.0);
            assert!((grid.count() as f64 * 1e-6 - cut.area(0)).abs() < 3e-3);
            assert!(is_inside(cut.inside().expect("it is exact").as_dvec2()) > 0.0);
            // The mean of a smooth function, and of the light of a lamp that fills the outline.
            let key = Key::new(3, Purpose::Test, 0);
            let (mut weights, mut moment, mut lamp) = (0.0, Vec2::ZERO, 0.0);
            for index in 0..4096 {
                let (place, side, weight) = cut.place(key.point2(index));
                assert!(
                    (is_inside(place.as_dvec2()) > -1e-6) == (side == 0)
                        || is_inside(place.as_dvec2()).abs() < 1e-6
                );
                weights += weight / 4096.0;
                moment += place * weight / 4096.0;
                lamp += if side == 0 { weight / 4096.0 } else { 0.0 };
            }
            // Half of the samples on each side: their areas are exact but for rounding.
            assert!((weights - 1.0).abs() < 1e-3, "{weights}");
            assert!((f64::from(lamp) - cut.area(0)).abs() < 1e-3);
            // Stratified samples of a linear function: within 1e-3 of the middle.
            assert!(moment.distance(Vec2::splat(0.5)) < 1e-3, "{moment}");
        }
        assert!(Cut::new(&[at(5.0, 7.0), at(6.0, 7.0), at(6.0, 8.0), at(5.0, 8.0)], corner).is_none());
    }
}
