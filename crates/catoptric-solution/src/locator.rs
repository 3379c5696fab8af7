//! Finds the element of a face that holds a point: a grid of element lists per face, in plane coordinates, with finer ones where cells
//! are crowded.

use std::collections::BTreeMap;

use glam::Vec2;
use rayon::prelude::*;

use crate::mesh::{DisplayVertex, Element, Face, FaceId};

/// Faces whose grids are built in one go.
const FACES_PER_JOB: usize = 64;

/// Grids of all faces in shared tables.
#[derive(Clone, Debug, Default)]
pub struct Locator {
    grids: Vec<Grid>,
    /// Start of each cell's list in `entries`, one more than there are cells.
    starts: Vec<u32>,
    entries: Vec<u32>,
    shapes: Vec<Shape>,
    /// Grids of crowded cells.
    nested: Vec<Grid>,
}

/// An entry that is a grid of its own, by its index.
const NESTED: u32 = 1 << 31;
/// Elements of a cell above which it gets one: a field around a house has thousands in the one where the house stands.
const CROWD: u32 = 48;
/// Grids in each other, at most: each divides its cell by the root of [`CROWD`] or more.
const MOST_GRIDS: u32 = 10;
/// How often the elements of a cell may be listed in the cells of its grid, on average.
const MOST_LISTED: usize = 6;

#[derive(Clone, Copy, Debug, Default)]
struct Grid {
    min: Vec2,
    cells_per_metre: Vec2,
    columns: u32,
    rows: u32,
    first_cell: u32,
}

impl Grid {
    /// Cells near to square, about one per element, at most 1024 a side.
    fn over([min, max]: [Vec2; 2], count: usize) -> Self {
        let (extent, count) = (max - min, count as f32);
        let aspect = (extent.x / extent.y.max(1e-30)).clamp(1e-3, 1e3);
        let columns = ((count * aspect).sqrt().ceil() as u32).clamp(1, 1024);
        let rows = ((count / aspect).sqrt().ceil() as u32).clamp(1, 1024);
        let cells_per_metre =
            Vec2::new(columns as f32 / extent.x.max(1e-30), rows as f32 / extent.y.max(1e-30));
        Self { min, cells_per_metre, columns, rows, first_cell: 0 }
    }

    /// First and last column and row of the cells that the box of a triangle meets.
    fn cells(&self, [a, b, c]: &[Vec2; 3]) -> [u32; 4] {
        let range = |low: f32, high: f32, cells: u32| {
            let clamp = |x: f32| (x as i64).clamp(0, i64::from(cells) - 1) as u32;
            // A hair wider than the element: a point on a cell border may round either way.
            (clamp((low - 1e-3).floor()), clamp((high + 1e-3).floor()))
        };
        let low = (a.min(*b).min(*c) - self.min) * self.cells_per_metre;
        let high = (a.max(*b).max(*c) - self.min) * self.cells_per_metre;
        let ((x0, x1), (y0, y1)) = (range(low.x, high.x, self.columns), range(low.y, high.y, self.rows));
        [x0, x1, y0, y1]
    }

    /// The cells in such a range.
    fn within(&self, &[x0, x1, y0, y1]: &[u32; 4]) -> impl Iterator<Item = usize> + use<> {
        let columns = self.columns;
        (y0..=y1).flat_map(move |y| (x0..=x1).map(move |x| (y * columns + x) as usize))
    }

    /// Column and row of a cell.
    fn corner(&self, cell: usize) -> Vec2 {
        let cell = cell as u32;
        Vec2::new((cell % self.columns) as f32, (cell / self.columns) as f32)
    }

    /// Where a cell lies.
    fn rectangle(&self, cell: usize) -> [Vec2; 2] {
        let corner = self.corner(cell);
        [corner, corner + 1.0].map(|corner| self.min + corner / self.cells_per_metre)
    }

