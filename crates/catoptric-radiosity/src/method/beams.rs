//! Beams of images on their way from mirror to mirror; those that show one image through windows beside each other are one.
//!
//! In a duct of four mirrors the image m walls to one side and n walls up is reached by every order of m and n reflections, each
//! with a window of its own, cut by the lines of sight over the corners between: (m + n)/2 windows on average. Together they are the
//! whole of the last mirror. As one they are as many beams as there are images; apart, R³ within R reflections instead of R².

use std::collections::BTreeMap;

use catoptric_light::contour::{MAX_CORNERS, Polygon};
use glam::DVec3;

/// What a mirror shows of the image of an eye.
#[derive(Clone, Debug)]
pub(super) struct Beam {
    /// The last mirror.
    pub(super) mirror: usize,
    /// Image of the eye in all mirrors, and of its normal.
    pub(super) eye: DVec3,
    pub(super) normal: DVec3,
    /// Product of the reflectances.
    pub(super) weight: DVec3,
    /// The part of the mirror that shows it.
    pub(super) window: Polygon,
    /// F(eye → window).
    pub(super) factor: f64,
}

impl Beam {
    /// Whether it differs by nothing but its window and by rounding.
    fn is_beside(&self, other: &Beam) -> bool {
        let (far, bright) = (1.0 + self.eye.length(), self.weight.max_element());
        (self.eye - other.eye).length() < SAME * far
            && (self.normal - other.normal).length() < SAME
            && (self.weight - other.weight).abs().max_element() < SAME * bright
    }
}

/// The beams after a number of reflections.
pub(super) struct Beams {
    /// Those that went into others have nothing left.
    beams: Vec<Beam>,
    /// By mirror and place of the image. An image on the border of two places may stay apart: that costs time and nothing else.
    groups: BTreeMap<(usize, [i64; 3]), Vec<usize>>,
    place: f64,
}

impl Beams {
    /// None yet, in a scene of some diagonal.
    pub(super) fn new(diagonal: f64) -> Self {
        Self { beams: Vec::new(), groups: BTreeMap::new(), place: 1e-6 * diagonal }
    }

    /// Adds a beam, together with all that it makes one with.
    pub(super) fn add(&mut self, mut beam: Beam) {
        let place = (beam.eye / self.place).round();
        let key = (beam.mirror, [place.x as i64, place.y as i64, place.z as i64]);
        let (beams, group) = (&mut self.beams, self.groups.entry(key).or_default());
        loop {
            let united = group.iter().enumerate().find_map(|(place, &index)| {
                let other = &beams[index];
                let window = other.is_beside(&beam).then(|| union(&other.window, &beam.window))?;
                Some((place, index, window?))
            });
            let Some((place, index, window)) = united else { break };
            beam.window = window;
            beam.factor += std::mem::take(&mut beams[index].factor);
            group.swap_remove(place);
        }
        group.push(beams.len());
        beams.push(beam);
    }

    /// All that have something left.
    pub(super) fn finished(mut self) -> Vec<Beam> {
        self.beams.retain(|beam| beam.factor > 0.0);
        self.beams
    }
}

/// The union of two convex polygons of one plane that share an edge, if it is convex.
fn union(a: &Polygon, b: &Polygon) -> Option<Polygon> {
    let (p, q) = (a.corners(), b.corners());
    let size = p.iter().map(|c| (*c - p[0]).length()).fold(0.0, f64::max);
    let near = |x: DVec3, y: DVec3| (x - y).length_squared() <= SHORT * SHORT * size * size;
    let (n, m) = (p.len(), q.len());
    for i in 0..n {
        for j in 0..m {
            if near(p[i], q[(j + 1) % m]) && near(p[(i + 1) % n], q[j]) {
                // Round a from the edge's end to its start, then on round b.
                let ours = (1..=n).map(|k| p[(i + k) % n]);
                let theirs = (2..m).map(|k| q[(j + k) % m]);
                return convex(ours.chain(theirs).collect());
            }
        }
    }
    None
}

