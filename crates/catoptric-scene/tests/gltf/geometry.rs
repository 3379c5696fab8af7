//! Meshes, accessors and nodes as they come into the scene.

use super::support::{Builder, box_mesh};
use catoptric_scene::{Barycentric, Scene, TriangleId};
use glam::{DVec3, Vec3, Vec4};
use serde_json::json;

const SQUARE: [f32; 12] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0];

fn corners(scene: &Scene) -> Vec<[Vec3; 3]> {
    (0..scene.triangles().len() as u32).map(|i| scene.corners(TriangleId(i))).collect()
}

#[test]
fn strips_alternate_their_winding_and_fans_share_their_first_corner() {
    for (mode, order) in [(5, [0_u32, 1, 2, 3]), (6, [0, 1, 3, 2])] {
        let mut builder = Builder::new();
        let position = builder.floats(&SQUARE, "VEC3");
        let indices = builder.indices(&order);
        builder.show(
            "strip",
            json!({ "attributes": { "POSITION": position }, "indices": indices, "mode": mode }),
        );
        let scene = builder.load().scene;
        assert_eq!(scene.triangles().len(), 2, "mode {mode}");
        for triangle in 0..2 {
            assert_eq!(scene.geometric_normal(TriangleId(triangle)), Vec3::Z, "mode {mode}");
        }
        let area: f32 = (0..2).map(|i| scene.area(TriangleId(i))).sum();
        assert_eq!(area, 1.0, "the two triangles cover the square once");
    }
}

#[test]
fn points_and_lines_are_skipped_with_a_warning() {
    for mode in 0..=3 {
        let mut builder = Builder::new();
        let position = builder.floats(&SQUARE, "VEC3");
        builder.show("wire", json!({ "attributes": { "POSITION": position }, "mode": mode }));
        let loaded = builder.load();
        assert_eq!(loaded.scene.triangles().len(), 0);
        assert!(loaded.warnings.iter().any(|w| w.place.contains("wire") && w.message.contains("skipped")));
    }
}

#[test]
fn a_mirroring_node_keeps_fronts_in_front_and_normals_on_their_side() {
    let mut builder = Builder::new();
    let position = builder.floats(&SQUARE, "VEC3");
    // Tilted normals: the surface is smooth.
    let tilted: Vec<f32> = [0.6, 0.0, 0.8].repeat(4);
    let normal = builder.floats(&tilted, "VEC3");
    let indices = builder.indices(&[0, 1, 2, 2, 1, 3]);
    let attributes = json!({ "POSITION": position, "NORMAL": normal });
    let node = builder.show("mirrored", json!({ "attributes": attributes, "indices": indices }));
    builder.json["nodes"][node]["scale"] = json!([-2.0, 1.0, 1.0]);
    let scene = builder.load().scene;
    assert!(scene.is_smooth(TriangleId(0)));
    for triangle in [TriangleId(0), TriangleId(1)] {
        assert_eq!(scene.geometric_normal(triangle), Vec3::Z);
        let shading = scene.shading_normal(triangle, Barycentric { u: 0.3, v: 0.3 });
        // Inverse transpose: (0.6/−2, 0, 0.8) of length √(0.09 + 0.64); a few f32 roundings.
        let expected = Vec3::new(-0.3, 0.0, 0.8) / 0.73_f32.sqrt();
        assert!((shading - expected).length() < 1e-6, "{shading}");
    }
}

#[test]
fn normals_that_only_round_differently_from_their_faces_leave_a_surface_flat() {
    for (tilt, smooth) in [(1e-4_f32, false), (1e-2, true)] {
        let mut builder = Builder::new();
        let position = builder.floats(&SQUARE, "VEC3");
        let normal = builder.floats(&[tilt, 0.0, 1.0].repeat(4), "VEC3");
        let indices = builder.indices(&[0, 1, 2, 2, 1, 3]);
        let attributes = json!({ "POSITION": position, "NORMAL": normal });
        builder.show("plate", json!({ "attributes": attributes, "indices": indices }));
        assert_eq!(builder.load().scene.is_smooth(TriangleId(0)), smooth, "tilt {tilt}");
    }
}

