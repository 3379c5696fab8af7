//! Small bright places on diffuse surfaces: the inside of a lamp's shade, a wall beside a bulb. None of the rays of a gather and of
//! those beside may have met them, and the guide that these make does not know them. What sources and the coarse solution tell does.

use std::collections::BTreeMap;
use std::f32::consts::PI;

use glam::{Vec2, Vec3};

use catoptric_light::Receiver;
use catoptric_scene::Rgb;
use catoptric_trace::sequence::{Key, frame, hemisphere_point};
use catoptric_trace::{PlaneId, Tracer};

use crate::guide::{Hints, PlaceId, WINDOWS, Window};
use crate::patch::PatchMesh;

use super::Sight;

/// Times the mean radiance of the scene from which on a place is bright.
const BRIGHT: f32 = 8.0;
/// Bright base triangles at most: those that are most noise to see.
const MOST_PARTS: usize = 4096;
/// Spots at most.
const MOST_SPOTS: usize = 256;
/// Corners of a spot's outline.
const OUTLINE: usize = 8;
/// Share of the variance that is known from which on spots are worth a look, …
const MINOR: f32 = 0.1;
/// … and share of that by all of them from which on a place is worth a window.
const MINOR_PLACE: f32 = 1.0 / 32.0;
/// Rays from each gather that look which spots are seen. Five lamps in cans, noise of the indirect light: × 1.5 with 8, × 1.2 with 16, × 0.98
/// with 64, all in the same time.
const LOOKS: f32 = 32.0;
/// What a place may add that no look sees, in looks: a lamp's inner wall is seen by a sliver. The same lamps: noise × 0.65.
const UNSEEN: f32 = 0.5;
/// Squared radius of a place by squared distance from which on it is not small, wherever its corners are.
const LARGE: f32 = 0.25;

/// A base triangle that is bright.
#[derive(Clone, Copy, Debug)]
struct Part {
    position: Vec3,
    normal: Vec3,
    area: f32,
    /// Channels added.
    radiance: f32,
    plane: PlaneId,
    root: usize,
    corners: [Vec3; 3],
}

/// One of them, or some that are near each other.
#[derive(Clone, Copy, Debug)]
struct Spot {
    position: Vec3,
    normal: Vec3,
    area: f32,
    /// Root mean square, channels added.
    radiance: f32,
    plane: PlaneId,
    /// Its outline, of `Spots::corners`.
    corners: [u16; OUTLINE],
    place: PlaceId,
}

impl Spot {
    /// What it adds to the variance of one ray from a receiver that sees it.
    #[inline]
    fn variance(&self, receiver: &Receiver) -> f32 {
        let way = self.position - receiver.position;
        let distance = way.length_squared();
        let cosines = way.dot(receiver.normal).max(0.0) * (-way.dot(self.normal)).max(0.0);
        // No more than half of the view: seen from so near, the centre does not stand for the rest.
        let share = (cosines * self.area / (PI * distance * distance).max(f32::MIN_POSITIVE)).min(0.5);
        self.radiance * self.radiance * share
    }
}

/// Spots that touch.
#[derive(Clone, Copy, Debug)]
struct Place {
    low: Vec3,
    high: Vec3,
    /// Its first spot, and the one after its last.
    spots: [usize; 2],
}

impl Place {
    const NOWHERE: Self = Self { low: Vec3::INFINITY, high: Vec3::NEG_INFINITY, spots: [0; 2] };

    fn grow(&mut self, corners: &[Vec3]) {
        for &corner in corners {
            (self.low, self.high) = (self.low.min(corner), self.high.max(corner));
        }
    }

    fn radius(&self) -> f32 {
        (0.5 * self.low.distance(self.high)).max(f32::MIN_POSITIVE)
    }

    /// Whether it may be seen in a small window.
    fn is_far_from(&self, position: Vec3) -> bool {
        let center = 0.5 * (self.low + self.high);
        self.radius().powi(2) <= LARGE * center.distance_squared(position)
    }
}

