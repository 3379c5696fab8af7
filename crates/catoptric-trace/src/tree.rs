//! The bounding volume tree: built by obvhs, collapsed to eight children a node, triangles in packets of four.
//!
//! obvhs's defects designed out (each held by a test in `tracer.rs`):
//! * its Morton codes wrap at the scene's maximum faces, so closed rooms get trees that are 8–18× slower: boxes
//!   are padded before the build, which moves every centroid inside;
//! * its boxes and triangle tests are not watertight: boxes are padded here and the test is Woop, Benthin & Wald's;
//! * its wide tree drops hits nearer than an absolute 1e-4: the traversal here has no near limit of its own.
//!
//! Slabs go by eight (see [`crate::eight`]), triangles by four (see [`crate::packet`]).

use glam::Vec3;
use obvhs::aabb::Aabb;
use obvhs::bvh2::{Bvh2, leaf_collapser, reinsertion::ReinsertionOptimizer};
use obvhs::ploc::{PlocBuilder, PlocSearchDistance, SortPrecision};

use crate::beam::Suspects;
use crate::eight::{Eight, Level, Plain, Row, at_level};
use crate::packet::{CUT_OUT, Facet, Nearest, Occlusion, Packet, Probe, TRANSMITS};
use crate::plane::PlaneId;

/// Children of a node.
const WIDTH: usize = 8;

/// Eight boxes, one per child.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Node {
    /// Least x, y and z, and greatest x, y and z; +∞ and −∞ where there is no child.
    pub(crate) bounds: [Row; 6],
    /// `LEAF | first packet << 4 | packets`, or the index of a node.
    pub(crate) children: [u32; WIDTH],
}

/// Tells a leaf among the children of a node.
pub(crate) const LEAF: u32 = 1 << 31;
/// A leaf names its first packet in 27 bits and its number of packets in 4.
const COUNT_BITS: u32 = 4;

/// The packets of a leaf.
#[inline(always)]
pub(crate) fn leaf(child: u32) -> std::ops::Range<usize> {
    let first = ((child & !LEAF) >> COUNT_BITS) as usize;
    first..first + (child & ((1 << COUNT_BITS) - 1)) as usize
}

/// The tree.
#[derive(Clone, Debug, Default)]
pub(crate) struct Tree {
    pub(crate) nodes: Vec<Node>,
    pub(crate) packets: Vec<Packet>,
    /// Least and greatest id of the triangles below each child of a node.
    pub(crate) spans: Vec<[(u32, u32); WIDTH]>,
    /// What the boxes are larger than their triangles, metres.
    pub(crate) padding: f32,
    pub(crate) level: Level,
}

/// The boxes of triangles, in pairs.
pub(crate) struct Boxes {
    binary: Bvh2,
    padding: f32,
}

/// The box of some points.
fn box_of<'a>(points: impl Iterator<Item = &'a Vec3>) -> Aabb {
    let mut aabb = Aabb::empty();
    for point in points {
        aabb.extend((*point).into());
    }
    aabb
}

impl Boxes {
    /// Around triangles with these corners, of which some, by their index, reach far beyond the others.
    pub(crate) fn around(triangles: &[[Vec3; 3]], is_outlying: impl Fn(usize) -> bool) -> Self {
        let inner = triangles.iter().enumerate().filter(|(index, _)| !is_outlying(*index));
        let inner = box_of(inner.flat_map(|(_, corners)| corners));
        // Half a ten-thousandth of a percent of the scene: above the rounding of slabs and positions (2⁻²³ each).
        let padding_of = |all: &Aabb| {
            let reach = all.min.abs().max(all.max.abs()).max_element().max(all.diagonal().max_element());
            reach * 2e-6 + f32::MIN_POSITIVE
        };
        let padding = padding_of(&inner);
        if triangles.is_empty() {
            return Self { binary: Bvh2::default(), padding };
        }
        let boxes: Vec<Aabb> = triangles
            .iter()
            .enumerate()
            .map(|(index, corners)| {
                let mut aabb = box_of(corners.iter());
                let padding = if is_outlying(index) { padding_of(&aabb).max(padding) } else { padding };
                aabb.min -= padding;
                aabb.max += padding;
                aabb
            })
            .collect();
        let indices = (0..triangles.len() as u32).collect();
        let mut binary = PlocBuilder::with_capacity(triangles.len()).build(
            PlocSearchDistance::Low,
            &boxes,
            indices,
            SortPrecision::U64,
            2,
        );
        ReinsertionOptimizer::default().run(&mut binary, 0.15, None);
        leaf_collapser::collapse(&mut binary, 8, 2.5);
        Self { binary, padding }
    }
}

