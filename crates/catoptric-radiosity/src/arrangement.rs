//! Segments in a plane become an arrangement: split where they meet, cut to length, with points that lie close to each other welded; long
//! edges beside much shorter ones are halved (Ruppert 1995). Key in docs/references.md: Ruppert1995.

use glam::DVec2;

use crate::contact::Segment;

/// Points where segments meet, for each of them, at most: finer than any mesh shows.
const MEETINGS_PER_SEGMENT: usize = 30;
/// Edges of outlines are halved for the sake of lines that are shorter than this share of their halves: only such make fans. At a
/// quarter, a bookcase gets a tenth more triangles, which show nothing.
const MUCH_SHORTER: f64 = 0.1;

/// Triangles without those that have the same corners as one before: an outline does not see what lies twice.
pub(crate) fn distinct(mut triangles: Vec<[DVec2; 3]>, tolerance: f64) -> Vec<[DVec2; 3]> {
    let mut points = Points::new(tolerance);
    let mut known = std::collections::BTreeSet::new();
    triangles.retain(|triangle| {
        let mut ids = triangle.map(|p| points.id(p));
        ids.sort_unstable();
        known.insert(ids)
    });
    triangles
}

/// Edges that only one of some triangles has.
pub(crate) fn outline(triangles: &[[DVec2; 3]], tolerance: f64) -> Vec<Segment> {
    borders(triangles, tolerance).into_iter().map(|(segment, _)| segment).collect()
}

/// The same, each with the third corner of its triangle.
pub(crate) fn borders(triangles: &[[DVec2; 3]], tolerance: f64) -> Vec<(Segment, DVec2)> {
    let mut points = Points::new(tolerance);
    let mut count: std::collections::BTreeMap<(u32, u32), (u32, u32)> = std::collections::BTreeMap::new();
    for triangle in triangles {
        let ids = triangle.map(|p| points.id(p));
        for k in 0..3 {
            let [a, b, c] = [0, 1, 2].map(|i| ids[(k + i) % 3]);
            if a != b {
                count.entry((a.min(b), a.max(b))).or_insert((0, c)).0 += 1;
            }
        }
    }
    let point = |id: u32| points.list[id as usize];
    let once = count.into_iter().filter(|&(_, (triangles, _))| triangles == 1);
    once.map(|((a, b), (_, third))| ([a, b].map(point), point(third))).collect()
}

/// Points, welded by distance.
pub(crate) struct Points {
    list: Vec<DVec2>,
    cells: std::collections::HashMap<(i64, i64), Vec<u32>>,
    tolerance: f64,
}

impl Points {
    /// How many there are.
    pub(crate) fn len(&self) -> usize {
        self.list.len()
    }

    pub(crate) fn new(tolerance: f64) -> Self {
        Self { list: Vec::new(), cells: std::collections::HashMap::new(), tolerance }
    }

    pub(crate) fn id(&mut self, point: DVec2) -> u32 {
        let size = 2.0 * self.tolerance;
        let cell_of = |p: DVec2| ((p.x / size).floor() as i64, (p.y / size).floor() as i64);
        let (low, cell, high) =
            (cell_of(point - self.tolerance), cell_of(point), cell_of(point + self.tolerance));
        for y in low.1..=high.1 {
            for x in low.0..=high.0 {
                for &id in self.cells.get(&(x, y)).map_or(&[][..], Vec::as_slice) {
                    if (self.list[id as usize] - point).length() <= self.tolerance {
                        return id;
                    }
                }
            }
        }
        let id = self.list.len() as u32;
        self.list.push(point);
        self.cells.entry(cell).or_default().push(id);
        id
    }
}

/// An edge of the arrangement.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ArrangedEdge {
    pub(crate) ends: [u32; 2],
    pub(crate) contact: bool,
}

/// Outline and contact lines, split wherever they meet or touch, and cut to length.
pub(crate) struct Arrangement {
    pub(crate) points: Vec<DVec2>,
    pub(crate) edges: Vec<ArrangedEdge>,
}

