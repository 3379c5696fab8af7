//! Contact lines: where other surfaces touch or cross a face (Baum et al. 1991). Light and shadow end there, so the
//! mesh must too, with vertices of its own on each side. `crossing` has where they cross, `plates` what hangs before a face, `feet` what
//! stands on it.

use std::collections::BTreeMap;

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use catoptric_scene::{Scene, TriangleId};
use catoptric_trace::{BoxTree, Tracer};

use crate::arrangement::{Points, borders};
use crate::face::FaceDraft;

mod crossing;
mod feet;
mod plates;

use crossing::{clip, crossing};
use feet::{Feet, SHORT, by_height, foot, is_leaning};
use plates::{HANGING, SOFT, is_parallel, outwards, plates};

/// A segment in the plane coordinates of a face.
pub type Segment = [DVec2; 2];

/// A contact line.
#[derive(Clone, Copy, Debug)]
pub struct Contact {
    /// Where it lies.
    pub segment: Segment,
    /// Distance of what stands or hangs there from the face, metres: 0 where it touches.
    pub gap: f64,
    /// Light differs on its two sides. Not so behind what hangs higher before the face than a share of its own size: shadow sets in
    /// there, and goes on.
    pub parts: bool,
    /// Where something flat and upright stands on the face, or flat and parallel hangs before it and parts the light: the way from the line
    /// to what it darkens, unit length in the plane of the face times the height of the lowest, metres. Zero elsewhere.
    pub foot: DVec2,
}

impl Contact {
    /// A line on which something touches that does not stand upright.
    fn touching(segment: Segment) -> Self {
        Self { segment, gap: 0.0, parts: true, foot: DVec2::ZERO }
    }
}

/// All triangles of a scene, to be asked which are near a face.
pub struct Obstacles {
    tree: BoxTree,
    reach: f64,
}

/// Distance from a plane that counts as touching, relative to how far the scene reaches, but for what is outlying: f32 positions carry
/// 2⁻²⁴ each, authored contact is often off by a few of them after transforms.
const TOUCH: f64 = 4e-6;

impl Obstacles {
    /// All triangles of the scene.
    pub fn new(tracer: &Tracer) -> Self {
        let scene = tracer.scene();
        let boxes = (0..scene.triangles().len() as u32).map(|t| {
            let [a, b, c] = scene.corners(TriangleId(t));
            [a.min(b).min(c), a.max(b).max(c)]
        });
        Self { tree: BoxTree::new(boxes), reach: tracer.extent().inner.reach() }
    }

    /// Distance that counts as touching, metres.
    pub fn tolerance(&self) -> f64 {
        TOUCH * self.reach
    }

    /// The contact lines on each face, whose triangles are `flats` in its plane coordinates (none of curved faces). The
    /// edges of the mesh are about `spacing` metres long, and about `finest` where things are near.
    ///
    /// A face with more of them than are worth their cost has none, but for the largest such faces.
    pub fn contact_lines(
        &self,
        scene: &Scene,
        faces: &[FaceDraft],
        flats: &[Vec<[DVec2; 3]>],
        spacing: f64,
        finest: f64,
    ) -> Vec<Vec<Contact>> {
        let worth: Vec<usize> = flats.iter().map(|own| worthwhile(area(own), spacing)).collect();
        let find = |index: usize, limit| {
            self.segments(scene, &faces[index], &flats[index], [spacing, finest], limit)
        };
        let mut found: Vec<Option<Vec<Contact>>> =
            (0..faces.len()).into_par_iter().with_max_len(1).map(|index| find(index, worth[index])).collect();
        let mut crowded: Vec<usize> = (0..faces.len()).filter(|&index| found[index].is_none()).collect();
        crowded.sort_by(|&a, &b| area(&flats[b]).total_cmp(&area(&flats[a])).then(a.cmp(&b)));
        crowded.truncate(MAX_CROWDED);
        let more: Vec<Option<Vec<Contact>>> =
            crowded.par_iter().with_max_len(1).map(|&index| find(index, MAX_SEGMENTS)).collect();
        for (index, more) in crowded.into_iter().zip(more) {
            found[index] = more;
        }
        found.into_iter().map(Option::unwrap_or_default).collect()
    }