/// Walls in a mesh of a whole building are flat, however smooth its columns are; a curved mesh is smooth, however finely it is cut.
#[test]
fn triangles_of_a_smooth_mesh_whose_normals_are_their_own_are_flat() {
    let mut builder = Builder::new();
    let arc = |step: f32| [libm::sinf(step), 0.0, libm::cosf(step)];
    // A flat square, and a strip of a barrel of radius 10 m, 2 mm wide: its normals differ from its own by a tenth of a milliradian.
    let (left, right) = (arc(0.0), arc(2e-4));
    let mut positions = SQUARE.to_vec();
    let mut normals = [0.0, 0.0, 1.0].repeat(4);
    for (normal, height) in [(left, 0.0), (left, 1.0), (right, 0.0), (right, 1.0)] {
        positions.extend([10.0 * normal[0] + 3.0, height, 10.0 * normal[2]]);
        normals.extend(normal);
    }
    // What makes the whole mesh smooth.
    positions.extend([5.0, 0.0, 0.0, 6.0, 0.0, 0.0, 5.0, 1.0, 0.0]);
    normals.extend([0.6, 0.0, 0.8].repeat(3));
    let position = builder.floats(&positions, "VEC3");
    let normal = builder.floats(&normals, "VEC3");
    let indices = builder.indices(&[0, 1, 2, 2, 1, 3, 4, 6, 5, 6, 7, 5, 8, 9, 10]);
    builder
        .show("all", json!({ "attributes": { "POSITION": position, "NORMAL": normal }, "indices": indices }));
    let scene = builder.load().scene;
    let smooth: Vec<bool> = (0..5).map(|t| scene.is_smooth(TriangleId(t))).collect();
    assert_eq!(smooth, [false, false, true, true, true]);
    assert_eq!(scene.shading_normal(TriangleId(0), Barycentric { u: 0.2, v: 0.2 }), Vec3::Z);
}

#[test]
fn zero_normals_are_replaced_and_normals_against_the_winding_are_turned() {
    let mut builder = Builder::new();
    let position = builder.floats(&SQUARE, "VEC3");
    let normal = builder.floats(&[0.0, 0.0, 0.0, 0.6, 0.0, 0.8, 0.0, f32::NAN, 0.0, 0.6, 0.0, -0.8], "VEC3");
    let indices = builder.indices(&[0, 1, 2, 2, 1, 3]);
    let attributes = json!({ "POSITION": position, "NORMAL": normal });
    builder.show("plate", json!({ "attributes": attributes, "indices": indices }));
    let loaded = builder.load();
    let normals: Vec<Vec3> = loaded.scene.vertices().iter().map(|vertex| vertex.normal).collect();
    assert_eq!([normals[0], normals[2]], [Vec3::Z, Vec3::Z]);
    assert_eq!(normals[3], -Vec3::new(0.6, 0.0, -0.8).normalize_or_zero());
    assert_eq!(loaded.warnings.iter().filter(|w| w.message.contains("normals")).count(), 2);
}

