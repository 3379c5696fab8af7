//! Small bright places on diffuse surfaces: the inside of a lamp's shade, a wall beside a bulb. None of the rays of a gather and of
//! those beside may have met them, and the guide that these make does not know them. What sources and the coarse solution tell does.

use std::f32::consts::PI;

use glam::{Vec2, Vec3};

use catoptric_light::{ImageChain, Lights, Receiver};
use catoptric_scene::Rgb;
use catoptric_trace::plane::Plane;
use catoptric_trace::sequence::{Key, frame, hemisphere_point};
use catoptric_trace::walk;

use crate::guide::{Hints, PlaceId, WINDOWS, Window};
use crate::patch::PatchMesh;

use super::Sight;
use super::bright::{MOST_CORNERS, MOST_SPOTS, Part, Place, Spot, bright_parts, spots_of};

/// Share of the variance that is known from which on spots are worth a look, …
const MINOR: f32 = 0.1;
/// … and share of that by all of them from which on a place is worth a window.
const MINOR_PLACE: f32 = 1.0 / 32.0;
/// Rays from each gather that look which spots are seen. Five lamps in cans, noise of the indirect light: × 1.5 with 8, × 1.2 with 16, × 0.98
/// with 64, all in the same time.
const LOOKS: f32 = 32.0;
/// … and where they do not add more to the variance than is known.
const FEWEST_LOOKS: f32 = 8.0;
/// What a place may add that no look sees, in looks: a lamp's inner wall is seen by a sliver. The same lamps: noise × 0.65.
const UNSEEN: f32 = 0.5;
/// Squared radius of a place by squared distance from which on it is not small, wherever its corners are.
const LARGE: f32 = 0.25;
/// Chains of mirrors over which spots are looked for, at most, …
const MOST_CHAINS: usize = 8;
/// … and the least that they reflect.
const LEAST_STRENGTH: f32 = 0.2;
/// Ways to see a spot: straight, and over each chain.
const WAYS: usize = 1 + MOST_CHAINS;

/// A receiver as it looks at spots: straight, or from where it is in the unfolded space of a chain of mirrors.
struct View<'a> {
    chain: Option<&'a ImageChain>,
    position: Vec3,
    tangent: Vec3,
    bitangent: Vec3,
    normal: Vec3,
    /// Spots in front of this plane alone are seen over the last mirror.
    beyond: Option<Plane>,
    /// Squared share of the light that the mirrors reflect at most.
    strength: f32,
}

impl<'a> View<'a> {
    fn straight(receiver: &Receiver) -> Self {
        let (normal, position) = (receiver.normal, receiver.position);
        let (tangent, bitangent) = frame(normal);
        Self { chain: None, position, tangent, bitangent, normal, beyond: None, strength: 1.0 }
    }

    /// This one's image, if the mirrors are before it.
    fn over(&self, lights: &Lights, chain: &'a ImageChain) -> Option<Self> {
        let [position, normal, tangent, bitangent] =
            [self.position, self.normal, self.tangent, self.bitangent].map(Vec3::as_dvec3);
        let chains = lights.chains();
        let one = chains.unfold(chain, position, normal, tangent)?;
        let other = chains.unfold(chain, position, normal, bitangent)?;
        Some(Self {
            chain: Some(chain),
            position: one.position.as_vec3(),
            tangent: one.geometric.as_vec3(),
            bitangent: other.geometric.as_vec3(),
            normal: one.normal.as_vec3(),
            beyond: one.beyond,
            strength: chain.strength().powi(2),
        })
    }

    /// What a spot adds to the variance of one ray if it is seen.
    #[inline]
    fn variance(&self, spot: &Spot) -> f32 {
        if self.beyond.is_some_and(|plane| plane.normal.dot(spot.position.as_dvec3()) <= plane.offset) {
            return 0.0;
        }
        let way = spot.position - self.position;
        let distance = way.length_squared();
        let cosines = way.dot(self.normal).max(0.0) * (-way.dot(spot.normal)).max(0.0);
        // No more than half of the view: seen from so near, the centre does not stand for the rest.
        let share = (cosines * spot.area / (PI * distance * distance).max(f32::MIN_POSITIVE)).min(0.5);
        self.strength * spot.radiance * spot.radiance * share
    }

