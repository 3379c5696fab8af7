//! What may lie in a pyramid: from a point to a polygon, such as all shadow rays from a receiver to a lamp at once. Nothing, or a few
//! triangles, whose shadows are then cut out of the lamp, or which the rays ask instead of the tree.
//!
//! Source: shaft culling (Haines & Wallace 1994), with a point for one of the two ends. The answer is on the safe side:
//! "empty" is certain, and what only comes near counts as in the way. Keys in docs/references.md: HainesWallace1994.

use std::ops::Range;

use glam::{DVec2, DVec3, Vec3, Vec4};

use catoptric_scene::TriangleId;

use crate::eight::{Eight, at_level};
use crate::packet::{CUT_OUT, PASSES, Packet};
use crate::plane::{Plane, PlaneId};
use crate::tree::{LEAF, Node, Stack, Tree, leaf};

/// Corners of a base, at most.
const MAX_CORNERS: usize = 6;

/// A convex polygon of few corners.
#[derive(Clone, Copy, Debug)]
pub struct Base {
    corners: [DVec3; MAX_CORNERS],
    count: usize,
    center: DVec3,
}

impl Base {
    /// A convex polygon, or a rectangle around it if it has many corners. `None` if it has no area.
    #[inline]
    pub fn around(polygon: &[DVec3]) -> Option<Self> {
        let center = polygon.iter().sum::<DVec3>() / polygon.len() as f64;
        let mut corners = [DVec3::ZERO; MAX_CORNERS];
        if polygon.len() <= MAX_CORNERS {
            corners[..polygon.len()].copy_from_slice(polygon);
            return Some(Self { corners, count: polygon.len(), center });
        }
        let first = polygon[0];
        let area: DVec3 = polygon.windows(2).map(|w| (w[0] - first).cross(w[1] - first)).sum();
        let x = (first - center).try_normalize()?;
        let y = area.try_normalize()?.cross(x);
        let mut low = DVec2::INFINITY;
        let mut high = DVec2::NEG_INFINITY;
        for corner in polygon {
            let at = DVec2::new(x.dot(*corner - center), y.dot(*corner - center));
            low = low.min(at);
            high = high.max(at);
        }
        for (corner, (s, t)) in
            corners.iter_mut().zip([(low.x, low.y), (high.x, low.y), (high.x, high.y), (low.x, high.y)])
        {
            *corner = center + x * s + y * t;
        }
        Some(Self { corners, count: 4, center })
    }

    /// Its corners.
    pub fn corners(&self) -> &[DVec3] {
        &self.corners[..self.count]
    }

    /// The mean of the corners of the polygon that it is around.
    pub fn center(&self) -> DVec3 {
        self.center
    }

    /// Its mirror image.
    pub fn reflected(mut self, plane: &Plane) -> Self {
        for corner in &mut self.corners[..self.count] {
            *corner = plane.reflect_point(*corner);
        }
        self.center = plane.reflect_point(self.center);
        self
    }
}

/// An end of a pyramid: inside is where normal · x is not below the offset.
#[derive(Clone, Copy, Debug)]
pub struct End {
    normal: DVec3,
    offset: f64,
    /// Triangles in it are not in the way.
    id: PlaneId,
}

impl End {
    /// The plane through `point` with the unit `normal`, which points inside.
    pub fn new(point: DVec3, normal: DVec3, id: PlaneId) -> Self {
        Self { normal, offset: normal.dot(point), id }
    }

    /// The plane of `base`, whose inside is where `eye` is.
    pub fn behind(base: &Base, eye: DVec3, id: PlaneId) -> Option<Self> {
        let first = base.corners[0];
        let area: DVec3 = base.corners().windows(2).map(|w| (w[0] - first).cross(w[1] - first)).sum();
        let normal = area.try_normalize()?;
        Some(Self::new(base.center, if normal.dot(eye - base.center) < 0.0 { -normal } else { normal }, id))
    }

