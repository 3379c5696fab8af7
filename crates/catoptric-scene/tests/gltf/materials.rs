//! Materials, textures, lights and cameras as they come into the scene.

use super::support::Builder;
use catoptric_scene::gltf::Loaded;
use catoptric_scene::{Barycentric, Projection, PunctualKind, Rgb, SurfacePoint, Transmission, TriangleId};
use glam::{Vec2, Vec3};
use serde_json::{Value, json};

const MIDDLE: Barycentric = Barycentric { u: 0.25, v: 0.25 };

/// One triangle of one material.
fn load_material(material: Value) -> Loaded {
    let mut builder = Builder::new();
    let material = builder.push("materials", material);
    builder.show_triangle("sample", Some(material));
    builder.load()
}

fn point(loaded: &Loaded) -> SurfacePoint {
    loaded.scene.surface_point(TriangleId(0), MIDDLE)
}

fn summary(loaded: &Loaded) -> &str {
    &loaded.scene.materials()[0].reading.summary
}

#[test]
fn each_row_of_the_material_table_is_read_as_its_ideal_component() {
    let base = json!([0.8, 0.4, 0.2, 1.0]);
    let color = Rgb::new(0.8, 0.4, 0.2);
    let pbr = |metallic: f32, roughness: f32| json!({ "baseColorFactor": base, "metallicFactor": metallic, "roughnessFactor": roughness });

    let lambertian = load_material(json!({ "pbrMetallicRoughness": pbr(0.0, 1.0) }));
    assert_eq!((summary(&lambertian), point(&lambertian).diffuse), ("Lambertian", color));
    assert_eq!(point(&lambertian).coat, 0.0);

    let mirror = load_material(json!({ "pbrMetallicRoughness": pbr(1.0, 0.05) }));
    assert_eq!((summary(&mirror), point(&mirror).mirror), ("ideal mirror", color));
    assert_eq!(point(&mirror).diffuse, Rgb::ZERO);

    let rough = load_material(json!({ "pbrMetallicRoughness": pbr(1.0, 0.5) }));
    assert_eq!((point(&rough).diffuse, point(&rough).mirror), (color, Rgb::ZERO));
    assert!(rough.warnings.iter().any(|w| w.message.contains("rough metal")), "{:?}", rough.warnings);

    let coated = load_material(json!({ "pbrMetallicRoughness": pbr(0.0, 0.0) }));
    assert_eq!((summary(&coated), point(&coated).coat), ("coated Lambertian", 1.0));
    let plain = json!({ "KHR_materials_specular": { "specularFactor": 0 } });
    let plain = load_material(json!({ "pbrMetallicRoughness": pbr(0.0, 0.0), "extensions": plain }));
    assert_eq!((summary(&plain), point(&plain).coat), ("Lambertian", 0.0));
    let lacquer = json!({ "KHR_materials_clearcoat": { "clearcoatFactor": 0.75 } });
    let lacquer = load_material(json!({ "pbrMetallicRoughness": pbr(0.0, 1.0), "extensions": lacquer }));
    assert_eq!(point(&lacquer).clearcoat, 0.75);

    let mixed = load_material(json!({ "pbrMetallicRoughness": pbr(0.25, 0.0) }));
    assert_eq!((point(&mixed).mirror, point(&mixed).diffuse), (color * 0.25, color * 0.75));

    let pane = json!({ "KHR_materials_transmission": { "transmissionFactor": 1 }, "KHR_materials_ior": { "ior": 1.4 } });
    let pane = load_material(json!({ "pbrMetallicRoughness": pbr(0.0, 0.0), "extensions": pane }));
    assert_eq!(summary(&pane), "thin pane, ior 1.4");
    assert_eq!((point(&pane).transmission, point(&pane).transmission_kind), (1.0, Transmission::Pane));
    assert_eq!((point(&pane).tint, point(&pane).ior, point(&pane).diffuse), (color, 1.4, Rgb::ZERO));

    let leaf = json!({ "KHR_materials_diffuse_transmission": { "diffuseTransmissionFactor": 0.25,
        "diffuseTransmissionColorFactor": [0.0, 1.0, 0.0] } });
    let leaf = load_material(json!({ "pbrMetallicRoughness": pbr(0.0, 1.0), "extensions": leaf }));
    assert_eq!((point(&leaf).diffuse, point(&leaf).diffuse_transmission), (color * 0.75, Rgb::Y * 0.25));

    let lamp = json!({ "KHR_materials_emissive_strength": { "emissiveStrength": 8 } });
    let lamp = load_material(json!({ "emissiveFactor": [1, 0.5, 0.25], "extensions": lamp }));
    assert_eq!(point(&lamp).emission.0, Rgb::new(8.0, 4.0, 2.0));

    let veil = json!({ "baseColorFactor": [1, 1, 1, 0.25], "metallicFactor": 0 });
    let veil = load_material(json!({ "pbrMetallicRoughness": veil, "alphaMode": "BLEND" }));
    assert_eq!(point(&veil).opacity, 0.25);
    let hole = json!({ "baseColorFactor": [1, 1, 1, 0.25], "metallicFactor": 0 });
    let hole = load_material(json!({ "pbrMetallicRoughness": hole, "alphaMode": "MASK" }));
    assert!(hole.scene.is_cut_out(TriangleId(0), MIDDLE), "0.25 is below glTF's default cut-off 0.5");

    let sign = load_material(json!({ "extensions": { "KHR_materials_unlit": {} } }));
    assert!(sign.scene.materials()[0].unlit);
}

