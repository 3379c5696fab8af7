//! Triangles of curved meshes are cut where other surfaces cross them, such as a column that stands in its base: light ends there,
//! so the mesh must too, as on the contact lines of flat faces.

use std::collections::BTreeMap;

use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;
use rustc_hash::{FxHashMap, FxHashSet};

use catoptric_scene::{Barycentric, Scene, TriangleId, Union};
use catoptric_trace::{MediumId, Tracer};

use crate::JOB;
use crate::contact::{Obstacles, Segment};
use crate::draft::{Draft, DraftVertex, Leaf, edge};
use crate::face::FaceDraft;
use crate::inset::INSET;
use crate::triangulate::{CutMesh, cut};

/// Crossings nearer to the end of an edge than this share of its length are at its end: the points of vertices are drawn farther
/// inside than that.
const SNAP: f64 = 1e-3;
/// Lines on all curved triangles together, at most: the largest triangles come first.
const MAX_LINES: usize = 40_000;

/// A curved triangle that is cut.
pub(crate) struct Cut {
    /// Corners of the parts.
    pub(crate) vertices: Vec<CutVertex>,
    /// The parts, turned as the triangle is.
    pub(crate) triangles: Vec<[u32; 3]>,
    /// Edges of them on which another surface crosses.
    pub(crate) lines: Vec<[u32; 2]>,
}

/// A corner of a part.
#[derive(Clone, Copy)]
pub(crate) struct CutVertex {
    pub(crate) position: Vec3,
    /// Unit shading normal of the front.
    pub(crate) normal: Vec3,
    /// Inside the triangle: neighbours do not know it.
    pub(crate) is_inside: bool,
}

/// An edge by the bits of its ends, the lesser first: meshes with seams have several vertices at one place.
type EdgeKey = [[u32; 3]; 2];

/// The key of an edge from `a` to `b`, and whether it leads from the lesser to the greater.
fn key(a: Vec3, b: Vec3) -> (EdgeKey, bool) {
    // Adding zero turns −0 into +0.
    let [a, b] = [a, b].map(|p| p.to_array().map(|v| (v + 0.0).to_bits()));
    if a < b { ([a, b], true) } else { ([b, a], false) }
}

/// The parts of each face that is one triangle of a curved mesh and crossed, or has a neighbour that is.
pub(crate) fn cuts(
    scene: &Scene,
    faces: &[FaceDraft],
    obstacles: &Obstacles,
    spacing: f64,
) -> Vec<Option<Cut>> {
    let tolerance = obstacles.tolerance();
    let mut lines: Vec<Vec<Segment>> = faces
        .par_iter()
        .with_max_len(JOB)
        .map(|face| if face.curved { obstacles.crossings(scene, face, spacing) } else { Vec::new() })
        .collect();
    keep_largest(scene, faces, &mut lines);

    // Where lines end on edges, as shares of the way from the lesser end: both triangles beside an edge must know.
    let mut ends: FxHashMap<EdgeKey, Vec<f64>> = FxHashMap::default();
    for (face, lines) in faces.iter().zip(&lines).filter(|(_, lines)| !lines.is_empty()) {
        let triangle = Triangle::new(scene, face);
        for &point in lines.iter().flatten() {
            if let Some((k, t)) = triangle.on_edge(point, 4.0 * tolerance) {
                let (key, ahead) = triangle.key(k);
                ends.entry(key).or_default().push(if ahead { t } else { 1.0 - t });
            }
        }
    }
    for (&[a, b], ends) in &mut ends {
        let [a, b] = [a, b].map(|p| Vec3::from_array(p.map(f32::from_bits)).as_dvec3());
        let snap = snap((b - a).length(), tolerance);
        ends.sort_by(f64::total_cmp);
        ends.retain(|t| (snap..=1.0 - snap).contains(t));
        ends.dedup_by(|next, kept| *next - *kept < snap);
    }
    ends.retain(|_, ends| !ends.is_empty());

    faces
        .par_iter()
        .zip(&lines)
        .with_max_len(JOB)
        .map(|(face, lines)| {
            if !face.curved || ends.is_empty() && lines.is_empty() {
                return None;
            }
            let triangle = Triangle::new(scene, face);
            let is_crossed = !lines.is_empty() || (0..3).any(|k| ends.contains_key(&triangle.key(k).0));
            is_crossed.then(|| triangle.cut(&ends, lines, tolerance))?
        })
        .collect()
}