#[test]
fn quantized_attributes_equal_the_floats_they_stand_for() {
    // Component type, corner coordinates as bytes, normalized, and the factor that glTF gives them.
    let cases: [(u32, Vec<u8>, bool, f32); 6] = [
        (5120, [-127_i8, 0, 64].map(|x| x as u8).to_vec(), true, 1.0 / 127.0),
        (5120, [-127_i8, 0, 64].map(|x| x as u8).to_vec(), false, 1.0),
        (5121, [255_u8, 0, 51].to_vec(), true, 1.0 / 255.0),
        (5122, [-32767_i16, 0, 1000].iter().flat_map(|x| x.to_le_bytes()).collect(), true, 1.0 / 32767.0),
        (5123, [65535_u16, 0, 1000].iter().flat_map(|x| x.to_le_bytes()).collect(), true, 1.0 / 65535.0),
        (5123, [65535_u16, 0, 1000].iter().flat_map(|x| x.to_le_bytes()).collect(), false, 1.0),
    ];
    let numbers = |component: u32| match component {
        5120 => [-127.0, 0.0, 64.0],
        5121 => [255.0, 0.0, 51.0],
        5122 => [-32767.0, 0.0, 1000.0],
        _ => [65535.0, 0.0, 1000.0],
    };
    for (component, element, normalized, factor) in cases {
        // Three corners: (a,b,c), (b,c,a), (c,a,b), each padded to a multiple of four bytes.
        let size = element.len() / 3;
        let stride = element.len().next_multiple_of(4);
        let mut bytes = Vec::new();
        for turn in 0..3 {
            let mut turned = element.clone();
            turned.rotate_left(turn * size);
            turned.resize(stride, 0);
            bytes.extend_from_slice(&turned);
        }
        let mut builder = Builder::new();
        builder.json.insert("extensionsRequired".to_owned(), json!(["KHR_mesh_quantization"]));
        let view = builder.view(&bytes, Some(stride));
        let position = builder.push(
            "accessors",
            json!({ "bufferView": view, "componentType": component, "type": "VEC3", "count": 3, "normalized": normalized }),
        );
        builder.show("quantized", json!({ "attributes": { "POSITION": position } }));
        let scene = builder.load().scene;
        let [a, b, c] = numbers(component).map(|x| x * factor);
        let expected = [Vec3::new(a, b, c), Vec3::new(b, c, a), Vec3::new(c, a, b)];
        for (found, expected) in scene.corners(TriangleId(0)).iter().zip(expected) {
            // Division against multiplication by the rounded reciprocal: one or two roundings.
            assert!(
                (*found - expected).abs().max_element() <= 2.0 * f32::EPSILON * expected.abs().max_element()
            );
        }
    }
}

#[test]
fn vertex_colours_of_all_types_are_shares() {
    let cases: [(u32, &str, Vec<u8>); 4] = [
        (5126, "VEC3", [0.2_f32, 0.4, 1.0].iter().flat_map(|x| x.to_le_bytes()).collect()),
        (5126, "VEC4", [0.2_f32, 0.4, 1.0, 1.0].iter().flat_map(|x| x.to_le_bytes()).collect()),
        (5121, "VEC4", vec![51, 102, 255, 255]),
        (5123, "VEC4", [13107_u16, 26214, 65535, 65535].iter().flat_map(|x| x.to_le_bytes()).collect()),
    ];
    for (component, kind, element) in cases {
        let mut builder = Builder::new();
        let position = builder.floats(&SQUARE[..9], "VEC3");
        let color = builder.accessor(&element.repeat(3), component, kind, 3, component != 5126);
        let material =
            builder.push("materials", json!({ "pbrMetallicRoughness": { "metallicFactor": 0.0 } }));
        let attributes = json!({ "POSITION": position, "COLOR_0": color });
        builder.show("painted", json!({ "attributes": attributes, "material": material }));
        let scene = builder.load().scene;
        assert!((scene.vertices()[0].color - Vec4::new(0.2, 0.4, 1.0, 1.0)).abs().max_element() < 1e-6);
        let point = scene.surface_point(TriangleId(0), Barycentric { u: 0.2, v: 0.2 });
        assert!((point.diffuse - Vec3::new(0.2, 0.4, 1.0)).abs().max_element() < 1e-6, "type {component}");
    }
}

#[test]
fn a_sparse_accessor_without_a_base_starts_from_zeros() {
    let mut builder = Builder::new();
    let indices = builder.view(&[1, 2], None);
    let values: Vec<u8> = [1.0_f32, 0.0, 0.0, 0.0, 1.0, 0.0].iter().flat_map(|x| x.to_le_bytes()).collect();
    let values = builder.view(&values, None);
    let position = builder.push(
        "accessors",
        json!({ "componentType": 5126, "type": "VEC3", "count": 3, "sparse": { "count": 2,
            "indices": { "bufferView": indices, "componentType": 5121 }, "values": { "bufferView": values } } }),
    );
    builder.show("sparse", json!({ "attributes": { "POSITION": position } }));
    assert_eq!(corners(&builder.load().scene), vec![[Vec3::ZERO, Vec3::X, Vec3::Y]]);
}

