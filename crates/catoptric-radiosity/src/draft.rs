//! The display mesh while it is refined: red triangles in a hierarchy, closed by green ones only when it is read.
//!
//! Red–green refinement (Bank, Sherman & Weiser 1983): a triangle with two or three marked edges is split into four,
//! one with a single marked edge is halved, and halves are forgotten before the next round, so that shapes never
//! degenerate and the mesh has no T-vertices.

use std::collections::BTreeMap;

use glam::{DVec2, Vec3};
use rayon::prelude::*;
use rustc_hash::{FxHashMap, FxHashSet};

use catoptric_light::Receiver;
use catoptric_scene::{Barycentric, TriangleId};
use catoptric_trace::interaction::Coat;
use catoptric_trace::{MediumId, MediumStack, Tracer};

use crate::arrangement::distinct;
use crate::contact::{Obstacles, Segment, gaps_at};
use crate::cut::cuts;
use crate::display::Displayed;
use crate::face::{FaceDraft, faces};
use crate::inset::INSET;
use crate::lattice::Lattice;
use crate::media::find_media;
use crate::triangulate::{FlatMesh, triangulate};
use crate::union::Union;

/// A vertex under refinement.
#[derive(Clone, Copy, Debug)]
pub struct DraftVertex {
    /// Where it is shown.
    pub position: Vec3,
    /// Where light of sources is sampled: drawn a little inside its element where the mesh ends.
    pub sample: Vec3,
    /// Where other light is gathered: there, or farther inside beside a gap.
    pub outlook: Vec3,
    /// Unit shading normal on its side.
    pub normal: Vec3,
    /// Its face.
    pub face: u32,
    /// A triangle of the scene that it lies on.
    pub triangle: TriangleId,
    /// Medium before it.
    pub medium: MediumId,
    /// The ends of the edge that it halves.
    pub parents: Option<[u32; 2]>,
}

/// A red triangle that is not split.
#[derive(Clone, Copy, Debug)]
pub struct Leaf {
    /// Its corners.
    pub vertices: [u32; 3],
    /// Its face.
    pub face: u32,
    /// The base triangle that it is a part of.
    pub root: u32,
    /// Times split.
    pub level: u8,
}

impl DraftVertex {
    /// Gathers other light where it receives that of sources, and not farther inside.
    pub(crate) fn gather_there(&mut self) {
        self.outlook = self.sample;
    }
}

/// The conforming triangles of a leaf: itself, or two halves.
#[derive(Clone, Copy, Debug)]
pub struct Closed {
    triangles: [[u32; 3]; 2],
    count: u8,
}

impl Closed {
    /// Those of a leaf of which an edge is halved (0: between corners 0 and 1, …) by a vertex, or none.
    pub(crate) fn of(vertices: [u32; 3], halved: Option<(usize, u32)>) -> Self {
        let Some((k, m)) = halved else { return Self { triangles: [vertices; 2], count: 1 } };
        let [p, q, opposite] = [0, 1, 2].map(|i| vertices[(k + i) % 3]);
        Self { triangles: [[p, m, opposite], [m, q, opposite]], count: 2 }
    }

    /// Their corners.
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles[..usize::from(self.count)]
    }
}

/// The mesh.
#[derive(Clone, Debug, Default)]
pub struct Draft {
    /// Faces.
    pub faces: Vec<FaceDraft>,
    /// Vertices; parents stand before their children.
    pub vertices: Vec<DraftVertex>,
    /// Unsplit triangles, face by face.
    pub leaves: Vec<Leaf>,
    /// Number of base triangles.
    pub roots: usize,
    /// Face of each base triangle.
    pub face_of_root: Vec<u32>,
    /// Medium before each base triangle: a wall that the water's surface crosses lies in two.
    pub medium_of_root: Vec<MediumId>,
    /// Corners of each base triangle.
    pub base: Vec<[u32; 3]>,
    /// Larger triangles, of open faces, count as this much where light is averaged over surfaces, m²: a field must not decide
    /// what is dark in the house.
    pub(crate) most_weight: f32,
    midpoints: FxHashMap<(u32, u32), u32>,
    /// A face that holds an edge, on curved surfaces: its ends alone may belong to other triangles.
    curved_edges: FxHashMap<(u32, u32), u32>,
    /// A place on the own side of each edge that lies on a contact line of a curved mesh, whole or halved.
    pub(crate) beside_lines: FxHashMap<(u32, u32), Vec3>,
    marked: FxHashSet<(u32, u32)>,
    /// Where the dark behind what hangs before a face sets in, or that beside what stands on it ends.
    pub(crate) soft_edges: Vec<SoftEdge>,
}

