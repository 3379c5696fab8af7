//! Meshes: every primitive of every visible node becomes a surface of world-space triangles.

use std::collections::BTreeMap;

use glam::{DMat3, DMat4, DQuat, DVec3, Vec2, Vec3, Vec4};

use crate::id::{MaterialId, SurfaceId};
use crate::scene::{FARTHEST, SceneParts, Surface, Triangle, Vertex, is_within_reach};

use super::accessor::{Accessor, Component};
use super::asset::Asset;
use super::deform::{Morph, Skin, vector};
use super::document::{Entity, Table};
use super::node::{Hierarchy, Node};
use super::options::LoadOptions;
use super::report::Report;

/// The meshes of a scene as they are read.
pub(super) struct MeshReader<'a> {
    pub(super) asset: &'a Asset,
    pub(super) options: &'a LoadOptions,
    pub(super) report: &'a Report,
    pub(super) hierarchy: &'a Hierarchy,
    /// Materials of the file; index of the default material.
    pub(super) materials: usize,
    pub(super) parts: SceneParts,
    /// Per surface: angle in radians below which a normal counts as geometric.
    pub(super) normal_precision: Vec<f32>,
    names: BTreeMap<String, u32>,
    /// Triangles looked at, kept or not.
    work: u64,
    primitives: usize,
}

/// How a primitive's indices make triangles.
#[derive(Clone, Copy)]
enum Mode {
    List,
    Strip,
    Fan,
}

/// The attributes of a primitive.
struct Attributes<'a> {
    position: Accessor<'a>,
    normal: Option<Accessor<'a>>,
    tangent: Option<Accessor<'a>>,
    uv: [Option<Accessor<'a>>; 2],
    color: Option<Accessor<'a>>,
    morph: Morph<'a>,
    skin: Option<Skin<'a>>,
}

impl<'a> MeshReader<'a> {
    pub(super) fn new(
        asset: &'a Asset,
        options: &'a LoadOptions,
        report: &'a Report,
        hierarchy: &'a Hierarchy,
        materials: usize,
    ) -> Self {
        Self {
            asset,
            options,
            report,
            hierarchy,
            materials,
            parts: SceneParts::default(),
            normal_precision: Vec::new(),
            names: BTreeMap::new(),
            work: 0,
            primitives: 0,
        }
    }

    /// Reads the meshes of all visible nodes.
    pub(super) fn read_all(&mut self) {
        let hierarchy = self.hierarchy;
        for node in hierarchy.nodes.iter().filter(|node| node.visible) {
            let root = self.asset.root();
            let Some(entity) = root.element(Table::NODES, node.index, self.report) else { continue };
            let Some((_, mesh)) = root.follow(&entity, "mesh", Table::MESHES, self.report) else { continue };
            let weights = entity
                .number_list("weights", self.report)
                .or_else(|| mesh.number_list("weights", self.report))
                .unwrap_or_default();
            let instances = self.instances(&entity, node);
            let primitives = mesh.objects("primitives", self.report);
            if primitives.is_empty() {
                self.report.warn(mesh.place(), "has no primitives");
            }
            for (index, primitive) in primitives.iter().enumerate() {
                self.primitives += 1;
                if self.primitives > self.options.max_surfaces {
                    let expected = format!("at most {} surfaces", self.options.max_surfaces);
                    self.report.problem(entity.place(), expected, "more", "raise the limit if this is meant");
                    return;
                }
                let name = match primitives.len() {
                    1 => node.name.clone(),
                    _ => format!("{}/{index}", node.name),
                };
                let skin = entity.index("skin", self.report);
                if self.read_primitive(primitive, &name, &weights, skin, &instances).is_none()
                    && self.work > self.options.max_triangles
                {
                    return;
                }
            }
        }
    }

