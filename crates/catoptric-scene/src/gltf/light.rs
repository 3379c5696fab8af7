//! KHR_lights_punctual.

use glam::DVec3;

use crate::light::{PunctualKind, PunctualLight};
use crate::quantity::Rgb;

use super::asset::Asset;
use super::document::Table;
use super::node::Hierarchy;
use super::report::Report;

const EXTENSION: &str = "KHR_lights_punctual";

/// The lights of all visible nodes, in world space.
pub(super) fn read_lights(asset: &Asset, hierarchy: &Hierarchy, report: &Report) -> Vec<PunctualLight> {
    let root = asset.root();
    let table = root.extension(EXTENSION, report).map(|e| e.objects("lights", report)).unwrap_or_default();
    let mut lights = Vec::new();
    for node in hierarchy.nodes.iter().filter(|node| node.visible) {
        let Some(entity) = root.element(Table::NODES, node.index, report) else { continue };
        let Some(index) = entity.extension(EXTENSION, report).and_then(|e| e.index("light", report)) else {
            continue;
        };
        let Some(light) = table.get(index) else {
            let found = format!("a reference to light {index} of {}", table.len());
            report.problem(entity.place(), "an existing light", found, "");
            continue;
        };
        let place = format!("light {index} of {}", entity.place());
        let color = light.numbers::<3>("color", report).unwrap_or([1.0; 3]);
        let color = Rgb::from_array(color.map(|x| x as f32)).max(Rgb::ZERO);
        let strength = light.number_or("intensity", 1.0, report);
        let intensity = color * strength.max(0.0);
        if strength < 0.0 || !intensity.is_finite() {
            report.problem(&place, "a finite intensity of at least 0", strength, "");
            continue;
        }
        let kind = match light.string("type", report) {
            Some("point") => PunctualKind::Point,
            Some("directional") => PunctualKind::Directional,
            Some("spot") => {
                let spot = light.object("spot", report);
                let angle = |key: &str, default: f32| {
                    spot.map_or(default, |spot| spot.number_or(key, default, report))
                        .clamp(0.0, std::f32::consts::FRAC_PI_2)
                };
                let inner = angle("innerConeAngle", 0.0);
                let outer = angle("outerConeAngle", std::f32::consts::FRAC_PI_4);
                if inner > outer {
                    report.warn(&place, "its inner cone is wider than its outer one");
                }
                PunctualKind::Spot { cos_inner: libm::cosf(inner.min(outer)), cos_outer: libm::cosf(outer) }
            }
            other => {
                let found = other.unwrap_or("none");
                report.problem(&place, "type \"point\", \"spot\" or \"directional\"", found, "");
                continue;
            }
        };
        if light.raw("range").is_some() {
            report.warn(&place, "its range is ignored: light does not end");
        }
        let direction = node.world.transform_vector3(DVec3::NEG_Z).try_normalize();
        let (position, direction) = (node.world.w_axis.truncate().as_vec3(), direction.map(|d| d.as_vec3()));
        if !position.is_finite() || (direction.is_none() && kind != PunctualKind::Point) {
            report.problem(&place, "a position and a direction", "a node scaled to nothing or infinity", "");
            continue;
        }
        let direction = direction.unwrap_or(glam::Vec3::NEG_Z);
        lights.push(PunctualLight { name: node.name.clone(), position, direction, intensity, kind });
    }
    lights
}
