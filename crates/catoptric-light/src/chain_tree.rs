//! Which image chains a receiver may see light over: a tree of all chains, from their first mirrors on, that is followed as far as something
//! of a mirror is seen in those before it (beam tracing: Heckbert & Hanrahan 1984). Keys in docs/references.md: HeckbertHanrahan1984.

use glam::{DVec2, DVec3};

use catoptric_trace::plane::Plane;

use crate::chains::{Aperture, ImageChain, Reflector};
use crate::contour::{MAX_CORNERS, Polygon};

/// A mirror behind those on the way to it.
#[derive(Clone, Debug)]
struct Node {
    /// In [`Reflector`]s.
    reflector: usize,
    /// Its image in them: around all its pieces, where the receiver is where it really is and the path is straight.
    window: Polygon,
    /// Sides that reflect, likewise: unit normals and offsets; both of one where the normal is of either.
    sides: Vec<(DVec3, f64, bool)>,
    /// The chain that ends here.
    chain: Option<u32>,
    children: Vec<u32>,
}

/// All chains of large mirrors, from their first mirrors on.
#[derive(Clone, Debug, Default)]
pub(crate) struct ChainTree {
    nodes: Vec<Node>,
    first: Vec<u32>,
}

/// What is seen through a window may touch its edge: by so much of unit length.
const SLACK: f64 = 1e-9;

impl ChainTree {
    /// Of chains without a small mirror.
    pub(crate) fn new(reflectors: &[Reflector], chains: &[ImageChain]) -> Self {
        let mut tree = Self::default();
        for (index, chain) in chains.iter().enumerate() {
            let mut at: Option<u32> = None;
            for (level, &reflector) in chain.reflectors.iter().enumerate() {
                let children = at.map_or(&tree.first, |node| &tree.nodes[node as usize].children);
                let known = children.iter().copied().find(|&c| tree.nodes[c as usize].reflector == reflector);
                let node = known.unwrap_or_else(|| {
                    let before = chain.reflectors[..level].iter().map(|&r| &reflectors[r].plane);
                    let new = tree.nodes.len() as u32;
                    tree.nodes.push(Node::new(reflector, &reflectors[reflector], before));
                    let children = at.map_or(&mut tree.first, |node| &mut tree.nodes[node as usize].children);
                    children.push(new);
                    new
                });
                at = Some(node);
            }
            if let Some(node) = at {
                tree.nodes[node as usize].chain = Some(index as u32);
            }
        }
        tree
    }

    /// The chains over which something may be seen from a position above the plane of `geometric`, by their indices, ascending.
    pub(crate) fn seen_from(&self, position: DVec3, geometric: DVec3, seen: &mut Vec<u32>) {
        seen.clear();
        let horizon = [geometric];
        for &node in &self.first {
            self.follow(node, position, &horizon, seen);
        }
        seen.sort_unstable();
    }

    fn follow(&self, node: u32, position: DVec3, beam: &[DVec3], seen: &mut Vec<u32>) {
        let node = &self.nodes[node as usize];
        if !node.reflects_towards(position) {
            return;
        }
        let Node { window, chain, children, .. } = node;
        // Most planes cut nothing off, or all: half a kilobyte need not be moved.
        let mut part: Option<Polygon> = None;
        for normal in beam {
            let (known, offset) = (part.as_ref().unwrap_or(window), normal.dot(position) - SLACK);
            let inside = known.corners().iter().filter(|c| normal.dot(**c) - offset >= 0.0).count();
            if inside == known.corners().len() {
                continue;
            }
            if inside == 0 {
                return;
            }
            let rest = known.clipped(*normal, offset);
            if rest.is_empty() {
                return;
            }
            part = Some(rest);
        }
        seen.extend(chain);
        if children.iter().any(|&child| self.nodes[child as usize].reflects_towards(position)) {
            let mut beam = [DVec3::ZERO; MAX_CORNERS];
            let mut sides = 0;
            for (side, normal) in beam.iter_mut().zip(part.as_ref().unwrap_or(window).sight_planes(position))
            {
                *side = normal;
                sides += 1;
            }
            for &child in children {
                self.follow(child, position, &beam[..sides], seen);
            }
        }
    }
}

impl Node {
    /// Whether a side of it that reflects is turned to a position.
    fn reflects_towards(&self, position: DVec3) -> bool {
        self.sides.iter().any(|&(normal, offset, both)| both || normal.dot(position) > offset)
    }

    fn new<'p>(
        reflector: usize,
        mirror: &Reflector,
        before: impl DoubleEndedIterator<Item = &'p Plane>,
    ) -> Self {
        let before: Vec<&Plane> = before.collect();
        let image = |point: DVec3| before.iter().rev().fold(point, |p, plane| plane.reflect_point(p));
        let turned = |vector: DVec3| before.iter().rev().fold(vector, |v, plane| plane.reflect_vector(v));
        let outline: Vec<DVec3> = around(mirror).into_iter().map(image).collect();
        let side = |piece: &Aperture| {
            let normal = turned(piece.normal);
            (normal, normal.dot(image(piece.outline.corners()[0])), piece.double_sided)
        };
        let mut sides: Vec<(DVec3, f64, bool)> = mirror.pieces().iter().map(side).collect();
        // Pieces of one plane that look the same way are one side.
        sides.dedup_by(|a, b| a.0.dot(b.0) > 0.0 && a.2 == b.2);
        Self { reflector, window: Polygon::new(&outline), sides, chain: None, children: Vec::new() }
    }
}

