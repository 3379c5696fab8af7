//! What is refused, and what is said about it.

use super::support::{Builder, box_mesh};
use catoptric_scene::gltf::{LoadOptions, load};
use serde_json::json;

fn refusal(builder: Builder) -> String {
    builder.try_load().map(|loaded| loaded.warnings).expect_err("must be refused").to_string()
}

#[test]
fn all_problems_of_a_file_come_in_one_report_with_names() {
    let mut builder = Builder::new();
    let position = builder.floats(&[0.0, 0.0, 0.0, f32::INFINITY, 0.0, 0.0, 0.0, 1.0, 0.0], "VEC3");
    builder.show("burst", json!({ "attributes": { "POSITION": position } }));
    let node = builder.show_triangle("lost", None);
    builder.json["meshes"][node]["primitives"][0]["material"] = json!(7);
    builder.push("nodes", json!({ "name": "blind", "camera": 3 }));
    builder.push("materials", json!({ "name": "odd", "doubleSided": "yes" }));
    let error = builder.try_load().expect_err("must be refused");
    assert_eq!(error.problems.len(), 4, "{error}");
    let text = error.to_string();
    for part in [
        "surface \"burst\"",
        "vertex 1",
        "surface \"lost\"",
        "node 2 \"blind\"",
        "material 0 \"odd\"",
        "scene.gltf",
    ] {
        assert!(text.contains(part), "{part} is missing in\n{text}");
    }
}

#[test]
fn what_is_farther_off_than_anything_is_refused() {
    for (far, is_refused) in [(1e11, false), (1e13, true)] {
        let mut builder = Builder::new();
        let position = builder.floats(&[0.0, 0.0, 0.0, far, 0.0, 0.0, 0.0, 1.0, 0.0], "VEC3");
        builder.show("burst", json!({ "attributes": { "POSITION": position } }));
        let text = builder.try_load().map_or_else(|error| error.to_string(), |_| String::new());
        assert_eq!(text.contains("vertex 1"), is_refused, "{text}");
    }
}

#[test]
fn what_is_brighter_than_anything_is_refused() {
    for (strength, is_refused) in [(1e14, false), (1e16, true)] {
        let mut builder = Builder::new();
        let lamp = json!({ "KHR_materials_emissive_strength": { "emissiveStrength": strength } });
        let lamp = json!({ "name": "nova", "emissiveFactor": [1, 1, 1], "extensions": lamp });
        let lamp = builder.push("materials", lamp);
        builder.show_triangle("lamp", Some(lamp));
        let text = builder.try_load().map_or_else(|error| error.to_string(), |_| String::new());
        assert_eq!(text.contains("nova") && text.contains("emissiveStrength"), is_refused, "{text}");

        let mut builder = Builder::new();
        let lights = json!({ "lights": [{ "type": "point", "intensity": strength }] });
        builder.json.insert("extensions".to_owned(), json!({ "KHR_lights_punctual": lights }));
        let node = json!({ "name": "star", "extensions": { "KHR_lights_punctual": { "light": 0 } } });
        builder.push("nodes", node);
        builder.show_triangle("ground", None);
        let text = builder.try_load().map_or_else(|error| error.to_string(), |_| String::new());
        assert_eq!(text.contains("star") && text.contains("intensity"), is_refused, "{text}");
    }
}

#[test]
fn a_required_extension_that_cannot_be_read_is_refused_with_what_to_do() {
    for (extension, hint) in [
        ("KHR_draco_mesh_compression", "gltf-transform"),
        ("EXT_meshopt_compression", "gltf-transform"),
        ("KHR_texture_basisu", "ktxdecompress"),
        ("EXT_texture_webp", "png"),
        ("ACME_teapots", "without this extension"),
    ] {
        let mut builder = Builder::new();
        builder.json.insert("extensionsRequired".to_owned(), json!([extension]));
        let text = refusal(builder);
        assert!(text.contains(extension) && text.contains(hint), "{text}");
        let mut builder = Builder::new();
        builder.json.insert("extensionsUsed".to_owned(), json!([extension]));
        let loaded = builder.load();
        assert!(
            loaded.warnings.iter().any(|w| w.message.contains(extension)) || extension.contains("meshopt")
        );
    }
}

#[test]
fn cycles_of_nodes_are_refused() {
    let mut builder = Builder::new();
    builder.push("nodes", json!({ "name": "a", "children": [1] }));
    builder.push("nodes", json!({ "name": "b", "children": [0] }));
    builder.push("scenes", json!({ "nodes": [0] }));
    assert!(refusal(builder).contains("a cycle"));
    let mut builder = Builder::new();
    builder.push("nodes", json!({ "name": "self", "children": [0] }));
    builder.push("scenes", json!({ "nodes": [0] }));
    assert!(refusal(builder).contains("a cycle"));
}

