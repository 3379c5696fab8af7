//! Bright base triangles, and the spots and places that they make together.

use std::collections::BTreeMap;
use std::f32::consts::PI;

use glam::Vec3;

use catoptric_scene::Rgb;
use catoptric_trace::sequence::frame;
use catoptric_trace::{PlaneId, Tracer};

use crate::display::Displayed;
use crate::guide::PlaceId;
use crate::patch::PatchMesh;

use super::Sight;

/// Times the mean radiance of the scene from which on a place is bright.
const BRIGHT: f32 = 8.0;
/// Bright base triangles at most: those that are most noise to see.
const MOST_PARTS: usize = 4096;
/// Spots at most.
pub(super) const MOST_SPOTS: usize = 256;
/// Corners of a spot's outline.
const OUTLINE: usize = 8;
/// Most corners of the spots of a place.
pub(super) const MOST_CORNERS: usize = OUTLINE * MOST_SPOTS;
/// Size of the cubes, in radii of a place, whose triangles become one spot if they look the same way: this to begin with, doubled until spots are few …
const FINEST_CUBE: f32 = 1.0 / 16.0;
/// … or as large as the place.
const COARSEST_CUBE: f32 = 4.0;

/// What is bright of a base triangle.
#[derive(Clone, Copy, Debug)]
pub(super) struct Part {
    pub(super) position: Vec3,
    pub(super) normal: Vec3,
    pub(super) area: f32,
    /// Channels added.
    pub(super) radiance: f32,
    pub(super) plane: PlaneId,
    pub(super) root: usize,
    /// Its outline.
    pub(super) corners: [Vec3; OUTLINE],
}

/// One of them, or some that are near each other.
#[derive(Clone, Copy, Debug)]
pub(super) struct Spot {
    pub(super) position: Vec3,
    pub(super) normal: Vec3,
    pub(super) area: f32,
    /// Root mean square, channels added.
    pub(super) radiance: f32,
    pub(super) plane: PlaneId,
    /// Its outline: indices of the corners of its place.
    pub(super) corners: [u16; OUTLINE],
    pub(super) place: PlaceId,
}

/// Spots that touch.
#[derive(Clone, Debug)]
pub(super) struct Place {
    low: Vec3,
    high: Vec3,
    /// Its first spot, and the one after its last.
    pub(super) spots: [usize; 2],
    pub(super) corners: Vec<Vec3>,
    /// Squared radiance times area, summed over its spots; and their squared radiance.
    pub(super) noise: f32,
    pub(super) brightest: f32,
}

impl Place {
    const NOWHERE: Self = Self {
        low: Vec3::INFINITY,
        high: Vec3::NEG_INFINITY,
        spots: [0; 2],
        corners: Vec::new(),
        noise: 0.0,
        brightest: 0.0,
    };

    fn grow(&mut self, corners: &[Vec3]) {
        for &corner in corners {
            (self.low, self.high) = (self.low.min(corner), self.high.max(corner));
        }
    }

    pub(super) fn center(&self) -> Vec3 {
        0.5 * (self.low + self.high)
    }

    pub(super) fn radius(&self) -> f32 {
        (0.5 * self.low.distance(self.high)).max(f32::MIN_POSITIVE)
    }
}

/// The bright parts of base triangles, by `irradiance` per vertex of what gathers look at, and which of its elements they are made of.
pub(super) fn bright_parts(
    tracer: &Tracer,
    sight: &Sight,
    patches: &PatchMesh,
    irradiance: &[Rgb],
) -> (Vec<Part>, Vec<bool>) {
    let displayed = sight.displayed;
    let mesh = &displayed.mesh;
    let (mut sum, mut whole) = (0.0_f64, 0.0_f64);
    let radiance_of = |index: usize| {
        let element = &mesh.elements[index];
        let received = element.vertices.iter().map(|&v| irradiance[v as usize]).sum::<Rgb>() / 3.0;
        let sent =
            received * patches.reflectances[patches.of_root[displayed.roots[index] as usize].0 as usize];
        sent.element_sum().max(0.0) / PI
    };
    let radiances: Vec<f32> = (0..mesh.elements.len()).map(radiance_of).collect();
    for (index, &radiance) in radiances.iter().enumerate() {
        // A field of large triangles must not decide what is bright in the house.
        let counted = f64::from(mesh.area(index as u32).min(sight.draft.most_weight));
        sum += f64::from(radiance) * counted;
        whole += counted;
    }
    let mean = if whole > 0.0 { (sum / whole) as f32 } else { 0.0 };
    let is_bright: Vec<bool> =
        radiances.iter().map(|&radiance| mean > 0.0 && radiance > BRIGHT * mean).collect();
    // Most base triangles are one element: what is bright of others may be as small as the mesh is there.
    let mut bright: Vec<usize> = (0..mesh.elements.len()).filter(|&index| is_bright[index]).collect();
    bright.sort_by_key(|&index| displayed.roots[index]);
    let mut parts: Vec<Part> = bright
        .chunk_by(|&a, &b| displayed.roots[a] == displayed.roots[b])
        .filter_map(|own| Part::new(tracer, sight, own, &radiances))
        .collect();
    parts.sort_by(|a, b| noise(b.radiance, b.area).total_cmp(&noise(a.radiance, a.area)));
    parts.truncate(MOST_PARTS);
    (parts, is_bright)
}

