//! A tree over the emitter cells, so that one receiver pays for a bounded number of parts, however many cells there are.
//!
//! Source: Walter et al. 2005 ("Lightcuts"): the tree is cut anew for each receiver, where most light may come from
//! first; Conty Estevez & Kulla 2018: what is left as a group is sampled by walking down, each child in proportion to
//! a bound of what it may send, and at the end one of a bundle of cells in proportion to about what each sends, which
//! bounds do not tell of so few. Keys in docs/references.md: Walter2005, ContyEstevezKulla2018.

mod build;
mod bundle;
mod view;

use std::collections::BinaryHeap;
use std::ops::Range;

use glam::{DVec3, Vec3};

use catoptric_scene::Rgb;

use crate::emitter::Cell;

use bundle::{BUNDLE, Bundle};
pub use view::{View, Windows};

/// A group of cells, in one line of the cache.
#[derive(Clone, Copy, Debug, Default)]
#[repr(align(64))]
struct Node {
    center: DVec3,
    /// Of a ball that holds the cells, rounded up.
    radius: f32,
    /// Axis and cosine of the half-angle of a cone that holds all normals.
    axis: Vec3,
    cos_cone: f32,
    /// Its sine, with [`SLACK`].
    sin_cone: f32,
    /// Share of [`LightTree::power`].
    power: f32,
    /// The first of the two children, which lie side by side; 0 at a leaf, which is one cell.
    children: u32,
    /// First cell; the highest bit is set where some cell is not diffuse, so that the group is none that is known well.
    first_lobed: u32,
    /// Its cells' bundle in [`LightTree::bundles`] times [`COUNTS`], plus their count; 0 where there are too many.
    bundle: u32,
}

impl Node {
    /// The first cell.
    fn first(&self) -> u32 {
        self.first_lobed & !LOBED
    }

    /// Some cell is not diffuse: it is no group that is known well.
    fn is_lobed(&self) -> bool {
        self.first_lobed & LOBED != 0
    }

    fn children(&self) -> Option<[u32; 2]> {
        (self.children > 0).then_some([self.children, self.children + 1])
    }

    /// Index of the bundle that holds its cells, and their count.
    fn bundle(&self) -> Option<(u32, u32)> {
        (self.bundle > 0).then_some((self.bundle / COUNTS, self.bundle % COUNTS))
    }
}

/// One more than a bundle's cells.
const COUNTS: u32 = BUNDLE as u32 + 1;
/// Mark in [`Node::first_lobed`].
const LOBED: u32 = 1 << 31;
/// Added to the sines of half-angles, so that what rounding of f32 turns away is kept.
const SLACK: f32 = 1e-6;

/// Numbers of nodes and bundles.
#[derive(Clone, Copy, Debug, Default)]
struct Main {
    nodes: usize,
    bundles: usize,
}

/// The tree over all cells but those of lamps, and beside it some of one lamp each.
#[derive(Clone, Debug, Default)]
pub struct LightTree {
    nodes: Vec<Node>,
    /// Σ radiance × area × normal of each node, per channel.
    vectors: Vec<[DVec3; 3]>,
    bundles: Vec<Bundle>,
    /// What of these is part of the tree over all.
    main: Main,
    /// Groups that are exact enough from far away, at the least.
    far_groups: usize,
    /// Σ radiance × area over channels, at the lobe's peak, of all cells but those of lamps; of the first such lamp's where there are no others.
    power: f64,
}

/// A part of the emitters as one receiver sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Part {
    /// One cell, to be integrated exactly.
    Cell(u32),
    /// A group, small and far: its irradiance is known well.
    Group(u32),
    /// Neighbours that are small and far one by one: their irradiance is known as well.
    Bundle(u32),
    /// A group beyond the budget, to be sampled by [`LightTree::draw`]; with a bound or an estimate of what it may send.
    Loose(u32, f64),
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

