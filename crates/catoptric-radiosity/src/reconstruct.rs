//! The classical pictures: light at vertices from the patches around them, instead of the final gather.
//!
//! The rules of Cohen & Greenberg 1985 for regular meshes of cells B₁, B₂ …: an inner vertex has the mean of the four cells around
//! it. `averaged` goes on like that on the border, (B₁+B₂)/2 on an edge and B₁ in a corner, which pulls the border towards
//! the inside; `extrapolated` lets the mean of a border vertex and the inner vertices opposite be what the cells say: (3B₁+3B₂−B₃−B₄)/4
//! on an edge, (7B₁−B₂−B₃−B₄)/4 in a corner. `flat` shows the cells.
//!
//! A cell is two triangles of the mesh that make a parallelogram, else one triangle. On a regular mesh the rules are those above to
//! the letter, elsewhere the same sentences hold with as many cells as there are.

use std::collections::BTreeMap;

use glam::Vec3;

use catoptric_scene::Rgb;
use catoptric_solution::{DisplayMesh, Element};

/// How light at vertices is made from patches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reconstruction {
    /// Every cell has its own light.
    Flat,
    /// Means of the cells around a vertex.
    Averaged,
    /// The same, extrapolated to the border.
    Extrapolated,
}

/// The cells of a mesh and what vertices take from them.
#[derive(Clone, Debug)]
pub struct Cells {
    /// Elements of each cell: one or two.
    members: Vec<Vec<u32>>,
    /// Cells around each vertex, ascending.
    around: Vec<Vec<u32>>,
    /// Whether a vertex is on the border of its face.
    border: Vec<bool>,
}

/// Corners of a parallelogram may be off by this share of its diagonal.
const PARALLELOGRAM: f32 = 1e-3;

impl Cells {
    /// Pairs the triangles of a mesh.
    pub fn new(mesh: &DisplayMesh) -> Self {
        // Elements on both sides of each edge: vertices of different faces are different.
        let mut sides: BTreeMap<(u32, u32), Vec<u32>> = BTreeMap::new();
        for (index, element) in mesh.elements.iter().enumerate() {
            for (a, b) in edges(element) {
                sides.entry((a.min(b), a.max(b))).or_default().push(index as u32);
            }
        }
        let mut border = vec![false; mesh.vertices.len()];
        for (&(a, b), elements) in &sides {
            if elements.len() == 1 {
                border[a as usize] = true;
                border[b as usize] = true;
            }
        }
        let mut cell_of = vec![u32::MAX; mesh.elements.len()];
        let mut members: Vec<Vec<u32>> = Vec::new();
        for (&shared, elements) in &sides {
            if let &[first, second] = elements.as_slice()
                && cell_of[first as usize] == u32::MAX
                && cell_of[second as usize] == u32::MAX
                && is_parallelogram(mesh, shared, first, second)
            {
                cell_of[first as usize] = members.len() as u32;
                cell_of[second as usize] = members.len() as u32;
                members.push(vec![first, second]);
            }
        }
        for element in 0..mesh.elements.len() {
            if cell_of[element] == u32::MAX {
                cell_of[element] = members.len() as u32;
                members.push(vec![element as u32]);
            }
        }
        let mut around = vec![Vec::new(); mesh.vertices.len()];
        for (element, &cell) in mesh.elements.iter().zip(&cell_of) {
            for v in element.vertices {
                around[v as usize].push(cell);
            }
        }
        for cells in &mut around {
            cells.sort_unstable();
            cells.dedup();
        }
        Self { members, around, border }
    }

    /// Number of cells of two triangles, and of one.
    pub fn count(&self) -> (usize, usize) {
        let pairs = self.members.iter().filter(|m| m.len() == 2).count();
        (pairs, self.members.len() - pairs)
    }

