//! The patches of the coarse solve: base triangles of the mesh, and clusters of small ones.

use std::collections::BTreeMap;

use glam::Vec3;

use catoptric_light::Receiver;
use catoptric_scene::{Barycentric, Rgb, Side, TriangleId};
use catoptric_trace::sequence::{Key, triangle_point};
use catoptric_trace::{MediumId, Tracer};

use crate::draft::Draft;

/// A patch of the mesh.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PatchId(pub u32);

/// Sets of near-coplanar base triangles of like material.
#[derive(Clone, Debug, Default)]
pub struct PatchMesh {
    /// Area of each patch, m².
    pub areas: Vec<f32>,
    /// Centre of each patch.
    pub centers: Vec<Vec3>,
    /// Medium in front of each patch.
    pub media: Vec<MediumId>,
    /// Mean effective diffuse reflectance of each patch.
    pub reflectances: Vec<Rgb>,
    /// Mean diffuse transmittance of each patch.
    pub transmittances: Vec<Rgb>,
    /// The patch on the other side, for diffuse transmission.
    pub opposite: Vec<Option<PatchId>>,
    /// Patch of each base triangle.
    pub of_root: Vec<PatchId>,
    /// Base triangles of each patch, with the running sum of their areas.
    members: Vec<Vec<(u32, f32)>>,
}

/// Base triangles smaller than this share of the spacing squared are clustered.
const CLUSTER_BELOW: f32 = 0.12;

impl PatchMesh {
    /// Builds the patches of a draft that has not been refined yet: its leaves are its base triangles.
    pub fn new(tracer: &Tracer, draft: &Draft, spacing: f32) -> Self {
        let scene = tracer.scene();
        let mut mesh = Self { of_root: vec![PatchId(0); draft.roots], ..Self::default() };
        let mut clusters: BTreeMap<[i32; 7], PatchId> = BTreeMap::new();
        let regions = regions_of_cut_faces(draft);
        for leaf in &draft.leaves {
            let area = draft.area(leaf);
            let face = &draft.faces[leaf.face as usize];
            let medium = draft.medium_of_root[leaf.root as usize];
            let center = draft.center(leaf);
            let patch = if area >= CLUSTER_BELOW * spacing * spacing {
                mesh.push(medium)
            } else {
                // One cluster per cube of the spacing, material, side and dominant direction, and on one side of the
                // contact lines: else light would pass through the walls that stand there.
                let normal = face.side.orient(scene.geometric_normal(face.triangles[0]));
                let axis = dominant_axis(normal);
                let cube = (center / spacing).floor();
                let material = scene.material_id_of(face.triangles[0]).0 as i32;
                let kind = axis << 1 | face.side as i32;
                let key = [
                    cube.x as i32,
                    cube.y as i32,
                    cube.z as i32,
                    material,
                    kind,
                    i32::from(medium.0),
                    regions[leaf.root as usize],
                ];
                *clusters.entry(key).or_insert_with(|| mesh.push(medium))
            };
            mesh.add(tracer, draft, leaf.root, patch, area, center);
        }
        for patch in 0..mesh.areas.len() {
            let area = mesh.areas[patch].max(f32::MIN_POSITIVE);
            mesh.centers[patch] /= area;
            mesh.reflectances[patch] /= area;
            mesh.transmittances[patch] /= area;
        }
        mesh.find_opposites(tracer, draft);
        mesh
    }

    fn push(&mut self, medium: MediumId) -> PatchId {
        self.areas.push(0.0);
        self.centers.push(Vec3::ZERO);
        self.media.push(medium);
        self.reflectances.push(Rgb::ZERO);
        self.transmittances.push(Rgb::ZERO);
        self.opposite.push(None);
        self.members.push(Vec::new());
        PatchId(self.areas.len() as u32 - 1)
    }

    fn add(&mut self, tracer: &Tracer, draft: &Draft, root: u32, patch: PatchId, area: f32, center: Vec3) {
        let index = patch.0 as usize;
        self.of_root[root as usize] = patch;
        self.areas[index] += area;
        self.centers[index] += center * area;
        self.members[index].push((root, self.areas[index]));
        let leaf = &draft.leaves[root as usize];
        let face = &draft.faces[leaf.face as usize];
        // Textures vary inside of a base triangle: four points give the mean that the coarse solve needs.
        let textured = tracer.scene().material_of(face.triangles[0]).base_texture.is_some();
        let points: &[(f32, f32)] =
            if textured { &[(0.333, 0.333), (0.6, 0.2), (0.2, 0.6), (0.2, 0.2)] } else { &[(0.333, 0.333)] };
        for &(u, v) in points {
            let position = position_in(draft, leaf.vertices, u, v);
            let triangle = face.triangle_at(tracer, position);
            let at = crate::draft::barycentric(tracer, triangle, position);
            let point = tracer.scene().surface_point(triangle, at);
            if let Some(side) = tracer.diffuse_side(triangle, &point, face.side) {
                let share = area / points.len() as f32;
                self.reflectances[index] += side.reflectance * (share * side.opacity);
                self.transmittances[index] += side.transmittance * (share * side.opacity);
            }
        }
    }

