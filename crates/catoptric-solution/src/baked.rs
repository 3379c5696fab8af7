//! The baked room that any viewer shows: display elements by material with exposed light in `COLOR_0`, unlit; mirrors,
//! glass and lamps as they were; cameras and lights.

use std::collections::BTreeMap;

use glam::{DVec3, Vec2, Vec3, Vec4};
use serde_json::{Value, json};

use catoptric_scene::gltf::{AppendError, Asset, DisplayPrimitive};
use catoptric_scene::quantity::LUMINANCE;
use catoptric_scene::{Barycentric, Irradiance, MaterialId, Rgb, Scene, Side, TriangleId};

use crate::mesh::{DisplayMesh, DisplayVertex, FaceId};
use crate::solution::Solution;

/// Luminance of the 95th percentile of the lit area after exposure.
const BRIGHT: f32 = 0.9;
/// Most texture coordinate sets that are written for a material; scenes keep two.
const MOST_SETS: usize = 8;

/// Accessors per display vertex.
pub(crate) struct Attributes {
    pub(crate) position: usize,
    pub(crate) normal: usize,
    /// In the order of [`IRRADIANCE`].
    pub(crate) irradiance: Vec<usize>,
}

/// Attributes that carry the irradiance of each term.
const IRRADIANCE: [&str; 5] = [
    "_IRRADIANCE_DIRECT",
    "_IRRADIANCE_MIRRORED",
    "_IRRADIANCE_CAUSTIC",
    "_IRRADIANCE_INDIRECT",
    "_IRRADIANCE_PUNCTUAL",
];
const TEXCOORD: [&str; MOST_SETS] = [
    "TEXCOORD_0",
    "TEXCOORD_1",
    "TEXCOORD_2",
    "TEXCOORD_3",
    "TEXCOORD_4",
    "TEXCOORD_5",
    "TEXCOORD_6",
    "TEXCOORD_7",
];

/// Adds the baked scene and makes it the default one; returns the exposure factor of its colours.
pub(crate) fn append(
    asset: &mut Asset,
    scene: &Scene,
    solution: &Solution,
    attributes: &Attributes,
) -> Result<f32, AppendError> {
    let light = incident(solution);
    let exposure = exposure(&solution.mesh, &light);
    // Baked materials come behind the file's own.
    let materials = asset.json().get("materials").and_then(Value::as_array).map_or(0, Vec::len);
    let mut baker = Baker::new(scene, solution, attributes, &light, exposure);
    let mut nodes = Vec::new();
    let in_file = |material: MaterialId| Some(material.index()).filter(|&index| index < materials);
    for (material, elements) in baked_elements(scene, &solution.mesh) {
        nodes.push(baker.append_baked(asset, material, in_file(material), &elements)?);
    }
    for (material, triangles) in ideal_triangles(scene, &solution.mesh) {
        nodes.push(append_ideal(asset, scene, material, in_file(material), &triangles)?);
    }
    nodes.extend(scene.cameras().iter().map(|camera| asset.append_camera(camera)));
    nodes.extend(scene.lights().iter().map(|light| asset.append_light(light)));
    if scene.origin() != DVec3::ZERO {
        nodes = vec![asset.append_group("Catoptric solution", &nodes, scene.origin())];
    }
    asset.append_scene("Catoptric solution", &nodes);
    Ok(exposure)
}

/// All light that arrives at each vertex.
fn incident(solution: &Solution) -> Vec<Irradiance> {
    let mut light: Vec<Irradiance> = solution.punctual.iter().map(|&h| Irradiance(h)).collect();
    for values in &solution.irradiance {
        light.iter_mut().zip(values).for_each(|(sum, &h)| sum.0 += h);
    }
    light
}

/// The factor that brings the 95th percentile of the lit area to [`BRIGHT`].
fn exposure(mesh: &DisplayMesh, light: &[Irradiance]) -> f32 {
    let mut lit: Vec<(f32, f64)> = (0..mesh.elements.len() as u32)
        .map(|element| {
            let corners = mesh.elements[element as usize].vertices;
            let mean = corners.iter().map(|&v| white(light[v as usize]).dot(LUMINANCE)).sum::<f32>() / 3.0;
            (mean, f64::from(mesh.area(element)))
        })
        .filter(|(luminance, _)| *luminance > 0.0)
        .collect();
    lit.sort_by(|a, b| a.0.total_cmp(&b.0));
    let total: f64 = lit.iter().map(|(_, area)| area).sum();
    let mut below = 0.0;
    let bright = lit.iter().find(|(_, area)| {
        below += area;
        below >= 0.95 * total
    });
    bright.map_or(1.0, |(luminance, _)| BRIGHT / luminance)
}

