//! What form factors are taken between: named surfaces of the scene, or the patches of the coarse solve.
//!
//! An element is a set of flat convex pieces on one side each. Both kinds look the same to every method.

use glam::DVec3;

use catoptric_light::contour::Polygon;
use catoptric_scene::{Side, TriangleId};
use catoptric_solution::DisplayMesh;
use catoptric_trace::{MediumStack, PlaneId, Tracer};

use crate::draft::Draft;
use crate::media::medium_before;
use crate::patch::{PatchId, PatchMesh};

/// A flat convex part of one side of an element.
#[derive(Clone, Debug)]
pub struct Piece {
    /// Corners, counter-clockwise seen from its side; metres, f64.
    pub outline: Polygon,
    /// A triangle of the scene in it.
    pub triangle: TriangleId,
    /// Its side.
    pub side: Side,
    /// Its plane.
    pub plane: PlaneId,
    /// Unit normal on its side.
    pub normal: DVec3,
    /// m².
    pub area: f64,
    /// Corner and edges where the outline is a parallelogram.
    parallelogram: Option<[DVec3; 3]>,
}

/// A sender and receiver.
#[derive(Clone, Debug)]
pub struct Element {
    /// `node`, `node/primitive`, or the same with `#` and a number for patches; the back of a two-sided surface
    /// ends in ` (back)`.
    pub name: String,
    /// m².
    pub area: f64,
    /// Medium in front.
    pub media: MediumStack,
    /// Its pieces.
    pub pieces: std::ops::Range<usize>,
}

/// Where a hit belongs.
#[derive(Debug)]
enum Lookup {
    /// Element of each side of each triangle.
    Surfaces(Vec<[Option<u32>; 2]>),
    /// Through the unrefined display mesh.
    Patches { mesh: Box<DisplayMesh>, of_element: Vec<PatchId> },
}

/// All senders and receivers.
#[derive(Debug)]
pub struct ElementSet {
    elements: Vec<Element>,
    pieces: Vec<Piece>,
    /// Running sum of the areas of an element's pieces.
    running: Vec<f64>,
    lookup: Lookup,
}

/// Corners of a joined piece, at most: clipping adds more.
const MAX_JOINED: usize = 12;
/// Triangles of one plane and surface beyond which joining them costs more than it saves.
const MAX_JOIN: usize = 256;

impl ElementSet {
    /// Every surface of the scene; two-sided ones have two elements.
    pub fn surfaces(tracer: &Tracer) -> Self {
        let scene = tracer.scene();
        let mut set = Self::empty(Lookup::Surfaces(Vec::new()));
        let mut lookup = vec![[None; 2]; scene.triangles().len()];
        for surface in scene.surfaces() {
            let triangles: Vec<TriangleId> = surface.triangles.clone().map(TriangleId).collect();
            let Some(&first) = triangles.first() else { continue };
            let sides: &[Side] =
                if tracer.has_back(first) { &[Side::Front, Side::Back] } else { &[Side::Front] };
            for &side in sides {
                let index = set.elements.len() as u32;
                for triangle in &triangles {
                    lookup[triangle.index()][side.index()] = Some(index);
                }
                let name = match side {
                    Side::Front => surface.name.clone(),
                    Side::Back => format!("{} (back)", surface.name),
                };
                set.push(name, medium_of(tracer, first, side), joined(tracer, &triangles, side));
            }
        }
        set.lookup = Lookup::Surfaces(lookup);
        set
    }

    /// The patches of a draft.
    pub fn patches(tracer: &Tracer, draft: &Draft, patches: &PatchMesh) -> Self {
        let base = draft.display(tracer);
        let of_element = base.roots.iter().map(|&r| patches.of_root[r as usize]).collect();
        let mut set = Self::empty(Lookup::Patches { mesh: Box::new(base.mesh), of_element });
        for index in 0..patches.len() as u32 {
            let mut pieces = Vec::new();
            let mut name = String::new();
            for root in patches.roots(PatchId(index)) {
                let face = &draft.faces[draft.face_of_root[root as usize] as usize];
                let corners =
                    draft.base[root as usize].map(|v| draft.vertices[v as usize].position.as_dvec3());
                let center = (corners[0] + corners[1] + corners[2]) / 3.0;
                let triangle = face.triangle_at(tracer, center.as_vec3());
                let normal = face.side.orient(tracer.scene().geometric_normal(triangle)).as_dvec3();
                if name.is_empty() {
                    name = format!("{}#{index}", tracer.scene().surface_of(triangle).name);
                }
                pieces.extend(Piece::new(
                    &corners,
                    normal,
                    triangle,
                    face.side,
                    tracer.planes().of(triangle),
                ));
            }
            set.push(name, MediumStack::inside(patches.media[index as usize]), pieces);
        }
        set
    }

    fn empty(lookup: Lookup) -> Self {
        Self { elements: Vec::new(), pieces: Vec::new(), running: Vec::new(), lookup }
    }

    fn push(&mut self, name: String, media: MediumStack, pieces: Vec<Piece>) {
        let start = self.pieces.len();
        let mut area = 0.0;
        for piece in pieces {
            area += piece.area;
            self.running.push(area);
            self.pieces.push(piece);
        }
        self.elements.push(Element { name, area, media, pieces: start..self.pieces.len() });
    }

    /// Number of elements.
    pub fn len(&self) -> usize {
        self.elements.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.elements.is_empty()
    }

    /// All elements.
    pub fn elements(&self) -> &[Element] {
        &self.elements
    }

    /// The pieces of an element.
    pub fn pieces(&self, element: u32) -> &[Piece] {
        &self.pieces[self.elements[element as usize].pieces.clone()]
    }

