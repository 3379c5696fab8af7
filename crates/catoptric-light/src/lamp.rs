//! Lamps: convex surfaces that glow alike everywhere, such as bulbs, tubes, discs and glowing boxes.
//!
//! Seen from outside, such a surface is its outline filled with one radiance, so that a receiver asks one polygon instead
//! of hundreds of facets: Lambert's contour formula needs the outline alone (the edges between two facets that are
//! both seen cancel), and shadow rays go where the outline is. Flat openings, as at the ends of a tube, count as facets that do
//! not glow: who looks at one asks facet by facet.

use std::collections::HashMap;
use std::ops::Range;

use glam::{DVec3, Vec3};

use catoptric_scene::{AlphaMode, Rgb, Scene, Surface, TriangleId};
use catoptric_trace::plane::Plane;
use catoptric_trace::{PlaneId, Tracer};

use crate::emitter::Cell;
use crate::light_tree::Windows;

/// A convex surface of one radiance, closed but for flat openings.
#[derive(Clone, Debug)]
pub struct Lamp {
    /// What it sends everywhere outside.
    pub radiance: Rgb,
    /// Its triangles.
    pub triangles: Range<u32>,
    /// Its cells, for what has to take them one by one.
    pub cells: Range<u32>,
    center: DVec3,
    radius: f64,
    corners: Vec<DVec3>,
    facets: Facets,
    edges: Edges,
    /// What glows lies in this plane, if in one.
    plane: PlaneId,
    /// Radius of the ball that it is to its receivers, if it is finely divided; metres.
    round: Option<f64>,
}

/// The planes of the facets.
#[derive(Clone, Debug, Default)]
struct Facets {
    planes: Vec<Plane>,
    ids: Vec<PlaneId>,
    /// Sum of the facets, m².
    area: f64,
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

