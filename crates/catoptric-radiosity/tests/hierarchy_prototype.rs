//! A prototype of hierarchical radiosity (Hanrahan, Salzman & Aupperle 1991) against the interface of the solvers: what it
//! can say in [`Rows`], and what it cannot (docs/adr/0006). Two walls at right angles and a lamp above them, nothing between.

use std::f64::consts::PI;

use glam::DVec3;

use catoptric_light::contour::{Polygon, irradiance};
use catoptric_radiosity::solver::{Params, Rows, Solver, StoredRows, System, solve_system};

/// A rectangle of the hierarchy.
struct Node {
    corner: DVec3,
    edges: [DVec3; 2],
    wall: usize,
    parent: Option<usize>,
    children: Option<[usize; 4]>,
    links: Vec<(usize, f64)>,
}

struct Hierarchy {
    nodes: Vec<Node>,
    reflectance: Vec<f64>,
    emission: Vec<f64>,
}

impl Hierarchy {
    fn new() -> Self {
        let mut hierarchy =
            Self { nodes: Vec::new(), reflectance: vec![0.6, 0.4, 0.0], emission: vec![0.0, 0.0, 1.0] };
        let (x, y, z) = (DVec3::X, DVec3::Y, DVec3::Z);
        for (wall, (corner, edges)) in
            [(DVec3::ZERO, [x, y]), (DVec3::ZERO, [y, z]), (DVec3::new(0.3, 0.3, 1.0), [y * 0.4, x * 0.4])]
                .into_iter()
                .enumerate()
        {
            hierarchy.push(corner, edges, wall, None);
        }
        hierarchy
    }

    fn push(&mut self, corner: DVec3, edges: [DVec3; 2], wall: usize, parent: Option<usize>) -> usize {
        self.nodes.push(Node { corner, edges, wall, parent, children: None, links: Vec::new() });
        self.nodes.len() - 1
    }

    fn area(&self, node: usize) -> f64 {
        let [a, b] = self.nodes[node].edges;
        a.cross(b).length()
    }

    /// F from a node, seen from 2 × 2 of its points.
    fn factor(&self, from: usize, to: usize) -> f64 {
        let Node { corner, edges: [a, b], .. } = self.nodes[to];
        let polygon = Polygon::new(&[corner, corner + a, corner + a + b, corner + b]);
        let Node { corner, edges: [a, b], .. } = self.nodes[from];
        let front = |eye: DVec3| {
            self.nodes[to].edges[0].cross(self.nodes[to].edges[1]).dot(eye - self.nodes[to].corner) > 0.0
        };
        let normal = a.cross(b).normalize();
        let points = [(0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75)];
        let seen = points.map(|(u, v)| corner + a * u + b * v);
        seen.iter().filter(|eye| front(**eye)).map(|eye| irradiance(*eye, normal, &polygon) / PI).sum::<f64>()
            / 4.0
    }

    fn split(&mut self, node: usize) -> [usize; 4] {
        if let Some(children) = self.nodes[node].children {
            return children;
        }
        let Node { corner, edges: [a, b], wall, .. } = self.nodes[node];
        let half = [a * 0.5, b * 0.5];
        let children = [(0.0, 0.0), (0.5, 0.0), (0.0, 0.5), (0.5, 0.5)]
            .map(|(u, v)| self.push(corner + a * u + b * v, half, wall, Some(node)));
        self.nodes[node].children = Some(children);
        children
    }

    /// Links two nodes where their exchange is below `limit`, else their parts.
    fn refine(&mut self, p: usize, q: usize, limit: f64, smallest: f64) {
        let (there, back) = (self.factor(p, q), self.factor(q, p));
        let splits = |h: &Self, n: usize| h.area(n) > smallest;
        if there.max(back) < limit || !(splits(self, p) || splits(self, q)) {
            self.nodes[p].links.push((q, there));
            self.nodes[q].links.push((p, back));
            return;
        }
        // The larger form factor leads to the node that is too coarse.
        if splits(self, q) && (there >= back || !splits(self, p)) {
            for child in self.split(q) {
                self.refine(p, child, limit, smallest);
            }
        } else {
            for child in self.split(p) {
                self.refine(child, q, limit, smallest);
            }
        }
    }

    fn leaves(&self) -> Vec<usize> {
        (0..self.nodes.len()).filter(|&n| self.nodes[n].children.is_none()).collect()
    }

    /// Gathers over the links of every level, then pushes down and pulls up.
    fn sweep(&self, radiosity: &mut [f64]) {
        let gathered: Vec<f64> = self
            .nodes
            .iter()
            .map(|n| self.reflectance[n.wall] * n.links.iter().map(|&(q, f)| f * radiosity[q]).sum::<f64>())
            .collect();
        for root in 0..3 {
            self.push_pull(root, 0.0, &gathered, radiosity);
        }
    }

    fn push_pull(&self, node: usize, above: f64, gathered: &[f64], radiosity: &mut [f64]) -> f64 {
        let down = above + gathered[node];
        radiosity[node] = match self.nodes[node].children {
            None => self.emission[self.nodes[node].wall] + down,
            Some(children) => {
                children.into_iter().map(|c| self.push_pull(c, down, gathered, radiosity)).sum::<f64>() / 4.0
            }
        };
        radiosity[node]
    }
}