    /// The cells that need grids of their own, ascending, with their elements, and 1 as their count. `own` are the grid's, which meet `cells`.
    fn crowded(
        &self,
        corners: &[[Vec2; 3]],
        own: &[u32],
        cells: &[[u32; 4]],
        count: &mut [u32],
    ) -> Vec<(usize, Vec<u32>)> {
        if count.iter().all(|&count| count <= CROWD) {
            return Vec::new();
        }
        let mut members: BTreeMap<usize, Vec<u32>> = BTreeMap::new();
        for (&element, own) in own.iter().zip(cells) {
            for cell in self.within(own).filter(|&cell| count[cell] > CROWD) {
                members.entry(cell).or_default().push(element);
            }
        }
        // Not where all lie on each other, or meet in one place: that would only be listed more often.
        members.retain(|&cell, members| {
            let grid = Self::over(self.rectangle(cell), members.len());
            let listed = |&e: &u32| {
                let [x0, x1, y0, y1] = grid.cells(&corners[e as usize]);
                (x1 - x0 + 1) as usize * (y1 - y0 + 1) as usize
            };
            members.iter().map(listed).sum::<usize>() <= MOST_LISTED * members.len()
        });
        members.keys().for_each(|&cell| count[cell] = 1);
        members.into_iter().collect()
    }
}

/// The box of some triangles.
fn bounds(corners: &[[Vec2; 3]]) -> [Vec2; 2] {
    let points = || corners.iter().flatten().copied();
    [points().fold(Vec2::INFINITY, Vec2::min), points().fold(Vec2::NEG_INFINITY, Vec2::max)]
}

/// Barycentric coordinates as an affine map of plane coordinates: (u, v) = matrix · (p − origin).
#[derive(Clone, Copy, Debug, Default)]
struct Shape {
    origin: Vec2,
    u: Vec2,
    v: Vec2,
}

impl Shape {
    fn new(a: Vec2, b: Vec2, c: Vec2) -> Self {
        let (e, f) = (b - a, c - a);
        let determinant = e.perp_dot(f);
        if determinant == 0.0 {
            // Without area it holds no point.
            return Self { origin: Vec2::NAN, u: Vec2::ZERO, v: Vec2::ZERO };
        }
        Self { origin: a, u: Vec2::new(f.y, -f.x) / determinant, v: Vec2::new(-e.y, e.x) / determinant }
    }

    #[inline]
    fn weights(&self, point: Vec2) -> [f32; 3] {
        let offset = point - self.origin;
        let (u, v) = (self.u.dot(offset), self.v.dot(offset));
        [1.0 - u - v, u, v]
    }
}

impl Locator {
    /// Builds the grids: about one cell per element.
    pub fn new(vertices: &[DisplayVertex], elements: &[Element], faces: &[Face]) -> Self {
        // By itself rayon stops splitting after few halves, and one face may be as fine as a thousand others.
        let jobs = faces.par_chunks(FACES_PER_JOB).with_max_len(1);
        let parts: Vec<Self> = jobs.map(|faces| Self::part(vertices, elements, faces)).collect();
        let mut all = Self::default();
        all.grids.reserve(faces.len());
        all.starts.reserve(parts.iter().map(|part| part.starts.len()).sum::<usize>() + 1);
        all.entries.reserve(parts.iter().map(|part| part.entries.len()).sum());
        all.shapes.reserve(elements.len());
        for part in parts {
            let (cell, entry, nested) =
                (all.starts.len() as u32, all.entries.len() as u32, all.nested.len() as u32);
            let moved = |grid: &Grid| Grid { first_cell: grid.first_cell + cell, ..*grid };
            all.grids.extend(part.grids.iter().map(moved));
            all.nested.extend(part.nested.iter().map(moved));
            all.starts.extend(part.starts.iter().map(|start| start + entry));
            let shift = |entry: u32| if entry & NESTED == 0 { entry } else { entry + nested };
            all.entries.extend(part.entries.into_iter().map(shift));
            all.shapes.extend(part.shapes);
        }
        all.starts.push(all.entries.len() as u32);
        all
    }

