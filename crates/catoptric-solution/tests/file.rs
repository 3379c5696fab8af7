//! Solutions saved and read again.

use std::path::Path;

use catoptric_scene::gltf::{Asset, LoadOptions, Loaded, load};
use catoptric_scene::{Radiance, Rgb, Scene, SceneHash, Side, Sky, SkyImage, TriangleId};
use catoptric_solution::file::{FileError, read, save};
use catoptric_solution::{DisplayMesh, DisplayVertex, Element, Face, FaceId, PatchRadiosity, Solution};
use glam::Vec3;
use serde_json::json;

/// A double-sided floor, a lamp that reflects, a mirror: six triangles, two materials with display elements.
fn loaded(folder: &Path) -> Loaded {
    loaded_at(folder, [0; 3])
}

/// The same somewhere else, metres.
fn loaded_at(folder: &Path, place: [i32; 3]) -> Loaded {
    let corners: [[f32; 3]; 4] = [[-1.0, 0.0, -1.0], [-1.0, 0.0, 1.0], [1.0, 0.0, 1.0], [1.0, 0.0, -1.0]];
    let mut bytes: Vec<u8> = corners.iter().flatten().flat_map(|x| x.to_le_bytes()).collect();
    bytes.extend([0_u32, 1, 2, 0, 2, 3].iter().flat_map(|i| i.to_le_bytes()));
    std::fs::write(folder.join("quad.bin"), &bytes).expect("a folder to write to");
    let quad = |material: u32| json!({ "primitives": [{ "attributes": { "POSITION": 0 }, "indices": 1, "material": material }] });
    let mut scene = json!({
        "asset": { "version": "2.0" },
        "extensionsUsed": ["KHR_lights_punctual"],
        "extensions": { "KHR_lights_punctual": { "lights": [{ "type": "spot", "spot": {} }] } },
        "scenes": [{ "nodes": [0, 1, 2, 3, 4] }],
        "nodes": [
            { "mesh": 0 },
            { "mesh": 1, "translation": [0, 1, 0] },
            { "mesh": 2, "translation": [0, 2, 0] },
            { "camera": 0, "translation": [0, 0, 5] },
            { "extensions": { "KHR_lights_punctual": { "light": 0 } } },
        ],
        "cameras": [{ "type": "orthographic", "orthographic": { "xmag": 2, "ymag": 1, "znear": 0, "zfar": 9 } }],
        "meshes": [quad(0), quad(1), quad(2)],
        "materials": [
            { "name": "floor", "doubleSided": true, "pbrMetallicRoughness": { "metallicFactor": 0 } },
            { "name": "lamp", "emissiveFactor": [1, 1, 1], "pbrMetallicRoughness": { "metallicFactor": 0 } },
            { "name": "mirror", "pbrMetallicRoughness": { "roughnessFactor": 0 } },
        ],
        "buffers": [{ "uri": "quad.bin", "byteLength": bytes.len() }],
        "bufferViews": [
            { "buffer": 0, "byteLength": 48 },
            { "buffer": 0, "byteOffset": 48, "byteLength": 24 },
        ],
        "accessors": [
            {
                "bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3",
                "min": [-1, 0, -1], "max": [1, 0, 1],
            },
            { "bufferView": 1, "componentType": 5125, "count": 6, "type": "SCALAR" },
        ],
    });
    if place != [0; 3]
        && let Some(nodes) = scene["nodes"].as_array_mut()
    {
        nodes.push(json!({ "children": [0, 1, 2, 3, 4], "translation": place }));
        scene["scenes"] = json!([{ "nodes": [5] }]);
    }
    let path = folder.join("scene.gltf");
    std::fs::write(&path, scene.to_string()).expect("a folder to write to");
    load(&path, &LoadOptions::default()).expect("a valid file")
}

