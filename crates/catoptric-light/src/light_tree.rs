//! A tree over the emitter cells, so that one receiver pays for a bounded number of parts, however many cells there are.
//!
//! Source: Walter et al. 2005 ("Lightcuts"): the tree is cut anew for each receiver, where most light may come from
//! first; Conty Estevez & Kulla 2018: what is left as a group is sampled by walking down, each child in proportion to
//! a bound of what it may send. Keys in docs/references.md: Walter2005, ContyEstevezKulla2018.

use std::collections::BinaryHeap;

use glam::DVec3;

use catoptric_scene::Rgb;
use catoptric_trace::plane::Plane;

use crate::contour::Polygon;
use crate::emitter::Cell;

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
    /// Its sine.
    sin_cone: f64,
    /// Σ radiance × area over channels, at the lobe's peak, for choices.
    power: f64,
    /// Some cell is not diffuse: it is no group that is known well.
    lobed: bool,
    /// Children; none at a leaf, which is one cell.
    children: Option<[u32; 2]>,
    /// First cell.
    first: u32,
}

/// The tree.
#[derive(Clone, Debug, Default)]
pub struct LightTree {
    nodes: Vec<Node>,
}

/// A part of the emitters as one receiver sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Part {
    /// One cell, to be integrated exactly.
    Cell(u32),
    /// A group, small and far: its irradiance is known well.
    Group(u32),
    /// A group beyond the budget, to be sampled by [`LightTree::draw`]; with the bound of what it may send.
    Loose(u32, f64),
}

/// Windows that light must come through, one or the other: the outlines of mirrors as seen from the receiver.
#[derive(Clone, Debug, Default)]
pub struct Windows {
    /// Inward normals of the planes through the receiver and the outlines' edges, window after window.
    normals: Vec<DVec3>,
    /// Where the normals of each window end.
    ends: Vec<usize>,
}

impl Windows {
    /// No windows: light may come from everywhere.
    pub fn clear(&mut self) {
        self.normals.clear();
        self.ends.clear();
    }

    /// Adds the window of `outlines`, all of which must be passed, seen from `eye`.
    pub fn add(&mut self, eye: DVec3, outlines: &[Polygon]) {
        self.normals.extend(outlines.iter().flat_map(|outline| outline.sight_planes(eye)).flatten());
        self.ends.push(self.normals.len());
    }

    /// Whether light may come from everywhere.
    pub fn is_empty(&self) -> bool {
        self.ends.is_empty()
    }

    /// The normals of each window.
    pub fn iter(&self) -> impl Iterator<Item = &[DVec3]> {
        let starts = std::iter::once(0).chain(self.ends.iter().copied());
        starts.zip(&self.ends).map(|(start, &end)| &self.normals[start..end])
    }

    /// Whether any of a ball about the eye + `offset` may be seen through them.
    pub fn may_show(&self, offset: DVec3, radius: f64) -> bool {
        self.is_empty() || self.iter().any(|window| window.iter().all(|n| n.dot(offset) > -radius))
    }
}

/// Where light arrives.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    /// The point.
    pub point: DVec3,
    /// Unit normal of the cosine.
    pub normal: DVec3,
    /// Unit normal of the surface.
    pub geometric: DVec3,
    /// Light must come through one of these, unless there are none.
    pub windows: &'a Windows,
    /// And from where n·x > offset.
    pub beyond: Option<Plane>,
}

impl View<'_> {
    /// Whether any of a ball may be seen through the windows, and lies beyond the plane.
    fn may_show(&self, center: DVec3, radius: f64) -> bool {
        self.beyond.is_none_or(|p| p.normal.dot(center) - p.offset > -radius)
            && self.windows.may_show(center - self.point, radius)
    }

    /// Whether all of a ball lies beyond the plane.
    fn has_beyond(&self, center: DVec3, radius: f64) -> bool {
        self.beyond.is_none_or(|p| p.normal.dot(center) - p.offset > radius)
    }
}

/// The parts that one receiver sees, and the buffer that finds them.
#[derive(Clone, Debug, Default)]
pub struct Cut {
    heap: BinaryHeap<Open>,
    waiting: Vec<u32>,
    found: Vec<(u32, Part)>,
}