/// The outline, on a face, of what hangs before it so high that shadow sets in gradually, or of what stands on it and is low.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SoftEdge {
    pub(crate) face: u32,
    pub(crate) ends: [Vec3; 2],
    /// Of what hangs or stands there, metres.
    pub(crate) height: f32,
    /// Unit vector to the side that is darkened, if one is.
    pub(crate) away: Option<Vec3>,
}

/// Long thin triangles of curved meshes are bisected down to this multiple of the spacing.
const SLIVER: f32 = 0.25;

/// Key of an edge.
#[inline]
pub(crate) fn edge(a: u32, b: u32) -> (u32, u32) {
    (a.min(b), a.max(b))
}

impl Draft {
    /// Cuts the diffuse sides of the scene into triangles with edges about `spacing` long, metres.
    pub fn new(tracer: &Tracer, spacing: f32) -> Self {
        let obstacles = Obstacles::new(tracer.scene());
        Self::on(tracer, &obstacles, faces(tracer), &Lattice::even(spacing), f32::INFINITY)
    }

    /// Cuts faces into triangles of a lattice. Their edges will be refined to about `finest` metres where things are near: what hangs lower
    /// before a face, or where that is infinite all that hangs, parts the light there.
    pub(crate) fn on(
        tracer: &Tracer,
        obstacles: &Obstacles,
        drafts: Vec<FaceDraft>,
        lattice: &Lattice,
        finest: f32,
    ) -> Self {
        let scene = tracer.scene();
        let spacing = lattice.spacing;
        let mut draft = Self { most_weight: spacing * spacing, ..Self::default() };
        let tolerance = obstacles.tolerance();

        let flats: Vec<Vec<[DVec2; 3]>> = drafts
            .par_iter()
            .map(|face| {
                let own: &[TriangleId] = if face.curved { &[] } else { &face.triangles };
                let flat = |t: &TriangleId| scene.corners(*t).map(|c| face.frame.flat(c.as_dvec3()));
                distinct(own.iter().map(flat).collect(), tolerance)
            })
            .collect();
        let spacing_in_f64 = f64::from(spacing);
        let contacts = obstacles.contact_lines(scene, &drafts, &flats, spacing_in_f64, f64::from(finest));
        let flat_meshes: Vec<Option<(FlatMesh, Vec<f64>)>> = drafts
            .par_iter()
            .zip(flats.par_iter().zip(&contacts))
            .with_max_len(1)
            .enumerate()
            .map(|(index, (face, (flat, contacts)))| {
                let lines = |parts: bool| -> Vec<Segment> {
                    contacts.iter().filter(|c| c.parts == parts).map(|c| c.segment).collect()
                };
                (!face.curved).then(|| {
                    let mesh = triangulate(
                        flat,
                        &lines(true),
                        &lines(false),
                        f64::from(lattice.spacing_of(index)),
                        tolerance,
                    );
                    let gaps = gaps_at(&mesh.points, contacts, tolerance);
                    (mesh, gaps)
                })
            })
            .collect();
        for (face, contacts) in (0_u32..).zip(&contacts) {
            let frame = &drafts[face as usize].frame;
            for contact in contacts.iter().filter(|c| !c.parts) {
                let ends = contact.segment.map(|p| frame.lift(p).as_vec3());
                draft.soft_edges.push(SoftEdge { face, ends, height: contact.gap as f32, away: None });
            }
            // What stands lower than that is as narrow as elements can be; what is higher, they follow by themselves.
            let heights = finest..0.5 * spacing;
            for contact in contacts.iter().filter(|c| c.foot != DVec2::ZERO) {
                let ends = contact.segment.map(|p| frame.lift(p).as_vec3());
                let foot = (frame.lift(contact.foot) - frame.lift(DVec2::ZERO)).as_vec3();
                let height = foot.length().max(heights.start);
                if heights.contains(&height) {
                    let away = Some(foot.normalize_or_zero());
                    draft.soft_edges.push(SoftEdge { face, ends, height, away });
                }
            }
        }
        let cuts = cuts(scene, &drafts, obstacles, spacing_in_f64);
        draft.faces = drafts;
        let mut welded: BTreeMap<[u32; 7], u32> = BTreeMap::new();
        let mut gap_of: Vec<f64> = Vec::new();
        let mut lines: FxHashSet<(u32, u32)> = FxHashSet::default();
        for index in 0..draft.faces.len() {
            match &flat_meshes[index] {
                Some((mesh, gaps)) => {
                    gap_of.resize(draft.vertices.len(), 0.0);
                    gap_of.extend(gaps);
                    draft.push_flat(tracer, index, mesh);
                }
                None => draft.push_curved(tracer, index, cuts[index].as_ref(), &mut welded, &mut lines),
            }
        }
        draft.part_along(&lines);
        for index in 0..draft.leaves.len() {
            let Leaf { face, vertices, .. } = draft.leaves[index];
            if draft.faces[face as usize].curved {
                draft.note_edges(face, vertices);
            }
        }
        gap_of.resize(draft.vertices.len(), 0.0);
        draft.inset_borders(&gap_of);
        draft.bisect_slivers(tracer, SLIVER * spacing);
        // Long edges of curved meshes are halved until they fit.
        for _ in 0..4 {
            let marks: Vec<(u32, u32)> = draft
                .edges()
                .into_iter()
                .filter(|&(a, b)| {
                    let face = draft.vertices[a as usize].face.min(draft.vertices[b as usize].face);
                    draft.length((a, b)) > 1.6 * lattice.spacing_of(face as usize)
                })
                .collect();
            if marks.is_empty() {
                break;
            }
            draft.split(tracer, &marks);
        }
        draft.inset_lines();
        // What has been made so far is the base.
        for (root, leaf) in draft.leaves.iter_mut().enumerate() {
            leaf.root = root as u32;
            leaf.level = 0;
        }
        draft.roots = draft.leaves.len();
        draft.face_of_root = draft.leaves.iter().map(|l| l.face).collect();
        draft.base = draft.leaves.iter().map(|l| l.vertices).collect();
        draft.medium_of_root = vec![MediumId::AIR; draft.roots];
        find_media(tracer, &mut draft);
        draft
    }