/// The links of all ancestors of a leaf, spread over the leaves of their far ends: what the solvers can read.
struct Linked<'a> {
    hierarchy: &'a Hierarchy,
    leaves: Vec<usize>,
    /// Per node: its leaves, as indices into `leaves`.
    below: Vec<Vec<usize>>,
}

impl<'a> Linked<'a> {
    fn new(hierarchy: &'a Hierarchy) -> Self {
        let leaves = hierarchy.leaves();
        let mut below = vec![Vec::new(); hierarchy.nodes.len()];
        for (index, &leaf) in leaves.iter().enumerate() {
            let mut node = Some(leaf);
            while let Some(n) = node {
                below[n].push(index);
                node = hierarchy.nodes[n].parent;
            }
        }
        Self { hierarchy, leaves, below }
    }
}

impl Rows for Linked<'_> {
    fn len(&self) -> usize {
        self.leaves.len()
    }

    fn visit(&self, from: usize, visit: &mut dyn FnMut(usize, f64)) {
        let mut sums = vec![0.0; self.len()];
        let mut node = Some(self.leaves[from]);
        while let Some(n) = node {
            for &(q, factor) in &self.hierarchy.nodes[n].links {
                for &leaf in &self.below[q] {
                    sums[leaf] += factor * self.hierarchy.area(self.leaves[leaf]) / self.hierarchy.area(q);
                }
            }
            node = self.hierarchy.nodes[n].parent;
        }
        sums.iter().enumerate().filter(|(_, f)| **f != 0.0).for_each(|(to, f)| visit(to, *f));
    }
}

fn linked(limit: f64, smallest: f64) -> Hierarchy {
    let mut hierarchy = Hierarchy::new();
    for (p, q) in [(0, 1), (0, 2), (1, 2)] {
        hierarchy.refine(p, q, limit, smallest);
    }
    hierarchy
}

fn solve(hierarchy: &Hierarchy, rows: &dyn Rows, leaves: &[usize]) -> Vec<f64> {
    let wall = |n: &usize| hierarchy.nodes[*n].wall;
    let reflectance: Vec<f64> = leaves.iter().map(|n| hierarchy.reflectance[wall(n)]).collect();
    let emission: Vec<f64> = leaves.iter().map(|n| hierarchy.emission[wall(n)]).collect();
    let weights: Vec<f64> = leaves.iter().map(|n| hierarchy.area(*n)).collect();
    let system = System { rows, reflectance: &reflectance, emission: &emission, weights: &weights };
    let params = Params { residual: 1e-13, ..Params::default() };
    solve_system(Solver::GaussSeidel, &system, &params, &mut |_| true).radiosity
}

/// Area-weighted mean radiosity of the floor.
fn floor(hierarchy: &Hierarchy, leaves: &[usize], radiosity: &[f64]) -> f64 {
    let on_floor = leaves.iter().zip(radiosity).filter(|(n, _)| hierarchy.nodes[**n].wall == 0);
    on_floor.map(|(n, b)| hierarchy.area(*n) * b).sum::<f64>()
}

#[test]
fn links_read_as_rows_have_the_solution_of_push_and_pull() {
    let hierarchy = linked(0.02, 1e-3);
    let rows = Linked::new(&hierarchy);
    let flat = solve(&hierarchy, &rows, &rows.leaves);
    let mut radiosity: Vec<f64> = hierarchy.nodes.iter().map(|n| hierarchy.emission[n.wall]).collect();
    for _ in 0..100 {
        hierarchy.sweep(&mut radiosity);
    }
    for (&leaf, b) in rows.leaves.iter().zip(&flat) {
        assert!((radiosity[leaf] - b).abs() < 1e-10, "{} {b}", radiosity[leaf]);
    }
    // Why the hierarchy must sweep by itself: as rows, every link is as long as its far end has leaves.
    let links: usize = hierarchy.nodes.iter().map(|n| n.links.len()).sum();
    let mut entries = 0;
    (0..rows.len()).for_each(|i| rows.visit(i, &mut |_, _| entries += 1));
    println!("{} leaves, {links} links, {entries} entries as rows", rows.len());
    assert!(links * 5 < entries);
}

#[test]
fn few_links_come_close_to_all_pairs() {
    let hierarchy = linked(0.02, 4e-3);
    let rows = Linked::new(&hierarchy);
    let by_links = floor(&hierarchy, &rows.leaves, &solve(&hierarchy, &rows, &rows.leaves));
    let fine = linked(0.0, 4e-3);
    let leaves = fine.leaves();
    let pairs: Vec<Vec<f64>> = leaves
        .iter()
        .map(|&p| {
            let other =
                |q: usize| if fine.nodes[p].wall == fine.nodes[q].wall { 0.0 } else { fine.factor(p, q) };
            leaves.iter().map(|&q| other(q)).collect()
        })
        .collect();
    let by_pairs = floor(&fine, &leaves, &solve(&fine, &StoredRows::dense(&pairs), &leaves));
    // Links carry up to 0.02 each; the prototype's own aim is one per cent of the power.
    assert!((by_links / by_pairs - 1.0).abs() < 0.01, "{by_links} by links, {by_pairs} by pairs");
}
