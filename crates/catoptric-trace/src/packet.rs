//! Four triangles side by side, and what a ray meets of them, in `glam::Vec4`, which is SSE2 on x86-64 and scalar elsewhere with
//! the same bits.
//!
//! Source: the watertight test of Woop, Benthin & Wald. Keys in docs/references.md: Woop2013.

use glam::{Vec3, Vec4};

use crate::plane::PlaneId;

/// What a triangle can do to a ray besides blocking it.
pub(crate) const CUT_OUT: u8 = 1;
/// Lets light pass undeviated (pane or blended alpha).
pub(crate) const PASSES: u8 = 2;
/// Lets light pass at all, refracted or not.
pub(crate) const TRANSMITS: u8 = 4;

/// One triangle for the tree.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Facet {
    pub(crate) corners: [Vec3; 3],
    pub(crate) id: u32,
    pub(crate) plane: PlaneId,
    pub(crate) flags: u8,
}

/// Four triangles side by side.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Packet {
    pub(crate) corners: [[Vec4; 3]; 3],
    pub(crate) ids: [u32; 4],
    pub(crate) planes: [u32; 4],
    pub(crate) flags: [u8; 4],
}

/// What a ray brings to the traversal.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Probe {
    pub(crate) origin: Vec3,
    pub(crate) inverse: Vec3,
    /// Rows of a node's bounds at which the ray enters and leaves.
    pub(crate) near: [usize; 3],
    pub(crate) far: [usize; 3],
    /// Axis of the largest direction component, and the two others, ordered to keep the winding.
    pub(crate) axes: [usize; 3],
    pub(crate) shear: [f32; 3],
    pub(crate) ignore: [u32; 2],
}

/// The nearest candidate so far.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Nearest {
    pub(crate) t: f32,
    pub(crate) id: u32,
    pub(crate) u: f32,
    pub(crate) v: f32,
    pub(crate) back: bool,
    pub(crate) plane: PlaneId,
    pub(crate) flags: u8,
}

impl Nearest {
    pub(crate) const NONE: Self =
        Self { t: f32::INFINITY, id: u32::MAX, u: 0.0, v: 0.0, back: false, plane: PlaneId::NONE, flags: 0 };
}

impl Probe {
    #[inline]
    pub(crate) fn new(origin: Vec3, direction: Vec3, ignore: [PlaneId; 2]) -> Self {
        // A tiny component instead of zero keeps the slabs free of NaN; its box error is far below the padding.
        let guard = |d: f32| if d.abs() < 1e-20 { 1e-20_f32.copysign(d) } else { d };
        let inverse = Vec3::new(1.0 / guard(direction.x), 1.0 / guard(direction.y), 1.0 / guard(direction.z));
        let absolute = direction.abs();
        let z = if absolute.x > absolute.y {
            if absolute.x > absolute.z { 0 } else { 2 }
        } else if absolute.y > absolute.z {
            1
        } else {
            2
        };
        let (mut x, mut y) = ((z + 1) % 3, (z + 2) % 3);
        if direction[z] < 0.0 {
            std::mem::swap(&mut x, &mut y);
        }
        let shear = [direction[x] / direction[z], direction[y] / direction[z], 1.0 / direction[z]];
        let side = |axis: usize, ahead: bool| if (inverse[axis] > 0.0) == ahead { axis + 3 } else { axis };
        Self {
            origin,
            inverse,
            near: [0, 1, 2].map(|axis| side(axis, false)),
            far: [0, 1, 2].map(|axis| side(axis, true)),
            axes: [x, y, z],
            shear,
            ignore: [ignore[0].0, ignore[1].0],
        }
    }
}

/// What lies on a segment, the worst last.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Occlusion {
    /// Nothing.
    Free,
    /// What lets light pass undeviated.
    Passing,
    /// What lets nothing pass.
    Blocked,
}

/// Lanes of a packet that a ray meets.
pub(crate) struct Candidates {
    pub(crate) mask: u32,
    pub(crate) t: Vec4,
    u: Vec4,
    v: Vec4,
    back: u32,
}

impl Candidates {
    #[inline]
    pub(crate) fn hit(&self, lane: usize, packet: &Packet) -> Nearest {
        Nearest {
            t: self.t[lane],
            id: packet.ids[lane],
            u: self.u[lane],
            v: self.v[lane],
            back: self.back >> lane & 1 == 1,
            plane: PlaneId(packet.planes[lane]),
            flags: packet.flags[lane],
        }
    }
}