#[test]
fn a_volume_absorbs_its_colour_over_its_distance() {
    let volume =
        json!({ "thicknessFactor": 0.1, "attenuationColor": [0.5, 0.25, 1.0], "attenuationDistance": 0.2 });
    let glass = load_material(json!({
        "pbrMetallicRoughness": { "metallicFactor": 0, "roughnessFactor": 0 },
        "extensions": { "KHR_materials_transmission": { "transmissionFactor": 1 }, "KHR_materials_volume": volume },
    }));
    assert_eq!(point(&glass).transmission_kind, Transmission::Solid);
    let sigma = glass.scene.materials()[0].absorption;
    let passed = Rgb::from_array(sigma.to_array().map(|s| libm::expf(-s * 0.2)));
    // exp and ln are each good to one rounding, of an exponent below 1.4.
    assert!((passed - Rgb::new(0.5, 0.25, 1.0)).abs().max_element() < 1e-6, "{passed}");
}

#[test]
fn a_primitive_without_a_material_has_gltfs_default_one() {
    let mut builder = Builder::new();
    builder.show_triangle("bare", None);
    let loaded = builder.load();
    assert_eq!(loaded.scene.materials().len(), 1);
    assert_eq!(point(&loaded).diffuse, Rgb::ONE, "a rough white metal is diffuse white");
}

#[test]
fn no_material_reflects_more_than_it_receives() {
    for material in [
        json!({ "pbrMetallicRoughness": { "baseColorFactor": [3, 2, 1, 1], "metallicFactor": 0.5, "roughnessFactor": 0 } }),
        json!({ "extensions": { "KHR_materials_pbrSpecularGlossiness": { "diffuseFactor": [1, 1, 1, 1], "specularFactor": [0.9, 0.9, 0.9] } } }),
        json!({ "pbrMetallicRoughness": { "metallicFactor": 0 }, "extensions": { "KHR_materials_diffuse_transmission": { "diffuseTransmissionFactor": 1 } } }),
    ] {
        let loaded = load_material(material.clone());
        let point = point(&loaded);
        let total =
            point.diffuse + point.diffuse_transmission + point.mirror + Rgb::splat(point.transmission);
        assert!(total.max_element() <= 1.0 + f32::EPSILON, "{material}: {total}");
    }
}

/// A 2×2 image: red, green above blue, white.
fn checker() -> String {
    let mut png = std::io::Cursor::new(Vec::new());
    let texels = vec![255, 0, 0, 0, 255, 0, 0, 0, 255, 255, 255, 255];
    image::RgbImage::from_raw(2, 2, texels).unwrap().write_to(&mut png, image::ImageFormat::Png).unwrap();
    let bytes = png.into_inner();
    // Percent-encoded data URIs are legal and need no base64.
    let encoded: String = bytes.iter().map(|byte| format!("%{byte:02x}")).collect();
    format!("data:image/png,{encoded}")
}

