//! What meshes that refine the same one have in common: splits that one takes from another, and values that vertices have from
//! the edges that they halve.

use catoptric_trace::Tracer;

use crate::draft::Draft;

impl Draft {
    /// Splits as `other` is split, which refines the same mesh of `common` vertices; returns the number here of each of its
    /// vertices.
    pub fn split_as(&mut self, tracer: &Tracer, other: &Draft, common: usize) -> Vec<u32> {
        let mut here: Vec<u32> = (0..common as u32).collect();
        for vertex in &other.vertices[common..] {
            // Those of the common mesh alone have no parents.
            let Some([a, b]) = vertex.parents else { continue };
            here.push(self.midpoint(tracer, here[a as usize], here[b as usize]));
        }
        let marks: Vec<(u32, u32)> =
            other.marked_edges().into_iter().map(|(a, b)| (here[a as usize], here[b as usize])).collect();
        self.split(tracer, &marks);
        here
    }

    /// Continues values of the first vertices to all: each of the rest has what lies `between` those of the edge that it halves.
    pub(crate) fn fill<T: Copy + Default>(&self, values: &mut Vec<T>, between: impl Fn(T, T) -> T) {
        for vertex in &self.vertices[values.len()..] {
            let value =
                vertex.parents.map_or(T::default(), |[a, b]| between(values[a as usize], values[b as usize]));
            values.push(value);
        }
    }
}
