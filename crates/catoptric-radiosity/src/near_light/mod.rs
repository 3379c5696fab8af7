//! Where the light of near surfaces bends between the vertices of the gathers, such as where a shadow meets the foot of what throws
//! it, or below a shelf: their mesh is finer there. Surfaces send what sources and the coarse solution bring them: the wall below a shelf that is
//! lit by other walls alone has an edge of shadow, too.
//!
//! The file `look` sends rays, `beside` knows what bright places send to what is near them, `spill` knows where light comes through gaps, `places` what small bright places, near or far, have in their way.
//!
//! Few rays tell, since the ends of an edge and its middle send the same: what they see in the distance, and the noise of it, is
//! the same, too.

mod beside;
mod look;
mod places;
mod spill;

use catoptric_light::Lights;
use catoptric_scene::Rgb;
use catoptric_trace::Tracer;
use catoptric_trace::walk::WalkParams;

use crate::display::Displayed;
use crate::draft::{Draft, edge};
use crate::near::Near;
use crate::patch::PatchMesh;
use crate::refine::most_promising;
use crate::sharing::Sharing;

use look::{Seen, Surplus};
use places::{Lit, Places};

/// How fine the mesh of the gathers is where the light of near surfaces bends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NearLightParams {
    /// Difference between the middle of an edge and the mean of its ends that is left alone, relative to the light there: of edges half
    /// as long as the spacing and longer ones. It shows by the area that it covers: of shorter ones more, by the root of their length.
    pub tolerance: f32,
    /// Light below this share of the mean counts as this much.
    pub floor: f32,
    /// Edges are looked at that are longer than this multiple of the harmonic mean distance of what is seen from them.
    pub ratio: f32,
    /// … and than this multiple of the spacing, …
    pub shortest: f32,
    /// … or than this one, if an end shares what it gathers with vertices around it.
    pub shortest_shared: f32,
    /// Times that they are halved.
    pub rounds: u32,
    /// Triangles that this may add for each base triangle, about.
    pub share: f32,
    /// … and at most, at all.
    pub max_triangles: usize,
}

/// Rays by which a vertex looks first, to see whether it is worth it.
const FEW_RAYS: u32 = 8;
/// … and then, twice as many each time, as long as they do not tell: the last ones are what a long edge is worth, shorter ones are worth as
/// many less as they cover less.
const RAYS: [u32; 4] = [32, 64, 128, 256];
/// Multiple of the spacing from which edges are long.
const WIDE: f32 = 0.5;
/// Difference of the ends of an edge, relative to the light there, from which on the edge may be shorter for what is near: by as much as it is more.
const STARK: f32 = 0.3;
/// What is known of the vertices of the gathers.
struct Known {
    /// Light of sources.
    light: Vec<f32>,
    /// All light.
    all: Vec<f32>,
    /// What they see, where they have looked.
    seen: Vec<Option<Seen>>,
    /// What bright places send there, likewise.
    lit: Vec<Option<Lit>>,
    /// … by the exact form of those beside them, if nothing is in the way, …
    free: Vec<Option<f32>>,
    /// … and as it is.
    beside: Vec<Option<f32>>,
}

impl Known {
    fn seen(&self, vertex: u32) -> Option<&Seen> {
        self.seen.get(vertex as usize)?.as_ref()
    }

    fn lit(&self, vertex: u32) -> Option<&Lit> {
        self.lit.get(vertex as usize)?.as_ref()
    }

    /// Gives new vertices of `draft` the mean of the edge that each halves.
    fn fill(&mut self, draft: &Draft) {
        draft.fill(&mut self.light, |a, b| 0.5 * (a + b));
        draft.fill(&mut self.all, |a, b| 0.5 * (a + b));
    }
}

