//! How fine walls are cut: by how far they see.
//!
//! The irradiance on a surface varies on the scale of the distance of what it sees (Ward & Heckbert 1992). Faces most of which
//! see little but sky, such as the ground around a house, are cut into larger triangles, and what is within gets the others; where most
//! surfaces are near to each other, such as shelves, there are more.

use glam::Vec3;
use rayon::prelude::*;

use catoptric_light::Receiver;
use catoptric_scene::{Barycentric, TriangleId};
use catoptric_trace::Tracer;
use catoptric_trace::sequence::{Key, Purpose, triangle_point};

use crate::JOB;
use crate::base_mesh::diffuse_area;
use crate::face::FaceDraft;
use crate::gather::{Surroundings, look_around};

/// Edge lengths of the base mesh.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Lattice {
    /// About how long edges are, metres, …
    pub(crate) spacing: f32,
    /// … doubled so many times, per face.
    pub(crate) doublings: Vec<u8>,
}

/// Points that look around, about, and the rays of each.
const POINTS: u32 = 2048;
const RAYS: u32 = 16;
/// Points that tell what most of a face sees, at least.
const LEAST_POINTS: usize = 4;

/// Triangles of a lattice by which scenes are compared with each other, whatever the quality.
const USUAL: f32 = 1400.0;
/// A face is open if it sees nothing within this multiple of the spacing of that lattice. Large floors of rooms see walls within 15.
const OPEN: f32 = 32.0;
/// … and large if so many larger triangles fit along it.
const LARGE: f32 = 8.0;
/// Times that the edges of open faces are doubled, at most: enough for a ground of a thousand kilometres around a small room.
const MOST_DOUBLINGS: u8 = 20;
/// Edges along which an author's triangle is cut, at most, about: a vertex that went astray draws out a sliver as long as one likes.
const MOST_ALONG: f32 = 1024.0;
/// … for which edges are doubled so many times at most.
const MOST_DOUBLINGS_OF_SLIVERS: u8 = 31;
/// This share of all surfaces sees something nearer …
const NEAREST: f32 = 0.2;
/// … than this multiple of the spacing, at most: there are as many triangles as that takes. Of the usual spacing, rooms with a few things in
/// them have 1.1 to 2.3, furnished ones 0.9 to 1.0, one with shelves full of books 0.27.
const CLOSE: f32 = 0.85;
/// Open surfaces get so many times the triangles of the others, at most.
const MOST_OPEN: f64 = 3.0;
/// … where more than this share of all is open, it is what the scene is about.
const ALL_OPEN: f64 = 0.95;
/// Most triangles, as a multiple of those of open rooms.
const MOST_TRIANGLES: f32 = 6.0;

/// What a point sees.
struct Glance {
    face: usize,
    /// What it stands for, m².
    area: f32,
    around: Surroundings,
}

impl Lattice {
    /// For about `count` triangles in a room, where they are not too few.
    pub(crate) fn new(tracer: &Tracer, faces: &[FaceDraft], count: usize) -> Self {
        let areas: Vec<f32> =
            faces.iter().map(|face| face.triangles.iter().map(|&t| tracer.scene().area(t)).sum()).collect();
        let glances = glances(tracer, faces, &areas);
        let doublings = doublings(&glances, &areas);
        // Of the author's triangles, some sides are no faces: nothing gets there.
        let of_faces = areas.iter().map(|&area| f64::from(area)).sum::<f64>().max(f64::MIN_POSITIVE);
        let whole = diffuse_area(tracer) * fine_area(&areas, &doublings) / of_faces;
        let usual = spacing_for(whole, USUAL);
        let is_open = |glance: &&Glance| glance.around.distance > OPEN * usual;
        let weight = |glance: &Glance| glance.area * 0.25_f32.powi(doublings[glance.face].into());
        // What sees nothing but sky takes no triangles from the others.
        let open: f64 = glances.iter().filter(is_open).map(|glance| f64::from(weight(glance))).sum();
        let fine = if open < ALL_OPEN * whole { (whole - open).max(whole / MOST_OPEN) } else { whole };
        let seen = glances.iter().filter(|glance| !is_open(glance) && !glance.around.hidden);
        let distances = seen.map(|glance| (glance.around.distance, weight(glance))).collect();
        let usual = spacing_for(fine, USUAL);
        let more = match quantile(distances, NEAREST) {
            Some(distance) if distance > 0.0 => (CLOSE * usual / distance).powi(2).clamp(1.0, MOST_TRIANGLES),
            _ => 1.0,
        };
        let spacing = spacing_for(fine, count.max(1) as f32 * more);
        let doublings =
            faces.iter().zip(doublings).map(|(face, n)| n.max(for_slivers(tracer, face, spacing)));
        Self { spacing, doublings: doublings.collect() }
    }