    /// What a place adds at most.
    #[inline]
    fn most(&self, place: &Place) -> f32 {
        let distance = place.center().distance(self.position) - place.radius();
        // From within no more than half of the view, as above.
        let share = 1.0 / (PI * distance.max(0.0).powi(2)).max(f32::MIN_POSITIVE);
        self.strength * (place.noise * share).min(0.5 * place.brightest)
    }

    /// The point of the unit square in whose direction a point is seen.
    fn point(&self, way: Vec3) -> Vec2 {
        let unit = way.normalize_or_zero();
        hemisphere_point(Vec3::new(unit.dot(self.tangent), unit.dot(self.bitangent), unit.dot(self.normal)))
    }

    /// Share of the light of a spot that arrives.
    fn sees(&self, lights: &Lights, receiver: &Receiver, spot: &Spot, targets: &mut Vec<Vec3>) -> Rgb {
        let tracer = lights.tracer();
        match self.chain {
            None => tracer.visibility(receiver.position, receiver.plane, spot.position, spot.plane),
            Some(chain) => {
                lights.chains().targets(chain, spot.position.as_dvec3(), targets);
                walk::follow(tracer, receiver.position, receiver.plane, &chain.planes, targets, spot.plane)
            }
        }
    }

    /// Where a place is seen, if it is small there: around those of its spots that face the receiver.
    fn window(&self, spots: &[Spot], place: &Place) -> Option<Window> {
        if place.radius().powi(2) > LARGE * place.center().distance_squared(self.position) {
            return None;
        }
        let mut is_needed = [false; MOST_CORNERS];
        for spot in spots.iter().filter(|spot| self.variance(spot) > 0.0) {
            spot.corners.iter().for_each(|&c| is_needed[usize::from(c)] = true);
        }
        let needed = place.corners.iter().zip(is_needed).filter(|(_, is_needed)| *is_needed);
        let ways = needed.map(|(corner, _)| *corner - self.position);
        // What is below the horizon is not seen.
        let above = ways.map(|way| way - self.normal * way.dot(self.normal).min(0.0));
        let window = Window::around(above.map(|way| self.point(way)));
        window.is_small().then_some(window)
    }
}

/// The bright places of a scene.
#[derive(Clone, Debug, Default)]
pub(super) struct Spots {
    /// By place.
    spots: Vec<Spot>,
    places: Vec<Place>,
    /// Per element of what gathers look at; empty where there are no spots.
    of_element: Vec<Option<PlaceId>>,
    /// Chains of mirrors over which they may be seen, of all that there are.
    chains: Vec<usize>,
}

impl Spots {
    /// Where `irradiance` per vertex of what gathers look at makes base triangles bright.
    pub(super) fn new(lights: &Lights, sight: &Sight, patches: &PatchMesh, irradiance: &[Rgb]) -> Self {
        let (parts, is_bright) = bright_parts(lights.tracer(), sight, patches, irradiance);
        let mut of_root = vec![None; patches.of_root.len()];
        let mut spots = Self::among(lights, &parts, |root, place| of_root[root] = Some(place));
        if !spots.spots.is_empty() {
            let of_elements = sight.displayed.roots.iter().zip(is_bright);
            let place = |(&root, is_bright): (&u32, bool)| of_root[root as usize].filter(|_| is_bright);
            spots.of_element = of_elements.map(place).collect();
        }
        spots
    }

    /// Those that bright base triangles make together; `tell` is told the place of each triangle.
    fn among(lights: &Lights, parts: &[Part], tell: impl FnMut(usize, PlaceId)) -> Self {
        let (spots, places) = spots_of(parts, tell);
        let chains = lights.chains().chains().iter().enumerate();
        let strong = chains.filter(|(_, chain)| chain.strength() >= LEAST_STRENGTH && !chain.is_of_facet());
        let mut strong: Vec<usize> = strong.map(|(index, _)| index).collect();
        strong.sort_by_key(|&index| lights.chains().chains()[index].planes.len());
        strong.truncate(MOST_CHAINS);
        Self { spots, places, of_element: Vec::new(), chains: strong }
    }