/// The light of surfaces, where a mesh knows it.
pub(crate) struct NearLight<'a> {
    pub(crate) tracer: &'a Tracer<'a>,
    pub(crate) lights: &'a Lights<'a>,
    pub(crate) displayed: &'a Displayed,
    pub(crate) patches: &'a PatchMesh,
    /// Irradiance per draft vertex, by sources and the coarse solution.
    pub(crate) irradiance: &'a [Rgb],
    /// The mean of its largest channel.
    pub(crate) mean: f32,
    /// Irradiance by sources alone.
    pub(crate) sources: &'a [Rgb],
    /// Vertices that share have no gathers of their own.
    pub(crate) sharing: &'a Sharing,
    pub(crate) spacing: f32,
    pub(crate) walk: &'a WalkParams,
    pub(crate) seed: u32,
}

impl NearLight<'_> {
    /// Splits edges of `draft`, whose vertices are the first of those that the irradiance is known of; whether there were any.
    /// `distances`: harmonic mean distance of what is seen from some of them, metres, NaN for others.
    pub(crate) fn refine(
        &self,
        draft: &mut Draft,
        near: &Near,
        distances: &[f32],
        params: &NearLightParams,
    ) -> bool {
        let mut is_split = false;
        if params.rounds == 0 {
            return is_split;
        }
        let mut hidden = near.hidden_vertices(draft);
        let largest = |light: &[Rgb]| light[..draft.vertices.len()].iter().map(|e| e.max_element()).collect();
        let mut known = Known {
            light: largest(self.sources),
            all: largest(self.irradiance),
            seen: Vec::new(),
            lit: Vec::new(),
            free: Vec::new(),
            beside: Vec::new(),
        };
        let places = Places::new(self, draft.most_weight);
        let more = ((params.share * draft.roots as f32) as usize).min(params.max_triangles);
        let limit = draft.leaves.len() + more;
        let mut spills = self.spills(near, draft, params);
        for (vertex, &gap) in draft.vertices.iter_mut().zip(&spills) {
            if gap < f32::INFINITY {
                vertex.gather_there();
            }
        }
        let looked_at = draft.vertices.len();
        let mut candidates = draft.edges();
        let mut active = draft.active_vertices();
        for _ in 0..params.rounds {
            // Each edge makes two triangles, and its neighbours are halved.
            let room = limit.saturating_sub(draft.leaves.len());
            if room < 3 {
                break;
            }
            let is_far = |v: u32, length: f32| {
                distances.get(v as usize).is_some_and(|&distance| length <= params.ratio * distance)
            };
            candidates.retain(|&(a, b)| {
                let length = draft.length((a, b));
                let spill = spills[a as usize].min(spills[b as usize]);
                let shares = |v: u32| (v as usize) < looked_at && self.sharing.shares(v);
                let shortest = if shares(a) || shares(b) { params.shortest_shared } else { params.shortest };
                length > spill.min(shortest * self.spacing) && !hidden[a as usize] && !hidden[b as usize]
            });
            let is_near = |&(a, b): &(u32, u32)| {
                let length = draft.length((a, b));
                spills[a as usize].min(spills[b as usize]) < f32::INFINITY
                    || !(is_far(a, length) && is_far(b, length))
            };
            let near = candidates.iter().copied().filter(is_near).collect();
            let mut marks = self.bent(draft, near, room, &spills, &mut known, params);
            if !places.is_empty() {
                let left_alone = |draft: &Draft, ends: (u32, u32), there: f32| {
                    self.tolerance(draft, ends, params) * (there + params.floor * self.mean)
                };
                let wide = WIDE * self.spacing;
                marks.extend(places.bent_beside(self.tracer, draft, &candidates, &mut known, left_alone));
                marks.extend(places.bent(self.tracer, draft, candidates, &mut known, wide, left_alone));
                marks.sort_by(|x, y| x.1.cmp(&y.1).then(y.0.total_cmp(&x.0)));
                marks.dedup_by_key(|mark| mark.1);
            }
            // What shows most first.
            for (excess, ends) in &mut marks {
                *excess *= draft.length(*ends).powi(2);
            }
            marks.sort_by(|x, y| y.0.total_cmp(&x.0).then(x.1.cmp(&y.1)));
            marks.truncate(room / 3);
            if marks.is_empty() {
                break;
            }
            is_split = true;
            let marks: Vec<(u32, u32)> = marks.into_iter().map(|(_, edge)| edge).collect();
            draft.split(self.tracer, &marks);
            known.fill(draft);
            spill::inherit(draft, &mut spills);
            draft.fill(&mut hidden, |a, b| a && b);
            // New edges are looked at next, and the halves of those that are split beside larger triangles.
            candidates = draft.edges_where(|v| !active.get(v as usize).is_some_and(|&used| used));
            let halves = |&(a, b): &(u32, u32)| {
                let middle = draft.known_midpoint(a, b);
                middle.into_iter().flat_map(move |m| [edge(a, m), edge(m, b)])
            };
            candidates.extend(marks.iter().flat_map(halves));
            candidates.sort_unstable();
            candidates.dedup();
            candidates.retain(|&(a, b)| draft.marked_midpoint(a, b).is_none());
            active = draft.active_vertices();
        }
        is_split
    }

    /// Difference of an edge's middle that is left alone, relative to the light there.
    fn tolerance(&self, draft: &Draft, ends: (u32, u32), params: &NearLightParams) -> f32 {
        params.tolerance * (WIDE * self.spacing / draft.length(ends)).max(1.0).sqrt()
    }

    /// The edges in whose middle light is not what their ends foretell, with the difference as a multiple of what is left alone. Where more
    /// edges may be such than there is `room` for triangles, those are looked at that promise most by their ends.
    fn bent(
        &self,
        draft: &mut Draft,
        candidates: Vec<(u32, u32)>,
        room: usize,
        spills: &[f32],
        known: &mut Known,
        params: &NearLightParams,
    ) -> Vec<(f32, (u32, u32))> {
        let floor = params.floor * self.mean;
        // Where light spills through a gap it is known to bend: few rays need not tell.
        let is_spill = |a: u32, b: u32| spills[a as usize].min(spills[b as usize]) < f32::INFINITY;
        let ends = |candidates: &[(u32, u32)]| candidates.iter().flat_map(|&(a, b)| [a, b]).collect();
        self.look(draft, ends(&candidates), FEW_RAYS, &mut known.seen);
        let promise = |&(a, b): &(u32, u32)| {
            let [one, other] = [known.seen(a)?, known.seen(b)?];
            if is_spill(a, b) {
                return Some(f32::INFINITY);
            }
            // Where the ends agree, so does the middle, but for what is smaller than the edge and before neither.
            let shown = 0.5
                * (known.light[a as usize] + known.light[b as usize] + one.total() + other.total())
                + floor;
            let difference = one.difference(other) / shown;
            let ratio = params.ratio * (STARK / difference).min(1.0);
            let (length, tolerance) = (draft.length((a, b)), self.tolerance(draft, (a, b), params));
            let may_bend = difference > tolerance && length > ratio * one.distance.min(other.distance);
            may_bend.then_some(difference / tolerance * length * length)
        };
        let promised: Vec<(f32, (u32, u32))> =
            candidates.iter().filter_map(|edge| Some((promise(edge)?, *edge))).collect();
        let candidates = most_promising(promised, room);
        draft.make_midpoints(self.tracer, &candidates);
        let middles: Vec<u32> = candidates.iter().map(|&(a, b)| draft.midpoint(self.tracer, a, b)).collect();
        known.fill(draft);
        let mut open: Vec<((u32, u32), u32)> = candidates.into_iter().zip(middles).collect();
        let (mut bent, mut doubtful) = (Vec::new(), Vec::new());
        for rays in RAYS {
            let asked = open.iter().flat_map(|&((a, b), middle)| [a, b, middle]).collect();
            self.look(draft, asked, rays, &mut known.seen);
            open.retain(|&((a, b), middle)| {
                let [Some(one), Some(other), Some(own)] = [a, b, middle].map(|v| known.seen(v)) else {
                    return false;
                };
                let bend = Surplus::of_middle(&own.irradiance, [&one.irradiance, &other.irradiance], rays);
                let foretold = 0.5 * (one.total() + other.total());
                let shown = known.light[middle as usize] + 0.5 * (own.total() + foretold) + floor;
                let left_alone = self.tolerance(draft, (a, b), params) * shown;
                let is_bent = bend.sum.abs() > left_alone;
                if is_bent && (is_spill(a, b) || bend.is_significant()) {
                    bent.push((bend.sum.abs() / left_alone, (a, b)));
                    return false;
                }
                // By the area that it covers it is worth more rays.
                let wide = draft.length((a, b)) / (WIDE * self.spacing);
                let is_worth = (2 * rays) as f32 <= RAYS[RAYS.len() - 1] as f32 * wide * wide;
                if is_bent && !is_worth {
                    doubtful.push((bend.sum.abs() / left_alone, (a, b)));
                }
                !is_spill(a, b) && is_worth && (is_bent || bend.may_be(left_alone))
            });
        }
        // Beside what is bent for certain they are believed: by few rays alone some would be left, and the foot of a wall has teeth.
        let mut is_beside = vec![false; draft.vertices.len()];
        for &(_, (a, b)) in &bent {
            is_beside[a as usize] = true;
            is_beside[b as usize] = true;
        }
        bent.extend(
            doubtful.into_iter().filter(|&(_, (a, b))| is_beside[a as usize] || is_beside[b as usize]),
        );
        bent
    }

    /// Per base triangle: the most that its places send, the largest channel, times π.
    fn sent(&self) -> Vec<f32> {
        let mut most = vec![0.0_f32; self.patches.of_root.len()];
        for (index, element) in (0_u32..).zip(&self.displayed.mesh.elements) {
            let reflectance = self.reflectance(index);
            for &v in &element.vertices {
                let most = &mut most[self.displayed.roots[index as usize] as usize];
                *most = most.max((self.of_shown(v) * reflectance).max_element());
            }
        }
        most
    }

    /// Reflectance of an element of the mesh that knows the light.
    fn reflectance(&self, element: u32) -> Rgb {
        let root = self.displayed.roots[element as usize] as usize;
        self.patches.reflectances[self.patches.of_root[root].0 as usize]
    }

    /// Irradiance at a vertex of that mesh.
    fn of_shown(&self, vertex: u32) -> Rgb {
        self.irradiance[self.displayed.origin[vertex as usize] as usize]
    }
}

