//! Refinement of the display mesh: edges are split where the middle is not what its ends foretell.

use catoptric_scene::{Cancelled, Progress, Rgb};
use catoptric_trace::Tracer;
use rayon::prelude::*;

use crate::JOB;
use crate::draft::Draft;
use crate::field::{Field, Values, mean};

/// When an edge is fine enough.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RefineParams {
    /// Difference between the middle and the mean of the ends, relative to the light there, that is left alone.
    pub tolerance: f32,
    /// Light below this share of the mean counts as this much: the eye does not see errors in the dark.
    pub floor: f32,
    /// Rounds: each halves edges.
    pub rounds: u32,
    /// First rounds in which triangles are also tested in their middle, where small shadows hide.
    pub inside_rounds: u32,
    /// Triangles with shorter edges are not tested inside, metres.
    pub inside_edge: f32,
    /// Edges whose relative difference times length is below this are left alone, metres: sharp shadows are followed
    /// into small triangles, soft ones and the noise of few shadow rays are not.
    pub blur: f32,
    /// Vertices at most.
    pub max_vertices: usize,
    /// Edges shorter than this are left alone, metres.
    pub min_edge: f32,
    /// Edges of the author's mesh shorter than this are only looked at where their ends differ by what would not be left
    /// alone in their middle, metres.
    pub short_edge: f32,
}

/// Splits edges until the field is as good as `params` asks for.
pub fn refine(
    tracer: &Tracer,
    draft: &mut Draft,
    field: &dyn Field,
    values: &mut Values,
    params: &RefineParams,
    progress: &dyn Progress,
) -> Result<(), Cancelled> {
    values.extend(draft, field, params, progress)?;
    if mean(draft, &values.values) <= 0.0 {
        return Ok(());
    }
    values.resolve(draft, field, params, progress)?;
    if params.inside_rounds > 0 {
        let marks = values.look_into_small(draft, field, params, progress)?;
        draft.split(tracer, &marks);
        values.extend(draft, field, params, progress)?;
    }
    let used = |draft: &Draft| draft.active_vertices().iter().filter(|&&used| used).count();
    let before = used(draft);
    halve(tracer, draft, field, values, params, progress)?;
    // Where there is little to follow, what is less visible is followed, too.
    let taken = used(draft).saturating_sub(before);
    if taken as f32 > SPARED * params.max_vertices.saturating_sub(before) as f32 {
        return Ok(());
    }
    let finer = RefineParams { blur: FINER * params.blur, inside_rounds: 0, ..*params };
    halve(tracer, draft, field, values, &finer, progress)
}

/// Share of the budget up to which the rest is spent on finer edges, …
const SPARED: f32 = 0.75;
/// … and how much finer they are.
const FINER: f32 = 2.0 / 3.0;