    /// The place that an element of what gathers look at belongs to.
    #[inline]
    pub(super) fn place_of(&self, element: u32) -> Option<PlaceId> {
        self.of_element.get(element as usize).copied().flatten()
    }

    /// Where in the hemisphere they are seen, straight and over mirrors, if they add much to the variance of a ray that is `known`.
    pub(super) fn seen_from(&self, lights: &Lights, receiver: &Receiver, known: f32, key: Key) -> Hints {
        let mut hints = Hints::default();
        if self.spots.is_empty() {
            return hints;
        }
        let mut views = vec![View::straight(receiver)];
        for &index in &self.chains {
            views.extend(views[0].over(lights, &lights.chains().chains()[index]));
        }
        // Most of what is far off, behind a mirror or small need not be looked at spot by spot.
        let count = self.spots.len();
        let (least, mut total) = (MINOR_PLACE * MINOR * known, 0.0_f32);
        // By view, then by spot: sums so far.
        let mut sums = [0.0; WAYS * MOST_SPOTS];
        for (view, sums) in views.iter().zip(sums.chunks_exact_mut(count)) {
            for place in &self.places {
                let [first, end] = place.spots;
                let is_minor = view.most(place) <= least.max(MINOR_PLACE * total);
                for (sum, spot) in sums[first..end].iter_mut().zip(&self.spots[first..end]) {
                    total += if is_minor { 0.0 } else { view.variance(spot) };
                    *sum = total;
                }
            }
        }
        if total <= MINOR * known || total <= 0.0 {
            return hints;
        }
        let looks = (FEWEST_LOOKS * total / known.max(f32::MIN_POSITIVE)).clamp(FEWEST_LOOKS, LOOKS);
        let each = total / looks;
        let before = |index: usize| if index > 0 { sums[index - 1] } else { 0.0 };
        let mut major: Vec<(f32, usize, usize)> = Vec::new();
        for view in 0..views.len() {
            for (index, place) in self.places.iter().enumerate() {
                let [first, end] = place.spots.map(|spot| before(view * count + spot));
                if end - first > MINOR_PLACE * total {
                    major.push((end - first, view, index));
                }
            }
        }
        major.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut opened: Vec<(usize, usize)> = Vec::new();
        for (own, view, index) in major {
            let place = &self.places[index];
            let [first, end] = place.spots;
            if opened.len() < WINDOWS
                && let Some(window) = views[view].window(&self.spots[first..end], place)
            {
                hints.open(PlaceId(index as u16), window, UNSEEN * own.min(each));
                opened.push((view, index));
            }
        }
        let mut next = key.uniform(0) * each;
        let mut targets = Vec::new();
        for (index, view) in views.iter().enumerate() {
            for (spot, sum) in self.spots.iter().zip(&sums[index * count..]) {
                let looks = ((sum - next) / each).ceil().max(0.0);
                if looks < 1.0 {
                    continue;
                }
                next += looks * each;
                let seen = view.sees(lights, receiver, spot, &mut targets);
                if seen != Rgb::ZERO {
                    let window = opened.iter().position(|&o| o == (index, usize::from(spot.place.0)));
                    let at = view.point(spot.position - view.position);
                    hints.add(window, at, looks * each * seen.max_element());
                }
            }
        }
        hints
    }
}

#[cfg(test)]
mod tests {
    use catoptric_scene::{Barycentric, Material, Radiance, Scene, Side, TriangleId};
    use catoptric_trace::sequence::{Purpose, cosine_hemisphere};

    use crate::gather::Gathered;
    use crate::guide::{Aim, Findings, Guide};

    use catoptric_light::LightParams;
    use catoptric_trace::{PlaneId, Tracer};

    use super::super::bright::outline;
    use super::super::tests::floor;
    use super::*;

