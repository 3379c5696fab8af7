//! The elements around vertices, and points that are spread as their hat functions are.

use catoptric_solution::Element;
use catoptric_trace::sequence::Key;

use crate::display::Displayed;

/// Points around a vertex at which it gathers.
pub(crate) const POINTS_AROUND: u32 = 4;

/// The elements around each vertex of a display mesh.
///
/// A vertex that gathers at its own place sees the darkest of a corner, and a face with nothing but corners would be dark
/// all over. Points spread with the density of its hat function give the mean that the hat stands for: the integral of
/// the light is kept.
pub(crate) struct Hats {
    /// Per draft vertex: where its elements start in `elements`.
    first: Vec<u32>,
    elements: Vec<u32>,
}

impl Hats {
    pub(crate) fn new(displayed: &Displayed, vertices: usize) -> Self {
        let corners = |e: &Element| e.vertices.map(|v| displayed.origin[v as usize]);
        let mut first = vec![0_u32; vertices + 1];
        for v in displayed.mesh.elements.iter().flat_map(corners) {
            first[v as usize + 1] += 1;
        }
        for v in 0..vertices {
            first[v + 1] += first[v];
        }
        let mut next = first.clone();
        let mut elements = vec![0; first[vertices] as usize];
        for (index, element) in displayed.mesh.elements.iter().enumerate() {
            for v in corners(element) {
                elements[next[v as usize] as usize] = index as u32;
                next[v as usize] += 1;
            }
        }
        Self { first, elements }
    }

    /// Elements around a draft vertex.
    pub(crate) fn around(&self, vertex: u32) -> &[u32] {
        let [start, end] = [0, 1].map(|k| self.first[vertex as usize + k] as usize);
        &self.elements[start..end]
    }

    /// A point around a draft vertex: its element and weights there. `None` where no element touches it.
    pub(crate) fn point(
        &self,
        displayed: &Displayed,
        vertex: u32,
        key: Key,
        index: u32,
    ) -> Option<(u32, [f32; 3])> {
        let mesh = &displayed.mesh;
        let around = self.around(vertex);
        let total: f32 = around.iter().map(|&e| mesh.area(e)).sum();
        let at = key.point2(index);
        let mut left = (index as f32 + key.child(1).uniform(index)) / POINTS_AROUND as f32 * total;
        let mut chosen = *around.last()?;
        for &element in around {
            left -= mesh.area(element);
            if left < 0.0 {
                chosen = element;
                break;
            }
        }
        // The weight of the vertex has the density 6w(1 − w): the middle of three uniform numbers. The rest is uniform.
        let third = key.child(2).uniform(index);
        let [x, y] = [at.x, at.y];
        let own = x.min(y).max(x.max(y).min(third));
        let share = key.child(3).uniform(index);
        let others = [(1.0 - own) * share, (1.0 - own) * (1.0 - share)];
        let corners = mesh.elements[chosen as usize].vertices;
        let place = corners.iter().position(|&v| displayed.origin[v as usize] == vertex)?;
        let mut weights = [0.0; 3];
        weights[place] = own;
        weights[(place + 1) % 3] = others[0];
        weights[(place + 2) % 3] = others[1];
        Some((chosen, weights))
    }
}
