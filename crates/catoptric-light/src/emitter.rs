//! Area emitters: cells (triangles and parallelograms), kept in a [`LightTree`] or joined to [`Lamp`]s.

use glam::DVec3;

use catoptric_scene::{Barycentric, Lobe, Rgb, Side, Surface, TriangleId};
use catoptric_trace::chain::Event;
use catoptric_trace::plane::Plane;
use catoptric_trace::sequence::triangle_point;
use catoptric_trace::{PlaneId, Tracer};

use crate::broad;
use crate::contour::{self, Polygon};
use crate::lamp::Lamp;
use crate::light_tree::LightTree;

/// A triangle or parallelogram that emits from one side (two-sided emitters are two cells).
#[derive(Clone, Copy, Debug)]
pub struct Cell {
    /// corner, edge a, edge b.
    pub(crate) corner: DVec3,
    edges: [DVec3; 2],
    /// A parallelogram, else a triangle.
    parallelogram: bool,
    /// Unit normal of the emitting side.
    pub normal: DVec3,
    /// Area, m².
    pub area: f64,
    /// Mean over the cell of the power per area over π: radiance, but for the lobe's factor.
    pub radiance: Rgb,
    /// How it is spread over angles.
    pub lobe: Lobe,
    /// Radiance varies over the cell: by a texture, or because something lies on it.
    pub textured: bool,
    /// Something may lie on it, in its plane.
    covered: bool,
    /// Its plane.
    pub plane: PlaneId,
    /// The emitting side.
    pub side: Side,
    /// Its one or two triangles.
    triangles: [TriangleId; 2],
}

impl Cell {
    /// Its outline.
    pub fn polygon(&self) -> Polygon {
        let (corners, count) = self.corners();
        Polygon::new(&corners[..count])
    }

    /// Its corners, and how many of these count.
    #[inline]
    pub(crate) fn corners(&self) -> ([DVec3; 4], usize) {
        let (a, b) = (self.corner + self.edges[0], self.corner + self.edges[1]);
        if self.parallelogram {
            ([self.corner, a, a + self.edges[1], b], 4)
        } else {
            ([self.corner, a, b, b], 3)
        }
    }

    /// Whether its emitting side is turned towards a point.
    #[inline]
    pub(crate) fn faces(&self, point: DVec3) -> bool {
        self.normal.dot(point - self.corner) > 0.0
    }

    /// The point of unit-square coordinates (s, t), uniform by area.
    #[inline]
    pub fn point(&self, s: f64, t: f64) -> DVec3 {
        let (u, v) = if self.parallelogram {
            (s, t)
        } else {
            let (u, v) = triangle_point(glam::Vec2::new(s as f32, t as f32));
            (f64::from(u), f64::from(v))
        };
        self.corner + self.edges[0] * u + self.edges[1] * v
    }

    /// Power per area over π at a point of the cell.
    pub fn radiance_at(&self, tracer: &Tracer, point: DVec3) -> Rgb {
        if !self.textured {
            return self.radiance;
        }
        let scene = tracer.scene();
        // The triangle that holds the point has the larger smallest coordinate.
        let best = self
            .triangles
            .iter()
            .map(|&id| {
                let [a, b, c] = scene.corners(id).map(|p| p.as_dvec3());
                let (e, f, p) = (b - a, c - a, point - a);
                let n = e.cross(f);
                let d = n.length_squared();
                let u = p.cross(f).dot(n) / d;
                let v = e.cross(p).dot(n) / d;
                (u.min(v).min(1.0 - u - v), id, Barycentric { u: u as f32, v: v as f32 })
            })
            .max_by(|x, y| x.0.total_cmp(&y.0));
        best.map_or(self.radiance, |(_, id, at)| {
            if self.covered && !self.triangles.contains(&tracer.on_top_of(id, self.side, point.as_vec3())) {
                return Rgb::ZERO;
            }
            let point = scene.surface_point(id, at);
            point.emission.0 * point.opacity
        })
    }

    /// Irradiance at a point by a part of the cell, by unit [`Cell::radiance`].
    #[inline]
    pub fn unit_irradiance(&self, position: DVec3, normal: DVec3, part: &Polygon) -> f64 {
        if self.lobe.is_diffuse() {
            contour::irradiance(position, normal, part)
        } else {
            contour::lobed_irradiance(position, normal, part, self.normal, f64::from(self.lobe.exponent()))
        }
    }