    /// A mirror, whose inside is where `point` is.
    pub fn mirror(plane: &Plane, id: PlaneId, point: DVec3) -> Self {
        let sign = if plane.normal.dot(point) < plane.offset { -1.0 } else { 1.0 };
        Self { normal: plane.normal * sign, offset: plane.offset * sign, id }
    }

    /// Its unit normal, to the inside.
    pub fn normal(&self) -> DVec3 {
        self.normal
    }

    /// Inside, normal · x is not below this.
    pub fn offset(&self) -> f64 {
        self.offset
    }

    /// Where the line from `from` towards `to` meets it, if not before `from`.
    fn meets(&self, from: DVec3, to: DVec3) -> DVec3 {
        let (a, b) = (self.normal.dot(from) - self.offset, self.normal.dot(to) - self.offset);
        if (a < 0.0) == (b < 0.0) { from } else { from.lerp(to, a / (a - b)) }
    }
}

/// The part between two planes of the pyramid from an eye to a convex polygon.
#[derive(Clone, Debug)]
pub struct Pyramid {
    /// Corners of a hull: the eye or the near end, then the base.
    hull: [Vec3; 2 * MAX_CORNERS],
    count: usize,
    /// Outward normals and offsets: sides and ends.
    planes: [(Vec3, f32); MAX_CORNERS + 2],
    sides: usize,
    eye: Vec3,
    /// Half of its width, metres per metre from the eye, where it is narrowest.
    spread: f32,
    min: Vec3,
    max: Vec3,
    ignore: [u32; 2],
    /// Triangles that are not in the way: those of the light.
    skip: Range<u32>,
}

/// Share of a pyramid's half width by which a triangle may reach inside and count as one that touches.
const TOUCH: f32 = 0.01;
/// Rounding of positions as a share of the padding of the boxes: 2⁻²² of the scene of 2e-6. An eye that much behind a wall is behind it.
const ROUNDING: f32 = 0.125;

impl Pyramid {
    /// From `eye` to `base`, between the planes `near` and `far`; the triangles `skip` are not in the way. `None` where it is
    /// too flat to tell inside from outside.
    #[inline]
    pub fn new(eye: DVec3, base: &Base, near: End, far: End, skip: Range<u32>) -> Option<Self> {
        let mut planes = [(Vec3::ZERO, 0.0); MAX_CORNERS + 2];
        let corners = base.corners();
        let axis = (base.center - eye).try_normalize()?;
        let mut spread = 1.0_f64;
        for (index, &corner) in corners.iter().enumerate() {
            let (a, b) = (corner - eye, corners[(index + 1) % corners.len()] - eye);
            let side = a.cross(b).try_normalize()?;
            let outward = if side.dot(axis) > 0.0 { -side } else { side };
            spread = spread.min(-outward.dot(axis));
            planes[index] = (outward.as_vec3(), outward.dot(eye) as f32);
        }
        let sides = corners.len() + 2;
        for (plane, end) in planes[corners.len()..].iter_mut().zip([near, far]) {
            *plane = ((-end.normal).as_vec3(), -end.offset as f32);
        }
        let mut hull = [Vec3::ZERO; 2 * MAX_CORNERS];
        for (index, &corner) in corners.iter().enumerate() {
            // From the eye on, or from where the near end is.
            hull[index] = near.meets(eye, corner).as_vec3();
            let last = if far.normal.dot(corner) < far.offset { far.meets(eye, corner) } else { corner };
            hull[corners.len() + index] = last.as_vec3();
        }
        let count = 2 * corners.len();
        let min = hull[..count].iter().copied().reduce(Vec3::min)?;
        let max = hull[..count].iter().copied().reduce(Vec3::max)?;
        let (eye, spread) = (eye.as_vec3(), spread as f32);
        Some(Self { hull, count, planes, sides, eye, spread, min, max, ignore: [near.id.0, far.id.0], skip })
    }

    /// Whether all of some corners lie on one side of it: what is between them is not in it.
    pub fn misses(&self, corners: &[Vec3]) -> bool {
        self.planes().iter().any(|(normal, offset)| corners.iter().all(|&c| normal.dot(c) >= *offset))
    }

