//! Hits in a scene: what a ray meets. The file `visibility` tells what light gets past.

mod visibility;

use glam::Vec3;

use catoptric_scene::{AlphaMode, Barycentric, Scene, Side, Transmission, TriangleId};

use crate::chain::Event;
use crate::eight::Level;
use crate::extent::Extent;
use crate::flat::{Flat, flat_mirrors};
use crate::fresnel::{self, DiffuseFresnel};
use crate::interaction::has_back;
use crate::medium::Media;
use crate::overlap::{COVERED_BACK, COVERED_FRONT, Overlaps};
use crate::packet::{CUT_OUT, Facet, Nearest, PASSES, Probe, TRANSMITS};
use crate::plane::{PlaneId, Planes};
use crate::slab::{Opposite, SlabId, Slabs};
use crate::tree::{Boxes, Tree};

/// A ray. Everything in the plane `from` is ignored, exactly: no offsets.
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    /// Start, metres.
    pub origin: Vec3,
    /// Unit direction (segments: any length).
    pub direction: Vec3,
    /// Plane it starts from.
    pub from: PlaneId,
}

impl Ray {
    /// A ray that starts in free space.
    pub fn free(origin: Vec3, direction: Vec3) -> Self {
        Self { origin, direction, from: PlaneId::NONE }
    }
}

/// Where a ray meets a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance in units of the direction's length.
    pub t: f32,
    /// The triangle.
    pub triangle: TriangleId,
    /// Where on it.
    pub at: Barycentric,
    /// Met from behind.
    pub back: bool,
}

impl Hit {
    fn new(nearest: &Nearest) -> Self {
        Self {
            t: nearest.t,
            triangle: TriangleId(nearest.id),
            at: Barycentric { u: nearest.u, v: nearest.v },
            back: nearest.back,
        }
    }
}

/// Light that goes on from a solid's border starts at least this share of the scene's diagonal off the edges of its triangle …
const OFF_EDGE: f32 = 4e-6;
/// … but at most this share of the triangle.
const AT_EDGE: f32 = 0.02;
/// Triangles of one plane lie this far apart at most, by rounding, as a share of how far they reach; and a look from before them begins this far off.
const ONE_PLANE: f32 = 4e-6;
const BEFORE_PLANE: f32 = 4.0 * ONE_PLANE;

/// By what hits in a scene are found: the tree, and tables of planes, media and materials.
#[derive(Clone, Debug)]
pub struct Accelerator {
    tree: Tree,
    planes: Planes,
    media: Media,
    /// Per plane: what flat mirrors, panes and coats in it are.
    flat: Vec<Flat>,
    overlaps: Overlaps,
    slabs: Slabs,
    /// Per triangle: plain Lambertian without texture, alpha or coat.
    lambertian: Vec<bool>,
    averages: Vec<DiffuseFresnel>,
    clearcoat: DiffuseFresnel,
    passes_anything: bool,
    specular: bool,
    extent: Extent,
}

impl Accelerator {
    /// Builds the tree and the tables.
    pub fn new(scene: &Scene) -> Self {
        let order: Vec<u32> = (0..scene.triangles().len() as u32).collect();
        Self::with_order(scene, &order)
    }