/// Halves edges, round by round.
fn halve(
    tracer: &Tracer,
    draft: &mut Draft,
    field: &dyn Field,
    values: &mut Values,
    params: &RefineParams,
    progress: &dyn Progress,
) -> Result<(), Cancelled> {
    let mut candidates = draft.edges();
    let mut active = draft.active_vertices();
    candidates.retain(|&edge| !values.is_fine(edge, draft.length(edge)));
    for round in 0..params.rounds {
        // What is the scale of this light? The area-weighted mean of the vertices so far.
        let floor = params.floor * mean(draft, &values.values);
        if floor <= 0.0 {
            return Ok(());
        }
        values.floor = floor;
        candidates.retain(|&(a, b)| {
            let length = draft.length((a, b));
            let differs = || shows(draft, &values.values, (a, b), floor, params);
            length > params.min_edge && (round > 0 || length > params.short_edge || differs())
        });
        let room = params.max_vertices.saturating_sub(active.iter().filter(|&&used| used).count());
        let promise = |&edge: &(u32, u32)| (promise(draft, &values.values, edge, floor), edge);
        candidates = most_promising(candidates.par_iter().with_min_len(1024).map(promise).collect(), room);
        // Both ends dark and the whole face dark: still look, a light patch may lie between.
        draft.make_midpoints(tracer, &candidates);
        values.extend(draft, field, params, progress)?;
        let mut marks: Vec<(f32, (u32, u32))> = candidates
            .par_iter()
            .with_min_len(256)
            .filter_map(|&(a, b)| {
                let middle = values.values[draft.known_midpoint(a, b)? as usize];
                let [p, q] = [a, b].map(|v| values.values[v as usize]);
                let error = (middle - (p + q) * 0.5).abs();
                // Beside an edge a dark middle must count as much as a lit one, or the middles of the edges that are left whole, which
                // are samples of the fit, are too bright.
                let light = if field.has_edges() {
                    (middle.min(p).min(q) + middle.max(p).max(q)) * 0.5
                } else {
                    (middle + p + q) / 3.0
                };
                let light = light + Rgb::splat(floor);
                let relative = (error / light).max_element();
                let [x, y] = [a, b].map(|v| draft.vertices[v as usize].position);
                let cost = cost(relative, (y - x).length());
                (relative > params.tolerance && cost > params.blur * params.blur).then_some((cost, (a, b)))
            })
            .collect();
        if round < params.inside_rounds {
            marks.extend(test_inside(draft, field, values, floor, params, round, room));
        }
        // The worst first, as far as the budget goes: each split edge makes about two vertices, and half of what is
        // left is kept for later rounds, where shadows get their edges.
        marks.par_sort_unstable_by(|x, y| x.1.cmp(&y.1).then(y.0.total_cmp(&x.0)));
        marks.dedup_by_key(|m| m.1);
        marks.par_sort_unstable_by(|x, y| y.0.total_cmp(&x.0).then(x.1.cmp(&y.1)));
        marks.truncate(room / 4);
        if marks.is_empty() {
            return Ok(());
        }
        let marks: Vec<(u32, u32)> = marks.into_iter().map(|m| m.1).collect();
        draft.split(tracer, &marks);
        values.extend(draft, field, params, progress)?;
        // Only new edges are looked at in the next round: those with an end that was not there.
        candidates = draft.edges_where(|v| !active.get(v as usize).is_some_and(|&used| used));
        active = draft.active_vertices();
    }
    Ok(())
}

/// Relative difference in the middle of an edge that its ends do not tell of. (Among more edges than can be looked at, one whose ends differ by
/// a tenth comes before one whose ends agree, if it is at least two thirds as long.)
const HIDDEN: f32 = 0.1;

/// Keeps so many in their order, those that promise most: no more looks than there is room for vertices, of which one in four is split, and
/// that finds nearly all that is worth it. (A model of 99 thousand triangles: 79 thousand looks instead of 252 thousand find 53 of 58 thousand
/// edges to split, of which there is room for 20; the least of these costs 4 % less.)
pub(crate) fn most_promising<T: Copy + Ord + Send>(mut ranked: Vec<(f32, T)>, count: usize) -> Vec<T> {
    if ranked.len() > count {
        ranked.par_sort_unstable_by(|x, y| y.0.total_cmp(&x.0).then(x.1.cmp(&y.1)));
        ranked.truncate(count);
        ranked.par_sort_unstable_by(|x, y| x.1.cmp(&y.1));
    }
    ranked.into_iter().map(|(_, one)| one).collect()
}

/// Whether the ends of an edge differ by what would not be left alone in its middle.
pub(crate) fn shows(
    draft: &Draft,
    values: &[Rgb],
    edge: (u32, u32),
    floor: f32,
    params: &RefineParams,
) -> bool {
    cost(half_difference(values, edge, floor), draft.length(edge)) > params.blur * params.blur
}

/// What an edge may cost by what is known of it: its ends differ, or something is between them all the same.
fn promise(draft: &Draft, values: &[Rgb], edge: (u32, u32), floor: f32) -> f32 {
    cost(half_difference(values, edge, floor) + HIDDEN, draft.length(edge))
}