    /// Those of some faces; their tables begin at zero.
    fn part(vertices: &[DisplayVertex], elements: &[Element], faces: &[Face]) -> Self {
        let mut locator = Self::default();
        let mut corners = Vec::new();
        for face in faces {
            corners.clear();
            let own = &elements[face.elements.start as usize..face.elements.end as usize];
            corners.extend(
                own.iter().map(|e| e.vertices.map(|v| face.plane_point(vertices[v as usize].position))),
            );
            locator.shapes.extend(corners.iter().map(|[a, b, c]| Shape::new(*a, *b, *c)));
            locator.push_grid(&corners, face.elements.start);
        }
        locator
    }

    fn push_grid(&mut self, corners: &[[Vec2; 3]], first_element: u32) {
        let [min, max] = bounds(corners);
        // A face of one element needs none.
        let grid = if corners.len() < 2 || !(max - min).is_finite() {
            Grid { first_cell: self.starts.len() as u32, ..Grid::default() }
        } else {
            let own: Vec<u32> = (0..corners.len() as u32).collect();
            self.grid(corners, &own, [min, max], first_element, 0)
        };
        self.grids.push(grid);
    }

    /// A grid over a rectangle, for some of the elements of a face, with grids of their own in crowded cells: its cells and lists are
    /// appended. `corners` are those of all elements.
    fn grid(
        &mut self,
        corners: &[[Vec2; 3]],
        own: &[u32],
        rectangle: [Vec2; 2],
        first_element: u32,
        depth: u32,
    ) -> Grid {
        let first_cell = self.starts.len() as u32;
        let grid = Grid { first_cell, ..Grid::over(rectangle, own.len()) };
        // Counted first, so that one table holds all lists.
        let cells: Vec<[u32; 4]> = own.iter().map(|&e| grid.cells(&corners[e as usize])).collect();
        let mut next = vec![0_u32; (grid.columns * grid.rows) as usize];
        cells.iter().flat_map(|own| grid.within(own)).for_each(|cell| next[cell] += 1);
        let crowded =
            if depth < MOST_GRIDS { grid.crowded(corners, own, &cells, &mut next) } else { Vec::new() };
        let mut end = self.entries.len() as u32;
        for next in &mut next {
            self.starts.push(end);
            end += std::mem::replace(next, end);
        }
        self.entries.resize(end as usize, 0);
        let nested = self.nested.len() as u32;
        for (index, (cell, _)) in (nested..).zip(&crowded) {
            self.entries[next[*cell] as usize] = NESTED | index;
        }
        for (&element, own) in own.iter().zip(&cells) {
            for cell in grid.within(own) {
                // A crowded cell keeps its one entry.
                let entry = &mut self.entries[next[cell] as usize];
                if *entry & NESTED == 0 {
                    *entry = first_element + element;
                    next[cell] += 1;
                }
            }
        }
        // Most points of a cell lie in the element that holds its middle. (Of crowded cells, nothing has been listed.)
        let shapes = &self.shapes[self.shapes.len() - corners.len()..];
        let starts = self.starts[first_cell as usize..].iter().map(|&start| start as usize);
        let ends = next.iter().map(|&end| end as usize);
        for (cell, (start, end)) in (0..).zip(starts.zip(ends)) {
            let middle = grid.corner(cell) + 0.5;
            let middle = grid.min + middle / grid.cells_per_metre;
            let list = &mut self.entries[start..end];
            let is_there = |&element: &u32| holds(shapes[(element - first_element) as usize].weights(middle));
            if let Some(first) = list.iter().position(is_there) {
                list.swap(0, first);
            }
        }
        self.nested.resize(self.nested.len() + crowded.len(), Grid::default());
        for (index, (cell, members)) in (nested as usize..).zip(crowded) {
            self.nested[index] = self.grid(corners, &members, grid.rectangle(cell), first_element, depth + 1);
        }
        grid
    }