/// Corners of a convex polygon around all pieces of a mirror: of the one, or of a rectangle.
fn around(mirror: &Reflector) -> Vec<DVec3> {
    if let [only] = &mirror.apertures[..] {
        return only.outline.corners().to_vec();
    }
    let normal = mirror.plane.normal;
    let origin = normal * mirror.plane.offset;
    let x = normal.any_orthonormal_vector();
    let y = normal.cross(x);
    let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
    for corner in mirror.pieces().iter().flat_map(|p| p.outline.corners()) {
        let at = DVec2::new(x.dot(*corner - origin), y.dot(*corner - origin));
        (low, high) = (low.min(at), high.max(at));
    }
    [(low.x, low.y), (high.x, low.y), (high.x, high.y), (low.x, high.y)]
        .map(|(s, t)| origin + x * s + y * t)
        .to_vec()
}

#[cfg(test)]
mod tests {
    use catoptric_scene::{Material, Radiance, Rgb, Scene, SceneParts};
    use catoptric_trace::sequence::{Key, Purpose, cosine_hemisphere, frame};
    use catoptric_trace::{Event, MediumStack, PlaneId, Ray, Tracer};
    use glam::Vec3;

    use crate::{LightParams, Lights};

    /// A tube of five mirrors, one of them in two pieces with a gap between, and a sheet beside it that reflects on both sides; a lamp above.
    fn tube() -> Scene {
        let mut parts = SceneParts::default();
        let silver = parts.add_material(Material::mirror("silver", Rgb::splat(0.95)));
        let sheet = Material { double_sided: true, ..Material::mirror("sheet", Rgb::splat(0.9)) };
        let sheet = parts.add_material(sheet);
        let lamp = parts.add_material(Material::emitter("lamp", Radiance(Rgb::ONE)));
        let corner = |k: u8| {
            let (sin, cos) = libm::sincosf(std::f32::consts::TAU * f32::from(k) / 5.0);
            Vec3::new(0.3 * cos, 0.0, -0.3 * sin)
        };
        for k in 0..5 {
            let (from, along) = (corner(k), corner((k + 1) % 5) - corner(k));
            if k == 2 {
                parts.add_quad("tube", silver, from, Vec3::Y * 0.3, along);
                parts.add_quad("tube", silver, from + Vec3::Y * 0.5, Vec3::Y * 0.3, along);
            } else {
                parts.add_quad("tube", silver, from, Vec3::Y * 0.8, along);
            }
        }
        parts.add_quad("sheet", sheet, Vec3::new(-0.6, -0.5, -0.8), Vec3::X, Vec3::Z * 0.4 + Vec3::Y * 0.2);
        parts.add_quad("lamp", lamp, Vec3::new(-0.2, 1.0, -0.2), Vec3::X * 0.4, Vec3::Z * 0.4);
        Scene::new(parts).expect("a valid scene")
    }

    /// Whatever rays meet over mirrors, the tree names: it leaves out nothing that may be seen, and most of what may not.
    #[test]
    fn no_chain_is_left_out_that_a_ray_finds() {
        let scene = tube();
        let tracer = Tracer::new(&scene);
        let lights = Lights::new(&tracer, LightParams::default());
        let chains = lights.chains();
        let (mut seen, mut found, mut named, mut places) = (Vec::new(), 0, 0, 0);
        for place in 0..100 {
            let key = Key::new(4, Purpose::Test, place);
            let at = |k: u32| key.child(k).point2(0) * 2.0 - 1.0;
            let position = Vec3::new(at(0).x * 0.5, 0.3 * at(1).x - 0.2, at(0).y * 0.5);
            let normal = Vec3::new(at(2).x, at(1).y, at(2).y).normalize_or(Vec3::Y);
            chains.seen_from(position.as_dvec3(), normal.as_dvec3(), &mut seen);
            places += 1;
            named += seen.len();
            let (x, y) = frame(normal);
            for index in 0..1000 {
                let local = cosine_hemisphere(key.point2(index));
                let direction = x * local.x + y * local.y + normal * local.z;
                let mut ray = Ray::free(position, direction);
                let mut planes: Vec<PlaneId> = Vec::new();
                while planes.len() < 8
                    && let Some(hit) = tracer.nearest(&ray, f32::INFINITY)
                {
                    let interaction = tracer.interact(ray.direction, &hit, MediumStack::AIR);
                    let [branch] = interaction.branches() else { break };
                    let Event::Planar(plane) = branch.event else { break };
                    planes.push(plane);
                    if let Some(chain) = chains.chains().iter().position(|c| c.planes == planes) {
                        found += 1;
                        assert!(seen.contains(&(chain as u32)), "place {place}: {planes:?}");
                    }
                    let origin = ray.origin + ray.direction * hit.t;
                    ray = Ray { origin, direction: branch.direction, from: plane };
                }
            }
        }
        assert!(found > 10_000, "{found}");
        let share = named as f64 / f64::from(places) / chains.chains().len() as f64;
        assert!(share < 0.5, "{share} of {} chains", chains.chains().len());
    }
}
