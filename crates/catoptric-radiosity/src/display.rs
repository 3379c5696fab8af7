//! The refined mesh as both passes read it: closed, without what refinement needs besides.

use rayon::prelude::*;

use catoptric_solution::{DisplayMesh, DisplayVertex, Element, Face, FaceId};
use catoptric_trace::Tracer;

use crate::draft::{Closed, Draft};

/// A draft as both passes read it.
#[derive(Clone, Debug)]
pub struct Displayed {
    /// The mesh.
    pub mesh: DisplayMesh,
    /// Draft vertex of each mesh vertex.
    pub origin: Vec<u32>,
    /// Base triangle of each element.
    pub roots: Vec<u32>,
    /// Leaf of each element.
    pub leaves: Vec<u32>,
}

impl Draft {
    /// The mesh as both passes read it, with the draft's index of each kept vertex and the base triangle of each element.
    pub fn display(&self, tracer: &Tracer) -> Displayed {
        // What closes each leaf is looked up side by side, vertices are numbered in one go.
        let closed: Vec<Closed> = self.leaves.par_iter().with_min_len(1024).map(|l| self.closed(l)).collect();
        let mut kept = vec![u32::MAX; self.vertices.len()];
        let mut origin = Vec::with_capacity(self.vertices.len());
        let mut vertices = Vec::with_capacity(self.vertices.len());
        let count = closed.iter().map(|closed| closed.triangles().len()).sum();
        let mut roots = Vec::with_capacity(count);
        let mut leaves = Vec::with_capacity(count);
        let mut elements = Vec::with_capacity(count);
        let mut faces = Vec::with_capacity(self.faces.len());
        let mut face_of = [
            vec![FaceId::NONE; tracer.scene().triangles().len()],
            vec![FaceId::NONE; tracer.scene().triangles().len()],
        ];
        let mut leaf = 0;
        for (index, face) in self.faces.iter().enumerate() {
            let start = elements.len() as u32;
            while self.leaves.get(leaf).is_some_and(|l| l.face as usize == index) {
                for corners in closed[leaf].triangles() {
                    let own = corners.map(|v| {
                        if kept[v as usize] == u32::MAX {
                            kept[v as usize] = vertices.len() as u32;
                            origin.push(v);
                            let vertex = &self.vertices[v as usize];
                            vertices.push(DisplayVertex {
                                position: vertex.position,
                                normal: vertex.normal,
                                triangle: vertex.triangle,
                                side: face.side,
                            });
                        }
                        kept[v as usize]
                    });
                    elements.push(Element { vertices: own });
                    roots.push(self.leaves[leaf].root);
                    leaves.push(leaf as u32);
                }
                leaf += 1;
            }
            for &triangle in &face.triangles {
                face_of[face.side.index()][triangle.index()] = FaceId(index as u32);
            }
            faces.push(Face {
                elements: start..elements.len() as u32,
                origin: face.frame.origin.as_vec3(),
                axes: face.frame.axes.map(|a| a.as_vec3()),
            });
        }
        Displayed { mesh: DisplayMesh::new(vertices, elements, faces, face_of), origin, roots, leaves }
    }
}
