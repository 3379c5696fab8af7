//! Image chains: the sequences of planar mirrors over which sources are seen as images, found before any gather. The file `reflector` holds what the
//! mirrors are.

mod reflector;

use glam::DVec3;

use catoptric_scene::{PunctualLight, Rgb};
use catoptric_trace::chain::MAX_PLANAR;
use catoptric_trace::plane::Plane;
use catoptric_trace::{PlaneId, Tracer};

use crate::Receiver;
use crate::chain_tree::ChainTree;
use crate::contour::Polygon;
use crate::emitter::Emitters;
use crate::light_tree::{View, Windows};
use crate::reach::{Ball, Beam, Reach, source_balls};

pub use reflector::{Aperture, Reflector};
use reflector::{frame, in_front, reflectors};

/// Mirrors in the order in which a path from the receiver meets them.
#[derive(Clone, Debug)]
pub struct ImageChain {
    /// Ids of the planes.
    pub planes: Vec<PlaneId>,
    /// Indices into [`ImageChains::reflectors`].
    pub(crate) reflectors: Vec<usize>,
    /// Windows in unfolded space: each a choice of one piece per mirror, seen from the light. Where there are too many or pieces overlap,
    /// one of rectangles around all pieces of each mirror.
    pub(crate) windows: Vec<Vec<Polygon>>,
    /// The windows are mirrors; not so rectangles around them, where following the chain decides.
    exact: bool,
    /// The equations of [`ImageChain::planes`].
    equations: Vec<Plane>,
    /// Each mirror reflects alike all over its windows.
    even: bool,
    strength: f32,
    /// Of a small mirror.
    facet: Option<Facet>,
}

/// What is known at once of light over a small mirror.
#[derive(Clone, Debug)]
struct Facet {
    /// Around the mirror.
    ball: Ball,
    /// Where light of area sources over it arrives.
    reach: Vec<Reach>,
}

/// All chains that are followed by images; others belong to the hemisphere rays.
#[derive(Clone, Debug, Default)]
pub struct ImageChains {
    reflectors: Vec<Reflector>,
    /// Those of facets last.
    chains: Vec<ImageChain>,
    /// Of those before them.
    tree: ChainTree,
    /// There are more than are listed.
    cut_short: bool,
    /// Their planes, ascending.
    listed: Vec<Vec<PlaneId>>,
    /// Planes of the facets that have a chain, ascending: they are many.
    facets: Vec<PlaneId>,
    /// Of each punctual light of the scene: the chains that it shines into, ascending, and where it arrives by them.
    punctual: Vec<Vec<(u32, Reach)>>,
}

/// Chains of mirrors that are no facets, at most: where there are more, light over the others is followed from the sources.
const MAX_CHAINS: usize = 64;
/// Chains whose reflectances multiply to less are left to the hemisphere rays.
const MIN_STRENGTH: f32 = 2e-3;
/// So many emitting cells are not asked one by one whether they light a reflector.
const MANY_CELLS: usize = 1024;
/// Combinations of pieces beyond which a chain has no windows.
const MAX_WINDOWS: usize = 8;