#[cfg(test)]
mod tests {
    use catoptric_light::LightParams;
    use catoptric_scene::{Material, MaterialId, Scene, SceneParts};

    use glam::Vec3;

    use super::*;
    use crate::base_mesh::coarse_patches;
    use crate::detail::is_inside;
    use crate::draft::DraftVertex;
    use crate::lattice::Lattice;
    use crate::near::NearParams;
    use crate::sharing::Covers;

    fn is_on_floor(vertex: &DraftVertex) -> bool {
        vertex.position.y == 0.0 && vertex.normal == Vec3::Y
    }

    fn share(is_lit: bool) -> f32 {
        f32::from(u8::from(is_lit))
    }

    /// The mesh of the gathers on a floor and a wall, with what else is built, where places hold so much light.
    fn refined(build: impl FnOnce(&mut SceneParts, MaterialId), lit: impl Fn(&DraftVertex) -> f32) -> Draft {
        let mut parts = SceneParts::default();
        let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
        parts.add_quad("floor", white, Vec3::new(-2.0, 0.0, 2.0), Vec3::X * 4.0, Vec3::Z * -4.0);
        parts.add_quad("wall", white, Vec3::new(-2.0, 0.0, -2.0), Vec3::X * 4.0, Vec3::Y * 2.0);
        build(&mut parts, white);
        let scene = Scene::new(parts).expect("a valid scene");
        let tracer = Tracer::new(&scene);
        let (mut draft, patches) = coarse_patches(&tracer, 150);
        let spacing = 0.55;
        let near = Near::new(&tracer, &draft, &draft.display(&tracer), spacing, 0);
        let none = NearParams { ratio: 1.0, rounds: 0, detail_rounds: 0, detail_share: 0.0, max_details: 0 };
        let distances = near.refine(&tracer, &mut draft, &none, &Lattice::even(spacing), 0);
        let mut finer = draft.clone();
        for _ in 0..4 {
            let edges = finer.edges();
            finer.split(&tracer, &edges);
        }
        let displayed = finer.display(&tracer);
        let irradiance: Vec<Rgb> = finer.vertices.iter().map(|v| Rgb::splat(lit(v))).collect();
        let light = NearLight {
            tracer: &tracer,
            lights: &Lights::new(&tracer, LightParams::default()),
            displayed: &displayed,
            patches: &patches,
            irradiance: &irradiance,
            sources: &irradiance,
            mean: 0.3,
            sharing: &Sharing::new(&tracer, &finer, spacing, 0.1 * spacing, Covers::Part, 1000, &[]),
            spacing,
            walk: &WalkParams::default(),
            seed: 0,
        };
        let params = NearLightParams {
            tolerance: 0.05,
            floor: 0.1,
            ratio: 0.8,
            shortest: 0.1,
            shortest_shared: 0.25,
            rounds: 4,
            share: 10.0,
            max_triangles: 3000,
        };
        light.refine(&mut draft, &near, &distances, &params);
        draft
    }