/// Radiance of a white Lambertian surface under this irradiance.
fn white(light: Irradiance) -> Rgb {
    light.reflected(Rgb::ONE).radiance().0
}

/// Corners of the display elements of each material, counter-clockwise seen from their side.
fn baked_elements(scene: &Scene, mesh: &DisplayMesh) -> BTreeMap<MaterialId, Vec<u32>> {
    let mut groups: BTreeMap<MaterialId, Vec<u32>> = BTreeMap::new();
    for element in &mesh.elements {
        let [a, b, c] = element.vertices;
        let corner = |v: u32| &mesh.vertices[v as usize];
        let normal: Vec3 = element.vertices.iter().map(|&v| corner(v).normal).sum();
        let (p, q, r) = (corner(a).position, corner(b).position, corner(c).position);
        let faces_its_side = (q - p).cross(r - p).dot(normal) >= 0.0;
        let indices = groups.entry(scene.material_id_of(corner(a).triangle)).or_default();
        indices.extend(if faces_its_side { [a, b, c] } else { [a, c, b] });
    }
    groups
}

/// Triangles without display elements on either side: mirrors, glass, black lamps, unlit surfaces.
fn ideal_triangles(scene: &Scene, mesh: &DisplayMesh) -> BTreeMap<MaterialId, Vec<TriangleId>> {
    let mut groups: BTreeMap<MaterialId, Vec<TriangleId>> = BTreeMap::new();
    let [fronts, backs] = &mesh.face_of;
    for (index, faces) in fronts.iter().zip(backs).enumerate() {
        if faces == (&FaceId::NONE, &FaceId::NONE) {
            let triangle = TriangleId(index as u32);
            groups.entry(scene.material_id_of(triangle)).or_default().push(triangle);
        }
    }
    groups
}

/// Writes display elements. Vertex attributes are shared by all materials and written when the first one needs them.
struct Baker<'a> {
    scene: &'a Scene,
    vertices: &'a [DisplayVertex],
    light: &'a [Irradiance],
    exposure: f32,
    attributes: &'a Attributes,
    colors: Option<usize>,
    emitting_colors: Option<usize>,
    albedo: Option<usize>,
    texcoords: [Option<usize>; 2],
}

impl<'a> Baker<'a> {
    fn new(
        scene: &'a Scene,
        solution: &'a Solution,
        attributes: &'a Attributes,
        light: &'a [Irradiance],
        exposure: f32,
    ) -> Self {
        Self {
            scene,
            vertices: &solution.mesh.vertices,
            light,
            exposure,
            attributes,
            colors: None,
            emitting_colors: None,
            albedo: None,
            texcoords: [None; 2],
        }
    }

    /// Adds the elements of one material, `original` in the file (none: glTF's default); returns their node.
    fn append_baked(
        &mut self,
        asset: &mut Asset,
        material: MaterialId,
        original: Option<usize>,
        indices: &[u32],
    ) -> Result<usize, AppendError> {
        let read = &self.scene.materials()[material.index()];
        let mut attributes = vec![("POSITION", self.attributes.position), ("NORMAL", self.attributes.normal)];
        let baked = if read.emits() {
            // Viewers add no emission to unlit surfaces: their colours have it, with the albedo.
            attributes.push(("COLOR_0", self.emitting_colors(asset)?));
            let source = original.and_then(|index| asset.json().get("materials")?.get(index)).cloned();
            asset.append_material(json!({
                "name": read.name,
                "pbrMetallicRoughness": { "metallicFactor": 0.0 },
                "extensions": { "KHR_materials_unlit": {} },
                "extras": { "catoptric": { "original": source, "index": original } },
            }))
        } else {
            attributes.push(("COLOR_0", self.colors(asset)?));
            asset.append_baked_material(original)?
        };
        let sets = texture_sets(asset, Some(baked));
        for (set, name) in TEXCOORD.into_iter().enumerate().take(sets) {
            attributes.push((name, self.texcoord(asset, set.min(1))?));
        }
        if indices.iter().any(|&v| self.vertex_color(&self.vertices[v as usize]) != Vec4::ONE) {
            attributes.push(("_ALBEDO", self.albedo(asset)?));
        }
        attributes.extend(IRRADIANCE.into_iter().zip(self.attributes.irradiance.iter().copied()));
        let indices = asset.append_u32("indices", indices)?;
        let primitive = DisplayPrimitive { attributes, indices: Some(indices), material: Some(baked) };
        let mesh = asset.append_mesh(&read.name, &[primitive]);
        Ok(asset.append_node(&read.name, mesh))
    }