impl Cut {
    /// The parts, neighbours beside each other.
    pub fn parts(&self) -> impl Iterator<Item = Part> {
        self.found.iter().map(|f| f.1)
    }
}

/// What a node is to a view.
enum Look {
    /// It sends nothing there.
    Dark,
    /// Exact enough as it is.
    Part(Part),
    /// Too near or too varied: its children are to be looked at.
    Divide([u32; 2]),
}

/// A group that may be divided further, the strongest first.
#[derive(Clone, Copy, Debug)]
struct Open {
    bound: f64,
    node: u32,
}

impl Ord for Open {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.bound.total_cmp(&other.bound).then(other.node.cmp(&self.node))
    }
}

impl PartialOrd for Open {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Open {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Open {}

/// Groups below this ratio of radius to distance count as one: the error of a point source is (r/d)² times a factor
/// below one, here 0.25 %.
const GROUP_RATIO: f64 = 0.05;
/// Normals of a group within 25° of its axis: beyond, shares below the receiver's view would be hidden in the mean.
const GROUP_CONE_COS: f64 = 0.906;
/// Nodes looked at for each part of the budget before the strongest are taken first: a binary tree over n parts has 2n
/// nodes, and as many again lead to what sends nothing.
const VISITS_PER_PART: usize = 4;
/// So few cells are all integrated exactly.
const FEW: usize = 4;

impl LightTree {
    /// The tree over `cells`, and the order of the cells that its leaves count in.
    pub fn new(cells: &[Cell]) -> (Self, Vec<u32>) {
        let mut order: Vec<u32> = (0..cells.len() as u32).collect();
        let mut nodes = Vec::new();
        if !cells.is_empty() {
            build(cells, &mut nodes, &mut order, 0);
        }
        (Self { nodes }, order)
    }

    /// Finds the parts that make up all emitters for a view, not more than `budget` (but always all that are exact
    /// where there are no more cells than that).
    pub fn cut(&self, cells: &[Cell], view: &View, budget: usize, cut: &mut Cut) {
        cut.found.clear();
        if self.nodes.is_empty() || self.cut_whole(cells, view, budget, cut) {
            return;
        }
        cut.heap.clear();
        cut.found.clear();
        self.open(cells, view, 0, cut);
        while cut.found.len() + cut.heap.len() < budget
            && let Some(group) = cut.heap.pop()
        {
            if let Some(children) = self.nodes[group.node as usize].children {
                for child in children {
                    self.open(cells, view, child, cut);
                }
            }
        }
        let left = cut.heap.drain();
        cut.found.extend(left.map(|g| (self.nodes[g.node as usize].first, Part::Loose(g.node, g.bound))));
        cut.found.sort_unstable_by_key(|f| f.0);
    }

    /// Divides all groups in their order, which is far cheaper than the strongest first; `false` where the budget does
    /// not hold them.
    fn cut_whole(&self, cells: &[Cell], view: &View, budget: usize, cut: &mut Cut) -> bool {
        let mut visits = 0;
        cut.waiting.clear();
        cut.waiting.push(0);
        while let Some(index) = cut.waiting.pop() {
            visits += 1;
            if cut.found.len() == budget || visits > VISITS_PER_PART * budget {
                return false;
            }
            match self.look(cells, view, index) {
                Look::Dark => {}
                Look::Part(part) => cut.found.push((self.nodes[index as usize].first, part)),
                Look::Divide([left, right]) => cut.waiting.extend([right, left]),
            }
        }
        true
    }

    /// Adds a node to the cut: as a part if that is exact enough, else as a group to be divided.
    fn open(&self, cells: &[Cell], view: &View, index: u32, cut: &mut Cut) {
        match self.look(cells, view, index) {
            Look::Dark => {}
            Look::Part(part) => cut.found.push((self.nodes[index as usize].first, part)),
            Look::Divide(_) => {
                let bound = self.bound(index, view);
                if bound > 0.0 {
                    cut.heap.push(Open { bound, node: index });
                }
            }
        }
    }

