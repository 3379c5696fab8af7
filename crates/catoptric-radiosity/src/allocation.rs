//! How many rays each gather gets.

use catoptric_solution::DisplayMesh;

use crate::display::Displayed;
use crate::draft::Draft;
use crate::guide::Guide;
use crate::solve::SolveParams;

/// Share of the prior that hidden vertices keep, so that the fit stays regular where everything is hidden.
pub(crate) const HIDDEN_TRUST: f32 = 1e-3;
/// Rays of a gather at a vertex, at least.
const MIN_VERTEX_RAYS: u32 = 16;

/// Rays of each vertex, and how much the fit trusts them. Where the author's tessellation is finer than the base mesh,
/// vertices share their neighbours' rays: they get them in proportion to the area around, and count by the rays per area
/// that they have seen, compared with the samples inside. Vertices of refined triangles stand near other surfaces, where
/// light bends: they only hold the fit. `whole`: area of a base triangle.
pub(crate) fn vertex_budgets(
    draft: &Draft,
    displayed: &Displayed,
    hidden: &[bool],
    params: &SolveParams,
    whole: f32,
) -> (Vec<u32>, Vec<f32>) {
    let mesh = &displayed.mesh;
    let mut refined = vec![false; mesh.vertices.len()];
    for element in 0..mesh.elements.len() {
        if is_refined(draft, displayed, element, whole) {
            for v in mesh.elements[element].vertices {
                refined[v as usize] = true;
            }
        }
    }
    let area = areas_around(mesh);
    let inside = params.gather_points * params.gather_rays as f32 / whole;
    (0..mesh.vertices.len())
        .map(|v| {
            // Beside each other, those of refined triangles are many: the noise of each is spread over less area.
            let whole_share = (area[v] / (0.25 * whole)).min(1.0);
            let share = if refined[v] { whole_share.sqrt() } else { whole_share };
            let least = MIN_VERTEX_RAYS.min(params.vertex_rays);
            let rays = power_of_two(params.vertex_rays as f32 * share).clamp(least, params.vertex_rays);
            let density = rays as f32 / area[v].max(f32::MIN_POSITIVE);
            let trust = if hidden[displayed.origin[v] as usize] {
                HIDDEN_TRUST
            } else if refined[v] {
                1.0
            } else {
                (density / inside).clamp(1.0, 40.0)
            };
            (rays, trust)
        })
        .unzip()
}

/// Whether an element is small because surfaces are near: it was split, or on a flat face it leads from short contact lines to the
/// lattice, of whose triangles `whole` is the area.
pub(crate) fn is_refined(draft: &Draft, displayed: &Displayed, element: usize, whole: f32) -> bool {
    let leaf = &draft.leaves[displayed.leaves[element] as usize];
    leaf.level > 0
        || !draft.faces[leaf.face as usize].curved && displayed.mesh.area(element as u32) < GRADED * whole
}

/// Share of a lattice triangle's area below which elements of flat faces are as those of refined ones. (At a quarter: 1 to 2 % more time, the
/// same errors.)
const GRADED: f32 = 0.1;

/// A third of the area of the elements around each vertex.
pub(crate) fn areas_around(mesh: &DisplayMesh) -> Vec<f32> {
    let mut area = vec![0.0_f32; mesh.vertices.len()];
    for element in 0..mesh.elements.len() {
        let third = mesh.area(element as u32) / 3.0;
        for v in mesh.elements[element].vertices {
            area[v as usize] += third;
        }
    }
    area
}

/// The power of two that is nearest by ratio: whole strata of the sequence.
fn power_of_two(count: f32) -> u32 {
    ((count * std::f32::consts::FRAC_1_SQRT_2).ceil().max(1.0) as u32).next_power_of_two()
}

/// Deviation of guided rays, relative to all light, at which a gather has the usual number of rays in a scene where all
/// deviate as much.
const USUAL_DEVIATION: f32 = 0.4;
/// From a quarter of the usual number to sixteen times as many.
const LEAST_STEP: i32 = -2;
const GREATEST_STEP: i32 = 4;

/// How rays are shared out among the gathers of a scene.
///
/// In proportion to the relative deviation: for a given sum of rays that makes the mean squared relative error least (the
/// allocation of Neyman 1934). The sum follows the mean deviation of the scene, so that this error is the same in each.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Allocation {
    mean: f32,
}

