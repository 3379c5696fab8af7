//! Where the display mesh is too coarse for a view: the light of sources bends within elements that are wider than a pixel.
//!
//! Refinement in pass one follows shadows to a size, whoever looks. A view comes as close as it likes. What a linear interpolant
//! misses is measured by how much its gradient differs from element to element, and how far that goes, in pixels: where that is too
//! much, the light is evaluated at the pixel, by the function that pass one had it from.

use std::f32::consts::PI;

use glam::Vec3;
use rayon::prelude::*;

use catoptric_scene::Rgb;
use catoptric_scene::quantity::LUMINANCE;
use catoptric_solution::{DisplayMesh, Element, Located, Solution, Term};
use catoptric_trace::walk::split::Seen;

use crate::direct::Wanted;
use crate::lines::Footprint;
use crate::needs::DARK;

/// Bends below this share of the light there are left to the mesh: they are smooth to the eye, and noise is no shadow.
const LEAST_BEND: f32 = 0.1;
/// Bends above this count as this: all of the light.
const MOST_BEND: f32 = 1.0;
/// Beside what bends, the fit of pass one overshoots, by less: vertices there have this share of it.
const BESIDE: f32 = 0.5;
/// Bends times their widths, in pixels, up to which the mesh is fine enough, …
const FINE: f32 = 0.5;
/// … and from which on nothing is read from it. Between the two it is a little of both, so that no border is seen. (By measurement, against
/// 1 and 1.2: no teeth at the edges of shadows, showcase closer by 3 % of FLIP and an eighth of the squared error; images take up to a third longer,
/// that of ring_caustic 1.7 times as long.)
const COARSE: f32 = 0.6;
/// Branches of less throughput show nothing of it.
const FAINT: f32 = 0.05;
/// The terms that are evaluated.
const TERMS: [Term; 2] = [Term::Direct, Term::Mirrored];

/// What the mesh does not show of the light of sources, and who looks.
#[derive(Clone, Debug)]
pub(crate) struct Resolution {
    /// Per vertex of the display mesh, of each term: relative bend of the light of sources times its width, metres.
    blurred: Vec<[f32; 2]>,
    /// How wide a pixel in the middle of the view is.
    pixel: Footprint,
}

impl Resolution {
    /// Looks at every element.
    pub(crate) fn of(solution: &Solution, pixel: Footprint) -> Self {
        let mesh = &solution.mesh;
        let luminance = |values: &[Rgb], v: usize| values.get(v).map_or(0.0, |light| light.dot(LUMINANCE));
        let light: Vec<Light> = (0..mesh.vertices.len())
            .into_par_iter()
            .with_min_len(4096)
            .map(|v| Light {
                sent: TERMS.map(|term| {
                    let known = solution.gathered.get(term.index()).map_or(0.0, |known| luminance(known, v));
                    luminance(&solution.irradiance[term.index()], v) - known
                }),
                all: solution.irradiance.iter().map(|values| luminance(values, v)).sum(),
            })
            .collect();
        Self { blurred: blurred(mesh, &light), pixel }
    }

    /// How far apart pixels are where something is seen, across the ray, metres. Planar mirrors keep that, curved ones do not.
    pub(crate) fn pixel_at(&self, seen: &Seen) -> f32 {
        self.pixel.width + self.pixel.spread * seen.distance
    }

    /// What is to be evaluated at a place, where the mesh holds so much direct and mirrored light: what it is too coarse for, and those terms that
    /// are `everywhere`.
    #[inline]
    pub(crate) fn wanted(
        &self,
        at: &Located,
        [known, mirrored]: [Rgb; 2],
        seen: &Seen,
        everywhere: [bool; 2],
    ) -> Wanted {
        let corners = at.vertices.map(|v| self.blurred[v as usize]);
        if everywhere == [false; 2] && corners == [[0.0; 2]; 3] || seen.throughput.max_element() < FAINT {
            return Wanted::NOTHING;
        }
        // What glows shows no shadows.
        let most = (known + mirrored).dot(LUMINANCE) * (seen.interaction.receives / PI);
        if most < LEAST_BEND * seen.interaction.emission.0.dot(LUMINANCE) {
            return Wanted::NOTHING;
        }
        let pixel = self.pixel_at(seen);
        let [direct, mirrored] = [0, 1].map(|term| {
            if everywhere[term] {
                return 1.0;
            }
            let [a, b, c] = corners.map(|blurred| blurred[term]);
            let blurred = a * at.weights[0] + b * at.weights[1] + c * at.weights[2];
            let way = ((blurred - FINE * pixel) / ((COARSE - FINE) * pixel)).clamp(0.0, 1.0);
            way * way * (3.0 - 2.0 * way)
        });
        Wanted { direct, mirrored, known }
    }
}

