//! The node hierarchy: which nodes the scene shows, and where they are.

use glam::{DMat4, DQuat, DVec3};
use serde_json::Value;

use super::asset::Asset;
use super::document::{Entity, Table, as_index};
use super::options::LoadOptions;
use super::report::Report;

/// A node's own transform as the file gives it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Local {
    /// Any affine matrix; cannot be animated.
    Matrix(DMat4),
    /// Translation · rotation · scale.
    Trs(Trs),
}

/// Translation, rotation and scale.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Trs {
    pub(super) translation: DVec3,
    pub(super) rotation: DQuat,
    pub(super) scale: DVec3,
}

impl Trs {
    const IDENTITY: Self = Self { translation: DVec3::ZERO, rotation: DQuat::IDENTITY, scale: DVec3::ONE };

    pub(super) fn matrix(&self) -> DMat4 {
        DMat4::from_scale_rotation_translation(self.scale, self.rotation, self.translation)
    }
}

impl Local {
    pub(super) fn matrix(&self) -> DMat4 {
        match self {
            Self::Matrix(matrix) => *matrix,
            Self::Trs(trs) => trs.matrix(),
        }
    }
}

/// A node of the shown scene; parents come before their children.
#[derive(Clone, Debug)]
pub(super) struct Node {
    /// Index in the file.
    pub(super) index: usize,
    /// Position of the parent in [`Hierarchy::nodes`].
    pub(super) parent: Option<usize>,
    pub(super) name: String,
    pub(super) local: Local,
    pub(super) world: DMat4,
    /// False where KHR_node_visibility hides it or an ancestor.
    pub(super) visible: bool,
}

/// The nodes of the shown scene in the order of a depth-first walk.
#[derive(Clone, Debug, Default)]
pub(super) struct Hierarchy {
    pub(super) nodes: Vec<Node>,
    /// Per node of the file: its position in `nodes`.
    positions: Vec<Option<usize>>,
}

impl Hierarchy {
    /// Moves everything by an offset, metres.
    pub(super) fn shift(&mut self, offset: DVec3) {
        for node in &mut self.nodes {
            node.world.w_axis += offset.extend(0.0);
        }
    }

    /// Walks the scene that the file shows: the source of a solution, else the default scene, else the
    /// first, else every node without a parent.
    pub(super) fn read(asset: &Asset, options: &LoadOptions, report: &Report) -> Self {
        let root = asset.root();
        let count = root.table_len(Table::NODES);
        let roots = match asset.source().map(|s| s.scene).or_else(|| root.index("scene", report)) {
            Some(scene) => scene_roots(root, scene, report),
            None if root.table_len(Table::SCENES) > 0 => scene_roots(root, 0, report),
            None => {
                let roots = parentless(asset, count);
                if roots.is_empty() && count > 0 {
                    report.problem("nodes", "a tree of nodes", "only nodes with parents: a cycle", "");
                }
                roots
            }
        };
        let mut hierarchy = Self { nodes: Vec::new(), positions: vec![None; count] };

        // An explicit stack: depth is the file's choice. Pushed in reverse, nodes come in file order.
        let mut stack: Vec<(usize, Option<usize>, usize)> =
            roots.iter().rev().map(|&index| (index, None, 1)).collect();
        while let Some((index, parent, depth)) = stack.pop() {
            let Some(entity) = root.element(Table::NODES, index, report) else { continue };
            if let Some(position) = hierarchy.positions[index] {
                let ancestor = hierarchy.is_ancestor(position, parent);
                let found = if ancestor { "a cycle" } else { "more than one parent" };
                if ancestor {
                    report.problem(entity.place(), "a tree of nodes", found, "");
                } else {
                    report.warn(entity.place(), format!("has {found}: shown once, below the first"));
                }
                continue;
            }
            if depth > options.max_node_depth || hierarchy.nodes.len() >= options.max_nodes {
                let expected =
                    format!("at most {} nodes, {} levels deep", options.max_nodes, options.max_node_depth);
                report.problem(entity.place(), expected, "more", "raise the limit if this is meant");
                break;
            }
            let local = local_transform(&entity, report);
            let above = parent.map(|parent| &hierarchy.nodes[parent]);
            let world = above.map_or(DMat4::IDENTITY, |above| above.world) * local.matrix();
            if !world.is_finite() {
                report.problem(entity.place(), "a finite world transform", "one that overflows", "");
                continue;
            }
            let hidden = entity
                .extension("KHR_node_visibility", report)
                .is_some_and(|extension| extension.raw("visible") == Some(&Value::Bool(false)));
            let visible = !hidden && above.is_none_or(|above| above.visible);
            let position = hierarchy.nodes.len();
            hierarchy.positions[index] = Some(position);
            let name = entity.display_name();
            hierarchy.nodes.push(Node { index, parent, name, local, world, visible });
            let mut children = entity.indices("children", report).unwrap_or_default();
            if let Some(lost) = children.iter().find(|&&child| child >= count) {
                let found = format!("node {lost} of {count}");
                report.problem(entity.place(), "children: existing nodes", found, "");
                children.clear();
            }
            stack.extend(children.into_iter().rev().map(|child| (child, Some(position), depth + 1)));
        }
        hierarchy
    }

