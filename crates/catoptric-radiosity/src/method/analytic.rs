//! Lambert's contour formula from the points of an adaptive Gauss quadrature over the sender, everything between
//! clipped exactly: the horizon, the outlines of blockers, the frames of planar mirrors (beams of images, any number).
//!
//! F_ij = 1/A_i ∫_{A_i} F(x → j) dx with F(x → j) by the contour formula (Baum, Rushmeier & Winget 1989, who integrate
//! over x numerically, too). The contour formula has no singularity at shared edges and corners: F(x → j) is bounded by
//! 1 and the quadrature subdivides towards them. Curved mirrors, coats, panes and glass are no images: paths over any
//! of them are found by hemisphere rays and added.

use std::cmp::Ordering;
use std::collections::BinaryHeap;
use std::f64::consts::PI;

use glam::DVec3;

use catoptric_light::contour::{MAX_CORNERS, Polygon, irradiance};
use catoptric_scene::{AlphaMode, Barycentric, Side, TriangleId};
use catoptric_trace::{PlaneId, Tracer};

use super::elements::joined;
use super::visible::{Blocker, Scratch, subtract};
use super::{ElementSet, Entry, FactorRow, FormFactors, MethodError, MethodParams, Piece, rays};

/// Polygons of a scene, at most: every point of the quadrature clips each by all others.
pub const MAX_POLYGONS: usize = 4_000;
/// Beams that carry less than this share of the power go on as their central ray: the first of these limits, from the finest,
/// with which one point of the sender looks at no more than [`POINT_WORK`] polygons.
const THIN: [f64; 2] = [3e-7, 1e-5];
/// Strips into which thin beams are cut.
const STRIPS: usize = 8;
/// Share of the power below which a strip's ray has nothing left: far less than sums round off.
const NOTHING: f64 = 1e-13;
/// Polygons that a point may look at.
const POINT_WORK: u64 = 100_000;
/// Relative error aimed at where there are mirrors: thin beams land as wholes, which is noise of about this size.
const MIRROR_TOLERANCE: f64 = 5e-6;
/// Polygons looked at per element, at most: with many mirrors every point is dear. The error is told.
const MAX_WORK: u64 = 5_000_000;
/// Reflections after which a beam goes on as its central ray, and a central ray ends.
const MAX_REFLECTIONS: usize = 1_000;

/// The method.
pub struct Analytic<'a> {
    tracer: &'a Tracer<'a>,
    set: &'a ElementSet,
    params: MethodParams,
    /// Every polygon of the scene.
    walls: Vec<Blocker>,
    /// Per wall: everything lies on one side of it, so that it stands between nothing.
    outer: Vec<bool>,
    triangles: Vec<TriangleId>,
    /// Per wall and edge: a vector in its plane that points inside, as long as the edge, and how far a point may be outside.
    edges: Vec<Vec<(DVec3, f64)>>,
    /// Per wall: its reflectance as a mirror.
    reflectances: Vec<Option<DVec3>>,
    mirrors: Vec<Mirror>,
    targets: Vec<Target>,
    /// What is in front of each mirror.
    stages: Vec<Stage>,
    /// Per triangle: what happens to light there is an image, or nothing.
    exact: Vec<bool>,
    /// Something in the scene sends light on in another way.
    rest: bool,
}

/// A side of a wall that reflects.
#[derive(Clone, Copy, Debug)]
struct Mirror {
    outline: Polygon,
    plane: PlaneId,
    normal: DVec3,
    offset: f64,
    reflectance: DVec3,
}

/// A receiving piece.
#[derive(Clone, Debug)]
struct Target {
    outline: Polygon,
    plane: PlaneId,
    normal: DVec3,
    offset: f64,
    /// Index of the element; the number of elements for black backs.
    element: usize,
}

/// What lies in front of a plane, clipped to it.
#[derive(Clone, Debug, Default)]
struct Stage {
    blockers: Vec<Blocker>,
    targets: Vec<Target>,
    mirrors: Vec<(usize, Polygon)>,
}

/// An eye, or its image in the last mirror, and the opening through which it looks.
struct View<'s> {
    eye: DVec3,
    normal: DVec3,
    stage: &'s Stage,
    window: Option<Polygon>,
    weight: DVec3,
    depth: usize,
}