    #[test]
    fn spots_that_are_seen_and_no_others_draw_rays() {
        let (mut parts, white) = floor();
        // A screen in the middle, a metre high.
        parts.add_quad("screen", white, Vec3::new(2.0, 0.0, 4.0), Vec3::Z * -4.0, Vec3::Y);
        let scene = Scene::new(parts).expect("a valid scene");
        let tracer = Tracer::new(&scene);
        let lights = Lights::new(&tracer, LightParams::default());
        let receiver = Receiver::on(&tracer, TriangleId(0), Side::Front, Barycentric { u: 0.1, v: 0.1 });
        assert!(receiver.position.x < 2.0 && receiver.normal == Vec3::Y);
        let spot = |position: Vec3, normal: Vec3| part(position, normal, 1e-3, 0);
        let over = spot(receiver.position + Vec3::new(0.5, 1.5, 0.2), Vec3::NEG_Y);
        let behind = spot(Vec3::new(3.5, 0.3, receiver.position.z), Vec3::NEG_X);
        let turned = spot(over.position, Vec3::Y);
        let key = Key::new(1, Purpose::Test, 0);
        let guide = |parts: Vec<Part>, known: f32| {
            let hints = Spots::among(&lights, &parts, |_, _| ()).seen_from(&lights, &receiver, known, key);
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

    /// A screen hides a bright place, and a mirror shows it.
    #[test]
    fn places_are_seen_over_mirrors() {
        let (mut parts, white) = floor();
        let mirror = parts.add_material(Material::mirror("mirror", Rgb::splat(0.9)));
        let lamp = parts.add_material(Material::emitter("lamp", Radiance(Rgb::ONE)));
        parts.add_quad("mirror", mirror, Vec3::new(4.0, 0.0, 0.0), Vec3::Z * 4.0, Vec3::Y * 3.0);
        parts.add_quad("lamp", lamp, Vec3::new(3.0, 3.0, 1.0), Vec3::X * 0.1, Vec3::Z * 0.1);
        // Above the receiver, and below the place.
        parts.add_quad("screen", white, Vec3::new(0.0, 1.0, 0.0), Vec3::X * 2.0, Vec3::Z * 4.0);
        let scene = Scene::new(parts).expect("a valid scene");
        let tracer = Tracer::new(&scene);
        let lights = Lights::new(&tracer, LightParams::default());
        let receiver = Receiver::on(&tracer, TriangleId(0), Side::Front, Barycentric { u: 0.2, v: 0.4 });
        let place = Vec3::new(1.9, 2.5, 2.0);
        let image = Vec3::new(8.0 - place.x, place.y, place.z);
        // It looks away from the receiver.
        let own = part(place, Vec3::X, 1e-3, 0);
        assert!(receiver.position.x < place.x);
        let spots = Spots::among(&lights, &[own], |_, _| ());
        let hints = spots.seen_from(&lights, &receiver, 0.0, Key::new(1, Purpose::Test, 0));
        let guide = Guide::new(&Findings::default(), &hints, Gathered::default());
        // What it adds is what its image, nine tenths as bright, adds.
        let way = image - receiver.position;
        let cosines = way.y * way.x;
        let share = cosines * own.area / (PI * way.length_squared().powi(2));
        // Of that, two factors are foretold and the third is seen: of the radiance squared two would do.
        let exact = 100.0 * (0.9_f32.powi(3) * share).sqrt();
        assert!((guide.even_deviation() / exact - 1.0).abs() < 1e-3, "{} {exact}", guide.even_deviation());
        let (tangent, bitangent) = frame(receiver.normal);
        let unit = way.normalize_or_zero();
        let at = hemisphere_point(Vec3::new(unit.dot(tangent), unit.dot(bitangent), unit.y));
        let key = Key::new(2, Purpose::Test, 0);
        let there = (0..256).filter(|&i| guide.warp(key.point2(i)).point.distance(at) < 0.02).count();
        assert!((there as f32 / 256.0 - 0.5).abs() < 0.05, "{there}");
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
        let corners = outline(normal, corners.into_iter());
        Part { position, normal, area, radiance: 100.0, plane: PlaneId::NONE, root, corners }
    }

    /// Two lamps whose inner walls are a thousand triangles each, below a ceiling.
    #[test]
    fn hundreds_of_bright_triangles_make_few_spots_and_no_difference() {
        let scene = Scene::new(floor().0).expect("a valid scene");
        let tracer = Tracer::new(&scene);
        let lights = Lights::new(&tracer, LightParams::default());
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
        let spots = Spots::among(&lights, &parts, |root, place| places[root] = Some(place));
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
            let hints = spots.seen_from(&lights, &receiver, 0.0, Key::new(1, Purpose::Test, 0));
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