impl Arrangement {
    /// Nothing where they meet too often.
    pub(crate) fn new(
        outline: &[Segment],
        contacts: &[Segment],
        spacing: f64,
        tolerance: f64,
    ) -> Option<Self> {
        let mut points = Points::new(tolerance);
        let segments: Vec<(Segment, bool)> =
            outline.iter().map(|s| (*s, false)).chain(contacts.iter().map(|s| (*s, true))).collect();
        // Parameters at which each segment is split.
        let mut splits: Vec<Vec<f64>> = segments.iter().map(|_| vec![0.0, 1.0]).collect();
        let mut meetings = 0;
        for i in 0..segments.len() {
            for j in i + 1..segments.len() {
                meetings += usize::from(meet(&segments, i, j, tolerance, &mut splits));
            }
            if meetings > MEETINGS_PER_SEGMENT * segments.len() {
                return None;
            }
        }
        let mut known = std::collections::BTreeMap::new();
        for ((segment, contact), splits) in segments.iter().zip(&mut splits) {
            splits.sort_by(f64::total_cmp);
            let [a, b] = *segment;
            let mut previous = points.id(a);
            for &t in splits.iter().skip(1) {
                let next = points.id(a.lerp(b, t));
                if next == previous {
                    continue;
                }
                let (from, to) = (points.list[previous as usize], points.list[next as usize]);
                let parts = ((to - from).length() / spacing).ceil().max(1.0) as u32;
                for part in 1..=parts {
                    let end = if part == parts {
                        next
                    } else {
                        points.id(from.lerp(to, f64::from(part) / f64::from(parts)))
                    };
                    if end != previous {
                        // The same edge twice: contact wins.
                        let key = (previous.min(end), previous.max(end));
                        *known.entry(key).or_insert(false) |= *contact;
                    }
                    previous = end;
                }
            }
        }
        let edges =
            known.into_iter().map(|((a, b), contact)| ArrangedEdge { ends: [a, b], contact }).collect();
        Some(Self { points: points.list, edges })
    }

    /// Halves edges in whose diametral circles points of much shorter ones lie (Ruppert 1995): no point that would make good triangles can
    /// be added there, and short lines would reach for the ends of the long one in fans.
    pub(crate) fn halve_encroached(&mut self) {
        let length = |points: &[DVec2], ends: [u32; 2]| {
            let [a, b] = ends.map(|end| points[end as usize]);
            (b - a).length()
        };
        // Length of the shortest edge at each point, and the points at the other ends.
        let mut shortest = vec![f64::INFINITY; self.points.len()];
        let mut beside: Vec<Vec<u32>> = vec![Vec::new(); self.points.len()];
        for edge in &self.edges {
            let own = length(&self.points, edge.ends);
            for (this, other) in [(0, 1), (1, 0)] {
                let [this, other] = [edge.ends[this], edge.ends[other]];
                shortest[this as usize] = shortest[this as usize].min(own);
                beside[this as usize].push(other);
            }
        }
        let mut by_length: Vec<u32> = (0..self.points.len() as u32).collect();
        by_length.sort_by(|&p, &q| shortest[p as usize].total_cmp(&shortest[q as usize]));
        let mut index = 0;
        while let Some(&ArrangedEdge { ends, contact }) = self.edges.get(index) {
            let radius = 0.5 * length(&self.points, ends);
            let middle = 0.5 * (self.points[ends[0] as usize] + self.points[ends[1] as usize]);
            // Lines that meet at a sharp angle would halve each other for ever.
            let meets = |p: u32| {
                ends.iter().any(|&end| end == p || beside.get(end as usize).is_some_and(|b| b.contains(&p)))
            };
            let encroaches =
                |p: u32| (self.points[p as usize] - middle).length_squared() < radius * radius && !meets(p);
            let mut shorter = by_length.iter().take_while(|&&p| shortest[p as usize] < MUCH_SHORTER * radius);
            if shorter.any(|&p| encroaches(p)) {
                let new = self.points.len() as u32;
                self.points.push(middle);
                self.edges[index] = ArrangedEdge { ends: [ends[0], new], contact };
                self.edges.push(ArrangedEdge { ends: [new, ends[1]], contact });
            } else {
                index += 1;
            }
        }
    }
}

/// Splits two segments where they cross, and each where an end of the other lies on it; says whether they meet.
fn meet(segments: &[(Segment, bool)], i: usize, j: usize, tolerance: f64, splits: &mut [Vec<f64>]) -> bool {
    let ([a, b], [c, d]) = (segments[i].0, segments[j].0);
    let apart = a.max(b).cmplt(c.min(d) - tolerance).any() || c.max(d).cmplt(a.min(b) - tolerance).any();
    if apart {
        return false;
    }
    let on = |p: DVec2, from: DVec2, to: DVec2| {
        let edge = to - from;
        let t = edge.dot(p - from) / edge.length_squared();
        let near = (0.0..=1.0).contains(&t) && (from + edge * t - p).length() <= tolerance;
        near.then_some(t)
    };
    let mut touches = false;
    for (p, from, to, which) in [(c, a, b, i), (d, a, b, i), (a, c, d, j), (b, c, d, j)] {
        if let Some(t) = on(p, from, to) {
            splits[which].push(t);
            touches = true;
        }
    }
    if touches {
        return true;
    }
    let (e, f) = (b - a, d - c);
    let denominator = e.perp_dot(f);
    if denominator == 0.0 {
        return false;
    }
    let t = (c - a).perp_dot(f) / denominator;
    let s = (c - a).perp_dot(e) / denominator;
    let cross = (0.0..=1.0).contains(&t) && (0.0..=1.0).contains(&s);
    if cross {
        splits[i].push(t);
        splits[j].push(s);
    }
    cross
}