    /// World matrices of a node: one, or those of EXT_mesh_gpu_instancing.
    fn instances(&self, entity: &Entity<'a>, node: &Node) -> Vec<DMat4> {
        let report = self.report;
        let attributes = entity
            .extension("EXT_mesh_gpu_instancing", report)
            .and_then(|extension| extension.object("attributes", report));
        let Some(attributes) = attributes else { return vec![node.world] };
        let open = |semantic: &str, components: usize| {
            let accessor = attributes.index(semantic, report)?;
            Accessor::open(
                self.asset,
                accessor,
                &[components],
                &format!("{semantic} of {}", node.name),
                report,
            )
        };
        let (translation, rotation, scale) = (open("TRANSLATION", 3), open("ROTATION", 4), open("SCALE", 3));
        let counts: Vec<usize> =
            [&translation, &rotation, &scale].into_iter().flatten().map(|a| a.count).collect();
        let count = counts.first().copied().unwrap_or(0);
        if counts.iter().any(|&c| c != count) || count as u64 > self.options.max_triangles {
            report.problem(entity.place(), "instance attributes of one length", format!("{counts:?}"), "");
            return Vec::new();
        }
        (0..count)
            .map(|i| {
                let rotation = rotation
                    .as_ref()
                    .and_then(|r| super::node::unit_quaternion(r.get::<4>(i).map(f64::from)))
                    .unwrap_or(DQuat::IDENTITY);
                let translation = translation.as_ref().map_or(DVec3::ZERO, |t| vector(t.get(i)));
                let scale = scale.as_ref().map_or(DVec3::ONE, |s| vector(s.get(i)));
                node.world * DMat4::from_scale_rotation_translation(scale, rotation, translation)
            })
            .collect()
    }

    fn read_primitive(
        &mut self,
        primitive: &Entity<'a>,
        name: &str,
        weights: &[f32],
        skin: Option<usize>,
        instances: &[DMat4],
    ) -> Option<()> {
        let report = self.report;
        let mode = match primitive.index("mode", report).unwrap_or(4) {
            4 => Mode::List,
            5 => Mode::Strip,
            6 => Mode::Fan,
            0..=3 => {
                report.warn(format!("surface {name:?}"), "points and lines have no area and are skipped");
                return None;
            }
            other => {
                report.problem(primitive.place(), "a mode from 0 to 6", other, "");
                return None;
            }
        };
        let attributes = self.open_attributes(primitive, name, weights, skin)?;
        let count = attributes.position.count;

        // Which vertices make which triangle.
        let indices = match primitive.index("indices", report) {
            None => None,
            Some(accessor) => {
                let purpose = format!("indices of surface {name:?}");
                let accessor = Accessor::open(self.asset, accessor, &[1], &purpose, report)?;
                if !accessor.is_unsigned() {
                    report.problem(purpose, "unsigned integers", "other numbers", "");
                    return None;
                }
                Some(accessor)
            }
        };
        let slots = indices.as_ref().map_or(count, |indices| indices.count);
        let triangles = match mode {
            Mode::List => slots / 3,
            Mode::Strip | Mode::Fan => slots.saturating_sub(2),
        };
        self.work = self.work.saturating_add((triangles as u64).saturating_mul(instances.len() as u64));
        if self.work > self.options.max_triangles {
            let expected = format!("at most {} triangles", self.options.max_triangles);
            let found = format!("{} up to here", self.work);
            report.problem(format!("surface {name:?}"), expected, found, "raise the limit if this is meant");
            return None;
        }
        if matches!(mode, Mode::List) && slots % 3 != 0 {
            report.warn(
                format!("surface {name:?}"),
                format!("has {slots} corners: the last {} are left over", slots % 3),
            );
        }
        let (mut corners, mut flat) = (Vec::new(), 0_usize);
        for triangle in 0..triangles {
            let corner = mode.corners(triangle).map(|slot| match &indices {
                Some(indices) => indices.get_u32::<1>(slot)[0],
                None => slot as u32,
            });
            if let Some(&index) = corner.iter().find(|&&index| index as usize >= count) {
                let place = format!("indices of surface {name:?}");
                report.problem(place, format!("indices below {count}"), index, "export the file again");
                return None;
            }
            // Zeros that no byte stands behind are cheap to ask for: they must not become vertices.
            let [a, b, c] = corner;
            let absent = |index: u32| attributes.position.is_absent(index as usize);
            if a == b || b == c || c == a || (attributes.morph.is_empty() && corner.into_iter().all(absent)) {
                flat += 1;
                continue;
            }
            corners.push(corner);
        }
        if flat > 0 {
            let message = format!("{flat} triangles have no area and were dropped");
            report.warn(format!("surface {name:?}"), message);
        }
        let material = self.material(primitive, name)?;
        self.add_surface(name, material, &attributes, &corners, instances)
    }

