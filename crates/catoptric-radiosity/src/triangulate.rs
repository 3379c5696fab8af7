//! A face becomes well-shaped triangles: its outline and contact lines are split where they meet, cut to length (`arrangement`), and
//! triangulated with a lattice inside (constrained Delaunay, Chew 1989), graded from short lines to the lattice (Ruppert 1995); both
//! by spade, with robust predicates. Keys in docs/references.md: Chew1989, Ruppert1995.

use std::panic::{AssertUnwindSafe, catch_unwind};

use glam::DVec2;
use spade::{
    AngleLimit, ConstrainedDelaunayTriangulation, HasPosition, Point2, RefinementParameters, Triangulation,
};

use catoptric_scene::Union;

use crate::arrangement::{Arrangement, outline};
use crate::contact::Segment;

/// A flat triangle mesh whose corners know on which side of a contact line they are.
#[derive(Clone, Debug, Default)]
pub struct FlatMesh {
    /// Vertices: several may share a point, one for each side of the contact lines that meet there.
    pub points: Vec<DVec2>,
    /// Counter-clockwise triangles.
    pub triangles: Vec<[u32; 3]>,
}

/// Indexed point for spade.
#[derive(Clone, Copy, Debug)]
struct Site {
    position: Point2<f64>,
}

impl From<Point2<f64>> for Site {
    fn from(position: Point2<f64>) -> Self {
        Self { position }
    }
}

impl HasPosition for Site {
    type Scalar = f64;
    fn position(&self) -> Point2<f64> {
        self.position
    }
}

/// Segments of outline and contact lines above which the arrangement, which looks at each pair, would cost more than the
/// picture gains: contact lines are left out.
const MAX_SEGMENTS: usize = 3000;

/// Angles below this many degrees are refined away: up to 20.7, Ruppert's algorithm comes to an end wherever lines do not meet at
/// sharp angles. Unrefined, the short lines of a ring on a floor reach for the lattice in long slivers, along which light is
/// interpolated (2026-11-21: ring_caustic has 1.8 times the relMSE_nc then, in 1.6 times the seconds).
const LEAST_ANGLE: f64 = 20.0;
/// … but for triangles below this share of the spacing squared. At ten times as much, fans of 192 lines of 5 mm around a ring on a table
/// stay as they are (spacing ½ m), and what curved mirrors throw beside it is shown as spikes.
const LEAST_AREA: f64 = 1e-4;
/// Points that this may add for each that is there, at most: lines that meet at sharp angles ask for any number. An arc on a
/// wide wall or the legs of a chair need up to six times as many as there are; what stops before leaves fans.
const ADDED: usize = 10;