    /// Shortest edge on the wall within 0.1 m of the floor and 0.2 m of `x`, and the number of vertices there, where the floor holds light up to
    /// the shadow at `shadow`.
    fn edges_at_foot(x: f32, shadow: f32) -> (f32, usize) {
        let draft = refined(|_, _| {}, |v| share(is_on_floor(v) && v.position.x < shadow));
        let at_foot = |v: u32| {
            let p = draft.vertices[v as usize].position;
            p.z == -2.0 && p.y < 0.1 && (p.x - x).abs() < 0.2
        };
        let mut shortest = f32::INFINITY;
        for leaf in &draft.leaves {
            for &[a, b, c] in draft.closed(leaf).triangles() {
                for (p, q) in [(a, b), (b, c), (c, a)] {
                    if at_foot(p) && at_foot(q) {
                        shortest = shortest.min(draft.length((p, q)));
                    }
                }
            }
        }
        let used = draft.active_vertices();
        (shortest, (0..draft.vertices.len() as u32).filter(|&v| used[v as usize] && at_foot(v)).count())
    }

    /// Longest edge of the wall's triangles just beside a bar that stands 2 cm before it, and how far off its vertices there gather, metres.
    /// The back of the bar holds light, or nothing does.
    fn edges_beside_bar(lit: bool) -> (f32, f32) {
        let (low, high) = (Vec3::new(0.4, 0.2, -1.98), Vec3::new(0.5, 1.8, -1.94));
        let draft = refined(
            |parts, white| parts.add_box("bar", white, low, high, false),
            |v| {
                share(
                    lit && v.position.z == low.z
                        && v.normal == Vec3::NEG_Z
                        && v.position.x >= low.x
                        && v.position.x <= high.x,
                )
            },
        );
        let position = |v: u32| draft.vertices[v as usize].position;
        let (mut longest, mut off) = (0.0_f32, 0.0_f32);
        for leaf in draft.leaves.iter().filter(|leaf| leaf.vertices.iter().all(|&v| position(v).z == -2.0)) {
            for &[a, b, c] in draft.closed(leaf).triangles() {
                let is_beside = (6..15).any(|y| {
                    is_inside(Vec3::new(high.x + 0.01, 0.1 * y as f32, -2.0), [a, b, c].map(position))
                });
                if is_beside {
                    for (p, q) in [(a, b), (b, c), (c, a)] {
                        longest = longest.max(draft.length((p, q)));
                        let vertex = &draft.vertices[p as usize];
                        off = off.max(vertex.outlook.distance(vertex.position));
                    }
                }
            }
        }
        (longest, off)
    }