    /// The node of the file's index, if the scene shows it.
    pub(super) fn find(&self, index: usize) -> Option<&Node> {
        self.nodes.get((*self.positions.get(index)?)?)
    }

    /// Positions from the root down to `position`.
    pub(super) fn chain(&self, position: usize) -> Vec<usize> {
        let mut chain = vec![position];
        let mut at = position;
        while let Some(parent) = self.nodes[at].parent {
            chain.push(parent);
            at = parent;
        }
        chain.reverse();
        chain
    }

    fn is_ancestor(&self, position: usize, below: Option<usize>) -> bool {
        let mut at = below;
        while let Some(node) = at {
            if node == position {
                return true;
            }
            at = self.nodes[node].parent;
        }
        false
    }
}

fn scene_roots(root: Entity<'_>, scene: usize, report: &Report) -> Vec<usize> {
    root.element(Table::SCENES, scene, report)
        .and_then(|scene| scene.indices("nodes", report))
        .unwrap_or_default()
}

/// Nodes that are nobody's child.
pub(super) fn parentless(asset: &Asset, count: usize) -> Vec<usize> {
    let mut is_child = vec![false; count];
    let nodes = asset.json.get("nodes").and_then(Value::as_array).map_or(&[][..], Vec::as_slice);
    for child in
        nodes.iter().filter_map(|node| node.get("children")?.as_array()).flatten().filter_map(as_index)
    {
        if let Some(flag) = is_child.get_mut(child) {
            *flag = true;
        }
    }
    (0..count).filter(|&index| !is_child[index]).collect()
}

/// `matrix`, or translation, rotation and scale.
pub(super) fn local_transform(node: &Entity<'_>, report: &Report) -> Local {
    if let Some(columns) = node.numbers::<16>("matrix", report) {
        let mut matrix = DMat4::from_cols_array(&columns);
        if matrix.row(3) != glam::DVec4::W {
            report.warn(node.place(), "the last row of its matrix is not 0 0 0 1 and is ignored");
            matrix.x_axis.w = 0.0;
            matrix.y_axis.w = 0.0;
            matrix.z_axis.w = 0.0;
            matrix.w_axis.w = 1.0;
        }
        return Local::Matrix(matrix);
    }
    let mut trs = Trs::IDENTITY;
    if let Some(translation) = node.numbers("translation", report) {
        trs.translation = DVec3::from_array(translation);
    }
    if let Some(rotation) = node.numbers("rotation", report) {
        trs.rotation = unit_quaternion(rotation).unwrap_or_else(|| {
            report.warn(node.place(), "its rotation is zero and is ignored");
            DQuat::IDENTITY
        });
    }
    if let Some(scale) = node.numbers("scale", report) {
        trs.scale = DVec3::from_array(scale);
    }
    Local::Trs(trs)
}

/// The quaternion brought to unit length, if it has one.
pub(super) fn unit_quaternion(components: [f64; 4]) -> Option<DQuat> {
    let quaternion = DQuat::from_array(components);
    let length = quaternion.length();
    (length.is_finite() && length > 1e-12).then(|| quaternion / length)
}
