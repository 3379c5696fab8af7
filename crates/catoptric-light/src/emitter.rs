//! Area emitters: cells (triangles and parallelograms) in a tree, so that far groups count as one.
//!
//! The tree is a light tree in the sense of Walter et al. 2005 ("Lightcuts"), cut by size alone: a group is taken as
//! one where it is small, far, and turned towards the receiver as a whole.

use glam::DVec3;

use catoptric_scene::{Barycentric, Radiance, Rgb, Side, TriangleId};
use catoptric_trace::{PlaneId, Tracer};

use crate::contour::Polygon;

/// A triangle or parallelogram that emits from one side (two-sided emitters are two cells).
#[derive(Clone, Copy, Debug)]
pub struct Cell {
    /// corner, edge a, edge b.
    corner: DVec3,
    edges: [DVec3; 2],
    /// A parallelogram, else a triangle.
    parallelogram: bool,
    /// Unit normal of the emitting side.
    pub normal: DVec3,
    /// Area, m².
    pub area: f64,
    /// Mean radiance.
    pub radiance: Rgb,
    /// Radiance varies over the cell.
    pub textured: bool,
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
        let [a, b] = self.edges;
        if self.parallelogram {
            Polygon::new(&[self.corner, self.corner + a, self.corner + a + b, self.corner + b])
        } else {
            Polygon::new(&[self.corner, self.corner + a, self.corner + b])
        }
    }

    /// The point of unit-square coordinates (s, t), uniform by area.
    #[inline]
    pub fn point(&self, s: f64, t: f64) -> DVec3 {
        let (u, v) = if self.parallelogram {
            (s, t)
        } else {
            let (u, v) = catoptric_trace::sequence::triangle_point(glam::Vec2::new(s as f32, t as f32));
            (f64::from(u), f64::from(v))
        };
        self.corner + self.edges[0] * u + self.edges[1] * v
    }

    /// Emitted radiance at a point of the cell.
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
            let point = scene.surface_point(id, at);
            point.emission.0 * point.opacity
        })
    }

    /// Whether a straight line meets the emitting side.
    fn meets(&self, origin: DVec3, direction: DVec3) -> bool {
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

    fn centroid(&self) -> DVec3 {
        let [a, b] = self.edges;
        self.corner + if self.parallelogram { (a + b) * 0.5 } else { (a + b) / 3.0 }
    }

    fn radius(&self) -> f64 {
        let center = self.centroid();
        self.polygon().corners().iter().map(|c| (*c - center).length()).fold(0.0, f64::max)
    }
}

/// A group of cells.
#[derive(Clone, Copy, Debug)]
struct Node {
    center: DVec3,
    radius: f64,
    /// Σ radiance × area × normal, per channel.
    vectors: [DVec3; 3],
    /// Axis and cosine of the half-angle of a cone that holds all normals.
    axis: DVec3,
    cos_cone: f64,
    /// Σ luminance-free power, for choices.
    power: f64,
    /// Children, or the range of cells of a leaf.
    children: Option<[u32; 2]>,
    cells: [u32; 2],
}

/// All area emitters of a scene.
#[derive(Clone, Debug, Default)]
pub struct Emitters {
    cells: Vec<Cell>,
    nodes: Vec<Node>,
    /// Emitters so large that hemisphere rays see them well: whole walls. Not in the tree.
    broad: Vec<Cell>,
    /// Per triangle: emits anywhere, either side.
    emits: Vec<bool>,
    is_broad: Vec<bool>,
    triangles: usize,
}

/// A part of the emitters as one receiver sees it.
#[derive(Clone, Copy, Debug)]
pub enum Part {
    /// One cell, to be integrated exactly.
    Cell(u32),
    /// A group, small and far.
    Group(u32),
}

/// Cells above this share of the scene's area are broad. Hemisphere rays find them with little noise, and with the
/// unoccluded irradiance as control variate with none where nothing blocks; shadow rays and images of whole glowing
/// walls would add the noise that a furnace of mirrors and emitters does not have.
const BROAD_SHARE: f64 = 0.04;
/// Each broad cell is asked by every hemisphere ray.
const MAX_BROAD: usize = 16;

/// Groups below this ratio of radius to distance count as one: the error of a point source is (r/d)² times a factor
/// below one, here 0.25 %.
const GROUP_RATIO: f64 = 0.05;
/// Normals of a group within 25° of its axis: beyond, shares below the receiver's view would be hidden in the mean.
const GROUP_CONE_COS: f64 = 0.906;