    /// What a narrow lobe leaves of a part of the cell, seen from `position`: all but a border the integrand in
    /// which, cosⁿ⁺³ over the square of the height, is below 1e-5 of that straight above. Samples of the whole
    /// would hardly meet the rest.
    pub(crate) fn lit_part(&self, position: DVec3, part: Polygon) -> Polygon {
        let cos = libm::pow(1e-5, 1.0 / (f64::from(self.lobe.exponent()) + 3.0));
        let height = self.normal.dot(position - self.corner);
        let reach = height * (1.0 - cos * cos).sqrt() / cos;
        let foot = position - self.normal * height;
        let along = self.edges[0].normalize_or_zero();
        let mut left = part;
        for direction in [along, self.normal.cross(along)] {
            let at = direction.dot(foot);
            left = left.clipped(direction, at - reach).clipped(-direction, -at - reach);
        }
        if left.is_empty() { part } else { left }
    }

    /// Bound of the radiance (sum of channels) times the area, grazing angles of lobes below n = 1 aside.
    pub(crate) fn strength(&self) -> f64 {
        f64::from(self.radiance.element_sum()) * self.lobe.peak() * self.area
    }

    /// Whether a triangle is one of its own.
    pub(crate) fn holds(&self, triangle: TriangleId) -> bool {
        self.triangles.contains(&triangle)
    }

    /// Whether a straight line meets the emitting side.
    pub(crate) fn meets(&self, origin: DVec3, direction: DVec3) -> bool {
        let towards = -self.normal.dot(direction);
        if towards <= 0.0 {
            return false;
        }
        let t = self.normal.dot(origin - self.corner) / towards;
        if t <= 0.0 {
            return false;
        }
        let p = origin + direction * t - self.corner;
        let [a, b] = self.edges;
        let n = a.cross(b);
        let d = n.length_squared();
        let (u, v) = (p.cross(b).dot(n) / d, a.cross(p).dot(n) / d);
        u >= 0.0 && v >= 0.0 && if self.parallelogram { u <= 1.0 && v <= 1.0 } else { u + v <= 1.0 }
    }

    /// One of its triangles.
    pub(crate) fn triangle(&self) -> TriangleId {
        self.triangles[0]
    }

    pub(crate) fn centroid(&self) -> DVec3 {
        let [a, b] = self.edges;
        self.corner + if self.parallelogram { (a + b) * 0.5 } else { (a + b) / 3.0 }
    }

    pub(crate) fn radius(&self) -> f64 {
        let center = self.centroid();
        self.polygon().corners().iter().map(|c| (*c - center).length()).fold(0.0, f64::max)
    }
}

/// All area emitters of a scene.
#[derive(Clone, Debug, Default)]
pub struct Emitters {
    cells: Vec<Cell>,
    /// Over the first cells, those of no lamp.
    tree: LightTree,
    lamps: Vec<Lamp>,
    /// Emitters so large that hemisphere rays see them well: whole walls. Not in the tree.
    broad: Vec<Cell>,
    /// Per triangle: emits anywhere, either side.
    emits: Vec<bool>,
    is_broad: Vec<bool>,
    triangles: usize,
}

/// Each receiver asks every lamp.
const MAX_LAMPS: usize = 256;
/// So few coarse balls are asked by their outlines: it costs little. (Two in interior: 3 % of the time, and closer by 1 % of FLIP.)
const FEW_BALLS: usize = 4;
/// Facets above which those of a lamp that a mirror's plane cuts are asked by a tree.
const MANY_FACETS: usize = 64;
/// Facets of all lamps but balls at most: each receiver looks for outlines among them.
const MAX_FACETS: usize = 1 << 17;

/// Texture samples along each side of a cell that find its mean radiance; half as many where cells are many.
const TEXTURE_SAMPLES: u32 = 16;
/// Emitting triangles that are many.
const MANY: usize = 4096;

impl Emitters {
    /// Collects every emitting side.
    pub fn new(tracer: &Tracer) -> Self {
        let scene = tracer.scene();
        let triangles = scene.triangles().len();
        let mut emitters =
            Self { emits: vec![false; triangles], is_broad: vec![false; triangles], ..Self::default() };
        let emitting = |s: &&Surface| scene.materials()[s.material.index()].emits();
        let many = scene.surfaces().iter().filter(emitting).map(|s| s.triangles.len()).sum::<usize>() > MANY;
        for surface in scene.surfaces() {
            let material = &scene.materials()[surface.material.index()];
            if !material.emits() {
                continue;
            }
            let mut index = surface.triangles.start;
            while index < surface.triangles.end {
                let id = TriangleId(index);
                let next = (index + 1 < surface.triangles.end).then_some(TriangleId(index + 1));
                let joined = next.and_then(|n| parallelogram(tracer, id, n));
                let (corner, edges, triangles) = match joined {
                    Some((corner, edges)) => (corner, edges, [id, TriangleId(index + 1)]),
                    None => {
                        let [a, b, c] = scene.corners(id).map(|p| p.as_dvec3());
                        (a, [b - a, c - a], [id, id])
                    }
                };
                index += if joined.is_some() { 2 } else { 1 };
                emitters.emits[triangles[0].index()] = true;
                emitters.emits[triangles[1].index()] = true;
                emitters.triangles += if joined.is_some() { 2 } else { 1 };
                let sides: &[Side] =
                    if tracer.has_back(id) { &[Side::Front, Side::Back] } else { &[Side::Front] };
                for &side in sides {
                    emitters.push(tracer, corner, edges, joined.is_some(), triangles, side, many);
                }
            }
        }
        emitters.separate_broad(tracer);
        emitters.build(tracer);
        emitters
    }