impl ImageChains {
    /// Finds the reflectors and the chains between them that can carry light from a source, and the facets that can. `bright_sky`: there
    /// is a part of the sky that counts as one.
    pub fn new(tracer: &Tracer, emitters: &Emitters, bright_sky: bool) -> Self {
        let mut reflectors = reflectors(tracer, emitters.lamps());
        reflectors.sort_by_key(|r| r.is_facet);
        let far_sources = !tracer.scene().lights().is_empty() || bright_sky;
        let sees = |a: &Reflector, b: &Reflector| {
            a.pieces
                .iter()
                .any(|p| b.pieces.iter().any(|q| in_front(p, &q.outline) && in_front(q, &p.outline)))
        };
        let lit = |r: &Reflector| {
            far_sources
                || emitters.cells().len() > MANY_CELLS
                || emitters.cells().iter().filter(|cell| cell.plane != r.id).any(|cell| {
                    let outline = cell.polygon();
                    let emitting = Aperture { outline, normal: cell.normal, double_sided: false };
                    r.pieces.iter().any(|p| in_front(p, &outline) && in_front(&emitting, &p.outline))
                })
        };
        let count = reflectors.partition_point(|r| !r.is_facet);
        let visible: Vec<Vec<bool>> = (0..count)
            .map(|a| (0..count).map(|b| a != b && sees(&reflectors[a], &reflectors[b])).collect())
            .collect();
        let is_lit: Vec<bool> = reflectors.iter().map(lit).collect();

        // Breadth first: short chains carry most light.
        let mut found: Vec<ImageChain> = Vec::new();
        let mut front: Vec<Vec<usize>> = (0..count).map(|r| vec![r]).collect();
        let mut examined = 0;
        for _ in 0..MAX_PLANAR {
            let mut next = Vec::new();
            for chain in &front {
                let strength: f32 = chain.iter().map(|&r| reflectors[r].strength).product();
                examined += 1;
                if strength < MIN_STRENGTH || examined > 20_000 {
                    continue;
                }
                let last = chain[chain.len() - 1];
                if is_lit[last] {
                    found.push(ImageChain::over(&reflectors, chain));
                }
                for next_reflector in (0..count).filter(|&r| visible[last][r]) {
                    let mut longer = chain.clone();
                    longer.push(next_reflector);
                    next.push(longer);
                }
            }
            if found.len() >= 4 * MAX_CHAINS {
                break;
            }
            front = next;
        }
        found.sort_by(|a, b| {
            b.strength
                .total_cmp(&a.strength)
                .then(a.planes.len().cmp(&b.planes.len()))
                .then(a.planes.cmp(&b.planes))
        });
        let cut_short = found.len() > MAX_CHAINS;
        found.truncate(MAX_CHAINS);
        let balls = source_balls(tracer, emitters);
        let facets = (count..reflectors.len()).filter(|&r| is_lit[r]).map(|facet| {
            let mut chain = ImageChain::over(&reflectors, &[facet]);
            chain.facet = Some(Facet::new(&balls, bright_sky, &reflectors[facet]));
            chain
        });
        let large = found.len();
        found.extend(facets);
        let mut facets: Vec<PlaneId> = found[large..].iter().flat_map(|c| c.planes.iter().copied()).collect();
        facets.sort_unstable();
        for chain in &mut found {
            chain.find_windows(&reflectors);
        }
        let mut listed: Vec<Vec<PlaneId>> = found[..large].iter().map(|c| c.planes.clone()).collect();
        listed.sort_unstable();
        let tree = ChainTree::new(&reflectors, &found[..large]);
        let lit_by = |light: &PunctualLight| {
            let reach =
                |(index, chain): (u32, &ImageChain)| Some((index, chain.reach_of(&reflectors, light)?));
            (0..).zip(&found).filter_map(reach).collect()
        };
        let punctual = tracer.scene().lights().iter().map(lit_by).collect();
        Self { reflectors, chains: found, tree, cut_short, listed, facets, punctual }
    }

    /// Whether there are more chains than are listed: light over the others is followed from the sources.
    pub fn are_cut_short(&self) -> bool {
        self.cut_short
    }

    /// Indices of the chains over which light may arrive at a receiver, as far as that is known at once, ascending.
    pub(crate) fn seen_from(&self, position: DVec3, geometric: DVec3, seen: &mut Vec<u32>) {
        self.tree.seen_from(position, geometric, seen);
        seen.extend(self.listed.len() as u32..self.chains.len() as u32);
    }

    /// The chains by which a punctual light, by its index in the scene, may arrive at a place, in turn.
    pub(crate) fn of_punctual(&self, light: usize, place: DVec3) -> impl Iterator<Item = &ImageChain> {
        let those = self.punctual[light].iter().filter(move |(_, reach)| reach.holds(place));
        those.map(|&(index, _)| &self.chains[index as usize])
    }

    /// The chains.
    pub fn chains(&self) -> &[ImageChain] {
        &self.chains
    }

    /// The reflectors.
    pub fn reflectors(&self) -> &[Reflector] {
        &self.reflectors
    }

    /// Whether a sequence of planes is on the list.
    pub fn contains(&self, planes: &[PlaneId]) -> bool {
        let is_facet = || matches!(planes, [plane] if self.facets.binary_search(plane).is_ok());
        self.listed.binary_search_by(|listed| listed.as_slice().cmp(planes)).is_ok() || is_facet()
    }
}

impl Facet {
    /// `balls` are those around the area sources.
    fn new(balls: &[Ball], bright_sky: bool, facet: &Reflector) -> Self {
        let corners = facet.pieces.iter().flat_map(|p| p.outline.corners()).copied();
        let ball = Ball::around(corners);
        let area = balls.iter().map(|&source| Reach::over(&facet.plane, ball, source));
        Self { ball, reach: area.chain(bright_sky.then_some(Reach::Everywhere)).collect() }
    }