/// A polygon without corners that do not turn; none if one turns back.
fn convex(mut corners: Vec<DVec3>) -> Option<Polygon> {
    let normal = {
        let first = corners[0];
        corners.windows(2).map(|w| (w[0] - first).cross(w[1] - first)).sum::<DVec3>().try_normalize()?
    };
    let mut index = 0;
    while index < corners.len() && corners.len() > 3 {
        let count = corners.len();
        let (before, here) = (corners[(index + count - 1) % count], corners[index]);
        let (back, on) = (here - before, corners[(index + 1) % count] - here);
        let turn = back.cross(on).dot(normal) / (back.length() * on.length()).max(f64::MIN_POSITIVE);
        if turn < -SHORT {
            return None;
        }
        if turn < SHORT {
            corners.remove(index);
        } else {
            index += 1;
        }
    }
    (corners.len() <= MAX_CORNERS).then(|| Polygon::new(&corners))
}

/// A window without the edges that repeated clipping leaves at corners: through an edge as short as rounding there is no
/// plane to clip by.
pub(super) fn without_short_edges(window: &Polygon) -> Polygon {
    let corners = window.corners();
    let size = corners.iter().map(|c| (*c - corners[0]).length()).fold(0.0, f64::max);
    let short = |k: usize| (corners[k] - corners[(k + 1) % corners.len()]).length() <= SHORT * size;
    if !(0..corners.len()).any(short) {
        return *window;
    }
    let mut kept: Vec<DVec3> = Vec::with_capacity(corners.len());
    for &corner in corners {
        if kept.last().is_none_or(|last| (corner - *last).length() > SHORT * size) {
            kept.push(corner);
        }
    }
    while kept.len() > 1 && (kept[0] - kept[kept.len() - 1]).length() <= SHORT * size {
        kept.pop();
    }
    Polygon::new(&kept)
}

/// Edges shorter than this share of a window are rounding, and so are turns by less than this angle.
const SHORT: f64 = 1e-9;

/// Images nearer to each other than this, relative to their distance, are one.
const SAME: f64 = 1e-10;

#[cfg(test)]
mod tests {
    use super::*;

    /// A quadrilateral in the plane z = 2.
    fn window(corners: [(f64, f64); 4]) -> Polygon {
        Polygon::new(&corners.map(|(x, y)| DVec3::new(x, y, 2.0)))
    }

    fn beam(window: Polygon) -> Beam {
        let (eye, normal, weight) = (DVec3::new(0.3, -4.0, 0.0), DVec3::Z, DVec3::splat(0.9));
        Beam { mirror: 1, eye, normal, weight, window, factor: 0.25 }
    }

    #[test]
    fn windows_cut_by_lines_of_sight_become_the_mirror_again() {
        let mut beams = Beams::new(1.0);
        // The middle comes last: it joins both.
        for (from, to) in [(0.0, 0.2), (0.7, 1.0), (0.2, 0.7)] {
            beams.add(beam(window([(from, 0.0), (to, 0.0), (to, 3.0), (from, 3.0)])));
        }
        let beams = beams.finished();
        assert_eq!(beams.len(), 1);
        assert_eq!(beams[0].factor, 0.75);
        assert_eq!(beams[0].window.corners().len(), 4, "corners on the seams are gone");
        assert!((beams[0].window.vector_area().length() - 3.0).abs() < 1e-15);
    }

    #[test]
    fn what_is_not_convex_or_of_another_image_stays_apart() {
        let low = window([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]);
        let narrow = window([(0.0, 1.0), (1.0, 1.0), (2.0, 2.0), (0.0, 2.0)]);
        let beside = window([(1.0, 0.0), (2.0, 0.0), (2.0, 1.0), (1.0, 1.0)]);
        let mut beams = Beams::new(1.0);
        beams.add(beam(low));
        beams.add(beam(narrow));
        beams.add(Beam { weight: DVec3::splat(0.8), ..beam(beside) });
        beams.add(Beam { mirror: 2, ..beam(beside) });
        assert_eq!(beams.finished().len(), 4);
    }
}
