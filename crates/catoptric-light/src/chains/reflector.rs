//! Planes with images, and the reflecting pieces of which they are made.

use std::collections::HashMap;

use glam::{DVec2, DVec3};

use catoptric_scene::{AlphaMode, Barycentric, Side, TriangleId};
use catoptric_trace::chain::Event;
use catoptric_trace::plane::Plane;
use catoptric_trace::{PlaneId, Tracer};

use crate::contour::Polygon;
use crate::lamp::Lamp;

/// A flat reflecting piece of a plane.
#[derive(Clone, Debug)]
pub struct Aperture {
    /// Its convex outline.
    pub outline: Polygon,
    /// Unit normal of the reflecting side.
    pub normal: DVec3,
    /// Both sides reflect.
    pub double_sided: bool,
}

/// A plane with its reflecting pieces.
#[derive(Clone, Debug)]
pub struct Reflector {
    /// Its id.
    pub id: PlaneId,
    /// Its equation.
    pub plane: Plane,
    /// Its pieces, apart from each other. Empty: too many to clip by, or they overlap; following the chain decides.
    pub apertures: Vec<Aperture>,
    /// Corners of all pieces, for culling: (outline, normal, double-sided).
    pub(super) pieces: Vec<Aperture>,
    /// Largest reflectance at normal incidence.
    pub(super) strength: f32,
    /// Its materials have neither textures nor holes.
    pub(super) even: bool,
    /// A small mirror: it has an image where it reflects alone.
    pub(super) is_facet: bool,
}

impl Reflector {
    /// All its pieces, for culling.
    pub(crate) fn pieces(&self) -> &[Aperture] {
        &self.pieces
    }
}

/// Pieces of a plane beyond which clipping costs more than it saves.
const MAX_APERTURES: usize = 6;

/// Whether any corner of `outline` lies on the reflecting (or emitting) side of `piece`.
pub(super) fn in_front(piece: &Aperture, outline: &Polygon) -> bool {
    let offset = piece.normal.dot(piece.outline.corners()[0]);
    outline.corners().iter().any(|c| {
        let height = piece.normal.dot(*c) - offset;
        height > 0.0 || (piece.double_sided && height != 0.0)
    })
}

/// The planes with images, their pieces joined to parallelograms where they are. What is inside of a lamp, as the end of a pole that a globe stands on,
/// reflects nothing to anyone.
pub(super) fn reflectors(tracer: &Tracer, lamps: &[Lamp]) -> Vec<Reflector> {
    let scene = tracer.scene();
    let mut lamps_in: HashMap<PlaneId, Vec<&Lamp>> = HashMap::new();
    let mut reflectors: Vec<Reflector> = Vec::new();
    let mut known: HashMap<PlaneId, usize> = HashMap::new();
    for surface in scene.surfaces() {
        for index in surface.triangles.clone() {
            let id = TriangleId(index);
            let (plane, is_facet) = match tracer.reflection(id) {
                Event::Planar(plane) => (plane, false),
                Event::Facet(plane) => (plane, true),
                Event::Undeviated | Event::Curved | Event::Enters(_) | Event::Leaves(_) => continue,
            };
            let material = scene.material_of(id);
            if !material.may_be_specular() {
                continue;
            }
            let corners = scene.corners(id).map(|c| c.as_dvec3());
            let lamps = lamps_in.entry(plane).or_insert_with(|| {
                let equation = tracer.planes().plane(plane);
                lamps.iter().filter(|lamp| lamp.may_be_cut_by(&equation)).collect()
            });
            if lamps.iter().any(|lamp| corners.iter().all(|c| lamp.holds(*c))) {
                continue;
            }
            let point = scene.surface_point(id, Barycentric { u: 1.0 / 3.0, v: 1.0 / 3.0 });
            let f0 = ((point.ior - 1.0) / (point.ior + 1.0)).powi(2);
            let strength = point.mirror.max_element()
                + point.coat * point.coat_share * f0
                + point.transmission * f0 * 2.0
                + point.clearcoat * 0.04;
            let piece = Aperture {
                outline: Polygon::new(&corners),
                normal: Side::Front.orient(scene.geometric_normal(id)).as_dvec3(),
                double_sided: tracer.has_back(id),
            };
            let reflector = *known.entry(plane).or_insert_with(|| {
                reflectors.push(Reflector {
                    id: plane,
                    plane: tracer.planes().plane(plane),
                    apertures: Vec::new(),
                    pieces: Vec::new(),
                    strength: 0.0,
                    even: true,
                    is_facet,
                });
                reflectors.len() - 1
            });
            let reflector = &mut reflectors[reflector];
            // Textured mirrors may be stronger elsewhere: the factor bounds them.
            let bound =
                if material.base_texture.is_some() { material.base_color.max_element() } else { strength };
            reflector.strength = reflector.strength.max(bound.max(strength));
            reflector.even &= !material.has_textures()
                && material.alpha_mode == AlphaMode::Opaque
                && !tracer.is_covered(id);
            reflector.pieces.push(piece);
        }
    }
    for reflector in &mut reflectors {
        let apertures = joined(&reflector.pieces);
        if apertures.len() <= MAX_APERTURES {
            // Light would come through both where two overlap.
            reflector.apertures = apart(&apertures).unwrap_or_default();
        }
    }
    reflectors
}