impl<'a> Analytic<'a> {
    /// Cuts the scene into convex polygons.
    pub fn new(
        tracer: &'a Tracer<'a>,
        set: &'a ElementSet,
        params: &MethodParams,
    ) -> Result<Self, MethodError> {
        let scene = tracer.scene();
        let mut exact = Vec::with_capacity(scene.triangles().len());
        let mut rest = false;
        for index in 0..scene.triangles().len() as u32 {
            let triangle = TriangleId(index);
            let material = scene.material_of(triangle);
            if matches!(material.alpha_mode, AlphaMode::Mask { .. }) {
                return Err(MethodError::CutOuts { surface: scene.surface_of(triangle).name.clone() });
            }
            let plain = !material.may_be_specular() || mirror_of(tracer, triangle).is_some();
            exact.push(plain);
            rest |= !plain;
        }
        let mut analytic = Self {
            tracer,
            set,
            params: *params,
            walls: Vec::new(),
            outer: Vec::new(),
            triangles: Vec::new(),
            edges: Vec::new(),
            reflectances: Vec::new(),
            mirrors: Vec::new(),
            targets: Vec::new(),
            stages: Vec::new(),
            exact,
            rest: rest && params.walk.extended,
        };
        for surface in scene.surfaces() {
            let triangles: Vec<TriangleId> = surface.triangles.clone().map(TriangleId).collect();
            for piece in joined(tracer, &triangles, Side::Front) {
                analytic.add_wall(&piece);
            }
        }
        for index in 0..set.len() {
            let pieces = set.pieces(index as u32);
            analytic.targets.extend(pieces.iter().map(|piece| Target::new(piece, index)));
        }
        let polygons = analytic.walls.len().max(analytic.targets.len());
        if polygons > MAX_POLYGONS {
            return Err(MethodError::TooManyPolygons { found: polygons, limit: MAX_POLYGONS });
        }
        analytic.outer = analytic.walls.iter().map(|w| analytic.is_outer(w)).collect();
        let stages = analytic.mirrors.iter().map(|m| analytic.stage(m.normal, m.offset, m.plane)).collect();
        analytic.stages = stages;
        Ok(analytic)
    }

    fn add_wall(&mut self, piece: &Piece) {
        let Some(wall) = Blocker::new(piece.outline, piece.plane) else { return };
        let back = self.tracer.has_back(piece.triangle);
        if self.params.walk.extended
            && let Some(reflectance) = mirror_of(self.tracer, piece.triangle)
        {
            let front = Mirror {
                outline: piece.outline,
                plane: piece.plane,
                normal: piece.normal,
                offset: piece.normal.dot(piece.outline.corners()[0]),
                reflectance,
            };
            if back {
                self.mirrors.push(Mirror { normal: -front.normal, offset: -front.offset, ..front });
            }
            self.mirrors.push(front);
        }
        if !back {
            let mut target = Target::new(piece, self.set.len());
            target.normal = -target.normal;
            target.offset = -target.offset;
            self.targets.push(target);
        }
        let reflectance = self.params.walk.extended.then(|| mirror_of(self.tracer, piece.triangle)).flatten();
        let corners = wall.outline.corners();
        let edge = |k: usize| {
            let along = corners[(k + 1) % corners.len()] - corners[k];
            (wall.normal.cross(along), -1e-9 * along.length_squared())
        };
        self.edges.push((0..corners.len()).map(edge).collect());
        self.walls.push(wall);
        self.triangles.push(piece.triangle);
        self.reflectances.push(reflectance);
    }

    /// Whether all walls lie on one side of a wall's plane, within the rounding of positions.
    fn is_outer(&self, wall: &Blocker) -> bool {
        let heights = self
            .walls
            .iter()
            .filter(|w| w.plane != wall.plane)
            .flat_map(|w| w.outline.corners().iter().map(|c| wall.normal.dot(*c) - wall.offset));
        let (low, high) = heights.fold((0.0_f64, 0.0_f64), |(low, high), h| (low.min(h), high.max(h)));
        let rounding = 1e-6 * f64::from(self.tracer.diagonal());
        low > -rounding || high < rounding
    }

