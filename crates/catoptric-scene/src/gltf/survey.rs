//! Looks at what the scene does not use: damage there is no reason to refuse a file, but its author should
//! know.
//!
//! The same readers run over every element of every table, with a report of their own whose problems become
//! warnings.

use super::accessor::{Accessor, view_bytes};
use super::asset::Asset;
use super::camera::read_projection;
use super::document::{Entity, Table, kind_of};
use super::report::Report;

/// Elements of one table that are looked at.
const MOST_ELEMENTS: usize = 100_000;

/// Warns of every reference that leads nowhere and every accessor that cannot be read.
pub(super) fn survey(asset: &Asset, report: &Report) {
    let found = Report::new(std::path::Path::new(""));
    let look = |table: Table, at_one: &dyn Fn(&Entity<'_>)| {
        if let Some(value) =
            asset.root().raw(table.key()).filter(|value| value.as_array().is_none_or(Vec::is_empty))
        {
            found.problem("file", format!("{}: an array with elements", table.key()), kind_of(value), "");
        }
        for index in 0..asset.table_len(table).min(MOST_ELEMENTS) {
            if let Some(entity) = asset.root().element(table, index, &found) {
                at_one(&entity);
            }
        }
    };
    let refers = |from: &Entity<'_>, key: &str, table: Table| {
        if let Some(index) = from.index(key, &found) {
            exists(asset, from, index, table, &found);
        }
    };
    let refers_all = |from: &Entity<'_>, key: &str, table: Table| {
        for index in from.indices(key, &found).unwrap_or_default() {
            exists(asset, from, index, table, &found);
        }
    };

    look(Table::BUFFERS, &|buffer| {
        if buffer.index("byteLength", &found).is_none_or(|length| length == 0) {
            found.problem(buffer.place(), "a byteLength of at least 1", "none", "");
        }
    });
    look(Table::BUFFER_VIEWS, &|_| {});
    for index in asset.broken_views.keys() {
        view_bytes(asset, *index, &|| "nothing in the scene".to_owned(), &found);
    }
    for index in 0..asset.table_len(Table::ACCESSORS).min(MOST_ELEMENTS) {
        Accessor::open(asset, index, &[1, 2, 3, 4, 9, 16], &"unused", &found);
    }
    look(Table::MESHES, &|mesh| look_at_mesh(asset, mesh, &found));
    look(Table::NODES, &|node| {
        refers(node, "mesh", Table::MESHES);
        refers(node, "camera", Table::CAMERAS);
        refers(node, "skin", Table::SKINS);
        refers_all(node, "children", Table::NODES);
        super::node::local_transform(node, &found);
    });
    look(Table::SCENES, &|scene| refers_all(scene, "nodes", Table::NODES));
    look(Table::CAMERAS, &|camera| {
        read_projection(camera, &found);
    });
    look(Table::SKINS, &|skin| {
        if skin.raw("joints").is_none() {
            found.problem(skin.place(), "joints", "none", "");
        }
        refers_all(skin, "joints", Table::NODES);
        refers(skin, "inverseBindMatrices", Table::ACCESSORS);
        refers(skin, "skeleton", Table::NODES);
    });
    look(Table::TEXTURES, &|texture| {
        refers(texture, "source", Table::IMAGES);
        refers(texture, "sampler", Table::SAMPLERS);
    });
    look(Table::IMAGES, &|image| look_at_image(asset, image, &found));
    look(Table::SAMPLERS, &|_| {});
    look(Table::ANIMATIONS, &|animation| {
        let samplers = animation.objects("samplers", &found);
        for sampler in &samplers {
            refers(sampler, "input", Table::ACCESSORS);
            refers(sampler, "output", Table::ACCESSORS);
        }
        for channel in animation.objects("channels", &found) {
            if let Some(target) = channel.object("target", &found) {
                refers(&target, "node", Table::NODES);
            }
            if channel.index("sampler", &found).is_none_or(|sampler| sampler >= samplers.len()) {
                found.problem(animation.place(), "channels with an existing sampler", "others", "");
            }
        }
    });
    let problems = match found.finish() {
        Ok(_) => return,
        Err(error) => error.problems,
    };
    for problem in problems {
        report.warn(&problem.place, format!("expected {}, found {}", problem.expected, problem.found));
    }
}

/// Reports a reference that leads nowhere.
fn exists(asset: &Asset, from: &Entity<'_>, index: usize, table: Table, found: &Report) {
    let count = asset.table_len(table);
    if index >= count {
        let expected = format!("a reference into `{}`", table.key());
        found.problem(from.place(), expected, format!("{index} of {count}"), "");
    }
}

fn look_at_mesh(asset: &Asset, mesh: &Entity<'_>, found: &Report) {
    let primitives = mesh.objects("primitives", found);
    if primitives.is_empty() {
        found.problem(mesh.place(), "primitives", "none", "");
    }
    for primitive in primitives {
        for (key, table) in [("indices", Table::ACCESSORS), ("material", Table::MATERIALS)] {
            if let Some(index) = primitive.index(key, found) {
                exists(asset, &primitive, index, table, found);
            }
        }
        if let Some(mode) = primitive.index("mode", found).filter(|mode| *mode > 6) {
            found.problem(mesh.place(), "a mode from 0 to 6", mode, "");
        }
        let attributes = primitive.object("attributes", found);
        if attributes.is_none() {
            found.problem(mesh.place(), "attributes", "none", "");
        }
        for semantics in attributes.into_iter().chain(primitive.objects("targets", found)) {
            for key in semantics.keys() {
                if let Some(index) = semantics.index(key, found) {
                    exists(asset, &semantics, index, Table::ACCESSORS, found);
                }
            }
        }
    }
}

fn look_at_image(asset: &Asset, image: &Entity<'_>, found: &Report) {
    match image.index("bufferView", found) {
        None => found.problem(image.place(), "a uri or a bufferView", "neither", ""),
        Some(view) => {
            let bytes = view_bytes(asset, view, &|| image.place().to_string(), found);
            if bytes.is_some_and(|bytes| image::guess_format(bytes).is_err()) {
                found.problem(image.place(), "PNG or JPEG", "another format", "");
            }
        }
    }
}