    fn push_flat(&mut self, tracer: &Tracer, face: usize, mesh: &FlatMesh) {
        let first = self.vertices.len() as u32;
        let draft = &self.faces[face];
        let normal = draft.side.orient(draft.frame.normal.as_vec3());
        let mut vertices = Vec::with_capacity(mesh.points.len());
        for &point in &mesh.points {
            let position = draft.frame.lift(point).as_vec3();
            vertices.push(DraftVertex {
                position,
                sample: position,
                outlook: position,
                normal,
                face: face as u32,
                triangle: draft.triangle_at(tracer, position),
                medium: MediumId::AIR,
                parents: None,
            });
        }
        for triangle in &mesh.triangles {
            let root = self.leaves.len() as u32;
            let [a, b, c] = triangle.map(|v| v + first);
            self.leaves.push(Leaf { vertices: [a, b, c], face: face as u32, root, level: 0 });
        }
        self.vertices.extend(vertices);
    }

    /// Length of an edge, metres.
    pub(crate) fn length(&self, (a, b): (u32, u32)) -> f32 {
        (self.vertices[b as usize].position - self.vertices[a as usize].position).length()
    }

    /// Centre of a triangle.
    pub fn center(&self, leaf: &Leaf) -> Vec3 {
        leaf.vertices.iter().map(|&v| self.vertices[v as usize].position).sum::<Vec3>() / 3.0
    }

    /// Area of a triangle, m².
    pub fn area(&self, leaf: &Leaf) -> f32 {
        let [a, b, c] = leaf.vertices.map(|v| self.vertices[v as usize].position);
        0.5 * (b - a).cross(c - a).length()
    }

    /// What a triangle counts where light is averaged, m².
    pub(crate) fn weight(&self, leaf: &Leaf) -> f32 {
        self.area(leaf).min(self.most_weight)
    }

    /// All edges of the leaves, ascending, each once.
    pub fn edges(&self) -> Vec<(u32, u32)> {
        self.edges_where(|_| true)
    }

    /// The edges of the leaves of which one end is such a vertex, ascending, each once.
    pub fn edges_where(&self, is_such: impl Fn(u32) -> bool + Sync) -> Vec<(u32, u32)> {
        let mut edges: Vec<(u32, u32)> = self
            .leaves
            .par_iter()
            .with_min_len(512)
            .flat_map_iter(|leaf| {
                let such = leaf.vertices.map(&is_such);
                (0..3)
                    .filter(move |&k| such[k] || such[(k + 1) % 3])
                    .map(|k| edge(leaf.vertices[k], leaf.vertices[(k + 1) % 3]))
            })
            .collect();
        edges.par_sort_unstable();
        edges.dedup();
        edges
    }

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

    /// Which vertices are corners of leaves.
    pub fn active_vertices(&self) -> Vec<bool> {
        let mut used = vec![false; self.vertices.len()];
        for leaf in &self.leaves {
            for &v in &leaf.vertices {
                used[v as usize] = true;
            }
        }
        used
    }

    /// The conforming triangles of a leaf.
    pub fn closed(&self, leaf: &Leaf) -> Closed {
        Closed::of(leaf.vertices, self.halved_edge(leaf.vertices))
    }

    /// Which edge of a leaf is halved by its neighbour (0: between corners 0 and 1, …), and the vertex there.
    pub(crate) fn halved_edge(&self, vertices: [u32; 3]) -> Option<(usize, u32)> {
        (0..3).find_map(|k| self.marked_midpoint(vertices[k], vertices[(k + 1) % 3]).map(|m| (k, m)))
    }