/// Share of an edge of so many metres within which two points are one.
fn snap(length: f64, tolerance: f64) -> f64 {
    SNAP.max(4.0 * tolerance / length.max(f64::MIN_POSITIVE)).min(0.5)
}

/// Leaves the lines of the largest triangles, as many as are allowed.
fn keep_largest(scene: &Scene, faces: &[FaceDraft], lines: &mut [Vec<Segment>]) {
    if lines.iter().map(Vec::len).sum::<usize>() <= MAX_LINES {
        return;
    }
    let area = |index: usize| scene.area(faces[index].triangles[0]);
    let mut crossed: Vec<usize> = (0..faces.len()).filter(|&index| !lines[index].is_empty()).collect();
    crossed.sort_by(|&a, &b| area(b).total_cmp(&area(a)).then(a.cmp(&b)));
    let mut left = MAX_LINES;
    for index in crossed {
        if lines[index].len() > left {
            (left, lines[index]) = (0, Vec::new());
        }
        left -= lines[index].len();
    }
}

/// Which of `count` vertices are ends of such edges.
fn ends_of<'a>(edges: impl Iterator<Item = &'a (u32, u32)>, count: usize) -> Vec<bool> {
    let mut are_ends = vec![false; count];
    for &(a, b) in edges {
        (are_ends[a as usize], are_ends[b as usize]) = (true, true);
    }
    are_ends
}

/// Front shading normal at corner `k` of a triangle.
fn corner_normal(scene: &Scene, id: TriangleId, k: usize) -> Vec3 {
    let [u, v] = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]][k];
    scene.shading_normal(id, Barycentric { u, v })
}

/// A triangle of a curved mesh in space and in its plane.
struct Triangle<'a> {
    scene: &'a Scene,
    face: &'a FaceDraft,
    id: TriangleId,
    corners: [Vec3; 3],
    flat: [DVec2; 3],
}

impl<'a> Triangle<'a> {
    fn new(scene: &'a Scene, face: &'a FaceDraft) -> Self {
        let id = face.triangles[0];
        let corners = scene.corners(id);
        Self { scene, face, id, corners, flat: corners.map(|c| face.frame.flat(c.as_dvec3())) }
    }

    /// Key of the edge after corner `k`.
    fn key(&self, k: usize) -> (EdgeKey, bool) {
        key(self.corners[k], self.corners[(k + 1) % 3])
    }

    /// The edge that a point lies on, by the corner that it starts from, and the share of the way along it.
    fn on_edge(&self, point: DVec2, tolerance: f64) -> Option<(usize, f64)> {
        (0..3).find_map(|k| {
            let (a, b) = (self.flat[k], self.flat[(k + 1) % 3]);
            let along = b - a;
            let t = (point - a).dot(along) / along.length_squared();
            let off = along.perp_dot(point - a).abs() / along.length();
            (off <= tolerance && (0.0..=1.0).contains(&t)).then_some((k, t))
        })
    }

    /// Front normal at a corner.
    fn normal(&self, k: usize) -> Vec3 {
        corner_normal(self.scene, self.id, k)
    }

