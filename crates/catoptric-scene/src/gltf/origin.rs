//! Where a scene lies. What is small and far from the world's origin is read about a point of its own: at three kilometres, f32
//! positions are a quarter of a millimetre apart.

use std::path::Path;

use glam::DVec3;

use super::accessor::Accessor;
use super::asset::Asset;
use super::document::Table;
use super::node::Hierarchy;
use super::report::Report;

/// Diagonals of a scene between the world's origin and its centre beyond which it is far.
const FAR: f64 = 1.0;
/// Positions of a primitive that are looked at, at most: the origin need not be right, only near.
const LOOKS: usize = 64;
/// Primitives that are looked at, at most: many nodes may show one mesh of many.
const MOST_PRIMITIVES: usize = 1 << 16;

/// The point about which a scene is read, metres: the world's own origin where that is not far.
pub(super) fn origin(asset: &Asset, hierarchy: &Hierarchy) -> DVec3 {
    // Whoever reads the meshes says what is wrong with them.
    let silent = &Report::new(Path::new(""));
    let root = asset.root();
    let (mut min, mut max) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    let mut seen = 0;
    for node in hierarchy.nodes.iter().filter(|node| node.visible) {
        let Some(entity) = root.element(Table::NODES, node.index, silent) else { continue };
        // Its joints place what has a skin.
        if entity.raw("skin").is_some() {
            continue;
        }
        let Some((_, mesh)) = root.follow(&entity, "mesh", Table::MESHES, silent) else { continue };
        let primitives = mesh.objects("primitives", silent);
        seen += primitives.len();
        if seen > MOST_PRIMITIVES {
            return DVec3::ZERO;
        }
        for primitive in primitives {
            let attributes = primitive.object("attributes", silent);
            let index = attributes.and_then(|attributes| attributes.index("POSITION", silent));
            // Of a sparse one all indices would be read.
            let dense = |&index: &usize| {
                root.element(Table::ACCESSORS, index, silent).is_some_and(|a| a.raw("sparse").is_none())
            };
            let open = |index| Accessor::open(asset, index, &[3], &"POSITION", silent);
            let Some(positions) = index.filter(dense).and_then(open).filter(|p| !p.is_empty_shell()) else {
                continue;
            };
            for at in (0..positions.count).step_by(positions.count.div_ceil(LOOKS).max(1)) {
                let place =
                    node.world.transform_point3(DVec3::from_array(positions.get::<3>(at).map(f64::from)));
                if place.is_finite() {
                    min = min.min(place);
                    max = max.max(place);
                }
            }
        }
    }
    let (center, diagonal) = ((min + max) * 0.5, (max - min).length());
    if !(center.is_finite() && diagonal > 0.0 && center.length() > FAR * diagonal) {
        return DVec3::ZERO;
    }
    // A round number: the same when things move a little, and exact in a file.
    let step = libm::exp2(libm::log2(diagonal).floor());
    (center / step).round() * step
}
