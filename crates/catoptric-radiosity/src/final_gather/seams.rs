//! Where faces of several materials lie side by side in one plane, as the squares of a chequered floor do, the light that arrives knows nothing of
//! it: what is gathered is fitted across their seams. Each square by itself would be a little brighter or darker than the next by noise.

use std::collections::BTreeMap;

use glam::Vec3;

use catoptric_scene::Rgb;
use catoptric_solution::{DisplayMesh, Element};
use catoptric_trace::{MediumId, PlaneId, Tracer};

use crate::display::Displayed;
use crate::draft::Draft;

/// Vertices this near to each other are one, as a multiple of the spacing, …
const NEAR: f32 = 1e-3;
/// … unless something stands between them that is higher than this.
const LIFT: f32 = 0.01;
/// Cosine of the angle within which edges have one direction.
const ALONG: f32 = 0.999;

/// A mesh in which such faces hang together.
pub(super) struct Seams {
    mesh: DisplayMesh,
    /// Its vertex, per vertex of the displayed mesh.
    of: Vec<u32>,
    /// Area around each vertex of the displayed mesh, m².
    areas: Vec<f32>,
}

/// Where vertices must agree to be one: plane and the side of it, medium, what covers the surface, and place.
type Key = (PlaneId, bool, MediumId, u32, [i64; 3]);

/// Where a vertex is, and the unit vectors along its edges.
#[derive(Clone, Debug)]
struct End {
    vertex: u32,
    face: u32,
    above: Vec3,
    edges: Vec<Vec3>,
}

impl End {
    /// Whether it may be one with another: of the same face if they meet in a corner alone, as squares of one colour do. What has an edge along one
    /// of the other's has been parted from it, because something stands or hangs there.
    fn may_join(&self, other: &Self) -> bool {
        let along = |a: &Vec3| other.edges.iter().any(|b| a.dot(*b) > ALONG);
        self.face != other.face || !self.edges.iter().any(along)
    }
}

impl Seams {
    /// `None` where no faces lie side by side. What is `hidden` (per draft vertex) is apart.
    pub(super) fn new(
        tracer: &Tracer,
        draft: &Draft,
        displayed: &Displayed,
        hidden: &[bool],
        spacing: f32,
    ) -> Option<Self> {
        let Displayed { mesh, origin, leaves, .. } = displayed;
        let mut areas = vec![0.0_f32; mesh.vertices.len()];
        let mut face_of = vec![u32::MAX; mesh.vertices.len()];
        for (index, element) in (0_u32..).zip(&mesh.elements) {
            let third = mesh.area(index) / 3.0;
            for &v in &element.vertices {
                areas[v as usize] += third;
                face_of[v as usize] = draft.leaves[leaves[index as usize] as usize].face;
            }
        }
        let places = places(tracer, draft, origin, &face_of, hidden, spacing);
        let edges = edges_at(mesh, &places);
        let end = |v: u32| {
            let vertex = &draft.vertices[origin[v as usize] as usize];
            let above = vertex.sample + vertex.normal * (LIFT * spacing);
            End { vertex: v, face: face_of[v as usize], above, edges: edges[&v].clone() }
        };
        let sees = |a: Vec3, b: Vec3| tracer.visibility(a, PlaneId::NONE, b, PlaneId::NONE) != Rgb::ZERO;
        let mut of: Vec<u32> = (0..mesh.vertices.len() as u32).collect();
        for vertices in &places {
            let mut knots: Vec<Vec<End>> = Vec::new();
            for own in vertices.iter().map(|&v| end(v)) {
                // On either side of what stands on the seam there are vertices of each face: those that see each other, the nearest first.
                let nearest = knots
                    .iter_mut()
                    .filter(|knot| knot.iter().all(|other| own.may_join(other)))
                    .map(|knot| (own.above.distance_squared(knot[0].above), knot))
                    .filter(|(_, knot)| sees(own.above, knot[0].above))
                    .min_by(|a, b| a.0.total_cmp(&b.0));
                if let Some((_, knot)) = nearest {
                    of[own.vertex as usize] = knot[0].vertex;
                    knot.push(own);
                } else {
                    knots.push(vec![own]);
                }
            }
        }
        // The first of each knot has a number of its own.
        let mut kept = Vec::new();
        for v in 0..of.len() {
            let first = of[v] as usize;
            of[v] = if first == v { kept.len() as u32 } else { of[first] };
            if first == v {
                kept.push(mesh.vertices[v]);
            }
        }
        if kept.len() == mesh.vertices.len() {
            return None;
        }
        let sewn = |element: &Element| Element { vertices: element.vertices.map(|v| of[v as usize]) };
        let elements = mesh.elements.iter().map(sewn).collect();
        let mesh = DisplayMesh::new(kept, elements, Vec::new(), [Vec::new(), Vec::new()]);
        Some(Self { mesh, of, areas })
    }

    /// The mesh.
    pub(super) fn mesh(&self) -> &DisplayMesh {
        &self.mesh
    }