/// Where the search for what is exact ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Leaves {
    Cells,
    /// Those that are no parts are sampled by what their cells send as points: of weights so close, samples have little noise.
    Bundles,
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
/// Bundles at most that are weighed for one receiver: together they cost what some twenty shadow rays cost.
const BUNDLES: usize = 256;
/// So few cells are all integrated exactly.
const FEW: usize = 4;

impl LightTree {
    /// Finds the parts that make up all emitters for a view: all that are exact where `whole` of them hold them, else about
    /// `budget`, the strongest first. (Between the two, parts that are exact would share samples with groups that are
    /// only bounded, which get more of them than they send.)
    pub fn cut(&self, cells: &[Cell], view: &View, whole: usize, budget: usize, cut: &mut Cut) {
        cut.found.clear();
        // Half of the groups are averted, more or less.
        let may_be_whole = self.far_groups <= 4 * whole;
        // Half of those of a closed body are averted.
        let may_be_bundles = self.main.bundles <= 2 * BUNDLES;
        if self.main.nodes == 0
            || may_be_whole && self.cut_whole(cells, view, 0, Leaves::Cells, whole, cut)
            || may_be_bundles && self.cut_whole(cells, view, 0, Leaves::Bundles, BUNDLES, cut)
        {
            return;
        }
        self.cut_strongest(cells, view, 0, budget, cut);
    }

    /// The same of a tree that was added, by its root.
    pub fn cut_added(&self, cells: &[Cell], view: &View, root: u32, budget: usize, cut: &mut Cut) {
        if !self.cut_whole(cells, view, root, Leaves::Bundles, BUNDLES, cut) {
            self.cut_strongest(cells, view, root, budget, cut);
        }
    }

    /// Divides the strongest groups first.
    fn cut_strongest(&self, cells: &[Cell], view: &View, root: u32, budget: usize, cut: &mut Cut) {
        cut.heap.clear();
        cut.found.clear();
        self.open(cells, view, root, cut);
        while cut.found.len() + cut.heap.len() < budget
            && let Some(group) = cut.heap.pop()
        {
            if let Some(children) = self.nodes[group.node as usize].children() {
                for child in children {
                    self.open(cells, view, child, cut);
                }
            }
        }
        let left = cut.heap.drain();
        cut.found.extend(left.map(|g| (self.nodes[g.node as usize].first(), Part::Loose(g.node, g.bound))));
        cut.found.sort_unstable_by_key(|f| f.0);
    }

    /// Divides all groups in their order, which is far cheaper than the strongest first; `false` where the budget does
    /// not hold them.
    fn cut_whole(
        &self,
        cells: &[Cell],
        view: &View,
        root: u32,
        leaves: Leaves,
        budget: usize,
        cut: &mut Cut,
    ) -> bool {
        let mut visits = 0;
        cut.found.clear();
        cut.waiting.clear();
        cut.waiting.push(root);
        while let Some(index) = cut.waiting.pop() {
            visits += 1;
            if cut.found.len() == budget || visits > VISITS_PER_PART * budget {
                return false;
            }
            match self.look(cells, view, index) {
                Look::Dark => {}
                Look::Part(part) => cut.found.push((self.nodes[index as usize].first(), part)),
                Look::Divide([left, right]) => match self.bundle_of(index) {
                    Some((bundle, cells)) if leaves == Leaves::Bundles => {
                        let estimate = bundle.estimate(cells, view);
                        if estimate > 0.0 {
                            cut.found
                                .push((self.nodes[index as usize].first(), Part::Loose(index, estimate)));
                        }
                    }
                    _ => cut.waiting.extend([right, left]),
                },
            }
        }
        true
    }

