//! The tree is built from the whole down: halves by place or by normal.

use glam::DVec3;

use catoptric_scene::Rgb;

use crate::emitter::Cell;

use super::bundle::{BUNDLE, Bundle};
use super::{COUNTS, GROUP_CONE_COS, LOBED, LightTree, Main, Node, SLACK};

/// What the tree has to know of a cell.
#[derive(Clone, Copy, Debug)]
pub(super) struct Source {
    pub centroid: DVec3,
    pub radius: f64,
    pub normal: DVec3,
    area: f64,
    pub radiance: Rgb,
    pub strength: f64,
    pub lobed: bool,
}

impl Source {
    fn new(cell: &Cell) -> Self {
        Self {
            centroid: cell.centroid(),
            radius: cell.radius(),
            normal: cell.normal,
            area: cell.area,
            radiance: cell.radiance,
            strength: cell.strength(),
            lobed: !cell.lobe.is_diffuse(),
        }
    }
}

impl LightTree {
    /// The tree over `cells`, and the order of the cells that its leaves count in.
    pub fn new(cells: &[Cell]) -> (Self, Vec<u32>) {
        let mut order: Vec<u32> = (0..cells.len() as u32).collect();
        let mut tree = Self { power: cells.iter().map(Cell::strength).sum(), ..Self::default() };
        if !cells.is_empty() {
            let sources: Vec<Source> = cells.iter().map(Source::new).collect();
            tree.add_nodes(1);
            tree.far_groups = tree.build(&sources, 0, &mut order, 0, None);
        }
        tree.main = Main { nodes: tree.nodes.len(), bundles: tree.bundles.len() };
        (tree, order)
    }

    /// Adds a tree of its own over `cells`, which begin at `first`, beside that over all: returns its root, and the order of these cells that
    /// its leaves count in.
    pub fn add(&mut self, cells: &[Cell], first: u32) -> (u32, Vec<u32>) {
        let mut order: Vec<u32> = (0..cells.len() as u32).collect();
        let sources: Vec<Source> = cells.iter().map(Source::new).collect();
        if self.power <= 0.0 {
            self.power = cells.iter().map(Cell::strength).sum();
        }
        let root = self.add_nodes(1);
        self.build(&sources, root, &mut order, first, None);
        (root, order)
    }

    /// Adds empty nodes; returns the index of the first.
    fn add_nodes(&mut self, count: usize) -> u32 {
        let first = self.nodes.len();
        self.nodes.resize(first + count, Node::default());
        self.vectors.resize(first + count, [DVec3::ZERO; 3]);
        first as u32
    }