impl Tree {
    /// The tree over `facets`, whose boxes are those of `boxes`; hits do not depend on their order.
    pub(crate) fn build(boxes: &Boxes, facets: &[Facet]) -> Self {
        let mut tree = Self { padding: boxes.padding, level: Level::detect(), ..Self::default() };
        if !facets.is_empty() {
            tree.collapse(&boxes.binary, facets);
            tree.find_spans();
        }
        tree
    }

    fn find_spans(&mut self) {
        const NOTHING: (u32, u32) = (u32::MAX, 0);
        let join = |a: (u32, u32), b: (u32, u32)| (a.0.min(b.0), a.1.max(b.1));
        self.spans = vec![[NOTHING; WIDTH]; self.nodes.len()];
        // Children come after their parents.
        for index in (0..self.nodes.len()).rev() {
            let node = &self.nodes[index];
            self.spans[index] = std::array::from_fn(|slot| match node.children[slot] {
                _ if node.bounds[0].0[slot] == f32::INFINITY => NOTHING,
                child if child & LEAF != 0 => {
                    let packets = &self.packets[leaf(child)];
                    packets.iter().flat_map(|p| p.ids).map(|id| (id, id)).fold(NOTHING, join)
                }
                child => self.spans[child as usize].into_iter().fold(NOTHING, join),
            });
        }
    }

    /// Adds flags to some triangles.
    pub(crate) fn mark(&mut self, flags: u8, is_marked: impl Fn(u32) -> bool) {
        for packet in &mut self.packets {
            for (lane, &id) in packet.ids.iter().enumerate() {
                packet.flags[lane] |= if is_marked(id) { flags } else { 0 };
            }
        }
    }

    /// Turns the binary tree into one of eight children a node.
    fn collapse(&mut self, binary: &Bvh2, facets: &[Facet]) {
        // Pairs of (binary node, slot to fill): the slot is (node, child) of this tree.
        let mut open: Vec<(usize, usize, usize)> = Vec::new();
        let root = self.push_node(binary, &[0], &mut open, facets);
        debug_assert_eq!(root, 0);
        while let Some((source, node, slot)) = open.pop() {
            let mut group = vec![source];
            // Open the largest inner node until there are eight.
            while group.len() < WIDTH {
                let largest =
                    (0..group.len()).filter(|&i| !binary.nodes[group[i]].is_leaf()).max_by(|&a, &b| {
                        let area = |i: usize| binary.nodes[group[i]].aabb.half_area();
                        area(a).total_cmp(&area(b))
                    });
                let Some(largest) = largest else { break };
                let first = binary.nodes[group[largest]].first_index as usize;
                group[largest] = first;
                group.push(first + 1);
            }
            let child = self.push_node(binary, &group, &mut open, facets);
            self.nodes[node].children[slot] = child as u32;
        }
    }

    /// Appends a node whose children are the binary nodes of `group`; inner children are left open.
    fn push_node(
        &mut self,
        binary: &Bvh2,
        group: &[usize],
        open: &mut Vec<(usize, usize, usize)>,
        facets: &[Facet],
    ) -> usize {
        let index = self.nodes.len();
        let [low, high] = [f32::INFINITY, f32::NEG_INFINITY].map(|b| Row([b; WIDTH]));
        let mut node = Node { bounds: [low, low, low, high, high, high], children: [0; WIDTH] };
        self.nodes.push(node);
        for (slot, &source) in group.iter().enumerate() {
            let child = &binary.nodes[source];
            for axis in 0..3 {
                node.bounds[axis].0[slot] = child.aabb.min[axis];
                node.bounds[axis + 3].0[slot] = child.aabb.max[axis];
            }
            if child.is_leaf() {
                let first = child.first_index as usize;
                let primitives = &binary.primitive_indices[first..first + child.prim_count as usize];
                node.children[slot] = self.push_leaf(primitives, facets);
            } else {
                open.push((source, index, slot));
            }
        }
        self.nodes[index] = node;
        index
    }

    fn push_leaf(&mut self, primitives: &[u32], facets: &[Facet]) -> u32 {
        let first = self.packets.len() as u32;
        for chunk in primitives.chunks(4) {
            // Lanes that are left repeat the first: without area they would ask for the exact edges every time.
            let of_lane = |lane: usize| &facets[*chunk.get(lane).unwrap_or(&chunk[0]) as usize];
            self.packets.push(Packet::of(std::array::from_fn(of_lane)));
        }
        let count = self.packets.len() as u32 - first;
        LEAF | first << COUNT_BITS | count
    }

