//! Lamps: closed convex surfaces that glow alike everywhere, such as bulbs and glowing boxes.
//!
//! Seen from outside, such a surface is its outline filled with one radiance, so that a receiver asks one polygon instead
//! of hundreds of facets: Lambert's contour formula needs the outline alone (the edges between two facets that are
//! both seen cancel), and shadow rays go where the outline is.

use std::collections::HashMap;
use std::ops::Range;

use glam::DVec3;

use catoptric_scene::{AlphaMode, Rgb, Surface, TriangleId};
use catoptric_trace::plane::Plane;
use catoptric_trace::{PlaneId, Tracer};

use crate::emitter::Cell;
use crate::light_tree::Windows;

/// A closed convex surface of one radiance.
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
}

/// The planes of the facets, outward normal · x = offset, coordinate by coordinate.
#[derive(Clone, Debug, Default)]
struct Facets {
    normals: [Vec<f64>; 3],
    offsets: Vec<f64>,
    planes: Vec<PlaneId>,
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
    facing: Vec<bool>,
    /// Edges between a facet that is seen and one that is not.
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

/// Corners at most: each pair of a facet and a corner is tested once.
const MAX_CORNERS: usize = 1024;
/// Share of the size by which a corner may stand out of a facet's plane: positions are f32, rounded in a transform, and a
/// facet may be a fiftieth of the whole.
const STANDS_OUT: f64 = 1e-5;
/// Cosine between the axis of sight and an outline's corner below which the projection stretches too far.
const MIN_COS: f64 = 0.1;

impl Lamp {
    /// The surface as a lamp, if it is one: emits from its front alone, everywhere the same, and is closed and convex.
    pub fn new(tracer: &Tracer, surface: &Surface, cell: &Cell) -> Option<Self> {
        let scene = tracer.scene();
        let material = &scene.materials()[surface.material.index()];
        let plain = !cell.textured && cell.lobe.is_diffuse() && material.alpha_mode == AlphaMode::Opaque;
        let triangles = surface.triangles.clone();
        // A tetrahedron is the least that is closed.
        if !plain || triangles.len() < 4 || triangles.clone().any(|t| tracer.has_back(TriangleId(t))) {
            return None;
        }
        let mut lamp = Self {
            radiance: cell.radiance,
            triangles: triangles.clone(),
            cells: 0..0,
            center: DVec3::ZERO,
            radius: 0.0,
            corners: Vec::new(),
            facets: Facets::default(),
            edges: Vec::new(),
        };
        let mut known: HashMap<[u32; 3], u32> = HashMap::new();
        // Half-edges wait for their partner.
        let mut open: HashMap<(u32, u32), u32> = HashMap::new();
        for id in triangles.map(TriangleId) {
            let corners = scene.corners(id);
            let ids = corners.map(|c| {
                let key = [c.x, c.y, c.z].map(|v| (v + 0.0).to_bits());
                *known.entry(key).or_insert_with(|| {
                    lamp.corners.push(c.as_dvec3());
                    lamp.corners.len() as u32 - 1
                })
            });
            if lamp.corners.len() > MAX_CORNERS {
                return None;
            }
            // The poles of a sphere have triangles without area.
            if ids[0] == ids[1] || ids[1] == ids[2] || ids[2] == ids[0] {
                continue;
            }
            let [a, b, c] = corners.map(|c| c.as_dvec3());
            let normal = (b - a).cross(c - a).try_normalize()?;
            let facet = lamp.facets.len() as u32;
            lamp.facets.push(normal, normal.dot(a), tracer.planes().of(id));
            for (from, to) in [(ids[0], ids[1]), (ids[1], ids[2]), (ids[2], ids[0])] {
                if let Some(other) = open.remove(&(to, from)) {
                    lamp.edges.push(Edge { ends: [to, from], facets: [other, facet] });
                } else if open.insert((from, to), facet).is_some() {
                    return None;
                }
            }
        }
        if !open.is_empty() || lamp.facets.len() < 4 {
            return None;
        }
        lamp.center = lamp.corners.iter().sum::<DVec3>() / lamp.corners.len() as f64;
        lamp.radius = lamp.corners.iter().map(|c| (*c - lamp.center).length()).fold(0.0, f64::max);
        let slack = STANDS_OUT * lamp.radius;
        // One closed surface, not several, all of whose corners lie behind every facet.
        let stands_out = |corner: &DVec3| lamp.facets.heights(*corner).any(|height| height > slack);
        let is_whole = lamp.corners.len() + lamp.facets.len() == lamp.edges.len() + 2;
        (is_whole && !lamp.corners.iter().any(stands_out)).then_some(lamp)
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
        outline.facing.clear();
        outline.facing.extend(self.facets.heights(eye).map(|height| height > 0.0));
        if hidden != PlaneId::NONE && self.facets.planes.contains(&hidden) {
            return Sight::Facets;
        }
        // Each edge between a facet that is seen and one that is not, in the sense of the one that is.
        outline.next.clear();
        outline.next.resize(self.corners.len(), u32::MAX);
        // Few are: found without a branch for each.
        outline.edges.resize(self.edges.len(), 0);
        let mut count = 0;
        for (index, edge) in self.edges.iter().enumerate() {
            let [a, b] = edge.facets.map(|f| outline.facing[f as usize]);
            outline.edges[count] = index as u32;
            count += usize::from(a != b);
        }
        let mut first = u32::MAX;
        for &index in &outline.edges[..count] {
            let edge = &self.edges[index as usize];
            let seen = outline.facing[edge.facets[0] as usize];
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
