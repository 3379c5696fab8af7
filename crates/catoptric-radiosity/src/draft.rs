//! The display mesh while it is refined: red triangles in a hierarchy, closed by green ones only when it is read.
//! `subdivision` splits them, `receivers` says where light arrives.

use std::collections::BTreeMap;

use glam::{DVec2, Vec3};
use rayon::prelude::*;
use rustc_hash::{FxHashMap, FxHashSet};

use catoptric_scene::{TriangleId, Union};
use catoptric_trace::{MediumId, Tracer};

use crate::arrangement::distinct;
use crate::contact::{Obstacles, Segment, gaps_at};
use crate::cut::cuts;
use crate::face::{FaceDraft, faces};
use crate::lattice::Lattice;
use crate::media::find_media;
use crate::triangulate::{FlatMesh, triangulate};

mod receivers;
mod subdivision;

pub use receivers::barycentric;

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

impl Leaf {
    /// Its edges.
    pub(crate) fn edges(&self) -> [(u32, u32); 3] {
        let [a, b, c] = self.vertices;
        [edge(a, b), edge(b, c), edge(c, a)]
    }
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
        let obstacles = Obstacles::new(tracer);
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

    /// Length of a triangle's longest edge, metres.
    pub(crate) fn longest_edge(&self, leaf: &Leaf) -> f32 {
        leaf.edges().into_iter().map(|edge| self.length(edge)).fold(0.0, f32::max)
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
}
