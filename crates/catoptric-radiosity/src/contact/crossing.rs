//! Where a triangle crosses the plane of a face, and what of a line lies on the face.

use glam::{DVec2, DVec3};

use super::Segment;

/// Where a triangle meets the plane of height zero.
pub(super) fn crossing(corners: &[DVec3; 3], heights: &[f64; 3], tolerance: f64) -> Option<[DVec3; 2]> {
    let mut points: [DVec3; 4] = [DVec3::ZERO; 4];
    let mut count = 0;
    let mut push = |p: DVec3| {
        if count < points.len() {
            points[count] = p;
            count += 1;
        }
    };
    for k in 0..3 {
        if heights[k].abs() <= tolerance {
            push(corners[k]);
        }
        let next = (k + 1) % 3;
        let (a, b) = (heights[k], heights[next]);
        if (a > tolerance && b < -tolerance) || (a < -tolerance && b > tolerance) {
            push(corners[k].lerp(corners[next], a / (a - b)));
        }
    }
    if count < 2 {
        return None;
    }
    let pair = [points[0], points[1]];
    ((pair[1] - pair[0]).length() > 4.0 * tolerance).then_some(pair)
}

/// The part of a segment inside a triangle of plane coordinates.
pub(super) fn clip(segment: &Segment, triangle: &[DVec2; 3], tolerance: f64) -> Option<Segment> {
    let [mut a, mut b] = *segment;
    let turn = (triangle[1] - triangle[0]).perp_dot(triangle[2] - triangle[0]).signum();
    for k in 0..3 {
        let (p, q) = (triangle[k], triangle[(k + 1) % 3]);
        let edge = (q - p).normalize_or_zero() * turn;
        let (da, db) = (edge.perp_dot(a - p), edge.perp_dot(b - p));
        // Lines along the triangle's own border stay.
        let (ia, ib) = (da >= -tolerance, db >= -tolerance);
        match (ia, ib) {
            (false, false) => return None,
            (true, true) => {}
            (true, false) => b = a.lerp(b, (da / (da - db)).clamp(0.0, 1.0)),
            (false, true) => a = b.lerp(a, (db / (db - da)).clamp(0.0, 1.0)),
        }
    }
    ((b - a).length() > 4.0 * tolerance).then_some([a, b])
}
