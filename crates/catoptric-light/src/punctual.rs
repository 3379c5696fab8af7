//! Irradiance by punctual lights, straight and over image chains, with hard shadows.

use glam::DVec3;

use catoptric_scene::{PunctualKind, PunctualLight, Rgb};
use catoptric_trace::{PlaneId, walk};

use crate::irradiance::{Lights, Scratch};
use crate::receiver::Receiver;

impl Lights<'_> {
    /// Irradiance by all punctual lights: straight, or over images.
    pub fn punctual(&self, receiver: &Receiver, scratch: &mut Scratch) -> PunctualIrradiance {
        let mut result = PunctualIrradiance::default();
        let lights = self.tracer().scene().lights();
        if lights.is_empty() {
            return result;
        }
        let position = receiver.position.as_dvec3();
        let (normal, geometric) = (receiver.normal.as_dvec3(), receiver.geometric.as_dvec3());
        for (number, light) in lights.iter().enumerate() {
            let arriving = self.unoccluded(light, position, normal, geometric);
            if let Some((irradiance, target, cos)) = arriving {
                let visible = self.tracer().visibility(
                    receiver.position,
                    receiver.plane,
                    target.as_vec3(),
                    PlaneId::NONE,
                );
                result.direct += irradiance * visible * receiver.coat.transmittance(cos);
            }
            for chain in self.chains().of_punctual(number, position) {
                let Some(image) = self.chains().unfold(chain, position, normal, geometric) else { continue };
                let arriving = self.unoccluded(light, image.position, image.normal, image.geometric);
                let Some((irradiance, target, cos)) = arriving else { continue };
                self.chains().targets(chain, target, &mut scratch.targets);
                let share = walk::follow(
                    self.tracer(),
                    receiver.position,
                    receiver.plane,
                    &chain.planes,
                    &scratch.targets,
                    PlaneId::NONE,
                );
                result.mirrored += irradiance * share * receiver.coat.transmittance(cos);
            }
        }
        result
    }

    /// Irradiance before visibility, the light's position and the cosine at the receiver.
    fn unoccluded(
        &self,
        light: &PunctualLight,
        position: DVec3,
        normal: DVec3,
        geometric: DVec3,
    ) -> Option<(Rgb, DVec3, f32)> {
        let (target, falloff) = match light.kind {
            PunctualKind::Directional => {
                let far = f64::from(self.far());
                (position - light.direction.as_dvec3() * far, 1.0)
            }
            PunctualKind::Point
            | PunctualKind::Spot { .. }
            | PunctualKind::Lobe { .. }
            | PunctualKind::Photometric { .. } => {
                let target = light.position.as_dvec3();
                (target, 1.0 / (target - position).length_squared().max(1e-12))
            }
        };
        let towards = (target - position).normalize_or_zero();
        let cos = normal.dot(towards);
        if cos <= 0.0 || geometric.dot(towards) <= 0.0 {
            return None;
        }
        let intensity = light.intensity_towards((-towards).as_vec3());
        let irradiance = intensity * (cos * falloff) as f32;
        (irradiance.max_element() > 0.0).then_some((irradiance, target, cos as f32))
    }
}

/// Irradiance by punctual lights.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PunctualIrradiance {
    /// Straight, or through panes.
    pub direct: Rgb,
    /// Over planar mirrors.
    pub mirrored: Rgb,
}

#[cfg(test)]
mod tests {
    use catoptric_scene::{Material, Scene, SceneParts};
    use catoptric_trace::interaction::Coat;
    use catoptric_trace::sequence::{Key, Purpose};
    use catoptric_trace::{MediumStack, Tracer};
    use glam::Vec3;

    use crate::LightParams;

    use super::*;

