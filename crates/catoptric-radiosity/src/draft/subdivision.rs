//! Leaves of the mesh are split, edges halved.
//!
//! Red–green refinement (Bank, Sherman & Weiser 1983): a triangle with two or three marked edges is split into four,
//! one with a single marked edge is halved, and halves are forgotten before the next round, so that shapes never
//! degenerate and the mesh has no T-vertices.

use glam::Vec3;
use rayon::prelude::*;

use catoptric_trace::Tracer;

use super::{Draft, DraftVertex, Leaf, edge};
use crate::inset::INSET;

impl Draft {
    pub(crate) fn note_edges(&mut self, face: u32, [a, b, c]: [u32; 3]) {
        for (p, q) in [(a, b), (b, c), (c, a)] {
            self.curved_edges.entry(edge(p, q)).or_insert(face);
        }
    }

    /// The vertex that halves an edge, made if it does not exist.
    pub fn midpoint(&mut self, tracer: &Tracer, a: u32, b: u32) -> u32 {
        let edge = edge(a, b);
        if let Some(&known) = self.midpoints.get(&edge) {
            known
        } else {
            self.push_midpoint(self.halved(tracer, edge), edge)
        }
    }

    /// Makes the vertices that halve edges, where they do not exist, in their order.
    pub fn make_midpoints(&mut self, tracer: &Tracer, edges: &[(u32, u32)]) {
        let halved = |&(a, b): &(u32, u32)| {
            let edge = edge(a, b);
            (!self.midpoints.contains_key(&edge)).then(|| (edge, self.halved(tracer, edge)))
        };
        let made: Vec<_> = edges.par_iter().with_min_len(256).map(halved).collect();
        for (edge, vertex) in made.into_iter().flatten() {
            if !self.midpoints.contains_key(&edge) {
                self.push_midpoint(vertex, edge);
            }
        }
    }

    /// The vertex that would halve an edge.
    fn halved(&self, tracer: &Tracer, (a, b): (u32, u32)) -> DraftVertex {
        let (p, q) = (self.vertices[a as usize], self.vertices[b as usize]);
        let position = (p.position + q.position) * 0.5;
        let on = self.curved_edges.get(&(a, b)).copied().unwrap_or(p.face.min(q.face));
        let face = &self.faces[on as usize];
        let (triangle, normal, sample, outlook) = if face.curved {
            let triangle = face.triangles[0];
            let corners = tracer.scene().corners(triangle);
            let beside = self.beside_lines.get(&(a, b)).copied();
            let center = beside.unwrap_or((corners[0] + corners[1] + corners[2]) / 3.0);
            let inside = position.lerp(center, INSET);
            (triangle, face.normal_at(tracer, triangle, position), inside, inside)
        } else {
            // Insets are inherited: the mean of the parents' gathering points lies inside where they do.
            let middle = |a: Vec3, b: Vec3| (a + b) * 0.5;
            let triangle = face.triangle_at(tracer, position);
            (triangle, p.normal, middle(p.sample, q.sample), middle(p.outlook, q.outlook))
        };
        DraftVertex {
            position,
            sample,
            outlook,
            normal,
            face: on,
            triangle,
            medium: p.medium,
            parents: Some([a, b]),
        }
    }

    fn push_midpoint(&mut self, vertex: DraftVertex, (a, b): (u32, u32)) -> u32 {
        let index = self.vertices.len() as u32;
        self.vertices.push(vertex);
        self.midpoints.insert((a, b), index);
        if let Some(&beside) = self.beside_lines.get(&(a, b)) {
            self.beside_lines.insert(edge(a, index), beside);
            self.beside_lines.insert(edge(index, b), beside);
        }
        index
    }

    /// The midpoint of an edge if it exists.
    pub fn known_midpoint(&self, a: u32, b: u32) -> Option<u32> {
        self.midpoints.get(&edge(a, b)).copied()
    }

    /// The vertex that halves an edge in the mesh as it is shown.
    pub fn marked_midpoint(&self, a: u32, b: u32) -> Option<u32> {
        if self.marked.contains(&edge(a, b)) { self.known_midpoint(a, b) } else { None }
    }

    /// All edges that have been split, ascending.
    pub fn marked_edges(&self) -> Vec<(u32, u32)> {
        let mut edges: Vec<(u32, u32)> = self.marked.iter().copied().collect();
        edges.sort_unstable();
        edges
    }