    /// The same, with the triangles given to the tree builder in another order: a permutation of their ids. The
    /// tree differs, no answer does.
    pub fn with_order(scene: &Scene, order: &[u32]) -> Self {
        let corners: Vec<[Vec3; 3]> = order.iter().map(|&id| scene.corners(TriangleId(id))).collect();
        let material_flags: Vec<u8> = scene
            .materials()
            .iter()
            .map(|m| match m.alpha_mode {
                AlphaMode::Mask { .. } => CUT_OUT,
                AlphaMode::Blend => PASSES,
                AlphaMode::Opaque => 0,
            } | match m.transmission_kind {
                _ if m.transmission <= 0.0 => 0,
                Transmission::Pane => PASSES,
                Transmission::Solid => TRANSMITS,
            })
            .map(|flags| if flags & PASSES != 0 { flags | TRANSMITS } else { flags })
            .collect();
        let flags = |id: TriangleId| material_flags[scene.material_id_of(id).index()];
        let extent = Extent::new(scene);
        let (boxes, (planes, overlaps)) = rayon::join(
            || Boxes::around(&corners, |index| extent.is_outlying(TriangleId(order[index]))),
            || {
                let planes = Planes::new(scene, &extent);
                let overlaps =
                    Overlaps::new(scene, &extent, &planes, flags, |id| has_back(scene.material_of(id)));
                (planes, overlaps)
            },
        );
        let facets: Vec<Facet> = order
            .iter()
            .zip(corners)
            .map(|(&id, corners)| {
                let triangle = TriangleId(id);
                Facet {
                    corners,
                    id,
                    plane: planes.of(triangle),
                    flags: flags(triangle) | overlaps.covered(triangle),
                }
            })
            .collect();
        let mut tree = Tree::build(&boxes, &facets);
        let slabs = slabs(scene, &planes, &tree, extent.inner.diagonal as f32);
        tree.mark(PASSES, |id| slabs.of(TriangleId(id)).is_some());
        let flat = flat_mirrors(scene, &extent, &planes);
        let lambertian = scene
            .triangles()
            .iter()
            .enumerate()
            .map(|(i, _)| {
                let material = scene.material_of(TriangleId(i as u32));
                !material.may_be_specular()
                    && !material.unlit
                    && material.alpha_mode == AlphaMode::Opaque
                    && material.diffuse_transmission_factor == 0.0
                    && material.metallic_roughness_texture.is_none()
            })
            .collect();
        Self {
            tree,
            media: Media::new(scene),
            flat,
            overlaps,
            lambertian,
            averages: scene.materials().iter().map(|m| fresnel::diffuse(m.ior)).collect(),
            clearcoat: fresnel::diffuse(1.5),
            passes_anything: !slabs.is_empty() || facets.iter().any(|f| f.flags & PASSES != 0),
            slabs,
            specular: scene.materials().iter().any(|m| m.may_be_specular()),
            planes,
            extent,
        }
    }
}

/// The scene, ready to be asked for hits.
#[derive(Clone, Debug)]
pub struct Tracer<'a> {
    scene: &'a Scene,
    accelerator: Accelerator,
}

impl<'a> Tracer<'a> {
    /// Builds the tree and the tables.
    pub fn new(scene: &'a Scene) -> Self {
        Self::with(scene, Accelerator::new(scene))
    }

    /// With what was built for this scene, or for one that differs from it by nothing but the sky.
    pub fn with(scene: &'a Scene, accelerator: Accelerator) -> Self {
        debug_assert_eq!(accelerator.lambertian.len(), scene.triangles().len(), "built for another scene");
        Self { scene, accelerator }
    }

    /// [`Tracer::new`], with [another order](Accelerator::with_order) of triangles.
    pub fn with_order(scene: &'a Scene, order: &[u32]) -> Self {
        Self::with(scene, Accelerator::with_order(scene, order))
    }

    /// The same, with instructions that every machine has. No answer differs.
    #[must_use]
    pub fn with_common_instructions(mut self) -> Self {
        self.accelerator.tree.level = Level::Plain;
        self
    }

