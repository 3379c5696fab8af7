//! Where surfaces are near to each other: the mesh of the gathers is finer there, and what nobody can see is told.

use glam::Vec3;
use rayon::prelude::*;

use catoptric_scene::Side;
use catoptric_trace::sequence::{Key, Purpose};
use catoptric_trace::{Ray, Tracer};

use crate::JOB;
use crate::detail::{Detail, Details};
use crate::display::Displayed;
use crate::draft::{Draft, SoftEdge};
use crate::gather::{Surroundings, look_around};
use crate::lattice::Lattice;

/// How fine the mesh of the gathers is where surfaces are near to each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NearParams {
    /// Edges are split where they are longer than this multiple of the harmonic mean distance of what is seen from them.
    pub ratio: f32,
    /// Times.
    pub rounds: u32,
    /// Times that triangles are split which small things are near to.
    pub detail_rounds: u32,
    /// Triangles that this may add for each base triangle, about.
    pub detail_share: f32,
    /// … and at most, at all: the author's tessellation may be as fine as it likes.
    pub max_details: usize,
}

/// Rays by which a vertex looks around, and one of a fine mesh.
const AROUND: u32 = 32;
const AROUND_FINE: u32 = 8;
/// Edges below this multiple of the spacing belong to small things.
const FINE: f32 = 0.25;

/// Edges of open faces are split where they are longer than this multiple of that distance, …
const OPEN_RATIO: f32 = 0.3;
/// … and than this one of the spacing.
const OPEN_SHORTEST: f32 = 1.5;

/// What is seen within this multiple of the spacing is beside a vertex.
const BESIDE: f32 = 0.25;

/// What the base vertices see.
pub struct Near {
    around: Vec<Surroundings>,
    /// Per vertex: base triangles that it sees near by.
    beside: Vec<Vec<u32>>,
    /// Places that are seen from something small and near, as small as it is near.
    glimpses: Details,
}

impl NearParams {
    /// About how short edges get where things are near, metres.
    pub(crate) fn finest(&self, spacing: f32) -> f32 {
        if self.detail_rounds == 0 {
            f32::INFINITY
        } else {
            spacing * 0.5_f32.powi(self.detail_rounds as i32 + 1)
        }
    }
}

impl Near {
    /// Has every vertex of an unrefined draft, shown as `base`, look around.
    pub fn new(tracer: &Tracer, draft: &Draft, base: &Displayed, spacing: f32, seed: u32) -> Self {
        let mut shortest = vec![f32::INFINITY; draft.vertices.len()];
        let mut longest = vec![0.0_f32; draft.vertices.len()];
        for (a, b) in draft.edges() {
            let length = draft.length((a, b));
            for v in [a as usize, b as usize] {
                shortest[v] = shortest[v].min(length);
                longest[v] = longest[v].max(length);
            }
        }
        let found: Vec<(Surroundings, Vec<u32>, Vec<Detail>)> = (0..draft.vertices.len())
            .into_par_iter()
            .with_min_len(16)
            .with_max_len(JOB)
            .map(|vertex| {
                let rays = if longest[vertex] < FINE * spacing { AROUND_FINE } else { AROUND };
                let small = shortest[vertex] < FINE * spacing;
                let (mut beside, mut glimpses) = (Vec::new(), Vec::new());
                let around = surroundings(tracer, draft, vertex as u32, rays, seed, |_, hit, position| {
                    if hit.t > spacing {
                        return;
                    }
                    let side = if hit.back { Side::Back } else { Side::Front };
                    if let Some(located) = base.mesh.locate(hit.triangle, side, position) {
                        let root = base.roots[located.element as usize];
                        if small {
                            glimpses.push(Detail { root, position, size: hit.t });
                        }
                        if hit.t < BESIDE * spacing && !beside.contains(&root) {
                            beside.push(root);
                        }
                    }
                });
                (around, beside, glimpses)
            })
            .collect();
        let mut around = Vec::with_capacity(found.len());
        let mut beside = Vec::with_capacity(found.len());
        let mut glimpses = Vec::new();
        for (own, near, seen) in found {
            around.push(own);
            beside.push(near);
            glimpses.extend(seen);
        }
        glimpses.par_extend(
            draft
                .soft_edges
                .par_iter()
                .with_max_len(JOB)
                .flat_map_iter(|edge| soft(tracer, draft, base, edge)),
        );
        Self { around, beside, glimpses: Details::new(glimpses) }
    }