    /// A point inside, in space.
    fn inside(&self, point: DVec2) -> CutVertex {
        let [a, b, c] = self.flat;
        let area = (b - a).perp_dot(c - a);
        let u = ((point - a).perp_dot(c - a) / area).clamp(0.0, 1.0);
        let v = ((b - a).perp_dot(point - a) / area).clamp(0.0, 1.0 - u);
        let normal = self.scene.shading_normal(self.id, Barycentric { u: u as f32, v: v as f32 });
        CutVertex { position: self.face.frame.lift(point).as_vec3(), normal, is_inside: true }
    }

    /// Corners and ends of lines on edges, one after the other around the triangle.
    fn rim(&self, ends: &FxHashMap<EdgeKey, Vec<f64>>) -> Vec<CutVertex> {
        let mut rim = Vec::new();
        for k in 0..3 {
            let next = (k + 1) % 3;
            rim.push(CutVertex { position: self.corners[k], normal: self.normal(k), is_inside: false });
            let (key, ahead) = self.key(k);
            let Some(ends) = ends.get(&key) else { continue };
            // The same bits from both sides.
            let (from, to) = if ahead { (k, next) } else { (next, k) };
            let [p, q] = [from, to].map(|k| self.corners[k].as_dvec3());
            let [m, n] = [from, to].map(|k| self.normal(k));
            let first = rim.len();
            rim.extend(ends.iter().map(|&t| CutVertex {
                position: p.lerp(q, t).as_vec3(),
                normal: m.lerp(n, t as f32).try_normalize().unwrap_or(m),
                is_inside: false,
            }));
            if !ahead {
                rim[first..].reverse();
            }
        }
        rim
    }

    /// The parts of this triangle. Nothing where its edges cannot be kept.
    fn cut(&self, ends: &FxHashMap<EdgeKey, Vec<f64>>, lines: &[Segment], tolerance: f64) -> Option<Cut> {
        let rim = self.rim(ends);
        let outline: Vec<DVec2> = rim.iter().map(|v| self.face.frame.flat(v.position.as_dvec3())).collect();
        let snapped = |point: DVec2| {
            let Some((k, _)) = self.on_edge(point, 4.0 * tolerance) else { return point };
            let length = (self.flat[(k + 1) % 3] - self.flat[k]).length();
            let reach = 2.0 * length * snap(length, tolerance);
            let nearest =
                outline.iter().min_by(|a, b| (**a - point).length().total_cmp(&(**b - point).length()));
            nearest.filter(|p| (**p - point).length() <= reach).copied().unwrap_or(point)
        };
        let is_inner = |line: &Segment| {
            let shared = (0..3).any(|k| {
                let (a, b) = (self.flat[k], self.flat[(k + 1) % 3]);
                let off = |p: DVec2| ((b - a).perp_dot(p - a)).abs() / (b - a).length();
                line.iter().all(|&p| off(p) <= 4.0 * tolerance)
            });
            line[0] != line[1] && !shared
        };
        let lines: Vec<Segment> = lines.iter().map(|line| line.map(snapped)).filter(is_inner).collect();
        if lines.is_empty() && outline.len() == 3 {
            return None;
        }
        let CutMesh { points, triangles, lines } =
            cut(&outline, &lines, tolerance).or_else(|| cut(&outline, &[], tolerance))?;
        let mut vertices = rim;
        vertices.extend(points[outline.len()..].iter().map(|&p| self.inside(p)));
        Some(Cut { vertices, triangles, lines })
    }
}

