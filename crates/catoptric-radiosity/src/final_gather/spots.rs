//! Small bright places on diffuse surfaces: the inside of a lamp's shade, a wall beside a bulb. None of the rays of a gather and of
//! those beside may have met them, and the guide that these make does not know them. What sources and the coarse solution tell does.

use std::f32::consts::PI;

use glam::Vec3;

use catoptric_light::Receiver;
use catoptric_scene::Rgb;
use catoptric_trace::sequence::{Key, frame, hemisphere_point};
use catoptric_trace::{PlaneId, Tracer};

use crate::guide::Hints;
use crate::patch::PatchMesh;

use super::Sight;

/// Times the mean radiance of the scene from which on a place is bright.
const BRIGHT: f32 = 8.0;
/// Spots at most: those that are most noise to see.
const MOST_SPOTS: usize = 256;
/// Share of the variance that is known from which on they are worth a look.
const MINOR: f32 = 0.1;
/// Rays from each gather that look which of them are seen. A desk lamp's indirect light: squared error × 1.4 with 4, × 1.1 with 16.
const LOOKS: f32 = 8.0;

/// A base triangle that is bright.
#[derive(Clone, Copy, Debug)]
struct Spot {
    position: Vec3,
    normal: Vec3,
    area: f32,
    /// Channels added.
    radiance: f32,
    plane: PlaneId,
}

impl Spot {
    const NONE: Self =
        Self { position: Vec3::ZERO, normal: Vec3::ZERO, area: 0.0, radiance: 0.0, plane: PlaneId::NONE };
}

/// The bright places of a scene.
#[derive(Clone, Debug, Default)]
pub(super) struct Spots(Vec<Spot>);

impl Spots {
    /// Where `irradiance` per vertex of what gathers look at makes patches bright.
    pub(super) fn new(tracer: &Tracer, sight: &Sight, patches: &PatchMesh, irradiance: &[Rgb]) -> Self {
        let displayed = sight.displayed;
        let mut roots = vec![Spot::NONE; patches.of_root.len()];
        let (mut sum, mut whole) = (0.0_f64, 0.0_f64);
        for (index, element) in displayed.mesh.elements.iter().enumerate() {
            let root = displayed.roots[index] as usize;
            let corners = element.vertices.map(|v| &displayed.mesh.vertices[v as usize]);
            let area = displayed.mesh.area(index as u32);
            let received = element.vertices.iter().map(|&v| irradiance[v as usize]).sum::<Rgb>() / 3.0;
            let sent = received * patches.reflectances[patches.of_root[root].0 as usize];
            let radiance = sent.element_sum().max(0.0) / PI;
            let spot = &mut roots[root];
            spot.position += corners.iter().map(|c| c.position).sum::<Vec3>() * (area / 3.0);
            spot.normal += corners.iter().map(|c| c.normal).sum::<Vec3>() * area;
            spot.area += area;
            spot.radiance += radiance * area;
            spot.plane = tracer.planes().of(corners[0].triangle);
            // A field of large triangles must not decide what is bright in the house.
            let counted = f64::from(area.min(sight.draft.most_weight));
            sum += f64::from(radiance) * counted;
            whole += counted;
        }
        let mean = if whole > 0.0 { (sum / whole) as f32 } else { 0.0 };
        let means = roots.into_iter().filter(|spot| spot.area > 0.0).map(|spot| Spot {
            position: spot.position / spot.area,
            normal: spot.normal.normalize_or_zero(),
            radiance: spot.radiance / spot.area,
            ..spot
        });
        let mut bright: Vec<Spot> =
            means.filter(|spot| spot.radiance > BRIGHT * mean && mean > 0.0).collect();
        let noise = |spot: &Spot| spot.radiance * spot.radiance * spot.area;
        bright.sort_by(|a, b| noise(b).total_cmp(&noise(a)));
        bright.truncate(MOST_SPOTS);
        Self(bright)
    }