    /// The same everywhere.
    pub(crate) fn even(spacing: f32) -> Self {
        Self { spacing, doublings: Vec::new() }
    }

    /// Whether a face has larger triangles.
    pub(crate) fn is_open(&self, face: u32) -> bool {
        self.doublings.get(face as usize).is_some_and(|&times| times > 0)
    }

    /// Edge length of a face, metres.
    pub(crate) fn spacing_of(&self, face: usize) -> f32 {
        self.spacing * (1_u32 << self.doublings.get(face).copied().unwrap_or(0)) as f32
    }

    /// Most doublings of any face.
    pub(crate) fn most_doublings(&self) -> u8 {
        self.doublings.iter().copied().max().unwrap_or(0)
    }
}

/// Doublings by which a face's longest edge is cut into no more than [`MOST_ALONG`].
fn for_slivers(tracer: &Tracer, face: &FaceDraft, spacing: f32) -> u8 {
    let longest_of = |&t: &TriangleId| {
        let [a, b, c] = tracer.scene().corners(t);
        a.distance(b).max(b.distance(c)).max(c.distance(a))
    };
    let longest = face.triangles.iter().map(longest_of).fold(0.0, f32::max);
    (longest / (MOST_ALONG * spacing)).max(1.0).log2().ceil().min(f32::from(MOST_DOUBLINGS_OF_SLIVERS)) as u8
}

/// Edge length for which so much area gives about `count` triangles.
pub(crate) fn spacing_for(area: f64, count: f32) -> f32 {
    // A right triangle with legs h has the area h²/2.
    ((2.0 * area / f64::from(count)).sqrt() as f32).max(f32::MIN_POSITIVE)
}

/// Area of the faces, less what larger triangles save.
fn fine_area(areas: &[f32], doublings: &[u8]) -> f64 {
    areas.iter().zip(doublings).map(|(&area, &n)| f64::from(area) * 0.25_f64.powi(n.into())).sum()
}

/// What points on the faces see: more of large ones, but not in proportion, or a field would leave none for the house in it; of ground
/// to the horizon, no more than of the largest walls.
fn glances(tracer: &Tracer, faces: &[FaceDraft], areas: &[f32]) -> Vec<Glance> {
    let scene = tracer.scene();
    let extent = tracer.extent();
    let widest = extent.inner.diagonal as f32;
    let widths: Vec<f32> = faces
        .iter()
        .zip(areas)
        .map(|(face, area)| match area.sqrt() {
            width if width > widest && face.triangles.iter().any(|&t| extent.is_outlying(t)) => widest,
            width => width,
        })
        .collect();
    let total: f64 = widths.iter().map(|&width| f64::from(width)).sum();
    let step = total / f64::from(POINTS);
    // The same in every solve: which lattice a scene gets is no matter of chance.
    let key_of = |index: usize| Key::new(0, Purpose::ElementPoint, index as u64 | 1 << 48);
    let mut drawn: Vec<(usize, TriangleId)> = Vec::new();
    let (mut sum, mut next) = (0.0, 0.5 * step);
    for (index, ((face, area), width)) in faces.iter().zip(areas).zip(&widths).enumerate() {
        sum += f64::from(*width);
        if step <= 0.0 || next >= sum {
            continue;
        }
        let ends: Vec<f32> = face
            .triangles
            .iter()
            .scan(0.0, |end, &t| {
                *end += scene.area(t);
                Some(*end)
            })
            .collect();
        while next < sum {
            let place = key_of(drawn.len()).uniform(0) * area;
            let triangle = ends.partition_point(|&end| end < place).min(ends.len() - 1);
            drawn.push((index, face.triangles[triangle]));
            next += step;
        }
    }
    drawn
        .par_iter()
        .enumerate()
        .with_min_len(16)
        .with_max_len(JOB)
        .map(|(index, &(at, triangle))| {
            let (face, key) = (&faces[at], key_of(index));
            let (u, v) = triangle_point(key.point2(1));
            let receiver = Receiver::on(tracer, triangle, face.side, Barycentric { u, v });
            let around = look_around(tracer, &receiver, 0..RAYS, key.child(1), |_, _, _: Vec3| {});
            let length = areas[at].sqrt();
            Glance { face: at, area: length * (length / widths[at]) * step as f32, around }
        })
        .collect()
}