    /// Whether light of area sources may arrive over it at a place, on the side to which `geometric` points.
    fn may_light(&self, place: DVec3, geometric: DVec3) -> bool {
        self.ball.is_above(place, geometric) && self.reach.iter().any(|r| r.holds(place))
    }
}

/// A receiver's place in the unfolded space of a chain, where the light is where it really is and the path is straight.
#[derive(Clone, Debug)]
pub struct Unfolded {
    /// Image of the receiver's position.
    pub position: DVec3,
    /// Image of its normal.
    pub normal: DVec3,
    /// Image of its geometric normal.
    pub geometric: DVec3,
    /// The last mirror's plane: what emits in it has no image in it.
    pub last: PlaneId,
    /// The receiver's own plane where it looks straight: what emits in it sends nothing along it, though by rounding it may lie before it.
    pub own: PlaneId,
    /// The last mirror's equation, turned so that what it reflects to the receiver has n·x > offset.
    pub beyond: Option<Plane>,
}

impl Unfolded {
    /// A receiver that looks straight, over no mirror.
    pub(crate) fn straight(receiver: &Receiver) -> Self {
        Self {
            position: receiver.position.as_dvec3(),
            normal: receiver.normal.as_dvec3(),
            geometric: receiver.geometric.as_dvec3(),
            last: PlaneId::NONE,
            own: receiver.plane,
            beyond: None,
        }
    }

    /// Whether what emits in a plane sends nothing from there.
    pub(crate) fn is_along(&self, plane: PlaneId) -> bool {
        plane == self.last || plane == self.own
    }

    /// The view of the emitters from here.
    pub(crate) fn view<'a>(&self, windows: &'a Windows) -> View<'a> {
        let (point, beyond) = (self.position, self.beyond);
        View { point, normal: self.normal, geometric: self.geometric, windows, beyond }
    }
}

impl ImageChains {
    /// The receiver's image through a chain, or `None` if it lies behind the first mirror's every side.
    pub fn unfold(
        &self,
        chain: &ImageChain,
        position: DVec3,
        normal: DVec3,
        geometric: DVec3,
    ) -> Option<Unfolded> {
        let (last, own) = (PlaneId::NONE, PlaneId::NONE);
        let mut image = Unfolded { position, normal, geometric, last, own, beyond: None };
        for &index in &chain.reflectors {
            let reflector = &self.reflectors[index];
            let height = |p: &Aperture| p.normal.dot(image.position - p.outline.corners()[0]);
            // The image of the receiver must see the reflecting side of this mirror.
            if !reflector.pieces.iter().any(|p| p.double_sided || height(p) > 0.0) {
                return None;
            }
            image.position = reflector.plane.reflect_point(image.position);
            image.normal = reflector.plane.reflect_vector(image.normal);
            image.geometric = reflector.plane.reflect_vector(image.geometric);
            image.last = reflector.id;
            let Plane { normal, offset } = reflector.plane;
            let turned = if normal.dot(image.position) > offset { -1.0 } else { 1.0 };
            image.beyond = Some(Plane { normal: normal * turned, offset: offset * turned });
        }
        Some(image)
    }

    /// What the mirrors of a chain reflect together of light along `direction` in unfolded space, about: glass as Schlick (1994) has it.
    /// More than zero, so that it can be divided by; one where no direction is known.
    pub(crate) fn reflectance(&self, chain: &ImageChain, direction: DVec3) -> f64 {
        let Some(mut direction) = direction.try_normalize() else { return 1.0 };
        let mut share = 1.0;
        for &index in chain.reflectors.iter().rev() {
            let Reflector { plane, strength, .. } = &self.reflectors[index];
            let (cos, strength) = (plane.normal.dot(direction).abs(), f64::from(*strength).min(1.0));
            share *= strength + (1.0 - strength) * (1.0 - cos).powi(5);
            direction = plane.reflect_vector(direction);
        }
        share.max(f64::from(MIN_STRENGTH))
    }

    /// The plane of a chain's first mirror, and a ball around all of the mirror.
    pub fn first_mirror(&self, chain: &ImageChain) -> Option<(Plane, DVec3, f64)> {
        let reflector = &self.reflectors[*chain.reflectors.first()?];
        let corners = || reflector.pieces.iter().flat_map(|piece| piece.outline.corners());
        let center = corners().sum::<DVec3>() / corners().count().max(1) as f64;
        let radius = corners().map(|c| c.distance(center)).fold(0.0, f64::max);
        Some((reflector.plane, center, radius))
    }

