//! Lambert's contour formula from the points of an adaptive Gauss quadrature over the sender, everything between
//! clipped exactly: the horizon, the outlines of blockers, the frames of planar mirrors (beams of images, any number).
//!
//! F_ij = 1/A_i ∫_{A_i} F(x → j) dx with F(x → j) by the contour formula (Baum, Rushmeier & Winget 1989, who integrate
//! over x numerically, too). The contour formula has no singularity at shared edges and corners: F(x → j) is bounded by
//! 1 and the quadrature subdivides towards them. Curved mirrors, coats, panes and glass are no images: paths over any
//! of them are found by hemisphere rays and added.
//!
//! `stage` has walls, targets and mirrors, `view` the way of a point's look among them; `beams` joins windows, `visible` clips,
//! `quadrature` has the rules.

use std::collections::BinaryHeap;
use std::ops::Range;

use glam::DVec3;

use catoptric_light::contour::Polygon;
use catoptric_scene::{AlphaMode, Side, TriangleId};
use catoptric_trace::{PlaneId, Tracer};

use super::elements::joined;
use super::quadrature::{COARSE, Cell, FINE, Integral, Place, Rule};
use super::visible::{Blocker, Shadows};
use super::{ElementSet, Entry, FactorRow, FormFactors, MethodError, MethodParams, Piece, rays};

mod stage;
mod view;

use stage::{Mirror, Stage, Target, mirror_of};
use view::{STRIPS, Scratch, View};

/// Polygons of a scene, at most: every point of the quadrature clips each by all others.
pub const MAX_POLYGONS: usize = 4_000;
/// Beams that carry less than this share of the power go on as their central rays: the last of these limits with which one
/// point of the sender looks at no more than [`POINT_WORK`] polygons, and which is not below [`THIN_SHARE`] of the tolerance.
const THIN: [f64; 5] = [1e-5, 1e-6, 1e-7, 1e-8, 1e-9];
/// Thousands of beams end at the limit, some per cent of each in the wrong place, most of them on either side.
const THIN_SHARE: f64 = 1e-3;
/// Polygons that a point may look at.
const POINT_WORK: u64 = 500_000;
/// Light is summed on cells of its own up to so many reflections, up to so many more, and from there on. What comes straight
/// or over few mirrors changes much across the sender and costs little at a point; distant images change little, so that a
/// few points are enough, and cost much.
const BANDS: [Range<usize>; 3] = [0..4, 4..12, 12..usize::MAX];
/// Relative error aimed at where there are mirrors: thin beams land as wholes, which is noise of about this size.
const MIRROR_TOLERANCE: f64 = 5e-7;
/// Relative error from which on the coarse rules do.
const ROUGH: f64 = 1e-4;
/// Polygons looked at per element, at most: with many mirrors every point is dear. The error is told.
const MAX_WORK: u64 = 20_000_000;

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

/// Parts into which the planes of other surfaces cut a sender before the quadrature starts.
const MAX_PARTS: usize = 48;

/// F below which errors are absolute.
const SMALL: f64 = 1e-6;

