//! Lamps: convex surfaces that glow alike everywhere, such as bulbs, tubes, discs and glowing boxes.
//!
//! Seen from outside, such a surface is its outline filled with one radiance, so that a receiver asks one polygon instead
//! of hundreds of facets: Lambert's contour formula needs the outline alone (the edges between two facets that are
//! both seen cancel), and shadow rays go where the outline is. Flat openings, as at the ends of a tube, count as facets that do
//! not glow: who looks at one asks facet by facet.

mod extent;
mod shape;

use std::collections::HashMap;
use std::ops::Range;

use glam::DVec3;

use catoptric_scene::{AlphaMode, Rgb, Surface, TriangleId};
use catoptric_trace::plane::Plane;
use catoptric_trace::{PlaneId, Tracer};

use crate::emitter::Cell;
use crate::light_tree::Windows;

use extent::Extent;
use shape::{Ball, Shape};

pub(crate) use shape::pieces;

/// A convex surface of one radiance, closed but for flat openings.
#[derive(Clone, Debug)]
pub struct Lamp {
    /// What it sends everywhere outside.
    pub radiance: Rgb,
    /// Its triangles.
    pub triangles: Range<u32>,
    /// Its cells, for what has to take them one by one.
    pub cells: Range<u32>,
    /// The root of a tree over them in [`Emitters::tree`](crate::emitter::Emitters::tree), where mirrors' planes cut the lamp and they are many.
    pub root: Option<u32>,
    center: DVec3,
    radius: f64,
    /// A box around it, where that is much narrower than the ball.
    extent: Option<Extent>,
    corners: Vec<DVec3>,
    facets: Facets,
    edges: Edges,
    /// What glows lies in this plane, if in one.
    plane: PlaneId,
    /// The ball that it is to its receivers, if it is finely divided.
    round: Option<Ball>,
    /// Its corners are few, and all of them lie behind every facet: it has an outline.
    is_convex: bool,
}

/// The planes of the facets.
#[derive(Clone, Debug, Default)]
struct Facets {
    planes: Vec<Plane>,
    ids: Vec<PlaneId>,
    /// From this one on they are openings.
    glowing: usize,
}

impl Facets {
    fn push(&mut self, normal: DVec3, offset: f64, id: PlaneId) {
        self.planes.push(Plane { normal, offset });
        self.ids.push(id);
    }

    fn len(&self) -> usize {
        self.planes.len()
    }
}

/// An edge between two facets; the first has it run from the first end to the second.
#[derive(Clone, Copy, Debug)]
struct Edge {
    ends: [u32; 2],
    facets: [u32; 2],
}

/// An edge as one of its facets has it.
#[derive(Clone, Copy, Debug)]
struct HalfEdge {
    from: u32,
    facet: u32,
    /// The next one around the facet.
    next: u32,
}

/// The edges of a closed surface, as halves: those of one edge are neighbours, an even one and the odd one after it.
#[derive(Clone, Debug, Default)]
struct Edges {
    halves: Vec<HalfEdge>,
    /// Coprime to the number of edges: steps that pass through all of them, far from each other.
    stride: usize,
}

impl Edges {
    fn new(edges: &[Edge]) -> Self {
        let mut after: HashMap<(u32, u32), u32> = HashMap::new();
        let mut halves = Vec::new();
        for &Edge { ends, facets } in edges {
            for side in 0..2 {
                after.insert((facets[side], ends[side]), halves.len() as u32);
                halves.push(HalfEdge { from: ends[side], facet: facets[side], next: 0 });
            }
        }
        for index in 0..halves.len() {
            let key = (halves[index].facet, halves[index ^ 1].from);
            // A facet's corners are gone around once each, so that every half edge has one after it.
            halves[index].next = after.get(&key).copied().unwrap_or(index as u32);
        }
        let is_coprime = |stride: usize| {
            let (mut a, mut b) = (edges.len(), stride);
            while b != 0 {
                (a, b) = (b, a % b);
            }
            a == 1
        };
        let golden = edges.len() * 618 / 1000;
        let stride = (golden.max(1)..).find(|s| is_coprime(*s)).unwrap_or(1);
        Self { halves, stride }
    }