impl Part {
    /// Of some elements of one base triangle, if they have an area.
    fn new(tracer: &Tracer, sight: &Sight, elements: &[usize], radiances: &[f32]) -> Option<Self> {
        let Displayed { mesh, roots, .. } = sight.displayed;
        let corners = |index: usize| mesh.elements[index].vertices.map(|v| &mesh.vertices[v as usize]);
        let (mut position, mut normal, mut area, mut radiance) = (Vec3::ZERO, Vec3::ZERO, 0.0, 0.0);
        for &index in elements {
            let own = mesh.area(index as u32);
            position += corners(index).iter().map(|c| c.position).sum::<Vec3>() * (own / 3.0);
            normal += corners(index).iter().map(|c| c.normal).sum::<Vec3>() * own;
            area += own;
            radiance += radiances[index] * own;
        }
        let normal = normal.normalize_or_zero();
        let points = elements.iter().flat_map(|&index| corners(index)).map(|c| c.position);
        (area > 0.0).then(|| Self {
            position: position / area,
            normal,
            area,
            radiance: radiance / area,
            plane: tracer.planes().of(corners(elements[0])[0].triangle),
            root: roots[elements[0]] as usize,
            corners: outline(normal, points),
        })
    }
}

/// What one ray that meets so much adds to the variance, in proportion.
fn noise(radiance: f32, area: f32) -> f32 {
    radiance * radiance * area
}

/// The places that bright base triangles make together, and their spots by place. `tell` is told the place of each triangle.
///
/// There are as many spots as triangles, if these are few; else triangles of a place that look the same way and are near each other are one.
pub(super) fn spots_of(parts: &[Part], mut tell: impl FnMut(usize, PlaceId)) -> (Vec<Spot>, Vec<Place>) {
    let group = touching(parts);
    let mut first = group.clone();
    first.sort_unstable();
    first.dedup();
    let place_of: Vec<usize> = group.iter().map(|g| first.partition_point(|f| f < g)).collect();
    let mut places = vec![Place::NOWHERE; first.len()];
    for (part, &place) in parts.iter().zip(&place_of) {
        places[place].grow(&part.corners);
        tell(part.root, PlaceId(place as u16));
    }

    let mut members: Vec<Vec<usize>> = (0..parts.len()).map(|part| vec![part]).collect();
    let mut cube = FINEST_CUBE;
    while members.len() > MOST_SPOTS && cube <= COARSEST_CUBE {
        let mut cubes: BTreeMap<(usize, [i32; 6]), Vec<usize>> = BTreeMap::new();
        for (index, (part, &place)) in parts.iter().zip(&place_of).enumerate() {
            let at = (part.position - places[place].low) / (cube * places[place].radius());
            let [at, facing] = [at.floor(), (part.normal * 2.0).round()].map(|v| v.as_ivec3().to_array());
            let key = [at[0], at[1], at[2], facing[0], facing[1], facing[2]];
            cubes.entry((place, key)).or_default().push(index);
        }
        members = cubes.into_values().collect();
        cube *= 2.0;
    }
    members.sort_by_cached_key(|own| {
        let sum: f32 = own.iter().map(|&m| noise(parts[m].radiance, parts[m].area)).sum();
        // Positive floats are in the order of their bits.
        std::cmp::Reverse(sum.to_bits())
    });
    members.truncate(MOST_SPOTS);
    members.sort_by_key(|own| place_of[own[0]]);
    let mut spots: Vec<Spot> = Vec::with_capacity(members.len());
    for own in members {
        let index = place_of[own[0]];
        let place = &mut places[index];
        place.spots = [if place.spots[1] == 0 { spots.len() } else { place.spots[0] }, spots.len() + 1];
        let spot = together(parts, &own, PlaceId(index as u16), &mut place.corners);
        place.noise += noise(spot.radiance, spot.area);
        place.brightest += spot.radiance * spot.radiance;
        spots.push(spot);
    }
    (spots, places)
}

