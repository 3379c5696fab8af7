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
    edges: Vec<Edge>,
    /// What glows lies in this plane, if in one.
    plane: PlaneId,
}

/// The planes of the facets, outward normal · x = offset, coordinate by coordinate.
#[derive(Clone, Debug, Default)]
struct Facets {
    normals: [Vec<f64>; 3],
    offsets: Vec<f64>,
    planes: Vec<PlaneId>,
    /// From this one on they are openings.
    glowing: usize,
}

impl Facets {
    fn push(&mut self, normal: DVec3, offset: f64, plane: PlaneId) {
        for (axis, values) in self.normals.iter_mut().enumerate() {
            values.push(normal[axis]);
        }
        self.offsets.push(offset);
        self.planes.push(plane);
    }

    fn len(&self) -> usize {
        self.offsets.len()
    }

    fn normal(&self, facet: usize) -> DVec3 {
        let [x, y, z] = &self.normals;
        DVec3::new(x[facet], y[facet], z[facet])
    }

    /// Heights of a point above all facets.
    fn heights(&self, point: DVec3) -> impl Iterator<Item = f64> {
        let [x, y, z] = &self.normals;
        let normals = x.iter().zip(y).zip(z);
        normals
            .zip(&self.offsets)
            .map(move |(((x, y), z), offset)| x * point.x + y * point.y + z * point.z - offset)
    }
}

/// An edge between two facets; the first has it run from the first end to the second.
#[derive(Clone, Copy, Debug)]
struct Edge {
    ends: [u32; 2],
    facets: [u32; 2],
}

/// The outline of a lamp as an eye sees it, and the buffers that find it.
#[derive(Clone, Debug, Default)]
pub struct Outline {
    /// Corners in the plane before the eye that holds the farthest of them, in order.
    pub corners: Vec<DVec3>,
    /// Unit normal of that plane, away from the eye.
    pub axis: DVec3,
    /// As many as lamps may have once one was asked, so that no index has to be checked.
    facing: Vec<bool>,
    /// Edges between a facet that is seen and one that is not, likewise.
    edges: Vec<u32>,
    next: Vec<u32>,
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

/// Facets, or edges, at most: a convex surface of n corners has no more than 2n − 4 and 3n − 6. A power of two.
const MOST: usize = 4096;
/// Corners at most: each pair of a facet and a corner is tested once.
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
        let first = *shape.facets.planes.first()?;
        let is_flat = first != PlaneId::NONE && shape.facets.planes.iter().all(|p| *p == first);
        shape.close()?;
        if is_flat {
            shape.keep_border()?;
        }
        let Shape { corners, facets, edges, .. } = shape;
        if corners.len() > MAX_CORNERS || facets.len().max(edges.len()) >= MOST {
            return None;
        }
        let center = corners.iter().sum::<DVec3>() / corners.len() as f64;
        let radius = corners.iter().map(|c| (*c - center).length()).fold(0.0, f64::max);
        let rounding = ROUNDING * center.abs().max_element();
        let slack = rounding.clamp(STANDS_OUT * radius, STANDS_OUT_AT_MOST * radius);
        // One closed surface, not several, all of whose corners lie behind every facet.
        let stands_out = |corner: &DVec3| facets.heights(*corner).any(|height| height > slack);
        let is_whole = corners.len() + facets.len() == edges.len() + 2;
        let is_convex = is_whole && !corners.iter().any(stands_out);
        let plane = if is_flat { first } else { PlaneId::NONE };
        let lamp = Self { radiance, triangles, cells: 0..0, center, radius, corners, facets, edges, plane };
        is_convex.then_some(lamp)
    }

    /// The plane that it lies in, if it is flat.
    pub fn plane(&self) -> Option<PlaneId> {
        (self.plane != PlaneId::NONE).then_some(self.plane)
    }

    /// Number of its facets.
    pub fn facet_count(&self) -> usize {
        self.facets.len()
    }

    /// Whether any of it may be seen through the windows.
    pub fn may_be_seen(&self, eye: DVec3, windows: &Windows) -> bool {
        windows.may_show(self.center - eye, self.radius)
    }

    /// No part of it is nearer than this, metres; below zero for a point that may be inside.
    pub(crate) fn distance(&self, point: DVec3) -> f64 {
        (self.center - point).length() - self.radius
    }

    /// How much of it lies where n·x ≥ offset.
    pub fn beyond(&self, plane: Option<Plane>) -> Beyond {
        let height = plane.map_or(f64::INFINITY, |p| p.normal.dot(self.center) - p.offset);
        if height >= self.radius {
            Beyond::Wholly
        } else if height <= -self.radius {
            Beyond::No
        } else {
            Beyond::Partly
        }
    }

    /// Centre and radius of a ball around it, metres.
    pub fn ball(&self) -> (DVec3, f64) {
        (self.center, self.radius)
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
        outline.facing.resize(MOST, false);
        outline.edges.resize(MOST, 0);
        let (Some((facing, _)), Some((edges, _))) =
            (outline.facing.split_first_chunk_mut::<MOST>(), outline.edges.split_first_chunk_mut::<MOST>())
        else {
            return Sight::Hidden;
        };
        for (facing, height) in facing.iter_mut().zip(self.facets.heights(eye)) {
            *facing = height > 0.0;
        }
        if let Some(plane) = self.plane() {
            if plane == hidden || !facing[0] {
                return Sight::Hidden;
            }
            outline.axis = -self.facets.normal(0);
            outline.corners.extend(&self.corners);
            return Sight::Outline;
        }
        let faces_opening = facing[self.facets.glowing..self.facets.len()].contains(&true);
        if faces_opening || hidden != PlaneId::NONE && self.facets.planes.contains(&hidden) {
            return Sight::Facets;
        }
        // Each edge between a facet that is seen and one that is not, in the sense of the one that is.
        outline.next.clear();
        outline.next.resize(self.corners.len(), u32::MAX);
        // Few are: found without a branch for each.
        let mut count = 0;
        for (edge, index) in self.edges.iter().zip(0..) {
            let [a, b] = edge.facets.map(|f| facing[f as usize % MOST]);
            edges[count % MOST] = index;
            count += usize::from(a != b);
        }
        let mut first = u32::MAX;
        for &index in &edges[..count] {
            let edge = &self.edges[index as usize];
            let seen = facing[edge.facets[0] as usize % MOST];
            let [from, to] = if seen { edge.ends } else { [edge.ends[1], edge.ends[0]] };
            // Where rounding makes the outline touch itself, there is no one outline.
            if outline.next[from as usize] != u32::MAX {
                return Sight::Facets;
            }
            outline.next[from as usize] = to;
            first = first.min(from);
        }
        if count == 0 {
            return Sight::Hidden;
        }
        let mut depth = 0.0_f64;
        let mut corner = first;
        for _ in 0..count {
            let sight = self.corners[corner as usize] - eye;
            let along = axis.dot(sight);
            if along < MIN_COS * sight.length() {
                return Sight::Facets;
            }
            depth = depth.max(along);
            outline.corners.push(sight / along);
            corner = outline.next[corner as usize];
            if corner == u32::MAX {
                return Sight::Facets;
            }
        }
        if corner != first || count < 3 {
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
        let normal = facets.normal(0);
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
        flat.push(normal, facets.offsets[0], facets.planes[0]);
        flat.glowing = 1;
        flat.push(-normal, -facets.offsets[0], PlaneId::NONE);
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