#[test]
fn texture_coordinates_are_scaled_then_rotated_then_moved() {
    let mut builder = Builder::new();
    builder.push("images", json!({ "uri": checker() }));
    builder.push("samplers", json!({ "magFilter": 9728, "wrapS": 33071, "wrapT": 33648 }));
    builder.push("textures", json!({ "source": 0, "sampler": 0 }));
    let transform = json!({ "scale": [0.5, 2.0], "rotation": std::f32::consts::FRAC_PI_2, "offset": [0.25, 1.0], "texCoord": 1 });
    let info = json!({ "index": 0, "extensions": { "KHR_texture_transform": transform } });
    let pbr = json!({ "metallicFactor": 0, "baseColorTexture": info });
    let material = builder.push("materials", json!({ "pbrMetallicRoughness": pbr }));
    builder.show_triangle("sample", Some(material));
    let loaded = builder.load();
    let texture = loaded.scene.materials()[0].base_texture.unwrap();
    assert_eq!(texture.uv_set, 1);
    // By hand: scale (0.1, 0.2) → (0.05, 0.4); a quarter turn u' = v, v' = −u → (0.4, −0.05); moved (0.65, 0.95).
    let moved = texture.transform.apply(Vec2::new(0.1, 0.2));
    assert!((moved - Vec2::new(0.65, 0.95)).abs().max_element() < 1e-6, "{moved}");
    let image = &loaded.scene.textures()[texture.texture.index()];
    let color =
        |u: f32, v: f32| image.sample(Vec2::new(u, v), catoptric_scene::texture::Coding::Srgb).truncate();
    assert_eq!([color(0.2, 0.2), color(0.7, 0.2), color(0.2, 0.7)], [Vec3::X, Vec3::Y, Vec3::Z]);
    assert_eq!(color(-3.0, 0.2), Vec3::X, "clamped along u");
    assert_eq!(color(0.2, 1.2), Vec3::Z, "mirrored along v: 1.2 is 0.8");
}

/// The first example of KHR_texture_transform: "only the lower left quadrant of the source image, rotated clockwise 90°". Its
/// GLSL matrix, read by columns, turns the other way and misses that quadrant; prose, example and viewers agree with this.
#[test]
fn a_texture_transform_turns_as_the_extensions_own_example_says() {
    let mut builder = Builder::new();
    builder.push("images", json!({ "uri": checker() }));
    builder.push("textures", json!({ "source": 0 }));
    let transform = json!({ "offset": [0, 1], "rotation": std::f64::consts::FRAC_PI_2, "scale": [0.5, 0.5] });
    let info = json!({ "index": 0, "extensions": { "KHR_texture_transform": transform } });
    let material = builder.push("materials", json!({ "pbrMetallicRoughness": { "baseColorTexture": info } }));
    builder.show_triangle("sample", Some(material));
    let loaded = builder.load();
    let transform = loaded.scene.materials()[0].base_texture.unwrap().transform;
    // Top left, top right and bottom left of the surface show bottom left, top left and bottom right of the quadrant.
    for (uv, expected) in [((0.0, 0.0), (0.0, 1.0)), ((1.0, 0.0), (0.0, 0.5)), ((0.0, 1.0), (0.5, 1.0))] {
        let found = transform.apply(Vec2::from(uv));
        assert!((found - Vec2::from(expected)).abs().max_element() < 1e-6, "{uv:?}: {found}");
    }
}

#[test]
fn a_clearcoat_reflects_along_its_own_normal_map_and_other_mirrors_along_the_materials() {
    let outer = |clearcoat: Value| {
        let mut builder = Builder::new();
        builder.push("images", json!({ "uri": checker() }));
        for _ in 0..2 {
            builder.push("textures", json!({ "source": 0 }));
        }
        let material = json!({ "normalTexture": { "index": 0, "scale": 0.5 },
            "extensions": { "KHR_materials_clearcoat": clearcoat } });
        let material = builder.push("materials", material);
        builder.show_triangle("sample", Some(material));
        let loaded = builder.load();
        loaded.scene.materials()[0].outer_normal_texture().map(|(_, scale)| scale)
    };
    assert_eq!(outer(json!({})), Some(0.5));
    assert_eq!(outer(json!({ "clearcoatFactor": 1 })), None);
    let own = json!({ "clearcoatFactor": 1, "clearcoatNormalTexture": { "index": 1, "scale": 0.25 } });
    assert_eq!(outer(own), Some(0.25));
}

