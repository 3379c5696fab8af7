//! Finds the triangle of a face at a point: the ceiling of a scanned room is one face of many thousand triangles, and each
//! sample of light asks.

use glam::{DVec2, Vec3};

use catoptric_scene::{Scene, TriangleId};
use catoptric_trace::Tracer;

use crate::face::{FaceDraft, Frame};

/// Triangles from which on a face has a grid.
const MANY: usize = 16;
/// Cells on a side at most.
const MOST_CELLS: f64 = 1024.0;
/// Share of a cell by which triangles are taken to be larger: a point on a border may round either way.
const MARGIN: f64 = 1e-3;

/// Lists of triangles by cells of the plane, about one cell per triangle.
#[derive(Clone, Debug)]
pub struct FaceGrid {
    min: DVec2,
    cells_per_metre: DVec2,
    columns: usize,
    rows: usize,
    /// Start of each cell's list, one more than there are cells.
    starts: Vec<u32>,
    /// Ascending within a cell.
    entries: Vec<TriangleId>,
}

impl FaceGrid {
    /// The grid of a face, `None` where there are few triangles.
    pub fn new(scene: &Scene, frame: &Frame, triangles: &[TriangleId]) -> Option<Self> {
        if triangles.len() < MANY {
            return None;
        }
        let bounds: Vec<[DVec2; 2]> = triangles
            .iter()
            .map(|&id| {
                let [a, b, c] = scene.corners(id).map(|p| frame.flat(p.as_dvec3()));
                [a.min(b).min(c), a.max(b).max(c)]
            })
            .collect();
        let (min, max) = bounds
            .iter()
            .fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(low, high), b| (low.min(b[0]), high.max(b[1])));
        let extent = (max - min).max(DVec2::splat(1e-30));
        let count = triangles.len() as f64;
        let aspect = (extent.x / extent.y).clamp(1e-3, 1e3);
        let cells = DVec2::new((count * aspect).sqrt(), (count / aspect).sqrt());
        let cells = cells.ceil().clamp(DVec2::ONE, DVec2::splat(MOST_CELLS));
        let mut grid = Self {
            min,
            cells_per_metre: cells / extent,
            columns: cells.x as usize,
            rows: cells.y as usize,
            starts: Vec::new(),
            entries: Vec::new(),
        };
        let mut lists: Vec<Vec<TriangleId>> = vec![Vec::new(); grid.columns * grid.rows];
        for (&id, [low, high]) in triangles.iter().zip(bounds) {
            let ((x0, y0), (x1, y1)) = (grid.cell(low, -MARGIN), grid.cell(high, MARGIN));
            for y in y0..=y1 {
                for x in x0..=x1 {
                    lists[y * grid.columns + x].push(id);
                }
            }
        }
        for list in &lists {
            grid.starts.push(grid.entries.len() as u32);
            grid.entries.extend(list);
        }
        grid.starts.push(grid.entries.len() as u32);
        Some(grid)
    }

    /// Column and row of a point that is moved by a share of a cell.
    fn cell(&self, point: DVec2, margin: f64) -> (usize, usize) {
        let at = (point - self.min) * self.cells_per_metre + DVec2::splat(margin);
        ((at.x.max(0.0) as usize).min(self.columns - 1), (at.y.max(0.0) as usize).min(self.rows - 1))
    }

    /// Triangles that may hold a point, ascending.
    fn near(&self, point: DVec2) -> &[TriangleId] {
        let (x, y) = self.cell(point, 0.0);
        let index = y * self.columns + x;
        &self.entries[self.starts[index] as usize..self.starts[index + 1] as usize]
    }
}

impl FaceDraft {
    /// The triangle of the face that holds a point, the first of them; beside the face the one that it is least outside of.
    pub fn triangle_at(&self, tracer: &Tracer, position: Vec3) -> TriangleId {
        if self.triangles.len() == 1 {
            return self.triangles[0];
        }
        let p = self.frame.flat(position.as_dvec3());
        let near = self.grid.as_ref().map_or(&[][..], |grid| grid.near(p));
        let depth = |id: TriangleId| {
            let [a, b, c] = tracer.scene().corners(id).map(|q| self.frame.flat(q.as_dvec3()));
            let area = (b - a).perp_dot(c - a);
            let depths = [(a, b), (b, c), (c, a)].map(|(q, r)| (r - q).perp_dot(p - q) / area);
            depths[0].min(depths[1]).min(depths[2])
        };
        if let Some(&found) = near.iter().find(|&&id| depth(id) >= 0.0) {
            return found;
        }
        let mut best = (f64::NEG_INFINITY, self.triangles[0]);
        for &id in &self.triangles {
            let depth = depth(id);
            if depth >= 0.0 {
                return id;
            }
            if depth > best.0 {
                best = (depth, id);
            }
        }
        best.1
    }
}

#[cfg(test)]
mod tests {
    use catoptric_scene::{Material, Rgb, SceneParts};
    use catoptric_trace::sequence::{Key, Purpose};

    use super::*;
    use crate::face::faces;

    #[test]
    fn the_grid_finds_what_a_search_of_all_triangles_finds() {
        let mut parts = SceneParts::default();
        let white = parts.add_material(Material::lambertian("white", Rgb::splat(0.5)));
        for i in 0..12 {
            for j in 0..9 {
                let corner = Vec3::new(i as f32 * 0.125, 0.0, j as f32 * 0.25);
                parts.add_quad("tile", white, corner, Vec3::Z * 0.25, Vec3::X * 0.125);
            }
        }
        let scene = Scene::new(parts).expect("a valid scene");
        let tracer = Tracer::new(&scene);
        let face = faces(&tracer).into_iter().next().expect("one face");
        assert_eq!(face.triangles.len(), 216);
        let slow = FaceDraft { grid: None, ..face.clone() };
        let key = Key::new(1, Purpose::Test, 0);
        for index in 0..2000 {
            // Also on edges between tiles, and outside.
            let at = key.point2(index) * 1.2 - glam::Vec2::splat(0.1);
            let at = if index % 3 == 0 { (at * 16.0).round() / 16.0 } else { at };
            let point = Vec3::new(at.x * 1.5, 0.0, at.y * 2.25);
            assert_eq!(face.triangle_at(&tracer, point), slow.triangle_at(&tracer, point), "{point}");
        }
    }
}