    /// Pairs the two sides of transmitting triangles by looking up the root at the same place.
    fn find_opposites(&mut self, tracer: &Tracer, draft: &Draft) {
        let transmits = self.transmittances.iter().any(|t| t.max_element() > 0.0);
        if !transmits {
            return;
        }
        let mut by_place: BTreeMap<(TriangleId, Side, [i64; 3]), PatchId> = BTreeMap::new();
        let place = |p: Vec3| [p.x, p.y, p.z].map(|c| (f64::from(c) * 1e4).round() as i64);
        for leaf in &draft.leaves {
            let face = &draft.faces[leaf.face as usize];
            let center = draft.center(leaf);
            let triangle = face.triangle_at(tracer, center);
            by_place.insert((triangle, face.side, place(center)), self.of_root[leaf.root as usize]);
        }
        for leaf in &draft.leaves {
            let face = &draft.faces[leaf.face as usize];
            let center = draft.center(leaf);
            let key = (face.triangle_at(tracer, center), face.side.opposite(), place(center));
            let own = self.of_root[leaf.root as usize].0 as usize;
            if self.opposite[own].is_none() {
                self.opposite[own] = by_place.get(&key).copied();
            }
        }
    }

    /// Number of patches.
    pub fn len(&self) -> usize {
        self.areas.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.areas.is_empty()
    }

    /// The base triangles of a patch.
    pub fn roots(&self, patch: PatchId) -> impl Iterator<Item = u32> + '_ {
        self.members[patch.0 as usize].iter().map(|m| m.0)
    }

    /// A point of a patch, uniform by area, as a receiver with the geometric normal.
    pub fn receiver(&self, tracer: &Tracer, draft: &Draft, patch: PatchId, key: Key, index: u32) -> Receiver {
        let members = &self.members[patch.0 as usize];
        let area = self.areas[patch.0 as usize];
        let pick = key.uniform(index) * area;
        let chosen = members.partition_point(|m| m.1 <= pick).min(members.len() - 1);
        let root = members[chosen].0;
        let (u, v) = triangle_point(key.child(1).point2(index));
        let position = position_in(draft, draft.base[root as usize], u, v);
        let face = &draft.faces[draft.face_of_root[root as usize] as usize];
        let triangle = face.triangle_at(tracer, position);
        let normal = face.side.orient(tracer.scene().geometric_normal(triangle));
        let medium = draft.medium_of_root[root as usize];
        draft.receiver_at(tracer, face, medium, position, normal, triangle)
    }
}

/// The part of its face that each base triangle belongs to, where contact lines cut the face; else −1.
fn regions_of_cut_faces(draft: &Draft) -> Vec<i32> {
    let regions = draft.regions();
    let mut first = vec![None; draft.faces.len()];
    let mut is_cut = vec![false; draft.faces.len()];
    for (&face, &region) in draft.face_of_root.iter().zip(&regions) {
        let face = face as usize;
        is_cut[face] |= *first[face].get_or_insert(region) != region;
    }
    let of = |(&face, &region): (&u32, &u32)| if is_cut[face as usize] { region as i32 } else { -1 };
    draft.face_of_root.iter().zip(&regions).map(of).collect()
}

/// The point of barycentric coordinates (u, v) between three vertices of a draft.
pub fn position_in(draft: &Draft, vertices: [u32; 3], u: f32, v: f32) -> Vec3 {
    let at = Barycentric { u, v };
    let [a, b, c] = vertices.map(|i| draft.vertices[i as usize].position);
    a + (b - a) * at.u + (c - a) * at.v
}

/// 0..6: the axis and sign along which a direction mostly points.
fn dominant_axis(direction: Vec3) -> i32 {
    let absolute = direction.abs();
    let axis = if absolute.x >= absolute.y && absolute.x >= absolute.z {
        0
    } else if absolute.y >= absolute.z {
        1
    } else {
        2
    };
    let negative = [direction.x, direction.y, direction.z][axis] < 0.0;
    (axis as i32) << 1 | i32::from(negative)
}