    #[test]
    fn light_that_comes_through_a_gap_is_gathered_there_on_a_mesh_as_fine_as_the_gap() {
        let (dark, far) = edges_beside_bar(false);
        let (bright, near) = edges_beside_bar(true);
        // Twice the gap of 2 cm off, or 0.15 of the way into a triangle of base edges of about half a metre; here, 0.01 of that way.
        assert!(far > 0.02 && near < 0.005, "{far} and {near} m");
        // Four rounds make a sixteenth of an edge of 0.55 m; and triangles of one round less may lie beside.
        assert!(dark > 0.2 && bright < 2.0 * 0.55 / 16.0, "{dark} and {bright} m");
    }

    #[test]
    fn edges_are_short_where_a_shadow_meets_a_wall_and_nowhere_else() {
        let x = 0.37;
        let (shadow, with) = edges_at_foot(x, x);
        let (lit, without) = edges_at_foot(x, f32::INFINITY);
        // Base edges are at least half as long as the spacing: none joins two places within 0.2 m.
        assert!(shadow < 0.15, "{shadow}");
        assert!(lit > 0.25, "{lit}");
        assert!(with > without, "{with} vertices, {without} where nothing changes");
        let (elsewhere, _) = edges_at_foot(-0.9, x);
        assert!(elsewhere > 0.25, "{elsewhere}");
    }

