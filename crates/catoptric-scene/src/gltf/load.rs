//! From a file to a validated scene.

use std::path::Path;

use crate::scene::{Scene, SceneParts};

use super::animation::AnimatedCameras;
use super::asset::Asset;
use super::camera::{framed_camera, read_cameras};
use super::clean::{clean, finish_normals};
use super::document::Table;
use super::light::{embed_photometry, read_lights};
use super::material::{default_material, read_materials};
use super::mesh::MeshReader;
use super::node::Hierarchy;
use super::options::LoadOptions;
use super::origin::origin;
use super::report::{LoadError, Report, Warning};
use super::survey::survey;
use super::texture::TextureReader;
use super::uri::{Folder, read_limited};
use super::{container, embed, extension, solid};

/// What a file contains.
#[derive(Clone, Debug)]
pub struct Loaded {
    /// The scene, validated.
    pub scene: Scene,
    /// The file itself, self-contained: to be written again with a solution.
    pub asset: Asset,
    /// The scene's cameras over time.
    pub cameras: AnimatedCameras,
    /// What was read in another way than its author may have meant.
    pub warnings: Vec<Warning>,
}

/// A scene without the file that it is from.
#[derive(Clone, Debug)]
pub struct Described {
    /// The scene, validated.
    pub scene: Scene,
    /// Its cameras over time.
    pub cameras: AnimatedCameras,
    /// What was read in another way than its author may have meant, in all of the file.
    pub warnings: Vec<Warning>,
}

/// A file that was read, of which no scene has been made yet: what else is in it can be read at the same time.
#[derive(Debug)]
pub struct Unread<'a> {
    path: &'a Path,
    options: &'a LoadOptions,
    report: Report,
}

/// Loads a `.gltf` or `.glb` file.
///
/// Reads nothing outside of the file's folder, never panics, and takes no more than `options` allow. A
/// file with a solution gives its source scene: the same triangles in the same order, to the last bit.
pub fn load(path: &Path, options: &LoadOptions) -> Result<Loaded, LoadError> {
    let (asset, unread) = open(path, options)?;
    unread.load(asset)
}

/// Reads a file with all that it refers to; the scene is to be made of it.
pub fn open<'a>(path: &'a Path, options: &'a LoadOptions) -> Result<(Asset, Unread<'a>), LoadError> {
    let report = Report::new(path);
    let Some(mut asset) = read_asset(path, options, &report) else { return Err(failed(report)) };
    embed_photometry(&mut asset, &options.photometry, &report);
    Ok((asset, Unread { path, options, report }))
}

/// Reads an asset in memory as if it had been written to `name` and loaded again.
pub fn load_asset(mut asset: Asset, name: &Path, options: &LoadOptions) -> Result<Loaded, LoadError> {
    let report = Report::new(name);
    embed_photometry(&mut asset, &options.photometry, &report);
    Unread { path: name, options, report }.load(asset)
}

impl Unread<'_> {
    /// The scene of the asset that was read.
    pub fn scene(self, asset: &Asset) -> Result<Described, LoadError> {
        read_scene(asset, self.path, self.options, self.report)
    }

    fn load(self, asset: Asset) -> Result<Loaded, LoadError> {
        let Described { scene, cameras, warnings } = self.scene(&asset)?;
        Ok(Loaded { scene, asset, cameras, warnings })
    }
}

impl Asset {
    /// Reads a file with all that it refers to, but makes no scene of it.
    pub fn read(path: &Path, options: &LoadOptions) -> Result<Self, LoadError> {
        let report = Report::new(path);
        match read_asset(path, options, &report) {
            Some(asset) => report.finish().map(|_| asset),
            None => Err(failed(report)),
        }
    }
}

/// The problems, of which there must be one.
fn failed(report: Report) -> LoadError {
    if !report.has_problems() {
        report.problem("file", "a readable glTF file", "something else", "");
    }
    match report.finish() {
        Err(error) => error,
        Ok(warnings) => LoadError { problems: Vec::new(), omitted: 0, warnings },
    }
}

fn read_asset(path: &Path, options: &LoadOptions, report: &Report) -> Option<Asset> {
    let (bytes, budget) = match read_limited(path, options.max_file_bytes) {
        Ok(read) => read,
        Err(error) => {
            report.problem("file", "a readable file", error, "");
            return None;
        }
    };
    let (json, bin) = container::parse(bytes, options, report)?;
    extension::check(super::document::Entity::root(&json), report);
    // Without a required extension everything else looks broken too.
    if report.has_problems() {
        return None;
    }
    Some(embed::embed(json, bin, &mut Folder::of(path, budget), report))
}

fn read_scene(
    asset: &Asset,
    path: &Path,
    options: &LoadOptions,
    report: Report,
) -> Result<Described, LoadError> {
    // Materials first: they say which textures are needed.
    let material_count = asset.source().map_or_else(
        || asset.table_len(Table::MATERIALS),
        |source| source.materials.min(asset.table_len(Table::MATERIALS)),
    );
    let mut textures = TextureReader::new(asset, options, &report);
    let mut materials = read_materials(asset, material_count, &mut textures, &report);
    let textures = textures.textures;

    // Nodes, and what hangs on them.
    let mut hierarchy = Hierarchy::read(asset, options, &report);
    let origin = origin(asset, &hierarchy);
    hierarchy.shift(-origin);
    let mut meshes = MeshReader::new(asset, options, &report, &hierarchy, material_count);
    meshes.read_all();
    let (mut parts, mut precision) = (meshes.parts, meshes.normal_precision);
    let lights = read_lights(asset, &hierarchy, &report);
    let camera_nodes = read_cameras(asset, &hierarchy, &report);
    let mut cameras = AnimatedCameras::read(asset, &hierarchy, &camera_nodes, origin, &report);
    if report.has_problems() {
        return Err(failed(report));
    }

    // What light transport cannot work with is taken out, and said.
    clean(&mut parts, &mut precision, &report);
    finish_normals(&mut parts, &precision, &report);
    if parts.surfaces.iter().any(|surface| surface.material.index() == material_count) {
        materials.push(default_material());
    }
    if parts.triangles.is_empty() {
        report.warn("scene", "has no surfaces");
    }
    let mut scene_cameras: Vec<_> = camera_nodes.into_iter().map(|node| node.camera).collect();
    if scene_cameras.is_empty() {
        scene_cameras.push(framed_camera(&parts.vertices));
        cameras = AnimatedCameras::still(&scene_cameras);
    }
    let parts = SceneParts {
        name: path.file_stem().map_or_else(|| "scene".to_owned(), |stem| stem.to_string_lossy().into_owned()),
        materials,
        textures,
        lights,
        cameras: scene_cameras,
        origin,
        ..parts
    };
    solid::check(&parts, &report);
    survey(asset, &report);
    match Scene::new(parts) {
        Ok(scene) => {
            let warnings = report.finish()?;
            Ok(Described { scene, cameras, warnings })
        }
        Err(issues) => {
            for issue in issues {
                report.problem(issue.place, "a valid scene", issue.problem, "");
            }
            Err(failed(report))
        }
    }
}