#[test]
fn an_instanced_mesh_is_flattened_and_every_surface_has_its_own_name() {
    let mut builder = Builder::new();
    let position = builder.floats(&SQUARE[..9], "VEC3");
    let primitive = json!({ "attributes": { "POSITION": position } });
    let mesh = builder.push("meshes", json!({ "primitives": [primitive, primitive] }));
    for x in [0, 5, 9] {
        builder.push("nodes", json!({ "mesh": mesh, "name": "twin", "translation": [x, 0, 0] }));
    }
    let single = builder.push("meshes", json!({ "primitives": [primitive] }));
    builder.push("nodes", json!({ "mesh": single, "translation": [0, 7, 0] }));
    let scene = builder.load().scene;
    let names: Vec<&str> = scene.surfaces().iter().map(|surface| surface.name.as_str()).collect();
    // The second primitive lies exactly on the first and is dropped with its surface.
    assert_eq!(names, ["twin/0", "twin/0 (2)", "twin/0 (3)", "node 3"]);
    assert_eq!(scene.corners(TriangleId(1))[0], Vec3::new(5.0, 0.0, 0.0));
}

#[test]
fn gpu_instances_stand_where_their_attributes_say() {
    let mut builder = Builder::new();
    let position = builder.floats(&SQUARE[..9], "VEC3");
    let translation = builder.floats(&[0.0, 0.0, 1.0, 0.0, 0.0, 2.0], "VEC3");
    let node = builder.show("grid", json!({ "attributes": { "POSITION": position } }));
    builder.json["nodes"][node]["extensions"] =
        json!({ "EXT_mesh_gpu_instancing": { "attributes": { "TRANSLATION": translation } } });
    builder.json["nodes"][node]["scale"] = json!([1, 1, 3]);
    let scene = builder.load().scene;
    assert_eq!(corners(&scene).iter().map(|c| c[0].z).collect::<Vec<_>>(), [3.0, 6.0]);
}

#[test]
fn flat_and_repeated_triangles_are_dropped_but_two_sides_of_a_sheet_stay() {
    let mut builder = Builder::new();
    let position = builder.floats(&SQUARE, "VEC3");
    // The same triangle turned, its back, and one without area.
    let indices = builder.indices(&[0, 1, 2, 1, 2, 0, 0, 2, 1, 0, 0, 1]);
    builder.show("sheet", json!({ "attributes": { "POSITION": position }, "indices": indices }));
    let loaded = builder.load();
    assert_eq!(loaded.scene.triangles().len(), 2);
    let said =
        |what: &str| loaded.warnings.iter().any(|w| w.message.starts_with('1') && w.message.contains(what));
    assert!(said("no area") && said("lie exactly on others"), "{:?}", loaded.warnings);
}

#[test]
fn morph_targets_and_skins_are_applied_at_rest() {
    let mut builder = Builder::new();
    let position = builder.floats(&SQUARE[..9], "VEC3");
    let up = builder.floats(&[0.0, 0.0, 4.0].repeat(3), "VEC3");
    let joints = builder.accessor(&[0, 0, 0, 0].repeat(3), 5121, "VEC4", 3, false);
    let weights = builder.floats(&[1.0, 0.0, 0.0, 0.0].repeat(3), "VEC4");
    let attributes = json!({ "POSITION": position, "JOINTS_0": joints, "WEIGHTS_0": weights });
    let node = builder.show("body", json!({ "attributes": attributes, "targets": [{ "POSITION": up }] }));
    builder.json["meshes"][0]["weights"] = json!([0.5]);
    let joint = builder.push("nodes", json!({ "translation": [10, 0, 0] }));
    let skin = builder.push("skins", json!({ "joints": [joint] }));
    builder.json["nodes"][node]["skin"] = json!(skin);
    // glTF: the transform of a skinned mesh's own node does not matter.
    builder.json["nodes"][node]["translation"] = json!([0, 99, 0]);
    assert_eq!(builder.load().scene.corners(TriangleId(0))[0], Vec3::new(10.0, 0.0, 2.0));
}