    /// Calls `visit` for every packet whose box is nearer than the limit it returns, nearest boxes first, until
    /// `visit` returns `None`.
    #[inline(always)]
    fn traverse<E: Eight>(
        &self,
        eight: E,
        probe: &Probe,
        mut limit: f32,
        mut visit: impl FnMut(&Packet, f32) -> Option<f32>,
    ) {
        if self.nodes.is_empty() {
            return;
        }
        let slabs = Slabs::new(eight, probe);
        // (child, entry distance). Depth × 7 entries at most; deeper trees spill to the heap.
        let mut stack = Stack::<(u32, f32), 24>::new();
        let mut current = 0_u32;
        'descend: loop {
            if current & LEAF == 0 {
                let node = &self.nodes[current as usize];
                let (entries, mask) = slabs.enter(node, limit);
                if mask != 0 {
                    if mask & (mask - 1) == 0 {
                        current = node.children[mask.trailing_zeros() as usize];
                        continue 'descend;
                    }
                    // The nearest child goes on, the others wait in order of distance.
                    let entries = eight.store(entries);
                    let mut order = [(0_u32, 0.0_f32); WIDTH];
                    let mut count = 0;
                    let mut bits = mask;
                    while bits != 0 {
                        let slot = bits.trailing_zeros() as usize;
                        bits &= bits - 1;
                        let entry = (node.children[slot], entries[slot]);
                        let mut at = count;
                        while at > 0 && order[at - 1].1 < entry.1 {
                            order[at] = order[at - 1];
                            at -= 1;
                        }
                        order[at] = entry;
                        count += 1;
                    }
                    for &entry in &order[..count - 1] {
                        stack.push(entry);
                    }
                    current = order[count - 1].0;
                    continue 'descend;
                }
            } else {
                for packet in &self.packets[leaf(current)] {
                    match visit(packet, limit) {
                        Some(nearer) => limit = nearer,
                        None => return,
                    }
                }
            }
            loop {
                match stack.pop() {
                    None => return,
                    Some((child, entry)) if entry <= limit => {
                        current = child;
                        continue 'descend;
                    }
                    Some(_) => {}
                }
            }
        }
    }

    /// The nearest hit with t ≤ `limit`; at equal t the lowest id wins. `accept` may refuse a candidate (cut-outs).
    #[inline]
    pub(crate) fn nearest(
        &self,
        probe: &Probe,
        limit: f32,
        accept: impl Fn(&Nearest) -> bool,
    ) -> Option<Nearest> {
        at_level!(self.level, eight => self.nearest_by(eight, probe, limit, accept))
    }

    #[inline(always)]
    fn nearest_by<E: Eight>(
        &self,
        eight: E,
        probe: &Probe,
        limit: f32,
        accept: impl Fn(&Nearest) -> bool,
    ) -> Option<Nearest> {
        let mut best: Option<Nearest> = None;
        self.traverse(
            eight,
            probe,
            limit,
            #[inline(always)]
            |packet, limit| {
                let Some(candidates) = packet.intersect(probe, limit) else { return Some(limit) };
                let mut limit = limit;
                let mut bits = candidates.mask;
                while bits != 0 {
                    let lane = bits.trailing_zeros() as usize;
                    bits &= bits - 1;
                    let id = packet.ids[lane];
                    let t = candidates.t[lane];
                    let nearer = match &best {
                        None => t <= limit,
                        Some(best) => t < best.t || (t == best.t && id < best.id),
                    };
                    if !nearer || probe.ignore.contains(&packet.planes[lane]) {
                        continue;
                    }
                    let candidate = candidates.hit(lane, packet);
                    if packet.flags[lane] & CUT_OUT == 0 || accept(&candidate) {
                        limit = t;
                        best = Some(candidate);
                    }
                }
                Some(limit)
            },
        );
        best
    }

    /// The triangle of the lowest rank among those in `plane` that let nothing pass, with t ≤ `limit`.
    pub(crate) fn opaque_in_plane<R: Ord>(
        &self,
        probe: &Probe,
        limit: f32,
        plane: PlaneId,
        rank: impl Fn(&Nearest) -> R,
        accept: impl Fn(&Nearest) -> bool,
    ) -> Option<Nearest> {
        let mut best: Option<(R, Nearest)> = None;
        self.traverse(Plain, probe, limit, |packet, limit| {
            let Some(candidates) = packet.intersect(probe, limit) else { return Some(limit) };
            for lane in (0..4).filter(|lane| candidates.mask >> lane & 1 == 1) {
                let candidate = candidates.hit(lane, packet);
                if candidate.plane != plane || candidate.flags & TRANSMITS != 0 {
                    continue;
                }
                let rank = rank(&candidate);
                if best.as_ref().is_some_and(|(least, _)| *least <= rank) {
                    continue;
                }
                if candidate.flags & CUT_OUT == 0 || accept(&candidate) {
                    best = Some((rank, candidate));
                }
            }
            Some(limit)
        });
        best.map(|(_, nearest)| nearest)
    }

    /// Whether anything lies at t < `limit`: `Blocked` by a triangle that lets nothing pass, `Passing` if only
    /// triangles that let light pass undeviated are in the way. Of these `passed` is told, in no order, and maybe more than once.
    #[inline]
    pub(crate) fn occlusion(
        &self,
        probe: &Probe,
        limit: f32,
        accept: impl Fn(&Nearest) -> bool,
        passed: impl FnMut(Nearest),
    ) -> Occlusion {
        at_level!(self.level, eight => self.occlusion_by(eight, probe, limit, accept, passed))
    }

    #[inline(always)]
    fn occlusion_by<E: Eight>(
        &self,
        eight: E,
        probe: &Probe,
        limit: f32,
        accept: impl Fn(&Nearest) -> bool,
        mut passed: impl FnMut(Nearest),
    ) -> Occlusion {
        let mut occlusion = Occlusion::Free;
        self.traverse(
            eight,
            probe,
            limit,
            #[inline(always)]
            |packet, limit| {
                occlusion = occlusion.max(packet.occlusion(probe, limit, &accept, &mut passed));
                (occlusion < Occlusion::Blocked).then_some(limit)
            },
        );
        occlusion
    }

    /// The same where nothing but what is suspected can be in the way.
    #[inline]
    pub(crate) fn occlusion_among(
        &self,
        suspects: &Suspects,
        probe: &Probe,
        limit: f32,
        accept: impl Fn(&Nearest) -> bool,
    ) -> Occlusion {
        let mut occlusion = Occlusion::Free;
        for packet in suspects.packets(self) {
            occlusion = occlusion.max(packet.occlusion(probe, limit, &accept, |_| {}));
            if occlusion == Occlusion::Blocked {
                break;
            }
        }
        occlusion
    }
}