    /// Adds a node to the cut: as a part if that is exact enough, else as a group to be divided.
    fn open(&self, cells: &[Cell], view: &View, index: u32, cut: &mut Cut) {
        match self.look(cells, view, index) {
            Look::Dark => {}
            Look::Part(part) => cut.found.push((self.nodes[index as usize].first(), part)),
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
        let radius = f64::from(node.radius);
        let children = node.children();
        if children.is_none() && !cells[node.first() as usize].faces(view.point) {
            return Look::Dark;
        }
        let offset = node.center - view.point;
        let height = view.geometric.dot(offset);
        if height + radius <= 0.0 || !view.may_show(node.center, radius) {
            return Look::Dark;
        }
        let distance = offset.length();
        let few = self.main.nodes <= 2 * FEW && (index as usize) < self.main.nodes;
        let whole = height > radius && view.shows_beyond(node.center, radius);
        let small = radius < GROUP_RATIO * distance && whole && !few && !node.is_lobed();
        let Some(children) = children else {
            return Look::Part(if small { Part::Group(index) } else { Part::Cell(node.first()) });
        };
        let towards = -node.axis.as_dvec3().dot(offset);
        let (sin_cone, cos_cone) = (f64::from(node.sin_cone), f64::from(node.cos_cone));
        // Averted by more than size and cone together: half of the groups of a round lamp.
        if towards < -(sin_cone * distance + radius) && cos_cone > 0.0 {
            return Look::Dark;
        }
        // Turned towards the receiver as a whole: even the most averted normal sees it.
        if small && cos_cone > GROUP_CONE_COS && towards > (sin_cone + GROUP_RATIO) * distance {
            return Look::Part(Part::Group(index));
        }
        if let Some((bundle, _)) = node.bundle()
            && whole
            && !few
            && self.bundles[bundle as usize].is_far(distance)
        {
            return Look::Part(Part::Bundle(index));
        }
        Look::Divide(children)
    }

    /// About the most irradiance (sum of channels) that a node may send: zero only where it can send none.
    #[inline]
    fn bound(&self, index: u32, view: &View) -> f64 {
        let node = &self.nodes[index as usize];
        let radius = f64::from(node.radius);
        let offset = node.center - view.point;
        if view.geometric.dot(offset) + radius <= 0.0 || !view.may_show(node.center, radius) {
            return 0.0;
        }
        let distance = offset.length();
        let near = (distance - radius).max(radius);
        let strength = self.power * f64::from(node.power) / (near * near);
        if distance <= radius {
            return strength;
        }
        let towards = offset / distance;
        let size = Angle::of_sine((radius / distance) as f32 + SLACK);
        let receives = Angle::of_cosine(view.normal.dot(towards) as f32).less(size);
        // Beyond 90°, cone and size together may reach past the half-turn: take the cone alone as all directions.
        let emits = if node.cos_cone <= 0.0 {
            1.0
        } else {
            let cone = Angle { cos: node.cos_cone, sin: node.sin_cone };
            Angle::of_cosine(-node.axis.dot(towards.as_vec3())).less(size).less(cone).cos
        };
        strength * f64::from(receives.cos.max(0.0) * emits.max(0.0))
    }

    /// Irradiance of a group at a point, unoccluded: Σ L·A·cosθ'·cosθ/r².
    pub fn irradiance(&self, group: u32, point: DVec3, normal: DVec3) -> Rgb {
        let offset = self.nodes[group as usize].center - point;
        let r2 = offset.length_squared();
        let towards = offset / r2.sqrt();
        let share = normal.dot(towards).max(0.0) / r2;
        let [r, g, b] = self.vectors[group as usize].map(|v| ((-v.dot(towards)).max(0.0) * share) as f32);
        Rgb::new(r, g, b)
    }

    /// A cell of a small group, chosen by power with `u` in [0, 1); returns what is left of `u`.
    pub fn choose(&self, group: u32, u: f64) -> (u32, f64) {
        let mut walk = Walk { node: group, probability: 1.0, u };
        while let Some(children) = self.nodes[walk.node as usize].children() {
            let [left, right] = children;
            let power = |child: u32| f64::from(self.nodes[child as usize].power);
            walk.descend(children, [power(left), power(right)]);
        }
        (self.nodes[walk.node as usize].first(), walk.u)
    }

    /// A node's bundle and the cells of it that are the node's.
    fn bundle_of(&self, group: u32) -> Option<(&Bundle, Range<u32>)> {
        let node = &self.nodes[group as usize];
        let (bundle, count) = node.bundle()?;
        Some((&self.bundles[bundle as usize], node.first()..node.first() + count))
    }

    /// Irradiance of a bundle, unoccluded: Σ L·A·cosθ'·cosθ/r² over its cells.
    pub fn irradiance_of_bundle(&self, group: u32, view: &View) -> Rgb {
        self.bundle_of(group).map_or(Rgb::ZERO, |(bundle, cells)| bundle.irradiance(cells, view))
    }

    /// A cell of a bundle, chosen by what each sends with `u` in [0, 1); returns what is left of `u`.
    pub fn choose_of_bundle(&self, group: u32, view: &View, u: f64) -> Option<(u32, f64)> {
        let (bundle, cells) = self.bundle_of(group)?;
        let (cell, _, rest) = bundle.draw::<false>(cells, view, u)?;
        Some((cell, rest))
    }

    /// A cell of a group, chosen by what each may send to a view with `u` in [0, 1): with the probability of the
    /// choice and what is left of `u`. `None` where none may send anything.
    pub fn draw(&self, group: u32, view: &View, u: f64) -> Option<(u32, f64, f64)> {
        let mut walk = Walk { node: group, probability: 1.0, u };
        loop {
            let node = &self.nodes[walk.node as usize];
            let Some([left, right]) = node.children() else { break };
            if let Some((bundle, cells)) = self.bundle_of(walk.node) {
                let (cell, share, rest) = bundle.draw::<true>(cells, view, walk.u)?;
                return Some((cell, walk.probability * share, rest));
            }
            if !walk.descend([left, right], [self.bound(left, view), self.bound(right, view)]) {
                return None;
            }
        }
        Some((self.nodes[walk.node as usize].first(), walk.probability, walk.u))
    }
}

/// A way down the tree.
#[derive(Clone, Copy, Debug)]
struct Walk {
    node: u32,
    probability: f64,
    /// What is left of the random number.
    u: f64,
}

impl Walk {
    /// Takes one of two children in proportion to their weights; `false` where there are none.
    #[inline]
    fn descend(&mut self, [left, right]: [u32; 2], [a, b]: [f64; 2]) -> bool {
        if a + b <= 0.0 {
            return false;
        }
        let p = a / (a + b);
        let (start, share, child) = if self.u < p { (0.0, p, left) } else { (p, 1.0 - p, right) };
        self.u = ((self.u - start) / share).clamp(0.0, 1.0 - 1e-12);
        self.probability *= share;
        self.node = child;
        true
    }
}

/// An angle up to the half-turn.
#[derive(Clone, Copy, Debug)]
struct Angle {
    cos: f32,
    sin: f32,
}

impl Angle {
    #[inline]
    fn of_cosine(cos: f32) -> Self {
        Self { cos, sin: (1.0 - cos * cos).max(0.0).sqrt() }
    }

