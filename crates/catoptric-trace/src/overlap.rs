//! What lies on top where triangles of one plane overlap: a picture in its wall's own plane, a lamp in the ceiling's, two sheets back to
//! back, a vase on a table.
//!
//! To rounding, a ray meets now the one and now the other. Here it is decided once for a side of a place: what shows a face to it
//! lies on what is seen from behind, then what is smaller on what is larger (pictures lie on walls), and what is opaque on what transmits:
//! light that passed the other would leave the plane, and with it what lies in it, behind.

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use catoptric_scene::{Scene, TriangleId};

use crate::boxes::BoxTree;
use crate::extent::Extent;
use crate::packet::TRANSMITS;
use crate::plane::Planes;

/// Something lies on the front of a triangle.
pub(crate) const COVERED_FRONT: u8 = 8;
/// Something lies on its back.
pub(crate) const COVERED_BACK: u8 = 16;

/// Triangles that overlap less than this share of how far they reach are neighbours that rounding moved: as far as what counts as one plane.
const ROUNDING: f64 = 1e-6;
/// Neighbours of a triangle that are looked at; where there are more, it counts as covered.
const MOST_NEIGHBOURS: usize = 1024;

/// What is covered, and by what.
#[derive(Clone, Debug, Default)]
pub(crate) struct Overlaps {
    /// Per triangle: [`COVERED_FRONT`], [`COVERED_BACK`]; empty where nothing is.
    covered: Vec<u8>,
    /// Per triangle: the lower lies on top among those of its plane; empty where nothing is covered.
    rank: Vec<u32>,
}

/// A triangle in its plane.
struct Member {
    id: u32,
    corners: [DVec2; 3],
    area: f64,
    surface: u32,
    /// Fronts on the side of the plane's normal.
    up: bool,
    has_back: bool,
    transmits: bool,
    rank: u32,
}

impl Member {
    fn shows(&self, up: bool) -> bool {
        self.has_back || self.up == up
    }

    fn bounds(&self) -> [DVec2; 2] {
        let [a, b, c] = self.corners;
        [a.min(b).min(c), a.max(b).max(c)]
    }
}

impl Overlaps {
    /// Looks through the planes of a scene. `flags` are those of the triangles' materials; `has_back` tells whether a triangle's back is a surface.
    pub(crate) fn new(
        scene: &Scene,
        extent: &Extent,
        planes: &Planes,
        flags: impl Fn(TriangleId) -> u8 + Sync,
        has_back: impl Fn(TriangleId) -> bool + Sync,
    ) -> Self {
        let count = scene.triangles().len();
        let kind = |id: TriangleId| {
            let normal = planes.plane(planes.of(id)).normal;
            let is_up = scene.geometric_normal(id).as_dvec3().dot(normal) >= 0.0;
            (scene.triangles()[id.index()].surface, flags(id) & TRANSMITS != 0, is_up)
        };
        // Most planes hold triangles of one kind, which do not lie on each other.
        let mut kinds = vec![None; planes.len()];
        let mut is_mixed = vec![false; planes.len()];
        for id in (0..count as u32).map(TriangleId) {
            let plane = planes.of(id).0 as usize;
            let first = kinds[plane].get_or_insert_with(|| kind(id));
            is_mixed[plane] = is_mixed[plane] || *first != kind(id);
        }
        let mut order: Vec<u32> =
            (0..count as u32).filter(|&id| is_mixed[planes.of(TriangleId(id)).0 as usize]).collect();
        order.sort_unstable_by_key(|&id| (planes.of(TriangleId(id)), id));
        let center = extent.inner.center;
        let groups: Vec<&[u32]> =
            order.chunk_by(|&a, &b| planes.of(TriangleId(a)) == planes.of(TriangleId(b))).collect();
        let found: Vec<Vec<(u32, u8, u32)>> = groups
            .into_par_iter()
            .with_max_len(1)
            .map(|group| {
                let normal = planes.plane(planes.of(TriangleId(group[0]))).normal;
                let members = group.iter().map(|&id| {
                    let triangle = TriangleId(id);
                    let (surface, transmits, up) = kind(triangle);
                    Member {
                        id,
                        corners: scene.corners(triangle).map(|p| flat(p.as_dvec3() - center, normal)),
                        area: f64::from(scene.area(triangle)),
                        surface: surface.0,
                        up,
                        has_back: has_back(triangle),
                        transmits,
                        rank: 0,
                    }
                });
                let reach =
                    group.iter().map(|&id| extent.reach_of(TriangleId(id))).fold(f64::INFINITY, f64::min);
                covered_in(members.collect(), ROUNDING * reach)
            })
            .collect();
        if found.iter().flatten().all(|&(_, covered, _)| covered == 0) {
            return Self::default();
        }
        let mut overlaps = Self { covered: vec![0; count], rank: vec![0; count] };
        for (id, covered, rank) in found.into_iter().flatten() {
            overlaps.covered[id as usize] = covered;
            overlaps.rank[id as usize] = rank;
        }
        overlaps
    }

