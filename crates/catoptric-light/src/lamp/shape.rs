//! How a lamp is put together from triangles, and which triangles are a piece.

use std::collections::HashMap;
use std::ops::Range;

use glam::{DVec3, Vec3};

use catoptric_scene::{Scene, TriangleId};
use catoptric_trace::{PlaneId, Tracer};

use super::{Edge, Facets, MAX_FLAT_CORNERS};

/// Sine of the angle between edges that count as one: rounding of f32 in edges of a fiftieth of the whole.
const STRAIGHT: f64 = 1e-4;

/// Share of the radius by which the facets of a ball may cut into it: as those of spheres of 24 by 12 quads, or of 320 triangles, do by .017 and .018.
const CUTS_IN: f64 = 0.02;
/// The same for what is a ball to receivers even where lamps are few: spheres of 1280 triangles and up.
const CUTS_IN_LITTLE: f64 = 5e-3;
/// Share by which what a ball shows to a direction may differ from the mean of all: spheres of 320 triangles by .0027 (.001 in the mean square), of 1280 by .0007,
/// of 32 by 16 quads by .0035 (.0008).
const DIFFERS: f64 = 4e-3;
/// Directions in which this is looked at, at most.
const LOOKS: usize = 1024;

/// What a finely divided ball is to its receivers.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ball {
    /// Metres.
    pub(super) radius: f64,
    /// From wherever it is seen, its facets show the same for all that matters.
    pub(super) is_fine: bool,
}

/// A surface as it is put together.
#[derive(Default)]
pub(super) struct Shape {
    pub(super) corners: Vec<DVec3>,
    pub(super) facets: Facets,
    pub(super) edges: Vec<Edge>,
    /// Of the triangles, times their unit normals; m².
    areas: Vec<DVec3>,
    known: HashMap<[u32; 3], u32>,
    /// Facets with an edge, by the corners that it runs between, that wait for the facet beyond.
    open: HashMap<(u32, u32), u32>,
}

impl Shape {
    /// Adds a triangle. `None` where the whole is no lamp.
    pub(super) fn add(&mut self, tracer: &Tracer, id: TriangleId) -> Option<()> {
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
        self.areas.push(0.5 * (b - a).cross(c - a));
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

    /// The ball that sends the same light, if this is one finely divided, with its corners within `radius` of its centre: seen from everywhere in
    /// turn, what is convex shows a quarter of its area (Cauchy).
    pub(super) fn ball(&self, center: DVec3, radius: f64) -> Option<Ball> {
        let is_closed = self.facets.glowing == self.facets.len();
        let cuts_in =
            |share: f64| self.facets.planes.iter().any(|p| p.distance(center) > -(1.0 - share) * radius);
        if !is_closed || cuts_in(CUTS_IN) {
            return None;
        }
        let area: f64 = self.areas.iter().map(|area| area.length()).sum();
        let mean = 0.25 * area;
        let shown = |towards: DVec3| self.areas.iter().map(|area| area.dot(towards).max(0.0)).sum::<f64>();
        // Of what is turned on a lathe, poles show the most, the middles of facets at the equator the least.
        let corners = self.corners.iter().map(|corner| (*corner - center).normalize());
        let normals = self.facets.planes.iter().map(|plane| plane.normal);
        let looks = corners.chain(normals).step_by((self.corners.len() + self.facets.len()).div_ceil(LOOKS));
        let is_round = looks.into_iter().all(|towards| (shown(towards) - mean).abs() <= DIFFERS * mean);
        let radius = (area / (4.0 * std::f64::consts::PI)).sqrt();
        is_round.then(|| Ball { radius, is_fine: !cuts_in(CUTS_IN_LITTLE) })
    }

    /// Closes each opening by a facet, in the order of their first corners. `None` where one touches itself.
    pub(super) fn close(&mut self) -> Option<()> {
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
    pub(super) fn keep_border(&mut self) -> Option<()> {
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