    /// The contact lines on a face: every triangle that is not its own and touches or crosses it from the face's side, the
    /// outlines of what hangs parallel before it, nearer than a share of the edge length, like pictures and mirrors (what is
    /// behind them is dark, and nobody sees it), and the edges on which something stands just before it, or leans over it. Nothing
    /// where there are more than `limit`; what stands without touching is left out first.
    fn segments(
        &self,
        scene: &Scene,
        face: &FaceDraft,
        own: &[[DVec2; 3]],
        [spacing, finest]: [f64; 2],
        limit: usize,
    ) -> Option<Vec<Contact>> {
        if own.is_empty() {
            return Some(Vec::new());
        }
        let tolerance = self.tolerance();
        let frame = &face.frame;
        // Only what rises on the face's own side casts light or shadow there; coplanar outlines do too.
        let side = match face.side {
            catoptric_scene::Side::Front => 1.0,
            catoptric_scene::Side::Back => -1.0,
        };
        // What is farther away than the face is large hides little of it.
        let gap = (HANGING * spacing).min(extent(own).length());
        let (mut min, mut max) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for corner in face.triangles.iter().flat_map(|&t| scene.corners(t)) {
            let corner = corner.as_dvec3();
            let before = corner + frame.normal * (side * gap);
            min = min.min(corner).min(before);
            max = max.max(corner).max(before);
        }
        let around = [min - tolerance, max + tolerance];
        let height = frame.normal.dot(frame.origin);
        let before = height + side * gap;
        let between = [height.min(before) - tolerance, height.max(before) + tolerance];
        let near = self.tree.overlapping_between(around, frame.normal, between, NEAR * limit)?;
        let mut segments = Distinct::new(tolerance);
        // The two sides of a plate have one outline: apart, or each edge of it would lie between two triangles.
        let mut hanging: [Vec<([DVec2; 3], f64)>; 2] = [Vec::new(), Vec::new()];
        let mut feet = Feet::new(gap, tolerance);
        let short = SHORT * spacing.min(extent(own).length());
        for id in near.into_iter().map(TriangleId) {
            if face.triangles.binary_search(&id).is_ok() {
                continue;
            }
            let corners = scene.corners(id).map(|c| c.as_dvec3());
            let heights = corners.map(|c| frame.height(c));
            let above = heights.map(|h| h * side);
            let projected = corners.map(|c| frame.flat(c));
            feet.push(&corners, &projected, &above, scene.is_smooth(id));
            let rises = above.iter().any(|&h| h > tolerance);
            let flat = heights.iter().all(|h| h.abs() <= tolerance);
            if flat {
                for k in 0..3 {
                    segments.push(Contact::touching([projected[k], projected[(k + 1) % 3]]));
                }
            } else if rises && is_parallel(&corners, &heights, gap, tolerance, side) {
                let [a, b, c] = projected;
                let turned = usize::from((b - a).perp_dot(c - a) < 0.0);
                hanging[turned].push((projected, above.into_iter().fold(f64::INFINITY, f64::min)));
            } else if rises && let Some(segment) = crossing(&corners, &heights, tolerance) {
                let touching = Contact::touching(segment.map(|p| frame.flat(p)));
                let foot = if scene.is_smooth(id) { DVec2::ZERO } else { foot(&corners, frame, side) };
                segments.push(Contact { foot, ..touching });
            }
        }
        for plate in hanging.iter().flat_map(|triangles| plates(triangles, tolerance)) {
            let size = area(&plate.triangles).sqrt();
            let parts = plate.height < (SOFT * size).max(finest);
            for (segment, inside) in borders(&plate.triangles, tolerance) {
                let foot = if parts { outwards(segment, inside) * plate.height } else { DVec2::ZERO };
                segments.push(Contact { gap: plate.height, parts, foot, ..Contact::touching(segment) });
            }
        }
        let touching = segments.list.len();
        let edges = feet.find();
        let above = |edge: &[DVec3; 2]| edge.map(|p| frame.height(p) * side);
        for edge in edges.standing {
            let gap = above(&edge).into_iter().fold(0.0, f64::max);
            let parts = gap < short;
            let segment = edge.map(|p| frame.flat(p));
            // What is higher than long is seen past.
            if parts || gap <= segment[0].distance(segment[1]) {
                segments.push(Contact { gap, parts, ..Contact::touching(segment) });
            }
        }
        for edge in edges.outlines {
            let (heights, ends) = (above(&edge), edge.map(|p| frame.flat(p)));
            if is_leaning(heights, ends[0].distance(ends[1]), tolerance) {
                for ([from, to], gap) in by_height(heights, [short, gap]) {
                    let segment = [from, to].map(|t| ends[0].lerp(ends[1], t));
                    segments.push(Contact { gap, parts: false, ..Contact::touching(segment) });
                }
            }
        }
        // What lies on the face, piece by piece.
        let level = |p: DVec2| p.extend(0.0);
        let pieces = BoxTree::new(
            own.iter().map(|[a, b, c]| [a.min(*b).min(*c), a.max(*b).max(*c)].map(|p| level(p).as_vec3())),
        );
        let mut clipped = Distinct::new(tolerance);
        let mut sure = 0;
        for (index, contact) in segments.list.iter().enumerate() {
            let [a, b] = contact.segment;
            for piece in pieces.overlapping(level(a.min(b)) - tolerance, level(a.max(b)) + tolerance) {
                if let Some(part) = clip(&contact.segment, &own[piece as usize], tolerance) {
                    clipped.push(Contact { segment: part, ..*contact });
                }
            }
            let is_crowded = clipped.list.len() > limit;
            if index < touching {
                if is_crowded {
                    return None;
                }
                sure = clipped.list.len();
            } else if is_crowded {
                // What only nearly touches gives way to what does.
                clipped.list.truncate(sure);
                break;
            }
        }
        Some(clipped.list)
    }