impl Packet {
    /// Of four triangles.
    pub(crate) fn of(facets: [&Facet; 4]) -> Self {
        Self {
            corners: std::array::from_fn(|corner| {
                std::array::from_fn(|axis| Vec4::from_array(facets.map(|f| f.corners[corner][axis])))
            }),
            ids: facets.map(|f| f.id),
            planes: facets.map(|f| f.plane.0),
            flags: facets.map(|f| f.flags),
        }
    }

    /// What lies at t < `limit`; `passed` is told of what lets light pass undeviated, as long as nothing blocks.
    #[inline(always)]
    pub(crate) fn occlusion(
        &self,
        probe: &Probe,
        limit: f32,
        accept: impl Fn(&Nearest) -> bool,
        mut passed: impl FnMut(Nearest),
    ) -> Occlusion {
        let mut occlusion = Occlusion::Free;
        let Some(candidates) = self.intersect(probe, limit) else { return occlusion };
        let mut bits = candidates.mask;
        while bits != 0 {
            let lane = bits.trailing_zeros() as usize;
            bits &= bits - 1;
            if candidates.t[lane] >= limit || probe.ignore.contains(&self.planes[lane]) {
                continue;
            }
            if self.flags[lane] & CUT_OUT != 0 && !accept(&candidates.hit(lane, self)) {
                continue;
            }
            if self.flags[lane] & PASSES == 0 {
                return Occlusion::Blocked;
            }
            passed(candidates.hit(lane, self));
            occlusion = Occlusion::Passing;
        }
        occlusion
    }

    /// Watertight ray–triangle test (Woop, Benthin & Wald 2013, §3), four triangles at once: edge functions of the
    /// sheared triangle; where one is exactly zero it is computed again in f64, so that neighbours always agree.
    #[inline(always)]
    pub(crate) fn intersect(&self, probe: &Probe, limit: f32) -> Option<Candidates> {
        let [x, y, z] = probe.axes;
        let (ox, oy, oz) =
            (Vec4::splat(probe.origin[x]), Vec4::splat(probe.origin[y]), Vec4::splat(probe.origin[z]));
        let (sx, sy, sz) = (Vec4::splat(probe.shear[0]), Vec4::splat(probe.shear[1]), probe.shear[2]);
        let [a, b, c] = &self.corners;
        let (az, bz, cz) = (a[z] - oz, b[z] - oz, c[z] - oz);
        let (ax, ay) = (a[x] - ox - sx * az, a[y] - oy - sy * az);
        let (bx, by) = (b[x] - ox - sx * bz, b[y] - oy - sy * bz);
        let (cx, cy) = (c[x] - ox - sx * cz, c[y] - oy - sy * cz);
        let mut u = cx * by - cy * bx;
        let mut v = ax * cy - ay * cx;
        let mut w = bx * ay - by * ax;

        let zero = u.cmpeq(Vec4::ZERO) | v.cmpeq(Vec4::ZERO) | w.cmpeq(Vec4::ZERO);
        if zero.any() {
            for lane in 0..4 {
                if zero.bitmask() >> lane & 1 == 1 {
                    let edge = |px: f32, py: f32, qx: f32, qy: f32| {
                        (f64::from(px) * f64::from(qy) - f64::from(py) * f64::from(qx)) as f32
                    };
                    u[lane] = edge(cx[lane], cy[lane], bx[lane], by[lane]);
                    v[lane] = edge(ax[lane], ay[lane], cx[lane], cy[lane]);
                    w[lane] = edge(bx[lane], by[lane], ax[lane], ay[lane]);
                }
            }
        }

        let zeros = Vec4::ZERO;
        let positive = u.cmpge(zeros) & v.cmpge(zeros) & w.cmpge(zeros);
        let negative = u.cmple(zeros) & v.cmple(zeros) & w.cmple(zeros);
        let determinant = u + v + w;
        let inside = (positive | negative) & determinant.cmpne(Vec4::ZERO);
        if !inside.any() {
            return None;
        }
        let scaled = (u * az + v * bz + w * cz) * sz;
        let inverse = Vec4::ONE / determinant;
        let t = scaled * inverse;
        let mask = (inside & t.cmpgt(Vec4::ZERO) & t.cmple(Vec4::splat(limit))).bitmask();
        if mask == 0 {
            return None;
        }
        // The winding is kept by the order of the axes, so that a front face turns one way.
        let back = determinant.cmplt(Vec4::ZERO).bitmask();
        Some(Candidates { mask, t, u: v * inverse, v: w * inverse, back })
    }
}