/// The spot that some triangles make; its outline is added to the `corners` of its place.
fn together(parts: &[Part], members: &[usize], place: PlaceId, corners: &mut Vec<Vec3>) -> Spot {
    let own = || members.iter().map(|&m| &parts[m]);
    let area: f32 = own().map(|part| part.area).sum();
    let middle = own().map(|part| part.position * part.area).sum::<Vec3>() / area;
    let distance = |part: &Part| part.position.distance_squared(middle);
    let mut nearest = &parts[members[0]];
    for part in own() {
        if distance(part) < distance(nearest) {
            nearest = part;
        }
    }
    let normal = own().map(|part| part.normal * part.area).sum::<Vec3>().normalize_or_zero();
    let squares: f32 = own().map(|part| noise(part.radiance, part.area)).sum();
    let outline = outline(normal, own().flat_map(|part| part.corners));
    Spot {
        // The middle of what is curved is beside it.
        position: nearest.position,
        normal,
        area,
        radiance: (squares / area).sqrt(),
        plane: nearest.plane,
        corners: outline.map(|corner| index_in(corners, corner)),
        place,
    }
}

/// The farthest points in eight directions along a surface.
pub(super) fn outline(normal: Vec3, points: impl Iterator<Item = Vec3> + Clone) -> [Vec3; OUTLINE] {
    let (tangent, bitangent) = frame(normal);
    let ways = [tangent, tangent + bitangent, bitangent, bitangent - tangent];
    std::array::from_fn(|index| {
        let way = if index < ways.len() { ways[index] } else { -ways[index - ways.len()] };
        let farthest = points.clone().max_by(|a, b| a.dot(way).total_cmp(&b.dot(way)));
        farthest.unwrap_or(Vec3::ZERO)
    })
}

/// The index of a point among others, to which it is added if it is none of them.
fn index_in(points: &mut Vec<Vec3>, point: Vec3) -> u16 {
    let known = points.iter().position(|&p| p == point);
    known.unwrap_or_else(|| {
        points.push(point);
        points.len() - 1
    }) as u16
}

/// For each part the group of those that it touches: their distance is no more than those from their centres to their corners.
fn touching(parts: &[Part]) -> Vec<usize> {
    let reach = |part: &Part| part.corners.iter().map(|c| c.distance(part.position)).fold(0.0_f32, f32::max);
    let reaches: Vec<f32> = parts.iter().map(reach).collect();
    let mut group: Vec<usize> = (0..parts.len()).collect();
    for a in 0..parts.len() {
        for b in 0..a {
            let (from, to) = (group[a], group[b]);
            let reach = reaches[a] + reaches[b];
            if from != to && parts[a].position.distance_squared(parts[b].position) <= reach * reach {
                group.iter_mut().filter(|g| **g == from).for_each(|g| *g = to);
            }
        }
    }
    group
}

#[cfg(test)]
mod tests {
    use catoptric_scene::Scene;

    use crate::base_mesh::coarse_patches;

    use super::super::tests::floor;
    use super::*;

    #[test]
    fn parts_are_as_small_as_the_mesh_where_it_is_refined() {
        let scene = Scene::new(floor().0).expect("a valid scene");
        let tracer = Tracer::new(&scene);
        let (mut draft, patches) = coarse_patches(&tracer, 50);
        // A disc of light of 0.3 m, on a mesh that is fine around it.
        let (middle, radius) = (Vec3::new(2.0, 0.0, 2.0), 0.15);
        let coarse = draft.leaves.iter().map(|leaf| draft.longest_edge(leaf)).fold(0.0, f32::max);
        for _ in 0..8 {
            let is_near = |&(a, b): &(u32, u32)| {
                let [a, b] = [a, b].map(|v| draft.vertices[v as usize].position);
                a.distance(b) > 0.1 && (a + b).distance(2.0 * middle) < 2.0 * radius + a.distance(b)
            };
            let marks: Vec<(u32, u32)> = draft.edges().into_iter().filter(is_near).collect();
            draft.split(&tracer, &marks);
        }
        let displayed = draft.display(&tracer);
        let light = |position: Vec3| if position.distance(middle) < radius { 1000.0 } else { 1.0 };
        let irradiance: Vec<Rgb> =
            displayed.mesh.vertices.iter().map(|v| Rgb::splat(light(v.position))).collect();
        let sight = Sight { displayed: &displayed, draft: &draft, sources: &[], of_gathers: &[] };
        let (parts, is_bright) = bright_parts(&tracer, &sight, &patches, &irradiance);
        let off = parts.iter().flat_map(|part| part.corners).map(|c| c.distance(middle)).fold(0.0, f32::max);
        // Elements at the border have corners in the disc, and edges of 0.1 m or, where closed, twice that.
        assert!(!parts.is_empty() && off < radius + 0.2 && coarse > 2.0 * off, "{off} {coarse}");
        let elements = (0..is_bright.len()).filter(|&index| is_bright[index]);
        let area: f32 = elements.map(|index| displayed.mesh.area(index as u32)).sum();
        let sum: f32 = parts.iter().map(|part| part.area).sum();
        assert!((sum / area - 1.0).abs() < 1e-4 && area > PI * radius * radius, "{sum} {area}");
    }
}