    /// Number of edges.
    fn len(&self) -> usize {
        self.halves.len() / 2
    }

    /// The other half of an edge.
    fn twin(half: u32) -> u32 {
        half ^ 1
    }

    /// The halves whose facets are seen where the others' are not, one after the other: the first such one that is met, and on
    /// from there. Nothing where none is; `false` where they do not close.
    fn outline(&self, is_seen: impl Fn(u32) -> bool, found: &mut Vec<u32>) -> bool {
        found.clear();
        let facing = |half: u32| is_seen(self.halves[half as usize].facet);
        let count = self.len();
        let mut edge = 0;
        let first = (0..count).find_map(|_| {
            let half = 2 * edge as u32;
            edge = (edge + self.stride) % count;
            match (facing(half), facing(Self::twin(half))) {
                (true, false) => Some(half),
                (false, true) => Some(Self::twin(half)),
                _ => None,
            }
        });
        let Some(first) = first else { return true };
        let mut half = first;
        loop {
            found.push(half);
            // Around the corner where it ends, from what is seen to what is not.
            half = self.halves[half as usize].next;
            let mut turns = 0;
            while facing(Self::twin(half)) && turns < count {
                half = self.halves[Self::twin(half) as usize].next;
                turns += 1;
            }
            if half == first {
                return true;
            }
            if found.len() >= count || turns >= count {
                return false;
            }
        }
    }
}

/// The outline of a lamp as an eye sees it, and the buffers that find it.
#[derive(Clone, Debug, Default)]
pub struct Outline {
    /// Corners in the plane before the eye that holds the farthest of them, in order.
    pub corners: Vec<DVec3>,
    /// Unit normal of that plane, away from the eye.
    pub axis: DVec3,
    /// Half edges between a facet that is seen and one that is not.
    halves: Vec<u32>,
}

/// How an eye sees a lamp.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sight {
    /// Not at all: from inside, or from below the horizon.
    Hidden,
    /// As its outline.
    Outline,
    /// From so near that it fills the view: facet by facet.
    Facets,
}

/// How much of a lamp lies beyond a plane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Beyond {
    /// Nothing.
    No,
    /// A part.
    Partly,
    /// All.
    Wholly,
}

/// Corners of what is no ball at most: each pair of a facet and a corner is tested once, and a longer outline is slower than a tree of facets.
const MAX_CORNERS: usize = 1024;
/// Corners of what may be flat at most.
const MAX_FLAT_CORNERS: usize = 1 << 16;
/// Share of the size by which a corner may stand out of a facet's plane: positions are f32, rounded in a transform, and a
/// facet may be a fiftieth of the whole.
const STANDS_OUT: f64 = 1e-5;
/// The same by rounding (2⁻²⁴ of a coordinate) far from the origin, as facets of a twentieth of the whole lengthen it, and the share of the size
/// above which it would hide dents.
const ROUNDING: f64 = 1.2e-6;
const STANDS_OUT_AT_MOST: f64 = 1e-3;
/// Cosine between the axis of sight and an outline's corner below which the projection stretches too far.
const MIN_COS: f64 = 0.1;
/// Corners of a ball's outline. With the circle's area, light from it is right to 3e-5 from wherever it is seen as an outline: all that
/// 16 corners get wrong is its higher moments.
const CIRCLE: [[f64; 2]; 16] = {
    const A: f64 = 0.9238795325112867;
    const B: f64 = std::f64::consts::FRAC_1_SQRT_2;
    const C: f64 = 0.3826834323650898;
    [
        [1.0, 0.0],
        [A, C],
        [B, B],
        [C, A],
        [0.0, 1.0],
        [-C, A],
        [-B, B],
        [-A, C],
        [-1.0, 0.0],
        [-A, -C],
        [-B, -B],
        [-C, -A],
        [0.0, -1.0],
        [C, -A],
        [B, -B],
        [A, -C],
    ]
};
/// Sine of the cone around a ball above which its facets matter: from nearer than a tenth of its radius, and inside.
const MAX_SINE: f64 = 0.9;
/// √(π/8 ∕ sin π/8): by so much farther out than the circle are these corners, for its area.
const STRETCH: f64 = 1.0130015562559769;
/// Share of the ball's radius below which a box that is somewhere as thin as this is worth asking, too.
const NARROW: f64 = 0.5;
/// Triangles at least: two of a plane are a cell, or two.
const LEAST_TRIANGLES: u32 = 3;