    /// Triangles whose boxes overlap that of a triangle of a curved mesh. Nothing where there are too many.
    pub(crate) fn near(
        &self,
        corners: &[DVec3; 3],
        flat: &[DVec2; 3],
        spacing: f64,
    ) -> Option<Vec<TriangleId>> {
        let [a, b, c] = *corners;
        let (min, max) = (a.min(b).min(c) - self.tolerance(), a.max(b).max(c) + self.tolerance());
        let most = NEAR * worthwhile(area(&[*flat]), spacing);
        Some(self.tree.overlapping_at_most(min, max, most)?.into_iter().map(TriangleId).collect())
    }

    /// What a triangle whose corners have these heights crosses of a face that is the triangle `flat` in its plane.
    pub(crate) fn crossing_inside(
        &self,
        corners: &[DVec3; 3],
        heights: &[f64; 3],
        face: &FaceDraft,
        flat: &[DVec2; 3],
    ) -> Option<Segment> {
        let segment = crossing(corners, heights, self.tolerance())?;
        clip(&segment.map(|p| face.frame.flat(p)), flat, self.tolerance())
    }
}

/// The gap at each point that lies on contact lines that part the light, the smallest of theirs; elsewhere 0.
pub(crate) fn gaps_at(points: &[DVec2], contacts: &[Contact], tolerance: f64) -> Vec<f64> {
    if contacts.iter().all(|c| !c.parts || c.gap == 0.0) {
        return vec![0.0; points.len()];
    }
    let level = |p: DVec2| p.extend(0.0);
    let tree = BoxTree::new(contacts.iter().map(|c| {
        let [a, b] = c.segment;
        [a.min(b), a.max(b)].map(|p| level(p).as_vec3())
    }));
    let distance = |p: DVec2, [a, b]: Segment| {
        let along = b - a;
        let t = ((p - a).dot(along) / along.length_squared()).clamp(0.0, 1.0);
        (a + along * t - p).length()
    };
    let gap = |&p: &DVec2| {
        let near = tree.overlapping(level(p) - 2.0 * tolerance, level(p) + 2.0 * tolerance);
        let own = near
            .into_iter()
            .map(|i| contacts[i as usize])
            .filter(|c| c.parts && distance(p, c.segment) <= 2.0 * tolerance);
        let least = own.map(|c| c.gap).fold(f64::INFINITY, f64::min);
        if least.is_finite() { least } else { 0.0 }
    };
    points.iter().map(gap).collect()
}