    /// Longest edge of the triangles of `draft` that hold such points.
    fn longest_at(draft: &Draft, points: impl Iterator<Item = Vec3>) -> f32 {
        let position = |v: u32| draft.vertices[v as usize].position;
        let points: Vec<Vec3> = points.collect();
        let mut longest = 0.0_f32;
        for leaf in &draft.leaves {
            for &corners in draft.closed(leaf).triangles() {
                let [a, b, c] = corners.map(position);
                let normal = (b - a).cross(c - a).normalize_or_zero();
                let holds = |p: &Vec3| (*p - a).dot(normal).abs() < 1e-4 && is_inside(*p, [a, b, c]);
                if points.iter().any(holds) {
                    longest =
                        [(a, b), (b, c), (c, a)].iter().fold(longest, |l, (p, q)| l.max(p.distance(*q)));
                }
            }
        }
        longest
    }

    #[test]
    fn the_foot_of_a_wall_before_a_lit_strip_is_as_fine_all_along() {
        let strip = -1.92..-1.5;
        let draft = refined(|_, _| {}, |v| share(is_on_floor(v) && strip.contains(&v.position.z)));
        let edges = (-29..30)
            .map(|x| longest_at(&draft, std::iter::once(Vec3::new(0.05 * x as f32 + 0.003, 0.02, -2.0))));
        let (shortest, longest) = edges.fold((f32::INFINITY, 0.0_f32), |(s, l), e| (s.min(e), l.max(e)));
        // By their own few rays three of four are not told to be bent once more: 0.125 m instead of 0.088 m, and so the light there has teeth.
        assert!(longest < 1.01 * shortest && longest < 0.55 / 4.0, "{shortest} to {longest} m");
    }

    #[test]
    fn a_screen_before_a_wall_hides_a_floor_that_is_lit_all_over() {
        let vertices = |lit: bool| {
            let (low, high) = (Vec3::new(-1.5, 0.0, -1.9), Vec3::new(1.5, 0.5, -1.89));
            let draft = refined(
                |parts, white| parts.add_box("screen", white, low, high, false),
                |v| share(lit && is_on_floor(v)),
            );
            let is_behind = |p: Vec3| p.z == -2.0 && p.x.abs() < 1.2 && (0.4..0.9).contains(&p.y);
            let used = draft.active_vertices();
            draft.vertices.iter().zip(used).filter(|(v, used)| *used && is_behind(v.position)).count()
        };
        // The floor is hidden up to 0.5 m, and most of it is seen from 0.7 m on.
        let (dark, lit) = (vertices(false), vertices(true));
        assert!(lit > 2 * dark, "{lit} vertices, {dark} without light");
    }

