//! Sheets of solid glass: window panes, table tops and fences that are modelled with both their faces.
//!
//! Light that enters through one of two parallel faces and leaves through the other goes on in its direction, beside its line by less than
//! a third of the thickness per unit of tanθ. Where that is little beside the sheet and the scene, shadow rays go straight through it, as
//! through a pane: what is seen beyond has its shadows, sharp as they are, where light-side rays would count. What such light loses (both
//! interfaces, and what the glass absorbs) and gains (a sheet brings nearer what lies beyond) is that of the refracted path; all that is
//! reflected inside of the sheet, or leaves it by an edge, is curved light as before.

use glam::Vec3;
use rustc_hash::FxHashMap;

use catoptric_scene::{AlphaMode, MaterialId, Rgb, Scene, TriangleId, Union};

use crate::chain::Event;
use crate::medium::MediumStack;
use crate::plane::{PlaneId, Planes};
use crate::tracer::{Hit, Tracer};

/// Sheets are this many times as wide as they are thick, at least: what enters within the shift of an edge may leave by it.
const THINNESS: f32 = 8.0;
/// They are thinner than this share of the scene's diagonal: shadows are shifted by less than a third of it at 45°.
const MOST_THICKNESS: f32 = 5e-3;
/// Faces are parallel within this angle (radians): light is turned by half of it.
const PARALLEL: f32 = 1e-3;
/// The thickness of a sheet is the same everywhere within this share.
const EVEN: f32 = 0.02;

/// Faces of sheets, those of one sheet by one number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SlabId(pub u32);

/// The faces of all sheets.
#[derive(Clone, Debug, Default)]
pub(crate) struct Slabs {
    /// Per triangle: the number of its sheet, or [`NONE`]; empty where there is none at all.
    of_triangle: Vec<u32>,
}

/// No sheet.
const NONE: u32 = u32::MAX;

/// A connected part of a body's surface in one plane.
struct Face {
    triangles: Vec<TriangleId>,
    /// Its area over its largest extent, metres.
    width: f32,
}

/// What lies on the other side of a sheet, as a ray from inside of a face finds it.
pub(crate) struct Opposite {
    /// The triangle, met from behind.
    pub(crate) triangle: TriangleId,
    /// How far it is, metres.
    pub(crate) distance: f32,
}

impl Slabs {
    /// Finds the sheets. `beyond` tells what a ray from a point in a plane along a unit direction meets first within a distance, and `is_in_air` whether
    /// a front lies in no other medium.
    pub(crate) fn new(
        scene: &Scene,
        planes: &Planes,
        diagonal: f32,
        beyond: impl Fn(Vec3, PlaneId, Vec3, f32) -> Option<Opposite>,
        is_in_air: impl Fn(Vec3, PlaneId, Vec3) -> bool,
    ) -> Self {
        let is_candidate = |&id: &TriangleId| {
            let material = scene.material_of(id);
            material.is_solid()
                && material.alpha_mode == AlphaMode::Opaque
                && !scene.is_smooth(id)
                && scene.geometric_normal(id) != Vec3::ZERO
        };
        let candidates: Vec<TriangleId> =
            (0..scene.triangles().len() as u32).map(TriangleId).filter(is_candidate).collect();
        if candidates.is_empty() {
            return Self::default();
        }
        let faces = faces(scene, planes, &candidates);
        let mut face_of = vec![NONE; scene.triangles().len()];
        for (index, face) in faces.iter().enumerate() {
            face.triangles.iter().for_each(|t| face_of[t.index()] = index as u32);
        }

        // The face on the other side of each, if that is one everywhere.
        let other_side = |face: &Face| -> Option<u32> {
            let most = (face.width / THINNESS).min(MOST_THICKNESS * diagonal);
            let mut found: Option<(u32, f32)> = None;
            for &triangle in &face.triangles {
                let center = scene.corners(triangle).iter().sum::<Vec3>() / 3.0;
                let (normal, plane) = (scene.geometric_normal(triangle), planes.of(triangle));
                let there = beyond(center, plane, -normal, most)?;
                let opposite = scene.geometric_normal(there.triangle);
                let other = face_of[there.triangle.index()];
                let fits = other != NONE
                    && scene.material_id_of(triangle) == scene.material_id_of(there.triangle)
                    && normal.dot(opposite) < 0.0
                    && normal.cross(opposite).length() < PARALLEL
                    && found.is_none_or(|(face, distance)| {
                        face == other && (distance - there.distance).abs() <= EVEN * distance
                    })
                    && is_in_air(center, plane, normal);
                if !fits {
                    return None;
                }
                found = Some((other, there.distance));
            }
            found.map(|(other, _)| other)
        };
        let opposite: Vec<Option<u32>> = faces.iter().map(other_side).collect();

        let mut of_triangle = vec![NONE; scene.triangles().len()];
        let mut found = false;
        for (index, face) in faces.iter().enumerate() {
            let index = index as u32;
            let Some(other) = opposite[index as usize] else { continue };
            if opposite[other as usize] == Some(index) {
                found = true;
                face.triangles.iter().for_each(|t| of_triangle[t.index()] = index.min(other));
            }
        }
        if found { Self { of_triangle } } else { Self::default() }
    }