/// One element per diffuse triangle and side, with values that text or rounding would lose.
fn solution(scene: &Scene) -> Solution {
    let mut vertices = Vec::new();
    let mut elements = Vec::new();
    let mut faces = Vec::new();
    let mut face_of = [vec![FaceId::NONE; 6], vec![FaceId::NONE; 6]];
    for (triangle, side) in [(0, Side::Front), (1, Side::Front), (0, Side::Back), (2, Side::Front)] {
        let first = vertices.len() as u32;
        let id = TriangleId(triangle);
        let normal = side.orient(scene.geometric_normal(id));
        vertices.extend(scene.corners(id).map(|position| DisplayVertex {
            position,
            normal,
            triangle: id,
            side,
        }));
        face_of[side.index()][triangle as usize] = FaceId(faces.len() as u32);
        let start = elements.len() as u32;
        elements.push(Element { vertices: [first, first + 1, first + 2] });
        let origin = scene.corners(id)[0];
        let axes = [Vec3::X, Vec3::NEG_Z];
        faces.push(Face { elements: start..start + 1, origin, axes });
    }
    let odd = [0.1, 1.0 / 3.0, f32::MIN_POSITIVE, 1e-42, -0.0, 16_777_217.0, 3.4e38, 1e-7];
    let values = |seed: usize| -> Vec<Rgb> {
        (0..vertices.len())
            .map(|i| Rgb::from([0, 1, 2].map(|c| odd[(seed + 3 * i + c) % odd.len()])))
            .collect()
    };
    Solution {
        irradiance: [values(0), values(1), values(2), values(3)],
        gathered: [Vec::new(), values(5)],
        punctual: values(4),
        mesh: DisplayMesh::new(vertices, elements, faces, face_of),
        patches: PatchRadiosity {
            areas: vec![2.0, 0.3],
            centers: vec![[0.1, 0.2, 0.3], [1.0, 2.0, 3.0]],
            radiosity: vec![[1e-42, 0.7, 5.0], [0.0, -0.0, 1.0]],
        },
        scene_hash: scene.hash(),
        settings: [("quality".to_owned(), "a \"text\" with ü".to_owned())].into(),
    }
}

fn written(asset: Asset, scene: &Scene, solution: &Solution, folder: &Path) -> Loaded {
    let path = folder.join("solved.glb");
    std::fs::write(&path, save(asset, scene, solution).expect("a whole solution"))
        .expect("a folder to write to");
    load(&path, &LoadOptions::default()).expect("a valid file")
}

fn bits(values: &[Rgb]) -> Vec<[u32; 3]> {
    values.iter().map(|v| v.to_array().map(f32::to_bits)).collect()
}

#[test]
fn a_solution_comes_back_bit_for_bit_with_its_scene() {
    let folder = tempfile::tempdir().unwrap();
    let Loaded { scene, asset, .. } = loaded(folder.path());
    let before = solution(&scene);
    let again = written(asset, &scene, &before, folder.path());
    assert_eq!(again.scene.hash(), scene.hash());
    assert_eq!(again.scene.cameras().len(), scene.cameras().len());
    assert_eq!(again.scene.lights().len(), scene.lights().len());

    let after = read(&again.asset).unwrap().unwrap();
    assert!(after.sky.is_none());
    let after = after.solution;
    assert_eq!(after.scene_hash, before.scene_hash);
    assert_eq!(after.settings, before.settings);
    assert_eq!(after.mesh.vertices, before.mesh.vertices);
    assert_eq!(after.mesh.elements, before.mesh.elements);
    assert_eq!(after.mesh.faces, before.mesh.faces);
    assert_eq!(after.mesh.face_of, before.mesh.face_of);
    assert_eq!(after.patches, before.patches);
    assert_eq!(bits(&after.punctual), bits(&before.punctual));
    for (a, b) in
        after.irradiance.iter().chain(&after.gathered).zip(before.irradiance.iter().chain(&before.gathered))
    {
        assert_eq!(bits(a), bits(b));
    }
}

#[test]
fn saving_twice_gives_the_same_file_as_once() {
    let folder = tempfile::tempdir().unwrap();
    let Loaded { scene, asset, .. } = loaded(folder.path());
    let solution = solution(&scene);
    let once = save(asset.clone(), &scene, &solution).unwrap();
    let again = written(asset, &scene, &solution, folder.path());
    assert!(save(again.asset, &again.scene, &solution).unwrap() == once);
}

/// What is read about a point of its own is shown where it is, and comes back about that point.
#[test]
fn a_solution_far_from_the_origin_is_where_its_scene_is() {
    let folder = tempfile::tempdir().unwrap();
    let Loaded { scene, asset, .. } = loaded_at(folder.path(), [1000, 0, -30_000]);
    let before = solution(&scene);
    let once = save(asset.clone(), &scene, &before).unwrap();
    let again = written(asset, &scene, &before, folder.path());
    assert_eq!((again.scene.hash(), again.scene.origin()), (scene.hash(), scene.origin()));
    assert_eq!(read(&again.asset).unwrap().unwrap().solution.mesh.vertices, before.mesh.vertices);
    let root = serde_json::Value::Object(again.asset.json().clone());
    let shown = &root["scenes"][root["scene"].as_u64().unwrap() as usize]["nodes"];
    assert_eq!(shown.as_array().unwrap().len(), 1);
    let group = &root["nodes"][shown[0].as_u64().unwrap() as usize];
    assert_eq!(group["translation"], json!(scene.origin().to_array()));
    // The floor is about its node, within the step of the origin.
    let floor = scene.corners(TriangleId(0))[0].as_dvec3() + scene.origin();
    assert_eq!(floor.to_array(), [999.0, 0.0, -30_001.0]);
    assert!(save(again.asset, &again.scene, &before).unwrap() == once);
}