    /// What is in front of a plane.
    fn stage(&self, normal: DVec3, offset: f64, plane: PlaneId) -> Stage {
        let clip = |p: &Polygon| {
            let part = p.clipped(normal, offset);
            // A sliver within rounding of the plane is in it.
            let height = part.corners().iter().map(|c| normal.dot(*c) - offset).fold(0.0, f64::max);
            (!part.is_empty() && height > 1e-9 * (1.0 + offset.abs())).then_some(part)
        };
        let other = |p: PlaneId| p != plane;
        Stage {
            blockers: self
                .walls
                .iter()
                .zip(&self.outer)
                .filter(|(w, outer)| other(w.plane) && !**outer)
                .filter_map(|(w, _)| Some(Blocker { outline: clip(&w.outline)?, ..w.clone() }))
                .collect(),
            targets: self
                .targets
                .iter()
                .filter(|t| other(t.plane))
                .filter_map(|t| Some(Target { outline: clip(&t.outline)?, ..t.clone() }))
                .collect(),
            mirrors: self
                .mirrors
                .iter()
                .enumerate()
                .filter(|(_, m)| other(m.plane))
                .filter_map(|(index, m)| Some((index, clip(&m.outline)?)))
                .collect(),
        }
    }

    /// Adds F(eye → j) for all j, times the view's weight, to `out`.
    fn look(&self, view: &View, out: &mut [DVec3], scratch: &mut Scratch) {
        let sight = view.window.map(|window| Sight::through(&window, view.eye));
        let seen = |outline: &Polygon| match &sight {
            None => *outline,
            Some(sight) => sight.of(outline),
        };
        if scratch.work > scratch.stop {
            return;
        }
        let mut parts: Vec<Polygon> = Vec::new();
        scratch.work += (view.stage.targets.len() + view.stage.mirrors.len()) as u64;
        for target in &view.stage.targets {
            if target.normal.dot(view.eye) <= target.offset {
                continue;
            }
            let part = seen(&target.outline);
            if part.is_empty() {
                continue;
            }
            parts.clear();
            parts.push(part);
            subtract(&mut parts, &view.stage.blockers, view.eye, target.plane, scratch);
            let factor: f64 = parts.iter().map(|p| irradiance(view.eye, view.normal, p)).sum::<f64>() / PI;
            out[target.element] += view.weight * factor;
        }
        for (index, outline) in &view.stage.mirrors {
            let mirror = &self.mirrors[*index];
            if mirror.normal.dot(view.eye) <= mirror.offset {
                continue;
            }
            let part = seen(outline);
            if part.is_empty() {
                continue;
            }
            let mut windows = vec![part];
            subtract(&mut windows, &view.stage.blockers, view.eye, mirror.plane, scratch);
            let weight = view.weight * mirror.reflectance;
            for window in windows {
                let window = without_short_edges(&window);
                if window.is_empty() {
                    continue;
                }
                let factor = irradiance(view.eye, view.normal, &window) / PI;
                if factor <= 0.0 {
                    continue;
                }
                if factor * weight.max_element() < scratch.thin || view.depth >= MAX_REFLECTIONS {
                    self.follow_strips(view, mirror, &window, weight, out, &mut scratch.landed);
                    continue;
                }
                let reflect = |v: DVec3| v - mirror.normal * (2.0 * mirror.normal.dot(v));
                let image = View {
                    eye: reflect(view.eye) + mirror.normal * (2.0 * mirror.offset),
                    normal: reflect(view.normal),
                    stage: &self.stages[*index],
                    window: Some(window),
                    weight,
                    depth: view.depth + 1,
                };
                self.look(&image, out, scratch);
            }
        }
    }