    /// On which sides something lies on a triangle: [`COVERED_FRONT`], [`COVERED_BACK`].
    pub(crate) fn covered(&self, triangle: TriangleId) -> u8 {
        self.covered.get(triangle.index()).copied().unwrap_or(0)
    }

    /// The lower lies on top where two overlap.
    pub(crate) fn rank(&self, triangle: TriangleId) -> u32 {
        self.rank.get(triangle.index()).copied().unwrap_or(0)
    }
}

/// A point of a plane without the axis along which it is steepest.
fn flat(point: DVec3, normal: DVec3) -> DVec2 {
    let steep = normal.abs();
    if steep.z >= steep.x && steep.z >= steep.y {
        point.truncate()
    } else if steep.x >= steep.y {
        DVec2::new(point.y, point.z)
    } else {
        DVec2::new(point.z, point.x)
    }
}

/// The triangles of one plane: id, sides on which they are covered, rank.
fn covered_in(mut members: Vec<Member>, rounding: f64) -> Vec<(u32, u8, u32)> {
    rank(&mut members);
    let inset = |m: &Member| {
        let [min, max] = m.bounds();
        [(min + rounding).extend(0.0), (max - rounding).extend(0.0)]
    };
    let tree = BoxTree::new(members.iter().map(|m| inset(m).map(|p| p.as_vec3())));
    members
        .iter()
        .map(|lower| {
            let [min, max] = inset(lower);
            let covered = match tree.overlapping_at_most(min, max, MOST_NEIGHBOURS) {
                None => COVERED_FRONT | COVERED_BACK,
                Some(near) => near
                    .into_iter()
                    .map(|index| &members[index as usize])
                    .filter(|upper| lies_on(upper, lower) != 0 && overlap(lower, upper, rounding))
                    .fold(0, |sides, upper| sides | lies_on(upper, lower)),
            };
            (lower.id, covered, lower.rank)
        })
        .collect()
}

/// Ranks triangles by what their surface measures in the plane, the smallest first.
fn rank(members: &mut [Member]) {
    members.sort_unstable_by_key(|m| (m.surface, m.id));
    let mut surfaces: Vec<(f64, u32)> = members
        .chunk_by(|a, b| a.surface == b.surface)
        .map(|of_one| (of_one.iter().map(|m| m.area).sum(), of_one[0].surface))
        .collect();
    surfaces.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut ranks: Vec<(u32, u32)> =
        (0_u32..).zip(surfaces).map(|(rank, (_, surface))| (surface, rank)).collect();
    ranks.sort_unstable();
    for member in members {
        if let Ok(at) = ranks.binary_search_by_key(&member.surface, |&(surface, _)| surface) {
            member.rank = ranks[at].1;
        }
    }
}

/// On which sides of `lower` the other would lie where they overlap.
fn lies_on(upper: &Member, lower: &Member) -> u8 {
    if upper.transmits {
        return 0;
    }
    if lower.transmits {
        return COVERED_FRONT | COVERED_BACK;
    }
    let on = |up: bool| {
        let wins = match (upper.shows(up), lower.shows(up)) {
            (false, _) => false,
            (true, false) => true,
            (true, true) => upper.rank < lower.rank,
        };
        match (wins, up == lower.up) {
            (false, _) => 0,
            (true, true) => COVERED_FRONT,
            (true, false) => COVERED_BACK,
        }
    };
    on(true) | on(false)
}

/// Whether two triangles overlap by more than rounding: no edge of either has the other beyond it.
fn overlap(a: &Member, b: &Member, rounding: f64) -> bool {
    let apart = |a: &[DVec2; 3], b: &[DVec2; 3]| {
        (0..3).any(|i| {
            let (from, to, third) = (a[i], a[(i + 1) % 3], a[(i + 2) % 3]);
            let inwards = (to - from).perp().normalize_or_zero();
            let inwards = if inwards.dot(third - from) < 0.0 { -inwards } else { inwards };
            b.iter().all(|&p| inwards.dot(p - from) < rounding)
        })
    };
    !apart(&a.corners, &b.corners) && !apart(&b.corners, &a.corners)
}