    /// Splits edges along which other surfaces are near (the irradiance from them bends on the scale of their distance), and
    /// then triangles that small things are near to, which no vertex of theirs may notice: a ball on a table.
    ///
    /// Returns the harmonic mean distance of what is seen from vertices, metres, NaN where none was asked for.
    pub(crate) fn refine(
        &self,
        tracer: &Tracer,
        draft: &mut Draft,
        params: &NearParams,
        lattice: &Lattice,
        seed: u32,
    ) -> Vec<f32> {
        let mut distances: Vec<f32> = self.around.iter().map(|a| a.distance).collect();
        let roots = draft.leaves.len();
        let spacing = lattice.spacing;
        // Faces with larger triangles first.
        let doublings = u32::from(lattice.most_doublings());
        for round in 0..doublings + params.rounds {
            let shortest = spacing * 2.0_f32.powi(doublings as i32 - round as i32 - 1);
            let is_open = round < doublings;
            let (ratio, shortest) = if is_open {
                (OPEN_RATIO, shortest.max(OPEN_SHORTEST * spacing))
            } else {
                (params.ratio, shortest)
            };
            let edges: Vec<(u32, u32)> = draft
                .edges()
                .into_iter()
                .filter(|&(a, b)| {
                    let face = draft.vertices[a as usize].face.min(draft.vertices[b as usize].face);
                    draft.length((a, b)) > shortest && (!is_open || lattice.is_open(face))
                })
                .collect();
            // Only the ends of edges that may be split are asked.
            let mut asked = vec![false; draft.vertices.len()];
            for &(a, b) in &edges {
                asked[a as usize] = true;
                asked[b as usize] = true;
            }
            distances.resize(draft.vertices.len(), f32::NAN);
            distances.par_iter_mut().enumerate().with_min_len(16).with_max_len(JOB).for_each(
                |(vertex, distance)| {
                    if asked[vertex] && distance.is_nan() {
                        *distance =
                            surroundings(tracer, draft, vertex as u32, AROUND, seed, |_, _, _| {}).distance;
                    }
                },
            );
            let marks: Vec<(u32, u32)> = edges
                .into_iter()
                .filter(|&(a, b)| {
                    draft.length((a, b)) > ratio * distances[a as usize].min(distances[b as usize])
                })
                .collect();
            if marks.is_empty() && !is_open {
                break;
            }
            draft.split(tracer, &marks);
        }
        let details = ((params.detail_share * roots as f32) as usize).min(params.max_details);
        let limit = draft.leaves.len() + details;
        for round in 0..params.detail_rounds {
            let shortest = spacing * 0.5_f32.powi(round as i32 + 1);
            let room = limit.saturating_sub(draft.leaves.len());
            let marks = self.glimpses.marks(draft, params.ratio, shortest, room);
            if marks.is_empty() {
                break;
            }
            draft.split(tracer, &marks);
        }
        distances.resize(draft.vertices.len(), f32::NAN);
        distances
    }

    /// Base triangles that a vertex sees near by, where it has looked.
    pub(crate) fn beside(&self, vertex: u32) -> &[u32] {
        self.beside.get(vertex as usize).map_or(&[], |roots| roots)
    }