impl Lamp {
    /// The lamps of a surface that emits from its front alone, everywhere the same: each of its pieces that is one. `cell` is any of its cells.
    pub fn all_of<'a>(
        tracer: &'a Tracer,
        surface: &Surface,
        cell: &'a Cell,
    ) -> impl Iterator<Item = Self> + use<'a> {
        let material = &tracer.scene().materials()[surface.material.index()];
        let plain = !cell.textured && cell.lobe.is_diffuse() && material.alpha_mode == AlphaMode::Opaque;
        let triangles = if plain { surface.triangles.clone() } else { 0..0 };
        pieces(tracer.scene(), triangles)
            .into_iter()
            .filter_map(move |piece| Self::new(tracer, piece, cell.radiance))
    }

    /// The triangles as a lamp, if they are one: convex, and closed but for flat openings.
    fn new(tracer: &Tracer, triangles: Range<u32>, radiance: Rgb) -> Option<Self> {
        let mut ids = triangles.clone().map(TriangleId);
        if triangles.len() < LEAST_TRIANGLES as usize
            || ids.any(|t| tracer.has_back(t) || tracer.is_covered(t))
        {
            return None;
        }
        let mut shape = Shape::default();
        for id in triangles.clone().map(TriangleId) {
            shape.add(tracer, id)?;
        }
        let first = *shape.facets.ids.first()?;
        let is_flat = first != PlaneId::NONE && shape.facets.ids.iter().all(|p| *p == first);
        shape.close()?;
        if is_flat {
            shape.keep_border()?;
        }
        // One closed surface, not several.
        if shape.corners.len() + shape.facets.len() != shape.edges.len() + 2 {
            return None;
        }
        let center = shape.corners.iter().sum::<DVec3>() / shape.corners.len() as f64;
        let radius = shape.corners.iter().map(|c| (*c - center).length()).fold(0.0, f64::max);
        let round = shape.ball(center, radius);
        let Shape { corners, mut facets, edges, .. } = shape;
        let rounding = ROUNDING * center.abs().max_element();
        let slack = rounding.clamp(STANDS_OUT * radius, STANDS_OUT_AT_MOST * radius);
        // Of what is convex, all corners lie behind every facet.
        let stands_out = |corner: &DVec3| facets.planes.iter().any(|facet| facet.distance(*corner) > slack);
        let is_fine = round.is_some_and(|ball| ball.is_fine);
        let is_convex = !is_fine && corners.len() <= MAX_CORNERS && !corners.iter().any(stands_out);
        let plane = if is_flat { first } else { PlaneId::NONE };
        let edges = Edges::new(&edges);
        facets.ids.sort_unstable();
        facets.ids.dedup();
        let extent = Extent::around(&corners).filter(|extent| extent.least() < NARROW * radius);
        let cells = 0..0;
        let lamp = Self {
            radiance,
            triangles,
            cells,
            root: None,
            center,
            radius,
            extent,
            corners,
            facets,
            edges,
            plane,
            round,
            is_convex,
        };
        (round.is_some() || is_convex).then_some(lamp)
    }

    /// The plane that it lies in, if it is flat.
    pub fn plane(&self) -> Option<PlaneId> {
        (self.plane != PlaneId::NONE).then_some(self.plane)
    }

    /// It is a ball whose facets show a little more to one side than to another, and has an outline that shows this.
    pub fn is_coarse_ball(&self) -> bool {
        self.is_convex && self.round.is_some()
    }

    /// Has its outline from now on, if it can.
    pub fn keep_outline(&mut self) {
        if self.is_convex {
            self.round = None;
        }
    }

    /// Whether a plane may cut it.
    pub(crate) fn may_be_cut_by(&self, plane: &Plane) -> bool {
        plane.distance(self.center).abs() < self.radius
    }

    /// Whether a point lies inside of it, where nobody sees it: of what is closed.
    pub(crate) fn holds(&self, point: DVec3) -> bool {
        let is_closed = self.facets.glowing == self.facets.len();
        is_closed && self.distance(point) < 0.0 && self.facets.planes.iter().all(|p| p.distance(point) < 0.0)
    }

    /// Facets among which its outline is looked for; none of a ball.
    pub fn facet_count(&self) -> usize {
        if self.round.is_some() { 0 } else { self.facets.len() }
    }

    /// Whether any of it may be seen through the windows.
    pub fn may_be_seen(&self, eye: DVec3, windows: &Windows) -> bool {
        windows.may_show(self.center - eye, self.radius)
            && self.extent.as_ref().is_none_or(|e| windows.may_show_where(|n| e.most_along(*n, eye) > 0.0))
    }

    /// No part of it is nearer than this, metres; below zero for a point that may be inside.
    pub(crate) fn distance(&self, point: DVec3) -> f64 {
        (self.center - point).length() - self.radius
    }

    /// How much of what `eye` sees of it through the windows lies where n·x ≥ offset, the last mirror's plane. `behind` is a buffer.
    pub fn beyond(
        &self,
        plane: Option<Plane>,
        eye: DVec3,
        windows: &Windows,
        behind: &mut Vec<DVec3>,
    ) -> Beyond {
        let Some(plane) = plane else { return Beyond::Wholly };
        let is_behind = |e: &Extent| e.most_along(plane.normal, DVec3::ZERO) <= plane.offset;
        if plane.distance(self.center) <= -self.radius || self.extent.as_ref().is_some_and(is_behind) {
            Beyond::No
        } else if windows.show_beyond(eye, self.center, self.radius, &plane)
            || self.shows_nothing_behind(&plane, eye, windows, behind)
        {
            Beyond::Wholly
        } else {
            Beyond::Partly
        }
    }

    /// Whether the windows show nothing of what of it lies where n·x < offset, by its corners: of balls that is known already.
    fn shows_nothing_behind(
        &self,
        plane: &Plane,
        eye: DVec3,
        windows: &Windows,
        behind: &mut Vec<DVec3>,
    ) -> bool {
        if self.round.is_some() {
            return false;
        }
        self.find_behind(plane, behind);
        behind.is_empty() || windows.show_none_of(eye, behind)
    }

    /// The corners of what of it lies where n·x < offset.
    fn find_behind(&self, plane: &Plane, corners: &mut Vec<DVec3>) {
        corners.clear();
        corners.extend(self.corners.iter().filter(|c| plane.distance(**c) < 0.0));
        if corners.is_empty() {
            return;
        }
        for edge in self.edges.halves.chunks_exact(2) {
            let [one, other] = [edge[0], edge[1]].map(|half| self.corners[half.from as usize]);
            let [from, to] = [one, other].map(|end| plane.distance(end));
            if from * to < 0.0 {
                corners.push(one.lerp(other, from / (from - to)));
            }
        }
    }

    /// Centre and radius of a ball around it, metres.
    pub fn ball(&self) -> (DVec3, f64) {
        (self.center, self.radius)
    }

    /// [`Lamp::outline`] for a receiver of its light, to whom a finely divided ball is round: an outline of few corners that sends as much.
    pub fn outline_of_light(
        &self,
        eye: DVec3,
        geometric: DVec3,
        hidden: PlaneId,
        outline: &mut Outline,
    ) -> Sight {
        let Some(Ball { radius, .. }) = self.round else {
            return self.outline(eye, geometric, hidden, outline);
        };
        outline.corners.clear();
        let offset = self.center - eye;
        let distance = offset.length();
        if geometric.dot(offset) + self.radius <= 0.0 {
            return Sight::Hidden;
        }
        // Sine and cosine of the cone that touches the ball.
        let sine = radius / distance;
        if sine > MAX_SINE {
            return self.outline(eye, geometric, hidden, outline);
        }
        if self.is_in(hidden) {
            return Sight::Facets;
        }
        let cosine = (1.0 - sine * sine).sqrt();
        let axis = offset / distance;
        let (right, up) = axis.any_orthonormal_pair();
        let (center, reach) = (eye + offset * (cosine * cosine), radius * cosine * STRETCH);
        outline.axis = axis;
        outline.corners.extend(CIRCLE.iter().map(|[x, y]| center + (right * *x - up * *y) * reach));
        Sight::Outline
    }

    /// Whether any of its facets lies in the plane.
    fn is_in(&self, plane: PlaneId) -> bool {
        plane != PlaneId::NONE && self.facets.ids.binary_search(&plane).is_ok()
    }

    /// Finds the outline from `eye`, above the horizon of its unit normal `geometric` at least in part. What faces the eye
    /// and lies in the plane `hidden` is not seen at all, and nothing of the lamp is then an outline.
    pub fn outline(&self, eye: DVec3, geometric: DVec3, hidden: PlaneId, outline: &mut Outline) -> Sight {
        outline.corners.clear();
        let offset = self.center - eye;
        if geometric.dot(offset) + self.radius <= 0.0 {
            return Sight::Hidden;
        }
        let Some(axis) = offset.try_normalize() else { return Sight::Hidden };
        outline.axis = axis;
        let is_seen = |facet: u32| self.facets.planes[facet as usize].distance(eye) > 0.0;
        if let Some(plane) = self.plane() {
            if plane == hidden || !is_seen(0) {
                return Sight::Hidden;
            }
            outline.axis = -self.facets.planes[0].normal;
            outline.corners.extend(&self.corners);
            return Sight::Outline;
        }
        let openings = self.facets.glowing as u32..self.facets.len() as u32;
        if openings.into_iter().any(is_seen) || self.is_in(hidden) {
            return Sight::Facets;
        }
        if !self.edges.outline(is_seen, &mut outline.halves) {
            return Sight::Facets;
        }
        let corner_of = |half: &u32| self.edges.halves[*half as usize].from;
        // From its first corner on: what it is does not depend on where it was found.
        let first = (0..outline.halves.len()).min_by_key(|i| corner_of(&outline.halves[*i]));
        let Some(first) = first else { return Sight::Hidden };
        outline.halves.rotate_left(first);
        let mut depth = 0.0_f64;
        for half in &outline.halves {
            let sight = self.corners[corner_of(half) as usize] - eye;
            let along = axis.dot(sight);
            if along < MIN_COS * sight.length() {
                return Sight::Facets;
            }
            depth = depth.max(along);
            outline.corners.push(sight / along);
        }
        // Where rounding has it that a few facets are seen over the true outline, theirs may have been found.
        let ahead = outline.corners.iter().cycle().skip(1);
        if outline.corners.iter().zip(ahead).any(|(a, b)| a.cross(*b).dot(axis) >= 0.0) {
            return Sight::Facets;
        }
        for corner in &mut outline.corners {
            *corner = eye + *corner * depth;
        }
        Sight::Outline
    }
}