    /// The sheet of which a triangle is part of a face.
    #[inline]
    pub(crate) fn of(&self, triangle: TriangleId) -> Option<SlabId> {
        self.of_triangle.get(triangle.index()).filter(|&&id| id != NONE).map(|&id| SlabId(id))
    }

    /// Whether there are none.
    pub(crate) fn is_empty(&self) -> bool {
        self.of_triangle.is_empty()
    }
}

/// Sorts triangles into connected parts of planes, in the order of their first triangles. Corners are shared where they are in the same place.
fn faces(scene: &Scene, planes: &Planes, candidates: &[TriangleId]) -> Vec<Face> {
    let mut joined = Union::new(candidates.len());
    let mut first_at: FxHashMap<(u32, [u32; 3]), u32> = FxHashMap::default();
    for (index, &triangle) in candidates.iter().enumerate() {
        for corner in scene.corners(triangle) {
            // −0 is 0.
            let place = (planes.of(triangle).0, (corner + Vec3::ZERO).to_array().map(f32::to_bits));
            joined.join(index as u32, *first_at.entry(place).or_insert(index as u32));
        }
    }
    let (number, count) = joined.numbered();
    let mut faces: Vec<Face> = (0..count).map(|_| Face { triangles: Vec::new(), width: 0.0 }).collect();
    for (&number, &triangle) in number.iter().zip(candidates) {
        faces[number as usize].triangles.push(triangle);
    }
    for face in &mut faces {
        let corners = || face.triangles.iter().flat_map(|&t| scene.corners(t));
        let low = corners().fold(Vec3::INFINITY, Vec3::min);
        let high = corners().fold(Vec3::NEG_INFINITY, Vec3::max);
        let area: f32 = face.triangles.iter().map(|&t| scene.area(t)).sum();
        face.width = area / (high - low).length().max(f32::MIN_POSITIVE);
    }
    faces
}

/// A shadow ray on its way through what lets light pass straight on.
#[derive(Debug)]
pub struct Passage<'a> {
    tracer: &'a Tracer<'a>,
    direction: Vec3,
    /// Length of the whole segment, metres.
    length: f32,
    share: Rgb,
    inside: Option<Inside>,
}

/// Within a sheet.
#[derive(Clone, Copy, Debug)]
struct Inside {
    slab: SlabId,
    material: MaterialId,
    /// Refracted direction.
    direction: Vec3,
    media: MediumStack,
}

impl<'a> Passage<'a> {
    /// Along a unit direction, for so many metres.
    pub fn new(tracer: &'a Tracer, direction: Vec3, length: f32) -> Self {
        Self { tracer, direction, length, share: Rgb::ONE, inside: None }
    }

    /// Light meets a surface, so many metres from the one before. Whether some of it passes.
    pub fn passes(&mut self, hit: &Hit, distance: f32) -> bool {
        let share = match self.inside.take() {
            None => self.passes_from_air(hit),
            Some(inside) => self.leaves(hit, distance, &inside),
        };
        self.share *= share;
        self.share.max_element() > 0.0
    }

    /// Share of the light that has got through, 0 in a sheet.
    pub fn share(&self) -> Rgb {
        if self.inside.is_none() { self.share } else { Rgb::ZERO }
    }

    fn passes_from_air(&mut self, hit: &Hit) -> Rgb {
        let interaction = self.tracer.interact(self.direction, hit, MediumStack::AIR);
        let mut share = Rgb::ZERO;
        for branch in interaction.branches() {
            match branch.event {
                Event::Undeviated => share += branch.throughput,
                Event::Enters(slab) => {
                    let material = self.tracer.scene().material_id_of(hit.triangle);
                    let (direction, media) = (branch.direction, branch.media);
                    self.inside = Some(Inside { slab, material, direction, media });
                    return branch.throughput;
                }
                Event::Planar(_) | Event::Facet(_) | Event::Curved | Event::Leaves(_) => {}
            }
        }
        share
    }