impl Allocation {
    /// For gathers whose rays deviate by so much, relative to all light, weighted by the area that they stand for. Those that look at
    /// nothing but the sky, of which they need not ask, leave their rays to the others.
    pub(crate) fn new(deviations: impl Iterator<Item = (f32, f32)>) -> Self {
        let (mut sum, mut area) = (0.0_f64, 0.0_f64);
        for (deviation, weight) in deviations.filter(|d| d.0 > 0.0) {
            sum += f64::from(deviation) * f64::from(weight);
            area += f64::from(weight);
        }
        Self { mean: if area > 0.0 { (sum / area) as f32 } else { 0.0 } }
    }

    /// Rays of a gather in steps of two, which keep the strata of the sequence whole.
    pub(crate) fn rays(self, usual: u32, deviation: f32) -> u32 {
        let times = deviation * self.mean / (USUAL_DEVIATION * USUAL_DEVIATION);
        let greatest = (GREATEST_STEP - LEAST_STEP) as u32;
        let least = usual.div_ceil(1 << -LEAST_STEP);
        let steps = (0..greatest)
            .filter(|&step| times >= std::f32::consts::SQRT_2 * 2.0_f32.powi(step as i32 + LEAST_STEP))
            .count();
        least << steps
    }
}

/// Deviation that a guide expects, relative to all light at a place: `other` light, which is known without rays, hides errors
/// of what they find.
pub(crate) fn relative_deviation(guide: &Guide, other: f32) -> f32 {
    guide.deviation() / (guide.mean() + other / std::f32::consts::PI).max(f32::MIN_POSITIVE)
}

#[cfg(test)]
mod tests {
    use catoptric_scene::{Material, Rgb, Scene, SceneParts};
    use catoptric_trace::Tracer;
    use glam::Vec3;

    use super::*;

    #[test]
    fn rays_follow_the_deviation_in_steps_of_two() {
        let usual = Allocation { mean: USUAL_DEVIATION };
        let rays = |times: f32| usual.rays(128, USUAL_DEVIATION * times);
        assert_eq!([0.0, 0.3, 0.5, 1.0, 2.0, 9.0, 100.0].map(rays), [32, 32, 64, 128, 256, 1024, 2048]);
    }

    /// Round a ring on a floor the elements of the base mesh are small because the ring is near: they are as those of triangles that
    /// were split for it, and not as an author's fine mesh, whose vertices share their rays and are trusted together.
    #[test]
    fn elements_that_lead_from_short_lines_are_refined_ones() {
        let mut parts = SceneParts::default();
        let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
        parts.add_quad("floor", white, Vec3::new(-2.0, 0.0, 2.0), Vec3::X * 4.0, Vec3::Z * -4.0);
        let corner = |k: u16| {
            let (sin, cos) = libm::sincosf(f32::from(k) / 64.0 * std::f32::consts::TAU);
            Vec3::new(0.3 * cos, 0.0, 0.3 * sin)
        };
        for k in 0..64 {
            parts.add_quad("ring", white, corner(k), corner(k + 1) - corner(k), Vec3::Y * 0.2);
        }
        let scene = Scene::new(parts).expect("a valid scene");
        let tracer = Tracer::new(&scene);
        let draft = Draft::new(&tracer, 0.5);
        let displayed = draft.display(&tracer);
        let whole = 0.5 * 0.5 * 0.5;
        let hidden = vec![false; draft.vertices.len()];
        let params = SolveParams::for_quality(catoptric_solution::Quality::Standard);
        let (rays, trust) = vertex_budgets(&draft, &displayed, &hidden, &params, whole);
        let places = displayed.mesh.vertices.iter().map(|v| v.position);
        let beside: Vec<usize> = places
            .zip(0..)
            .filter(|(p, _)| p.y == 0.0 && (p.length() - 0.3).abs() < 0.01)
            .map(|p| p.1)
            .collect();
        assert!(beside.len() >= 64);
        assert!(beside.iter().all(|&i| trust[i] == 1.0 && rays[i] >= MIN_VERTEX_RAYS));
        assert!((0..displayed.mesh.elements.len()).any(|e| !is_refined(&draft, &displayed, e, whole)));
    }

    #[test]
    fn noisier_scenes_get_more_rays_all_over() {
        let of = |deviation: f32| Allocation::new([(deviation, 1.0), (2.0 * deviation, 0.5)].into_iter());
        let [calm, noisy] = [0.3, 0.6].map(|deviation| of(deviation).rays(128, deviation));
        assert_eq!(noisy, 4 * calm);
        assert_eq!(Allocation::new(std::iter::empty()).rays(128, 1.0), 32);
    }
}