    /// What each base triangle hangs together with: vertices are not shared across contact lines.
    pub fn regions(&self) -> Vec<u32> {
        let mut joined = Union::new(self.vertices.len());
        for [a, b, c] in self.base.iter().copied() {
            joined.join(a, b);
            joined.join(a, c);
        }
        self.base.iter().map(|corners| joined.find(corners[0])).collect()
    }

    /// Where a vertex receives light.
    pub fn receiver(&self, tracer: &Tracer, vertex: u32) -> Receiver {
        let v = &self.vertices[vertex as usize];
        let face = &self.faces[v.face as usize];
        self.receiver_at(tracer, face, v.medium, v.sample, v.normal, v.triangle)
    }

    /// Where a vertex gathers the light of other surfaces.
    pub fn gatherer(&self, tracer: &Tracer, vertex: u32) -> Receiver {
        let v = &self.vertices[vertex as usize];
        let face = &self.faces[v.face as usize];
        self.receiver_at(tracer, face, v.medium, v.outlook, v.normal, v.triangle)
    }

    /// Where a point inside an element receives light.
    pub fn receiver_inside(
        &self,
        tracer: &Tracer,
        displayed: &Displayed,
        element: u32,
        weights: [f32; 3],
    ) -> Receiver {
        let corners =
            displayed.mesh.elements[element as usize].vertices.map(|v| &displayed.mesh.vertices[v as usize]);
        let mix = |f: &dyn Fn(usize) -> Vec3| f(0) * weights[0] + f(1) * weights[1] + f(2) * weights[2];
        let position = mix(&|k| corners[k].position);
        let leaf = &self.leaves[displayed.leaves[element as usize] as usize];
        self.receiver_of(tracer, leaf, position)
    }

    /// Where a point inside a leaf receives light.
    pub fn receiver_in_leaf(&self, tracer: &Tracer, leaf: u32, weights: [f32; 3]) -> Receiver {
        let leaf = &self.leaves[leaf as usize];
        let corners = leaf.vertices.map(|v| &self.vertices[v as usize]);
        let mix = |f: &dyn Fn(usize) -> Vec3| f(0) * weights[0] + f(1) * weights[1] + f(2) * weights[2];
        let position = mix(&|k| corners[k].position);
        self.receiver_of(tracer, leaf, position)
    }

    /// Where a point of a leaf receives light.
    fn receiver_of(&self, tracer: &Tracer, leaf: &Leaf, position: Vec3) -> Receiver {
        let face = &self.faces[leaf.face as usize];
        let triangle = face.triangle_at(tracer, position);
        let normal = face.normal_at(tracer, triangle, position);
        let medium = self.medium_of_root[leaf.root as usize];
        self.receiver_at(tracer, face, medium, position, normal, triangle)
    }

    /// A receiver at a point of a face.
    pub fn receiver_at(
        &self,
        tracer: &Tracer,
        face: &FaceDraft,
        medium: MediumId,
        position: Vec3,
        normal: Vec3,
        triangle: TriangleId,
    ) -> Receiver {
        let coat = if tracer.is_lambertian(triangle) {
            Coat::NONE
        } else {
            let at = barycentric(tracer, triangle, position);
            let point = tracer.scene().surface_point(triangle, at);
            tracer.diffuse_side(triangle, &point, face.side).map_or(Coat::NONE, |d| d.coat)
        };
        Receiver {
            position,
            plane: tracer.planes().of(triangle),
            normal,
            geometric: face.side.orient(tracer.scene().geometric_normal(triangle)),
            coat,
            media: MediumStack::inside(medium),
        }
    }
}

impl FaceDraft {
    /// Unit shading normal at a point, on the side of the face. On a triangle of a curved mesh the scene's own: halfway between unit
    /// normals is not halfway between their ends, and halved again and again a cone's normals were 2° off.
    pub fn normal_at(&self, tracer: &Tracer, triangle: TriangleId, position: Vec3) -> Vec3 {
        self.side.orient(if self.curved {
            tracer.scene().shading_normal(triangle, barycentric(tracer, triangle, position))
        } else {
            self.frame.normal.as_vec3()
        })
    }
}

/// Barycentric coordinates of a point of a triangle.
pub fn barycentric(tracer: &Tracer, triangle: TriangleId, position: Vec3) -> Barycentric {
    let [a, b, c] = tracer.scene().corners(triangle).map(|p| p.as_dvec3());
    let (e, f, p) = (b - a, c - a, position.as_dvec3() - a);
    let n = e.cross(f);
    let d = n.length_squared().max(f64::MIN_POSITIVE);
    let u = (p.cross(f).dot(n) / d).clamp(0.0, 1.0);
    let v = (e.cross(p).dot(n) / d).clamp(0.0, 1.0 - u);
    Barycentric { u: u as f32, v: v as f32 }
}