#[test]
fn lights_stand_and_shine_where_their_nodes_put_them() {
    let mut builder = Builder::new();
    let lights = json!([
        { "type": "point", "intensity": 10, "color": [1, 0.5, 0] },
        { "type": "spot", "spot": { "innerConeAngle": 0.25, "outerConeAngle": 0.5 } },
        { "type": "directional", "intensity": 3 },
    ]);
    builder.json.insert("extensions".to_owned(), json!({ "KHR_lights_punctual": { "lights": lights } }));
    let half = std::f32::consts::FRAC_1_SQRT_2;
    for light in 0..3 {
        // A quarter turn about x: −Z goes to −(−Y)… by hand: (0, 0, −1) → (0, 1, 0).
        builder.push(
            "nodes",
            json!({ "translation": [1, 2, 3], "rotation": [half, 0, 0, half], "scale": [4, 4, 4],
            "extensions": { "KHR_lights_punctual": { "light": light } } }),
        );
    }
    let scene = builder.load().scene;
    let [point, spot, sun] = scene.lights() else { panic!("three lights") };
    assert_eq!((&point.kind, point.intensity), (&PunctualKind::Point, Rgb::new(10.0, 5.0, 0.0)));
    assert_eq!(point.position, Vec3::new(1.0, 2.0, 3.0));
    assert!((spot.direction - Vec3::Y).length() < 1e-6, "{}", spot.direction);
    let expected = PunctualKind::Spot { cos_inner: libm::cosf(0.25), cos_outer: libm::cosf(0.5) };
    assert_eq!((&spot.kind, spot.intensity), (&expected, Rgb::ONE));
    assert_eq!((&sun.kind, sun.intensity), (&PunctualKind::Directional, Rgb::splat(3.0)));
}

/// A lamp that is brighter to its C90 side, and to the front than to the side.
const IES: &str = "IESNA:LM-63-1995\nTILT=NONE\n1 1000 1 2 3 1 2 0 0 0\n1 1 10\n0 90\n0 90 180\n400 100\n400 200\n400 100\n";

#[test]
fn extras_of_a_light_give_it_a_lobe_or_a_photometric_table() {
    let mut builder = Builder::new();
    let lights = json!([
        { "name": "lobe", "type": "spot", "intensity": 6.0, "extras": { "catoptric": { "lobe": 3.0 } } },
        { "name": "table", "type": "point", "color": [1.0, 0.5, 0.0], "extras": { "catoptric": { "ies": IES } } },
        { "name": "plain", "type": "point", "intensity": 5.0 },
    ]);
    builder.json.insert("extensions".to_owned(), json!({ "KHR_lights_punctual": { "lights": lights } }));
    for light in 0..3 {
        builder.push("nodes", json!({ "name": format!("node {light}"), "extensions": { "KHR_lights_punctual": { "light": light } } }));
    }
    let scene = builder.load().scene;
    let [lobe, table, plain] = scene.lights() else { panic!("three lights") };
    assert_eq!(lobe.kind, PunctualKind::Lobe { exponent: 3.0 });
    // Lights shine along -Z; 60 degrees off, the cosine is a half.
    let slanted = Vec3::new(0.75_f32.sqrt(), 0.0, -0.5);
    assert!((lobe.intensity_towards(slanted) - Rgb::splat(6.0 / 8.0)).length() < 1e-5);
    assert_eq!(lobe.intensity_towards(Vec3::Z), Rgb::ZERO);
    assert!((table.intensity_towards(Vec3::NEG_Z) - Rgb::new(400.0, 200.0, 0.0)).length() < 1e-3);
    // C0 is the node's +X: 100 cd there, 200 to its side.
    assert!((table.intensity_towards(Vec3::X) - Rgb::new(100.0, 50.0, 0.0)).length() < 1e-3);
    assert!((table.intensity_towards(Vec3::Y) - Rgb::new(200.0, 100.0, 0.0)).length() < 1e-3);
    assert_eq!(table.intensity_towards(Vec3::Z), Rgb::ZERO);
    assert_eq!(plain.kind, PunctualKind::Point);
}

#[test]
fn lobes_and_tables_that_are_broken_are_named() {
    for (extras, part) in [(json!({ "lobe": -1.0 }), "lobe"), (json!({ "ies": "no table" }), "LM-63")] {
        let mut builder = Builder::new();
        let lights = json!([{ "name": "lamp", "type": "point", "extras": { "catoptric": extras } }]);
        builder.json.insert("extensions".to_owned(), json!({ "KHR_lights_punctual": { "lights": lights } }));
        builder.push("nodes", json!({ "extensions": { "KHR_lights_punctual": { "light": 0 } } }));
        let message = builder.try_load().map(|_| ()).expect_err("a broken light").to_string();
        assert!(message.contains(part), "{message}");
    }
}