/// Luminous irradiance of a vertex.
#[derive(Clone, Copy, Debug)]
struct Light {
    /// What sources send, by term.
    sent: [f32; 2],
    /// All.
    all: f32,
}

/// Per vertex: how much the terms bend in the elements around it, relative to all light there, times the width of that.
fn blurred(mesh: &DisplayMesh, light: &[Light]) -> Vec<[f32; 2]> {
    let slopes: Vec<Slope> =
        mesh.elements.par_iter().with_min_len(4096).map(|element| Slope::of(mesh, element, light)).collect();
    // One after the other: sums are the same for any number of threads.
    let mut around = vec![Slope::default(); mesh.vertices.len()];
    let (mut sum, mut area) = (0.0_f64, 0.0_f64);
    for (element, slope) in mesh.elements.iter().zip(&slopes) {
        for v in element.vertices.map(|v| v as usize) {
            around[v].add(slope);
            sum += f64::from(slope.area * light[v].all);
            area += f64::from(slope.area);
        }
    }
    let floor = (f64::from(DARK) * sum / area.max(f64::MIN_POSITIVE)) as f32;
    let bends: Vec<[[f32; 2]; 3]> = mesh
        .elements
        .par_iter()
        .zip(&slopes)
        .with_min_len(4096)
        .map(|(element, slope)| {
            let corners = element.vertices.map(|v| mesh.vertices[v as usize].position);
            element.vertices.map(|v| {
                let light = light[v as usize].all + floor;
                let mean = &around[v as usize];
                [0, 1].map(|term| {
                    let bend =
                        slope.gradients[term] - mean.gradients[term] / mean.area.max(f32::MIN_POSITIVE);
                    let along = bend.normalize_or_zero();
                    let [p, q, r] = corners.map(|c| c.dot(along));
                    let width = p.max(q).max(r) - p.min(q).min(r);
                    let relative = bend.length() * width / light.max(f32::MIN_POSITIVE);
                    (relative.min(MOST_BEND) - LEAST_BEND).max(0.0) * width
                })
            })
        })
        .collect();
    let mut own = vec![[0.0_f32; 2]; mesh.vertices.len()];
    let widen = |all: &mut [[f32; 2]], v: u32, value: [f32; 2]| {
        let all = &mut all[v as usize];
        *all = [all[0].max(value[0]), all[1].max(value[1])];
    };
    for (element, bends) in mesh.elements.iter().zip(bends) {
        for (v, bend) in element.vertices.into_iter().zip(bends) {
            widen(&mut own, v, bend);
        }
    }
    let mut blurred = own.clone();
    for element in &mesh.elements {
        let [a, b, c] = element.vertices.map(|v| own[v as usize]);
        let most = [0, 1].map(|term| BESIDE * a[term].max(b[term]).max(c[term]));
        if most != [0.0; 2] {
            element.vertices.iter().for_each(|&v| widen(&mut blurred, v, most));
        }
    }
    blurred
}

/// How the terms change along an element, or along those around a vertex: then gradients are weighted by area.
#[derive(Clone, Copy, Debug, Default)]
struct Slope {
    /// In the plane of the element, per metre.
    gradients: [Vec3; 2],
    /// m².
    area: f32,
}

