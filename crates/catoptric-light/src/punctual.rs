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
        let mut seen = std::mem::take(&mut scratch.chains);
        self.chains().seen_from(position, geometric, &mut seen);
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
            for chain in seen.iter().map(|&index| &self.chains().chains()[index as usize]) {
                if !chain.may_reach_from(number, position) {
                    continue;
                }
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
        scratch.chains = seen;
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