    /// Takes the broad cells out of the list.
    fn separate_broad(&mut self, tracer: &Tracer) {
        let broad = broad::broad(tracer, &self.cells);
        for &index in &broad {
            let cell = self.cells[index];
            self.broad.push(cell);
            for triangle in cell.triangles {
                self.is_broad[triangle.index()] = true;
            }
        }
        let mut index = 0;
        self.cells.retain(|_| {
            index += 1;
            !broad.contains(&(index - 1))
        });
    }

    /// Broad emitters.
    pub fn broad(&self) -> &[Cell] {
        &self.broad
    }

    /// Whether a triangle is part of a broad emitter.
    #[inline]
    pub fn is_broad(&self, triangle: TriangleId) -> bool {
        self.is_broad[triangle.index()]
    }

    /// Radiance that a triangle sends against `direction` as part of a broad emitter; `None` if it is part of none.
    pub fn broad_from(&self, triangle: TriangleId, direction: DVec3) -> Option<Rgb> {
        let is_seen = |cell: &&Cell| cell.triangles.contains(&triangle) && cell.normal.dot(direction) < 0.0;
        self.is_broad(triangle).then(|| self.broad.iter().filter(is_seen).map(|cell| cell.radiance).sum())
    }

    /// Radiance of all broad emitters that a straight line out of the plane `from` meets from the front, blocked or not.
    #[inline]
    pub fn broad_along(&self, origin: DVec3, from: PlaneId, direction: DVec3) -> Rgb {
        self.broad
            .iter()
            .filter(|cell| cell.plane != from && cell.meets(origin, direction))
            .map(|cell| cell.radiance)
            .sum()
    }

    fn push(
        &mut self,
        tracer: &Tracer,
        corner: DVec3,
        edges: [DVec3; 2],
        parallelogram: bool,
        triangles: [TriangleId; 2],
        side: Side,
        many: bool,
    ) {
        let scene = tracer.scene();
        let cross = edges[0].cross(edges[1]);
        let covered = triangles.iter().any(|&id| tracer.is_covered_on(id, side));
        let textured = scene.material_of(triangles[0]).emission_texture.is_some()
            || scene.material_of(triangles[0]).base_texture.is_some()
            || covered;
        let mut cell = Cell {
            corner,
            edges,
            parallelogram,
            normal: side.orient(scene.geometric_normal(triangles[0])).as_dvec3(),
            area: cross.length() * if parallelogram { 1.0 } else { 0.5 },
            radiance: {
                let point = scene.surface_point(triangles[0], Barycentric { u: 1.0 / 3.0, v: 1.0 / 3.0 });
                point.emission.0 * point.opacity
            },
            lobe: scene.material_of(triangles[0]).lobe,
            textured,
            covered,
            plane: tracer.planes().of(triangles[0]),
            side,
            triangles,
        };
        if textured {
            // The mean over a grid decides shares only; what arrives is sampled.
            let side = if many { TEXTURE_SAMPLES / 2 } else { TEXTURE_SAMPLES };
            let mut sum = Rgb::ZERO;
            for i in 0..side * side {
                let at = |k: u32| (f64::from(k) + 0.5) / f64::from(side);
                sum += cell.radiance_at(tracer, cell.point(at(i % side), at(i / side)));
            }
            cell.radiance = sum / (side * side) as f32;
        }
        if cell.radiance.max_element() > 0.0 && cell.area > 0.0 {
            self.cells.push(cell);
        }
    }