/// The bright places of a scene.
#[derive(Clone, Debug, Default)]
pub(super) struct Spots {
    /// By place.
    spots: Vec<Spot>,
    places: Vec<Place>,
    corners: Vec<Vec3>,
    /// Per element of what gathers look at; empty where there are no spots.
    of_element: Vec<Option<PlaceId>>,
}

impl Spots {
    /// Where `irradiance` per vertex of what gathers look at makes patches bright.
    pub(super) fn new(tracer: &Tracer, sight: &Sight, patches: &PatchMesh, irradiance: &[Rgb]) -> Self {
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
        let parts = roots.iter().enumerate().filter(|(_, root)| is_bright(root)).map(|(index, root)| Part {
            position: root.position / root.area,
            normal: root.normal.normalize_or_zero(),
            area: root.area,
            radiance: root.radiance / root.area,
            plane: root.plane,
            root: index,
            corners: sight.draft.base[index].map(|v| sight.draft.vertices[v as usize].position),
        });
        let mut of_root = vec![None; roots.len()];
        let mut spots = Self::among(parts.collect(), |root, place| of_root[root] = Some(place));
        if !spots.spots.is_empty() {
            spots.of_element = displayed.roots.iter().map(|&root| of_root[root as usize]).collect();
        }
        spots
    }

    /// The places and spots that bright base triangles make together; `tell` is told the place of each.
    fn among(mut parts: Vec<Part>, mut tell: impl FnMut(usize, PlaceId)) -> Self {
        let by_noise = |a: &(f32, f32), b: &(f32, f32)| (b.0 * b.0 * b.1).total_cmp(&(a.0 * a.0 * a.1));
        parts.sort_by(|a, b| by_noise(&(a.radiance, a.area), &(b.radiance, b.area)));
        parts.truncate(MOST_PARTS);
        let group = touching(&parts);
        let mut first = group.clone();
        first.sort_unstable();
        first.dedup();
        let place_of: Vec<usize> = group.iter().map(|g| first.partition_point(|f| f < g)).collect();
        let mut places = vec![Place::NOWHERE; first.len()];
        for (part, &place) in parts.iter().zip(&place_of) {
            places[place].grow(&part.corners);
            tell(part.root, PlaceId(place as u16));
        }

        // As many spots as parts, if these are few; else those of a place that look the same way and are near each other are one.
        let mut members: Vec<Vec<usize>> = (0..parts.len()).map(|part| vec![part]).collect();
        let mut share = 1.0 / 32.0;
        while members.len() > MOST_SPOTS && share < 4.0 {
            share *= 2.0;
            let mut cells: BTreeMap<(usize, [i32; 6]), Vec<usize>> = BTreeMap::new();
            for (index, (part, &place)) in parts.iter().zip(&place_of).enumerate() {
                let at = (part.position - places[place].low) / (share * places[place].radius());
                let [at, facing] = [at.floor(), (part.normal * 2.0).round()].map(|v| v.as_ivec3().to_array());
                let key = [at[0], at[1], at[2], facing[0], facing[1], facing[2]];
                cells.entry((place, key)).or_default().push(index);
            }
            members = cells.into_values().collect();
        }
        let mut corners: Vec<Vec3> = Vec::new();
        let mut spots: Vec<Spot> = members
            .iter()
            .map(|members| {
                let own = || members.iter().map(|&m| &parts[m]);
                let area: f32 = own().map(|part| part.area).sum();
                let middle = own().map(|part| part.position * part.area).sum::<Vec3>() / area;
                let distance = |part: &Part| part.position.distance_squared(middle);
                let nearest = own().min_by(|a, b| distance(a).total_cmp(&distance(b)));
                // Of no parts there is no group.
                let Part { position, plane, .. } = nearest.unwrap_or(&parts[members[0]]);
                let normal = own().map(|part| part.normal * part.area).sum::<Vec3>().normalize_or_zero();
                let squares: f32 = own().map(|part| part.radiance.powi(2) * part.area).sum();
                let outline = outline(normal, own().flat_map(|part| part.corners));
                Spot {
                    position: *position,
                    normal,
                    area,
                    radiance: (squares / area).sqrt(),
                    plane: *plane,
                    corners: outline.map(|corner| index_in(&mut corners, corner)),
                    place: PlaceId(place_of[members[0]] as u16),
                }
            })
            .collect();
        spots.sort_by(|a, b| by_noise(&(a.radiance, a.area), &(b.radiance, b.area)));
        spots.truncate(MOST_SPOTS);
        spots.sort_by_key(|spot| spot.place.0);
        for (index, spot) in spots.iter().enumerate() {
            let place = &mut places[usize::from(spot.place.0)];
            place.spots = [if place.spots[1] == 0 { index } else { place.spots[0] }, index + 1];
        }
        Self { spots, places, corners, of_element: Vec::new() }
    }