    /// What leaves on the other side, by the refracted path.
    fn leaves(&self, hit: &Hit, distance: f32, inside: &Inside) -> Rgb {
        let tracer = self.tracer;
        if !hit.back || tracer.scene().material_id_of(hit.triangle) != inside.material {
            return Rgb::ZERO;
        }
        let interaction = tracer.interact(inside.direction, hit, inside.media);
        let mut branches = interaction.branches().iter();
        let Some(leaving) = branches.find(|b| b.event == Event::Leaves(inside.slab)) else {
            return Rgb::ZERO;
        };
        let cos = self.direction.dot(interaction.geometric).abs();
        let thickness = distance * cos;
        let refracted = inside.direction.dot(interaction.geometric).abs().max(f32::MIN_POSITIVE);
        let medium = inside.media.current();
        let passed = tracer.media().transmittance(medium, thickness / refracted);
        let gain = gain(self.length * cos, thickness, cos, tracer.media().ior(medium));
        leaving.throughput * passed * gain
    }
}

/// What the view of things beyond a sheet grows by, as a solid angle, against that without it: dω/dA of the refracted path over that of the
/// straight one.
///
/// With a height of H between the ends, d of it in glass of index n, a path that starts at the angle θ arrives ρ(θ) = (H − d) tanθ + d tanθt beside
/// its foot, and dω/dA = sinθ / (ρ dρ/dθ). `cos` is that of the straight path, ρ = H tanθ₀.
pub(crate) fn gain(height: f32, thickness: f32, cos: f32, ior: f32) -> f32 {
    let depth = (thickness / height.max(f32::MIN_POSITIVE)).min(1.0);
    let cos = cos.clamp(1e-3, 1.0);
    let straight = ((1.0 - cos * cos).max(0.0)).sqrt() / cos;
    // ρ/H and its derivative by t = tanθ: sinθt = t / (n √(1 + t²)).
    let reach = |t: f32| {
        let inside = (ior * ior * (1.0 + t * t) - t * t).sqrt();
        let across = (1.0 - depth) * t + depth * t / inside;
        let slope = (1.0 - depth) + depth * ior * ior / (inside * inside * inside);
        (across, slope)
    };
    // Newton: ρ is nearly straight.
    let mut t = straight;
    for _ in 0..3 {
        let (across, slope) = reach(t);
        t = (t + (straight - across) / slope).max(0.0);
    }
    let (_, slope) = reach(t);
    // sinθ dθ = t (1 + t²)^(−3/2) dt, and dA = ρ dρ dφ.
    let density = |t: f32| {
        let square = 1.0 + t * t;
        1.0 / (square * square.sqrt())
    };
    // t/ρ is 1/slope(0) at normal incidence.
    let magnified = if straight > 1e-4 { t / straight } else { 1.0 / slope };
    density(t) * magnified / slope / density(straight)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The gain by tracing: the area on which a narrow cone of directions arrives.
    fn traced(height: f64, thickness: f64, ior: f64, theta: f64) -> (f64, f64) {
        let (sin, cos) = (libm::sin, libm::cos);
        let rho = |theta: f64| {
            let inside = sin(theta) / ior;
            (height - thickness) * sin(theta) / cos(theta)
                + thickness * inside / (1.0 - inside * inside).sqrt()
        };
        let step = 1e-4;
        let solid = cos(theta - step) - cos(theta + step);
        let area = 0.5 * (rho(theta + step).powi(2) - rho(theta - step).powi(2));
        let straight = height / height.hypot(rho(theta));
        // dω/dA without a sheet is cos³θ₀/H².
        (solid / area * height * height / straight.powi(3), straight)
    }

    #[test]
    fn what_lies_beyond_a_sheet_is_seen_as_large_as_refracted_paths_show_it() {
        for height in [0.5, 2.0] {
            for thickness in [0.0, 0.01, 0.1] {
                for theta in [0.05_f64, 0.4, 0.9, 1.3] {
                    let (expected, cos) = traced(height, thickness, 1.5, theta);
                    let found = gain(height as f32, thickness as f32, cos as f32, 1.5);
                    // Differences of the trace are good to 1e-4² / θ², positions to 2⁻²³.
                    assert!((f64::from(found) / expected - 1.0).abs() < 2e-5, "{found} {expected}");
                }
            }
        }
        // At normal incidence what lies beyond is nearer by d (1 − 1/n).
        assert!((gain(1.0, 0.1, 1.0, 1.5) - 1.0 / (1.0 - 0.1 / 3.0_f32).powi(2)).abs() < 1e-5);
    }
}