    /// A thin beam goes on as the central rays of strips across its longest extent. From far down a duct windows are narrow
    /// but tall: what leaves them low goes on for many reflections more than what leaves them high.
    fn follow_strips(
        &self,
        view: &View,
        mirror: &Mirror,
        window: &Polygon,
        weight: DVec3,
        out: &mut [DVec3],
        landed: &mut [f64],
    ) {
        let corners = window.corners();
        let edges = (0..corners.len()).map(|k| corners[(k + 1) % corners.len()] - corners[k]);
        let longest =
            edges.fold(DVec3::ZERO, |a, b| if b.length_squared() > a.length_squared() { b } else { a });
        let Some(axis) = longest.try_normalize() else { return };
        let (low, high) = corners
            .iter()
            .map(|c| axis.dot(*c))
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), h| (low.min(h), high.max(h)));
        let at = |k: usize| low + (high - low) * k as f64 / STRIPS as f64;
        let mut rest = *window;
        for k in 1..=STRIPS {
            let strip = if k == STRIPS { rest } else { rest.clipped(-axis, -at(k)) };
            rest = rest.clipped(axis, at(k));
            if strip.is_empty() {
                continue;
            }
            let factor = irradiance(view.eye, view.normal, &strip) / PI;
            if factor > 0.0 {
                self.follow_center(view.eye, mirror, &strip, weight * factor, out, landed);
            }
        }
    }

    /// A strip lands where its central ray does: its power is kept, its place is right within its width.
    fn follow_center(
        &self,
        eye: DVec3,
        mirror: &Mirror,
        window: &Polygon,
        mut weight: DVec3,
        out: &mut [DVec3],
        landed: &mut [f64],
    ) {
        let sent = weight.max_element();
        let corners = window.corners();
        let mut origin = corners.iter().copied().sum::<DVec3>() / corners.len() as f64;
        let mut direction = (origin - eye).normalize_or_zero();
        let mut from = mirror.plane;
        direction -= mirror.normal * (2.0 * mirror.normal.dot(direction));
        for _ in 0..MAX_REFLECTIONS {
            let Some((wall, t)) = self.nearest(origin, direction, from) else { return };
            origin += direction * t;
            let (blocker, triangle) = (&self.walls[wall], self.triangles[wall]);
            let front = self.tracer.scene().geometric_normal(triangle).as_dvec3();
            let side = if front.dot(direction) < 0.0 { Side::Front } else { Side::Back };
            if side == Side::Back && !self.tracer.has_back(triangle) {
                out[self.set.len()] += weight;
                return;
            }
            if let Some(element) = self.set.locate(triangle, side, origin) {
                out[element as usize] += weight;
                landed[element as usize] += sent;
            }
            let Some(reflectance) = self.reflectances[wall] else { return };
            weight *= reflectance;
            if weight.max_element() < NOTHING {
                return;
            }
            direction -= blocker.normal * (2.0 * blocker.normal.dot(direction));
            from = blocker.plane;
        }
    }

    fn nearest(&self, origin: DVec3, direction: DVec3, from: PlaneId) -> Option<(usize, f64)> {
        let mut best: Option<(usize, f64)> = None;
        for (index, wall) in self.walls.iter().enumerate() {
            let speed = wall.normal.dot(direction);
            if wall.plane == from || speed == 0.0 {
                continue;
            }
            let t = (wall.offset - wall.normal.dot(origin)) / speed;
            if t <= 0.0 || best.is_some_and(|(_, b)| t >= b) {
                continue;
            }
            let point = origin + direction * t;
            let corners = wall.outline.corners();
            let inside = self.edges[index]
                .iter()
                .zip(corners)
                .all(|(&(inward, slack), &a)| inward.dot(point - a) >= slack);
            if inside {
                best = Some((index, t));
            }
        }
        best
    }

    /// The sender's pieces as triangles, cut where another plane crosses them: F(x → j) has a kink there.
    fn cells(&self, piece: &Piece, stage: &Stage) -> Vec<[DVec3; 3]> {
        let mut parts = vec![piece.outline];
        let planes = stage.targets.iter().map(|t| (t.normal, t.offset, t.plane));
        let mut used: Vec<PlaneId> = Vec::new();
        let most = MAX_PARTS.min(self.params.max_cells / 4);
        for (normal, offset, plane) in planes {
            if parts.len() >= most || used.contains(&plane) {
                continue;
            }
            used.push(plane);
            let mut cut = Vec::with_capacity(parts.len() + 1);
            for part in &parts {
                let heights = part.corners().iter().map(|c| normal.dot(*c) - offset);
                let (low, high) =
                    heights.fold((0.0_f64, 0.0_f64), |(low, high), h| (low.min(h), high.max(h)));
                let rounding = 1e-7 * (1.0 + offset.abs());
                if low < -rounding && high > rounding {
                    cut.push(part.clipped(normal, offset));
                    cut.push(part.clipped(-normal, -offset));
                } else {
                    cut.push(*part);
                }
            }
            parts = cut;
        }
        parts
            .iter()
            .flat_map(|part| {
                let corners = part.corners();
                (1..corners.len().saturating_sub(1)).map(|k| [corners[0], corners[k], corners[k + 1]])
            })
            .collect()
    }
}

/// The planes through an eye and the edges of a window.
struct Sight {
    planes: [DVec3; MAX_CORNERS],
    count: usize,
    eye: DVec3,
}