/// How many times the edges of each face are doubled: the open ones, by how far half of them see.
fn doublings(glances: &[Glance], areas: &[f32]) -> Vec<u8> {
    let mut distances: Vec<(usize, Vec<f32>)> = Vec::new();
    for glance in glances {
        match distances.last_mut().filter(|last| last.0 == glance.face) {
            Some((_, own)) => own.push(glance.around.distance),
            None => distances.push((glance.face, vec![glance.around.distance])),
        }
    }
    let median = |(face, mut own): (usize, Vec<f32>)| {
        let middle = own.len() / 2;
        (own.len() >= LEAST_POINTS).then(|| (face, *own.select_nth_unstable_by(middle, f32::total_cmp).1))
    };
    let medians: Vec<(usize, f32)> = distances.into_iter().filter_map(median).collect();
    let mut doublings = vec![0; areas.len()];
    // Open faces need not become less than the others.
    let is_open = |distance: f32| distance > OPEN * spacing_for(fine_area(areas, &doublings), USUAL);
    let mut open = vec![false; areas.len()];
    for &(face, _) in medians.iter().filter(|m| is_open(m.1)) {
        open[face] = true;
    }
    let area = |wanted: bool| {
        areas.iter().zip(&open).filter(|a| *a.1 == wanted).map(|a| f64::from(*a.0)).sum::<f64>()
    };
    let most = match area(false) {
        closed if closed > 0.0 => {
            (area(true) / closed).max(1.0).log(4.0).ceil().min(f64::from(MOST_DOUBLINGS)) as u8
        }
        _ => 0,
    };
    // What open faces save makes the others finer, beside which more are open.
    for _ in 0..most {
        let usual = spacing_for(fine_area(areas, &doublings), USUAL);
        for &(face, distance) in &medians {
            let times =
                (distance / (OPEN * usual)).min(areas[face].sqrt() / (LARGE * usual)).max(1.0).log2() as u8;
            doublings[face] = times.min(most);
        }
    }
    doublings
}