/// A ray among boxes, in registers.
struct Slabs<'a, E: Eight> {
    eight: E,
    probe: &'a Probe,
    origin: [E::Numbers; 3],
    inverse: [E::Numbers; 3],
}

impl<'a, E: Eight> Slabs<'a, E> {
    #[inline(always)]
    fn new(eight: E, probe: &'a Probe) -> Self {
        let (o, d) = (probe.origin, probe.inverse);
        Self {
            eight,
            probe,
            origin: [eight.splat(o.x), eight.splat(o.y), eight.splat(o.z)],
            inverse: [eight.splat(d.x), eight.splat(d.y), eight.splat(d.z)],
        }
    }

    /// Distances of eight planes across an axis. A scaled origin would lose bits: this subtracts first.
    #[inline(always)]
    fn distances(&self, node: &Node, axis: usize, row: usize) -> E::Numbers {
        let e = self.eight;
        e.multiply(e.subtract(e.load(&node.bounds[row]), self.origin[axis]), self.inverse[axis])
    }

    /// Entry distances and a mask of the children whose boxes the ray meets before `limit`.
    #[inline(always)]
    fn enter(&self, node: &Node, limit: f32) -> (E::Numbers, u32) {
        let (e, Probe { near, far, .. }) = (self.eight, self.probe);
        // Spelled out: closures that array functions call would not be compiled for the instruction set.
        let x = (self.distances(node, 0, near[0]), self.distances(node, 0, far[0]));
        let y = (self.distances(node, 1, near[1]), self.distances(node, 1, far[1]));
        let z = (self.distances(node, 2, near[2]), self.distances(node, 2, far[2]));
        let entry = e.max(e.max(x.0, y.0), e.max(z.0, e.splat(0.0)));
        // Ize 2013: 1 + 2γ₃ makes the exit conservative for any distance.
        let exit = e.multiply(e.min(e.min(x.1, y.1), z.1), e.splat(1.000_000_5));
        let exit = e.min(exit, e.splat(limit));
        (entry, e.at_most(entry, exit))
    }
}

/// A small stack that spills to the heap, so that no depth loses a hit.
pub(crate) struct Stack<T, const NEAR: usize> {
    near: [T; NEAR],
    length: usize,
    spill: Vec<T>,
}

impl<T: Copy + Default, const NEAR: usize> Stack<T, NEAR> {
    #[inline(always)]
    pub(crate) fn new() -> Self {
        Self { near: [T::default(); NEAR], length: 0, spill: Vec::new() }
    }

    #[inline(always)]
    pub(crate) fn push(&mut self, entry: T) {
        if self.length < self.near.len() {
            self.near[self.length] = entry;
            self.length += 1;
        } else {
            self.spill.push(entry);
        }
    }

    #[inline(always)]
    pub(crate) fn pop(&mut self) -> Option<T> {
        if let Some(entry) = self.spill.pop() {
            return Some(entry);
        }
        if self.length == 0 {
            return None;
        }
        self.length -= 1;
        Some(self.near[self.length])
    }
}