    /// The element at `point` and its weights. A point between elements by rounding, or outside of the face, gets the
    /// element that it is least outside of, with weights clamped into it.
    #[inline]
    pub fn find(&self, id: FaceId, face: &Face, point: Vec2) -> Option<(u32, [f32; 3])> {
        let grid = &self.grids[id.0 as usize];
        if face.elements.end == face.elements.start + 1 {
            let element = face.elements.start;
            return Some((element, inside(self.shapes[element as usize].weights(point))));
        }
        if grid.columns == 0 {
            return None;
        }
        let mut list = self.list(grid, point);
        while let [only] = list
            && only & NESTED != 0
        {
            list = self.list(&self.nested[(only ^ NESTED) as usize], point);
        }
        self.best(list.iter().copied(), point).or_else(|| self.best(face.elements.clone(), point))
    }

    /// What lies in the cell of a point.
    #[inline]
    fn list(&self, grid: &Grid, point: Vec2) -> &[u32] {
        let cell = (point - grid.min) * grid.cells_per_metre;
        let x = (cell.x.max(0.0) as u32).min(grid.columns - 1);
        let y = (cell.y.max(0.0) as u32).min(grid.rows - 1);
        let index = (grid.first_cell + y * grid.columns + x) as usize;
        &self.entries[self.starts[index] as usize..self.starts[index + 1] as usize]
    }

    /// The candidate that holds a point, else the one that it is least outside of.
    #[inline]
    fn best(&self, candidates: impl Iterator<Item = u32> + Clone, point: Vec2) -> Option<(u32, [f32; 3])> {
        for element in candidates.clone() {
            let weights = self.shapes[element as usize].weights(point);
            if holds(weights) {
                return Some((element, weights));
            }
        }
        let depth = |weights: [f32; 3]| weights[0].min(weights[1]).min(weights[2]);
        let best = candidates
            .map(|element| (element, self.shapes[element as usize].weights(point)))
            .filter(|(_, weights)| !weights[0].is_nan())
            .reduce(|best, next| if depth(next.1) > depth(best.1) { next } else { best });
        best.map(|(element, weights)| (element, inside(weights)))
    }
}

/// Whether no weight is negative.
#[inline]
fn holds([a, b, c]: [f32; 3]) -> bool {
    // One branch that is hard to predict, not three.
    (a >= 0.0) & (b >= 0.0) & (c >= 0.0)
}

/// Weights moved to the nearest side of the element: ≥ 0, sum 1.
#[inline]
fn inside(weights: [f32; 3]) -> [f32; 3] {
    let [a, b, c] = weights.map(|w| if w > 0.0 { w } else { 0.0 });
    let sum = a + b + c;
    if sum > 0.0 { [a / sum, b / sum, c / sum] } else { [1.0, 0.0, 0.0] }
}

#[cfg(test)]
mod tests {
    use catoptric_scene::{Side, TriangleId};
    use glam::Vec3;

    use super::*;

    /// A square of uneven triangles, some of them without area.
    fn square(n: u32) -> (Vec<DisplayVertex>, Vec<Element>, Face) {
        let side = 2.0;
        let place = |k: u32| {
            let [x, z] = [k % (n + 1), k / (n + 1)].map(|i| i as f32 / n as f32);
            // Fine at one corner, coarse at the other.
            Vec3::new(x * x, 0.0, z * z * z) * side
        };
        let vertices: Vec<DisplayVertex> = (0..(n + 1) * (n + 1))
            .map(|k| DisplayVertex {
                position: place(k),
                normal: Vec3::Y,
                triangle: TriangleId(0),
                side: Side::Front,
            })
            .collect();
        let corner = |x: u32, z: u32| z * (n + 1) + x;
        let mut elements = Vec::new();
        for (x, z) in (0..n * n).map(|k| (k % n, k / n)) {
            let [a, b, c, d] = [corner(x, z), corner(x, z + 1), corner(x + 1, z + 1), corner(x + 1, z)];
            elements.extend([[a, b, c], [a, c, c], [a, c, d]].map(|vertices| Element { vertices }));
        }
        let face = Face {
            elements: 0..elements.len() as u32,
            origin: Vec3::new(0.3, 0.0, -0.2),
            axes: [Vec3::Z, Vec3::X],
        };
        (vertices, elements, face)
    }

