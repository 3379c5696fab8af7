//! The hemicube (Cohen & Greenberg 1985): the scene is projected onto the five faces of half a cube about a point of the
//! sender, a depth buffer keeps the nearest triangle of each cell (item buffer), and every cell adds its delta form
//! factor to what it sees.
//!
//! Delta form factors are exact integrals over the cells, not the products of area and kernel of the paper, so they sum
//! to 1 at every resolution. Cells that see a mirror, glass or a hole go on as rays. The cube is turned about the normal by
//! another angle at every point: that breaks the plaid which a fixed raster weaves.

use std::f64::consts::PI;

use glam::{DVec2, DVec3, Vec3};

use catoptric_light::contour;
use catoptric_scene::{AlphaMode, Side, TriangleId};
use catoptric_trace::sequence::{Key, Purpose};
use catoptric_trace::walk::{self, Arrival};
use catoptric_trace::{Ledger, PlaneId, Ray, Tracer};

use super::scrambles::{SCRAMBLES, Scrambles};
use super::{ElementSet, FactorRow, FormFactors, MethodParams};

/// The method.
pub struct Hemicube<'a> {
    tracer: &'a Tracer<'a>,
    set: &'a ElementSet,
    params: MethodParams,
    raster: Raster,
    /// Per triangle: a cell that sees it goes on as a ray.
    goes_on: Vec<bool>,
}

/// The cells of one hemicube of half edge 1: the top first, then the four sides.
#[derive(Clone, Debug)]
pub struct Raster {
    resolution: usize,
    /// Delta form factors of a quarter of symmetry are not stored apart: all cells of the top, row by row.
    top: Vec<f64>,
    /// Those of a side, rows from the horizon up.
    side: Vec<f64>,
}

/// ∫∫ of 1/(π(x² + y² + 1)²) from the origin to (x, y): the form factor of a rectangle above a point, one corner over it
/// (Howell B-3).
fn over(x: f64, y: f64) -> f64 {
    let (rx, ry) = ((1.0 + x * x).sqrt(), (1.0 + y * y).sqrt());
    (x / rx * libm::atan(y / rx) + y / ry * libm::atan(x / ry)) / (2.0 * PI)
}

/// The same for a rectangle at distance 1 beside the point, from the horizon to height z, from the middle to y
/// (Howell B-4).
fn beside(y: f64, z: f64) -> f64 {
    let r = (1.0 + z * z).sqrt();
    (libm::atan(y) - libm::atan(y / r) / r) / (2.0 * PI)
}

impl Raster {
    /// `resolution` cells along an edge of the top; made even.
    pub fn new(resolution: u32) -> Self {
        let n = (resolution.max(2) as usize).next_multiple_of(2);
        let at = |k: usize| 2.0 * k as f64 / n as f64 - 1.0;
        let top = (0..n * n)
            .map(|cell| {
                let (i, j) = (cell % n, cell / n);
                let ([x0, x1], [y0, y1]) = ([at(i), at(i + 1)], [at(j), at(j + 1)]);
                over(x1, y1) - over(x0, y1) - over(x1, y0) + over(x0, y0)
            })
            .collect();
        let side = (0..n * n / 2)
            .map(|cell| {
                let (i, j) = (cell % n, cell / n);
                let ([y0, y1], [z0, z1]) = ([at(i), at(i + 1)], [at(j) + 1.0, at(j + 1) + 1.0]);
                beside(y1, z1) - beside(y0, z1) - beside(y1, z0) + beside(y0, z0)
            })
            .collect();
        Self { resolution: n, top, side }
    }

    /// Cells of the five faces.
    pub fn cells(&self) -> usize {
        self.top.len() + 4 * self.side.len()
    }

    /// Delta form factor of a cell of a face (0 is the top).
    pub fn delta(&self, face: usize, cell: usize) -> f64 {
        if face == 0 { self.top[cell] } else { self.side[cell] }
    }

    fn rows(&self, face: usize) -> usize {
        if face == 0 { self.resolution } else { self.resolution / 2 }
    }