#[test]
fn extras_of_an_emissive_material_give_its_light_a_lobe() {
    let read = |extras: Value| {
        let mut builder = Builder::new();
        let (position, indices) = super::support::box_mesh(&mut builder, 3.0, false);
        let lamp = json!({ "name": "lamp", "emissiveFactor": [1, 1, 1], "extras": extras });
        let material = builder.push("materials", lamp);
        let primitive =
            json!({ "attributes": { "POSITION": position }, "indices": indices, "material": material });
        builder.show("box", primitive);
        builder.try_load().map(|loaded| loaded.scene.materials()[0].clone()).map_err(|e| e.to_string())
    };
    let lamp = read(json!({ "catoptric": { "lobe": 2.5 } })).expect("a lobe");
    assert_eq!(lamp.lobe.exponent(), 2.5);
    assert!(lamp.reading.summary.contains("cosine lobe n = 2.5"), "{}", lamp.reading.summary);
    assert!(read(json!({ "catoptric": {} })).expect("no lobe").lobe.is_diffuse());
    for wrong in [json!(0.0), json!(-2), json!(1000.5), json!(1e39), json!("NaN")] {
        let message = read(json!({ "catoptric": { "lobe": wrong } })).expect_err("a broken lobe");
        assert!(message.contains("lobe") && message.contains("\"lamp\""), "{wrong}: {message}");
        assert!(message.contains(".gl"), "the file has a name: {message}");
    }
}

#[test]
fn a_file_without_a_camera_gets_one_that_sees_everything() {
    let mut builder = Builder::new();
    let (position, indices) = super::support::box_mesh(&mut builder, 3.0, false);
    builder.show("box", json!({ "attributes": { "POSITION": position }, "indices": indices }));
    let loaded = builder.load();
    let camera = &loaded.scene.cameras()[0];
    assert_eq!((camera.name.as_str(), loaded.scene.cameras().len()), ("framed", 1));
    let Projection::Perspective { yfov } = camera.projection else { panic!("perspective") };
    let tan = libm::tanf(0.5 * yfov);
    let camera_from_world = camera.world_from_camera.inverse();
    let mut fullest = 0.0_f32;
    for vertex in loaded.scene.vertices() {
        let p = camera_from_world.transform_point3(vertex.position);
        assert!(p.z < 0.0);
        fullest =
            fullest.max((p.x / (-p.z * tan * camera.aspect.unwrap())).abs()).max((p.y / (-p.z * tan)).abs());
    }
    assert!(fullest < 1.0 && fullest > 0.9, "the picture is filled to {fullest}");
}

#[test]
fn cameras_follow_the_animation_of_the_nodes_above_them() {
    let mut builder = Builder::new();
    let orthographic = json!({ "xmag": 2, "ymag": 1, "znear": 0.1, "zfar": 10 });
    builder.push("cameras", json!({ "type": "orthographic", "orthographic": orthographic }));
    let perspective = json!({ "yfov": 1, "znear": 0.1, "aspectRatio": 2 });
    builder.push("cameras", json!({ "type": "perspective", "perspective": perspective }));
    let eye = builder.push("nodes", json!({ "name": "eye", "camera": 0, "translation": [0, 0, 1] }));
    let rail = builder.push("nodes", json!({ "name": "rail", "children": [eye], "scale": [2, 2, 2] }));
    let still = builder.push("nodes", json!({ "name": "still", "camera": 1 }));
    builder.push("scenes", json!({ "nodes": [rail, still] }));
    builder.slide(rail);
    let loaded = builder.load();
    assert_eq!(loaded.cameras.duration(), 2.0);
    let names: Vec<&str> = loaded.scene.cameras().iter().map(|camera| camera.name.as_str()).collect();
    assert_eq!(names, ["eye", "still"]);
    for (seconds, x) in [(0.0, 0.0), (0.5, 2.0), (2.0, 8.0), (99.0, 8.0)] {
        let cameras = loaded.cameras.at(seconds);
        assert_eq!(Vec3::from(cameras[0].world_from_camera.translation), Vec3::new(x, 0.0, 2.0));
        assert_eq!(cameras[0].world_from_camera.matrix3, glam::Mat3A::IDENTITY, "scale is no part of a view");
        assert_eq!(cameras[1].world_from_camera, loaded.scene.cameras()[1].world_from_camera);
    }
    assert_eq!(loaded.scene.cameras()[0].projection, Projection::Orthographic { xmag: 2.0, ymag: 1.0 });
}