/// Of (value, weight), the value below which about `share` of all weight is.
fn quantile(mut values: Vec<(f32, f32)>, share: f32) -> Option<f32> {
    values.sort_by(|a, b| a.0.total_cmp(&b.0));
    let below = share * values.iter().map(|v| v.1).sum::<f32>();
    let mut sum = 0.0;
    values
        .into_iter()
        .find(|&(_, weight)| {
            sum += weight;
            sum >= below
        })
        .map(|(value, _)| value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contact::Obstacles;
    use crate::draft::Draft;
    use crate::face::faces;
    use catoptric_scene::{Material, MaterialId, Rgb, Scene, SceneParts};

    const COUNT: usize = 1400;

    /// The lattice of what `build` makes, and the base triangles with all corners in a box.
    fn lattice(build: impl FnOnce(&mut SceneParts, MaterialId), low: Vec3, high: Vec3) -> (Lattice, usize) {
        let mut parts = SceneParts::default();
        let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
        build(&mut parts, white);
        let scene = Scene::new(parts).expect("the scene is valid");
        let tracer = Tracer::new(&scene);
        let faces = faces(&tracer);
        let lattice = Lattice::new(&tracer, &faces, COUNT);
        let draft = Draft::on(&tracer, &Obstacles::new(&tracer), faces, &lattice, f32::INFINITY);
        let is_inside = |v: &u32| {
            let position = draft.vertices[*v as usize].position;
            position.cmpge(low - 1e-4).all() && position.cmple(high + 1e-4).all()
        };
        let count = draft.leaves.iter().filter(|leaf| leaf.vertices.iter().all(is_inside)).count();
        (lattice, count)
    }

    /// A room of which one wall is missing.
    fn add_room(parts: &mut SceneParts, white: MaterialId) {
        let (x, y, z) = (Vec3::X, Vec3::Y, Vec3::Z);
        parts.add_quad("floor", white, Vec3::new(-2.0, 0.0, 2.0), 4.0 * x, -4.0 * z);
        parts.add_quad("ceiling", white, Vec3::new(-2.0, 2.5, -2.0), 4.0 * x, 4.0 * z);
        parts.add_quad("back", white, Vec3::new(-2.0, 0.0, -2.0), 4.0 * x, 2.5 * y);
        parts.add_quad("left", white, Vec3::new(-2.0, 0.0, -2.0), 2.5 * y, 4.0 * z);
        parts.add_quad("right", white, Vec3::new(2.0, 0.0, -2.0), 4.0 * z, 2.5 * y);
    }

    const LOW: Vec3 = Vec3::new(-2.0, 0.0, -2.0);
    const HIGH: Vec3 = Vec3::new(2.0, 2.5, 2.0);

    #[test]
    fn a_field_takes_no_triangles_from_the_house_in_it() {
        let (alone, of_alone) = lattice(add_room, LOW, HIGH);
        assert!(alone.doublings.iter().all(|&times| times == 0));
        for side in [80.0, 10_000.0, 1e6] {
            let (in_field, of_house) = lattice(
                |parts, white| {
                    add_room(parts, white);
                    let corner = Vec3::new(-0.5 * side, -0.1, 0.5 * side);
                    parts.add_quad("field", white, corner, Vec3::X * side, Vec3::Z * -side);
                },
                LOW,
                HIGH,
            );
            assert!(in_field.most_doublings() > 0);
            // By area, the house would be left with a hundredth, or nothing. What the field has left may be as much as the house.
            assert!(2 * of_house > of_alone, "{side} m: {of_house} of {of_alone}");
        }
        let all = lattice(
            |parts, white| {
                parts.add_quad("field", white, Vec3::new(-40.0, 0.0, 40.0), Vec3::X * 80.0, Vec3::Z * -80.0);
            },
            Vec3::splat(-50.0),
            Vec3::splat(50.0),
        );
        // A field alone is what its scene is about.
        assert!(all.0.most_doublings() == 0 && all.1 > COUNT / 2, "{}", all.1);
    }

    /// … nor does a vertex that went astray, however far: it draws out a sliver.
    #[test]
    fn a_stray_vertex_costs_next_to_nothing() {
        let (_, of_alone) = lattice(add_room, LOW, HIGH);
        for far in [1e4, 1e6, 1e8] {
            let add_stray = |parts: &mut SceneParts, white| {
                add_room(parts, white);
                let corners = [Vec3::new(3.0, 0.0, 0.0), Vec3::new(far, 0.0, 0.0), Vec3::new(3.0, 1.0, 0.0)];
                parts.add_triangles("stray", white, &corners, &[[0, 1, 2]]);
            };
            let of_room = lattice(add_stray, LOW, HIGH).1;
            let all = lattice(add_stray, Vec3::splat(f32::NEG_INFINITY), Vec3::INFINITY).1;
            assert!(2 * of_room > of_alone, "{far} m: {of_room} of {of_alone}");
            // Twice as many segments as there may be along it, each the base of two triangles.
            assert!(all < of_room + 4 * MOST_ALONG as usize, "{far} m: {all}, {of_room} in the room");
        }
    }

    /// A room with boards one above the other along its back wall, metres deep.
    fn add_shelves(parts: &mut SceneParts, white: MaterialId, depth: f32) {
        add_room(parts, white);
        for board in 0..24 {
            let low = Vec3::new(-1.9, 0.1 * board as f32 + 0.05, -1.9);
            parts.add_box("board", white, low, low + Vec3::new(3.8, 0.02, depth), false);
        }
    }

    #[test]
    fn shelves_get_more_triangles_than_an_open_room() {
        let area_of_room = 2.0 * 4.0 * 4.0 + 3.0 * 4.0 * 2.5;
        let room = lattice(add_room, LOW, HIGH).0;
        let usual = spacing_for(area_of_room, COUNT as f32);
        assert!((room.spacing / usual - 1.0).abs() < 0.01, "{} {usual}", room.spacing);
        for (depth, share) in [(1.5, 0.8), (0.2, 0.4)] {
            let shelves = lattice(|parts, white| add_shelves(parts, white, depth), LOW, HIGH).0;
            let of_boards = 24.0 * 2.0 * (3.8 * depth + 0.02 * (3.8 + depth));
            let area = area_of_room + f64::from(of_boards);
            assert!(
                (f64::from(of_boards) / area - share).abs() < 0.1,
                "boards {depth} m deep are another share"
            );
            // They see the next board 0.08 m away: the most triangles that a scene gets, though they be less than half of it.
            let most = spacing_for(area, MOST_TRIANGLES * COUNT as f32);
            assert!((shelves.spacing / most - 1.0).abs() < 0.1, "{depth} m: {} {most}", shelves.spacing);
        }
    }
}