    fn planes(&self) -> &[(Vec3, f32)] {
        &self.planes[..self.sides]
    }

    /// The children whose boxes are not certainly outside.
    #[inline(always)]
    fn meets_boxes<E: Eight>(&self, e: E, node: &Node) -> u32 {
        let mut near = u32::MAX;
        for axis in 0..3 {
            near &= e.at_most(e.load(&node.bounds[axis]), e.splat(self.max[axis]));
            near &= e.at_most(e.splat(self.min[axis]), e.load(&node.bounds[axis + 3]));
        }
        for (normal, offset) in self.planes() {
            if near == 0 {
                return 0;
            }
            let mut least = e.splat(0.0);
            for axis in 0..3 {
                let bound = &node.bounds[if normal[axis] > 0.0 { axis } else { axis + 3 }];
                least = e.add(least, e.multiply(e.splat(normal[axis]), e.load(bound)));
            }
            // The boxes are padded by more than the rounding of this sum.
            near &= e.at_most(least, e.splat(*offset));
        }
        near
    }

    /// The triangles of a packet, bit by bit, that are not certainly outside, whatever its neighbours are. What reaches inside by
    /// less than `slack` only touches, but not near the eye: there the pyramid is not as wide as that.
    #[inline]
    fn meets_packet(&self, packet: &Packet, slack: f32) -> u32 {
        let splat = Vec4::splat;
        let mut lanes = 0;
        for lane in 0..4 {
            let own = self.skip.contains(&packet.ids[lane]) || self.ignore.contains(&packet.planes[lane]);
            // Lanes that are left repeat the first.
            let again = lane > 0 && packet.ids[lane] == packet.ids[0];
            lanes |= u32::from(!own && !again) << lane;
        }
        if lanes == 0 {
            return 0;
        }
        let [a, b, c] = &packet.corners;
        for axis in 0..3 {
            let low = a[axis].min(b[axis]).min(c[axis]);
            let high = a[axis].max(b[axis]).max(c[axis]);
            let meets = low.cmple(splat(self.max[axis])) & high.cmpge(splat(self.min[axis]));
            lanes &= meets.bitmask();
        }
        if lanes == 0 {
            return 0;
        }
        let mut touches = 0;
        for (normal, offset) in self.planes() {
            let height = |corner: &[Vec4; 3]| {
                corner[0] * splat(normal.x) + corner[1] * splat(normal.y) + corner[2] * splat(normal.z)
            };
            let [a, b, c] = [0, 1, 2].map(|k| height(&packet.corners[k]));
            let least = a.min(b).min(c);
            lanes &= !least.cmpge(splat(*offset)).bitmask();
            if lanes == 0 {
                return 0;
            }
            touches |= least.cmpge(splat(*offset - slack)).bitmask();
        }
        // The plane of the triangle.
        let edge = |p: &[Vec4; 3], q: &[Vec4; 3]| [0, 1, 2].map(|k| q[k] - p[k]);
        let (e, f) = (edge(a, b), edge(a, c));
        let n = [e[1] * f[2] - e[2] * f[1], e[2] * f[0] - e[0] * f[2], e[0] * f[1] - e[1] * f[0]];
        let length2 = n[0] * n[0] + n[1] * n[1] + n[2] * n[2];
        let length = Vec4::new(length2.x.sqrt(), length2.y.sqrt(), length2.z.sqrt(), length2.w.sqrt());
        let height =
            |p: Vec3| (splat(p.x) - a[0]) * n[0] + (splat(p.y) - a[1]) * n[1] + (splat(p.z) - a[2]) * n[2];
        let is_far =
            height(self.eye).abs().cmpge(length * (slack / (TOUCH * self.spread).max(f32::MIN_POSITIVE)));
        lanes &= !(touches & is_far.bitmask());
        if lanes == 0 {
            return 0;
        }
        let slack = length * (slack * ROUNDING);
        let mut low = height(self.hull[0]);
        let mut high = low;
        for &corner in &self.hull[1..self.count] {
            let h = height(corner);
            low = low.min(h);
            high = high.max(h);
        }
        let beside = low.cmpge(-slack) | high.cmple(slack);
        lanes & !beside.bitmask()
    }
}

