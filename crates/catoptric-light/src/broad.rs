//! Which emitters are broad: hemisphere rays find them with little noise, and with their unoccluded irradiance as control variate with none where
//! nothing blocks. Shadow rays and images of whole glowing walls would add the noise that a furnace of mirrors and emitters does not have.
//!
//! Of a ceiling that glows, or two soft boxes, shadow rays make less noise in less time (deviation over seeds: 0.68 % instead of 0.98, 0.98 instead of
//! 1.22), since the rest of the view needs fewer rays then. Not where many images of it are seen, or where it is cut into strips by what stands
//! right before it, as a window behind blinds: as sources these make three quarters of the noise in three to six times the time.

use std::collections::BTreeSet;

use catoptric_scene::{Barycentric, Rgb, TriangleId};
use catoptric_trace::chain::Event;
use catoptric_trace::sequence::{Key, Purpose, cosine_hemisphere, frame, triangle_point};
use catoptric_trace::walk::{self, WalkParams};
use catoptric_trace::{Ledger, MediumStack, Ray, Tracer};

use crate::emitter::Cell;

/// Cells are large above this share of the scene's area, and of what its diffuse surfaces see.
const LARGE: f64 = 0.04;
/// Share of the view, straight and over mirrors, that large cells take up together where they are broad in any case.
const VIEW: f64 = 0.4;
/// Share of what is seen of them that is seen over two mirrors or more, from which on they have many images …
const MANY_IMAGES: f64 = 0.1;
/// … and share of the view that all take up, above which that is too many. (An elevator of three mirrors: a glowing ceiling, 0.15 of its view, as source
/// makes 0.84 % of deviation instead of 1.14 in six times the time; a panel in the ceiling, 0.08, makes 0.90 % instead of 1.94 in 2.6 times.)
const MIDDLING: f64 = 0.12;
/// Planes of flat mirrors, panes and coats, small ones such as those of a mirror ball among them, above which it has many images wherever they are seen.
const MANY_MIRRORS: usize = 8;
/// What hides a cell stands right before it within this share of the root of its area, …
const RIGHT_BEFORE: f64 = 0.1;
/// … and cuts it into strips if it hides so much, as a share of what is seen of all.
const STRIPS: f64 = 0.2;
/// Rays that tell: a share of 4 % is seen with an error of 0.4 %, one of 40 % with an error of 1 %.
const RAYS: u32 = 2048;
/// Each broad cell is asked by every hemisphere ray.
const MOST: usize = 16;

/// What the diffuse surfaces of a scene see of large cells, as shares of their view.
#[derive(Clone, Debug, Default, PartialEq)]
struct Outlook {
    /// By cell.
    seen: Vec<f64>,
    /// Over two mirrors or more.
    far: f64,
    /// What is hidden by things that are right before them.
    hidden: f64,
}

/// The broad ones among cells, by index. Those of one diffuse radiance that are large, and not many.
pub(crate) fn broad(tracer: &Tracer, cells: &[Cell]) -> Vec<usize> {
    let scene = tracer.scene();
    let total: f64 = (0..scene.triangles().len()).map(|t| f64::from(scene.area(TriangleId(t as u32)))).sum();
    let is_large = |c: &Cell| !c.textured && c.lobe.is_diffuse() && c.area > LARGE * total;
    let mut large: Vec<usize> = (0..cells.len()).filter(|&i| is_large(&cells[i])).collect();
    if large.is_empty() || large.len() > MOST {
        return Vec::new();
    }
    let own: Vec<&Cell> = large.iter().map(|&i| &cells[i]).collect();
    let outlook = Outlook::new(tracer, &own);
    // A large lamp outside of a window is not broad.
    let mut seen = outlook.seen.iter();
    large.retain(|_| seen.next().is_some_and(|&share| share > LARGE));
    let all: f64 = outlook.seen.iter().sum();
    let is_broad = all > VIEW
        || all > MIDDLING && outlook.far > MANY_IMAGES * all
        || outlook.hidden > STRIPS * all
        || image_planes(tracer) > MANY_MIRRORS;
    if is_broad { large } else { Vec::new() }
}