    /// Sums, per vertex of the mesh, of what those that are one have.
    fn sums<T: Copy + std::ops::AddAssign>(&self, zero: T, of_vertex: impl Fn(usize) -> T) -> Vec<T> {
        let mut sums = vec![zero; self.mesh.vertices.len()];
        for (v, &to) in self.of.iter().enumerate() {
            sums[to as usize] += of_vertex(v);
        }
        sums
    }

    /// What a vertex weighs beside those that are one with it, by how much the fit trusts it: more than nothing.
    fn weight(&self, trust: &[f32], v: usize) -> f32 {
        (self.areas[v] * trust[v]).max(1e-20)
    }

    /// Means by weight of values per displayed vertex.
    pub(super) fn means(&self, values: &[Rgb], trust: &[f32]) -> Vec<Rgb> {
        let sums = self.sums(Rgb::ZERO, |v| values[v] * self.weight(trust, v));
        let weights = self.sums(0.0, |v| self.weight(trust, v));
        sums.into_iter().zip(weights).map(|(sum, weight)| sum / weight).collect()
    }

    /// Variances of such means by those of the values.
    pub(super) fn variances(&self, variances: &[f32], trust: &[f32]) -> Vec<f32> {
        let sums = self.sums(0.0, |v| variances[v] * self.weight(trust, v).powi(2));
        let weights = self.sums(0.0, |v| self.weight(trust, v));
        sums.into_iter().zip(weights).map(|(sum, weight)| sum / (weight * weight)).collect()
    }

    /// How much the fit trusts them.
    pub(super) fn trust(&self, trust: &[f32]) -> Vec<f32> {
        let sums = self.sums(0.0, |v| trust[v] * self.areas[v]);
        let areas = self.sums(0.0, |v| self.areas[v]);
        sums.into_iter().zip(areas).map(|(sum, area)| sum / area.max(f32::MIN_POSITIVE)).collect()
    }

    /// Gives vertices that are one the mean of their values, per draft vertex; `origin`: those of the displayed mesh.
    pub(super) fn even(&self, values: &mut [Rgb], origin: &[u32]) {
        let own: Vec<Rgb> = origin.iter().map(|&v| values[v as usize]).collect();
        let even = self.parted(&self.means(&own, &vec![1.0; own.len()]));
        for (&v, even) in origin.iter().zip(even) {
            values[v as usize] = even;
        }
    }

    /// Values of the mesh, per displayed vertex.
    pub(super) fn parted(&self, values: &[Rgb]) -> Vec<Rgb> {
        self.of.iter().map(|&v| values[v as usize]).collect()
    }
}

/// Vertices of flat faces that are at one place, ascending, and may be one: `origin` and `face_of` are their draft vertices and faces.
fn places(
    tracer: &Tracer,
    draft: &Draft,
    origin: &[u32],
    face_of: &[u32],
    hidden: &[bool],
    spacing: f32,
) -> Vec<Vec<u32>> {
    let mut places: BTreeMap<Key, Vec<u32>> = BTreeMap::new();
    for ((v, &from), &face) in (0_u32..).zip(origin).zip(face_of) {
        let vertex = &draft.vertices[from as usize];
        let Some(face) = draft.faces.get(face as usize).filter(|face| !face.curved) else { continue };
        if hidden[from as usize] {
            continue;
        }
        let along = tracer.planes().plane(face.plane).normal.dot(vertex.normal.as_dvec3()) > 0.0;
        let coat = if tracer.is_lambertian(vertex.triangle) {
            u32::MAX
        } else {
            tracer.scene().material_id_of(vertex.triangle).0
        };
        let cell = |c: f32| (f64::from(c) / f64::from(NEAR * spacing)).round() as i64;
        let place = vertex.position.to_array().map(cell);
        places.entry((face.plane, along, vertex.medium, coat, place)).or_default().push(v);
    }
    places.into_values().filter(|vertices| vertices.len() > 1).collect()
}

/// Unit vectors along the edges of elements at vertices of some places, by vertex.
fn edges_at(mesh: &DisplayMesh, places: &[Vec<u32>]) -> BTreeMap<u32, Vec<Vec3>> {
    let mut edges: BTreeMap<u32, Vec<Vec3>> = places.iter().flatten().map(|&v| (v, Vec::new())).collect();
    if edges.is_empty() {
        return edges;
    }
    let at = |v: u32| mesh.vertices[v as usize].position;
    for element in &mesh.elements {
        for (k, v) in element.vertices.iter().enumerate() {
            if let Some(edges) = edges.get_mut(v) {
                let ends = [1, 2].map(|step| element.vertices[(k + step) % 3]);
                edges.extend(ends.map(|end| (at(end) - at(*v)).normalize_or_zero()));
            }
        }
    }
    edges
}

#[cfg(test)]
mod tests {
    use catoptric_scene::{Material, MaterialId, Scene, SceneParts};

    use super::*;