/// Triangulates the union of `triangles` with the contact lines `contacts` and further `lines` that part nothing, edges about `spacing`
/// long (metres).
/// Points closer than `tolerance` are one.
pub fn triangulate(
    triangles: &[[DVec2; 3]],
    contacts: &[Segment],
    lines: &[Segment],
    spacing: f64,
    tolerance: f64,
) -> FlatMesh {
    let mut outline = outline(triangles, tolerance);
    outline.extend(lines);
    let contacts = if contacts.len() + outline.len() > MAX_SEGMENTS { &[] } else { contacts };
    let Some(mut arrangement) = Arrangement::new(&outline, contacts, spacing, tolerance)
        .or_else(|| Arrangement::new(&outline, &[], spacing, tolerance))
    else {
        return plain(triangles);
    };
    arrangement.halve_encroached();
    let mut sites: Vec<DVec2> = arrangement.points.clone();
    lattice(triangles, &arrangement, spacing, &mut sites);

    let vertices: Vec<Site> = sites.iter().map(|p| Site { position: Point2::new(p.x, p.y) }).collect();
    let edges: Vec<[usize; 2]> =
        arrangement.edges.iter().map(|e| [e.ends[0] as usize, e.ends[1] as usize]).collect();
    let Some(cdt) = refined(&vertices, &edges, LEAST_AREA * spacing * spacing) else {
        return plain(triangles);
    };

    // Triangles inside the face, with the corners joined across everything but contact lines.
    let inside = Inside::new(triangles);
    let mut kept: Vec<[u32; 3]> = Vec::new();
    let mut slot_of_face = vec![u32::MAX; cdt.num_all_faces() + 1];
    for face in cdt.inner_faces() {
        let corners = face.vertices().map(|v| v.fix().index());
        let points = face.vertices().map(|v| DVec2::new(v.position().x, v.position().y));
        let area = 0.5 * (points[1] - points[0]).perp_dot(points[2] - points[0]);
        if area <= tolerance * tolerance {
            continue;
        }
        if inside.holds((points[0] + points[1] + points[2]) / 3.0) {
            slot_of_face[face.fix().index()] = kept.len() as u32;
            kept.push(corners.map(|c| c as u32));
        }
    }
    let mut corners = Union::new(kept.len() * 3);
    let contact: std::collections::HashSet<(u32, u32)> = arrangement
        .edges
        .iter()
        .filter(|e| e.contact)
        .map(|e| (e.ends[0].min(e.ends[1]), e.ends[0].max(e.ends[1])))
        .collect();
    for edge in cdt.undirected_edges() {
        let directed = edge.as_directed();
        let [Some(left), Some(right)] = [directed.face().as_inner(), directed.rev().face().as_inner()]
            .map(|f| f.map(|f| slot_of_face[f.fix().index()]))
        else {
            continue;
        };
        if left == u32::MAX || right == u32::MAX {
            continue;
        }
        let ends = [directed.from().fix().index() as u32, directed.to().fix().index() as u32];
        if contact.contains(&(ends[0].min(ends[1]), ends[0].max(ends[1]))) {
            continue;
        }
        for end in ends {
            let corner = |slot: u32| {
                let at = kept[slot as usize].iter().position(|&c| c == end).unwrap_or(0);
                slot * 3 + at as u32
            };
            corners.join(corner(left), corner(right));
        }
    }

    // One vertex per class of joined corners, in order of first use.
    let mut mesh = FlatMesh::default();
    let mut vertex_of = vec![u32::MAX; kept.len() * 3];
    let positions: Vec<DVec2> = cdt.vertices().map(|v| DVec2::new(v.position().x, v.position().y)).collect();
    for (slot, triangle) in kept.iter().enumerate() {
        let own = std::array::from_fn(|k| {
            let root = corners.find((slot * 3 + k) as u32) as usize;
            if vertex_of[root] == u32::MAX {
                vertex_of[root] = mesh.points.len() as u32;
                mesh.points.push(positions[triangle[k] as usize]);
            }
            vertex_of[root]
        });
        mesh.triangles.push(own);
    }
    if mesh.triangles.is_empty() { plain(triangles) } else { mesh }
}

/// A triangle in parts.
pub(crate) struct CutMesh {
    /// The points of its outline, then those inside.
    pub(crate) points: Vec<DVec2>,
    /// Counter-clockwise triangles.
    pub(crate) triangles: Vec<[u32; 3]>,
    /// Their edges on lines.
    pub(crate) lines: Vec<[u32; 2]>,
}

/// Cuts a triangle along lines, counter-clockwise `outline` with the points on its edges (constrained Delaunay). Nothing where the
/// outline would not stay as it is.
pub(crate) fn cut(outline: &[DVec2], lines: &[Segment], tolerance: f64) -> Option<CutMesh> {
    let count = outline.len();
    let rim: Vec<Segment> = (0..count).map(|k| [outline[k], outline[(k + 1) % count]]).collect();
    let Arrangement { points, edges } = Arrangement::new(&rim, lines, f64::INFINITY, tolerance)?;
    let is_rim = |[a, b]: [u32; 2]| {
        let (low, high) = (a.min(b) as usize, a.max(b) as usize);
        high < count && (high == low + 1 || (low == 0 && high + 1 == count))
    };
    let kept = edges.iter().filter(|edge| is_rim(edge.ends)).count();
    let others = edges.iter().any(|edge| !edge.contact && !is_rim(edge.ends));
    if points.get(..count) != Some(outline) || kept != count || others {
        return None;
    }
    let sites = points.iter().map(|p| Site { position: Point2::new(p.x, p.y) }).collect();
    let constraints = edges.iter().map(|edge| edge.ends.map(|end| end as usize)).collect();
    let cdt = ConstrainedDelaunayTriangulation::<Site>::try_bulk_load_cdt(sites, constraints, |_| {}).ok()?;
    if cdt.num_vertices() != points.len() {
        return None;
    }
    let mut triangles = Vec::new();
    for face in cdt.inner_faces() {
        let corners = face.vertices().map(|v| v.fix().index());
        let [a, b, c] = corners.map(|v| points[v]);
        let longest = (b - a).length().max((c - b).length()).max((a - c).length());
        // Points on an edge are on one line but for rounding: what lies between them is no part.
        if (b - a).perp_dot(c - a) > 0.1 * tolerance * longest {
            triangles.push(corners.map(|v| v as u32));
        }
    }
    let lines =
        edges.iter().filter(|edge| edge.contact && !is_rim(edge.ends)).map(|edge| edge.ends).collect();
    Some(CutMesh { points, triangles, lines })
}