    /// Opens what the primitive has; what does not fit its positions is left out with a warning.
    fn open_attributes(
        &self,
        primitive: &Entity<'a>,
        name: &str,
        weights: &[f32],
        skin: Option<usize>,
    ) -> Option<Attributes<'a>> {
        let (asset, report) = (self.asset, self.report);
        let place = || format!("surface {name:?}");
        let Some(attributes) = primitive.object("attributes", report) else {
            report.problem(place(), "attributes", "none", "");
            return None;
        };
        let open = |semantic: &str, components: &[usize]| {
            let accessor = attributes.index(semantic, report)?;
            Accessor::open(asset, accessor, components, &format!("{semantic} of {}", place()), report)
        };
        if attributes.raw("POSITION").is_none() {
            report.warn(place(), "has no positions and is skipped");
            return None;
        }
        let position = open("POSITION", &[3])?;
        let draco = primitive.extension("KHR_draco_mesh_compression", report);
        if position.is_empty_shell() && draco.is_some() {
            let hint =
                "decompress it: `gltf-transform copy in.glb out.glb` (npm install -g @gltf-transform/cli)";
            report.problem(place(), "vertex data", "only Draco-compressed data", hint);
            return None;
        }
        let count = position.count;
        let fitting = |semantic: &str, components: &[usize]| {
            let accessor = open(semantic, components)?;
            if accessor.count < count {
                let message =
                    format!("{semantic} has {} elements for {count} vertices and is ignored", accessor.count);
                report.warn(place(), message);
                return None;
            }
            Some(accessor)
        };
        Some(Attributes {
            normal: fitting("NORMAL", &[3]),
            tangent: fitting("TANGENT", &[4]),
            uv: [fitting("TEXCOORD_0", &[2]), fitting("TEXCOORD_1", &[2])],
            color: fitting("COLOR_0", &[3, 4]).map(Accessor::into_shares),
            morph: Morph::read(asset, primitive, weights, count, report),
            skin: skin.and_then(|skin| Skin::read(asset, skin, &attributes, self.hierarchy, count, report)),
            position,
        })
    }

    fn material(&self, primitive: &Entity<'a>, name: &str) -> Option<MaterialId> {
        match primitive.index("material", self.report) {
            None => Some(MaterialId(self.materials as u32)),
            Some(index) if index < self.materials => Some(MaterialId(index as u32)),
            Some(index) => {
                let place = format!("surface {name:?}");
                let found = format!("a reference to material {index} of {}", self.materials);
                self.report.problem(place, "an existing material", found, "");
                None
            }
        }
    }

    fn add_surface(
        &mut self,
        name: &str,
        material: MaterialId,
        attributes: &Attributes<'a>,
        corners: &[[u32; 3]],
        instances: &[DMat4],
    ) -> Option<()> {
        // Only the vertices that are used, in the file's order.
        let mut used: Vec<u32> = corners.iter().flatten().copied().collect();
        used.sort_unstable();
        used.dedup();
        let surface = SurfaceId(self.parts.surfaces.len() as u32);
        let first_triangle = self.parts.triangles.len() as u32;
        let mut losses = Losses::default();
        for world in instances {
            let base = self.parts.vertices.len();
            if base + used.len() > u32::MAX as usize {
                self.report.problem(format!("surface {name:?}"), "at most 2³² vertices", "more", "");
                return None;
            }
            for &vertex in &used {
                match attributes.vertex(vertex as usize, world, &mut losses) {
                    Some(vertex) => self.parts.vertices.push(vertex),
                    None => {
                        let place = format!("surface {name:?}, POSITION of vertex {vertex}");
                        let hint = "the mesh is damaged: repair it in the authoring program";
                        let expected = format_args!("coordinates of at most {FARTHEST:e} m");
                        self.report.problem(place, expected, "more, infinity or NaN", hint);
                        return None;
                    }
                }
            }
            let smooth = attributes.normal.is_some();
            // A mirroring transform turns the winding; fronts must stay fronts.
            let mirrored = attributes.skin.is_none() && DMat3::from_mat4(*world).determinant() < 0.0;
            for corner in corners {
                let at = |index: u32| used.binary_search(&index).map_or(0, |at| (base + at) as u32);
                let [a, b, c] = corner.map(at);
                let vertices = if mirrored { [a, c, b] } else { [a, b, c] };
                self.parts.triangles.push(Triangle { vertices, surface, smooth });
            }
        }
        losses.report(name, self.report);
        let triangles = first_triangle..self.parts.triangles.len() as u32;
        let name = self.unique_name(name);
        self.parts.surfaces.push(Surface { name, material, triangles });
        // Half a step of the coded normals, doubled.
        self.normal_precision.push(match attributes.normal.as_ref().map(|normal| normal.component) {
            Some(Component::I8 | Component::U8) => 1.5e-2,
            _ => 1e-3,
        });
        Some(())
    }

    /// The name, with a number behind it if it is taken.
    fn unique_name(&mut self, name: &str) -> String {
        let mut candidate = name.to_owned();
        loop {
            if !self.names.contains_key(&candidate) {
                self.names.insert(candidate.clone(), 1);
                return candidate;
            }
            let uses = self.names.entry(name.to_owned()).or_insert(1);
            *uses += 1;
            candidate = format!("{name} ({uses})");
        }
    }
}