    /// The place that an element of what gathers look at belongs to.
    #[inline]
    pub(super) fn place_of(&self, element: u32) -> Option<PlaceId> {
        self.of_element.get(element as usize).copied().flatten()
    }

    /// Where in the hemisphere they are seen, if they add much to the variance of a ray that is `known`.
    pub(super) fn seen_from(&self, tracer: &Tracer, receiver: &Receiver, known: f32, key: Key) -> Hints {
        let mut hints = Hints::default();
        if self.spots.is_empty() {
            return hints;
        }
        let mut sums = [0.0; MOST_SPOTS];
        let mut total = 0.0_f32;
        for (sum, spot) in sums.iter_mut().zip(&self.spots) {
            total += spot.variance(receiver);
            *sum = total;
        }
        if total <= MINOR * known || total <= 0.0 {
            return hints;
        }
        let (tangent, bitangent) = frame(receiver.normal);
        let point = |way: Vec3| {
            let unit = way.normalize_or_zero();
            hemisphere_point(Vec3::new(unit.dot(tangent), unit.dot(bitangent), unit.dot(receiver.normal)))
        };
        let each = total / LOOKS;
        let before = |spot: usize| if spot > 0 { sums[spot - 1] } else { 0.0 };
        let own = |place: &Place| before(place.spots[1]) - before(place.spots[0]);
        let places = self.places.iter().enumerate().map(|(index, place)| (own(place), index));
        let mut major: Vec<(f32, usize)> = places.filter(|(own, _)| *own > MINOR_PLACE * total).collect();
        major.sort_by(|a, b| b.0.total_cmp(&a.0));
        let windows = major.into_iter().filter_map(|(own, index)| {
            self.window(&self.places[index], receiver, point).map(|window| (own, index, window))
        });
        for (own, index, window) in windows.take(WINDOWS) {
            hints.open(PlaceId(index as u16), window, UNSEEN * own.min(each));
        }
        let mut next = key.uniform(0) * each;
        for (spot, sum) in self.spots.iter().zip(sums) {
            let looks = ((sum - next) / each).ceil().max(0.0);
            if looks < 1.0 {
                continue;
            }
            next += looks * each;
            let seen = tracer.visibility(receiver.position, receiver.plane, spot.position, spot.plane);
            if seen != Rgb::ZERO {
                let at = point(spot.position - receiver.position);
                hints.add(spot.place, at, looks * each * seen.max_element());
            }
        }
        hints
    }

    /// Where a place is seen, if it is small there: around those of its spots that face the receiver.
    fn window(&self, place: &Place, receiver: &Receiver, point: impl Fn(Vec3) -> Vec2) -> Option<Window> {
        if !place.is_far_from(receiver.position) {
            return None;
        }
        let mut is_needed = [false; OUTLINE * MOST_SPOTS];
        let [first, end] = place.spots;
        for spot in self.spots[first..end].iter().filter(|spot| spot.variance(receiver) > 0.0) {
            spot.corners.iter().for_each(|&c| is_needed[usize::from(c)] = true);
        }
        let needed = self.corners.iter().zip(is_needed).filter(|(_, is_needed)| *is_needed);
        let ways = needed.map(|(corner, _)| *corner - receiver.position);
        // What is below the horizon is not seen.
        let above = ways.map(|way| way - receiver.normal * way.dot(receiver.normal).min(0.0));
        let window = Window::around(above.map(point));
        window.is_small().then_some(window)
    }
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

#[cfg(test)]
mod tests {
    use catoptric_scene::{Barycentric, Material, Scene, SceneParts, Side, TriangleId};
    use catoptric_trace::sequence::{Purpose, cosine_hemisphere};

