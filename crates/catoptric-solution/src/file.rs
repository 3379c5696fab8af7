//! A solution in a glTF file: named arrays beside the source scene, which stays as it was.
//!
//! [`save`] adds to the file of the scene: what viewers show (the module `baked`), and every array of the [`Solution`] bit
//! for bit under a name in `asset.extras.catoptric.arrays`. Floats are stored as they are in memory, so a solution that
//! was read gives the same picture, to the last bit, as the one that was saved.

use std::collections::BTreeMap;

use glam::Vec3;
use serde::{Deserialize, Serialize};

use catoptric_scene::gltf::{AppendError, Asset};
use catoptric_scene::{Radiance, Rgb, Scene, SceneHash, Side, Sky, SkyImage, TriangleId};

use crate::baked::{self, Attributes};
use crate::mesh::{DisplayMesh, DisplayVertex, Element, Face, FaceId};
use crate::solution::{PatchRadiosity, Solution, Term};

/// Bumped when older programs would misread the arrays.
const FORMAT: u32 = 2;

/// The gathered parts of the direct and the mirrored term.
const GATHERED: [&str; 2] = ["gathered_direct", "gathered_mirrored"];

/// Why a solution could not be saved or read.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// The file cannot hold it.
    #[error("cannot save the solution: {0}")]
    Append(#[from] AppendError),
    /// The solution itself is broken.
    #[error("cannot save the solution: {0}")]
    Invalid(String),
    /// A solution by another version.
    #[error("its solution has format {found}, this program reads format {FORMAT}")]
    Format {
        /// Format of the file.
        found: u64,
    },
    /// The solution's description is not what it should be.
    #[error("its solution is damaged: {0}")]
    Description(String),
    /// An array is missing or of the wrong length.
    #[error("its solution is damaged: array {name:?}: expected {expected} values, found {found}")]
    Array {
        /// Its name.
        name: &'static str,
        /// Values that belong there.
        expected: usize,
        /// Values that are there.
        found: usize,
    },
    /// An array holds an index that leads nowhere or a value that makes no sense.
    #[error("its solution is damaged: array {name:?}: {problem}")]
    Value {
        /// Its name.
        name: &'static str,
        /// What is wrong.
        problem: String,
    },
}

/// What a file with a solution holds beside its scene.
#[derive(Clone, Debug)]
pub struct Saved {
    /// The solution.
    pub solution: Solution,
    /// The sky with which it was computed: glTF has none.
    pub sky: Option<Sky>,
}