    /// What a node is to a view.
    fn look(&self, cells: &[Cell], view: &View, index: u32) -> Look {
        let node = &self.nodes[index as usize];
        if node.children.is_none() && !cells[node.first as usize].faces(view.point) {
            return Look::Dark;
        }
        let offset = node.center - view.point;
        let height = view.geometric.dot(offset);
        if height + node.radius <= 0.0 || !view.may_show(node.center, node.radius) {
            return Look::Dark;
        }
        let distance = offset.length();
        let towards = -node.axis.dot(offset);
        let few = self.nodes.len() <= 2 * FEW;
        let whole = height > node.radius && view.has_beyond(node.center, node.radius);
        let small = node.radius < GROUP_RATIO * distance && whole && !few && !node.lobed;
        let Some(children) = node.children else {
            return Look::Part(if small { Part::Group(index) } else { Part::Cell(node.first) });
        };
        // Averted by more than size and cone together: half of the groups of a round lamp.
        let averted = node.sin_cone * distance + node.radius;
        if towards < -averted && node.cos_cone > 0.0 {
            return Look::Dark;
        }
        // Turned towards the receiver as a whole: even the most averted normal sees it.
        if small && node.cos_cone > GROUP_CONE_COS && towards > (node.sin_cone + GROUP_RATIO) * distance {
            return Look::Part(Part::Group(index));
        }
        Look::Divide(children)
    }

    /// About the most irradiance (sum of channels) that a node may send: zero only where it can send none.
    fn bound(&self, index: u32, view: &View) -> f64 {
        let node = &self.nodes[index as usize];
        let offset = node.center - view.point;
        if view.geometric.dot(offset) + node.radius <= 0.0 {
            return 0.0;
        }
        if !view.may_show(node.center, node.radius) {
            return 0.0;
        }
        let distance = offset.length();
        let near = (distance - node.radius).max(node.radius);
        let strength = node.power / (near * near);
        if distance <= node.radius {
            return strength;
        }
        let sin = node.radius / distance;
        let size = (sin, (1.0 - sin * sin).max(0.0).sqrt());
        let receives = lessened(view.normal.dot(offset) / distance, size);
        // Beyond 90°, cone and size together may reach past the half-turn: take the cone alone as all directions.
        if node.cos_cone <= 0.0 {
            return strength * receives.max(0.0);
        }
        // Averted by more than size and cone together: most groups of a round lamp, told without a root.
        let cos = -node.axis.dot(offset) / distance;
        if cos < 0.0 && cos * cos > (node.sin_cone + sin) * (node.sin_cone + sin) {
            return 0.0;
        }
        let emits = lessened(lessened(cos, size), (node.sin_cone, node.cos_cone));
        strength * receives.max(0.0) * emits.max(0.0)
    }

    /// Irradiance of a group at a point, unoccluded: Σ L·A·cosθ'·cosθ/r².
    pub fn irradiance(&self, group: u32, point: DVec3, normal: DVec3) -> Rgb {
        let node = &self.nodes[group as usize];
        let offset = node.center - point;
        let r2 = offset.length_squared();
        let towards = offset / r2.sqrt();
        let share = normal.dot(towards).max(0.0) / r2;
        let [r, g, b] = node.vectors.map(|v| ((-v.dot(towards)).max(0.0) * share) as f32);
        Rgb::new(r, g, b)
    }

    /// A cell of a small group, chosen by power with `u` in [0, 1); returns what is left of `u`.
    pub fn choose(&self, group: u32, u: f64) -> (u32, f64) {
        let (cell, _, rest) = self.walk(group, u, |node| self.nodes[node as usize].power);
        (cell, rest)
    }

    /// A cell of a group, chosen by what each may send to a view with `u` in [0, 1): with the probability of the
    /// choice and what is left of `u`. `None` where none may send anything.
    pub fn draw(&self, group: u32, view: &View, u: f64) -> Option<(u32, f64, f64)> {
        let drawn = self.walk(group, u, |node| self.bound(node, view));
        (drawn.1 > 0.0).then_some(drawn)
    }