impl Obstacles {
    /// Where other surfaces cross a triangle of a curved mesh, in its plane: those that share no corner with it. Nothing where
    /// there are more than it is worth.
    fn crossings(&self, scene: &Scene, face: &FaceDraft, spacing: f64) -> Vec<Segment> {
        let triangle = Triangle::new(scene, face);
        let corners = triangle.corners.map(|c| c.as_dvec3());
        let tolerance = self.tolerance();
        let heights =
            |corners: [DVec3; 3], normal: DVec3, origin: DVec3| corners.map(|c| normal.dot(c - origin));
        let is_crossed = |h: [f64; 3]| h.iter().any(|h| *h > tolerance) && h.iter().any(|h| *h < -tolerance);
        let bits = |p: Vec3| p.to_array().map(|v| (v + 0.0).to_bits());
        let own = triangle.corners.map(bits);
        let mut lines = Vec::new();
        let Some(near) = self.near(&corners, &triangle.flat, spacing) else { return lines };
        for id in near {
            let others = scene.corners(id);
            if others.iter().any(|&p| own.contains(&bits(p))) {
                continue;
            }
            let others = others.map(|c| c.as_dvec3());
            let above = heights(others, face.frame.normal, face.frame.origin);
            let normal = (others[1] - others[0]).cross(others[2] - others[0]).normalize_or_zero();
            if !is_crossed(above) || !is_crossed(heights(corners, normal, others[0])) {
                continue;
            }
            lines.extend(self.crossing_inside(&others, &above, face, &triangle.flat));
        }
        lines
    }
}

impl Draft {
    /// Adds a triangle of a curved mesh, whole or in parts; `lines` gets the edges of the parts on which another surface crosses.
    pub(crate) fn push_curved(
        &mut self,
        tracer: &Tracer,
        face: usize,
        cut: Option<&Cut>,
        welded: &mut BTreeMap<[u32; 7], u32>,
        lines: &mut FxHashSet<(u32, u32)>,
    ) {
        let scene = tracer.scene();
        let draft = &self.faces[face];
        let (id, side) = (draft.triangles[0], draft.side);
        let surface = scene.triangles()[id.index()].surface.0;
        let corners = scene.corners(id);
        let center = (corners[0] + corners[1] + corners[2]) / 3.0;
        let mut vertex = |p: Vec3, normal: Vec3, is_inside: bool| {
            let mut push = || {
                self.vertices.push(DraftVertex {
                    position: p,
                    sample: p.lerp(center, INSET),
                    outlook: p.lerp(center, INSET),
                    normal,
                    face: face as u32,
                    triangle: id,
                    medium: MediumId::AIR,
                    parents: None,
                });
                self.vertices.len() as u32 - 1
            };
            if is_inside {
                return push();
            }
            // Adding zero turns −0 into +0.
            let bits = |v: f32| (v + 0.0).to_bits();
            let rounded = |v: f32| ((v * 4096.0).round() + 0.0).to_bits();
            let [x, y, z] = p.to_array().map(bits);
            let [nx, ny, nz] = normal.to_array().map(rounded);
            *welded.entry([x, y, z, nx, ny, nz, surface << 1 | side as u32]).or_insert_with(push)
        };
        let parts: Vec<[u32; 3]> = match cut {
            None => {
                let corner = |k| vertex(corners[k], side.orient(corner_normal(scene, id, k)), false);
                vec![std::array::from_fn(corner)]
            }
            Some(cut) => {
                let own: Vec<u32> = cut
                    .vertices
                    .iter()
                    .map(|v| vertex(v.position, side.orient(v.normal), v.is_inside))
                    .collect();
                lines.extend(cut.lines.iter().map(|&[a, b]| edge(own[a as usize], own[b as usize])));
                cut.triangles.iter().map(|triangle| triangle.map(|v| own[v as usize])).collect()
            }
        };
        for vertices in parts {
            let root = self.leaves.len() as u32;
            self.leaves.push(Leaf { vertices, face: face as u32, root, level: 0 });
        }
    }