/// What is said about a solution in JSON.
#[derive(Debug, Serialize, Deserialize)]
struct Description {
    format: u32,
    scene_hash: String,
    settings: BTreeMap<String, String>,
    /// COLOR_0 is H/π times this, up to 1.
    exposure: f32,
    sky: Option<SkyDescription>,
    vertices: usize,
    elements: usize,
    faces: usize,
    triangles: usize,
    patches: usize,
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum SkyDescription {
    Uniform { radiance: [f32; 3] },
    Image { width: usize, height: usize },
}

/// The bytes of a self-contained .glb: the scene of `asset`, its light, and a baked room for any viewer.
pub fn save(mut asset: Asset, scene: &Scene, solution: &Solution) -> Result<Vec<u8>, FileError> {
    append(&mut asset, scene, solution)?;
    Ok(asset.to_glb()?)
}

/// Adds a solution to the file of its scene; one that was there before is replaced.
pub fn append(asset: &mut Asset, scene: &Scene, solution: &Solution) -> Result<(), FileError> {
    solution.validate().map_err(FileError::Invalid)?;
    asset.remove_solution();
    let Solution { mesh, irradiance, gathered, punctual, patches, scene_hash, settings } = solution;
    let mut writer = Writer { asset };

    // What is known per vertex, shown to viewers as attributes.
    let position = writer.vectors("vertex_position", mesh.vertices.iter().map(|v| v.position))?;
    let normal = writer.vectors("vertex_normal", mesh.vertices.iter().map(|v| v.normal))?;
    let mut light = Vec::new();
    for term in Term::ALL {
        let values = irradiance[term.index()].iter().copied();
        light.push(writer.vectors(term_array(term), values)?);
    }
    light.push(writer.vectors("irradiance_punctual", punctual.iter().copied())?);
    for (name, values) in GATHERED.into_iter().zip(gathered) {
        writer.vectors(name, values.iter().copied())?;
    }

    // The rest of the mesh, and the patches.
    writer.indices("vertex_triangle", mesh.vertices.iter().map(|v| v.triangle.0))?;
    writer.indices("vertex_side", mesh.vertices.iter().map(|v| v.side.index() as u32))?;
    writer.indices("element_vertices", mesh.elements.iter().flat_map(|e| e.vertices))?;
    writer.indices("face_elements", mesh.faces.iter().map(|f| f.elements.end - f.elements.start))?;
    writer.vectors("face_origin", mesh.faces.iter().map(|f| f.origin))?;
    writer.vectors("face_axes", mesh.faces.iter().flat_map(|f| f.axes))?;
    writer.indices("face_of_front", mesh.face_of[0].iter().map(|f| f.0))?;
    writer.indices("face_of_back", mesh.face_of[1].iter().map(|f| f.0))?;
    writer.scalars("patch_area", &patches.areas)?;
    writer.vectors("patch_center", patches.centers.iter().copied().map(Vec3::from))?;
    writer.vectors("patch_radiosity", patches.radiosity.iter().copied().map(Vec3::from))?;
    let sky = match scene.sky() {
        None => None,
        Some(Sky::Uniform(radiance)) => Some(SkyDescription::Uniform { radiance: radiance.0.to_array() }),
        Some(Sky::Image(image)) => {
            writer.vectors("sky", image.texels.iter().copied().map(Vec3::from))?;
            Some(SkyDescription::Image { width: image.width, height: image.height })
        }
    };

    let attributes = Attributes { position, normal, irradiance: light };
    let exposure = baked::append(asset, scene, solution, &attributes)?;
    let description = Description {
        format: FORMAT,
        scene_hash: scene_hash.to_string(),
        settings: settings.clone(),
        exposure,
        sky,
        vertices: mesh.vertices.len(),
        elements: mesh.elements.len(),
        faces: mesh.faces.len(),
        triangles: mesh.face_of[0].len(),
        patches: patches.areas.len(),
    };
    let description =
        serde_json::to_value(description).map_err(|error| FileError::Invalid(error.to_string()))?;
    asset.set_metadata(description);
    Ok(())
}

/// The solution in a file, if it has one.
pub fn read(asset: &Asset) -> Result<Option<Saved>, FileError> {
    let Some(metadata) = asset.metadata() else { return Ok(None) };
    let format = metadata.get("format").and_then(serde_json::Value::as_u64).unwrap_or(0);
    if format != u64::from(FORMAT) {
        return Err(FileError::Format { found: format });
    }
    let text = |error: &dyn std::fmt::Display| FileError::Description(error.to_string());
    let description: Description = Deserialize::deserialize(metadata).map_err(|error| text(&error))?;
    let scene_hash: SceneHash = description.scene_hash.parse().map_err(|error| text(&error))?;

    let mesh = read_mesh(asset, &description)?;
    let mut irradiance: [Vec<Rgb>; 4] = Default::default();
    for term in Term::ALL {
        irradiance[term.index()] = vectors(asset, term_array(term), description.vertices)?;
    }
    let mut gathered: [Vec<Rgb>; 2] = Default::default();
    for (name, values) in GATHERED.into_iter().zip(&mut gathered) {
        if asset.array_f32(name).is_some() {
            *values = vectors(asset, name, description.vertices)?;
        }
    }
    let arrays = |name, count| -> Result<Vec<[f32; 3]>, FileError> {
        Ok(vectors(asset, name, count)?.into_iter().map(|v| v.to_array()).collect())
    };
    let solution = Solution {
        mesh,
        irradiance,
        gathered,
        punctual: vectors(asset, "irradiance_punctual", description.vertices)?,
        patches: PatchRadiosity {
            areas: floats(asset, "patch_area", description.patches)?,
            centers: arrays("patch_center", description.patches)?,
            radiosity: arrays("patch_radiosity", description.patches)?,
        },
        scene_hash,
        settings: description.settings,
    };
    solution.validate().map_err(FileError::Description)?;
    let sky = match description.sky {
        None => None,
        Some(SkyDescription::Uniform { radiance }) => Some(Sky::Uniform(Radiance(radiance.into()))),
        Some(SkyDescription::Image { width, height }) => {
            let texels = arrays("sky", width.saturating_mul(height))?;
            Some(Sky::Image(SkyImage { width, height, texels }))
        }
    };
    Ok(Some(Saved { solution, sky }))
}

fn read_mesh(asset: &Asset, description: &Description) -> Result<DisplayMesh, FileError> {
    let &Description { vertices, elements, faces, triangles, .. } = description;

    // Every index is checked before anything is looked up with it.
    let below = |name, values: Vec<u32>, bound: usize| match values.iter().find(|v| **v as usize >= bound) {
        Some(bad) => Err(FileError::Value { name, problem: format!("{bad} is not below {bound}") }),
        None => Ok(values),
    };
    let positions = vectors(asset, "vertex_position", vertices)?;
    let normals = vectors(asset, "vertex_normal", vertices)?;
    let vertex_triangle = indices(asset, "vertex_triangle", vertices)?;
    let vertex_triangle = below("vertex_triangle", vertex_triangle, triangles)?;
    let side = below("vertex_side", indices(asset, "vertex_side", vertices)?, 2)?;
    let corners = indices(asset, "element_vertices", elements.saturating_mul(3))?;
    let corners = below("element_vertices", corners, vertices)?;
    let lengths = indices(asset, "face_elements", faces)?;
    let total: u64 = lengths.iter().map(|&length| u64::from(length)).sum();
    if total != elements as u64 {
        let problem = format!("the faces have {total} elements, not {elements}");
        return Err(FileError::Value { name: "face_elements", problem });
    }
    let origins = vectors(asset, "face_origin", faces)?;
    let axes = vectors(asset, "face_axes", faces.saturating_mul(2))?;
    let mut face_of: [Vec<FaceId>; 2] = Default::default();
    for (of, name) in face_of.iter_mut().zip(["face_of_front", "face_of_back"]) {
        *of = indices(asset, name, triangles)?.into_iter().map(FaceId).collect();
    }

    let vertices = (0..vertices)
        .map(|i| DisplayVertex {
            position: positions[i],
            normal: normals[i],
            triangle: TriangleId(vertex_triangle[i]),
            side: if side[i] == 0 { Side::Front } else { Side::Back },
        })
        .collect();
    let elements = corners.as_chunks::<3>().0.iter().map(|&vertices| Element { vertices }).collect();
    let mut start = 0;
    let faces = (0..faces)
        .map(|i| {
            let end = start + lengths[i];
            let elements = std::mem::replace(&mut start, end)..end;
            Face { elements, origin: origins[i], axes: [axes[2 * i], axes[2 * i + 1]] }
        })
        .collect();
    Ok(DisplayMesh::new(vertices, elements, faces, face_of))
}

/// Appends named arrays. glTF has no empty ones: they are left out.
struct Writer<'a> {
    asset: &'a mut Asset,
}