impl Sight {
    fn through(window: &Polygon, eye: DVec3) -> Self {
        let mut sight = Self { planes: [DVec3::ZERO; MAX_CORNERS], count: 0, eye };
        for plane in window.sight_planes(eye).into_iter().flatten() {
            sight.planes[sight.count] = plane;
            sight.count += 1;
        }
        sight
    }

    /// The part of a polygon that is seen: only planes that cut it are clipped by.
    fn of(&self, outline: &Polygon) -> Polygon {
        let mut cuts = [false; MAX_CORNERS];
        for (cut, plane) in cuts.iter_mut().zip(&self.planes[..self.count]) {
            let offset = plane.dot(self.eye);
            let inside = outline.corners().iter().filter(|c| plane.dot(**c) >= offset).count();
            if inside == 0 {
                return Polygon::new(&[]);
            }
            *cut = inside < outline.corners().len();
        }
        let mut part = *outline;
        for (_, plane) in cuts.iter().zip(&self.planes[..self.count]).filter(|(cut, _)| **cut) {
            part = part.clipped(*plane, plane.dot(self.eye));
            if part.is_empty() {
                break;
            }
        }
        part
    }
}

/// A window without the edges that repeated clipping leaves at corners: through an edge as short as rounding there is no
/// plane to clip by.
fn without_short_edges(window: &Polygon) -> Polygon {
    let corners = window.corners();
    let size = corners.iter().map(|c| (*c - corners[0]).length()).fold(0.0, f64::max);
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

/// Edges shorter than this share of a window are rounding.
const SHORT: f64 = 1e-9;

/// Parts into which the planes of other surfaces cut a sender before the quadrature starts.
const MAX_PARTS: usize = 48;

/// The reflectance of a flat mirror (or of the mirror part of a mixed surface) that is the same everywhere and at every
/// angle: its reflections are images.
fn mirror_of(tracer: &Tracer, triangle: TriangleId) -> Option<DVec3> {
    tracer.image_plane(triangle)?;
    let scene = tracer.scene();
    let material = scene.material_of(triangle);
    let at = |u, v| scene.surface_point(triangle, Barycentric { u, v });
    let points = [at(0.2, 0.2), at(0.6, 0.2), at(0.2, 0.6)];
    let textured = material.base_texture.is_some()
        || material.metallic_roughness_texture.is_some()
        || material.specular_texture.is_some()
        || material.clearcoat_texture.is_some()
        || material.transmission_texture.is_some();
    let same = points.iter().all(|p| p.mirror == points[0].mirror);
    let plain = points.iter().all(|p| {
        (p.coat == 0.0 || p.coat_share == 0.0)
            && p.clearcoat == 0.0
            && p.transmission == 0.0
            && p.opacity == 1.0
    });
    (same && plain && !textured && points[0].mirror.max_element() > 0.0).then(|| points[0].mirror.as_dvec3())
}

impl Target {
    fn new(piece: &Piece, element: usize) -> Self {
        Self {
            outline: piece.outline,
            plane: piece.plane,
            normal: piece.normal,
            offset: piece.normal.dot(piece.outline.corners()[0]),
            element,
        }
    }
}

/// Gauss–Legendre nodes and weights on [0, 1].
const GAUSS4: [(f64, f64); 4] = [
    (0.069_431_844_202_973_71, 0.173_927_422_568_726_9),
    (0.330_009_478_207_571_9, 0.326_072_577_431_273_1),
    (0.669_990_521_792_428_1, 0.326_072_577_431_273_1),
    (0.930_568_155_797_026_3, 0.173_927_422_568_726_9),
];
const GAUSS5: [(f64, f64); 5] = [
    (0.046_910_077_030_668_0, 0.118_463_442_528_094_5),
    (0.230_765_344_947_158_45, 0.239_314_335_249_683_2),
    (0.5, 0.284_444_444_444_444_4),
    (0.769_234_655_052_841_5, 0.239_314_335_249_683_2),
    (0.953_089_922_969_332, 0.118_463_442_528_094_5),
];

/// A triangle of the sender with its share of the integral and the difference of two rules on it.
struct Cell {
    corners: [DVec3; 3],
    stage: usize,
    values: Vec<DVec3>,
    errors: Vec<f64>,
    /// What thin beams brought, which is where their rays happened to land.
    landed: Vec<f64>,
    /// Worst error in units of what is aimed at.
    score: f64,
    /// Order of creation: ties are broken the same way every time.
    serial: usize,
}

impl PartialEq for Cell {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}
impl Eq for Cell {}
impl PartialOrd for Cell {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}
impl Ord for Cell {
    fn cmp(&self, other: &Self) -> Ordering {
        self.score.total_cmp(&other.score).then(other.serial.cmp(&self.serial))
    }
}

/// F below which errors are absolute.
const SMALL: f64 = 1e-6;

impl Analytic<'_> {
    /// ∫ F(x → ·) over a triangle by two Gauss rules on the square that collapses to it.
    fn integrate(
        &self,
        corners: [DVec3; 3],
        normal: DVec3,
        stage: &Stage,
        scratch: &mut Scratch,
    ) -> Integral {
        let [a, b, c] = corners;
        let twice_area = (b - a).cross(c - a).length();
        let count = self.set.len() + 1;
        let mut landed = vec![0.0; count];
        let mut rule = |nodes: &[(f64, f64)]| {
            let mut sum = vec![DVec3::ZERO; count];
            let mut here = sum.clone();
            landed.fill(0.0);
            for &(u, wu) in nodes {
                for &(v, wv) in nodes {
                    let eye = a + (b - a) * (u * (1.0 - v)) + (c - a) * (u * v);
                    let view = View { eye, normal, stage, window: None, weight: DVec3::ONE, depth: 0 };
                    here.fill(DVec3::ZERO);
                    scratch.landed.clear();
                    scratch.landed.resize(count, 0.0);
                    self.look(&view, &mut here, scratch);
                    let weight = wu * wv * u * twice_area;
                    for (sum, value) in landed.iter_mut().zip(&scratch.landed) {
                        *sum += value * weight;
                    }
                    for (sum, value) in sum.iter_mut().zip(&here) {
                        *sum += *value * weight;
                    }
                }
            }
            sum
        };
        let coarse = rule(&GAUSS4);
        let values = rule(&GAUSS5);
        let errors = values.iter().zip(&coarse).map(|(f, c)| (*f - *c).abs().max_element()).collect();
        Integral { values, errors, landed }
    }

    /// How thin beams may get so that a point in the middle of the sender does not look at too much.
    fn choose_thin(&self, piece: &Piece, stage: &Stage, scratch: &mut Scratch) {
        let corners = piece.outline.corners();
        let eye = corners.iter().copied().sum::<DVec3>() / corners.len() as f64;
        let mut out = vec![DVec3::ZERO; self.set.len() + 1];
        scratch.landed.clear();
        scratch.landed.resize(out.len(), 0.0);
        // From the coarsest on: a finer limit costs up to as many times more as it is finer, or nothing.
        scratch.thin = THIN[THIN.len() - 1];
        for &limit in THIN.iter().rev() {
            let before = scratch.work;
            let wider = std::mem::replace(&mut scratch.thin, limit);
            let view = View { eye, normal: piece.normal, stage, window: None, weight: DVec3::ONE, depth: 0 };
            scratch.stop = before + POINT_WORK;
            self.look(&view, &mut out, scratch);
            scratch.stop = u64::MAX;
            if scratch.work - before > POINT_WORK {
                scratch.thin = wider;
                break;
            }
        }
        scratch.work = 0;
    }
}