/// Contact lines on a face for each square of the edge length that it covers, and one more, at most.
const SEGMENTS_PER_SQUARE: f64 = 100.0;
/// Faces that may have more, at most.
const MAX_CROWDED: usize = 100;
/// Contact lines that those may have, at most: the arrangement looks at each pair.
const MAX_SEGMENTS: usize = 3000;
/// Triangles near a face for each contact line that it may have, at most.
const NEAR: usize = 16;

/// How many contact lines a face is worth. Where it covers n squares of the edge length it has about 2n triangles, and
/// many times as many contact lines are finer than the mesh shows. As the sum of n over all faces is what the mesh was
/// asked for, the work is proportional to the number of faces at most, whatever lies on whatever.
fn worthwhile(area: f64, spacing: f64) -> usize {
    (SEGMENTS_PER_SQUARE * (1.0 + area / (spacing * spacing))).min(MAX_SEGMENTS as f64) as usize
}

/// Area of triangles, m².
fn area(triangles: &[[DVec2; 3]]) -> f64 {
    triangles.iter().map(|[a, b, c]| 0.5 * (*b - *a).perp_dot(*c - *a).abs()).sum()
}

/// Size of the box around triangles.
fn extent(triangles: &[[DVec2; 3]]) -> DVec2 {
    let (mut min, mut max) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
    for p in triangles.iter().flatten() {
        min = min.min(*p);
        max = max.max(*p);
    }
    max - min
}

/// Contact lines, each segment once: soups hold the same triangle many times.
struct Distinct {
    points: Points,
    known: BTreeMap<(u32, u32), usize>,
    list: Vec<Contact>,
}

impl Distinct {
    fn new(tolerance: f64) -> Self {
        Self { points: Points::new(tolerance), known: BTreeMap::new(), list: Vec::new() }
    }

