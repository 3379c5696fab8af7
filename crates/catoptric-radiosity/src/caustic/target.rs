//! Where light is sent: the specular geometry, in pieces small enough that one importance serves each.

use glam::Vec3;

use catoptric_light::Lights;
use catoptric_scene::{Barycentric, Material, TriangleId};
use catoptric_trace::{MediumId, Tracer};

use crate::curve::on_curve;

/// A triangle of the specular geometry, or a part of one.
#[derive(Clone, Copy, Debug)]
pub(super) struct Target {
    pub(super) triangle: TriangleId,
    /// Its corners in the triangle.
    corners: [(f32, f32); 3],
    /// Which quarter of which quarter of the triangle it is: two bits for each halving of edges, …
    quarter: u32,
    /// … of which there were so many.
    depth: u32,
    pub(super) center: Vec3,
    pub(super) radius: f32,
    /// Unit normal of the front.
    pub(super) normal: Vec3,
    pub(super) area: f32,
    pub(super) sides: Sides,
    /// Share of the power that it deviates, roughly: for importance only.
    pub(super) strength: f32,
}

/// From where a target acts on light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Sides {
    Front,
    Both,
    /// A border of glass: from its inside only for light that is there.
    Solid(MediumId),
}

/// Parts have at most this share of the specular area.
const LARGEST_SHARE: f32 = 1.0 / 1024.0;
/// Share that coats and panes reflect over the hemisphere, about: importance only.
const WEAK_STRENGTH: f32 = 0.1;

impl Target {
    /// The point of barycentric coordinates (u, v) of this part.
    #[inline]
    pub(super) fn at(&self, u: f32, v: f32) -> Barycentric {
        let [a, b, c] = self.corners;
        let w = 1.0 - u - v;
        Barycentric { u: a.0 * w + b.0 * u + c.0 * v, v: a.1 * w + b.1 * u + c.1 * v }
    }

    /// Upper bound of the cosine at the target towards a ball, zero only where no point of either sees the other.
    #[inline]
    pub(super) fn cosine_bound(&self, center: Vec3, radius: f32, medium: MediumId) -> f32 {
        let offset = center - self.center;
        let distance = offset.length().max(f32::MIN_POSITIVE);
        let height = self.normal.dot(offset) / distance;
        let height = match self.sides {
            Sides::Front => height,
            Sides::Both => height.abs(),
            Sides::Solid(inside) if inside == medium => -height,
            Sides::Solid(_) => height,
        };
        (height + radius / distance).clamp(0.0, 1.0)
    }
}

/// Which part of the specular geometry a place on it belongs to.
#[derive(Clone, Debug, Default)]
pub(super) struct Places {
    /// Triangles, ascending: how often their edges are halved, and where their parts begin.
    triangles: Vec<(TriangleId, u32, u32)>,
    /// Parts, triangle by triangle, by their quarters.
    parts: Vec<u32>,
}

impl Places {
    pub(super) fn new(targets: &[Target]) -> Self {
        let mut parts: Vec<u32> = (0..targets.len() as u32).collect();
        parts.sort_unstable_by_key(|&part| {
            let target = &targets[part as usize];
            (target.triangle.0, target.quarter)
        });
        let mut triangles: Vec<(TriangleId, u32, u32)> = Vec::new();
        for (start, &part) in (0..).zip(&parts) {
            let target = &targets[part as usize];
            if triangles.last().is_none_or(|last| last.0 != target.triangle) {
                triangles.push((target.triangle, target.depth, start));
            }
        }
        Self { triangles, parts }
    }

    /// The part, by its index in the list, that holds a place on a triangle, if this is specular.
    pub(super) fn part(&self, triangle: TriangleId, at: Barycentric) -> Option<usize> {
        let index = self.triangles.binary_search_by_key(&triangle.0, |t| t.0.0).ok()?;
        let (_, depth, start) = self.triangles[index];
        let mut weights = [1.0 - at.u - at.v, at.u, at.v];
        let mut quarter = 0;
        for _ in 0..depth {
            let corner = weights.iter().position(|&w| w >= 0.5);
            // Weights of the quarter's own corners, in the order in which it lists them.
            weights = weights.map(|w| 2.0 * w);
            match corner {
                Some(corner) => weights[corner] -= 1.0,
                None => weights = [1.0 - weights[2], 1.0 - weights[0], 1.0 - weights[1]],
            }
            quarter = 4 * quarter + corner.unwrap_or(3) as u32;
        }
        self.parts.get((start + quarter) as usize).map(|&part| part as usize)
    }
}