    fn colors(&mut self, asset: &mut Asset) -> Result<usize, AppendError> {
        let exposed = self.light.iter().map(|&light| white(light));
        append_once(&mut self.colors, asset, "COLOR_0", exposed.flat_map(|l| display(l * self.exposure)), 3)
    }

    fn emitting_colors(&mut self, asset: &mut Asset) -> Result<usize, AppendError> {
        let radiance = |vertex: &DisplayVertex, light: Irradiance| {
            let point = self.scene.surface_point(vertex.triangle, place(self.scene, vertex));
            let emits = vertex.side == Side::Front || self.scene.material_of(vertex.triangle).double_sided;
            let own = if emits { point.emission.0 } else { Rgb::ZERO };
            own + light.reflected(point.diffuse).radiance().0
        };
        let colors = self.vertices.iter().zip(self.light);
        let colors = colors.flat_map(|(v, &light)| display(radiance(v, light) * self.exposure));
        append_once(&mut self.emitting_colors, asset, "COLOR_0 of emitters", colors, 3)
    }

    fn albedo(&mut self, asset: &mut Asset) -> Result<usize, AppendError> {
        let (scene, vertices) = (self.scene, self.vertices);
        let colors = vertices.iter().flat_map(|v| interpolate(scene, v, |corner| corner.color).to_array());
        append_once(&mut self.albedo, asset, "_ALBEDO", colors, 4)
    }

    fn texcoord(&mut self, asset: &mut Asset, set: usize) -> Result<usize, AppendError> {
        let (scene, vertices) = (self.scene, self.vertices);
        let uv = vertices.iter().flat_map(|v| scene.uv(v.triangle, place(scene, v), set as u8).to_array());
        append_once(&mut self.texcoords[set], asset, TEXCOORD[set], uv, 2)
    }

    fn vertex_color(&self, vertex: &DisplayVertex) -> Vec4 {
        interpolate(self.scene, vertex, |corner| corner.color)
    }
}

/// The accessor in `slot`, written now if it is not there.
fn append_once(
    slot: &mut Option<usize>,
    asset: &mut Asset,
    name: &str,
    values: impl Iterator<Item = f32>,
    components: usize,
) -> Result<usize, AppendError> {
    if let Some(accessor) = *slot {
        return Ok(accessor);
    }
    let values: Vec<f32> = values.collect();
    let accessor = asset.append_f32(name, &values, components)?;
    *slot = Some(accessor);
    Ok(accessor)
}

/// A colour that glTF can hold.
fn display(color: Rgb) -> [f32; 3] {
    color.clamp(Rgb::ZERO, Rgb::ONE).to_array()
}

/// Where a display vertex lies on its triangle: the least-squares solution of p = a + u·(b − a) + v·(c − a).
fn place(scene: &Scene, vertex: &DisplayVertex) -> Barycentric {
    let [a, b, c] = scene.corners(vertex.triangle).map(|p| p.as_dvec3());
    let (e, f, p) = (b - a, c - a, vertex.position.as_dvec3() - a);
    let (ee, ef, ff, pe, pf) = (e.dot(e), e.dot(f), f.dot(f), p.dot(e), p.dot(f));
    let determinant = ee * ff - ef * ef;
    let (u, v) = ((pe * ff - pf * ef) / determinant, (pf * ee - pe * ef) / determinant);
    match u.is_finite() && v.is_finite() {
        true => Barycentric { u: u as f32, v: v as f32 },
        false => Barycentric { u: 0.0, v: 0.0 },
    }
}

