//! A mesh by the parts that hang together, which are fitted side by side.

use catoptric_solution::DisplayMesh;

use catoptric_scene::Union;

use super::bending::{Bend, bends};

/// Vertices of a job, at least: parts of a few are solved together.
const JOB_VERTICES: u32 = 512;

/// A mesh to which light is fitted: its parts that hang together by elements, side by side.
pub struct FitMesh<'a> {
    pub(super) mesh: &'a DisplayMesh,
    /// Of each part, its first vertex, element and bend in the lists; one more ends the last.
    pub(super) starts: Vec<[u32; 3]>,
    /// Vertices, part by part, ascending.
    pub(super) vertices: Vec<u32>,
    /// Place of each vertex in that list.
    pub(super) place: Vec<u32>,
    /// Elements, part by part, ascending.
    pub(super) elements: Vec<u32>,
    /// Bends, part by part.
    pub(super) bends: Vec<Bend>,
    /// First parts of the jobs that all is done in; one more ends the last.
    pub(super) jobs: Vec<usize>,
}

impl<'a> FitMesh<'a> {
    /// The parts of a mesh.
    pub fn new(mesh: &'a DisplayMesh) -> Self {
        let mut joined = Union::new(mesh.vertices.len());
        for element in &mesh.elements {
            let [a, b, c] = element.vertices;
            joined.join(a, b);
            joined.join(a, c);
        }
        let (part_of, count) = joined.numbered();
        let part_of_element = |e: &u32| part_of[mesh.elements[*e as usize].vertices[0] as usize];
        let part_of_bend = |b: &Bend| part_of[b.vertices[0] as usize];
        let mut vertices: Vec<u32> = (0..mesh.vertices.len() as u32).collect();
        vertices.sort_by_key(|&v| part_of[v as usize]);
        let mut elements: Vec<u32> = (0..mesh.elements.len() as u32).collect();
        elements.sort_by_key(part_of_element);
        let mut bends = bends(mesh);
        bends.sort_by_key(part_of_bend);
        let mut place = vec![0; vertices.len()];
        for (index, &v) in vertices.iter().enumerate() {
            place[v as usize] = index as u32;
        }
        let start = |part: u32| {
            let vertex = vertices.partition_point(|&v| part_of[v as usize] < part);
            let element = elements.partition_point(|e| part_of_element(e) < part);
            let bend = bends.partition_point(|b| part_of_bend(b) < part);
            [vertex, element, bend].map(|i| i as u32)
        };
        let starts: Vec<[u32; 3]> = (0..=count as u32).map(start).collect();
        let mut jobs = vec![0];
        let mut first = 0;
        for (part, &[end, ..]) in starts.iter().enumerate().skip(1) {
            if end - first >= JOB_VERTICES || part == count {
                jobs.push(part);
                first = end;
            }
        }
        Self { mesh, starts, vertices, place, elements, bends, jobs }
    }

    /// The elements of each part.
    pub(super) fn elements_of_parts(&self) -> impl Iterator<Item = &[u32]> {
        self.starts.windows(2).map(|ends| &self.elements[ends[0][1] as usize..ends[1][1] as usize])
    }
}