    /// Up to 90°.
    #[inline]
    fn of_sine(sin: f32) -> Self {
        Self { cos: (1.0 - sin * sin).max(0.0).sqrt(), sin }
    }

    /// What is left without another angle, not below zero.
    #[inline]
    fn less(self, other: Self) -> Self {
        // Without branches, which could not be foretold.
        let left = if self.cos >= other.cos { 0.0 } else { 1.0 };
        Self {
            cos: left * (self.cos * other.cos + self.sin * other.sin) + (1.0 - left),
            sin: left * (self.sin * other.cos - self.cos * other.sin),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contour;
    use crate::emitter::Emitters;
    use catoptric_scene::{Material, Radiance, Scene, SceneParts};
    use catoptric_trace::Tracer;
    use catoptric_trace::sequence::{Key, Purpose};

    /// Sums what the cells of each node send to a view; returns the count of the node's cells and their sum, and counts in `far` the bundles of points.
    fn check(tree: &LightTree, all: &[Cell], view: &View, index: u32, far: &mut u32) -> (u32, f64) {
        let node = &tree.nodes[index as usize];
        let (count, sum) = match node.children() {
            Some(children) => {
                let [a, b] = children.map(|child| check(tree, all, view, child, far));
                // Light-side rays are stratified over the cells in this order.
                assert!(a.0.abs_diff(b.0) <= 1, "no halves: {} and {}", a.0, b.0);
                (a.0 + b.0, a.1 + b.1)
            }
            None => {
                let cell = &all[node.first() as usize];
                let sent = if cell.faces(view.point) {
                    contour::irradiance(view.point, view.normal, &cell.polygon())
                } else {
                    0.0
                };
                (1, sent * f64::from(cell.radiance.element_sum()))
            }
        };
        let bound = tree.bound(index, view);
        let apart = (node.center - view.point).length() > 2.0 * f64::from(node.radius);
        assert!(sum <= 0.0 || bound > 0.0, "{count} cells send {sum}");
        assert!(!apart || sum <= bound * (1.0 + 1e-5), "{count} cells send {sum}, bounded by {bound}");
        if let Some((bundle, cells)) = tree.bundle_of(index) {
            assert_eq!(cells.len(), count as usize);
            let drawn = bundle.draw::<true>(cells.clone(), view, 0.5);
            assert!(sum <= 0.0 || drawn.is_some(), "{count} cells send {sum}");
            let estimate = bundle.estimate(cells.clone(), view);
            assert!(sum <= 0.0 || estimate > 0.0, "{count} cells send {sum}");
            if matches!(tree.look(all, view, index), Look::Part(Part::Bundle(_))) {
                *far += 1;
                let irradiance = f64::from(bundle.irradiance(cells, view).element_sum());
                // What a group may be off, of what it would send at right angles: averted and grazing cells err by as much.
                let most = tree.power * f64::from(node.power) / (node.center - view.point).length_squared();
                assert!((irradiance - sum).abs() < 0.0025 * most, "{count} cells: {irradiance} {sum} {most}");
            }
        }
        (count, sum)
    }

    #[test]
    fn no_group_sends_more_than_its_bound() {
        let mut parts = SceneParts::default();
        let glowing = parts.add_material(Material::emitter("glowing", Radiance(Rgb::splat(3.0))));
        parts.add_sphere("one", glowing, Vec3::ZERO, 0.3, 12);
        parts.add_sphere("four", glowing, Vec3::new(-0.4, 0.5, 0.3), 0.1, 20);
        parts.add_box("two", glowing, Vec3::splat(0.4), Vec3::new(0.5, 0.9, 0.6), true);
        parts.add_quad("three", glowing, Vec3::new(-0.9, -0.5, 0.1), Vec3::X * 0.2, Vec3::Y);
        let scene = Scene::new(parts).expect("a valid scene");
        let tracer = Tracer::new(&scene);
        let emitters = Emitters::new(&tracer);
        // Over lamps, too, which are in no tree of the emitters.
        let (tree, order) = LightTree::new(emitters.cells());
        let cells: Vec<Cell> = order.iter().map(|&i| emitters.cells()[i as usize]).collect();
        let windows = Windows::default();
        let key = Key::new(3, Purpose::Test, 0);
        let mut far = 0;
        for index in 0..3000 {
            let [a, b, c] = [0, 1, 2].map(|child| key.child(child).point2(index).as_dvec2() * 2.0 - 1.0);
            let (point, normal) = (DVec3::new(a.x, a.y, b.x), DVec3::new(b.y, c.x, c.y));
            let normal = normal.normalize_or(DVec3::Y);
            let view = View { point, normal, geometric: normal, windows: &windows, beyond: None };
            let (count, _) = check(&tree, &cells, &view, 0, &mut far);
            assert_eq!(count as usize, cells.len());
        }
        assert!(far > 3000, "{far} bundles of points");
    }
}