#[test]
fn ranges_that_leave_their_data_are_refused_and_name_the_accessor() {
    type Damage = fn(&mut Builder);
    let damages: [(&str, Damage); 7] = [
        ("count", |b| b.json["accessors"][0]["count"] = json!(4)),
        ("huge count", |b| b.json["accessors"][0]["count"] = json!(1_u64 << 62)),
        ("offset", |b| b.json["accessors"][0]["byteOffset"] = json!(4)),
        ("offset that wraps", |b| b.json["accessors"][0]["byteOffset"] = json!(u64::MAX - 3)),
        ("stride", |b| b.json["bufferViews"][0]["byteStride"] = json!(1_u64 << 61)),
        ("view", |b| b.json["bufferViews"][0]["byteLength"] = json!(1000)),
        ("component type", |b| b.json["accessors"][0]["componentType"] = json!(7)),
    ];
    for (name, damage) in damages {
        let mut builder = Builder::new();
        builder.show_triangle("sample", None);
        damage(&mut builder);
        let text = refusal(builder);
        assert!(text.contains("accessor 0") && text.contains("POSITION"), "{name}: {text}");
    }
}

#[test]
fn an_index_beyond_the_vertices_is_refused() {
    let mut builder = Builder::new();
    let position = builder.floats(&[0.0; 9], "VEC3");
    let indices = builder.indices(&[0, 1, 3]);
    builder.show("sample", json!({ "attributes": { "POSITION": position }, "indices": indices }));
    assert!(refusal(builder).contains("indices below 3, found 3"));
}

#[test]
fn each_limit_stops_a_file_that_exceeds_it() {
    let folder = tempfile::tempdir().unwrap();
    let mut builder = Builder::new();
    let (position, indices) = box_mesh(&mut builder, 1.0, false);
    let inner = builder.show("box", json!({ "attributes": { "POSITION": position }, "indices": indices }));
    let outer = builder.push("nodes", json!({ "children": [inner] }));
    builder.push("scenes", json!({ "nodes": [outer] }));
    let path = builder.write(folder.path());
    let fits = LoadOptions {
        max_triangles: 12,
        max_nodes: 2,
        max_node_depth: 2,
        max_surfaces: 1,
        ..LoadOptions::default()
    };
    assert!(load(&path, &fits).is_ok());
    for tight in [
        LoadOptions { max_triangles: 11, ..fits.clone() },
        LoadOptions { max_nodes: 1, ..fits.clone() },
        LoadOptions { max_node_depth: 1, ..fits.clone() },
        LoadOptions { max_surfaces: 0, ..fits.clone() },
        LoadOptions { max_file_bytes: 100, ..fits.clone() },
        LoadOptions { max_json_memory: 1000, ..fits },
    ] {
        assert!(load(&path, &tight).is_err(), "{tight:?}");
    }
}

#[test]
fn a_huge_count_without_data_costs_nothing() {
    // Accessors without a buffer view are zeros: a few bytes of JSON may ask for 2³² vertices.
    let mut builder = Builder::new();
    let position = builder
        .push("accessors", json!({ "componentType": 5126, "type": "VEC3", "count": 4_294_967_295_u64 }));
    builder.show("void", json!({ "attributes": { "POSITION": position } }));
    assert!(refusal(builder).contains("at most 10000000 triangles"));
    // Within the limit they are still no vertices.
    let mut builder = Builder::new();
    let count = 3 * LoadOptions::default().max_triangles;
    let position =
        builder.push("accessors", json!({ "componentType": 5126, "type": "VEC3", "count": count }));
    builder.show("void", json!({ "attributes": { "POSITION": position } }));
    assert!(builder.load().scene.vertices().is_empty());
}

#[test]
fn deep_and_wide_json_is_refused_before_it_is_built() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("deep.gltf");
    std::fs::write(&path, "[".repeat(1_000_000)).unwrap();
    assert!(load(&path, &LoadOptions::default()).is_err());
    std::fs::write(&path, format!("{{\"a\":[{}{{}}]}}", "{},".repeat(100_000))).unwrap();
    let options = LoadOptions { max_json_memory: 20 << 20, ..LoadOptions::default() };
    assert!(load(&path, &options).unwrap_err().to_string().contains("MiB"));
}