    /// Radius of the ball that sends the same light, if they are one finely divided, with corners within `radius` of its centre: seen from
    /// everywhere in turn, what is convex shows a quarter of its area (Cauchy).
    fn radius_of_ball(&self, center: DVec3, radius: f64) -> Option<f64> {
        let is_closed = self.glowing == self.len();
        let cuts_in = |plane: &Plane| plane.distance(center) > -(1.0 - CUTS_IN) * radius;
        (is_closed && !self.planes.iter().any(cuts_in))
            .then(|| (self.area / (4.0 * std::f64::consts::PI)).sqrt())
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
/// Share of the radius by which the facets of a ball may cut into it: spheres of 1280 triangles and up. What these show differs by 1e-3 between
/// directions, twice this at the very most.
const CUTS_IN: f64 = 5e-3;
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
        if triangles.len() < LEAST_TRIANGLES as usize || ids.any(|t| tracer.has_back(t)) {
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
        let Shape { corners, mut facets, edges, .. } = shape;
        // One closed surface, not several.
        if corners.len() + facets.len() != edges.len() + 2 {
            return None;
        }
        let center = corners.iter().sum::<DVec3>() / corners.len() as f64;
        let radius = corners.iter().map(|c| (*c - center).length()).fold(0.0, f64::max);
        let rounding = ROUNDING * center.abs().max_element();
        let slack = rounding.clamp(STANDS_OUT * radius, STANDS_OUT_AT_MOST * radius);
        let round = facets.radius_of_ball(center, radius);
        // Of what is convex, all corners lie behind every facet.
        let stands_out = |corner: &DVec3| facets.planes.iter().any(|facet| facet.distance(*corner) > slack);
        let is_convex = round.is_some() || corners.len() <= MAX_CORNERS && !corners.iter().any(stands_out);
        let plane = if is_flat { first } else { PlaneId::NONE };
        let edges = Edges::new(&edges);
        facets.ids.sort_unstable();
        facets.ids.dedup();
        let lamp =
            Self { radiance, triangles, cells: 0..0, center, radius, corners, facets, edges, plane, round };
        is_convex.then_some(lamp)
    }

    /// The plane that it lies in, if it is flat.
    pub fn plane(&self) -> Option<PlaneId> {
        (self.plane != PlaneId::NONE).then_some(self.plane)
    }

    /// Facets among which its outline is looked for; none of a ball.
    pub fn facet_count(&self) -> usize {
        if self.round.is_some() { 0 } else { self.facets.len() }
    }

    /// Whether any of it may be seen through the windows.
    pub fn may_be_seen(&self, eye: DVec3, windows: &Windows) -> bool {
        windows.may_show(self.center - eye, self.radius)
    }

    /// No part of it is nearer than this, metres; below zero for a point that may be inside.
    pub(crate) fn distance(&self, point: DVec3) -> f64 {
        (self.center - point).length() - self.radius
    }

    /// How much of what `eye` sees of it through the windows lies where n·x ≥ offset, the last mirror's plane.
    pub fn beyond(&self, plane: Option<Plane>, eye: DVec3, windows: &Windows) -> Beyond {
        let Some(plane) = plane else { return Beyond::Wholly };
        if plane.distance(self.center) <= -self.radius {
            Beyond::No
        } else if windows.show_beyond(eye, self.center, self.radius, &plane) {
            Beyond::Wholly
        } else {
            Beyond::Partly
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
        let Some(radius) = self.round else { return self.outline(eye, geometric, hidden, outline) };
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

/// A surface as it is put together.
#[derive(Default)]
struct Shape {
    corners: Vec<DVec3>,
    facets: Facets,
    edges: Vec<Edge>,
    known: HashMap<[u32; 3], u32>,
    /// Facets with an edge, by the corners that it runs between, that wait for the facet beyond.
    open: HashMap<(u32, u32), u32>,
}

impl Shape {
    /// Adds a triangle. `None` where the whole is no lamp.
    fn add(&mut self, tracer: &Tracer, id: TriangleId) -> Option<()> {
        let corners = tracer.scene().corners(id);
        let ids = corners.map(|c| {
            *self.known.entry(key_of(c)).or_insert_with(|| {
                self.corners.push(c.as_dvec3());
                self.corners.len() as u32 - 1
            })
        });
        // The poles of a sphere have triangles without area.
        if ids[0] == ids[1] || ids[1] == ids[2] || ids[2] == ids[0] {
            return Some(());
        }
        if self.corners.len() > MAX_FLAT_CORNERS {
            return None;
        }
        let [a, b, c] = corners.map(|c| c.as_dvec3());
        let normal = (b - a).cross(c - a).try_normalize()?;
        let facet = self.facets.len() as u32;
        self.facets.area += 0.5 * (b - a).cross(c - a).length();
        self.facets.push(normal, normal.dot(a), tracer.planes().of(id));
        for (from, to) in [(ids[0], ids[1]), (ids[1], ids[2]), (ids[2], ids[0])] {
            if let Some(other) = self.open.remove(&(to, from)) {
                self.edges.push(Edge { ends: [to, from], facets: [other, facet] });
            } else if self.open.insert((from, to), facet).is_some() {
                return None;
            }
        }
        Some(())
    }

    /// Closes each opening by a facet, in the order of their first corners. `None` where one touches itself.
    fn close(&mut self) -> Option<()> {
        self.facets.glowing = self.facets.len();
        let mut border: Vec<((u32, u32), u32)> = self.open.drain().collect();
        border.sort_unstable();
        let mut next = vec![None; self.corners.len()];
        for &((from, to), facet) in &border {
            if next[from as usize].replace((to, facet)).is_some() {
                return None;
            }
        }
        for ((start, _), _) in border {
            let opening = self.facets.len() as u32;
            // Twice its area, along its normal: it runs against its neighbours.
            let mut area = DVec3::ZERO;
            let origin = self.corners[start as usize];
            let mut at = start;
            while let Some((to, facet)) = next[at as usize].take() {
                self.edges.push(Edge { ends: [at, to], facets: [facet, opening] });
                let [a, b] = [at, to].map(|c| self.corners[c as usize] - origin);
                area -= a.cross(b);
                at = to;
            }
            // Others have been gone around with the first of their corners.
            if at != start || area != DVec3::ZERO {
                let normal = area.try_normalize().filter(|_| at == start)?;
                self.facets.push(normal, normal.dot(origin), PlaneId::NONE);
            }
        }
        Some(())
    }

    /// Of a flat shape, only its border matters, and of that the corners where it turns. `None` where it turns inwards, or where there
    /// are several borders.
    fn keep_border(&mut self) -> Option<()> {
        let (facets, glowing) = (&self.facets, self.facets.glowing);
        // Immersed discs turn around once, so that one that never turns inwards is convex.
        let is_disc = self.corners.len() + facets.len() == self.edges.len() + 2;
        if !is_disc || facets.len() != glowing + 1 {
            return None;
        }
        let normal = facets.planes[0].normal;
        let border = self.edges.iter().filter(|e| e.facets[1] as usize == glowing);
        // As they were added: one after the other.
        let around: Vec<DVec3> = border.map(|e| self.corners[e.ends[0] as usize]).collect();
        let count = around.len();
        let mut corners = Vec::new();
        for index in 0..count {
            let [a, b, c] = [count - 1, 0, 1].map(|step| around[(index + step) % count]);
            let (before, after) = (b - a, c - b);
            let turn = before.cross(after).dot(normal) / (before.length() * after.length());
            if turn < -STRAIGHT || before.dot(after) < 0.0 && turn < STRAIGHT {
                return None;
            }
            if turn > STRAIGHT {
                corners.push(b);
            }
        }
        let count = corners.len() as u32;
        if count < 3 {
            return None;
        }
        let mut flat = Facets::default();
        let offset = facets.planes[0].offset;
        flat.push(normal, offset, facets.ids[0]);
        flat.glowing = 1;
        flat.push(-normal, -offset, PlaneId::NONE);
        self.edges = (0..count).map(|i| Edge { ends: [i, (i + 1) % count], facets: [0, 1] }).collect();
        (self.corners, self.facets) = (corners, flat);
        Some(())
    }
}

/// Sine of the angle between edges that count as one: rounding of f32 in edges of a fiftieth of the whole.
const STRAIGHT: f64 = 1e-4;

/// The runs of triangles that share no corner with others.
pub(crate) fn pieces(scene: &Scene, triangles: Range<u32>) -> Vec<Range<u32>> {
    let mut last: HashMap<[u32; 3], u32> = HashMap::new();
    for id in triangles.clone() {
        for corner in scene.corners(TriangleId(id)) {
            last.insert(key_of(corner), id);
        }
    }
    let (mut pieces, mut start, mut reach) = (Vec::new(), triangles.start, triangles.start);
    for id in triangles {
        let corners = scene.corners(TriangleId(id));
        reach = corners.map(|c| last[&key_of(c)]).into_iter().fold(reach, u32::max);
        if id == reach {
            pieces.push(start..id + 1);
            (start, reach) = (id + 1, id + 1);
        }
    }
    pieces
}

/// A corner by its bits; both zeros are one.
fn key_of(corner: Vec3) -> [u32; 3] {
    corner.to_array().map(|v| (v + 0.0).to_bits())
}