#[test]
fn glass_that_is_open_inverted_or_nested_is_reported_and_sound_glass_is_not() {
    let load = |bodies: &[(f32, bool, usize)]| {
        let mut builder = Builder::new();
        let extensions = json!({ "KHR_materials_transmission": { "transmissionFactor": 1 },
            "KHR_materials_volume": { "thicknessFactor": 1 } });
        let glass = json!({ "pbrMetallicRoughness": { "metallicFactor": 0, "roughnessFactor": 0 }, "extensions": extensions });
        let material = builder.push("materials", glass);
        for &(half, inverted, missing) in bodies {
            let (position, indices) = box_mesh(&mut builder, half, inverted);
            builder.json["accessors"][indices]["count"] = json!(36 - 3 * missing);
            let attributes = json!({ "POSITION": position });
            builder
                .show("glass", json!({ "attributes": attributes, "indices": indices, "material": material }));
        }
        builder.load().warnings.into_iter().map(|w| w.message).collect::<Vec<_>>().join("\n")
    };
    assert_eq!(load(&[(1.0, false, 0)]), "", "a closed box");
    assert_eq!(load(&[(1.0, false, 0), (0.5, true, 0)]), "", "a box with a cavity");
    assert!(load(&[(1.0, false, 1)]).contains("not closed (3 open edges)"));
    assert!(load(&[(1.0, true, 0)]).contains("inside out"));
    assert!(load(&[(1.0, false, 0), (0.5, false, 0)]).contains("inside of"));
}

/// Thirty kilometres off, f32 positions are two millimetres apart: a square of a metre, its lamp and its cameras keep their shape to the
/// last bit, and the scene knows where it lies.
#[test]
fn what_is_far_from_the_origin_is_read_about_a_point_of_its_own() {
    let far = [1000.3, 200.7, -30_000.1];
    let scenes = [[0.0; 3], far].map(|place| {
        let mut builder = Builder::new();
        let position = builder.floats(&SQUARE, "VEC3");
        let indices = builder.indices(&[0, 1, 2, 2, 1, 3]);
        let square =
            builder.show("square", json!({ "attributes": { "POSITION": position }, "indices": indices }));
        let perspective = json!({ "yfov": 1, "znear": 0.1 });
        builder.push("cameras", json!({ "type": "perspective", "perspective": perspective }));
        let eye = builder.push("nodes", json!({ "name": "eye", "camera": 0, "translation": [0.5, 0.5, 3] }));
        let rail = builder.push("nodes", json!({ "name": "rail", "children": [eye] }));
        builder.push("extensionsUsed", json!("KHR_lights_punctual"));
        let lights = json!({ "KHR_lights_punctual": { "lights": [{ "type": "point" }] } });
        builder.json.insert("extensions".to_owned(), lights);
        let lamp = builder.push(
            "nodes",
            json!({ "translation": [0.5, 2, 1], "extensions": { "KHR_lights_punctual": { "light": 0 } } }),
        );
        let all = json!({ "children": [square, rail, lamp], "translation": place });
        let all = builder.push("nodes", all);
        builder.json.insert("scenes".to_owned(), json!([{ "nodes": [all] }]));
        builder.slide(rail);
        builder.load()
    });
    let [near, far] = scenes.each_ref().map(|loaded| &loaded.scene);
    assert_eq!(near.origin(), DVec3::ZERO);
    let offset = (DVec3::from_array([1000.3, 200.7, -30_000.1]) - far.origin()).as_vec3();
    // Half of the origin's step, about a diagonal, on each axis.
    assert!(offset.abs().max_element() <= 1.0, "{offset}");
    let close = |a: Vec3, b: Vec3| assert!(a.distance(b) < 5e-7, "{a} {b}");
    for (here, there) in corners(near).iter().flatten().zip(corners(far).iter().flatten()) {
        close(*here + offset, *there);
    }
    close(near.lights()[0].position + offset, far.lights()[0].position);
    for seconds in [0.0, 1.0, 2.0] {
        let [here, there] =
            scenes.each_ref().map(|loaded| loaded.cameras.at(seconds)[0].world_from_camera.translation);
        close(Vec3::from(here) + offset, there.into());
    }
    let [here, there] = [near, far].map(|scene| scene.cameras()[0].world_from_camera.translation);
    close(Vec3::from(here) + offset, there.into());
}