    use crate::gather::Gathered;
    use crate::guide::{Aim, Findings, Guide};

    use super::*;

    #[test]
    fn spots_that_are_seen_and_no_others_draw_rays() {
        let mut parts = SceneParts::default();
        let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
        parts.add_quad("floor", white, Vec3::ZERO, Vec3::Z * 4.0, Vec3::X * 4.0);
        // A screen in the middle, a metre high.
        parts.add_quad("screen", white, Vec3::new(2.0, 0.0, 4.0), Vec3::Z * -4.0, Vec3::Y);
        let scene = Scene::new(parts).expect("a valid scene");
        let tracer = Tracer::new(&scene);
        let receiver = Receiver::on(&tracer, TriangleId(0), Side::Front, Barycentric { u: 0.1, v: 0.1 });
        assert!(receiver.position.x < 2.0 && receiver.normal == Vec3::Y);
        let spot = |position: Vec3, normal: Vec3| part(position, normal, 1e-3, 0);
        let over = spot(receiver.position + Vec3::new(0.5, 1.5, 0.2), Vec3::NEG_Y);
        let behind = spot(Vec3::new(3.5, 0.3, receiver.position.z), Vec3::NEG_X);
        let turned = spot(over.position, Vec3::Y);
        let key = Key::new(1, Purpose::Test, 0);
        let guide = |parts: Vec<Part>, known: f32| {
            let hints = Spots::among(parts, |_, _| ()).seen_from(&tracer, &receiver, known, key);
            Guide::new(&Findings::default(), &hints, Gathered::default())
        };
        let deviation = |parts: Vec<Part>| guide(parts, 0.0).even_deviation();
        assert_eq!(deviation(vec![behind]), 0.0);
        assert_eq!(deviation(vec![turned]), 0.0);
        // One ray of all finds 100 with the probability of the form factor.
        let way = over.position - receiver.position;
        let share = way.y * way.y * over.area / (PI * way.length_squared().powi(2));
        let exact = 100.0 * share.sqrt();
        assert!((deviation(vec![over]) / exact - 1.0).abs() < 1e-4, "{} {exact}", deviation(vec![over]));
        // Half of the looks at two alike are at either.
        let all = deviation(vec![over, turned, spot(over.position, Vec3::NEG_Y)]);
        assert!((all / exact / std::f32::consts::SQRT_2 - 1.0).abs() < 1e-4);
        assert_eq!(guide(vec![over], 11.0 * exact * exact).even_deviation(), 0.0);
        // More rays than elsewhere go there.
        let (tangent, bitangent) = frame(receiver.normal);
        let unit = way.normalize_or_zero();
        let local = Vec3::new(unit.dot(tangent), unit.dot(bitangent), unit.y);
        let guide = guide(vec![over], 0.0);
        let to_spot = (0..256).map(|index| guide.warp(key.point2(index))).filter(|aim| {
            assert!(aim.share > 0.0);
            (aim.point - hemisphere_point(local)).length() < 0.02
        });
        // Half of all rays follow the hints.
        assert!((to_spot.count() as f32 / 256.0 - 0.5).abs() < 0.05);
    }

    /// A triangle of 100 in all channels.
    fn part(position: Vec3, normal: Vec3, area: f32, root: usize) -> Part {
        let (tangent, bitangent) = frame(normal);
        // Equilateral: of side a, its area is √3/4 a², and its corners are a/√3 from its middle.
        let reach = (area * 4.0 / (3.0 * 3.0_f32.sqrt())).sqrt();
        let corner = |third: u8| {
            let (sin, cos) = libm::sincosf(f32::from(third) * std::f32::consts::TAU / 3.0);
            position + (tangent * cos + bitangent * sin) * reach
        };
        let corners = [0, 1, 2].map(corner);
        Part { position, normal, area, radiance: 100.0, plane: PlaneId::NONE, root, corners }
    }