    /// Gives the vertices on contact lines of curved meshes one for each side. `lines`: edges on them.
    pub(crate) fn part_along(&mut self, lines: &FxHashSet<(u32, u32)>) {
        if lines.is_empty() {
            return;
        }
        let is_on = ends_of(lines.iter(), self.vertices.len());
        // The corners of triangles at each such vertex, ascending.
        let mut around: FxHashMap<u32, Vec<(u32, usize)>> = FxHashMap::default();
        for (index, leaf) in self.leaves.iter().enumerate() {
            for (k, &v) in leaf.vertices.iter().enumerate().filter(|(_, v)| is_on[**v as usize]) {
                around.entry(v).or_default().push((index as u32, k));
            }
        }
        let mut parted: Vec<u32> = around.keys().copied().collect();
        parted.sort_unstable();
        let before: Vec<[u32; 3]> = self.leaves.iter().map(|leaf| leaf.vertices).collect();
        for v in parted {
            let Some(fan) = around.get(&v) else { continue };
            // Triangles that share an edge which is on no line are on one side.
            let mut side = Union::new(fan.len());
            let mut beside: FxHashMap<u32, u32> = FxHashMap::default();
            for (at, &(leaf, k)) in fan.iter().enumerate() {
                let corners = before[leaf as usize];
                for w in [corners[(k + 1) % 3], corners[(k + 2) % 3]] {
                    if !lines.contains(&edge(v, w)) {
                        side.join(at as u32, *beside.entry(w).or_insert(at as u32));
                    }
                }
            }
            let (side, sides) = side.numbered();
            let copies: Vec<u32> = (1..sides)
                .map(|_| {
                    self.vertices.push(self.vertices[v as usize]);
                    self.vertices.len() as u32 - 1
                })
                .collect();
            for (&(leaf, k), side) in fan.iter().zip(side).filter(|(_, side)| *side > 0) {
                self.leaves[leaf as usize].vertices[k] = copies[side as usize - 1];
            }
        }
        // What halves an edge on a line is drawn to its own side.
        for (leaf, before) in self.leaves.iter().zip(&before) {
            for k in 0..3 {
                let next = (k + 1) % 3;
                if lines.contains(&edge(before[k], before[next])) {
                    let center = self.center(leaf);
                    self.beside_lines.entry(edge(leaf.vertices[k], leaf.vertices[next])).or_insert(center);
                }
            }
        }
    }

    /// Whether each vertex is on a contact line of a curved mesh.
    pub(crate) fn on_lines(&self) -> Vec<bool> {
        ends_of(self.beside_lines.keys(), self.vertices.len())
    }