    /// Light at every vertex from light of every element. Not below zero: light extrapolated into a dark corner may be.
    pub fn at_vertices(&self, mesh: &DisplayMesh, light: &[Rgb], extrapolate: bool) -> Vec<Rgb> {
        let cells = self.of_cells(mesh, light);
        let means: Vec<Rgb> =
            self.around.iter().map(|around| mean(around.iter().map(|&c| cells[c as usize]))).collect();
        if !extrapolate {
            return means;
        }
        (0..means.len())
            .map(|v| {
                if !self.border[v] {
                    return means[v];
                }
                // The inner corner that all cells around share; where there is none, all of theirs.
                let corners = |c: u32| {
                    let elements = self.members[c as usize].iter();
                    let all = elements.flat_map(|&e| mesh.elements[e as usize].vertices);
                    let mut inner: Vec<u32> = all.filter(|&w| !self.border[w as usize]).collect();
                    inner.sort_unstable();
                    inner.dedup();
                    inner
                };
                let mut inner: Vec<u32> = self.around[v].iter().flat_map(|&c| corners(c)).collect();
                inner.sort_unstable();
                let times = |w: u32| inner.iter().filter(|&&x| x == w).count();
                let shared: Vec<u32> =
                    inner.iter().copied().filter(|&w| times(w) == self.around[v].len()).collect();
                if !shared.is_empty() {
                    inner = shared;
                }
                inner.dedup();
                if inner.is_empty() {
                    return means[v];
                }
                (means[v] * 2.0 - mean(inner.iter().map(|&w| means[w as usize]))).max(Rgb::ZERO)
            })
            .collect()
    }

    /// Light of the elements, the same for both of a cell.
    pub fn flat(&self, mesh: &DisplayMesh, light: &[Rgb]) -> Vec<Rgb> {
        let mut result = vec![Rgb::ZERO; mesh.elements.len()];
        for (members, value) in self.members.iter().zip(self.of_cells(mesh, light)) {
            members.iter().for_each(|&e| result[e as usize] = value);
        }
        result
    }

    /// Area-weighted means of the members.
    fn of_cells(&self, mesh: &DisplayMesh, light: &[Rgb]) -> Vec<Rgb> {
        self.members
            .iter()
            .map(|members| {
                let area: f32 = members.iter().map(|&e| mesh.area(e)).sum();
                let sum: Rgb = members.iter().map(|&e| light[e as usize] * mesh.area(e)).sum();
                sum / area.max(f32::MIN_POSITIVE)
            })
            .collect()
    }
}

/// A mesh whose elements share no vertices, for light that is flat. Vertex v belongs to element v / 3.
pub fn unshared(mesh: &DisplayMesh) -> DisplayMesh {
    let vertices = mesh.elements.iter().flat_map(|e| e.vertices.map(|v| mesh.vertices[v as usize])).collect();
    let elements = (0..mesh.elements.len() as u32)
        .map(|e| Element { vertices: [3 * e, 3 * e + 1, 3 * e + 2] })
        .collect();
    DisplayMesh::new(vertices, elements, mesh.faces.clone(), mesh.face_of.clone())
}

fn edges(element: &Element) -> [(u32, u32); 3] {
    let [a, b, c] = element.vertices;
    [(a, b), (b, c), (c, a)]
}

fn mean(values: impl Iterator<Item = Rgb>) -> Rgb {
    let (mut sum, mut count) = (Rgb::ZERO, 0.0);
    for value in values {
        sum += value;
        count += 1.0;
    }
    sum / f32::max(count, 1.0)
}

/// Whether two triangles make a parallelogram with right angles or nearly, whose diagonal is the edge that they share.
fn is_parallelogram(mesh: &DisplayMesh, (a, b): (u32, u32), first: u32, second: u32) -> bool {
    let position = |v: u32| mesh.vertices[v as usize].position;
    let apex = |e: u32| {
        let other = mesh.elements[e as usize].vertices.into_iter().find(|&v| v != a && v != b);
        other.map_or(Vec3::ZERO, position)
    };
    let (p, q, r, s) = (position(a), position(b), apex(first), apex(second));
    let diagonal = (q - p).length();
    let closes = (p + q - r - s).length() <= PARALLELOGRAM * diagonal;
    // The shared edge is the longest of both: else two triangles could pair along a leg.
    let legs = (p - r).length().max((q - r).length());
    closes && legs < diagonal
}