    /// Squares of a side of one on either side of x = 0, of these materials, and what stands there.
    fn seams(
        materials: [Material; 2],
        build: impl FnOnce(&mut SceneParts, MaterialId),
    ) -> (Displayed, Option<Seams>) {
        let mut parts = SceneParts::default();
        let [left, right] = materials.map(|m| parts.add_material(m));
        parts.add_quad("left", left, Vec3::new(-1.0, 0.0, 0.0), Vec3::Z, Vec3::X);
        parts.add_quad("right", right, Vec3::ZERO, Vec3::Z, Vec3::X);
        build(&mut parts, left);
        let scene = Scene::new(parts).expect("a valid scene");
        let tracer = Tracer::new(&scene);
        let draft = Draft::new(&tracer, 0.26);
        let displayed = draft.display(&tracer);
        let hidden = vec![false; draft.vertices.len()];
        let seams = Seams::new(&tracer, &draft, &displayed, &hidden, 0.26);
        (displayed, seams)
    }

    fn grey(name: &str, reflectance: f32) -> Material {
        Material::lambertian(name, Rgb::splat(reflectance))
    }

    /// Places on the seam, and where two vertices there are one.
    fn on_seam(displayed: &Displayed, seams: &Seams) -> Vec<(f32, bool)> {
        let vertices = &displayed.mesh.vertices;
        let at = |v: usize| vertices[v].position;
        let upwards = (0..vertices.len()).filter(|&v| at(v).x == 0.0 && vertices[v].normal == Vec3::Y);
        let upwards: Vec<usize> = upwards.collect();
        let first = |&v: &usize| {
            let other = upwards.iter().find(|&&w| w > v && at(w).distance(at(v)) < 1e-4)?;
            Some((at(v).z, seams.of[v] == seams.of[*other]))
        };
        upwards.iter().filter_map(first).collect()
    }

    #[test]
    fn vertices_of_two_materials_in_one_plane_are_one_unless_a_wall_stands_between() {
        let (displayed, seams) = seams([grey("black", 0.1), grey("white", 0.8)], |_, _| {});
        let open = on_seam(&displayed, &seams.expect("a seam"));
        assert!(open.len() >= 4 && open.iter().all(|place| place.1), "{open:?}");

        let (displayed, seams) = self::seams([grey("black", 0.1), grey("white", 0.8)], |parts, black| {
            // Two sheets back to back, from the middle of the seam on.
            let from = Vec3::new(0.0, 0.0, 0.5);
            parts.add_quad("wall", black, from, Vec3::Z * 0.5, Vec3::Y);
            parts.add_quad("wall", black, from, Vec3::Y, Vec3::Z * 0.5);
        });
        let parted = on_seam(&displayed, &seams.expect("a seam"));
        let is_right = |&(z, is_one): &(f32, bool)| (z - 0.5).abs() < 0.01 || is_one == (z < 0.5);
        assert!(parted.iter().all(is_right), "{parted:?}");
        assert!(parted.iter().any(|p| p.1) && parted.iter().any(|p| !p.1), "{parted:?}");
    }

    #[test]
    fn what_is_coated_and_what_is_not_are_apart() {
        // Light arrives under a coat less what the coat reflects.
        let coated = Material { roughness: 0.0, specular: 1.0, ..grey("coated", 0.5) };
        let (displayed, seams) = seams([grey("dull", 0.5), coated], |_, _| {});
        let parted = seams.map(|seams| on_seam(&displayed, &seams));
        assert!(parted.is_none(), "{parted:?}");
    }

    #[test]
    fn what_is_one_has_the_mean_by_trust_and_the_variance_of_that() {
        let (displayed, seams) = seams([grey("black", 0.1), grey("white", 0.8)], |_, _| {});
        let seams = seams.expect("a seam");
        let count = displayed.mesh.vertices.len();
        let knot = (0..count)
            .find_map(|v| Some((v, (v + 1..count).find(|&w| seams.of[w] == seams.of[v])?)))
            .expect("two that are one");
        let (a, b) = (seams.areas[knot.0], seams.areas[knot.1]);
        let mut trust = vec![1.0; count];
        trust[knot.1] = 3.0;
        let mut values = vec![Rgb::ZERO; count];
        (values[knot.0], values[knot.1]) = (Rgb::splat(1.0), Rgb::splat(2.0));
        let at = seams.of[knot.0] as usize;
        let share = 3.0 * b / (a + 3.0 * b);
        assert!((seams.means(&values, &trust)[at] - (1.0 + share)).abs().max_element() < 1e-5);
        assert!((seams.trust(&trust)[at] - (a + 3.0 * b) / (a + b)).abs() < 1e-5);
        let variance = (1.0 - share) * (1.0 - share) + share * share;
        assert!((seams.variances(&vec![1.0; count], &trust)[at] - variance).abs() < 1e-5);
        assert_eq!(
            seams.parted(&seams.means(&values, &trust))[knot.0],
            seams.parted(&seams.means(&values, &trust))[knot.1]
        );
    }
}
