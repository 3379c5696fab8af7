//! KHR_lights_punctual.

use std::sync::Arc;

use glam::{DMat4, DVec3};
use serde_json::{Value, json};

use crate::light::{PunctualKind, PunctualLight};
use crate::photometry::Photometry;
use crate::quantity::Rgb;
use crate::scene::BRIGHTEST;

use super::asset::Asset;
use super::document::{Entity, Table};
use super::node::Hierarchy;
use super::report::Report;

const EXTENSION: &str = "KHR_lights_punctual";
pub(super) const EXTRAS: &str = "catoptric";

/// Puts the texts of photometric files into the extras of the lights (or of the lights of the nodes) that they are for.
pub(super) fn embed_photometry(asset: &mut Asset, photometry: &[(String, String)], report: &Report) {
    for (name, text) in photometry {
        let of_node = asset.json.get("nodes").and_then(Value::as_array).and_then(|nodes| {
            let node = nodes.iter().find(|n| n["name"] == **name && !n["extensions"][EXTENSION].is_null())?;
            node["extensions"][EXTENSION]["light"].as_u64()
        });
        let extension = asset.json.get_mut("extensions").and_then(|e| e.get_mut(EXTENSION));
        let lights = extension.and_then(|e| e.get_mut("lights")).and_then(Value::as_array_mut);
        let lights = lights.map_or(&mut [][..], Vec::as_mut_slice);
        let by_name = lights.iter().position(|light| light["name"] == **name);
        let chosen = of_node.and_then(|index| usize::try_from(index).ok()).or(by_name);
        let Some(Value::Object(light)) = chosen.and_then(|index| lights.get_mut(index)) else {
            let names: Vec<&str> = lights.iter().filter_map(|light| light["name"].as_str()).collect();
            let found = format!("none; lights: {}", names.join(", "));
            report.problem(format!("light {name:?}"), "a punctual light of this name", found, "");
            continue;
        };
        let extras = light.entry("extras").or_insert_with(|| json!({}));
        if !extras.is_object() {
            *extras = json!({});
        }
        extras[EXTRAS] = json!({ "ies": text });
    }
}

/// The distribution that extras give a light: `lobe`, an exponent, or `ies`, the text of a photometric file.
fn distribution(
    own: &Entity,
    place: &str,
    kind: PunctualKind,
    color: Rgb,
    intensity: Rgb,
    world: DMat4,
    report: &Report,
) -> Option<(PunctualKind, Rgb)> {
    if own.raw("lobe").is_some() {
        let exponent = own.number_or("lobe", 1.0, report);
        if !(exponent >= 0.0 && exponent.is_finite()) {
            report.problem(place, "a lobe's exponent of at least 0", exponent, "");
            return None;
        }
        return Some((PunctualKind::Lobe { exponent }, intensity));
    }
    let Some(text) = own.string("ies", report) else { return Some((kind, intensity)) };
    match Photometry::parse(text) {
        Ok(table) => {
            let across = world.transform_vector3(DVec3::X).normalize_or(DVec3::X).as_vec3();
            let intensity = color * table.peak();
            Some((PunctualKind::Photometric { table: Arc::new(table), across }, intensity))
        }
        Err(error) => {
            report.problem(place, "the text of an IES LM-63 file", error, "");
            None
        }
    }
}

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
        if strength < 0.0 || intensity.max_element() > BRIGHTEST {
            let expected = format_args!("an intensity from 0 to {BRIGHTEST:e}");
            report.problem(&place, expected, strength, "correct its intensity");
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
        let own = light.object("extras", report).and_then(|extras| extras.object(EXTRAS, report));
        let (kind, intensity) = match own {
            Some(own) => match distribution(&own, &place, kind, color, intensity, node.world, report) {
                Some(distribution) => distribution,
                None => continue,
            },
            None => (kind, intensity),
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