/// All parts of the specular geometry along a space-filling curve; none if nothing is curved or refracting and all chains of mirrors are listed.
pub(super) fn collect(lights: &Lights) -> Vec<Target> {
    let tracer = lights.tracer();
    let scene = tracer.scene();
    let deviates = |m: &Material| {
        let smooth = m.may_be_specular();
        let only_alpha = m.transmission <= 0.0
            && m.clearcoat <= 0.0
            && m.metallic <= 0.0
            && m.specular <= 0.0
            && m.metallic_roughness_texture.is_none();
        smooth && !only_alpha
    };
    let specular: Vec<TriangleId> = (0..scene.triangles().len() as u32)
        .map(TriangleId)
        .filter(|&t| deviates(scene.material_of(t)))
        .collect();
    let bends = |t: TriangleId| scene.material_of(t).is_solid() || tracer.image_plane(t).is_none();
    if !specular.iter().any(|&t| bends(t)) && !lights.chains().are_cut_short() {
        return Vec::new();
    }
    let total: f64 = specular.iter().map(|&t| f64::from(scene.area(t))).sum();
    let largest = total as f32 * LARGEST_SHARE;
    let mut targets = Vec::with_capacity(specular.len());
    for triangle in specular {
        let material = scene.material_of(triangle);
        let (sides, strength) = if material.is_solid() {
            (Sides::Solid(MediumId::inside(scene.material_id_of(triangle))), 1.0)
        } else {
            let sides = if tracer.has_back(triangle) { Sides::Both } else { Sides::Front };
            (sides, if material.metallic > 0.0 { 1.0 } else { WEAK_STRENGTH })
        };
        let whole = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)];
        push_parts(
            tracer,
            &mut targets,
            triangle,
            (whole, 0, 0),
            scene.area(triangle),
            largest,
            sides,
            strength,
        );
    }
    // Neighbours in the list are neighbours in space, so that a stratum of the list is one.
    targets.sort_by_cached_key(|target| on_curve(tracer, target.center));
    targets
}

fn push_parts(
    tracer: &Tracer,
    targets: &mut Vec<Target>,
    triangle: TriangleId,
    (corners, quarter, depth): ([(f32, f32); 3], u32, u32),
    area: f32,
    largest: f32,
    sides: Sides,
    strength: f32,
) {
    let scene = tracer.scene();
    let [a, b, c] = corners;
    if area > largest {
        let middle = |p: (f32, f32), q: (f32, f32)| (0.5 * (p.0 + q.0), 0.5 * (p.1 + q.1));
        let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
        for (part, number) in [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]].into_iter().zip(0..) {
            let part = (part, 4 * quarter + number, depth + 1);
            push_parts(tracer, targets, triangle, part, 0.25 * area, largest, sides, strength);
        }
        return;
    }
    let [p, q, r] = corners.map(|(u, v)| scene.position(triangle, Barycentric { u, v }));
    let center = (p + q + r) / 3.0;
    let radius = (p - center).length().max((q - center).length()).max((r - center).length());
    let normal = scene.geometric_normal(triangle);
    targets.push(Target { triangle, corners, quarter, depth, center, radius, normal, area, sides, strength });
}

#[cfg(test)]
mod tests {
    use catoptric_light::LightParams;
    use catoptric_scene::{Radiance, Rgb, Scene, SceneParts};
    use catoptric_trace::sequence::{Key, Purpose, triangle_point};

    use super::*;

    #[test]
    fn each_part_holds_its_own_places() {
        let mut parts = SceneParts::default();
        let mirror = parts.add_material(Material::mirror("mirror", Rgb::ONE));
        let glowing = parts.add_material(Material::emitter("lamp", Radiance(Rgb::ONE)));
        parts.add_sphere("ball", mirror, Vec3::ZERO, 0.1, 8);
        parts.add_quad("sheet", mirror, Vec3::new(-1.0, -1.0, 0.0), Vec3::X * 2.0, Vec3::Y * 2.0);
        parts.add_quad("lamp", glowing, Vec3::Y * 3.0, Vec3::X, Vec3::Z);
        let scene = Scene::new(parts).expect("a valid scene");
        let tracer = Tracer::new(&scene);
        let targets = collect(&Lights::new(&tracer, LightParams::default()));
        let places = Places::new(&targets);
        assert!(targets.iter().any(|t| t.depth > 3), "{}", targets.len());
        for (index, target) in targets.iter().enumerate() {
            let key = Key::new(2, Purpose::Test, index as u64);
            for sample in 0..4 {
                let (u, v) = triangle_point(key.point2(sample) * 0.98 + 0.01);
                assert_eq!(places.part(target.triangle, target.at(u, v)), Some(index), "{target:?}");
            }
        }
        let lamp = scene.triangles().len() as u32 - 1;
        assert_eq!(places.part(TriangleId(lamp), Barycentric { u: 0.2, v: 0.2 }), None);
    }
}