    /// Two lamps whose inner walls are a thousand triangles each, below a ceiling.
    #[test]
    fn hundreds_of_bright_triangles_make_few_spots_and_no_difference() {
        let mut scene = SceneParts::default();
        let white = scene.add_material(Material::lambertian("white", Rgb::splat(0.5)));
        scene.add_quad("floor", white, Vec3::ZERO, Vec3::Z * 4.0, Vec3::X * 4.0);
        let scene = Scene::new(scene).expect("a valid scene");
        let tracer = Tracer::new(&scene);
        let (radius, height, around, up) = (0.06, 0.1, 40_u16, 25_u16);
        let area = std::f32::consts::TAU * radius * height / f32::from(around * up);
        let lamp = |middle: Vec3, first: usize| -> Vec<Part> {
            (0..around * up)
                .map(|index| {
                    let angle = f32::from(index % around) * std::f32::consts::TAU / f32::from(around);
                    let (sin, cos) = libm::sincosf(angle);
                    let out = Vec3::new(cos, 0.0, sin);
                    let rise = Vec3::Y * (height * (f32::from(index / around) + 0.5) / f32::from(up));
                    part(middle + out * radius + rise, -out, area, first + usize::from(index))
                })
                .collect()
        };
        let mut parts = lamp(Vec3::new(1.0, 2.5, 1.0), 0);
        parts.extend(lamp(Vec3::new(3.0, 2.5, 2.0), 1000));
        let mut places = vec![None; 2000];
        let spots = Spots::among(parts.clone(), |root, place| places[root] = Some(place));
        assert!(spots.spots.len() <= MOST_SPOTS && spots.spots.len() > 16, "{}", spots.spots.len());
        assert_eq!(spots.places.len(), 2);
        assert!(places[..1000].iter().all(|p| p.is_some() && *p == places[0]));
        assert!(places[1000..].iter().all(|p| p.is_some() && *p == places[1000] && *p != places[0]));

        for (u, v) in [(0.1, 0.1), (0.3, 0.5), (0.05, 0.8)] {
            let receiver = Receiver::on(&tracer, TriangleId(0), Side::Front, Barycentric { u, v });
            let exact: f32 = parts
                .iter()
                .map(|part| {
                    let way = part.position - receiver.position;
                    let cosines = way.dot(receiver.normal) * (-way.dot(part.normal)).max(0.0);
                    1e4 * cosines * part.area / (PI * way.length_squared().powi(2))
                })
                .sum();
            let hints = spots.seen_from(&tracer, &receiver, 0.0, Key::new(1, Purpose::Test, 0));
            let guide = Guide::new(&Findings::default(), &hints, Gathered::default());
            // Spots look one way, which their triangles do within 15°: where these begin to look away that is 1 - cos 15° of the cosine of those
            // in front, and in 32 looks one more or less is 3 %.
            let ratio = guide.even_deviation().powi(2) / exact;
            assert!((ratio - 1.0).abs() < 0.07, "{ratio}");
            // Rays are sent where both are, and next to nowhere else but everywhere alike.
            let key = Key::new(2, Purpose::Test, 0);
            let (tangent, bitangent) = frame(receiver.normal);
            let near = |aim: &Aim| {
                let local = cosine_hemisphere(aim.point);
                let way = tangent * local.x + bitangent * local.y + receiver.normal * local.z;
                let is_there = |middle: Vec3| {
                    let to = middle - receiver.position;
                    (to - way * way.dot(to)).length() < 0.15
                };
                [Vec3::new(1.0, 2.55, 1.0), Vec3::new(3.0, 2.55, 2.0)].map(is_there)
            };
            let aims: Vec<[bool; 2]> = (0..1024).map(|i| near(&guide.warp(key.point2(i)))).collect();
            let [one, other] = [0, 1].map(|k| aims.iter().filter(|near| near[k]).count());
            assert!(one.min(other) > 100 && (one + other).abs_diff(512) < 30, "{one} {other}");
        }
    }
}