    /// Makes node `index` that over `order`, whose first entry has the global position `first`; returns how many groups
    /// it has at the least.
    fn build(
        &mut self,
        sources: &[Source],
        index: u32,
        order: &mut [u32],
        first: u32,
        bundle: Option<u32>,
    ) -> usize {
        let of = |i: &u32| &sources[*i as usize];
        let (mut center, mut power, mut axis) = (DVec3::ZERO, 0.0, DVec3::ZERO);
        let mut vectors = [DVec3::ZERO; 3];
        let mut lobed = false;
        for source in order.iter().map(of) {
            lobed |= source.lobed;
            power += source.strength;
            center += source.centroid * source.strength;
            axis += source.normal * source.area;
            for channel in 0..3 {
                vectors[channel] += source.normal * (f64::from(source.radiance[channel]) * source.area);
            }
        }
        center /= power;
        let axis = axis.normalize_or_zero().as_vec3();
        let (mut radius, mut cos_cone) = (0.0_f64, 1.0_f64);
        for source in order.iter().map(of) {
            radius = radius.max((source.centroid - center).length() + source.radius);
            cos_cone = cos_cone.min(source.normal.dot(axis.as_dvec3()));
        }
        self.vectors[index as usize] = vectors;
        self.nodes[index as usize] = Node {
            center,
            radius: (radius as f32).next_up(),
            axis,
            cos_cone: cos_cone as f32,
            sin_cone: (1.0 - cos_cone * cos_cone).max(0.0).sqrt() as f32 + SLACK,
            power: (power / self.power) as f32,
            children: 0,
            first_lobed: first | if lobed { LOBED } else { 0 },
            bundle: 0,
        };
        if order.len() == 1 {
            return 1;
        }
        // The largest groups that fit are bundles, those within them parts of these.
        let is_bundle = bundle.is_none() && order.len() <= BUNDLE;
        let bundle = if is_bundle { Some(self.bundles.len() as u32) } else { bundle };
        self.nodes[index as usize].bundle = bundle.map_or(0, |b| b * COUNTS + order.len() as u32);
        // By place or by normal, whichever gives the tighter halves. Halves, though bundles are not full then: light-side rays are spread
        // over the cells in this order, and dyadic shares of it must be near to each other. With full bundles caustics and what a lamp's
        // shade lets out have 1.05 to 1.1 times the error.
        let middle = order.len() / 2;
        let mut best = f64::INFINITY;
        let mut kept = Vec::new();
        for value in [|s: &Source| s.centroid, |s: &Source| s.normal] {
            sort_by_extent(sources, order, value);
            let (head, tail) = order.split_at(middle);
            let cost = spread(sources, head) + spread(sources, tail);
            if cost < best || kept.is_empty() {
                best = cost;
                kept.clear();
                kept.extend_from_slice(order);
            }
        }
        order.copy_from_slice(&kept);
        drop(kept);
        let (head, tail) = order.split_at_mut(middle);
        let children = self.add_nodes(2);
        self.nodes[index as usize].children = children;
        let groups = self.build(sources, children, head, first, bundle)
            + self.build(sources, children + 1, tail, first + middle as u32, bundle);
        let mut is_known = cos_cone > GROUP_CONE_COS && !lobed;
        if is_bundle {
            let bundle = Bundle::new(sources, order, first, center, radius);
            is_known |= bundle.is_known();
            self.bundles.push(bundle);
        }
        if is_known { 1 } else { groups }
    }
}

/// Sorts along the axis on which a value of the cells extends most.
fn sort_by_extent(sources: &[Source], order: &mut [u32], value: fn(&Source) -> DVec3) {
    let mut low = DVec3::INFINITY;
    let mut high = DVec3::NEG_INFINITY;
    for &index in order.iter() {
        let value = value(&sources[index as usize]);
        low = low.min(value);
        high = high.max(value);
    }
    let axis = (high - low).max_position();
    order.sort_by(|&a, &b| {
        let (x, y) = (value(&sources[a as usize])[axis], value(&sources[b as usize])[axis]);
        x.total_cmp(&y).then(a.cmp(&b))
    });
}

/// How badly a group stands for its cells: power × size² × solid angle into which it emits (the surface area orientation
/// heuristic of Conty Estevez & Kulla 2018, with the solid angle of the cone widened by 90°, up to all directions).
fn spread(sources: &[Source], order: &[u32]) -> f64 {
    let of = |i: &u32| &sources[*i as usize];
    let mut low = DVec3::INFINITY;
    let mut high = DVec3::NEG_INFINITY;
    let mut power = 0.0;
    let mut axis = DVec3::ZERO;
    for source in order.iter().map(of) {
        let (center, radius) = (source.centroid, source.radius);
        low = low.min(center - radius);
        high = high.max(center + radius);
        power += source.strength;
        axis += source.normal * source.area;
    }
    let axis = axis.normalize_or_zero();
    let cos_cone = order.iter().map(of).map(|c| c.normal.dot(axis)).fold(1.0, f64::min);
    // 1 for a flat group, 2 for one that emits everywhere: cos(θ + 90°) = −sin θ.
    let directions = if cos_cone <= 0.0 { 2.0 } else { 1.0 + (1.0 - cos_cone * cos_cone).max(0.0).sqrt() };
    power * (high - low).length_squared() * directions
}