#[test]
fn the_default_scene_shows_baked_sides_and_leaves_mirrors_as_they_were() {
    let folder = tempfile::tempdir().unwrap();
    let Loaded { scene, asset, .. } = loaded(folder.path());
    let again = written(asset, &scene, &solution(&scene), folder.path());
    let root = serde_json::Value::Object(again.asset.json().clone());
    let shown = &root["scenes"][root["scene"].as_u64().unwrap() as usize];
    let nodes: Vec<_> = shown["nodes"]
        .as_array()
        .unwrap()
        .iter()
        .map(|n| &root["nodes"][n.as_u64().unwrap() as usize])
        .collect();
    let primitive = |name: &str| {
        let node = nodes.iter().find(|node| node["name"] == name && node.get("mesh").is_some()).unwrap();
        &root["meshes"][node["mesh"].as_u64().unwrap() as usize]["primitives"][0]
    };
    let material = |name: &str| &root["materials"][primitive(name)["material"].as_u64().unwrap() as usize];

    for name in ["floor", "lamp"] {
        assert!(material(name)["extensions"]["KHR_materials_unlit"].is_object(), "{name}");
        assert_eq!(material(name)["extras"]["catoptric"]["original"]["name"], name);
        for attribute in ["COLOR_0", "_IRRADIANCE_DIRECT", "_IRRADIANCE_INDIRECT", "_IRRADIANCE_PUNCTUAL"] {
            assert!(primitive(name)["attributes"][attribute].is_u64(), "{name} has no {attribute}");
        }
    }
    assert_eq!(primitive("mirror")["material"], 2);
    // Cameras and lights are shown too.
    assert!(nodes.iter().any(|node| node.get("camera").is_some()));
    assert!(nodes.iter().any(|node| node["extensions"]["KHR_lights_punctual"].is_object()));
}

#[test]
fn the_sky_is_kept_whether_uniform_or_an_image() {
    let folder = tempfile::tempdir().unwrap();
    let texels: Vec<[f32; 3]> = (0..8).map(|i| [i as f32 / 3.0, 1e-42, 7e30]).collect();
    let skies = [
        Sky::Uniform(Radiance(Rgb::new(0.1, 0.2, 1.0 / 3.0))),
        Sky::Image(SkyImage { width: 4, height: 2, texels }),
    ];
    for sky in skies {
        let Loaded { scene, asset, .. } = loaded(folder.path());
        let mut parts = scene.into_parts();
        parts.sky = Some(sky);
        let scene = Scene::new(parts).unwrap();
        let again = written(asset, &scene, &solution(&scene), folder.path());
        let mut parts = again.scene.into_parts();
        parts.sky = read(&again.asset).unwrap().unwrap().sky;
        assert_eq!(Scene::new(parts).unwrap().hash(), scene.hash());
    }
}

#[test]
fn a_file_without_a_solution_has_none_and_damage_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let Loaded { scene, asset, .. } = loaded(folder.path());
    assert!(read(&asset).unwrap().is_none());

    let again = written(asset, &scene, &solution(&scene), folder.path());
    let metadata = again.asset.metadata().unwrap().clone();
    let damaged = |key: &str, value: serde_json::Value| {
        let mut asset = again.asset.clone();
        let mut metadata = metadata.clone();
        metadata[key] = value;
        asset.set_metadata(metadata);
        read(&asset)
    };
    assert!(matches!(damaged("format", json!(99)), Err(FileError::Format { found: 99 })));
    assert!(matches!(damaged("scene_hash", json!("none")), Err(FileError::Description(_))));
    assert!(matches!(damaged("vertices", json!(7)), Err(FileError::Array { name: "vertex_position", .. })));
    assert!(matches!(damaged("elements", json!(u64::MAX)), Err(FileError::Array { .. })));
    assert!(matches!(damaged("triangles", json!(2)), Err(FileError::Value { name: "vertex_triangle", .. })));
}

#[test]
fn an_empty_solution_is_a_solution() {
    let folder = tempfile::tempdir().unwrap();
    let Loaded { scene, asset, .. } = loaded(folder.path());
    let none = || vec![FaceId::NONE; scene.triangles().len()];
    let mesh = DisplayMesh::new(Vec::new(), Vec::new(), Vec::new(), [none(), none()]);
    let solution = Solution { mesh, scene_hash: SceneHash(5), ..Solution::default() };
    let again = written(asset, &scene, &solution, folder.path());
    let saved = read(&again.asset).unwrap().unwrap();
    assert_eq!(saved.solution.scene_hash, SceneHash(5));
    assert_eq!(saved.solution.mesh.vertices.len(), 0);
}
