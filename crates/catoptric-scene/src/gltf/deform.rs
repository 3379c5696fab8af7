//! What moves vertices before the node does: morph targets at their default weights, skins at the default pose.

use glam::{DMat4, DVec3};

use super::accessor::Accessor;
use super::asset::Asset;
use super::document::{Entity, Table};
use super::node::Hierarchy;
use super::report::Report;

/// Morph targets with a weight other than zero.
pub(super) struct Morph<'a> {
    targets: Vec<Target<'a>>,
}

struct Target<'a> {
    weight: f64,
    position: Option<Accessor<'a>>,
    normal: Option<Accessor<'a>>,
    tangent: Option<Accessor<'a>>,
}

impl<'a> Morph<'a> {
    /// The targets of a primitive under the given weights; `count` vertices.
    pub(super) fn read(
        asset: &'a Asset,
        primitive: &Entity<'a>,
        weights: &[f32],
        count: usize,
        report: &Report,
    ) -> Self {
        let mut targets = Vec::new();
        for (index, target) in primitive.objects("targets", report).into_iter().enumerate() {
            let weight = f64::from(weights.get(index).copied().unwrap_or(0.0));
            if weight == 0.0 {
                continue;
            }
            let open = |semantic: &str| {
                let accessor = target.index(semantic, report)?;
                let purpose = format!("{semantic} of morph target {index} of {}", primitive.place());
                let accessor = Accessor::open(asset, accessor, &[3], &purpose, report)?;
                if accessor.count < count {
                    report.warn(primitive.place(), format!("{semantic} of target {index} is too short"));
                    return None;
                }
                Some(accessor)
            };
            targets.push(Target {
                weight,
                position: open("POSITION"),
                normal: open("NORMAL"),
                tangent: open("TANGENT"),
            });
        }
        Self { targets }
    }

    /// Whether no target moves anything.
    pub(super) fn is_empty(&self) -> bool {
        self.targets.is_empty()
    }

    pub(super) fn position(&self, vertex: usize, base: DVec3) -> DVec3 {
        self.sum(vertex, base, |target| target.position.as_ref())
    }

    pub(super) fn normal(&self, vertex: usize, base: DVec3) -> DVec3 {
        self.sum(vertex, base, |target| target.normal.as_ref())
    }

    pub(super) fn tangent(&self, vertex: usize, base: DVec3) -> DVec3 {
        self.sum(vertex, base, |target| target.tangent.as_ref())
    }

    fn sum<'s>(
        &'s self,
        vertex: usize,
        base: DVec3,
        attribute: impl Fn(&'s Target<'a>) -> Option<&'s Accessor<'a>>,
    ) -> DVec3 {
        self.targets.iter().fold(base, |sum, target| match attribute(target) {
            Some(accessor) => sum + vector(accessor.get(vertex)) * target.weight,
            None => sum,
        })
    }
}

/// Joint matrices and the vertices' weights.
pub(super) struct Skin<'a> {
    /// world_from_joint · inverse bind matrix.
    matrices: Vec<DMat4>,
    influences: Vec<(Accessor<'a>, Accessor<'a>)>,
}

impl<'a> Skin<'a> {
    /// The skin of a node for one of its primitives; None where it cannot be used, which is then said.
    pub(super) fn read(
        asset: &'a Asset,
        skin: usize,
        attributes: &Entity<'a>,
        hierarchy: &Hierarchy,
        count: usize,
        report: &Report,
    ) -> Option<Self> {
        let skin = asset.root().element(Table::SKINS, skin, report)?;
        let unusable = |why: &str| {
            report.warn(skin.place(), format!("{why}: its meshes are shown unskinned"));
            None
        };
        let joints = skin.indices("joints", report)?;
        let bind = match skin.index("inverseBindMatrices", report) {
            None => None,
            Some(accessor) => Some(Accessor::open(asset, accessor, &[16], &"inverseBindMatrices", report)?),
        };
        if bind.as_ref().is_some_and(|bind| bind.count < joints.len()) {
            return unusable("has fewer inverse bind matrices than joints");
        }
        let mut matrices = Vec::with_capacity(joints.len());
        for (index, &joint) in joints.iter().enumerate() {
            let Some(node) = hierarchy.find(joint) else {
                return unusable("has a joint outside of the scene");
            };
            let inverse_bind = bind.as_ref().map_or(DMat4::IDENTITY, |bind| {
                DMat4::from_cols_array(&bind.get::<16>(index).map(f64::from))
            });
            matrices.push(node.world * inverse_bind);
        }
        let mut influences = Vec::new();
        for set in 0..2 {
            let (joints, weights) = (format!("JOINTS_{set}"), format!("WEIGHTS_{set}"));
            let (Some(joint_index), Some(weight_index)) =
                (attributes.index(&joints, report), attributes.index(&weights, report))
            else {
                continue;
            };
            let joints = Accessor::open(asset, joint_index, &[4], &joints, report)?;
            let weights = Accessor::open(asset, weight_index, &[4], &weights, report)?.into_shares();
            if joints.count < count || weights.count < count || !joints.is_unsigned() {
                return unusable("has joints or weights that do not fit its vertices");
            }
            influences.push((joints, weights));
        }
        if influences.is_empty() {
            return unusable("deforms a mesh without joints and weights");
        }
        Some(Self { matrices, influences })
    }

    /// world_from_mesh at a vertex: the weighted mean of its joints' matrices.
    pub(super) fn matrix(&self, vertex: usize) -> Option<DMat4> {
        let mut sum = DMat4::ZERO;
        let mut total = 0.0;
        for (joints, weights) in &self.influences {
            let (joints, weights) = (joints.get_u32::<4>(vertex), weights.get::<4>(vertex));
            for (&joint, &weight) in joints.iter().zip(&weights) {
                if weight != 0.0 {
                    sum += *self.matrices.get(joint as usize)? * f64::from(weight);
                    total += f64::from(weight);
                }
            }
        }
        let matrix = sum * (1.0 / total);
        (total > 0.0 && matrix.is_finite()).then_some(matrix)
    }
}

/// Three floats in double precision.
pub(super) fn vector(components: [f32; 3]) -> DVec3 {
    DVec3::from_array(components.map(f64::from))
}