/// What may be in the way in a pyramid: nothing outside it is.
#[derive(Clone, Debug, Default)]
pub struct Suspects {
    /// Packets, and which of their triangles, bit by bit.
    packets: Vec<(u32, u8)>,
}

/// A triangle that may be in the way.
#[derive(Clone, Copy, Debug)]
pub struct Suspect {
    /// Which.
    pub id: TriangleId,
    /// Its corners, metres.
    pub corners: [Vec3; 3],
    /// Its plane.
    pub plane: PlaneId,
    /// It lets light pass undeviated.
    pub passes: bool,
    /// It has holes.
    pub cut_out: bool,
}

impl Suspects {
    /// Nothing at all is in the way, for certain.
    pub fn is_empty(&self) -> bool {
        self.packets.is_empty()
    }

    /// Packets of four triangles: what one ray costs that asks them.
    pub fn packet_count(&self) -> usize {
        self.packets.len()
    }

    /// Triangles.
    pub fn triangle_count(&self) -> usize {
        self.packets.iter().map(|(_, lanes)| lanes.count_ones() as usize).sum()
    }

    pub(crate) fn packets<'a>(&'a self, tree: &'a Tree) -> impl Iterator<Item = &'a Packet> {
        self.packets.iter().map(|&(index, _)| &tree.packets[index as usize])
    }

    pub(crate) fn triangles<'a>(&'a self, tree: &'a Tree) -> impl Iterator<Item = Suspect> + 'a {
        self.packets(tree).zip(&self.packets).flat_map(|(packet, &(_, lanes))| {
            (0..4).filter(move |lane| lanes >> lane & 1 == 1).map(|lane| Suspect {
                id: TriangleId(packet.ids[lane]),
                corners: packet.corners.map(|corner| Vec3::from_array(corner.map(|axis| axis[lane]))),
                plane: PlaneId(packet.planes[lane]),
                passes: packet.flags[lane] & PASSES != 0,
                cut_out: packet.flags[lane] & CUT_OUT != 0,
            })
        })
    }
}

impl Tree {
    /// Finds the triangles that may lie in the pyramid, the same in any tree; `false` if they are more than `most`. Triangles that
    /// touch it from outside by less than the padding of the boxes do not count.
    pub(crate) fn suspects_in(&self, pyramid: &Pyramid, most: usize, suspects: &mut Suspects) -> bool {
        suspects.packets.clear();
        at_level!(self.level, eight => self.suspects_by(eight, pyramid, most, suspects).is_some())
    }

    #[inline(always)]
    fn suspects_by<E: Eight>(
        &self,
        eight: E,
        pyramid: &Pyramid,
        most: usize,
        suspects: &mut Suspects,
    ) -> Option<()> {
        if self.nodes.is_empty() {
            return Some(());
        }
        let mut room = most;
        let mut stack = Stack::<u32, 64>::new();
        stack.push(0);
        while let Some(current) = stack.pop() {
            if current & LEAF != 0 {
                for index in leaf(current) {
                    let lanes = pyramid.meets_packet(&self.packets[index], self.padding);
                    if lanes != 0 {
                        room = room.checked_sub(lanes.count_ones() as usize)?;
                        suspects.packets.push((index as u32, lanes as u8));
                    }
                }
                continue;
            }
            let node = &self.nodes[current as usize];
            let mut bits = pyramid.meets_boxes(eight, node);
            while bits != 0 {
                let slot = bits.trailing_zeros() as usize;
                bits &= bits - 1;
                let (least, greatest) = self.spans[current as usize][slot];
                let is_own = pyramid.skip.contains(&least) && pyramid.skip.contains(&greatest);
                if !is_own {
                    stack.push(node.children[slot]);
                }
            }
        }
        Some(())
    }
}