    /// Which draft vertices nobody can see: all of their base, then those between two hidden ones.
    pub fn hidden_vertices(&self, draft: &Draft) -> Vec<bool> {
        let mut hidden: Vec<bool> = Vec::with_capacity(draft.vertices.len());
        for (index, vertex) in draft.vertices.iter().enumerate() {
            hidden.push(match vertex.parents {
                None => self.around.get(index).is_some_and(|a| a.hidden),
                Some([a, b]) => hidden[a as usize] && hidden[b as usize],
            });
        }
        hidden
    }
}

/// Points along a soft edge, at most.
const MOST_ALONG: f32 = 64.0;

/// Details beside the outline of what hangs before a face, on both sides, or stands on it, as small as it is high.
fn soft<'a>(
    tracer: &'a Tracer,
    draft: &'a Draft,
    base: &'a Displayed,
    edge: &'a SoftEdge,
) -> impl Iterator<Item = Detail> + 'a {
    let [a, b] = edge.ends;
    let parts = ((b - a).length() / edge.height.max(f32::MIN_POSITIVE)).ceil().clamp(1.0, MOST_ALONG) as u32;
    let face = &draft.faces[edge.face as usize];
    let normal = face.side.orient(face.frame.normal.as_vec3());
    let across = normal.cross(b - a).normalize_or_zero() * (0.5 * edge.height);
    let across = edge.away.map_or(across, |away| away * across.length());
    (0..=2 * parts + 1).filter_map(move |index| {
        let (part, way) = (index / 2, if index % 2 == 0 { across } else { -across });
        if index % 2 == 1 && edge.away.is_some() {
            return None;
        }
        let position = a.lerp(b, part as f32 / parts as f32) + way;
        let above = 0.5 * edge.height;
        let hit = tracer.nearest(&Ray::free(position + normal * above, -normal), 1.5 * above)?;
        let located = base.mesh.locate(hit.triangle, face.side, position)?;
        let root = base.roots[located.element as usize];
        Some(Detail { root, position, size: edge.height })
    })
}