    fn walk(&self, group: u32, mut u: f64, weight: impl Fn(u32) -> f64) -> (u32, f64, f64) {
        let mut index = group;
        let mut probability = 1.0;
        while let Some([left, right]) = self.nodes[index as usize].children {
            let (a, b) = (weight(left), weight(right));
            if a + b <= 0.0 {
                return (self.nodes[index as usize].first, 0.0, u);
            }
            let p = a / (a + b);
            if u < p {
                u /= p;
                probability *= p;
                index = left;
            } else {
                u = (u - p) / (1.0 - p);
                probability *= 1.0 - p;
                index = right;
            }
            u = u.clamp(0.0, 1.0 - 1e-12);
        }
        (self.nodes[index as usize].first, probability, u)
    }
}

/// Cosine of an angle made smaller by another, given as (sine, cosine); not below zero degrees.
#[inline]
fn lessened(cos: f64, (sin_by, cos_by): (f64, f64)) -> f64 {
    if cos >= cos_by { 1.0 } else { cos * cos_by + (1.0 - cos * cos).max(0.0).sqrt() * sin_by }
}

/// Builds the node over `order` (whose first entry has global position `first`); returns its index.
fn build(cells: &[Cell], nodes: &mut Vec<Node>, order: &mut [u32], first: u32) -> u32 {
    let index = nodes.len() as u32;
    let of = |i: &u32| &cells[*i as usize];
    let mut node = Node {
        center: DVec3::ZERO,
        radius: 0.0,
        vectors: [DVec3::ZERO; 3],
        axis: DVec3::Z,
        cos_cone: 1.0,
        sin_cone: 0.0,
        power: 0.0,
        lobed: false,
        children: None,
        first,
    };
    for cell in order.iter().map(of) {
        let power = cell.strength();
        node.lobed |= !cell.lobe.is_diffuse();
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
    node.sin_cone = (1.0 - node.cos_cone * node.cos_cone).max(0.0).sqrt();
    nodes.push(node);
    if order.len() > 1 {
        // By place or by normal, whichever gives the tighter halves.
        let middle = order.len() / 2;
        let mut best = f64::INFINITY;
        let mut kept = Vec::new();
        for value in [Cell::centroid, |c: &Cell| c.normal] {
            sort_by_extent(cells, order, value);
            let (head, tail) = order.split_at(middle);
            let cost = spread(cells, head) + spread(cells, tail);
            if cost < best || kept.is_empty() {
                best = cost;
                kept.clear();
                kept.extend_from_slice(order);
            }
        }
        order.copy_from_slice(&kept);
        drop(kept);
        let (head, tail) = order.split_at_mut(middle);
        let left = build(cells, nodes, head, first);
        let right = build(cells, nodes, tail, first + middle as u32);
        nodes[index as usize].children = Some([left, right]);
    }
    index
}

/// Sorts along the axis on which a value of the cells extends most.
fn sort_by_extent(cells: &[Cell], order: &mut [u32], value: fn(&Cell) -> DVec3) {
    let mut low = DVec3::INFINITY;
    let mut high = DVec3::NEG_INFINITY;
    for &index in order.iter() {
        let value = value(&cells[index as usize]);
        low = low.min(value);
        high = high.max(value);
    }
    let axis = (high - low).max_position();
    order.sort_by(|&a, &b| {
        let (x, y) = (value(&cells[a as usize])[axis], value(&cells[b as usize])[axis]);
        x.total_cmp(&y).then(a.cmp(&b))
    });
}

/// How badly a group stands for its cells: power × size² × solid angle into which it emits (the surface area orientation
/// heuristic of Conty Estevez & Kulla 2018, with the solid angle of the cone widened by 90°, up to all directions).
fn spread(cells: &[Cell], order: &[u32]) -> f64 {
    let of = |i: &u32| &cells[*i as usize];
    let mut low = DVec3::INFINITY;
    let mut high = DVec3::NEG_INFINITY;
    let mut power = 0.0;
    let mut axis = DVec3::ZERO;
    for cell in order.iter().map(of) {
        let (center, radius) = (cell.centroid(), cell.radius());
        low = low.min(center - radius);
        high = high.max(center + radius);
        power += cell.strength();
        axis += cell.normal * cell.area;
    }
    let axis = axis.normalize_or_zero();
    let cos_cone = order.iter().map(of).map(|c| c.normal.dot(axis)).fold(1.0, f64::min);
    // 1 for a flat group, 2 for one that emits everywhere: cos(θ + 90°) = −sin θ.
    let directions = if cos_cone <= 0.0 { 2.0 } else { 1.0 + (1.0 - cos_cone * cos_cone).max(0.0).sqrt() };
    power * (high - low).length_squared() * directions
}