    /// Puts the cells in order, neighbours beside each other, those of lamps last, and makes the tree over the others.
    fn build(&mut self, tracer: &Tracer) {
        let in_order = |cells: &[Cell], order: &[u32]| order.iter().map(|&i| cells[i as usize]).collect();
        let (tree, order) = LightTree::new(&self.cells);
        let cells: Vec<Cell> = in_order(&self.cells, &order);
        let mut lamps = self.find_lamps(tracer);
        if lamps.is_empty() {
            (self.tree, self.cells) = (tree, cells);
            return;
        }
        let lamp_of = |cell: &Cell| lamps.iter().position(|l| l.triangles.contains(&cell.triangles[0].0));
        let of_lamps: Vec<Option<usize>> = cells.iter().map(lamp_of).collect();
        let of =
            |lamp: Option<usize>| cells.iter().zip(&of_lamps).filter(move |c| *c.1 == lamp).map(|c| *c.0);
        let others: Vec<Cell> = of(None).collect();
        let (tree, order) = LightTree::new(&others);
        self.tree = tree;
        self.cells = in_order(&others, &order);
        let mirrors = image_planes(tracer);
        for (index, lamp) in lamps.iter_mut().enumerate() {
            let start = self.cells.len() as u32;
            let own: Vec<Cell> = of(Some(index)).collect();
            if own.len() > MANY_FACETS && mirrors.iter().any(|plane| lamp.may_be_cut_by(plane)) {
                let (root, order) = self.tree.add(&own, start);
                lamp.root = Some(root);
                self.cells.extend(in_order(&own, &order));
            } else {
                self.cells.extend(own);
            }
            lamp.cells = start..self.cells.len() as u32;
        }
        self.lamps = lamps;
    }

    /// The surfaces, or pieces of them, that are lamps; none where there are so many that each receiver had better ask a tree.
    fn find_lamps(&self, tracer: &Tracer) -> Vec<Lamp> {
        let mut lamps = Vec::new();
        let scene = tracer.scene();
        let mut cell_of: Vec<Option<&Cell>> = vec![None; scene.triangles().len()];
        for cell in &self.cells {
            cell_of[cell.triangles[0].index()] = Some(cell);
        }
        for surface in scene.surfaces() {
            let mut triangles = surface.triangles.clone().map(|t| t as usize);
            if !triangles.clone().all(|t| self.emits[t] && !self.is_broad[t]) {
                continue;
            }
            let Some(cell) = triangles.find_map(|t| cell_of[t]) else { continue };
            lamps.extend(Lamp::all_of(tracer, surface, cell).take(MAX_LAMPS + 1 - lamps.len()));
            if lamps.len() > MAX_LAMPS || lamps.iter().map(Lamp::facet_count).sum::<usize>() > MAX_FACETS {
                return Vec::new();
            }
        }
        if lamps.iter().filter(|lamp| lamp.is_coarse_ball()).count() <= FEW_BALLS {
            lamps.iter_mut().for_each(Lamp::keep_outline);
        }
        lamps
    }

    /// The lamps.
    pub fn lamps(&self) -> &[Lamp] {
        &self.lamps
    }

    /// The tree over the cells that are part of no lamp.
    pub fn tree(&self) -> &LightTree {
        &self.tree
    }

    /// All cells.
    pub fn cells(&self) -> &[Cell] {
        &self.cells
    }

    /// Number of emitting triangles.
    pub fn triangle_count(&self) -> usize {
        self.triangles
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.cells.is_empty()
    }

    /// Whether a triangle may emit.
    #[inline]
    pub fn emits(&self, triangle: TriangleId) -> bool {
        self.emits[triangle.index()]
    }

    /// Total emitted power, per channel.
    pub fn power(&self) -> Rgb {
        let all = self.cells.iter().chain(&self.broad);
        all.map(|c| c.radiance * (std::f64::consts::PI * c.area) as f32).sum()
    }
}

/// The planes of mirrors that have images.
fn image_planes(tracer: &Tracer) -> Vec<Plane> {
    let mut ids: Vec<PlaneId> = (0..tracer.scene().triangles().len() as u32)
        .filter_map(|index| match tracer.reflection(TriangleId(index)) {
            Event::Planar(plane) | Event::Facet(plane) => Some(plane),
            Event::Undeviated | Event::Curved | Event::Enters(_) | Event::Leaves(_) => None,
        })
        .collect();
    ids.sort_unstable();
    ids.dedup();
    ids.into_iter().map(|id| tracer.planes().plane(id)).collect()
}

/// The parallelogram that two triangles of a plane make up, if they do: corner and edges.
fn parallelogram(tracer: &Tracer, first: TriangleId, second: TriangleId) -> Option<(DVec3, [DVec3; 2])> {
    if tracer.planes().of(first) != tracer.planes().of(second) {
        return None;
    }
    let p = tracer.scene().corners(first);
    let q = tracer.scene().corners(second);
    // The corner that is not shared on each side.
    let lone_p = (0..3).find(|&i| !q.contains(&p[i]))?;
    let lone_q = (0..3).find(|&i| !p.contains(&q[i]))?;
    if (0..3).any(|i| i != lone_p && !q.contains(&p[i])) {
        return None;
    }
    let corner = p[lone_p].as_dvec3();
    let (a, b) = (p[(lone_p + 1) % 3].as_dvec3(), p[(lone_p + 2) % 3].as_dvec3());
    let (e, f) = (a - corner, b - corner);
    let opposite = q[lone_q].as_dvec3();
    let error = (corner + e + f - opposite).length();
    (error < 1e-5 * (e.length() + f.length())).then_some((corner, [e, f]))
}