    /// Inside, an element is found that holds the point, as the weights say; outside, the nearest in its cell, with weights on its border.
    #[test]
    fn points_lie_in_the_elements_that_are_found() {
        let (vertices, elements, face) = square(17);
        let locator = Locator::new(&vertices, &elements, std::slice::from_ref(&face));
        let mut found = vec![false; elements.len()];
        for (i, j) in (0..400).flat_map(|i| (0..400).map(move |j| (i, j))) {
            // From a tenth outside to a tenth outside.
            let point = Vec3::new(i as f32, 0.0, j as f32) * (2.4 / 399.0) - Vec3::new(0.2, 0.0, 0.2);
            let (element, weights) =
                locator.find(FaceId(0), &face, face.plane_point(point)).expect("the face has elements");
            found[element as usize] = true;
            assert!(weights.iter().all(|w| *w >= 0.0) && (weights.iter().sum::<f32>() - 1.0).abs() < 1e-6);
            let corners = elements[element as usize].vertices.map(|v| vertices[v as usize].position);
            let there: Vec3 = corners.iter().zip(weights).map(|(corner, weight)| *corner * weight).sum();
            let is_inside = point.clamp(Vec3::ZERO, Vec3::splat(2.0)) == point;
            // Rounding: an element is as thin as 2·17⁻³ m, and its weights are quotients by that of differences of 2⁻²⁴ · 2.4 m.
            assert!(!is_inside || there.distance(point) < 1e-4, "{point}: {there}");
        }
        let has_area = |index: usize| index % 3 != 1;
        assert!(found.iter().enumerate().all(|(index, found)| has_area(index) || !found));
        // The finest are smaller than the distance of two points.
        assert!(found.iter().filter(|found| **found).count() > elements.len() / 2);
    }

    /// A field around a house: rings of triangles, from one metre to ten kilometres.
    fn field() -> (Vec<DisplayVertex>, Vec<Element>, Face) {
        const RINGS: u32 = 64;
        const SECTORS: u32 = 32;
        let mut vertices = Vec::new();
        let mut radius = 1.0;
        for _ in 0..=RINGS {
            for sector in 0..SECTORS {
                let around =
                    Vec2::from_angle(sector as f32 * std::f32::consts::TAU / SECTORS as f32) * radius;
                let position = Vec3::new(around.x, 0.0, around.y);
                let (triangle, side) = (TriangleId(0), Side::Front);
                vertices.push(DisplayVertex { position, normal: Vec3::Y, triangle, side });
            }
            radius *= 1.155;
        }
        let elements: Vec<Element> = (0..RINGS * SECTORS)
            .flat_map(|at| {
                let next = at - at % SECTORS + (at + 1) % SECTORS;
                let [a, b, c, d] = [at, next, next + SECTORS, at + SECTORS];
                [[a, c, b], [a, d, c]].map(|vertices| Element { vertices })
            })
            .collect();
        let axes = [Vec3::Z, Vec3::X];
        let face = Face { elements: 0..elements.len() as u32, origin: Vec3::ZERO, axes };
        (vertices, elements, face)
    }

    /// No list is long, and each element is found by its middle. (One grid for all has 1000 triangles in a cell.)
    #[test]
    fn crowded_cells_have_grids_of_their_own() {
        let (vertices, elements, face) = field();
        let locator = Locator::new(&vertices, &elements, std::slice::from_ref(&face));
        let longest = locator.starts.windows(2).map(|pair| pair[1] - pair[0]).max();
        // Half as many again where most reach across the cell: a grid would only list them more often.
        assert!(longest.is_some_and(|longest| 2 * longest <= 3 * CROWD), "{longest:?}");
        // A ring is a sixth wider than the one in it: about three levels of grids, each of a few crowded cells, reach from the horizon to
        // the house.
        assert!((1..64).contains(&locator.nested.len()), "{}", locator.nested.len());
        for (index, element) in (0..).zip(&elements) {
            let corners = element.vertices.map(|v| face.plane_point(vertices[v as usize].position));
            let middle = corners.iter().sum::<Vec2>() / 3.0;
            let found = locator.find(FaceId(0), &face, middle).map(|(element, _)| element);
            assert_eq!(found, Some(index));
        }
    }
}