    /// Draws the sampling points of vertices on contact lines of curved meshes inside, each to its own side.
    pub(crate) fn inset_lines(&mut self) {
        if self.beside_lines.is_empty() {
            return;
        }
        let on_lines = self.on_lines();
        let mut sums: Vec<Option<(Vec3, f32)>> =
            on_lines.into_iter().map(|on| on.then_some((Vec3::ZERO, 0.0))).collect();
        for leaf in &self.leaves {
            let center = self.center(leaf);
            for &v in &leaf.vertices {
                if let Some((sum, count)) = &mut sums[v as usize] {
                    *sum += center;
                    *count += 1.0;
                }
            }
        }
        for (vertex, sum) in self.vertices.iter_mut().zip(sums) {
            if let Some((sum, count)) = sum.filter(|(_, count)| *count > 0.0) {
                vertex.sample = vertex.position.lerp(sum / count, INSET);
                vertex.outlook = vertex.sample;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use catoptric_scene::{Material, MaterialId, Rgb, SceneParts};

    use super::*;

    /// A smooth tube of 24 quads along `axis`, with the radius 0.3 m and 1 m long from `foot`.
    fn add_tube(parts: &mut SceneParts, material: MaterialId, foot: Vec3, axis: Vec3) {
        let (side, other) = axis.any_orthonormal_pair();
        let (mut positions, mut normals, mut indices) = (Vec::new(), Vec::new(), Vec::new());
        for k in 0..24_u32 {
            let (sin, cos) = libm::sincosf(k as f32 * std::f32::consts::TAU / 24.0);
            let normal = side * cos + other * sin;
            positions.extend([foot + 0.3 * normal, foot + 0.3 * normal + axis]);
            normals.extend([normal; 2]);
            let [low, high, next_low, next_high] = [2 * k, 2 * k + 1, (2 * k + 2) % 48, (2 * k + 3) % 48];
            indices.extend([[low, next_high, high], [low, next_low, next_high]]);
        }
        parts.add_mesh("tube", material, &positions, &normals, &indices, true);
    }

    /// The mesh of what `build` puts together, with edges of `spacing` metres; corner by corner each of its curved triangles.
    fn curved(spacing: f32, build: impl Fn(&mut SceneParts, MaterialId)) -> (Draft, Vec<[u32; 3]>) {
        let mut parts = SceneParts::default();
        let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
        build(&mut parts, white);
        let scene = Scene::new(parts).expect("a valid scene");
        let draft = Draft::new(&Tracer::new(&scene), spacing);
        let is_curved = |leaf: &&Leaf| draft.faces[leaf.face as usize].curved;
        let triangles = draft.leaves.iter().filter(is_curved).map(|leaf| leaf.vertices).collect();
        (draft, triangles)
    }

    fn area(draft: &Draft, triangles: &[[u32; 3]]) -> f32 {
        let own = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|v| draft.vertices[v as usize].position);
            0.5 * (b - a).cross(c - a).length()
        };
        triangles.iter().map(own).sum()
    }

    /// Edges that only one triangle has.
    fn open_edges(triangles: &[[u32; 3]]) -> Vec<(u32, u32)> {
        let mut count: BTreeMap<(u32, u32), u32> = BTreeMap::new();
        for [a, b, c] in triangles {
            for key in [edge(*a, *b), edge(*b, *c), edge(*c, *a)] {
                *count.entry(key).or_default() += 1;
            }
        }
        count.into_iter().filter(|(_, n)| *n == 1).map(|(key, _)| key).collect()
    }

    #[test]
    fn a_tube_in_a_plinth_is_cut_where_it_leaves_it() {
        let top = 0.237;
        let build = |parts: &mut SceneParts, white, top| {
            add_tube(parts, white, Vec3::ZERO, Vec3::Y);
            parts.add_box("plinth", white, Vec3::new(-1.0, -0.5, -1.0), Vec3::new(1.0, top, 1.0), false);
        };
        // Twice: with the tube's triangles as they are, and bisected.
        for spacing in [2.0, 0.4] {
            let (draft, triangles) = curved(spacing, |parts, white| build(parts, white, top));
            let (whole, uncut) = curved(spacing, |parts, white| build(parts, white, -0.1));
            let expected = area(&whole, &uncut);
            assert!((area(&draft, &triangles) - expected).abs() < 1e-5 * expected);
            // Rounding of f32, and what is snapped at corners: nothing is, here.
            let height = |v: u32| draft.vertices[v as usize].position.y - top;
            let mut sides = [0, 0];
            for triangle in &triangles {
                let heights = triangle.map(height);
                let is_above = heights.iter().sum::<f32>() > 0.0;
                assert!(heights.iter().all(|h| if is_above { *h > -1e-5 } else { *h < 1e-5 }), "{heights:?}");
                // Light is sampled on the own side.
                let samples = triangle.map(|v| draft.vertices[v as usize].sample.y - top);
                assert!(samples.iter().all(|h| (*h > 0.0) == is_above), "{samples:?}");
                sides[usize::from(is_above)] += 1;
            }
            assert!(sides.iter().all(|n| *n >= 48), "{sides:?}");
            // No T-vertices: but for the rims, and each side of the cut, every edge lies between two triangles.
            let is_end = |h: f32| [-top, 0.0, 1.0 - top].iter().any(|end| (h - end).abs() < 1e-5);
            let open = open_edges(&triangles);
            let mut on_cut = 0;
            for (a, b) in open {
                let (h, g) = (height(a), height(b));
                assert!((h - g).abs() < 1e-5 && is_end(h), "an open edge between {h} and {g}");
                on_cut += usize::from(h.abs() < 1e-5);
            }
            // 24 quads of two triangles are crossed, and there are two sides.
            assert!(on_cut >= 2 * 48, "{on_cut}");
        }
    }

    #[test]
    fn halves_of_edges_on_a_cut_stay_on_their_side() {
        let top = 0.237;
        let mut parts = SceneParts::default();
        let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
        add_tube(&mut parts, white, Vec3::ZERO, Vec3::Y);
        parts.add_box("plinth", white, Vec3::new(-1.0, -0.5, -1.0), Vec3::new(1.0, top, 1.0), false);
        let scene = Scene::new(parts).expect("a valid scene");
        let tracer = Tracer::new(&scene);
        let mut draft = Draft::new(&tracer, 2.0);
        for _ in 0..2 {
            let edges = draft.edges();
            draft.split(&tracer, &edges);
        }
        let mut beside = 0;
        for leaf in draft.leaves.iter().filter(|leaf| draft.faces[leaf.face as usize].curved) {
            let is_above = draft.center(leaf).y > top;
            for v in leaf.vertices.map(|v| draft.vertices[v as usize]) {
                assert_eq!(v.sample.y > top, is_above, "{v:?}");
                beside += usize::from((v.position.y - top).abs() < 1e-5);
            }
        }
        assert!(beside > 400, "{beside}");
    }

    #[test]
    fn balls_that_stand_in_each_other_are_cut_along_one_line() {
        let build = |parts: &mut SceneParts, white, apart: f32| {
            parts.add_sphere("ball", white, Vec3::new(0.01, 0.02, 0.03), 0.5, 24);
            parts.add_sphere("other", white, Vec3::new(apart, 0.05, 0.0), 0.4, 20);
        };
        let (draft, triangles) = curved(1.0, |parts, white| build(parts, white, 0.6));
        let (whole, uncut) = curved(1.0, |parts, white| build(parts, white, 1.5));
        let expected = area(&whole, &uncut);
        assert!((area(&draft, &triangles) - expected).abs() < 1e-4 * expected);
        assert!(open_edges(&uncut).is_empty());
        // Each ball has two open rings now, along the line where both surfaces are.
        let open = open_edges(&triangles);
        assert!(open.len() > 100, "{}", open.len());
        let mut ends: BTreeMap<u32, u32> = BTreeMap::new();
        for (a, b) in open {
            for v in [a, b] {
                *ends.entry(v).or_default() += 1;
                let p = draft.vertices[v as usize].position;
                let off = [
                    (p - Vec3::new(0.01, 0.02, 0.03)).length() - 0.5,
                    (p - Vec3::new(0.6, 0.05, 0.0)).length() - 0.4,
                ];
                // The facets of balls of 24 and 20 rings are up to r(1 − cos(π/20)) = 0.005 m inside.
                assert!(off.iter().all(|d| (-0.006..1e-4).contains(d)), "{off:?}");
            }
        }
        // Closed rings: no edge ends in the open, as one would at a T-vertex.
        assert!(ends.values().all(|n| *n == 2));
    }

    #[test]
    fn what_only_touches_cuts_nothing() {
        // It stands on the floor with its rim.
        let build = |height: f32| {
            curved(2.0, |parts, white| {
                add_tube(parts, white, Vec3::ZERO, Vec3::Y);
                parts.add_quad("floor", white, Vec3::new(-1.0, height, 1.0), Vec3::X * 2.0, Vec3::Z * -2.0);
            })
        };
        let [(_, standing), (_, above), (_, crossed)] = [0.0, -0.1, 0.1].map(build);
        assert_eq!(standing.len(), above.len());
        let [rims, with_cut] = [&above, &crossed].map(|triangles| open_edges(triangles).len());
        assert!(with_cut > rims, "{with_cut} open edges, {rims} of the rims");
    }
}
