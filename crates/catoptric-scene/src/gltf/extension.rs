//! Which extensions are understood, which are approximated, and what to do about the others.

use super::document::Entity;
use super::report::Report;

/// Read in full as far as the ideal world goes.
const UNDERSTOOD: &[&str] = &[
    "EXT_mesh_gpu_instancing",
    "KHR_lights_punctual",
    "KHR_materials_clearcoat",
    "KHR_materials_diffuse_transmission",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_unlit",
    "KHR_materials_volume",
    "KHR_mesh_quantization",
    "KHR_node_visibility",
    "KHR_texture_transform",
];

/// Without an ideal counterpart: each material that has one says so, the scene is rendered without.
const APPROXIMATED: &[&str] = &[
    "KHR_materials_anisotropy",
    "KHR_materials_dispersion",
    "KHR_materials_iridescence",
    "KHR_materials_sheen",
    "KHR_materials_variants",
];

/// About the file, not about light.
const IRRELEVANT: &[&str] = &["KHR_xmp", "KHR_xmp_json_ld", "KHR_materials_common"];

/// What to do about an extension that is required and not understood.
fn hint(name: &str) -> &'static str {
    match name {
        "KHR_draco_mesh_compression" => {
            "decompress it: `gltf-transform copy in.glb out.glb` (npm install -g @gltf-transform/cli)"
        }
        "EXT_meshopt_compression" | "KHR_meshopt_compression" => {
            "decompress it: `gltf-transform copy in.glb out.glb` (npm install -g @gltf-transform/cli)"
        }
        "KHR_texture_basisu" => {
            "convert its textures: `gltf-transform ktxdecompress in.glb out.glb`, or export with PNG"
        }
        "EXT_texture_webp" | "EXT_texture_avif" => {
            "convert its textures: `gltf-transform png in.glb out.glb`"
        }
        "MSFT_texture_dds" => "export the file with PNG or JPEG textures",
        _ => "export the file without this extension",
    }
}

/// Reports required extensions that cannot be read, and optional ones that will be ignored.
pub(super) fn check(root: Entity<'_>, report: &Report) {
    let names = |key: &'static str| {
        let names = root.array(key, report).unwrap_or_default().iter();
        names.filter_map(move |name| {
            if name.as_str().is_none() {
                report.problem(key, "names of extensions", super::document::kind_of(name), "");
            }
            name.as_str()
        })
    };
    let known = |name: &str| UNDERSTOOD.contains(&name) || APPROXIMATED.contains(&name);
    let required: Vec<&str> = names("extensionsRequired").collect();
    for name in &required {
        if APPROXIMATED.contains(name) {
            report
                .warn("file", format!("requires {name}, which has no ideal counterpart: see its materials"));
        } else if !known(name) && !IRRELEVANT.contains(name) {
            report.problem(
                "extensionsRequired",
                "extensions that this program can read",
                format!("{name}, without which the file cannot be shown"),
                hint(name),
            );
        }
    }
    for name in names("extensionsUsed") {
        if !known(name) && !IRRELEVANT.contains(&name) && !required.contains(&name) {
            report.warn("file", format!("{name} is ignored"));
        }
    }
}