/// The face's own triangles as they are.
fn plain(triangles: &[[DVec2; 3]]) -> FlatMesh {
    let mut mesh = FlatMesh::default();
    for triangle in triangles {
        let first = mesh.points.len() as u32;
        mesh.points.extend(triangle);
        let turn = (triangle[1] - triangle[0]).perp_dot(triangle[2] - triangle[0]);
        mesh.triangles.push(if turn >= 0.0 {
            [first, first + 1, first + 2]
        } else {
            [first, first + 2, first + 1]
        });
    }
    mesh
}

/// Points in the union of the face's triangles.
struct Inside<'a> {
    triangles: &'a [[DVec2; 3]],
}

/// Share of a triangle's size by which a point beside it counts as in it: one on the border of two may be outside of both by rounding, by some
/// 1e-16 of where they are.
const ROUNDING: f64 = 1e-12;

impl<'a> Inside<'a> {
    fn new(triangles: &'a [[DVec2; 3]]) -> Self {
        Self { triangles }
    }

    fn holds(&self, p: DVec2) -> bool {
        self.triangles.iter().any(|[a, b, c]| {
            let edges = [*b - *a, *c - *b, *a - *c];
            let [u, v, w] = [(0, a), (1, b), (2, c)].map(|(k, from)| edges[k].perp_dot(p - *from));
            let slack = ROUNDING * edges.iter().map(|e| e.length_squared()).fold(0.0, f64::max);
            (u >= -slack && v >= -slack && w >= -slack) || (u <= slack && v <= slack && w <= slack)
        })
    }
}

type Cdt = ConstrainedDelaunayTriangulation<Site>;

/// The triangulation of some points with these edges, its triangles refined until they are well shaped or smaller than `least_area`, m².
/// Nothing where a coordinate is more than spade takes.
fn refined(vertices: &[Site], edges: &[[usize; 2]], least_area: f64) -> Option<Cdt> {
    let mut most = ADDED * vertices.len();
    loop {
        let mut cdt = Cdt::try_bulk_load_cdt(vertices.to_vec(), edges.to_vec(), |_| {}).ok()?;
        if most == 0 {
            return Some(cdt);
        }
        let refine = || {
            // Outline and contact lines stay as they are: neighbours and the two sides know their points.
            cdt.refine(
                RefinementParameters::new()
                    .with_angle_limit(AngleLimit::from_deg(LEAST_ANGLE))
                    .with_min_required_area(least_area)
                    .with_max_additional_vertices(most)
                    .keep_constraint_edges(),
            );
            cdt
        };
        // In a few valid triangulations, such as of hundreds of lines that cross, spade 2.15 walks in circles to where a point is to be
        // added, and gives up with a panic. It comes less far then.
        match catch_unwind(AssertUnwindSafe(refine)) {
            Ok(cdt) => return Some(cdt),
            Err(_) => most /= 2,
        }
    }
}