impl Mode {
    /// The slots of triangle `i` (glTF 2.0 §3.7.2.1: strips alternate their winding).
    fn corners(self, i: usize) -> [usize; 3] {
        match self {
            Self::List => [3 * i, 3 * i + 1, 3 * i + 2],
            Self::Strip => [i, i + 1 + i % 2, i + 2 - i % 2],
            Self::Fan => [i + 1, i + 2, 0],
        }
    }
}

/// Data that could not be used as it is.
#[derive(Default)]
struct Losses {
    normals: usize,
    coordinates: usize,
    weights: usize,
}

impl Losses {
    fn report(&self, name: &str, report: &Report) {
        let say = |count: usize, what: &str| {
            if count > 0 {
                report.warn(format!("surface {name:?}"), format!("{count} {what}"));
            }
        };
        say(self.normals, "normals are zero or not finite: the faces' own are used");
        say(self.coordinates, "texture coordinates or colours are not finite and are ignored");
        say(self.weights, "vertices have no skin weights and follow their node");
    }
}

impl Attributes<'_> {
    /// A vertex in world space; None if it is nowhere.
    fn vertex(&self, index: usize, world: &DMat4, losses: &mut Losses) -> Option<Vertex> {
        let skinned = self.skin.as_ref().map(|skin| skin.matrix(index));
        if skinned == Some(None) {
            losses.weights += 1;
        }
        let world = skinned.flatten().unwrap_or(*world);
        let position = self.morph.position(index, vector(self.position.get(index)));
        let position = world.transform_point3(position).as_vec3();
        if !is_within_reach(position) {
            return None;
        }
        let linear = DMat3::from_mat4(world);
        let normal = self.normal.as_ref().map_or(Vec3::ZERO, |normal| {
            let normal = self.morph.normal(index, vector(normal.get(index)));
            let unit = unit(cofactor(linear) * normal);
            if unit == DVec3::ZERO {
                losses.normals += 1;
            }
            unit.as_vec3()
        });
        let tangent = self.tangent.as_ref().map_or(Vec4::ZERO, |tangent| {
            let [x, y, z, w] = tangent.get::<4>(index);
            let unit = unit(linear * self.morph.tangent(index, vector([x, y, z])));
            let side = if w < 0.0 { -1.0 } else { 1.0 };
            let side = if linear.determinant() < 0.0 { -side } else { side };
            if unit == DVec3::ZERO { Vec4::ZERO } else { unit.as_vec3().extend(side) }
        });
        let mut uv = [Vec2::ZERO; 2];
        for (uv, accessor) in uv.iter_mut().zip(&self.uv) {
            *uv = accessor.as_ref().map_or(Vec2::ZERO, |a| Vec2::from_array(a.get(index)));
            if !uv.is_finite() {
                losses.coordinates += 1;
                *uv = Vec2::ZERO;
            }
        }
        let mut color = self.color.as_ref().map_or(Vec4::ONE, |color| {
            let value = Vec4::from_array(color.get(index));
            if color.components == 3 { value.truncate().extend(1.0) } else { value }
        });
        if !color.is_finite() {
            losses.coordinates += 1;
            color = Vec4::ONE;
        }
        Some(Vertex { position, normal, tangent, uv, color: color.max(Vec4::ZERO) })
    }
}

/// The inverse transpose times |det|: turns normals, also where the transform is singular.
fn cofactor(m: DMat3) -> DMat3 {
    let cofactor =
        DMat3::from_cols(m.y_axis.cross(m.z_axis), m.z_axis.cross(m.x_axis), m.x_axis.cross(m.y_axis));
    if m.determinant() < 0.0 { cofactor * -1.0 } else { cofactor }
}

/// The unit vector, or zero where there is none.
fn unit(vector: DVec3) -> DVec3 {
    // Scaling by the largest component first keeps tiny and huge vectors from leaving f64's range.
    let largest = vector.abs().max_element();
    if !(largest > 0.0 && largest.is_finite()) {
        return DVec3::ZERO;
    }
    let scaled = vector / largest;
    scaled / scaled.length()
}