/// What two Gauss rules find on a cell.
struct Integral {
    values: Vec<DVec3>,
    errors: Vec<f64>,
    landed: Vec<f64>,
}

impl FormFactors for Analytic<'_> {
    fn row(&self, from: u32) -> FactorRow {
        let count = self.set.len();
        let pieces = self.set.pieces(from);
        let area: f64 = pieces.iter().map(|p| p.area).sum();
        let mut scratch = Scratch::default();
        let tolerance = match self.mirrors.is_empty() {
            true => self.params.tolerance,
            false => self.params.tolerance.max(MIRROR_TOLERANCE),
        };
        let mut total = vec![DVec3::ZERO; count + 1];
        let mut error = vec![0.0; count + 1];
        let mut heap: BinaryHeap<Cell> = BinaryHeap::new();
        let mut made = 0_usize;
        let score = |errors: &[f64], total: &[DVec3]| {
            (0..count).map(|j| errors[j] / total[j].max_element().max(SMALL * area)).fold(0.0, f64::max)
        };

        // Start with the pieces, cut where planes cross them.
        let stages: Vec<Stage> = pieces
            .iter()
            .map(|p| self.stage(p.normal, p.normal.dot(p.outline.corners()[0]), p.plane))
            .collect();
        if let (Some(piece), false) = (pieces.first(), self.mirrors.is_empty()) {
            self.choose_thin(piece, &stages[0], &mut scratch);
        }
        let mut fresh: Vec<([DVec3; 3], usize)> = Vec::new();
        for (index, piece) in pieces.iter().enumerate() {
            fresh.extend(self.cells(piece, &stages[index]).into_iter().map(|corners| (corners, index)));
        }

        // Split the worst cell until every form factor is good enough.
        loop {
            let mut cells = Vec::with_capacity(fresh.len());
            for (corners, stage) in fresh.drain(..) {
                let Integral { values, errors, landed } =
                    self.integrate(corners, pieces[stage].normal, &stages[stage], &mut scratch);
                for j in 0..=count {
                    total[j] += values[j];
                    error[j] += errors[j];
                }
                cells.push(Cell { corners, stage, values, errors, landed, score: 0.0, serial: made });
                made += 1;
            }
            for mut cell in cells {
                cell.score = score(&cell.errors, &total);
                heap.push(cell);
            }
            let spent = made >= self.params.max_cells || scratch.work > MAX_WORK;
            if score(&error, &total) <= tolerance || spent {
                break;
            }
            let Some(worst) = heap.pop() else { break };
            for j in 0..=count {
                total[j] -= worst.values[j];
                error[j] -= worst.errors[j];
            }
            let [a, b, c] = worst.corners;
            let (ab, bc, ca) = ((a + b) * 0.5, (b + c) * 0.5, (c + a) * 0.5);
            fresh.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]].map(|t| (t, worst.stage)));
        }

        // Sum again, in order of making: running sums have gathered rounding.
        let mut cells = heap.into_vec();
        cells.sort_by_key(|c| c.serial);
        total.fill(DVec3::ZERO);
        error.fill(0.0);
        for cell in &cells {
            for j in 0..=count {
                total[j] += cell.values[j] / area;
                // Between one strip and the next, what lands where changes by about a strip's share.
                error[j] += (cell.errors[j] + cell.landed[j] / STRIPS as f64) / area;
            }
        }
        let samples = made as u64 * (GAUSS4.len() * GAUSS4.len() + GAUSS5.len() * GAUSS5.len()) as u64;
        let mut row = self.book(&total, &error, samples);
        if self.rest {
            self.add_rest(from, &mut row);
        }
        row
    }
}