/// Lattice points inside the face, not too near to any segment.
fn lattice(triangles: &[[DVec2; 3]], arrangement: &Arrangement, spacing: f64, sites: &mut Vec<DVec2>) {
    let (mut min, mut max) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
    for p in triangles.iter().flatten() {
        min = min.min(*p);
        max = max.max(*p);
    }
    let extent = max - min;
    let cells = (extent / spacing).ceil().max(DVec2::ONE);
    if !cells.is_finite() || cells.x * cells.y > 4e6 {
        return;
    }
    let (columns, rows) = (cells.x as usize, cells.y as usize);
    if columns < 2 || rows < 2 {
        return;
    }
    let step = extent / cells;
    let clearance = 0.4 * step.min_element();
    // Segments by lattice cell, so that each point asks its neighbours only.
    let mut near: Vec<Vec<u32>> = vec![Vec::new(); columns * rows];
    for (index, edge) in arrangement.edges.iter().enumerate() {
        let [a, b] = edge.ends.map(|e| arrangement.points[e as usize]);
        let low = ((a.min(b) - min - clearance) / step).floor();
        let high = ((a.max(b) - min + clearance) / step).floor();
        let clamp = |x: f64, n: usize| (x.max(0.0) as usize).min(n - 1);
        for y in clamp(low.y, rows)..=clamp(high.y, rows) {
            for x in clamp(low.x, columns)..=clamp(high.x, columns) {
                near[y * columns + x].push(index as u32);
            }
        }
    }
    let inside = Inside::new(triangles);
    for j in 1..rows {
        for i in 1..columns {
            let point = min + step * DVec2::new(i as f64, j as f64);
            let close = [(i, j), (i - 1, j), (i, j - 1), (i - 1, j - 1)].iter().any(|&(x, y)| {
                near[y.min(rows - 1) * columns + x.min(columns - 1)].iter().any(|&e| {
                    let [a, b] = arrangement.edges[e as usize].ends.map(|k| arrangement.points[k as usize]);
                    distance(point, a, b) < clearance
                })
            });
            if !close && inside.holds(point) {
                sites.push(point);
            }
        }
    }
}

/// Distance of a point from a segment.
fn distance(p: DVec2, a: DVec2, b: DVec2) -> f64 {
    let edge = b - a;
    let length = edge.length_squared();
    let t = if length > 0.0 { (edge.dot(p - a) / length).clamp(0.0, 1.0) } else { 0.0 };
    (a + edge * t - p).length()
}

#[cfg(test)]
mod tests {
    use catoptric_trace::sequence::{Key, Purpose};

    use super::*;

    /// The middles of elements of a strip lie on its diagonal, and by rounding on neither side of it: a hole would be left.
    #[test]
    fn strips_are_covered_whatever_their_size() {
        let key = Key::new(2, Purpose::Test, 0);
        for index in 0..3000 {
            let size = key.point2(index).as_dvec2();
            let corner = key.child(1).point2(index).as_dvec2() - 0.5;
            // Positions are f32.
            let f32s = |x: f64, y: f64| DVec2::new(f64::from(x as f32), f64::from(y as f32));
            let (w, h) = (0.1 + 0.1 * size.x, 1.0 + size.y);
            let [a, b, c, d] =
                [(0.0, 0.0), (w, 0.0), (w, h), (0.0, h)].map(|(x, y)| f32s(corner.x + x, corner.y + y));
            let triangles = [[d, a, b], [d, b, c]];
            let mesh = triangulate(&triangles, &[], &[], 0.4, 1e-5);
            // Points are moved by 1e-5 at most, of a width of 0.1 and more; a hole is a tenth.
            let (covered, whole) = (area(&mesh), (b - a).perp_dot(d - a));
            assert!((covered / whole - 1.0).abs() < 1e-4, "strip {index}: {covered} of {whole}");
        }
    }

    fn square(size: f64) -> Vec<[DVec2; 3]> {
        let [a, b, c, d] =
            [(0.0, 0.0), (size, 0.0), (size, size), (0.0, size)].map(|(x, y)| DVec2::new(x, y));
        vec![[a, b, c], [a, c, d]]
    }