impl Writer<'_> {
    fn vectors(
        &mut self,
        name: &'static str,
        values: impl Iterator<Item = Vec3>,
    ) -> Result<usize, FileError> {
        let flat: Vec<f32> = values.flat_map(|v| v.to_array()).collect();
        self.floats(name, &flat, 3)
    }

    fn scalars(&mut self, name: &'static str, values: &[f32]) -> Result<usize, FileError> {
        self.floats(name, values, 1)
    }

    fn floats(&mut self, name: &'static str, values: &[f32], components: usize) -> Result<usize, FileError> {
        if values.is_empty() {
            return Ok(0);
        }
        let accessor = self.asset.append_f32(name, values, components)?;
        self.asset.name_array(name, accessor);
        Ok(accessor)
    }

    fn indices(&mut self, name: &'static str, values: impl Iterator<Item = u32>) -> Result<(), FileError> {
        let values: Vec<u32> = values.collect();
        if !values.is_empty() {
            let accessor = self.asset.append_u32(name, &values)?;
            self.asset.name_array(name, accessor);
        }
        Ok(())
    }
}

fn term_array(term: Term) -> &'static str {
    match term {
        Term::Direct => "irradiance_direct",
        Term::Mirrored => "irradiance_mirrored",
        Term::Caustic => "irradiance_caustic",
        Term::Indirect => "irradiance_indirect",
    }
}

fn of_length<T>(name: &'static str, values: Option<Vec<T>>, expected: usize) -> Result<Vec<T>, FileError> {
    let values = values.unwrap_or_default();
    match values.len() == expected {
        true => Ok(values),
        false => Err(FileError::Array { name, expected, found: values.len() }),
    }
}

fn floats(asset: &Asset, name: &'static str, count: usize) -> Result<Vec<f32>, FileError> {
    finite(name, of_length(name, asset.array_f32(name), count)?, |value| value.is_finite())
}

/// The values of an array, all of which must be finite.
fn finite<T>(
    name: &'static str,
    values: Vec<T>,
    is_finite: impl Fn(&T) -> bool,
) -> Result<Vec<T>, FileError> {
    match values.iter().position(|value| !is_finite(value)) {
        Some(bad) => Err(FileError::Value { name, problem: format!("value {bad} is not finite") }),
        None => Ok(values),
    }
}

fn vectors(asset: &Asset, name: &'static str, count: usize) -> Result<Vec<Vec3>, FileError> {
    finite(name, of_length(name, asset.array_vec3(name), count)?, |value| value.is_finite())
}

fn indices(asset: &Asset, name: &'static str, count: usize) -> Result<Vec<u32>, FileError> {
    of_length(name, asset.array_u32(name), count)
}
