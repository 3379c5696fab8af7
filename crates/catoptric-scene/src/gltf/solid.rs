//! Whether solid glass is solid: closed, right side out, not inside of other glass.
//!
//! Inside and outside follow the geometric normal, so a mesh that is open or inverted bends light as if the
//! room were glass. A body is a connected set of triangles of one material, corners welded by position.

use std::collections::HashMap;

use glam::DVec3;

use crate::scene::SceneParts;
use crate::union::Union;

use super::report::Report;

/// More bodies than this are not compared with each other.
const MOST_BODIES: usize = 1000;
/// Triangles that the tests for nesting may look at in all.
const NESTING_WORK: usize = 20_000_000;

/// A connected piece of glass.
struct Body {
    surface: usize,
    triangles: Vec<[DVec3; 3]>,
    open_edges: usize,
    /// Six times the enclosed volume; negative where normals point inwards.
    volume: f64,
    low: DVec3,
    high: DVec3,
}

/// Warns of solid glass that is open, inverted or inside of other solid glass.
pub(super) fn check(parts: &SceneParts, report: &Report) {
    let mut bodies = Vec::new();
    for (index, material) in parts.materials.iter().enumerate() {
        if material.is_solid() {
            bodies.append(&mut collect(parts, index));
        }
    }
    let place = |body: &Body| format!("surface {:?}", parts.surfaces[body.surface].name);
    for body in bodies.iter().filter(|body| body.open_edges > 0) {
        report.warn(
            place(body),
            format!(
                "is solid glass but not closed ({} open edges): light leaks in or out there",
                body.open_edges
            ),
        );
    }
    if bodies.len() > MOST_BODIES {
        report.warn("scene", format!("{} bodies of glass: not checked for nesting", bodies.len()));
        return;
    }
    let mut work = NESTING_WORK;
    for body in bodies.iter().filter(|body| body.open_edges == 0) {
        let around = bodies.iter().find(|outer| outer.open_edges == 0 && contains(outer, body, &mut work));
        match (body.volume < 0.0, around) {
            // A cavity: glass outside, air inside.
            (true, Some(_)) => {}
            (true, None) => {
                report.warn(place(body), "is solid glass turned inside out: flip its faces");
            }
            (false, Some(outer)) => {
                let outer = &parts.surfaces[outer.surface].name;
                let message = format!("is solid glass inside of {outer:?}: its outside is taken for air");
                report.warn(place(body), message);
            }
            (false, None) => {}
        }
    }
}

/// The bodies of one material.
fn collect(parts: &SceneParts, material: usize) -> Vec<Body> {
    // Weld corners by position.
    let mut ids: HashMap<[u32; 3], u32> = HashMap::new();
    let mut triangles = Vec::new();
    for surface in parts.surfaces.iter().filter(|surface| surface.material.index() == material) {
        for triangle in &parts.triangles[surface.triangles.start as usize..surface.triangles.end as usize] {
            let corners = triangle.vertices.map(|v| parts.vertices[v as usize].position + glam::Vec3::ZERO);
            let welded = corners.map(|corner| {
                let next = ids.len() as u32;
                *ids.entry(corner.to_array().map(f32::to_bits)).or_insert(next)
            });
            triangles.push((triangle.surface.index(), welded, corners.map(|corner| corner.as_dvec3())));
        }
    }

    // Join corners that share a triangle; a body has the number of its root.
    let mut joined = Union::new(ids.len());
    for (_, [a, b, c], _) in &triangles {
        joined.join(*a, *b);
        joined.join(*a, *c);
    }

    // Gather the triangles of each body, in order of their first triangle.
    let mut positions: Vec<Option<usize>> = vec![None; ids.len()];
    let mut bodies: Vec<Body> = Vec::new();
    for (surface, [corner, ..], points) in &triangles {
        let root = joined.find(*corner) as usize;
        let position = *positions[root].get_or_insert(bodies.len());
        if position == bodies.len() {
            bodies.push(Body {
                surface: *surface,
                triangles: Vec::new(),
                open_edges: 0,
                volume: 0.0,
                low: points[0],
                high: points[0],
            });
        }
        bodies[position].triangles.push(*points);
    }
    for body in &mut bodies {
        let origin = body.low;
        body.volume = body.triangles.iter().fold(0.0, |sum, points| {
            let [a, b, c] = points.map(|point| point - origin);
            sum + a.dot(b.cross(c))
        });
        for point in body.triangles.iter().flatten() {
            body.low = body.low.min(*point);
            body.high = body.high.max(*point);
        }
    }

    // Closed: each edge is passed as often one way as the other.
    let mut edges: Vec<(u32, u32, i32)> = triangles
        .iter()
        .flat_map(|(_, [a, b, c], _)| [(*a, *b), (*b, *c), (*c, *a)])
        .map(|(a, b)| if a < b { (a, b, 1) } else { (b, a, -1) })
        .collect();
    edges.sort_unstable();
    for same in edges.chunk_by(|x, y| (x.0, x.1) == (y.0, y.1)) {
        if same.iter().map(|edge| edge.2).sum::<i32>() != 0
            && let Some(position) = positions[joined.find(same[0].0) as usize]
        {
            bodies[position].open_edges += 1;
        }
    }
    bodies
}

/// Whether `inner` lies inside of `outer`: its box does, and a ray from one of its corners leaves `outer`
/// an odd number of times.
fn contains(outer: &Body, inner: &Body, work: &mut usize) -> bool {
    let boxed = inner.low.cmpgt(outer.low).all() && inner.high.cmplt(outer.high).all();
    let Some(left) = work.checked_sub(if boxed { outer.triangles.len() } else { 0 }) else { return false };
    *work = left;
    if !boxed {
        return false;
    }
    // A direction along which no modelled edge runs.
    let direction = DVec3::new(0.577_123, 0.311_789, 0.754_907);
    let origin = inner.triangles[0][0];
    let crossings = outer.triangles.iter().filter(|[a, b, c]| {
        // Möller & Trumbore 1997.
        let (edge1, edge2) = (*b - *a, *c - *a);
        let p = direction.cross(edge2);
        let determinant = edge1.dot(p);
        let t = origin - *a;
        let u = t.dot(p) / determinant;
        let q = t.cross(edge1);
        let v = direction.dot(q) / determinant;
        u >= 0.0 && v >= 0.0 && u + v <= 1.0 && edge2.dot(q) / determinant > 0.0
    });
    crossings.count() % 2 == 1
}