    /// A point of an element, uniform by area and continuous in (u, v) within a piece.
    pub fn point(&self, element: u32, u: f64, v: f64) -> (&Piece, DVec3) {
        let range = self.elements[element as usize].pieces.clone();
        let running = &self.running[range.clone()];
        let pick = u * self.elements[element as usize].area;
        let chosen = running.partition_point(|&sum| sum <= pick).min(running.len() - 1);
        let piece = &self.pieces[range.start + chosen];
        let before = running[chosen] - piece.area;
        let within = ((pick - before) / piece.area).clamp(0.0, 1.0);
        (piece, piece.point(within, v))
    }

    /// The element at a place of a side of a triangle; `None` where that side has none.
    #[inline]
    pub fn locate(&self, triangle: TriangleId, side: Side, position: DVec3) -> Option<u32> {
        match &self.lookup {
            Lookup::Surfaces(table) => table[triangle.index()][side.index()],
            Lookup::Patches { mesh, of_element } => {
                let located = mesh.locate(triangle, side, position.as_vec3())?;
                Some(of_element[located.element as usize].0)
            }
        }
    }
}

impl Piece {
    /// `None` for outlines without area. `hint` says on which side the normal is.
    fn new(corners: &[DVec3], hint: DVec3, triangle: TriangleId, side: Side, plane: PlaneId) -> Option<Self> {
        let vector = Polygon::new(corners).vector_area();
        let area = vector.length();
        if area.is_nan() || area <= 0.0 {
            return None;
        }
        let normal = vector / area;
        let (outline, normal) = if normal.dot(hint) >= 0.0 {
            (Polygon::new(corners), normal)
        } else {
            let reversed: Vec<DVec3> = corners.iter().rev().copied().collect();
            (Polygon::new(&reversed), -normal)
        };
        let parallelogram = match outline.corners() {
            &[a, b, c, d] if (a + c - b - d).length() <= 1e-6 * (c - a).length() => Some([a, b - a, d - a]),
            _ => None,
        };
        Some(Self { outline, triangle, side, plane, normal, area, parallelogram })
    }

    /// A point, uniform by area. Parallelograms are mapped by their edges: shadows of parallel edges stay parallel to
    /// the axes of the sequence, which then converges faster.
    pub fn point(&self, u: f64, v: f64) -> DVec3 {
        match self.parallelogram {
            Some([corner, a, b]) => corner + a * u + b * v,
            None => self.outline.point(u, v),
        }
    }
}

/// Medium in front of a side.
fn medium_of(tracer: &Tracer, triangle: TriangleId, side: Side) -> MediumStack {
    let [a, b, c] = tracer.scene().corners(triangle);
    MediumStack::inside(medium_before(tracer, (a + b + c) / 3.0, triangle, side))
}

/// The triangles of one surface as few convex polygons: neighbours in one plane are joined while the result is convex.
pub(crate) fn joined(tracer: &Tracer, triangles: &[TriangleId], side: Side) -> Vec<Piece> {
    let scene = tracer.scene();
    let mut groups: std::collections::BTreeMap<PlaneId, Vec<TriangleId>> = std::collections::BTreeMap::new();
    for &triangle in triangles {
        groups.entry(tracer.planes().of(triangle)).or_default().push(triangle);
    }
    let mut pieces = Vec::new();
    for (plane, members) in groups {
        let mut parts: Vec<(Vec<DVec3>, TriangleId, DVec3)> = members
            .iter()
            .map(|&t| {
                let normal = scene.geometric_normal(t).as_dvec3();
                (scene.corners(t).map(|c| c.as_dvec3()).to_vec(), t, normal)
            })
            .collect();
        if parts.len() <= MAX_JOIN {
            let mut index = 0;
            while index < parts.len() {
                let partner = (index + 1..parts.len()).find_map(|other| {
                    let same_side = parts[index].2.dot(parts[other].2) > 0.0;
                    let union = same_side.then(|| union(&parts[index].0, &parts[other].0, parts[index].2))?;
                    Some((other, union?))
                });
                match partner {
                    Some((other, corners)) => {
                        parts[index].0 = corners;
                        parts.remove(other);
                    }
                    None => index += 1,
                }
            }
        }
        pieces.extend(parts.into_iter().filter_map(|(corners, triangle, normal)| {
            Piece::new(&corners, side.orient(normal.as_vec3()).as_dvec3(), triangle, side, plane)
        }));
    }
    pieces
}

/// The union of two polygons that share an edge, if it is convex.
fn union(a: &[DVec3], b: &[DVec3], normal: DVec3) -> Option<Vec<DVec3>> {
    let (n, m) = (a.len(), b.len());
    if n + m - 2 > MAX_JOINED {
        return None;
    }
    let (i, j) = (0..n).flat_map(|i| (0..m).map(move |j| (i, j))).find(|&(i, j)| {
        let (next_i, next_j) = ((i + 1) % n, (j + 1) % m);
        a[i] == b[next_j] && a[next_i] == b[j]
    })?;
    let mut corners: Vec<DVec3> = (1..=n).map(|k| a[(i + k) % n]).collect();
    corners.extend((2..m).map(|k| b[(j + k) % m]));
    let count = corners.len();
    let longest = (0..count).map(|k| (corners[(k + 1) % count] - corners[k]).length()).fold(0.0, f64::max);
    let turn = |k: usize| {
        let (p, q, r) = (corners[k], corners[(k + 1) % count], corners[(k + 2) % count]);
        (q - p).cross(r - q).dot(normal)
    };
    // Straight corners are allowed: rounding may bend them by 1e-7 of the size.
    (0..count).all(|k| turn(k) > -1e-6 * longest * longest).then_some(corners)
}