/// Half of what the ends of an edge differ by, relative to the light there.
fn half_difference(values: &[Rgb], (a, b): (u32, u32), floor: f32) -> f32 {
    let [p, q] = [a, b].map(|v| values[v as usize]);
    let light = (p + q) * 0.5 + Rgb::splat(floor.max(f32::MIN_POSITIVE));
    ((q - p).abs() * 0.5 / light).max_element()
}

/// What a triangle costs whose corners and middle differ by what is not left alone.
pub(crate) fn misses(
    [corners, middle]: [Rgb; 2],
    longest: f32,
    floor: f32,
    params: &RefineParams,
) -> Option<f32> {
    let light = (corners + middle) * 0.5 + Rgb::splat(floor.max(f32::MIN_POSITIVE));
    let relative = ((middle - corners).abs() / light).max_element();
    // What a linear interpolant misses there is most of what it misses at an edge's middle.
    let cost = cost(relative, longest);
    (relative > 2.0 * params.tolerance && cost > 4.0 * params.blur * params.blur).then_some(cost)
}

/// What an edge adds to the squared error of a picture: relative error squared times area.
fn cost(relative: f32, length: f32) -> f32 {
    relative.min(2.0).powi(2) * length * length
}

/// Edges of the triangles that hold something in their middle that their corners do not foretell; of so many triangles at most, those
/// with the longest edges.
fn test_inside(
    draft: &Draft,
    field: &dyn Field,
    values: &Values,
    floor: f32,
    params: &RefineParams,
    round: u32,
    room: usize,
) -> Vec<(f32, (u32, u32))> {
    let is_long = |&index: &u32| {
        let leaf = &draft.leaves[index as usize];
        let shared = leaf.vertices.iter().all(|&v| values.sharing.shares(v));
        let fine = if shared { 2.0 * values.sharing.cell() } else { 0.0 };
        u32::from(leaf.level) >= round && draft.longest_edge(leaf) > params.inside_edge.max(fine)
    };
    let leaves = (0..draft.leaves.len() as u32).into_par_iter().with_min_len(1024);
    let promise = |index: u32| (draft.longest_edge(&draft.leaves[index as usize]), index);
    let long = most_promising(leaves.filter(is_long).map(promise).collect(), room);
    let test = |index: u32| {
        let leaf = &draft.leaves[index as usize];
        let vertices = leaf.vertices;
        let look = values.look(draft, &vertices, params);
        let foretold = vertices.iter().map(|&v| values.values[v as usize]).sum::<Rgb>() / 3.0;
        let found = field.evaluate_inside(draft, index, look);
        let marked = misses([foretold, found], draft.longest_edge(leaf), floor, params);
        marked.into_iter().flat_map(move |cost| {
            (0..3).map(move |k| {
                let (a, b) = (vertices[k], vertices[(k + 1) % 3]);
                (cost, (a.min(b), a.max(b)))
            })
        })
    };
    long.into_par_iter().with_min_len(16).with_max_len(JOB).flat_map_iter(test).collect()
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::draft::Leaf;
    use crate::field::{Found, Known, Look};
    use crate::sharing::{Covers, Sharing};
    use crate::solve::SolveParams;
    use catoptric_scene::{Material, Scene, SceneParts, Silent};
    use catoptric_solution::Quality;
    use catoptric_trace::sequence::{Key, Purpose};

    fn standard() -> RefineParams {
        SolveParams::for_quality(Quality::Standard).sources
    }

    /// Even light with noise, of which the usual samples leave this share: all of it is known, or none.
    struct Noisy {
        deviation: f32,
        is_known: bool,
    }

    impl Field for Noisy {
        fn evaluate(&self, _: &Draft, vertex: u32, _: Known, look: Look) -> Found {
            let deviation = self.deviation * libm::powf(look.times() as f32, -0.75);
            // Even between −√3 and √3: of variance one.
            let noise = (Key::new(0, Purpose::Test, u64::from(vertex)).uniform(0) - 0.5) * libm::sqrtf(12.0);
            let variance = if self.is_known { 3.0 * deviation * deviation } else { 0.0 };
            let value = Rgb::splat(1.0 + noise * deviation);
            Found { value, variance, times: look.times(), ..Found::default() }
        }

        fn evaluate_inside(&self, _: &Draft, _: u32, _: Look) -> Rgb {
            Rgb::ONE
        }
    }

    #[test]
    fn those_that_promise_most_are_kept_in_their_order() {
        assert_eq!(most_promising(vec![(0.0, 1), (2.0, 2), (1.0, 3)], 3), [1, 2, 3]);
        let all = (0..8).map(|i| (if i % 3 == 1 { 1.0 } else { 0.1 * i as f32 }, i)).collect();
        assert_eq!(most_promising(all, 3), [1, 4, 7]);
        // Of those that promise the same, the first ones.
        assert_eq!(most_promising(vec![(1.0, 1), (1.0, 4), (1.0, 7)], 2), [1, 4]);
    }

    #[test]
    fn noise_that_is_known_splits_no_edges() {
        let mut parts = SceneParts::default();
        let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
        parts.add_quad("floor", white, Vec3::new(-2.0, 0.0, 2.0), Vec3::X * 4.0, Vec3::Z * -4.0);
        let scene = Scene::new(parts).expect("a valid scene");
        let tracer = Tracer::new(&scene);
        let spacing = 0.4;
        let vertices = |is_known: bool| {
            let mut draft = Draft::new(&tracer, spacing);
            let before = draft.active_vertices().iter().filter(|&&used| used).count();
            let params = RefineParams { blur: 0.03 * spacing, ..standard() };
            let field = Noisy { deviation: 0.024, is_known };
            refine(&tracer, &mut draft, &field, &mut Values::default(), &params, &Silent)
                .expect("not stopped");
            [before, draft.active_vertices().iter().filter(|&&used| used).count()]
        };
        let [[before, known], [_, unknown]] = [true, false].map(vertices);
        // Four times the samples leave a 2.8th of the noise, 0.0085; no middle is off the mean of its ends by more than 2 √3 times that, and
        // 0.03 is left alone.
        assert_eq!(known, before);
        // Of the noise of the usual samples, √1.5 · 0.024 is usual: every third edge is split.
        assert!(unknown > 2 * before, "{before} became {unknown}");
    }

    /// Light from `x = EDGE` on.
    struct Shadow;

    const EDGE: f32 = 0.012;

    impl Field for Shadow {
        fn evaluate(&self, draft: &Draft, vertex: u32, _: Known, look: Look) -> Found {
            let lit = draft.vertices[vertex as usize].position.x >= EDGE;
            let value = if lit { Rgb::ONE } else { Rgb::ZERO };
            Found { value, times: look.times(), ..Found::default() }
        }

        fn evaluate_inside(&self, _: &Draft, _: u32, _: Look) -> Rgb {
            Rgb::ONE
        }
    }

    /// A small face at the origin, and a floor beyond x = 1.
    fn face_and_floor(width: f32, height: f32) -> Scene {
        let mut parts = SceneParts::default();
        let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
        parts.add_quad("face", white, Vec3::ZERO, Vec3::X * width, Vec3::Y * height);
        parts.add_quad("floor", white, Vec3::new(1.0, 0.0, 2.0), Vec3::X * 4.0, Vec3::Z * -4.0);
        Scene::new(parts).expect("a valid scene")
    }

    /// The back of a book beside one that stands out: it is small enough for its corners to share, but not finer than the shadow on it.
    #[test]
    fn a_shadow_on_a_narrow_face_keeps_its_edge() {
        let (width, height, spacing) = (0.06, 0.15, 0.4);
        let scene = face_and_floor(width, height);
        let tracer = Tracer::new(&scene);
        let mut draft = Draft::new(&tracer, spacing);
        let sharing = Sharing::new(&tracer, &draft, spacing, 0.25 * spacing, Covers::Part, 1000, &[]);
        let is_back = |draft: &Draft, v: u32| draft.vertices[v as usize].position.x < 0.5;
        assert!((0..draft.vertices.len() as u32).any(|v| is_back(&draft, v) && sharing.shares(v)));
        let mut values = Values::new(sharing);
        let params = RefineParams { blur: 0.03 * spacing, ..standard() };
        refine(&tracer, &mut draft, &Shadow, &mut values, &params, &Silent).expect("not stopped");
        let light: f32 = draft
            .leaves
            .iter()
            .filter(|leaf| leaf.vertices.iter().all(|&v| is_back(&draft, v)))
            .map(|leaf| {
                draft.area(leaf) * leaf.vertices.iter().map(|&v| values.values[v as usize].x).sum::<f32>()
                    / 3.0
            })
            .sum();
        // Edges across the shadow's are left alone where the middle's error, ½ of ⅔ (it is lit) and the floor, a tenth of at most 1,
        // times their length is below the blur. Half of an edge is off at most.
        let exact = height * (width - EDGE);
        let most = height * 0.5 * params.blur / (0.5 / (2.0 / 3.0 + 0.1));
        assert!((light - exact).abs() < most, "{light} of {exact}, {most} off at most");
    }

    /// Light on a small face but for a seam along its border.
    struct Framed {
        width: f32,
        height: f32,
    }

    const SEAM: f32 = 0.004;
    /// Edges that shadows may keep, metres.
    const BLUR: f32 = 0.003;

    impl Framed {
        fn light(&self, at: Vec3) -> Rgb {
            let within = |x: f32, length: f32| x > SEAM && x < length - SEAM;
            let is_lit = at.x > 0.5 || within(at.x, self.width) && within(at.y, self.height);
            if is_lit { Rgb::ONE } else { Rgb::ZERO }
        }
    }

    impl Field for Framed {
        fn evaluate(&self, draft: &Draft, vertex: u32, _: Known, look: Look) -> Found {
            let value = self.light(draft.vertices[vertex as usize].position);
            Found { value, times: look.times(), ..Found::default() }
        }

        fn evaluate_inside(&self, draft: &Draft, leaf: u32, _: Look) -> Rgb {
            self.light(draft.center(&draft.leaves[leaf as usize]))
        }
    }

    /// The post of a chair between seat and back: where it touches them it is dark, and that is where its corners are.
    #[test]
    fn a_small_face_whose_corners_are_dark_is_looked_into() {
        let (width, height, spacing) = (0.04, 0.08, 0.4);
        let scene = face_and_floor(width, height);
        let tracer = Tracer::new(&scene);
        let light = |inside_rounds: u32| -> f32 {
            let mut draft = Draft::new(&tracer, spacing);
            let sharing = Sharing::new(&tracer, &draft, spacing, 0.25 * spacing, Covers::Part, 1000, &[]);
            let mut values = Values::new(sharing);
            let params =
                RefineParams { blur: BLUR, short_edge: 0.125 * spacing, inside_rounds, ..standard() };
            refine(&tracer, &mut draft, &Framed { width, height }, &mut values, &params, &Silent)
                .expect("not stopped");
            let own = |leaf: &&Leaf| draft.center(leaf).x < 0.5;
            let light = |leaf: &Leaf| leaf.vertices.iter().map(|&v| values.values[v as usize].x).sum::<f32>();
            draft.leaves.iter().filter(own).map(|leaf| draft.area(leaf) * light(leaf) / 3.0).sum()
        };
        // Without a look inside nothing tells.
        assert_eq!(light(0), 0.0);
        // Edges across the seam's border are left alone where the middle's error, ½ of at most ⅔ (it is lit) and the floor, a tenth of at
        // most 1, times their length is below the blur: of their length half is off at most, along the border.
        let lit = (width - 2.0 * SEAM) * (height - 2.0 * SEAM);
        let most = 2.0 * (width + height) * 0.5 * BLUR / (0.5 / (2.0 / 3.0 + 0.1));
        let found = light(1);
        assert!((found - lit).abs() < most && most < 0.25 * lit, "{found} of {lit}, {most} off at most");
    }
}
