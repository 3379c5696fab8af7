//! What a run starts from: the scene with its sky and, if there is one, its solution.

use std::path::{Path, PathBuf};

use catoptric_image::{Image, ReadLimits};
use catoptric_scene::gltf::{self, AnimatedCameras, Asset, Described, LoadError, LoadOptions, Unread};
use catoptric_scene::{BRIGHTEST, Photometry, Radiance, Scene, SceneHash, Sky, SkyImage};
use catoptric_solution::Solution;
use catoptric_solution::file::{self, Saved};
use catoptric_trace::Accelerator;

use crate::failure::{Failure, did_you_mean};
use crate::value::{LightFile, SkySource};

/// A scene that is ready for both passes.
pub(crate) struct Input {
    pub(crate) scene: Scene,
    pub(crate) hash: SceneHash,
    /// The file, to be written again with a solution.
    pub(crate) asset: Asset,
    /// All that was read: no output may take the place of one of them.
    pub(crate) files: Vec<PathBuf>,
    pub(crate) cameras: AnimatedCameras,
    /// Light that was computed before.
    pub(crate) solution: Option<Solution>,
    /// The scene's, if it was built while the light was read.
    pub(crate) accelerator: Option<Accelerator>,
    /// What was read in another way than its author may have meant.
    pub(crate) warnings: Vec<String>,
}

/// Which light is used.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Light<'a> {
    /// None: it will be computed. If the file has some, its sky is kept.
    New,
    /// That in the file of the scene, if there is some.
    Own,
    /// That of another file, a solution of the same scene.
    Beside(&'a Path),
}

impl Input {
    /// Reads the scene, its sky and its light.
    pub(crate) fn read(path: &Path, sky: Option<&SkySource>, light: Light) -> Result<Self, Failure> {
        Self::read_with(path, sky, &[], light)
    }

    /// The same, with photometric files for some of its lights.
    pub(crate) fn read_with(
        path: &Path,
        sky: Option<&SkySource>,
        photometry: &[LightFile],
        light: Light,
    ) -> Result<Self, Failure> {
        let mut files: Vec<PathBuf> = photometry.iter().map(|light| light.file.clone()).collect();
        let photometry = photometry.iter().map(read_photometry).collect::<Result<_, Failure>>()?;
        let options = LoadOptions { photometry, ..LoadOptions::default() };
        let opened = || open(path, || gltf::open(path, &options));
        let described = |unread: Unread, asset: &Asset, with_accelerator: bool| {
            let described = unread.scene(asset).map_err(|error| Failure::Run(error.to_string()))?;
            let accelerator = with_accelerator.then(|| Accelerator::new(&described.scene));
            Ok::<_, Failure>((described, accelerator))
        };
        // Light is read while the tree is built; where there is none, that is a stage of its own.
        let (asset, described, saved, light_file) = match light {
            Light::New | Light::Own => {
                let (asset, unread) = opened()?;
                let has_light = asset.metadata().is_some();
                let (described, saved) =
                    rayon::join(|| described(unread, &asset, has_light), || saved(&asset, path));
                (asset, described?, saved?, path)
            }
            Light::Beside(beside) => {
                let scene = || {
                    let (asset, unread) = opened()?;
                    let described = described(unread, &asset, true)?;
                    Ok::<_, Failure>((asset, described))
                };
                let (scene, saved) = rayon::join(scene, || saved_beside(path, beside));
                let (asset, described) = scene?;
                (asset, described, Some(saved?), beside)
            }
        };
        let (Described { scene, cameras, warnings }, accelerator) = described;
        let mut warnings: Vec<String> = warnings.iter().map(ToString::to_string).collect();

        files.extend([path.to_owned(), light_file.to_owned()]);
        files.extend_from_slice(asset.files());
        if let Some(SkySource::File(image)) = sky {
            files.push(image.clone());
        }

        // The sky that was asked for, else the one that the solution was made with.
        let (saved_sky, solution) =
            saved.map_or((None, None), |Saved { sky, solution }| (sky, Some(solution)));
        let sky = match sky {
            Some(source) => Some(read_sky(source, &mut warnings)?),
            None => saved_sky,
        };
        let scene = match sky {
            Some(sky) => with_sky(scene, sky)?,
            None => scene,
        };

        let hash = scene.hash();
        let solution = solution.filter(|_| !matches!(light, Light::New));
        if let Some(solution) = &solution {
            check_hash(solution, hash, &scene, path, light_file)?;
        }
        Ok(Self { scene, hash, asset, files, cameras, solution, accelerator, warnings })
    }
}

/// The name of a light and the text of its file.
fn read_photometry(of: &LightFile) -> Result<(String, String), Failure> {
    let shown = of.file.display();
    let fail = |error: &dyn std::fmt::Display| {
        Failure::run(
            format_args!("--ies {}: {shown}: {error}", of.light),
            "name an IES LM-63 file, like --ies Lamp=lamp.ies",
        )
    };
    let size = std::fs::metadata(&of.file).map_err(|error| fail(&error))?.len();
    if size > MAX_PHOTOMETRY {
        return Err(fail(&format_args!("{size} bytes are too many")));
    }
    let bytes = std::fs::read(&of.file).map_err(|error| fail(&error))?;
    // Keywords may be in any code page; the numbers are ASCII.
    let text = String::from_utf8_lossy(&bytes).into_owned();
    Photometry::parse(&text).map_err(|error| fail(&error))?;
    Ok((of.light.clone(), text))
}