    /// Two mirrors that face each other, one of them in two pieces, a third across, a sheet that reflects on both sides and has a light on its upper edge, and lights of every kind.
    fn hall() -> Scene {
        let mut parts = SceneParts::default();
        let silver = parts.add_material(Material::mirror("silver", Rgb::splat(0.95)));
        let sheet = Material { double_sided: true, ..Material::mirror("sheet", Rgb::splat(0.9)) };
        let sheet = parts.add_material(sheet);
        parts.add_quad("left", silver, Vec3::new(-1.0, 0.2, 0.8), Vec3::Z * -0.7, Vec3::Y);
        parts.add_quad("left", silver, Vec3::new(-1.0, 0.2, -0.1), Vec3::Z * -0.7, Vec3::Y);
        parts.add_quad("right", silver, Vec3::new(1.0, 0.3, -0.5), Vec3::Z, Vec3::Y * 0.8);
        parts.add_quad("back", silver, Vec3::new(-0.9, 0.0, -1.0), Vec3::X * 1.6, Vec3::Y);
        parts.add_quad(
            "sheet",
            sheet,
            Vec3::new(-0.2, 0.5, 0.2),
            Vec3::X * 0.5,
            Vec3::Y * 0.4 + Vec3::Z * 0.2,
        );
        let spot = PunctualKind::Spot { cos_inner: 0.97, cos_outer: 0.9 };
        let kinds =
            [PunctualKind::Point, spot, PunctualKind::Directional, PunctualKind::Lobe { exponent: 2.0 }];
        for (index, kind) in (0_u8..).zip(kinds) {
            let x = 0.2 * f32::from(index) - 0.4;
            let direction = Vec3::new(-0.8 + 3.0 * x, -0.3, -0.5).normalize_or_zero();
            let position = Vec3::new(x, 0.9, 0.4);
            parts.lights.push(PunctualLight {
                name: String::new(),
                position,
                direction,
                intensity: Rgb::ONE,
                kind,
            });
        }
        Scene::new(parts).expect("a valid scene")
    }

    /// What is left out because it arrives elsewhere brings nothing: the same bits as by asking for all lights over all chains.
    #[test]
    fn lights_are_asked_for_where_they_arrive_alone() {
        let scene = hall();
        let tracer = Tracer::new(&scene);
        let lights = Lights::new(&tracer, LightParams::default());
        let (mut scratch, mut lit, mut asked) = (Scratch::default(), 0, 0);
        let (places, chains) = (4000, lights.chains().chains().len());
        for place in 0..places {
            let key = Key::new(6, Purpose::Test, place);
            let at = |k: u32| key.child(k).point2(0) * 2.0 - 1.0;
            let position = Vec3::new(at(0).x * 0.95, 0.5 + 0.5 * at(1).x, at(0).y * 0.95);
            let normal = Vec3::new(at(2).x, at(1).y, at(2).y).normalize_or(Vec3::Y);
            let (plane, coat, media) = (PlaneId::NONE, Coat::NONE, MediumStack::AIR);
            let receiver = Receiver { position, plane, normal, geometric: normal, coat, media };
            let found = lights.punctual(&receiver, &mut scratch).mirrored;

            let mut all = Rgb::ZERO;
            let (point, normal) = (position.as_dvec3(), normal.as_dvec3());
            for (number, light) in scene.lights().iter().enumerate() {
                asked += lights.chains().of_punctual(number, point).count();
                for chain in lights.chains().chains() {
                    let Some(image) = lights.chains().unfold(chain, point, normal, normal) else { continue };
                    let arriving = lights.unoccluded(light, image.position, image.normal, image.geometric);
                    let Some((irradiance, target, _)) = arriving else { continue };
                    lights.chains().targets(chain, target, &mut scratch.targets);
                    let targets = &scratch.targets;
                    let (planes, none) = (&chain.planes, PlaneId::NONE);
                    all += irradiance * walk::follow(&tracer, position, none, planes, targets, none);
                }
            }
            assert_eq!(found, all, "{position}");
            lit += usize::from(found != Rgb::ZERO);
        }
        // Of the places many are lit, and few of the ways to them are asked for.
        assert!(5 * lit > places as usize, "{lit}");
        let pairs = places as usize * scene.lights().len() * chains;
        assert!(4 * asked < pairs, "{asked} of {pairs}");
    }
}