    /// Marks edges for splitting and splits triangles until the rest can be closed by halving: a triangle with two
    /// or three marked edges is split into four, and so is one whose marked edge is split twice.
    /// Returns the range of vertices that were made.
    pub fn split(&mut self, tracer: &Tracer, marks: &[(u32, u32)]) -> std::ops::Range<u32> {
        let before = self.vertices.len() as u32;
        // What is new is at these vertices: a leaf that has fewer than two of them is as it was.
        let mut touched = vec![false; self.vertices.len()];
        for &(a, b) in marks {
            let middle = self.midpoint(tracer, a, b);
            self.marked.insert(edge(a, b));
            self.touch(&mut touched, &[a, b, middle]);
        }
        loop {
            // All leaves are looked at before the first is split: side by side, in whatever order.
            let wanted: Vec<bool> = self
                .leaves
                .par_iter()
                .with_min_len(512)
                .map(|leaf| {
                    let count = leaf.vertices.iter().filter(|&&v| touched[v as usize]).count();
                    count > 1 && self.is_to_be_split(leaf)
                })
                .collect();
            if !wanted.contains(&true) {
                return before..self.vertices.len() as u32;
            }
            let mut parts: Vec<[Leaf; 4]> = Vec::new();
            for index in (0..wanted.len()).filter(|&index| wanted[index]) {
                let leaf = self.leaves[index];
                let [a, b, c] = leaf.vertices;
                let [ab, bc, ca] = [(a, b), (b, c), (c, a)].map(|(p, q)| {
                    self.marked.insert(edge(p, q));
                    self.midpoint(tracer, p, q)
                });
                self.touch(&mut touched, &[a, b, c, ab, bc, ca]);
                let corners = [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]];
                if self.faces[leaf.face as usize].curved {
                    corners.iter().for_each(|&vertices| self.note_edges(leaf.face, vertices));
                }
                parts.push(corners.map(|vertices| Leaf { vertices, level: leaf.level + 1, ..leaf }));
            }
            self.replace(&wanted, &parts);
        }
    }

    /// Puts parts in the places of leaves, in order: from the back, in the same memory, for few of many are split.
    fn replace(&mut self, is_split: &[bool], parts: &[[Leaf; 4]]) {
        let Some(&[any, ..]) = parts.first() else { return };
        self.leaves.resize(is_split.len() + 3 * parts.len(), any);
        let (mut to, mut from) = (self.leaves.len(), is_split.len());
        let mut parts = parts.iter().rev();
        // Those before the first that is split stay where they are.
        while to > from {
            from -= 1;
            match is_split[from].then(|| parts.next()).flatten() {
                Some(parts) => {
                    to -= 4;
                    self.leaves[to..to + 4].copy_from_slice(parts);
                }
                None => {
                    to -= 1;
                    self.leaves[to] = self.leaves[from];
                }
            }
        }
    }

    /// Notes vertices and the ends of the edges that they halve: a leaf on the other side may have the whole edge.
    fn touch(&self, touched: &mut Vec<bool>, vertices: &[u32]) {
        touched.resize(self.vertices.len(), false);
        for &v in vertices {
            touched[v as usize] = true;
            for end in self.vertices[v as usize].parents.into_iter().flatten() {
                touched[end as usize] = true;
            }
        }
    }

    /// Whether halving would not close a leaf: two of its edges are marked, or one twice.
    fn is_to_be_split(&self, leaf: &Leaf) -> bool {
        let [a, b, c] = leaf.vertices;
        let edges = [(a, b), (b, c), (c, a)];
        let count = edges.iter().filter(|&&(p, q)| self.marked.contains(&edge(p, q))).count();
        count > 1 || (count == 1 && edges.iter().any(|&(p, q)| self.is_split_twice(p, q)))
    }

    /// Whether an edge is marked and one of its halves is, too.
    fn is_split_twice(&self, a: u32, b: u32) -> bool {
        if !self.marked.contains(&edge(a, b)) {
            return false;
        }
        self.midpoints
            .get(&edge(a, b))
            .is_some_and(|&m| self.marked.contains(&edge(a, m)) || self.marked.contains(&edge(m, b)))
    }
}