/// Bytes of a photometric file, at most.
const MAX_PHOTOMETRY: u64 = 16 << 20;

/// Reads a file; one that is not there is looked for under similar names.
fn open<T>(path: &Path, read: impl FnOnce() -> Result<T, LoadError>) -> Result<T, Failure> {
    if !path.exists() {
        let message = format!("{}: no such file", path.display());
        return Err(match similar_file(path) {
            Some(similar) => Failure::run(message, format_args!("did you mean {}?", similar.display())),
            None => Failure::Run(message),
        });
    }
    read().map_err(|error| Failure::Run(error.to_string()))
}

/// The solution in a file of its own for the scene in `path`.
fn saved_beside(path: &Path, beside: &Path) -> Result<Saved, Failure> {
    let asset = open(beside, || Asset::read(beside, &LoadOptions::default()))?;
    saved(&asset, beside)?.ok_or_else(|| {
        Failure::run(
            format_args!("{}: is a scene without a solution", beside.display()),
            format_args!("make one: catoptric solve {} -o solved.glb", path.display()),
        )
    })
}

/// A scene in the same folder whose name is close.
fn similar_file(path: &Path) -> Option<PathBuf> {
    let folder = path.parent().filter(|parent| !parent.as_os_str().is_empty());
    let names: Vec<String> = std::fs::read_dir(folder.unwrap_or(Path::new(".")))
        .ok()?
        .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
        .filter(|name| name.ends_with(".glb") || name.ends_with(".gltf"))
        .collect();
    let name = path.file_name()?.to_string_lossy();
    did_you_mean(&name, names.iter().map(String::as_str)).map(|similar| path.with_file_name(similar))
}

fn saved(asset: &Asset, path: &Path) -> Result<Option<Saved>, Failure> {
    file::read(asset).map_err(|error| {
        Failure::run(
            format_args!("{}: {error}", path.display()),
            "solve the scene again with this version: catoptric solve SCENE -o solved.glb",
        )
    })
}

/// The light must be that of this scene, or the picture would be wrong without a sign of it.
fn check_hash(
    solution: &Solution,
    hash: SceneHash,
    scene: &Scene,
    path: &Path,
    light_file: &Path,
) -> Result<(), Failure> {
    let mesh = &solution.mesh;
    let triangles = scene.triangles().len();
    let fits = mesh.face_of.iter().all(|of| of.len() == triangles)
        && mesh.vertices.iter().all(|vertex| vertex.triangle.index() < triangles);
    if solution.scene_hash == hash && fits {
        return Ok(());
    }
    let found = format!(
        "{}: holds the light of another scene (hash {}) than {} (hash {hash})",
        light_file.display(),
        solution.scene_hash,
        path.display(),
    );
    let sky = scene.sky().is_some();
    let hint =
        if sky { "the sky belongs to the light: solve again with the same --sky" } else { "solve it again" };
    Err(Failure::run(
        found,
        format_args!("{hint}: catoptric solve {} -o {}", path.display(), light_file.display()),
    ))
}

fn with_sky(scene: Scene, sky: Sky) -> Result<Scene, Failure> {
    let mut parts = scene.into_parts();
    parts.sky = Some(sky);
    Scene::new(parts).map_err(|issues| {
        let lines: Vec<String> = issues.iter().map(|i| format!("{}: {}", i.place, i.problem)).collect();
        Failure::Run(lines.join("\n"))
    })
}

/// The sky as a person gave it. Texels that no light can have are put to zero, with a warning.
fn read_sky(source: &SkySource, warnings: &mut Vec<String>) -> Result<Sky, Failure> {
    let path = match source {
        SkySource::Uniform(radiance) => return Ok(Sky::Uniform(Radiance((*radiance).into()))),
        SkySource::File(path) => path,
    };
    if !path.exists() {
        return Err(Failure::run(
            format_args!("{}: no such sky file", path.display()),
            "--sky takes a radiance like 1,1,1 or an equirectangular .exr or .hdr file",
        ));
    }
    let image = Image::read(path, &ReadLimits::default())?;
    let Some(mut texels) = image.rgb("") else {
        let channels: Vec<&str> = image.channels.iter().map(|c| c.name.as_str()).collect();
        return Err(Failure::Run(format!(
            "{}: expected the channels R, G, B, found {}",
            path.display(),
            channels.join(", ")
        )));
    };
    if image.width != 2 * image.height {
        warnings.push(format!(
            "{}: {}x{} is not twice as wide as high: read as equirectangular all the same",
            path.display(),
            image.width,
            image.height
        ));
    }
    let mut impossible = 0_usize;
    for value in texels.as_flattened_mut() {
        if !(0.0..=BRIGHTEST).contains(value) {
            *value = if value.is_finite() { value.clamp(0.0, BRIGHTEST) } else { 0.0 };
            impossible += 1;
        }
    }
    if impossible > 0 {
        let shown = path.display();
        warnings.push(format!(
            "{shown}: {impossible} values that are not finite were put to 0, others into the range from 0 to {BRIGHTEST:e}"
        ));
    }
    Ok(Sky::Image(SkyImage { width: image.width, height: image.height, texels }))
}
