//! Bright base triangles, and the spots and places that they make together.

use std::collections::BTreeMap;
use std::f32::consts::PI;

use glam::Vec3;

use catoptric_scene::Rgb;
use catoptric_trace::sequence::frame;
use catoptric_trace::{PlaneId, Tracer};

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

/// A base triangle that is bright.
#[derive(Clone, Copy, Debug)]
pub(super) struct Part {
    pub(super) position: Vec3,
    pub(super) normal: Vec3,
    pub(super) area: f32,
    /// Channels added.
    pub(super) radiance: f32,
    pub(super) plane: PlaneId,
    pub(super) root: usize,
    pub(super) corners: [Vec3; 3],
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

/// The base triangles that `irradiance` per vertex of what gathers look at makes bright.
pub(super) fn bright_parts(
    tracer: &Tracer,
    sight: &Sight,
    patches: &PatchMesh,
    irradiance: &[Rgb],
) -> Vec<Part> {
    let displayed = sight.displayed;
    let mut roots = vec![RootSum::NOTHING; patches.of_root.len()];
    let (mut sum, mut whole) = (0.0_f64, 0.0_f64);
    for (index, element) in displayed.mesh.elements.iter().enumerate() {
        let root = displayed.roots[index] as usize;
        let corners = element.vertices.map(|v| &displayed.mesh.vertices[v as usize]);
        let area = displayed.mesh.area(index as u32);
        let received = element.vertices.iter().map(|&v| irradiance[v as usize]).sum::<Rgb>() / 3.0;
        let sent = received * patches.reflectances[patches.of_root[root].0 as usize];
        let radiance = sent.element_sum().max(0.0) / PI;
        let of_root = &mut roots[root];
        of_root.position += corners.iter().map(|c| c.position).sum::<Vec3>() * (area / 3.0);
        of_root.normal += corners.iter().map(|c| c.normal).sum::<Vec3>() * area;
        of_root.area += area;
        of_root.radiance += radiance * area;
        of_root.plane = tracer.planes().of(corners[0].triangle);
        // A field of large triangles must not decide what is bright in the house.
        let counted = f64::from(area.min(sight.draft.most_weight));
        sum += f64::from(radiance) * counted;
        whole += counted;
    }
    let mean = if whole > 0.0 { (sum / whole) as f32 } else { 0.0 };
    let is_bright =
        |root: &RootSum| root.area > 0.0 && mean > 0.0 && root.radiance > BRIGHT * mean * root.area;
    let mut parts: Vec<Part> = roots
        .iter()
        .enumerate()
        .filter(|(_, root)| is_bright(root))
        .map(|(index, root)| Part {
            position: root.position / root.area,
            normal: root.normal.normalize_or_zero(),
            area: root.area,
            radiance: root.radiance / root.area,
            plane: root.plane,
            root: index,
            corners: sight.draft.base[index].map(|v| sight.draft.vertices[v as usize].position),
        })
        .collect();
    parts.sort_by(|a, b| noise(b.radiance, b.area).total_cmp(&noise(a.radiance, a.area)));
    parts.truncate(MOST_PARTS);
    parts
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
fn outline(normal: Vec3, points: impl Iterator<Item = Vec3> + Clone) -> [Vec3; OUTLINE] {
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

/// Sums over the elements of a base triangle.
#[derive(Clone, Copy, Debug)]
struct RootSum {
    position: Vec3,
    normal: Vec3,
    area: f32,
    radiance: f32,
    plane: PlaneId,
}

impl RootSum {
    const NOTHING: Self =
        Self { position: Vec3::ZERO, normal: Vec3::ZERO, area: 0.0, radiance: 0.0, plane: PlaneId::NONE };
}