    /// Longest edges of triangles on the floor where the border of the shadow is that a screen throws before a small bright place in the ceiling, and
    /// off it; the place is dark, or sends such a share of the light of all places. The rest is sent, unseen from the floor, by a shelf below the ceiling.
    fn edges_in_shadow_of_screen(share_of_place: f32) -> [f32; 2] {
        let draft = refined(
            |parts, white| {
                parts.add_quad("ceiling", white, Vec3::new(-2.0, 2.0, -2.0), Vec3::X * 4.0, Vec3::Z * 4.0);
                parts.add_box("screen", white, Vec3::new(0.0, 1.0, -1.0), Vec3::new(1.0, 1.01, 1.0), false);
                parts.add_box("shelf", white, Vec3::new(-1.9, 1.8, 1.6), Vec3::new(-1.6, 1.81, 1.9), false);
            },
            |v| {
                let p = v.position;
                let is_place = p.y == 2.0 && p.x.abs() < 0.15 && p.z.abs() < 0.15;
                let is_shelf = p.y == 1.81 && v.normal == Vec3::Y;
                100.0 * (share_of_place * share(is_place) + (1.0 - share_of_place) * share(is_shelf))
            },
        );
        // Half of the place is hidden at x = 0, all and nothing of it 0.15 m beside: base edges are twice as long.
        [(0.01, 5), (-1.4, 9)]
            .map(|(x, half)| longest_at(&draft, (-half..half + 1).map(|z| Vec3::new(x, 0.0, 0.1 * z as f32))))
    }

    #[test]
    fn what_stands_before_a_small_bright_place_has_a_shadow_far_from_both() {
        let [dark, dark_elsewhere] = edges_in_shadow_of_screen(0.0);
        // Of 32 points two stand for a place that sends a twentieth: more are asked where these do not agree.
        for share in [1.0, 0.05] {
            let [lit, lit_elsewhere] = edges_in_shadow_of_screen(share);
            // One halving of a right-angled triangle of the lattice, at its longest edge, leaves √½ = 0.71 of that.
            assert!(dark > 0.4 && lit < 0.7 * dark, "{share}: {lit} m, {dark} m without light");
            assert_eq!(dark_elsewhere, lit_elsewhere, "{share}");
        }
    }

    /// Longest edge of the wall's triangles around a patch of 0.12 m on the floor that ends at the wall, and far from it; the patch is dark, or sends a
    /// hundredth of what bright places do. The rest is sent, unseen, by a shelf below the ceiling.
    fn edges_beside_patch(is_lit: bool) -> [f32; 2] {
        let draft = refined(
            |parts, white| {
                parts.add_quad("ceiling", white, Vec3::new(-2.0, 2.0, -2.0), Vec3::X * 4.0, Vec3::Z * 4.0);
                parts.add_box("shelf", white, Vec3::new(-1.9, 1.8, 1.6), Vec3::new(-1.6, 1.81, 1.9), false);
            },
            |v| {
                let p = v.position;
                let is_patch = is_on_floor(v) && (p.x - 0.37).abs() < 0.06 && p.z < -1.88;
                let is_shelf = p.y == 1.81 && v.normal == Vec3::Y;
                100.0 * (share(is_lit && is_patch) + 10.0 * share(is_shelf))
            },
        );
        [0.37, -1.5].map(|x| {
            let along = (-4..5).map(|step| 0.02 * step as f32);
            longest_at(&draft, along.flat_map(|off| [0.01, 0.05].map(|y| Vec3::new(x + off, y, -2.0))))
        })
    }

    #[test]
    fn a_wall_is_fine_beside_a_small_patch_of_light_on_the_floor() {
        let [[dark, _], [lit, elsewhere]] = [false, true].map(edges_beside_patch);
        // None of 32 points need lie on the patch. Edges are as short as it is, and far off as they are without it.
        assert!(
            dark > 0.4 && lit < 0.12 && elsewhere > 0.4,
            "{lit} m, {dark} m without light, {elsewhere} m"
        );
    }
}