    /// Centre of a cell in coordinates of its face.
    fn center(&self, face: usize, cell: usize) -> DVec2 {
        let n = self.resolution as f64;
        let (i, j) = ((cell % self.resolution) as f64, (cell / self.resolution) as f64);
        let lift = if face == 0 { -1.0 } else { 0.0 };
        DVec2::new((2.0 * i + 1.0) / n - 1.0, (2.0 * j + 1.0) / n + lift)
    }
}

/// A hemicube in place: point, axes of the five faces.
struct Cube {
    eye: DVec3,
    plane: PlaneId,
    /// Right, up and forward of each face. Side faces have the normal as up: rows start at the horizon.
    faces: [[DVec3; 3]; 5],
}

impl Cube {
    fn new(eye: DVec3, normal: DVec3, plane: PlaneId, turn: f64) -> Self {
        let (tangent, _) = catoptric_trace::sequence::frame(normal.as_vec3());
        let tangent = (tangent.as_dvec3() - normal * normal.dot(tangent.as_dvec3())).normalize_or_zero();
        let bitangent = normal.cross(tangent);
        let (sin, cos) = libm::sincos(turn);
        let (x, y) = (tangent * cos + bitangent * sin, bitangent * cos - tangent * sin);
        let faces = [[x, y, normal], [y, normal, x], [-x, normal, y], [-y, normal, -x], [x, normal, -y]];
        Self { eye, plane, faces }
    }

    fn direction(&self, raster: &Raster, face: usize, cell: usize) -> DVec3 {
        let [right, up, forward] = self.faces[face];
        let at = raster.center(face, cell);
        right * at.x + up * at.y + forward
    }
}

/// The item buffer: nearest triangle per cell of a face.
#[derive(Clone, Copy)]
struct Item {
    /// 1/depth: linear in the picture.
    inverse_depth: f64,
    triangle: u32,
}

const EMPTY: Item = Item { inverse_depth: 0.0, triangle: u32::MAX };

/// Hemicubes per scramble, at least.
const MIN_POINTS: u32 = 8;

impl<'a> Hemicube<'a> {
    /// Computes the delta form factors.
    pub fn new(tracer: &'a Tracer<'a>, set: &'a ElementSet, params: &MethodParams) -> Self {
        let scene = tracer.scene();
        let goes_on = (0..scene.triangles().len() as u32)
            .map(|t| {
                let material = scene.material_of(TriangleId(t));
                (material.may_be_specular() && params.walk.extended)
                    || material.alpha_mode != AlphaMode::Opaque
            })
            .collect();
        Self { tracer, set, params: *params, raster: Raster::new(params.resolution), goes_on }
    }

    /// Projects every triangle onto one face.
    fn draw(&self, cube: &Cube, face: usize, items: &mut Vec<Item>) {
        let scene = self.tracer.scene();
        let (columns, rows) = (self.raster.resolution, self.raster.rows(face));
        items.clear();
        items.resize(columns * rows, EMPTY);
        let [right, up, forward] = cube.faces[face];
        let half = columns as f64 / 2.0;
        let bottom = if face == 0 { -1.0 } else { 0.0 };
        // Through the eye and the edges of the face; the last keeps what is behind the eye away.
        let frustum = [
            DVec3::new(1.0, 0.0, 1.0),
            DVec3::new(-1.0, 0.0, 1.0),
            DVec3::new(0.0, -1.0, 1.0),
            DVec3::new(0.0, 1.0, -bottom),
            DVec3::Z,
        ];
        let (mut visible, mut spare) = (Vec::new(), Vec::new());
        for index in 0..scene.triangles().len() as u32 {
            let triangle = TriangleId(index);
            if self.tracer.planes().of(triangle) == cube.plane {
                continue;
            }
            // Into the face's frame: the picture is at depth 1.
            let corners = scene.corners(triangle).map(|c| {
                let p = c.as_dvec3() - cube.eye;
                DVec3::new(p.dot(right), p.dot(up), p.dot(forward))
            });
            let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
            let height = normal.dot(corners[0]);
            if height == 0.0 {
                continue;
            }
            visible.clear();
            visible.extend(corners);
            for plane in frustum {
                contour::cut(&mut visible, plane, 0.0, &mut spare);
            }
            if visible.len() < 3 {
                continue;
            }
            // Edges through the eye as half-planes of the picture; what is met is inside of all.
            let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
            for corner in &visible {
                let p = DVec2::new(corner.x, corner.y) / corner.z.max(1e-300);
                let p = p.clamp(DVec2::new(-1.0, bottom), DVec2::ONE);
                low = low.min(p);
                high = high.max(p);
            }
            let sign = height.signum();
            let edges: [DVec3; 3] = std::array::from_fn(|k| corners[k].cross(corners[(k + 1) % 3]) * sign);
            let cells = |v: f64, base: f64| ((v - base) * half).floor().max(0.0) as usize;
            for row in cells(low.y, bottom)..=cells(high.y, bottom).min(rows - 1) {
                for column in cells(low.x, -1.0)..=cells(high.x, -1.0).min(columns - 1) {
                    let cell = row * columns + column;
                    let at = self.raster.center(face, cell);
                    let ray = DVec3::new(at.x, at.y, 1.0);
                    // A ray on a common edge belongs to both: the depth test and the lower id decide.
                    if edges.iter().any(|e| e.dot(ray) < 0.0) {
                        continue;
                    }
                    let inverse_depth = normal.dot(ray) / height;
                    if inverse_depth > items[cell].inverse_depth {
                        items[cell] = Item { inverse_depth, triangle: index };
                    }
                }
            }
        }
    }