/// The number of planes that have images.
fn image_planes(tracer: &Tracer) -> usize {
    let triangles = (0..tracer.scene().triangles().len() as u32).map(TriangleId);
    let planes = triangles.filter_map(|triangle| match tracer.reflection(triangle) {
        Event::Planar(plane) | Event::Facet(plane) => Some(plane.0),
        _ => None,
    });
    planes.collect::<BTreeSet<u32>>().len()
}

impl Outlook {
    fn new(tracer: &Tracer, cells: &[&Cell]) -> Self {
        let scene = tracer.scene();
        let mut sums = Vec::with_capacity(scene.triangles().len());
        let mut area = 0.0_f64;
        for index in 0..scene.triangles().len() {
            let triangle = TriangleId(index as u32);
            if scene.material_of(triangle).may_be_diffuse() {
                area += f64::from(scene.area(triangle));
            }
            sums.push(area);
        }
        let mut outlook = Self { seen: vec![0.0; cells.len()], ..Self::default() };
        let key = Key::new(0, Purpose::EmitterChoice, 0);
        let each = 1.0 / f64::from(RAYS);
        let params = WalkParams::default();
        let mut ledger = Ledger::default();
        for index in 0..RAYS {
            let pick = f64::from(key.point1(index)) * area;
            let from = sums.partition_point(|&s| s <= pick).min(sums.len().saturating_sub(1));
            let from = TriangleId(from as u32);
            let (u, v) = triangle_point(key.child(1).point2(index));
            let normal = scene.geometric_normal(from);
            let (tangent, bitangent) = frame(normal);
            let local = cosine_hemisphere(key.child(2).point2(index));
            let origin = scene.position(from, Barycentric { u, v });
            let direction = tangent * local.x + bitangent * local.y + normal * local.z;
            let ray = Ray { origin, direction, from: tracer.planes().of(from) };
            let roulette = key.child(3).child(index);
            let mut first = None;
            walk::choose_meeting(
                tracer,
                ray,
                MediumStack::AIR,
                Rgb::ONE,
                roulette,
                &params,
                &mut ledger,
                |arrival| {
                    first = first.or(Some((arrival.hit.triangle, arrival.position)));
                    let (triangle, towards) = (arrival.hit.triangle, arrival.direction.as_dvec3());
                    let met =
                        cells.iter().position(|cell| cell.holds(triangle) && cell.normal.dot(towards) < 0.0);
                    let Some(cell) = met else { return };
                    let share = f64::from(arrival.throughput.max_element()) * each;
                    outlook.seen[cell] += share;
                    outlook.far += if arrival.chain.planar_count() > 1 { share } else { 0.0 };
                },
            );
            let Some((triangle, place)) = first else { continue };
            let is_hidden = cells.iter().any(|cell| {
                let height = cell.normal.dot(place.as_dvec3() - cell.corner);
                !cell.holds(triangle)
                    && (0.0..RIGHT_BEFORE * cell.area.sqrt()).contains(&height)
                    && cell.meets(origin.as_dvec3(), direction.as_dvec3())
            });
            outlook.hidden += if is_hidden { each } else { 0.0 };
        }
        outlook
    }
}

#[cfg(test)]
mod tests {
    use catoptric_scene::{Material, MaterialId, Radiance, Scene, SceneParts};
    use glam::Vec3;

    use crate::{LightParams, Lights};

    use super::*;