impl Slope {
    fn of(mesh: &DisplayMesh, element: &Element, light: &[Light]) -> Self {
        let [a, b, c] = element.vertices.map(|v| mesh.vertices[v as usize].position);
        let [p, q, r] = element.vertices.map(|v| light[v as usize].sent);
        let normal = (b - a).cross(c - a);
        let square = normal.length_squared();
        if square <= 0.0 {
            return Self::default();
        }
        let gradient =
            |term: usize| normal.cross((c - b) * p[term] + (a - c) * q[term] + (b - a) * r[term]) / square;
        Self { gradients: [gradient(0), gradient(1)], area: 0.5 * square.sqrt() }
    }

    fn add(&mut self, other: &Self) {
        for (sum, gradient) in self.gradients.iter_mut().zip(other.gradients) {
            *sum += gradient * other.area;
        }
        self.area += other.area;
    }
}

#[cfg(test)]
mod tests {
    use catoptric_scene::{Side, TriangleId};
    use catoptric_solution::{DisplayVertex, Face, FaceId};

    use super::*;

    /// A strip of squares of 1 m, halved: columns of vertices at x = 0, 1, …, with so much direct light in each.
    fn strip(direct: &[f32]) -> Solution {
        let vertex = |x: usize, y: usize| DisplayVertex {
            position: Vec3::new(x as f32, y as f32, 0.0),
            normal: Vec3::Z,
            triangle: TriangleId(0),
            side: Side::Front,
        };
        let vertices: Vec<DisplayVertex> =
            (0..direct.len()).flat_map(|x| [vertex(x, 0), vertex(x, 1)]).collect();
        let elements: Vec<Element> = (0..direct.len() as u32 - 1)
            .flat_map(|x| [[2 * x, 2 * x + 2, 2 * x + 1], [2 * x + 1, 2 * x + 2, 2 * x + 3]])
            .map(|vertices| Element { vertices })
            .collect();
        let face = Face { elements: 0..elements.len() as u32, origin: Vec3::ZERO, axes: [Vec3::X, Vec3::Y] };
        let face_of = [vec![FaceId(0)], vec![FaceId::NONE]];
        let values: Vec<Rgb> = direct.iter().flat_map(|&light| [Rgb::splat(light); 2]).collect();
        let dark = vec![Rgb::ZERO; values.len()];
        Solution {
            mesh: DisplayMesh::new(vertices, elements, vec![face], face_of),
            irradiance: [values, dark.clone(), dark.clone(), vec![Rgb::ONE; dark.len()]],
            ..Solution::default()
        }
    }

    /// Blur of the direct light along the strip, metres.
    fn along(solution: &Solution) -> Vec<f32> {
        let pixel = Footprint { width: 1.0, spread: 0.0 };
        Resolution::of(solution, pixel).blurred.iter().step_by(2).map(|blurred| blurred[0]).collect()
    }

    #[test]
    fn what_is_linear_is_fine_at_any_width() {
        assert_eq!(along(&strip(&[0.0, 1.0, 2.0, 3.0, 4.0])), [0.0; 5]);
    }

    #[test]
    fn a_shadows_edge_is_as_wide_as_its_element_and_fades_beside() {
        let blurred = along(&strip(&[9.0, 9.0, 9.0, 9.0, 0.0, 0.0, 0.0, 0.0]));
        // Around its ends gradients are 0 and 9 per metre, their mean is between: bends of more than all light there (1 of other light
        // and a tenth of the mean, in the dark) count as 1, less the tenth that is left alone.
        assert!((blurred[4] - 0.9).abs() < 1e-6, "{blurred:?}");
        assert!(blurred[3] > 0.3 && blurred[3] < 0.6, "{blurred:?}");
        for (beside, end) in [(2, 3), (5, 4)] {
            assert!((blurred[beside] - BESIDE * blurred[end]).abs() < 1e-6, "{blurred:?}");
        }
        assert_eq!([blurred[0], blurred[1], blurred[6], blurred[7]], [0.0; 4]);
    }

    #[test]
    fn what_no_source_sends_is_left_to_the_mesh() {
        let mut solution = strip(&[9.0, 9.0, 9.0, 0.0, 0.0, 0.0]);
        solution.gathered[0] = solution.irradiance[Term::Direct.index()].clone();
        assert_eq!(along(&solution), [0.0; 6]);
    }
}
