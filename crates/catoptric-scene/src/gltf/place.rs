//! Adding cameras and lights where a scene has them in world space.

use glam::{Mat4, Quat, Vec3};
use serde_json::{Value, json};

use crate::camera::{Camera, Projection};
use crate::light::{PunctualKind, PunctualLight};

use super::asset::Asset;

const LIGHTS: &str = "KHR_lights_punctual";
/// glTF asks for a near plane above 0 and, of parallel projections, for a far one.
const NEAREST: f32 = 1e-3;
const FARTHEST: f32 = 1e4;

impl Asset {
    /// Adds a camera and a node that places it; returns the node's index.
    pub fn append_camera(&mut self, camera: &Camera) -> usize {
        self.mark_source();
        let near = camera.near.max(NEAREST);
        let described = match camera.projection {
            Projection::Perspective { yfov } => {
                let mut perspective = json!({ "yfov": yfov, "znear": near });
                if let Some(aspect) = camera.aspect {
                    perspective["aspectRatio"] = json!(aspect);
                }
                json!({ "name": camera.name, "type": "perspective", "perspective": perspective })
            }
            Projection::Orthographic { xmag, ymag } => json!({
                "name": camera.name,
                "type": "orthographic",
                "orthographic": { "xmag": xmag, "ymag": ymag, "znear": near, "zfar": near + FARTHEST },
            }),
        };
        let index = self.push("cameras", described);
        let matrix = Mat4::from(camera.world_from_camera).to_cols_array();
        self.push("nodes", json!({ "name": camera.name, "camera": index, "matrix": matrix }))
    }

    /// Adds a punctual light and a node that places it; returns the node's index.
    pub fn append_light(&mut self, light: &PunctualLight) -> usize {
        self.mark_source();
        let strength = light.intensity.max_element();
        let color = if strength > 0.0 { light.intensity / strength } else { Vec3::ONE };
        let mut described = json!({ "name": light.name, "color": color.to_array(), "intensity": strength });
        described["type"] = json!(match light.kind {
            PunctualKind::Point | PunctualKind::Lobe { .. } | PunctualKind::Photometric { .. } => "point",
            PunctualKind::Directional => "directional",
            PunctualKind::Spot { .. } => "spot",
        });
        if let PunctualKind::Lobe { exponent } = light.kind {
            described["extras"] = json!({ "catoptric": { "lobe": exponent } });
        }
        if let PunctualKind::Spot { cos_inner, cos_outer } = light.kind {
            let outer = libm::acosf(cos_outer).clamp(1e-3, std::f32::consts::FRAC_PI_2);
            let inner = libm::acosf(cos_inner).clamp(0.0, outer - 1e-4);
            described["spot"] = json!({ "innerConeAngle": inner, "outerConeAngle": outer });
        }
        self.use_extension(LIGHTS);
        let index = self.push_light(described);
        let turn =
            Quat::from_rotation_arc(Vec3::NEG_Z, light.direction.try_normalize().unwrap_or(Vec3::NEG_Z));
        let node = json!({
            "name": light.name,
            "translation": light.position.to_array(),
            "rotation": turn.normalize().to_array(),
            "extensions": { LIGHTS: { "light": index } },
        });
        self.push("nodes", node)
    }

    /// Number of lights in the light table.
    pub(super) fn lights_len(&self) -> usize {
        let extension = self.json.get("extensions").and_then(|extensions| extensions.get(LIGHTS));
        extension.and_then(|extension| extension.get("lights")?.as_array()).map_or(0, Vec::len)
    }

    /// Takes out the lights behind the first `count`.
    pub(super) fn truncate_lights(&mut self, count: usize) {
        let extension = self.json.get_mut("extensions").and_then(|extensions| extensions.get_mut(LIGHTS));
        if let Some(Value::Array(lights)) = extension.and_then(|extension| extension.get_mut("lights")) {
            lights.truncate(count);
        }
    }

    /// Adds to the light table in the root's extension; returns the light's index.
    fn push_light(&mut self, light: Value) -> usize {
        let extensions = self.json.entry("extensions").or_insert(Value::Null);
        if !extensions.is_object() {
            *extensions = json!({});
        }
        if !extensions[LIGHTS].is_object() {
            extensions[LIGHTS] = json!({});
        }
        let lights = &mut extensions[LIGHTS]["lights"];
        let mut table = lights.as_array().cloned().unwrap_or_default();
        table.push(light);
        let index = table.len() - 1;
        *lights = Value::Array(table);
        index
    }
}