impl Analytic<'_> {
    /// ∫ F(x → ·) over a triangle by two Gauss rules on the square that collapses to it.
    fn integrate(
        &self,
        place: &Place,
        normal: DVec3,
        stage: &Stage,
        rules: [Rule; 2],
        scratch: &mut Scratch,
    ) -> Integral {
        let [a, b, c] = place.corners;
        let twice_area = (b - a).cross(c - a).length();
        let count = self.set.len() + 1;
        let mut landed = vec![0.0; count];
        let mut rule = |nodes: Rule| {
            let mut sum = vec![DVec3::ZERO; count];
            let mut here = sum.clone();
            landed.fill(0.0);
            for &(u, wu) in nodes {
                for &(v, wv) in nodes {
                    let eye = a + (b - a) * (u * (1.0 - v)) + (c - a) * (u * v);
                    let view = View::from(eye, normal, stage);
                    here.fill(DVec3::ZERO);
                    scratch.landed.fill(0.0);
                    self.look(&view, &place.band, &mut here, scratch);
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
        let coarse = rule(rules[0]);
        let values = rule(rules[1]);
        let errors = values.iter().zip(&coarse).map(|(f, c)| (*f - *c).abs().max_element()).collect();
        Integral { values, errors, landed }
    }

    /// How thin beams may get so that a point in the middle of the sender does not look at too much.
    fn choose_thin(&self, piece: &Piece, stage: &Stage, tolerance: f64, scratch: &mut Scratch) {
        let corners = piece.outline.corners();
        let eye = corners.iter().copied().sum::<DVec3>() / corners.len() as f64;
        let mut out = vec![DVec3::ZERO; self.set.len() + 1];
        // From the coarsest on: a finer limit costs up to as many times more as it is finer, or nothing.
        scratch.thin = THIN[0];
        for &limit in THIN.iter().filter(|t| **t >= THIN_SHARE * tolerance) {
            let before = scratch.work;
            let wider = std::mem::replace(&mut scratch.thin, limit);
            let view = View::from(eye, piece.normal, stage);
            scratch.stop = before + POINT_WORK;
            self.look(&view, &(0..usize::MAX), &mut out, scratch);
            scratch.stop = u64::MAX;
            if scratch.work - before > POINT_WORK {
                scratch.thin = wider;
                break;
            }
        }
        scratch.work = 0;
        scratch.landed.fill(0.0);
    }
}

impl FormFactors for Analytic<'_> {
    fn row(&self, from: u32) -> FactorRow {
        let count = self.set.len();
        let pieces = self.set.pieces(from);
        let area: f64 = pieces.iter().map(|p| p.area).sum();
        let mut scratch = Scratch {
            shadows: Shadows::default(),
            buffers: [Polygon::new(&[]); 2],
            parts: Vec::new(),
            work: 0,
            stop: u64::MAX,
            thin: THIN[0],
            landed: vec![0.0; count + 1],
        };
        let tolerance = match self.mirrors.is_empty() {
            true => self.params.tolerance,
            false => self.params.tolerance.max(MIRROR_TOLERANCE),
        };
        let mut total = vec![DVec3::ZERO; count + 1];
        let mut error = vec![0.0; count + 1];
        let mut heap: BinaryHeap<Cell> = BinaryHeap::new();
        let mut made = 0_usize;
        let mut samples = 0;
        let score = |errors: &[f64], total: &[DVec3]| {
            (0..count).map(|j| errors[j] / total[j].max_element().max(SMALL * area)).fold(0.0, f64::max)
        };

        // Start with the pieces, cut where planes cross them.
        let stages: Vec<Stage> = pieces
            .iter()
            .map(|p| self.stage(p.normal, p.normal.dot(p.outline.corners()[0]), p.plane))
            .collect();
        let bands = if self.mirrors.is_empty() { &BANDS[..1] } else { &BANDS[..] };
        if let (Some(piece), false) = (pieces.first(), self.mirrors.is_empty()) {
            self.choose_thin(piece, &stages[0], tolerance, &mut scratch);
        }
        let mut fresh: Vec<Place> = Vec::new();
        for (index, piece) in pieces.iter().enumerate() {
            for corners in self.cells(piece, &stages[index]) {
                fresh.extend(bands.iter().map(|band| Place { corners, piece: index, band: band.clone() }));
            }
        }

        // Split the worst cell until every form factor is good enough.
        loop {
            let mut cells = Vec::with_capacity(fresh.len());
            for place in fresh.drain(..) {
                let rules = if tolerance > ROUGH || place.band == BANDS[2] { COARSE } else { FINE };
                let (normal, stage) = (pieces[place.piece].normal, &stages[place.piece]);
                let Integral { values, errors, landed } =
                    self.integrate(&place, normal, stage, rules, &mut scratch);
                for j in 0..=count {
                    total[j] += values[j];
                    error[j] += errors[j];
                }
                samples += rules.iter().map(|nodes| (nodes.len() * nodes.len()) as u64).sum::<u64>();
                cells.push(Cell { place, values, errors, landed, score: 0.0, serial: made });
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
            let Place { corners: [a, b, c], piece, band } = worst.place;
            let (ab, bc, ca) = ((a + b) * 0.5, (b + c) * 0.5, (c + a) * 0.5);
            let quarters = [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]];
            fresh.extend(quarters.map(|corners| Place { corners, piece, band: band.clone() }));
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