    /// The weight that a cell's walk carries, by a ray: also the slow twin of the whole method.
    fn walk(
        &self,
        cube: &Cube,
        direction: DVec3,
        element: u32,
        key: Key,
        ledger: &mut Ledger,
        mut meet: impl FnMut(&Arrival),
    ) {
        let direction = direction.normalize_or_zero().as_vec3();
        let ray = Ray { origin: cube.eye.as_vec3(), direction, from: cube.plane };
        let media = self.set.elements()[element as usize].media;
        walk::choose_meeting(self.tracer, ray, media, Vec3::ONE, key, &self.params.walk, ledger, &mut meet);
    }

    /// Hemicubes per scramble: fewer would leave the sender's own extent to chance.
    fn points(&self) -> u32 {
        (self.params.rays / self.raster.cells() as u32).max(MIN_POINTS)
    }

    fn cubes(&self, from: u32) -> impl Iterator<Item = (u32, Cube)> + '_ {
        let key = Key::new(self.params.seed, Purpose::FormFactor, u64::from(from) | 1 << 41);
        let each = self.points();
        (0..SCRAMBLES * each).map(move |k| {
            let (scramble, index) = (k / each, k % each);
            let [u, v, turn, _] = key.child(scramble).point4(index).map(f64::from);
            let (piece, eye) = self.set.point(from, u, v);
            (k, Cube::new(eye, piece.normal, piece.plane, turn * PI / 2.0))
        })
    }

    /// Adds what the item at a cell receives, or where its ray goes.
    fn spend(
        &self,
        cube: &Cube,
        face: usize,
        cell: usize,
        triangle: TriangleId,
        depth: f64,
        scrambles: &mut Scrambles,
        ledger: &mut Ledger,
        delta: f64,
    ) {
        let scene = self.tracer.scene();
        let direction = cube.direction(&self.raster, face, cell);
        let back = scene.geometric_normal(triangle).as_dvec3().dot(direction) >= 0.0;
        let side = if back { Side::Back } else { Side::Front };
        let position = cube.eye + direction * depth;
        let diffuse = scene.material_of(triangle).may_be_diffuse();
        match self.set.locate(triangle, side, position) {
            Some(to) => {
                scrambles.add(to, DVec3::splat(delta));
                if diffuse {
                    ledger.arrived += DVec3::splat(delta);
                } else {
                    ledger.absorbed += DVec3::splat(delta);
                }
            }
            None if back && !self.tracer.has_back(triangle) => ledger.black_backs += DVec3::splat(delta),
            None => ledger.absorbed += DVec3::splat(delta),
        }
    }

    /// The slow twin: one ray per cell.
    pub fn row_by_rays(&self, from: u32) -> FactorRow {
        self.row_with(from, |_, _, items| items.fill(Item { inverse_depth: 1.0, triangle: u32::MAX - 1 }))
    }

    fn row_with(&self, from: u32, draw: impl Fn(&Cube, usize, &mut Vec<Item>)) -> FactorRow {
        let each = self.points();
        let share = 1.0 / f64::from(each);
        let key = Key::new(self.params.seed, Purpose::Roulette, u64::from(from) | 1 << 45);
        let mut scrambles = Scrambles::new(self.set.len());
        let mut ledger = Ledger::default();
        let mut items: Vec<Item> = Vec::new();
        for (k, cube) in self.cubes(from) {
            for face in 0..5 {
                items.clear();
                items.resize(self.raster.resolution * self.raster.rows(face), EMPTY);
                draw(&cube, face, &mut items);
                for (cell, item) in items.iter().enumerate() {
                    let delta = self.raster.delta(face, cell) * share;
                    let known = (item.triangle as usize) < self.goes_on.len();
                    if item.triangle == u32::MAX {
                        ledger.escaped += DVec3::splat(delta);
                    } else if known && !self.goes_on[item.triangle as usize] {
                        let triangle = TriangleId(item.triangle);
                        let depth = 1.0 / item.inverse_depth;
                        self.spend(&cube, face, cell, triangle, depth, &mut scrambles, &mut ledger, delta);
                    } else {
                        let direction = cube.direction(&self.raster, face, cell);
                        let walk_key = key.child(k).child((face * self.raster.top.len() + cell) as u32);
                        let mut own = Ledger::default();
                        self.walk(&cube, direction, from, walk_key, &mut own, |arrival| {
                            let place = arrival.position.as_dvec3();
                            let side = arrival.interaction.side;
                            if let Some(to) = self.set.locate(arrival.hit.triangle, side, place) {
                                scrambles.add(to, arrival.throughput.as_dvec3() * delta);
                            }
                        });
                        ledger.add(&own.scaled(delta));
                    }
                }
            }
            if k % each == each - 1 {
                scrambles.next();
            }
        }
        let (factors, errors) = scrambles.finish();
        let cells = u64::from(each * SCRAMBLES) * self.raster.cells() as u64;
        FactorRow::from_dense(&factors, &errors, ledger.scaled(1.0 / f64::from(SCRAMBLES)), cells)
    }
}