    /// Broad cells in a room of 4 × 3 × 4 m, after something is built, of white, a mirror and what glows.
    fn count(build: impl FnOnce(&mut SceneParts, [MaterialId; 3])) -> usize {
        let mut parts = SceneParts::default();
        let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
        let mirror = parts.add_material(Material::mirror("mirror", Rgb::splat(0.9)));
        let lamp = parts.add_material(Material::emitter("lamp", Radiance(Rgb::ONE)));
        build(&mut parts, [white, mirror, lamp]);
        let scene = Scene::new(parts).expect("a valid scene");
        let tracer = Tracer::new(&scene);
        Lights::new(&tracer, LightParams::default()).emitters().broad().len()
    }

    const SIZE: Vec3 = Vec3::new(4.0, 3.0, 4.0);

    /// Floor, ceiling and four walls.
    fn add_room(parts: &mut SceneParts, [floor, ceiling, left, right, back, front]: [MaterialId; 6]) {
        let (x, y, z) = (Vec3::X * SIZE, Vec3::Y * SIZE, Vec3::Z * SIZE);
        parts.add_quad("floor", floor, Vec3::ZERO, z, x);
        parts.add_quad("ceiling", ceiling, y, x, z);
        parts.add_quad("left", left, Vec3::ZERO, y, z);
        parts.add_quad("right", right, x, z, y);
        parts.add_quad("back", back, Vec3::ZERO, x, y);
        parts.add_quad("front", front, z, y, x);
    }

    #[test]
    fn furnaces_are_broad_and_lamps_are_not() {
        assert_eq!(count(|parts, [_, _, lamp]| add_room(parts, [lamp; 6])), 6);
        // Between four mirrors a floor sees nothing but the ceiling, most of it over two of them or more.
        assert_eq!(count(|parts, [w, m, l]| add_room(parts, [w, l, m, m, m, m])), 1);
        // A fifth of what a room sees, with a mirror or without.
        assert_eq!(count(|parts, [w, _, l]| add_room(parts, [w, l, w, w, w, w])), 0);
        assert_eq!(count(|parts, [w, m, l]| add_room(parts, [w, l, w, m, w, w])), 0);
        // The ceiling of an elevator has many images; a panel in it of 2 m is worth them.
        assert_eq!(count(|parts, [w, m, l]| add_room(parts, [w, l, m, m, m, w])), 1);
        let panel = |parts: &mut SceneParts, [w, m, l]: [MaterialId; 3]| {
            add_room(parts, [w, w, m, m, m, w]);
            parts.add_quad("panel", l, Vec3::new(1.0, 2.99, 1.0), Vec3::X * 2.0, Vec3::Z * 2.0);
        };
        assert_eq!(count(panel), 0);
        // Each tile of a mirror has an image of its own.
        let tiles = |tiles: u8| {
            count(|parts, [white, mirror, lamp]| {
                add_room(parts, [white, lamp, white, white, white, white]);
                for tile in 0..tiles {
                    let corner = Vec3::new(0.4 * f32::from(tile), 0.01, 1.0);
                    let tilted = Vec3::new(0.3, 0.01 * f32::from(tile), 0.0);
                    parts.add_quad("tile", mirror, corner, Vec3::Z, tilted);
                }
            })
        };
        assert_eq!([tiles(8), tiles(9)], [0, 1]);
    }

    #[test]
    fn what_is_seen_in_strips_is_broad() {
        let panel = |slats: u16, off: f32| {
            count(|parts, [white, _, lamp]| {
                add_room(parts, [white; 6]);
                let corner = Vec3::new(0.01, 0.4, 0.4);
                parts.add_quad("panel", lamp, corner, Vec3::Y * 2.2, Vec3::Z * 3.2);
                for slat in 0..slats {
                    let low = corner + Vec3::new(off, 2.2 * f32::from(slat) / f32::from(slats), 0.0);
                    parts.add_box("slat", white, low, low + Vec3::new(0.06, 0.01, 3.2), false);
                }
            })
        };
        assert_eq!([panel(0, 0.0), panel(24, 0.05), panel(24, 1.0)], [0, 1, 0]);
    }
}