    fn area(mesh: &FlatMesh) -> f64 {
        mesh.triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|v| mesh.points[v as usize]);
                0.5 * (b - a).perp_dot(c - a)
            })
            .sum()
    }

    #[test]
    fn the_mesh_covers_the_face_once_whatever_the_contacts() {
        let contacts = [
            [DVec2::new(0.3, 0.0), DVec2::new(0.3, 1.0)],
            [DVec2::new(0.1, 0.5), DVec2::new(0.9, 0.55)],
            [DVec2::new(0.3, 0.2), DVec2::new(0.8, 0.2)],
        ];
        for count in 0..=contacts.len() {
            let mesh = triangulate(&square(1.0), &contacts[..count], &[], 0.11, 1e-7);
            assert!((area(&mesh) - 1.0).abs() < 1e-9, "{count} contacts: {}", area(&mesh));
        }
    }

    /// A line across separates the sides: no triangle of the left shares a vertex with one of the right.
    #[test]
    fn a_contact_line_across_the_face_gives_each_side_its_own_vertices() {
        let line = [DVec2::new(0.4, 0.0), DVec2::new(0.4, 1.0)];
        let mesh = triangulate(&square(1.0), &[line], &[], 0.2, 1e-7);
        let mut sides = vec![[false; 2]; mesh.points.len()];
        for t in &mesh.triangles {
            let center = t.iter().map(|&v| mesh.points[v as usize].x).sum::<f64>() / 3.0;
            for &v in t {
                sides[v as usize][usize::from(center > 0.4)] = true;
            }
        }
        assert!(sides.iter().all(|s| s[0] != s[1]));
    }

    /// Around the end of a line that stops inside, the sides hang together.
    #[test]
    fn a_contact_line_that_ends_inside_shares_its_end() {
        let line = [DVec2::new(0.5, 0.0), DVec2::new(0.5, 0.5)];
        let mesh = triangulate(&square(1.0), &[line], &[], 0.25, 1e-7);
        let at = |p: DVec2| mesh.points.iter().filter(|q| (**q - p).length() < 1e-9).count();
        assert_eq!(at(DVec2::new(0.5, 0.5)), 1);
        assert_eq!(at(DVec2::new(0.5, 0.25)), 2);
        assert_eq!(at(DVec2::new(0.5, 0.0)), 2);
    }

    /// Eleven points and four lines of a valid triangulation in which spade 2.15 does not find where a circumcentre lies.
    #[test]
    fn where_the_refinement_gives_up_there_are_triangles() {
        let points = [
            (1.89356, 1.53524),
            (2.06099, 0.97585),
            (2.44348, 1.63632),
            (2.02544, 0.75214),
            (2.38551, 1.5649),
            (1.85296, 1.55932),
            (1.8325, 1.65508),
            (1.71204, 1.31276),
            (1.74967, 0.94572),
            (1.84692, 0.84281),
            (2.04104, 1.25026),
        ];
        let vertices = points.map(|(x, y)| Site { position: Point2::new(x, y) });
        let edges = [[0, 1], [2, 10], [3, 4], [3, 5]];
        let cdt = refined(&vertices, &edges, 5e-4).expect("the coordinates are small");
        assert!(cdt.num_vertices() >= points.len());
        let is_kept = |[a, b]: &[usize; 2]| {
            let [a, b] = [a, b].map(|v| spade::handles::FixedVertexHandle::from_index(*v));
            cdt.get_edge_from_neighbors(a, b).is_some_and(|edge| edge.is_constraint_edge())
        };
        assert!(edges.iter().all(is_kept));
        let turn = |[a, b, c]: [Point2<f64>; 3]| (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
        assert!(cdt.inner_faces().all(|face| turn(face.positions()) > 0.0));
    }

    /// A round thing in short segments stands on a face with a wide lattice: elements grow from one to the other, none is a
    /// sliver. Those too small to be refined may be.
    #[test]
    fn elements_grow_from_short_contact_lines_to_the_lattice() {
        let spacing = 0.25;
        let contacts = ring(DVec2::new(0.45, 0.52), 0.13, 48);
        let mesh = triangulate(&square(1.0), &contacts, &[], spacing, 1e-7);
        assert!((area(&mesh) - 1.0).abs() < 1e-9);
        let mut counted = 0;
        for t in &mesh.triangles {
            let q = t.map(|v| mesh.points[v as usize]);
            let size = 0.5 * (q[1] - q[0]).perp_dot(q[2] - q[0]);
            if size < LEAST_AREA * spacing * spacing {
                continue;
            }
            counted += 1;
            for k in 0..3 {
                let (a, b) = (q[(k + 1) % 3] - q[k], q[(k + 2) % 3] - q[k]);
                let least = libm::sin(LEAST_ANGLE.to_radians());
                // spade compares radius and edge, this compares a sine: f64 roundings apart.
                assert!(
                    a.perp_dot(b) > (1.0 - 1e-9) * least * a.length() * b.length(),
                    "sliver at {:?}",
                    q[k]
                );
            }
        }
        // Each of the 48 lines has its element, and a few rows lead to the lattice of 5 by 5: not thousands.
        assert!((96..600).contains(&counted), "{counted}");
    }

    /// The lines of a regular polygon.
    fn ring(center: DVec2, radius: f64, count: u32) -> Vec<Segment> {
        let corner = |k: u32| {
            let turn = f64::from(k % count) / f64::from(count) * std::f64::consts::TAU;
            center + radius * DVec2::new(libm::cos(turn), libm::sin(turn))
        };
        (0..count).map(|k| [corner(k), corner(k + 1)]).collect()
    }

    /// Longest edge over shortest one.
    fn slenderness(points: &[DVec2], triangle: [u32; 3]) -> f64 {
        let [a, b, c] = triangle.map(|v| points[v as usize]);
        let edges = [(b - a).length(), (c - b).length(), (a - c).length()];
        edges.iter().fold(0.0, |x: f64, y| x.max(*y))
            / edges.iter().fold(f64::INFINITY, |x: f64, y| x.min(*y))
    }

    /// A ring of 192 lines of 5 mm on a table 0.88 m deep, 4 cm from its edge, where edges are half a metre long. A triangle with no
    /// angle below 20° is at most 1/sin 20° = 2.9 times as long as wide; beside outlines that stay as they are, and where two lines of the ring
    /// meet, it can be more. A fan from the end of the long edge is 30 times.
    #[test]
    fn short_lines_near_a_long_edge_reach_for_its_ends_in_no_fans() {
        let table = [DVec2::ZERO, DVec2::new(1.5, 0.0), DVec2::new(1.5, 0.88), DVec2::new(0.0, 0.88)];
        let triangles = vec![[table[0], table[1], table[2]], [table[0], table[2], table[3]]];
        let contacts = ring(DVec2::new(0.8, 0.19), 0.15, 192);
        let mesh = triangulate(&triangles, &contacts, &[], 0.5, 1e-6);
        assert!((area(&mesh) - 1.5 * 0.88).abs() < 1e-9);
        let worst = mesh.triangles.iter().map(|&t| slenderness(&mesh.points, t)).fold(0.0, f64::max);
        assert!(worst < 8.0, "{worst}");
        assert!((384..2500).contains(&mesh.triangles.len()), "{}", mesh.triangles.len());
    }

    /// A chair's four legs, 4 cm wide, on a floor with edges of a metre: few points, and each leg needs many around it.
    #[test]
    fn thin_legs_on_a_wide_floor_have_no_fans() {
        let legs = [(1.3, 1.3), (1.7, 1.3), (1.3, 1.7), (1.7, 1.7)];
        let contacts: Vec<Segment> =
            legs.iter().flat_map(|&(x, y)| ring(DVec2::new(x, y), 0.02, 8)).collect();
        let mesh = triangulate(&square(3.0), &contacts, &[], 1.0, 1e-6);
        assert!((area(&mesh) - 9.0).abs() < 1e-9);
        let worst = mesh.triangles.iter().map(|&t| slenderness(&mesh.points, t)).fold(0.0, f64::max);
        // No angle is below the least: no edge is longer than the shortest over its sine.
        let most = 1.0 / libm::sin(LEAST_ANGLE.to_radians());
        assert!(worst < most, "{worst} {most}");
        assert!((80..2500).contains(&mesh.triangles.len()), "{}", mesh.triangles.len());
    }

    /// A T-junction off by rounding must not leave a sliver: no angle below a few degrees in a simple room wall.
    #[test]
    fn nearly_collinear_outlines_leave_no_slivers() {
        let p = |x: f64, y: f64| DVec2::new(x, y);
        let triangles = [
            [p(0.0, 0.0), p(1.0, 0.0), p(0.0, 1.0)],
            [p(1.0, 0.0), p(0.5, 0.5 + 1e-9), p(1.0, 1.0)],
            [p(0.5, 0.5 + 1e-9), p(0.0, 1.0), p(1.0, 1.0)],
        ];
        let mesh = triangulate(&triangles, &[], &[], 0.2, 1e-6);
        assert!((area(&mesh) - 1.0).abs() < 1e-6);
        for t in &mesh.triangles {
            let q = t.map(|v| mesh.points[v as usize]);
            for k in 0..3 {
                let (a, b) = (q[(k + 1) % 3] - q[k], q[(k + 2) % 3] - q[k]);
                assert!(a.perp_dot(b) > 0.05 * a.length() * b.length(), "sliver at {:?}", q[k]);
            }
        }
    }
}
