//! A folder with a small scene, and the program run in it.

use std::fs;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};

use serde_json::json;

/// A temporary folder that holds `scene.gltf`: a lamp over a floor, beside a mirror; cameras `Left` and `Right`.
pub(crate) struct Bench {
    folder: tempfile::TempDir,
}

/// What a run left.
pub(crate) struct Run {
    pub(crate) code: i32,
    pub(crate) stdout: String,
    pub(crate) stderr: String,
}

impl Run {
    /// Asserts an exit code and that the message names things.
    #[track_caller]
    pub(crate) fn fails_with(&self, code: i32, parts: &[&str]) {
        assert_eq!(self.code, code, "{}", self.stderr);
        for part in parts {
            assert!(self.stderr.contains(part), "{part:?} is missing:\n{}", self.stderr);
        }
        assert!(!self.stderr.contains("panicked"), "{}", self.stderr);
    }
}

impl Bench {
    pub(crate) fn new() -> Self {
        let bench = Self { folder: tempfile::tempdir().expect("a temporary folder that works") };
        bench.write_scene("scene.gltf", [0.8, 0.7, 0.6]);
        bench
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Names of the files in the folder, sorted.
    pub(crate) fn files(&self) -> Vec<String> {
        let entries = fs::read_dir(self.folder.path()).expect("a temporary folder that works");
        let mut names: Vec<String> = entries
            .map(|entry| {
                entry.expect("a temporary folder that works").file_name().into_string().expect("UTF-8")
            })
            .collect();
        names.sort();
        names
    }

    /// Runs the program in the folder.
    pub(crate) fn run(&self, arguments: &[&str]) -> Run {
        let output = self.command(arguments).output().expect("the program runs");
        Run {
            code: output.status.code().unwrap_or(-1),
            stdout: String::from_utf8(output.stdout).expect("UTF-8"),
            stderr: String::from_utf8(output.stderr).expect("UTF-8"),
        }
    }

    /// Renders the scene as a draft.
    pub(crate) fn render(&self, arguments: &[&str]) -> Run {
        self.run(&[&["render", "scene.gltf", "--quality", "draft"], arguments].concat())
    }

    /// Starts the program in the folder.
    pub(crate) fn spawn(&self, arguments: &[&str]) -> Child {
        self.command(arguments).stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("the program runs")
    }

    fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_catoptric"));
        command.current_dir(self.folder.path()).args(arguments);
        command
    }

    /// Writes a scene whose floor has this base colour.
    pub(crate) fn write_scene(&self, name: &str, floor: [f32; 3]) {
        // A unit quad that looks up.
        let corners: [[f32; 3]; 4] = [[-1.0, 0.0, -1.0], [-1.0, 0.0, 1.0], [1.0, 0.0, 1.0], [1.0, 0.0, -1.0]];
        let mut bytes: Vec<u8> = corners.iter().flatten().flat_map(|x| x.to_le_bytes()).collect();
        bytes.extend([0_u32, 1, 2, 0, 2, 3].iter().flat_map(|i| i.to_le_bytes()));
        fs::write(self.path("quad.bin"), &bytes).expect("a temporary folder that works");

        let [r, g, b] = floor;
        let half = std::f32::consts::FRAC_1_SQRT_2;
        let diffuse = json!({ "specularFactor": 0.0 });
        let mesh = |material: u32| json!({ "primitives": [{ "attributes": { "POSITION": 0 }, "indices": 1, "material": material }] });
        let scene = json!({
            "asset": { "version": "2.0" },
            "extensionsUsed": ["KHR_materials_specular"],
            "scene": 0,
            "scenes": [{ "nodes": [0, 1, 2, 3, 4] }],
            "nodes": [
                { "name": "Floor", "mesh": 0 },
                { "name": "Lamp", "mesh": 1, "translation": [0, 2, 0], "rotation": [1, 0, 0, 0], "scale": [0.3, 1, 0.3] },
                { "name": "Mirror", "mesh": 2, "translation": [-1, 1, 0], "rotation": [0, 0, -half, half] },
                { "name": "Left", "camera": 0, "translation": [0.5, 1.2, 4] },
                { "name": "Right", "camera": 0, "translation": [1.5, 0.8, 4] },
            ],
            "cameras": [{ "type": "perspective", "perspective": { "yfov": 0.8, "aspectRatio": 1.5, "znear": 0.1 } }],
            "meshes": [mesh(0), mesh(1), mesh(2)],
            "materials": [
                {
                    "name": "floor", "doubleSided": true,
                    "pbrMetallicRoughness": { "baseColorFactor": [r, g, b, 1], "metallicFactor": 0, "roughnessFactor": 1 },
                    "extensions": { "KHR_materials_specular": diffuse },
                },
                {
                    "name": "lamp", "emissiveFactor": [1, 1, 1],
                    "pbrMetallicRoughness": { "baseColorFactor": [0, 0, 0, 1], "metallicFactor": 0, "roughnessFactor": 1 },
                    "extensions": { "KHR_materials_specular": diffuse },
                },
                {
                    "name": "mirror",
                    "pbrMetallicRoughness": { "baseColorFactor": [0.9, 0.95, 0.9, 1], "metallicFactor": 1, "roughnessFactor": 0 },
                },
            ],
            "buffers": [{ "uri": "quad.bin", "byteLength": bytes.len() }],
            "bufferViews": [
                { "buffer": 0, "byteOffset": 0, "byteLength": 48 },
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
        fs::write(self.path(name), scene.to_string()).expect("a temporary folder that works");
    }
}