/// A corner attribute at a display vertex.
fn interpolate(
    scene: &Scene,
    vertex: &DisplayVertex,
    attribute: impl Fn(&catoptric_scene::Vertex) -> Vec4,
) -> Vec4 {
    let at = place(scene, vertex);
    let corners = scene.triangles()[vertex.triangle.index()].vertices;
    let [a, b, c] = corners.map(|v| attribute(&scene.vertices()[v as usize]));
    if a == b && a == c { a } else { a + (b - a) * at.u + (c - a) * at.v }
}

/// Adds triangles that no light is baked on, with their original material; returns their node.
fn append_ideal(
    asset: &mut Asset,
    scene: &Scene,
    material: MaterialId,
    original: Option<usize>,
    triangles: &[TriangleId],
) -> Result<usize, AppendError> {
    // Corners of smooth surfaces are shared, those of flat ones have their triangle's normal.
    let mut corners: Vec<(u32, Vec3)> = Vec::new();
    let mut known: BTreeMap<u32, u32> = BTreeMap::new();
    let mut indices = Vec::with_capacity(3 * triangles.len());
    for &triangle in triangles {
        let flat = scene.geometric_normal(triangle);
        let smooth = scene.is_smooth(triangle);
        for vertex in scene.triangles()[triangle.index()].vertices {
            let next = corners.len() as u32;
            let index = if smooth { *known.entry(vertex).or_insert(next) } else { next };
            if index == next {
                let own = scene.vertices()[vertex as usize].normal;
                corners.push((vertex, if smooth && own != Vec3::ZERO { own } else { flat }));
            }
            indices.push(index);
        }
    }
    let vertices: Vec<_> = corners.iter().map(|&(vertex, _)| &scene.vertices()[vertex as usize]).collect();

    let mut append = |name: &'static str, values: Vec<f32>, components| {
        asset.append_f32(name, &values, components).map(|accessor| (name, accessor))
    };
    let mut attributes = vec![
        append("POSITION", vertices.iter().flat_map(|v| v.position.to_array()).collect(), 3)?,
        append("NORMAL", corners.iter().flat_map(|(_, normal)| normal.to_array()).collect(), 3)?,
    ];
    if vertices.iter().any(|v| v.color != Vec4::ONE) {
        let colors = vertices.iter().flat_map(|v| v.color.clamp(Vec4::ZERO, Vec4::ONE).to_array());
        attributes.push(append("COLOR_0", colors.collect(), 4)?);
    }
    for (set, name) in TEXCOORD.into_iter().enumerate().take(texture_sets(asset, original)) {
        let uv = |v: &&catoptric_scene::Vertex| -> Vec2 { v.uv[set.min(1)] };
        let values: Vec<f32> = vertices.iter().flat_map(|v| uv(v).to_array()).collect();
        attributes.push((name, asset.append_f32(name, &values, 2)?));
    }
    let indices = asset.append_u32("indices", &indices)?;
    let name = &scene.materials()[material.index()].name;
    let mesh = asset
        .append_mesh(name, &[DisplayPrimitive { attributes, indices: Some(indices), material: original }]);
    Ok(asset.append_node(name, mesh))
}

/// How many texture coordinate sets a material of the file asks for.
fn texture_sets(asset: &Asset, material: Option<usize>) -> usize {
    let material = material.and_then(|index| asset.json().get("materials")?.get(index));
    material.map_or(0, sets_below).min(MOST_SETS)
}

/// Sets below a JSON value: each object under a key that ends in `Texture` uses one, 0 unless it says otherwise.
fn sets_below(value: &Value) -> usize {
    let Value::Object(object) = value else { return 0 };
    let sets = object.iter().filter(|(key, _)| *key != "extras").map(|(key, value)| {
        let moved = value.pointer("/extensions/KHR_texture_transform/texCoord");
        let set = moved.or_else(|| value.get("texCoord")).and_then(Value::as_u64).unwrap_or(0);
        let own = if key.ends_with("Texture") { set as usize + 1 } else { 0 };
        own.max(sets_below(value))
    });
    sets.max().unwrap_or(0)
}