impl FormFactors for Hemicube<'_> {
    fn row(&self, from: u32) -> FactorRow {
        self.row_with(from, |cube, face, items| self.draw(cube, face, items))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn delta_form_factors_sum_to_one_at_every_resolution() {
        for resolution in [2, 10, 64, 301] {
            let raster = Raster::new(resolution);
            let sum: f64 = raster.top.iter().sum::<f64>() + 4.0 * raster.side.iter().sum::<f64>();
            assert!((sum - 1.0).abs() < 1e-12, "{resolution}: {sum}");
            assert!(raster.top.iter().chain(&raster.side).all(|d| *d > 0.0));
        }
    }

    /// ΔF ≈ ΔA/(π(x² + y² + 1)²) on top and z ΔA/(π(y² + z² + 1)²) on the sides (Cohen & Greenberg 1985, fig. 7), for
    /// small cells.
    #[test]
    fn delta_form_factors_match_the_kernel_of_the_paper() {
        let raster = Raster::new(200);
        let area = 0.01_f64.powi(2);
        for cell in [0, 100 * 200 + 100, 57 * 200 + 190] {
            let p = raster.center(0, cell);
            let kernel = area / (PI * (p.length_squared() + 1.0).powi(2));
            assert!((raster.delta(0, cell) / kernel - 1.0).abs() < 1e-4);
        }
        for cell in [99 * 200 + 100, 57 * 200 + 190] {
            let p = raster.center(1, cell);
            let kernel = p.y * area / (PI * (p.length_squared() + 1.0).powi(2));
            assert!((raster.delta(1, cell) / kernel - 1.0).abs() < 1e-3);
        }
    }
}