    /// The scene.
    #[inline]
    pub fn scene(&self) -> &'a Scene {
        self.scene
    }

    /// The planes.
    #[inline]
    pub fn planes(&self) -> &Planes {
        &self.accelerator.planes
    }

    /// The media.
    #[inline]
    pub fn media(&self) -> &Media {
        &self.accelerator.media
    }

    /// How large the scene is.
    #[inline]
    pub fn extent(&self) -> &Extent {
        &self.accelerator.extent
    }

    /// Diagonal of the bounding box of everything, metres.
    pub fn diagonal(&self) -> f32 {
        self.accelerator.extent.all.diagonal as f32
    }

    /// Whether a triangle is plain Lambertian: no coat, mirror, transmission or alpha anywhere on it.
    #[inline]
    pub fn is_lambertian(&self, triangle: TriangleId) -> bool {
        self.accelerator.lambertian[triangle.index()]
    }

    /// Whether anything in the scene reflects or transmits specularly.
    pub fn has_specular(&self) -> bool {
        self.accelerator.specular
    }

    /// The plane of a flat reflector that is large enough to have images.
    #[inline]
    pub fn image_plane(&self, triangle: TriangleId) -> Option<PlaneId> {
        match self.reflection(triangle) {
            Event::Planar(plane) => Some(plane),
            _ => None,
        }
    }

    /// Whether a plane has images.
    pub fn plane_has_images(&self, plane: PlaneId) -> bool {
        self.accelerator.flat[plane.0 as usize] == Flat::Mirror
    }

    /// What a reflection at a triangle is, where its normal is that of the geometry.
    #[inline]
    pub fn reflection(&self, triangle: TriangleId) -> Event {
        let plane = self.accelerator.planes.of(triangle);
        match self.accelerator.flat[plane.0 as usize] {
            Flat::Mirror if !self.scene.is_smooth(triangle) => Event::Planar(plane),
            Flat::Facet if !self.scene.is_smooth(triangle) => Event::Facet(plane),
            _ => Event::Curved,
        }
    }

    /// The sheet of glass of which a triangle is part of a face.
    #[inline]
    pub fn slab_of(&self, triangle: TriangleId) -> Option<SlabId> {
        self.accelerator.slabs.of(triangle)
    }

    /// Whether something else lies on a triangle, on a side that it shows.
    pub fn is_covered(&self, triangle: TriangleId) -> bool {
        self.is_covered_on(triangle, Side::Front)
            || self.has_back(triangle) && self.is_covered_on(triangle, Side::Back)
    }

    /// Whether something else may lie on a side of a triangle.
    pub fn is_covered_on(&self, triangle: TriangleId, side: Side) -> bool {
        let flag = if side == Side::Front { COVERED_FRONT } else { COVERED_BACK };
        self.accelerator.overlaps.covered(triangle) & flag != 0
    }

    /// What lies on top at a point of a side of a triangle, in its plane: often itself.
    pub fn on_top_of(&self, triangle: TriangleId, side: Side, point: Vec3) -> TriangleId {
        if !self.is_covered_on(triangle, side) {
            return triangle;
        }
        let normal = side.orient(self.scene.geometric_normal(triangle));
        let distance = self.accelerator.extent.reach_of(triangle) as f32 * BEFORE_PLANE;
        let ray = Ray::free(point + normal * distance, -normal);
        let plane = self.accelerator.planes.of(triangle);
        let itself =
            Nearest { t: distance, id: triangle.0, plane, back: side == Side::Back, ..Nearest::NONE };
        TriangleId(self.on_top(&ray, &itself).id)
    }

    #[inline]
    pub(crate) fn coat_averages(&self, triangle: TriangleId) -> DiffuseFresnel {
        self.accelerator.averages[self.scene.material_id_of(triangle).index()]
    }

    #[inline]
    pub(crate) fn clearcoat_averages(&self) -> DiffuseFresnel {
        self.accelerator.clearcoat
    }

    #[inline]
    fn is_solid_here(&self, nearest: &Nearest) -> bool {
        !self.scene.is_cut_out(TriangleId(nearest.id), Barycentric { u: nearest.u, v: nearest.v })
    }

    /// The nearest hit within `limit`, of any kind; holes of cut-outs are no hits.
    ///
    /// Where several lie in one plane, the one on top is met: what shows a face, then the smaller, and what is opaque before what
    /// transmits.
    #[inline]
    pub fn nearest(&self, ray: &Ray, limit: f32) -> Option<Hit> {
        let probe = Probe::new(ray.origin, ray.direction, [ray.from, PlaneId::NONE]);
        let nearest = self.accelerator.tree.nearest(&probe, limit, |n| self.is_solid_here(n))?;
        if nearest.flags & if nearest.back { COVERED_BACK } else { COVERED_FRONT } != 0 {
            return Some(Hit::new(&self.on_top(ray, &nearest)));
        }
        Some(Hit::new(&nearest))
    }

    /// Where light goes on from `position`, the place of a hit. On the border of a solid that is not as near to an edge of the triangle as
    /// a position is rounded: beyond the neighbour's plane, light would never meet it, and take the glass with it.
    #[inline]
    pub fn departure(&self, hit: &Hit, position: Vec3) -> Vec3 {
        let Barycentric { u, v } = hit.at;
        let nearest = u.min(v).min(1.0 - u - v);
        if nearest > AT_EDGE || !self.scene.material_of(hit.triangle).is_solid() {
            return position;
        }
        self.off_edge(hit, position, nearest)
    }

    #[cold]
    fn off_edge(&self, hit: &Hit, position: Vec3, nearest: f32) -> Vec3 {
        let [a, b, c] = self.scene.corners(hit.triangle);
        let (e, f) = (b - a, c - a);
        // Heights are at least twice the area over the longest edge. Positions round by 2⁻²⁴ of the scene, a few times; neighbours turn
        // away by a few degrees.
        let longest = e.length().max(f.length()).max((c - b).length());
        let extent = &self.accelerator.extent;
        let size = if extent.is_outlying(hit.triangle) {
            extent.reach_of(hit.triangle)
        } else {
            extent.inner.diagonal
        };
        let least = OFF_EDGE * size as f32 * longest / e.cross(f).length().max(f32::MIN_POSITIVE);
        let least = least.min(AT_EDGE);
        if nearest >= least {
            return position;
        }
        let [u, v, w] = [hit.at.u, hit.at.v, 1.0 - hit.at.u - hit.at.v].map(|weight| weight.max(least));
        let all = u + v + w;
        a + e * (u / all) + f * (v / all)
    }

    /// What lies on top at the place of `nearest`, in the same plane.
    #[cold]
    fn on_top(&self, ray: &Ray, nearest: &Nearest) -> Nearest {
        // Planes are one within 1e-6 of how far their triangles reach: along the ray that is longer by 1/cosθ.
        let normal = self.scene.geometric_normal(TriangleId(nearest.id));
        let slope = ray.direction.dot(normal).abs().max(1e-4 * ray.direction.length());
        let reach = self.accelerator.extent.reach_of(TriangleId(nearest.id)) as f32;
        let slack = nearest.t * 1e-6 + reach * ONE_PLANE / slope;
        // A short ray meets few boxes.
        let start = (nearest.t - slack).max(0.0);
        let probe = Probe::new(ray.origin + ray.direction * start, ray.direction, [ray.from, PlaneId::NONE]);
        let rank = |n: &Nearest| {
            let id = TriangleId(n.id);
            let shows = !n.back || self.has_back(id);
            (!shows, self.accelerator.overlaps.rank(id), n.id)
        };
        let on_top = self.accelerator.tree.opaque_in_plane(
            &probe,
            nearest.t - start + slack,
            nearest.plane,
            rank,
            |n| self.is_solid_here(n),
        );
        on_top.map_or(*nearest, |n| Nearest { t: nearest.t, ..n })
    }
}

/// Surfaces along the way out of other media that are looked at.
const MOST_BORDERS: u32 = 32;

/// The sheets of glass in a scene.
fn slabs(scene: &Scene, planes: &Planes, tree: &Tree, diagonal: f32) -> Slabs {
    let beyond = |origin: Vec3, from: PlaneId, direction: Vec3, most: f32| {
        let probe = Probe::new(origin, direction, [from, PlaneId::NONE]);
        let found = tree.nearest(&probe, most, |_| true)?;
        found.back.then_some(Opposite { triangle: TriangleId(found.id), distance: found.t })
    };
    let is_in_air = |mut origin: Vec3, mut from: PlaneId, direction: Vec3| {
        for _ in 0..MOST_BORDERS {
            let probe = Probe::new(origin, direction, [from, PlaneId::NONE]);
            let Some(found) = tree.nearest(&probe, f32::INFINITY, |_| true) else { return true };
            if scene.material_of(TriangleId(found.id)).is_solid() {
                return !found.back;
            }
            (origin, from) = (origin + direction * found.t, found.plane);
        }
        true
    };
    Slabs::new(scene, planes, diagonal, beyond, is_in_air)
}