/// What a vertex sees first.
fn surroundings(
    tracer: &Tracer,
    draft: &Draft,
    vertex: u32,
    rays: u32,
    seed: u32,
    visit: impl FnMut(u32, &catoptric_trace::Hit, Vec3),
) -> Surroundings {
    let key = Key::new(seed, Purpose::Hemisphere, u64::from(vertex) | 1 << 41);
    look_around(tracer, &draft.gatherer(tracer, vertex), 0..rays, key, visit)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base_mesh::coarse_patches;
    use crate::contact::Obstacles;
    use crate::detail::is_inside;
    use crate::face::faces;
    use catoptric_scene::{Material, MaterialId, Radiance, Rgb, Scene, SceneParts};

    /// A large floor with a ball above it, far from every vertex of the floor's base triangles.
    fn ball_on_a_floor(radius: f32) -> Scene {
        let mut parts = SceneParts::default();
        let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
        parts.add_quad("floor", white, Vec3::new(-2.0, 0.0, 2.0), Vec3::X * 4.0, Vec3::Z * -4.0);
        parts.add_sphere("ball", white, Vec3::new(0.21, 3.0 * radius, 0.13), radius, 12);
        Scene::new(parts).expect("a valid scene")
    }

    /// Largest edge of the floor's triangles that come as near to the ball's foot as its radius, metres.
    fn size_at_foot(radius: f32, detail_share: f32) -> f32 {
        let scene = ball_on_a_floor(radius);
        let tracer = Tracer::new(&scene);
        let (mut draft, _) = coarse_patches(&tracer, 60);
        let spacing = 0.7;
        let near = Near::new(&tracer, &draft, &draft.display(&tracer), spacing, 0);
        let params = NearParams { ratio: 1.5, rounds: 0, detail_rounds: 4, detail_share, max_details: 1000 };
        near.refine(&tracer, &mut draft, &params, &Lattice::even(spacing), 0);
        let foot = Vec3::new(0.21, 0.0, 0.13);
        draft
            .leaves
            .iter()
            .map(|leaf| leaf.vertices.map(|v| draft.vertices[v as usize].position))
            .filter(|corners| corners.iter().all(|c| c.y == 0.0) && is_inside(foot, *corners))
            .flat_map(|[a, b, c]| [(b - a).length(), (c - b).length(), (a - c).length()])
            .fold(0.0, f32::max)
    }

    /// A lamp of 12 cm, 2 cm below the ceiling, seen past: the dark behind it is a matter of centimetres. Its back is no surface of
    /// which vertices could look.
    #[test]
    fn the_ceiling_is_fine_behind_a_lamp_and_not_parted() {
        let mut parts = SceneParts::default();
        let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
        let lamp = parts.add_material(Material::emitter("lamp", Radiance(Rgb::ONE)));
        let corner = Vec3::new(-2.0, 0.0, -2.0);
        parts.add_quad("ceiling", white, corner, Vec3::X * 4.0, Vec3::Z * 4.0);
        parts.add_quad("lamp", lamp, Vec3::new(0.1, -0.02, 0.2), Vec3::X * 0.12, Vec3::Z * 0.12);
        let scene = Scene::new(parts).expect("a valid scene");
        let tracer = Tracer::new(&scene);
        let spacing = 0.2;
        let lattice = Lattice::even(spacing);
        let obstacles = Obstacles::new(&tracer);
        let mut draft = Draft::on(&tracer, &obstacles, faces(&tracer), &lattice, 0.01);
        let near = Near::new(&tracer, &draft, &draft.display(&tracer), spacing, 0);
        let params =
            NearParams { ratio: 1.2, rounds: 0, detail_rounds: 4, detail_share: 2.0, max_details: 5000 };
        near.refine(&tracer, &mut draft, &params, &Lattice::even(spacing), 0);
        let (low, high) = (Vec3::new(0.1, 0.0, 0.2), Vec3::new(0.22, 0.0, 0.32));
        let corners = |leaf: &crate::draft::Leaf| leaf.vertices.map(|v| draft.vertices[v as usize].position);
        // Inside and outside of its left and lower edges, half as far off as it hangs, and as far apart.
        for along in [0.02, 0.04, 0.08, 0.1] {
            for off in [-0.01, 0.01] {
                for place in [low + Vec3::new(off, 0.0, along), low + Vec3::new(along, 0.0, off)] {
                    let holding = draft.leaves.iter().map(corners).find(|&c| is_inside(place, c));
                    let [a, b, c] = holding.expect("the ceiling has no hole");
                    let longest = (b - a).length().max((c - b).length()).max((a - c).length());
                    assert!(longest < 1.2 * 0.02 + 1e-4, "{longest} at {place}");
                }
            }
        }
        // Each edge between two of its leaves is one edge: no vertex lies twice at a place.
        let mut places: Vec<[u32; 3]> =
            draft.vertices.iter().map(|v| v.position.to_array().map(|x| (x + 0.0).to_bits())).collect();
        places.sort_unstable();
        places.dedup();
        assert_eq!(places.len(), draft.vertices.len());
        assert!(draft.vertices.iter().any(|v| v.position.distance(high) < 1e-5), "a vertex at its corner");
    }

    /// A wall of 4 m with what `build` puts on it: the longest edge of what holds a place of the wall, in the mesh of the gathers.
    fn on_wall(build: impl FnOnce(&mut SceneParts, MaterialId)) -> impl Fn(Vec3) -> f32 {
        let mut parts = SceneParts::default();
        let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
        let corner = Vec3::new(-2.0, 0.0, 2.0);
        parts.add_quad("wall", white, corner, Vec3::X * 4.0, Vec3::Z * -4.0);
        build(&mut parts, white);
        let scene = Scene::new(parts).expect("a valid scene");
        let tracer = Tracer::new(&scene);
        let lattice = Lattice::even(SPACING);
        let params =
            NearParams { ratio: 1.2, rounds: 0, detail_rounds: 4, detail_share: 9.0, max_details: 5000 };
        let finest = params.finest(SPACING);
        let mut draft = Draft::on(&tracer, &Obstacles::new(&tracer), faces(&tracer), &lattice, finest);
        let near = Near::new(&tracer, &draft, &draft.display(&tracer), SPACING, 0);
        near.refine(&tracer, &mut draft, &params, &lattice, 0);
        let corners = |leaf: &crate::draft::Leaf| leaf.vertices.map(|v| draft.vertices[v as usize].position);
        let leaves: Vec<[Vec3; 3]> = draft.leaves.iter().map(corners).collect();
        move |place: Vec3| {
            let is_there = |c: &&[Vec3; 3]| c.iter().all(|p| p.y == 0.0) && is_inside(place, **c);
            let [a, b, c] = *leaves.iter().find(is_there).expect("the wall has no hole");
            (b - a).length().max((c - b).length()).max((a - c).length())
        }
    }

    /// Edges of the wall's own mesh, about.
    const SPACING: f32 = 0.4;
    /// What lies low on it.
    const HEIGHT: f32 = 0.04;

    /// A batten of 4 cm on a wall, as the frame of a mirror is: the dark at its foot is as narrow all along it, not just where its own
    /// vertices look; half-discs of dark would show where they do not. A mirror of 1.8 by 0.9 m that hangs as far before it leaves such a line, too.
    #[test]
    fn a_wall_is_as_fine_all_along_the_foot_of_what_is_low() {
        // Both long sides, and the top.
        let (along, up) = (Vec3::X * 1.8, Vec3::Y * HEIGHT);
        let batten = [Vec3::new(-0.9, 0.0, 0.1), Vec3::new(0.9, 0.0, 0.03)];
        let beside_batten = on_wall(|parts, white| {
            parts.add_quad("side", white, batten[0], along, up);
            parts.add_quad("other side", white, batten[1], -along, up);
            parts.add_quad("top", white, batten[0] + up, along, Vec3::Z * -0.07);
        });
        let mirror = [Vec3::new(-0.9, 0.0, 0.5), Vec3::new(0.9, 0.0, -0.4)];
        let beside_mirror = on_wall(|parts, white| {
            parts.add_quad("mirror", white, mirror[0] + up, along, Vec3::Z * -0.9);
        });
        let both: [(&dyn Fn(Vec3) -> f32, _); 2] = [(&beside_batten, batten), (&beside_mirror, mirror)];
        for (longest_at, [low, high]) in both {
            for step in 0..60 {
                let x = -0.88 + 1.76 * step as f32 / 59.0;
                for z in [low.z + 0.5 * HEIGHT, high.z - 0.5 * HEIGHT] {
                    let longest = longest_at(Vec3::new(x, 0.0, z));
                    // Triangles that hold a detail are halved until edges are 1.2 times its size. Details lie `HEIGHT` apart; between two of them
                    // there may be the half of one that is twice as large.
                    assert!(longest < 2.0 * 1.2 * HEIGHT + 1e-4, "{longest} at {x}, {z}");
                }
            }
            assert!(longest_at(Vec3::new(0.0, 0.0, 1.0)) > 0.5 * SPACING);
        }
        // Nobody sees what is behind the mirror.
        assert!(beside_mirror(Vec3::new(0.1, 0.0, 0.05)) > 0.5 * SPACING);
    }

    #[test]
    fn the_floor_is_fine_under_a_ball_that_its_corners_do_not_notice() {
        let (coarse, fine) = (size_at_foot(0.1, 0.0), size_at_foot(0.1, 2.0));
        // The ball is 0.2 m above its foot: edges of 1.5 times that are halved, and those of 0.7 m are longer.
        assert!(coarse > 0.5, "{coarse}");
        assert!(fine < 0.3, "{fine} of {coarse}");
    }
}