    /// Where in the hemisphere they are seen, if they add much to the variance of a ray that is `known`.
    pub(super) fn seen_from(&self, tracer: &Tracer, receiver: &Receiver, known: f32, key: Key) -> Hints {
        let mut hints = Hints::default();
        if self.0.is_empty() {
            return hints;
        }
        // By what each adds to the variance of one ray.
        let noise = |spot: &Spot| {
            let way = spot.position - receiver.position;
            let distance = way.length_squared();
            let cosines = way.dot(receiver.normal).max(0.0) * (-way.dot(spot.normal)).max(0.0);
            // No more than half of the view: seen from so near, the centre does not stand for the rest.
            let share = (cosines * spot.area / (PI * distance * distance).max(f32::MIN_POSITIVE)).min(0.5);
            spot.radiance * spot.radiance * share
        };
        let mut sums = [0.0; MOST_SPOTS];
        let mut total = 0.0_f32;
        for (sum, spot) in sums.iter_mut().zip(&self.0) {
            total += noise(spot);
            *sum = total;
        }
        if total <= MINOR * known || total <= 0.0 {
            return hints;
        }
        let (tangent, bitangent) = frame(receiver.normal);
        let each = total / LOOKS;
        let mut next = key.uniform(0) * each;
        for (spot, sum) in self.0.iter().zip(sums) {
            let looks = ((sum - next) / each).ceil().max(0.0);
            if looks < 1.0 {
                continue;
            }
            next += looks * each;
            let seen = tracer.visibility(receiver.position, receiver.plane, spot.position, spot.plane);
            if seen != Rgb::ZERO {
                let way = (spot.position - receiver.position).normalize_or_zero();
                let local = Vec3::new(way.dot(tangent), way.dot(bitangent), way.dot(receiver.normal));
                hints.add(hemisphere_point(local), looks * each * seen.max_element());
            }
        }
        hints
    }
}

#[cfg(test)]
mod tests {
    use catoptric_scene::{Barycentric, Material, Scene, SceneParts, Side, TriangleId};
    use catoptric_trace::sequence::Purpose;

    use crate::gather::Gathered;
    use crate::guide::{Findings, Guide};

    use super::*;

    #[test]
    fn spots_that_are_seen_and_no_others_draw_rays() {
        let mut parts = SceneParts::default();
        let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
        parts.add_quad("floor", white, Vec3::ZERO, Vec3::Z * 4.0, Vec3::X * 4.0);
        // A screen in the middle, a metre high.
        parts.add_quad("screen", white, Vec3::new(2.0, 0.0, 4.0), Vec3::Z * -4.0, Vec3::Y);
        let scene = Scene::new(parts).expect("a valid scene");
        let tracer = Tracer::new(&scene);
        let receiver = Receiver::on(&tracer, TriangleId(0), Side::Front, Barycentric { u: 0.1, v: 0.1 });
        assert!(receiver.position.x < 2.0 && receiver.normal == Vec3::Y);
        let spot = |position: Vec3, normal: Vec3| Spot {
            position,
            normal,
            area: 1e-3,
            radiance: 100.0,
            plane: PlaneId::NONE,
        };
        let over = spot(receiver.position + Vec3::new(0.5, 1.5, 0.2), Vec3::NEG_Y);
        let behind = spot(Vec3::new(3.5, 0.3, receiver.position.z), Vec3::NEG_X);
        let turned = spot(over.position, Vec3::Y);
        let key = Key::new(1, Purpose::Test, 0);
        let guide = |spots: Vec<Spot>, known: f32| {
            let hints = Spots(spots).seen_from(&tracer, &receiver, known, key);
            Guide::new(&Findings::default(), &hints, Gathered::default())
        };
        let deviation = |spots: Vec<Spot>| guide(spots, 0.0).even_deviation();
        assert_eq!(deviation(vec![behind]), 0.0);
        assert_eq!(deviation(vec![turned]), 0.0);
        // One ray of all finds 100 with the probability of the form factor.
        let way = over.position - receiver.position;
        let share = way.y * way.y * over.area / (PI * way.length_squared().powi(2));
        let exact = 100.0 * share.sqrt();
        assert!((deviation(vec![over]) / exact - 1.0).abs() < 1e-4, "{} {exact}", deviation(vec![over]));
        // Half of the looks at two alike are at either.
        let all = deviation(vec![over, turned, spot(over.position, Vec3::NEG_Y)]);
        assert!((all / exact / std::f32::consts::SQRT_2 - 1.0).abs() < 1e-4);
        assert_eq!(guide(vec![over], 11.0 * exact * exact).even_deviation(), 0.0);
        // More rays than elsewhere go there.
        let (tangent, bitangent) = frame(receiver.normal);
        let unit = way.normalize_or_zero();
        let local = Vec3::new(unit.dot(tangent), unit.dot(bitangent), unit.y);
        let guide = guide(vec![over], 0.0);
        let to_spot = (0..256).map(|index| guide.warp(key.point2(index))).filter(|(point, share)| {
            let is_near = (*point - hemisphere_point(local)).length() < 0.18;
            assert!(*share > 0.0);
            is_near && *share < 0.1
        });
        // Half of all rays follow the hints.
        assert!((to_spot.count() as f32 / 256.0 - 0.5).abs() < 0.05);
    }
}