    /// Where a path to the point `light` aims before each mirror, and the light itself last.
    pub fn targets(&self, chain: &ImageChain, light: DVec3, targets: &mut Vec<glam::Vec3>) {
        targets.clear();
        targets.push(light.as_vec3());
        let mut image = light;
        for &index in chain.reflectors.iter().rev() {
            image = self.reflectors[index].plane.reflect_point(image);
            targets.push(image.as_vec3());
        }
        targets.reverse();
    }
}

impl ImageChain {
    /// Over some of the reflectors, in this order.
    fn over(reflectors: &[Reflector], chain: &[usize]) -> Self {
        Self {
            planes: chain.iter().map(|&r| reflectors[r].id).collect(),
            reflectors: chain.to_vec(),
            windows: Vec::new(),
            exact: false,
            equations: chain.iter().map(|&r| reflectors[r].plane).collect(),
            even: chain.iter().all(|&r| reflectors[r].even),
            strength: chain.iter().map(|&r| reflectors[r].strength).product(),
            facet: None,
        }
    }

    /// Finds the windows: every combination of one piece per mirror, if there are few.
    fn find_windows(&mut self, reflectors: &[Reflector]) {
        let counts: Vec<usize> = self.reflectors.iter().map(|&r| reflectors[r].apertures.len()).collect();
        let combinations: usize = counts.iter().product();
        self.exact = (1..=MAX_WINDOWS).contains(&combinations);
        // Seen from the light: reflected at every later mirror.
        let seen = |outline: &Polygon, level: usize| {
            let mut corners = outline.corners().to_vec();
            for &later in &self.reflectors[level + 1..] {
                for corner in &mut corners {
                    *corner = reflectors[later].plane.reflect_point(*corner);
                }
            }
            Polygon::new(&corners)
        };
        let window = |mut combination: usize| {
            let outline = |(level, &index): (usize, &usize)| {
                let Reflector { apertures, pieces, plane, .. } = &reflectors[index];
                if !self.exact {
                    return seen(&frame(pieces, plane.normal), level);
                }
                let choice = combination % counts[level];
                combination /= counts[level];
                seen(&apertures[choice].outline, level)
            };
            self.reflectors.iter().enumerate().map(outline).collect()
        };
        self.windows = (0..if self.exact { combinations } else { 1 }).map(window).collect();
    }

    /// Whether light of area sources may arrive at a place, on the side to which `geometric` points.
    #[inline]
    pub(crate) fn may_light(&self, place: DVec3, geometric: DVec3) -> bool {
        self.facet.as_ref().is_none_or(|facet| facet.may_light(place, geometric))
    }

    /// Where a punctual light arrives over these mirrors; `None` if nowhere: what it sends is followed through the windows, from the last.
    fn reach_of(&self, reflectors: &[Reflector], light: &PunctualLight) -> Option<Reach> {
        let beam = Beam::of(light);
        let last = &reflectors[*self.reflectors.last()?];
        if !last.pieces.iter().any(|p| p.double_sided || beam.is_above(p.normal, p.outline.corners()[0])) {
            return None;
        }
        let mut corners: Vec<DVec3> = Vec::new();
        for windows in &self.windows {
            let (mut through, mut part) = (beam.clone(), Polygon::new(&[]));
            for window in windows.iter().rev() {
                part = through.part(window);
                if part.is_empty() {
                    break;
                }
                through.narrow(&part);
            }
            corners.extend_from_slice(part.corners());
        }
        if corners.is_empty() {
            return None;
        }
        // From where the light is straight to where the receiver is.
        let (first, others) = self.equations.split_first()?;
        let at_first = |point: DVec3| others.iter().rev().fold(point, |p, plane| plane.reflect_point(p));
        let turned = |way: DVec3| self.equations.iter().rev().fold(way, |w, plane| plane.reflect_vector(w));
        let window = Ball::around(corners.into_iter().map(at_first));
        Some(beam.reach(window, |point| first.reflect_point(at_first(point)), turned))
    }

    /// The mirrors from the one at `level` on, if light that is seen through the windows is certain to be reflected by them.
    pub(crate) fn mirrors_from(&self, level: usize) -> Option<(&[Plane], PlaneId)> {
        (self.even && self.exact).then(|| (&self.equations[level..], self.planes[level]))
    }

    /// Whether it is that of a small mirror.
    pub fn is_of_facet(&self) -> bool {
        self.facet.is_some()
    }

    /// Product of the mirrors' largest reflectances.
    pub fn strength(&self) -> f32 {
        self.strength
    }

    /// An upper bound of what is lost when the chain is left out.
    pub fn bound(&self, power: Rgb) -> Rgb {
        power * self.strength
    }
}