impl Emitters {
    /// Collects every emitting side.
    pub fn new(tracer: &Tracer) -> Self {
        let scene = tracer.scene();
        let triangles = scene.triangles().len();
        let mut emitters =
            Self { emits: vec![false; triangles], is_broad: vec![false; triangles], ..Self::default() };
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
                    emitters.push(tracer, corner, edges, joined.is_some(), triangles, side);
                }
            }
        }
        emitters.separate_broad(tracer);
        emitters.build();
        emitters
    }

    /// Takes the broad cells out of the list.
    fn separate_broad(&mut self, tracer: &Tracer) {
        let scene = tracer.scene();
        let total: f64 =
            (0..scene.triangles().len()).map(|t| f64::from(scene.area(TriangleId(t as u32)))).sum();
        let is_broad = |c: &Cell| !c.textured && c.area > BROAD_SHARE * total;
        if self.cells.iter().filter(|c| is_broad(c)).count() > MAX_BROAD {
            return;
        }
        let (broad, rest) = self.cells.iter().partition(|c| is_broad(c));
        self.cells = rest;
        self.broad = broad;
        for cell in &self.broad {
            for triangle in cell.triangles {
                self.is_broad[triangle.index()] = true;
            }
        }
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

    /// Radiance of all broad emitters that a straight line meets from the front, blocked or not.
    #[inline]
    pub fn broad_along(&self, origin: DVec3, direction: DVec3) -> Rgb {
        self.broad.iter().filter(|cell| cell.meets(origin, direction)).map(|cell| cell.radiance).sum()
    }

    fn push(
        &mut self,
        tracer: &Tracer,
        corner: DVec3,
        edges: [DVec3; 2],
        parallelogram: bool,
        triangles: [TriangleId; 2],
        side: Side,
    ) {
        let scene = tracer.scene();
        let cross = edges[0].cross(edges[1]);
        let textured = scene.material_of(triangles[0]).emission_texture.is_some()
            || scene.material_of(triangles[0]).base_texture.is_some();
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
            textured,
            plane: tracer.planes().of(triangles[0]),
            side,
            triangles,
        };
        if textured {
            // The mean over a 16 × 16 grid decides shares only; what arrives is sampled.
            let mut sum = Rgb::ZERO;
            for i in 0..256 {
                let point = cell.point((f64::from(i % 16) + 0.5) / 16.0, (f64::from(i / 16) + 0.5) / 16.0);
                sum += cell.radiance_at(tracer, point);
            }
            cell.radiance = sum / 256.0;
        }
        if cell.radiance.max_element() > 0.0 && cell.area > 0.0 {
            self.cells.push(cell);
        }
    }

    fn build(&mut self) {
        if self.cells.is_empty() {
            return;
        }
        let mut order: Vec<u32> = (0..self.cells.len() as u32).collect();
        let mut nodes = Vec::new();
        build_node(&self.cells, &mut nodes, &mut order, 0);
        self.cells = order.iter().map(|&i| self.cells[i as usize]).collect();
        self.nodes = nodes;
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

    /// Calls `visit` for the parts that make up all emitters as seen from `point`, above the plane of `normal`.
    pub fn cut(&self, point: DVec3, normal: DVec3, mut visit: impl FnMut(Part)) {
        if self.nodes.is_empty() {
            return;
        }
        let mut stack = [0_u32; 64];
        let mut length = 1;
        while length > 0 {
            length -= 1;
            let index = stack[length];
            let node = &self.nodes[index as usize];
            let offset = node.center - point;
            if normal.dot(offset) + node.radius <= 0.0 {
                continue;
            }
            let distance = offset.length();
            let small = node.radius < GROUP_RATIO * distance;
            let Some([left, right]) = node.children else {
                let cell = node.cells[0];
                if self.cells[cell as usize].normal.dot(point - self.cells[cell as usize].corner) > 0.0 {
                    let above = normal.dot(offset) > node.radius;
                    visit(if small && above && self.nodes.len() > 8 {
                        Part::Group(index)
                    } else {
                        Part::Cell(cell)
                    });
                }
                continue;
            };
            if small && node.cos_cone > GROUP_CONE_COS && normal.dot(offset) - node.radius > 0.0 {
                // Turned towards the receiver as a whole: even the most averted normal sees it.
                let cos = -node.axis.dot(offset) / distance;
                let sin_cone = (1.0 - node.cos_cone * node.cos_cone).max(0.0).sqrt();
                if cos > sin_cone + GROUP_RATIO {
                    visit(Part::Group(index));
                    continue;
                }
            }
            if length + 2 <= stack.len() {
                stack[length] = right;
                stack[length + 1] = left;
                length += 2;
            } else {
                visit(Part::Group(index));
            }
        }
    }

    /// Irradiance of a group at a point, unoccluded: Σ L·A·cosθ'·cosθ/r².
    pub fn group_irradiance(&self, group: u32, point: DVec3, normal: DVec3) -> Rgb {
        let node = &self.nodes[group as usize];
        let offset = node.center - point;
        let r2 = offset.length_squared();
        let towards = offset / r2.sqrt();
        let share = normal.dot(towards).max(0.0) / r2;
        let [r, g, b] = node.vectors.map(|v| ((-v.dot(towards)).max(0.0) * share) as f32);
        Rgb::new(r, g, b)
    }

    /// A cell of a group, chosen by power with `u` in [0, 1); returns what is left of `u`.
    pub fn choose_cell(&self, group: u32, mut u: f64) -> (u32, f64) {
        let mut index = group;
        while let Some([left, right]) = self.nodes[index as usize].children {
            let (a, b) = (self.nodes[left as usize].power, self.nodes[right as usize].power);
            let p = a / (a + b);
            if u < p {
                u /= p;
                index = left;
            } else {
                u = (u - p) / (1.0 - p);
                index = right;
            }
            u = u.clamp(0.0, 1.0 - 1e-12);
        }
        let [first, end] = self.nodes[index as usize].cells;
        let count = f64::from(end - first);
        let pick = (u * count).floor().min(count - 1.0);
        (first + pick as u32, u * count - pick)
    }
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

/// Builds the node over `order` (whose first entry has global position `first`); returns its index.
fn build_node(cells: &[Cell], nodes: &mut Vec<Node>, order: &mut [u32], first: u32) -> u32 {
    let index = nodes.len() as u32;
    let of = |i: &u32| &cells[*i as usize];
    let mut node = Node {
        center: DVec3::ZERO,
        radius: 0.0,
        vectors: [DVec3::ZERO; 3],
        axis: DVec3::Z,
        cos_cone: 1.0,
        power: 0.0,
        children: None,
        cells: [first, first + order.len() as u32],
    };
    for cell in order.iter().map(of) {
        let power = f64::from(cell.radiance.element_sum()) * cell.area;
        node.power += power;
        node.center += cell.centroid() * power;
        for channel in 0..3 {
            node.vectors[channel] += cell.normal * (f64::from(cell.radiance[channel]) * cell.area);
        }
    }
    node.center /= node.power;
    node.axis = order.iter().map(of).map(|c| c.normal * c.area).sum::<DVec3>().normalize_or_zero();
    for cell in order.iter().map(of) {
        node.radius = node.radius.max((cell.centroid() - node.center).length() + cell.radius());
        node.cos_cone = node.cos_cone.min(cell.normal.dot(node.axis));
    }
    nodes.push(node);
    if order.len() > 1 {
        // Split by normal where normals differ much, else by place: both along the axis of the largest extent.
        let by_normal = node.cos_cone < GROUP_CONE_COS;
        let value = |c: &Cell| if by_normal { c.normal } else { c.centroid() };
        let mut low = DVec3::INFINITY;
        let mut high = DVec3::NEG_INFINITY;
        for cell in order.iter().map(of) {
            low = low.min(value(cell));
            high = high.max(value(cell));
        }
        let extent = high - low;
        let axis = if extent.x >= extent.y && extent.x >= extent.z {
            0
        } else if extent.y >= extent.z {
            1
        } else {
            2
        };
        order.sort_by(|&a, &b| {
            let (x, y) = (value(&cells[a as usize])[axis], value(&cells[b as usize])[axis]);
            x.total_cmp(&y).then(a.cmp(&b))
        });
        let middle = order.len() / 2;
        let (head, tail) = order.split_at_mut(middle);
        let left = build_node(cells, nodes, head, first);
        let right = build_node(cells, nodes, tail, first + middle as u32);
        nodes[index as usize].children = Some([left, right]);
    }
    index
}

/// Radiance that a hit surface emits, as [`catoptric_trace::interaction::Interaction`] reports it, for callers that have
/// a triangle only.
pub fn emitted(tracer: &Tracer, triangle: TriangleId, at: Barycentric, side: Side) -> Radiance {
    if side == Side::Back && !tracer.has_back(triangle) {
        return Radiance::ZERO;
    }
    let point = tracer.scene().surface_point(triangle, at);
    point.emission * point.opacity
}