/// Joins triangles that make up parallelograms.
fn joined(pieces: &[Aperture]) -> Vec<Aperture> {
    let mut result: Vec<Aperture> = Vec::new();
    let mut index = 0;
    while index < pieces.len() {
        let first = &pieces[index];
        let partner = pieces.get(index + 1).and_then(|second| join(first, second));
        index += if partner.is_some() { 2 } else { 1 };
        result.push(partner.unwrap_or_else(|| first.clone()));
    }
    result
}

fn join(first: &Aperture, second: &Aperture) -> Option<Aperture> {
    let (p, q) = (first.outline.corners(), second.outline.corners());
    if first.double_sided != second.double_sided || first.normal.dot(second.normal) < 0.999 {
        return None;
    }
    let lone_p = (0..3).find(|&i| !q.contains(&p[i]))?;
    let lone_q = (0..3).find(|&i| !p.contains(&q[i]))?;
    if (0..3).any(|i| i != lone_p && !q.contains(&p[i])) {
        return None;
    }
    let (corner, a, b) = (p[lone_p], p[(lone_p + 1) % 3], p[(lone_p + 2) % 3]);
    let opposite = q[lone_q];
    let closes =
        (a + b - corner - opposite).length() < 1e-5 * ((a - corner).length() + (b - corner).length());
    closes.then(|| Aperture { outline: Polygon::new(&[corner, a, opposite, b]), ..first.clone() })
}

/// Overlaps of less than this share of a piece are rounding.
const OVERLAP: f64 = 1e-6;

/// Pieces of one plane of which none overlap, on whatever side they reflect: what lies within another is left out. `None` where some
/// overlap in part.
fn apart(pieces: &[Aperture]) -> Option<Vec<Aperture>> {
    let mut result: Vec<Aperture> = Vec::new();
    for piece in pieces {
        let within = |a: &Aperture, b: &Aperture| share_within(&a.outline, &b.outline);
        if result.iter().any(|other| within(piece, other) > 1.0 - OVERLAP) {
            continue;
        }
        result.retain(|other| within(other, piece) <= 1.0 - OVERLAP);
        if result.iter().any(|other| within(piece, other) > OVERLAP) {
            return None;
        }
        result.push(piece.clone());
    }
    Some(result)
}

/// The share of a polygon that lies within another one of its plane.
fn share_within(polygon: &Polygon, other: &Polygon) -> f64 {
    let (corners, area) = (other.corners(), other.vector_area());
    let inside = (0..corners.len()).fold(*polygon, |rest, i| {
        let (from, to) = (corners[i], corners[(i + 1) % corners.len()]);
        let inwards = area.cross(to - from);
        rest.clipped(inwards, inwards.dot(from))
    });
    inside.vector_area().length() / polygon.vector_area().length().max(f64::MIN_POSITIVE)
}

/// A rectangle around pieces of a plane.
pub(super) fn frame(pieces: &[Aperture], normal: DVec3) -> Polygon {
    let corners = || pieces.iter().flat_map(|p| p.outline.corners());
    let first: &[DVec3] = pieces.first().map_or(&[], |p| p.outline.corners());
    let origin = first.first().copied().unwrap_or(DVec3::ZERO);
    let right = first.get(1).map_or(DVec3::ZERO, |c| *c - origin);
    let right = right.reject_from(normal).try_normalize().unwrap_or(normal.any_orthonormal_vector());
    let up = normal.cross(right);
    let at = |c: &DVec3| DVec2::new(right.dot(*c - origin), up.dot(*c - origin));
    let low = corners().map(at).fold(DVec2::INFINITY, DVec2::min);
    let high = corners().map(at).fold(DVec2::NEG_INFINITY, DVec2::max);
    let [a, b, c, d] = [(low.x, low.y), (high.x, low.y), (high.x, high.y), (low.x, high.y)];
    Polygon::new(&[a, b, c, d].map(|(x, y)| origin + right * x + up * y))
}