    /// Adds a segment, or lowers the gap, and the height, of the one that is there.
    fn push(&mut self, contact: Contact) {
        let [a, b] = contact.segment.map(|p| self.points.id(p));
        if a == b {
            return;
        }
        let index = *self.known.entry((a.min(b), a.max(b))).or_insert(self.list.len());
        match self.list.get_mut(index) {
            Some(known) => {
                known.gap = known.gap.min(contact.gap);
                known.parts |= contact.parts;
                let lower = contact.foot.length_squared() < known.foot.length_squared();
                if contact.foot != DVec2::ZERO && (known.foot == DVec2::ZERO || lower) {
                    known.foot = contact.foot;
                }
            }
            None => self.list.push(contact),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use catoptric_scene::{Material, Rgb, SceneParts, Side};
    use catoptric_trace::Tracer;
    use glam::Vec3;

    use crate::face::faces;

    /// Contact lines on the floor below what `build` puts before it.
    fn on_floor(build: impl Fn(&mut SceneParts, catoptric_scene::MaterialId)) -> Vec<Contact> {
        let mut parts = SceneParts::default();
        let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
        parts.add_quad("floor", white, Vec3::ZERO, Vec3::Z * 4.0, Vec3::X * 4.0);
        build(&mut parts, white);
        let scene = Scene::new(parts).expect("a valid scene");
        let tracer = Tracer::new(&scene);
        let drafts = faces(&tracer);
        let flats: Vec<Vec<[DVec2; 3]>> = drafts
            .iter()
            .map(|face| {
                let own: &[TriangleId] = if face.curved { &[] } else { &face.triangles };
                let flat = |t: &TriangleId| scene.corners(*t).map(|c| face.frame.flat(c.as_dvec3()));
                own.iter().map(flat).collect()
            })
            .collect();
        let lines = Obstacles::new(&tracer).contact_lines(&scene, &drafts, &flats, 1.0, 0.005);
        let floor = drafts
            .iter()
            .position(|f| f.side == Side::Front && f.triangles.contains(&TriangleId(0)))
            .expect("the floor has a front");
        lines[floor].clone()
    }

    /// Mean of the middles of lines.
    fn middle(lines: &[Contact]) -> DVec2 {
        lines.iter().map(|c| 0.5 * (c.segment[0] + c.segment[1])).sum::<DVec2>() / lines.len() as f64
    }

    /// Behind a plate just before a wall nobody looks; below a ball, of which each facet is nearly level beside the gap, one
    /// does.
    #[test]
    fn plates_hang_and_balls_do_not() {
        let plate = |p: &mut SceneParts, m| {
            p.add_box("plate", m, Vec3::new(1.0, 0.01, 1.0), Vec3::new(2.0, 0.05, 2.0), false);
        };
        // Each side lies on two triangles of the floor at most.
        let lines = on_floor(plate);
        assert!((4..=8).contains(&lines.len()), "{lines:?}");
        assert!(lines.iter().all(|c| (c.gap - 0.01).abs() < 1e-6), "{lines:?}");
        // What it darkens is outside of it, as far as it hangs.
        for Contact { segment: [a, b], foot, .. } in &lines {
            let outwards = 0.5 * (*a + *b) - middle(&lines);
            assert!(foot.dot(*b - *a).abs() < 1e-6 && foot.dot(outwards) > 0.0, "{lines:?}");
            assert!((foot.length() - 0.01).abs() < 1e-6, "{lines:?}");
        }
        let ball = |p: &mut SceneParts, m| p.add_sphere("ball", m, Vec3::new(2.0, 0.301, 2.0), 0.3, 24);
        assert!(on_floor(ball).is_empty());
    }

    /// A box that stands on the floor darkens what its sides face; what leans on it like a roof does not stand, nor do the facets of a
    /// ball.
    #[test]
    fn what_stands_upright_has_a_foot() {
        let height = 0.04_f32;
        let lines = on_floor(|p, m| {
            p.add_box("box", m, Vec3::new(1.0, 0.0, 1.0), Vec3::new(2.0, height, 3.0), false);
        });
        let standing: Vec<&Contact> = lines.iter().filter(|c| c.foot != DVec2::ZERO).collect();
        assert!(!standing.is_empty());
        let center = middle(&lines);
        for contact in standing {
            assert!((contact.foot.length() - f64::from(height)).abs() < 1e-6, "{contact:?}");
            // Away from the box, square to its side.
            let [a, b] = contact.segment;
            assert!(contact.foot.dot(b - a).abs() < 1e-6, "{contact:?}");
            assert!(contact.foot.dot(0.5 * (a + b) - center) > 0.0, "{contact:?} from {center}");
        }
        let roof = on_floor(|p, m| {
            p.add_quad("roof", m, Vec3::new(1.0, 0.0, 1.0), Vec3::Z, Vec3::new(1.0, 1.0, 0.0));
        });
        assert!(!roof.is_empty() && roof.iter().all(|c| c.foot == DVec2::ZERO), "{roof:?}");
        let ball = on_floor(|p, m| p.add_sphere("ball", m, Vec3::new(2.0, 0.1, 2.0), 0.3, 24));
        assert!(ball.iter().all(|c| c.foot == DVec2::ZERO), "{ball:?}");
    }

    /// 2 cm before the floor, a plate of a metre parts the light; one of 12 cm is seen past, and the dark behind it comes and goes.
    #[test]
    fn what_hangs_high_for_its_size_parts_nothing() {
        let plate = |size: f32| {
            let lines = on_floor(move |p, m| {
                p.add_quad("plate", m, Vec3::new(1.0, 0.02, 1.0), Vec3::X * size, Vec3::Z * size);
            });
            assert!((4..=8).contains(&lines.len()), "{lines:?}");
            lines
        };
        assert!(plate(1.0).iter().all(|c| c.parts));
        assert!(plate(0.12).iter().all(|c| !c.parts));
    }

    /// A card whose edge is just above the floor parts what is before it from what is behind it, as one that touches does, be it
    /// upright or nearly level; one at the height of a hand leaves a line that parts nothing, and a higher one none. The foot of a tube
    /// is one line, however finely its wall is divided.
    #[test]
    fn what_ends_just_above_a_face_stands_on_it() {
        for rise in [Vec3::new(0.4, 1.0, 0.0), Vec3::new(1.0, 0.1, 0.0)] {
            // Those along the edge: the outlines of what leans part nothing.
            let card = |height: f32| {
                let mut lines = on_floor(move |p, m| {
                    p.add_quad("card", m, Vec3::new(1.0, height, 1.0), rise, Vec3::Z);
                });
                lines.retain(|c| c.segment.iter().all(|p| (p.x - 1.0).abs() < 1e-6));
                assert!(lines.iter().all(|c| (c.gap - f64::from(height)).abs() < 1e-6), "{lines:?}");
                lines
            };
            // The line crosses the floor's diagonal at most once.
            let touching = card(0.0);
            assert!((1..=2).contains(&touching.len()), "{touching:?}");
            for (height, parts) in [(0.004, true), (0.1, false)] {
                let lines = card(height);
                assert!(lines.iter().all(|c| c.parts == parts), "{lines:?}");
                assert_eq!(lines.len(), touching.len(), "{height}");
            }
            assert!(card(0.21).is_empty());
        }
        let tube = |rings: u16| {
            on_floor(move |p, m| {
                for ring in 0..rings {
                    let (low, rise) =
                        (0.002 + 0.04 * f32::from(ring) / f32::from(rings), 0.04 / f32::from(rings));
                    let corners =
                        [Vec3::X, Vec3::Z, -Vec3::X, -Vec3::Z].map(|p| Vec3::new(3.0, low, 1.0) + 0.5 * p);
                    for k in 0..4 {
                        let next = corners[(k + 1) % 4];
                        p.add_quad("tube", m, corners[k], next - corners[k], Vec3::Y * rise);
                    }
                }
            })
            .len()
        };
        let one = tube(1);
        assert!((4..=8).contains(&one), "{one}");
        assert_eq!(tube(7), one);
    }

    /// A sheet that lies on one edge: light below it is a matter of how high it is there, along both sides of it.
    #[test]
    fn what_leans_is_outlined_by_its_height() {
        for is_thick in [false, true] {
            let lines = on_floor(move |p, m| {
                let (foot, rise, width) = (Vec3::new(1.0, 0.0, 1.0), Vec3::new(1.0, 0.25, 0.0), Vec3::Z);
                p.add_quad("lower", m, foot, rise, width);
                if is_thick {
                    let top = foot + Vec3::Y * 0.02;
                    p.add_quad("upper", m, top, width, rise);
                    p.add_quad("left", m, foot, Vec3::Y * 0.02, rise);
                    p.add_quad("right", m, foot + width, rise, Vec3::Y * 0.02);
                }
            });
            let outlines: Vec<&Contact> = lines.iter().filter(|c| !c.parts).collect();
            // From where it is 5 cm high to where it is 20, on both sides, by doublings.
            let along: f64 = outlines.iter().map(|c| (c.segment[1] - c.segment[0]).length()).sum();
            assert!((along - 2.0 * 0.6).abs() < 1e-6, "{along}: {lines:?}");
            for contact in outlines {
                let ends = contact.segment.map(|p| 0.25 * (p.x - 1.0));
                let (low, high) = (ends[0].min(ends[1]), ends[0].max(ends[1]));
                assert!(high <= contact.gap + 1e-6 && contact.gap <= 2.0 * low + 1e-6, "{contact:?}");
            }
        }
    }

    #[test]
    fn points_on_contact_lines_know_the_smallest_gap() {
        let line =
            |y: f64, gap| Contact { gap, ..Contact::touching([DVec2::new(0.0, y), DVec2::new(1.0, y)]) };
        let upright =
            Contact { gap: 0.02, ..Contact::touching([DVec2::new(1.0, 0.0), DVec2::new(1.0, 1.0)]) };
        // What parts nothing has no say.
        let soft = Contact { gap: 0.001, parts: false, ..line(0.0, 0.0) };
        let contacts = [line(0.0, 0.01), line(1.0, 0.0), upright, soft];
        let points = [[0.5, 0.0], [0.5, 0.5], [1.0, 0.0], [1.0, 0.5], [1.0, 1.0]].map(DVec2::from);
        assert_eq!(gaps_at(&points, &contacts, 1e-6), [0.01, 0.0, 0.01, 0.02, 0.0]);
    }
}