impl Analytic<'_> {
    /// The row with its ledger. What escaped is what is left: a contour sum knows nothing of the sky.
    fn book(&self, total: &[DVec3], error: &[f64], samples: u64) -> FactorRow {
        let count = self.set.len();
        let mut row = FactorRow::from_dense(&total[..count], &error[..count], Default::default(), samples);
        row.ledger.black_backs = total[count];
        for entry in &row.entries {
            let piece = self.set.pieces(entry.to).first();
            let material = piece.map(|p| self.tracer.scene().material_of(p.triangle));
            let reflectance = piece
                .filter(|_| self.params.walk.extended)
                .and_then(|p| mirror_of(self.tracer, p.triangle))
                .unwrap_or(DVec3::ZERO);
            let kept = entry.factor * (DVec3::ONE - reflectance);
            if material.is_some_and(|m| m.may_be_diffuse()) {
                row.ledger.arrived += kept;
            } else {
                row.ledger.absorbed += kept;
            }
        }
        row.ledger.escaped = DVec3::ONE - row.ledger.arrived - row.ledger.absorbed - row.ledger.black_backs;
        row
    }

    /// Adds paths with an event that is not an image, by rays.
    fn add_rest(&self, from: u32, row: &mut FactorRow) {
        let mut exact = true;
        let rest = rays::cast(self.tracer, self.set, &self.params, from, |arrival, _| {
            // A walk is new where nothing has happened yet.
            exact = arrival.chain.is_empty() || exact;
            let counts = !exact;
            exact &= self.exact[arrival.hit.triangle.index()];
            if counts { 1.0 } else { 0.0 }
        });
        let (mut factors, mut errors) = rays::dense(row, self.set.len());
        for &Entry { to, factor, error } in &rest.entries {
            factors[to as usize] += factor;
            errors[to as usize] = libm::hypot(errors[to as usize], error);
        }
        *row = FactorRow::from_dense(&factors, &errors, rest.ledger, row.samples + rest.samples);
    }
}
